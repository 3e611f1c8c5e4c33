"""The dataset card: contents, origin and known defects of a dataset."""

from __future__ import annotations

from collections import Counter
from dataclasses import MISSING, asdict, dataclass, fields
from fnmatch import fnmatchcase
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar

from eldata.base.fields import Fields, TextFile, names_of
from eldata.base.files import json_text, path_problem, write_text
from eldata.base.numbers import counted
from eldata.base.visible import has_unseen, shown
from eldata.errors import ArgumentError, ManifestError, did_you_mean
from eldata.manifest.patterns import has_fields
from eldata.raw.stated import MOSAIC_CFAS, PLANES, MosaicFacts

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence
    from pathlib import Path

    from eldata.records import FrameRecord, PairRecord

OfPair = TypeVar("OfPair", "PairRecord", "FrameRecord")
Record = TypeVar("Record")

OWN_PROTOCOL = "raw"
"""The protocol of a card that names none, such as your own set's."""

CHANNELS = {
    "bayer": (4,),
    "xtrans": (9,),
    "quad-bayer": (16,),
    "nona-bayer": (36,),
    "both": (4, 9),
    "mixed": (4, 9, 16, 36),
}
"""How many channels packed frames may have, by a card's word for their colour filter array."""
CFA_WORDS = tuple(CHANNELS)


@dataclass(frozen=True, slots=True)
class Download:
    """A place where files can be downloaded.

    Attributes
    ----------
    address, size_bytes, notes
        Web address, its size if known, and what to know about it.
    direct
        Whether the publisher lets programs fetch it; the others are web pages for people.
    part
        Name of the archive's part of the dataset, if there are several.
    paths
        Pattern of the manifest's paths that the archive holds.
    below
        Folder of the dataset to unpack it into, if the manifest lists none of its files; ``None``: not known.
    sha256
        ``sha256:<hex>`` of the archive, if published.
    about
        Its size in words, where ``size_bytes`` is not known.
    """

    address: str
    size_bytes: int | None = None
    notes: str = ""
    direct: bool = False
    part: str = ""
    paths: str = "*"
    below: str | None = None
    sha256: str | None = None
    about: str = ""

    def holds(self, path: str) -> bool:
        """Tell whether the archive holds a path of the manifest."""
        return fnmatchcase(path, self.paths)


@dataclass(frozen=True, slots=True)
class CameraCard:
    """How a dataset's camera names itself in EXIF: any of ``models`` (makers sell one body under several names).

    None at all: no public text says, and no file's camera is checked.
    """

    models: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Subset:
    """A named choice of pairs: those that fit all of ``splits``, ``scenes`` and ``paths``.

    Attributes
    ----------
    name, title, source
        Short name, what it is, and who uses it.
    pairs
        Expected number of pairs; a manifest that gives another is refused. ``None``: it is not known.
    splits, scenes
        Wanted values; empty means all.
    paths
        Pattern of the noisy frames' paths, with ``*`` and ``?`` as in a shell.
    first
        Whether of each burst, which is what has a reference, an ISO and a ratio in common, only the first frame by path
        belongs to it.
    without
        Flags of noisy frames that do not belong to it.
    """

    name: str
    title: str
    source: str
    pairs: int | None = None
    splits: tuple[str, ...] = ()
    scenes: tuple[str, ...] = ()
    paths: str = "*"
    first: bool = False
    without: tuple[str, ...] = ()

    def holds(self, pair: PairRecord | FrameRecord) -> bool:
        """Tell whether a pair, or the row of a noisy frame, belongs to this subset, ``first`` aside."""
        return (
            (not self.splits or pair.split in self.splits)
            and (not self.scenes or pair.scene in self.scenes)
            and not {*self.without} & {*pair.flags}
            and (
                fnmatchcase(pair.path, self.paths) or has_fields(pair.path)
            )  # or nothing of it is there: that has to show
        )

    def members(self, rows: Iterable[OfPair]) -> list[OfPair]:
        """Return the pairs of a dataset, or rows of noisy frames, that belong to this subset."""
        held = [row for row in rows if self.holds(row)]
        if not self.first:
            return held
        first: dict[object, str] = {}
        for row in held:
            burst = row.reference, row.iso, row.ratio
            first[burst] = min(row.path, first.get(burst, row.path))
        paths = set(first.values())
        return [row for row in held if row.path in paths]

    def choose(self, pairs: Sequence[PairRecord]) -> list[PairRecord]:
        """Return the pairs of this subset, given all pairs of a dataset.

        Raises
        ------
        ManifestError
            If their number is not the expected one.
        """
        chosen = self.members(pairs)
        if len(chosen) != (self.pairs or len(chosen)):
            raise ManifestError(
                f"subset {self.name!r}: the card expects {self.pairs} pairs, the manifest has {len(chosen)}"
            )
        return chosen


@dataclass(frozen=True, slots=True)
class Card:
    """A dataset card.

    Attributes
    ----------
    name, title, version
        Short name (the manifest's file has it too), full title, version of this manifest.
    folder
        The dataset's folder below the data root; the manifest's paths start there.
    cfa
        ``bayer``, ``xtrans``, ``quad-bayer``, ``nona-bayer``; ``both``: files of the first two; ``mixed``: of others.
    cameras
        EXIF identity of each camera in the manifest.
    counts
        Expected number of rows per role. A card without a manifest has none.
    scenes_shared
        Whether a scene's name under several cameras is one scene that all of them photographed; scores of it then count
        as one in intervals and p-values (:func:`eldata.evaluation.statistics.list_clusters`).
    subsets
        Named choices of pairs. ``eldata evaluate`` scores the first one by default.
    protocol
        Name of the protocol that scores the set unless another is named; of a card that states none it is ``raw``, by
        the files' own levels.
    mosaics
        What is stated of files that are pixels alone, such as ``.npy``; of each file the first that fits counts.
    known_defects, sources
        What is wrong with the published files, and where this card's facts come from.
    contents, levels
        What the set holds, and its black and white levels, in words, as far as a public text says.
    scored
        How published code scores it, and what of that no protocol of eldata's can say.
    unknown
        What no public text says.
    """

    name: str
    title: str
    version: str
    folder: str
    citation: str
    licence: str
    homepage: str
    cfa: str
    cameras: dict[str, CameraCard]
    counts: dict[str, int]
    scenes_shared: bool = True
    downloads: tuple[Download, ...] = ()
    subsets: tuple[Subset, ...] = ()
    protocol: str = OWN_PROTOCOL
    mosaics: tuple[MosaicFacts, ...] = ()
    known_defects: tuple[str, ...] = ()
    sources: tuple[str, ...] = ()
    contents: str = ""
    levels: str = ""
    scored: tuple[str, ...] = ()
    unknown: tuple[str, ...] = ()


def find_subset(subsets: Sequence[Subset], name: str) -> Subset:
    """Return a subset by name.

    Raises
    ------
    ArgumentError
        If the name is unknown; the message lists the known ones.
    """
    for subset in subsets:
        if subset.name == name:
            return subset
    known = [subset.name for subset in subsets]
    listed = ", ".join(known) or "none"
    raise ArgumentError(f"no subset is called {name!r}; known are {listed}{did_you_mean(name, known)}")


def cfa_word(names: Iterable[str]) -> str:
    """Return a card's word for files of these colour filter arrays, as :class:`eldata.raw.levels.Sites` names them."""
    words = {"xtrans" if name == "X-Trans" else name.lower() for name in names}
    if len(words) == 1:
        return words.pop()
    return "both" if words == {"bayer", "xtrans"} else "mixed"


def counts_of(records: Iterable[FrameRecord]) -> dict[str, int]:
    """Return the number of rows of each role, as cards state it."""
    return dict(sorted(Counter(str(record.role) for record in records).items()))


def own_card(name: str, folder: str, records: Sequence[FrameRecord], **fields: Any) -> Card:
    """Make the card of a set of one's own; what only its owner knows, such as the licence, is left to fill in."""
    unknown: dict[str, Any] = dict.fromkeys(("citation", "licence", "homepage"), "not stated")
    title, counts = title_of_set(records), counts_of(records)
    return Card(name=name, title=title, version="1.0", folder=folder, counts=counts, **unknown, **fields)


def title_of_set(records: Sequence[FrameRecord]) -> str:
    """Return a title for a set, from its scenes, roles and cameras."""
    scenes = len({record.scene for record in records} - {""})
    what = [counted(scenes, "scene")] if scenes else []
    what += ["calibration frames"] if {"bias", "flat"} & set(counts_of(records)) else []
    cameras = dict.fromkeys(sorted(record.camera for record in records))
    return f"{' and '.join(what)} taken with {' and '.join(cameras)}"


def load_card(path: Path, content: bytes | None = None) -> Card:
    """Read a dataset card, from its ``content`` if that is given.

    Raises
    ------
    ManifestError
        If the file cannot be read or a field is missing, unknown or of the wrong kind; the message names it.
    """
    if content is None and not path.exists():
        raise ManifestError(f"{path}: is missing; a manifest needs its dataset card")
    top = TextFile(path, ManifestError, content=content).json()
    top.only(names_of(Card))
    cameras, counts = top.inside("cameras"), top.inside("counts")
    subsets = tuple(_read(one, Subset, "name", "paths") for one in top.objects("subsets", missing_ok=True))
    for index, subset in enumerate(subsets):
        if subset.name in [other.name for other in subsets[:index]]:
            raise top.problem(f"subsets[{index}].name", f"{shown(subset.name)} names two subsets")
    downloads = top.objects("downloads", missing_ok=True)
    return _read(
        top,
        Card,
        "protocol",
        folder=top.parsed("folder", _check_folder),
        cfa=top.choice("cfa", CFA_WORDS),
        cameras={name: _read_camera(cameras, name) for name in cameras.data},
        counts={role: counts.whole(role) for role in counts.data},
        downloads=tuple(_read(one, Download, "address", "paths", "sha256") for one in downloads),
        subsets=subsets,
        mosaics=tuple(map(_read_mosaic, top.objects("mosaics", missing_ok=True))),
    )


def _read(entry: Fields, kind: type[Record], *filled: str, **given: Any) -> Record:
    """Read a record from an object: each field by its type, a missing one as its default.

    Texts may be empty, but for those that are ``filled``. What is ``given`` was read already.
    """
    entry.only(names_of(kind))
    for one in fields(kind):  # type: ignore[arg-type] # it is a record's
        if one.name in given:
            continue
        default, empty = one.default is not MISSING, one.name not in filled
        if one.type == "tuple[str, ...]":
            given[one.name] = entry.texts(one.name, missing_ok=default, empty=empty)
            continue
        ways: dict[str, Callable[[str], Any]] = {"bool": entry.flag, "int": entry.whole}
        read = ways.get(str(one.type).removesuffix(" | None"), partial(entry.text, empty=empty))
        given[one.name] = entry.optional(one.name, read, one.default) if default else read(one.name)
    return kind(**given)


def _check_folder(found: object) -> str:
    """Return a card's ``folder`` if it is the name of one folder, else refuse it."""
    if not isinstance(found, str) or path_problem(found) or "/" in found:
        raise ArgumentError(f"expected the name of one folder, found {shown(found)}")
    return found


def _read_camera(cameras: Fields, name: str) -> CameraCard:
    """Read one camera of a card, by its name."""
    if has_unseen(name):
        raise cameras.problem(name, "has characters in its name that do not show")
    return _read(cameras.inside(name), CameraCard)


def _read_mosaic(entry: Fields) -> MosaicFacts:
    """Read a card's facts on mosaics without a header: files, cameras, CFA, black and white level in DN."""
    entry.only(names_of(MosaicFacts))
    given: dict[str, Any] = {"cfa": entry.choice("cfa", MOSAIC_CFAS)}
    planes = given["planes"] = entry.texts("planes", missing_ok=True)
    if planes and sorted(planes) != sorted(PLANES):
        raise entry.wrong("planes", f"{', '.join(PLANES)}, in the order in which they lie", list(planes))
    if "shape" in entry.data:
        given["shape"] = entry.each("shape", Fields.whole, expected="rows and columns", count=2, at_least=2)
    if "level_arrays" in entry.data:
        names = "names of the arrays of black and of white level, in place of levels"
        given["level_arrays"] = entry.texts("level_arrays", expected=names, count=2)
        entry.only([name for name in names_of(MosaicFacts) if not name.endswith("_level_dn")])
    else:
        levels = "one level, or one for each of R, G1, B and G2"
        black = entry.each("black_level_dn", Fields.number, expected=levels, fewest=1, at_least=0)
        if len(black) not in (1, 4):
            raise entry.wrong("black_level_dn", levels, list(black))
        given |= {"black_level_dn": black, "white_level_dn": entry.number("white_level_dn", above=max(black))}
    return _read(entry, MosaicFacts, "paths", "cameras", **given)


def save_card(path: Path, card: Card) -> None:
    """Write a dataset card as JSON, whole or not at all."""
    write_text(path, card_text(card))


_LEFT_OUT = ("first", "without", *(one.name for one in fields(MosaicFacts) if one.default is not MISSING))
"""What a card's entries leave out where it says nothing."""


def card_text(card: Card) -> str:
    """Return a dataset card as it is written."""
    data = {name: value for name, value in asdict(card).items() if name != "mosaics" or value}
    for entry in (*data["subsets"], *data.get("mosaics", ())):
        for name in [name for name in _LEFT_OUT if not entry.get(name, True)]:
            del entry[name]
    return json_text(data)
