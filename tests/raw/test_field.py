"""Files that LibRaw reads in another way than they are meant: which image, which order, which of two samples."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import imagecodecs
import numpy as np
import pytest
import tifffile

from eldata.errors import ArgumentError, RawFileError, UnusableRawError
from eldata.isp import render_libraw
from eldata.raw import pack, read_header, read_raw, write_dng
from eldata.raw.libraw import count_images
from eldata.raw.tiff import read_directories
from eldata.raw.unsupported import refuse_unsupported
from tests.raw.helpers import (
    BAYER,
    EXPOSURE,
    active_area,
    add_tags,
    in_fields,
    letters,
    make_sensor,
    random_mosaic,
    write_plain_dng,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tests.raw.helpers import Tag

FIELD = Path(__file__).parent / "field"
SCENE = (0.18, 0.30, 0.12, 0.30)  # of R, G1, B, G2: what the files of tests/raw/field hold
BLACK = (50714, "I", 1, 64, True)


def signal_of(path: Path) -> NDArray[np.float64]:
    """Mean of each packed channel, normalised with the file's own levels."""
    frame = read_raw(path)
    packed = pack(frame.mosaic, frame.sensor.cfa).reshape(4, -1).astype(np.float64)
    black = np.array(frame.sensor.black_level_dn)
    signal: NDArray[np.float64] = (packed.mean(axis=1) - black) / (frame.sensor.white_level_dn - black)
    return signal


# --- the order of rows and columns ----------------------------------------------------------------------------


@pytest.mark.parametrize("compression", ["none", "lossless-jpeg"])
@pytest.mark.parametrize("fields", [(2, 1), (1, 2), (2, 2), (3, 4)], ids=str)
def test_interleaved_rows_and_columns_are_put_in_order(
    fields: tuple[int, int], compression: str, tmp_path: Path
) -> None:
    mosaic = random_mosaic(64, 90, low=100, high=1000)
    stored: Any = np.ascontiguousarray(in_fields(mosaic, *fields))
    options: dict[str, Any] = {}
    if compression == "lossless-jpeg":
        options = {"shape": stored.shape, "dtype": np.uint16, "compression": 7, "rowsperstrip": 64}
        stored = iter([bytes(imagecodecs.ljpeg_encode(stored, bitspersample=16))])
    tags = (50975, "I", 1, fields[0], True), (52547, "I", 1, fields[1], True)
    write_plain_dng(tmp_path / "a.dng", stored, ("RG", "GB"), BLACK, *tags, active_area(2, 4, 62, 90), **options)
    assert np.array_equal(read_raw(tmp_path / "a.dng").mosaic, mosaic[2:62, 4:90])


def test_interleaved_rows_of_a_phone_are_put_in_order() -> None:
    assert signal_of(FIELD / "row-interleave-2.dng") == pytest.approx(SCENE, abs=0.002)


NOT_LIBRAWS = ["row-interleave-2", "float32-hot-1.5", "black-deltaH-columns", "black-deltaV-slope"]


@pytest.mark.parametrize("name", NOT_LIBRAWS)
def test_libraws_own_rendering_of_them_is_refused(name: str) -> None:
    with pytest.raises(RawFileError, match=r"of which LibRaw makes a wrong .*eldata\.isp\.Rendering"):
        render_libraw(FIELD / f"{name}.dng")


@pytest.mark.parametrize("value", [0, 70000])
def test_impossible_interleaving_is_refused(value: int, tmp_path: Path) -> None:
    write_plain_dng(tmp_path / "a.dng", random_mosaic(64, 64), ("RG", "GB"), (50975, "I", 1, value, True))
    with pytest.raises(RawFileError, match=f"damaged: it declares {value} interleaved fields of 64 rows"):
        read_raw(tmp_path / "a.dng")


# --- which image, and which sample ----------------------------------------------------------------------------


def test_of_two_samples_the_first_is_taken_and_said() -> None:
    frame = read_raw(FIELD / "dual-pixel-2-samples.dng")
    assert (frame.sensor.black_level_dn, frame.sensor.white_level_dn) == ((64.0,) * 4, 1023.0)
    assert signal_of(FIELD / "dual-pixel-2-samples.dng") == pytest.approx(SCENE, abs=0.002)
    said = ("it has 2 samples of each pixel, as dual pixels give: the mosaic is the first",)
    assert frame.remarks == said
    assert read_header(FIELD / "dual-pixel-2-samples.dng").remarks == said


def test_each_sample_has_its_own_levels(tmp_path: Path) -> None:
    """Row, column, sample: of a pattern of 2 x 2 the first sample's are every second number."""
    first, second = random_mosaic(64, 64, low=100, high=900), random_mosaic(64, 64, seed=1, low=100, high=900)
    both = np.stack([first, second], axis=-1)
    levels = (60, 10, 61, 11, 62, 12, 63, 13)
    tags: Any = (50713, "H", 2, (2, 2), True), (50714, "I", 8, levels, True), (50717, "I", 2, (1000, 900), True)
    write_plain_dng(tmp_path / "a.dng", both, ("RG", "GB"), *tags, white=None, photometric=1, planarconfig="contig")
    add_tags(tmp_path / "a.dng", (262, "H", 1, 32803, True))  # tifffile writes no CFA of two samples
    frame = read_raw(tmp_path / "a.dng")
    assert np.array_equal(frame.mosaic, first)
    assert (frame.sensor.black_level_dn, frame.sensor.white_level_dn) == ((60.0, 61.0, 63.0, 62.0), 1000.0)


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
            tiff.write(preview, photometric="rgb", subfiletype=1, subifds=len(mosaics), metadata=None, extratags=first)
        for index, mosaic in enumerate(mosaics):
            tags: list[Tag] = [(33421, "H", 2, (2, 2), True), (33422, "B", 4, bytes((0, 1, 1, 2)), True)]
            tags += [(50714, "I", 1, 64 + index, True), (50717, "I", 1, 1023 + index, True)]
            tags += [] if in_sub_ifds else first
            tiff.write(mosaic, photometric=32803, subfiletype=0, metadata=None, extratags=tags)


@pytest.mark.parametrize("in_sub_ifds", [False, True])
def test_each_image_of_a_pixel_shift_can_be_chosen(in_sub_ifds: bool, tmp_path: Path) -> None:
    mosaics = [random_mosaic(64, 96, seed=seed, low=100, high=1000) for seed in range(4)]
    write_shift(tmp_path / "a.dng", mosaics, in_sub_ifds=in_sub_ifds)
    assert np.array_equal(read_raw(tmp_path / "a.dng").mosaic, mosaics[0])
    for index, mosaic in enumerate(mosaics):
        frame = read_raw(tmp_path / "a.dng", image=index)
        assert np.array_equal(frame.mosaic, mosaic)
        assert frame.sensor.black_level_dn == (64.0 + index,) * 4
        assert frame.sensor.white_level_dn == 1023 + index
        which = f"the mosaic is image {index}, counted from 0 (read_raw's image= chooses)"
        assert frame.remarks == (f"it holds 4 images of one size, as of a pixel shift: {which}",)
    with pytest.raises(RawFileError, match="has no image 4: it holds 4, counted from 0"):
        read_raw(tmp_path / "a.dng", image=4)
    with pytest.raises(ArgumentError, match="image counts from 0; found -1"):
        read_raw(tmp_path / "a.dng", image=-1)


def test_images_that_no_directory_lists_are_counted_by_libraw(tmp_path: Path) -> None:
    """As of formats other than TIFF; a DNG serves, of which both is known."""
    for count in (1, 2, 4):
        mosaics = [random_mosaic(64, 96, seed=seed, low=100, high=1000) for seed in range(count)]
        write_shift(tmp_path / "a.dng", mosaics, in_sub_ifds=True)
        assert count_images(tmp_path / "a.dng") == count


def test_a_file_of_one_image_says_so(tmp_path: Path) -> None:
    write_dng(tmp_path / "a.dng", random_mosaic(60, 64), make_sensor(), EXPOSURE)
    with pytest.raises(RawFileError, match="has no image 1: it holds 1, counted from 0"):
        read_raw(tmp_path / "a.dng", image=1)


# --- what says no mosaic --------------------------------------------------------------------------------------

GREY = "is a grey TIFF, which states no colour filter array .*; use the camera's raw file, or state them in the mosaics"


def test_a_grey_tiff_is_no_mosaic() -> None:
    for read in (read_raw, read_header):
        with pytest.raises(UnusableRawError, match=GREY):
            read(FIELD / "tif-gray16.tif")


@pytest.mark.parametrize("photometric", ["minisblack", "miniswhite"])
def test_a_grey_tiff_with_a_cameras_exif_is_no_mosaic_either(photometric: Any, tmp_path: Path) -> None:
    """As exiftool makes of what unprocessed_raw -T writes."""
    tags: Any = [(271, "s", 0, "SONY", True), (272, "s", 0, "ILCE-7S", True), (34855, "H", 1, 800, True)]
    tags += [(33434, "2I", 1, (1, 30), True)]
    tifffile.imwrite(tmp_path / "a.tif", random_mosaic(64, 96), photometric=photometric, metadata=None, extratags=tags)
    with pytest.raises(UnusableRawError, match=GREY):
        read_raw(tmp_path / "a.tif")


@pytest.mark.parametrize("tag", [50706, 34310, 33422], ids=["DNG", "Leaf", "CFA"])
def test_cameras_raws_that_call_themselves_grey_are_not_meant(tag: int, tmp_path: Path) -> None:
    """What LibRaw says of them counts."""
    own: Any = [(tag, "B", 4, bytes((1, 4, 0, 0)), True)]
    tifffile.imwrite(tmp_path / "a.tif", random_mosaic(64, 96), metadata=None, extratags=own)
    refuse_unsupported(tmp_path / "a.tif", read_directories(tmp_path / "a.tif"))


def test_whole_numbers_in_deflate_are_named(tmp_path: Path) -> None:
    for name in ("deflate", "adobe_deflate"):
        write_plain_dng(tmp_path / "a.dng", random_mosaic(64, 64), compression=name)
        for read in (read_raw, read_header):
            with pytest.raises(UnusableRawError, match="is a DNG of whole numbers in Deflate compression"):
                read(tmp_path / "a.dng")


# --- tags in another spelling ---------------------------------------------------------------------------------


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("area", [(0, 0, 60, 60), (1, 3, 61, 63)], ids=str)
@pytest.mark.parametrize("phase", BAYER)
def test_a_cfa_pattern_of_16_bit_numbers_is_read(
    phase: str, area: tuple[int, int, int, int], order: Any, tmp_path: Path
) -> None:
    """As of bytes, which LibRaw reads."""
    mosaic, tags = random_mosaic(64, 64, low=100, high=900), (BLACK, active_area(*area))
    numbers = tuple("RGB".index(letter) for row in letters(BAYER[phase]) for letter in row)
    pattern = (33421, "H", 2, (2, 2), True), (33422, "H", 4, numbers, True)
    write_plain_dng(tmp_path / "short.dng", mosaic, None, *pattern, *tags, white=1023, byteorder=order)
    write_plain_dng(tmp_path / "bytes.dng", mosaic, letters(BAYER[phase]), *tags, white=1023, byteorder=order)
    short, as_bytes = read_raw(tmp_path / "short.dng"), read_raw(tmp_path / "bytes.dng")
    assert short.sensor == as_bytes.sensor
    assert np.array_equal(short.mosaic, as_bytes.mosaic)


def test_names_beyond_ascii_are_written_back(tmp_path: Path) -> None:
    sensor = replace(make_sensor(), make="Зенит", model="小米 14 Ultra é")
    mosaic = random_mosaic(60, 64)
    write_dng(tmp_path / "a.dng", mosaic, sensor, EXPOSURE)
    frame = read_raw(tmp_path / "a.dng")
    assert (frame.sensor.make, frame.sensor.model) == (sensor.make, sensor.model)
    write_dng(tmp_path / "b.dng", frame.mosaic, frame.sensor, frame.exposure)
    assert (tmp_path / "a.dng").read_bytes() == (tmp_path / "b.dng").read_bytes()


@pytest.mark.parametrize("name", [b"Caf\xe9 1", b"\xff\xfe\x81"])
def test_names_that_are_no_utf8_do_not_end_in_an_error_of_python(name: bytes, tmp_path: Path) -> None:
    write_plain_dng(tmp_path / "a.dng", random_mosaic(64, 64), ("RG", "GB"), BLACK)
    with tifffile.TiffFile(tmp_path / "a.dng") as tiff:
        tag = tiff.pages.first.tags[272]
        at, count = tag.valueoffset, tag.count
    content = bytearray((tmp_path / "a.dng").read_bytes())
    content[at : at + count] = name.ljust(count, b"\0")
    (tmp_path / "a.dng").write_bytes(content)
    frame = read_raw(tmp_path / "a.dng")
    write_dng(tmp_path / "b.dng", frame.mosaic, frame.sensor, frame.exposure)
    assert read_raw(tmp_path / "b.dng").sensor.model == frame.sensor.model
