"""Sequences of one's own, a reference for each frame: as data, and scored as film."""

from __future__ import annotations

import json
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import rawpy

from eldata import evaluate
from eldata.cli.main import main
from eldata.datasets import DRVDataset
from eldata.demo.camera import CAMERAS
from eldata.demo.scenes import scene_radiance
from eldata.demo.tree import demo_card
from eldata.errors import ArgumentError
from eldata.evaluation import save_clip_prediction
from eldata.manifest.catalogue import save_manifest
from eldata.metrics import st_rred
from eldata.metrics.st_rred import PEAK_ELD
from eldata.raw.dng import write_dng
from eldata.raw.reading import read_header
from eldata.records import Exposure, FrameRecord
from tests.evaluation import published_code

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

MOMENTS = 4
MANIFEST = "manifests/mine.csv"
SIZE = (256, 384)
# ISO and factor of the frames of a moment: two noisy frames of each setting between two references.
FRAMES = ((100, None), (800, 1), (800, 1), (800, 100), (800, 100), (100, None))


def seen(scene: int, moment: int) -> NDArray[np.float32]:
    """Return what stands before the camera: a striped thing that moves by 17 pixels from moment to moment."""
    picture = scene_radiance(scene, *SIZE).copy()
    rows, columns = np.mgrid[:64, :48]
    left = 20 + 17 * moment
    picture[:, 100:164, left : left + 48] = 0.25 + 0.2 * np.sin(rows / 3) * np.cos(columns / 4)
    return picture


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two sequences of four moments."""
    folder = tmp_path_factory.mktemp("film")
    camera = CAMERAS[0].with_size(*SIZE)
    records = []
    for scene in (1, 2):
        for moment in range(1, MOMENTS + 1):
            name = f"scene-{scene}-moment-{moment}"
            picture = seen(scene, moment)
            for number, (iso, factor) in enumerate(FRAMES, 1):
                path = f"{camera.name}/{name}/IMG_{number:04d}.dng"
                exposure_s = Fraction(4) if factor is None else Fraction(4 * 100, iso * factor)
                record = FrameRecord(
                    path, "reference", camera.name, scene=name, split="test", iso=Fraction(iso), exposure_s=exposure_s
                )
                if factor is not None:
                    reference = f"{camera.name}/{name}/IMG_{1 if number < 4 else 6:04d}.dng"
                    record = replace(record, role="noisy", ratio=Fraction(factor), reference=reference)
                records.append(record)
                generator = np.random.default_rng([5, scene, moment, number])
                mosaic = camera.photograph(picture, exposure_s / 4, iso, generator)
                target = folder / "data" / "Mine" / path
                target.parent.mkdir(parents=True, exist_ok=True)
                write_dng(target, mosaic, camera.sensor, Exposure(Fraction(iso), exposure_s), compression="none")
    card = demo_card("mine", "Film", "Mine", {camera.name: camera.sensor}, records, "simulated")
    (folder / "manifests").mkdir()
    save_manifest(folder / MANIFEST, replace(card, protocol="sequences"), records)
    return folder


def test_sequences_are_scored_as_film(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(made)
    assert main(["verify", MANIFEST, "--root", "data", "--level", "full", "--jobs", "1"]) == 0
    dataset = DRVDataset(made / "data" / "Mine", form="raw", manifest=MANIFEST, window=MOMENTS)
    assert len(dataset) == 2 * 2 * 2  # sequences, factors, repeats
    scores = tmp_path / "scores.json"
    score = ["evaluate", "--manifest", MANIFEST, "--root", "data", "--jobs", "1"]
    assert main([*score, "--baseline", "input", "--json", str(scores)]) == 0
    assert "ST-RRED" in capsys.readouterr().out
    content = json.loads(scores.read_text())
    assert content["protocol"]["name"] == "sequences", "which the card names"
    assert [(row["camera"], row["ratio"], row["videos"]) for row in content["table"]] == [
        ("DemoAlpha", 1.0, 4),
        ("DemoAlpha", 100.0, 4),
        (None, None, 8),
    ]
    videos = {video["scene"]: video for video in content["videos"]}
    assert len(videos) == 8
    assert content["coverage"]["missing"] == []
    for record in dataset.records:
        video = videos[record.scene]
        assert video["frames"] == MOMENTS
        compare_with_the_published_code(video, made / "data" / "Mine", record.frames, record.references)
    by_factor = {f: np.mean([v["st_rred"] for s, v in videos.items() if f"-x{f}" in s]) for f in (1, 100)}
    assert by_factor[1] < by_factor[100]


def compare_with_the_published_code(
    video: dict[str, object], folder: Path, frames: Sequence[str], references: Sequence[str]
) -> None:
    """Each frame with its own reference by the ELD code's metrics, and ST-RRED of the two films."""
    shown, truth, found = [], [], []
    for frame, reference in zip(frames, references, strict=True):
        with rawpy.imread(str(folder / frame)) as dark, rawpy.imread(str(folder / reference)) as bright:
            still = published_code.eld_frame(bright, white=None)
            noisy = published_code.eld_frame(dark, white=None)
        ratio = exposure(folder / reference) / exposure(folder / frame)
        (one,), (corrected,) = published_code.eld_clip(np.clip(noisy * float(ratio), 0, 1)[None], still, correct=True)
        found.append((one.psnr_db, one.ssim))
        shown.append(corrected)
        truth.append(still)
    assert (video["psnr_db"], video["ssim"]) == pytest.approx(tuple(np.mean(found, axis=0)), abs=1e-4)
    grey = (published_code.eld_grey(np.stack(some)) for some in (shown, truth))
    rred = st_rred(*grey, data_range=1.0, peak=PEAK_ELD)
    assert rred.st_rred > 0
    assert video["st_rred"] == pytest.approx(rred.st_rred, rel=1e-3)


def exposure(path: Path) -> Fraction:
    found = read_header(path).exposure
    assert found.iso is not None
    assert found.exposure_s is not None
    return found.iso * found.exposure_s


def test_predictions_of_photographs_are_those_of_the_film(made: Path, tmp_path: Path) -> None:
    """One folder, scored as pairs and as film; each frame's own reference is the perfect prediction."""
    dataset = DRVDataset(
        made / "data" / "Mine", form="raw", manifest=made / MANIFEST, window=MOMENTS, cameras=["DemoAlpha"]
    )
    for record, sample in zip(dataset.records, dataset, strict=True):
        assert sample["input"].shape == sample["target"].shape == (MOMENTS, 4, 128, 192)
        assert len({target.numpy().tobytes() for target in sample["target"]}) == MOMENTS
        for place, path in enumerate(save_clip_prediction(tmp_path, record, sample["target"].numpy())):
            assert path == tmp_path / Path(record.frames[place]).with_suffix(".npy")
            with rawpy.imread(str(made / "data" / "Mine" / record.references[place])) as raw:
                expected = published_code.eld_frame(raw, white=None)
            np.testing.assert_allclose(sample["target"][place].numpy(), expected, atol=1e-6)
    options: dict[str, Any] = {"manifest": made / MANIFEST, "root": made / "data"}
    film_scores = evaluate(tmp_path, **options)
    assert (film_scores.whole.values["st_rred"], film_scores.ssim) == (0.0, 1.0)
    assert np.isinf(film_scores.psnr_db)
    assert len(film_scores.scores) == 8
    of_pairs = evaluate(tmp_path, protocol="raw", **options)
    assert len(of_pairs.scores) == 2 * 2 * 2 * MOMENTS
    clip = "DemoAlpha/scene-2/ISO800-x100"
    some = evaluate(tmp_path, protocol="sequences", ids=[clip], **options)
    assert [video.scene for video in some.scores] == [clip, f"{clip}-2"]
    assert [video.scene for video in evaluate(tmp_path, protocol="sequences", ids=["scene-2"], **options).scores] == [
        f"DemoAlpha/scene-2/ISO800-x{factor}{repeat}" for factor in (1, 100) for repeat in ("", "-2")
    ]


def test_part_of_the_clips(made: Path) -> None:
    folder = made / "data" / "Mine"
    some = DRVDataset(folder, form="raw", manifest=made / MANIFEST, window=2, stride=1, ratios=[100], ids=["scene-1"])
    assert {clip.scene for clip in some.clips} == {f"DemoAlpha/scene-1/ISO800-x100{repeat}" for repeat in ("", "-2")}
    assert len(some) == 2 * (MOMENTS - 1)
    assert [record.start for record in some.records[:3]] == [0, 1, 2]
    assert some.records[1].reference == some.records[1].references[0]
    with pytest.raises(ArgumentError, match="no clip has scene scene-3; known are DemoAlpha/scene-1/ISO800-x1"):
        DRVDataset(folder, form="raw", manifest=made / MANIFEST, ids=["scene-3"])
