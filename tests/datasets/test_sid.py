"""SIDDataset: samples equal to a plain route bit for bit for both cameras, choices of pairs, and clear refusals."""

from __future__ import annotations

import shutil
from collections import Counter
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import rawpy
import torch
from torch.utils.data import DataLoader

from eldata import SIDDataset
from eldata.datasets import open_dataset
from eldata.errors import ArgumentError, DatasetError, ManifestError
from eldata.manifest.catalogue import shipped_manifest
from eldata.raw.levels import with_levels
from tests.raw.helpers import sid_pack
from tests.sid_tree import SENSORS, frames_of, write_frames
from tests.trees import scale_exposure, swap
from tests.waiting import PATIENCE_S

if TYPE_CHECKING:
    from numpy.typing import NDArray

CAMERAS = ("sony", "fuji")
BOTH = pytest.mark.parametrize("camera", CAMERAS)

# Validation and test scenes at all ratios, and a misaligned one.
NOISY = {
    "sony": [
        *(f"Sony/short/{scene}_00_{time}s.ARW" for scene in ("10185", "20201") for time in ("0.1", "0.04", "0.033")),
        "Sony/short/10034_00_0.1s.ARW",
    ],
    "fuji": [
        *("Fuji/short/10019_00_0.1s.RAF", "Fuji/short/10019_00_0.033s.RAF", "Fuji/short/10172_00_0.04s.RAF"),
        "Fuji/short/20015_00_0.1s.RAF",
    ],
}
SCENES = {camera: sorted({Path(path).name[:5] for path in paths}) for camera, paths in NOISY.items()}


@pytest.fixture(scope="session")
def sid(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Some pairs of both halves below one folder. Not to be changed."""
    folder = tmp_path_factory.mktemp("data") / "SID"
    for camera in CAMERAS:
        manifest = shipped_manifest(f"sid-{camera}")
        write_frames(manifest.name, folder, frames_of(manifest, NOISY[camera]))
    return folder


@pytest.fixture
def own(sid: Path, tmp_path: Path) -> Path:
    """A copy of one's own."""
    return Path(shutil.copytree(sid, tmp_path / "SID"))


def some(camera: Any, root: Path, **options: Any) -> SIDDataset:
    """The pairs whose files are there."""
    dataset = SIDDataset(root, camera=camera, scenes=SCENES[camera], **options)
    dataset.records = tuple(record for record in dataset.records if record.path in NOISY[camera])
    return dataset


# --- pixels -------------------------------------------------------------------------------------------------------


def plain_packed(path: Path, black: float | None, white: float) -> NDArray[np.float32]:
    """Packed and normalised as the ELD and SID code do it, in numpy on rawpy's pixels, without any clip."""
    with rawpy.imread(str(path)) as raw:
        dn = raw.raw_image_visible.astype(np.float32)
        own = raw.black_level_per_channel
    if path.suffix == ".ARW":
        planes = np.stack([dn[0::2, 0::2], dn[0::2, 1::2], dn[1::2, 1::2], dn[1::2, 0::2]])
        level = np.array(own if black is None else [black] * 4, np.float32)[:, None, None]
    else:
        planes = sid_pack(dn[: dn.shape[0] // 6 * 6, : dn.shape[1] // 6 * 6])
        level = np.array([own[0] if black is None else black], np.float32)[:, None, None]
    packed: NDArray[np.float32] = (planes - level) / (np.float32(white) - level)
    return packed


def same_bits(tensor: torch.Tensor, expected: NDArray[np.float32]) -> None:
    assert tensor.dtype == torch.float32
    assert expected.dtype == np.float32
    np.testing.assert_array_equal(tensor.numpy().view(np.uint32), expected.view(np.uint32))


LEVELS = {
    ("sony", "published"): (None, 16383.0),
    ("sony", "metadata"): (None, SENSORS["sid-sony"].white_level_dn),
    ("sony", "sid-sony"): (512.0, 16383.0),
    ("fuji", "published"): (None, 16383.0),
    ("fuji", "metadata"): (None, SENSORS["sid-fuji"].white_level_dn),
    ("fuji", "sid-fuji"): (1024.0, 16383.0),
}


@pytest.mark.parametrize(("camera", "levels"), LEVELS)
@pytest.mark.parametrize("clip", ["both", "upper"])
def test_samples_equal_a_plain_route_bit_for_bit(camera: str, levels: str, clip: str, sid: Path) -> None:
    black, white = LEVELS[camera, levels]
    low = np.float32(0 if clip == "both" else -np.inf)
    dataset = some(camera, sid, levels=levels, clip=clip)
    assert len(dataset) == len(NOISY[camera])
    for record, sample in zip(dataset.records, dataset, strict=True):
        noisy = np.clip(plain_packed(sid / record.path, black, white), low, np.float32(1))
        same_bits(sample["input"], np.clip(noisy * np.float32(record.ratio), low, np.float32(1)))
        target = plain_packed(sid / record.reference, black, white)
        same_bits(sample["target"], np.clip(target, np.float32(0), np.float32(1)))


def test_the_tree_has_what_the_comparison_must_cover(sid: Path) -> None:
    for camera, channels in (("sony", 4), ("fuji", 9)):
        for sample in some(camera, sid, clip="upper"):
            assert sample["input"].shape == sample["target"].shape
            assert sample["input"].shape[0] == channels
            assert sample["input"].min() < 0
            assert sample["target"].min() == 0, "the clip is of the input"
            assert sample["input"].max() == sample["target"].max() == 1


def test_levels_by_every_name_differ(sid: Path) -> None:
    """Or the comparison above could not tell which ones were taken."""
    for camera in CAMERAS:
        levels: list[Any] = [name for other, name in LEVELS if other == camera]
        targets = [some(camera, sid, levels=name, clip="none")[0]["target"] for name in levels]
        assert not any(torch.equal(a, b) for i, a in enumerate(targets) for b in targets[:i])


def test_the_published_constants_by_name() -> None:
    for name, (black, channels) in {"sid-sony": (512.0, 4), "sid-fuji": (1024.0, 3)}.items():
        sensor = with_levels(SENSORS[name], name)  # type: ignore[arg-type]
        assert (sensor.black_level_dn, sensor.white_level_dn) == ((black,) * channels, 16383.0)
    with pytest.raises(
        ArgumentError, match="levels must be one of 'metadata', 'published', 'sid-sony', 'sid-fuji', 'lrid'"
    ):
        with_levels(SENSORS["sid-sony"], "sid")  # type: ignore[arg-type]


# --- fields -------------------------------------------------------------------------------------------------------


@BOTH
def test_scalar_fields_are_the_records(camera: str, sid: Path) -> None:
    dataset = some(camera, sid)
    for record, sample in zip(dataset.records, dataset, strict=True):
        assert sample["ratio"] == sample["nominal_ratio"] == float(record.ratio) in (100.0, 250.0, 300.0)
        assert sample["iso"] == float(record.iso or 0) > 0
        assert sample["exposure_s"] == float(record.exposure_s or 0) > 0
        for name in ("camera", "scene", "split", "path", "reference"):
            assert sample[name] == getattr(record, name)
        assert sample["flags"] == ";".join(record.flags)
    assert {sample["camera"] for sample in dataset} == {{"sony": "SonyA7S2", "fuji": "FujifilmXT2"}[camera]}


def test_the_input_is_multiplied_by_the_nominal_ratio_as_published(own: Path) -> None:
    """EXIF that has 0.033 s in place of 1/30: 303 by EXIF, 300 by the published rule."""
    name = "Sony/short/10185_00_0.033s.ARW"
    scale_exposure(own / name, Fraction(990, 1000))
    by = {}
    for amplification in ("nominal", "metadata"):
        dataset = some("sony", own, amplification=amplification, clip="none")
        (by[amplification],) = [sample for sample in dataset if sample["path"] == name]
    assert (by["nominal"]["ratio"], by["nominal"]["nominal_ratio"]) == (300.0, 300.0)
    assert (by["metadata"]["ratio"], by["metadata"]["nominal_ratio"]) == (float(Fraction(10000, 33)), 300.0)
    once = plain_packed(own / name, None, 16383.0)
    same_bits(by["nominal"]["input"], once * np.float32(300))
    same_bits(by["metadata"]["input"], once * np.float32(Fraction(10000, 33)))


def test_a_frame_of_uncertain_iso_is_read(tmp_path: Path) -> None:
    """If the list's ISO 12800 is true, the ratio by EXIF is 600; the published code has 300, and training goes on."""
    name = "Sony/short/00207_02_0.033s.ARW"
    manifest = shipped_manifest("sid-sony")
    write_frames("sid-sony", tmp_path, frames_of(manifest, [name]))
    dataset = SIDDataset(tmp_path, scenes=[207])
    (position,) = [i for i, record in enumerate(dataset.records) if record.path == name]
    sample = dataset[position]
    assert (sample["ratio"], sample["iso"], sample["flags"]) == (300.0, 12800.0, "uncertain-iso")
    assert SIDDataset(tmp_path, scenes=[207], amplification="metadata")[position]["ratio"] == 600.0


def test_records_and_frame_come_from_the_manifest_alone(own: Path) -> None:
    for path in own.rglob("*.*"):
        path.unlink()
    dataset = SIDDataset(own, camera="fuji", subset="test-first")
    table = dataset.frame
    assert len(table) == len(dataset) == 94
    assert dict(table.groupby("ratio").size()) == {100.0: 41, 250.0: 27, 300.0: 26}


def test_repr_says_what_is_in_it(sid: Path) -> None:
    text = repr(SIDDataset(sid, camera="fuji", split="eval"))
    for part in ("SIDDataset", "742 pairs", "FujifilmXT2", "splits test, val", "300, 100, 250", "published", "nominal"):
        assert part in text, (part, text)


# --- choices of pairs ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "count"),
    [
        ({}, 2697),
        ({"camera": "fuji"}, 2397),
        ({"split": "train"}, 1865),
        ({"split": "val"}, 234),
        ({"split": "test"}, 598),
        ({"split": "eval"}, 832),
        ({"camera": "fuji", "split": "train"}, 1655),
        ({"camera": "fuji", "split": "eval"}, 742),
        ({"subset": "eval-first"}, 129),
        ({"subset": "eval-first", "exclude_flags": ["misaligned"]}, 124),
        ({"subset": "eval-first", "split": "test"}, 93),
        ({"subset": "test-first"}, 93),
        ({"subset": "indoor-15"}, 45),
        ({"subset": "indoor-15", "ratios": [300]}, 15),
        ({"subset": "all"}, 2697),
        ({"camera": "fuji", "subset": "test-first"}, 94),
        ({"camera": "fuji", "subset": "eval-first"}, 132),
        ({"scenes": [10034]}, 12),
        ({"scenes": ["10034", 1]}, 24),
        ({"isos": [50]}, 10),
        ({"ratios": [250]}, 699),
    ],
)
def test_choices(options: dict[str, Any], count: int, sid: Path) -> None:
    assert len(SIDDataset(sid, **options)) == count


def test_eval_is_validation_and_test(sid: Path) -> None:
    splits = Counter(record.split for record in SIDDataset(sid, split="eval").records)
    assert splits == {"val": 234, "test": 598}


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"camera": "Sony"}, "camera must be one of 'sony', 'fuji'; found 'Sony'"),
        ({"split": "dev"}, "split must be one of 'train', 'val', 'test', 'eval'; found 'dev'"),
        ({"split": ""}, "split must be one of"),
        ({"subset": "indoor"}, "no subset is called 'indoor'; known are eval-first, test-first, indoor-15, all"),
        ({"camera": "fuji", "subset": "indoor-15"}, "known are test-first, eval-first, all"),
        ({"scenes": ["34"]}, "no pair has scene 34; known are 231, next to it .*20211$"),
        ({"isos": [51]}, "no pair has ISO 51; known are 50, 64, 80"),
        ({"ratios": [200]}, "no pair has ratio 200; known are 100, 250, 300"),
        ({"exclude_flags": ["bad"]}, "no pair has flag bad; known are misaligned"),
        ({"split": "train", "subset": "indoor-15"}, "no pair has all of the wanted"),
        (
            {"levels": "sid"},
            "levels must be one of 'metadata', 'published', 'sid-sony', 'sid-fuji', 'lrid'; found 'sid'",
        ),
        ({"levels": "sid-fuji"}, "of another camera; those of 'sony' are 'sid-sony'"),
        ({"amplification": "exif"}, "amplification must be one of 'metadata', 'nominal', 'measured'; found 'exif'"),
        ({"clip": "lower"}, "clip must be one of"),
    ],
)
def test_unknown_values_list_the_known(options: dict[str, Any], said: str, sid: Path) -> None:
    with pytest.raises(ArgumentError, match=said):
        SIDDataset(sid, **options)


def test_it_opens_by_its_names(sid: Path) -> None:
    for camera in CAMERAS:
        opened = open_dataset(f"sid-{camera}", sid, split="val")
        assert isinstance(opened, SIDDataset)
        assert opened.records == SIDDataset(sid, camera=camera, split="val").records  # type: ignore[arg-type]


# --- workers ------------------------------------------------------------------------------------------------------


@BOTH
# Newer Pythons warn of any fork of a process with threads; that this one is safe, and spawn, are tested with ELD.
@pytest.mark.filterwarnings("ignore:.*use of fork:DeprecationWarning")
def test_workers_give_what_indexing_gives(camera: str, sid: Path) -> None:
    dataset = some(camera, sid)
    loader = DataLoader(dataset, batch_size=2, num_workers=2, multiprocessing_context="fork", timeout=PATIENCE_S)
    batches = list(loader)
    inputs = torch.cat([batch["input"] for batch in batches])
    assert torch.equal(inputs, torch.stack([sample["input"] for sample in dataset]))
    assert [path for batch in batches for path in batch["path"]] == [record.path for record in dataset.records]
    assert torch.cat([batch["ratio"] for batch in batches]).tolist() == [float(r.ratio) for r in dataset.records]


# --- wrong files --------------------------------------------------------------------------------------------------


@BOTH
def test_swapped_files_are_not_silently_read(camera: str, own: Path) -> None:
    record = some(camera, own).records[0]
    swap(own / record.path, own / record.reference)
    with pytest.raises(DatasetError, match="exposure ratio"):
        some(camera, own)[0]


def test_a_missing_root_says_where_to_get_the_data(tmp_path: Path) -> None:
    with pytest.raises(DatasetError) as raised:
        SIDDataset(tmp_path / "SID")
    for part in (str(tmp_path / "SID"), "which holds Sony", "https://github.com/cchen156/Learning-to-See-in-the-Dark"):
        assert part in str(raised.value)


def test_the_folder_of_one_camera_is_not_taken_for_the_dataset(sid: Path) -> None:
    with pytest.raises(DatasetError, match="no folder 'Fuji' for camera FujifilmXT2; is this the right folder"):
        SIDDataset(sid / "Fuji", camera="fuji")


def test_a_manifest_of_your_own(sid: Path, tmp_path: Path) -> None:
    with pytest.raises(ManifestError, match="cannot be read"):
        SIDDataset(sid, manifest=tmp_path / "mine.csv")
    for suffix in (".csv", ".json"):
        shutil.copy(shipped_manifest("sid-sony").path.with_suffix(suffix), tmp_path / f"mine{suffix}")
    assert len(SIDDataset(sid, manifest=tmp_path / "mine.csv", subset="indoor-15")) == 45
