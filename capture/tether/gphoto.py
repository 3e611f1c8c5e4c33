"""The program ``gphoto2``: its command lines, what it prints, and what its errors mean.

What was seen of the real program (2.5.28) and shaped this module:

- Its exit code is 1 for every failure, and 0 for a download that filled the disk: the file is then cut short under its
  final name. So an exit code of 0 proves nothing, and every frame is decoded before it counts.
- ``--set-config`` takes a number for a place in the list: 25 is the 26th choice, not 25 s. ``--set-config-value`` takes
  the text.
- Without a terminal it asks "Overwrite? [y|n]" and fails where a file exists: each shot has its own folder.
- It remembers the last port in ~/.gphoto/settings and uses it if none is given: so the port is always given.
- Messages follow the language of the environment; ``LC_ALL=C`` keeps them, and decimal points, readable.
"""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import tempfile
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import IO, TYPE_CHECKING, Final

from capture.capture_errors import CameraLostError, GphotoError
from eldata.base.fields import TextFile
from eldata.base.files import check_posix
from eldata.base.stopping import held

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

INSTALL: Final = "install it with: apt install gphoto2 (macOS: brew install gphoto2), or name it with --gphoto2 PATH"
PATTERN: Final = "frame.%C"  # %C is the camera's own extension: a JPEG beside the raw gets another name
LOG: Final = "gphoto2.log"
_GRACE_S: Final = 5.0
_MESSAGES: Final = Path(__file__).parents[1] / "templates" / "gphoto2.toml"
_CAMERA: Final = re.compile(r"(?P<model>\S.*?)\s+(?P<port>[a-z0-9]+:\S.*?)\s*")
_NO_CAPTURE_PORTS: Final = ("disk:", "usbdiskdirect:", "usbscsi:")  # memory cards, which are listed too
_NEW_FILE: Final = re.compile(r"New file is in location (?P<path>/.*?) on the camera")
_LISTED: Final = re.compile(r"FILENAME='(?P<path>/[^']*)'.*?FILESIZE=\s*\d+(?:.*?FILEMTIME=(?P<time>\d+))?")
_CHOICE: Final = re.compile(r"Choice: (?P<index>\d+) (?P<text>.*)")


@dataclass(frozen=True, slots=True)
class Setting:
    """A setting as the camera has it now; ``choices`` is empty if it is not a list."""

    name: str
    current: str
    choices: tuple[str, ...] = ()
    read_only: bool = False


def set_arguments(values: dict[str, str]) -> list[str]:
    """Return the options that set some settings, by the camera's own text."""
    return [part for name, value in values.items() for part in ("--set-config-value", f"{name}={value}")]


def get_arguments(names: Sequence[str]) -> list[str]:
    """Return the options that read some settings."""
    return [part for name in names for part in ("--get-config", name)]


CAPTURE: Final = ("--capture-image-and-download", "--filename", PATTERN, "--force-overwrite")


@dataclass(frozen=True, slots=True)
class Gphoto:
    """The program, and the camera that it is to talk to.

    Attributes
    ----------
    program
        Its path.
    port
        The camera's, as ``usb:001,005``; empty for the only one.
    timeout_s
        How long a command may take beyond the exposure; then it is killed with all that it started.
    inherited
        File descriptors that the program keeps open: the session's lock, which so outlives a killed session for as long
        as its gphoto2 is still downloading.
    started
        Called with the process id of each run.
    """

    program: str
    port: str = ""
    timeout_s: float = 60.0
    inherited: tuple[int, ...] = ()
    started: Callable[[int], None] | None = None

    @classmethod
    def find(cls, name: str, *, timeout_s: float) -> Gphoto:
        """Return the program of this name or path.

        Raises
        ------
        GphotoError
            If it is not installed.
        EldataError
            If this system cannot run a session (:func:`~eldata.base.files.check_posix`).
        """
        check_posix("tethered capture")
        path = shutil.which(name)
        if path is None:
            raise GphotoError(f"{name}: program not found; {INSTALL}")
        return cls(str(Path(path).absolute()), timeout_s=timeout_s)

    def command(self, *arguments: str) -> list[str]:
        """Return a whole command line."""
        return [self.program, *(("--port", self.port) if self.port else ()), *arguments]

    # --- what it is asked ---------------------------------------------------------------------------------------------

    def detect(self) -> dict[str, str]:
        """Return the models of the cameras that can be reached, by port; without memory cards, which are listed too.

        Asked without a port: given one, the program lists it whether or not a camera is there.
        """
        return parse_cameras(self._run(["--auto-detect"]))

    def setting_names(self) -> tuple[str, ...]:
        """Return the names of the camera's settings, without their sections."""
        lines = self._run(["--list-config"]).splitlines()
        return tuple(line.strip().rpartition("/")[2] for line in lines if line.startswith("/"))

    def settings(self, names: Sequence[str]) -> dict[str, Setting]:
        """Read some settings of the camera."""
        found = parse_settings(self._run(get_arguments(names)))
        if len(found) != len(names):
            raise GphotoError(
                f"gphoto2 was asked for {', '.join(names)} and returned {len(found)} of {len(names)} settings"
            )
        return {name: Setting(name, *one) for name, one in zip(names, found, strict=True)}

    def set(self, values: dict[str, str]) -> None:
        """Set some settings."""
        self._run(set_arguments(values))

    def capture(self, folder: Path, exposure_s: float) -> None:
        """Release, and download what the camera took into an empty folder as ``frame.<its extension>``.

        What the program says is kept beside it, so that a later session still knows where on the card the frame is.
        """
        # Twice the exposure: a camera whose long-exposure noise reduction is on takes a dark frame of equal length.
        with (folder / LOG).open("ab+") as log:
            self._run(list(CAPTURE), folder=folder, limit_s=2 * exposure_s + self.timeout_s, log=log)

    def card(self) -> tuple[PurePosixPath, ...]:
        """List the files on the camera, oldest first as far as it says."""
        return parse_card(self._run(["--parsable", "--list-files"]))

    def fetch(self, path: PurePosixPath, folder: Path) -> None:
        """Download a file from the camera as ``frame.<its extension>``; it stays on the camera."""
        arguments = ["--folder", str(path.parent), "--get-file", path.name, "--filename", PATTERN, "--force-overwrite"]
        self._run(arguments, folder=folder)

    # --- the process --------------------------------------------------------------------------------------------------

    def _run(
        self,
        arguments: list[str],
        *,
        folder: Path | None = None,
        limit_s: float | None = None,
        log: IO[bytes] | None = None,
    ) -> str:
        """Run a command; return its output and errors as one text.

        Raises
        ------
        CameraLostError
            If the camera is out of reach, or the program hangs and was killed.
        GphotoError
            If it fails in another way.
        """
        if log is None:
            # A file, not a pipe: a helper that the program leaves behind would keep a pipe open.
            with tempfile.TemporaryFile() as file:
                return self._run(arguments, folder=folder, limit_s=limit_s, log=file)
        limit_s = self.timeout_s if limit_s is None else limit_s
        begun = log.seek(0, os.SEEK_END)
        process: subprocess.Popen[bytes] | None = None
        try:
            with held():  # a process that nobody knows of yet could not be ended
                process = self._start(arguments, folder, log)
            if self.started is not None:
                self.started(process.pid)
            code = process.wait(limit_s)
        except subprocess.TimeoutExpired:
            _end(process)
            raise CameraLostError(
                f"gphoto2 {arguments[0]} did not end within {limit_s:g} s and was ended: switch the camera off and on, "
                "check cable and battery; if it is only slow, give more time with --timeout",
                _text(log, begun),
            ) from None
        except BaseException:  # Ctrl-C above all: nothing may go on that the journal does not know of
            _end(process)
            raise
        output = _text(log, begun)
        if code != 0:
            raise explained(arguments[0], output)
        return output

    def _start(self, arguments: list[str], folder: Path | None, log: IO[bytes]) -> subprocess.Popen[bytes]:
        environment = {name: value for name, value in os.environ.items() if name not in ("LANGUAGE", "LC_MESSAGES")}
        try:
            return subprocess.Popen(  # noqa: S603 # arguments as a list, no shell
                self.command(*arguments),
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                cwd=folder,
                env=environment | {"LC_ALL": "C", "LANG": "C"},
                # A group of its own: it can be ended with all that it started, and Ctrl-C does not end it half-way.
                start_new_session=True,
                pass_fds=self.inherited,
            )
        except OSError as error:
            raise GphotoError(f"{self.program} cannot be run ({error.strerror}); {INSTALL}") from error


def _end(process: subprocess.Popen[bytes] | None) -> None:
    """End a process and all that it started: first with the interrupt that lets it close the camera's session."""
    if process is None:  # it was not started
        return
    for number in (signal.SIGINT, signal.SIGKILL):
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, number)
        with suppress(subprocess.TimeoutExpired):
            process.wait(_GRACE_S)
            break
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, signal.SIGKILL)  # a helper that outlived its parent
    process.wait()


def _text(log: IO[bytes], begun: int) -> str:
    log.seek(begun)
    return log.read().decode("utf-8", "replace")


def explained(what: str, output: str) -> GphotoError:
    """Return the error that a failed command stands for, to be raised."""
    known = TextFile(_MESSAGES, GphotoError).toml()
    boilerplate = known.texts("boilerplate")
    said = " ".join(line for line in map(str.strip, output.splitlines()) if not line.startswith(boilerplate))
    said = re.sub(r"\*\*\* Error[ *]*\*\*\*", " ", said).replace("*** Error", "").replace("***", "")
    said = " ".join(said.split())[:300] or "nothing"
    for message in known.objects("message"):
        if re.search(message.text("pattern"), output, re.IGNORECASE):
            kind = CameraLostError if message.flag("lost") else GphotoError
            return kind(f"{message.text('advice')}. gphoto2 {what} said: {said}", output)
    return GphotoError(f"gphoto2 {what} failed and said: {said}", output)


# --- what it prints ---------------------------------------------------------------------------------------------------


def parse_cameras(output: str) -> dict[str, str]:
    """Return the cameras of ``--auto-detect``, models by port."""
    lines = output.splitlines()
    rule = next((index for index, line in enumerate(lines) if line.startswith("-----")), len(lines))
    matches = (_CAMERA.fullmatch(line) for line in lines[rule + 1 :])
    found = {one["port"]: one["model"] for one in matches if one is not None}
    return {port: model for port, model in found.items() if not port.startswith(_NO_CAPTURE_PORTS)}


def parse_settings(output: str) -> list[tuple[str, tuple[str, ...], bool]]:
    """Return the settings of ``--get-config``, in their order: current value, choices, whether read-only."""
    found: list[tuple[str, tuple[str, ...], bool]] = []
    current: str | None = None
    choices: list[str] = []
    read_only = False
    for line in output.splitlines():
        text = line.strip()
        if text.startswith("Label:"):
            current, choices, read_only = None, [], False
        elif text.startswith("Readonly:"):
            read_only = text.endswith("1")
        elif text.startswith("Current:"):
            current = text.removeprefix("Current:").strip()
        elif (choice := _CHOICE.fullmatch(text)) is not None:
            choices.append(choice["text"].strip())
        elif text == "END" and current is not None:
            found.append((current, tuple(choices), read_only))
            current = None
    return found


def parse_card(output: str) -> tuple[PurePosixPath, ...]:
    """Return the files of ``--parsable --list-files``, oldest first by the camera's clock, then by name."""
    matches = (_LISTED.search(line) for line in output.splitlines())
    found = sorted((int(one["time"] or 0), one["path"]) for one in matches if one is not None)
    return tuple(PurePosixPath(path) for _, path in found)


def parse_taken(output: str) -> tuple[PurePosixPath, ...]:
    """Return where on the camera the frames of a capture are."""
    return tuple(PurePosixPath(one["path"]) for one in _NEW_FILE.finditer(output))
