"""The layout of the See-in-the-Dark dataset (SID): its file names, what they say, and the rows that follow.

A file is ``<folder>/{short,long}/SNNNN_BB_Ts.<ext>``. SNNNN is the scene, its first digit S the split (0 train, 1 test,
2 validation); BB is the number in the burst; T is the exposure time in seconds, where ``0.033`` means 1/30. Every scene
has one long exposure, ``00``, and bursts of short ones, numbered from ``00`` on without gaps. So a table of one row per
scene says it all: its ISO, its long exposure, and how many shots each short burst has.

The exposure ratio is that of the times, at most 300, as in the published code. There the cap is for 10 / 0.033 = 303;
with the true 1/30 s no pair of the lists lies above 300, so that the nominal ratio is also the true one.

Sources: C. Chen, Q. Chen, J. Xu and V. Koltun, "Learning to See in the Dark", CVPR 2018; the SID repository's file
lists, README, test_Sony.py and test_Fuji.py.
"""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

from eldata.base.fields import TextFile
from eldata.base.files import write_text
from eldata.base.tables import csv_text
from eldata.errors import ManifestError
from eldata.manifest.pairs import UNCERTAIN_ISO
from eldata.records import FrameRecord

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

EXPOSURES_S = {
    "0.033s": Fraction(1, 30),
    "0.04s": Fraction(1, 25),
    "0.1s": Fraction(1, 10),
    "10s": Fraction(10),
    "30s": Fraction(30),
}
SHORT_EXPOSURES = ("0.1s", "0.04s", "0.033s")
LARGEST_RATIO = Fraction(300)
SPLITS = {"0": "train", "1": "test", "2": "val"}

MISALIGNED = "misaligned"
MISALIGNED_UNCONFIRMED = "misaligned-unconfirmed"


@dataclass(frozen=True, slots=True)
class SidCamera:
    """One half of the set.

    Attributes
    ----------
    name
        Camera, as the ELD manifest and the noise profiles call it.
    folder, extension
        Those of its files, the extension with the dot.
    misaligned, misaligned_unconfirmed
        Scenes whose pairs are misaligned according to the authors; according to others, or possibly.
    uncertain_iso
        Short frames whose ISO in the lists differs from their scene's.
    """

    name: str
    folder: str
    extension: str
    misaligned: tuple[str, ...] = ()
    misaligned_unconfirmed: tuple[str, ...] = ()
    uncertain_iso: tuple[str, ...] = ()

    def path(self, kind: str, scene: str, burst: int, exposure: str) -> str:
        """Return a frame's path relative to the dataset's folder; ``kind`` is ``short`` or ``long``."""
        return f"{self.folder}/{kind}/{scene}_{burst:02d}_{exposure}{self.extension}"


@dataclass(frozen=True, slots=True)
class SidScene:
    """One scene: ``iso`` of all of its frames, its ``long`` exposure, and the number of ``shots`` per short exposure.

    Exposures are named as in the files: a key of :data:`EXPOSURES_S`.
    """

    scene: str
    iso: int
    long: str
    shots: Mapping[str, int]


SONY = SidCamera(
    name="SonyA7S2",
    folder="Sony",
    extension=".ARW",
    misaligned=("10034", "10045", "10172"),
    misaligned_unconfirmed=("00108", "00183"),
    uncertain_iso=("Sony/short/00207_02_0.033s.ARW",),
)
FUJI = SidCamera(
    name="FujifilmXT2",
    folder="Fuji",
    extension=".RAF",
    misaligned_unconfirmed=("10172",),
)
SID_CAMERAS = {"sid-sony": SONY, "sid-fuji": FUJI}


def nominal_ratio(long: str, short: str) -> Fraction:
    """Return the exposure ratio of two named exposures, at most 300."""
    return min(EXPOSURES_S[long] / EXPOSURES_S[short], LARGEST_RATIO)


def sid_records(camera: SidCamera, scenes: Iterable[SidScene]) -> tuple[FrameRecord, ...]:
    """Return the rows of one half of the set, sorted by path.

    ``exposure_s`` and ``ratio`` are exact; the short frames carry the flags, which are about pairs.
    """
    rows = []
    for scene in scenes:
        split = SPLITS[scene.scene[0]]
        reference = camera.path("long", scene.scene, 0, scene.long)
        iso = Fraction(scene.iso)
        long_s = EXPOSURES_S[scene.long]
        rows.append(FrameRecord(reference, "reference", camera.name, scene.scene, split, iso, long_s))
        for exposure, count in scene.shots.items():
            for burst in range(count):
                path = camera.path("short", scene.scene, burst, exposure)
                flags = _flags(camera, scene.scene, path)
                rows.append(
                    FrameRecord(
                        path=path,
                        role="noisy",
                        camera=camera.name,
                        scene=scene.scene,
                        split=split,
                        iso=None if UNCERTAIN_ISO in flags else iso,
                        exposure_s=EXPOSURES_S[exposure],
                        ratio=nominal_ratio(scene.long, exposure),
                        reference=reference,
                        flags=flags,
                    )
                )
    return tuple(sorted(rows, key=lambda row: row.path))


def _flags(camera: SidCamera, scene: str, path: str) -> tuple[str, ...]:
    flags = (
        (MISALIGNED, scene in camera.misaligned),
        (MISALIGNED_UNCONFIRMED, scene in camera.misaligned_unconfirmed),
        (UNCERTAIN_ISO, path in camera.uncertain_iso),
    )
    return tuple(flag for flag, applies in flags if applies)


# --- the table of scenes ----------------------------------------------------------------------------------------

_COLUMNS = ("scene", "iso", "long", *SHORT_EXPOSURES)


def load_scenes(path: Path) -> tuple[SidScene, ...]:
    """Read a table of scenes: CSV with the columns ``scene, iso, long`` and the number of shots per short exposure.

    Raises
    ------
    ManifestError
        If it cannot be read, has other columns, or has a number that is not one.
    """
    return tuple(
        SidScene(
            row.text("scene"), row.whole("iso"), row.text("long"), {key: row.whole(key) for key in SHORT_EXPOSURES}
        )
        for row in TextFile(path, ManifestError).rows(_COLUMNS)
    )


def save_scenes(path: Path, scenes: Iterable[SidScene]) -> None:
    """Write a table of scenes, whole or not at all."""
    rows = (
        (item.scene, item.iso, item.long, *(item.shots.get(name, 0) for name in SHORT_EXPOSURES)) for item in scenes
    )
    write_text(path, csv_text(_COLUMNS, rows))


def scenes_from_lists(camera: SidCamera, lists: Iterable[Path]) -> tuple[SidScene, ...]:
    """Condense the official file lists (``Sony_train_list.txt`` and so on) to a table of scenes.

    A line is ``./Sony/short/00001_00_0.04s.ARW ./Sony/long/00001_00_10s.ARW ISO200 F8``.

    Raises
    ------
    ManifestError
        If a line has another form, a burst has a gap, a scene has two long exposures, or a frame that
        ``camera.uncertain_iso`` does not name has another ISO than its scene: the table could not say it.
    """
    folder, extension = re.escape(camera.folder), re.escape(camera.extension)
    name = rf"(\d{{5}})_(\d\d)_([\d.]+s){extension}"
    line_form = re.compile(rf"\./{folder}/short/{name} \./{folder}/long/{name} ISO(\d+) F[\d.]+")
    bursts: dict[str, dict[str, list[int]]] = {}
    longs: dict[str, set[str]] = {}
    isos: dict[str, dict[str, int]] = {}
    for path in lists:
        for number, line in enumerate(TextFile(path, ManifestError).text().splitlines(), 1):
            match = line_form.fullmatch(line.strip())
            if match is None or (match[1], 0) != (match[4], int(match[5])):
                raise ManifestError(f"{path} line {number}: not a line of a SID list: {line!r}")
            scene, burst, short, long = match[1], int(match[2]), match[3], match[6]
            bursts.setdefault(scene, {}).setdefault(short, []).append(burst)
            longs.setdefault(scene, set()).add(long)
            isos.setdefault(scene, {})[camera.path("short", scene, burst, short)] = int(match[7])
    scenes = []
    for scene in sorted(bursts):
        iso = Counter(isos[scene].values()).most_common(1)[0][0]
        odd = [path for path, found in isos[scene].items() if found != iso and path not in camera.uncertain_iso]
        gaps = [short for short, found in bursts[scene].items() if sorted(found) != list(range(len(found)))]
        if odd or gaps or len(longs[scene]) != 1:
            raise ManifestError(
                f"scene {scene}: of another ISO: {odd}; bursts with gaps: {gaps}; long: {sorted(longs[scene])}"
            )
        shots = {short: len(bursts[scene].get(short, ())) for short in SHORT_EXPOSURES}
        scenes.append(SidScene(scene, iso, longs[scene].pop(), shots))
    return tuple(scenes)
