"""Fetching a card's archives over connections that break: by pooch, with a downloader that goes on.

Pooch's own downloader starts over and deletes what has arrived. Here that stays in ``<name>.part`` and goes on by range
requests, in this run or the next. ``<name>.part.json`` says what makes the bytes one file: the address, the total size,
and the server's mark for this version (a strong ETag, else Last-Modified). Without such a mark, or when the server's
file has changed, fetching starts over: two versions are never spliced.
"""

from __future__ import annotations

import os
import re
import time
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import IO, TYPE_CHECKING, Any
from urllib.parse import unquote, urlsplit

from eldata import __version__
from eldata.base.fields import TextFile
from eldata.base.files import try_lock, write_json
from eldata.download.archives import FORMATS, check_room, progress_bar, size_text
from eldata.errors import ArgumentError, DownloadError
from eldata.manifest.catalogue import data_root

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    import requests
    from tqdm import tqdm

    from eldata.manifest.card import Download

_PIECE_BYTES = 2**14  # what a broken connection loses at most
_PASSING = (206, 408, 416, 425, 429, 500, 502, 503, 504)  # time-outs, too many requests, a server in trouble
_BY_HAND = "look at the homepage, or open it in a browser, save the archive and use --from"


def archive_name(address: str) -> str:
    """Return the archive's name at the end of an address, empty if there is none."""
    name = PurePosixPath(unquote(urlsplit(address).path)).name
    plain = bool(name) and name[0] not in ".-" and not any(sign in name for sign in '/\\:\0\n\r"')
    return name if plain and name.lower().endswith((".zip", ".7z")) else ""


def choose_parts(downloads: Sequence[Download], names: Collection[str]) -> tuple[Download, ...]:
    """Return the downloads that a program may fetch, one for each named part; a single part needs no name.

    Raises
    ------
    ArgumentError
        If a name is unknown, or no name is given although there are several parts; the message lists them.
    """
    parts = {one.part: one for one in reversed(downloads) if one.direct}
    known = ", ".join(sorted(parts)) or "none"
    for name in names:
        if name not in parts:
            raise ArgumentError(f"no part is called {name!r}; known are {known}")
    if not names and len(parts) > 1:
        raise ArgumentError(f"the dataset comes in several archives; name those you need with --part: {known}")
    return tuple(parts[name] for name in names or parts)


def fetch_archive(download: Download, root: Path | str | None, downloader: RangeDownloader) -> Path:
    """Fetch an archive, unless it is there; return its path, once it is complete and has the card's hash.

    It is kept in ``archives`` below the data root, where one that differs is never replaced.

    Raises
    ------
    DownloadError
        If it cannot be fetched: the server refuses, sends something else, or cannot be reached; the disk is full; or
        the file is not the expected one. The message says what is kept and how to go on.
    """
    import pooch
    from pooch.hashes import hash_matches

    name = archive_name(download.address)
    if not name:
        raise DownloadError(f"{download.address}: does not end in the name of an archive (.zip, .7z); {_BY_HAND}")
    target, size_bytes = data_root(root) / "archives" / name, download.size_bytes
    pooch.get_logger().setLevel("WARNING")  # it says what the progress bar shows
    try:
        if not target.exists():
            fetch = replace(downloader, size_bytes=size_bytes)
            pooch.retrieve(download.address, download.sha256, name, target.parent.absolute(), downloader=fetch)
        elif size_bytes not in (None, target.stat().st_size) or not hash_matches(target, download.sha256):
            stated = f"expected {size_bytes or 'any number of'} bytes and the hash {download.sha256}, as its card says"
            raise DownloadError(f"{target}: {stated}, found another file; move it away to fetch it again")
    except ValueError as error:  # pooch's, of the hash
        raise DownloadError(f"{download.address}: {error} Has it changed? Look at the homepage") from error
    except OSError as error:
        raise DownloadError(f"cannot keep {target}: {error.strerror or error}; the same command goes on") from error
    return target


@dataclass(frozen=True, slots=True)
class RangeDownloader:
    """A downloader for pooch's registries and ``retrieve``, for large archives and bad connections.

    Attributes
    ----------
    size_bytes
        The archive's size, if known; a server that states another is refused.
    tries, longest_wait_s
        So many tries in a row that bring nothing new end it; waits between them double from 1 s to this.
    silence_s
        So long without a byte counts as a broken connection.
    plain_http
        Let addresses be http, unencrypted; for tests against a server on this machine.
    """

    size_bytes: int | None = None
    tries: int = 8
    longest_wait_s: float = 60.0
    silence_s: float = 60.0
    plain_http: bool = False

    def __call__(self, url: str, output_file: str, pooch: object = None) -> None:
        """Fetch an archive into pooch's file, by way of a ``.part`` in the same folder."""
        import requests

        del pooch
        part = Path(output_file).with_name(f"{archive_name(url)}.part")
        note = part.with_suffix(".part.json")
        session = requests.Session()
        session.max_redirects = 5
        if not self.plain_http:
            del session.adapters["http://"]
        with part.open("ab") as file, session, progress_bar(part.stem) as bar:
            if try_lock(file) is False:
                raise DownloadError(f"{part}: another process is fetching it; wait for that one")
            furthest, failures = file.tell(), 0
            while True:
                try:
                    self._fetch_rest(session, url, note, file, bar)
                    break
                except (ValueError, requests.TooManyRedirects) as error:
                    reason = "is, or redirects to, an address that is not fetched (https alone, few redirects)"
                    raise DownloadError(f"{url}: {reason}: {error}") from error
                except requests.RequestException as error:
                    size = file.seek(0, os.SEEK_END)
                    failures = 0 if size > furthest else failures + 1
                    furthest = max(furthest, size)
                    if failures >= self.tries:
                        gave_up = f"gave up after {failures} tries in a row that brought nothing new ({error})"
                        kept = f"{size_text(size)} are kept in {part}, the same command goes on from there"
                        raise DownloadError(f"{url}: {gave_up}; {kept}") from error
                    time.sleep(min(self.longest_wait_s, 2.0 ** max(failures - 1, 0)))
            file.flush()
            os.fsync(file.fileno())
            part.replace(output_file)
            note.unlink(missing_ok=True)

    def _fetch_rest(self, session: requests.Session, url: str, note: Path, file: IO[bytes], bar: tqdm[Any]) -> None:
        """Ask for the missing bytes once; never take more than the server or the card announces."""
        import requests

        have, (mark, total) = file.seek(0, os.SEEK_END), _read_note(note, url)
        if not mark or have > total or self.size_bytes not in (None, total):
            have = 0
        if have and have == total:
            return  # a run that ended just before its last step
        headers = {"Accept-Encoding": "identity", "User-Agent": f"eldata/{__version__}"}
        if have:
            headers |= {"Range": f"bytes={have}-", "If-Range": mark}
        with session.get(url, headers=headers, stream=True, timeout=(30, self.silence_s)) as answer:
            if answer.status_code == 206 and have:
                sent = answer.headers.get("Content-Range", "")
                # A server that ignores If-Range would append the new version's end to the old one's start.
                if _mark_of(answer) not in ("", mark) or not re.fullmatch(rf"bytes {have}-\d+/{total}", sent):
                    note.unlink()
                    raise requests.ConnectionError("the server's file has changed, or it sends other bytes than asked")
            elif answer.status_code == 200:  # from the start, or it has no ranges, or another version by now
                length = answer.headers.get("Content-Length", "")
                if not length.isdecimal() or self.size_bytes not in (None, int(length)):
                    expected = f"expected a file of {self.size_bytes or 'a stated number of'} bytes"
                    raise DownloadError(f"{url}: {expected}, the server says {length or 'nothing'}; {_BY_HAND}")
                mark, total, have = _mark_of(answer), int(length), 0
            elif answer.status_code in _PASSING:
                if answer.status_code in (206, 416):  # not a part that was asked for
                    note.unlink(missing_ok=True)
                raise requests.ConnectionError(f"the server answered {answer.status_code} {answer.reason}")
            else:
                raise DownloadError(f"{url}: the server answered {answer.status_code} {answer.reason}; {_BY_HAND}")
            check_room(note.parent, total - have, "still to come")
            bar.total, bar.n = total, have
            for piece in answer.iter_content(_PIECE_BYTES):
                if have == 0:  # not earlier: a hotel's login page must not cost the gigabytes that have arrived
                    if not piece.startswith(tuple(FORMATS)):
                        raise DownloadError(f"{url}: sent no archive, but {piece[:64]!r}; {_BY_HAND}")
                    file.truncate(0)
                    write_json(note, {"address": url, "total_bytes": total, "mark": mark})
                if have + len(piece) > total:
                    note.unlink()
                    raise requests.ConnectionError(f"the server sent more than the {total} bytes that it announced")
                have += file.write(piece)
                bar.update(len(piece))
            if have < total:
                raise requests.ConnectionError(f"the connection ended at {have} of {total} bytes")


def _read_note(path: Path, address: str) -> tuple[str, int]:
    """Return mark and size of the file that has begun to arrive; an empty mark if that is not known."""
    try:
        note = TextFile(path, DownloadError).json()
        return note.text("mark", empty=True) if note.text("address") == address else "", note.whole("total_bytes")
    except DownloadError:
        return "", 0


def _mark_of(answer: requests.Response) -> str:
    """Return the server's mark of this version of the file, in the form for If-Range."""
    etag: str = answer.headers.get("ETag", "")
    # A weak one may stay when bytes change.
    return etag if etag and not etag.startswith("W/") else answer.headers.get("Last-Modified", "")
