"""The published Low-light Raw Image Denoising set (LRID): its bursts and rows.

Noisy frames are ``<part>/6400/<gain>/<scene>/<number>_exp-<ns>_iso-6400_<time>_orientation_<degrees>_camera-0.dng``,
ten in a burst; the reference of a scene is ``<part>/npy/GT_align_ours/<scene>.npy``, fused from frames of ISO 100. The
gain is the exposure ratio.

Sources: H. Feng et al., "Learnability Enhancement for Low-Light Raw Image Denoising: A Data Perspective", TPAMI 2024;
the PMN repository's branch TPAMI: infos, README, get_dataset_infos.py, data_process/phone_datasets.py, trainer_LRID.py.

No public text lists the dark frames: ``bias/6400`` and ``bias-hot/6400`` are read as whole folders, and are patterns.
"""

from __future__ import annotations

import pickletools
import re
from collections import defaultdict
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import TYPE_CHECKING

from eldata.base.fields import TextFile
from eldata.base.files import write_text
from eldata.base.tables import csv_text
from eldata.errors import ManifestError
from eldata.manifest.pairs import NOMINAL_RATIO, WARM_SENSOR
from eldata.records import FrameRecord

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

CAMERA = "IMX686"
ISO, REFERENCE_ISO = Fraction(6400), Fraction(100)
NANOSECONDS = 10**9

# Parts of the set, each with the scenes that the published code scores (PhoneBase_Dataset.data_split) and the name of
# their split; the rest is for training.
SCORED = {
    "indoor_x5": ("eval", (4, 14, 25, 41, 44, 51, 52, 53, 58)),
    "indoor_x3": ("", ()),
    "outdoor_x3": ("test", (9, 21, 22, 32, 44, 51)),
}

# Scenes that the published code takes the dark frames of a warm sensor for (PhoneBase_Dataset.hot_check).
WARM = {
    "indoor_x5": (6, 15, 33, 35, 37, 39, 46, 59),
    "indoor_x3": (1, 2, 4, 5, 6, 10, *range(12, 20)),
    "outdoor_x3": (*range(6), 7, *range(10, 20), 22, 26, 30, 51, 52, 54, 55, 56),
}

_COLUMNS = ("part", "scene", "gain", "exposure_ns", "orientation", "frames")
_NOISY = re.compile(
    r".*[\\/](\w+)[\\/]6400[\\/](\d+)[\\/](\d{3})[\\/](\d{6})_exp-(\d+)_iso-6400_([\d_]+)_orientation_(\d+)_camera-0\.dng"
)
_REFERENCE = re.compile(r".*[\\/](\w+)[\\/]npy[\\/]GT_align_ours[\\/](\d{3})\.npy")


@dataclass(frozen=True, slots=True)
class Burst:
    """The noisy frames of one scene and gain.

    A frame is its number and its time as in the name: ``005062@2022_08_17_05_33_48_461_9688422862537``.
    """

    part: str
    scene: str
    gain: int
    exposure_ns: int
    orientation: int
    frames: tuple[str, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """The frames' paths."""
        folder = f"{self.part}/6400/{self.gain}/{self.scene}"
        return tuple(
            f"{folder}/{number}_exp-{self.exposure_ns}_iso-6400_{time}_orientation_{self.orientation}_camera-0.dng"
            for number, _, time in (frame.partition("@") for frame in self.frames)
        )


def lrid_records(bursts: Iterable[Burst]) -> tuple[FrameRecord, ...]:
    """Return the rows of the set, sorted by path."""
    rows = {
        f"{folder}/6400/*.dng": FrameRecord(f"{folder}/6400/*.dng", "bias", CAMERA, iso=ISO, flags=flags)
        for folder, flags in (("bias", ()), ("bias-hot", (WARM_SENSOR,)))
    }
    for burst in bursts:
        scene = f"{burst.part}-{burst.scene}"
        name, scored = SCORED[burst.part]
        split = name if int(burst.scene) in scored else "train"
        reference = f"{burst.part}/npy/GT_align_ours/{burst.scene}.npy"
        rows[reference] = FrameRecord(reference, "reference", CAMERA, scene, split, REFERENCE_ISO)
        exposure_s = Fraction(burst.exposure_ns, NANOSECONDS)
        warm = (WARM_SENSOR,) if int(burst.scene) in WARM[burst.part] else ()
        noisy = FrameRecord("", "noisy", CAMERA, scene, split, ISO, exposure_s, Fraction(burst.gain))
        noisy = replace(noisy, reference=reference, flags=(NOMINAL_RATIO, *warm))
        rows |= {path: replace(noisy, path=path) for path in burst.names}
    return tuple(sorted(rows.values(), key=lambda row: row.path))


def bursts_from_infos(folder: Path) -> tuple[Burst, ...]:
    """Condense the published info files (``indoor_x5_short.info`` and so on) to a table of bursts.

    They are pickles, which are not run: the paths are among their texts.

    Raises
    ------
    ManifestError
        If the frames of a burst differ in what a burst has once, or scenes and references are not the same.
    """
    bursts = []
    for part in SCORED:
        found: dict[tuple[str, int], list[tuple[str, int, int]]] = defaultdict(list)
        for match in _matches(folder / f"{part}_short.info", _NOISY):
            frame = f"{match[4]}@{match[6]}"
            found[match[3], int(match[2])].append((frame, int(match[5]), int(match[7])))
        references = {match[2] for match in _matches(folder / f"{part}_GT_align_ours.info", _REFERENCE)}
        if references != {scene for scene, _ in found}:
            raise ManifestError(f"{folder}: the references of {part} are not those of its scenes")
        for (scene, gain), frames in sorted(found.items()):
            facts = {(exposure_ns, orientation) for _, exposure_ns, orientation in frames}
            if len(facts) != 1:
                raise ManifestError(f"{folder}: {part}, gain {gain}, scene {scene}: frames differ: {sorted(facts)}")
            ((exposure_ns, orientation),) = facts
            bursts.append(Burst(part, scene, gain, exposure_ns, orientation, tuple(sorted(f for f, _, _ in frames))))
    return tuple(bursts)


def _matches(path: Path, pattern: re.Pattern[str]) -> list[re.Match[str]]:
    texts = (argument for _, argument, _ in pickletools.genops(path.read_bytes()) if isinstance(argument, str))
    return [match for text in texts if (match := pattern.fullmatch(text))]


def save_bursts(path: Path, bursts: Iterable[Burst]) -> None:
    """Write a table of bursts, whole or not at all."""
    rows = ((b.part, b.scene, b.gain, b.exposure_ns, b.orientation, ";".join(b.frames)) for b in bursts)
    write_text(path, csv_text(_COLUMNS, rows))


def load_bursts(path: Path) -> tuple[Burst, ...]:
    """Read a table of bursts.

    Raises
    ------
    ManifestError
        If it cannot be read, has other columns, or has a number that is not one.
    """
    return tuple(
        Burst(
            row.text("part"),
            row.text("scene"),
            row.whole("gain"),
            row.whole("exposure_ns"),
            row.whole("orientation"),
            tuple(row.text("frames").split(";")),
        )
        for row in TextFile(path, ManifestError).rows(_COLUMNS)
    )
