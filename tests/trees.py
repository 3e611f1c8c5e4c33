"""Small datasets of real DNG files for tests: made once, copied where a test damages them.

``python -m tests.trees NAME FOLDER`` writes the small files of a shipped manifest into a folder.
"""

from __future__ import annotations

import os
import re
import shutil
import sys
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import IO

import numpy as np
import pytest
import tifffile

from eldata.base.files import atomic_write
from eldata.demo.tree import make_tree
from eldata.manifest.card import counts_of, save_card
from eldata.manifest.catalogue import Manifest, load_manifest, shipped_manifest
from eldata.manifest.table import save_records
from eldata.raw.dng import write_dng
from eldata.raw.reading import read_raw
from eldata.records import Exposure, FrameRecord, Sensor

SIZE = (64, 96)
_FIELD = re.compile(r"\{\w+\}")
ALPHA, BETA = "DemoAlpha/scene-1", "DemoBeta/scene-1"


def frame(number: int, scene: str = ALPHA) -> str:
    """A frame's path in the manifest."""
    return f"{scene}/IMG_{number:04d}.dng"


@dataclass(frozen=True)
class Tree:
    """A dataset on disk: its manifest's CSV, and the data root with the files, which lie in a folder of it."""

    csv: Path
    root: Path
    folder: str = "ELD-demo"

    @property
    def manifest(self) -> Manifest:
        """The manifest as it is on disk now."""
        return load_manifest(self.csv)

    @property
    def data(self) -> Path:
        """The dataset's own folder."""
        return self.root / self.folder

    def file(self, number: int, scene: str = ALPHA) -> Path:
        return self.data / frame(number, scene)


def build_tree(folder: Path) -> Tree:
    """Two cameras, one scene, sixteen frames each: 32 files, 64 x 96 pixels. The fixture ``demo_tree`` has them."""
    make_tree(folder, scenes=1, size=SIZE)
    return tree_in(folder)


def tree_in(folder: Path) -> Tree:
    """The demo's tree that lies in ``folder``."""
    return Tree(folder / "manifests" / "eld-demo.csv", folder / "data")


def copy_tree(tree: Tree, folder: Path) -> Tree:
    """A copy that a test may damage."""
    shutil.copytree(tree.csv.parent, folder / "manifests")
    shutil.copytree(tree.root, folder / "data")
    return Tree(folder / "manifests" / tree.csv.name, folder / "data")


def retake(path: Path, *, model: str | None = None, exposure: Exposure | None = None) -> None:
    """Write a raw file again with another camera model or exposure, the pixels as they are."""
    raw = read_raw(path)
    sensor = raw.sensor if model is None else replace(raw.sensor, model=model)
    write_dng(path, raw.mosaic, sensor, exposure or raw.exposure, compression="lossless-jpeg")


def scale_exposure(path: Path, factor: Fraction) -> None:
    """Write a raw file again with its exposure time multiplied."""
    raw = read_raw(path)
    assert raw.exposure.exposure_s is not None
    retake(path, exposure=replace(raw.exposure, exposure_s=raw.exposure.exposure_s * factor))


def swap(first: Path, second: Path) -> None:
    """Exchange two files."""
    aside = first.with_name("aside")
    first.rename(aside)
    second.rename(first)
    aside.rename(second)


def flip_compressed_byte(path: Path) -> None:
    """Flip one bit in the middle of a raw file's compressed pixels; its size and header stay."""
    with tifffile.TiffFile(path) as tiff:
        page = tiff.pages.first
        at = page.dataoffsets[0] + page.databytecounts[0] // 2
    content = bytearray(path.read_bytes())
    content[at] ^= 1
    path.write_bytes(content)


# --- a published set's file names, with small files inside ------------------------------------------------------


def place_of(record: FrameRecord, folder: Path) -> Path:
    """Where a file of a dataset lies, in a folder that is there."""
    path = folder / record.path
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


def write_each_once(
    folder: Path, records: Iterable[FrameRecord], kind: Callable[[FrameRecord], object],
    write: Callable[[FrameRecord], object],
) -> None:  # fmt: skip
    """Write files; those of one kind are one under several names (hard links), which saves time and says nothing."""
    made: dict[object, Path] = {}
    for record in records:
        path = place_of(record, folder)
        if kind(record) in made:
            os.link(made[kind(record)], path)
        else:
            write(record)
            made[kind(record)] = path


def list_scenes(name: str, folder: Path, scenes: Collection[str]) -> Path:
    """Write a manifest of some scenes of a published set alone; return its CSV file."""
    published = shipped_manifest(name)
    records = [record for record in published.records if record.scene in scenes]
    csv = folder / "manifests" / f"{name}.csv"
    csv.parent.mkdir(parents=True)
    save_records(csv, records)
    save_card(csv.with_suffix(".json"), replace(published.card, counts=counts_of(records), subsets=()))
    return csv


def build_published_tree(manifest: Manifest, folder: Path) -> None:
    """Lay a shipped manifest's files out in ``folder``: every name that it lists, small DNG files inside.

    Exposures are the manifest's where it has them. References take 4 s at ISO 100 where it has none, noisy frames then
    what their nominal ratio asks for; frames flagged ``inexact-ratio`` are 1/16 off, as the published one is. Equal
    frames are one file under several names (hard links), which saves time and says nothing. What fields of a path stand
    for is 1 and 2 here.
    """
    mosaic = np.random.default_rng(1).integers(600, 15000, (48, 64), dtype=np.uint16)
    records = [
        replace(
            record,
            path=_FIELD.sub(text, record.path),
            reference=None if record.reference is None else _FIELD.sub(text, record.reference),
        )
        for record in manifest.records
        for text in (("1", "2") if "{" in record.path else ("",))
    ]
    record_of = {record.path: record for record in records}

    def write(record: FrameRecord) -> None:
        model = (record.camera, *manifest.card.cameras[record.camera].models)[-1]
        sensor = Sensor("Maker", model, ((0, 1), (3, 2)), (512.0,) * 4, 16383.0, *mosaic.shape)
        write_dng(folder / record.path, mosaic, sensor, _exposure_of(record, record_of))

    write_each_once(folder, records, lambda one: (one.camera, _exposure_of(one, record_of)), write)


def _exposure_of(record: FrameRecord, record_of: dict[str, FrameRecord]) -> Exposure:
    iso = record.iso or Fraction(100)
    exposure_s = record.exposure_s or Fraction(4)
    if record.exposure_s is None and record.reference is not None and record.ratio is not None:
        reference = _exposure_of(record_of[record.reference], record_of)
        assert reference.iso is not None
        assert reference.exposure_s is not None
        exposure_s = reference.iso * reference.exposure_s / (iso * record.ratio)
        if "inexact-ratio" in record.flags:
            exposure_s *= Fraction(16, 15)
    return Exposure(iso, exposure_s, Fraction(8))


def interrupt_manifest(patch: pytest.MonkeyPatch, suffix: str) -> None:
    """Have the file of a manifest with this suffix meet Ctrl-C between its last byte and its renaming."""

    @contextmanager
    def write(path: Path) -> Iterator[IO[bytes]]:
        with atomic_write(path) as file:
            yield file
            if path.suffix == suffix:
                raise KeyboardInterrupt

    for module in ("manifest.catalogue", "base.files"):
        patch.setattr(f"eldata.{module}.atomic_write", write)


if __name__ == "__main__":
    build_published_tree(shipped_manifest(sys.argv[1]), Path(sys.argv[2]))
