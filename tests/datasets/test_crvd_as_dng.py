"""docs/datasets.md: CRVD's frames as DNG, scored as RViDeNet's code scores."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from PIL import Image
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from eldata.evaluation import evaluate
from eldata.manifest.catalogue import load_manifest, shipped_manifest
from eldata.manifest.verify import verify
from eldata.raw.dng import write_dng
from eldata.raw.reading import read_raw
from eldata.records import Exposure, Sensor

if TYPE_CHECKING:
    from numpy.typing import NDArray

ROOT = Path(__file__).parents[2]
SIZE = (36, 44)
ssim_of: Any = structural_similarity  # scikit-image has annotations in part only
psnr_of: Any = peak_signal_noise_ratio


def block(kind: str, name: str) -> str:
    text = (ROOT / "docs" / "datasets.md").read_text(encoding="utf-8")
    (found,) = re.findall(rf"```{kind} {re.escape(name)}\n(.*?)```", text, re.DOTALL)
    return str(found)


def plain_scores(prediction: NDArray[np.uint16], reference: NDArray[np.uint16]) -> tuple[float, float]:
    """As ``test_indoor.py`` and ``compute_ssim_for_packed_raw`` have it, but in float64."""
    gt, test = ((mosaic.astype(np.float64) - 240) / (2**12 - 1 - 240) for mosaic in (reference, prediction))
    planes = [(slice(1, None, 2), slice(0, None, 2)), (slice(1, None, 2), slice(1, None, 2))]
    planes += [(slice(0, None, 2), slice(1, None, 2)), (slice(0, None, 2), slice(0, None, 2))]
    ssim = sum(float(ssim_of(gt[place], test[place], data_range=1.0)) for place in planes) / 4
    return float(psnr_of(gt, test, data_range=1.0)), ssim


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The test scenes' published names, written by Pillow as the published code writes TIFF, and made DNG."""
    folder = tmp_path_factory.mktemp("crvd")
    generator = np.random.default_rng(7)
    for record in shipped_manifest("crvd").records:
        if record.split == "test" and ("_noisy0" in record.path or record.role == "reference"):
            path = folder / "data" / "CRVD" / record.path
            path.parent.mkdir(parents=True, exist_ok=True)
            mosaic = generator.integers(190, 4096, SIZE).astype(np.uint16)  # some of it below the black level
            Image.fromarray(mosaic).save(path)
    (folder / "crvd_to_dng.py").write_text(block("python", "crvd_to_dng.py"), encoding="utf-8")
    (folder / "crvd.toml").write_text(block("toml", "crvd.toml"), encoding="utf-8")
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    subprocess.run([sys.executable, "-W", "error", "crvd_to_dng.py"], cwd=folder, env=environment, check=True)
    return folder


def test_every_frame_comes_out_with_its_levels(made: Path) -> None:
    manifest = load_manifest(made / "crvd-dng.csv")
    assert len(manifest.records) == 2 * 175
    assert verify([manifest], made / "data", level="quick").ok
    for record in manifest.records[::50]:
        raw = read_raw(made / "data" / "CRVD-DNG" / record.path)
        with Image.open(made / "data" / "CRVD" / record.path.replace(".dng", ".tiff")) as image:
            assert np.array_equal(raw.mosaic, np.asarray(image))
        assert raw.sensor.cfa == ((3, 2), (0, 1))
        assert (set(raw.sensor.black_level_dn), raw.sensor.white_level_dn) == ({240.0}, 4095.0)
        assert raw.exposure.iso == record.iso


def test_scores_are_those_of_the_published_code(made: Path) -> None:
    manifest = load_manifest(made / "crvd-dng.csv")
    files = made / "data" / "CRVD-DNG"
    generator = np.random.default_rng(8)
    sensor = Sensor("", "IMX385", ((3, 2), (0, 1)), (240.0,) * 4, 4095.0, *SIZE)
    expected = {}
    for record in manifest.records:
        if record.reference is not None:
            reference = read_raw(files / record.reference).mosaic
            made_dn = np.clip(reference + generator.normal(0, 60, SIZE), 240, 4095).astype(np.uint16)
            expected[record.path] = plain_scores(made_dn, reference)
            path = made / "preds" / record.path
            path.parent.mkdir(parents=True, exist_ok=True)
            write_dng(path, made_dn, sensor, Exposure(record.iso))
    result = evaluate(made / "preds", manifest=made / "crvd-dng.csv", root=made / "data", protocol=made / "crvd.toml")
    assert not result.problems
    assert len(result.images) == 175
    for pair, image in zip(result.pairs, result.images, strict=True):
        psnr_db, ssim = expected[pair.path]
        assert image.psnr_db == pytest.approx(psnr_db, abs=1e-6, rel=0)
        assert image.ssim == pytest.approx(ssim, abs=1e-6, rel=0)
    (row,) = [row for row in result.table if row.ratio is None]
    assert row.values["psnr_db"] == pytest.approx(np.mean([psnr for psnr, _ in expected.values()]), abs=1e-6)
