"""Written DNG files: read back by the package, and by LibRaw, exifread and tifffile without it."""

from __future__ import annotations

import re
from dataclasses import replace
from datetime import datetime
from fractions import Fraction
from pathlib import Path
from typing import Any, Literal

import exifread
import numpy as np
import pytest
import rawpy
import tifffile
from numpy.typing import NDArray

from eldata.errors import ArgumentError
from eldata.raw import read_header, read_raw, write_dng
from eldata.records import Exposure, Sensor
from tests.cases import in_one_test
from tests.raw.helpers import BAYER, CFAS, EXPOSURE, SOME_CFAS, letters, make_sensor, random_mosaic

Compression = Literal["none", "lossless-jpeg"]
COMPRESSIONS: tuple[Compression, ...] = ("none", "lossless-jpeg")


def check_round_trip(
    path: Path, mosaic: NDArray[np.uint16], sensor: Sensor, exposure: Exposure = EXPOSURE,
    compression: Compression = "none",
) -> None:  # fmt: skip
    write_dng(path, mosaic, sensor, exposure, compression=compression)
    frame = read_raw(path)
    assert frame.path == path
    np.testing.assert_array_equal(frame.mosaic, mosaic, strict=True)
    assert frame.sensor == sensor
    assert frame.exposure == exposure


@in_one_test("name", CFAS)
def test_every_field_comes_back(name: str, tmp_path: Path) -> None:
    height, width = 47 + len(name) % 3, 53 + len(name) % 2
    check_round_trip(tmp_path / "a.dng", random_mosaic(height, width), make_sensor(CFAS[name], height, width))


@in_one_test("compression", COMPRESSIONS)
@in_one_test("shape", [(22, 22), (23, 22), (22, 23), (23, 25), (301, 203), (64, 600)])
@in_one_test("name", ["GRBG", "xtrans-41", "quad-30", "nona-14"])
def test_sizes(name: str, shape: tuple[int, int], compression: Compression, tmp_path: Path) -> None:
    sensor = make_sensor(CFAS[name], *shape, white_level_dn=65535.0)
    coins = np.random.default_rng(9).integers(0, 2, shape).astype(np.uint16)
    for mosaic in (random_mosaic(*shape, low=0, high=65535), coins * np.uint16(65535), coins * np.uint16(32768)):
        check_round_trip(tmp_path / "a.dng", mosaic, sensor, compression=compression)


@pytest.mark.parametrize(
    "exposure",
    [
        Exposure(),
        Exposure(iso=Fraction(65534), exposure_s=Fraction(1, 3)),
        Exposure(iso=Fraction(65535), exposure_s=Fraction(30)),
        Exposure(iso=Fraction(65536), f_number=Fraction(14, 10)),
        Exposure(iso=Fraction(3276800), exposure_s=Fraction(5, 2)),
        Exposure(iso=Fraction(2**32 - 1)),
        Exposure(exposure_s=Fraction(2**32 - 1, 2**32 - 2)),
    ],
    ids=str,
)
def test_exposures_come_back_as_exact_fractions(exposure: Exposure, tmp_path: Path) -> None:
    check_round_trip(tmp_path / "a.dng", random_mosaic(60, 64), make_sensor(), exposure)
    header = read_header(tmp_path / "a.dng")
    assert (header.make, header.model, header.exposure) == ("Acme", "Nocturne 1", exposure)


def test_an_exposure_in_floats_is_the_fractions_that_they_are_nearest_to(tmp_path: Path) -> None:
    floats: Any = Exposure(iso=800.0, exposure_s=1 / 30, f_number=np.float32(2.8))  # type: ignore[arg-type]
    write_dng(tmp_path / "a.dng", random_mosaic(60, 64), make_sensor(), floats)
    found = read_header(tmp_path / "a.dng").exposure
    assert found.iso == 800
    assert found.exposure_s == Fraction(1, 30)
    assert found.f_number == pytest.approx(2.8)
    wrong: dict[str, Any] = {"iso": 800.5, "exposure_s": INF, "f_number": NAN}
    for name, value in wrong.items():
        (tmp_path / name).mkdir()
        check_refused(tmp_path / name, "iso = 1601/2|a DNG cannot hold", {}, replace(EXPOSURE, **{name: value}))


@in_one_test(
    "fields",
    [
        {"make": "", "model": ""},
        {"make": "A"},
        # LibRaw has levels and a matrix of its own for these.
        {"make": "NIKON CORPORATION", "model": "NIKON D850"},
        {"make": "SONY", "model": "ILCE-7SM2"},
        {"make": "FUJIFILM", "model": "X-T2"},
        {"make": "Phase One", "model": "P 45"},
        {"white_balance": None, "xyz_to_camera": None},
        {"black_level_dn": (0.0, 0.0, 0.0, 0.0)},
        {"black_level_dn": (0.0, 7.0, 1.0, 300.0)},
        {"white_level_dn": 515.0},
        {"white_level_dn": 65535.0},
    ],
)
def test_sensors_come_back(fields: dict[str, Any], tmp_path: Path) -> None:
    for cfa in (BAYER["GBRG"], CFAS["xtrans-00"]):
        if "black_level_dn" not in fields or cfa == BAYER["GBRG"]:
            check_round_trip(tmp_path / "a.dng", random_mosaic(60, 64), make_sensor(cfa, **fields))


# --- what others read ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SOME_CFAS)
@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_libraw_reads_mosaic_colours_and_levels(name: str, compression: Compression, tmp_path: Path) -> None:
    cfa = SOME_CFAS[name]
    mosaic = random_mosaic(61, 63)
    sensor = make_sensor(cfa, 61, 63)
    write_dng(tmp_path / "a.dng", mosaic, sensor, EXPOSURE, compression=compression)
    with rawpy.imread(str(tmp_path / "a.dng")) as raw:
        np.testing.assert_array_equal(raw.raw_image_visible, mosaic)
        names = raw.color_desc.decode()
        tiled = [[names[index] for index in row] for row in raw.raw_colors_visible.tolist()]
        right = [[letters(cfa)[y % len(cfa)][x % len(cfa)] for x in range(63)] for y in range(61)]
        # Of quad-Bayer LibRaw has the pixels right and no idea of the colours: it takes 4 x 4 for 8 x 2.
        assert (tiled == right) is not name.startswith("quad")
        assert raw.white_level == 15871
        if name in BAYER:
            # LibRaw's second green is the one in blue's rows, whatever the phase.
            assert raw.black_level_per_channel == [512, 509, 511, 514]
        elif name.startswith("xtrans"):
            assert raw.black_level_per_channel[:3] == [256, 256, 256]
        assert raw.other.iso_speed == 800
        assert raw.other.shutter_speed == pytest.approx(1 / 30)
        assert raw.other.aperture == pytest.approx(2.8)
        assert raw.camera_whitebalance[:3] == pytest.approx([2.1, 1.0, 1.5])


@pytest.mark.parametrize("milliseconds", [None, 0, 7, 120, 999])
def test_the_time_comes_back(milliseconds: int | None, tmp_path: Path) -> None:
    path = tmp_path / "a.dng"
    taken = None if milliseconds is None else datetime(2026, 12, 31, 23, 59, 58, 1000 * milliseconds)  # noqa: DTZ001
    write_dng(path, random_mosaic(60, 64), make_sensor(), EXPOSURE, taken=taken)
    assert read_header(path).taken == taken
    path.write_bytes(path.read_bytes()[:-1])  # some writers leave out the last zero of a text
    if taken is not None and milliseconds == 0:
        assert (read_header(path).taken, read_header(path).exposure) == (taken, EXPOSURE)


def test_exifread_reads_camera_and_exposure(tmp_path: Path) -> None:
    exposure = Exposure(Fraction(102400), Fraction(1, 250), Fraction(14, 10))
    write_dng(tmp_path / "a.dng", random_mosaic(60, 64), make_sensor(BAYER["GBRG"]), exposure)
    with (tmp_path / "a.dng").open("rb") as file:
        tags = exifread.process_file(file, details=False)
    assert str(tags["Image Make"]) == "Acme"
    assert str(tags["Image Model"]) == "Nocturne 1"
    shutter, aperture = tags["EXIF ExposureTime"].values[0], tags["EXIF FNumber"].values[0]
    assert (shutter.num, shutter.den) == (1, 250)
    assert Fraction(aperture.num, aperture.den) == Fraction(7, 5)
    assert tags["EXIF ISOSpeedRatings"].values == [65535]
    assert tags["EXIF SensitivityType"].values == [2]  # "recommended exposure index"
    assert tags["EXIF RecommendedExposureIndex"].values == [102400]
    assert tags["Image CFAPattern"].values == [1, 2, 0, 1]
    assert "Image ISOSpeedRatings" not in tags


@pytest.mark.parametrize("name", ["BGGR", "xtrans-23", "quad-32", "nona-52"])
@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_tifffile_reads_pixels_and_tags(name: str, compression: Compression, tmp_path: Path) -> None:
    cfa = CFAS[name]
    mosaic = random_mosaic(61, 63)
    write_dng(tmp_path / "a.dng", mosaic, make_sensor(cfa, 61, 63), EXPOSURE, compression=compression)
    with tifffile.TiffFile(tmp_path / "a.dng") as tiff:
        assert len(tiff.pages) == 1
        page = tiff.pages.first
        np.testing.assert_array_equal(page.asarray(), mosaic)
        assert page.photometric == 32803
        assert page.compression == (1 if compression == "none" else 7)
        assert bytes(page.tags[50706].value) == bytes((1, 4, 0, 0))
        assert page.tags[33421].value == (len(cfa), len(cfa))
        assert list(map(int, page.tags[33422].value)) == ["RGB".index(letter) for row in letters(cfa) for letter in row]
        assert page.tags[50717].value == 15871
        # Black by place in the CFA: the R of the pattern carries the R level and so on.
        black = (256,) * 3 if name.startswith("xtrans") else (512, 509, 511, 514)
        assert page.tags[50713].value == (len(cfa), len(cfa))
        assert list(page.tags[50714].value) == [black[channel] for row in cfa for channel in row]
        codes = [tag.code for tag in page.tags]
        assert codes == sorted(codes)  # TIFF 6.0 asks for ascending tags


# --- what is refused ----------------------------------------------------------------------------------------


NAN, INF = float("nan"), float("inf")


def matrix(value: float) -> tuple[tuple[float, ...], ...]:
    return (1.0, 0.0, 0.0), (0.0, value, 0.0), (0.0, 0.0, 1.0)


@in_one_test(
    "words, exposure",
    [
        ("iso = 1001/10 is not a positive whole number", Exposure(iso=Fraction(1001, 10))),
        ("iso = 0", Exposure(iso=Fraction(0))),
        ("iso = 4294967296", Exposure(iso=Fraction(2**32))),
        ("exposure_s = 0", Exposure(exposure_s=Fraction(0))),
        ("exposure_s = 1/4294967296", Exposure(exposure_s=Fraction(1, 2**32))),
        ("f_number = 4294967296", Exposure(f_number=Fraction(2**32))),
    ],
)
def test_an_exposure_that_does_not_fit_is_refused(words: str, exposure: Exposure, tmp_path: Path) -> None:
    check_refused(tmp_path, words, {}, exposure)


def check_refused(folder: Path, words: str, fields: dict[str, Any], exposure: Exposure = EXPOSURE) -> None:
    mosaic = random_mosaic(21 if fields.get("height") == 21 else 60, 64)
    with pytest.raises(ArgumentError, match=f"{re.escape(str(folder / 'a.dng'))}: .*{words}"):
        write_dng(folder / "a.dng", mosaic, make_sensor(**fields), exposure)
    assert list(folder.iterdir()) == []


# An error of our own, not Python's; and nothing is written that read_raw would refuse, or read as another sensor.
@in_one_test(
    "words, field, values",
    [
        ("black_level_dn .*: expected numbers", "black_level_dn", [(-1.0,) * 4, (65536.0,) * 4, (NAN,) * 4]),
        ("", "black_level_dn", [(512.0,), (512.0,) * 5]),
        ("white_level_dn [-0-9.a-z]+: expected a whole number", "white_level_dn", [15871.5, 65536.0, NAN, INF]),
        ("white_level_dn [0-9.]+ must lie above", "white_level_dn", [0.0, 514.0]),
        ("Zorki", "make", ["Zorki\0Ж"]),
        ("white_balance .*: expected positive multipliers", "white_balance", [(-2.0, 1, 1.5, 1.1), (2.0, 0, 2, 1)]),
        ("white_balance .*: .*multipliers within 32", "white_balance", [(2.0, 1, 2**33, 1), (2.0, 1, 2**-33, 1)]),
        ("a DNG cannot hold .*xyz_to_camera", "xyz_to_camera", [matrix(INF), matrix(-(2.0**31))]),
        ("a DNG cannot hold", "matrix_illuminant", [65536]),
        ("model 'Nocturne '", "model", ["Nocturne "]),
        (r"expected a uint16 mosaic of 61 x 64 .* found uint16 \(60, 64\)", "height", [61]),
        ("", "height", [21]),
        ("unsupported CFA", "cfa", [((0, 1), (1, 2))]),
        ("", "cfa", [CFAS["xtrans-00"]]),  # with four black levels
    ],
)
def test_a_sensor_that_does_not_fit_is_refused(words: str, field: str, values: list[Any], tmp_path: Path) -> None:
    for value in values:
        fields = {field: value} | ({"black_level_dn": (256.0,) * 4} if field == "cfa" else {})
        check_refused(tmp_path, words, fields)
