"""``measured_shift_px``: what ``capture check --write`` measures, and pairs and scores cut to what both frames show."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from capture.cli.main import main as capture
from eldata import PackedStore, evaluate
from eldata.cli.main import main
from eldata.datasets import PairDataset
from eldata.errors import DatasetError
from eldata.evaluation import save_prediction
from eldata.manifest import load_manifest, save_records
from eldata.manifest.card import CameraCard, Card
from eldata.manifest.writing import save_manifest
from eldata.raw import bayer_cfa, write_dng
from eldata.records import Exposure, FrameRecord, Sensor
from eldata.sources.shards import write_shards
from eldata.sources.store import build_store, source_of_dataset

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

SIZE, OFF = (448, 512), (4, -6)  # down, right
BLACK, WHITE, RATIO = 512, 16383, 4
CROPS = {
    "target": np.s_[:444, 6:],
    "input": np.s_[4:, :506],
}


def mosaics() -> dict[str, NDArray[np.uint16]]:
    """A textured scene, and what a camera sees of it that is turned up and to the right: all lies lower, and left."""
    rows, columns = np.mgrid[: SIZE[0] + 16, : SIZE[1] + 16]
    generator = np.random.default_rng(0)
    light = np.full(rows.shape, 3000.0)
    for _ in range(60):
        angle, period, phase = generator.uniform(0, np.pi), generator.uniform(6, 40), generator.uniform(0, 6)
        light += 150 * np.sin((rows * np.sin(angle) + columns * np.cos(angle)) * 2 * np.pi / period + phase)
    light = np.clip(light, 100, 12000)
    seen = {"clean": light[8:-8, 8:-8], "noisy": light[8 - OFF[0] : -8 - OFF[0], 8 - OFF[1] : -8 - OFF[1]] / RATIO}
    noise = generator.normal(0, 2, SIZE)
    return {name: np.rint(BLACK + light + noise).astype(np.uint16) for name, light in seen.items()}


@pytest.fixture(scope="module")
def manifest(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A set of one pair, as ``capture check --write`` leaves it."""
    folder: Path = tmp_path_factory.mktemp("shifted")
    data, sensor = (
        folder / "data" / "own" / "s",
        Sensor("Maker", "Model", bayer_cfa("GBRG"), (BLACK,) * 4, WHITE, *SIZE),
    )
    data.mkdir(parents=True)
    exposures = {"clean": Exposure(Fraction(100), Fraction(1)), "noisy": Exposure(Fraction(100), Fraction(1, RATIO))}
    rows = []
    for name, mosaic in mosaics().items():
        write_dng(data / f"{name}.dng", mosaic, sensor, exposures[name])
        row = FrameRecord(f"s/{name}.dng", "reference", "Cam", scene="s", iso=Fraction(100))
        rows.append(replace(row, exposure_s=exposures[name].exposure_s))
    rows[1] = replace(rows[1], role="noisy", ratio=Fraction(RATIO), reference="s/clean.dng")
    counts = {"noisy": 1, "reference": 1}
    card = Card("own", "Own", "1", "own", "", "", "", "bayer", {"Cam": CameraCard(("Model",))}, counts)
    save_manifest(folder / "own.csv", card, rows)
    assert capture(["check", str(folder / "own.csv"), "--root", str(folder / "data"), "--write"]) in (0, 1)
    return folder / "own.csv"


def shifted(manifest: Path, folder: Path, down: Fraction, right: Fraction) -> Path:
    (folder / "own.json").write_bytes(manifest.with_suffix(".json").read_bytes())
    rows = load_manifest(manifest).records
    save_records(folder / "own.csv", [replace(r, measured_shift_px=(down, right)) if r.reference else r for r in rows])
    return folder / "own.csv"


def test_pairs_are_cut_to_what_both_frames_show(manifest: Path, tmp_path: Path) -> None:
    (noisy,) = (row for row in load_manifest(manifest).records if row.role == "noisy")
    assert noisy.measured_shift_px is not None
    np.testing.assert_allclose([float(one) for one in noisy.measured_shift_px], OFF, atol=0.1)
    root = manifest.parent / "data"
    build_store(source_of_dataset("own", root=root, manifest=manifest), tmp_path / "own.h5")
    build_store(source_of_dataset("own", root=root, manifest=manifest), tmp_path / "small.h5", compression="zstd")
    datasets: list[Any] = [
        PairDataset(root / "own", manifest),
        *(PackedStore(tmp_path / f"{name}.h5", crop=None, augment=False) for name in ("own", "small")),
    ]
    for dataset in datasets:
        (sample,) = dataset
        for (side, crop), mosaic in zip(CROPS.items(), mosaics().values(), strict=True):
            cut = (mosaic[crop].astype(np.float64) - BLACK) / (WHITE - BLACK) * (1 if side == "target" else RATIO)
            packed = np.stack([cut[1::2, ::2], cut[1::2, 1::2], cut[::2, 1::2], cut[::2, ::2]])
            np.testing.assert_allclose(sample[side].numpy(), packed, atol=1e-6)
    with pytest.raises(DatasetError, match="measured_shift_px"):
        write_shards(tmp_path / "own.h5", tmp_path / "shards", tile=None)


def test_predictions_are_scored_where_both_frames_show_the_same(manifest: Path, tmp_path: Path) -> None:
    root = str(manifest.parent / "data")
    (sample,) = PairDataset(manifest.parent / "data" / "own", manifest)
    error = sample["input"].numpy().astype(np.float64) - sample["target"].numpy()
    expected = -10 * np.log10(np.mean(error**2))
    arguments = ["--manifest", str(manifest), "--root", root]
    assert main(["baseline", "input", *arguments, "-o", str(tmp_path / "preds")]) == 0
    save_prediction(tmp_path / "cut", sample["path"], sample["input"].numpy())  # what a network makes of a sample
    folders: list[dict[str, Any]] = [{"predictions": tmp_path / name} for name in ("preds", "cut")]
    for given in ({"baseline": "input"}, *folders):
        result = evaluate(
            given.pop("predictions", None), manifest=manifest, root=root, protocol="eld-uncorrected", **given
        )
        (score,) = result.scores
        assert score.psnr_db == pytest.approx(expected, abs=1e-3)
    assert main(["evaluate", str(tmp_path / "preds"), *arguments, "--html", str(tmp_path / "page.html")]) == 0


@pytest.mark.parametrize(("down", "right"), [(1, 0), (0, -3), (300, 0)])
def test_what_cannot_be_cut_is_refused_by_name(down: int, right: int, manifest: Path, tmp_path: Path) -> None:
    csv = shifted(manifest, tmp_path, Fraction(down), Fraction(right))
    with pytest.raises(DatasetError, match=r"noisy\.dng: lies .*measured_shift_px"):
        PairDataset(manifest.parent / "data" / "own", csv)[0]
    result = evaluate(None, manifest=csv, root=manifest.parent / "data", baseline="input")
    assert len(result.problems) == 1
    assert "measured_shift_px" in str(result.problems[0])


def test_less_than_half_a_pixel_is_no_shift(manifest: Path, tmp_path: Path) -> None:
    csv = shifted(manifest, tmp_path, Fraction("0.4"), Fraction("-0.3"))
    assert PairDataset(manifest.parent / "data" / "own", csv)[0]["input"].shape == (4, 224, 256)
    store = tmp_path / "own.h5"
    build_store(source_of_dataset("own", root=manifest.parent / "data", manifest=csv), store)
    write_shards(store, tmp_path / "shards", tile=None)
