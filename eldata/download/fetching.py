"""Fetching large archives, over connections that break.

Pooch's registry says what there is to fetch and which hash it has, and pooch checks that. Its own fetching would start
a broken download over and delete what has arrived, so the fetching is ours: what has arrived is kept in ``<name>.part``
and goes on by range requests, in this run or the next. ``<name>.part.json`` beside it holds what makes the bytes one
file: the address, the total size, and the server's mark for this version (a strong ETag, else Last-Modified). Without
such a mark, or when the server's file has changed, fetching starts over: two versions are never spliced.
"""

from __future__ import annotations

import os
import re
import time
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from http import HTTPStatus
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, NoReturn

from eldata import __version__
from eldata.base.fields import TextFile
from eldata.base.files import check_posix, try_lock, write_json
from eldata.download.archives import HEAD_BYTES, archive_format, looks_like
from eldata.download.card_downloads import check_room, progress_bar, size_text
from eldata.errors import DownloadError

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

    import requests
    from pooch import Pooch
    from tqdm import tqdm

_PIECE_BYTES = 2**14  # what a broken connection loses at most
_MOST_REDIRECTS = 5
_MOVE_AWAY = "move it away to fetch it again"
_PASSING = (408, 425, 429, 500, 502, 503, 504)  # time-outs, too many requests, a server in trouble
_CONTENT_RANGE = re.compile(r"bytes (\d+)-(\d+)/(\d+)")


@dataclass(frozen=True, slots=True)
class Patience:
    """How long to put up with a bad connection.

    ``tries`` in a row that bring nothing new end it; waits between them double from ``first_wait_s`` to
    ``longest_wait_s``; ``silence_s`` without a byte counts as a broken connection.
    """

    tries: int = 8
    first_wait_s: float = 1.0
    longest_wait_s: float = 60.0
    silence_s: float = 60.0

    def wait_s(self, failures: int) -> float:
        """Return how long to wait after this many failures in a row."""
        return float(min(self.longest_wait_s, self.first_wait_s * 2.0 ** min(failures - 1, 30)))


class _Broken(Exception):  # noqa: N818 # not an error yet: another try may succeed
    """A try ended before its time."""


@dataclass(frozen=True, slots=True)
class Fetcher:
    """Fetches archives over https.

    Attributes
    ----------
    patience
        How long to put up with a bad connection.
    plain_http_hosts
        Hosts that may be asked over unencrypted http; for tests against a server on this machine.
    """

    patience: Patience = Patience()
    plain_http_hosts: Collection[str] = ()

    def fetch(self, archives: Pooch, name: str, *, size_bytes: int | None = None) -> Path:
        """Return where an archive lies, complete and with the right hash; it is fetched first if it is not there.

        Parameters
        ----------
        archives, name
            Pooch's registry (see :func:`~eldata.download.card_downloads.kept_archives`) and the archive's name in it.
        size_bytes
            The archive's size, if known.

        Raises
        ------
        DownloadError
            If it cannot be fetched: the server refuses, sends something else, or cannot be reached; the disk is full;
            or the file is not the expected one. The message says what is kept and how to go on.
        """
        from pooch.hashes import file_hash, hash_matches

        target, known, address = Path(archives.path, name), archives.registry[name], archives.get_url(name)

        def found(path: Path) -> str:
            algorithm = known.rpartition(":")[0] or "sha256"
            return f"expected {known}, found {algorithm}:{file_hash(path, algorithm)}"

        try:
            if target.exists():
                if size_bytes is not None and (found_bytes := target.stat().st_size) != size_bytes:
                    raise DownloadError(f"{target}: expected {size_bytes} bytes, found {found_bytes}; {_MOVE_AWAY}")
                if not hash_matches(target, known):
                    raise DownloadError(f"{target}: {found(target)}; {_MOVE_AWAY}")
                return target
            with suppress(FileExistsError):  # not of a folder: what is opened in it says so
                target.parent.mkdir(parents=True)
            with open_partial(target) as partial:
                self._complete(address, partial, size_bytes)
                if not hash_matches(partial.path, known):
                    wrong = found(partial.path)
                    partial.discard()  # going on from it would fail again
                    raise DownloadError(f"{address}: {wrong}; the publisher has changed it: look at the homepage")
                partial.keep(target)
        except OSError as error:
            raise DownloadError(f"cannot keep {target}: {error.strerror or error}") from error
        return target

    def _complete(self, address: str, partial: Partial, size_bytes: int | None) -> None:
        """Try until all bytes are there."""
        import requests

        furthest = partial.size_bytes
        failures = 0
        with self._session() as session, progress_bar(partial.path.stem) as bar:
            while True:
                try:
                    self._try(session, address, partial, size_bytes, bar)
                except (_Broken, requests.RequestException) as error:
                    size = partial.size_bytes
                    failures = 0 if size > furthest else failures + 1
                    furthest = max(furthest, size)
                    if failures >= self.patience.tries:
                        raise DownloadError(
                            f"{address}: gave up after {failures} tries in a row that brought nothing new "
                            f"({_reason(error)}); {size_text(size)} are kept in {partial.path}, the same command goes "
                            "on from there"
                        ) from error
                    time.sleep(self.patience.wait_s(max(failures, 1)))
                else:
                    return

    def _try(
        self, session: requests.Session, address: str, partial: Partial, size_bytes: int | None, bar: tqdm[Any]
    ) -> None:
        """Ask for what is missing, once."""
        have = partial.size_bytes
        known = partial.version()
        ours = known is not None and known.address == address and size_bytes in (None, known.total_bytes)
        if known is None or not ours or not known.mark or have > known.total_bytes:
            partial.restart()
            have, known = 0, None
        if known is not None and have == known.total_bytes:
            return  # a run that ended just before its last step
        headers = {"Accept-Encoding": "identity", "User-Agent": f"eldata/{__version__}"}
        if known is not None and have:
            headers |= {"Range": f"bytes={have}-", "If-Range": known.mark}
        with self._answer(session, address, headers) as answer:
            if answer.status_code == HTTPStatus.PARTIAL_CONTENT and known is not None and have:
                _check_range(answer, partial, known, have)
            elif answer.status_code == HTTPStatus.OK:
                # We asked from the start, or the server does not support ranges, or it has another version by now.
                _check_kind(address, answer)
                known, have = Version(address, _total_of(address, answer), _mark_of(answer)), 0
                if size_bytes not in (None, known.total_bytes):
                    raise DownloadError(
                        f"{address}: expected {size_bytes} bytes, the server has {known.total_bytes}; the publisher "
                        "has changed the file: look at the homepage"
                    )
            else:
                _refuse(address, partial, answer)
            check_room(partial.path.parent, known.total_bytes - partial.size_bytes, "still to come")
            bar.total = known.total_bytes
            bar.n = have
            bar.refresh()
            _receive(answer, partial, known, have, bar)

    def _session(self) -> requests.Session:
        """Return a session that asks, and is redirected, over https alone."""
        import requests

        session = requests.Session()
        session.max_redirects = _MOST_REDIRECTS
        plain = session.adapters.pop("http://")
        for host in self.plain_http_hosts:
            session.mount(f"http://{host}:", plain)
        return session

    def _answer(self, session: requests.Session, address: str, headers: dict[str, str]) -> requests.Response:
        from requests.exceptions import InvalidSchema, TooManyRedirects

        try:
            return session.get(address, headers=headers, stream=True, timeout=(30, self.patience.silence_s))
        except InvalidSchema as error:  # it names the address
            reason = f"is, or redirects to, an address that is not encrypted (https), so nothing was fetched: {error}"
            raise DownloadError(f"{address}: {reason}") from error
        except TooManyRedirects as error:
            reason = f"redirects more than {_MOST_REDIRECTS} times; is it still valid?"
            raise DownloadError(f"{address}: {reason}") from error
        except ValueError as error:  # requests looks at the next address too
            raise DownloadError(f"{address}: is malformed, or redirects to an address that is ({error})") from error


def _check_range(answer: requests.Response, partial: Partial, known: Version, have: int) -> None:
    found = _CONTENT_RANGE.fullmatch(answer.headers.get("Content-Range", ""))
    # A server that ignores If-Range would append the new version's end to the old one's start.
    changed = _mark_of(answer) not in ("", known.mark)
    if found is None or changed or (int(found[1]), int(found[3])) != (have, known.total_bytes):
        partial.restart()
        raise _Broken("the server's file has changed, or it sends other bytes than it was asked for")


def _refuse(address: str, partial: Partial, answer: requests.Response) -> NoReturn:
    status = answer.status_code
    if status in (HTTPStatus.PARTIAL_CONTENT, HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE):
        partial.restart()
        raise _Broken(f"the server answered {status} to a request for the missing bytes")
    if status in _PASSING:
        raise _Broken(f"the server answered {status} {answer.reason}")
    advice_of: dict[int, str] = {
        HTTPStatus.UNAUTHORIZED: "it asks for a login: fetch it in a browser and use --from",
        HTTPStatus.FORBIDDEN: "the publisher does not let it be fetched (any more): look at the homepage",
        HTTPStatus.NOT_FOUND: "the publisher has moved or removed it: look at the homepage",
    }
    advice = advice_of.get(status, "look at the homepage")
    raise DownloadError(f"{address}: the server answered {status} {answer.reason}; {advice}")


def _receive(answer: requests.Response, partial: Partial, version: Version, have: int, bar: tqdm[Any]) -> None:
    """Take the bytes of an answer, which start at ``have``."""
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
            # Not earlier: a hotel's login page must not cost the gigabytes that have arrived.
            partial.restart()
            partial.note(version)
            piece = head
        if have + len(piece) > total:
            partial.restart()
            raise _Broken(f"the server sent more than the {total} bytes that it announced")
        partial.append(piece)
        have += len(piece)
        bar.update(len(piece))
    if have < total:
        raise _Broken(f"the connection ended at {have} of {total} bytes")


def _mark_of(answer: requests.Response) -> str:
    """Return what tells this version of the file from others, in the form for If-Range."""
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


def _reason(error: Exception) -> str:
    """Return the last cause in a few words: urllib3 nests three errors around 'Connection refused'."""
    text = " ".join(str(error).split())
    inner = re.findall(r"\[Errno -?\d+\] [^'\")]+|timed out|IncompleteRead\([^)]*\)", text)
    return inner[-1] if inner else text or type(error).__name__


# --- what has arrived -------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Version:
    """Which file the bytes in a ``.part`` belong to: ``mark`` is the server's ETag or Last-Modified, or empty."""

    address: str
    total_bytes: int
    mark: str


class Partial:
    """An unfinished download: ``<name>.part``, which :func:`open_partial` opens, and what it belongs to."""

    def __init__(self, target: Path, file: IO[bytes]) -> None:
        self.path, self._note = _paths(target)
        self._file = file

    @property
    def size_bytes(self) -> int:
        """How many bytes have arrived."""
        return os.fstat(self._file.fileno()).st_size

    def version(self) -> Version | None:
        """Return which file the bytes belong to, ``None`` if unknown."""
        try:
            note = TextFile(self._note, DownloadError).json()
            return Version(note.text("address"), note.whole("total_bytes"), note.text("mark", empty=True))
        except DownloadError:
            return None

    def note(self, version: Version) -> None:
        """Write down which file the bytes belong to, before the first of them."""
        write_json(self._note, asdict(version))

    def restart(self) -> None:
        """Forget what has arrived."""
        self._note.unlink(missing_ok=True)
        self._file.truncate(0)

    def append(self, piece: bytes) -> None:
        """Add bytes at the end."""
        rest = memoryview(piece)
        try:
            while rest:
                rest = rest[self._file.write(rest) :]
        except OSError as error:
            raise DownloadError(
                f"cannot write {self.path}: {error.strerror}; {size_text(self.size_bytes)} are kept there: make room "
                "and the same command goes on"
            ) from error

    def keep(self, target: Path) -> None:
        """Give the whole file its name."""
        os.fsync(self._file.fileno())
        self.path.rename(target)
        self._note.unlink(missing_ok=True)

    def discard(self) -> None:
        """Remove what has arrived."""
        self.path.unlink()
        self._note.unlink(missing_ok=True)


@contextmanager
def open_partial(target: Path) -> Iterator[Partial]:
    """Open what has arrived of a file, for one process at a time.

    Raises
    ------
    DownloadError
        If it cannot be written, or another process is fetching it.
    """
    check_posix("fetching a file")
    path, _ = _paths(target)
    try:
        file = path.open("ab", buffering=0)
    except OSError as error:
        raise DownloadError(f"cannot write {path}: {error.strerror}") from error
    with file:
        if not try_lock(path, file):
            raise DownloadError(f"{path}: another process is fetching it; wait for that one")
        yield Partial(target, file)


def _paths(target: Path) -> tuple[Path, Path]:
    return target.with_name(f"{target.name}.part"), target.with_name(f"{target.name}.part.json")
