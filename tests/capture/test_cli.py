from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from capture.cli import main
from eldata import __version__
from tests.cases import in_one_test

if TYPE_CHECKING:
    import pytest


@in_one_test(
    "line, words",
    [
        ("plan --metered soon", "argument --metered: expected seconds above 0, such as 4, 1/2"),
        ("plan --metered 1e999999999", "found '1e999999999'"),
        ("plan --metered 1/0", "expected seconds above 0"),
        ("plan --isos 800 fast", "argument --isos: expected a whole number"),
        ("plan --isos " + "9" * 5000, "expected a whole number"),
        ("plan --factors 0", "argument --factors: expected a whole number of 1 or more, found '0'"),
        ("plan --met 4", "there is no option --met; did you mean --metered?"),
        ("fly", "fly"),
        ("", "a command is needed; see capture --help"),
    ],
)
def test_wrong_usage_is_one_line(line: str, words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(line.split()) == 2
    output, errors = capsys.readouterr()
    assert output == ""
    assert errors.splitlines()[-1].startswith(("capture: ", "capture plan: "))
    assert errors.count("\n") == 1 or not line
    assert words in errors


def test_version(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Arguments of the process are the default."""
    monkeypatch.setattr(sys, "argv", ["capture", "--version"])
    assert main(["--version"]) == main() == 0
    assert capsys.readouterr().out == f"capture {__version__}\n" * 2
