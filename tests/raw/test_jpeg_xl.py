"""Mosaics in JPEG XL (DNG 1.7): as LibRaw reads the same mosaic uncompressed. libjxl's encoder makes the streams."""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING, Any

import imagecodecs
import numpy as np
import pytest
import tifffile

from eldata.errors import RawFileError, UnusableRawError
from eldata.isp import render_libraw
from eldata.raw import jpeg_xl, read_header, read_raw
from eldata.raw.sensor_facts import lossy_compression
from tests.raw.helpers import active_area, add_tags, black_levels, in_fields, random_mosaic, write_plain_dng

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from tests.raw.helpers import Tag

JPEG_XL, DISTANCE = 52546, 52553
LOSSY = "its JPEG XL compression is lossy: its noise is not the sensor's"


def encoded(pixels: NDArray[Any], *, bits: int = 16, **options: Any) -> bytes:
    options = options or {"lossless": True}
    return bytes(imagecodecs.jpegxl_encode(np.ascontiguousarray(pixels), bitspersample=bits, effort=3, **options))


def write_jpeg_xl(
    path: Path,
    stored: NDArray[Any],
    *tags: Tag,
    tile: tuple[int, int] | None = (32, 48),
    rows: int = 20,
    whole: bool = True,
    change: Any = lambda content: content,
    coding: dict[str, Any] | None = None,
    **options: Any,
) -> None:
    """Write a DNG. ``whole``: tiles beyond the edge are filled up; ``change``: made to each stream."""
    height, width = stored.shape
    down, across = tile or (rows, width)
    parts = [stored[y : y + down, x : x + across] for y in range(0, height, down) for x in range(0, width, across)]
    if tile and whole:
        parts = [np.pad(one, ((0, down - one.shape[0]), (0, across - one.shape[1])), mode="edge") for one in parts]
    layout: dict[str, Any] = {"tile": tile} if tile else {"rowsperstrip": rows}
    streams = iter([change(encoded(one, **coding or {})) for one in parts])
    layout |= {"shape": stored.shape, "dtype": np.uint16, "compression": JPEG_XL}
    write_plain_dng(path, streams, ("RG", "GB"), *tags, **layout, **options)


def interleave(rows: int, columns: int) -> tuple[Tag, Tag]:
    return (50975, "I", 1, rows, True), (52547, "I", 1, columns, True)


BLACK = black_levels(((64, 65), (66, 67)))
CURVE = tuple(int(value) for value in np.minimum(np.arange(5000) ** 1.02, 60000))
TAGS: dict[str, tuple[Tag, ...]] = {
    "black": BLACK,
    "nothing": (),
    "area": (*BLACK, active_area(1, 3, 61, 90)),
    "crop": (*BLACK, active_area(2, 4, 62, 90), (50719, "I", 2, (4, 4), True), (50720, "I", 2, (60, 40), True)),
    "masked": (active_area(8, 0, 64, 92), (50830, "I", 4, (0, 0, 8, 92), True)),
    "rows": (*BLACK, (50716, "2i", 64, tuple(n for y in range(64) for n in (y % 3, 2)), True)),
    "table": (*BLACK, (50712, "H", len(CURVE), CURVE, True)),
    "two numbers": (*BLACK, (50712, "H", 2, (3, 900), True)),
    "opcodes": (*BLACK, (51009, "B", 4, bytes(4), True)),
}


def bare(content: bytes) -> bytes:
    """As Adobe's converter writes it: what is in the last box of a container."""
    at = content.index(b"jxlc") + 4
    assert int.from_bytes(content[at - 8 : at - 4], "big") in (0, len(content) - at + 8)
    return content[at:]


LAYOUTS: dict[str, dict[str, Any]] = {
    "tiles": {},
    "strips": {"tile": None},
    "cut": {"whole": False},
    "bare": {"change": bare},
}


# Every tag in tiles, and every layout, in both orders.
WAYS = [*((name, "tiles", "<") for name in TAGS), *(("black", layout, order) for layout in LAYOUTS for order in "<>")]


@pytest.mark.parametrize(("name", "layout", "order"), WAYS)
def test_a_mosaic_is_what_libraw_reads_of_it_uncompressed(name: str, layout: str, order: Any, tmp_path: Path) -> None:
    mosaic = random_mosaic(64, 92, low=100, high=6000)
    write_jpeg_xl(tmp_path / "a.dng", mosaic, *TAGS[name], byteorder=order, **LAYOUTS[layout])
    write_plain_dng(tmp_path / "plain.dng", mosaic, ("RG", "GB"), *TAGS[name], byteorder=order)
    frame, plain = read_raw(tmp_path / "a.dng"), read_raw(tmp_path / "plain.dng")
    assert frame.mosaic.dtype == plain.mosaic.dtype
    assert np.array_equal(frame.mosaic, plain.mosaic)
    assert (frame.sensor, frame.exposure, frame.remarks) == (plain.sensor, plain.exposure, plain.remarks)
    assert lossy_compression(tmp_path / "a.dng") is None


@pytest.mark.parametrize("fields", [(2, 1), (1, 2), (2, 2), (3, 4)], ids=str)
def test_interleaved_fields_are_put_in_order_over_all_tiles(fields: tuple[int, int], tmp_path: Path) -> None:
    mosaic = random_mosaic(65, 91, low=100, high=6000)
    write_jpeg_xl(
        tmp_path / "a.dng", in_fields(mosaic, *fields), *BLACK, *interleave(*fields), active_area(2, 2, 65, 91)
    )
    assert np.array_equal(read_raw(tmp_path / "a.dng").mosaic, mosaic[2:, 2:])


def test_a_mosaic_of_8_bits_is_read(tmp_path: Path) -> None:
    mosaic = random_mosaic(64, 96, low=10, high=250).astype(np.uint8)
    write_jpeg_xl(tmp_path / "a.dng", mosaic, white=255, coding={"bits": 8, "lossless": True})
    frame = read_raw(tmp_path / "a.dng")
    assert frame.mosaic.dtype == np.uint16
    assert np.array_equal(frame.mosaic, mosaic)


# --- what is lossy ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("container", [False, True])
def test_a_lossy_mosaic_is_read_and_said_to_be_lossy(container: bool, tmp_path: Path) -> None:
    """tifffile puts the tiles together by itself."""
    mosaic = random_mosaic(64, 96, low=9000, high=15000)
    write_jpeg_xl(tmp_path / "a.dng", mosaic, coding={"distance": 0.2, "usecontainer": container})
    frame = read_raw(tmp_path / "a.dng")
    assert np.array_equal(frame.mosaic, tifffile.imread(tmp_path / "a.dng"))
    assert not np.array_equal(frame.mosaic, mosaic)
    assert frame.remarks == read_header(tmp_path / "a.dng").remarks == (LOSSY,)
    assert lossy_compression(tmp_path / "a.dng") == (
        "a DNG's lossy JPEG XL compression (convert from the original without it)"
    )


@pytest.mark.parametrize(("distance", "remarks"), [(0.0, ()), (0.5, (LOSSY,))])
def test_what_the_tag_says_counts(distance: float, remarks: tuple[str, ...], tmp_path: Path) -> None:
    write_jpeg_xl(tmp_path / "a.dng", random_mosaic(64, 96), (DISTANCE, "f", 1, distance, True))
    assert read_header(tmp_path / "a.dng").remarks == remarks


# --- samples of fewer bits ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("bits", [9, 10, 12, 14, 15])
def test_samples_are_dn_where_white_is_one_that_they_reach(bits: int, tmp_path: Path) -> None:
    mosaic = random_mosaic(64, 96, low=0, high=1 << bits)
    write_jpeg_xl(tmp_path / "a.dng", mosaic, white=(1 << bits) - 1, coding={"bits": bits, "lossless": True})
    frame = read_raw(tmp_path / "a.dng")
    assert np.array_equal(frame.mosaic, mosaic)
    assert frame.remarks == ()


@pytest.mark.parametrize("bits", [9, 10, 12, 14, 15])
def test_samples_are_scaled_where_levels_are_of_16_bits(bits: int, tmp_path: Path) -> None:
    """As Adobe's SDK has libjxl do it: a sample's share of the largest, of 65535."""
    mosaic = random_mosaic(64, 96, low=0, high=1 << bits)
    write_jpeg_xl(tmp_path / "a.dng", mosaic, white=60000, coding={"bits": bits, "lossless": True})
    frame = read_raw(tmp_path / "a.dng")
    shares = [[round(Fraction(int(value) * 65535, (1 << bits) - 1)) for value in row] for row in mosaic]
    assert frame.mosaic.tolist() == shares
    said = f"its samples of {bits} bits are scaled to 16, which its levels are for, as Adobe's software does"
    assert frame.remarks == read_header(tmp_path / "a.dng").remarks == (said,)


def test_a_table_says_which_samples_it_is_for(tmp_path: Path) -> None:
    mosaic = random_mosaic(64, 96, low=0, high=1024)
    coding = {"bits": 10, "lossless": True}
    for length, stored in ((1024, mosaic), (65536, np.rint(mosaic * (65535 / 1023)).astype(int))):
        table = tuple(int(value) for value in np.arange(length)[::-1] // 2)
        write_jpeg_xl(tmp_path / "a.dng", mosaic, (50712, "H", length, table, True), coding=coding)
        assert np.array_equal(read_raw(tmp_path / "a.dng").mosaic, np.array(table)[stored])


@pytest.mark.parametrize(("bits", "white"), [(10, 16383), (8, 65535), (12, 4096)])
def test_levels_that_samples_cannot_have_are_named(bits: int, white: int, tmp_path: Path) -> None:
    mosaic = random_mosaic(64, 96, low=0, high=200).astype(np.uint8 if bits == 8 else np.uint16)
    write_jpeg_xl(tmp_path / "a.dng", mosaic, white=white, coding={"bits": bits, "lossless": True})
    for read in (read_raw, read_header):
        with pytest.raises(UnusableRawError, match=f"samples of {bits} bits, but its WhiteLevel .* up to {white}"):
            read(tmp_path / "a.dng")


# --- what is refused ----------------------------------------------------------------------------------------------


def overwritten(content: bytes) -> bytes:
    return content[: len(content) // 2] + bytes(40) + content[len(content) // 2 + 40 :]


RGB = encoded(np.zeros((32, 48, 3), np.uint16))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda content: content[: len(content) // 2], "does not decode"),
        (lambda content: content[:-1], "does not decode"),
        (overwritten, "does not decode"),
        (lambda _: b"\xff\x0a\0", "breaks off within its header"),
        (lambda content: b"\xff\xd8" + content[2:], "does not begin as a"),
        (lambda _: RGB + bytes(1000), r"decodes to \(32, 48, 3\)"),
        (lambda _: encoded(np.zeros((32, 48, 2), np.uint16)), "has more channels than one"),
        (lambda _: encoded(np.zeros((2, 32, 48), np.uint16)), "has a preview, or several images"),
        (lambda _: encoded(np.zeros((32, 48), np.float32), bits=32), "holds floating-point numbers"),
        (lambda _: encoded(np.zeros((16, 48), np.uint16)), r"holds \(16, 48\) pixels; expected 32 x 48"),
    ],
)
def test_damaged_streams_are_found(change: Any, words: str, tmp_path: Path) -> None:
    write_jpeg_xl(tmp_path / "a.dng", random_mosaic(64, 96), change=change)
    with pytest.raises(RawFileError, match=f"damaged.*(JPEG|image data, from byte [0-9]+).*{words}"):
        read_raw(tmp_path / "a.dng")


def test_streams_of_other_bits_than_the_first_are_found(tmp_path: Path) -> None:
    streams = iter([encoded(np.zeros((32, 96), np.uint16), bits=bits) for bits in (12, 14)])
    layout: dict[str, Any] = {"shape": (64, 96), "dtype": np.uint16, "rowsperstrip": 32, "compression": JPEG_XL}
    write_plain_dng(tmp_path / "a.dng", streams, white=4095, **layout)
    with pytest.raises(RawFileError, match=r"damaged: .* samples of 14 bits; expected those of the first"):
        read_raw(tmp_path / "a.dng")


def test_an_absurd_size_takes_no_memory(tmp_path: Path) -> None:
    """One that a stream has, and one that the directory has."""
    import tracemalloc

    flat = encoded(np.zeros((3000, 3000), np.uint16))
    tracemalloc.start()
    write_jpeg_xl(tmp_path / "a.dng", random_mosaic(64, 96), change=lambda _: flat)
    with pytest.raises(RawFileError, match=r"it holds \(3000, 3000\) pixels; expected 32 x 48"):
        read_raw(tmp_path / "a.dng")
    write_jpeg_xl(tmp_path / "a.dng", random_mosaic(64, 96), tile=None)
    add_tags(tmp_path / "a.dng", (256, "I", 1, 60000, True), (257, "I", 1, 60000, True))
    with pytest.raises(RawFileError, match=r"truncated: its image data, .* cannot hold 3600000000 pixels"):
        read_raw(tmp_path / "a.dng")
    assert tracemalloc.get_traced_memory()[1] < 1 << 23
    tracemalloc.stop()


def test_whatever_bytes_are_changed_nothing_but_a_raw_file_error_comes(tmp_path: Path) -> None:
    """100 files with some bytes of their streams changed, in their headers half of the time."""
    generator = np.random.default_rng(0)

    def change(content: bytes) -> bytes:
        changed = bytearray(content)
        last = 30 if generator.random() < 0.5 else len(content)
        for place in generator.integers(2, last, 3):
            changed[place] = int(generator.integers(256))
        return bytes(changed)

    refused = 0
    for _ in range(100):
        write_jpeg_xl(tmp_path / "a.dng", random_mosaic(64, 96), change=change)
        try:
            read_raw(tmp_path / "a.dng")
        except RawFileError:
            refused += 1
    assert refused > 95


def test_more_samples_than_one_are_named(tmp_path: Path) -> None:
    write_jpeg_xl(tmp_path / "a.dng", random_mosaic(64, 96))
    add_tags(tmp_path / "a.dng", (277, "H", 1, 3, True))
    with pytest.raises(UnusableRawError, match="has 3 samples of each pixel in JPEG XL; expected 1"):
        read_raw(tmp_path / "a.dng")


def test_a_table_of_another_type_is_named_and_not_ignored(tmp_path: Path) -> None:
    write_jpeg_xl(tmp_path / "a.dng", random_mosaic(64, 96), (50712, "I", 2, (3, 900), True))
    with pytest.raises(UnusableRawError, match="has a LinearizationTable that is not of SHORTs"):
        read_raw(tmp_path / "a.dng")


def test_floats_are_named(tmp_path: Path) -> None:
    write_jpeg_xl(tmp_path / "a.dng", random_mosaic(64, 96))
    add_tags(tmp_path / "a.dng", (339, "H", 1, 3, True))
    with pytest.raises(UnusableRawError, match="floating-point pixels have a Compression of 52546, not one of 1, 8"):
        read_raw(tmp_path / "a.dng")


def test_a_linear_raw_is_no_mosaic(tmp_path: Path) -> None:
    """As phones write it (Expert RAW, ProRAW)."""
    options: dict[str, Any] = {"photometric": 34892, "compression": JPEG_XL, "white": 65535}
    write_plain_dng(tmp_path / "a.dng", np.dstack([random_mosaic(64, 96)] * 3), None, **options)
    with pytest.raises(UnusableRawError, match="already demosaiced"):
        read_raw(tmp_path / "a.dng")


def test_a_preview_in_jpeg_xl_changes_nothing(tmp_path: Path) -> None:
    mosaic = random_mosaic(64, 96, low=100, high=1000)
    tags: list[Tag] = [(50706, "B", 4, bytes((1, 7, 1, 0)), True), (271, "s", 0, "A", True), (272, "s", 0, "B", True)]
    cfa: list[Tag] = [(33421, "H", 2, (2, 2), True), (33422, "B", 4, bytes((0, 1, 1, 2)), True)]
    with tifffile.TiffWriter(tmp_path / "a.dng") as tiff:
        options: Any = {"metadata": None}
        preview = np.zeros((24, 32, 3), np.uint8)
        tiff.write(preview, photometric="rgb", subfiletype=1, subifds=1, compression=JPEG_XL, extratags=tags, **options)
        tiff.write(mosaic, photometric=32803, subfiletype=0, extratags=[*cfa, (50717, "I", 1, 1023, True)], **options)
    frame = read_raw(tmp_path / "a.dng")
    assert np.array_equal(frame.mosaic, mosaic)
    assert frame.remarks == ()


def test_libraws_own_rendering_is_refused(tmp_path: Path) -> None:
    tags: list[Tag] = [(50728, "2I", 3, (1, 2, 1, 1, 1, 2), True)]
    tags.append((50721, "2i", 9, tuple(n for value in (7, 0, 0, 0, 9, 0, 0, 0, 6) for n in (value, 10)), True))
    write_jpeg_xl(tmp_path / "a.dng", random_mosaic(64, 96), *tags)
    with pytest.raises(UnusableRawError, match=r"JPEG XL, which LibRaw does not decode; .*eldata\.isp\.Rendering"):
        render_libraw(tmp_path / "a.dng")


def test_a_decoder_that_is_missing_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    write_jpeg_xl(tmp_path / "a.dng", random_mosaic(64, 96))
    monkeypatch.setattr("eldata.raw.strips.can_decode", lambda: False)
    with pytest.raises(UnusableRawError, match=r"which this imagecodecs was built without; install imagecodecs"):
        read_header(tmp_path / "a.dng")


@pytest.mark.parametrize("container", [False, True])
@pytest.mark.parametrize("shape", [(64, 96), (64, 64), (33, 77), (90, 160), (80, 64), (96, 64), (2, 700), (9000, 3)])
def test_headers_say_what_decoding_gives(shape: tuple[int, int], container: bool) -> None:
    """Sizes of every spelling: in eights or not, with a known ratio of sides or not."""
    for bits in (9, 12, 16):
        content = encoded(np.zeros(shape, np.uint16), bits=bits, usecontainer=container, lossless=True)
        assert jpeg_xl.parse_header(content) == (jpeg_xl.decode_stream(content).shape, bits, False)
