"""`eldata protocols`, and the options of `eldata evaluate` that choose among them."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from eldata.base.console import Parser, add_command, run
from eldata.cli import protocols
from eldata.protocols import PROTOCOLS
from tests.cases import in_one_test
from tests.cli.conftest import Cli, assert_golden, normalised
from tests.cli.test_usage import assert_one_line

if TYPE_CHECKING:
    from pathlib import Path

    import pytest


def command(*arguments: str) -> int:
    parser = Parser(prog="eldata")
    protocols.add_options(add_command(parser.add_subparsers(), "protocols", protocols.__doc__))
    return run(parser, ["protocols", *arguments])


def test_list(capsys: pytest.CaptureFixture[str]) -> None:
    assert command() == 0
    assert_golden("protocols-list", normalised(capsys.readouterr().out))


def test_show(capsys: pytest.CaptureFixture[str]) -> None:
    assert command("show", "led-eld") == 0
    shown = capsys.readouterr().out
    assert command("led-eld") == 0
    assert capsys.readouterr().out == shown
    assert_golden("protocols-show", normalised(shown))
    assert PROTOCOLS["led-eld"].digest in shown
    assert max(len(line) for line in shown.splitlines() if "sha256:" not in line) <= 80


def test_json_and_dataset(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert command("--dataset", "sid-fuji", "--json", str(tmp_path / "p.json")) == 0
    listed = json.loads((tmp_path / "p.json").read_text(encoding="utf-8"))["protocols"]
    assert [one["name"] for one in listed] == ["raw", "sid", "sid-uncorrected", "sid2018"]
    for one in listed:
        assert one == PROTOCOLS[one["name"]].as_dict() | {"digest": PROTOCOLS[one["name"]].digest}
    assert "eld-cvpr20" not in capsys.readouterr().out


def test_a_file_of_ones_own(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text('base = "eld"\nname = "mine"\ntitle = "Mine"\nlevels = "metadata"\n')
    assert command(str(path)) == 0
    assert "levels              the file's own white and black" in capsys.readouterr().out
    path.write_text("levels = 3\n")
    assert command(str(path)) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err == f"eldata protocols: {path}, field base: is missing; a protocol needs base, name and title\n"


# --- eldata evaluate --------------------------------------------------------------------------------------------------


@in_one_test(
    "arguments, said",
    [
        (["--dataset", "eld"], "one of the arguments PREDS --baseline is required"),
        (["x", "--baseline", "input", "--dataset", "eld"], "--baseline: not allowed with argument PREDS"),
        (["x", "--dataset", "eld", "--protocol", "elf"], "no protocol is called 'elf'"),
        (["x", "--dataset", "sid-fuji", "--protocol", "pmn"], "protocol 'pmn' is pmn-sid (for sid-sony) and pmn-eld"),
        (["x", "--dataset", "eld", "--clip", "0007"], "(in Python ids=[...]) is for datasets of clips, such as drv"),
        (["x", "--dataset", "eld", "--protocol", "drv-rgb"], "'drv-rgb' scores videos, and 'eld' is a dataset of"),
        (["x", "--dataset", "drv", "--protocol", "led"], "'led' is led-sid (for sid-sony) and led-eld (for eld)"),
        (["x", "--dataset", "drv", "--subset", "test", "--clip", "0007"], "give a subset or ids, not both"),
    ],
)
def test_wrong_usage_of_evaluate(arguments: list[str], said: str, eldata: Cli) -> None:
    assert_one_line(eldata("evaluate", *arguments), said)
