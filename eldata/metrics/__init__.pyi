from .rescaling import rescale as rescale
from .rescaling import rescale_factor as rescale_factor
from .scoring import Score as Score
from .scoring import score as score
from .signal_to_noise import psnr as psnr
from .similarity import ssim as ssim

__all__ = ["Score", "psnr", "rescale", "rescale_factor", "score", "ssim"]
