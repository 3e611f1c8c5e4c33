"""What a raw file says, and whether it decodes and is whole, without its pixels.

Light: where isolation is on, numpy and the decoder are loaded only by the process that decodes.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from eldata.base.isolation import guarded_file
from eldata.errors import RawFileError

if TYPE_CHECKING:
    from pathlib import Path

    from eldata.records import RawHeader, Sensor


def raw_facts(path: Path, *, decode: bool) -> tuple[RawHeader, Sensor | RawFileError | None]:
    """Return a raw file's header and, if it is to be decoded, its sensor, or why it does not decode or is damaged.

    The header has what there is to remark of the file; one whose black level takes its pixels is decoded for it.

    Every check that finds damage is made (:mod:`eldata.raw.damage`), so it takes about twice as long as decoding where
    the file has lossless JPEGs.

    Raises
    ------
    RawFileError
        Like :func:`eldata.raw.read_header`.
    """
    return guarded_file(partial(_facts, decode=decode), path, RawFileError)


def _facts(path: Path, *, decode: bool) -> tuple[RawHeader, Sensor | RawFileError | None]:
    from eldata.raw.black_levels import TAKING_PIXELS
    from eldata.raw.damage import check_streams
    from eldata.raw.reading import read_header, read_raw
    from eldata.raw.tiff import read_directories

    header = read_header(path)
    if not decode and not any(set(TAKING_PIXELS) & one.values.keys() for one in read_directories(path)):
        return header, None
    try:
        frame = read_raw(path)
        if decode:
            check_streams(path)
    except RawFileError as error:
        return header, error
    return replace(header, remarks=frame.remarks), frame.sensor
