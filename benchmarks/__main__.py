"""The command line: ``python -m benchmarks [name ...] [--rounds N] [--json FILE]``."""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
import tempfile
from dataclasses import asdict
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

from benchmarks.harness import Row, measure

if TYPE_CHECKING:
    from collections.abc import Sequence

NAMES = (
    *(
        "decode",
        "packing",
        "dataset_item",
        "metrics",
        "evaluation",
        "methods",
        "noise",
        "synthetic_pairs",
        "small_crops",
        "calibration",
    ),
    "store",
    "raw_parts",
    "raw_training",
    "scale",
    "manifest",
    "shading",
)

_PACKAGES = ("eldata", "numpy", "numba", "rawpy", "torch", "scikit-image")


def main(arguments: Sequence[str] | None = None) -> None:
    options = _parse(arguments)
    environment = _environment(options.rounds)
    print("\n".join(f"{key}: {value}" for key, value in environment.items()), end="\n\n", flush=True)
    cores = sorted({1, len(os.sched_getaffinity(0))})
    found: list[tuple[str, int, Row]] = []
    with tempfile.TemporaryDirectory(prefix="eldata-benchmarks-") as folder:
        from benchmarks.data import make_files

        _say("making the files")
        names = options.names or NAMES
        files = make_files(Path(folder), calibration="calibration" in names)
        for name in names:
            for count in cores:
                _say(f"{name} on {count} of {cores[-1]} cores")
                found += [(name, count, row) for row in measure(name, files, options.rounds, count)]
    print(_table(found))
    if options.json is not None:
        rows = [
            {"benchmark": name, "cores": count, **asdict(row), "verdict": row.verdict} for name, count, row in found
        ]
        options.json.write_text(json.dumps({"environment": environment, "rows": rows}, indent=2) + "\n")


def _parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description="Time the hot paths (Linux only).")
    parser.add_argument("names", nargs="*", metavar="name", help=f"which: {', '.join(NAMES)}; default all")
    parser.add_argument("--rounds", type=int, default=7, help="rounds after the warm-up (default 7)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write everything there too")
    options = parser.parse_args(arguments)
    for name in options.names:
        if name not in NAMES:
            parser.error(f"no benchmark is called {name!r}; known are {', '.join(NAMES)}")
    if options.rounds < 1:
        parser.error("--rounds must be 1 or more")
    return options


def _environment(rounds: int) -> dict[str, str]:
    packages = ", ".join(f"{name} {version(name)}" for name in _PACKAGES)
    return {
        "date": f"{datetime.now(UTC):%Y-%m-%d}",
        "CPU": f"{_cpu_model()}, {len(os.sched_getaffinity(0))} cores usable",
        "load before": f"{os.getloadavg()[0]:.2f}",
        "versions": f"Python {platform.python_version()}, {packages}",
        "times": f"median [lowest-highest] of {rounds} rounds in turn; a result is the median of the rounds' ratios",
        "memory": "peak beyond the inputs",
    }


def _cpu_model() -> str:
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("model name"):
            return line.split(":", 1)[1].strip()
    return platform.machine()


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _table(found: Sequence[tuple[str, int, Row]]) -> str:
    from eldata.base.tables import text_table

    header = ("benchmark", "case", "cores", "eldata", "against", "which takes", "result", "expected", "values")
    return text_table(header, [_cells(*entry) for entry in found], left=(0, 1, 4, 7, 8))


def _cells(name: str, cores: int, row: Row) -> tuple[str, ...]:
    unit = "MB" if row.unit == " MB" else "ms"
    return (
        name,
        row.case,
        str(cores),
        f"{row.ours} {unit}",
        row.against,
        f"{row.theirs} {unit}",
        f"{row.figure:.2f}{row.unit}",
        row.verdict,
        row.values,
    )


if __name__ == "__main__":
    main()
