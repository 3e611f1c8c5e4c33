"""The protocols that come with the package, by name: ``shipped.toml``, which says what each follows."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eldata.base.fields import TextFile
from eldata.errors import ArgumentError
from eldata.protocols.clips import ClipProtocol
from eldata.protocols.protocol import Protocol

if TYPE_CHECKING:
    from collections.abc import Mapping

_CONTENT = TextFile(Path(__file__).parent / "shipped.toml", ArgumentError).toml().data


def _shipped(content: Mapping[str, Any]) -> dict[str, Protocol]:
    texts: dict[str, str] = {}
    for name, text in content["texts"].items():
        texts[name] = text.strip().format_map(texts)
    made: dict[str, Protocol] = {}
    for kind, protocol in (("images", Protocol), ("clips", ClipProtocol)):
        for name, stated in content[kind].items():
            fields = {"name": name} | {field: _value(value, texts) for field, value in stated.items()}
            base = fields.pop("base", None)
            made[name] = protocol(**fields) if base is None else replace(made[base], **fields)
    return made


def _value(value: Any, texts: dict[str, str]) -> Any:
    """Return a field as a protocol has it: lists as tuples, texts put in, no text at all as ``None``."""
    if isinstance(value, list):
        return tuple(value)
    return value.strip().format_map(texts) or None if isinstance(value, str) else value


PROTOCOLS: dict[str, Protocol] = _shipped(_CONTENT)
"""Those of images and those of clips, by name."""

FAMILIES: tuple[str, ...] = tuple(dict.fromkeys(p.family for p in PROTOCOLS.values() if p.family))
"""Names that stand for one protocol per dataset."""
