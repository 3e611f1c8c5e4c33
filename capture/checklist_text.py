"""The checklist as plain text and as Markdown: the same content as the page, to print or to paste into notes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from capture.apertures import f_text
from capture.checklist_content import at_each_scene, before_moment, calibration_parts, preparation, rows
from capture.shots import minutes
from eldata.base.tables import aligned_markdown, markdown_text, one_line, text_table

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from capture.checklist_content import ChecklistRow, Item
    from capture.plan import Plan

    Rows = Sequence[Sequence[str]]

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
        metered = [f"- Planned for a metered time of {scene.metered_s} s at {at}. Metered: ________ s"]
        moment = [f"- {text}" for text in (before_moment(plan, scene),) if text]
        if scene.moment > 1:
            metered, remarks = [], []  # as of the first
        parts += [
            heading(2, scene.name),
            "\n".join([*metered, *moment, *notes, *remarks]),
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
