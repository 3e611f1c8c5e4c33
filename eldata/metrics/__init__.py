"""Image metrics: PSNR, SSIM, ELD's illuminance rescaling, and the three fused into one protocol."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
