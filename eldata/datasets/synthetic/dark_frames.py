"""Dark frames as noise: the read noise of real bias frames, for component D of a noise model.

Dark frames hold the noise that no formula describes: the fixed pattern, correlations of neighbours, banding, telegraph
pixels. Adding a whole frame adds all of it.
"""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from eldata.datasets.batches import Field, new_arrays
from eldata.datasets.calibration_frames import CalibrationFrames, choose_camera
from eldata.datasets.clean import CleanFrames
from eldata.datasets.crops import Crop, Region
from eldata.errors import ArgumentError, DatasetError, check_choice
from eldata.noise.dark_shading import DarkShading
from eldata.raw.levels import Levels, pack, packed_black_level_dn, packed_shape, packing_sites
from eldata.sources.store.read import SUFFIXES, Store
from eldata.sources.store.write import calibration_place

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from numpy.typing import NDArray

    from eldata.sources.frames import Frame

Place = Literal["same", "free"]
ShadingFrom = Literal["these", "others"]

GAIN_SPREAD = 0.01
"""K of an item lies within this share of its ISO's, uniformly, as in PMN (H. Feng et al., TPAMI 2023)."""

_BIAS = "bias"
_LEVELS_APART = 0.001  # of the range from black to white
_BLACK_APART_DN = 1.0  # between frames of one ISO: cameras measure it in each


class DarkFrames:
    """Bias frames of one camera, whose noise is added as it is: component D of :class:`~eldata.noise.NoiseModel`.

    ``D = (d - black)[crop] + U(-1/2, 1/2)`` in DN, d being a whole frame of the item's ISO; with photons, ``P*+D``. In
    :class:`~eldata.datasets.SyntheticPairs` each frame of an ISO is used once before any is used twice.

    Parameters
    ----------
    frames
        The folder of a camera's bias frames, ``<camera>/bias`` with ``ISO<iso>/...`` in it, or the camera's folder, or
        the one that holds it; a store of them (``eldata pack``), from which only crops are read; a manifest (``.csv``)
        that lists them below ``$ELDATA_ROOT`` or ``./data``; or :class:`~eldata.datasets.CalibrationFrames`.
    camera
        Which, if the folder holds several.
    isos
        Only these ISOs.
    levels
        The same as of the clean frames (:class:`~eldata.datasets.CleanFrames`), whose range from black to white must be
        the dark frames' own.
    place
        Where a crop comes from: ``"same"``, from where the clean one lies on the sensor, so that the fixed pattern
        stays where the sensor has it, for clean frames of the same camera; or ``"free"``, from anywhere, in step with
        the CFA. A crop of a dark frame is never turned: rows stay rows.
    shading
        A dark shading (:class:`~eldata.noise.DarkShading`, or its file) to take off the frames, as it is taken off the
        inputs that a network will see: ``D = (d - black - shading)[crop] + U(-1/2, 1/2)``. The fixed pattern is gone
        then, and ``place="free"`` is right for any sensor.
    shading_from
        ``"these"``: the shading is from these frames, and has a share of their noise with it; what is left is scaled by
        :meth:`1 / sqrt(1 - h) <eldata.noise.DarkShading.leverage>`, which restores the variance of the noise.
        ``"others"``: it is from other frames, and what is left stays as it is.
    dither
        Add U(-1/2, 1/2), which makes up for the rounding of the frames, and with it 1/12 DN^2 to their variance.
        ``False``: values as they are.
    keep
        Number of whole frames to keep in memory, in each process, 2 bytes a pixel; of a store, too: crops of kept
        frames are cut in memory, which takes less time than reading them.

    Raises
    ------
    DatasetError
        If there is no bias frame, or frames differ in what they have in common: CFA, size, levels of an ISO.
    FileError
        If a file or a store cannot be read.
    ArgumentError
        If a value is out of its range.

    Examples
    --------
    >>> from eldata.datasets import DarkFrames, CleanFrames, SyntheticPairs
    >>> from eldata.noise import NoiseModel
    >>> dark = DarkFrames("calibration/MyCamera/bias")  # doctest: +SKIP
    >>> pairs = SyntheticPairs(  # doctest: +SKIP
    ...     CleanFrames("clean"), "MyCamera.json", model=NoiseModel("P*+D", dark_frames=dark)
    ... )
    """

    def __init__(
        self, frames: CalibrationFrames | Path | str, camera: str | None = None, *,
        isos: Collection[float] | None = None, levels: Levels = "metadata", place: Place = "same",
        shading: DarkShading | Path | str | None = None, shading_from: ShadingFrom = "these", dither: bool = True,
        keep: int = 0,
    ) -> None:  # fmt: skip
        check_choice("place", place, get_args(Place))
        check_choice("shading_from", shading_from, get_args(ShadingFrom))
        self.place: Place = place
        self.dither = dither
        self._where, self._frames, there = _find_frames(frames, camera, levels, keep)
        for iso in () if isos is None else isos:
            _check_iso(iso, there, self._where)
        self._numbers = {iso: there[iso] for iso in sorted(there) if isos is None or iso in isos}
        if not self._numbers:
            raise ArgumentError(f"isos is empty; there are {_join_isos(there)}")
        # A file is decoded to be looked at, and may be kept; of a store nothing is read.
        look = self._frames.open_frame if self._frames.reads_parts else self._frames.frame
        self._first = {iso: look(numbers[0]).without_pixels() for iso, numbers in self._numbers.items()}
        for iso, numbers in self._numbers.items():
            self._check(self._first[iso], iso)
            for number in numbers if self._frames.reads_parts else ():  # files are checked when they are decoded
                self._check(look(number), iso)
        self.shading = None if shading is None else DarkShading.of(shading)
        self._scale = self._find_scales(shading_from)

    def _find_scales(self, shading_from: ShadingFrom) -> dict[float, float]:
        """Find the factor of a frame less its shading, by ISO; refuse a shading of another sensor."""
        if self.shading is None:
            return {}
        scales = {}
        for iso, first in self._first.items():
            model = "" if first.sensor is None else first.sensor.model
            self.shading.check_sensor(first.name, first.shape, first.cfa, model)
            share = self.shading.leverage(iso)
            if shading_from == "these" and not share < 1:
                raise ArgumentError(f"ISO {iso:g}: one frame alone makes the dark shading; nothing of it is left")
            scales[iso] = (1 - share) ** -0.5 if shading_from == "these" else 1.0
        return scales

    @property
    def isos(self) -> tuple[float, ...]:
        """ISOs that there are frames of, ascending."""
        return tuple(self._numbers)

    def names(self, iso: float) -> tuple[str, ...]:
        """List the files, or places in the store, of the frames of an ISO.

        Raises
        ------
        ArgumentError
            If there are none.
        """
        _check_iso(iso, self._numbers, self._where)
        return tuple(self._frames.names[number] for number in self._numbers[iso])

    def draw(
        self, iso: float, count: int, shape: tuple[int, int, int], generator: np.random.Generator
    ) -> NDArray[np.float32]:
        """Draw crops (count, C, h, w) of frames of an ISO, from one place at random, in DN above black.

        They are of different frames as long as there are enough. This is for models that are called by themselves,
        which do not know where on the sensor the clean data lies.

        Raises
        ------
        ArgumentError
            If there are no frames of this ISO, or the shape does not fit them.
        FileError, DatasetError
            As :meth:`crops` does.
        """
        there = len(self.names(iso))
        rounds = -(-count // there)
        members = np.concatenate([generator.permutation(there) for _ in range(rounds)])[:count]
        return self.crops(iso, members.tolist(), self._anywhere(iso, shape, generator))

    def region(self, iso: float, frame: Frame, crop: Crop, generator: np.random.Generator) -> Region:
        """Choose the part of the packed dark frames whose noise a clean crop gets.

        Raises
        ------
        DatasetError
            If clean and dark frames do not go together: another kind of CFA, another range from black to white, or,
            where the place is to be the same, another size or phase.
        """
        dark, shape = self._first[iso], crop.packed_shape
        sites = packing_sites(dark.cfa)
        clean = packing_sites(frame.cfa).name if frame.cfa else "RGB"
        if clean != sites.name:
            raise DatasetError(f"{frame.name}: is {clean}, but the dark frames are {sites.name}, such as {dark.name}")
        if abs(frame.range_dn - dark.range_dn) > _LEVELS_APART * dark.range_dn:
            raise DatasetError(
                f"{frame.name}: has {frame.range_dn:g} DN from black to white, but the dark frames have "
                f"{dark.range_dn:g}, such as {dark.name}; take frames of one camera, with the same levels= "
                '("metadata" or "published")'
            )
        if self.place == "free":
            return self._anywhere(iso, shape, generator)
        if (frame.shape, frame.cfa) != (dark.shape, dark.cfa):
            raise DatasetError(
                f"{frame.name}: has {frame.kind}, but the dark frames have {dark.kind}, such as {dark.name}; their "
                'fixed pattern belongs to that sensor. DarkFrames(..., place="free") takes dark crops from anywhere'
            )
        return *crop.place(frame, "dark frames are"), shape[1], shape[2]

    def crops(self, iso: float, members: Sequence[int], region: Region) -> NDArray[np.float32]:
        """Read one part of some frames of an ISO, by their number, in DN above black and the shading.

        Raises
        ------
        DatasetError
            If a frame is unlike the others.
        FileError
            If it cannot be read.
        """
        shape = (len(members), packing_sites(self._first[iso].cfa).channels, *region[2:])
        dark: NDArray[np.float32] = new_arrays([Field("dark", shape, "<f4")])["dark"]
        crop = Crop.region(self._first[iso], region)
        shading = None if self.shading is None else pack(self.shading.at(iso, *crop.slices), crop.cfa)
        for place, member in enumerate(members):
            frame = self._frames.frame(self._numbers[iso][member])
            self._check(frame, iso)
            black = packed_black_level_dn(crop.cfa, frame.black_level_dn)
            np.subtract(pack(crop.cut(frame), crop.cfa), black[:, None, None], out=dark[place], dtype=np.float32)
        if shading is not None:
            dark -= shading
            dark *= np.float32(self._scale[iso])
        return dark

    def _anywhere(self, iso: float, shape: tuple[int, int, int], generator: np.random.Generator) -> Region:
        """Draw a place for packed crops (C, h, w), in step with the CFA."""
        dark = self._first[iso]
        whole, step = packed_shape(dark.shape, dark.cfa), packing_sites(dark.cfa).sub
        _, height, width = shape
        if shape[0] != whole[0] or height > whole[1] or width > whole[2] or height % step or width % step:
            raise ArgumentError(f"dark frames give crops of {whole} packed pixels or less, and none of {shape}")
        top, left = (
            step * int(generator.integers((most - side) // step + 1))
            for most, side in zip(whole[1:], shape[1:], strict=True)
        )
        return top, left, height, width

    def _check(self, frame: Frame, iso: float) -> None:
        """Refuse a frame that is unlike the first of all, or of its ISO, or whose pixels are no whole DN."""
        if frame.mosaic.dtype.kind == "f":
            raise DatasetError(
                f"{frame.name}: its pixels are no whole DN; use the dark frames as the camera wrote them"
            )
        first = next(iter(self._first.values()))
        if (frame.shape, frame.cfa) != (first.shape, first.cfa):
            raise DatasetError(
                f"{frame.name}: has {frame.kind}, but {first.name} has {first.kind}; dark frames are of one camera"
            )
        first, stated = self._first[iso], frame.exposure.iso
        if stated is not None and float(stated) != iso:
            raise DatasetError(f"{frame.name}: was taken at ISO {float(stated):g}, but lies among those of ISO {iso:g}")
        apart = np.abs(np.subtract(frame.black_level_dn, first.black_level_dn)).max()
        if frame.white_level_dn != first.white_level_dn or apart > _BLACK_APART_DN:
            raise DatasetError(
                f"{frame.name}: has black level {frame.black_level_dn} and white level {frame.white_level_dn:g} DN, "
                f"but {first.name} has {first.black_level_dn} and {first.white_level_dn:g}; dark frames of one ISO "
                "have the same levels"
            )

    def __repr__(self) -> str:
        counts = ", ".join(f"ISO {iso:g}: {len(numbers)}" for iso, numbers in self._numbers.items())
        shading = "" if self.shading is None else f", shading={self.shading.digest[:15]}"
        return f"DarkFrames({self._where!r}, {counts}; place={self.place!r}, dither={self.dither}{shading})"


def _check_iso(iso: float, known: Collection[float], where: str) -> None:
    """Refuse an ISO that has no dark frames."""
    if iso not in known:
        raise ArgumentError(f"{where}: there are no dark frames of ISO {iso:g}; there are {_join_isos(known)}")


def _find_frames(
    frames: CalibrationFrames | Path | str, camera: str | None, levels: Levels, keep: int
) -> tuple[str, CleanFrames, dict[float, list[int]]]:
    """Find bias frames: what messages call them, the frames, and their numbers by ISO."""
    if isinstance(frames, (str, Path)) and Path(frames).suffix.lower() in SUFFIXES:
        source = Store(frames)
        paths: dict[str, dict[str, Fraction]] = {}
        for frame in source.frames:
            owner, role, stated_iso = calibration_place(frame.path) or ("", "", 0)
            if role == _BIAS:
                paths.setdefault(owner or source.dataset, {})[frame.path] = Fraction(stated_iso)
        if not paths:
            raise DatasetError(
                f"{source.path}: holds no bias frames; eldata pack makes such a store of the folder that holds "
                "bias/ISO<iso>/... of a camera"
            )
        where, isos = str(frames), paths[choose_camera(camera, paths, str(source.path))]
        names = [f"{source.path.as_posix()}/{path}" for path in isos]
        files = CleanFrames(source, names=names, levels=levels, keep=keep)
    else:
        if isinstance(frames, (str, Path)):
            folder = Path(frames).parent if Path(frames).name == _BIAS else Path(frames)
            is_manifest = folder.suffix.lower() == ".csv"
            frames = (
                CalibrationFrames(camera=camera, manifest=frames) if is_manifest else CalibrationFrames(folder, camera)
            )
        records = [record for record in frames.records if record.role == _BIAS and record.iso is not None]
        if not records:
            raise DatasetError(f"{frames.root}: holds no bias frames of {frames.camera}")
        where, isos = str(frames.root), {record.path: Fraction(record.iso or 0) for record in records}
        files = CleanFrames([frames.file(record) for record in records], levels=levels, keep=keep)
    numbers: dict[float, list[int]] = {}
    for number, iso in enumerate(isos.values()):
        numbers.setdefault(float(iso), []).append(number)
    return where, files, numbers


def _join_isos(isos: Collection[float]) -> str:
    """Join ISOs in a text, ascending."""
    return ", ".join(f"{iso:g}" for iso in sorted(isos))
