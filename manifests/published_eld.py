"""The published ELD set: its cameras, its rows and its card.

Sources: see :mod:`eldata.manifest.eld`.
"""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING

from eldata.manifest.card import CameraCard, Card, Download
from eldata.manifest.eld import EldCamera, eld_records

if TYPE_CHECKING:
    from eldata.records import FrameRecord

_SCENES = tuple(range(1, 11))
_INEXACT = "NikonD850/scene-1/IMG_0012.nef"

PUBLISHED_CAMERAS = (
    # All EXIF ratios of the Sony frames are exact, its references 4 s, in scene 2 3.2 s (PMN, ELD_SonyA7S2.info).
    EldCamera("SonyA7S2", ".ARW", 100, {scene: Fraction(16, 5) if scene == 2 else Fraction(4) for scene in _SCENES}),
    EldCamera("NikonD850", ".nef", 100),
    # The Canon references' ISO is called "base ISO" only.
    EldCamera("CanonEOS70D", ".CR2"),
    EldCamera("CanonEOS700D", ".CR2"),
)


def published_eld() -> tuple[Card, tuple[FrameRecord, ...]]:
    """Return card and rows of the published ELD set: 4 cameras, 10 scenes, 16 frames each."""
    records = eld_records(PUBLISHED_CAMERAS, _SCENES, {_INEXACT: ("inexact-ratio",)})
    card = Card(
        name="eld",
        title="Extreme Low-light Denoising dataset (ELD)",
        version="1.0",
        folder="ELD",
        citation=(
            "K. Wei, Y. Fu, Y. Zheng and J. Yang, Physics-based Noise Modeling for Extreme Low-light Photography, IEEE "
            "Transactions on Pattern Analysis and Machine Intelligence, 2021"
        ),
        licence="MIT for the repository; none stated separately for the data",
        homepage="https://github.com/Vandermode/ELD",
        cfa="bayer",
        cameras={
            "SonyA7S2": CameraCard(("ILCE-7SM2",)),
            "NikonD850": CameraCard(("NIKON D850",)),
            "CanonEOS70D": CameraCard(("Canon EOS 70D",)),
            "CanonEOS700D": CameraCard(("Canon EOS 700D", "Canon EOS REBEL T5i", "Canon EOS Kiss X7i")),
        },
        counts={role: sum(record.role == role for record in records) for role in sorted({r.role for r in records})},
        scenes_shared=True,  # ten scenes, which all four cameras photographed
        protocol="eld",
        downloads=(
            Download(
                "https://drive.google.com/drive/folders/1QoEhB1P-hNzAc4cRb7RdzyEKktexPVgy",
                None,
                "Google Drive folder of the authors",
            ),
            Download(
                "https://drive.google.com/file/d/13Ge6-FY9RMPrvGiPvw7O4KS3LNfUXqEX",
                None,
                "one archive, according to the PMN README",
                about="11.46 GB",
            ),
        ),
        known_defects=(
            (
                "The first public archive held 18 raw files in SonyA7S2/scene-5 and 17 in CanonEOS700D/scene-5; "
                "mismatched references then gave scores of about 70 dB. It was uploaded again on 2022-01-05."
            ),
            f"{_INEXACT} (a x1 frame, not among the 240 pairs) has an EXIF ratio of 0.9375.",
            "Some scenes also hold RGB renderings, which are ignored.",
            "No checksums were published: eldata lock records them from a copy that you trust.",
        ),
        sources=(
            "The paper's Algorithm 1 and dataset section: cameras, ISOs, low-light factors, 240 pairs",
            (
                "ELD repository (MIT), commit 53d5408, test_ELD.py and sid_dataset.py: layout, extensions, references; "
                "README and issue 21: defects"
            ),
            "PMN repository, commit d207d3e, ELD_SonyA7S2.info: exposures of the Sony frames",
            "LED repository, commit ee3d372, file lists: ratios of the Nikon frames",
        ),
    )
    return card, records
