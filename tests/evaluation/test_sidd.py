"""SIDD from files in MATLAB's format: pixels and scores against h5py, numpy and scikit-image alone."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np
import pytest
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from eldata import evaluate
from eldata.datasets import SIDDDataset
from eldata.manifest.catalogue import shipped_manifest
from eldata.manifest.verify import verify
from eldata.protocols import get_protocol
from tests.sidd_tree import SHAPE, build_sidd_tree, write_corrected

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Row and column of R, and of B, in the first 2 x 2 sites of arrays as MATLAB shows them.
RED_AND_BLUE = {
    "GP": ((1, 1), (0, 0)),
    "IP": ((0, 0), (1, 1)),
    "S6": ((0, 1), (1, 0)),
    "N6": ((1, 1), (0, 0)),
    "G4": ((1, 1), (0, 0)),
}
ssim_of: Any = structural_similarity  # scikit-image has annotations in part only
psnr_of: Any = peak_signal_noise_ratio


def by_h5py(path: Path) -> NDArray[np.float32]:
    """As published code reads a file: columns first."""
    with h5py.File(path) as file:
        return np.array(file["x"], np.float32)


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root: Path = tmp_path_factory.mktemp("data")
    build_sidd_tree(shipped_manifest("sidd"), root / "SIDD")
    return root


def test_files_verify(root: Path) -> None:
    manifest = shipped_manifest("sidd")
    assert len(manifest.records) == 640
    assert verify([manifest], root, level="full").problems == ()


@pytest.mark.parametrize("phone", RED_AND_BLUE)
def test_pixels_are_those_of_matlabs_array(phone: str, root: Path) -> None:
    dataset = SIDDDataset(root / "SIDD")
    assert len(dataset) == 320
    index = next(index for index, pair in enumerate(dataset.records) if f"_{phone}_" in pair.path)
    (red, red_column), (blue, blue_column) = RED_AND_BLUE[phone]
    for side, name in (("input", dataset.records[index].path), ("target", dataset.records[index].reference)):
        mosaic = by_h5py(root / "SIDD" / name).T
        assert mosaic.shape == SHAPE
        starts = ((red, red_column), (red, blue_column), (blue, blue_column), (blue, red_column))
        expected = np.stack([mosaic[row::2, column::2] for row, column in starts])
        np.testing.assert_array_equal(dataset[index][side], expected)  # type: ignore[literal-required]
    assert dataset[index]["ratio"] == 1


@pytest.mark.parametrize("phone", ["s6", "gp", "ip"])
def test_scores_are_those_of_sfrns_arithmetic(phone: str, root: Path) -> None:
    """PSNR is of the whole mosaic, as SFRN has it, and SSIM, which it has not, of each packed channel."""
    result = evaluate(None, "sidd", root=root, subset=f"sfrn-{phone}", baseline="input")
    assert result.protocol.name == "sfrn-sidd"
    folders = (root / "SIDD" / "SIDD_Medium_Raw" / "Data").iterdir()
    named = [(folder, folder.name.lower().split("_")) for folder in folders]
    tested = [folder for folder, words in named if phone == words[2] and int(words[1]) in (2, 3, 5)]
    expected = {}
    for folder in tested:
        for tail in ("010", "011"):
            name = f"{folder.name[:4]}_NOISY_RAW_{tail}.MAT"
            noisy, clean = by_h5py(folder / name), by_h5py(folder / name.replace("NOISY", "GT"))
            noisy = noisy.clip(0, 1)
            places = [(slice(row, None, 2), slice(column, None, 2)) for row in (0, 1) for column in (0, 1)]
            ssim = np.mean([ssim_of(clean[place], noisy[place], data_range=1) for place in places])
            expected[name] = psnr_of(clean, noisy, data_range=1), ssim
    assert len(result.images) == len(expected)
    for pair, image in zip(result.pairs, result.images, strict=True):
        psnr_db, ssim = expected[pair.path.rpartition("/")[2]]
        assert image.psnr_db == pytest.approx(psnr_db, abs=1e-6, rel=0)
        assert image.ssim == pytest.approx(ssim, abs=1e-6, rel=0)


def test_sidd_cc_is_scored_by_the_manifest_of_the_document(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two files, which the document's block writes; references keep their negatives where the protocol clips none."""
    page = (Path(__file__).parents[2] / "docs" / "datasets.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"```python\n(\"\"\"The manifest of a copy of SIDD-CC.*?)```", page, re.DOTALL)
    monkeypatch.chdir(tmp_path)
    records = [one for one in shipped_manifest("sidd").records if one.path.split("/")[2][:4] in ("0001", "0200")]
    write_corrected(tmp_path / "data" / "SIDD-CC", records)
    exec(compile(block, "datasets.md", "exec"), {})  # noqa: S102 # our own text
    assert verify(tmp_path / "my-sidd-cc.csv", tmp_path / "data", level="full").problems == ()
    unclipped = replace(get_protocol("sfrn-sidd"), reference_clip="none")
    result = evaluate(
        None, manifest=tmp_path / "my-sidd-cc.csv", root=tmp_path / "data", baseline="input", protocol=unclipped
    )
    assert len(result.images) == 4
    for pair, image in zip(result.pairs, result.images, strict=True):
        noisy, clean = (by_h5py(tmp_path / "data" / "SIDD-CC" / path) for path in (pair.path, pair.reference))
        assert clean.min() < 0
        assert image.psnr_db == pytest.approx(psnr_of(clean, noisy.clip(0, 1), data_range=1), abs=1e-6, rel=0)
