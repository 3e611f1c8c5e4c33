"""One photograph in, a denoised DNG out: what is left of the noise, and that nothing but pixels changes."""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import exifread
import numpy as np
import pytest
import rawpy
from PIL import Image

from eldata.baselines import photographs
from eldata.baselines.classical import BASELINES
from eldata.baselines.photographs import denoise, denoise_file
from eldata.cli.main import main
from eldata.errors import ArgumentError, DatasetError
from eldata.noise import CameraProfile
from eldata.raw import read_header, read_raw, write_dng
from tests.cases import in_one_test
from tests.evaluation.own_set import MATRIX, WHITE_BALANCE
from tests.raw.helpers import BAYER, EXPOSURE, add_tags, make_sensor, xtrans_at

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from eldata.records import Sensor

GAIN, SIGMA_DN = 2.0, 6.0  # DN for each photoelectron, of read noise
WHITE_DN = 16383.0
TAKEN = datetime(2026, 11, 28, 21, 30, 5)  # noqa: DTZ001 # a camera's clock


def sensor_of(cfa: Any = BAYER["GBRG"], height: int = 321, width: int = 442) -> Sensor:
    black = (511.5, 512.0, 513.0, 512.25)[: 3 if len(cfa) == 6 else 4]
    return make_sensor(
        cfa, height, width, black_level_dn=black, white_level_dn=WHITE_DN, white_balance=WHITE_BALANCE,
        xyz_to_camera=MATRIX,
    )  # fmt: skip


def photograph(path: Path, sensor: Sensor, *, seed: int = 0, clipped: bool = True) -> NDArray[np.float64]:
    """Write four flats with shot and read noise; return the mean number of DN above black."""
    generator, (height, width) = np.random.default_rng(seed), (sensor.height, sensor.width)
    rows, columns = np.mgrid[:height, :width]
    light: NDArray[np.float64] = np.choose(
        2 * (rows >= height // 2) + (columns >= width // 2), (200.0, 800.0, 2500.0, 6000.0)
    )
    period = len(sensor.cfa)
    black = np.take(sensor.black_level_dn, np.array(sensor.cfa)[rows % period, columns % period])
    noisy = black + GAIN * generator.poisson(light / GAIN) + generator.normal(0, SIGMA_DN, light.shape)
    if clipped:
        noisy[20:30, 40:60] = WHITE_DN
    write_dng(path, np.rint(noisy).astype(np.uint16), sensor, EXPOSURE, taken=TAKEN, orientation=6)
    return light


@in_one_test("method", ["network", "dct"])
@in_one_test("cfa", [*BAYER.values(), xtrans_at(1, 4)])
def test_the_noise_is_gone_and_the_light_is_not(cfa: Any, method: str, tmp_path: Path) -> None:
    """Of 20,000 pixels or more of each flat."""
    if len(cfa) == 6 and method == "network":
        return
    sensor, source, out = sensor_of(cfa), tmp_path / "a.dng", tmp_path / "b.dng"
    light = photograph(source, sensor)
    denoise_file(source, out, method=method)
    before, after = read_raw(source), read_raw(out)
    height, width = after.mosaic.shape
    noisy = before.mosaic < WHITE_DN
    assert np.array_equal(after.mosaic >= WHITE_DN, ~noisy)
    for level in np.unique(light):
        inner = (light == level) & noisy
        inner[[0, 1, height // 2 - 12, height // 2 + 12]] = False
        inner &= np.abs(np.arange(height) - height // 2)[:, None] > 12
        inner &= np.abs(np.arange(width) - width // 2) > 12
        inner[8:42, 28:72] = False
        one, two = (frame.mosaic[inner].astype(float) for frame in (before, after))
        assert two.std() < 0.4 * one.std(), (level, one.std(), two.std())
        # Its mean is that of its input, to five errors and a hundredth of the noise.
        assert two.mean() == pytest.approx(one.mean(), abs=5 * one.std() / np.sqrt(one.size) + 0.01 * one.std())


def test_nothing_but_pixels_changes(tmp_path: Path) -> None:
    source, out = tmp_path / "a.dng", tmp_path / "b.dng"
    photograph(source, sensor_of())
    denoise_file(source, out, method="dct")
    before, after = read_raw(source), read_raw(out)
    assert after.sensor == before.sensor
    assert after.exposure == before.exposure == EXPOSURE
    assert after.orientation == before.orientation == 6
    assert read_header(out).taken == TAKEN
    tags = []
    for path in (source, out):
        with path.open("rb") as file:
            tags.append({name: str(tag) for name, tag in exifread.process_file(file, details=False).items()})
    assert tags[1].pop("Image Software").endswith("denoise, dct")
    assert tags[0].pop("Image Software") == "eldata"
    places = {"Image StripOffsets", "Image ExifOffset"}  # the word in Software is longer
    assert {name for name in tags[0] if tags[0][name] != tags[1].get(name)} == places
    assert tags[0].keys() == tags[1].keys()
    with rawpy.imread(str(out)) as raw:
        assert raw.sizes.flip == 6
        assert raw.postprocess(half_size=True).std() > 0


@in_one_test("method", ["network", "dct"])
def test_the_light_is_amplified_up_to_white(method: str, tmp_path: Path) -> None:
    source, out = tmp_path / "a.dng", tmp_path / "b.dng"
    light = photograph(source, sensor_of(), clipped=False)
    denoise_file(source, out, method=method, ratio=4.0)
    mosaic = read_raw(out).mosaic
    assert mosaic[light == 6000.0].max() == mosaic[light == 6000.0].min() == WHITE_DN
    dark = mosaic[:100, :150].astype(float)
    assert dark.mean() == pytest.approx(512 + 4 * 200, abs=4)


def test_where_the_noise_is_known_from(tmp_path: Path) -> None:
    source = tmp_path / "a.dng"
    photograph(source, sensor_of())
    assert read_raw(source).noise_profile is None
    outcomes = {"photograph itself": denoise_file(source, tmp_path / "1.dng", method="dct")}
    profile = CameraProfile.load("SonyA7S2")
    with pytest.raises(ArgumentError, match="no profile of the camera Nocturne 1 was given, only of SonyA7S2"):
        denoise_file(source, tmp_path / "2.dng", profile, method="dct")
    outcomes["profile of SonyA7S2, another camera"] = denoise_file(
        source, tmp_path / "2.dng", profile, method="dct", profile_of_another_camera=True
    )
    frame = read_raw(source)
    for model in ("ILCE-7SM2", "sonya7s2"):  # as cards that ship have it, and as a profile of one's own
        named = replace(frame, sensor=replace(frame.sensor, model=model))
        assert np.array_equal(
            denoise(named, profile, method="dct"), denoise(frame, profile, method="dct", profile_of_another_camera=True)
        )
    # By the specification: variance = S x + O of shares of white, a pair for each colour plane.
    span = WHITE_DN - 512
    stated = np.array([GAIN / span * share for share in (0.9, 1.0, 1.1)])
    pairs = [number for slope in stated for number in (slope, (SIGMA_DN / span) ** 2)]
    add_tags(source, (51041, "d", 6, tuple(pairs), True))
    noise = read_raw(source).noise_profile
    assert noise == pytest.approx((GAIN / span, (SIGMA_DN / span) ** 2))
    outcomes["NoiseProfile"] = denoise_file(source, tmp_path / "3.dng", method="dct")
    for words, result in outcomes.items():
        assert words in result.noise
    by_itself, stated_file = (read_raw(tmp_path / f"{name}.dng").mosaic.astype(float) for name in (1, 3))
    assert np.abs(by_itself - stated_file).mean() < 1.0  # DN: both are right
    for bad in ((1.0,), (-1e-4, 1e-6), (0.0, 0.0)):
        photograph(source, sensor_of())
        add_tags(source, (51041, "d", len(bad), bad, True))
        assert read_raw(source).noise_profile is None


def test_a_photograph_beyond_what_the_network_was_made_for_is_named(tmp_path: Path) -> None:
    source = tmp_path / "a.dng"
    photograph(source, sensor_of())
    (remark,) = denoise_file(source, tmp_path / "1.dng", ratio=0.25).remarks
    assert "less noise (59 dB" in remark
    assert denoise_file(source, tmp_path / "2.dng").remarks == ()
    assert denoise_file(source, tmp_path / "3.dng", method="dct", ratio=0.25).remarks == ()


@pytest.mark.parametrize("cfa", [BAYER["GRBG"], xtrans_at(0, 3)])
def test_bands_make_what_the_whole_frame_makes(cfa: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The noise is found in bands, too; where tiles fade into each other, float32 is rounded once more."""
    photograph(tmp_path / "a.dng", sensor_of(cfa, 331, 602))
    whole = denoise(read_raw(tmp_path / "a.dng"), method="dct")
    denoise_file(tmp_path / "a.dng", tmp_path / "1.dng", method="dct")
    monkeypatch.setattr(photographs, "_ROWS", 24)
    monkeypatch.setattr(photographs, "BASELINES", {"dct": replace(BASELINES["dct"], tile=128)})
    found = denoise(read_raw(tmp_path / "a.dng"), method="dct")
    np.testing.assert_allclose(found, whole, rtol=0, atol=3e-7)
    denoise_file(tmp_path / "a.dng", tmp_path / "2.dng", method="dct")
    one, two = (read_raw(tmp_path / f"{name}.dng").mosaic for name in (1, 2))
    assert np.count_nonzero(one != two) < 20  # of 199,000, at half a DN


def test_what_cannot_be_denoised_is_refused(tmp_path: Path) -> None:
    source, out = tmp_path / "a.dng", tmp_path / "b.dng"
    photograph(source, sensor_of(xtrans_at(0, 0)))
    with pytest.raises(DatasetError, match="take dct"):
        denoise_file(source, out)
    with pytest.raises(ArgumentError, match="no denoiser is called"):
        denoise_file(source, out, method="nlm")
    write_dng(source, read_raw(source).mosaic, read_raw(source).sensor, replace(EXPOSURE, iso=Fraction(10**6)))
    with pytest.raises(ArgumentError, match="ISO"):
        denoise_file(source, out, CameraProfile.load("SonyA7S2"), method="dct", profile_of_another_camera=True)
    assert not out.exists()


# --- the command ------------------------------------------------------------------------------------------------------


def test_one_file_with_its_picture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    photograph(tmp_path / "a.dng", sensor_of())
    argv = [str(tmp_path / "a.dng"), "-o", str(tmp_path / "b.dng"), "--preview", str(tmp_path / "b.png")]
    assert main(["denoise", *argv, "--method", "dct"]) == 0
    assert capsys.readouterr().out == f"{tmp_path / 'b.dng'}: noise estimated from the photograph itself\n"
    with Image.open(tmp_path / "b.png") as picture:
        assert picture.size == (2 * 221, 160)
        left, right = np.hsplit(np.asarray(picture, float), 2)
    before, after = (half[20:60, 20:60].std(axis=(0, 1)).mean() for half in (left, right))
    assert after < 0.5 * before
    assert main(["denoise", *argv]) == 2
    assert "b.dng: is there already" in capsys.readouterr().err


def test_several_files_go_on_after_one_that_fails(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    names, out = [tmp_path / f"{name}.dng" for name in "abc"], tmp_path / "out"
    for seed, path in enumerate(names):
        photograph(path, sensor_of(), seed=seed)
    names[1].write_bytes(names[1].read_bytes()[:5000])
    command = ["denoise", *map(str, names), "-o", str(out), "--method", "dct"]
    assert main(command) == 1
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(":")[0] for line in lines] == [str(out / "a.dng"), str(names[1]), str(out / "c.dng")]
    assert "truncated" in lines[1]
    assert sorted(path.name for path in out.iterdir()) == ["a.dng", "c.dng"]
    photograph(names[1], sensor_of(), seed=1)
    before = {path: path.stat().st_mtime_ns for path in out.iterdir()}
    assert main(command) == 0  # goes on with what is missing
    lines = capsys.readouterr().out.splitlines()
    assert lines == [
        "2 of 3 photographs were denoised before",
        f"{out / 'b.dng'}: noise estimated from the photograph itself",
    ]
    assert {path: path.stat().st_mtime_ns for path in before} == before
    for others, words in ((["--amplify", "2"], "denoise, dct, now eldata"), (["--method", "network"], "now eldata")):
        assert main([*command, *others]) == 2
        assert words in capsys.readouterr().err
    (out / "b.dng").write_bytes(b"a photograph of somebody's")
    assert main(command) == 2
    assert "b.dng is there, by others" in capsys.readouterr().err
    assert (out / "b.dng").read_bytes() == b"a photograph of somebody's"


@in_one_test(
    "options, words",
    [
        (["a.dng", "b.dng", "-o", "c.dng"], "is one file, and 2 photographs are given"),
        (["a.dng", "d/a.dng", "-o", "out"], "have the same name"),
        (["a.dng", "b.dng", "-o", "out", "--preview", "p.png"], "--preview is for one photograph"),
        (["a.dng", "-o", "a.dng"], "is there already"),
        (["a.dng", "-o", "none/x/b.dng"], "no folder"),
        (["a.dng", "-o", "b.jpg"], "does not end in .dng"),
    ],
)
def test_what_is_asked_for_is_refused_before_any_work(
    options: list[str], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.dng").write_bytes(b"not a raw file")
    assert main(["denoise", *options]) == 2
    assert words in capsys.readouterr().err


def test_a_network_of_ones_own(tmp_path: Path) -> None:
    source, out = tmp_path / "a.dng", tmp_path / "b.dng"
    photograph(source, sensor_of(), clipped=False)
    made = denoise_file(source, out, method="tests.baselines.test_predicting:halved")
    assert (made.noise, made.remarks) == ("known to the network alone", ())
    black = np.take(sensor_of().black_level_dn, np.array(sensor_of().cfa))[0, 0]
    before, after = (read_raw(path).mosaic[::2, ::2][:160].astype(float) - black for path in (source, out))
    np.testing.assert_allclose(after, before / 2, atol=0.51)
