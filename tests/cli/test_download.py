from __future__ import annotations

from pathlib import PurePosixPath
from typing import TYPE_CHECKING

import pytest

from eldata.download import fetching
from eldata.manifest import catalogue
from eldata.manifest.card import Download
from tests.download import server
from tests.download.helpers import HASTY, contents, make_shelf, sevenzipped, tree, zipped

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from tests.cli.conftest import Cli

FILES = contents()
PACKED = {f"SID/{name}": content for name, content in FILES.items()}
BY_HAND = Download("https://drive.google.com/open?id=1", None, "a mirror")


def archive_at(address: str) -> Download:
    """An archive that a program may fetch; its part is called as its file."""
    part = PurePosixPath(address).stem
    return Download(address, None, "the authors pay for each download", direct=True, part=part, about="25 GB")


@pytest.fixture
def site(monkeypatch: pytest.MonkeyPatch) -> Iterator[server.Site]:
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    with server.running() as site:
        site.content = zipped(PACKED)
        yield site


@pytest.fixture
def data(tmp_path: Path, eldata: Cli) -> Path:
    """The data root that no --root names, and that is not there yet."""
    return tmp_path / "cwd" / "data"


@pytest.fixture
def small(site: server.Site, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> server.Site:
    """One dataset called small is known, which the site serves."""
    know(tmp_path, monkeypatch, archive_at(site.address), BY_HAND)
    monkeypatch.setattr(fetching, "RangeDownloader", lambda: HASTY)
    return site


def know(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *downloads: Download) -> None:
    shelf = make_shelf(tmp_path / "shelf", *downloads)
    monkeypatch.setattr(catalogue, "shipped_folder", lambda: shelf)


# --- fetching ---------------------------------------------------------------------------------------------------------


def test_without_yes_the_terms_are_shown_and_nothing_is_fetched(eldata: Cli, small: server.Site, data: Path) -> None:
    outcome = eldata("download", "small")
    assert (outcome.code, outcome.err) == (1, "")
    for words in (
        small.address,
        "the authors pay for each download",
        "licence: MIT",
        "https://drive.google.com/open?id=1",
        "fetch an archive once, keep it",
        "eldata download small --root data --yes",
        "eldata download small --root data --from FILE",
        "0 of 6 files are in data/SID",
    ):
        assert words in outcome.out
    assert small.requests == []
    assert not data.exists()


def test_yes_fetches_unpacks_and_says_what_is_next(eldata: Cli, small: server.Site, data: Path) -> None:
    outcome = eldata("download", "small", "--yes")
    assert (outcome.code, outcome.err) == (0, "")
    assert outcome.out.index(small.address) < outcome.out.index("set.zip: 6 files unpacked")
    assert "small: all 6 files are in data/SID; check them: eldata verify" in outcome.out
    assert tree(data) == {f"SID/{name}": content for name, content in FILES.items()} | {
        "archives/set.zip": small.content
    }


# --- parts ------------------------------------------------------------------------------------------------------------


@pytest.fixture
def parts(small: server.Site, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> server.Site:
    base = small.address.removesuffix("set.zip")
    know(tmp_path, monkeypatch, archive_at(f"{base}long.zip"), archive_at(f"{base}short.zip"))
    return small


def of_kind(kind: str) -> dict[str, bytes]:
    return {name: content for name, content in FILES.items() if f"/{kind}/" in name}


def test_one_part_and_then_the_other(eldata: Cli, parts: server.Site, data: Path) -> None:
    parts.content = zipped(of_kind("long"))
    outcome = eldata("download", "small", "--part", "long", "--yes")
    assert outcome.code == 1
    assert "3 of 6 files are in data/SID" in outcome.out
    parts.content = zipped(of_kind("short"))
    assert eldata("download", "small", "--part", "long", "--part", "short", "--yes").code == 0
    assert [request["path"] for request in parts.requests] == ["/long.zip", "/short.zip"]


# --- --from -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "pack"), [("Sony.zip", zipped), ("download(1)", sevenzipped)])
def test_an_archive_saved_by_hand(name: str, pack: object, eldata: Cli, small: server.Site, data: Path) -> None:
    saved = data.parent / name
    saved.write_bytes(pack(PACKED | {"README": b"x"}))  # type: ignore[operator]
    outcome = eldata("download", "small", "--from", saved)
    assert (outcome.code, outcome.err) == (0, "")
    assert f"{name}: 6 files unpacked, 0 were there already; 6 of its files are listed in the manifest" in outcome.out
    assert "1 files beside the dataset's folder stay in it" in outcome.out
    assert tree(data) == {f"SID/{name}": content for name, content in FILES.items()}
    assert small.requests == []
