"""eldata: data for denoising raw photographs taken in the dark.

The public names load on first use, so that importing the package stays light: neither torch nor rawpy.
"""

import lazy_loader

from eldata.errors import name_missing_torch

__version__ = "0.2.0"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__getattr__ = name_missing_torch(__getattr__)
