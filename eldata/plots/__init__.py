"""Drawings of plain numbers, for pages and for notebooks: what is measured, and what it means, others say."""
