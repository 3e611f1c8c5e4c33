"""Files that commands write: tried before the work, and none is lost to another that fails after it."""

from __future__ import annotations

import argparse
import json
import os
import re
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from capture.cli.main import parser as capture_parser
from eldata.base.console import _Output, each_of
from eldata.cli.main import parser as eldata_parser
from eldata.errors import EldataError
from tests.cli.conftest import Cli, room_for

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from tests.evaluation.helpers import Tree


# --- which options name them --------------------------------------------------------------------------------------


def options_of(parser: argparse.ArgumentParser) -> Iterator[tuple[str, argparse.Action]]:
    """Every option of a program, with the command that has it."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for command in action.choices.values():
                yield from options_of(command)
        else:
            yield parser.prog, action


@pytest.mark.parametrize("parser", [eldata_parser(), capture_parser()], ids=["eldata", "capture"])
def test_every_option_that_names_a_file_to_write_is_tried_first(parser: argparse.ArgumentParser) -> None:
    found = [
        (command, action.option_strings[-1], isinstance(action, _Output))
        for command, action in options_of(parser)
        if action.option_strings and action.metavar == "FILE" and re.search(r"\bwrite\b", str(action.help))
    ]
    assert len(found) > 5
    assert [one for one in found if not one[2]] == []


# --- before the work ----------------------------------------------------------------------------------------------

ARGUMENTS = {
    "evaluate": ["preds", "--manifest", "none.csv"],
    "compare": ["none.json", "none.json"],
    "verify": ["none.csv"],
    "lock": ["none.csv"],
    "calibrate": ["none"],
    "profile show": ["none"],
    "profile estimate": ["none"],
    "noise check": ["none", "--frames", "none"],
    "protocols": ["none"],
    "info": ["none"],
    "download": ["none"],
}


@pytest.mark.parametrize(
    ("command", "option"),
    [
        *((command, "--json") for command in ARGUMENTS),
        *(("evaluate", option) for option in ("--csv", "--html")),
        *(("calibrate", option) for option in ("-o", "--output", "--html")),
        ("compare", "--html"),
        ("profile show", "--html"),
        ("profile estimate", "-o"),
        ("noise check", "--html"),
    ],
)
def test_a_place_to_write_to_is_tried_before_the_input_is_read(command: str, option: str, eldata: Cli) -> None:
    given = [*command.split(), *ARGUMENTS[command]]
    Path("folder").mkdir()
    for target, problem in (
        ("folder", "is a folder, not a file"),
        ("no/x", "there is no folder no; make it first"),
        (os.devnull, "is a device, not a file"),
    ):
        outcome = eldata(*given, option, target)
        assert (outcome.code, outcome.out) == (2, "")
        assert outcome.err == f"eldata {command}: cannot write {target}: {problem}\n"
    outcome = eldata(*given, option, "")
    assert outcome.err == f"eldata {command}: cannot write {option}: expected the name of a file, found nothing\n"
    assert "cannot write" not in eldata(*given, option, "x").err, "it is the input that is wrong now"
    assert [path.name for path in Path.cwd().iterdir()] == ["folder"]


@pytest.mark.parametrize("second", ["x.csv", "./x.csv", "folder/../x.csv", "link/x.csv", "{absolute}"])
def test_one_file_is_not_written_twice(second: str, eldata: Cli) -> None:
    Path("folder").mkdir()
    Path("link").symlink_to(Path.cwd())
    second = second.replace("{absolute}", str(Path("x.csv").absolute()))
    outcome = eldata("evaluate", "preds", "--dataset", "eld", "--csv", "x.csv", "--json", second)
    assert (outcome.code, outcome.out) == (2, "")
    assert outcome.err == f"eldata evaluate: --csv and --json both write {second}; give each a file of its own\n"


def test_files_of_one_name_in_two_folders_are_two(eldata: Cli) -> None:
    Path("folder").mkdir()
    outcome = eldata("evaluate", "preds", "--manifest", "none.csv", "--csv", "x", "--json", "folder/x")
    assert "none.csv" in outcome.err


def test_an_older_file_is_left_alone_until_there_is_a_new_one(eldata: Cli) -> None:
    Path("x.csv").write_text("yesterday's")
    assert eldata("evaluate", "preds", "--manifest", "none.csv", "--csv", "x.csv").code == 2
    assert Path("x.csv").read_text() == "yesterday's"


# --- after it -----------------------------------------------------------------------------------------------------


def test_a_full_disk_costs_an_evaluation_neither_its_table_nor_its_other_files(
    eldata: Cli, tree: Tree, predictions: Path
) -> None:
    arguments = ("evaluate", predictions, "--manifest", tree.manifest, "--root", tree.root, "--jobs", "1")
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


def test_a_page_that_cannot_be_drawn_costs_no_numbers(
    eldata: Cli, tree: Tree, predictions: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise RuntimeError("no font")

    monkeypatch.setattr("eldata.reports.evaluation.page.write_evaluation_page", broken)
    arguments = ("evaluate", predictions, "--manifest", tree.manifest, "--root", tree.root, "--jobs", "1")
    outcome = eldata(*arguments, "--html", "x.html", "--json", "x.json")
    assert outcome.code == 2
    assert "12 of 12 pairs" in outcome.out
    assert outcome.err == "eldata evaluate: unexpected RuntimeError: no font; --debug shows where\n"
    assert len(json.loads(Path("x.json").read_text())["images"]) == 12


def refuse(path: str, *_: object) -> None:
    raise EldataError(f"cannot write {path}: No space left on device")


@pytest.mark.parametrize("command", ["verify", "lock"])
def test_what_was_found_is_shown_though_the_json_cannot_be_written(
    command: str, eldata: Cli, own: Tree, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(f"eldata.cli.{command}.write_json", refuse)
    outcome = eldata(command, own.manifest, "--root", own.root, "--jobs", "1", "--json", "x.json")
    assert outcome.code == 2
    assert "32" in outcome.out
    assert outcome.err == f"eldata {command}: cannot write x.json: No space left on device\n"


def test_a_comparison_is_shown_though_its_files_cannot_be_written(eldata: Cli, tree: Tree, predictions: Path) -> None:
    arguments = ("evaluate", predictions, "--manifest", tree.manifest, "--root", tree.root, "--jobs", "1")
    for protocol, name in (("eld", "a.json"), ("eld-uncorrected", "b.json")):
        assert eldata(*arguments, "--protocol", protocol, "--json", name).code == 0
    whole = eldata("compare", "a.json", "b.json")
    with room_for(100):
        outcome = eldata("compare", "a.json", "b.json", "--json", "x.json", "--html", "x.html")
    assert (outcome.code, outcome.out) == (2, whole.out)
    last = outcome.err.splitlines()[-1]
    assert (
        last
        == "eldata compare: cannot write x.json: No space left on device; cannot write x.html: No space left on device"
    )


def test_every_step_is_taken_and_what_failed_is_raised() -> None:
    taken = []

    def step(name: str, error: BaseException | None = None) -> Callable[[], None]:
        def take() -> None:
            taken.append(name)
            if error is not None:
                raise error

        return take

    each_of(step("a"), None, step("b"))
    with pytest.raises(EldataError, match=r"^one$"):
        each_of(step("c", EldataError("one")), step("d"))
    with pytest.raises(ExceptionGroup) as caught:
        each_of(step("e", EldataError("one")), step("f", OSError("two")), step("g"))
    assert [str(one) for one in caught.value.exceptions] == ["one", "two"]
    with pytest.raises(KeyboardInterrupt):
        each_of(step("h", KeyboardInterrupt()), step("i"))
    assert "".join(taken) == "abcdefgh"
