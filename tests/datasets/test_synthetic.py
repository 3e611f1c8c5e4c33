"""Synthetic pairs: what an item depends on, where its pixels come from, and its noise."""

from __future__ import annotations

import copy
import dataclasses
import hashlib
import math
import pickle
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader, default_collate

from eldata.datasets.base import SourcePairs
from eldata.datasets.clean import CleanFrames
from eldata.datasets.items import CroppedItems
from eldata.datasets.synthetic.arrays import Arrays
from eldata.datasets.synthetic.pairs import SyntheticPairs, SyntheticSample
from eldata.datasets.synthetic.synthesis import Recipe, synthesize
from eldata.errors import ArgumentError, DatasetError, ProfileError
from eldata.noise import CameraProfile, NoiseModel
from eldata.raw import write_dng
from eldata.raw.cfa import XTRANS_CFA, pack, unpack
from eldata.raw.levels import pack_normalised
from eldata.sources.frames import Frame
from tests.datasets.comparing import same
from tests.datasets.methods import FORK, workers
from tests.raw.helpers import (
    BAYER,
    CFAS,
    EXPOSURE,
    NONA,
    Cfa,
    colours_of,
    layout_of,
    levels_of,
    make_sensor,
    random_mosaic,
    start_of,
)
from tests.waiting import PATIENCE_S

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

# Python 3.12 and later warn of any fork in a process that has threads.
pytestmark = pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")

NUMBERS = ("gain_dn_per_e", "tukey_lambda", "sigma_tl_dn", "sigma_gauss_dn", "sigma_row_dn")


class Mosaics:
    """A source of given mosaics."""

    def __init__(
        self, mosaics: Sequence[NDArray[Any]], cfa: Cfa, *, black: float = 0.0, white: float = 65535.0
    ) -> None:
        self.mosaics, self.cfa, self.black, self.white = mosaics, cfa, black, white

    def __len__(self) -> int:
        return len(self.mosaics)

    def frame(self, index: int) -> Frame:
        levels = (self.black,) * levels_of(self.cfa)
        return Frame(self.mosaics[index], self.cfa, levels, self.white, f"mosaic {index}")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    top = tmp_path_factory.mktemp("clean")
    for number, cfa in enumerate((BAYER["RGGB"], BAYER["GBRG"], BAYER["BGGR"])):
        write_dng(top / f"{number}.dng", random_mosaic(60, 64, seed=number), make_sensor(cfa), EXPOSURE)
    return top


def pairs(source: Any, profiles: Any = "SonyA7S2", **options: Any) -> SyntheticPairs:
    return SyntheticPairs(source, profiles, **{"crop": 8} | options)


def arrays(packed: Any, **options: Any) -> Arrays:
    return Arrays(packed, **options)


def items(dataset: SyntheticPairs) -> list[SyntheticSample]:
    return [dataset[index] for index in range(len(dataset))]


def raw_pairs(folder: Path, **options: Any) -> SyntheticPairs:
    return pairs(CleanFrames(folder), ("SonyA7S2", "NikonD850"), **{"crops_per_frame": 4, "seed": 3} | options)


def different(first: Mapping[str, Any], second: Mapping[str, Any]) -> None:
    assert not torch.equal(first["input"], second["input"])
    assert first["gain_dn_per_e"] != second["gain_dn_per_e"]
    assert first["ratio"] != second["ratio"]


# --- what an item depends on ----------------------------------------------------------------------------------------


def test_an_item_depends_on_seed_epoch_and_index_alone(folder: Path) -> None:
    reference = items(raw_pairs(folder))
    assert len(reference) == 12
    shuffled = raw_pairs(folder)
    shuffled.set_epoch(0)
    for index in [*np.random.default_rng(0).permutation(12).tolist(), 5, 5, -1, -12]:
        same(shuffled[index], reference[index])
    other = raw_pairs(folder)
    other.set_epoch(7)
    assert [item["path"] for item in items(other)] == [item["path"] for item in reference]
    other.set_epoch(0)
    same(other[4], reference[4])
    kept = SyntheticPairs(CleanFrames(folder, keep=3), ("SonyA7S2", "NikonD850"), crop=8, crops_per_frame=4, seed=3)
    for index in range(12):
        same(kept[index], reference[index])
        different(kept[index], reference[index])


def test_another_seed_epoch_or_index_gives_another_item(folder: Path) -> None:
    dataset = raw_pairs(folder)
    first = dataset[0]
    different(first, dataset[3])  # the same frame
    assert first["path"] == dataset[3]["path"]
    different(first, raw_pairs(folder, seed=4)[0])
    dataset.set_epoch(1)
    assert dataset.epoch == 1
    different(first, dataset[0])
    # Neither sums nor shifts of the three make items equal.
    epoch_4 = raw_pairs(folder, seed=2)
    epoch_4.set_epoch(1)
    different(first, epoch_4[0])


def test_no_global_generator_is_touched(folder: Path) -> None:
    before = torch.get_rng_state(), pickle.dumps(np.random.get_state())  # noqa: NPY002 - it must not have moved
    raw_pairs(folder)[0]
    assert torch.equal(torch.get_rng_state(), before[0])
    assert pickle.dumps(np.random.get_state()) == before[1]  # noqa: NPY002


def loader(dataset: SyntheticPairs, workers: int, method: str | None, **options: Any) -> DataLoader[SyntheticSample]:
    return DataLoader(
        dataset,
        batch_size=None,
        num_workers=workers,
        multiprocessing_context=method,
        timeout=PATIENCE_S if workers else 0,
        **options,
    )


@pytest.mark.parametrize("workers", [0, 2])
@pytest.mark.parametrize("crop", [8, None])
def test_batches_hold_the_items(crop: int | None, workers: int, folder: Path) -> None:
    """Which DataLoaders ask for at once; whole frames and the last, smaller batch too."""
    dataset = raw_pairs(folder, crop=crop, augment=False)
    dataset.set_epoch(1)
    batches = list(DataLoader(dataset, batch_size=5, num_workers=workers, timeout=PATIENCE_S if workers else 0))
    assert [len(batch["path"]) for batch in batches] == [5, 5, 2]
    for number, batch in enumerate(batches):
        wanted = default_collate([dataset[index] for index in range(5 * number, min(5 * number + 5, 12))])
        assert list(batch) == list(wanted)
        for key, value in wanted.items():
            assert torch.equal(batch[key], value) if isinstance(value, torch.Tensor) else batch[key] == value, key


def test_batches_of_different_cameras_are_torchs_error() -> None:
    """As without batches: Bayer and X-Trans are not stacked."""

    class Both(Mosaics):
        def frame(self, index: int) -> Frame:
            cfa = BAYER["RGGB"] if index == 0 else XTRANS_CFA
            return Frame(self.mosaics[index], cfa, (0.0,) * (4 if index == 0 else 3), 65535.0, "")

    dataset = pairs(Both([random_mosaic(60, 60, seed=1)] * 2, BAYER["RGGB"]))
    assert [tuple(sample["input"].shape) for sample in dataset.__getitems__([0, 1])] == [(4, 8, 8), (9, 8, 8)]
    with pytest.raises(RuntimeError, match="stack expects each tensor to be equal size"):
        next(iter(DataLoader(dataset, batch_size=2)))


@pytest.mark.parametrize(
    ("method", "copied"),
    [
        *(pytest.param("fork", copied, marks=FORK.marks) for copied in (None, "pickle", "deepcopy")),
        pytest.param("spawn", None, marks=pytest.mark.study),  # which pickles it
    ],
)
def test_an_epoch_reaches_persistent_workers(method: str, copied: str | None, folder: Path) -> None:
    """Of the data set, and of a copy, whose epoch is not the original's."""
    original, reference = raw_pairs(folder), raw_pairs(folder)
    copies = {None: original, "pickle": pickle.loads(pickle.dumps(original)), "deepcopy": copy.deepcopy(original)}
    dataset = copies[copied]
    batches = loader(dataset, workers(method), method, persistent_workers=True, prefetch_factor=4)
    for epoch in (0, 1, 5, 1):
        dataset.set_epoch(epoch)
        reference.set_epoch(epoch)
        for index, item in enumerate(batches):
            same(item, reference[index])
    assert original.epoch == (1 if copied is None else None)


# --- length, index, collate -----------------------------------------------------------------------------------------


def test_lengths_and_frames() -> None:
    source = arrays(np.full((3, 4, 16, 16), 0.5, np.float32), range_dn=1000.0)
    for crops in (1, 2, 5):
        dataset = pairs(source, crops_per_frame=crops)
        assert len(dataset) == 3 * crops
        assert [item["path"] for item in items(dataset)] == [f"array {i % 3}" for i in range(3 * crops)]
        for index in (3 * crops, -3 * crops - 1, 1000):
            with pytest.raises(IndexError, match=rf"index {index} is outside of {3 * crops} items"):
                dataset[index]


# --- where the pixels come from -------------------------------------------------------------------------------------


def numbered(height: int, width: int) -> NDArray[np.uint16]:
    """A mosaic whose values say where they stand: row * width + column."""
    return np.arange(height * width, dtype=np.uint16).reshape(height, width)


def places(item: SyntheticSample, cfa: Cfa, width: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Row and column, in the clean frame, of each pixel of the target's mosaic."""
    value = np.rint(unpack(item["target"].numpy().astype(np.float64), start_of(cfa)) * 65535).astype(np.int64)
    return value // width, value % width


@pytest.mark.parametrize("name", [*BAYER, "xtrans-00", "xtrans-42", "quad-31", "nona-25"])
def test_a_target_is_an_exact_crop_of_the_normalised_frame(name: str) -> None:
    cfa = {**CFAS, **NONA}[name]
    mosaic = numbered(121, 123)
    source = Mosaics([mosaic], cfa, black=64.0, white=16000.0)
    whole = pack_normalised(mosaic, cfa, source.frame(0).black_level_dn, 16000.0)
    starts = set()
    for item in items(pairs(source, crop=6, augment=False, crops_per_frame=60)):
        target = item["target"].numpy()
        inside = np.flatnonzero((target[0] > 0) & (target[0] < 1))
        if inside.size == 0:
            continue
        y, x = np.unravel_index(inside[0], target.shape[1:])
        ((row, column),) = np.argwhere(whole[0] == target[0, y, x])
        top, left = int(row - y), int(column - x)
        np.testing.assert_array_equal(target, whole[:, top : top + 6, left : left + 6])
        starts.add((top, left))
    assert len(starts) > 30


@pytest.mark.parametrize("name", [*BAYER, "xtrans-15", "xtrans-42", "quad-13", "nona-25"])
def test_all_eight_orientations_occur_and_keep_the_cfa(name: str) -> None:
    """150 items: one of eight is missed with probability 2e-8."""
    cfa = {**CFAS, **NONA}[name]
    height, width = 91, 99
    colours = colours_of(cfa)
    period = len(cfa)
    seen = set()
    for item in items(pairs(Mosaics([numbered(height, width)], cfa), crop=6, crops_per_frame=150)):
        rows, columns = places(item, cfa, width)
        side = 6 * layout_of(cfa)[2]
        assert rows.shape == (side, side)
        # Neighbours stay neighbours, in one direction.
        down = rows[1, 0] - rows[0, 0], columns[1, 0] - columns[0, 0]
        right = rows[0, 1] - rows[0, 0], columns[0, 1] - columns[0, 0]
        y, x = np.mgrid[:side, :side]
        np.testing.assert_array_equal(rows, rows[0, 0] + down[0] * y + right[0] * x)
        np.testing.assert_array_equal(columns, columns[0, 0] + down[1] * y + right[1] * x)
        seen.add((*map(int, down), *map(int, right)))
        # Each packed channel holds its own colour.
        value = np.rint(item["target"].numpy().astype(np.float64) * 65535).astype(np.int64)
        for channel, colour in zip(value, colours, strict=True):
            found = {
                "RGBG"[cfa[a % period][b % period]] for a, b in zip(*np.divmod(channel.ravel(), width), strict=True)
            }
            assert found == {colour}
    ways = {(s, 0, 0, t) for s in (1, -1) for t in (1, -1)} | {(0, s, t, 0) for s in (1, -1) for t in (1, -1)}
    assert seen == ways


@pytest.mark.parametrize("augment", [False, True])
def test_every_place_is_reached(augment: bool) -> None:
    """25 places, 400 items: one is missed with probability 2e-6. With augmentation a period more is needed."""
    side = 18 if augment else 16
    dataset = pairs(Mosaics([numbered(side, side)], BAYER["RGGB"]), crop=4, augment=augment, crops_per_frame=400)
    corners = set()
    covered = np.zeros((side, side), bool)
    for item in items(dataset):
        rows, columns = places(item, BAYER["RGGB"], side)
        corners.add((int(rows.min()) // 2, int(columns.min()) // 2))
        covered[rows, columns] = True
    assert corners >= {(y, x) for y in range(5) for x in range(5)}
    # Turned crops lose up to a row and a column at the bottom and at the right, and unturned ones take none there.
    assert covered[: side - augment, : side - augment].all()


@pytest.mark.parametrize("augment", [False, True])
@pytest.mark.parametrize("name", ["GRBG", "xtrans-42", "quad-12", "nona-41"])
def test_whole_frames(name: str, augment: bool) -> None:
    cfa = CFAS[name]
    mosaic = numbered(66, 78)
    whole = pack(mosaic, cfa).shape
    lost = layout_of(cfa)[1] if augment else 0
    shapes = set()
    for item in items(pairs(Mosaics([mosaic], cfa), crop=None, augment=augment, crops_per_frame=40)):
        shapes.add(tuple(item["target"].shape))
        assert item["input"].shape == item["target"].shape
    straight = (whole[0], whole[1] - lost, whole[2] - lost)
    assert shapes == ({straight, (straight[0], straight[2], straight[1])} if augment else {straight})


def test_float_frames_are_clipped_and_normalised() -> None:
    mosaic = np.linspace(-100, 1200, 32 * 32).reshape(32, 32)
    source = Mosaics([mosaic], BAYER["RGGB"], black=0.0, white=1000.0)
    item = pairs(source, crop=None, augment=False)[0]
    np.testing.assert_allclose(item["target"].numpy(), np.clip(pack(mosaic, BAYER["RGGB"]) / 1000, 0, 1), rtol=1e-6)


# --- the noise ------------------------------------------------------------------------------------------------------


def flat(**options: Any) -> SyntheticPairs:
    source = arrays(np.full((1, 4, 16, 16), 0.3, np.float32), range_dn=15871.0)
    return pairs(source, **{"crops_per_frame": 200} | options)


def test_ratios_are_uniform_between_their_limits() -> None:
    """200 items: the mean within 5 standard errors."""
    for low, high, options in ((100.0, 300.0, {}), (10.0, 20.0, {"ratio": (10, 20)})):
        ratios = np.array([item["ratio"] for item in items(flat(**options))])
        assert low <= ratios.min() < low + (high - low) / 10
        assert high - (high - low) / 10 < ratios.max() <= high
        assert abs(ratios.mean() - (low + high) / 2) < 5 * (high - low) / math.sqrt(12 * 200)


def test_a_fixed_ratio() -> None:
    for ratio in (150, 150.0, (150, 150.0), [150, 150]):
        assert {item["ratio"] for item in items(flat(ratio=ratio, crops_per_frame=10))} == {150.0}


def test_cameras_are_drawn_alike() -> None:
    """200 items of 2 cameras: within 5 standard deviations of a half; one profile by name, path or object."""
    nikon = CameraProfile.load("NikonD850")
    found = items(flat(profiles=["SonyA7S2", nikon]))
    cameras = [item["camera"] for item in found]
    assert abs(cameras.count("SonyA7S2") - 100) < 5 * math.sqrt(50)
    assert set(cameras) == {"SonyA7S2", "NikonD850"}
    for item in found:
        low, high = CameraProfile.load(item["camera"]).gain_range_dn_per_e
        assert low <= item["gain_dn_per_e"] <= high


def test_a_profile_by_name_path_or_object(tmp_path: Path) -> None:
    profile = CameraProfile.load("SonyA7S2")
    profile.save(tmp_path / "mine.json")
    wanted = flat(profiles="SonyA7S2")[0]
    path = tmp_path / "mine.json"
    for profiles in (profile, [profile], ("SonyA7S2",), str(path), path, [path]):
        same(flat(profiles=profiles)[0], wanted)


def test_an_iso_between_two_that_were_measured() -> None:
    """A camera whose ISO 50 has the gain of ISO 100; by one line from end to end K at ISO 320 was 1.61."""
    sony = CameraProfile.load("SonyA7S2")
    rows = tuple(
        dataclasses.replace(sony.rows[0], iso=float(iso), gain_dn_per_e=gain)
        for iso, gain in {50: 0.4, 100: 0.4, 200: 0.8, 400: 1.6, 800: 3.2}.items()
    )
    profile = dataclasses.replace(sony, rows=rows, iso_range=(50.0, 800.0), gain_range_dn_per_e=(0.4, 3.2))
    for iso, gain in ((125, 0.5), (320, 1.28)):
        for item in items(flat(profiles=profile, iso=iso, crops_per_frame=3)):
            assert item["gain_dn_per_e"] == pytest.approx(gain, rel=1e-12)
            assert item["iso"] == iso


def measured_profile() -> CameraProfile:
    """The Sony with all figures of ISO 800 and 1600, off the lines of its fits, and not all of ISO 3200."""
    sony = CameraProfile.load("SonyA7S2")
    rows = tuple(
        dataclasses.replace(
            row, sigma_tl_dn=None if row.iso == 3200 else row.iso / 200, sigma_gauss_dn=4.5, sigma_row_dn=0.75
        )
        if row.iso in (800, 1600, 3200)
        else row
        for row in sony.rows
    )
    return dataclasses.replace(sony, rows=rows)


def figures(item: Mapping[str, Any]) -> tuple[Any, ...]:
    return (*(item[name] for name in NUMBERS), tuple(item["colour_bias_dn"].tolist()))


def test_one_of_several_isos_with_weights() -> None:
    """600 items: each count within 5 standard deviations of its weight's share."""
    for iso, weights in (
        ([800, 1600, 3200], {800: 1, 1600: 1, 3200: 1}),
        ((6400,), {6400: 1}),
        (np.array([200, 400]), {200: 1, 400: 1}),
        ({100: 1, 800: 4.5, 6400: 0.5}, {100: 1, 800: 4.5, 6400: 0.5}),
    ):
        found = items(flat(iso=iso, crops_per_frame=600))
        total = sum(weights.values())
        for value, weight in weights.items():
            share = weight / total
            of_iso = [item for item in found if item["iso"] == value]
            assert abs(len(of_iso) - 600 * share) <= 5 * math.sqrt(600 * share * (1 - share))
            assert {item["gain_dn_per_e"] for item in of_iso} == {CameraProfile.load("SonyA7S2").gain_at_iso(value)}
        assert {item["iso"] for item in found} == set(weights)


def test_each_of_several_isos_has_its_own_row() -> None:
    """As measured where the profile has all of it; else lambda and bias of the ISO's rows, and scales off its lines."""
    profile = measured_profile()
    dataset = flat(profiles=profile, iso=[800, 1600, 3200])
    found = items(dataset)
    for iso in (800, 1600):
        p = profile.measured(iso)
        wanted = (*(getattr(p, name) for name in NUMBERS), p.colour_bias_dn)
        assert {figures(item) for item in found if item["iso"] == iso} == {wanted}
    near = {(row.tukey_lambda, row.colour_bias_dn) for row in profile.rows if row.iso == 3200}
    rest = [figures(item) for item in found if item["iso"] == 3200]
    assert {(numbers[1], numbers[-1]) for numbers in rest} == near
    assert len({numbers[2] for numbers in rest}) == len(rest) > 30
    assert "SonyA7S2 (ISO 800, 1600: measured; ISO 3200: nearest-gain)" in repr(dataset)
    same(
        flat(profiles=profile, iso={800: 2}, crops_per_frame=1)[0],
        flat(profiles=profile, iso=[800], crops_per_frame=1)[0],
    )


def test_the_row_of_several_isos_may_be_given() -> None:
    profile = measured_profile()
    drawn = {item["tukey_lambda"] for item in items(flat(profiles=profile, iso=[800, 1600], row="any"))}
    assert drawn == {row.tukey_lambda for row in profile.rows}
    p = profile.measured(800)
    assert figures(flat(profiles=profile, iso=800, row="measured")[0])[2] == p.sigma_tl_dn
    with pytest.raises(
        ArgumentError, match=r"ISO 3200 of SonyA7S2 was not measured, or not completely; ISO 800, 1600 were"
    ):
        flat(profiles=profile, iso=[800, 3200], row="measured")


def test_every_camera_has_to_know_the_isos() -> None:
    canon = dataclasses.replace(CameraProfile.load("CanonEOS70D"), iso_range=(200.0, 6400.0))
    with pytest.raises(ArgumentError, match="ISO 100 is outside of the calibrated range 200 to 6400 of CanonEOS70D"):
        flat(profiles=["SonyA7S2", canon], iso=[100, 800])
    found = items(flat(profiles=["SonyA7S2", canon], iso=[200, 800]))
    assert {(item["camera"], item["camera_id"], item["iso"]) for item in found} == {
        (camera, number, iso) for number, camera in enumerate(("SonyA7S2", "CanonEOS70D")) for iso in (200.0, 800.0)
    }


@pytest.mark.parametrize(
    ("iso", "words"),
    [
        ([], "iso must be one ISO or several; found none"),
        ({}, "iso must be one ISO or several; found none"),
        ([800, 1600, 800], r"ISO 800 is there twice; to draw some more often give weights, iso=\{800: 2, \.\.\.\}"),
        (["800"], "iso must be one number, finite and above 0; found '800'"),
        ([800, -1], "iso must be finite and above 0; found -1"),
        ({800: 0, 1600: 1}, "the weight of ISO 800 must be finite and above 0; found 0"),
        ({800: None}, "the weight of ISO 800 must be one number"),
        ([800, 12800], "ISO 12800 is outside of the calibrated range"),
        ("800", "iso must be one number, finite and above 0; found '800'"),
    ],
)
def test_isos_that_make_no_sense(iso: Any, words: str) -> None:
    with pytest.raises(ArgumentError, match=words):
        flat(iso=iso)


@pytest.mark.parametrize(
    ("seed", "iso", "epoch", "wanted"),
    [
        (0, None, 0, ("SonyA7S2", 1.0347833592241122, 121.49811849702728, "5b058a5ea300f901")),
        (3, 800, 2, ("SonyA7S2", 0.7513288, 272.9721099788428, "0ce006f03f00c33f")),
        (2**32 - 1, None, 7, ("NikonD850", 4.193193475833979, 209.24141458234968, "eda0f37f011c8484")),
    ],
)
def test_items_are_those_of_0_1(seed: int, iso: float | None, epoch: int, wanted: tuple[Any, ...]) -> None:
    """To the bit: draws and noise of the release, written down here."""
    dataset = flat(profiles=["SonyA7S2", "NikonD850"], crops_per_frame=4, seed=seed, iso=iso)
    dataset.set_epoch(epoch)
    item = dataset[1]
    digest = hashlib.sha256(item["input"].numpy().tobytes()).hexdigest()[:16]
    assert (item["camera"], item["gain_dn_per_e"], item["ratio"], digest) == wanted
    assert item["iso"] == (iso or 0)


def test_the_model_is_passed_on_and_clips_both_ways_by_default() -> None:
    # At this gain and ratio the noise has a deviation of about 0.5 around 0.3; 5120 pixels.
    bright: dict[str, Any] = {"iso": 6400, "ratio": 900.0, "crops_per_frame": 20}
    inputs = torch.stack([item["input"] for item in items(flat(**bright))])
    free = torch.stack([item["input"] for item in items(flat(**bright, clip="none"))])
    assert free.min() < 0
    assert free.max() > 1
    assert torch.equal(free.clamp(0, 1), inputs)
    item = flat(model=NoiseModel("B"), clip="none")[0]
    shift = (item["input"] - item["target"]).double() * 15871.0 / item["ratio"]
    for channel, bias in zip(shift, item["colour_bias_dn"].tolist(), strict=True):
        np.testing.assert_allclose(channel.numpy(), bias, rtol=1e-3, atol=1e-4)


def test_the_dataset_decides_the_clip_as_for_pairs_to_test_on() -> None:
    """One default for all; a model without a clip of its own is clipped like the default one."""
    bright: dict[str, Any] = {"iso": 6400, "ratio": 900.0, "crops_per_frame": 5}
    assert flat().clip == SourcePairs.clip == CroppedItems.clip == "both"
    limits = {"both": (0, 1), "upper": (-math.inf, 1), "none": (-math.inf, math.inf)}
    free = torch.stack([item["input"] for item in items(flat(**bright, clip="none"))])
    for clip, (low, high) in limits.items():
        for model in (None, NoiseModel(), NoiseModel(clip=clip)):  # type: ignore[arg-type]
            dataset = flat(**bright, model=model, clip=clip)
            found = items(dataset)
            assert torch.equal(torch.stack([item["input"] for item in found]), free.clamp(low, high))
            assert (dataset.clip, dataset.model.clip) == (clip, clip)  # type: ignore[attr-defined]
    given = NoiseModel()
    flat(model=given, clip="upper")
    assert given.clip is None
    assert torch.equal(torch.stack([item["input"] for item in items(flat(**bright, model=given))]), free.clamp(0, 1))


def test_the_target_is_light_whatever_the_clip() -> None:
    source = arrays(np.linspace(-0.5, 1.5, 4 * 16 * 16, dtype=np.float32).reshape(1, 4, 16, 16), range_dn=15871.0)
    wanted = pairs(source)[0]["target"]
    assert (float(wanted.min()), float(wanted.max())) == (0, 1)
    for clip in ("upper", "none"):
        assert torch.equal(pairs(source, clip=clip)[0]["target"], wanted)


def test_clips_that_disagree_are_named() -> None:
    for options in ({"clip": "both"}, {}):
        with pytest.raises(
            ArgumentError, match="SyntheticPairs: clip='both', but the noise model's own clip is 'none'"
        ):
            flat(model=NoiseModel(clip="none"), **options)
    with pytest.raises(ArgumentError, match="clip must be one of 'both', 'upper', 'none'; found 'lower'"):
        flat(clip="lower")
    same(flat(model=NoiseModel(clip="both"))[0], flat()[0])


@pytest.mark.parametrize("array", [np.full((1, 4, 8, 8), 3000, np.uint16), [np.ones((4, 8, 8), np.int32)]])
def test_arrays_of_whole_numbers_are_dn(array: Any) -> None:
    with pytest.raises(ArgumentError, match=r"^array 0 is u?int(16|32), whole numbers .* give \(clean - black\)"):
        arrays(array, range_dn=15871.0)
    mixed = arrays([np.ones((4, 8, 8), np.float32), np.ones((4, 8, 8), np.uint8)], range_dn=15871.0)
    with pytest.raises(ArgumentError, match=r"^array 1 is uint8, whole numbers"):
        mixed.frame(1)


def test_the_range_of_the_noise_is_the_frames(folder: Path) -> None:
    """A converter's codes are whole DN of the frame's own range."""
    dataset = raw_pairs(folder, model=NoiseModel("P*+G*"), ratio=100.0)
    for index in range(3):
        sensor = make_sensor()
        range_dn = sensor.white_level_dn - float(np.mean(sensor.black_level_dn))
        assert dataset.source.frame(index).range_dn == range_dn
        item = raw_pairs(folder, model=NoiseModel("P*"), ratio=100.0, clip="none")[index]
        counts = item["input"].double().numpy() * range_dn / 100.0 / item["gain_dn_per_e"]
        np.testing.assert_allclose(counts, np.rint(counts), atol=2e-3)


# --- refusals -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("ratio", [0.0, (300.0, 100.0), (0.0, 100.0), (100.0, math.nan), math.inf, "100", (1, 2, 3), [], None]),
        ("crops_per_frame", [0, -1]),
        ("crop", [1, -8]),
        ("seed", [-1, "0", 2**128]),
    ],
)
def test_a_number_that_makes_no_sense(name: str, values: list[Any]) -> None:
    for value in values:
        with pytest.raises(ArgumentError, match=f"{name} (must be|2 or more)"):
            flat(**{name: value})


def test_an_epoch_that_makes_no_sense() -> None:
    dataset = flat()
    with pytest.raises(ArgumentError, match="epoch must be"):
        dataset.set_epoch(2**32)
    assert dataset.epoch is None


@pytest.mark.parametrize("source", ["clean", np.zeros((1, 4, 8, 8)), None])
def test_a_source_that_is_none(source: Any) -> None:
    with pytest.raises(ArgumentError, match=r"SyntheticPairs: the source of clean data has len and frame\(index\), as"):
        pairs(source)


def test_profiles_that_make_no_sense() -> None:
    with pytest.raises(ArgumentError, match="give at least one camera profile"):
        flat(profiles=[])
    for profiles in (None, 3, [None], {"SonyA7S2"}, b"SonyA7S2"):
        with pytest.raises(ArgumentError, match="expected a camera profile or several: each a shipped one's name"):
            flat(profiles=profiles)
    with pytest.raises(ProfileError, match="no camera profile is called 'Leica'"):
        flat(profiles="Leica")


def test_an_iso_or_row_that_the_profile_does_not_know() -> None:
    with pytest.raises(ArgumentError, match="ISO 50 is outside of the calibrated range"):
        flat(iso=50)
    assert flat(iso=50, extrapolate=True)[0]["gain_dn_per_e"] == pytest.approx(flat(iso=100)[0]["gain_dn_per_e"] / 2)
    with pytest.raises(ArgumentError, match="row must be"):
        flat(row="best")


@pytest.mark.parametrize("name", ["RGGB", "xtrans-00", "quad-00", "nona-00"])
def test_a_crop_that_is_too_large(name: str) -> None:
    cfa = CFAS[name]
    scale, period = layout_of(cfa)[2], len(cfa)
    for augment in (False, True):
        side = 8 * scale + (period if augment else 0)
        fits = pairs(Mosaics([numbered(side, side)], cfa), augment=augment, crops_per_frame=20)
        assert all(item["target"].shape[1:] == (8, 8) for item in items(fits))
        for height, width in ((side - period, side), (side, side - period), (side - 1, side)):
            small = pairs(Mosaics([numbered(height, width)], cfa), augment=augment, crops_per_frame=8)
            for index in range(8):
                with pytest.raises(DatasetError, match=r"mosaic 0: .* too few for a crop .*take a smaller crop"):
                    small[index]


def test_a_whole_frame_of_one_period_has_nothing_to_turn() -> None:
    source = Mosaics([numbered(2, 12)], BAYER["RGGB"])
    with pytest.raises(DatasetError, match="too few"):
        pairs(source, crop=None)[0]
    assert pairs(source, crop=None, augment=False)[0]["target"].shape == (4, 1, 6)


def test_an_odd_crop_of_xtrans() -> None:
    with pytest.raises(ArgumentError, match="crop must be even for X-Trans; found 7"):
        pairs(Mosaics([numbered(60, 60)], XTRANS_CFA), crop=7)[0]
    assert pairs(Mosaics([numbered(60, 60)], BAYER["RGGB"]), crop=7)[0]["target"].shape == (4, 7, 7)


# --- the object -----------------------------------------------------------------------------------------------------


def test_the_range_of_the_simulated_camera_decides_the_noise() -> None:
    """A frame of 12 bits with it has the noise of one of 14 bits to the bit, for both are the same share of white."""
    shared = np.full((1, 4, 64, 64), 0.25, np.float32)
    twelve, fourteen = (Arrays(shared, range_dn=range_dn) for range_dn in (4095.0 - 128, 15871.0))
    wanted = pairs(fourteen, crop=32, iso=1600)[0]
    given = pairs(twelve, crop=32, iso=1600, range_dn=15871.0)[0]
    assert torch.equal(given["input"], wanted["input"])
    alone = pairs(twelve, crop=32, iso=1600)
    assert alone[0]["input"].std() > 1.9 * wanted["input"].std()  # in DN it is as large, of a quarter of the range
    assert "range_dn=15871" in repr(pairs(twelve, range_dn=15871.0))
    assert "range_dn=" not in repr(alone).split("NoiseModel", 1)[1]
    with pytest.raises(ArgumentError, match="range_dn"):
        pairs(twelve, range_dn=0)


@pytest.mark.parametrize(("black", "white"), [(64.0, 1023.0), (128.0, 4095.0), (0.0, 65535.0), (2048.0, 13583.0)])
def test_files_of_other_bits_are_refused_with_both_ranges(black: float, white: float, tmp_path: Path) -> None:
    """Under levels that are stated for them as well; 14 bits that end at 13583 are on the profile's scale."""
    sensor = make_sensor(black_level_dn=(black,) * 4, white_level_dn=white)
    clean = tmp_path / "clean"
    clean.mkdir()
    write_dng(clean / "a.dng", np.full((60, 64), round(black + 0.2 * (white - black)), np.uint16), sensor, EXPOSURE)
    out, recipe = tmp_path / "out", Recipe(CameraProfile.load("SonyA7S2"))
    if white == 13583:
        assert pairs(CleanFrames(clean))[0]["target"].mean() == pytest.approx(0.2, abs=1e-4)
        assert synthesize(clean, out, recipe).card.counts["noisy"] == 1
        return
    for levels in ("metadata", "published"):
        words = rf"a.dng: has {white - black:g} DN .* SonyA7S2 .* have 15871; range_dn=15871 makes"
        with pytest.raises(DatasetError, match=words):
            pairs(CleanFrames(clean, levels=levels))[0]
    with pytest.raises(DatasetError, match=rf"a.dng: has {white - black:g} DN .* 15871; the noisy files are like"):
        synthesize(clean, out, recipe)
    given = pairs(CleanFrames(clean), range_dn=15871.0)[0]
    shares = np.full((1, 4, 30, 32), given["target"][0, 0, 0], np.float32)
    wanted = pairs(arrays(shares, range_dn=15871.0))[0]
    assert torch.allclose(given["input"], wanted["input"], atol=1e-3)
    assert pairs(CleanFrames(clean), "CanonEOS5D4")[0]["input"].shape == (4, 8, 8)  # whose levels are not known


def test_the_repr_says_what_is_made() -> None:
    dataset = flat(profiles=("SonyA7S2", "NikonD850"), seed=5, augment=False)
    text = repr(dataset)
    for part in ("SyntheticPairs(Arrays(1 frames", "200 items", "cameras: SonyA7S2, NikonD850", "NoiseModel('P*+G*"):
        assert part in text
    for part in ("clip='both'", "ratio=(100.0, 300.0)", "crop=8", "augment=False", "seed=5"):
        assert part in text
