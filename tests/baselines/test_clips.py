"""Clips: the loss, the network of five frames, and predictions of a data set of clips; and tiles of any image."""

from __future__ import annotations

import json
import zipfile
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from eldata.baselines import NetworkDenoiser, UNet, clip_error, load_network, save_network
from eldata.baselines.noisy_frames import mirrored_window
from eldata.baselines.predicting import BaselineDenoiser, write_predictions
from eldata.baselines.prediction_folder import begin_folder
from eldata.baselines.tiling import tiled
from eldata.baselines.training import consistent_error
from eldata.cli.main import main
from eldata.datasets.published import DRVDataset
from eldata.errors import ArgumentError, DatasetError, EldataError
from eldata.evaluation.evaluate import evaluate
from eldata.evaluation.request import SETTINGS
from eldata.manifest.clips import Clip
from eldata.manifest.layouts import scan_raw
from tests.cases import in_one_test
from tests.drv_tree import SmallDrv, small_drv, write_raw_clip

HERE = "tests.baselines.test_clips"
CLIPS = ("0007", "0013")
SIZE = (48, 56)


# --- the loss ---------------------------------------------------------------------------------------------------------


def by_hand(noisy: NDArray[Any], clean: NDArray[Any], network: Any, window: int, weight: float) -> float:
    """The loss of a batch: what the first and the last window are off by, and how much that differs."""
    off = []
    for start in (0, noisy.shape[1] - window):
        target = clean if clean.ndim == 4 else clean[:, start + window // 2]
        off.append(network(noisy[:, start : start + window]) - target)
    return float(sum(np.abs(one).mean() for one in off) + weight * np.abs(off[0] - off[1]).mean())


@pytest.mark.parametrize(("window", "frames"), [(1, 2), (1, 4), (3, 4), (5, 6)])
@pytest.mark.parametrize("is_still", [True, False])
def test_the_loss_is_that_of_its_formula(window: int, frames: int, is_still: bool) -> None:
    rng = np.random.default_rng(window + frames)
    noisy = rng.random((3, frames, 4, 6, 5))
    clean = rng.random((3, 4, 6, 5) if is_still else noisy.shape)

    def network(batch: torch.Tensor) -> torch.Tensor:
        assert batch.shape == ((6, 4, 6, 5) if window == 1 else (6, window, 4, 6, 5))
        return batch**2 if window == 1 else (batch[:, window // 2] + batch[:, 0] * batch[:, -1])

    def same(frames: NDArray[Any]) -> NDArray[Any]:
        return np.asarray(frames[:, 0] ** 2 if window == 1 else frames[:, window // 2] + frames[:, 0] * frames[:, -1])

    batch = {"input": torch.from_numpy(noisy), "target": torch.from_numpy(clean)}
    for weight in (0.0, 0.05, 2.0):
        found = clip_error(network, batch, window=window, weight=weight)  # type: ignore[arg-type] # a function will do
        assert found.item() == pytest.approx(by_hand(noisy, clean, same, window, weight), rel=1e-12)


def test_of_a_still_it_is_the_published_loss() -> None:
    """|f1 - y| + |f2 - y| + 0.05 |f1 - f2|, and what moves as the clean frames move is not flicker."""
    first, second, clean = torch.rand(3, 2, 4, 5, 6, generator=torch.Generator().manual_seed(3)).double()
    expected = (first - clean).abs().mean() + (second - clean).abs().mean() + 0.05 * (first - second).abs().mean()
    assert consistent_error(first, second, clean, clean).item() == pytest.approx(expected.item(), rel=1e-12)
    moved = consistent_error(first + 1, second + 1, first, second, weight=7.0)
    assert moved.item() == pytest.approx(2.0, rel=1e-12)
    with pytest.raises(ArgumentError, match="weight is 0 or more"):
        consistent_error(first, second, clean, clean, weight=-1.0)
    with pytest.raises(ArgumentError, match="clips of 4 frames or more"):
        clip_error(torch.nn.Identity(), {"input": first[None], "target": clean[None]}, window=3)


# --- the network ------------------------------------------------------------------------------------------------------


def test_a_network_of_windows_sees_frames_as_channels() -> None:
    network = UNet(3, width=4, depth=1, frames=5, seed=2)
    single = UNet(3, width=4, depth=1, inputs=15, seed=2)
    windows = torch.rand(2, 5, 3, 8, 12, generator=torch.Generator().manual_seed(0))
    with torch.inference_mode():
        assert torch.equal(network(windows), single(windows.reshape(2, 15, 8, 12)))
    assert (network.window, single.window) == (5, 1)
    with pytest.raises(ArgumentError, match="frames are odd"):
        UNet(frames=4)


# --- predictions ------------------------------------------------------------------------------------------------------


def small_network() -> UNet:
    return UNet(3, width=3, depth=1, frames=5, seed=4)


def later(window: torch.Tensor) -> torch.Tensor:
    """Of a window of three frames (1, 3, C, h, w) the last one, darker."""
    return 0.5 * window[:, 2]


@pytest.fixture(scope="module")
def drv(tmp_path_factory: pytest.TempPathFactory) -> SmallDrv:
    """Two static clips of eleven frames, of which the fifth to the ninth are scored."""
    return small_drv(tmp_path_factory.mktemp("drv"), CLIPS, 11, size=SIZE)


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The small network's file. Not to be changed."""
    path = tmp_path_factory.mktemp("exported") / "net.pt2"
    save_network(small_network(), path, channels=3, multiple=2, window=5, clip="none")
    return path


def of_set(drv: SmallDrv) -> dict[str, Any]:
    return {"manifest": drv.csv, "root": drv.root, "ids": list(CLIPS)}


@pytest.mark.parametrize("kind", ["module", "export"])
def test_predictions_of_clips_are_the_networks_own(kind: str, drv: SmallDrv, exported: Path, tmp_path: Path) -> None:
    network = small_network().eval()
    name = f"{HERE}:small_network" if kind == "module" else str(exported)
    loaded = load_network(name, multiple=2, device="cpu")
    assert (loaded.window, loaded.multiple) == (5, 2)
    report = write_predictions(loaded, "", tmp_path / "p", **of_set(drv))
    assert (report.written, report.kept, report.problems) == (10, 0, ())
    everything = DRVDataset(drv.data, manifest=drv.csv, window=11, ids=CLIPS)
    for sample in everything:
        frames = sample["input"]
        for number in range(4, 9):
            with torch.inference_mode():
                expected = network(frames[None, number - 2 : number + 3])[0].numpy()
            found = np.load(tmp_path / "p" / sample["scene"] / f"{number + 1:04d}.npy")
            np.testing.assert_allclose(found, expected, atol=2e-6)


def test_frames_by_themselves_and_raw_clips(tmp_path: Path) -> None:
    """A network of single frames goes over clips frame by frame; what it gets of raws is the input that is scored."""
    data = tmp_path / "data" / "DRV"
    for clip in CLIPS:
        write_raw_clip(data, clip, 9)
    scan_raw(data).save(tmp_path / "raw.csv")
    options: dict[str, Any] = {"manifest": tmp_path / "raw.csv", "root": tmp_path / "data"}
    report = write_predictions(BaselineDenoiser("input"), "", tmp_path / "p", clip="protocol", ids=CLIPS, **options)
    assert (report.written, report.problems) == (10, ())
    ours = evaluate(tmp_path / "p", ids=CLIPS, **options)
    theirs = evaluate(None, baseline="input", ids=CLIPS, **options)
    assert [one.psnr_db for one in ours.scores] == [one.psnr_db for one in theirs.scores]
    assert [one.values["st_rred"] for one in ours.scores] == [one.values["st_rred"] for one in theirs.scores]

    window = load_network(f"{HERE}:later", window=3, device="cpu", multiple=1)
    write_predictions(window, "", tmp_path / "w", clip="none", ids=["0007"], **options)
    sample = DRVDataset(data, form="raw", ids=["0007"], window=9, clip="none")[0]
    names = [f"DSC{998 + number:05d}.npy" for number in range(4, 9)]
    nexts = [5, 6, 7, 8, 7]  # of the last frame the mirrored one
    for name, number in zip(names, nexts, strict=True):
        found = np.load(tmp_path / "w" / "0007" / name)
        np.testing.assert_array_equal(found, 0.5 * sample["input"][number].numpy())


def test_windows_are_mirrored_at_the_ends() -> None:
    """Held against numpy's own mirroring."""
    for count in (3, 4, 7):
        clip = Clip("0001", "test", "", tuple(f"{k}.png" for k in range(count)), tuple(range(count)), None)
        for length in (1, 3, 5):
            padded = np.pad(np.arange(count), length // 2, mode="reflect")
            for place in range(count):
                expected = [f"{k}.png" for k in padded[place : place + length]]
                assert list(mirrored_window(clip, f"{place}.png", length)) == expected
    with pytest.raises(DatasetError, match="clip 0001: has 3 frames; a window of 7 needs 4"):
        mirrored_window(Clip("0001", "test", "", ("a1", "a2", "a3"), (1, 2, 3), None), "a1", 7)
    gapped = Clip("0001", "test", "", ("a1", "a2", "a4"), (1, 2, 4), None)
    assert mirrored_window(gapped, "a1", 3) == ("a2", "a1", "a2")
    with pytest.raises(DatasetError, match="clip 0001: a number is missing near a2"):
        mirrored_window(gapped, "a2", 3)


def test_tiles_of_a_clip_are_the_whole_frame() -> None:
    """A network of depth 1 reaches 9 pixels, a quarter of an overlap of 40 is 10; it halves frames, as tiles begin."""
    network = UNet(4, width=3, depth=1, frames=5, seed=4).eval()
    frames = np.random.default_rng(0).random((5, 4, 210, 188)).astype(np.float32)
    frame: Any = SimpleNamespace(window=lambda length: frames[:length])  # as much of it as a network asks for
    found = NetworkDenoiser(partial(run, network), {}, tile=160, overlap=40, multiple=2, window=5)(frame)
    assert np.abs(found - run(network, frames)).max() < 5e-6


def test_a_clip_that_was_begun_goes_on_frame_by_frame(drv: SmallDrv, tmp_path: Path) -> None:
    out = tmp_path / "p"
    write_predictions(load_network(f"{HERE}:later", window=3, multiple=1), "", out, **of_set(drv))
    files = {file: (file.stat().st_mtime_ns, file.read_bytes()) for file in sorted(out.rglob("*.npy"))}
    gone = [*files][2::5]
    for file in gone:
        file.unlink()
    report = write_predictions(load_network(f"{HERE}:later", window=3, multiple=1), "", out, **of_set(drv))
    assert (report.written, report.kept) == (2, 8)
    assert all(file.read_bytes() == content for file, (_, content) in files.items())
    assert [file for file, (time, _) in files.items() if file.stat().st_mtime_ns != time] == gone
    with pytest.raises(ArgumentError, match="started with window 3, now 1"):
        write_predictions(load_network(f"{HERE}:later", multiple=1), "", out, **of_set(drv))


# --- what networks state ----------------------------------------------------------------------------------------------


def test_a_file_records_what_its_network_takes_and_others_are_refused(
    drv: SmallDrv, exported: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = exported
    loaded = load_network(str(path), device="cpu")
    assert (loaded.window, loaded.multiple, loaded.clip) == (5, 2, "none")
    assert load_network(str(path), multiple=8, device="cpu").multiple == 8
    choice = ["--manifest", str(drv.csv), "--root", str(drv.root), "--clip", "0007", "-o", str(tmp_path / "p")]
    for options, said in (
        (["--window", "3"], "takes windows of 5 frames, by its own account; found --window 3: leave it out"),
        (["--multiple", "3"], "takes sides that are multiples of 2, by its own account; found --multiple 3"),
        (["--input-clip", "both"], "was trained with inputs clipped as 'none', by its own account; found 'both'"),
        (["--input-clip", "protocol"], "was trained with inputs clipped as 'none'"),
    ):
        assert main(["predict", str(path), *choice, *options]) == 2
        error = capsys.readouterr().err
        assert said in error
        assert error.count("\n") == 1
        assert not (tmp_path / "p").exists()
    assert main(["predict", str(path), *choice]) == 0
    assert json.loads((tmp_path / "p" / SETTINGS).read_text(encoding="utf-8"))["clip"] == "none"
    with pytest.raises(ArgumentError, match="number is odd; found 4"):
        load_network(f"{HERE}:later", window=4)


def test_a_network_of_clips_is_refused_where_there_are_photographs(
    drv: SmallDrv, demo_tree: Path, tmp_path: Path
) -> None:
    network = load_network(f"{HERE}:small_network", device="cpu")
    manifest = next((demo_tree / "manifests").glob("*.csv"))
    with pytest.raises(ArgumentError, match=r"takes windows of 5 frames of a clip, and .* is a dataset of photographs"):
        write_predictions(network, "", tmp_path / "p", manifest=manifest, root=demo_tree / "data")
    assert not (tmp_path / "p").exists()


@in_one_test(
    "record, said",
    [
        ('{"schema": 2}', "field schema: expected 1"),
        ('{"schema": 1, "window": 4}', "field window: expected an odd number of frames, found 4"),
        ('{"schema": 1, "window": 100000000000}', "field window: expected a whole number"),
        ('{"schema": 1, "clip": "all"}', "field clip: expected one of"),
        ('{"schema": 1, "frames": 5}', "field frames: is unknown"),
        ("{", "is not JSON"),
    ],
)
def test_a_record_that_lies_is_named(record: str, said: str, exported: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(exported) as archive, zipfile.ZipFile(tmp_path / "net.pt2", "w") as copy:
        for name in archive.namelist():
            copy.writestr(name, record if name.endswith("extra/eldata.json") else archive.read(name))
    with pytest.raises(EldataError, match=rf"net.pt2, eldata.json.*{said}"):
        load_network(str(tmp_path / "net.pt2"), device="cpu")


class Wide(torch.nn.Conv2d):
    """A network all of whose arguments have defaults."""

    def __init__(self, channels: int = 3, kernel: int = 1) -> None:
        super().__init__(channels, channels, kernel)


def wide(channels: int = 3) -> Wide:
    return Wide(channels)


def any_images(*images: torch.Tensor) -> torch.Tensor:
    return images[0] * 2


def test_what_makes_a_network_and_what_is_one() -> None:
    image = np.ones((3, 4, 4), np.float32)
    for name in ("Wide", "wide"):
        assert load_network(f"{HERE}:{name}", device="cpu").run(image).shape == (3, 4, 4)
    np.testing.assert_array_equal(load_network(f"{HERE}:any_images", device="cpu").run(image), 2 * image)
    np.testing.assert_array_equal(load_network("torch:relu", device="cpu").run(image), image)
    with pytest.raises(ArgumentError, match=r"torch.nn:Conv2d is a class whose in_channels, out_channels, kernel_size"):
        load_network("torch.nn:Conv2d", device="cpu")


# --- two at once ------------------------------------------------------------------------------------------------------


def test_the_same_work_may_be_done_by_several(tmp_path: Path) -> None:
    """And none of them leaves the folder to other work as long as one is there."""
    pytest.importorskip("fcntl")
    same = {"schema": 1, "denoiser": "one"}
    with begin_folder(tmp_path / "p", same):
        pass
    second = begin_folder(tmp_path / "p", same)
    with begin_folder(tmp_path / "p", same):
        second.__enter__()
    with (
        pytest.raises(ArgumentError, match="started with denoiser"),
        begin_folder(tmp_path / "p", {**same, "denoiser": "two"}),
    ):
        pass
    second.__exit__(None, None, None)
    with begin_folder(tmp_path / "p", {**same, "denoiser": "two"}):
        assert json.loads((tmp_path / "p" / SETTINGS).read_text(encoding="utf-8"))["denoiser"] == "two"


# --- tiles ------------------------------------------------------------------------------------------------------------


def run(module: torch.nn.Module, image: np.ndarray) -> np.ndarray:
    with torch.inference_mode():
        return np.asarray(module(torch.from_numpy(image)[None])[0].numpy())


@settings(max_examples=25, deadline=None)
@given(
    st.integers(9, 90), st.integers(9, 90), st.sampled_from([(32, 16), (48, 16), (64, 32)]), st.sampled_from([1, 4, 8])
)
def test_tiles_are_the_whole_image(height: int, width: int, sides: tuple[int, int], multiple: int) -> None:
    """Three convolutions of 3 x 3 reach 3 pixels; a quarter of an overlap of 16 is 4."""
    image = np.random.default_rng(height * 100 + width).random((4, height, width)).astype(np.float32)
    torch.manual_seed(17)
    module = torch.nn.Sequential(
        *(part for _ in range(3) for part in (torch.nn.Conv2d(4, 4, 3, padding=1), torch.nn.ReLU()))
    )
    tile, overlap = sides
    whole = tiled(lambda part: run(module, part), image, tile=0, overlap=0, multiple=multiple)
    found = tiled(lambda part: run(module, part), image, tile=tile, overlap=overlap, multiple=multiple)
    assert found.shape == image.shape
    assert np.abs(found - whole).max() < 2e-6


@pytest.mark.parametrize(("tile", "overlap", "multiple"), [(30, 8, 4), (32, 6, 4), (32, 20, 4), (-1, 0, 1), (32, 8, 0)])
def test_what_does_not_go_together(tile: int, overlap: int, multiple: int) -> None:
    with pytest.raises(ArgumentError, match="multiple"):
        tiled(lambda part: part, np.zeros((4, 64, 64), np.float32), tile=tile, overlap=overlap, multiple=multiple)


def test_images_that_do_not_fit_are_named() -> None:
    with pytest.raises(ArgumentError, match=r"of an image of \(4, 64, 64\) it made \(4, 62, 62\)"):
        tiled(lambda part: part[:, 1:-1, 1:-1], np.zeros((4, 64, 64), np.float32), tile=0, overlap=0, multiple=1)
    with pytest.raises(ArgumentError, match="too small to be extended to multiples of 16"):
        tiled(lambda part: part, np.zeros((4, 5, 64), np.float32), tile=0, overlap=0, multiple=16)
