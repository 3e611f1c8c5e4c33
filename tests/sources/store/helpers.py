"""Small raws, stores of them, and what a store holds, for the tests of stores."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from eldata.raw import write_dng
from eldata.sources.store import Source, build_store, source_of_dataset, source_of_folder
from tests.drv_tree import SmallDrv
from tests.raw.helpers import BAYER, EXPOSURE, NONA, QUAD, XTRANS, make_sensor, random_mosaic
from tests.sid_tree import SmallTree
from tests.trees import Tree

CFAS = (BAYER["RGGB"], BAYER["GBRG"], XTRANS["xtrans-00"], XTRANS["xtrans-42"], QUAD["quad-31"], NONA["nona-14"])
SHAPES = ((300, 400), (131, 515), (60, 66), (150, 133), (133, 270), (61, 75))


@dataclass(frozen=True)
class Packed:
    """A store and what it was made from."""

    store: Path
    source: Source


def write_clean(folder: Path, count: int = 4) -> Path:
    """Write raws of several cameras: sizes below, at and above a chunk, none of them a multiple."""
    folder.mkdir(parents=True)
    for number in range(count):
        cfa, (height, width) = CFAS[number % 6], SHAPES[number % 6]
        sensor = make_sensor(cfa, height, width)
        write_dng(folder / f"{number}.dng", random_mosaic(height, width, seed=number), sensor, EXPOSURE)
    return folder


def pack_tree(tree: Tree | SmallTree | SmallDrv, store: Path, **options: Any) -> Packed:
    """Pack all pairs of a tree."""
    source = source_of_dataset(tree.manifest.name, root=tree.root, manifest=tree.csv)
    build_store(source, store, **options)
    return Packed(store, source)


def pack_folder(folder: Path, store: Path, **options: Any) -> Packed:
    """Pack a folder of clean raws."""
    source = source_of_folder(folder)
    build_store(source, store, **options)
    return Packed(store, source)
