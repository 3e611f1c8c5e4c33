"""Manifests: one row a file, with a dataset card beside it. Needs neither torch nor rawpy to import."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
