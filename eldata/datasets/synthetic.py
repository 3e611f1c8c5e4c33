"""Synthetic pairs: clean crops with noise made on the fly."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch
from torch.utils.data import Dataset, get_worker_info

from eldata.datasets.draws import CleanCrop, NoiseChoice, NoiseFacts, SharedEpoch
from eldata.errors import ArgumentError
from eldata.noise.model import NoiseModel

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from eldata.datasets.clean import CleanSource
    from eldata.noise.profile import CameraProfile, RowChoice


class SyntheticSample(NoiseFacts):
    """One synthetic pair, as torch's default collate accepts it.

    ``input`` and ``target`` are (C, h, w) float32, normalised; the input is amplified by ``ratio``. ``path`` says where
    the clean frame comes from. The rest are the parameters that its noise was made with.
    """

    input: torch.Tensor
    target: torch.Tensor
    path: str


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
        if not -len(self) <= index < len(self):
            raise IndexError(f"index {index} is outside of {len(self)} items")
        index %= len(self)
        generator = np.random.default_rng([self.seed, self.epoch, index])
        frame = self.source.frame(index % len(self.source))
        target = CleanCrop.draw(frame, generator, crop=self.crop, augment=self.augment).packed(frame)
        draw = self.noise.draw(generator)
        noisy = self.model(
            target,
            parameters=draw.parameters,
            ratio=draw.ratio,
            range_dn=frame.range_dn,
            generator=generator,
            threads=None if get_worker_info() is None else 1,  # the workers share the CPUs already
        )
        return SyntheticSample(
            **draw.facts(), input=torch.from_numpy(noisy), target=torch.from_numpy(target), path=frame.name
        )

    def __repr__(self) -> str:
        cameras = ", ".join(profile.camera for profile in self.noise.profiles)
        return (
            f"SyntheticPairs({self.source!r}, {len(self)} items, cameras: {cameras}; {self.model!r}, "
            f"ratio={self.noise.ratio}, crop={self.crop}, augment={self.augment}, seed={self.seed})"
        )
