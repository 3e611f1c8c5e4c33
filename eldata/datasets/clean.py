"""Clean frames and clips for synthetic noise: of raw files, arrays and stores, by their number."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, TypeGuard

import numpy as np

from eldata.base.compiled import scratch
from eldata.base.numbers import checked_number
from eldata.errors import ArgumentError, DatasetError, check_choice
from eldata.manifest.catalogue import FrameFiles, find_manifests, is_manifest
from eldata.manifest.clips import moment_name
from eldata.manifest.own import clean_raws
from eldata.manifest.patterns import expand, sequence_of
from eldata.noise.model import check_normalised
from eldata.raw._kernels import scatter_bayer
from eldata.raw.levels import LEVELS, CfaRows, Levels, check_in_dn, packing_sites, unpack
from eldata.raw.stated import StatedFile
from eldata.sources.frames import Files, Frame, FrameSource, KeptFrames, Pixels
from eldata.sources.store.read import SUFFIXES, Store

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from numpy.typing import NDArray

    from eldata.records import FrameRecord

_BAYER: CfaRows = ((0, 1), (3, 2))


class CleanSource(Protocol):
    """What :class:`~eldata.datasets.synthetic.pairs.SyntheticPairs` draws its clean crops from.

    If it has an attribute ``reads_parts``, that says whether its frames read only the parts that are asked for
    (:class:`eldata.sources.frames.FrameSource`).
    """

    def __len__(self) -> int:
        """Return the number of frames."""

    def frame(self, index: int) -> Frame:
        """Return one frame."""


class ClipSource(Protocol):
    """What :class:`~eldata.datasets.synthetic.pairs.SyntheticClips` draws from: for each clip, its frames in order."""

    def __len__(self) -> int:
        """Return the number of clips."""

    def clip(self, index: int) -> CleanSource:
        """Return the frames of one clip; they are decoded one by one."""


class CleanFrames:
    """Clean frames of raw files or of a store, by their number, such as the long exposures of SID.

    Items are the same from files and from a store of them; of a store only the crops are read.

    Parameters
    ----------
    source
        A folder, of whose camera raws those that are clean are taken (:func:`eldata.manifest.own.clean_raws`; files
        one by one are taken as they are); or a store (``eldata pack``): the frames of a packed folder, or the
        references of packed pairs; or a manifest (``.csv``, or a set's name, unless a folder has it): the references
        that it lists below ``$ELDATA_ROOT`` or ``./data``, be they raws or mosaics whose levels its card states. Or
        several of these and of files, one after the other.
    reference
        Pattern of the clean frames' paths below a folder, such as ``"*/long/*"``; ``"*"`` takes all.
    names
        Of a :class:`~eldata.sources.frames.FrameSource` given as ``source``: its frames, in this order.
    levels
        White level: the file's (``"metadata"``) or 16383 (``"published"``).
    keep
        Number of whole frames to keep in memory, in each process: those that were used last.

    Raises
    ------
    DatasetError
        If there is not a raw file, a store or manifest has no clean frames or a reference of it is not there, it is not
        certain which of a folder's are clean, or two of several places hold one file.
    ManifestError
        If a manifest is malformed.
    StoreError
        If the store is truncated, or of another version.
    ArgumentError
        If ``levels`` is unknown, or ``keep`` negative.

    Examples
    --------
    >>> from eldata.datasets import CleanFrames
    >>> len(CleanFrames("eldata-demo/data/ELD-demo/DemoAlpha"))
    4
    """

    def __init__(
        self,
        source: Path | str | Iterable[Path | str | StatedFile] | FrameSource,
        *,
        reference: str | None = None,
        names: Iterable[str] = (),
        levels: Levels = "metadata",
        keep: int = 0,
    ) -> None:
        check_choice("levels", levels, LEVELS)
        if keep < 0:
            raise ArgumentError(f"keep must be 0 or more; found {keep}")
        self.levels: Levels = levels
        self.keep = keep
        self._kept = KeptFrames(keep)
        if isinstance(source, FrameSource):
            self.origin, self.names = source, tuple(names)
        else:
            self.origin, self.names = _find_frames(source, reference)
        self._opened: dict[int, Frame] = {}  # those that read parts: without pixels

    @property
    def reads_parts(self) -> bool:
        """Whether the source reads parts of frames."""
        return self.origin.reads_parts

    def __len__(self) -> int:
        return len(self.names)

    def open_frame(self, index: int) -> Frame:
        """Open one frame; a file is decoded unless it is mapped, of a store nothing is read yet."""
        frame = self._opened.get(index)
        if frame is None:
            frame = self.origin.frame(self.names[index]).with_levels(self.levels)
            if frame.sensor is not None:
                check_in_dn(frame.name, frame.sensor, "noise")
            if self.reads_parts or frame.reads_parts:
                self._opened[index] = frame
        return frame

    def frame(self, index: int) -> Frame:
        """Return one frame, from memory if it is kept, else newly opened."""
        return self._kept.frame(index, partial(self._read, index)) if self.keep else self.open_frame(index)

    def _read(self, index: int) -> Frame:
        """Read one frame with its pixels."""
        opened = self.open_frame(index)
        return replace(opened, mosaic=opened.whole()) if self.reads_parts or opened.reads_parts else opened

    def __repr__(self) -> str:
        first = f"first {self.names[0]}, " if self.names else ""
        return f"CleanFrames({len(self)} frames, {first}levels={self.levels!r}, keep={self.keep})"


def clean_files(
    source: Path | str | Iterable[Path | str | StatedFile], reference: str | None = None
) -> tuple[Path | StatedFile, ...]:
    """Return the clean raw files of a folder, the references of a manifest, or the files that are given.

    Raises
    ------
    DatasetError
        If there is none, or it is not certain which they are.
    ManifestError
        If the manifest is malformed.
    """
    files: Sequence[Path | StatedFile]
    if not isinstance(source, (str, Path)):
        files = [place if isinstance(place, StatedFile) else Path(place) for place in source]
    elif is_manifest(source):
        files = _list_references(str(source))
    else:
        files = clean_raws(Path(source), reference)
    if not files:
        raise DatasetError("no raw file was given")
    return tuple(files)


def _list_references(manifest: str) -> list[Path | StatedFile]:
    """List the files of a manifest's references."""
    (loaded,) = find_manifests(manifest)
    folder = loaded.folder()
    rows = [row for row in expand(loaded.records, folder) if row.role == "reference"]
    if not rows:
        raise DatasetError(f"{manifest}: lists no reference below {folder}, and references are its clean frames")
    if missing := [row.path for row in rows if not (folder / row.path).is_file()]:
        lacks = f"lacks {len(missing)} of the {len(rows)} references of {manifest}, first {missing[0]}"
        raise DatasetError(f"{folder}: {lacks}; ELDATA_ROOT names the folder that holds the set")
    files = FrameFiles.of(folder, loaded.card, rows)
    return [files.at(row.path) for row in rows]


def _as_path(file: Path | StatedFile) -> Path:
    """Take the path of a file that may come with stated facts."""
    return file.path if isinstance(file, StatedFile) else file


def _find_frames(
    source: Path | str | Iterable[Path | str | StatedFile], reference: str | None
) -> tuple[FrameSource, tuple[str, ...]]:
    """Find the source of clean frames, files or a store, and the frames' names in it."""
    if not isinstance(source, (str, Path)):
        source = places = list(source)
        if any(map(_holds_frames, places)):
            several = _Several(places, reference)
            return several, several.names
    if not (isinstance(source, (str, Path)) and _is_store(source)):
        files = clean_files(source, reference)
        stated = {str(file.path): file for file in files if isinstance(file, StatedFile)}
        return Files(stated), tuple(str(_as_path(file)) for file in files)
    store = Store(source)
    clean = sorted(frame.path for frame in store.frames if frame.role == "reference" and frame.sensor.cfa)
    if not clean:
        raise DatasetError(f"{source}: holds no clean frames, but {len(store.frames)} of other kinds")
    return store, tuple(clean)


class _Several:
    """Frames of several folders, files and stores, by the names that the frames have."""

    records: tuple[FrameRecord, ...] = ()

    def __init__(self, places: Iterable[Path | str | StatedFile], reference: str | None) -> None:
        parts = [_find_frames(place if _holds_frames(place) else (place,), reference) for place in places]
        each = [(origin, name) for origin, names in parts for name in names]
        self.names = tuple(str(origin.path / name) if isinstance(origin, Store) else name for origin, name in each)
        check_once(self.names)
        self._of = dict(zip(self.names, each, strict=True))
        self.reads_parts = all(origin.reads_parts for origin, _ in parts)

    def frame(self, path: str) -> Frame:
        """Open one of the frames."""
        origin, name = self._of[path]
        return origin.frame(name)


def check_once(names: Sequence[object]) -> None:
    """Refuse a file that occurs in two of the given places, with a DatasetError."""
    if len(set(names)) < len(names):
        twice = next(name for place, name in enumerate(names) if name in names[:place])
        raise DatasetError(f"{twice}: lies in two of the folders or stores that were given; give each once")


def _holds_frames(place: Path | str | StatedFile) -> TypeGuard[Path | str]:
    """Check for a folder, a store or a manifest, as opposed to a single file."""
    return isinstance(place, (str, Path)) and (Path(place).is_dir() or _is_store(place) or is_manifest(place))


def _is_store(source: Path | str) -> bool:
    """Recognise a store by its extension."""
    return Path(source).suffix.lower() in SUFFIXES


class Arrays:
    """Clean frames from packed, normalised arrays (C, h, w) in memory (or memory-mapped).

    Parameters
    ----------
    arrays
        One array per frame, or one array (N, C, h, w).
    range_dn
        White minus black level of the camera that is simulated, DN.
    cfa
        Their CFA; by default RGGB.

    Examples
    --------
    >>> import numpy as np
    >>> from eldata.datasets import Arrays
    >>> len(Arrays(np.zeros((3, 4, 64, 64), np.float32), range_dn=15871.0))
    3
    """

    reads_parts = True

    def __init__(
        self, arrays: Sequence[NDArray[Any]] | NDArray[Any], *, range_dn: float, cfa: CfaRows = _BAYER
    ) -> None:
        if len(arrays) == 0:
            raise ArgumentError("no array was given")
        self.arrays = arrays
        self.range_dn = checked_number("range_dn", range_dn, above=0)
        self._sites = packing_sites(cfa)  # packed data starts where packing does, whatever the offset of its sensor
        self._black_level_dn = (0.0,) * self._sites.levels
        self.cfa = cfa
        check_normalised(np.asarray(arrays[0]), "array 0")

    def __len__(self) -> int:
        return len(self.arrays)

    def frame(self, index: int) -> Frame:
        """Return one array as a mosaic."""
        packed, name, sites = np.asarray(self.arrays[index]), f"array {index}", self._sites
        check_normalised(packed, name)
        if packed.ndim != 3 or len(packed) != sites.channels or any(side % sites.sub for side in packed.shape[1:]):
            unpack(packed, sites.cfa)  # raises, saying what is expected
        shape = packed.shape[1] * sites.scale, packed.shape[2] * sites.scale
        mosaic = Pixels(shape, np.dtype(np.float32), partial(self._read, packed))
        return Frame(mosaic, sites.cfa, self._black_level_dn, self.range_dn, name)

    def _read(self, packed: NDArray[Any], rows: slice, columns: slice) -> NDArray[np.float32]:
        """Unpack a part of a mosaic, in DN, into memory that the next call of this thread overwrites."""
        sites, range_dn = self._sites, np.float32(self.range_dn)
        period, scale = sites.period, sites.scale
        top, bottom, _ = rows.indices(packed.shape[1] * scale)
        left, right, _ = columns.indices(packed.shape[2] * scale)
        above, before = top % period, left % period  # of the periods that hold it
        height, width = above + bottom - top, before + right - left
        height, width = height + -height % period, width + -width % period
        row, column = (top - above) // scale, (left - before) // scale
        if period == 2 and packed.dtype == np.float32:
            whole: NDArray[np.float32] = scratch("unpacked", (height, width), range_dn.dtype)
            scatter_bayer(packed, row, column, sites.channel_of, range_dn, whole)
        else:
            periods = packed[:, row : row + height // scale, column : column + width // scale]
            whole = unpack(periods.astype(np.float32, copy=False), sites.cfa)
            whole *= range_dn
        return whole[above : above + bottom - top, before : before + right - left]

    def __repr__(self) -> str:
        return f"Arrays({len(self)} frames of shape {self.arrays[0].shape}, range_dn={self.range_dn:g})"


class CleanClips:
    """Clean clips by their number, for :class:`~eldata.datasets.synthetic.pairs.SyntheticClips`.

    Parameters
    ----------
    source
        A folder, or a store of it (``eldata pack FOLDER``): each folder at any depth below it that holds camera raws is
        a clip, in the order of the numbers in their names; of a manifest each folder that holds references. Or clips
        one by one: such folders, or :class:`CleanFrames`,
        :class:`~eldata.datasets.clean.Arrays` and the like in the order of time.
    levels
        Of folders and stores, as in :class:`CleanFrames`.

    Raises
    ------
    DatasetError
        If there is no clip, the names of a clip do not follow one numbering, or a store holds a dataset's pairs or
        clips.
    StoreError
        If the store is truncated, or of another version.
    ArgumentError
        If ``levels`` is unknown.

    Examples
    --------
    >>> import numpy as np
    >>> from eldata.datasets import Arrays, CleanClips
    >>> len(CleanClips([Arrays(np.zeros((9, 4, 64, 64), np.float32), range_dn=15871.0)]))
    1
    """

    def __init__(self, source: Path | str | Iterable[Path | str | CleanSource], *, levels: Levels = "metadata") -> None:
        check_choice("levels", levels, LEVELS)
        clips: list[CleanSource] = []
        for place in [source] if isinstance(source, (str, Path)) else source:
            if not isinstance(place, (str, Path)):
                clips.append(place)
            elif _is_store(place):
                clips += _read_clips(Store(place), levels)
            else:  # of clips that are given one by one all frames are taken
                reference = None if place is source else "*"
                clips += [CleanFrames(files, levels=levels) for files in clip_files(place, reference)]
        if not clips:
            raise DatasetError("no clip was given")
        self._clips: tuple[CleanSource, ...] = tuple(clips)

    def __len__(self) -> int:
        return len(self._clips)

    def clip(self, index: int) -> CleanSource:
        """Return the frames of one clip."""
        return self._clips[index]

    def __repr__(self) -> str:
        return f"CleanClips({len(self)} clips, first {self._clips[0]!r})"


class CleanScene(NamedTuple):
    """A clean file to make noisy ones of, and its place among all, from 0 on.

    ``drawn_for`` is the number of the scene, or clip, that parameters are drawn for, ``first`` the place of that one's
    first file among all; ``moment`` is the file's place in a clip from 1 on, else 0.
    """

    number: int
    file: Path | StatedFile
    scene: str
    drawn_for: int
    first: int
    moment: int = 0

    @property
    def path(self) -> Path:
        """Where the file lies."""
        return _as_path(self.file)

    def below(self, folder: Path) -> Path | StatedFile:
        """Put a folder before the path of the file."""
        return replace(self.file, path=folder / self.path) if isinstance(self.file, StatedFile) else folder / self.file


def clean_scenes(clean: Sequence[Path], clips: bool | None, reference: str | None = None) -> list[CleanScene]:
    """Return the clean files of folders and manifests in order: frames of clips, or each a scene.

    ``None``: scenes, if that is sure.

    Raises
    ------
    DatasetError
        If there is no raw file, it is not certain which are clean, the names of a clip do not follow one numbering, two
        folders hold the same file, or a folder below may be a clip or not.
    """
    groups: list[Sequence[Path | StatedFile]]
    if clips:
        groups = [files for folder in clean for files in clip_files(folder, reference)]
    else:
        groups = [[file] for folder in clean for file in clean_files(folder, reference)]
    check_once([_as_path(file) for files in groups for file in files])
    scenes: list[CleanScene] = []
    folders: dict[Path, list[str]] = {}
    for number, files in enumerate(groups):
        first = len(scenes)
        for moment, file in enumerate(files, 1):
            scene = moment_name(f"clip-{number + 1}", moment) if clips else f"scene-{number + 1}"
            scenes.append(CleanScene(len(scenes), file, scene, number, first, moment if clips else 0))
            folders.setdefault(scenes[-1].path.parent, []).append(scenes[-1].path.name)
    for folder, names in folders.items() if clips is None else ():
        # A clip's frames differ in their numbers; one stray name among them makes it no stills.
        if folder not in clean and len(names) > 1 and 3 * len(sequence_of(names).odd) < len(names):
            raise DatasetError(
                f"{folder}: its {len(names)} raw files, {names[0]} to {names[-1]}, may be frames of a clip or "
                "stills. Say which: --clips (clips=True) draws parameters once for each folder and keeps its "
                "frames together, --no-clips (clips=False) draws them for each frame"
            )
    return scenes


def clip_files(source: Path | str, reference: str | None = None) -> list[Sequence[Path | StatedFile]]:
    """Return the clips of a folder or manifest, each a folder at any depth that holds frames, in the order of numbers.

    Raises
    ------
    DatasetError
        If there is no raw file, it is not certain which are clean, or the names of a clip do not follow one numbering.
    """
    folders: dict[Path, dict[str, Path | StatedFile]] = {}
    for file in clean_files(source, reference):
        folders.setdefault(_as_path(file).parent, {})[_as_path(file).name] = file
    return [[files[name] for name in _order_names(folder, files)] for folder, files in sorted(folders.items())]


def _read_clips(source: Store, levels: Levels) -> Iterator[CleanFrames]:
    """Yield the clips of a store of clean raws: each folder in it is one."""
    if source.manifest is not None:
        raise DatasetError(f"{source.path}: holds a dataset, not clean clips; pack a folder of folders of clean raws")
    folders: dict[PurePosixPath, list[str]] = {}
    for frame in source.frames:
        place = PurePosixPath(frame.path)
        folders.setdefault(place.parent, []).append(place.name)
    for folder, names in sorted(folders.items()):
        paths = [str(folder / name) for name in _order_names(source.path / folder, names)]
        yield CleanFrames(source, names=paths, levels=levels)


def _order_names(folder: PurePosixPath | Path, names: Iterable[str]) -> tuple[str, ...]:
    """Return the names of a clip's frames in the order of their numbers."""
    sequence = sequence_of(names)
    if sequence.odd or sequence.doubles or sequence.gaps:
        what = ", ".join(sequence.odd) or f"two of {sequence.doubles}"
        if sequence.gaps:
            what = f"nothing from {sequence.gaps[0][0]} to {sequence.gaps[0][1]}"
        raise DatasetError(f"{folder}: expected the frames of one clip, numbered without a gap; found {what}")
    return sequence.names
