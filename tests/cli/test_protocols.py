"""`eldata protocols`: what it lists and shows, by name, family, digest or file."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from eldata.protocols import PROTOCOLS
from tests.cli.conftest import Cli, assert_golden, normalised

if TYPE_CHECKING:
    from pathlib import Path


def test_list_and_show(eldata: Cli) -> None:
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


def test_json_and_dataset(eldata: Cli, tmp_path: Path) -> None:
    outcome = eldata("protocols", "--dataset", "sid-fuji", "--json", tmp_path / "p.json")
    assert outcome.code == 0
    assert "eld-cvpr20" not in outcome.out
    listed = json.loads((tmp_path / "p.json").read_text(encoding="utf-8"))["protocols"]
    assert [protocol["name"] for protocol in listed] == ["raw", "sid", "sid-uncorrected", "sid2018"]
    for protocol in listed:
        named = PROTOCOLS[protocol["name"]]
        assert protocol == named.as_dict() | {"digest": named.digest}


def test_a_file_of_ones_own(eldata: Cli, tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text('base = "eld"\nname = "mine"\ntitle = "Mine"\nlevels = "metadata"\n')
    assert "levels              the file's own white and black" in eldata("protocols", path).out
    path.write_text("levels = 3\n")
    refused = eldata("protocols", path)
    assert (refused.code, refused.out) == (2, "")
    assert refused.err == f"eldata protocols: {path}, field base: is missing; a protocol needs base, name and title\n"
