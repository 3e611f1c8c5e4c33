"""What a store holds, as HDF5: names, attributes, version; the records that its readers get.

::

    /                   attributes format, version, written_by, dataset, compression, files, facts_crc32
    /manifest/csv       the manifest's bytes, uint8; its digest is that of the file (not in a store of clean frames)
    /manifest/json      the dataset card's bytes, uint8
    /facts              a line of JSON a frame, in their order, uint8 (:func:`facts_line`)
    /frames/<n>         one file's visible mosaic, (H, W) uint16 in DN, or a 16-bit RGB frame, (3, H, W) uint16: in one
                        piece, which readers map; compressed, in chunks of 256 x 256 with a checksum each

Frames of clips stand in the order of the clip, its reference before them; the manifest is then the list of these files,
patterns expanded.

Mosaics, not packed planes: the one packer cuts, turns, packs and normalises a crop in one pass, which a packed crop
would need two for, and nothing of the visible area is lost. Facts of all frames stand in one place, for HDF5 takes a
millisecond for the attributes of a frame, which is minutes of 100,000.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, astuple, dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, get_args

from eldata.base.fields import TextFile
from eldata.base.files import sha256_of
from eldata.base.numbers import fraction_of
from eldata.errors import ArgumentError, FileError, check_choice
from eldata.manifest.patterns import is_png
from eldata.records import D65, ExactFloat, Exposure, Sensor, exact_fraction, exact_number, from_columns
from eldata.sources.frames import RGB_WHITE

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from fractions import Fraction
    from pathlib import Path

    from eldata.manifest.catalogue import Manifest
    from eldata.records import Role

FORMAT = "eldata-store"
VERSION = 3
CHUNK = 256
SUFFIXES = (".h5", ".hdf5")

Compression = Literal["none", "lz4", "zstd"]
COMPRESSIONS: tuple[Compression, ...] = get_args(Compression)


class StoreError(FileError):
    """A file is not a store, or one that cannot be used."""


@dataclass(frozen=True, slots=True)
class PackedFile:
    """The file that a frame was decoded from: its size, ``sha256:<hex>`` of its bytes, and who decoded it."""

    size_bytes: int
    sha256: str
    decoder: str

    @classmethod
    def of(cls, file: Path) -> PackedFile:
        """Return what is kept of a file; it is read once more."""
        import rawpy

        decoder = "eldata" if is_png(file.name) else f"LibRaw {'.'.join(map(str, rawpy.libraw_version))}"
        return cls(file.stat().st_size, sha256_of(file), decoder)


@dataclass(frozen=True, slots=True)
class StoredFrame:
    """One frame of a store, without its pixels.

    Attributes
    ----------
    key
        Name of its HDF5 dataset.
    path, role
        The file that it comes from, relative to the dataset's folder, and its role there.
    sensor, exposure
        As the file states them: levels, CFA, white balance, matrix; exact fractions. Of RGB (:func:`rgb_sensor`).
    sha256
        Of its pixels, row by row, little-endian.
    file
        What it was decoded from.
    channel_white_levels_dn
        As in :class:`eldata.records.RawFrame`.
    """

    key: str
    path: str
    role: Role
    sensor: Sensor
    exposure: Exposure
    sha256: str
    file: PackedFile
    channel_white_levels_dn: tuple[float, ...] | None = None

    @property
    def shape(self) -> tuple[int, ...]:
        """That of its pixels, (H, W), of RGB (3, H, W)."""
        size = self.sensor.height, self.sensor.width
        return size if self.sensor.cfa else (3, *size)


@dataclass(frozen=True, slots=True)
class Store:
    """A store's content without its pixels.

    Attributes
    ----------
    facts_crc32
        Of what it states of its frames, checksums of their pixels among it: tells it from another store.
    manifest
        ``None`` for a store of clean frames.
    frames
        Mosaics, or the RGB frames of preprocessed clips.
    """

    path: Path
    dataset: str
    compression: Compression
    facts_crc32: int
    manifest: Manifest | None
    frames: tuple[StoredFrame, ...]

    @property
    def digest(self) -> str:
        """``sha256:<hex>`` of what frames it holds: paths, pixels, what their files state; not how they are kept."""
        facts: dict[str, list[Any]] = {frame.path: [frame.role, frame.sha256] for frame in self.frames}
        for frame in self.frames:
            if frame.sensor.cfa:
                stated = sensor_data(frame.sensor), more_of_sensor(frame.sensor), exposure_data(frame.exposure)
                facts[frame.path] += [*stated, frame.channel_white_levels_dn]
        return f"sha256:{hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()}"


def layout(shape: tuple[int, ...], compression: Compression) -> Mapping[str, Any]:
    """Return how h5py lays out a frame, (H, W) or (3, H, W), after making sure that HDF5 knows the compression.

    HDF5's checksums find damage before the compression's filter, which believes what a chunk says of itself, sees it.

    Raises
    ------
    ArgumentError
        If the name is unknown, or hdf5plugin is not installed.
    """
    check_choice("compression", compression, COMPRESSIONS)
    if compression == "none":
        return {}
    try:
        import hdf5plugin  # registers its filters with HDF5 as it is imported
    except ImportError as error:
        raise ArgumentError(
            f"compression {compression!r} needs the package hdf5plugin: pip install 'eldata[compression]'"
        ) from error
    chunks = (1,) * (len(shape) - 2) + tuple(min(CHUNK, side) for side in shape[-2:])
    return {"chunks": chunks, "fletcher32": True, **hdf5plugin.Bitshuffle(cname=compression)}


# --- the facts of frames ------------------------------------------------------------------------------------------


def frame_key(number: int) -> str:
    """Return the name of a frame's HDF5 dataset, by its place in the order in which frames were packed."""
    return f"{number:06d}"


def rgb_sensor(height: int, width: int) -> Sensor:
    """Return what stands for the sensor of an RGB frame, whose CFA is empty."""
    return Sensor("", "", (), (0.0,), RGB_WHITE, height, width)


def facts_line(frame: StoredFrame, known: dict[str, int]) -> bytes:
    """Return what a store states of a frame beside its pixels, as a line of JSON.

    ``[path, role, sha256 of the pixels, [size, sha256, decoder] of the file, sensor, exposure]``: the sensor as the
    file states it, with ``more`` where it states fractions, or a light that is not D65, and ``whites`` of a raw file
    that LibRaw has one a channel of. Where an earlier frame's file states the same, the number of that one stands in
    its place. Of an RGB frame, ``[height, width]`` and null.

    Parameters
    ----------
    frame
        The next frame.
    known
        The numbers of frames by what they state; this one is added.
    """
    line: list[Any] = [frame.path, frame.role, frame.sha256, astuple(frame.file)]
    if not frame.sensor.cfa:
        line += [frame.shape[1:], None]
    else:
        sensor = {"sensor": sensor_data(frame.sensor), "more": more_of_sensor(frame.sensor)}
        for stated in (sensor | {"whites": frame.channel_white_levels_dn}, exposure_data(frame.exposure)):
            number = known.setdefault(json.dumps(stated), int(frame.key))
            line.append(stated if number == int(frame.key) else number)
    return json.dumps(line, separators=(",", ":")).encode() + b"\n"


def frames_in(facts: bytes) -> list[StoredFrame]:
    """Return the frames that lines of :func:`facts_line` state; those that state the same share one record of it.

    Raises
    ------
    ValueError, LookupError, TypeError, ArgumentError
        If they are anything else.
    """
    lines = TextFile("facts", ArgumentError, content=b'{"frames":[%s]}' % b",".join(facts.splitlines())).json()
    sensors: dict[int, tuple[Sensor, tuple[float, ...] | None]] = {}
    exposures: dict[int, Exposure] = {}
    rows = []
    for number, (path, role, sha256, file, sensor, exposure) in enumerate(lines.data["frames"]):
        if not isinstance(path, str):
            raise TypeError(f"path {path!r}")
        if isinstance(sensor, list):
            its_sensor, its_exposure, whites = rgb_sensor(*map(int, sensor)), Exposure(), None
        else:
            of_sensor, of_exposure = sensor, exposure
            if isinstance(sensor, dict):
                of_sensor, whites = number, None if sensor["whites"] is None else tuple(map(float, sensor["whites"]))
                sensors[number] = sensor_of(sensor["sensor"], sensor["more"]), whites
            if isinstance(exposure, dict):
                of_exposure, exposures[number] = number, exposure_of(exposure)
            its_sensor, whites = sensors[of_sensor]
            its_exposure = exposures[of_exposure]
        rows.append((frame_key(number), path, role, its_sensor, its_exposure, sha256, file, whites))
    if not rows:
        return []
    columns: dict[str, Sequence[Any]] = dict(zip(StoredFrame.__slots__, zip(*rows, strict=True), strict=True))
    files = zip(PackedFile.__slots__, zip(*columns["file"], strict=True), strict=True)
    return from_columns(StoredFrame, columns | {"file": from_columns(PackedFile, dict(files))})


# --- what raw files state, as JSON in stores: written in one way, and checked as it is read ----------------

# A sensor is written with levels, white balance and matrix as floats; beside it, where there is any, what such a record
# has no room for.

_EXACT = ("black_level_dn", "white_level_dn", "white_balance", "xyz_to_camera")


def exposure_data(exposure: Exposure) -> dict[str, str | None]:
    """Return an exposure as plain types; fractions as text, so that they stay exact."""
    return {name: None if value is None else str(value) for name, value in asdict(exposure).items()}


def exposure_of(data: Mapping[str, Any]) -> Exposure:
    """Return the exposure that :func:`exposure_data` wrote; ArgumentError or TypeError if it is something else."""
    return Exposure(**{name: exact(text) for name, text in data.items()})


def sensor_data(sensor: Sensor) -> dict[str, Any]:
    """Return a sensor as plain types, without its light; fractions as the nearest floats."""
    return {name: value for name, value in asdict(sensor).items() if name != "matrix_illuminant"}


def more_of_sensor(sensor: Sensor) -> dict[str, Any]:
    """Return what :func:`sensor_data` leaves out: fractions that floats do not hold, as text, and another light."""
    fields = {name: getattr(sensor, name) for name in _EXACT}
    more = {name: _texts(value) for name, value in fields.items() if _has_fractions(value)}
    return more if sensor.matrix_illuminant == D65 else more | {"matrix_illuminant": sensor.matrix_illuminant}


def sensor_of(data: Mapping[str, Any], more: Mapping[str, Any]) -> Sensor:
    """Return the sensor that :func:`sensor_data` and :func:`more_of_sensor` wrote; TypeError if it is something else.

    Raises
    ------
    ArgumentError
        If a fraction is not what its float is nearest to, or the light not a whole number of 16 bits.
    """
    sensor = Sensor(**{name: _tuples(value) for name, value in data.items()})
    fractions = {name: _numbers(value) for name, value in more.items() if name != "matrix_illuminant"}
    for name, value in fractions.items():
        if name not in _EXACT or value != getattr(sensor, name):
            raise ArgumentError(f"{name}: expected fractions beside a float of the sensor, found {more[name]}")
    light = more.get("matrix_illuminant", D65)
    if type(light) is not int or not 0 <= light < 1 << 16:
        raise ArgumentError(f"matrix_illuminant: expected a whole number of 16 bits, found {light!r}")
    return replace(sensor, **fractions, matrix_illuminant=light)


def exact(text: str | None) -> Fraction | None:
    """Return the fraction that a text names, its digits bounded before they are parsed."""
    return None if text is None else fraction_of(text, digits=40)


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


def _has_fractions(value: Any) -> bool:
    return any(map(_has_fractions, value)) if isinstance(value, tuple) else isinstance(value, ExactFloat)


def _texts(value: Any) -> Any:
    return list(map(_texts, value)) if isinstance(value, tuple) else str(exact_fraction(value))


def _numbers(value: Any) -> Any:
    if isinstance(value, list):
        return tuple(map(_numbers, value))
    text = str(value)
    size = fraction_of(text.removeprefix("-"), digits=40)
    return exact_number(-size if text.startswith("-") else size)
