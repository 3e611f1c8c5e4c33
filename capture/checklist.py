"""The checklist of a plan: one page for a phone or tablet in the dark, or plain text, or Markdown.

The page is one file with its style and script inside; its policy lets it load nothing else. What is entered stays in
the browser, under the plan's digest. A scene may meter differently from the plan: the page has the shots for every time
on the camera's dial, as :mod:`capture.shots` plans them.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from capture.capture_errors import ImpossibleShotError
from capture.observed import format_f_number
from capture.shots import ScenePlan, Shot, format_minutes, plan_shots
from eldata.base.fields import shipped_toml
from eldata.base.tables import aligned_markdown, markdown_text, one_line, text_table

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from capture.plan import Plan

__all__ = ["FORMATS", "html_checklist", "markdown_checklist", "plan_digest", "text_checklist"]

TEMPLATES: Final = Path(__file__).parent / "templates"
_WORDS = TEMPLATES / "checklist.toml"
_TITLES: Final = {"bias": "Bias frames", "flats": "Flat-field frames"}
_LONGEST_TEXT: Final = 500  # characters of a file's name or a remark
_MOST_REPEATS: Final = 99
_TO_BE_TIMED_S: Final = 1  # shorter exposures are over before a button is pressed


@dataclass(frozen=True, slots=True)
class ChecklistRow:
    """A row with one box to tick: a shot, or successive shots with the same settings.

    Attributes
    ----------
    shot
        The (first) shot.
    count
        How many shots the row stands for.
    """

    shot: Shot
    count: int

    @property
    def numbers(self) -> str:
        """Number, or first and last: ``1-10``."""
        first = self.shot.number
        return str(first) if self.count == 1 else f"{first}-{first + self.count - 1}"

    @property
    def dial(self) -> str:
        """Exposure time, by its mark on the camera."""
        return self.shot.setting.dial

    @property
    def what(self) -> str:
        """The role in words, with what belongs to it."""
        words: str = self.shot.role
        if self.shot.factor is not None:
            words = f"noisy x{self.shot.factor}"
        if self.shot.level is not None:
            words = f"flat {float(100 * self.shot.level):.0f} %"
        return words if self.count == 1 else f"{words}, {self.count} frames"


def make_rows(shots: Iterable[Shot]) -> tuple[ChecklistRow, ...]:
    """Make checklist rows of shots; successive shots with equal settings share a row."""

    def settings(shot: Shot) -> tuple[object, ...]:
        """List the settings that shots of one row share."""
        return shot.role, shot.iso, shot.setting.dial, shot.factor, shot.reference, shot.level

    groups = [list(group) for _, group in groupby(shots, key=settings)]
    return tuple(ChecklistRow(group[0], len(group)) for group in groups)


@dataclass(frozen=True, slots=True)
class CalibrationPart:
    """Calibration frames of one kind: ``"bias"`` or ``"flats"``, with what to do before."""

    kind: str
    title: str
    items: tuple[Mapping[str, str], ...]
    shots: tuple[Shot, ...]

    @property
    def rows(self) -> tuple[ChecklistRow, ...]:
        """The rows of its shots."""
        return make_rows(self.shots)


def calibration_parts(plan: Plan) -> tuple[CalibrationPart, ...]:
    """Return the plan's calibration frames by kind, in the order in which they are taken."""
    kinds: dict[str, list[Shot]] = {}
    for shot in () if plan.calibration is None else plan.calibration.shots:
        kinds.setdefault("flats" if shot.role == "flat" else "bias", []).append(shot)
    return tuple(
        CalibrationPart(kind, _TITLES[kind], read_items(kind, plan), tuple(shots)) for kind, shots in kinds.items()
    )


def read_items(kind: str, plan: Plan) -> tuple[Mapping[str, str], ...]:
    """Read the tasks before the first shot (``"preparation"``), or before calibration frames of a kind.

    Each item has a ``name`` (what is ticked stays ticked when the words change), a ``text`` and, in one line, ``why``.
    """
    return tuple(item | {"text": _fill_text(item["text"], plan)} for item in shipped_toml(_WORDS)[kind])


def read_steps(plan: Plan) -> tuple[str, ...]:
    """Read the steps at each scene."""
    return tuple(_fill_text(text, plan) for text in shipped_toml(_WORDS)["at_each_scene"])


def _fill_text(text: str, plan: Plan) -> str:
    """Fill a text's placeholders with the plan's base ISO, files, extension and step of the shutter."""
    return text.format(
        base_iso=plan.protocol.base_iso,
        files=len(plan.shots),
        raw_extension=plan.camera.raw_extension,
        step=plan.camera.shutter.step,
    )


# --- the page ---------------------------------------------------------------------------------------------------------


def plan_digest(plan: Plan) -> str:
    """Hash a plan's decisions as ``sha256:<hex>``; notes may change without losing ticks."""
    content = plan.as_dict()
    for scene in content["scenes"]:
        del scene["notes"], scene["shots"]
    return f"sha256:{hashlib.sha256(_dump_json(content).encode()).hexdigest()}"


def _dump_json(data: object) -> str:
    """Write data as JSON without spaces, keys sorted."""
    return json.dumps(data, sort_keys=True, separators=(",", ":"))


def html_checklist(plan: Plan) -> str:
    """Return the checklist as a page; the same plan gives the same page."""
    from eldata.reports.html import policy_hash, render_page

    # With the line end that stands before them in the page, since the policy's hashes are of elements' whole content.
    style, script = ("\n" + (TEMPLATES / f"checklist.{suffix}").read_text(encoding="utf-8") for suffix in ("css", "js"))
    # No text in the data can close its script element.
    data = _dump_json(_collect_data(plan)).replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
    return render_page(
        "checklist.html",
        TEMPLATES,
        plan=plan,
        format_f_number=format_f_number,
        time_needed=format_minutes(plan.duration_s),
        scene_rows=[(scene, make_rows(scene.shots)) for scene in plan.scenes],
        parts=calibration_parts(plan),
        preparation=read_items("preparation", plan),
        at_each_scene=read_steps(plan),
        longest_text=_LONGEST_TEXT,
        data=data,
        style=style,
        script=script,
        style_hash=policy_hash(style),
        script_hash=policy_hash(script),
    )


def _collect_data(plan: Plan) -> dict[str, Any]:
    """Collect the data that the page's script computes with."""

    def frames(rows: Iterable[ChecklistRow]) -> list[dict[str, Any]]:
        """List number, count, ISO and dial of each row."""
        return [{"number": r.shot.number, "count": r.count, "iso": r.shot.iso, "dial": r.dial} for r in rows]

    parts, times = calibration_parts(plan), plan.camera.shutter.times
    items = [*read_items("preparation", plan), *(item for part in parts for item in part.items)]
    return {
        "digest": plan_digest(plan),
        "dials": [time.dial for time in times],
        "lasting": {time.dial: round(time.true_s, 2) for time in times if time.true_s >= _TO_BE_TIMED_S},
        "times": _list_times(plan),
        "frames": frames(make_rows(plan.scenes[0].shots) if plan.scenes else ()),
        "scenes": [{"name": scene.name, "metered": str(scene.metered_s)} for scene in plan.scenes],
        "calibration": frames(row for part in parts for row in part.rows),
        "preparation": [item["name"] for item in items],
        "most_repeats": _MOST_REPEATS,
    }


def _list_times(plan: Plan) -> list[dict[str, Any]]:
    """List the times that a scene may be metered at: its rows' dials, as indices, and remarks; or what to change.

    These are the times on the camera's dial, and those that the plan's scenes were metered at.
    """
    index = {time: number for number, time in enumerate(plan.camera.shutter.times)}
    shown = {scene.metered_s: str(scene.metered_s) for scene in plan.scenes}
    shown |= {time.nominal_s: time.dial for time in index}
    rows = []
    for metered_s in sorted(shown):
        row: dict[str, Any] = {"metered": str(metered_s), "shown": shown[metered_s]}
        try:
            scene = ScenePlan("", metered_s, plan_shots(plan.camera, plan.protocol, metered_s))
        except ImpossibleShotError as error:
            row["problem"] = str(error)
        else:
            row |= {"dials": [index[line.shot.setting] for line in make_rows(scene.shots)], "remarks": scene.remarks}
        rows.append(row)
    return rows


# --- text and Markdown: the same content as the page, to print or to paste into notes ---------------------------------


_HEADER = ("", "frame", "what", "ISO", "set", "compare", "file", "remark")
_LEFT = (0, 2, 6, 7)


def text_checklist(plan: Plan) -> str:
    """Return the checklist as plain text."""
    return _format_checklist(
        plan,
        lambda level, text: f"{text}\n{'=-'[level - 1] * len(text)}",
        one_line,
        lambda cells: text_table(_HEADER, cells, _LEFT),
    )


def markdown_checklist(plan: Plan) -> str:
    """Return the checklist as Markdown; its tables are aligned for reading as they stand."""
    return _format_checklist(
        plan,
        lambda level, text: f"{'#' * level} {text}",
        markdown_text,
        lambda cells: aligned_markdown((_HEADER, *cells), _LEFT),
    )


def _format_checklist(
    plan: Plan,
    heading: Callable[[int, str], str],
    plain: Callable[[str], str],
    table: Callable[[Sequence[Sequence[str]]], str],
) -> str:
    """Write a plan's checklist in a format given by its functions of headings, plain text and tables."""

    def boxes(items: Iterable[Mapping[str, str]]) -> str:
        """Write a box to tick for each item."""
        return "\n".join(f"- [ ] {item['text']}. {item['why']}" for item in items)

    def rows(shots: Iterable[Shot]) -> str:
        """Write the table of shots."""
        return table([_format_row(row) for row in make_rows(shots)])

    protocol = plan.protocol
    counted = f"{plan.extent}, {len(plan.shots)} frames, {format_minutes(plan.duration_s)} of shooting"
    parts = [
        heading(1, f"Capture checklist: {plain(plan.camera.name)}"),
        f"{counted}; base ISO {protocol.base_iso}.",
        heading(2, "Preparation"),
        boxes(read_items("preparation", plan)),
    ]
    if plan.scenes:
        steps = (f"{number}. {text}" for number, text in enumerate(read_steps(plan), 1))
        parts += [heading(2, "At each scene"), "\n".join(steps)]
    for scene in plan.scenes:
        at = f"ISO {protocol.base_iso}{'' if scene.aperture is None else f', {format_f_number(scene.aperture)}'}"
        lines = [f"Planned for a metered time of {scene.metered_s} s at {at}. Metered: ________ s"]
        lines += [f"Note: {plain(note)}" for note in scene.notes] + [plain(remark) for remark in scene.remarks]
        parts += [heading(2, scene.name), "\n".join(f"- {line}" for line in lines), rows(scene.shots)]
    for part in calibration_parts(plan):
        remarks = plan.calibration.remarks if plan.calibration is not None and part.kind == "flats" else ()
        before = "\n".join([boxes(part.items), *(f"- {plain(remark)}" for remark in remarks)])
        parts += [heading(2, part.title), before, rows(part.shots)]
    return "\n\n".join(parts) + "\n"


def _format_row(row: ChecklistRow) -> tuple[str, ...]:
    """List a row's cells: numbers, role, ISO, time, the reference to compare with, and blanks to fill in."""
    compared = "" if row.shot.reference is None else f"with {row.shot.reference}"
    return ("[ ]", row.numbers, row.what, str(row.shot.iso), f"{row.dial} s", compared, "_" * 12, "_" * 16)


FORMATS: Final[dict[str, Callable[[Plan], str]]] = {
    "html": html_checklist,
    "md": markdown_checklist,
    "txt": text_checklist,
}
"""What writes each kind of checklist, by the end of its file's name."""
