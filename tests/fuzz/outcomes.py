"""What came of one trial, in one word, and how it is told from other failures of its sort."""

from __future__ import annotations

import traceback
from dataclasses import dataclass
from typing import TYPE_CHECKING

from eldata.errors import EldataError

if TYPE_CHECKING:
    from pathlib import Path

READ, REFUSED = "read", "refused"
# What must not happen, with what it means.
FAILURES = {
    "crash": "the process died",
    "hang": "more than the allowed time, of the processor or waiting",
    "memory": "more than the allowed memory, or an attempt at it",
    "exception": "another exception than ours: a traceback, or an 'unexpected' line",
    "message": "our error, but of several lines, or one that does not name the file",
    "silent": "read with other pixels than the whole file's, though the damage can be told",
    "escaped": "a file was written outside of the folder",
}
OUTCOMES = (READ, REFUSED, *FAILURES)


@dataclass(frozen=True)
class Outcome:
    """What came of a trial: one of :data:`OUTCOMES`, the failure's sort, and what was said."""

    word: str
    sort: str = ""
    text: str = ""


def of_error(error: BaseException, folder: Path, *, names_file: bool) -> Outcome:
    """Return the outcome of a reader that raised."""
    chain: list[BaseException] = [error]
    while (cause := chain[-1].__cause__ or chain[-1].__context__) is not None and cause not in chain:
        chain.append(cause)
    text = "".join(traceback.format_exception(error))
    # Where memory is refused here, a machine without our limit would have given it.
    if any(isinstance(one, MemoryError) for one in chain):
        return Outcome("memory", f"MemoryError {_place(chain[-1])}", text)
    if not isinstance(error, EldataError):
        return Outcome("exception", f"{type(error).__name__} {_place(error)}", text)
    message = str(error)
    if "\n" in message or "\r" in message:
        return Outcome("message", f"several lines {_place(error)}", text)
    if names_file and str(folder) not in message:
        return Outcome("message", f"does not name the file {_place(error)}", text)
    return Outcome(REFUSED, text=message)


def _place(error: BaseException) -> str:
    """The innermost of our functions that an error came through."""
    ours = [
        frame
        for frame in traceback.extract_tb(error.__traceback__)
        if any(f"/{package}/" in frame.filename for package in ("eldata", "capture", "manifests"))
        and "/tests/" not in frame.filename
    ]
    return f"in {ours[-1].name} ({'/'.join(ours[-1].filename.split('/')[-3:])}:{ours[-1].lineno})" if ours else ""


def of_dump(dump: str) -> str:
    """The innermost of our functions in what faulthandler wrote of a process that died."""
    ours = [
        line.strip()
        for line in dump.splitlines()
        if line.lstrip().startswith("File ") and any(f"/{package}/" in line for package in ("eldata", "capture"))
    ]
    first = next((line for line in ours if "/tests/" not in line), "")
    kind = next((line for line in dump.splitlines() if line.startswith("Fatal Python error")), "")
    return f"{kind.removeprefix('Fatal Python error: ')} {first.replace('File ', '')}".strip()
