"""The published sets of clips: DRV, preprocessed and raw, with references and without, and CRVD."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import TYPE_CHECKING, Literal, get_args

from eldata.datasets.clips import ClipWindows
from eldata.errors import ArgumentError, ManifestError, check_choice
from eldata.manifest.catalogue import FrameFiles, known_manifest, load_manifest, shipped_manifest
from eldata.manifest.clips import moment_name
from eldata.manifest.layouts import DYNAMIC, scan_raw
from eldata.manifest.pairs import Choice
from eldata.sources.frames import Files, no_folder

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable
    from fractions import Fraction
    from pathlib import Path

    from eldata.datasets.crops import Region
    from eldata.datasets.items import Crops
    from eldata.manifest.catalogue import Manifest
    from eldata.manifest.clips import FrameRange
    from eldata.manifest.layouts import Scan
    from eldata.noise.dark_shading import DarkShading
    from eldata.protocols.protocol import Amplification
    from eldata.raw.levels import Clip, FrameLevels
    from eldata.records import FrameRecord, PairRecord


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
    (:func:`eldata.manifest.layouts.scan_raw`); ``dataset.layout`` and ``repr`` describe them; what cannot be told is an
    error. A 20-megapixel frame takes 80 MB: choose a ``region`` (in packed pixels) or a ``crop`` for training.

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
        raws in place of looking for them, as :func:`~eldata.manifest.layouts.scan_raw` saves it.
    reference
        Of camera raws that are looked for: pattern of the references' file names, for copies with several raws in a
        folder below ``long``.
    split
        ``"train"``, ``"val"`` or ``"test"``.
    ids, window, stride, frames, region, crops_per_window, cameras, scenes, isos, ratios, subset, exclude_flags, \
    levels, clip, amplification, dark_shading, crop, augment, crops, seed
        As for :class:`~eldata.datasets.clips.ClipWindows`.

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

    def __init__(
        self,
        root: Path | str | None = None,
        *,
        form: Form = "preprocessed",
        dynamic: bool = False,
        manifest: Path | str | None = None,
        reference: str = "*",
        ids: Collection[str] | None = None, window: int = 5, stride: int | None = None, frames: FrameRange = "all",
        region: Region | None = None, crops_per_window: int = 1,
        cameras: Collection[str] | None = None, scenes: Collection[str | int] | None = None,
        isos: Collection[int] | None = None, ratios: Collection[float | Fraction] | None = None,
        split: str | Collection[str] | None = None, subset: str | None = None, exclude_flags: Collection[str] = (),
        levels: FrameLevels = "metadata", clip: Clip = "both", amplification: Amplification = "metadata",
        dark_shading: DarkShading | Path | str | None = None,
        crop: int | None = None, augment: bool = False, crops: Crops = "random", seed: int = 0,
    ) -> None:  # fmt: skip
        check_choice("form", form, FORMS)
        published = shipped_manifest("drv")
        folder = published.own_folder(root)
        if not folder.is_dir():
            raise no_folder(folder, published.card, ("VBM4D_rawRGB and long, or short and long",))
        found: Manifest | Scan = published
        if manifest is not None and manifest != published.name:
            found = load_manifest(manifest)
        elif form == "raw":
            found = scan_raw(folder, reference=reference)
        rows = [row for row in found.records if (row.split == DYNAMIC) == dynamic]
        files = Files(FrameFiles.of(folder, found.card, rows), rows)
        super().__init__(
            files, rows, found.card.subsets, folder, dynamic=dynamic,
            cameras=cameras, scenes=scenes, isos=isos, ratios=ratios, split=split, subset=subset,
            exclude_flags=exclude_flags, ids=ids, window=window, stride=stride, frames=frames, region=region,
            crops_per_window=crops_per_window, levels=levels, clip=clip, amplification=amplification,
            dark_shading=dark_shading, crop=crop, augment=augment, crops=crops, seed=seed,
        )  # fmt: skip


# --- the Captured Raw Video Denoising dataset (CRVD), indoor ----------------------------------------------------------

SHOTS = range(10)
"""The noisy shots of a frame."""

_FRAME = re.compile(r".*/frame([1-9][0-9]*)_noisy([0-9])\.tiff")


class CRVDDataset(ClipWindows):
    """The indoor clips of CRVD: 7 frames each, 11 scenes at 5 ISOs; every frame has ten noisy shots and a reference.

    ``dataset[i]`` is a :class:`~eldata.datasets.clips.ClipSample` whose ``target`` has a frame for each of ``input``,
    both packed Bayer, C = 4. A frame and its reference are exposed alike: ``ratio`` is 1. The n-th noisy shots of the
    moments are the n-th clip of a scene and ISO: ``ids=["scene7"]`` are its 50 clips. Splits: ``"train"`` (scenes 1 to
    6), ``"test"`` (7 to 11). The files are mosaics in TIFF; the card states their levels (black 240, white 4095) and
    colour filter array (GBRG). As pairs of frames they are
    ``PairDataset(root, "crvd")`` (:class:`eldata.datasets.base.PairDataset`).

    Parameters
    ----------
    root
        The folder that holds ``indoor_raw_noisy`` and ``indoor_raw_gt``. Default: ``CRVD`` below ``$ELDATA_ROOT`` or
        ``./data``.
    shots
        Which of the ten noisy shots of each frame, from 0; the published code scores the first: ``shots=[0]``.
    manifest
        A manifest's CSV file in place of the shipped one, such as one that ``eldata lock`` has filled in.
    ids, window, stride, frames, region, crops_per_window, cameras, scenes, isos, ratios, split, subset, \
    exclude_flags, levels, clip, amplification, dark_shading, crop, augment, crops, seed
        As for :class:`~eldata.datasets.clips.ClipWindows`; the choice is of frames.

    Raises
    ------
    ArgumentError
        If a value is unknown (the message lists the known ones) or out of its range.
    DatasetError
        Of an item, if the folder is not there: ``records`` need no files.

    References
    ----------
    H. Yue, C. Cao, L. Liao, R. Chu and J. Yang, "Supervised Raw Video Denoising with a Benchmark Dataset on Dynamic
    Scenes", IEEE/CVF Conference on Computer Vision and Pattern Recognition, 2020.

    Examples
    --------
    >>> from eldata.datasets import CRVDDataset
    >>> dataset = CRVDDataset("data/CRVD", split="test", shots=[0], window=3)  # doctest: +SKIP
    >>> len(dataset), dataset[0]["input"].shape, dataset[0]["target"].shape  # doctest: +SKIP
    (50, torch.Size([3, 4, 540, 960]), torch.Size([3, 4, 540, 960]))
    """

    def __init__(
        self,
        root: Path | str | None = None,
        *,
        shots: Collection[int] = SHOTS,
        manifest: Path | str = "crvd",
        ids: Collection[str] | None = None, window: int = 5, stride: int | None = None, frames: FrameRange = "all",
        region: Region | None = None, crops_per_window: int = 1,
        cameras: Collection[str] | None = None, scenes: Collection[str | int] | None = None,
        isos: Collection[int] | None = None, ratios: Collection[float | Fraction] | None = None,
        split: str | Collection[str] | None = None, subset: str | None = None, exclude_flags: Collection[str] = (),
        levels: FrameLevels = "metadata", clip: Clip = "both", amplification: Amplification = "metadata",
        dark_shading: DarkShading | Path | str | None = None,
        crop: int | None = None, augment: bool = False, crops: Crops = "random", seed: int = 0,
    ) -> None:  # fmt: skip
        found = known_manifest("crvd") if manifest == "crvd" else load_manifest(manifest)
        folder = found.own_folder(root)
        choice = Choice(cameras, scenes, isos, ratios, split, subset, exclude_flags)
        rows = _moments(found, choice.pairs(found.records, found.card.subsets), shots)
        files = Files(FrameFiles.of(folder, found.card, rows), rows, found.card)
        super().__init__(
            files, rows, (), folder, ids=ids, window=window, stride=stride, frames=frames, region=region,
            crops_per_window=crops_per_window, levels=levels, clip=clip, amplification=amplification,
            dark_shading=dark_shading, crop=crop, augment=augment, crops=crops, seed=seed,
        )  # fmt: skip


def _moments(manifest: Manifest, pairs: Iterable[PairRecord], shots: Collection[int]) -> list[FrameRecord]:
    """Return the rows of pairs as moments of sequences (:mod:`eldata.manifest.clips`), of these noisy shots alone."""
    if not {*shots} <= set(SHOTS):
        raise ArgumentError(f"shots must be of 0 to {len(SHOTS) - 1}; found {list(shots)}")
    chosen = {pair.path for pair in pairs}
    noisy = [row for row in manifest.records if row.path in chosen]
    scene_of: dict[str | None, str] = {}
    kept = []
    for row, (frame, shot) in zip(noisy, map(_numbers, noisy), strict=True):
        if shot in shots:
            scene_of[row.reference] = moment_name(row.scene, frame)
            kept.append(replace(row, scene=scene_of[row.reference]))
    return kept + [replace(row, scene=scene_of[row.path]) for row in manifest.records if row.path in scene_of]


def _numbers(row: FrameRecord) -> tuple[int, int]:
    found = _FRAME.fullmatch(row.path)
    if found is None:
        raise ManifestError(f"{row.path}: expected a name such as frame1_noisy0.tiff, whose numbers say frame and shot")
    return int(found[1]), int(found[2])
