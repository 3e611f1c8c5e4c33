"""Image metrics: PSNR, SSIM, ELD's illuminance rescaling, the three fused into one protocol; ST-RRED of clips."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
