from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING

import numpy as np
import pytest

from eldata.datasets import ELDDataset
from eldata.demo.camera import CAMERAS
from eldata.demo.tree import make_tree
from eldata.raw.reading import exposure_ratio, read_raw

if TYPE_CHECKING:
    from pathlib import Path

    from eldata.manifest.catalogue import Manifest

SIZE = (64, 96)


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Manifest]:
    folder = tmp_path_factory.mktemp("tree")
    return folder, make_tree(folder, scenes=2, size=SIZE)


def digests(folder: Path) -> dict[str, str]:
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def test_the_same_seed_gives_the_same_bytes(tree: tuple[Path, Manifest], tmp_path: Path) -> None:
    make_tree(tmp_path, scenes=2, size=SIZE)
    assert digests(tmp_path) == digests(tree[0])
    assert len(digests(tmp_path)) == 2 * 2 * 16 + 2


def test_no_two_frames_share_their_noise(tree: tuple[Path, Manifest]) -> None:
    folder = tree[0] / "data" / "ELD-demo" / "DemoAlpha" / "scene-1"
    first, second = (read_raw(folder / f"IMG_{n:04d}.dng").mosaic.astype(float) for n in (1, 6))
    assert abs(np.corrcoef((first - first.mean()).ravel(), (second - second.mean()).ravel())[0, 1]) > 0.9  # one scene
    difference = first - second
    assert 1 < difference.std() < 100


def test_exposures_are_the_manifests_and_ratios_exact(tree: tuple[Path, Manifest]) -> None:
    folder, manifest = tree
    root = folder / "data" / "ELD-demo"
    noisy = [record for record in manifest.records if record.role == "noisy"]
    assert len(noisy) == 2 * 2 * 12
    for record in noisy:
        assert record.reference is not None
        frame, reference = read_raw(root / record.path), read_raw(root / record.reference)
        assert (frame.exposure.iso, frame.exposure.exposure_s) == (record.iso, record.exposure_s)
        assert exposure_ratio(reference, frame) == record.ratio


def test_noisy_frames_have_the_light_that_their_ratio_says(tree: tuple[Path, Manifest]) -> None:
    """On average over the frame, amplified by the ratio, a noisy frame is as bright as its reference."""
    dataset = ELDDataset(
        tree[0] / "data" / "ELD-demo", manifest=tree[1].path, ratios=(1, 10, 100), levels="metadata", clip="none"
    )
    for sample in dataset:
        camera = next(camera for camera in CAMERAS if camera.name == sample["camera"])
        gain = camera.base_gain_dn_per_e * sample["iso"] / 100
        span = camera.sensor.white_level_dn - max(camera.sensor.black_level_dn)
        bias = gain * np.mean(camera.colour_bias_e) / span * sample["ratio"]
        row = gain * camera.sigma_row_e / span * sample["ratio"] / np.sqrt(SIZE[0])
        reference = float(sample["target"].mean())
        assert float(sample["input"].mean()) - bias == pytest.approx(reference, rel=0.03, abs=5 * row)
