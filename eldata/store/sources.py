"""What is packed: the files of a dataset's pairs, or a folder of clean raws."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from eldata.errors import ArgumentError, DatasetError
from eldata.manifest.catalogue import Manifest, load_manifest, shipped_manifest
from eldata.manifest.pairs import select_pairs
from eldata.manifest.subsets import find_subset
from eldata.raw.extensions import RAW_EXTENSIONS

if TYPE_CHECKING:
    from collections.abc import Collection

    from eldata.records import Role


@dataclass(frozen=True, slots=True)
class Source:
    """Files to pack.

    Attributes
    ----------
    dataset
        Name of the dataset, or of the folder.
    folder
        Where the paths start.
    files
        Path and role of each, in the order in which they are packed.
    manifest
        ``None`` for a folder of clean frames.
    """

    dataset: str
    folder: Path
    files: tuple[tuple[str, Role], ...]
    manifest: Manifest | None = None

    @property
    def digest(self) -> str:
        """``sha256:<hex>`` of manifest and file list: a part made from others is not resumed."""
        lines = [self.dataset, "" if self.manifest is None else self.manifest.digest]
        lines += [f"{role} {path}" for path, role in self.files]
        text = "\n".join(lines)
        return f"sha256:{hashlib.sha256(text.encode()).hexdigest()}"


def source_of_dataset(
    name: str,
    *,
    root: Path | str | None = None,
    manifest: Path | str | None = None,
    cameras: Collection[str] | None = None,
    splits: Collection[str] | None = None,
    subset: str | None = None,
) -> Source:
    """Return the files of a dataset's pairs: references first come, each once, then their noisy frames.

    Parameters
    ----------
    name
        The dataset's name, that of its manifest.
    root
        The folder that holds the datasets; default ``$ELDATA_ROOT``, else ``./data``.
    manifest
        A manifest's CSV file in place of the shipped one.
    cameras, splits, subset
        Which pairs; ``None`` means all.

    Raises
    ------
    ManifestError
        If there is no such dataset, or the manifest is malformed.
    ArgumentError
        If a camera, split or subset is unknown, or no pair is left; or if the manifest is of another dataset.
    DatasetError
        If the folder is not there, or the pairs are not raw files.
    """
    loaded = shipped_manifest(name) if manifest is None else load_manifest(manifest)
    if loaded.name != name:
        raise ArgumentError(f"{manifest}: is the manifest of {loaded.name!r}, not of {name!r}")
    if any("*" in record.path or record.path.lower().endswith(".png") for record in loaded.records):
        raise DatasetError(f"{name}: a store holds pairs and clean raw frames, not clips; read them with its class")
    pairs = select_pairs(
        loaded.records,
        cameras=cameras,
        splits=splits,
        subset=None if subset is None else find_subset(loaded.card.subsets, subset),
    )
    files: dict[str, Role] = {}
    for pair in pairs:
        files.setdefault(pair.reference, "reference")
        files[pair.path] = "noisy"
    packed = [path for path in files if path.endswith(".npy")]
    if packed:
        raise DatasetError(
            f"{packed[0]}: is a packed array, not a raw file in DN, as are {len(packed)} in all; a store holds raw "
            "files (eldata synthesize --format dng makes them)"
        )
    folder = loaded.folder(root)
    if not folder.is_dir():
        raise DatasetError(
            f"{folder}: there is no such folder; --root names the folder that holds {loaded.card.folder} (where to "
            f"get it: {loaded.card.homepage})"
        )
    return Source(name, folder, tuple(files.items()), loaded)


def source_of_folder(folder: Path | str) -> Source:
    """Return the camera raws of a folder as clean frames, such as the long exposures of SID.

    Raises
    ------
    DatasetError
        If it holds none.
    """
    folder = Path(folder)
    found = sorted(path for path in folder.rglob("*") if path.suffix.lower() in RAW_EXTENSIONS)
    if not found:
        raise DatasetError(f"{folder}: holds no camera raw file")
    files: list[tuple[str, Role]] = [(path.relative_to(folder).as_posix(), "reference") for path in found]
    return Source(folder.resolve().name, folder, tuple(files))
