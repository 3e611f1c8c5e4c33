"""Pictures of a comparison: drawn from what was scored, found again from saved results, linked in a real browser."""

from __future__ import annotations

import io
import json
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pytest
from PIL import Image

from eldata.cli.main import main
from eldata.evaluation.comparison import Comparison, compare
from eldata.evaluation.evaluate import evaluate
from eldata.evaluation.looking import ScoredImage, images_of, place_of_difference, units_again
from eldata.evaluation.results import load_result
from eldata.evaluation.statistics import holm
from eldata.reports import pictures
from eldata.reports.comparison import write_comparison_page
from tests.evaluation.helpers import Tree, perturbed, place, small_tree
from tests.reports.evaluations import written
from tests.reports.pages import OUTSIDE, assert_well_formed, checked

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from tests.capture.checklist_browser import Page

CROP = (12, 16)
IMAGES = 12  # two cameras, one scene, three ISOs, two factors


def far_off(target: NDArray[np.float64], name: str) -> NDArray[np.float64]:
    """A worse prediction, with its errors in one corner."""
    result = perturbed(target, name)
    result[:, 18:30, 32:46] += 0.3
    return result


@dataclass(frozen=True)
class Compared:
    """Two methods' results, as JSON files and their comparison, and the page with pictures."""

    tree: Tree
    folder: Path
    files: tuple[Path, Path]
    comparison: Comparison
    images: tuple[ScoredImage, ...]

    @property
    def page(self) -> Path:
        return self.folder / "page.html"

    def picture(self, name: str) -> NDArray[np.uint8]:
        return np.asarray(Image.open(io.BytesIO((self.folder / "page-pictures" / name).read_bytes())))


@pytest.fixture(scope="module")
def compared(tmp_path_factory: pytest.TempPathFactory) -> Compared:
    folder = tmp_path_factory.mktemp("compared")
    tree = small_tree(folder / "demo")
    files = []
    for name, make in (("near", perturbed), ("far", far_off)):
        place(folder / name, tree, make)
        evaluate(folder / name, **tree.where).write_json(folder / f"{name}.json")
        files.append(folder / f"{name}.json")
    methods = {path.stem: load_result(path) for path in files}
    comparison = compare(methods)
    dataset, units = units_again(comparison.first, **tree.where)
    images = images_of(
        list(comparison.results.values()),
        comparison.images,
        dataset_folder=dataset,
        predictions=[folder / "near", folder / "far"],
        units=units,
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pictures, "CROP", CROP)
        write_comparison_page(comparison, folder / "page.html", images=images)
    return Compared(tree, folder, (files[0], files[1]), comparison, images)


def test_what_is_drawn_is_what_was_scored(compared: Compared) -> None:
    """The PSNR of the decoded arrays, by its own formula, is the score of the file that was read back."""
    assert len(compared.images) == IMAGES
    for image, scores in zip(compared.images[:4], compared.comparison.images, strict=False):
        seen = image.decoded()
        for prediction, score in zip(seen.predictions, scores, strict=True):
            error = np.mean(np.square(prediction.astype(np.float64) - seen.reference))
            assert 10 * np.log10(1 / error) == pytest.approx(score.psnr_db, abs=1e-4)


def test_every_image_has_all_of_its_pictures(compared: Compared) -> None:
    names = {path.name for path in (compared.folder / "page-pictures").iterdir()}
    layers = ("input", "method-1", "method-2", "reference", "error-1", "error-2", "whole")
    assert names == {f"{number:04d}-{layer}.jpg" for number in range(1, IMAGES + 1) for layer in layers}
    assert compared.picture("0001-method-1.jpg").shape == (*CROP, 3)
    # Where the second method is wrong and the first is not, its error is brighter.
    near, far = (compared.picture(f"0001-error-{index}.jpg").mean() for index in (1, 2))
    assert far > 1.5 * near


def test_the_page_has_them_lazily_and_is_well_formed(compared: Compared) -> None:
    text = compared.page.read_text(encoding="utf-8")
    assert_well_formed(text)
    sources = [one["src"] for one in checked(text).all("img") if not one["src"].startswith("data:")]
    assert len(sources) == 7  # of the first image alone
    assert all((compared.folder / source).is_file() for source in sources)
    assert "img-src data: 'self' file:;" in text
    # The worst difference comes first.
    gains = [other.psnr_db - first.psnr_db for first, other in compared.comparison.images]
    worst = compared.comparison.images[int(np.argmin(gains))][0].path
    assert text.partition('class="sortable"')[2].partition("</a></th>")[0].endswith(f">{worst}")


def test_a_page_that_is_written_again_leaves_no_old_pictures(compared: Compared, tmp_path: Path) -> None:
    folder = tmp_path / "page-pictures"
    folder.mkdir()
    (folder / "0999-error-7.jpg").write_bytes(b"old")
    (folder / "mine.jpg").write_bytes(b"kept")
    write_comparison_page(compared.comparison, tmp_path / "page.html", images=compared.images)
    names = {path.name for path in folder.iterdir()}
    assert "mine.jpg" in names
    assert "0999-error-7.jpg" not in names
    assert len(names) == 7 * IMAGES + 1


def test_the_place_of_difference_is_that_of_a_search_window_by_window() -> None:
    errors = np.random.default_rng(5).random((3, 37, 53))
    errors[1, 20:29, 30:41] += 2
    best, where = -1.0, (0, 0)
    for top in sorted({*range(0, 37 - 12 + 1, 3), 37 - 12}):
        for left in sorted({*range(0, 53 - 16 + 1, 4), 53 - 16}):
            means = [np.mean(one[top : top + 12, left : left + 16] ** 2) for one in errors]
            if max(means) - min(means) > best:
                best, where = max(means) - min(means), (top, left)
    rows, columns = place_of_difference(list(errors), (12, 16))
    assert (rows.start, columns.start) == where
    assert (rows.stop - rows.start, columns.stop - columns.start) == (12, 16)
    assert place_of_difference(list(errors), (99, 99)) == (slice(0, 37), slice(0, 53))


def test_holm_is_that_of_r() -> None:
    """``p.adjust(c(0.01, 0.04, 0.03, 0.005), "holm")`` and ``p.adjust(c(0.6, 0.7), "holm")``; nan does not count."""
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.6, 0.7]) == [1.0, 1.0]
    found = holm([0.02, float("nan"), 0.03])
    assert [found[0], found[2]] == pytest.approx([0.04, 0.04])
    assert np.isnan(found[1])


def test_the_command_draws_and_says_what_is_in_its_way(
    compared: Compared, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = [str(path) for path in compared.files]
    page = ["--html", str(tmp_path / "page.html")]
    own = ["--manifest", str(compared.tree.manifest), "--root", str(compared.tree.root), "--jobs", "1"]
    assert main(["compare", *files, *page, "--pictures", "whole", *own]) == 0
    with Image.open(tmp_path / "page-pictures" / "0001-reference.jpg") as image:
        assert (image.height, image.width) == compared.images[0].decoded().reference.shape[1:]
    capsys.readouterr()
    data = json.loads(compared.files[0].read_text(encoding="utf-8"))
    data["provenance"]["manifest_sha256"] = "sha256:" + "0" * 64
    other = written(tmp_path / "other.json", data)
    assert main(["compare", str(other), *files[1:], "--html", str(tmp_path / "b.html"), "--pictures", *own]) == 2
    assert "is not the manifest that" in capsys.readouterr().err
    assert not (tmp_path / "b.html").exists()
    refused = {
        (*page, "--pictures"): "no dataset is called 'eld-demo'",
        ("--pictures",): "--pictures are of a page: say where to write it with --html FILE",
        (*page, "--pictures", *own, "--predictions", str(tmp_path)): "expected a folder of predictions per method",
        (*page, "--pictures", *own, *("--predictions", str(tmp_path)) * 2): "is gone since it was scored",
    }
    for arguments, words in refused.items():
        assert main(["compare", *files, *arguments]) == 2
        assert words in capsys.readouterr().err


# --- in a browser -------------------------------------------------------------------------------------------------


@pytest.fixture
def page(bare: Page, compared: Compared) -> Page:
    bare.open(compared.page.as_uri())
    return bare


TRANSFORMS = "[...document.querySelectorAll('.glass img')].map((e) => e.style.transform)"
SHOWN = (
    "[...document.querySelectorAll('table.sortable tbody tr')].filter((e) => !e.hidden)"
    ".map((e) => e.cells[0].textContent)"
)


@pytest.mark.browser
def test_keys_step_through_the_rows_that_the_filters_leave(page: Page) -> None:
    rows = page.run(SHOWN)
    assert len(rows) == IMAGES
    assert page.text("#look-name") == rows[0]
    page.press("ArrowRight", 2)
    assert page.text("#look-name") == rows[2]
    assert page.run("document.querySelector('tr[aria-current]').cells[0].textContent") == rows[2]
    page.run("Promise.all([...document.querySelectorAll('.looking img')].map((e) => e.decode()))")
    assert page.run("[...document.querySelectorAll('.looking img')].every((e) => e.naturalWidth > 0)")
    page.run(
        "(() => { const e = document.querySelector('select[data-column=camera]'); e.value = 'DemoBeta';"
        " e.dispatchEvent(new Event('input')); })()"
    )
    left = page.run(SHOWN)
    assert left == [name for name in rows if name.startswith("DemoBeta/")]
    assert page.text("#filter-count") == f"{len(left)} of {IMAGES}"
    page.type(".filters input", left[1].rpartition("/")[2])
    assert page.run(SHOWN) == [left[1]]
    page.click("table.sortable tbody tr:not([hidden]) a")
    assert page.text("#look-name") == left[1]


@pytest.mark.browser
def test_crops_are_linked(page: Page) -> None:
    before = page.run(TRANSFORMS)
    assert len(before) == 6  # input, two methods and their errors, reference
    assert len(set(before)) == 1
    page.click("[data-do=out]")
    zoomed = page.run(TRANSFORMS)
    assert len(set(zoomed)) == 1
    assert zoomed[0] != before[0]
    page.press("ArrowRight", modifiers=8)  # Shift: pan
    assert page.run("document.querySelector('tr[aria-current]') === document.querySelector('table.sortable tbody tr')")
    page.click("[data-do=flip]")
    assert page.run("[...document.querySelectorAll('.panel')].filter((e) => e.checkVisibility()).length") == 1
    assert len(set(page.run(TRANSFORMS))) == 1


@pytest.mark.browser
@pytest.mark.parametrize("width", [390, 1280])
def test_the_page_with_pictures_fits_its_window(width: int, page: Page) -> None:
    page.resize(width)
    page.wait(lambda: page.run("innerWidth") == width)
    assert page.run("document.documentElement.scrollWidth") <= width
    assert page.run(OUTSIDE) == []
