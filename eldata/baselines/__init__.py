"""Predictions of a data set: denoisers without training, and networks from files. The names load on first use."""

import lazy_loader

from eldata.errors import name_missing_torch

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__getattr__ = name_missing_torch(__getattr__)
