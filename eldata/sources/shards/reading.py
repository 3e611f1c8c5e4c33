"""Reading shards from any place that fsspec knows, forward only, each sample checked; and checking all of a folder."""

from __future__ import annotations

import hashlib
import re
import time
import zlib
from contextlib import closing, suppress
from dataclasses import dataclass, field
from functools import cache
from typing import IO, TYPE_CHECKING, Any

from fsspec.core import url_to_fs  # type: ignore[import-untyped] # it has none

from eldata.base.numbers import checked_number
from eldata.errors import ArgumentError, DatasetError
from eldata.sources.shards.index import (
    END,
    INDEX,
    MemberError,
    ShardError,
    ShardIndex,
    StoredSample,
    from_bytes,
    key_of,
    parse_index,
)

if TYPE_CHECKING:
    from collections.abc import Generator, Iterator, Mapping, Sequence

    from fsspec import AbstractFileSystem  # type: ignore[import-untyped] # it has none

    from eldata.sources.shards.index import Shard


# --- files read forward, going on where a connection broke ------------------------------------------------------------

# What is fetched at once: as much as a few samples, so that a connection's latency does not count.
_BLOCK_BYTES = 8 << 20
_MOST_INDEX_BYTES = 256 << 20  # what the reader of text files takes
_LOCAL = ("file", "local", "memory")
_RANGE = re.compile(r"bytes=(\d+)-(\d+)")


@dataclass(frozen=True)
class Folder:
    """A folder of shards: an address as fsspec takes it, the options of its file system, and how failures are met.

    A read that fails is tried ``attempts`` times in all without any progress, first after ``wait_s`` seconds and then
    each time after twice as long. A web server of which no byte comes for ``timeout_s`` seconds has failed; one that
    sends slowly has not. The options may be secrets, and are not shown.
    """

    address: str
    options: Mapping[str, Any] = field(default_factory=dict, repr=False)
    attempts: int = 5
    wait_s: float = 0.5
    timeout_s: float = 60.0

    def __post_init__(self) -> None:
        if self.attempts < 1 or self.wait_s < 0:
            raise ArgumentError(
                f"attempts must be 1 or more and retry_wait_s 0 or more; found {self.attempts}, {self.wait_s}"
            )
        checked_number("timeout_s", self.timeout_s, above=0)

    def file_system(self) -> tuple[AbstractFileSystem, str]:
        """Return the file system and the folder's path in it; each process asks for itself.

        Raises
        ------
        ArgumentError
            If the address has a protocol that fsspec does not know, or whose package is not installed.
        """
        try:
            system, path = url_to_fs(self.address, **{**self.options, **self._web_options()})
        except (ValueError, ImportError) as error:
            raise ArgumentError(f"{self.address}: cannot be opened ({error})") from error
        return system, path.rstrip("/")

    def _web_options(self) -> dict[str, Any]:
        """Return the options that hold a web server to its time and to what it was asked for.

        aiohttp's own time is five minutes for an answer, and fsspec keeps all that a server sends for a range.
        """
        if not self.address.startswith(("http://", "https://")):
            return {}
        from aiohttp import ClientTimeout

        limit = ClientTimeout(total=None, sock_connect=self.timeout_s, sock_read=self.timeout_s)
        own = self.options.get("client_kwargs", {})
        return {"client_kwargs": {"timeout": limit, **own, "response_class": _bounded_response()}}

    def place(self, name: str) -> str:
        """Return a file's address, for people."""
        return f"{self.address.rstrip('/')}/{name}"

    def read_index(self) -> ShardIndex:
        """Return what the shards hold.

        Raises
        ------
        ShardError
            If the index is missing, cannot be read, or is not an index.
        ArgumentError
            As :meth:`file_system` does.
        """
        with closing(Forward(self, INDEX)) as file:
            content = file.read_rest(_MOST_INDEX_BYTES)
        if len(content) > _MOST_INDEX_BYTES:
            raise ShardError(self.place(INDEX), f"has more than {_MOST_INDEX_BYTES >> 20} MiB; is it an index?")
        return parse_index(self.place(INDEX), content)


@cache
def _bounded_response() -> type:
    """Return the answers that aiohttp is to give fsspec: a body longer than its request's range is an error."""
    from aiohttp import ClientPayloadError, ClientResponse

    class BoundedResponse(ClientResponse):
        async def read(self) -> bytes:
            asked = _RANGE.fullmatch(self.request_info.headers.get("Range", ""))
            most = int(asked[2]) + 1 - int(asked[1]) if asked else _MOST_INDEX_BYTES
            content = bytearray()
            async for piece in self.content.iter_any():
                content += piece
                if len(content) > most:
                    self.close()  # what is still to come is not waited for
                    raise ClientPayloadError(f"the server sent more than the {most} bytes that it was asked for")
            return bytes(content)

    return BoundedResponse


class Forward:
    """One file, read forward; :meth:`read` gives exactly what was asked for, or an error."""

    def __init__(self, folder: Folder, name: str) -> None:
        self.place = folder.place(name)
        self._folder = folder
        self._system, path = folder.file_system()
        self._path = f"{path}/{name}"
        self._at = 0  # the byte that is next
        self._file_at = 0
        self._file: IO[bytes] | None = None
        self._has_ranges = True
        protocol = self._system.protocol
        self._is_local = bool({protocol, *protocol} & set(_LOCAL)) if protocol else False

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            with suppress(Exception):  # nothing is lost with it
                self._file.close()
            self._file = None

    def go_to(self, place: int) -> None:
        """Go on at a later byte; what lies between is not fetched where a file can be read from any byte on."""
        self._at = place

    def read(self, count: int) -> bytes:
        """Return the next ``count`` bytes.

        Raises
        ------
        ShardError
            If the file is missing, ends before, or cannot be read although it was tried several times.
        """
        pieces = []
        while count > 0:
            piece = self._piece(count)
            if not piece:
                raise ShardError(
                    self.place, f"is truncated: it ends at byte {self._at}, {count} bytes too early; copy it again"
                )
            pieces.append(piece)
            count -= len(piece)
        return b"".join(pieces)

    def read_rest(self, most: int) -> bytes:
        """Return the rest, of more than ``most`` bytes one more: an address could go on sending for ever.

        Raises
        ------
        ShardError
            Like :meth:`read`.
        """
        pieces, left = [], most + 1
        while left and (piece := self._piece(min(left, _BLOCK_BYTES))):
            pieces.append(piece)
            left -= len(piece)
        return b"".join(pieces)

    def _piece(self, most: int) -> bytes:
        """Return some bytes, none at the end."""
        wait_s = self._folder.wait_s
        attempt = 1
        while True:
            try:
                piece = self._opened().read(most)
            except ValueError as error:  # fsspec's, of a web server that knows no ranges
                self.close()
                if self._is_local or not self._has_ranges:
                    raise ShardError(self.place, f"cannot be read ({error})") from error
                self._has_ranges = False
                continue
            except Exception as error:  # each file system of fsspec raises what its own library does
                self.close()
                if self._is_local or _is_final(error) or attempt == self._folder.attempts:
                    tried = f" after {attempt} attempts" if attempt > 1 else ""
                    raise ShardError(self.place, f"cannot be read{tried} {self._reason(error)}") from error
            else:
                self._at += len(piece)
                self._file_at = self._at
                return piece
            time.sleep(wait_s)
            wait_s *= 2
            attempt += 1

    def _reason(self, error: BaseException) -> str:
        """Return what failed, and what to do."""
        # Of any failure to learn a file's size, fsspec makes a FileNotFoundError with its cause.
        cause = error if error.__cause__ is None else error.__cause__
        if isinstance(cause, TimeoutError) and not self._is_local:
            limit = self._folder.timeout_s
            return f"(no byte came for {limit:g} s); is the server up? timeout_s says how long it is waited for"
        said = f"{type(error).__name__}: {error}".rstrip(": ")
        return f"({said}); is the address right?"

    def _opened(self) -> IO[bytes]:
        """Return the file at the byte that is next."""
        if self._file is None:
            block_bytes = _BLOCK_BYTES if self._has_ranges else 0  # 0: fsspec streams from the first byte on
            self._file = self._system.open(self._path, "rb", block_size=block_bytes)
            self._file_at = 0
        file: IO[bytes] = self._file
        if self._file_at < self._at and self._has_ranges:
            with suppress(ValueError):  # a stream that cannot seek: what comes before is read and dropped
                self._file_at = file.seek(self._at)
        while dropped := file.read(min(self._at - self._file_at, _BLOCK_BYTES)) if self._file_at < self._at else b"":
            self._file_at += len(dropped)  # at the end the next read says so
        return file


def _is_final(error: BaseException) -> bool:
    """Return whether another attempt would end the same: a file that is not there, or not available."""
    cause = error if error.__cause__ is None else error.__cause__
    # aiohttp's errors have the server's answer as `status`, those of httpx have it as `response`.
    status = getattr(cause, "status", None) or getattr(getattr(cause, "response", None), "status_code", None)
    if status is not None:
        return status in (401, 403, 404, 410)
    return isinstance(cause, (FileNotFoundError, PermissionError, IsADirectoryError, NotADirectoryError))


def read_samples(
    folder: Folder, index: ShardIndex, shard_number: int, numbers: Sequence[int]
) -> Generator[StoredSample]:
    """Yield samples of a shard by their rising places in it, one in memory at a time; those between are passed over.

    Raises
    ------
    ShardError
        If the shard is missing, truncated or damaged, or holds anything but samples; the message says where.
    """
    shard = index.shards[shard_number]
    with closing(Forward(folder, shard.name)) as file:
        for _, sample in _each(file, shard, numbers):
            yield sample


def _each(file: Forward, shard: Shard, numbers: Sequence[int]) -> Iterator[tuple[bytes, StoredSample]]:
    """Yield samples of an open shard, and the bytes that they are."""
    starts = shard.starts.tolist()
    for number in numbers:
        file.go_to(starts[number])
        where = f"sample {number} (bytes {starts[number]} to {starts[number + 1]})"
        content = file.read(int(shard.sample_bytes[number]))
        yield content, _checked_sample(file.place, where, content, int(shard.crc32[number]))


def _checked_sample(place: str, where: str, content: bytes, crc32: int) -> StoredSample:
    """Return the sample that bytes of a shard are, if their checksum is that of the index.

    Raises
    ------
    ShardError
        If it is not, or they are not a sample.
    """
    if zlib.crc32(content) != crc32:
        # What it holds instead often says more than that it differs.
        problem = "its checksum is not that of the index"
        try:
            problem = f"{problem}, although it reads as sample {key_of(from_bytes(content).number)}"
        except MemberError as error:
            problem = f"{problem}: {error}"
        raise ShardError(place, f"{where} is damaged or of other shards: {problem}; copy it again")
    try:
        return from_bytes(content)
    except MemberError as error:
        raise ShardError(place, f"{where} is not a sample: {error}") from error


def verify_shards(address: str, *, storage_options: Mapping[str, Any] | None = None) -> list[str]:
    """Read all shards and return what is wrong with them, one line per shard; nothing if all is well.

    Raises
    ------
    ShardError
        If there is no index, or none that can be read.
    ArgumentError
        If fsspec cannot open the address.
    """
    folder = Folder(str(address), storage_options or {})
    index = folder.read_index()
    problems = []
    numbers: set[int] = set()
    for shard in index.shards:
        try:
            numbers |= _checked(folder, shard)
        except (ShardError, DatasetError) as error:
            problems.append(str(error))
    if not problems and numbers != set(range(len(index))):
        problems.append(f"{folder.address}: its {len(index)} samples are not numbered from 0, each once")
    return problems


def _checked(folder: Folder, shard: Shard) -> set[int]:
    """Return the numbers of a shard's samples."""
    digest = hashlib.sha256()
    numbers = set()
    with closing(Forward(folder, shard.name)) as file:
        for content, sample in _each(file, shard, range(len(shard))):
            digest.update(content)
            numbers.add(sample.number)
        end = file.read_rest(len(END))
        if end != END:
            raise ShardError(file.place, f"does not end after its {len(shard)} samples; copy it again")
        digest.update(end)
        if f"sha256:{digest.hexdigest()}" != shard.sha256:
            raise ShardError(file.place, f"expected {shard.sha256}, found sha256:{digest.hexdigest()}; copy it again")
    return numbers
