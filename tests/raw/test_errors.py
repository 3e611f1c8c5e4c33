"""Files that cannot be used: each is refused by one error that names the file and the reason."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import imagecodecs
import numpy as np
import pytest
import tifffile
from PIL import Image

from eldata.errors import RawFileError, UnusableRawError
from eldata.isp import render_libraw
from eldata.raw import read_header, read_raw, write_dng
from tests.cases import in_one_test
from tests.raw.helpers import (
    DNG_KINDS,
    EXPOSURE,
    XTRANS,
    Tag,
    active_area,
    add_tags,
    check_refused,
    letters,
    make_sensor,
    opcode_list,
    random_mosaic,
    write_plain_dng,
)


@pytest.fixture(autouse=True)
def only_libraw_prints(capfd: pytest.CaptureFixture[str]) -> Iterator[None]:
    """Python prints and logs nothing; LibRaw's C code may print a line of its own on a damaged file."""
    yield
    captured = capfd.readouterr()
    assert captured.out == ""
    printed = [line for line in captured.err.splitlines() if "Unexpected end of file" not in line]
    assert [line for line in printed if "data corrupted at" not in line] == []


def test_a_missing_file(tmp_path: Path) -> None:
    (tmp_path / "b.ARW").symlink_to(tmp_path / "gone.ARW")
    for name in ("a.ARW", "no folder/a.ARW", "b.ARW"):
        check_refused(tmp_path / name, "cannot be read: No such file or directory")


@pytest.mark.parametrize("kind", ["JPEG", "PNG", "TIFF"])
def test_an_ordinary_image_named_as_a_raw_file(kind: str, tmp_path: Path) -> None:
    pixels = (random_mosaic(64, 3 * 64) >> 8).astype(np.uint8).reshape(64, 64, 3)
    Image.fromarray(pixels).save(tmp_path / "a.ARW", kind)
    check_refused(tmp_path / "a.ARW", "is a JPEG picture" if kind == "JPEG" else "not a raw file that LibRaw knows")


@in_one_test(
    "content, words",
    [
        *((content, ".") for content in (b"\0" * 5000, b"\xff" * 5000, b"II*\0" * 1000, b"MM\0*" * 1000, b"II*\0")),
        (b"x\n" * 5000, "."),
        (b"FOVb", "is a Sigma X3F, .*Foveon"),
        (b"II\x1a\0\0\0HEAPCCDR", "is a CRW .*Adobe DNG Converter"),
        (b"PK\x03\x04", "is a ZIP archive .*unpack it"),
        *(
            (magic, "is an array, .*state them in the mosaics")
            for magic in (b"\x93NUMPY", b"MATLAB 5.0", b"\x89HDF\r\n")
        ),
    ],
)
def test_noise(content: bytes, words: str, tmp_path: Path) -> None:
    (tmp_path / "a.dng").write_bytes(content + bytes(1000 if len(content) > 4 else 0))
    check_refused(tmp_path / "a.dng", words)


# --- truncated ----------------------------------------------------------------------------------------------


def written(path: Path, kind: str) -> tuple[bytes, int]:
    """Write a DNG of a kind; return its bytes, and where its pixels end."""
    cfa, compression = DNG_KINDS[kind]
    write_dng(path, random_mosaic(24, 26), make_sensor(cfa, 24, 26), EXPOSURE, compression=compression)
    with tifffile.TiffFile(path) as tiff:
        return path.read_bytes(), tiff.pages.first.dataoffsets[0] + tiff.pages.first.databytecounts[0]


@pytest.mark.parametrize("kind", DNG_KINDS)
def test_a_file_cut_anywhere_before_its_exif_is_refused(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "a.dng"
    data, end = written(path, kind)
    for length in [*range(0, 400, 3), *range(400, end, 29)]:
        path.write_bytes(data[:length])
        check_refused(path, ".", read_raw)
    path.write_bytes(data[: end - 1])
    check_refused(path, rf"truncated: it declares data up to byte \d+ but has {end - 1} bytes; copy or download it")


# Regression: EXIF stands behind the pixels. Where its last values are cut off exifread makes up numbers
# (1/30 s becomes 1/1, 255/256, 1/4294967296...) or leaves them out, logs "Unexpected slice length" on stderr,
# and read_raw returns them as the exposure.
@pytest.mark.parametrize("kind", DNG_KINDS)
def test_a_file_cut_inside_of_its_exif_never_gives_another_exposure(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "a.dng"
    data, end = written(path, kind)
    for length in range(end, len(data)):
        path.write_bytes(data[:length])
        for read in (read_raw, read_header):
            try:
                assert read(path).exposure == EXPOSURE
            except RawFileError:
                continue


def test_a_last_row_of_zeros_far_below_black(tmp_path: Path) -> None:
    path, mosaic = tmp_path / "a.dng", random_mosaic(64, 66)
    mosaic[-1] = 0
    write_plain_dng(path, mosaic, ("RG", "GB"), (50714, "I", 1, 400, True))
    check_refused(path, "last row is all 0 DN", read_raw)
    write_plain_dng(path, mosaic, ("RG", "GB"))  # black 0: zeros are dark
    np.testing.assert_array_equal(read_raw(path).mosaic, mosaic)


# --- by name ------------------------------------------------------------------------------------------------

REPEAT, BLACK, WHITE, DELTA, MASKED = 50713, 50714, 50717, 50715, 50830
COMPRESSION, LINEAR = 259, (262, "H", 1, 34892, True)  # PhotometricInterpretation: LinearRaw
MOSAIC = random_mosaic(72, 72)
NAN = float("nan")
WRITE = r"; read its pixels with tifffile and write a DNG whose mosaic is one uint16 plane \(eldata\.raw\.write_dng\)"


@dataclass
class Case:
    """A DNG that tifffile writes, and what its error says; ``changed``: tags that tifffile would not write."""

    words: str
    tags: Sequence[Tag] = ()
    pattern: Sequence[str] | None = ("RG", "GB")
    changed: Sequence[Tag] = ()
    data: Any = None
    options: dict[str, Any] = field(default_factory=dict)


def tag(code: int, kind: str, *values: float) -> Tag:
    return code, kind, len(values) // len(kind), values, True


def in_blocks(side: int) -> list[str]:
    return ["".join(colour * side for colour in row) for row in ("RG", "GB") for _ in range(side)]


def of_planes(*numbers: int) -> list[Tag]:
    return [tag(33421, "H", 2, 2), *((code, "B", 4, bytes(numbers), True) for code in (33422, 50710))]


REFUSED = [
    # levels
    Case("BlackLevel has 2 numbers, expected 4 .*write it again", [tag(REPEAT, "H", 2, 2), tag(BLACK, "I", 1, 2)]),
    Case("its BlackLevel has 4 numbers, expected 1 by", [tag(REPEAT, "H", 2), tag(BLACK, "I", 1, 2, 3, 4)]),
    Case("its BlackLevel has 1 number, expected 2 by", [tag(REPEAT, "H", 1, 2), tag(BLACK, "I", 64)]),
    Case("no BlackLevel, only the MaskedAreas.*measure", [active_area(0, 2, 64, 66), tag(MASKED, "I", 0, 0, 64, 2)]),
    Case("damaged: its BlackLevel is not a number", [tag(BLACK, "d", NAN)]),
    # which LibRaw takes for 0
    Case("damaged: its BlackLevel is not a number", [tag(BLACK, "2I", 512, 0)]),
    Case("damaged: its WhiteLevel is not a number", [tag(WHITE, "2I", 512, 0)], options={"white": None}),
    Case("damaged: its BlackLevelDeltaH is not a number", [tag(DELTA, "2I", 512, 0)]),
    # numbers that are missing or impossible
    Case("damaged: expected 2 numbers .* tag 50713", [tag(REPEAT, "H", 2, 2, 1), tag(BLACK, "H", 1, 2, 3, 4)]),
    Case(r"damaged: its BlackLevel repeats every \(0, 0\) pixels", [tag(REPEAT, "H", 0, 0), tag(BLACK, "H", 1)]),
    Case(r"damaged: its BlackLevel repeats every \(1, 65\)", [tag(REPEAT, "H", 1, 65), tag(BLACK, "H", *[1] * 65)]),
    Case("damaged: expected 4 numbers .* tag 50830", [tag(MASKED, "I", *(0, 0, 1, 1) * 9)]),  # more than any camera's
    Case("damaged: expected 4 numbers .* tag 50829", [tag(50829, "I", 0, 0)]),
    Case("damaged: expected 4 numbers from 0 on as its tag 50829; found -8", [tag(50829, "i", -8, -8, 60, 60)]),
    Case("damaged: expected 2 numbers .* tag 33421", [tag(33421, "H", 2)], None),
    Case("damaged: its list of opcodes .* 40 bytes", [opcode_list(2, 9, declared=2**32 - 1)]),
    Case("truncated: its image data, 40 bytes, cannot hold", changed=[tag(COMPRESSION, "H", 7), tag(279, "I", 40)]),
    # layouts and compressions
    *(
        Case(f"has interleaved {name.lower()}s .its {name}InterleaveFactor is {number}", [tag(code, "I", number)])
        for name, code, number in [("Row", 50975, 0), ("Row", 50975, 2), ("Column", 52547, 2), ("Column", 52547, 70000)]
    ),
    *(
        Case("is a DNG of whole numbers in Deflate compression", options={"compression": name})
        for name in ("deflate", "adobe_deflate")
    ),
    Case("is a GPR .*gpr_tools -i", changed=[tag(COMPRESSION, "H", 9)]),
    Case("has pixels that are floating-point numbers", changed=[LINEAR], data=MOSAIC.astype(np.float32)),
    # Regression: but for layout 2 LibRaw ignores it, and the mosaic was read as if its rows were straight.
    *(Case(f"its CFALayout is {layout} ", [tag(50711, "H", layout)]) for layout in (2, 4)),
    # Regression: the greens side by side or in one column, and any 6 x 6 of R, G and B, are taken for Bayer
    # and X-Trans; of "RB", "GG" the record even has a CFA without channel 1 and three black levels.
    *(
        Case("unsupported colour filter array: .* sites of BGR", pattern=pattern)
        for pattern in [
            *(("RG", "RB"), ("RB", "GG"), ("GG", "RB"), ("RG", "BG"), ("GR", "GB")),
            *(("RRGG", "GGBB", "RRGG", "GGBB"), ("RGGRRB",) * 6, ("RGBRGB", "GBRGBR", "BRGBRG") * 2),
            (*letters(XTRANS["xtrans-00"])[:5], "GGRGGR"),
        ]
    ),
    Case("array: 8 x 8 sites of BGR", pattern=in_blocks(4)),
    Case("array: 4 x 4 sites of BGR", pattern=[*in_blocks(2)[:3], "GGBG"]),
    Case("array: 6 x 6 sites of BGR", pattern=[*in_blocks(3)[:5], "GGGBBG"]),
    # Regression: LibRaw takes the first four colours for the pattern, so it was read as Bayer.
    Case("array: 4 x 4 sites of BGR", pattern=["RGGB", "RGGB", "GRBG", "BGGR"]),
    # LibRaw calls any four colours CYGM.
    Case("array: 2 x 2 sites of CGMY", of_planes(3, 4, 5, 1), None),
    Case("array: 2 x 2 sites of BGRW", of_planes(0, 1, 6, 2), None),
]
OF_COLOURS = {"photometric": 34892, "planarconfig": 1}
# Only their samples show it.
REFUSED_DECODED = [
    *(
        Case(f"white level {white} DN is not above the black level", [tag(BLACK, "I", 400)], options={"white": white})
        for white in (400, 100)
    ),
    *(Case("no colour filter array", pattern=pattern) for pattern in (None, ("RR", "RR"))),
    Case("already demosaiced", pattern=None, data=MOSAIC.reshape(24, 72, 3), options=OF_COLOURS),
]


@in_one_test(
    "case, readers",
    [*((case, (read_raw, read_header)) for case in REFUSED), *((case, (read_raw,)) for case in REFUSED_DECODED)],
)
def test_it_is_refused_by_name(case: Case, readers: Sequence[Callable[[Path], object]], tmp_path: Path) -> None:
    path = tmp_path / "a.dng"
    write_plain_dng(path, MOSAIC if case.data is None else case.data, case.pattern, *case.tags, **case.options)
    add_tags(path, *case.changed)
    error = check_refused(path, case.words, *readers)
    of_damage = case.words.startswith(("damaged", "truncated", "white level"))
    assert isinstance(error, UnusableRawError) is not of_damage


def write_jpeg_xl(path: Path, mosaic: Any) -> None:
    stream = bytes(imagecodecs.jpegxl_encode(mosaic, bitspersample=16, effort=1, lossless=True))
    layout: dict[str, Any] = {"shape": mosaic.shape, "dtype": np.uint16, "rowsperstrip": len(mosaic)}
    write_plain_dng(path, iter([stream]), ("RG", "GB"), compression=52546, **layout)


@pytest.mark.parametrize("mosaic", [MOSAIC, np.full((64, 96), 300, np.uint16)], ids=["noise", "flat"])
def test_jpeg_xl_is_named(mosaic: Any, tmp_path: Path) -> None:
    """Also of less than a bit for each pixel, where all are alike; and of a demosaiced image, as phones write it."""
    write_jpeg_xl(tmp_path / "a.dng", mosaic)
    words = r"pixels in JPEG XL \(its Compression is 52546\).*a version before 1\.7 \(Compatib"
    check_refused(tmp_path / "a.dng", words, read_raw, read_header, render_libraw)
    add_tags(tmp_path / "a.dng", LINEAR)
    check_refused(tmp_path / "a.dng", words)
