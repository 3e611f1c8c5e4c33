"""`eldata download` from a hub that runs on this machine and answers as the Hugging Face hub does."""

from __future__ import annotations

import hashlib
import json
import os
import re
import subprocess
import sys
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import TYPE_CHECKING, Any

import pytest

from eldata.download.hub import hub_name
from eldata.manifest.card import Download
from eldata.manifest.catalogue import shipped_manifest
from tests.waiting import PATIENCE_S

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

COMMIT = "c" * 40
# The hub has the SHA-256 of large files, of the others git's hash. huggingface_hub keeps 10 MiB of a file at a time.
LARGE = bytes(range(256)) * (25 << 12)
REFERENCE = next(row.path for row in shipped_manifest("lrid").records if row.role == "reference")
FILES = {
    REFERENCE: LARGE,
    "bias/6400/1.dng": b"dark",
    "README.md": b"about",
    "indoor_x5/100/000/a.dng": b"unlisted",
}


class Hub:
    """What a repository holds, and what was asked; ``cut`` files end in the middle once, ``wrong`` ones differ."""

    def __init__(self) -> None:
        self.files = dict(FILES)
        self.cut: set[str] = set()
        self.wrong: set[str] = set()
        self.asked: list[tuple[str, str, str | None]] = []
        self.tokens: set[str | None] = set()
        self.address = ""

    def tree(self) -> list[dict[str, Any]]:
        found = []
        for path, content in self.files.items():
            blob = hashlib.sha1(b"blob %d\0" % len(content) + content, usedforsecurity=False).hexdigest()
            entry: dict[str, Any] = {"type": "file", "path": path, "size": len(content), "oid": blob}
            if content == LARGE:
                entry["lfs"] = {"oid": hashlib.sha256(content).hexdigest(), "size": len(content), "pointerSize": 134}
            found.append(entry)
        return found


class Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    hub: Hub

    def log_message(self, format: str, *arguments: Any) -> None:  # noqa: A002 # its name in the base class
        pass

    def do_HEAD(self) -> None:
        self.do_GET()

    def do_GET(self) -> None:
        hub, path = self.hub, self.path.partition("?")[0]
        hub.asked.append((self.command, path, self.headers.get("Range")))
        hub.tokens.add(self.headers.get("Authorization"))
        api = "/api/datasets/hansen97/LRID_simplified"
        file = path.removeprefix(f"/datasets/hansen97/LRID_simplified/resolve/{COMMIT}/")
        if path == api:
            self.answer(json.dumps({"id": "hansen97/LRID_simplified", "sha": COMMIT}).encode())
        elif path == f"{api}/tree/{COMMIT}":
            self.answer(json.dumps(hub.tree()).encode())
        elif file in hub.files:
            self.send_file(file)
        else:
            self.answer(b"{}", status=404)

    def send_file(self, file: str) -> None:
        content = self.hub.files[file]
        start = int((re.fullmatch(r"bytes=(\d+)-.*", self.headers.get("Range", "")) or ["", "0"])[1])
        body = content[start:]
        if file in self.hub.wrong:
            body = bytes(len(body))
        headers = {"ETag": f'"{hashlib.sha256(content).hexdigest()}"', "X-Repo-Commit": COMMIT}
        if start:
            headers["Content-Range"] = f"bytes {start}-{len(content) - 1}/{len(content)}"
        cut = self.command == "GET" and file in self.hub.cut
        self.hub.cut -= {file} if cut else set()
        self.answer(body, status=206 if start else 200, most=len(body) // 2 if cut else None, **headers)

    def answer(self, body: bytes, status: int = 200, most: int | None = None, **headers: str) -> None:
        self.send_response(status)
        for name, value in {"Content-Length": str(len(body)), "Accept-Ranges": "bytes", **headers}.items():
            self.send_header(name, value)
        self.end_headers()
        if self.command == "GET":
            self.wfile.write(body[:most])
        if most is not None:
            self.close_connection = True


@pytest.fixture
def hub() -> Iterator[Hub]:
    found = Hub()
    server = ThreadingHTTPServer(("127.0.0.1", 0), type("Bound", (Handler,), {"hub": found}))
    found.address = f"http://127.0.0.1:{server.server_port}"
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    yield found
    server.shutdown()
    server.server_close()
    thread.join()


def download(hub: Hub, root: Path, *more: str) -> subprocess.CompletedProcess[str]:
    """Run the command in a process of its own: huggingface_hub reads its endpoint when it is imported."""
    environment = os.environ | {"HF_ENDPOINT": hub.address, "HF_HOME": str(root / "home"), "HF_TOKEN": "secret"}
    environment |= {"NO_PROXY": "127.0.0.1", "HF_HUB_OFFLINE": "0"}
    environment |= dict.fromkeys(("HF_HUB_DISABLE_TELEMETRY", "HF_HUB_DISABLE_XET"), "1")
    command = [sys.executable, "-m", "eldata.cli.main", "download", "lrid", "--part", "simplified"]
    command += ["--root", str(root), *more]
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=PATIENCE_S, check=False)


def test_files_that_are_listed_arrive_checked_and_go_on_where_they_broke(hub: Hub, tmp_path: Path) -> None:
    folder = tmp_path / "LRID"
    told = download(hub, tmp_path)
    assert told.returncode == 1
    assert hub.asked == []
    assert "CC BY-NC 4.0" in told.stdout
    hub.cut = {REFERENCE}
    done = download(hub, tmp_path, "--yes")
    assert done.returncode == 1, done.stderr  # of 5507 rows two have files
    assert "2 files unpacked" in done.stdout
    assert (folder / REFERENCE).read_bytes() == LARGE
    assert (folder / "bias" / "6400" / "1.dng").read_bytes() == b"dark"
    there = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    assert there == {"bias/6400/1.dng", REFERENCE}
    assert {f"bytes={10 << 20}-", None} <= {wanted for _, path, wanted in hub.asked if path.endswith(REFERENCE)}
    assert hub.tokens == {None}
    hub.asked.clear()
    again = download(hub, tmp_path, "--yes")
    assert "0 files unpacked, 2 were there already" in again.stdout
    assert not [path for _, path, _ in hub.asked if "resolve" in path]
    (folder / REFERENCE).write_bytes(bytes(len(LARGE)))
    assert "1 differ and were left alone" in download(hub, tmp_path, "--yes").stdout
    assert (folder / REFERENCE).read_bytes() == bytes(len(LARGE))


def test_what_is_not_the_hubs_is_refused_by_name(hub: Hub, tmp_path: Path) -> None:
    hub.wrong = {REFERENCE}
    done = download(hub, tmp_path, "--yes")
    assert done.returncode == 2
    assert f"{REFERENCE}: expected the hash {hashlib.sha256(LARGE).hexdigest()}" in done.stderr
    assert not (tmp_path / "LRID" / REFERENCE).exists()
    hub.wrong, hub.files = set(), {"other/a.txt": b"x"}
    assert "none of its 1 files is listed" in download(hub, tmp_path, "--yes").stderr
    hub.address = "http://127.0.0.1:9"
    done = download(hub, tmp_path, "--yes")
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "hansen97/LRID_simplified: " in done.stderr


def test_only_data_sets_of_the_hub_are_its_own() -> None:
    assert hub_name(Download("https://huggingface.co/datasets/a-b/c.d")) == "a-b/c.d"
    for other in ("https://huggingface.co/a/b", "http://huggingface.co/datasets/a/b", "https://x.example/datasets/a/b"):
        assert hub_name(Download(other)) == ""
