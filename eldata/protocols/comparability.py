"""Whether scores of two protocols may be compared, and if not, why."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from eldata.protocols.digests import NEUTRAL, OF_THE_FACTOR, SCORED, canonical
from eldata.protocols.words import FIELDS, in_words

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence


def comparability(
    first: Mapping[str, Any],
    second: Mapping[str, Any],
    *,
    equal: Sequence[Mapping[str, Collection[str]]] = (),
    ignored: Collection[str] = (),
) -> list[str]:
    """Return in words in what two protocols differ; nothing if their scores compare.

    Names and sentences do not count: two protocols of different names may score alike. Neither do fields that have no
    effect, such as where a factor is found that is not used.

    Parameters
    ----------
    first, second
        Protocols as a result's JSON holds them (``protocol``), of images or of clips. A field that one of them does not
        state, because an older version wrote it, is neutral (:data:`eldata.protocols.digests.NEUTRAL`).
    equal
        Values of a field that came to the same where something was scored, by the field: such as ``{"levels":
        ["published", "sid-sony"]}`` of files whose black level is 512.
    ignored
        Fields that do not count.

    Returns
    -------
    list of str
        Such as ``"region: full frame against packed centre 512 x 512"``, in the order of an evaluation.
    """
    a, b = canonical(first), canonical(second)
    names = [name for name in dict.fromkeys((*FIELDS, *a, *b)) if name not in ignored and a.get(name) != b.get(name)]
    regions = [_factor_region(fields) for fields in (first, second)]
    if "rescaling" in names:  # where a factor is found says nothing against no factor
        names = [name for name in names if name not in OF_THE_FACTOR]
    elif regions[0] == regions[1]:
        names = [name for name in names if name != "rescaling_region"]
    stated = [{**fields, "rescaling_region": region} for fields, region in zip((first, second), regions, strict=True)]
    return [
        f"{FIELDS[name][0] if name in FIELDS else name.replace('_', ' ')}: "
        + " against ".join(_words(fields, name) for fields in stated)
        for name in names
        if not any(all(_value(fields, name) in choices.get(name, ()) for fields in stated) for choices in equal)
    ]


def _factor_region(protocol: Mapping[str, Any]) -> Any:
    found = _value(protocol, "rescaling_region")
    return protocol.get("region") if found == SCORED else found


def _value(protocol: Mapping[str, Any], name: str) -> Any:
    return protocol.get(name, NEUTRAL.get(name))


def _words(protocol: Mapping[str, Any], name: str) -> str:
    return in_words(name, _value(protocol, name)) if name in (*protocol, *NEUTRAL) else "not stated"
