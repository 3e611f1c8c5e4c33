"""What the file of a dark shading holds, read and checked before anything is loaded."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.base.arrays import NpyError, opened_npz
from eldata.base.fields import Fields, TextFile, names_of
from eldata.base.files import file_problem
from eldata.errors import ArgumentError, ShadingError
from eldata.raw.cfa import packed_channels

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from eldata.base.arrays import Declared, NpzArchive
    from eldata.raw.cfa import CfaRows

SCHEMA = 1
SCHEMA_WITH_MODEL = 2
FIELDS = ("slope_dn", "offset_dn")
ADVICE = "write it again with eldata calibrate --dark-shading"

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
        """Of its mean frame in the lines, 1 / DN^2: one over the variance that noise leaves in it."""
        return self.frames / self.sigma_dn**2


def read_content(path: Path) -> tuple[dict[str, Any], str]:
    """Return what a file holds, as the arguments of :class:`~eldata.noise.dark_shading.DarkShading`, and its digest.

    Raises
    ------
    ShadingError
        If it cannot be read, is damaged, or is not the file of a dark shading.
    """
    problem = file_problem(path)
    if problem is not None:
        raise ShadingError(path, problem)
    try:
        with opened_npz(path) as archive:
            return _read(path, archive)
    except NpyError as error:
        raise ShadingError(path, f"is not the file of a dark shading: {error}; {ADVICE}") from error
    except OSError as error:
        raise ShadingError(path, f"cannot be read: {error.strerror or error}") from error


def _read(path: Path, archive: NpzArchive) -> tuple[dict[str, Any], str]:
    about = archive.read("about", _like("about", "uint8", None)).tobytes()
    top = TextFile(path, ShadingError, ADVICE, content=about).json()
    schema = top.schema(SCHEMA, also=(SCHEMA_WITH_MODEL,))
    known = ["schema", "camera", "source", "cfa", "modes", "height", "width", "isos", "notes", "digest"]
    known += ["model"] * (schema == SCHEMA_WITH_MODEL)
    top.only(known)
    modes = top.whole("modes", at_least=1, at_most=_MOST_MODES)
    height, width = (top.whole(name, at_least=2, at_most=_LONGEST_SIDE) for name in ("height", "width"))
    if modes * height * width * 8 > path.stat().st_size:
        raise top.problem("height", f"the file is too small for {modes} x {height} x {width} pixels: truncated?")
    cfa = _cfa(top)
    isos = tuple(map(_iso, top.objects("isos", fewest=1, expected="a list of at least one ISO")))
    fields = {name: archive.read(name, _like(name, "float32", (modes, height, width))) for name in FIELDS}
    hot = archive.read("hot", _like("hot", "bool", (height, width)))
    if hot.view(np.uint8).max() > 1:
        raise top.problem("hot", "expected true and false alone, found other bytes")
    content: dict[str, Any] = {
        "camera": top.text("camera"),
        "source": top.text("source"),
        "cfa": cfa,
        "isos": isos,
        "hot": hot,
        "notes": top.texts("notes", empty=True),
        "model": top.text("model") if schema == SCHEMA_WITH_MODEL else "",
    }
    arrays = {name: np.ascontiguousarray(values, dtype=np.float32) for name, values in fields.items()}
    return content | arrays, top.text("digest")


def _like(name: str, values: str, shape: tuple[int, ...] | None) -> Callable[[Declared], None]:
    """Return a check that an array is of a type and shape; of any length up to a MiB, if that is not known."""

    def check(header: Declared) -> None:
        fits = header.shape == shape if shape else len(header.shape) == 1 and header.shape[0] <= _MOST_ABOUT_BYTES
        if header.values != values or not fits:
            expected = f"{values} {shape}" if shape else f"up to {_MOST_ABOUT_BYTES} bytes"
            raise NpyError(f"{name}: expected {expected}, found {header.values} {header.shape}")

    return check


def _cfa(top: Fields) -> CfaRows:
    rows = top.each("cfa", lambda inner, name: inner.each(name, Fields.whole, at_most=3), expected="a list of rows")
    try:
        packed_channels(rows)
    except (ArgumentError, ValueError) as error:
        raise top.problem("cfa", str(error)) from error
    return rows


def _iso(one: Fields) -> ShadingIso:
    one.only(names_of(ShadingIso))
    return ShadingIso(
        iso=one.number("iso", above=0),
        mode=one.whole("mode", at_most=_MOST_MODES),
        frames=one.whole("frames", at_least=1),
        sigma_dn=one.number("sigma_dn", above=0),
        level_error_dn=one.each("level_error_dn", Fields.number, expected="a list of numbers"),
        standard_error_dn=one.each("standard_error_dn", Fields.number, expected="a list of numbers", at_least=0),
    )
