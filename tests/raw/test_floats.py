"""Floating-point DNGs: what they hold, on the scale of their own levels. The files are made by another code's rules."""

from __future__ import annotations

import zlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import imagecodecs
import numpy as np
import pytest
import tifffile

from eldata.errors import ArgumentError, DatasetError, RawFileError
from eldata.raw import normalise, pack, pack_normalised, read_raw, write_dng
from eldata.raw.levels import packed_frame
from tests.raw.helpers import BAYER, EXPOSURE, active_area, add_tags, black_levels, make_sensor, write_plain_dng

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tests.raw.helpers import Tag

FIELD = Path(__file__).parent / "field"
DEFLATE = 8
# How many samples back each predictor of floats looks.
BACK = {3: 1, 34894: 2, 34895: 4}


def floats(height: int = 48, width: int = 52, seed: int = 0, bits: int = 32) -> NDArray[np.float32]:
    """Values around black with negative ones, as many bits as are asked for hold exactly."""
    values = np.random.default_rng(seed).normal(0.02, 0.05, (height, width)).astype(np.float32)
    if bits == 16:
        return values.astype(np.float16).astype(np.float32)
    if bits == 24:  # 16 bits of fraction
        return (values.view(np.uint32) & 0xFFFFFF80).view(np.float32)
    return values


def as_bytes(values: NDArray[np.float32], bits: int, order: str) -> bytes:
    if bits == 24:
        big = np.frombuffer(imagecodecs.float24_encode(values, byteorder=">"), np.uint8).reshape(-1, 3)
        return (big if order == ">" else big[:, ::-1]).tobytes()
    return values.astype(f"{order}f{bits // 8}").tobytes()


def predicted(values: NDArray[np.float32], bits: int, back: int) -> bytes:
    """The predictor of the DNG specification, 1.4 and later, row by row, byte by byte."""
    rows = []
    for row in values:
        samples = np.frombuffer(as_bytes(row, bits, ">"), np.uint8).reshape(-1, bits // 8)
        mixed = samples.T.reshape(-1).astype(int)
        rows.append(bytes(int(b - (mixed[i - back] if i >= back else 0)) % 256 for i, b in enumerate(mixed)))
    return b"".join(rows)


def write_float_dng(
    path: Path,
    values: NDArray[np.float32],
    *tags: Tag,
    bits: int = 32,
    compression: int = 1,
    predictor: int = 1,
    tile: tuple[int, int] | None = None,
    rows: int = 20,
    order: str = "<",
    change: Any = lambda content: content,
    **options: Any,
) -> None:
    """Write a floating-point DNG. ``change``: made to each strip or tile when it is encoded."""
    height, width = values.shape
    down, across = tile or (rows, width)
    segments = []
    for top in range(0, height, down):
        for left in range(0, width, across):
            part = values[top : top + down, left : left + across]
            if tile is not None:
                part = np.pad(part, ((0, down - part.shape[0]), (0, across - part.shape[1])))
            coded = predicted(part, bits, BACK[predictor]) if predictor > 1 else as_bytes(part, bits, order)
            segments.append(change(zlib.compress(coded) if compression != 1 else coded))
    # tifffile knows no floats of 24 bits: it writes the strips as they come, and is told afterwards what they are.
    write_plain_dng(
        path,
        iter(segments),
        ("RG", "GB"),
        *tags,
        shape=values.shape,
        dtype=np.float32,
        compression=DEFLATE,
        predictor=3 if predictor > 1 else None,
        byteorder=order,
        **({"tile": tile} if tile else {"rowsperstrip": rows}),
        **options,
    )
    with tifffile.TiffFile(path, mode="r+") as file:
        page = file.pages.first
        page.tags[258].overwrite(bits)
        page.tags[259].overwrite(compression)
        if predictor > 1:
            page.tags[317].overwrite(predictor)


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("tile", [None, (32, 16)], ids=["strips", "tiles"])
@pytest.mark.parametrize(
    ("bits", "compression", "predictor"),
    [
        *((bits, 1, 1) for bits in (16, 24, 32)),
        *((bits, DEFLATE, predictor) for bits in (16, 24, 32) for predictor in (1, *BACK)),
    ],
)
def test_every_way_to_store_floats_is_read_to_the_bit(
    bits: int, compression: int, predictor: int, tile: tuple[int, int] | None, order: str, tmp_path: Path
) -> None:
    values = floats(bits=bits)
    write_float_dng(
        tmp_path / "a.dng",
        values,
        bits=bits,
        compression=compression,
        predictor=predictor,
        tile=tile,
        order=order,
        white=1,
    )
    frame = read_raw(tmp_path / "a.dng")
    assert frame.mosaic.dtype == np.float32
    assert np.array_equal(frame.mosaic, values)
    assert (values < 0).any()
    assert (frame.sensor.black_level_dn, frame.sensor.white_level_dn) == ((0.0,) * 4, 1.0)


@pytest.mark.parametrize("bits", [16, 32])
def test_tifffiles_own_floats_are_read(bits: int, tmp_path: Path) -> None:
    values = floats(bits=bits)
    stored: Any = values.astype(f"f{bits // 8}")
    write_plain_dng(tmp_path / "a.dng", stored, white=None, compression="adobe_deflate", predictor=3, tile=(16, 32))
    frame = read_raw(tmp_path / "a.dng")
    assert np.array_equal(frame.mosaic, values)
    assert frame.sensor.white_level_dn == 1  # the specification's, where none is stated


def test_floats_behind_a_preview_are_read(tmp_path: Path) -> None:
    """As HDRMerge lays its files out: levels and CFA stand in the sub-IFD; a proxy beside it is not read."""
    values = floats(96, 128)
    first: list[Tag] = [(50706, "B", 4, bytes((1, 4, 0, 0)), True), (271, "s", 0, "A", True), (272, "s", 0, "B", True)]
    cfa: list[Tag] = [(33421, "H", 2, (2, 2), True), (33422, "B", 4, bytes((1, 0, 2, 1)), True)]
    cfa += [(50714, "2I", 1, (1, 100), True), (50717, "I", 1, 2, True)]
    with tifffile.TiffWriter(tmp_path / "a.dng") as tiff:
        options: Any = {"metadata": None, "photometric": 32803}
        preview = np.zeros((24, 32, 3), np.uint8)
        tiff.write(preview, photometric="rgb", subfiletype=1, subifds=2, metadata=None, extratags=first)
        proxy = np.full((48, 64), 300, np.uint16)
        tiff.write(proxy, subfiletype=1, extratags=[*cfa[:2], (50714, "I", 1, 256, True)], **options)
        coded: Any = {"tile": (32, 32), "compression": "adobe_deflate", "predictor": 3}
        tiff.write(values, subfiletype=0, extratags=cfa, **coded, **options)
    frame = read_raw(tmp_path / "a.dng")
    assert np.array_equal(frame.mosaic, values)
    assert (frame.sensor.black_level_dn, frame.sensor.white_level_dn) == ((0.01,) * 4, 2.0)
    assert frame.sensor.cfa == BAYER["GRBG"]


def test_one_bright_pixel_changes_no_other() -> None:
    """LibRaw's integers are scaled by the brightest pixel."""
    frame = read_raw(FIELD / "float32-hot-1.5.dng")
    assert frame.mosaic.max() == 1.5
    assert frame.mosaic.mean(dtype=np.float64) == pytest.approx(0.2248, abs=5e-5)
    packed = pack(frame.mosaic, frame.sensor.cfa).reshape(4, -1)
    assert np.median(packed, axis=1) == pytest.approx([0.18, 0.30, 0.12, 0.30], abs=0.002)


@pytest.mark.parametrize("area", [(1, 0, 46, 52), (0, 3, 48, 51), (1, 1, 47, 51)])
def test_levels_and_phase_are_those_of_the_active_area(area: tuple[int, int, int, int], tmp_path: Path) -> None:
    """A file of the same numbers, whole ones, lies on it: LibRaw decodes that."""
    values = np.rint(floats() * 4000 + 900)
    tags = active_area(*area), *black_levels(((64, 65), (66, 67)))
    write_float_dng(tmp_path / "a.dng", values, *tags, white=4095)
    write_plain_dng(tmp_path / "whole.dng", values.astype(np.uint16), ("RG", "GB"), *tags, white=4095)
    frame, whole = read_raw(tmp_path / "a.dng"), read_raw(tmp_path / "whole.dng")
    assert np.array_equal(frame.mosaic, whole.mosaic)
    assert frame.sensor == whole.sensor
    assert set(whole.sensor.black_level_dn) == {64, 65, 66, 67}


def test_a_float_mosaic_comes_back_to_the_bit(tmp_path: Path) -> None:
    mosaic = floats(60, 64) * 15000 + 512
    sensor = make_sensor(black_level_dn=(512.25, 509.5, 511.0, 514.0))
    write_dng(tmp_path / "a.dng", mosaic, sensor, EXPOSURE)
    again = read_raw(tmp_path / "a.dng")
    assert again.mosaic.dtype == np.float32
    assert np.array_equal(again.mosaic, mosaic)
    assert (again.sensor, again.exposure) == (sensor, EXPOSURE)


def test_what_a_float_dng_cannot_hold_is_refused(tmp_path: Path) -> None:
    mosaic, sensor = floats(60, 64) * 15000 + 512, make_sensor()
    with pytest.raises(ArgumentError, match=r"lossless-jpeg.*whole numbers"):
        write_dng(tmp_path / "a.dng", mosaic, sensor, EXPOSURE, compression="lossless-jpeg")
    mosaic[3, 4] = np.nan
    with pytest.raises(ArgumentError, match="not finite"):
        write_dng(tmp_path / "a.dng", mosaic, sensor, EXPOSURE)
    assert not list(tmp_path.iterdir())


def test_a_float_frame_packs_like_its_numbers(tmp_path: Path) -> None:
    values = floats() * 4000 + 64
    write_float_dng(tmp_path / "a.dng", values, *black_levels(((64,),)), white=4095)
    frame = read_raw(tmp_path / "a.dng")
    cfa, black, white = frame.sensor.cfa, frame.sensor.black_level_dn, frame.sensor.white_level_dn
    expected = normalise(pack(values, cfa), cfa, black, white, clip="none")
    assert np.array_equal(packed_frame(frame, levels="metadata", clip="none"), expected)
    assert expected.min() < 0
    with pytest.raises(ArgumentError, match="corrected=True"):  # floats are mostly normalised already
        pack_normalised(frame.mosaic, cfa, black, white)


def test_shares_of_white_are_not_taken_for_dn() -> None:
    frame = read_raw(FIELD / "float32-hot-1.5.dng")
    assert packed_frame(frame, levels="metadata", clip="both").max() == 1
    with pytest.raises(DatasetError, match=r"float32-hot.*white level is 1, .* white level of 16383 .* is in DN"):
        packed_frame(frame, levels="published", clip="both")


def test_whole_dn_are_asked_for_by_name() -> None:
    frame = read_raw(FIELD / "float32-hot-1.5.dng")
    with pytest.raises(RawFileError, match=r"no whole DN, .*; a store needs whole DN: use the raw files"):
        frame.whole_dn("a store")
    whole = read_raw(FIELD / "dual-pixel-2-samples.dng")
    assert whole.whole_dn("a store") is whole.mosaic


@pytest.mark.parametrize(
    ("options", "changed", "words"),
    [
        ({"bits": 32, "predictor": 3}, {317: 2}, "floating-point pixels have a Predictor of 2, not one of 1, 3, 34894"),
        ({}, {258: 64}, "floating-point pixels have a BitsPerSample of 64, not one of 16, 24, 32"),
        ({}, {259: 5}, "floating-point pixels have a Compression of 5, not one of 1, 8"),
        ({}, {259: 32946}, "floating-point pixels have a Compression of 32946, not one of 1, 8"),
        ({"compression": 1}, {278: 4}, r"damaged: it declares 3 of 12 strips or tiles"),
        ({"compression": 1}, {278: 30}, "damaged: .* 4160 bytes cannot hold 30 x 52 pixels"),
        ({"tile": (32, 16)}, {322: 1 << 18}, "damaged: .* bytes cannot hold 32 x 262144 pixels"),
        ({"tile": (32, 16)}, {322: 1 << 20}, "damaged: its strips or tiles have far more pixels than 48 x 52"),
        ({"tile": (32, 16)}, {323: 0}, "damaged: one of the sizes that it declares is 0"),
    ],
)
def test_what_is_not_supported_or_cannot_be_is_named(
    options: dict[str, Any], changed: dict[int, int], words: str, tmp_path: Path
) -> None:
    write_float_dng(tmp_path / "a.dng", floats(), **{"compression": DEFLATE, **options})
    with tifffile.TiffFile(tmp_path / "a.dng", mode="r+") as file:
        for tag, value in changed.items():
            file.pages.first.tags[tag].overwrite(value)
    with pytest.raises(RawFileError, match=words):
        read_raw(tmp_path / "a.dng")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda content: content[:-40] + bytes(40), "does not decompress"),
        (lambda content: zlib.compress(zlib.decompress(content)[:-4]), "does not decompress to just the 4160 bytes"),
        (lambda content: content[:-1] + bytes([content[-1] ^ 1]), "does not decompress"),  # its checksum
    ],
    ids=["overwritten", "short", "checksum"],
)
def test_damaged_strips_are_found(change: Any, words: str, tmp_path: Path) -> None:
    write_float_dng(tmp_path / "a.dng", floats(), compression=DEFLATE, change=change)
    with pytest.raises(RawFileError, match=f"damaged: its image data, from byte [0-9]+ .*{words}"):
        read_raw(tmp_path / "a.dng")


def test_a_bomb_takes_no_memory(tmp_path: Path) -> None:
    """One strip that would inflate to 128 MB, in a file that declares 10 kB of pixels."""
    bomb = zlib.compress(bytes(1 << 27))
    write_float_dng(tmp_path / "a.dng", floats(), compression=DEFLATE, rows=48, change=lambda _: bomb)
    import tracemalloc

    tracemalloc.start()
    with pytest.raises(RawFileError, match="does not decompress to just the 9984 bytes of its pixels"):
        read_raw(tmp_path / "a.dng")
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 1 << 25


def test_floats_that_are_no_mosaic_by_their_tags_are_not_libraws(tmp_path: Path) -> None:
    """LibRaw would make integers of them."""
    write_float_dng(tmp_path / "a.dng", floats(), white=1)
    add_tags(tmp_path / "a.dng", (262, "H", 1, 34892, True))
    with pytest.raises(RawFileError, match="its pixels are floating-point numbers, and no mosaic by its tags"):
        read_raw(tmp_path / "a.dng")


def test_a_linearization_table_beside_floats_is_named(tmp_path: Path) -> None:
    write_float_dng(tmp_path / "a.dng", floats(), (50712, "H", 4, (0, 1, 2, 3), True))
    with pytest.raises(RawFileError, match="floating-point numbers with a LinearizationTable"):
        read_raw(tmp_path / "a.dng")


def test_of_two_samples_of_floats_the_first_is_taken(tmp_path: Path) -> None:
    both = np.stack([floats(), floats(seed=1)])
    for planes, stored in (("contig", np.moveaxis(both, 0, -1)), ("separate", both)):
        options: Any = {"photometric": 1, "planarconfig": planes, "compression": "adobe_deflate", "predictor": 3}
        write_plain_dng(tmp_path / "a.dng", np.ascontiguousarray(stored), ("RG", "GB"), white=None, **options)
        add_tags(tmp_path / "a.dng", (262, "H", 1, 32803, True))  # tifffile writes no CFA of two samples
        assert np.array_equal(read_raw(tmp_path / "a.dng").mosaic, both[0])


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_pixels_that_are_no_numbers_are_named(bad: float, tmp_path: Path) -> None:
    values = floats()
    values[7, 9] = values[8, 1] = bad
    write_float_dng(tmp_path / "a.dng", values)
    with pytest.raises(RawFileError, match="2 of its pixels are not finite numbers, the first in row 7, column 9"):
        read_raw(tmp_path / "a.dng")
