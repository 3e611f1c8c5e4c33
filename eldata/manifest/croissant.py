"""A set's card and manifest as Croissant, the vocabulary in which data sets are described for machine learning.

Version 1.1 (http://mlcommons.org/croissant/1.1), with those fields of its vocabulary for responsible AI (RAI) for which
the card has facts. What the card does not know is said to be unknown, never made up: Croissant asks for the hash of
each file that is linked, so archives whose publisher states none are named in the text, not linked.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import fields
from operator import attrgetter
from pathlib import PurePosixPath
from typing import TYPE_CHECKING, Any

from eldata.manifest.card import Card, stated
from eldata.manifest.table import number_text
from eldata.records import FrameRecord

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from eldata.manifest.card import Download
    from eldata.manifest.catalogue import Manifest

CROISSANT = "http://mlcommons.org/croissant/1.1"
RESPONSIBLE_AI = "http://mlcommons.org/croissant/RAI/1.0"

# As the specification's section "Context" has it.
_CONTEXT: dict[str, Any] = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "cr": "http://mlcommons.org/croissant/",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "dct": "http://purl.org/dc/terms/",
    "sc": "https://schema.org/",
    "conformsTo": "dct:conformsTo",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "description": {"@container": "@language"},
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "name": {"@container": "@language"},
} | {
    name: f"cr:{name}"
    for name in (
        *("arrayShape", "citeAs", "column", "containedIn", "equivalentProperty", "extract", "field", "fileProperty"),
        *("fileObject", "fileSet", "format", "includes", "isArray", "isLiveDataset", "jsonPath", "key", "md5"),
        *("parentField", "path", "recordSet", "references", "regex", "repeated", "replace", "samplingRate"),
        *("separator", "source", "subField", "transform"),
    )
}

_FORMATS = {
    ".arw": "image/x-sony-arw",
    ".cr2": "image/x-canon-cr2",
    ".dng": "image/x-adobe-dng",
    ".nef": "image/x-nikon-nef",
    ".png": "image/png",
    ".raf": "image/x-fuji-raf",
    ".tif": "image/tiff",
    ".tiff": "image/tiff",
}

_COLUMNS = {
    "path": "path below the set's folder",
    "role": "reference (a clean long exposure), noisy, bias or flat",
    "camera": "camera, as the set names it",
    "scene": "scene",
    "split": "train, val, test, or what the set has",
    "iso": "ISO",
    "exposure_s": "exposure time in seconds, exactly: a decimal number or a fraction such as 1/30",
    "ratio": "nominal exposure ratio (ISO times time) of the reference to the noisy frame",
    "reference": "path of a noisy frame's reference; empty in other rows",
    "width": "width in pixels",
    "height": "height in pixels",
    "size_bytes": "size of the file in bytes",
    "sha256": "sha256:<hex> of the file",
    "flags": "remarks, separated by semicolons",
}
_WHOLE = {"width", "height", "size_bytes"}
_NUMBERS = {"iso", "exposure_s", "ratio"}
_OF_PAIRS = ("path", "reference", "camera", "scene", "split", "iso", "exposure_s", "ratio", "flags")


def to_croissant(described: Manifest | Card) -> dict[str, Any]:
    """Return a set as Croissant 1.1, plain types for a JSON-LD file.

    Parameters
    ----------
    described
        A manifest: its CSV file is then the distribution that both record sets, ``frames`` and ``pairs``, read; it has
        to lie beside the JSON-LD file, under its own name. Or a card alone, which has neither.

    Returns
    -------
    dict
        ``license`` is the card's text (an address, if it is an SPDX name), or says that none is stated.

    Examples
    --------
    >>> from eldata.manifest import shipped_manifest, to_croissant
    >>> described = to_croissant(shipped_manifest("eld"))
    >>> described["conformsTo"][0], [one["@id"] for one in described["recordSet"]]
    ('http://mlcommons.org/croissant/1.1', ['frames', 'pairs'])
    """
    card = described if isinstance(described, Card) else described.card
    found: dict[str, Any] = {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": [CROISSANT, RESPONSIBLE_AI],
        "name": card.name,
        "description": " ".join(sentences(_described(card, described))),
        "version": card.version,
        "license": licence_of(card),
        "keywords": ["raw images", "denoising", "low light"],
    }
    if stated(card.citation):
        found["citeAs"] = card.citation
    if card.homepage.startswith(("http://", "https://")):
        found["url"] = card.homepage
    if not isinstance(described, Card):
        found |= {"distribution": _distribution(described), "recordSet": _record_sets(described)}
    return found | _responsible(card)


def licence_of(card: Card) -> str:
    """Return a set's licence: of an SPDX name its address, else the card's text, or that none is stated."""
    if card.spdx and not card.spdx.startswith("LicenseRef-"):
        return f"https://spdx.org/licenses/{card.spdx}"
    return stated(card.licence) or "unknown: no licence is stated"


def _described(card: Card, described: Manifest | Card) -> Iterable[str]:
    yield card.title
    yield card.contents
    if card.cameras:
        yield f"Cameras: {', '.join(card.cameras)}"
    if isinstance(described, Card):
        yield "No public text lists its files"
    else:
        counts = Counter(str(record.role) for record in described.records)
        yield f"The manifest lists {', '.join(f'{count} {role}' for role, count in sorted(counts.items()))} frames"
    for download in card.downloads:
        if download.sha256 is None:
            yield f"Available at {place_text(download)}"


def place_text(download: Download) -> str:
    """Return an archive's address, and what is known of it."""
    size = download.about or (f"{download.size_bytes} bytes" if download.size_bytes is not None else "")
    facts = "; ".join(filter(None, (download.part and f"part {download.part}", size, download.notes)))
    return f"{download.address} ({facts})" if facts else download.address


def sentences(texts: Iterable[str]) -> Iterable[str]:
    """Yield texts that are not empty as sentences."""
    return (text if text.endswith((".", "!", "?")) else f"{text}." for text in texts if text)


# --- files and rows ---------------------------------------------------------------------------------------------------


def _distribution(manifest: Manifest) -> list[dict[str, Any]]:
    table = {
        "@type": "cr:FileObject",
        "@id": "manifest",
        "name": manifest.path.name,
        "description": "One row a file of the set.",
        "contentUrl": manifest.path.name,
        "encodingFormat": "text/csv",
        "sha256": manifest.digest.removeprefix("sha256:"),
    }
    archives = [
        {
            "@type": "cr:FileObject",
            "@id": f"archive-{number}",
            "name": PurePosixPath(download.address).name or f"archive-{number}",
            "description": download.notes or "An archive of the set.",
            "contentUrl": download.address,
            "encodingFormat": "application/octet-stream",
            "sha256": download.sha256.removeprefix("sha256:"),
        }
        | ({} if download.size_bytes is None else {"contentSize": f"{download.size_bytes} B"})
        for number, download in enumerate(manifest.card.downloads, start=1)
        if download.sha256 is not None
    ]
    suffixes = sorted({PurePosixPath(record.path).suffix for record in manifest.records})
    files = [
        {
            "@type": "cr:FileSet",
            "@id": f"files{suffix}",
            "name": f"files{suffix}",
            "description": f"Files below the folder {manifest.card.folder}, as the manifest lists them.",
            "encodingFormat": _FORMATS.get(suffix.lower(), "application/octet-stream"),
            "includes": f"**/*{suffix}",
        }
        for suffix in suffixes
    ]
    return [table, *archives, *files]


def _record_sets(manifest: Manifest) -> list[dict[str, Any]]:
    columns = [field.name for field in fields(FrameRecord)]
    frames = {
        "@type": "cr:RecordSet",
        "@id": "frames",
        "name": "frames",
        "description": "Every file of the manifest; an empty cell is not known.",
        "key": {"@id": "frames/path"},
        "field": [_field("frames", name, manifest.records) for name in columns],
    }
    pairs = [_field("pairs", name, manifest.records) for name in _OF_PAIRS]
    pairs[1]["references"] = {"field": {"@id": "frames/path"}}
    described = {
        "@type": "cr:RecordSet",
        "@id": "pairs",
        "name": "pairs",
        "description": (
            "Pairs of a noisy frame (path) and its clean reference: the manifest's rows whose reference is not empty, "
            "with the exposure of the noisy frame."
        ),
        "field": pairs,
    }
    return [frames, *([described] if any(record.reference for record in manifest.records) else [])]


def _field(record_set: str, name: str, records: Sequence[FrameRecord]) -> dict[str, Any]:
    return {
        "@type": "cr:Field",
        "@id": f"{record_set}/{name}",
        "name": name,
        "description": _COLUMNS[name],
        "dataType": _data_type(name, records),
        "source": {"fileObject": {"@id": "manifest"}, "extract": {"column": name}},
    }


def _data_type(name: str, records: Sequence[FrameRecord]) -> str:
    """Return a column's type: numbers only where every cell is a decimal one, for a fraction is text to a reader."""
    if name in _WHOLE:
        return "sc:Integer"
    if name not in _NUMBERS:
        return "sc:Text"
    stated = {value for value in map(attrgetter(name), records) if value is not None}
    return "sc:Float" if stated and all("/" not in number_text(value) for value in stated) else "sc:Text"


# --- responsible AI ---------------------------------------------------------------------------------------------------


def _responsible(card: Card) -> dict[str, Any]:
    told: dict[str, Any] = {
        "rai:dataCollection": " ".join(sentences([card.contents or card.title, *card.sources])),
        "rai:dataCollectionType": ["Physical data collection"],
        "rai:dataUseCases": [
            "Training and evaluation of denoisers of raw photographs taken in the dark, and of models of their noise."
        ],
        "rai:dataPreprocessingProtocol": list(sentences([card.levels])),
        "rai:dataLimitations": list(sentences(card.known_defects)),
        "rai:dataCollectionMissingData": " ".join(sentences(card.unknown)),
        "rai:personalSensitiveInformation": ["Not stated by the texts that this card was made from."],
    }
    return {name: value for name, value in told.items() if value}
