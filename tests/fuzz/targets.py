"""What is fuzzed: kinds of input, the readers of each, as a command of ours would call them, and what changes it."""

from __future__ import annotations

import os
import signal
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from eldata.errors import ArgumentError, FileError, ProfileError
from tests.fuzz import bytewise, containers, seeds, tiffs, words

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

    from tests.fuzz.bytewise import Change
    from tests.fuzz.seeds import Seed

    Reader = Callable[[Path], object]


@dataclass(frozen=True)
class Kind:
    """One kind of input.

    Attributes
    ----------
    seeds
        The good files that are changed.
    readers
        What reads a file, by :attr:`Seed.reader`.
    own
        Changes that suit the format, by the file's suffix; the empty one is for every other.
    nameless
        Readers that are handed no path, so that their errors cannot name it, and the file is always a file.
    truth
        What a whole file is read as, where a damaged one must not be read as anything else.
    isolated
        Whether readers work in processes of their own, as in commands: in some damaged stores HDF5 runs for ever. The
        others have to do without.
    """

    seeds: Callable[[], list[Seed]]
    readers: Mapping[str, Reader]
    own: Mapping[str, tuple[Change, ...]]
    nameless: frozenset[str] = frozenset()
    truth: Callable[[object], NDArray[Any]] | None = None
    isolated: bool = False


def called(name: str, path: Path) -> object:
    """Hand a path to ``module:function``, which is imported when it is first used."""
    return resolve_name(name)(path)


# --- raws ---------------------------------------------------------------------------------------------------------


def _read_raw(path: Path) -> object:
    from eldata.raw.reading import read_header, read_raw

    read_header(path)
    return read_raw(path)


def _buffer(path: Path) -> object:
    from eldata.raw import bayer_cfa, read_buffer

    return read_buffer(
        path, seeds.BUFFER, bits=14, packing="le16", cfa=bayer_cfa("RGGB", block=2), black=512, white=16383
    )


def _mosaic(frame: Any) -> NDArray[Any]:
    mosaic: NDArray[Any] = frame.mosaic
    return mosaic


# --- predictions --------------------------------------------------------------------------------------------------


def _prediction(path: Path) -> object:
    from eldata.evaluation.predictions import load_prediction

    return np.array(load_prediction(path, seeds.SENSOR, "metadata"))  # pages of a mapped file are read here


def _colours(path: Path, pixels: Any) -> object:
    from eldata.evaluation.predictions import load_colours

    return np.array(load_colours(path, (3, seeds.SENSOR.height, seeds.SENSOR.width), pixels))


# --- archives, stores, shards ---------------------------------------------------------------------------------------


def _archive(path: Path) -> object:
    from eldata.download.archives import open_archive
    from eldata.download.unpacking import unpack_archive

    archive = open_archive(path)
    return unpack_archive(archive, {member.name: member.name for member in archive.files}, path.parent / "unpacked")


def _store(path: Path) -> object:
    from eldata.sources.store.read import StoreFrames

    source = StoreFrames(path)
    for held in source.store.frames:
        source.frame(held.path).whole()
    return source


def _shard(path: Path) -> object:
    from eldata.sources.shards.reading import verify_shards

    (path.parent / "index.json").write_bytes((seeds.GOOD / "shards" / "index.json").read_bytes())
    problems = verify_shards(str(path.parent))
    if problems:  # listed, as a command lists them
        raise FileError(path, problems[0])
    return problems


# --- text ---------------------------------------------------------------------------------------------------------


def _parameters(path: Path) -> object:
    from eldata.noise.published import profiles_from_published, read_published

    found = read_published(path)
    try:
        return profiles_from_published("SonyA7S2", found)
    except ProfileError as error:  # it is handed no path, and names the camera
        raise FileError(path, str(error)) from error


def _published_table(path: Path) -> object:
    from eldata.evaluation.published.tables import load_published

    (path.parent / "sources.json").write_bytes(seeds.SOURCES)
    return load_published(path.parent)


def _published_sources(path: Path) -> object:
    from eldata.evaluation.published.tables import load_published

    if os.path.lexists(path):
        path.rename(path.with_name("sources.json"))
    (path.parent / "one.csv").write_bytes(seeds.table())
    return load_published(path.parent)


def _progress(path: Path) -> object:
    from capture.checklist_progress import load_progress
    from capture.plan import Plan

    return load_progress(path, Plan.load(seeds.GOOD / "plan.json"))


def _mapping(path: Path) -> object:
    from capture.mapping import load_mapping
    from capture.observed import Observed, ObservedFrame
    from capture.plan import Plan

    plan = Plan.load(seeds.GOOD / "plan.json")
    shots = [shot for _, shot in plan.shots]
    frames = [
        ObservedFrame(Path(f"/card/DSC{number:05d}.dng"), Fraction(shot.iso), shot.setting.nominal_s, None, "Mine 1")
        for number, shot in enumerate(shots, start=1)
    ]
    return load_mapping(path, plan, Observed(tuple(frames), (), by_time=True))


def _scheduler(path: Path) -> object:
    from eldata.base.clusters import _scheduler

    return _scheduler(str(path))


def _seconds(path: Path) -> object:
    from capture.shutter import parse_seconds

    return parse_seconds(path.read_bytes().decode(errors="surrogateescape"))


def _index(path: Path) -> object:
    from eldata.sources.shards.index import parse_index

    return parse_index("index.json", path.read_bytes())


def _facts(path: Path) -> object:
    from eldata.sources.shards.index import parse_facts

    try:
        return parse_facts(path.read_bytes())
    except (ValueError, LookupError, TypeError, ArithmeticError) as error:  # as documented: its caller names the shard
        raise ArgumentError("not a sample's facts") from error


def _store_facts(path: Path) -> object:
    from eldata.sources.store.format import frames_in

    try:
        return frames_in(path.read_bytes())
    except (ValueError, LookupError, TypeError) as error:  # as documented: its caller names the store
        raise ArgumentError("not the facts of frames") from error


# --- the drill ------------------------------------------------------------------------------------------------------


def _drill(path: Path) -> object:
    """Do what the file says: what the tests of this package find in it, readers must never do."""
    word = path.read_text(encoding="utf-8")
    if word == "crash":
        os.kill(os.getpid(), signal.SIGSEGV)
    if word == "exit":
        os._exit(0)
    while word == "hang":
        pass
    if word == "wait":
        signal.pause()
    if word == "memory":
        return np.ones(1 << 27, dtype=np.uint8)
    if word == "too much":
        raise MemoryError
    if word == "exception":
        raise KeyError(word)
    if word == "message":
        raise ArgumentError("expected a number, found something else")
    if word == "two lines":
        raise FileError(path, "one\ntwo")
    if word == "refused":
        raise FileError(path, "expected something else")
    if word == "escaped":
        (path.parent.parent / "outside").touch()
    return np.zeros(3, np.uint16) if word == "silent" else Fraction(1)


# --- all ----------------------------------------------------------------------------------------------------------

DRILL: Final = {
    "crash": "crash",
    "exit": "crash",
    "hang": "hang",
    "wait": "hang",
    "memory": "memory",
    "too much": "memory",
    "exception": "exception",
    "message": "message",
    "two lines": "message",
    "refused": "refused",
    "escaped": "escaped",
    "read": "read",
}
"""What a reader is told to do, and what is to be found of it."""


def _drill_seeds() -> list[Seed]:
    return [seeds.Seed(f"{word}.txt", "drill", word.encode()) for word in DRILL]


_TIFF = (*tiffs.CHANGES, containers.jpeg)
_WHOLE_NPY = (containers.npy, containers.npy)

KINDS: dict[str, Kind] = {
    "raws": Kind(
        seeds.raws,
        {"raw": _read_raw, "buffer": _buffer},
        {
            ".raw": (),
            "": (*_TIFF, *_TIFF, *_TIFF, containers.jpeg_end, tiffs.crowded),
            ".cr3": (containers.boxes, containers.boxes, containers.boxes, *tiffs.CHANGES),
            ".crw": (containers.heap, containers.heap),
            ".raf": (containers.raf, containers.raf, containers.jpeg),
        },
        truth=_mosaic,
    ),
    "texts": Kind(
        seeds.texts,
        {
            "manifest": partial(called, "eldata.manifest.table:load_records"),
            "card": partial(called, "eldata.manifest.card:load_card"),
            "profile": partial(called, "eldata.noise.profile:CameraProfile.load"),
            "parameters": _parameters,
            "protocol": partial(called, "eldata.protocols.named:load_protocol"),
            "result": partial(called, "eldata.evaluation.saved:load_result"),
            "published": _published_table,
            "sources": _published_sources,
            "scenes": partial(called, "manifests.sid_scenes:load_scenes"),
            "camera": partial(called, "capture.camera:CameraDescription.load"),
            "plan": partial(called, "capture.plan:Plan.load"),
            "progress": _progress,
            "mapping": _mapping,
            "scheduler": _scheduler,
            "seconds": _seconds,
            "index": _index,
            "facts": _facts,
            "store": _store_facts,
            **{
                name: partial(called, f"eldata.isp.response_files:{name}")
                for name in ("read_response_table", "read_published_response", "read_dorf", "read_curve_model")
            },
        },
        {"": (*words.CHANGES, *words.CHANGES, words.encoded)},
        nameless=frozenset(("seconds", "index", "facts", "store")),
    ),
    "archives": Kind(
        seeds.archives,
        {"archive": _archive},
        {
            ".zip": (containers.zip_record, containers.zip_record, containers.named),
            "": (containers.sevenzip, containers.sevenzip),
        },
    ),
    "predictions": Kind(
        seeds.predictions,
        {"raw": _prediction, "srgb": partial(_colours, pixels="srgb"), "rgb": partial(_colours, pixels="rgb")},
        {
            ".npy": _WHOLE_NPY,
            ".npz": (containers.zip_record, *_WHOLE_NPY),
            ".h5": (containers.hdf5,),
            ".png": (containers.png, containers.png, containers.png_bomb),
            "": (*tiffs.CHANGES, tiffs.crowded),
        },
    ),
    "stores": Kind(seeds.stores, {"store": _store}, {}),
    "shards": Kind(seeds.shards, {"shard": _shard}, {".tar": (containers.tar_record, containers.npy)}),
    "shadings": Kind(
        seeds.shadings,
        {"shading": partial(called, "eldata.noise:DarkShading.load")},
        {"": (containers.zip_record, containers.npy)},
    ),
    "drill": Kind(_drill_seeds, {"drill": _drill}, {}),
}


def changes_of(kind: Kind, name: str) -> tuple[Change, ...]:
    """What may be done to a file of this name: half of it suits the format, half knows nothing of it."""
    own = kind.own.get(Path(name).suffix.lower(), kind.own.get("", ()))
    return (*bytewise.CHANGES, *own * max(1, len(bytewise.CHANGES) // max(1, len(own))))
