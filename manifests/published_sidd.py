"""The published raw files of the medium Smartphone Image Denoising Dataset (SIDD): its instances, rows and card.

A scene instance is a folder, ``0001_001_S6_00100_00060_3200_L``: its number, its scene, the phone, the ISO, the shutter
(1/60 s), the colour temperature of the light and its brightness. It holds two noisy frames, ``0001_NOISY_RAW_010.MAT``
and ``.._011.MAT``, and the same of ``GT_RAW`` and ``METADATA_RAW``.

Sources: A. Abdelhamed, S. Lin and M. S. Brown, "A High-Quality Denoising Dataset for Smartphone Cameras", CVPR 2018;
the ReadMe of the medium set and the names of its folders, in the repository
yilmazdoga/deep-residual-autoencoder-for-real-image-denoising; code that reads the raw files, in
zhangyi-3/Noise-Synthesis (SFRN), BorealisAI/noise_flow and fenghansen/YOND_public; the authors' own code, in
AbdoKamel/simple-camera-pipeline and AbdoKamel/sidd-ground-truth-image-estimation.
"""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

from eldata.base.fields import TextFile
from eldata.errors import ManifestError
from eldata.manifest.card import CameraCard, Card, Download, Subset
from eldata.raw.stated import MosaicFacts
from eldata.records import FrameRecord

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

CAMERAS = {"GP": "GooglePixel", "IP": "iPhone7", "S6": "GalaxyS6Edge", "N6": "Nexus6", "G4": "LGG4"}
FRAMES = ("010", "011")

# Of arrays as MATLAB shows them, which is how eldata reads them. The authors' MATLAB code reads a DNG as it lies,
# normalises it and saves that (LoadRawImages.m), and renders what it saved by the pattern that the DNG states
# (matlab/demo.m), without turning it. 0001_METADATA_RAW_010.MAT, of the Galaxy, states GRBG, 3000 rows, 5328 columns.
# h5py has columns first: there the Galaxy's is GBRG, and the others', symmetric, are what they were. Loaders that
# transpose what h5py gives have these; SFRN, Noise Flow and Noise2NoiseFlow do not transpose and keep the pattern.
CFAS = {"GP": "BGGR", "IP": "RGGB", "S6": "GRBG", "N6": "BGGR", "G4": "BGGR"}
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


_SFRN = "SFRN repository (zhangyi-3/Noise-Synthesis), commit ee3ae27, test.py"


def published_sidd(instances: Iterable[Instance]) -> tuple[Card, tuple[FrameRecord, ...]]:
    """Return card and rows of the published set: the medium one, raw."""
    instances = tuple(instances)
    records = sidd_records(instances)
    of_sfrn = [
        Subset(
            name=f"sfrn-{phone.lower()}",
            title=f"{CAMERAS[phone]}, scenes 2, 3 and 5, as SFRN tests",
            source=f"{_SFRN}",
            pairs=len(FRAMES) * sum(one.phone == phone and one.scene in ("002", "003", "005") for one in instances),
            scenes=("002", "003", "005"),
            paths=f"*_{phone}_*",
        )
        for phone in ("S6", "GP", "IP")
    ]
    card = Card(
        name="sidd",
        title="Smartphone Image Denoising Dataset (SIDD), medium, raw",
        version="1.0",
        folder="SIDD",
        citation=(
            "A. Abdelhamed, S. Lin and M. S. Brown, A High-Quality Denoising Dataset for Smartphone Cameras, IEEE/CVF "
            "Conference on Computer Vision and Pattern Recognition, 2018"
        ),
        licence="see the homepage: no text that eldata was made from states it",
        homepage="https://abdokamel.github.io/sidd/",
        cfa="bayer",
        cameras={name: CameraCard(()) for name in CAMERAS.values()},
        counts=dict(sorted(Counter(str(record.role) for record in records).items())),
        scenes_shared=True,  # ten scenes, of which each phone photographed most
        downloads=(
            Download(
                "https://abdokamel.github.io/sidd/", notes="the authors' page; their older one is offline at times"
            ),
            Download("https://bit.ly/2kHT7Yr", notes="SIDD_Medium_Raw, according to the README of Noise Flow"),
        ),
        subsets=tuple(of_sfrn),
        known_defects=(
            (
                "The files are MATLAB's, which stores columns first: read with h5py, arrays come out transposed, and "
                "with them the colour filter array (GRBG becomes GBRG). eldata reads them as MATLAB does; code that "
                "does not (SFRN, Noise Flow) takes the Galaxy's R for B, and shapes and predictions are transposed."
            ),
            (
                "Raws of the Galaxy S6 were clipped at black by the phone, which biases averages of frames; 34 of the "
                "200 scene instances are no longer served (README of SIDD-CC on Hugging Face, MhdMohammadi)."
            ),
            "METADATA_RAW files and the set's text files are not listed.",
            "No checksums were published: eldata lock records those of your copy.",
        ),
        sources=(
            (
                "ReadMe of the medium set and lists of its folders "
                "(yilmazdoga/deep-residual-autoencoder-for-real-image-denoising, commit ff5433c, "
                "datasets/SIDD_Dataset/SIDD_Medium_sRGB): instances, what their names say, counts"
            ),
            f"{_SFRN}, utils.py: names of the raw files, their form, scores",
            "Noise Flow repository (BorealisAI/noise_flow), commit 48d1e07, sidd/: form of the files, metadata",
            "YOND repository (fenghansen/YOND_public), commit a0b5d27: blocks, folders, colour filter arrays",
            (
                "The authors' code (AbdoKamel/simple-camera-pipeline, commit 26b4041, with the metadata of a Galaxy's "
                "frame; AbdoKamel/sidd-ground-truth-image-estimation, commit ede85b0): how the arrays lie"
            ),
        ),
        contents=(
            "320 pairs: 160 scene instances of ten scenes, two frames each, of five phones; mosaics in MATLAB's v7.3 "
            "format (HDF5, dataset x), normalised. Ground truth was estimated from bursts of the same exposure"
        ),
        levels="already normalised to [0, 1]: black 0, white 1",
        scored=(
            (
                f"{_SFRN}: both frames of scenes 2, 3 and 5 of one phone (subsets sfrn-s6, sfrn-gp, sfrn-ip), PSNR "
                "alone, of the whole mosaic, data range 1, prediction clipped to [0, 1], no scalar: protocol sfrn-sidd."
            ),
            (
                "Validation and benchmark are blocks, not frames: ValidationNoisyBlocksRaw.mat, "
                "ValidationGtBlocksRaw.mat and BenchmarkNoisyBlocksRaw.mat hold 40 x 32 blocks of 256 x 256, of the 40 "
                "scene instances that the medium set lacks, by number; the benchmark's references are not public. "
                "YOND's code means PSNR (data range 1) and an SSIM of its own over all blocks. No "
                "protocol of eldata's: SSIM there is of the mosaic, not of packed channels."
            ),
        ),
        unknown=(
            (
                "The colour filter array of each frame stands in its METADATA file; no public text lists them all. "
                "Several loaders have one for each phone: RGGB for the iPhone, GRBG for the Galaxy, BGGR for the "
                "others. YOND's has GBRG for the Galaxy's blocks."
            ),
            "The camera model of each file, which its METADATA file alone names: SM-G925I of a Galaxy's.",
            (
                "Which frame of each instance the validation blocks were cut from, and how the small set (one pair of "
                "each instance) names its raw files."
            ),
        ),
        protocol="sfrn-sidd",
        mosaics=tuple(
            MosaicFacts("*.MAT", cfa, (0.0,), 1.0, tuple(name for phone, name in CAMERAS.items() if CFAS[phone] == cfa))
            for cfa in sorted(set(CFAS.values()))
        ),
    )
    return card, records
