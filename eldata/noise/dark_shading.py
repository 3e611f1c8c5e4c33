"""Dark shading: what a sensor shows of itself in the dark, the same in every frame, as a line over ISO in each pixel.

``DS(ISO) = k ISO + b + BLE[ISO]`` in DN over the recorded black level, after PMN [1]_: slope k and offset b of each
pixel, and a black level error of each CFA channel at each ISO. Where a camera switches its conversion gain, each mode
has a k and a b of its own.

The file
--------
An .npz archive, not compressed, that numpy reads: ``slope_dn`` and ``offset_dn``, float32 (modes, H, W); ``hot``,
boolean (H, W); and ``about``, the bytes of a JSON object with the rest, and the digest of it all.

References
----------
.. [1] H. Feng, L. Wang, Y. Wang, H. Fan and H. Huang, "Learnability Enhancement for Low-light Raw Image Denoising: A
   Data Perspective", IEEE Transactions on Pattern Analysis and Machine Intelligence, 2023.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.base.files import atomic_write, json_text
from eldata.base.visible import shown
from eldata.errors import ArgumentError, DatasetError, ShadingError
from eldata.noise.shading_content import (
    ADVICE,
    FIELDS,
    SCHEMA,
    SCHEMA_WITH_MODEL,
    ShadingIso,
    read_content,
)
from eldata.raw.levels import cfa_from, pack, packed_area, packed_channels, packed_shape, packing_sites

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from eldata.raw.levels import CfaRows


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class DarkShading:
    """The dark shading of one camera body.

    Attributes
    ----------
    camera, source
        The camera's name, and where the figures come from.
    cfa
        The CFA of pixel (0, 0).
    isos
        The measured ISOs, ascending.
    slope_dn, offset_dn
        k [DN per unit of ISO] and b [DN], (modes, H, W) float32. Where a mode has one ISO alone, k is 0.
    hot
        (H, W) True where a pixel is hot, cold or stuck at one of the ISOs: its k and b are those of its neighbours of
        the same colour, so that it stays as it is when the shading is subtracted.
    notes
        What a user should know, such as which ISOs were left out.
    model
        The camera's model, as the bias frames state it; empty: none was stated.
    digest
        ``sha256:<hex>`` of all of these.

    Raises
    ------
    ArgumentError
        If they do not go together.
    """

    camera: str
    source: str
    cfa: CfaRows
    isos: tuple[ShadingIso, ...]
    slope_dn: NDArray[np.float32] = field(repr=False)
    offset_dn: NDArray[np.float32] = field(repr=False)
    hot: NDArray[np.bool_] = field(repr=False)
    notes: tuple[str, ...] = ()
    model: str = ""
    digest: str = field(init=False)

    def __post_init__(self) -> None:
        speeds, modes = [one.iso for one in self.isos], [one.mode for one in self.isos]
        if not speeds or speeds != sorted(set(speeds)):
            raise ArgumentError(f"a dark shading has one ISO or more, each once, ascending; found {speeds}")
        if modes != sorted(modes) or sorted(set(modes)) != list(range(len(self.slope_dn))):
            raise ArgumentError(f"{len(self.slope_dn)} gain modes are numbered from 0, ascending; found {modes}")
        packed_channels(self.cfa)
        channels = max(map(max, self.cfa)) + 1
        for one in self.isos:
            if {len(one.level_error_dn), len(one.standard_error_dn)} != {channels}:
                raise ArgumentError(f"ISO {one.iso:g}: expected {channels} levels, one per CFA channel")
        if self.hot.dtype != np.bool_ or self.hot.ndim != 2:
            raise ArgumentError(f"hot is boolean (H, W); found {self.hot.dtype} {self.hot.shape}")
        expected = (len(self.slope_dn), *self.hot.shape)
        for name in FIELDS:
            values: NDArray[np.float32] = getattr(self, name)
            if values.dtype != np.float32 or values.shape != expected:
                raise ArgumentError(f"{name} is float32 {expected}; found {values.dtype} {values.shape}")
            if not all(np.isfinite(row).all() for row in _rows(values)):
                raise ArgumentError(f"{name} holds values that are not finite")
        object.__setattr__(self, "digest", self._digest())

    def _digest(self) -> str:
        found = hashlib.sha256(json_text(self._about(), indent=None).encode())
        for values in (self.slope_dn, self.offset_dn, self.hot):
            for row in _rows(values):
                found.update(row.astype(row.dtype.newbyteorder("<"), copy=False).tobytes())
        return f"sha256:{found.hexdigest()}"

    def _about(self) -> dict[str, Any]:
        modes, height, width = self.slope_dn.shape
        return {
            "schema": SCHEMA_WITH_MODEL if self.model else SCHEMA,
            "camera": self.camera,
            **({"model": self.model} if self.model else {}),
            "source": self.source,
            "cfa": [list(row) for row in self.cfa],
            "modes": modes,
            "height": height,
            "width": width,
            "isos": [asdict(one) for one in self.isos],
            "notes": list(self.notes),
        }

    def summary(self) -> dict[str, Any]:
        """Return what a person asks first, as plain types: all but the pixels."""
        return {
            "digest": self.digest,
            "isos": [asdict(one) | {"error_dn": self.error_dn(one.iso)} for one in self.isos],
            "modes": len(self.slope_dn),
            "hot": int(self.hot.sum()),
            "notes": list(self.notes),
        }

    # --- what it says ---------------------------------------------------------------------------------------------

    def measured(self, iso: float) -> ShadingIso:
        """Return what was measured at an ISO.

        Raises
        ------
        ArgumentError
            If nothing was: the black level error of an ISO follows from no other ISO's.
        """
        for one in self.isos:
            if one.iso == iso:
                return one
        listed = ", ".join(f"{one.iso:g}" for one in self.isos)
        raise ArgumentError(
            f"the dark shading of {self.camera} was not measured at ISO {iso:g}, and no other ISO tells its black "
            f"level error; there are {listed}. Take bias frames at ISO {iso:g} and calibrate again"
        )

    def at(
        self,
        iso: float,
        rows: slice = slice(None),
        columns: slice = slice(None),
        *,
        out: NDArray[np.float32] | None = None,
    ) -> NDArray[np.float32]:
        """Return the shading of a part of the mosaic, (h, w) float32, in DN over the recorded black level.

        Parameters
        ----------
        iso
            One of the measured ISOs.
        rows, columns
            Which part; the whole by default. Steps are not for mosaics.
        out
            Where to write it, (h, w) float32; by default into new memory.

        Raises
        ------
        ArgumentError
            If the ISO was not measured.

        Examples
        --------
        >>> shading = DarkShading.load("mycamera.npz")  # doctest: +SKIP
        >>> corrected = frame.mosaic - shading.at(float(frame.exposure.iso))  # doctest: +SKIP
        """
        from eldata.noise._kernels import fill_line

        one = self.measured(iso)
        slope, offset = (values[one.mode, rows, columns] for values in (self.slope_dn, self.offset_dn))
        top, left = (part.indices(side)[0] for part, side in zip((rows, columns), self.hot.shape, strict=True))
        period, part = len(self.cfa), np.empty(slope.shape, np.float32) if out is None else out
        down, right = top + np.arange(period), left + np.arange(slope.shape[1])
        channels = np.asarray(self.cfa)[down[:, None] % period, right % period]
        fill_line(slope, offset, np.float32(iso), np.asarray(one.level_error_dn, np.float32)[channels], part)
        return part

    def packed(self, iso: float, region: tuple[int, int, int, int] | None = None) -> NDArray[np.float32]:
        """Return the shading of a part of packed data, (C, h, w) float32, in DN over the recorded black level.

        Parameters
        ----------
        iso
            One of the measured ISOs.
        region
            (top, left, height, width) in packed pixels, even for X-Trans; by default all that packing keeps.

        Raises
        ------
        ArgumentError
            As :meth:`at` does; or if the region is not within the sensor or odd for X-Trans.
        """
        area, sites = packed_area(self.hot.shape, self.cfa), packing_sites(self.cfa)
        whole = packed_shape(self.hot.shape, self.cfa)[1:]
        top, left, height, width = region or (0, 0, *whole)
        within = min(top, left) >= 0 and top + height <= whole[0] and left + width <= whole[1]
        if not within or any(side % sites.sub for side in (top, left, height, width)):
            raise ArgumentError(
                f"region {(top, left, height, width)} is not within the {whole[0]} x {whole[1]} packed pixels of the "
                f"dark shading of {self.camera}" + (", or not even, as X-Trans needs it" if sites.sub > 1 else "")
            )
        rows, columns = (
            slice(start + scale * first, start + scale * (first + side))
            for start, first, side in ((area.top, top, height), (area.left, left, width))
            for scale in (sites.scale,)
        )
        return pack(self.at(iso, rows, columns), cfa_from(self.cfa, area.top, area.left))

    def check_sensor(self, name: str, shape: tuple[int, int], cfa: CfaRows, model: str = "") -> None:
        """Refuse a frame of another sensor.

        Parameters
        ----------
        name
            What messages call the frame.
        shape, cfa
            Its size and CFA.
        model
            The camera's model, as its file states it. Another body of this model cannot be told.

        Raises
        ------
        DatasetError
            If it is of another model, size or CFA.
        """
        if self.model and model and model.casefold() != self.model.casefold():
            raise DatasetError(
                f"{name}: is of a {model}, but the dark shading of {self.camera} is of a {self.model}; it belongs to "
                "one body"
            )
        height, width = self.hot.shape
        if shape != (height, width) or cfa != self.cfa:
            raise DatasetError(
                f"{name}: has {shape[0]} x {shape[1]} pixels of {f'the CFA {cfa}' if cfa else 'RGB'}, but the dark "
                f"shading of {self.camera} is of {height} x {width} pixels, or another CFA, {self.cfa}; it belongs to "
                "one body and one raw format"
            )

    def error_dn(self, iso: float) -> float:
        """Return the standard error that noise leaves in a pixel of the shading at an ISO, DN.

        Raises
        ------
        ArgumentError
            If the ISO was not measured.
        """
        one = self.measured(iso)
        mode = [other for other in self.isos if other.mode == one.mode]
        weights, speeds = np.array([other.weight for other in mode]), np.array([other.iso for other in mode])
        middle = float(weights @ speeds / weights.sum())
        lever = float(weights @ (speeds - middle) ** 2)
        return math.sqrt(1 / weights.sum() + ((iso - middle) ** 2 / lever if len(mode) > 1 else 0.0))

    def leverage(self, iso: float) -> float:
        """Return h, the share that a bias frame of an ISO has in the shading there, of the frames that it is from.

        Subtracted from such a frame, the shading takes a share of its noise with it: the variance of what is left is
        ``1 - h`` of the frame's own, and ``1 / sqrt(1 - h)`` puts it back. A frame that the shading is not from has
        ``1 + h`` instead.

        Raises
        ------
        ArgumentError
            If the ISO was not measured.
        """
        return (self.error_dn(iso) / self.measured(iso).sigma_dn) ** 2

    # --- the file -------------------------------------------------------------------------------------------------

    def save(self, path: Path | str) -> None:
        """Write the .npz file, whole or not at all.

        Raises
        ------
        EldataError
            If the operating system refuses.
        """
        about = json_text(self._about() | {"digest": self.digest}, indent=None).encode()
        with atomic_write(path) as file:
            np.savez(
                file,
                allow_pickle=False,
                about=np.frombuffer(about, np.uint8),
                slope_dn=self.slope_dn.astype("<f4", copy=False),
                offset_dn=self.offset_dn.astype("<f4", copy=False),
                hot=self.hot,
            )

    @classmethod
    def of(cls, given: DarkShading | Path | str) -> DarkShading:
        """Return a dark shading that was given itself, or as its file.

        Raises
        ------
        ArgumentError
            If it is neither.
        ShadingError
            As :meth:`load` does.
        """
        if isinstance(given, cls):
            return given
        if isinstance(given, (str, Path)):
            return cls.load(given)
        raise ArgumentError(f"expected a DarkShading or the path of its file; found {given!r:.100}")

    @classmethod
    def load(cls, path: Path | str) -> DarkShading:
        """Read a file that :meth:`save` wrote.

        What it declares is checked before anything is loaded, and it holds as many bytes as it declares.

        Raises
        ------
        ShadingError
            If it cannot be read, is damaged, or is not the file of a dark shading.
        """
        content, stated = read_content(Path(path))
        try:
            found = cls(**content)
        except ArgumentError as error:
            raise ShadingError(path, f"{error}; {ADVICE}") from error
        if stated != found.digest:
            raise ShadingError(
                path, f"field digest: expected {found.digest}, that of the content, found {shown(stated)}; {ADVICE}"
            )
        return found


def dark_shading_in(path: Path) -> DarkShading:
    """Return the dark shading of a file, which a process reads once as long as it stays what it is.

    Raises
    ------
    ShadingError
        If it cannot be read.
    """
    try:
        status = path.stat()
    except OSError as error:
        raise ShadingError(path, f"cannot be read: {error.strerror or error}") from error
    return _loaded(path, status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=1)
def _loaded(path: Path, *_: int) -> DarkShading:
    return DarkShading.load(path)


def _rows(values: NDArray[Any]) -> NDArray[Any]:
    """Return an array as its rows: what is done to one at a time takes no memory."""
    return values.reshape(-1, values.shape[-1])
