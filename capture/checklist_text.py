"""The checklist as plain text and as Markdown: the same content as the page, to print or to fold into notes."""

from __future__ import annotations

import re
import unicodedata
from typing import TYPE_CHECKING

from capture.checklist_content import BEFORE_BIAS, BEFORE_FLATS, at_each_scene, bias_and_flats, preparation, rows
from eldata.base.tables import text_table

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from capture.checklist_content import ChecklistRow, Item
    from capture.plan import Plan

_HEADER = ("", "frame", "what", "ISO", "set", "compare", "file", "remark")
_LEFT = (0, 2, 6, 7)


def text_checklist(plan: Plan) -> str:
    """Return the checklist as plain text."""
    return _checklist(plan, _Text())


def markdown_checklist(plan: Plan) -> str:
    """Return the checklist as Markdown; its tables are aligned for reading as they stand."""
    return _checklist(plan, _Markdown())


class _Text:
    def heading(self, level: int, text: str) -> str:
        return f"{text}\n{'=-'[level - 1] * len(text)}"

    def plain(self, text: str) -> str:
        return _one_line(text)

    def table(self, cells: Sequence[Sequence[str]]) -> str:
        return text_table(_HEADER, cells, left=_LEFT)


class _Markdown:
    def heading(self, level: int, text: str) -> str:
        return f"{'#' * level} {text}"

    def plain(self, text: str) -> str:
        return re.sub(r"([\\`*_{}\[\]<>()#+\-.!|~&$:])", r"\\\1", _one_line(text))

    def table(self, cells: Sequence[Sequence[str]]) -> str:
        widths = [max(3, *(len(cell) for cell in column)) for column in zip(_HEADER, *cells, strict=True)]
        rules = ["-" * width if index in _LEFT else "-" * (width - 1) + ":" for index, width in enumerate(widths)]
        lines = [
            [
                cell.ljust(width) if index in _LEFT else cell.rjust(width)
                for index, (cell, width) in enumerate(zip(line, widths, strict=True))
            ]
            for line in (_HEADER, rules, *cells)
        ]
        return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _checklist(plan: Plan, form: _Text | _Markdown) -> str:
    protocol = plan.protocol
    parts = [
        form.heading(1, f"Capture checklist: {form.plain(plan.camera.name)}"),
        f"{len(plan.scenes)} scenes, {len(plan.shots)} frames; base ISO {protocol.base_iso}.",
        form.heading(2, "Preparation"),
        _items(preparation(plan)),
    ]
    if plan.scenes:
        steps = (f"{number}. {text}" for number, text in enumerate(at_each_scene(plan), 1))
        parts += [form.heading(2, "At each scene"), "\n".join(steps)]
    for scene in plan.scenes:
        notes = [f"- Note: {form.plain(note)}" for note in scene.notes]
        remarks = [f"- {form.plain(remark)}" for remark in scene.remarks]
        metered = f"- Planned for a metered time of {scene.metered_s} s at ISO {protocol.base_iso}. Metered: ________ s"
        parts += [
            form.heading(2, scene.name),
            "\n".join([metered, *notes, *remarks]),
            _rows(rows(scene.shots), form.table),
        ]
    if plan.calibration is not None:
        bias, flats = bias_and_flats(plan)
        remarks = [f"- {form.plain(remark)}" for remark in plan.calibration.remarks]
        parts += [form.heading(2, "Bias frames"), _items(BEFORE_BIAS), _rows(bias, form.table)]
        parts += [
            form.heading(2, "Flat-field frames"),
            "\n".join([_items(BEFORE_FLATS), *remarks]),
            _rows(flats, form.table),
        ]
    return "\n\n".join(parts) + "\n"


def _items(items: Sequence[Item]) -> str:
    return "\n".join(f"- [ ] {item.text}. {item.why}" for item in items)


def _rows(found: Sequence[ChecklistRow], table: Callable[[Sequence[Sequence[str]]], str]) -> str:
    return table(
        [
            (
                "[ ]",
                row.numbers,
                row.what,
                str(row.iso),
                f"{row.dial} s",
                "" if row.reference is None else f"with {row.reference}",
                "_" * 12,
                "_" * 16,
            )
            for row in found
        ]
    )


def _one_line(text: str) -> str:
    """Return a text without line breaks, and without what would steer a terminal."""
    return "".join(c for c in " ".join(text.split()) if unicodedata.category(c) not in ("Cc", "Cf", "Cs"))
