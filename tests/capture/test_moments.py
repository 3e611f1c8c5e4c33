"""Video sets, moment by moment: from the plan to ST-RRED, and what goes wrong between two moments."""

from __future__ import annotations

import json
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import rawpy

from capture.capture_errors import PlanError
from capture.check import check
from capture.checklist import FORMATS, load_progress
from capture.cli import main as capture
from capture.matching import match
from capture.observed import observe
from capture.plan import Plan
from capture.shots import MOVE_S, duration_of
from eldata import evaluate
from eldata.cli.main import main as eldata
from eldata.datasets import DRVDataset
from eldata.errors import ArgumentError, DatasetError
from eldata.evaluation import save_clip_prediction
from eldata.manifest import load_manifest
from eldata.metrics import st_rred
from eldata.metrics.st_rred import PEAK_ELD
from tests.capture.films import film, film_plan, made_set, seen, shifted
from tests.capture.test_checklist import written
from tests.capture.test_progress import ticked
from tests.evaluation import published_code

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from capture.check.result import CheckedGroup, CheckReport

MOMENTS = 4
MANIFEST = "manifests/mine.csv"


def names(*moments: int, scene: int = 1) -> list[str]:
    return [f"scene-{scene}-moment-{moment}" for moment in moments]


# --- from plan to score -----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two sequences of four moments, two noisy frames of each setting, planned on the command line."""
    folder = tmp_path_factory.mktemp("film")
    film_plan(1).camera.save(folder / "cam.json")
    line = "--scenes 2 --metered 4 --isos 800 --factors 1 100 --moments 4 --repeats 2"
    assert capture(["plan", "--camera", str(folder / "cam.json"), *line.split(), "-o", str(folder / "plan.json")]) == 0
    film(folder / "card", Plan.load(folder / "plan.json"))
    made_set(folder, Plan.load(folder / "plan.json"))
    return folder


def test_from_plan_to_st_rred(
    made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(made)
    assert eldata(["verify", MANIFEST, "--root", "data", "--level", "full", "--jobs", "1"]) == 0
    dataset = DRVDataset(made / "data" / "Mine", form="raw", manifest=MANIFEST, window=MOMENTS)
    assert len(dataset) == 2 * 2 * 2  # sequences, factors, repeats
    scores = tmp_path / "scores.json"
    score = ["evaluate", "--manifest", MANIFEST, "--root", "data", "--jobs", "1"]
    assert eldata([*score, "--baseline", "input", "--json", str(scores)]) == 0
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
        compare_with_the_published_code(video, made / "data" / "Mine", record.paths, record.references)
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
    from eldata.raw.reading import read_header

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
            assert path == tmp_path / Path(record.paths[place]).with_suffix(".npy")
            with rawpy.imread(str(made / "data" / "Mine" / record.references[place])) as raw:
                expected = published_code.eld_frame(raw, white=None)
            np.testing.assert_allclose(sample["target"][place].numpy(), expected, atol=1e-6)
    options: dict[str, Any] = {"manifest": made / MANIFEST, "root": made / "data"}
    film_scores = evaluate(tmp_path, **options)
    assert (film_scores.st_rred, film_scores.ssim) == (0.0, 1.0)
    assert np.isinf(film_scores.psnr_db)
    assert len(film_scores.videos) == 8
    of_pairs = evaluate(tmp_path, protocol="raw", **options)
    assert len(of_pairs.images) == 2 * 2 * 2 * MOMENTS
    clip = "DemoAlpha/scene-2/ISO800-x100"
    some = evaluate(tmp_path, protocol="sequences", ids=[clip], **options)
    assert [video.scene for video in some.videos] == [clip, f"{clip}-2"]
    assert [video.scene for video in evaluate(tmp_path, protocol="sequences", ids=["scene-2"], **options).videos] == [
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


# --- between two moments ----------------------------------------------------------------------------------------------


Mishap = Callable[[str, "NDArray[np.float32]"], "NDArray[np.float32]"]


def from_the_third(change: Callable[[NDArray[np.float32]], NDArray[np.float32]]) -> Mishap:
    """What happens between moments 2 and 3, and stays."""
    return lambda name, picture: picture if name < "scene-1-moment-3" else change(picture)


def checked(folder: Path, mishap: Mishap, moments: int = MOMENTS) -> CheckReport:
    plan = film_plan(moments)
    film(folder / "card", plan, mishap=mishap)
    return check(made_set(folder, plan), folder / "data")


def reasons(group: CheckedGroup) -> str:
    return " ".join(map(str, group.reasons))


def verdicts(report: CheckReport) -> dict[str, str]:
    return {group.name.rpartition("-")[2]: group.verdict for group in report.groups}


def test_a_clean_sequence_is_kept(tmp_path: Path) -> None:
    report = checked(tmp_path, lambda _, picture: picture)
    assert report.ok, report.format_text()
    found = {one.path: one for group in report.groups for one in group.measures if one.name == "moment shift"}
    assert len(found) == MOMENTS - 1
    assert all(one.value < 0.05 for one in found.values())
    assert "distance from moment 3 (IMG_0004.dng)" in found["DemoAlpha/scene-1-moment-4/IMG_0001.dng"].text


@pytest.mark.parametrize(("pixels", "verdict"), [(0.3, "look"), (1.0, "shoot again")])
def test_the_camera_moved_between_moments(pixels: float, verdict: str, tmp_path: Path) -> None:
    report = checked(tmp_path, from_the_third(shifted(pixels)))
    assert verdicts(report) == {"1": "keep", "2": "keep", "3": verdict, "4": "keep"}, report.format_text()
    (measure,) = [one for one in report.groups[2].measures if one.name == "moment shift"]
    assert abs(measure.value - pixels) < 0.1
    assert "moment shift: distance from moment 2 (IMG_0004.dng)" in reasons(report.groups[2])
    assert "the camera moved between the moments, or what moves fills half" in reasons(report.groups[2])


@pytest.mark.parametrize(("factor", "verdict"), [(1.01, "look"), (0.97, "shoot again")])
def test_the_light_changed_between_moments(factor: float, verdict: str, tmp_path: Path) -> None:
    report = checked(tmp_path, from_the_third(lambda picture: picture * np.float32(factor)))
    assert verdicts(report) == {"1": "keep", "2": "keep", "3": verdict, "4": "keep"}, report.format_text()
    assert "since moment 2 (IMG_0004.dng)" in reasons(report.groups[2])
    (measure,) = [one for one in report.groups[2].measures if one.name == "moment drift"]
    assert abs(measure.value - 100 * (factor - 1)) < 0.3


def test_nothing_moved(tmp_path: Path) -> None:
    report = checked(tmp_path, lambda name, picture: seen(1, 2) if name.endswith("3") else picture)
    assert verdicts(report) == {"1": "keep", "2": "keep", "3": "look", "4": "keep"}, report.format_text()
    assert "nothing moved since moment 2 (IMG_0004.dng): 0 % of the picture changed" in reasons(report.groups[2])


def test_what_goes_wrong_within_a_moment_is_of_that_moment(tmp_path: Path) -> None:
    """A scene's checks are those of each moment: the light of the third moment changes after its first frame."""
    plan = film_plan(3)
    film(tmp_path / "card", plan)
    brighter = film(tmp_path / "bright", plan, mishap=lambda _, picture: picture * np.float32(1.2))
    number = 2 * 4 + 4  # the third moment's last reference
    (brighter / f"DSC{number:05d}.dng").replace(tmp_path / "card" / f"DSC{number:05d}.dng")
    report = check(made_set(tmp_path, plan), tmp_path / "data")
    assert verdicts(report) == {"1": "keep", "2": "keep", "3": "shoot again"}, report.format_text()


# --- cards ------------------------------------------------------------------------------------------------------------


def test_a_moment_that_was_skipped(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The checklist knows which; without it the last one is called missing, and that this is a guess is said."""
    plan = film_plan(MOMENTS)
    film(tmp_path / "card", plan, names(1, 2, 4))
    observed = observe(sorted((tmp_path / "card").iterdir()), plan.camera.models)
    guessed = match(plan, observed)
    assert {remark.scene for remark in guessed.missing} == {"scene-1-moment-4"}
    assert any(remark.kind == "ambiguous" and "3 of these 4 were found" in remark.text for remark in guessed.remarks)
    content = ticked(plan)
    for shot in content["scenes"][2]["shots"]:
        shot["taken_at"] = None
    progress = written(content, tmp_path)
    manifest = made_set(tmp_path, plan, "--progress", str(progress), "--yes")
    assert "scene-1-moment-3: none of its 4 frames; not ticked on the checklist either" in capsys.readouterr().out
    scenes = {row.scene for row in load_manifest(manifest).records}
    assert scenes == {*names(1, 2, 4)}
    report = check(manifest, tmp_path / "data")
    assert verdicts(report) == {"1": "keep", "2": "keep", "4": "look"}
    assert "moment 3 is missing: it is compared with moment 2" in reasons(report.groups[2])
    with pytest.raises(DatasetError, match=r"clip DemoAlpha/scene-1/ISO800-x1: has no 3 continuous frames"):
        evaluate(None, baseline="input", protocol="sequences", manifest=manifest, root=tmp_path / "data")
    # The missing one comes later: another card joins the set.
    again = film(tmp_path / "night-2", plan, names(3))
    arguments = ["manifest", str(tmp_path / "plan.json"), str(again), "-o", str(manifest), "--append", "--jobs", "1"]
    assert capture([*arguments, "--copy-to", str(tmp_path / "data" / "Mine")]) == 0
    assert verdicts(check(manifest, tmp_path / "data")) == dict.fromkeys("1234", "keep")


def test_a_moment_that_was_taken_twice(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plan = film_plan(MOMENTS)
    film(tmp_path / "card", plan, names(1, 2, 3, 3, 4))
    manifest = made_set(tmp_path, plan, "--yes")
    output = capsys.readouterr().out
    assert "5 such series were found for 4: left out as a first attempt: DSC00001.dng to DSC00004.dng" in output
    report = check(manifest, tmp_path / "data")
    assert verdicts(report) == {"1": "keep", "2": "keep", "3": "look", "4": "keep"}
    assert "or this moment taken twice?" in reasons(report.groups[2])


def test_scenes_and_moments_on_one_card(tmp_path: Path) -> None:
    """Two sequences; --only and --scene take one, or one moment."""
    plan = film_plan(2, scenes=2)
    film(tmp_path / "card", plan)
    manifest = made_set(tmp_path, plan)
    text = manifest.with_suffix(".json").read_text()
    assert "2 scenes taken with DemoAlpha" in text
    assert "2 moments of each scene" in text
    assert [group.name for group in check(manifest, tmp_path / "data", scenes=["2"]).groups] == [
        f"DemoAlpha {name}" for name in names(1, 2, scene=2)
    ]
    (group,) = check(manifest, tmp_path / "data", scenes=names(2, scene=2)).groups
    assert group.verdict == "keep"
    assert plan.only(["scene-2"]).scenes == plan.scenes[2:]
    assert plan.only(names(2)).scenes == plan.scenes[1:2]


# --- plan and lists ---------------------------------------------------------------------------------------------------


def test_a_plan_of_moments(tmp_path: Path) -> None:
    plan = film_plan(3, scenes=2)
    assert [scene.name for scene in plan.scenes] == [*names(1, 2, 3), *names(1, 2, 3, scene=2)]
    assert len(plan.shots) == 2 * 3 * 4
    alone = duration_of([shot for _, shot in plan.shots])
    assert plan.duration.total_s == alone.total_s + 4 * MOVE_S
    assert "4 changes between moments at 20 s" in str(plan.duration)
    plan.save(tmp_path / "plan.json")
    assert Plan.load(tmp_path / "plan.json") == plan
    for name in ("scene-2", "scene-2-moment-2"):
        metered = plan.remeter(name, Fraction(2))
        assert [scene.metered_s for scene in metered.scenes] == [4, 4, 4, 2, 2, 2]
        assert metered.scenes[4].shots == metered.scenes[3].shots != plan.scenes[3].shots
    noted = plan.add_note("scene-1", "toys").add_note("scene-1-moment-2", "upside down")
    assert [scene.notes for scene in noted.scenes[:3]] == [("toys",), ("upside down",), ()]
    assert {scene.aperture for scene in plan.set_aperture("scene-1", Fraction(8)).scenes[:3]} == {Fraction(8)}
    assert len(plan.add_scene("scene-7", Fraction(1)).scenes) == 9


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"scenes": "scene-1"}, "the protocol has moments 1 to 3, such as scene-1-moment-1; found scene-1"),
        (
            {"scenes": "scene-1-moment-4"},
            "has moments 1 to 3, such as scene-1-moment-1; found scene-1-moment-4",
        ),
        ({"metered_s": "2"}, "a sequence has one metered time"),
        ({"moments": 1}, "the protocol has no moments; found scene-1-moment-1"),
        ({"moments": 0}, "moments: expected"),
        ({"moments": 100}, "moments must be at most 99, found 100"),
    ],
)
def test_a_plan_s_file_that_contradicts_itself(change: dict[str, object], words: str, tmp_path: Path) -> None:
    content = film_plan(3).as_dict()
    if "scenes" in change:
        content["scenes"][2]["name"] = change["scenes"]
    elif "moments" in change:
        content["protocol"] |= change
    else:
        content["scenes"][2] |= film_plan(3).remeter("scene-1", Fraction(2)).as_dict()["scenes"][2]
    (tmp_path / "plan.json").write_text(json.dumps(content))
    with pytest.raises(PlanError, match=words):
        Plan.load(tmp_path / "plan.json")


def test_a_checklist_says_what_to_do_between_moments() -> None:
    plan = film_plan(3).add_note("scene-1", "toys")
    for form in ("md", "txt"):
        text = FORMATS[form](plan)
        assert "1 scene of 3 moments, 12 frames" in text
        assert text.count("Planned for a metered time") == 1
        assert text.count("The first of 3 moments: nothing moves until its last reference is taken.") == 1
        for moment in (2, 3):
            assert f"Move what is to move a little by hand, or show picture {moment} of 3 on the monitor" in text
        assert text.count("Note: toys") == 1


def test_progress_has_one_metered_time_a_sequence(tmp_path: Path) -> None:
    plan = film_plan(3)
    metered = ticked(plan.remeter("scene-1", Fraction(2)))
    assert load_progress(written(metered, tmp_path), plan).as_metered(plan) == plan.remeter("scene-1", Fraction(2))
    metered["scenes"][2] = ticked(plan)["scenes"][2]
    with pytest.raises(PlanError, match="expected 2, as of the scene's other moments, found '4'"):
        load_progress(written(metered, tmp_path), plan)
