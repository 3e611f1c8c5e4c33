"""Folders of predictions in another layout: one message of what was found, what was expected, what is nearest."""

from __future__ import annotations

import shutil
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

import pytest

from eldata.evaluation import evaluate
from eldata.evaluation.layouts import describe_misplaced
from eldata.evaluation.scores import EvaluationProblem, problem_lines

if TYPE_CHECKING:
    from collections.abc import Callable

    from eldata.evaluation import EvaluationResult
    from tests.evaluation.helpers import Tree

FIRST = "DemoAlpha/scene-1/IMG_0004"


@pytest.fixture
def moved(predictions: Path, tmp_path: Path) -> Callable[[Callable[[str], str]], Path]:
    """Return a function that makes a folder of the good predictions under names of their own."""

    def move(rename: Callable[[str], str]) -> Path:
        for path in predictions.rglob("*.npy"):
            target = tmp_path / "preds" / rename(path.relative_to(predictions).as_posix())
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(path, target)
        return tmp_path / "preds"

    return move


def run(folder: Path, tree: Tree, cameras: list[str] | None = None, *, allow_missing: bool = False) -> EvaluationResult:
    return evaluate(folder, **tree.where, cameras=cameras, allow_missing=allow_missing)


def in_camera(name: str) -> str:
    """Without the first folder, and nothing of the other camera."""
    return name.partition("/")[2]


def renamed(old: str, new: str) -> Callable[[str], str]:
    return lambda name: name.replace(old, new)


WHICH = f"could be {FIRST}.npy or DemoBeta/scene-1/IMG_0004.npy: its name does not tell which"
NPY, OF_ONE = "12 files", "6 files"

# How the predictions are called, what is found, what the message says of the nearest layout.
LAYOUTS: dict[str, tuple[Callable[[str], str], str, str]] = {
    "flat": (renamed("/", "_"), NPY, f"DemoAlpha_scene-1_IMG_0004.npy would be {FIRST}.npy"),
    "flat-without-camera": (lambda name: in_camera(name).replace("/", "_"), OF_ONE, f"scene-1_IMG_0004.npy {WHICH}"),
    "names-of-frames": (lambda name: PurePosixPath(name).name, OF_ONE, f"IMG_0004.npy {WHICH}"),
    "without-scenes": (renamed("scene-1/", ""), NPY, f"DemoAlpha/IMG_0004.npy would be {FIRST}.npy"),
    "without-zeros-and-signs": (
        lambda name: name.replace("_000", "").replace("_00", "").replace("scene-", "scene"),
        NPY,
        "DemoAlpha/scene1/IMG10.npy would be DemoAlpha/scene-1/IMG_0010.npy",
    ),
    "a-word-more": (renamed(".npy", "_out.npy"), NPY, f"{FIRST}_out.npy would be {FIRST}.npy"),
    "another-order": (
        lambda name: "_".join(reversed(name.removesuffix(".npy").split("/"))) + ".npy",
        NPY,
        f"IMG_0004_scene-1_DemoAlpha.npy would be {FIRST}.npy",
    ),
    "no-extension": (renamed(".npy", ""), NPY, f"{FIRST} would be {FIRST}.npy"),
    "two-folders-more": (lambda name: f"a/b/{name}", NPY, "they lie below a/b: give {folder}/a/b as the"),
    "a-folder-a-camera": (
        lambda name: f"{name[4:5]}/{name}",
        NPY,
        "each of {folder}/A and {folder}/B holds some: give one of them as the folder",
    ),
    "strangers": (lambda name: f"{name[4:5]}{name[-6:]}", NPY, "is it the right folder, and the right dataset?"),
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
def test_it_is_the_one_problem(allow_missing: bool, tree: Tree, moved: Callable[[Callable[[str], str]], Path]) -> None:
    rename, _, nearest = LAYOUTS["flat"]
    folder = moved(rename)
    result = run(folder, tree, allow_missing=allow_missing)
    (problem,) = result.problems
    assert problem.path == str(folder)
    assert nearest in problem.reason
    assert not result.scores
    assert len(result.missing) == 12
    assert result.format_text() == f"{problem}\nnothing was scored: 1 problem"


def test_an_empty_folder_is_one_message(tree: Tree, predictions: Path, tmp_path: Path) -> None:
    (tmp_path / "preds" / "DemoAlpha").mkdir(parents=True)
    (tmp_path / "preds" / ".hidden.npy").write_bytes(b"x")
    (tmp_path / "preds" / "link").symlink_to(predictions)
    (problem,) = run(tmp_path / "preds", tree).problems
    assert problem.reason == (
        "found no file, but for hidden ones and links to folders; expected one for each noisy frame: "
        f"the prediction of {FIRST}.dng is {FIRST}.npy"
    )


@pytest.mark.parametrize("levels", [1, 2])
def test_a_folder_within_the_layout_names_the_one_above(levels: int, tree: Tree, predictions: Path) -> None:
    inner = predictions.joinpath(*FIRST.split("/")[:levels])
    (problem,) = run(inner, tree).problems
    within = "/".join(FIRST.split("/")[:levels])
    assert f"this is {within} of the layout: give {predictions} as the folder of predictions" in problem.reason


def test_the_dataset_is_not_predictions_of_it(tree: Tree, predictions: Path, tmp_path: Path) -> None:
    """Its folder, those in it, the one above; nothing in it is to be renamed or moved away."""
    (tmp_path / "link").symlink_to(tree.files)
    part = tree.files / "DemoAlpha"
    for folder in (tree.files, tmp_path / "link", part, part / "scene-1", tree.root):
        result = run(folder, tree)
        (problem,) = result.problems
        assert problem.path == str(folder)
        assert problem.reason.startswith(
            f"holds the dataset itself, {tree.files}; give a folder of predictions alone, such as eldata"
        )
        assert not result.scores
    own = tree.copy(tmp_path / "own")
    shutil.copytree(predictions, own.files / "preds")
    assert not run(own.files / "preds", own).problems


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
    said = describe_misplaced(Path("preds"), names, *SID)
    assert said.startswith("found 10030 files, none of them where expected")


# --- some are right ---------------------------------------------------------------------------------------------------


def test_files_that_are_not_read_are_named_where_a_prediction_is_missing(
    tree: Tree, moved: Callable[[Callable[[str], str]], Path]
) -> None:
    folder = moved(lambda name: name.replace(".npy", ".pt") if "Beta" in name else name)
    result = run(folder, tree)
    assert [problem.path for problem in result.problems] == [
        pair.path for pair in tree.pairs if pair.camera == "DemoBeta"
    ]
    (reason,) = {problem.reason for problem in result.problems}
    assert reason == (
        "has no prediction, only a .pt file, which is not read; add it as .npy, .npz, .h5, .tif, .tiff, .png or .dng, "
        "or score the rest with --allow-missing"
    )
    assert len(run(folder, tree, allow_missing=True).scores) == 6


def test_files_nearby_are_named_where_predictions_are_missing(
    tree: Tree, moved: Callable[[Callable[[str], str]], Path]
) -> None:
    folder = moved(lambda name: name.replace("/", "_") if "Beta" in name else name)
    result = run(folder, tree)
    assert len(result.problems) == 12
    extra, missing = result.problems[:6], result.problems[6:]
    assert [problem.path for problem in missing] == [pair.path for pair in tree.pairs if pair.camera == "DemoBeta"]
    for problem in extra:
        assert "/" not in problem.path
        assert problem.reason.endswith(": DemoBeta_scene-1_IMG_0004.npy would be DemoBeta/scene-1/IMG_0004.npy")
    lines = result.format_text().splitlines()
    assert len(lines) == 5
    assert lines[2] == "6 alike: has no prediction; add it, or score the rest with --allow-missing"
    assert lines[3].startswith("  DemoBeta/scene-1/IMG_0004.dng, DemoBeta/scene-1/IMG_0005.dng, ")
    assert lines[4] == "nothing was scored: 12 problems"


# --- many lines -------------------------------------------------------------------------------------------------------


def problems_of(*groups: tuple[int, str]) -> list[EvaluationProblem]:
    return [
        EvaluationProblem(f"{reason}/scene-{number // 10}/{number:03d}.dng", reason)
        for count, reason in groups
        for number in range(count)
    ]


def test_problems_alike_stand_together_and_none_is_uncounted() -> None:
    lines = problem_lines(problems_of((1, "b"), (14, "a")))
    assert lines == [
        "b/scene-0/000.dng: b",
        "14 alike: a",
        f"  {', '.join(f'a/scene-0/00{number}.dng' for number in range(6))} and 8 more",
    ]


def test_of_very_many_reasons_twenty_lines_are_shown() -> None:
    lines = problem_lines(problems_of((4, "a"), *((1, f"b{number}") for number in range(30))))
    assert len(lines) == 21
    assert lines[20] == "... and 12 more (--json FILE lists all)"


def test_a_name_that_steers_the_terminal_is_shown_by_its_numbers() -> None:
    assert problem_lines([EvaluationProblem("a\x1b[2J\n.npy", "is\todd")]) == ["a\\x1b[2J\\n.npy: is\\todd"]


# --- SID's names ------------------------------------------------------------------------------------------------------

SID: tuple[list[str], dict[str, str]] = (
    [f"Sony/short/{name}.ARW" for name in ("10003_00_0.04s", "10003_00_0.1s", "10006_00_0.04s", "10006_00_0.1s")],
    {"Sony/long/10003_00_10s.ARW": "Sony/short/10003_00_0.04s.ARW"},
)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("10006_00_0.1s.npy", "10006_00_0.1s.npy would be Sony/short/10006_00_0.1s.npy"),
        ("sony_10006_00_0.1s_pred.tif", "sony_10006_00_0.1s_pred.tif would be Sony/short/10006_00_0.1s.tif"),
        (
            "10003_00_100_out.png",  # as the code of SID writes them
            "10003_00_100_out.png could be Sony/short/10003_00_0.04s.png or Sony/short/10003_00_0.1s.png: its name",
        ),
        ("Sony/long/10003_00_10s.npy", "has the name of a reference; predictions have that of their noisy frame"),
    ],
)  # fmt: skip
def test_names_of_sid(name: str, said: str, tmp_path: Path) -> None:
    assert said in describe_misplaced(tmp_path, [name], *SID)
