"""Small files that readers get wrong, and others that LibRaw reads in another way than they are meant.

They are read rightly, or refused by the name of the field, with what to do.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from eldata.isp import render_libraw
from eldata.raw import read_header, read_raw, write_dng
from eldata.raw.container import read_container, refuse_unsupported
from eldata.raw.reading import check_one_image
from tests.cases import in_one_test
from tests.raw.helpers import (
    BAYER,
    CFAS,
    Tag,
    active_area,
    add_tags,
    check_refused,
    letters,
    opcode_list,
    random_mosaic,
    write_plain_dng,
)
from tests.raw.test_errors import WRITE

FIELD = Path(__file__).parent / "field"
BLACK = (50714, "I", 1, 64, True)


# --- what is read ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "black"),
    [
        ("black-deltaH-frac", 64.25),  # whose deltas are all 0
        ("black-repeatdim-count1", 64),
        ("two-cfa-images-proxy-first", 64),
        ("masked-areas-black-0", 0),
    ],
)
def test_a_field_file_has_its_level_and_comes_back(name: str, black: float, tmp_path: Path) -> None:
    found = read_raw(FIELD / f"{name}.dng")
    assert found.mosaic.dtype == np.uint16
    assert (found.sensor.black_level_dn, found.sensor.white_level_dn) == ((black,) * 4, 1023)
    write_dng(tmp_path / "a.dng", found.mosaic, found.sensor, found.exposure)
    again = read_raw(tmp_path / "a.dng")
    assert again.sensor == found.sensor
    np.testing.assert_array_equal(again.mosaic, found.mosaic)


@pytest.mark.parametrize("white", [None, 1023])
def test_what_the_image_does_not_state_is_not_taken_from_a_proxy(white: int | None, tmp_path: Path) -> None:
    """By the specification black is 0 then, and white the largest number."""
    tags: list[Tag] = [(33421, "H", 2, (2, 2), True), (33422, "B", 4, bytes((0, 1, 1, 2)), True)]
    levels: list[Tag] = [BLACK, (50717, "I", 1, 255, True), (50706, "B", 4, bytes((1, 4, 0, 0)), True)]
    with tifffile.TiffWriter(tmp_path / "a.dng") as tiff:
        options: Any = {"photometric": 32803, "metadata": None}
        proxy = random_mosaic(32, 48, low=64, high=200)
        tiff.write(proxy, subfiletype=1, subifds=1, extratags=[*tags, *levels], **options)
        own: list[Tag] = [] if white is None else [(50717, "I", 1, white, True)]
        tiff.write(random_mosaic(64, 96, low=100, high=1000), subfiletype=0, extratags=[*tags, *own], **options)
    sensor = read_raw(tmp_path / "a.dng").sensor
    assert (sensor.black_level_dn, sensor.white_level_dn) == ((0.0,) * 4, white or 65535.0)


def test_levels_are_those_of_the_image_that_is_read(tmp_path: Path) -> None:
    """A proxy stands first, with everything else: a black of 256, another phase, masked areas, deltas and noise."""
    path, plain = tmp_path / "a.dng", read_raw(FIELD / "two-cfa-images-proxy-first.dng")
    path.write_bytes((FIELD / "two-cfa-images-proxy-first.dng").read_bytes())
    profile = struct.pack("<2d", 1.0, 2.0)
    add_tags(
        path,
        (33422, "B", 4, bytes((2, 1, 1, 0)), True),
        (50717, "I", 1, 4095, True),
        (50830, "I", 4, (0, 0, 8, 8), True),
        (50715, "2i", 1, (40, 1), True),
        active_area(1, 0, 64, 96),
        opcode_list(2, 9),
        (51041, "B", len(profile), profile, True),
    )
    found = read_raw(path)
    assert found.sensor == plain.sensor
    assert (found.sensor.black_level_dn, found.sensor.white_level_dn) == ((64.0,) * 4, 1023.0)
    assert found.remarks == ()
    np.testing.assert_array_equal(found.mosaic, plain.mosaic)


# --- what is refused, and what to do ----------------------------------------------------------------------------

REFUSED = {
    "float32-hot-1.5.dng": r"has pixels that are floating-point numbers \(its SampleFormat is 3\)" + WRITE,
    "dual-pixel-2-samples.dng": r"several samples .* as of dual pixels \(its SamplesPerPixel is 2\)" + WRITE,
    "row-interleave-2.dng": r"has interleaved rows \(its RowInterleaveFactor is 2\)" + WRITE,
    "black-deltaH-columns.dng": r"row or column \(its BlackLevelDeltaH\)" + WRITE,
    "black-deltaV-slope.dng": r"row or column \(its BlackLevelDeltaV\)" + WRITE,
    "pidng-black4-nodim.dng": "its BlackLevel has 4 numbers, expected 1 by its BlackLevelRepeatDim: which is",
    "tif-gray16.tif": "is a grey TIFF, which states no colour filter array .*; use the camera's raw file, or state",
}


@in_one_test("name, words", REFUSED.items())
def test_a_field_file_is_refused_by_its_field(name: str, words: str) -> None:
    check_refused(FIELD / name, words, read_raw, read_header)
    if name != "tif-gray16.tif":
        check_refused(FIELD / name, words, render_libraw)


def write_shift(path: Path, mosaics: list[NDArray[np.uint16]], *, in_sub_ifds: bool) -> None:
    """A DNG of several images of one size with a black level each; previews are none of them."""
    first: list[Tag] = [
        (50706, "B", 4, bytes((1, 4, 0, 0)), True),
        (271, "s", 0, "Acme", True),
        (272, "s", 0, "N", True),
    ]
    with tifffile.TiffWriter(path) as tiff:
        if in_sub_ifds:
            preview = np.zeros((24, 32, 3), np.uint8)
            tiff.write(
                preview,
                photometric="rgb",
                compression="jpeg",
                subfiletype=1,
                subifds=len(mosaics),
                metadata=None,
                extratags=first,
            )
        for index, mosaic in enumerate(mosaics):
            tags: list[Tag] = [(33421, "H", 2, (2, 2), True), (33422, "B", 4, bytes((0, 1, 1, 2)), True)]
            tags += [(50714, "I", 1, 64 + index, True), (50717, "I", 1, 1023 + index, True)]
            tags += [(51041, "d", 2, (1e-4, 1e-7), True), *([] if in_sub_ifds else first)]
            tiff.write(mosaic, photometric=32803, subfiletype=0, metadata=None, extratags=tags)


@pytest.mark.parametrize("in_sub_ifds", [False, True])
def test_several_mosaics_of_one_size_are_named(in_sub_ifds: bool, tmp_path: Path) -> None:
    mosaics = [random_mosaic(64, 96, seed=seed, low=100, high=1000) for seed in range(4)]
    write_shift(tmp_path / "a.dng", mosaics, in_sub_ifds=in_sub_ifds)
    path, words = tmp_path / "a.dng", "holds 4 mosaics of one size .PhotometricInterpretation 32803., as of a pixel"
    check_refused(path, words, read_raw, read_header, render_libraw)
    # As LibRaw is asked of formats other than TIFF, whose images no directory lists.
    check_refused(path, "holds several images, .*dnglab convert --image-index", check_one_image)
    write_shift(path, mosaics[:1], in_sub_ifds=in_sub_ifds)
    check_one_image(path)
    np.testing.assert_array_equal(read_raw(path).mosaic, mosaics[0])
    assert read_raw(path).noise_profile == (1e-4, 1e-7)  # with the raw image, wherever that stands


@pytest.mark.parametrize("tag", [50706, 34310, 33422], ids=["DNG", "Leaf", "CFA"])
def test_cameras_raws_that_call_themselves_grey_are_not_meant(tag: int, tmp_path: Path) -> None:
    """What LibRaw says of them counts."""
    own: Any = [(tag, "B", 4, bytes((1, 4, 0, 0)), True)]
    tifffile.imwrite(tmp_path / "a.tif", random_mosaic(64, 96), metadata=None, extratags=own)
    refuse_unsupported(read_container(tmp_path / "a.tif"))


# --- tags in another spelling ---------------------------------------------------------------------------------


@in_one_test("order", ["<", ">"])
@in_one_test("area", [(0, 0, 60, 60), (1, 3, 61, 63)])
@in_one_test("name", [*BAYER, "quad-13"])
def test_a_cfa_pattern_of_16_bit_numbers_is_read(
    name: str, area: tuple[int, int, int, int], order: Any, tmp_path: Path
) -> None:
    """As of bytes, which LibRaw reads."""
    cfa, mosaic, tags = CFAS[name], random_mosaic(64, 64, low=100, high=900), (BLACK, active_area(*area))
    numbers = tuple("RGB".index(letter) for row in letters(cfa) for letter in row)
    pattern = (33421, "H", 2, (len(cfa),) * 2, True), (33422, "H", len(numbers), numbers, True)
    write_plain_dng(tmp_path / "short.dng", mosaic, None, *pattern, *tags, white=1023, byteorder=order)
    write_plain_dng(tmp_path / "bytes.dng", mosaic, letters(cfa), *tags, white=1023, byteorder=order)
    short, as_bytes = read_raw(tmp_path / "short.dng"), read_raw(tmp_path / "bytes.dng")
    assert short.sensor == as_bytes.sensor
    assert np.array_equal(short.mosaic, as_bytes.mosaic)


# --- opcodes: what is said of a file that is read rightly -----------------------------------------------------


@pytest.mark.parametrize("order", ["<", ">"])
def test_opcodes_are_named_and_not_applied(order: str, tmp_path: Path) -> None:
    """By their numbers in the DNG specification 1.7.1; a list is big-endian in any file."""
    lists = opcode_list(1, 4, 5), opcode_list(2, 9, 9, 9, 9, 10), opcode_list(3, 1, 3, 14, 77, 2**32 - 1, 0)
    path, mosaic = tmp_path / "a.dng", random_mosaic(64, 64)
    write_plain_dng(path, mosaic, ("RG", "GB"), *lists, byteorder=order)
    found = read_raw(path)
    assert found.remarks == read_header(path).remarks
    assert [remark.partition(": ")[0] for remark in found.remarks] == [
        "its OpcodeList1 (FixBadPixelsConstant, FixBadPixelsList) is not applied",
        "its OpcodeList2 (GainMap, DeltaPerRow) is not applied",
        "its OpcodeList3 (WarpRectilinear, FixVignetteRadial, WarpRectilinear2, unknown) is not applied",
    ]
    assert found.remarks[0] in repr(found)
    np.testing.assert_array_equal(found.mosaic, mosaic)


def test_a_file_without_opcodes_is_not_remarked_on(tmp_path: Path) -> None:
    empty = (opcode_list(2), (51022, "B", 4, b"\0\0\0\0", True))
    for tags in ((), empty):
        write_plain_dng(tmp_path / "a.dng", random_mosaic(64, 64), ("RG", "GB"), *tags)
        assert read_raw(tmp_path / "a.dng").remarks == ()
