"""The whole protocol against an independent re-computation (:mod:`tests.evaluation.oracle`)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from eldata.evaluation import evaluate
from tests.evaluation import oracle
from tests.evaluation.helpers import Tree, place, small_tree, spread

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

SCENES = 3
PSNR_TOLERANCE_DB = 1e-6
SSIM_TOLERANCE = 1e-7


@pytest.fixture(scope="module")
def saturated_tree(tmp_path_factory: pytest.TempPathFactory) -> Tree:
    """Several scenes whose references have areas at the published white level and below black, each elsewhere."""
    tree = small_tree(tmp_path_factory.mktemp("oracle") / "demo", scenes=SCENES)
    for path in sorted(tree.files.glob("*/*/IMG_*.dng")):
        number = oracle.frame_number(path)
        if number in oracle.REFERENCE_NUMBERS:
            spread(path, slice(2 * number, 2 * number + 9), slice(40, 61))
    return tree


@pytest.fixture(scope="module")
def written(
    saturated_tree: Tree, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, dict[str, NDArray[np.float32]]]:
    folder = tmp_path_factory.mktemp("predictions")
    return folder, place(folder, saturated_tree)


def expected_scores(
    tree: Tree, predictions: dict[str, NDArray[np.float32]], *, corrected: bool
) -> dict[str, oracle.Score]:
    return {
        pair.path: oracle.score(
            predictions[pair.path], oracle.reference(tree.files / pair.reference), corrected=corrected
        )
        for pair in tree.pairs
    }


def test_the_tree_has_what_the_comparison_must_cover(
    saturated_tree: Tree, written: tuple[Path, dict[str, NDArray[np.float32]]]
) -> None:
    frames = {
        camera: oracle.decode(saturated_tree.files / f"{camera}/scene-1/IMG_0001.dng")
        for camera in ("DemoAlpha", "DemoBeta")
    }
    assert not np.array_equal(frames["DemoAlpha"].pattern, frames["DemoBeta"].pattern)
    assert len(set(frames["DemoBeta"].black)) > 1
    for pair in saturated_tree.pairs:
        target = oracle.reference(saturated_tree.files / pair.reference)
        prediction = written[1][pair.path]
        assert 0.001 < np.mean(target == 1) < 0.2
        assert target.min() == 0
        assert np.any(prediction == 1)
        assert prediction.max() > 1
        assert prediction.min() < 0


@pytest.mark.parametrize(("protocol", "corrected"), [("eld", True), ("eld-uncorrected", False)])
def test_scores_and_table_equal_the_independent_computation(
    saturated_tree: Tree, written: tuple[Path, dict[str, NDArray[np.float32]]], protocol: str, *, corrected: bool
) -> None:
    folder, predictions = written
    expected = expected_scores(saturated_tree, predictions, corrected=corrected)
    pairs = {pair.path: pair for pair in saturated_tree.pairs}
    assert len(pairs) == 2 * SCENES * 3 * 2  # cameras, scenes, ISOs, factors

    result = evaluate(folder, protocol=protocol, manifest=saturated_tree.manifest, root=saturated_tree.root)

    assert not result.problems
    assert [image.path for image in result.images] == sorted(pairs)
    for image in result.images:
        pair, other = pairs[image.path], expected[image.path]
        assert (image.camera, image.scene, image.iso, image.ratio) == (pair.camera, pair.scene, pair.iso, pair.factor)
        assert image.psnr_db == pytest.approx(other.psnr_db, abs=PSNR_TOLERANCE_DB, rel=0)
        assert image.ssim == pytest.approx(other.ssim, abs=SSIM_TOLERANCE, rel=0)
        assert image.rescale == pytest.approx(other.alpha, abs=1e-6, rel=0)
    assert {pair.path: pair.reference for pair in result.pairs} == {p.path: p.reference for p in pairs.values()}

    cameras = ("DemoAlpha", "DemoBeta")
    groups: list[tuple[str | None, int | None]] = [(camera, factor) for camera in cameras for factor in (100, 200)]
    groups += [(None, 100), (None, 200), (None, None)]
    assert [(row.camera, row.ratio) for row in result.table] == groups
    for row in result.table:
        members = [
            expected[path]
            for path, pair in pairs.items()
            if row.camera in (None, pair.camera) and row.ratio in (None, pair.factor)
        ]
        psnr_db, ssim = oracle.mean(members)
        assert row.pairs == row.scored == len(members)
        assert row.psnr_db == pytest.approx(psnr_db, abs=PSNR_TOLERANCE_DB, rel=0)
        assert row.ssim == pytest.approx(ssim, abs=SSIM_TOLERANCE, rel=0)


def test_the_two_protocols_differ_by_the_factor_alone(
    saturated_tree: Tree, written: tuple[Path, dict[str, NDArray[np.float32]]]
) -> None:
    """And the factor matters here, so that the comparison above could tell them apart."""
    folder, _ = written
    corrected, plain = (
        evaluate(folder, protocol=name, manifest=saturated_tree.manifest, root=saturated_tree.root)
        for name in ("eld", "eld-uncorrected")
    )
    for first, second in zip(corrected.images, plain.images, strict=True):
        assert second.rescale == 1.0
        assert first.rescale < 0.97
        assert abs(first.psnr_db - second.psnr_db) > 0.1


def test_every_reference_of_a_scene_gives_another_score(
    saturated_tree: Tree, written: tuple[Path, dict[str, NDArray[np.float32]]]
) -> None:
    """A wrong choice of reference cannot hide within the tolerance of the comparison above."""
    pair = saturated_tree.pairs[0]
    scores = [
        oracle.score(
            written[1][pair.path],
            oracle.reference((saturated_tree.files / pair.path).with_name(f"IMG_{number:04d}.dng")),
            corrected=True,
        ).psnr_db
        for number in oracle.REFERENCE_NUMBERS
    ]
    assert np.diff(sorted(scores)).min() > 1e-3
