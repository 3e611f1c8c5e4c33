"""The good files that are changed: small ones of every format, made by the package itself and by others."""

from __future__ import annotations

import io
import json
import struct
import tempfile
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.raw.files import RAW_EXTENSIONS
from eldata.records import Exposure, PairRecord, Sensor
from eldata.sources.store.format import PackedFile, StoredFrame, facts_line
from tests.raw.helpers import (
    BAYER,
    EXPOSURE,
    NONA,
    QUAD,
    active_area,
    black_levels,
    letters,
    make_sensor,
    write_plain_dng,
    xtrans_at,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

TESTS = Path(__file__).parents[1]
GOOD = Path(__file__).parent / "good"

SENSOR = make_sensor(BAYER["RGGB"], 60, 64)
"""Of the reference that predictions belong to."""

BUFFER = (60, 64)
"""Rows and columns of the sensor's buffer without a header."""


@dataclass(frozen=True)
class Seed:
    """A good file.

    Attributes
    ----------
    name
        Its name; the suffix says the format.
    reader
        Which of its kind's readers reads it.
    content
        Its bytes.
    pixels
        Where its pixels' data stand, first byte and the one after the last, if a page of zeros in them can be told from
        an image: they are compressed, or none may lie far below the black level.
    """

    name: str
    reader: str
    content: bytes
    pixels: tuple[int, int] | None = None


def _made(make: Callable[[Path], object], name: str) -> bytes:
    with tempfile.TemporaryDirectory(prefix="eldata-fuzz-") as folder:
        path = Path(folder) / name
        make(path)
        return path.read_bytes()


# --- raws ---------------------------------------------------------------------------------------------------------


def _scene(height: int, width: int, seed: int, sigma: float = 12.0) -> NDArray[np.uint16]:
    """A dark frame with a gradient: black at 512 DN, read noise, a few bright pixels."""
    generator = np.random.default_rng(seed)
    rows = np.linspace(0, 300, height)[:, None]
    noisy = 512 + rows + generator.normal(0, sigma + np.sqrt(rows), (height, width))
    noisy[generator.integers(height), generator.integers(width)] = 15000
    return np.clip(np.rint(noisy), 400, 16383).astype(np.uint16)


def _pixels(content: bytes) -> tuple[int, int]:
    import tifffile

    with tifffile.TiffFile(io.BytesIO(content)) as tiff:
        page = tiff.pages.first
        return page.dataoffsets[0], page.dataoffsets[-1] + page.databytecounts[-1]


def raws() -> list[Seed]:
    """DNG files of both writers, tiny files of other containers, and every raw file among the tests' fixtures."""
    from eldata.raw.dng import write_dng

    found = []
    for number, (cfa, compression, size) in enumerate(
        (
            (BAYER["RGGB"], "none", (60, 64)),
            (BAYER["GBRG"], "none", (90, 96)),
            (BAYER["BGGR"], "lossless-jpeg", (96, 120)),
            (BAYER["GRBG"], "lossless-jpeg", (140, 132)),
            (xtrans_at(1, 2), "none", (60, 66)),
            (xtrans_at(0, 0), "lossless-jpeg", (120, 132)),
            (QUAD["quad-31"], "lossless-jpeg", (96, 104)),
            (NONA["nona-14"], "none", (66, 72)),
        )
    ):

        def make(
            path: Path, cfa: Any = cfa, compression: Any = compression, size: Any = size, seed: int = number
        ) -> None:
            mosaic = _scene(size[0], size[1], seed, 12.0 if seed % 2 else 120.0)
            write_dng(path, mosaic, make_sensor(cfa, *size), EXPOSURE, compression=compression)

        content = _made(make, "a.dng")
        found.append(Seed(f"{compression}-{len(cfa)}-{number}.dng", "raw", content, _pixels(content)))
    black = black_levels(((500, 501), (502, 503)))
    plain: dict[str, tuple[tuple[Any, ...], dict[str, Any]]] = {
        "strips": (black, {"rowsperstrip": 16}),
        "tiles": (black, {"tile": (32, 32)}),
        "big-endian": (black, {"byteorder": ">"}),
        "area": ((active_area(1, 3, 57, 61), *black), {}),
        "no-black": ((), {}),
        "floats": (black, {"kind": np.float32, "compression": "adobe_deflate", "predictor": 3, "tile": (32, 32)}),
        "no-exif-xtrans": ((), {"pattern": letters(xtrans_at(0, 0))}),
    }
    for name, (tags, options) in plain.items():

        def write(path: Path, tags: Any = tags, options: Any = options) -> None:
            options = dict(options)
            scene = _scene(64, 64, 9).astype(options.pop("kind", np.uint16))
            write_plain_dng(path, scene, options.pop("pattern", ("RG", "GB")), *tags, **options)

        content = _made(write, "a.dng")
        found.append(Seed(f"{name}.dng", "raw", content, _pixels(content) if tags else None))
    found += [
        Seed("made.cr3", "raw", _canon_boxes()),
        Seed("made.crw", "raw", _canon_heap()),
        Seed("made.raf", "raw", _fuji_file(found[4].content)),
        Seed("made-16.raw", "buffer", _scene(*BUFFER, 3).astype("<u2").tobytes()),
    ]
    fixtures = sorted(
        path for path in TESTS.rglob("*") if path.suffix.lower() in RAW_EXTENSIONS and path.stat().st_size < 120_000
    )
    return [*found, *(Seed("-".join(path.relative_to(TESTS).parts), "raw", path.read_bytes()) for path in fixtures)]


def _directory(entries: list[tuple[int, int, int, bytes]]) -> bytes:
    """A little-endian TIFF with one directory."""
    table, values, at = struct.pack("<H", len(entries)), b"", 8 + 2 + 12 * len(entries) + 4
    for tag, kind, count, value in entries:
        inline = value.ljust(4, b"\0") if len(value) <= 4 else struct.pack("<I", at + len(values))
        table += struct.pack("<HHI", tag, kind, count) + inline
        values += b"" if len(value) <= 4 else value
    return b"II*\0\x08\0\0\0" + table + bytes(4) + values


def _box(name: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content) + 8) + name + content


def _canon_boxes() -> bytes:
    """The boxes of a CR3 that hold its metadata, without an image."""
    first = _directory([(271, 2, 6, b"Canon\0"), (272, 2, 13, b"Canon EOS R6\0")])
    second = _directory(
        [
            (33434, 5, 1, struct.pack("<II", 1, 4)),
            (33437, 5, 1, struct.pack("<II", 28, 10)),
            (34855, 3, 1, struct.pack("<H", 100)),
            (36867, 2, 20, b"2026:01:02 03:04:05\0"),
        ]
    )
    canon = bytes.fromhex("85c0b687820f11e08111f4ce462b6a48")
    blocks = _box(b"CNCV", b"CanonCR3_001/01.09.00/00.00.00") + _box(b"CMT1", first) + _box(b"CMT2", second)
    sample = _box(b"stsd", bytes(4) + struct.pack(">I", 1) + _box(b"CRAW", bytes(82) + _box(b"CMP1", bytes(52))))
    table = _box(b"stbl", sample + _box(b"stsz", bytes(12)) + _box(b"co64", bytes(16)))
    track = _box(b"trak", _box(b"mdia", _box(b"minf", table)))
    moov = _box(b"moov", _box(b"uuid", canon + blocks) + track)
    return _box(b"ftyp", b"crx \0\0\0\1crx isom") + moov + _box(b"mdat", bytes(64))


def _canon_heap() -> bytes:
    """A CRW: a heap with make and model, exposure and sizes, without an image."""
    values = [(0x080A, b"Canon\0Canon EOS 300D DIGITAL\0"), (0x1810, struct.pack("<7I", 64, 48, 0, 0, 0, 8, 1))]
    values += [(0x102A, struct.pack("<16H", *range(16))), (0x180E, struct.pack("<3I", 1100000000, 0, 0))]
    body, records = b"", struct.pack("<H", len(values))
    for code, value in values:
        records += struct.pack("<HII", code, len(value), len(body))
        body += value
    inner = body + records + struct.pack("<I", len(body))
    outer = inner + struct.pack("<HHII", 1, 0x300A, len(inner), 0) + struct.pack("<I", len(inner))
    return b"II" + struct.pack("<I", 26) + b"HEAPCCDR" + bytes(12) + outer


def _fuji_file(tiff: bytes) -> bytes:
    """A RAF: its header, a JPEG that is only EXIF, a directory of its own, and pixels."""
    exif = b"\xff\xd8\xff\xe1" + struct.pack(">H", len(tiff[:2000]) + 8) + b"Exif\0\0" + tiff[:2000] + b"\xff\xd9"
    records = (
        (0x0100, struct.pack(">HH", 60, 66)),
        (0x0110, struct.pack(">HH", 0, 0)),
        (0x0111, struct.pack(">HH", 60, 66)),
    )
    own = struct.pack(">I", len(records)) + b"".join(struct.pack(">HH", tag, len(v)) + v for tag, v in records)
    head = b"FUJIFILMCCD-RAW 0201FF129502" + b"X-T1".ljust(32, b"\0") + b"0100" + bytes(20)
    at = len(head) + 36
    parts = (exif, own, tiff)
    places = b""
    for part in parts:
        places += struct.pack(">II", at, len(part))
        at += len(part)
    return head + places + bytes(12) + b"".join(parts)


# --- text ---------------------------------------------------------------------------------------------------------

SOURCES = json.dumps(
    {
        "one": {
            "label": "x",
            "citation": "x",
            "url": "x",
            "commit": None,
            "tables": {"1": "x"},
            "known": [],
            "unknown": [],
        }
    }
).encode()


def table() -> bytes:
    """A table of published numbers, whose source is that of :data:`SOURCES`."""
    from eldata.evaluation.published.tables import COLUMNS

    row = dict.fromkeys(COLUMNS, "x") | {"source": "one", "table": "1", "psnr_db": "40.5"}
    row |= {"ratio": "", "pairs": "", "ssim": "0.95", "st_rred": ""}
    return f"{','.join(COLUMNS)}\n{','.join(row.values())}\n".encode()


def _facts() -> str:
    from eldata.sources.shards.index import Facts, Side, facts_text

    sensor = Sensor("make", "model", ((0, 1), (3, 2)), (0.0,) * 4, 16383.0, 4, 4)
    side = Side(sensor, Exposure(Fraction(100), Fraction(1, 30), None))
    record = PairRecord("a", "b", "c", "", "", Fraction(100), Fraction(1), Fraction(100), ())
    return facts_text(Facts(record, Fraction(100), 0, 0, side, side))


def _results() -> dict[str, Any]:
    """A result of images, several of them in one file, and one of clips."""
    from eldata.evaluation.evaluate import evaluate
    from tests.drv_tree import small_drv
    from tests.reports.evaluations import result_data

    image = result_data(cameras=("SonyA7S2",), scenes=1)
    with tempfile.TemporaryDirectory(prefix="eldata-fuzz-") as folder:
        drv = small_drv(Path(folder), ("0007",), 12)
        clip = evaluate(None, manifest=drv.csv, root=drv.root, ids=["0007"], baseline="input")
    return {"images": image, "several": {"results": [image]}, "clips": clip.as_dict()}


def texts() -> list[Seed]:
    """A small file of every text format that a command reads."""
    from capture.camera import EXAMPLE
    from eldata.manifest.catalogue import shipped_manifest
    from eldata.noise.profile import CameraProfile
    from manifests.sid_scenes import SHORT_EXPOSURES

    profile = {"schema": 1} | CameraProfile.load("SonyA7S2").as_dict()
    fit = {"slope": 0.5, "bias": -1.0, "sigma": 0.25}
    parameters = {
        "Kmin": 0.25,
        "Kmax": 16.0,
        "G_shape": [0.1, 0.0, -0.2],
        "color_bias": [[0.0, 1.0, 2.0, 3.0]] * 3,
        "Profile-1": {"G_scale": fit, "g_scale": fit, "R_scale": fit},
    }
    sensor = Sensor("make", "model", ((0, 1), (3, 2)), (0.0,) * 4, 16383.0, 4, 4)
    exposure, file = Exposure(Fraction(100), Fraction(1, 30)), PackedFile(1, "x", "x")
    known: dict[str, int] = {}
    frames = [StoredFrame(f"{number:06d}", "a", "bias", sensor, exposure, "x", file) for number in range(2)]
    curve = b"# a curve\n0 0\n0.25 0.5\n0.5 0.7\n1 1\n"
    grid = " ".join(f"{value:g}" for value in np.linspace(0, 1, 16))
    dorf = f"one\nkind\nI =\n{grid}\nB =\n{grid}\n" * 2
    bump = " ".join(f"{value:g}" for value in np.sin(np.linspace(0, np.pi, 16)).round(3))
    model = "".join(f"{label}=\n{of}\n" for label, of in (("E", grid), ("f0", grid), ("h(1)", bump), ("h(2)", bump)))
    scenes = f"scene,iso,long,{','.join(SHORT_EXPOSURES)}\n00001,100,10s,1,1,1\n00002,200,30s,1,1,1\n"
    found = {
        "protocol.toml": ("protocol", (GOOD / "protocol.toml").read_bytes()),
        "profile.json": ("profile", json.dumps(profile).encode()),
        "parameters.json": ("parameters", json.dumps(parameters).encode()),
        "eld.json": ("card", (shipped_manifest("eld").path.with_suffix(".json")).read_bytes()),
        "mine.json": ("card", (GOOD / "mine.json").read_bytes()),
        "mine.csv": ("manifest", (GOOD / "mine.csv").read_bytes()),
        "table.csv": ("published", table()),
        "sources.json": ("sources", SOURCES),
        "curve.txt": ("read_response_table", curve),
        "rgb.txt": ("read_published_response", "\n".join([grid] * 3).encode()),
        "dorf.txt": ("read_dorf", dorf.encode()),
        "emor.txt": ("read_curve_model", model.encode()),
        "scenes.csv": ("scenes", scenes.encode()),
        "camera.json": ("camera", _made(EXAMPLE.save, "camera.json")),
        "plan.json": ("plan", (GOOD / "plan.json").read_bytes()),
        "calibration-plan.json": ("plan", (GOOD / "calibration-plan.json").read_bytes()),
        "progress.json": ("progress", (GOOD / "progress.json").read_bytes()),
        "mapping.json": ("mapping", (GOOD / "mapping.json").read_bytes()),
        "scheduler.json": (
            "scheduler",
            b'{"type": "Scheduler", "id": "x", "address": "tcp://host:8786", "workers": {}}',
        ),
        "seconds.txt": ("seconds", b"1/60"),
        "index.json": ("index", (GOOD / "shards" / "index.json").read_bytes()),
        "facts.json": ("facts", _facts().encode()),
        "facts.jsonl": ("store", b"".join(facts_line(frame, known) for frame in frames)),
    }
    found |= {f"result-{name}.json": ("result", json.dumps(data).encode()) for name, data in _results().items()}
    return [Seed(name, reader, content) for name, (reader, content) in found.items()]


# --- archives -------------------------------------------------------------------------------------------------------


def archives() -> list[Seed]:
    """Zip, in each of its compressions, and 7z."""
    import zipfile

    from tests.download.helpers import contents, sevenzipped, zipped

    files = {name: content * 2 for name, content in contents(400).items()}
    methods = {"stored": 0, "deflated": 8, "bzip2": 12, "lzma": 14}
    found = {f"{name}.zip": zipped(files, method) for name, method in methods.items()}
    found["one.7z"] = sevenzipped(files)
    wide = io.BytesIO()
    with zipfile.ZipFile(wide, "w") as archive, archive.open(next(iter(files)), "w", force_zip64=True) as member:
        member.write(b"x" * 500)
    found["zip64.zip"] = wide.getvalue()
    return [Seed(name, "archive", content) for name, content in found.items()]


# --- predictions ----------------------------------------------------------------------------------------------------


def predictions() -> list[Seed]:
    """Every format of predictions, of raws and of renderings."""
    import h5py
    import imagecodecs
    import tifffile

    from eldata.raw.dng import write_dng

    generator = np.random.default_rng(5)
    packed = generator.random((4, 30, 32), dtype=np.float32)
    mosaic = generator.integers(0, 65536, (60, 64), dtype=np.uint16)
    colours = generator.random((3, 60, 64), dtype=np.float32)
    eight = generator.integers(0, 256, (60, 64, 3), dtype=np.uint8)
    sixteen = generator.integers(0, 65536, (60, 64, 3), dtype=np.uint16)

    def saved(array: NDArray[Any]) -> bytes:
        return _made(lambda path: np.save(path, array), "a.npy")

    def h5(name: str, array: NDArray[Any], **options: Any) -> bytes:
        def make(path: Path) -> None:
            with h5py.File(path, "w") as file:
                file.create_dataset(name, data=array, **options)

        return _made(make, "a.h5")

    dark = _scene(60, 64, 3)
    found = {
        ("packed.npy", "raw"): saved(packed),
        ("mosaic.npy", "raw"): saved(mosaic),
        ("wide.npy", "raw"): saved(packed.astype(np.float64)),
        ("columns.npy", "raw"): saved(np.asfortranarray(packed.astype(np.float16))),
        ("one.npz", "raw"): _made(lambda path: np.savez(path, packed), "a.npz"),
        ("packed.npz", "raw"): _made(lambda path: np.savez_compressed(path, prediction=mosaic, other=eight), "a.npz"),
        ("plain.h5", "raw"): h5("prediction", packed),
        ("gzip.h5", "raw"): h5("anything", mosaic, chunks=(30, 32), compression="gzip"),
        ("packed.tif", "raw"): _made(lambda path: tifffile.imwrite(path, packed, photometric="minisblack"), "a.tif"),
        ("deflated.tiff", "raw"): _made(
            lambda path: tifffile.imwrite(path, mosaic, photometric="minisblack", compression="deflate", tile=(32, 32)),
            "a.tiff",
        ),
        ("grey.png", "raw"): bytes(imagecodecs.png_encode(mosaic)),
        ("raw.dng", "raw"): _made(
            lambda path: write_dng(path, dark, SENSOR, EXPOSURE, compression="lossless-jpeg"), "a.dng"
        ),
        ("colours.npy", "srgb"): saved(colours),
        ("eight.png", "srgb"): bytes(imagecodecs.png_encode(eight)),
        ("eight.tif", "srgb"): _made(
            lambda path: tifffile.imwrite(path, eight, photometric="rgb", compression="lzw"), "a.tif"
        ),
        ("sixteen.png", "rgb"): bytes(imagecodecs.png_encode(sixteen)),
    }
    return [Seed(name, reader, content) for (name, reader), content in found.items()]


# --- stores, shards --------------------------------------------------------------------------------------------------


def stores() -> list[Seed]:
    """Training stores with every compression."""
    from eldata.sources.store import build_store, source_of_dataset
    from eldata.sources.store.format import COMPRESSIONS
    from tests.trees import build_tree

    with tempfile.TemporaryDirectory(prefix="eldata-fuzz-") as folder:
        tree = build_tree(Path(folder))
        source = source_of_dataset("eld-demo", root=tree.root, manifest=tree.csv, cameras=["DemoBeta"], isos=[800])
        found = []
        for compression in COMPRESSIONS:
            path = Path(folder) / f"{compression}.h5"
            build_store(source, path, compression=compression)
            found.append(Seed(path.name, "store", path.read_bytes()))
    return found


def shards() -> list[Seed]:
    """A shard; its index stays as it was written."""
    return [Seed("shard-000000.tar", "shard", (GOOD / "shards" / "shard-000000.tar").read_bytes())]


def shadings() -> list[Seed]:
    """The files of a dark shading of two gain modes: by itself, and of a named model."""
    from eldata.noise import DarkShading, ShadingIso

    generator = np.random.default_rng(6)
    levels: dict[str, Any] = {"level_error_dn": (1.5, 0.0, -0.5, 2.0), "standard_error_dn": (0.1,) * 4}
    slope, offset = generator.normal(0, 1, (2, 2, 12, 16)).astype(np.float32)
    shading = DarkShading(
        camera="Demo",
        source="a test",
        cfa=((1, 0), (2, 3)),
        isos=tuple(ShadingIso(iso=400 * 4**mode, mode=mode, frames=9, sigma_dn=2.5, **levels) for mode in range(2)),
        slope_dn=slope,
        offset_dn=offset,
        hot=generator.random((12, 16)) < 0.1,
    )
    files = {
        "shading.npz": shading,
        "shading-model.npz": replace(shading, model="Maker 1"),
    }
    return [Seed(name, "shading", _made(one.save, "a.npz")) for name, one in files.items()]
