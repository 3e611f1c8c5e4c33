"""Pages with scripts of ours: they sort tables, move sliders, link crops, and the policy lets no other run."""

from __future__ import annotations

import base64
import hashlib
from pathlib import Path
from typing import Final

from eldata.reports.html import rendered

_TEMPLATES: Final = Path(__file__).parents[1] / "templates"


def rendered_with_script(template: str, *more: str, **values: object) -> str:
    """Return a page whose template puts ``script`` into a script element, as it is; no other may run there.

    It is evaluation.js, and after it the scripts named in ``more``.
    """
    script = "\n".join((_TEMPLATES / name).read_text(encoding="utf-8") for name in ("evaluation.js", *more))
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")
    return rendered(template, script=script, script_policy=f"; script-src 'sha256-{digest}'", **values)


def jpeg_uri(jpeg: bytes) -> str:
    """Return a picture as the address of itself."""
    return f"data:image/jpeg;base64,{base64.b64encode(jpeg).decode('ascii')}"
