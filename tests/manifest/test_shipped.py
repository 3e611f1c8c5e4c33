"""The shipped ELD manifest against facts of the paper and its repository; every set against its generator."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path, PurePosixPath

import pytest

from capture.protocol import RELEASED
from eldata.manifest.card import load_card, save_card
from eldata.manifest.catalogue import Manifest, carded_names, shipped_folder, shipped_manifest, shipped_names
from eldata.manifest.table import save_records
from manifests.generate import published

EXTENSIONS = {"SonyA7S2": ".ARW", "NikonD850": ".nef", "CanonEOS70D": ".CR2", "CanonEOS700D": ".CR2"}


def test_committed_files_are_what_the_generator_writes(tmp_path: Path) -> None:
    """A manifest edited by hand would be lost at the next `make manifests`."""
    for name in carded_names():
        save_card(tmp_path / f"{name}.json", load_card(shipped_folder() / f"{name}.json"))
    for name, records in published().items():
        save_records(tmp_path / f"{name}.csv", records)
    for path in tmp_path.iterdir():
        assert path.read_bytes() == (shipped_folder() / path.name).read_bytes(), f"run make manifests ({path.name})"
    assert set(published()) == set(shipped_names())


@pytest.fixture(scope="module")
def eld() -> Manifest:
    return shipped_manifest("eld")


def number_of(path: str) -> int:
    return int(PurePosixPath(path).stem.removeprefix("IMG_"))


def test_every_file_is_listed_by_its_real_name(eld: Manifest) -> None:
    expected = {
        f"{camera}/scene-{scene}/IMG_{number:04d}{extension}"
        for camera, extension in EXTENSIONS.items()
        for scene in range(1, 11)
        for number in range(1, 17)
    }
    assert len(eld.records) == 640
    assert {record.path for record in eld.records} == expected


def test_numbers_isos_factors_and_references(eld: Manifest) -> None:
    """Two independent derivations of one numbering: a mistake in either shows here. Four rows are the paper's."""
    frames = {frame.number: frame for frame in RELEASED.frames()}
    assert sorted(frames) == list(range(1, 17))
    assert [(frames[n].iso, frames[n].factor, frames[n].reference) for n in (2, 4, 9, 15)] == [
        *((800, 1, 1), (800, 100, 6), (1600, 100, 11), (3200, 200, 16))
    ]
    for record in eld.records:
        frame = frames[number_of(record.path)]
        assert (record.role, record.ratio) == (frame.role, frame.factor)
        place, extension = PurePosixPath(record.path).parent, EXTENSIONS[record.camera]
        reference = None if frame.reference is None else f"{place}/IMG_{frame.reference:04d}{extension}"
        assert record.reference == reference
        if record.iso is not None:
            assert record.iso == frame.iso
        if record.exposure_s is not None:
            metered_s = Fraction("3.2") if record.scene == "scene-2" else Fraction(4)
            assert record.exposure_s == RELEASED.exposure_s(frame, metered_s)
        assert record.iso is not None or record.role == "reference"


def test_sony_exposures_are_exact(eld: Manifest) -> None:
    by_path = {record.path: record.exposure_s for record in eld.records}
    exposures_s = {"1/IMG_0001": 4, "1/IMG_0005": Fraction(1, 400), "2/IMG_0005": Fraction(1, 500), "10/IMG_0002": 0.5}
    assert {name: by_path[f"SonyA7S2/scene-{name}.ARW"] for name in exposures_s} == exposures_s


def test_what_is_not_published_is_left_empty(eld: Manifest) -> None:
    """An invented figure would make verify refuse good files."""
    for record in eld.records:
        assert {record.size_bytes, record.sha256, record.width, record.height} == {None}
        if record.camera != "SonyA7S2":
            assert record.exposure_s is None
        if record.camera.startswith("Canon") and record.role == "reference":
            assert record.iso is None


def test_the_one_inexact_ratio_is_flagged(eld: Manifest) -> None:
    flagged = {record.path: record.flags for record in eld.records if record.flags}
    assert flagged == {"NikonD850/scene-1/IMG_0012.nef": ("inexact-ratio",)}
    assert any("scene-1/IMG_0012.nef" in defect for defect in eld.card.known_defects)
