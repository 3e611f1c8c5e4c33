"""Files of ``torch.export``, written, and loaded without a pickle.

``torch.export.load`` unpickles whatever of an archive its lists of weights and constants call pickled, its example
inputs too, and loads compiled libraries (torch 2.13, ``torch/export/pt2_archive/_package.py``). Networks need none of
it. So only archives are loaded whose members are plain tensors and descriptions, and torch is held to
``weights_only`` for the rest.
"""

from __future__ import annotations

import copy
import io
import os
import re
import zipfile
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from eldata.base.fields import TextFile, names_of
from eldata.base.files import atomic_write, json_text
from eldata.baselines.consistency import checked_window
from eldata.errors import EldataError, FileError, check_choice
from eldata.raw.levels import CLIP_RANGES

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from eldata.raw.levels import Clip

# Below the archive's own folder. torch looks members up without regard to case.
_PLAIN = re.compile(
    r"(?:archive_format|archive_version|version|byteorder|\.data/(?:version|serialization_id)|\.format_version"
    r"|\.storage_alignment|models/model\.json|data/sample_inputs/model\.pt|extra/.*"
    r"|data/weights/(?:weight_\d+|model_weights_config\.json)"
    r"|data/constants/(?:tensor_\d+|model_constants_config\.json))"
)
_FORCED = "TORCH_FORCE_WEIGHTS_ONLY_LOAD"
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
        reason = (str(error).strip().splitlines() or [type(error).__name__])[0][:200]
        raise EldataError(f"torch.export cannot follow {type(network).__name__}: {reason}") from error
    record = {"schema": _SCHEMA, **asdict(TakenInput(window, multiple, clip))}
    with atomic_write(path) as file:
        torch.export.save(exported, file, extra_files={_RECORD: json_text(record)})


def load_exported(path: Path) -> tuple[Any, TakenInput]:
    """Return the module of a file of ``torch.export.save``, and what :func:`save_network` has recorded in it.

    Raises
    ------
    FileError
        If it is not one, or holds what only a pickle or a compiled library tells.
    """
    import torch

    try:
        content = path.read_bytes()  # once: what is looked at is what is loaded
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            names = [name.partition("/")[2] for name in archive.namelist()]
    except (OSError, zipfile.BadZipFile) as error:
        raise FileError(path, f"is not an archive of torch.export: {error}") from error
    others = sorted({name for name in names if not _PLAIN.fullmatch(name.lower())})
    if others:
        raise FileError(
            path,
            f"holds {', '.join(others[:3])}, which a network does not need and which torch.export may unpickle or run. "
            "Export the network alone: torch.export.save(torch.export.export(network, ...), file)",
        )
    extra = {_RECORD: ""}
    try:
        with _weights_only():
            module = torch.export.load(io.BytesIO(content), extra_files=extra).module()
    except Exception as error:  # torch.export raises what its parts raise
        reason = (str(error).strip().splitlines() or [type(error).__name__])[0][:200]
        raise FileError(path, f"cannot be loaded by torch.export, without pickles: {reason}") from error
    return module, _taken(path, extra[_RECORD]) if extra[_RECORD] else TakenInput()


def _taken(path: Path, content: str | bytes) -> TakenInput:
    record = TextFile(f"{path}, {_RECORD}", EldataError, "export it again with save_network", content).json()
    record.schema(_SCHEMA)
    record.only(("schema", *names_of(TakenInput)))
    window = record.optional("window", record.whole, at_least=1, at_most=_MOST_FRAMES)
    if window is not None and window % 2 == 0:
        raise record.wrong("window", "an odd number of frames", window)
    multiple = record.optional("multiple", record.whole, at_least=1, at_most=_LARGEST_MULTIPLE)
    return TakenInput(window, multiple, record.optional("clip", record.choice, known=tuple(CLIP_RANGES)))


@contextmanager
def _weights_only() -> Iterator[None]:
    """Hold every ``torch.load`` in the block to ``weights_only``, whatever it is asked for."""
    before = os.environ.get(_FORCED)
    os.environ[_FORCED] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ[_FORCED]
        else:
            os.environ[_FORCED] = before
