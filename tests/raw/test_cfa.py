"""Packing against strided numpy, and its inverse."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from eldata.errors import ArgumentError
from eldata.raw import normalise, pack, packed_area, unpack
from eldata.raw.levels import bayer_cfa, packed_layouts, packing_sites
from tests.cases import in_one_test
from tests.raw.helpers import (
    BAYER,
    CFAS,
    NONA,
    QUAD,
    XTRANS,
    Cfa,
    blocks_at,
    colours_of,
    indices_of,
    layout_of,
    levels_of,
    random_mosaic,
    reference_area,
    reference_pack,
    restarts,
    sid_pack,
    start_of,
    xtrans_at,
)

DTYPES = ["uint8", "uint16", "int32", "int64", "float32", "float64", "bool", "complex64"]


@in_one_test("name", CFAS)
def test_each_packed_channel_holds_just_its_colour(name: str) -> None:
    cfa = CFAS[name]
    tiled = np.tile(np.array(cfa, np.uint8), (25, 25))[: 16 + 29, : 16 + 30]
    packed = pack(tiled, cfa)
    expected = [{index} for index in indices_of(cfa)]
    assert [set(np.unique(channel).tolist()) for channel in packed] == expected
    assert [sites_name[0] for sites_name in packing_sites(cfa).names] == list(colours_of(cfa))


@pytest.mark.parametrize("name", BAYER)
def test_bayer_equals_the_strided_slices_of_its_name(name: str) -> None:
    mosaic = random_mosaic(14, 22)
    packed = pack(mosaic, BAYER[name])
    quarters = {(y, x): mosaic[y::2, x::2] for y in range(2) for x in range(2)}
    red, blue = divmod(name.index("R"), 2), divmod(name.index("B"), 2)
    np.testing.assert_array_equal(packed[0], quarters[red])
    np.testing.assert_array_equal(packed[1], quarters[red[0], blue[1]])
    np.testing.assert_array_equal(packed[2], quarters[blue])
    np.testing.assert_array_equal(packed[3], quarters[blue[0], red[1]])


@in_one_test("name", XTRANS)
def test_xtrans_at_any_offset_loses_the_fewest_rows_and_columns_and_packs_as_sid(name: str) -> None:
    cfa, mosaic = XTRANS[name], random_mosaic(31, 40)
    area = packed_area((31, 40), cfa)
    possible = restarts(cfa)
    assert (area.top, area.left) in possible
    assert area.top + area.left == min(map(sum, possible))
    assert (area.height, area.width) == ((31 - area.top) // 6 * 6, (40 - area.left) // 6 * 6)
    np.testing.assert_array_equal(pack(mosaic, cfa), sid_pack(mosaic[area.slices]))


@given(
    cfa=st.sampled_from(list(CFAS.values())),
    dtype=st.sampled_from(DTYPES),
    height=st.integers(11, 40),
    width=st.integers(11, 40),
    seed=st.integers(0, 2**32 - 1),
)
@settings(deadline=None, max_examples=200)
def test_unpack_inverts_pack_exactly(cfa: Cfa, dtype: str, height: int, width: int, seed: int) -> None:
    raw_bytes = np.random.default_rng(seed).bytes(height * width * np.dtype(dtype).itemsize)
    mosaic: NDArray[Any] = np.frombuffer(raw_bytes, np.uint8)
    # Any bits: NaN payloads and infinities must come back too.
    mosaic = mosaic > 127 if dtype == "bool" else mosaic.view(dtype)
    mosaic = mosaic.reshape(height, width)
    before = mosaic.tobytes()

    packed = pack(mosaic, cfa)
    back = unpack(packed, cfa)

    kept = mosaic[reference_area((height, width), cfa)]
    assert packed.dtype == back.dtype == mosaic.dtype
    assert back.shape == kept.shape
    assert back.tobytes() == kept.tobytes()
    assert packed.tobytes() == reference_pack(mosaic, cfa).tobytes()
    assert mosaic.tobytes() == before


@pytest.mark.parametrize("name", ["GRBG", "xtrans-24", "quad-31", "nona-14"])
def test_views_of_any_memory_layout(name: str) -> None:
    cfa, big = CFAS[name], random_mosaic(62, 70, seed=3)
    column = np.stack([big, big + 1], axis=-1)[..., 1]
    for mosaic in (big[::2, 1::2], big[::-1, ::-1], np.asfortranarray(big), column):
        mosaic.flags.writeable = False
        packed = pack(mosaic, cfa)
        np.testing.assert_array_equal(packed, reference_pack(mosaic, cfa))
        assert packed.flags.c_contiguous
        assert not np.shares_memory(packed, mosaic)
        kept = mosaic[reference_area((mosaic.shape[0], mosaic.shape[1]), cfa)]
        np.testing.assert_array_equal(unpack(np.asfortranarray(packed), cfa), kept)


@pytest.mark.parametrize(("name", "side"), [("quad-00", 2), ("quad-32", 2), ("nona-00", 3), ("nona-43", 3)])
def test_one_step_makes_the_other_two_forms(name: str, side: int) -> None:
    """Binned, and half the size with the blocks side by side, as the module's text says; both from the mosaic."""
    import torch

    cfa = {**QUAD, **NONA}[name]
    mosaic = random_mosaic(37, 41).astype(np.float64)
    rows, columns = reference_area((37, 41), cfa)
    im, start = mosaic[rows, columns], start_of(cfa)
    blocks = im.reshape(im.shape[0] // side, side, im.shape[1] // side, side)
    as_bayer: Cfa = tuple(row[::side] for row in start[::side])
    packed = pack(mosaic, cfa)
    binned = packed.reshape(4, side * side, *packed.shape[1:]).mean(1)
    np.testing.assert_allclose(binned, pack(blocks.mean((1, 3)), as_bayer), rtol=1e-12)
    shuffled = torch.nn.functional.pixel_shuffle(torch.from_numpy(packed)[None], side)[0].numpy()
    for y in range(side):
        for x in range(side):
            of_bayer = pack(np.ascontiguousarray(blocks[:, y, :, x]), as_bayer)
            np.testing.assert_array_equal(shuffled[:, y::side, x::side], of_bayer)


def test_the_number_of_channels_tells_the_kinds_apart() -> None:
    names = {channels: sites.name for channels, sites in packed_layouts().items()}
    assert names == {4: "Bayer", 9: "X-Trans", 16: "quad-Bayer", 36: "nona-Bayer"}
    assert packing_sites(QUAD["quad-13"]).names[:6] == ("R.00", "R.01", "R.10", "R.11", "G1.00", "G1.01")


def test_bayer_by_name_and_in_blocks() -> None:
    assert {first: bayer_cfa(first) for first in BAYER} == BAYER
    assert bayer_cfa(block=2) == QUAD["quad-00"]
    assert bayer_cfa("BGGR", block=2) == QUAD["quad-22"]
    assert bayer_cfa("GRBG", block=3) == NONA["nona-03"]
    for arguments in (("RGB", 1), ("rggb", 2)):
        with pytest.raises(ArgumentError, match="first must be one of 'RGGB', 'GRBG', 'GBRG', 'BGGR'; found"):
            bayer_cfa(*arguments)
    with pytest.raises(ArgumentError, match=r"block must be 1 \(Bayer\), 2 \(quad-Bayer\) or 3 .*found 4"):
        bayer_cfa("RGGB", 4)


@in_one_test("name", CFAS)
def test_a_mosaic_below_one_period_is_refused(name: str) -> None:
    cfa = CFAS[name]
    rows, columns = reference_area((100, 100), cfa)
    height, width = rows.start + len(cfa), columns.start + len(cfa)
    assert pack(np.zeros((height, width), np.uint16), cfa).shape[1:] == (layout_of(cfa)[1],) * 2
    for shape in ((height - 1, width), (height, width - 1), (0, 0)):
        with pytest.raises(ArgumentError, match="does not hold one whole"):
            pack(np.zeros(shape, np.uint16), cfa)


@pytest.mark.parametrize(
    "cfa",
    [
        (),
        ((0, 1),),
        ((0, 1), (1, 2)),  # both greens under one index
        ((0, 3), (1, 2)),  # G1 not in R's row
        ((0, 2), (1, 3)),  # greens in one row
        ((0, 1), (2, 3)),  # and in one column
        ((1, 0), (3, 2)),
        ((0, 1, 3), (2,)),
        (*xtrans_at(0, 0)[:5], (1, 1, 0, 1, 1, 0)),  # one site wrong
        xtrans_at(0, 0)[:5],
        tuple(row[:5] for row in xtrans_at(0, 0)),
        (*QUAD["quad-11"][:3], (0, 1, 1, 1)),
        tuple(tuple(min(index, 2) for index in row) for row in NONA["nona-00"]),  # G2 under B's index
        tuple(tuple(index if index < 3 else 1 for index in row) for row in QUAD["quad-00"]),  # greens under one index
        blocks_at(4, 0, 0),
    ],
)
def test_other_patterns_are_refused(cfa: Cfa) -> None:
    mosaic = np.zeros((24, 24), np.uint16)
    with pytest.raises(ArgumentError, match="unsupported CFA"):
        pack(mosaic, cfa)


@in_one_test(
    "name, shapes",
    [
        *(("RGGB", [(4, 6), (3, 6, 6)]), ("quad-00", [(15, 6, 6)]), ("nona-00", [(9, 6, 6)])),
        ("xtrans-00", [(4, 6, 6), (9, 5, 6)]),
    ],
)
def test_other_shapes_and_values_are_refused(name: str, shapes: list[tuple[int, ...]]) -> None:
    cfa = CFAS[name]
    for shape in shapes:
        with pytest.raises(ArgumentError, match="expected packed data"):
            unpack(np.zeros(shape, np.float32), cfa)
    with pytest.raises(ArgumentError, match="expected packed data"):
        normalise(np.zeros((5, 6, 6)), cfa, [0.0] * levels_of(cfa), 1.0)
    for shape in ((24,), (3, 24, 24), (24, 24, 1)):
        with pytest.raises(ArgumentError, match="two dimensions"):
            pack(np.zeros(shape, np.uint16), cfa)
    with pytest.raises(ArgumentError, match="values of 1, 2, 4 or 8 bytes can be packed, not complex128"):
        pack(np.zeros((24, 24), complex), BAYER["RGGB"])
