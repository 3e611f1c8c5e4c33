"""The contact sheet: one HTML page that needs no network, with each scene's pictures and what was found."""

from __future__ import annotations

import base64
from typing import TYPE_CHECKING

from capture.checklist_content import TEMPLATES
from eldata.base.files import write_text
from eldata.base.tables import with_error
from eldata.errors import ArgumentError

if TYPE_CHECKING:
    from pathlib import Path

    from capture.check.result import CheckReport, SheetPicture


def write_sheet(path: Path | str, report: CheckReport) -> None:
    """Write the contact sheet of a report, whole or not at all.

    Raises
    ------
    ArgumentError
        If the name does not end in .html.
    """
    check_sheet_name(path)
    write_text(path, sheet_page(report))


def check_sheet_name(path: Path | str) -> None:
    """Raise :class:`ArgumentError` unless a contact sheet can have this name."""
    if not str(path).endswith((".html", ".htm")):
        raise ArgumentError(f"--sheet {path}: the contact sheet is an HTML page: end its name in .html")


def sheet_page(report: CheckReport) -> str:
    """Return the page; the same report gives the same text."""
    from eldata.reports.html import rendered

    return rendered("sheet.html", TEMPLATES, report=report, source=_source, with_error=with_error)


def _source(picture: SheetPicture) -> str:
    return f"data:image/jpeg;base64,{base64.b64encode(picture.jpeg).decode()}"
