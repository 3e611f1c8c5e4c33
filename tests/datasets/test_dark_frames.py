"""Dark frames as noise: to the bit, in turns, with the statistics of frames that were kept out, or refused by name."""

from __future__ import annotations

import pickle
from collections import Counter
from collections.abc import Iterable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from eldata.calibration import BiasStack, ShadingFit, fixed_pattern
from eldata.datasets import Arrays, CleanClips, DarkFrames, SyntheticClips, SyntheticPairs
from eldata.datasets.clean import CleanFrames
from eldata.errors import ArgumentError, DatasetError
from eldata.noise import Adc, CameraProfile, NoiseDraw, NoiseModel, NoiseParameters
from eldata.noise._kernels import expose_compiled
from eldata.noise.on_device import expose_on_device
from eldata.raw import pack, read_raw, write_dng
from eldata.records import Exposure
from eldata.sources.store import build_store, source_of_folder
from tests.datasets.mosaics import Mosaics
from tests.raw.helpers import BAYER, EXPOSURE, NONA, QUAD, XTRANS, Cfa, make_sensor, random_mosaic

SIDE = 72
RANGE = 15871.0 - 511.5  # of make_sensor's Bayer cameras
ISOS = {400: 5, 1600: 3}
PARAMETERS = NoiseParameters(1.0, 0.0, 0.0, 0.0, 0.0, iso=400.0)


def write_bias(folder: Path, iso: int, mosaics: Iterable[NDArray[np.uint16]], cfa: Cfa, **sensor: Any) -> Path:
    """Bias frames of one camera; the folder bias."""
    place = folder / "Nocturne" / "bias" / f"ISO{iso}"
    place.mkdir(parents=True)
    for number, mosaic in enumerate(mosaics):
        exposure = Exposure(Fraction(iso), Fraction(1, 4000))
        write_dng(place / f"{number}.dng", mosaic, make_sensor(cfa, *mosaic.shape, **sensor), exposure)
    return place.parent


def written(folder: Path, cfa: Cfa = BAYER["GRBG"], isos: dict[int, int] | None = None, side: int = SIDE) -> Path:
    """Those whose pixels are at random."""
    generator = np.random.default_rng(7)
    for iso, count in (ISOS if isos is None else isos).items():
        mosaics = generator.integers(480, 560, (count, side, side), dtype=np.uint16)
        bias = write_bias(folder, iso, mosaics, cfa)
    return bias


@pytest.fixture(scope="module")
def bias(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("calibration"))


@pytest.fixture(scope="module")
def store(bias: Path) -> Path:
    path = bias.parents[1] / "bias.h5"
    build_store(source_of_folder(bias.parents[1]), path)
    return path


def night(cfa: Cfa = BAYER["GRBG"], side: int = SIDE, white: float = 15871.0, count: int = 2) -> Mosaics:
    """Clean frames of that camera without any light."""
    black = 256.0 if len(cfa) == 6 and max(map(max, cfa)) == 2 else 511.5
    return Mosaics([np.full((side, side), black, np.float32)] * count, cfa, black=black, white=white)


def pairs(dark: DarkFrames, source: Any = None, **options: Any) -> SyntheticPairs:
    usual: dict[str, Any] = {"profiles": "SonyA7S2", "crop": 16, "crops_per_frame": 8, "ratio": 100.0, "clip": "none"}
    model = NoiseModel("P*+D", dark_frames=dark)
    return SyntheticPairs(night() if source is None else source, model=model, **usual | options)


def in_dn(item: Any, range_dn: float = RANGE) -> NDArray[np.float64]:
    dn: NDArray[np.float64] = item["input"].double().numpy() * range_dn / item["ratio"]
    return dn


def above_black(path: Path | str) -> NDArray[np.float64]:
    """A mosaic in DN above black, by numpy's own arithmetic."""
    raw = read_raw(path)
    black = np.array(raw.sensor.black_level_dn)[np.array(raw.sensor.cfa)]
    found: NDArray[np.float64] = raw.mosaic - np.tile(black, np.floor_divide(raw.mosaic.shape, len(black)))
    return found


# --- to the bit -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "cfa", [BAYER["GRBG"], BAYER["RGGB"], XTRANS["xtrans-00"], XTRANS["xtrans-23"], QUAD["quad-01"], NONA["nona-20"]]
)
def test_a_draw_is_the_frame_to_the_bit(cfa: Cfa, tmp_path: Path) -> None:
    """Of each kind of CFA, whole and by crops: in the dark, without dither, DN that are the file's minus black."""
    frames = DarkFrames(written(tmp_path, cfa, {400: 2}), dither=False)
    each = [pack(above_black(name), cfa) for name in frames.names(400)]
    clean = np.zeros(each[0].shape, np.float32)
    model, options = NoiseModel("P*+D", dark_frames=frames), {"parameters": PARAMETERS, "ratio": 1.0, "range_dn": 1.0}
    drawn = [model(clean, generator=np.random.default_rng(seed), **options) for seed in range(8)]  # type: ignore[arg-type]
    for exposure in drawn:
        assert sum(np.array_equal(exposure, frame) for frame in each) == 1
    assert len({exposure.tobytes() for exposure in drawn}) == 2
    source = night(cfa)
    dataset = pairs(frames, source, crop=8)
    dataset.set_epoch(0)
    for index in range(6):
        dn, crop = in_dn(dataset[index], source.frame(0).range_dn), dataset.item(index).crop
        top, left = (part.start for part in crop.slices)
        area = above_black(dataset[index]["dark_frame"])[top : top + crop.height, left : left + crop.width]
        np.testing.assert_allclose(dn, pack(area, crop.cfa), rtol=2e-6, atol=1e-4)


def test_files_and_store_give_the_same_items(bias: Path, store: Path) -> None:
    of_files, of_store = pairs(DarkFrames(bias)), pairs(DarkFrames(store))
    for first, second in zip(of_files, of_store, strict=True):
        assert torch.equal(first["input"], second["input"])
        assert second["dark_frame"] == f"{store.as_posix()}/" + "/".join(first["dark_frame"].split("/")[-4:])
    for given in (DarkFrames(bias.parent), DarkFrames(bias.parents[1], "Nocturne"), DarkFrames(store, "Nocturne")):
        assert given.isos == (400.0, 1600.0)
        assert "ISO 400: 5, ISO 1600: 3; place='same', dither=True" in repr(given)
    assert DarkFrames(bias, isos=[1600]).isos == (1600.0,)
    of_store.set_epoch(0)
    assert torch.equal(pickle.loads(pickle.dumps(of_store))[3]["input"], of_store[3]["input"])


def test_the_dither_precedes_the_converter(bias: Path) -> None:
    """207,360 numbers: uniform within half a DN, mean and variance to 5 standard errors; rounding takes it away.

    But for those that float32 puts on the border of half a DN: its step at 512 is 6e-5, so 3e-5 of them.
    """
    plain, dithered = DarkFrames(bias, dither=False), DarkFrames(bias)
    clean = np.zeros((40, 4, SIDE // 2, SIDE // 2), np.float32)
    made = {}
    for name, model in {
        "plain": NoiseModel("D", dark_frames=plain),
        "dithered": NoiseModel("D", dark_frames=dithered),
        "rounded": NoiseModel("D", dark_frames=dithered, adc=Adc(512, 16383)),
    }.items():
        generator = np.random.default_rng(1)
        made[name] = model(clean, parameters=PARAMETERS, ratio=1.0, range_dn=1.0, generator=generator)
    added = (made["dithered"] - made["plain"]).astype(np.float64)
    assert np.abs(added).max() <= 0.5
    assert abs(added.mean()) < 5 * (1 / 12 / added.size) ** 0.5
    assert abs(added.var() - 1 / 12) < 5 * (1 / 180 / added.size) ** 0.5
    assert np.count_nonzero(made["rounded"] != made["plain"]) < 4e-4 * added.size
    assert np.array_equal(made["rounded"], np.rint(made["rounded"] + 512) - 512)


# --- in turns ---------------------------------------------------------------------------------------------------------


def test_each_frame_is_used_once_before_any_is_used_twice(store: Path) -> None:
    """Over epochs, in order."""
    dataset = pairs(DarkFrames(store), iso=400)
    used: Counter[str] = Counter()
    for epoch in range(3):
        dataset.set_epoch(epoch)
        for item in dataset:
            used[item["dark_frame"]] += 1
            assert max(used.values()) - (min(used.values()) if len(used) == 5 else 0) <= 1
            assert item["iso"] == 400


def test_isos_are_those_of_the_frames(store: Path) -> None:
    """All of them alike, or those that are asked for; K lies within 1 % of the ISO's, uniformly (KS by quartiles)."""
    dataset = pairs(DarkFrames(store), crops_per_frame=128)
    profile = CameraProfile.load("SonyA7S2")
    draws = [dataset.item(index).draw for index in range(len(dataset))]
    assert Counter(draw.iso for draw in draws) == {400.0: 128, 1600.0: 128}
    shares = np.array([draw.parameters.gain_dn_per_e / profile.gain_at_iso(draw.iso or 0) for draw in draws])
    assert np.abs(shares - 1).max() <= 0.01
    counts = np.histogram(shares, 4, (0.99, 1.01))[0]  # binomial (256, 1/4): deviation 6.9
    assert np.abs(counts - 64).max() < 5 * 6.9
    assert {draw.parameters.iso for draw in draws} == {400.0, 1600.0}
    weighted = pairs(DarkFrames(store), crops_per_frame=128, iso={400: 3, 1600: 1})
    assert Counter(weighted.item(index).draw.iso for index in range(256)) == {400.0: 192, 1600.0: 64}


def test_frames_of_a_clip_have_dark_frames_of_their_own_from_one_place(bias: Path) -> None:
    clips = CleanClips([Arrays(np.zeros((4, 4, 36, 36), np.float32), range_dn=RANGE, cfa=BAYER["GRBG"])])
    options: dict[str, Any] = {"frames": 2, "crop": 16, "windows_per_clip": 12, "clip": "none", "iso": 1600}
    model = NoiseModel("P*+D", dark_frames=DarkFrames(bias, dither=False))
    dataset = SyntheticClips(clips, "SonyA7S2", model=model, **options)
    dataset.set_epoch(0)
    for index in range(12):
        item, crop = dataset[index], dataset.item(index).crop
        names = item["dark_frame"].split(", ")
        assert len(set(names)) == 2
        top, left = (part.start for part in crop.slices)
        for dn, name in zip(in_dn(item), names, strict=True):
            area = above_black(name)[top : top + 32, left : left + 32]
            np.testing.assert_allclose(dn, pack(area, crop.cfa), rtol=2e-6, atol=1e-4)
    with pytest.raises(
        ArgumentError, match=r"windows of 4 frames, .* need as many dark frames of an ISO; ISO 1600 has 3"
    ):
        SyntheticClips(clips, "SonyA7S2", model=model, **options | {"frames": 4})


# --- refused by name --------------------------------------------------------------------------------------------------


def test_clean_frames_that_do_not_go_with_them(bias: Path) -> None:
    dark, free = DarkFrames(bias), DarkFrames(bias, place="free")
    for source, words in (
        (night(XTRANS["xtrans-00"]), "mosaic 0: is X-Trans, but the dark frames are Bayer, such as .*ISO1600/0.dng"),
        (night(BAYER["RGGB"]), "mosaic 0: has 72 x 72 pixels of the CFA .*, but the dark frames have"),
        (night(side=80), r'mosaic 0: has 80 x 80 .* DarkFrames\(..., place="free"\)'),
        (night(white=4095.0), "mosaic 0: has 3583.5 DN from black to white, .* have 15359.5, .*levels="),
    ):
        with pytest.raises(DatasetError, match=words):
            pairs(dark, source)[0]
    for clean in (night(BAYER["RGGB"]), night(side=80), Arrays(np.zeros((1, 4, 20, 20), np.float32), range_dn=RANGE)):
        assert pairs(free, clean)[0]["input"].shape == (4, 16, 16)
    with pytest.raises(ArgumentError, match=r"crops of \(4, 36, 36\) packed pixels or less, .*39"):
        pairs(free, night(side=80), crop=39)[0]


def test_a_turned_crop_that_is_not_square_does_not_fit_the_sensor(tmp_path: Path) -> None:
    cfa, dark = BAYER["GRBG"], np.full((48, SIDE), 511, np.uint16)
    bias = write_bias(tmp_path, 400, [dark], cfa)
    clean = Mosaics([np.full(dark.shape, 511.5, np.float32)], cfa, black=511.5, white=15871.0)
    with pytest.raises(DatasetError, match=r"dark frames are not turned, and its turned crop, 70 x 46 pixels"):
        list(pairs(DarkFrames(bias), clean, crop=None))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"white_level_dn": 4095.0}, "1.dng: has black level .* and white level 4095 DN, but .*0.dng has"),
        ({"cfa": BAYER["RGGB"]}, "1.dng: has 72 x 72 pixels of the CFA .*, but .*0.dng has"),
        ({"black_level_dn": (600.0,) * 4}, "1.dng: has black level"),
        ({}, "1.dng: was taken at ISO 800, but lies among those of ISO 400"),
    ],
)
def test_frames_that_do_not_go_together(change: Any, words: str, tmp_path: Path) -> None:
    bias = written(tmp_path)
    spoilt = bias / "ISO400" / "1.dng"
    raw = read_raw(spoilt)
    exposure = raw.exposure if change else replace(raw.exposure, iso=Fraction(800))
    write_dng(spoilt, raw.mosaic, replace(raw.sensor, **change), exposure)
    with pytest.raises(DatasetError, match=words):
        list(pairs(DarkFrames(bias), iso=400))
    build_store(source_of_folder(tmp_path), tmp_path / "bias.h5")
    with pytest.raises(DatasetError, match=words):  # at once: a store tells of each frame
        DarkFrames(tmp_path / "bias.h5")


def test_isos_and_models_that_are_refused(bias: Path, store: Path, tmp_path: Path) -> None:
    dark, adc = DarkFrames(bias), Adc(512, 16383)
    model, clean = NoiseModel("P*+D", dark_frames=dark), np.zeros((4, 8, 8), np.float32)
    options: dict[str, Any] = {"ratio": 1.0, "range_dn": 1.0, "generator": np.random.default_rng(0)}
    there = "there are no dark frames of ISO 800; there are 400, 1600"
    for wrong, words in (
        (lambda: pairs(dark, iso=800), there),
        (lambda: pairs(dark, range_dn=15871.0), "leave range_dn out"),
        (lambda: DarkFrames(bias, isos=[800]), there),
        (lambda: DarkFrames(bias, isos=[]), "isos is empty; there are 400, 1600"),
        (lambda: NoiseModel("P*+D"), "D takes real frames"),
        (lambda: NoiseModel("P*+G*", dark_frames=dark), "takes no dark frames: it has no component D"),
        (lambda: NoiseModel("D", dark_frames=DarkFrames(bias, dither=False), adc=adc), "without a dither"),
        (lambda: DarkFrames(bias, place="here"), "place"),  # type: ignore[arg-type]
        (lambda: pairs(dark, profiles=["SonyA7S2", "NikonD850"]), "are of one camera; give its profile alone"),
        (lambda: model(clean, parameters=replace(PARAMETERS, iso=None), **options), "they do not state it"),
        (lambda: model(clean, parameters=PARAMETERS, dark=clean, **options), r"dark must be .* shape \(1, 4, 8, 8\)"),
    ):
        with pytest.raises(ArgumentError, match=words):
            wrong()
    with pytest.raises(DatasetError, match="holds no clean frames, but 8 of other kinds"):
        CleanFrames(store)
    (tmp_path / "Flats" / "flat" / "ISO100").mkdir(parents=True)
    write_dng(tmp_path / "Flats" / "flat" / "ISO100" / "0.dng", random_mosaic(60, 64), make_sensor(), EXPOSURE)
    for place, camera, words in (
        (store, "Other", "has no camera 'Other'; there is Nocturne"),
        (tmp_path, "Flats", "holds no bias frames of Flats"),
    ):
        with pytest.raises(DatasetError, match=words):
            DarkFrames(place, camera)


# --- less a dark shading ----------------------------------------------------------------------------------------------


def shaded(count: int, seed: int) -> NDArray[np.uint16]:
    """Frames with a pattern of 6 DN, and noise of 3 DN."""
    pattern = np.random.default_rng(61).normal(512, 6, (SIDE, SIDE))
    return np.rint(pattern + np.random.default_rng(seed).normal(0, 3, (count, SIDE, SIDE))).astype(np.uint16)


def test_less_a_shading_the_noise_alone_is_left(tmp_path: Path) -> None:
    """Of six frames that the shading is from, 31104 pixels: variance to 5 standard errors, 4 %.

    The pattern is four times as much. Of other frames' shading the variance is 1 + 1/6, and is left so.
    """
    cfa, frames = BAYER["GRBG"], shaded(6, 1)
    bias = write_bias(tmp_path, 400, frames, cfa, black_level_dn=(512.0,) * 4)
    shading_from: Any
    for shading_from, of, scale in (("these", frames, (5 / 6) ** -0.5), ("others", shaded(6, 2), 1.0)):
        fit, stack = ShadingFit(), BiasStack(cfa)
        for mosaic in of:
            stack.add(mosaic)
        fit.add(400, fixed_pattern(stack), (512.0,) * 4, (0.1,) * 4)
        shading = fit.shading("Nocturne", "a test")
        shading.save(tmp_path / "shading.npz")
        dark = DarkFrames(bias, shading=tmp_path / "shading.npz", shading_from=shading_from, dither=False)
        assert f"shading={shading.digest[:15]}" in repr(dark)
        crops = dark.crops(400, range(6), (0, 0, SIDE // 2, SIDE // 2))
        black = 512.0 + pack(shading.at(400), cfa)
        np.testing.assert_allclose(crops, (np.stack([pack(frame, cfa) for frame in frames]) - black) * scale, atol=2e-4)
        assert crops.var() == pytest.approx((9 + 1 / 12) * (1 if shading_from == "these" else 7 / 6), rel=0.04)
        draws, clean = [NoiseDraw(PARAMETERS, 1.0, 1.0)] * 6, np.zeros_like(crops)
        np.testing.assert_allclose(expose_compiled(clean, draws, (), keys=[1], dark=crops), crops, atol=2e-4)
        on_device = expose_on_device(torch.from_numpy(clean), draws, (), torch.Generator(), dark=crops)
        np.testing.assert_allclose(on_device.numpy(), crops, atol=2e-4)
        source = Mosaics([np.full((SIDE, SIDE), 512.0, np.float32)], cfa, black=512.0, white=15871.0)
        dataset = pairs(dark, source)
        dataset.set_epoch(0)
        item, crop = dataset[1], dataset.item(1).crop
        rows, columns = (slice(part.start // 2, part.start // 2 + 16) for part in crop.slices)
        number = int(item["dark_frame"].split("/")[-1].split(".")[0])
        np.testing.assert_allclose(in_dn(item, 15871.0 - 512), crops[number][:, rows, columns], atol=2e-3)
