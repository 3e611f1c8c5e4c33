"""Synthetic pairs: what an item depends on, where its pixels come from, and its noise."""

from __future__ import annotations

import copy
import math
import pickle
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader, default_collate

from eldata.datasets.clean import Arrays, CleanFrame, RawFiles
from eldata.datasets.synthetic import SyntheticPairs, SyntheticSample
from eldata.errors import ArgumentError, DatasetError, ProfileError
from eldata.noise import CameraProfile, NoiseModel, NoiseParameters
from eldata.raw import write_dng
from eldata.raw.cfa import XTRANS_CFA, pack, pack_normalised, unpack
from tests.datasets.methods import METHODS
from tests.noise.helpers import Law
from tests.raw.helpers import BAYER, BAYER_COLOURS, EXPOSURE, XTRANS, XTRANS_COLOURS, Cfa, make_sensor, random_mosaic
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

    def frame(self, index: int) -> CleanFrame:
        levels = (self.black,) * (4 if len(self.cfa) == 2 else 3)
        return CleanFrame(self.mosaics[index], self.cfa, levels, self.white, f"mosaic {index}")


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
    return pairs(RawFiles(folder), ("SonyA7S2", "NikonD850"), **{"crops_per_frame": 4, "seed": 3} | options)


def same(first: Mapping[str, Any], second: Mapping[str, Any]) -> None:
    assert list(first) == list(second)
    assert set(first) == set(SyntheticSample.__annotations__)
    for key, value in first.items():
        if isinstance(value, torch.Tensor):
            assert value.dtype == second[key].dtype
            assert torch.equal(value, second[key]), key
        else:
            assert value == second[key], key


def different(first: Mapping[str, Any], second: Mapping[str, Any]) -> None:
    assert not torch.equal(first["input"], second["input"])
    assert first["gain_dn_per_e"] != second["gain_dn_per_e"]
    assert first["ratio"] != second["ratio"]


# --- what an item depends on ----------------------------------------------------------------------------------------


def test_an_item_depends_on_seed_epoch_and_index_alone(folder: Path) -> None:
    reference = items(raw_pairs(folder))
    assert len(reference) == 12
    shuffled = raw_pairs(folder)
    for index in [*np.random.default_rng(0).permutation(12).tolist(), 5, 5, -1, -12]:
        same(shuffled[index], reference[index])
    other = raw_pairs(folder)
    other.set_epoch(7)
    assert [item["path"] for item in items(other)] == [item["path"] for item in reference]
    other.set_epoch(0)
    same(other[4], reference[4])
    kept = SyntheticPairs(RawFiles(folder, keep=3), ("SonyA7S2", "NikonD850"), crop=8, crops_per_frame=4, seed=3)
    for index in range(12):
        same(kept[index], reference[index])


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


@pytest.mark.parametrize("workers", [1, 2])
@pytest.mark.parametrize("method", METHODS)
def test_workers_change_nothing(workers: int, method: str, folder: Path) -> None:
    reference = list(loader(raw_pairs(folder), 0, None))
    for item, wanted in zip(loader(raw_pairs(folder), workers, method), reference, strict=True):
        same(item, wanted)


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
        def frame(self, index: int) -> CleanFrame:
            cfa = BAYER["RGGB"] if index == 0 else XTRANS_CFA
            return CleanFrame(self.mosaics[index], cfa, (0.0,) * (4 if index == 0 else 3), 65535.0, "")

    dataset = pairs(Both([random_mosaic(60, 60, seed=1)] * 2, BAYER["RGGB"]))
    assert [tuple(sample["input"].shape) for sample in dataset.__getitems__([0, 1])] == [(4, 8, 8), (9, 8, 8)]
    with pytest.raises(RuntimeError, match="stack expects each tensor to be equal size"):
        next(iter(DataLoader(dataset, batch_size=2)))


def test_a_shuffled_loader_gives_the_same_items(folder: Path) -> None:
    wanted = {item["gain_dn_per_e"]: item for item in items(raw_pairs(folder))}
    shuffled = list(loader(raw_pairs(folder), 2, "fork", shuffle=True, generator=torch.Generator().manual_seed(1)))
    assert len(shuffled) == len(wanted)
    for item in shuffled:
        same(item, wanted[item["gain_dn_per_e"]])


def check_epochs(dataset: SyntheticPairs, folder: Path, method: str) -> None:
    reference = raw_pairs(folder)
    batches = loader(dataset, 2, method, persistent_workers=True, prefetch_factor=4)
    for epoch in (0, 1, 5, 1):
        dataset.set_epoch(epoch)
        reference.set_epoch(epoch)
        for index, item in enumerate(batches):
            same(item, reference[index])


@pytest.mark.parametrize("method", METHODS)
def test_an_epoch_reaches_persistent_workers(method: str, folder: Path) -> None:
    check_epochs(raw_pairs(folder), folder, method)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("copied", ["pickle", "deepcopy"])
def test_an_epoch_reaches_persistent_workers_of_a_copy(method: str, copied: str, folder: Path) -> None:
    original = raw_pairs(folder)
    dataset = pickle.loads(pickle.dumps(original)) if copied == "pickle" else copy.deepcopy(original)
    check_epochs(dataset, folder, method)
    assert original.epoch == 0


def test_a_copy_gives_the_same_items_and_has_an_epoch_of_its_own(folder: Path) -> None:
    dataset = raw_pairs(folder)
    dataset.set_epoch(2)
    again = pickle.loads(pickle.dumps(dataset))
    assert again.epoch == 2
    same(again[1], dataset[1])
    dataset.set_epoch(3)
    assert again.epoch == 2


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


def test_default_collate(folder: Path) -> None:
    dataset = raw_pairs(folder)
    batch = next(iter(DataLoader(dataset, batch_size=4)))
    assert batch["input"].shape == batch["target"].shape == (4, 4, 8, 8)
    assert batch["input"].dtype == batch["target"].dtype == torch.float32
    assert batch["colour_bias_dn"].shape == (4, 4)
    assert batch["colour_bias_dn"].dtype == torch.float64
    assert batch["path"] == [dataset[i]["path"] for i in range(4)]
    assert set(batch["camera"]) <= {"SonyA7S2", "NikonD850"}
    for name in (*NUMBERS, "ratio"):
        assert batch[name].dtype == torch.float64
        assert batch[name].tolist() == [dataset[i][name] for i in range(4)]  # type: ignore[literal-required]


# --- where the pixels come from -------------------------------------------------------------------------------------


def numbered(height: int, width: int) -> NDArray[np.uint16]:
    """A mosaic whose values say where they stand: row * width + column."""
    return np.arange(height * width, dtype=np.uint16).reshape(height, width)


def places(item: SyntheticSample, cfa: Cfa, width: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Row and column, in the clean frame, of each pixel of the target's mosaic."""
    start = cfa if len(cfa) == 2 else XTRANS_CFA
    value = np.rint(unpack(item["target"].numpy().astype(np.float64), start) * 65535).astype(np.int64)
    return value // width, value % width


@pytest.mark.parametrize("name", [*BAYER, "xtrans-00", "xtrans-42"])
def test_a_target_is_an_exact_crop_of_the_normalised_frame(name: str) -> None:
    cfa = {**BAYER, **XTRANS}[name]
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


@pytest.mark.parametrize("name", [*BAYER, "xtrans-00", "xtrans-15", "xtrans-42"])
def test_all_eight_orientations_occur_and_keep_the_cfa(name: str) -> None:
    """150 items: one of eight is missed with probability 2e-8."""
    cfa = {**BAYER, **XTRANS}[name]
    height, width = 91, 99
    colours = BAYER_COLOURS if len(cfa) == 2 else XTRANS_COLOURS
    period = len(cfa)
    seen = set()
    for item in items(pairs(Mosaics([numbered(height, width)], cfa), crop=6, crops_per_frame=150)):
        rows, columns = places(item, cfa, width)
        side = 6 * (2 if period == 2 else 3)
        assert rows.shape == (side, side)
        # Neighbours stay neighbours, in one direction.
        down, right = (
            (rows[1, 0] - rows[0, 0], columns[1, 0] - columns[0, 0]),
            (
                rows[0, 1] - rows[0, 0],
                columns[0, 1] - columns[0, 0],
            ),
        )
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
@pytest.mark.parametrize("name", ["GRBG", "xtrans-42"])
def test_whole_frames(name: str, augment: bool) -> None:
    cfa = {**BAYER, **XTRANS}[name]
    mosaic = numbered(66, 78)
    whole = pack(mosaic, cfa).shape
    lost = (1 if len(cfa) == 2 else 2) if augment else 0
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


def test_an_xtrans_source_gives_nine_channels(tmp_path: Path) -> None:
    cfa = XTRANS["xtrans-42"]
    write_dng(tmp_path / "x.dng", random_mosaic(60, 64), make_sensor(cfa), EXPOSURE)
    for source in (
        RawFiles(tmp_path),
        arrays(np.full((1, 9, 16, 18), 0.5, np.float32), range_dn=1000.0, cfa=cfa),
    ):
        for augment in (False, True):
            item = pairs(source, crop=6, augment=augment)[0]
            assert item["input"].shape == item["target"].shape == (9, 6, 6)


# --- the noise ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("channels", [4, 9])
def test_the_items_parameters_are_those_of_its_noise(channels: int) -> None:
    """8 flat items of 24576 pixels in each channel: means within 5 standard errors of the closed form.

    The variance is that of the component with the fewest draws, the rows: 5 standard errors of it as well.
    """
    cfa = BAYER["RGGB"] if channels == 4 else XTRANS_CFA
    height, width, range_dn, clean = 3072, 8, 15871.0, 0.5
    source = arrays(np.full((1, channels, height, width), clean, np.float32), range_dn=range_dn, cfa=cfa)
    dataset = pairs(
        source,
        ("SonyA7S2", "CanonEOS70D"),
        model=NoiseModel(clip="none"),
        crop=None,
        augment=False,
        crops_per_frame=8,
    )
    gains = set()
    for item in items(dataset):
        bias = item["colour_bias_dn"].tolist()
        numbers = {name: item[name] for name in NUMBERS}  # type: ignore[literal-required]
        parameters = NoiseParameters(**numbers, colour_bias_dn=(bias[0], bias[1], bias[2], bias[3]))
        gains.add(parameters.gain_dn_per_e)
        signal_e = clean * range_dn / (item["ratio"] * parameters.gain_dn_per_e)
        green = (bias[1] + bias[3]) / 2
        of_channel = bias if channels == 4 else [{"R": bias[0], "G": green, "B": bias[2]}[c] for c in XTRANS_COLOURS]
        dn = item["input"].numpy().astype(np.float64) * range_dn / item["ratio"]
        assert torch.allclose(item["target"], torch.tensor(clean))
        pixels, rows = height * width, height
        squares = []
        for channel, value in zip(dn, of_channel, strict=True):
            law = Law.of("P*+G*+B+R+U", parameters, signal_e, value)
            assert abs(channel.mean() - law.mean) < 5 * law.mean_error(pixels, rows)
            squares.append(np.mean((channel - law.mean) ** 2))
        law = Law.of("P*+G*+B+R+U", parameters, signal_e)
        # X-Trans: 9 channels of 3072 packed rows come from 9216 mosaic rows.
        error = law.variance_error(channels * pixels, (2 if channels == 4 else 3) * rows)
        assert abs(np.mean(squares) - law.variance - law.row_variance) < 5 * error
        expected = NoiseModel().expected_variance_dn2(signal_e, parameters)
        assert expected == pytest.approx(law.variance + law.row_variance)
    assert len(gains) == 8


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
    for ratio in (150, 150.0, (150, 150.0)):
        assert {item["ratio"] for item in items(flat(ratio=ratio, crops_per_frame=10))} == {150.0}


def test_cameras_are_drawn_alike() -> None:
    """200 items of 2 cameras: within 5 standard deviations of a half; one profile by name, path or object."""
    nikon = CameraProfile.load("NikonD850")
    dataset = flat(profiles=["SonyA7S2", nikon])
    cameras = [item["camera"] for item in items(dataset)]
    assert abs(cameras.count("SonyA7S2") - 100) < 5 * math.sqrt(50)
    assert set(cameras) == {"SonyA7S2", "NikonD850"}
    for item in items(dataset):
        low, high = CameraProfile.load(item["camera"]).gain_range_dn_per_e
        assert low <= item["gain_dn_per_e"] <= high


def test_a_profile_by_name_path_or_object(tmp_path: Path) -> None:
    profile = CameraProfile.load("SonyA7S2")
    profile.save(tmp_path / "mine.json")
    wanted = flat(profiles="SonyA7S2")[0]
    for profiles in (profile, [profile], ("SonyA7S2",), str(tmp_path / "mine.json")):
        same(flat(profiles=profiles)[0], wanted)


def test_the_iso_and_the_row_are_passed_on() -> None:
    sony = CameraProfile.load("SonyA7S2")
    gain = sony.gain_at_iso(800)
    near = {(row.tukey_lambda, row.colour_bias_dn) for row in sony.rows if row.iso == 800}
    found = items(flat(iso=800, row="nearest-gain", crops_per_frame=40))
    assert {item["gain_dn_per_e"] for item in found} == {gain}
    assert {(item["tukey_lambda"], tuple(item["colour_bias_dn"].tolist())) for item in found} == near
    everywhere = {item["tukey_lambda"] for item in items(flat(iso=800, crops_per_frame=100))}
    assert everywhere == {row.tukey_lambda for row in sony.rows}


def test_the_model_is_passed_on_and_clips_both_ways_by_default() -> None:
    # At this gain and ratio the noise has a deviation of about 0.5 around 0.3; 5120 pixels.
    bright: dict[str, Any] = {"iso": 6400, "ratio": 900.0, "crops_per_frame": 20}
    inputs = torch.stack([item["input"] for item in items(flat(**bright))])
    assert (float(inputs.min()), float(inputs.max())) == (0, 1)
    free = torch.stack([item["input"] for item in items(flat(**bright, model=NoiseModel()))])
    assert free.min() < 0
    assert free.max() > 1
    assert torch.equal(free.clamp(0, 1), inputs)
    item = flat(model=NoiseModel("B", clip="none"))[0]
    shift = (item["input"] - item["target"]).double() * 15871.0 / item["ratio"]
    for channel, bias in zip(shift, item["colour_bias_dn"].tolist(), strict=True):
        np.testing.assert_allclose(channel.numpy(), bias, rtol=1e-3, atol=1e-4)


def test_the_range_of_the_noise_is_the_frames(folder: Path) -> None:
    """A converter's codes are whole DN of the frame's own range."""
    dataset = raw_pairs(folder, model=NoiseModel("P*+G*"), ratio=100.0)
    for index in range(3):
        sensor = make_sensor()
        range_dn = sensor.white_level_dn - float(np.mean(sensor.black_level_dn))
        assert dataset.source.frame(index).range_dn == range_dn
        item = raw_pairs(folder, model=NoiseModel("P*"), ratio=100.0)[index]
        counts = item["input"].double().numpy() * range_dn / 100.0 / item["gain_dn_per_e"]
        np.testing.assert_allclose(counts, np.rint(counts), atol=2e-3)


# --- refusals -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("ratio", [0.0, -1.0, (300.0, 100.0), (0.0, 100.0), math.nan, (100.0, math.nan), math.inf])
def test_a_ratio_that_makes_no_sense(ratio: Any) -> None:
    with pytest.raises(ArgumentError, match="ratio must be"):
        flat(ratio=ratio)


@pytest.mark.parametrize(
    ("name", "value"), [("crops_per_frame", 0), ("crops_per_frame", -1), ("crop", 1), ("crop", 0), ("crop", -8)]
)
def test_a_number_that_makes_no_sense(name: str, value: int) -> None:
    with pytest.raises(ArgumentError, match=r"crops_per_frame must be 1 or more and crop 2 or more; found") as caught:
        flat(**{name: value})
    assert str(value) in str(caught.value)


def test_a_negative_seed() -> None:
    with pytest.raises(ArgumentError, match="seed"):
        flat(seed=-1)


def test_a_negative_epoch() -> None:
    dataset = flat()
    with pytest.raises(ArgumentError, match="epoch must be 0 or more; found -1"):
        dataset.set_epoch(-1)
    assert dataset.epoch == 0


def test_profiles_that_make_no_sense() -> None:
    with pytest.raises(ArgumentError, match="give at least one camera profile"):
        flat(profiles=[])
    with pytest.raises(ProfileError, match="no camera profile is called 'Leica'"):
        flat(profiles="Leica")


def test_an_iso_or_row_that_the_profile_does_not_know() -> None:
    with pytest.raises(ArgumentError, match="ISO 50 is outside of the calibrated range"):
        flat(iso=50)[0]
    assert flat(iso=50, extrapolate=True)[0]["gain_dn_per_e"] == pytest.approx(flat(iso=100)[0]["gain_dn_per_e"] / 2)
    with pytest.raises(ArgumentError, match="row must be"):
        flat(row="best")[0]


@pytest.mark.parametrize("name", ["RGGB", "xtrans-00"])
def test_a_crop_that_is_too_large(name: str) -> None:
    cfa = {**BAYER, **XTRANS}[name]
    scale, period = (2, 2) if len(cfa) == 2 else (3, 6)
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


def test_the_repr_says_what_is_made() -> None:
    dataset = flat(profiles=("SonyA7S2", "NikonD850"), seed=5, augment=False)
    text = repr(dataset)
    for part in ("SyntheticPairs(Arrays(1 frames", "200 items", "cameras: SonyA7S2, NikonD850", "NoiseModel('P*+G*"):
        assert part in text
    for part in ("clip='both'", "ratio=(100.0, 300.0)", "crop=8", "augment=False", "seed=5"):
        assert part in text
