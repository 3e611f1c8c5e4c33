"""Synthetic pairs: clean crops with noise made on the fly."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, TypedDict

import numpy as np
import torch
from torch.utils.data import Dataset, get_worker_info

from eldata.datasets.augmentation import ORIENTATIONS, Orientation, oriented
from eldata.errors import ArgumentError, DatasetError
from eldata.noise.model import NoiseModel
from eldata.noise.profile import CameraProfile
from eldata.raw.cfa import normalise, pack, pack_normalised, packed_area

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from eldata.datasets.clean import CleanFrame, CleanSource
    from eldata.noise.profile import RowChoice


class SyntheticSample(TypedDict):
    """One synthetic pair, as torch's default collate accepts it.

    ``input`` and ``target`` are (C, h, w) float32, normalised; the input is amplified by ``ratio``. The rest are the
    parameters that its noise was made with (:class:`eldata.noise.NoiseParameters`; ``colour_bias_dn`` is (4,) float64).
    """

    input: torch.Tensor
    target: torch.Tensor
    ratio: float
    camera: str
    path: str
    gain_dn_per_e: float
    tukey_lambda: float
    sigma_tl_dn: float
    sigma_gauss_dn: float
    sigma_row_dn: float
    colour_bias_dn: torch.Tensor


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
        low, high = ratio if isinstance(ratio, tuple) else (ratio, ratio)
        if not 0 < low <= high < math.inf:
            raise ArgumentError(f"ratio must be finite and above 0, the lower first; found {ratio}")
        if seed < 0:
            raise ArgumentError(f"seed must be 0 or more; found {seed}")
        if crops_per_frame < 1 or (crop is not None and crop < 2):
            raise ArgumentError(
                f"crops_per_frame must be 1 or more and crop 2 or more; found {crops_per_frame}, {crop}"
            )
        chosen = [profiles] if isinstance(profiles, (str, CameraProfile)) else list(profiles)
        self.source = source
        self.profiles = tuple(CameraProfile.load(p) if isinstance(p, str) else p for p in chosen)
        if not self.profiles:
            raise ArgumentError("give at least one camera profile")
        self.model = NoiseModel(clip="both") if model is None else model
        self.ratio = (float(low), float(high))
        self.crop = crop
        self.augment = augment
        self.crops_per_frame = crops_per_frame
        self.seed = seed
        self.iso = iso
        self.row: RowChoice = row
        self._epoch = torch.zeros((), dtype=torch.int64)
        self._share_epoch()

    def _share_epoch(self) -> None:
        # Shared memory, so that persistent workers see the next epoch.
        self._epoch.share_memory_()  # type: ignore[no-untyped-call]

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._share_epoch()  # a copy has an epoch of its own, which its workers share again

    @property
    def epoch(self) -> int:
        """The current epoch."""
        return int(self._epoch)

    def set_epoch(self, epoch: int) -> None:
        """Choose the epoch whose items are drawn from now on, in running workers too."""
        if epoch < 0:
            raise ArgumentError(f"epoch must be 0 or more; found {epoch}")
        self._epoch.fill_(epoch)

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
        target = self._clean_crop(frame, generator)
        profile = self.profiles[int(generator.integers(len(self.profiles)))]
        parameters = profile.sample(generator, iso=self.iso, row=self.row)
        ratio = float(generator.uniform(*self.ratio))
        noisy = self.model(
            target,
            parameters=parameters,
            ratio=ratio,
            range_dn=frame.range_dn,
            generator=generator,
            threads=None if get_worker_info() is None else 1,  # the workers share the CPUs already
        )
        return SyntheticSample(
            input=torch.from_numpy(noisy),
            target=torch.from_numpy(target),
            ratio=ratio,
            camera=profile.camera,
            path=frame.name,
            gain_dn_per_e=parameters.gain_dn_per_e,
            tukey_lambda=parameters.tukey_lambda,
            sigma_tl_dn=parameters.sigma_tl_dn,
            sigma_gauss_dn=parameters.sigma_gauss_dn,
            sigma_row_dn=parameters.sigma_row_dn,
            colour_bias_dn=torch.tensor(parameters.colour_bias_dn, dtype=torch.float64),
        )

    def _clean_crop(self, frame: CleanFrame, generator: np.random.Generator) -> NDArray[np.float32]:
        orientation = ORIENTATIONS[int(generator.integers(len(ORIENTATIONS)))] if self.augment else Orientation()
        period = len(frame.cfa)
        area = packed_area((frame.mosaic.shape[0], frame.mosaic.shape[1]), frame.cfa)
        mosaic = frame.mosaic[area.slices]
        # From here on the pattern starts as packing wants it.
        cfa = tuple(
            tuple(frame.cfa[(y + area.top) % period][(x + area.left) % period] for x in range(period))
            for y in range(period)
        )
        margin = period if self.augment else 0
        scale = 2 if period == 2 else 3
        height = area.height - margin if self.crop is None else self.crop * scale
        width = area.width - margin if self.crop is None else self.crop * scale
        if orientation.transpose and self.crop is None:
            height, width = width, height
        if height % period or width % period:
            raise ArgumentError(f"crop must be even for X-Trans; found {self.crop}")
        rows, columns = (width, height) if orientation.transpose else (height, width)
        if rows + margin > area.height or columns + margin > area.width or min(rows, columns) <= 0:
            raise DatasetError(
                f"{frame.name}: {area.height} x {area.width} pixels are too few for a crop of {rows + margin} x "
                f"{columns + margin} (crop={self.crop}, augment={self.augment}); take a smaller crop"
            )
        top = period * int(generator.integers((area.height - rows - margin) // period + 1))
        left = period * int(generator.integers((area.width - columns - margin) // period + 1))
        window = mosaic[top : top + rows + margin, left : left + columns + margin]
        crop = oriented(window, cfa, orientation)[:height, :width]
        if crop.dtype == np.uint16:
            return pack_normalised(crop, cfa, frame.black_level_dn, frame.white_level_dn)
        return normalise(pack(crop, cfa), cfa, frame.black_level_dn, frame.white_level_dn)

    def __repr__(self) -> str:
        cameras = ", ".join(profile.camera for profile in self.profiles)
        return (
            f"SyntheticPairs({self.source!r}, {len(self)} items, cameras: {cameras}; {self.model!r}, "
            f"ratio={self.ratio}, crop={self.crop}, augment={self.augment}, seed={self.seed})"
        )
