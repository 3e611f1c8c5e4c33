"""Calibration frames of the simulated camera in DNG files: made once, copied where a test spoils them."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eldata.calibration.frames import FramesError, sort_frames
from eldata.calibration.iso_results import IsoCalibration
from eldata.calibration.one_iso import calibrate_iso
from eldata.datasets.calibration_frames import CalibrationFrames
from eldata.demo.calibration_frames import make_calibration_frames
from eldata.manifest.verify_report import Problem
from eldata.raw.dng import write_dng
from eldata.raw.reading import read_raw
from eldata.records import FrameRecord, Role

SIZE = (256, 384)
ISOS = (100, 400, 1600)
CAMERA = "DemoGamma"


@dataclass(frozen=True)
class FrameTree:
    """Frames on disk, as ``make_calibration_frames`` lays them out."""

    folder: Path

    @property
    def root(self) -> Path:
        """The folder that holds the cameras' folders."""
        return self.folder / "data" / "calibration"

    @property
    def camera(self) -> Path:
        (camera,) = self.root.iterdir()
        return camera

    @property
    def manifest(self) -> Path:
        return self.folder / "manifests" / "calibration-demo.csv"

    @property
    def truth(self) -> dict[str, Any]:
        read: dict[str, Any] = json.loads((self.folder / "truth.json").read_text(encoding="utf-8"))
        return read

    def files(self, role: Role, iso: int) -> list[Path]:
        return sorted((self.camera / role / f"ISO{iso}").glob("*.dng"))

    def frames(self, **options: Any) -> CalibrationFrames:
        return CalibrationFrames(self.root, **options)

    def copy(self, folder: Path) -> FrameTree:
        shutil.copytree(self.folder, folder)
        return FrameTree(folder)


def make_tree(folder: Path, **options: Any) -> FrameTree:
    """Three ISOs, six bias frames and three pairs of flats each, 256 x 384 pixels, unless told otherwise."""
    settings: dict[str, Any] = {"isos": ISOS, "bias_frames": 6, "flat_levels": 3, "size": SIZE, **options}
    make_calibration_frames(folder, **settings)
    return FrameTree(folder)


def rewritten(
    path: Path, *,
    mosaic: Callable[[NDArray[np.uint16]], NDArray[np.uint16]] | None = None, **fields: Any,
) -> None:  # fmt: skip
    """Write a raw file again with other pixels, exposure, or fields of its sensor."""
    raw = read_raw(path)
    pixels = raw.mosaic if mosaic is None else mosaic(raw.mosaic)
    exposure = {name: fields.pop(name) for name in ("iso", "exposure_s") if name in fields}
    changed = replace(raw.sensor, **{"height": pixels.shape[0], "width": pixels.shape[1], **fields})
    write_dng(path, pixels, changed, replace(raw.exposure, **exposure), compression="lossless-jpeg")


def problems_of(frames: CalibrationFrames) -> list[Problem]:
    """What the checks of the headers and, where they find nothing, of the pixels list."""
    chosen = sort_frames(frames)
    found = [problem for one in chosen for problem in one.problems]
    if found:
        return found
    for one in chosen:
        try:
            calibrate_iso(frames, one)
        except FramesError as error:
            found += error.problems
    return found


def calibrated_iso(frames: CalibrationFrames, iso: int) -> IsoCalibration:
    (chosen,) = (one for one in sort_frames(frames) if one.iso == iso)
    found = calibrate_iso(frames, chosen)
    assert isinstance(found, IsoCalibration)
    return found


def relative(tree: FrameTree, path: Path) -> str:
    """A file's path as a record has it."""
    return path.relative_to(tree.root).as_posix()


def named(records: tuple[FrameRecord, ...]) -> list[str]:
    return [record.path for record in records]
