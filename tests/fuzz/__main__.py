"""The command line: ``python -m tests.fuzz [--raws N] [--texts N] ... [--minutes M] [--seed S]`` (Linux only)."""

from __future__ import annotations

import argparse
import os
import random
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

from eldata.base.tables import text_table
from tests.fuzz.outcomes import OUTCOMES
from tests.fuzz.running import Fuzzing

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from tests.fuzz.running import Tally

# Of one round where a time is set: the proportions of what docs/reliability.md reports.
ROUND = {
    "raws": 2000,
    "texts": 400,
    "archives": 100,
    "predictions": 40,
    "stores": 20,
    "shards": 20,
    "shadings": 20,
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run trials, print what came of them; exit code 1 if a reader failed."""
    options = _parse(arguments)
    counts = {kind: getattr(options, kind) for kind in ROUND}
    seed = random.SystemRandom().randrange(1 << 32) if options.seed is None else options.seed
    with tempfile.TemporaryDirectory(prefix="eldata-fuzz-") as work:
        run = Fuzzing(seed, options.failures.resolve(), Path(work), options.jobs)
        print(f"seed {seed}, {options.jobs} processes at a time", flush=True)
        if options.minutes is None:
            for kind, count in counts.items():
                run.run({kind: count} if count else {})
        else:
            end = time.monotonic() + 60 * options.minutes
            while time.monotonic() < end:
                run.run(ROUND)
        print(summary(run.tallies, seed, options.failures))
    return 1 if any(tally.failures for tally in run.tallies.values()) else 0


def _parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m tests.fuzz", description="Feed damaged and hostile files to eldata."
    )
    for kind in ROUND:
        parser.add_argument(f"--{kind}", type=int, default=0, metavar="N", help=f"so many trials of {kind}")
    parser.add_argument(
        "--minutes", type=float, metavar="M", help="rounds of every kind for so long, instead of counts"
    )
    parser.add_argument("--seed", type=int, metavar="S", help="the same trials again; default another one in each run")
    parser.add_argument(
        "--jobs", type=int, default=len(os.sched_getaffinity(0)), metavar="J", help="processes at a time"
    )
    parser.add_argument(
        "--failures", type=Path, default=Path("fuzz-failures"), metavar="FOLDER", help="where failing files are kept"
    )
    options = parser.parse_args(arguments)
    if options.minutes is None and not any(getattr(options, kind) for kind in ROUND):
        parser.error("say how many trials (--raws 1000), or for how long (--minutes 10)")
    return options


def summary(tallies: Mapping[str, Tally], seed: int, failures: Path) -> str:
    """Return the table of outcomes, and below it each sort of failure with one kept example."""
    heads = ["kind", "trials", *OUTCOMES, "CPU s", "largest MB"]
    rows = [
        [
            *(kind, str(tally.trials), *(str(tally.words[word]) for word in OUTCOMES)),
            *(f"{tally.seconds:.0f}", f"{tally.peak / 1e6:.0f}"),
        ]
        for kind, tally in tallies.items()
    ]
    lines = [text_table(heads, rows)]
    for kind, tally in tallies.items():
        for (word, sort), count in tally.sorts.most_common():
            example = failures / f"{kind}-{word}-{seed}-{tally.first[word, sort]}"
            lines.append(f"{kind}: {word} x {count}: {sort}\n    {example}")
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
