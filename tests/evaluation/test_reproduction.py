"""A saved result evaluated again: the same numbers, or which ones differ and under what other conditions."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from eldata.cli.main import main
from eldata.errors import ArgumentError
from eldata.evaluation import Task, evaluate, evaluate_all, reproduce
from eldata.manifest import load_manifest
from eldata.manifest.writing import save_manifest
from tests.evaluation.own_set import OwnSet, build_own_set

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

PROTOCOL = """
base = "eld"
name = "mine"
title = "Mine"
region = "border-2"
rescaling = "none"
ssim_window = "gaussian-11"
"""


def largest_gap(prediction: np.ndarray, reference: np.ndarray) -> float:
    """A task of one's own."""
    return float(np.abs(prediction - reference).max())


LARGEST_GAP = Task(largest_gap, label="gap", higher_is_better=False)


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> OwnSet:
    """Two scenes with two pairs each, the last one flagged."""
    own = build_own_set(tmp_path_factory.mktemp("own"), scenes=2)
    manifest = load_manifest(own.manifest)
    *others, last = manifest.records
    assert last.role == "noisy"
    save_manifest(own.manifest, manifest.card, [*others, replace(last, flags=("misaligned",))])
    return own


@pytest.fixture
def preds(own: OwnSet, tmp_path: Path) -> Path:
    """Random predictions of every noisy frame."""
    generator = np.random.default_rng(5)
    for record in load_manifest(own.manifest).records:
        if record.role == "noisy":
            file = (tmp_path / "preds" / record.path).with_suffix(".npy")
            file.parent.mkdir(parents=True, exist_ok=True)
            np.save(file, generator.random((4, 30, 42), dtype=np.float32))
    return tmp_path / "preds"


def saved(own: OwnSet, preds: Path, out: Path, **options: Any) -> Path:
    evaluate(preds, **own.where, **options).write_json(out)
    return out


def changed(path: Path, change: Callable[[dict[str, Any]], None]) -> Path:
    data = json.loads(path.read_text(encoding="utf-8"))
    change(data)
    path.write_text(json.dumps(data), encoding="utf-8")
    return path


@pytest.mark.parametrize("choice", ["plain", "own protocol", "task", "some", "flags"])
def test_the_same_to_the_last_digit(own: OwnSet, preds: Path, tmp_path: Path, choice: str) -> None:
    mine = tmp_path / "mine.toml"
    mine.write_text(PROTOCOL, encoding="utf-8")
    options: dict[str, dict[str, Any]] = {
        "own protocol": {"protocol": mine},
        "task": {"task": f"{__name__}:LARGEST_GAP"},
        "some": {"allow_missing": True},
        "flags": {"exclude_flags": ["misaligned"]},
    }
    if choice == "some":
        next(preds.rglob("*.npy")).unlink()
    path = saved(own, preds, tmp_path / "r.json", **options.get(choice, {}))
    mine.unlink()
    found = reproduce(path, **own.where)
    assert found.same
    assert found.conditions == ()
    assert found.again.protocol.digest == found.saved.digest
    assert [score.values for score in found.again.scores] == [score.values for score in found.saved.scores]
    assert f"every value of {4 - (choice in ('some', 'flags'))} pairs" in found.format_text()


def test_the_input_itself(own: OwnSet, tmp_path: Path) -> None:
    result = evaluate(None, **own.where, baseline="input")
    result.write_json(tmp_path / "r.json")
    assert reproduce(tmp_path / "r.json", **own.where).same
    assert reproduce(result, **own.where).same


def test_one_other_prediction_is_named_and_nothing_else(own: OwnSet, preds: Path, tmp_path: Path) -> None:
    path = saved(own, preds, tmp_path / "r.json")
    file = sorted(preds.rglob("*.npy"))[2]
    pixels = np.load(file)
    pixels[0, 3, 4] = np.nextafter(pixels[0, 3, 4], np.float32(2))
    np.save(file, pixels)
    found = reproduce(path, **own.where)
    name = found.saved.scores[2].name
    assert not found.same
    assert {one.where.rpartition(": ")[0] for one in found.scores} == {name}
    assert found.conditions == ()
    text = found.format_text()
    for words in (f"{name}: psnr_db", "1 of 4 images", "Nothing else that is stated differs", "eldata verify"):
        assert words in text


def test_what_the_numbers_depend_on_is_held_against_it(own: OwnSet, preds: Path, tmp_path: Path) -> None:
    """The digits were kept, but for the last one of one value; versions, and a flag that is gone, are named."""
    path = saved(own, preds, tmp_path / "r.json")
    before = json.loads(path.read_text(encoding="utf-8"))["images"][1]["ssim"]

    def other(data: dict[str, Any]) -> None:
        data["provenance"] |= {"numpy": "1.0.0", "manifest_sha256": "sha256:0"}
        data["images"][1]["ssim"] = float(np.nextafter(before, 2))

    found = reproduce(changed(path, other), **own.where)
    assert [(one.found, one.saved) for one in found.scores] == [(before, float(np.nextafter(before, 2)))]
    assert [(one.where, one.saved) for one in found.conditions] == [
        ("manifest_sha256", "sha256:0"),
        ("numpy", "1.0.0"),
    ]
    assert "numpy" in found.format_text()
    assert json.loads(json.dumps(found.as_dict()))["reproduced"] is False


def test_a_prediction_that_is_gone_is_a_problem(own: OwnSet, preds: Path, tmp_path: Path) -> None:
    path = saved(own, preds, tmp_path / "r.json")
    file = min(preds.rglob("*.npy"))
    file.unlink()
    found = reproduce(path, **own.where)
    assert not found.same
    assert "nothing was scored: 1 problem" in found.format_text()
    assert file.stem in found.format_text()


def test_the_command(own: OwnSet, preds: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of all protocols at once, from predictions that lie elsewhere now."""
    evaluate_all(preds, **own.where).write_json(tmp_path / "r.json")
    elsewhere = preds.rename(tmp_path / "elsewhere")
    command = ["reproduce", str(tmp_path / "r.json"), *own.arguments]
    assert main(command) == 2
    assert "preds" in capsys.readouterr().err
    command += ["--predictions", str(elsewhere), "--json", str(tmp_path / "again.json")]
    assert main(command) == 0
    assert capsys.readouterr().out.count("reproduced to the last digit") > 1
    assert all(one["reproduced"] for one in json.loads((tmp_path / "again.json").read_text())["results"])
    np.save(next(elsewhere.rglob("*.npy")), np.zeros((4, 30, 42), np.float32))
    assert main(command) == 1
    assert "NOT reproduced: 1 of 4 images" in capsys.readouterr().out


def test_what_is_needed_and_not_there_is_named(own: OwnSet, preds: Path, tmp_path: Path) -> None:
    path = saved(own, preds, tmp_path / "r.json")
    with pytest.raises(ArgumentError, match=r"not a set that eldata knows; give its manifest with --manifest"):
        reproduce(path, root=own.root)
    evaluate_all(preds, **own.where).write_json(tmp_path / "all.json")
    with pytest.raises(ArgumentError, match=r"results of several protocols \(raw, .*\)"):
        reproduce(tmp_path / "all.json", **own.where)

    def unknown(data: dict[str, Any]) -> None:
        from eldata.protocols.protocol import StatedProtocol

        data["protocol"]["sharpening"] = "much"
        data["provenance"]["protocol_digest"] = StatedProtocol(result.kind, data["protocol"]).digest

    result = evaluate(None, **own.where, baseline="input")
    with pytest.raises(ArgumentError, match="of another version of eldata, which may have scored otherwise"):
        reproduce(changed(path, unknown), **own.where)
    empty = evaluate(tmp_path, **own.where)
    with pytest.raises(ArgumentError, match="nothing was scored"):
        reproduce(empty, **own.where)
