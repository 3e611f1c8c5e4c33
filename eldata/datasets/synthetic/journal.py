"""What a run of :func:`~eldata.datasets.synthetic.synthesis.synthesize` has finished, so that the same call goes on.

``OUT/.begun.jsonl`` is there from the first file to the last: its first line says what was begun, each other which
scene is whole, with the hashes of its files. Lines are only appended; a last one without its end was being written, and
is cut off.
"""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import asdict, dataclass
from typing import IO, TYPE_CHECKING

from eldata.base.fields import TextFile
from eldata.base.files import can_lock, check_same_work, json_text, remove_leftovers, write_text
from eldata.errors import DatasetError, EldataError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from fractions import Fraction
    from pathlib import Path

    from eldata.base.fields import Fields

NAME = ".begun.jsonl"
FORMAT = "eldata synthesize"
VERSION = 2


@dataclass(frozen=True, slots=True)
class CleanFacts:
    """What a scene's rows and parameters need to know of its clean frame."""

    iso: Fraction
    exposure_s: Fraction
    width: int
    height: int
    model: str
    cfa: str


@dataclass(frozen=True, slots=True)
class WrittenScene:
    """A scene whose files are whole: ``sha256`` by name."""

    index: int
    clean: CleanFacts
    sha256: Mapping[str, str]


class SynthesisJournal:
    """The journal of one folder; use it through :func:`opened_journal`."""

    def __init__(self, path: Path, file: IO[bytes], written: Mapping[int, WrittenScene]) -> None:
        self._path, self._file = path, file
        self.written = written

    def add(self, scene: WrittenScene) -> None:
        """Note a scene, unless it is noted already."""
        if self.written.get(scene.index) == scene:
            return
        facts = asdict(scene.clean) | {"iso": str(scene.clean.iso), "exposure_s": str(scene.clean.exposure_s)}
        line = {"scene": scene.index, "clean": facts, "sha256": dict(scene.sha256)}
        try:
            self._file.write(json_text(line, indent=None).encode())
            self._file.flush()
        except OSError as error:
            raise EldataError(f"cannot write {self._path}: {error.strerror}") from error

    def finish(self) -> None:
        """Remove it: all is written."""
        self._path.unlink()


@contextmanager
def opened_journal(folder: Path, begun: Mapping[str, object]) -> Iterator[SynthesisJournal]:
    """Begin work in a new or empty folder, or go on with the same work in it.

    Parameters
    ----------
    folder
        The run's own.
    begun
        What must be the same, of plain types.

    Raises
    ------
    DatasetError
        If the folder holds something else.
    ArgumentError
        If something else was begun in it.
    EldataError
        If another process works in it, or it cannot be written.
    """
    path = folder / NAME
    begun = {"format": FORMAT, "version": VERSION} | dict(begun)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        remove_leftovers(folder)
        if not path.exists():
            if any(folder.iterdir()):
                raise DatasetError(f"{folder}: holds something already; give a new folder")
            write_text(path, json_text(begun, indent=None))
        file = path.open("r+b")
    except OSError as error:
        raise EldataError(f"cannot make {error.filename}: {error.strerror}") from error
    with file:
        if can_lock(file.fileno()) is False:
            raise EldataError(f"{folder}: another process is writing it; wait for that one")
        advice = f"remove {folder} to start again"
        first, *rest = file.read().splitlines(keepends=True) or [b""]
        check_same_work(folder, TextFile(path, EldataError, advice, first).json().data, begun)
        whole = [line for line in rest if line.endswith(b"\n")]
        scenes = [
            _scene(TextFile(f"{path}, line {n}", EldataError, advice, line).json()) for n, line in enumerate(whole, 2)
        ]
        file.seek(len(first) + sum(map(len, whole)))
        file.truncate()
        yield SynthesisJournal(path, file, {scene.index: scene for scene in scenes})


def _scene(line: Fields) -> WrittenScene:
    clean, sums = line.inside("clean"), line.inside("sha256")
    facts = CleanFacts(
        iso=clean.fraction("iso"),
        exposure_s=clean.fraction("exposure_s"),
        width=clean.whole("width"),
        height=clean.whole("height"),
        model=clean.text("model", empty=True),
        cfa=clean.text("cfa"),
    )
    return WrittenScene(line.whole("scene"), facts, {name: sums.text(name) for name in sums.data})
