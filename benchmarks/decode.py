"""Reading one raw file: pixels, levels, EXIF and the checks, beside LibRaw's decoding alone."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from benchmarks import published
from benchmarks.harness import Row, in_turn
from eldata.raw import read_raw

if TYPE_CHECKING:
    from pathlib import Path

    from benchmarks.data import Files


def run(files: Files, rounds: int, _cores: int) -> list[Row]:
    compressed = files.first_pair()[1]
    return [*_rows("uncompressed", files.uncompressed, rounds), *_rows("lossless JPEG", compressed, rounds)]


def _rows(case: str, path: Path, rounds: int) -> list[Row]:
    mosaic = published.decode(path)
    assert np.array_equal(read_raw(path).mosaic, mosaic)
    timings = in_turn(
        rounds,
        {
            "LibRaw alone": lambda: published.decode(path),
            "eldata": lambda: read_raw(path),
            "LibRaw + exifread": lambda: (published.decode(path), published.exposure(path)),
            "copy of the pixels": mosaic.copy,
            "numpy.fromfile": lambda: np.fromfile(path, np.uint16),
        },
    )
    return [
        timings.faster(case, "eldata", "LibRaw + exifread", values="bit-identical"),
        timings.cost(case, "eldata", "LibRaw alone", at_most=0.15 if case == "uncompressed" else None),
        timings.cost(case, "eldata", "numpy.fromfile", at_most=1.5 if case == "uncompressed" else None),
        timings.cost(case, "eldata", "copy of the pixels"),
    ]
