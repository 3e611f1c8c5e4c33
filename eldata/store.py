"""The old name of :mod:`eldata.sources.store`, until 0.3."""

from eldata.base.moved import forwarded

__getattr__ = forwarded(__name__, "eldata.sources.store")
