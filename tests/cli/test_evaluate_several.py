"""`eldata evaluate A B C`: one pass, a folder of results, their comparison, exit codes, refusals in a line."""

from __future__ import annotations

import json
import shlex
import shutil
from typing import TYPE_CHECKING

import pytest

from tests.cli.test_usage import assert_one_line

if TYPE_CHECKING:
    from pathlib import Path

    from tests.cli.conftest import Cli
    from tests.evaluation.helpers import Tree


@pytest.fixture
def several(predictions: Path, tmp_path: Path) -> list[Path]:
    """The same predictions twice, and once without those of one camera."""
    folders = [tmp_path / name for name in ("first", "second", "partly")]
    for folder in folders:
        shutil.copytree(predictions, folder)
    shutil.rmtree(folders[2] / "DemoBeta")
    return folders


def test_one_pass_writes_what_single_runs_write(eldata: Cli, tree: Tree, several: list[Path], tmp_path: Path) -> None:
    """The one that lacks files is scored as it is alone: not; the exit code says so, and the others are compared."""
    outcome = eldata("evaluate", *several, *tree.arguments, "-o", tmp_path / "results")
    assert outcome.code == 1, outcome.err
    names = [*(f"{folder.name}.{kind}" for folder in several for kind in ("csv", "json")), "comparison.json"]
    assert sorted(path.name for path in (tmp_path / "results").iterdir()) == ["comparison.html", *sorted(names)]
    for folder in several:
        alone = tmp_path / "alone"
        code = eldata("evaluate", folder, *tree.arguments, "--json", f"{alone}.json", "--csv", f"{alone}.csv").code
        assert code == (1 if folder.name == "partly" else 0)
        for kind in ("json", "csv"):
            together = tmp_path / "results" / f"{folder.name}.{kind}"
            assert together.read_bytes() == alone.with_suffix(f".{kind}").read_bytes()
    compared = json.loads((tmp_path / "results" / "comparison.json").read_text())
    assert [method["name"] for method in compared["methods"]] == ["first", "second"]
    assert len(compared["common"]) == 12
    for name in ("first:", "second:", "partly:", "nothing was scored: ", "second minus first"):
        assert name in outcome.out


def test_what_is_printed_draws_the_pictures(eldata: Cli, tree: Tree, several: list[Path], tmp_path: Path) -> None:
    """And what compare prints of the results is what was printed with them."""
    out = tmp_path / "my results"
    named = ["--name", "ours", "--name", "theirs"]
    outcome = eldata("evaluate", *several[:2], *tree.arguments, *named, "-o", out)
    assert outcome.code == 0, outcome.err
    assert eldata("compare", out / "ours.json", out / "theirs.json").out.strip() in outcome.out
    asked, command = outcome.out.splitlines()[-1].split(": ", 1)
    assert asked == "to see every image beside each other"
    assert eldata(*shlex.split(command)[1:]).code == 0
    assert len(list((out / "pictures-pictures").iterdir())) >= 12
    assert "to see" not in eldata("evaluate", *several[:2], *tree.arguments, "--format", "latex", "-o", out).out
    next(several[1].rglob("*.npy")).write_bytes(b"")  # which stays a problem where missing ones are allowed
    assert eldata("evaluate", *several[:2], *tree.arguments, "--allow-missing").code == 1


def test_refusals(eldata: Cli, tree: Tree, several: list[Path], tmp_path: Path) -> None:
    (tmp_path / "more").mkdir()
    namesake = shutil.copytree(several[0], tmp_path / "more" / "first")
    (tmp_path / "file").touch()
    for arguments, words in (
        ([several[0], namesake], "would both be called 'first'"),
        ([several[0], several[1], "--json", tmp_path / "a.json"], "--json writes the result of one method"),
        ([several[0], several[1], "--name", "one"], "found 1 for 2 folders"),
        ([several[0], tmp_path / "nowhere", "-o", tmp_path / "results"], "nowhere: No such"),
        ([several[0], several[1], "-o", tmp_path / "file"], "File exists"),
        ([several[0], several[1], "-o", tmp_path / "no" / "folder"], "No such file"),
        (["--baseline", "input", "-o", tmp_path / "results"], "-o and --name are for folders of predictions"),
    ):
        assert_one_line(eldata("evaluate", *arguments, *tree.arguments), words)
        assert not (tmp_path / "results").exists()
