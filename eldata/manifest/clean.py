"""Which raws of a folder are clean: by a manifest beside them, by ISO and exposure, or by a pattern of their paths."""

from __future__ import annotations

from collections import defaultdict
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING

from eldata.base.numbers import counted
from eldata.errors import DatasetError, ManifestError, RawFileError
from eldata.manifest.card import load_card
from eldata.manifest.catalogue import load_manifest, shipped_folder
from eldata.manifest.pair_checks import RATIO_TOLERANCE
from eldata.raw.files import raws_below

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from eldata.records import RawHeader, Role

_UP = 4  # folders above one in which its manifest may lie
_HOW = (
    "say which are: give a manifest (eldata manifest FOLDER -o mine.csv), or a pattern of their paths, such as "
    "reference='*/long/*' (--reference of eldata pack and synthesize); '*' takes all"
)


def clean_raws(folder: Path, reference: str | None = None) -> list[Path]:
    """Return the camera raws below a folder that are clean frames, sorted.

    Of files that a manifest beside them lists, or the shipped one of a folder of that name, these are the references.
    Of others all, if a camera's are of one ISO; else, as ``eldata manifest`` has it, those at its lowest ISO, if in
    each folder they are what was exposed most (ISO times exposure time), and no folder is without them.

    Parameters
    ----------
    folder
        Searched through at any depth.
    reference
        Pattern of the clean frames' paths below it, with ``*`` and ``?``, in place of all this.

    Raises
    ------
    DatasetError
        If there is none, or it is not certain which they are.
    """
    paths = raws_below(folder)
    if reference is not None:
        chosen = [path for path in paths if fnmatchcase(path.relative_to(folder).as_posix(), reference)]
        if not chosen:
            raise DatasetError(f"{folder}: none of its {counted(len(paths), 'camera raw')} has a path like {reference}")
        return chosen
    roles = _listed_roles(folder, paths)
    chosen = [path for path in paths if roles.get(path) == "reference"]
    others = [path for path in paths if path not in roles]
    if not chosen and not others:
        raise DatasetError(f"{folder}: its manifest lists no reference among its {counted(len(paths), 'camera raw')}")
    return sorted(chosen + (_by_exposure(folder, others) if len(others) > 1 else others))


def _listed_roles(folder: Path, paths: Sequence[Path]) -> dict[Path, Role]:
    """Return the roles that a manifest states of these files: the nearest one that lists some."""
    whole = folder.resolve()
    above = (whole, *whole.parents[:_UP])
    near = (*above, *(path for path in whole.iterdir() if path.is_dir()))
    for table, base in _tables_beside(above, near):
        rows = {base / row.path: row.role for row in load_manifest(table).records}
        roles = {path: rows[there] for path in paths if (there := whole / path.relative_to(folder)) in rows}
        if roles:
            return roles
    return {}


def _tables_beside(places: Sequence[Path], near: Sequence[Path]) -> Iterator[tuple[Path, Path]]:
    """Yield manifests in these places and the shipped ones, with the folders near by that have their set's name."""
    for place in (*(each for one in places for each in (one, one / "manifests")), shipped_folder()):
        for path in sorted(place.glob("*.csv")):
            try:
                name = load_card(path.with_suffix(".json")).folder
            except ManifestError:  # another table
                continue
            yield from ((path, base) for base in near if base.name.casefold() == name.casefold())


def _by_exposure(folder: Path, paths: Sequence[Path]) -> list[Path]:
    from eldata.raw.reading import read_header

    cameras: dict[str, list[tuple[Path, RawHeader]]] = defaultdict(list)
    chosen: list[Path] = []
    for path in paths:
        try:
            header = read_header(path)
        except RawFileError:
            chosen.append(path)  # whatever reads it says why it cannot
        else:
            cameras[header.model].append((path, header))
    for frames in cameras.values():
        isos = sorted({header.exposure.iso for _, header in frames if header.exposure.iso is not None})
        if len(isos) < 2:
            chosen += [path for path, _ in frames]
            continue
        places: dict[Path, list[tuple[Path, RawHeader]]] = defaultdict(list)
        for path, header in frames:
            places[path.parent].append((path, header))
        for place, members in places.items():
            light = {path: (of.exposure.iso or 0) * (of.exposure.exposure_s or 0) for path, of in members}
            lowest = [path for path, of in members if of.exposure.iso == isos[0]]
            if not lowest or min(light[path] for path in lowest) * (1 + RATIO_TOLERANCE) < max(light.values()):
                those = "those at the lowest are not what was exposed most" if lowest else "none is at the lowest"
                raise DatasetError(
                    f"{folder}: its {counted(len(frames), 'camera raw')} are of ISO {isos[0]} to {isos[-1]}, and in "
                    f"{place} {those}, so it is not certain which are clean; {_HOW}"
                )
            chosen += lowest
    return chosen
