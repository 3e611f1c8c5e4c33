"""The page on the paper: each of its rows is whole, and every public name that it gives is there."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "paper.md").read_text(encoding="utf-8")
ROWS = 79
COLUMNS = 4  # place, what the paper says, where it is, status with test or difference


def rows(page: str) -> list[list[str]]:
    """The cells of each row of the page's tables, without heads and rules."""
    found = [
        [cell.strip() for cell in line.strip().strip("|").split("|")] for line in page.splitlines() if line[:1] == "|"
    ]
    return [row for row in found if row[0] != "place" and set("".join(row)) != {"-"}]


def is_public(name: str) -> bool:
    """Whether a module promises a name, so that it can be imported from there."""
    module, _, last = name.rpartition(".")
    place = importlib.import_module(module)
    return last in place.__all__ and hasattr(place, last)


def test_the_page_is_true() -> None:
    table = rows(PAGE)
    assert len(table) == ROWS
    assert [row for row in table if len(row) != COLUMNS or "" in row] == []
    assert {row[-1].partition(": ")[0] for row in table} == {"same", "differs", "not had"}
    assert [row for row in table if row[-1].startswith("same: ") and "::" not in row[-1]] == []
    names = set(re.findall(r"`((?:eldata|capture)\.[\w.]+)`", PAGE))
    assert {name for name in names if not is_public(name)} == set()
