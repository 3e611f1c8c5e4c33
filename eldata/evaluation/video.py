"""The evaluation of clips: each frame against the clip's one still, the window of frames as a video.

The prediction of frame ``DSC00005.ARW`` of clip ``0013`` is ``PREDS/0013/DSC00005.<ext>``, whatever folders the frame
lies in; else as for images (:mod:`eldata.evaluation.predictions`). Of preprocessed RGB frames it is (3, h, w) or a
16-bit RGB PNG, in the order R, G, B.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.base.files import inside
from eldata.base.png import rgb_frame
from eldata.base.workers import AnyWorkers, Failed, Workers, accepts_jobs, require_files
from eldata.errors import ArgumentError, DatasetError, ManifestError, PredictionError
from eldata.evaluation.common import EvaluationProblem, file_problems, software
from eldata.evaluation.predictions import find_predictions, load_prediction, load_rgb_prediction, save_prediction
from eldata.evaluation.video_results import FrameScore, VideoResult, VideoScore
from eldata.manifest.catalogue import Manifest, load_manifest, shipped_manifest
from eldata.manifest.clip_checks import is_png
from eldata.manifest.clips import clips_of, select_rows, windows
from eldata.manifest.drv import Layout
from eldata.manifest.patterns import expand
from eldata.manifest.subsets import find_subset
from eldata.manifest.verify import check_files
from eldata.protocols.video import default_video_protocol, get_video_protocol

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from numpy.typing import NDArray

    from eldata.evaluation.predictions import FoundPredictions
    from eldata.manifest.clips import ClipRecord
    from eldata.manifest.verify import Level
    from eldata.protocols.video import VideoProtocol
    from eldata.records import FrameRecord, Sensor


@accepts_jobs
def evaluate_video(
    predictions: Path | str,
    dataset: str = "drv",
    *,
    protocol: str | None = None,
    root: Path | str | None = None,
    manifest: Path | str | None = None,
    subset: str | None = None,
    ids: Collection[str] | None = None,
    allow_missing: bool = False,
    workers: AnyWorkers = 1,
) -> VideoResult:
    """Score a folder of predicted clips under a named protocol.

    Before anything is scored, the numbering of all frames of the clips is checked, and the files that are scored as
    ``eldata verify --level metadata`` does. A clip is scored if all of its frames have a prediction.

    Parameters
    ----------
    predictions
        Folder of predictions: see the module's text.
    dataset
        Name of a shipped manifest of clips: ``drv``, the preprocessed ones.
    protocol
        Name of a protocol (:mod:`eldata.protocols.video`). Default: the dataset's own.
    root
        The folder that holds the datasets; default ``$ELDATA_ROOT``, else ``./data``.
    manifest
        A manifest's CSV file, in place of ``dataset``: that of a copy's raws
        (:func:`eldata.manifest.drv.scan_raw`), or one that ``eldata lock`` filled in.
    subset
        Name of a subset on the dataset's card: ``test`` (default), ``val`` or ``train``.
    ids
        Score these clips instead of a subset; the result says so.
    allow_missing
        Score what is there although predictions are missing or unusable; the table shows the coverage.
    workers
        Number of worker processes, or an executor that scores (:mod:`eldata.base.workers`); the files are checked from
        here. Scores do not depend on it.

    Returns
    -------
    VideoResult
        Scores, means and provenance. If it has ``problems`` and ``allow_missing`` is false, nothing was scored.

    Raises
    ------
    EldataError
        If the folder of predictions is not there.
    DatasetError
        If the dataset is not there, or its files are not what the manifest says.
    ManifestError, ArgumentError
        If the manifest is malformed or has no clips, or a name is unknown.
    """
    workers = Workers.of(workers)
    loaded = shipped_manifest(dataset) if manifest is None else load_manifest(manifest)
    chosen = _protocol(loaded, protocol)
    folder = loaded.folder(root)
    if not folder.is_dir():
        raise DatasetError(
            f"{folder}: the dataset is not there; name the folder above it with --root (root=...). Where to get it: "
            f"{loaded.card.homepage}"
        )
    subset_name, rows = _rows(loaded, subset, ids)
    _require(loaded, folder, rows, "quick", workers)
    listed = expand(rows, folder)
    clips = clips_of(listed)
    wanted = tuple(
        window
        for clip in clips
        for window in windows(clip, length=chosen.frame_count, stride=chosen.frame_count, frames=chosen.frames)
    )
    _check_windows(wanted, chosen)
    needed = {path for window in wanted for path in (*window.paths, window.reference)}
    _require(loaded, folder, [row for row in listed if row.path in needed], "metadata", workers)

    places = {path: _Place(_prediction_of(window, path)) for window in wanted for path in window.paths}
    known = [
        f"{row.scene}/{PurePosixPath(row.path).name}" for row in expand(loaded.records, folder) if row.role == "noisy"
    ]
    found = find_predictions(Path(predictions), places.values(), known)
    problems = file_problems(found, allow_missing=allow_missing)
    scores: dict[str, VideoScore] = {}
    if allow_missing or not problems:
        scores, unusable = _score_all(folder, chosen, wanted, found, workers)
        problems += unusable
        if problems and not allow_missing:
            scores = {}
    videos = tuple(scores[window.scene] for window in wanted if window.scene in scores)
    return VideoResult(
        protocol=chosen,
        provenance={
            "dataset": loaded.name,
            "manifest_version": loaded.card.version,
            "manifest_sha256": loaded.digest,
            "protocol_digest": chosen.digest,
            "subset": subset_name,
            "ids": None if ids is None else sorted(ids),
            "layout": str(Layout.of(listed)),
            "predictions": str(predictions),
            **software(),
        },
        windows=wanted,
        videos=videos,
        missing=tuple(window.scene for window in wanted if window.scene not in scores),
        problems=tuple(problems),
        notes=tuple(_notes(found, videos)),
    )


def save_clip_prediction(folder: Path | str, record: ClipRecord, prediction: NDArray[Any]) -> list[Path]:
    """Write the frames of a predicted window as ``.npy`` where :func:`evaluate_video` looks for them.

    Parameters
    ----------
    folder
        The folder of predictions; folders below it are made.
    record
        The window, ``dataset.records[i]``.
    prediction
        (T, C, h, w), floating in [0, 1].

    Raises
    ------
    ArgumentError
        If it has not as many frames as the window.
    EldataError
        If a file cannot be written.
    """
    if len(prediction) != len(record.paths):
        raise ArgumentError(f"expected {len(record.paths)} predicted frames, found {len(prediction)}")
    return [
        save_prediction(folder, _prediction_of(record, path), frame)
        for path, frame in zip(record.paths, prediction, strict=True)
    ]


# --- choosing and checking --------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Place:
    path: str


def _prediction_of(record: ClipRecord, path: str) -> str:
    return f"{record.scene}/{PurePosixPath(path).name}"


def _protocol(manifest: Manifest, name: str | None) -> VideoProtocol:
    own = default_video_protocol(manifest.name)
    if own is None:
        raise ArgumentError(f"{manifest.name} is no dataset of clips; those are drv and drv-raw")
    chosen = own if name is None else get_video_protocol(name)
    if chosen.dataset != manifest.name:
        raise ArgumentError(f"protocol {chosen.name!r} is for dataset {chosen.dataset!r}, not {manifest.name!r}")
    return chosen


def _rows(
    manifest: Manifest, subset: str | None, ids: Collection[str] | None
) -> tuple[str | None, tuple[FrameRecord, ...]]:
    subsets = manifest.card.subsets
    if ids is not None and subset is not None:
        raise ArgumentError("give a subset or ids, not both")
    if ids is None and not subsets:
        raise ArgumentError(f"{manifest.path}: its card names no subset; name the clips with ids")
    if ids is not None:
        splits = {row.split for row in manifest.records if row.role == "reference"}
        return None, select_rows(manifest.records, splits=sorted(splits), ids=ids)
    chosen = subsets[0] if subset is None else find_subset(subsets, subset)
    rows = select_rows(manifest.records, splits=chosen.splits, ids=None)
    clips = {row.scene for row in rows if row.role == "noisy"}
    if len(clips) != chosen.pairs:
        raise ManifestError(
            f"subset {chosen.name!r} has {chosen.pairs} clips, the manifest {len(clips)} of them; score those with ids"
        )
    return chosen.name, rows


def _require(
    manifest: Manifest,
    folder: Path,
    rows: Sequence[FrameRecord],
    level: Level,
    workers: Workers,
) -> None:
    problems, _ = check_files(manifest, folder, rows, level=level, workers=workers)
    if problems:
        more = f" (and {len(problems) - 1} more: eldata verify --level metadata lists all)" if len(problems) > 1 else ""
        raise DatasetError(f"{folder}: the dataset is not what its manifest says: {problems[0]}{more}")


def _check_windows(wanted: Sequence[ClipRecord], protocol: VideoProtocol) -> None:
    for window in wanted:
        if window.reference is None:
            raise DatasetError(f"clip {window.scene}: has no reference, so it cannot be scored")
        if is_png(window.path) != (protocol.pixels == "rgb"):
            raise ArgumentError(f"{window.path}: protocol {protocol.name!r} scores {protocol.pixels} frames")


def _notes(found: FoundPredictions, videos: Sequence[VideoScore]) -> list[str]:
    notes = []
    if found.unscored:
        notes.append(f"not scored, because this evaluation leaves their frames out: {found.unscored} predictions")
    perfect = [video.scene for video in videos if video.psnr_db == float("inf")]
    if perfect:
        notes.append(f"with a frame that equals the reference exactly: {len(perfect)} videos, such as {perfect[0]}")
    return notes


# --- scoring ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Unit:
    """A window and the prediction of each of its frames."""

    window: ClipRecord
    files: tuple[Path, ...]

    def __str__(self) -> str:
        return f"clip {self.window.scene}"


def _score_all(
    folder: Path,
    protocol: VideoProtocol,
    wanted: Sequence[ClipRecord],
    found: FoundPredictions,
    workers: Workers,
) -> tuple[dict[str, VideoScore], list[EvaluationProblem]]:
    units = []
    for window in wanted:
        files = [found.files.get(_prediction_of(window, path)) for path in window.paths]
        if None not in files:
            units.append(_Unit(window, tuple(path for path in files if path is not None)))
    # Processes share the CPUs; within one process the metrics use all of them.
    work = partial(_score_unit, Path.cwd(), folder.absolute(), protocol, workers.threads_within)
    scores: dict[str, VideoScore] = {}
    problems: list[EvaluationProblem] = []
    for outcome in workers.attempt(work, units, label="scoring", unit="video"):
        if isinstance(outcome, VideoScore):
            scores[outcome.scene] = outcome
        elif isinstance(outcome, Failed):
            problems.append(EvaluationProblem(str(outcome.unit), outcome.reason))
        else:
            problems += outcome
    return scores, problems


@dataclass(frozen=True, slots=True, eq=False)
class _Reference:
    """The clip's still, (C, h, w) float32, and the sensor that it was taken with if it is a raw."""

    pixels: NDArray[np.float32]
    sensor: Sensor | None


def _score_unit(
    start: Path, folder: Path, protocol: VideoProtocol, threads: int | None, unit: _Unit
) -> VideoScore | list[EvaluationProblem]:
    from eldata.metrics import raw_to_grey, rescale, score, st_rred

    window = unit.window
    still = inside(folder, window.reference or "")
    require_files(still, *(start / file for file in unit.files))
    reference = _reference(still, protocol)
    problems: list[EvaluationProblem] = []
    frames: list[FrameScore] = []
    # Of each frame the grey image alone is kept, which ST-RRED is taken of.
    grey = np.empty((len(unit.files), *reference.pixels.shape[1:]), np.float64)
    for place, (path, file) in enumerate(zip(window.paths, unit.files, strict=True)):
        try:
            prediction = _load(start / file, reference, protocol)
        except PredictionError as error:
            problems.append(EvaluationProblem(str(file), error.reason))
            continue
        found = score(prediction, reference.pixels, rescaling=protocol.rescaling, threads=threads)
        frames.append(FrameScore(path, found.psnr_db, found.ssim, found.rescale))
        scored = rescale(prediction, reference.pixels) if protocol.rescaling == "scalar" else prediction.clip(0.0, 1.0)
        grey[place] = raw_to_grey(scored)
    if problems:
        return problems
    motionless = np.broadcast_to(raw_to_grey(reference.pixels), grey.shape)
    video = st_rred(grey, motionless, peak=protocol.st_rred_peak, threads=threads)
    return VideoScore(
        scene=window.scene,
        split=window.split,
        camera=window.camera,
        start=window.start,
        frames=tuple(frames),
        st_rred=video.st_rred,
        spatial_rred=video.spatial,
        temporal_rred=video.temporal,
    )


def _reference(path: Path, protocol: VideoProtocol) -> _Reference:
    if protocol.pixels == "rgb":
        return _Reference(rgb_frame(path), None)
    from eldata.raw.levels import packed_frame
    from eldata.raw.reading import read_raw

    frame = read_raw(path)
    return _Reference(packed_frame(frame, levels=protocol.levels, clip=protocol.reference_clip), frame.sensor)


def _load(path: Path, reference: _Reference, protocol: VideoProtocol) -> NDArray[np.float32 | np.float64]:
    if reference.sensor is not None:
        return load_prediction(path, reference.sensor, protocol.levels)
    channels, height, width = reference.pixels.shape
    return load_rgb_prediction(path, (channels, height, width))
