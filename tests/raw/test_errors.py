"""Files that cannot be used: each is refused by one error that names the file and the reason."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Literal

import numpy as np
import pytest
import tifffile
from PIL import Image

from eldata.errors import RawFileError
from eldata.raw import read_header, read_raw, write_dng
from tests.raw.helpers import (
    BAYER,
    EXPOSURE,
    XTRANS,
    Cfa,
    Tag,
    add_tags,
    letters,
    make_sensor,
    random_mosaic,
    write_plain_dng,
    xtrans_at,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from eldata.records import RawFrame, RawHeader

READERS: list[Callable[[Path], RawFrame | RawHeader]] = [read_raw, read_header]
KINDS: dict[str, tuple[Cfa, Literal["none", "lossless-jpeg"]]] = {
    "uncompressed": (BAYER["RGGB"], "none"),
    "lossless JPEG": (BAYER["GBRG"], "lossless-jpeg"),
    "X-Trans": (xtrans_at(1, 2), "none"),
    "X-Trans lossless JPEG": (xtrans_at(0, 0), "lossless-jpeg"),
}


@pytest.fixture(autouse=True)
def only_libraw_prints(capfd: pytest.CaptureFixture[str]) -> Iterator[None]:
    """Python prints and logs nothing; LibRaw's C code may print a line of its own on a damaged file."""
    yield
    captured = capfd.readouterr()
    assert captured.out == ""
    printed = [line for line in captured.err.splitlines() if "Unexpected end of file" not in line]
    assert [line for line in printed if "data corrupted at" not in line] == []


def refused(path: Path, reason: str, readers: list[Callable[[Path], RawFrame | RawHeader]] | None = None) -> None:
    for read in readers or READERS:
        with pytest.raises(RawFileError, match=reason) as caught:
            read(path)
        assert caught.value.path == path
        assert str(caught.value) == f"{path}: {caught.value.reason}"
        assert "\n" not in str(caught.value)


def test_a_missing_file(tmp_path: Path) -> None:
    refused(tmp_path / "a.ARW", "cannot be read: No such file or directory")
    refused(tmp_path / "no folder" / "a.ARW", "cannot be read: No such file or directory")
    (tmp_path / "b.ARW").symlink_to(tmp_path / "gone.ARW")
    refused(tmp_path / "b.ARW", "cannot be read: No such file or directory")


@pytest.mark.parametrize("kind", ["JPEG", "PNG", "TIFF"])
def test_an_ordinary_image_named_as_a_raw_file(kind: str, tmp_path: Path) -> None:
    pixels = (random_mosaic(64, 3 * 64) >> 8).astype(np.uint8).reshape(64, 64, 3)
    Image.fromarray(pixels).save(tmp_path / "a.ARW", kind)
    refused(tmp_path / "a.ARW", "is a JPEG picture" if kind == "JPEG" else "not a raw file that LibRaw knows")


@pytest.mark.parametrize(
    "content", [b"\0" * 5000, b"\xff" * 5000, b"II*\0" * 1000, b"MM\0*" * 1000, b"II*\0", b"x\n" * 5000]
)
def test_noise(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "a.dng").write_bytes(content)
    refused(tmp_path / "a.dng", ".")


# --- truncated ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_a_file_without_its_last_pixel(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "a.dng"
    data, end = written(path, kind, (60, 66))
    path.write_bytes(data[: end - 1])
    refused(
        path,
        rf"truncated: it declares data up to byte \d+ but has {end - 1} bytes; copy or download it again",
    )


@pytest.mark.parametrize("kind", ["uncompressed", "lossless JPEG", "X-Trans"])
def test_a_file_cut_anywhere_before_its_exif_is_refused(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "a.dng"
    data, end = written(path, kind)
    for length in [*range(0, 400, 3), *range(400, end, 29), end - 1]:
        path.write_bytes(data[:length])
        refused(path, ".", [read_raw])


# Regression: EXIF stands behind the pixels. Where its last values are cut off exifread makes up numbers
# (1/30 s becomes 1/1, 255/256, 1/4294967296...) or leaves them out, logs "Unexpected slice length" on stderr,
# and read_raw returns them as the exposure.
@pytest.mark.parametrize("kind", ["uncompressed", "lossless JPEG", "X-Trans"])
def test_a_file_cut_inside_of_its_exif_never_gives_another_exposure(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "a.dng"
    data, end = written(path, kind)
    wrong = {}
    for length in range(end, len(data)):
        path.write_bytes(data[:length])
        for read in READERS:
            try:
                read_as = read(path)
            except RawFileError:
                continue
            if read_as.exposure != EXPOSURE:
                wrong[length - len(data)] = read_as.exposure
    assert wrong == {}


def written(path: Path, kind: str, shape: tuple[int, int] = (24, 26)) -> tuple[bytes, int]:
    """Write a DNG of a kind; return its bytes, and where its pixels end."""
    cfa, compression = KINDS[kind]
    write_dng(path, random_mosaic(*shape), make_sensor(cfa, *shape), EXPOSURE, compression=compression)
    with tifffile.TiffFile(path) as tiff:
        return path.read_bytes(), tiff.pages.first.dataoffsets[0] + tiff.pages.first.databytecounts[0]


def test_data_that_cannot_hold_the_pixels_though_the_extents_fit(tmp_path: Path) -> None:
    write_plain_dng(tmp_path / "a.dng", random_mosaic(64, 66))
    add_tags(tmp_path / "a.dng", (259, "H", 1, 7, True), (279, "I", 1, 40, True))
    refused(tmp_path / "a.dng", "truncated: its image data, 40 bytes, cannot hold 4224 pixels")


def test_a_last_row_of_zeros_far_below_black(tmp_path: Path) -> None:
    path, mosaic = tmp_path / "a.dng", random_mosaic(64, 66)
    mosaic[-1] = 0
    write_plain_dng(path, mosaic, ("RG", "GB"), (50714, "I", 1, 400, True))
    refused(path, "last row is all 0 DN", [read_raw])
    write_plain_dng(path, mosaic, ("RG", "GB"))  # black 0: zeros are dark
    np.testing.assert_array_equal(read_raw(path).mosaic, mosaic)


# --- not a mosaic of a Bayer or X-Trans sensor --------------------------------------------------------------


def test_an_already_demosaiced_dng(tmp_path: Path) -> None:
    rgb = random_mosaic(64, 3 * 66).reshape(64, 66, 3)
    write_plain_dng(tmp_path / "a.dng", rgb, None, photometric=34892, planarconfig=1)
    refused(tmp_path / "a.dng", "already demosaiced", [read_raw])


@pytest.mark.parametrize("pattern", [None, ("RR", "RR")])
def test_a_monochrome_dng(pattern: tuple[str, str] | None, tmp_path: Path) -> None:
    write_plain_dng(tmp_path / "a.dng", random_mosaic(64, 66), pattern)
    refused(tmp_path / "a.dng", "no colour filter array", [read_raw])


# Regression: the greens side by side or in one column, and any 6 x 6 of R, G and B, are taken for Bayer
# and X-Trans; of "RB", "GG" the record even has a CFA without channel 1 and three black levels.
@pytest.mark.parametrize(
    "pattern",
    [
        ("RG", "RB"),
        ("RB", "GG"),
        ("GG", "RB"),
        ("RG", "BG"),
        ("GR", "GB"),
        ("RRGG", "GGBB", "RRGG", "GGBB"),
        ("RGGRRB",) * 6,
        ("RGBRGB", "GBRGBR", "BRGBRG") * 2,
        (*letters(XTRANS["xtrans-00"])[:5], "GGRGGR"),
    ],
    ids="/".join,
)
def test_other_patterns_of_red_green_and_blue(pattern: tuple[str, ...], tmp_path: Path) -> None:
    write_plain_dng(tmp_path / "a.dng", random_mosaic(66, 72), pattern)
    refused(tmp_path / "a.dng", "unsupported colour filter array", [read_raw])


def in_blocks(side: int, rows: tuple[str, str] = ("RG", "GB")) -> list[str]:
    return ["".join(colour * side for colour in row) for row in rows for _ in range(side)]


NAMED = {
    "hexadeca-Bayer": (in_blocks(4), "as of hexadeca-Bayer, 8 x 8 sites of BGR"),
    "nearly quad-Bayer": (["RRGG", "RRGG", "GGBB", "GGBG"], "4 x 4 sites of BGR"),
    "nearly nona-Bayer": ([*in_blocks(3)[:5], "GGGBBG"], "6 x 6 sites of BGR"),
    # Regression: LibRaw takes the first four colours of the next for the pattern, so it was read as Bayer.
    "four columns": (["RGGB", "RGGB", "GRBG", "BGGR"], "4 x 4 sites of BGR"),
}


@pytest.mark.parametrize(("pattern", "words"), NAMED.values(), ids=NAMED)
def test_a_colour_filter_array_by_name(pattern: list[str], words: str, tmp_path: Path) -> None:
    write_plain_dng(tmp_path / "a.dng", random_mosaic(72, 72), pattern)
    refused(tmp_path / "a.dng", f"unsupported colour filter array: {words}")


@pytest.mark.parametrize(
    ("numbers", "words"), [((3, 4, 5, 1), r"CYGM \(cyan.*2 x 2 sites of CGMY"), ((0, 1, 6, 2), r"RGBW \(with white")]
)
def test_other_colours_by_name(numbers: tuple[int, ...], words: str, tmp_path: Path) -> None:
    """LibRaw calls any four colours CYGM."""
    planes = bytes(numbers)
    tags: list[Tag] = [(33421, "H", 2, (2, 2), True), (33422, "B", 4, planes, True), (50710, "B", 4, planes, True)]
    write_plain_dng(tmp_path / "a.dng", random_mosaic(64, 66), None, *tags)
    refused(tmp_path / "a.dng", words)


@pytest.mark.parametrize("layout", [2, 4])
def test_staggered_rows_are_no_bayer(layout: int, tmp_path: Path) -> None:
    """Regression: but for layout 2 LibRaw ignores it, and the mosaic was read as if its rows were straight."""
    write_plain_dng(tmp_path / "a.dng", random_mosaic(64, 66), ("RG", "GB"), (50711, "H", 1, layout, True))
    refused(tmp_path / "a.dng", f"its CFALayout is {layout} ")


def test_a_compression_that_libraw_cannot_decode(tmp_path: Path) -> None:
    path = tmp_path / "GOPR0001.GPR"
    write_plain_dng(path, random_mosaic(64, 66))
    entry = struct.pack("<HHI", 259, 3, 1)
    path.write_bytes(path.read_bytes().replace(entry + b"\1\0", entry + b"\x09\0"))
    refused(path, "is a GPR .*gpr_tools -i")


@pytest.mark.parametrize(
    ("head", "words"),
    [(b"FOVb", "is a Sigma X3F, .*Foveon"), (b"II\x1a\0\0\0HEAPCCDR", "is a CRW .*Adobe DNG Converter")],
)
def test_containers_that_are_known_not_to_work(head: bytes, words: str, tmp_path: Path) -> None:
    (tmp_path / "a.X3F").write_bytes(head + bytes(1000))
    refused(tmp_path / "a.X3F", words)


@pytest.mark.parametrize("tag", ["BlackLevel", "WhiteLevel", "BlackLevelDeltaH"])
def test_a_level_over_0_is_refused_and_not_taken_for_0(tag: str, tmp_path: Path) -> None:
    number = {"BlackLevel": 50714, "WhiteLevel": 50717, "BlackLevelDeltaH": 50715}[tag]
    tags: list[Tag] = [(number, "2I", 1, (512, 0), True)]
    write_plain_dng(tmp_path / "a.dng", random_mosaic(64, 66), ("RG", "GB"), *tags, white=None)
    refused(tmp_path / "a.dng", f"its {tag} is not a number")


@pytest.mark.parametrize("white", [400, 100])
def test_white_not_above_black(white: int, tmp_path: Path) -> None:
    write_plain_dng(tmp_path / "a.dng", random_mosaic(64, 66), ("RG", "GB"), (50714, "I", 1, 400, True), white=white)
    refused(tmp_path / "a.dng", f"white level {white} DN is not above the black level", [read_raw])
