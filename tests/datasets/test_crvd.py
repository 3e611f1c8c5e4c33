"""CRVD as published: a small tree in its layout, as clips and as pairs, and scored as RViDeNet's code scores it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from eldata import evaluate
from eldata.datasets import CRVDDataset, PairDataset
from eldata.errors import ArgumentError, ManifestError
from eldata.evaluation.score import cut_to_dn
from eldata.manifest import shipped_manifest, verify
from eldata.manifest.catalogue import Manifest, save_manifest
from eldata.protocols import get_protocol
from eldata.records import Sensor
from tests.crvd_tree import build_crvd_tree

SCENES, ISOS = ("scene1", "scene7"), (1600, 25600)


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> tuple[Manifest, Path]:
    """Return a manifest of two scenes at two ISOs, all shots, and the folder that holds their mosaics."""
    folder = tmp_path_factory.mktemp("crvd")
    shipped = shipped_manifest("crvd")
    rows = [row for row in shipped.records if row.scene in SCENES and row.iso in ISOS]
    counts = {role: sum(row.role == role for row in rows) for role in ("noisy", "reference")}
    (first,) = (replace(subset, pairs=14) for subset in shipped.card.subsets if subset.name == "test-first")
    manifest = save_manifest(folder / "crvd.csv", replace(shipped.card, counts=counts, subsets=(first,)), rows)
    build_crvd_tree(manifest, manifest.folder(folder))
    return manifest, folder


def as_published(raw: NDArray[np.uint16]) -> NDArray[np.float64]:
    """Return a mosaic's shares of white in the planes that the code scores, R, G, B, G of GBRG."""
    shares = (raw.astype(np.float64) - 240) / (4095 - 240)
    return np.stack([shares[1::2, 0::2], shares[1::2, 1::2], shares[0::2, 1::2], shares[0::2, 0::2]])


def test_clips_have_a_reference_for_each_frame(tree: tuple[Manifest, Path]) -> None:
    manifest, folder = tree
    root = manifest.folder(folder)
    assert verify([manifest], folder, level="full").problems == ()
    every = CRVDDataset(root, manifest=manifest.path, window=7, clip="none")
    assert len(every) == len(SCENES) * len(ISOS) * 10
    first = CRVDDataset(root, manifest=manifest.path, split="test", shots=[0], window=3, stride=1, clip="none")
    assert len(first) == len(ISOS) * 5
    sample = first[1]  # frames 2 to 4 of scene 7 at the first ISO
    for place, frame in enumerate((2, 3, 4)):
        at = f"scene7/ISO1600/frame{frame}"
        noisy = tifffile.imread(root / f"indoor_raw_noisy/{at}_noisy0.tiff")
        clean = tifffile.imread(root / f"indoor_raw_gt/{at}_clean_and_slightly_denoised.tiff")
        # float32 shares of white: their last place is 2^-24 of numbers below 1
        np.testing.assert_allclose(sample["input"][place], as_published(noisy), rtol=0, atol=2**-23)
        np.testing.assert_allclose(sample["target"][place], as_published(clean), rtol=0, atol=2**-23)
    assert sample["ratio"] == 1
    with pytest.raises(ArgumentError, match="shots"):
        CRVDDataset(root, manifest=manifest.path, shots=[10])
    other = [replace(row, path=row.path.replace("_noisy0", "_dark0")) for row in manifest.records]
    renamed = save_manifest(folder / "renamed.csv", manifest.card, other)
    with pytest.raises(ManifestError, match="frame1_noisy0"):
        CRVDDataset(root, manifest=renamed.path)


@pytest.mark.parametrize("protocol", ["rvidenet-crvd", "florn-crvd"])
def test_scores_are_those_of_the_published_code(protocol: str, tree: tuple[Manifest, Path], tmp_path: Path) -> None:
    """Its steps once more by numpy and scikit-image: mosaics, uint16, PSNR of the mosaic, SSIM plane by plane."""
    manifest, folder = tree
    root = manifest.folder(folder)
    pairs = PairDataset(root, manifest.path, subset="test-first").records
    assert len(pairs) == 14
    expected: dict[str, tuple[float, float]] = {}
    for pair in pairs:
        clean, noisy = (tifffile.imread(root / path) for path in (pair.reference, pair.path))
        generator = np.random.default_rng(len(expected))
        planes = 0.7 * as_published(clean) + 0.3 * as_published(noisy) + generator.normal(0, 1e-3, (4, 20, 28))
        if protocol == "florn-crvd":  # a network's float32; whole DN, of which its code moves none
            planes = (np.rint(planes * 3855) / 3855).astype(np.float32)
        file = (tmp_path / pair.path).with_suffix(".npy")
        file.parent.mkdir(parents=True, exist_ok=True)
        np.save(file, planes)
        saved = np.uint16(np.clip(planes, 0, 1) * (4095 - 240) + 240)
        found = ((saved.astype(np.float32) - 240) / (4095 - 240)).astype(np.float64)
        target = as_published(clean)
        if protocol == "florn-crvd":
            target = np.maximum(target, 0)
        psnr = peak_signal_noise_ratio(target, found, data_range=1.0)  # type: ignore[no-untyped-call]
        ssim = structural_similarity(target, found, data_range=1.0, channel_axis=0)  # type: ignore[no-untyped-call]
        expected[pair.path] = float(psnr), float(ssim)
    options: dict[str, Any] = {"manifest": manifest.path, "root": folder, "protocol": protocol}
    result = evaluate(tmp_path, "crvd", **options)
    assert len(result.scores) == 14
    for score in result.scores:
        np.testing.assert_allclose((score.psnr_db, score.ssim), expected[score.path], rtol=0, atol=1e-6)


def test_no_whole_level_moves_in_florns_float32() -> None:
    """Of all 3,856; in RViDeNet's float64 half of them are cut down by one. Equal to the code's own line to the bit."""
    dn = np.arange(240, 4096, dtype=np.float32).reshape(4, 4, 241)
    shares = (dn - 240) / (2**12 - 1 - 240)
    sensor = Sensor("", "", ((0, 1), (3, 2)), (240.0,) * 4, 4095.0, 8, 482)
    np.testing.assert_array_equal(cut_to_dn(shares, sensor, np.float32), shares)
    published = (np.uint16(shares * (2**12 - 1 - 240) + 240).astype(np.float32) - 240) / (2**12 - 1 - 240)
    np.testing.assert_array_equal(cut_to_dn(shares, sensor, np.float32), published)
    assert np.count_nonzero(cut_to_dn(shares, sensor, np.float64) != shares) == 1939


def test_cutting_down_to_whole_dn_is_for_raw_predictions() -> None:
    with pytest.raises(ArgumentError, match="quantisation"):
        replace(get_protocol("eld-raw2rgb"), quantisation="dn-truncated").check()
    assert get_protocol("rvidenet-crvd").digest != replace(get_protocol("rvidenet-crvd"), quantisation="none").digest
