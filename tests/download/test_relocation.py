from __future__ import annotations

from pathlib import Path

import pytest

from eldata.download.installing import Relocation, count_listed, find_relocation
from eldata.errors import ArchiveError
from eldata.manifest.catalogue import shipped_manifest, shipped_names
from tests.cases import in_one_test

ARCHIVE = Path("set.zip")
LISTED = ["Sony/long/00001_00_10s.ARW", "Sony/short/00001_00_0.1s.ARW", "Sony/short/00001_01_0.1s.ARW"]


@in_one_test("above", ["", "home/me/SID/"])
@in_one_test("name", shipped_names())
def test_every_shipped_manifest_recognises_its_own_files(name: str, above: str) -> None:
    listed = [record.path for record in shipped_manifest(name).records]
    names = [above + path.replace("*", "_1") for path in listed]
    relocation = find_relocation(ARCHIVE, names, listed)
    assert relocation == Relocation(above.rstrip("/"), "")
    assert [relocation.target(name) for name in names] == [path.replace("*", "_1") for path in listed]
    assert count_listed((path.replace("*", "_1") for path in listed), listed) == len(listed)


def test_the_two_halves_of_sid_are_told_apart() -> None:
    sony, fuji = ([record.path for record in shipped_manifest(f"sid-{half}").records] for half in ("sony", "fuji"))
    with pytest.raises(ArchiveError, match=r"none of its 2590 files is listed.*another dataset's archive"):
        find_relocation(ARCHIVE, fuji, sony)


def test_a_folder_less_than_expected() -> None:
    relocation = find_relocation(ARCHIVE, ["short/00001_00_0.1s.ARW", "long/00001_00_10s.ARW"], LISTED)
    assert relocation == Relocation("", "Sony")
    assert relocation.target("short/new.ARW") == "Sony/short/new.ARW"


def test_a_folder_of_another_name() -> None:
    relocation = find_relocation(ARCHIVE, ["x/Sony2025/short/00001_00_0.1s.ARW", "x/README"], LISTED)
    assert relocation == Relocation("x/Sony2025", "Sony")
    assert relocation.target("x/README") is None


def test_unlisted_files_go_with_the_listed_ones() -> None:
    names = [
        "SID/Sony/short/00001_00_0.1s.ARW",
        "SID/Sony/short/extra.ARW",
        "SID/Sony/list.txt",
        "__MACOSX/x",
        "README",
    ]
    relocation = find_relocation(ARCHIVE, names, LISTED)
    assert [relocation.target(name) for name in names] == [
        "Sony/short/00001_00_0.1s.ARW",
        "Sony/short/extra.ARW",
        "Sony/list.txt",
        None,
        None,
    ]


def test_nothing_is_guessed_where_two_places_fit() -> None:
    """The two Canons of ELD have files of the same names."""
    listed = [record.path for record in shipped_manifest("eld").records]
    with pytest.raises(ArchiveError, match=r"in 2 ways \(\. as CanonEOS700D, \. as CanonEOS70D\)"):
        find_relocation(ARCHIVE, ["scene-1/IMG_0001.CR2"], listed)


def test_two_copies_in_one_archive() -> None:
    names = ["Sony/short/00001_00_0.1s.ARW", "backup/Sony/short/00001_00_0.1s.ARW"]
    with pytest.raises(ArchiveError, match=r"in 2 ways \(\. as \., backup as \.\); unpack it by hand"):
        find_relocation(ARCHIVE, names, LISTED)


def test_an_archive_whose_content_is_not_published() -> None:
    names = ["0001/DSC1.ARW"]
    assert find_relocation(ARCHIVE, names, LISTED, "short") == Relocation("", "short")
    with pytest.raises(ArchiveError, match="none of its 1 files is listed"):
        find_relocation(ARCHIVE, names, LISTED)
    # What is listed says more.
    assert find_relocation(ARCHIVE, ["Sony/short/00001_00_0.1s.ARW"], LISTED, "short") == Relocation("", "")


def test_patterns_match_within_their_folder_only() -> None:
    listed = ["VBM4D_rawRGB/0001/*.png", "long/0001/half0001*.png"]
    names = ["DRV/VBM4D_rawRGB/0001/1.png", "DRV/long/0001/half0001.png", "DRV/long/0001/other.png", "preview.png"]
    relocation = find_relocation(ARCHIVE, names, listed)
    assert relocation == Relocation("DRV", "")
    targets = [target for name in names if (target := relocation.target(name)) is not None]
    assert count_listed(targets, listed) == 2
