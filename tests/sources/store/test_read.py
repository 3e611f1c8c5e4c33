"""Opening stores: what is refused and how; reading parts, by threads and after forks; verification."""

from __future__ import annotations

import os
import pickle
import shutil
import signal
import struct
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from eldata.errors import DatasetError
from eldata.raw import read_raw
from eldata.sources.store import Store, build_store, verify_store
from eldata.sources.store.read import VERSION, StoreError
from tests.sources.store.helpers import SHAPES, Packed, pack_folder, write_clean
from tests.waiting import PATIENCE_S

# Python 3.12 and later warn of any fork in a process that has threads.
pytestmark = pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Packed:
    folder = tmp_path_factory.mktemp("clean")
    return pack_folder(write_clean(folder / "raws"), folder / "clean.h5", compression="lz4")


@pytest.fixture
def own(clean: Packed, tmp_path: Path) -> Path:
    """A copy to spoil."""
    return Path(shutil.copy(clean.store, tmp_path / "store.h5"))


@pytest.mark.parametrize(("mode", "options"), [("r", {}), ("r+", {"libver": "latest"})])
def test_a_store_that_the_callers_h5py_holds_open(mode: str, options: dict[str, Any], own: Path) -> None:
    whole = Store(own)
    with h5py.File(own, mode, **options):
        assert Store(own).frames == whole.frames
        read_all(own)


# --- refusals -----------------------------------------------------------------------------------------------------


def read_all(path: Path) -> None:
    store = Store(path)
    for frame in store.frames:
        store.frame(frame.path).whole()


def refused(path: Path, reason: str, *works: Callable[[Path], object]) -> None:
    for work in works or (Store, verify_store):
        with pytest.raises(StoreError, match=reason) as caught:
            work(path)
        assert str(caught.value).startswith(f"{path}: ")


def edit(change: Callable[[h5py.File], object]) -> Callable[[Path], None]:
    def spoil(path: Path) -> None:
        with h5py.File(path, "r+") as file:
            change(file)

    return spoil


def make_pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def write_hdf5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file["x"] = np.zeros(3)


def write_facts(file: h5py.File) -> None:
    del file["facts"]
    file["facts"] = np.frombuffer(b"\x01", np.uint8)


WRITER = rf"written by eldata .*; .* reads version {VERSION}: "


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda path: path.unlink(), "cannot be read: No such file or directory"),
        (make_pipe, "is a pipe, device or socket, not a file"),
        (lambda path: path.write_text("path,role"), "is not an HDF5 file; eldata pack makes stores"),
        (write_hdf5, "is an HDF5 file, but not a store of eldata"),
        (lambda path: os.truncate(path, 0), r"is empty \(0 bytes\)"),
        (lambda path: os.truncate(path, path.stat().st_size - 200), "is damaged .*truncated file.*; copy or pack it"),
        (edit(lambda file: file.attrs.update(version=VERSION + 1)), f"{WRITER}install a newer one"),
        (edit(lambda file: file.attrs.update(version=VERSION - 1)), f"{WRITER}pack it again"),
        (edit(lambda file: file["frames"].pop("000001")), "expected 4 frames, found 3"),
        (edit(lambda file: file.pop("frames")), "is damaged"),
        (edit(lambda file: file.attrs.update(compression="gzip")), "unknown compression 'gzip'"),
        (edit(write_facts), "is damaged .*what it states of its frames is not what was written"),
    ],
)
def test_a_damaged_store(spoil: Callable[[Path], object], reason: str, own: Path) -> None:
    spoil(own)
    refused(own, reason)


# --- verification -------------------------------------------------------------------------------------------------


def test_verification_finds_another_pixel(own: Path) -> None:
    for level, hashed in (("quick", 0), ("full", 4)):
        report = verify_store(own, level=level, workers=2)  # type: ignore[arg-type]
        assert report.ok
        assert (report.datasets[0].files_checked, report.datasets[0].files_hashed) == (4, hashed)
        assert report.format_text() == f"raws: 4 of 4 files checked ({level}) in {own}: all well"
    with h5py.File(own, "r+") as file:
        file["frames/000001"][130, 258] ^= 1
    assert verify_store(own).ok
    (problem,) = verify_store(own, level="full", workers=2).problems
    assert (problem.path, problem.field) == ("1.dng", "sha256 of the pixels")


@pytest.mark.parametrize("codec", ["lz4", "zstd"])
def test_damaged_chunks_are_found(codec: Any, tmp_path: Path) -> None:
    """Sizes that lie among them: bitshuffle believes them, and without HDF5's checksum some end the process."""
    own = pack_folder(write_clean(tmp_path / "raws", 1), tmp_path / "store.h5", compression=codec).store
    whole = own.read_bytes()
    with h5py.File(own) as file:
        place = file["frames/000000"].id.get_chunk_info(0)
    lies = [(0, ">Q", value) for value in (2**17 + 16, 2**63, 0)]  # of the chunk
    lies += [(8, ">I", value) for value in (0, 6, 2**32 - 16)]  # of a block decoded
    lies += [(12, ">I", value) for value in (0, 2**32 - 1)]  # of the first block
    spoilt = [(at, struct.pack(form, value)) for at, form, value in lies]
    for at, value in [*spoilt, (0, bytes(place.size)), (0, bytes(512))]:
        content = bytearray(whole)
        content[place.byte_offset + at : place.byte_offset + at + len(value)] = value
        own.write_bytes(content)
        assert [problem.path for problem in verify_store(own, level="full").problems] == ["0.dng"]
        refused(own, "frame 000000 is damaged", read_all)
    entry = struct.pack("<2I4Q", place.size, 0, 0, 0, 0, place.byte_offset)  # in HDF5's index; a chunk of no bytes
    assert whole.count(entry) == 1
    (tmp_path / "other.h5").write_bytes(whole.replace(entry, bytes(4) + entry[4:]))
    refused(tmp_path / "other.h5", "expected 4 chunks, found 3 chunks", read_all)


def test_other_and_missing_pixels_are_found(own: Path) -> None:
    with h5py.File(own, "r+") as file:
        pixels = file["frames/000000"][...]
        for name in ("000000", "000002", "000003"):
            del file["frames"][name]
        file["frames"].create_dataset("000003", (64, 64), np.uint16)
        file["frames"].create_dataset("000000", pixels.shape, np.uint16, chunks=(256, 256))[:256] = pixels[:256]
        file["frames"].create_dataset("000002", SHAPES[2], np.uint16)
        file.move("frames/000001", "frames/000009")
    found = {problem.path: (problem.expected, problem.found) for problem in verify_store(own).problems}
    assert found == {
        "0.dng": ("4 chunks", "2 chunks"),
        "1.dng": ("a frame 000001", "nothing"),
        "2.dng": ("one piece", "nothing"),
        "3.dng": ("uint16 (150, 133)", "uint16 (64, 64)"),
    }
    for number, problem in ((0, "4 chunks, found 2 chunks"), (2, "one piece, found nothing")):
        read = lambda path, number=number: Store(path).frame(f"{number}.dng").whole()  # noqa: E731
        refused(own, rf"frame 00000{number} is damaged \(expected {problem}\)", read)


# --- reading ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("compression", ["none", "lz4"])
def test_parts_are_the_files_pixels(compression: Any, clean: Packed, tmp_path: Path) -> None:
    """Of a mapping they are views, aligned, and not to be written to."""
    store = build_store(clean.source, tmp_path / "store.h5", compression=compression)
    generator = np.random.default_rng(0)
    for held in store.frames:
        mosaic, frame = read_raw(clean.source.folder / held.path).mosaic, store.frame(held.path)
        assert (frame.shape, frame.mosaic.dtype, frame.sensor) == (mosaic.shape, mosaic.dtype, held.sensor)
        np.testing.assert_array_equal(frame.whole(), mosaic)
        for _ in range(30):
            top, bottom = sorted(generator.integers(0, mosaic.shape[0] + 1, 2).tolist())
            left, right = sorted(generator.integers(0, mosaic.shape[1] + 1, 2).tolist())
            part = slice(top, bottom), slice(left, right)
            np.testing.assert_array_equal(frame.read(*part), mosaic[part])
        corner = frame.read(slice(-20, None), slice(None, 5))
        np.testing.assert_array_equal(corner, mosaic[-20:, :5])
        assert corner.flags.writeable == (compression == "lz4")
        assert corner.__array_interface__["data"][0] % 2 == 0
    assert not any(isinstance(held, np.ndarray) and held.flags.owndata for held in store.reader._opened.values())


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
@pytest.mark.parametrize("compression", ["none", "lz4"])
def test_forks_while_threads_read(compression: Any, clean: Packed, tmp_path: Path) -> None:
    """Each child reads the same pixels, and no thread of the parent meets anything."""
    store = build_store(clean.source, tmp_path / "store.h5", compression=compression)
    ended = threading.Event()
    frames = [store.frame(held.path) for held in store.frames]
    mosaics = [read_raw(clean.source.folder / held.path).mosaic for held in store.frames]

    def read(number: int) -> None:
        while not ended.is_set():
            number = (number + 1) % len(frames)
            part = frames[number].read(slice(9, 50), slice(9, 50))
            np.testing.assert_array_equal(part, mosaics[number][9:50, 9:50])

    with ThreadPoolExecutor(4) as threads:
        readings = [threads.submit(read, number) for number in range(4)]
        try:
            for _ in range(30):
                child = os.fork()
                if child == 0:
                    signal.alarm(int(PATIENCE_S))  # ends a child that waits for ever
                    same = all(np.array_equal(f.whole(), mosaic) for f, mosaic in zip(frames, mosaics, strict=True))
                    os._exit(0 if same else 1)
                assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
        finally:
            ended.set()
        for reading in readings:
            reading.result()


@pytest.mark.parametrize("compression", ["none", "lz4"])
@pytest.mark.parametrize("share", [0.5, 2.0])
def test_a_store_that_changes_under_an_open_dataset(
    share: float, compression: Any, clean: Packed, tmp_path: Path
) -> None:
    """To touch the pages that a mapping has lost would end the process by SIGBUS."""
    path = tmp_path / "store.h5"
    frame = build_store(clean.source, path, compression=compression).frame("0.dng")
    frame.whole()
    size = path.stat().st_size
    os.truncate(path, int(size * share))
    refused(path, f"had {size} bytes when it was opened and has {int(size * share)} now; ", lambda _: frame.whole())


def test_a_store_that_is_replaced_by_renaming(own: Path, tmp_path: Path) -> None:
    """The open file is read on; a process that opens the name for the first time is not given other pixels."""
    store = Store(own)
    before = store.frame("0.dng").whole().copy()
    with pytest.raises(DatasetError, match="holds no frame 'none'"):
        store.frame("none")
    same = pickle.loads(pickle.dumps(store))
    np.testing.assert_array_equal(same.frame("0.dng").whole(), before)
    other = pack_folder(write_clean(tmp_path / "raws", 5), tmp_path / "other.h5")
    other.store.replace(own)
    np.testing.assert_array_equal(store.frame("0.dng").whole(), before)
    copy = pickle.loads(pickle.dumps(store))
    refused(own, "is another store than the one that was opened", lambda _: copy.frame("0.dng").whole())
