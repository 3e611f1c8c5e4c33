"""The published sets of pairs: ELD, SID, LRD, LRID and SIDD."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from eldata.datasets.base import PairDataset
from eldata.errors import ArgumentError, check_choice
from eldata.manifest.pairs import splits_of
from eldata.raw.levels import CAMERA_LEVELS_DN

if TYPE_CHECKING:
    from collections.abc import Collection
    from fractions import Fraction
    from pathlib import Path

    from eldata.datasets.items import Crops
    from eldata.noise.dark_shading import DarkShading
    from eldata.protocols.protocol import Amplification
    from eldata.raw.levels import Clip, FrameLevels

SidCameraName = Literal["sony", "fuji"]

_MANIFESTS: dict[str, str] = {"sony": "sid-sony", "fuji": "sid-fuji"}
_SPLITS: dict[str, tuple[str, ...]] = {
    "train": ("train",),
    "val": ("val",),
    "test": ("test",),
    "eval": ("val", "test"),
}


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
        seed: int = 0,
    ) -> None:  # fmt: skip
        super().__init__(
            root, manifest, cameras=cameras, scenes=scenes, isos=isos, ratios=ratios, split=split, subset=subset,
            exclude_flags=exclude_flags, levels=levels, clip=clip, amplification=amplification,
            dark_shading=dark_shading, crop=crop, augment=augment, crops=crops, crops_per_frame=crops_per_frame,
            seed=seed,
        )  # fmt: skip


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
        seed: int = 0,
    ) -> None:  # fmt: skip
        check_choice("camera", camera, _MANIFESTS)
        shipped = _MANIFESTS[camera]
        if levels in CAMERA_LEVELS_DN and levels != shipped:
            raise ArgumentError(f"levels {levels!r} are of another camera; those of {camera!r} are {shipped!r}")
        names = splits_of(split)
        if names is not None:
            for name in names:
                check_choice("split", name, _SPLITS)
            split = [part for name in names for part in _SPLITS[name]]
        manifest = shipped if manifest is None else manifest
        super().__init__(
            root, manifest, cameras=cameras, scenes=scenes, isos=isos, ratios=ratios, split=split, subset=subset,
            exclude_flags=exclude_flags, levels=levels, clip=clip, amplification=amplification,
            dark_shading=dark_shading, crop=crop, augment=augment, crops=crops, crops_per_frame=crops_per_frame,
            seed=seed,
        )  # fmt: skip


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
        seed: int = 0,
    ) -> None:  # fmt: skip
        super().__init__(
            root, manifest, cameras=cameras, scenes=scenes, isos=isos, ratios=ratios, split=split, subset=subset,
            exclude_flags=exclude_flags, levels=levels, clip=clip, amplification=amplification,
            dark_shading=dark_shading, crop=crop, augment=augment, crops=crops, crops_per_frame=crops_per_frame,
            seed=seed,
        )  # fmt: skip


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
        seed: int = 0,
    ) -> None:  # fmt: skip
        super().__init__(
            root, manifest, cameras=cameras, scenes=scenes, isos=isos, ratios=ratios, split=split, subset=subset,
            exclude_flags=exclude_flags, levels=levels, clip=clip, amplification=amplification,
            dark_shading=dark_shading, crop=crop, augment=augment, crops=crops, crops_per_frame=crops_per_frame,
            seed=seed,
        )  # fmt: skip


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
        seed: int = 0,
    ) -> None:  # fmt: skip
        if manifest is None:
            manifest = "sidd-blocks" if subset in ("validation", "benchmark") else "sidd"
        super().__init__(
            root, manifest, cameras=cameras, scenes=scenes, isos=isos, ratios=ratios, split=split, subset=subset,
            exclude_flags=exclude_flags, levels=levels, clip=clip, amplification=amplification,
            dark_shading=dark_shading, crop=crop, augment=augment, crops=crops, crops_per_frame=crops_per_frame,
            seed=seed,
        )  # fmt: skip
