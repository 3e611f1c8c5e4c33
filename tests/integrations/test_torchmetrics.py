"""The metrics as torchmetrics modules: the numbers of ``eldata evaluate``, in any batches, over any processes."""

from __future__ import annotations

import json
import math
import shutil
import sys
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch.multiprocessing.spawn import spawn

from eldata import metrics
from eldata.datasets import ELDDataset
from eldata.errors import ArgumentError, EldataError
from eldata.evaluation import evaluate
from eldata.protocols import PROTOCOLS
from eldata.raw import read_raw, write_dng
from eldata.sources.frames import Files
from tests.cases import in_one_test
from tests.evaluation import oracle
from tests.evaluation.helpers import Tree, place

pytest.importorskip("torchmetrics", reason="needs eldata[torchmetrics]")

from collections.abc import Callable

import torchmetrics

from eldata.integrations.torchmetrics import PSNR, SSIM, ProtocolScore

MODULES = [PSNR, SSIM, ProtocolScore]


def images(count: int, size: tuple[int, int] = (24, 20), seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    """Predictions and references (count, 4, h, w), of errors that differ from image to image."""
    generator = torch.Generator().manual_seed(seed)
    target = torch.rand((count, 4, *size), generator=generator)
    spread = torch.linspace(0.01, 0.2, count)[:, None, None, None]
    return (0.9 * target + spread * torch.randn(target.shape, generator=generator)), target


def numbers(value: Any) -> dict[str, float]:
    """What ``compute`` gave, as floats."""
    return {name: float(one) for name, one in (value if isinstance(value, dict) else {"value": value}).items()}


# --- the numbers --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def tree(demo_tree: Path) -> Tree:
    return Tree(demo_tree)


@pytest.fixture(scope="module")
def placed(tree: Tree, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    folder = tmp_path_factory.mktemp("predictions") / "preds"
    return folder, place(folder, tree)


@pytest.mark.parametrize("protocol", ["eld", "eld-uncorrected", "led-eld", "pmn-eld"])
def test_the_numbers_are_those_of_evaluate(tree: Tree, placed: tuple[Path, dict[str, Any]], protocol: str) -> None:
    """To the last bit, by camera and factor as in the table."""
    rules = PROTOCOLS[protocol]
    folder, predictions = placed
    result = evaluate(folder, manifest=tree.manifest, root=tree.root, protocol=protocol)
    assert result.scored == 12
    groups = {(row.camera, row.ratio): row for row in result.table if row.camera and row.ratio}
    assert len(groups) == 4
    for (camera, ratio), row in groups.items():
        metric = ProtocolScore(protocol)
        members = [pair for pair in oracle.pairs(tree.files) if (pair.camera, pair.factor) == (camera, ratio)]
        frames = [
            Files(tree.files).frame(pair.reference).with_levels(rules.levels).normalise(rules.reference_clip)
            for pair in members
        ]
        metric.update(
            torch.from_numpy(np.stack([predictions[pair.path] for pair in members])), torch.from_numpy(np.stack(frames))
        )
        assert numbers(metric.compute()) == {"psnr_db": row.psnr_db, "ssim": row.ssim}


@pytest.mark.parametrize("clip", ["upper", "none"])
def test_the_score_is_that_of_evaluate_whatever_the_clip_of_the_input(
    clip: Any, tree: Tree, placed: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    """References of which a quarter lies below black, of a dataset and as an array that keeps them."""
    folder, predictions = placed
    dark = Tree(Path(shutil.copytree(tree.folder, tmp_path / "dark")))
    for path in {pair.reference for pair in oracle.pairs(dark.files)}:
        raw = read_raw(dark.files / path)
        raw.mosaic[: raw.mosaic.shape[0] // 4] = min(raw.sensor.black_level_dn) - 150
        write_dng(dark.files / path, raw.mosaic, raw.sensor, raw.exposure)
    result = evaluate(folder, manifest=dark.manifest, root=dark.root)
    of_dataset, of_arrays = ProtocolScore("eld"), ProtocolScore("eld")
    for sample in ELDDataset(dark.files, manifest=dark.manifest, clip=clip, ratios=[100, 200]):
        prediction = torch.from_numpy(predictions[sample["path"]])
        kept = Files(dark.files).frame(sample["reference"]).with_levels("published").normalise(clip)
        assert np.mean(kept < 0) == pytest.approx(0.25)
        of_dataset.update(prediction, sample["target"])
        of_arrays.update(prediction, torch.from_numpy(kept))
    for metric in (of_dataset, of_arrays):
        found = numbers(metric.compute())
        assert found == pytest.approx({"psnr_db": result.psnr_db, "ssim": result.ssim}, rel=0, abs=1e-9)


@pytest.mark.parametrize(("module", "function"), [(PSNR, metrics.psnr), (SSIM, metrics.ssim)])
@pytest.mark.parametrize("data_range", [1.0, 4.0])
def test_the_mean_is_that_of_the_functions(module: Any, function: Callable[..., float], data_range: float) -> None:
    preds, target = images(5)
    metric = module(data_range=data_range)
    metric.update(preds, target)
    pairs = zip(preds.numpy(), target.numpy(), strict=True)
    expected = math.fsum(function(*pair, data_range=data_range) for pair in pairs) / 5
    assert metric.compute().dtype == torch.float64
    assert float(metric.compute()) == expected


# --- batches ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("module", MODULES)
def test_batches_and_order_change_nothing(module: Any) -> None:
    preds, target = images(7)
    whole = module()
    whole.update(preds, target)
    expected = numbers(whole.compute())
    for parts in ([[0, 1, 2], [3, 4, 5, 6]], [[6], [2], [4, 0, 1, 5, 3]], [[3, 2, 1, 0, 6, 5, 4]]):
        other = module()
        for part in parts:
            other.update(preds[part], target[part])
        assert numbers(other.compute()) == expected


@pytest.mark.parametrize("module", [*MODULES, pytest.param(partial(ProtocolScore, "led-eld"), id="led-eld")])
def test_one_image_without_a_batch(module: Any) -> None:
    preds, target = images(1)
    batched, single, plane = module(), module(), module()
    batched.update(preds, target)
    single.update(preds[0], target[0])
    assert numbers(single.compute()) == numbers(batched.compute())
    plane.update(preds[0, 0], target[0, 0])
    assert all(math.isfinite(value) for value in numbers(plane.compute()).values())


# --- what a torchmetrics module does ------------------------------------------------------------------------------


def test_a_collection_keeps_protocols_apart() -> None:
    """After a perfect first batch the scores of both are equal; torchmetrics would go on with one for both."""
    preds, target = images(3)
    names = ["eld", "eld-uncorrected"]
    collection = torchmetrics.MetricCollection({name: ProtocolScore(name) for name in names})
    alone = {name: ProtocolScore(name) for name in names}
    for prediction, reference in ((target[:1], target[:1]), (preds[1:], target[1:])):
        collection.update(prediction, reference)
        for metric in alone.values():
            metric.update(prediction, reference)
    found = collection.compute()
    for name in names:
        assert float(found[f"{name}_ssim"]) == numbers(alone[name].compute())["ssim"]
    assert float(found["eld_ssim"]) != float(found["eld-uncorrected_ssim"])


@pytest.mark.parametrize("module", MODULES)
def test_nothing_seen_is_nan(module: Any) -> None:
    """As ``evaluate`` prints no number for no image; torchmetrics warns of it."""
    with pytest.warns(UserWarning, match="before the ``update`` method"):
        found = numbers(module().compute())
    assert all(math.isnan(value) for value in found.values())


def test_infinite_scores() -> None:
    preds, target = images(2)
    metric = PSNR()
    metric.update(target, target)
    metric.update(preds, target)
    assert float(metric.compute()) == math.inf
    metric.update(torch.full_like(target, math.inf), target)
    assert math.isnan(float(metric.compute()))


# --- processes ----------------------------------------------------------------------------------------------------


def score_parts(rank: int, folder: str, cases: dict[str, list[list[list[int]]]]) -> None:
    """Score one of two processes' batches of each case, and write down what it finds."""
    torch.distributed.init_process_group("gloo", init_method=f"file://{folder}/meeting", rank=rank, world_size=2)
    preds, target = images(6)
    found = {}
    for case, batches in cases.items():
        for module in MODULES:
            metric = module()
            for batch in batches[rank]:
                metric.update(preds[batch], target[batch])
            metric._update_count = max(metric._update_count, 1)  # no warning of a process without images
            for _ in range(2):  # after the first the states are this process's own again
                value = metric.compute()
                metric._computed = None
            kept = sum(part.numel() for part in getattr(metric, metric.columns[0]))
            found[f"{case} {module.__name__}"] = {**numbers(value), "kept": kept}
    Path(folder, f"{rank}.json").write_text(json.dumps(found), encoding="utf-8")
    torch.distributed.destroy_process_group()


@pytest.mark.study
def test_two_processes_with_uneven_batches(tmp_path: Path) -> None:
    """A real group: its number is that of one process that saw all images, also where one process saw none."""
    preds, target = images(6)
    cases = {
        "uneven": [[[0, 1, 2], [3]], [[4, 5]]],
        "one image each way": [[[5]], [[0, 1], [2], [3, 4]]],
        "none here": [[[0, 1, 2, 3, 4, 5]], []],
        "none first": [[], [[0], [1, 2, 3, 4, 5]]],
    }
    spawn(score_parts, (str(tmp_path), cases), nprocs=2)  # type: ignore[no-untyped-call]
    found = [json.loads((tmp_path / f"{rank}.json").read_text()) for rank in range(2)]
    for module in MODULES:
        alone = module()
        alone.update(preds, target)
        for case, batches in cases.items():
            for rank in range(2):
                answer = found[rank][f"{case} {module.__name__}"]
                assert answer.pop("kept") == sum(map(len, batches[rank])), "states are the process's own again"
                assert answer == numbers(alone.compute()), case


# --- bad input ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("module", MODULES)
@pytest.mark.parametrize(
    ("preds", "target", "reason"),
    [
        (torch.zeros(2, 4, 8, 8), torch.zeros(3, 4, 8, 8), r"differ in shape: \(2, 4, 8, 8\) against \(3, 4, 8, 8\)"),
        (torch.zeros(1, 1, 4, 8, 8), torch.zeros(1, 1, 4, 8, 8), r"found shape \(1, 1, 4, 8, 8\)"),
        (torch.zeros(8), torch.zeros(8), r"found shape \(8,\)"),
        (torch.zeros(4, 8, 8, dtype=torch.uint8), torch.zeros(4, 8, 8), "holds integers"),
        (np.zeros((4, 8, 8), np.float32), torch.zeros(4, 8, 8), "preds must be a torch tensor, not ndarray"),
        (torch.zeros(4, 8, 8), [0.0], "target must be a torch tensor, not list"),
    ],
)
def test_bad_input_is_refused_and_nothing_added(module: Any, preds: Any, target: Any, reason: str) -> None:
    metric = module()
    with pytest.raises(ArgumentError, match=reason):
        metric.update(preds, target)
    assert all(getattr(metric, column) == [] for column in metric.columns)


def test_a_batch_with_one_bad_image_adds_none_of_it() -> None:
    preds, target = images(2, size=(6, 6))
    metric = SSIM()
    with pytest.raises(ArgumentError, match="too small"):
        metric.update(preds, target)
    assert metric.ssim == []


@in_one_test(
    "module, arguments, reason",
    [
        (PSNR, {"data_range": 0.0}, "data_range must be positive"),
        (SSIM, {"data_range": math.inf}, "data_range must be positive"),
        (ProtocolScore, {"threads": 0}, "threads must be at least 1"),
        (ProtocolScore, {"protocol": "elf"}, "no protocol is called 'elf'"),
        (ProtocolScore, {"protocol": "sid2018"}, "protocol 'sid2018' is of renderings"),
        (ProtocolScore, {"protocol": "drv-raw"}, "protocol 'drv-raw' is of clips"),
    ],
)
def test_bad_arguments(module: Any, arguments: dict[str, Any], reason: str) -> None:
    with pytest.raises(ArgumentError, match=reason):
        module(**arguments)


# --- without torchmetrics -----------------------------------------------------------------------------------------


def test_without_torchmetrics_the_error_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "torchmetrics", None)  # what an import of a package that is not installed meets
    monkeypatch.delitem(sys.modules, "eldata.integrations.torchmetrics")
    with pytest.raises(EldataError, match=r"^[^\n]+pip install 'eldata\[torchmetrics\]'[^\n]+$") as caught:
        import_module("eldata.integrations.torchmetrics")
    assert isinstance(caught.value, ImportError)
