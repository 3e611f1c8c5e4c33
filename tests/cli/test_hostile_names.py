"""Names that would steer a terminal: no command prints one as it is, or fails to print it, in any encoding."""

from __future__ import annotations

import io
import json
import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

import capture.cli
import eldata.cli.main
from eldata.base.visible import has_unseen
from tests.evaluation.helpers import Tree, place

Run = Callable[..., tuple[int, str]]

# Escape sequences of 7 and 8 bits, a turn of direction, DEL, a line separator, a return, a byte that is not UTF-8.
STEERS = "x\x1b[31m\x9b2J\u202e\u2066\x7f\u2028\r\udcff"
# What a stranger names may be on two lines as well; the user's own folder is not a stranger's.
STRANGE = f"{STEERS}\nall well"


@pytest.fixture(params=["ascii", "utf-8"])  # the latter holds all that must not be printed
def run(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Run:
    """Run a command line in this process, with streams that refuse what their encoding lacks."""

    encoding: str = request.param

    def call(*arguments: str | Path) -> tuple[int, str]:
        streams = [io.BytesIO(), io.BytesIO()]
        wrapped = [io.TextIOWrapper(written, encoding=encoding, errors="strict") for written in streams]
        for name, stream in zip(("stdout", "stderr"), wrapped, strict=True):
            monkeypatch.setattr(sys, name, stream)
        program, *rest = map(str, arguments)
        code = (eldata.cli.main.main if program == "eldata" else capture.cli.main)(rest)
        monkeypatch.undo()
        for stream in wrapped:
            stream.flush()
        text = "".join(written.getvalue().decode(encoding) for written in streams)
        assert not has_unseen(text, lines=True), text
        assert "\nall well" not in text, text
        assert "--debug shows where" not in text, text
        assert "Traceback" not in text, text
        return code, text

    return call


@pytest.fixture
def place_for_all(tmp_path: Path) -> Path:
    folder = tmp_path / STEERS
    folder.mkdir()
    return folder


def test_sets_and_predictions(run: Run, demo_tree: Path, place_for_all: Path) -> None:
    tree = Tree(demo_tree).copy(place_for_all / "tree")
    where = ("--root", tree.root, "--jobs", "1")
    scene = next(path for path in tree.files.glob("*/*") if path.is_dir())
    stray = scene / f"{STRANGE}.dng"
    shutil.copy(next(scene.glob("*.dng")), stray)
    for level in ("quick", "full"):
        code, text = run("eldata", "verify", tree.manifest, *where, "--level", level, "--json", place_for_all / "v")
        assert code == 1
        assert "x\\x1b[31m\\x9b2J\\u202e\\u2066\\x7f\\u2028\\r\\udcff\\nall well.dng" in text
    assert json.loads((place_for_all / "v").read_text())["ok"] is False
    assert run("eldata", "lock", tree.manifest, *where)[0] == 1
    stray.unlink()
    predictions = place_for_all / "predictions"
    place(predictions, Tree(demo_tree))  # the test's own reader knows plain names alone
    strange = predictions / f"{STRANGE}.npy"
    shutil.copy(next(predictions.rglob("*.npy")), strange)
    more = ("--manifest", tree.manifest, *where)
    code, text = run("eldata", "evaluate", predictions, *more)
    assert code == 1
    assert "\\nall well.npy: is the prediction of no noisy frame" in text
    strange.unlink()
    page = place_for_all / "page.html"
    code, text = run("eldata", "evaluate", predictions, *more, "--csv", place_for_all / "s.csv", "--html", page)
    assert code == 0, text
    assert not has_unseen(page.read_text(encoding="utf-8"), lines=True)


def test_words_of_the_command_line_and_of_files(run: Run, place_for_all: Path) -> None:
    """Unknown names, and files that are wrong in a field with such a name."""
    bad = place_for_all / "bad"
    for text in (json.dumps({STRANGE: STRANGE}), json.dumps([STRANGE]), f'"{STRANGE}'):
        bad.write_text(text, encoding="utf-8", errors="backslashreplace")
        for command in ("profile show", "protocols", "compare", "evaluate --manifest", "verify", "lock"):
            words = command.split()
            end = [bad, bad] if command == "compare" else [bad]
            run("eldata", words[0], *(["preds"] if words[0] == "evaluate" else []), *words[1:], *end)
        for command in ("plan", "checklist", "check"):
            run("capture", command, bad)
    for command in ("info", "download", "protocols", "verify", STRANGE):
        assert run("eldata", command, STRANGE)[0] == 2
    for root in (place_for_all, place_for_all / "none"):
        run("eldata", "info", "--root", root)
        run("eldata", "info", "eld", "--root", root)
        run("eldata", "download", "eld", "--root", root)
        run("eldata", "download", "eld", "--root", root, "--from", place_for_all / "none.zip")
