"""A manifest of 100,000 rows to checked records."""

from __future__ import annotations

import csv
import hashlib
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd

from benchmarks.harness import Row, in_turn
from eldata.manifest.table import COLUMNS, load_records

if TYPE_CHECKING:
    from benchmarks.data import Files

_ROWS = 100_000


def run(_files: Files, rounds: int, _cores: int) -> list[Row]:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "set.csv"
        path.write_text("\n".join([",".join(COLUMNS), *map(_line, range(_ROWS))]) + "\n", encoding="utf-8")
        assert [record.path for record in load_records(path)] == [row["path"] for row in _dicts(path)]
        timings = in_turn(
            rounds,
            {
                "csv.DictReader": lambda: _dicts(path),
                "pandas.read_csv": lambda: pd.read_csv(path),
                "eldata": lambda: load_records(path),
            },
        )
    return [timings.cost("100,000 rows", "eldata", floor) for floor in ("csv.DictReader", "pandas.read_csv")]


def _line(number: int) -> str:
    """One reference and fifteen noisy frames a scene, all hashed."""
    scene = f"SonyA7S2/scene-{number // 16:05}"
    path, reference = f"{scene}/IMG_{number:07}.ARW", f"{scene}/IMG_{number - number % 16:07}.ARW"
    shot = f"1/{1 + number % 4000},{(1, 10, 100, 200)[number % 4]},{reference}" if number % 16 else "1/30,,"
    role = "noisy" if number % 16 else "reference"
    digest = hashlib.sha256(path.encode()).hexdigest()
    size = 25_000_000 + number % 999_983
    return f"{path},{role},SonyA7S2,scene-{number // 16:05},test,800,{shot},4256,2848,{size},sha256:{digest},"


def _dicts(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))
