from __future__ import annotations

import hashlib
import resource
import shutil
import signal
import subprocess
import sys
import time
import zipfile
from typing import TYPE_CHECKING, Any

import pooch
import pytest
import requests

from eldata.download.card_downloads import kept_archives
from eldata.download.fetching import Fetcher, Patience, open_partial
from eldata.errors import DownloadError
from eldata.manifest.card import Download
from tests.cases import in_one_test
from tests.download import server
from tests.download.helpers import contents, fetch, fetcher, noise, note_of, small_card, tree, zipped
from tests.syncing import OnDisk
from tests.waiting import PATIENCE_S, until

if TYPE_CHECKING:
    from pathlib import Path

CONTENT = zipped(contents(30_000))


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


# --- pooch ------------------------------------------------------------------------------------------------------------


def sha256_of(content: bytes) -> str:
    return f"sha256:{hashlib.sha256(content).hexdigest()}"


def test_a_broken_download_goes_on(site: server.Site, target: Path) -> None:
    """Of any registry of pooch's, and more often than it may without progress; the hash may be any that pooch knows."""
    site.then(*[server.breaking_after(16_384)] * 8, server.serve)
    known_hash = f"md5:{hashlib.md5(CONTENT, usedforsecurity=False).hexdigest()}"
    archives = pooch.create(target.parent, "", registry={"set.zip": known_hash}, urls={"set.zip": site.address})
    assert tree(fetcher().fetch(archives, "set.zip").parent) == {"set.zip": CONTENT}
    assert site.ranges == [None, *(f"bytes={16_384 * n}-" for n in range(1, 9))]
    assert {request.get("if-range") for request in site.requests[1:]} == {'"one"'}


def test_what_the_downloader_saves(site: server.Site, target: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """2 MB over connections that break after 0.6 MB each: why pooch's own downloader does not do, however patient."""
    monkeypatch.setattr(time, "sleep", lambda _: None)
    site.content = zipped({"a": noise(2_000_000)}, zipfile.ZIP_STORED)[:2_000_000]
    site.then(server.breaking_after(600_000))
    alone = pooch.create(
        target.parent, "", registry={"set.zip": None}, urls={"set.zip": site.address}, retry_if_failed=5
    )
    with pytest.raises(requests.RequestException):
        alone.fetch("set.zip")
    assert (len(site.requests), site.sent_bytes, tree(target.parent)) == (6, 3_600_000, {})
    site.requests.clear()
    site.sent_bytes = 0
    fetched(site, target)
    assert len(site.requests) == 4
    assert site.sent_bytes - 2_000_000 in range(3 * 2**14)  # each break loses less than one piece


def test_an_archive_is_on_the_disk_before_it_gets_its_name(
    site: server.Site, target: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk = OnDisk(monkeypatch)
    fetched(site, target)
    assert disk.named == {target.name: True}


@pytest.mark.kill
def test_a_run_killed_while_the_hash_is_checked_loses_nothing(site: server.Site, target: Path) -> None:
    process = started(site, target, known_hash=sha256_of(CONTENT), slow="yes")
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == b"checking\n"
        refused(site, target, "another process is fetching it")
        process.kill()
        process.communicate(timeout=PATIENCE_S)
    finally:
        process.kill()
    assert part_of(target).read_bytes() == CONTENT
    site.requests.clear()
    fetched(site, target, sha256=sha256_of(CONTENT))
    assert site.requests == []


def test_a_redirect_to_nonsense_keeps_what_has_come(site: server.Site, target: Path) -> None:
    site.then(server.breaking_after(16_384), server.redirect("https://[nonsense/"))
    said = "is malformed, or redirects to an address that is (Invalid IPv6 URL)"
    refused(site, target, said, sha256=sha256_of(CONTENT))
    assert part_of(target).read_bytes() == CONTENT[:16_384]


# --- the connection ---------------------------------------------------------------------------------------------------


def test_what_is_there_is_not_fetched_again(site: server.Site, target: Path) -> None:
    fetched(site, target)
    fetched(site, target, size_bytes=len(CONTENT), sha256=sha256_of(CONTENT))
    assert len(site.requests) == 1
    assert site.requests[0]["accept-encoding"] == "identity"


@pytest.mark.parametrize("wrong", [{"size_bytes": 5}, {"sha256": f"sha256:{'0' * 64}"}])
def test_what_is_there_and_wrong_is_named_and_kept(site: server.Site, target: Path, wrong: dict[str, Any]) -> None:
    fetched(site, target)
    with pytest.raises(DownloadError, match=r"set\.zip: expected .*, found .*; move it away"):
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
    hasty = Patience(tries=5, first_wait_s=0.001, silence_s=0.3)
    fetch(site.address, target, hasty)
    assert target.read_bytes() == CONTENT
    assert len(site.requests) >= 2  # more where the machine is so busy that the server is silent too


def range_of(first: int, last: int) -> server.Behaviour:
    """Send these bytes, whatever was asked for."""

    def behaviour(handler: server.Handler, site: server.Site) -> None:
        body, total = site.content[first : last + 1], len(site.content)
        handler.start(206, Content_Length=len(body), ETag=site.etag, Content_Range=f"bytes {first}-{last}/{total}")
        handler.wfile.write(body)

    return behaviour


FROM_32K = "bytes=32768-"


@pytest.mark.parametrize(
    ("etag", "behaviours", "ranges"),
    [
        ('"one"', [server.status(503), server.breaking_after(32_768), server.status(429)], [None, None, FROM_32K]),
        # No ranges: it starts over. No mark of the version, or a weak one: two answers cannot be trusted to be of one.
        ('"one"', [server.without_ranges(32_768), server.without_ranges()], [None]),
        ("", [server.without_mark(32_768), server.without_mark()], [None]),
        ('W/"weak"', [server.breaking_after(32_768)], [None]),
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
        (server.without_ranges(32_768), 4, ["gave up after 3 tries"]),  # each brings 30 kB, and yet nothing new
        (server.claiming(1), 4, ["gave up"]),
        (server.page, 1, ["web page", "in a browser", "--from"]),
        (server.page_called_zip, 1, ["web page", "in a browser", "--from"]),
        (range_of(4, 9), 3, ["gave up"]),
        (server.without_length, 1, ["does not say how long", "--from"]),
        (server.redirect("/set.zip"), 6, ["redirects more than 5 times"]),
        (server.redirect("http://example.org/set.zip"), 1, ["redirects to", "not encrypted", "http://example.org/set"]),
    ],
)
def test_what_is_not(
    behaviour: server.Behaviour, requests: int, words: list[str], site: server.Site, target: Path
) -> None:
    site.then(behaviour)
    refused(site, target, *words)
    assert len(site.requests) == requests


def test_no_server_and_no_archive(site: server.Site, target: Path) -> None:
    site.content = b"not an archive at all" * 100
    refused(site, target, "another kind", "not an a")
    assert part_of(target).stat().st_size == 0
    site.address = "http://127.0.0.1:1/set.zip"
    refused(site, target, "Connection refused", "gave up")


@pytest.mark.parametrize(("code", "advice"), [(401, "--from"), (403, "homepage"), (404, "removed"), (501, "501")])
def test_errors_that_stay(code: int, advice: str, site: server.Site, target: Path) -> None:
    site.then(server.breaking_after(16_384), server.status(code))
    refused(site, target, str(code), advice)
    assert len(site.requests) == 2
    assert part_of(target).read_bytes() == CONTENT[:16_384]


# --- ranges and versions ----------------------------------------------------------------------------------------------


def changed(handler: server.Handler, site: server.Site) -> None:
    site.content, site.etag = zipped(contents(30_001)), '"two"'
    server.serve(handler, site)


def changed_ignoring_if_range(handler: server.Handler, site: server.Site) -> None:
    site.content, site.etag = zipped(contents(30_001)), '"two"'
    del handler.headers["If-Range"]
    server.serve(handler, site)


def changed_to_the_same_size(handler: server.Handler, site: server.Site) -> None:
    site.content, site.etag = site.content[:-1] + b"!", '"two"'
    del handler.headers["If-Range"]
    server.serve(handler, site)


@pytest.mark.parametrize("change", [changed, changed_ignoring_if_range, changed_to_the_same_size])
def test_a_file_that_changes_between_two_ranges_is_not_spliced(
    change: server.Behaviour, site: server.Site, target: Path
) -> None:
    site.then(server.breaking_after(32_768), change, server.serve)
    fetched(site, target)
    assert site.ranges[1] == "bytes=32768-"
    assert site.content != CONTENT


def test_another_address_starts_over(site: server.Site, target: Path) -> None:
    begin(site, target)
    site.address += "?mirror"
    fetched(site, target)
    assert site.ranges == [None]


@pytest.mark.parametrize("spoil", ["missing", "[]"])
def test_bytes_of_unknown_origin_start_over(spoil: str, site: server.Site, target: Path) -> None:
    begin(site, target)
    assert note_of(target) == {"address": site.address, "total_bytes": len(CONTENT), "mark": '"one"'}
    note = target.with_name("set.zip.part.json")
    note.unlink() if spoil == "missing" else note.write_text(spoil)
    fetched(site, target)
    assert site.ranges == [None]


def test_a_run_killed_before_its_last_step_asks_for_nothing(site: server.Site, target: Path) -> None:
    begin(site, target)
    part_of(target).write_bytes(CONTENT)
    fetched(site, target)
    assert site.requests == []


# --- lies -------------------------------------------------------------------------------------------------------------


def test_a_server_that_claims_less_cuts_the_file(site: server.Site, target: Path) -> None:
    """The protocol ends there. The archive's structure shows it (test_archives), or the size on the card."""
    site.then(server.claiming(-1_000))
    refused(site, target, "expected", str(len(CONTENT)), size_bytes=len(CONTENT))
    assert fetch(site.address, target).stat().st_size == len(CONTENT) - 1_000


def test_a_size_that_is_not_the_cards(site: server.Site, target: Path) -> None:
    refused(site, target, "expected 5 bytes", f"the server has {len(CONTENT)}", "homepage", size_bytes=5)
    assert not part_of(target).exists() or part_of(target).stat().st_size == 0


def test_a_part_of_another_size_than_the_cards_starts_over(site: server.Site, target: Path) -> None:
    begin(site, target)
    part_of(target).write_bytes(CONTENT)
    site.then(changed)
    size_bytes = len(zipped(contents(30_001)))
    assert size_bytes != len(CONTENT)
    fetched(site, target, size_bytes=size_bytes)
    assert site.ranges == [None]


def test_a_hash_that_is_not_the_cards_starts_over_next_time(site: server.Site, target: Path) -> None:
    message = refused(site, target, "expected sha256:0000", "homepage", sha256=f"sha256:{'0' * 64}")
    assert sha256_of(CONTENT).partition(":")[2] in message
    assert tree(target.parent) == {}


@pytest.mark.parametrize("behaviour", [server.page, server.page_called_zip, server.without_length])
def test_a_login_page_on_the_way_costs_nothing(behaviour: server.Behaviour, site: server.Site, target: Path) -> None:
    site.then(server.breaking_after(32_768), behaviour)
    refused(site, target)
    site.then(server.serve)
    fetched(site, target)
    assert site.ranges[-1] == "bytes=32768-"


# --- addresses --------------------------------------------------------------------------------------------------------


@in_one_test("address", ["http://127.0.0.1/set.zip", "ftp://example.org/set.zip", "file:///etc/set.zip"])
def test_plain_http_is_refused(address: str, target: Path) -> None:
    with pytest.raises(DownloadError, match="not encrypted"):
        Fetcher().fetch(kept_archives(small_card(Download(address, direct=True)), target), "set.zip")


# --- the disk ---------------------------------------------------------------------------------------------------------


def test_a_disk_with_too_little_room(site: server.Site, target: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: type("Usage", (), {"free": 1000}))
    refused(site, target, "are still to come", "1 kB are free", "--root")


def test_a_disk_that_fills_up(site: server.Site, target: Path) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, hard))
        message = refused(site, target, f"cannot write {part_of(target)}", "File too large", "are kept there")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, ignored)
    assert "50 kB" in message
    assert part_of(target).read_bytes() == CONTENT[:50_000]
    site.requests.clear()
    fetched(site, target)
    assert site.ranges == ["bytes=50000-"]


def test_a_folder_that_cannot_be_made(site: server.Site, tmp_path: Path) -> None:
    (tmp_path / "archives").write_text("a file")
    with pytest.raises(DownloadError, match=r"cannot write .*archives/set\.zip\.part: Not a directory"):
        fetch(site.address, tmp_path / "archives" / "set.zip")


def test_one_process_at_a_time(site: server.Site, target: Path) -> None:
    target.parent.mkdir()
    with open_partial(target):
        refused(site, target, "another process is fetching it")
    fetched(site, target)


# --- interruptions ----------------------------------------------------------------------------------------------------

FETCH = """
import sys
import pooch
from eldata.download.fetching import Fetcher

address, folder, known_hash, slow = sys.argv[1:]
if slow:
    def hash_matches(*_, **__):
        print("checking", flush=True)
        sys.stdin.read()
    pooch.hashes.hash_matches = hash_matches
archives = pooch.create(folder, "", registry={"set.zip": known_hash or None}, urls={"set.zip": address})
Fetcher(plain_http_hosts=["127.0.0.1"]).fetch(archives, "set.zip")
"""


def started(site: server.Site, target: Path, *, known_hash: str = "", slow: str = "") -> subprocess.Popen[bytes]:
    command = [sys.executable, "-c", FETCH, site.address, str(target.parent), known_hash, slow]
    pipe = subprocess.PIPE
    return subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe)


def stuck_after(count: int) -> server.Behaviour:
    def behaviour(handler: server.Handler, site: server.Site) -> None:
        handler.start(200, Content_Length=len(site.content), ETag=site.etag)
        handler.wfile.write(site.content[:count])
        handler.wfile.flush()
        site.over.wait(PATIENCE_S)
        handler.cut()

    return behaviour


@pytest.mark.kill
def test_a_killed_run_is_gone_on_with(site: server.Site, target: Path) -> None:
    site.content = zipped({"a": noise(10**6)})
    site.then(stuck_after(600_000))
    process = started(site, target)
    try:
        until(lambda: part_of(target).exists() and part_of(target).stat().st_size >= 580_000)
        process.kill()
        process.communicate(timeout=PATIENCE_S)
    finally:
        process.kill()
    assert not target.exists()
    have = part_of(target).stat().st_size
    site.then(server.serve)
    site.requests.clear()
    fetched(site, target)
    assert site.ranges == [f"bytes={have}-"]


def test_ctrl_c_comes_through_and_keeps_what_has_come(
    site: server.Site, target: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    site.then(server.breaking_after(16_384))
    monkeypatch.setattr(time, "sleep", interrupt)
    with pytest.raises(KeyboardInterrupt):
        fetch(site.address, target)
    assert part_of(target).read_bytes() == CONTENT[:16_384]


def test_waits_double_up_to_a_limit() -> None:
    patience = Patience(first_wait_s=1, longest_wait_s=60)
    assert [patience.wait_s(n) for n in (1, 2, 3, 7, 8, 5000)] == [1, 2, 4, 60, 60, 60]
