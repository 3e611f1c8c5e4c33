"""Synthetic pairs: clean crops with noise made on the fly."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import torch
from torch.utils.data import Dataset

from eldata.datasets.batches import Batch, Field, new_batch, threads_here
from eldata.datasets.draws import CleanCrop, NoiseChoice, NoiseFacts, SharedEpoch
from eldata.errors import ArgumentError
from eldata.noise.model import NoiseModel

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from eldata.datasets.clean import CleanFrame, CleanSource
    from eldata.datasets.draws import NoiseDraw
    from eldata.noise.profile import CameraProfile, RowChoice


class SyntheticSample(NoiseFacts):
    """One synthetic pair, as torch's default collate accepts it.

    ``input`` and ``target`` are (C, h, w) float32, normalised; the input is amplified by ``ratio``. ``path`` says where
    the clean frame comes from. The rest are the parameters that its noise was made with.
    """

    input: torch.Tensor
    target: torch.Tensor
    path: str


class _Item(NamedTuple):
    """One item before its pixels are read, and the generator that its noise comes from."""

    frame: CleanFrame
    crop: CleanCrop
    draw: NoiseDraw
    generator: np.random.Generator


class SyntheticPairs(Dataset[SyntheticSample]):
    """Clean crops and noisy exposures of them, made anew in each epoch.

    Item i of epoch e depends on (seed, e, i) alone: not on workers, their number, or what was read before. Call
    :meth:`set_epoch` before each epoch; it reaches workers that are running already.

    Parameters
    ----------
    source
        Clean frames: :class:`~eldata.datasets.clean.RawFiles`, :class:`~eldata.datasets.clean.Arrays`, or anything with
        their two methods.
    profiles
        One camera profile or several (one is drawn for each item), by name, path or object.
    model
        The noise model; by default the full one, clipped to [0, 1] as the published loaders' input is.
    ratio
        Low-light factors: (lowest, highest), drawn uniformly; the paper's by default. Or one fixed number.
    crop
        Side of the square crop in packed pixels, even for X-Trans; ``None`` takes whole frames.
    augment
        Draw one of the eight orientations of the mosaic; the CFA stays in order.
    crops_per_frame
        Items per clean frame: the length is this times the number of frames.
    seed
        First part of each item's seed.
    iso, row
        As in :meth:`eldata.noise.CameraProfile.sample`.

    Raises
    ------
    ArgumentError
        If a value is out of its range.
    """

    def __init__(
        self,
        source: CleanSource,
        profiles: CameraProfile | str | Sequence[CameraProfile | str],
        *,
        model: NoiseModel | None = None,
        ratio: float | tuple[float, float] = (100.0, 300.0),
        crop: int | None = 512,
        augment: bool = True,
        crops_per_frame: int = 1,
        seed: int = 0,
        iso: float | None = None,
        row: RowChoice = "any",
    ) -> None:
        if seed < 0:
            raise ArgumentError(f"seed must be 0 or more; found {seed}")
        if crops_per_frame < 1 or (crop is not None and crop < 2):
            raise ArgumentError(
                f"crops_per_frame must be 1 or more and crop 2 or more; found {crops_per_frame}, {crop}"
            )
        self.source = source
        self.noise = NoiseChoice.of(profiles, ratio, iso, row)
        self.model = NoiseModel(clip="both") if model is None else model
        self.crop = crop
        self.augment = augment
        self.crops_per_frame = crops_per_frame
        self.seed = seed
        self._epoch = SharedEpoch()

    @property
    def epoch(self) -> int:
        """The current epoch."""
        return self._epoch.value

    def set_epoch(self, epoch: int) -> None:
        """Choose the epoch whose items are drawn from now on, in running workers too."""
        self._epoch.set(epoch)

    def __len__(self) -> int:
        return len(self.source) * self.crops_per_frame

    def __iter__(self) -> Iterator[SyntheticSample]:
        return (self[index] for index in range(len(self)))

    def __getitem__(self, index: int) -> SyntheticSample:
        """Make one pair.

        Raises
        ------
        IndexError
            If the index is outside.
        DatasetError
            If a frame is smaller than the crop (with ``augment`` one period of the CFA more is needed).
        """
        item = self._item(index)
        return self._made(item, item.crop.packed(item.frame))

    def __getitems__(self, indices: Sequence[int]) -> list[Any]:
        """Make the pairs of a batch in memory that is used again (:mod:`eldata.datasets.batches`).

        torch's DataLoader calls this. The values are those of ``dataset[i]``; errors too.
        """
        if self.crop is None:  # whole frames may differ in size
            return [self[index] for index in indices]
        batch: Batch | None = None
        samples = []
        for number, index in enumerate(indices):  # one whole frame in memory at a time
            item = self._item(index)
            shape = len(indices), *item.crop.packed_shape
            if number == 0:
                batch = new_batch([Field(name, shape, "<f4") for name in ("input", "target")])
            if batch is None or batch.fields[0].shape != shape:  # no such memory; or Bayer and X-Trans
                return [self[index] for index in indices]
            target = item.crop.packed(item.frame, out=batch.arrays["target"][number])
            sample = self._made(item, target)
            batch.arrays["input"][number] = sample["input"].numpy()
            samples.append({**sample, "input": None, "target": None})
            del item, sample
        return [] if batch is None else batch.parts(samples)

    def _item(self, index: int) -> _Item:
        if not -len(self) <= index < len(self):
            raise IndexError(f"index {index} is outside of {len(self)} items")
        index %= len(self)
        generator = np.random.default_rng([self.seed, self.epoch, index])
        frame = self.source.frame(index % len(self.source))
        crop = CleanCrop.draw(frame, generator, crop=self.crop, augment=self.augment)
        return _Item(frame, crop, self.noise.draw(generator), generator)

    def _made(self, item: _Item, target: NDArray[np.float32]) -> SyntheticSample:
        noisy = self.model(
            target,
            parameters=item.draw.parameters,
            ratio=item.draw.ratio,
            range_dn=item.frame.range_dn,
            generator=item.generator,
            threads=threads_here(),
        )
        return SyntheticSample(
            **item.draw.facts(), input=torch.from_numpy(noisy), target=torch.from_numpy(target), path=item.frame.name
        )

    def __repr__(self) -> str:
        cameras = ", ".join(profile.camera for profile in self.noise.profiles)
        return (
            f"SyntheticPairs({self.source!r}, {len(self)} items, cameras: {cameras}; {self.model!r}, "
            f"ratio={self.noise.ratio}, crop={self.crop}, augment={self.augment}, seed={self.seed})"
        )
