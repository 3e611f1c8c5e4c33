"""Files that commands write: tried before the work, and none is lost to another that fails after it."""

from __future__ import annotations

import json
import os
from pathlib import Path

from eldata.base.files import refuse_among
from eldata.noise.profile import CameraProfile
from tests.cases import in_one_test
from tests.cli.conftest import Cli, Outcome, room_for
from tests.evaluation.helpers import Tree


def test_a_file_that_is_read_is_not_written_by_whatever_name(eldata: Cli) -> None:
    CameraProfile.load("SonyA7S2").save("profile.json")
    before = Path("profile.json").read_bytes()
    Path("folder").mkdir()
    Path("hard.json").hardlink_to("profile.json")
    Path("symbolic.json").symlink_to("profile.json")
    names = ("profile.json", "./profile.json", "folder/../profile.json", "hard.json", "symbolic.json")
    for name in (*names, str(Path("profile.json").absolute())):
        outcome = eldata("calibrate", "none", "--gain", "profile.json", "-o", name)
        assert (outcome.code, outcome.out) == (2, "")
        assert outcome.err == (
            f"eldata calibrate: -o: {Path(name)} is a file that this command reads; give another name\n"
        )
    assert Path("profile.json").read_bytes() == before
    assert Path("symbolic.json").is_symlink()
    assert "none: " in eldata("calibrate", "none", "-o", "profile.json").err  # an older profile of the same name


@in_one_test("place", [".", "DemoAlpha", "DemoAlpha/scene-1"])
def test_nothing_is_written_among_a_sets_own_files(place: str, eldata: Cli, tree: Tree, predictions: Path) -> None:
    """A folder of its own in the set's may be written to, unless the set is searched through for raws."""
    held, folder = sorted(tree.files.rglob("*")), tree.files / place
    scoring = ("evaluate", predictions, *tree.arguments)
    for command in (
        (*scoring, "-o", folder),
        *((*scoring, f"--{kind}", folder / f"x.{kind}") for kind in ("csv", "json", "html")),
        ("pack", tree.files, "-o", folder / "x.h5"),
        ("synthesize", tree.files, "--camera", "SonyA7S2", "-o", folder),
        ("synthesize", tree.files, "--camera", "SonyA7S2", "-o", folder / "new"),
    ):
        outcome = eldata(*command)
        assert (outcome.code, outcome.out) == (2, "")
        assert f"cannot write into {folder}" in outcome.err
    assert sorted(tree.files.rglob("*")) == held
    refuse_among(tree.files / "results", tree.files, ["DemoAlpha/scene-1/IMG_0001.dng"])
    refuse_among(tree.files.parent, tree.files)


# --- before the work ----------------------------------------------------------------------------------------------


@in_one_test(
    "command",
    [
        "evaluate none --dataset eld --csv",
        "verify none --json",
        "calibrate none --html",
        "compare a b --json",
        "manifest none -o",
        "pack x -o",
    ],
)
def test_a_place_to_write_to_is_tried_before_the_input_is_read(command: str, eldata: Cli) -> None:
    arguments = command.split()
    Path("folder.csv").mkdir(exist_ok=True)
    problems = {
        "folder.csv": "cannot write folder.csv: is a folder, not a file",
        "no/x.csv": "cannot write no/x.csv: there is no folder no; make it first",
        os.devnull: f"cannot write {os.devnull}: is a pipe, device or socket, not a file",
        "": "cannot write .: is a folder, not a file",
    }
    for target, problem in problems.items():
        outcome = eldata(*arguments, target)
        assert (outcome.code, outcome.out) == (2, "")
        assert outcome.err == f"eldata {arguments[0]}: {arguments[-1]}: {problem}\n"
    assert [path.name for path in Path.cwd().iterdir()] == ["folder.csv"]
    assert "cannot write" not in eldata(*arguments, "x.csv").err, "it is the input that is wrong now"


# --- after it -----------------------------------------------------------------------------------------------------


def test_a_full_disk_costs_an_evaluation_neither_its_table_nor_its_other_files(
    eldata: Cli, tree: Tree, predictions: Path
) -> None:
    arguments = ("evaluate", predictions, *tree.arguments)
    whole = eldata(*arguments, "--csv", "whole.csv")
    with room_for(2 * Path("whole.csv").stat().st_size):
        outcome = eldata(*arguments, "--json", "x.json", "--csv", "x.csv", "--html", "x.html")
    assert outcome.code == 2
    assert outcome.out == whole.out
    assert outcome.err == (
        "eldata evaluate: cannot write x.json: No space left on device; cannot write x.html: No space left on device\n"
    )
    assert Path("x.csv").read_text() == Path("whole.csv").read_text()
    assert sorted(path.name for path in Path.cwd().iterdir()) == ["whole.csv", "x.csv"]


def test_data_to_standard_output_and_the_text_beside_it(eldata: Cli, tree: Tree, tmp_path: Path) -> None:
    options = ("evaluate", "--baseline", "input", "--manifest", str(tree.manifest), "--root", str(tree.root))
    text = eldata(*options, "--csv", str(tmp_path / "a.csv"), "--json", str(tmp_path / "a.json")).out
    written = (tmp_path / "a.csv").read_text(encoding="utf-8")
    assert eldata(*options, "--csv", "-") == Outcome(0, written, text)
    assert json.loads(eldata(*options, "--json", "-").out) == json.loads((tmp_path / "a.json").read_bytes())
    outcome = eldata(*options, "--json", "-", "--csv", "-")
    assert (outcome.code, outcome.out) == (2, "")
    assert "would both go to standard output" in outcome.err
    assert not Path("-").exists()
