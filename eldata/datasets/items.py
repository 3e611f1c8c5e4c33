"""Items: crops drawn from (seed, draw, index), and read from frames of any source.

A dataset's ``draw_item`` says what an item is: which crop of which frames goes where, and the facts beside the pixels.
:class:`CroppedItems` reads its parts in order, by several threads where the source allows it, into memory that is used
again, one by one or as whole batches.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from bisect import bisect_right
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, fields
from itertools import accumulate, chain
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias, TypedDict, get_args, get_type_hints

import numpy as np
import torch
from torch.utils.data import Dataset

from eldata.base.compiled import in_threads
from eldata.base.numbers import checked_index
from eldata.base.seeds import checked_epoch, checked_seed, item_generator
from eldata.base.visible import in_line, name_of
from eldata.datasets.batches import Batch, Field, new_arrays, new_batch, reading_threads
from eldata.datasets.crops import Crop
from eldata.errors import ArgumentError, EldataError, check_choice
from eldata.manifest.pairs import Choice
from eldata.noise.dark_shading import DarkShading
from eldata.protocols.protocol import Amplification
from eldata.raw.levels import CLIP_RANGES, FRAME_LEVELS, Clip, FrameLevels

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from eldata.plots.axes import Drawing
    from eldata.plots.pictures import Panel
    from eldata.records import Sensor
    from eldata.sources.frames import Frame


Crops = Literal["random", "grid"]
Transform: TypeAlias = "Callable[[dict[str, Any]], Any]"
_THUMBNAIL = 220  # columns or rows


_keeps_counts = ContextVar("_keeps_counts", default=False)


@contextmanager
def keep_counts() -> Iterator[None]:
    """Read items to look at them, which does not count as asking for them."""
    token = _keeps_counts.set(True)
    try:
        yield
    finally:
        _keeps_counts.reset(token)


class SharedDraws:
    """Which draw an item gets: the k-th time that it is asked for, draw k; once an epoch is set, the epoch's.

    All workers count in one memory, forked or spawned, persistent or not, and see the epoch as it changes. Nothing is
    locked: only a sampler with replacement has two workers ask for one item at a time, in no order that repeats.
    """

    def __init__(self, items: int) -> None:
        # 0, or one more than the epoch that is set; then how often each item was asked for.
        self._memory = torch.zeros(1 + items, dtype=torch.int64).share_memory_()  # type: ignore[no-untyped-call]

    def set_epoch(self, epoch: int) -> None:
        """Fix the draw of every item."""
        self._memory[0] = epoch + 1

    def next_of(self, index: int) -> int:
        """Return the draw that an item gets now, and count that it was asked for."""
        if self._memory[0]:
            return int(self._memory[0]) - 1
        draw = int(self._memory[1 + index])
        if not _keeps_counts.get():
            self._memory[1 + index] = draw + 1
        return draw

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._memory.share_memory_()  # a copy has memory of its own, which its workers share again


def keywords_of(arguments: Mapping[str, Any], *own: str) -> dict[str, Any]:
    """Choose the base constructor's keywords from a constructor's ``locals()``: all but its ``own``."""
    return {name: value for name, value in arguments.items() if name not in ("self", "__class__", *own)}


def take_choice(options: dict[str, Any]) -> Choice:
    """Move the keywords that choose pairs or clips from the options into a Choice."""
    return Choice(**{field.name: options.pop(field.name) for field in fields(Choice)})


class Part(NamedTuple):
    """One read of an item: the crop of a frame, times ``gain``, into a tensor or one place of it.

    ``is_light``: the frame stands for the light itself, so it lies in [0, 1] whatever the dataset's clip, which is of
    noisy frames. ``facts`` are those of the sample that are known once the frame is open.
    """

    tensor: str
    frame: Frame
    place: int | None = None
    gain: float = 1.0
    is_light: bool = False
    facts: Mapping[str, Any] = MappingProxyType({})


@dataclass(slots=True, eq=False)
class DrawnItem:
    """One item before its pixels are read.

    Attributes
    ----------
    crop
        The part of each of its frames.
    shapes
        Of its tensors, by name.
    parts
        What is read, once; a source that decodes whole frames is asked for one after the other.
    facts
        What a sample has beside its tensors, complete once they were read.
    sensor
        Whose colours it is shown in; ``None``: as they are.
    """

    crop: Crop
    shapes: Mapping[str, tuple[int, ...]]
    parts: Iterable[Part]
    facts: dict[str, Any]
    sensor: Sensor | None


class Sample(TypedDict):
    """An item of any dataset, as torch's default collate accepts it, together with those of others.

    ``input`` and ``target`` are (C, h, w) float32, normalised, the input multiplied by ``ratio``: the files' own
    exposure ratio, or with another ``amplification`` the manifest's nominal one, which ``nominal_ratio`` always is; of
    made noise both are the one that was drawn. ``iso`` and ``exposure_s`` (seconds) are the noisy file's; of made
    noise the ISO is the one that was given or drawn. What is not known, or is not there, is nan, -1 or empty.

    Of made noise ``path`` and ``reference`` say where the clean frame comes from, ``camera_id`` is the place of the
    camera in the dataset, and from ``gain_dn_per_e`` on stand the parameters that it was made with
    (:class:`eldata.noise.NoiseParameters`; ``colour_bias_dn`` is (4,) float64). ``dark_frame`` names the dark frame of
    component D, of a clip the dark frames in order.

    A window of a clip has ``input`` (T, C, h, w); its ``path`` and ``reference``, ISO and time are the first frame's,
    ``start`` is that one's position in the clip, and ``clip`` the clip's in the source of made noise. ``target`` is the
    one still that all frames are compared with, (C, h, w): ``target.expand_as(input)`` repeats it without memory, and
    ``target[:, None]`` does so in a batch. Of a sequence (:mod:`eldata.manifest.clips`) and of made noise it has each
    frame's own, (T, C, h, w); a clip without reference has none.
    """

    input: torch.Tensor
    target: torch.Tensor
    ratio: float
    nominal_ratio: float
    iso: float
    exposure_s: float
    camera: str
    scene: str
    split: str
    path: str
    reference: str
    flags: str
    camera_id: int
    gain_dn_per_e: float
    tukey_lambda: float
    sigma_tl_dn: float
    sigma_gauss_dn: float
    sigma_row_dn: float
    colour_bias_dn: torch.Tensor
    dark_frame: str
    clip: int
    start: int


_BLANK: dict[type, Any] = {float: math.nan, int: -1, str: ""}
_UNKNOWN = {name: _BLANK[kind] for name, kind in get_type_hints(Sample).items() if kind in _BLANK}


def _complete(facts: Mapping[str, Any]) -> dict[str, Any]:
    """Add to an item's facts those that are not known."""
    return {**_UNKNOWN, "colour_bias_dn": torch.from_numpy(np.full(4, np.nan)), **facts}


class CroppedItems(Dataset[Sample], ABC):
    """Items that are crops: draw k of item i depends on (seed, k, i) alone, not on workers or other items.

    The k-th time that an item is asked for it is draw k, from 0 on, whatever the workers; after :meth:`set_epoch`
    always that of the epoch.

    Parameters
    ----------
    crop, augment, crops, seed, transform
        See :class:`eldata.datasets.base.PairDataset`.
    repeats
        Items per record, and the name of this argument.

    Raises
    ------
    ArgumentError
        If one is out of its range.
    """

    clip: Clip = "both"
    source: Any = None
    _unit = "items"

    def __init__(
        self, crop: int | None, augment: bool, crops: Crops, seed: int, transform: Transform | None,
        repeats: tuple[str, int],
    ) -> None:  # fmt: skip
        name, number = repeats
        self.seed, self.transform = checked_seed(seed), transform
        if number < 1 or (crop is not None and crop < 2):
            raise ArgumentError(f"{name} must be 1 or more and crop 2 or more; found {number}, {crop}")
        check_choice("crops", crops, get_args(Crops))
        if crops == "grid" and (crop is None or number != 1):
            raise ArgumentError(
                f"crops='grid' has each crop of a frame once: give crop=, its side, and leave {name} at 1; found "
                f"crop={crop}, {name}={number}"
            )
        self.crop, self.augment = crop, augment
        self.crops: Crops = crops
        self._repeats, self._repeats_name = number, name
        self._starts: list[int] | None = None  # of a grid: the first item of each record, and their number

    def _choose_values(
        self,
        levels: FrameLevels,
        clip: Clip,
        amplification: Amplification,
        shading: DarkShading | Path | str | None,
        cameras: Iterable[str],
    ) -> None:
        """Choose what becomes of DN: of inputs of these cameras, less a dark shading, which may be given as its file.

        Raises
        ------
        ArgumentError
            If a value is unknown (the message lists the known ones), or there is a shading and the inputs are of
            several cameras.
        ShadingError
            If the shading's file cannot be read.
        """
        check_choice("levels", levels, FRAME_LEVELS)
        check_choice("clip", clip, tuple(CLIP_RANGES))
        check_choice("amplification", amplification, get_args(Amplification))
        self.levels, self.clip, self.amplification = levels, clip, amplification
        self.dark_shading = None if shading is None else DarkShading.of(shading)
        several = list(dict.fromkeys(cameras))
        if self.dark_shading is not None and len(several) > 1:
            raise ArgumentError(
                f"dark_shading is of one body, {self.dark_shading.camera}, and there are pairs or clips of "
                f"{len(several)} cameras: {', '.join(several)}; choose one with cameras=[...]"
            )

    def set_epoch(self, epoch: int) -> None:
        """Give every item the draw of this epoch, in running workers too, until the next call.

        Raises
        ------
        ArgumentError
            If it is not a whole number from 0 up to below 2^32.
        """
        self._draws.set_epoch(checked_epoch(epoch))

    def _count_items(self, records: int, frames: Iterable[Frame]) -> None:
        """Count the items: of a grid its crops, in a frame of each record."""
        if self.crops == "grid" and self.crop is not None:
            counts = (Crop.count_tiles(frame, crop=self.crop, augment=self.augment) for frame in frames)
            self._starts = list(accumulate(counts, initial=0))
        self._records_count = records
        self._draws = SharedDraws(len(self))

    def __len__(self) -> int:
        return self._records_count * self._repeats if self._starts is None else self._starts[-1]

    def _record_of(self, place: int) -> tuple[int, int | None]:
        """Return the record that an item is of, and which crop of its grid."""
        if self._starts is None:
            return place % self._records_count, None
        index = place % self._starts[-1]
        record = bisect_right(self._starts, index) - 1
        return record, index - self._starts[record]

    @property
    def record_numbers(self) -> NDArray[np.int64]:
        """Number of the record of each item."""
        if self._starts is None:
            return np.arange(len(self)) % self._records_count
        return np.repeat(np.arange(self._records_count), np.diff(self._starts))

    def _indices_of(self, record: int) -> range:
        """Return the indices of the items of a record; of random crops the first one's."""
        return range(record, record + 1) if self._starts is None else range(*self._starts[record : record + 2])

    @property
    def _crop_text(self) -> str:
        """The choice of crops, in words."""
        grid = f", crops={self.crops!r}" if self._starts is not None else ""
        return f"crop={self.crop}, augment={self.augment}{grid}"

    @abstractmethod
    def draw_item(self, place: int, generator: np.random.Generator) -> DrawnItem:
        """Draw an item; ``place`` is its index, and its number of items more for each draw before."""

    @property
    def _may_differ(self) -> bool:
        """Whether the items of a batch may differ in size, which only reading shows: whole frames that are decoded."""
        return self.crop is None and not self.reads_parts

    def item(self, index: int) -> Any:
        """Draw an item from (seed, draw, index): what :meth:`draw_item` returns."""
        length = len(self)
        index = checked_index(index, length)
        draw = self._draws.next_of(index)
        return self.draw_item(index + draw * length, item_generator(self.seed, draw, index))

    # --- reading -----------------------------------------------------------------------------------------------------

    @property
    def reads_parts(self) -> bool:
        """Whether the source says that its frames read parts (:class:`eldata.sources.frames.FrameSource`)."""
        return getattr(self.source, "reads_parts", False)

    def _finish(self, items: Sequence[Any], arrays: Mapping[str, NDArray[Any]]) -> None:
        """Compute the tensors that are not read, for several items at once, whose arrays are stacked."""

    def _read_to_show(self, index: int = 0) -> tuple[dict[str, Any], Sensor | None]:
        """Read one item to be looked at, and the sensor of its target; raises like ``dataset[index]``."""
        with keep_counts():
            item = self.item(index)
        return self._read_sample(item), item.sensor

    def plot(self, index: int = 0) -> Drawing:
        """Draw an item: input, target and their difference; of a window of frames the first.

        Packed raw is rendered quickly, one pixel for each packed one, and both sides are stretched alike.

        Returns
        -------
        matplotlib.figure.Figure
            An axes each; it belongs to no pyplot, and a notebook shows it.

        Raises
        ------
        IndexError, FileError, DatasetError
            Like ``dataset[index]``.
        """
        from eldata.plots.pictures import side_by_side

        sample, sensor = self._read_to_show(index)
        return side_by_side(describe_sample(sample), render_sample(sample, sensor))

    def _outline(self) -> list[tuple[str, str]]:
        """Describe the dataset by names and values: all that its items depend on, for a repr is known again."""
        repeats = f"{self._repeats_name}={self._repeats}"
        items = f"{len(self)} {self._unit}, {self._crop_text}, {repeats}, seed={self.seed}"
        transform = [] if self.transform is None else [("transform", name_of(self.transform))]
        return [("items", items), *transform]

    def _describe_values(self) -> str:
        """Describe in words how DN become values: levels, clip, amplification, dark shading."""
        shading = "" if self.dark_shading is None else f", dark_shading={self.dark_shading.digest[:15]}"
        return f"levels={self.levels!r}, clip={self.clip!r}, amplification={self.amplification!r}{shading}"

    def __repr__(self) -> str:
        return f"{type(self).__name__}({in_line('; '.join(f'{name}: {text}' for name, text in self._outline()))})"

    def _repr_html_(self) -> str:
        """Render the dataset and its first item for notebooks."""
        return show_dataset(type(self).__name__, self._outline(), self._read_to_show if len(self) else None)

    def __iter__(self) -> Iterator[Sample]:
        return (self[index] for index in range(len(self)))

    def __getitem__(self, index: int) -> Sample:
        """Read one item.

        Raises
        ------
        IndexError
            If the index is outside.
        FileError
            If a file or store cannot be read.
        DatasetError
            If a frame is smaller than the crop (with ``augment`` a mosaic needs one period of the CFA more), or the
            frames of an item do not belong together.
        """
        sample: Sample = self._apply_transform(self._read_sample(self.item(index)))
        return sample

    def _apply_transform(self, sample: dict[str, Any]) -> Any:
        """Apply the dataset's transform to a sample; an error that it raises names the item."""
        if self.transform is None:
            return sample
        place = sample["path"]  # it may change the sample
        try:
            made = self.transform(sample)
        except Exception as error:
            error.add_note(f"in transform= of {type(self).__name__}, for {place}")
            raise
        if made is None:
            raise ArgumentError(f"{place}: transform= returned None; it returns the sample, changed or not")
        return made

    def _read_sample(self, item: DrawnItem) -> dict[str, Any]:
        """Read a drawn item: its tensors and facts by name."""
        arrays = new_arrays([Field(name, shape, "<f4") for name, shape in item.shapes.items()])
        self._read_items([item], {name: array[None] for name, array in arrays.items()})
        return {name: torch.from_numpy(array) for name, array in arrays.items()} | _complete(item.facts)

    def __getitems__(self, indices: Sequence[int]) -> list[Any]:
        """Read the items of a batch into memory that is used again (:mod:`eldata.datasets.batches`).

        torch's DataLoader calls this. Values and errors are as of ``dataset[i]``.
        """
        if self._may_differ:
            return [self[index] for index in indices]
        samples = self._read_batch(indices)
        return samples if self.transform is None else [self._apply_transform(dict(sample)) for sample in samples]

    def _read_batch(self, indices: Sequence[int]) -> list[dict[str, Any]]:
        """Read items into one piece of memory, or as they are where they do not fit one."""
        batch: Batch | None = None
        samples: list[dict[str, Any]] = []
        for group in [indices] if self.reads_parts else [[index] for index in indices]:
            items = [self.item(index) for index in group]
            shapes = items[0].shapes
            if batch is None:
                batch = new_batch([Field(name, (len(indices), *shape), "<f4") for name, shape in shapes.items()])
            if batch is None or any(item.shapes != batch.shapes for item in items):
                rest = map(self.item, indices[len(samples) + len(items) :])  # each is drawn once the last one was read
                made = [] if batch is None else batch.parts(samples)
                return [*made, *map(self._read_sample, chain(items, rest))]
            places = slice(len(samples), len(samples) + len(items))
            self._read_items(items, {name: array[places] for name, array in batch.arrays.items()})
            samples += [dict.fromkeys(shapes) | _complete(item.facts) for item in items]
            del items  # their frames, before the next ones are decoded
        return [] if batch is None else batch.parts(samples)

    def _read_items(self, items: Sequence[DrawnItem], arrays: Mapping[str, NDArray[Any]]) -> None:
        """Fill arrays with the parts of several items, by threads if the source reads parts."""

        def fill_part(place: int, part: Part) -> None:
            """Write a part of the item at this place, such as its input, into its array."""
            items[place].facts.update(part.facts)
            array = arrays[part.tensor][place]
            out, clip = array if part.place is None else array[part.place], "both" if part.is_light else self.clip
            items[place].crop.fill(part.frame, out, clip=clip, gain=part.gain)

        if self.reads_parts:
            works = [(place, part) for place, item in enumerate(items) for part in item.parts]
            values = sum(array[0].size for array in arrays.values())
            in_threads(lambda work: fill_part(*work), works, reading_threads(len(items), values))
        else:
            for place, item in enumerate(items):
                for part in item.parts:
                    fill_part(place, part)
                    del part  # its frame, before the next one is decoded
        self._finish(items, arrays)


# --- items to be looked at --------------------------------------------------------------------------------------------


def describe_sample(sample: Mapping[str, Any]) -> str:
    """Describe a sample: camera, scene, ISO, ratio and files."""
    facts = [str(sample[name]) for name in ("camera", "scene") if sample.get(name)]
    for name, form in (("iso", "ISO {:g}"), ("ratio", "×{:g}"), ("start", "frame {:g}")):
        value = sample.get(name)
        if value is not None and math.isfinite(value) and (value > 0 or (name == "start" and value == 0)):
            facts.append(form.format(value))
    return "\n".join(text for text in (", ".join(facts), str(sample.get("path", ""))) if text)


def render_sample(sample: Mapping[str, Any], sensor: Sensor | None) -> list[Panel]:
    """Return the pictures of a sample: its input, its target if it has one, and the error between them.

    Of a window of frames the first one is shown. Both sides are multiplied by the same number, which makes a dark
    target visible; the error is the mean over channels of the absolute difference, in the sample's own units.
    """
    from eldata.isp.rendering import brightening

    arrays = {name: np.asarray(sample[name]) for name in ("input", "target") if name in sample}
    sides = {name: array if array.ndim == 3 else array[0] for name, array in arrays.items()}
    brighter = brightening(sides.get("target", sides["input"]))
    more = "" if brighter == 1 else f", {brighter:g} times as bright"
    ratio = sample.get("ratio", 1.0)
    names = {"input": f"input ×{ratio:g}" if math.isfinite(ratio) and ratio != 1 else "input", "target": "target"}
    panels: list[Panel] = [(names[side] + more, _render(array * brighter, sensor)) for side, array in sides.items()]
    if len(sides) == 2 and sides["input"].shape == sides["target"].shape:
        panels.append(("absolute error, mean of channels", np.abs(sides["input"] - sides["target"]).mean(axis=0)))
    return panels


def show_dataset(
    name: str, outline: Sequence[tuple[str, str]], read: Callable[[], tuple[dict[str, Any], Sensor | None]] | None
) -> str:
    """Return a dataset as a notebook shows it: what it is, and its first item in small, or why that cannot be read."""
    from eldata.base.tables import block, picture, table
    from eldata.plots.pictures import thumbnail

    parts, notes = [table((), outline, left=(0, 1))], []
    try:
        if read is not None:
            sample, sensor = read()
            panels = [panel for panel in render_sample(sample, sensor) if panel[1].ndim == 3]
            parts += [picture(thumbnail(pixels, _THUMBNAIL), text) for text, pixels in panels]
            notes = [f"first item: {line}" for line in describe_sample(sample).splitlines()[:1]]
    except (EldataError, OSError) as error:
        notes = [f"the first item cannot be shown: {error}"]
    return block(name, *parts, notes=notes)


def _render(values: NDArray[Any], sensor: Sensor | None) -> NDArray[np.uint8]:
    """Return (C, h, w) as 8-bit colours: packed raw as a quick rendering, three colours as they are."""
    if len(values) != 3:
        from eldata.isp.rendering import preview

        return preview(values, sensor)
    colours: NDArray[np.uint8] = np.rint(np.clip(values, 0, 1) * 255).astype(np.uint8)
    return colours.transpose(1, 2, 0)
