"""Synthetic pairs: what an item depends on, where its pixels come from, and its noise."""

from __future__ import annotations

import dataclasses
import hashlib
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch.utils.data import DataLoader, default_collate

from eldata.datasets.base import SourcePairs
from eldata.datasets.clean import Arrays, CleanFrames
from eldata.datasets.items import CroppedItems, Sample
from eldata.datasets.synthetic.pairs import SyntheticPairs
from eldata.datasets.synthetic.synthesis import Recipe, synthesize
from eldata.errors import ArgumentError, DatasetError
from eldata.noise import CameraProfile, NoiseModel
from eldata.raw import write_dng
from eldata.raw.levels import unpack
from tests.cases import in_one_test
from tests.datasets.comparing import same
from tests.datasets.mosaics import Mosaics
from tests.raw.helpers import BAYER, CFAS, EXPOSURE, NONA, colours_of, layout_of, make_sensor, random_mosaic, start_of

NUMBERS = ("gain_dn_per_e", "tukey_lambda", "sigma_tl_dn", "sigma_gauss_dn", "sigma_row_dn")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    top = tmp_path_factory.mktemp("clean")
    for number, cfa in enumerate((BAYER["RGGB"], BAYER["GBRG"], BAYER["BGGR"])):
        write_dng(top / f"{number}.dng", random_mosaic(60, 64, seed=number), make_sensor(cfa), EXPOSURE)
    return top


def pairs(source: Any, profiles: Any = "SonyA7S2", **options: Any) -> SyntheticPairs:
    return SyntheticPairs(source, profiles, **{"crop": 8} | options)


def items(dataset: SyntheticPairs) -> list[Sample]:
    return [dataset[index] for index in range(len(dataset))]


def raw_pairs(folder: Path, **options: Any) -> SyntheticPairs:
    return pairs(CleanFrames(folder), ("SonyA7S2", "NikonD850"), **{"crops_per_frame": 4, "seed": 3} | options)


# --- what an item depends on ----------------------------------------------------------------------------------------


def test_an_item_depends_on_seed_epoch_and_index_alone(folder: Path) -> None:
    """In any order, in batches, which are made at once, and of frames that are kept."""
    reference = items(raw_pairs(folder))
    assert len(reference) == 12
    shuffled = raw_pairs(folder)
    shuffled.set_epoch(0)
    for index in [*np.random.default_rng(0).permutation(12).tolist(), 5, 5, -1, -12]:
        same(shuffled[index], reference[index])
    for number, batch in enumerate(DataLoader(shuffled, batch_size=5)):
        same(batch, default_collate(reference[5 * number : 5 * number + 5]))
    other = raw_pairs(folder)
    other.set_epoch(7)
    assert [item["path"] for item in items(other)] == [item["path"] for item in reference]
    other.set_epoch(0)
    same(other[4], reference[4])
    kept = SyntheticPairs(CleanFrames(folder, keep=3), ("SonyA7S2", "NikonD850"), crop=8, crops_per_frame=4, seed=3)
    for index in range(12):
        same(kept[index], reference[index])
        again = kept[index]
        assert not torch.equal(again["input"], reference[index]["input"])
        assert again["gain_dn_per_e"] != reference[index]["gain_dn_per_e"]
        assert again["ratio"] != reference[index]["ratio"]


# --- where the pixels come from -------------------------------------------------------------------------------------


def numbered(height: int, width: int) -> NDArray[np.uint16]:
    """A mosaic whose values say where they stand: row * width + column."""
    return np.arange(height * width, dtype=np.uint16).reshape(height, width)


@pytest.mark.parametrize("augment", [False, True])
@pytest.mark.parametrize("name", [*BAYER, "xtrans-00", "xtrans-15", "xtrans-42", "quad-13", "nona-25"])
def test_all_eight_orientations_occur_and_keep_the_cfa(name: str, augment: bool) -> None:
    """150 items: one of eight is missed with probability 2e-8."""
    cfa = {**CFAS, **NONA}[name]
    height, width, period, side = 91, 99, len(cfa), 6 * layout_of(cfa)[2]
    y, x = np.mgrid[:side, :side]
    source = Mosaics([numbered(height, width)], cfa)
    found, starts = set(), set()
    for item in items(pairs(source, crop=6, crops_per_frame=150, augment=augment)):
        value = np.rint(item["target"].numpy().astype(np.float64) * 65535).astype(np.int64)
        rows, columns = np.divmod(unpack(value, start_of(cfa)), width)
        # Neighbours stay neighbours, in one direction.
        down = rows[1, 0] - rows[0, 0], columns[1, 0] - columns[0, 0]
        right = rows[0, 1] - rows[0, 0], columns[0, 1] - columns[0, 0]
        np.testing.assert_array_equal(rows, rows[0, 0] + down[0] * y + right[0] * x, strict=True)
        np.testing.assert_array_equal(columns, columns[0, 0] + down[1] * y + right[1] * x)
        found.add((*map(int, down), *map(int, right)))
        starts.add((rows[0, 0], columns[0, 0]))
        # Each packed channel holds its own colour.
        for channel, colour in zip(value, colours_of(cfa), strict=True):
            places = zip(*np.divmod(channel.ravel(), width), strict=True)
            assert {"RGBG"[cfa[row % period][column % period]] for row, column in places} == {colour}
    ways = {(s, 0, 0, t) for s in (1, -1) for t in (1, -1)} | {(0, s, t, 0) for s in (1, -1) for t in (1, -1)}
    assert found == (ways if augment else {(1, 0, 0, 1)})
    assert len(starts) > 30


# --- the noise ------------------------------------------------------------------------------------------------------


def flat(**options: Any) -> SyntheticPairs:
    source = Arrays(np.full((1, 4, 16, 16), 0.3, np.float32), range_dn=15871.0)
    return pairs(**{"source": source, "crops_per_frame": 200} | options)


def test_ratios_are_uniform_between_their_limits() -> None:
    """200 items: the mean within 5 standard errors."""
    assert {item["ratio"] for item in items(flat(ratio=150, crops_per_frame=10))} == {150.0}
    for low, high, options in ((100.0, 300.0, {}), (10.0, 20.0, {"ratio": (10, 20)})):
        ratios = np.array([item["ratio"] for item in items(flat(**options))])
        assert low <= ratios.min() < low + (high - low) / 10
        assert high - (high - low) / 10 < ratios.max() <= high
        assert abs(ratios.mean() - (low + high) / 2) < 5 * (high - low) / math.sqrt(12 * 200)


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
    drawn = {item["tukey_lambda"] for item in items(flat(profiles=profile, iso=[800, 1600], row="any"))}
    assert drawn == {row.tukey_lambda for row in profile.rows}
    one, other = (flat(profiles=profile, iso=iso, crops_per_frame=1)[0] for iso in ({800: 2}, [800]))
    same(one, other)


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
    assert item["iso"] == iso or (iso is None and math.isnan(item["iso"]))


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
    beyond = Arrays(np.linspace(-0.5, 1.5, 4 * 16 * 16, dtype=np.float32).reshape(1, 4, 16, 16), range_dn=15871.0)
    for clip in limits:  # the target is light
        light = pairs(beyond, clip=clip)[0]["target"]
        assert (float(light.min()), float(light.max())) == (0, 1)
    assert torch.equal(torch.stack([item["input"] for item in items(flat(**bright, model=given))]), free.clamp(0, 1))


# --- refusals -------------------------------------------------------------------------------------------------------


@in_one_test(
    "options, words",
    [
        *(({"ratio": ratio}, "ratio must be") for ratio in (0.0, (300.0, 100.0), (100.0, math.nan), "100", (1, 2, 3))),
        ({"crops_per_frame": 0}, "crops_per_frame must be"),
        ({"crop": 1}, "crop 2 or more"),
        ({"seed": -1}, "seed must be"),
        ({"range_dn": 0}, "range_dn must be"),
        ({"row": "best"}, "row must be"),
        ({"clip": "lower"}, "clip must be one of 'both', 'upper', 'none'; found 'lower'"),
        ({"model": NoiseModel(clip="none")}, "SyntheticPairs: clip='both', but the noise model's own clip is 'none'"),
        ({"profiles": []}, "give at least one camera profile"),
        *(({"profiles": given}, "expected a camera profile or several: each") for given in (None, [None], {"Sony"})),
        ({"iso": []}, "iso must be one ISO or several; found none"),
        ({"iso": {}}, "iso must be one ISO or several; found none"),
        ({"iso": [800, 1600, 800]}, r"ISO 800 is there twice; .* give weights, iso=\{800: 2, \.\.\.\}"),
        *(({"iso": iso}, "iso must be one number, finite and above 0; found '800'") for iso in ("800", ["800"])),
        ({"iso": {800: 0, 1600: 1}}, "the weight of ISO 800 must be finite and above 0; found 0"),
        *(({"iso": iso}, "is outside of the calibrated range") for iso in (50, [800, 12800])),
        ({"iso": [800], "row": "measured"}, "has K and all scales of its ISO"),
        ({"source": None}, r"SyntheticPairs: the source of clean data has len and frame\(index\), as"),
    ],
)
def test_what_is_refused(options: dict[str, Any], words: str) -> None:
    with pytest.raises(ArgumentError, match=words):
        flat(**options)


@pytest.mark.parametrize("name", ["RGGB", "xtrans-00", "quad-00", "nona-00"])
def test_a_crop_that_is_too_large(name: str) -> None:
    """With augmentation one period more is needed, and every place is reached."""
    cfa = CFAS[name]
    for augment in (False, True):
        side = 8 * layout_of(cfa)[2] + (len(cfa) if augment else 0)
        fits = pairs(Mosaics([numbered(side, side)], cfa), augment=augment, crops_per_frame=20)
        assert all(item["target"].shape[1:] == (8, 8) for item in items(fits))
        whole = pairs(Mosaics([numbered(side, side)], cfa), crop=None, augment=augment)[0]
        assert whole["input"].shape == whole["target"].shape == fits[0]["target"].shape
        small = pairs(Mosaics([numbered(side, side - 1)], cfa), augment=augment)
        with pytest.raises(DatasetError, match=r"mosaic 0: .* too few for a crop .*take a smaller crop"):
            small[0]


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
    text = repr(flat(profiles=("SonyA7S2", "NikonD850"), seed=5, augment=False))
    parts = ("SyntheticPairs(clean frames: Arrays(1 frames", "cameras: SonyA7S2, NikonD850", "NoiseModel('P*+G*+B+R+U'")
    assert all(part in text for part in parts)
    assert text.endswith("ratio: 100 to 300; items: 200 items, crop=8, augment=False, crops_per_frame=200, seed=5)")


@pytest.mark.parametrize(("black", "white"), [(128.0, 4095.0), (0.0, 24000.0)])
def test_files_of_other_bits_are_refused_with_both_ranges(black: float, white: float, tmp_path: Path) -> None:
    """Under levels that are stated for them as well."""
    clean = write_level(tmp_path / "clean", black, white)
    for levels in ("metadata", "published"):
        words = rf"a.dng: has {white - black:g} DN .* SonyA7S2 .* have 15871; range_dn=15871 makes"
        with pytest.raises(DatasetError, match=words):
            pairs(CleanFrames(clean, levels=levels))[0]
    with pytest.raises(DatasetError, match=rf"a.dng: has {white - black:g} DN .* 15871; the noisy files are like"):
        synthesize(clean, tmp_path / "out", Recipe(CameraProfile.load("SonyA7S2")))
    given = pairs(CleanFrames(clean), range_dn=15871.0)[0]
    shares = np.full((1, 4, 30, 32), given["target"][0, 0, 0], np.float32)
    wanted = pairs(Arrays(shares, range_dn=15871.0))[0]
    assert torch.allclose(given["input"], wanted["input"], atol=1e-3)
    assert pairs(CleanFrames(clean), "CanonEOS5D4")[0]["input"].shape == (4, 8, 8)  # whose levels are not known


def write_level(folder: Path, black: float, white: float) -> Path:
    """Write a flat of a fifth of the range."""
    folder.mkdir()
    sensor = make_sensor(black_level_dn=(black,) * 4, white_level_dn=white)
    write_dng(folder / "a.dng", np.full((60, 64), round(black + 0.2 * (white - black)), np.uint16), sensor, EXPOSURE)
    return folder


@pytest.mark.parametrize("share", [0.68, 1.0, 1.48])
def test_files_of_other_white_levels_are_taken(share: float, tmp_path: Path) -> None:
    """Up to 1.5 times as many DN as the profile's 15871 from black to white, or as much fewer."""
    clean = write_level(tmp_path / "clean", 512.0, 512.0 + round(15871 * share))
    assert pairs(CleanFrames(clean))[0]["target"].mean() == pytest.approx(0.2, abs=1e-4)
    made = synthesize(clean, tmp_path / "out", Recipe(CameraProfile.load("SonyA7S2")))
    assert made.card.counts["noisy"] == 1
