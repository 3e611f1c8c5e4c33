"""Predictions in every format; what is wrong is named; strangers' files cost neither memory nor other files."""

from __future__ import annotations

import json
import pickle
import subprocess
import sys
import tracemalloc
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import imagecodecs
import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from eldata.base.arrays import read_array
from eldata.datasets import DRVDataset
from eldata.errors import ArgumentError, PredictionError
from eldata.evaluation import evaluate, load_prediction, save_clip_prediction, save_prediction
from eldata.evaluation.predictions import load_colours
from eldata.raw.dng import write_dng
from eldata.raw.reading import read_raw
from eldata.records import Exposure
from tests.bait import Bait
from tests.drv_tree import SmallDrv
from tests.evaluation import hostile_predictions as hostile
from tests.evaluation import oracle
from tests.evaluation.helpers import SIZE, Tree, place
from tests.evaluation.prediction_files import FILES, OF_PACKED, Writer, h5, quantised, save_npy, save_npz, save_png, tif
from tests.waiting import PATIENCE_S

PACKED = (4, SIZE[0] // 2, SIZE[1] // 2)
VICTIM = "DemoAlpha/scene-1/IMG_0004.dng"


# --- every format ---------------------------------------------------------------------------------------------


@pytest.mark.filterwarnings("ignore:Reading `.npy`")  # of Python 2
@pytest.mark.parametrize("name", [*FILES, *OF_PACKED])
def test_every_format_is_read_as_what_it_stands_for(name: str, tree: Tree, tmp_path: Path) -> None:
    """Packed and as a mosaic, whose sites LibRaw tells. float32 has seven digits."""
    kind, save = (FILES | OF_PACKED)[name]
    stored, stands_for = quantised(np.random.default_rng(7).random(PACKED), kind)
    sensor, path = read_raw(tree.files / VICTIM).sensor, tmp_path / name
    forms = [] if name in OF_PACKED else [oracle.unpack(stored, oracle.decode(tree.files / VICTIM).pattern)]
    for form in forms if path.suffix == ".png" else [*forms, stored]:
        save(path, form)
        np.testing.assert_allclose(load_prediction(path, sensor, "published"), stands_for, rtol=1e-7)


@pytest.mark.parametrize("compression", ["none", "lossless-jpeg"])
def test_a_dng_is_read_with_its_own_black_and_the_published_white(tree: Tree, tmp_path: Path, compression: Any) -> None:
    sensor, frame = read_raw(tree.files / VICTIM).sensor, oracle.decode(tree.files / VICTIM)
    black = frame.black[:, None, None]
    dn = np.rint(np.random.default_rng(7).random(PACKED) * (oracle.WHITE_DN - black) + black)
    mosaic = oracle.unpack(dn.astype(np.uint16), frame.pattern)
    write_dng(tmp_path / "x.dng", mosaic, sensor, Exposure(), compression=compression)
    found = load_prediction(tmp_path / "x.dng", sensor, "published")
    np.testing.assert_allclose(found, (dn - black) / (oracle.WHITE_DN - black), rtol=1e-6)


def test_save_prediction_is_found_and_read_back(tree: Tree, drv: SmallDrv, tmp_path: Path) -> None:
    sensor = read_raw(tree.files / VICTIM).sensor
    values = np.random.default_rng(3).random(PACKED, dtype=np.float32)
    path = save_prediction(tmp_path / "new" / "folder", VICTIM, values)
    assert path == tmp_path / "new" / "folder" / "DemoAlpha" / "scene-1" / "IMG_0004.npy"
    assert np.array_equal(load_prediction(path, sensor, "published"), values)
    record = DRVDataset(drv.data, split="test", frames="evaluation", manifest=drv.csv).records[0]
    with pytest.raises(ArgumentError, match="expected 5 predicted frames, found 4"):
        save_clip_prediction(tmp_path, record, np.zeros((4, *PACKED)))


@pytest.mark.parametrize("name", FILES)
def test_a_prediction_takes_less_than_three_times_its_array(name: str, tree: Tree, tmp_path: Path) -> None:
    """The array as it is loaded; a mosaic is packed into another, so twice is the least."""
    kind, save = FILES[name]
    for size in (SIZE, (512, 768)):  # what is loaded on first use is not counted
        save(tmp_path / name, quantised(np.random.default_rng(3).random(size), kind)[0])
        sensor = replace(read_raw(tree.files / VICTIM).sensor, height=size[0], width=size[1])
        tracemalloc.start()
        loaded = load_prediction(tmp_path / name, sensor, "metadata")
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    assert 1.4 < peak / loaded.nbytes < 3


# --- what is wrong is named -----------------------------------------------------------------------------------


def good() -> NDArray[np.float32]:
    return np.random.default_rng(1).random(PACKED, dtype=np.float32)


def spoilt(value: float) -> NDArray[np.float32]:
    array = good()
    array[2, 5, 7] = value
    return array


def spoil(write: Writer, change: Callable[[bytes], bytes]) -> Callable[[Path], None]:
    """A writer of a file whose content is changed."""

    def save(path: Path) -> None:
        write(path, np.rint(oracle_mosaic() * 65535).astype(np.uint16))
        path.write_bytes(change(path.read_bytes()))

    return save


def cut(write: Writer, share: float = 0.6) -> Callable[[Path], None]:
    return spoil(write, lambda content: content[: int(len(content) * share)])


def longer(write: Writer, share: float = 0.75) -> Callable[[Path], None]:
    """With six bytes more: without a checksum all that follow are read shifted."""
    return spoil(write, lambda content: content[: (at := int(len(content) * share))] + b"\7" * 6 + content[at:])


def damaged(write: Writer) -> Callable[[Path], None]:
    """With bytes in the middle changed, of a format that would notice."""

    def change(content: bytes) -> bytes:
        middle = len(content) // 2
        return content[:middle] + bytes(255 - byte for byte in content[middle : middle + 16]) + content[middle + 16 :]

    return spoil(write, change)


def oracle_mosaic() -> NDArray[np.float64]:
    return np.random.default_rng(2).random(SIZE)


def npy(make: Callable[[], NDArray[Any]]) -> Callable[[Path], None]:
    return lambda path: np.save(path, make())


def several_datasets(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file["first"], file["second"] = good(), good()


def png(make: Callable[[], NDArray[Any]]) -> Callable[[Path], None]:
    return lambda path: save_png(path, make())


def save_dng(path: Path, mosaic: NDArray[Any], cfa: tuple[tuple[int, ...], ...] = ((0, 1), (3, 2))) -> None:
    from eldata.demo.camera import CAMERAS

    sensor = replace(CAMERAS[0].with_size(*mosaic.shape).sensor, cfa=cfa)
    write_dng(path, mosaic.astype(np.uint16), sensor, Exposure())


DEFLATED = tif(compression="zlib", byteorder=">")
SHAPES = [str(PACKED), str(SIZE)]
SEVERAL = ["one array", "'prediction'", "first, second"]

# extension, writer, words that the reason must have: what was expected, what was found, what to do.
BAD: dict[str, tuple[str, Callable[[Path], None], list[str]]] = {
    "channels-last": (".npy", npy(lambda: good().transpose(1, 2, 0)), [*SHAPES, "(32, 48, 4)", "transpose(2, 0, 1)"]),
    "batch-dimension": (".npy", npy(lambda: good()[None]), [*SHAPES, "(1, 4, 32, 48)", "prediction[0]"]),
    "smaller": (".npy", npy(lambda: good()[:, 1:, :]), [*SHAPES, "(4, 31, 48)", "whole frame"]),
    "turned": (".npy", npy(lambda: good().transpose(0, 2, 1)), [*SHAPES, "(4, 48, 32)", "orientation"]),
    "nan": (".npy", npy(lambda: spoilt(np.nan)), ["finite", "1 NaN", "(2, 5, 7)"]),
    "infinite": (".npy", npy(lambda: spoilt(np.inf)), ["finite", "infinite", "(2, 5, 7)"]),
    "dn": (".npy", npy(lambda: good() * 15871), ["[0, 1]", "DN", "divide", "15871"]),
    "uint8": (".npy", npy(lambda: (good() * 255).astype(np.uint8)), ["float", "uint16", "uint8", "convert"]),
    "complex": (".npy", npy(lambda: good().astype(np.complex64)), ["float", "complex64", "convert"]),
    "npz-several": (".npz", lambda path: np.savez(path, first=good(), second=good()), SEVERAL),
    "h5-several": (".h5", several_datasets, SEVERAL),
    "png-8-bit": (".png", png(lambda: (oracle_mosaic() * 255).astype(np.uint8)), ["uint16", "uint8"]),
    "png-rgba": (".png", png(lambda: np.full((*SIZE, 4), 999, np.uint16)), [*SHAPES, "(64, 96, 4)", "PNG", "grey"]),
    # Packed channels have the shape of a channels-last array, but no PNG can be channels-first.
    "png-rgb": (".png", png(lambda: np.full((*SIZE, 3), 999, np.uint16)), [*SHAPES, "(64, 96, 3)", "PNG", "grey"]),
    "dng-size": (".dng", lambda path: save_dng(path, oracle_mosaic()[:32] * 9999), ["64 x 96", "32 x 96"]),
    "dng-larger": (".dng", lambda path: save_dng(path, np.ones((256, 256))), ["64 x 96", "one of 65536 pixels"]),
    "dng-phase": (
        ".dng",
        lambda path: save_dng(path, oracle_mosaic() * 9999, ((1, 0), (2, 3))),
        ["CFA", "((0, 1), (3, 2))", "((1, 0), (2, 3))"],
    ),
    "dng-cut": (".dng", cut(save_dng, 0.5), ["truncated"]),
    "npy-cut": (".npy", cut(save_npy), ["cannot be read as npy", "write it again"]),
    "h5-cut": (".h5", cut(h5()), ["cannot be read as h5", "write it again"]),
    "png-cut": (".png", cut(save_png), ["does not end as a PNG does"]),
    "npy-longer": (".npy", longer(save_npy), ["declares 12288 bytes of values and has 12294", "inserted?"]),
    "png-longer": (".png", longer(save_png, 1.0), ["does not end as a PNG does"]),
    "npz-damaged": (".npz", damaged(save_npz), ["cannot be read as npz", "write it again"]),
    "tiff-damaged": (".tiff", damaged(DEFLATED), ["cannot be read as tiff", "write it again"]),
    "png-damaged": (".png", damaged(save_png), ["cannot be read as png", "write it again"]),
    **{
        f"{kind}-garbage": (f".{kind}", hostile.content(b"this is no such file at all " * 100), [])
        for kind in ("npy", "npz", "h5", "tif", "png", "dng")
    },
    **{f"{kind}-empty": (f".{kind}", hostile.content(b""), []) for kind in ("npy", "npz", "h5", "tif", "png", "dng")},
}


@pytest.mark.parametrize("name", BAD)
def test_bad_prediction_is_named_with_what_to_do(name: str, tree: Tree, tmp_path: Path) -> None:
    extension, write, words = BAD[name]
    path = tmp_path / f"x{extension}"
    write(path)
    with pytest.raises(PredictionError) as caught:
        load_prediction(path, read_raw(tree.files / VICTIM).sensor, "published")
    assert caught.value.path == path
    reason = caught.value.reason
    assert len(reason) > 15
    assert "\n" not in reason
    for word in words:
        assert word in reason


def test_bait(tmp_path: Path) -> None:
    """The pickles below do their harm where pickles are run, so the tests below can fail."""
    np.save(tmp_path / "bait.npy", np.array([Bait(tmp_path / "marker")], dtype=object), allow_pickle=True)
    np.load(tmp_path / "bait.npy", allow_pickle=True)
    assert (tmp_path / "marker").is_dir()


def pickled_npy(path: Path, bait: Bait) -> None:
    np.save(path, np.array([bait], dtype=object), allow_pickle=True)


def pickled_npz(path: Path, bait: Bait) -> None:
    np.savez(path, prediction=np.array([bait], dtype=object))


def bare_pickle(path: Path, bait: Bait) -> None:
    path.write_bytes(pickle.dumps(bait))


@pytest.mark.parametrize(
    ("extension", "write"),
    [(".npy", pickled_npy), (".npz", pickled_npz), (".npy", bare_pickle), (".npz", bare_pickle), (".h5", bare_pickle)],
)
def test_a_pickle_is_refused_and_never_run(
    extension: str, write: Callable[[Path, Bait], None], tree: Tree, tmp_path: Path
) -> None:
    path = tmp_path / f"x{extension}"
    write(path, Bait(tmp_path / "marker"))
    with pytest.raises(PredictionError):
        load_prediction(path, read_raw(tree.files / VICTIM).sensor, "published")
    assert not (tmp_path / "marker").exists()


# --- scale ----------------------------------------------------------------------------------------------------


def test_a_few_hot_pixels_are_no_scale_problem(tree: Tree, tmp_path: Path) -> None:
    """An amplified input has some values far above 1; they are clamped when they are scored."""
    np.save(tmp_path / "x.npy", spoilt(77.0))
    loaded = load_prediction(tmp_path / "x.npy", read_raw(tree.files / VICTIM).sensor, "published")
    assert np.array_equal(loaded, spoilt(77.0))


@pytest.mark.parametrize("factor", [0.1, 1 / 255])
def test_a_dark_scale_is_noted_because_rescaling_hides_it(factor: float, tree: Tree, tmp_path: Path) -> None:
    place(tmp_path, tree, lambda target, _: target * factor + 1e-4)
    result = evaluate(tmp_path, **tree.where)
    (note,) = (note for note in result.notes if "saturate" not in note)
    assert "12 of 12 predictions" in note
    assert "scale" in note


# --- renderings in sRGB -----------------------------------------------------------------------------------------------

RGB_SHAPE = (3, 6, 8)


@pytest.mark.parametrize(("bits", "pixels"), [(8, "srgb"), (16, "srgb"), (16, "rgb")])
@pytest.mark.parametrize("extension", ["png", "npy", "tif"])
def test_integers_become_the_same_floats_as_by_division(bits: int, pixels: Any, extension: str, tmp_path: Path) -> None:
    """Every code. Of frames that are no renderings, arrays have their channels first."""
    codes = np.resize(np.arange(2**bits, dtype=f"uint{bits}"), (256, 256, 3))
    path = tmp_path / f"x.{extension}"
    first = pixels == "rgb" and extension != "png"
    stored = np.ascontiguousarray(codes.transpose(2, 0, 1)) if first else codes
    if extension == "png":
        path.write_bytes(imagecodecs.png_encode(stored))
    elif extension == "tif":
        tifffile.imwrite(path, stored, photometric="minisblack" if first else "rgb")
    else:
        np.save(path, stored)
    found = load_colours(path, (3, 256, 256), pixels)
    assert np.array_equal(found, (codes.astype(np.float32) / np.float32(2**bits - 1)).transpose(2, 0, 1))


@pytest.mark.parametrize(
    ("pixels", "array", "said"),
    [
        ("srgb", np.zeros((6, 8)), "one grey channel"),
        ("srgb", np.zeros((4, 6, 8)), "packed raw, or with alpha"),
        ("srgb", np.zeros((6, 7, 3)), r"expected \(6, 8, 3\) or \(3, 6, 8\), found \(6, 7, 3\); render the whole"),
        ("srgb", np.full((6, 8, 3), 200.0), "divide by 65535 or 255"),
        ("srgb", np.full((6, 8, 3), np.nan), "finite"),
        ("rgb", np.zeros((6, 8, 3)), "channels-last"),
        ("rgb", np.zeros(RGB_SHAPE, np.uint8), "found uint8"),
        ("rgb", np.zeros((3, 5, 5)), r"expected shape \(3, 6, 8\) \(R, G, B\), found \(3, 5, 5\); predict the whole"),
        ("rgb", np.full(RGB_SHAPE, np.nan), "1?44 NaN"),
    ],
)
def test_bad_colours(pixels: Any, array: NDArray[Any], said: str, tmp_path: Path) -> None:
    np.save(tmp_path / "x.npy", array)
    with pytest.raises(PredictionError, match=said):
        load_colours(tmp_path / "x.npy", RGB_SHAPE, pixels)


def test_a_dng_is_neither_rendering_nor_frame(tmp_path: Path) -> None:
    (tmp_path / "x.dng").write_bytes(b"")
    for pixels, kind in (("srgb", "a rendering in sRGB"), ("rgb", "an RGB frame")):
        with pytest.raises(PredictionError, match=f"expected {kind}, found a DNG"):
            load_colours(tmp_path / "x.dng", RGB_SHAPE, pixels)  # type: ignore[arg-type] # of either


# --- strangers' predictions: each that asks for too much is refused by name -------------------------------------------


MOST_KIB = 32 << 10
"""More than a frame of 25 kB and what libraries allocate once, far less than the 64 MiB that each bomb expands to."""


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What became of each prediction, in a process of its own."""
    folder = tmp_path_factory.mktemp("hostile")
    names = hostile.write_all(folder)
    command = [sys.executable, "-m", "tests.evaluation.hostile_predictions", str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S)
    assert done.returncode == 0, done.stderr[-2000:]  # the last name is the file that it ended with
    found: dict[str, Any] = json.loads(done.stdout)
    assert sorted(found["outcomes"]) == names
    return found


def test_every_one_is_refused_in_one_line(outcomes: dict[str, Any]) -> None:
    assert len(outcomes["outcomes"]) > 70
    for name, outcome in outcomes["outcomes"].items():
        assert outcome.startswith("refused: "), f"{name}: {outcome}"
        assert outcome.isprintable(), name
        assert 25 < len(outcome) < 300, outcome


def test_none_takes_memory_to_speak_of(outcomes: dict[str, Any]) -> None:
    assert outcomes["peak_kib"] - outcomes["before_kib"] < MOST_KIB


def test_no_other_file_is_shown(outcomes: dict[str, Any]) -> None:
    assert hostile.ELSEWHERE not in json.dumps(outcomes)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("shape-of-terabytes.npy", ["(4, 32, 48) (packed) or (64, 96) (mosaic)", "found (4, 1000000, 1000000)"]),
        ("type-of-records.npy", ["not a .npy file of numbers", "write it again"]),
        ("right-shape-and-one-byte-less.npy", ["declares 24576 bytes of values and has 24575", "write it again"]),
        ("named-pipe.npy", ["is a pipe, device or socket, not a file"]),
        ("link-to-a-device.h5", ["is a pipe, device or socket, not a file"]),
        ("folder.tif", ["is a folder, not a file"]),
        ("bomb-after-the-array.npz", ["declares 24576 bytes of values and has 67108864: were bytes inserted?"]),
        ("fill-values-of-gigabytes.h5", ["found (4, 30000, 30000)", "whole frame"]),
        ("right-shape-half-written.h5", ["2 of its 4 chunks were written"]),
        ("external-link.h5", ["expected one array, or one called 'prediction'; found none"]),
        ("external-storage.h5", ["lie in other files"]),
        ("virtual.h5", ["lie in other files"]),
        ("checksum.h5", ["filter returned failure"]),
        ("30000-by-30000.png", ["found (30000, 30000)"]),
        ("30000-by-30000.tif", ["found (30000, 30000)"]),
        ("strips-missing.tif", ["strips or tiles are missing"]),
        ("no-pages.tif", ["holds no image"]),
    ],
)
def test_what_is_wrong_is_said(name: str, words: list[str], outcomes: dict[str, Any]) -> None:
    for word in words:
        assert word in outcomes["outcomes"][name]


# --- what is odd and good ---------------------------------------------------------------------------------------------


def test_what_is_not_pixels_is_passed_over(tmp_path: Path) -> None:
    """Compressed text that libpng would expand, and a gamma and a profile, which change no sample."""
    text = hostile.chunk(b"zTXt", b"Comment\0\0" + zlib.compress(bytes(7 << 20), 9))
    gamma = hostile.chunk(b"gAMA", (45455).to_bytes(4, "big"))
    path = tmp_path / "x.png"
    path.write_bytes(hostile.png(hostile.header(), gamma, *[text] * 50, hostile.PIXELS))
    assert np.array_equal(read_array(path, lambda _: None), hostile.grey())
