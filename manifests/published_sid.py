"""The dataset cards of the published See-in-the-Dark set (SID), Sony and Fuji, with the subsets that papers score."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

from eldata.manifest.card import CameraCard, Card, Download, Subset
from manifests.sid_scenes import SID_CAMERAS, SidScene, sid_records

if TYPE_CHECKING:
    from collections.abc import Sequence

    from eldata.records import FrameRecord

_SID = "SID repository (MIT), commit 0448b58"
_ELD = "ELD repository (MIT), commit 53d5408"
_FIRST = "*/short/?????_00_*"
_INDOOR = (
    *("10185", "10187", "10191", "10193", "10198", "10213", "10217", "10226", "10227", "10228"),
    *("20188", "20201", "20208", "20210", "20211"),
)
_EVAL_FIRST = Subset(
    "eval-first",
    "validation and test scenes, first shot of each burst",
    f"the ELD paper (TPAMI 2021), table on SID Sony; {_ELD}, SID_Sony_paired.txt; also PMN, SonyR and LRD",
    129,
    splits=("val", "test"),
    paths=_FIRST,
)
_TEST_FIRST = Subset(
    "test-first",
    "test scenes, first shot of each burst",
    f"{_SID}, test_Sony.py and test_Fuji.py; also LED",
    93,
    splits=("test",),
    paths=_FIRST,
)
_INDOOR_15 = Subset(
    "indoor-15",
    "15 indoor scenes at each of the three ratios, first shot of each burst",
    f"the ELD paper of CVPR 2020; {_ELD}, SID_Sony_15_paired.txt and test_SID.py",
    45,
    splits=("val", "test"),
    scenes=_INDOOR,
    paths=_FIRST,
)
_ALL = Subset("all", "every short frame of every split", f"{_SID}, dataset/*_list.txt", 2697)


@dataclass(frozen=True, slots=True)
class _Half:
    """What a card says of one half of the set beyond its rows."""

    title: str
    cfa: str
    subsets: tuple[Subset, ...]
    downloads: tuple[Download, ...]
    known_defects: tuple[str, ...]
    sources: tuple[str, ...]


_HALVES = {
    "sid-sony": _Half(
        title="See-in-the-Dark dataset (SID), Sony",
        cfa="bayer",
        subsets=(_EVAL_FIRST, _TEST_FIRST, _INDOOR_15, _ALL),
        downloads=(
            Download(
                "https://storage.googleapis.com/isl-datasets/SID/Sony2025.zip",
                None,
                "the authors removed their download script over storage bills and ask people to download once, by hand",
                direct=True,
                part="sony",
                about="25 GB",
            ),
            Download(
                "https://drive.google.com/open?id=1G6VruemZtpOyHjOC5N8Ww3ftVXOydSXx", None, "a mirror", about="25 GB"
            ),
            Download("https://pan.baidu.com/s/1fk8EibhBe_M1qG0ax9LQZA", None, "in parts: cat SonyPart* > Sony.zip"),
        ),
        known_defects=(
            (
                "Scenes 10034, 10045 and 10172 are misaligned with their references: the README asks to leave them "
                "out of numbers (flag misaligned). They are 5 of the 129 pairs of eval-first; most papers kept them."
            ),
            (
                "A user found 00108, 00183 and about 38 pairs in all misaligned in the training set, and gave no list "
                "(SID issue 53, no reply): these two scenes have the flag misaligned-unconfirmed."
            ),
            (
                "The lists state ISO 12800 for Sony/short/00207_02_0.033s.ARW and 25600 for the rest of its scene. Its "
                "iso is left empty (flag uncertain-iso): if 12800 is true, its exposure ratio is 600, not 300."
            ),
            (
                "Fixed-pattern noise shows at the bottom corners of some frames, which is why the ELD papers score the "
                "centre 512 x 512 of the packed frame (ELD repository, test_SID.py)."
            ),
            "No checksums were published: eldata lock records them from a copy that you trust.",
        ),
        sources=(
            f"{_SID}, dataset/Sony_{{train,val,test}}_list.txt: files, ISO, exposures, splits",
            f"{_SID}, README: meaning of the names, 1/30 s, misaligned scenes, downloads; test_Sony.py: ratio",
            "SID_evaltest.info of the PMN repository, commit d207d3e: EXIF ratios are exactly 100, 250 and 300",
            f"{_ELD}, SID_Sony_paired.txt and SID_Sony_15_paired.txt: subsets",
            "SID issue 53: 00108 and 00183",
        ),
    ),
    "sid-fuji": _Half(
        title="See-in-the-Dark dataset (SID), Fuji",
        cfa="xtrans",
        subsets=(
            Subset(
                _TEST_FIRST.name,
                _TEST_FIRST.title,
                f"{_SID}, test_Fuji.py; the ELD paper (TPAMI 2021) reports on the test set",
                94,
                _TEST_FIRST.splits,
                paths=_FIRST,
            ),
            Subset(
                _EVAL_FIRST.name,
                _EVAL_FIRST.title,
                "the choice of eval-first in sid-sony, for this camera; no published numbers are known",
                132,
                _EVAL_FIRST.splits,
                paths=_FIRST,
            ),
            Subset(_ALL.name, _ALL.title, _ALL.source, 2397),
        ),
        downloads=(
            Download(
                "https://storage.googleapis.com/isl-datasets/SID/Fuji2025.zip",
                None,
                "the authors removed their download script over storage bills and ask people to download once, by hand",
                direct=True,
                part="fuji",
                about="52 GB",
            ),
            Download(
                "https://drive.google.com/open?id=1C7GeZ3Y23k1B8reRL79SqnZbRBc4uizH", None, "a mirror", about="52 GB"
            ),
            Download("https://pan.baidu.com/s/1fk8EibhBe_M1qG0ax9LQZA", None, "in parts: cat FujiPart* > Fuji.zip"),
        ),
        known_defects=(
            (
                "The README asks to leave the misaligned images 10034, 10045 and 10172 out of numbers without naming a "
                "camera. All three are Sony scenes; of Fuji's only 10172 exists, which may or may not be meant (flag "
                "misaligned-unconfirmed)."
            ),
            "No EXIF of these files was seen: ISO and exposure times are those of the lists.",
            "No checksums were published: eldata lock records them from a copy that you trust.",
        ),
        sources=(
            f"{_SID}, dataset/Fuji_{{train,val,test}}_list.txt: files, ISO, exposures, splits",
            f"{_SID}, README: meaning of the names, 1/30 s, downloads; test_Fuji.py: ratio, packing",
            "The SID paper (CVPR 2018), dataset section: the camera",
        ),
    ),
}


def published_sid(name: str, scenes: Sequence[SidScene]) -> tuple[Card, tuple[FrameRecord, ...]]:
    """Return card and rows of a half of the published set, ``sid-sony`` or ``sid-fuji``, from its table of scenes."""
    camera, half = SID_CAMERAS[name], _HALVES[name]
    records = sid_records(camera, scenes)
    card = Card(
        name=name,
        title=half.title,
        version="1.0",
        folder="SID",
        citation=(
            "C. Chen, Q. Chen, J. Xu and V. Koltun, Learning to See in the Dark, IEEE Conference on Computer Vision "
            "and Pattern Recognition, 2018"
        ),
        licence="MIT for the repository; none stated separately for the data",
        homepage="https://github.com/cchen156/Learning-to-See-in-the-Dark",
        cfa=half.cfa,
        cameras={camera.name: CameraCard(camera.models)},
        counts=dict(sorted(Counter(record.role for record in records).items())),
        protocol="sid",
        downloads=half.downloads,
        subsets=half.subsets,
        known_defects=half.known_defects,
        sources=half.sources,
    )
    return card, records
