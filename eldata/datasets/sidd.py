"""The Smartphone Image Denoising Dataset (SIDD), its medium set in raw."""

from __future__ import annotations

from typing import TYPE_CHECKING, Unpack

from eldata.base.arguments import spell_keywords
from eldata.datasets.base import PairDataset, PairOptions

if TYPE_CHECKING:
    from pathlib import Path


class SIDDDataset(PairDataset):
    """The SIDD medium set in raw: 320 pairs of ten scenes, by five phones, in MATLAB's files.

    Parameters, samples and errors: :class:`~eldata.datasets.base.PairDataset`. Every pair is of the split
    ``"train"``; subsets: ``"sfrn-s6"``, ``"sfrn-gp"`` and ``"sfrn-ip"``, the scenes that SFRN tests of one phone.

    The files hold shares of white, so black is 0 and white 1; a reference has its noisy frame's ISO and time, and
    nothing is amplified. Arrays lie as MATLAB shows them: what h5py reads of the same files is their transpose.

    References
    ----------
    A. Abdelhamed, S. Lin and M. S. Brown, "A High-Quality Denoising Dataset for Smartphone Cameras", IEEE/CVF
    Conference on Computer Vision and Pattern Recognition, 2018.

    Examples
    --------
    >>> from eldata.datasets import SIDDDataset
    >>> dataset = SIDDDataset("data/SIDD", cameras=["GalaxyS6Edge"])  # doctest: +SKIP
    >>> len(dataset)  # doctest: +SKIP
    70
    """

    @spell_keywords(PairOptions)
    def __init__(
        self, root: Path | str | None = None, *, manifest: Path | str = "sidd", **options: Unpack[PairOptions]
    ) -> None:
        super().__init__(root, manifest, **options)
