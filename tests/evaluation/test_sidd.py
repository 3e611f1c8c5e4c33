"""SIDD, frames and blocks, from files in MATLAB's format: against h5py, scipy, numpy and scikit-image alone."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import scipy.io
from numpy.typing import NDArray
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from eldata import evaluate
from eldata.baselines.predicting import BaselineDenoiser, write_predictions
from eldata.datasets import SIDDDataset
from eldata.download import unpack_dataset
from eldata.errors import ArchiveError, ArgumentError
from eldata.integrations.protocol_scores import protocol_of_tensors
from eldata.manifest.catalogue import shipped_manifest
from eldata.manifest.verify import verify
from eldata.protocols import get_protocol
from tests.cases import in_one_test
from tests.evaluation.published_code import gaussian_ssim
from tests.sidd_tree import SHAPE, blocks_of, build_sidd_tree, write_corrected

# Row and column of R, and of B, in the first 2 x 2 sites of arrays as MATLAB shows them.
RED_AND_BLUE = {
    "GP": ((1, 1), (0, 0)),
    "IP": ((0, 0), (1, 1)),
    "S6": ((0, 1), (1, 0)),
    "N6": ((1, 1), (0, 0)),
    "G4": ((1, 1), (0, 0)),
}
ssim_of: Any = structural_similarity  # scikit-image has annotations in part only
psnr_of: Any = peak_signal_noise_ratio


def by_h5py(path: Path) -> NDArray[np.float32]:
    """As published code reads a file: columns first."""
    with h5py.File(path) as file:
        return np.array(file["x"], np.float32)


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root: Path = tmp_path_factory.mktemp("data")
    build_sidd_tree(shipped_manifest("sidd"), root / "SIDD")
    return root


def test_files_verify(root: Path) -> None:
    manifest = shipped_manifest("sidd")
    assert len(manifest.records) == 640
    assert verify([manifest], root, level="full").problems == ()


@pytest.mark.parametrize("phone", RED_AND_BLUE)
def test_pixels_are_those_of_matlabs_array(phone: str, root: Path) -> None:
    dataset = SIDDDataset(root / "SIDD")
    assert len(dataset) == 320
    index = next(index for index, pair in enumerate(dataset.records) if f"_{phone}_" in pair.path)
    (red, red_column), (blue, blue_column) = RED_AND_BLUE[phone]
    for side, name in (("input", dataset.records[index].path), ("target", dataset.records[index].reference)):
        mosaic = by_h5py(root / "SIDD" / name).T
        assert mosaic.shape == SHAPE
        starts = ((red, red_column), (red, blue_column), (blue, blue_column), (blue, red_column))
        expected = np.stack([mosaic[row::2, column::2] for row, column in starts])
        np.testing.assert_array_equal(dataset[index][side], expected)  # type: ignore[literal-required]
    assert dataset[index]["ratio"] == 1


@pytest.mark.parametrize("phone", ["s6", "gp", "ip"])
def test_scores_are_those_of_sfrns_arithmetic(phone: str, root: Path) -> None:
    """PSNR is of the whole mosaic, as SFRN has it, and SSIM, which it has not, of each packed channel."""
    result = evaluate(None, "sidd", root=root, subset=f"sfrn-{phone}", baseline="input")
    assert result.protocol.name == "sfrn-sidd"
    folders = (root / "SIDD" / "SIDD_Medium_Raw" / "Data").iterdir()
    named = [(folder, folder.name.lower().split("_")) for folder in folders]
    tested = [folder for folder, words in named if phone == words[2] and int(words[1]) in (2, 3, 5)]
    expected = {}
    for folder in tested:
        for tail in ("010", "011"):
            name = f"{folder.name[:4]}_NOISY_RAW_{tail}.MAT"
            noisy, clean = by_h5py(folder / name), by_h5py(folder / name.replace("NOISY", "GT"))
            noisy = noisy.clip(0, 1)
            places = [(slice(row, None, 2), slice(column, None, 2)) for row in (0, 1) for column in (0, 1)]
            ssim = np.mean([ssim_of(clean[place], noisy[place], data_range=1) for place in places])
            expected[name] = psnr_of(clean, noisy, data_range=1), ssim
    assert len(result.scores) == len(expected)
    for pair, image in zip(result.units, result.scores, strict=True):
        psnr_db, ssim = expected[pair.path.rpartition("/")[2]]
        assert image.psnr_db == pytest.approx(psnr_db, abs=1e-6, rel=0)
        assert image.ssim == pytest.approx(ssim, abs=1e-6, rel=0)


def test_sidd_cc_is_scored_by_the_manifest_of_the_document(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two files, which the document's block writes; references keep their negatives where the protocol clips none."""
    page = (Path(__file__).parents[2] / "docs" / "datasets.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"### SIDD-CC\n.*?```python\n(.*?)```", page, re.DOTALL)
    monkeypatch.chdir(tmp_path)
    records = [one for one in shipped_manifest("sidd").records if one.path.split("/")[2][:4] in ("0001", "0200")]
    write_corrected(tmp_path / "data" / "SIDD-CC", records)
    exec(compile(block, "datasets.md", "exec"), {})  # noqa: S102 # our own text
    assert verify(tmp_path / "my-sidd-cc.csv", tmp_path / "data", level="full").problems == ()
    unclipped = replace(get_protocol("sfrn-sidd"), reference_clip="none")
    result = evaluate(
        None, manifest=tmp_path / "my-sidd-cc.csv", root=tmp_path / "data", baseline="input", protocol=unclipped
    )
    assert len(result.scores) == 4
    for pair, image in zip(result.units, result.scores, strict=True):
        noisy, clean = (by_h5py(tmp_path / "data" / "SIDD-CC" / path) for path in pair.files)
        assert clean.min() < 0
        assert image.psnr_db == pytest.approx(psnr_of(clean, noisy.clip(0, 1), data_range=1), abs=1e-6, rel=0)


# --- blocks, from MATLAB's arrays -------------------------------------------------------------------------------------

NAMES = ("ValidationNoisyBlocksRaw", "ValidationGtBlocksRaw", "BenchmarkNoisyBlocksRaw")
GALAXY = (0, 9, 12, 17, 22, 27, 32, 37)


@pytest.fixture(scope="module")
def blocks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The three files unpacked, as `eldata download sidd-blocks --from` does."""
    root, manifest = tmp_path_factory.mktemp("data"), shipped_manifest("sidd-blocks")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("os.fsync", lambda _: None)  # 3840 of them take minutes on a slow disk
        for name in NAMES:
            file = root / f"{name}.mat"
            scipy.io.savemat(file, {name: blocks_of(name), "OptionalData": {"MethodName": "x"}}, do_compression=True)
            done = unpack_dataset(file, manifest, root / "SIDD")
            assert (len(done.written), done.files_listed, done.left) == (1280, 1280, ())
    again = unpack_dataset(root / f"{NAMES[0]}.mat", manifest, root / "SIDD")
    assert len(again.same_size) == 1280
    return root


@in_one_test(
    "shape, words",
    [
        ((8, 8, 32, 32), r"holds 64 blocks, and the manifest lists 1280"),
        ((64, 64, 40, 32), r"holds 4096 blocks, and the manifest lists 1280"),
        ((1024, 8, 8), r"expected an array of blocks, .*found \[\('ValidationNoisyBlocksRaw', \(1024, 8, 8\)"),
    ],
)
def test_blocks_are_unpacked_whole_or_refused(shape: tuple[int, ...], words: str, tmp_path: Path) -> None:
    """Sides in another order, or blocks of another set under the same name; HDF5 is named for what it is."""
    manifest, file = shipped_manifest("sidd-blocks"), tmp_path / "blocks.mat"
    scipy.io.savemat(file, {NAMES[0]: np.zeros(shape, np.float32)})
    with pytest.raises(ArchiveError, match=words):
        unpack_dataset(file, manifest, tmp_path / "SIDD")
    with h5py.File(file, "w") as held:
        held[NAMES[0]] = np.zeros(shape, np.float32)
    with pytest.raises(ArchiveError, match="blocks as MATLAB's -v7 saves them"):
        unpack_dataset(file, manifest, tmp_path / "SIDD")
    assert not (tmp_path / "SIDD").exists()


def test_files_verify_and_items_are_the_blocks(blocks: Path) -> None:
    assert verify([shipped_manifest("sidd-blocks")], blocks, level="full").problems == ()
    dataset = SIDDDataset(blocks / "SIDD", subset="validation")
    assert len(dataset) == 1280
    # Row and column of R, G of its row, B, G of its row; image 0 is of the Galaxy, 1 of the Pixel, 4 of the iPhone.
    places: dict[int, list[tuple[int, int]]] = {
        0: [(0, 1), (0, 0), (1, 0), (1, 1)],
        1: [(1, 1), (1, 0), (0, 0), (0, 1)],
        4: [(0, 0), (0, 1), (1, 1), (1, 0)],
    }
    for image, starts in places.items():
        sample = dataset[32 * image + 31]
        for side, name in (("input", NAMES[0]), ("target", NAMES[1])):
            block = blocks_of(name)[image, 31]
            expected = [block[row::2, column::2] for row, column in starts]
            np.testing.assert_array_equal(sample[side], np.stack(expected))  # type: ignore[literal-required]


def test_scores_are_those_of_yonds_arithmetic(blocks: Path, tmp_path: Path) -> None:
    """Each block as a grey image; predictions are blocks, clipped to [0, 1] first. Of the Galaxy: GRBG."""
    truth = blocks_of(NAMES[1])
    predicted = truth + np.random.default_rng(3).normal(0, 0.03, truth.shape).astype(np.float32)
    folder = tmp_path / "SIDD_Validation_Raw" / NAMES[0]
    folder.mkdir(parents=True)
    expected = []
    for image, block in ((image, block) for image in GALAXY for block in range(32)):
        np.save(folder / f"{image:02}_{block:02}.npy", predicted[image, block])
        clipped, target = predicted[image, block].clip(0, 1), truth[image, block]
        expected.append((psnr_of(target, clipped, data_range=1), gaussian_ssim(clipped, target)))
    result = evaluate(tmp_path, "sidd-blocks", root=blocks, cameras=["GalaxyS6Edge"])
    assert (result.protocol.name, len(result.scores)) == ("yond-sidd", 256)
    found = [(one.psnr_db, one.ssim) for one in result.scores]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6)


def test_the_benchmark_is_predicted_and_not_scored(blocks: Path, tmp_path: Path) -> None:
    wanted: dict[str, Any] = {"subset": "benchmark", "cameras": ["iPhone7"], "clip": "none"}
    report = write_predictions(BaselineDenoiser("input"), "sidd-blocks", tmp_path / "out", root=blocks, **wanted)
    assert (report.written, report.problems) == (256, ())
    made = np.load(tmp_path / "out" / "SIDD_Benchmark_Raw" / NAMES[2] / "39_31.npy")
    np.testing.assert_array_equal(made[0], blocks_of(NAMES[2])[39, 31][0::2, 0::2])
    for refused in (
        lambda: evaluate(tmp_path / "out", "sidd-blocks", root=blocks, subset="benchmark"),
        lambda: SIDDDataset(blocks / "SIDD", subset="benchmark"),
    ):
        with pytest.raises(ArgumentError, match="1280 noisy frames of the subset 'benchmark'"):
            refused()


def test_ssim_of_a_mosaic_goes_with_raw_values_whose_places_are_known() -> None:
    with pytest.raises(ArgumentError, match="ssim_planes"):
        replace(get_protocol("sid2018"), ssim_planes="mosaic").check()
    with pytest.raises(ArgumentError, match="SSIM of mosaics"):
        protocol_of_tensors("yond-sidd")
