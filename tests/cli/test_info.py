"""`eldata info` and `eldata protocols`: what they list, and what they show of one."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from eldata.manifest.card import Download
from eldata.manifest.catalogue import carded_names, shipped_card, shipped_manifest, shipped_names
from eldata.manifest.patterns import is_pattern
from eldata.protocols import PROTOCOLS
from tests.cases import in_one_test
from tests.cli.conftest import Cli, assert_golden, normalised
from tests.cli.test_download import know
from tests.cli.test_usage import assert_one_line
from tests.download.helpers import contents, file_names


@pytest.fixture
def small(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """One dataset called small is known, and nothing else; its folder."""
    downloads = (
        Download("https://example.org/Sony.zip", None, "fetch it once", direct=True, part="Sony", about="25 GB"),
        Download("https://drive.google.com/open?id=1", None, "a mirror", about="25 GB"),
    )
    know(tmp_path, monkeypatch, *downloads)
    return tmp_path / "cwd" / "data" / "SID"


def test_the_table_has_every_shipped_dataset(eldata: Cli) -> None:
    outcome = eldata("info")
    assert (outcome.code, outcome.err) == (0, "")
    _, _, *rows = outcome.out.splitlines()[: 2 + len(carded_names())]
    assert tuple(row.split()[0] for row in rows) == carded_names()
    for row, name in zip(rows, carded_names(), strict=True):
        card = shipped_card(name)
        assert row.endswith(card.title)
        if name not in shipped_names():
            assert "card alone" in row
            continue
        manifest = shipped_manifest(name)
        patterns = any(map(is_pattern, (record.path for record in manifest.records)))
        assert f" {len(manifest.records)}{'+' if patterns else ''} " in row
        assert "absent" in row


def test_all_of_one_dataset(eldata: Cli, small: Path) -> None:
    outcome = eldata("info", "small")
    assert (outcome.code, outcome.err) == (0, "")
    for words in (
        "small: Small set",
        "licence    MIT",
        "citation   A. Author, A Paper, 2018",
        "homepage   https://example.org/small",
        "files      6: 6 noisy",
        "folder     data/SID",
        "data/SID/Sony/long/00001_00_10s.ARW",
        "    https://example.org/Sony.zip\n        direct, part Sony, 25 GB: fetch it once",
        "    https://drive.google.com/open?id=1\n        by hand, in a browser, 25 GB: a mirror",
        "- Frame 3 is blurred.",
        "- The paper.",
        "next\n    eldata download small --root data\n",
    ):
        assert words in outcome.out


def test_the_next_command_is_to_verify_what_is_there(eldata: Cli, small: Path) -> None:
    for name, content in contents().items():
        (small / name).parent.mkdir(parents=True, exist_ok=True)
        (small / name).write_bytes(content)
    next_line = eldata("info", "small").out.splitlines()[-1]
    assert next_line.split()[:2] == ["eldata", "verify"]
    (small / file_names()[0]).unlink()
    verified = eldata(*next_line.split()[1:])
    assert verified.code == 1
    assert file_names()[0] in verified.out


@in_one_test("name", carded_names())
def test_every_dataset_has_its_page(name: str, eldata: Cli) -> None:
    outcome = eldata("info", name)
    assert (outcome.code, outcome.err) == (0, "")
    card = shipped_card(name)
    for place in card.downloads:
        assert place.address in outcome.out
    shown = " ".join(outcome.out.split())
    texts = (card.citation, card.licence, card.contents, card.levels, *card.scored, *card.unknown)
    for text in (*texts, *card.known_defects, *card.sources):
        assert text in shown
    assert f"CFA {card.cfa}" in shown or card.cfa == "both"


def test_a_set_with_a_card_alone(eldata: Cli, tmp_path: Path) -> None:
    outcome = eldata("info", "lld", "--json", tmp_path / "x.json")
    assert "files      eldata has no list of them, only this card" in outcome.out
    assert "\nnext\n    list your copy: eldata manifest FOLDER -o mine.csv, or arrays by hand" in outcome.out
    (dataset,) = json.loads((tmp_path / "x.json").read_text())["datasets"]
    assert (dataset["manifest"], dataset["presence"], dataset["verify"]) == (None, None, None)
    assert_one_line(eldata("download", "lld"), "by its card alone", "eldata info lld")
    assert_one_line(eldata("evaluate", tmp_path, "--dataset", "lld"), "by its card alone", "eldata info lld")


# --- protocols --------------------------------------------------------------------------------------------------------


def test_protocols_are_listed_and_shown(eldata: Cli) -> None:
    assert_golden("protocols-list", normalised(eldata("protocols").out))
    shown = eldata("protocols", "show", "led-eld").out
    assert_golden("protocols-show", normalised(shown))
    assert max(len(line) for line in shown.splitlines() if "sha256:" not in line) <= 80
    digest = PROTOCOLS["led-eld"].digest
    assert digest in shown
    assert eldata("protocols", "led-eld").out == eldata("protocols", digest[:15]).out == shown
    family = eldata("protocols", "led").out
    assert shown in family
    assert family.count("sha256:") == 2


def test_protocols_of_a_dataset(eldata: Cli, tmp_path: Path) -> None:
    outcome = eldata("protocols", "--dataset", "sid-fuji", "--json", tmp_path / "p.json")
    assert outcome.code == 0
    assert "eld-cvpr20" not in outcome.out
    listed = json.loads((tmp_path / "p.json").read_text(encoding="utf-8"))["protocols"]
    assert [protocol["name"] for protocol in listed] == ["raw", "sid", "sid-uncorrected", "sid2018"]
    for protocol in listed:
        named = PROTOCOLS[protocol["name"]]
        assert protocol == named.as_dict() | {"digest": named.digest}


def test_a_protocol_of_ones_own(eldata: Cli, tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text('base = "eld"\nname = "mine"\ntitle = "Mine"\nlevels = "metadata"\n')
    assert "levels              the file's own white and black" in eldata("protocols", path).out
    path.write_text("levels = 3\n")
    assert_one_line(eldata("protocols", path), f"{path}, field base: is missing")
