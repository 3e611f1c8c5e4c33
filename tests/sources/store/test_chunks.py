"""Reading chunks outside of HDF5: h5py is the oracle; what HDF5 alone can read, and chunks that lie."""

from __future__ import annotations

import os
import struct
from typing import TYPE_CHECKING, Any

import h5py
import hdf5plugin
import numpy as np
import pytest

from eldata.sources.store import chunks
from eldata.sources.store.chunks import ChunkError, ChunkTable, chunk_table, read_part

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from numpy.typing import NDArray

# Chunks whose last bitshuffle block is whole, shorter, or has pixels behind it that are not compressed.
SHAPES = [
    ((512, 300), (256, 256)),
    ((131, 515), (131, 256)),
    ((67, 61), (67, 61)),
    ((1, 5), (1, 5)),
    ((3, 70, 90), (1, 64, 64)),
]


def written(folder: Path, shape: tuple[int, ...], chunk: tuple[int, ...], **options: Any) -> tuple[Path, NDArray[Any]]:
    generator = np.random.default_rng(3)
    pixels = (generator.gamma(2.0, 90.0, shape) + 500).astype(np.uint16)  # as noisy DN: they compress by half
    path = folder / "file.h5"
    with h5py.File(path, "w") as file:
        file.create_dataset("frame", data=pixels, chunks=chunk, **options)
    return path, pixels


def parts(height: int, width: int) -> Iterator[tuple[range, range]]:
    yield range(height), range(width)
    generator = np.random.default_rng(0)
    for _ in range(40):
        top, bottom = sorted(generator.integers(0, height + 1, 2).tolist())
        left, right = sorted(generator.integers(0, width + 1, 2).tolist())
        yield range(top, bottom), range(left, right)


@pytest.mark.parametrize("codec", ["none", "lz4", "zstd"])
@pytest.mark.parametrize(("shape", "chunk"), SHAPES)
def test_every_part_is_what_hdf5_reads(
    codec: Any, shape: tuple[int, ...], chunk: tuple[int, ...], tmp_path: Path
) -> None:
    options = {} if codec == "none" else dict(hdf5plugin.Bitshuffle(cname=codec))
    path, pixels = written(tmp_path, shape, chunk, **options)
    planes = pixels.reshape(-1, *shape[-2:])
    with h5py.File(path) as file, path.open("rb") as content:
        table = chunk_table(file["frame"].id)
        assert table is not None
        assert (table.decode is None) == (codec == "none")
        for rows, columns in parts(*shape[-2:]):
            for number, plane in enumerate(planes):
                found = np.empty((len(rows), len(columns)), np.uint16)
                read_part(content.fileno(), table, number, rows, columns, found)
                np.testing.assert_array_equal(found, plane[rows.start : rows.stop, columns.start : columns.stop])


@pytest.mark.parametrize(
    "options", [{"compression": "gzip"}, {"shuffle": True}, dict(hdf5plugin.Bitshuffle(cname="none"))]
)
def test_other_filters_are_left_to_hdf5(options: dict[str, Any], tmp_path: Path) -> None:
    path, _ = written(tmp_path, (64, 64), (64, 64), **options)
    with h5py.File(path) as file:
        assert chunk_table(file["frame"].id) is None


def test_other_pixels_are_left_to_hdf5(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "file.h5", "w") as file:
        file.create_dataset("frame", data=np.zeros((8, 8), ">u2"), chunks=(8, 8))
        assert chunk_table(file["frame"].id) is None


def test_without_the_decoder_hdf5_reads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, _ = written(tmp_path, (64, 64), (64, 64), **dict(hdf5plugin.Bitshuffle(cname="lz4")))
    monkeypatch.setattr(chunks, "_decoder", lambda _: None)
    with h5py.File(path) as file:
        assert chunk_table(file["frame"].id) is None


def read_spoilt(path: Path, table: ChunkTable, place: int, value: bytes) -> None:
    """Read the first chunk with some of its bytes replaced."""
    content = bytearray(path.read_bytes())
    start = int(table.offsets[0, 0, 0]) + place
    content[start : start + len(value)] = value
    path.write_bytes(content)
    with path.open("rb") as file:
        read_part(file.fileno(), table, 0, range(64), range(64), np.empty((64, 64), np.uint16))


@pytest.mark.parametrize(
    ("place", "value"),
    [
        (0, struct.pack(">Q", 64 * 64 * 2 + 8)),  # another size
        (8, struct.pack(">I", 6)),  # no whole group of pixels
        (8, struct.pack(">I", 0)),
        (12, struct.pack(">I", 0)),  # a block of nothing
        (12, struct.pack(">I", 2**31)),  # a block beyond the chunk, which the decoder would believe
        (12, struct.pack(">I", 2**32 - 1)),
        (16, b"\xff" * 40),  # no LZ4
    ],
)
def test_a_chunk_that_lies_is_an_error(place: int, value: bytes, tmp_path: Path) -> None:
    path, _ = written(tmp_path, (64, 64), (64, 64), **dict(hdf5plugin.Bitshuffle(cname="lz4")))
    with h5py.File(path) as file:
        table = chunk_table(file["frame"].id)
    assert table is not None
    with pytest.raises(ChunkError, match="a chunk"):
        read_spoilt(path, table, place, value)


@pytest.mark.parametrize("codec", ["none", "lz4"])
def test_a_file_that_ends_too_soon_is_an_error(codec: Any, tmp_path: Path) -> None:
    """As when it is cut after it was opened; a memory map would end the process."""
    options = {} if codec == "none" else dict(hdf5plugin.Bitshuffle(cname=codec))
    path, _ = written(tmp_path, (64, 64), (64, 64), **options)
    with h5py.File(path) as file:
        table = chunk_table(file["frame"].id)
    assert table is not None
    os.truncate(path, int(table.offsets[0, 0, 0]) + 100)
    with path.open("rb") as content, pytest.raises(ChunkError, match="beyond the end of the file"):
        read_part(content.fileno(), table, 0, range(64), range(64), np.empty((64, 64), np.uint16))


def test_a_chunk_that_was_never_written_is_an_error(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "file.h5", "w") as file:
        file.create_dataset("frame", (64, 64), np.uint16, chunks=(64, 64))
        table = chunk_table(file["frame"].id)
    assert table is not None
    with (tmp_path / "file.h5").open("rb") as content, pytest.raises(ChunkError, match="a chunk of 0 bytes"):
        read_part(content.fileno(), table, 0, range(64), range(64), np.empty((64, 64), np.uint16))
