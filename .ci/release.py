"""Make sure that a tag may be released, and print the notes of the release.

python .ci/release.py v0.2.0 > notes.md
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]


def notes(tag: str, version: str, changelog: str, citation: str) -> str:
    """Return the changelog's section of a version.

    Raises
    ------
    ValueError
        If the tag, the package's version, the changelog's dated section and CITATION.cff do not agree.
    """
    if tag != f"v{version}":
        raise ValueError(f"the tag is {tag}, eldata/__init__.py has version {version}: expected the tag v{version}")
    if f"\nversion: {version}\n" not in citation:
        raise ValueError(f"CITATION.cff: expected the line 'version: {version}'")
    heading = rf"^## {re.escape(version)} \(\d{{4}}-\d\d-\d\d\)$"
    section = re.search(rf"{heading}\n(.*?)(?=^## |\Z)", changelog, re.MULTILINE | re.DOTALL)
    if section is None:
        raise ValueError(f"CHANGELOG.md: expected the heading '## {version} (YYYY-MM-DD)' with the day of the release")
    return section[1].strip() + "\n"


def version_of(source: str) -> str:
    """Return the version that the text of ``eldata/__init__.py`` states.

    Raises
    ------
    ValueError
        If it states none.
    """
    match = re.search(r'^__version__ = "([^"]+)"$', source, re.MULTILINE)
    if match is None:
        raise ValueError('eldata/__init__.py: expected a line such as __version__ = "0.2.0"')
    return match[1]


def main(tag: str) -> None:
    """Print the notes of the release with this tag."""
    package, changelog, citation = (
        (ROOT / name).read_text(encoding="utf-8") for name in ("eldata/__init__.py", "CHANGELOG.md", "CITATION.cff")
    )
    sys.stdout.write(notes(tag, version_of(package), changelog, citation))


if __name__ == "__main__":
    try:
        main(*sys.argv[1:2] or [""])
    except ValueError as error:
        sys.exit(str(error))
