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

from eldata.base.arrays import Declared, read_array
from eldata.base.fields import Fields, TextFile, names_of
from eldata.base.files import atomic_write, json_text
from eldata.base.visible import shown
from eldata.errors import ArgumentError, DatasetError, ShadingError
from eldata.raw.levels import CfaRows, packed_channels

if TYPE_CHECKING:
    from numpy.typing import NDArray


_SCHEMA, _SCHEMA_WITH_MODEL = 1, 2
_FIELDS = ("slope_dn", "offset_dn")
_ADVICE = "write it again with eldata calibrate --dark-shading"
_MOST_ABOUT_BYTES = 1 << 20
_LONGEST_SIDE = 65_535
_MOST_MODES = 16


@dataclass(frozen=True, slots=True, kw_only=True)
class ShadingIso:
    """What one ISO gave to a dark shading.

    Attributes
    ----------
    iso
        ISO speed.
    mode
        The number of its gain mode, from 0: whose slope and offset hold.
    frames
        Bias frames.
    sigma_dn
        Standard deviation of a pixel over time, DN.
    level_error_dn
        BLE: by how much the mean of each CFA channel lies over the line, DN.
    standard_error_dn
        Of the level, by the scatter between frames, DN.
    """

    iso: float
    mode: int
    frames: int
    sigma_dn: float
    level_error_dn: tuple[float, ...]
    standard_error_dn: tuple[float, ...]

    def __post_init__(self) -> None:
        for name in ("iso", "sigma_dn"):  # as a file gives them back: they are in the digest
            object.__setattr__(self, name, float(getattr(self, name)))
        for name in ("level_error_dn", "standard_error_dn"):
            object.__setattr__(self, name, tuple(map(float, getattr(self, name))))

    @property
    def weight(self) -> float:
        """Weight of its mean frame in the fit, 1 / DN^2: one over the variance that noise leaves in it."""
        return self.frames / self.sigma_dn**2


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
        (H, W) True where a pixel is hot, cold or stuck at one of the ISOs: its k and b come from its neighbours of
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
        isos, modes = [row.iso for row in self.isos], [row.mode for row in self.isos]
        if not isos or isos != sorted(set(isos)):
            raise ArgumentError(f"a dark shading has one ISO or more, each once, ascending; found {isos}")
        if modes != sorted(modes) or sorted(set(modes)) != list(range(len(self.slope_dn))):
            raise ArgumentError(f"{len(self.slope_dn)} gain modes are numbered from 0, ascending; found {modes}")
        packed_channels(self.cfa)
        channels = max(map(max, self.cfa)) + 1
        for row in self.isos:
            if {len(row.level_error_dn), len(row.standard_error_dn)} != {channels}:
                raise ArgumentError(f"ISO {row.iso:g}: expected {channels} levels, one per CFA channel")
        if self.hot.dtype != np.bool_ or self.hot.ndim != 2:
            raise ArgumentError(f"hot is boolean (H, W); found {self.hot.dtype} {self.hot.shape}")
        expected = (len(self.slope_dn), *self.hot.shape)
        for name in _FIELDS:
            values: NDArray[np.float32] = getattr(self, name)
            if values.dtype != np.float32 or values.shape != expected:
                raise ArgumentError(f"{name} is float32 {expected}; found {values.dtype} {values.shape}")
            if not all(np.isfinite(row).all() for row in _flatten_rows(values)):
                raise ArgumentError(f"{name} holds values that are not finite")
        object.__setattr__(self, "digest", self._compute_digest())

    def _compute_digest(self) -> str:
        """Compute ``sha256:<hex>`` of all facts and pixels."""
        digest = hashlib.sha256(json_text(self._list_facts(), indent=None).encode())
        for values in (self.slope_dn, self.offset_dn, self.hot):
            for row in _flatten_rows(values):
                digest.update(row.astype(row.dtype.newbyteorder("<"), copy=False).tobytes())
        return f"sha256:{digest.hexdigest()}"

    def _list_facts(self) -> dict[str, Any]:
        """Collect everything but the pixels, as plain JSON types."""
        modes, height, width = self.slope_dn.shape
        return {
            "schema": _SCHEMA_WITH_MODEL if self.model else _SCHEMA,
            "camera": self.camera,
            **({"model": self.model} if self.model else {}),
            "source": self.source,
            "cfa": [list(row) for row in self.cfa],
            "modes": modes,
            "height": height,
            "width": width,
            "isos": [asdict(row) for row in self.isos],
            "notes": list(self.notes),
        }

    def summary(self) -> dict[str, Any]:
        """Summarise all but the pixels, as plain types."""
        return {
            "digest": self.digest,
            "isos": [asdict(row) | {"error_dn": self.error_dn(row.iso)} for row in self.isos],
            "modes": len(self.slope_dn),
            "hot": int(self.hot.sum()),
            "notes": list(self.notes),
        }

    # --- what it says ---------------------------------------------------------------------------------------------

    def measured(self, iso: float) -> ShadingIso:
        """Look up the measurements of an ISO.

        Raises
        ------
        ArgumentError
            If nothing was: the black level error of an ISO follows from no other ISO's.
        """
        for row in self.isos:
            if row.iso == iso:
                return row
        listed = ", ".join(f"{row.iso:g}" for row in self.isos)
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

        row = self.measured(iso)
        slope, offset = (values[row.mode, rows, columns] for values in (self.slope_dn, self.offset_dn))
        top, left = (part.indices(side)[0] for part, side in zip((rows, columns), self.hot.shape, strict=True))
        period, part = len(self.cfa), np.empty(slope.shape, np.float32) if out is None else out
        down, right = top + np.arange(period), left + np.arange(slope.shape[1])
        channels = np.asarray(self.cfa)[down[:, None] % period, right % period]
        fill_line(slope, offset, np.float32(iso), np.asarray(row.level_error_dn, np.float32)[channels], part)
        return part

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
        number = self.measured(iso).mode
        mode = [row for row in self.isos if row.mode == number]
        weights, speeds = np.array([row.weight for row in mode]), np.array([row.iso for row in mode])
        middle = float(weights @ speeds / weights.sum())
        lever = float(weights @ (speeds - middle) ** 2)
        return math.sqrt(1 / weights.sum() + ((iso - middle) ** 2 / lever if len(mode) > 1 else 0.0))

    def leverage(self, iso: float) -> float:
        """Compute h, the share that one of the fitted bias frames has in the shading at its own ISO.

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
        about = json_text(self._list_facts() | {"digest": self.digest}, indent=None).encode()
        with atomic_write(path) as file:
            np.savez(
                file,  # plain numbers: nothing is pickled, and numpy 2.1 has no allow_pickle here
                about=np.frombuffer(about, np.uint8),
                slope_dn=self.slope_dn.astype("<f4", copy=False),
                offset_dn=self.offset_dn.astype("<f4", copy=False),
                hot=self.hot,
            )

    @classmethod
    def of(cls, given: DarkShading | Path | str) -> DarkShading:
        """Take a dark shading, or load it from its file.

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
        path = Path(path)
        try:
            shading, stated = _read(path)
        except ArgumentError as error:
            raise ShadingError(path, f"{error}; {_ADVICE}") from error
        if stated != shading.digest:
            raise ShadingError(
                path, f"field digest: expected {shading.digest} by the content, found {shown(stated)}; {_ADVICE}"
            )
        return shading


def _read(path: Path) -> tuple[DarkShading, str]:
    """Read a shading and the digest that its file states; declared sizes are checked before anything is loaded."""

    def load_array(name: str, dtype: str, *shape: int) -> NDArray[Any]:
        """Load an array of the file; refuse another type or shape. Without a shape it is text, of any length."""

        def check_header(header: Declared) -> None:
            fits = header.shape == shape or (not shape and header.shape <= (_MOST_ABOUT_BYTES,))
            if header.values != dtype or not fits:
                expected = f"{dtype} {shape}" if shape else f"up to {_MOST_ABOUT_BYTES} bytes"
                found = f"found {header.values} {header.shape}"
                raise ShadingError(path, f"{name}: expected {expected}, {found}; {_ADVICE}")

        return read_array(path, check_header, name=name, kind=".npz", error=ShadingError, advice=_ADVICE)

    top = TextFile(path, ShadingError, _ADVICE, content=load_array("about", "uint8").tobytes()).json()
    has_model = top.schema(_SCHEMA, also=(_SCHEMA_WITH_MODEL,)) == _SCHEMA_WITH_MODEL
    known = ("schema", "camera", "source", "cfa", "modes", "height", "width", "isos", "notes", "digest")
    top.only((*known, "model") if has_model else known)
    modes = top.whole("modes", at_least=1, at_most=_MOST_MODES)
    height, width = (top.whole(name, at_least=2, at_most=_LONGEST_SIDE) for name in ("height", "width"))
    if modes * height * width * 8 > path.stat().st_size:
        raise top.problem("height", f"the file is too small for {modes} x {height} x {width} pixels: truncated?")
    cfa = top.each("cfa", lambda inner, name: inner.each(name, Fields.whole, at_most=3), expected="a list of rows")
    lines = {name: load_array(name, "float32", modes, height, width).astype(np.float32, copy=False) for name in _FIELDS}
    shading = DarkShading(
        camera=top.text("camera"),
        source=top.text("source"),
        cfa=cfa,
        isos=tuple(map(_read_iso, top.objects("isos", fewest=1, expected="a list of at least one ISO"))),
        hot=load_array("hot", "bool", height, width),
        notes=top.texts("notes", empty=True),
        model=top.text("model") if has_model else "",
        **lines,
    )
    return shading, top.text("digest")


def _read_iso(fields: Fields) -> ShadingIso:
    """Read the measurements of one ISO."""
    fields.only(names_of(ShadingIso))
    return ShadingIso(
        iso=fields.number("iso", above=0),
        mode=fields.whole("mode", at_most=_MOST_MODES),
        frames=fields.whole("frames", at_least=1),
        sigma_dn=fields.number("sigma_dn", above=0),
        level_error_dn=fields.each("level_error_dn", Fields.number, expected="a list of numbers"),
        standard_error_dn=fields.each("standard_error_dn", Fields.number, expected="a list of numbers", at_least=0),
    )


def dark_shading_in(path: Path) -> DarkShading:
    """Load the dark shading of a file, once in a process unless the file changes.

    Raises
    ------
    ShadingError
        If it cannot be read.
    """
    try:
        status = path.stat()
    except OSError as error:
        raise ShadingError(path, f"cannot be read: {error.strerror or error}") from error
    return _load_cached(path, status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=1)
def _load_cached(path: Path, *_: int) -> DarkShading:
    """Load a shading again only if the other arguments, the file's time and size, have changed."""
    return DarkShading.load(path)


def _flatten_rows(values: NDArray[Any]) -> NDArray[Any]:
    """Flatten an array to its rows, so that work on one row at a time takes no memory."""
    return values.reshape(-1, values.shape[-1])
