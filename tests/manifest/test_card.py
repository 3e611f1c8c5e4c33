"""The dataset card: a faithful round trip, and each malformed field named."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from eldata.errors import ManifestError
from eldata.manifest.card import (
    CFA_WORDS,
    CameraCard,
    Card,
    Download,
    Subset,
    card_text,
    cfa_word,
    load_card,
    save_card,
)
from eldata.manifest.catalogue import load_manifest, save_manifest
from eldata.raw.stated import MosaicFacts
from tests.cases import in_one_test
from tests.syncing import OnDisk
from tests.trees import Tree

CARD = Card(
    name="set",
    title="A set — with “quotes”",
    version="2.1",
    folder="SET",
    citation="A. Author, 2024",
    licence="CC BY 4.0",
    homepage="https://example.org/set",
    cfa="xtrans",
    cameras={"XT2": CameraCard(("X-T2", "X-T2S")), "XT3": CameraCard(("X-T3",))},
    counts={"noisy": 12, "reference": 4},
    downloads=(Download("https://example.org/a.zip", 123, "part 1"), Download("https://example.org/b.zip")),
    known_defects=("frame 7 is blurred",),
    sources=("the paper's table 1",),
    scenes_shared=False,
    subsets=(Subset("all", "All", "paper", 12), Subset("first", "First", "paper", 3, first=True)),
    mosaics=(MosaicFacts("*.npy", "GBRG", (240.0,), 4095.0),),
)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "set.json"


def test_round_trip(path: Path) -> None:
    save_card(path, CARD)
    assert load_card(path) == CARD
    assert "“quotes”" in path.read_text(encoding="utf-8"), "people read this file: text is not escaped"


def test_optional_fields_may_be_left_out(path: Path) -> None:
    least = {name: value for name, value in json.loads(card_text(CARD)).items() if name in REQUIRED}
    path.write_text(json.dumps(least | {"downloads": [{"address": "https://example.org/b.zip"}]}), encoding="utf-8")
    card = load_card(path)
    assert (card.downloads, card.scenes_shared, card.known_defects) == (CARD.downloads[1:], True, ())
    assert card.protocol == "raw", "a set of one's own"


DELETE = object()


def test_the_word_for_colour_filter_arrays(tmp_path: Path) -> None:
    kinds = {"Bayer": "bayer", "X-Trans": "xtrans", "quad-Bayer": "quad-bayer", "nona-Bayer": "nona-bayer"}
    assert {name: cfa_word([name, name]) for name in kinds} == kinds
    assert cfa_word(["Bayer", "X-Trans"]) == "both"
    assert cfa_word(["Bayer", "quad-Bayer"]) == cfa_word(kinds) == "mixed"
    for word in CFA_WORDS:
        save_card(tmp_path / "a.json", replace(CARD, cfa=word))
        assert load_card(tmp_path / "a.json").cfa == word


REQUIRED = ("name", "title", "version", "folder", "citation", "licence", "homepage", "cfa", "cameras", "counts")


@in_one_test(
    "where, value, field",
    [
        *[((name,), value, name) for name in REQUIRED for value in (DELETE, 7, None)],
        (("colour",), "red", "colour"),
        *[(("folder",), name, "folder") for name in ("../SET", "/SET", "a/b", "", "..", "C:")],
        (("cfa",), "Bayer", "cfa"),
        (("cameras", "XT2"), ["X-T2"], "cameras.XT2"),
        (("cameras", "XT2"), {}, "cameras.XT2.models"),
        (("cameras", "XT2", "models"), "X-T2", "cameras.XT2.models"),
        (("cameras", "XT2", "lens"), "50", "cameras.XT2.lens"),
        (("cameras", "X\u202eT2"), {"models": []}, "cameras.'X\\u202eT2'"),
        (("subsets", 1, "name"), "all", "subsets[1].name"),
        (("mosaics", 0, "cfa"), "RGBG", "mosaics[0].cfa"),
        (("mosaics", 0, "black_level_dn"), [1, 2], "mosaics[0].black_level_dn"),
        (("mosaics", 0, "white_level_dn"), 240, "mosaics[0].white_level_dn"),
        (("mosaics", 0, "bits"), 10, "mosaics[0].bits"),
        *[(("counts", "noisy"), value, "counts.noisy") for value in ("1", 1.0, True)],
        (("scenes_shared",), "no", "scenes_shared"),
        (("downloads",), {}, "downloads"),
        (("downloads", 0), "https://example.org", "downloads[0]"),
        *[(("downloads", 0, "address"), value, "downloads[0].address") for value in (DELETE, 1)],
        (("downloads", 0, "size_bytes"), "5", "downloads[0].size_bytes"),
        (("downloads", 0, "notes"), 5, "downloads[0].notes"),
        (("downloads", 0, "mirror"), "", "downloads[0].mirror"),
        (("known_defects",), "none", "known_defects"),
        (("sources", 0), None, "sources[0]"),
    ],
)
def test_a_bad_field_is_named(path: Path, where: tuple[str | int, ...], value: Any, field: str) -> None:
    content = json.loads(card_text(CARD))
    target: Any = content
    for key in where[:-1]:
        target = target[key]
    if value is DELETE:
        del target[where[-1]]
    else:
        target[where[-1]] = value
    path.write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(ManifestError) as raised:
        load_card(path)
    assert f"{path}, field {field}: " in str(raised.value)


# --- card and table together --------------------------------------------------------------------------------------


def test_a_manifest_without_its_card_says_so(tree: Tree) -> None:
    tree.csv.with_suffix(".json").unlink()
    with pytest.raises(ManifestError, match="a manifest needs its dataset card"):
        load_manifest(tree.csv)


def test_a_camera_that_is_not_on_the_card(tree: Tree) -> None:
    text = tree.csv.read_text(encoding="utf-8")
    tree.csv.write_text(text.replace("noisy,DemoBeta", "noisy,DemoGamma", 1), encoding="utf-8")
    with pytest.raises(ManifestError, match=r"'DemoGamma' is not on the card.*DemoAlpha, DemoBeta"):
        load_manifest(tree.csv)


def test_a_lost_row_is_noticed(tree: Tree) -> None:
    """A manifest that lost rows would verify less than it claims."""
    lines = tree.csv.read_text(encoding="utf-8").splitlines(keepends=True)
    tree.csv.write_text("".join(lines[:-2] + lines[-1:]), encoding="utf-8")
    with pytest.raises(ManifestError, match="the card expects"):
        load_manifest(tree.csv)


def test_rows_are_on_the_disk_before_the_card_gets_its_name(tree: Tree, monkeypatch: pytest.MonkeyPatch) -> None:
    """And they get theirs last: where the rows are the new ones, so is the card."""
    disk, renamed = OnDisk(monkeypatch), []
    rename = os.replace

    def replace_file(source: Path, target: Path) -> None:
        renamed.append((target.suffix, [disk.has(part) for part in tree.csv.parent.glob(".*.csv.eldata.part")]))
        rename(source, target)

    monkeypatch.setattr(os, "replace", replace_file)
    manifest = tree.manifest
    save_manifest(tree.csv, replace(manifest.card, version="2"), manifest.records)
    assert renamed == [(".json", [True]), (".csv", [True])]
