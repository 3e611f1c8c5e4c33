"""The evaluation of clips against the published code's way (``published_code``), and ST-RRED of those clips."""

from __future__ import annotations

import json
import math
import shutil
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import rawpy

from eldata.datasets.published import DRVDataset
from eldata.errors import ArgumentError, DatasetError
from eldata.evaluation import EvaluationResult, evaluate, save_clip_prediction
from eldata.manifest.layouts import scan_raw
from eldata.metrics import PEAK_ELD, st_rred
from eldata.raw.levels import unpack
from tests.drv_tree import SENSOR, SmallDrv, generator_of, rgb_frame_of, small_drv, still_of, write_png, write_raw_clip
from tests.evaluation import published_code
from tests.raw.helpers import BAYER

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from numpy.typing import NDArray

CLIPS = ("0007", "0013")
IDS = list(CLIPS)
SCORED = range(5, 10)  # frames numbered from 1
SIZE = (48, 56)


@pytest.fixture(scope="module")
def drv(tmp_path_factory: pytest.TempPathFactory) -> SmallDrv:
    return small_drv(tmp_path_factory.mktemp("drv"), (*CLIPS, "M0003"), 12, size=SIZE)


def predicted(clip: str, number: int) -> NDArray[np.float32]:
    """A prediction as a network would make it: too bright, somewhat noisy, in places beyond [0, 1]."""
    still = still_of(clip, SIZE).transpose(2, 0, 1) / 65535
    noisy = rgb_frame_of(clip, number, SIZE).transpose(2, 0, 1) / 65535
    frame = 1.1 * (0.8 * still + 0.2 * noisy) + generator_of(f"{clip}-{number}").normal(0, 0.005, still.shape)
    frame[:, 3:5, 7:9] = 1.2
    frame[:, 9:11, 2:5] = -0.1
    return frame.astype(np.float32)


@pytest.fixture(scope="module")
def predictions(drv: SmallDrv, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("preds")
    dataset = DRVDataset(drv.data, split="test", frames="evaluation", manifest=drv.csv)
    for record in dataset.records:
        frames = np.stack([predicted(record.scene, number) for number in SCORED])
        written = save_clip_prediction(folder, record, frames)
        assert [path.relative_to(folder).as_posix() for path in written] == [
            f"{record.scene}/{number:04d}.npy" for number in SCORED
        ]
    return folder


def score(drv: SmallDrv, predictions: Path, **options: Any) -> EvaluationResult:
    return evaluate(predictions, manifest=drv.csv, root=drv.root, **{"ids": IDS} | options)


@pytest.fixture(scope="module")
def result(drv: SmallDrv, predictions: Path) -> EvaluationResult:
    return score(drv, predictions)


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
        clip, repeated = published_code.eld_grey(shown), published_code.eld_grey(np.stack([still] * len(shown)))
        rred = st_rred(clip, repeated, data_range=1.0, peak=PEAK_ELD)
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
    assert [video.scene for video in result.scores] == IDS
    assert (result.psnr_db, result.ssim, result.whole.values["st_rred"]) == pytest.approx(np.mean(means, axis=0))


@pytest.mark.parametrize("protocol", ["drv-rgb", "drv-rgb-uncorrected"])
def test_rgb_scores_are_those_of_the_published_code(protocol: str, drv: SmallDrv, predictions: Path) -> None:
    check_against_the_published_code(
        score(drv, predictions, protocol=protocol),
        lambda clip: np.stack([predicted(clip, number) for number in SCORED]),
        lambda clip: still_of(clip, SIZE).transpose(2, 0, 1).astype(np.float32) / np.float32(65535),
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


def test_a_perfect_prediction(drv: SmallDrv, tmp_path: Path) -> None:
    for clip in CLIPS:
        for number in SCORED:
            write_png(tmp_path / clip / f"{number:04d}.png", still_of(clip, SIZE))
    found = score(drv, tmp_path, protocol="drv-rgb-uncorrected")
    assert (found.psnr_db, found.ssim, found.whole.values["st_rred"]) == (math.inf, 1.0, 0.0)
    assert any("equals the reference exactly: 2 videos" in note for note in found.notes)
    assert json.loads(json.dumps(found.as_dict(), allow_nan=False))["table"][0]["psnr_db"] == "inf"


# --- coverage and problems --------------------------------------------------------------------------------------------


@pytest.fixture
def own(predictions: Path, tmp_path: Path) -> Path:
    shutil.copytree(predictions, tmp_path / "preds")
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
    assert "1 of 2" in rest.format_table()
    assert "INCOMPLETE: 1 videos" in rest.format_text()


def test_a_damaged_dataset_stops_the_evaluation(drv: SmallDrv, predictions: Path, tmp_path: Path) -> None:
    shutil.copytree(drv.csv.parent.parent, tmp_path / "tree")
    copy = SmallDrv(tmp_path / "tree/manifests/drv.csv", tmp_path / "tree/data")
    frame = copy.data / "VBM4D_rawRGB/0007/0006.png"
    content = frame.read_bytes()
    frame.write_bytes(content[:100])
    with pytest.raises(DatasetError, match=r"not what its manifest says: .*0006\.png"):
        score(copy, predictions)
    frame.write_bytes(content)
    (copy.data / "VBM4D_rawRGB/0007/0002.png").unlink()  # not scored, but it would shift those that are
    with pytest.raises(DatasetError, match="without a gap"):
        score(copy, predictions)
    shutil.rmtree(copy.root)
    with pytest.raises(DatasetError, match=r"the dataset is not there.*github\.com"):
        score(copy, predictions)


# --- names ------------------------------------------------------------------------------------------------------------


def test_unknown_names_list_the_known(drv: SmallDrv, predictions: Path) -> None:
    with pytest.raises(ArgumentError, match=r"'drv-rgb' scores videos, and 'eld' is a dataset of images; its protoc"):
        evaluate(predictions, "eld", protocol="drv-rgb")
    with pytest.raises(ArgumentError, match=r"'eld' scores images, .*; its protocols are drv-rgb, drv-rgb-uncorrected"):
        score(drv, predictions, protocol="eld")
    with pytest.raises(ArgumentError, match="'drv-raw' is for dataset 'drv-raw', not 'drv'"):
        score(drv, predictions, protocol="drv-raw")
    with pytest.raises(ArgumentError, match=r"give camera values as a list: \['SonyRX100M6'\]"):
        score(drv, predictions, cameras="SonyRX100M6")
    with pytest.raises(TypeError, match=r"unexpected keyword argument 'camera'"):
        score(drv, predictions, camera=["SonyRX100M6"])
    with pytest.raises(ArgumentError, match="its card names no subset"):
        score(drv, predictions, ids=None)


# --- mistakes ---------------------------------------------------------------------------------------------------------


MISTAKES: dict[str, tuple[Callable[[NDArray[np.float32]], NDArray[np.float32]], str]] = {
    "the other order of colours": (lambda frame: frame[::-1], "as if in the order B, G, R"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_mistakes_in_clips_are_named(mistake: str, drv: SmallDrv, result: EvaluationResult, tmp_path: Path) -> None:
    """Frames of a clip are looked at as images are."""
    assert result.suspicions == ()
    change, words = MISTAKES[mistake]
    for clip in CLIPS:
        (tmp_path / clip).mkdir()
        for number in SCORED:
            np.save(tmp_path / clip / f"{number:04d}.npy", change(predicted(clip, number)))
    (found,) = score(drv, tmp_path).suspicions
    assert (found.words, found.shown, found.looked) == (words, found.looked, found.looked)
