"""Pairs and scores for training code on BasicSR, such as LED's: a dataset and two metrics for its registries.

BasicSR, and each repository that began as a copy of it, finds datasets and metrics by the ``type`` of a yaml file in
registries of its own package. :func:`register` puts those of this module there. Nothing here imports that package.
"""

from __future__ import annotations

from importlib import import_module
from operator import index as index_of
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypedDict, get_args

import numpy as np
import torch
from torch.utils.data import Dataset

from eldata.base.seeds import item_generator
from eldata.datasets.base import PairDataset, SourcePairs
from eldata.datasets.crops import Crop
from eldata.datasets.items import checked_index
from eldata.datasets.packed import PackedStore
from eldata.datasets.registry import dataset_class, dataset_names, open_dataset
from eldata.errors import ArgumentError, EldataError, check_choice, did_you_mean
from eldata.integrations.exports.frames import balance_multipliers, matrix_to_srgb
from eldata.integrations.protocol_scores import protocol_of_tensors, protocol_score
from eldata.manifest.pairs import Choice
from eldata.raw.cfa import pack
from eldata.raw.levels import FrameLevels, packed_black_level_dn

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from eldata.protocols.protocol import Amplification
    from eldata.records import Sensor
    from eldata.sources.frames import Frame

__all__ = [
    "BatchSample",
    "EldataPairs",
    "EldataReferences",
    "MissingBasicSRError",
    "eldata_psnr",
    "eldata_psnr_pt",
    "eldata_ssim",
    "eldata_ssim_pt",
    "register",
]

LedLevels = Literal[FrameLevels, "metadata-per-channel"]
Meta = Literal["gt", "lq"]
Phase = Literal["train", "val", "test"]

_DRAWS = 2**31  # what torch.randint draws an epoch from
_STORES = (".h5", ".hdf5")


class MissingBasicSRError(EldataError, ImportError):
    """The package whose registries are wanted is not installed, or has none."""


class BatchSample(TypedDict):
    """One pair as LED's own dataset of pairs gives it.

    ``lq`` and ``gt`` are (C, h, w) float32, ``lq`` multiplied by ``ratio``. ``wb`` are the multipliers of R, G1, B, G2
    with G1 = 1, ``ccm`` the matrix (3, 3) from white-balanced camera colours to linear sRGB; nan where the file states
    none.
    """

    lq: torch.Tensor
    gt: torch.Tensor
    ratio: torch.Tensor
    wb: torch.Tensor
    ccm: torch.Tensor
    lq_path: str
    gt_path: str


class _Own(TypedDict, total=False):
    """Keys of the yaml that say what a sample is."""

    dataroot: str | None
    data_pair_list: str
    phase: Phase
    crop_size: int | None
    use_hflip: bool
    use_rot: bool
    zero_clip: bool
    which_meta: Meta
    levels: LedLevels
    amplification: Amplification
    ratio_range: Sequence[int]


# Keys of the yaml that BasicSR's own code reads, or that say how LED keeps its files, which a manifest or store does.
_READ_ELSEWHERE = frozenset(
    (
        *("name", "type", "scale", "num_worker_per_gpu", "batch_size_per_gpu", "dataset_enlarge_ratio", "pin_memory"),
        *("persistent_workers", "prefetch_mode", "num_prefetch_queue", "use_shuffle", "postfix", "load_in_mem"),
    )
)
# Keys of LED's loaders that change samples, and that this one does not do.
_REFUSED = {
    "use_patches": "frames are cut as they are read; leave it out, and choose crop_size",
    "ratio_aug": "samples have the ratio of their files; synthetic noise at any ratio: eldata.SyntheticPairs",
}


class EldataPairs(Dataset[BatchSample]):
    """Pairs of a manifest or a store, as LED's ``PairedRAWDataset`` gives its own: the ``type`` of a yaml's dataset.

    Parameters
    ----------
    opt
        The dataset's part of the yaml. ``data_pair_list``: a set's name (``sid-sony``), a manifest's CSV file, or a
        store (``.h5``). ``dataroot``: the set's own folder; not for a store. Which pairs:
        :class:`~eldata.manifest.pairs.Choice`. ``phase``, which BasicSR sets: with ``train``, ``crop_size`` (side in
        packed pixels) is cut at a random place, else from the middle; ``~`` takes whole frames. ``use_hflip`` and
        ``use_rot``, both or neither: one of eight orientations. ``zero_clip`` (true): clip the input at 0 too.
        ``which_meta``: ``gt`` or ``lq``, whose ``wb`` and ``ccm``. ``levels``: ``metadata-per-channel``, as LED has
        them, LibRaw's white level per channel, and where it has none the file's; or as every dataset has them.
        ``amplification``: as every dataset has it.

    Raises
    ------
    ArgumentError
        If a key is unknown (the message has the nearest one), or asks for what this dataset does not do.
    EldataError
        As :class:`~eldata.datasets.base.PairDataset` and :class:`~eldata.datasets.packed.PackedStore` do.

    Notes
    -----
    Values are those of LED's arithmetic, to the bit: packed, less black, over white less black, times the ratio, and
    clipped at 1 at the end alone. Places and orientations of training crops are drawn from torch's random numbers, as
    LED draws them, so that its seed decides them and no epoch needs to be set; turning keeps the CFA in order, where
    LED's turns packed arrays.
    """

    opt: dict[str, Any]

    def __init__(self, opt: Mapping[str, Any]) -> None:
        self.opt = dict(opt)
        own, choice = _understood(self.opt)
        self._set_ratios(own.get("ratio_range"))
        self.phase: Phase = own.get("phase", "train")
        self.which_meta: Meta = own.get("which_meta", "gt")
        check_choice("phase", self.phase, get_args(Phase))
        check_choice("which_meta", self.which_meta, get_args(Meta))
        if own.get("use_hflip", False) != own.get("use_rot", False):
            raise ArgumentError(
                "use_hflip and use_rot must be the same: eldata draws one of all eight orientations, or none"
            )
        self.crop_size = own.get("crop_size")
        self.zero_clip = own.get("zero_clip", True)
        self.levels: LedLevels = own.get("levels", "metadata-per-channel")
        check_choice("levels", self.levels, get_args(LedLevels))
        self.pairs = _opened(own, choice, in_training=self.phase == "train")

    def _set_ratios(self, ratio_range: Sequence[int] | None) -> None:
        if ratio_range is not None:
            raise ArgumentError("ratio_range: pairs have the ratio of their files; EldataReferences draws ratios")

    def __len__(self) -> int:
        return len(self.pairs)

    def __iter__(self) -> Iterator[BatchSample]:
        return (self[index] for index in range(len(self)))

    def __getitem__(self, index: int) -> BatchSample:
        """Read an item: in training of a place that torch's random numbers draw, else the whole frame or its middle."""
        index = checked_index(index, len(self))
        draw = int(torch.randint(_DRAWS, ())) if self.phase == "train" else 0
        sample: BatchSample = self._sample(index, item_generator(0, draw, index))
        return sample

    def _sample(self, index: int, generator: np.random.Generator) -> Any:
        """Return a sample, in LED's order of steps, each in float32."""
        item = self.pairs.drawn(index, generator)
        pair = item.pair
        crop = self._cut(pair.target, item.crop)
        images: dict[str, torch.Tensor] = {}
        sensors: dict[str, Sensor | None] = {}
        for part in item.parts:
            name = "gt" if part.is_light else "lq"
            values, black, white = self._dn(part.frame, crop)
            values -= black
            values /= white - black
            if name == "lq":
                values *= np.float32(part.gain)
            np.clip(values, 0 if name == "gt" or self.zero_clip else None, 1, out=values)
            images[name], sensors[name] = torch.from_numpy(values), part.frame.sensor
        ratio = torch.tensor(float(pair.ratio), dtype=torch.float32)
        colours = _colours(sensors[self.which_meta])
        return images | {"ratio": ratio, **colours, "lq_path": pair.record.path, "gt_path": pair.record.reference}

    def _cut(self, target: Frame, drawn: Crop) -> Crop:
        """Return the part of a frame: in training as it was drawn, else its middle."""
        if self.phase == "train" or self.crop_size is None:
            return drawn
        _, height, width = drawn.packed_shape
        place = (height - self.crop_size) // 2, (width - self.crop_size) // 2
        return Crop.region(target, (*place, self.crop_size, self.crop_size))

    def _dn(self, frame: Frame, crop: Crop) -> tuple[NDArray[np.float32], ...]:
        """Return a part of a frame in DN, (C, h, w), and black and white level of each packed channel, (C, 1, 1)."""
        if not crop.cfa or frame.sensor is None:
            raise ArgumentError(f"{frame.name}: is not a raw frame in DN, which LED's arithmetic begins with")
        levels = crop.levels(frame.black_level_dn), crop.levels(_whites_dn(frame, self.levels))
        blacks, whites = (packed_black_level_dn(crop.cfa, one)[:, None, None] for one in levels)
        return pack(crop.cut(frame), crop.cfa).astype(np.float32), blacks, whites

    def __repr__(self) -> str:
        name = type(self).__name__
        return f"{name}({self.pairs!r}, phase={self.phase!r}, crop_size={self.crop_size}, levels={self.levels!r})"


class EldataReferences(EldataPairs):
    """Clean references in DN, as LED's ``RAWGTDataset`` gives its files: for the noise that LED's model makes.

    Each reference of the chosen pairs is an item, once. ``lq`` and ``gt`` are the same, (C, h, w) float32 in DN,
    ``black_level`` and ``white_level`` (C, 1, 1), ``ratio`` is a whole number drawn from torch's random numbers.
    Nothing is turned, as LED turns nothing here: its model does.

    Parameters
    ----------
    opt
        As for :class:`EldataPairs`, and ``ratio_range``: the smallest and the largest ratio, [100, 300].

    Raises
    ------
    ArgumentError, EldataError
        As :class:`EldataPairs` does.
    """

    def __init__(self, opt: Mapping[str, Any]) -> None:
        super().__init__(opt)
        self._references = tuple({record.reference: record for record in self.pairs.records}.values())

    def _set_ratios(self, ratio_range: Sequence[int] | None) -> None:
        try:
            self.lowest, self.largest = map(index_of, (100, 300) if ratio_range is None else ratio_range)
        except (TypeError, ValueError):
            self.lowest = self.largest = 0
        if not 0 < self.lowest <= self.largest:
            raise ArgumentError(f"ratio_range: expected two whole numbers such as [100, 300], found {ratio_range}")

    def __len__(self) -> int:
        return len(self._references)

    def _sample(self, index: int, generator: np.random.Generator) -> Any:
        record = self._references[index]
        frame = self.pairs.source.frame(record.reference).with_levels(self.pairs.levels)
        crop = self._cut(frame, Crop.draw(frame, generator, crop=self.pairs.crop, augment=False))
        image, black, white = map(torch.from_numpy, self._dn(frame, crop))
        return {
            "gt": image,
            "lq": image.clone(),  # LED's model makes its noisy input of it
            **_colours(frame.sensor),
            "ratio": int(torch.randint(self.lowest, self.largest + 1, ())),
            "lq_path": record.reference,
            "gt_path": record.reference,
            "black_level": black,
            "white_level": white,
        }


def _colours(sensor: Sensor | None) -> dict[str, torch.Tensor]:
    """Return white balance and matrix."""
    return {"wb": torch.from_numpy(balance_multipliers(sensor)), "ccm": torch.from_numpy(matrix_to_srgb(sensor))}


def _understood(opt: Mapping[str, Any]) -> tuple[_Own, Choice]:
    """Return what a dataset's part of a yaml says of samples, and of which pairs."""
    known = (*_Own.__annotations__, *Choice.__annotations__)
    for name, value in opt.items():
        if value and name in _REFUSED:
            raise ArgumentError(f"{name}: EldataPairs does not do this; {_REFUSED[name]}")
        if name not in (*known, *_REFUSED, *_READ_ELSEWHERE):
            raise ArgumentError(
                f"{name}: EldataPairs has no such key; known are {', '.join(known)}{did_you_mean(name, known)}"
            )
    if not opt.get("data_pair_list"):
        raise ArgumentError(
            "data_pair_list: expected a set's name, a manifest's CSV file, or a store that eldata pack made; found "
            "nothing"
        )
    own: Any = {name: opt[name] for name in _Own.__annotations__ if name in opt}
    choice: Any = {name: opt[name] for name in Choice.__annotations__ if opt.get(name) is not None}
    return own, choice


def _opened(own: _Own, choice: Choice, *, in_training: bool) -> SourcePairs:
    """Return the pairs. A set of this package's own has the amplification that its papers have."""
    levels = own.get("levels", "metadata-per-channel")
    options: dict[str, Any] = {
        **choice,
        "levels": "metadata" if levels == "metadata-per-channel" else levels,
        "crop": own.get("crop_size") if in_training else None,
        "augment": in_training and own.get("use_rot", False),
    }
    if "amplification" in own:
        options["amplification"] = own["amplification"]
    pair_list, root = str(own["data_pair_list"]), own.get("dataroot")
    if Path(pair_list).suffix in _STORES:
        if root:
            raise ArgumentError(f"dataroot: {pair_list} is a store, which needs no other files; leave it out")
        return PackedStore(pair_list, **options)
    if pair_list not in dataset_names():
        return PairDataset(root, pair_list, **options)
    if not issubclass(dataset_class(pair_list), SourcePairs):
        raise ArgumentError(f"data_pair_list: {pair_list} is a set of clips, and LED's code reads pairs")
    opened: SourcePairs = open_dataset(pair_list, root, **options)
    return opened


def _whites_dn(frame: Frame, levels: LedLevels) -> tuple[float, ...]:
    whites = frame.channel_white_levels_dn if levels == "metadata-per-channel" else None
    return (frame.white_level_dn,) * len(frame.black_level_dn) if whites is None else whites


# --- metrics ----------------------------------------------------------------------------------------------------------


def eldata_psnr(img: torch.Tensor, img2: torch.Tensor, *, protocol: str = "eld", **_: Any) -> torch.Tensor:
    """Return each image's PSNR in dB under a protocol: a metric's ``type``, with ``protocol`` as its other key.

    Parameters
    ----------
    img, img2
        Predictions and references, (B, C, h, w) whole frames, normalised as the protocol says.
    protocol
        A name such as ``led-sid``, or the path of a TOML file.

    Returns
    -------
    torch.Tensor
        (B,) float64, as ``eldata evaluate`` has each to the last bit; the training code takes the mean.

    Raises
    ------
    ArgumentError
        If the images are no batches of tensors: the yaml needs ``calculate_metric_in_batch: true``, or BasicSR rounds
        them to 8 bits first. If the protocol is not one of raw images.
    """
    return _scores(img, img2, protocol, "psnr_db")


def eldata_ssim(img: torch.Tensor, img2: torch.Tensor, *, protocol: str = "eld", **_: Any) -> torch.Tensor:
    """Return each image's SSIM under a protocol; all else is as for :func:`eldata_psnr`."""
    return _scores(img, img2, protocol, "ssim")


def eldata_psnr_pt(img: torch.Tensor, img2: torch.Tensor, *, protocol: str = "eld", **_: Any) -> torch.Tensor:
    """Return what :func:`eldata_psnr` does: LED adds ``_pt`` to the names of metrics that it gives tensors."""
    return _scores(img, img2, protocol, "psnr_db")


def eldata_ssim_pt(img: torch.Tensor, img2: torch.Tensor, *, protocol: str = "eld", **_: Any) -> torch.Tensor:
    """Return what :func:`eldata_ssim` does: LED adds ``_pt`` to the names of metrics that it gives tensors."""
    return _scores(img, img2, protocol, "ssim")


def _scores(img: torch.Tensor, img2: torch.Tensor, protocol: str, column: str) -> torch.Tensor:
    given: tuple[Any, ...] = (img, img2)  # whatever the training code hands over
    for image in given:
        if not isinstance(image, torch.Tensor) or image.ndim != 4:
            raise ArgumentError(
                f"expected batches of tensors (B, C, h, w), found {type(image).__name__} {tuple(image.shape)}; set "
                "calculate_metric_in_batch: true in the yaml's val section, so that images are not rounded to 8 bits"
            )
    chosen = protocol_of_tensors(protocol)
    each = [getattr(protocol_score(chosen, *one), column) for one in zip(img, img2, strict=True)]
    return torch.tensor(each, dtype=torch.float64)


def register(package: str = "basicsr") -> None:
    """Put the dataset and the metrics into a package's registries: BasicSR's, or those of a copy such as ``led``.

    Call it before the training code builds its datasets. What is there already is left.

    Raises
    ------
    MissingBasicSRError
        If the package, or its ``utils.registry``, cannot be imported; the message has the reason.
    ArgumentError
        If a registry has something else of that name.
    """
    place = f"{package}.utils.registry"
    try:
        registries = import_module(place)
        found: dict[Any, tuple[Any, ...]] = {
            registries.DATASET_REGISTRY: (EldataPairs, EldataReferences),
            registries.METRIC_REGISTRY: (eldata_psnr, eldata_psnr_pt, eldata_ssim, eldata_ssim_pt),
        }
    except (ImportError, AttributeError) as error:
        raise MissingBasicSRError(
            f"{place} cannot be imported ({error}); run this where {package} is installed, or in its repository's "
            "folder, or name the package that has the registries"
        ) from error
    for registry, entries in found.items():
        for entry in entries:
            if entry.__name__ not in registry:
                registry.register(entry)
            elif registry.get(entry.__name__) is not entry:
                raise ArgumentError(f"{place}: something else is registered as {entry.__name__}; register eldata first")
