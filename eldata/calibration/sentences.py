"""What a calibration says: findings, remarks and why there is no profile, by name (``sentences.toml``)."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

from eldata.base.fields import TextFile
from eldata.errors import ArgumentError


@cache
def read_sentences() -> dict[str, dict[str, str]]:
    """Read the sentences of each kind by name."""
    content: dict[str, Any] = TextFile(Path(__file__).with_name("sentences.toml"), ArgumentError).toml().data
    return content


def describe(kind: str, **words: object) -> str:
    """Return a sentence by kind and name, such as ``remarks.drift``, with its words filled in."""
    group, _, name = kind.partition(".")
    return read_sentences()[group][name].format(**words)
