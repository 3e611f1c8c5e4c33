"""The virtual benchmark: its files and splits, small; the whole path as a study."""

from __future__ import annotations

import runpy
import subprocess
import sys
from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np
import pytest
from scipy.stats import ttest_1samp, ttest_rel

import eldata.demo.benchmark_frames
from eldata.base.workers import Workers
from eldata.datasets import DarkFrames, ELDDataset
from eldata.demo import benchmark_frames
from eldata.demo.benchmark import run_benchmark
from eldata.demo.benchmark_frames import BenchmarkPlan, benchmark_scenes, make_benchmark
from eldata.demo.sensor import BENCHMARK_SENSORS
from eldata.errors import ArgumentError
from eldata.evaluation import evaluate
from eldata.manifest import verify
from eldata.noise import CameraProfile, DarkShading
from eldata.raw.reading import read_raw
from tests.cases import in_one_test
from tests.demo.test_tree import digests
from tests.test_architecture import ROOT
from tests.waiting import PATIENCE_S

if TYPE_CHECKING:
    from pathlib import Path

    from eldata.manifest.catalogue import Manifest

EXAMPLE = ROOT / "examples" / "prove_noise_models.py"
SIZE = (64, 96)
SMALL = BenchmarkPlan(scenes=2, training_scenes=2, size=SIZE, bias_frames=2)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Manifest]:
    folder = tmp_path_factory.mktemp("benchmark")
    return folder, make_benchmark(folder, SMALL)


def test_the_test_split_is_elds_and_is_what_is_scored(made: tuple[Path, Manifest]) -> None:
    folder, manifest = made
    place = folder / "data" / "ELD-benchmark" / "BenchAlpha"
    assert sorted(path.name for path in (place / "scene-2").iterdir()) == [f"IMG_{n:04d}.dng" for n in range(1, 17)]
    pairs = ELDDataset(folder / "data" / "ELD-benchmark", manifest=manifest.path, split="test")
    assert len(pairs) == 2 * 2 * 6
    scored = evaluate(None, manifest=manifest.path, root=folder / "data", baseline="input")
    assert {image.path for image in scored.images} == {record.path for record in pairs.records}


def test_splits_share_no_scene() -> None:
    scenes = benchmark_scenes(10, 24)
    assert [sum(scene.split == split for scene in scenes) for split in ("test", "train")] == [10, 24]
    shown = [scene.picture or scene.still_life for scene in scenes]
    assert len(set(shown)) == len({scene.name for scene in scenes}) == 34
    stereo = {scene.split for scene in scenes if scene.picture.startswith("motorcycle")}
    assert len(stereo) == 1


def test_without_scikit_image_there_are_still_lifes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(benchmark_frames, "find_spec", lambda _: None)
    scenes = benchmark_scenes(10, 24)
    assert len({scene.still_life for scene in scenes}) == 34


@in_one_test("name", [*benchmark_frames.TEST_PICTURES, *benchmark_frames.TRAINING_PICTURES])
def test_pictures_are_linear_and_fill_the_frame(name: str) -> None:
    light = benchmark_frames.picture_radiance(name, 96, 144)
    assert light.shape == (3, 96, 144)
    assert light.dtype == np.float32
    assert 0 <= light.min() < 0.2 < light.max() <= 1


def test_training_scenes_have_two_takes_of_each_exposure(made: tuple[Path, Manifest]) -> None:
    """Equal but for their noise: what Noise2Noise needs."""
    folder, manifest = made
    rows = [row for row in manifest.records if row.split == "train" and row.camera == "BenchBeta"]
    noisy = [row for row in rows if row.role == "noisy" and row.scene == "scene-101"]
    exposures = {(Fraction(iso), Fraction(factor)) for iso in (800, 1600, 3200) for factor in (100, 200)}
    assert {(row.iso, row.ratio) for row in noisy} == exposures
    assert len(noisy) == 12
    place = folder / "data" / "ELD-benchmark"
    first, second = (read_raw(place / row.path) for row in noisy[:2])
    assert first.exposure == second.exposure
    assert first.exposure.exposure_s == Fraction(4) * 100 / (800 * 100)
    assert np.mean(first.mosaic != second.mosaic) > 0.5


def test_all_verifies(made: tuple[Path, Manifest]) -> None:
    assert verify([made[1]], made[0] / "data", level="metadata").ok


def test_calibration_frames_lie_where_commands_look_for_them(made: tuple[Path, Manifest]) -> None:
    folder = made[0] / "data"
    for name, isos in (("BenchAlpha", (400, 800, 1600, 3200, 6400, 12800)), ("BenchBeta", (200, 400, 800, 1600, 3200))):
        dark = DarkFrames(folder / "calibration", name, isos=isos)
        assert {float(iso) for iso in dark.isos} == set(isos)
        flats = sorted((folder / "calibration" / name / "flat" / "ISO800").iterdir())
        means = [read_raw(path).mosaic.mean() for path in flats]
        times = [read_raw(path).exposure.exposure_s for path in flats]
        assert len(flats) == 10
        # One lamp: over the black level, light goes with time, from 80 % of the range down to 5 %.
        black = read_raw(flats[0]).sensor.black_level_dn[1]
        rates = [(mean - black) / float(time or 0) for mean, time in zip(means, times, strict=True)]
        assert max(rates) / min(rates) < 1.02
        held = sorted((folder / "held-out" / name / "bias" / "ISO1600").iterdir())
        ours = sorted((folder / "calibration" / name / "bias" / "ISO1600").iterdir())
        assert len(held) == 8
        assert (read_raw(held[0]).mosaic != read_raw(ours[0]).mosaic).any()


def test_the_same_seed_gives_the_same_bytes_and_another_one_others(
    made: tuple[Path, Manifest], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(eldata.demo.benchmark_frames, "BENCHMARK_SENSORS", BENCHMARK_SENSORS[:1])
    smaller = replace(SMALL, scenes=1, training_scenes=1)
    make_benchmark(tmp_path / "again", smaller)
    again, before = digests(tmp_path / "again" / "data"), digests(made[0] / "data")
    assert len(again) == 16 + 13 + 6 * (2 + 10) + 3 * (8 + 4)
    assert again.items() <= before.items()
    make_benchmark(tmp_path / "other", replace(smaller, seed=1))
    other = digests(tmp_path / "other" / "data")
    assert other.keys() == again.keys()
    assert not other.items() & again.items()


@in_one_test("wrong", [{"scenes": 0}, {"scenes": 101}, {"training_scenes": 0}, {"bias_frames": 1}, {"seed": -1}])
def test_numbers_out_of_range_are_refused(wrong: dict[str, int]) -> None:
    with pytest.raises(ArgumentError, match=next(iter(wrong))):
        BenchmarkPlan(**wrong)  # type: ignore[arg-type]


@pytest.mark.study
def test_the_whole_path(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Of one camera; interrupted once before its end, which leaves nothing that the next run stumbles over."""

    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    plan = BenchmarkPlan(scenes=1, training_scenes=1, size=(256, 256))
    for module in ("benchmark", "benchmark_frames"):
        monkeypatch.setattr(f"eldata.demo.{module}.BENCHMARK_SENSORS", BENCHMARK_SENSORS[:1])
    with monkeypatch.context() as patch:
        patch.setattr("eldata.demo.benchmark_frames.write_json", interrupt)
        with pytest.raises(KeyboardInterrupt):
            run_benchmark(tmp_path / "x", plan)
    run_benchmark(tmp_path / "x", plan, workers=Workers(2))
    out = capsys.readouterr().out
    for words in ("all well", "--mode 3200", "6 of 6 pairs, subset test", "eldata noise check"):
        assert words in out
    profile = CameraProfile.load(str(tmp_path / "x" / "profiles" / "BenchAlpha.json"))
    assert profile.measured(1600).gain_dn_per_e == pytest.approx(0.095 * 16, rel=0.03)
    assert len(profile.gain_modes) == 2
    shading = DarkShading.load(tmp_path / "x" / "profiles" / "BenchAlpha-shading.npz")
    dark = DarkFrames(tmp_path / "x" / "profiles" / "BenchAlpha-bias.h5", shading=shading)
    assert {800, 1600, 3200} <= set(map(float, dark.isos))
    (tmp_path / "x").rename(tmp_path / "benchmark")
    rows = ["input", "P*+D", "virtual", "noise2noise", "paired"]
    options = [str(tmp_path), "--steps", "2", "--seeds", "2", "--cameras", "BenchAlpha", "--rows", *rows]
    first = subprocess.run([sys.executable, EXAMPLE, *options], capture_output=True, text=True, timeout=PATIENCE_S)
    assert first.returncode == 0, first.stderr
    capsys.readouterr()
    runpy.run_path(str(EXAMPLE))["main"](options)
    assert capsys.readouterr().out == first.stdout[first.stdout.index("BenchAlpha\n") :]  # all was there
    assert first.stdout.count("|     2 |") == len(rows) - 1


def test_intervals_of_seeds_are_those_of_a_paired_t_test(tmp_path: Path) -> None:
    """Of images that all score alike, so that the scenes have no share: against scipy's paired test."""
    example = runpy.run_path(str(EXAMPLE))
    record = example["Record"](tmp_path / "camera.json", {})
    images = [(f"scene-{n // 2}", float(ratio)) for n, ratio in enumerate((100, 200) * 6)]
    seeds = {"G": (30.1, 30.4, 29.9), "paired": (30.9, 31.3, 30.6, 33.0), "dct": (31.0,)}
    for row, means in seeds.items():
        for seed, mean in enumerate(means):
            record.add(row, seed, images, [mean] * len(images))
    mean, half = example["with_interval"](*record.of("G", 200.0, "paired"))
    paired = ttest_rel(seeds["G"], seeds["paired"][:3])  # of the seeds that both have
    assert (mean - half, mean + half) == pytest.approx(tuple(paired.confidence_interval(0.95)))
    mean, half = example["with_interval"](*record.of("dct", 100.0, "paired"))
    single = ttest_1samp(31.0 - np.array(seeds["paired"]), 0.0)
    assert (mean - half, mean + half) == pytest.approx(tuple(single.confidence_interval(0.95)))
    assert example["with_interval"](*record.of("dct", 100.0)) == pytest.approx((31.0, 0.0))


@pytest.mark.parametrize("folder", ["proof", "proof/larger"])
def test_the_documented_tables_are_those_of_the_records(folder: str, capsys: pytest.CaptureFixture[str]) -> None:
    """What docs/proof.md shows is what the command prints of the records beside it."""
    runpy.run_path(str(EXAMPLE))["main"]([str(ROOT / "docs" / folder), "--table"])
    printed = capsys.readouterr().out
    page = (ROOT / "docs" / "proof.md").read_text(encoding="utf-8")
    tables = [part for part in printed.split("\n\n") if part.startswith("|")]
    assert tables
    for table in tables:
        assert table.strip() in page
