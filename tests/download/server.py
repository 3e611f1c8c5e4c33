"""A web server on this machine that misbehaves on request."""

from __future__ import annotations

import re
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from tests.waiting import PATIENCE_S

Behaviour = Callable[["Handler", "Site"], None]


class Site:
    """What the server holds under every path, and how it answers: one behaviour per request, the last one for good.

    ``over`` is set when the server ends: behaviours that say nothing wait for it.
    """

    def __init__(self, address: str) -> None:
        self.address = address
        self.content = b""
        self.etag = '"one"'
        self.behaviours: list[Behaviour] = [serve]
        self.requests: list[dict[str, str]] = []
        self.over = threading.Event()

    def then(self, *behaviours: Behaviour) -> None:
        self.behaviours = list(behaviours)

    @property
    def ranges(self) -> list[str | None]:
        return [request.get("range") for request in self.requests]


class Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True  # or a body waits 40 ms, until its headers have been acknowledged
    site: Site

    def do_GET(self) -> None:
        self.site.requests.append({key.lower(): value for key, value in self.headers.items()} | {"path": self.path})
        behaviours = self.site.behaviours
        (behaviours.pop(0) if len(behaviours) > 1 else behaviours[0])(self, self.site)

    def log_message(self, format: str, *arguments: Any) -> None:  # noqa: A002 # its name in the base class
        pass

    def start(self, status: int, **headers: object) -> None:
        self.send_response(status)
        for name, value in headers.items():
            if value is not None:
                self.send_header(name.replace("_", "-"), str(value))
        self.end_headers()

    def cut(self) -> None:
        """End the connection, with or without what was announced."""
        self.wfile.flush()
        self.close_connection = True


def asked_from(handler: Handler, site: Site) -> int | None:
    """First byte asked for, if a range was, and of this version."""
    found = re.fullmatch(r"bytes=(\d+)-", handler.headers.get("Range", ""))
    if found is None or handler.headers.get("If-Range") not in (None, site.etag):
        return None
    return int(found[1])


def answer(handler: Handler, site: Site, *, most: int | None = None, shift: int = 0) -> None:
    """Answer as a server should, but end after ``most`` bytes, or claim ``shift`` bytes more than there are."""
    start = asked_from(handler, site)
    total = len(site.content) + shift
    body = site.content[start or 0 :]
    headers: dict[str, object] = {"ETag": site.etag, "Content_Type": "application/zip"}
    if start is not None and start >= len(site.content):
        handler.start(416, Content_Length=0, Content_Range=f"bytes */{len(site.content)}")
        return
    if start is not None:
        headers["Content_Range"] = f"bytes {start}-{total - 1}/{total}"
    handler.start(206 if start is not None else 200, Content_Length=len(body) + shift, **headers)
    handler.wfile.write(body[:most])
    if shift or most is not None:
        handler.cut()


def serve(handler: Handler, site: Site) -> None:
    answer(handler, site)


def breaking_after(count: int) -> Behaviour:
    return lambda handler, site: answer(handler, site, most=count)


def endless(handler: Handler, site: Site) -> None:
    """Announce a length, and never stop sending."""
    handler.start(200, Content_Length=len(site.content), Transfer_Encoding="chunked", ETag=site.etag)
    piece = site.content[:5000]
    while True:
        handler.wfile.write(b"%x\r\n%s\r\n" % (len(piece), piece))


def claiming(shift: int) -> Behaviour:
    return lambda handler, site: answer(handler, site, shift=shift)


def status(code: int) -> Behaviour:
    return lambda handler, _site: handler.start(code, Content_Length=0)


def redirect(target: str) -> Behaviour:
    return lambda handler, _site: handler.start(302, Location=target, Content_Length=0)


def whole(content: bytes | None = None, most: int | None = None, **headers: object) -> Behaviour:
    """Answer without a look at the range: the content, or its first bytes and then the end of the connection."""

    def behaviour(handler: Handler, site: Site) -> None:
        body = site.content if content is None else content
        handler.start(200, **({"Content_Length": len(body), "ETag": site.etag} | headers))
        handler.wfile.write(body[:most])
        if most is not None:
            handler.cut()

    return behaviour


def silent(_handler: Handler, site: Site) -> None:
    site.over.wait(PATIENCE_S)


without_length = whole(most=1 << 30, Content_Length=None, Connection="close")
page = whole(b"<!DOCTYPE html><title>Google Drive - Virus scan warning</title>" + b" " * 2000, Content_Type="text/html")


class _Quiet(ThreadingHTTPServer):
    """Says nothing on stderr, where tests look for one line, when a client leaves in the middle of an answer."""

    daemon_threads = True

    def handle_error(self, request: object, client_address: object) -> None:
        pass


@contextmanager
def running() -> Iterator[Site]:
    """A site that is served until the end of the block."""

    class OwnHandler(Handler):
        """With a site of its own."""

    server = _Quiet(("127.0.0.1", 0), OwnHandler)
    OwnHandler.site = Site(f"http://127.0.0.1:{server.server_port}/set.zip")
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    try:
        yield OwnHandler.site
    finally:
        OwnHandler.site.over.set()
        server.shutdown()
        thread.join()
        server.server_close()
