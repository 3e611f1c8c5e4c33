"""Each shipped protocol, from files to scores, against the plain arithmetic of :mod:`tests.evaluation.plain`."""

from __future__ import annotations

import zlib
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
import rawpy
from PIL import Image

from eldata.evaluation import EvaluationResult, evaluate, evaluate_all, save_prediction
from eldata.manifest.catalogue import shipped_manifest
from eldata.protocols import PROTOCOLS
from eldata.protocols.kinds import IMAGES
from eldata.raw.dng import write_dng
from eldata.raw.reading import read_raw
from eldata.records import Exposure
from tests.evaluation import oracle, plain
from tests.evaluation.helpers import scored_pairs
from tests.evaluation.own_set import WHITE_BALANCE, OwnSet, build_own_set, mosaic_of, sensor_of
from tests.sid_tree import frames_of, write_frames

if TYPE_CHECKING:
    from numpy.typing import NDArray

PSNR_TOLERANCE_DB = 1e-6
SSIM_TOLERANCE = 1e-6


def prediction_of(target: NDArray[np.float64], name: str) -> NDArray[np.float32]:
    """Too bright, a little noisy, in places saturated, beyond, or negative."""
    generator = np.random.default_rng(zlib.crc32(name.encode()))
    result = 1.12 * target + generator.normal(0.0, 0.02, target.shape)
    result[:, 5:7, 8:12] = 1.0
    result[:, 9, 2:4] = 1.25
    result[:, 12:14, 3:9] -= 0.1
    return result.astype(np.float32)


def predict(files: Path, folder: Path, pairs: list[tuple[str, str]]) -> dict[str, NDArray[np.float32]]:
    written = {}
    for path, reference in pairs:
        written[path] = prediction_of(plain.reference(files / reference, "16383"), path)
        save_prediction(folder, path, written[path])
    return written


def assert_equal_to_the_plain_way(
    result: EvaluationResult, files: Path, written: dict[str, NDArray[np.float32]]
) -> None:
    assert not result.problems
    assert len(result.images) == len(result.pairs) > 0
    way = plain.WAYS[result.protocol.name]
    for pair, image in zip(result.pairs, result.images, strict=True):
        psnr_db, ssim, factor = plain.score(written[pair.path], files / pair.reference, way)
        assert image.psnr_db == pytest.approx(psnr_db, abs=PSNR_TOLERANCE_DB, rel=0), result.protocol.name
        assert image.ssim == pytest.approx(ssim, abs=SSIM_TOLERANCE, rel=0), result.protocol.name
        assert image.rescale == pytest.approx(factor, abs=1e-6, rel=0), result.protocol.name


# --- ELD --------------------------------------------------------------------------------------------------------------

ELD_COUNTS = {"eld": 120, "eld-uncorrected": 120, "pmn-eld": 60, "lrd-eld": 60, "led-eld": 96}
ELD_CAMERAS = ["SonyA7S2", "NikonD850"]


@pytest.fixture(scope="module")
def eld(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, dict[str, NDArray[np.float32]]]:
    """The frames of factors 100 and 200 of two cameras, one of which LibRaw knows a white level per channel of."""
    root = tmp_path_factory.mktemp("eld")
    files = root / "ELD"
    manifest = shipped_manifest("eld")
    scored = scored_pairs("eld", "eld", cameras=ELD_CAMERAS)
    pairs = [(pair.path, pair.reference) for pair in scored]
    record_of = {record.path: record for record in manifest.records}
    size = (48, 64)
    exposure_of: dict[str, Exposure] = {}
    for path, reference in pairs:
        record, clean = record_of[path], record_of[reference]
        long = Exposure(clean.iso or Fraction(100), clean.exposure_s or Fraction(4), Fraction(8))
        assert record.iso is not None
        assert record.ratio is not None
        assert long.iso is not None
        assert long.exposure_s is not None
        short = record.exposure_s or long.iso * long.exposure_s / (record.iso * record.ratio)
        exposure_of |= {reference: long, path: Exposure(record.iso, short, Fraction(8))}
    for path, exposure in exposure_of.items():
        record = record_of[path]
        make = {"NikonD850": "NIKON CORPORATION", "SonyA7S2": "SONY"}[record.camera]
        sensor = sensor_of(size, make=make, model=manifest.card.cameras[record.camera].models[0])
        (files / path).parent.mkdir(parents=True, exist_ok=True)
        write_dng(files / path, mosaic_of(path, size, bright=record.role == "reference"), sensor, exposure)
    return root, files, predict(files, root / "preds", pairs)


@pytest.mark.parametrize("name", ELD_COUNTS)
def test_protocols_of_eld(name: str, eld: tuple[Path, Path, dict[str, NDArray[np.float32]]]) -> None:
    root, files, written = eld
    cameras = None if PROTOCOLS[name].cameras else ELD_CAMERAS
    result = evaluate(root / "preds", "eld", protocol=name, root=root, cameras=cameras)
    assert len(result.pairs) == ELD_COUNTS[name]
    assert_equal_to_the_plain_way(result, files, written)


def test_libraw_states_white_levels_per_channel_of_one_of_the_cameras(
    eld: tuple[Path, Path, dict[str, NDArray[np.float32]]],
) -> None:
    """Or the comparison above would not cover them; where it does not, the result says so."""
    root, files, _ = eld
    levels = []
    for camera in ("NikonD850", "SonyA7S2"):
        with rawpy.imread(str(next((files / camera / "scene-3").glob("IMG_0006.*")))) as raw:
            levels.append((raw.camera_white_level_per_channel, raw.white_level))
    assert levels[0][0] is not None
    assert levels[0][0][0] not in (levels[0][1], 16383)
    assert levels[1][0] is None
    result = evaluate(root / "preds", "eld", protocol="led", root=root)
    (note,) = (note for note in result.notes if note.startswith("LibRaw"))
    assert "of the references of 48 pairs, such as that of SonyA7S2/scene-" in note
    assert "SonyA7S2" not in evaluate(root / "preds", "eld", protocol="led", root=root, cameras=["NikonD850"]).notes


def test_all_scores_each_protocol_of_a_published_set_on_its_own_pairs(
    eld: tuple[Path, Path, dict[str, NDArray[np.float32]]],
) -> None:
    root, _, _ = eld
    combined = evaluate_all(root / "preds", "eld", root=root, cameras=["SonyA7S2"])
    counts = {result.protocol.name: len(result.images) for result in combined.results}
    assert counts == {"eld": 60, "eld-uncorrected": 60, "pmn-eld": 60, "led-eld": 48, "lrd-eld": 60}
    for result in combined.results:
        alone = evaluate(root / "preds", "eld", protocol=result.protocol.name, root=root, cameras=["SonyA7S2"])
        assert result == alone
    assert combined.results[2].images == combined.results[0].images  # pmn-eld scores as eld does
    assert "pmn-eld: scored alike, the pairs differ" in combined.format_text()
    assert "(48 pairs)" not in combined.format_table()  # all of led-eld's pairs are eld's too


# --- SID --------------------------------------------------------------------------------------------------------------

SID_COUNTS = {"sid": 129, "sid-uncorrected": 129, "pmn-sid": 129, "lrd-sid": 129, "led-sid": 93}


@pytest.fixture(scope="module")
def sid(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, dict[str, NDArray[np.float32]]]:
    root = tmp_path_factory.mktemp("sid")
    files = root / "SID"
    manifest = shipped_manifest("sid-sony")
    scored = scored_pairs("sid-sony", "sid")
    write_frames("sid-sony", files, frames_of(manifest, {pair.path for pair in scored}))
    return root, files, predict(files, root / "preds", [(pair.path, pair.reference) for pair in scored])


@pytest.mark.parametrize("name", SID_COUNTS)
def test_protocols_of_sid(name: str, sid: tuple[Path, Path, dict[str, NDArray[np.float32]]]) -> None:
    root, files, written = sid
    result = evaluate(root / "preds", "sid-sony", protocol=name, root=root)
    assert len(result.pairs) == SID_COUNTS[name]
    assert_equal_to_the_plain_way(result, files, written)


def test_frames_that_are_too_small_for_a_region(sid: tuple[Path, Path, dict[str, NDArray[np.float32]]]) -> None:
    root, _, _ = sid
    result = evaluate(root / "preds", "sid-sony", protocol="eld-cvpr20", root=root)
    assert (result.scored, len(result.problems), len(result.pairs)) == (0, 45, 45)
    assert "a packed image of 20 x 30 is too small for the region 'centre-512'" in str(result.problems[0])
    combined = evaluate_all(root / "preds", "sid-sony", root=root)
    assert [result.protocol.name for result in combined.results] == [*list(SID_COUNTS)[:3], "led-sid", "lrd-sid"]
    reasons = {one.protocol: one.reason for one in combined.not_scored}
    assert set(reasons) == {"eld-cvpr20", "sid-tpami", "sid-srgb", "sid2018"}
    assert "too small" in reasons["sid-tpami"]
    assert reasons["sid2018"] == "scores renderings in sRGB; the predictions are raw"
    assert not combined.problems


# --- the centre, and sRGB ---------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def large(tmp_path_factory: pytest.TempPathFactory) -> tuple[OwnSet, Path, dict[str, NDArray[np.float32]]]:
    """Two pairs of frames that are larger than the centre of 512 x 512 packed pixels."""
    folder = tmp_path_factory.mktemp("large")
    own = build_own_set(folder, size=(1040, 1066))
    pairs = [(f"s0/x{ratio}.dng", "s0/clean.dng") for ratio in (50, 100)]
    return own, folder / "preds", predict(own.files, folder / "preds", pairs)


@pytest.mark.parametrize("name", ["eld-cvpr20", "sid-tpami"])
def test_the_centre_of_512(name: str, large: tuple[OwnSet, Path, dict[str, NDArray[np.float32]]]) -> None:
    own, preds, written = large
    result = evaluate(preds, manifest=own.manifest, root=own.root, protocol=name)
    assert_equal_to_the_plain_way(result, own.files, written)
    full = evaluate(preds, manifest=own.manifest, root=own.root, protocol="sid")
    assert abs(full.images[0].psnr_db - result.images[0].psnr_db) > 1e-3


def test_raw_predictions_in_srgb(large: tuple[OwnSet, Path, dict[str, NDArray[np.float32]]]) -> None:
    own, preds, written = large
    result = evaluate(preds, manifest=own.manifest, root=own.root, protocol="sid-srgb")
    assert len(result.images) == 2
    for pair, image in zip(result.pairs, result.images, strict=True):
        sensor = read_raw(own.files / pair.reference).sensor  # colour as the file states it, to six decimals
        assert sensor.white_balance is not None
        assert sensor.white_balance == pytest.approx(WHITE_BALANCE, abs=1e-5)
        psnr_db, ssim, factor = plain.score_srgb(
            written[pair.path], own.files / pair.reference, sensor.white_balance, sensor.xyz_to_camera, 512
        )
        assert image.psnr_db == pytest.approx(psnr_db, abs=PSNR_TOLERANCE_DB, rel=0)
        assert image.ssim == pytest.approx(ssim, abs=SSIM_TOLERANCE, rel=0)
        assert image.rescale == pytest.approx(factor, abs=1e-9, rel=0)


@pytest.fixture(scope="module")
def rendered(tmp_path_factory: pytest.TempPathFactory) -> tuple[OwnSet, dict[str, NDArray[np.uint8]]]:
    folder = tmp_path_factory.mktemp("rendered")
    own = build_own_set(folder, scenes=2)
    made = {}
    generator = np.random.default_rng(5)
    for scene in ("s0", "s1"):
        clean = plain.libraw_8_bits(own.files / scene / "clean.dng").astype(np.float64)
        for ratio in (50, 100):
            noisy = np.clip(0.95 * clean + generator.normal(0, 6, clean.shape), 0, 255)
            made[f"{scene}/x{ratio}.dng"] = np.rint(noisy).astype(np.uint8)
    return own, made


@pytest.mark.parametrize("form", ["png8", "npy-last", "npy-first", "npy-uint8"])
def test_renderings_under_sid2018(
    form: str, rendered: tuple[OwnSet, dict[str, NDArray[np.uint8]]], tmp_path: Path
) -> None:
    own, made = rendered
    for path, pixels in made.items():
        target = (tmp_path / path).with_suffix(".png" if form == "png8" else ".npy")
        target.parent.mkdir(parents=True, exist_ok=True)
        if form == "png8":
            Image.fromarray(pixels).save(target)
        else:
            scaled = pixels if form == "npy-uint8" else (pixels / 255).astype(np.float32)
            np.save(target, scaled.transpose(2, 0, 1) if form == "npy-first" else scaled)
    result = evaluate(tmp_path, manifest=own.manifest, root=own.root, protocol="sid2018")
    assert not result.problems
    assert len(result.images) == 4
    for pair, image in zip(result.pairs, result.images, strict=True):
        psnr_db, ssim = plain.score_sid2018(made[pair.path], own.files / pair.reference)
        assert image.psnr_db == pytest.approx(psnr_db, abs=PSNR_TOLERANCE_DB, rel=0)
        assert image.ssim == pytest.approx(ssim, abs=SSIM_TOLERANCE, rel=0)
        assert image.rescale == 1.0
    combined = evaluate_all(tmp_path, manifest=own.manifest, root=own.root)
    assert [one.protocol.name for one in combined.results] == ["sid2018"]
    assert combined.results[0].images == result.images
    assert {one.reason for one in combined.not_scored} == {"scores packed raw; the predictions are sRGB"}


def test_finer_predictions_are_rounded_to_8_bits(
    rendered: tuple[OwnSet, dict[str, NDArray[np.uint8]]], tmp_path: Path
) -> None:
    own, made = rendered
    for path, pixels in made.items():
        (tmp_path / path).parent.mkdir(exist_ok=True)
        np.save((tmp_path / path).with_suffix(".npy"), (pixels + 0.4) / 255)
    result = evaluate(tmp_path, manifest=own.manifest, root=own.root, protocol="sid2018")
    first = result.pairs[0]
    expected = plain.score_sid2018(made[first.path], own.files / first.reference)[0]
    assert result.images[0].psnr_db == pytest.approx(expected, abs=PSNR_TOLERANCE_DB, rel=0)


def test_every_shipped_protocol_is_compared() -> None:
    compared = {*plain.WAYS, "sid2018", "sid-srgb"}
    assert compared == {name for name, protocol in PROTOCOLS.items() if protocol.kind is IMAGES}


# --- the input itself -------------------------------------------------------------------------------------------------


def test_the_input_as_a_baseline(tmp_path: Path) -> None:
    """The row that papers print as "Input": amplified by the files' ratio, clipped before and after."""
    own = build_own_set(tmp_path)
    for name, low in (("eld", 0.0), ("led", -np.inf)):
        result = evaluate(None, manifest=own.manifest, root=own.root, protocol=name, baseline="input")
        way = plain.WAYS[result.protocol.name]
        assert result.provenance["predictions"] == "none: the input itself"
        for pair, image in zip(result.pairs, result.images, strict=True):
            with rawpy.imread(str(own.files / pair.path)) as raw:
                assert raw.raw_pattern is not None
                packed = oracle.pack(raw.raw_image_visible.astype(np.float64), raw.raw_pattern.astype(np.int64))
                black = np.array(raw.black_level_per_channel, np.float64)[:, None, None]
                white = 16383.0 if way.white == "16383" else float(raw.white_level)
            normalised = np.clip(((packed - black) / (white - black)).astype(np.float32), low, 1)
            noisy = np.clip(normalised * np.float32(pair.ratio), low, 1)
            psnr_db, ssim, _ = plain.score(noisy, own.files / pair.reference, way)
            assert image.psnr_db == pytest.approx(psnr_db, abs=1e-5, rel=0)
            assert image.ssim == pytest.approx(ssim, abs=1e-5, rel=0)


def test_levels_per_channel_may_differ_between_channels() -> None:
    from eldata.evaluation.references import normalised_frame
    from eldata.records import RawFrame

    sensor = sensor_of((8, 12))
    mosaic = mosaic_of("x", (8, 12), bright=True)
    whites = (15000.0, 15100.0, 14900.0, 15200.0)
    frame = RawFrame(Path("x"), mosaic, replace(sensor), Exposure(), whites)  # no file is read
    packed = oracle.pack(mosaic.astype(np.float64), sensor.cfa_pattern.astype(np.int64))
    black = np.array(sensor.black_level_dn)[:, None, None]
    expected = (packed - black) / (np.array(whites)[:, None, None] - black)
    for clip, low, high in (("both", 0, 1), ("upper", -np.inf, 1), ("none", -np.inf, np.inf)):
        found = normalised_frame(frame, "metadata-per-channel", clip=clip, gain=3.0)  # type: ignore[arg-type] # one of three
        assert found.dtype == np.float32
        np.testing.assert_allclose(found, np.clip(3 * np.clip(expected, low, high), low, high), rtol=1e-5, atol=1e-6)
