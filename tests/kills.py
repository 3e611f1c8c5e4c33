"""Kills commands at random moments, runs them again, and compares what is there with what an undisturbed run leaves.

``python -m tests.kills --trials 200`` does it for each command; names choose some, ``--signal TERM`` or ``INT`` ends
them otherwise. What a trial demands:

- after the kill, each file with a name of its own is whole: the one of before, or the undisturbed run's;
- no process of it is left, of its workers neither;
- after SIGTERM and Ctrl-C: exit code 143 or 130, one line, and no temporary file;
- the same command then ends well, or says that all is there already; and the folder holds what it holds after an
  undisturbed run, to the bit, and nothing else. (HDF5 stores are compared by all that is in them: the library numbers
  its blocks otherwise when a file is opened twice.)

Commands run in forks of this process, which has imported all that they need: the whole time of a fork is work. Each
second one is ended some time after its begin, drawn over the time that the command takes; the others by themselves,
before a step that changes a folder (a file that is written, renamed, linked or removed, a new folder), drawn
over the steps of the command: the moments that matter may be a thousandth of its time.
"""

from __future__ import annotations

import argparse
import hashlib
import io
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Callable
from contextlib import chdir, redirect_stdout, suppress
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import NamedTuple, NoReturn

import numpy as np
from tqdm import tqdm

from tests.syncing import not_synced
from tests.waiting import PATIENCE_S, until

ROOT = Path(__file__).parents[1]
STEPS = frozenset(("os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.link", "os.truncate", "os.utime"))


# --- the commands -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Case:
    """A command: what it reads (``inputs``, made once), the folder of it that is copied at first, and its arguments."""

    line: str
    inputs: Callable[[Path], object]
    copied: str = ""

    def main(self) -> int:
        program, *arguments = self.line.split()
        main: Callable[[list[str]], int] = import_module(f"{program}.cli.main").main
        return main(arguments)


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
    for name in ("preds", "others"):
        place(folder / name, Tree(folder / "tree"))


def calibration_frames(folder: Path) -> None:
    from tests.calibration.trees import make_tree

    make_tree(folder / "frames", isos=(100,), bias_frames=4, flat_levels=2)


def memory_card(folder: Path) -> None:
    from tests.capture.simulated import plan_of, shoot, whole_plan

    plan = plan_of("4", "1", factors=(100,))
    shoot(folder / "card", whole_plan(plan))
    plan.save(folder / "plan.json")


DATA = "../inputs/tree/data"
FRAMES = "../inputs/frames/data/calibration"
CARD = "../inputs/plan.json ../inputs/card -o manifests/mine.csv"
HALVED = "tests.baselines.test_predicting:halved"
ELD = f"--root {DATA} --manifest ../inputs/tree/manifests/eld-demo.csv"
CASES = {
    "pack": Case(f"eldata pack eld-demo -o store.h5 {ELD} --jobs 1", demo_tree),
    "pack-lz4": Case("eldata pack ../inputs/clean -o store.h5 --compression lz4 --jobs 1", clean_raws),
    "lock": Case(f"eldata lock manifests/eld-demo.csv --root {DATA} --jobs 1", demo_tree, "tree/manifests"),
    "synthesize": Case("eldata synthesize ../inputs/clean -o set --camera SonyA7S2 --per-image 2 --jobs 1", clean_raws),
    "evaluate": Case(f"eldata evaluate ../inputs/preds ../inputs/others {ELD} -o results --jobs 1", predictions),
    "baseline": Case(f"eldata baseline input {ELD} -o preds --jobs 1", demo_tree),
    "predict": Case(f"eldata predict {HALVED} {ELD} -o preds --tile 16 --overlap 0", demo_tree),
    "calibrate": Case(f"eldata calibrate {FRAMES} -o p.json --json d.json --jobs 1", calibration_frames),
    "capture-manifest": Case(f"capture manifest {CARD} --copy-to data/mine --jobs 1", memory_card),
}


# --- running ----------------------------------------------------------------------------------------------------------


class Run(NamedTuple):
    """A run of a command in its folder: how it ended, negative by a signal, and what it said on standard error."""

    code: int
    said: str


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
    first: dict[str, str] = field(default_factory=dict)
    expected: dict[str, str] = field(default_factory=dict)
    seconds: float = 0.0
    steps: int = 0

    @property
    def folder(self) -> Path:
        return self.base / "run"

    def prepare(self) -> list[str]:
        """Make the inputs, run the command undisturbed, here and in a fork; return what is wrong already."""
        (self.base / "inputs").mkdir()
        self.case.inputs(self.base / "inputs")
        self.begin()
        self.first = self.contents()
        with chdir(self.folder), redirect_stdout(io.StringIO()):
            self.case.main()  # what is imported and compiled now, forks have
        self.expected = self.contents()
        self.begin()
        begun = time.monotonic()
        run = self.run()
        self.seconds = time.monotonic() - begun
        if run.code != 0:
            return [f"undisturbed: exit code {run.code}: {run.said}"]
        self.steps = int((self.base / "steps").read_text(encoding="utf-8"))
        return [f"undisturbed runs differ: {self.different()}"] if self.different() else []

    def begin(self) -> None:
        """Empty the folder, but for what is there at first."""
        shutil.rmtree(self.folder, ignore_errors=True)
        (self.folder / ".tmp").mkdir(parents=True)  # for temporary files, which are to be gone as well
        if self.case.copied:
            copied = self.base / "inputs" / self.case.copied
            shutil.copytree(copied, self.folder / copied.name)

    def run(self, *, number: int = 0, after_s: float = 0.0, step: int = 0) -> Run:
        """Run the command; send it a signal some time after its begin, or before a step, counted from 1."""
        log = self.base / "log"
        log.write_bytes(b"")
        # a Ctrl-C that comes before the fork has put this program's handler down would be raised in this program's code
        signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
        pid = os.fork()
        if not pid:
            try:
                self._be(log, Steps(number, step))
            finally:  # a Ctrl-C just before the work, or after it; whatever it was, a fork must not come back
                signal.signal(signal.SIGINT, signal.SIG_DFL)
                os.kill(os.getpid(), signal.SIGINT)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])
        if number and not step:
            time.sleep(after_s)
            with suppress(ProcessLookupError):
                os.kill(pid, number)
        _, status = os.waitpid(pid, 0)
        until(lambda: not marked(f"KILLS={self.base}"), "the end of every process of a command")
        return Run(os.waitstatus_to_exitcode(status), log.read_text(encoding="utf-8"))

    def _be(self, log: Path, steps: Steps) -> NoReturn:
        """Be the command, in a fork; each process that it starts has ``KILLS`` in its environment."""
        code = 99
        signal.signal(signal.SIGINT, signal.default_int_handler)
        try:
            os.setsid()
            os.environ |= {"KILLS": str(self.base), "PYTHONPATH": str(ROOT)}
            os.chdir(self.folder)
            tempfile.tempdir = os.environ["TMPDIR"] = str(self.folder / ".tmp")
            nowhere = os.open(os.devnull, os.O_RDWR)
            os.dup2(nowhere, 0)
            os.dup2(nowhere, 1)
            os.dup2(os.open(log, os.O_WRONLY), 2)
            signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])  # what it raises is in the log
            sys.addaudithook(steps.see)
            code = self.case.main()
        except BaseException:  # noqa: BLE001 # a fork must not come back
            traceback.print_exc()
        finally:
            with suppress(Exception):
                sys.stdout.flush()
            if not steps.number:
                (self.base / "steps").write_text(str(steps.seen), encoding="utf-8")
            os._exit(code)

    def contents(self) -> dict[str, str]:
        """Digests of all files and folders."""
        return {
            path.relative_to(self.folder).as_posix(): digest(path)
            for path in sorted(self.folder.rglob("*"))
            if not path.name.endswith((".nbi", ".nbc"))
        }

    def different(self) -> list[str]:
        """Name what differs from an undisturbed run's folder."""
        now = self.contents()
        return sorted(name for name in now.keys() | self.expected.keys() if now.get(name) != self.expected.get(name))

    def half_written(self) -> list[str]:
        """Name the files, hidden ones of unfinished work left out, that are neither as before nor as after."""
        return [
            name
            for name, now in self.contents().items()
            if now not in (self.expected.get(name), self.first.get(name))
            and not any(part.startswith(".") for part in Path(name).parts)
        ]


def digest(path: Path) -> str:
    if path.is_dir():
        return "folder"
    return hashlib.sha256(path.read_bytes()).hexdigest()


def marked(mark: str) -> list[str]:
    """The processes that have a text in their environment, zombies left out: those have none any more."""
    processes = []
    for environment in Path("/proc").glob("[0-9]*/environ"):
        with suppress(OSError):
            if mark.encode() in environment.read_bytes():
                processes.append(environment.parent.name)
    return processes


# --- trials -----------------------------------------------------------------------------------------------------------


def trials(bench: Bench, count: int, number: int, generator: random.Random) -> tuple[int, list[str]]:
    """End a command so many times; return how often that left unfinished work, and what was wrong."""
    ended = unfinished = 0
    wrong: list[str] = []
    for _ in range(20 * count + 100):
        if ended == count or len(wrong) > 20:
            return unfinished, wrong
        after_s = generator.uniform(0.0, bench.seconds)
        step = generator.randint(1, bench.steps) if ended % 2 else 0
        bench.begin()
        run = bench.run(number=number, after_s=after_s, step=step)
        if run.code == 0:
            continue  # it was faster this time
        ended += 1
        unfinished += bench.contents() not in (bench.first, bench.expected)
        moment = f"before step {step} of {bench.steps}" if step else f"after {after_s:.3f} s"
        wrong += [f"{moment}: {text}" for text in wrong_of(bench, run, number)]
    return unfinished, [*wrong, f"ended only {ended} times"]


def wrong_of(bench: Bench, run: Run, number: int) -> list[str]:
    """What is wrong after a signal, and after the same command was run again."""
    wrong = [f"half written: {bench.half_written()}"] if bench.half_written() else []
    temporary = [name for name in bench.contents() if name.endswith(".part") and Path(name).name.startswith(".")]
    if number == signal.SIGKILL:
        well = run.code == -signal.SIGKILL
    else:
        # before the command runs, or once it is over
        early = (run.code == -number and not run.said) or run.said.endswith("\nKeyboardInterrupt\n")
        well = early or (run.code == 128 + number and run.said.count("\n") == 1)
        wrong += [f"left {temporary}"] if temporary else []
    if not well:
        wrong.append(f"exit code {run.code}: {run.said[-1000:]}")
    again = bench.run()
    if again.code != 0 and not (again.code == 2 and "already" in again.said):
        wrong.append(f"run again: exit code {again.code}: {again.said}")
    if bench.different():
        wrong.append(f"run again: {bench.different()}")
    return wrong


def in_a_process(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Run this program: its forks need a process without threads."""
    command = [sys.executable, "-m", "tests.kills", *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=2 * PATIENCE_S)


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.kills", description="Kill commands at random moments.")
    parser.add_argument("commands", nargs="*", metavar="COMMAND", help=f"of {', '.join(CASES)} (default: all)")
    parser.add_argument("--trials", type=int, default=200, help="of each signal (default: %(default)s)")
    parser.add_argument("--signal", nargs="+", choices=("KILL", "TERM", "INT", "HUP"), default=["KILL"], dest="signals")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args(argv)
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job ignores it
    os.fsync = not_synced
    tqdm.set_lock(threading.RLock())  # its own is one for all forks: who is killed while holding it keeps it for ever
    tqdm.monitor_interval = 0  # no thread, which may hold it at a fork
    failed = False
    for name in arguments.commands or CASES:
        with tempfile.TemporaryDirectory() as folder:
            bench = Bench(CASES[name], Path(folder))
            wrong = bench.prepare()
            for word in arguments.signals if not wrong else ():
                generator = random.Random(f"{name} {arguments.seed}")  # noqa: S311 # moments, no secrets
                unfinished, found = trials(bench, arguments.trials, signal.Signals[f"SIG{word}"], generator)
                print(
                    f"{name}: {arguments.trials} times SIG{word} left unfinished work {unfinished} times; "
                    f"{len(found)} wrong; seed {arguments.seed}",
                    flush=True,
                )
                wrong += found
        for text in wrong:
            print(f"  {name}: {text}", flush=True)
        failed |= bool(wrong)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
