"""Archives: unpacked whole or not at all; damaged and hostile ones are refused in one line before they do harm."""

from __future__ import annotations

import gzip
import io
import os
import stat
import struct
import zipfile
import zlib
from functools import partial
from typing import TYPE_CHECKING

import pytest

from eldata.download import archives
from eldata.download.archives import STAGING, read_members, unpack_archive
from eldata.errors import ArchiveError, ManifestError
from tests.download.helpers import contents, sevenzipped, tree, zipped

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from eldata.download.archives import Outcome

FILES = contents()
NAMES = tuple(sorted(FILES))


PACKERS: dict[str, Callable[[dict[str, bytes]], bytes]] = {
    "zip": zipped,
    "zip-stored": lambda files: zipped(files, zipfile.ZIP_STORED),
    "7z": sevenzipped,
    "7z-plain": partial(sevenzipped, encoded_header=False),
}


def save(tmp_path: Path, content: bytes) -> Path:
    """Under a name that says nothing: content counts."""
    path = tmp_path / "saved"
    path.write_bytes(content)
    return path


def unpack(path: Path, folder: Path) -> Outcome:
    members = read_members(path)
    return unpack_archive(path, members, {member.name: member.name for member in members}, folder)


def refused(path: Path, *words: str) -> None:
    folder = path.parent / "SID"
    with pytest.raises(ArchiveError) as caught:
        unpack(path, folder)
    message = str(caught.value)
    for word in (str(path), *words):
        assert word in message
    assert "\n" not in message
    assert len(message) < 1000
    assert not folder.exists()


# --- unpacking --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", PACKERS)
def test_unpacked_once_and_then_there(name: str, tmp_path: Path) -> None:
    path = save(tmp_path, PACKERS[name](FILES | {"Sony/empty": b"", "Sony/._empty": b"macOS's, passed over"}))
    names = tuple(sorted([*NAMES, "Sony/empty"]))
    assert unpack(path, tmp_path / "SID") == (names, (), ())
    assert tree(tmp_path / "SID") == FILES | {"Sony/empty": b""}
    assert sorted(path.name for path in (tmp_path / "SID").iterdir()) == ["Sony"]
    assert unpack(path, tmp_path / "SID") == ((), names, ())


@pytest.mark.parametrize("change", ["size", "folder", "link"])
def test_what_differs_is_left_alone(change: str, tmp_path: Path) -> None:
    path = save(tmp_path, zipped(FILES))
    place = tmp_path / "SID" / NAMES[2]
    place.parent.mkdir(parents=True)
    if change == "folder":
        place.mkdir()
    elif change == "link":
        place.symlink_to("nowhere")
    else:
        place.write_bytes(FILES[NAMES[2]][:-1])
    before = tree(tmp_path / "SID")
    assert unpack(path, tmp_path / "SID") == (NAMES[:2] + NAMES[3:], (), (NAMES[2],))
    after = tree(tmp_path / "SID")
    assert {path: after[path] for path in before} == before
    assert place.is_symlink() == (change == "link")


def test_a_link_that_leads_out_is_not_followed(tmp_path: Path) -> None:
    (tmp_path / "outside").mkdir()
    (tmp_path / "SID" / "Sony").mkdir(parents=True)
    (tmp_path / "SID" / "Sony" / "short").symlink_to(tmp_path / "outside")
    with pytest.raises(ManifestError, match="leads outside"):
        unpack(save(tmp_path, zipped(FILES)), tmp_path / "SID")
    assert list((tmp_path / "outside").iterdir()) == []


@pytest.mark.parametrize("name", ["zip-stored", "7z"])
def test_damage_in_the_middle_leaves_whole_files_alone(name: str, tmp_path: Path) -> None:
    files = contents(100_000)
    content = bytearray(PACKERS[name](files))
    content[len(content) * 2 // 3] ^= 1
    with pytest.raises(ArchiveError, match="damaged"):
        unpack(save(tmp_path, bytes(content)), tmp_path / "SID")
    found = {path: body for path, body in tree(tmp_path / "SID").items() if not path.startswith(STAGING)}
    assert found.items() < files.items()
    assert (tmp_path / "SID" / STAGING).is_dir()
    (tmp_path / "saved").write_bytes(PACKERS[name](files))
    unpack(tmp_path / "saved", tmp_path / "SID")
    assert tree(tmp_path / "SID") == files


# --- what is refused --------------------------------------------------------------------------------------------------


def with_mode(mode: int) -> bytes:
    info = zipfile.ZipInfo("Sony/a")
    info.external_attr = (mode | 0o777) << 16
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr(info, "/etc")
    return buffer.getvalue()


def packed_by(method: int, flags: int = 0) -> bytes:
    content = bytearray(zipped({"a": b"x"}))
    for mark, offset in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        struct.pack_into("<HH", content, content.index(mark) + offset, flags, method)
    return bytes(content)


def renamed(name: str) -> bytes:
    """A 7z archive whose member got this name of ten letters in its plain header, its checksums mended."""
    content = sevenzipped({"aa/bb/evil": b"x" * 50}, encoded_header=False)
    offset, size, _ = struct.unpack_from("<QQL", content, 12)
    header = content[32 + offset : 32 + offset + size]
    header = header.replace("aa/bb/evil".encode("utf-16le"), name.encode("utf-16le"))
    start = struct.pack("<QQL", offset, size, zlib.crc32(header))
    return content[:8] + struct.pack("<L", zlib.crc32(start)) + start + content[32 : 32 + offset] + header


OUTSIDE = ("../evil", "Sony/../../evil", "/etc/evil", "C:/evil", "..\\evil", "Sony//evil", "Sony/./evil", "Sony/e\nvil")


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"\n <!DOCTYPE html><html>Virus scan warning", ["is a web page", "download the file itself"]),
        (b"Rar!\x1a\x07\x01\x00" + b"x" * 600, ["not a zip or 7z archive", "Rar!", "by hand"]),
        (gzip.compress(b"x", mtime=0), ["not a zip or 7z archive"]),
        (b"", ["is empty (0 bytes)"]),
        (zipped({}), ["holds no file"]),
        (zipped(FILES)[:-30], ["damaged", "not finished", "not all parts joined"]),
        (packed_by(9), ["method (9)", "by hand (7z x)"]),
        (packed_by(12), ["method (12)", "by hand (7z x)"]),
        (packed_by(14), ["method (14)", "by hand (7z x)"]),
        (packed_by(8, flags=1), ["is encrypted"]),
        (with_mode(stat.S_IFLNK), ["'Sony/a'", "a link"]),
        (with_mode(stat.S_IFIFO), ["'Sony/a'", "a device"]),
        (zipped({"a1": b"x", "a2": b"y"}).replace(b"a2", b"a1"), ["would be one file"]),
        (zipped({"n/" * 30_000 + "a": b"x"}), ["more than"]),
        (zipped({"Sony/" + "n" * 300: b"x"}), ["more than 255 characters"]),
        (renamed("../../evil"), ["'..' part"]),
        (renamed("/a/bb/evil"), ["absolute"]),
        *((zipped({"Sony/good": b"x", name: b"x"}), ["by hand"]) for name in OUTSIDE),
        *(
            (zipped({first: b"x", second: b"y"}), ["would be one file", repr(first)])
            for first, second in (("a/a.ARW", "a/A.arw"), ("stra\u00dfe", "STRASSE"), ("caf\u00e9", "cafe\u0301"))
        ),
    ],
)
def test_what_is_refused(content: bytes, words: list[str], tmp_path: Path) -> None:
    refused(save(tmp_path, content), *words)


def test_what_is_no_file(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.zip")
    refused(tmp_path / "pipe.zip", "is a pipe, device or socket, not a file")
    refused(tmp_path / "none.zip", "cannot be read", "No such file")


def test_links_and_passwords_in_a_7z(tmp_path: Path) -> None:
    import py7zr

    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "a").symlink_to("/etc")
    with py7zr.SevenZipFile(tmp_path / "x", "w") as archive:
        archive.writeall(tmp_path / "in", "in")
    refused(tmp_path / "x", "'in/a'", "a link")
    for hide_names in (False, True):
        with py7zr.SevenZipFile(tmp_path / "y", "w", password="secret", header_encryption=hide_names) as archive:  # noqa: S106
            archive.writestr(b"x", "a")
        with pytest.raises(ArchiveError, match=r"[Pp]assword"):
            unpack(tmp_path / "y", tmp_path / "SID")


@pytest.mark.parametrize("name", ["zip", "7z"])
def test_a_bomb(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = save(tmp_path, PACKERS[name]({"a": bytes(2 * 2**20)}))
    assert read_members(path)  # small enough to be harmless
    monkeypatch.setattr(archives, "SURELY_HARMLESS_BYTES", 2**20)
    refused(path, "more than 100-fold", "bomb")


def test_a_member_longer_than_stated(tmp_path: Path) -> None:
    """A bomb that lies about its size: no more comes out than it stated."""
    content = bytearray(zipped({"a": b"x" * 1000}))
    struct.pack_into("<L", content, content.index(b"PK\x01\x02") + 24, 10)
    with pytest.raises(ArchiveError, match="damaged"):
        unpack(save(tmp_path, bytes(content)), tmp_path / "SID")
    assert all(path.stat().st_size <= 10 for path in (tmp_path / "SID").rglob("a"))
