"""Legal predictions in forms that tempt a reader to copy them more often than needed.

Run as a program it loads each of them, and prints by how much that raised the peak of the process's memory.
"""

from __future__ import annotations

import json
import multiprocessing
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import imagecodecs
import numpy as np
import tifffile

from eldata.evaluation.predictions import load_prediction
from eldata.records import Sensor
from tests.peak import peak_kib

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

HEIGHT, WIDTH = 1600, 2400
SENSOR = Sensor("Maker", "Model", ((0, 1), (3, 2)), (512.0,) * 4, 16383.0, HEIGHT, WIDTH, None, None)
SMALL = replace(SENSOR, height=64, width=96)


def mosaic(kind: str) -> NDArray[Any]:
    values = np.random.default_rng(3).random((HEIGHT, WIDTH), np.float32)
    return np.rint(values * 65535).astype(kind) if kind.lstrip("<>") == "u2" else values.astype(kind)


def h5(path: Path, array: NDArray[Any], **options: Any) -> None:
    with h5py.File(path, "w") as file:
        file.create_dataset("prediction", data=array, **options)


def tif(path: Path, array: NDArray[Any], **options: Any) -> None:
    tifffile.imwrite(path, array, photometric="minisblack", **options)


def png(path: Path, array: NDArray[Any]) -> None:
    path.write_bytes(imagecodecs.png_encode(array, level=1))


AWKWARD: dict[str, Callable[[Path], None]] = {
    "plain.npy": lambda path: np.save(path, mosaic("f4")),
    "float64.npy": lambda path: np.save(path, mosaic("f8")),
    "float16.npy": lambda path: np.save(path, mosaic("f2")),
    "uint16.npy": lambda path: np.save(path, mosaic("u2")),
    "big-endian.npy": lambda path: np.save(path, mosaic(">f8")),
    "fortran.npy": lambda path: np.save(path, np.asfortranarray(mosaic("f4"))),
    "big-endian-fortran.npy": lambda path: np.save(path, np.asfortranarray(mosaic(">u2"))),
    "deflated.npz": lambda path: np.savez_compressed(path, mosaic("f4")),
    "big-endian-deflated.npz": lambda path: np.savez_compressed(path, mosaic(">f8")),
    "one-chunk-gzip-shuffle.h5": lambda path: h5(
        path, mosaic("f4"), chunks=(HEIGHT, WIDTH), compression="gzip", shuffle=True, fletcher32=True
    ),
    "chunks-lzf.h5": lambda path: h5(path, mosaic("f8"), compression="lzf"),
    "one-chunk-lzf.h5": lambda path: h5(path, mosaic("u2"), chunks=(HEIGHT, WIDTH), compression="lzf"),
    "big-endian.h5": lambda path: h5(path, mosaic(">f8")),
    "one-strip-deflated.tif": lambda path: tif(path, mosaic("f4"), compression="zlib", rowsperstrip=HEIGHT),
    "tiles-deflated.tif": lambda path: tif(path, mosaic("f4"), compression="zlib", tile=(256, 256), predictor=True),
    "big-endian.tif": lambda path: tif(path, mosaic("f8"), byteorder=">"),
    "16-bit.png": lambda path: png(path, mosaic("u2")),
}


def times_of_array(folder: Path, small: Path, name: str) -> float:
    """Load a small prediction, which maps libraries, and then the large one; return how often the peak held it."""
    load_prediction(small / name, SMALL, "metadata")
    Path("/proc/self/clear_refs").write_text("5")  # the peak starts again from what is in use now
    before = peak_kib()
    loaded = load_prediction(folder / name, SENSOR, "metadata")
    return (peak_kib() - before) * 1024 / loaded.nbytes


def main(folder: Path, small: Path) -> None:
    """Each in a fork of its own, where no other has left memory that is used again, of a process with all libraries."""
    for name in AWKWARD:
        load_prediction(small / name, SMALL, "metadata")
    with multiprocessing.get_context("fork").Pool(1, maxtasksperchild=1) as pool:
        found = pool.map(partial(times_of_array, folder, small), AWKWARD, chunksize=1)
    print(json.dumps(dict(zip(AWKWARD, found, strict=True))))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
