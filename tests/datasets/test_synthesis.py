"""Synthetic pairs on disk: files, manifest, recorded parameters, noise."""

from __future__ import annotations

import json
import pickle
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import exifread
import numpy as np
import pytest
import torch

from eldata.cli.main import main
from eldata.datasets.base import PairDataset
from eldata.datasets.clips import ClipWindows
from eldata.datasets.synthetic import synthesis
from eldata.datasets.synthetic.synthesis import Recipe, draw_splits, synthesize
from eldata.errors import ArgumentError, DatasetError, RawFileError
from eldata.manifest import load_manifest, verify
from eldata.noise import CameraProfile, NoiseModel, NoiseParameters
from eldata.raw import bayer_cfa, read_raw, write_dng
from eldata.raw.levels import XTRANS_CFA, pack_normalised
from eldata.records import Exposure, Sensor
from eldata.sources.frames import Files
from tests.cases import in_one_test
from tests.noise.helpers import Law

BLACK, WHITE = 512.0, 16383.0
RANGE = WHITE - BLACK
LEVEL = 0.3  # of the clean flat
SONY = CameraProfile.load("SonyA7S2")
EXPOSURE = Exposure(Fraction(100), Fraction(4), Fraction(28, 5))


def sensor(height: int, width: int) -> Sensor:
    return Sensor("ACME", "One", ((0, 1), (3, 2)), (BLACK,) * 4, WHITE, height, width, (2.0, 1.0, 1.5, 1.0))


def write_flat(path: Path, height: int = 256, width: int = 256) -> None:
    mosaic = np.full((height, width), round(BLACK + LEVEL * RANGE), dtype=np.uint16)
    write_dng(path, mosaic, sensor(height, width), EXPOSURE)


@pytest.fixture
def clean(tmp_path: Path) -> Path:
    folder = tmp_path / "clean"
    (folder / "sub").mkdir(parents=True)
    write_flat(folder / "a.dng")
    write_flat(folder / "sub" / "b.dng", 128, 192)
    return folder


def recorded(out: Path) -> list[dict[str, Any]]:
    frames: list[dict[str, Any]] = json.loads((out / "parameters.json").read_text())["frames"]
    return frames


def parameters_of(frame: dict[str, Any]) -> NoiseParameters:
    names = ("gain_dn_per_e", "tukey_lambda", "sigma_tl_dn", "sigma_gauss_dn", "sigma_row_dn")
    return NoiseParameters(**{name: frame[name] for name in names}, colour_bias_dn=tuple(frame["colour_bias_dn"]))


@pytest.mark.parametrize("file_format", ["dng", "npy"])
def test_tree_verifies_and_is_read(clean: Path, tmp_path: Path, file_format: Any) -> None:
    out = tmp_path / "out"
    manifest = synthesize(clean, out, Recipe(SONY, per_image=2, format=file_format))
    report = verify(manifest.path, out / "data", level="full")
    assert report.ok, report.format_text()
    assert report.datasets[0].files_checked == 6
    pairs = PairDataset(out / "data" / "out", manifest.path, levels="metadata", clip="none")
    assert len(pairs) == len(recorded(out)) == 4
    for sample, frame in zip(pairs, recorded(out), strict=True):
        assert sample["path"] == frame["path"]
        assert sample["ratio"] == pytest.approx(frame["ratio"], rel=1e-8)  # EXIF has 32 bits a part
        assert 100 <= frame["ratio"] <= 300
        assert sample["input"].shape == sample["target"].shape
        assert float(sample["target"].mean()) == pytest.approx(LEVEL, abs=1e-4)
    cut = PairDataset(out / "data" / "out", manifest.path, levels="metadata", clip="none", crop=8, crops_per_frame=3)
    cut.set_epoch(0)
    for index, sample in enumerate(cut):  # a packed array is cut as a raw file is
        top, left = (side.start // 2 for side in cut.item(index).crop.slices)
        for whole, part in ((pairs[index % 4][name], sample[name]) for name in ("input", "target")):
            assert torch.equal(part, whole[:, top : top + 8, left : left + 8])


@pytest.mark.parametrize(("block", "word"), [(1, "bayer"), (2, "quad-bayer"), (3, "nona-bayer")])
def test_noise_is_that_of_the_recorded_parameters(block: int, word: str, tmp_path: Path) -> None:
    """Against the closed forms, within 5 standard errors, of the DNGs' own pixels.

    Mean and variance of each colour, and the variance of the mosaic rows' means; U's variance is the DNG's rounding.
    """
    cfa, clean, out = bayer_cfa("GRBG", block), tmp_path / "clean", tmp_path / "out"
    clean.mkdir()
    whole = replace(sensor(252, 241), cfa=cfa)  # of odd width: what fills no period is left out
    write_dng(clean / "a.dng", np.full((252, 241), round(BLACK + LEVEL * RANGE), np.uint16), whole, EXPOSURE)
    manifest = synthesize(clean, out, Recipe(SONY, per_image=4))
    assert manifest.card.cfa == word
    for frame in recorded(out):
        p = parameters_of(frame)
        raw = read_raw(out / "data" / "out" / frame["path"])
        assert raw.sensor.cfa == cfa
        dn = raw.mosaic.astype(np.float64) - BLACK
        height, width = dn.shape
        assert (height, width) == (252, 240)
        electrons = LEVEL * RANGE / frame["ratio"] / p.gain_dn_per_e
        law = Law.of("P*+G*+B+R+U", p, electrons)
        pixel, row = law.variance, law.row_variance
        variance = pixel + row
        channel = np.array(cfa)[np.arange(height)[:, None] % len(cfa), np.arange(width) % len(cfa)]
        for index in range(4):
            found = dn[channel == index]
            error = np.sqrt(pixel / found.size + row / (height / 2))
            assert abs(found.mean() - law.mean - p.colour_bias_dn[index]) < 5 * error
            # Var of a sample variance: about (kurtosis - 1) / n; read noise has a kurtosis below 6 here.
            spread = np.sqrt(5 / found.size) + np.sqrt(2 / (height / 2)) * row / variance
            assert abs(found.var() / variance - 1) < 5 * spread
        biases = np.array([p.colour_bias_dn[index] for index in range(4)])
        means = (dn - biases[channel]).mean(axis=1)  # one draw a row, and what the row's pixels leave
        expected = row + pixel / width
        assert abs(means.var(ddof=1) / expected - 1) < 5 * np.sqrt(2 / (height - 1))


def test_files_have_the_quantisation_step_of_the_camera(clean: Path, tmp_path: Path) -> None:
    """White, 16383, is no multiple of 4, and no pixel of these reaches it."""
    for step in (4.0, 1.0):
        out = tmp_path / f"{step:g}"
        synthesize(clean, out, Recipe(replace(SONY, quantisation_step_dn=step)))
        for frame in recorded(out):
            mosaic = read_raw(out / "data" / out.name / frame["path"]).mosaic
            assert set(np.unique(mosaic % 4)) == ({0} if step == 4 else {0, 1, 2, 3})


# --- interruptions ------------------------------------------------------------------------------------------------


class EndedError(Exception):
    pass


def everything(out: Path) -> dict[str, bytes]:
    return {str(path.relative_to(out)): path.read_bytes() for path in sorted(out.rglob("*")) if path.is_file()}


@pytest.fixture
def unfinished(clean: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[Path, dict[str, bytes]]:
    """A run that ended in its second scene, and what an undisturbed one leaves."""
    whole, out = tmp_path / "whole" / "set", tmp_path / "ended" / "set"
    for folder in (whole, out):
        folder.parent.mkdir()
    synthesize(clean, whole, Recipe(SONY, per_image=2))
    real = write_dng

    def ending(path: Path, *rest: Any, **options: Any) -> None:
        if path.match("scene-2/noisy-2.dng"):
            raise EndedError
        real(path, *rest, **options)

    with monkeypatch.context() as patch:
        patch.setattr(synthesis, "write_dng", ending)
        with pytest.raises(EndedError):
            synthesize(clean, out, Recipe(SONY, per_image=2))
    return out, everything(whole)


def test_an_ended_run_goes_on(
    unfinished: tuple[Path, dict[str, bytes]], clean: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, whole = unfinished
    assert sorted(path.name for path in out.iterdir()) == [".begun", "data", "manifests"], "no manifest yet"
    assert not list((out / "manifests").iterdir())
    written: list[str] = []

    def writing(path: Path, *rest: Any, **options: Any) -> None:
        written.append(path.name)
        write_dng(path, *rest, **options)

    monkeypatch.setattr(synthesis, "write_dng", writing)
    half = out / "data" / "set" / "SonyA7S2" / "scene-2" / ".noisy-2.dng.eldata.part"
    half.write_bytes(b"half")
    synthesize(clean, out, Recipe(SONY, per_image=2))
    assert written == ["noisy-2.dng"], "all others were whole"
    assert everything(out) == whole


def test_only_the_same_work_goes_on(unfinished: tuple[Path, dict[str, bytes]], clean: Path) -> None:
    out, _ = unfinished
    before = everything(out)
    same = Recipe(SONY, per_image=2)
    for recipe in (Recipe(SONY), replace(same, seed=5), replace(same, profile=replace(SONY, source="changed"))):
        with pytest.raises(ArgumentError, match=r"set: was begun with another recipe, .* remove it to start again"):
            synthesize(clean, out, recipe)
    write_flat(clean / "c.dng")
    with pytest.raises(ArgumentError, match="was begun with"):
        synthesize(clean, out, same)
    assert everything(out) == before


def test_npy_is_the_models_output(clean: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    options: Any = {"iso": 12800, "row": "nearest-gain", "extrapolate": True}
    recipe = Recipe(SONY, spec="P*+G*+B+R", seed=7, ratio=(200, 200), format="npy", **options)
    synthesize(clean, out, recipe)
    frame = recorded(out)[0]
    raw = read_raw(out / "data" / "out" / "SonyA7S2" / "scene-1" / "clean.dng")
    target = pack_normalised(raw.mosaic, raw.sensor.cfa, raw.sensor.black_level_dn, raw.sensor.white_level_dn)
    generator = np.random.default_rng([7, 0, 0])
    p = SONY.sample(generator, **options)
    assert parameters_of(frame) == p
    assert frame["ratio"] == 200
    generator.uniform()  # the ratio's draw
    expected = NoiseModel("P*+G*+B+R")(target, parameters=p, ratio=200.0, range_dn=RANGE, generator=generator)
    np.testing.assert_array_equal(np.load(out / "data" / "out" / frame["path"]), expected)


def test_dark_frames(tmp_path: Path) -> None:
    """A frame without light is the dark frame itself; each dark frame comes once before any twice."""
    clean, dark = tmp_path / "clean", tmp_path / "Camera" / "bias" / "ISO1600"
    clean.mkdir()
    dark.mkdir(parents=True)
    of, generator = replace(sensor(32, 48), black_level_dn=(508.0, 511.0, 513.0, 516.0)), np.random.default_rng(2)
    without_light = np.tile(np.array(of.black_level_dn, np.uint16)[np.array(of.cfa)], (16, 24))
    for number in range(3):
        mosaic = generator.integers(480, 540, (32, 48)).astype(np.uint16)
        write_dng(dark / f"{number}.dng", mosaic, of, Exposure(Fraction(1600), Fraction(1, 8000)))
        write_dng(clean / f"{number % 2}.dng", without_light, of, EXPOSURE)
    recipe = Recipe(SONY, spec="P*+D", iso=1600, per_image=3, dark_frames=tmp_path / "Camera")
    synthesize(clean, tmp_path / "out", recipe)
    frames = recorded(tmp_path / "out")
    used = [frame["dark_frame"] for frame in frames]
    assert len(set(used[:3])) == len(set(used[3:])) == 3
    for frame in frames:
        made, own = read_raw(tmp_path / "out" / "data" / "out" / frame["path"]), read_raw(frame["dark_frame"])
        assert np.abs(made.mosaic.astype(int) - own.mosaic).max() <= 1  # the dither, rounded
        assert made.exposure.iso == 1600
    assert pickle.loads(pickle.dumps(recipe)) == recipe, "as it goes to workers"
    with pytest.raises(ArgumentError, match="no dark frames of ISO 800; there are 1600"):
        replace(recipe, iso=800)


# Regression: 1600 became 1599, 6400 became 6395 and 100 became 50.
@pytest.mark.parametrize("iso", [100, 320, 6400])
def test_the_iso_asked_for_is_the_iso_written(iso: int, tmp_path: Path) -> None:
    (tmp_path / "clean").mkdir()
    write_flat(tmp_path / "clean" / "a.dng", 32, 48)
    manifest = synthesize(tmp_path / "clean", tmp_path / "out", Recipe(SONY, spec="P", iso=iso))
    (row,) = (row for row in manifest.records if row.role == "noisy")
    assert row.iso == iso
    with (tmp_path / "out" / "data" / "out" / row.path).open("rb") as file:
        assert exifread.process_file(file)["EXIF ISOSpeedRatings"].values == [iso]
    (pair,) = PairDataset(tmp_path / "out" / "data" / "out", manifest.path)
    assert pair["iso"] == iso


def test_xtrans_at_an_offset_and_odd_sizes(tmp_path: Path) -> None:
    cfa = tuple(tuple(XTRANS_CFA[(y + 2) % 6][(x + 1) % 6] for x in range(6)) for y in range(6))
    mosaic = np.random.default_rng(0).integers(2000, 9000, (101, 113), dtype=np.uint16)
    described = replace(sensor(101, 113), cfa=cfa, black_level_dn=(1024.0,) * 3)
    (tmp_path / "clean").mkdir()
    write_dng(tmp_path / "clean" / "x.dng", mosaic, described, EXPOSURE)
    manifest = synthesize(tmp_path / "clean", tmp_path / "out", Recipe(SONY))
    assert manifest.card.cfa == "xtrans"
    sample = PairDataset(tmp_path / "out/data/out", manifest.path, levels="metadata")[0]
    assert sample["input"].shape == sample["target"].shape == (9, 32, 36)
    expected = pack_normalised(mosaic, cfa, (1024.0,) * 3, WHITE)
    np.testing.assert_array_equal(sample["target"].numpy(), expected)


@in_one_test(
    "options, word",
    [
        ({"ratio": (300.0, 100.0)}, "ratio"),
        ({"seed": -1}, "seed"),
        ({"per_image": 0}, "per_image"),
        ({"format": "png"}, "format"),
        ({"spec": "U"}, "rounds"),
        ({"iso": 12800}, "ISO 12800 is outside"),
        ({"iso": 400.5}, "a DNG states its ISO as a whole number"),
        ({"spec": "P*+D"}, "dark_frames="),
        ({"spec": "P*+D", "dark_frames": Path("none")}, "dark frames of one ISO; choose it with --iso"),
    ],
)
def test_recipes_that_are_refused(options: dict[str, Any], word: str) -> None:
    with pytest.raises(ArgumentError, match=word):
        Recipe(SONY, **options)


def test_what_cannot_be_made_noisy(clean: Path, tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"b\.dng: lies in two"):
        synthesize([clean, clean / "sub"], tmp_path / "out", Recipe(SONY))
    (tmp_path / "file").write_text("")
    with pytest.raises(DatasetError, match="is not a folder"):
        synthesize(clean, tmp_path / "file", Recipe(SONY))
    write_dng(clean / "a.dng", np.full((64, 64), 3000, np.uint16), sensor(64, 64), Exposure(Fraction(100)))
    with pytest.raises(RawFileError, match="exposure time"):
        synthesize(clean, tmp_path / "out", Recipe(SONY))


def test_command(clean: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    (tmp_path / "more").mkdir()
    write_flat(tmp_path / "more" / "c.dng", 96, 96)
    several = ["synthesize", str(clean), str(tmp_path / "more"), "--jobs", "1", "-o"]
    command = [*several, str(out), "--camera", "NikonD850", "--ratio", "150", "--split", "2:1"]
    assert main(command) == 0
    assert "3 noisy frames of 3 clean ones" in capsys.readouterr().out
    made = [(Path(frame["clean"]).name, frame["ratio"]) for frame in recorded(out)]
    assert made == [("a.dng", 150), ("b.dng", 150), ("c.dng", 150)]
    manifest = load_manifest(out / "manifests" / "out.csv")
    assert sorted(row.split for row in manifest.records) == ["test"] * 2 + ["train"] * 4
    assert verify(manifest.path, out / "data", level="metadata").ok
    for wrong, words in (
        (command[6:], "holds something already"),
        ([str(tmp_path / "new"), "--camera", "Kodak"], "Kodak"),
        ([str(tmp_path / "new"), "--camera", "SonyA7S2", "--ratio", "x"], "ratio"),
    ):
        assert main([*several, *wrong]) == 2
        said = capsys.readouterr().err
        assert (words in said, said.count("\n")) == (True, 1)
    assert not (tmp_path / "new").exists()


# --- clips ------------------------------------------------------------------------------------------------------------


def write_clips(folder: Path, clips: int, frames: int) -> Path:
    """Clips of a flat and a square that moves by 8 pixels a frame."""
    for clip in range(clips):
        place = folder / f"{clip:03}"
        place.mkdir(parents=True)
        for number in range(frames):
            mosaic = np.full((96, 96), round(BLACK + LEVEL * RANGE), np.uint16)
            mosaic[16:32, 8 * number : 8 * number + 16] = 9000
            write_dng(place / f"{number + 8}.dng", mosaic, sensor(96, 96), EXPOSURE)  # 8, 9, 10: not by letters
    return folder


def draw_of(frame: dict[str, Any]) -> tuple[object, ...]:
    return (*(str(value) for name, value in frame.items() if name not in ("path", "clean")),)


def test_clips_are_drawn_once_each_and_load_as_clips(tmp_path: Path) -> None:
    clean, out = write_clips(tmp_path / "clean", 3, 4), tmp_path / "out"
    manifest = synthesize(clean, out, Recipe(SONY, per_image=2, clips=True, split=(2, 1), seed=5))
    assert verify(manifest.path, out / "data", level="full").ok
    assert manifest.card.protocol == "sequences"
    frames = recorded(out)
    draws = {(Path(frame["clean"]).parent.name, Path(frame["path"]).name, draw_of(frame)) for frame in frames}
    assert len(draws) == len({draw for *_, draw in draws}) == 3 * 2  # one a clip and copy, and no two alike
    splits = {(row.scene.split("-moment-")[0], row.split) for row in manifest.records}
    assert sorted(split for _, split in splits) == ["test", "train", "train"]
    folder = out / "data" / "out"
    windows = ClipWindows(Files(folder, manifest.records), manifest.records, (), folder, window=4, clip="none")
    assert len(windows) == 6
    order = {frame["path"]: int(Path(frame["clean"]).stem) for frame in frames}
    assert all([order[path] for path in record.frames] == [8, 9, 10, 11] for record in windows.records)
    for item in windows:
        noise = (item["input"] - item["target"]).reshape(4, -1).numpy()
        # Of noise that is drawn afresh the correlation is 0 to 1 / sqrt(9216); rows' and the bias's are a part of it.
        between = np.corrcoef(noise - noise.mean(axis=1, keepdims=True))
        assert np.abs(between[np.triu_indices(4, 1)]).max() < 0.3
        assert noise.std() > 0


def test_clips_are_scored_by_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    clean, out = write_clips(tmp_path / "clean", 2, 3), tmp_path / "out"
    command = ["synthesize", str(clean), "--camera", "SonyA7S2", "--jobs", "1", "-o"]
    for options, words in (([], ("--clips", "--no-clips", str(clean))), (["--clips", "--split", "95:5"], ("95:5",))):
        assert main([*command, str(out), *options]) == 2
        said = capsys.readouterr().err
        assert all(word in said for word in words)
    assert main([*command, str(out), "--clips", "--split", "1:1"]) == 0
    root = ["--manifest", str(out / "manifests" / "out.csv"), "--root", str(out / "data"), "--jobs", "1"]
    assert main(["evaluate", "--baseline", "input", *root, "--json", str(tmp_path / "r.json")]) == 0
    videos = json.loads((tmp_path / "r.json").read_text())["videos"]
    assert [len(video["frame_scores"]) for video in videos] == [3, 3]
    assert main([*command, str(tmp_path / "stills"), "--no-clips"]) == 0
    assert len({draw_of(frame) for frame in recorded(tmp_path / "stills")}) == 6


def test_a_frame_of_another_clip_is_named(tmp_path: Path) -> None:
    clean = write_clips(tmp_path / "clean", 2, 3)
    write_flat(clean / "001" / "9.dng")
    with pytest.raises(DatasetError, match=r"9\.dng: width 256, .*8\.dng has 96"):
        synthesize(clean, tmp_path / "out", Recipe(SONY, clips=True))


def test_a_split_is_of_whole_scenes_or_clips_and_follows_the_seed() -> None:
    drawn = [draw_splits(seed, (95, 5), 100) for seed in (0, 0, 1)]
    assert [one.count("test") for one in drawn] == [5, 5, 5]
    assert drawn[0] == drawn[1] != drawn[2]
    for shares in ((0, 5), (95, -5), (float("nan"), 1)):
        with pytest.raises(ArgumentError, match="split"):
            draw_splits(0, shares, 100)
