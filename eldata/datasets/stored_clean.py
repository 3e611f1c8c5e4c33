"""Clean frames and clips of a store, for synthetic noise: only the crops are read."""

from __future__ import annotations

from pathlib import PurePosixPath
from typing import TYPE_CHECKING, Any

from eldata.datasets.clean import CleanFrame
from eldata.errors import DatasetError, check_choice
from eldata.manifest.patterns import sequence_of
from eldata.raw.levels import LEVELS, white_level_dn
from eldata.sources.store.read import PixelReader, StoredMosaic, open_store

if TYPE_CHECKING:
    from pathlib import Path

    from eldata.raw.levels import Levels
    from eldata.sources.store.layout import StoredFrame


def stored_mosaic(reader: PixelReader, frame: StoredFrame) -> StoredMosaic:
    """Return a stored frame's mosaic, to be read part by part."""
    return StoredMosaic(reader, frame.key, (frame.sensor.height, frame.sensor.width))


def stored_clean_frame(reader: PixelReader, frame: StoredFrame, white_level: float) -> CleanFrame:
    """Return a stored frame as one whose mosaic is read part by part."""
    mosaic: Any = stored_mosaic(reader, frame)
    name = str(reader.path / frame.path)
    return CleanFrame(mosaic, frame.sensor.cfa, frame.sensor.black_level_dn, white_level, name)


class _Frames:
    """Some frames of a store, in order."""

    def __init__(self, reader: PixelReader, frames: tuple[StoredFrame, ...], levels: Levels) -> None:
        self._reader = reader
        self.frames = frames
        self.levels: Levels = levels

    def __len__(self) -> int:
        return len(self.frames)

    def frame(self, index: int) -> CleanFrame:
        """Return one frame, whose mosaic is read part by part: ``mosaic[rows, columns]``."""
        frame = self.frames[index]
        return stored_clean_frame(self._reader, frame, white_level_dn(frame.sensor, self.levels))

    def __repr__(self) -> str:
        return f"clip of {self.frames[0].path}"


class StoredFrames(_Frames):
    """Clean frames of a store, for :class:`~eldata.datasets.synthetic.SyntheticPairs`: only the crops are read.

    The frames are those of a packed folder, or the references of packed pairs. Items are the same as from
    :class:`~eldata.datasets.clean.RawFiles` over the same files in the same order.

    Parameters
    ----------
    path
        The store.
    levels
        White level: the file's (``"metadata"``) or 16383 (``"published"``).

    Raises
    ------
    StoreError
        If the file is no store, truncated, not complete, or of a newer version.
    ArgumentError
        If ``levels`` is unknown.
    """

    def __init__(self, path: Path | str, *, levels: Levels = "metadata") -> None:
        check_choice("levels", levels, LEVELS)
        store = open_store(path)
        frames = sorted((frame for frame in store.frames if frame.role == "reference"), key=lambda frame: frame.path)
        super().__init__(PixelReader(store.path), tuple(frames), levels)
        self.path = store.path

    def __repr__(self) -> str:
        return f"StoredFrames({str(self.path)!r}, {len(self)} frames, levels={self.levels!r})"


class StoredClips:
    """Clean clips of a store, for :class:`~eldata.datasets.synthetic_clips.SyntheticClips`: only the crops are read.

    The store is of a folder of clean raws (``eldata pack FOLDER``); each folder in it that holds raws is a clip, as in
    :class:`~eldata.datasets.synthetic_clips.RawClips`, and items are the same.

    Parameters
    ----------
    path
        The store.
    levels
        White level: the file's (``"metadata"``) or 16383 (``"published"``).

    Raises
    ------
    StoreError
        If the file is no store, truncated, not complete, or of a newer version.
    DatasetError
        If it holds a dataset's pairs or clips, or the names of a clip do not follow one numbering.
    ArgumentError
        If ``levels`` is unknown.
    """

    def __init__(self, path: Path | str, *, levels: Levels = "metadata") -> None:
        check_choice("levels", levels, LEVELS)
        store = open_store(path)
        if store.manifest is not None:
            raise DatasetError(f"{path}: holds a dataset, not clean clips; pack a folder of folders of clean raws")
        self.path = store.path
        self.levels: Levels = levels
        reader = PixelReader(store.path)
        self._clips: list[_Frames] = []
        for folder in sorted({PurePosixPath(frame.path).parent for frame in store.frames}):
            of_name = {
                PurePosixPath(frame.path).name: frame
                for frame in store.frames
                if PurePosixPath(frame.path).parent == folder
            }
            sequence = sequence_of(of_name)
            if sequence.odd or sequence.doubles or sequence.gaps:
                raise DatasetError(
                    f"{path}/{folder}: expected the frames of one clip, numbered without a gap; found "
                    f"{', '.join(sequence.odd) or sequence.doubles or sequence.gaps}"
                )
            self._clips.append(_Frames(reader, tuple(of_name[name] for name in sequence.names), levels))

    def __len__(self) -> int:
        return len(self._clips)

    def clip(self, index: int) -> _Frames:
        """Return the frames of one clip; they are read part by part."""
        return self._clips[index]

    def __repr__(self) -> str:
        return f"StoredClips({str(self.path)!r}, {len(self)} clips, levels={self.levels!r})"
