"""Fetching one large file over a connection that breaks.

What has come is kept in ``<name>.part`` and goes on by range requests, in this run or the next. ``<name>.part.json``
beside it holds what makes the bytes one file: the address, the total size, and the server's mark for this version (a
strong ETag, else Last-Modified). Without such a mark, or when the server's file has changed, fetching starts over:
two versions are never spliced.
"""

from __future__ import annotations

import re
import shutil
import time
from dataclasses import dataclass
from http import HTTPStatus
from typing import IO, TYPE_CHECKING, Any, NoReturn
from urllib.parse import urljoin, urlsplit

from tqdm import tqdm

from eldata import __version__
from eldata.base.files import sha256_of
from eldata.download.errors import DownloadError
from eldata.download.formats import HEAD_BYTES, archive_format, looks_like
from eldata.download.partial import Partial, Version
from eldata.download.sizes import size_text

if TYPE_CHECKING:
    from collections.abc import Collection
    from pathlib import Path

    import requests

_PIECE_BYTES = 2**14  # what a broken connection loses at most
_MOST_REDIRECTS = 5
_PASSING = (
    HTTPStatus.REQUEST_TIMEOUT,
    HTTPStatus.TOO_EARLY,
    HTTPStatus.TOO_MANY_REQUESTS,
    HTTPStatus.INTERNAL_SERVER_ERROR,
    HTTPStatus.BAD_GATEWAY,
    HTTPStatus.SERVICE_UNAVAILABLE,
    HTTPStatus.GATEWAY_TIMEOUT,
)
_CONTENT_RANGE = re.compile(r"bytes (\d+)-(\d+)/(\d+)")


@dataclass(frozen=True, slots=True)
class Patience:
    """How long to put up with a bad connection.

    ``tries`` in a row without a byte more than ever before end it; waits between them double from ``first_wait_s`` to
    ``longest_wait_s``; ``silence_s`` without a byte counts as a broken connection.
    """

    tries: int = 8
    first_wait_s: float = 1.0
    longest_wait_s: float = 60.0
    silence_s: float = 60.0

    def wait_s(self, failures: int) -> float:
        """Return how long to wait after so many failures in a row."""
        return float(min(self.longest_wait_s, self.first_wait_s * 2.0 ** min(failures - 1, 30)))


class _Broken(Exception):  # noqa: N818 # not an error yet: another try may help
    """A try ended before its time."""


class Fetcher:
    """Fetches files over https.

    Parameters
    ----------
    patience
        How long to put up with a bad connection.
    plain_http_hosts
        Hosts that may be asked over unencrypted http; for tests against a server on this machine.
    """

    def __init__(self, patience: Patience = Patience(), plain_http_hosts: Collection[str] = ()) -> None:
        self._patience = patience
        self._plain_http_hosts = frozenset(plain_http_hosts)

    def fetch(self, address: str, target: Path, *, size_bytes: int | None = None, sha256: str | None = None) -> Path:
        """Fetch ``address`` into the file ``target``, which appears there once it is whole.

        A ``target`` that is there is not fetched again.

        Parameters
        ----------
        size_bytes, sha256
            The file's size and ``sha256:<hex>``, if known.

        Raises
        ------
        DownloadError
            If it cannot be fetched: the server says no, sends something else, or stays unreachable; the disk is full;
            or the file is not the expected one. The message says what is kept and how to go on.
        """
        if target.exists():
            _check_expected(target, size_bytes, sha256, "move it away to fetch it again")
            return target
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise DownloadError(f"cannot make the folder {target.parent}: {error.strerror}") from error
        partial = Partial(target)
        with partial.opened() as file:
            self._complete(address, partial, file, size_bytes)
            try:
                _check_expected(partial.path, size_bytes, sha256, "the publisher has changed it, or it was damaged")
            except DownloadError:
                partial.discard()  # going on from it would end the same
                raise
            partial.path.replace(target)
            partial.discard()
        return target

    def _complete(self, address: str, partial: Partial, file: IO[bytes], size_bytes: int | None) -> None:
        """Try until all bytes are there."""
        import requests

        furthest = partial.size_of(file)
        failures = 0
        with requests.Session() as session, _progress_bar(partial.target.name) as bar:
            while True:
                try:
                    self._try(session, address, partial, file, size_bytes, bar)
                except (_Broken, requests.RequestException) as error:
                    size = partial.size_of(file)
                    failures = 0 if size > furthest else failures + 1
                    furthest = max(furthest, size)
                    if failures >= self._patience.tries:
                        raise DownloadError(
                            f"{address}: gave up after {failures} tries in a row that brought nothing new "
                            f"({_reason(error)}); {size_text(size)} are kept in {partial.path}, the same command goes "
                            "on from there"
                        ) from error
                    time.sleep(self._patience.wait_s(max(failures, 1)))
                else:
                    return

    def _try(
        self,
        session: requests.Session,
        address: str,
        partial: Partial,
        file: IO[bytes],
        size_bytes: int | None,
        bar: tqdm[Any],
    ) -> None:
        """Ask for what is missing, once."""
        have = partial.size_of(file)
        known = partial.version()
        if known is None or known.address != address or not known.mark or have > known.total_bytes:
            partial.restart(file)
            have, known = 0, None
        if known is not None and have == known.total_bytes:
            return  # a run that ended just before its last step
        headers = {"Accept-Encoding": "identity", "User-Agent": f"eldata/{__version__}"}
        if known is not None and have:
            headers |= {"Range": f"bytes={have}-", "If-Range": known.mark}
        with self._answer(session, address, headers) as answer:
            if answer.status_code == HTTPStatus.PARTIAL_CONTENT and known is not None and have:
                self._check_range(answer, partial, file, known, have)
            elif answer.status_code == HTTPStatus.OK:
                # Asked from the start, or the server knows no ranges, or has another version by now.
                _check_kind(address, answer)
                known, have = Version(address, _total_of(address, answer), _mark_of(answer)), 0
                _check_total(address, known.total_bytes, size_bytes)
            else:
                self._refuse(address, partial, file, answer)
            _check_room(partial, known.total_bytes - partial.size_of(file))
            bar.total = known.total_bytes
            bar.n = have
            bar.refresh()
            self._receive(answer, partial, file, known, have, bar)

    def _answer(self, session: requests.Session, address: str, headers: dict[str, str]) -> requests.Response:
        """Return the answer, redirections followed one by one so that none leads to an unencrypted place."""
        here = address
        for _ in range(_MOST_REDIRECTS + 1):
            self._check_address(address, here)
            answer = session.get(
                here, headers=headers, stream=True, allow_redirects=False, timeout=(30, self._patience.silence_s)
            )
            if not answer.is_redirect:
                return answer
            answer.close()
            here = urljoin(here, answer.headers["Location"])
        raise DownloadError(
            f"{address}: redirects more than {_MOST_REDIRECTS} times (last to {here}); is it still valid?"
        )

    def _check_address(self, address: str, here: str) -> None:
        parts = urlsplit(here)
        if parts.scheme == "https" or (parts.scheme == "http" and parts.hostname in self._plain_http_hosts):
            return
        what = "is" if here == address else f"redirects to {here}, which is"
        raise DownloadError(f"{address}: {what} not encrypted (https), so nothing was fetched")

    def _check_range(
        self, answer: requests.Response, partial: Partial, file: IO[bytes], known: Version, have: int
    ) -> None:
        found = _CONTENT_RANGE.fullmatch(answer.headers.get("Content-Range", ""))
        # A server that ignores If-Range would append the new version's end to the old one's start.
        changed = _mark_of(answer) not in ("", known.mark)
        if found is None or changed or (int(found[1]), int(found[3])) != (have, known.total_bytes):
            partial.restart(file)
            raise _Broken("the server's file has changed, or it answers with other bytes than asked for")

    def _refuse(self, address: str, partial: Partial, file: IO[bytes], answer: requests.Response) -> NoReturn:
        status = answer.status_code
        if status in (HTTPStatus.PARTIAL_CONTENT, HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE):
            partial.restart(file)
            raise _Broken(f"the server answered {status} to what it should have sent")
        if status in _PASSING:
            raise _Broken(f"the server answered {status} {answer.reason}")
        advice_of: dict[int, str] = {
            HTTPStatus.UNAUTHORIZED: "it asks for a login: fetch it in a browser and use --from",
            HTTPStatus.FORBIDDEN: "the publisher does not let it be fetched (any more): look at the homepage",
            HTTPStatus.NOT_FOUND: "the publisher has moved or removed it: look at the homepage",
        }
        advice = advice_of.get(status, "look at the homepage")
        raise DownloadError(f"{address}: the server answered {status} {answer.reason}; {advice}")

    def _receive(
        self, answer: requests.Response, partial: Partial, file: IO[bytes], version: Version, have: int, bar: tqdm[Any]
    ) -> None:
        """Take the bytes of an answer that start at ``have``."""
        total = version.total_bytes
        head = b""
        for arrived in answer.iter_content(_PIECE_BYTES):
            piece = arrived
            if have == 0:
                head += piece
                if len(head) < min(HEAD_BYTES, total):
                    continue
                if archive_format(head) is None:
                    raise DownloadError(
                        f"{version.address}: sent {looks_like(head)} in place of an archive; open it in a browser, "
                        "save the archive and use --from"
                    )
                # Not earlier: the login page of a hotel must not cost the gigabytes that have come.
                partial.restart(file)
                partial.note(version)
                piece = head
            if have + len(piece) > total:
                partial.restart(file)
                raise _Broken(f"the server sent more than the {total} bytes that it announced")
            partial.append(file, piece)
            have += len(piece)
            bar.update(len(piece))
        if have < total:
            raise _Broken(f"the connection ended at {have} of {total} bytes")
        partial.sync(file)


def _progress_bar(name: str) -> tqdm[Any]:
    return tqdm(desc=name, unit="B", unit_scale=True, unit_divisor=1000, disable=None, leave=False)


def _mark_of(answer: requests.Response) -> str:
    """Return what tells this version of the file from others, as If-Range takes it."""
    etag = answer.headers.get("ETag", "")
    if etag and not etag.startswith("W/"):  # a weak one may stay when bytes change
        return etag
    return answer.headers.get("Last-Modified", "")


def _total_of(address: str, answer: requests.Response) -> int:
    length = answer.headers.get("Content-Length", "")
    encoding = answer.headers.get("Content-Encoding", "identity")
    if not length.isdecimal() or encoding != "identity":
        raise DownloadError(
            f"{address}: the server does not say how long the file is, so that a broken download would look whole; "
            "fetch it in a browser and use --from"
        )
    return int(length)


def _check_kind(address: str, answer: requests.Response) -> None:
    kind = answer.headers.get("Content-Type", "").partition(";")[0].strip().lower()
    if kind in ("text/html", "application/xhtml+xml"):
        raise DownloadError(
            f"{address}: answered with a web page in place of an archive; open it in a browser, save the archive "
            "and use --from"
        )


def _check_total(address: str, total: int, size_bytes: int | None) -> None:
    if size_bytes is not None and total != size_bytes:
        raise DownloadError(
            f"{address}: expected {size_bytes} bytes, the server has {total}; the publisher has changed the file: look "
            "at the homepage"
        )


def _check_room(partial: Partial, missing: int) -> None:
    free = shutil.disk_usage(partial.path.parent).free
    if missing > free:
        raise DownloadError(
            f"{partial.path.parent}: {size_text(missing)} are still to come, {size_text(free)} are free; make room, or "
            "choose another disk with --root"
        )


def _check_expected(path: Path, size_bytes: int | None, sha256: str | None, advice: str) -> None:
    size = path.stat().st_size
    if size_bytes is not None and size != size_bytes:
        raise DownloadError(f"{path}: expected {size_bytes} bytes, found {size}; {advice}")
    if sha256 is not None and (found := sha256_of(path)) != sha256:
        raise DownloadError(f"{path}: expected {sha256}, found {found}; {advice}")


def _reason(error: Exception) -> str:
    """Return the last cause in a few words: urllib3 nests three errors around 'Connection refused'."""
    text = " ".join(str(error).split())
    inner = re.findall(r"\[Errno -?\d+\] [^'\")]+|timed out|IncompleteRead\([^)]*\)", text)
    return inner[-1] if inner else text or type(error).__name__
