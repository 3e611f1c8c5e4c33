"""Small files made to keep a reader busy, to fill its memory, or to bring it to an error of its own.

Each is refused by one error that names it. A reader without bounds takes minutes or gigabytes for some: pytest's own
limit on time, or the machine, would end those tests.
"""

from __future__ import annotations

import struct
from pathlib import Path

import pytest

from eldata.raw import read_raw
from eldata.raw.tiff import read_directories
from tests.cases import in_one_test
from tests.raw.helpers import Tag, add_tags, check_refused, random_mosaic, write_plain_dng

Entry = tuple[int, int, int, int]  # tag, kind, count, value or offset


def directory(*entries: Entry, following: int = 0) -> bytes:
    return (
        struct.pack("<H", len(entries))
        + b"".join(struct.pack("<HHII", *e) for e in entries)
        + struct.pack("<I", following)
    )


# --- the walk over all directories ------------------------------------------------------------------------------------


def test_directories_that_share_their_entries(tmp_path: Path) -> None:
    """4 MB: each of sixty directories begins within the first one, and each entry has the same half million values."""
    path = tmp_path / "a.dng"
    values = 1 << 19
    entries: list[Entry] = [(50714, 3, values, 100_000)] * 2000
    first = directory((330, 4, 60, 60_000), *entries)
    content = bytearray(100_000 + 8 * values)
    content[:8] = b"II*\0" + struct.pack("<I", 8)
    content[8 : 8 + len(first)] = first
    struct.pack_into("<60I", content, 60_000, *(20_000 + 2 * number for number in range(60)))
    path.write_bytes(content)
    check_refused(path, "made to keep a reader busy: its directories declare far too many values")


def test_more_entries_than_any_camera_writes(tmp_path: Path) -> None:
    path = tmp_path / "a.dng"
    path.write_bytes(b"II*\0" + struct.pack("<I", 8) + directory(*[(270, 2, 4, 0)] * 5000))
    check_refused(path, "far too many entries")


@pytest.mark.parametrize("tag", [271, 272, 36867])
def test_a_text_of_many_megabytes_that_entries_share(tag: int, tmp_path: Path) -> None:
    path, length = tmp_path / "a.dng", 1 << 22
    content = b"II*\0" + struct.pack("<I", 8) + directory(*[(tag, 2, length, 8)] * 4000)
    path.write_bytes(content.ljust(length + 8, b"x"))
    check_refused(path, "made to keep a reader busy: its directories declare far too many values")


def test_a_directory_before_the_files_begin(tmp_path: Path) -> None:
    path = tmp_path / "a.dng"
    path.write_bytes(b"II*\0" + struct.pack("<I", 8) + directory((330, 9, 1, (1 << 32) - 5)))
    check_refused(path, "it declares a directory at byte -5")


@in_one_test(
    "tags",
    [
        ((50721, "2i", 9, (1, 0) * 9, True), (50778, "H", 1, 21, True)),  # a matrix of 1/0
        ((50721, "2i", 9, (0, 2) * 9, True), (50778, "B", 0, b"", True)),  # an illuminant of no values
    ],
)
def test_colours_that_are_no_numbers_are_not_known(tags: tuple[Tag, ...], tmp_path: Path) -> None:
    write_plain_dng(tmp_path / "a.dng", random_mosaic(64, 66), ("RG", "GB"), *tags)
    sensor = read_raw(tmp_path / "a.dng").sensor
    assert sensor.xyz_to_camera is None


# --- sizes ------------------------------------------------------------------------------------------------------------


def test_more_pixels_than_the_file_can_hold(tmp_path: Path) -> None:
    """60,000 x 60,000 pixels, whose strips all lie in the same few bytes: LibRaw would take 7 GB for them."""
    path, sides = tmp_path / "a.dng", 60_000
    write_plain_dng(path, random_mosaic(64, 66), ("RG", "GB"))
    size = path.stat().st_size
    add_tags(path, *((tag, "I", 1, sides, True) for tag in (256, 257, 278)))
    check_refused(path, "its rows take 7200000000; the file has 8448 bytes there")
    offsets, lengths = ((tag, "I", sides, (value,) * sides, True) for tag, value in ((273, 8), (279, size - 8)))
    add_tags(path, offsets, lengths, (278, "I", 1, 1, True))
    assert read_directories(path)[0].pixels == 3_600_000_000
    check_refused(path, "its rows take 120000")


def test_image_data_before_the_file_begins(tmp_path: Path) -> None:
    """Offsets of a signed type: -5, of the mosaic and of a preview beside it."""
    path = tmp_path / "a.dng"
    write_plain_dng(path, random_mosaic(64, 66), ("RG", "GB"))
    content = bytearray(path.read_bytes())
    (first,) = struct.unpack_from("<I", content, 4)
    (count,) = struct.unpack_from("<H", content, first)
    add_tags(path, (273, "i", 1, -5, True))
    check_refused(path, r"damaged: it declares 8448 bytes of image data at byte -5")
    preview = struct.pack("<HHHIi", 3, 273, 9, 1, -5) + struct.pack("<HHIIHHIII", 279, 4, 1, 64, 259, 3, 1, 7, 0)
    content[first + 2 + 12 * count : first + 6 + 12 * count] = struct.pack("<I", len(content))
    path.write_bytes(content + preview)
    assert read_directories(path)[1].extents == ((-5, 64),)
    assert read_raw(path).mosaic.shape == (64, 66)


def test_memory_that_there_is_not(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def starve(_: Path) -> None:
        raise MemoryError

    path = tmp_path / "a.dng"
    write_plain_dng(path, random_mosaic(64, 66))
    monkeypatch.setattr("eldata.raw.reading.read_container", starve)
    check_refused(path, "needs more memory than there is; is the file whole, and what it says it is?")
