"""Predictions on disk: loading, checking and saving them.

For a noisy frame ``SonyA7S2/scene-1/IMG_0004.ARW`` the prediction is ``PREDS/SonyA7S2/scene-1/IMG_0004.<ext>``. It is
packed (C, h, w) or a mosaic (H, W); float in [0, 1] of the reference's normalised signal, or uint16 where
65535 = 1.0; a DNG holds raw DN. Protocols whose predictions are in sRGB take renderings: an RGB PNG or TIFF of 8 or 16
bits, or RGB arrays; of the mosaic's size under ``sid2018``, else of a pixel for each packed one.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from eldata.base.arrays import read_array
from eldata.base.files import atomic_write, file_problem
from eldata.errors import ArgumentError, PredictionError, RawFileError
from eldata.evaluation.layouts import stem_of
from eldata.raw.levels import pack, packed_shape, with_levels
from eldata.sources.frames import Frame

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from eldata.base.arrays import Declared
    from eldata.manifest.clips import ClipRecord
    from eldata.protocols.protocol import Levels
    from eldata.records import Sensor

# A prediction near [0, 1] has next to nothing above 2, even where it is an amplified noisy frame with hot pixels.
_SCALE_LIMIT = 2.0
_SCALE_SHARE = 1e-3

_MOST_MARGIN = 2  # pixels of a DNG, over those of the mosaic: it may have masked borders


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


def load_prediction(path: Path, sensor: Sensor, levels: Levels) -> NDArray[np.float32 | np.float64]:
    """Load a prediction and check it against the reference's sensor.

    Parameters
    ----------
    path
        A file of one of :data:`eldata.evaluation.layouts.EXTENSIONS`.
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
        A file of one of :data:`eldata.evaluation.layouts.EXTENSIONS` but dng. A rendering: an RGB PNG or TIFF of 8 or
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
    """Refuse what is neither packed nor a mosaic like the reference, of numbers that have a scale."""
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
    """Refuse what is not a rendering, or not a frame, of the reference's size."""
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
        raise PredictionError(
            path,
            f"expected finite values, found {int(bad.sum())} NaN or infinite, the first at {first}; mend the model",
        )
    if high <= _SCALE_LIMIT:
        return
    share = float(np.mean(values > _SCALE_LIMIT))
    if share > _SCALE_SHARE:
        raise PredictionError(
            path,
            f"expected values in [0, 1], found {low:.4g} to {high:.4g} with {share:.1%} above {_SCALE_LIMIT:g}: is it "
            f"in DN or 0..255? {cure}, or save uint16 with 65535 = 1.0",
        )


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

    problem = file_problem(path)
    if problem is not None:
        raise PredictionError(path, problem)
    try:
        pixels = max((directory.pixels for directory in read_directories(path)), default=0)
        if pixels > _MOST_MARGIN * sensor.height * sensor.width:
            raise PredictionError(
                path,
                f"expected a mosaic of {sensor.height} x {sensor.width} pixels like the reference, found one of "
                f"{pixels} pixels",
            )
        frame = read_raw(path)
    except RawFileError as error:
        raise PredictionError(path, f"{error.reason}; write it again, for example with eldata.raw.write_dng") from error
    if frame.sensor.cfa != sensor.cfa or frame.mosaic.shape != (sensor.height, sensor.width):
        raise PredictionError(
            path,
            f"expected a mosaic of {sensor.height} x {sensor.width} pixels with CFA {sensor.cfa} like the reference, "
            f"found {frame.mosaic.shape[0]} x {frame.mosaic.shape[1]} with {frame.sensor.cfa}",
        )
    return Frame.of_decoded(frame)
