"""A set as Croissant: what the JSON-LD says is what card and CSV file say, and mlcroissant finds no error in it."""

from __future__ import annotations

import csv
import hashlib
import json
import shutil
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest

from eldata.base.files import write_json
from eldata.cli.main import main
from eldata.manifest import shipped_card, shipped_manifest, shipped_names, to_croissant
from eldata.manifest.card import Download
from eldata.manifest.catalogue import carded_names
from tests.integrations.published_sets import sid_like

if TYPE_CHECKING:
    from pathlib import Path

    from eldata.manifest.catalogue import Manifest


def rows(manifest: Manifest) -> list[dict[str, str]]:
    with manifest.path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


@pytest.mark.parametrize("name", shipped_names())
def test_it_says_what_the_csv_file_holds(name: str) -> None:
    manifest = shipped_manifest(name)
    found = to_croissant(manifest)
    table = found["distribution"][0]
    assert table["sha256"] == hashlib.sha256(manifest.path.read_bytes()).hexdigest()
    assert table["contentUrl"] == manifest.path.name
    cells = rows(manifest)
    frames, pairs = found["recordSet"]
    assert [field["source"]["extract"]["column"] for field in frames["field"]] == list(cells[0])
    for field in (*frames["field"], *pairs["field"]):
        column = [row[field["source"]["extract"]["column"]] for row in cells]
        if field["dataType"] in ("sc:Float", "sc:Integer"):
            assert all(is_number(cell) for cell in column if cell)
    suffixes = {f".{row['path'].rpartition('.')[2]}" for row in cells}
    assert {one["includes"] for one in found["distribution"][1:]} == {f"**/*{suffix}" for suffix in suffixes}


def test_fractions_are_text() -> None:
    """A third of a second is no decimal number: a reader of numbers would fail on it."""
    (frames, _) = to_croissant(shipped_manifest("sid-sony"))["recordSet"]
    kinds = {field["name"]: field["dataType"] for field in frames["field"]}
    assert kinds["exposure_s"] == "sc:Text"
    assert kinds["iso"] == kinds["ratio"] == "sc:Float"


@pytest.mark.parametrize(
    ("licence", "said"),
    [
        ("not stated", "unknown: no licence is stated"),
        ("none stated", "unknown: no licence is stated"),
        ("", "unknown: no licence is stated"),
        ("CC0-1.0", "https://spdx.org/licenses/CC0-1.0"),
        ("MIT for the repository; none stated separately for the data",) * 2,
    ],
)
def test_the_licence_is_stated_or_unknown(licence: str, said: str) -> None:
    assert to_croissant(replace(shipped_card("eld"), licence=licence))["license"] == said


def test_archives_are_linked_with_a_hash_and_named_without_one() -> None:
    digest = "ab" * 32
    known = Download("https://example.org/A.zip", 5, sha256=f"sha256:{digest}")
    unknown = Download("https://example.org/B.zip", None, "a mirror", about="25 GB")
    manifest = shipped_manifest("eld")
    found = to_croissant(replace(manifest, card=replace(manifest.card, downloads=(known, unknown))))
    linked = [one for one in found["distribution"] if one["@id"].startswith("archive")]
    assert [(one["contentUrl"], one["sha256"], one["contentSize"]) for one in linked] == [
        (known.address, digest, "5 B")
    ]
    assert "https://example.org/B.zip (25 GB; a mirror)" in found["description"]


def test_defects_and_what_is_unknown_are_said() -> None:
    card = shipped_card("rawnind")
    found = to_croissant(card)
    assert "distribution" not in found
    for text in (*card.known_defects, *card.unknown):
        assert text in json.dumps(found, ensure_ascii=False)


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", "eld", "--croissant"]) == 0
    assert json.loads(capsys.readouterr().out) == to_croissant(shipped_manifest("eld"))
    file = tmp_path / "eld.croissant.json"
    assert main(["info", "eld", "--croissant", str(file)]) == 0
    assert "it reads eld.csv: put" in capsys.readouterr().out
    assert json.loads(file.read_text(encoding="utf-8")) == to_croissant(shipped_manifest("eld"))
    own = sid_like(tmp_path)
    assert main(["info", str(own.path), "--croissant", str(file)]) == 0
    assert json.loads(file.read_text(encoding="utf-8"))["license"] == "https://spdx.org/licenses/CC0-1.0"
    assert main(["info", "rawnind", "--croissant"]) == 0
    capsys.readouterr()
    assert main(["info", "--croissant", str(file)]) == 2
    assert "--croissant describes one set" in capsys.readouterr().err


# --- its validator ----------------------------------------------------------------------------------------------------


def validated(described: dict[str, Any], path: Path) -> Any:
    mlcroissant = pytest.importorskip(
        "mlcroissant",
        reason="needs mlcroissant, which the locked tools cannot have: its jsonpath-rw is no wheel (docs/manifests.md)",
    )
    write_json(path, described)
    dataset = mlcroissant.Dataset(jsonld=path)
    assert dataset.metadata.ctx.issues.errors == set()
    (warning,) = dataset.metadata.ctx.issues.warnings
    assert "datePublished" in warning, "no card knows when a set was published"
    return dataset


@pytest.mark.filterwarnings("default")  # of mlcroissant and what it is made of
@pytest.mark.parametrize("name", carded_names())
def test_mlcroissant_finds_no_error(name: str, tmp_path: Path) -> None:
    described = shipped_manifest(name) if name in shipped_names() else shipped_card(name)
    validated(to_croissant(described), tmp_path / f"{name}.croissant.json")


@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("record_set", ["frames", "pairs"])
def test_mlcroissant_reads_the_rows(record_set: str, tmp_path: Path) -> None:
    manifest = shipped_manifest("eld")
    shutil.copy(manifest.path, tmp_path / "eld.csv")
    dataset = validated(to_croissant(manifest), tmp_path / "eld.croissant.json")
    read = {record[f"{record_set}/path"].decode(): record for record in dataset.records(record_set)}
    cells = rows(manifest)
    assert len(read) == len(cells) == 640
    for row in cells:
        record = read[row["path"]]
        reference, ratio = record[f"{record_set}/reference"], record[f"{record_set}/ratio"]
        assert (reference and reference.decode()) == (row["reference"] or None)
        assert ratio == (float(row["ratio"]) if row["ratio"] else None)
