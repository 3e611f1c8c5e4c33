"""Opening stores: what is refused and how; reading parts; verification."""

from __future__ import annotations

import json
import os
import pickle
import shutil
import signal
import struct
import threading
import zlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np
import pytest

from eldata.raw import read_raw
from eldata.sources.store import build_store, open_store, verify_store
from eldata.sources.store.format import VERSION, StoreError
from eldata.sources.store.read import StoreFrames
from tests.sources.store.helpers import SHAPES, Packed, pack_folder, write_clean
from tests.waiting import PATIENCE_S

if TYPE_CHECKING:
    from collections.abc import Callable

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


@pytest.mark.parametrize(("mode", "options"), [("r", {}), ("r+", {"locking": True}), ("r+", {"libver": "latest"})])
def test_a_store_that_the_callers_h5py_holds_open(mode: str, options: dict[str, Any], own: Path) -> None:
    whole = open_store(own)
    with h5py.File(own, mode, **options):
        assert open_store(own).frames == whole.frames
        all_pixels(own)


# --- refusals -----------------------------------------------------------------------------------------------------


def all_pixels(path: Path) -> None:
    source = StoreFrames(path)
    for frame in source.store.frames:
        source.frame(frame.path).whole()


def refused(path: Path, reason: str, *works: Callable[[Path], object]) -> None:
    for work in works or (open_store, verify_store):
        with pytest.raises(StoreError, match=reason) as caught:
            work(path)
        assert str(caught.value).startswith(f"{path}: ")


def test_a_missing_store(tmp_path: Path) -> None:
    refused(tmp_path / "store.h5", "cannot be read: No such file or directory")
    refused(tmp_path, "is a folder, not a file")
    os.mkfifo(tmp_path / "pipe.h5")
    refused(tmp_path / "pipe.h5", "is a named pipe, not a file")


@pytest.mark.parametrize("share", [0.02, 0.999])
def test_a_truncated_store(share: float, own: Path) -> None:
    os.truncate(own, int(own.stat().st_size * share))
    refused(own, "is truncated .*; copy or pack it again")


def test_foreign_files(tmp_path: Path) -> None:
    text, empty, hdf5 = tmp_path / "a.h5", tmp_path / "b.h5", tmp_path / "c.h5"
    text.write_text("path,role")
    empty.touch()
    with h5py.File(hdf5, "w") as file:
        file["x"] = np.zeros(3)
    refused(text, "is not an HDF5 file; eldata pack makes stores")
    refused(empty, r"is empty \(0 bytes\)")
    refused(hdf5, "is an HDF5 file, but not a store of eldata")


@pytest.mark.parametrize(("version", "advice"), [(VERSION + 1, "install a newer one"), (VERSION - 1, "pack it again")])
def test_a_store_of_another_version(version: int, advice: str, own: Path) -> None:
    with h5py.File(own, "r+") as file:
        file.attrs["version"] = version
        file.attrs["written_by"] = "eldata 9.1"
    refused(own, rf"is a store of version {version}, written by eldata 9\.1; .* reads version {VERSION}: {advice}")


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda file: file["frames"].pop("000001"), "expected 4 frames, found 3"),
        (lambda file: file.pop("frames"), "is damaged"),
        (lambda file: file.attrs.update(compression="gzip"), "unknown compression 'gzip'"),
    ],
)
def test_a_damaged_store(spoil: Any, reason: str, own: Path) -> None:
    with h5py.File(own, "r+") as file:
        spoil(file)
    refused(own, reason)


@pytest.mark.parametrize(
    ("place", "value"),
    [(0, None), (3, ["1"]), (4, 3), (4, {"sensor": {}, "more": {}, "whites": None}), (5, -1), (4, [4])],
)
def test_facts_that_are_no_frames(place: int, value: object, own: Path) -> None:
    """One bit is found by the checksum; what is wrong with lines whose checksum fits is found as they are read."""
    with h5py.File(own, "r+") as file:
        file["facts"][5] ^= 1
    refused(own, "is damaged .*what it states of its frames is not what was written")
    with h5py.File(own, "r+") as file:
        file["facts"][5] ^= 1
        lines = file["facts"][:].tobytes().splitlines(keepends=True)
        changed = json.loads(lines[1])
        changed[place] = value
        content = b"".join([lines[0], json.dumps(changed).encode(), b"\n", *lines[2:]])
        del file["facts"]
        file["facts"] = np.frombuffer(content, np.uint8)
        file.attrs["facts_crc32"] = zlib.crc32(content)
    refused(own, "is damaged")


# --- verification -------------------------------------------------------------------------------------------------


def test_a_whole_store_is_all_well(clean: Packed) -> None:
    for level, hashed in (("quick", 0), ("full", 4)):
        report = verify_store(clean.store, level=level, workers=2)  # type: ignore[arg-type]
        assert report.ok
        assert (report.datasets[0].files_checked, report.datasets[0].files_hashed) == (4, hashed)
        assert report.format_text() == f"raws: 4 of 4 files checked ({level}) in {clean.store}: all well"


def test_another_pixel_is_found(own: Path) -> None:
    with h5py.File(own, "r+") as file:
        file["frames/000001"][130, 258] ^= 1
    assert verify_store(own).ok
    (problem,) = verify_store(own, level="full").problems
    assert (problem.path, problem.field) == ("1.dng", "sha256 of the pixels")


@pytest.mark.parametrize("codec", ["lz4", "zstd"])
def test_damaged_chunks_are_found(codec: Any, tmp_path: Path) -> None:
    """Sizes that lie among them: bitshuffle believes them, and without HDF5's checksum some end the process."""
    own = pack_folder(write_clean(tmp_path / "raws", 1), tmp_path / "store.h5", compression=codec).store
    whole = own.read_bytes()
    with h5py.File(own) as file:
        place = file["frames/000000"].id.get_chunk_info(0)
    lies = [(0, ">Q", value) for value in (2**17 + 16, 2**19, 2**63, 0)]  # of the chunk
    lies += [(8, ">I", value) for value in (0, 6, 2**31, 2**32 - 16)]  # of a block decoded
    lies += [(12, ">I", value) for value in (0, 2**31 - 1, 2**32 - 1)]  # of the first block
    spoilt = [(at, struct.pack(form, value)) for at, form, value in lies]
    for at, value in [*spoilt, (16, b"\xff" * 40), (0, bytes(place.size)), (0, b"\xff" * place.size), (0, bytes(512))]:
        content = bytearray(whole)
        content[place.byte_offset + at : place.byte_offset + at + len(value)] = value
        own.write_bytes(content)
        assert [problem.path for problem in verify_store(own, level="full").problems] == ["0.dng"]
        refused(own, "frame 000000 is damaged", all_pixels)


def test_other_and_missing_pixels_are_found(own: Path) -> None:
    with h5py.File(own, "r+") as file:
        pixels = file["frames/000000"][...]
        for name in ("000000", "000002", "000003"):
            del file["frames"][name]
        file["frames"].create_dataset("000003", (64, 64), np.uint16)
        file["frames"].create_dataset("000000", pixels.shape, np.uint16, chunks=(256, 256))[:256] = pixels[:256]
        file["frames"].create_dataset("000002", SHAPES[2], np.uint16)
    found = {problem.path: (problem.expected, problem.found) for problem in verify_store(own).problems}
    assert found == {
        "3.dng": ("uint16 (150, 133)", "uint16 (64, 64)"),
        "0.dng": ("4 chunks", "2 chunks"),
        "2.dng": ("one piece", "nothing"),
    }
    for number, problem in ((0, "4 chunks, found 2 chunks"), (2, "one piece, found nothing")):
        read = lambda path, number=number: StoreFrames(path).frame(f"{number}.dng").whole()  # noqa: E731
        refused(own, rf"frame 00000{number} is damaged \(expected {problem}\)", read)


def test_a_frame_under_another_name_is_missing(own: Path) -> None:
    with h5py.File(own, "r+") as file:
        file.move("frames/000001", "frames/000009")
    (problem,) = verify_store(own).problems
    assert (problem.path, problem.expected, problem.found) == ("1.dng", "a frame 000001", "nothing")


# --- reading ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("compression", ["none", "lz4"])
def test_parts_are_the_files_pixels(compression: Any, clean: Packed, tmp_path: Path) -> None:
    build_store(clean.source, tmp_path / "store.h5", compression=compression)
    source = StoreFrames(tmp_path / "store.h5")
    generator = np.random.default_rng(0)
    for held in source.store.frames:
        mosaic, frame = read_raw(clean.source.folder / held.path).mosaic, source.frame(held.path)
        assert (frame.shape, frame.mosaic.dtype, frame.sensor) == (mosaic.shape, mosaic.dtype, held.sensor)
        np.testing.assert_array_equal(frame.whole(), mosaic)
        for _ in range(30):
            top, bottom = sorted(generator.integers(0, mosaic.shape[0] + 1, 2).tolist())
            left, right = sorted(generator.integers(0, mosaic.shape[1] + 1, 2).tolist())
            part = slice(top, bottom), slice(left, right)
            np.testing.assert_array_equal(frame.read(*part), mosaic[part])
        np.testing.assert_array_equal(frame.read(slice(-20, None), slice(None, 5)), mosaic[-20:, :5])


def test_an_uncompressed_store_is_mapped_and_not_written_to(clean: Packed, tmp_path: Path) -> None:
    build_store(clean.source, tmp_path / "store.h5")
    part = StoreFrames(tmp_path / "store.h5").frame("0.dng").read(slice(3, 9), slice(None))
    assert not part.flags.writeable
    assert not part.flags.owndata
    assert part.__array_interface__["data"][0] % 2 == 0


def test_threads_may_read_at_once(clean: Packed) -> None:
    reader = StoreFrames(clean.store)._reader
    frames = open_store(clean.store).frames
    wrong: list[str] = []

    def read(number: int) -> None:
        frame = frames[number % 4]
        mosaic = read_raw(clean.source.folder / frame.path).mosaic
        parts = (reader.read(frame.key, slice(top, 60), slice(60)) for top in range(40))
        wrong.extend(frame.path for top, part in enumerate(parts) if not np.array_equal(part, mosaic[top:60, :60]))

    threads = [threading.Thread(target=read, args=(number,)) for number in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []


def open_descriptors(path: Path) -> int:
    return sum(link.resolve() == path.resolve() for link in Path("/proc/self/fd").iterdir())


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="needs /proc")
def test_no_handle_is_shared_over_a_fork_or_pickled(clean: Packed) -> None:
    reader = StoreFrames(clean.store)._reader
    assert open_descriptors(clean.store) == 0
    wanted = reader.read("000000", slice(5), slice(5)).copy()
    assert open_descriptors(clean.store) > 0
    child = os.fork()
    if child == 0:
        inherited = open_descriptors(clean.store)
        same = np.array_equal(reader.read("000000", slice(5), slice(5)), wanted)
        os._exit(inherited + 10 * (not same))
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    np.testing.assert_array_equal(reader.read("000000", slice(5), slice(5)), wanted)
    copy = pickle.loads(pickle.dumps(reader))
    np.testing.assert_array_equal(copy.read("000000", slice(5), slice(5)), wanted)
    reader.close()
    copy.close()
    assert open_descriptors(clean.store) == 0


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_forks_while_threads_read(clean: Packed) -> None:
    """Each child reads, and no thread of the parent finds its file closed."""
    source, ended, wrong = StoreFrames(clean.store), threading.Event(), list[str]()
    frames = [source.frame(held.path) for held in source.store.frames]

    def read(number: int) -> None:
        while not ended.is_set():
            number = (number + 1) % len(frames)
            try:
                frames[number].read(slice(9, 50), slice(9, 50))
            except StoreError as error:
                wrong.append(str(error))

    threads = [threading.Thread(target=read, args=(number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    try:
        for _ in range(30):
            child = os.fork()
            if child == 0:
                signal.alarm(int(PATIENCE_S))  # ends a child that waits for ever
                frames[0].read(slice(5), slice(5))
                os._exit(0)
            assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    finally:
        ended.set()
        for thread in threads:
            thread.join()
    assert wrong == []


@pytest.mark.parametrize("compression", ["none", "lz4"])
@pytest.mark.parametrize("share", [0.5, 2.0])
def test_a_store_that_changes_under_an_open_dataset(
    share: float, compression: Any, clean: Packed, tmp_path: Path
) -> None:
    """To touch the pages that a mapping has lost would end the process by SIGBUS."""
    path = tmp_path / "store.h5"
    build_store(clean.source, path, compression=compression)
    frame = StoreFrames(path).frame("0.dng")
    frame.whole()
    size = path.stat().st_size
    os.truncate(path, int(size * share))
    refused(
        path,
        f"had {size} bytes when it was opened and has {int(size * share)} now; .*renaming",
        lambda _: frame.whole(),
    )


def test_a_store_that_is_replaced_by_renaming(own: Path, tmp_path: Path) -> None:
    """The open file is read on; a process that opens the name for the first time is not given other pixels."""
    source = StoreFrames(own)
    before = source.frame("0.dng").whole().copy()
    other = pack_folder(write_clean(tmp_path / "raws", 5), tmp_path / "other.h5")
    other.store.replace(own)
    np.testing.assert_array_equal(source.frame("0.dng").whole(), before)
    copy = pickle.loads(pickle.dumps(source))
    refused(own, "is another store than the one that was opened", lambda _: copy.frame("0.dng").whole())
