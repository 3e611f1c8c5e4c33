"""What a calibration says: findings, remarks and why there is no profile, by name (``sentences.toml``)."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from eldata.base.fields import TextFile
from eldata.errors import ArgumentError

if TYPE_CHECKING:
    from collections.abc import Mapping


@cache
def read_sentences() -> Mapping[str, Mapping[str, str]]:
    """Read the sentences of each kind by name."""
    return TextFile(Path(__file__).with_name("sentences.toml"), ArgumentError).toml().data


def describe(kind: str, **words: object) -> str:
    """Return a sentence by kind and name, such as ``remarks.drift``, with its words filled in."""
    group, _, name = kind.partition(".")
    return read_sentences()[group][name].format(**words)
