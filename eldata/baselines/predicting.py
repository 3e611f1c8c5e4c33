"""A data set through a denoiser into a folder that :func:`eldata.evaluate` scores; existing predictions are kept."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Protocol

import numpy as np

from eldata import __version__
from eldata.base.files import inside, remove_leftovers
from eldata.base.numbers import counted
from eldata.base.workers import AnyWorkers, Failed, require_files
from eldata.baselines.classical import BASELINES, SignalNoise
from eldata.baselines.noisy_frames import NoisyFrame, NoisyFrames, estimate_line, line_of_profile
from eldata.baselines.prediction_folder import ANSWERS, begin_folder, describe_answers
from eldata.errors import ArgumentError, DatasetError
from eldata.evaluation.predictions import save_prediction, stem_of
from eldata.evaluation.request import Request, make_request, plan_scoring, require_pairs
from eldata.manifest.card import CHANNELS
from eldata.manifest.clips import Clip, clips_of, setting_name
from eldata.manifest.patterns import expand
from eldata.metrics.registry import IMAGES
from eldata.noise.profile import CameraProfile, profile_of
from eldata.protocols.words import in_words

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from numpy.typing import NDArray

    from eldata.evaluation.scores import Pair
    from eldata.manifest.catalogue import FrameFiles
    from eldata.protocols.protocol import Protocol as ScoringProtocol
    from eldata.raw.levels import Clip as ClipRange

    Values = NDArray[np.floating[Any]]

PixelType = Literal["float32", "float16", "uint16"]
ANOTHER = "profile_of_another_camera"
"""In the settings: whether a profile was allowed to stand for cameras that it is not of."""
_SCHEMA = 1
_OF_SRGB = ("input_space", "prediction_space", "response")  # what the settings say in words of predictions in sRGB


class Denoiser(Protocol):
    """Whatever predicts a frame. With more than one worker it has to be picklable."""

    def settings(self, cameras: Collection[str], channels: Collection[int]) -> dict[str, Any]:
        """Return the settings that decide its predictions, of plain types; a folder holds predictions of one denoiser.

        Parameters
        ----------
        cameras
            Whose frames it will get; they may be refused, and must not change what is returned.
        channels
            How many channels C the data set's frames may have.
        """
        ...

    def __call__(self, frame: NoisyFrame) -> Values:
        """Return (C, h, w), normalised like the input."""
        ...


@dataclass(frozen=True, slots=True)
class BaselineDenoiser:
    """A denoiser that needs no training of yours (:data:`eldata.baselines.BASELINES`).

    Attributes
    ----------
    name
        Its key there.
    profiles
        The cameras' noise; without, it is estimated from each frame.
    profile_of_another_camera
        Whether the only profile may stand for cameras that it is not of.
    """

    name: str
    profiles: tuple[CameraProfile, ...] = ()
    profile_of_another_camera: bool = False

    def __post_init__(self) -> None:
        if self.name not in BASELINES:
            raise ArgumentError(f"no baseline is called {self.name!r}; known are {', '.join(BASELINES)}")
        cameras = [profile.camera for profile in self.profiles]
        if len(set(cameras)) < len(cameras):
            raise ArgumentError(f"give one profile of each camera; found profiles of {', '.join(cameras)}")

    def settings(self, cameras: Collection[str], channels: Collection[int]) -> dict[str, Any]:  # noqa: ARG002 # any
        """Return its name, the versions of its package or weights, and the source of the noise.

        Raises
        ------
        ArgumentError
            If a camera has no profile.
        EldataError
            If a package that it needs is not installed.
        """
        baseline = BASELINES[self.name]
        if self.profiles and baseline.uses_noise:
            for camera in cameras:
                profile_of(camera, self.profiles, another=self.profile_of_another_camera)
        noise = {profile.camera: sha256(repr(profile).encode()).hexdigest() for profile in self.profiles}
        return {
            "denoiser": self.name,
            **baseline.versions(),
            "noise": noise or "each frame's own",
            ANOTHER: bool(self.profiles) and self.profile_of_another_camera,
        }

    def __call__(self, frame: NoisyFrame) -> Values:
        """Return its estimate of the signal."""
        baseline = BASELINES[self.name]
        return baseline.denoise(frame.image, self._find_noise(frame) if baseline.uses_noise else None)

    def _find_noise(self, frame: NoisyFrame) -> SignalNoise:
        """Find a frame's noise: by the camera's profile or, without any, from the frame itself."""
        if not self.profiles:
            return estimate_line(frame.image)
        if math.isnan(frame.range_dn):
            raise ArgumentError("a profile is of raw frames, and these are in RGB; leave --profile out")
        profile = profile_of(frame.pair.camera, self.profiles, another=self.profile_of_another_camera)
        line = line_of_profile(profile, frame.path, frame.iso, ratio=frame.ratio, range_dn=frame.range_dn)
        return replace(line, black=()) if frame.has_own_black else line


@dataclass(frozen=True, slots=True)
class PredictionReport:
    """What became of the frames.

    Attributes
    ----------
    folder
        The predictions'.
    written, kept
        Numbers of frames predicted now, and of those that were there.
    problems
        Frames without a prediction, in words; those of one reason together.
    remarks
        What a reader of the scores should know.
    """

    folder: Path
    written: int
    kept: int
    problems: tuple[str, ...]
    remarks: tuple[str, ...] = ()

    def format_text(self) -> str:
        """Return the lines that a command prints."""
        kept = f", {self.kept} were there" if self.kept else ""
        lines = [*self.problems, *self.remarks, f"{counted(self.written, 'frame')} predicted{kept}: {self.folder}"]
        return "\n".join(lines)


def write_predictions(
    denoiser: Denoiser, dataset: str, out: Path | str, *, protocol: str | Path | ScoringProtocol | None = None,
    clip: ClipRange | Literal["protocol"] | None = None, dtype: PixelType = "float32",
    root: Path | str | None = None, manifest: Path | str | None = None, cameras: Collection[str] | None = None,
    subset: str | None = None, ids: Collection[str] | None = None, exclude_flags: Collection[str] = (),
    dark_shading: Path | str | None = None, workers: AnyWorkers = 1,
) -> PredictionReport:  # fmt: skip
    """Predict each pair, or each frame of the clips, that a protocol scores, as :func:`eldata.evaluate` wants it.

    So is each frame of a subset without references, such as a benchmark's, which others score.

    Frames whose prediction is there are left out, so that work that was interrupted goes on.

    Parameters
    ----------
    denoiser
        What predicts.
    dataset, protocol
        As :func:`eldata.evaluate` has them. The protocol decides levels and amplification, and with them what 1.0 is.
    out
        A new folder, or one that this function began with the same settings, or with others without a prediction.
    clip
        Of the input, before and after it is amplified: ``"none"`` keeps the negative half of the read noise, which
        averages need; ``"protocol"`` is what the protocol has for its input, and networks trained on it want. ``None``
        is what the denoiser's settings state as ``clip``, else ``"none"``.
    dtype
        Of the files: ``"uint16"`` with 65535 = 1.0, clipped to [0, 1], takes half of the space.
    root, manifest, cameras, subset, ids, exclude_flags, dark_shading, workers
        As :func:`eldata.evaluate` has them. The dark shading is taken off the inputs here.

    Raises
    ------
    ArgumentError
        If names are unknown, the protocol scores renderings, the denoiser states another ``clip`` or a ``window`` of
        frames where there are no clips, a camera has no profile, or the folder holds other predictions.
    EldataError
        If a package that the denoiser needs is not installed.
    DatasetError, ManifestError
        If the data set is not there or not what its manifest says.
    """
    request = make_request(
        None, dataset, protocol, root=root, manifest=manifest, cameras=cameras, subset=subset, ids=ids,
        exclude_flags=exclude_flags, baseline="input", dark_shading=dark_shading, workers=workers,
    )  # fmt: skip
    chosen = request.protocol
    pairs = plan_scoring(request, unscored=True).pairs
    cameras = list(dict.fromkeys(pair.camera for pair in pairs))
    has_colours = chosen.pixels == "rgb" or chosen.input_space == "srgb"
    stated = denoiser.settings(cameras, (3,) if has_colours else CHANNELS[request.manifest.card.cfa])
    frames = stated.get("window", 1)
    if request.kind is IMAGES and frames > 1:
        raise ArgumentError(
            f"the network takes windows of {frames} frames of a clip, and {request.manifest.name} is a dataset of "
            "photographs; give one of clips, such as drv"
        )
    known = stated.get("clip")
    wanted_clip = (known or "none") if clip is None else chosen.input_clip if clip == "protocol" else clip
    if known not in (None, wanted_clip):
        raise ArgumentError(
            f"the network was trained with inputs clipped as {known!r}, by its own account; found {wanted_clip!r}: "
            "leave --clip (clip=...) out"
        )
    require_pairs(request, pairs)
    folder = Path(out)
    settings = {
        "schema": _SCHEMA,
        "eldata": __version__,
        **stated,
        "dataset": request.manifest.name,
        "manifest_sha256": request.manifest.digest,
        "levels": chosen.levels,
        "amplification": chosen.amplification,
        "clip": wanted_clip,
        "dtype": dtype,
        "dark_shading": chosen.dark_shading,
        **({name: in_words(name, getattr(chosen, name)) for name in _OF_SRGB} if chosen.pixels == "srgb" else {}),
    }
    with begin_folder(folder, settings):
        every = [_name_prediction(folder, pair, path) for pair in pairs for path in pair.frames]
        for place in sorted({file.parent for file in every}):
            if place.is_dir():
                remove_leftovers(place)
        units = _plan_units(request, pairs, folder)
        missing = [_name_prediction(folder, unit.pair, path) for unit in units for path in unit.missing]
        work = partial(_predict_unit, denoiser, request.files, folder, chosen, wanted_clip, dtype, request.dark_shading)
        what = "frame" if request.kind is IMAGES else "clip"
        outcomes = request.workers.attempt(work, units, label="denoising", unit=what)
        failed: dict[str, list[str]] = {}
        for outcome in outcomes:
            if isinstance(outcome, Failed):
                failed.setdefault(outcome.reason, []).append(outcome.unit.path)
        written = sum(file.exists() for file in missing)
    problems = tuple(
        f"{paths[0]}: {reason}" if len(paths) == 1 else f"{len(paths)} {what}s, such as {paths[0]}: {reason}"
        for reason, paths in failed.items()
    )
    return PredictionReport(folder, written, len(every) - len(missing), problems, _collect_remarks(stated, cameras))


def _collect_remarks(settings: dict[str, Any], cameras: Sequence[str]) -> tuple[str, ...]:
    """Collect remarks on the folder's settings for readers of the scores."""
    remarks = describe_answers(settings.get(ANSWERS, {}))
    without = [camera for camera in cameras if camera not in settings["noise"]] if settings.get(ANOTHER) else []
    if not without:
        return remarks
    known = ", ".join(settings["noise"])
    return (f"the noise of {known} was taken for frames of {', '.join(without)}, another camera", *remarks)


def _plan_units(request: Request, pairs: Sequence[Pair], folder: Path) -> list[_Unit]:
    """Plan the work: pairs and windows without all predictions, with their clips."""
    clips: dict[str, Clip] = {}
    if request.kind is not IMAGES:
        listed, first = expand(request.manifest.records, request.folder), {pair.path for pair in pairs}
        names = {setting_name(row) for row in listed if row.path in first}
        rows = [row for row in listed if row.role != "noisy" or setting_name(row) in names]
        clips = {clip.scene: clip for clip in clips_of(rows)}
    units = []
    for pair in pairs:
        missing = tuple(path for path in pair.frames if not _name_prediction(folder, pair, path).exists())
        if missing:
            units.append(_Unit(pair, missing, clips.get(pair.scene)))
    return units


def _name_prediction(folder: Path, pair: Pair, path: str) -> Path:
    """Name the ``.npy`` file of a frame's prediction."""
    return folder / f"{stem_of(pair.place(path))}.npy"


@dataclass(frozen=True, slots=True)
class _Unit:
    """A pair, or a window of a clip, and its frames without a prediction."""

    pair: Pair
    missing: tuple[str, ...]
    clip: Clip | None

    @property
    def path(self) -> str:
        """Its first frame."""
        return self.pair.path


def _predict_unit(
    denoiser: Denoiser, dataset: FrameFiles, out: Path, protocol: ScoringProtocol, clip: ClipRange, dtype: PixelType,
    dark_shading: Path | None, unit: _Unit,
) -> None:  # fmt: skip
    """Work on one unit: from raw files to the predictions' files."""
    pair = unit.pair
    require_files(*(inside(dataset.folder, path) for path in pair.files))
    frames = NoisyFrames(dataset, pair, unit.clip, protocol, clip, dark_shading)
    for path in unit.missing:
        frame = frames.frame(path)
        predicted = np.asarray(denoiser(frame))
        expected = (3 if protocol.pixels == "srgb" else len(frame.image), *frame.image.shape[1:])
        if predicted.shape != expected:
            raise DatasetError(
                f"the denoiser made {predicted.shape} of a frame of {frame.image.shape}; protocol {protocol.name} "
                f"takes {expected}"
            )
        unusable = int(np.count_nonzero(~np.isfinite(predicted)))
        if unusable:
            raise DatasetError(f"the denoiser made {unusable} of {predicted.size} values NaN or infinite")
        if dtype == "uint16":
            predicted = np.rint(np.clip(predicted, 0.0, 1.0) * 65535)
        save_prediction(out, pair.place(path), predicted.astype(dtype))
