"""Protocols by name: those that come with the package (``shipped.toml``), those for a dataset, a user's own file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eldata.base.fields import Fields, TextFile, names_of, shipped_toml
from eldata.base.visible import shown
from eldata.errors import ArgumentError, ManifestError, did_you_mean
from eldata.metrics.registry import IMAGES
from eldata.protocols.protocol import (
    ANY_DATASET,
    CHOICES,
    NEUTRAL,
    ONE_CAMERAS_LEVELS,
    ClipProtocol,
    Protocol,
    scoring,
)

if TYPE_CHECKING:
    from collections.abc import Mapping

    from eldata.manifest.card import Card


_CONTENT = shipped_toml(Path(__file__).with_name("shipped.toml"))


def _read_shipped(content: Mapping[str, Any]) -> dict[str, Protocol]:
    """Make the shipped protocols of a parsed file, by name; one may build on another before it."""
    texts: dict[str, str] = {}
    for name, text in content["texts"].items():
        texts[name] = text.strip().format_map(texts)
    made: dict[str, Protocol] = {}
    for kind, protocol in (("images", Protocol), ("clips", ClipProtocol)):
        for name, stated in content[kind].items():
            fields = {"name": name} | {field: _convert_value(value, texts) for field, value in stated.items()}
            base = fields.pop("base", None)
            made[name] = protocol(**fields) if base is None else replace(made[base], **fields)
    return made


def _convert_value(value: Any, texts: dict[str, str]) -> Any:
    """Convert a field to what a protocol holds: lists as tuples, texts put in, no text at all as ``None``."""
    if isinstance(value, list):
        return tuple(value)
    return value.strip().format_map(texts) or None if isinstance(value, str) else value


PROTOCOLS: dict[str, Protocol] = _read_shipped(_CONTENT)
"""Protocols of images and of clips, by name."""

FAMILIES: tuple[str, ...] = tuple(dict.fromkeys(p.family for p in PROTOCOLS.values() if p.family))
"""Names that stand for one protocol per dataset."""


# --- which one a name means -------------------------------------------------------------------------------------------


def get_protocol(name: str | Path, dataset: str | None = None, *, own: bool = False) -> Protocol:
    """Find a protocol by its name, by the path of a TOML file, or by a family's name and a dataset.

    Parameters
    ----------
    name
        Such as ``eld``; ``pmn``, which means ``pmn-sid`` or ``pmn-eld`` by the dataset; ``mine.toml``
        (:func:`eldata.protocols.load_protocol`).
    dataset
        The dataset that is to be scored, if it is known.
    own
        Whether it is a set of your own. A family's members differ in the choice of pairs, and such a set has its own
        pairs: the family's first member is taken, unless another is for a dataset of this name.

    Raises
    ------
    ArgumentError
        If the name is unknown (the message lists the known ones), or a family has none for the dataset; or like
        :func:`~eldata.protocols.load_protocol`.

    Examples
    --------
    >>> from eldata.protocols import get_protocol
    >>> protocol = get_protocol("eld")
    >>> protocol.name, protocol.levels
    ('eld', 'published')
    """
    if isinstance(name, Path) or name.endswith(".toml"):
        return load_protocol(name)
    if name in PROTOCOLS:
        return PROTOCOLS[name]
    members = members_of(name)
    if not members:
        known = (*PROTOCOLS, *FAMILIES)
        raise ArgumentError(
            f"no protocol is called {name!r}; known are {', '.join(known)}, or give a file ending in .toml"
            f"{did_you_mean(name, known)}"
        )
    fitting = [protocol for protocol in members if dataset is None or protocol.covers(dataset)]
    if own or len(fitting) == 1:
        return (fitting or members)[0]
    names = " and ".join(f"{protocol.name} (for {protocol.dataset})" for protocol in members)
    raise ArgumentError(f"protocol {name!r} is {names}; name one of them for dataset {dataset or 'not known'!r}")


def of_digest(digest: str) -> tuple[Protocol, ...]:
    """Find the protocols of a digest, or of its beginning.

    Raises
    ------
    ArgumentError
        If no shipped protocol has such a digest.
    """
    protocols = tuple(protocol for protocol in PROTOCOLS.values() if protocol.digest.startswith(digest))
    if not protocols:
        raise ArgumentError(f"no shipped protocol has the digest {digest}")
    return protocols


def members_of(family: str) -> tuple[Protocol, ...]:
    """List the protocols of a family; none if there is no such family."""
    return tuple(protocol for protocol in PROTOCOLS.values() if protocol.family == family)


def default_protocol(card: Card) -> Protocol:
    """Find the protocol that a set's card names, which scores it unless another is named.

    Raises
    ------
    ManifestError
        If it is not one of the shipped protocols.

    Examples
    --------
    >>> from eldata.manifest import shipped_card
    >>> from eldata.protocols import default_protocol
    >>> default_protocol(shipped_card("sid-sony")).name
    'sid'
    """
    if card.protocol not in PROTOCOLS:
        raise ManifestError(
            f"{card.name}.json: protocol: expected the name of one that comes with eldata (eldata protocols lists "
            f"them), found {card.protocol!r}{did_you_mean(card.protocol, PROTOCOLS)}"
        )
    return PROTOCOLS[card.protocol]


def protocols_for(dataset: str) -> tuple[Protocol, ...]:
    """List the protocols that were made for a dataset.

    A set of no known name has its own pairs, so it gets one protocol of images of each way to score, the first of the
    shipped ones. One camera's levels, whatever the file states, are not a way to score another, nor is cutting down to
    whole DN, of which a set may hold none, nor SSIM of grey blocks.

    Examples
    --------
    >>> from eldata.protocols import protocols_for
    >>> [protocol.name for protocol in protocols_for("eld")]
    ['eld', 'eld-uncorrected', 'pmn-eld', 'sony-eld', 'led-eld', 'lrd-eld', 'eld-srgb', 'eld-raw2rgb', 'eld-rgb2rgb']
    """
    every = PROTOCOLS.values()
    covering = tuple(protocol for protocol in every if protocol.dataset != ANY_DATASET and protocol.covers(dataset))
    if covering:
        return covering
    ways: list[Protocol] = []
    for protocol in every:
        fits = protocol.kind is IMAGES and protocol.levels not in ONE_CAMERAS_LEVELS
        fits = fits and all(getattr(protocol, name) == NEUTRAL[name] for name in ("quantisation", "ssim_planes"))
        if fits and all(scoring(protocol.as_dict()) != scoring(way.as_dict()) for way in ways):
            ways.append(protocol)
    return tuple(ways)


# --- a file of the user's own -----------------------------------------------------------------------------------------


_BASE = "base"
_LISTS_OF_TEXT = ("cameras", "scenes")
_KNOWN = (_BASE, *(name for name in names_of(Protocol) if name != "family"))
_LARGEST_BYTES = 1 << 20


def load_protocol(path: Path | str) -> Protocol:
    """Load a protocol from a TOML file.

    It has ``base``, the name of a shipped protocol, ``name``, ``title``, and any field of :class:`Protocol` that is to
    differ from the base's. ``response`` may name a table beside it, ``{table = "mine.txt"}``
    (:func:`~eldata.isp.response.read_response_table`), whose points are taken over.
    ``source`` is by default the base's with the file's name.

    Raises
    ------
    ArgumentError
        If the file cannot be read, a field is unknown, missing or of the wrong type, a value is impossible, or the name
        is a shipped protocol's; the message names file and field.
    """
    path = Path(path)
    top = TextFile(path, ArgumentError, largest_bytes=_LARGEST_BYTES).toml()
    top.only(_KNOWN)
    for name in (_BASE, "name", "title"):
        if name not in top.data:
            raise top.problem(name, "is missing; a protocol needs base, name and title")
    values = {name: _read_field(top, name, path.parent) for name in top.data}
    base = values.pop(_BASE)
    name = values["name"]
    if name in PROTOCOLS or name in FAMILIES:
        raise top.problem("name", f"{shown(name)} is the name of a shipped protocol; choose another")
    if not name.isprintable() or name.endswith(".toml"):
        raise top.wrong("name", "printable text that does not end in .toml", name)
    start = PROTOCOLS[base]
    if start.kind is not IMAGES:
        raise ArgumentError(f"{path}: base: {base!r} scores clips; a protocol of your own starts from one of images")
    made = replace(start, **({"source": f"{path.name}, after {base}: {start.source}", "family": ""} | values))
    try:
        made.check()
    except ArgumentError as error:
        raise ArgumentError(f"{path}: {error}") from error
    return made


def _read_ratio(top: Fields, name: str) -> Any:
    """Read a positive ratio as it is written, whole or with decimals."""
    top.number(name, above=0)
    return top.value(name)  # whole where it is: the digest tells 100 from 100.0


def _read_response(top: Fields, folder: Path) -> str:
    """Read the response that a file states, with the points of the curve in the files that it names."""
    from eldata.isp.response import read_response_table

    if isinstance(top.data["response"], str):
        return top.text("response")
    stated = top.inside("response")
    if tuple(stated.data) != ("table",):
        raise top.wrong("response", "'gamma-2.2' or {table = FILE}", ", ".join(sorted(stated.data)))
    return read_response_table(folder / stated.text("table")).text


def _read_field(top: Fields, name: str, folder: Path) -> Any:
    """Read a field's value as :class:`Protocol` has it."""
    if name == "response":
        return _read_response(top, folder)
    if name == _BASE:
        return top.choice(name, tuple(PROTOCOLS))
    if name in CHOICES:
        return top.choice(name, CHOICES[name])
    if name == "mse_offset":
        return top.number(name)
    if name == "ratios":
        return top.each(name, _read_ratio, expected="a list of positive numbers, such as [100, 200]; [] for all")
    if name in _LISTS_OF_TEXT:
        return top.texts(name, expected="a list of names; [] for all", empty=True)
    if name == "subset":
        return top.text(name, empty=True) or None
    return top.text(name, empty=name not in ("name", "title"))
