from __future__ import annotations

import json
import shlex
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import eldata.demo.evaluation
from eldata.cli.main import main, parser
from eldata.demo.evaluation import run_demo
from eldata.demo.tree import make_clean, make_tree
from eldata.errors import EldataError
from eldata.evaluation import EvaluationResult
from eldata.examples import train_on_demo
from eldata.examples.train_denoiser import parser as training_parser

SIZE = (64, 96)


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(eldata.demo.evaluation, "make_tree", partial(make_tree, size=SIZE))


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, EvaluationResult]]:
    """A demo of the real size, with one scene."""
    folder = tmp_path_factory.mktemp("demo") / "new" / "folder"
    return folder, run_demo(folder, scenes=1)


def test_the_whole_path_to_better_scores_everywhere(demo: tuple[Path, dict[str, EvaluationResult]]) -> None:
    folder, results = demo
    assert set(results) == {"amplified", "dct", "network"}
    for result in results.values():
        assert not result.problems
        assert len(result.scores) == len(result.units) == 12
    assert len(list((folder / "data").rglob("*.dng"))) == 32
    assert (folder / "manifests" / "eld-demo.csv").is_file()
    assert not list(folder.rglob("*.part"))
    for name in ("dct", "network"):
        for before, after in zip(results["amplified"].table, results[name].table, strict=True):
            assert after.psnr_db > before.psnr_db + 3
            assert after.ssim > before.ssim


@pytest.mark.usefixtures("small")
def test_what_is_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "what's new"
    run_demo(folder, scenes=2)
    out = capsys.readouterr().out
    commands = [shlex.split(line)[1:] for line in out.splitlines() if line.startswith("$ ")]  # to be pasted
    assert [command[1] for command in commands] == ["verify", *["baseline"] * 2, *["evaluate"] * 4, "compare", "demo"]
    for command in commands[:-2]:
        assert parser().parse_args(command[1:]).root == str(folder / "data")
    for words in ("64 raw files", "all well", "eldata verify", "eldata evaluate", "24 of 24", "contact-sheet.png"):
        assert words in out
    assert out.count("note: the files of DemoBeta saturate at 15303 DN") == 1
    with Image.open(folder / "contact-sheet.png") as image:
        assert image.size == (4 * (48 + 16) + 16, 2 * (32 + 26 + 16) + 16)  # with margins, and captions of 26 rows


def test_training_on_the_demo(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two steps: they show the way, which the command makes two minutes long."""
    size = (160, 240)  # whose packed halves hold a crop
    monkeypatch.setattr(eldata.demo.evaluation, "make_tree", partial(make_tree, size=size))
    monkeypatch.setattr(train_on_demo, "make_clean", partial(make_clean, size=size))
    monkeypatch.setattr(train_on_demo, "_SCENES", 2)
    monkeypatch.setattr(train_on_demo, "train_on_demo", partial(train_on_demo.train_on_demo, epochs=1))
    folder = tmp_path / "what's new"
    assert main(["demo", str(folder), "--scenes", "1", "--train"]) == 0
    *_, last = lines = capsys.readouterr().out.splitlines()
    (command,) = [shlex.split(line)[4:] for line in lines if line.startswith("$ python -m eldata.examples.")]
    chosen = training_parser().parse_args(command)
    clean = sorted(path.relative_to(folder).as_posix() for path in Path(*chosen.clean).rglob("*.dng"))
    assert clean == [f"data/clean/Demo{name}/scene-{number}.dng" for name in ("Alpha", "Beta") for number in (2, 3)]
    assert f"epoch 0: step {len(clean) * 4 // 8}," in "\n".join(lines)
    scores = {name: json.loads((folder / f"{name}.json").read_text()) for name in ("amplified", "trained")}
    before, after = (np.mean([image["psnr_db"] for image in found["images"]]) for found in scores.values())
    assert {image["scene"] for image in scores["trained"]["images"]} == {"scene-1"}
    side = "above" if after > before else "below"
    assert last.startswith(
        f"trained: {abs(after - before):.2f} dB {side} the amplified input. Two minutes are too short"
    )
    shown = [shlex.split(line)[1:] for line in lines if line.startswith("$ eldata ") and "trained" in line]
    assert [one[1] for one in shown] == ["predict", "evaluate", "evaluate"]  # as the training has it, and as it is done
    assert shown[1] == shown[2]


@pytest.mark.usefixtures("small")
def test_running_again_after_an_interruption(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C while the raw files are written must not make the demo's own folder a foreign one."""
    with monkeypatch.context() as patch:

        def interrupt(*_: object) -> None:
            raise KeyboardInterrupt

        patch.setattr("eldata.demo.tree.save_manifest", interrupt)
        with pytest.raises(KeyboardInterrupt):
            run_demo(tmp_path / "x", scenes=1)
    assert (tmp_path / "x").exists()
    results = run_demo(tmp_path / "x", scenes=1, beside="dct")  # and another baseline beside the network
    assert list(results) == ["amplified", "dct", "network"]
    assert (tmp_path / "x" / "dct.csv").is_file()


@pytest.mark.usefixtures("small")
@pytest.mark.parametrize("inside", ["notes.txt", "data/notes.txt", ""])
def test_a_foreign_folder_is_refused_and_left_alone(inside: str, tmp_path: Path) -> None:
    """One that holds a file or a folder, or is a file itself."""
    folder = tmp_path / "photos"
    (folder / inside).parent.mkdir(parents=True, exist_ok=True)
    (folder / inside).write_text("mine")
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(EldataError, match="photos"):
        run_demo(folder, scenes=1)
    assert sorted(tmp_path.rglob("*")) == before
