"""The journal of a session: what was about to be done and what was done, each as a line of JSON synced to disk.

``intent`` comes before the release, ``done`` after the frame has its final name; so after a crash at any moment an
intent without an end says which frame to look for. Lines are only ever appended. A last line without its line end was
being written when the power went: it never happened, and is cut off.
"""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import dataclass, field, replace
from datetime import datetime
from typing import TYPE_CHECKING, Any, Final

from capture.capture_errors import JournalError
from capture.placing import rename_to_new
from capture.plan import CALIBRATION
from eldata.base.fields import TextFile

if TYPE_CHECKING:
    from pathlib import Path

    from capture.matching import Slot
    from capture.plan import Plan
    from capture.shots import Shot
    from eldata.base.fields import Fields

NAME: Final = "journal.jsonl"
SCHEMA: Final = 1
_ADVICE: Final = "if the file was edited, bring the old one back; else go on in a new folder"
_EVENTS: Final = ("plan", "intent", "done", "wrong", "failed")


@dataclass(frozen=True, slots=True)
class Entry:
    """A line about a shot.

    Attributes
    ----------
    event
        ``"intent"``, ``"done"``, ``"wrong"`` (a frame with other settings, kept aside) or ``"failed"`` (no frame).
    slot
        Scene, or ``"calibration"``, and number.
    shot
        What was to be taken (:func:`fingerprint`).
    token
        Which attempt; also the name of its folder.
    details
        The rest: file, size, hash and EXIF of a frame, or why there is none.
    """

    event: str
    slot: Slot
    shot: str
    token: str
    details: dict[str, Any] = field(default_factory=dict)


def fingerprint(plan: Plan, shot: Shot) -> str:
    """Return what makes a shot the same: camera, role, settings and place in the protocol."""
    what = [shot.role, f"ISO {shot.iso}", f"{shot.setting.dial} s"]
    if shot.factor is not None:
        what.append(f"x{shot.factor} of {shot.reference}")
    if shot.level is not None:
        what.append(f"level {shot.level}")
    if shot.series:
        what.append(shot.series)
    return f"{plan.camera.name}: {', '.join(what)}"


def digest_of(plan: Plan) -> str:
    """Return the hash of a plan's shots; notes do not count."""
    shots = [[scene, shot.number, fingerprint(plan, shot)] for scene, shot in plan.shots]
    return f"sha256:{hashlib.sha256(json.dumps(shots).encode()).hexdigest()}"


class Journal:
    """The journal of one folder, open for appending; or only read, and not touched, if it is not to be ``writable``.

    To write, the caller must hold the folder's lock.

    Raises
    ------
    JournalError
        If a line other than the last is not an entry, or the file cannot be read.
    """

    def __init__(self, path: Path, *, writable: bool = True) -> None:
        self.path = path
        self.plans: list[str] = []
        self.entries: list[Entry] = []
        whole = self._read()
        if not writable:
            return
        try:
            with path.open("ab") as file:
                if file.tell() > whole:
                    file.truncate(whole)
                    os.fsync(file.fileno())
            _sync_folder(path.parent)
        except OSError as error:
            raise JournalError(f"{path}: cannot be written to ({error.strerror})") from error

    # --- reading ------------------------------------------------------------------------------------------------------

    def _read(self) -> int:
        """Take in the whole lines; return their number of bytes."""
        try:
            data = self.path.read_bytes()
        except FileNotFoundError:
            return 0
        except OSError as error:
            raise JournalError(f"{self.path}: cannot be read ({error.strerror})") from error
        whole = data.rfind(b"\n") + 1
        for number, line in enumerate(data[:whole].splitlines(), 1):
            self._take(TextFile(f"{self.path}, line {number}", JournalError, _ADVICE, line).json())
        return whole

    def _take(self, line: Fields) -> None:
        event = line.choice("event", _EVENTS)
        if event == "plan":
            line.schema(SCHEMA, "capture")
            self.plans.append(line.text("digest"))
            return
        slot = (line.text("scene"), line.whole("number"))
        details = {key: value for key, value in line.data.items() if key not in _COMMON}
        self.entries.append(Entry(event, slot, line.text("shot"), line.text("token"), details))

    def done(self) -> dict[Slot, Entry]:
        """Return the frames that were taken, by shot; of several the last."""
        return {entry.slot: entry for entry in self.entries if entry.event == "done"}

    def open_intents(self) -> tuple[Entry, ...]:
        """Return the shots that were begun, and whose outcome is unknown."""
        ended = {entry.token for entry in self.entries if entry.event != "intent"}
        return tuple(entry for entry in self.entries if entry.event == "intent" and entry.token not in ended)

    # --- writing ------------------------------------------------------------------------------------------------------

    def write_plan(self, plan: Plan) -> None:
        """Note the plan that is followed from here on, if it has changed."""
        digest = digest_of(plan)
        if self.plans[-1:] != [digest]:
            self._append({"event": "plan", "schema": SCHEMA, "digest": digest, "camera": plan.camera.name})
            self.plans.append(digest)

    def write(self, entry: Entry) -> Entry:
        """Append an entry, and return it; it is on the disk when this returns."""
        scene, number = entry.slot
        line = {"event": entry.event, "scene": scene, "number": number, "shot": entry.shot, "token": entry.token}
        self._append(line | entry.details)
        self.entries.append(entry)
        return entry

    def end(self, intent: Entry, event: str, **details: Any) -> None:
        """Append what became of an intent."""
        self.write(replace(intent, event=event, details=details))

    def _append(self, line: dict[str, Any]) -> None:
        stamped = line | {"time": datetime.now().astimezone().isoformat(timespec="milliseconds")}
        data = json.dumps(stamped, ensure_ascii=False).encode() + b"\n"
        try:
            with self.path.open("ab") as file:
                begun = file.tell()
                try:
                    file.write(data)
                    file.flush()
                    os.fsync(file.fileno())
                except OSError:
                    file.truncate(begun)  # half a line would run into the next one
                    raise
        except OSError as error:
            raise JournalError(
                f"{self.path}: cannot be written to ({error.strerror}); make room on the disk, then run this again"
            ) from error

    # --- the plan that it belongs to ----------------------------------------------------------------------------------

    def check(self, plan: Plan, path: Path | str) -> None:
        """Refuse a plan in which a shot that was taken here has changed or is gone.

        A plan that was changed only where nothing is taken yet, such as by metering a later scene again, is accepted;
        so is one where the frames of the changed scene were deleted.

        Raises
        ------
        JournalError
            If so; the message names the scene, and what to do.
        """
        if not self.plans or self.plans[-1] == digest_of(plan):
            return
        now = {(scene, shot.number): fingerprint(plan, shot) for scene, shot in plan.shots}
        for entry in self.done().values():
            file = self.path.parent / str(entry.details.get("file"))
            if now.get(entry.slot) == entry.shot or not file.is_file():
                continue
            scene, number = entry.slot
            asks = now.get(entry.slot, "no such shot")
            again = "the calibration frames" if scene == CALIBRATION else scene
            raise JournalError(
                f"{path} was changed after {again} had been begun here: {file.name} was taken as {entry.shot}, and the "
                f"plan now asks for {asks} as frame {number}. Bring the old plan back to go on with it; or, to follow "
                f"the new one, move the files of {again} away from {file.parent}, or take another folder (-o)"
            )


_COMMON: Final = frozenset(("event", "scene", "number", "shot", "token", "time"))


def _sync_folder(folder: Path) -> None:
    """Sync the names of renamed and new files to the disk."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def place(source: Path, target: Path) -> None:
    """Give a file its final name, content and name synced to disk; never over another file.

    Raises
    ------
    JournalError
        If the target is there already, or the disk refuses.
    """
    try:
        with source.open("rb") as file:
            os.fsync(file.fileno())
        rename_to_new(source, target)
        _sync_folder(target.parent)
    except FileExistsError:
        raise JournalError(f"{target} is there already, and this session did not take it: move it away") from None
    except OSError as error:
        raise JournalError(f"{target}: cannot be written ({error.strerror})") from error
