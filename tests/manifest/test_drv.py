"""DRV's manifest: published clips and splits, patterns, the layout of a copy, verify and lock."""

from __future__ import annotations

import os
import shutil
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from eldata.download.fetching import archive_name, choose_parts
from eldata.errors import ArgumentError, DatasetError
from eldata.manifest.catalogue import shipped_manifest
from eldata.manifest.clips import FRAME_RANGES, Clip, clips_of, frame_range, windows
from eldata.manifest.layouts import UNUSED, describe_layout, scan_raw
from eldata.manifest.lock import lock
from eldata.manifest.patterns import FrameSequence, expand, sequence_of
from eldata.manifest.verify import verify
from eldata.manifest.verify_report import Level
from tests.cases import in_one_test
from tests.drv_tree import (
    NOISY,
    REFERENCE,
    SmallDrv,
    rgb_frame_of,
    small_drv,
    still_of,
    write_png,
    write_raw,
    write_raw_clip,
)
from tests.trees import swap

CLIPS = ("0007", "0013", "M0003")


# --- the published set ------------------------------------------------------------------------------------------------


def test_every_clip_of_every_split() -> None:
    manifest = shipped_manifest("drv")
    noisy = [record for record in manifest.records if record.role == "noisy"]
    assert Counter(record.split for record in noisy) == {"train": 129, "val": 24, "test": 49, "dynamic": 23}
    static = {record.scene for record in noisy if record.split != "dynamic"}
    assert static == {f"{number:04d}" for number in range(1, 203)}
    assert {record.scene for record in noisy} - static == {f"M{number:04d}" for number in range(23)}
    assert len(manifest.records) == 225 + 202
    for record in noisy:
        assert record.path == f"VBM4D_rawRGB/{record.scene}/*.png"
        assert record.reference == (None if record.scene.startswith("M") else f"long/{record.scene}/half0001*.png")
        assert {record.iso, record.exposure_s, record.ratio, record.sha256, record.width} == {None}


def test_a_program_fetches_what_the_manifest_lists() -> None:
    """Whether an archive of raws is here already, the manifest cannot tell: those are fetched by hand."""
    manifest = shipped_manifest("drv")
    downloads = {archive_name(download.address): download for download in manifest.card.downloads}
    shorts = [f"short{number}" for number in range(1, 6)]
    assert set(downloads) == {"long.zip", "VBM4D_rawRGB.zip", *(f"{part}.zip" for part in shorts)}
    assert [part.part for part in choose_parts(tuple(downloads.values()), ["long", "noisy"])] == ["long", "noisy"]
    for part in shorts:
        assert (downloads[f"{part}.zip"].part, downloads[f"{part}.zip"].below) == (part, "short")
        with pytest.raises(ArgumentError, match="known are long, noisy"):
            choose_parts(tuple(downloads.values()), [part])
    for record in manifest.records:
        holders = [download.part for download in downloads.values() if download.holds(record.path)]
        assert holders == ["long" if record.role == "reference" else "noisy"]


# --- numbering and windows --------------------------------------------------------------------------------------------


@in_one_test(
    "names, numbers",
    [
        (["1.png", "9.png", "10.png"], (1, 9, 10)),
        (["0001.png", "0002.png"], (1, 2)),
        (["a1_6.png", "a1_7.png"], (6, 7)),
        (["only.png"], None),
        (["1_2.png", "2_1.png"], None),  # two numbers run: neither is the frame's
        ([], None),
    ],
)
def test_names_in_order(names: list[str], numbers: tuple[int, ...] | None) -> None:
    assert sequence_of(reversed(names)) == FrameSequence(tuple(names), numbers, ())


def test_gaps_doubles_and_odd_names() -> None:
    sequence = sequence_of(["0001.png", "0002.png", "0005.png", "0009.png", "0005 (1).png"])
    assert (sequence.gaps, sequence.odd) == (((3, 4), (6, 8)), ("0005 (1).png",))
    assert sequence_of(["5.png", "05.png", "6.png"]).doubles == (5,)


def clip_of(numbers: list[int]) -> Clip:
    return Clip("0001", "train", "C", tuple(f"{n}.png" for n in numbers), tuple(numbers), "r.png")


def test_windows_exhaustively() -> None:
    for count, length, stride in product(range(1, 9), range(1, 5), range(1, 5)):
        clip = clip_of(list(range(count)))
        expected = [start for start in range(0, count, stride) if start + length <= count]
        if not expected:
            with pytest.raises(DatasetError, match=f"no {length} continuous frames among its {count}"):
                windows(clip, length=length, stride=stride, frames="all")
            continue
        found = windows(clip, length=length, stride=stride, frames="all")
        assert [window.start for window in found] == expected
        for window in found:
            assert window.frames == tuple(f"{n}.png" for n in range(window.start, window.start + length))
            assert (window.path, window.reference) == (window.frames[0], "r.png")


def test_windows_do_not_span_gaps() -> None:
    for missing in range(1, 7):
        numbers = [n for n in range(8) if n != missing]
        found = windows(clip_of(numbers), length=2, stride=1, frames="all")
        pairs = [tuple(int(path[:-4]) for path in window.frames) for window in found]
        assert pairs == [(n, n + 1) for n in range(7) if missing not in (n, n + 1)]
    with pytest.raises(DatasetError, match="eldata verify finds gaps"):
        windows(clip_of([0, 2, 4]), length=2, stride=1, frames="all")


def test_named_frame_ranges() -> None:
    for count in range(30):
        positions = list(range(count))
        assert list(frame_range("all", count)) == positions
        assert list(frame_range("authors", count)) == list(range(4, count - 3))  # test_video.py
        assert list(frame_range("evaluation", count)) == positions[4:9]
    with pytest.raises(ArgumentError, match="'all', 'authors', 'evaluation'; found 'some'"):
        frame_range("some", 3)  # type: ignore[arg-type]
    assert len(FRAME_RANGES) == 3


# --- patterns ---------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> SmallDrv:
    return small_drv(tmp_path_factory.mktemp("drv"), CLIPS, 6)


@pytest.fixture
def drv(original: SmallDrv, tmp_path: Path) -> SmallDrv:
    shutil.copytree(original.csv.parent.parent, tmp_path / "tree")
    return SmallDrv(tmp_path / "tree" / "manifests" / "drv.csv", tmp_path / "tree" / "data")


def test_expanding_puts_the_files_of_a_copy_in(drv: SmallDrv) -> None:
    rows = expand(drv.manifest.records, drv.data)
    assert [row.path for row in rows] == sorted(
        path.relative_to(drv.data).as_posix() for path in drv.data.rglob("*.png")
    )
    references = {row.reference for row in rows if row.role == "noisy"}
    assert references == {"long/0007/half0001_0.png", "long/0013/half0001_0.png", None}
    assert expand(rows, drv.data) == rows


def test_clips_need_frames_and_one_reference(drv: SmallDrv) -> None:
    records = drv.manifest.records
    assert [clip.scene for clip in clips_of(expand(records, drv.data))] == list(CLIPS)
    shutil.copy(drv.data / "long/0007/half0001_0.png", drv.data / "long/0007/half0001_1.png")
    with pytest.raises(DatasetError, match="clip 0007: expected one file as its reference"):
        clips_of(expand(records, drv.data))
    (drv.data / "VBM4D_rawRGB/0007/x.png").write_bytes(b"x")
    with pytest.raises(DatasetError, match=r"clip 0007: .* do not follow one numbering"):
        clips_of(expand(records, drv.data))
    shutil.rmtree(drv.data / "VBM4D_rawRGB/0013")
    with pytest.raises(DatasetError, match=r"no frames of 1 clips, 0013 .*ids=\['0007', 'M0003'\]"):
        clips_of(expand(records, drv.data))


# --- verify and lock, preprocessed ------------------------------------------------------------------------------------


def found(drv: SmallDrv, level: Level = "metadata") -> list[tuple[str, str]]:
    return [(problem.path, problem.field) for problem in verify([drv.manifest], drv.root, level=level).problems]


FRAME = "VBM4D_rawRGB/0007/0004.png"


GAP = ("VBM4D_rawRGB/0007", "number")
LONG = "long/0007/half0001"
OF_8_BITS = rgb_frame_of("0007", 4).astype(np.uint8)


def copy(data: Path, name: str, to: str) -> None:
    shutil.copy(data / name, (data / name).with_name(to))


def flip(data: Path) -> None:
    content = bytearray((data / FRAME).read_bytes())
    content[len(content) // 2] ^= 1
    (data / FRAME).write_bytes(content)


@pytest.mark.parametrize(
    ("damage", "level", "expected"),
    [
        (lambda data: (data / FRAME).unlink(), "quick", [GAP]),
        (lambda data: (data / FRAME).rename(data / FRAME.replace("0004", "0017")), "quick", [GAP, GAP]),
        (lambda data: copy(data, FRAME, "04.png"), "quick", [GAP]),
        (lambda data: copy(data, FRAME, "0004 (1).png"), "quick", [("VBM4D_rawRGB/0007/0004 (1).png", "name")]),
        (lambda data: (data / f"{LONG}_0.png").unlink(), "quick", [(f"{LONG}*.png", "file")]),
        (lambda data: copy(data, f"{LONG}_0.png", "half0001_1.png"), "quick", [(f"{LONG}*.png", "file")]),
        (lambda data: os.truncate(data / FRAME, 300), "metadata", [(FRAME, "content")]),
        (lambda data: write_png(data / FRAME, OF_8_BITS), "metadata", [(FRAME, "content")]),
        (lambda data: write_png(data / FRAME, rgb_frame_of("0007", 4, (40, 40))), "metadata", [(FRAME, "size")]),
        (flip, "metadata", []),
        (flip, "full", [(FRAME, "content")]),
    ],
)
def test_what_shows_before_the_files_are_listed(
    damage: Callable[[Path], object], level: Level, expected: list[tuple[str, str]], drv: SmallDrv
) -> None:
    damage(drv.data)
    assert found(drv, level) == expected


def test_locking_lists_the_files(drv: SmallDrv) -> None:
    assert lock(drv.csv, drv.root).files_locked == 20
    manifest = drv.manifest
    assert manifest.card.counts == {"noisy": 18, "reference": 2}
    assert not any("*" in record.path for record in manifest.records)
    assert all(record.sha256 for record in manifest.records)
    assert found(drv, "full") == []
    before = drv.csv.read_bytes(), drv.csv.with_suffix(".json").read_bytes()
    lock(drv.csv, drv.root)
    assert (drv.csv.read_bytes(), drv.csv.with_suffix(".json").read_bytes()) == before
    # The folders below long hold more than the reference: camera raws among them.
    write_png(drv.data / "long/0007/other.png", still_of("x"))
    write_raw(drv.data / "long/0007/DSC00001.ARW", REFERENCE)
    assert found(drv, "full") == []


# --- raws -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("short", ["short", "archives/short2/short"])
def test_raws_are_found_wherever_the_archives_were_unpacked(short: str, tmp_path: Path) -> None:
    for clip in CLIPS:
        write_raw_clip(tmp_path, clip, 4, short=short)
    scan = scan_raw(tmp_path)
    assert Counter(record.role for record in scan.records) == {"noisy": 12, "reference": 2}
    assert describe_layout(scan.records) == (
        f"noisy {short}/<clip>/DSC<n>.ARW: 3 clips, 12 files; reference long/<clip>/DSC<n>.ARW: 2 clips, 2 files; "
        "4 to 4 frames per clip; without a reference: M0003"
    )
    for record in scan.records:
        assert record.split == {"0007": "test", "0013": "test", "M0003": "dynamic"}[record.scene]
        if record.role == "noisy":
            assert record.reference == (None if record.scene == "M0003" else f"long/{record.scene}/DSC00001.ARW")


@pytest.mark.parametrize(
    ("stray", "message"),
    [
        ("short/DSC00001.ARW", r"cannot tell which clip 1 raw files belong to, such as short/DSC00001.ARW"),
        ("short/0999/DSC00001.ARW", r"cannot tell .* short/0999"),
        ("long/short/0007/DSC00001.ARW", r"cannot tell .* long/short"),
        ("short2/0007/DSC09999.ARW", r"clip 0007 lies in 2 folders: short/0007, short2/0007"),
        ("long/0007/DSC00002.ARW", r"clip 0007 has 2 long exposures, and which is the reference is not published"),
    ],
)
def test_what_cannot_be_told_is_an_error(stray: str, message: str, tmp_path: Path) -> None:
    write_raw_clip(tmp_path, "0007", 2)
    (tmp_path / stray).parent.mkdir(parents=True, exist_ok=True)
    shutil.copy(tmp_path / "short/0007/DSC00998.ARW", tmp_path / stray)
    with pytest.raises(DatasetError, match=message):
        scan_raw(tmp_path)


def test_the_reference_is_named_where_there_are_several(tmp_path: Path) -> None:
    data = tmp_path / "DRV"
    write_raw_clip(data, "0007", 2)
    write_raw(data / "long/0007/DSC00002.ARW", REFERENCE)
    scan = scan_raw(data, reference="*2.ARW")
    assert {row.reference for row in scan.records if row.role == "noisy"} == {"long/0007/DSC00002.ARW"}
    assert [row.path for row in scan.records if UNUSED in row.flags] == ["long/0007/DSC00001.ARW"]
    assert verify([scan.save(tmp_path / "raw.csv")], tmp_path, level="metadata").ok


RAW_FRAME, RAW_REFERENCE = "short/0007/DSC00999.ARW", "long/0007/DSC00001.ARW"
EITHER = {(path, "exposure") for path in (RAW_FRAME, RAW_REFERENCE)}


@pytest.mark.parametrize(
    ("damage", "expected"),
    [
        (lambda data: write_raw(data / RAW_FRAME, replace(NOISY, iso=Fraction(3200))), {(RAW_FRAME, "exposure")}),
        (lambda data: swap(data / RAW_FRAME, data / RAW_REFERENCE), EITHER),
    ],
)
def test_what_shows_in_raws(damage: Callable[[Path], object], expected: set[tuple[str, str]], tmp_path: Path) -> None:
    data = tmp_path / "DRV"
    with pytest.raises(DatasetError, match="holds no camera raw of a clip"):
        scan_raw(data)
    for clip in CLIPS:
        write_raw_clip(data, clip, 4)
    write_raw(data / "long/M0003/DSC00001.ARW", REFERENCE)  # which is left out
    manifest = scan_raw(data).save(tmp_path / "drv-raw.csv")
    assert verify([manifest], tmp_path, level="full").ok
    damage(data)
    problems = verify([manifest], tmp_path, level="metadata").problems
    assert {(problem.path, problem.field) for problem in problems} == expected
