"""Files of ``torch.export``: networks with what they take, written and loaded."""

from __future__ import annotations

import copy
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from eldata.base.fields import TextFile, names_of
from eldata.base.files import atomic_write, json_text
from eldata.base.numbers import checked_whole
from eldata.errors import ArgumentError, EldataError, FileError, check_choice
from eldata.raw.levels import CLIP_RANGES, Clip

if TYPE_CHECKING:
    from pathlib import Path


_RECORD = "eldata.json"  # among the archive's extra files
_SCHEMA = 1
_MOST_FRAMES = 99
_LARGEST_MULTIPLE = 1 << 12


@dataclass(frozen=True, slots=True)
class TakenInput:
    """What a network takes, as far as its file says.

    Attributes
    ----------
    window
        Frames of a clip, of which it predicts the middle one; 1: single frames.
    multiple
        What heights and widths are multiples of.
    clip
        Of the inputs that it was trained with.
    """

    window: int | None = None
    multiple: int | None = None
    clip: Clip | None = None


def save_network(
    network: Any, path: Path | str, *, channels: int, multiple: int = 16, window: int = 1, clip: Clip | None = None
) -> None:
    """Write a torch module as a file of torch.export (``.pt2``), as ``eldata predict`` runs it.

    The file records ``window``, ``multiple`` and ``clip``; predictions with others are refused.

    Parameters
    ----------
    network
        A ``torch.nn.Module`` of one tensor, (1, C, h, w) or, of a window of T > 1 frames, (1, T, C, h, w), to
        (1, C, h, w); it is copied to the CPU.
    path
        To write to.
    channels
        C.
    multiple
        What heights and widths are multiples of; they are free otherwise, from two of these on.
    window
        T, odd: the frames of a clip of which the network predicts the middle one.
    clip
        Of the inputs that it was trained with; ``None``: it is not recorded.

    Raises
    ------
    EldataError
        If torch.export cannot follow the module.
    ArgumentError
        If the window is even, or ``clip`` is unknown.
    """
    import torch

    frames = () if checked_window(window) == 1 else (window,)
    if clip is not None:
        check_choice("clip", clip, CLIP_RANGES)
    # A copy: the caller's network, perhaps in training on a GPU, stays where and as it is. What predicts neither drops
    # values at random nor updates its batch statistics, which is what torch's eval() switches off.
    alone = copy.deepcopy(network).cpu().eval()
    example = torch.zeros(1, *frames, channels, 4 * multiple, 6 * multiple)
    first = example.ndim - 2
    sides = {place: multiple * torch.export.Dim(name, min=2, max=4096) for place, name in enumerate("hw", first)}
    try:
        exported = torch.export.export(alone, (example,), dynamic_shapes=(sides,))
    except Exception as error:  # torch.export raises what its parts raise
        raise EldataError(f"torch.export cannot follow {type(network).__name__}: {first_line(error)}") from error
    record = {"schema": _SCHEMA, **asdict(TakenInput(window, multiple, clip))}
    with atomic_write(path) as file:
        torch.export.save(exported, file, extra_files={_RECORD: json_text(record)})


def load_exported(path: Path) -> tuple[Any, TakenInput]:
    """Load a module of ``torch.export.save``, and the record that :func:`save_network` left in its file.

    Raises
    ------
    FileError
        If it is not one.
    """
    import torch

    extra = {_RECORD: ""}
    try:
        module = torch.export.load(path, extra_files=extra).module()
    except Exception as error:  # torch.export raises what its parts raise
        raise FileError(path, f"cannot be loaded by torch.export: {first_line(error)}") from error
    return module, _read_record(path, extra[_RECORD]) if extra[_RECORD] else TakenInput()


def _read_record(path: Path, content: str | bytes) -> TakenInput:
    """Read the window, size multiple and clip range that :func:`save_network` has recorded."""
    content = content.encode() if isinstance(content, str) else content
    record = TextFile(f"{path}, {_RECORD}", EldataError, "export it again with save_network", content).json()
    record.schema(_SCHEMA)
    record.only(("schema", *names_of(TakenInput)))
    window = record.optional("window", record.whole, at_least=1, at_most=_MOST_FRAMES)
    if window is not None and window % 2 == 0:
        raise record.wrong("window", "an odd number of frames", window)
    multiple = record.optional("multiple", record.whole, at_least=1, at_most=_LARGEST_MULTIPLE)
    return TakenInput(window, multiple, record.optional("clip", record.choice, known=tuple(CLIP_RANGES)))


def checked_window(window: int) -> int:
    """Return a window's number of frames; raise :class:`ArgumentError` unless it is odd, as its middle is predicted."""
    if checked_whole("window", window, at_least=1) % 2 == 0:
        raise ArgumentError(f"the middle frame of a window is predicted, so their number is odd; found {window}")
    return window


def first_line(error: BaseException) -> str:
    """Take the first line of an error's message, 200 characters at most; its type if it has none."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0][:200]
