"""Folders of predictions: which file belongs to which frame; of another layout, one message of what is nearest."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable
from pathlib import Path, PurePosixPath
from typing import Any

import pytest

from eldata.evaluation import evaluate
from eldata.evaluation.predictions import FoundPredictions, describe_misplaced, find_predictions
from eldata.evaluation.scores import EvaluationProblem, problem_lines
from tests.evaluation.helpers import Tree

FIRST = "DemoAlpha/scene-1/IMG_0004"


def found_in(folder: Path, names: Iterable[str], tree: Tree, **options: Any) -> FoundPredictions:
    """Match files of these names with the tree's noisy frames."""
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    return find_predictions(folder, [pair.path for pair in tree.pairs], **options)


@pytest.fixture
def good(tree: Tree) -> list[str]:
    """Names of a prediction of each frame."""
    return [str(Path(pair.path).with_suffix(".npy")) for pair in tree.pairs]


def renamed(old: str, new: str) -> Callable[[str], str]:
    return lambda name: name.replace(old, new)


NPY, UNKNOWN = "12 files", "is it the right folder, and the right dataset?"
SOME = "holds some: give one of them as the folder"

# How the predictions are called, what is found, what the message says of the nearest layout.
LAYOUTS: dict[str, tuple[Callable[[str], str], str, str]] = {
    "flat": (renamed("/", "_"), NPY, f"DemoAlpha_scene-1_IMG_0004.npy would be {FIRST}.npy"),
    "names-of-frames": (lambda name: PurePosixPath(name).name, "6 files", UNKNOWN),  # of which camera?
    "a-word-more": (renamed(".npy", "_out.npy"), NPY, f"{FIRST}_out.npy would be {FIRST}.npy"),
    "another-order": (
        lambda name: "_".join(reversed(name.removesuffix(".npy").split("/"))) + ".npy",
        NPY,
        f"IMG_0004_scene-1_DemoAlpha.npy would be {FIRST}.npy",
    ),
    "two-folders-more": (lambda name: f"a/b/{name}", NPY, "they lie below a/b: give {folder}/a/b as the"),
    "a-folder-a-camera": (lambda name: f"{name[4:5]}/{name}", NPY, f"each of {{folder}}/A and {{folder}}/B {SOME}"),
    "a-folder-a-frame": (lambda name: f"{name[-8:-4]}/{name}", NPY, f"{{folder}}/0009 and 3 others {SOME}"),
    "strangers": (lambda name: f"{name[4:5]}{name[-6:]}", NPY, UNKNOWN),
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_another_layout_is_one_message(layout: str, tree: Tree) -> None:
    rename, found, nearest = LAYOUTS[layout]
    places, folder = [pair.path for pair in tree.pairs], Path("preds")
    names = sorted({rename(str(PurePosixPath(place).with_suffix(".npy"))) for place in places})
    said = describe_misplaced(folder, names, places)
    assert said.startswith(f"found {found}, none of them ")
    assert f"the prediction of {FIRST}.dng is {FIRST}.npy" in said, "what was expected"
    assert nearest.replace("{folder}", str(folder)) in said


@pytest.mark.parametrize("allow_missing", [False, True])
def test_it_is_the_one_problem(allow_missing: bool, tree: Tree, good: list[str], tmp_path: Path) -> None:
    rename, _, nearest = LAYOUTS["flat"]
    found = found_in(tmp_path, map(rename, good), tree, allow_missing=allow_missing)
    (problem,) = found.problems
    assert problem.path == str(tmp_path)
    assert nearest in problem.reason
    assert not found.files


def test_an_empty_folder_is_one_message(tree: Tree, predictions: Path, tmp_path: Path) -> None:
    (tmp_path / "preds" / "DemoAlpha").mkdir(parents=True)
    (tmp_path / "preds" / ".hidden.npy").write_bytes(b"x")
    (tmp_path / "preds" / "link").symlink_to(predictions)
    result = evaluate(tmp_path / "preds", **tree.where)
    (problem,) = result.problems
    assert problem.reason == (
        "found no file, but for hidden ones and links to folders; expected one for each noisy frame: "
        f"the prediction of {FIRST}.dng is {FIRST}.npy"
    )
    assert (result.scores, len(result.missing)) == ((), 12)
    assert result.format_text() == f"{problem}\nnothing was scored: 1 problem"


@pytest.mark.parametrize("levels", [1, 2])
def test_a_folder_within_the_layout_names_the_one_above(levels: int, tree: Tree, predictions: Path) -> None:
    inner = predictions.joinpath(*FIRST.split("/")[:levels])
    (problem,) = found_in(inner, (), tree).problems
    within = "/".join(FIRST.split("/")[:levels])
    assert f"this is {within} of the layout: give {predictions} as the folder of predictions" in problem.reason


def test_the_dataset_is_not_predictions_of_it(tree: Tree, predictions: Path, tmp_path: Path) -> None:
    """Its folder, those in it, the one above; nothing in it is to be renamed or moved away."""
    (tmp_path / "link").symlink_to(tree.files)
    part = tree.files / "DemoAlpha"
    for folder in (tree.files, tmp_path / "link", part, part / "scene-1", tree.root):
        result = evaluate(folder, **tree.where)
        (problem,) = result.problems
        assert problem.path == str(folder)
        assert problem.reason.startswith(
            f"holds the dataset itself, {tree.files}; give a folder of predictions alone, such as eldata"
        )
        assert not result.scores
    own = tree.copy(tmp_path / "own")
    shutil.copytree(predictions, own.files / "preds")
    assert not evaluate(own.files / "preds", **own.where).problems


def test_why_more_frames_are_wanted_than_were_predicted_is_said(predictions: Path, tree: Tree) -> None:
    """A set of one's own without all of a protocol's factors is scored whole."""
    problems = evaluate(predictions, **tree.where, protocol="sid").problems
    (reason,) = {problem.reason for problem in problems}
    assert reason.startswith(
        "has no prediction, and sid scores this set's own pairs, not its factors x100, x250, x300; add it, or score "
    )


def test_very_long_paths_and_very_many_files_are_told_apart_at_once() -> None:
    """Work grows with the files and not with the powers of their names' lengths."""
    deep = "1_" * 20_000 + "/x" * 2_000
    names = [f"{deep}/{number}.npy" for number in range(30)] + [f"{number}_0.npy" for number in range(10_000)]
    said = describe_misplaced(Path("preds"), names, SID)
    assert said.startswith("found 10030 files, none of them where expected")


# --- some are right ---------------------------------------------------------------------------------------------------


def test_files_that_are_not_read_are_named_where_a_prediction_is_missing(
    tree: Tree, good: list[str], tmp_path: Path
) -> None:
    names = [name.replace(".npy", ".pt") if "Beta" in name else name for name in good]
    found = found_in(tmp_path, names, tree)
    assert [problem.path for problem in found.problems] == [pair.path for pair in tree.pairs if "Beta" in pair.path]
    (reason,) = {problem.reason for problem in found.problems}
    assert reason == (
        "has no prediction, only a .pt file, which is not read; add it as .npy, .npz, .h5, .tif, .tiff, .png or .dng, "
        "or score the rest with --allow-missing"
    )
    rest = found_in(tmp_path, (), tree, allow_missing=True)
    assert (len(rest.files), rest.problems) == (6, ())


def test_files_nearby_are_named_where_predictions_are_missing(tree: Tree, good: list[str], tmp_path: Path) -> None:
    names = [name.replace("/", "_") if "Beta" in name else name for name in good]
    problems = found_in(tmp_path, names, tree).problems
    assert [problem.path for problem in problems[6:]] == [pair.path for pair in tree.pairs if "Beta" in pair.path]
    for problem in problems[:6]:
        assert "/" not in problem.path
        assert problem.reason.endswith(": DemoBeta_scene-1_IMG_0004.npy would be DemoBeta/scene-1/IMG_0004.npy")
    lines = problem_lines(problems)
    assert len(lines) == 4
    assert lines[2] == "6 alike: has no prediction; add it, or score the rest with --allow-missing"
    assert lines[3].startswith("  DemoBeta/scene-1/IMG_0004.dng, DemoBeta/scene-1/IMG_0005.dng, ")


def test_extra_predictions_are_named(tree: Tree, good: list[str], tmp_path: Path) -> None:
    extra = ["DemoAlpha/scene-1/IMG_0017.npy", "DemoAlpha/scene-9/IMG_0004.npy", "IMG_0004.tif"]
    found = found_in(tmp_path, [*good, *extra], tree)
    assert [problem.path for problem in found.problems] == extra
    assert all("is the prediction of no noisy frame" in problem.reason for problem in found.problems)
    assert len(found.files) == 12


def test_two_extensions_are_ambiguous(tree: Tree, good: list[str], tmp_path: Path) -> None:
    found = found_in(tmp_path, [*good, f"{FIRST}.tif"], tree, allow_missing=True)
    (problem,) = found.problems
    assert str(problem) == f"{FIRST}.dng: expected one prediction, found 2: {FIRST}.npy, {FIRST}.tif; keep one"
    assert len(found.files) == 11


def test_hidden_and_unrelated_files_are_ignored(tree: Tree, good: list[str], tmp_path: Path) -> None:
    others = (
        *(".DS_Store", ".IMG_0004.npy.x7.part", ".hidden.npy", ".cache/IMG_0004.npy", "notes.txt", "config.json"),
        *("DemoAlpha/scene-1/IMG_0004.txt", "DemoAlpha/scene-1/._IMG_0004.npy", "DemoAlpha/preview.jpg"),
    )
    assert found_in(tmp_path, [*good, *others], tree) == found_in(tmp_path, (), tree)
    assert not found_in(tmp_path, (), tree).problems


def test_predictions_of_other_factors_are_counted(tree: Tree, good: list[str], tmp_path: Path) -> None:
    known = [f"DemoAlpha/scene-1/IMG_{number:04d}" for number in (2, 3, 7)]  # x1, x10, x1
    names = [*good, *(f"{name}.npy" for name in known)]
    found = found_in(tmp_path, names, tree, known=[f"{name}.dng" for name in (*known, FIRST)])
    assert (found.unscored, found.problems) == (3, ())


# --- many lines -------------------------------------------------------------------------------------------------------


def problems_of(*groups: tuple[int, str]) -> list[EvaluationProblem]:
    return [
        EvaluationProblem(f"{reason}/scene-{number // 10}/{number:03d}.dng", reason)
        for count, reason in groups
        for number in range(count)
    ]


def test_problems_alike_stand_together_and_none_is_uncounted() -> None:
    """Of very many reasons twenty lines are shown; a name that steers the terminal, by its numbers."""
    some = ", ".join(f"a/scene-0/00{number}.dng" for number in range(6))
    lines = problem_lines(problems_of((1, "b"), (14, "a")))
    assert lines == ["b/scene-0/000.dng: b", "14 alike: a", f"  {some} and 8 more"]
    lines = problem_lines(problems_of((4, "a"), *((1, f"b{number}") for number in range(30))))
    assert (len(lines), lines[20]) == (21, "... and 12 more (--json FILE lists all)")
    span = ["found (4, 9, 3) up to 1.5e+04 in 2", "found (4, 12, 3) up to 2e+03 in 2"]
    lines = problem_lines([EvaluationProblem(text[7:10], text) for text in span])
    assert lines[0] == "2 alike: found (4, 9..12, 3) up to 2e+03..1.5e+04 in 2"
    assert problem_lines([EvaluationProblem("a\x1b[2J\n.npy", "is\todd")]) == ["a\\x1b[2J\\n.npy: is\\todd"]


# --- SID's names ------------------------------------------------------------------------------------------------------

SID = [f"Sony/short/{name}.ARW" for name in ("10003_00_0.04s", "10003_00_0.1s", "10006_00_0.04s", "10006_00_0.1s")]


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("10006_00_0.1s.npy", "10006_00_0.1s.npy would be Sony/short/10006_00_0.1s.npy"),
        ("sony_10006_00_0.1s_pred.tif", "sony_10006_00_0.1s_pred.tif would be Sony/short/10006_00_0.1s.tif"),
        ("10003_00_100_out.png", UNKNOWN),  # as the code of SID writes them: of either exposure
    ],
)
def test_names_of_sid(name: str, said: str, tmp_path: Path) -> None:
    assert said in describe_misplaced(tmp_path, [name], SID)


def test_frames_whose_predictions_would_lie_in_one_place(tmp_path: Path) -> None:
    (tmp_path / "x.npy").touch()
    found = find_predictions(tmp_path, ["x.ARW", "x.dng"])
    assert found.files == {"x.ARW": tmp_path / "x.npy"}
    assert [str(problem) for problem in found.problems] == [
        "x.dng: its prediction would lie where that of x.ARW does; give the frames other names"
    ]
