"""Predictions on disk: which files lie in a folder, which noisy frame each is meant for, loading, checking and saving.

For a noisy frame ``SonyA7S2/scene-1/IMG_0004.ARW`` the prediction is ``PREDS/SonyA7S2/scene-1/IMG_0004.<ext>``. It is
packed (C, h, w) or a mosaic (H, W); float in [0, 1] of the reference's normalised signal, or uint16 where
65535 = 1.0; a DNG holds raw DN. Protocols whose predictions are in sRGB take renderings: an RGB PNG or TIFF of 8 or 16
bits, or RGB arrays; of the mosaic's size under ``sid2018``, else of a pixel for each packed one. Where no file lies as
expected, one message names the nearest layout.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np

from eldata.base.arrays import Declared, read_array
from eldata.base.files import atomic_write, file_problem, folder_problem, split_member, visible_below
from eldata.base.numbers import counted
from eldata.errors import ArgumentError, EldataError, PredictionError, RawFileError
from eldata.evaluation.scores import EvaluationProblem
from eldata.raw.levels import pack, packed_shape, with_levels
from eldata.sources.frames import Frame

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping, Sequence

    from numpy.typing import NDArray

    from eldata.manifest.clips import ClipRecord
    from eldata.protocols.protocol import Levels
    from eldata.records import Sensor

EXTENSIONS = (".npy", ".npz", ".h5", ".tif", ".tiff", ".png", ".dng")
"""The kinds of file that a prediction may be, by the ends of their names."""

_MOST_EXAMINED = 20  # files whose names are compared with all noisy frames'
_MOST_NAMED = 3
_FOLDERS_ABOVE = 3
_MOST_SHOWN = 8  # predictions of one frame
READ = f"{', '.join(EXTENSIONS[:-1])} or {EXTENSIONS[-1]}"

OF_DATASET: Final = (
    "holds the dataset itself, {}; give a folder of predictions alone, such as eldata predict, eldata baseline or code "
    "of yours writes, or --baseline input to score the noisy frames as they are"
)


def stem_of(path: str) -> str:
    """Return a path without its extension; of a frame in an array file ``clip#im-3`` for ``clip.npz#im:3``."""
    file, member = split_member(path)
    return Path(file).with_suffix("").as_posix() + (f"#{member.replace(':', '-')}" if member else "")


def is_read(name: str) -> bool:
    """Check that a file has an extension of predictions."""
    return Path(name).suffix.lower() in EXTENSIONS


def save_prediction(folder: Path | str, noisy_path: str, prediction: NDArray[Any]) -> Path:
    """Write a prediction as ``.npy`` where :func:`eldata.evaluate` looks for it, whole or not at all.

    Parameters
    ----------
    folder
        The folder of predictions; folders below it are made.
    noisy_path
        The noisy frame's path in the manifest, as in a sample's ``path``.
    prediction
        Packed (C, h, w) or mosaic (H, W); float in [0, 1], or uint16 where 65535 = 1.0.

    Examples
    --------
    >>> from eldata import ELDDataset
    >>> from eldata.evaluation import save_prediction
    >>> dataset = ELDDataset("eldata-demo/data/ELD-demo", manifest="eldata-demo/manifests/eld-demo.csv")
    >>> sample = dataset[0]
    >>> save_prediction("preds", sample["path"], sample["input"].numpy()).as_posix()
    'preds/DemoAlpha/scene-1/IMG_0004.npy'
    """
    path = Path(folder) / f"{stem_of(noisy_path)}.npy"
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as file:
        np.save(file, np.asarray(prediction), allow_pickle=False)
    return path


def save_clip_prediction(folder: Path | str, record: ClipRecord, prediction: NDArray[Any]) -> list[Path]:
    """Write the frames of a predicted window as ``.npy`` where :func:`eldata.evaluate` looks for them.

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
    if len(prediction) != len(record.frames):
        raise ArgumentError(f"expected {len(record.frames)} predicted frames, found {len(prediction)}")
    return [
        save_prediction(folder, record.place(path), frame)
        for path, frame in zip(record.frames, prediction, strict=True)
    ]


# --- the files of a folder --------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class FoundPredictions:
    """The files of a folder of predictions, matched with the frames to score.

    Attributes
    ----------
    files
        Prediction of each noisy frame, by its place.
    problems
        Noisy frames with several predictions or none, and files that are the prediction of no noisy frame.
    unscored
        Number of predictions of noisy frames that this evaluation does not score.
    elsewhere
        Numbers of predictions of other datasets, by their names.
    """

    files: dict[str, Path]
    problems: tuple[EvaluationProblem, ...]
    unscored: int
    elsewhere: dict[str, int] = field(default_factory=dict)


def find_predictions(
    folder: Path,
    places: Collection[str],
    known: Collection[str] = (),
    *,
    elsewhere: Callable[[], Mapping[str, Iterable[str]]] = dict,
    dataset: tuple[Path, Iterable[str]] | None = None,
    allow_missing: bool = False,
    because: str = "",
) -> FoundPredictions:
    """Match the files of a folder with where predictions may lie, but for their extension.

    Of a folder in which nothing lies where a prediction may, that is the one problem.

    Parameters
    ----------
    folder
        The folder of predictions.
    places, known
        Paths of the noisy frames to score, and of all in the manifest: where predictions may lie.
    elsewhere
        Returns the noisy frames' paths in other datasets, by their names; called if files are left over.
    dataset
        The dataset's folder and its files' paths there, which are not predictions.
    allow_missing
        Whether noisy frames may lack a prediction.
    because
        Why a prediction is wanted that somebody may not expect to be, in words that go on a sentence.

    Raises
    ------
    EldataError
        If the folder is not there.
    """
    names = _list_files(folder)
    if dataset is not None:
        raws = _find_raws(folder, names, *dataset)
        names = [name for name in names if name not in raws]
        if raws and not any(map(is_read, names)):
            return FoundPredictions({}, (EvaluationProblem(str(folder), OF_DATASET.format(dataset[0])),), 0)
    by_stem: dict[str, list[str]] = {}
    unread: dict[str, str] = {}
    for name in names:
        if is_read(name):
            by_stem.setdefault(stem_of(name), []).append(name)
        else:
            unread.setdefault(stem_of(name), name)
    is_elsewhere = by_stem.keys().isdisjoint(map(stem_of, (*places, *known)))
    files: dict[str, Path] = {}
    problems, missing = [], []
    place_of_stem: dict[str, str] = {}
    for place in places:
        stem = stem_of(place)
        alike = by_stem.pop(stem, [])
        if place_of_stem.setdefault(stem, place) != place:
            reason = f"its prediction would lie where that of {place_of_stem[stem]} does; give the frames other names"
            problems.append(EvaluationProblem(place, reason))
        elif len(alike) == 1:
            files[place] = folder / alike[0]
        elif alike:
            reason = f"expected one prediction, found {len(alike)}: {', '.join(alike[:_MOST_SHOWN])}; keep one"
            problems.append(EvaluationProblem(place, reason))
        elif not allow_missing:
            there = add = ""
            if stem in unread:
                there, add = f", only a {Path(unread[stem]).suffix} file, which is not read", f" as {READ}"
            reason = f"has no prediction{there}{because}; add it{add}, or score the rest with --allow-missing"
            missing.append(EvaluationProblem(place, reason))

    def count_others(paths: Iterable[str]) -> int:
        """Count the files named like these paths, and take them from the files that are left."""
        return sum(len(by_stem.pop(stem, ())) for stem in set(map(stem_of, paths)))

    unscored = count_others(known)
    counts = {name: count for name, paths in elsewhere().items() if (count := count_others(paths))} if by_stem else {}
    if places and is_elsewhere:
        layout = describe_misplaced(folder, names, places, counts)
        return FoundPredictions({}, (EvaluationProblem(str(folder), layout),), 0)
    extra = [name for alike in by_stem.values() for name in alike]
    nearest = _find_nearest(extra, [problem.path for problem in missing])
    reason = "is the prediction of no noisy frame in the manifest; rename it or move it away"
    reason += "" if nearest is None else f": {nearest}"
    problems += [EvaluationProblem(name, reason) for name in extra]
    return FoundPredictions(files, (*problems, *missing), unscored, counts)


def _find_raws(folder: Path, names: Iterable[str], dataset: Path, paths: Iterable[str]) -> set[str]:
    """Return the names of the dataset's own files in a folder, which is the dataset's, one above it or one in it."""
    place, own = folder.resolve().as_posix(), dataset.resolve().as_posix()
    if not (f"{own}/".startswith(f"{place}/") or place.startswith(f"{own}/")):
        return set()
    raws = {f"{own}/{path}" for path in paths}
    return {name for name in names if f"{place}/{name}" in raws}


def check_folder(folder: Path) -> None:
    """Raise an EldataError unless a folder of predictions is there."""
    if (problem := folder_problem(folder)) is not None:
        raise EldataError(f"{folder}: {problem}; give the one that holds the predictions, a file for each noisy frame")


def _list_files(folder: Path) -> list[str]:
    """Return the files of a folder of predictions, relative to it, sorted.

    Hidden files and folders, and linked folders, are left out; a folder that is named like a prediction is there.
    """
    check_folder(folder)
    files = (path.relative_to(folder) for path in visible_below(folder) if is_read(path.name) or not path.is_dir())
    return sorted(map(Path.as_posix, files))


# --- a folder in which nothing lies as expected -----------------------------------------------------------------------


def describe_misplaced(
    folder: Path, names: Sequence[str], places: Collection[str], elsewhere: Mapping[str, int] = MappingProxyType({})
) -> str:
    """Describe a folder in which no prediction lies where it should, and name the nearest layout.

    Parameters
    ----------
    folder
        The folder of predictions; those above it may be the right one.
    names
        The files in it, POSIX paths relative to it.
    places
        Paths of the noisy frames.
    elsewhere
        Numbers of predictions of other datasets, by their names.
    """
    rule = f"the prediction of {(place := next(iter(places)))} is {_predicted_path(place)}"
    if not names:
        return f"found no file, but for hidden ones and links to folders; expected one for each noisy frame: {rule}"
    wrong, likely = f"none of them where expected ({rule})", [name for name in names if is_read(name)]
    if not likely:
        likely = list(names)
        wrong = f"none of them read; expected {READ} ({rule}, and eldata.evaluation.save_prediction writes it)"
    others = [f"{count} of them of {name} (--dataset {name})" for name, count in elsewhere.items()]
    advice = f"it holds predictions of other data, {_join_some(others)}" if others else None
    advice = advice or _other_folder(folder, likely, places) or _find_nearest(likely, places)
    return (
        f"found {counted(len(likely), 'file')}, {wrong}; {advice or 'is it the right folder, and the right dataset?'}"
    )


def _other_folder(folder: Path, names: Sequence[str], places: Collection[str]) -> str | None:
    """Name the folder with the expected layout: one below, several below, or one above this."""
    stems = {stem_of(place) for place in places}
    deepest = max(stem.count("/") + 1 for stem in stems)
    below = set()
    for parts in (stem_of(name).split("/") for name in names):
        cuts = range(max(1, len(parts) - deepest), len(parts))
        below |= {"/".join(parts[:cut]) for cut in cuts if "/".join(parts[cut:]) in stems}
    several = [str(folder / name) for name in sorted(below)]
    if len(several) == 1:
        return f"they lie below {below.pop()}: give {several[0]} as the folder of predictions"
    if several:
        return f"each of {_join_some(several)} holds some: give one of them as the folder of predictions"
    above = Path(os.path.abspath(folder))  # noqa: PTH100 # as it was called, links are not followed
    for levels in range(1, min(_FOLDERS_ABOVE, len(above.parts) - 1) + 1):
        prefix = "/".join(above.parts[-levels:])
        if any(f"{prefix}/{stem_of(name)}" in stems for name in names):
            return f"this is {prefix} of the layout: give {above.parents[levels - 1]} as the folder of predictions"
    return None


def _find_nearest(names: Sequence[str], places: Iterable[str]) -> str | None:
    """Return an example: a file, and what its name would have to be; None where no name tells which frame it is of."""
    parts = {place: stem_of(place).split("/") for place in places}
    for name in names[:_MOST_EXAMINED]:
        shared = {place: sum(_has_word(name, word) for word in words) for place, words in parts.items()}
        meant = {place: count for place, count in shared.items() if _has_word(name, parts[place][-1])}
        best = [place for place, count in meant.items() if count == max(meant.values())]
        if len(best) == 1:
            return f"{name} would be {_predicted_path(best[0], name)}"
    return None


def _has_word(name: str, word: str) -> bool:
    """Find a word in a name, without more digits next to it: IMG_1 is not in IMG_10."""
    return re.search(rf"(?<!\d){re.escape(word)}(?!\d)", name) is not None


def _predicted_path(place: str, name: str = "") -> str:
    """Return the place of a prediction, with the file's own extension if predictions may have it."""
    return stem_of(place) + (Path(name).suffix if is_read(name) else EXTENSIONS[0])


def _join_some(texts: Sequence[str]) -> str:
    """Return the first of some texts in a sentence, such as ``a, b and 3 others``."""
    if len(texts) > _MOST_NAMED + 1:
        texts = [*texts[:_MOST_NAMED], f"{len(texts) - _MOST_NAMED} others"]
    return " and ".join(filter(None, (", ".join(texts[:-1]), texts[-1])))


# --- loading ----------------------------------------------------------------------------------------------------------

# A prediction near [0, 1] has next to nothing above 2, even where it is an amplified noisy frame with hot pixels.
_SCALE_LIMIT = 2.0
_SCALE_SHARE = 1e-3

_MOST_MARGIN = 2  # pixels of a DNG, over those of the mosaic: it may have masked borders


def load_prediction(path: Path, sensor: Sensor, levels: Levels) -> NDArray[np.float32 | np.float64]:
    """Load a prediction and check it against the reference's sensor.

    Parameters
    ----------
    path
        A file of one of :data:`EXTENSIONS`.
    sensor
        The reference's: its CFA and size decide the expected shape.
    levels
        Levels that normalise a DNG's DN (:attr:`eldata.protocols.Protocol.levels`).

    Returns
    -------
    ndarray
        (C, h, w), float32 or float64, normalised, finite; not clamped.

    Raises
    ------
    PredictionError
        If the file cannot be read, or its shape, type, values or scale are wrong; the message says what was expected,
        what was found and what to do.
    """
    if path.suffix.lower() == ".dng":
        return load_dng(path, sensor).with_levels(levels).normalise("none")
    values = _floating(read_array(path, partial(_check_raw, path, sensor)))
    if values.ndim == 2:
        values = pack(values, sensor.cfa)
    leveled = with_levels(sensor, "metadata" if levels == "metadata-per-channel" else levels)
    span = leveled.white_level_dn - max(leveled.black_level_dn)
    _check_values(path, values, f"divide by {span:g} (white - black) or 255")
    return values


def load_colours(
    path: Path, shape: tuple[int, int, int], pixels: Literal["srgb", "rgb"]
) -> NDArray[np.float32 | np.float64]:
    """Load a prediction that is a rendering in sRGB, or an RGB frame such as DRV's preprocessed ones.

    Parameters
    ----------
    path
        A file of one of :data:`EXTENSIONS` but dng. A rendering: an RGB PNG or TIFF of 8 or
        16 bits, or an array (H, W, 3) or (3, H, W), uint8, uint16 or float in [0, 1]. A frame: a 16-bit RGB PNG, the
        others channels first.
    shape
        (3, H, W), the reference's.
    pixels
        What it should be (:attr:`eldata.protocols.Protocol.pixels`).

    Returns
    -------
    ndarray
        (3, H, W) in the order R, G, B, float32 or float64 with the full scale at 1, finite; not clamped, not rounded.

    Raises
    ------
    PredictionError
        Like :func:`load_prediction`.
    """
    rendering = pixels == "srgb"
    if path.suffix.lower() == ".dng":
        advice = "a rendering in sRGB, found a DNG; save an RGB PNG of 8 or 16 bits"
        if not rendering:
            advice = "an RGB frame, found a DNG; save npy (3, h, w) or a 16-bit RGB PNG"
        raise PredictionError(path, f"expected {advice}")
    values = _floating(read_array(path, partial(_check_colours, path, shape, rendering=rendering)))
    if values.shape != shape:
        values = np.ascontiguousarray(values.transpose(2, 0, 1))
    _check_values(path, values, "divide by 65535 or 255")
    return values


def _check_raw(path: Path, sensor: Sensor, declared: Declared) -> None:
    """Refuse arrays that are neither packed nor a mosaic of the reference's size, or of numbers without a scale."""
    _check_type(path, declared)
    mosaic_shape = (sensor.height, sensor.width)
    shape = packed_shape(mosaic_shape, sensor.cfa)
    if declared.shape in (shape, mosaic_shape):
        return
    hint = "predict the whole frame, in the reference's orientation"
    if len(declared.shape) == 3 and path.suffix.lower() == ".png":
        hint = "a PNG holds the mosaic as one grey channel: eldata.raw.unpack() it first"
    elif declared.shape == (*shape[1:], shape[0]):
        hint = "it is channels-last: transpose(2, 0, 1) it"
    elif len(declared.shape) == 4 and declared.shape[0] == 1:
        hint = "drop the batch dimension: save prediction[0]"
    elif len(declared.shape) == 3 and 3 in (declared.shape[0], declared.shape[-1]):
        hint = "renderings in sRGB? this protocol takes raw frames; eldata protocols lists those that take renderings"
    raise PredictionError(
        path, f"expected shape {shape} (packed) or {mosaic_shape} (mosaic), found {declared.shape}; {hint}"
    )


def _check_colours(path: Path, shape: tuple[int, int, int], declared: Declared, *, rendering: bool) -> None:
    """Refuse arrays that are not a rendering, or an RGB frame, of the reference's size."""
    if not (rendering and declared.values == "uint8"):
        _check_type(path, declared)
    _, height, width = shape
    found = declared.shape
    channels_last = found == (height, width, 3)
    if found == shape or (channels_last and (rendering or path.suffix.lower() == ".png")):
        return
    expected = f"({height}, {width}, 3) or {shape}" if rendering else f"shape {shape} (R, G, B)"
    hint = f"{'render' if rendering else 'predict'} the whole frame, in the reference's orientation"
    if channels_last:
        hint = "it is channels-last: transpose(2, 0, 1) it"
    elif rendering and len(found) == 3 and 4 in (found[0], found[-1]):
        hint = "packed raw, or with alpha? this protocol takes renderings in sRGB (eldata protocols lists those of raw)"
    elif rendering and len(found) == 2:
        hint = "one grey channel? this protocol takes renderings in sRGB"
    raise PredictionError(path, f"expected {expected}, found {found}; {hint}")


def _check_type(path: Path, declared: Declared) -> None:
    """Refuse numbers that are neither uint16 nor floating-point."""
    if declared.values not in ("uint16", "float16", "float32", "float64"):
        raise PredictionError(
            path, f"expected float in [0, 1] or uint16 with 65535 = 1.0, found {declared.values}; convert it"
        )


def _floating(array: NDArray[Any]) -> NDArray[Any]:
    """Return an array as float32 or float64 with full scale at 1, in this machine's byte order, row after row."""
    kind = array.dtype.newbyteorder("=")
    if kind in (np.uint8, np.uint16):
        values = np.empty(array.shape, np.float32)
        np.divide(array, np.float32(np.iinfo(kind).max), out=values, dtype=np.float32)
        return values
    return array.astype(np.float32 if kind == np.float16 else kind, order="C", copy=False)


def _check_values(path: Path, values: NDArray[Any], cure: str) -> None:
    """Refuse values that are not finite, or of another scale, for which ``cure`` says what to do."""
    low, high = float(values.min()), float(values.max())  # NaN comes through both
    if not (np.isfinite(low) and np.isfinite(high)):
        bad = ~np.isfinite(values)
        first = tuple(int(axis) for axis in np.unravel_index(int(bad.argmax()), bad.shape))
        found = f"{int(bad.sum())} NaN or infinite, the first at {first}"
        raise PredictionError(path, f"expected finite values, found {found}; fix the model")
    if high <= _SCALE_LIMIT:
        return
    share = float(np.mean(values > _SCALE_LIMIT))
    if share > _SCALE_SHARE:
        found = f"{low:.4g} to {high:.4g} with {share:.1%} above {_SCALE_LIMIT:g}"
        advice = f"is it in DN or 0..255? {cure}, or save uint16 with 65535 = 1.0"
        raise PredictionError(path, f"expected values in [0, 1], found {found}: {advice}")


def load_dng(path: Path, sensor: Sensor) -> Frame:
    """Load a prediction that is a DNG, with its own levels.

    Parameters
    ----------
    path
        The file.
    sensor
        The reference's: CFA and size have to be the same.

    Raises
    ------
    PredictionError
        Like :func:`load_prediction`.
    """
    from eldata.raw.reading import read_raw
    from eldata.raw.tiff import read_directories

    if (problem := file_problem(path)) is not None:
        raise PredictionError(path, problem)
    expected = f"expected a mosaic of {sensor.height} x {sensor.width} pixels"
    try:
        pixels = max((directory.pixels for directory in read_directories(path)), default=0)
        if pixels > _MOST_MARGIN * sensor.height * sensor.width:
            raise PredictionError(path, f"{expected} like the reference, found one of {pixels} pixels")
        frame = read_raw(path)
    except RawFileError as error:
        raise PredictionError(path, f"{error.reason}; write it again, for example with eldata.raw.write_dng") from error
    if frame.sensor.cfa != sensor.cfa or frame.mosaic.shape != (sensor.height, sensor.width):
        found = f"{frame.mosaic.shape[0]} x {frame.mosaic.shape[1]} with {frame.sensor.cfa}"
        raise PredictionError(path, f"{expected} with CFA {sensor.cfa} like the reference, found {found}")
    return Frame.of_decoded(frame)
