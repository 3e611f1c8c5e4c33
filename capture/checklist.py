"""The checklist of a plan: one page for a phone or tablet in the dark, or plain text, or Markdown.

The page is one file with its style and script inside; its policy lets it load nothing else. What is entered stays in
the browser, under the plan's digest, and can be exported (:func:`load_progress`). A scene that meters differently from
the plan is planned again in the page, with the rounding of :mod:`capture.shots`: there in sixth powers, which turn the
camera's halves and thirds of a stop into fractions.
"""

from __future__ import annotations

import base64
import hashlib
import json
from fractions import Fraction
from typing import TYPE_CHECKING, Any, Final

from capture.apertures import f_text
from capture.checklist_content import (
    TEMPLATES,
    at_each_scene,
    calibration_parts,
    every_item,
    preparation,
    rows,
)
from capture.checklist_progress import (
    KIND,
    LONGEST_TEXT,
    MOST_REPEATS,
    SCHEMA,
    Progress,
    ProgressError,
    SceneProgress,
    ShotProgress,
    load_progress,
)
from capture.checklist_text import markdown_checklist, text_checklist
from capture.shots import light_share, minutes

if TYPE_CHECKING:
    from collections.abc import Callable

    from capture.checklist_content import ChecklistRow
    from capture.exact import ExactNumber
    from capture.plan import Plan

__all__ = [
    "FORMATS",
    "Progress",
    "ProgressError",
    "SceneProgress",
    "ShotProgress",
    "html_checklist",
    "load_progress",
    "markdown_checklist",
    "plan_digest",
    "text_checklist",
]


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
        protocol=plan.protocol,
        calibration=plan.calibration,
        frames=len(plan.shots),
        time_needed=minutes(plan.duration.total_s),
        scene_rows=[(scene, rows(scene.shots)) for scene in plan.scenes],
        parts=calibration_parts(plan),
        preparation=preparation(plan),
        at_each_scene=at_each_scene(plan),
        longest_text=LONGEST_TEXT,
        data=_embedded(_page_data(plan)),
        style=style,
        script=script,
        style_hash=_policy_hash(style),
        script_hash=_policy_hash(script),
    )


FORMATS: Final[dict[str, Callable[[Plan], str]]] = {
    "html": html_checklist,
    "md": markdown_checklist,
    "txt": text_checklist,
}
"""What writes each kind of checklist, by the end of its file's name."""


def _policy_hash(text: str) -> str:
    """Return how a page's policy names the one script, or style, that may run."""
    return f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}"


def _embedded(data: dict[str, Any]) -> str:
    """Return JSON that may stand in a ``script`` element: no text in it can close that."""
    text = json.dumps(data, sort_keys=True, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _page_data(plan: Plan) -> dict[str, Any]:
    """Return what the page's script computes with."""
    camera, protocol = plan.camera, plan.protocol
    return {
        "kind": KIND,
        "schema": SCHEMA,
        "digest": plan_digest(plan),
        "camera": camera.name,
        "isos": camera.isos,
        "base_iso": protocol.base_iso,
        "noisy_isos": protocol.noisy_isos,
        "step_sixth": str(Fraction(2) ** int(6 * camera.shutter.step)),
        "times": [
            {"dial": time.dial, "nominal": str(time.nominal_s), "sixth": str(_sixth_power(time.true_exact))}
            for time in camera.shutter.times
        ],
        "fitting": _fitting(plan),
        "frames": [_page_frame(plan, row) for row in rows(plan.scenes[0].shots)] if plan.scenes else [],
        "scenes": [{"name": scene.name, "metered": str(scene.metered_s)} for scene in plan.scenes],
        "calibration": [row.as_dict() for part in calibration_parts(plan) for row in part.rows],
        "preparation": [item.name for item in every_item(plan)],
        "longest_text": LONGEST_TEXT,
        "most_repeats": MOST_REPEATS,
    }


def _page_frame(plan: Plan, row: ChecklistRow) -> dict[str, Any]:
    frame = plan.protocol.frames()[row.number - 1]
    light = light_share(plan.camera, plan.protocol, frame)
    return row.as_dict() | {"factor": frame.factor, "reference": frame.reference, "light": str(light)}


def _sixth_power(number: ExactNumber) -> Fraction:
    # Steps are thirds, halves or whole stops, so that six of them are whole.
    return number.coefficient**6 * Fraction(2) ** int(6 * number.stops)


def _fitting(plan: Plan) -> list[int]:
    """Return the indices of the first and last setting for the references at which all shots fit."""
    camera, protocol = plan.camera, plan.protocol
    scales = [light_share(camera, protocol, frame) for frame in protocol.frames() if frame.factor is not None]
    ends = (min(scales), max(scales))
    found = [
        index
        for index, time in enumerate(camera.shutter.times)
        if all(camera.nearest(time.true_exact * scale) is not None for scale in ends)
    ]
    return [found[0], found[-1]] if found else []
