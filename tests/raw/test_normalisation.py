"""Normalisation, bit for bit, against the formula in plain numpy."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from eldata.errors import ArgumentError
from eldata.raw import normalise, pack, pack_normalised
from eldata.raw.levels import FRAME_LEVELS, Clip, FrameLevels, packed_frame, with_levels
from eldata.records import Exposure, RawFrame
from tests.cases import in_one_test
from tests.raw.helpers import BAYER, CFAS, Cfa, indices_of, is_xtrans, make_sensor, random_mosaic, reference_pack

CLIPS: tuple[Clip, ...] = ("both", "upper", "none")

BAYER_BLACK = (512.0, 509.25, 511.0, 514.0)
XTRANS_BLACK = (1022.0, 1023.5, 1021.0)


def black_of(cfa: Cfa) -> tuple[float, ...]:
    return XTRANS_BLACK if is_xtrans(cfa) else BAYER_BLACK


def formula(
    packed: NDArray[np.uint16], cfa: Cfa, black: Sequence[float], white: float, clip: Clip, gain: float
) -> NDArray[np.float32]:
    """clip(gain * clip((DN - black) / (white - black))), each step in float32."""
    black32 = np.array([black[index] for index in indices_of(cfa)], np.float32)[:, None, None]
    low = np.float32(0 if clip == "both" else -np.inf)
    high = np.float32(np.inf if clip == "none" else 1)
    x = packed.astype(np.float32)
    x = (x - black32) / (np.float32(white) - black32)
    x = np.minimum(np.maximum(x, low), high)
    x = x * np.float32(gain)
    x = np.minimum(np.maximum(x, low), high)
    assert x.dtype == np.float32
    return x


def same_bits(a: NDArray[np.float32], b: NDArray[np.float32]) -> bool:
    return a.shape == b.shape and a.dtype == b.dtype == np.float32 and a.tobytes() == b.tobytes()


@in_one_test("name", CFAS)
@in_one_test("clip", CLIPS)
@in_one_test("gain", [1.0, 100.0, 0.3])
def test_pack_normalised_is_the_formula_bit_for_bit(name: str, clip: Clip, gain: float) -> None:
    cfa = CFAS[name]
    mosaic = random_mosaic(47, 61, seed=5, low=0, high=65535)
    mosaic[:20] = random_mosaic(20, 61, seed=6, low=480, high=1060)  # around black
    expected = formula(reference_pack(mosaic, cfa), cfa, black_of(cfa), 15871.0, clip, gain)
    result = pack_normalised(mosaic, cfa, black_of(cfa), 15871.0, clip=clip, gain=gain)
    assert same_bits(result, expected)
    # The data must reach both limits for the comparison to say something about them.
    assert expected.min() < 0 or clip == "both"
    assert expected.max() > 1 or clip != "none"


@pytest.mark.parametrize("name", ["GRBG", "xtrans-52", "quad-21", "nona-52"])
def test_non_contiguous_and_read_only_mosaics(name: str) -> None:
    cfa, big = CFAS[name], random_mosaic(80, 90, low=0, high=20000)
    for view in (big[::2, ::-2], np.asfortranarray(big), big[3:50, 7:]):
        view.flags.writeable = False
        expected = formula(reference_pack(view, cfa), cfa, black_of(cfa), 15871.0, "both", 7.0)
        assert same_bits(pack_normalised(view, cfa, black_of(cfa), 15871.0, gain=7.0), expected)


@pytest.mark.parametrize("name", ["BGGR", "xtrans-00"])
@pytest.mark.parametrize("clip", CLIPS)
def test_normalise_after_pack_is_pack_normalised(name: str, clip: Clip) -> None:
    cfa, mosaic = CFAS[name], random_mosaic(36, 42, low=0, high=30000)
    apart = normalise(pack(mosaic, cfa), cfa, black_of(cfa), 15871.0, clip=clip)
    assert same_bits(apart, pack_normalised(mosaic, cfa, black_of(cfa), 15871.0, clip=clip))


@pytest.mark.parametrize(("name", "count"), [("RGGB", 1), ("RGGB", 3), ("RGGB", 5), ("xtrans-00", 4), ("quad-00", 16)])
def test_as_many_black_levels_as_the_cfa_has_channels(name: str, count: int) -> None:
    cfa, mosaic = CFAS[name], random_mosaic(24, 24)
    packed = reference_pack(mosaic, cfa)
    with pytest.raises(ArgumentError, match=f"black levels for this CFA, found {count}"):
        pack_normalised(mosaic, cfa, (512.0,) * count, 16000.0)
    with pytest.raises(ArgumentError, match=f"black levels for this CFA, found {count}"):
        normalise(packed, cfa, (512.0,) * count, 16000.0)


@pytest.mark.parametrize(
    ("black", "white"),
    [
        ((512.0, 512.0, 512.0, 16000.0), 16000.0),
        ((512.0,) * 4, 100.0),
        ((512.0, np.nan, 512.0, 512.0), 16000.0),
        ((512.0,) * 4, np.inf),
        ((512.0,) * 4, np.nan),
        # Regression: as float64 above black, and in float32, in which it divides, equal to it.
        ((512.0,) * 4, 512.0000001),
    ],
)
def test_white_must_lie_above_every_black(black: tuple[float, ...], white: float) -> None:
    mosaic = random_mosaic(8, 8)
    with pytest.raises(ArgumentError, match="must lie above every black level"):
        pack_normalised(mosaic, BAYER["RGGB"], black, white)
    with pytest.raises(ArgumentError, match="must lie above every black level"):
        normalise(pack(mosaic, BAYER["RGGB"]), BAYER["RGGB"], black, white)


READ_ONLY = np.frombuffer(bytes(4 * 4 * 4 * 4), np.float32).reshape(4, 4, 4)
OUT = np.empty((4, 4, 8), np.float32)


@in_one_test(
    "words, dtype, arguments",
    [
        *(("gain", "uint16", {"gain": gain}) for gain in (-1.0, -1e-9, np.nan, np.inf, 1e39)),
        *(("uint16", dtype, {}) for dtype in ("uint8", "int32", "float32", ">u2")),
        *(
            ("out must be a writeable C-contiguous float32", "uint16", {"out": out})
            for out in (OUT[:, :, :5].copy(), np.asfortranarray(OUT[:, :, :4]), OUT[:, :, ::2], READ_ONLY)
        ),
        ("clip must be one of 'both', 'upper', 'none'", "uint16", {"clip": "lower"}),
    ],
)
def test_other_arguments_are_refused(words: str, dtype: str, arguments: dict[str, Any]) -> None:
    with pytest.raises(ArgumentError, match=words):
        pack_normalised(np.zeros((8, 8), dtype), BAYER["RGGB"], BAYER_BLACK, 16000.0, **arguments)


# --- which levels -------------------------------------------------------------------------------------------------

# ELD's sid_dataset.py divides by 16383 whatever the camera; SID's test_Sony.py takes 512 and 16383 off every file, its
# test_Fuji.py 1024 and 16383.
PUBLISHED: dict[FrameLevels, tuple[float | None, float]] = {
    "metadata": (None, 15871.0),
    "published": (None, 16383.0),
    "sid-sony": (512.0, 16383.0),
    "sid-fuji": (1024.0, 16383.0),
    "lrid": (64.0, 1023.0),
}


@pytest.mark.parametrize("name", ["RGGB", "xtrans-00"])
@pytest.mark.parametrize("levels", FRAME_LEVELS)
def test_levels_are_those_of_the_file_or_of_the_published_code(levels: FrameLevels, name: str) -> None:
    """A pixel at the black level is 0 and one at the white level 1, exactly."""
    cfa = CFAS[name]
    stated = black_of(cfa)
    black, white = PUBLISHED[levels]
    sensor = make_sensor(cfa, 12, 12, black_level_dn=stated, white_level_dn=15871.0)
    chosen = with_levels(sensor, levels)
    assert chosen.black_level_dn == (stated if black is None else (black,) * len(stated))
    assert chosen.white_level_dn == white
    for level, value in ((white, 1), (black, 0)):
        if level is not None:
            frame = RawFrame(Path("a.dng"), np.full((12, 12), level, np.uint16), sensor, Exposure())
            assert set(packed_frame(frame, levels=levels, clip="none").ravel().tolist()) == {value}


def test_white_is_where_the_range_is_the_references() -> None:
    reference = make_sensor(black_level_dn=(500.0,) * 4, white_level_dn=13500.0)
    noisy = make_sensor(black_level_dn=(510.0,) * 4, white_level_dn=15000.0)
    assert with_levels(noisy, "metadata", reference).white_level_dn == 13510
    assert with_levels(noisy, "published", reference).white_level_dn == 16383
