"""The harness finds what it is for, and a seeded pass of it over every reader finds nothing."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from tests.cases import in_one_test
from tests.fuzz.__main__ import ROUND, main, summary
from tests.fuzz.child import Task, outcome_of
from tests.fuzz.running import Fuzzing, Limits
from tests.fuzz.seeds import raws
from tests.fuzz.targets import DRILL, KINDS
from tests.fuzz.trials import PLACES, load_seeds, save_seeds, trial

if TYPE_CHECKING:
    from pathlib import Path

# A file without its pixels, one whose levels do not say of what, and methods of compression that are refused.
REFUSED = {"raw-real-canon-eos-r6.cr3", "raw-field-pidng-black4-nodim.dng", "bzip2.zip", "lzma.zip"}


def fuzzing(folder: Path, limits: Limits | None = None) -> Fuzzing:
    return Fuzzing(0, folder / "failures", folder, jobs=2, limits=limits or Limits())


@pytest.fixture(scope="module")
def drill(tmp_path_factory: pytest.TempPathFactory) -> Fuzzing:
    """Every failure once, each found by a limit that a busy machine cannot reach by being busy."""
    run = fuzzing(tmp_path_factory.mktemp("drill"), Limits(busy_s=1.0, waiting_s=2.0, most_bytes=64 << 20))
    run.run({"drill": len(DRILL)})
    return run


@pytest.mark.kill
def test_every_failure_is_seen_and_its_file_is_kept(drill: Fuzzing) -> None:
    kept = {
        json.loads((folder / "trial.json").read_text())["file"].removesuffix(".txt"): folder.name
        for folder in drill.failures.iterdir()
    }
    words = {word: name.split("-")[1] for word, name in kept.items()}
    assert words == {word: outcome for word, outcome in DRILL.items() if outcome not in ("read", "refused")}
    assert drill.tallies["drill"].trials == len(DRILL)
    assert drill.tallies["drill"].words["read"] == drill.tallies["drill"].words["refused"] == 1
    for word, name in kept.items():
        assert (drill.failures / name / "input.txt").read_text() == word
    text = summary(drill.tallies, 0, drill.failures)
    assert "SIGSEGV" in text
    assert "exit code 0" in text


def test_pixels_that_changed_without_a_word_are_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By a reader that takes zeros for pixels."""

    def credulous(path: Path) -> object:
        return SimpleNamespace(mosaic=np.frombuffer(path.read_bytes(), np.uint8))

    monkeypatch.setitem(KINDS, "raws", replace(KINDS["raws"], readers={"raw": credulous}))
    seeds = [seed for seed in raws() if seed.name == "none-2-1.dng"]
    task = Task("raws", 0, 0, 400, "", str(tmp_path), "", 1 << 30)
    holes = [made for made in (trial("raws", seeds, 0, number) for number in range(400)) if made.detectable]
    assert len(holes) > 20
    for made in holes:
        path = tmp_path / "input.dng"
        path.write_bytes(made.content)
        assert outcome_of(task, made, path).word == "silent"
    whole = replace(holes[0], content=seeds[0].content)
    path.write_bytes(whole.content)
    assert outcome_of(task, whole, path).word == "read"


@in_one_test("kind", ROUND)
def test_a_trial_is_the_same_wherever_it_is_made(kind: str, tmp_path: Path) -> None:
    seeds = KINDS[kind].seeds()
    save_seeds(tmp_path / kind, seeds)
    one, two = ([trial(kind, held, 7, number) for number in range(40)] for held in (seeds, load_seeds(tmp_path / kind)))
    assert one == two
    assert one != [trial(kind, seeds, 8, number) for number in range(40)]
    assert sum(made.content != made.seed.content for made in one) > 30
    assert {made.place for made in one} <= {"", *PLACES}


@in_one_test("kind", ROUND)
def test_the_good_files_are_good(kind: str, tmp_path: Path) -> None:
    """But for those that only have the structure of their format, and no pixels, or are refused for what they are."""
    refused = []
    for number, seed in enumerate(KINDS[kind].seeds()):
        folder = tmp_path / kind / str(number)
        folder.mkdir(parents=True)
        path = folder / (seed.name if kind == "shards" else f"input{seed.name[seed.name.rindex('.') :]}")
        path.write_bytes(seed.content)
        try:
            KINDS[kind].readers[seed.reader](path)
        except Exception:  # noqa: BLE001 # which is what is asked
            refused.append(seed.name)
    assert [name for name in refused if not name.startswith("made.") and name not in REFUSED] == []


@pytest.mark.study
def test_a_seeded_pass_over_every_reader(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A small part of what docs/reliability.md reports: 0 crashes, hangs, tracebacks, silent pixels."""
    counts = [f"--{kind}={count // 2}" for kind, count in ROUND.items()]
    code = main([*counts, "--seed", "0", "--jobs", "1", "--failures", str(tmp_path)])
    assert code == 0, capsys.readouterr().out
