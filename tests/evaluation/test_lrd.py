"""LRD under its own protocol: against its published arithmetic in plain numpy, and a table without its many factors."""

from __future__ import annotations

import math
import zlib
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import rawpy
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from eldata.evaluation import evaluate, save_prediction
from eldata.evaluation.scores import groups_of
from eldata.manifest.catalogue import shipped_card, shipped_manifest
from eldata.protocols import PROTOCOLS, default_protocol, get_protocol
from tests.lrd_tree import SENSOR, write_frames

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

BIASES = ("test-3ev", "test-2ev", "test-1ev")
ssim_of: Any = structural_similarity  # scikit-image has annotations in part only
psnr_of: Any = peak_signal_noise_ratio


def packed(path: Path, white: float | None) -> NDArray[np.float32]:
    """As ``pack_raw_LRD`` has it, but each plane with the black level of its own colour: R, G1, G2, B, in [0, 1]."""
    with rawpy.imread(str(path)) as raw:
        mosaic = raw.raw_image_visible.astype(np.float32)
        levels = [float(raw.black_level_per_channel[index]) for index in (0, 1, 3, 2)]
        level = float(raw.white_level) if white is None else white
    planes = (mosaic[0::2, 0::2], mosaic[0::2, 1::2], mosaic[1::2, 0::2], mosaic[1::2, 1::2])
    scaled = [(plane - black) / (level - black) for plane, black in zip(planes, levels, strict=True)]
    return np.clip(np.stack(scaled), 0, 1).astype(np.float32)


def plain_scores(prediction: NDArray[np.float32], clean: NDArray[np.float32]) -> tuple[float, float]:
    """As ``tensor2im`` and ``quality_assess`` have it; ``prediction`` in the order of the published code."""
    x, y = (np.clip(np.transpose(image, (1, 2, 0)).astype(np.float64) * 255.0, 0, 255) for image in (prediction, clean))
    return float(psnr_of(y, x, data_range=255)), float(ssim_of(y, x, data_range=255, channel_axis=-1))


@pytest.fixture(scope="module")
def lrd(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, NDArray[np.float32]]]:
    """The test scenes, and predictions of them (R, G1, G2, B) that overshoot and go below 0 in places."""
    root = tmp_path_factory.mktemp("lrd")
    records = [record for record in shipped_manifest("lrd").records if record.split == "test"]
    write_frames(root / "LRD", records)
    predictions = {}
    for record in records:
        if record.reference is None:
            continue
        generator = np.random.default_rng(zlib.crc32(record.path.encode()))
        clean = packed(root / "LRD" / record.reference, None)
        made = (1.1 * clean + generator.normal(-0.01, 0.03, clean.shape)).astype(np.float32)
        predictions[record.path] = made
        save_prediction(root / "preds", record.path, made[[0, 1, 3, 2]])
    return root, predictions


@pytest.mark.parametrize("subset", BIASES)
def test_scores_are_those_of_the_published_arithmetic(
    subset: str, lrd: tuple[Path, dict[str, NDArray[np.float32]]]
) -> None:
    root, predictions = lrd
    result = evaluate(root / "preds", "lrd", root=root, subset=subset)
    assert result.protocol.name == "lrd-lrd"
    assert not result.problems
    assert len(result.images) == 60
    for pair, image in zip(result.pairs, result.images, strict=True):
        psnr_db, ssim = plain_scores(predictions[pair.path], packed(root / "LRD" / pair.reference, None))
        assert image.psnr_db == pytest.approx(psnr_db, abs=1e-6, rel=0)
        assert image.ssim == pytest.approx(ssim, abs=1e-6, rel=0)
        assert image.rescale == 1


def test_the_first_subset_is_the_published_codes_default_and_the_white_level_matters(
    lrd: tuple[Path, dict[str, NDArray[np.float32]]],
) -> None:
    root, predictions = lrd
    result = evaluate(root / "preds", "lrd", root=root)
    assert {pair.path.split("_")[1] for pair in result.pairs} == {"03"}
    assert SENSOR.white_level_dn != 65535
    pair = result.pairs[0]
    with_65535, _ = plain_scores(predictions[pair.path], packed(root / "LRD" / pair.reference, 65535.0))
    assert abs(with_65535 - result.images[0].psnr_db) > 1e-2, "the two levels have to be told apart"


def test_the_input_is_multiplied_by_the_ratio_of_the_names(lrd: tuple[Path, dict[str, NDArray[np.float32]]]) -> None:
    root, _ = lrd
    result = evaluate(None, "lrd", root=root, baseline="input")
    for pair, image in zip(result.pairs[:5], result.images, strict=False):
        clean_s = float(pair.reference.rpartition("_")[2].removesuffix("s.DNG"))
        noisy_s = float(pair.path.rpartition("_")[2].removesuffix("s.DNG"))
        assert pair.iso is not None
        ratio = 100 * clean_s / (float(pair.iso) * noisy_s)
        noisy = np.clip(packed(root / "LRD" / pair.path, None) * np.float32(ratio), 0, 1)
        psnr_db, ssim = plain_scores(noisy, packed(root / "LRD" / pair.reference, None))
        assert image.psnr_db == pytest.approx(psnr_db, abs=1e-4, rel=0)  # float32 of the amplified input
        assert image.ssim == pytest.approx(ssim, abs=1e-5, rel=0)


def test_names_of_the_protocol() -> None:
    assert default_protocol(shipped_card("lrd")) is get_protocol("lrd", "lrd") is PROTOCOLS["lrd-lrd"]
    assert get_protocol("lrd", "eld") is PROTOCOLS["lrd-eld"]
    one, other = PROTOCOLS["lrd-lrd"], PROTOCOLS["lrd-eld"]
    assert (one.rules, one.levels, one.reference_clip) == (other.rules, other.levels, other.reference_clip)


# --- a table of many factors ------------------------------------------------------------------------------------------


def test_factors_that_nearly_every_pair_has_its_own_of_are_no_groups(
    lrd: tuple[Path, dict[str, NDArray[np.float32]]],
) -> None:
    root, _ = lrd
    result = evaluate(root / "preds", "lrd", root=root)
    assert len({pair.ratio for pair in result.pairs}) == 27  # datalist/LRD_test_list.txt, -3EV
    (row,) = result.table
    assert (row.camera, row.ratio, row.pairs) == (None, None, 60)
    mean = math.fsum(image.psnr_db for image in result.images) / 60
    assert row.values["psnr_db"] == pytest.approx(mean, rel=1e-12)


def test_up_to_twelve_factors_are_groups() -> None:
    twelve = [("A", float(ratio)) for ratio in range(1, 13)]
    assert groups_of(twelve) == [*twelve, (None, None)]
    assert groups_of([*twelve, ("A", 13.0)]) == [(None, None)]
    assert groups_of([*twelve, ("B", 13.0)]) == [("A", None), ("B", None), (None, None)]
