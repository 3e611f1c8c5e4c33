"""Packing: what a store holds, of pairs, clips and clean frames; nothing that ends the work half-way leaves a store."""

from __future__ import annotations

import hashlib
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from eldata.base.arrays import read_rgb16
from eldata.errors import ArgumentError, DatasetError, EldataError, ManifestError, RawFileError
from eldata.raw import read_raw
from eldata.records import Exposure
from eldata.sources.store import Store, build_store, source_of_dataset, source_of_folder, verify_store, write
from tests.drv_tree import SmallDrv, small_drv
from tests.raw.helpers import random_mosaic, write_plain_dng
from tests.sources.store.helpers import Packed, pack_folder, pack_tree, write_clean
from tests.syncing import OnDisk
from tests.trees import Tree, tree_in

FRAMES = 7
SIZE = (301, 270)  # above a chunk, no multiple of one


@pytest.fixture(scope="module")
def tree(demo_tree: Path) -> Tree:
    return tree_in(demo_tree)


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Packed:
    """A folder of four cameras' frames."""
    folder = tmp_path_factory.mktemp("clean")
    return pack_folder(write_clean(folder / "raws"), folder / "clean.h5")


@pytest.fixture(scope="module")
def drv(tmp_path_factory: pytest.TempPathFactory) -> SmallDrv:
    return small_drv(tmp_path_factory.mktemp("drv"), ("0007", "0013", "M0003"), FRAMES, size=SIZE)


# --- what it holds ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("compression", "jobs"), [("none", 1), ("lz4", 3), ("zstd", 1)])
def test_a_store_holds_every_file_once_as_decoded(compression: Any, jobs: int, tree: Tree, tmp_path: Path) -> None:
    store = Store(pack_tree(tree, tmp_path / "store.h5", compression=compression, workers=jobs).store)
    assert store.compression == compression
    assert sorted(frame.path for frame in store.frames) == sorted(record.path for record in tree.manifest.records)
    with h5py.File(store.path) as file:
        for frame in store.frames:
            raw = read_raw(tree.data / frame.path)
            pixels = file[f"frames/{frame.key}"]
            assert (pixels.compression is None and not pixels._filters) == (compression == "none")
            np.testing.assert_array_equal(pixels[...], raw.mosaic, strict=True)
            assert (frame.sensor, frame.exposure) == (raw.sensor, raw.exposure)
            assert frame.sha256 == f"sha256:{hashlib.sha256(raw.mosaic.tobytes()).hexdigest()}"
    assert store.manifest is not None
    assert (store.manifest.records, store.manifest.card) == (tree.manifest.records, tree.manifest.card)
    assert store.manifest.digest == tree.manifest.digest
    assert sorted(path.name for path in tmp_path.iterdir()) == ["store.h5"]


def test_a_store_keeps_what_files_state(tmp_path: Path) -> None:
    """Levels, white balance and matrix come back to the last digit, negative ones too, with the matrix's light."""
    (tmp_path / "clean").mkdir()
    matrix = (2, -1, 0, -1, 4, 1, 0, 1, 2)
    write_plain_dng(
        tmp_path / "clean" / "a.dng",
        random_mosaic(40, 48),
        ("RG", "GB"),
        (50714, "2I", 1, (1535, 3), True),
        (50721, "2i", 9, tuple(part for number in matrix for part in (number, 3)), True),
        (50728, "2I", 3, (493494, 10**6, 1, 1, 606815, 10**6), True),
    )
    (held,) = Store(pack_folder(tmp_path / "clean", tmp_path / "store.h5").store).frames
    assert held.sensor == read_raw(tmp_path / "clean" / "a.dng").sensor
    assert held.sensor.black_level_dn == (1535 / 3,) * 4
    assert None not in (held.sensor.white_balance, held.sensor.xyz_to_camera)


def test_rgb_clips_stand_in_order_with_their_reference_first(drv: SmallDrv, tmp_path: Path) -> None:
    """The manifest lists the files, not the patterns."""
    store = Store(pack_tree(drv, tmp_path / "drv.h5", compression="lz4").store)
    with h5py.File(store.path, locking=False) as file:
        for frame in store.frames:
            pixels = read_rgb16(drv.data / frame.path).transpose(2, 0, 1)
            np.testing.assert_array_equal(file[f"frames/{frame.key}"][...], pixels)
            np.testing.assert_array_equal(store.reader.read(frame.key, slice(3, 290), slice(200, 270)),
                                          pixels[:, 3:290, 200:270])  # fmt: skip
            assert (frame.shape, frame.exposure) == ((3, *SIZE), Exposure())
    paths = [frame.path for frame in store.frames]
    clip = [f"VBM4D_rawRGB/0013/{number:04d}.png" for number in range(1, FRAMES + 1)]
    start = paths.index("long/0013/half0001_0.png")
    assert (store.dataset, paths[start + 1 : start + 1 + FRAMES]) == ("drv", clip)
    assert store.manifest is not None
    assert {record.path for record in store.manifest.records} == {*paths}
    assert store.manifest.card.counts == {"noisy": 3 * FRAMES, "reference": 2}
    by_path = {record.path: record.reference for record in store.manifest.records}
    assert by_path["VBM4D_rawRGB/0007/0003.png"] == "long/0007/half0001_0.png"
    assert by_path["VBM4D_rawRGB/M0003/0003.png"] is None


# --- what is packed, and what cannot be ---------------------------------------------------------------------------


def test_what_cannot_be_packed(tree: Tree, drv: SmallDrv, tmp_path: Path) -> None:
    def dataset(name: str, **options: Any) -> object:
        return source_of_dataset(name, **{"root": tree.root, **options})

    refusals: tuple[tuple[type[Exception], str, Callable[[], object]], ...] = (
        (ManifestError, "no dataset is called 'nothing'", lambda: dataset("nothing")),
        (DatasetError, "data/DRV: there is no such folder; --root names the folder", lambda: dataset("drv")),
        (DatasetError, "data/DRV: there is no such folder", lambda: dataset("drv-raw")),
        (ArgumentError, "holds pairs, not clips", lambda: dataset("eld-demo", manifest=tree.csv, ids=["0007"])),
        (ArgumentError, "DemoBeta", lambda: dataset("eld-demo", manifest=tree.csv, cameras=["X"])),
        (ArgumentError, "is the manifest of 'eld-demo', not of 'eld'", lambda: dataset("eld", manifest=tree.csv)),
        (ArgumentError, "no clip has split x", lambda: dataset("drv", root=drv.root, manifest=drv.csv, split=["x"])),
        # The shipped list has 225 clips: what is missing is not left out in silence.
        (DatasetError, "no frames of 222 clips.*with ids", lambda: dataset("drv", root=drv.root)),
        (DatasetError, "holds no camera raw file", lambda: source_of_folder(tmp_path)),
    )
    for error, words, work in refusals:
        with pytest.raises(error, match=words):
            work()
    source = source_of_folder(tree.data)
    with pytest.raises(ArgumentError, match="compression must be one of 'none', 'lz4', 'zstd'; found 'gzip'"):
        build_store(source, tmp_path / "x.h5", compression="gzip")  # type: ignore[arg-type]
    with pytest.raises(EldataError, match=r"cannot write .*nowhere/x.h5: No such file"):
        build_store(source, tmp_path / "nowhere" / "x.h5")
    assert not any(tmp_path.iterdir())
    (tmp_path / "x.h5").touch()
    with pytest.raises(EldataError, match=r"x\.h5: is there already"):
        build_store(source, tmp_path / "x.h5")


def test_without_hdf5plugin_an_uncompressed_store_works(
    clean: Packed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pack_folder(clean.source.folder, tmp_path / "lz4.h5", compression="lz4")
    monkeypatch.setitem(sys.modules, "hdf5plugin", None)
    assert len(build_store(clean.source, tmp_path / "plain.h5").frames) == 4
    words = r"needs the package hdf5plugin: pip install 'eldata\[compression\]'"
    with pytest.raises(ArgumentError, match=words):
        build_store(clean.source, tmp_path / "other.h5", compression="zstd")
    with pytest.raises(ArgumentError, match=words):
        Store(tmp_path / "lz4.h5")


# --- what ends the work half-way ----------------------------------------------------------------------------------


def test_a_store_is_on_the_disk_before_it_gets_its_name(
    clean: Packed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk = OnDisk(monkeypatch)
    build_store(clean.source, tmp_path / "store.h5")
    assert disk.named == {"store.h5": True}


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
    command = [sys.executable, "-B", "-c", code, "pack", str(clean.source.folder), "-o", str(tmp_path / "store.h5")]
    done = subprocess.run([*command, "--jobs", "1", "--compression", compression], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == f"eldata pack: cannot write {tmp_path / 'store.h5'}: File too large\n"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("compression", "call"), [("none", 3), ("lz4", 12)])
def test_a_signal_while_hdf5_writes_comes_after_it_and_leaves_nothing(
    compression: Any, call: int, clean: Packed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """HDF5 calls Python for each write, and goes on without the chunk if that raises."""

    class Disk(write._Disk):
        calls = 0

        def seek(self, *place: int) -> int:  # as the file is opened, and before each write
            self.calls += 1
            if self.calls == call:
                os.kill(os.getpid(), signal.SIGINT)
            return super().seek(*place)

    opened = h5py.h5f.get_obj_count()
    monkeypatch.setattr(write, "_Disk", Disk)
    with pytest.raises(KeyboardInterrupt):
        build_store(clean.source, tmp_path / "store.h5", compression=compression)
    assert h5py.h5f.get_obj_count() == opened
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_cannot_be_decoded_leaves_nothing(clean: Packed, tmp_path: Path) -> None:
    folder = write_clean(tmp_path / "raws")
    whole = (folder / "2.dng").read_bytes()
    (folder / "2.dng").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(RawFileError, match=r"2\.dng: truncated"):
        pack_folder(folder, tmp_path / "store.h5", workers=2)
    assert [path.name for path in tmp_path.iterdir()] == ["raws"]
    (folder / "2.dng").write_bytes(whole)
    build_store(source_of_folder(folder), tmp_path / "store.h5")
    assert (tmp_path / "store.h5").read_bytes() == clean.store.read_bytes()


def test_a_clip_without_its_reference_is_found(drv: SmallDrv, tmp_path: Path) -> None:
    source = source_of_dataset("drv", root=drv.root, manifest=drv.csv, ids=["0007"])
    lone = replace(source, files=tuple(file for file in source.files if file[1] == "noisy"))
    build_store(lone, tmp_path / "lone.h5")
    found = [(problem.path, problem.field, problem.found) for problem in verify_store(tmp_path / "lone.h5").problems]
    assert found == [(f"VBM4D_rawRGB/0007/{number:04d}.png", "reference", "nothing") for number in range(1, FRAMES + 1)]
