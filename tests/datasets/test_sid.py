"""SIDDataset: samples equal to a plain route bit for bit for both cameras, choices of pairs, and clear refusals."""

from __future__ import annotations

import shutil
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eldata import SIDDataset
from eldata.datasets.items import Sample
from eldata.errors import ArgumentError
from eldata.manifest.catalogue import shipped_manifest
from eldata.records import PairRecord
from tests.cases import in_one_test
from tests.datasets.comparing import pack_plainly, same_bits
from tests.sid_tree import SENSORS, frames_of, write_frames
from tests.trees import scale_exposure

CAMERAS = ("sony", "fuji")

# Validation and test scenes at all ratios, and a misaligned one.
NOISY = {
    "sony": [
        *(f"Sony/short/{scene}_00_{time}s.ARW" for scene in ("10185", "20201") for time in ("0.1", "0.04", "0.033")),
        "Sony/short/10034_00_0.1s.ARW",
    ],
    "fuji": [f"Fuji/short/{of}s.RAF" for of in ("10019_00_0.1", "10019_00_0.033", "10172_00_0.04", "20015_00_0.1")],
}
SCENES = {camera: sorted({Path(path).name[:5] for path in paths}) for camera, paths in NOISY.items()}


@pytest.fixture(scope="session")
def sid(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Some pairs of both halves below one folder. Not to be changed."""
    folder = tmp_path_factory.mktemp("data") / "SID"
    for camera in CAMERAS:
        manifest = shipped_manifest(f"sid-{camera}")
        write_frames(manifest.name, folder, frames_of(manifest, NOISY[camera]))
    return folder


def some(camera: Any, root: Path, **options: Any) -> list[tuple[PairRecord, Sample]]:
    """The pairs whose files are there."""
    dataset = SIDDataset(root, camera=camera, scenes=SCENES[camera], check="never", **options)
    return [(record, dataset[n]) for n, record in enumerate(dataset.records) if record.path in NOISY[camera]]


# --- pixels -------------------------------------------------------------------------------------------------------


LEVELS = {
    ("sony", "published"): (None, 16383.0),
    ("sony", "metadata"): (None, SENSORS["sid-sony"].white_level_dn),
    ("sony", "sid-sony"): (512.0, 16383.0),
    ("fuji", "published"): (None, 16383.0),
    ("fuji", "metadata"): (None, SENSORS["sid-fuji"].white_level_dn),
    ("fuji", "sid-fuji"): (1024.0, 16383.0),
}


@pytest.mark.parametrize(("camera", "levels"), LEVELS)
@pytest.mark.parametrize("clip", ["both", "upper"])
def test_samples_equal_a_plain_route_bit_for_bit(camera: str, levels: str, clip: str, sid: Path) -> None:
    black, white = LEVELS[camera, levels]
    low = np.float32(0 if clip == "both" else -np.inf)
    pairs = some(camera, sid, levels=levels, clip=clip)
    assert len(pairs) == len(NOISY[camera])
    for record, sample in pairs:
        noisy = np.clip(pack_plainly(sid / record.path, white, black), low, np.float32(1))
        same_bits(sample["input"], np.clip(noisy * np.float32(record.ratio), low, np.float32(1)))
        target = pack_plainly(sid / record.reference, white, black)
        same_bits(sample["target"], np.clip(target, np.float32(0), np.float32(1)))


# --- fields -------------------------------------------------------------------------------------------------------


def test_the_input_is_multiplied_by_the_nominal_ratio_as_published(sid: Path, tmp_path: Path) -> None:
    """EXIF that has 0.033 s in place of 1/30: 303 by EXIF, 300 by the published rule."""
    name, own = "Sony/short/10185_00_0.033s.ARW", Path(shutil.copytree(sid, tmp_path / "SID"))
    scale_exposure(own / name, Fraction(990, 1000))
    by = {}
    for amplification in ("nominal", "metadata"):
        pairs = some("sony", own, amplification=amplification, clip="none")
        (by[amplification],) = [sample for record, sample in pairs if record.path == name]
    assert (by["nominal"]["ratio"], by["nominal"]["nominal_ratio"]) == (300.0, 300.0)
    assert (by["metadata"]["ratio"], by["metadata"]["nominal_ratio"]) == (float(Fraction(10000, 33)), 300.0)
    once = pack_plainly(own / name, 16383.0)
    same_bits(by["nominal"]["input"], once * np.float32(300))
    same_bits(by["metadata"]["input"], once * np.float32(Fraction(10000, 33)))


def test_a_frame_of_uncertain_iso_is_read(tmp_path: Path) -> None:
    """If the list's ISO 12800 is true, the ratio by EXIF is 600; the published code has 300, and training goes on."""
    name = "Sony/short/00207_02_0.033s.ARW"
    manifest = shipped_manifest("sid-sony")
    write_frames("sid-sony", tmp_path, frames_of(manifest, [name]))
    dataset = SIDDataset(tmp_path, scenes=[207], check="never")
    (position,) = [i for i, record in enumerate(dataset.records) if record.path == name]
    sample = dataset[position]
    assert (sample["ratio"], sample["iso"], sample["flags"]) == (300.0, 12800.0, "uncertain-iso")
    by_exif = SIDDataset(tmp_path, scenes=[207], amplification="metadata", check="never")
    assert by_exif[position]["ratio"] == 600.0


# --- choices of pairs ---------------------------------------------------------------------------------------------


@in_one_test(
    "options, count",
    [
        ({}, 2697),
        ({"camera": "fuji", "split": "eval"}, 742),
        ({"subset": "eval-first", "exclude_flags": ["misaligned"]}, 124),
        ({"scenes": ["10034", 1]}, 24),
    ],
)
def test_choices(options: dict[str, Any], count: int) -> None:
    assert len(SIDDataset("none", check="never", **options)) == count


@in_one_test(
    "options, said",
    [
        ({"camera": "Sony"}, "camera must be one of 'sony', 'fuji'; found 'Sony'"),
        ({"split": "dev"}, "split must be one of 'train', 'val', 'test', 'eval'; found 'dev'"),
        ({"levels": "sid-fuji"}, "of another camera; those of 'sony' are 'sid-sony'"),
        ({"amplification": "exif"}, "amplification must be one of 'metadata', 'nominal'; found 'exif'"),
    ],
)
def test_unknown_values_list_the_known(options: dict[str, Any], said: str) -> None:
    with pytest.raises(ArgumentError, match=said):
        SIDDataset("none", check="never", **options)
