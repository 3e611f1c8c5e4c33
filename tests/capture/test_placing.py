from __future__ import annotations

import os
import resource
from dataclasses import replace
from pathlib import Path

import pytest

from capture.capture_errors import MappingError
from capture.placing import Placement, check_free, copy, link
from eldata.base.files import sha256_of
from eldata.records import FrameRecord
from tests.syncing import OnDisk

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def placement(tmp_path: Path) -> Placement:
    source = tmp_path / "card" / "DSC1.ARW"
    source.parent.mkdir()
    source.write_bytes(os.urandom(100_000))
    os.utime(source, (1_700_000_000, 1_700_000_000))
    record = FrameRecord("scene-1/IMG_0001.ARW", "reference", "Acme", sha256=sha256_of(source))
    return Placement(source, tmp_path / "data" / record.path, record)


@pytest.mark.parametrize("work", [copy, link])
def test_placing(placement: Placement, work: object) -> None:
    for _ in range(2):  # again changes nothing
        (copy if work is copy else link)(placement)
        assert placement.target.read_bytes() == placement.path.read_bytes()
        assert [path.name for path in placement.target.parent.iterdir()] == ["IMG_0001.ARW"]
        assert placement.target.stat().st_mtime == 1_700_000_000
    assert placement.target.samefile(placement.path) == (work is link)


@pytest.mark.parametrize("size", [5, 100_000])  # the second is that of what would be placed
@pytest.mark.parametrize("work", [copy, link])
def test_what_is_there_is_never_replaced(placement: Placement, work: object, size: int) -> None:
    placement.target.parent.mkdir(parents=True)
    placement.target.write_bytes(bytes(size))
    with pytest.raises(MappingError, match="is there already with another content"):
        check_free([placement])
    with pytest.raises(MappingError, match="appeared meanwhile"):
        (copy if work is copy else link)(placement)
    assert placement.target.read_bytes() == bytes(size)
    assert len(list(placement.target.parent.iterdir())) == 1


def test_files_are_on_the_disk_before_they_get_their_names(
    placement: Placement, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk = OnDisk(monkeypatch)
    copy(placement)
    assert disk.named == {"IMG_0001.ARW": True}


def test_a_dangling_link_is_not_written_through(placement: Placement, tmp_path: Path) -> None:
    placement.target.parent.mkdir(parents=True)
    placement.target.symlink_to(tmp_path / "elsewhere")
    with pytest.raises(MappingError, match="is there already"):
        check_free([placement])
    with pytest.raises(MappingError, match="appeared meanwhile"):
        copy(placement)
    assert not (tmp_path / "elsewhere").exists()


@pytest.mark.parametrize("side", ["source", "target"])
def test_the_disk_that_fails_is_named(side: str, placement: Placement) -> None:
    """A source that the system does not let be read; a target for which it has no room."""
    if side == "source":
        with pytest.raises(OSError, match="Input/output error: '/proc/self/mem'"):
            copy(replace(placement, path=Path("/proc/self/mem")))
    else:
        before = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, before[1]))
        try:
            with pytest.raises(MappingError, match=r"cannot write \S*IMG_0001.ARW: File too large; .* goes on"):
                copy(placement)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert list(placement.target.parent.iterdir()) == []


def test_a_source_that_changes_is_not_placed(placement: Placement) -> None:
    placement.path.write_bytes(b"another")
    with pytest.raises(MappingError, match="changed while it was being copied"):
        copy(placement)
    assert list(placement.target.parent.iterdir()) == []


def test_without_hard_links_a_copy_is_still_whole(placement: Placement, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(self: Path, target: Path) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(Path, "hardlink_to", refuse)
    copy(placement)
    assert placement.target.read_bytes() == placement.path.read_bytes()
    placement.target.unlink()
    with pytest.raises(MappingError, match=r"cannot be a hard link .*; use --copy-to"):
        link(placement)
