"""The protocols that come with the package, each with the code or paper that it follows.

What a source leaves open stands in its text. Facts of the repositories are of the commits named there.
"""

from __future__ import annotations

from dataclasses import replace

from eldata.protocols.clips import CLIP_PROTOCOLS
from eldata.protocols.protocol import Protocol

_TPAMI = "K. Wei et al., Physics-based Noise Modeling for Extreme Low-light Photography, TPAMI 2021"
_CVPR = "K. Wei et al., A Physics-based Noise Formation Model for Extreme Low-light Raw Denoising, CVPR 2020"
_CODE = "models/ELD_model.py, util/index.py"
_UNCORRECTED = "; without the illuminance correction"
_SID_RATIOS = (100, 250, 300)

_ELD = Protocol(
    name="eld",
    title="ELD as published: packed raw, full frame, white level 16383, one scalar per image",
    source=f"{_TPAMI}, results on the ELD dataset; ELD repository, commit 53d5408, test_ELD.py, {_CODE}",
    dataset="eld",
    ratios=(100, 200),
    levels="published",
    reference_clip="both",
    region="full",
    rescaling="scalar",
)
_SID = Protocol(
    name="sid",
    title="SID scored as ELD is: packed raw, full frame, white level 16383, one scalar per image",
    source=(
        f"{_TPAMI}, results on SID; ELD repository, commit 53d5408, test_SID.py, {_CODE}; on the whole frame, as the "
        "PMN repository reports it (commit d207d3e, README), where the ELD paper has the centre 512 x 512"
    ),
    dataset="sid",
    ratios=_SID_RATIOS,
    levels="published",
    reference_clip="both",
    region="full",
    rescaling="scalar",
    amplification="nominal",
)
_CROP_FIRST = (
    "The code crops the input before the network and scores what comes out; here the whole frame's prediction is "
    "cropped, so values near the crop's edge may differ"
)
_ELD_CVPR20 = replace(
    _SID,
    name="eld-cvpr20",
    title="SID as in ELD's CVPR paper: 15 indoor scenes, packed centre 512 x 512, one scalar per image",
    source=(
        f"{_CVPR}, results on SID; ELD repository, commit 53d5408, test_SID.py (crop=True), SID_Sony_15_paired.txt, "
        f"{_CODE}. {_CROP_FIRST}. The paper's results on the ELD dataset are of the full frame: protocol eld. Its "
        "tables themselves were not compared"
    ),
    dataset="sid-sony",
    subset="indoor-15",
    region="centre-512",
)
_SID_TPAMI = replace(
    _ELD_CVPR20,
    name="sid-tpami",
    title="SID as in ELD's TPAMI paper: 129 pairs, packed centre 512 x 512, one scalar per image",
    source=(
        f"{_TPAMI}, results on SID Sony: all 129 pairs (ELD repository, issue 44) at the centre (PMN repository, "
        f"commit d207d3e, README); ELD repository, commit 53d5408, {_CODE}. {_CROP_FIRST}. Its tables themselves were "
        "not compared"
    ),
    subset="eval-first",
)

_PMN_SOURCE = (
    "H. Feng et al., Learnability Enhancement for Low-light Raw Denoising: Where Paired Real Data Meets Noise "
    "Modeling, ACM MM 2022; PMN repository, commit d207d3e, trainer_SID.py, README. The README gives numbers with the "
    "correction (these) and without. Baselines get an input clipped to [0, 1]; the authors' own model one that keeps "
    "its negatives and has dark shading subtracted, and its correction sees a reference that keeps them too"
)
_PMN_SID = replace(
    _SID,
    name="pmn-sid",
    family="pmn",
    title="SID as PMN reports it: 129 pairs, full frame, one scalar per image",
    source=_PMN_SOURCE,
    dataset="sid-sony",
    subset="eval-first",
)
_PMN_ELD = replace(
    _ELD,
    name="pmn-eld",
    family="pmn",
    title="ELD as PMN reports it: SonyA7S2 alone, full frame, one scalar per image",
    source=_PMN_SOURCE,
    cameras=("SonyA7S2",),
)

_LED_SOURCE = (
    "X. Jin et al., Lighting Every Darkness in Two Pairs, ICCV 2023; LED repository, commit ee3d372, "
    "led/data/paired_raw_dataset.py (levels, clips), led/models/raw_denoising_utils.py (correction on the clamped "
    "prediction, not clamped again), led/metrics/psnr_ssim.py (the functions ending in _pt), "
    "options/base/val_and_logger.yaml (crop_border 2). The input keeps its negatives, the reference does not. The "
    "base options have the correction off, the experiments' turn it on. White is LibRaw's per-channel level; where "
    "LibRaw has none, its white_level, as led/data/raw_utils.py reads images, and the result says so"
)
_LED = replace(
    _SID,
    family="led",
    levels="metadata-per-channel",
    region="border-2",
    prediction_clamp="before",
    mse_offset=1e-8,
    ssim_window="gaussian-11",
    ssim_covariance="population",
    input_clip="upper",
)
_LED_SID = replace(
    _LED,
    name="led-sid",
    title="SID as LED scores it: test scenes, all but 2 packed pixels at the edges, own white levels, Gaussian SSIM",
    source=(
        f"{_LED_SOURCE}. Which pairs its lists hold (valid_100.txt and so on) was not seen: here the test scenes, the "
        "first shot of each burst"
    ),
    dataset="sid-sony",
    subset="test-first",
)
_LED_ELD = replace(
    _LED,
    name="led-eld",
    title="ELD as LED scores it: scenes 3 to 10 of two cameras, all but 2 packed pixels at the edges, Gaussian SSIM",
    source=(
        f"{_LED_SOURCE}. Scenes 1 and 2 are for training. It has lists of the factors 1 and 10 too; 100 and 200 are "
        "those that others report"
    ),
    dataset="eld",
    ratios=(100, 200),
    cameras=("SonyA7S2", "NikonD850"),
    scenes=tuple(f"scene-{number}" for number in range(3, 11)),
    amplification="metadata",
)

_LRD_SOURCE = (
    "F. Zhang et al., Towards General Low-Light Raw Noise Synthesis and Modeling, ICCV 2023; LRD repository, commit "
    "451f079, test_denoise_SID.py and test_denoise_ELD.py (the correction is commented out), "
    "datasets/Denoise_dataset.py (white is LibRaw's white_level). Its input has the dark shading of the PMN "
    "repository subtracted before it is clipped, which input_clip does not say"
)
_LRD_SID = replace(
    _PMN_SID,
    name="lrd-sid",
    family="lrd",
    title="SID as LRD scores it: 129 pairs, full frame, the file's white level, no scalar",
    source=_LRD_SOURCE,
    levels="metadata",
    rescaling="none",
)
_LRD_ELD = replace(
    _PMN_ELD,
    name="lrd-eld",
    family="lrd",
    title="ELD as LRD scores it: SonyA7S2 alone, full frame, the file's white level, no scalar",
    source=_LRD_SOURCE,
    levels="metadata",
    rescaling="none",
)

_SID_SRGB = replace(
    _SID_TPAMI,
    name="sid-srgb",
    title="SID raw predictions in sRGB as the ELD code has it: 129 pairs, packed centre 512 x 512, 8 bits, one scalar",
    source=(
        f"ELD repository, commit 53d5408, {_CODE}, util/process.py with stage_eval = srgb: corrected in raw, then "
        "rendered with the reference's white balance and matrix, gamma 2.2, truncated to 8 bits. The paper's sRGB "
        "tables were made with a response curve measured on a Sony A7S2 and name neither pairs nor region; the code's "
        f"default is gamma, pairs and region are those of sid-tpami. {_CROP_FIRST}"
    ),
    space="srgb",
    rendering="eld-isp",
    rounding="8-bit-truncated",
    prediction_clamp="before",
)

_SID2018 = replace(
    _SID,
    name="sid2018",
    title="SID's own evaluation: 8-bit sRGB renderings by LibRaw, test scenes, no scalar, MATLAB's SSIM",
    source=(
        "C. Chen et al., Learning to See in the Dark, CVPR 2018; SID repository, commit 0448b58, test_Sony.py and "
        "test_Fuji.py: renderings by LibRaw (camera white balance, no automatic brightening, 16 bits) and outputs "
        "saved as 8-bit PNG, scored in MATLAB with default parameters (its issue 52) on RGB images (issue 65). "
        "MATLAB's ssim takes an RGB image for a volume. The MATLAB code was not published: whether its version and "
        "call did exactly this is open. LibRaw's version moves the reference, too"
    ),
    subset="test-first",
    levels="metadata",
    rescaling="none",
    rounding="8-bit",
    space="srgb",
    rendering="libraw",
    ssim_window="gaussian-11-volume",
    ssim_covariance="population",
)

PROTOCOLS: dict[str, Protocol] = {
    protocol.name: protocol
    for protocol in (
        _ELD,
        replace(
            _ELD,
            name="eld-uncorrected",
            title="ELD without the scalar: the prediction's own brightness counts",
            source=_ELD.source + _UNCORRECTED,
            rescaling="none",
        ),
        _SID,
        replace(
            _SID,
            name="sid-uncorrected",
            title="SID without the scalar: the prediction's own brightness counts",
            source=_SID.source + _UNCORRECTED,
            rescaling="none",
        ),
        _ELD_CVPR20,
        _SID_TPAMI,
        _PMN_SID,
        _PMN_ELD,
        _LED_SID,
        _LED_ELD,
        _LRD_SID,
        _LRD_ELD,
        _SID_SRGB,
        _SID2018,
        *CLIP_PROTOCOLS,
    )
}
"""Those of images and those of clips by name; a dataset's default comes first."""

FAMILIES: tuple[str, ...] = tuple(dict.fromkeys(p.family for p in PROTOCOLS.values() if p.family))
"""Names that stand for one protocol per dataset."""
