"""Packing: what a store holds, and that nothing that ends the work half-way changes it."""

from __future__ import annotations

import errno
import hashlib
import os
import signal
import subprocess
import sys
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np
import pytest

from eldata.errors import ArgumentError, DatasetError, EldataError, ManifestError, RawFileError
from eldata.raw import read_raw
from eldata.sources.store import build_store, journal, open_store, source_of_dataset, source_of_folder
from eldata.sources.store.journal import journaled
from tests.sources.store.helpers import Packed, contents, pack_folder, pack_tree, start_packing, write_clean
from tests.syncing import OnDisk
from tests.trees import Tree, tree_in

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from eldata.sources.store import Source

# Python 3.12 and later warn of any fork in a process that has threads.
pytestmark = pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")


@pytest.fixture(scope="module")
def tree(demo_tree: Path) -> Tree:
    return tree_in(demo_tree)


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Packed:
    """A folder of four cameras' frames, packed in one go."""
    folder = tmp_path_factory.mktemp("clean")
    return pack_folder(write_clean(folder / "raws"), folder / "clean.h5")


def test_a_store_is_on_the_disk_before_it_gets_its_name(
    clean: Packed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk = OnDisk(monkeypatch)
    build_store(clean.source, tmp_path / "store.h5")
    assert disk.named == {"store.h5": True}


# --- what it holds ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("compression", "jobs"), [("none", 1), ("lz4", 3), ("zstd", 1)])
def test_a_store_holds_every_file_once_as_decoded(compression: Any, jobs: int, tree: Tree, tmp_path: Path) -> None:
    packed = pack_tree(tree, tmp_path / "store.h5", compression=compression, workers=jobs)
    store = open_store(packed.store)
    assert store.compression == compression
    assert sorted(frame.path for frame in store.frames) == sorted(record.path for record in tree.manifest.records)
    with h5py.File(packed.store) as file:
        for frame in store.frames:
            raw = read_raw(tree.data / frame.path)
            pixels = file[f"frames/{frame.key}"]
            assert pixels.dtype == np.uint16
            assert (pixels.compression is None and not pixels._filters) == (compression == "none")
            np.testing.assert_array_equal(pixels[...], raw.mosaic)
            assert (frame.sensor, frame.exposure) == (raw.sensor, raw.exposure)
            assert frame.sha256 == f"sha256:{hashlib.sha256(raw.mosaic.tobytes()).hexdigest()}"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["store.h5"]


def test_a_store_holds_manifest_and_card(tree: Tree, tmp_path: Path) -> None:
    manifest = open_store(pack_tree(tree, tmp_path / "store.h5").store).manifest
    assert manifest is not None
    assert (manifest.records, manifest.card, manifest.digest) == (
        tree.manifest.records,
        tree.manifest.card,
        tree.manifest.digest,
    )


def test_a_store_of_clean_frames_holds_no_manifest(clean: Packed) -> None:
    store = open_store(clean.store)
    assert (store.manifest, store.dataset) == (None, "raws")
    assert [(frame.path, frame.role) for frame in store.frames] == [(f"{n}.dng", "reference") for n in range(4)]


def test_a_part_of_a_dataset(tree: Tree) -> None:
    def source(**options: Any) -> Source:
        return source_of_dataset("eld-demo", root=tree.root, manifest=tree.csv, **options)

    assert {path.partition("/")[0] for path, _ in source(cameras=["DemoBeta"]).files} == {"DemoBeta"}
    files = source(split=["test"]).files
    assert len(files) == 32 == len(set(files))
    assert sum(role == "reference" for _, role in files) == 8
    for options, word in (({"cameras": ["X"]}, "DemoBeta"), ({"split": ["X"]}, "test"), ({"subset": "X"}, "known")):
        with pytest.raises(ArgumentError, match=word):
            source(**options)


def test_what_cannot_be_packed(tree: Tree, tmp_path: Path) -> None:
    with pytest.raises(ManifestError, match="no dataset is called 'nothing'"):
        source_of_dataset("nothing")
    for name in ("drv", "drv-raw"):
        with pytest.raises(DatasetError, match="data/DRV: there is no such folder; --root names the folder"):
            source_of_dataset(name, root=tree.root)
    with pytest.raises(ArgumentError, match="eld-demo: holds pairs, not clips"):
        source_of_dataset("eld-demo", root=tree.root, manifest=tree.csv, ids=["0007"])
    with pytest.raises(ArgumentError, match="is the manifest of 'eld-demo', not of 'eld'"):
        source_of_dataset("eld", manifest=tree.csv)
    with pytest.raises(DatasetError, match="no such folder"):
        source_of_dataset("eld-demo", root=tmp_path, manifest=tree.csv)
    with pytest.raises(DatasetError, match="holds no camera raw file"):
        source_of_folder(tmp_path)
    with pytest.raises(ArgumentError, match="compression must be one of 'none', 'lz4', 'zstd'; found 'gzip'"):
        build_store(source_of_folder(tree.data), tmp_path / "x.h5", compression="gzip")  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, match="workers must be 1 or more"):
        build_store(source_of_folder(tree.data), tmp_path / "x.h5", workers=0)
    with pytest.raises(EldataError, match=r"cannot write .*nowhere/x.h5.part: No such file"):
        build_store(source_of_folder(tree.data), tmp_path / "nowhere" / "x.h5")
    assert not any(tmp_path.iterdir())


def test_without_hdf5plugin_an_uncompressed_store_works(
    clean: Packed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pack_folder(clean.source.folder, tmp_path / "lz4.h5", compression="lz4")
    monkeypatch.setitem(sys.modules, "hdf5plugin", None)
    build_store(clean.source, tmp_path / "plain.h5")
    assert len(open_store(tmp_path / "plain.h5").frames) == 4
    for work in (
        lambda: build_store(clean.source, tmp_path / "other.h5", compression="zstd"),
        lambda: open_store(tmp_path / "lz4.h5"),
    ):
        with pytest.raises(ArgumentError, match=r"needs the package hdf5plugin: pip install 'eldata\[compression\]'"):
            work()


# --- the end of the process ---------------------------------------------------------------------------------------


def in_child(work: Callable[[], object]) -> int:
    """Run in a forked process; return its exit code, negative if a signal ended it."""
    child = os.fork()
    if child == 0:
        try:
            work()
        except BaseException:  # noqa: BLE001 # or pytest would go on in the child
            os._exit(1)
        os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def at_write(number: int, then: Callable[[int, memoryview, int], None]) -> Callable[[int, memoryview, int], None]:
    """Return a write that does something else the n-th time."""
    whole, count = journal._write_all, 0

    def write(descriptor: int, data: memoryview, offset: int) -> None:
        nonlocal count
        count += 1
        if count == number:
            then(descriptor, data, offset)
        whole(descriptor, data, offset)

    return write


def kill(descriptor: int, data: memoryview, offset: int) -> None:
    """Die as by kill -9, half of the write done."""
    os.pwrite(descriptor, data[: len(data) // 2], offset)
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.kill
def test_killed_at_every_write_and_resumed(clean: Packed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each write of a packing, in turn, is the last one of a process, half done; the next process is killed too."""
    wanted = contents(clean.store)
    whole = journal._write_all
    store, part = tmp_path / "store.h5", tmp_path / "store.h5.part"
    number, kills, half_way = 0, 0, 0
    while True:
        number += 1
        monkeypatch.setattr(journal, "_write_all", at_write(number, kill))
        first = in_child(lambda: build_store(clean.source, store))
        if first == 0:  # fewer writes than that
            break
        assert first == -signal.SIGKILL
        assert not store.exists()
        kills += 1
        # Die again, soon after: undoing included.
        monkeypatch.setattr(journal, "_write_all", at_write(1 + number % 5, kill))
        kills += in_child(lambda: build_store(clean.source, store)) == -signal.SIGKILL
        monkeypatch.setattr(journal, "_write_all", whole)
        if not store.exists():
            half_way += build_store(clean.source, store).resumed in (1, 2, 3)
        assert contents(store) == wanted
        assert not part.exists()
        store.unlink()
    assert kills > 60
    assert half_way > 20
    assert contents(store) == wanted


@pytest.mark.kill
@pytest.mark.parametrize("jobs", [1, 2])
def test_the_command_is_killed_and_resumed(jobs: int, tree: Tree, tmp_path: Path) -> None:
    """Processes of their own, each killed while it decodes a file further on than the one before."""
    source = pack_tree(tree, tmp_path / "whole.h5", compression="lz4").source
    store = tmp_path / "store.h5"
    command = ["pack", "eld-demo", "--manifest", str(tree.csv), "--root", str(tree.root), "-o", str(store)]
    command += ["--compression", "lz4", "--jobs", str(jobs)]
    for number in (0, 5, 31):
        process = start_packing(command, stop_at=source.files[number][0], folder=tmp_path)
        process.kill()
        process.communicate()
        assert not store.exists()
    done = subprocess.run([sys.executable, "-m", "eldata.cli.main", *command], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    if jobs == 1:  # with more, those that were decoded ahead may not have been written
        assert "32 frames packed (31 of them before)" in done.stdout
    assert contents(store) == contents(tmp_path / "whole.h5")


def failing(error: BaseException) -> Callable[[int, memoryview, int], None]:
    def fail(descriptor: int, data: memoryview, offset: int) -> None:
        raise error

    return fail


@pytest.mark.parametrize("number", [1, 2, 5, 9, 14, 25, 33, 40])
@pytest.mark.parametrize("error", [OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)), KeyboardInterrupt()], ids=repr)
def test_a_full_disk_or_ctrl_c_keeps_the_finished_part(
    error: BaseException, number: int, clean: Packed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store, part = tmp_path / "store.h5", tmp_path / "store.h5.part"
    with monkeypatch.context() as patch:
        patch.setattr(journal, "_write_all", at_write(number, failing(error)))
        with pytest.raises((EldataError, KeyboardInterrupt), match=r"cannot write .*store.h5.part: No space|^$"):
            build_store(clean.source, store, workers=2)
    assert not store.exists()
    assert part.exists()
    build_store(clean.source, store)
    assert contents(store) == contents(clean.store)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["store.h5"]


def test_a_file_that_cannot_be_read_is_named_and_not_the_store(
    clean: Packed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def failing_disk(*_: object) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr("hashlib.file_digest", failing_disk)
    with pytest.raises(OSError, match=f"Input/output error: '.*{clean.source.files[0][0]}'"):
        build_store(clean.source, tmp_path / "store.h5")


def test_a_file_that_cannot_be_decoded_keeps_those_before_it(clean: Packed, tmp_path: Path) -> None:
    folder = write_clean(tmp_path / "raws")
    whole = (folder / "2.dng").read_bytes()
    (folder / "2.dng").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(RawFileError, match=r"2\.dng: truncated"):
        pack_folder(folder, tmp_path / "store.h5", workers=2)
    (folder / "2.dng").write_bytes(whole)
    report = build_store(source_of_folder(folder), tmp_path / "store.h5")
    assert (report.resumed, report.frames) == (2, 4)
    assert contents(tmp_path / "store.h5") == contents(clean.store)


# --- refusals -----------------------------------------------------------------------------------------------------


def begun(folder: Path, clean: Packed) -> Path:
    """A part of a store, as a kill leaves it."""

    def work() -> None:
        kill_after_two_frames()
        build_store(clean.source, folder / "store.h5")

    code = in_child(work)
    assert code == -signal.SIGKILL
    return folder / "store.h5.part"


def kill_after_two_frames() -> None:
    commit, count = journal.JournaledFile.commit, 0

    def killing(self: journal.JournaledFile) -> None:
        nonlocal count
        commit(self)
        count += 1
        if count == 3:  # the first is of the empty store
            os.kill(os.getpid(), signal.SIGKILL)

    journal.JournaledFile.commit = killing  # type: ignore[method-assign] # in a child that dies


def test_two_writers(clean: Packed, tmp_path: Path) -> None:
    with (
        journaled(tmp_path / "store.h5.part"),
        pytest.raises(EldataError, match=r"store.h5.part: another process is writing it"),
    ):
        build_store(clean.source, tmp_path / "store.h5")
    build_store(clean.source, tmp_path / "store.h5")  # the lock is gone with its holder


def test_a_store_that_is_there_is_kept(clean: Packed) -> None:
    before = clean.store.read_bytes()
    with pytest.raises(EldataError, match="is there already"):
        build_store(clean.source, clean.store)
    assert clean.store.read_bytes() == before


def test_a_part_of_other_files_is_not_resumed(clean: Packed, tmp_path: Path) -> None:
    part = begun(tmp_path, clean)
    fewer = source_of_folder(write_clean(tmp_path / "raws", 3))
    with pytest.raises(ArgumentError, match=r"store.h5.part: was begun with another files digest"):
        build_store(fewer, tmp_path / "store.h5")
    with pytest.raises(ArgumentError, match="was begun with another compression: expected lz4, found none"):
        build_store(clean.source, tmp_path / "store.h5", compression="lz4")
    assert part.exists()
    assert build_store(clean.source, tmp_path / "store.h5").resumed == 2


def test_a_part_without_its_journal(clean: Packed, tmp_path: Path) -> None:
    part = begun(tmp_path, clean)
    journal_file = part.with_name(f"{part.name}.journal")
    journal_file.write_bytes(b"something else entirely")
    with pytest.raises(EldataError, match="is not a journal of eldata; remove"):
        build_store(clean.source, tmp_path / "store.h5")
    journal_file.unlink()
    with pytest.raises(EldataError, match=r"its journal store.h5.part.journal is not there"):
        build_store(clean.source, tmp_path / "store.h5")
    part.unlink()
    build_store(clean.source, tmp_path / "store.h5")


def test_a_journal_that_a_kill_left_beside_a_finished_store_is_removed(clean: Packed, tmp_path: Path) -> None:
    store, left = tmp_path / "store.h5", tmp_path / "store.h5.part.journal"
    build_store(clean.source, store)
    left.write_bytes(b"of the last commit")
    with pytest.raises(EldataError, match="is there already"):
        build_store(clean.source, store)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["store.h5"]


def test_a_stale_journal_does_no_harm(clean: Packed, tmp_path: Path) -> None:
    """As a kill between the last two steps leaves it."""
    begun(tmp_path, clean).unlink()
    build_store(clean.source, tmp_path / "store.h5")
    assert contents(tmp_path / "store.h5") == contents(clean.store)
