from __future__ import annotations

import gzip
import io
import stat
import struct
import sys
import zipfile
import zlib
from typing import TYPE_CHECKING

import pytest

from eldata.download import archives
from eldata.download.archives import Archive, check_members, open_archive
from eldata.download.members import Member
from eldata.download.unpacking import unpack_archive
from eldata.errors import ArchiveError, DownloadError
from tests.cases import in_one_test
from tests.download.helpers import contents, sevenzipped, tree, zipped
from tests.download.hostile import plain_sevenzip

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

PACKERS: dict[str, Callable[[dict[str, bytes]], bytes]] = {
    "zip": zipped,
    "zip-stored": lambda files: zipped(files, zipfile.ZIP_STORED),
    "7z": sevenzipped,
}


def saved(tmp_path: Path, content: bytes) -> Path:
    """Under a name that says nothing: content counts."""
    path = tmp_path / "saved"
    path.write_bytes(content)
    return path


def refused(path: Path, *words: str) -> None:
    with pytest.raises(ArchiveError) as caught:
        read(open_archive(path))
    message = str(caught.value)
    for word in (str(path), *words):
        assert word in message
    assert "\n" not in message


def read(archive: Archive) -> dict[str, bytes]:
    """The bytes of its files; they are unpacked beside it."""
    folder = archive.path.with_name("unpacked")
    unpack_archive(archive, {member.name: member.name for member in archive.files}, folder)
    return tree(folder)


# --- what is in it ----------------------------------------------------------------------------------------------------


def test_empty_files_and_folders(tmp_path: Path) -> None:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.mkdir("Sony")
        archive.writestr("Sony/empty", b"")
    assert read(open_archive(saved(tmp_path, buffer.getvalue()))) == {"Sony/empty": b""}
    assert read(open_archive(saved(tmp_path, sevenzipped({"Sony/empty": b"", "Sony/a": b"a"})))) == {
        "Sony/empty": b"",
        "Sony/a": b"a",
    }


@in_one_test(
    "content, words",
    [
        (b"\0" * 5000, ["not a zip or 7z archive", "nothing but zeros"]),
        (b"\n <!DOCTYPE html><html>Virus scan warning", ["not a zip or 7z archive", "web page", "Google Drive"]),
        (b"Rar!\x1a\x07\x01\x00" + b"x" * 600, ["not a zip or 7z archive", "RAR", "unrar"]),
        (b"II*\x00" + b"x" * 600, ["not a zip or 7z archive", "another kind", "II*"]),
        (gzip.compress(b"x", mtime=0), ["a tar archive or a compressed file", "by hand (tar xf"]),
        (bytes(257) + b"ustar" + bytes(250), ["a tar archive"]),
        (b"", ["is empty (0 bytes)"]),
        (zipped({}), ["holds no file"]),
        (zipped(contents())[:-30], ["End-of-central-directory", "not finished", "not all parts were joined"]),
        (zipped({"a": b"x"}, zipfile.ZIP_BZIP2), ["method 12", "by hand (7z x)"]),
        (zipped({"a": b"x"}, zipfile.ZIP_LZMA), ["method 14", "by hand (7z x)"]),
        *(
            (zipped({"Sony/good": b"x", name: b"x"}), [word, "do not unpack it"])
            for name, word in (
                *(("../evil", ".."), ("Sony/../../evil", ".."), ("/etc/evil", "absolute"), ("C:/evil", "drive")),
                *(("..\\evil", "backslash"), ("Sony//evil", "empty"), ("Sony/./evil", "'.'")),
                ("Sony/e\nvil", "control character"),
            )
        ),
        *(
            (zipped({first: b"x", second: b"y"}), ["would be one file", repr(first)])
            for first, second in (("a/a.ARW", "a/A.arw"), ("stra\u00dfe", "STRASSE"), ("caf\u00e9", "cafe\u0301"))
        ),
        (zipped({"Sony": b"x", "Sony/a": b"y"}), ["is a file, and a folder of"]),
    ],
)
def test_what_is_not_a_sound_archive_is_named(content: bytes, words: list[str], tmp_path: Path) -> None:
    refused(saved(tmp_path, content), *words)


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    refused(tmp_path / "none.zip", "cannot be read", "No such file")
    refused(tmp_path, "is a folder, not a file")


def test_seven_zip_without_its_reader(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = saved(tmp_path, sevenzipped(contents()))
    monkeypatch.setitem(sys.modules, "py7zr", None)
    with pytest.raises(DownloadError, match=r"pip install 'eldata\[7z\]'.* by hand"):
        open_archive(path)


# --- what is unsafe ---------------------------------------------------------------------------------------------------


def renamed(content: bytes, old: str, new: str) -> bytes:
    """A 7z archive with a member's name changed in its plain header, and the header's checksums made right again."""
    offset, size, _ = struct.unpack_from("<QQL", content, 12)
    header = content[32 + offset : 32 + offset + size].replace(old.encode("utf-16le"), new.encode("utf-16le"))
    start = struct.pack("<QQL", offset, size, zlib.crc32(header))
    return content[:8] + struct.pack("<L", zlib.crc32(start)) + start + content[32 : 32 + offset] + header


def test_seven_zip_names_that_leave_the_folder(tmp_path: Path) -> None:
    content = plain_sevenzip({"aa/bb/evil": b"x" * 50})
    assert read(open_archive(saved(tmp_path, renamed(content, "aa/", "bb/")))) == {"bb/bb/evil": b"x" * 50}
    refused(saved(tmp_path, renamed(content, "aa/bb/evil", "../../evil")), "do not unpack it")


@pytest.mark.parametrize(("mode", "word"), [(stat.S_IFLNK, "a link"), (stat.S_IFIFO, "a device")])
def test_links_and_devices_in_a_zip(mode: int, word: str, tmp_path: Path) -> None:
    info = zipfile.ZipInfo("Sony/a")
    info.external_attr = (mode | 0o777) << 16
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr(info, "/etc")
    refused(saved(tmp_path, buffer.getvalue()), "'Sony/a'", word)


def test_links_in_a_7z(tmp_path: Path) -> None:
    import py7zr

    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "a").symlink_to("/etc")
    with py7zr.SevenZipFile(tmp_path / "x", "w") as archive:
        archive.writeall(tmp_path / "in", "in")
    refused(tmp_path / "x", "'in/a'", "a link")


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_a_name_twice(tmp_path: Path) -> None:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("a", "x")
        archive.writestr("a", "y")
    refused(saved(tmp_path, buffer.getvalue()), "would be one file")


def test_an_encrypted_zip(tmp_path: Path) -> None:
    content = bytearray(zipped({"a": b"x"}))
    for mark, offset in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        content[content.index(mark) + offset] |= 1
    refused(saved(tmp_path, bytes(content)), "encrypted")


def test_an_encrypted_7z(tmp_path: Path) -> None:
    import py7zr

    for hide_names in (False, True):
        with py7zr.SevenZipFile(tmp_path / "x", "w", password="secret", header_encryption=hide_names) as archive:  # noqa: S106
            archive.writestr(b"x", "a")
        refused(tmp_path / "x", "encrypted")


def test_a_method_that_python_does_not_know(tmp_path: Path) -> None:
    content = bytearray(zipped({"a": b"x"}))
    for mark, offset in ((b"PK\x03\x04", 8), (b"PK\x01\x02", 10)):
        struct.pack_into("<H", content, content.index(mark) + offset, 9)
    refused(saved(tmp_path, bytes(content)), "method 9", "by hand (7z x)")


# --- bombs ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["zip", "7z"])
def test_a_bomb(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = saved(tmp_path, PACKERS[name]({"a": bytes(2 * 2**20)}))
    assert open_archive(path).files  # small enough to be harmless
    monkeypatch.setattr(archives, "SURELY_HARMLESS_BYTES", 2**20)
    refused(path, "more than 100-fold", "bomb")


def test_dark_frames_are_not_a_bomb(tmp_path: Path) -> None:
    assert open_archive(saved(tmp_path, zipped({"a": bytes(10 * 2**20)}))).files[0].size_bytes == 10 * 2**20


def test_members_that_share_their_bytes(tmp_path: Path) -> None:
    """Each member is harmless by itself: https://www.bamsoftware.com/hacks/zipbomb/."""
    path = saved(tmp_path, b"x" * 1000)
    members = [Member(str(n), str(n), "file", 900, packed_bytes=900) for n in range(10)]
    with pytest.raises(ArchiveError, match=r"its members claim 9000 bytes of a file of 1000"):
        check_members(path, members)


def test_more_members_than_any_dataset(tmp_path: Path) -> None:
    path = saved(tmp_path, b"x")
    with pytest.raises(ArchiveError, match="lists 500001 members"):
        check_members(path, [Member("a", "a", "file", 0)] * 500_001)


def test_a_member_longer_than_stated(tmp_path: Path) -> None:
    content = bytearray(zipped({"a": b"x" * 1000}))
    struct.pack_into("<L", content, content.index(b"PK\x01\x02") + 24, 10)
    refused(saved(tmp_path, bytes(content)), "damaged")
