"""Mosaics without levels of their own, whose card states them: whatever holds them, as the same frames in DNG files."""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
import tifffile
from numpy.typing import NDArray

from eldata import evaluate
from eldata.base.files import sha256_of
from eldata.cli.main import main
from eldata.datasets import CalibrationFrames, CleanClips, CleanFrames, PairDataset, SyntheticPairs
from eldata.errors import ArgumentError, DatasetError, RawFileError, UnusableRawError
from eldata.manifest import load_manifest, verify
from eldata.manifest.card import CameraCard, Card, load_card, save_card
from eldata.manifest.catalogue import FrameFiles, save_manifest
from eldata.raw import bayer_cfa, pack, pack_normalised, read_raw, write_dng
from eldata.raw.levels import packed_frame
from eldata.raw.stated import MosaicFacts, StatedFile
from eldata.records import Exposure, FrameRecord, Sensor
from tests.cases import in_one_test
from tests.sidd_tree import save_matlab_73

SHAPE, BLACK, WHITE, CFA = (48, 64), 240.0, 4095.0, "GBRG"
REFERENCE, NOISY = Exposure(Fraction(100), Fraction(1)), Exposure(Fraction(1600), Fraction(1, 1600))
RATIO = Fraction(100)
CARD = Card("own", "Own", "1", "own", "", "", "", "bayer", {"Cam": CameraCard(())}, {"noisy": 2, "reference": 2})


WRITERS: dict[str, Callable[[Path, NDArray[Any]], object]] = {
    "npy": np.save,
    "tiff": tifffile.imwrite,
    "mat": lambda path, mosaic: scipy.io.savemat(path, {"x": mosaic}, do_compression=True),
    "MAT": save_matlab_73,
}


def mosaic_of(exposure: Exposure, seed: int) -> NDArray[np.uint16]:
    generator = np.random.default_rng(seed)
    scene = np.random.default_rng(1).gamma(2.0, 600.0, SHAPE)
    light = scene if exposure is REFERENCE else scene / float(RATIO)
    return np.clip(generator.poisson(light) + BLACK + generator.normal(0, 2, SHAPE), 0, WHITE).astype(np.uint16)


def own_set(folder: Path, kind: str, facts: MosaicFacts | None) -> Path:
    """Write a set of two pairs; return its manifest. ``kind`` is the files' extension; DNGs state all themselves."""
    data, rows = folder / "data" / "own", []
    sensor = Sensor("Maker", "Model", bayer_cfa(CFA), (BLACK,) * 4, WHITE, *SHAPE)
    for scene in ("a", "b"):
        (data / scene).mkdir(parents=True)
        for seed, (name, exposure) in enumerate((("clean", REFERENCE), ("noisy", NOISY)), ord(scene)):
            mosaic, path = mosaic_of(exposure, seed), data / scene / f"{name}.{kind}"
            if kind == "dng":
                write_dng(path, mosaic, sensor, exposure)
            else:
                WRITERS[kind](path, mosaic)
        shot = partial(FrameRecord, camera="Cam", scene=scene, split="test")
        clean = shot(f"{scene}/clean.{kind}", "reference", iso=REFERENCE.iso, exposure_s=REFERENCE.exposure_s)
        noisy = shot(f"{scene}/noisy.{kind}", "noisy", iso=NOISY.iso, exposure_s=NOISY.exposure_s)
        noisy = replace(noisy, ratio=RATIO, reference=clean.path)
        rows += [clean, noisy]
    path = folder / "own.csv"
    save_manifest(path, replace(CARD, mosaics=() if facts is None else (facts,)), rows)
    return path


FACTS = MosaicFacts("*", CFA, (BLACK,), WHITE)


def scored(manifest: Path) -> list[tuple[float, float, float | None]]:
    result = evaluate(None, "own", manifest=manifest, root=manifest.parent / "data", baseline="input")
    return [(score.psnr_db, score.ssim, score.ratio) for score in result.scores]


@pytest.fixture(scope="module")
def as_dng(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return own_set(tmp_path_factory.mktemp("dng"), "dng", None)


@pytest.mark.parametrize("kind", WRITERS)
def test_mosaics_are_read_as_raws_are(kind: str, as_dng: Path, tmp_path: Path) -> None:
    path = own_set(tmp_path, kind, FACTS)
    root = tmp_path / "data"
    report = verify([load_manifest(path)], root, level="full")
    assert report.problems == ()
    expected = PairDataset(as_dng.parent / "data" / "own", as_dng, clip="none")
    found = PairDataset(root / "own", path, clip="none")
    for raw, mosaic in zip(expected, found, strict=True):
        np.testing.assert_array_equal(raw["input"], mosaic["input"])
        np.testing.assert_array_equal(raw["target"], mosaic["target"])
        assert (raw["ratio"], raw["iso"], raw["exposure_s"]) == (mosaic["ratio"], mosaic["iso"], mosaic["exposure_s"])


def test_mosaics_are_scored_packed_and_predicted_as_raws_are(as_dng: Path, tmp_path: Path) -> None:
    path = own_set(tmp_path, "npy", FACTS)
    assert scored(path) == scored(as_dng)
    common = ["--manifest", str(path), "--root", str(tmp_path / "data"), "--jobs", "1"]
    predictions = str(tmp_path / "preds")
    assert main(["baseline", "input", *common, "-o", predictions]) == 0
    assert main(["evaluate", predictions, *common, "--allow-suspect"]) == 0
    assert main(["pack", "own", *common, "-o", str(tmp_path / "own.h5")]) == 0


def test_references_are_clean_frames(as_dng: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a manifest alone and beside others: as the same mosaics in DNG files, to the bit."""
    monkeypatch.setenv("ELDATA_ROOT", str(as_dng.parent / "data"))
    raws = CleanFrames(as_dng)
    monkeypatch.setenv("ELDATA_ROOT", str(tmp_path / "data"))
    path = own_set(tmp_path, "tiff", FACTS)
    arrays, several = CleanFrames(str(path)), CleanFrames([path, as_dng.parent / "data" / "own" / "a"])
    assert (len(raws), len(arrays), len(several)) == (2, 2, 3)
    np.testing.assert_array_equal(several.frame(1).whole(), raws.frame(1).whole())
    of_raws, of_arrays = (SyntheticPairs(clean, "CanonEOS5D4", crop=16, seed=3) for clean in (raws, arrays))
    np.testing.assert_array_equal(of_raws[1]["input"], of_arrays[1]["input"])
    assert len(CleanClips(path)) == 2
    (tmp_path / "data" / "own" / "a" / "clean.tiff").unlink()
    assert main(["synthesize", str(path), "-o", str(tmp_path / "none"), "--camera", "CanonEOS5D4"]) == 2


def test_floats_are_what_the_card_calls_white(tmp_path: Path) -> None:
    shares = (np.arange(16, dtype=np.float64).reshape(4, 4) / 20).astype(np.float64)
    np.save(tmp_path / "x.npy", shares)
    frame = read_raw(StatedFile(tmp_path / "x.npy", MosaicFacts("*", "RGGB", (0.0,), 1.0)))
    assert frame.mosaic.dtype == np.float32
    np.testing.assert_array_equal(frame.mosaic, shares.astype(np.float32))
    packed = packed_frame(frame, levels="metadata", clip="none")
    np.testing.assert_array_equal(packed, pack(shares.astype(np.float32), frame.sensor.cfa))
    with pytest.raises(DatasetError, match=r"x\.npy: its white level is 1, .* white level of 16383 .* is in DN"):
        packed_frame(frame, levels="published", clip="both")
    with pytest.raises(RawFileError, match=r"no whole DN, .*; a store needs whole DN: use the raw files"):
        frame.whole_dn("a store")
    with pytest.raises(ArgumentError, match="corrected=True"):  # floats are mostly normalised already
        pack_normalised(frame.mosaic, frame.sensor.cfa, frame.sensor.black_level_dn, 1.0)


def test_a_file_of_which_nothing_is_stated_is_refused(tmp_path: Path) -> None:
    """By its card's name for it, whatever reads it."""
    path = own_set(tmp_path, "mat", None)
    report = verify([load_manifest(path)], tmp_path / "data", level="metadata")
    assert len(report.problems) == 4
    assert "mosaics" in report.problems[0].advice
    with pytest.raises(RawFileError, match="mosaics"):
        PairDataset(tmp_path / "data" / "own", path)[0]


def npy(values: NDArray[Any]) -> bytes:
    content = io.BytesIO()
    np.save(content, values)
    return content.getvalue()


@in_one_test(
    "name, content, problem",
    [
        ("x.npy", npy(np.zeros((4, 4, 3), np.uint16)), "mosaic of numbers"),
        ("x.npy", npy(np.full((4, 4), 1 << 16, np.uint32)), "DN from 0"),
        ("x.npy", npy(np.full((4, 4), np.nan, np.float32)), "not finite"),
        ("x.mat", b"\x89HDF\r\n\x1a\n", "is HDF5 without MATLAB's header: name it .h5"),
        ("x.h5", b"MATLAB 7.3 MAT-file", "is a MATLAB file: name it .mat"),
        ("x.bin", bytes(96), "is numbers without a header; state its shape"),
    ],
)
def test_what_is_no_mosaic_is_named(name: str, content: bytes, problem: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(RawFileError, match=f"{name}: .*{problem}"):
        StatedFile(tmp_path / name, FACTS).read()


def shares_of(mosaic: NDArray[Any]) -> NDArray[np.float32]:
    return ((mosaic - np.float32(BLACK)) / np.float32(WHITE - BLACK)).astype(np.float32)


def save_as(dtype: str, values: NDArray[Any], path: Path) -> StatedFile:
    """Write TIFF, as CRVD has it, or what the name says, as SIDD and LRID have it."""
    WRITERS[path.suffix[1:]](path, np.asarray(values, dtype))
    return StatedFile(path, FACTS)


CLEAN, DARK = mosaic_of(REFERENCE, 1).astype(np.float64), mosaic_of(NOISY, 1).astype(np.float64)


@pytest.mark.parametrize(
    ("values", "dtype", "name", "levels", "fitting"),
    [
        (shares_of(CLEAN), "float32", "x.npy", (64, 1023), r"\d, which are shares of white, .* black 0 and white 1 "),
        (shares_of(DARK), "float32", "x.npy", (0, 16383), "black 0 and white 1 "),
        (CLEAN, "float64", "x.mat", (0, 1), r"far outside.* white 4095 \(values of 12 bits\) would fit"),
        (CLEAN / 4, "uint16", "x.mat", (0, 1), r"; white 1023 \(values of 10 bits\) would fit"),
        (np.where(DARK > 270, 300.5, 0.3), "float32", "x.npy", (0, 1), "many of them far outside"),
        (CLEAN / 16, "uint8", "x.tiff", (240, 4095), "uint8, which ends at 255, .* black 14.95 and white 255 "),
        (CLEAN / 16, "uint16", "x.tiff", (240, 4095), "most of them below black"),
        (CLEAN * 16, "uint16", "x.tiff", (240, 4095), "black 3841 and white 65535 "),
        (CLEAN, "uint16", "x.npy", (64, 1023), "many of them far outside"),
        (np.maximum(DARK - BLACK, 0), "uint16", "x.npy", (240, 4095), "most of them below black"),
    ],
)  # fmt: skip
def test_values_that_cannot_be_of_the_cards_levels_are_refused(
    values: NDArray[Any], dtype: str, name: str, levels: tuple[float, float], fitting: str, tmp_path: Path
) -> None:
    file = save_as(dtype, values, tmp_path / name)
    file = replace(file, facts=replace(FACTS, black_level_dn=levels[:1], white_level_dn=levels[1]))
    stated = f"where its card states black {levels[0]} and white {levels[1]}"
    with pytest.raises(UnusableRawError, match=rf"x\.\w+: .*{stated}; ") as refused:
        file.read()
    assert re.search(fitting, str(refused.value))
    if dtype == "uint8":
        with pytest.raises(UnusableRawError, match=stated):
            file.check()


NOISE = np.random.default_rng(3).normal(0, 1, (480, 640))


@pytest.mark.parametrize(
    ("values", "dtype", "levels"),
    [
        (np.full(SHAPE, 64), "uint16", (64, 1023)),  # a quiet sensor's bias frame
        (np.zeros(SHAPE), "uint16", (0, 16383)),  # one whose black is clipped
        (511.4 + 0.3 * NOISE, "uint16", (512, 16383)),
        (512 - 100 + 40 * NOISE, "uint16", (512, 16383)),  # at the highest ISO, black off by half a percent
        (2048 + 900 * NOISE.clip(-2, 9), "uint16", (2048, 15520)),  # x300: half of it below black
        (np.full(SHAPE, 16383), "uint16", (2048, 13583)),  # blown out: converters end above the stated white
        (np.where(NOISE > 0, 1, 0.1 * NOISE), "float32", (0, 1)),
        (np.where(NOISE > 1, 3, 0.2), "float32", (0, 1)),  # fused of several exposures
        (0.05 * NOISE, "float32", (0, 16383)),  # a mean of dark frames less their black
        (16 * np.rint(250 + 5 * NOISE), "uint16", (4000, 65520)),  # 12 bits in 16
        (np.where(np.arange(640) < 300, 0, 600 + 5 * NOISE), "float32", (512, 16383)),  # padding
        (np.where(NOISE > 0, 1, 0), "uint8", (0, 1)),  # photons or none
    ],
)
def test_darkness_and_glare_are_of_the_cards_levels(
    values: NDArray[Any], dtype: str, levels: tuple[float, float], tmp_path: Path
) -> None:
    file = save_as(dtype, values, tmp_path / "x.npy")
    file = replace(file, facts=replace(FACTS, black_level_dn=levels[:1], white_level_dn=levels[1]))
    file.check()
    assert file.read().sensor.white_level_dn == levels[1]


def test_levels_that_do_not_fit_are_found_by_verify_and_never_scored(tmp_path: Path) -> None:
    """Shares of white, noise of 0.02, were scored as PSNR inf; a recorded hash says nothing of what the card states."""
    path = own_set(tmp_path, "npy", replace(FACTS, black_level_dn=(64,), white_level_dn=1023))
    generator = np.random.default_rng(0)
    for file in (tmp_path / "data" / "own").glob("*/*.npy"):
        values = np.linspace(0.2, 0.7, 48 * 64).reshape(SHAPE) + 0.02 * generator.normal(size=SHAPE)
        np.save(file, values.astype(np.float32))
    loaded, root = load_manifest(path), tmp_path / "data"
    hashed = [replace(row, sha256=sha256_of(root / "own" / row.path)) for row in loaded.records]
    save_manifest(path, loaded.card, hashed)
    report = verify([load_manifest(path)], root, level="full")
    assert [problem.field for problem in report.problems] == ["content"] * 4
    assert "black 0 and white 1" in report.problems[0].advice
    with pytest.raises(UnusableRawError, match="black 0 and white 1"):
        PairDataset(root / "own", path)[0]
    result = evaluate(None, "own", manifest=path, root=root, baseline="input")
    assert result.scores == ()
    assert all("black 0 and white 1" in str(problem) for problem in result.problems)


def test_borders_of_arrays_are_named_once_and_read(tmp_path: Path) -> None:
    path = own_set(tmp_path, "npy", FACTS)
    for file in (tmp_path / "data").rglob("*.npy"):
        mosaic = np.load(file)
        mosaic[-4:] = 0
        np.save(file, mosaic)
    report = verify([load_manifest(path)], tmp_path / "data", level="full")
    (remark,) = report.datasets[0].remarks
    assert (report.problems, remark.files) == ((), 4)
    assert "4 at the bottom (of 0 DN) of its 48 rows and 64 columns hold no picture" in remark.text


def test_which_of_several_arrays_is_said(tmp_path: Path) -> None:
    scipy.io.savemat(tmp_path / "x.mat", {"x": np.full(SHAPE, 300.0), "y": np.full(SHAPE, 400.0), "name": "text"})
    with pytest.raises(RawFileError, match="x, y"):
        read_raw(StatedFile(tmp_path / "x.mat", FACTS))
    assert read_raw(StatedFile(tmp_path / "x.mat", replace(FACTS, array="y"))).mosaic.max() == 400
    (tmp_path / "cut.mat").write_bytes((tmp_path / "x.mat").read_bytes()[:300])
    with pytest.raises(RawFileError, match="again"):
        read_raw(StatedFile(tmp_path / "cut.mat", replace(FACTS, array="y")))


def test_the_first_that_fits_camera_and_path_counts(tmp_path: Path) -> None:
    own, other = replace(FACTS, cameras=("Other",)), replace(FACTS, paths="a/*", cfa="RGGB")
    path = own_set(tmp_path, "npy", FACTS)
    loaded = load_manifest(path)
    card = replace(loaded.card, mosaics=(own, other, FACTS))
    files = FrameFiles.of(tmp_path, card, loaded.records)
    for place, (facts, _) in files.stated.items():
        assert facts.cfa == ("RGGB" if place.startswith("a/") else CFA)
    assert len(files.stated) == 4
    save_card(tmp_path / "card.json", card)
    assert load_card(tmp_path / "card.json") == card


def test_ratios_that_no_file_states_are_the_manifests(tmp_path: Path) -> None:
    """Rows without an exposure time need the flag that says so; without it the missing time is named."""
    path = own_set(tmp_path, "npy", FACTS)
    loaded = load_manifest(path)
    rows = [replace(row, exposure_s=None) for row in loaded.records]
    save_manifest(path, loaded.card, rows)
    with pytest.raises(RawFileError, match="exposure time"):
        PairDataset(tmp_path / "data" / "own", path)[0]
    flagged = [replace(row, flags=("nominal-ratio",)) if row.role == "noisy" else row for row in rows]
    save_manifest(path, loaded.card, flagged)
    assert PairDataset(tmp_path / "data" / "own", path)[0]["ratio"] == 100
    assert scored(path)[0][2] == 100


def test_bias_frames_in_arrays_calibrate_as_raws_do(tmp_path: Path) -> None:
    data, manifest = tmp_path / "data" / "own", tmp_path / "own.csv"
    data.mkdir(parents=True)
    for number in range(3):
        np.save(data / f"{number}.npy", mosaic_of(NOISY, number))
    shot = partial(FrameRecord, role="bias", camera="Cam", iso=Fraction(800), exposure_s=Fraction(1, 1000))
    rows = [shot(f"{number}.npy") for number in range(3)]
    save_manifest(manifest, replace(CARD, counts={"bias": 3}, mosaics=(FACTS,)), rows)
    frames = CalibrationFrames(data, manifest=manifest)
    assert frames.header(frames.records[0]).exposure.iso == 800
    np.testing.assert_array_equal(frames[1]["mosaic"], mosaic_of(NOISY, 1))
    np.save(data / "0.npy", mosaic_of(NOISY, 0).astype(np.float32) + 0.5)
    with pytest.raises((DatasetError, RawFileError), match="whole DN"):
        frames.read(frames.records[0])
