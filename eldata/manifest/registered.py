"""Sets that other installed packages register: their names, and where their manifests lie.

A package registers a set by an entry point of the group ``eldata.datasets``: its name, and the place of its class
(docs/adding-a-dataset.md). Python opens it by that class; commands need its manifest alone: ``<name>.csv`` and its card
``<name>.json`` in the folder of the class's module. Nothing of the package is imported for it: that may take seconds.
"""

from __future__ import annotations

from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path

from eldata.errors import ArgumentError, ManifestError

# The group of entry points under which other packages name their sets.
ENTRY_POINTS = "eldata.datasets"


def registered_names() -> tuple[str, ...]:
    """Return the names of the sets of other packages, sorted."""
    return tuple(sorted({point.name for point in entry_points(group=ENTRY_POINTS)}))


def registered_place(name: str, own: str | None = None) -> str | None:
    """Return what a name stands for: ``own``, what eldata has of that name, or ``module:Class``; ``None``: nothing.

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
    folders = [Path(folder).joinpath(*inner) for folder in spec.submodule_search_locations or ()]
    folders = [folder if folder.is_dir() else folder.parent for folder in folders]
    if not folders and spec.origin is not None:
        folders = [Path(spec.origin).parent]  # a module alone
    for folder in folders:
        if (folder / f"{name}.csv").is_file():
            return folder / f"{name}.csv"
    raise ManifestError(
        f"dataset {name!r} is registered as {place}, whose folder {folders[0] if folders else package} has no "
        f"{name}.csv; commands need that manifest with its card {name}.json there (docs/adding-a-dataset.md)"
    )
