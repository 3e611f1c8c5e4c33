"""The published Dark Raw Video dataset (DRV): its clips and splits, and its card.

Sources: C. Chen, Q. Chen, M. N. Do and V. Koltun, "Seeing Motion in the Dark", ICCV 2019; the DRV repository's lists of
clips, train.py, test_video.py and test_image.py.
"""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from eldata.base.fields import TextFile
from eldata.base.files import write_text
from eldata.base.tables import csv_text
from eldata.errors import ManifestError
from eldata.manifest.card import CameraCard, Card, Download, Subset
from eldata.manifest.drv import DYNAMIC
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


_HOST = "https://storage.googleapis.com/isl-datasets/DRV"


def published_drv(split_of: Mapping[str, str]) -> tuple[Card, tuple[FrameRecord, ...]]:
    """Return card and rows of the published set in its preprocessed form."""
    records = drv_records(split_of)
    subsets = [
        Subset(
            name=split,
            title=f"static clips of the {split} split",
            source=f"DRV repository, commit e3e81e7, DRV/{split}_list.txt",
            pairs=sum(value == split for value in split_of.values()),
            splits=(split,),
        )
        for split in ("test", "val", "train")
    ]
    card = Card(
        name="drv",
        title="Dark Raw Video dataset (DRV)",
        version="1.0",
        folder="DRV",
        citation=(
            "C. Chen, Q. Chen, M. N. Do and V. Koltun, Seeing Motion in the Dark, IEEE International Conference on "
            "Computer Vision, 2019"
        ),
        licence="MIT according to the repository's README, which has no licence file; none stated for the data",
        homepage="https://github.com/cchen156/Seeing-Motion-in-the-Dark",
        cfa="bayer",
        cameras={CAMERA: CameraCard(("DSC-RX100M6",))},
        counts=dict(sorted(Counter(str(record.role) for record in records).items())),
        protocol="drv-rgb",
        downloads=(
            Download(
                f"{_HOST}/long.zip",
                None,
                "references, preprocessed and raw; size not published",
                direct=True,
                part="long",
                paths="long/*",
            ),
            Download(
                f"{_HOST}/VBM4D_rawRGB.zip",
                None,
                "preprocessed noisy frames; size not published",
                direct=True,
                part="noisy",
                paths="VBM4D_rawRGB/*",
            ),
            # The manifest lists no raws, so a program could not tell whether such an archive is there already.
            *(
                Download(
                    f"{_HOST}/short{number}.zip",
                    None,
                    "camera raws, one of five parts; size not published",
                    part=f"short{number}",
                    paths="short/*",
                    below="short",
                )
                for number in range(1, 6)
            ),
        ),
        subsets=tuple(subsets),
        known_defects=(
            (
                "File names and numbers of frames are not published: the rows are patterns, and a lost frame shows as "
                "a gap in the numbering or not at all until eldata lock has listed a copy that you trust."
            ),
            (
                "The preprocessing (2x2 binning, amplification, VBM4D) is lost; the author does not remember black "
                "level and gain (DRV issues 8 and 10). The preprocessed files state neither ISO nor exposure nor ratio."
            ),
            (
                "The black level 512 that is quoted for the raws is probably wrong: RawTherapee and rawspeed have 800 "
                "for this camera. It is read from each file."
            ),
            "How the raw archives are laid out is not published: eldata looks and says what it found.",
            "The dynamic clips M0000 to M0022 have no reference; what the folders long/M* hold is not published.",
            "Users report a green cast in preprocessed inputs (SNR-Aware issue 9).",
            "No checksums were published: eldata lock records them from a copy that you trust.",
        ),
        sources=(
            "DRV repository, commit e3e81e7, DRV/{train,val,test}_list.txt: static clips and splits",
            (
                "DRV repository, commit e3e81e7, train.py, test_video.py, test_image.py: names of folders and "
                "references, 16-bit RGB divided by 65535, dynamic clips, frames tested; README: downloads, licence"
            ),
            "K. Wei et al., TPAMI 2021, section 4.6: the camera, a Sony RX100 VI",
        ),
    )
    return card, records
