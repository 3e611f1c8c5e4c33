from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from eldata.download.card_downloads import archive_name, kept_archives
from eldata.download.hub import hub_name
from eldata.download.installing import fetch_dataset
from eldata.errors import DownloadError
from eldata.manifest.card import Download
from eldata.manifest.catalogue import ROOT_VARIABLE, shipped_manifest, shipped_names
from tests.download.helpers import fetcher, make_shelf, small_card

if TYPE_CHECKING:
    from pathlib import Path

HASH = f"sha256:{'1' * 64}"


@pytest.mark.parametrize("name", shipped_names())
def test_the_registry_is_the_cards(name: str, tmp_path: Path) -> None:
    card = shipped_manifest(name).card
    archives = kept_archives(card, tmp_path)
    direct = [download for download in card.downloads if download.direct and not hub_name(download)]
    assert archives.urls == {archive_name(download): download.address for download in direct}
    assert archives.registry == {archive_name(download): download.sha256 for download in direct}
    assert "" not in archives.registry
    assert archives.abspath == tmp_path / "archives"
    assert not archives.allow_updates
    assert not archives.abspath.exists()


def test_what_a_person_fetches_is_not_in_it_and_the_first_address_of_a_name_is() -> None:
    card = small_card(
        Download("https://one.example/set.zip", notes="a page asks first"),
        Download("https://two.example/set.zip?version=2", direct=True, sha256=HASH),
        Download("https://three.example/set.zip", direct=True),
    )
    archives = kept_archives(card)
    assert archives.urls == {"set.zip": "https://two.example/set.zip?version=2"}
    assert archives.registry == {"set.zip": HASH}


def test_the_folder_is_below_the_data_root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert str(kept_archives(small_card()).path) == "data/archives"
    monkeypatch.setenv(ROOT_VARIABLE, "~/large")  # a folder of this name: pooch would take it for one of the home's
    assert kept_archives(small_card()).abspath == tmp_path / "~" / "large" / "archives"
    assert kept_archives(small_card(), tmp_path / "disk").abspath == tmp_path / "disk" / "archives"


def test_an_address_without_an_archives_name(tmp_path: Path) -> None:
    download = Download("https://example.org/download?id=5", direct=True)
    manifest = make_shelf(tmp_path, download).manifest
    with pytest.raises(DownloadError, match=r"id=5: expected an address that ends in .* \(\.zip, .* use --from"):
        fetch_dataset(download, manifest, tmp_path, fetcher())
