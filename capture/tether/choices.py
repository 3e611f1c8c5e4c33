"""Which of the camera's own choices each setting of a plan is.

Makers write one time in several ways: 1/60, 0.0166s (cut to four decimals), 10/600, 0.3, 1/3, 3s for what others call
3.2. So a choice that names exactly the time of the dial comes first; next, the one choice within an eighth of a stop.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Final

from capture.capture_errors import TetherError
from capture.exact import as_exact
from capture.matching import STOPS_TOLERANCE
from eldata.base.fields import fraction_of, whole_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from capture.camera import CameraDescription
    from capture.shots import Shot
    from capture.shutter import ShutterTime
    from capture.tether.gphoto import Setting

_NUMBER: Final = r"[0-9]{1,9}(?:[.,][0-9]{1,9})?"
_TIME: Final = re.compile(rf"(?P<top>{_NUMBER})(?:/(?P<bottom>{_NUMBER}))? ?(?P<unit>s|sec|\"|m)?", re.ASCII)
_CUT: Final = re.compile(r"0[.,][0-9]{4}s?")  # Nikon's: whole ten-thousandths of a second, the rest cut off
_CUT_STEP: Final = Fraction(1, 10_000)
_COARSE_BELOW_S: Final = Fraction(1, 100)
_ISO: Final = re.compile(r"(?:ISO ?)?(?P<iso>[0-9]{1,9})", re.ASCII)
_RAW: Final = re.compile(r"(?<![a-z])(?:c|m|s)?raw|nef|nrw|\barw|cr[23w]\b|raf|orf|rw2|pef|dng", re.IGNORECASE)
_COMPRESSED: Final = re.compile(r"jpe?g|\+|fine|normal|basic|standard|light|heif", re.IGNORECASE)
_LONGEST_OF_LADDER_S: Final = 30  # beyond it cameras use their own steps
_SHORTEST_OF_CUT_S: Final = Fraction(1, 1000)


@dataclass(frozen=True, slots=True)
class Choices:
    """The camera's own texts for a plan's settings.

    Attributes
    ----------
    iso_name, shutter_name
        What the camera calls the two settings.
    isos
        Its text for each ISO of the plan.
    times
        Its text for each dial setting of the plan.
    """

    iso_name: str
    shutter_name: str
    isos: dict[int, str]
    times: dict[str, str]

    def values(self, shot: Shot) -> dict[str, str]:
        """Return what to set for a shot."""
        return {self.iso_name: self.isos[shot.iso], self.shutter_name: self.times[shot.setting.dial]}


def seconds_of(text: str) -> Fraction | None:
    """Return the seconds of a choice: ``1/60``, ``0.3``, ``300/10``, ``0,0166s``, ``2m``; ``None`` for ``Bulb``."""
    found = _TIME.fullmatch(text.strip())
    if found is None:
        return None
    top, bottom = (fraction_of((found[name] or "1").replace(",", ".")) for name in ("top", "bottom"))
    if not top or not bottom:
        return None
    return top / bottom * (60 if found["unit"] == "m" else 1)


def is_time(text: str, setting: ShutterTime) -> bool:
    """Return whether a text that the camera shows may stand for a setting."""
    seconds = seconds_of(text)
    if seconds is None:
        return False
    if _CUT.fullmatch(text.strip()) is not None:
        if seconds <= setting.nominal_s < seconds + _CUT_STEP:
            return True
        if seconds < _COARSE_BELOW_S:
            return False  # what was cut off is as large as the steps
    return setting.stops_off(seconds) <= STOPS_TOLERANCE


def time_choice(setting: ShutterTime, choices: Sequence[str], others: Sequence[ShutterTime]) -> str:
    """Return the choice that is a dial setting.

    Parameters
    ----------
    setting
        The setting.
    choices
        The camera's texts.
    others
        All settings of the camera description: what a choice could be instead.

    Raises
    ------
    TetherError
        If none fits, or the one that fits could be another setting too.
    """
    fitting = list(dict.fromkeys(text for text in choices if is_time(text, setting)))
    if not fitting:
        raise TetherError(f"{setting.dial} s")
    chosen = min(fitting, key=lambda text: (seconds_of(text) != setting.nominal_s, _stops(text, setting)))
    if seconds_of(chosen) == setting.nominal_s and _CUT.fullmatch(chosen.strip()) is None:
        return chosen
    rivals = [other.dial for other in others if other != setting and is_time(chosen, other)]
    if rivals:
        raise TetherError(f"{setting.dial} s (it shows {chosen} for this and for {', '.join(rivals)} s)")
    return chosen


def _stops(text: str, setting: ShutterTime) -> float:
    seconds = seconds_of(text)
    return float("inf") if seconds is None else setting.stops_off(seconds)


def iso_choice(iso: int, choices: Sequence[str]) -> str:
    """Return the choice that is an ISO; not one with an addition, such as ``100 Multi Frame Noise Reduction``.

    Raises
    ------
    TetherError
        If there is none.
    """
    found = next((text for text in choices if is_iso(text, iso)), None)
    if found is None:
        raise TetherError(f"ISO {iso}")
    return found


def is_iso(text: str, iso: int) -> bool:
    """Return whether a text that the camera shows is an ISO."""
    found = _ISO.fullmatch(text.strip())
    return found is not None and whole_of(found["iso"]) == iso


def choose(camera: CameraDescription, shots: Iterable[Shot], iso: Setting, shutter: Setting) -> Choices:
    """Return the camera's texts for every setting of some shots.

    Raises
    ------
    TetherError
        If the camera does not offer one of them now; the message names every one, and says what to look at.
    """
    planned = list(shots)
    for setting in (iso, shutter):
        if setting.read_only or not setting.choices:
            state = "read-only" if setting.read_only else f"not offered as a list (now {setting.current!r})"
            raise TetherError(
                f"the camera's {setting.name} is {state}: turn its mode dial to M and switch automatics off, then run "
                "this again"
            )
    lacking: list[str] = []

    def chosen(choice: Callable[..., str], *arguments: object) -> str:
        try:
            return choice(*arguments)
        except TetherError as error:
            lacking.append(str(error))
            return ""

    isos = {number: chosen(iso_choice, number, iso.choices) for number in dict.fromkeys(shot.iso for shot in planned)}
    times = {
        time.dial: chosen(time_choice, time, shutter.choices, camera.shutter.times)
        for time in dict.fromkeys(shot.setting for shot in planned)
    }
    if lacking:
        offered = f"{_ends(iso.choices)} as ISO, {_ends(shutter.choices)} as time"
        raise TetherError(
            f"the camera does not offer {', '.join(lacking)}; it offers {offered}. Look at its mode dial (M), shutter "
            "type and ISO range; or correct the camera description, and plan again"
        )
    for dial, text in times.items():
        _check_steps(camera, dial, text, shutter.choices)
    return Choices(iso.name, shutter.name, isos, times)


def _ends(choices: Sequence[str]) -> str:
    return f"{choices[0]} ... {choices[-1]}" if len(choices) > 1 else choices[0]


def _check_steps(camera: CameraDescription, dial: str, text: str, choices: Sequence[str]) -> None:
    """Refuse a camera that is set to other steps than the plan counts in.

    Halves and thirds of a stop share names, 1/20 and 10, with other times behind them: the ratio would be off.
    """
    step = camera.shutter.step
    seconds = seconds_of(text)
    if camera.shutter.true_times == "as-named" or step == 1 or seconds is None:
        return
    if seconds > _LONGEST_OF_LADDER_S / 2 or seconds < _SHORTEST_OF_CUT_S:
        return
    times = sorted({time for time in map(seconds_of, choices) if time is not None})
    at = times.index(seconds)
    if not 0 < at < len(times) - 1:
        return
    around = (as_exact(times[at + 1]) / times[at - 1]).log2  # two steps
    if (around > 0.84) == (step == Fraction(1, 3)):
        raise TetherError(
            f"the plan counts in steps of {step} stop, and around {dial} s the camera offers steps of about "
            f"{around / 2:.2f} stop: set its exposure steps (EV steps) to {step} in the menu, or describe the camera "
            "as it is and plan again"
        )


def format_problem(setting: Setting) -> str | None:
    """Return why an image format will not do; ``None`` for raw alone, or a text that says neither raw nor JPEG."""
    text = setting.current
    if _COMPRESSED.search(text) is None:
        return None  # of "Unknown value 000d" the first frame shows what it is
    offered = [choice for choice in setting.choices if _RAW.search(choice) and not _COMPRESSED.search(choice)]
    advice = f"set it to {' or '.join(offered)}" if offered else "set it to raw"
    if _RAW.search(text) is not None:
        return (
            f"the camera's {setting.name} is {text!r}: {advice} alone. With a JPEG beside it, some cameras hand over "
            "the raw of the shot before"
        )
    return f"the camera's {setting.name} is {text!r}: {advice} in its menu"
