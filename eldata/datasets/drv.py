"""The Dark Raw Video dataset (DRV): preprocessed and raw, static clips with a reference and dynamic ones without."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal, Unpack, get_args

from eldata.datasets.base import no_folder
from eldata.datasets.clips import PairedClips, RawReader, RgbReader, UnpairedClips, WindowOptions, Windows
from eldata.errors import check_choice
from eldata.manifest.catalogue import data_root, load_manifest, shipped_manifest
from eldata.manifest.drv import DYNAMIC, scan_raw

if TYPE_CHECKING:
    from eldata.raw.cfa import Clip
    from eldata.raw.levels import Levels
    from eldata.records import FrameRecord

DrvSplit = Literal["train", "val", "test"]
_STATIC: tuple[DrvSplit, ...] = get_args(DrvSplit)


class DRVDataset(PairedClips):
    """The static clips of DRV as the authors preprocessed them: RGB, binned, amplified and denoised by VBM4D.

    ``dataset[i]`` is a :class:`~eldata.datasets.clips.ClipSample` with C = 3 in the order R, G, B (the DRV code has
    B, G, R, from OpenCV), divided by 65535. What it was amplified by is not published: ``ratio`` is nan. 202 clips, of
    which 129 are for training, 24 for validation and 49 for testing.

    Parameters
    ----------
    root
        The folder that holds ``VBM4D_rawRGB`` and ``long``. Default: ``DRV`` below ``$ELDATA_ROOT`` or ``./data``.
    split
        ``"train"``, ``"val"`` or ``"test"``; ``None`` is all three.
    manifest
        A manifest's CSV file in place of the shipped one, such as one that ``eldata lock`` has filled in.
    options
        Which windows of which clips: ``ids``, ``window``, ``stride``, ``frames``, ``region``
        (:class:`~eldata.datasets.clips.WindowOptions`).

    Raises
    ------
    ArgumentError
        If a split, a clip or a range is unknown (the message lists the known ones), or a number makes no sense.
    DatasetError
        If the folder or files of a chosen clip are not there, or their names are not in order.

    References
    ----------
    C. Chen, Q. Chen, M. N. Do and V. Koltun, "Seeing Motion in the Dark", IEEE International Conference on Computer
    Vision, 2019.

    Examples
    --------
    >>> from eldata import DRVDataset
    >>> dataset = DRVDataset("data/DRV", split="test", frames="evaluation")  # doctest: +SKIP
    >>> len(dataset), dataset[0]["input"].shape, dataset[0]["target"].shape  # doctest: +SKIP
    (49, torch.Size([5, 3, 918, 1374]), torch.Size([3, 918, 1374]))
    """

    def __init__(
        self,
        root: Path | str | None = None,
        *,
        split: DrvSplit | None = None,
        manifest: Path | str = "drv",
        **options: Unpack[WindowOptions],
    ) -> None:
        folder = _folder(root)
        rows = _listed(manifest)
        super().__init__(Windows(folder, rows, RgbReader(), splits=_splits(split), **options))


class DRVDynamicDataset(UnpairedClips):
    """The 23 dynamic clips of DRV, M0000 to M0022, preprocessed: input alone, for they have no reference.

    ``dataset[i]`` is an :class:`~eldata.datasets.clips.UnpairedClipSample`; ``ids`` are ``M0000`` and so on. Everything
    else is as in :class:`DRVDataset`. They are as dark and noisy as the static ones: no clean source for
    :class:`~eldata.datasets.synthetic_clips.SyntheticClips`.
    """

    def __init__(
        self,
        root: Path | str | None = None,
        *,
        manifest: Path | str = "drv",
        **options: Unpack[WindowOptions],
    ) -> None:
        folder = _folder(root)
        rows = _listed(manifest)
        super().__init__(Windows(folder, rows, RgbReader(), splits=(DYNAMIC,), **options))


class DRVRawDataset(PairedClips):
    """The static clips of DRV as camera raws: packed Bayer, amplified by the exact exposure ratio of the files.

    How the raw archives lie is not published. The files are looked for below ``root``
    (:func:`eldata.manifest.drv.scan_raw`); ``dataset.layout`` and ``repr`` say what was found, and what cannot be told
    is an error. A 20-megapixel frame takes 80 MB: choose a ``region`` (in packed pixels) for training.

    ``split`` and the other ``options`` are as in :class:`DRVDataset`.

    Parameters
    ----------
    root
        The folder below which the archives were unpacked, such as ``data/DRV``.
    reference
        Pattern of the references' file names, for copies with several raws in a folder below ``long``.
    levels
        White level: the file's (``"metadata"``) or 16383 (``"published"``). Black is the file's.
    clip
        As in :class:`~eldata.datasets.base.PairDataset`.
    manifest
        A manifest's CSV file, as :func:`~eldata.manifest.drv.scan_raw` saves it; then nothing is looked for.

    Raises
    ------
    ArgumentError, DatasetError
        As :class:`DRVDataset`; and if the files do not lie as ``scan_raw`` expects.
    """

    def __init__(
        self,
        root: Path | str | None = None,
        *,
        split: DrvSplit | None = None,
        reference: str = "*",
        levels: Levels = "metadata",
        clip: Clip = "both",
        manifest: Path | str | None = None,
        **options: Unpack[WindowOptions],
    ) -> None:
        reader = RawReader(levels=levels, clip=clip)
        folder = _folder(root)
        rows = scan_raw(folder, reference=reference).records if manifest is None else _listed(manifest)
        super().__init__(Windows(folder, rows, reader, splits=_splits(split), **options))


class DRVRawDynamicDataset(UnpairedClips):
    """The dynamic clips of DRV as camera raws: packed, normalised, not amplified; ``ratio`` is 1.

    There is no reference, so no exposure ratio either: multiply by the one that you choose. Parameters are as in
    :class:`DRVRawDataset`.
    """

    def __init__(
        self,
        root: Path | str | None = None,
        *,
        reference: str = "*",
        levels: Levels = "metadata",
        clip: Clip = "both",
        manifest: Path | str | None = None,
        **options: Unpack[WindowOptions],
    ) -> None:
        reader = RawReader(levels=levels, clip=clip)
        folder = _folder(root)
        rows = scan_raw(folder, reference=reference).records if manifest is None else _listed(manifest)
        super().__init__(Windows(folder, rows, reader, splits=(DYNAMIC,), **options))


def _splits(split: DrvSplit | None) -> tuple[DrvSplit, ...]:
    if split is None:
        return _STATIC
    check_choice("split", split, _STATIC)
    return (split,)


def _folder(root: Path | str | None) -> Path:
    card = shipped_manifest("drv").card
    folder = data_root() / card.folder if root is None else Path(root)
    if not folder.is_dir():
        raise no_folder(folder, card, "VBM4D_rawRGB and long, or short and long")
    return folder


def _listed(manifest: Path | str) -> tuple[FrameRecord, ...]:
    return (shipped_manifest("drv") if manifest == "drv" else load_manifest(manifest)).records
