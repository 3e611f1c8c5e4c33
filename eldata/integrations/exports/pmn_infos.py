"""PMN's infos: pickled lists of dictionaries, as its get_dataset_infos.py makes them."""

from __future__ import annotations

import io
import pickle
from pathlib import PurePosixPath
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.errors import RawFileError
from eldata.integrations.colours import balance_multipliers, matrix_to_srgb
from eldata.manifest.eld import nearest_reference

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from fractions import Fraction

    from eldata.integrations.exports.frames import ExportFrame, ExportPair


def sid_train_info(pairs: Sequence[ExportPair]) -> list[dict[str, Any]]:
    """Return one entry a reference: its facts, ``long``, and ``short`` and ``ratio`` of all of its noisy frames."""
    noisy_of: dict[str, list[ExportPair]] = {}
    for pair in pairs:
        noisy_of.setdefault(pair.reference.path, []).append(pair)
    return [
        _facts(own[0].reference)
        | {
            "ratio": np.array([_ratio(pair.record.ratio) for pair in own]),
            "long": str(own[0].reference.file),
            "short": [str(pair.noisy.file) for pair in own],
        }
        for own in noisy_of.values()
    ]


def sid_evaltest_info(pairs: Sequence[ExportPair]) -> list[dict[str, Any]]:
    """Return one entry a pair, by ratio: PMN's code cuts the list where the ratio changes."""
    return [
        _facts(pair.reference)
        | {"ratio": _ratio(pair.record.ratio), "long": str(pair.reference.file), "short": str(pair.noisy.file)}
        for pair in sorted(pairs, key=lambda pair: pair.record.ratio)
    ]


def eld_info(pairs: Sequence[ExportPair], scenes: Iterable[Mapping[int, str]]) -> list[list[dict[str, Any]]]:
    """Return for each scene an entry a number, from 1 on without a gap: PMN's code counts places, not names.

    Numbers without a frame have their reference's entry, which stands for no ISO and ratio that is asked for.
    """
    frames = {frame.path: frame for pair in pairs for frame in (pair.reference, pair.noisy)}
    ratio_of = {pair.noisy.path: _ratio(pair.record.ratio) for pair in pairs}
    infos = []
    for numbered in scenes:
        last = max(numbered)
        paths = [numbered.get(number, numbered.get(nearest_reference(number))) for number in range(1, last + 1)]
        known = next(path for path in paths if path is not None)
        entries = [path or known for path in paths]
        infos.append(
            [
                _facts(frames[path]) | {"ratio": ratio_of.get(path, 1), "data": str(frames[path].file)}
                for path in entries
            ]
        )
    return infos


def _facts(frame: ExportFrame) -> dict[str, Any]:
    iso, seconds = frame.exposure.iso, frame.exposure.exposure_s
    if iso is None or seconds is None:
        raise RawFileError(frame.file, "states no ISO or no exposure time, which PMN's infos have")
    return {
        "ISO": int(iso),
        "ExposureTime": float(seconds),
        "name": PurePosixPath(frame.path).stem,
        "wb": balance_multipliers(frame.sensor),
        "ccm": matrix_to_srgb(frame.sensor),
    }


def _ratio(ratio: Fraction) -> int | float:
    return ratio.numerator if ratio.denominator == 1 else float(ratio)


class _Pickler(pickle.Pickler):
    """Writes arrays as calls of ``numpy.array``, which every numpy has.

    What numpy 2 writes of itself names modules that the numpy of PMN's code, below 1.20, does not have.
    """

    def reducer_override(self, value: Any) -> Any:
        if isinstance(value, np.ndarray):
            return np.array, (value.tolist(), value.dtype.str)
        return NotImplemented


def pickled(content: Any) -> bytes:
    """Return a list of infos pickled, for any Python 3 and any numpy."""
    out = io.BytesIO()
    _Pickler(out, protocol=2).dump(content)
    return out.getvalue()
