"""Raw to sRGB: the paper's pipeline on torch, measured response curves, LibRaw's rendering, a quick preview."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
