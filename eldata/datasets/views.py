"""Pairs of a source given otherwise: in DN, half as much to send from a worker, or as two noisy frames of one scene."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import torch

from eldata.base.compiled import in_threads
from eldata.base.seeds import item_generator
from eldata.datasets.base import SIDES, PairFacts, PairItem, Sample
from eldata.datasets.batches import Field, new_arrays
from eldata.datasets.items import DrawnItem, Part, ReadItems, checked_index
from eldata.errors import ArgumentError, check_choice
from eldata.raw.cfa import packed_shape, packing_sites
from eldata.raw.levels import CLIP_RANGES, pack_normalised, packed_black_level_dn

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from eldata.datasets.base import SourcePairs
    from eldata.datasets.crops import Crop
    from eldata.raw.cfa import CfaRows
    from eldata.raw.levels import Clip
    from eldata.records import Sensor


Sampled = TypeVar("Sampled")


class DnSample(PairFacts):
    """One pair in DN: half as much to send from a worker as a :class:`~eldata.datasets.base.Sample`.

    ``input_dn`` and ``target_dn`` are (H, W) uint16, mosaics in DN as the files have them, the input not multiplied by
    ``ratio`` yet. ``cfa`` (theirs, 2 x 2, 4 x 4 or 6 x 6, uint8), ``input_black_dn``, ``target_black_dn`` (per CFA
    channel, float64) and the white levels are for :func:`normalise_batch`. The rest is as in
    :class:`~eldata.datasets.base.Sample`.
    """

    input_dn: torch.Tensor
    target_dn: torch.Tensor
    cfa: torch.Tensor
    input_black_dn: torch.Tensor
    target_black_dn: torch.Tensor
    input_white_dn: float
    target_white_dn: float


class _OfPairs(ReadItems[Sampled]):
    """Items of a dataset of pairs, as a subclass gives them."""

    def __init__(self, pairs: SourcePairs) -> None:
        self.pairs = pairs
        self.source, self.clip = pairs.source, pairs.clip

    @property
    def _may_differ(self) -> bool:
        """As that of the pairs."""
        return self.pairs._may_differ


class DnPairs(_OfPairs[DnSample]):
    """The items of a dataset of pairs in DN, for a DataLoader whose batches go through :func:`normalise_batch`.

    Sending a batch from a worker takes longer than reading it; uint16 is half as much to send. The conversion then runs
    in the main process, or on the device that the batch was moved to.

    Raises
    ------
    ArgumentError
        If a dark shading is taken off the input, which leaves fractions of a DN.
    """

    dtype = "<u2"

    def __init__(self, pairs: SourcePairs) -> None:
        if pairs.dark_shading is not None:
            raise ArgumentError(
                "batches in DN are of whole DN, and less a dark shading the input has fractions of one; leave "
                "dark_shading out, or take the normalised items"
            )
        super().__init__(pairs)

    def __len__(self) -> int:
        return len(self.pairs)

    def item(self, index: int) -> DrawnItem:
        """Draw an item of the pairs."""
        item: DrawnItem = self.pairs.item(index)
        item.shapes = dict.fromkeys((f"{side}_dn" for side in SIDES), (item.crop.height, item.crop.width))
        item.facts["cfa"] = torch.tensor(item.crop.cfa, dtype=torch.uint8)
        item.parts = self._in_dn(item.crop, item.facts, item.parts)
        return item

    def _in_dn(self, crop: Crop, facts: dict[str, Any], parts: Iterable[Part]) -> Iterator[Part]:
        """Yield both mosaics; their levels become facts."""
        for part in parts:
            facts[f"{part.tensor}_black_dn"] = torch.tensor(crop.levels(part.frame.black_level_dn), dtype=torch.float64)
            facts[f"{part.tensor}_white_dn"] = part.frame.white_level_dn
            yield part._replace(tensor=f"{part.tensor}_dn")

    def _fill(self, item: DrawnItem, part: Part, out: NDArray[Any]) -> None:
        """Copy one crop in DN, turned."""
        out[...] = item.crop.cut(part.frame)

    def _seen(self, index: int = 0) -> tuple[dict[str, Any], Sensor | None]:
        """Read the same item of the pairs, normalised."""
        return self.pairs._seen(index)

    def _outline(self) -> list[tuple[str, str]]:
        """Return what the pairs are."""
        return [("in DN", "for normalise_batch"), *self.pairs._outline()]

    def __repr__(self) -> str:
        return f"DnPairs({self.pairs!r})"


def normalise_batch(batch: Mapping[str, Any], *, clip: Clip = "both") -> dict[str, Any]:
    """Pack, normalise and amplify a batch in DN, on the device that it lies on: the samples that the raw route gives.

    Where division and multiplication of float32 are IEEE's, as on the CPU, the values are those of
    the dataset's, bit for bit.

    Parameters
    ----------
    batch
        A :class:`DnSample`, or several collated.
    clip
        As in :class:`~eldata.datasets.base.PairDataset`: of the input.

    Returns
    -------
    dict
        The batch with ``input`` and ``target``, (C, h, w) or (B, C, h, w) float32, in place of the mosaics and levels.

    Raises
    ------
    ArgumentError
        If ``clip`` is unknown, or the batch is not in DN.
    """
    check_choice("clip", clip, CLIP_RANGES)
    names = {"cfa", *(f"{side}_{what}" for side in SIDES for what in ("dn", "black_dn", "white_dn"))}
    if not names <= set(batch) or batch["input_dn"].dtype != torch.uint16:
        raise ArgumentError("expected a batch in DN, as PackedStore(...).in_dn() gives it: uint16 with its levels")
    result = {name: value for name, value in batch.items() if name not in names}
    images = [image for side in SIDES for image in _images(batch, side, clip if side == "input" else "both")]
    on_cpu = batch["input_dn"].device.type == "cpu"
    packed = _by_kernel(images) if on_cpu else _by_torch(images)
    sides = packed if batch["input_dn"].ndim == 2 else packed.chunk(2)
    return result | dict(zip(SIDES, sides, strict=True))


class _Image(NamedTuple):
    """One mosaic (H, W) of a batch in DN, and how it is normalised."""

    mosaic: torch.Tensor
    cfa: CfaRows
    black_level_dn: tuple[float, ...]
    white_level_dn: float
    gain: float
    clip: Clip


def _images(batch: Mapping[str, Any], side: str, clip: Clip) -> Iterator[_Image]:
    """Yield the images of one side of a batch; its numbers are fetched from the device at once."""
    several = batch["input_dn"].ndim == 3

    def each(value: Any) -> Any:
        values = torch.as_tensor(value).tolist()
        return values if several else [values]

    mosaics = batch[f"{side}_dn"] if several else batch[f"{side}_dn"][None]
    blacks, whites = each(batch[f"{side}_black_dn"]), each(batch[f"{side}_white_dn"])
    gains = each(batch["ratio"]) if side == "input" else [1.0] * len(mosaics)
    for mosaic, cfa, black, white, gain in zip(mosaics, each(batch["cfa"]), blacks, whites, gains, strict=True):
        yield _Image(mosaic, tuple(map(tuple, cfa)), tuple(black), white, gain, clip)


def _by_kernel(images: Sequence[_Image]) -> torch.Tensor:
    """Return images packed by the one packer, (N, C, h, w), on as many threads as torch takes.

    Into memory that is used again: the pages of new memory would cost several times as much as the packing.
    """
    mosaics = [image.mosaic.numpy() for image in images]
    shape = len(images), *packed_shape(mosaics[0].shape, images[0].cfa)
    packed = new_arrays([Field("packed", shape, "<f4")])["packed"]

    def work(number: int) -> None:
        image = images[number]
        black, white = image.black_level_dn, image.white_level_dn
        pack_normalised(mosaics[number], image.cfa, black, white, clip=image.clip, gain=image.gain, out=packed[number])

    in_threads(work, range(len(images)), torch.get_num_threads())
    return torch.from_numpy(packed)


def _by_torch(images: Sequence[_Image]) -> torch.Tensor:
    """Return images packed by torch on their device, (N, C, h, w): the packer's operations, one by one."""
    first = images[0].mosaic
    shape = packed_shape((first.shape[0], first.shape[1]), images[0].cfa)
    packed = torch.empty((len(images), *shape), dtype=torch.float32, device=first.device)
    for image, values in zip(images, packed, strict=True):
        low, high = CLIP_RANGES[image.clip]
        for in_mosaic, in_packed in packing_sites(image.cfa).slices:
            values[in_packed] = image.mosaic[in_mosaic].to(torch.float32)
        black = torch.from_numpy(packed_black_level_dn(image.cfa, image.black_level_dn)).to(first.device)[:, None, None]
        white = torch.tensor(image.white_level_dn, dtype=torch.float32, device=first.device)
        values.sub_(black).div_(white - black).clamp_(low, high)
        values.mul_(torch.tensor(image.gain, dtype=torch.float32, device=first.device)).clamp_(max=high)
    return packed


# --- pairs of two noisy frames of one scene, for training without a clean one -----------------------------------------


class Noise2Noise(_OfPairs[Sample]):
    """Two noisy frames of one scene, ISO and ratio: the input, and in place of the clean target another one.

    J. Lehtinen et al., ICML 2018, and the row of that name in K. Wei et al., TPAMI 2021. The samples are those of the
    pairs but for ``target``, a noisy frame that is drawn for the item, amplified and clipped like the input; ``path``
    is the input's. Targets whose negative read noise is clipped off are too bright where it is dark, and the network
    learns that: give the pairs ``clip="none"``, and test on the same.

    Parameters
    ----------
    pairs
        Of a source that reads parts, such as :class:`~eldata.datasets.PackedStore`. Those whose scene has no other
        noisy frame of their ISO and ratio are left out.

    Raises
    ------
    ArgumentError
        If the source decodes whole files, or no scene has two such frames.
    """

    def __init__(self, pairs: SourcePairs) -> None:
        if not pairs.reads_parts:
            raise ArgumentError("Noise2Noise reads two noisy frames of a scene at once: pack the dataset, eldata pack")
        super().__init__(pairs)
        groups: dict[object, list[int]] = defaultdict(list)
        for number, record in enumerate(pairs.records):
            like = record.camera, record.reference, record.iso, record.ratio
            groups[like].append(number)
        self._groups = [group for group in groups.values() if len(group) > 1]
        self._count = sum(map(len, self._groups))
        self._members = [
            (group, place, step)
            for group in self._groups
            for place in range(len(group))
            for step in range(len(pairs._indices_of(group[place])))
        ]
        if not self._members:
            raise ArgumentError(
                "Noise2Noise needs two noisy frames of a scene at one ISO and ratio; of "
                f"{len(pairs.records)} pairs none has another one"
            )

    def __len__(self) -> int:
        return len(self._members) * self.pairs.crops_per_frame

    def item(self, index: int) -> PairItem:
        """Draw an item from (seed, epoch, index): a crop of a pair, and another pair of its scene."""
        index = checked_index(index, len(self))
        group, place, step = self._members[index % len(self._members)]
        generator = item_generator(self.pairs.seed, self.pairs.epoch, index)
        other_place = (place + 1 + int(generator.integers(len(group) - 1))) % len(group)
        item = self.pairs.drawn(self.pairs._indices_of(group[place])[step], generator)
        other = self.pairs.drawn(self.pairs._indices_of(group[other_place])[step], generator)
        both = zip(SIDES, (item, other), strict=True)
        item.parts = [part._replace(tensor=side) for side, one in both for part in one.parts if part.tensor == "input"]
        return item

    def _outline(self) -> list[tuple[str, str]]:
        """Return what the dataset is: two noisy frames of each of these pairs."""
        return [("noisy frames", str(self._count)), *self.pairs._outline()]

    def __repr__(self) -> str:
        return f"Noise2Noise({self._count} noisy frames of {len(self._groups)} exposures; {self.pairs!r})"
