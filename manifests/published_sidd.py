"""The published raw files of the Smartphone Image Denoising Dataset (SIDD): the medium set, and the blocks.

A scene instance is a folder, ``0001_001_S6_00100_00060_3200_L``: its number, its scene, the phone, the ISO, the shutter
(1/60 s), the colour temperature of the light and its brightness. It holds two noisy frames, ``0001_NOISY_RAW_010.MAT``
and ``.._011.MAT``, and the same of ``GT_RAW`` and ``METADATA_RAW``. Of the 40 instances that the medium set lacks
there are blocks, in three arrays of MATLAB's, (40, 32, 256, 256): eldata lists each block as the file that it unpacks.

Sources: A. Abdelhamed, S. Lin and M. S. Brown, "A High-Quality Denoising Dataset for Smartphone Cameras", CVPR 2018;
the ReadMe of the medium set and the names of its folders, in the repository
yilmazdoga/deep-residual-autoencoder-for-real-image-denoising; code that reads the raw files, in
zhangyi-3/Noise-Synthesis (SFRN), BorealisAI/noise_flow, fenghansen/YOND_public and zejinwang/Blind2Unblind; the
authors' own code, in AbdoKamel/simple-camera-pipeline and AbdoKamel/sidd-ground-truth-image-estimation, and their
benchmark's (SIDD_Benchmark_Code, DenoiseRaw.m). The 40 instances (``facts/sidd-blocks.csv``) are those of YOND's log
(logs/log_YOND_SIDD_simple+full_pre_grumix_iter.log): with the medium set's they are the numbers 1 to 200.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

from eldata.base.fields import TextFile
from eldata.errors import ManifestError
from eldata.records import FrameRecord

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

CAMERAS = {"GP": "GooglePixel", "IP": "iPhone7", "S6": "GalaxyS6Edge", "N6": "Nexus6", "G4": "LGG4"}
FRAMES = ("010", "011")

# The colour filter arrays on the cards are of arrays as MATLAB shows them, which is how eldata reads them. The authors'
# MATLAB code reads a DNG as it lies, normalises it and saves that (LoadRawImages.m), and renders what it saved by the
# pattern that the DNG states (matlab/demo.m), without turning it. 0001_METADATA_RAW_010.MAT, of the Galaxy, states
# GRBG, 3000 rows, 5328 columns. h5py has columns first: there the Galaxy's is GBRG, and the others', symmetric, are
# what they were. Loaders that transpose what h5py gives have these; SFRN, Noise Flow and Noise2NoiseFlow do not
# transpose and keep the pattern.
FOLDER = "SIDD_Medium_Raw/Data"

_INSTANCE = re.compile(r"(\d{4})_(\d{3})_(GP|IP|S6|N6|G4)_(\d{5})_(\d{5})_\d{4}_[LNH]")


@dataclass(frozen=True, slots=True)
class Instance:
    """A scene instance: its folder's ``name``, and what that says."""

    name: str
    number: str
    scene: str
    phone: str
    iso: Fraction
    exposure_s: Fraction


def instance_of(name: str) -> Instance:
    """Return what the name of an instance's folder says; ManifestError if it has another form."""
    match = _INSTANCE.fullmatch(name)
    if match is None:
        raise ManifestError(f"not the name of a scene instance of SIDD: {name!r}")
    return Instance(name, match[1], match[2], match[3], Fraction(match[4]), 1 / Fraction(match[5]))


def load_instances(path: Path) -> tuple[Instance, ...]:
    """Read the table of instances: their names."""
    return tuple(instance_of(row.text("instance")) for row in TextFile(path, ManifestError).rows(("instance",)))


def sidd_records(instances: Iterable[Instance]) -> tuple[FrameRecord, ...]:
    """Return the rows of the set, sorted by path."""
    rows = []
    for one in instances:
        shot = (CAMERAS[one.phone], one.scene, "train", one.iso, one.exposure_s)
        for frame in FRAMES:
            reference, noisy = (f"{FOLDER}/{one.name}/{one.number}_{kind}_RAW_{frame}.MAT" for kind in ("GT", "NOISY"))
            rows.append(FrameRecord(reference, "reference", *shot))
            rows.append(FrameRecord(noisy, "noisy", *shot, ratio=Fraction(1), reference=reference))
    return tuple(sorted(rows, key=lambda row: row.path))


# The blocks' arrays, whose names are those of their files; below them a file for each, counted from 0 as code indexes.
# DenoiseRaw.m cuts block (i, b) out of what MATLAB loads of the i-th folder by name: so the order is that of the
# numbers, and the blocks lie as the frames do.
IMAGES, BLOCKS = 40, 32
VALIDATION, BENCHMARK = "SIDD_Validation_Raw", "SIDD_Benchmark_Raw"


def block_records(instances: Iterable[Instance]) -> tuple[FrameRecord, ...]:
    """Return the rows of the blocks, sorted by path: validation in pairs, the benchmark's noisy ones alone."""
    rows = []
    for image, one in enumerate(instances):
        for block in range(BLOCKS):
            name = f"{image:02}_{block:02}.npy"
            camera, shot = CAMERAS[one.phone], (one.iso, one.exposure_s)
            truth = f"{VALIDATION}/ValidationGtBlocksRaw/{name}"
            noisy = f"{VALIDATION}/ValidationNoisyBlocksRaw/{name}"
            bench = f"{BENCHMARK}/BenchmarkNoisyBlocksRaw/{name}"
            rows.append(FrameRecord(truth, "reference", camera, one.scene, "val", *shot))
            rows.append(FrameRecord(noisy, "noisy", camera, one.scene, "val", *shot, Fraction(1), truth))
            rows.append(FrameRecord(bench, "noisy", camera, one.scene, "test", *shot, Fraction(1)))
    return tuple(sorted(rows, key=lambda row: row.path))
