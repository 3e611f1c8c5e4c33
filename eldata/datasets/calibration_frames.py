"""Bias and flat-field frames of one camera, by ISO, from a manifest or from folders."""

from __future__ import annotations

import math
import re
from collections import defaultdict
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, TypedDict

from eldata.base.files import folder_problem, inside, visible_below
from eldata.base.numbers import checked_index, counted
from eldata.base.tables import block, frame_of, table
from eldata.base.visible import in_line
from eldata.errors import ArgumentError, DatasetError, did_you_mean
from eldata.manifest.catalogue import FrameFiles, data_root, find_manifest
from eldata.manifest.pairs import WARM_SENSOR, as_values
from eldata.manifest.patterns import expand
from eldata.raw.files import RAW_EXTENSIONS, is_raw, of_arrays
from eldata.records import FrameRecord, RawFrame, RawHeader, Role

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

    import numpy as np
    import pandas as pd
    from numpy.typing import NDArray

    from eldata.plots.axes import Drawing
    from eldata.raw.stated import StatedFile

_ROLES: tuple[Role, ...] = ("bias", "flat")
_FOLDER = "calibration"
_ISO_FOLDER = re.compile(r"ISO([1-9][0-9]{0,8})")


class CalibrationSample(TypedDict):
    """One frame as :class:`CalibrationFrames` gives it; the default collate of torch takes it."""

    mosaic: NDArray[np.uint16]
    role: str
    camera: str
    iso: float
    exposure_s: float
    path: str


@dataclass(frozen=True, slots=True)
class FlatPair:
    """Two flats of one ISO and exposure, taken one after the other."""

    first: FrameRecord
    second: FrameRecord


class CalibrationFrames:
    """Bias and flat-field frames of one camera.

    Nothing is decoded before it is asked for, and one frame at a time: the memory does not depend on their number.

    Parameters
    ----------
    root
        The folder that holds ``<camera>/{bias,flat}/ISO<iso>/...``, or the camera's own folder, with ``bias`` and
        ``flat`` in it. Default: ``calibration`` below ``$ELDATA_ROOT``, else below ``./data``. With a manifest, the
        folder that its paths start from; default the manifest's own below the data root.
    camera
        The camera's name; may be left out if there is one alone.
    manifest
        A manifest's CSV file, or the name of a known set, whose rows of role ``bias`` and ``flat`` are taken in place
        of what the folders hold; not those with the flag ``warm-sensor``, which are a series of their own: give
        their folder.
    isos
        Only these ISOs.

    Attributes
    ----------
    records
        One :class:`~eldata.records.FrameRecord` per frame, sorted by path: bias and flat frames of the chosen ISOs.
        From folders, the ISO is the folder's and the exposure time not known; :meth:`read` has what the file says.
    skipped
        Files in the folders that are not raw files, such as the JPEG beside a raw file.

    Raises
    ------
    DatasetError
        If there is no such folder, camera or ISO, or a frame lies where no ISO is named; the message lists what there
        is.

    Examples
    --------
    >>> from eldata import CalibrationFrames
    >>> frames = CalibrationFrames("eldata-calibration/data/calibration", "DemoGamma")
    >>> frames.isos
    (Fraction(100, 1), Fraction(400, 1), Fraction(1600, 1), Fraction(6400, 1))
    """

    def __init__(
        self,
        root: Path | str | None = None,
        camera: str | None = None,
        *,
        manifest: Path | str | None = None,
        isos: Collection[int] | None = None,
    ) -> None:
        self.skipped: tuple[str, ...] = ()
        if manifest is not None:
            loaded = find_manifest(manifest)
            self.root = loaded.own_folder(root)
            records = tuple(
                record
                for record in expand(loaded.records, self.root)
                if record.role in _ROLES and WARM_SENSOR not in record.flags
            )
            self.camera = choose_camera(camera, {record.camera for record in records}, str(loaded.path))
            self._files = FrameFiles.of(self.root, loaded.card, records)
            records = tuple(record for record in records if record.camera == self.camera)
            for record in records:
                if record.iso is None:
                    raise DatasetError(f"{loaded.path}, {record.path}: a calibration frame's row needs its ISO")
        else:
            self.root = data_root() / _FOLDER if root is None else Path(root)
            self._files = FrameFiles(self.root)
            self.camera, records, self.skipped = _find_in_folders(self.root, camera)
        self.records = _keep_isos(records, as_values(isos))

    @property
    def isos(self) -> tuple[Fraction, ...]:
        """The ISOs, ascending."""
        return tuple(sorted({record.iso for record in self.records if record.iso is not None}))

    def of(self, role: Role, iso: Fraction | int) -> tuple[FrameRecord, ...]:
        """Return the records of one role and ISO, sorted by path."""
        return tuple(record for record in self.records if record.role == role and record.iso == iso)

    def path(self, record: FrameRecord) -> Path:
        """Return the path of a frame's file.

        Raises
        ------
        ManifestError
            If the path leads outside of the root.
        """
        return inside(self.root, record.path)

    def file(self, record: FrameRecord) -> Path | StatedFile:
        """Return a frame's file, of a mosaic with what its card states; raises like :meth:`path`."""
        return self._files.at(record.path)

    def header(self, record: FrameRecord) -> RawHeader:
        """Read the header of one frame's file; raises like :meth:`read`."""
        from eldata.raw.reading import read_header

        return read_header(self.file(record))

    def read(self, record: FrameRecord) -> RawFrame:
        """Decode one frame.

        Raises
        ------
        RawFileError
            If the file is missing, damaged or not a raw mosaic, or holds fractions of a DN.
        """
        from eldata.raw.reading import read_raw

        frame = read_raw(self.file(record))
        frame.whole_dn("calibration")
        return frame

    @property
    def frame(self) -> pd.DataFrame:
        """The records as a pandas DataFrame, one row per frame, numbers as floats."""
        return frame_of(self.records)

    def __len__(self) -> int:
        return len(self.records)

    def __iter__(self) -> Iterator[CalibrationSample]:
        return (self[index] for index in range(len(self)))

    def __getitem__(self, index: int) -> CalibrationSample:
        """Decode one frame: its mosaic in DN, black level not subtracted; nan for an ISO or time that is not stated."""
        record = self.records[checked_index(index, len(self))]
        frame = self.read(record)
        return CalibrationSample(
            mosaic=frame.mosaic,
            role=record.role,
            camera=record.camera,
            iso=float(frame.exposure.iso or math.nan),
            exposure_s=float(frame.exposure.exposure_s or math.nan),
            path=record.path,
        )

    def plot(self, index: int = 0) -> Drawing:
        """Draw a frame: its mosaic in DN, with the scale of all but the furthest values.

        Returns
        -------
        matplotlib.figure.Figure
            It belongs to no pyplot, and a notebook shows it.

        Raises
        ------
        RawFileError
            If the file is missing, damaged or not a raw mosaic.
        """
        from eldata.plots.pictures import side_by_side

        sample = self[index]
        facts = [f"{sample['camera']}, {sample['role']}", f"ISO {sample['iso']:g}"]
        facts += [f"{sample['exposure_s']:g} s"] if sample["exposure_s"] > 0 else []
        return side_by_side(f"{', '.join(facts)}\n{sample['path']}", [("mosaic [DN]", sample["mosaic"])])

    def _repr_html_(self) -> str:
        """Render the numbers of frames by ISO as a table for notebooks."""
        rows = [
            tuple(str(count) for count in (f"{float(iso):g}", len(self.of("bias", iso)), len(self.of("flat", iso))))
            for iso in self.isos
        ]
        skipped = [f"{counted(len(self.skipped), 'other file')} skipped"] if self.skipped else []
        heading = f"CalibrationFrames of {self.camera}: {counted(len(self), 'frame')} in {self.root}"
        return block(heading, table(("ISO", "bias", "flat"), rows, left=()), notes=skipped)

    def __repr__(self) -> str:
        counts = ", ".join(
            f"ISO {float(iso):g}: {len(self.of('bias', iso))} bias, {len(self.of('flat', iso))} flat"
            for iso in self.isos
        )
        return f"CalibrationFrames({str(self.root)!r}, {self.camera!r}, {len(self)} frames; {counts})"


def flat_pairs(flats: Collection[FrameRecord]) -> tuple[tuple[FlatPair, ...], tuple[FrameRecord, ...]]:
    """Return pairs of equal flats, and the flats that have no partner.

    Flats of the same exposure time are paired in the order of their paths, which cameras number by time: the first with
    the second, the third with the fourth.

    Parameters
    ----------
    flats
        Of one ISO, with their exposure times.
    """
    by_exposure: dict[Fraction | None, list[FrameRecord]] = defaultdict(list)
    for record in sorted(flats, key=lambda record: record.path):
        by_exposure[record.exposure_s].append(record)
    pairs, single = [], []
    for exposure, same in by_exposure.items():
        count = len(same) // 2 * 2 if exposure is not None else 0
        pairs += [FlatPair(*same[index : index + 2]) for index in range(0, count, 2)]
        single += same[count:]
    return tuple(sorted(pairs, key=lambda pair: pair.first.path)), tuple(single)


# --- finding --------------------------------------------------------------------------------------------------


def choose_camera(wanted: str | None, found: Collection[str], where: str) -> str:
    """Return the camera that is wanted, or the only one of those found; raises a DatasetError that lists them."""
    listed = ", ".join(sorted(found))
    if not found:
        raise DatasetError(f"{where}: holds no calibration frames (rows of role bias or flat)")
    if wanted is None:
        if len(found) > 1:
            raise DatasetError(f"{where}: holds frames of {len(found)} cameras; choose one: {listed}")
        return next(iter(found))
    if wanted not in found:
        raise DatasetError(f"{where}: has no camera {wanted!r}; there is {listed}{did_you_mean(wanted, found)}")
    return wanted


def _find_in_folders(root: Path, camera: str | None) -> tuple[str, tuple[FrameRecord, ...], tuple[str, ...]]:
    """Find the camera, its frames by role and ISO folder, and other files, which are skipped."""
    layout = "<camera>/bias/ISO100/..., <camera>/flat/ISO100/..., one folder per ISO"
    problem = folder_problem(root)
    if problem is not None:
        raise DatasetError(f"{root}: {problem}; calibration frames lie in {layout}")
    if any((root / role).is_dir() for role in _ROLES):  # the camera's own folder
        name, prefix = camera or root.resolve().name, ""
    else:
        places = visible_below(root, deep=False)
        cameras = [path.name for path in places if any((path / role).is_dir() for role in _ROLES)]
        if not cameras:
            raise DatasetError(f"{root}: holds no folder bias or flat, nor a camera's with them; expected {layout}")
        name = choose_camera(camera, cameras, str(root))
        prefix = f"{name}/"
    records: list[FrameRecord] = []
    skipped: list[str] = []
    for role in _ROLES:
        folder = root / prefix / role
        for path in visible_below(folder):
            relative, parts = path.relative_to(root).as_posix(), path.relative_to(folder).parts
            is_folder, is_link = path.is_dir(), path.is_symlink()
            if is_folder and not is_link:
                continue
            if is_folder:  # which the search does not follow: its frames would be missing without a word
                raise DatasetError(f"{path}: is a link to a folder; move the frames themselves there")
            if not is_raw(path):
                skipped.append(relative)
                continue
            named = _ISO_FOLDER.fullmatch(parts[0])
            if named is None or len(parts) == 1:
                raise DatasetError(
                    f"{path}: lies in no folder that names its ISO; expected {folder}/ISO100/{path.name} or the like"
                )
            records.append(FrameRecord(path=relative, role=role, camera=name, iso=Fraction(named[1])))
    if not records:
        others = f", but {len(skipped)} other file(s) such as {in_line(skipped[0])}" if skipped else ""
        others += next(filter(None, (of_arrays(Path(name).suffix) for name in skipped)), "")
        raise DatasetError(
            f"{root / prefix}: holds no raw file ({', '.join(sorted(RAW_EXTENSIONS))}) in {layout}{others}"
        )
    return name, tuple(sorted(records, key=lambda record: record.path)), tuple(skipped)


def _keep_isos(records: tuple[FrameRecord, ...], isos: Collection[int] | None) -> tuple[FrameRecord, ...]:
    """Keep the records of some ISOs; refuse an ISO without records."""
    if isos is None:
        return records
    known = sorted({record.iso for record in records if record.iso is not None})
    listed = ", ".join(f"{float(iso):g}" for iso in known)
    if not isos:
        raise ArgumentError(f"isos is empty; there are {listed}")
    for iso in isos:
        if iso not in known:
            raise DatasetError(f"no frames of ISO {iso}; there are {listed}")
    return tuple(record for record in records if record.iso in isos)
