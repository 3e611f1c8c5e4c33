"""Manifests by file or by name: the table, its card and its digest together.

Other installed packages register sets by entry points of the group ``eldata.datasets``: a name, and the place of its
class (docs/adding-a-dataset.md). Python opens a set by that class; commands need its manifest alone: ``<name>.csv`` and
its card ``<name>.json`` in the folder of the class's module. Nothing of the package is imported for it: that may take
seconds.
"""

from __future__ import annotations

import os
from collections import defaultdict
from contextlib import suppress
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from eldata.base.files import atomic_write, encoded, inside, split_member, visible_below
from eldata.errors import ArgumentError, EldataError, ManifestError, did_you_mean
from eldata.manifest.card import Card, card_text, counts_of, load_card, save_card
from eldata.manifest.patterns import expand, has_fields, is_pattern, matching
from eldata.manifest.table import load_table, table_text
from eldata.raw.stated import MosaicFacts, StatedFile
from eldata.records import Exposure, FrameRecord

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping


ROOT_VARIABLE = "ELDATA_ROOT"
_NEAR = 64  # folders of a place that are looked into
ENTRY_POINTS = "eldata.datasets"
"""The group of entry points under which other packages name their sets."""


@dataclass(frozen=True, slots=True)
class FrameFiles:
    """The files of a set.

    Attributes
    ----------
    folder
        The set's; paths start there, and may not leave it.
    stated
        What is stated of mosaics without levels of their own, by path.
    """

    folder: Path
    stated: Mapping[str, tuple[MosaicFacts, Exposure]] = field(default_factory=dict)

    @classmethod
    def of(cls, folder: Path, card: Card, records: Iterable[FrameRecord]) -> FrameFiles:
        """Make the files of these rows, with the facts that their card states."""
        if not card.mosaics:
            return cls(folder)
        stated = {}
        for record in expand(tuple(records), folder):
            if (facts := mosaic_facts(card.mosaics, record)) is not None:
                stated[record.path] = facts, Exposure(record.iso, record.exposure_s)
        return cls(folder, stated)

    def at(self, path: str) -> Path | StatedFile:
        """Return a path's file for :func:`eldata.raw.read_raw`, with what its card states.

        Raises
        ------
        ManifestError
            If it leads out of the folder.
        """
        file = inside(self.folder, path)
        return StatedFile(file, *self.stated[path], split_member(path)[1]) if path in self.stated else file

    def absolute(self) -> FrameFiles:
        """Make the folder absolute, for processes that start in another one."""
        return replace(self, folder=self.folder.absolute())

    def only(self, paths: Collection[str]) -> FrameFiles:
        """Keep the facts of these paths alone, for a worker."""
        return replace(self, stated={path: self.stated[path] for path in paths if path in self.stated})


def mosaic_facts(mosaics: Iterable[MosaicFacts], record: FrameRecord) -> MosaicFacts | None:
    """Return the first facts that a card states for a row's camera and path; ``None``: the file states them."""
    file = split_member(record.path)[0]
    for facts in mosaics:
        if fnmatchcase(file, facts.paths) and (not facts.cameras or record.camera in facts.cameras):
            return facts
    return None


@dataclass(frozen=True, slots=True)
class Manifest:
    """A manifest as loaded: ``path`` of the CSV, its ``card``, its ``records`` by path, ``digest`` of the CSV."""

    path: Path
    card: Card
    records: tuple[FrameRecord, ...]
    digest: str

    @property
    def name(self) -> str:
        """The dataset's short name."""
        return self.card.name

    def of_copy(self, folder: Path) -> Manifest:
        """Return the manifest with a copy's files in place of rows whose paths have fields.

        Raises
        ------
        ManifestError
            Like :func:`eldata.manifest.patterns.expand`.
        """
        if not any(has_fields(record.path) for record in self.records):
            return self
        records = expand(self.records, folder)
        return replace(self, records=records, card=replace(self.card, counts=counts_of(records)))

    def stated_folder(self, root: Path | str | None = None) -> Path:
        """Return the folder where the dataset belongs below a data root (see :func:`data_root`)."""
        return data_root(root) / self.card.folder

    def folder(self, root: Path | str | None = None) -> Path:
        """Find the dataset's folder below a data root, or in it, by :meth:`folder_at`."""
        return self.folder_at(self.stated_folder(root), data_root(root))

    def own_folder(self, root: Path | str | None) -> Path:
        """Find the dataset's folder if ``root`` is meant to be it; ``None``: below the data root."""
        place = None if root is None else Path(root).expanduser()
        return self.folder() if place is None else self.folder_at(place, place)

    def folder_at(self, expected: Path, *places: Path) -> Path:
        """Return the folder that holds the dataset's files: the expected one if it does, or none else does.

        Copies lie one level off, in a folder of other capitals, or in the folder that an archive made. So ``places``
        are looked into, their folders, and what these have of the expected name; a folder is taken if a file of the
        manifest lies where the manifest has it.

        Raises
        ------
        ManifestError
            If the expected folder does not hold it, and two others do.
        """
        paths_in: dict[str, list[str]] = defaultdict(list)
        for record in self.records:
            paths_in[record.path.rpartition("/")[0]].append(record.path)

        def holds(folder: Path) -> bool:
            """Tell whether a folder has at least one of the manifest's files."""
            try:
                at = (paths for parent, paths in paths_in.items() if is_pattern(parent) or (folder / parent).is_dir())
                there = (path for paths in at for path in paths)
                return any(
                    matching(folder, path) if is_pattern(path) else (folder / split_member(path)[0]).is_file()
                    for path in there
                )
            except (OSError, EldataError):  # a neighbour, perhaps; the expected folder is read again, and named
                return False

        if holds(expected):
            return expected
        near = [expected / self.card.folder, *places]
        for place in places:
            folders = [path for path in visible_below(place, deep=False) if path.is_dir()][:_NEAR]
            near += [*folders, *(folder / self.card.folder for folder in folders)]
        holders = {folder.resolve(): folder for folder in near if holds(folder)}
        if len(holders) > 1:
            raise ManifestError(
                f"{expected}: holds no file of {self.name}, but each of these folders does: "
                f"{', '.join(map(str, holders.values()))}; give the one that is meant as root"
            )
        return next(iter(holders.values()), expected)


def data_root(root: Path | str | None = None) -> Path:
    """Return the folder that holds the datasets: ``root``, else ``$ELDATA_ROOT``, else ``./data``; ``~`` is home."""
    return Path(root if root is not None else os.environ.get(ROOT_VARIABLE) or "data").expanduser()


def is_manifest(place: Path | str) -> bool:
    """Tell whether a place names a manifest: a CSV file, or a known set's name that no folder here has."""
    suffix = Path(place).suffix.lower()
    return suffix == ".csv" or (not suffix and str(place) in known_names() and not Path(place).exists())


def load_manifest(path: Path | str, contents: tuple[bytes, bytes] | None = None) -> Manifest:
    """Load a manifest: ``<name>.csv`` and the card ``<name>.json`` beside it; or their ``contents``, if given.

    Raises
    ------
    ManifestError
        If either is malformed, a row's camera is not on the card, or the card expects another number of rows.
    """
    path = Path(path)
    rows, facts = contents or (None, None)
    records, digest = load_table(path, rows)
    card = load_card(path.with_suffix(".json"), facts)
    if unknown := {record.camera for record in records} - card.cameras.keys():
        record = next(record for record in records if record.camera in unknown)
        known = ", ".join(card.cameras)
        raise ManifestError(f"{path}, {record.path}: camera {record.camera!r} is not on the card, which has {known}")
    found = counts_of(records)
    if found != card.counts:
        raise ManifestError(f"{path}: the card expects {card.counts} rows per role, found {found}")
    return Manifest(path, card, records, digest)


def save_manifest(path: Path | str, card: Card, records: Iterable[FrameRecord]) -> Manifest:
    """Write a manifest's CSV file and, beside it, its card; return it as it loads.

    Both are on the disk under temporary names before either is renamed, the CSV file last: where it is the new one, so
    is the card. A card that says the same stays as it is.

    Raises
    ------
    ManifestError
        If rows and card contradict each other; nothing is written then.
    EldataError
        If a file cannot be written.
    """
    path = Path(path)
    table = encoded(table_text(path, records))
    manifest = load_manifest(path, (table, encoded(card_text(card))))
    with atomic_write(path) as rows:
        rows.write(table)
        rows.flush()
        os.fsync(rows.fileno())
        if _find_card(path) != card:
            save_card(path.with_suffix(".json"), card)
    return manifest


def refuse_others(path: Path, card: Card, records: Iterable[FrameRecord], advice: str) -> None:
    """Refuse to replace a CSV file or card that says something else: people fill in the card.

    What says the same may be there: the same command wrote it before, or one that ended between the two files.

    Raises
    ------
    ArgumentError
        If so, with what to do instead.
    """
    same = {path: path.is_file() and path.read_bytes() == encoded(table_text(path, records))}
    same[path.with_suffix(".json")] = _find_card(path) == card
    for file, is_same in same.items():
        if file.exists() and not is_same:
            raise ArgumentError(f"{file} is there already, with other content: give another name, or {advice}")


def _find_card(path: Path) -> Card | None:
    """Load the card of a manifest's CSV file; ``None`` if it is missing or invalid."""
    with suppress(ManifestError):
        return load_card(path.with_suffix(".json"))
    return None


def shipped_folder() -> Path:
    """Return the folder of the manifests that come with the package."""
    installed = Path(__file__).parent / "shipped"  # a wheel has them here (pyproject.toml)
    return installed if installed.is_dir() else Path(__file__).parents[2] / "manifests"


def shipped_names() -> tuple[str, ...]:
    """Return the names of the shipped manifests.

    Examples
    --------
    >>> from eldata.manifest import shipped_names
    >>> shipped_names()[:4]
    ('crvd', 'drv', 'eld', 'llrvd')
    """
    return tuple(sorted(path.stem for path in shipped_folder().glob("*.csv")))


def carded_names() -> tuple[str, ...]:
    """Return the names of the sets with a shipped card; some have no manifest, since no text lists their files."""
    return tuple(sorted(path.stem for path in shipped_folder().glob("*.json")))


def shipped_card(name: str) -> Card:
    """Load a shipped card by its dataset's name.

    Raises
    ------
    ManifestError
        If the name is unknown; the message lists the known ones.
    """
    if name not in carded_names():
        raise ManifestError(_explain_unknown(name, carded_names()))
    return load_card(shipped_folder() / f"{name}.json")


def shipped_manifest(name: str) -> Manifest:
    """Load a shipped manifest by its dataset's name.

    Raises
    ------
    ManifestError
        If the name is unknown; the message lists the known ones. If the set has a card alone, the message says so.

    Examples
    --------
    >>> from eldata.manifest import shipped_manifest
    >>> manifest = shipped_manifest("eld")
    >>> len(manifest.records), manifest.records[3].path
    (640, 'CanonEOS700D/scene-1/IMG_0004.CR2')
    """
    if name in carded_names() and name not in shipped_names():
        raise ManifestError(
            f"eldata knows {name!r} by its card alone, without a list of its files: eldata info {name} says what is "
            "known; eldata manifest FOLDER -o mine.csv lists camera raws, you list arrays (docs/adding-a-dataset.md)"
        )
    if name not in shipped_names():
        raise ManifestError(_explain_unknown(name, shipped_names()))
    return load_manifest(shipped_folder() / f"{name}.csv")


def registered_names() -> tuple[str, ...]:
    """Return the names of the sets of other packages, sorted."""
    return tuple(sorted({point.name for point in entry_points(group=ENTRY_POINTS)}))


def registered_place(name: str, own: str | None = None) -> str | None:
    """Resolve a name to ``own``, if eldata has it, or to another package's ``module:Class``; ``None``: it is unknown.

    Raises
    ------
    ArgumentError
        If it stands for several.
    """
    found = [own] if own else []
    found += [point.value for point in entry_points(group=ENTRY_POINTS, name=name)]
    if len(found) > 1:
        raise ArgumentError(
            f"{len(found)} datasets are called {name!r}: {', '.join(found)}; import the one that you want"
        )
    return found[0] if found else None


def registered_manifest(name: str, place: str) -> Path:
    """Return the path of the manifest of a set that another package registers as ``module:Class``.

    Raises
    ------
    ManifestError
        If it is not there.
    """
    package, *inner = place.partition(":")[0].strip().split(".")
    spec = find_spec(package)
    if spec is None:
        raise ManifestError(f"dataset {name!r} is registered as {place}, but there is no module {package}; install it")
    roots = spec.submodule_search_locations or [str(Path(spec.origin or package).parent)]  # or a module alone
    folders = [folder if folder.is_dir() else folder.parent for folder in (Path(root, *inner) for root in roots)]
    for folder in folders:
        if (folder / f"{name}.csv").is_file():
            return folder / f"{name}.csv"
    raise ManifestError(
        f"dataset {name!r} is registered as {place}, whose folder {folders[0]} has no {name}.csv; commands need that "
        f"manifest with its card {name}.json there (docs/adding-a-dataset.md)"
    )


def known_names() -> tuple[str, ...]:
    """Return the names of all sets: those with a shipped card, and those that other installed packages register."""
    return tuple(dict.fromkeys((*carded_names(), *registered_names())))


def known_manifest(name: str) -> Manifest:
    """Load the manifest of a set by its name: a shipped one, or one that another installed package registers.

    Raises
    ------
    ManifestError
        If the name is unknown (the message lists the known ones), the set has a card alone, or what a package registers
        has no manifest, or one of another name.
    ArgumentError
        If several sets have the name.
    """
    shipped = name in carded_names()
    place = registered_place(name, "the one that comes with eldata" if shipped else None)
    if place is None:
        raise ManifestError(_explain_unknown(name, known_names()))
    if shipped:
        return shipped_manifest(name)
    manifest = load_manifest(registered_manifest(name, place))
    if manifest.name != name:
        raise ManifestError(
            f"{manifest.path}: its card names it {manifest.name!r}, but it is registered as {name!r}; give it one name"
        )
    return manifest


def _own_path(name: str, root: Path | str | None) -> Path | None:
    """Find NAME.csv of a set of one's own: here, or in the folder ``manifests`` in the data root or beside it."""
    places = Path(), data_root(root) / "manifests", data_root(root).parent / "manifests"
    return next((place / f"{name}.csv" for place in places if (place / f"{name}.csv").is_file()), None)


def find_manifest(dataset: Path | str, root: Path | str | None = None) -> Manifest:
    """Load the manifest of a set: its CSV file, a known set's by its name, or NAME.csv of one's own.

    Raises
    ------
    ManifestError
        Like :func:`load_manifest` and :func:`known_manifest`.
    """
    if not is_name(dataset):
        return load_manifest(dataset)
    own = None if dataset in known_names() else _own_path(str(dataset), root)
    return known_manifest(str(dataset)) if own is None else load_manifest(own)


def known_manifests(root: Path | str | None = None) -> tuple[tuple[Manifest, ...], tuple[str, ...]]:
    """Load the manifests of all known sets as files are checked against them, and say why some cannot be loaded.

    What another package registers must not keep the rest from being used.
    """
    manifests, problems = [], []
    for name in dict.fromkeys((*shipped_names(), *registered_names())):
        try:
            manifests.append(checking_manifest(name, root))
        except EldataError as error:
            problems.append(str(error))
    return tuple(manifests), tuple(problems)


def _explain_unknown(name: str, known: Collection[str]) -> str:
    """Explain that no dataset has this name: list its parts, or known and similar names."""
    parts = [one for one in known if name and one.startswith(f"{name.casefold()}-")]
    meant = f"it is {' and '.join(parts)}: name one" if parts else f"known are {', '.join(known)}"
    return f"no dataset is called {name!r}; {meant}{'' if parts else did_you_mean(name, known)}"


def locked_path(name: str, root: Path | str | None = None) -> Path:
    """Return the path that ``eldata lock NAME`` writes: a known set's manifest with a copy's sizes and hashes.

    Beside the data that it is about, not in the package, which the next update would replace.
    """
    return data_root(root) / "manifests" / f"{name}.csv"


def checking_manifest(name: str, root: Path | str | None = None) -> Manifest:
    """Load the manifest that a set's files are checked against: as locked for this copy, else as known.

    Raises
    ------
    ManifestError
        Like :func:`known_manifest`; or if it was locked from another version of the manifest.
    """
    known, path = known_manifest(name), locked_path(name, root)
    if not path.is_file():
        return known
    locked = load_manifest(path)
    if (locked.name, locked.card.version) != (name, known.card.version):
        raise ManifestError(
            f"{path}: is of {locked.name} {locked.card.version}, and eldata knows {name} {known.card.version}; move it "
            f"away, and lock again (eldata lock {name})"
        )
    return locked


def is_name(text: Path | str) -> bool:
    """Tell whether a text is a set's name: it is known, or it looks like one, and is not a file."""
    if not isinstance(text, str) or not text or Path(text).name != text:
        return False
    return text in known_names() or not (Path(text).suffix or Path(text).exists())


def find_manifests(where: Path | str | Iterable[Path | str], root: Path | str | None = None) -> tuple[Manifest, ...]:
    """Load one manifest (a CSV file), all of a folder, a known set's by its name, or several of these.

    A known name is a name: a folder of that name is ``./eld``. With ``root``, the folder that holds the datasets, what
    ``eldata lock NAME`` has recorded there is taken instead of the known manifest.

    Raises
    ------
    ManifestError
        If there is none, or one is malformed; of a name, like :func:`checking_manifest`.
    """
    if not isinstance(where, (str, Path)):
        return tuple(manifest for one in where for manifest in find_manifests(one, root))
    if is_name(where):
        if where in known_names():
            return (checking_manifest(str(where), root),)
        if own := _own_path(str(where), root):
            return (load_manifest(own),)
        known = _explain_unknown(str(where), known_names())
        raise ManifestError(f"{where}: there is no such file or folder, and {known}")
    path = Path(where)
    if path.is_dir():
        found = [file for file in visible_below(path, deep=False) if file.suffix == ".csv"]
        if not found:
            raise ManifestError(f"{path}: holds no manifest (*.csv)")
        return tuple(load_manifest(file) for file in found)
    if path.is_file() and path.suffix.lower() != ".csv":
        raise ManifestError(f"{path}: is not a manifest, a CSV file; give one, a folder of them, or a dataset's name")
    return (load_manifest(path),)
