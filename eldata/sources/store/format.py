"""What a store holds, as HDF5: names, attributes, version; the records that its readers get.

::

    /                   attributes format, version, written_by, dataset, compression, files_digest, complete
    /manifest/csv       the manifest's bytes, uint8; its digest is that of the file (not in a store of clean frames)
    /manifest/json      the dataset card's bytes, uint8
    /table              what the attributes of all frames say once more (table.py); not in stores of RGB frames
    /frames/<n>         one file's visible mosaic, (H, W) uint16 in DN, in chunks of 256 x 256
                        attributes path, role, sha256 (of the pixels), sensor and exposure (JSON), and sensor_more
                        (JSON) where the sensor states fractions, or a light that is not D65
                        or a 16-bit RGB frame, (3, H, W) uint16, in chunks of 1 x 256 x 256
                        attributes path, role, sha256, kind = "rgb"
                        Of either kind: file (JSON), the packed file's size and digest and the LibRaw that decoded it;
                        and channel_white_levels_dn (JSON) of a raw file that LibRaw has one of

Frames of clips stand in the order of the clip, its reference before them; the manifest is then the list of these files,
patterns expanded.

Mosaics, not packed planes: the one packer cuts, turns, packs and normalises a crop in one pass, which a packed crop
would need two for, and nothing of the visible area is lost.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Literal, get_args

from eldata.base.files import sha256_of
from eldata.errors import ArgumentError, FileError, check_choice
from eldata.manifest.patterns import is_png
from eldata.sources.file_facts import exposure_data, exposure_of, more_of_sensor, parsed, sensor_data, sensor_of

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from eldata.manifest.catalogue import Manifest
    from eldata.records import Exposure, RawFrame, Role, Sensor

FORMAT = "eldata-store"
VERSION = 2
RGB = "rgb"
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

    @classmethod
    def stated(cls, attributes: Mapping[str, Any]) -> PackedFile:
        """Return what a frame's attributes say."""
        return cls(**parsed("attribute file", attributes["file"]))


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
        As the file states them: levels, CFA, white balance, matrix; exact fractions.
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
        """That of its pixels, (H, W)."""
        return self.sensor.height, self.sensor.width


@dataclass(frozen=True, slots=True)
class StoredRgb:
    """An RGB frame of a store, without its pixels; the fields are as in :class:`StoredFrame`."""

    key: str
    path: str
    role: Role
    height: int
    width: int
    sha256: str
    file: PackedFile

    @property
    def shape(self) -> tuple[int, ...]:
        """That of its pixels, (3, H, W)."""
        return 3, self.height, self.width


@dataclass(frozen=True, slots=True)
class Store:
    """A store's content without its pixels.

    Attributes
    ----------
    manifest
        ``None`` for a store of clean frames.
    frames
        The mosaics.
    rgb
        The RGB frames, of preprocessed clips.
    """

    path: Path
    dataset: str
    compression: Compression
    manifest: Manifest | None
    frames: tuple[StoredFrame, ...]
    rgb: tuple[StoredRgb, ...] = ()

    @property
    def every(self) -> tuple[StoredFrame | StoredRgb, ...]:
        """All frames, the mosaics first."""
        return *self.frames, *self.rgb

    @property
    def digest(self) -> str:
        """``sha256:<hex>`` of what frames it holds: paths, pixels, what their files state; not how they are kept."""
        facts = {frame.path: [frame.role, frame.sha256] for frame in self.rgb} | {
            frame.path: [
                frame.role,
                frame.sha256,
                sensor_data(frame.sensor),
                more_of_sensor(frame.sensor),
                exposure_data(frame.exposure),
                frame.channel_white_levels_dn,
            ]
            for frame in self.frames
        }
        return f"sha256:{hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()}"


def chunk_shape(shape: tuple[int, ...]) -> tuple[int, ...]:
    """Return the chunks of a frame, (H, W) or (3, H, W)."""
    return (1,) * (len(shape) - 2) + tuple(min(CHUNK, side) for side in shape[-2:])


def filters(compression: Compression) -> Mapping[str, Any]:
    """Return h5py's keywords of a compression, after making sure that HDF5 knows it.

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
    return dict(hdf5plugin.Bitshuffle(cname=compression))


def frame_attributes(path: str, role: Role, frame: RawFrame, sha256: str, file: PackedFile) -> dict[str, str]:
    """Return the attributes of a frame's HDF5 dataset."""
    more = more_of_sensor(frame.sensor)
    whites = frame.channel_white_levels_dn
    return {
        "path": path,
        "role": role,
        "sha256": sha256,
        "sensor": json.dumps(sensor_data(frame.sensor)),
        **({"sensor_more": json.dumps(more)} if more else {}),
        "exposure": json.dumps(exposure_data(frame.exposure)),
        "file": json.dumps(asdict(file)),
        **({} if whites is None else {"channel_white_levels_dn": json.dumps({"values": whites})}),
    }


def rgb_attributes(path: str, role: Role, sha256: str, file: PackedFile) -> dict[str, str]:
    """Return the attributes of an RGB frame's HDF5 dataset."""
    return {"path": path, "role": role, "sha256": sha256, "kind": RGB, "file": json.dumps(asdict(file))}


def stored(key: str, attributes: Mapping[str, Any], shape: tuple[int, ...]) -> StoredFrame | StoredRgb:
    """Return a frame from the attributes and the shape of its HDF5 dataset.

    Raises
    ------
    ValueError, LookupError, TypeError
        If they are not what :func:`frame_attributes` or :func:`rgb_attributes` makes.
    """
    path, role, sha256 = str(attributes["path"]), attributes["role"], str(attributes["sha256"])
    if attributes.get("kind") == RGB:
        planes, height, width = shape
        if planes != 3:
            raise ValueError(f"an RGB frame of {planes} planes")
        return StoredRgb(key, path, role, int(height), int(width), sha256, PackedFile.stated(attributes))
    sensor = sensor_in(attributes["sensor"], attributes.get("sensor_more"))
    exposure = exposure_in(attributes["exposure"])
    whites = white_levels_in(attributes.get("channel_white_levels_dn"))
    return StoredFrame(key, path, role, sensor, exposure, sha256, PackedFile.stated(attributes), whites)


def sensor_in(text: str, more: str | None) -> Sensor:
    """Return the sensor that the attributes ``sensor`` and ``sensor_more`` state; raises like :func:`stored`."""
    stated_more = {} if more is None else parsed("attribute sensor_more", more)
    return sensor_of(parsed("attribute sensor", text), stated_more)


def exposure_in(text: str) -> Exposure:
    """Return the exposure that the attribute ``exposure`` states; raises like :func:`stored`."""
    return exposure_of(parsed("attribute exposure", text))


def white_levels_in(text: str | None) -> tuple[float, ...] | None:
    """Return what the attribute ``channel_white_levels_dn`` states, if it is there; raises like :func:`stored`."""
    if text is None:
        return None
    return tuple(map(float, parsed("attribute channel_white_levels_dn", text)["values"]))
