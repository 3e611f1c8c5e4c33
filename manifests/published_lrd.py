"""The published Low-light Raw Denoising set (LRD): its scenes, rows and card.

A file is ``Clean/NNNNN_00_Ts.DNG`` or ``Noisy/NNNNN_0E_Ts.DNG``: NNNNN is the scene, T its exposure time in seconds,
rounded to five decimals, E the exposure bias, 1 to 3 stops below. The ratio is that of the published code, from the
names: 100 T / (ISO t), the clean frames being of ISO 100.

Sources: F. Zhang et al., "Towards General Low-Light Raw Noise Synthesis and Modeling", ICCV 2023; the LRD repository's
lists of pairs, README, test_denoise_LRD.py and datasets/Denoise_dataset.py.
"""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

from eldata.base.fields import TextFile
from eldata.base.files import write_text
from eldata.base.tables import csv_text
from eldata.errors import ManifestError
from eldata.manifest.card import CameraCard, Card, Download, Subset
from eldata.records import FrameRecord

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

CAMERA = "IMX586"
CLEAN_ISO = Fraction(100)
BIASES = (1, 2, 3)
SPLITS = ("train", "val", "test")

_COLUMNS = ("scene", "split", "iso", "clean", "1ev", "2ev", "3ev")
_NAME = r"(\d{5})_(\d\d)_([\d.]+)s\.DNG"
_LINE = re.compile(rf"\./LRD/Clean/{_NAME} \./LRD/Noisy/{_NAME} ISO(\d+) -(\d)EV")


@dataclass(frozen=True, slots=True)
class LrdScene:
    """One scene: ``iso`` of its noisy frames, and exposure times as in the names: ``clean``, and three ``noisy``."""

    scene: str
    split: str
    iso: int
    clean: str
    noisy: tuple[str, ...]


def lrd_records(scenes: Iterable[LrdScene]) -> tuple[FrameRecord, ...]:
    """Return the rows of the set, sorted by path."""
    rows = []
    for scene in scenes:
        reference = f"Clean/{scene.scene}_00_{scene.clean}s.DNG"
        clean_s, iso = Fraction(scene.clean), Fraction(scene.iso)
        rows.append(FrameRecord(reference, "reference", CAMERA, scene.scene, scene.split, CLEAN_ISO, clean_s))
        for bias, time in zip(BIASES, scene.noisy, strict=True):
            ratio = CLEAN_ISO * clean_s / (iso * Fraction(time))
            path = f"Noisy/{scene.scene}_{bias:02d}_{time}s.DNG"
            rows.append(
                FrameRecord(
                    path, "noisy", CAMERA, scene.scene, scene.split, iso, Fraction(time), ratio, reference=reference
                )
            )
    return tuple(sorted(rows, key=lambda row: row.path))


def lrd_scenes_from_lists(lists: Mapping[str, Path]) -> tuple[LrdScene, ...]:
    """Condense the official lists of pairs (``LRD_train_list.txt`` and so on), by split, to a table of scenes.

    A line is ``./LRD/Clean/00541_00_0.05s.DNG ./LRD/Noisy/00541_01_0.01s.DNG ISO200 -1EV``.

    Raises
    ------
    ManifestError
        If a line has another form, or a scene has not one clean frame, one ISO, one split and three biases: the table
        could not say it.
    """
    stated: dict[str, set[tuple[str, int, str]]] = {}
    noisy: dict[str, dict[int, str]] = {}
    for split, path in lists.items():
        for number, line in enumerate(TextFile(path, ManifestError).text().splitlines(), 1):
            match = _LINE.fullmatch(line.strip())
            if match is None or (match[1], match[2]) != (match[4], "00") or int(match[5]) != int(match[8]):
                raise ManifestError(f"{path} line {number}: not a line of an LRD list: {line!r}")
            stated.setdefault(match[1], set()).add((split, int(match[7]), match[3]))
            if noisy.setdefault(match[1], {}).setdefault(int(match[8]), match[6]) != match[6]:
                raise ManifestError(f"{path} line {number}: a second frame of -{match[8]}EV of scene {match[1]}")
    scenes = []
    for scene in sorted(stated):
        facts, times = stated[scene], noisy[scene]
        if len(facts) != 1 or sorted(times) != list(BIASES):
            raise ManifestError(f"scene {scene}: {sorted(facts)}, biases {sorted(times)}")
        ((split, iso, clean),) = facts
        scenes.append(LrdScene(scene, split, iso, clean, tuple(times[bias] for bias in BIASES)))
    return tuple(scenes)


def save_lrd_scenes(path: Path, scenes: Iterable[LrdScene]) -> None:
    """Write a table of scenes, whole or not at all."""
    write_text(path, csv_text(_COLUMNS, ((s.scene, s.split, s.iso, s.clean, *s.noisy) for s in scenes)))


def load_lrd_scenes(path: Path) -> tuple[LrdScene, ...]:
    """Read a table of scenes.

    Raises
    ------
    ManifestError
        If it cannot be read, has other columns, or has a number that is not one.
    """
    return tuple(
        LrdScene(
            row.text("scene"),
            row.text("split"),
            row.whole("iso"),
            row.text("clean"),
            tuple(row.text(f"{bias}ev") for bias in BIASES),
        )
        for row in TextFile(path, ManifestError).rows(_COLUMNS)
    )


_CODE = "LRD repository, commit 451f079"


def published_lrd(scenes: Iterable[LrdScene]) -> tuple[Card, tuple[FrameRecord, ...]]:
    """Return card and rows of the published set."""
    records = lrd_records(scenes)
    pairs = Counter(record.split for record in records if record.role == "noisy")
    of_one_bias = [
        Subset(
            name=f"test-{bias}ev",
            title=f"test scenes, exposure bias -{bias} EV",
            source=f"{_CODE}, test_denoise_LRD.py, which scores one bias at a time (--EV, by default -3)",
            pairs=pairs["test"] // len(BIASES),
            splits=("test",),
            paths=f"Noisy/?????_{bias:02d}_*",
        )
        for bias in reversed(BIASES)
    ]
    of_a_split = [
        Subset(
            name=split,
            title=f"{split} scenes, all three exposure biases",
            source=f"{_CODE}, datalist/LRD_{split}_list.txt",
            pairs=pairs[split],
            splits=(split,),
        )
        for split in reversed(SPLITS)
    ]
    card = Card(
        name="lrd",
        title="Low-light Raw Denoising dataset (LRD)",
        version="1.0",
        folder="LRD",
        citation=(
            "F. Zhang, B. Xu, Z. Li, X. Liu, Q. Lu, C. Gao and N. Sang, Towards General Low-Light Raw Noise Synthesis "
            "and Modeling, IEEE/CVF International Conference on Computer Vision, 2023"
        ),
        licence="MIT for the repository; none stated separately for the data",
        homepage="https://github.com/fengzhang427/LRD",
        cfa="bayer",
        cameras={CAMERA: CameraCard(())},
        counts=dict(sorted(Counter(str(record.role) for record in records).items())),
        protocol="lrd-lrd",
        downloads=(
            Download(
                "https://www.dropbox.com/scl/fi/tari9hvf2ubxo232owekz/LRD.zip?rlkey=7zj9kqgsf06g97smexkrzv05q&dl=0",
                notes="Dropbox of the authors",
            ),
            Download("https://1drv.ms/u/s!Ag-MqgbV0Z6NjH3TLuQEF_QszXrR?e=3ugcxy", notes="OneDrive of the authors"),
            Download("https://pan.baidu.com/s/1m7Qwa4Y2IvpAlCfmlgWiUQ", notes="code vj53"),
        ),
        subsets=(*of_one_bias, *of_a_split),
        known_defects=(
            (
                "The exposure bias is not the ratio: by the names' times and ISOs, pairs of -1 EV have ratios from "
                "1.50 to 3.31, of -2 EV 2.99 to 7.99, of -3 EV 5.98 to 20.3. The ratio here is that of the times, as "
                "in the published code."
            ),
            (
                "Times in the names are rounded to five decimals: 0.00016 may be 1/6400, which is 2 % shorter. The "
                "ratio from EXIF (amplification='metadata') differs from the published code's by as much."
            ),
            (
                "test_denoise_LRD.py and NPYDataset_LRD expect five fields in a line of a list, and LRD_test_list.txt "
                "has four: the published code does not run on the published list."
            ),
            (
                "The configuration names LRD_KLD_test_list.txt, which is not there. LDR_KLD_test_list.txt is the test "
                "list with other folders (./DJI/), each scene's number less by 25, and the word Outdoor."
            ),
            "No checksums were published: eldata lock records them from a copy that you trust.",
        ),
        sources=(
            f"{_CODE}, datalist/LRD_{{train,val,test}}_list.txt: every pair, its ISO and exposure bias",
            (
                f"{_CODE}, test_denoise_LRD.py, datasets/Denoise_dataset.py: ISO of the clean frames, ratio, levels, "
                "order of the CFA; README: downloads, licence"
            ),
            "LRD repository, issue 10: what the ratio is for",
        ),
        contents=(
            "600 scenes, each a clean frame of ISO 100 and three noisy ones, of exposure bias -1, -2 and -3 EV; 100 "
            "scenes each of ISO 200, 400, 800, 1600, 3200 and 6400; 480 scenes for training, 60 for validation, 60 for "
            "testing. DNG"
        ),
        levels="black as each file has it; white 65535 for every file in the published code (the file's own here)",
        scored=(
            (
                f"{_CODE}, test_denoise_LRD.py: both frames normalised and clipped to [0, 1], the input then "
                "multiplied by the ratio and clipped again; whole packed frame, no scalar, PSNR and SSIM by "
                "scikit-image. Protocol lrd-lrd; the published numbers are of one exposure bias: subsets test-3ev, "
                "test-2ev, test-1ev."
            ),
            (
                "White 65535 for every file cannot be said by a protocol: lrd-lrd takes each file's own white level, "
                "and scores as the code does where that is 65535."
            ),
            (
                "The code subtracts LibRaw's black levels in the order R, G1, B, G2 from planes in the order of the "
                "2x2 square, R, G1, G2, B: where G2's level differs from B's, scores differ."
            ),
        ),
        unknown=(
            "The files' own white level, sizes and camera model: eldata does not check the model.",
            "The size of the archive, and whether it has a folder LRD at its top.",
            "Which tables of the paper were made with which exposure bias: they were not read.",
        ),
    )
    return card, records
