"""The script that `eldata completion` prints, in the shell that it is for."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from capture.cli import main as capture
from eldata.base.completion import SHELLS
from tests.shared import there
from tests.waiting import PATIENCE_S

if TYPE_CHECKING:
    from collections.abc import Mapping

    from tests.cli.conftest import Cli

WORDS = {
    ("veri",): ["verify"],
    ("evaluate", "--data"): ["--dataset"],
    ("evaluate", "x", "--dataset", "sid"): ["sid-fuji", "sid-sony", "sidd", "sidd-blocks", "sidd-cc"],
    ("evaluate", "x", "--protocol", "pmn"): ["pmn", "pmn-eld", "pmn-lrid", "pmn-sid"],
    ("verify", "lr"): ["lrd", "lrid"],
    ("synthesize", "x", "--camera", "SonyA"): ["SonyA7S2", "SonyA7S2-PMN"],
    ("profile", "sh"): ["show"],
    ("profile", "show", "Nikon"): ["NikonD850", "NikonD850-2"],
    ("compare", "scor"): ["scores.json"],
    ("evaluate", "pre"): ["preds"],
}
CAPTURE_WORDS = {
    ("man",): ["manifest"],
    ("manifest", "pl"): ["plan.json"],
    ("manifest", "x", "--copy-to", "da"): ["data"],
    ("manifest", "x", "--prog"): ["--progress"],
    ("plan", "--protocol", "rel"): ["released"],
}


def test_what_bash_completes(eldata: Cli) -> None:
    outcome = eldata("completion", "bash")
    assert (outcome.code, outcome.err) == (0, "")
    Path("scores.json").write_text("{}")
    Path("preds").mkdir()
    assert_completed("eldata", outcome.out, WORDS)


def test_what_bash_completes_of_capture(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("plan.json").write_text("{}")
    Path("data").mkdir()
    assert capture(["completion", "bash"]) == 0
    assert_completed("capture", capsys.readouterr().out, CAPTURE_WORDS)


def assert_completed(program: str, script: str, expected_words: Mapping[tuple[str, ...], list[str]]) -> None:
    Path("script.sh").write_text(script)
    lines = ["source ./script.sh"]
    for typed in expected_words:
        words = " ".join((program, *typed))
        lines += [f"COMP_WORDS=({words}); COMP_CWORD={len(typed)}; COMPREPLY=(); COMP_LINE='{words}'"]
        lines += [f"_shtab_{program}", 'echo "${COMPREPLY[@]}"']
    bash = there(shutil.which("bash"))
    done = subprocess.run([bash, "-c", "\n".join(lines)], capture_output=True, text=True, timeout=PATIENCE_S)
    found = {typed: sorted(line.split()) for typed, line in zip(expected_words, done.stdout.splitlines(), strict=True)}
    assert found == {typed: sorted(expected) for typed, expected in expected_words.items()}


@pytest.mark.parametrize("shell", SHELLS)
def test_every_shell_has_a_script_with_the_commands(shell: str, eldata: Cli) -> None:
    outcome = eldata("completion", shell)
    assert (outcome.code, outcome.err) == (0, "")
    for word in ("verify", "sid-sony", "exclude"):
        assert word in outcome.out
