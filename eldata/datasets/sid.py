"""The See-in-the-Dark dataset (SID)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, Unpack

from eldata.base.arguments import spell_keywords
from eldata.datasets.base import PairDataset, PairOptions
from eldata.errors import ArgumentError, check_choice
from eldata.manifest.pairs import splits_of
from eldata.raw.levels import CAMERA_LEVELS_DN

if TYPE_CHECKING:
    from pathlib import Path

SidCameraName = Literal["sony", "fuji"]

_MANIFESTS: dict[str, str] = {"sony": "sid-sony", "fuji": "sid-fuji"}
_SPLITS: dict[str, tuple[str, ...]] = {
    "train": ("train",),
    "val": ("val",),
    "test": ("test",),
    "eval": ("val", "test"),
}


class SIDDataset(PairDataset):
    """The SID set: 2697 pairs of a Sony A7S II (Bayer), 2397 of a Fujifilm X-T2 (X-Trans, packed to nine channels).

    Samples and errors: :class:`~eldata.datasets.base.PairDataset`.

    Parameters
    ----------
    root
        The folder that holds ``Sony`` and ``Fuji``. Default: ``SID`` below ``$ELDATA_ROOT`` or ``./data``.
    camera
        ``"sony"`` or ``"fuji"``.
    split
        ``"train"``, ``"val"``, ``"test"``, or ``"eval"``: validation and test together, which most papers score on.
        ``None`` is everything: name one for training.
    subset
        A choice of pairs as published, on the dataset's card: ``"eval-first"`` (the first shot of each burst of
        validation and test; 129 Sony pairs), ``"test-first"`` (of the test scenes; 93 Sony, 94 Fuji), ``"indoor-15"``
        (15 scenes at 3 ratios, 45 Sony pairs), ``"all"``. Other arguments choose among its pairs.
    scenes, isos, ratios
        Which pairs; ``None`` means all. A scene is ``"00034"`` or 34; ratios are 100, 250 and 300.
    exclude_flags
        Pairs to leave out, such as ``["misaligned"]``: scenes 10034, 10045 and 10172 of Sony, which the authors ask to
        leave out of numbers. ``"misaligned-unconfirmed"``: see the card's known defects.
    levels
        ``"published"``: black of the file, white 16383, as the ELD code has it for Sony; ``"metadata"``: both of the
        file; ``"sid-sony"`` or ``"sid-fuji"``, for the camera's own set: the constants of the SID code, black 512 or
        1024 and white 16383 (the ELD code has these for Fuji).
    clip
        As in :class:`~eldata.datasets.base.PairDataset`.
    amplification
        ``"nominal"``: the input is multiplied by 100, 250 or 300, the ratio of the times in the file names, at most
        300, as in the SID and ELD code. ``"metadata"``: by the ratio that EXIF gives.
    manifest
        A manifest's CSV file in place of the shipped one.

    References
    ----------
    C. Chen, Q. Chen, J. Xu and V. Koltun, "Learning to See in the Dark", IEEE Conference on Computer Vision and Pattern
    Recognition, 2018.

    Examples
    --------
    >>> from eldata import SIDDataset
    >>> dataset = SIDDataset("data/SID", camera="sony", subset="eval-first")  # doctest: +SKIP
    >>> len(dataset)  # doctest: +SKIP
    129
    >>> training = SIDDataset("data/SID", camera="fuji", split="train")  # doctest: +SKIP
    """

    @spell_keywords(PairOptions)
    def __init__(
        self,
        root: Path | str | None = None,
        *,
        camera: SidCameraName = "sony",
        manifest: Path | str | None = None,
        **options: Unpack[PairOptions],
    ) -> None:
        check_choice("camera", camera, _MANIFESTS)
        shipped = _MANIFESTS[camera]
        levels, split = options.get("levels"), options.get("split")
        if levels in CAMERA_LEVELS_DN and levels != shipped:
            raise ArgumentError(f"levels {levels!r} are of another camera; those of {camera!r} are {shipped!r}")
        names = splits_of(split)
        if names is not None:
            for name in names:
                check_choice("split", name, _SPLITS)
            options["split"] = [part for name in names for part in _SPLITS[name]]
        options.setdefault("amplification", "nominal")
        super().__init__(root, shipped if manifest is None else manifest, **options)
