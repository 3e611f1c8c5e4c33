"""Sets whose rows are patterns, and frames inside arrays: ReCRVD, LLRVD, PMRID, and archives with their own levels."""

from __future__ import annotations

import json
import runpy
import shutil
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from eldata import evaluate
from eldata.datasets import LLRVDDataset, PairDataset, PMRIDDataset, ReCRVDDataset, open_dataset
from eldata.download.overview import overview
from eldata.errors import DatasetError, ManifestError, RawFileError, UnusableRawError
from eldata.evaluation import save_prediction
from eldata.evaluation.predictions import stem_of
from eldata.manifest.catalogue import load_manifest, save_manifest, shipped_manifest
from eldata.manifest.lock import lock
from eldata.manifest.patterns import expand
from eldata.manifest.verify import verify
from eldata.raw.stated import MosaicFacts, StatedFile
from eldata.records import FrameRecord
from tests.pattern_trees import BUILDERS, FRAMES, RATIOS

psnr_of: Any = peak_signal_noise_ratio  # scikit-image has annotations in part only
ssim_of: Any = structural_similarity


def build(name: str, root: Path) -> Path:
    """A small copy below a data root; its folder."""
    manifest = shipped_manifest(name)
    BUILDERS[name](manifest, root / manifest.card.folder)
    return root / manifest.card.folder


# --- what the published loaders read ----------------------------------------------------------------------------------


def test_llrvd_is_what_its_loader_reads(tmp_path: Path) -> None:
    """(T, h, w, 4) arrays, levels and amplification as BRVE's llrvd_pipeline.py has them, to float32's last digits."""
    folder = build("llrvd", tmp_path)
    dataset = LLRVDDataset(folder, scenes=["35"], ratios=[160], window=FRAMES)
    assert [record.frames for record in dataset.records] == [
        tuple(f"ratio_noisy_all/35/160/lq.npy#{frame}" for frame in range(FRAMES))
    ]
    sample = dataset[0]
    noisy, clean = np.load(folder / "ratio_noisy_all/35/160/lq.npy"), np.load(folder / "ratio_gt/35/gt.npy")
    expected = np.clip((noisy.astype(np.float32) - 512) / (15360 - 512), 0, 1) * 160
    rgbg = [0, 1, 3, 2]  # R, G1, G2, B to this package's R, G1, B, G2
    assert np.abs(sample["input"].numpy() - np.clip(expected, 0, 1).transpose(0, 3, 1, 2)[:, rgbg]).max() < 2e-6
    truth = np.clip((clean.astype(np.float32) - 512) / (15360 - 512), 0, 1)
    assert np.abs(sample["target"].numpy() - truth.transpose(0, 3, 1, 2)[:, rgbg]).max() < 2e-7
    assert sample["ratio"] == sample["nominal_ratio"] == 160


def test_recrvd_is_what_its_loader_reads(tmp_path: Path) -> None:
    folder = build("recrvd", tmp_path)
    dataset = ReCRVDDataset(folder, scenes=["goat"], shots=[1], window=FRAMES)
    assert len(dataset) == 1
    for frame in range(FRAMES):
        mosaic = tifffile.imread(folder / f"wb_scene_noisy/goat/ISO6400/wb_noisy_{frame + 1}_1.tiff")
        packed = np.stack([mosaic[1::2, 0::2], mosaic[1::2, 1::2], mosaic[0::2, 1::2], mosaic[0::2, 0::2]])  # of GBRG
        expected = np.clip((packed.astype(np.float64) - 240) / (4095 - 240), 0, 1)
        assert np.abs(dataset[0]["input"][frame].numpy() - expected).max() < 1e-6


def test_pmrid_is_what_its_loader_reads(tmp_path: Path) -> None:
    folder = build("pmrid", tmp_path)
    dataset = PMRIDDataset(folder, scenes=["Scene1"])
    assert [record.path for record in dataset.records] == [
        f"Scene1/Dark/exposure-case{number}/input.raw" for number in (1, 2)
    ]
    mosaic = np.fromfile(folder / "Scene1/Dark/exposure-case2/gt.raw", "<u2").reshape(3000, 4000)
    assert np.abs(dataset[1]["target"][0].numpy() - mosaic[1::2, 1::2] / 65535).max() < 1e-7  # R of BGGR
    (folder / "Scene1/Dark/exposure-case2/gt.raw").write_bytes(b"\1" * 23_999_998)
    with pytest.raises(RawFileError, match=r"gt.raw: expected 24000000 bytes \(3000 x 4000 pixels\), found 23999998"):
        dataset[1]


def test_levels_that_no_text_states_are_asked_for(tmp_path: Path) -> None:
    """As docs/datasets.md has it, of a copy as the hub makes it."""
    published, name = shipped_manifest("raw-denoise"), "RAW/noisy/4Card_Gain160_E30_noisy.npy"
    BUILDERS["raw-denoise"](published, folder := tmp_path / "raw_denoise/sony_IMX678_20240111")
    asked = "states no colour filter array and neither black nor white level.*state them in the mosaics of its set's"
    with pytest.raises(UnusableRawError, match=asked):
        open_dataset("raw-denoise", tmp_path)[0]
    with pytest.raises(DatasetError, match=asked):
        evaluate(None, "raw-denoise", baseline="input", root=tmp_path)
    assert len(problems_of("raw-denoise", tmp_path)) == 4
    card = replace(published.card, name="mine", mosaics=(MosaicFacts("*.npy", "GRBG", (200.0,), 4095.0),))
    save_manifest(tmp_path / "mine.csv", card, published.records)
    (sample, _) = PairDataset(tmp_path / "raw_denoise", tmp_path / "mine.csv", clip="none")
    red = (np.load(folder / name)[0::2, 1::2].astype(np.float64) - 200) / (4095 - 200)
    assert np.abs(sample["input"][0].numpy() - red).max() < 1e-6
    assert verify(tmp_path / "mine.csv", tmp_path, level="full").problems == ()
    (folder / name.replace("noisy", "gt")).unlink()
    (problem,) = verify(tmp_path / "mine.csv", tmp_path).problems
    assert (problem.path, problem.found) == (name.replace("noisy", "gt"), "nothing")


# --- protocols, step by step ------------------------------------------------------------------------------------------


def spoil(mosaic: NDArray[Any], seed: int) -> NDArray[np.float32]:
    """A prediction of a normalised frame: a little noise, in places beyond [0, 1]."""
    noise = np.random.default_rng(seed).normal(0, 0.03, mosaic.shape)
    spoilt: NDArray[np.float32] = (mosaic + noise).astype(np.float32)
    spoilt[..., :4, :4] = 1.2
    spoilt[..., 4:6, 4:6] = -0.2
    return spoilt


def test_recrvd_scores_are_the_authors(tmp_path: Path) -> None:
    """test_ReCRVD.py: clipped, cut down to whole DN, PSNR of the mosaic, SSIM of each of its four planes."""
    folder, preds = build("recrvd", tmp_path), tmp_path / "preds"
    psnr, ssim = [], []
    for scene in ("flamingo", "goat"):
        for frame in range(1, FRAMES + 1):
            place = f"wb_scene_clean_postprocessed/{scene}/wb_clean_postprocessed_{frame}.tiff"
            clean = tifffile.imread(folder / place)
            truth = (clean.astype(np.float32) - 240) / (4095 - 240)
            mosaic = spoil(truth, frame)
            save_prediction(preds, f"wb_scene_noisy/{scene}/ISO6400/wb_noisy_{frame}_0.tiff", mosaic)
            clipped = np.clip(mosaic, 0, 1).astype(np.float64)
            cut: Any = (np.uint16(clipped * (4095 - 240) + 240).astype(np.float32) - 240) / (4095 - 240)
            psnr.append(psnr_of(truth, cut, data_range=1.0))
            planes = [(row, column) for row in (0, 1) for column in (0, 1)]
            ssim.append(np.mean([
                ssim_of(truth[r::2, c::2], cut[r::2, c::2], data_range=1.0) for r, c in planes
            ]))  # fmt: skip
    with pytest.raises(DatasetError, match=r"no such folder"):
        evaluate(preds, "recrvd", root=tmp_path)
    result = evaluate(preds, "recrvd", root=tmp_path, allow_missing=True)
    mean = result.whole
    assert result.protocol.name == "rvideformer-recrvd"
    assert (mean.scored, mean.pairs) == (2 * FRAMES, 2 * FRAMES + 28)
    assert result.psnr_db == pytest.approx(np.mean(psnr), abs=1e-5)
    assert result.ssim == pytest.approx(np.mean(ssim), abs=1e-6)


def test_llrvd_scores_are_the_authors(tmp_path: Path) -> None:
    """BRVE's metrics.py on a frame of (h, w, 4): the prediction as it is, SSIM of each plane."""
    folder, preds = build("llrvd", tmp_path), tmp_path / "preds"
    psnr, ssim = [], []
    truth = np.clip((np.load(folder / "ratio_gt/35/gt.npy").astype(np.float32) - 512) / (15360 - 512), 0, 1)
    for ratio in RATIOS:
        for frame in range(FRAMES):
            packed = spoil(truth[frame].transpose(2, 0, 1), ratio + frame)
            save_prediction(preds, f"ratio_noisy_all/35/{ratio}/lq.npy#{frame}", packed[[0, 1, 3, 2]])
            made = packed.transpose(1, 2, 0)
            psnr.append(psnr_of(truth[frame], made, data_range=1.0))
            ssim.append(np.mean([
                ssim_of(made[..., plane], truth[frame][..., plane], data_range=1.0) for plane in range(4)
            ]))  # fmt: skip
    assert (preds / "ratio_noisy_all/35/125/lq#3.npy").is_file()
    result = evaluate(preds, "llrvd", root=tmp_path, allow_missing=True)
    assert (result.protocol.name, result.scored) == ("brve-llrvd", len(RATIOS) * FRAMES)
    assert result.psnr_db == pytest.approx(np.mean(psnr), abs=1e-5)
    assert result.ssim == pytest.approx(np.mean(ssim), abs=1e-6)


# --- PMRID's regions in sRGB: examples/pmrid_regions.py against a rewrite of run_benchmark.py and utils.py ------------

WB, CCM = (1.9, 1.0, 1.7), np.array([[1.5, -0.4, -0.1], [-0.2, 1.4, -0.2], [0.0, -0.5, 1.5]])
ROIS = ((100, 60, 260, 200), (2001, 1501, 2101, 1581), (3900, 2900, 4000, 3000))


def demosaic(codes: Any, code: str) -> Any:
    """In place of OpenCV, which need not be here: colours of an RGGB mosaic's blocks, the greens weighted apart."""
    assert (code, codes.dtype) == ("BG2RGB_EA", np.uint16)
    greens = codes[0::2, 1::2] // 4 * 3 + codes[1::2, 0::2] // 4
    return np.stack([codes[0::2, 0::2], greens, codes[1::2, 1::2]], axis=-1).repeat(2, 0).repeat(2, 1)


def render_as_published(bggr: Any) -> list[Any]:
    """utils.py's bggr2rggb, bayer2rgb and back, of a mosaic (H, W) in [0, 1]: the regions."""
    bayer = bggr[::-1, ::-1].astype(np.float64)
    for row, column, gain in ((0, 0, WB[0]), (0, 1, WB[1]), (1, 0, WB[1]), (1, 1, WB[2])):
        bayer[row::2, column::2] *= gain
    codes = np.round(bayer.clip(0, 1).astype(np.float32) * 65535).clip(0, 65535).astype(np.uint16)
    rgb = demosaic(codes, "BG2RGB_EA")[::-1, ::-1].astype(np.float32) / 65535
    return [(rgb[y0:y1, x0:x1].dot(CCM.T).clip(0, 1) ** (1 / 2.2)).astype(np.float32) for x0, y0, x1, y1 in ROIS]


def test_regions_are_scored_as_published(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cv2", SimpleNamespace(COLOR_BAYER_BG2RGB_EA="BG2RGB_EA", cvtColor=demosaic))
    score_regions = runpy.run_path(str(Path(__file__).parents[2] / "examples/pmrid_regions.py"))["score_regions"]
    folder, file = build("pmrid", tmp_path), "Scene1/Dark/exposure-case1/input.raw"
    shutil.rmtree(folder / "Scene1/Dark/exposure-case2")
    gt = np.fromfile(folder / file.replace("input", "gt"), np.uint16).reshape(3000, 4000).astype(np.float32) / 65535
    predicted = np.roll(gt, 2, axis=1) * np.float32(1.5) - np.float32(0.05)
    save_prediction(tmp_path / "preds", file, predicted)
    (folder / "benchmark.json").write_text("[]")
    with pytest.raises(DatasetError, match=r"json: expected the regions of .*case1/input.raw, found none"):
        score_regions(tmp_path / "preds", tmp_path)
    meta = {"wb_gain": WB, "CCM": CCM.tolist(), "ROIs": ROIS}
    (folder / "benchmark.json").write_text(json.dumps([{"input": file, "meta": meta}]))
    scores, images = score_regions(tmp_path / "preds", tmp_path), map(render_as_published, (gt, predicted))
    for found, *patches in zip(scores, *images, strict=True):
        expected = psnr_of(*patches, data_range=1), ssim_of(*patches, channel_axis=2, data_range=2)
        assert found == pytest.approx(expected, abs=1e-6)


# --- copies that are not whole ----------------------------------------------------------------------------------------


def problems_of(name: str, root: Path) -> dict[str, str]:
    """What verify finds, scenes that are not there aside."""
    report = verify([shipped_manifest(name)], root, level="metadata")
    found = {problem.path: f"{problem.field} {problem.found}" for problem in report.problems}
    return {path: text for path, text in found.items() if "no such folder" not in text}


def test_what_a_copy_lacks_is_named(tmp_path: Path) -> None:
    folder = build("recrvd", tmp_path)
    assert problems_of("recrvd", tmp_path) == {}
    (folder / "wb_scene_clean_postprocessed/goat/wb_clean_postprocessed_5.tiff").unlink()
    (folder / "wb_scene_noisy/goat/ISO6400/wb_noisy_2_1.tiff").unlink()
    problems = problems_of("recrvd", tmp_path)
    assert problems["wb_scene_clean_postprocessed/goat/wb_clean_postprocessed_5.tiff"].startswith("file nothing")
    assert problems["wb_scene_noisy/goat/ISO6400"] == "number no frame 2"
    with pytest.raises(DatasetError, match=r"lacks 1 of the .*wb_clean_postprocessed_5.tiff"):
        PairDataset(folder, "recrvd", scenes=["goat"])


def test_an_array_that_is_cut_off_or_of_another_form_is_named(tmp_path: Path) -> None:
    folder = build("llrvd", tmp_path)
    clip = folder / "ratio_noisy_all/35/125/lq.npy"
    whole = clip.read_bytes()
    clip.write_bytes(whole[:-100])
    (problem,) = [text for path, text in problems_of("llrvd", tmp_path).items() if "/35/125/" in path]
    assert "declares 22400 bytes of values and has 22300: truncated?" in problem
    np.save(clip, np.load(folder / "ratio_gt/35/gt.npy")[..., :3])
    report = verify([shipped_manifest("llrvd")], tmp_path, level="metadata")
    assert "packed numbers, (4, h, w) or (h, w, 4)" in report.format_text()


def test_a_file_with_braces_in_its_name_is_itself(tmp_path: Path) -> None:
    for name in ("IMG{1}.npy", "IMG{2}.npy", "{}.npy"):
        np.save(tmp_path / name, np.zeros((4, 4)))
    rows = tuple(FrameRecord(name, "noisy", "A") for name in ("IMG{1}.npy", "{}.npy"))
    assert expand(rows, tmp_path) == rows


def test_a_field_that_cannot_be_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a/soon").mkdir(parents=True)
    np.save(tmp_path / "a/soon/x.npy", np.zeros((4, 4)))
    row = FrameRecord("a/{ratio}/x.npy", "noisy", "A")
    with pytest.raises(ManifestError, match=r"a/soon/x.npy: .*'soon' as ratio"):
        expand([row], tmp_path)


# --- locked -----------------------------------------------------------------------------------------------------------


def test_a_locked_copy_has_a_row_for_each_frame(tmp_path: Path) -> None:
    folder = build("pmrid", tmp_path)
    report = lock("pmrid", tmp_path)
    assert not report.problems
    locked = load_manifest(report.path)
    assert [row.path for row in locked.records] == sorted(
        path.relative_to(folder).as_posix() for path in folder.rglob("*.raw")
    )
    assert all(row.sha256 for row in locked.records)


# --- frames inside arrays ---------------------------------------------------------------------------------------------


def test_what_is_meant_in_a_file(tmp_path: Path) -> None:
    """Of npy, npz and HDF5: one frame of an array, by its name where there are several; levels of the file's own."""
    clip = np.random.default_rng(0).integers(60, 1000, (3, 4, 20, 24)).astype(np.uint16)
    np.savez_compressed(tmp_path / "clip.npz", im=clip, black_level=[64, 64, 64, 64], white_level=1023)
    facts = MosaicFacts("*", "RGGB", level_arrays=("black_level", "white_level"), planes=("R", "G1", "G2", "B"))
    frame = StatedFile(tmp_path / "clip.npz", facts, member="im:2").read()
    assert np.array_equal(frame.mosaic[0::2, 1::2], clip[2, 1])
    assert np.array_equal(frame.mosaic[1::2, 0::2], clip[2, 2])
    assert (frame.sensor.black_level_dn, frame.sensor.white_level_dn) == ((64.0,) * 4, 1023.0)
    assert StatedFile(tmp_path / "clip.npz", facts, member="im:2").header.levels_dn == (64.0, 1023.0)
    with pytest.raises(RawFileError, match=r"clip.npz: holds an array of shape \(3, 4, 20, 24\), which has no part 3"):
        StatedFile(tmp_path / "clip.npz", facts, member="im:3").read()
    np.savez(tmp_path / "clip.npz", im=clip, black_level=[64, 64], white_level=1023)
    with pytest.raises(RawFileError, match="expected levels, one number or four"):
        StatedFile(tmp_path / "clip.npz", facts, member="im:0").check()
    np.savez(tmp_path / "clip.npz", im=clip, black_level=64, white_level=63)
    with pytest.raises(RawFileError, match="expected one white level above black"):
        StatedFile(tmp_path / "clip.npz", facts, member="im:0").read()


def test_what_is_not_known_of_a_subset_is_not_said(tmp_path: Path) -> None:
    assert "first of each frame's ten noisy shots\n" in overview(shipped_manifest("recrvd"), tmp_path).format_text()


def test_stems_of_frames_in_arrays() -> None:
    assert [stem_of(path) for path in ("a/lq.npy#3", "a/lq#3.npy", "a/x.npz#im:3", "a/IMG#1.dng")] == [
        *("a/lq#3", "a/lq#3", "a/x#im-3", "a/IMG#1"),
    ]
