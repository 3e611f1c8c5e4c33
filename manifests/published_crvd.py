"""The published Captured Raw Video Denoising set (CRVD), indoor: its rows and card.

Noisy frames are ``indoor_raw_noisy/scene<s>/ISO<iso>/frame<f>_noisy<n>.tiff``, references
``indoor_raw_gt/scene<s>/ISO<iso>/frame<f>_clean_and_slightly_denoised.tiff``: 11 scenes, 5 ISOs, 7 frames, each noisy
ten times. Counts and names are those that the loops of the published code run over.

Sources: H. Yue et al., "Supervised Raw Video Denoising with a Benchmark Dataset on Dynamic Scenes", CVPR 2020; the
RViDeNet repository's README, test_indoor.py, train_finetune.py and utils.py; FloRNN's datasets/CRVD_seq.py.
"""

from __future__ import annotations

from collections import Counter
from fractions import Fraction

from eldata.manifest.card import CameraCard, Card, Download, Subset
from eldata.manifest.pairs import NOMINAL_RATIO
from eldata.raw.stated import MosaicFacts
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


_CODE = "RViDeNet repository, commit 4615032"
_FLORNN = "FloRNN repository (nagejacob/FloRNN), commit ba9e695"


def published_crvd() -> tuple[Card, tuple[FrameRecord, ...]]:
    """Return card and rows of the published set's indoor clips."""
    records = crvd_records()
    noisy = Counter(record.split for record in records if record.role == "noisy")
    card = Card(
        name="crvd",
        title="Captured Raw Video Denoising dataset (CRVD), indoor",
        version="1.0",
        folder="CRVD",
        citation=(
            "H. Yue, C. Cao, L. Liao, R. Chu and J. Yang, Supervised Raw Video Denoising with a Benchmark Dataset on "
            "Dynamic Scenes, IEEE/CVF Conference on Computer Vision and Pattern Recognition, 2020"
        ),
        licence="CC BY-NC-SA 4.0, academic purposes only (README of the repository)",
        homepage="https://github.com/cao-cong/RViDeNet",
        cfa="bayer",
        cameras={CAMERA: CameraCard(())},
        counts=dict(sorted(Counter(str(record.role) for record in records).items())),
        downloads=(
            Download(
                "https://drive.google.com/drive/folders/1TZhNrsJ4tmKaU7b9b_9hkJIhwMi9Tfk3", notes="the authors' folder"
            ),
            Download(
                "https://mega.nz/file/Hx8TgLQY#0MoZSqdrQ_HgIc4OP6_jmwAwupNctPc7ZilXLV_FAQ0", notes="the authors' mirror"
            ),
            Download("https://pan.baidu.com/s/13p1I2j18ZCCACaR_zoFavw", notes="key cdux"),
        ),
        subsets=(
            Subset(
                name="test-first",
                title="test scenes, the first of each frame's ten noisy shots",
                source=f"{_CODE}, test_indoor.py",
                pairs=noisy["test"] // len(SHOTS),
                splits=("test",),
                paths="*_noisy0.tiff",
            ),
            Subset("test", "test scenes, every noisy shot", f"{_CODE}, README", noisy["test"], splits=("test",)),
            Subset("train", "scenes 1 to 6, every noisy shot", f"{_CODE}, README", noisy["train"], splits=("train",)),
        ),
        known_defects=(
            (
                "Loaders lay the archives out differently: FloRNN as listed here, others with one more folder "
                "(indoor_raw_noisy/indoor_raw_noisy_scene1/scene1), RViDeNet with noisy frames and references in one."
            ),
            (
                "References are means of noisy frames, denoised a little by BM3D; the plain means (frame1_clean.tiff) "
                "lie beside the noisy frames and are not listed. Means of frames that were clipped are biased "
                "(RViDeNet, issue 2)."
            ),
            (
                "The outdoor clips (outdoor_raw_noisy, 10 scenes of 50 frames of ISO 25600) have no reference and are "
                "not listed."
            ),
            "No checksums were published; eldata lock records those of a copy.",
        ),
        sources=(
            (
                f"{_CODE}, README: colour filter array, levels, licence, downloads; test_indoor.py, train_finetune.py: "
                "every name, test scenes, scores; utils.py: SSIM"
            ),
            (
                f"{_FLORNN}, datasets/CRVD_seq.py: folders of noisy frames and references, outdoor clips; "
                "test_models/CRVD_test.py"
            ),
            "The paper's abstract: 55 groups, 11 scenes at 5 ISOs",
        ),
        contents=(
            "55 indoor clips of 7 frames, 11 scenes at ISO 1600, 3200, 6400, 12800 and 25600, each frame noisy ten "
            "times; 1920 x 1080 mosaics in 16-bit TIFF. Motion was made by moving things between frames"
        ),
        levels="black 240, white 4095 for every file; GBRG (README of the repository)",
        scored=(
            (
                f"{_CODE}, test_indoor.py: each frame of scenes 7 to 11 against its own reference (subset test-first); "
                "the prediction clipped to [0, 1], then cut down to whole DN (black 240, white 4095) and normalised "
                "again; reference normalised, not clipped; PSNR on data range 1, SSIM by scikit-image for each packed "
                "channel; means over frames, scenes and ISOs: protocol rvidenet-crvd. Scores in sRGB are of renderings "
                "by a network, and not offered."
            ),
            f"{_FLORNN}, test_models/CRVD_test.py: the same, but the reference clipped to [0, 1]: protocol florn-crvd.",
        ),
        unknown=(
            "The size of the archives, and how the TIFF files are compressed.",
            "How the camera names itself: the files state no camera model.",
            "The exposure times: a frame and its reference were exposed alike, so every ratio is 1.",
        ),
        protocol="rvidenet-crvd",
        mosaics=(MosaicFacts("*.tiff", "GBRG", (240.0,), 4095.0),),
    )
    return card, records
