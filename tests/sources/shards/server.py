"""A web server on this machine that serves a folder, with or without ranges, and fails on request.

Failures, by name: a status such as ``503``; ``cut`` and ``reset``, a body that ends in its middle, the connection
closed or reset; ``stall``, no answer until the server ends; ``stop``, none after half of the body; ``trickle``, a body
in many small pieces; ``short``, less than was asked for, and said so; ``shifted``, a range that begins a byte later
than it says; ``other``, another file's bytes; ``endless``, a body that goes on, up to ``ENDLESS_BYTES``.
"""

from __future__ import annotations

import re
import socket
import struct
import threading
import time
from contextlib import contextmanager, suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


ENDLESS_BYTES = 1 << 30


class Site:
    """What is served and how: ``failures`` are used up by the requests for shards, one each."""

    def __init__(self, folder: Path, *, ranges: bool) -> None:
        self.folder = folder
        self.ranges = ranges
        self.failures: list[str] = []
        self.sent = 0
        self.requests = 0
        self.latency_s = 0.0
        self.bytes_per_s = float("inf")
        self.ended = threading.Event()
        self.lock = threading.Lock()
        self.address = ""

    def failure(self) -> str:
        with self.lock:
            return self.failures.pop(0) if self.failures else ""


class Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True  # or a body waits 40 ms, until its headers have been acknowledged
    site: Site

    def do_HEAD(self) -> None:
        self.answer(body=False)

    def do_GET(self) -> None:
        self.answer(body=True)

    def answer(self, *, body: bool) -> None:
        path = self.site.folder / self.path.rpartition("/")[2]
        if not path.is_file():
            self.send_response(404)
            self.send_header("Content-Length", "0")
            self.end_headers()
            return
        self.site.requests += 1
        if self.site.latency_s:
            time.sleep(self.site.latency_s)
        failure = self.site.failure() if path.suffix == ".tar" else ""
        if failure == "stall":
            self.site.ended.wait()
            self.close_connection = True
            return
        if failure.isdecimal():
            self.send_response(int(failure))
            self.send_header("Content-Length", "0")
            self.end_headers()
            return
        content = path.read_bytes()
        size = len(content)
        content = {"other": content[::-1], "shifted": content[1:] + b"\0"}.get(failure, content)
        asked = re.fullmatch(r"bytes=(\d+)-(\d+)", self.headers.get("Range", ""))
        if asked and self.site.ranges:
            content = content[int(asked[1]) : int(asked[2]) + 1]
            if failure == "short":
                content = content[: max(1, len(content) // 2)]
            self.send_response(206)
            self.send_header("Content-Range", f"bytes {asked[1]}-{int(asked[1]) + len(content) - 1}/{size}")
        else:
            self.send_response(200)
        if failure == "endless" and body:
            self.end_headers()  # without its length
            self.close_connection = True
            with suppress(OSError):  # the client has enough
                while self.site.sent < ENDLESS_BYTES:
                    self.wfile.write(bytes(1 << 20))
                    self.site.sent += 1 << 20
            return
        self.send_header("Accept-Ranges", "bytes") if self.site.ranges else None
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        if body:
            if failure in ("cut", "reset", "stop"):
                content = content[: len(content) // 2]
                self.close_connection = True
            if failure == "reset":
                self.connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            pieces = 50 if failure == "trickle" else max(1, round(len(content) / self.site.bytes_per_s / 0.02))
            each = -(-len(content) // pieces) or 1
            with self.site.lock:  # before the reader has it, who may look
                self.site.sent += len(content)
            for start in range(0, len(content), each):
                self.wfile.write(content[start : start + each])
                if pieces > 1:
                    time.sleep(0.02)
            if failure == "stop":
                self.site.ended.wait()

    def log_message(self, format: str, *arguments: Any) -> None:  # noqa: A002 # its name in the base class
        pass


@contextmanager
def serving(folder: Path, *, ranges: bool = True) -> Iterator[Site]:
    site = Site(folder, ranges=ranges)
    handler = type("OfSite", (Handler,), {"site": site})
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        server.daemon_threads = True
        site.address = f"http://127.0.0.1:{server.server_port}/shards"
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        try:
            yield site
        finally:
            site.ended.set()
            server.shutdown()
            thread.join()
