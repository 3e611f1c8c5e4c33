from __future__ import annotations

import errno
import os
import resource
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from eldata.download.archives import Archive, open_archive
from eldata.download.unpacking import STAGING, Unpacked, unpack_archive
from eldata.errors import ArchiveError, DownloadError
from tests.download.helpers import contents, noise, sevenzipped, tree, zipped
from tests.download.test_archives import PACKERS
from tests.syncing import OnDisk
from tests.waiting import PATIENCE_S, until

FILES = contents()
NAMES = tuple(sorted(FILES))


def archive_of(tmp_path: Path, content: bytes) -> Archive:
    path = tmp_path / "set.archive"
    path.write_bytes(content)
    return open_archive(path)


def unpack_all(archive: Archive, folder: Path) -> Unpacked:
    return unpack_archive(archive, {member.name: member.name for member in archive.files}, folder)


@pytest.mark.parametrize("name", PACKERS)
def test_unpacked_once_and_then_identical(name: str, tmp_path: Path) -> None:
    archive = archive_of(tmp_path, PACKERS[name](FILES))
    assert unpack_all(archive, tmp_path / "SID") == Unpacked(NAMES, (), ())
    assert tree(tmp_path / "SID") == FILES
    assert sorted(path.name for path in (tmp_path / "SID").iterdir()) == ["Sony"]
    assert unpack_all(archive, tmp_path / "SID") == Unpacked((), NAMES, ())


def test_members_are_on_the_disk_before_they_get_their_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    disk = OnDisk(monkeypatch)
    unpack_all(archive_of(tmp_path, zipped(FILES)), tmp_path / "SID")
    assert disk.named == {name.rpartition("/")[2]: True for name in NAMES}


@pytest.mark.parametrize("change", ["content", "size", "folder", "link"])
def test_what_differs_is_left_alone(change: str, tmp_path: Path) -> None:
    archive = archive_of(tmp_path, zipped(FILES))
    place = tmp_path / "SID" / NAMES[2]
    place.parent.mkdir(parents=True)
    if change == "folder":
        place.mkdir()
    elif change == "link":
        place.symlink_to("nowhere")
    else:
        place.write_bytes(FILES[NAMES[2]][:-1] + (b"" if change == "size" else b"\0"))
    before = tree(tmp_path / "SID")
    assert unpack_all(archive, tmp_path / "SID") == Unpacked(NAMES[:2] + NAMES[3:], (), (NAMES[2],))
    after = tree(tmp_path / "SID")
    assert {path: after[path] for path in before} == before
    assert place.is_symlink() == (change == "link")


@pytest.mark.parametrize("link", ["Sony", "Sony/short"])
def test_a_link_that_leads_out_is_not_followed(link: str, tmp_path: Path) -> None:
    archive = archive_of(tmp_path, zipped(FILES))
    (tmp_path / "outside").mkdir()
    place = tmp_path / "SID" / link
    place.parent.mkdir(parents=True, exist_ok=True)
    place.symlink_to(tmp_path / "outside")
    with pytest.raises(ArchiveError, match="leads outside"):
        unpack_all(archive, tmp_path / "SID")
    assert list((tmp_path / "outside").iterdir()) == []


def test_the_datasets_folder_may_be_a_link(tmp_path: Path) -> None:
    (tmp_path / "large-disk").mkdir()
    (tmp_path / "SID").symlink_to("large-disk")
    unpack_all(archive_of(tmp_path, zipped(FILES)), tmp_path / "SID")
    assert tree(tmp_path / "large-disk") == FILES


def test_a_staging_folder_that_is_a_link_is_not_followed(tmp_path: Path) -> None:
    (tmp_path / "SID").mkdir()
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "file").write_text("mine")
    (tmp_path / "SID" / STAGING).symlink_to(tmp_path / "mine")
    unpack_all(archive_of(tmp_path, zipped(FILES)), tmp_path / "SID")
    assert tree(tmp_path / "mine") == {"file": b"mine"}
    assert tree(tmp_path / "SID") == FILES


@pytest.mark.parametrize("name", ["zip-stored", "7z"])
def test_damage_in_the_middle_leaves_whole_files_alone(name: str, tmp_path: Path) -> None:
    files = contents(100_000)
    content = bytearray(PACKERS[name](files))
    content[len(content) * 2 // 3] ^= 1
    path = tmp_path / "set.archive"
    path.write_bytes(content)
    with pytest.raises(ArchiveError, match="damaged"):
        unpack_all(open_archive(path), tmp_path / "SID")
    found = tree(tmp_path / "SID")
    assert found
    assert found.items() < files.items()
    assert (tmp_path / "SID" / STAGING).is_dir()


def test_too_little_room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    archive = archive_of(tmp_path, zipped(FILES))
    monkeypatch.setattr(shutil, "disk_usage", lambda _: type("Usage", (), {"free": 18_000}))
    with pytest.raises(DownloadError, match=r"18 kB are to be unpacked, 18 kB are free; make room.*--root"):
        unpack_all(archive, tmp_path / "SID")
    assert tree(tmp_path / "SID") == {}
    (tmp_path / "SID" / "Sony" / "long").mkdir(parents=True)
    (tmp_path / "SID" / NAMES[0]).write_bytes(FILES[NAMES[0]])
    assert unpack_all(archive, tmp_path / "SID").identical == NAMES[:1]  # what is there needs no room


@pytest.mark.parametrize("pack", [zipped, sevenzipped])
def test_a_disk_that_fills_up(pack: object, tmp_path: Path) -> None:
    files = {"a": noise(1000), "b": noise(90_000, 1), "c": noise(1000, 2)}
    archive = archive_of(tmp_path, pack(files))  # type: ignore[operator]
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, limit[1]))
        with pytest.raises(DownloadError, match=r"cannot write .*/b: File too large; .* the same command goes on"):
            unpack_all(archive, tmp_path / "SID")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)
        signal.signal(signal.SIGXFSZ, ignored)
    assert tree(tmp_path / "SID") == {"a": files["a"]}
    assert unpack_all(archive, tmp_path / "SID") == Unpacked(("b", "c"), ("a",), ())


def test_no_space_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(DownloadError, match="No space left on device"):
        unpack_all(archive_of(tmp_path, zipped(FILES)), tmp_path / "SID")
    assert tree(tmp_path / "SID") == {}


# What lets a run stop in the middle of the third file, to be killed there: in whichever process writes it.
SLOW = """
import os, time
from pathlib import Path
from eldata.download import members

class Slow(members._Staged):
    begun = 0
    def __init__(self, new):
        super().__init__(new)
        Slow.begun += 1
    def write(self, piece):
        if Slow.begun == 3:
            super().write(piece[:1000])
            Path(os.environ["HALF"]).touch()
            time.sleep(600)
        return super().write(piece)

members._Staged = Slow
"""
UNPACK = """
import sys
from pathlib import Path
from eldata.download.archives import open_archive
from eldata.download.unpacking import unpack_archive

archive = open_archive(Path(sys.argv[1]))
unpack_archive(archive, {member.name: member.name for member in archive.files}, Path(sys.argv[2]))
"""


def start_and_stop_halfway(archive: Archive, folder: Path, sent: signal.Signals) -> None:
    half, slow = archive.path.with_name("half"), archive.path.with_name("slow")
    slow.mkdir()
    (slow / "sitecustomize.py").write_text(SLOW)
    environment = os.environ | {"PYTHONPATH": f"{slow}{os.pathsep}{Path.cwd()}", "HALF": str(half)}
    command = [sys.executable, "-c", UNPACK, str(archive.path), str(folder)]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, env=environment)
    try:
        until(half.exists)
        with pytest.raises(DownloadError, match="another process is unpacking there"):
            unpack_all(archive, folder)
        process.send_signal(sent)
        process.communicate(timeout=PATIENCE_S)
    finally:
        process.kill()


@pytest.mark.kill
@pytest.mark.parametrize(("sent", "name"), [(signal.SIGKILL, "7z"), (signal.SIGINT, "zip")])
def test_a_killed_run_is_gone_on_with(sent: signal.Signals, name: str, tmp_path: Path) -> None:
    archive = archive_of(tmp_path, PACKERS[name](FILES))
    folder = tmp_path / "SID"
    start_and_stop_halfway(archive, folder, sent)
    left = {path: content for path, content in tree(folder).items() if not path.startswith(STAGING)}
    assert len(left) == 2
    assert left.items() < FILES.items()
    assert (folder / STAGING).is_dir()
    again = unpack_all(archive, folder)
    assert (len(again.written), len(again.identical), again.differing) == (4, 2, ())
    assert tree(folder) == FILES
    assert not (folder / STAGING).exists()
