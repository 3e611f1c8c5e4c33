"""Predictions in every form that is read, some of which tempt a reader to copy them more often than needed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeAlias

import h5py
import imagecodecs
import numpy as np
import tifffile
from numpy.typing import NDArray
from PIL import Image

from tests.evaluation import hostile_predictions as hostile

Writer: TypeAlias = Callable[[Path, NDArray[Any]], None]


def save_npy(path: Path, array: NDArray[Any]) -> None:
    with path.open("wb") as file:  # given a name, numpy would add .npy
        np.save(file, array)


def save_fortran(path: Path, array: NDArray[Any]) -> None:
    save_npy(path, np.asfortranarray(array))


def save_of_python_2(path: Path, array: NDArray[Any]) -> None:
    header = "{'descr': '<f4', 'fortran_order': False, 'shape': (4L, 32L, 48L), }"
    path.write_bytes(hostile.npy(header, array.tobytes()))


def pillow(**options: Any) -> Writer:
    """A writer of one page, or of several: Pillow fills them up to 16 bytes."""

    def save(path: Path, array: NDArray[Any]) -> None:
        first, *more = [Image.fromarray(plane) for plane in (array if array.ndim == 3 else array[None])]
        first.save(path, append_images=more, **{"save_all": bool(more)} | options)

    return save


def save_npz(path: Path, array: NDArray[Any]) -> None:
    np.savez(path, array)


def save_deflated(path: Path, array: NDArray[Any]) -> None:
    np.savez_compressed(path, array)


def save_npz_several(path: Path, array: NDArray[Any]) -> None:
    np.savez_compressed(path, other=np.zeros((3, 5)), prediction=array, time_s=np.float64(0.3))


def h5(*, whole: bool = False, **options: Any) -> Writer:
    """``whole``: in one chunk."""

    def save(path: Path, array: NDArray[Any]) -> None:
        with h5py.File(path, "w") as file:
            file.create_dataset("anything", data=array, **({"chunks": array.shape} if whole else {}), **options)

    return save


def save_h5_several(path: Path, array: NDArray[Any]) -> None:
    with h5py.File(path, "w") as file:
        file["features"] = np.zeros(7)
        file.create_dataset("prediction", data=array, compression="gzip")
        file.create_group("meta")


def tif(*, whole: bool = False, **options: Any) -> Writer:
    """``whole``: in one strip."""

    def save(path: Path, array: NDArray[Any]) -> None:
        strip = {"rowsperstrip": array.shape[-2]} if whole else {}
        tifffile.imwrite(path, array, **({"photometric": "minisblack"} | strip | options))

    return save


def save_png(path: Path, array: NDArray[Any]) -> None:
    path.write_bytes(imagecodecs.png_encode(array, level=1))


# What is stored, and how; a PNG holds mosaics alone.
FILES: dict[str, tuple[str, Writer]] = {
    "float16.npy": ("<f2", save_npy),
    "float32.npy": ("<f4", save_npy),
    "float64.npy": ("<f8", save_npy),
    "uint16.npy": ("<u2", save_npy),
    "fortran.npy": ("<f4", save_fortran),
    "big-endian-float64.npy": (">f8", save_npy),
    "big-endian-fortran.npy": (">u2", save_fortran),
    "one.npz": ("<f4", save_npz),
    "several.npz": ("<f8", save_npz_several),
    "deflated.npz": ("<f4", save_deflated),
    "one.h5": ("<f4", h5()),
    "several.h5": ("<u2", save_h5_several),
    "big-endian.h5": (">f8", h5()),
    "one-chunk-gzip-shuffle-checksum.h5": ("<f4", h5(whole=True, compression="gzip", shuffle=True, fletcher32=True)),
    "lzf.h5": ("<f8", h5(compression="lzf")),
    "float32.tif": ("<f4", tif()),
    "deflated.tiff": ("<u2", tif(compression="zlib", byteorder=">")),
    "big-endian.tif": ("<f8", tif(byteorder=">")),
    "pages.tif": ("<f4", tif(metadata=None)),
    "tiles.tif": ("<f4", tif(tile=(32, 64), compression="zlib", predictor=True)),
    "one-strip.tif": ("<f4", tif(whole=True, compression="zlib")),
    "ome.tif": ("<f4", tif(ome=True)),
    "big.tif": ("<f4", tif(bigtiff=True, byteorder=">")),
    "pillow.tif": ("<f4", pillow()),
    "pillow-pages.tif": ("<f4", pillow(save_all=True)),
    "16-bit.png": ("<u2", save_png),
}
OF_PACKED: dict[str, tuple[str, Writer]] = {
    "of-python-2.npy": ("<f4", save_of_python_2),
    "chunks.h5": ("<f4", h5(chunks=(4, 10, 10), maxshape=(None, None, None))),
    "chunks-beyond-its-sides.h5": ("<f4", h5(chunks=(5, 40, 50), maxshape=(None, None, None), compression="gzip")),
    "planes.tif": ("<f4", tif(photometric="rgb", planarconfig="separate")),
}


def quantised(values: NDArray[np.floating[Any]], kind: str) -> tuple[NDArray[Any], NDArray[np.float64]]:
    """What is stored for values in [0, 1], and what it stands for."""
    if kind.endswith("u2"):
        stored: NDArray[Any] = np.rint(values * 65535).astype(kind)
        return stored, stored / 65535
    stored = values.astype(kind)
    return stored, stored.astype(np.float64)
