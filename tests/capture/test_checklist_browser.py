"""The checklist's page in a real browser: what a photographer does with it, and exposures equal to Python's."""

from __future__ import annotations

import json
import re
import time
from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING

import pytest

from capture.camera import EXAMPLE, Shutter
from capture.checklist import html_checklist, make_rows
from capture.cli import main
from capture.plan import Plan, make_plan
from capture.protocol import RELEASED, CaptureProtocol
from tests.capture.simulated import HOSTILE, hostile_plan

if TYPE_CHECKING:
    from pathlib import Path

    from tests.capture.checklist_browser import Page

pytestmark = pytest.mark.browser

DOUBLE_TAP_S = 0.55  # longer than what the page takes for one tap too many


# Listed times, bulb, and measured speeds, ISO 100 and 800 half a stop apart, so that frames get other times.
LISTED = Shutter(("1/9000", "1/3333", "1/1000", "1/100", "1/11", "0.3", "1", "1.1", "4.4"), true_times="as-named")
BULB = Shutter.between("1/8000", "30", Fraction(1, 3), bulb_s=300)
SPEEDS = ((100, Fraction(90)), (800, Fraction(480)), (1600, Fraction(1280)), (3200, Fraction(2592)))
PLANS = {
    "as-named": (replace(EXAMPLE, shutter=LISTED), CaptureProtocol(100, (800, 3200), (1, 2, 10)), Fraction(1)),
    "bulb": (replace(EXAMPLE, shutter=BULB), RELEASED, Fraction(100)),
    "measured": (replace(EXAMPLE, true_isos=SPEEDS), replace(RELEASED, repeats=3, references=2), Fraction(2)),
}


def plan_of(name: str) -> Plan:
    camera, protocol, metered_s = PLANS[name]
    return make_plan(camera, protocol, {"scene-1": metered_s})


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("page") / "checklist.html"
    path.write_text(html_checklist(hostile_plan()), encoding="utf-8")
    return path


@pytest.fixture
def bare(bare: Page) -> Page:
    """It on a phone."""
    bare.resize(390)
    return bare


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
    """By mouse, then by keyboard; undone, the button has the focus."""
    assert page.run("byId('not-kept').hidden && byId('refused').hidden")
    assert page.text("#where") == "scene-1, frame 1 of 16: reference"
    assert (page.text("#next-iso"), page.text("#next-dial")) == ("100", "2 s")
    take(page)
    assert page.text("#where") == "scene-1, frame 2 of 16: noisy ×1"
    assert (page.text("#next-iso"), page.text("#next-dial")) == ("800", "1/4 s")
    assert page.text("#hint") == "Change ISO and shutter."
    assert page.text("#live") == "Taken. Next: scene-1, frame 2 of 16: noisy ×1, ISO 800, 1/4 s."
    page.press("Enter")
    assert page.text("#hint") == "Change shutter."
    assert page.text("#total-text").startswith("2 of ")
    assert page.text("#scene-1-title .count") == "2 of 16"
    assert ticked(page) == ["scene-1/1", "scene-1/2"]
    page.run("byId('undo').focus()")
    page.press("Enter", 2)
    assert (ticked(page), page.run("document.activeElement.id")) == ([], "taken")  # there is nothing to undo any more


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


# --- metered time ---------------------------------------------------------------------------------------------------


def test_one_row_after_the_other(page: Page) -> None:
    """Two taps are one; a frame that is repeated counts again; the next scene follows, and the end is said."""
    page.click("#taken")
    page.click("#taken")
    assert ticked(page) == ["scene-1/1"]
    page.click("#again")
    assert page.text("#scene-1-1 .state") == "Take it again; the last one counts."
    time.sleep(DOUBLE_TAP_S)
    take(page)
    assert page.text("#scene-1-1 .state") == "Taken 2 times; the last one counts."
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


@pytest.mark.parametrize("name", PLANS)
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


def test_timer_counts_the_exposure_and_sounds_at_its_end(bare: Page) -> None:
    """Bulb 102 s, so named; the sounds are laid out in the sound's own clock, which goes on in the background."""
    bare.send("Page.addScriptToEvaluateOnNewDocument", source=SOUNDS + CLOCK)
    timed = show(bare, plan_of("bulb"))
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
    page.run("window.first = lock; rowsOf('scene-1').filter((row) => !row.done).forEach((row) => setDone(row, true))")
    assert page.run("first.released && lock === null")  # the scene is done


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


def test_unreadable_storage_is_set_aside(page: Page) -> None:
    text = '{"prepared": [], "metered": {"scene-1": "2"}, "rows": {}}'
    page.run(f"localStorage.setItem(KEY, {json.dumps(text)})")
    page.reload()
    assert "cannot be read" in page.text("#refused")
    assert ticked(page) == []
    page.click("#scene-1-1 .tick")
    page.reload()
    assert page.run("byId('refused').hidden")
    assert ticked(page) == ["scene-1/1"]
    assert page.run("localStorage.getItem(`${KEY}:unreadable`)") == text


# --- looks, paper -----------------------------------------------------------------------------------------


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


def test_fits_and_has_large_targets(page: Page) -> None:
    page.resize(320)
    page.run("sections.forEach((section) => fold(section, true)); every('.more').forEach((e) => e.click())")
    page.run(f"rows.get('scene-1/1').remark = {json.dumps(HOSTILE)}; showAll()")
    meter(page, "scene-1", "1/10")
    found = page.run(LOOK)
    assert found["width"] <= 320
    assert (found["out"], found["small"], found["unnamed"]) == ([], [], [])
    assert found["targets"] > 200


def test_paper(page: Page) -> None:
    """A page of preparation, one a scene, and the calibration frames; nothing that only a screen needs."""
    take(page)
    assert len(re.findall(rb"/Type\s*/Page\b", page.pdf())) == 5
    page.send("Emulation.setEmulatedMedia", media="print")
    shown = "every('button, select, progress').filter((e) => e.checkVisibility() && !e.matches('.fold')).length"
    assert page.run(shown) == 0
    assert page.run("every('.shot, .notes input').every((e) => e.checkVisibility())")
