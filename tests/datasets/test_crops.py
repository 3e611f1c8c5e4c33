"""Orientations of mosaics, whose pixels are turned and whose CFA is not; and crops="grid", each crop once an epoch."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from eldata import DRVDataset, SyntheticClips, SyntheticPairs
from eldata.datasets import Arrays, CleanClips, training_loader
from eldata.datasets.crops import ORIENTATIONS, Orientation, copy_turned, turn_mosaic
from eldata.errors import ArgumentError, DatasetError
from eldata.manifest import shipped_manifest
from eldata.raw.levels import XTRANS_CFA, pack_normalised, packed_area
from tests.cases import in_one_test
from tests.datasets.mosaics import Mosaics
from tests.drv_tree import RGB_SIZE, SmallDrv
from tests.raw.helpers import BAYER, CFAS, NONA, QUAD, SOME_CFAS, XTRANS, Cfa, layout_of, levels_of, random_mosaic

# --- orientations -----------------------------------------------------------------------------------------------------


# Of nona those where a period may begin: 36 phases of it would take longer than all else.
ALL_CFAS: dict[str, Cfa] = {
    **BAYER, **XTRANS, **QUAD, **{name: NONA[name] for name in ("nona-00", "nona-03", "nona-33", "nona-14")}
}  # fmt: skip


def colours(cfa: Cfa, height: int, width: int) -> NDArray[Any]:
    """A mosaic of colours, the two greens alike."""
    period = len(cfa)
    pattern = np.array([[1 if value == 3 else value for value in row] for row in cfa])
    return np.tile(pattern, (height // period, width // period))


EACH = pytest.mark.parametrize("orientation", ORIENTATIONS, ids=str)


@EACH
@in_one_test("cfa", ALL_CFAS.values())
def test_the_cfa_stays_and_the_pixels_are_the_turned_ones(cfa: Cfa, orientation: Orientation) -> None:
    period = len(cfa)
    height, width = 3 * period, 4 * period
    mosaic = np.arange(height * width).reshape(height, width)
    view = turn_mosaic(mosaic, cfa, orientation)
    turned = mosaic.T if orientation.transpose else mosaic
    turned = turned[:: -1 if orientation.flip_rows else 1, :: -1 if orientation.flip_columns else 1]
    # Less than a period is lost, at the top and at the left only.
    top, left = (turned.shape[0] - view.shape[0], turned.shape[1] - view.shape[1])
    assert 0 <= top < period
    assert 0 <= left < period
    np.testing.assert_array_equal(view, turned[top:, left:])
    # Each pixel's colour is the one that the CFA has there.
    of_pixel = colours(cfa, height, width).ravel()
    wanted = colours(cfa, 5 * period, 5 * period)[: view.shape[0], : view.shape[1]]
    np.testing.assert_array_equal(of_pixel[view], wanted)
    # And no smaller loss would have done.
    for other_top, other_left in itertools.product(range(period), repeat=2):
        if other_top + other_left < top + left:
            rest = of_pixel[turned[other_top:, other_left:]]
            whole = colours(cfa, 5 * period, 5 * period)[: rest.shape[0], : rest.shape[1]]
            assert not np.array_equal(rest, whole)


@EACH
@in_one_test("cfa", [*SOME_CFAS.values(), ((0,),)])
def test_a_copy_is_the_view(cfa: Cfa, orientation: Orientation) -> None:
    """At sizes below, at and above what the compiled loops take at once; of a part of a larger mosaic too."""
    period = len(cfa)
    generator = np.random.default_rng(0)
    for rows, columns in ((2, 2), (3, 7), (8, 5), (9, 16)):
        whole = generator.integers(0, 65536, (rows * period + 5, columns * period + 3), dtype=np.uint16)
        for mosaic in (
            whole[2 : 2 + rows * period, 1 : 1 + columns * period],
            whole[: rows * period, : columns * period],
        ):
            view = turn_mosaic(mosaic, cfa, orientation)
            for height, width in (view.shape, (view.shape[0] - period + 1, view.shape[1]), (1, 1)):
                copy = np.empty((height, width), np.uint16)
                copy_turned(mosaic, cfa, orientation, copy)
                np.testing.assert_array_equal(copy, view[:height, :width])
            with pytest.raises(ArgumentError, match="does not fill"):
                copy_turned(mosaic, cfa, orientation, np.empty((view.shape[0] + 1, 1), np.uint16))


@in_one_test(
    "shape, cfa", [((5, 4), BAYER["RGGB"]), ((6, 8), XTRANS_CFA), ((6, 8), QUAD["quad-13"]), ((2, 2, 2), BAYER["RGGB"])]
)
def test_shapes_that_do_not_fit(shape: tuple[int, ...], cfa: Cfa) -> None:
    with pytest.raises(ArgumentError, match=rf"sides are multiples of {len(cfa)}; found shape"):
        turn_mosaic(np.zeros(shape), cfa, Orientation())


# --- grids ------------------------------------------------------------------------------------------------------------


def grid(source: Any, **options: Any) -> SyntheticPairs:
    chosen: dict[str, Any] = {"crop": 4, "crops": "grid"} | options
    return SyntheticPairs(source, "SonyA7S2", **chosen)


@pytest.mark.parametrize("name", [*BAYER, "xtrans-42", "quad-31", "nona-00"])
def test_the_crops_are_the_frames_blocks_row_by_row(name: str) -> None:
    """Blocks of the packed frames by numpy alone; frames of two sizes, with rest at the bottom and the right."""
    cfa = CFAS[name]
    mosaics = [random_mosaic(61, 75, seed=1), random_mosaic(73, 50, seed=2)]
    blocks = []
    for mosaic in mosaics:
        whole = pack_normalised(mosaic, cfa, (0.0,) * levels_of(cfa), 65535.0)
        rows, columns = (side // 4 for side in whole.shape[1:])
        cut = whole[:, : 4 * rows, : 4 * columns].reshape(len(whole), rows, 4, columns, 4)
        blocks += list(cut.transpose(1, 3, 0, 2, 4).reshape(-1, len(whole), 4, 4))
    dataset = grid(Mosaics(mosaics, cfa), augment=False)
    assert len(dataset) == len(blocks)
    for item, block in zip(dataset, blocks, strict=True):
        np.testing.assert_array_equal(item["target"].numpy(), block)


@pytest.mark.parametrize("name", ["RGGB", "xtrans-00"])
def test_turned_crops_reach_at_most_a_period_into_the_next(name: str) -> None:
    """Of a mosaic whose values say where they stand."""
    cfa, width = CFAS[name], 88
    scale, period = layout_of(cfa)[2], len(cfa)
    side = 4 * scale
    dataset = grid(Mosaics([np.arange(70 * width, dtype=np.uint16).reshape(70, width)], cfa))
    area = packed_area((70, width), cfa)
    columns = (area.width - period) // side
    assert len(dataset) == (area.height - period) // side * columns > columns
    for index, item in enumerate(dataset):
        places = np.rint(item["target"].numpy().astype(np.float64) * 65535).astype(int)
        row, column = divmod(index, columns)
        for found, first in zip(
            np.divmod(places, width), (area.top + side * row, area.left + side * column), strict=True
        ):
            assert first <= found.min() <= first + period
            assert found.max() - found.min() == side - 1


def test_windows_of_clips_have_a_grid_each(drv: SmallDrv) -> None:
    clips = CleanClips([Arrays(np.full((6, 4, 21, 33), 0.2, np.float32), range_dn=1e4)] * 2)
    made = SyntheticClips(clips, "SonyA7S2", crop=8, crops="grid", frames=5)
    assert [made[index]["clip"] for index in range(len(made))] == [0] * 8 + [1] * 8
    whole = DRVDataset(drv.data, manifest=drv.csv)
    read = DRVDataset(drv.data, manifest=drv.csv, crop=8, crops="grid")
    each = (RGB_SIZE[0] // 8) * (RGB_SIZE[1] // 8)
    assert len(read) == each * len(whole) > len(whole)
    assert torch.equal(read[each + 1]["input"], whole[1]["input"][..., :8, 8:16])


def test_what_cannot_be_a_grid_is_refused() -> None:
    source = Arrays(np.full((2, 4, 16, 16), 0.5, np.float32), range_dn=1000.0)
    for options in ({"crop": None}, {"crops_per_frame": 2}):
        with pytest.raises(ArgumentError, match="crops='grid'"):
            grid(source, **options)
    with pytest.raises(ArgumentError, match="crops must be"):
        grid(source, crops="tiles")
    with pytest.raises(DatasetError, match="take a smaller crop"):
        grid(source, crop=16)  # turning takes a period more
    assert len(grid(source, crop=16, augment=False)) == 2
    with pytest.raises(ArgumentError, match="even for X-Trans"):
        grid(Mosaics([random_mosaic(60, 60, seed=1)], XTRANS_CFA), crop=5)


def test_the_papers_schedule_has_257600_steps() -> None:
    """Batches of 1, 200 epochs, of the clean frames that SID's Sony training set has, 2848 x 4256 pixels each."""
    rows = shipped_manifest("sid-sony").records
    clean = {row.path for row in rows if row.split == "train" and row.role == "reference"}
    assert len(clean) == 161
    frame = np.broadcast_to(np.uint16(0), (2848, 4256))
    dataset = grid(Mosaics([frame] * len(clean), BAYER["RGGB"]), crop=512)
    assert len(training_loader(dataset, 1, num_workers=0)) * 200 == 161 * 8 * 200 == 257_600
