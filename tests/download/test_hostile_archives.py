"""Damaged and hostile archives: each is refused in one line, or read right; nothing crashes, hangs or fills memory."""

from __future__ import annotations

import os
import struct
import zipfile
from typing import TYPE_CHECKING

import pytest

from eldata.cli.main import main
from eldata.download.archives import open_archive
from eldata.download.unpacking import unpack_archive
from eldata.errors import ArchiveError, DownloadError
from tests.download.helpers import contents, tree, zipped
from tests.download.hostile import FILES, HOSTILE, SOUND, damaged_archive

if TYPE_CHECKING:
    from pathlib import Path


TRIALS = dict.fromkeys(SOUND, 60)


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
            assert all(body == FILES[name] for name, body in found.items() if name in FILES), seed
    assert not any("\n" in refusal for refusal in refusals)
    assert len(refusals) > TRIALS[kind] // 4


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


def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.zip")
    with pytest.raises(ArchiveError, match=r"pipe\.zip: is a named pipe, not a file"):
        open_archive(tmp_path / "pipe.zip")
