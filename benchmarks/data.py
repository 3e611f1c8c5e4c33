"""What is measured: one scene photographed at 12 megapixels by the demo's first camera, and predictions for it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from eldata.datasets import ELDDataset
from eldata.demo.camera import CAMERAS
from eldata.demo.tree import make_tree
from eldata.evaluation import save_prediction
from eldata.raw import read_raw, write_dng

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

SIZE = (2832, 4240)


@dataclass(frozen=True, slots=True)
class Files:
    """Where things lie, in a folder that the caller removes.

    ``data`` holds an ELD-like set of lossless-JPEG DNGs, 16 frames of which 6 are scored; ``uncompressed`` is its
    first reference, written without compression.
    """

    data: Path
    manifest: Path
    predictions: Path
    uncompressed: Path

    def dataset(self) -> ELDDataset:
        return ELDDataset(self.data / "ELD-demo", manifest=self.manifest)

    def first_pair(self) -> tuple[Path, Path]:
        """Return the noisy file and the reference of the dataset's first pair."""
        dataset = self.dataset()
        return dataset.root / dataset.records[0].path, dataset.root / dataset.records[0].reference

    def first_prediction(self) -> Path:
        return self.predictions / Path(self.dataset().records[0].path).with_suffix(".npy")


def make_files(folder: Path) -> Files:
    """Write everything into ``folder``: half a gigabyte, in about half a minute."""
    manifest = make_tree(folder, scenes=1, size=SIZE, cameras=CAMERAS[:1])
    files = Files(folder / "data", manifest.path, folder / "predictions", folder / "uncompressed.dng")
    reference = read_raw(files.first_pair()[1])
    write_dng(files.uncompressed, reference.mosaic, reference.sensor, reference.exposure)
    for path, prediction in _predictions(files.dataset()):
        save_prediction(files.predictions, path, prediction)
    return files


def _predictions(dataset: ELDDataset) -> Iterator[tuple[str, NDArray[np.float32]]]:
    """Yield what a fair denoiser might give: a little too dark, with noise left."""
    generator = np.random.default_rng(0)
    for sample in dataset:
        target = sample["target"].numpy()
        noise = generator.standard_normal(target.shape, dtype=np.float32)
        yield sample["path"], np.clip(np.float32(0.97) * target + np.float32(0.02) * noise, 0, 1)
