"""A set of the user's own: a few pairs of small DNG files with colour, in no published layout."""

from __future__ import annotations

import zlib
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eldata.demo.tree import demo_card
from eldata.evaluation import save_prediction
from eldata.manifest.card import OWN_PROTOCOL, cfa_word, save_card
from eldata.manifest.table import save_records
from eldata.raw.dng import write_dng
from eldata.raw.levels import pack, packing_sites
from eldata.records import Exposure, FrameRecord, Role, Sensor
from tests.raw.helpers import Cfa

GBRG: Cfa = ((3, 2), (0, 1))
BLACK = (510.0, 511.0, 513.0, 514.0)
WHITE = 15300.0
SIZE = (60, 84)
WHITE_BALANCE = (2.1, 1.0, 1.6, 1.0)
MATRIX = ((0.7, -0.2, -0.05), (-0.4, 1.2, 0.2), (-0.05, 0.15, 0.6))


def sensor_of(size: tuple[int, int], *, cfa: Cfa = GBRG, black: tuple[float, ...] = BLACK) -> Sensor:
    """Black levels of its own, a white level that is no published one."""
    return Sensor("Maker", "Mine 1", cfa, black, WHITE, *size, WHITE_BALANCE, MATRIX)


def mosaic_of(path: str, size: tuple[int, int], *, bright: bool) -> NDArray[np.uint16]:
    """Smooth structure with noise; a reference has values below black, at both white levels, and between them."""
    generator = np.random.default_rng(zlib.crc32(path.encode()))
    rows, columns = np.mgrid[: size[0], : size[1]]
    wave = 0.5 + 0.45 * np.sin(rows / 7.0 + generator.uniform(0, 6)) * np.cos(columns / 11.0)
    span = 14000.0 if bright else 140.0
    mosaic = 512 + span * wave + generator.normal(0, 40 if bright else 8, size)
    if bright:
        middle = (size[0] // 2, size[1] // 2)
        mosaic[middle[0] : middle[0] + 6, middle[1] : middle[1] + 8] = 16383
        mosaic[middle[0] - 8 : middle[0], middle[1] : middle[1] + 8] = 15700
        mosaic[middle[0] : middle[0] + 6, middle[1] - 8 : middle[1]] = 480
    result: NDArray[np.uint16] = np.clip(np.rint(mosaic), 1, 16383).astype(np.uint16)
    return result


class Placed:
    """A set's ``manifest``, which is the CSV, and its data root, as evaluations take them."""

    manifest: Any
    root: Any

    @property
    def where(self) -> dict[str, Any]:
        """What every evaluation of it is given."""
        return {"manifest": self.manifest, "root": self.root}

    @property
    def arguments(self) -> list[str]:
        """The same for a command; of small frames, starting workers is what takes time."""
        return ["--manifest", str(self.manifest), "--root", str(self.root), "--jobs", "1"]


@dataclass(frozen=True)
class OwnSet(Placed):
    """A set and its predictions."""

    manifest: Path
    root: Path

    @property
    def files(self) -> Path:
        return self.root / "MINE"

    @property
    def predictions(self) -> Path:
        """Of the fixture ``own``."""
        return self.root.parent / "preds"


def build_own_set(
    folder: Path, *,
    ratios: tuple[int, ...] = (50, 100), scenes: int = 1, size: tuple[int, int] = SIZE, cfa: Cfa = GBRG,
    black: tuple[float, ...] = BLACK,
) -> OwnSet:  # fmt: skip
    """One camera; each scene has a reference and one noisy frame a ratio."""
    sensor = sensor_of(size, cfa=cfa, black=black)
    records = []
    root = folder / "data"
    for scene in (f"s{number}" for number in range(scenes)):
        reference = f"{scene}/clean.dng"
        frames: list[tuple[str, Role, Fraction, Fraction, Fraction | None]] = [
            (reference, "reference", Fraction(100), Fraction(4), None)
        ]
        frames += [(f"{scene}/x{r}.dng", "noisy", Fraction(1600), Fraction(1, 4) / r, Fraction(r)) for r in ratios]
        for path, role, iso, exposure_s, ratio in frames:
            clean = role == "reference"
            (root / "MINE" / path).parent.mkdir(parents=True, exist_ok=True)
            exposure = Exposure(iso, exposure_s, Fraction(8))
            write_dng(root / "MINE" / path, mosaic_of(path, size, bright=clean), sensor, exposure)
            record = FrameRecord(path, role, "Mine", scene=scene, iso=iso, exposure_s=exposure_s, ratio=ratio)
            records.append(record if clean else replace(record, reference=reference))
    card = demo_card("mine", "A set of one's own", "MINE", {"Mine": sensor}, records, "simulated")
    card = replace(card, protocol=OWN_PROTOCOL, cfa=cfa_word([packing_sites(cfa).name]))
    save_card(folder / "mine.json", card)
    save_records(folder / "mine.csv", sorted(records, key=lambda record: record.path))
    return OwnSet(folder / "mine.csv", root)


def predict(own: OwnSet, folder: Path, sigma: float, *, reverse: bool = False) -> Path:
    """A prediction of each noisy frame: its reference with noise; ``reverse``: its channels the other way round."""
    for number, path in enumerate(sorted(own.files.glob("*/x*.dng"))):
        place = path.relative_to(own.files)
        mosaic = mosaic_of(f"{place.parent.as_posix()}/clean.dng", SIZE, bright=True).astype(np.float64)
        values = (mosaic - 512) / (15300 - 512) + np.random.default_rng(number).normal(0, sigma, SIZE)
        packed = pack(values, GBRG)
        save_prediction(folder, place.as_posix(), (packed[::-1] if reverse else packed).astype(np.float32))
    return folder
