"""The frames that are exported: what their files state of themselves."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, NamedTuple, Unpack

import numpy as np

from eldata.base.files import file_problem, folder_problem, inside
from eldata.base.workers import Failed, Workers, require_files
from eldata.errors import DatasetError
from eldata.manifest.catalogue import FrameFiles, known_manifest, load_manifest
from eldata.manifest.pairs import Choice, refuse_shifted, select_pairs
from eldata.raw.colour import camera_to_srgb

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from numpy.typing import NDArray

    from eldata.base.workers import AnyWorkers
    from eldata.manifest.catalogue import Manifest
    from eldata.records import Exposure, PairRecord, Sensor


@dataclass(frozen=True, slots=True)
class ExportFrame:
    """A frame: its path in the manifest, its file (absolute), what that states; ``sensor`` if it was asked for."""

    path: str
    file: Path
    exposure: Exposure
    sensor: Sensor | None = None


class ExportPair(NamedTuple):
    """A pair of a manifest, and both of its frames."""

    record: PairRecord
    noisy: ExportFrame
    reference: ExportFrame


def exported_pairs(
    name: str = "",
    *,
    manifest: Path | str | None = None,
    root: Path | str | None = None,
    with_sensors: bool = False,
    workers: AnyWorkers = 1,
    **choice: Unpack[Choice],
) -> tuple[Manifest, dict[str, list[ExportPair]]]:
    """Return a set's manifest and its chosen pairs by camera, once each of their files was asked for its exposure.

    ``with_sensors`` decodes the files, for white balance and matrix.

    Raises
    ------
    ManifestError
        If there is no such set, or the manifest is malformed.
    ArgumentError
        If a value of the choice is unknown; the message lists the known ones.
    DatasetError
        If files are missing, or cannot be read; the message has the first of them and how many there are.
    """
    loaded = known_manifest(name) if manifest is None else load_manifest(manifest)
    noisy = [record for record in loaded.records if record.role == "noisy"]
    if noisy and all(record.ratio is None for record in noisy):
        raise DatasetError(f"{loaded.name}: its noisy frames are clips without a ratio, and published code reads pairs")
    pairs = select_pairs(loaded.records, loaded.card.subsets, **choice)
    folder = loaded.folder(root)
    problem = folder_problem(folder)
    if problem is not None:
        raise DatasetError(f"{folder}: {problem}; --root names the folder that holds {loaded.card.folder}")
    paths = list(dict.fromkeys(path for pair in pairs for path in (pair.reference, pair.path)))
    stated = FrameFiles.of(folder, loaded.card, loaded.records).stated
    mosaics = [path for path in paths if path in stated]
    if mosaics:
        raise DatasetError(
            f"{folder / mosaics[0]}: is a mosaic whose levels the set's card states, as are {len(mosaics)} of "
            f"{len(paths)} files; published code reads raw files, by LibRaw: write them as DNG (eldata.raw.write_dng)"
        )
    absent = [path for path in paths if file_problem(inside(folder, path)) is not None]
    if absent:
        raise DatasetError(
            f"{folder / absent[0]}: {file_problem(folder / absent[0])}, as {len(absent)} of {len(paths)} files in all; "
            "choose the pairs that you have by --camera, --split or --subset (eldata verify lists what is missing)"
        )
    work = partial(_stated, folder.absolute(), with_sensors)
    frames = {frame.path: frame for frame in _all_read(Workers.of(workers).attempt(work, paths, label="reading"))}
    found: dict[str, list[ExportPair]] = {}
    for pair in pairs:
        refuse_shifted(pair, "published code compares frames as they lie: leave the pair out")
        found.setdefault(pair.camera, []).append(ExportPair(pair, frames[pair.path], frames[pair.reference]))
    return loaded, found


def _stated(folder: Path, with_sensors: bool, path: str) -> ExportFrame:
    from eldata.raw.reading import read_header, read_raw

    file = inside(folder, path)
    require_files(file)
    if not with_sensors:
        return ExportFrame(path, file, read_header(file).exposure)
    raw = read_raw(file)
    raw.whole_dn("published code, which reads with LibRaw,")
    return ExportFrame(path, file, raw.exposure, raw.sensor)


def _all_read(outcomes: Iterable[ExportFrame | Failed[str]]) -> list[ExportFrame]:
    every = list(outcomes)
    failed = [outcome for outcome in every if isinstance(outcome, Failed)]
    if failed:
        raise DatasetError(f"{failed[0].reason}" + (f"; so are {len(failed) - 1} more" if len(failed) > 1 else ""))
    return [outcome for outcome in every if not isinstance(outcome, Failed)]


# --- a sensor's colours as published code has them beside a frame: float32, nan where unknown -------------------------


def balance_multipliers(sensor: Sensor | None) -> NDArray[np.float32]:
    """Return the multipliers of R, G1, B and G2 as shot, G1 = 1: (4,); nan if the file states none."""
    stated = None if sensor is None else sensor.white_balance
    return np.array((np.nan,) * 4 if stated is None else tuple(map(float, stated)), np.float32)


def matrix_to_srgb(sensor: Sensor | None) -> NDArray[np.float32]:
    """Return the matrix from white-balanced camera R, G, B to linear sRGB: (3, 3); nan if the file states none."""
    if sensor is None or sensor.xyz_to_camera is None:
        return np.full((3, 3), np.nan, np.float32)
    return camera_to_srgb(sensor.xyz_to_camera).astype(np.float32)
