"""Photograph scenes for a low-light denoising dataset: the protocol, the plan, the shots, and what became of them.

A sibling of :mod:`eldata` that needs neither a decoder nor a tensor library to plan. Public names load on first use.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
