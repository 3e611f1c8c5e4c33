"""Blocks of code with columns, such as tables, keep their lines; the style breaks long lines of all others."""

from __future__ import annotations

import re
from collections import Counter
from typing import TYPE_CHECKING

from docutils import nodes

if TYPE_CHECKING:
    from sphinx.application import Sphinx

_RULE = re.compile(r"^ *-{2,} {2,}-{2,}", re.MULTILINE)
_ROW = re.compile(r"^ *\S+(?: \S+)* {2,}\S+(?: \S+)* {2,}\S", re.MULTILINE)
_SECOND = re.compile(r"^( *\S+(?: \S+)* {2,})[^\s#]", re.MULTILINE)
_PART = re.compile(r"(?<=::)|(?<=[/_.(])(?=\w)")
_FITS, _SHORT = 88, 20  # characters: of a line at full size; of a name that need not be broken


def has_columns(text: str) -> bool:
    """Whether a text has a table's rule, two lines of three columns, or three whose second ones begin alike.

    Comments do not count as a column.
    """
    seconds = Counter(len(line[1]) for line in _SECOND.finditer(text))
    return bool(_RULE.search(text)) or len(_ROW.findall(text)) > 1 or max(seconds.values(), default=0) > 2


def mark(_app: Sphinx, doctree: nodes.document, _docname: str) -> None:
    """Give them the classes that the style knows; long names in tables break behind their parts."""
    for block in doctree.findall(nodes.literal_block):
        text = block.astext()
        if has_columns(text):
            block["classes"].append("columns")
            if max(map(len, text.splitlines())) > _FITS:
                block["classes"].append("wide")
    for entry in doctree.findall(nodes.entry):
        for name in list(entry.findall(nodes.literal)):
            if len(name.astext()) > _SHORT:
                parts = [part for part in _PART.split(name.astext()) if part]
                name.children = []
                for part in parts:
                    name += [nodes.Text(part), nodes.raw("", "<wbr>", format="html")]


def setup(app: Sphinx) -> dict[str, bool]:
    """Sphinx's entry point."""
    app.connect("doctree-resolved", mark)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
