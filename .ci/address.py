"""What a package index shows: links, and README with whole addresses, where the repository's address is known.

No file here names that address, which a move or a fork would make wrong; the workflow that releases gives it:
``ELDATA_ADDRESS=https://HOST/OWNER/NAME python -m hatchling build``. Without it README is as it stands.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface

_LINK = re.compile(r"(!?)(\[[^\]]*\])\((?!https?:|#)([^)\s]+)\)")
_PAGES = {"Repository": "", "Documentation": "tree/{tag}/docs", "Changelog": "blob/{tag}/CHANGELOG.md"}
_PAGES |= {"Issues": "issues", "Security": "security"}


def whole(text: str, address: str, tag: str) -> str:
    """Return a text of Markdown whose links and pictures, relative to the repository, are those of a tag of it."""

    def target(match: re.Match[str]) -> str:
        picture, label, path = match.groups()
        return f"{picture}{label}({address}/{'raw' if picture else 'blob'}/{tag}/{path})"

    return _LINK.sub(target, text).replace("<this repository>", address)


class Address(MetadataHookInterface):
    """Readme and links of the metadata."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Fill them in."""
        text = (Path(self.root) / "README.md").read_text(encoding="utf-8")
        address, tag = os.environ.get("ELDATA_ADDRESS", "").rstrip("/"), f"v{metadata['version']}"
        metadata["urls"] = {}
        if address:
            text = whole(text, address, tag)
            metadata["urls"] = {name: f"{address}/{page.format(tag=tag)}".rstrip("/") for name, page in _PAGES.items()}
        metadata["readme"] = {"content-type": "text/markdown", "text": text}
