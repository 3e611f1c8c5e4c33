from __future__ import annotations

import argparse
import json
import re
import shlex
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

import eldata as package
from capture.cli.main import parser as capture_parser
from eldata.cli.main import parser as eldata_parser
from tests.cases import in_one_test
from tests.cli.conftest import Cli, Outcome
from tests.shared import there

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from tests.evaluation.helpers import Tree


def assert_one_line(outcome: Outcome, *words: str) -> None:
    assert outcome.code == 2
    assert outcome.out == ""
    assert outcome.err.endswith("\n")
    assert outcome.err.count("\n") == 1
    assert outcome.err.startswith("eldata")
    assert "Traceback" not in outcome.err
    assert "--debug shows where" not in outcome.err  # which is for errors that nobody thought of
    for word in words:
        assert word in outcome.err


# --- help and version -----------------------------------------------------------------------------------------


def test_version(eldata: Cli) -> None:
    assert eldata("--version") == Outcome(0, f"eldata {package.__version__}\n", "")


def test_no_command_lists_the_commands(eldata: Cli) -> None:
    for arguments, names in (((), ("demo", "evaluate", "verify")), (("profile",), ("show", "import", "list"))):
        outcome = eldata(*arguments)
        assert (outcome.code, outcome.out) == (2, "")
        assert all(f"\n    {name} " in outcome.err for name in names)
    assert_one_line(eldata("--jobs", "2", "verify"), "there is no option --jobs, and a command's options come after")
    assert_one_line(eldata("demo", "--dask", "a"), "eldata demo: there is no option --dask")


def test_help_is_a_word_as_well_as_an_option(eldata: Cli) -> None:
    assert eldata("help") == eldata("--help")
    assert eldata("help", "profile", "show") == eldata("profile", "show", "--help")
    assert_one_line(eldata("help", "verfy"), "did you mean verify?")


# --- wrong usage ----------------------------------------------------------------------------------------------


@in_one_test(
    "arguments, meant",
    [
        (["frobnicate"], "there is no command 'frobnicate'; commands are"),
        (["verfy"], "did you mean verify? See eldata --help"),
        (["profile", "shwo"], "did you mean show? See eldata profile --help"),
        (["evaluate", "x", "--datset", "eld"], "there is no option --datset; did you mean --dataset? See"),
        (
            ["--level", "full", "verify", "eld"],
            "no option --level, and a command's options come after its name",
        ),
        (["verify", "eld", "--level", "ful"], "did you mean full?"),
        (["verify", "edl"], "no dataset is called 'edl'; known are aim25, crvd, drv, eld"),
        (["info", "sid"], "it is sid-fuji and sid-sony: name one"),
        (["pack", "data/SID/Sny", "-o", "x.h5"], "data/SID/Sny: there is no such folder; give a folder of camera raws"),
        (["evaluate", "x", "--dataset", "eld", "--protocol", "eld-uncorected"], "did you mean eld-uncorrected?"),
        (["profile", "show", "sonya7s2"], "did you mean SonyA7S2?"),
        (["verify", "eld", "--camera", "SonyA7SII"], "did you mean SonyA7S2?"),
    ],
)
def test_what_was_probably_meant(arguments: list[str], meant: str, eldata: Cli) -> None:
    assert_one_line(eldata(*arguments), meant)


def leaves(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    """The parsers of a program's commands, without those that only hold others."""
    groups = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    for group in groups:
        for command in group.choices.values():
            yield from leaves(command)
    if not groups:
        yield parser


@pytest.mark.parametrize("program", [eldata_parser, capture_parser])
def test_every_help_explains_each_option_and_ends_with_an_example_that_parses(
    program: Callable[[], argparse.ArgumentParser],
) -> None:
    whole = program()
    for parser in (whole, *leaves(whole)):
        options = [action for action in parser._actions if not isinstance(action, argparse._SubParsersAction)]
        assert all(option.help for option in options), parser.prog
        outputs = parser.get_default("outputs") or {}
        for option in options:
            if option.option_strings and option.metavar == "FILE" and re.search(r"\bwrite\b", str(option.help)):
                assert option.dest in outputs, f"{parser.prog} does not check {option.dest} before its work"
        examples = [line.strip() for line in parser.format_help().splitlines() if line.startswith("    eldata ")]
        examples += [line.strip() for line in parser.format_help().splitlines() if line.startswith("    capture ")]
        assert examples, parser.prog
        for example in examples:
            assert example.startswith(parser.prog)
            arguments = program().parse_args(shlex.split(example.partition(" > ")[0])[1:])
            assert arguments.command.startswith(parser.prog)


@in_one_test(
    "arguments, words",
    [
        (["lock"], ["MANIFEST", "eldata lock --help"]),
        (["evaluate", "x"], ["--dataset", "--manifest"]),
        (["evaluate", "x", "--dataset", "eld", "--manifest", "y"], ["--manifest", "--dataset"]),
        (["verify", "x", "--level", "deep"], ["--level", "deep", "quick", "metadata", "full"]),
        (["lock", "x", "--jobs", "0"], ["jobs", "0"]),
        (["demo", "x", "--scenes", "0"], ["scenes", "0"]),
    ],
)
def test_wrong_usage_is_one_line(arguments: list[str], words: list[str], eldata: Cli) -> None:
    assert_one_line(eldata(*arguments), *words)
    assert not any(Path.cwd().iterdir())


# --- unusable input -------------------------------------------------------------------------------------------


def test_unusable_input_is_one_line(eldata: Cli, own: Tree, predictions: Path, tmp_path: Path) -> None:
    commands: list[list[str | Path]] = [["verify"], ["lock"], ["evaluate", predictions, "--manifest"]]
    set_at, nowhere = own.manifest, tmp_path / "no" / "such.csv"
    root: list[str | Path] = ["--root", own.root]
    for command in commands:
        assert_one_line(eldata(*command, nowhere), str(nowhere), "cannot be read")
        assert_one_line(eldata(*command, set_at, *root, "--camera", "Leica"), "Leica", "DemoAlpha")
    for name in ("verify", "lock"):
        assert_one_line(eldata(name, tmp_path), str(tmp_path))
    assert_one_line(eldata("evaluate", tmp_path / "none", "--manifest", set_at, *root), "none", "no such folder")
    assert_one_line(eldata(*commands[2], set_at, "--root", tmp_path / "none"), str(tmp_path / "none"), "--root")
    card = set_at.with_suffix(".json")
    whole = card.read_text()
    card.write_text('{"nonsense": 1}')
    assert_one_line(eldata("verify", set_at, *root), str(card), "nonsense")
    card.unlink()
    assert_one_line(eldata("verify", set_at, *root), str(card), "card")
    card.write_text(whole)
    set_at.write_bytes(content := b"../" + set_at.read_bytes())
    for command in commands:
        assert_one_line(eldata(*command, set_at, *root), str(set_at), "line 1", "path,role")
    assert set_at.read_bytes() == content


def test_dataset_that_is_not_what_its_manifest_says(eldata: Cli, own: Tree, predictions: Path) -> None:
    (own.files / "DemoAlpha/scene-1/IMG_0006.dng").unlink()
    outcome = eldata("evaluate", predictions, "--manifest", own.manifest, "--root", own.root, "--jobs", "1")
    assert_one_line(outcome, "DemoAlpha/scene-1/IMG_0006.dng", "expected a file, found nothing")


# --- --json and --csv -----------------------------------------------------------------------------------------


def test_nothing_scored_is_not_all_well_and_no_older_scores_outlive_it(
    eldata: Cli, tree: Tree, predictions: Path, tmp_path: Path
) -> None:
    """The problems are written. A script must not take the wrong folder for success, nor read yesterday's scores."""
    (tmp_path / "preds").mkdir()
    targets = ("--csv", tmp_path / "x.csv", "--json", tmp_path / "x.json")
    arguments = ("--manifest", tree.manifest, "--root", tree.root, "--jobs", "1", *targets)
    assert eldata("evaluate", predictions, *arguments).code == 0
    assert (tmp_path / "x.csv").read_text().count("\n") == 13
    assert eldata("evaluate", tmp_path / "preds", *arguments).code == 1
    data = json.loads((tmp_path / "x.json").read_text())
    assert (len(data["problems"]), len(data["coverage"]["missing"])) == (1, 12)
    assert not (tmp_path / "x.csv").exists() or (tmp_path / "x.csv").read_text().count("\n") == 1
    assert eldata("evaluate", tmp_path / "preds", *arguments, "--allow-missing").code != 0


# --- --root, --camera, --protocol ------------------------------------------------------------------------------


def test_root_wins_over_the_variable_which_wins_over_data(
    eldata: Cli, tree: Tree, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def folder_checked(*arguments: str | Path) -> str:
        outcome = eldata("verify", tree.manifest, "--jobs", "1", *arguments)
        found = there(re.search(r"\((?:no folder )?(\S+?)\)|in (\S+):", outcome.out.replace("(quick) ", "")))
        return found[1] or found[2]

    assert folder_checked() == str(Path("data") / "ELD-demo")
    monkeypatch.setenv("ELDATA_ROOT", str(tmp_path / "variable"))
    assert folder_checked() == str(tmp_path / "variable" / "ELD-demo")
    assert folder_checked("--root", tree.root) == str(tree.files)
    monkeypatch.setenv("ELDATA_ROOT", str(tree.root))
    assert folder_checked() == str(tree.files)
    monkeypatch.setenv("ELDATA_ROOT", "")
    assert folder_checked() == str(Path("data") / "ELD-demo")
    (Path.cwd() / "data").symlink_to(tree.root)
    assert eldata("verify", tree.manifest, "--jobs", "1").code == 0


# --- --debug --------------------------------------------------------------------------------------------------


def test_an_unexpected_error_is_one_line_and_debug_shows_the_traceback(
    eldata: Cli, monkeypatch: pytest.MonkeyPatch, tree: Tree
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise RuntimeError("first line\nsecond line")

    monkeypatch.setattr("eldata.cli.verify.verify", broken)
    plain = eldata("verify", tree.manifest)
    assert plain.code == 2
    assert plain.err.count("\n") == 1
    assert "RuntimeError" in plain.err
    assert "--debug" in plain.err
    debug = eldata("verify", tree.manifest, "--debug")
    assert "Traceback (most recent call last)" in debug.err
    assert debug.err.endswith(plain.err)
