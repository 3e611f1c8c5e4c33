"""The frames of a store, as datasets read them: :class:`StoreFrames`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from eldata.errors import DatasetError
from eldata.manifest.pairs import select_pairs
from eldata.protocols.named import default_protocol
from eldata.records import FrameRecord
from eldata.sources.frames import Frame
from eldata.sources.store.format import StoredFrame, StoredRgb
from eldata.sources.store.read import PixelReader, StoredMosaic, open_store

if TYPE_CHECKING:
    from pathlib import Path

    from eldata.manifest.pairs import Choice
    from eldata.raw.levels import FrameLevels
    from eldata.records import PairRecord


class StoreFrames:
    """The frames of a store: a :class:`~eldata.sources.frames.FrameSource` that reads only the parts it is asked for.

    Raises
    ------
    StoreError
        If the file is not a store, truncated, not complete, or of a newer version.
    """

    reads_parts = True

    def __init__(self, path: Path | str) -> None:
        self.store = open_store(path)
        self.path = self.store.path
        self.decodes_long = self.store.compression == "zstd"
        self._reader = PixelReader(self.path)
        self._held = {frame.path: frame for frame in self.store.every}
        self._before = f"{self.path.as_posix()}/"
        self._kinds: dict[tuple[int, int], int] = {}
        self._kind_numbers: dict[tuple[object, ...], int] = {}

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_held": {}, "_kinds": {}}  # of this process's objects

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state, _held={frame.path: frame for frame in state["store"].every})

    @property
    def records(self) -> tuple[FrameRecord, ...]:
        """The rows of the manifest whose files are held; of clean frames those that they would have."""
        if self.store.manifest is None:
            return tuple(FrameRecord(frame.path, frame.role, frame.sensor.model) for frame in self.store.frames)
        return tuple(record for record in self.store.manifest.records if record.path in self._held)

    def frame(self, path: str) -> Frame:
        """Open a frame by its path, with or without the store's before it.

        Raises
        ------
        DatasetError
            If the store does not hold it.
        """
        held = self._found(path)
        name = str(self.path / held.path)
        mosaic = StoredMosaic(self._reader, held.key, held.shape)
        if isinstance(held, StoredRgb):
            return Frame.of_rgb(mosaic, name)
        return Frame.of_raw(mosaic, held.sensor, name, held.exposure, held.channel_white_levels_dn)

    def kind_of(self, path: str) -> int:
        """Return a number that frames share which make a pair, or none, with the same others: by all but its colours.

        Raises
        ------
        DatasetError
            If the store does not hold it.
        """
        held = self._found(path)
        if isinstance(held, StoredRgb):
            return self._kind_numbers.setdefault((held.shape,), len(self._kind_numbers))
        facts = id(held.sensor), id(held.exposure)  # which a store keeps as long as itself
        if facts not in self._kinds:
            sensor = held.sensor
            levels = sensor.black_level_dn, sensor.white_level_dn
            kind = held.shape, sensor.cfa, levels, held.exposure.iso, held.exposure.exposure_s
            self._kinds[facts] = self._kind_numbers.setdefault(kind, len(self._kind_numbers))
        return self._kinds[facts]

    def _found(self, path: str) -> StoredFrame | StoredRgb:
        held = self._held.get(path.removeprefix(self._before))
        if held is None:
            raise DatasetError(f"{self.path}: holds no frame {path!r}; pack the dataset again")
        return held

    @property
    def levels(self) -> FrameLevels:
        """The levels of its frames unless others are asked for: those of the protocol that its set's card names."""
        manifest = self.store.manifest
        return "metadata" if manifest is None else default_protocol(manifest.card).frame_levels

    def pairs(self, choice: Choice) -> tuple[PairRecord, ...]:
        """Return the pairs that are held and chosen.

        Raises
        ------
        DatasetError
            If the store holds clean frames or clips, or only a part of the chosen subset.
        ArgumentError
            If a value is unknown, or no pair is left.
        """
        manifest = self.store.manifest
        if manifest is None:
            raise DatasetError(f"{self.path}: holds clean frames, not pairs; read it with StoredFrames")
        subset = choice.get("subset")
        if subset is not None:  # counted on the whole manifest: a store of a part may lack some
            wanted = {pair.path for pair in select_pairs(manifest.records, manifest.card.subsets, subset=subset)}
            lacking = sorted(wanted - set(self._held))
            if lacking:
                raise DatasetError(
                    f"{self.path}: lacks {len(lacking)} of the {len(wanted)} pairs of the subset {subset!r}, such as "
                    f"{lacking[0]}; pack the whole dataset, or that subset"
                )
            held = [record for record in self.records if record.role != "noisy" or record.path in wanted]
        else:
            held = list(self.records)
        rest = choice.copy()
        rest["subset"] = None  # it is chosen
        return select_pairs(held, (), **rest)
