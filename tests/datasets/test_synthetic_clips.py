"""Synthetic clips: one draw for all frames, fresh noise in each, frames aligned, and what an item depends on."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from eldata.datasets.clean import Arrays, CleanClips
from eldata.datasets.synthetic.pairs import SyntheticClips
from eldata.errors import ArgumentError, DatasetError
from eldata.noise import NoiseParameters
from eldata.raw import write_dng
from eldata.raw.levels import pack_normalised
from tests.noise.helpers import Law
from tests.raw.helpers import BAYER, EXPOSURE, make_sensor, random_mosaic

NUMBERS = ("gain_dn_per_e", "tukey_lambda", "sigma_tl_dn", "sigma_gauss_dn", "sigma_row_dn")
RANGE_DN = 15871.0


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two clips, of 4 and 6 frames, whose numbers are not padded."""
    top = tmp_path_factory.mktemp("clean")
    for clip, (first, count) in {"a": (8, 4), "b": (97, 6)}.items():
        (top / clip).mkdir()
        for number in range(first, first + count):
            mosaic = random_mosaic(60, 64, seed=number)
            write_dng(top / clip / f"{number}.dng", mosaic, make_sensor(BAYER["GBRG"]), EXPOSURE)
    return top


def clips(source: Any, **options: Any) -> SyntheticClips:
    return SyntheticClips(source, "SonyA7S2", **{"crop": 8, "frames": 3} | options)


def raw_clips(folder: Path, **options: Any) -> SyntheticClips:
    return clips(CleanClips(folder), **{"windows_per_clip": 3, "seed": 3} | options)


# --- where the pixels come from ---------------------------------------------------------------------------------------


def test_frames_are_consecutive_and_cut_alike(folder: Path) -> None:
    """Each target frame is the same part of its own file, found by the first frame's."""
    cfa = BAYER["GBRG"]
    starts = {0: set[int](), 1: set[int]()}
    dataset = raw_clips(folder, augment=False, windows_per_clip=40)
    sensor = make_sensor(cfa)
    for index in range(len(dataset)):
        item = dataset[index]
        assert item["clip"] == index % 2
        first = (8, 97)[item["clip"]] + item["start"]
        assert item["path"] == str(folder / "ab"[item["clip"]] / f"{first}.dng")
        whole = [
            pack_normalised(random_mosaic(60, 64, seed=first + step), cfa, sensor.black_level_dn, sensor.white_level_dn)
            for step in range(3)
        ]
        target = item["target"].numpy()
        ((top, left),) = [
            (y, x)
            for y, x in np.argwhere(whole[0][0, :23, :25] == target[0, 0, 0, 0])
            if np.array_equal(whole[0][:, y : y + 8, x : x + 8], target[0])
        ]
        for step in range(3):
            np.testing.assert_array_equal(target[step], whole[step][:, top : top + 8, left : left + 8])
        starts[item["clip"]].add(item["start"])
    assert starts == {0: {0, 1}, 1: {0, 1, 2, 3}}  # 40 draws of four: one is missed with probability 4e-5


def test_sizes_and_levels_of_one_clip_must_agree(tmp_path: Path) -> None:
    sensor = make_sensor()
    write_dng(tmp_path / "1.dng", random_mosaic(60, 64), sensor, EXPOSURE)
    for other, message in (
        (replace(sensor, height=62), "62 x 64 pixels"),
        (make_sensor(BAYER["BGGR"]), "60 x 64 pixels of the CFA"),
        (replace(sensor, white_level_dn=15000.0), ".* white level 15000 DN"),
    ):
        write_dng(tmp_path / "2.dng", random_mosaic(other.height, 64), other, EXPOSURE)
        with pytest.raises(DatasetError, match=f"2.dng: has {message}.*, but .*1.dng has .* is it one clip?"):
            clips(CleanClips(tmp_path), frames=2)[0]


# --- the noise --------------------------------------------------------------------------------------------------------


def test_one_draw_for_all_frames_and_fresh_noise_in_each() -> None:
    """8 flat windows of 3 frames of 4 x 1024 x 8 pixels.

    Mean and variance of each frame lie within 5 standard errors of the closed form for the item's one draw; the
    correlation of the noise of two frames, of n = 32768 pixels, within 5 of 0. Row noise is 1024 x 2 draws for the
    four channels, so the standard error of the correlation is at most 1 / sqrt(2048) where it is all row noise.
    """
    height, width = 1024, 8
    gains = set()
    source = CleanClips([Arrays(np.full((3, 4, height, width), 0.5, np.float32), range_dn=RANGE_DN)])
    for item in clips(source, crop=None, augment=False, clip="none", windows_per_clip=8):
        bias = item["colour_bias_dn"].tolist()
        parameters = NoiseParameters(
            **{name: item[name] for name in NUMBERS},  # type: ignore[literal-required]
            colour_bias_dn=(bias[0], bias[1], bias[2], bias[3]),
        )
        gains.add(parameters.gain_dn_per_e)
        signal_e = 0.5 * RANGE_DN / (item["ratio"] * parameters.gain_dn_per_e)
        law = Law.of("P*+G*+B+R+U", parameters, signal_e)
        dn = item["input"].numpy().astype(np.float64) * RANGE_DN / item["ratio"]
        noise = dn - law.mean - np.array(bias)[:, None, None]
        for frame in noise:
            assert abs(frame.mean()) < 5 * law.mean_error(frame.size, 2 * height)
            error = law.variance_error(frame.size, 2 * height)
            assert abs(np.mean(frame**2) - law.variance - law.row_variance) < 5 * error
        total = law.variance + law.row_variance
        spread = math.sqrt(law.variance**2 + 2 * law.variance * law.row_variance) / total / math.sqrt(noise[0].size)
        spread += law.row_variance / total / math.sqrt(2 * height)
        for one, two in ((0, 1), (0, 2), (1, 2)):
            assert abs(np.mean(noise[one] * noise[two]) / total) < 5 * spread
        assert torch.equal(item["target"], torch.full((3, 4, height, width), 0.5))
    assert len(gains) == 8


# --- sources ----------------------------------------------------------------------------------------------------------


def test_clips_that_are_too_short(folder: Path) -> None:
    dataset = raw_clips(folder, frames=5)
    with pytest.raises(DatasetError, match="4 frames are too few for a window of 5"):
        dataset[0]
    assert dataset[1]["input"].shape[0] == 5
    with pytest.raises(ArgumentError, match="frames and windows_per_clip must be 1 or more; found 0, 3"):
        raw_clips(folder, frames=0)
