"""Synthetic pairs: clean crops with noise made on the fly."""

from __future__ import annotations

from typing import TYPE_CHECKING, Unpack

from eldata.datasets.base import SIDES
from eldata.datasets.crops import Crop
from eldata.datasets.draws import NoiseFacts
from eldata.datasets.items import Part
from eldata.datasets.noisy_items import NoiseOptions, NoisyItem, NoisyItems

if TYPE_CHECKING:
    from collections.abc import Iterator

    import numpy as np
    import torch

    from eldata.datasets.clean import CleanSource
    from eldata.datasets.draws import Cameras


class SyntheticSample(NoiseFacts):
    """One synthetic pair, as torch's default collate accepts it.

    ``input`` and ``target`` are (C, h, w) float32, normalised; the input is amplified by ``ratio``. ``path`` says where
    the clean frame comes from. The rest are the parameters that its noise was made with.
    """

    input: torch.Tensor
    target: torch.Tensor
    path: str


class SyntheticPairs(NoisyItems[NoisyItem, SyntheticSample]):
    """Clean crops and noisy exposures of them, made again in each epoch.

    Item i of epoch e depends on (seed, e, i) alone: not on workers, their number, or what was read before. Call
    :meth:`set_epoch` before each epoch; it reaches workers that are running already.

    Parameters
    ----------
    source
        Clean frames: :class:`~eldata.datasets.clean.RawFiles`, :class:`~eldata.datasets.clean.Arrays`, or anything with
        their two methods.
    profiles
        One camera profile or several (one is drawn for each item), by name, path or object.
    crops_per_frame
        Items per clean frame: the length is this times the number of frames.
    options
        What noise is made (:class:`~eldata.datasets.noisy_items.Noise`): ``model``, ``ratio``, ``iso``, ``row``; and
        from which crops (:class:`~eldata.datasets.items.Cropping`): ``crop`` (default 512), ``augment`` (``True``),
        ``seed``.

    Raises
    ------
    ArgumentError
        If a value is out of its range.

    Examples
    --------
    >>> import numpy as np
    >>> from eldata import SyntheticPairs
    >>> from eldata.datasets import Arrays
    >>> clean = Arrays(np.full((2, 4, 128, 128), 0.2, np.float32), range_dn=15871.0)
    >>> pairs = SyntheticPairs(clean, "SonyA7S2", crop=64, crops_per_frame=8, seed=0)
    >>> len(pairs), pairs[0]["input"].shape
    (16, torch.Size([4, 64, 64]))
    >>> bool((pairs[3]["input"] == pairs[3]["input"]).all())
    True
    """

    def __init__(
        self,
        source: CleanSource,
        profiles: Cameras,
        *,
        crops_per_frame: int = 1,
        **options: Unpack[NoiseOptions],
    ) -> None:
        super().__init__(source, "frame", profiles, ("crops_per_frame", crops_per_frame), options)
        self.source = source
        self.crops_per_frame = crops_per_frame

    def drawn(self, index: int, generator: np.random.Generator) -> NoisyItem:
        """Draw a crop of frame ``index`` modulo their number, and its noise."""
        frame = self.source.frame(index % len(self.source))
        crop = Crop.draw(frame, generator, crop=self.crop, augment=self.augment)
        return NoisyItem(frame, crop, self.draw_noise(generator, index), generator, index)

    def shapes(self, item: NoisyItem) -> dict[str, tuple[int, ...]]:
        """Return the shapes of input and target."""
        return dict.fromkeys(SIDES, item.crop.packed_shape)

    def parts(self, item: NoisyItem) -> Iterator[Part]:
        """Yield the clean crop."""
        yield Part("target", item.frame, is_light=True)

    def __repr__(self) -> str:
        return self._text(self.source, f"{len(self)} items")
