"""SIDD's blocks: from MATLAB's arrays to files, items and scores, against scipy, numpy and scikit-image alone."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import scipy.io
from skimage.metrics import peak_signal_noise_ratio

from eldata import evaluate
from eldata.baselines.predicting import write_predictions
from eldata.datasets import SIDDDataset
from eldata.download import unpack_dataset
from eldata.errors import ArchiveError, ArgumentError
from eldata.integrations.protocol_scores import protocol_of_tensors
from eldata.manifest.catalogue import shipped_manifest
from eldata.manifest.verify import verify
from eldata.protocols import get_protocol
from tests.sidd_tree import blocks_of

if TYPE_CHECKING:
    from collections.abc import Collection
    from pathlib import Path

    from numpy.typing import NDArray

    from eldata.baselines.noisy_frames import NoisyFrame

NAMES = ("ValidationNoisyBlocksRaw", "ValidationGtBlocksRaw", "BenchmarkNoisyBlocksRaw")
GALAXY = (0, 9, 12, 17, 22, 27, 32, 37)
psnr_of: Any = peak_signal_noise_ratio  # scikit-image has annotations in part only


def ssim_by_yond(prediction: NDArray[Any], target: NDArray[Any]) -> float:
    """YOND_SIDD.py calculate_ssim and ssim: of values up to 255, filter2D cut to where the window lies inside."""
    taps = np.exp(-((np.arange(11) - 5.0) ** 2) / (2 * 1.5**2))
    window = np.outer(taps, taps) / taps.sum() ** 2

    def filtered(image: NDArray[Any]) -> NDArray[Any]:
        windows = np.lib.stride_tricks.sliding_window_view(image, (11, 11))
        return np.asarray(np.einsum("ijkl,kl->ij", windows, window))

    one, two = (image.astype(np.float64) * 255 for image in (prediction, target))
    mean_one, mean_two = filtered(one), filtered(two)
    var_one, var_two = filtered(one**2) - mean_one**2, filtered(two**2) - mean_two**2
    covariance = filtered(one * two) - mean_one * mean_two
    c1, c2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2
    above = (2 * mean_one * mean_two + c1) * (2 * covariance + c2)
    return float((above / ((mean_one**2 + mean_two**2 + c1) * (var_one + var_two + c2))).mean())


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The three files unpacked, as `eldata download sidd-blocks --from` does."""
    root, manifest = tmp_path_factory.mktemp("data"), shipped_manifest("sidd-blocks")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("os.fsync", lambda _: None)  # 3840 of them take minutes on a slow disk
        for name in NAMES:
            file = root / f"{name}.mat"
            scipy.io.savemat(file, {name: blocks_of(name), "OptionalData": {"MethodName": "x"}}, do_compression=True)
            done = unpack_dataset(file, manifest, root / "SIDD")
            assert (len(done.unpacked.written), done.files_listed, done.left) == (1280, 1280, ())
    again = unpack_dataset(root / f"{NAMES[0]}.mat", manifest, root / "SIDD")
    assert len(again.unpacked.identical) == 1280
    return root


def test_files_verify_and_items_are_the_blocks(root: Path) -> None:
    assert verify([shipped_manifest("sidd-blocks")], root, level="full").problems == ()
    dataset = SIDDDataset(root / "SIDD", subset="validation")
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


def test_scores_are_those_of_yonds_arithmetic(root: Path, tmp_path: Path) -> None:
    """Each block as a grey image; predictions are blocks, clipped to [0, 1] first. Of the Galaxy: GRBG."""
    truth = blocks_of(NAMES[1])
    predicted = truth + np.random.default_rng(3).normal(0, 0.03, truth.shape).astype(np.float32)
    folder = tmp_path / "SIDD_Validation_Raw" / NAMES[0]
    folder.mkdir(parents=True)
    expected = []
    for image, block in ((image, block) for image in GALAXY for block in range(32)):
        np.save(folder / f"{image:02}_{block:02}.npy", predicted[image, block])
        clipped, target = predicted[image, block].clip(0, 1), truth[image, block]
        expected.append((psnr_of(target, clipped, data_range=1), ssim_by_yond(clipped, target)))
    result = evaluate(tmp_path, "sidd-blocks", root=root, cameras=["GalaxyS6Edge"])
    assert (result.protocol.name, len(result.images)) == ("yond-sidd", 256)
    found = [(one.psnr_db, one.ssim) for one in result.images]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6)


@dataclass(frozen=True)
class Same:
    """Returns its input."""

    def settings(self, cameras: Collection[str], channels: Collection[int]) -> dict[str, Any]:
        return {"denoiser": f"same for {len(cameras)} of {channels}"}

    def __call__(self, frame: NoisyFrame) -> NDArray[Any]:
        return frame.image


def test_the_benchmark_is_predicted_and_not_scored(root: Path, tmp_path: Path) -> None:
    phones = ["iPhone7"]
    report = write_predictions(Same(), "sidd-blocks", tmp_path / "out", root=root, subset="benchmark", cameras=phones)
    assert (report.written, report.problems) == (256, ())
    made = np.load(tmp_path / "out" / "SIDD_Benchmark_Raw" / NAMES[2] / "39_31.npy")
    np.testing.assert_array_equal(made[0], blocks_of(NAMES[2])[39, 31][0::2, 0::2])
    for refused in (
        lambda: evaluate(tmp_path / "out", "sidd-blocks", root=root, subset="benchmark"),
        lambda: SIDDDataset(root / "SIDD", subset="benchmark"),
    ):
        with pytest.raises(ArgumentError, match="1280 noisy frames of the subset 'benchmark'"):
            refused()


def test_files_of_matlab_that_hold_no_blocks(tmp_path: Path) -> None:
    manifest = shipped_manifest("sidd-blocks")
    scipy.io.savemat(tmp_path / "x.mat", {"x": np.zeros((3, 4))})
    with pytest.raises(ArchiveError, match="one array of blocks"):
        unpack_dataset(tmp_path / "x.mat", manifest, tmp_path / "SIDD")
    whole = (tmp_path / "x.mat").read_bytes()
    (tmp_path / "cut.mat").write_bytes(whole[:140])
    (tmp_path / "x.bin").write_bytes(whole)
    for name, reason in (("cut.mat", "damaged"), ("x.bin", r"ends in \.mat")):
        with pytest.raises(ArchiveError, match=reason):
            unpack_dataset(tmp_path / name, manifest, tmp_path / "SIDD")


def test_ssim_of_a_mosaic_goes_with_raw_values_whose_places_are_known() -> None:
    with pytest.raises(ArgumentError, match="ssim_planes"):
        replace(get_protocol("sid2018"), ssim_planes="mosaic").check()
    with pytest.raises(ArgumentError, match="SSIM of mosaics"):
        protocol_of_tensors("yond-sidd")
