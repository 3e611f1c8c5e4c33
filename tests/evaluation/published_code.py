"""Each protocol of images as its authors' code computes it, step by step, in numpy, scikit-image and rawpy.

It shares no code with the package, on purpose: nothing of ``eldata`` may be imported here. Every step names the file
and the function that it follows. The repositories, at these commits:

- ELD: Vandermode/ELD, 53d5408
- PMN: megvii-research/PMN, d207d3e; on LRID its branch TPAMI, 9f985ba
- LED: Srameo/LED, ee3d372
- LRD: fengzhang427/LRD, 451f079
- SID: cchen156/Learning-to-See-in-the-Dark, 0448b58

Frames are normalised in float32 where theirs are, since "is not 1" depends on it. From there on they compute in float32
(torch; scikit-image of their time made PSNR of float32 in float32), and here it is float64 throughout: their sums move
with the machine by more than the tolerance. Their division by <p, p> has no guard; nor has it here.

Predictions come as mosaics: a network's output with every value at its pixel. So the order of channels is the authors'
on this side, and whatever it is on the other.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache, partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, TypeAlias

import exifread
import numpy as np
import rawpy
from numpy.typing import NDArray
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

Array: TypeAlias = NDArray[Any]
Response: TypeAlias = Callable[[Array], Array]

psnr_of: Any = peak_signal_noise_ratio  # scikit-image has annotations in part only
ssim_of: Any = structural_similarity


@dataclass(frozen=True)
class Score:
    """``factor`` is NaN where the code finds none."""

    psnr_db: float
    ssim: float
    factor: float = math.nan


@dataclass(frozen=True)
class Route:
    """What one repository does with a pair: arrays are packed as it packs them, (C, h, w).

    ``arranged`` brings a network's output, as a mosaic, into the repository's channels; ``target`` reads a reference,
    ``given`` what the network is given of a noisy frame and its ratio; ``score`` compares an output with a target.
    """

    arranged: Callable[[Array, Any], Array]
    target: Callable[[Any], Array]
    given: Callable[[Any, float], Array]
    ratio: Callable[[Path, Path], float]
    score: Callable[[Array, Array, Path], Score]

    def of_prediction(self, mosaic: Array, reference: Path) -> Score:
        with opened(reference) as raw:
            return self.score(self.arranged(mosaic, raw), self.target(raw), reference)

    def of_input(self, noisy: Path, reference: Path) -> Score:
        """Score a network that returns what it is given."""
        with opened(reference) as raw:
            target = self.target(raw)
        with opened(noisy) as raw:
            return self.score(self.given(raw, self.ratio(noisy, reference)), target, reference)


def opened(path: Path) -> Any:
    """A raw file, or a mosaic in .npy in its place: PMN utils.py dataload, branch TPAMI."""
    if path.suffix == ".npy":
        return nullcontext(SimpleNamespace(raw_image_visible=np.load(path)))
    return rawpy.imread(str(path))


# --- how frames are packed --------------------------------------------------------------------------------------------


def bayer_by_pattern(mosaic: Array, raw: Any) -> Array:
    """R, G, B and the other G, found in LibRaw's pattern.

    ELD dataset/sid_dataset.py pack_raw_bayer; the same in LRD datasets/Denoise_dataset.py pack_raw_SID and in LED
    led/data/raw_utils.py pack_raw_bayer, which cuts an odd last row or column off first.
    """
    height, width = (size - size % 2 for size in mosaic.shape)
    even = mosaic[:height, :width]
    corners = [np.argwhere(raw.raw_pattern == colour)[0] for colour in (0, 1, 2, 3)]
    return np.stack([even[top::2, left::2] for top, left in corners])


def bayer_in_place(mosaic: Array, raw: Any) -> Array:
    """The four corners of each cell clockwise, whatever their colours: PMN data_process/process.py raw2bayer."""
    del raw
    return np.stack([mosaic[0::2, 0::2], mosaic[0::2, 1::2], mosaic[1::2, 1::2], mosaic[1::2, 0::2]])


def bayer_by_rows(mosaic: Array, raw: Any) -> Array:
    """The four corners of each cell by rows, R first: LRD datasets/Denoise_dataset.py pack_raw_LRD."""
    del raw
    return np.stack([mosaic[0::2, 0::2], mosaic[0::2, 1::2], mosaic[1::2, 0::2], mosaic[1::2, 1::2]])


# Each row is a channel; its four places are those of the cell's corners in a period of six.
XTRANS_QUARTERS = (
    ((0, 0), (0, 4), (3, 1), (3, 3)),
    ((0, 2), (0, 5), (3, 2), (3, 5)),
    ((0, 1), (0, 3), (3, 0), (3, 4)),
    ((1, 2), (2, 5), (5, 2), (4, 5)),
    ((2, 2), (1, 5), (4, 2), (5, 5)),
)
XTRANS_THIRDS = ((1, 0), (1, 1), (2, 0), (2, 1))


def xtrans(mosaic: Array, raw: Any) -> Array:
    """Nine channels at fixed places: SID test_Fuji.py pack_raw, ELD dataset/sid_dataset.py pack_raw_xtrans."""
    del raw
    height, width = (size // 6 * 6 for size in mosaic.shape)
    whole = mosaic[:height, :width]
    packed = np.zeros((9, height // 3, width // 3), mosaic.dtype)
    for channel, places in enumerate(XTRANS_QUARTERS):
        for corner, (down, right) in enumerate(places):
            packed[channel, corner // 2 :: 2, corner % 2 :: 2] = whole[down::6, right::6]
    for channel, (down, right) in enumerate(XTRANS_THIRDS, start=5):
        packed[channel] = whole[down::3, right::3]
    return packed


# --- levels and clips -------------------------------------------------------------------------------------------------


def unit(values: Array) -> Array:
    """Clipped to [0, 1], in the type that they have."""
    clipped: Array = np.clip(values, 0, 1)
    return clipped


def dn(raw: Any) -> Array:
    mosaic: Array = raw.raw_image_visible.astype(np.float32)
    return mosaic


def blacks(raw: Any) -> Array:
    """In LibRaw's order R, G, B, G, as whole numbers."""
    return np.array(raw.black_level_per_channel, np.float32)[:, None, None]


def eld_frame(raw: Any, white: float | None = 16383) -> Array:
    """ELD dataset/sid_dataset.py pack_raw_bayer: black of the file, white a constant, clipped before any ratio.

    LRD datasets/Denoise_dataset.py pack_raw_SID has LibRaw's ``white_level`` in the constant's place.
    """
    level = np.float32(raw.white_level if white is None else white)
    return unit((bayer_by_pattern(dn(raw), raw) - blacks(raw)) / (level - blacks(raw)))


def eld_xtrans_frame(raw: Any) -> Array:
    """ELD dataset/sid_dataset.py pack_raw_xtrans: both levels are constants, and clipped before packing."""
    return xtrans(unit((dn(raw) - np.float32(1024)) / np.float32(16383 - 1024)), raw)


def amplified(frame: Callable[[Any], Array], raw: Any, ratio: float) -> Array:
    """ELD dataset/sid_dataset.py SIDDataset and ELDEvalDataset, LRD datasets/Denoise_dataset.py ELDEvalDataset.

    LRD subtracts a dark shading first, which is data of one camera and not of a protocol; it is left out.
    """
    return unit(frame(raw) * np.float32(ratio))


def lrd_own_frame(raw: Any) -> Array:
    """LRD datasets/Denoise_dataset.py pack_raw_LRD: white 65535, and LibRaw's R, G, B, G as black of R, G, G, B."""
    return unit((bayer_by_rows(dn(raw), raw) - blacks(raw)) / (np.float32(65535) - blacks(raw)))


def pmn_frame(raw: Any, ratio: float | None = None) -> Array:
    """PMN data_process/process.py raw2bayer with bl 512 and wp 16383 (runfiles/*.yml), of any file.

    Reference: clipped by raw2bayer. Input: not clipped there but after the ratio, if the run file says so, which those
    of the baselines do (data_process/real_datasets.py SID_Dataset and ELD_Dataset, ``__getitem__``).
    """
    packed = bayer_in_place(dn(raw), raw).astype(np.float64)  # an array of integers is subtracted: numpy widens
    normalised = (packed - 512) / (16383 - 512)
    if ratio is None:
        return unit(normalised).astype(np.float32)
    return unit(normalised.astype(np.float32) * np.float32(ratio))


def sony_frame(raw: Any, ratio: float | None = None) -> Array:
    """SonyResearch/raw_image_denoising datasets/real_dataset.py ELDPairEvalDataset, without its dark shading."""
    packed = bayer_in_place(dn(raw).astype(np.float32), raw)
    normalised = (packed - 512) / (16383 - 512)
    if ratio is None:
        return np.clip(normalised, 0, 1).astype(np.float32)
    given: Array = np.minimum(normalised.astype(np.float32) * np.float32(ratio), 1)
    return given


def sony_lrid_input(raw: Any, ratio: float) -> Array:
    """SonyResearch/raw_image_denoising datasets/real_dataset.py LRIDEvalDataset, without its dark shading."""
    packed = bayer_in_place(dn(raw).astype(np.float32), raw)
    given: Array = np.minimum(((packed - 64) / (1023 - 64)).astype(np.float32) * np.float32(ratio), 1)
    return given


def lrid_frame(raw: Any, ratio: float | None = None) -> Array:
    """PMN, branch TPAMI, data_process/process.py raw2bayer with bl 64 and wp 1023 (runfiles/IMX686/Ours.yml).

    data_process/phone_datasets.py IMX686_Dataset, ``__getitem__``: a reference is clipped, an input multiplied by the
    gain of its folder (ori is false) and not clipped (clip is false) before trainer_LRID.py clamps it to be scored. The
    dark shading, which is subtracted first, is data and not of a protocol; it is left out.
    """
    black = np.array([0, 0, 0, 0]) + 64
    normalised = (bayer_in_place(dn(raw), raw) - black[:, None, None]) / (1023 - black[:, None, None])
    if ratio is None:
        return unit(normalised).astype(np.float32)
    given: Array = normalised.astype(np.float32) * np.float32(ratio)
    return given


def led_levels(raw: Any) -> Array:
    """LED led/data/raw_utils.py read_img: LibRaw's white level per channel, or its one where there are none."""
    stated = raw.camera_white_level_per_channel
    whites = [raw.white_level] * 4 if stated is None else stated
    return np.array(whites, np.float32)[:, None, None]


def led_frame(raw: Any, ratio: float | None = None) -> Array:
    """LED led/data/paired_raw_dataset.py depack_meta and ``__getitem__``: nothing is clipped before the ratio.

    The data sets that are scored have ``zero_clip: false`` (options/base/dataset/test), so an input keeps its
    negatives; a reference is clipped at both ends.
    """
    normalised = (bayer_by_pattern(dn(raw), raw) - blacks(raw)) / (led_levels(raw) - blacks(raw))
    if ratio is None:
        return unit(normalised)
    given: Array = np.minimum(normalised * np.float32(ratio), np.float32(1))
    return given


# --- ratios -----------------------------------------------------------------------------------------------------------


def ratio_by_names(noisy: Path, reference: Path) -> float:
    """ELD dataset/sid_dataset.py compute_expo_ratio; SID test_Sony.py, LRD test_denoise_SID.py and LED alike.

    PMN has it in its lists (infos/SID_evaltest.info), where it is 100, 250 or 300.
    """
    short, long = (float(path.stem.split("_")[-1].removesuffix("s")) for path in (noisy, reference))
    return min(long / short, 300)


def exposure(path: Path) -> float:
    """ISO times seconds: ELD dataset/sid_dataset.py metainfo, which LED and LRD have too; they ``eval`` the tags."""
    with path.open("rb") as file:
        tags = exifread.process_file(file, details=False)
    return float(Fraction(str(tags["EXIF ISOSpeedRatings"])) * Fraction(str(tags["EXIF ExposureTime"])))


def ratio_by_exif(noisy: Path, reference: Path) -> float:
    """ELD dataset/sid_dataset.py ELDEvalDataset; LED scripts/data_preparation/eld_to_sid_structure.py."""
    return exposure(reference) / exposure(noisy)


def ratio_by_names_and_iso(noisy: Path, reference: Path) -> float:
    """LRD test_denoise_LRD.py denoise_test_pair, which has the ISO of the noisy frame from its list."""
    with noisy.open("rb") as file:
        iso = Fraction(str(exifread.process_file(file, details=False)["EXIF ISOSpeedRatings"]))
    short, long = (float(path.stem.split("_")[-1].removesuffix("s")) for path in (noisy, reference))
    return (100 * long) / (float(iso) * short)


def ratio_by_folder(noisy: Path, reference: Path) -> float:
    """PMN, branch TPAMI, get_dataset_infos.py get_IMX686_info_short: the folder's name."""
    del reference
    return float(noisy.parent.parent.name)


def ratio_by_number(noisy: Path, reference: Path) -> float:
    """PMN data_process/real_datasets.py ELD_Dataset: the nominal one, here from where the frame lies in its scene."""
    del reference
    return {4: 100.0, 0: 200.0}[int(re.findall(r"\d+", noisy.stem)[-1]) % 5]


# --- what is compared -------------------------------------------------------------------------------------------------


def corrected(output: Array, target: Array) -> tuple[Array, float]:
    """ELD models/ELD_model.py IlluminanceCorrect; PMN data_process/__init__.py and LED raw_denoising_utils.py copy it.

    The prediction is clamped first; what is multiplied is not clamped again, here.
    """
    p = np.clip(output.astype(np.float64), 0, 1)
    counted = target != 1
    inner, t = p[counted], target[counted].astype(np.float64)
    factor = float(np.dot(inner, t) / np.dot(inner, inner))
    return factor * p, factor


def as_image(packed: Array) -> Array:
    """(h, w, C) in [0, 255], not rounded: ELD models/ELD_model.py tensor2im; PMN utils.py, LRD SID_post_process.py."""
    return np.clip(np.transpose(packed.astype(np.float64), (1, 2, 0)) * 255.0, 0, 255)


def assessed(output: Array, target: Array, factor: float = math.nan) -> Score:
    """ELD util/index.py quality_assess; PMN utils.py, LRD raw_process/SID_post_process.py: scikit-image's defaults."""
    x, y = as_image(output), as_image(target)
    return Score(float(psnr_of(y, x, data_range=255)), float(ssim_of(y, x, data_range=255, channel_axis=-1)), factor)


def eld_score(output: Array, target: Array, reference: Path) -> Score:
    """ELD models/ELD_model.py eval with ``correct=True, crop=False``; PMN trainer_SID.py eval, which clamps twice."""
    del reference
    rescaled, factor = corrected(output, target)
    return assessed(rescaled, target, factor)


def uncorrected_score(output: Array, target: Array, reference: Path) -> Score:
    """The same without the corrector; LRD test_denoise_SID.py and test_denoise_ELD.py, where it is commented out.

    PMN trainer_LRID.py eval, branch TPAMI, which clamps to [0, 1] first.
    """
    del reference
    return assessed(output, target)


def centre(packed: Array, size: int = 512) -> Array:
    """ELD util/util.py crop_center, of packed pixels."""
    height, width = packed.shape[-2:]
    left, top = width // 2 - size // 2, height // 2 - size // 2
    return packed[:, top : top + size, left : left + size]


def eld_centre_score(output: Array, target: Array, reference: Path) -> Score:
    """ELD models/ELD_model.py eval with ``crop=True``: everything happens on the centre.

    The code crops the network's input; a prediction is of the whole frame, so that its output is cropped here.
    """
    return eld_score(centre(output), centre(target), reference)


def led_window() -> Array:
    """OpenCV's getGaussianKernel(11, 1.5), in LED led/metrics/psnr_ssim.py _ssim_pth."""
    taps = np.exp(-((np.arange(11) - 5.0) ** 2) / (2 * 1.5**2))
    window: Array = taps / taps.sum()
    return window


def led_smooth(image: Array) -> Array:
    """Its convolution with the window in both directions, without padding, (..., h - 10, w - 10)."""
    for axis in (-2, -1):
        image = np.lib.stride_tricks.sliding_window_view(image, 11, axis=axis) @ led_window()
    return image


def led_score(output: Array, target: Array, reference: Path) -> Score:
    """LED led/models/raw_base_model.py test, then led/metrics/psnr_ssim.py calculate_psnr_pt and calculate_ssim_pt.

    The factor is of the whole frame. Each metric cuts ``crop_border: 2`` off by itself
    (options/base/val_and_logger.yaml) and works on batches, ``calculate_metric_in_batch``, so what is above 1 stays.
    """
    del reference
    rescaled, factor = corrected(output, target)
    x, y = (image.astype(np.float64)[:, 2:-2, 2:-2] for image in (rescaled, target))
    psnr_db = 10 * math.log10(1 / (float(np.mean((x - y) ** 2)) + 1e-8))

    return Score(psnr_db, gaussian_ssim(x, y), factor)


def gaussian_ssim(x: Array, y: Array) -> float:
    """The same file's _ssim_pth, of values up to 255; YOND YOND_SIDD.py ssim has the same arithmetic of one plane."""
    x, y = 255 * x.astype(np.float64), 255 * y.astype(np.float64)
    c1, c2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2
    mx, my = led_smooth(x), led_smooth(y)
    vx, vy, cxy = led_smooth(x * x) - mx**2, led_smooth(y * y) - my**2, led_smooth(x * y) - mx * my
    structure = (2 * cxy + c2) / (vx + vy + c2)
    return float(np.mean((2 * mx * my + c1) / (mx**2 + my**2 + c1) * structure))


# --- sRGB by ELD's own pipeline ---------------------------------------------------------------------------------------

XYZ_TO_CAMERA, NEUTRAL = "Image Tag 0xC621", "Image Tag 0xC628"  # ColorMatrix1 and AsShotNeutral of a DNG

# LibRaw's xyz_rgb (src/tables/colordata.cpp)
SRGB_TO_XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)


def eld_colour(path: Path) -> tuple[Array, Array]:
    """White balance of R, G, B, G and the matrix from camera to sRGB: ELD util/process.py raw2rgb_postprocess.

    They come from LibRaw as float32, the matrix as ``rgb_camera_matrix``, which only a changed rawpy has. Here both are
    computed in float64 from the DNG's tags, as LibRaw does (src/utils/utils_dcraw.cpp cam_xyz_coeff), and held against
    LibRaw's. Of DNGs LibRaw leaves the second green's multiplier at 0; of the ARW files that the code was made for, it
    is the first's.
    """
    with path.open("rb") as file:
        tags = exifread.process_file(file, details=False)
    neutral, matrix = (
        np.array([float(Fraction(one.num, one.den)) for one in tags[name].values]) for name in (NEUTRAL, XYZ_TO_CAMERA)
    )
    gains = neutral[1] / neutral
    camera = matrix.reshape(3, 3) @ SRGB_TO_XYZ
    to_srgb = np.linalg.inv(camera / camera.sum(axis=1, keepdims=True))
    with rawpy.imread(str(path)) as raw:
        stated = np.array(raw.camera_whitebalance) / raw.camera_whitebalance[1]
        np.testing.assert_allclose(gains, stated[:3], rtol=1e-5)
        np.testing.assert_allclose(to_srgb, raw.color_matrix[:, :3], atol=1e-5)
    return np.array([*gains, gains[1]]), to_srgb


def eld_gamma(linear: Array) -> Array:
    """ELD util/process.py gamma_compression, up to the codes."""
    return np.maximum(linear, 1e-8) ** (1 / 2.2)


def eld_curve(irradiance: Array, brightness: Array) -> Response:
    """ELD util/process.py camera_response_function: each colour's own curve, straight between its points."""

    def shown(linear: Array) -> Array:
        return np.stack([np.interp(one, irradiance, curve) for one, curve in zip(linear, brightness, strict=True)])

    return shown


def eld_rendered(packed: Array, path: Path, response: Response = eld_gamma) -> Array:
    """ELD util/process.py process: codes of 8 bits, cut off and not rounded, over 255."""
    gains, to_srgb = eld_colour(path)
    balanced = np.clip(packed.astype(np.float64) * gains[:, None, None], 0.0, 1.0)
    rgb = np.stack([balanced[0], balanced[[1, 3]].mean(axis=0), balanced[2]])
    linear = np.clip(np.tensordot(to_srgb, rgb, axes=1), 0.0, 1.0)
    codes: Array = np.clip((response(linear).astype(np.float32) * np.float32(255)).astype(np.int32), 0, 255)
    return codes / 255.0


def eld_shown(output: Array, target: Array, reference: Path) -> tuple[Array, Array, float]:
    """Both renderings, (3, 512, 512) in [0, 1], and the factor.

    ELD models/ELD_model.py eval with ``stage_eval`` srgb: corrected in raw, then both are rendered.
    """
    target = centre(target)
    rescaled, factor = corrected(centre(output), target)
    return eld_rendered(rescaled, reference), eld_rendered(target, reference), factor


def eld_srgb_score(output: Array, target: Array, reference: Path) -> Score:
    """Its scores."""
    return assessed(*eld_shown(output, target, reference))


def eld_whole_srgb_score(output: Array, target: Array, reference: Path, response: Response = eld_gamma) -> Score:
    """The same of the whole frame, ``crop=False``."""
    rescaled, factor = corrected(output, target)
    return assessed(eld_rendered(rescaled, reference, response), eld_rendered(target, reference, response), factor)


def eld_rgb_score(output: Array, target: Array, reference: Path, response: Response = eld_gamma) -> Score:
    """ELD models/ELD_model.py eval with ``stage_out`` srgb: what the network makes, (3, h, w), is corrected in sRGB.

    The target is what dataset/sid_dataset.py renders of the packed reference, which is given here.
    """
    shown = eld_rendered(target, reference, response)
    rescaled, factor = corrected(output, shown)
    return assessed(rescaled, shown, factor)


# --- SID's own --------------------------------------------------------------------------------------------------------


def sid_codes(image: Array) -> NDArray[np.uint8]:
    """What SID test_Sony.py saves of an image in [0, 1]: scipy.misc.toimage with cmin 0, cmax 255."""
    codes: NDArray[np.uint8] = (np.clip(image.astype(np.float32) * np.float32(255), 0, 255) + 0.5).astype(np.uint8)
    return codes


@lru_cache(maxsize=1)
def sid_reference(path: Path) -> NDArray[np.uint8]:
    """(H, W, 3), as SID test_Sony.py and test_Fuji.py render and save a reference."""
    with rawpy.imread(str(path)) as raw:
        wide = raw.postprocess(use_camera_wb=True, half_size=False, no_auto_bright=True, output_bps=16)
    return sid_codes(wide / 65535.0)


def sid_score(codes: NDArray[np.uint8], path: Path) -> Score:
    """PSNR and SSIM of saved images, (H, W, 3), as MATLAB's psnr and ssim have them by default (SID issues 52 and 65).

    MATLAB takes an image in colour for a volume, smooths it with a Gaussian of sigma 1.5 in all three directions, with
    repeated edges, and has no correction for small samples. scikit-image's map of a volume that is continued by its own
    edges is that, inside.

    The reference is cut to the output's size, as test_Fuji.py does: X-Trans is packed in whole periods, so that an
    output may lack rows or columns.
    """
    height, width, _ = codes.shape
    x, y = codes.astype(np.float64), sid_reference(path)[:height, :width].astype(np.float64)
    wide = [np.pad(image, 5, mode="edge") for image in (y, x)]
    options = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False}
    _, full = ssim_of(*wide, data_range=255, full=True, **options)
    return Score(float(psnr_of(y, x, data_range=255)), float(full[5:-5, 5:-5, 5:-5].mean()))


# --- clips ------------------------------------------------------------------------------------------------------------


def eld_clip(output: Array, target: Array, *, correct: bool) -> tuple[list[Score], Array]:
    """Scores of a clip's frames, (T, C, h, w), against one still or each its own, and the frames as they are scored.

    ELD models/ELD_model.py IlluminanceCorrect.forward, which takes the frames one by one, and tensor2im with
    ``video=True``; util/index.py quality_assess, whose PSNR and SSIM are those of its frames.
    """
    targets = np.broadcast_to(target, output.shape)
    pairs = list(zip(output, targets, strict=True))
    rescaled = [corrected(frame, still) if correct else (frame, math.nan) for frame, still in pairs]
    shown = np.stack([np.clip(frame.astype(np.float64) * 255, 0, 255) / 255 for frame, _ in rescaled])
    return [assessed(frame, still, factor) for (frame, factor), still in zip(rescaled, targets, strict=True)], shown


def eld_grey(clip: Array) -> Array:
    """(T, h, w) of (T, C, h, w) in the order R, G, B, G, or R, G, B: ELD util/index.py raw2gray."""
    green = clip[:, 1::2].mean(axis=1)
    grey: Array = 0.2989 * clip[:, 0] + 0.5870 * green + 0.1140 * clip[:, 2]
    return grey


# --- the protocols ----------------------------------------------------------------------------------------------------

ELD = Route(bayer_by_pattern, eld_frame, partial(amplified, eld_frame), ratio_by_exif, eld_score)
ELD_PLAIN = Route(bayer_by_pattern, eld_frame, partial(amplified, eld_frame), ratio_by_exif, uncorrected_score)
LRD_FRAME = partial(eld_frame, white=None)


def on_sid(route: Route, score: Callable[[Array, Array, Path], Score] | None = None) -> Route:
    """The same on SID, where the ratio comes from the names."""
    return Route(route.arranged, route.target, route.given, ratio_by_names, score or route.score)


PMN = Route(bayer_in_place, pmn_frame, pmn_frame, ratio_by_number, eld_score)
SONY = Route(bayer_in_place, sony_frame, sony_frame, ratio_by_number, eld_score)
LED = Route(bayer_by_pattern, led_frame, led_frame, ratio_by_exif, led_score)
LRD = Route(bayer_by_pattern, LRD_FRAME, partial(amplified, LRD_FRAME), ratio_by_exif, uncorrected_score)

BAYER = {
    "raw": Route(bayer_by_pattern, LRD_FRAME, partial(amplified, LRD_FRAME), ratio_by_exif, eld_score),
    "eld": ELD,
    "eld-uncorrected": ELD_PLAIN,
    "sid": on_sid(ELD),
    "sid-uncorrected": on_sid(ELD_PLAIN),
    "eld-cvpr20": on_sid(ELD, eld_centre_score),
    "sid-tpami": on_sid(ELD, eld_centre_score),
    "sid-srgb": on_sid(ELD, eld_srgb_score),
    "eld-srgb": Route(ELD.arranged, ELD.target, ELD.given, ELD.ratio, eld_whole_srgb_score),
    "pmn-sid": on_sid(PMN),
    "sony-sid": on_sid(SONY),
    "pmn-eld": PMN,
    "sony-eld": SONY,
    "sony-lrid": Route(bayer_in_place, lrid_frame, sony_lrid_input, ratio_by_folder, uncorrected_score),
    "pmn-lrid": Route(bayer_in_place, lrid_frame, lrid_frame, ratio_by_folder, uncorrected_score),
    "two-shots-lrid": Route(bayer_in_place, lrid_frame, lrid_frame, ratio_by_folder, eld_score),
    "led-sid": on_sid(LED),
    "led-eld": LED,
    "lrd-sid": on_sid(LRD),
    "lrd-eld": LRD,
    "lrd-lrd": Route(
        bayer_by_rows, lrd_own_frame, partial(amplified, lrd_own_frame), ratio_by_names_and_iso, uncorrected_score
    ),
}
"""Protocols that score packed raw values, on Bayer sensors."""

XTRANS = {
    name: Route(xtrans, eld_xtrans_frame, partial(amplified, eld_xtrans_frame), ratio_by_names, score)
    for name, score in (("sid", eld_score), ("sid-uncorrected", uncorrected_score))
}
"""Those that are for X-Trans too."""

RENDERED = {"sid2018": sid_score, **dict.fromkeys(("sid-raw2rgb", "sid-rgb2rgb"), eld_rgb_score)}
RENDERED |= {"eld-raw2rgb": eld_rgb_score, "eld-rgb2rgb": eld_rgb_score}
"""Protocols that score renderings."""

CLIPS = dict.fromkeys(("drv-rgb", "drv-raw", "sequences"), True)
CLIPS |= dict.fromkeys(("drv-rgb-uncorrected", "drv-raw-uncorrected"), False)
"""Protocols of clips, and whether each frame is corrected. ELD's code for video is not public but for its metrics."""
