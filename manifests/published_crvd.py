"""The published Captured Raw Video Denoising set (CRVD), indoor: its rows.

Noisy frames are ``indoor_raw_noisy/scene<s>/ISO<iso>/frame<f>_noisy<n>.tiff``, references
``indoor_raw_gt/scene<s>/ISO<iso>/frame<f>_clean_and_slightly_denoised.tiff``: 11 scenes, 5 ISOs, 7 frames, each noisy
ten times. Counts and names are those that the loops of the published code run over.

Sources: H. Yue et al., "Supervised Raw Video Denoising with a Benchmark Dataset on Dynamic Scenes", CVPR 2020; the
RViDeNet repository's README, test_indoor.py, train_finetune.py and utils.py; FloRNN's datasets/CRVD_seq.py.
"""

from __future__ import annotations

from fractions import Fraction

from eldata.manifest.pairs import NOMINAL_RATIO
from eldata.records import FrameRecord

CAMERA = "IMX385"
TRAIN_SCENES, TEST_SCENES = range(1, 7), range(7, 12)
ISOS = (1600, 3200, 6400, 12800, 25600)
FRAMES = range(1, 8)
SHOTS = range(10)


def crvd_records() -> tuple[FrameRecord, ...]:
    """Return the rows of the indoor clips, sorted by path."""
    rows = []
    for number in (*TRAIN_SCENES, *TEST_SCENES):
        scene, split = f"scene{number}", "test" if number in TEST_SCENES else "train"
        for iso in ISOS:
            for frame in FRAMES:
                place = f"{scene}/ISO{iso}/frame{frame}"
                reference = f"indoor_raw_gt/{place}_clean_and_slightly_denoised.tiff"
                shot = (CAMERA, scene, split, Fraction(iso))
                rows.append(FrameRecord(reference, "reference", *shot))
                rows += [
                    FrameRecord(
                        f"indoor_raw_noisy/{place}_noisy{shot_number}.tiff",
                        "noisy",
                        *shot,
                        ratio=Fraction(1),
                        reference=reference,
                        flags=(NOMINAL_RATIO,),
                    )
                    for shot_number in SHOTS
                ]
    return tuple(sorted(rows, key=lambda row: row.path))
