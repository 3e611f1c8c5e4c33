"""The exposure times of a camera, each with the name that it has and the time that the shutter gives.

The camera *names* a time 1/60 s, on its dial and mostly in EXIF; what it *gives* is a step of an even ladder of powers
of two, 1/64 s. Names were rounded for people: 15 s is 16 s, 0.3 s is 2^(-5/3) = 0.315 s. Exposure ratios follow from
what is given. So both are kept, the latter as an exact number ``c 2^s``: with ``c`` and ``s`` as fractions, products,
quotients and comparisons stay exact, so that rounding to a camera's steps has no near misses.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final, Literal, get_args

from capture.capture_errors import CameraError
from eldata.base.numbers import fraction_of
from eldata.base.visible import shown
from eldata.errors import ArgumentError

if TYPE_CHECKING:
    from eldata.base.fields import Fields

TrueTimes = Literal["powers-of-two", "as-named"]

_LONGEST_BULB_S: Final = 3600
# EXIF states the name of a setting or what it gives, rounded in either case; neighbouring settings are a third of a
# stop apart, and names account for up to a tenth.
STOPS_TOLERANCE: Final = 0.125

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


@dataclass(frozen=True, slots=True)
class ExactNumber:
    """The number ``coefficient * 2 ** stops``, kept with ``stops`` in [0, 1) so that equal numbers have equal fields.

    Attributes
    ----------
    coefficient
        A positive fraction.
    stops
        Exponent of two: stops in a photographer's sense.

    Raises
    ------
    ArgumentError
        If the coefficient is not above 0.
    """

    coefficient: Fraction
    stops: Fraction = Fraction(0)

    def __post_init__(self) -> None:
        if not self.coefficient > 0:
            raise ArgumentError(f"coefficient must be above 0, found {self.coefficient}")
        whole = math.floor(self.stops)
        object.__setattr__(self, "coefficient", Fraction(self.coefficient) * Fraction(2) ** whole)
        object.__setattr__(self, "stops", Fraction(self.stops) - whole)

    @property
    def log2(self) -> float:
        """Its logarithm to the base 2: stops over 1."""
        return math.log2(self.coefficient.numerator) - math.log2(self.coefficient.denominator) + float(self.stops)

    def __float__(self) -> float:
        return float(self.coefficient) * math.exp2(float(self.stops))

    def __mul__(self, other: ExactNumber | Fraction | int) -> ExactNumber:
        factor = as_exact(other)
        return ExactNumber(self.coefficient * factor.coefficient, self.stops + factor.stops)

    def __truediv__(self, other: ExactNumber | Fraction | int) -> ExactNumber:
        divisor = as_exact(other)
        return ExactNumber(self.coefficient / divisor.coefficient, self.stops - divisor.stops)

    def __lt__(self, other: ExactNumber) -> bool:
        # c1 2^s1 < c2 2^s2 is (c1 / c2)^d < 2^(d (s2 - s1)), and with a common denominator d both sides are fractions.
        common = math.lcm(self.stops.denominator, other.stops.denominator)
        exponent = (other.stops - self.stops) * common
        return (self.coefficient / other.coefficient) ** common < Fraction(2) ** int(exponent)

    def __le__(self, other: ExactNumber) -> bool:
        return not other < self


def as_exact(value: ExactNumber | Fraction | int) -> ExactNumber:
    """Return a fraction as an :class:`ExactNumber`."""
    return value if isinstance(value, ExactNumber) else ExactNumber(Fraction(value))


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
    true_exact
        What the camera gives, in seconds.
    """

    dial: str
    nominal_s: Fraction
    true_exact: ExactNumber

    @property
    def true_s(self) -> float:
        """What the camera gives, in seconds."""
        return float(self.true_exact)

    def stops_off(self, exposure_s: Fraction) -> float:
        """Return how far a time lies from this setting, in stops: from its name or what it gives, the nearer one.

        Some makers write the name into EXIF, others what the camera gives.
        """
        observed = as_exact(exposure_s)
        return min(abs((observed / self.nominal_s).log2), abs((observed / self.true_exact).log2))


@cache
def ladder(step: Fraction) -> dict[Fraction, ShutterTime]:
    """Return the standard times of a step (a third, half or full stop), fastest first, by what their names say.

    Raises
    ------
    CameraError
        If it is another step.
    """
    if step not in _LADDERS:
        raise CameraError(f"shutter step: expected 1/3, 1/2 or 1 stop, found {step}")
    names, first = _LADDERS[step]
    times = [
        ShutterTime(name, parse_seconds(name), ExactNumber(Fraction(1), first + step * index))
        for index, name in enumerate(names)
    ]
    return {time.nominal_s: time for time in times}


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
    CameraError
        If the list of times is empty, a time is named twice, a name is not a standard time of the step, or ``bulb_s``
        is not above the slowest time.
    """

    dials: tuple[str, ...]
    step: Fraction = Fraction(1, 3)
    true_times: TrueTimes = "powers-of-two"
    bulb_s: int = 0

    def __post_init__(self) -> None:
        ladder(self.step)
        if self.true_times not in get_args(TrueTimes):
            raise CameraError(
                f"true_times: expected one of {', '.join(get_args(TrueTimes))}, found {self.true_times!r}"
            )
        if not self.dials:
            raise CameraError("shutter times: expected at least one, found none")
        times = _times(self.dials, self.step, self.true_times)
        if self.bulb_s and not times[-1].nominal_s < self.bulb_s <= _LONGEST_BULB_S:
            raise CameraError(
                f"bulb_s: expected whole seconds above the slowest time, {self.dials[-1]} s, and up to "
                f"{_LONGEST_BULB_S}, found {self.bulb_s}"
            )
        named = [(dial, time.nominal_s) for dial, time in zip(self.dials, times, strict=True)]
        for (dial_before, before_s), (dial, time_s) in pairwise(named):
            if time_s == before_s:
                raise CameraError(f"shutter times: expected each time once, found {dial} twice")
            if time_s < before_s:
                raise CameraError(f"shutter times: expected the fastest first, found {dial} after {dial_before}")

    @classmethod
    def between(
        cls, fastest: str, slowest: str, step: Fraction, true_times: TrueTimes = "powers-of-two", bulb_s: int = 0
    ) -> Shutter:
        """Return the standard times from the fastest to the slowest.

        Raises
        ------
        CameraError
            If one of them is not a standard time of this step, or the fastest is slower than the slowest.
        """
        first, last = (_standard(name, step).nominal_s for name in (fastest, slowest))
        if first > last:
            raise CameraError(f"shutter: the fastest time, {fastest} s, is slower than the slowest, {slowest} s")
        dials = tuple(time.dial for nominal_s, time in ladder(step).items() if first <= nominal_s <= last)
        return cls(dials, step, true_times, bulb_s)

    @property
    def times(self) -> tuple[ShutterTime, ...]:
        """The times, fastest first; after those of the dial those of the bulb setting, ``bulb 64``, in steps."""
        named = _times(self.dials, self.step, self.true_times)
        return (*named, *_bulb_times(named[-1], self.step, self.bulb_s))


@cache
def _times(dials: tuple[str, ...], step: Fraction, true_times: TrueTimes) -> tuple[ShutterTime, ...]:
    if true_times == "powers-of-two":
        return tuple(_standard(dial, step) for dial in dials)
    return tuple(ShutterTime(dial, _seconds(dial), as_exact(_seconds(dial))) for dial in dials)


@cache
def _bulb_times(slowest: ShutterTime, step: Fraction, bulb_s: int) -> tuple[ShutterTime, ...]:
    """Return whole seconds that go on in the camera's steps: after 30 s (2^5 s) in thirds 40, 51, 64, 81 and so on."""
    found: dict[int, ShutterTime] = {}
    seconds, steps = 0, 1
    while seconds < bulb_s:
        seconds = round(float(slowest.true_exact * ExactNumber(Fraction(1), steps * step)))
        steps += 1
        if slowest.nominal_s < seconds <= bulb_s:
            found[seconds] = ShutterTime(f"bulb {seconds}", Fraction(seconds), as_exact(seconds))
    return tuple(found.values())


@cache
def borders(shutter: Shutter) -> tuple[ExactNumber, ...]:
    """Return the squares of the borders between neighbouring times, and those half a step beyond both ends."""
    given = [time.true_exact for time in shutter.times]
    step = ExactNumber(Fraction(1), shutter.step)
    first, last = (given[1] / given[0], given[-1] / given[-2]) if len(given) > 1 else (step, step)
    return tuple(one * other for one, other in pairwise([given[0] / first, *given, given[-1] * last]))


def _seconds(name: str) -> Fraction:
    try:
        return parse_seconds(name)
    except ArgumentError as error:
        raise CameraError(f"shutter times: {error}") from None


def _standard(name: str, step: Fraction) -> ShutterTime:
    seconds = _seconds(name)
    known = ladder(step)
    found = known.get(seconds)
    if found is not None:
        return found
    near = min(known.values(), key=lambda time: abs((as_exact(seconds) / time.nominal_s).log2))
    raise CameraError(
        f"shutter times: {name} s is not a standard time in steps of {step} stop; the nearest is {near.dial} s. If the "
        'camera has just this time, list its times and say "true_times": "as-named"'
    )


_FIELDS: Final = ("step", "fastest", "slowest", "times", "true_times", "bulb_s")


def shutter_from(fields: Fields) -> Shutter:
    """Return the shutter that stands in a JSON object."""
    fields.only(_FIELDS)
    step = Fraction(1, 3)
    if "step" in fields.data or "times" not in fields.data:
        step = fields.parsed("step", parse_seconds)
    if step not in _LADDERS:
        raise fields.wrong("step", '"1/3", "1/2" or "1" (stops)', fields.data["step"])
    if "times" in fields.data and {"fastest", "slowest"} & set(fields.data):
        raise fields.wrong("times", "either a list of times, or fastest and slowest", "both")
    true_times: TrueTimes = fields.optional("true_times", fields.choice, "powers-of-two", known=get_args(TrueTimes))
    bulb_s = fields.optional("bulb_s", fields.whole, 0, at_most=_LONGEST_BULB_S)
    if "times" in fields.data:
        return Shutter(fields.texts("times"), step, true_times, bulb_s)
    return Shutter.between(fields.text("fastest"), fields.text("slowest"), step, true_times, bulb_s)


def shutter_as_dict(shutter: Shutter) -> dict[str, Any]:
    """Return a shutter as plain JSON types."""
    content: dict[str, Any] = {"step": str(shutter.step), "true_times": shutter.true_times}
    names = [time.dial for time in ladder(shutter.step).values()]
    first = names.index(shutter.dials[0]) if shutter.dials[0] in names else len(names)
    if tuple(names[first : first + len(shutter.dials)]) == shutter.dials:
        content |= {"fastest": shutter.dials[0], "slowest": shutter.dials[-1]}
    else:
        content |= {"times": list(shutter.dials)}
    return content | ({"bulb_s": shutter.bulb_s} if shutter.bulb_s else {})
