"""Sets by name, in every command: those that come with eldata, and those that other packages register."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from eldata import ELDDataset, PackedStore, evaluate
from eldata.evaluation.results import load_result
from eldata.manifest.catalogue import load_manifest, save_manifest, shipped_manifest, shipped_names
from tests.cli.conftest import Cli
from tests.datasets.test_registry import install
from tests.evaluation.helpers import Tree
from tests.trees import build_published_tree


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder for packages."""
    monkeypatch.syspath_prepend(tmp_path / "site")
    return tmp_path / "site"


@pytest.fixture
def dusk(own: Tree, site: Path) -> Path:
    """The demo's tree as the set of a package that cannot even be imported; its data root."""
    install(site, "dusk", "dusk = dusk_sets.of_ours.dusk:Dusk")
    package = site / "dusk_sets" / "of_ours"
    package.mkdir(parents=True)
    for folder in (package.parent, package):
        (folder / "__init__.py").write_text("raise RuntimeError('imported')")
    manifest = load_manifest(own.manifest)
    save_manifest(package / "dusk.csv", replace(manifest.card, name="dusk"), manifest.records)
    return own.root


def test_a_registered_set_works_in_every_command(dusk: Path, eldata: Cli, tmp_path: Path) -> None:
    root = ("--root", dusk)
    assert "dusk: Simulated ELD-like set" in eldata("info", "dusk", *root).out
    next_line = eldata("info", "dusk", *root).out.splitlines()[-1]
    assert next_line.startswith("    eldata verify dusk --root ")
    (row,) = [line for line in eldata("info", *root).out.splitlines() if line.startswith("dusk ")]
    assert "  present  " in row
    for arguments in (["verify", "dusk"], ["verify"], ["verify", "dusk", "dusk"]):
        outcome = eldata(*arguments, *root)
        assert (outcome.code, outcome.err) == (0, "")
        assert "dusk: 32 of 32 files checked (quick)" in outcome.out
    score = eldata("evaluate", "--baseline", "input", "--dataset", "dusk", "--camera", "DemoBeta", *root, "--jobs", "1")
    assert "dusk, protocol eld: 6 of 6 pairs" in score.out
    store = tmp_path / "dusk.h5"
    packed = eldata("pack", "dusk", "-o", store, "--camera", "DemoBeta", *root, "--jobs", "1")
    assert packed.out.startswith("16 frames packed: ")
    assert "dusk: all 32 files are in" in eldata("download", "dusk", *root).out


def test_what_a_broken_package_registers_leaves_the_rest_alone(eldata: Cli, site: Path) -> None:
    install(site, "gone", "gone = gone_package:Gone")
    install(site, "bare", "bare = bare_module:Bare")
    (site / "bare_module.py").write_text("")
    outcome = eldata("info")
    assert outcome.code == 1
    assert "\neld " in outcome.out
    assert "'gone' is registered as gone_package:Gone, but there is no module gone_package" in outcome.err
    assert f"'bare' is registered as bare_module:Bare, whose folder {site} has no bare.csv" in outcome.err
    for arguments in (["verify", "gone"], ["info", "gone"], ["evaluate", "x", "--dataset", "gone"]):
        assert "there is no module gone_package" in eldata(*arguments).err


# --- lock by name -----------------------------------------------------------------------------------------------------


def test_lock_by_name_writes_beside_the_data_and_verify_finds_it(dusk: Path, eldata: Cli, site: Path) -> None:
    root = ("--root", dusk, "--jobs", "1")
    shipped = site / "dusk_sets" / "of_ours" / "dusk.csv"
    before = shipped.read_bytes()
    locked = eldata("lock", "dusk", *root)
    assert (locked.code, locked.err) == (0, "")
    assert f"{dusk / 'manifests' / 'dusk.csv'}: size and hash of 32 files recorded" in locked.out
    assert shipped.read_bytes() == before
    full = eldata("verify", "--level", "full", *root)  # all that are there
    assert full.code == 0
    assert "have no recorded hash" not in full.out

    # Another version of the manifest: its rows may be others.
    known = load_manifest(shipped)
    save_manifest(shipped, replace(known.card, version="9.9"), known.records)
    outcome = eldata("verify", "dusk", *root)
    assert outcome.code == 2
    assert "is of dusk 1.0, and eldata knows dusk 9.9; move it away, and lock again" in outcome.err


def test_a_set_of_ones_own_by_its_name_or_manifest(
    own: Tree, predictions: Path, eldata: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In every command that takes a dataset; the name, if its manifest is at the data root, beside it, or here."""
    monkeypatch.chdir(own.folder)
    wanted = evaluate(predictions, manifest=own.manifest, root=own.root)
    for name in ("eld-demo", "manifests/eld-demo.csv"):
        for words in (("info", name), ("verify", name), ("pack", name, "-o", tmp_path / f"{len(name)}.h5")):
            assert eldata(*words).code == 0, words
        outcome = eldata("evaluate", predictions, "--dataset", name, "--json", tmp_path / "result.json")
        assert (outcome.code, load_result(tmp_path / "result.json").scores) == (0, wanted.scores)
        assert len(ELDDataset(manifest=name, cameras="DemoAlpha")) == 6
    assert len(PackedStore(tmp_path / "8.h5")) == 24


def test_verify_without_a_name_names_what_is_not_there(eldata: Cli, tmp_path: Path) -> None:
    nothing = eldata("verify")
    assert nothing.code == 1
    assert nothing.out.startswith("nothing was verified; --root names the folder that holds the datasets\nnot there: ")
    manifest = shipped_manifest("eld")
    build_published_tree(manifest, tmp_path / "data" / manifest.card.folder)
    outcome = eldata("verify", "--root", tmp_path / "data", "--json", tmp_path / "x.json")
    assert outcome.code == 0
    lines = outcome.out.splitlines()
    assert lines[0].startswith(f"eld: {len(manifest.records)} of {len(manifest.records)} files checked (quick) in ")
    assert lines[1] == (
        f"not there: {', '.join(name for name in shipped_names() if name != 'eld')}; "
        "eldata info NAME says where to get one"
    )
    assert json.loads((tmp_path / "x.json").read_text())["ok"] is True
