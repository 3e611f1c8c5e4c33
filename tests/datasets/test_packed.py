"""Pairs and clips of a store: bit for bit what the files give, by whatever process; and pairs of two noisy frames."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.many_frames import write_small_store
from benchmarks.raw_training import make_datasets, train
from eldata.datasets import (
    CleanClips,
    CleanFrames,
    Noise2Noise,
    PackedStore,
    PairDataset,
    SIDDataset,
    SyntheticClips,
    SyntheticPairs,
    base,
    training_loader,
)
from eldata.datasets.crops import Crop
from eldata.datasets.items import Sample
from eldata.datasets.packed import PackedClips
from eldata.datasets.published import DRVDataset
from eldata.errors import ArgumentError, DatasetError
from eldata.manifest.card import Subset, save_card
from eldata.raw.dng import write_dng
from eldata.records import Records
from eldata.sources.frames import Frame
from eldata.sources.pairs import PairOpener
from eldata.sources.store import build_store, source_of_dataset, verify_store
from tests.datasets.comparing import same, same_frames
from tests.drv_tree import RGB_SIZE, SENSOR, SmallDrv, write_raw_clip
from tests.raw.helpers import BAYER, EXPOSURE, XTRANS, make_sensor, random_mosaic
from tests.sid_tree import SmallTree, build_small_tree
from tests.sources.store.helpers import pack_folder, pack_tree, write_clean
from tests.trees import BETA, Tree

# --- the raw route ------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def sets(pristine: Tree, store: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Tree, Path]]:
    """Trees and their stores: RGGB and GBRG; X-Trans, compressed."""
    folder = tmp_path_factory.mktemp("fuji")
    fuji = build_small_tree("sid-fuji", folder, ["10019"])
    packed = pack_tree(fuji, folder / "fuji.h5", compression="zstd").store
    return {"eld": (pristine, store), "fuji": (fuji, packed)}


@pytest.mark.parametrize(
    ("name", "levels", "clip", "amplification"),
    [
        ("eld", "published", "both", "metadata"),
        ("eld", "metadata", "upper", "nominal"),
        ("eld", "metadata", "none", "metadata"),
        ("fuji", "sid-fuji", "upper", "metadata"),
    ],
)
def test_whole_frames_equal_the_raw_route(
    name: str, levels: Any, clip: Any, amplification: Any, sets: dict[str, tuple[Tree, Path]]
) -> None:
    tree, store = sets[name]
    options: dict[str, Any] = {"levels": levels, "clip": clip, "amplification": amplification}
    raw = PairDataset(tree.data, tree.csv, **options)
    stored = PackedStore(store, crop=None, augment=False, **options)
    assert stored.records == raw.records
    for ours, theirs in zip(stored, raw, strict=True):
        same(ours, theirs)


def test_clean_crops_are_those_of_the_raw_files(tmp_path: Path) -> None:
    """Bayer and X-Trans of every phase: SyntheticPairs cannot tell the two sources apart."""
    folder = write_clean(tmp_path / "raws")
    store = pack_folder(folder, tmp_path / "clean.h5", compression="lz4").store
    levels: Any
    for levels in ("metadata", "published"):
        ours, theirs = (
            SyntheticPairs(CleanFrames(source, levels=levels), "SonyA7S2", crop=8, crops_per_frame=5, seed=2)
            for source in (store, folder)
        )
        for mine, other in zip(ours, theirs, strict=True):
            assert mine["path"].rpartition("/")[2] == other["path"].rpartition("/")[2]
            same(dict(mine) | {"path": "", "reference": ""}, dict(other) | {"path": "", "reference": ""})


# --- choices and refusals -----------------------------------------------------------------------------------------


def test_choices_among_the_stores_pairs(store: Path) -> None:
    dataset = PackedStore(store, cameras=["DemoBeta"], ratios=[100, 200], crop=8, seed=3)
    assert {record.camera for record in dataset.records} == {"DemoBeta"}
    assert {record.ratio for record in dataset.records} == {100, 200}
    assert list(dataset.frame["path"]) == [record.path for record in dataset.records]
    text = repr(dataset)
    for part in ("PackedStore", "6 of ", "DemoBeta", "crop=8", "augment=True", "seed=3", "levels='published'"):
        assert part in text
    for options, word in (
        ({"cameras": ["X"]}, "known are DemoAlpha, DemoBeta"),
        ({"levels": "camera"}, "levels must be one of"),
        ({"clip": "lower"}, "clip must be one of"),
        ({"amplification": "x"}, "amplification must be one of"),
        ({"subset": "x"}, "no subset is called 'x'"),
        ({"crop": 1}, "crop 2 or more"),
        ({"crops_per_frame": 0}, "crops_per_frame must be 1 or more"),
    ):
        with pytest.raises(ArgumentError, match=word):
            PackedStore(store, **options)
    with pytest.raises(DatasetError, match="too few for a crop"):
        PackedStore(store, crop=48)[0]


def test_a_store_of_a_part_and_its_subsets(tree: Tree, tmp_path: Path) -> None:
    card = tree.manifest.card
    subsets = (Subset("beta", "one camera", "", 12, paths="DemoBeta/*"), Subset("all", "all", "", 24))
    save_card(tree.csv.with_suffix(".json"), replace(card, subsets=subsets))
    source = source_of_dataset(card.name, root=tree.root, manifest=tree.csv, subset="beta")
    assert {path.rpartition("/")[0] for path, _ in source.files} == {BETA}
    build_store(source, tmp_path / "beta.h5")
    for subset in (None, "beta"):
        assert len(PackedStore(tmp_path / "beta.h5", crop=8, subset=subset)) == 12
    with pytest.raises(DatasetError, match="lacks 12 of the 24 chosen pairs, such as DemoAlpha/"):
        PackedStore(tmp_path / "beta.h5", subset="all")


# --- what does not grow with the number of frames ---------------------------------------------------------------------


def test_opening_a_store_opens_one_pair_of_each_kind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """500 frames of 50 scenes, each with a white balance of its own: pairs of one kind. A batch opens its own four."""
    path = write_small_store(tmp_path / "small.h5", 500)
    assert verify_store(path).ok
    opened: list[str] = []
    open_pair = PairOpener.open_pair

    def counted(opener: Any, record: Any, target: Any) -> Any:
        opened.append(record.path)
        return open_pair(opener, record, target)

    monkeypatch.setattr(PairOpener, "open_pair", counted)
    pairs = PackedStore(path, crop=16)
    assert (len(pairs), len(opened)) == (450, 1)
    loader = training_loader(pairs, 4, num_workers=0)
    next(iter(loader))
    assert len(opened) == 5
    monkeypatch.setattr(base, "_MOST_OPEN", 10)
    for _ in zip(range(20), loader, strict=False):
        assert len(pairs._pairs) <= 10


def test_a_dataset_goes_to_workers_by_columns(tmp_path: Path) -> None:
    """It is the same there; frames share their sensors, and what one process has opened the others have not."""
    pairs = PackedStore(write_small_store(tmp_path / "small.h5", 200), crop=16)
    pairs.set_epoch(0)
    first = pairs[3]
    sent = pickle.loads(pickle.dumps(pairs))
    assert sent.records == pairs.records
    assert sent.source.frames == pairs.source.frames
    assert sent.source.records == pairs.source.records
    assert len({*map(id, (frame.sensor for frame in sent.source.frames))}) == 20
    assert sent._pairs == {}
    assert sent[3]["path"] == first["path"]
    assert (sent[3]["input"] == first["input"]).all()
    assert pickle.loads(pickle.dumps(Records())) == ()
    assert isinstance(sent.records, tuple)


# --- clips ------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def rgb(drv: SmallDrv, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return pack_tree(drv, tmp_path_factory.mktemp("store") / "rgb.h5").store


@pytest.fixture(scope="module")
def raw_files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder that holds DRV: Bayer clips, and an X-Trans one of another size and phase."""
    root = tmp_path_factory.mktemp("raw")
    for clip in ("0007", "M0003"):
        write_raw_clip(root / "DRV", clip, 7)
    xtrans = replace(SENSOR, cfa=XTRANS["xtrans-42"], black_level_dn=(801.0,) * 3, height=83, width=94)
    write_raw_clip(root / "DRV", "0013", 7, sensor=xtrans)
    return root


@pytest.fixture(scope="module")
def raw(raw_files: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    store = tmp_path_factory.mktemp("store") / "raw.h5"
    build_store(source_of_dataset("drv-raw", root=raw_files), store, compression="lz4")
    return store


# --- the files ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "options",
    [{}, {"window": 3, "stride": 2}, {"frames": "evaluation"}, {"ids": ["0013"]}, {"dynamic": True, "window": 4}],
)
def test_whole_rgb_windows_are_those_of_the_files(options: dict[str, Any], rgb: Path, drv: SmallDrv) -> None:
    ours = PackedClips(rgb, crop=None, augment=False, **options)
    theirs = DRVDataset(drv.data, manifest=drv.csv, **options)
    assert ours.records == theirs.records
    assert ours.frame.equals(theirs.frame)
    without = {"target"} if options.get("dynamic") else set()
    for mine, other in zip(ours, theirs, strict=True):
        same(mine, other)
        assert set(mine) == set(Sample.__annotations__) - without


@pytest.mark.parametrize(("levels", "clip"), [("metadata", "both"), ("published", "upper"), ("metadata", "none")])
def test_whole_raw_windows_are_those_of_the_files(levels: Any, clip: Any, raw: Path, raw_files: Path) -> None:
    for dynamic, channels in ((False, {4, 9}), (True, {4})):
        options: dict[str, Any] = {"levels": levels, "clip": clip, "window": 3, "dynamic": dynamic}
        ours = PackedClips(raw, crop=None, augment=False, **options)
        for mine, other in zip(ours, DRVDataset(raw_files / "DRV", form="raw", **options), strict=True):
            same(mine, other)
        assert {sample["input"].shape[1] for sample in ours} == channels


def test_crops_of_rgb_windows_are_parts_of_the_files_turned_alike(rgb: Path, drv: SmallDrv) -> None:
    """Each frame and the reference at the drawn place, turned by numpy."""
    ours, theirs = PackedClips(rgb, crop=21, crops_per_window=6, seed=4), DRVDataset(drv.data, manifest=drv.csv)
    ours.set_epoch(2)
    assert len(ours) == 6 * len(theirs)
    like = Frame.of_rgb(np.zeros((3, *RGB_SIZE), np.uint16), "")
    for index, sample in enumerate(ours):
        crop = Crop.draw(like, np.random.default_rng([4, 2, index]), crop=21, augment=True)
        rows, columns = (
            slice(None, None, -1 if flip else 1) for flip in (crop.orientation.flip_rows, crop.orientation.flip_columns)
        )
        for name in ("input", "target"):
            part = theirs[index % len(theirs)][name][(..., *crop.slices)].numpy()
            part = np.swapaxes(part, -1, -2) if crop.orientation.transpose else part
            np.testing.assert_array_equal(sample[name].numpy(), part[..., rows, columns])


# --- choices and refusals -----------------------------------------------------------------------------------------


def test_choices_and_refusals(rgb: Path, raw: Path) -> None:
    dataset = PackedClips(rgb, crop=16, ids=["0013"], window=2)
    assert {record.scene for record in dataset.records} == {"0013"}
    assert PackedClips(rgb, crop=16, scenes=["0013"], window=2).records == dataset.records
    for part in ("PackedClips", "1 clips, 6 windows of 2 frames", "crop=16", "augment=True", "seed=0", "levels="):
        assert part in repr(dataset)
    for options, word in (
        ({"split": ["train"]}, "no clip has split train; known are test"),
        ({"crops_per_window": 0}, "crops_per_window must be 1 or more"),
        ({"crop": 9, "region": (0, 0, 4, 4)}, "give a region or a crop, not both"),
    ):
        with pytest.raises(ArgumentError, match=word):
            PackedClips(rgb, **options)
    for store, crop in ((rgb, 49), (raw, 400)):
        with pytest.raises(DatasetError, match=f"too few for a crop of {crop if crop == 49 else 2 * crop}"):
            PackedClips(store, crop=crop, augment=False)[0]


def test_stores_of_other_things_are_refused(rgb: Path, store: Path, drv: SmallDrv, tmp_path: Path) -> None:
    source = source_of_dataset("drv", root=drv.root, manifest=drv.csv, ids=["M0003"])
    build_store(source, tmp_path / "dynamic.h5")
    with pytest.raises(DatasetError, match="holds no clip with a reference; read it with dynamic=True"):
        PackedClips(tmp_path / "dynamic.h5")
    (tmp_path / "raws").mkdir()
    sensor = make_sensor(BAYER["RGGB"], 64, 64)
    write_dng(tmp_path / "raws" / "1.dng", random_mosaic(64, 64), sensor, EXPOSURE)
    clean = pack_folder(tmp_path / "raws", tmp_path / "clean.h5").store
    with pytest.raises(DatasetError, match="holds clean frames, not clips; read it with CleanFrames or CleanClips"):
        PackedClips(clean)
    with pytest.raises(DatasetError, match="holds clean frames, not pairs; read it with CleanFrames"):
        PackedStore(clean)
    with pytest.raises(DatasetError, match="holds pairs, not clips; read it with PackedStore"):
        PackedClips(store)
    with pytest.raises(DatasetError, match="holds a dataset, not clean clips"):
        CleanClips(rgb)


# --- clean clips --------------------------------------------------------------------------------------------------


def test_clean_clips_are_those_of_the_raw_files(tmp_path: Path) -> None:
    folder = tmp_path / "clips"
    for clip, cfa in (("a", BAYER["GBRG"]), ("b", BAYER["RGGB"])):
        (folder / clip).mkdir(parents=True)
        for number in (9, 10, 11):
            mosaic = random_mosaic(70, 90, seed=number)
            write_dng(folder / clip / f"{number}.dng", mosaic, make_sensor(cfa, 70, 90), EXPOSURE)
    store = pack_folder(folder, tmp_path / "clean.h5", compression="lz4").store
    levels: Any
    for levels in ("metadata", "published"):
        ours, theirs = (CleanClips(source, levels=levels) for source in (store, folder))
        assert len(ours) == len(theirs) == 2
        for number in range(2):
            same_frames(ours.clip(number), theirs.clip(number))
        made = [SyntheticClips(clips, "SonyA7S2", frames=2, crop=8, seed=2)[1] for clips in (ours, theirs)]
        same(*(dict(sample) | {"path": "", "reference": ""} for sample in made))
    assert "2 clips" in repr(ours)
    (folder / "a" / "10.dng").unlink()
    gap = pack_folder(folder, tmp_path / "gap.h5").store
    with pytest.raises(DatasetError, match="expected the frames of one clip, numbered without a gap"):
        CleanClips(gap)


# --- two noisy frames -------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def burst_tree(tmp_path_factory: pytest.TempPathFactory) -> SmallTree:
    """Bursts of one scene at several ratios."""
    return build_small_tree("sid-sony", tmp_path_factory.mktemp("sony"), ["10003"])


@pytest.fixture(scope="module")
def bursts(burst_tree: SmallTree, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return pack_tree(burst_tree, tmp_path_factory.mktemp("store") / "sony.h5").store


def test_each_item_is_two_exposures_of_one_place(bursts: Path) -> None:
    """The same crop of the whole frames, each in turn the input, every other frame of its burst a target in time."""
    pairs = PackedStore(bursts, crop=8, augment=True, crops_per_frame=3, clip="none", seed=4)
    noisy = Noise2Noise(pairs)
    noisy.set_epoch(0)
    shots: dict[object, set[str]] = {}
    for record in pairs.records:
        shots.setdefault((record.ratio, record.iso), set()).add(record.path)
    assert max(map(len, shots.values())) > 2
    assert len(noisy) == 3 * sum(len(burst) for burst in shots.values() if len(burst) > 1)
    parts = [[*pairs.draw_item(n, np.random.default_rng(0)).parts][1] for n in range(len(pairs.records))]
    numbers = {id(part.frame): number for number, part in enumerate(parts)}
    met = set()
    for index in range(len(noisy)):
        item, sample = noisy.item(index), noisy[index]
        first, second = (numbers[id(part.frame)] for part in item.parts)
        one, other = pairs.records[first], pairs.records[second]
        assert sample["path"] == one.path != other.path
        assert {one.path, other.path} <= shots[one.ratio, one.iso]
        met.add((one.path, other.path))
        for side, part in (("input", parts[first]), ("target", parts[second])):
            expected = np.empty(item.crop.packed_shape, np.float32)
            item.crop.fill(part.frame, expected, clip="none", gain=part.gain)
            np.testing.assert_array_equal(sample[side].numpy(), expected)  # type: ignore[literal-required]
    assert repr(noisy).startswith(f"Noise2Noise(noisy frames: {len(noisy) // 3} of ")
    assert len(met) > len(noisy) // 3  # three crops of a frame seldom have one and the same target


def test_two_crops_of_a_grid_have_one_place(bursts: Path) -> None:
    """Each crop of each noisy frame that has another of its kind, once, and the target's from the same place."""
    pairs = PackedStore(bursts, crop=8, crops="grid", augment=False)
    noisy = Noise2Noise(pairs)
    each = len(pairs) // len(pairs.records)
    items = [noisy.item(index) for index in range(len(noisy))]
    places = {(part.facts["path"], str(item.crop.slices)) for item in items for part in [*item.parts][:1]}
    assert len(places) == len(noisy) > each > 1
    assert len(noisy) % each == 0
    assert {str(item.crop.slices) for item in items} == {str(pairs.item(n).crop.slices) for n in range(len(pairs))}


def test_what_has_no_second_exposure_is_refused(burst_tree: SmallTree, bursts: Path) -> None:
    with pytest.raises(ArgumentError, match="pack the dataset"):
        Noise2Noise(SIDDataset(burst_tree.data, manifest=burst_tree.csv))
    single = PackedStore(bursts)
    single.records = single.records[:1]
    with pytest.raises(ArgumentError, match="of 1 pairs none has another one"):
        Noise2Noise(single)


def test_uncompressed_raws_train_as_their_store(tmp_path: Path) -> None:
    """Files as an A7S II writes them; benchmarks/raw_training.py takes 200 steps of whole ones."""
    raws, store = make_datasets(tmp_path, ("00001",), (160, 4256), crop=32, crops_per_frame=2)
    assert raws.source.frame(raws.records[0].path).reads_parts
    assert train(raws, 3) == train(store, 3)
