"""The published Low-light Raw Denoising set (LRD): its scenes and rows.

A file is ``Clean/NNNNN_00_Ts.DNG`` or ``Noisy/NNNNN_0E_Ts.DNG``: NNNNN is the scene, T its exposure time in seconds,
rounded to five decimals, E the exposure bias, 1 to 3 stops below. The ratio is that of the published code, from the
names: 100 T / (ISO t), the clean frames being of ISO 100.

Sources: F. Zhang et al., "Towards General Low-Light Raw Noise Synthesis and Modeling", ICCV 2023; the LRD repository's
lists of pairs, README, test_denoise_LRD.py and datasets/Denoise_dataset.py.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

from eldata.base.fields import TextFile
from eldata.base.files import write_text
from eldata.base.tables import csv_text
from eldata.errors import ManifestError
from eldata.records import FrameRecord

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

CAMERA = "IMX586"
CLEAN_ISO = Fraction(100)
BIASES = (1, 2, 3)
SPLITS = ("train", "val", "test")

_COLUMNS = ("scene", "split", "iso", "clean", "1ev", "2ev", "3ev")
_NAME = r"(\d{5})_(\d\d)_([\d.]+)s\.DNG"
_LINE = re.compile(rf"\./LRD/Clean/{_NAME} \./LRD/Noisy/{_NAME} ISO(\d+) -(\d)EV")


@dataclass(frozen=True, slots=True)
class LrdScene:
    """One scene: ``iso`` of its noisy frames, and exposure times as in the names: ``clean``, and three ``noisy``."""

    scene: str
    split: str
    iso: int
    clean: str
    noisy: tuple[str, ...]


def lrd_records(scenes: Iterable[LrdScene]) -> tuple[FrameRecord, ...]:
    """Return the rows of the set, sorted by path."""
    rows = []
    for scene in scenes:
        reference = f"Clean/{scene.scene}_00_{scene.clean}s.DNG"
        clean_s, iso = Fraction(scene.clean), Fraction(scene.iso)
        rows.append(FrameRecord(reference, "reference", CAMERA, scene.scene, scene.split, CLEAN_ISO, clean_s))
        for bias, time in zip(BIASES, scene.noisy, strict=True):
            ratio = CLEAN_ISO * clean_s / (iso * Fraction(time))
            path = f"Noisy/{scene.scene}_{bias:02d}_{time}s.DNG"
            rows.append(
                FrameRecord(
                    path, "noisy", CAMERA, scene.scene, scene.split, iso, Fraction(time), ratio, reference=reference
                )
            )
    return tuple(sorted(rows, key=lambda row: row.path))


def lrd_scenes_from_lists(lists: Mapping[str, Path]) -> tuple[LrdScene, ...]:
    """Condense the official lists of pairs (``LRD_train_list.txt`` and so on), by split, to a table of scenes.

    A line is ``./LRD/Clean/00541_00_0.05s.DNG ./LRD/Noisy/00541_01_0.01s.DNG ISO200 -1EV``.

    Raises
    ------
    ManifestError
        If a line has another form, or a scene has not one clean frame, one ISO, one split and three biases: the table
        could not say it.
    """
    stated: dict[str, set[tuple[str, int, str]]] = {}
    noisy: dict[str, dict[int, str]] = {}
    for split, path in lists.items():
        for number, line in enumerate(TextFile(path, ManifestError).text().splitlines(), 1):
            match = _LINE.fullmatch(line.strip())
            if match is None or (match[1], match[2]) != (match[4], "00") or int(match[5]) != int(match[8]):
                raise ManifestError(f"{path} line {number}: not a line of an LRD list: {line!r}")
            stated.setdefault(match[1], set()).add((split, int(match[7]), match[3]))
            if noisy.setdefault(match[1], {}).setdefault(int(match[8]), match[6]) != match[6]:
                raise ManifestError(f"{path} line {number}: a second frame of -{match[8]}EV of scene {match[1]}")
    scenes = []
    for scene in sorted(stated):
        facts, times = stated[scene], noisy[scene]
        if len(facts) != 1 or sorted(times) != list(BIASES):
            raise ManifestError(f"scene {scene}: {sorted(facts)}, biases {sorted(times)}")
        ((split, iso, clean),) = facts
        scenes.append(LrdScene(scene, split, iso, clean, tuple(times[bias] for bias in BIASES)))
    return tuple(scenes)


def save_lrd_scenes(path: Path, scenes: Iterable[LrdScene]) -> None:
    """Write a table of scenes, whole or not at all."""
    write_text(path, csv_text(_COLUMNS, ((s.scene, s.split, s.iso, s.clean, *s.noisy) for s in scenes)))


def load_lrd_scenes(path: Path) -> tuple[LrdScene, ...]:
    """Read a table of scenes.

    Raises
    ------
    ManifestError
        If it cannot be read, has other columns, or has a number that is not one.
    """
    return tuple(
        LrdScene(
            row.text("scene"),
            row.text("split"),
            row.whole("iso"),
            row.text("clean"),
            tuple(row.text(f"{bias}ev") for bias in BIASES),
        )
        for row in TextFile(path, ManifestError).rows(_COLUMNS)
    )
