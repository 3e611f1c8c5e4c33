"""What a camera can be set to: its exposure times, ISOs and file names.

The camera *names* a time 1/60 s, on its dial and mostly in EXIF; what it *gives* is a step of an even ladder of powers
of two, 1/64 s. Names were rounded for people: 15 s is 16 s, 0.3 s is 2^(-5/3) = 0.315 s. Exposure ratios follow from
what is given. So both are kept, the former as a fraction. Of the latter, what is nearer than a billionth counts as
equal, so that rounding to a camera's steps does not depend on the last digit.
"""

from __future__ import annotations

import math
import re
from bisect import bisect_left
from contextlib import suppress
from dataclasses import asdict, dataclass
from fractions import Fraction
from functools import cache
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final, Literal, get_args

from capture.capture_errors import CaptureError, naming
from eldata.base.fields import Fields, TextFile, names_of
from eldata.base.files import write_json
from eldata.base.numbers import fraction_of
from eldata.base.visible import shown
from eldata.errors import ArgumentError
from eldata.raw.files import RAW_EXTENSIONS

if TYPE_CHECKING:
    from pathlib import Path

TrueTimes = Literal["powers-of-two", "as-named"]

_LONGEST_BULB_S: Final = 3600
# EXIF states the name of a setting or what it gives, rounded in either case; neighbouring settings are a third of a
# stop apart, and names account for up to a tenth.
STOPS_TOLERANCE: Final = 0.125
EQUAL: Final = 1 + 1e-9  # times of a quotient below are one

# The times as cameras name them, from 2^-15 s in steps of a third and from 2^-14 s in steps of half a stop. Steps of
# halves and thirds share some names with other meanings: 10 s is 2^(10/3) s by thirds and 2^(7/2) s by halves.
_THIRDS: Final = tuple(
    """
1/32000 1/25600 1/20000 1/16000 1/12800 1/10000 1/8000 1/6400 1/5000 1/4000 1/3200 1/2500 1/2000 1/1600 1/1250 1/1000
1/800 1/640 1/500 1/400 1/320 1/250 1/200 1/160 1/125 1/100 1/80 1/60 1/50 1/40 1/30 1/25 1/20 1/15 1/13 1/10 1/8 1/6
1/5 1/4 0.3 0.4 0.5 0.6 0.8 1 1.3 1.6 2 2.5 3.2 4 5 6 8 10 13 15 20 25 30 40 50 60
""".split()  # noqa: SIM905 # read as a dial, not as a list
)
_HALVES: Final = tuple(
    """
1/16000 1/12000 1/8000 1/6000 1/4000 1/3000 1/2000 1/1500 1/1000 1/750 1/500 1/350 1/250 1/180 1/125 1/90 1/60 1/45
1/30 1/20 1/15 1/10 1/8 1/6 1/4 0.3 0.5 0.7 1 1.5 2 3 4 6 8 10 15 20 30 45 60
""".split()  # noqa: SIM905 # read as a dial, not as a list
)
_LADDERS: Final[dict[Fraction, tuple[tuple[str, ...], int]]] = {
    Fraction(1, 3): (_THIRDS, -15),
    Fraction(1, 2): (_HALVES, -14),
    Fraction(1): (_THIRDS[::3], -15),
}


def parse_seconds(text: object) -> Fraction:
    """Return the seconds that a text such as ``4``, ``1/2``, ``0.5`` or ``.5`` names, exactly.

    Raises
    ------
    ArgumentError
        If it is not a time above 0.
    """
    if not isinstance(text, str):
        raise ArgumentError(f'expected seconds as text, such as "1/2", found {shown(text)}')
    try:
        return fraction_of(f"0{text}" if text.startswith(".") else text, above=0, digits=9)
    except ArgumentError:
        raise ArgumentError(f"expected seconds above 0, such as 4, 1/2 or 0.5, found {shown(text)}") from None


@dataclass(frozen=True, slots=True)
class ShutterTime:
    """One setting of the shutter.

    Attributes
    ----------
    dial
        As the camera shows it: ``1/60``, ``0.3``, ``15``.
    nominal_s
        What the name says, in seconds: what EXIF states with most makers.
    true_s
        What the camera gives, in seconds.
    """

    dial: str
    nominal_s: Fraction
    true_s: float

    def stops_off(self, exposure_s: Fraction) -> float:
        """Compute the distance in stops of a time from this setting: from its name or its true time, the nearer one.

        Some makers write the name into EXIF, others what the camera gives.
        """
        return min(abs(math.log2(exposure_s / time_s)) for time_s in (self.nominal_s, self.true_s))


@cache
def ladder(step: Fraction) -> dict[Fraction, ShutterTime]:
    """Return the standard times of a step (a third, half or full stop), fastest first, by what their names say.

    Raises
    ------
    CaptureError
        If it is another step.
    """
    if step not in _LADDERS:
        raise CaptureError(f"shutter step: expected 1/3, 1/2 or 1 stop, found {step}")
    names, first = _LADDERS[step]
    times = [
        ShutterTime(name, parse_seconds(name), _power_of_two(first + step * index)) for index, name in enumerate(names)
    ]
    return {time.nominal_s: time for time in times}


def _power_of_two(stops: Fraction) -> float:
    """Return 2^stops; of equal fractions of a stop the quotient is a power of two exactly."""
    return math.ldexp(math.exp2(stops % 1), math.floor(stops))


@dataclass(frozen=True, slots=True)
class Shutter:
    """The exposure times of a camera.

    Attributes
    ----------
    dials
        Names of the times, fastest first.
    step
        Distance of the camera's steps in stops: 1/3, 1/2 or 1. It says what a name means.
    true_times
        ``"powers-of-two"``: names are rounded, what the camera gives is a power of two of its steps. ``"as-named"``:
        the camera gives exactly what it names, as machine-vision cameras and phones do.
    bulb_s
        The longest exposure to be timed by hand or by a remote release, beyond the slowest time, in whole seconds; 0:
        none. What the timer says is what the camera gives.

    Raises
    ------
    CaptureError
        If the list of times is empty, a time is named twice, a name is not a standard time of the step, or ``bulb_s``
        is not above the slowest time.
    """

    dials: tuple[str, ...]
    step: Fraction = Fraction(1, 3)
    true_times: TrueTimes = "powers-of-two"
    bulb_s: int = 0

    def __post_init__(self) -> None:
        ladder(self.step)
        if not self.dials:
            raise CaptureError("shutter times: expected at least one, found none")
        times = _read_times(self.dials, self.step, self.true_times)
        if self.bulb_s and not times[-1].nominal_s < self.bulb_s <= _LONGEST_BULB_S:
            raise CaptureError(
                f"bulb_s: expected whole seconds above the slowest time, {self.dials[-1]} s, and up to "
                f"{_LONGEST_BULB_S}, found {self.bulb_s}"
            )
        for before, time in pairwise(times):
            if time.nominal_s == before.nominal_s:
                raise CaptureError(f"shutter times: expected each time once, found {time.dial} twice")
            if time.nominal_s < before.nominal_s:
                raise CaptureError(f"shutter times: expected the fastest first, found {time.dial} after {before.dial}")

    @classmethod
    def between(
        cls, fastest: str, slowest: str, step: Fraction, true_times: TrueTimes = "powers-of-two", bulb_s: int = 0
    ) -> Shutter:
        """Return the standard times from the fastest to the slowest.

        Raises
        ------
        CaptureError
            If one of them is not a standard time of this step, or the fastest is slower than the slowest.
        """
        first, last = (_find_standard(name, step).nominal_s for name in (fastest, slowest))
        if first > last:
            raise CaptureError(f"shutter: the fastest time, {fastest} s, is slower than the slowest, {slowest} s")
        dials = tuple(time.dial for nominal_s, time in ladder(step).items() if first <= nominal_s <= last)
        return cls(dials, step, true_times, bulb_s)

    @property
    def times(self) -> tuple[ShutterTime, ...]:
        """The times, fastest first: the dial's, then the bulb setting's in steps, ``bulb 64``."""
        named = _read_times(self.dials, self.step, self.true_times)
        return (*named, *_list_bulb_times(named[-1], self.step, self.bulb_s))


@cache
def _read_times(dials: tuple[str, ...], step: Fraction, true_times: TrueTimes) -> tuple[ShutterTime, ...]:
    """Read the dial's times; their true times are powers of two, or as named."""
    if true_times == "powers-of-two":
        return tuple(_find_standard(dial, step) for dial in dials)
    return tuple(ShutterTime(dial, parse_seconds(dial), float(parse_seconds(dial))) for dial in dials)


@cache
def _list_bulb_times(slowest: ShutterTime, step: Fraction, bulb_s: int) -> tuple[ShutterTime, ...]:
    """Return whole seconds that go on in the camera's steps: after 30 s (2^5 s) in thirds 40, 51, 64, 81 and so on."""
    times: dict[int, ShutterTime] = {}
    seconds, steps = 0, 1
    while seconds < bulb_s:
        seconds = round(slowest.true_s * _power_of_two(steps * step))
        steps += 1
        if slowest.nominal_s < seconds <= bulb_s:
            times[seconds] = ShutterTime(f"bulb {seconds}", Fraction(seconds), float(seconds))
    return tuple(times.values())


@cache
def borders(shutter: Shutter) -> tuple[float, ...]:
    """Return the borders between neighbouring times, the roots of their products, and those beyond both ends."""
    given = [time.true_s for time in shutter.times]
    step = _power_of_two(shutter.step)
    first, last = (given[1] / given[0], given[-1] / given[-2]) if len(given) > 1 else (step, step)
    return tuple(math.sqrt(one * other) for one, other in pairwise([given[0] / first, *given, given[-1] * last]))


def _find_standard(name: str, step: Fraction) -> ShutterTime:
    """Find a standard shutter time in steps of ``step`` stop by its name, in seconds."""
    seconds = parse_seconds(name)
    known = ladder(step)
    time = known.get(seconds)
    if time is not None:
        return time
    near = min(known.values(), key=lambda time: abs(math.log2(seconds / time.nominal_s)))
    raise CaptureError(
        f"shutter times: {name} s is not a standard time in steps of {step} stop; the nearest is {near.dial} s. If the "
        'camera has just this time, list its times and say "true_times": "as-named"'
    )


def read_shutter(fields: Fields) -> Shutter:
    """Read the shutter that stands in a JSON object."""
    listed = "times" in fields.data
    fields.only(("step", "true_times", "bulb_s", *(("times",) if listed else ("fastest", "slowest"))))
    step = Fraction(1, 3) if listed and "step" not in fields.data else fields.parsed("step", parse_seconds)
    true_times: TrueTimes = fields.optional("true_times", fields.choice, "powers-of-two", known=get_args(TrueTimes))
    bulb_s = fields.optional("bulb_s", fields.whole, 0, at_most=_LONGEST_BULB_S)
    if listed:
        return Shutter(fields.texts("times"), step, true_times, bulb_s)
    return Shutter.between(fields.text("fastest"), fields.text("slowest"), step, true_times, bulb_s)


def shutter_as_dict(shutter: Shutter) -> dict[str, Any]:
    """Return a shutter as plain JSON types."""
    content: dict[str, Any] = {"step": str(shutter.step), "true_times": shutter.true_times, "bulb_s": shutter.bulb_s}
    ends = shutter.dials[0], shutter.dials[-1]
    with suppress(CaptureError):  # of times that are not standard ones
        if Shutter.between(*ends, shutter.step).dials == shutter.dials:
            return content | {"fastest": ends[0], "slowest": ends[1]}
    return content | {"times": list(shutter.dials)}


# --- the camera -------------------------------------------------------------------------------------------------------

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
    CaptureError
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
            raise CaptureError(f"camera name: expected letters, digits and . _ + - as in SonyA7S2, found {self.name!r}")
        if not self.models or not all(model.strip() == model and model for model in self.models):
            raise CaptureError(
                f"models of {self.name}: expected the camera's name as EXIF has it, such as ILCE-7SM2 (one or more); "
                f"found {list(self.models)}"
            )
        if self.raw_extension.lower() not in RAW_EXTENSIONS:
            raise CaptureError(
                f"raw_extension of {self.name}: expected a raw file's, with the dot, such as .ARW or .CR2; found "
                f"{shown(self.raw_extension)}"
            )
        if not self.isos or any(low >= high for low, high in pairwise(self.isos)):
            raise CaptureError(f"isos of {self.name}: expected one or more, rising; found {list(self.isos)}")
        if self.base_iso not in self.isos:
            raise CaptureError(
                f"base_iso of {self.name}: expected one of its ISOs, {', '.join(map(str, self.isos))}; found "
                f"{self.base_iso}"
            )
        for iso, speed in self.true_isos:
            if iso not in self.isos:
                raise CaptureError(f"true_isos of {self.name}: expected its ISOs, found {iso}, which it does not have")
            if abs(math.log2(speed / iso)) > _MOST_STOPS_OFF:
                raise CaptureError(
                    f"true_isos of {self.name}: expected speeds within {_MOST_STOPS_OFF} stop of their names, found "
                    f"{float(speed):g} for ISO {iso}"
                )

    @classmethod
    def load(cls, path: Path | str) -> CameraDescription:
        """Read a camera description.

        Raises
        ------
        CaptureError
            If the file cannot be read, or a field is missing, unknown or wrong; the message names it.
        """
        top = TextFile(path, CaptureError).json()
        top.schema(SCHEMA, "capture")
        with naming(path):
            return read_camera(top)

    def save(self, path: Path | str) -> None:
        """Write the description as JSON, whole or not at all."""
        write_json(path, {"schema": SCHEMA} | camera_as_dict(self))

    def speed(self, iso: int) -> Fraction:
        """Return the measured speed of an ISO; its name, if the camera states none at all.

        Raises
        ------
        CaptureError
            If the camera states other ISOs' speeds: a ratio of a measured speed and a name would be neither.
        """
        speeds = dict(self.true_isos)
        if speeds and iso not in speeds:
            raise CaptureError(
                f"{self.name} states the true speed of ISO {', '.join(map(str, speeds))}, and not of ISO {iso}: "
                "measure that too, or leave true_isos out"
            )
        return speeds.get(iso, Fraction(iso))

    @property
    def fastest(self) -> ShutterTime:
        """The fastest time, which bias frames take."""
        return self.shutter.times[0]

    @property
    def slowest(self) -> ShutterTime:
        """The slowest time."""
        return self.shutter.times[-1]

    def find_marked(self, seconds: Fraction) -> ShutterTime | None:
        """Return the setting that is marked with this time, if there is one."""
        return next((time for time in self.shutter.times if time.nominal_s == seconds), None)

    def round_to_nearest(self, wanted_s: float | Fraction) -> ShutterTime | None:
        """Return the setting whose given time is nearest by ratio; of two equally near the faster.

        ``None`` if the wanted time lies beyond the camera's fastest or slowest by more than half of a step there.
        """
        wanted, between = float(wanted_s), borders(self.shutter)
        if not between[0] <= wanted * EQUAL or not wanted <= between[-1] * EQUAL:
            return None
        return self.shutter.times[bisect_left(between, wanted / EQUAL, 1, len(between) - 1) - 1]

    def round_down(self, wanted_s: float) -> ShutterTime | None:
        """Return the slowest setting that gives no more than the wanted time; ``None`` if all give more."""
        return next((time for time in reversed(self.shutter.times) if time.true_s <= wanted_s * EQUAL), None)


def read_wholes(fields: Fields, name: str) -> tuple[int, ...]:
    """Return a list of whole numbers above 0, at least one, each once."""
    expected = "a list of at least one whole number"
    return fields.each(name, Fields.whole, expected=expected, fewest=1, once=True, at_least=1)


def read_camera(top: Fields) -> CameraDescription:
    """Read the camera description that stands in a JSON object."""
    top.only(("schema", *names_of(CameraDescription)))
    speeds: list[tuple[int, Fraction]] = []
    for name in top.inside("true_isos").data if "true_isos" in top.data else ():
        if _ISO.fullmatch(name) is None:
            raise top.wrong("true_isos", 'ISOs with their speeds, as {"100": 81, "800": 644.5}', name)
        speeds.append((int(name), Fraction(str(top.inside("true_isos").number(name, above=0)))))
    return CameraDescription(
        top.text("name"),
        top.texts("models"),
        top.text("raw_extension"),
        read_wholes(top, "isos"),
        top.whole("base_iso", at_least=1),
        read_shutter(top.inside("shutter")),
        top.optional("cfa", top.choice, "bayer", known=get_args(Cfa)),
        tuple(sorted(speeds)),
    )


def camera_as_dict(camera: CameraDescription) -> dict[str, Any]:
    """Return a camera description as plain JSON types, without the schema number."""
    true_isos = {str(iso): float(speed) for iso, speed in camera.true_isos}
    return asdict(camera) | {"shutter": shutter_as_dict(camera.shutter), "true_isos": true_isos}


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
