"""Pairs as sequential shards: written from a store, read from disk or over a network. The names load on first use."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
