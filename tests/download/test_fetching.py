from __future__ import annotations

import errno
import hashlib
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from typing import TYPE_CHECKING, Any

import pytest

from eldata.download.errors import DownloadError
from eldata.download.fetching import Fetcher, Patience
from eldata.download.partial import Partial
from tests.download import server
from tests.download.helpers import contents, fetcher, noise, note_of, tree, zipped
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
    assert fetcher().fetch(site.address, target, **options) == target
    assert tree(target.parent) == {target.name: site.content}


def refused(site: server.Site, target: Path, *words: str, **options: Any) -> str:
    with pytest.raises(DownloadError) as caught:
        fetcher().fetch(site.address, target, **options)
    message = str(caught.value)
    for word in words:
        assert word in message
    assert "\n" not in message
    assert not target.exists()
    return message


def part_of(target: Path) -> Path:
    return target.with_name(f"{target.name}.part")


# --- the connection ---------------------------------------------------------------------------------------------------


def test_a_good_server(site: server.Site, target: Path) -> None:
    fetched(site, target)
    assert site.ranges == [None]
    assert site.requests[0]["accept-encoding"] == "identity"


def test_what_is_there_is_not_fetched_again(site: server.Site, target: Path) -> None:
    fetched(site, target)
    fetched(site, target, size_bytes=len(CONTENT), sha256=f"sha256:{hashlib.sha256(CONTENT).hexdigest()}")
    assert len(site.requests) == 1


@pytest.mark.parametrize("wrong", [{"size_bytes": 5}, {"sha256": f"sha256:{'0' * 64}"}])
def test_what_is_there_and_wrong_is_named_and_kept(site: server.Site, target: Path, wrong: dict[str, Any]) -> None:
    fetched(site, target)
    with pytest.raises(DownloadError, match=r"set\.zip: expected .*, found .*; move it away"):
        fetcher().fetch(site.address, target, **wrong)
    assert target.read_bytes() == CONTENT
    assert len(site.requests) == 1


def test_a_connection_that_breaks_again_and_again(site: server.Site, target: Path) -> None:
    """More often than it may without progress; each try brings something."""
    site.then(*[server.breaking_after(16_384)] * 8, server.serve)
    fetched(site, target)
    assert site.ranges == [None, *(f"bytes={16_384 * n}-" for n in range(1, 9))]
    assert {request.get("if-range") for request in site.requests[1:]} == {'"one"'}


def test_a_connection_that_never_brings_more(site: server.Site, target: Path) -> None:
    site.then(server.breaking_after(16_384), server.breaking_after(0))
    message = refused(site, target, "gave up after 3 tries in a row", "the same command goes on", "16.4 kB are kept in")
    assert str(part_of(target)) in message
    assert part_of(target).read_bytes() == CONTENT[:16_384]
    site.then(server.serve)
    site.requests.clear()
    fetched(site, target)
    assert site.ranges == ["bytes=16384-"]


def test_no_server(site: server.Site, target: Path) -> None:
    site.address = "http://127.0.0.1:1/set.zip"
    refused(site, target, "Connection refused", "gave up")


def test_a_silent_server(site: server.Site, target: Path) -> None:
    site.then(server.silent, server.serve)
    hasty = Patience(tries=5, first_wait_s=0.001, silence_s=0.3)
    fetcher(hasty).fetch(site.address, target)
    assert target.read_bytes() == CONTENT
    assert len(site.requests) >= 2  # more where the machine is so busy that the server is silent too


@pytest.mark.parametrize("code", [500, 502, 503, 429, 408])
def test_errors_that_pass(code: int, site: server.Site, target: Path) -> None:
    site.then(server.status(code), server.breaking_after(32_768), server.status(code), server.serve)
    fetched(site, target)
    assert len(site.requests) == 4


def test_errors_that_should_pass_and_do_not(site: server.Site, target: Path) -> None:
    site.then(server.status(503))
    refused(site, target, "503", "gave up after 3 tries")
    assert len(site.requests) == 3


@pytest.mark.parametrize(
    ("code", "advice"), [(401, "--from"), (403, "homepage"), (404, "moved or removed"), (410, "homepage"), (501, "501")]
)
def test_errors_that_stay(code: int, advice: str, site: server.Site, target: Path) -> None:
    site.then(server.status(code))
    refused(site, target, str(code), advice)
    assert len(site.requests) == 1


def test_an_error_that_stays_keeps_what_has_come(site: server.Site, target: Path) -> None:
    site.then(server.breaking_after(16_384), server.status(404))
    refused(site, target, "404")
    assert part_of(target).read_bytes() == CONTENT[:16_384]


# --- ranges and versions ----------------------------------------------------------------------------------------------


def test_a_server_without_ranges_starts_over(site: server.Site, target: Path) -> None:
    site.then(server.without_ranges(32_768), server.without_ranges(49_152), server.without_ranges())
    fetched(site, target)
    assert len(site.requests) == 3


def test_a_server_without_ranges_that_always_breaks_is_given_up(site: server.Site, target: Path) -> None:
    """Each try brings 30 kB, and yet nothing new."""
    site.then(server.without_ranges(32_768))
    refused(site, target, "gave up after 3 tries")
    assert len(site.requests) == 4


def test_a_server_that_marks_no_versions_is_not_trusted_to_go_on(site: server.Site, target: Path) -> None:
    site.then(server.without_mark(32_768), server.without_mark())
    fetched(site, target)
    assert site.ranges == [None, None]


def test_a_weak_mark_is_none(site: server.Site, target: Path) -> None:
    site.etag = 'W/"one"'
    site.then(server.breaking_after(32_768), server.serve)
    fetched(site, target)
    assert site.ranges == [None, None]


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


def test_a_file_that_changed_between_two_runs_is_not_spliced(site: server.Site, target: Path) -> None:
    site.then(server.breaking_after(16_384), server.breaking_after(0))
    refused(site, target)
    site.then(changed)
    fetched(site, target)


def test_another_address_starts_over(site: server.Site, target: Path) -> None:
    site.then(server.breaking_after(16_384), server.breaking_after(0))
    refused(site, target)
    site.then(server.serve)
    site.requests.clear()
    site.address += "?mirror"
    fetched(site, target)
    assert site.ranges == [None]


@pytest.mark.parametrize("spoil", ["missing", "no json", "[]", '{"address": 1}'])
def test_bytes_of_unknown_origin_start_over(spoil: str, site: server.Site, target: Path) -> None:
    site.then(server.breaking_after(16_384), server.breaking_after(0))
    refused(site, target)
    assert note_of(target) == {"address": site.address, "total_bytes": len(CONTENT), "mark": '"one"'}
    note = target.with_name("set.zip.part.json")
    note.unlink() if spoil == "missing" else note.write_text(spoil)
    site.then(server.serve)
    site.requests.clear()
    fetched(site, target)
    assert site.ranges == [None]


def test_a_run_killed_before_its_last_step_asks_for_nothing(site: server.Site, target: Path) -> None:
    site.then(server.breaking_after(16_384), server.breaking_after(0))
    refused(site, target)
    part_of(target).write_bytes(CONTENT)
    site.requests.clear()
    fetched(site, target)
    assert site.requests == []


# --- lies -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("shift", [1, 1_000, 10**6])
def test_a_server_that_claims_more_than_it_has(shift: int, site: server.Site, target: Path) -> None:
    site.then(server.claiming(shift))
    refused(site, target, "gave up")


def test_a_server_that_claims_less_cuts_the_file(site: server.Site, target: Path) -> None:
    """The protocol ends there. The archive's structure shows it (test_archives), or the size on the card."""
    site.then(server.claiming(-1_000))
    refused(site, target, "expected", str(len(CONTENT)), size_bytes=len(CONTENT))
    assert fetcher().fetch(site.address, target).stat().st_size == len(CONTENT) - 1_000


def test_a_size_that_is_not_the_cards(site: server.Site, target: Path) -> None:
    refused(site, target, "expected 5 bytes", f"the server has {len(CONTENT)}", "homepage", size_bytes=5)
    assert not part_of(target).exists() or part_of(target).stat().st_size == 0


def test_a_hash_that_is_not_the_cards_starts_over_next_time(site: server.Site, target: Path) -> None:
    refused(site, target, "expected sha256:0000", "found sha256:", sha256=f"sha256:{'0' * 64}")
    assert tree(target.parent) == {}


def test_a_range_that_was_not_asked_for(site: server.Site, target: Path) -> None:
    def other_range(handler: server.Handler, site: server.Site) -> None:
        body = site.content[100:]
        total = len(site.content)
        handler.start(206, Content_Length=len(body), ETag=site.etag, Content_Range=f"bytes 100-{total - 1}/{total}")
        handler.wfile.write(body)

    site.then(server.breaking_after(32_768), other_range, server.serve)
    fetched(site, target)


def test_an_unasked_for_range(site: server.Site, target: Path) -> None:
    def range_at_once(handler: server.Handler, site: server.Site) -> None:
        handler.start(206, Content_Length=4, ETag=site.etag, Content_Range=f"bytes 0-3/{len(site.content)}")
        handler.wfile.write(site.content[:4])

    site.then(range_at_once, server.serve)
    fetched(site, target)


@pytest.mark.parametrize("behaviour", [server.page, server.page_called_zip])
def test_a_web_page_in_place_of_the_archive(behaviour: server.Behaviour, site: server.Site, target: Path) -> None:
    site.then(behaviour)
    refused(site, target, "web page", "in a browser", "--from")
    assert not part_of(target).exists() or part_of(target).stat().st_size == 0


@pytest.mark.parametrize("behaviour", [server.page, server.page_called_zip, server.without_length])
def test_a_login_page_on_the_way_costs_nothing(behaviour: server.Behaviour, site: server.Site, target: Path) -> None:
    site.then(server.breaking_after(32_768), behaviour)
    refused(site, target)
    site.then(server.serve)
    fetched(site, target)
    assert site.ranges[-1] == "bytes=32768-"


def test_something_else_in_place_of_the_archive(site: server.Site, target: Path) -> None:
    site.content = b"not an archive at all" * 100
    refused(site, target, "no archive", "not an a")


def test_a_server_that_states_no_length(site: server.Site, target: Path) -> None:
    site.then(server.without_length)
    refused(site, target, "does not say how long", "--from")


# --- addresses --------------------------------------------------------------------------------------------------------


def test_redirects_are_followed(site: server.Site, target: Path) -> None:
    site.then(server.redirect("/elsewhere"), server.redirect(site.address), server.serve)
    fetched(site, target)
    assert [request["path"] for request in site.requests] == ["/set.zip", "/elsewhere", "/set.zip"]


def test_redirects_in_a_circle(site: server.Site, target: Path) -> None:
    site.then(server.redirect("/set.zip"))
    refused(site, target, "redirects more than 5 times")
    assert len(site.requests) == 6


def test_a_redirect_to_an_unencrypted_place(site: server.Site, target: Path) -> None:
    site.then(server.redirect("http://example.org/set.zip"))
    refused(site, target, "redirects to http://example.org/set.zip", "not encrypted")


@pytest.mark.parametrize("address", ["http://127.0.0.1/set.zip", "ftp://example.org/set.zip", "file:///etc/passwd"])
def test_plain_http_is_refused(address: str, target: Path) -> None:
    with pytest.raises(DownloadError, match="not encrypted"):
        Fetcher().fetch(address, target)


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
    with pytest.raises(DownloadError, match=r"cannot make the folder .*archives"):
        fetcher().fetch(site.address, tmp_path / "archives" / "set.zip")


def test_one_process_at_a_time(site: server.Site, target: Path) -> None:
    target.parent.mkdir()
    with Partial(target).opened():
        refused(site, target, "another process is fetching it")
    fetched(site, target)


# --- interruptions ----------------------------------------------------------------------------------------------------

FETCH = """
import sys
from pathlib import Path
from eldata.download.fetching import Fetcher
Fetcher(plain_http_hosts=["127.0.0.1"]).fetch(sys.argv[1], Path(sys.argv[2]))
"""


def stuck_after(count: int) -> server.Behaviour:
    def behaviour(handler: server.Handler, site: server.Site) -> None:
        handler.start(200, Content_Length=len(site.content), ETag=site.etag)
        handler.wfile.write(site.content[:count])
        handler.wfile.flush()
        site.over.wait(PATIENCE_S)
        handler.cut()

    return behaviour


@pytest.mark.kill
@pytest.mark.parametrize("sent", [signal.SIGKILL, signal.SIGINT])
def test_a_killed_run_is_gone_on_with(sent: signal.Signals, site: server.Site, target: Path) -> None:
    site.content = zipped({"a": noise(10**6)})
    site.then(stuck_after(600_000))
    process = subprocess.Popen([sys.executable, "-c", FETCH, site.address, str(target)], stderr=subprocess.PIPE)
    try:
        until(lambda: part_of(target).exists() and part_of(target).stat().st_size >= 580_000)
        process.send_signal(sent)
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
        fetcher().fetch(site.address, target)
    assert part_of(target).read_bytes() == CONTENT[:16_384]


def test_waits_double_up_to_a_limit() -> None:
    patience = Patience(first_wait_s=1, longest_wait_s=60)
    assert [patience.wait_s(n) for n in (1, 2, 3, 7, 8, 5000)] == [1, 2, 4, 60, 60, 60]


def test_an_unwritable_part_is_named(site: server.Site, target: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    target.parent.mkdir()
    part_of(target).mkdir()
    refused(site, target, f"cannot write {part_of(target)}", os.strerror(errno.EISDIR))
