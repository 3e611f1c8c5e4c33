from .image_score import Score as Score
from .image_score import ScoringRules as ScoringRules
from .image_score import factor_by as factor_by
from .image_score import score as score
from .image_score import score_by as score_by
from .rescaling import rescale as rescale
from .rescaling import rescale_factor as rescale_factor
from .signal_to_noise import psnr as psnr
from .similarity import ssim as ssim
from .st_rred import PEAK_8_BIT as PEAK_8_BIT
from .st_rred import PEAK_ELD as PEAK_ELD
from .st_rred import StRred as StRred
from .st_rred import raw_to_grey as raw_to_grey
from .st_rred import st_rred as st_rred

__all__ = [
    "PEAK_8_BIT",
    "PEAK_ELD",
    "Score",
    "ScoringRules",
    "StRred",
    "factor_by",
    "psnr",
    "raw_to_grey",
    "rescale",
    "rescale_factor",
    "score",
    "score_by",
    "ssim",
    "st_rred",
]
