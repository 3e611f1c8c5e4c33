"""Which protocol a name means, and which ones are for a dataset."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from eldata.errors import ArgumentError, ManifestError, did_you_mean
from eldata.protocols.digests import scoring
from eldata.protocols.kinds import IMAGES
from eldata.protocols.named import FAMILIES, PROTOCOLS
from eldata.protocols.protocol import ANY_DATASET, ONE_CAMERAS_LEVELS

if TYPE_CHECKING:
    from eldata.manifest.card import Card
    from eldata.protocols.protocol import Protocol


def get_protocol(name: str | Path, dataset: str | None = None, *, own: bool = False) -> Protocol:
    """Return a protocol by its name, by the path of a TOML file, or by a family's name and a dataset.

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
        from eldata.protocols.custom import load_protocol

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
    """Return the protocols that a digest means, or its beginning.

    Raises
    ------
    ArgumentError
        If no shipped protocol has such a digest.
    """
    found = tuple(protocol for protocol in PROTOCOLS.values() if protocol.digest.startswith(digest))
    if not found:
        raise ArgumentError(f"no shipped protocol has the digest {digest}")
    return found


def members_of(family: str) -> tuple[Protocol, ...]:
    """Return the protocols of a family; none if there is no such family."""
    return tuple(protocol for protocol in PROTOCOLS.values() if protocol.family == family)


def default_protocol(card: Card) -> Protocol:
    """Return the protocol that scores a set unless another is named: the one that its card names.

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


def protocols_for(dataset: str, *, own: bool = False) -> tuple[Protocol, ...]:
    """Return the protocols that were made for a dataset.

    A set of your ``own``, or of no known name, has its own pairs, so it gets one protocol of each way to score, the
    first of the shipped ones. Levels that are those of one camera, whatever the file states, are not a way to score
    another.

    Examples
    --------
    >>> from eldata.protocols import protocols_for
    >>> [protocol.name for protocol in protocols_for("eld")]
    ['eld', 'eld-uncorrected', 'pmn-eld', 'led-eld', 'lrd-eld']
    """
    every = PROTOCOLS.values()
    covering = tuple(one for one in every if one.dataset != ANY_DATASET and one.covers(dataset))
    if covering and not own:
        return covering
    ways: list[Protocol] = []
    for protocol in covering or every:
        fits = protocol.levels not in ONE_CAMERAS_LEVELS and (covering or protocol.kind is IMAGES)
        if fits and all(scoring(protocol.as_dict()) != scoring(way.as_dict()) for way in ways):
            ways.append(protocol)
    return tuple(ways)
