"""What all frames of a store state, in one dataset beside them: a store is opened by it, not by their attributes.

::

    /table      JSON as uint8; of all frames, in their order: "path", "role", "sha256" as the attributes have them,
                "file" as {"size_bytes": [...], "sha256": [...], "decoder": [...]};
                "sensor", "sensor_more", "exposure", "channel_white_levels_dn" as {"texts": those that there are,
                "of": numbers of texts, with spaces between them, -1 for none}

HDF5 takes about a millisecond for the attributes of a frame, which is minutes of 100,000. Stores with RGB frames have
no table and are opened by the attributes, which stay what counts: ``eldata verify`` compares.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.base.fields import TextFile
from eldata.errors import ArgumentError
from eldata.records import from_columns
from eldata.sources.store.format import RGB, PackedFile, StoredFrame, exposure_in, sensor_in, white_levels_in

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

TABLE = "table"
_OWN = ("path", "role", "sha256")
_FILE = {"size_bytes": int, "sha256": str, "decoder": str}
_SHARED = ("sensor", "sensor_more", "exposure", "channel_white_levels_dn")


def frame_key(number: int) -> str:
    """Return the name of a frame's HDF5 dataset, by its place in the order in which frames were packed."""
    return f"{number:06d}"


def store_table(attributes: Sequence[Mapping[str, Any]]) -> NDArray[np.uint8] | None:
    """Return the table of frames, given the attributes of each; ``None`` if there is an RGB frame."""
    if any(each.get("kind") == RGB for each in attributes):
        return None
    columns: dict[str, Any] = {name: [str(each[name]) for each in attributes] for name in _OWN}
    files = [*map(PackedFile.stated, attributes)]
    columns["file"] = {name: [getattr(file, name) for file in files] for name in _FILE}
    for name in _SHARED:
        numbers: dict[str, int] = {}
        of = [numbers.setdefault(str(each[name]), len(numbers)) if name in each else -1 for each in attributes]
        columns[name] = {"texts": list(numbers), "of": " ".join(map(str, of))}
    return np.frombuffer(json.dumps(columns, separators=(",", ":")).encode(), np.uint8)


def frames_in_table(content: bytes) -> list[StoredFrame]:
    """Return the frames that a table states; those that state the same share one record of it.

    Raises
    ------
    ValueError, LookupError, TypeError
        If it is not what :func:`store_table` makes.
    """
    data = TextFile(TABLE, ArgumentError, content=content).json().data
    columns = {name: _of_kind(name, data[name], str) for name in _OWN}
    files = {name: _of_kind(name, data["file"][name], kind) for name, kind in _FILE.items()}
    columns["file"] = from_columns(PackedFile, files)
    sensors, more = _texts(data["sensor"]), _texts(data["sensor_more"])
    columns["sensor"] = _made(sensor_in, zip(sensors, more, strict=True))
    columns["exposure"] = _made(exposure_in, zip(_texts(data["exposure"])))
    columns["channel_white_levels_dn"] = _made(white_levels_in, zip(_texts(data["channel_white_levels_dn"])))
    count = len(columns["path"])
    rows = {*map(len, (*columns.values(), *files.values()))}
    if rows != {count}:
        raise ValueError(f"the table's columns have {sorted(rows)} rows")
    columns["key"] = [*map(frame_key, range(count))]
    return from_columns(StoredFrame, columns)


def _of_kind(name: str, values: Any, kind: type) -> list[Any]:
    if not isinstance(values, list) or not {*map(type, values)} <= {kind}:
        raise TypeError(f"the table's column {name} holds other things than {kind.__name__}")
    return values


def _texts(column: Mapping[str, Any]) -> list[str | None]:
    """Return the text of each frame in a column of texts that frames share."""
    texts: list[str | None] = [*_of_kind("texts", column["texts"], str), None]
    numbers = [*map(int, column["of"].split())]
    if not all(number >= -1 for number in {*numbers}):
        raise ValueError("the table names a text before the first one")
    return [texts[number] for number in numbers]


def _made(make: Callable[..., Any], arguments: Any) -> list[Any]:
    """Return what is made of each frame's texts, each kind once."""
    known: dict[Any, Any] = {}
    found = []
    for texts in arguments:
        if texts not in known:
            known[texts] = make(*texts)
        found.append(known[texts])
    return found
