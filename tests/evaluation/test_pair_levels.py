"""Pairs whose files differ in their levels: shares of white are the same wherever a pair is shown, and it is said once.

The files of tests/evaluation/field are of a simulated scene at a light of 1:10 (1:100, ``black-off-8``), whose scores
were computed beside them, with numpy alone.
"""

from __future__ import annotations

import math
import shutil
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from numpy.typing import NDArray

from capture.check import check
from eldata import PackedStore, evaluate, verify
from eldata.base.workers import Workers
from eldata.baselines.predicting import BaselineDenoiser, write_predictions
from eldata.datasets import PairDataset
from eldata.datasets.clips import ClipWindows
from eldata.evaluation import scored_pairs
from eldata.manifest.catalogue import FrameFiles, save_manifest
from eldata.manifest.own import sort_own_set
from eldata.manifest.pair_checks import white_remarks
from eldata.protocols import PROTOCOLS
from eldata.raw import pack, read_raw, write_dng
from eldata.raw.levels import MeanLevels, differ_in_white, with_levels
from eldata.records import Exposure, FrameRecord
from eldata.sources.frames import Files
from eldata.sources.store import build_store, source_of_dataset
from tests.raw.helpers import make_sensor

FIELD = Path(__file__).parent / "field"
UNSCALED = replace(PROTOCOLS["raw"], name="raw-unscaled", rescaling="none")
NOISY = "hall/IMG_0002.dng"
# The DN that are 1 over black, of the reference and of the noisy frame, the score, and what is said.
CASES = {
    "white-by-iso": (11535, 11535, 45.84, "15303, that of its reference 13583, on one DN scale"),
    "white-12-bit-burst": (14920, 3730, 46.64, "3880, that of its reference 15520, ranges a power of two apart"),
}


def manifest_of(folder: Path, out: Path) -> Path:
    """Write a manifest of a set of one's own, whose card names ``raw``."""
    found = sort_own_set(folder, folder.name)
    return save_manifest(out / f"{folder.name}.csv", found.card, found.records).path


def shares(path: Path, range_dn: float, gain: float = 1.0) -> NDArray[np.float64]:
    frame = read_raw(path)
    over = pack(frame.mosaic, frame.sensor.cfa) - np.float64(frame.sensor.black_level_dn[0])
    return np.clip(np.clip(over / range_dn, 0, 1) * gain, 0, 1)


@pytest.mark.parametrize("case", CASES)
def test_every_way_to_a_pair_has_the_same_shares_and_it_is_said_once(case: str, tmp_path: Path) -> None:
    of_reference, of_noisy, psnr_db, words = CASES[case]
    folder = FIELD / case
    clean, noisy = shares(folder / "hall/IMG_0001.dng", of_reference), shares(folder / NOISY, of_noisy, 10)
    assert -10 * math.log10(np.mean((clean - noisy) ** 2)) == pytest.approx(psnr_db, abs=0.005)
    csv = manifest_of(folder, tmp_path)
    where: dict[str, Any] = {"manifest": csv, "root": FIELD}

    ways = [PairDataset(folder, csv)[0]]
    build_store(source_of_dataset(case, **where), tmp_path / "store.h5")
    ways.append(PackedStore(tmp_path / "store.h5", crop=None, augment=False)[0])
    shown = [(way["input"].numpy(), way["target"].numpy()) for way in ways]
    shown += [images[:2] for images in scored_pairs(None, baseline="input", protocol=UNSCALED, **where)]
    write_predictions(BaselineDenoiser("input"), "", tmp_path / "p", clip="protocol", **where)
    shown.append((np.load(tmp_path / "p" / "hall/IMG_0002.npy"), clean))
    for first, second in shown:
        np.testing.assert_allclose(first, noisy, atol=2e-6)
        np.testing.assert_allclose(second, clean, atol=2e-6)

    for given in ({"predictions": None, "baseline": "input"}, {"predictions": tmp_path / "p"}):
        result = evaluate(protocol=UNSCALED, **given, **where)
        assert result.scores[0].psnr_db == pytest.approx(psnr_db, abs=0.005)
        assert sum(words in note for note in result.notes) == 1
    assert not any("white level is" in note for note in evaluate(None, protocol="eld", baseline="input", **where).notes)
    assert verify(csv, FIELD, level="metadata").format_text().count(words) == 1
    report = check(csv, FIELD)
    (ratio,) = (one for one in report.groups[0].measures if one.name == "ratio")
    assert ratio.value == pytest.approx(10, abs=5 * ratio.standard_error)
    assert ratio.standard_error < 0.01
    assert report.groups[0].verdict_of(NOISY) == "keep"
    assert report.format_text().count(words) == 1


@pytest.mark.parametrize(
    ("noisy", "reference", "differ"),
    [
        ((2048, 15303), (2048, 13583), True),
        ((2048, 13583), (2048, 15303), True),
        ((0, 10000), (0, 15000), True),
        ((512, 16383), (500, 16383), False),  # as it always was
        ((128, 4095), (512, 16383), False),
        ((512, 16383), (128, 4095), False),
        ((150, 4095), (600, 15892), False),  # 14 bits are 3.88 of 12
        ((512, 3395), (2048, 15303), False),  # 12 bits beside 14, and Canon's other white
        ((0, 1), (64, 1023), False),  # shares of white
        ((0, 959), (0, 1), False),
        ((0, 255), (0, 65535), False),
    ],
)
def test_which_white_levels_are_two_of_one_scale(noisy: MeanLevels, reference: MeanLevels, differ: bool) -> None:
    assert differ_in_white(noisy, reference) == differ
    ours, theirs = (
        make_sensor(black_level_dn=(black,) * 4, white_level_dn=white) for black, white in (noisy, reference)
    )
    range_dn = (reference if differ else noisy)[1] - (reference if differ else noisy)[0]
    assert with_levels(ours, "metadata", theirs).white_level_dn == noisy[0] + range_dn
    assert with_levels(ours, "published", theirs) == with_levels(ours, "published")


def test_of_files_that_state_no_levels_one_of_each_iso_is_decoded(monkeypatch: pytest.MonkeyPatch) -> None:
    """As of CR2, NEF and ARW, whose white level only LibRaw tells, once it has decoded them."""
    case = "white-by-iso"
    own = sort_own_set(FIELD / case, case)
    records, cameras = own.records, own.card.cameras
    noisy = [replace(records[1], path=path) for path in (NOISY, "hall/lost.CR2")]
    decode = Mock(wraps=read_raw)
    monkeypatch.setattr("eldata.raw.reading.read_raw", decode)
    levels_dn = dict.fromkeys((records[0].path, NOISY, "hall/lost.CR2"))
    (said,) = white_remarks([records[0], *noisy], levels_dn, cameras, FrameFiles(FIELD / case), Workers(1))
    assert (said.path, said.files) == (NOISY, 2)
    assert CASES[case][3] in said.text
    assert sorted(call.args[0].name for call in decode.call_args_list) == ["IMG_0001.dng", "IMG_0002.dng"]


def test_frames_of_a_clip_are_divided_as_their_reference_is(tmp_path: Path) -> None:
    """Each channel after its own black, in float32, beside a reference whose white is 13 % lower."""
    mosaic = np.random.default_rng(1).integers(600, 8000, (60, 64)).astype(np.uint16)
    for name, white, time in (("clean", 13583.0, 1), ("f1", 15303.0, 10), ("f2", 15303.0, 10)):
        exposure = Exposure(Fraction(100), Fraction(1, time))
        write_dng(tmp_path / f"{name}.dng", mosaic, make_sensor(white_level_dn=white), exposure)
    rows = [FrameRecord("clean.dng", "reference", "A", "s")]
    rows += [FrameRecord(f"f{one}.dng", "noisy", "A", "s", reference="clean.dng") for one in (1, 2)]
    clip = ClipWindows(Files(tmp_path, rows), rows, (), tmp_path, window=2, clip="none")[0]
    assert clip["ratio"] == 10
    for frame in clip["input"]:
        np.testing.assert_allclose(frame, 10 * clip["target"], rtol=1e-6)


@pytest.mark.parametrize(("stated", "psnr_db"), [(512, 23.63), (520, 27.52), (8, 2.66), (1032, 10.39)])
def test_a_stated_black_that_is_wrong_is_a_finding_with_both(stated: int, psnr_db: float, tmp_path: Path) -> None:
    """The noisy frame's black is 520. At x100 an offset of 8 DN is 5 % of the range, and the light is as it was."""
    shutil.copytree(FIELD / "black-off-8", tmp_path / "set")
    frame = read_raw(tmp_path / "set" / NOISY)
    sensor = replace(frame.sensor, black_level_dn=(float(stated),) * 4)
    write_dng(tmp_path / "set" / NOISY, frame.mosaic, sensor, frame.exposure)
    csv = manifest_of(tmp_path / "set", tmp_path)
    result = evaluate(None, manifest=csv, root=tmp_path, protocol=UNSCALED, baseline="input")
    assert result.scores[0].psnr_db == pytest.approx(psnr_db, abs=0.01)
    (group,) = check(csv, tmp_path).groups
    (found,) = (one for one in group.measures if one.name == "offset")
    assert found.value == pytest.approx((520 - stated) / 1.5871, abs=0.31)  # five standard errors
    wrong = {one.name for one in group.row(next(iter(group.pairs))).values() if one.verdict != "keep"}
    assert wrong == (set() if stated == 520 else {"offset"})
    said = f"black is 520 DN by its pixels, the stated one {stated}: at x100"
    assert (said in group.format_text()) == bool(wrong)
