"""eldata pack, and eldata verify of a store: text, exit codes, one line for what goes wrong."""

from __future__ import annotations

import json
from pathlib import Path

from eldata.datasets import DarkFrames
from eldata.datasets.packed import PackedClips, PackedStore
from tests.cli.conftest import Cli
from tests.cli.test_usage import assert_one_line
from tests.datasets.test_dark_frames import written
from tests.drv_tree import small_drv
from tests.evaluation.helpers import Tree


def test_pack_then_verify_then_read(eldata: Cli, tree: Tree, tmp_path: Path) -> None:
    import h5py

    store = tmp_path / "my store.h5"
    packing = ("pack", "eld-demo", "--manifest", tree.manifest, "--root", tree.root)
    outcome = eldata(*packing, "-o", store, "--compression", "lz4", "--jobs", "1")
    assert (outcome.code, outcome.err) == (0, "")
    assert outcome.out.startswith(f"32 frames packed: {store}, ")
    assert f"to check: eldata verify '{store}' --level full\n" in outcome.out
    checking = ("verify", store, "--level", "full", "--jobs", "1", "--json", tmp_path / "report.json")
    checked = eldata(*checking)
    assert (checked.code, checked.err) == (0, "")
    assert checked.out == f"eld-demo: 32 of 32 files checked (full) in {store}: all well\n"
    assert json.loads((tmp_path / "report.json").read_text())["ok"] is True
    assert len(PackedStore(store, crop=8)) == 24
    part = eldata(*packing, "-o", tmp_path / "part.h5", "--camera", "DemoBeta", "--split", "test", "--jobs", "1")
    assert part.out.startswith("16 frames packed: ")

    with h5py.File(store, "r+") as file:
        file["frames/000007"][3, 3] ^= 1
    damaged = eldata(*checking)
    assert (damaged.code, damaged.err) == (1, "")
    assert "copy or pack the store again" in damaged.out


def test_a_folder_of_clean_raws(eldata: Cli, tree: Tree, tmp_path: Path) -> None:
    folder = tree.files / "DemoBeta" / "scene-1"
    assert eldata("pack", folder, "-o", tmp_path / "clean.h5").out.startswith("4 frames packed: ")
    every = eldata("pack", folder, "-o", tmp_path / "every.h5", "--reference", "*")
    assert every.out.startswith("16 frames packed: ")
    assert_one_line(eldata("pack", "eld", "-o", tmp_path / "x.h5", "--reference", "*"), "is for a folder of raws")
    assert_one_line(eldata("pack", folder, "-o", tmp_path / "x.h5", "--split", "test"), "--split", "is a folder")
    assert_one_line(eldata("pack", tmp_path, "-o", tmp_path / "x.h5"), "holds no camera raw file")


# --- clips ----------------------------------------------------------------------------------------------------------


def test_clips_are_packed_verified_and_read(eldata: Cli, tmp_path: Path) -> None:
    drv = small_drv(tmp_path, ("0007", "M0003"), 6)
    store = tmp_path / "drv.h5"
    packing = ("pack", "drv", "--manifest", drv.csv, "--root", drv.root, "--jobs", "1")
    assert eldata(*packing, "-o", store).out.startswith(f"13 frames packed: {store}, ")
    checked = eldata("verify", store, "--level", "full", "--jobs", "1")
    assert (checked.code, checked.out) == (0, f"drv: 13 of 13 files checked (full) in {store}: all well\n")
    assert len(PackedClips(store, crop=8)) == len(PackedClips(store, dynamic=True, crop=8)) == 1
    assert eldata(*packing, "-o", tmp_path / "m.h5", "--clip", "M0003").out.startswith("6 frames packed: ")
    for option, words in (
        ("--clip", "no clip has scene x; known are 0007, M0003"),
        ("--split", "no clip has split x"),
        ("--subset", "no subset is called 'x'"),
    ):
        assert_one_line(eldata(*packing, "-o", tmp_path / "x.h5", option, "x"), words)


def test_calibration_frames_of_a_camera(eldata: Cli, tmp_path: Path) -> None:
    bias = written(tmp_path / "data" / "calibration", isos={400: 2}, side=24)
    store = tmp_path / "bias.h5"
    outcome = eldata("pack", "calibration", "--root", str(tmp_path / "data"), "--camera", "Nocturne", "-o", str(store))
    assert (outcome.code, outcome.err) == (0, "")
    assert DarkFrames(store).isos == DarkFrames(bias).isos == (400.0,)
    lacking = eldata("pack", "calibration", "--root", str(tmp_path), "-o", str(tmp_path / "more.h5"))
    assert_one_line(lacking, "there is no such folder; calibration frames lie in")
