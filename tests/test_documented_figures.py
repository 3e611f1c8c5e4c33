"""What a document shows of a command, the command prints: blocks of `$ eldata ...`, on the data of the demo."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from eldata.cli.main import main
from eldata.noise import CameraProfile, NoiseModel
from tests.shared import made_once, there

ROOT = Path(__file__).parents[1]
_BLOCK = re.compile(r"^```\n\$ (eldata (?:evaluate|demo) eldata-(?:.*\\\n)*.*)\n((?:.*\n)*?)```$", re.MULTILINE)
COMMANDS: dict[str, dict[str, list[str]]] = {}
"""By command, what each block shows of it."""
for path in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))):
    for number, (command, shown) in enumerate(_BLOCK.findall(path.read_text(encoding="utf-8")), 1):
        COMMANDS.setdefault(command, {})[f"{path.name} {number}"] = shown.splitlines()


def run_demo(folder: Path) -> None:
    assert main(["demo", str(folder / "eldata-demo")]) == 0


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    with made_once(tmp_path_factory, "whole-demo", run_demo) as folder:
        yield folder


@pytest.mark.study
@pytest.mark.parametrize("command", COMMANDS, ids=map(", ".join, COMMANDS.values()))
def test_a_command_prints_what_documents_show(
    command: str, demo: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A line may be cut off at its end; "..." stands for lines that are left out, and nothing else may be."""
    (tmp_path / "eldata-demo").symlink_to(demo / "eldata-demo")
    monkeypatch.chdir(tmp_path)
    capsys.readouterr()
    assert any("README.md 1" in blocks for blocks in COMMANDS.values())
    assert main(shlex.split(command.replace("\\\n", " "))[1:]) == 0
    printed = capsys.readouterr().out
    for block, shown in COMMANDS[command].items():
        pattern = "".join("(?:.*\n)*?" if line == "..." else f"{re.escape(line)}.*\n" for line in shown)
        assert re.match(pattern, printed), f"{block}: {printed}"


def test_the_early_clip_lifts_the_dark_as_documented() -> None:
    """docs/noise.md: the mean of 4,000 draws of a dark patch in DN, whose standard error is 0.03."""
    text = (ROOT / "docs" / "noise.md").read_text(encoding="utf-8")
    found = there(re.search(r"mean of (\d\.\d) DN instead of (\d\.\d)\)", text))
    generator, range_dn = np.random.default_rng(1), 15871.0
    profile, model = CameraProfile.load("SonyA7S2"), NoiseModel("P*+G*+B+R+U")
    dark = np.zeros((4, 32, 32), np.float32)
    clipped, whole = [], []
    for _ in range(4000):
        parameters = profile.sample(generator)
        noisy = model(dark, parameters=parameters, ratio=1.0, range_dn=range_dn, generator=generator) * range_dn
        clipped.append(np.maximum(noisy, 0).mean())
        whole.append(noisy.mean())
    for stated, drawn in zip(found.groups(), (clipped, whole), strict=True):
        assert float(stated) == pytest.approx(np.mean(drawn), abs=0.05 + 4 * float(np.std(drawn)) / 4000**0.5)
