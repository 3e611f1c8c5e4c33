"""LPIPS beside the scores of protocols of sRGB: only where it is asked for, of what they compare."""

from __future__ import annotations

import csv
import json
import multiprocessing
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from typing import TYPE_CHECKING

import numpy as np
import pytest
import torch

from eldata.cli.main import main
from eldata.errors import ArgumentError, FileError
from eldata.evaluation import evaluate, evaluate_all, load_results, save_prediction
from eldata.evaluation.comparison import Method, compare
from eldata.evaluation.comparison_tables import format_comparison
from eldata.metrics import LpipsWeights, lpips
from eldata.metrics.lpips import BACKBONE_FILE, LINEAR_FILE
from eldata.reports.compare.page import write_comparison_page
from eldata.reports.evaluation.page import fact_cells, write_evaluation_page
from tests.evaluation import oracle, published_code
from tests.evaluation.own_set import OwnSet, build_own_set
from tests.metrics.seeded_lpips import State, publish, seeded_states, take_as_published

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture(scope="module")
def states() -> tuple[State, State]:
    return seeded_states()


@pytest.fixture
def weights(states: tuple[State, State], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    return publish(tmp_path / "weights", states, monkeypatch)


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> OwnSet:
    """With renderings of its four noisy frames in ``preds`` beside it, and of the same, noisier, in ``other``."""
    folder = tmp_path_factory.mktemp("own")
    own = build_own_set(folder, scenes=2)
    generator = np.random.default_rng(8)
    for name, sigma in (("preds", 6), ("other", 20)):
        for scene in ("s0", "s1"):
            clean = published_code.sid_reference(own.files / scene / "clean.dng").astype(np.float64)
            for ratio in (50, 100):
                noisy = np.clip(clean + generator.normal(0, sigma, clean.shape), 0, 255)
                path = folder / name / scene / f"x{ratio}.npy"
                path.parent.mkdir(parents=True, exist_ok=True)
                np.save(path, noisy / 255)  # not of 256 levels: the protocol rounds
    return own


def test_renderings_have_it_as_they_are_compared(
    own: OwnSet, weights: Path, states: tuple[State, State], tmp_path: Path
) -> None:
    predictions = own.root.parent / "preds"
    without = evaluate(predictions, manifest=own.manifest, root=own.root, protocol="sid2018")
    result = evaluate(predictions, manifest=own.manifest, root=own.root, protocol="sid2018", lpips=weights)
    assert not result.problems
    assert result.digest == without.digest
    assert len(result.images) == 4
    seeded = LpipsWeights.of(*states)
    for image, plainly in zip(result.images, without.images, strict=True):
        codes = np.floor(255 * np.load((predictions / image.path).with_suffix(".npy")) + 0.5)
        clean = published_code.sid_reference(own.files / image.scene / "clean.dng")
        first, second = (pixels.transpose(2, 0, 1).astype(np.float32) / np.float32(255) for pixels in (codes, clean))
        assert image.lpips == lpips(first, second, seeded) > 0
        assert {name: value for name, value in image.values.items() if name != "lpips"} == plainly.values
    assert result.whole.values["lpips"] == pytest.approx(np.mean([image.lpips for image in result.images]), rel=1e-12)

    result.write_csv(tmp_path / "with.csv")
    without.write_csv(tmp_path / "without.csv")
    rows, plain_rows = (
        list(csv.reader((tmp_path / name).read_text().splitlines())) for name in ("with.csv", "without.csv")
    )
    assert rows[0] == [*plain_rows[0], "lpips"]
    assert [row[:-1] for row in rows[1:]] == plain_rows[1:]
    assert [float(row[-1]) for row in rows[1:]] == [image.lpips for image in result.images]
    assert "LPIPS" in result.format("text")
    assert "LPIPS" not in without.format("text")


def test_results_are_read_back_and_say_with_what(own: OwnSet, weights: Path, tmp_path: Path) -> None:
    result = evaluate(
        own.root.parent / "preds", manifest=own.manifest, root=own.root, protocol="sid2018", lpips=weights
    )
    stated = result.provenance["lpips"]
    assert set(stated) == {BACKBONE_FILE.name, LINEAR_FILE.name, "torch"}
    assert stated["torch"].split("+")[0] == torch.__version__.split("+")[0]
    result.write_json(tmp_path / "result.json")
    (back,) = load_results(tmp_path / "result.json")
    assert back.images == result.images
    assert back.table == result.table
    assert back.as_dict() == json.loads((tmp_path / "result.json").read_text()) == result.as_dict()


def test_without_it_nothing_names_it(own: OwnSet, tmp_path: Path) -> None:
    result = evaluate(own.root.parent / "preds", manifest=own.manifest, root=own.root, protocol="sid2018")
    result.write_json(tmp_path / "result.json")
    assert '"lpips"' not in (tmp_path / "result.json").read_text()


def test_raw_predictions_have_it_of_their_renderings(
    weights: Path, states: tuple[State, State], tmp_path: Path
) -> None:
    own = build_own_set(tmp_path / "large", ratios=(100,), size=(1040, 1066))
    target = oracle.reference(own.files / "s0/clean.dng")
    prediction = (1.1 * target + np.random.default_rng(3).normal(0, 0.02, target.shape)).astype(np.float32)
    save_prediction(tmp_path / "preds", "s0/x100.dng", prediction)
    result = evaluate(tmp_path / "preds", manifest=own.manifest, root=own.root, protocol="sid-srgb", lpips=weights)
    first, second, _ = published_code.eld_shown(prediction, target, own.files / "s0/clean.dng")
    expected = lpips(first, second, LpipsWeights.of(*states))
    # A code may differ by one where a value lies on the edge of two: 1/255 in a few of 786,432 values.
    assert result.images[0].lpips == pytest.approx(expected, rel=1e-4)


def test_threads_that_score_side_by_side_change_nothing(own: OwnSet, weights: Path) -> None:
    options = {"manifest": own.manifest, "root": own.root, "protocol": "sid2018", "lpips": weights}
    one = evaluate(own.root.parent / "preds", **options)  # type: ignore[arg-type]
    with ThreadPoolExecutor(2) as pool:
        two = evaluate(own.root.parent / "preds", workers=pool, **options)  # type: ignore[arg-type]
    assert two.images == one.images


def test_processes_that_score_side_by_side_change_nothing(own: OwnSet, weights: Path) -> None:
    options = {"manifest": own.manifest, "root": own.root, "protocol": "sid2018", "lpips": weights}
    one = evaluate(own.root.parent / "preds", **options)  # type: ignore[arg-type]
    spawned = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(2, spawned, initializer=take_as_published, initargs=(weights,)) as pool:
        two = evaluate(own.root.parent / "preds", workers=pool, **options)  # type: ignore[arg-type]
    assert not two.problems
    assert two.images == one.images


def test_methods_are_compared_by_what_all_have(own: OwnSet, weights: Path) -> None:
    def method(name: str, lpips: Path | None) -> Method:
        found = evaluate(own.root.parent / name, manifest=own.manifest, root=own.root, protocol="sid2018", lpips=lpips)
        return Method(name, found)

    first, other = method("preds", weights), method("other", weights)
    both = compare([first, other])
    assert [metric.name for metric in both.kind.metrics] == ["psnr_db", "ssim", "lpips"]
    assert both.whole.gains[0]["lpips"].interval.mean > 0  # of noise; lower is better
    assert not both.warnings
    assert "LPIPS" in format_comparison(both, "text")
    for methods in ([first, method("other", None)], [method("preds", None), other]):
        some = compare(methods)
        assert [metric.name for metric in some.kind.metrics] == ["psnr_db", "ssim"]
        assert not some.warnings


def test_pages_show_it(own: OwnSet, weights: Path, tmp_path: Path) -> None:
    methods = [
        Method(
            name,
            evaluate(own.root.parent / name, manifest=own.manifest, root=own.root, protocol="sid2018", lpips=weights),
        )
        for name in ("preds", "other")
    ]
    result = methods[0].result
    write_evaluation_page(
        [result], tmp_path / "one.html", dataset_folder=own.files, predictions=own.root.parent / "preds"
    )
    page = (tmp_path / "one.html").read_text(encoding="utf-8")
    assert f"{result.images[0].lpips:.4f}" in page
    assert len(fact_cells(result.images[0], result.kind)) == 2
    write_comparison_page(compare(methods), tmp_path / "two.html")
    assert "LPIPS" in (tmp_path / "two.html").read_text(encoding="utf-8")


def test_the_command(own: OwnSet, weights: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    given = ["evaluate", str(own.root.parent / "preds"), "--manifest", str(own.manifest), "--root", str(own.root)]
    given += ["--jobs", "1", "--csv", str(tmp_path / "scores.csv"), "--lpips", str(weights)]
    assert main([*given, "--protocol", "sid2018"]) == 0
    assert "LPIPS" in capsys.readouterr().out
    assert (tmp_path / "scores.csv").read_text().splitlines()[0].endswith(",rescale,lpips")
    assert main([*given, "--protocol", "sid"]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert "LPIPS is defined on sRGB images, and protocol 'sid' scores raw ones" in captured.err


def test_what_it_does_not_go_with_is_refused(own: OwnSet, weights: Path) -> None:
    predictions = own.root.parent / "preds"
    with pytest.raises(
        ArgumentError, match=r"LPIPS is defined on sRGB images, and protocol 'eld' .* sid-srgb, sid2018"
    ):
        evaluate(predictions, manifest=own.manifest, root=own.root, protocol="eld", lpips=weights)
    with pytest.raises(ArgumentError, match="'drv-rgb' scores raw ones"):
        evaluate(predictions, "drv", root=own.root, lpips=weights)
    with pytest.raises(ArgumentError, match="--lpips goes with one protocol of sRGB, not with --protocol all"):
        evaluate_all(predictions, manifest=own.manifest, root=own.root, lpips=weights)
    with pytest.raises(FileError, match=r"nowhere.*7be5be79.pth: cannot be read: No such file"):
        evaluate(predictions, manifest=own.manifest, root=own.root, protocol="sid2018", lpips=weights / "nowhere")


def test_renderings_that_are_too_small_for_it_are_named(weights: Path, tmp_path: Path) -> None:
    own = build_own_set(tmp_path / "small", ratios=(100,), size=(28, 84))
    clean = published_code.sid_reference(own.files / "s0/clean.dng")
    (tmp_path / "preds" / "s0").mkdir(parents=True)
    np.save(tmp_path / "preds" / "s0" / "x100.npy", clean)
    result = evaluate(tmp_path / "preds", manifest=own.manifest, root=own.root, protocol="sid2018", lpips=weights)
    assert not result.images
    (problem,) = result.problems
    assert problem.reason == (
        "protocol sid2018 cannot score it: an image of 28 x 84 pixels is too small: LPIPS needs at least 31 x 31"
    )
