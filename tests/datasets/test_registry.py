"""What every dataset of the registry must do. A new dataset is tested by being registered."""

from __future__ import annotations

import os
import pickle
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import fields
from fnmatch import fnmatch
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import torch

from eldata import evaluate
from eldata.base.files import split_member
from eldata.datasets import PackedStore, PairDataset, dataset_class, dataset_names, open_dataset, published
from eldata.datasets.packed import PackedClips
from eldata.errors import ArgumentError, DatasetError, UnusableRawError
from eldata.manifest.catalogue import ENTRY_POINTS, Manifest, shipped_manifest, shipped_names
from eldata.manifest.pairs import Choice, unpaired
from eldata.manifest.patterns import expand
from eldata.manifest.verify import verify
from eldata.manifest.verify_report import Level
from eldata.sources.store import build_store, source_of_dataset
from tests.cases import in_one_test
from tests.crvd_tree import build_crvd_tree
from tests.datasets.comparing import same
from tests.drv_tree import build_drv_tree
from tests.lrd_tree import build_lrd_tree
from tests.lrid_tree import build_lrid_tree
from tests.pattern_trees import BUILDERS
from tests.sid_tree import build_sid_tree
from tests.sidd_tree import build_blocks_tree, build_sidd_tree
from tests.trees import build_published_tree
from tests.waiting import PATIENCE_S


def build_sized_tree(manifest: Manifest, folder: Path) -> None:
    """Files of the published sizes, of which all but the head is a hole; some pixels of noisy ones are others."""
    build_published_tree(manifest, folder)
    for record in manifest.records:
        path, content = folder / record.path, bytearray((folder / record.path).read_bytes())
        path.unlink()  # a link to another's
        if record.role == "noisy":
            content[2000:4000] = content[3000:5000]
        path.write_bytes(content)
        os.truncate(path, record.size_bytes or 0)


# How each dataset's files are faked: every published name, small content.
TREES: dict[str, Callable[[Manifest, Path], None]] = {
    "eld": build_published_tree,
    "sid-sony": build_sid_tree,
    "sid-fuji": build_sid_tree,
    "drv": partial(build_drv_tree, frames=9),
    "crvd": build_crvd_tree,
    **BUILDERS,
    "rawnind": build_sized_tree,
    "lrd": build_lrd_tree,
    "lrid": build_lrid_tree,
    "sidd": build_sidd_tree,
    "sidd-blocks": build_blocks_tree,
}

# The frames of these hold fractions of a DN, and a store takes whole DN alone.
FRACTIONS = ("lrid", "sidd", "sidd-blocks")

NAMES = tuple(published._CLASSES)  # not those of packages that happen to be installed beside this one
EVERY = pytest.mark.parametrize("name", NAMES)


# --- the registry -----------------------------------------------------------------------------------------------------


def install(folder: Path, package: str, line: str) -> None:
    """Make an installed package as pip leaves it: metadata with one entry point."""
    info = folder / f"{package}-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[{ENTRY_POINTS}]\n{line}\n")


def test_another_package_registers_a_dataset(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert set(NAMES) == set(shipped_names()) == set(TREES)
    install(tmp_path, "dusk", "dusk = eldata_test_dusk:Dusk")
    install(tmp_path, "lost", "lost = eldata_test_dusk:Lost")
    install(tmp_path, "mine", "eld = mine:Dataset")
    (tmp_path / "eldata_test_dusk.py").write_text("class Dusk:\n  def __init__(self, root):\n    self.root = root\n")
    monkeypatch.syspath_prepend(tmp_path)
    assert {*NAMES, "dusk", "lost"} <= set(dataset_names())
    assert open_dataset("dusk", "data/DUSK").root == "data/DUSK"
    for error, name, words in (
        (ArgumentError, "elf", "no dataset is called 'elf'; known are eld, .*dusk"),
        (DatasetError, "lost", "'lost' is registered as eldata_test_dusk:Lost, which cannot be imported"),
        (ArgumentError, "eld", "2 datasets are called 'eld': eldata.datasets.published.*, mine:Data"),  # whose?
    ):
        with pytest.raises(error, match=words):
            dataset_class(name)
    assert dataset_class("drv")


# --- the card ---------------------------------------------------------------------------------------------------------


@EVERY
def test_the_card_is_filled_in(name: str) -> None:
    """Name, version, citation, licence, homepage, counts and all else."""
    manifest = shipped_manifest(name)
    assert manifest.name == manifest.path.stem == name
    for item in fields(manifest.card):
        if item.name in ("subsets", "mosaics", "contents", "levels", "scored", "unknown"):
            continue  # not every set has named ones; the rest is for what a manifest does not say
        assert getattr(manifest.card, item.name), f"{item.name} is empty"
    assert manifest.card.homepage.startswith("https://")
    for download in manifest.card.downloads:
        assert download.address.startswith("https://")
    for camera in manifest.card.cameras.values():
        assert all(camera.models)
        assert camera.models or any("camera model" in unknown for unknown in manifest.card.unknown)
    assert {record.camera for record in manifest.records} == set(manifest.card.cameras), "no camera without files"


@EVERY
def test_the_counts_are_the_manifests(name: str) -> None:
    manifest = shipped_manifest(name)
    assert manifest.card.counts == Counter(record.role for record in manifest.records)
    for subset in manifest.card.subsets:
        if subset.pairs is None:
            continue  # of a copy
        alone = unpaired(manifest.records, subset)
        if alone and any(record.ratio for record in alone):  # a benchmark's noisy frames
            assert len(alone) == subset.pairs
        elif any(record.ratio for record in manifest.records):
            assert len(Choice(subset=subset.name).pairs(manifest.records, manifest.card.subsets)) == subset.pairs
        else:  # a row stands for a clip: it has no ratio, which a pair has
            noisy = [record for record in manifest.records if record.role == "noisy" and record.split in subset.splits]
            assert len({record.scene for record in noisy}) == subset.pairs


# --- a copy -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [name for name in NAMES if name != "raw-denoise"])  # which asks for levels
def test_a_copy_in_its_real_layout(name: str, tmp_path: Path) -> None:
    """It loads, is sound, is scored, is packed, and is found one level off; what a half of it lacks is named.

    Of a set whose names are patterns the small copy has some scenes. tests/cli/test_info.py has citation and licence.
    """
    manifest = shipped_manifest(name)
    folder = tmp_path / manifest.card.folder
    TREES[name](manifest, folder)
    rows = expand(manifest.records, folder)
    there = [row for row in rows if (folder / split_member(row.path)[0]).is_file()]
    scenes = {str(row.scene) for row in there if row.role == "reference"}
    options = {} if scenes == {row.scene for row in rows if row.role == "reference"} else {"scenes": [*scenes]}
    if options:
        with pytest.raises(DatasetError, match=rf"no frames of \d+ scenes, .*{re.escape(repr(sorted(scenes)))}"):
            open_dataset(name, folder)
    dataset = open_dataset(name, folder, **options)
    (check_pairs if isinstance(dataset, PairDataset) else check_clips)(dataset, manifest, scenes)

    def find_problems(level: Level) -> set[str]:
        problems = verify([manifest], tmp_path, level=level).problems
        return {problem.path for problem in problems if problem.found != "no such folder"}

    assert find_problems("metadata") == set()
    result = evaluate(None, name, root=tmp_path, baseline="input", allow_missing=bool(options))
    assert 0 < result.whole.scored == len(result.scores)
    assert 0 < result.psnr_db < 45

    store = tmp_path / "store.h5"
    if name in FRACTIONS:
        with pytest.raises(UnusableRawError, match="its pixels are no whole DN"):
            build_store(source_of_dataset(name, root=tmp_path), store)
    else:
        scene = min(scenes)
        build_store(source_of_dataset(name, root=tmp_path, scenes=[scene]), store)
        if name == "drv":
            same(PackedClips(store, crop=None, augment=False)[0], open_dataset(name, folder, scenes=[scene])[0])
        else:
            packed = PackedStore(store, crop=None, augment=False, levels="metadata")
            same(packed[0], PairDataset(folder, name, scenes=[scene], levels="metadata")[0])

    nested = tmp_path / "unpacked" / folder.name
    nested.parent.mkdir()
    folder.rename(nested)
    assert find_problems("quick") == set()
    assert len(open_dataset(name, nested.parent, **options)) == len(dataset)
    references = sorted({split_member(row.path)[0] for row in there if row.role == "reference"})
    renamed, *lost = references[len(references) // 2 :]
    for path in lost:
        (nested / path).unlink()
    (nested / renamed).rename((nested / renamed).with_stem("renamed"))
    with pytest.raises(DatasetError, match=r"lacks [0-9]+ of the|expected one file as its reference"):
        open_dataset(name, nested.parent, **options)
    problems = find_problems("quick")
    for path in (renamed, *lost):
        assert any(fnmatch(path, problem.partition("#")[0]) for problem in problems), path


def check_pairs(dataset: PairDataset, manifest: Manifest, _: set[str]) -> None:
    """The real names with their extensions in their real case; every camera's files open, in workers' copies too."""
    copy = pickle.loads(pickle.dumps(dataset))
    assert dataset.name == manifest.name
    first_of = {record.camera: index for index, record in reversed([*enumerate(dataset.records)])}
    assert set(first_of) == set(manifest.card.cameras)
    for index in first_of.values():
        record, sample = dataset.records[index], dataset[index]
        assert sample["path"] == record.path
        assert sample["input"].shape == sample["target"].shape
        assert sample["input"].dtype == sample["target"].dtype == torch.float32
        assert sample["ratio"] == pytest.approx(float(record.ratio), rel=0.1)
        same(copy[index], sample)


def check_clips(dataset: Any, _: Manifest, scenes: set[str]) -> None:
    # Of a sequence, the scene stands within the clip's name.
    assert {re.sub(r"^[^/]+/([^/]+)(/.*)?$", r"\1", record.scene) for record in dataset.records} == scenes
    sample = dataset[0]
    assert sample["path"] == dataset.records[0].path
    each = slice(0 if dataset.records[0].references else 1, None)  # a reference for each frame, or one for all
    assert sample["input"].shape[each] == sample["target"].shape
    assert sample["input"].dtype == sample["target"].dtype == torch.float32
    same(pickle.loads(pickle.dumps(dataset))[0], sample)


# --- refusals ---------------------------------------------------------------------------------------------------------


@EVERY
def test_records_need_no_files_and_a_missing_folder_says_where_to_get_them(name: str, tmp_path: Path) -> None:
    """As the set is made; but some sets' records do, for the names of their frames are not published."""
    if name not in ("drv", "recrvd", "llrvd"):
        dataset = open_dataset(name, tmp_path / "nowhere", check="never")
        frame = dataset.frame
        assert len(frame) == len(dataset) == len(dataset.records) > 0
        for column in ("camera", "scene", "split", "reference"):
            assert list(frame[column]) == [getattr(record, column) for record in dataset.records]
        assert repr(dataset)
    with pytest.raises(DatasetError) as raised:
        open_dataset(name, tmp_path / "nowhere")
    for words in ("nowhere", shipped_manifest(name).card.homepage, f"eldata info {name}", f"eldata download {name}"):
        assert words in str(raised.value)


@in_one_test(
    "place, name", [("eldata", "ELDDataset"), ("eldata.datasets", "PackedStore"), ("eldata.baselines", "Training")]
)
def test_a_name_that_needs_torch_says_how_to_install_it(place: str, name: str) -> None:
    code = f"import sys; sys.modules['torch'] = None; from {place} import {name}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=PATIENCE_S)
    told = f"ModuleNotFoundError: {name} needs torch, which is not installed: pip install torch"
    assert done.stderr.splitlines()[-1] == told


def test_a_program_that_needs_torch_says_how_to_install_it(tmp_path: Path) -> None:
    (tmp_path / "sitecustomize.py").write_text("import sys; sys.modules['torch'] = None")
    places = os.environ | {"PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}
    command = [sys.executable, "-m", "eldata.examples.train_denoiser", "--help"]
    done = subprocess.run(command, capture_output=True, text=True, env=places, timeout=PATIENCE_S)
    told = "eldata.examples needs torch, which is not installed: pip install torch\n"
    assert (done.returncode, done.stdout, done.stderr) == (2, "", told)
