"""Opening stores: what is refused and how; reading parts; verification."""

from __future__ import annotations

import json
import os
import pickle
import shutil
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np
import pytest

from eldata.base.isolation import Limits, isolation
from eldata.errors import ArgumentError
from eldata.raw import pack, read_raw
from eldata.raw.cfa import cfa_from
from eldata.sources.store import open_store, verify_store
from eldata.sources.store.format import StoreError
from eldata.sources.store.read import PixelReader, StoredMosaic
from tests.sources.store.helpers import Packed, pack_folder, write_clean

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


@pytest.mark.parametrize("mode", ["r", "r+"])
@pytest.mark.parametrize("options", [{}, {"locking": True}, {"locking": False}, {"libver": "latest"}], ids=str)
def test_a_store_that_the_callers_h5py_holds_open(mode: str, options: dict[str, Any], own: Path) -> None:
    whole = open_store(own)
    with h5py.File(own, mode, **options):
        assert open_store(own).frames == whole.frames
        all_pixels(own)


# --- refusals -----------------------------------------------------------------------------------------------------


def by_attributes(path: Path) -> object:
    return open_store(path, by_table=False)


def all_pixels(path: Path) -> None:
    reader = PixelReader(path)
    try:
        for frame in open_store(path).frames:
            height, width = frame.shape
            reader.read(frame.key, range(height), range(width))
    finally:
        reader.close()


def refused(path: Path, reason: str, *works: Callable[[Path], object]) -> None:
    for work in works or (open_store, by_attributes, verify_store):
        with pytest.raises(StoreError, match=reason) as caught:
            work(path)
        assert str(caught.value).startswith(f"{path}: ")


def test_a_missing_store(tmp_path: Path) -> None:
    refused(tmp_path / "store.h5", "cannot be read: No such file or directory")
    refused(tmp_path, "is a folder, not a file")
    os.mkfifo(tmp_path / "pipe.h5")
    refused(tmp_path / "pipe.h5", "is a named pipe, not a file")


@pytest.mark.parametrize("share", [0.02, 0.3, 0.7, 0.999])
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


def test_a_store_in_whose_attributes_hdf5_runs_for_ever(own: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where texts are kept ("GCOL", the global heap), HDF5 steps on by lengths, also by those of 0."""
    data = bytearray(own.read_bytes())
    heap = data.index(b"GCOL")
    data[heap + 104 : heap + 168] = bytes(64)
    with isolation():
        assert open_store(own).frames
        own.write_bytes(data)
        monkeypatch.setattr("eldata.sources.store.read._TRIAL_LIMITS", Limits(seconds=1.0))
        refused(own, "its decoder took more than 1 s; is the file whole")


def test_other_files_are_not_followed(own: Path, tmp_path: Path) -> None:
    """Links and pixels outside of the file, frames and chunks that no camera and no packing makes."""
    whole = own.read_bytes()

    def spoilt(change: Callable[[h5py.File], None], reason: str, *more: Callable[[Path], object]) -> None:
        own.write_bytes(whole)
        with h5py.File(own, "r+") as file:
            change(file)
        refused(own, f"is damaged .*{reason}", by_attributes, verify_store, *more)

    def another(file: h5py.File, **options: Any) -> None:
        frame = file["frames/000000"]
        attributes = dict(frame.attrs)
        del file["frames/000000"]
        made = file["frames"].create_dataset("000000", frame.shape, np.uint16, **options)
        made.attrs.update(attributes)

    def linked(file: h5py.File) -> None:
        del file["frames/000000"]
        file["frames/000000"] = h5py.ExternalLink("other.h5", "x")

    def linked_group(file: h5py.File) -> None:
        file["manifest"] = h5py.SoftLink("/frames")

    def huge(file: h5py.File) -> None:
        sensor = json.loads(file["frames/000000"].attrs["sensor"]) | {"height": 1 << 20, "width": 1 << 20}
        file["frames/000000"].attrs["sensor"] = json.dumps(sensor)

    def huge_in_table(file: h5py.File) -> None:
        table = json.loads(file["table"][:].tobytes())
        sensors = table["sensor"]["texts"]
        sensors[0] = json.dumps(json.loads(sensors[0]) | {"height": 1 << 20, "width": 1 << 20})
        del file["table"]
        file["table"] = np.frombuffer(json.dumps(table).encode(), np.uint8)

    def linked_table(file: h5py.File) -> None:
        del file["table"]
        file["table"] = h5py.SoftLink("/frames")

    def huge_table(file: h5py.File) -> None:
        del file["table"]
        file.create_dataset("table", (1 << 40,), np.uint8, chunks=(1 << 20,))

    def huge_manifest(file: h5py.File) -> None:
        file.create_dataset("manifest/csv", (1 << 40,), np.uint8, chunks=(1 << 20,))

    outside = [(str(tmp_path / "other.bin"), 0, h5py.h5f.UNLIMITED)]
    spoilt(linked, "'000000' is a link", all_pixels)
    spoilt(linked_group, "'manifest' is a link", open_store)
    spoilt(lambda file: another(file, external=outside), "the pixels of '000000' lie in other files", all_pixels)
    wide = {"chunks": (4096, 4096), "maxshape": (None, None)}
    spoilt(lambda file: another(file, **wide), r"chunks of \(4096, 4096\)", all_pixels)
    spoilt(huge, r"frame 000000 declares \(1048576, 1048576\) pixels")
    spoilt(huge_manifest, "manifest/csv declares 1099511627776 bytes", open_store)
    spoilt(linked_table, "'table' is a link", open_store)
    spoilt(huge_table, "table declares 1099511627776 bytes", open_store)
    own.write_bytes(whole)
    with h5py.File(own, "r+") as file:
        huge_in_table(file)
    refused(own, r"table declares \(1048576, 1048576\) pixels", open_store, verify_store)


def test_a_newer_store(own: Path) -> None:
    with h5py.File(own, "r+") as file:
        file.attrs["version"] = 3
        file.attrs["written_by"] = "eldata 9.1"
    refused(own, r"is a store of version 3, written by eldata 9\.1; .* up to version 2: install a newer one")


def test_a_store_that_is_not_complete(own: Path) -> None:
    with h5py.File(own, "r+") as file:
        file.attrs["complete"] = False
    refused(own, "is not complete; the eldata pack command that began it goes on with it")


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda file: file["frames"].pop("000001"), "expected 4 frames, found 3|lists 4 frames, and there are 3"),
        (lambda file: file.pop("frames"), "is damaged"),
        (lambda file: file.attrs.update(compression="gzip"), "unknown compression 'gzip'"),
    ],
)
def test_a_damaged_store(spoil: Any, reason: str, own: Path) -> None:
    with h5py.File(own, "r+") as file:
        spoil(file)
    refused(own, reason)


@pytest.mark.parametrize("damage", [{"sensor": None}, {"file": None}, {"exposure": "{"}])
def test_damaged_attributes_are_found_where_a_table_is_read_too(damage: dict[str, Any], own: Path) -> None:
    with h5py.File(own, "r+") as file:
        attributes = file["frames/000002"].attrs
        attributes.update({name: value for name, value in damage.items() if value is not None})
        for name in (name for name, value in damage.items() if value is None):
            del attributes[name]
    refused(own, "is damaged", by_attributes, verify_store)
    with h5py.File(own, "r+") as file:
        del file["table"]
    refused(own, "is damaged")


def test_the_table_says_what_the_attributes_say(clean: Packed, own: Path) -> None:
    """Also of a store without a table; one that says something else is found, and a damaged one is refused."""
    assert open_store(clean.store) == open_store(clean.store, by_table=False)
    with h5py.File(own, "r+") as file:
        table = json.loads(file["table"][:].tobytes())
        del file["table"]
    assert open_store(own).every == open_store(clean.store).every
    assert verify_store(own).ok

    def with_table(changes: dict[str, Any]) -> None:
        with h5py.File(own, "r+") as file:
            file.pop("table", None)
            file["table"] = np.frombuffer(json.dumps(table | changes).encode(), np.uint8)

    with_table({"path": ["other.dng", *table["path"][1:]]})
    (problem,) = verify_store(own).problems
    assert (problem.path, problem.field, problem.found) == ("other.dng", "path in the table", "other.dng")
    assert problem.expected == table["path"][0]
    shared, file = table["sensor"], table["file"]
    changes: list[dict[str, Any]] = [
        {"path": table["path"][1:]},
        {"path": [1, 2, 3, 4]},
        {"role": None},
        {"sensor": shared | {"of": "0 1 2 4"}},
        {"sensor": shared | {"of": "0 1 2 -2"}},
        {"sensor": shared | {"of": "0 1 2 -1"}},
        {"sensor": shared | {"texts": ["{}"] * 4}},
        {"exposure": {"texts": []}},
        {"file": file | {"size_bytes": ["1"] * 4}},
        {"file": file | {"size_bytes": [None] * 4}},
        {"file": file | {"sha256": file["sha256"][1:]}},
        {"file": [1]},
    ]
    for damaged in changes:
        with_table(damaged)
        refused(own, "is damaged", open_store, verify_store)
    with_table({})
    with h5py.File(own, "r+") as store:
        store.move("frames/000001", "frames/000009")
    (problem,) = verify_store(own).problems
    assert (problem.path, problem.field, problem.found) == (table["path"][1], "table", "a frame 000001")


# --- verification -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("jobs", [1, 3])
def test_a_whole_store_is_all_well(jobs: int, clean: Packed) -> None:
    for level, hashed in (("quick", 0), ("full", 4)):
        report = verify_store(clean.store, level=level, workers=jobs)  # type: ignore[arg-type]
        assert report.ok
        assert (report.datasets[0].files_checked, report.datasets[0].files_hashed) == (4, hashed)
        assert report.format_text() == f"raws: 4 of 4 files checked ({level}) in {clean.store}: all well"


def test_another_pixel_is_found(own: Path) -> None:
    with h5py.File(own, "r+") as file:
        file["frames/000001"][130, 258] ^= 1
    assert verify_store(own).ok
    (problem,) = verify_store(own, level="full").problems
    assert (problem.path, problem.field) == ("1.dng", "sha256 of the pixels")


def test_damaged_chunks_are_found(own: Path) -> None:
    with h5py.File(own) as file:
        place = file["frames/000002"].id.get_chunk_info(0)
    content = bytearray(own.read_bytes())
    content[place.byte_offset : place.byte_offset + place.size] = bytes(place.size)
    own.write_bytes(content)
    assert [problem.path for problem in verify_store(own, level="full").problems] == ["2.dng"]


def test_another_size_is_found(own: Path) -> None:
    with h5py.File(own, "r+") as file:
        attributes = dict(file["frames/000003"].attrs)
        del file["frames/000003"]
        file["frames"].create_dataset("000003", (64, 64), np.uint16, chunks=(64, 64)).attrs.update(attributes)
        pixels, attributes = file["frames/000000"][...], dict(file["frames/000000"].attrs)
        del file["frames/000000"]
        file["frames"].create_dataset("000000", pixels.shape, np.uint16, chunks=(256, 256)).attrs.update(attributes)
        file["frames/000000"][:256, :] = pixels[:256]
    found = {problem.path: (problem.expected, problem.found) for problem in verify_store(own).problems}
    assert found == {"3.dng": ("uint16 (150, 133)", "uint16 (64, 64)"), "0.dng": ("4 chunks", "2")}


# --- reading ------------------------------------------------------------------------------------------------------


def test_parts_are_the_files_pixels(clean: Packed) -> None:
    reader = PixelReader(clean.store)
    generator = np.random.default_rng(0)
    for frame in open_store(clean.store).frames:
        mosaic = read_raw(clean.source.folder / frame.path).mosaic
        stored = StoredMosaic(reader, frame.key, (frame.sensor.height, frame.sensor.width))
        assert (stored.shape, stored.dtype) == (mosaic.shape, mosaic.dtype)
        np.testing.assert_array_equal(np.asarray(stored), mosaic)
        for _ in range(30):
            top, bottom = sorted(generator.integers(0, mosaic.shape[0] + 1, 2))
            left, right = sorted(generator.integers(0, mosaic.shape[1] + 1, 2))
            part = slice(int(top), int(bottom)), slice(int(left), int(right))
            np.testing.assert_array_equal(stored[part], mosaic[part])
            np.testing.assert_array_equal(stored.borrow(part), mosaic[part])
        np.testing.assert_array_equal(stored[-20:, :5], mosaic[-20:, :5])
        with pytest.raises(ArgumentError, match="without steps"):
            stored[::2, :]


@pytest.mark.parametrize("compression", ["none", "lz4"])
def test_parts_are_packed_as_they_are_read(compression: Any, tmp_path: Path) -> None:
    """Of 5 CFAs, up to 2 x 3 chunks; the part may begin at any row and column, also where chunks cut its periods."""
    packed = pack_folder(write_clean(tmp_path / "raws", count=5), tmp_path / "clean.h5", compression=compression)
    reader, generator = PixelReader(packed.store), np.random.default_rng(0)
    for frame in open_store(packed.store).frames:
        stored = StoredMosaic(reader, frame.key, (frame.sensor.height, frame.sensor.width))
        mosaic = read_raw(packed.source.folder / frame.path).mosaic
        for step in (1, 2, 4, 6) * 6:
            top, left = (step * int(generator.integers(0, (side - 24) // step)) for side in mosaic.shape)
            bottom = int(generator.integers(top + 12, mosaic.shape[0] + 1))
            right = int(generator.integers(left + 12, mosaic.shape[1] + 1))
            part = slice(top, bottom), slice(left, right)
            cfa = cfa_from(frame.sensor.cfa, top, left)
            expected = pack(mosaic[part], cfa)
            found = np.zeros_like(expected)
            stored.pack(part, cfa, found)
            np.testing.assert_array_equal(found, expected)


def test_what_is_read_stays_and_what_is_borrowed_does_not(clean: Packed) -> None:
    frame = open_store(clean.store).frames[0]
    reader = PixelReader(clean.store)
    kept = reader.read(frame.key, range(10), range(10))
    before = kept.copy()
    borrowed = reader.borrow(frame.key, range(10), range(10))
    reader.borrow(frame.key, range(20, 30), range(10))
    np.testing.assert_array_equal(kept, before)
    assert not np.array_equal(borrowed, before)


def test_threads_may_read_at_once(clean: Packed) -> None:
    reader = PixelReader(clean.store)
    frames = open_store(clean.store).frames
    wrong: list[str] = []

    def read(number: int) -> None:
        frame = frames[number % 4]
        mosaic = read_raw(clean.source.folder / frame.path).mosaic
        parts = (reader.borrow(frame.key, range(top, 60), range(60)) for top in range(40))
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
    reader = PixelReader(clean.store)
    assert open_descriptors(clean.store) == 0
    wanted = reader.read("000000", range(5), range(5))
    assert open_descriptors(clean.store) > 0
    child = os.fork()
    if child == 0:
        inherited = open_descriptors(clean.store)
        same = np.array_equal(reader.read("000000", range(5), range(5)), wanted)
        os._exit(inherited + 10 * (not same))
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    np.testing.assert_array_equal(reader.read("000000", range(5), range(5)), wanted)
    copy = pickle.loads(pickle.dumps(reader))
    np.testing.assert_array_equal(copy.read("000000", range(5), range(5)), wanted)
    reader.close()
    copy.close()
    assert open_descriptors(clean.store) == 0
