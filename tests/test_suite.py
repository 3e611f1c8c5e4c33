"""The suite's own rules: make leaves out what is marked, clocks decide nothing, and what fails is named."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

from tests.cases import in_one_test

ROOT = Path(__file__).parents[1]


def test_make_leaves_out_what_carries_a_mark() -> None:
    options = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["pytest"]["ini_options"]
    marks = [line.partition(":")[0] for line in options["markers"]]
    (rare,) = re.findall(r"^RARE := (.+)$", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    assert rare == " or ".join(marks)


CLOCK = re.compile(r"\b(monotonic|perf_counter|process_time|time_ns)(_ns)?\b|mark\.timeout|timeout=\d")
# These look at clocks to end what hangs and to choose moments; no test of theirs asks how long anything took.
MAY_WAIT = {"tests/waiting.py", "tests/capture/checklist_browser.py", "tests/kills.py", "tests/test_suite.py"}


def test_no_test_looks_at_a_clock() -> None:
    """A machine may be busy: conditions are waited for (tests/waiting.py), and speed is for the benchmarks."""
    modules = {path.relative_to(ROOT).as_posix(): path for path in (ROOT / "tests").rglob("*.py")}
    looking = {name for name, path in modules.items() if CLOCK.search(path.read_text(encoding="utf-8"))}
    assert looking - MAY_WAIT == set()


def test_a_case_that_fails_is_named() -> None:
    @in_one_test("number", [1, 2])
    @in_one_test("a, b", [("x", 1), ("y", 2)])
    def check(number: int, a: str, b: int) -> None:
        assert (number, a, b) != (2, "y", 2)

    with pytest.raises(AssertionError) as caught:
        check()
    assert caught.value.__notes__ == ["in the case a='y', b=2", "in the case number=2"]
