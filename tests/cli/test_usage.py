from __future__ import annotations

import argparse
import json
import re
import shlex
import signal
from collections.abc import Callable
from pathlib import Path

import pytest

import eldata as package
from capture.cli.main import parser as capture_parser
from eldata.cli.main import main
from eldata.cli.main import parser as eldata_parser
from tests.cases import in_one_test
from tests.cli.conftest import Cli, Outcome
from tests.evaluation.helpers import Tree
from tests.raw.damaging import PAGE, Whole
from tests.without_posix import commands


def assert_one_line(outcome: Outcome, *words: str) -> None:
    assert outcome.code == 2
    assert outcome.out == ""
    assert outcome.err.endswith("\n")
    assert outcome.err.count("\n") == 1
    assert outcome.err.startswith("eldata")
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


def test_help_is_a_word_as_well_as_an_option(eldata: Cli) -> None:
    assert eldata("help") == eldata("--help")
    assert eldata("help", "profile", "show") == eldata("profile", "show", "--help")
    assert_one_line(eldata("help", "verfy"), "did you mean verify?")


def test_the_common_options_of_evaluate_fill_thirty_lines(eldata: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    common, rare = eldata("evaluate", "--help").out.split("\nless common options:\n")
    assert common.count("\n") <= 30
    assert all(f"  {name} " in common for name in ("PREDS", "--dataset", "--protocol", "--root", "--html", "--json"))
    assert all(f"  {name} " in rare for name in ("--subset", "--allow-suspect", "--task", "--compare"))


def test_ctrl_c_before_a_command_begins_is_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("eldata.base.console.import_module", lambda _: signal.raise_signal(signal.SIGINT))
    assert main(["demo"]) == 130
    assert capsys.readouterr().err == "eldata: interrupted; nothing was begun\n"


# --- wrong usage ----------------------------------------------------------------------------------------------


@in_one_test(
    "arguments, words",
    [
        ("frobnicate", "there is no command 'frobnicate'; commands are"),
        ("verfy", "did you mean verify? See eldata --help"),
        ("train", "training: python -m eldata.examples.train_denoiser"),
        ("info eld sid", "eldata info: unrecognized arguments: sid; see eldata info --help"),
        ("evaluate x --datset eld", "there is no option --datset; did you mean --dataset? See"),
        ("--level full verify eld", "no option --level, and a command's options come after its name"),
        ("--jobs 2 verify", "there is no option --jobs, and a command's options come after"),
        ("demo --dask a", "eldata demo: there is no option --dask"),
        ("verify eld --level ful", "did you mean full?"),
        ("info sid", "it is sid-fuji and sid-sony: name one"),
        ("pack data/SID/Sny -o x.h5", "data/SID/Sny: there is no such folder; give a folder of camera raws"),
        ("evaluate x --dataset eld --protocol eld-uncorected", "did you mean eld-uncorrected?"),
        ("profile show sonya7s2", "did you mean SonyA7S2?"),
        ("profile show absent.json", "absent.json: cannot be read"),
        ("verify eld --camera SonyA7SII", "did you mean SonyA7S2?"),
        ("verify a.h5 b.csv", "a.h5 is checked alone"),
        ("verify a.h5 --root x", "--root and --camera are for manifests; a store is checked whole"),
        ("lock", "MANIFEST; see eldata lock --help"),
        ("verify x --level deep", "'deep' (choose from quick, metadata, full)"),
        ("lock x --jobs 0", "argument --jobs: expected a whole number of 1 or more, found '0'"),
        ("demo x --scenes 0", "scenes must be 1 or more"),
        ("demo x --beside dct --calibration", "--beside is about the demo that scores"),
        ("demo x --scenes 2 --calibration", "--scenes is about the demo that scores"),
        ("demo x --calibration --seed -1", "seed must be 0 or more; found -1"),
        ("evaluate x", "one of the arguments --dataset --manifest is required"),
        ("evaluate --dataset eld", "one of the arguments PREDS --baseline is required"),
        ("evaluate x --dataset eld --clip 0007", "(in Python ids=[...]) is for datasets of clips, such as drv"),
        ("evaluate x --dataset drv --subset test --clip 0007", "give a subset or ids, not both"),
        ("protocols --dataset edl", "no protocol is for dataset 'edl'; eldata info lists the datasets; did you"),
        ("synthesize x -o y --camera SonyA7S2 --ratio a", "expected a number or two such as 100:300, found 'a'"),
        ("synthesize x -o y --camera SonyA7S2 --split 9", "expected two shares such as 95:5, found '9'"),
        ("synthesize x -o y --camera SonyA7S2 --model P*+D", "component D takes real dark frames; give --dark-frames"),
        ("synthesize x -o y --camera SonyA7S2 --dark-frames z", "--dark-frames is for component D"),
        ("pack calibration -o x.h5 --split test", "--split, --subset and --clip are for datasets"),
        ("pack calibration -o x.h5 --camera a --camera b", "give --camera once, or not at all"),
        ("manifest x -o mine.txt", "-o takes a name that ends in .csv, found mine.txt"),
        ("calibrate x --crop 8", "argument --crop: expected rows and columns such as 8:-8,16:, found '8'"),
        ("calibrate x --crop 8:a,:", "expected rows and columns such as 8:-8,16:, found '8:a,:'"),
        ("calibrate none", "none: there is no such folder"),
    ],
)
def test_wrong_usage_is_one_line(arguments: str, words: str, eldata: Cli) -> None:
    assert_one_line(eldata(*arguments.split()), words)
    assert not any(Path.cwd().iterdir())


@pytest.mark.parametrize("program", [eldata_parser, capture_parser])
def test_every_help_explains_each_option_and_ends_with_an_example_that_parses(
    program: Callable[[], argparse.ArgumentParser],
) -> None:
    for words, parser in commands(program()):
        options = [action for action in parser._actions if not isinstance(action, argparse._SubParsersAction)]
        if words and options != parser._actions:
            continue  # it only holds others
        assert all(option.help for option in options), parser.prog
        outputs = parser.get_default("outputs") or {}
        for option in options:
            if option.option_strings and option.metavar == "FILE" and re.search(r"\bwrite\b", str(option.help)):
                assert option.dest in outputs, f"{parser.prog} does not check {option.dest} before its work"
        examples = re.findall(r"^    ((?:eldata|capture) .*)", parser.format_help(), flags=re.MULTILINE)
        assert examples, parser.prog
        for example in examples:
            assert example.startswith(parser.prog)
            arguments = program().parse_args(shlex.split(example.partition(" > ")[0])[1:])
            assert arguments.command.startswith(parser.prog)


# --- unusable input -------------------------------------------------------------------------------------------


def test_unusable_input_is_one_line(eldata: Cli, own: Tree, predictions: Path, tmp_path: Path) -> None:
    table, nowhere = own.manifest, tmp_path / "no" / "such.csv"
    root: list[str | Path] = ["--root", own.root]
    commands: list[list[str | Path]] = [["verify"], ["lock"], ["evaluate", predictions, "--manifest"]]
    for command in commands:
        assert_one_line(eldata(*command, nowhere), str(nowhere), "cannot be read")
        assert_one_line(eldata(*command, table, *root, "--camera", "Leica"), "Leica", "DemoAlpha")
    for name in ("verify", "lock"):
        assert_one_line(eldata(name, tmp_path), str(tmp_path))
    assert_one_line(eldata("evaluate", tmp_path / "none", "--manifest", table, *root), "none", "no such folder")
    assert_one_line(eldata(*commands[2], table, "--root", tmp_path / "none"), str(tmp_path / "none"), "--root")
    table.with_suffix(".json").unlink()
    assert_one_line(eldata("verify", table, *root), str(table.with_suffix(".json")), "card")


def test_no_command_takes_a_file_that_lost_a_part_for_whole(eldata: Cli, own: Tree, predictions: Path) -> None:
    """Its compressed data has a page of zeros, as an interrupted download leaves it, and decodes to a whole frame.

    Regression: verify said "all well", lock recorded its hash, and evaluate scored it, 28.84 dB instead of 43.05.
    """
    reference = "DemoAlpha/scene-1/IMG_0006.dng"
    path = own.files / reference
    whole = Whole.read(path)
    data = bytearray(whole.content)
    data[whole.first + 3000 : whole.first + 3000 + PAGE] = bytes(PAGE)
    path.write_bytes(data)
    manifest = own.manifest.read_bytes()
    place = own.arguments[1:]
    assert eldata("verify", *place, "--level", "metadata").code == 0
    for command in (("verify", *place, "--level", "full"), ("lock", *place), ("evaluate", predictions, *own.arguments)):
        outcome = eldata(*command)
        assert outcome.code == 1
        assert reference in outcome.out + outcome.err
        assert "bytes of 0x00 in a row" in outcome.out + outcome.err
    assert own.manifest.read_bytes() == manifest


# --- --json and --csv -----------------------------------------------------------------------------------------


def test_nothing_scored_is_not_all_well_and_no_older_scores_outlive_it(
    eldata: Cli, tree: Tree, predictions: Path, tmp_path: Path
) -> None:
    """The problems are written. A script must not take the wrong folder for success, nor read yesterday's scores."""
    (tmp_path / "preds").mkdir()
    targets = ("--csv", tmp_path / "x.csv", "--json", tmp_path / "x.json")
    arguments = (*tree.arguments, *targets)
    assert eldata("evaluate", predictions, *arguments).code == 0
    assert (tmp_path / "x.csv").read_text().count("\n") == 13
    assert eldata("evaluate", tmp_path / "preds", *arguments).code == 1
    data = json.loads((tmp_path / "x.json").read_text())
    assert (len(data["problems"]), len(data["coverage"]["missing"])) == (1, 12)
    assert not (tmp_path / "x.csv").exists() or (tmp_path / "x.csv").read_text().count("\n") == 1
    assert eldata("evaluate", tmp_path / "preds", *arguments, "--allow-missing").code != 0


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
