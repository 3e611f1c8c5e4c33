"""The checklist's page in a real browser: what a photographer does with it, and exposures equal to Python's."""

from __future__ import annotations

import json
import os
import random
import re
import shutil
import time
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import pytest

from capture.capture_errors import ImpossibleShotError
from capture.checklist import html_checklist, load_progress
from capture.checklist_content import rows
from capture.exact import parse_seconds
from capture.plan import plan_scene
from eldata.errors import ArgumentError
from tests.capture.checklist_browser import Browser, Page
from tests.capture.checklist_plans import HOSTILE, PLANS, plan_of, small
from tests.capture.test_checklist import exported

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from capture.plan import Plan

pytestmark = pytest.mark.browser

PHONE, DESKTOP = 390, 1280
DOUBLE_TAP_S = 0.55  # longer than what the page takes for one tap too many


@pytest.fixture(scope="session")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    found = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if found is None:
        if os.environ.get("ELDATA_REQUIRE_BROWSER"):
            pytest.fail("ELDATA_REQUIRE_BROWSER is set and there is no chromium")
        pytest.skip("no chromium here; apt-get install chromium")
    running = Browser(found, tmp_path_factory.mktemp("browser"))
    yield running
    running.close()


@pytest.fixture(scope="module")
def plan() -> Plan:
    return small()


@pytest.fixture(scope="module")
def file(plan: Plan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("page") / "checklist.html"
    path.write_text(html_checklist(plan), encoding="utf-8")
    return path


@pytest.fixture
def bare(browser: Browser, tmp_path: Path) -> Iterator[Page]:
    page = Page(browser, tmp_path, PHONE, 844)
    yield page
    assert page.problems() == []  # nothing from the network, no error, nothing against the policy
    page.close()


@pytest.fixture
def page(bare: Page, file: Path) -> Page:
    bare.open(file.as_uri())
    return bare


def ticked(page: Page) -> list[str]:
    code = "every('[data-row]').filter((e) => e.querySelector('.tick input').checked).map((e) => e.dataset.row)"
    return list(page.run(code))


def dials(page: Page, scene: str) -> list[str]:
    return list(page.run(f"every('#{scene}-body .dial').map((e) => e.textContent)"))


def take(page: Page, times: int = 1) -> None:
    for _ in range(times):
        page.click("#taken")
        time.sleep(DOUBLE_TAP_S)


def meter(page: Page, scene: str, text: str) -> None:
    if not page.run(f"byId('{scene}-metered').checkVisibility()"):
        page.click(f"#{scene}-title .fold")
    page.type(f"#{scene}-metered", text)
    page.press("Tab")


# --- shooting -------------------------------------------------------------------------------------------------------


def test_next_shot_shows_what_to_dial(page: Page) -> None:
    assert page.text("#where") == "scene-1, frame 1 of 16: reference"
    assert (page.text("#next-iso"), page.text("#next-dial")) == ("100", "2 s")
    take(page)
    assert page.text("#where") == "scene-1, frame 2 of 16: noisy ×1"
    assert (page.text("#next-iso"), page.text("#next-dial")) == ("800", "1/4 s")
    assert page.text("#hint") == "Change ISO and shutter."
    assert page.text("#live") == "Taken. Next: scene-1, frame 2 of 16: noisy ×1, ISO 800, 1/4 s."
    take(page)
    assert page.text("#hint") == "Change shutter."
    assert page.text("#total-text").startswith("2 of ")
    assert page.text("#scene-1-title .count") == "2 of 16"
    assert ticked(page) == ["scene-1/1", "scene-1/2"]


def test_double_tap_is_one_tap_and_undo_takes_it_back(page: Page) -> None:
    page.click("#taken")
    page.click("#taken")
    assert ticked(page) == ["scene-1/1"]
    page.click("#scene-1-3 .tick input")
    page.click("#scene-1-3 .tick input")
    assert ticked(page) == ["scene-1/1", "scene-1/3"]
    page.click("#undo")
    page.click("#undo")
    assert ticked(page) == []
    assert page.run("document.getElementById('undo').disabled")


def test_tick_reload_untick(page: Page, file: Path) -> None:
    page.click("#scene-1-1 .tick")
    page.click('[data-item="tripod"]')
    page.click("#scene-1-1 .more")
    page.type("#scene-1-1 .file", "DSC01234")
    page.type("#scene-1-1 .remark", 'a lamp "blew" </script>')
    page.click("#scene-1-2 .tick")
    page.click("#undo")
    meter(page, "scene-2", "1")
    page.run("(() => { const s = byId('theme'); s.value = 'red'; s.dispatchEvent(new Event('change')); })()")
    before = page.run("JSON.stringify(progress())")
    page.reload()
    assert page.run("JSON.stringify(progress())") == before
    assert ticked(page) == ["scene-1/1"]
    assert page.run("document.querySelector('#scene-1-1 .remark').value") == 'a lamp "blew" </script>'
    assert page.run("document.querySelector('[data-item=tripod]').checked")
    assert page.run("byId('scene-2-metered').value") == "1"
    assert page.run("document.documentElement.dataset.theme") == "red"
    time.sleep(DOUBLE_TAP_S)
    page.click("#scene-1-1 .tick")
    page.reload()
    assert ticked(page) == []
    page.open_tab()
    page.open(file.as_uri())
    assert page.run("rows.get('scene-1/1').file") == "DSC01234"


def test_undo_of_a_tick_leaves_what_was_written_since(page: Page) -> None:
    page.click("#scene-1-1 .tick")
    page.click("#scene-1-1 .more")
    page.type("#scene-1-1 .remark", "kept")
    page.click("#undo")
    assert page.run("[rows.get('scene-1/1').done, rows.get('scene-1/1').remark]") == [False, "kept"]


def test_repeat(page: Page) -> None:
    take(page, 2)
    page.click("#again")
    assert page.text("#where") == "scene-1, frame 2 of 16: noisy ×1"
    assert page.text("#scene-1-2 .state") == "Take it again; the last one counts."
    take(page)
    assert page.text("#scene-1-2 .state") == "Taken 2 times; the last one counts."
    assert page.run("progress().scenes[0].shots[1].repeats") == 1


def test_the_next_scene_follows_and_all_taken_is_said(page: Page) -> None:
    page.run("rowsOf('scene-1').slice(0, -1).forEach((row) => setDone(row, true))")
    take(page)
    assert page.text("#where").startswith("scene-2, frame 1 of 16")
    assert page.run("[byId('scene-1-body').hidden, byId('scene-2-body').hidden]") == [True, False]
    page.run("rowsOf('scene-2').forEach((row) => setDone(row, true))")
    assert page.text("#where") == "calibration, frames 1 to 4: bias, 4 frames"
    assert page.text("#taken") == "Taken, all 4"
    page.run("rowsOf('calibration').forEach((row) => setDone(row, true))")
    assert page.text("#where").startswith("All frames are taken.")
    assert page.run("byId('taken').disabled")


# --- metered time ---------------------------------------------------------------------------------------------------


def test_metered_time_plans_the_scene_anew(page: Page, plan: Plan) -> None:
    for text, metered_s in (("1", 1), ("0.8", Fraction(4, 5)), (" 1,6 s", Fraction(8, 5)), ("7/4", Fraction(7, 4))):
        meter(page, "scene-1", text)
        scene = plan.remeter("scene-1", Fraction(metered_s)).scene("scene-1")
        assert dials(page, "scene-1") == [f"{shot.setting.dial} s" for shot in scene.shots]
        assert page.run("every('#scene-1-remarks li').map((e) => e.textContent)") == list(scene.remarks)
    assert dials(page, "scene-2") == [f"{shot.setting.dial} s" for shot in plan.scene("scene-2").shots]
    page.click("#scene-1-body .slower")
    assert page.run("metered.get('scene-1')") == "2"
    assert page.run("byId('scene-1-metered').value") == "2"


def test_impossible_shots_are_shown_with_what_to_change(page: Page, plan: Plan) -> None:
    meter(page, "scene-1", "1/10")
    with pytest.raises(ImpossibleShotError) as caught:
        plan.remeter("scene-1", Fraction(1, 10))
    problem = page.text("#scene-1-problem")
    assert f"scene-1: {problem}" == str(caught.value)
    assert page.text("#next-problem") == problem
    assert page.run("[byId('taken').disabled, byId('next-problem').hidden]") == [True, False]
    assert page.text("#scene-1-15 .state") == "Impossible: the camera has no time near 1/64000 s."
    assert page.text("#scene-1-2 .state") == ""
    assert page.run("document.querySelector('#scene-1-1 .tick input').disabled")
    page.click("#show")
    assert page.run("document.activeElement.id") == "scene-1-metered"
    page.click("#undo")
    assert page.text("#scene-1-problem") == ""
    assert not page.run("byId('taken').disabled")


def test_what_was_taken_at_another_setting_is_to_be_taken_again(page: Page) -> None:
    take(page)
    meter(page, "scene-1", "1")
    assert ticked(page) == []
    assert page.text("#scene-1-1 .state") == "Taken at 2 s; take it again at this time."
    meter(page, "scene-1", "2")  # as it was after all
    assert ticked(page) == ["scene-1/1"]
    meter(page, "scene-1", "1")
    take(page)
    assert page.run("[progress().scenes[0].shots[0].taken_at, progress().scenes[0].shots[0].repeats]") == ["1", 1]


@pytest.mark.parametrize("text", ["", "soon", "0", "-1", "1/0", "1e3", "<b>", "9999999999"])
def test_no_time_changes_nothing(page: Page, text: str) -> None:
    before = dials(page, "scene-1")
    meter(page, "scene-1", text)
    assert dials(page, "scene-1") == before
    assert page.text("#scene-1-problem").startswith(f'"{text}" is not a time')
    assert page.run("byId('scene-1-metered').getAttribute('aria-invalid')") == "true"


def times_to_try(name: str) -> list[Fraction]:
    """Every time of the camera, between them, at the limits and anywhere."""
    camera = PLANS[name][0]
    named = [time.nominal_s for time in camera.shutter.times]
    given = [Fraction(time.true_s).limit_denominator(10**8) for time in camera.shutter.times]
    between = [
        Fraction(f"{(a.true_s * b.true_s) ** 0.5:.9f}")
        for a, b in zip(camera.shutter.times, camera.shutter.times[1:], strict=False)
    ]
    chance = random.Random(6)  # noqa: S311 - examples, no secrets
    any_times = [Fraction(chance.randint(1, 999), chance.randint(1, 999)) for _ in range(30)]
    wild = [Fraction(1, 999999999), Fraction(999999999), Fraction(999999999, 999999998), Fraction("0.000000001")]
    return [seconds for seconds in dict.fromkeys((*named, *given, *between, *any_times, *wild)) if seconds > 0]


@pytest.mark.parametrize("name", PLANS)
def test_exposures_are_those_of_python(bare: Page, name: str, tmp_path: Path) -> None:
    """Settings, remarks and what to change, to the letter; over half of the times are possible or not by a hair."""
    camera, protocol, _ = PLANS[name]
    (tmp_path / "page.html").write_text(html_checklist(plan_of(name)), encoding="utf-8")
    bare.open((tmp_path / "page.html").as_uri())
    expected: list[Any] = []
    times = times_to_try(name)
    for seconds in times:
        try:
            scene = plan_scene(camera, protocol, "scene-1", seconds)
        except ImpossibleShotError as error:
            expected.append(str(error).removeprefix("scene-1: "))
        else:
            shots = [row.shot for row in rows(scene.shots)]
            expected.append([[[shot.setting.dial, str(shot.target_s)] for shot in shots], list(scene.remarks)])
    found = bare.run(
        f"{json.dumps([str(seconds) for seconds in times])}.map((text) => {{ const scene = sceneShots(fraction(text));"
        " return scene.problem || [scene.shots.map((shot) => [shot.setting.dial, shot.target]), scene.remarks]; })"
    )
    for seconds, ours, theirs in zip(times, expected, found, strict=True):
        assert theirs == ours, seconds
    kinds = [isinstance(item, str) for item in expected]
    assert 0 < sum(kinds) < len(kinds)


def test_seconds_are_read_as_python_reads_them(page: Page) -> None:
    texts = ["1", "1/2", "0.5", ".5", "2/4", "10/4", "007", "1.50", "999999999/999999999", "0.000000001", "1/999999999"]
    texts += [
        "",
        "0",
        "0/1",
        "1/0",
        "0.0",
        "1.",
        "-1",
        "+1",
        "1/2/3",
        "1 /2",
        "1e3",
        "٣",
        "1234567890",
        "1.1234567890",
        "½",
        "1\n",
    ]
    expected: list[str | None] = []
    for text in texts:
        try:
            expected.append(str(parse_seconds(text)))
        except ArgumentError:
            expected.append(None)
    code = f"{json.dumps(texts)}.map((text) => {{ const found = seconds(text); return found && textOf(found); }})"
    assert page.run(code) == expected


# --- export and import ----------------------------------------------------------------------------------------------


def download(page: Page) -> Path:
    path = page.downloads / "SonyA7S2-progress.json"
    path.unlink(missing_ok=True)
    page.click("#export")
    page.wait(path.exists)
    return path


def test_untouched_export_is_what_python_expects(page: Page, plan: Plan) -> None:
    assert json.loads(download(page).read_text(encoding="utf-8")) == exported(plan)


def test_export_is_read_by_python_and_comes_back(
    page: Page, plan: Plan, file: Path, browser: Browser, tmp_path: Path
) -> None:
    page.click("#scene-1-1 .tick")
    page.click("#scene-1-1 .more")
    page.type("#scene-1-1 .file", "DSC\t01234")
    page.type("#scene-1-1 .remark", HOSTILE)
    page.click("#calibration-title .fold")
    page.click("#calibration-1 .tick")
    page.click('[data-item="bias-cap"]')
    meter(page, "scene-2", "3.2")
    path = download(page)
    found = load_progress(path, plan)
    assert found.scenes[0].shots[0].done
    assert found.scenes[0].shots[0].file == "DSC 01234"
    assert found.scenes[0].shots[0].remark.startswith("</script>")
    assert found.calibration[0].done
    assert found.preparation == ("bias-cap",)
    assert found.as_metered(plan) == plan.remeter("scene-2", Fraction(16, 5))

    other = Page(browser, tmp_path / "other", DESKTOP, 900)
    other.open(file.as_uri())
    assert ticked(other) == []  # another profile
    other.choose_file("#import-file", path)
    other.wait(lambda: other.text("#kept") != "")
    assert other.text("#kept") == f"Imported {path.name}."
    assert other.run("JSON.stringify(progress(), null, 1)") + "\n" == path.read_text(encoding="utf-8")
    assert ticked(other) == ["scene-1/1", "calibration/1"]
    other.reload()
    assert ticked(other) == ["scene-1/1", "calibration/1"]
    other.choose_file("#import-file", path)
    other.wait(lambda: other.text("#kept") != "")
    other.run("setDone(rows.get('scene-1/2'), true)")
    other.click("#undo")
    other.click("#undo")
    assert ticked(other) == ["scene-1/1", "calibration/1"]
    assert other.problems() == []
    other.close()


def test_copied_text_is_what_export_writes(page: Page) -> None:
    page.click("#scene-1-1 .tick")
    exported_text = download(page).read_text(encoding="utf-8")
    page.click("#copy")
    page.wait(lambda: page.text("#kept") == "Copied." or page.run("byId('text').checkVisibility()"))
    page.run(
        "Object.defineProperty(navigator, 'clipboard', {value: {writeText: async (text) => { window.copied = text; }}})"
    )
    page.click("#copy")
    page.wait(lambda: page.text("#kept") == "Copied.")
    assert page.run("window.copied") == exported_text
    assert not page.run("byId('text').checkVisibility()")
    page.run("navigator.clipboard.writeText = () => Promise.reject(new DOMException('no', 'NotAllowedError'))")
    page.click("#copy")
    page.wait(lambda: page.run("byId('text').checkVisibility()"))
    assert page.run("byId('text').value") == exported_text
    assert page.run("document.activeElement.id") == "text"


def test_progress_of_an_older_plan_is_taken_as_far_as_it_fits(bare: Page, plan: Plan, tmp_path: Path) -> None:
    grown = plan.add_scene("scene-3", Fraction(2)).only(["scene-2", "scene-3"])
    (tmp_path / "page.html").write_text(html_checklist(grown), encoding="utf-8")
    content = exported(plan)
    content["scenes"][1]["shots"][0]["taken_at"] = "4"
    (tmp_path / "older.json").write_text(json.dumps(content), encoding="utf-8")
    bare.open((tmp_path / "page.html").as_uri())
    bare.choose_file("#import-file", tmp_path / "older.json")
    bare.wait(lambda: bare.text("#kept") != "")
    assert bare.text("#kept") == "Imported older.json. Not in this plan, and left out: scene-1, calibration."
    assert ticked(bare) == ["scene-2/1"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda _: "[", "is not JSON"),
        (lambda _: "null", "it is not the exported progress"),
        (lambda content: json.dumps(content | {"camera": "NikonD850"}), "it is for the camera NikonD850"),
        (lambda content: json.dumps(content | {"schema": 2}), "another version"),
        (lambda content: json.dumps(content | {"scenes": 1}), "its scenes is not a list"),
        (
            lambda content: json.dumps(content).replace('"remark": ""', '"remark": 7', 1),
            "scene-1, row 1: remark is not a text",
        ),
        (
            lambda content: json.dumps(content).replace('"taken_at": null', '"taken_at": 1', 1),
            "scene-1, row 1: taken_at is neither",
        ),
        (
            lambda content: json.dumps(content).replace('"repeats": 0', '"repeats": 1e9', 1),
            "repeats is not a whole number up to 99",
        ),
        (lambda content: json.dumps(content).replace('"metered_s": "2"', '"metered_s": "x"', 1), "no metered time"),
    ],
)
def test_unusable_import_is_refused_and_changes_nothing(
    page: Page, plan: Plan, tmp_path: Path, change: Any, words: str
) -> None:
    page.click("#scene-1-1 .tick")
    path = tmp_path / "bad.json"
    path.write_text(change(exported(plan)), encoding="utf-8")
    page.choose_file("#import-file", path)
    page.wait(lambda: page.text("#refused") != "")
    assert words in page.text("#refused")
    assert ticked(page) == ["scene-1/1"]
    assert page.text("#undo") == "Undo tick scene-1 1"


# --- storage --------------------------------------------------------------------------------------------------------

BROKEN = {
    "refused": (
        "Object.defineProperty(window, 'localStorage', {get() { throw new DOMException('no', 'SecurityError'); }});"
    ),
    "full": "Storage.prototype.setItem = () => { throw new DOMException('full', 'QuotaExceededError'); };",
}


@pytest.mark.parametrize("kind", BROKEN)
def test_without_storage_the_page_says_so_and_works(bare: Page, file: Path, kind: str) -> None:
    bare.send("Page.addScriptToEvaluateOnNewDocument", source=BROKEN[kind])
    bare.open(file.as_uri())
    assert not bare.run("byId('not-kept').hidden")
    take(bare, 2)
    assert ticked(bare) == ["scene-1/1", "scene-1/2"]
    assert bare.run("unsaved")
    assert json.loads(download(bare).read_text())["scenes"][0]["shots"][1]["taken_at"] == "1/4"
    assert not bare.run("unsaved")


def test_with_storage_nothing_is_said(page: Page) -> None:
    assert page.run("byId('not-kept').hidden && byId('refused').hidden")


def test_unreadable_storage_is_set_aside(page: Page) -> None:
    page.run("localStorage.setItem(KEY, '{broken')")
    page.reload()
    assert "cannot be read" in page.text("#refused")
    page.click("#scene-1-1 .tick")
    page.reload()
    assert page.run("byId('refused').hidden")
    assert ticked(page) == ["scene-1/1"]
    assert page.run("localStorage.getItem(`${KEY}:unreadable`)") == "{broken"


# --- keyboard, looks, paper -----------------------------------------------------------------------------------------


def focus(page: Page) -> str:
    return str(
        page.run("document.activeElement.id || document.activeElement.className || document.activeElement.tagName")
    )


def tab_to(page: Page, name: str) -> None:
    for _ in range(60):
        if focus(page) == name:
            return
        page.press("Tab")
    pytest.fail(f"{name} is not reached by Tab")


def test_keyboard_alone(page: Page) -> None:
    page.press("Tab")
    assert focus(page) == "skip"
    page.press("Enter")
    tab_to(page, "taken")
    page.press("Enter")
    time.sleep(DOUBLE_TAP_S)
    page.press("Space")
    assert ticked(page) == ["scene-1/1", "scene-1/2"]
    assert focus(page) == "taken"
    outline = page.run(
        "getComputedStyle(document.activeElement).outlineStyle + getComputedStyle(document.activeElement).outlineWidth"
    )
    assert outline == "solid3px"
    tab_to(page, "undo")
    page.press("Enter")
    page.press("Enter")
    assert ticked(page) == []
    assert focus(page) == "taken"  # Undo has nothing to undo any more
    tab_to(page, "fold")
    page.press("Enter")  # the preparation, out of the way
    tab_to(page, "scene-1-metered")
    page.send("Input.insertText", text="1")
    page.press("Enter")
    assert page.run("metered.get('scene-1')") == "1"
    page.press("Tab", 2)
    page.press("Space")
    assert ticked(page) == ["scene-1/1"]
    page.press("Tab")
    page.press("Enter")
    page.press("Tab")
    page.send("Input.insertText", text="DSC1")
    assert page.run("rows.get('scene-1/1').file") == "DSC1"


LOOK = """(() => {
  const shown = every("body *").filter((e) => e.checkVisibility() && !e.closest(".skip, .unseen"));
  const targets = shown.filter((e) => e.matches("button, select, input[type=text], .tick"));
  const size = (e) => e.getBoundingClientRect();
  return {
    width: document.documentElement.scrollWidth,
    out: shown.filter((e) => size(e).right > innerWidth + .5 || size(e).left < -.5)
      .map((e) => e.outerHTML.slice(0, 90)),
    small: targets.filter((e) => size(e).height < 48 || size(e).width < 48).map((e) => e.outerHTML.slice(0, 90)),
    unnamed: targets.filter((e) => !e.matches(".tick"))
      .filter((e) => !(e.textContent.trim() || e.getAttribute("aria-label") || e.labels?.length))
      .map((e) => e.outerHTML.slice(0, 90)),
    targets: targets.length,
  };
})()"""


@pytest.mark.parametrize("width", [320, PHONE, DESKTOP])
def test_fits_and_has_large_targets(page: Page, width: int) -> None:
    page.resize(width)
    page.run("sections.forEach((section) => fold(section, true)); every('.more').forEach((e) => e.click())")
    page.run(f"rows.get('scene-1/1').remark = {json.dumps(HOSTILE)}; showAll()")
    meter(page, "scene-1", "1/10")
    found = page.run(LOOK)
    assert found["width"] <= width
    assert (found["out"], found["small"], found["unnamed"]) == ([], [], [])
    assert found["targets"] > 200


CONTRASTS = """(() => {
  const parse = (text) => (text.match(/[\\d.]+/g) || []).map(Number);
  const light = ([r, g, b]) => [r, g, b].map((v) => v / 255)
    .map((v) => v <= .04045 ? v / 12.92 : ((v + .055) / 1.055) ** 2.4)
    .reduce((sum, v, i) => sum + v * [.2126, .7152, .0722][i], 0);
  const ground = (e) => {
    for (let one = e; one; one = one.parentElement) {
      const colour = parse(getComputedStyle(one).backgroundColor);
      if (colour.length === 3) return colour;  // with a fourth number it is transparent
    }
    return parse(getComputedStyle(document.documentElement).backgroundColor);
  };
  const ratio = (a, b) => (Math.max(light(a), light(b)) + .05) / (Math.min(light(a), light(b)) + .05);
  const texts = every("body *").filter((e) => e.checkVisibility() && !e.closest(".unseen, script, style, noscript")
    && (e.matches("input, select") || [...e.childNodes].some((n) => n.nodeType === 3 && n.textContent.trim())));
  const edges = every("button, select, input[type=text], .tick input")
    .filter((e) => e.checkVisibility() && !e.matches(".fold"));
  return {
    texts: texts.map((e) => [ratio(parse(getComputedStyle(e).color), ground(e)), e.outerHTML.slice(0, 80)]),
    edges: edges.map((e) => [
      ratio(parse(getComputedStyle(e).borderTopColor), ground(e.parentElement)), e.outerHTML.slice(0, 80)]),
    page: light(ground(document.body)),
  };
})()"""


@pytest.mark.parametrize("theme", ["dark", "red", "amber", "light"])
def test_contrast(page: Page, theme: str) -> None:
    page.run(f"setTheme('{theme}'); setDone(rows.get('scene-1/2'), true); repeat(rows.get('scene-1/2'))")
    meter(page, "scene-1", "1/10")
    page.run("fold('scene-2', true); byId('not-kept').hidden = false; refuse('Refused')")
    found = page.run(CONTRASTS)
    assert len(found["texts"]) > 100
    assert [text for text in found["texts"] if text[0] < 4.5] == []
    assert [edge for edge in found["edges"] if edge[0] < 3] == []
    if theme != "light":
        assert found["page"] == 0


def test_motion_only_where_it_is_welcome(page: Page) -> None:
    behaviour = "getComputedStyle(document.documentElement).scrollBehavior"
    assert page.run(behaviour) == "smooth"
    page.send("Emulation.setEmulatedMedia", features=[{"name": "prefers-reduced-motion", "value": "reduce"}])
    assert page.run(behaviour) == "auto"


def test_paper(page: Page) -> None:
    """A page of preparation, one a scene, and the calibration frames; nothing that only a screen needs."""
    take(page)
    assert len(re.findall(rb"/Type\s*/Page\b", page.pdf())) == 5
    page.send("Emulation.setEmulatedMedia", media="print")
    assert (
        page.run("every('button, select, progress').filter((e) => e.checkVisibility() && !e.matches('.fold')).length")
        == 0
    )
    assert page.run("every('.shot').every((e) => e.checkVisibility())")
    assert page.run("every('.notes input').every((e) => e.checkVisibility())")
    found = page.run(CONTRASTS)
    assert min(ratio for ratio, _ in found["texts"]) > 10
    assert found["page"] == 1


def test_without_scripts_the_page_is_whole(bare: Page, file: Path) -> None:
    bare.send("Emulation.setScriptExecutionDisabled", value=True)
    bare.open(file.as_uri())
    nodes = bare.send("DOMSnapshot.captureSnapshot", computedStyles=["display"])
    strings = nodes["strings"]
    shown = " ".join(strings[index] for index in nodes["documents"][0]["layout"]["text"] if index >= 0)
    for words in ("does not run here", "1/800 s", "Tripod on firm ground", "Flat-field frames"):
        assert words in shown
    for words in ("Next shot", "Export", "Note"):
        assert words not in shown.replace("Notes", "")


def test_repeated_frames_are_one_row(bare: Page, tmp_path: Path) -> None:
    """Three noisy frames of a setting are ticked at once, and come home as three."""
    plan = plan_of("measured")
    (tmp_path / "page.html").write_text(html_checklist(plan), encoding="utf-8")
    bare.open((tmp_path / "page.html").as_uri())
    assert bare.text("#where") == "scene-1, frames 1 to 2: reference, 2 frames"
    assert bare.text("#taken") == "Taken, all 2"
    take(bare, 2)
    assert bare.text("#total-text") == "5 of 44 frames"
    found = load_progress("progress.json", plan, json.dumps(bare.run("progress()")).encode())
    assert [(row.number, row.count) for row in found.scenes[0].shots if row.done] == [(1, 2), (3, 3)]
