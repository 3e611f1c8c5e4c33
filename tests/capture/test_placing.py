from __future__ import annotations

import os
import resource
from dataclasses import replace
from pathlib import Path
from typing import Literal

import pytest

from capture.capture_errors import CaptureError
from capture.manifest import Placement, place_files
from eldata.base.files import sha256_of
from eldata.errors import EldataError
from eldata.records import FrameRecord


@pytest.fixture
def placement(tmp_path: Path) -> Placement:
    source = tmp_path / "card" / "DSC1.ARW"
    source.parent.mkdir()
    source.write_bytes(os.urandom(100_000))
    os.utime(source, (1_700_000_000, 1_700_000_000))
    record = FrameRecord("scene-1/IMG_0001.ARW", "reference", "Acme", sha256=sha256_of(source))
    return Placement(source, tmp_path / "data" / record.path, record)


@pytest.mark.parametrize("how", ["copy", "link"])
def test_placing(placement: Placement, how: Literal["copy", "link"]) -> None:
    for _ in range(2):  # again changes nothing
        place_files([placement], how)
        assert placement.target.read_bytes() == placement.path.read_bytes()
        assert [path.name for path in placement.target.parent.iterdir()] == ["IMG_0001.ARW"]
        assert placement.target.stat().st_mtime == 1_700_000_000
    assert placement.target.samefile(placement.path) == (how == "link")


@pytest.mark.parametrize("content", [5, 100_000, None])  # the second is that of what would be placed, the last a link
@pytest.mark.parametrize("how", ["copy", "link"])
def test_what_is_there_is_never_replaced(
    placement: Placement, how: Literal["copy", "link"], content: int | None
) -> None:
    """Before anything is written: the file before it stays away too."""
    placement.target.parent.mkdir(parents=True)
    if content is None:
        placement.target.symlink_to(placement.target.parent / "elsewhere")
    else:
        placement.target.write_bytes(bytes(content))
    free = replace(placement, target=placement.target.with_name("IMG_0000.ARW"))
    with pytest.raises(CaptureError, match="is there already with another content"):
        place_files([free, placement], how)
    assert [path.name for path in placement.target.parent.iterdir()] == ["IMG_0001.ARW"]
    assert placement.target.is_symlink() or placement.target.read_bytes() == bytes(content or 0)


@pytest.mark.parametrize("side", ["source", "target"])
def test_the_disk_that_fails_is_named(side: str, placement: Placement) -> None:
    """A source that the system does not let be read; a target for which it has no room."""
    if side == "source":
        with pytest.raises(OSError, match="Input/output error: '/proc/self/mem'"):
            place_files([replace(placement, path=Path("/proc/self/mem"))], "copy")
    else:
        before = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, before[1]))
        try:
            with pytest.raises(EldataError, match=r"cannot write \S*IMG_0001.ARW: File too large"):
                place_files([placement], "copy")
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert list(placement.target.parent.iterdir()) == []


def test_a_source_that_changes_is_not_placed(placement: Placement) -> None:
    placement.path.write_bytes(b"another")
    with pytest.raises(CaptureError, match="changed while it was being copied"):
        place_files([placement], "copy")
    assert list(placement.target.parent.iterdir()) == []
