"""A set of one's own whose files are arrays of floats, with levels on its card: as the same whole numbers in DNGs.

What cannot be done with them says so, and names the file.
"""

from __future__ import annotations

import re
import shutil
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from eldata import SyntheticPairs
from eldata.datasets import CleanFrames, PairDataset
from eldata.datasets.synthetic.synthesis import Recipe, synthesize
from eldata.errors import EldataError
from eldata.evaluation import evaluate
from eldata.manifest.catalogue import load_manifest, save_manifest
from eldata.noise import CameraProfile
from eldata.raw import read_raw
from eldata.raw.stated import MosaicFacts
from eldata.sources.store import build_store, source_of_dataset
from tests.evaluation.own_set import BLACK, WHITE, OwnSet, build_own_set

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from eldata.evaluation import EvaluationResult

FILE_LEVELS = ("lrd-eld", "led-eld")
"""Protocols with the files' own levels; LibRaw knows none of each channel for these files."""


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> OwnSet:
    return build_own_set(tmp_path_factory.mktemp("own"))


def rewritten(own: OwnSet, folder: Path, which: str, scale: float = 1.0, hot: float | None = None) -> OwnSet:
    """The set with some files as floats, divided by ``scale``, one pixel of which is set to ``hot`` times white."""
    shutil.copytree(own.manifest.parent, folder, dirs_exist_ok=True)
    copy = OwnSet(folder / own.manifest.name, folder / "data")
    loaded = load_manifest(own.manifest)
    white = round(WHITE / scale)
    facts = MosaicFacts("*.npy", "GBRG", tuple(level / scale for level in BLACK), white)
    renamed = {}
    for path in sorted(copy.files.glob(which)):
        mosaic = read_raw(path).mosaic
        values = (mosaic / np.float64(scale)).astype(np.float32)
        if hot is not None:
            values[np.unravel_index(mosaic.argmax(), mosaic.shape)] = hot * white
        np.save(path.with_suffix(".npy"), values)
        path.unlink()
        row = path.relative_to(copy.files).as_posix()
        renamed[row] = row.replace(".dng", ".npy")
    rows = [
        replace(row, path=renamed.get(row.path, row.path), reference=renamed.get(row.reference or "", row.reference))
        for row in loaded.records
    ]
    save_manifest(copy.manifest, replace(loaded.card, mosaics=(facts,)), rows)
    return copy


def scored(own: OwnSet, protocol: str) -> EvaluationResult:
    return evaluate(None, baseline="input", **own.where, protocol=protocol)


def figures(result: EvaluationResult) -> list[tuple[str, float, float]]:
    return [(one.path.partition(".")[0], one.psnr_db, one.ssim) for one in result.scores]


@pytest.mark.parametrize("which", ["*/clean.dng", "*/*.dng"], ids=["references", "all"])
@pytest.mark.parametrize("protocol", [*FILE_LEVELS, "eld"])
def test_floats_of_the_same_numbers_score_the_same(own: OwnSet, protocol: str, which: str, tmp_path: Path) -> None:
    floats = rewritten(own, tmp_path, which)
    assert figures(scored(floats, protocol)) == figures(scored(own, protocol))


@pytest.mark.parametrize("protocol", FILE_LEVELS)
def test_shares_of_white_score_the_same_and_no_bright_pixel_matters(own: OwnSet, protocol: str, tmp_path: Path) -> None:
    """float32 has seven digits."""
    shares = rewritten(own, tmp_path, "*/clean.dng", scale=15300, hot=1.5)
    for one, other in zip(figures(scored(shares, protocol)), figures(scored(own, protocol)), strict=True):
        assert one[0] == other[0]
        assert one[1:] == pytest.approx(other[1:], abs=1e-5)


def test_shares_of_white_are_not_scored_against_a_white_level_in_dn(own: OwnSet, tmp_path: Path) -> None:
    shares = rewritten(own, tmp_path, "*/clean.dng", scale=15300)
    result = scored(shares, "eld")
    assert result.scores == ()
    reasons = {str(problem) for problem in result.problems}
    assert len(reasons) == 2
    assert all(
        re.search(r"clean\.npy: its white level is 1, .* white level of 16383 .* is in DN", one) for one in reasons
    )


def test_a_dataset_gives_the_same_crops(own: OwnSet, tmp_path: Path) -> None:
    floats = rewritten(own, tmp_path, "*/*.dng")
    choice: dict[str, Any] = {"levels": "metadata", "crop": 16, "augment": True, "clip": "none"}
    one, other = (PairDataset(of.files, manifest=of.manifest, **choice) for of in (floats, own))
    for index in range(len(one)):
        for name in ("input", "target"):
            assert np.array_equal(one[index][name].numpy(), other[index][name].numpy())


def test_clean_frames_in_dn_are_taken_and_shares_of_white_are_not(
    own: OwnSet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    profile = CameraProfile.load("SonyA7S2")

    def pair(of: OwnSet) -> Mapping[str, Any]:
        monkeypatch.setenv("ELDATA_ROOT", str(of.root))
        return SyntheticPairs(CleanFrames(of.manifest), profiles=profile, crop=16)[0]

    one, other = pair(rewritten(own, tmp_path / "dn", "*/clean.dng")), pair(own)
    assert np.array_equal(one["target"].numpy(), other["target"].numpy())
    assert np.array_equal(one["input"].numpy(), other["input"].numpy())
    with pytest.raises(EldataError, match=r"clean\.npy: its white level is 1, .* noise is in DN"):
        pair(rewritten(own, tmp_path / "shares", "*/clean.dng", scale=15300))


@pytest.mark.parametrize(
    "use",
    [
        lambda floats, path: build_store(
            source_of_dataset("mine", root=floats.root, manifest=floats.manifest), path / "a.h5"
        ),
        lambda floats, path: synthesize(floats.manifest, path / "out", Recipe(CameraProfile.load("SonyA7S2"))),
    ],
    ids=["store", "synthesis"],
)
def test_what_needs_whole_dn_names_the_file(
    own: OwnSet, use: Callable[[OwnSet, Path], object], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    floats = rewritten(own, tmp_path, "*/*.dng")
    monkeypatch.setenv("ELDATA_ROOT", str(floats.root))
    with pytest.raises(EldataError, match=r"[a-z0-9]*\.npy: its pixels are no whole DN.*as the camera wrote them"):
        use(floats, tmp_path)
