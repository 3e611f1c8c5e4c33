"""Metrics and datasets as other frameworks take them."""
