"""Manifests: one row per file, with a dataset card beside it. Importing it needs neither torch nor rawpy."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
