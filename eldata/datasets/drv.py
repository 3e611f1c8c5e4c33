"""The Dark Raw Video dataset (DRV): preprocessed and raw, static clips with a reference and dynamic ones without."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Unpack

from eldata.datasets.base import no_folder
from eldata.datasets.clips import ClipSample, ClipWindows, PairedClips, Sample, UnpairedClips, UnpairedClipSample
from eldata.manifest.catalogue import data_root, load_manifest, shipped_manifest
from eldata.manifest.drv import DYNAMIC, scan_raw
from eldata.sources.frames import Files

if TYPE_CHECKING:
    from eldata.datasets.clips import ListedClips, WindowOptions
    from eldata.manifest.catalogue import Manifest
    from eldata.manifest.drv import Scan


class _Listed(ClipWindows[Sample]):
    """The static or the dynamic clips below a folder, as a manifest lists them."""

    def __init__(
        self, root: Path | str | None = None, *, manifest: Path | str = "drv", **options: Unpack[WindowOptions]
    ) -> None:
        super().__init__(*_listed(root, manifest, "*", is_dynamic=not self._is_paired), **options)


class _Raws(ClipWindows[Sample]):
    """The static or the dynamic clips of camera raws below a folder, as found, or as a manifest lists them."""

    def __init__(
        self,
        root: Path | str | None = None,
        *,
        reference: str = "*",
        manifest: Path | str | None = None,
        **options: Unpack[WindowOptions],
    ) -> None:
        super().__init__(*_listed(root, manifest, reference, is_dynamic=not self._is_paired), **options)


class DRVDataset(_Listed[ClipSample], PairedClips):
    """The static clips of DRV as the authors preprocessed them: RGB, binned, amplified and denoised by VBM4D.

    ``dataset[i]`` is a :class:`~eldata.datasets.clips.ClipSample` with C = 3 in the order R, G, B (the DRV code has
    B, G, R, from OpenCV), divided by 65535. What it was amplified by is not published: ``ratio`` is nan. 202 clips, of
    which 129 are for training, 24 for validation and 49 for testing.

    Parameters
    ----------
    root
        The folder that holds ``VBM4D_rawRGB`` and ``long``. Default: ``DRV`` below ``$ELDATA_ROOT`` or ``./data``.
    manifest
        A manifest's CSV file in place of the shipped one, such as one that ``eldata lock`` has filled in.
    options
        Which windows of which clips: ``window``, ``stride``, ``frames``, ``region``, ``split`` (``"train"``, ``"val"``
        or ``"test"``), ``ids`` and all else of :class:`~eldata.datasets.clips.Windowing`.

    Raises
    ------
    ArgumentError
        If a value is unknown (the message lists the known ones) or out of its range.
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


class DRVDynamicDataset(_Listed[UnpairedClipSample], UnpairedClips):
    """The 23 dynamic clips of DRV, M0000 to M0022, preprocessed: input alone, for they have no reference.

    ``dataset[i]`` is an :class:`~eldata.datasets.clips.UnpairedClipSample`; ``ids`` are ``M0000`` and so on. Everything
    else is as in :class:`DRVDataset`. They are as dark and noisy as the static ones: no clean source for
    :class:`~eldata.datasets.synthetic_clips.SyntheticClips`.
    """


class DRVRawDataset(_Raws[ClipSample], PairedClips):
    """The static clips of DRV as camera raws: packed Bayer, amplified by the exact exposure ratio of the files.

    How the raw archives lie is not published. The files are looked for below ``root``
    (:func:`eldata.manifest.drv.scan_raw`); ``dataset.layout`` and ``repr`` say what was found, and what cannot be told
    is an error. A 20-megapixel frame takes 80 MB: choose a ``region`` (in packed pixels) for training.

    Parameters
    ----------
    root
        The folder below which the archives were unpacked, such as ``data/DRV``.
    reference
        Pattern of the references' file names, for copies with several raws in a folder below ``long``.
    manifest
        A manifest's CSV file, as :func:`~eldata.manifest.drv.scan_raw` saves it; then nothing is looked for.
    options
        As for :class:`DRVDataset`; ``levels`` is ``"metadata"`` by default.

    Raises
    ------
    ArgumentError, DatasetError
        As :class:`DRVDataset`; and if the files do not lie as ``scan_raw`` expects.
    """


class DRVRawDynamicDataset(_Raws[UnpairedClipSample], UnpairedClips):
    """The dynamic clips of DRV as camera raws: packed, normalised, not amplified; ``ratio`` is 1.

    There is no reference, so no exposure ratio either: multiply by the one that you choose. Parameters are as in
    :class:`DRVRawDataset`.
    """


def _listed(root: Path | str | None, manifest: Path | str | None, reference: str, *, is_dynamic: bool) -> ListedClips:
    """Return the static or the dynamic clips below a folder: those of a manifest, or the camera raws found there."""
    published = shipped_manifest("drv")
    folder = data_root() / published.card.folder if root is None else Path(root)
    if not folder.is_dir():
        raise no_folder(folder, published.card, "VBM4D_rawRGB and long, or short and long")
    found: Manifest | Scan
    if manifest is None:
        found = scan_raw(folder, reference=reference)
    else:
        found = published if manifest == "drv" else load_manifest(manifest)
    rows = [row for row in found.records if (row.split == DYNAMIC) == is_dynamic]
    return Files(folder, rows), rows, found.card.subsets, folder
