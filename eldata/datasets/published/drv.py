"""The Dark Raw Video dataset (DRV): preprocessed and raw, static clips with a reference and dynamic ones without."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, Unpack, get_args

from eldata.base.arguments import spell_keywords
from eldata.datasets.base import no_folder
from eldata.datasets.clips import ClipWindows, WindowOptions
from eldata.errors import check_choice
from eldata.manifest.catalogue import FrameFiles, load_manifest, shipped_manifest
from eldata.manifest.drv import DYNAMIC, scan_raw
from eldata.sources.frames import Files

if TYPE_CHECKING:
    from pathlib import Path

    from eldata.manifest.catalogue import Manifest
    from eldata.manifest.drv import Scan


Form = Literal["preprocessed", "raw"]
FORMS: tuple[Form, ...] = get_args(Form)


class DRVDataset(ClipWindows):
    """The clips of DRV: static ones with a reference, dynamic ones without; preprocessed, or as camera raws.

    ``dataset[i]`` is a :class:`~eldata.datasets.clips.ClipSample`, of dynamic clips an
    :class:`~eldata.datasets.clips.UnpairedClipSample`: input alone. As the authors preprocessed them, frames are RGB,
    binned, amplified and denoised by VBM4D: C = 3 in the order R, G, B (the DRV code has B, G, R, from OpenCV), divided
    by 65535. What they were amplified by is not published: ``ratio`` is nan. 202 static clips, of which 129 are for
    training, 24 for validation and 49 for testing, and 23 dynamic ones, M0000 to M0022, as dark and noisy: no clean
    source for :class:`~eldata.datasets.synthetic.pairs.SyntheticClips`.

    Camera raws are packed Bayer, amplified by the exact exposure ratio of the files; dynamic ones, which have none, are
    not: ``ratio`` is 1. How the raw archives lie is not published. The files are looked for below ``root``
    (:func:`eldata.manifest.drv.scan_raw`); ``dataset.layout`` and ``repr`` say what was found, and what cannot be told
    is an error. A 20-megapixel frame takes 80 MB: choose a ``region`` (in packed pixels) or a ``crop`` for training.

    Parameters
    ----------
    root
        The folder that holds ``VBM4D_rawRGB`` and ``long``, or below which the raw archives were unpacked. Default:
        ``DRV`` below ``$ELDATA_ROOT`` or ``./data``.
    form
        ``"preprocessed"`` or ``"raw"``.
    dynamic
        The dynamic clips in place of the static ones.
    manifest
        A manifest's CSV file: in place of the shipped one, such as one that ``eldata lock`` has filled in; of camera
        raws in place of looking for them, as :func:`~eldata.manifest.drv.scan_raw` saves it.
    reference
        Of camera raws that are looked for: pattern of the references' file names, for copies with several raws in a
        folder below ``long``.
    options
        Which windows of which clips: ``window``, ``stride``, ``frames``, ``region``, ``split`` (``"train"``, ``"val"``
        or ``"test"``), ``ids`` and all else of :class:`~eldata.datasets.clips.Windowing`. ``levels`` of camera raws is
        ``"metadata"`` by default.

    Raises
    ------
    ArgumentError
        If a value is unknown (the message lists the known ones) or out of its range.
    DatasetError
        If the folder or files of a chosen clip are not there, or their names are not in order; or if camera raws do not
        lie as ``scan_raw`` expects.

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

    @spell_keywords(WindowOptions)
    def __init__(
        self,
        root: Path | str | None = None,
        *,
        form: Form = "preprocessed",
        dynamic: bool = False,
        manifest: Path | str | None = None,
        reference: str = "*",
        **options: Unpack[WindowOptions],
    ) -> None:
        check_choice("form", form, FORMS)
        published = shipped_manifest("drv")
        folder = published.own_folder(root)
        if not folder.is_dir():
            raise no_folder(folder, published.card, "VBM4D_rawRGB and long, or short and long")
        found: Manifest | Scan = published
        if manifest is not None and manifest != published.name:
            found = load_manifest(manifest)
        elif form == "raw":
            found = scan_raw(folder, reference=reference)
        rows = [row for row in found.records if (row.split == DYNAMIC) == dynamic]
        files = Files(FrameFiles.of(folder, found.card, rows), rows)
        super().__init__(files, rows, found.card.subsets, folder, dynamic=dynamic, **options)
