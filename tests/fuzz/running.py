"""Trials over child processes that may die: the one in progress is to blame, and the next process goes on after it."""

from __future__ import annotations

import json
import os
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tests.fuzz.child import DEFECT, READY, Task, keep
from tests.fuzz.outcomes import FAILURES, Outcome, of_dump
from tests.fuzz.targets import KINDS
from tests.fuzz.trials import save_seeds

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

ROOT = Path(__file__).parents[2]
_TRIALS_OF_ONE_PROCESS = 2000
_TO_START_S = 120  # a child loads libraries and reads every good file


@dataclass(frozen=True)
class Limits:
    """What a trial may take: processor time; time of doing nothing; memory beyond the process's own."""

    busy_s: float = 10.0
    waiting_s: float = 30.0
    most_bytes: int = 2 << 30


@dataclass
class Tally:
    """What came of one kind's trials."""

    trials: int = 0
    words: Counter[str] = field(default_factory=Counter)
    sorts: Counter[tuple[str, str]] = field(default_factory=Counter)
    first: dict[tuple[str, str], int] = field(default_factory=dict)
    seconds: float = 0.0
    peak: int = 0

    def add(self, number: int, outcome: Outcome, seconds: float, peak: int) -> None:
        """Count one trial."""
        self.trials += 1
        self.words[outcome.word] += 1
        self.seconds += seconds
        self.peak = max(self.peak, peak)
        if outcome.word in FAILURES:
            key = (outcome.word, outcome.sort)
            self.sorts[key] += 1
            self.first[key] = min(number, self.first.get(key, number))

    @property
    def failures(self) -> int:
        """Number of trials that a reader failed."""
        return sum(self.words[word] for word in FAILURES)


@dataclass
class Fuzzing:
    """A run: the folders that it needs, and what it has counted so far."""

    seed: int
    failures: Path
    work: Path
    jobs: int = 2
    limits: Limits = field(default_factory=Limits)
    tallies: dict[str, Tally] = field(default_factory=dict)

    def run(self, counts: Mapping[str, int]) -> None:
        """Run so many further trials of each kind."""
        chunks: list[Task] = []
        for kind, count in counts.items():
            tally = self.tallies.setdefault(kind, Tally())
            seeds = self.work / "seeds" / kind
            if not seeds.exists():
                save_seeds(seeds, KINDS[kind].seeds())
            for first in range(tally.trials, tally.trials + count, _TRIALS_OF_ONE_PROCESS):
                last = min(first + _TRIALS_OF_ONE_PROCESS, tally.trials + count)
                task = Task(kind, self.seed, first, last, str(seeds), "", str(self.failures), self.limits.most_bytes)
                chunks.append(task)
        with ThreadPoolExecutor(self.jobs) as pool:
            for kind, answers in pool.map(self._chunk, chunks):
                for number, outcome, seconds, peak in answers:
                    self.tallies[kind].add(number, outcome, seconds, peak)

    def _chunk(self, task: Task) -> tuple[str, list[tuple[int, Outcome, float, int]]]:
        found: list[tuple[int, Outcome, float, int]] = []
        at = task.first
        while at < task.last:
            work = Path(tempfile.mkdtemp(dir=self.work))
            try:
                for number, outcome, seconds, peak in _one_process(
                    replace(task, first=at, work=str(work)), self.limits
                ):
                    found.append((number, outcome, seconds, peak))
                    at = number + 1
            finally:
                shutil.rmtree(work, ignore_errors=True)
        return task.kind, found


def _one_process(task: Task, limits: Limits) -> Iterator[tuple[int, Outcome, float, int]]:
    """Yield what a child process answers, and at last, if it ends early, what came of the trial that ended it."""
    argument = json.dumps(asdict(task))
    child = subprocess.Popen(
        [sys.executable, "-m", "tests.fuzz.child", argument], stdout=subprocess.PIPE, cwd=ROOT, start_new_session=True
    )
    number = task.first
    try:
        for line in _lines(child, limits):
            if line is None:
                outcome = _stopped(child, task)
                keep(Path(task.failures), Path(task.work), outcome, number)
                yield number, outcome, limits.busy_s, 0
                return
            answer: dict[str, Any] = json.loads(line)
            number = answer["number"] + 1
            yield answer["number"], Outcome(answer["word"], answer["sort"]), answer["seconds"], answer["peak"]
        if number < task.last:
            code = child.wait()
            how = signal.Signals(-code).name if code < 0 else f"exit code {code}"
            dump = (Path(task.work) / "dump.txt").read_text(encoding="utf-8", errors="replace")
            if dump.startswith(DEFECT):
                raise RuntimeError(dump)
            outcome = Outcome("crash", f"{how} {of_dump(dump)}".strip(), dump)
            keep(Path(task.failures), Path(task.work), outcome, number)
            yield number, outcome, 0.0, 0
    finally:
        with suppress(ProcessLookupError):
            os.killpg(child.pid, signal.SIGKILL)
        child.wait()
        if child.stdout is not None:
            child.stdout.close()


def _lines(child: subprocess.Popen[bytes], limits: Limits) -> Iterator[bytes | None]:
    """Yield the child's lines; ``None`` once a trial has taken too long. It ends when the child does."""
    if child.stdout is None:
        return
    descriptor, rest = child.stdout.fileno(), b""
    busy = seen = 0.0  # processor time when the trial began, and when it last grew
    grew = time.monotonic()
    started = False  # to start takes seconds, which are no trial's
    while True:
        ready, _, _ = select.select([descriptor], [], [], 0.25)
        if ready:
            piece = os.read(descriptor, 1 << 16)
            if not piece:
                return
            *lines, rest = (rest + piece).split(b"\n")
            started = started or bool(lines)
            yield from (line for line in lines if line != READY)
            busy = seen = _busy_seconds(child.pid)
            grew = time.monotonic()
            continue
        now, more = _busy_seconds(child.pid), 0 if started else _TO_START_S
        if now - seen > 0.05:
            seen, grew = now, time.monotonic()
        if now - busy > limits.busy_s + more or time.monotonic() - grew > limits.waiting_s + more:
            yield None
            return


def _busy_seconds(pid: int) -> float:
    """Processor time that a process has taken (proc(5), stat)."""
    with suppress(OSError, ValueError):
        fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace").rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    return 0.0


def _stopped(child: subprocess.Popen[bytes], task: Task) -> Outcome:
    """End a process that hangs, and say where it was."""
    with suppress(ProcessLookupError):
        os.kill(child.pid, signal.SIGABRT)  # faulthandler writes down where it is
    with suppress(subprocess.TimeoutExpired):
        child.wait(timeout=Limits().busy_s)
    dump = (Path(task.work) / "dump.txt").read_text(encoding="utf-8", errors="replace")
    return Outcome("hang", of_dump(dump).removeprefix("Aborted").strip(), dump)
