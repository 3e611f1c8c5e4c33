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
from eldata.sources.store import build, build_store, open_store, source_of_dataset, source_of_folder
from eldata.sources.store.format import StoreError
from tests.sources.store.helpers import Packed, contents, pack_folder, pack_tree, start_packing, write_clean
from tests.syncing import OnDisk
from tests.trees import Tree, tree_in

if TYPE_CHECKING:
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
    with pytest.raises(EldataError, match=r"cannot write .*nowhere/x.h5: No such file"):
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


@pytest.mark.kill
@pytest.mark.parametrize("jobs", [1, 2])
def test_a_killed_command_leaves_no_half_store_and_starts_anew(jobs: int, tree: Tree, tmp_path: Path) -> None:
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
        assert (tmp_path / ".store.h5.eldata.part").exists()
    done = subprocess.run([sys.executable, "-m", "eldata.cli.main", *command], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert "32 frames packed: " in done.stdout
    assert contents(store) == contents(tmp_path / "whole.h5")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["stopped", "store.h5", "whole.h5"]


@pytest.mark.kill
@pytest.mark.parametrize(
    ("kilobytes", "compression"),
    [*((size, "none") for size in (0, 1, 90, 400)), (1, "zstd"), (90, "zstd"), (300, "lz4")],
)
def test_a_full_disk_is_one_line_and_leaves_nothing(
    kilobytes: int, compression: str, clean: Packed, tmp_path: Path
) -> None:
    """Files that cannot grow beyond so many kilobytes stand for it; the whole store takes more, compressed or not."""
    assert clean.store.stat().st_size > 1000 * kilobytes
    code = (
        "import resource, signal, sys; from eldata.cli.main import main; signal.signal(signal.SIGXFSZ, signal.SIG_IGN);"
        f"resource.setrlimit(resource.RLIMIT_FSIZE, (1000 * {kilobytes},) * 2); sys.exit(main(sys.argv[1:]))"
    )
    command = [sys.executable, "-c", code, "pack", str(clean.source.folder), "-o", str(tmp_path / "store.h5")]
    done = subprocess.run([*command, "--jobs", "1", "--compression", compression], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == f"eldata pack: cannot write {tmp_path / 'store.h5'}: File too large\n"
    assert list(tmp_path.iterdir()) == []


def test_ctrl_c_leaves_nothing(clean: Packed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("eldata.sources.store.build.facts_line", interrupt)
        with pytest.raises(KeyboardInterrupt):
            build_store(clean.source, tmp_path / "store.h5", workers=2)
    assert list(tmp_path.iterdir()) == []
    build_store(clean.source, tmp_path / "store.h5")
    assert contents(tmp_path / "store.h5") == contents(clean.store)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize(("compression", "call"), [("none", 3), ("lz4", 1), ("lz4", 12), ("zstd", 6), ("zstd", 25)])
def test_a_signal_while_hdf5_writes_comes_after_it_and_leaves_nothing(
    number: int, compression: Any, call: int, clean: Packed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """HDF5 calls Python for each write, and goes on without the chunk if that raises."""

    class EndedError(BaseException):
        pass

    def end(*_: object) -> None:
        raise EndedError

    class Disk(build._Disk):
        calls = 0

        def seek(self, *place: int) -> int:  # as the file is opened, and before each write
            self.calls += 1
            if self.calls == call:
                os.kill(os.getpid(), number)
            return super().seek(*place)

    handler, opened = signal.signal(number, end), h5py.h5f.get_obj_count()
    monkeypatch.setattr(build, "_Disk", Disk)
    try:
        with pytest.raises(EndedError):
            build_store(clean.source, tmp_path / "store.h5", compression=compression)
        assert signal.getsignal(number) is end
        assert h5py.h5f.get_obj_count() == opened
    finally:
        signal.signal(number, handler)
    assert list(tmp_path.iterdir()) == []


def test_a_store_gets_its_name_once_every_chunk_is_counted(
    clean: Packed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = h5py.Group.create_dataset

    def lacking(self: h5py.Group, name: str, *, data: Any, **options: Any) -> Any:
        if not name.startswith("frames/"):
            return whole(self, name, data=data)
        return whole(self, name, data.shape, data.dtype, **options).write_direct(data, np.s_[:60], np.s_[:60])

    monkeypatch.setattr(h5py.Group, "create_dataset", lacking)
    with pytest.raises(StoreError, match=r"0\.dng: expected 4 chunks, found 2 chunks"):
        build_store(clean.source, tmp_path / "store.h5", compression="lz4")
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_cannot_be_read_is_named_and_not_the_store(
    clean: Packed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def failing_disk(*_: object) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    monkeypatch.setattr("hashlib.file_digest", failing_disk)
    with pytest.raises(OSError, match=f"Input/output error: '.*{clean.source.files[0][0]}'"):
        build_store(clean.source, tmp_path / "store.h5")


def test_a_file_that_cannot_be_decoded_leaves_nothing(clean: Packed, tmp_path: Path) -> None:
    folder = write_clean(tmp_path / "raws")
    whole = (folder / "2.dng").read_bytes()
    (folder / "2.dng").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(RawFileError, match=r"2\.dng: truncated"):
        pack_folder(folder, tmp_path / "store.h5", workers=2)
    assert [path.name for path in tmp_path.iterdir()] == ["raws"]
    (folder / "2.dng").write_bytes(whole)
    assert build_store(source_of_folder(folder), tmp_path / "store.h5").frames == 4
    assert contents(tmp_path / "store.h5") == contents(clean.store)


# --- refusals -----------------------------------------------------------------------------------------------------


def test_a_store_that_is_there_is_kept(clean: Packed) -> None:
    before = clean.store.read_bytes()
    with pytest.raises(EldataError, match="is there already"):
        build_store(clean.source, clean.store)
    assert clean.store.read_bytes() == before
