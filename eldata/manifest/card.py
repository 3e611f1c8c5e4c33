"""The dataset card: what a dataset is, where it comes from, what is known to be wrong with it."""

from __future__ import annotations

import json
from dataclasses import MISSING, asdict, dataclass, field, fields
from typing import TYPE_CHECKING, Any

from eldata.base.files import path_problem, write_json
from eldata.errors import ManifestError
from eldata.manifest.subsets import Subset

if TYPE_CHECKING:
    from pathlib import Path


@dataclass(frozen=True, slots=True)
class Download:
    """A place to get the files from.

    Attributes
    ----------
    address, size_bytes, notes
        Web address, its size if known, and what to know about it.
    direct
        Whether the publisher lets a program fetch it; the others are web pages for a person.
    part
        Name of the archive's share of the dataset, if it comes in several.
    paths
        Pattern of the manifest's paths that the archive holds.
    below
        Folder of the dataset to unpack it into if the manifest lists none of its files; ``None``: not known.
    sha256
        ``sha256:<hex>`` of the archive, if published.
    about
        Its size in words, where ``size_bytes`` is not known.
    """

    address: str
    size_bytes: int | None = None
    notes: str = ""
    direct: bool = False
    part: str = ""
    paths: str = "*"
    below: str | None = None
    sha256: str | None = None
    about: str = ""


@dataclass(frozen=True, slots=True)
class CameraCard:
    """How a dataset's camera names itself in EXIF: any of ``models`` (makers sell one body under several names)."""

    models: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Card:
    """A dataset card.

    Attributes
    ----------
    name, title, version
        Short name (that of the manifest's file), full title, version of this manifest.
    folder
        The dataset's folder below the data root; the manifest's paths start there.
    cfa
        ``bayer`` or ``xtrans``.
    cameras
        EXIF identity of each camera in the manifest.
    counts
        Expected number of rows per role.
    subsets
        Named choices of pairs. The first is the one that ``eldata evaluate`` scores if no other is named.
    known_defects, sources
        What is wrong with the published files, and where this card's facts come from.
    """

    name: str
    title: str
    version: str
    folder: str
    citation: str
    licence: str
    homepage: str
    cfa: str
    cameras: dict[str, CameraCard]
    counts: dict[str, int]
    downloads: tuple[Download, ...] = ()
    subsets: tuple[Subset, ...] = ()
    known_defects: tuple[str, ...] = ()
    sources: tuple[str, ...] = field(default=())


_DOWNLOAD_KINDS: dict[str, type] = {
    "size_bytes": int,
    "notes": str,
    "direct": bool,
    "part": str,
    "paths": str,
    "below": str,
    "sha256": str,
    "about": str,
}


def load_card(path: Path) -> Card:
    """Read a dataset card.

    Raises
    ------
    ManifestError
        If the file cannot be read or a field is missing, unknown or of the wrong kind; the message names it.
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ManifestError(f"{path}: cannot be read: {error.strerror}; a manifest needs its dataset card") from error
    except (ValueError, RecursionError) as error:
        raise ManifestError(f"{path}: is not JSON ({error})") from error
    if not isinstance(data, dict):
        raise ManifestError(f"{path}: expected a JSON object, found {type(data).__name__}")
    _check_keys(path, "", data, Card)
    strings = ("name", "title", "version", "folder", "citation", "licence", "homepage", "cfa")
    texts = {key: _typed(path, key, data[key], str) for key in strings}
    if path_problem(texts["folder"]) or "/" in texts["folder"]:
        raise ManifestError(f"{path}, field folder: expected the name of one folder, found {texts['folder']!r}")
    if texts["cfa"] not in ("bayer", "xtrans"):
        raise ManifestError(f"{path}, field cfa: expected bayer or xtrans, found {texts['cfa']!r}")
    cameras = {}
    for name, entry in _typed(path, "cameras", data["cameras"], dict).items():
        _check_keys(path, f"cameras.{name}.", _typed(path, f"cameras.{name}", entry, dict), CameraCard)
        cameras[name] = CameraCard(_texts(path, f"cameras.{name}.models", entry["models"]))
    counts = {
        role: _typed(path, f"counts.{role}", count, int)
        for role, count in _typed(path, "counts", data["counts"], dict).items()
    }
    downloads = []
    for index, entry in enumerate(_typed(path, "downloads", data.get("downloads", []), list)):
        where = f"downloads[{index}]"
        _check_keys(path, f"{where}.", _typed(path, where, entry, dict), Download)
        downloads.append(
            Download(
                _typed(path, f"{where}.address", entry["address"], str),
                **{
                    key: _typed(path, f"{where}.{key}", entry[key], kind)
                    for key, kind in _DOWNLOAD_KINDS.items()
                    if entry.get(key) is not None
                },
            )
        )
    return Card(
        **texts,
        cameras=cameras,
        counts=counts,
        downloads=tuple(downloads),
        subsets=_subsets(path, data.get("subsets", [])),
        known_defects=_texts(path, "known_defects", data.get("known_defects", [])),
        sources=_texts(path, "sources", data.get("sources", [])),
    )


def save_card(path: Path, card: Card) -> None:
    """Write a dataset card as JSON, whole or not at all."""
    write_json(path, asdict(card))


def _subsets(path: Path, value: Any) -> tuple[Subset, ...]:
    subsets: list[Subset] = []
    for index, entry in enumerate(_typed(path, "subsets", value, list)):
        where = f"subsets[{index}]"
        _check_keys(path, f"{where}.", _typed(path, where, entry, dict), Subset)
        name, title, source = (_typed(path, f"{where}.{key}", entry[key], str) for key in ("name", "title", "source"))
        if name in [subset.name for subset in subsets]:
            raise ManifestError(f"{path}, field {where}.name: {name!r} names two subsets")
        subsets.append(
            Subset(
                name,
                title,
                source,
                _typed(path, f"{where}.pairs", entry["pairs"], int),
                _texts(path, f"{where}.splits", entry.get("splits", [])),
                _texts(path, f"{where}.scenes", entry.get("scenes", [])),
                _typed(path, f"{where}.paths", entry.get("paths", "*"), str),
            )
        )
    return tuple(subsets)


def _check_keys(path: Path, prefix: str, data: dict[str, Any], record: type) -> None:
    known = {item.name: item for item in fields(record)}
    for key in data:
        if key not in known:
            raise ManifestError(f"{path}, field {prefix}{key}: is unknown; known are {', '.join(known)}")
    for key, item in known.items():
        if key not in data and item.default is MISSING and item.default_factory is MISSING:
            raise ManifestError(f"{path}, field {prefix}{key}: is missing")


def _typed(path: Path, name: str, value: Any, kind: type) -> Any:
    if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
        raise ManifestError(f"{path}, field {name}: expected {kind.__name__}, found {value!r}")
    return value


def _texts(path: Path, name: str, value: Any) -> tuple[str, ...]:
    return tuple(_typed(path, f"{name}[{i}]", item, str) for i, item in enumerate(_typed(path, name, value, list)))
