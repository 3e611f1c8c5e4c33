"""Component S: the dark shading of the drawn ISO, at the place on the sensor, by both engines; what is refused."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import torch

from eldata.datasets import SyntheticClips, SyntheticPairs
from eldata.errors import ArgumentError, DatasetError
from eldata.noise import CameraProfile, NoiseModel, NoiseParameters, parse_components
from eldata.noise.exposures import Exposures
from eldata.noise.on_device import expose_on_device
from eldata.noise.shading_content import DarkCurrent
from eldata.raw import pack
from eldata.records import Exposure
from eldata.sources.frames import Frame
from tests.calibration.in_memory import ISO
from tests.calibration.judged import Specimen, judged
from tests.calibration.simulation import Camera
from tests.planted_shading import pattern_of, shading_of
from tests.raw.helpers import BAYER, NONA, XTRANS, Cfa, make_sensor

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from eldata.noise import DarkShading

SIDE = 72
SPEC = "P*+G*+R+U"
RANGE = 15000.0
PARAMETERS = NoiseParameters(1.5, 0.1, 2.0, 2.5, 0.7, iso=800.0)
OPTIONS: dict[str, Any] = {"ratio": 100.0, "range_dn": RANGE}


def packed_pattern(cfa: Cfa, iso: float) -> NDArray[np.uint16]:
    return pack(pattern_of((SIDE, SIDE), cfa, iso), cfa)


def model_of(cfa: Cfa, spec: str = f"{SPEC}+S") -> NoiseModel:
    return NoiseModel(spec, dark_shading=shading_of(make_sensor(cfa, SIDE, SIDE), (800, 1600)))


@pytest.mark.parametrize("cfa", [BAYER["RGGB"], BAYER["GRBG"], XTRANS["xtrans-23"], NONA["nona-20"]])
def test_what_it_adds_is_the_shading_there(cfa: Cfa) -> None:
    """The noise of other components stays to the bit, so the difference is the pattern, to float32 at 100 times."""
    model, plain, whole = model_of(cfa), NoiseModel(SPEC), packed_pattern(cfa, 1600)
    parameters = [PARAMETERS, replace(PARAMETERS, iso=1600.0)]
    clean = np.full((2, len(whole), 4, 8), 0.01, np.float32)
    for place in ((0, 0), (2, 4), (whole.shape[1] - 4, whole.shape[2] - 8)):
        options: dict[str, Any] = {"parameters": parameters, **OPTIONS}
        made = model(clean, place=place, generator=np.random.default_rng(3), **options)
        without = plain(clean, generator=np.random.default_rng(3), **options)
        for number, iso in enumerate((800, 1600)):
            there = packed_pattern(cfa, iso)[:, place[0] : place[0] + 4, place[1] : place[1] + 8]
            np.testing.assert_allclose((made - without)[number] * RANGE / 100, there, atol=2e-3)
    exposures = [
        Exposures.of(
            parse_components(spec), [PARAMETERS] * 2, [100.0] * 2, len(whole), range_dn=RANGE, shading_dn=taken
        )
        for spec, taken in ((f"{SPEC}+S", whole[None, :, :4, :8].astype(np.float32)), (SPEC, None))
    ]
    on_device, without = (
        expose_on_device(torch.from_numpy(clean), one, torch.Generator().manual_seed(0)).numpy() for one in exposures
    )
    np.testing.assert_allclose((on_device - without) * RANGE / 100, [whole[:, :4, :8]] * 2, atol=2e-3)


def test_the_mean_of_many_frames_is_the_shading() -> None:
    """64 frames of 5184 pixels, of no light: z of a pixel's mean has mean 0 +- 0.014 and deviation 1 +- 0.0098; 5 each.

    Rows share their noise, which is left out; the variance is the closed form without S, rounding's 1/12 in it.
    """
    model, plain, frames = model_of(BAYER["GRBG"], "P*+G*+U+S"), NoiseModel("P*+G*+U"), 64
    clean = np.zeros((frames, 4, SIDE // 2, SIDE // 2), np.float32)
    made = model(clean, parameters=PARAMETERS, generator=np.random.default_rng(5), **OPTIONS) * RANGE / 100
    sigma = np.sqrt(plain.expected_variance_dn2(0.0, PARAMETERS) / frames)
    z = (made.mean(axis=0, dtype=np.float64) - packed_pattern(BAYER["GRBG"], 800)) / sigma
    assert abs(z.mean()) < 5 * 0.014
    assert z.std() == pytest.approx(1.0, abs=5 * 0.0098)
    pieces = {
        model(clean[0, :, :6, :6], parameters=PARAMETERS, generator=np.random.default_rng(seed), **OPTIONS).tobytes()
        for seed in (0, 0, 1)
    }
    assert len(pieces) == 2
    mosaic = np.zeros((SIDE, SIDE), np.float32)  # GRBG is extended by a column: the whole frame all the same
    options: dict[str, Any] = {"parameters": PARAMETERS, "generator": np.random.default_rng(0), **OPTIONS}
    alone = NoiseModel("S", dark_shading=model.dark_shading).on_mosaic(mosaic, cfa=BAYER["GRBG"], **options)
    np.testing.assert_allclose(alone * RANGE / 100, pattern_of((SIDE, SIDE), BAYER["GRBG"], 800), atol=2e-3)


class Night:
    """Clean frames without light of the camera whose shading it is."""

    def __init__(self, model: str = "Model") -> None:
        self.sensor = replace(make_sensor(BAYER["GRBG"], SIDE, SIDE), model=model, black_level_dn=(512.0,) * 4)

    def __len__(self) -> int:
        return 2

    def frame(self, index: int) -> Frame:
        dark = np.full((SIDE, SIDE), 512, np.uint16)
        return Frame(dark, self.sensor.cfa, self.sensor.black_level_dn, 15512.0, f"night {index}", self.sensor)

    def clip(self, _: int) -> Night:
        return self


def test_pairs_and_clips_have_it_where_the_sensor_has_it() -> None:
    """Turned crops too, whose shading is not turned; ISOs are those of the shading."""
    shading = shading_of(Night().sensor, (800, 1600))
    model = NoiseModel("P*+S", dark_shading=shading)
    profile = CameraProfile.load("SonyA7S2")
    given: dict[str, Any] = {"model": model, "crop": 10, "ratio": 100.0, "clip": "none"}
    for dataset in (
        SyntheticPairs(Night(), profile, crops_per_frame=6, **given),
        SyntheticClips(Night(), profile, frames=2, windows_per_clip=6, **given),
    ):
        isos = set()
        for index in range(len(dataset)):
            item, sample = dataset.item(index), dataset[index]
            top, left = (part.start for part in item.crop.slices)
            isos.add(sample["iso"])
            pattern = pattern_of((SIDE, SIDE), BAYER["GRBG"], sample["iso"])[top : top + 20, left : left + 20]
            found = sample["input"].numpy() * RANGE / 100
            np.testing.assert_allclose(found, np.broadcast_to(pack(pattern, item.crop.cfa), found.shape), atol=2e-3)
        assert isos == {800.0, 1600.0}
    with pytest.raises(DatasetError, match="night 0: is of a Other, but the dark shading of Planted is of a Model"):
        SyntheticPairs(Night("Other"), profile, **given)[0]


def test_pairs_have_the_dark_current_of_their_time() -> None:
    """That of the clean frame's light, 4 s at ISO 100, less by the ratio; a frame that states none is refused."""
    shading = shading_of(Night().sensor, (800, 1600))
    current = DarkCurrent(
        current_dn=np.full((SIDE, SIDE), 0.5, np.float32), error_dn=1e-3, bias_exposure_s=(0.001,) * 2, exposure_s=(9,)
    )

    class Timed(Night):
        def frame(self, index: int) -> Frame:
            return replace(super().frame(index), exposure=Exposure(Fraction(100), Fraction(4)))

    def pairs(source: Night, of: DarkShading) -> SyntheticPairs:
        model = NoiseModel("P*+S", dark_shading=of)
        return SyntheticPairs(source, "SonyA7S2", model=model, crop=10, ratio=10.0, clip="none", iso=800)

    plain, timed = (pairs(Timed(), one)[0]["input"].numpy() for one in (shading, replace(shading, current=current)))
    np.testing.assert_allclose((timed - plain) * RANGE / 10, 0.5 * 800 * (400 / (800 * 10) - 0.001), rtol=1e-3)
    with pytest.raises(ArgumentError, match="has dark current, which grows with the exposure time"):
        pairs(Night(), replace(shading, current=current))[0]


def test_what_does_not_go_together_is_refused() -> None:
    shading = shading_of(make_sensor(BAYER["RGGB"], SIDE, SIDE), (800, 1600))
    for spec, words in (
        ("P*+D+S", "the frames of D have their own dark shading, and S would add it again"),
        ("P*+G+B+S", "the dark shading of S has the colour bias in it, and B would add it again"),
    ):
        with pytest.raises(ArgumentError, match=words):
            NoiseModel(spec, dark_shading=shading)
    with pytest.raises(ArgumentError, match="S adds a dark shading; give dark_shading="):
        NoiseModel("P*+S")
    with pytest.raises(ArgumentError, match="takes no dark shading: it has no component S"):
        NoiseModel("P*", dark_shading=shading)
    model = NoiseModel("P*+G*+R+U+S", dark_shading=shading)
    assert repr(model) == f"NoiseModel('P*+G*+R+U+S', dark_shading={shading.digest[:15]})"
    assert model.without_quantisation().components.spec == "P*+G*+R+S"
    clean, options = np.zeros((4, 6, 6), np.float32), {"generator": np.random.default_rng(0), **OPTIONS}
    for given, words in (
        ({"parameters": replace(PARAMETERS, iso=None)}, "the parameters' ISO, and they do not state it"),
        ({"parameters": replace(PARAMETERS, iso=400.0)}, "was not measured at ISO 400"),
        ({"parameters": PARAMETERS, "place": (32, 0)}, "is not within the 36 x 36 packed pixels"),
    ):
        with pytest.raises(ArgumentError, match=words):
            model(clean, **given, **options)
    with pytest.raises(ArgumentError, match="a dark shading gives crops of"):
        model(np.zeros((9, 6, 6), np.float32), parameters=PARAMETERS, **options)
    with pytest.raises(ArgumentError, match="place= is for models with component S, T or F"):
        NoiseModel("P*")(clean, parameters=PARAMETERS, place=(0, 0), **options)
    with pytest.raises(ArgumentError, match="dark shading differs from pixel to pixel"):
        model.expected_variance_dn2(1.0, PARAMETERS)
    with pytest.raises(ArgumentError, match="was not measured at ISO 400"):
        SyntheticPairs(Night(), "SonyA7S2", model=model, iso=400)


def test_with_it_the_papers_model_has_the_fixed_pattern() -> None:
    """Of a simulated sensor whose shading is known: columns, hot pixels, and that it is this sensor's own pattern.

    Seven statistics at 4 standard errors from the scatter of 16 pairs: 1 % of a right model's would be off, and the
    seed is fixed. Without S three of them are.
    """
    specimen = Specimen(Camera(shape=(192, 288)), seed=2)
    sensor, bias = specimen.camera.sensor, specimen.body.fixed - specimen.camera.black
    blank = shading_of(sensor, (ISO,))
    one = replace(blank.isos[0], level_error_dn=(0.0,) * 4)
    offset = bias[None].astype(np.float32)
    shading = replace(blank, isos=(one,), slope_dn=np.zeros_like(blank.slope_dn), offset_dn=offset)
    found = judged(NoiseModel(f"{SPEC}+S", dark_shading=shading), specimen, pairs=16)
    without = judged(NoiseModel(), specimen, pairs=16)
    assert [of.check for of in found.off if of.check in ("fixed pattern", "columns", "level")] == []
    assert sum(of.check == "fixed pattern" for of in without.off) >= 2
