"""The Low-light Raw Image Denoising set (LRID)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Unpack

from eldata.base.arguments import spell_keywords
from eldata.datasets.base import PairDataset, PairOptions

if TYPE_CHECKING:
    from pathlib import Path


class LRIDDataset(PairDataset):
    """The LRID set: bursts of ten noisy DNG frames of 139 scenes, exposure ratios 1 to 16; references in ``.npy``.

    Parameters, samples and errors: :class:`~eldata.datasets.base.PairDataset`. Splits: ``"train"``, ``"eval"`` (indoor)
    and ``"test"`` (outdoor); subsets: ``"indoor-first"`` and ``"outdoor-first"``, the first frame of each burst of the
    scenes that are scored. A scene's name begins with its part: ``"indoor_x5-004"``. Frames of scenes for which the
    published code takes the dark frames of a warm sensor have the flag ``"warm-sensor"``.

    The defaults give the input of the published code less its dark shading: ``levels="lrid"`` is black 64 and white
    1023 for every file, ``clip="none"``, ``amplification="nominal"``: by the ratio of the folders. No file states the
    exposure of the references.

    References
    ----------
    H. Feng et al., "Learnability Enhancement for Low-Light Raw Image Denoising: A Data Perspective", IEEE Transactions
    on Pattern Analysis and Machine Intelligence, 2024.

    Examples
    --------
    >>> from eldata.datasets import LRIDDataset
    >>> dataset = LRIDDataset("data/LRID", subset="indoor-first", ratios=[16])  # doctest: +SKIP
    >>> len(dataset)  # doctest: +SKIP
    9
    """

    @spell_keywords(PairOptions)
    def __init__(
        self, root: Path | str | None = None, *, manifest: Path | str = "lrid", **options: Unpack[PairOptions]
    ) -> None:
        options.setdefault("amplification", "nominal")
        options.setdefault("clip", "none")
        super().__init__(root, manifest, **options)
