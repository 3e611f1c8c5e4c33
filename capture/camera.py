"""What a camera can be set to: its exposure times (:mod:`capture.shutter`), ISOs and file names."""

from __future__ import annotations

import re
from bisect import bisect_left
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final, Literal, get_args

from capture.capture_errors import CameraError, naming
from capture.shutter import ExactNumber, Shutter, ShutterTime, as_exact, borders, shutter_as_dict, shutter_from
from eldata.base.fields import Fields, TextFile, names_of
from eldata.base.files import write_json
from eldata.base.visible import shown
from eldata.raw.files import RAW_EXTENSIONS

if TYPE_CHECKING:
    from pathlib import Path

SCHEMA: Final = 1
Cfa = Literal["bayer", "xtrans"]

_MOST_STOPS_OFF: Final = 1  # of an ISO's name: ISO 12232 lets makers choose it, and cameras are up to half a stop off
_ISO: Final = re.compile(r"[1-9][0-9]{0,8}")
_NAME: Final = re.compile(r"[A-Za-z0-9][\w.+-]*", re.ASCII)


@dataclass(frozen=True, slots=True)
class CameraDescription:
    """What a camera can be set to.

    Attributes
    ----------
    name
        Short name, also of its folder in the dataset, such as ``SonyA7S2``.
    models
        How the camera names itself in EXIF, under any name that it is sold by, such as ``ILCE-7SM2``.
    raw_extension
        Of its raw files, with the dot, as the files have it: ``.ARW``.
    isos
        Its ISOs, rising.
    base_iso
        The ISO of its references: the lowest that is not an extended ("L") one.
    shutter
        Its exposure times.
    cfa
        ``"bayer"`` or ``"xtrans"``.
    true_isos
        Measured speeds of ISOs, for those that are known: what the camera calls ISO 100 may be ISO 81. Whole cameras
        that are off by the same factor need none, since only ratios count.

    Raises
    ------
    CameraError
        If a field is invalid, or the base ISO or one with a measured speed is not among the ISOs.
    """

    name: str
    models: tuple[str, ...]
    raw_extension: str
    isos: tuple[int, ...]
    base_iso: int
    shutter: Shutter
    cfa: Cfa = "bayer"
    true_isos: tuple[tuple[int, Fraction], ...] = ()

    def __post_init__(self) -> None:
        if _NAME.fullmatch(self.name) is None:
            raise CameraError(f"camera name: expected letters, digits and . _ + - as in SonyA7S2, found {self.name!r}")
        if not self.models or not all(model.strip() == model and model for model in self.models):
            raise CameraError(
                f"models of {self.name}: expected the camera's name as EXIF has it, such as ILCE-7SM2 (one or more); "
                f"found {list(self.models)}"
            )
        if self.raw_extension.lower() not in RAW_EXTENSIONS:
            raise CameraError(
                f"raw_extension of {self.name}: expected a raw file's, with the dot, such as .ARW or .CR2; found "
                f"{shown(self.raw_extension)}"
            )
        if not self.isos or any(low >= high for low, high in pairwise(self.isos)):
            raise CameraError(f"isos of {self.name}: expected one or more, rising; found {list(self.isos)}")
        if self.base_iso not in self.isos:
            raise CameraError(
                f"base_iso of {self.name}: expected one of its ISOs, {', '.join(map(str, self.isos))}; found "
                f"{self.base_iso}"
            )
        if self.cfa not in get_args(Cfa):
            raise CameraError(f"cfa of {self.name}: expected {' or '.join(get_args(Cfa))}, found {self.cfa!r}")
        for iso, speed in self.true_isos:
            if iso not in self.isos:
                raise CameraError(f"true_isos of {self.name}: expected its ISOs, found {iso}, which it does not have")
            if abs(as_exact(speed / iso).log2) > _MOST_STOPS_OFF:
                raise CameraError(
                    f"true_isos of {self.name}: expected speeds within {_MOST_STOPS_OFF} stop of their names, found "
                    f"{float(speed):g} for ISO {iso}"
                )

    @classmethod
    def load(cls, path: Path | str) -> CameraDescription:
        """Read a camera description.

        Raises
        ------
        CameraError
            If the file cannot be read, or a field is missing, unknown or wrong; the message names it.
        """
        top = TextFile(path, CameraError).json()
        top.schema(SCHEMA, "capture")
        with naming(path, CameraError):
            return camera_from(top)

    def save(self, path: Path | str) -> None:
        """Write the description as JSON, whole or not at all."""
        write_json(path, {"schema": SCHEMA} | camera_as_dict(self))

    def speed(self, iso: int) -> Fraction:
        """Return the measured speed of an ISO; its name, if the camera states none at all.

        Raises
        ------
        CameraError
            If the camera states those of others: a ratio of a measured speed and a name would be neither.
        """
        speeds = dict(self.true_isos)
        if speeds and iso not in speeds:
            raise CameraError(
                f"{self.name} states the true speed of ISO {', '.join(map(str, speeds))}, and not of ISO {iso}: "
                "measure that too, or leave true_isos out"
            )
        return speeds.get(iso, Fraction(iso))

    @property
    def fastest(self) -> ShutterTime:
        """The fastest time: that of bias frames."""
        return self.shutter.times[0]

    @property
    def slowest(self) -> ShutterTime:
        """The slowest time."""
        return self.shutter.times[-1]

    def named(self, seconds: Fraction) -> ShutterTime | None:
        """Return the setting that is marked with this time, if there is one."""
        return next((time for time in self.shutter.times if time.nominal_s == seconds), None)

    def nearest(self, wanted_s: ExactNumber | Fraction) -> ShutterTime | None:
        """Return the setting whose given time is nearest by ratio; of two equally near the faster.

        ``None`` if the wanted time lies beyond the camera's fastest or slowest by more than half of a step there.
        """
        wanted = as_exact(wanted_s)
        # Nearest by ratio: the border between two neighbours is the root of their product. Squares stay exact.
        square, between = wanted * wanted, borders(self.shutter)
        if square < between[0] or between[-1] < square:
            return None
        return self.shutter.times[bisect_left(between, square, 1, len(between) - 1) - 1]

    def not_above(self, wanted_s: ExactNumber | Fraction) -> ShutterTime | None:
        """Return the slowest setting that gives no more than the wanted time; ``None`` if all give more."""
        wanted = as_exact(wanted_s)
        return next((time for time in reversed(self.shutter.times) if time.true_exact <= wanted), None)


def read_wholes(fields: Fields, name: str) -> tuple[int, ...]:
    """Return a list of whole numbers above 0, at least one, each once."""
    expected = "a list of at least one whole number"
    return fields.each(name, Fields.whole, expected=expected, fewest=1, once=True, at_least=1)


def camera_from(top: Fields) -> CameraDescription:
    """Return the camera description that stands in a JSON object."""
    top.only(("schema", *names_of(CameraDescription)))
    values: dict[str, Any] = {
        "name": top.text("name"),
        "models": top.texts("models"),
        "raw_extension": top.text("raw_extension"),
        "isos": read_wholes(top, "isos"),
        "base_iso": top.whole("base_iso", at_least=1),
        "cfa": top.optional("cfa", top.choice, "bayer", known=get_args(Cfa)),
        "true_isos": _true_isos(top) if "true_isos" in top.data else (),
    }
    return CameraDescription(**values, shutter=shutter_from(top.inside("shutter")))


def _true_isos(top: Fields) -> tuple[tuple[int, Fraction], ...]:
    speeds = top.inside("true_isos")
    found = {}
    for name in speeds.data:
        iso = int(name) if _ISO.fullmatch(name) else 0
        if not iso or iso in found:
            raise top.wrong("true_isos", 'ISOs, each once, with their speeds, as {"100": 81, "800": 644.5}', name)
        found[iso] = Fraction(str(speeds.number(name, above=0)))
    return tuple(sorted(found.items()))


def camera_as_dict(camera: CameraDescription) -> dict[str, Any]:
    """Return a camera description as plain JSON types, without the schema number."""
    return {
        "name": camera.name,
        "models": list(camera.models),
        "raw_extension": camera.raw_extension,
        "isos": list(camera.isos),
        "base_iso": camera.base_iso,
        "shutter": shutter_as_dict(camera.shutter),
        "cfa": camera.cfa,
    } | ({"true_isos": {str(iso): float(speed) for iso, speed in camera.true_isos}} if camera.true_isos else {})


EXAMPLE: Final = CameraDescription(
    name="SonyA7S2",
    models=("ILCE-7SM2",),
    raw_extension=".ARW",
    isos=(
        *(100, 125, 160, 200, 250, 320, 400, 500, 640, 800, 1000, 1250, 1600, 2000, 2500, 3200, 4000, 5000, 6400, 8000),
        *(10000, 12800, 16000, 20000, 25600),
    ),
    base_iso=100,
    shutter=Shutter.between("1/8000", "30", Fraction(1, 3)),
)
"""The Sony A7S II of the released set, to start your own description from."""
