"""What every dataset of pairs shares: records from the manifest, pixels decoded on demand."""

from __future__ import annotations

from dataclasses import asdict
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypedDict, get_args

import numpy as np
import torch
from torch.utils.data import Dataset

from eldata.errors import DatasetError, check_choice
from eldata.manifest.catalogue import Manifest, data_root, load_manifest, shipped_manifest, shipped_names
from eldata.manifest.pairs import UNCERTAIN_ISO, select_pairs
from eldata.manifest.subsets import find_subset
from eldata.manifest.verify import RATIO_TOLERANCE
from eldata.raw.cfa import CLIP_RANGES
from eldata.raw.levels import FRAME_LEVELS, FrameLevels, packed_frame
from eldata.records import RawHeader

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

    import pandas as pd
    from numpy.typing import NDArray

    from eldata.manifest.card import Card
    from eldata.raw.cfa import Clip
    from eldata.records import Exposure, PairRecord, RawFrame

Amplification = Literal["metadata", "nominal"]
AMPLIFICATIONS: tuple[Amplification, ...] = get_args(Amplification)


class Sample(TypedDict):
    """One pair, as torch's default collate accepts it.

    ``input`` and ``target`` are (C, h, w) float32, normalised, the input multiplied by ``ratio``: the files' own
    exposure ratio or, with ``amplification="nominal"``, the manifest's, which ``nominal_ratio`` always is. ``iso`` and
    ``exposure_s`` (seconds) are the noisy file's.
    """

    input: torch.Tensor
    target: torch.Tensor
    ratio: float
    nominal_ratio: float
    iso: float
    exposure_s: float
    camera: str
    scene: str
    split: str
    path: str
    reference: str
    flags: str


class PairDataset(Dataset[Sample]):
    """Pairs of a manifest: ``dataset[i]`` is a :class:`Sample`.

    Parameters
    ----------
    root
        The dataset's own folder, such as ``data/ELD``. Default: the card's folder below ``$ELDATA_ROOT`` or ``./data``.
    manifest
        A manifest's CSV file, or the name of a shipped one.
    cameras, scenes, isos, ratios, splits, exclude_flags
        Which pairs; ``None`` means all. See :func:`eldata.manifest.pairs.select_pairs`.
    subset
        Name of a subset on the manifest's card (:mod:`eldata.manifest.subsets`).
    levels
        ``"published"``: white level 16383 for every camera; ``"metadata"``: the file's own. Black is the file's either
        way. Or the constants of the SID code by name: :func:`eldata.raw.levels.with_levels`.
    clip
        ``"both"``: the normalised frame is clipped to [0, 1] before and after the input is multiplied by the ratio,
        as published; ``"upper"``: at 1 only, so that negative read noise is kept; ``"none"``.
    amplification
        What the input is multiplied by: ``"metadata"``, the ratio of ISO times exposure time that the files state, or
        ``"nominal"``, the manifest's ratio. The files' ratio is checked either way.

    Raises
    ------
    DatasetError
        If the folder, or that of a chosen camera, is not there.
    ArgumentError
        If a value that chooses pairs, a subset, ``levels``, ``clip`` or ``amplification`` is unknown; the message lists
        the known ones.
    ManifestError
        If the manifest is malformed.

    Notes
    -----
    Frames of different cameras differ in size: with more than one camera use ``batch_size=1``. The files are decoded
    anew on each access, in DataLoader workers under fork as under spawn.
    """

    def __init__(
        self,
        root: Path | str | None,
        manifest: Path | str,
        *,
        cameras: Collection[str] | None = None,
        scenes: Collection[str | int] | None = None,
        isos: Collection[int] | None = None,
        ratios: Collection[float | Fraction] | None = None,
        splits: Collection[str] | None = None,
        subset: str | None = None,
        exclude_flags: Collection[str] = (),
        levels: FrameLevels = "published",
        clip: Clip = "both",
        amplification: Amplification = "metadata",
    ) -> None:
        for name, value, known in (
            ("levels", levels, FRAME_LEVELS),
            ("clip", clip, tuple(CLIP_RANGES)),
            ("amplification", amplification, AMPLIFICATIONS),
        ):
            check_choice(name, value, known)
        loaded = _manifest(manifest)
        self.name = loaded.name
        self.root = data_root() / loaded.card.folder if root is None else Path(root)
        self.levels: FrameLevels = levels
        self.clip: Clip = clip
        self.amplification: Amplification = amplification
        self.records: tuple[PairRecord, ...] = select_pairs(
            loaded.records,
            cameras=cameras,
            scenes=scenes,
            isos=isos,
            ratios=ratios,
            splits=splits,
            subset=None if subset is None else find_subset(loaded.card.subsets, subset),
            exclude_flags=exclude_flags,
        )
        self._check_folders(loaded)

    def _check_folders(self, manifest: Manifest) -> None:
        if not self.root.is_dir():
            folders = dict.fromkeys(record.path.split("/")[0] for record in manifest.records)
            raise no_folder(self.root, manifest.card, ", ".join(folders))
        tops = {record.path.split("/")[0]: record.camera for record in self.records}
        present = [camera for top, camera in tops.items() if (self.root / top).is_dir()]
        for top, camera in tops.items():
            if camera not in present:
                hint = f"choose those you have with cameras={present!r}" if present else "is this the right folder?"
                raise DatasetError(f"{self.root}: has no folder {top!r} for camera {camera}; {hint}")

    @property
    def frame(self) -> pd.DataFrame:
        """The records as a pandas DataFrame, one row a pair, numbers as floats."""
        import pandas as pd

        rows = [
            {key: float(value) if isinstance(value, Fraction) else value for key, value in asdict(record).items()}
            for record in self.records
        ]
        return pd.DataFrame(rows)

    def __len__(self) -> int:
        return len(self.records)

    def __iter__(self) -> Iterator[Sample]:
        return (self[index] for index in range(len(self)))

    def __getitem__(self, index: int) -> Sample:
        """Decode one pair.

        Raises
        ------
        RawFileError
            If a file is missing, damaged or without exposure data.
        DatasetError
            If the files' exposure ratio is more than a tenth off the manifest's, or their sizes differ.
        """
        from eldata.base.files import inside
        from eldata.raw.reading import read_raw

        record = self.records[index]
        reference = read_raw(inside(self.root, record.reference))
        target = packed_frame(reference, levels=self.levels, clip=self.clip)
        sensor = reference.sensor
        header = RawHeader(reference.path, sensor.make, sensor.model, reference.exposure)
        del reference  # its pixels: a worker holds one mosaic at a time
        noisy_path = inside(self.root, record.path)
        if noisy_path.suffix == ".npy":
            return self._sample(record, _packed_noisy(noisy_path, target.shape, self.clip), target, record.ratio, None)
        noisy = read_raw(noisy_path)
        ratio = checked_ratio(record, header, noisy)
        shape = (sensor.height, sensor.width)
        if noisy.mosaic.shape != shape or noisy.sensor.cfa != sensor.cfa:
            raise DatasetError(
                f"{noisy.path}: {noisy.mosaic.shape} pixels, CFA {noisy.sensor.cfa}, but its reference "
                f"{record.reference} has {shape}, {sensor.cfa}"
            )
        applied = ratio if self.amplification == "metadata" else record.ratio
        amplified = packed_frame(noisy, levels=self.levels, clip=self.clip, gain=float(applied))
        return self._sample(record, amplified, target, applied, noisy.exposure)

    def _sample(
        self,
        record: PairRecord,
        amplified: NDArray[np.float32],
        target: NDArray[np.float32],
        ratio: Fraction,
        exposure: Exposure | None,
    ) -> Sample:
        """Return the sample; ISO and exposure time are the file's, or the manifest's where the file has none."""
        iso = record.iso if exposure is None else exposure.iso
        exposure_s = record.exposure_s if exposure is None else exposure.exposure_s
        return Sample(
            input=torch.from_numpy(amplified),
            target=torch.from_numpy(target),
            ratio=float(ratio),
            nominal_ratio=float(record.ratio),
            iso=float(iso or 0),
            exposure_s=float(exposure_s or 0),
            camera=record.camera,
            scene=record.scene,
            split=record.split,
            path=record.path,
            reference=record.reference,
            flags=";".join(record.flags),
        )

    def __repr__(self) -> str:
        def counted(values: Collection[object]) -> str:
            distinct = list(dict.fromkeys(values))
            texts = [f"{float(value):g}" if isinstance(value, Fraction) else str(value) for value in distinct]
            return ", ".join(texts) if len(texts) <= 6 else f"{len(texts)} values"

        return (
            f"{type(self).__name__}({str(self.root)!r}, {len(self)} pairs, "
            f"cameras: {counted([r.camera for r in self.records])}; "
            f"{len({(r.camera, r.scene) for r in self.records})} scenes; "
            f"splits {counted([r.split for r in self.records])}; "
            f"ISO {counted([r.iso for r in self.records])}; ratios {counted([r.ratio for r in self.records])}; "
            f"levels={self.levels!r}, clip={self.clip!r}, amplification={self.amplification!r})"
        )


def checked_ratio(record: PairRecord, reference: RawFrame | RawHeader, noisy: RawFrame | RawHeader) -> Fraction:
    """Return the exposure ratio that a pair's files state.

    Raises
    ------
    DatasetError
        If it is more than a tenth off the manifest's.
    """
    from eldata.raw.reading import exposure_ratio

    ratio = exposure_ratio(reference, noisy)
    differs = abs(ratio - record.ratio) > RATIO_TOLERANCE * record.ratio
    if differs and UNCERTAIN_ISO not in record.flags:
        raise DatasetError(
            f"{noisy.path}: expected an exposure ratio of {float(record.ratio):g} to {record.reference}, found "
            f"{float(ratio):g}; are both the frames that their names say? (eldata verify finds all such files)"
        )
    return ratio


def no_folder(folder: Path, card: Card, holds: str) -> DatasetError:
    """Return the error that a dataset's folder is not there, with what it should hold and where to get it."""
    known = card.name in shipped_names()  # the commands do not know a set of the user's own
    commands = f"; eldata info {card.name} says more, eldata download {card.name} fetches or unpacks it"
    return DatasetError(
        f"{folder}: there is no such folder; give the folder of {card.title}, which holds {holds} "
        f"(where to get it: {card.homepage}{commands if known else ''})"
    )


def _manifest(manifest: Path | str) -> Manifest:
    if isinstance(manifest, str) and "/" not in manifest and not manifest.endswith(".csv"):
        return shipped_manifest(manifest)
    return load_manifest(manifest)


def _packed_noisy(path: Path, shape: tuple[int, ...], clip: Clip) -> NDArray[np.float32]:
    """Read a packed, amplified noisy frame and clip it as raw ones are after amplification."""
    try:
        packed = np.load(path, allow_pickle=False)
    except (OSError, ValueError) as error:
        raise DatasetError(f"{path}: cannot be read as a packed array ({error})") from error
    if packed.shape != shape or packed.dtype != np.float32:
        raise DatasetError(f"{path}: expected float32 {shape} like its reference, found {packed.dtype} {packed.shape}")
    clipped: NDArray[np.float32] = np.clip(packed, *CLIP_RANGES[clip])
    return clipped
