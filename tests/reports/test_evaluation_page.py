"""The page of an evaluation and that of a comparison: complete, self-contained, safe with any text, right pictures."""

from __future__ import annotations

import io
import math
import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from eldata.errors import EldataError, PredictionError
from eldata.evaluation.comparison import compare
from eldata.evaluation.evaluate import evaluate
from eldata.evaluation.looking import worst_and_best, worst_and_best_images
from eldata.evaluation.results import EvaluationResult, saved_result
from eldata.isp.rendering import brightening, preview
from eldata.protocols.protocol import fields_digest
from eldata.raw.levels import packed_frame
from eldata.raw.reading import read_raw
from eldata.reports import pictures
from eldata.reports.comparison import comparison_page
from eldata.reports.evaluation import EACH, evaluation_page, score_plots, write_evaluation_page
from eldata.reports.pictures import CROP, DrawnImage, show_images
from tests.evaluation import published_code
from tests.evaluation.helpers import Tree, place, small_tree
from tests.reports.evaluations import result, result_data, table_of
from tests.reports.pages import HOSTILE, assert_self_contained, assert_well_formed, checked


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Tree:
    return small_tree(tmp_path_factory.mktemp("tree") / "demo", scenes=2)


@pytest.fixture(scope="module")
def predictions(tree: Tree, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("predictions") / "preds"
    place(folder, tree)
    return folder


@pytest.fixture(scope="module")
def evaluated(tree: Tree, predictions: Path) -> EvaluationResult:
    return evaluate(predictions, **tree.where)


@pytest.fixture(scope="module")
def page(evaluated: EvaluationResult, tree: Tree, predictions: Path, tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("page") / "page.html"
    write_evaluation_page(evaluated, path, dataset_folder=tree.files, predictions=predictions)
    return path.read_text(encoding="utf-8")


def hostile_data(**options: Any) -> dict[str, Any]:
    """A result with bad words in every text; some scores are infinite or not known."""
    data = result_data(cameras=[HOSTILE + "$x$", "相机 " + "long" * 20], **options)
    for index, image in enumerate(data["images"]):
        image["path"] = f"{HOSTILE}/{index}.ARW"
        image["scene"] += HOSTILE
    data["images"][0]["psnr_db"] = "inf"
    data["images"][1] |= {"psnr_db": None, "ssim": None, "rescale": None}
    data["images"][2]["rescale"] = 0
    data["images"][3] |= {"iso": 0, "rescale": 40.0}
    data["protocol"] |= {"title": HOSTILE, "source": HOSTILE}
    data["provenance"] |= {
        "dataset": HOSTILE,
        "predictions": "/x/" + HOSTILE.replace("/", ""),
        "excluded_flags": {HOSTILE: 3},
    }
    data["coverage"] |= {"pairs": 99, "missing": [HOSTILE, "a", "b"]}
    data["problems"] = [{"path": HOSTILE, "reason": HOSTILE}]
    data["notes"] = [HOSTILE]
    return data


@pytest.fixture(scope="module")
def hostile() -> str:
    return evaluation_page(saved_result(hostile_data(), "test"), ())


@pytest.fixture(scope="module")
def comparison() -> str:
    methods = [result(), result(gain_db=0.4, method=1), result(gain_db=-0.1, method=2)]
    return comparison_page(compare(dict(zip("abc", methods, strict=True))))


@pytest.fixture(scope="module")
def hostile_comparison() -> str:
    first, second = hostile_data(), hostile_data(method=1)
    second["protocol"]["levels"] = HOSTILE
    second["provenance"]["protocol_digest"] = fields_digest(second["protocol"])
    names = HOSTILE, "相机 $y$ " + "long" * 20
    return comparison_page(
        compare({name: saved_result(one, HOSTILE) for name, one in zip(names, (first, second), strict=True)})
    )


# --- the whole page -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("which", ["page", "hostile", "comparison", "hostile_comparison"])
def test_well_formed_and_only_our_script_may_run(which: str, request: pytest.FixtureRequest) -> None:
    text: str = request.getfixturevalue(which)
    assert_well_formed(text)
    assert_self_contained(text)
    assert "<script>" in text


def test_hostile_text_stays_text(hostile: str, hostile_comparison: str) -> None:
    for text in (hostile, hostile_comparison):
        checker = checked(text)
        assert HOSTILE in checker.text
        assert not [item for item in checker.all("img") if "evil" in item["src"]]
        for _, attributes in checker.elements:
            for name, value in attributes.items():
                assert HOSTILE not in value or name in ("alt", "aria-label")


def test_says_what_was_found(page: str, evaluated: EvaluationResult) -> None:
    checker = checked(page)
    assert "preds on eld-demo" in checker.text
    assert "Complete: 24 of 24 pairs." in checker.text
    for row in evaluated.table:
        for text in (f"{row.psnr_db:.2f}", f"{row.ssim:.3f}"):
            assert f"<td>{text}</td>" in page
    for value in (evaluated.protocol.digest, evaluated.provenance["manifest_sha256"], evaluated.provenance["libraw"]):
        assert f"<dd>{value}</dd>" in page
    for name in evaluated.protocol.as_dict():
        assert f"<dt>{name}</dt>" in page
    assert checker.text.count("IMG_") == len(evaluated.scores) + 2 * 2 * EACH  # rows; headings and labels of sliders
    assert "no interval with fewer than 6 scenes" in checker.text


def test_every_image_has_a_row_with_what_it_sorts_by(page: str, evaluated: EvaluationResult) -> None:
    body = page[page.index('<table class="sortable">') :]
    values = [float(value) for value in re.findall(r'data-value="([^"]+)"', body)]
    expected = [value for i in evaluated.scores for value in (i.iso, i.ratio, i.psnr_db, i.ssim, i.rescale)]
    assert values == expected


def test_intervals_over_scenes_are_in_the_table() -> None:
    from eldata.evaluation.statistics import interval_of_mean

    one = result()
    text = evaluation_page(one, ())
    for row in one.table:
        images = one.scores_of(row)
        interval = interval_of_mean([image.psnr_db for image in images], [image.scene for image in images])
        assert f"<td>{interval.low:.2f} to {interval.high:.2f}</td>" in text


def test_incomplete_says_so_and_lists_what_is_missing(hostile: str) -> None:
    text = checked(hostile).text
    assert "Incomplete: 96 of 99 pairs" in text
    assert "Not in these means: 3 of 99 pairs" in text
    assert "Problems: 1" in text


def test_nothing_scored() -> None:
    data = result_data(scenes=1)
    data["table"] = [row | {"scored": 0, "psnr_db": None, "ssim": None} for row in table_of(data)]
    data |= {"images": [], "problems": [{"path": "a", "reason": "has no prediction"}]}
    data["coverage"] = {"pairs": 12, "scored": 0, "missing": ["a"]}
    text = checked(evaluation_page(saved_result(data, "test"), ())).text
    assert "Nothing was scored: 1 problem, listed below." in text
    assert "a: has no prediction" in text
    assert not re.search(r"\bnan\b", text)


def test_the_same_page_each_time(
    evaluated: EvaluationResult, tree: Tree, predictions: Path, page: str, tmp_path: Path
) -> None:
    write_evaluation_page(evaluated, tmp_path / "a.html", dataset_folder=tree.files, predictions=predictions)
    assert (tmp_path / "a.html").read_text(encoding="utf-8") == page


def test_wrong_exposure_shows() -> None:
    one = result()
    dark = tuple(replace(image, values=image.values | {"rescale": 4.0}) for image in one.scores)
    plots = {plot.name: plot for plot in score_plots(replace(one, scores=dark))}
    assert "from 4 to 4" in plots["rescaling"].alt
    assert plots["rescaling"].light != plots["rescaling"].dark
    assert score_plots(replace(one, scores=())) == ()
    text = checked(evaluation_page(result(protocol="eld-uncorrected"), ())).text
    assert "there is no factor to show" in text
    assert "Rescaling that was found" not in text


def test_errors(evaluated: EvaluationResult, tree: Tree, predictions: Path, tmp_path: Path) -> None:
    with pytest.raises(EldataError, match="cannot write"):
        write_evaluation_page(evaluated, tmp_path / "no" / "a.html", dataset_folder=tree.files, predictions=predictions)
    gone = tmp_path / "preds"
    shutil.copytree(predictions, gone)
    for path in gone.rglob("*.npy"):
        path.unlink()
    with pytest.raises(PredictionError, match="is gone since it was scored"):
        write_evaluation_page(evaluated, tmp_path / "a.html", dataset_folder=tree.files, predictions=gone)
    assert not (tmp_path / "a.html").exists()


# --- pictures -----------------------------------------------------------------------------------------------------


def pixels(jpeg: bytes) -> NDArray[np.float64]:
    return np.asarray(Image.open(io.BytesIO(jpeg)), dtype=np.float64)


@pytest.fixture
def finest(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures whose codec moves a pixel by about one code."""
    monkeypatch.setattr(pictures, "_QUALITIES", (100,))


@pytest.mark.usefixtures("finest")
def test_pictures_show_what_was_scored(evaluated: EvaluationResult, tree: Tree, predictions: Path) -> None:
    """Against the same steps written plainly."""
    shown = show_images(worst_and_best_images(evaluated, EACH, dataset_folder=tree.files, predictions=predictions))
    assert [rank for rank, _, _ in shown] == ["Worst"] * EACH + ["Best"] * EACH
    pairs = {pair.path: pair for pair in evaluated.units}
    for _, score, image in shown:
        pair = pairs[score.path]
        reference = read_raw(tree.files / str(pair.reference))
        target = packed_frame(reference, levels="published", clip="both")
        amplified = packed_frame(
            read_raw(tree.files / pair.path), levels="published", clip="both", gain=float(pair.nominal_ratio or 1)
        )
        prediction = np.clip(np.load((predictions / pair.path).with_suffix(".npy")), 0, 1) * score.rescale
        expected = {"input": amplified, "method-1": np.clip(prediction, 0, 1), "reference": target}
        layers = image.layers
        assert list(layers) == ["input", "method-1", "reference", "error-1"]
        for key, packed in expected.items():
            wanted = preview(packed * image.brighter, reference.sensor).astype(np.float64)
            found = pixels(layers[key])
            assert found.shape == wanted.shape == (32, 48, 3)
            assert np.abs(found - wanted).mean() < 1.5
        # Two other layers are much further away than the codec moves one.
        assert np.abs(pixels(layers["input"]) - pixels(layers["reference"])).mean() > 12
        assert (image.size, image.box, image.whole) == ((32, 48), (0, 0, 48, 32), {})


def test_errors_are_bright_where_they_are(
    evaluated: EvaluationResult, tree: Tree, predictions: Path, tmp_path: Path
) -> None:
    """A prediction that is its reference but for one block, at a known place."""
    folder = tmp_path / "preds"

    def spoilt(target: NDArray[np.float64], name: str) -> NDArray[np.float64]:
        made = target.copy()
        made[:, 8:16, 16:32] = 1 - made[:, 8:16, 16:32]
        return made

    place(folder, tree, spoilt)
    one = evaluate(folder, **tree.where, protocol="eld-uncorrected")
    shown = show_images(worst_and_best_images(one, EACH, dataset_folder=tree.files, predictions=folder))
    for _, _, image in shown:
        error = pixels(image.layers["error-1"]).mean(axis=2)
        inside = np.zeros(error.shape, dtype=bool)
        inside[8:16, 16:32] = True
        assert error[inside].mean() > 5 * error[~inside].mean()


@pytest.mark.usefixtures("finest")
def test_a_crop_comes_with_the_whole(
    evaluated: EvaluationResult, tree: Tree, predictions: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = evaluated
    entire = show_images(worst_and_best_images(one, EACH, dataset_folder=tree.files, predictions=predictions))
    monkeypatch.setattr(pictures, "CROP", (16, 24))
    monkeypatch.setattr(pictures, "_WHOLE_WIDTH", 24)
    shown = show_images(worst_and_best_images(one, EACH, dataset_folder=tree.files, predictions=predictions))
    for (_, _, image), (_, _, full) in zip(shown, entire, strict=True):
        assert (image.box, image.size) == ((12, 8, 24, 16), (32, 48))
        assert list(image.whole) == ["method-1", "error-1"]
        assert pixels(image.whole["method-1"]).shape == (16, 24, 3)
        centre = pixels(full.layers["reference"])[8:24, 12:36]
        assert np.abs(pixels(image.layers["reference"]) - centre).mean() < 2.5
    text = evaluation_page(one, shown)
    assert "the centre 24 × 16 packed pixels" in checked(text).text
    assert "left: 25.00%; top: 25.00%; width: 50.00%; height: 50.00%" in text
    assert_well_formed(text)


def test_renderings_are_shown_as_they_are(tree: Tree, tmp_path: Path) -> None:
    """Under a protocol of sRGB: predictions that are the reference's rendering, a little darker."""
    folder = tmp_path / "preds"

    def dark(_target: NDArray[np.float64], name: str) -> NDArray[np.float32]:
        reference = next(pair.reference for pair in tree.pairs if pair.path == name)
        return published_code.sid_reference(tree.files / reference).transpose(2, 0, 1) * np.float32(0.9 / 255)

    place(folder, tree, dark)
    one = evaluate(folder, **tree.where, protocol="sid2018", allow_missing=True)
    assert one.scores
    shown = show_images(worst_and_best_images(one, EACH, dataset_folder=tree.files, predictions=folder))
    for _, _, image in shown:
        assert list(image.layers) == ["method-1", "reference", "error-1"]
        prediction, reference = (pixels(image.layers[name]).mean() for name in ("method-1", "reference"))
        assert prediction == pytest.approx(0.9 * reference, rel=0.02)
        assert image.size == (64, 96)
    write_evaluation_page(one, tmp_path / "a.html", dataset_folder=tree.files, predictions=folder)
    assert "sRGB renderings" in (tmp_path / "a.html").read_text(encoding="utf-8")


def test_worst_and_best_are_of_different_scenes() -> None:
    images = result().scores
    worst, best = worst_and_best(images, EACH)
    assert worst[0] == min(images, key=lambda image: image.psnr_db)
    assert best[0] == max(images, key=lambda image: image.psnr_db)
    for kind in (worst, best):
        assert len({image.place for image in kind}) == EACH
    for image in worst:
        assert image.psnr_db == min(other.psnr_db for other in images if other.place == image.place)
    assert worst_and_best(images[:1], EACH) == ([images[0]], [])
    unknown = replace(images[0], values=images[0].values | {"psnr_db": math.nan})
    assert worst_and_best((unknown,), EACH) == ([], [])


def test_a_page_of_240_pairs_stays_below_10_mb() -> None:
    """With 24 pictures of noise, which no format makes small: as many bytes as there may be of pictures."""
    one = result(cameras=["a", "b", "c", "d"], scenes=10)
    assert len(one.scores) == 240
    noise = np.random.default_rng(0).bytes(pictures._MOST_BYTES // (2 * EACH) // 4)
    layers = dict.fromkeys(("input", "method-1", "reference", "error-1"), noise)
    image = DrawnImage("frame 1", layers, {}, (slice(0, CROP[0]), slice(0, CROP[1])), (1424, 2128), 1.0, 0.1)
    ranked = zip(("Worst", "Best"), worst_and_best(one.scores, EACH), strict=True)
    shown = [(rank, score, image) for rank, scores in ranked for score in scores]
    assert len(shown) == 2 * EACH
    assert 8e6 < len(evaluation_page(one, shown)) < 10e6


def test_pictures_get_smaller_until_they_fit(
    evaluated: EvaluationResult, tree: Tree, predictions: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def size() -> int:
        shown = show_images(worst_and_best_images(evaluated, EACH, dataset_folder=tree.files, predictions=predictions))
        return sum(len(jpeg) for _, _, image in shown for jpeg in image.layers.values())

    best = size()
    monkeypatch.setattr(pictures, "_MOST_BYTES", best - 1)
    assert 0.5 * best < size() < best


def test_a_dark_reference_is_shown_brighter_and_a_bright_one_is_not() -> None:
    ramp = np.linspace(0, 1, 10_000, dtype=np.float32).reshape(4, 50, 50)
    assert brightening(ramp) == 1.0
    assert brightening(ramp * 0.3) == 2.0
    assert brightening(ramp * 0.001) == 8.0
    assert brightening(ramp * 0) == 1.0


# --- Markdown and LaTeX -------------------------------------------------------------------------------------------


def test_markdown_and_latex_have_the_numbers_choices_and_gaps() -> None:
    one = result()
    markdown, latex = one.format("markdown"), one.format("latex")
    for row in one.table:
        for text in (f"{row.psnr_db:.2f}", f"{row.ssim:.3f}", str(row.pairs)):
            assert f" {text} " in markdown
            assert f"& {text} " in latex
    caption = f"eld 1.0, protocol eld ({one.digest[:15]}): 96 of 96 pairs."
    assert rf"\caption{{{caption}}}" in latex
    assert caption in markdown
    assert (latex.count(r"\midrule"), r"\label{tab:eld-eld}" in latex) == (3, True)

    data = result_data()
    data["provenance"] |= {"cameras": ["SonyA7S2"], "subset": "indoor", "excluded_flags": {"misaligned": 5}}
    data["coverage"]["pairs"] = 100
    data["notes"] = ["odd_one"]
    text = saved_result(data, "test").format("markdown")
    assert "96 of 100 pairs, only SonyA7S2, subset indoor, without misaligned (5); INCOMPLETE" in text
    assert r"Note: odd\_one" in text
