"""Clips against the published code's way (``published_code``), with ST-RRED: DRV's, and sequences of one's own."""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rawpy
from numpy.typing import NDArray

from eldata.cli.main import main
from eldata.datasets import DRVDataset
from eldata.demo.camera import CAMERAS
from eldata.demo.scenes import scene_radiance
from eldata.demo.tree import demo_card, write_shot
from eldata.errors import ArgumentError, DatasetError
from eldata.evaluation import EvaluationResult, evaluate, save_clip_prediction
from eldata.manifest.catalogue import save_manifest
from eldata.manifest.layouts import scan_raw
from eldata.metrics import PEAK_ELD, st_rred
from eldata.raw.levels import unpack
from eldata.records import FrameRecord
from tests.drv_tree import SENSOR, SmallDrv, generator_of, still_of, write_raw_clip
from tests.evaluation import published_code
from tests.evaluation.helpers import CLIPS, SCORED_FRAMES, predicted_clip, predicted_frame
from tests.raw.helpers import BAYER

IDS = list(CLIPS)


def score(drv: SmallDrv, predictions: Path | None = None, **options: Any) -> EvaluationResult:
    return evaluate(predictions or drv.root / "preds", manifest=drv.csv, root=drv.root, **{"ids": IDS} | options)


@pytest.fixture(scope="module")
def result(drv: SmallDrv) -> EvaluationResult:
    return score(drv)


# --- the numbers ------------------------------------------------------------------------------------------------------


def check_against_the_published_code(
    result: EvaluationResult,
    frames_of: Callable[[str], NDArray[np.float32]],
    still_in: Callable[[str], NDArray[np.float32]],
) -> None:
    """Correction, PSNR and SSIM frame by frame, means, ST-RRED of whole clips; averages over videos."""
    means = []
    correct = published_code.CLIPS[result.protocol.name]
    for video in result.scores:
        still = still_in(video.scene)
        scores, shown = published_code.eld_clip(frames_of(video.scene), still, correct=correct)
        films = (published_code.eld_grey(film) for film in (shown, np.broadcast_to(still, shown.shape)))
        rred = st_rred(*films, data_range=1.0, peak=PEAK_ELD)
        found = np.array([(frame.psnr_db, frame.ssim, frame.rescale) for frame in video.frames])
        expected = np.array([(one.psnr_db, one.ssim, one.factor if correct else 1.0) for one in scores])
        largest = np.abs(found - expected).max(axis=0)
        print(f"{result.protocol.name}: {len(scores)} frames, largest differences {largest}")
        assert np.all(largest <= 1e-6)
        # The corrected frames are rounded to float32 before ST-RRED is taken.
        assert video.values["st_rred"] == pytest.approx(rred.st_rred, rel=1e-4)
        assert (video.values["spatial_rred"], video.values["temporal_rred"]) == pytest.approx(
            (rred.spatial, rred.temporal), rel=1e-4
        )
        assert (video.psnr_db, video.ssim) == pytest.approx(tuple(expected[:, :2].mean(axis=0)))
        assert video.values["st_rred"] > 0
        means.append((video.psnr_db, video.ssim, video.values["st_rred"]))
    assert len(result.scores) == len(result.units) > 1
    assert (result.psnr_db, result.ssim, result.whole.values["st_rred"]) == pytest.approx(np.mean(means, axis=0))


@pytest.mark.parametrize("protocol", ["drv-rgb", "drv-rgb-uncorrected"])
def test_rgb_scores_are_those_of_the_published_code(protocol: str, drv: SmallDrv) -> None:
    check_against_the_published_code(
        score(drv, protocol=protocol),
        predicted_clip,
        lambda clip: still_of(clip).transpose(2, 0, 1).astype(np.float32) / np.float32(65535),
    )


@pytest.mark.parametrize("phases", [("RGGB", "GRBG"), ("BGGR", "GBRG")])
def test_raw_scores_are_those_of_the_published_code(phases: tuple[str, str], tmp_path: Path) -> None:
    sensors = {clip: replace(SENSOR, cfa=BAYER[phase]) for clip, phase in zip(CLIPS, phases, strict=True)}
    for clip, sensor in sensors.items():
        write_raw_clip(tmp_path / "DRV", clip, 12, sensor=sensor)
    manifest = scan_raw(tmp_path / "DRV").save(tmp_path / "drv-raw.csv")
    dataset = DRVDataset(tmp_path / "DRV", form="raw", split="test", frames="evaluation")
    stills, frames = {}, {}
    for record in dataset.records:
        with rawpy.imread(str(tmp_path / f"DRV/long/{record.scene}/DSC00001.ARW")) as raw:
            still = published_code.eld_frame(raw, white=None)  # the paper is silent on levels: they are the file's
        noise = generator_of(record.scene).normal(0, 0.02, (5, *still.shape))
        stills[record.scene] = still
        frames[record.scene] = (0.9 * still + noise).astype(np.float32)
        save_clip_prediction(tmp_path / "preds", record, frames[record.scene])
    for protocol in ("drv-raw", "drv-raw-uncorrected"):
        result = evaluate(tmp_path / "preds", protocol=protocol, manifest=manifest.path, root=tmp_path, ids=IDS)
        check_against_the_published_code(result, lambda clip: frames[clip], lambda clip: stills[clip])
    # A mosaic scores as the packed prediction does.
    for path in sorted((tmp_path / "preds").rglob("*.npy")):
        np.save(path, unpack(np.load(path), sensors[path.parent.name].cfa))
    mosaics = evaluate(tmp_path / "preds", protocol=protocol, manifest=manifest.path, root=tmp_path, ids=IDS)
    assert mosaics.scores == result.scores


# --- coverage and problems --------------------------------------------------------------------------------------------


@pytest.fixture
def own(drv: SmallDrv, tmp_path: Path) -> Path:
    shutil.copytree(drv.root / "preds", tmp_path / "preds")
    return tmp_path / "preds"


def test_a_video_needs_all_of_its_frames(drv: SmallDrv, own: Path, result: EvaluationResult) -> None:
    assert result.provenance["layout"].startswith("noisy VBM4D_rawRGB/<clip>/<n>.png: 2 clips, 24 files")
    assert [len(video.frames) for video in result.scores] == [5, 5]
    (own / "0007/0006.npy").unlink()
    found = score(drv, own)
    assert [problem.path for problem in found.problems] == ["0007/0006.png"]
    assert found.scores == ()
    assert "nothing was scored" in found.format_text()
    rest = score(drv, own, allow_missing=True)
    assert rest.scores == result.scores[1:]
    assert rest.missing == ("0007",)
    assert "1 of 2" in rest.format_text()
    assert "INCOMPLETE: 1 videos" in rest.format_text()


def test_a_damaged_dataset_stops_the_evaluation(drv: SmallDrv, tmp_path: Path) -> None:
    shutil.copytree(drv.csv.parent.parent, tmp_path / "tree")
    copy = SmallDrv(tmp_path / "tree/manifests/drv.csv", tmp_path / "tree/data")
    frame = copy.data / "VBM4D_rawRGB/0007/0006.png"
    content = frame.read_bytes()
    frame.write_bytes(content[:100])
    with pytest.raises(DatasetError, match=r"not what its manifest says: .*0006\.png"):
        score(copy, drv.root / "preds")
    frame.write_bytes(content)
    (copy.data / "VBM4D_rawRGB/0007/0002.png").unlink()  # not scored, but it would shift those that are
    with pytest.raises(DatasetError, match="without a gap"):
        score(copy, drv.root / "preds")
    shutil.rmtree(copy.root)
    with pytest.raises(DatasetError, match=r"the dataset is not there.*github\.com"):
        score(copy, drv.root / "preds")


# --- names ------------------------------------------------------------------------------------------------------------


def test_unknown_names_list_the_known(drv: SmallDrv) -> None:
    with pytest.raises(ArgumentError, match=r"'drv-rgb' scores videos, and 'eld' is a dataset of images; its protoc"):
        evaluate(drv.root / "preds", "eld", protocol="drv-rgb")
    with pytest.raises(ArgumentError, match=r"'eld' scores images, .*; its protocols are drv-rgb, drv-rgb-uncorrected"):
        score(drv, protocol="eld")
    with pytest.raises(ArgumentError, match="'drv-raw' is for dataset 'drv-raw', not 'drv'"):
        score(drv, protocol="drv-raw")
    with pytest.raises(TypeError, match=r"unexpected keyword argument 'camera'"):
        score(drv, camera=["SonyRX100M6"])
    with pytest.raises(ArgumentError, match="its card names no subset"):
        score(drv, ids=None)


# --- mistakes ---------------------------------------------------------------------------------------------------------


def test_mistakes_in_clips_are_named(drv: SmallDrv, result: EvaluationResult, tmp_path: Path) -> None:
    """Frames of a clip are looked at as images are; here the colours are in the other order."""
    assert result.suspicions == ()
    for clip in CLIPS:
        (tmp_path / clip).mkdir()
        for number in SCORED_FRAMES:
            np.save(tmp_path / clip / f"{number:04d}.npy", predicted_frame(clip, number)[::-1])
    (found,) = score(drv, tmp_path).suspicions
    assert (found.words, found.shown, found.looked) == ("as if in the order B, G, R", 2, 2)


# --- sequences of one's own, a reference for each frame: as data, and scored as film ----------------------------------


MOMENTS = 4
MANIFEST = "manifests/mine.csv"
SIZE = (256, 384)
# ISO and factor of the frames of a moment: two noisy frames of each setting between two references.
FRAMES = ((100, None), (800, 1), (800, 1), (800, 100), (800, 100), (100, None))


def picture_of(scene: int, moment: int) -> NDArray[np.float32]:
    """Return what stands before the camera: a striped thing that moves by 17 pixels from moment to moment."""
    picture = scene_radiance(scene, *SIZE).copy()
    rows, columns = np.mgrid[:64, :48]
    left = 20 + 17 * moment
    picture[:, 100:164, left : left + 48] = 0.25 + 0.2 * np.sin(rows / 3) * np.cos(columns / 4)
    return picture


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two sequences of four moments."""
    folder = tmp_path_factory.mktemp("film")
    camera = CAMERAS[0].with_size(*SIZE)
    records = []
    for scene in (1, 2):
        for moment in range(1, MOMENTS + 1):
            name = f"scene-{scene}-moment-{moment}"
            picture = picture_of(scene, moment)
            for number, (iso, factor) in enumerate(FRAMES, 1):
                path = f"{camera.name}/{name}/IMG_{number:04d}.dng"
                exposure_s = Fraction(4) if factor is None else Fraction(4 * 100, iso * factor)
                more: dict[str, Any] = {"role": "reference"}
                if factor is not None:
                    reference = f"{camera.name}/{name}/IMG_{1 if number < 4 else 6:04d}.dng"
                    more = {"role": "noisy", "ratio": Fraction(factor), "reference": reference}
                about: dict[str, Any] = {"camera": camera.name, "scene": name, "split": "test", "iso": Fraction(iso)}
                records.append(FrameRecord(path, exposure_s=exposure_s, **about, **more))
                generator = np.random.default_rng([5, scene, moment, number])
                mosaic = camera.photograph(picture, exposure_s / 4, iso, generator)
                write_shot(folder / "data" / "Mine" / path, mosaic, camera.sensor, Fraction(iso), exposure_s)
    card = demo_card("mine", "Film", "Mine", {camera.name: camera.sensor}, records, "simulated")
    (folder / "manifests").mkdir()
    save_manifest(folder / MANIFEST, replace(card, protocol="sequences"), records)
    return folder


def test_sequences_are_scored_as_film(film: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each frame with its own reference by the ELD code's metrics, and ST-RRED of the two films."""
    monkeypatch.chdir(film)
    assert main(["verify", MANIFEST, "--root", "data", "--level", "full", "--jobs", "1"]) == 0
    folder = film / "data" / "Mine"
    dataset = DRVDataset(folder, form="raw", manifest=MANIFEST, window=MOMENTS)
    assert len(dataset) == 2 * 2 * 2  # sequences, factors, repeats
    result = evaluate(None, manifest=MANIFEST, root="data", baseline="input")
    assert result.protocol.name == "sequences", "which the card names"
    rows = [(row.camera, row.ratio, row.pairs) for row in result.table]
    assert rows == [("DemoAlpha", 1.0, 4), ("DemoAlpha", 100.0, 4), (None, None, 8)]
    records = {record.scene: record for record in dataset.records}

    def decoded(path: str) -> NDArray[np.float32]:
        with rawpy.imread(str(folder / path)) as raw:
            return published_code.eld_frame(raw, white=None)

    def amplified(scene: str) -> NDArray[np.float32]:
        frames = zip(records[scene].frames, records[scene].references, strict=True)
        ratios = [(one, published_code.ratio_by_exif(folder / one, folder / reference)) for one, reference in frames]
        return np.stack([np.clip(decoded(frame) * np.float32(ratio), 0, 1) for frame, ratio in ratios])

    check_against_the_published_code(
        result, amplified, lambda scene: np.stack([decoded(path) for path in records[scene].references])
    )
    by_factor = {f: np.mean([v.values["st_rred"] for v in result.scores if f"-x{f}" in v.scene]) for f in (1, 100)}
    assert by_factor[1] < by_factor[100]


def test_predictions_of_photographs_are_those_of_the_film(film: Path, tmp_path: Path) -> None:
    """One folder, scored as pairs and as film; each frame's own reference is the perfect prediction."""
    dataset = DRVDataset(
        film / "data" / "Mine", form="raw", manifest=film / MANIFEST, window=MOMENTS, cameras=["DemoAlpha"]
    )
    for record, sample in zip(dataset.records, dataset, strict=True):
        assert sample["input"].shape == sample["target"].shape == (MOMENTS, 4, 128, 192)
        assert len({target.numpy().tobytes() for target in sample["target"]}) == MOMENTS
        for place, path in enumerate(save_clip_prediction(tmp_path, record, sample["target"].numpy())):
            assert path == tmp_path / Path(record.frames[place]).with_suffix(".npy")
            with rawpy.imread(str(film / "data" / "Mine" / record.references[place])) as raw:
                expected = published_code.eld_frame(raw, white=None)
            np.testing.assert_allclose(sample["target"][place].numpy(), expected, atol=1e-6)
    options: dict[str, Any] = {"manifest": film / MANIFEST, "root": film / "data"}
    film_scores = evaluate(tmp_path, **options)
    assert (film_scores.psnr_db, film_scores.ssim, film_scores.whole.values["st_rred"]) == (math.inf, 1.0, 0.0)
    assert any("equals the reference exactly: 8 videos" in note for note in film_scores.notes)
    assert json.loads(json.dumps(film_scores.as_dict(), allow_nan=False))["table"][0]["psnr_db"] == "inf"
    assert len(film_scores.scores) == 8
    of_pairs = evaluate(tmp_path, protocol="raw", **options)
    assert len(of_pairs.scores) == 2 * 2 * 2 * MOMENTS
    clip = "DemoAlpha/scene-2/ISO800-x100"
    some = evaluate(tmp_path, protocol="sequences", ids=[clip], **options)
    assert [video.scene for video in some.scores] == [clip, f"{clip}-2"]
    assert [video.scene for video in evaluate(tmp_path, protocol="sequences", ids=["scene-2"], **options).scores] == [
        f"DemoAlpha/scene-2/ISO800-x{factor}{repeat}" for factor in (1, 100) for repeat in ("", "-2")
    ]


def test_part_of_the_clips(film: Path) -> None:
    folder = film / "data" / "Mine"
    some = DRVDataset(folder, form="raw", manifest=film / MANIFEST, window=2, stride=1, ratios=[100], ids=["scene-1"])
    assert {clip.scene for clip in some.clips} == {f"DemoAlpha/scene-1/ISO800-x100{repeat}" for repeat in ("", "-2")}
    assert len(some) == 2 * (MOMENTS - 1)
    assert [record.start for record in some.records[:3]] == [0, 1, 2]
    assert some.records[1].reference == some.records[1].references[0]
    with pytest.raises(ArgumentError, match="no clip has scene scene-3; known are DemoAlpha/scene-1/ISO800-x1"):
        DRVDataset(folder, form="raw", manifest=film / MANIFEST, ids=["scene-3"])
