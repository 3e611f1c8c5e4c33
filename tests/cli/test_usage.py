from __future__ import annotations

import argparse
import json
import os
import re
import shlex
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

import eldata as package
from capture.cli.main import parser as capture_parser
from eldata.cli.main import parser as eldata_parser
from tests.cli.conftest import Cli, Outcome

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from tests.evaluation.helpers import Tree

COMMANDS = ("demo", "manifest", "verify", "lock", "protocols", "evaluate", "compare", "calibrate")


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


def test_help_lists_commands_and_exit_codes(eldata: Cli) -> None:
    outcome = eldata("--help")
    assert outcome.code == 0
    assert outcome.err == ""
    for word in (
        *COMMANDS,
        "Exit codes",
        "0 all well",
        "1 problems",
        "2 wrong usage",
        "130 Ctrl-C",
        "141",
        "143",
        "ELDATA_ROOT",
    ):
        assert word in " ".join(outcome.out.split())


@pytest.mark.parametrize(
    ("command", "options"),
    [
        ("demo", ["DIR", "--scenes", "--seed", "--calibration", "--benchmark", "--without", "shading", "--jobs",
                  "--debug"]),
        ("calibrate", ["FRAMES", "--camera", "--output", "--html", "--iso", "--root", "--jobs", "--json", "--debug",
                       "docs/calibration.md"]),
        ("verify", ["MANIFESTS", "--root", "--camera", "--level", "quick", "metadata", "full", "--jobs",
                    "--json", "--debug"]),
        ("manifest", ["FOLDER", "--output", "--reference", "--scene", "--jobs", "--json", "--debug"]),
        ("lock", ["MANIFEST", "--root", "--camera", "--jobs", "--json", "--debug"]),
        ("evaluate", ["PREDS", "--dataset", "--manifest", "--protocol", "eld-uncorrected", "--root", "--camera",
                      "--allow-missing", "--jobs", "--dask", "--csv", "--format", "--html", "--compare", "--json",
                      "--baseline", "--debug", "npy", "uint16"]),
        ("protocols", ["NAME", "--json", "--debug"]),
        ("compare", ["RESULT", "--name", "--protocol", "--format", "--html", "--json", "--debug"]),
    ],
)  # fmt: skip
def test_help_of_each_command(command: str, options: list[str], eldata: Cli) -> None:
    outcome = eldata(command, "--help")
    assert outcome.code == 0
    assert outcome.err == ""
    assert f"eldata {command}" in outcome.out
    for option in options:
        assert option in outcome.out
    # Every option has a text.
    assert not re.search(r"^  (-\S+|--\S+)( [A-Z]+)?\n(?=  -|\Z)", outcome.out, re.MULTILINE)


def test_every_command_is_tested_here(eldata: Cli) -> None:
    listed = re.findall(r"^    (\w+)(?: |$)", eldata("--help").out, re.MULTILINE)
    assert set(COMMANDS) <= set(listed)


def test_no_command(eldata: Cli) -> None:
    outcome = eldata()
    assert outcome.code == 2
    assert outcome.out == ""
    assert "--help" in outcome.err
    assert "Traceback" not in outcome.err


def test_running_stands_before_a_command_or_after_it(eldata: Cli) -> None:
    after = eldata("profile", "list", "--json", "after.json", "--debug")
    assert after.code == 0
    assert eldata("--json=before.json", "--debug", "profile", "list") == after
    assert Path("before.json").read_bytes() == Path("after.json").read_bytes()
    assert_one_line(eldata("--dask", "a", "demo"), "eldata demo: there is no option --dask")
    assert_one_line(eldata("--jobs", "2", "verify", "--dask", "a"), "--dask: not allowed with argument --jobs")
    assert "a command is needed" in eldata("--jobs", "2").err


# --- wrong usage ----------------------------------------------------------------------------------------------


def test_unknown_command(eldata: Cli) -> None:
    assert_one_line(eldata("frobnicate"), "frobnicate", "verify", "evaluate", "--help")


@pytest.mark.parametrize(
    ("arguments", "meant"),
    [
        (["verfy"], "did you mean verify? See eldata --help"),
        (["profile", "shwo"], "did you mean show? See eldata profile --help"),
        (["evaluate", "x", "--datset", "eld"], "there is no option --datset; did you mean --dataset? See"),
        (["evaluate", "x", "--datset=eld"], "there is no option --datset; did you mean --dataset? See"),
        (
            ["--level", "full", "verify", "eld"],
            "no option --level, and a command's options come after its name",
        ),
        (["verify", "eld", "--level", "ful"], "did you mean full?"),
        (["verify", "edl"], "no dataset is called 'edl'; known are aim25, crvd, drv, eld"),
        (["verify", "ELD"], "did you mean eld?"),
        (["lock", "sid-sonny"], "did you mean sid-sony?"),
        (["info", "sid"], "it is sid-fuji and sid-sony: name one"),
        (["download", "edl"], "did you mean eld?"),
        (["pack", "lrdd", "-o", "x.h5"], "did you mean lrd?"),
        (["pack", "data/SID/Sny", "-o", "x.h5"], "data/SID/Sny: there is no such folder; give a folder of camera raws"),
        (["evaluate", "x", "--dataset", "dvr"], "did you mean drv?"),
        (["evaluate", "x", "--dataset", "eld", "--protocol", "eld-uncorected"], "did you mean eld-uncorrected?"),
        (["protocols", "pmn_sid"], "did you mean pmn-sid?"),
        (["protocols", "--dataset", "edl"], "did you mean eld?"),
        (["profile", "show", "sonya7s2"], "did you mean SonyA7S2?"),
        (["verify", "eld", "--camera", "SonyA7SII"], "did you mean SonyA7S2?"),
        (["pack", "eld", "-o", "x.h5", "--camera", "sonya7s2"], "did you mean SonyA7S2?"),
        (["pack", "sid-sony", "-o", "x.h5", "--subset", "indor-15"], "did you mean indoor-15?"),
    ],
)
def test_what_was_probably_meant(arguments: list[str], meant: str, eldata: Cli) -> None:
    assert_one_line(eldata(*arguments), meant)


def test_a_model_in_place_of_predictions(eldata: Cli) -> None:
    Path("model.pt").write_bytes(b"x")
    Path("data/ELD").mkdir(parents=True)
    assert_one_line(
        eldata("evaluate", "model.pt", "--dataset", "eld"),
        "model.pt: is a file, not a folder, and may hold a model: eldata predict makes predictions with one",
    )


def leaves(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    """The parsers of a program's commands, without those that only hold others."""
    groups = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    for group in groups:
        for one in group.choices.values():
            yield from leaves(one)
    if not groups:
        yield parser


@pytest.mark.parametrize("program", [eldata_parser, capture_parser])
def test_every_help_ends_with_an_example_that_parses(program: Callable[[], argparse.ArgumentParser]) -> None:
    whole = program()
    for parser in (whole, *leaves(whole)):
        examples = [line.strip() for line in parser.format_help().splitlines() if line.startswith("    eldata ")]
        examples += [line.strip() for line in parser.format_help().splitlines() if line.startswith("    capture ")]
        assert examples, parser.prog
        for example in examples:
            assert example.startswith(parser.prog)
            arguments = program().parse_args(shlex.split(example.partition(" > ")[0])[1:])
            assert arguments.command.startswith(parser.prog)


@pytest.mark.parametrize("command", COMMANDS)
def test_unknown_option(command: str, eldata: Cli) -> None:
    required = {
        "verify": ["x"],
        "lock": ["x"],
        "calibrate": ["x"],
        "evaluate": ["x", "--dataset", "eld"],
        "compare": ["x", "y"],
    }.get(command, [])
    assert_one_line(eldata(command, *required, "--frobnicate"), "--frobnicate", "--help")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["lock"], ["MANIFEST", "eldata lock --help"]),
        (["evaluate"], ["PREDS", "eldata evaluate --help"]),
        (["evaluate", "x"], ["--dataset", "--manifest"]),
        (["evaluate", "x", "--dataset", "eld", "--manifest", "y"], ["--manifest", "--dataset"]),
        (["evaluate", "x", "--dataset"], ["--dataset", "expected one argument"]),
        (["verify", "x", "--level", "deep"], ["--level", "deep", "quick", "metadata", "full"]),
        (["evaluate", "x", "--dataset", "eld", "--protocol", "elf"], ["elf", "eld-uncorrected"]),
        (["verify", "x", "--jobs", "many"], ["--jobs", "many"]),
        (["lock", "x", "--jobs", "1.5"], ["--jobs", "1.5"]),
        (["demo", "x", "--scenes", "two"], ["--scenes", "two"]),
        (["demo", "x", "--scenes", "0"], ["scenes", "0"]),
        (["demo", "x", "--seed", "-1"], ["seed", "-1"]),
        (["demo", "x", "y"], ["y"]),
    ],
)
def test_wrong_usage_is_one_line(arguments: list[str], words: list[str], eldata: Cli) -> None:
    assert_one_line(eldata(*arguments), *words)
    assert not any(Path.cwd().iterdir())


def test_jobs_must_be_positive(eldata: Cli, tree: Tree, predictions: Path) -> None:
    root = ("--root", tree.root, "--jobs", "0")
    assert_one_line(eldata("verify", tree.manifest, "--level", "metadata", *root), "jobs", "0")
    assert_one_line(eldata("evaluate", predictions, "--manifest", tree.manifest, *root), "jobs", "0")
    assert_one_line(eldata("lock", tree.manifest, *root), "jobs", "0")


@pytest.mark.parametrize("level", ["quick", "full"])
def test_jobs_must_be_positive_at_every_level(level: str, eldata: Cli, tree: Tree) -> None:
    arguments = ("verify", tree.manifest, "--root", tree.root, "--level", level, "--jobs", "-2")
    assert_one_line(eldata(*arguments), "jobs", "-2")


# --- unusable input -------------------------------------------------------------------------------------------


def test_missing_manifest(eldata: Cli, tmp_path: Path, predictions: Path) -> None:
    missing = tmp_path / "no" / "such.csv"
    assert_one_line(eldata("verify", missing), str(missing), "cannot be read")
    assert_one_line(eldata("lock", missing), str(missing), "cannot be read")
    assert_one_line(eldata("evaluate", predictions, "--manifest", missing), str(missing), "cannot be read")


def test_folder_without_manifests(eldata: Cli, tmp_path: Path) -> None:
    assert_one_line(eldata("verify", tmp_path), str(tmp_path), "manifest")
    assert_one_line(eldata("lock", tmp_path), str(tmp_path))


def test_missing_card(eldata: Cli, own: Tree) -> None:
    card = own.manifest.with_suffix(".json")
    card.unlink()
    assert_one_line(eldata("verify", own.manifest, "--root", own.root), str(card), "card")


def test_missing_predictions_folder(eldata: Cli, tree: Tree, tmp_path: Path) -> None:
    outcome = eldata("evaluate", tmp_path / "nowhere", "--manifest", tree.manifest, "--root", tree.root)
    assert_one_line(outcome, str(tmp_path / "nowhere"), "no such folder")


def test_missing_dataset_folder(eldata: Cli, tree: Tree, predictions: Path, tmp_path: Path) -> None:
    outcome = eldata("evaluate", predictions, "--manifest", tree.manifest, "--root", tmp_path / "nowhere")
    assert_one_line(outcome, str(tmp_path / "nowhere"), "--root")


def test_unknown_names(eldata: Cli, tree: Tree, predictions: Path) -> None:
    root = ("--root", tree.root)
    assert_one_line(eldata("evaluate", predictions, "--dataset", "led", *root), "'led'", "eld")
    assert_one_line(eldata("verify", tree.manifest, "--camera", "Leica", *root), "'Leica'", "DemoAlpha")
    assert_one_line(eldata("lock", tree.manifest, "--camera", "Leica", *root), "'Leica'", "DemoAlpha")
    assert_one_line(
        eldata("evaluate", predictions, "--manifest", tree.manifest, "--camera", "Leica", *root), "Leica", "DemoAlpha"
    )


# What the file holds (None: the real one, spoilt below), and words of the error.
MALFORMED: dict[str, tuple[bytes | None, list[str]]] = {
    "empty": (b"", ["line 1"]),
    "binary": (bytes(range(256)) * 4, ["UTF-8"]),
    "header": (b"a,b,c\n1,2,3\n", ["line 1", "path,role"]),
    "header-of-two-lines": (b'"a\nb\nd",c\n', ["path,role"]),
    "fields": (None, ["line 2", "14 fields"]),
    "ratio": (None, ["line 3", "column ratio", "'fast'"]),
    "outside": (None, ["line 2", "column path", "../"]),
    "quote": (None, ["CSV"]),
}


def malformed(name: str, good: bytes) -> bytes:
    lines = good.split(b"\n")
    if name == "fields":
        lines[1] += b",more"
    elif name == "ratio":
        lines[2] = lines[2].replace(b",1,DemoAlpha/", b",fast,DemoAlpha/")
    elif name == "outside":
        lines[1] = b"../" + lines[1]
    elif name == "quote":
        lines[1] = b'"' + lines[1]
    else:
        return MALFORMED[name][0] or b""
    assert b"\n".join(lines) != good
    return b"\n".join(lines)


@pytest.mark.parametrize("command", ["verify", "lock", "evaluate"])
@pytest.mark.parametrize("name", MALFORMED)
def test_malformed_manifest(name: str, command: str, eldata: Cli, own: Tree, predictions: Path) -> None:
    content = malformed(name, own.manifest.read_bytes())
    own.manifest.write_bytes(content)
    arguments: list[str | Path] = [command, own.manifest]
    if command == "evaluate":
        arguments = [command, predictions, "--manifest", own.manifest]
    assert_one_line(eldata(*arguments, "--root", own.root), str(own.manifest), *MALFORMED[name][1])
    assert own.manifest.read_bytes() == content


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("{", ["JSON"]),
        ("[]", ["expected an object"]),
        ('{"name": "x"}', ["found nothing"]),
        ('{"nonsense": 1}', ["nonsense"]),
    ],
)
def test_malformed_card(content: str, words: list[str], eldata: Cli, own: Tree) -> None:
    card = own.manifest.with_suffix(".json")
    card.write_text(content)
    assert_one_line(eldata("verify", own.manifest, "--root", own.root), str(card), *words)


def test_dataset_that_is_not_what_its_manifest_says(eldata: Cli, own: Tree, predictions: Path) -> None:
    (own.files / "DemoAlpha/scene-1/IMG_0006.dng").unlink()
    outcome = eldata("evaluate", predictions, "--manifest", own.manifest, "--root", own.root, "--jobs", "1")
    assert_one_line(outcome, "DemoAlpha/scene-1/IMG_0006.dng", "expected a file, found nothing")


def test_demo_refuses_a_foreign_folder(eldata: Cli, tmp_path: Path) -> None:
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "holiday.jpg").write_bytes(b"x")
    assert_one_line(eldata("demo", tmp_path / "photos"), str(tmp_path / "photos"), "new folder")
    assert [path.name for path in (tmp_path / "photos").iterdir()] == ["holiday.jpg"]


# --- --json and --csv -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["missing-folder", "folder", "file-as-folder"])
@pytest.mark.parametrize("command", ["verify", "lock", "evaluate", "evaluate-csv"])
def test_unwritable_target(command: str, kind: str, eldata: Cli, own: Tree, predictions: Path, tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").write_text("x")
    target = {
        "missing-folder": tmp_path / "nowhere" / "x",
        "folder": tmp_path / "folder",
        "file-as-folder": tmp_path / "file" / "x",
    }[kind]
    option = "--csv" if command == "evaluate-csv" else "--json"
    manifest: list[str | Path] = [predictions, "--manifest"] if command.startswith("evaluate") else []
    name = command.removesuffix("-csv")
    outcome = eldata(name, *manifest, own.manifest, "--root", own.root, "--jobs", "1", option, target)
    assert outcome.code == 2
    assert outcome.err.count("\n") == 1
    assert f"cannot write {target}" in outcome.err
    assert "Traceback" not in outcome.err
    assert list((tmp_path / "folder").iterdir()) == []
    assert not (tmp_path / "nowhere").exists()


def test_verify_json(eldata: Cli, own: Tree, tmp_path: Path) -> None:
    (own.files / "DemoAlpha/scene-1/IMG_0006.dng").unlink()
    target = tmp_path / "report.json"
    target.touch()
    outcome = eldata("verify", own.manifest, "--root", own.root, "--jobs", "1", "--json", target)
    assert outcome.code == 1
    data = json.loads(target.read_text(encoding="utf-8"))
    assert data["ok"] is False
    assert data["level"] == "quick"
    (dataset,) = data["datasets"]
    (problem,) = dataset["problems"]
    assert problem["path"] == "DemoAlpha/scene-1/IMG_0006.dng"
    assert {"expected", "found", "advice", "field"} <= set(problem)
    assert all(problem[key] in outcome.out for key in ("path", "expected", "found", "advice"))
    assert dataset["files_listed"] == 32
    assert dataset["files_checked"] == 31
    assert not list(tmp_path.glob(".*"))  # no temporary file is left


def test_lock_json(eldata: Cli, own: Tree, tmp_path: Path) -> None:
    outcome = eldata("lock", own.manifest, "--root", own.root, "--jobs", "1", "--json", tmp_path / "x.json")
    assert outcome.code == 0
    assert json.loads((tmp_path / "x.json").read_text()) == {"files_locked": 32, "problems": []}


def test_evaluate_json_and_csv(eldata: Cli, tree: Tree, predictions: Path, tmp_path: Path) -> None:
    targets = ("--csv", tmp_path / "x.csv", "--json", tmp_path / "x.json")
    outcome = eldata("evaluate", predictions, "--manifest", tree.manifest, "--root", tree.root, "--jobs", "1", *targets)
    assert outcome.code == 0
    data = json.loads((tmp_path / "x.json").read_text())
    assert len(data["images"]) == 12
    assert (tmp_path / "x.csv").read_text().count("\n") == 13
    means = {(row["camera"], row["ratio"]): row for row in data["table"]}
    assert f"{means['DemoAlpha', 100.0]['psnr_db']:.2f}" in outcome.out


def test_evaluate_json_of_problems_is_written_too(eldata: Cli, tree: Tree, tmp_path: Path) -> None:
    (tmp_path / "preds").mkdir()
    arguments = ("evaluate", tmp_path / "preds", "--manifest", tree.manifest, "--root", tree.root, "--jobs", "1")
    outcome = eldata(*arguments, "--json", tmp_path / "x.json")
    assert outcome.code == 1
    data = json.loads((tmp_path / "x.json").read_text())
    assert len(data["problems"]) == 1
    assert len(data["coverage"]["missing"]) == 12


def test_nothing_scored_is_not_all_well(eldata: Cli, tree: Tree, tmp_path: Path) -> None:
    """The wrong folder with --allow-missing has nothing to score: a script must not take that for success."""
    (tmp_path / "preds").mkdir()
    outcome = eldata(
        "evaluate", tmp_path / "preds", "--manifest", tree.manifest, "--root", tree.root, "--jobs", "1",
        "--allow-missing",
    )  # fmt: skip
    assert outcome.code != 0


def test_an_older_csv_does_not_outlive_a_run_without_scores(
    eldata: Cli, tree: Tree, predictions: Path, tmp_path: Path
) -> None:
    """Else a script reads yesterday's scores."""
    (tmp_path / "preds").mkdir()
    target = tmp_path / "x.csv"
    arguments = ("--manifest", tree.manifest, "--root", tree.root, "--jobs", "1", "--csv", target)
    assert eldata("evaluate", predictions, *arguments).code == 0
    assert eldata("evaluate", tmp_path / "preds", *arguments).code == 1
    assert not target.exists() or target.read_text().count("\n") == 1


# --- --root, --camera, --protocol ------------------------------------------------------------------------------


def test_root_wins_over_the_variable_which_wins_over_data(
    eldata: Cli, tree: Tree, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def folder_checked(*arguments: str | Path) -> str:
        outcome = eldata("verify", tree.manifest, "--jobs", "1", *arguments)
        found = re.search(r"\((?:no folder )?(\S+?)\)|in (\S+):", outcome.out.replace("(quick) ", ""))
        assert found is not None
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


def test_camera_may_be_repeated(eldata: Cli, own: Tree) -> None:
    (own.files / "DemoBeta/scene-1/IMG_0006.dng").unlink()
    arguments = ("verify", own.manifest, "--root", own.root, "--jobs", "1")
    assert eldata(*arguments, "--camera", "DemoAlpha").code == 0
    assert eldata(*arguments, "--camera", "DemoBeta").code == 1
    assert eldata(*arguments, "--camera", "DemoAlpha", "--camera", "DemoBeta").code == 1


def test_protocol_is_passed_on(eldata: Cli, tree: Tree, predictions: Path) -> None:
    arguments = ("evaluate", predictions, "--manifest", tree.manifest, "--root", tree.root, "--jobs", "1")
    corrected, plain = eldata(*arguments), eldata(*arguments, "--protocol", "eld-uncorrected")
    assert "protocol eld:" in corrected.out
    assert "protocol eld-uncorrected:" in plain.out
    assert corrected.out.splitlines()[4] != plain.out.splitlines()[4]


# --- --debug --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("command", ["verify", "lock"])
def test_debug_shows_the_traceback(command: str, eldata: Cli, tmp_path: Path) -> None:
    plain = eldata(command, tmp_path / "none.csv")
    debug = eldata(command, tmp_path / "none.csv", "--debug")
    assert debug.code == plain.code == 2
    assert "Traceback (most recent call last)" in debug.err
    assert "ManifestError" in debug.err
    assert debug.err.endswith(plain.err)


def test_debug_of_evaluate_and_demo(eldata: Cli, tmp_path: Path) -> None:
    assert "Traceback" in eldata("evaluate", tmp_path / "none", "--dataset", "eld", "--debug").err
    assert "Traceback" in eldata("demo", tmp_path / "x", "--scenes", "0", "--debug").err


def test_an_unexpected_error_is_one_line_too(eldata: Cli, monkeypatch: pytest.MonkeyPatch, tree: Tree) -> None:
    def broken(*_: object, **__: object) -> None:
        raise RuntimeError("first line\nsecond line")

    monkeypatch.setattr("eldata.cli.verify.verify", broken)
    plain = eldata("verify", tree.manifest)
    assert plain.code == 2
    assert plain.err.count("\n") == 1
    assert "RuntimeError" in plain.err
    assert "--debug" in plain.err
    assert "Traceback" in eldata("verify", tree.manifest, "--debug").err


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_unreadable_manifest(eldata: Cli, own: Tree) -> None:
    own.manifest.chmod(0)
    assert_one_line(eldata("verify", own.manifest, "--root", own.root), str(own.manifest), "cannot be read")
