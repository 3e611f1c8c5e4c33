"""The checklist of a plan: one page for a phone or tablet in the dark, or plain text, or Markdown.

The page is one file with its style and script inside; its policy lets it load nothing else. What is entered stays in
the browser, under the plan's digest. A scene may meter differently from the plan: the page has the shots for every time
on the camera's dial, as :mod:`capture.shots` plans them.
"""

from __future__ import annotations

import base64
import hashlib
import json
from typing import TYPE_CHECKING, Any, Final

from capture.capture_errors import ImpossibleShotError
from capture.checklist_content import (
    TEMPLATES,
    at_each_scene,
    calibration_parts,
    every_item,
    preparation,
    rows,
)
from capture.observed import f_text
from capture.shots import ScenePlan, minutes, scene_shots
from eldata.base.tables import aligned_markdown, markdown_text, one_line, text_table

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from capture.checklist_content import ChecklistRow, Item
    from capture.plan import Plan

    Rows = Sequence[Sequence[str]]

__all__ = [
    "FORMATS",
    "html_checklist",
    "markdown_checklist",
    "plan_digest",
    "text_checklist",
]


_LONGEST_TEXT: Final = 500  # characters of a file's name or a remark
_MOST_REPEATS: Final = 99
_TO_BE_TIMED_S: Final = 1  # shorter exposures are over before a button is pressed


def plan_digest(plan: Plan) -> str:
    """Return ``sha256:<hex>`` of what a plan decides; notes may change without losing what was ticked."""
    content = plan.as_dict()
    for scene in content["scenes"]:
        del scene["notes"], scene["shots"]
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return f"sha256:{hashlib.sha256(text.encode()).hexdigest()}"


def html_checklist(plan: Plan) -> str:
    """Return the checklist as a page; the same plan gives the same page."""
    from eldata.reports.html import rendered

    # With the line end that stands before them in the page, since the policy's hashes are of elements' whole content.
    style, script = ("\n" + (TEMPLATES / f"checklist.{suffix}").read_text(encoding="utf-8") for suffix in ("css", "js"))
    return rendered(
        "checklist.html",
        TEMPLATES,
        plan=plan,
        f_text=f_text,
        time_needed=minutes(plan.duration.total_s),
        scene_rows=[(scene, rows(scene.shots)) for scene in plan.scenes],
        parts=calibration_parts(plan),
        preparation=preparation(plan),
        at_each_scene=at_each_scene(plan),
        longest_text=_LONGEST_TEXT,
        data=_embedded(_page_data(plan)),
        style=style,
        script=script,
        style_hash=_policy_hash(style),
        script_hash=_policy_hash(script),
    )


def _policy_hash(text: str) -> str:
    """Return how a page's policy names the one script, or style, that may run."""
    return f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}"


def _embedded(data: dict[str, Any]) -> str:
    """Return JSON that may stand in a ``script`` element: no text in it can close that."""
    text = json.dumps(data, sort_keys=True, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _page_data(plan: Plan) -> dict[str, Any]:
    """Return what the page's script computes with."""
    camera = plan.camera
    return {
        "digest": plan_digest(plan),
        "dials": [time.dial for time in camera.shutter.times],
        "lasting": {time.dial: round(time.true_s, 2) for time in camera.shutter.times if time.true_s >= _TO_BE_TIMED_S},
        "times": _times(plan),
        "frames": [row.as_dict() for scene in plan.scenes[:1] for row in rows(scene.shots)],
        "scenes": [{"name": scene.name, "metered": str(scene.metered_s)} for scene in plan.scenes],
        "calibration": [row.as_dict() for part in calibration_parts(plan) for row in part.rows],
        "preparation": [item.name for item in every_item(plan)],
        "most_repeats": _MOST_REPEATS,
    }


def _times(plan: Plan) -> list[dict[str, Any]]:
    """Return for each time that a scene may be metered at: its rows' dials, as indices, and remarks; or what to change.

    These are the times on the camera's dial, and those that the plan's scenes were metered at.
    """
    times = plan.camera.shutter.times
    index = {time: number for number, time in enumerate(times)}
    shown = {scene.metered_s: str(scene.metered_s) for scene in plan.scenes}
    shown |= {time.nominal_s: time.dial for time in times}
    found = []
    for metered_s in sorted(shown):
        row: dict[str, Any] = {"metered": str(metered_s), "shown": shown[metered_s]}
        try:
            scene = ScenePlan("", metered_s, scene_shots(plan.camera, plan.protocol, metered_s))
        except ImpossibleShotError as error:
            row["problem"] = str(error)
        else:
            row |= {"dials": [index[one.shot.setting] for one in rows(scene.shots)], "remarks": scene.remarks}
        found.append(row)
    return found


# --- text and Markdown: the same content as the page, to print or to paste into notes ---------------------------------


_HEADER = ("", "frame", "what", "ISO", "set", "compare", "file", "remark")
_LEFT = (0, 2, 6, 7)


def text_checklist(plan: Plan) -> str:
    """Return the checklist as plain text."""

    def heading(level: int, text: str) -> str:
        return f"{text}\n{'=-'[level - 1] * len(text)}"

    return _checklist(plan, heading, one_line, lambda cells: text_table(_HEADER, cells, _LEFT))


def markdown_checklist(plan: Plan) -> str:
    """Return the checklist as Markdown; its tables are aligned for reading as they stand."""

    def heading(level: int, text: str) -> str:
        return f"{'#' * level} {text}"

    return _checklist(plan, heading, markdown_text, lambda cells: aligned_markdown((_HEADER, *cells), _LEFT))


def _checklist(
    plan: Plan, heading: Callable[[int, str], str], plain: Callable[[str], str], table: Callable[[Rows], str]
) -> str:
    protocol = plan.protocol
    counted = f"{plan.extent}, {len(plan.shots)} frames, {minutes(plan.duration.total_s)} of shooting"
    parts = [
        heading(1, f"Capture checklist: {plain(plan.camera.name)}"),
        f"{counted}; base ISO {protocol.base_iso}.",
        heading(2, "Preparation"),
        _items(preparation(plan)),
    ]
    if plan.scenes:
        steps = (f"{number}. {text}" for number, text in enumerate(at_each_scene(plan), 1))
        parts += [heading(2, "At each scene"), "\n".join(steps)]
    for scene in plan.scenes:
        notes = [f"- Note: {plain(note)}" for note in scene.notes]
        remarks = [f"- {plain(remark)}" for remark in scene.remarks]
        at = f"ISO {protocol.base_iso}{'' if scene.aperture is None else f', {f_text(scene.aperture)}'}"
        metered = f"- Planned for a metered time of {scene.metered_s} s at {at}. Metered: ________ s"
        parts += [
            heading(2, scene.name),
            "\n".join([metered, *notes, *remarks]),
            _rows(rows(scene.shots), table),
        ]
    for part in calibration_parts(plan):
        said = plan.calibration.remarks if plan.calibration is not None and part.kind == "flats" else ()
        before = "\n".join([_items(part.items), *(f"- {plain(remark)}" for remark in said)])
        parts += [heading(2, part.title), before, _rows(part.rows, table)]
    return "\n\n".join(parts) + "\n"


def _items(found: Sequence[Item]) -> str:
    return "\n".join(f"- [ ] {item.text}. {item.why}" for item in found)


def _rows(found: Sequence[ChecklistRow], table: Callable[[Rows], str]) -> str:
    return table(
        [
            (
                "[ ]",
                row.numbers,
                row.what,
                str(row.shot.iso),
                f"{row.dial} s",
                "" if row.shot.reference is None else f"with {row.shot.reference}",
                "_" * 12,
                "_" * 16,
            )
            for row in found
        ]
    )


FORMATS: Final[dict[str, Callable[[Plan], str]]] = {
    "html": html_checklist,
    "md": markdown_checklist,
    "txt": text_checklist,
}
"""What writes each kind of checklist, by the end of its file's name."""
