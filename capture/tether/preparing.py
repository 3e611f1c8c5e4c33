"""Before the first shot: which camera is connected, whether it is the plan's and offers all that the plan asks for."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from capture.capture_errors import CameraLostError, TetherError
from capture.tether.choices import Choices, choose, format_problem

if TYPE_CHECKING:
    from capture.plan import Plan
    from capture.tether.gphoto import Gphoto, Setting

_LOW_BATTERY_PERCENT: Final = 20
_FORMATS: Final = ("imageformat", "imagequality")
_SHUTTERS: Final = ("shutterspeed2", "shutterspeed")  # Nikon's first has exact fractions, its second four decimals


@dataclass(frozen=True, slots=True)
class Ready:
    """A camera that can shoot a plan: the program with its port, its texts for the settings, and what to show."""

    gphoto: Gphoto
    choices: Choices
    remarks: tuple[str, ...]


def prepare(plan: Plan, gphoto: Gphoto) -> Ready:
    """Look at the connected camera.

    Raises
    ------
    CameraLostError
        If there is none.
    TetherError
        If there are several, it is not the plan's, or it does not offer a setting or raw files.
    """
    port, name = chosen_port(gphoto)
    gphoto = replace(gphoto, port=port)
    names = gphoto.setting_names()
    needed = (("iso", ("iso",)), ("shutterspeed", _SHUTTERS))
    lacking = [what for what, any_of in needed if not {*any_of} & {*names}]
    if lacking:
        raise TetherError(
            f"{name} does not offer {' or '.join(lacking)} now: turn its mode dial to M, and set its USB mode to "
            "PC remote; gphoto2 --list-config shows what it has"
        )
    asked = [one for one in ("cameramodel", "batterylevel", "iso", *_SHUTTERS, *_FORMATS) if one in names]
    settings = gphoto.settings(asked)
    problems = [format_problem(settings[one]) for one in _FORMATS if one in settings]
    if "cameramodel" in settings:
        problems.insert(0, model_problem(settings["cameramodel"].current, plan.camera.models))
    for problem in problems:
        if problem is not None:
            raise TetherError(problem)
    choices = _choices(plan, settings)
    battery = settings["batterylevel"].current if "batterylevel" in settings else ""
    remarks = [f"{name} at {port}{f', battery {battery}' if battery else ''}"]
    percent = battery.rstrip("% ")
    if percent.isdecimal() and int(percent) <= _LOW_BATTERY_PERCENT:
        remarks.append("its battery is low: a change of batteries in the middle of a scene moves the camera")
    return Ready(gphoto, choices, tuple(remarks))


def _choices(plan: Plan, settings: dict[str, Setting]) -> Choices:
    """Return the camera's texts, by the first of its shutter settings that has all times."""
    shots = [shot for _, shot in plan.shots]
    shutters = [settings[name] for name in _SHUTTERS if name in settings]
    for shutter in shutters[:-1]:
        try:
            return choose(plan.camera, shots, settings["iso"], shutter)
        except TetherError:
            continue
    return choose(plan.camera, shots, settings["iso"], shutters[-1])


def chosen_port(gphoto: Gphoto) -> tuple[str, str]:
    """Return port and name of the camera.

    Raises
    ------
    CameraLostError
        If none is found, or none at the given port.
    TetherError
        If there are several and none was chosen.
    """
    if gphoto.port and not gphoto.port.startswith("usb:"):
        return gphoto.port, "the camera"  # auto-detection does not find one in the network
    found = replace(gphoto, port="").detect()
    if not found:
        raise CameraLostError(
            "no camera was found: plug the cable in, switch the camera on, wake it, and set its USB mode to PC remote "
            "or PTP; gphoto2 --auto-detect shows what is found"
        )
    listed = ", ".join(f"{port} ({model})" for port, model in found.items())
    if not gphoto.port and len(found) > 1:
        raise TetherError(f"several cameras are connected: {listed}; choose one with --port")
    port = gphoto.port or next(iter(found))
    if port not in found:
        raise CameraLostError(f"--port {port}: no camera is there; found {listed}")
    return port, found[port]


def model_problem(said: str, models: tuple[str, ...]) -> str | None:
    """Return why a camera's own name is not among the plan's, or ``None``; EXIF may put the maker before it."""
    name = " ".join(said.split()).casefold()
    if not name or any(name == model.casefold() or model.casefold().endswith(f" {name}") for model in models):
        return None
    return (
        f"the connected camera calls itself {said}, and the plan is for {' or '.join(models)}: connect that one, or "
        "make a plan with a description of this one (the same body under another name: add that name to its models)"
    )
