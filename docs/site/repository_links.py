"""Pages that stand elsewhere in the repository, and links between them and those of docs.

Everything stays readable where it stands. A page of the site that holds ``<!-- page: CHANGELOG.md -->`` shows that
file, with what else the page has before its second heading; links lead to the site's own page of a file where there
is one. Where a page holds ``<!-- found by: black level -->``, a search for these words finds it first.
"""

from __future__ import annotations

import os
import re
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sphinx.application import Sphinx

ROOT = Path(__file__).parents[2]
SHOWN = {
    "README.md": "docs/index.md",
    "CHANGELOG.md": "docs/project/changelog.md",
    "CONTRIBUTING.md": "docs/project/contributing.md",
    "CODE_OF_CONDUCT.md": "docs/project/conduct.md",
    "SECURITY.md": "docs/project/security.md",
    "benchmarks/RESULTS.md": "docs/project/benchmarks.md",
}
_COMMENT = re.compile(r"<!-- page: (\S+) -->")
_FOUND_BY = re.compile(r"^<!-- found by: (.+) -->$", re.MULTILINE)
_LINK = re.compile(r"(?<=\]\()(?![a-z]+:|#)([^)\s#]+)(?=[)#])")
_CODE = re.compile(r"(^```.*?^```$|`[^`\n]+`)", re.MULTILINE | re.DOTALL)


def relinked(text: str, written_in: str, page: str) -> str:
    """Return a text whose links, relative to the file that it was written in, lead to the same from a page."""

    def target(match: re.Match[str]) -> str:
        named = os.path.normpath(PurePosixPath(written_in).parent / match[1]).replace(os.sep, "/")
        shown = SHOWN.get(named, named)
        return os.path.relpath(shown, PurePosixPath(page).parent).replace(os.sep, "/")

    pieces = _CODE.split(text)
    pieces[::2] = [_LINK.sub(target, piece) for piece in pieces[::2]]
    return "".join(pieces)


def read(app: Sphinx, docname: str, source: list[str]) -> None:
    """Put in the file that a page shows, and lead all links to where they are met here."""
    file = Path(app.env.doc2path(docname))
    if file.suffix != ".md":
        return
    page = f"docs/{docname}.md"

    def shown(match: re.Match[str]) -> str:
        app.env.note_dependency(str(ROOT / match[1]), docname=docname)
        return relinked((ROOT / match[1]).read_text(encoding="utf-8"), match[1], page)

    found = _COMMENT.search(source[0])
    if found is None:
        text = relinked(source[0], page, page)
    else:
        before, heading, after = shown(found).partition("\n## ")
        text = f"{before}\n{source[0][found.end() :]}{heading}{after}"
    source[0] = _FOUND_BY.sub(r"```{index} ! \1\n```", text)


def setup(app: Sphinx) -> dict[str, bool]:
    """Sphinx's entry point."""
    app.connect("source-read", read)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
