"""Whether scores of two protocols may be compared, and if not, why."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from eldata.protocols.protocol import DESCRIPTIVE
from eldata.protocols.words import FIELDS, in_words

if TYPE_CHECKING:
    from collections.abc import Mapping

# Texts that follow from other fields.
_DERIVED = ("psnr", "ssim")


def comparability(first: Mapping[str, Any], second: Mapping[str, Any]) -> list[str]:
    """Return in words in what two protocols differ; nothing if their scores compare.

    Name, title and source do not count: two protocols of different names may score alike.

    Parameters
    ----------
    first, second
        Protocols as a result's JSON holds them (``protocol``), of images or of clips.

    Returns
    -------
    list of str
        Such as ``"region: full frame against packed centre 512 x 512"``, in the order of an evaluation. A field that
        one of them does not state, because an older version wrote it, counts as different.
    """
    ignored = {"name", *DESCRIPTIVE}
    stated = [*FIELDS, *(name for name in (*first, *second) if name not in FIELDS)]
    names = [name for name in dict.fromkeys(stated) if name not in ignored and (name in first or name in second)]
    different = [name for name in names if first.get(name) != second.get(name) or (name in first) != (name in second)]
    explained = [name for name in different if name not in _DERIVED] or different
    return [f"{_label(name)}: {_stated(first, name)} against {_stated(second, name)}" for name in explained]


def _label(name: str) -> str:
    return FIELDS[name][0] if name in FIELDS else name.replace("_", " ")


def _stated(protocol: Mapping[str, Any], name: str) -> str:
    return in_words(name, protocol[name]) if name in protocol else "not stated"
