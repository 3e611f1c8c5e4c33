from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path, PurePosixPath

import pytest

from eldata.download import fetching
from eldata.manifest import catalogue
from eldata.manifest.card import Download
from tests.cli.conftest import Cli
from tests.download import server
from tests.download.helpers import HASTY, contents, make_shelf, sevenzipped, tree, zipped

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


def test_one_part_and_then_the_other(
    eldata: Cli, small: server.Site, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    base = small.address.removesuffix("set.zip")
    know(tmp_path, monkeypatch, archive_at(f"{base}long.zip"), archive_at(f"{base}short.zip"))
    for kind, arguments, code in (("long", ["--part", "long"], 1), ("short", ["--part", "long", "--part", "short"], 0)):
        small.content = zipped({name: content for name, content in FILES.items() if f"/{kind}/" in name})
        outcome = eldata("download", "small", *arguments, "--yes")
        assert outcome.code == code
        assert ("3 of 6 files are in data/SID" in outcome.out) == (kind == "long")
    assert [request["path"] for request in small.requests] == ["/long.zip", "/short.zip"]


# --- --from -----------------------------------------------------------------------------------------------------------


def test_an_archive_saved_by_hand(eldata: Cli, small: server.Site, data: Path) -> None:
    saved = data.parent / "download(1)"
    saved.write_bytes(sevenzipped(PACKED | {"README": b"x"}))
    outcome = eldata("download", "small", "--from", saved)
    assert (outcome.code, outcome.err) == (0, "")
    assert "download(1): 6 files unpacked, 0 were there already; 6 of its files are listed in" in outcome.out
    assert "1 files beside the dataset's folder stay in it" in outcome.out
    assert tree(data) == {f"SID/{name}": content for name, content in FILES.items()}
    assert small.requests == []
    (data / "SID" / next(iter(FILES))).write_bytes(b"another")
    again = eldata("download", "small", "--from", saved)
    assert again.code == 1
    assert "all 6 files are in data/SID, but some differ from the archive" in again.out
