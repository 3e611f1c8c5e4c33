"""Reading files that someone else wrote: tifffile's DNG files and a RAF's shape with Pillow's EXIF."""

from __future__ import annotations

import io
import struct
from concurrent.futures import ThreadPoolExecutor
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import rawpy
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from eldata.raw import exposure_ratio, read_header, read_raw, write_dng
from eldata.raw.container import read_container
from eldata.raw.reading import check_sizes, visible_cfa
from eldata.records import Exposure, RawHeader
from tests.cases import in_one_test
from tests.raw.helpers import (
    BAYER,
    CFAS,
    EXPOSURE,
    NONA,
    QUAD,
    Cfa,
    Tag,
    active_area,
    add_tags,
    black_levels,
    check_refused,
    letters,
    levels_of,
    make_sensor,
    random_mosaic,
    write_plain_dng,
)

MARGINS = [(0, 0), (2, 4), (1, 0), (0, 1), (1, 3), (5, 2), (3, 3)]


def shifted(cfa: Cfa, down: int, right: int) -> Cfa:
    n = len(cfa)
    return tuple(tuple(cfa[(y + down) % n][(x + right) % n] for x in range(n)) for y in range(n))


def where(part: np.ndarray, whole: np.ndarray) -> tuple[int, int]:
    """Row and column of the one place in ``whole`` where ``part`` stands."""
    windows = np.lib.stride_tricks.sliding_window_view(whole, part.shape)
    found = np.argwhere((windows == part).all(axis=(2, 3)))
    assert len(found) == 1
    return int(found[0][0]), int(found[0][1])


@in_one_test("margins", MARGINS)
@in_one_test("name", [*BAYER, "xtrans-21", *QUAD, "nona-00", "nona-12", "nona-45"])
def test_phase_and_levels_are_those_of_the_visible_area(name: str, margins: tuple[int, int], tmp_path: Path) -> None:
    """CFAPattern and BlackLevel count from the active area's corner. LibRaw widens odd margins, but of 6 x 6."""
    path, whole, cfa = tmp_path / "a.dng", random_mosaic(64, 66), {**CFAS, **NONA}[name]
    stated = [Fraction(257, 4), Fraction(61), Fraction(1, 3), Fraction(62)][: levels_of(cfa)]
    at_sites = [stated[channel] for row in cfa for channel in row]
    parts = tuple(part for level in at_sites for part in level.as_integer_ratio())
    repeat = (50713, "H", 2, (len(cfa),) * 2, True)
    tags = active_area(*margins, 62, 65), repeat, (50714, "2I", len(parts) // 2, parts, True)
    write_plain_dng(path, whole, letters(cfa), *tags)
    frame = read_raw(path)
    top, left = where(frame.mosaic, whole)
    assert 0 <= top - margins[0] <= 1
    assert 0 <= left - margins[1] <= 1
    assert frame.sensor.cfa == shifted(cfa, top - margins[0], left - margins[1])
    assert frame.sensor.black_level_dn == tuple(map(float, stated))
    assert frame.mosaic.shape == (frame.sensor.height, frame.sensor.width)
    assert read_header(path).levels_dn == (float(sum(at_sites) / len(at_sites)), 16000.0)
    if name not in {**QUAD, **NONA}:  # of which LibRaw has other colours
        with rawpy.imread(str(path)) as raw:
            seen = [["RGBG"[raw.raw_color(top + y, left + x)] for x in range(len(cfa))] for y in range(len(cfa))]
        assert letters(frame.sensor.cfa) == ["".join(row) for row in seen]


@pytest.mark.parametrize("kind", ["f", "d"])
def test_a_level_written_as_a_float_is_exact(kind: str, tmp_path: Path) -> None:
    """LibRaw has 511 of it."""
    tags: list[Tag] = [(50713, "H", 2, (1, 2), True), (50714, kind, 2, (511.625, 512.0), True)]
    write_plain_dng(tmp_path / "a.dng", random_mosaic(64, 66), ("RG", "GB"), *tags)
    assert read_raw(tmp_path / "a.dng").sensor.black_level_dn == (511.625, 512, 512, 511.625)


@pytest.mark.parametrize("repeat", [(1, 3), (4, 2), (8, 8)])
def test_a_pattern_that_does_not_fit_the_cfa_is_named(repeat: tuple[int, int], tmp_path: Path) -> None:
    rows, columns = repeat
    levels = [[64] * columns for _ in range(rows)]
    write_plain_dng(tmp_path / "a.dng", random_mosaic(64, 66), ("RG", "GB"), *black_levels(levels))
    assert read_raw(tmp_path / "a.dng").sensor.black_level_dn == (64,) * 4  # one level whatever it repeats after
    levels[0][0] = 65
    write_plain_dng(tmp_path / "a.dng", random_mosaic(64, 66), ("RG", "GB"), *black_levels(levels))
    words = rf"BlackLevel .repeated every {rows} x {columns} pixels. differs between sites of one colour"
    check_refused(tmp_path / "a.dng", words, read_raw)


@pytest.mark.parametrize(
    ("height", "top", "words"),
    [
        (60, 6, "damaged: its visible area of 60 x 60 pixels from 6, 0 on does not lie inside"),
        (60000, 0, "truncated: "),
    ],
)
def test_sizes_that_cannot_be(height: int, top: int, words: str, tmp_path: Path) -> None:
    """As LibRaw makes them of a damaged file whose directories are not walked."""
    (tmp_path / "a.nef").write_bytes(bytes(5000))
    area = {"top_margin": top, "height": height, "left_margin": 0, "width": 60}
    raw: Any = SimpleNamespace(sizes=SimpleNamespace(raw_height=max(height, 64), raw_width=64, **area))
    check_refused(tmp_path / "a.nef", words, lambda path: check_sizes(path, raw))


def test_colours_of_which_the_file_states_nothing_are_libraws(tmp_path: Path) -> None:
    raw: Any = SimpleNamespace(color_desc=b"RGBG", sizes=SimpleNamespace(top_margin=1, left_margin=0))
    raw.raw_pattern, raw.raw_color = np.zeros((2, 2)), lambda y, x: ((0, 1), (3, 2))[y % 2][x % 2]
    assert visible_cfa(tmp_path, raw, None) == (BAYER["GBRG"], (0, 1, 2, 3))
    raw.color_desc = b"RGBE"
    check_refused(tmp_path, "array: 2 x 2 sites of BEGR", lambda path: visible_cfa(path, raw, None))
    raw.raw_pattern = None
    check_refused(tmp_path, "array: 0 x 0 sites", lambda path: visible_cfa(path, raw, None))


def test_the_exposure_ratio_is_exact(tmp_path: Path) -> None:
    exposures = {
        "long": Exposure(Fraction(100), Fraction(10)),
        "short": Exposure(Fraction(100), Fraction(1, 30)),
        "odd": Exposure(Fraction(102400), Fraction(3, 7)),
    }
    for name, exposure in exposures.items():
        write_dng(tmp_path / f"{name}.dng", random_mosaic(60, 64), make_sensor(), exposure)
    add_tags(tmp_path / "short.dng", (33434, "2I", 1, (1, 25), True))  # in the first directory: EXIF counts
    headers = {name: read_header(tmp_path / f"{name}.dng") for name in exposures}
    assert exposure_ratio(headers["long"], headers["short"]) == 300
    assert exposure_ratio(read_raw(tmp_path / "short.dng"), headers["long"]) == Fraction(1, 300)
    assert exposure_ratio(headers["long"], headers["odd"]) == Fraction(7000, 307200)


# --- RAF ----------------------------------------------------------------------------------------------------


def raf(**exif: Any) -> bytes:
    """The head of a RAF and its embedded JPEG, which holds its EXIF. There is no CFA data behind it."""
    image, jpeg = Image.new("RGB", (16, 8)), io.BytesIO()
    image.save(jpeg, "JPEG", **exif)
    head = b"FUJIFILMCCD-RAW 0201FF129502X-T2".ljust(84, b"\0") + struct.pack(">II", 160, len(jpeg.getvalue()))
    return head.ljust(160, b"\0") + jpeg.getvalue()


def test_the_exif_of_a_raf_is_that_of_its_embedded_jpeg(tmp_path: Path) -> None:
    path, exif = tmp_path / "a.RAF", Image.Exif()
    exif[271], exif[272] = "FUJIFILM", "X-T2"
    exif[0x8769] = {33434: IFDRational(1, 30), 33437: IFDRational(28, 10), 34855: 1600}
    path.write_bytes(raf(exif=exif) + b"pixels would follow")
    header = read_container(path).header
    assert (header.make, header.model) == ("FUJIFILM", "X-T2")
    assert (header.exposure.exposure_s, header.exposure.iso) == (Fraction(1, 30), Fraction(1600))
    for content in (raf(), raf()[:160] + bytes(2000)):  # no EXIF, and no JPEG
        path.write_bytes(content)
        assert read_container(path).header == RawHeader(path, "", "", Exposure())


@pytest.mark.parametrize("at", [84, 92, 100], ids=["JPEG", "CFA header", "CFA data"])
def test_a_raf_cut_inside_of_a_part(at: int, tmp_path: Path) -> None:
    path, data = tmp_path / "a.RAF", bytearray(raf())
    end = len(data) + 5000
    struct.pack_into(">II", data, at, len(data), 5000)
    path.write_bytes(data + bytes(4999))
    check_refused(path, f"declares data up to byte {end} but has {end - 1} bytes")
    struct.pack_into(">II", data, 84, 160, 1 << 25)
    path.write_bytes(data)
    check_refused(path, "damaged: it declares 33554432 bytes of EXIF, and no camera writes 16777216")


def test_a_maker_that_is_no_utf_8(tmp_path: Path) -> None:
    write_dng(tmp_path / "a.dng", random_mosaic(60, 64), make_sensor(make="Acme?"), EXPOSURE)
    content = (tmp_path / "a.dng").read_bytes()
    (tmp_path / "a.dng").write_bytes(content.replace(b"Acme?\0", b"Acm\xe9!\0"))
    assert read_header(tmp_path / "a.dng").make == "Acmé!"


def test_eight_threads_read_what_one_reads(tmp_path: Path) -> None:
    for number, cfa in enumerate([*BAYER.values(), CFAS["xtrans-00"], CFAS["xtrans-41"]]):
        compression: Any = "lossless-jpeg" if number % 2 else "none"
        mosaic = random_mosaic(240, 252, seed=number)
        write_dng(tmp_path / f"{number}.dng", mosaic, make_sensor(cfa, 240, 252), EXPOSURE, compression=compression)
    paths = sorted(tmp_path.iterdir())
    with ThreadPoolExecutor(8) as pool:
        frames = list(pool.map(read_raw, paths * 10))
    for frame, expected in zip(frames, [read_raw(path) for path in paths] * 10, strict=True):
        assert (frame.path, frame.sensor, frame.exposure) == (expected.path, expected.sensor, expected.exposure)
        np.testing.assert_array_equal(frame.mosaic, expected.mosaic)
