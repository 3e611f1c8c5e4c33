"""Image metrics: PSNR, SSIM, ELD's illuminance rescaling, the three fused into one protocol; LPIPS of sRGB images."""

import lazy_loader

from eldata.base.moved import forwarded

_find, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
__getattr__ = forwarded(
    __name__,
    {name: f"eldata.integrations.torchmetrics:{name}" for name in ("PSNR", "SSIM", "ProtocolScore")},
    find=_find,
)
