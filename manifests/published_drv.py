"""The published Dark Raw Video dataset (DRV): its clips and splits, and its rows.

Sources: C. Chen, Q. Chen, M. N. Do and V. Koltun, "Seeing Motion in the Dark", ICCV 2019; the DRV repository's lists of
clips, train.py, test_video.py and test_image.py.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from eldata.base.fields import TextFile
from eldata.base.files import write_text
from eldata.base.tables import csv_text
from eldata.errors import ManifestError
from eldata.manifest.layouts import DYNAMIC
from eldata.records import FrameRecord

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

CAMERA = "SonyRX100M6"
DYNAMIC_CLIPS = tuple(f"M{number:04d}" for number in range(23))

_COLUMNS = ("scene", "split")


def drv_records(split_of: Mapping[str, str]) -> tuple[FrameRecord, ...]:
    """Return the rows of the preprocessed form for clips and their splits, sorted by path."""
    rows = []
    for clip, split in split_of.items():
        reference = None if split == DYNAMIC else f"long/{clip}/half0001*.png"
        noisy = f"VBM4D_rawRGB/{clip}/*.png"
        rows.append(FrameRecord(noisy, "noisy", CAMERA, scene=clip, split=split, reference=reference))
        if reference is not None:
            rows.append(FrameRecord(reference, "reference", CAMERA, scene=clip, split=split))
    return tuple(sorted(rows, key=lambda row: row.path))


def splits_from_lists(lists: Mapping[str, Path]) -> dict[str, str]:
    """Return the split of each clip from the official lists, by split, with the dynamic clips; sorted by clip.

    Raises
    ------
    ManifestError
        If a clip is listed twice.
    """
    split_of: dict[str, str] = {}
    for split, path in lists.items():
        for clip in TextFile(path, ManifestError).text().split():
            if clip in split_of:
                raise ManifestError(f"{path}: clip {clip} is in split {split_of[clip]} already")
            split_of[clip] = split
    return dict(sorted(split_of.items())) | dict.fromkeys(DYNAMIC_CLIPS, DYNAMIC)


def save_splits(path: Path, split_of: Mapping[str, str]) -> None:
    """Write the table of clips."""
    write_text(path, csv_text(_COLUMNS, split_of.items()))


def load_splits(path: Path) -> dict[str, str]:
    """Read the table of clips."""
    return {row.text("scene"): row.text("split") for row in TextFile(path, ManifestError).rows(_COLUMNS)}
