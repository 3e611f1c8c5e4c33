from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING

from capture.cli import main
from eldata import __version__
from tests.cases import in_one_test

if TYPE_CHECKING:
    from pathlib import Path

    import pytest

# The released set, from its published file lists.
METERED = """\
frame  role        ISO  factor  exposure  reference
-----  ---------  ----  ------  --------  ---------
    1  reference   100       -       4 s          -
    2  noisy       800      x1     1/2 s          1
    3  noisy       800     x10    1/20 s          1
    4  noisy       800    x100   1/200 s          6
    5  noisy       800    x200   1/400 s          6
    6  reference   100       -       4 s          -
    7  noisy      1600      x1     1/4 s          6
    8  noisy      1600     x10    1/40 s          6
    9  noisy      1600    x100   1/400 s         11
   10  noisy      1600    x200   1/800 s         11
   11  reference   100       -       4 s          -
   12  noisy      3200      x1     1/8 s         11
   13  noisy      3200     x10    1/80 s         11
   14  noisy      3200    x100   1/800 s         16
   15  noisy      3200    x200  1/1600 s         16
   16  reference   100       -       4 s          -
16 frames per scene: 4 references at ISO 100, 12 noisy (ISOs: 3, factors: 4)
"""


def test_json_says_what_the_table_says(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A time has several spellings; without one, exposures are unknown."""
    for number, text in enumerate(("4", "4.0", "8/2")):
        file = tmp_path / f"{number}.json"
        assert main(["protocol", "--metered", text, "--json", str(file)]) == 0
        assert capsys.readouterr() == (METERED, "")
        content = json.loads(file.read_text())
        frames = content.pop("frames")
        assert content == {
            "base_iso": 100,
            "noisy_isos": [800, 1600, 3200],
            "low_light_factors": [1, 10, 100, 200],
            "repeats": 1,
            "references": 1,
            "metered_s": "4",
        }
        assert len(frames) == 16
        assert frames[4] == {
            "number": 5, "role": "noisy", "iso": 800, "factor": 200, "exposure_s": "1/400", "reference": 6,
        }  # fmt: skip
    small = ["protocol", "--base-iso", "50", "--isos", "400", "--factors", "200", "100"]
    assert main([*small, "--json", str(tmp_path / "small.json")]) == 0
    assert "4 frames per scene: 2 references at ISO 50, 2 noisy" in capsys.readouterr().out
    content = json.loads((tmp_path / "small.json").read_text())
    assert content["metered_s"] is None
    assert {frame["exposure_s"] for frame in content["frames"]} == {None}


@in_one_test(
    "line, words",
    [
        (
            "protocol --metered soon",
            "argument --metered: expected seconds above 0, such as 4, 1/2",
        ),
        ("protocol --metered 1e999999999", "found '1e999999999'"),
        ("protocol --metered 1/0", "expected seconds above 0"),
        ("protocol --isos 800 fast", "argument --isos: expected a whole number"),
        ("protocol --isos " + "9" * 5000, "expected a whole number"),
        ("protocol --isos 800 800", "noisy_isos must hold each value once, found 800 again"),
        ("protocol --factors 0", "argument --factors: expected a whole number of 1 or more, found '0'"),
        ("protocol --met 4", "there is no option --met; did you mean --metered?"),
        ("fly", "fly"),
    ],
)
def test_wrong_usage_is_one_line(line: str, words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(line.split()) == 2
    output, errors = capsys.readouterr()
    assert output == ""
    assert errors.splitlines()[-1].startswith(("capture: ", "capture protocol: "))
    assert errors.count("\n") == 1
    assert words in errors


def test_version(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Arguments of the process are the default."""
    monkeypatch.setattr(sys, "argv", ["capture", "--version"])
    assert main(["--version"]) == main() == 0
    assert capsys.readouterr().out == f"capture {__version__}\n" * 2
