"""What is packed: the files of a dataset's pairs or clips, or a folder of clean raws."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from eldata.errors import ArgumentError, DatasetError
from eldata.manifest.card import card_text
from eldata.manifest.catalogue import FrameFiles, Manifest, known_manifest, load_manifest
from eldata.manifest.clips import choose_clips, clips_of
from eldata.manifest.layouts import scan_raw
from eldata.manifest.own import clean_raws
from eldata.manifest.pairs import Choice
from eldata.manifest.patterns import expand, is_pattern, is_png
from eldata.manifest.table import table_text
from eldata.raw.files import raws_below

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Sequence
    from fractions import Fraction

    from eldata.manifest.card import Card
    from eldata.records import FrameRecord, Role

# How calibration frames lie: <camera>/{bias,flat}/ISO<iso>/...
_CALIBRATION = re.compile(r"(?:(?P<camera>[^/]+)/)?(?P<role>bias|flat)/ISO(?P<iso>[1-9][0-9]{0,8})/.+")

# The name that a list of DRV's camera raws has (eldata.manifest.layouts).
_RAW_CLIPS = "drv-raw"


class CalibrationPlace(NamedTuple):
    """What the path of a calibration frame says of it; a camera that is not named is empty."""

    camera: str
    role: Role
    iso: int


def calibration_place(path: str) -> CalibrationPlace | None:
    """Return what a path says of a calibration frame; ``None``: it is not one's."""
    found = _CALIBRATION.fullmatch(path)
    if found is None:
        return None
    return CalibrationPlace(found["camera"] or "", "bias" if found["role"] == "bias" else "flat", int(found["iso"]))


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
    listing
        What the store keeps of the manifest, its CSV and its card as bytes; of clips, patterns are expanded.
    """

    dataset: str
    folder: Path
    files: tuple[tuple[str, Role], ...]
    manifest: Manifest | None = None
    listing: tuple[bytes, bytes] | None = None

    @property
    def frame_files(self) -> FrameFiles:
        """Where they lie, with what the manifest's card states of them."""
        if self.manifest is None:
            return FrameFiles(self.folder)
        return FrameFiles.of(self.folder, self.manifest.card, self.manifest.records)


def source_of_dataset(
    name: str,
    *,
    root: Path | str | None = None,
    manifest: Path | str | None = None,
    ids: Collection[str] | None = None,
    cameras: Collection[str] | None = None,
    scenes: Collection[str | int] | None = None,
    isos: Collection[int] | None = None,
    ratios: Collection[float | Fraction] | None = None,
    split: str | Collection[str] | None = None,
    subset: str | None = None,
    exclude_flags: Collection[str] = (),
) -> Source:
    """Return the files of a dataset's pairs or clips: references first come, each once, then their noisy frames.

    Parameters
    ----------
    name
        The dataset's name, that of its manifest; ``drv-raw`` is the camera raws of DRV, found below its folder.
    root
        The folder that holds the datasets; default ``$ELDATA_ROOT``, else ``./data``.
    manifest
        A manifest's CSV file in place of the shipped one.
    ids
        Which clips, such as ``["0007", "M0003"]``: their scenes.
    cameras, scenes, isos, ratios, split, subset, exclude_flags
        Which pairs or clips: see :class:`~eldata.manifest.pairs.Choice`.

    Raises
    ------
    ManifestError
        If there is no such dataset, or the manifest is malformed.
    ArgumentError
        If a camera, split or subset is unknown, or no pair is left; or if the manifest is of another dataset.
    DatasetError
        If the folder or files of a clip are not there, a clip's frames do not follow one numbering, or the pairs are
        not raw files.
    """
    choice = Choice(cameras, scenes, isos, ratios, split, subset, exclude_flags)
    if name == _RAW_CLIPS and manifest is None:
        folder = _folder(known_manifest("drv"), root)
        scan = scan_raw(folder)
        return _source_of_clips(scan.card, scan.records, folder, choice, ids)
    loaded = known_manifest(name) if manifest is None else load_manifest(manifest)
    if loaded.name != name:
        raise ArgumentError(f"{manifest}: is the manifest of {loaded.name!r}, not of {name!r}")
    if _holds_clips(loaded.records):
        folder = _folder(loaded, root)
        return _source_of_clips(loaded.card, loaded.records, folder, choice, ids)
    if ids is not None:
        raise ArgumentError(f"{name}: holds pairs, not clips; choose them by cameras, splits or a subset")
    pairs = choice.pairs(loaded.records, loaded.card.subsets)
    files: dict[str, Role] = {}
    for pair in pairs:
        files.setdefault(pair.reference, "reference")
        files[pair.path] = "noisy"
    stated = FrameFiles.of(loaded.folder(root), loaded.card, loaded.records).stated
    packed = [path for path in files if path.endswith(".npy") and path not in stated]
    if packed:
        raise DatasetError(
            f"{packed[0]}: is a packed array, not a raw file in DN, as are {len(packed)} in all; a store holds raw "
            "files (eldata synthesize --format dng makes them)"
        )
    return Source(name, _folder(loaded, root), tuple(files.items()), loaded, _listing(loaded))


def _folder(manifest: Manifest, root: Path | str | None) -> Path:
    folder = manifest.folder(root)
    if not folder.is_dir():
        raise DatasetError(
            f"{folder}: there is no such folder; --root names the folder that holds {manifest.card.folder} (where to "
            f"get it: {manifest.card.homepage})"
        )
    return folder


def _holds_clips(records: Iterable[FrameRecord]) -> bool:
    """Return whether rows are clips: patterns, PNG frames, or noisy frames none of which has a nominal ratio."""
    rows = tuple(records)
    noisy = [row for row in rows if row.role == "noisy"]
    return any(is_pattern(row.path) or is_png(row.path) for row in rows) or (
        bool(noisy) and all(row.ratio is None for row in noisy)
    )


def _source_of_clips(
    card: Card,
    records: Sequence[FrameRecord],
    folder: Path,
    choice: Choice,
    ids: Collection[str] | None,
) -> Source:
    rows = expand(choose_clips(records, card.subsets, choice, ids=ids), folder)
    files: dict[str, Role] = {}
    for clip in clips_of(rows):
        if clip.reference is not None:
            files.setdefault(clip.reference, "reference")
        files |= dict.fromkeys(clip.frames, "noisy")
    kept = tuple(row for row in rows if row.path in files)
    counts = Counter(str(row.role) for row in kept)
    listing = replace(card, counts=dict(sorted(counts.items())), subsets=())
    path = Path(f"{card.name}.csv")  # what messages call it
    content = table_text(path, kept).encode(), card_text(listing).encode()
    manifest = load_manifest(path, content)
    return Source(card.name, folder, tuple(files.items()), manifest, content)


def _listing(manifest: Manifest) -> tuple[bytes, bytes]:
    return manifest.path.read_bytes(), manifest.path.with_suffix(".json").read_bytes()


def source_of_folder(folder: Path | str, reference: str | None = None) -> Source:
    """Return the clean frames of a folder, such as the long exposures of SID: :func:`eldata.manifest.own.clean_raws`.

    A folder of bias and flat-field frames, ``bias/ISO<iso>`` or ``flat/ISO<iso>``, gives them as what they are.

    Raises
    ------
    DatasetError
        If it holds none, or it is not certain which are clean.
    """
    folder = Path(folder)
    paths = [path.relative_to(folder).as_posix() for path in raws_below(folder)]
    places = {path: place.role for path in paths if (place := calibration_place(path)) is not None}
    files: dict[str, Role] = dict(places)
    if len(places) < len(paths):
        clean = (path.relative_to(folder).as_posix() for path in clean_raws(folder, reference))
        files |= {path: "reference" for path in clean if path not in places}
    return Source(folder.resolve().name, folder, tuple(sorted(files.items())))
