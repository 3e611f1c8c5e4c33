"""Fetching from a server on this machine that breaks, lies and changes its mind."""

from __future__ import annotations

import hashlib
import resource
import shutil
import signal
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from eldata.base.files import try_lock
from eldata.download.fetching import RangeDownloader, archive_name
from eldata.errors import DownloadError
from eldata.manifest.catalogue import shipped_manifest, shipped_names
from tests.cases import in_one_test
from tests.download import server
from tests.download.helpers import HASTY, contents, fetch, noise, tree, zipped
from tests.syncing import OnDisk
from tests.waiting import until

CONTENT = zipped(contents(30_000))
SHA256 = f"sha256:{hashlib.sha256(CONTENT).hexdigest()}"
FROM_32K = "bytes=32768-"


@pytest.fixture
def target(tmp_path: Path, site: server.Site) -> Path:
    site.content = CONTENT
    return tmp_path / "archives" / "set.zip"


def fetched(site: server.Site, target: Path, **options: Any) -> None:
    """Fetch, and see that the file is right and nothing lies beside it."""
    assert fetch(site.address, target, **options) == target
    assert tree(target.parent) == {target.name: site.content}


def refused(site: server.Site, target: Path, *words: str, **options: Any) -> str:
    with pytest.raises(DownloadError) as caught:
        fetch(site.address, target, **options)
    message = str(caught.value)
    for word in words:
        assert word in message
    assert "\n" not in message
    assert not target.exists()
    return message


def begin(site: server.Site, target: Path) -> None:
    """Have 16 kB arrive, and the next request be the first that the server knows of; it serves again."""
    site.then(server.breaking_after(16_384), server.breaking_after(0))
    refused(site, target)
    site.then(server.serve)
    site.requests.clear()


def part_of(target: Path) -> Path:
    return target.with_name(f"{target.name}.part")


# --- connections that break -------------------------------------------------------------------------------------------


def test_a_broken_download_goes_on(site: server.Site, target: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """More often than it may without progress; no byte is sent twice but what a break loses; the hash is compared."""
    disk = OnDisk(monkeypatch)
    site.then(*[server.breaking_after(16_384)] * 8, server.serve)
    fetched(site, target, sha256=SHA256)
    assert disk.named[target.name], "it is on the disk before it gets its name"
    assert site.ranges == [None, *(f"bytes={16_384 * n}-" for n in range(1, 9))]
    assert {request.get("if-range") for request in site.requests[1:]} == {'"one"'}
    assert {request["accept-encoding"] for request in site.requests} == {"identity"}


def test_what_is_there_is_not_fetched_again(site: server.Site, target: Path) -> None:
    fetched(site, target)
    fetched(site, target, size_bytes=len(CONTENT), sha256=SHA256)
    for wrong in ({"size_bytes": 5}, {"sha256": f"sha256:{'0' * 64}"}):
        with pytest.raises(DownloadError, match=r"set\.zip: expected .*, found another file; move it away"):
            fetch(site.address, target, **wrong)
    assert target.read_bytes() == CONTENT
    assert len(site.requests) == 1


def test_a_connection_that_never_brings_more(site: server.Site, target: Path) -> None:
    site.then(server.breaking_after(16_384), server.breaking_after(0))
    message = refused(site, target, "gave up after 3 tries in a row", "the same command goes on", "16.4 kB are kept in")
    assert str(part_of(target)) in message
    assert part_of(target).read_bytes() == CONTENT[:16_384]
    site.then(server.serve)
    site.requests.clear()
    fetched(site, target)
    assert site.ranges == ["bytes=16384-"]


def test_a_silent_server(site: server.Site, target: Path) -> None:
    site.then(server.silent, server.serve)
    fetch(site.address, target, replace(HASTY, tries=5, silence_s=0.3))
    assert target.read_bytes() == CONTENT
    assert len(site.requests) >= 2  # more where the machine is so busy that the server is silent too


def range_of(first: int, last: int) -> server.Behaviour:
    """Send these bytes, whatever was asked for."""

    def behaviour(handler: server.Handler, site: server.Site) -> None:
        body, total = site.content[first : last + 1], len(site.content)
        handler.start(206, Content_Length=len(body), ETag=site.etag, Content_Range=f"bytes {first}-{last}/{total}")
        handler.wfile.write(body)

    return behaviour


@pytest.mark.parametrize(
    ("etag", "behaviours", "ranges"),
    [
        ('"one"', [server.status(503), server.breaking_after(32_768), server.status(429)], [None, None, FROM_32K]),
        # No ranges: it starts over. No mark of the version, or a weak one: two answers cannot be trusted to be of one.
        ('"one"', [server.whole(most=32_768), server.whole()], [None, FROM_32K]),
        ("", [server.whole(most=32_768), server.whole()], [None, None]),
        ('W/"weak"', [server.breaking_after(32_768)], [None, None]),
        ('"one"', [server.breaking_after(32_768), range_of(100, len(CONTENT) - 1)], [None, FROM_32K]),
        ('"one"', [range_of(0, 3)], [None]),
        ('"one"', [server.redirect("/elsewhere"), server.redirect("/set.zip")], [None, None]),
    ],
)
def test_what_is_put_up_with(
    etag: str, behaviours: list[server.Behaviour], ranges: list[str | None], site: server.Site, target: Path
) -> None:
    site.etag = etag
    site.then(*behaviours, server.serve)
    fetched(site, target)
    assert site.ranges[: len(ranges)] == ranges


@pytest.mark.parametrize(
    ("behaviour", "requests", "words"),
    [
        (server.status(503), 3, ["503", "gave up after 3 tries"]),
        (server.status(404), 1, ["answered 404", "homepage", "--from"]),
        (server.whole(most=32_768), 4, ["gave up after 3 tries"]),  # each brings 30 kB, and yet nothing new
        (server.claiming(1), 4, ["gave up"]),
        (server.page, 1, ["no archive, but b'<!DOCTYPE html>", "in a browser", "--from"]),
        (range_of(4, 9), 3, ["gave up"]),
        (server.without_length, 1, ["the server says nothing", "--from"]),
        (server.redirect("/set.zip"), 6, ["few redirects", "Exceeded 5 redirects"]),
        (server.redirect("ftp://example.org/set.zip"), 1, ["redirects to", "ftp://example.org/set"]),
        (server.redirect("https://[nonsense/"), 1, ["redirects to", "Invalid IPv6 URL"]),
    ],
)
def test_what_is_not(
    behaviour: server.Behaviour, requests: int, words: list[str], site: server.Site, target: Path
) -> None:
    site.then(behaviour)
    refused(site, target, *words)
    assert len(site.requests) == requests


def test_an_endless_body_is_cut(site: server.Site, target: Path) -> None:
    """No more is kept, or read, than was announced, however often."""
    site.then(server.endless)
    refused(site, target, "sent more than the", "gave up")
    assert part_of(target).stat().st_size <= len(CONTENT)
    assert len(site.requests) == 4


def test_no_server(site: server.Site, target: Path) -> None:
    site.address = "http://127.0.0.1:1/set.zip"
    refused(site, target, "Connection refused", "gave up")


# --- versions and lies ------------------------------------------------------------------------------------------------


def changed_to(content: bytes, *, ignoring_if_range: bool) -> server.Behaviour:
    def behaviour(handler: server.Handler, site: server.Site) -> None:
        site.content, site.etag = content, '"two"'
        if ignoring_if_range:
            del handler.headers["If-Range"]
        server.serve(handler, site)

    return behaviour


LONGER, ALTERED = zipped(contents(30_001)), CONTENT[:100] + b"!" + CONTENT[101:]


@pytest.mark.parametrize(
    ("content", "ignoring"), [(LONGER, False), (LONGER, True), (ALTERED, True)], ids=["a", "b", "c"]
)
def test_a_file_that_changes_between_two_ranges_is_not_spliced(
    content: bytes, ignoring: bool, site: server.Site, target: Path
) -> None:
    site.then(server.breaking_after(32_768), changed_to(content, ignoring_if_range=ignoring), server.serve)
    fetched(site, target)
    assert site.ranges[1] == FROM_32K
    assert site.content == content


@in_one_test("spoil", ["", "[]", "address"])
def test_bytes_of_unknown_origin_start_over(spoil: str, site: server.Site, target: Path) -> None:
    shutil.rmtree(target.parent, ignore_errors=True)
    begin(site, target)
    if spoil == "address":
        site.address += "?mirror"
    else:
        target.with_name("set.zip.part.json").write_text(spoil)
    fetched(site, target)
    assert site.ranges == [None]


def test_a_run_killed_before_its_last_step_asks_for_nothing(site: server.Site, target: Path) -> None:
    begin(site, target)
    part_of(target).write_bytes(CONTENT)
    fetched(site, target)
    assert site.requests == []


def test_what_is_not_the_cards(site: server.Site, target: Path) -> None:
    """A server that claims less cuts the file: the protocol ends there. The card's size or hash shows it."""
    refused(site, target, "expected a file of 5 bytes", f"the server says {len(CONTENT)}", size_bytes=5)
    site.then(server.claiming(-1_000))
    refused(site, target, str(len(CONTENT)), size_bytes=len(CONTENT))
    refused(site, target, SHA256.partition(":")[2], "Has it changed? Look at the homepage", sha256=SHA256)
    assert tree(target.parent) == {}
    assert fetch(site.address, target).stat().st_size == len(CONTENT) - 1_000


@pytest.mark.parametrize("behaviour", [server.page, server.without_length])
def test_a_login_page_on_the_way_costs_nothing(behaviour: server.Behaviour, site: server.Site, target: Path) -> None:
    site.then(server.breaking_after(32_768), behaviour)
    refused(site, target)
    site.then(server.serve)
    fetched(site, target)
    assert site.ranges[-1] == FROM_32K


# --- addresses --------------------------------------------------------------------------------------------------------


@in_one_test("address", ["http://127.0.0.1/set.zip", "ftp://example.org/set.zip", "file:///etc/set.zip"])
def test_plain_http_is_refused(address: str, target: Path) -> None:
    with pytest.raises(DownloadError, match="https alone"):
        fetch(address, target, RangeDownloader())


def test_an_address_without_an_archives_name(tmp_path: Path) -> None:
    for name in shipped_names():
        assert all(archive_name(one.address) for one in shipped_manifest(name).card.downloads if one.direct)
    with pytest.raises(DownloadError, match=r"id=5: does not end in the name of an archive .* use --from"):
        fetch("https://example.org/download?id=5", tmp_path / "archives" / "set.zip")


# --- the disk ---------------------------------------------------------------------------------------------------------


def test_a_disk_with_too_little_room(site: server.Site, target: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: type("Usage", (), {"free": 1000}))
    refused(site, target, "are still to come", "1 kB are free", "--root")


def test_a_disk_that_fills_up(site: server.Site, target: Path) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, hard))
        refused(site, target, f"cannot keep {target}", "File too large", "the same command goes on")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, ignored)
    assert part_of(target).read_bytes() == CONTENT[:50_000]
    site.requests.clear()
    fetched(site, target)
    assert site.ranges == ["bytes=50000-"]


def test_one_process_at_a_time(site: server.Site, target: Path) -> None:
    target.parent.mkdir()
    with part_of(target).open("ab") as file:
        assert try_lock(file)
        refused(site, target, "another process is fetching it")
    fetched(site, target)


# --- interruptions ----------------------------------------------------------------------------------------------------


def test_what_has_arrived_is_in_the_part_while_more_is_awaited(site: server.Site, target: Path) -> None:
    """So a kill of the process loses no more than a broken connection does, and the next run goes on from there."""

    def stuck(handler: server.Handler, site: server.Site) -> None:
        handler.start(200, Content_Length=len(site.content), ETag=site.etag)
        handler.wfile.write(site.content[:600_000])
        handler.wfile.flush()
        until(lambda: part_of(target).stat().st_size >= 560_000)
        handler.cut()

    site.content = zipped({"a": noise(10**6)})
    site.then(stuck, server.serve)
    fetched(site, target)
    assert site.ranges == [None, f"bytes={600_000 // 2**14 * 2**14}-"], "all but a piece that was not whole"
