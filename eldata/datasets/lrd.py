"""The Low-light Raw Denoising dataset (LRD)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Unpack

from eldata.base.arguments import spell_keywords
from eldata.datasets.base import PairDataset, PairOptions

if TYPE_CHECKING:
    from pathlib import Path


class LRDDataset(PairDataset):
    """The LRD set: 1800 pairs of 600 scenes, three exposure biases each, in DNG.

    Parameters, samples and errors: :class:`~eldata.datasets.base.PairDataset`. Splits: ``"train"``, ``"val"``,
    ``"test"``; subsets: ``"test-3ev"``, ``"test-2ev"`` and ``"test-1ev"``, the test scenes at one bias.

    The defaults give the input of the published code, but for the white level: ``levels="metadata"`` is the file's own,
    where the code has 65535 for every file. ``amplification="nominal"``: by the ratio of the times in the file names,
    as in the code.

    References
    ----------
    F. Zhang et al., "Towards General Low-Light Raw Noise Synthesis and Modeling", IEEE/CVF International Conference on
    Computer Vision, 2023.

    Examples
    --------
    >>> from eldata.datasets import LRDDataset
    >>> dataset = LRDDataset("data/LRD", subset="test-3ev")  # doctest: +SKIP
    >>> len(dataset)  # doctest: +SKIP
    60
    """

    @spell_keywords(PairOptions)
    def __init__(
        self, root: Path | str | None = None, *, manifest: Path | str = "lrd", **options: Unpack[PairOptions]
    ) -> None:
        options.setdefault("amplification", "nominal")
        super().__init__(root, manifest, **options)
