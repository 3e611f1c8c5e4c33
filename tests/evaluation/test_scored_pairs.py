"""What the score is taken of, pair by pair: measured again, it gives the score to the last digit."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from eldata.errors import ArgumentError, EldataError, PredictionError
from eldata.evaluation import evaluate, save_prediction, scored_pairs
from eldata.metrics import psnr, ssim
from eldata.metrics.registry import IMAGES
from eldata.protocols import PROTOCOLS, Protocol
from eldata.records import PairRecord
from tests.drv_tree import SmallDrv, still_of
from tests.evaluation.own_set import OwnSet, predict


def measured(prediction: NDArray[Any], reference: NDArray[Any], protocol: Protocol) -> tuple[float, float]:
    """PSNR and SSIM by their public functions, as a protocol defines them."""
    how: dict[str, Any] = {"window": protocol.ssim_window, "covariance": protocol.ssim_covariance}
    if protocol.mse_offset:
        error = math.fsum(np.square(prediction - reference).ravel()) / reference.size + protocol.mse_offset
        return -10 * math.log10(error), ssim(prediction, reference, **how)
    return psnr(prediction, reference), ssim(prediction, reference, **how)


OF_RAW = [name for name, one in PROTOCOLS.items() if one.kind is IMAGES and one.region[:6] != "centre"]
OF_RAW = [name for name in OF_RAW if PROTOCOLS[name].space == "raw"]


@pytest.mark.parametrize("baseline", [None, "input"])
@pytest.mark.parametrize("name", OF_RAW)
def test_what_is_measured_of_raw_values_is_the_score_to_the_last_digit(name: str, baseline: Any, own: OwnSet) -> None:
    protocol = PROTOCOLS[name]
    predictions = None if baseline else own.predictions
    result = evaluate(predictions, **own.where, protocol=name, baseline=baseline)
    pairs = list(scored_pairs(predictions, **own.where, protocol=name, baseline=baseline))
    assert [record for _, _, record in pairs] == list(result.units)
    assert len(pairs) == 4
    chooses = protocol.ratios or protocol.cameras or protocol.scenes or protocol.subset
    assert bool(result.provenance["set_aside"]) == bool(chooses)  # the set's own pairs are scored
    for (prediction, reference, record), image in zip(pairs, result.scores, strict=True):
        assert isinstance(record, PairRecord)
        assert prediction.dtype == reference.dtype == np.float64
        assert prediction.shape == reference.shape
        assert len(reference) == (1 if protocol.ssim_planes == "mosaic" else 4)
        found_db, similarity = measured(prediction, reference, protocol)
        assert similarity == image.ssim
        assert found_db == pytest.approx(image.psnr_db, abs=1e-12) if protocol.mse_offset else found_db == image.psnr_db


def codes(image: NDArray[Any]) -> NDArray[np.float32]:
    """The levels of an image of 256, exactly."""
    assert image.dtype == np.float32
    found: NDArray[np.float32] = np.rint(255 * image)
    np.testing.assert_array_equal((found / np.float32(255)).astype(np.float32), image)
    return found


@pytest.mark.parametrize(
    ("name", "shape"), [("eld-srgb", None), ("sid2018", (3, 60, 84)), ("eld-raw2rgb", (3, 30, 42))]
)
def test_renderings_have_256_levels(name: str, shape: tuple[int, ...] | None, own: OwnSet, tmp_path: Path) -> None:
    """Those that a network made are as they are."""
    folder, protocol = own.predictions, PROTOCOLS[name]
    if shape is not None:
        folder = tmp_path
        for number, path in enumerate(sorted(own.files.glob("*/x*.dng"))):
            made = np.random.default_rng(number).uniform(-0.1, 1.1, shape).astype(np.float32)
            save_prediction(folder, path.relative_to(own.files).as_posix(), made)
    result = evaluate(folder, **own.where, protocol=name)
    pairs = scored_pairs(folder, **own.where, protocol=name)
    for (prediction, reference, _), image in zip(pairs, result.scores, strict=True):
        assert reference.shape[0] == 3
        if name == "eld-raw2rgb":
            assert measured(prediction, reference, protocol) == (image.psnr_db, image.ssim)
            continue
        first, second = codes(prediction), codes(reference)
        how: dict[str, Any] = {"window": protocol.ssim_window, "covariance": protocol.ssim_covariance}
        assert ssim(first, second, data_range=255.0, **how) == image.ssim
        assert psnr(first, second, data_range=255.0) == pytest.approx(image.psnr_db, abs=1e-12)


def test_frames_of_a_clip_come_together(drv: SmallDrv) -> None:
    """As what is said of two frames, such as optical flow, needs them."""
    given: dict[str, Any] = {"manifest": drv.csv, "root": drv.root, "ids": ["0007", "0013"]}
    result = evaluate(drv.root / "preds", **given)
    pairs = list(scored_pairs(drv.root / "preds", **given))
    assert [record.scene for _, _, record in pairs] == ["0007", "0013"]
    for (prediction, reference, record), video in zip(pairs, result.scores, strict=True):
        still = (still_of(record.scene).transpose(2, 0, 1) / 65535).astype(np.float32)
        assert prediction.shape == reference.shape == (5, *still.shape)
        np.testing.assert_array_equal(reference, np.broadcast_to(still, reference.shape))
        found = [psnr(*images) for images in zip(prediction, reference, strict=True)]
        assert found == [frame.psnr_db for frame in video.frames]


def test_files_are_read_as_they_are_asked_for(own: OwnSet, tmp_path: Path) -> None:
    predict(own, tmp_path, 0.01)
    np.save(tmp_path / "s1" / "x50.npy", np.zeros((1, 2, 3), np.float32))
    pairs = scored_pairs(tmp_path, **own.where)
    assert [next(pairs)[2].path for _ in range(3)] == ["s0/x100.dng", "s0/x50.dng", "s1/x100.dng"]
    with pytest.raises(PredictionError, match=r"expected shape \(4, 30, 42\)"):
        next(pairs)


def test_what_is_missing_is_said_before_anything_is_read(own: OwnSet, tmp_path: Path) -> None:
    predict(own, tmp_path, 0.01)
    (tmp_path / "s0" / "x50.npy").unlink()
    (tmp_path / "s1" / "x50.npy").unlink()
    with pytest.raises(EldataError, match=r"s0/x50.dng: has no prediction.* \(and 1 more: eldata evaluate lists all"):
        scored_pairs(tmp_path, **own.where)
    (tmp_path / "s0" / "other.npy").write_bytes(b"")  # of no frame
    found = scored_pairs(tmp_path, **own.where, allow_missing=True)
    assert [record.path for _, _, record in found] == ["s0/x100.dng", "s1/x100.dng"]
    with pytest.raises(ArgumentError, match="a folder of predictions or a baseline"):
        scored_pairs(None, **own.where)
