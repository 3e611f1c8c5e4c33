"""The checklist's page in a real browser: what a photographer does with it, and exposures equal to Python's."""

from __future__ import annotations

import json
import re
import time
from fractions import Fraction
from typing import TYPE_CHECKING

import pytest

from capture.checklist import html_checklist, make_rows
from capture.cli import main
from capture.plan import Plan
from tests.capture.checklist_browser import Browser, Page
from tests.capture.checklist_plans import HOSTILE, plan_of, small

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

pytestmark = pytest.mark.browser

PHONE, DESKTOP = 390, 1280
DOUBLE_TAP_S = 0.55  # longer than what the page takes for one tap too many


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


def show(page: Page, plan: Plan) -> Page:
    """Open a plan's checklist."""
    path = page.downloads / "page.html"
    path.write_text(html_checklist(plan), encoding="utf-8")
    page.open(path.as_uri())
    return page


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
    """Choose a metered time in a scene's list."""
    if not page.run(f"byId('{scene}-metered').checkVisibility()"):
        page.click(f"#{scene}-title .fold")
    page.run(
        f"(() => {{ const e = byId('{scene}-metered'); e.value = '{text}'; e.dispatchEvent(new Event('change')); }})()"
    )


# --- shooting -------------------------------------------------------------------------------------------------------


def test_next_shot_shows_what_to_dial(page: Page) -> None:
    assert page.run("byId('not-kept').hidden && byId('refused').hidden")
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
    before = page.run("JSON.stringify(entered())")
    page.reload()
    assert page.run("JSON.stringify(entered())") == before
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


def test_undo_survives_a_reload(page: Page) -> None:
    take(page)
    page.click('[data-item="tripod"]')
    meter(page, "scene-1", "1")
    before = page.run("JSON.stringify(entered())")
    page.click("#scene-1-3 .tick")
    page.reload()
    assert page.text("#undo") == "Undo tick scene-1 3"
    page.click("#undo")
    assert page.run("JSON.stringify(entered())") == before
    page.reload()
    for label in ("metered time of scene-1", "tick", "tick scene-1 1"):
        assert page.text("#undo") == f"Undo {label}"
        page.click("#undo")
    assert page.run("[byId('undo').disabled, prepared.size, metered.get('scene-1')]") == [True, 0, "2"]
    assert ticked(page) == []
    page.reload()
    assert page.run("byId('undo').disabled")


def test_undo_is_bounded_and_of_this_page(page: Page) -> None:
    page.run("for (let i = 0; i < 400; i += 1) { setDone(rows.get('scene-1/1'), i % 2 === 0); }")
    kept = page.run("localStorage.getItem(UNDO)")
    assert 50_000 < len(kept) <= 100_000
    assert page.run("JSON.stringify(undoable)") == kept
    wrong = (
        "{",
        "{}",
        '[{"rows": {"scene-9/1": {}}}]',
        kept.replace("scene-1/1", "scene-9/1"),
        kept.replace('"2"', '"7"'),
    )
    for text in wrong:
        page.run(f"localStorage.setItem(UNDO, {json.dumps(text)})")
        page.reload()
        assert page.run("[undoable.length, byId('undo').disabled, byId('refused').hidden]") == [0, True, True]


def test_two_tabs_share_what_undo_takes_back(page: Page, file: Path) -> None:
    first = page.tab
    page.open_tab()
    page.open(file.as_uri())
    take(page)
    page.tab = first
    page.wait(lambda: ticked(page) == ["scene-1/1"] and page.text("#undo") == "Undo tick scene-1 1")
    page.run("undo()")  # a tab in the background draws nothing to click on
    assert ticked(page) == []


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
    assert page.run("rows.get('scene-1/2').repeats") == 1


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


def test_a_time_that_cannot_be_shot_changes_nothing(page: Page) -> None:
    """What is said of it, of every time: below."""
    take(page)
    before = page.run("JSON.stringify(entered())")
    meter(page, "scene-1", "1/10")
    assert page.text("#scene-1-problem").endswith("The shots below are still those of 2 s.")
    assert page.run("JSON.stringify(entered())") == before
    assert page.run("byId('scene-1-metered').value") == "2"
    assert page.text("#undo") == "Undo tick scene-1 1"
    meter(page, "scene-1", "8/5")
    assert page.run("byId('scene-1-problem').hidden")
    page.click("#scene-1-body .slower")
    assert page.run("[metered.get('scene-1'), byId('scene-1-metered').selectedOptions[0].label]") == ["2", "2 s"]


def test_what_was_taken_at_another_setting_is_to_be_taken_again(page: Page) -> None:
    take(page)
    meter(page, "scene-1", "1")
    assert ticked(page) == []
    assert page.text("#scene-1-1 .state") == "Taken at 2 s; take it again at this time."
    assert page.text("#live").startswith("scene-1 is planned for 1 s. 1 shots were taken at other settings")
    meter(page, "scene-1", "2")  # as it was after all
    assert ticked(page) == ["scene-1/1"]
    meter(page, "scene-1", "1")
    take(page)
    assert page.run("[rows.get('scene-1/1').takenAt, rows.get('scene-1/1').repeats]") == ["1", 1]


@pytest.mark.parametrize("name", ["thirds", "as-named", "bulb", "measured", "two-times"])
def test_every_time_on_the_dial_gives_what_remeter_gives(
    bare: Page, name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What the page shows for a time is what `capture plan --remeter` makes of it: dials, remarks, or the refusal."""
    plan = plan_of(name)
    plan.save(tmp_path / "plan.json")
    show(bare, plan)
    times = sorted({time.nominal_s for time in plan.camera.shutter.times} | {plan.scenes[0].metered_s})
    assert bare.run("every('#scene-1-metered option').map((e) => e.value)") == [str(seconds) for seconds in times]
    refused = 0
    for seconds in times:
        meter(bare, "scene-1", str(seconds))
        command = ["plan", str(tmp_path / "plan.json"), "--remeter", f"scene-1={seconds}"]
        if main(command):
            refused += 1
            expected = capsys.readouterr().err.removeprefix("capture plan: scene-1: ").strip()
            assert bare.text("#scene-1-problem").startswith(f"{expected}. The shots below are still those of ")
            continue
        assert bare.run("byId('scene-1-problem').hidden"), seconds
        capsys.readouterr()
        scene = Plan.load(tmp_path / "plan.json").scene("scene-1")
        assert dials(bare, "scene-1") == [f"{row.dial} s" for row in make_rows(scene.shots)]
        assert bare.run("every('#scene-1-remarks li').map((e) => e.textContent)") == list(scene.remarks)
        assert bare.run("metered.get('scene-1')") == str(seconds)
    assert 0 < refused < len(times)


def test_a_plans_own_metered_time_is_in_the_list(bare: Page, plan: Plan) -> None:
    """Between two times of the dial, or written otherwise than the camera writes it."""
    odd = plan.remeter("scene-1", Fraction(7, 4)).remeter("scene-2", Fraction(13, 10))
    show(bare, odd)
    labels = "['scene-1', 'scene-2'].map((name) => byId(`${name}-metered`).selectedOptions[0].label)"
    assert bare.run(labels) == ["7/4 s", "1.3 s"]
    assert bare.text("#scene-1-remarks li") == odd.scene("scene-1").remarks[0]
    meter(bare, "scene-1", "2")
    meter(bare, "scene-1", "7/4")
    assert dials(bare, "scene-1") == [f"{row.dial} s" for row in make_rows(odd.scene("scene-1").shots)]


# --- timer, screen --------------------------------------------------------------------------------------------------

# Notes when each sound begins and how it is cut off; the browser's own classes make it.
SOUNDS = """
window.sounded = [];
window.OscillatorNode = class extends OscillatorNode {
  start(at) { super.start(at); window.began ??= this.context.currentTime; window.sounded.push(at); }
};
"""
# The clock of the page stands still; `later` lets seconds pass.
CLOCK = "(() => { const now = Date.now(); window.later = 0; Date.now = () => now + 1000 * window.later; })();"


@pytest.fixture
def timed(bare: Page) -> Page:
    bare.send("Page.addScriptToEvaluateOnNewDocument", source=SOUNDS + CLOCK)
    return show(bare, plan_of("bulb"))


def test_timer_counts_the_exposure_and_sounds_at_its_end(timed: Page) -> None:
    """Bulb 102 s, so named; the sounds are laid out in the sound's own clock, which goes on in the background."""
    assert (timed.text("#next-dial"), timed.text("#timer")) == ("bulb 102 s", "Start timer, 102 s")
    timed.click("#timer")
    assert timed.text("#timer") == "Stop timer"
    assert timed.text("#left") == "102 s"
    timed.wait(lambda: timed.run("sounded.length") == 4)
    first, *others = timed.run("sounded")
    assert [at - first for at in others] == pytest.approx([1, 2, 3])
    assert 3 < first - timed.run("began") <= 99
    timed.run("later = 101.5; showTimer()")
    assert timed.text("#left") == "1 s"
    timed.run("later = 102; 0")
    timed.wait(lambda: timed.text("#say") == "The time is over.")
    assert timed.text("#live") == "The time is over."
    assert (timed.text("#left"), timed.text("#timer")) == ("", "Start timer, 102 s")
    assert ticked(timed) == []  # whether it was taken, the photographer knows


def test_timer_stops_by_hand_and_when_the_shot_is_taken(timed: Page) -> None:
    timed.click("#timer")
    time.sleep(DOUBLE_TAP_S)
    timed.click("#timer")
    assert (timed.text("#left"), timed.run("timer")) == ("", None)
    timed.wait(lambda: timed.run("audio.state") == "suspended")
    time.sleep(DOUBLE_TAP_S)
    timed.click("#timer")
    timed.wait(lambda: timed.run("audio.state") == "running")
    assert timed.text("#left") == "102 s"
    take(timed)
    assert (timed.text("#left"), timed.run("timer")) == ("", None)
    assert timed.run("rows.get('scene-1/1').takenAt") == "bulb 102"


def test_timer_is_offered_from_one_second_and_knows_what_the_camera_gives(page: Page) -> None:
    """A shutter that says 15 s is open for 16 s; 1/4 s needs no timer."""
    assert page.text("#timer") == "Start timer, 2 s"
    meter(page, "scene-1", "15")
    assert page.text("#timer") == "Start timer, 16 s"
    meter(page, "scene-1", "2")
    take(page)
    assert not page.run("byId('timer').checkVisibility()")
    before = page.run("byId('taken').offsetTop")
    page.click("#undo")
    assert page.run("byId('taken').offsetTop") == before


def test_the_button_to_tick_keeps_its_place(page: Page) -> None:
    """From shot to shot, with a timer and without: never from under a finger in the dark."""
    code = "byId('taken').offsetTop"
    found = page.run(f"rowsOf('scene-1').slice(0, -1).map((row) => {{ setDone(row, true); return {code}; }})")
    page.click("#timer")
    assert {page.run(code), *found} == {found[0]}
    page.run("byId('next-iso').textContent = '12800'; byId('next-dial').textContent = '1/8000 s'")
    assert page.run(code) == found[0]


def test_timer_without_sound_says_so(bare: Page, file: Path) -> None:
    bare.send("Page.addScriptToEvaluateOnNewDocument", source="delete window.AudioContext;")
    bare.open(file.as_uri())
    bare.click("#timer")
    assert bare.text("#say") == "No sound here: watch the seconds."
    assert bare.text("#left") == "2 s"


def held(page: Page) -> bool:
    return bool(page.run("lock !== null && lock.released === false"))


def test_screen_stays_on_while_a_scene_is_shot(page: Page) -> None:
    """Chromium's own lock, from a file."""
    assert page.run("'wakeLock' in navigator && byId('not-awake').hidden")
    assert not held(page)
    take(page)
    page.wait(lambda: held(page))
    page.run("lock.release()")  # as the browser does when the page is hidden
    page.wait(lambda: page.run("lock") is None)
    page.run("document.dispatchEvent(new Event('visibilitychange'))")
    page.wait(lambda: held(page))
    page.reload()
    page.wait(lambda: held(page))  # in the middle of a scene
    page.run("window.first = lock; rowsOf('scene-1').filter((row) => !row.done).forEach((row) => setDone(row, true))")
    assert page.run("first.released && lock === null")  # the scene is done
    page.click("#timer")
    page.wait(lambda: held(page))
    assert page.run("byId('not-awake').hidden")


def test_without_a_wake_lock_the_page_says_so(bare: Page, file: Path) -> None:
    bare.send("Page.addScriptToEvaluateOnNewDocument", source="delete Navigator.prototype.wakeLock;")
    bare.open(file.as_uri())
    assert bare.text("#not-awake").startswith("This browser does not keep the screen on for this page")
    assert bare.run("byId('not-awake').checkVisibility()")
    take(bare)
    assert ticked(bare) == ["scene-1/1"]


def test_a_refused_wake_lock_is_said(page: Page) -> None:
    page.run("WakeLock.prototype.request = () => Promise.reject(new DOMException('low battery', 'NotAllowedError'))")
    assert not page.run("byId('not-awake').checkVisibility()")
    take(page)
    page.wait(lambda: bool(page.run("byId('not-awake').checkVisibility()")))


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


@pytest.mark.parametrize("text", ["{broken", '{"prepared": [], "metered": {"scene-1": "2"}, "rows": {}}'])
def test_unreadable_storage_is_set_aside(page: Page, text: str) -> None:
    page.run(f"localStorage.setItem(KEY, {json.dumps(text)})")
    page.reload()
    assert "cannot be read" in page.text("#refused")
    assert ticked(page) == []
    page.click("#scene-1-1 .tick")
    page.reload()
    assert page.run("byId('refused').hidden")
    assert ticked(page) == ["scene-1/1"]
    assert page.run("localStorage.getItem(`${KEY}:unreadable`)") == text


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
    page.press("ArrowUp", 3)
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


@pytest.mark.parametrize("width", [320, DESKTOP])
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


def test_contrast(page: Page) -> None:
    page.run("setDone(rows.get('scene-1/2'), true); repeat(rows.get('scene-1/2'))")
    meter(page, "scene-1", "1/10")
    page.run("fold('scene-2', true); for (const name of ['not-kept', 'refused']) byId(name).hidden = false")
    for theme in ("dark", "red", "amber", "light"):
        page.run(f"setTheme('{theme}')")
        found = page.run(CONTRASTS)
        assert len(found["texts"]) > 100
        assert [text for text in found["texts"] if text[0] < 4.5] == [], theme
        assert [edge for edge in found["edges"] if edge[0] < 3] == [], theme
        bar = page.run("document.querySelector('meta[name=theme-color]').content")  # of the phone's browser
        if theme != "light":
            assert (found["page"], bar) == (0, "rgb(0, 0, 0)")


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
    for words in ("Next shot", "Home again", "Note"):
        assert words not in shown.replace("Notes", "")


def test_repeated_frames_are_one_row(bare: Page) -> None:
    """Three noisy frames of a setting are ticked at once, and count as three."""
    plan = plan_of("measured")
    show(bare, plan)
    assert bare.text("#where") == "scene-1, frames 1 to 2: reference, 2 frames"
    assert bare.text("#taken") == "Taken, all 2"
    take(bare, 2)
    assert bare.text("#total-text") == "5 of 44 frames"
    assert ticked(bare) == ["scene-1/1", "scene-1/3"]
