"""Pairs and scores for training code on BasicSR, such as LED's: two datasets and two metrics for its registries.

BasicSR, and each repository that began as a copy of it, finds datasets and metrics by the ``type`` of a yaml file in
registries of its own package. :func:`register` puts those of this module there. Nothing here imports that package.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import numpy as np
import torch
from torch.utils.data import Dataset

from eldata.base.numbers import checked_index
from eldata.base.seeds import item_generator
from eldata.datasets.base import PairDataset, SourcePairs
from eldata.datasets.crops import Crop
from eldata.datasets.packed import PackedStore
from eldata.datasets.published import dataset_class, dataset_names, open_dataset
from eldata.errors import ArgumentError, EldataError, check_choice, did_you_mean
from eldata.integrations.protocol_scores import protocol_of_tensors, protocol_score
from eldata.manifest.pairs import Choice
from eldata.raw.colour import camera_to_srgb
from eldata.raw.levels import FrameLevels, pack, packed_black_level_dn

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from eldata.records import Sensor
    from eldata.sources.frames import Frame

__all__ = ["EldataPairs", "EldataReferences", "MissingBasicSRError", "eldata_psnr", "eldata_psnr_pt"]
__all__ += ["eldata_ssim", "eldata_ssim_pt", "register"]

# Keys of the yaml that say what a sample is, with their defaults: as in LED's yaml.
_DEFAULTS: dict[str, Any] = dict.fromkeys(("dataroot", "data_pair_list", "crop_size", "amplification")) | {
    **dict.fromkeys(("use_hflip", "use_rot"), False),
    "phase": "train",
    "zero_clip": True,
    "which_meta": "gt",
    "levels": "metadata-per-channel",
}
# Keys that BasicSR's own code reads, or that say how LED keeps its files, which a manifest or store does.
_READ_ELSEWHERE = (
    *("name", "type", "scale", "num_worker_per_gpu", "batch_size_per_gpu", "dataset_enlarge_ratio", "pin_memory"),
    *("persistent_workers", "prefetch_mode", "num_prefetch_queue", "use_shuffle", "postfix", "load_in_mem"),
)


class MissingBasicSRError(EldataError, ImportError):
    """The package whose registries are wanted is not installed, or has none."""


class EldataPairs(Dataset[dict[str, Any]]):
    """Pairs of a manifest or a store, as LED's ``PairedRAWDataset`` gives its own: the ``type`` of a yaml's dataset.

    A sample's ``lq`` and ``gt`` are (C, h, w) float32, ``lq`` multiplied by ``ratio``; ``wb`` are the multipliers of R,
    G1, B, G2 with G1 = 1, ``ccm`` the matrix (3, 3) from white-balanced camera colours to linear sRGB, nan where the
    file states none; ``lq_path`` and ``gt_path`` are the manifest's.

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

    def __init__(self, opt: Mapping[str, Any]) -> None:
        known = (*_DEFAULTS, *Choice.__annotations__)
        unknown = [name for name in opt if name not in (*known, *_READ_ELSEWHERE)]
        if unknown:
            hint = did_you_mean(unknown[0], known)
            raise ArgumentError(f"{unknown[0]}: EldataPairs has no such key; known are {', '.join(known)}{hint}")
        self.opt = _DEFAULTS | dict(opt)
        check_choice("phase", self.opt["phase"], ("train", "val", "test"))
        check_choice("which_meta", self.opt["which_meta"], ("gt", "lq"))
        check_choice("levels", self.opt["levels"], (*get_args(FrameLevels), "metadata-per-channel"))
        if self.opt["use_hflip"] != self.opt["use_rot"]:
            raise ArgumentError("use_hflip and use_rot must be the same: eldata draws all eight orientations, or none")
        self.is_training = self.opt["phase"] == "train"
        self.pairs = _open_pairs(self.opt, in_training=self.is_training)

    def __len__(self) -> int:
        return len(self.pairs)

    def __getitem__(self, index: int) -> dict[str, Any]:
        """Read an item: in training of a place that torch's random numbers draw, else the whole frame or its middle."""
        index = checked_index(index, len(self))
        draw = int(torch.randint(2**31, ())) if self.is_training else 0
        return self._read_sample(index, item_generator(0, draw, index))

    def _read_sample(self, index: int, generator: np.random.Generator) -> dict[str, Any]:
        """Return a sample, in LED's order of steps, each in float32."""
        item = self.pairs.draw_item(index, generator)
        sample: dict[str, Any] = {}
        facts: dict[str, Any] = {}
        for part in item.parts:
            name = "gt" if part.is_light else "lq"
            facts |= part.facts
            values, black, white = self._read_dn(part.frame, self._cut(part.frame, item.crop))
            values -= black
            values /= white - black
            if name == "lq":
                values *= np.float32(part.gain)
            np.clip(values, 0 if name == "gt" or self.opt["zero_clip"] else None, 1, out=values)
            sample[name] = torch.from_numpy(values)
            if name == self.opt["which_meta"]:
                sample |= _colours(part.frame.sensor)
        ratio = torch.tensor(facts["ratio"], dtype=torch.float32)
        return sample | {"ratio": ratio, "lq_path": facts["path"], "gt_path": facts["reference"]}

    def _cut(self, frame: Frame, drawn: Crop) -> Crop:
        """Return the part of a frame: in training as it was drawn, else its middle."""
        size = self.opt["crop_size"]
        if self.is_training or size is None:
            return drawn
        _, height, width = drawn.packed_shape
        return Crop.region(frame, ((height - size) // 2, (width - size) // 2, size, size))

    def _read_dn(self, frame: Frame, crop: Crop) -> tuple[NDArray[np.float32], ...]:
        """Return a part of a frame in DN, (C, h, w), and black and white level of each packed channel, (C, 1, 1)."""
        if not crop.cfa or frame.sensor is None:
            raise ArgumentError(f"{frame.name}: is not a raw frame in DN, which LED's arithmetic begins with")
        whites = (frame.white_level_dn,) * len(frame.black_level_dn)
        if self.opt["levels"] == "metadata-per-channel":  # LED's, each file by its own
            own = (frame.sensor.white_level_dn,) * len(whites)
            whites = frame.channel_white_levels_dn or own
        levels = (packed_black_level_dn(crop.cfa, crop.levels(own)) for own in (frame.black_level_dn, whites))
        black, white = (level[:, None, None] for level in levels)
        return pack(crop.cut(frame), crop.cfa).astype(np.float32), black, white


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
        own = dict(opt)
        stated = own.pop("ratio_range", None) or (100, 300)
        super().__init__(own)
        if len(stated) != 2 or not all(isinstance(ratio, int) for ratio in stated) or not 0 < stated[0] <= stated[1]:
            raise ArgumentError(f"ratio_range: expected two whole numbers such as [100, 300], found {stated}")
        self._ratios: tuple[int, int] = tuple(stated)
        self._references = list(dict.fromkeys(record.reference for record in self.pairs.records))

    def __len__(self) -> int:
        return len(self._references)

    def _read_sample(self, index: int, generator: np.random.Generator) -> dict[str, Any]:
        """Read a clean image in DN as LED's sample, with its levels, colours and a random ratio."""
        path = self._references[index]
        frame = self.pairs.source.frame(path).with_levels(self.pairs.levels)
        crop = self._cut(frame, Crop.draw(frame, generator, crop=self.pairs.crop, augment=False))
        image, black, white = map(torch.from_numpy, self._read_dn(frame, crop))
        sample = {"gt": image, "lq": image.clone(), "black_level": black, "white_level": white}  # lq gets LED's noise
        ratio = int(torch.randint(self._ratios[0], self._ratios[1] + 1, ()))
        return sample | _colours(frame.sensor) | {"ratio": ratio, "lq_path": path, "gt_path": path}


def _colours(sensor: Sensor | None) -> dict[str, torch.Tensor]:
    """Return white balance (4,) and matrix (3, 3) as LED keeps them; nan where the file states none."""
    balance, matrix = (None, None) if sensor is None else (sensor.white_balance, sensor.xyz_to_camera)
    wb = np.full(4, np.nan) if balance is None else np.array(balance, np.float64)
    ccm = np.full((3, 3), np.nan) if matrix is None else camera_to_srgb(matrix)
    return {"wb": torch.from_numpy(wb).float(), "ccm": torch.from_numpy(ccm).float()}


def _open_pairs(opt: Mapping[str, Any], *, in_training: bool) -> SourcePairs:
    """Return the pairs. A set of this package's own has the amplification that its papers have."""
    options = {name: opt[name] for name in ("amplification", *Choice.__annotations__) if opt.get(name) is not None}
    options["levels"] = "metadata" if opt["levels"] == "metadata-per-channel" else opt["levels"]
    options |= {"crop": opt["crop_size"] if in_training else None, "augment": in_training and opt["use_rot"]}
    pair_list, root = str(opt["data_pair_list"] or ""), opt["dataroot"]
    if not pair_list:
        raise ArgumentError("data_pair_list: expected a set's name, a manifest's CSV file, or a store; found nothing")
    if Path(pair_list).suffix in (".h5", ".hdf5"):
        if root:
            raise ArgumentError(f"dataroot: {pair_list} is a store, which needs no other files; leave it out")
        return PackedStore(pair_list, **options)
    if pair_list not in dataset_names():
        return PairDataset(root, pair_list, **options)
    if not issubclass(dataset_class(pair_list), SourcePairs):
        raise ArgumentError(f"data_pair_list: {pair_list} is a set of clips, and LED's code reads pairs")
    pairs: SourcePairs = open_dataset(pair_list, root, **options)
    return pairs


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
    return _score_batch(img, img2, protocol, "psnr_db")


def eldata_ssim(img: torch.Tensor, img2: torch.Tensor, *, protocol: str = "eld", **_: Any) -> torch.Tensor:
    """Return each image's SSIM under a protocol; all else is as for :func:`eldata_psnr`."""
    return _score_batch(img, img2, protocol, "ssim")


def eldata_psnr_pt(img: torch.Tensor, img2: torch.Tensor, *, protocol: str = "eld", **_: Any) -> torch.Tensor:
    """Return the same as :func:`eldata_psnr`: LED adds ``_pt`` to the names of metrics that it gives tensors."""
    return _score_batch(img, img2, protocol, "psnr_db")


def eldata_ssim_pt(img: torch.Tensor, img2: torch.Tensor, *, protocol: str = "eld", **_: Any) -> torch.Tensor:
    """Return the same as :func:`eldata_ssim`: LED adds ``_pt`` to the names of metrics that it gives tensors."""
    return _score_batch(img, img2, protocol, "ssim")


def _score_batch(img: torch.Tensor, img2: torch.Tensor, protocol: str, column: str) -> torch.Tensor:
    """Score batches (B, C, h, w) image by image under a protocol; ``column`` names the metric."""
    images: tuple[Any, ...] = (img, img2)  # whatever the training code hands over
    if not all(isinstance(image, torch.Tensor) and image.ndim == 4 for image in images):
        raise ArgumentError(
            f"expected batches of tensors (B, C, h, w), found {type(img).__name__} {tuple(img.shape)}; set "
            "calculate_metric_in_batch: true in the yaml's val section, so that images are not rounded to 8 bits"
        )
    chosen = protocol_of_tensors(protocol)
    each = [getattr(protocol_score(chosen, *pair), column) for pair in zip(img, img2, strict=True)]
    return torch.tensor(each, dtype=torch.float64)


def register(package: str = "basicsr") -> None:
    """Put the datasets and the metrics into the registries of BasicSR, or of a copy such as ``led``.

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
        entries: dict[Any, tuple[Any, ...]] = {
            registries.DATASET_REGISTRY: (EldataPairs, EldataReferences),
            registries.METRIC_REGISTRY: (eldata_psnr, eldata_ssim, eldata_psnr_pt, eldata_ssim_pt),
        }
    except (ImportError, AttributeError) as error:
        raise MissingBasicSRError(f"{place} cannot be imported ({error}); is {package} installed?") from error
    for registry, entry in ((registry, entry) for registry, own in entries.items() for entry in own):
        if entry.__name__ not in registry:
            registry.register(entry)
        elif registry.get(entry.__name__) is not entry:
            raise ArgumentError(f"{place}: something else is registered as {entry.__name__}; register eldata first")
