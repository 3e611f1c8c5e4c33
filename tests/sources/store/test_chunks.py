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
from eldata.sources.store.chunks import ChunkError, chunk_table, read_part

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


@pytest.mark.parametrize("codec", ["lz4", "zstd"])
def test_a_chunk_that_lies_is_an_error(codec: Any, tmp_path: Path) -> None:
    """The 22 lies of docs/training.md about its sizes and blocks; of 10 of them HDF5's own filter ends the process."""
    path, pixels = written(tmp_path, (256, 256), (256, 256), **dict(hdf5plugin.Bitshuffle(cname=codec)))
    with h5py.File(path) as file:
        table = chunk_table(file["frame"].id)
    assert table is not None
    content, start, size = path.read_bytes(), int(table.offsets[0, 0, 0]), pixels.nbytes
    (first,) = struct.unpack_from(">I", content, start + 12)  # bytes of the first block
    second = 16 + first
    lies = [(0, ">Q", value) for value in (size + 16, size * 4, 2**40, 2**63, size // 2, 0)]  # of the chunk
    lies += [(8, ">I", value) for value in (0, 6, 16, 2 * 8192, 2**31, 2**32 - 16)]  # of a block decoded
    lies += [(12, ">I", value) for value in (0, first - 1, first + 1, 2**31 - 1, 2**31, 2**32 - 1)]
    lies += [(second, ">I", value) for value in (2**31 - 1, 2**32 - 1)]  # which the decoder would believe
    spoilt = [(place, struct.pack(form, value)) for place, form, value in lies]
    for place, value in [*spoilt, (16, b"\xff" * 40), (16, bytes(40))]:  # neither LZ4 nor zstd
        changed = bytearray(content)
        changed[start + place : start + place + len(value)] = value
        path.write_bytes(changed)
        with path.open("rb") as file, pytest.raises(ChunkError, match="a chunk"):
            read_part(file.fileno(), table, 0, range(256), range(256), np.empty((256, 256), np.uint16))


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
