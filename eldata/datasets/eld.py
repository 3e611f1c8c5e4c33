"""The Extreme Low-light Denoising dataset (ELD)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Unpack

from eldata.base.arguments import spell_keywords
from eldata.datasets.base import PairDataset, PairOptions

if TYPE_CHECKING:
    from pathlib import Path


class ELDDataset(PairDataset):
    """The ELD set: by default the paper's 240 pairs (4 cameras, 10 scenes, 3 ISOs, low-light factors 100 and 200).

    The reference of a noisy frame is the nearest of frames 1, 6, 11 and 16 by number. Parameters, samples and errors:
    :class:`~eldata.datasets.base.PairDataset`; ``ratios=(1, 10)`` gives the easier pairs of the same scenes. A set of
    your own in the same layout is read with its ``manifest``, and with the levels of the protocol that its card names.

    The defaults (of ELD ``levels="published"``, ``clip="both"``) give exactly the input of the published evaluation, so
    that numbers compare with the literature.

    References
    ----------
    K. Wei, Y. Fu, Y. Zheng and J. Yang, "Physics-based Noise Modeling for Extreme Low-light Photography", IEEE
    Transactions on Pattern Analysis and Machine Intelligence, 2021.

    Examples
    --------
    >>> from eldata import ELDDataset
    >>> manifest = "eldata-demo/manifests/eld-demo.csv"
    >>> dataset = ELDDataset("eldata-demo/data/ELD-demo", manifest=manifest, ratios=[100])
    >>> len(dataset), dataset[0]["input"].shape, dataset[0]["path"]
    (6, torch.Size([4, 256, 384]), 'DemoAlpha/scene-1/IMG_0004.dng')
    """

    @spell_keywords(PairOptions)
    def __init__(
        self, root: Path | str | None = None, *, manifest: Path | str = "eld", **options: Unpack[PairOptions]
    ) -> None:
        options.setdefault("ratios", (100, 200))
        super().__init__(root, manifest, **options)
