"""Predictions made to fill the memory, stall or crash whoever loads them, or to have them read other files.

Run as a program it loads each of them, in a process whose memory is limited, and prints what became of it.
"""

from __future__ import annotations

import json
import os
import resource
import struct
import sys
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import tifffile

from eldata.records import Sensor
from tests.peak import peak_kib

HEIGHT, WIDTH = 64, 96
PACKED = (4, HEIGHT // 2, WIDTH // 2)
SENSOR = Sensor("Maker", "Model", ((0, 1), (3, 2)), (512.0,) * 4, 16383.0, HEIGHT, WIDTH, None, None)
ELSEWHERE = "what is hidden"
"""What lies in other files, and no message may hold."""
ENDLESS_BYTES = 64 << 20
MEMORY_BYTES = 2 << 30


def good() -> np.ndarray[Any, np.dtype[np.float32]]:
    return np.random.default_rng(5).random(PACKED, dtype=np.float32)


def grey() -> np.ndarray[Any, np.dtype[np.uint16]]:
    return np.random.default_rng(6).integers(0, 65535, (HEIGHT, WIDTH), dtype=np.uint16)


# --- npy and npz --------------------------------------------------------------------------------------------------


def npy(header: str, data: bytes = b"", version: bytes = b"\x01\x00", length: int | None = None) -> bytes:
    text = header.encode() + b"\n"
    size = len(text) if length is None else length
    return b"\x93NUMPY" + version + size.to_bytes(2 if version == b"\x01\x00" else 4, "little") + text + data


def described(shape: str, descr: str = "'<f4'") -> str:
    return f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}"


NPY: dict[str, bytes] = {
    "shape-of-terabytes": npy(described("(4, 1000000, 1000000)"), bytes(100)),
    "shape-that-overflows": npy(described("(4294967296, 4294967296)"), bytes(100)),
    "right-shape-and-no-data": npy(described(str(PACKED))),
    "right-shape-and-one-byte-less": npy(described(str(PACKED)), bytes(4 * 4 * 32 * 48 - 1)),
    "header-of-gigabytes": npy(described(str(PACKED)), version=b"\x02\x00", length=0xFFFFFFFF),
    "header-of-60000-brackets": npy("(" * 60_000),
    "header-that-calls": npy(described("__import__('os').system('true')")),
    "header-of-a-bomb-of-types": npy(described(str(PACKED), "'" + "f4," * 1000 + "'")),
    "type-of-gigabytes": npy(described("(1,)", "'|V2147483647'"), bytes(100)),
    "type-of-objects": npy(described(str(PACKED), "'|O'"), bytes(4 * 4 * 32 * 48)),
    "type-of-records": npy(described(str(PACKED), "[('a', '<f4', (1000000, 1000000))]"), bytes(100)),
}


def member(path: Path, content: bytes, method: int = zipfile.ZIP_DEFLATED) -> None:
    with zipfile.ZipFile(path, "w", method) as archive:
        archive.writestr("prediction.npy", content)


def endless_member(path: Path, header: bytes) -> None:
    """A header, and 64 MiB of zeros in 64 kB."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("prediction.npy", "w") as file:
        file.write(header)
        for _ in range(ENDLESS_BYTES >> 20):
            file.write(bytes(1 << 20))


def odd_names(path: Path) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("\x1b[31ma.npy", b"")
        archive.writestr("b\u202e.npy", b"")


NPZ: dict[str, Callable[[Path], None]] = {
    "bomb": lambda path: endless_member(path, npy(described("(4000, 4000)"))),
    "bomb-after-the-array": lambda path: endless_member(path, npy(described(str(PACKED)))),
    "bzip2": lambda path: member(path, npy(described(str(PACKED)), good().tobytes()), zipfile.ZIP_BZIP2),
    "names-with-escapes": odd_names,
    "not-an-array": lambda path: member(path, b"text"),
}

# --- h5 -----------------------------------------------------------------------------------------------------------


def h5(write: Callable[[h5py.File], None]) -> Callable[[Path], None]:
    def save(path: Path) -> None:
        with h5py.File(path, "w") as file:
            write(file)

    return save


def chunked(file: h5py.File, content: bytes) -> None:
    """One chunk that is the whole array, with these bytes."""
    dataset = file.create_dataset("prediction", PACKED, "<f4", chunks=PACKED, compression="gzip")
    dataset.id.write_direct_chunk((0, 0, 0), content)


def deflated_zeros(count: int) -> bytes:
    stream = zlib.compressobj(9)
    return b"".join([*(stream.compress(bytes(1 << 20)) for _ in range(count >> 20)), stream.flush()])


def secret_beside(path: Path) -> str:
    """Another file that a prediction refers to, which holds what it should not be able to show."""
    beside = path.parent / "elsewhere"
    beside.mkdir(exist_ok=True)
    (beside / "secret.bin").write_bytes(ELSEWHERE.encode() * 10_000)
    with h5py.File(beside / "secret.h5", "w") as file:
        file["prediction"] = good()
    tifffile.imwrite(beside / "secret.tif", good(), photometric="minisblack")
    return str(beside)


def external_link(path: Path) -> None:
    beside = secret_beside(path)
    with h5py.File(path, "w") as file:
        file["prediction"] = h5py.ExternalLink(f"{beside}/secret.h5", "prediction")


def external_storage(path: Path) -> None:
    beside = secret_beside(path)
    with h5py.File(path, "w") as file:
        file.create_dataset("prediction", PACKED, "<f4", external=[(f"{beside}/secret.bin", 0, h5py.h5f.UNLIMITED)])


def virtual(path: Path) -> None:
    beside = secret_beside(path)
    layout = h5py.VirtualLayout(PACKED, "<f4")
    layout[...] = h5py.VirtualSource(f"{beside}/secret.h5", "prediction", PACKED)
    with h5py.File(path, "w") as file:
        file.create_virtual_dataset("prediction", layout)


def half_written(file: h5py.File) -> None:
    dataset = file.create_dataset("prediction", PACKED, "<f4", chunks=(1, *PACKED[1:]))
    dataset[:2] = 0.5


def damaged_checksum(file: h5py.File) -> None:
    file.create_dataset("prediction", data=good(), chunks=PACKED, fletcher32=True)
    mask, content = file["prediction"].id.read_direct_chunk((0, 0, 0))
    file["prediction"].id.write_direct_chunk((0, 0, 0), content[:99] + b"?" + content[100:], filter_mask=mask)


def thousands_of_items(file: h5py.File) -> None:
    for number in range(1500):
        file.create_group(f"{number:04d}")


H5: dict[str, Callable[[Path], None]] = {
    "fill-values-of-gigabytes": h5(lambda file: file.create_dataset("x", (4, 30_000, 30_000), "<f4", chunks=True)),
    "right-shape-never-written": h5(lambda file: file.create_dataset("x", PACKED, "<f4")),
    "right-shape-half-written": h5(half_written),
    "external-link": external_link,
    "external-storage": external_storage,
    "virtual": virtual,
    "records": h5(lambda file: file.create_dataset("x", PACKED, np.dtype([("a", "<f4")]))),
    "texts": h5(lambda file: file.create_dataset("x", PACKED, h5py.string_dtype())),
    "chunk-of-gigabytes": h5(
        lambda file: file.create_dataset("x", PACKED, "<f4", chunks=(4, 16_000, 16_000), maxshape=(None,) * 3)
    ),
    "chunk-that-ends-early": h5(lambda file: chunked(file, zlib.compress(good().tobytes())[:2000])),
    "checksum": h5(damaged_checksum),
    "thousands-of-items": h5(thousands_of_items),
}

# --- png ----------------------------------------------------------------------------------------------------------


def chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def png(*chunks: bytes) -> bytes:
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks) + chunk(b"IEND", b"")


def header(width: int = WIDTH, height: int = HEIGHT, depth: int = 16, colour: int = 0, interlace: int = 0) -> bytes:
    return chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, interlace))


ROWS = zlib.compress(b"".join(b"\0" + row.astype(">u2").tobytes() for row in grey()))
PIXELS = chunk(b"IDAT", ROWS)

PNG: dict[str, bytes] = {
    "30000-by-30000": png(header(30_000, 30_000), chunk(b"IDAT", deflated_zeros(ENDLESS_BYTES))),
    "2-billion-by-2-billion": png(header(0x7FFFFFFF, 0x7FFFFFFF), PIXELS),
    "endless-data": png(header(), *[chunk(b"IDAT", bytes(1 << 18))] * 8),
    "header-twice": png(header(), header(30_000, 30_000), PIXELS),
    "no-pixels": png(header()),
    "half-of-the-pixels": png(header(), chunk(b"IDAT", ROWS[: len(ROWS) // 2])),
    "chunk-of-gigabytes": b"\x89PNG\r\n\x1a\n" + header() + b"\xff\xff\xff\xffIDAT" + bytes(100),
    "no-end": b"\x89PNG\r\n\x1a\n" + header() + PIXELS,
    "checksum": png(header(), PIXELS[:-1] + b"?"),
}

# --- tiff ---------------------------------------------------------------------------------------------------------


def tiff(path: Path, array: Any, **options: Any) -> None:
    tifffile.imwrite(path, array, photometric="minisblack", **options)


def with_tags(path: Path, changes: dict[int, tuple[int, int, int]], **options: Any) -> None:
    """A good file of one page, some of whose tags are another type, number and value."""
    tiff(path, grey(), metadata=None, **{"rowsperstrip": HEIGHT} | options)
    content = bytearray(path.read_bytes())
    (at,) = struct.unpack_from("<I", content, 4)
    (count,) = struct.unpack_from("<H", content, at)
    for entry in range(at + 2, at + 2 + 12 * count, 12):
        tag = struct.unpack_from("<H", content, entry)[0]
        if tag in changes:
            kind, number, value = changes[tag]
            struct.pack_into("<HII", content, entry + 2, kind, number, value)
    path.write_bytes(content)


def content(data: bytes) -> Callable[[Path], None]:
    def save(path: Path) -> None:
        path.write_bytes(data)

    return save


def ome(path: Path) -> None:
    """A page whose description says that the pixels are in another file."""
    beside = secret_beside(path)
    description = (
        '<?xml version="1.0"?><OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06"><Image ID="Image:0">'
        '<Pixels ID="Pixels:0" DimensionOrder="XYCZT" Type="float" SizeX="48" SizeY="32" SizeC="4" SizeZ="1" '
        'SizeT="1">'
        f'<TiffData IFD="0" PlaneCount="4"><UUID FileName="{beside}/secret.tif">urn:uuid:x</UUID></TiffData>'
        "</Pixels></Image></OME>"
    )
    tiff(path, good()[0], metadata=None, description=description)


def sparse(path: Path) -> None:
    """Half of the strips are not there, which readers fill with zeros."""
    tiff(path, grey(), metadata=None, rowsperstrip=HEIGHT // 4)
    content = bytearray(path.read_bytes())
    with tifffile.TiffFile(path) as file:
        tags = [file.pages.first.tags[name] for name in ("StripOffsets", "StripByteCounts")]
    for tag in tags:
        struct.pack_into("<2I" if int(tag.dtype) == 4 else "<2H", content, tag.valueoffset, 0, 0)
    path.write_bytes(content)


TIFF: dict[str, Callable[[Path], None]] = {
    "30000-by-30000": lambda path: with_tags(path, {256: (4, 1, 30_000), 257: (4, 1, 30_000), 278: (4, 1, 30_000)}),
    "100-pages": lambda path: tiff(path, np.zeros((100, 4, 6), np.uint16), metadata=None),
    "pixels-in-another-file": ome,
    "strips-missing": sparse,
    "strip-beyond-the-end": lambda path: with_tags(path, {273: (4, 1, 100_000)}),
    "strip-of-gigabytes": lambda path: with_tags(path, {279: (4, 1, 0xFFFFFFFF)}),
    "tiles-of-gigabytes": lambda path: with_tags(
        path, {322: (4, 1, 65_536), 323: (4, 1, 65_536)}, rowsperstrip=None, tile=(64, 64), compression="zlib"
    ),
    "compression-of-tomorrow": lambda path: with_tags(path, {259: (3, 1, 60_000)}),
    "no-pages": content(b"II*\0\0\0\0\0" + bytes(100)),
    "first-page-beyond-the-end": content(b"II*\0\xff\xff\xff\xff" + bytes(100)),
}


# --- what is not a file -------------------------------------------------------------------------------------------


SPECIAL: dict[str, Callable[[Path], None]] = {
    "named-pipe": os.mkfifo,
    "link-to-a-device": lambda path: path.symlink_to("/dev/zero"),
    "folder": lambda path: path.mkdir(),
    "link-to-nothing": lambda path: path.symlink_to("nothing"),
}


def write_all(folder: Path) -> list[str]:
    """Write every file; return their names."""
    every: dict[str, Any] = {"npy": NPY, "png": PNG, "npz": NPZ, "h5": H5, "tif": TIFF, "dng": {}}
    for extension, kinds in every.items():
        for name, made in (kinds | SPECIAL).items():
            write = content(made) if isinstance(made, bytes) else made
            write(folder / f"{name}.{extension}")
    return sorted(path.name for path in folder.iterdir() if path.name != "elsewhere")


def main(folder: Path) -> None:
    """Load each prediction; print the kind of error that it ended in, and the peaks of memory before and after."""
    from eldata.errors import PredictionError
    from eldata.evaluation.predictions import load_prediction

    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    np.save(folder / "elsewhere" / "good.npy", good())
    tiff(folder / "elsewhere" / "good.tif", grey())
    for name in ("good.npy", "good.tif", "secret.h5"):  # libraries are loaded
        load_prediction(folder / "elsewhere" / name, SENSOR, "metadata")
    before_kib = peak_kib()
    outcomes = {}
    for path in sorted(folder.iterdir()):
        if path.name == "elsewhere":
            continue
        print(path.name, file=sys.stderr, flush=True)
        try:
            load_prediction(path, SENSOR, "metadata")
            outcomes[path.name] = "loaded"
        except PredictionError as error:
            outcomes[path.name] = f"refused: {error.reason}"
        except BaseException as error:  # noqa: BLE001 # whatever it is, it is what this program looks for
            outcomes[path.name] = f"{type(error).__name__}: {error}"
    print(json.dumps({"outcomes": outcomes, "before_kib": before_kib, "peak_kib": peak_kib()}))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
