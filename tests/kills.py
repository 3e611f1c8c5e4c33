"""Kills commands at random moments, runs them again, and compares what is there with what an undisturbed run leaves.

``python -m tests.kills --trials 200`` does it for each command; names choose some, ``--signal TERM`` or ``INT`` ends them
otherwise. What a trial demands:

- after the kill, each file with a name of its own is whole: the one of before, or the undisturbed run's;
- no process of it is left, of its workers neither;
- after SIGTERM and Ctrl-C: exit code 143 or 130, one line, and no temporary file;
- the same command then ends well, or says that all is there already; and the folder holds what it holds after an
  undisturbed run, to the bit, and nothing else. (HDF5 stores are compared by all that is in them: the library numbers its
  blocks otherwise when a file is opened twice.)

Commands run in forks of this process, which has imported all that they need: the whole time of a fork is work. Every
twentieth is a process of its own, with two workers where the command has any, and with guarded processes that decode. Of the others each second one is ended some time
after its begin, drawn over the time that the command takes; the rest by themselves, before a step that changes a folder (a
file that is opened to be written, renamed, linked or removed, a new folder), drawn over the steps of the command: the moments
that matter may be a thousandth of its time.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import random
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import time
import traceback
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import numpy as np

from eldata.base.stopping import exit_code
from tests.waiting import until

if TYPE_CHECKING:
    from collections.abc import Callable

ROOT = Path(__file__).parents[1]
WITH_WORKERS = 20  # each so-manyth trial has two worker processes
STEPS = frozenset(("os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.link", "os.truncate", "os.utime"))
JOBS = "{jobs}"


# --- the commands -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Case:
    """A command: what it reads (``inputs``, made once), what is in its folder at first, and its arguments there."""

    program: str
    arguments: tuple[str, ...]
    inputs: Callable[[Path], None]
    begin: Callable[[Path, Path], None] = lambda inputs, folder: None

    def command(self, jobs: int) -> list[str]:
        return [argument.format(jobs=jobs) for argument in self.arguments]


def demo_tree(folder: Path) -> None:
    from tests.trees import build_tree

    build_tree(folder / "tree")


def clean_raws(folder: Path) -> None:
    from eldata.raw.dng import write_dng
    from tests.raw.helpers import BAYER, EXPOSURE, make_sensor

    (folder / "clean").mkdir()
    for number in range(6):
        mosaic = np.random.default_rng(number).integers(600, 9000, (96, 128)).astype(np.uint16)
        write_dng(folder / "clean" / f"{number}.dng", mosaic, make_sensor(BAYER["RGGB"], 96, 128), EXPOSURE)


def predictions(folder: Path) -> None:
    from tests.evaluation.helpers import Tree, place

    demo_tree(folder)
    place(folder / "preds", Tree(folder / "tree"))


def store(folder: Path) -> None:
    from tests.sources.store.helpers import pack_tree
    from tests.trees import tree_in

    demo_tree(folder)
    pack_tree(tree_in(folder / "tree"), folder / "eld.h5")


def calibration_frames(folder: Path) -> None:
    from tests.calibration.trees import made_tree

    made_tree(folder / "frames", isos=(100, 400), bias_frames=4, flat_levels=2)


def memory_card(folder: Path) -> None:
    from tests.capture.simulated import plan_of, shoot, whole_plan

    plan = plan_of("4", "1", factors=(100,))
    shoot(folder / "card", whole_plan(plan))
    plan.save(folder / "plan.json")


def manifests(inputs: Path, folder: Path) -> None:
    shutil.copytree(inputs / "tree" / "manifests", folder / "manifests")


ELD = "--root ../inputs/tree/data --manifest ../inputs/tree/manifests/eld-demo.csv"
CASES = {
    name: Case(*rest)
    for name, *rest in (
        ("pack", "eldata", f"pack eld-demo -o store.h5 {ELD} --jobs {JOBS}".split(), demo_tree),
        (
            "lock",
            "eldata",
            f"lock manifests/eld-demo.csv --root ../inputs/tree/data --jobs {JOBS}".split(),
            demo_tree,
            manifests,
        ),
        (
            "synthesize",
            "eldata",
            f"synthesize ../inputs/clean -o set --camera SonyA7S2 --per-image 2 --jobs {JOBS}".split(),
            clean_raws,
        ),
        (
            "evaluate",
            "eldata",
            f"evaluate ../inputs/preds {ELD} --csv s.csv --json s.json --html s.html --jobs {JOBS}".split(),
            predictions,
        ),
        ("shard", "eldata", "shard ../inputs/eld.h5 -o shards --tile 16 --samples-per-shard 20".split(), store),
        (
            "calibrate",
            "eldata",
            f"calibrate ../inputs/frames/data/calibration -o p.json --json d.json --jobs {JOBS}".split(),
            calibration_frames,
        ),
        (
            "capture-manifest",
            "capture",
            f"manifest ../inputs/plan.json ../inputs/card -o manifests/mine.csv --copy-to data/mine --jobs {JOBS}".split(),
            memory_card,
        ),
    )
}


# --- running ----------------------------------------------------------------------------------------------------------


@dataclass
class Run:
    """A run of a command in its folder: how it ended, negative by a signal, and what it printed."""

    code: int
    said: str
    seconds: float


@dataclass
class Steps:
    """Counts the steps of this process that change a folder, and sends it a signal before one."""

    number: int
    step: int
    seen: int = 0

    def see(self, event: str, arguments: tuple[object, ...]) -> None:
        writes = event == "open" and isinstance(arguments[2], int) and arguments[2] & (os.O_WRONLY | os.O_RDWR)
        if event in STEPS or writes:
            self.seen += 1
            if self.seen == self.step:
                os.kill(os.getpid(), self.number)


@dataclass
class Bench:
    """A command in its folder, which is always the same: paths stand in what some commands write."""

    case: Case
    base: Path
    expected: dict[str, str] = field(default_factory=dict)
    first: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        (self.base / "inputs").mkdir()
        self.case.inputs(self.base / "inputs")

    @property
    def folder(self) -> Path:
        return self.base / "run"

    def begin(self) -> None:
        """Empty the folder, but for what is there at first."""
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir()
        (self.folder / ".tmp").mkdir()  # for temporary files, which are to be gone as well
        self.case.begin(self.base / "inputs", self.folder)

    def run(self, *, jobs: int = 1, number: int = 0, after_s: float = 0.0, step: int = 0) -> Run:
        """Run the command; send it a signal some time after its begin, or before a step, counted from 1."""
        log = self.base / "log"
        begun = time.monotonic()
        pid = self._forked(log, number, step) if jobs == 1 else self._spawned(log, jobs)
        if number and not step:
            time.sleep(after_s)
            with suppress(ProcessLookupError):
                os.kill(pid, number)
        _, status = os.waitpid(pid, 0)
        seconds = time.monotonic() - begun
        until(lambda: not marked(self.mark), "the end of every process of a command")
        return Run(os.waitstatus_to_exitcode(status), log.read_text(encoding="utf-8"), seconds)

    @property
    def mark(self) -> str:
        """Stands in the environment of each process that the command starts."""
        return f"KILLS={self.base}"

    def steps(self) -> int:
        """Run the command; return its number of steps."""
        self.run(number=-1, step=-1)
        return int((self.base / "steps").read_text(encoding="utf-8"))

    def _forked(self, log: Path, number: int, step: int) -> int:
        sys.stdout.flush()
        sys.stderr.flush()
        pid = os.fork()
        if not pid:
            self._be(log, number, step)
        return pid

    def _be(self, log: Path, number: int, step: int) -> NoReturn:
        code = 99
        steps = Steps(number, step)
        try:
            os.setsid()
            os.environ |= {"KILLS": str(self.base), "ELDATA_ISOLATE": "0"}
            os.chdir(self.folder)
            tempfile.tempdir = str(self.folder / ".tmp")
            written = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
            os.dup2(written, 1)
            os.dup2(written, 2)
            sys.argv = [self.case.program, *self.case.command(1)]
            sys.addaudithook(steps.see)
            code = main_of(self.case.program)(None)
        except BaseException:  # noqa: BLE001 # a fork must not come back
            traceback.print_exc()
        finally:
            with suppress(Exception):
                sys.stdout.flush()
            if number == -1:
                (self.base / "steps").write_text(str(steps.seen), encoding="utf-8")
            os._exit(code)

    def _spawned(self, log: Path, jobs: int) -> int:
        command = [sys.executable, "-m", f"{self.case.program}.cli.main", *self.case.command(jobs)]
        environment = os.environ | {
            "PYTHONPATH": str(ROOT),
            "TMPDIR": str(self.folder / ".tmp"),
            "KILLS": str(self.base),
        }
        with log.open("wb") as said:
            process = subprocess.Popen(
                command, cwd=self.folder, env=environment, stdin=subprocess.DEVNULL, stdout=said, stderr=said,
                start_new_session=True,
            )  # fmt: skip
        process.returncode = 0  # it is waited for above
        return process.pid

    def contents(self) -> dict[str, str]:
        """Digests of all files and folders."""
        return {
            path.relative_to(self.folder).as_posix(): digest(path)
            for path in sorted(self.folder.rglob("*"))
            if not path.name.endswith((".nbi", ".nbc"))
        }


def main_of(program: str) -> Callable[[list[str] | None], int]:
    if program == "eldata":
        from eldata.cli.main import main
    else:
        from capture.cli.main import main
    return main


def digest(path: Path) -> str:
    if path.is_dir():
        return "folder"
    if path.suffix == ".h5":
        from tests.sources.store.helpers import contents

        return hashlib.sha256(repr(sorted(contents(path).items())).encode()).hexdigest()
    return hashlib.sha256(path.read_bytes()).hexdigest()


def marked(mark: str) -> list[int]:
    """The processes that have a text in their environment, zombies left out: those have none any more."""
    found = []
    for environment in Path("/proc").glob("[0-9]*/environ"):
        with suppress(OSError):
            if mark.encode() in environment.read_bytes():
                found.append(int(environment.parent.name))
    return found


# --- trials -----------------------------------------------------------------------------------------------------------


def is_own(name: str) -> bool:
    """Whether a file's name is its own, and not one of unfinished work: hidden, a store's part or its journal."""
    return not any(part.startswith(".") for part in Path(name).parts) and ".part" not in name


def half_written(bench: Bench) -> list[str]:
    return [
        name
        for name, found in bench.contents().items()
        if is_own(name) and found not in (bench.expected.get(name), bench.first.get(name))
    ]


def leftovers(bench: Bench) -> list[str]:
    return [name for name in bench.contents() if name.endswith(".part") and Path(name).name.startswith(".")]


def trials(name: str, base: Path, count: int, number: int, seed: int) -> tuple[Counter[str], list[str]]:
    """Kill a command so many times; return what was counted, and what was wrong."""
    bench = Bench(CASES[name], base)
    bench.begin()
    os.chdir(bench.folder)
    main_of(bench.case.program)(bench.case.command(1))  # what is imported and compiled now, forks have
    os.chdir(base)
    undisturbed: dict[int, list[float]] = {1: [], 2: []}
    for jobs in (1, 1, 1, 2):
        bench.begin()
        bench.first = bench.contents()
        run = bench.run(jobs=jobs)
        if run.code != 0:
            return Counter(), [f"undisturbed: exit code {run.code}: {run.said}"]
        undisturbed[jobs].append(run.seconds)
        if bench.expected and bench.contents() != bench.expected:
            return Counter(), [f"two undisturbed runs differ: {different(bench)}"]
        bench.expected = bench.contents()
    bench.begin()
    steps = bench.steps()
    counted: Counter[str] = Counter()
    wrong: list[str] = []
    generator = random.Random(f"{name} {seed}")
    while counted["kills"] < count and counted["runs"] < 20 * count + 100 and len(wrong) < 20:
        counted["runs"] += 1
        jobs = 2 if counted["kills"] % WITH_WORKERS == WITH_WORKERS - 1 else 1
        after_s = generator.uniform(0.0, statistics.median(undisturbed[jobs]))
        step = generator.randint(1, steps) if jobs == 1 and counted["kills"] % 2 else 0
        bench.begin()
        run = bench.run(jobs=jobs, number=number, after_s=after_s, step=step)
        if run.code == 0:
            continue  # it was faster this time
        found = list(wrong_of(bench, run, number, counted, jobs))
        counted["kills"] += 1
        moment = f"before step {step} of {steps}" if step else f"after {after_s:.3f} s"
        wrong += [f"{name}, {jobs} jobs, {moment}: {text}" for text in found]
    if counted["kills"] < count:
        wrong.append(f"{name}: only {counted['kills']} kills in {counted['runs']} runs")
    counted["ms undisturbed"] = round(1000 * statistics.median(undisturbed[1]))
    return counted, wrong


def wrong_of(bench: Bench, run: Run, number: int, counted: Counter[str], jobs: int) -> list[str]:
    """What is wrong after a kill, and after the same command was run again."""
    wrong = []
    dirty, temporary = half_written(bench), leftovers(bench)
    counted["left unfinished work"] += bench.contents() not in (bench.first, bench.expected)
    counted["left a temporary file"] += bool(temporary)
    if dirty:
        wrong.append(f"half written: {dirty}")
    if number == signal.SIGKILL:
        if run.code != -signal.SIGKILL:
            wrong.append(f"exit code {run.code}: {run.said}")
    else:
        early = run.code == -number and not run.said  # before Python could be told what to do
        counted["before the first line of ours"] += early
        if run.code != exit_code(number) and not early:
            wrong.append(f"exit code {run.code}: {run.said}")
        if run.said.count("\n") != 1 and not early:
            wrong.append(f"said {run.said!r}")
        if temporary:
            wrong.append(f"left {temporary}")
    again = bench.run(jobs=jobs)
    done = bench.contents() == bench.expected
    if again.code != 0 and not (again.code == 2 and "already" in again.said and done):
        wrong.append(f"run again: exit code {again.code}: {again.said}")
    if not done:
        wrong.append(f"run again: {different(bench)}")
    return wrong


def different(bench: Bench) -> list[str]:
    found = bench.contents()
    return sorted(name for name in found.keys() | bench.expected.keys() if found.get(name) != bench.expected.get(name))


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.kills", description="Kill commands at random moments.")
    parser.add_argument("commands", nargs="*", metavar="COMMAND", help=f"of {', '.join(CASES)} (default: all)")
    parser.add_argument("--trials", type=int, default=200)
    parser.add_argument("--signal", choices=("KILL", "TERM", "INT", "HUP"), default="KILL")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args(argv)
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job ignores it
    number = signal.Signals[f"SIG{arguments.signal}"]
    failed = False
    for name in arguments.commands or CASES:
        with tempfile.TemporaryDirectory() as folder:
            begun = time.monotonic()
            devnull = os.open(os.devnull, os.O_WRONLY)
            shown = os.dup(1)
            os.dup2(devnull, 1)  # of the commands that run here
            try:
                counted, wrong = trials(name, Path(folder), arguments.trials, number, arguments.seed)
                sys.stdout.flush()
            finally:
                os.chdir(ROOT)
                os.dup2(shown, 1)
        failed |= bool(wrong)
        rest = ", ".join(f"{value} {key}" for key, value in counted.items() if key not in ("kills", "runs"))
        print(
            f"{name}: {counted['kills']} times {number.name} in {counted['runs']} runs ({rest}); {len(wrong)} wrong; "
            f"seed {arguments.seed}; {time.monotonic() - begun:.0f} s",
            flush=True,
        )
        for text in wrong:
            print(f"  {text}", flush=True)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
