"""Which raws of a folder are taken for clean: never a noisy one without a word."""

from __future__ import annotations

import shutil
from fractions import Fraction
from pathlib import Path

import pytest

from eldata.datasets import CleanClips, CleanFrames
from eldata.datasets.synthetic.synthesis import Recipe, synthesize
from eldata.errors import DatasetError
from eldata.manifest import shipped_manifest
from eldata.manifest.own import clean_raws
from eldata.noise import CameraProfile
from eldata.records import Exposure
from eldata.sources.store import source_of_folder
from tests.manifest.test_own import NOISY, REFERENCE, SENSOR, shoot
from tests.trees import tree_in


def chosen(folder: Path, pattern: str | None = None) -> list[str]:
    return [path.relative_to(folder).as_posix() for path in clean_raws(folder, pattern)]


@pytest.mark.parametrize("is_listed", [True, False])
def test_every_route_takes_the_references_of_a_set(is_listed: bool, demo_tree: Path, tmp_path: Path) -> None:
    """In ELD's layout, 8 of 32 frames: by the manifest beside them, or by ISO and exposure alone."""
    tree = tree_in(demo_tree)
    wanted = [record.path for record in tree.manifest.records if record.role == "reference"]
    folder = tree.data
    if not is_listed:
        folder = tmp_path / "mine"
        shutil.copytree(tree.data, folder)
    assert chosen(folder) == wanted
    assert len(wanted) == 8
    assert CleanFrames(folder).names == tuple(str(folder / path) for path in wanted)
    assert source_of_folder(folder).files == tuple((path, "reference") for path in wanted)
    with pytest.raises(DatasetError, match=r"expected the frames of one clip, .* nothing from 2 to 5"):
        CleanClips(folder)
    made = synthesize(folder, tmp_path / "made", Recipe(CameraProfile.load("SonyA7S2")), reference="*Alpha*_0001.dng")
    assert made.card.counts == {"noisy": 1, "reference": 1}


def test_a_manifest_says_more_than_exposures(tmp_path: Path) -> None:
    """SID's long exposures are of many ISOs in one folder, and its short ones lie beside them."""
    records = shipped_manifest("sid-sony").records
    longs = [record.path for record in records if record.role == "reference"][:3]
    shorts = [record.path for record in records if record.role == "noisy"][:3]
    folder = tmp_path / "SID"
    for path in (*longs, *shorts):
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_bytes(b"never read")
    assert chosen(folder) == longs
    assert [f"Sony/long/{name}" for name in chosen(folder / "Sony" / "long")] == longs
    with pytest.raises(DatasetError, match="short: its manifest lists no reference among its 3 camera raws"):
        clean_raws(folder / "Sony" / "short")


FAST, LONG = Exposure(Fraction(100), Fraction(1, 400)), Exposure(Fraction(1600), Fraction(4))


@pytest.mark.parametrize(
    ("shots", "pattern", "wanted"),
    [
        ({"a": REFERENCE, "b": FAST}, None, ["a", "b"]),  # one ISO: clean stills of any exposures
        ({"a": REFERENCE, "b": Exposure()}, None, ["a", "b"]),
        ({"a": REFERENCE, "b": NOISY}, None, ["a"]),
        ({"a": REFERENCE, "b": NOISY}, "*", ["a", "b"]),
        ({"s/long/a": NOISY, "s/short/b": FAST}, "*/long/*", ["s/long/a"]),
        ({"a": REFERENCE, "b": FAST, "c": NOISY}, None, "in .*those at the lowest are not what was exposed most"),
        ({"a": REFERENCE, "b": LONG}, None, r"its 2 camera raws are of ISO 100 to 1600, .* reference='\*/long/\*'"),
        ({"day/a": REFERENCE, "night/b": NOISY}, None, "in .*night none is at the lowest"),
        ({"a": REFERENCE}, "b*", "none of its 1 camera raw has a path like b"),
    ],
)
def test_what_is_clean_of_exposures(
    shots: dict[str, Exposure], pattern: str | None, wanted: list[str] | str, tmp_path: Path
) -> None:
    for name, exposure in shots.items():
        shoot(tmp_path / f"{name}.dng", exposure, SENSOR)
    if isinstance(wanted, str):
        with pytest.raises(DatasetError, match=wanted):
            clean_raws(tmp_path, pattern)
    else:
        assert chosen(tmp_path, pattern) == [f"{name}.dng" for name in wanted]
