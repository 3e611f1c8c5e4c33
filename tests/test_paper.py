"""The page on the paper: each of its rows is whole, and every test, file and public name that it gives is there."""

from __future__ import annotations

import ast
import importlib
import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "paper.md").read_text(encoding="utf-8")
ROWS = 79
COLUMNS = 5  # place, what the paper says, status, where it is, test or difference


def rows(page: str) -> list[list[str]]:
    """The cells of each row of the page's tables, without heads and rules."""
    found = [
        [cell.strip() for cell in line.strip().strip("|").split("|")] for line in page.splitlines() if line[:1] == "|"
    ]
    return [row for row in found if row[0] != "place" and set("".join(row)) != {"-"}]


def functions_of(file: Path) -> set[str]:
    """The functions of a module, which is not run."""
    return {node.name for node in ast.parse(file.read_bytes()).body if isinstance(node, ast.FunctionDef)}


def is_public(name: str) -> bool:
    """Whether a module promises a name, so that it can be imported from there."""
    module, _, last = name.rpartition(".")
    place = importlib.import_module(module)
    return last in place.__all__ and hasattr(place, last)


def problems(page: str) -> list[str]:
    """What is wrong with the page, in words."""
    table = rows(page)
    found = [] if len(table) == ROWS else [f"{len(table)} rows"]
    found += [f"a cell is empty: {row}" for row in table if len(row) != COLUMNS or "" in row]
    found += [f"status {row[2]}" for row in table if row[2] not in {"same", "differs", "not had"}]
    found += [f"no test of {row[1]}" for row in table if row[2] == "same" and "::" not in row[-1]]
    for file, test in re.findall(r"`(tests/[^`:]+)::(\w+)`", page):
        if not (ROOT / file).is_file() or test not in functions_of(ROOT / file):
            found.append(f"{file}::{test} is not there")
    for link in re.findall(r"\]\((?!https:)([^)#]+)", page):
        if not (ROOT / "docs" / link).exists():
            found.append(f"{link} is not there")
    found += [
        f"{name} is not public" for name in re.findall(r"`((?:eldata|capture)\.[\w.]+)`", page) if not is_public(name)
    ]
    return found


def test_the_page_is_true() -> None:
    assert problems(PAGE) == []
    assert len(re.findall("::test_", PAGE)) == len(re.findall(r"`tests/[^`:]+::test_\w+`", PAGE)) > 60
