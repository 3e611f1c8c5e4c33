"""The study of docs/proof.md: its benchmark, small; the whole path as a study; the records that the page shows."""

from __future__ import annotations

import importlib
import runpy
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import ttest_1samp, ttest_rel

from eldata.datasets import DarkFrames, ELDDataset
from eldata.manifest import verify
from eldata.noise import CameraProfile, DarkShading
from tests.test_architecture import ROOT

EXAMPLES = ROOT / "examples"
STUDY = EXAMPLES / "prove_noise_models.py"


@pytest.fixture
def benchmark(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(EXAMPLES)
    return importlib.import_module("virtual_benchmark")


def test_splits_share_no_scene(benchmark: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    scenes = benchmark.choose_scenes(10, 24)
    assert [sum(scene.split == split for scene in scenes) for split in ("test", "train")] == [10, 24]
    shown = [scene.picture or scene.still_life for scene in scenes]
    assert len(set(shown)) == len({scene.name for scene in scenes}) == 34
    assert len({scene.split for scene in scenes if scene.picture.startswith("motorcycle")}) == 1
    monkeypatch.setattr(benchmark, "find_spec", lambda _: None)  # without scikit-image
    assert len({scene.still_life for scene in benchmark.choose_scenes(10, 24)}) == 34


def test_the_benchmark_is_elds_and_has_two_takes_to_train_on(benchmark: Any, tmp_path: Path) -> None:
    manifest = benchmark.photograph(tmp_path, scenes=2, training_scenes=1, size=(64, 96), bias_frames=2)
    assert verify([manifest], tmp_path / "data", level="metadata").ok
    assert len(ELDDataset(tmp_path / "data" / "ELD-benchmark", manifest=manifest.path, split="test")) == 2 * 2 * 6
    noisy = [row for row in manifest.records if (row.split, row.role, row.camera) == ("train", "noisy", "BenchBeta")]
    exposures = {(Fraction(iso), Fraction(factor)) for iso in (800, 1600, 3200) for factor in (100, 200)}
    assert {(row.iso, row.ratio) for row in noisy} == exposures
    assert len(noisy) == 12


@pytest.mark.study
def test_the_whole_path(
    benchmark: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of one camera."""
    monkeypatch.setattr(benchmark, "SENSORS", benchmark.SENSORS[:1])
    small = partial(benchmark.photograph, scenes=1, training_scenes=1, size=(256, 256))
    monkeypatch.setattr(benchmark, "photograph", small)
    benchmark.main([str(tmp_path / "benchmark")])
    profiles = tmp_path / "benchmark" / "profiles"
    profile = CameraProfile.load(str(profiles / "BenchAlpha.json"))
    assert profile.measured(1600).gain_dn_per_e == pytest.approx(0.095 * 16, rel=0.03)
    assert len(profile.gain_modes) == 2
    dark = DarkFrames(profiles / "BenchAlpha-bias.h5", shading=DarkShading.load(profiles / "BenchAlpha-shading.npz"))
    assert {800, 1600, 3200} <= set(map(float, dark.isos))
    rows = ["input", "P*+D", "virtual", "noise2noise", "paired"]
    options = [str(tmp_path), "--steps", "2", "--seeds", "2", "--cameras", "BenchAlpha", "--rows", *rows]
    main = runpy.run_path(str(STUDY))["main"]
    capsys.readouterr()
    main(options)
    first = capsys.readouterr().out
    main(options)
    assert capsys.readouterr().out == first[first.index("| trained on") :]  # all was there
    assert first.count("\n| ") == len(rows) + 2  # and two lines of the head


def test_intervals_of_seeds_are_those_of_a_paired_t_test(tmp_path: Path) -> None:
    """Of images that all score alike, so that the scenes have no share: against scipy's paired test."""
    example = runpy.run_path(str(STUDY))
    record = example["Record"](tmp_path / "camera.json", {})
    images = [(f"scene-{n // 2}", float(ratio)) for n, ratio in enumerate((100, 200) * 6)]
    seeds = {"G": (30.1, 30.4, 29.9), "paired": (30.9, 31.3, 30.6, 33.0), "anscombe-bm3d": (31.0,)}
    for row, means in seeds.items():
        for seed, mean in enumerate(means):
            record.add(row, seed, images, [mean] * len(images))
    mean, half = example["with_interval"](*record.of("G", 200.0, "paired"))
    paired = ttest_rel(seeds["G"], seeds["paired"][:3])  # of the seeds that both have
    assert (mean - half, mean + half) == pytest.approx(tuple(paired.confidence_interval(0.95)))
    mean, half = example["with_interval"](*record.of("anscombe-bm3d", 100.0, "paired"))
    single = ttest_1samp(31.0 - np.array(seeds["paired"]), 0.0)
    assert (mean - half, mean + half) == pytest.approx(tuple(single.confidence_interval(0.95)))
    assert example["with_interval"](*record.of("anscombe-bm3d", 100.0)) == pytest.approx((31.0, 0.0))


@pytest.mark.parametrize("folder", ["proof", "proof/larger"])
def test_the_documented_tables_are_those_of_the_records(folder: str, capsys: pytest.CaptureFixture[str]) -> None:
    """What docs/proof.md shows is what the command prints of the records beside it."""
    runpy.run_path(str(STUDY))["main"]([str(ROOT / "docs" / folder), "--table"])
    assert capsys.readouterr().out.strip() in (ROOT / "docs" / "proof.md").read_text(encoding="utf-8")


@pytest.mark.study
@pytest.mark.parametrize(
    "case",
    [
        "rooted --isos 100 200",  # codes of a curve, wider than the noise
        "twelve --isos 100 --seed 2",  # and even ones
        "plain --isos 6400 --repeat 3",  # a distribution that ends
        "telegraph --isos 200 400",  # row noise holds, whatever the shape of the read noise
        "silent --isos 800",
        "smoothed --isos 100 800",
    ],
)
def test_what_the_study_of_calibration_found(case: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(EXAMPLES)
    study: Any = importlib.import_module("prove_calibration")
    assert study.main(case.split()) == 0
    if case.startswith("silent"):  # against another K it does not hold
        truths = study.Specimen.truths
        monkeypatch.setattr(study.Specimen, "truths", lambda self: truths(self) | {"K": (1.1 * self.case.gain,)})
        assert study.main(case.split()) == 1
