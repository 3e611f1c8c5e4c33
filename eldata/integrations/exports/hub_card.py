"""The page that a set has on the Hugging Face Hub: README.md, whose header the package ``datasets`` reads.

Fields of the header: hub-docs, datasetcard.md; licences: docs/hub/repositories-licenses.md there. Features are stated,
not left to ``datasets`` (5.2), which takes them from the first five samples: a field that these lack is lost of all
others, and a list that is empty in them may not be filled in later ones.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from eldata.base.fields import names_of
from eldata.base.files import json_text
from eldata.base.tables import markdown_text
from eldata.manifest.card import stated
from eldata.manifest.croissant import licence_of, place_text, sentences, to_croissant
from eldata.records import Exposure, PairRecord

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from eldata.manifest.card import Card
    from eldata.manifest.catalogue import Manifest

_ADDRESS = "OWNER/{name}"
# In escaped text: it ends before what cannot stand between angle brackets, and before a sentence's own marks.
_WEB_ADDRESS = re.compile(r"""https?://(?:\\[*_{}\[\]|~&$]|[^\s\\"'])*(?:\\[_~&$]|[\w/=%#-])""")

# What the Hub calls an SPDX name otherwise than in small letters, and, of the names of Card.spdx, those that it has.
_RENAMED = {"ODbL-1.0": "odbl", "ODC-By-1.0": "odc-by", "PDDL-1.0": "pddl"}
_ON_THE_HUB = re.compile(
    r"cc0-1\.0|cc-by-([234]\.0|2\.5)|cc-by-sa-[34]\.0|cc-by-nc(-sa)?-[234]\.0|cc-by-nd-4\.0|cc-by-nc-nd-[34]\.0|"
    r"cdla-(permissive-[12]|sharing-1)\.0|mit|apache-2\.0|bsd-[23]-clause|gpl-[23]\.0|agpl-3\.0|lgpl-(2\.1|3\.0)|mpl-2\.0|"
    r"odbl|odc-by|pddl"
)

_SIZES = ((1_000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K"), (1_000_000, "100K<n<1M"))
_LARGEST = "1M<n<10M"

_SENSOR = {
    "make": "string",
    "model": "string",
    "cfa": [["int64"]],
    "black_level_dn": ["float64"],
    "white_level_dn": "float64",
    "height": "int64",
    "width": "int64",
    "white_balance": ["float64"],
    "xyz_to_camera": [["float64"]],
}
_SENSOR_MORE = {
    "black_level_dn": ["string"],
    "white_level_dn": "string",
    "white_balance": ["string"],
    "xyz_to_camera": [["string"]],
    "matrix_illuminant": "int64",
}
_SIDE = {"sensor": _SENSOR, "exposure": dict.fromkeys(names_of(Exposure), "string"), "sensor_more": _SENSOR_MORE}
_FACTS = {
    "record": dict.fromkeys(names_of(PairRecord), "string") | {"flags": ["string"]},
    "ratio": "string",
    "top": "int64",
    "left": "int64",
    "input": _SIDE,
    "target": _SIDE,
}
"""What a sample's JSON may hold (:mod:`eldata.sources.shards.index`)."""

_OF_FRAMES = ("iso", "exposure_s", "size_bytes", "sha256")
PAIR_COLUMNS = (
    *("path", "camera", "scene", "split", "iso", "exposure_s", "ratio", "flags", "size_bytes", "sha256"),
    *("reference", *(f"reference_{name}" for name in _OF_FRAMES), "download"),
)


@dataclass(frozen=True, slots=True)
class HubSplit:
    """A split as ``datasets`` names it: a pattern of its files, its number of samples or pairs, its shards' bytes."""

    name: str
    files: str
    examples: int
    bytes: int = 0


@dataclass(frozen=True, slots=True)
class HubLayout:
    """What a folder holds: its splits, whether with pixels, and the size (H, W) of all of these if it is one."""

    splits: tuple[HubSplit, ...]
    pixels: bool = False
    shape: tuple[int, int] | None = None


def hub_page(manifest: Manifest, layout: HubLayout) -> str:
    """Return README.md: the header in YAML, and the page that people read."""
    header = "\n".join(_yaml(_header(manifest, layout)))
    return f"---\n{header}\n---\n\n" + "\n\n".join(_sections(manifest, layout)) + "\n"


# --- the header -------------------------------------------------------------------------------------------------------


def _header(manifest: Manifest, layout: HubLayout) -> dict[str, Any]:
    examples = sum(split.examples for split in layout.splits) or len(manifest.records)
    header: dict[str, Any] = {
        **_licence(manifest.card),
        "pretty_name": manifest.card.title,
        "task_categories": ["image-to-image"],
        "tags": [word.replace(" ", "-") for word in to_croissant(manifest)["keywords"]],
        "size_categories": [next((text for most, text in _SIZES if examples < most), _LARGEST)],
    }
    return header | (_of_shards(layout) if layout.pixels else _of_tables(manifest, layout))


def _of_shards(layout: HubLayout) -> dict[str, Any]:
    array = {"array2_d": {"shape": list(layout.shape), "dtype": "uint16"}} if layout.shape else [["uint16"]]
    features = {"json": _FACTS, "input.npy": array, "target.npy": array, "__key__": "string", "__url__": "string"}
    counts = [{"name": one.name, "num_bytes": one.bytes, "num_examples": one.examples} for one in layout.splits]
    return {
        "configs": [{"config_name": "pairs", "data_files": _files(layout.splits)}],
        "dataset_info": [{"config_name": "pairs", "features": _features(features), "splits": counts}],
    }


def _of_tables(manifest: Manifest, layout: HubLayout) -> dict[str, Any]:
    kinds = _kinds(manifest)
    of_pairs = {name: kinds.get(name.removeprefix("reference_"), "string") for name in PAIR_COLUMNS}
    pairs = {"config_name": "pairs", "default": True, **_table(layout.splits, of_pairs)}
    frames = {"config_name": "frames", **_table([HubSplit("frames", manifest.path.name, 0)], kinds)}
    return {"configs": [pairs, frames] if layout.splits else [frames]}


def _licence(card: Card) -> dict[str, str]:
    """Return the fields that state a licence: a name that the Hub has, or ``other`` with the card's."""
    name = _RENAMED.get(card.spdx) or re.sub("-(only|or-later)$", "", card.spdx).lower()
    if _ON_THE_HUB.fullmatch(name):
        return {"license": name}
    if card.spdx:
        link = "LICENSE" if card.spdx.startswith("LicenseRef-") else licence_of(card)
        return {"license": "other", "license_name": card.spdx.removeprefix("LicenseRef-").lower(), "license_link": link}
    words = stated(card.licence)
    return (
        {"license": "other", "license_name": "in-words", "license_details": words} if words else {"license": "unknown"}
    )


def _table(splits: Sequence[HubSplit], kinds: Mapping[str, Any]) -> dict[str, Any]:
    """Return how ``datasets`` is to read tables: an empty cell is not known, and NA is a name as any other."""
    read = {"keep_default_na": False, "na_values": [""]}
    return {"data_files": _files(splits), **read, "features": _features(kinds)}


def _files(splits: Iterable[HubSplit]) -> list[dict[str, str]]:
    return [{"split": split.name, "path": split.files} for split in splits]


def _kinds(manifest: Manifest) -> dict[str, str]:
    """Return the type of each of the manifest's columns, as Croissant states it.

    A whole number that is missing in some row is a float: the reader of tables has no other number for it.
    """
    fields = to_croissant(manifest)["recordSet"][0]["field"]
    kinds = {}
    for field in fields:
        name = field["name"]
        whole = all(getattr(record, name) is not None for record in manifest.records)
        kinds[name] = {"sc:Text": "string", "sc:Float": "float64", "sc:Integer": "int64" if whole else "float64"}[
            field["dataType"]
        ]
    return kinds


def _features(kinds: Mapping[str, Any]) -> list[dict[str, Any]]:
    return [{"name": name, **_feature(kind)} for name, kind in kinds.items()]


def _feature(kind: Any) -> dict[str, Any]:
    """Return a type as ``datasets`` writes it: a list by the type of its items, a dict by those of its fields."""
    if isinstance(kind, list):
        item = _feature(kind[0])
        return {"list": item.get("dtype", item)}
    if isinstance(kind, dict) and "array2_d" not in kind:
        return {"struct": _features(kind)}
    return {"dtype": kind}


def _yaml(value: dict[str, Any] | list[Any]) -> list[str]:
    """Return plain types as lines of YAML; texts and numbers as JSON has them, which YAML reads alike."""
    if isinstance(value, dict):
        return [line for name, item in value.items() for line in _entry(f"{name}:", item)]
    return [line for item in value for line in _entry("-", item)]


def _entry(start: str, item: Any) -> list[str]:
    if not isinstance(item, (dict, list)):
        return [f"{start} {json_text(item, indent=None).rstrip()}"]
    inner = [f"  {line}" for line in _yaml(item)]
    return [start, *inner] if start != "-" else [f"- {inner[0].lstrip()}", *inner[1:]]


# --- the page ---------------------------------------------------------------------------------------------------------


def _sections(manifest: Manifest, layout: HubLayout) -> Iterable[str]:
    card = manifest.card
    yield f"# {_quoted(card.title)}"
    yield _quoted(" ".join(sentences([card.contents, f"Cameras: {', '.join(card.cameras)}", card.levels])))
    facts = (("Licence", licence_of(card)), ("Citation", stated(card.citation)), ("Homepage", stated(card.homepage)))
    yield "\n".join(f"- {name}: {_quoted(text)}" for name, text in facts if text)
    yield from _reading(manifest, layout)
    if not layout.pixels:
        yield "## Where the photographs are"
        yield _bullets(_quoted(place_text(one)) for one in card.downloads) or (
            f"Not stated; the manifest's paths begin in {_quoted(card.folder)}."
        )
    for title, texts in (("Known defects", card.known_defects), ("What is not known", card.unknown)):
        if texts:
            yield f"## {title}"
            yield _bullets(map(_quoted, texts))
    yield "## Files"
    yield _bullets(_files_in_words(manifest, layout))


def _reading(manifest: Manifest, layout: HubLayout) -> Iterable[str]:
    """Yield how the folder is read; the lines are those of docs/hub.md."""
    address = _ADDRESS.format(name=re.sub(r"[^\w.-]", "", manifest.name))  # it stands in code that people copy
    yield "## Reading it"
    if layout.pixels:
        split = layout.splits[0].name
        yield f"""```python
import numpy as np
from datasets import load_dataset

for pair in load_dataset("{address}", split="{split}", streaming=True):
    noisy, clean = (np.array(pair[name], dtype=np.uint16) for name in ("input.npy", "target.npy"))
    facts = pair["json"]
```"""
        yield (
            "Both are mosaics in DN, as the camera gave them; the facts are the record, the exposure ratio, and each "
            "frame's levels, CFA and exposure. As packed, normalised and amplified tensors, shuffled over ranks and "
            "workers, eldata gives them from the same files:"
        )
        yield f"""```python
from eldata import StreamedPairs

pairs = StreamedPairs("hf://datasets/{address}/data/{split}")  # or this folder's data/{split}
```"""
        return
    what = f', split="{layout.splits[0].name}"' if layout.splits else ', "frames", split="frames"'
    yield f"""```python
from datasets import load_dataset

rows = load_dataset("{address}"{what})
```"""
    yield (
        "Rows name the photographs, which are not here: a data set is passed on by those who may. With your own copy, "
        f"eldata verify {_quoted(manifest.path.name)} --root FOLDER says whether it is whole."
    )


def _files_in_words(manifest: Manifest, layout: HubLayout) -> Iterable[str]:
    for split in layout.splits:
        what = "samples as tar shards, and their index" if layout.pixels else "pairs: names, exposures, ratios, hashes"
        yield f"{_quoted(split.files)}: {split.examples} {what}"
    stem = _quoted(manifest.path.stem)
    yield f"{stem}.csv, {stem}.json: the manifest, one row a file, and its card"
    yield f"{stem}.croissant.json: the same in Croissant 1.1"


def _quoted(text: str) -> str:
    """Return Markdown that shows a card's text as it is: of what it holds, only web addresses become links."""
    return _WEB_ADDRESS.sub(lambda found: f"<{found[0].replace(chr(92), '')}>", markdown_text(text))


def _bullets(texts: Iterable[str]) -> str:
    return "\n".join(f"- {text}" for text in texts)
