"""Damaged and hostile archives: each is refused in one line, or read right; nothing crashes, hangs or fills memory."""

from __future__ import annotations

import io
import multiprocessing
import os
import struct
import tarfile
import threading
import zipfile
from typing import TYPE_CHECKING

import pytest

from eldata.cli.main import main
from eldata.download import seven_zip_reader
from eldata.download.archives import open_archive
from eldata.download.tar_reader import TarReader
from eldata.download.unpacking import unpack_archive
from eldata.errors import ArchiveError, DownloadError
from tests.download.helpers import contents, noise, tree, zipped
from tests.download.hostile import FILES, HOSTILE, SOUND, damaged_archive
from tests.waiting import until

if TYPE_CHECKING:
    from pathlib import Path

# A 7z archive costs two processes.
TRIALS = {kind: 6 if kind.startswith("7z") else 60 for kind in SOUND}


def unpack_all(path: Path, folder: Path) -> dict[str, bytes]:
    archive = open_archive(path)
    unpack_archive(archive, {member.name: member.name for member in archive.files}, folder)
    return tree(folder)


@pytest.mark.parametrize("kind", SOUND)
def test_damage_anywhere_is_one_line_or_none(kind: str, tmp_path: Path) -> None:
    """Whatever the libraries raise on nonsense; and what is read without an error is right, where a CRC says so."""
    content = SOUND[kind]()
    path = tmp_path / "saved"
    refusals: list[str] = []
    for seed in range(TRIALS[kind]):
        path.write_bytes(damaged_archive(kind, content, seed))
        try:
            found = unpack_all(path, tmp_path / str(seed))
        except (ArchiveError, DownloadError) as error:
            refusals.append(str(error))
        else:
            if kind.startswith(("zip", "7z")):
                assert all(body == FILES[name] for name, body in found.items() if name in FILES), seed
    assert not any("\n" in refusal for refusal in refusals)
    assert len(refusals) > TRIALS[kind] // 4  # a plain tar's bytes have no checksum


@pytest.mark.parametrize("kind", [kind for kind in SOUND if "sparse" not in kind])
def test_without_the_damage_they_are_read(kind: str, tmp_path: Path) -> None:
    (tmp_path / "saved").write_bytes(SOUND[kind]())
    assert unpack_all(tmp_path / "saved", tmp_path / "SID")


@pytest.mark.parametrize("kind", ["sparse", "pax-sparse"])
def test_sparse_members_are_named(kind: str, tmp_path: Path) -> None:
    (tmp_path / "saved").write_bytes(SOUND[kind]())
    with pytest.raises(ArchiveError, match=r"member 'Sony/.*' is stored as a sparse file.* by hand"):
        open_archive(tmp_path / "saved")


@pytest.mark.parametrize("name", HOSTILE)
def test_archives_that_are_made_to_harm(name: str, tmp_path: Path) -> None:
    (tmp_path / "saved").write_bytes(HOSTILE[name]())
    with pytest.raises((ArchiveError, DownloadError)) as caught:
        unpack_all(tmp_path / "saved", tmp_path / "SID")
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 1000


def test_a_damaged_archive_is_not_said_to_be_standard_output(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its table of contents sends zipfile to a place before the file's beginning."""
    content = bytearray(zipped(contents(), zipfile.ZIP_STORED))
    end = content.index(b"PK\5\6")
    (place,) = struct.unpack_from("<L", content, end + 16)
    struct.pack_into("<L", content, end + 16, place + 5)
    path = tmp_path / "saved"
    path.write_bytes(content)
    assert main(["download", "sid-sony", "--from", str(path), "--root", str(tmp_path)]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"eldata download: {path}: ")
    assert "damaged" in said
    assert said.count("\n") == 1


# --- tar, by our own walk ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("form", [tarfile.USTAR_FORMAT, tarfile.GNU_FORMAT, tarfile.PAX_FORMAT])
@pytest.mark.parametrize("packed", ["", "gz", "bz2", "xz"])
def test_our_walk_over_a_tar_finds_what_tarfile_finds(form: int, packed: str, tmp_path: Path) -> None:
    """Names of every length, up to what the format can hold, and in other scripts."""
    lengths = (1, 99, 100) if form == tarfile.USTAR_FORMAT else (1, 99, 100, 101, 154, 155, 200, 254)
    names = [f"{'f' * 60}/{'n' * length}" for length in lengths] + ["Größe/ж.ARW", "a b"]
    with tarfile.open(tmp_path / "saved", f"w:{packed}", format=form) as archive:  # type: ignore[call-overload]
        archive.addfile(archive.gettarinfo(tmp_path, "folder"))
        for number, name in enumerate(names):
            info = tarfile.TarInfo(name)
            info.size = number * 300
            info.pax_headers = {"comment": "a=b\nc", "mtime": "0.5"} if form == tarfile.PAX_FORMAT else {}
            archive.addfile(info, io.BytesIO(noise(info.size, number)))
    with tarfile.open(tmp_path / "saved") as archive:
        expected = {name: archive.extractfile(name).read() for name in names}  # type: ignore[union-attr]
        listed = [(info.name, info.size) for info in archive]
    members = TarReader().members(tmp_path / "saved", 2**30)
    assert [(member.name, member.size_bytes) for member in members] == listed
    assert unpack_all(tmp_path / "saved", tmp_path / "SID") == expected


def test_a_pax_header_for_all_members(tmp_path: Path) -> None:
    """As git archive writes it."""
    path, records = tmp_path / "saved", {"comment": "c0ffee"}
    with tarfile.open(path, "w", format=tarfile.PAX_FORMAT, pax_headers=records) as archive:
        archive.addfile(tarfile.TarInfo("Sony/a"))
    assert unpack_all(path, tmp_path / "SID") == {"Sony/a": b""}


def test_a_size_that_only_a_pax_header_can_hold(tmp_path: Path) -> None:
    """Files from 8 GiB on: the header's own field is empty, and the bytes that follow are not another member."""
    path = tmp_path / "saved"
    with tarfile.open(path, "w", format=tarfile.PAX_FORMAT) as archive:
        info = tarfile.TarInfo("Sony/a")
        info.pax_headers = {"size": "700"}
        archive.addfile(info)
    content = path.read_bytes()[: 3 * 512] + b"x" * 700 + bytes(324 + 1024)
    path.write_bytes(content)
    assert unpack_all(path, tmp_path / "SID") == {"Sony/a": b"x" * 700}


# --- 7z, in a process of its own --------------------------------------------------------------------------------------


def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.zip")
    with pytest.raises(ArchiveError, match=r"pipe\.zip: is a named pipe, not a file"):
        open_archive(tmp_path / "pipe.zip")


def test_a_7z_that_nothing_comes_out_of(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its process waits for a pipe that nobody writes to."""
    others = set(multiprocessing.active_children())  # an executor's that outlives its tests
    os.mkfifo(tmp_path / "pipe")
    monkeypatch.setattr(seven_zip_reader, "_SILENCE_S", 0.1)
    with pytest.raises(ArchiveError, match="nothing came out of it"):
        seven_zip_reader.SevenZipReader().members(tmp_path / "pipe", 2**30)
    assert set(multiprocessing.active_children()) <= others


def test_a_7z_whose_process_dies(tmp_path: Path) -> None:
    others = set(multiprocessing.active_children())
    os.mkfifo(tmp_path / "pipe")

    def kill() -> None:
        until(lambda: set(multiprocessing.active_children()) - others)
        for process in set(multiprocessing.active_children()) - others:
            process.kill()

    killer = threading.Thread(target=kill)
    killer.start()
    with pytest.raises(ArchiveError, match=r"the process that unpacks it ended early \(exit code -9\)"):
        seven_zip_reader.SevenZipReader().members(tmp_path / "pipe", 2**30)
    killer.join()
