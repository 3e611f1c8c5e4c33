"""The pages of evaluations and comparisons in a real browser: sorting, sliders, both widths, both themes, no script."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from eldata.evaluation.comparison import compare
from eldata.evaluation.evaluate import evaluate
from eldata.evaluation.results import saved_result
from eldata.reports import pictures
from eldata.reports.comparison import write_comparison_page
from eldata.reports.evaluation import evaluation_page, write_evaluation_page
from tests.evaluation.helpers import place, small_tree
from tests.reports.evaluations import result
from tests.reports.pages import OUTSIDE
from tests.reports.test_evaluation_page import hostile_data

if TYPE_CHECKING:
    from pathlib import Path

    from tests.capture.checklist_browser import Page

pytestmark = pytest.mark.browser

PHONE, DESKTOP = 390, 1280


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Each page, by name."""
    folder = tmp_path_factory.mktemp("pages")
    tree = small_tree(folder / "demo", scenes=1)
    place(folder / "preds", tree)
    evaluated = evaluate(folder / "preds", **tree.where)
    paths = {name: folder / f"{name}.html" for name in ("evaluation", "comparison", "hostile", "hostile-comparison")}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pictures, "CROP", (24, 36))
        write_evaluation_page(evaluated, paths["evaluation"], dataset_folder=tree.files, predictions=folder / "preds")
    methods = {name: result(gain_db=gain, method=gain) for gain, name in enumerate(("base", "unet", "best"))}
    write_comparison_page(compare(methods), paths["comparison"])
    hostile = [saved_result(hostile_data(method=method), "test") for method in (0, 1)]
    paths["hostile"].write_text(evaluation_page(hostile[0], ()), encoding="utf-8")
    bad = "<b>" + "long" * 30
    write_comparison_page(compare({"a": hostile[0], bad: hostile[1]}), paths["hostile-comparison"])
    return paths


@pytest.fixture
def page(bare: Page, files: dict[str, Path]) -> Page:
    bare.open(files["evaluation"].as_uri())
    return bare


# --- sorting ------------------------------------------------------------------------------------------------------


def column(page: Page, name: str) -> list[str]:
    """The cells of a column as they stand: what they sort by, or their text."""
    code = (
        "(() => { const table = document.querySelector('table.sortable');"
        f" const at = [...table.tHead.rows[0].cells].findIndex((e) => e.textContent.startsWith({name!r}));"
        " return [...table.tBodies[0].rows].map((r) => r.cells[at].dataset.value ?? r.cells[at].textContent); })()"
    )
    return list(page.run(code))


def sorted_heads(page: Page) -> list[list[str]]:
    code = "[...document.querySelectorAll('th[aria-sort]')].map((e) => [e.textContent, e.getAttribute('aria-sort')])"
    return list(page.run(code))


PSNR_BUTTON = "table.sortable th:nth-child(6) button"


def test_sorting_by_mouse(page: Page) -> None:
    before = column(page, "PSNR")
    values = [float(value) for value in before]
    assert sorted_heads(page) == []
    page.click(PSNR_BUTTON)
    assert [float(value) for value in column(page, "PSNR")] == sorted(values)
    assert sorted_heads(page) == [["PSNR [dB]", "ascending"]]
    assert page.text("[role=status]") == "Sorted by PSNR [dB], ascending."
    page.click(PSNR_BUTTON)
    assert [float(value) for value in column(page, "PSNR")] == sorted(values, reverse=True)
    assert sorted_heads(page) == [["PSNR [dB]", "descending"]]
    assert sorted(values) != values != sorted(values, reverse=True)


def test_unknown_scores_sort_last_either_way(bare: Page, files: dict[str, Path]) -> None:
    bare.open(files["hostile"].as_uri())
    for _ in range(2):
        bare.click(PSNR_BUTTON)
        assert column(bare, "PSNR").index("NaN") == 95
    assert column(bare, "PSNR")[0] == "Infinity"


# --- the slider ---------------------------------------------------------------------------------------------------

VIEWER = "#picture-1"


def clips(page: Page) -> dict[str, str]:
    """What of each visible layer is cut away."""
    code = (
        f"Object.fromEntries([...document.querySelectorAll('{VIEWER} .layer')]"
        ".filter((e) => getComputedStyle(e).visibility === 'visible')"
        ".map((e) => [e.dataset.layer, getComputedStyle(e).clipPath]))"
    )
    return dict(page.run(code))


def test_slider_by_keyboard(page: Page) -> None:
    assert clips(page) == {"input": "inset(0px 50% 0px 0px)", "prediction": "inset(0px 0px 0px 50%)"}
    page.run(f"document.querySelector('{VIEWER} input[type=range]').focus()")
    page.press("ArrowRight", 10)
    assert clips(page) == {"input": "inset(0px 40% 0px 0px)", "prediction": "inset(0px 0px 0px 60%)"}
    code = f"document.querySelector('{VIEWER} input[type=range]')"
    assert page.run(f"{code}.getAttribute('aria-valuetext')") == "60 % from the left"
    assert page.run(f"{code}.labels[0].textContent").startswith("Line between the left and the right picture of Demo")


def test_slider_by_mouse_on_the_picture(page: Page) -> None:
    box = page.run(
        f"(() => {{ const e = document.querySelector('{VIEWER} .stage'); e.scrollIntoView({{block: 'center'}});"
        " const r = e.getBoundingClientRect(); return [r.left, r.top, r.width, r.height]; })()"
    )
    y = box[1] + box[3] / 2
    for kind, share in (("mousePressed", 0.5), ("mouseMoved", 0.75), ("mouseMoved", 0.25), ("mouseReleased", 0.25)):
        place = {"x": box[0] + share * box[2], "y": y}
        page.send("Input.dispatchMouseEvent", type=kind, button="left", buttons=1, clickCount=1, **place)
    value = int(page.run(f"document.querySelector('{VIEWER} input[type=range]').value"))
    assert value == pytest.approx(25, abs=2)
    page.send("Input.dispatchMouseEvent", type="mouseMoved", x=box[0] + 0.9 * box[2], y=y)  # no button: nothing moves
    assert int(page.run(f"document.querySelector('{VIEWER} input[type=range]').value")) == value
    assert clips(page)["prediction"] == f"inset(0px 0px 0px {value}%)"


def test_layers_are_chosen_by_mouse_and_keyboard(page: Page) -> None:
    page.click(f"{VIEWER} input[data-side=right][value=reference]")
    assert set(clips(page)) == {"input", "reference"}
    assert page.text(f"{VIEWER} .tag.right") == "Reference"
    page.run(f"document.querySelector('{VIEWER} input[data-side=left][value=input]').focus()")
    page.press("ArrowRight")
    assert set(clips(page)) == {"prediction", "reference"}
    page.press("ArrowRight")
    assert clips(page) == {"reference": "none"}  # on both sides: all of it
    # The other viewers stay as they are.
    assert page.text("#picture-2 .tag.right") == "Prediction"
    assert page.run("new Set([...document.querySelectorAll('input[type=radio]')].map((e) => e.name)).size") == 2 * int(
        page.run("document.querySelectorAll('.viewer').length")
    )


# --- the whole page -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("width", [PHONE, DESKTOP])
@pytest.mark.parametrize("name", ["evaluation", "comparison", "hostile", "hostile-comparison"])
def test_fits_its_window(name: str, width: int, bare: Page, files: dict[str, Path]) -> None:
    bare.resize(width)
    bare.open(files[name].as_uri())
    assert bare.run("innerWidth") == width
    assert bare.run("document.documentElement.scrollWidth") <= width
    assert bare.run(OUTSIDE) == []
    # No control is cut off by its card.
    cut = (
        "[...document.querySelectorAll('.viewer input, .viewer label')].filter((e) => !e.closest('.unseen') &&"
        " e.getBoundingClientRect().right > e.closest('.viewer').getBoundingClientRect().right).length"
    )
    assert bare.run(cut) == 0
    images = bare.run("[...document.images].map((e) => e.complete && e.naturalWidth > 0)")
    assert all(images)
    assert len(images) == bare.run("document.querySelectorAll('img').length") > 0


def test_without_script_everything_is_there_to_be_read(bare: Page, files: dict[str, Path]) -> None:
    bare.send("Emulation.setScriptExecutionDisabled", value=True)
    bare.open(files["evaluation"].as_uri())
    bare.send("Emulation.setScriptExecutionDisabled", value=False)  # for what the test itself asks
    assert bare.run("document.querySelectorAll('.live').length") == 0
    seen = "[...document.querySelectorAll('#picture-1 .layer img')].map((e) => e.checkVisibility() && e.width > 50)"
    assert bare.run(seen) == [True] * 4
    assert bare.run("document.querySelector('#picture-1 .controls').checkVisibility()") is False
    assert bare.run("document.querySelectorAll('table.sortable tbody tr').length") == 12
    assert bare.run("document.querySelectorAll('table.sortable button').length") == 0


def test_keyboard_reaches_the_table_and_skips_to_it(page: Page) -> None:
    page.press("Tab")
    assert page.run("document.activeElement.textContent") == "Skip to the table"
    page.press("Enter")
    page.press("Tab")
    assert page.run("document.activeElement.getAttribute('aria-labelledby')") == "means-table"
