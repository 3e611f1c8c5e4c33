"""A stand-in for the program gphoto2 with a camera on the cable: same options, same texts, same exit codes.

It imports the standard library alone, so that it starts quickly. Its camera lives in the folder $FAKE_GPHOTO2: a JSON
state, frames to hand out (small DNG files, written before by eldata), and a card. ``state["trouble"]`` is a list of
what goes wrong: each item names an option, what to do and, with ``skip``, after how many calls.
"""

from __future__ import annotations

import json
import os
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from typing import Any

ROOT = Path(os.environ.get("FAKE_GPHOTO2", "."))
STATE = ROOT / "state.json"
CARD = ROOT / "card"
START_S = 1795305000  # 2026-11-21 23:50:00: a camera's clock, which runs over midnight
STAMP = b"2000:01:01 00:00:00"
NO_CAMERA = (
    "\n*** Error ***              \nCould not detect any camera\n*** Error (-105: 'Unknown model') ***       \n\n"
)
ADVICE = """For debugging messages, please use the --debug option.
Debugging messages may help finding a solution to your problem.
If you intend to send any error or debug messages to the gphoto
developer mailing list <gphoto-devel@lists.sourceforge.net>, please run
gphoto2 as follows:

    env LANG=C gphoto2 --debug --debug-logfile=my-logfile.txt

Please make sure there is sufficient quoting around the arguments.

"""
CLAIMED = """
*** Error ***
An error occurred in the io-library ('Could not claim the USB device'): Could not claim interface 0 (Device or resource
busy). Make sure no other program (gvfs-gphoto2-volume-monitor) is using the device and you have read/write access.
*** Error (-53: 'Could not claim the USB device') ***

"""
BUSY = """
*** Error ***
PTP Device Busy
ERROR: Could not capture image.
ERROR: Could not capture.
*** Error (-110: 'I/O in progress') ***

"""
BROKEN = "*** Error (-1: 'Unspecified error') ***\n\n"
IO = """
*** Error ***
PTP I/O Error
*** Error (-7: 'I/O problem') ***

"""


class Fails(Exception):  # noqa: N818 # a way out
    """The program ends with 1 and this text."""


def save(state: dict[str, Any]) -> None:
    temporary = STATE.with_suffix(".part")
    temporary.write_text(json.dumps(state))
    temporary.replace(STATE)


def trouble(state: dict[str, Any], option: str) -> str:
    """Return what goes wrong with this call; each trouble happens once, or ``times``."""
    for item in state["trouble"]:
        if item["on"] != option:
            continue
        if item.get("skip", 0) > 0:
            item["skip"] -= 1
            save(state)
            return ""
        item["times"] = item.get("times", 1) - 1
        if item["times"] <= 0:
            state["trouble"].remove(item)
        save(state)
        return str(item["do"])
    return ""


def shown(name: str, setting: dict[str, Any]) -> str:
    lines = [
        f"Label: {name}",
        f"Readonly: {setting.get('read_only', 0)}",
        "Type: RADIO",
        f"Current: {setting['current']}",
    ]
    lines += [f"Choice: {index} {text}" for index, text in enumerate(setting.get("choices", ()))]
    return "\n".join([*lines, "END"])


def develop(state: dict[str, Any], name: str) -> bytes:
    """Return the frame of these settings, with its own time."""
    state["count"] += 1
    taken = time.gmtime(START_S + 3 * state["count"])
    data = (ROOT / "frames" / name).read_bytes()
    stamp = time.strftime("%Y:%m:%d %H:%M:%S", taken).encode()
    return data.replace(STAMP, stamp)


def capture(state: dict[str, Any], pattern: str) -> None:
    what = trouble(state, "capture")
    if what == "busy":
        raise Fails(BUSY)
    if what == "hang":
        time.sleep(600)
    if what == "unplug":
        state["plugged"] = False
        save(state)
        raise Fails("ERROR: Could not capture image.\nERROR: Could not capture.\n" + BROKEN)
    name = f"{state['config']['iso']['current']}_{state['config']['shutterspeed']['current'].replace('/', '-')}.dng"
    if what == "wrong":
        name = "wrong.dng"
    last = ROOT / "last"
    data = last.read_bytes() if what == "same" and last.exists() else develop(state, name)
    last.write_bytes(data)
    on_card = CARD / f"DSC{state['count']:05d}.DNG"
    if state["keeps"] and what != "lost":
        on_card.write_bytes(data)
    save(state)
    print(f"New file is in location /DCIM/100FAKE/{on_card.name} on the camera", flush=True)
    time.sleep(state.get("slow_s", 0))
    suffix = "jpg" if what == "jpeg" else "DNG"
    target = Path(pattern.replace("%C", suffix))
    if what in ("download", "lost"):
        raise Fails(IO)
    if what == "unplug-download":
        state["plugged"] = False
        save(state)
        raise Fails(IO)
    if what == "hang-download":
        Path("tmpfileAbC123").write_bytes(data[:1000])
        time.sleep(600)
    if what in ("partial", "partial-well"):
        target.write_bytes(data[: len(data) // 2])
        if what == "partial":
            raise Fails(IO)
    elif what == "nothing":
        return
    else:
        print(f"Saving file as {target}", flush=True)
        temporary = Path("tmpfileAbC123")
        temporary.write_bytes(b"\xff\xd8 a JPEG" if what == "jpeg" else data)
        temporary.replace(target)
        (ROOT / "delivered").open("a").write(f"{name}\n")
    if what == "hang-after":
        time.sleep(600)
    on_card.unlink(missing_ok=True)
    print(f"Deleting file /DCIM/100FAKE/{on_card.name} on the camera")


def get_config(state: dict[str, Any], name: str) -> None:
    if name not in state["config"]:
        raise Fails(f"\n*** Error ***\n{name} not found in configuration tree.\n{BROKEN}")
    print(shown(name, state["config"][name]))


def set_config(state: dict[str, Any], text: str) -> None:
    name, _, value = text.partition("=")
    what = trouble(state, "set")
    if what == "fails":
        raise Fails(f"\n*** Error ***\n{name} not found in configuration tree.\n{BROKEN}")
    setting = state["config"][name]
    if value not in setting["choices"]:
        raise Fails(f"\n*** Error ***\nChoice {value} not found within list of choices.\n{BROKEN}")
    if what != "ignored":
        setting["current"] = value
        save(state)


def get_file(state: dict[str, Any], name: str, pattern: str) -> None:
    if trouble(state, "get") == "fails":
        raise Fails(IO)
    path = CARD / name
    if not path.is_file():
        raise Fails("*** Error (-108: 'File not found') ***\n")
    Path(pattern.replace("%C", path.suffix[1:])).write_bytes(path.read_bytes())
    print(f"Saving file as {pattern}")


def list_files() -> None:
    for path in sorted(CARD.iterdir()):
        size, seconds = path.stat().st_size, int(path.stat().st_mtime)
        print(f"FILENAME='/DCIM/100FAKE/{path.name}' PERMS=rd FILESIZE={size} FILETYPE=image/x-raw FILEMTIME={seconds}")


def answer(state: dict[str, Any], given: list[tuple[str, str]], ports: list[str]) -> None:
    """Do what the options ask for."""
    named = dict(given)
    what = trouble(state, "any")
    if what == "claimed":
        raise Fails(CLAIMED)
    if what == "hang":
        time.sleep(600)
    if named.get("--port", "") not in ports:
        raise Fails(NO_CAMERA)
    if "--list-config" in named:
        print("\n".join(f"/main/imgsettings/{name}" for name in state["config"]))
    for option, value in given:
        if option == "--get-config":
            get_config(state, value)
        elif option == "--set-config-value":
            set_config(state, value)
    if "--capture-image-and-download" in named:
        capture(state, named["--filename"])
    if "--get-file" in named:
        get_file(state, named["--get-file"], named["--filename"])
    if "--list-files" in named:
        list_files()


def main(arguments: list[str]) -> int:
    state = json.loads(STATE.read_text())
    with (ROOT / "calls").open("a") as file:
        file.write(json.dumps([arguments, os.environ["LC_ALL"]]) + "\n")
    options = iter(arguments)
    takes = ("--port", "--get-config", "--set-config-value", "--filename", "--folder", "--get-file")
    given = [(option, next(options) if option in takes else "") for option in options]
    named = dict(given)
    cameras = state["cameras"] if state["plugged"] else []
    try:
        if "--auto-detect" in named:
            print(f"{'Model':<30} {'Port':<16}\n{'-' * 58}")
            for model, port in cameras:
                print(f"{model:<30} {port:<16}")
            return 0
        answer(state, given, [port for _, port in cameras])
    except Fails as error:
        print(ADVICE, end="")
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main(sys.argv[1:]))
    except KeyboardInterrupt:
        sys.exit(130)
