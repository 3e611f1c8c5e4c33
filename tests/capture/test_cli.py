from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from capture.cli import main
from eldata import __version__
from tests.waiting import PATIENCE_S

ROOT = Path(__file__).resolve().parents[2]

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

SMALL = """\
frame  role       ISO  factor  exposure  reference
-----  ---------  ---  ------  --------  ---------
    1  reference   50       -         -          -
    2  noisy      400    x100         -          1
    3  noisy      400    x200         -          4
    4  reference   50       -         -          -
4 frames per scene: 2 references at ISO 50, 2 noisy (ISOs: 1, factors: 2)
"""


def test_table_with_exposures(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["protocol", "--metered", "4"]) == 0
    assert capsys.readouterr() == (METERED, "")


def test_table_without_exposures(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["protocol", "--base-iso", "50", "--isos", "400", "--factors", "200", "100"]) == 0
    assert capsys.readouterr() == (SMALL, "")


@pytest.mark.parametrize("text", ["1/2", "0.5", ".5", "2/4"])
def test_metered_time_has_several_spellings(text: str, tmp_path: Path) -> None:
    file = tmp_path / "protocol.json"
    assert main(["protocol", "--metered", text, "--json", str(file)]) == 0
    content = json.loads(file.read_text())
    assert content["metered_s"] == "1/2"
    assert content["frames"][3]["exposure_s"] == "1/1600"


def test_json_says_what_the_table_says(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "protocol.json"
    file.touch()
    assert main(["protocol", "--metered", "4", "--json", str(file)]) == 0
    assert capsys.readouterr().out == METERED
    assert list(tmp_path.iterdir()) == [file]
    content = json.loads(file.read_text())
    frames = content.pop("frames")
    assert content == {
        "base_iso": 100,
        "noisy_isos": [800, 1600, 3200],
        "low_light_factors": [1, 10, 100, 200],
        "repeats": 1,
        "moments": 1,
        "references": 1,
        "metered_s": "4",
    }
    assert len(frames) == 16
    assert frames[0] == {
        "number": 1, "role": "reference", "iso": 100, "factor": None, "exposure_s": "4", "reference": None,
    }  # fmt: skip
    assert frames[4] == {
        "number": 5, "role": "noisy", "iso": 800, "factor": 200, "exposure_s": "1/400", "reference": 6,
    }  # fmt: skip


def test_json_without_metered_time_leaves_exposures_unknown(tmp_path: Path) -> None:
    file = tmp_path / "protocol.json"
    assert main(["protocol", "--json", str(file)]) == 0
    content = json.loads(file.read_text())
    assert content["metered_s"] is None
    assert {frame["exposure_s"] for frame in content["frames"]} == {None}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            ["protocol", "--metered", "soon"],
            "argument --metered: expected seconds above 0, such as 4, 1/2 or 0.5, found 'soon'",
        ),
        (["protocol", "--metered", "1e999999999"], "found '1e999999999'"),
        (["protocol", "--metered", "1/0"], "expected seconds above 0"),
        (["protocol", "--metered", "0"], "expected seconds above 0, such as 4, 1/2 or 0.5, found '0'"),
        (["protocol", "--metered", "-1/2"], "--metered"),
        (["protocol", "--isos", "800", "fast"], "argument --isos: expected a whole number"),
        (["protocol", "--isos", "9" * 5000], "expected a whole number"),
        (["protocol", "--isos"], "argument --isos: expected at least one argument"),
        (["protocol", "--isos", "800", "800"], "noisy_isos must hold each value once, found 800 again"),
        (["protocol", "--factors", "0"], "low_light_factors must be a positive whole number, found 0"),
        (["protocol", "--base-iso", "-100"], "base_iso must be a positive whole number, found -100"),
        (["protocol", "--met", "4"], "there is no option --met; did you mean --metered?"),
        (["protocol", "two\nlines"], "unrecognized arguments: two lines; see capture --help"),
        (["fly"], "fly"),
    ],
)
def test_wrong_usage_is_one_line(arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 2
    output, errors = capsys.readouterr()
    assert output == ""
    assert errors.startswith(("capture: ", "capture protocol: "))
    assert errors.count("\n") == 1
    assert words in errors


@pytest.mark.parametrize("name", ["missing/protocol.json", ".", ""])
def test_json_that_cannot_be_written(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["protocol", "--json", name]) == 2
    output, errors = capsys.readouterr()
    assert output == ""
    assert errors.startswith("capture protocol: cannot write ")
    assert errors.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "arguments",
    [
        ["protocol", "--debug", "--factors", "0"],
        ["protocol", "--factors", "0", "--debug"],
    ],
)
def test_debug_shows_the_traceback(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 2
    assert "Traceback (most recent call last)" in capsys.readouterr().err


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"capture {__version__}\n"


def test_without_arguments_asks_for_a_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 2
    output, errors = capsys.readouterr()
    assert output == ""
    assert errors.endswith("capture: a command is needed; see capture --help\n")


@pytest.mark.parametrize(
    "arguments", [["--help"], ["protocol", "--help"], ["plan", "--help"], ["camera", "--help"], ["manifest", "--help"]]
)
def test_help(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 0
    output = capsys.readouterr().out
    assert output.startswith("usage: capture ")
    assert ("protocol" if arguments == ["--help"] else f"capture {arguments[0]}") in output


def test_arguments_of_the_process_are_the_default(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["capture", "protocol", "--metered", "4"])
    assert main() == 0
    assert capsys.readouterr().out == METERED


@pytest.mark.parametrize(
    "arguments",
    [
        ["--help"],
        ["protocol", "--help"],
        ["plan", "--help"],
        ["camera", "--help"],
        ["manifest", "--help"],
        ["protocol", "--metered", "4"],
    ],
)
def test_heavy_packages_stay_out(arguments: list[str]) -> None:
    code = (
        "import sys, capture\n"
        "from capture.cli import main\n"
        f"assert main({arguments!r}) == 0\n"
        "heavy = {'torch', 'rawpy', 'numpy'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, text=True, capture_output=True, timeout=PATIENCE_S)
    assert done.returncode == 0, done.stderr


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs Linux's /dev/full")
@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_full_standard_output_is_one_line(unbuffered: str) -> None:
    code = "import sys; from capture.cli import main; sys.exit(main(['protocol']))"
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-c", code],
            cwd=ROOT,
            env={**os.environ, "PYTHONUNBUFFERED": unbuffered},
            text=True,
            stdout=full,
            stderr=subprocess.PIPE,
            timeout=PATIENCE_S,
        )
    assert done.returncode == 2
    assert done.stderr == "capture protocol: cannot write to standard output: No space left on device\n"
