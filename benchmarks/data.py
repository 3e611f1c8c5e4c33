"""What is measured: one scene photographed at 12 megapixels by the demo's first camera, and predictions for it.

For the calibration, bias and flat-field frames of the camera whose noise is known.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from eldata.base.workers import Workers
from eldata.datasets import ELDDataset
from eldata.demo.calibration_frames import make_calibration_frames
from eldata.demo.camera import CAMERAS
from eldata.demo.tree import make_tree
from eldata.evaluation import save_prediction
from eldata.raw import read_raw, write_dng

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

SIZE = (2832, 4240)

CALIBRATION_ISOS = {100: (200, 400), 1600: (800, 3200), 25600: (6400, 12800)}
"""ISOs whose frames are simulated, and those under which the same pixels are written again."""


@dataclass(frozen=True, slots=True)
class Files:
    """Where things lie, in a folder that the caller removes.

    ``data`` holds an ELD-like set of lossless-JPEG DNGs, 16 frames of which 6 are scored; ``uncompressed`` is its
    first reference, written without compression. ``calibration`` holds bias and flat-field frames by ISO, if they were
    asked for.
    """

    data: Path
    manifest: Path
    predictions: Path
    uncompressed: Path
    calibration: Path

    def dataset(self) -> ELDDataset:
        return ELDDataset(self.data / "ELD-demo", manifest=self.manifest)

    def first_pair(self) -> tuple[Path, Path]:
        """Return the noisy file and the reference of the dataset's first pair."""
        dataset = self.dataset()
        return dataset.root / dataset.records[0].path, dataset.root / dataset.records[0].reference

    def first_prediction(self) -> Path:
        return self.predictions / Path(self.dataset().records[0].path).with_suffix(".npy")


def make_files(folder: Path, *, calibration: bool = True) -> Files:
    """Write everything into ``folder``: half a gigabyte, in about half a minute; with ``calibration`` 2 GB more."""
    manifest = make_tree(folder, scenes=1, size=SIZE, cameras=CAMERAS[:1])
    files = Files(
        data=folder / "data",
        manifest=manifest.path,
        predictions=folder / "predictions",
        uncompressed=folder / "uncompressed.dng",
        calibration=folder / "calibration",
    )
    reference = read_raw(files.first_pair()[1])
    write_dng(files.uncompressed, reference.mosaic, reference.sensor, reference.exposure)
    for path, prediction in _predictions(files.dataset()):
        save_prediction(files.predictions, path, prediction)
    if calibration:
        _make_calibration(files.calibration)
    return files


def _make_calibration(folder: Path) -> None:
    """Write 10 bias frames and 5 pairs of flats at each of nine ISOs: 180 files.

    A third of them is simulated and written under two more ISOs each: they take as long to read and to measure as if
    all were, and most of a minute is saved.
    """
    jobs = len(os.sched_getaffinity(0))
    made = folder / "made"
    manifest = make_calibration_frames(made, isos=tuple(CALIBRATION_ISOS), size=SIZE, workers=Workers(jobs))
    (made / "data" / "calibration" / manifest.records[0].camera).rename(folder / manifest.records[0].camera)
    paths = [folder / record.path for record in manifest.records]
    for _ in Workers(jobs).run(_write_again, paths, label="calibration files"):
        pass


def _write_again(path: Path) -> None:
    frame = read_raw(path)
    iso = int(path.parent.name.removeprefix("ISO"))
    for other in CALIBRATION_ISOS[iso]:
        target = path.parent.with_name(f"ISO{other}") / path.name
        target.parent.mkdir(exist_ok=True)
        exposure = replace(frame.exposure, iso=Fraction(other))
        write_dng(target, frame.mosaic, frame.sensor, exposure, compression="lossless-jpeg")


def _predictions(dataset: ELDDataset) -> Iterator[tuple[str, NDArray[np.float32]]]:
    """Yield what a fair denoiser might give: a little too dark, with noise left."""
    generator = np.random.default_rng(0)
    for sample in dataset:
        target = sample["target"].numpy()
        noise = generator.standard_normal(target.shape, dtype=np.float32)
        yield sample["path"], np.clip(np.float32(0.97) * target + np.float32(0.02) * noise, 0, 1)
