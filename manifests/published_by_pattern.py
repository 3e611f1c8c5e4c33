"""Rows of published sets whose files follow one pattern: two for each scene, which stand for all of its frames.

Of none of them a public text lists every file (a folder, the ratios, or the scenes); the published code takes what it
finds. :mod:`eldata.manifest.patterns` has how such rows are filled in from a copy.

recrvd
    H. Yue et al., "RViDeformer: Efficient Raw Video Denoising Transformer with a Larger Benchmark Dataset", TCSVT 2025;
    the RViDeformer repository's dataset.py, test_ReCRVD.py, train.txt and test.txt: frames 1 to 25, ten shots of each.
llrvd
    Y. Fu et al., "Low-light Raw Video Denoising with a High-quality Realistic Motion Dataset", TMM 2022; the BRVE
    repository's README, llrvd_dataset.py and data_list: an array of a clip's frames, the ratio in the folder's name.
pmrid
    Y. Wang et al., "Practical Deep Raw Image Denoising on Mobile Devices", ECCV 2020; the PMRID repository's README and
    benchmark.py.
raw-denoise
    TWSLA/raw_denoise on Hugging Face, README of revision e08e2a6: names are scene, gain and exposure.
"""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING

from eldata.manifest.pairs import NOMINAL_RATIO
from eldata.records import FrameRecord

if TYPE_CHECKING:
    from collections.abc import Mapping

# Camera, paths of references and of noisy frames, and the ratio, if no folder names it.
PATTERNS = {
    "recrvd": (
        "ReCRVD",
        "wb_scene_clean_postprocessed/<scene>/wb_clean_postprocessed_{frame}.tiff",
        "wb_scene_noisy/<scene>/*/wb_noisy_{frame}_{shot}.tiff",
        Fraction(1),
    ),
    "llrvd": (
        "LLRVD",
        "ratio_gt/<scene>/gt.npy#{frame}",
        "ratio_noisy_all/<scene>/{ratio}/lq.npy#{frame}",
        None,
    ),
    "pmrid": ("Reno10x", "{scene}/{light}/{case}/gt.raw", "{scene}/{light}/{case}/input.raw", Fraction(1)),
    "raw-denoise": (
        "IMX678",
        "RAW/gt/{scene}_{gain}_{exposure}_gt.npy",
        "RAW/noisy/{scene}_{gain}_{exposure}_noisy.npy",
        Fraction(1),
    ),
}


def pattern_records(name: str, split_of: Mapping[str, str]) -> tuple[FrameRecord, ...]:
    """Return the rows of a set, sorted by path, for the splits of its scenes; of a scene "" its path has the name."""
    camera, *paths, ratio = PATTERNS[name]
    rows = []
    for scene, split in split_of.items():
        reference, noisy = (path.replace("<scene>", scene) for path in paths)
        rows.append(FrameRecord(reference, "reference", camera, scene, split))
        frames = FrameRecord(
            noisy, "noisy", camera, scene, split, ratio=ratio, reference=reference, flags=(NOMINAL_RATIO,)
        )
        rows.append(frames)
    return tuple(sorted(rows, key=lambda row: row.path))
