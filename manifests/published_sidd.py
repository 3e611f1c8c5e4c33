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


# The blocks' arrays, whose names are those of their files; below them a file for each, counted from 0 as code indexes.
# DenoiseRaw.m cuts block (i, b) out of what MATLAB loads of the i-th folder by name: so the order is that of the
# numbers, and the blocks lie as that does (CFAS).
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


_CITATION = (
    "A. Abdelhamed, S. Lin and M. S. Brown, A High-Quality Denoising Dataset for Smartphone Cameras, IEEE/CVF "
    "Conference on Computer Vision and Pattern Recognition, 2018"
)
_HOMEPAGE = "https://abdokamel.github.io/sidd/"


def _mosaics(paths: str) -> tuple[MosaicFacts, ...]:
    return tuple(
        MosaicFacts(paths, cfa, (0.0,), 1.0, tuple(name for phone, name in CAMERAS.items() if CFAS[phone] == cfa))
        for cfa in sorted(set(CFAS.values()))
    )


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
        citation=_CITATION,
        licence="see the homepage: no text that eldata was made from states it",
        homepage=_HOMEPAGE,
        cfa="bayer",
        cameras={name: CameraCard(()) for name in CAMERAS.values()},
        counts=dict(sorted(Counter(str(record.role) for record in records).items())),
        scenes_shared=True,  # ten scenes, of which each phone photographed most
        downloads=(
            Download(_HOMEPAGE, notes="the authors' page; their older one is offline at times"),
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
            "The validation and benchmark blocks are a set of their own: sidd-blocks.",
        ),
        unknown=(
            (
                "The colour filter array of each frame stands in its METADATA file; no public text lists them all. "
                "Several loaders have one for each phone: RGGB for the iPhone, GRBG for the Galaxy, BGGR for the "
                "others. YOND's has GBRG for the Galaxy's blocks."
            ),
            "The camera model of each file, which its METADATA file alone names: SM-G925I of a Galaxy's.",
            "How the small set (one pair of each instance) names its raw files.",
        ),
        protocol="sfrn-sidd",
        mosaics=_mosaics("*.MAT"),
    )
    return card, records


_BLIND2UNBLIND = "Blind2Unblind repository (zejinwang/Blind2Unblind), commit efb6f82, test_sidd_b2u.py"
_YOND = "YOND repository (fenghansen/YOND_public), commit a0b5d27"


def published_blocks(instances: Iterable[Instance]) -> tuple[Card, tuple[FrameRecord, ...]]:
    """Return card and rows of the published blocks: validation and benchmark, raw."""
    records = block_records(instances)
    card = Card(
        name="sidd-blocks",
        title="Smartphone Image Denoising Dataset (SIDD), validation and benchmark blocks, raw",
        version="1.0",
        folder="SIDD",
        citation=_CITATION,
        licence="see the homepage: no text that eldata was made from states it",
        homepage=_HOMEPAGE,
        cfa="bayer",
        cameras={name: CameraCard(()) for name in CAMERAS.values()},
        counts=dict(sorted(Counter(str(record.role) for record in records).items())),
        scenes_shared=True,
        downloads=(
            Download(
                _HOMEPAGE,
                notes="ValidationNoisyBlocksRaw.mat, ValidationGtBlocksRaw.mat, BenchmarkNoisyBlocksRaw.mat: unpack "
                "each with eldata download sidd-blocks --from FILE.mat",
            ),
        ),
        subsets=(
            Subset(
                name="validation",
                title="32 blocks of each of 40 scene instances",
                source=f"{_YOND}, YOND_SIDD.py; {_BLIND2UNBLIND}",
                pairs=IMAGES * BLOCKS,
                splits=("val",),
            ),
            Subset(
                name="benchmark",
                title="noisy blocks alone, of other frames: their references are kept by the publisher",
                source="the authors' SIDD_Benchmark_Code, DenoiseRaw.m",
                pairs=IMAGES * BLOCKS,
                splits=("test",),
            ),
        ),
        known_defects=(
            (
                "Public texts contradict each other on the Galaxy's blocks: GRBG by the metadata beside the frames "
                "that they were cut from and the authors' own code, as on this card; GBRG by YOND (in place of the "
                "metadata: utils/sidd_utils.py) and others with its file. R and B change places between the two, which "
                "no score of these blocks sees, and a network does. For the other, copy manifest and card."
            ),
            "Raws of the Galaxy S6 were clipped at black by the phone (README of SIDD-CC on Hugging Face).",
            "No checksums were published: eldata lock records those of your copy.",
        ),
        sources=(
            (
                f"{_YOND}: data_process/yond_datasets.py (files, arrays, the order of the folders), "
                "utils/sidd_utils.py (CFA), YOND_SIDD.py (scores), its log (the 40 instances)"
            ),
            f"{_BLIND2UNBLIND}: arrays, scores; benchmark_sidd_b2u.py: what is submitted",
            "The authors' SIDD_Benchmark_Code, DenoiseRaw.m, in public copies: what blocks are cut from, their order",
            "swz30/CycleISP, commit dc64f64, test_sidd_raw.py, utils/image_utils.py; its issue 13 asks for the CFA",
        ),
        contents=(
            "1280 pairs of 256 x 256 pixels, 32 blocks of each of the 40 scene instances that the medium set lacks, "
            "and 1280 noisy blocks without references. Three files in MATLAB's format 5 hold one array each, (40, 32, "
            "256, 256); eldata download --from makes <array>/<image>_<block>.npy of it, counted from 0"
        ),
        levels="already normalised to [0, 1]: black 0, white 1",
        scored=(
            (
                f"{_YOND}, YOND_SIDD.py, and {_BLIND2UNBLIND}, score alike: each block as a grey image, PSNR (data "
                "range 1) and SSIM (Gaussian window 11 x 11, sigma 1.5, valid region), prediction clipped to [0, 1], "
                "means over all blocks: protocol yond-sidd."
            ),
            (
                "CycleISP's test_sidd_raw.py has that PSNR alone, of blocks that its authors packed, and leaves out "
                "those that are predicted exactly."
            ),
            (
                "Benchmark: eldata predict --subset benchmark writes predictions, which the publisher scores: "
                "DenoisedBlocksRaw, (40, 32, 256, 256), in SubmitRaw.mat (Blind2Unblind; YOND calls it results)."
            ),
        ),
        unknown=(
            "The camera model of each phone: as of the medium set.",
            "Which frame of each instance the validation blocks were cut from; the benchmark's are of NOISY_RAW_010.",
            "How the publisher's benchmark scores: its code was not published.",
        ),
        protocol="yond-sidd",
        mosaics=_mosaics("*.npy"),
    )
    return card, records
