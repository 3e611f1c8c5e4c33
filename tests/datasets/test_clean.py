"""Clean frames from raw files and from arrays."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eldata.datasets.clean import Arrays, CleanClips, CleanFrames, clean_scenes
from eldata.datasets.crops import Crop, turn_mosaic
from eldata.datasets.synthetic.pairs import SyntheticPairs
from eldata.errors import DatasetError, EldataError
from eldata.raw import write_dng
from eldata.raw.levels import CLIP_RANGES, normalise, pack, unpack
from eldata.sources.store import build_store, source_of_folder
from tests.cases import in_one_test
from tests.raw.helpers import BAYER, EXPOSURE, XTRANS, Cfa, make_sensor, random_mosaic

CFAS = [BAYER["RGGB"], BAYER["GBRG"], XTRANS["xtrans-00"], XTRANS["xtrans-42"]]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four DNG files, one of them in a folder below, and what is not a raw file."""
    top = tmp_path_factory.mktemp("clean")
    (top / "deep" / "deeper").mkdir(parents=True)
    names = ("a.dng", "b.DNG", "deep/c.dng", "deep/deeper/d.dng")
    for number, (name, cfa) in enumerate(zip(names, CFAS, strict=True)):
        write_dng(top / name, random_mosaic(60, 64, seed=number), make_sensor(cfa), EXPOSURE)
    (top / "notes.txt").write_text("no raw")
    (top / "deep" / "preview.jpg").write_bytes(b"no raw")
    return top


# --- raw files ------------------------------------------------------------------------------------------------------


def test_several_places_are_one_source(folder: Path, tmp_path: Path) -> None:
    """Folders, files and stores, one after the other, and the frames are those of each alone."""
    other, store = tmp_path / "other", tmp_path / "clean.h5"
    other.mkdir()
    write_dng(other / "z.dng", random_mosaic(40, 52, seed=9), make_sensor(CFAS[0], 40, 52), EXPOSURE)
    build_store(source_of_folder(other), store)
    lone = [CleanFrames(folder), CleanFrames(other), CleanFrames(store)]
    several = CleanFrames([folder, other / "z.dng", str(store)])
    assert len(several) == 6
    assert [several.frame(number).name for number in range(6)] == list(several.names)
    for number, frame in enumerate([source.frame(n) for source in lone for n in range(len(source))]):
        np.testing.assert_array_equal(several.frame(number).whole(), frame.whole())
        assert several.frame(number).name == frame.name
    assert not several.reads_parts
    assert CleanFrames([store]).reads_parts
    pairs = SyntheticPairs(several, "SonyA7S2", crop=8, crops="grid")
    assert len(pairs) == sum(len(SyntheticPairs(one, "SonyA7S2", crop=8, crops="grid")) for one in lone)
    with pytest.raises(DatasetError, match=r"a\.dng: lies in two"):
        CleanFrames([folder, folder / "a.dng"])


@pytest.mark.parametrize(("levels", "white"), [("metadata", 15871.0), ("published", 16383.0)])
def test_each_frame_is_the_file(levels: Any, white: float, folder: Path) -> None:
    source = CleanFrames(folder, levels=levels)
    for number, cfa in enumerate(CFAS):
        frame = source.frame(number)
        sensor = make_sensor(cfa)
        np.testing.assert_array_equal(frame.whole(), random_mosaic(60, 64, seed=number))
        assert frame.mosaic.dtype == np.uint16
        assert frame.cfa == cfa
        assert frame.black_level_dn == sensor.black_level_dn
        assert frame.white_level_dn == white
        assert frame.range_dn == pytest.approx(white - np.mean(sensor.black_level_dn))
        assert frame.name == source.names[number]
        assert "mosaic" not in repr(frame)


def test_the_frames_last_used_are_kept(folder: Path) -> None:
    source = CleanFrames(folder, keep=2)
    first, second = source.frame(0), source.frame(1)
    assert source.frame(0) is first  # and so 1 is the oldest
    source.frame(2)
    assert source.frame(0) is first
    assert source.frame(1) is not second
    assert len(source._kept._frames) == 2


@in_one_test(
    "work, words",
    [
        (lambda folder: CleanFrames(folder, keep=-1), "keep"),
        (lambda folder: CleanFrames(folder, levels="eld"), "levels must be one of"),  # type: ignore[arg-type]
        (lambda folder: CleanFrames(folder / "none"), "none: there is no such folder"),
        (lambda folder: CleanFrames(folder / "a.dng"), r"a\.dng: is a file, not a folder"),
        (lambda _: CleanFrames([]), "no raw file was given"),
        (lambda _: CleanClips([]), "no clip was given"),
        (lambda _: Arrays([], range_dn=1.0), "no array was given"),
        (lambda _: Arrays(np.zeros((1, 4, 2, 2)), range_dn=0.0), "range_dn must be finite and above 0"),
        (lambda _: Arrays(np.zeros((1, 9, 2, 2)), range_dn=1.0).frame(0), r"expected packed data \(4, h"),
    ],
)
def test_what_is_refused(work: Any, words: str, folder: Path) -> None:
    with pytest.raises(EldataError, match=words):
        work(folder)


@in_one_test("names, may_be_clip", [("1 2 3", True), ("1 2 3 x", True), ("1 2 x y", False), ("x y", False)])
def test_numbered_stills_may_be_a_clip(names: str, may_be_clip: bool, tmp_path_factory: pytest.TempPathFactory) -> None:
    top = tmp_path_factory.mktemp("raws")
    (top / "below").mkdir()
    for name in names.split():
        (top / "below" / f"{name}.dng").touch()
    with pytest.raises(DatasetError, match="--no-clips") if may_be_clip else nullcontext():
        assert len(clean_scenes([top], None, "*")) == len(names.split())


# --- arrays ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("cfa", [*BAYER.values(), XTRANS["xtrans-42"]], ids=str)
def test_a_part_of_an_array_is_that_of_the_whole(cfa: Cfa) -> None:
    """At any place and of any size, in step with the CFA or not."""
    rng = np.random.default_rng(1)
    frame = Arrays(rng.random((1, 4 if len(cfa) == 2 else 9, 12, 14), np.float32), range_dn=900.0, cfa=cfa).frame(0)
    whole = frame.whole()
    for _ in range(40):
        (top, bottom), (left, right) = (np.sort(rng.integers(side + 1, size=2)) for side in frame.shape)
        part = slice(top, bottom), slice(left, right)
        np.testing.assert_array_equal(frame.read(*part), whole[part])


@pytest.mark.parametrize("cfa", [BAYER["BGGR"], XTRANS["xtrans-42"]], ids=["Bayer", "X-Trans"])
@pytest.mark.parametrize("clip", ["both", "upper", "none"])
def test_a_crop_of_an_array_is_what_numpy_makes_of_it(cfa: Cfa, clip: Any) -> None:
    """With values beyond all limits, NaN and -0 among them, which stay what they are."""
    rng = np.random.default_rng(3)
    packed = rng.normal(0.5, 0.5, (4 if len(cfa) == 2 else 9, 16, 18)).astype(np.float32)
    packed[:, 2:5, 3], packed[:, 6:9, 2], packed[0, 1, 1], packed[0, 1, 2] = np.nan, -0.0, np.inf, -np.inf
    frame = Arrays(packed[None], range_dn=900.0, cfa=cfa).frame(0)
    for seed in range(12):
        crop = Crop.draw(frame, np.random.default_rng(seed), crop=8, augment=True)
        out = np.empty(crop.packed_shape, np.float32)
        crop.fill(frame, out, clip=clip, gain=1.5)
        turned = turn_mosaic(unpack(packed, cfa)[crop.slices] * np.float32(900), crop.cfa, crop.orientation)
        once = normalise(
            pack(turned[: crop.height, : crop.width].copy(), crop.cfa),
            crop.cfa,
            frame.black_level_dn,
            frame.white_level_dn,
            clip=clip,
        )
        wanted = np.clip(once * np.float32(1.5), *CLIP_RANGES[clip])
        np.testing.assert_array_equal(out.view(np.uint32), wanted.view(np.uint32))


def test_pictures_in_place_of_raws_are_counted_and_what_else_to_do_is_said(tmp_path: Path) -> None:
    for name in ("a.JPG", "b.jpg", "c.png", "notes.txt"):
        (tmp_path / name).touch()
    said = r"3 pictures \(\.jpg, \.png\).*use the raw files .*of your own inverse ISP \(eldata\.datasets\.Arrays\)"
    with pytest.raises(DatasetError, match=said):
        CleanFrames(tmp_path)
