"""The published datasets, a class each, and all datasets by name, other packages' too.

A package of yours registers a dataset by an entry point (:mod:`eldata.manifest.catalogue`). Nothing of it is imported
before that dataset is asked for.
"""

from __future__ import annotations

import re
from dataclasses import replace
from importlib import import_module
from typing import TYPE_CHECKING, Any, ClassVar, Literal, get_args

from eldata.datasets.base import PairDataset
from eldata.datasets.clips import ClipWindows
from eldata.datasets.items import Crops, Transform, keywords_of, take_choice
from eldata.errors import ArgumentError, DatasetError, ManifestError, check_choice, did_you_mean
from eldata.manifest.catalogue import (
    FrameFiles,
    find_manifest,
    load_manifest,
    registered_names,
    registered_place,
    shipped_manifest,
)
from eldata.manifest.clips import FrameRange, moment_name
from eldata.manifest.layouts import DYNAMIC, Scan, scan_raw
from eldata.manifest.pairs import as_values
from eldata.manifest.patterns import is_pattern
from eldata.raw.levels import CAMERA_LEVELS_DN, Clip, FrameLevels
from eldata.sources.frames import FileCheck, Files, no_folder

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable
    from fractions import Fraction
    from pathlib import Path

    from eldata.datasets.crops import Region
    from eldata.manifest.catalogue import Manifest
    from eldata.noise.dark_shading import DarkShading
    from eldata.protocols.protocol import Amplification
    from eldata.records import FrameRecord, PairRecord


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

    def __init__(
        self,
        root: Path | str | None = None,
        *,
        manifest: Path | str = "eld",
        cameras: Collection[str] | None = None, scenes: Collection[str | int] | None = None,
        isos: Collection[int] | None = None, ratios: Collection[float | Fraction] | None = (100, 200),
        split: str | Collection[str] | None = None, subset: str | None = None, exclude_flags: Collection[str] = (),
        levels: FrameLevels | None = None, clip: Clip = "both", amplification: Amplification = "metadata",
        dark_shading: DarkShading | Path | str | None = None,
        crop: int | None = None, augment: bool = False, crops: Crops = "random", crops_per_frame: int = 1,
        seed: int = 0, transform: Transform | None = None, check: FileCheck = "exists",
    ) -> None:  # fmt: skip
        super().__init__(**keywords_of(locals()))


SidCameraName = Literal["sony", "fuji"]

_SID_MANIFESTS = {"sony": "sid-sony", "fuji": "sid-fuji"}
_SID_SPLITS = {"train": ("train",), "val": ("val",), "test": ("test",), "eval": ("val", "test")}


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
        A manifest's CSV file instead of the shipped one.

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

    def __init__(
        self,
        root: Path | str | None = None,
        *,
        camera: SidCameraName = "sony",
        manifest: Path | str | None = None,
        cameras: Collection[str] | None = None, scenes: Collection[str | int] | None = None,
        isos: Collection[int] | None = None, ratios: Collection[float | Fraction] | None = None,
        split: str | Collection[str] | None = None, subset: str | None = None, exclude_flags: Collection[str] = (),
        levels: FrameLevels | None = None, clip: Clip = "both", amplification: Amplification = "nominal",
        dark_shading: DarkShading | Path | str | None = None,
        crop: int | None = None, augment: bool = False, crops: Crops = "random", crops_per_frame: int = 1,
        seed: int = 0, transform: Transform | None = None, check: FileCheck = "exists",
    ) -> None:  # fmt: skip
        options = keywords_of(locals(), "camera")
        check_choice("camera", camera, _SID_MANIFESTS)
        shipped = _SID_MANIFESTS[camera]
        if levels in CAMERA_LEVELS_DN and levels != shipped:
            raise ArgumentError(f"levels {levels!r} are of another camera; those of {camera!r} are {shipped!r}")
        names = as_values(split)
        if names is not None:
            for name in names:
                check_choice("split", name, _SID_SPLITS)
            options["split"] = [part for name in names for part in _SID_SPLITS[name]]
        super().__init__(**options | {"manifest": manifest or shipped})


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

    def __init__(
        self,
        root: Path | str | None = None,
        *,
        manifest: Path | str = "lrd",
        cameras: Collection[str] | None = None, scenes: Collection[str | int] | None = None,
        isos: Collection[int] | None = None, ratios: Collection[float | Fraction] | None = None,
        split: str | Collection[str] | None = None, subset: str | None = None, exclude_flags: Collection[str] = (),
        levels: FrameLevels | None = None, clip: Clip = "both", amplification: Amplification = "nominal",
        dark_shading: DarkShading | Path | str | None = None,
        crop: int | None = None, augment: bool = False, crops: Crops = "random", crops_per_frame: int = 1,
        seed: int = 0, transform: Transform | None = None, check: FileCheck = "exists",
    ) -> None:  # fmt: skip
        super().__init__(**keywords_of(locals()))


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

    def __init__(
        self,
        root: Path | str | None = None,
        *,
        manifest: Path | str = "lrid",
        cameras: Collection[str] | None = None, scenes: Collection[str | int] | None = None,
        isos: Collection[int] | None = None, ratios: Collection[float | Fraction] | None = None,
        split: str | Collection[str] | None = None, subset: str | None = None, exclude_flags: Collection[str] = (),
        levels: FrameLevels | None = None, clip: Clip = "none", amplification: Amplification = "nominal",
        dark_shading: DarkShading | Path | str | None = None,
        crop: int | None = None, augment: bool = False, crops: Crops = "random", crops_per_frame: int = 1,
        seed: int = 0, transform: Transform | None = None, check: FileCheck = "exists",
    ) -> None:  # fmt: skip
        super().__init__(**keywords_of(locals()))


class SIDDDataset(PairDataset):
    """The SIDD set in raw, by five phones: the medium set, 320 pairs of ten scenes, or its 1280 validation blocks.

    Parameters, samples and errors: :class:`~eldata.datasets.base.PairDataset`. Every pair of the medium set is of the
    split ``"train"``; subsets: ``"sfrn-s6"``, ``"sfrn-gp"`` and ``"sfrn-ip"``, the scenes that SFRN tests of one phone.
    ``subset="validation"`` is the blocks of 256 x 256 pixels, which the manifest ``"sidd-blocks"`` lists, once
    ``eldata download sidd-blocks --from`` has unpacked them; the benchmark's blocks have no references.

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
    >>> len(SIDDDataset("data/SIDD", subset="validation"))  # doctest: +SKIP
    1280
    """

    def __init__(
        self,
        root: Path | str | None = None,
        *,
        manifest: Path | str | None = None,
        cameras: Collection[str] | None = None, scenes: Collection[str | int] | None = None,
        isos: Collection[int] | None = None, ratios: Collection[float | Fraction] | None = None,
        split: str | Collection[str] | None = None, subset: str | None = None, exclude_flags: Collection[str] = (),
        levels: FrameLevels | None = None, clip: Clip = "both", amplification: Amplification = "metadata",
        dark_shading: DarkShading | Path | str | None = None,
        crop: int | None = None, augment: bool = False, crops: Crops = "random", crops_per_frame: int = 1,
        seed: int = 0, transform: Transform | None = None, check: FileCheck = "exists",
    ) -> None:  # fmt: skip
        if manifest is None:
            manifest = "sidd-blocks" if subset in ("validation", "benchmark") else "sidd"
        super().__init__(**keywords_of(locals()))


Form = Literal["preprocessed", "raw"]


class DRVDataset(ClipWindows):
    """The clips of DRV: static ones with a reference, dynamic ones without; preprocessed, or as camera raws.

    ``dataset[i]`` is a :class:`~eldata.datasets.items.Sample`, of dynamic clips without ``target``. As the authors
    preprocessed them, frames are RGB, binned, amplified and denoised by VBM4D: C = 3 in the order R, G, B (the DRV code
    has B, G, R, from OpenCV), divided by 65535. What they were amplified by is not published: ``ratio`` is nan. 202
    static clips, of which 129 are for training, 24 for validation and 49 for testing, and 23 dynamic ones, M0000 to
    M0022, as dark and noisy: no clean source for :class:`~eldata.datasets.synthetic.pairs.SyntheticClips`.

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
        The dynamic clips instead of the static ones.
    manifest
        A manifest's CSV file: instead of the shipped one, such as one that ``eldata lock`` has filled in; of camera
        raws instead of looking for them, as :func:`~eldata.manifest.layouts.scan_raw` saves it.
    reference
        Of camera raws that are looked for: pattern of the references' file names, for copies with several raws in a
        folder below ``long``.
    split
        ``"train"``, ``"val"`` or ``"test"``.
    ids, window, stride, frames, region, crops_per_window, cameras, scenes, isos, ratios, subset, exclude_flags, \
    levels, clip, amplification, dark_shading, crop, augment, crops, seed, transform
        As for :class:`~eldata.datasets.clips.ClipWindows`.
    check
        As for :class:`~eldata.datasets.base.PairDataset`.

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
        dark_shading: DarkShading | Path | str | None = None, transform: Transform | None = None,
        crop: int | None = None, augment: bool = False, crops: Crops = "random", seed: int = 0,
        check: FileCheck = "exists",
    ) -> None:  # fmt: skip
        options = keywords_of(locals(), "root", "form", "manifest", "reference", "check")
        check_choice("form", form, get_args(Form))
        published = shipped_manifest("drv")
        folder = published.own_folder(root)
        if not folder.is_dir():
            raise no_folder(folder, published.card, ("VBM4D_rawRGB and long, or short and long",))
        listed: Manifest | Scan = published
        if manifest is not None and manifest != published.name:
            listed = load_manifest(manifest)
        elif form == "raw":
            listed = scan_raw(folder, reference=reference)
        rows = [row for row in listed.records if (row.split == DYNAMIC) == dynamic]
        files = Files(FrameFiles.of(folder, listed.card, rows), rows)
        super().__init__(files, rows, listed.card.subsets, folder, **options)
        files.require(self.records, check)


SHOTS = range(10)
"""The noisy shots of a frame."""

# Of the three sets of such clips, with the number of the frame, from 1 on or in an array from 0, and of the shot.
_FRAME = re.compile(r".*(?:/frame([0-9]+)_noisy([0-9])\.tiff|/wb_noisy_([0-9]+)_([0-9])\.tiff|\.npy#([0-9]+))")


class CRVDDataset(ClipWindows):
    """The indoor clips of CRVD: 7 frames each, 11 scenes at 5 ISOs; every frame has ten noisy shots and a reference.

    ``dataset[i]`` is a :class:`~eldata.datasets.items.Sample` whose ``target`` has a frame for each of ``input``,
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
        A manifest's CSV file instead of the shipped one, such as one that ``eldata lock`` has filled in.
    ids, window, stride, frames, region, crops_per_window, cameras, scenes, isos, ratios, split, subset, \
    exclude_flags, levels, clip, amplification, dark_shading, crop, augment, crops, seed, transform
        As for :class:`~eldata.datasets.clips.ClipWindows`; the choice is of frames.
    check
        As for :class:`~eldata.datasets.base.PairDataset`.

    Raises
    ------
    ArgumentError
        If a value is unknown (the message lists the known ones) or out of its range.
    DatasetError
        If a chosen file or the folder is not there; of an item, if ``check`` is ``"never"``.

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

    shipped: ClassVar[str] = "crvd"
    """Name of the manifest that is read by default."""

    def __init__(
        self,
        root: Path | str | None = None,
        *,
        shots: Collection[int] = SHOTS,
        manifest: Path | str | None = None,
        ids: Collection[str] | None = None, window: int = 5, stride: int | None = None, frames: FrameRange = "all",
        region: Region | None = None, crops_per_window: int = 1,
        cameras: Collection[str] | None = None, scenes: Collection[str | int] | None = None,
        isos: Collection[int] | None = None, ratios: Collection[float | Fraction] | None = None,
        split: str | Collection[str] | None = None, subset: str | None = None, exclude_flags: Collection[str] = (),
        levels: FrameLevels = "metadata", clip: Clip = "both", amplification: Amplification = "metadata",
        dark_shading: DarkShading | Path | str | None = None, transform: Transform | None = None,
        crop: int | None = None, augment: bool = False, crops: Crops = "random", seed: int = 0,
        check: FileCheck = "exists",
    ) -> None:  # fmt: skip
        options = keywords_of(locals(), "root", "shots", "manifest", "check")
        listed = find_manifest(manifest or self.shipped)
        folder = listed.own_folder(root)
        if (of_copy := listed.of_copy(folder)) is not listed and not folder.is_dir():
            raise no_folder(folder, listed.card, (listed.records[0].path,))
        listed = of_copy
        rows = _list_moments(listed, take_choice(options).pairs(listed.records, listed.card.subsets), shots)
        files = Files(FrameFiles.of(folder, listed.card, rows), rows, listed.card)
        super().__init__(files, rows, (), folder, **options)
        files.require(self.records, check)


def _list_moments(manifest: Manifest, pairs: Iterable[PairRecord], shots: Collection[int]) -> list[FrameRecord]:
    """Return the rows of pairs as moments of sequences (:mod:`eldata.manifest.clips`), of these noisy shots alone."""
    shots = as_values(shots) or ()
    if not {*shots} <= set(SHOTS):
        raise ArgumentError(f"shots must be of 0 to {len(SHOTS) - 1}; found {list(shots)}")
    chosen = {pair.path for pair in pairs}
    noisy = [row for row in manifest.records if row.path in chosen]
    if lost := sorted({row.scene for row in noisy if is_pattern(row.path)}):
        have = sorted({row.scene for row in noisy} - {*lost})
        raise DatasetError(f"no frames of {len(lost)} scenes, such as {lost[0]}: choose yours with scenes={have!r}")
    scene_of: dict[str | None, str] = {}
    kept = []
    for row, (frame, shot) in zip(noisy, map(_parse_frame_and_shot, noisy), strict=True):
        if shot in shots:
            scene_of[row.reference] = moment_name(row.scene, frame)
            kept.append(replace(row, scene=scene_of[row.reference]))
    return kept + [replace(row, scene=scene_of[row.path]) for row in manifest.records if row.path in scene_of]


def _parse_frame_and_shot(row: FrameRecord) -> tuple[int, int]:
    """Parse the numbers of frame and shot in the name of a noisy file."""
    numbers = _FRAME.fullmatch(row.path)
    if numbers is None:
        raise ManifestError(f"{row.path}: expected a name such as frame1_noisy0.tiff, whose numbers say frame and shot")
    if numbers[5]:
        return int(numbers[5]) + 1, 0
    return int(numbers[1] or numbers[3]), int(numbers[2] or numbers[4])


class ReCRVDDataset(CRVDDataset):
    """The clips of ReCRVD: 120 scenes of 25 frames, each with ten noisy shots and a reference, like those of CRVD.

    Parameters, samples and errors: :class:`CRVDDataset`. Splits: ``"train"`` (90 scenes), ``"test"`` (30). No public
    text names the ISO of a scene or the folder between a scene and its noisy frames: it is found in the copy.

    References
    ----------
    H. Yue, C. Cao, L. Liao and J. Yang, "RViDeformer: Efficient Raw Video Denoising Transformer with a Larger Benchmark
    Dataset", IEEE Transactions on Circuits and Systems for Video Technology, 2025.
    """

    shipped = "recrvd"


class LLRVDDataset(CRVDDataset):
    """The clips of LLRVD: 70 scenes of a screen, each with a reference and noisy clips of several exposure ratios.

    Parameters, samples and errors: :class:`CRVDDataset`; a clip is one array, so it has one shot of each frame:
    ``ids=["35"]`` are a scene's clips, ``ratios=[125]`` those of a ratio. Splits: ``"train"`` (60 scenes), ``"val"``
    (4), ``"test"`` (6). Inputs are amplified by the ratio that their folder names, as in the published code.

    References
    ----------
    Y. Fu, Z. Wang, T. Zhang and J. Zhang, "Low-light Raw Video Denoising with a High-quality Realistic Motion Dataset",
    IEEE Transactions on Multimedia, 2022.
    """

    shipped = "llrvd"


class PMRIDDataset(PairDataset):
    """The PMRID benchmark: noisy and clean frames of an Oppo Reno 10x, 16 bits a pixel without a header.

    Parameters, samples and errors: :class:`~eldata.datasets.base.PairDataset`. A scene is a folder, whose exposures lie
    in folders of it; a frame and its reference are exposed alike, and nothing is amplified.

    References
    ----------
    Y. Wang, H. Huang, Q. Xu, J. Liu, Y. Liu and J. Wang, "Practical Deep Raw Image Denoising on Mobile Devices",
    European Conference on Computer Vision, 2020.
    """

    def __init__(
        self,
        root: Path | str | None = None,
        *,
        manifest: Path | str = "pmrid",
        cameras: Collection[str] | None = None, scenes: Collection[str | int] | None = None,
        isos: Collection[int] | None = None, ratios: Collection[float | Fraction] | None = None,
        split: str | Collection[str] | None = None, subset: str | None = None, exclude_flags: Collection[str] = (),
        levels: FrameLevels | None = None, clip: Clip = "both", amplification: Amplification = "metadata",
        dark_shading: DarkShading | Path | str | None = None,
        crop: int | None = None, augment: bool = False, crops: Crops = "random", crops_per_frame: int = 1,
        seed: int = 0, transform: Transform | None = None, check: FileCheck = "exists",
    ) -> None:  # fmt: skip
        super().__init__(**keywords_of(locals()))


class RawNINDDataset(PairDataset):
    """RawNIND: scenes by cameras with Bayer and X-Trans arrays, each at several ISOs; 2281 noisy frames.

    Parameters, samples and errors: :class:`~eldata.datasets.base.PairDataset`. A reference is the first of its scene.
    Few pairs are known to lie on each other: ``subset="aligned"``, or ``exclude_flags=["unaligned", "misaligned"]``.
    Inputs are amplified by what EXIF states, which nobody has published. Splits: ``"train"``, ``"test"`` (16 scenes).

    References
    ----------
    B. Brummer and C. De Vleeschouwer, "Learning Joint Denoising, Demosaicing, and Compression from the Raw Natural
    Image Noise Dataset", arXiv 2501.08924, 2025.
    """

    def __init__(
        self,
        root: Path | str | None = None,
        *,
        manifest: Path | str = "rawnind",
        cameras: Collection[str] | None = None, scenes: Collection[str | int] | None = None,
        isos: Collection[int] | None = None, ratios: Collection[float | Fraction] | None = None,
        split: str | Collection[str] | None = None, subset: str | None = None, exclude_flags: Collection[str] = (),
        levels: FrameLevels | None = None, clip: Clip = "both", amplification: Amplification = "metadata",
        dark_shading: DarkShading | Path | str | None = None,
        crop: int | None = None, augment: bool = False, crops: Crops = "random", crops_per_frame: int = 1,
        seed: int = 0, transform: Transform | None = None, check: FileCheck = "exists",
    ) -> None:  # fmt: skip
        super().__init__(**keywords_of(locals()))


# --- all datasets by name -----------------------------------------------------------------------------------------

# A dataset's name is its manifest's; and the options that tell manifests apart which one class reads.
_CLASSES: dict[str, tuple[type[Any], dict[str, str]]] = {
    "eld": (ELDDataset, {}),
    "sid-sony": (SIDDataset, {"camera": "sony"}),
    "sid-fuji": (SIDDataset, {"camera": "fuji"}),
    "drv": (DRVDataset, {}),
    "crvd": (CRVDDataset, {}),
    "recrvd": (ReCRVDDataset, {}),
    "llrvd": (LLRVDDataset, {}),
    "pmrid": (PMRIDDataset, {}),
    "raw-denoise": (PairDataset, {"manifest": "raw-denoise"}),
    "rawnind": (RawNINDDataset, {}),
    "lrd": (LRDDataset, {}),
    "lrid": (LRIDDataset, {}),
    "sidd": (SIDDDataset, {}),
    "sidd-blocks": (SIDDDataset, {"manifest": "sidd-blocks"}),
}


def dataset_names() -> tuple[str, ...]:
    """Return the names of all datasets: this package's own, then other packages'.

    Examples
    --------
    >>> from eldata.datasets import dataset_names
    >>> dataset_names()[:4]
    ('eld', 'sid-sony', 'sid-fuji', 'drv')
    """
    return tuple(dict.fromkeys((*_CLASSES, *registered_names())))


def dataset_class(name: str) -> type[Any]:
    """Return a dataset's class: one of pairs (:class:`~eldata.datasets.base.PairDataset`) or of clips (DRV).

    Raises
    ------
    ArgumentError
        If the name is unknown (the message lists the known ones), or several packages register it.
    DatasetError
        If the class that another package registers is not to be found.
    """
    own, _ = _CLASSES.get(name, (None, {}))
    place = registered_place(name, None if own is None else f"{own.__module__}:{own.__name__}")
    if place is None:
        known = dataset_names()
        hint = did_you_mean(name, known)
        raise ArgumentError(f"no dataset is called {name!r}; known are {', '.join(known)}{hint}")
    if own is not None:
        return own
    module, _, attribute = place.partition(":")
    try:
        registered: type[Any] = getattr(import_module(module), attribute)
    except (ImportError, AttributeError) as error:
        raise DatasetError(f"dataset {name!r} is registered as {place}, which cannot be imported: {error}") from error
    return registered


def open_dataset(name: str, root: Path | str | None = None, **options: Any) -> Any:
    """Return a dataset by name: ``open_dataset("sid-fuji", root)`` is ``SIDDataset(root, camera="fuji")``.

    Parameters
    ----------
    name
        One of :func:`dataset_names`.
    root
        The dataset's own folder.
    options
        Keyword arguments of its class.

    Raises
    ------
    ArgumentError
        If the name is unknown (the message lists the known ones), or several packages register it.
    EldataError
        As :func:`dataset_class` and the class do.
    """
    _, own_options = _CLASSES.get(name, (None, {}))
    return dataset_class(name)(root, **own_options | options)  # each class has keywords of its own
