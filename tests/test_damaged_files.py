"""A file of each kind, cut short or with bytes changed: it is read, or refused in one line that names it."""

from __future__ import annotations

import random
from collections.abc import Callable
from functools import partial
from pathlib import Path

import h5py
import imagecodecs
import numpy as np
import pytest
import scipy.io
import tifffile
from numpy.typing import NDArray

from capture.plan import Plan
from eldata.base.arrays import read_array
from eldata.download.archives import read_members, unpack_archive
from eldata.errors import EldataError
from eldata.evaluation.predictions import load_prediction
from eldata.manifest.card import load_card
from eldata.manifest.catalogue import shipped_manifest
from eldata.manifest.table import load_records
from eldata.noise import CameraProfile, DarkShading
from eldata.protocols.named import load_protocol
from eldata.raw.dng import write_dng
from eldata.raw.reading import read_raw
from eldata.sources.store import build_store, source_of_dataset
from eldata.sources.store.read import Store
from tests.capture.simulated import hostile_plan
from tests.download.helpers import contents, sevenzipped, zipped
from tests.planted_shading import shading_of
from tests.raw.helpers import BAYER, EXPOSURE, make_sensor
from tests.trees import build_tree

SENSOR = make_sensor(BAYER["RGGB"], 60, 64)
TRIALS = 60


def mosaic() -> NDArray[np.uint16]:
    """A dark frame: black at 512 DN, read noise, a few bright pixels."""
    noisy = 512 + np.random.default_rng(3).normal(0, 20, (60, 64))
    noisy[30, 30] = 15000
    return np.clip(np.rint(noisy), 400, 16383).astype(np.uint16)


def packed() -> NDArray[np.float32]:
    return np.random.default_rng(5).random((4, 30, 32), dtype=np.float32)


def write_h5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file.create_dataset("prediction", data=packed(), chunks=(2, 15, 16), compression="gzip", shuffle=True)


def write_store(path: Path) -> None:
    tree = build_tree(path.parent / "tree")
    source = source_of_dataset("eld-demo", root=tree.root, manifest=tree.csv, cameras=["DemoBeta"], isos=[800])
    build_store(source, path)


def write_protocol(path: Path) -> None:
    path.write_text('base = "eld"\nname = "hallway"\ntitle = "Our hallway"\nlevels = "metadata"\nratios = [50, 100]\n')


def copy_of(original: Path) -> Callable[[Path], object]:
    return lambda path: path.write_bytes(original.read_bytes())


def read_store(path: Path) -> None:
    source = Store(path)
    for held in source.frames:
        source.frame(held.path).whole()


def unpack(path: Path) -> None:
    members = read_members(path)
    unpack_archive(path, members, {member.name: member.name for member in members}, path.parent / "unpacked")


read_prediction = partial(load_prediction, sensor=SENSOR, levels="metadata")

KINDS: dict[str, tuple[Callable[[Path], object], Callable[[Path], object]]] = {
    "plain.dng": (lambda path: write_dng(path, mosaic(), SENSOR, EXPOSURE), read_raw),
    "jpeg.dng": (lambda path: write_dng(path, mosaic(), SENSOR, EXPOSURE, compression="lossless-jpeg"), read_raw),
    "x.npy": (lambda path: np.save(path, packed()), read_prediction),
    "x.npz": (lambda path: np.savez_compressed(path, prediction=packed()), read_prediction),
    "x.h5": (write_h5, read_prediction),
    "plain.tif": (lambda path: tifffile.imwrite(path, packed(), photometric="minisblack"), read_prediction),
    "deflated.tif": (
        lambda path: tifffile.imwrite(path, mosaic(), tile=(32, 32), compression="zlib", photometric="minisblack"),
        read_prediction,
    ),
    "x.png": (lambda path: path.write_bytes(imagecodecs.png_encode(mosaic())), read_prediction),
    "x.mat": (
        lambda path: scipy.io.savemat(path, {"x": packed()}, do_compression=True),
        lambda path: read_array(path, lambda _: None),
    ),
    "manifest.csv": (copy_of(shipped_manifest("eld").path), load_records),
    "card.json": (copy_of(shipped_manifest("eld").path.with_suffix(".json")), load_card),
    "profile.json": (lambda path: CameraProfile.load("SonyA7S2").save(path), CameraProfile.load),
    "protocol.toml": (write_protocol, load_protocol),
    "plan.json": (lambda path: hostile_plan().save(path), Plan.load),
    "shading.npz": (lambda path: shading_of(make_sensor(height=12, width=16), (400,)).save(path), DarkShading.load),
    "store.h5": (write_store, read_store),
    "x.zip": (lambda path: path.write_bytes(zipped(contents(400))), unpack),
    "x.7z": (lambda path: path.write_bytes(sevenzipped(contents(400))), unpack),
}


def damaged(content: bytes, rng: random.Random) -> bytes:
    """Cut short, or with up to three bytes changed, or both; headers, at either end, more often than the rest."""
    data = bytearray(content)
    for _ in range(rng.randint(0, 3)):
        within = min(len(data), rng.choice((200, 2000, len(data))))
        place = rng.choice((rng.randrange(within), -1 - rng.randrange(within)))
        data[place] = rng.choice((data[place] ^ 1 << rng.randrange(8), 0, 255))
    if data == content or rng.random() < 0.3:
        del data[rng.randrange(len(data)) :]
    return bytes(data)


@pytest.mark.parametrize("name", KINDS)
def test_it_is_read_or_refused_by_name(name: str, tmp_path: Path) -> None:
    """60 trials; whatever else a library raises would be a traceback."""
    write, read = KINDS[name]
    path = tmp_path / name
    write(path)
    read(path)
    whole, rng = path.read_bytes(), random.Random(0)  # noqa: S311 # to be repeated
    refusals = []
    for _ in range(TRIALS):
        path.write_bytes(damaged(whole, rng))
        try:
            read(path)
        except EldataError as error:
            refusals.append(str(error))
    assert all(str(path) in refusal and refusal.isprintable() for refusal in refusals), refusals
    assert len(refusals) > TRIALS // 4
