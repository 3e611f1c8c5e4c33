"""docs/calibration.md says what to do about each remark and each check: from the sources, so that none is forgotten."""

from __future__ import annotations

import ast
import re
from pathlib import Path
from typing import TYPE_CHECKING

from eldata.calibration.iso_results import CHECKS

if TYPE_CHECKING:
    from collections.abc import Iterator

ROOT = Path(__file__).parents[2]
DOCS = (ROOT / "docs" / "calibration.md").read_text(encoding="utf-8")
ROOM = ROOT / "eldata/calibration"
SOURCES = {path.relative_to(ROOM).as_posix(): path.read_text("utf-8") for path in sorted(ROOM.rglob("*.py"))}
# Where remarks are made otherwise than by remarks.append(...): the functions that return them.
RETURNED = {("one_iso.py", "no_pairs"), ("frames.py", "unequal_pair"), ("iso_results.py", "FailedIso")}


def text_of(node: ast.expr) -> str:
    """A text as it is written, with "…" for what is put in."""
    match node:
        case ast.Constant(value=str() as text):
            return text
        case ast.JoinedStr(values=parts):
            return "".join(text_of(part) for part in parts)
        case ast.FormattedValue():
            return "…"
    return ""


def remarks_in(module: str, source: str) -> Iterator[str]:
    for node in ast.walk(ast.parse(source)):
        match node:
            case ast.Call(func=ast.Attribute(value=ast.Name(id="remarks"), attr="append"), args=[given]):
                if text_of(given):
                    yield text_of(given)
            case ast.FunctionDef(name=name) | ast.ClassDef(name=name) if (module, name) in RETURNED:
                for inner in ast.walk(node):
                    if isinstance(inner, ast.Return) and inner.value is not None and len(text_of(inner.value)) > 1:
                        yield text_of(inner.value)


REMARKS = sorted({remark for module, source in SOURCES.items() for remark in remarks_in(module, source)})


def phrases() -> list[list[str]]:
    """What the first column of the table of remarks quotes; "…" in it stands for anything."""
    table = DOCS[DOCS.index("### What a remark says") : DOCS.index("### What a plot shows")]
    cells = [line.split(" | ")[0] for line in table.splitlines() if line.startswith('| "')]
    return [quoted.split(" … ") for cell in cells for quoted in re.findall(r'"([^"]+)"', cell)]


def test_each_remark_is_documented() -> None:
    assert len(REMARKS) > 20
    for remark in REMARKS:
        assert any(all(part in remark for part in phrase) for phrase in phrases()), remark


def test_each_documented_remark_is_made() -> None:
    """Some are literal elsewhere: the figures' names, or the remark of flats alone."""
    made = re.sub(r'"\s*f?"', "", "\n".join(SOURCES.values()))
    assert [phrase for phrase in phrases() if not all(part in made for part in phrase)] == []


def test_each_check_is_documented() -> None:
    assert sorted(check.name for check in CHECKS) == sorted(re.findall(r"^\| `([^`]+)` \|", DOCS, re.MULTILINE))
