"""Names in strangers' sets and files that would steer a terminal are printed by their numbers, in any encoding."""

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
STRANGE = "x\x1b[31m\x9b2J\u202e\u2066\x7f\u2028\r\udcff\nall well"


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


def test_sets_and_predictions(run: Run, demo_tree: Path, tmp_path: Path) -> None:
    tree = Tree(demo_tree).copy(tmp_path / "tree")
    where = ("--root", tree.root, "--jobs", "1")
    scene = next(path for path in tree.files.glob("*/*") if path.is_dir())
    stray = scene / f"{STRANGE}.dng"
    shutil.copy(next(scene.glob("*.dng")), stray)
    for level in ("quick", "full"):
        code, text = run("eldata", "verify", tree.manifest, *where, "--level", level, "--json", tmp_path / "v")
        assert code == 1
        assert "x\\x1b[31m\\x9b2J\\u202e\\u2066\\x7f\\u2028\\r\\udcff\\nall well.dng" in text
    assert json.loads((tmp_path / "v").read_text())["ok"] is False
    assert run("eldata", "lock", tree.manifest, *where)[0] == 1
    stray.unlink()
    predictions = tmp_path / "predictions"
    place(predictions, Tree(demo_tree))  # the test's own reader knows plain names alone
    strange = predictions / f"{STRANGE}.npy"
    shutil.copy(next(predictions.rglob("*.npy")), strange)
    code, text = run("eldata", "evaluate", predictions, "--manifest", tree.manifest, *where)
    assert code == 1
    assert "\\nall well.npy: is the prediction of no noisy frame" in text


def test_photographs(run: Run, demo_tree: Path, tmp_path: Path) -> None:
    tree = Tree(demo_tree)
    good, cut = (tmp_path / f"{name}{STRANGE}.dng" for name in ("good", "cut"))
    shutil.copy(next(tree.files.glob("DemoAlpha/*/*.dng")), good)
    cut.write_bytes(good.read_bytes()[:3000])
    code, text = run("eldata", "denoise", good, cut, "--method", "dct", "--profile", "SonyA7S2",
                     "--profile-of-another-camera", "-o", tmp_path / "out")  # fmt: skip
    assert code == 1
    assert "goodx\\x1b[31m\\x9b2J" in text
    assert "cutx\\x1b[31m\\x9b2J" in text


def test_fields_of_files(run: Run, tmp_path: Path) -> None:
    bad = tmp_path / "bad"
    for text in (json.dumps({STRANGE: STRANGE}), json.dumps([STRANGE]), f'"{STRANGE}'):
        bad.write_text(text, encoding="utf-8", errors="backslashreplace")
        for command in ("profile show", "protocols", "compare", "evaluate --manifest", "verify", "lock"):
            words = command.split()
            end = [bad, bad] if command == "compare" else [bad]
            run("eldata", words[0], *(["preds"] if words[0] == "evaluate" else []), *words[1:], *end)
        for command in ("plan", "checklist", "check"):
            run("capture", command, bad)
