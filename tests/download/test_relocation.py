from __future__ import annotations

from pathlib import Path

import pytest

from eldata.download.installing import count_listed, find_targets
from eldata.errors import ArchiveError
from eldata.manifest.catalogue import shipped_manifest, shipped_names
from eldata.manifest.patterns import as_glob, is_pattern
from tests.cases import in_one_test

ARCHIVE = Path("set.zip")
LISTED = ["Sony/long/00001_00_10s.ARW", "Sony/short/00001_00_0.1s.ARW", "Sony/short/00001_01_0.1s.ARW"]


@in_one_test("above", ["", "home/me/SID/"])
@in_one_test("name", shipped_names())
def test_every_shipped_manifest_recognises_its_own_files(name: str, above: str) -> None:
    listed = [record.path for record in shipped_manifest(name).records]
    paths = [as_glob(path).replace("*", "_1") for path in listed]
    by_name = [path for path in listed if not is_pattern(path.rpartition("/")[0])]  # folders that no text names
    if name not in ("llrvd", "pmrid"):  # of these what fits has to be unpacked by hand
        assert find_targets(ARCHIVE, [above + path for path in paths], listed) == {above + path: path for path in paths}
        assert count_listed(paths, listed) == len(by_name)


SHORT = "short/00001_00_0.1s.ARW"
DRV = ["VBM4D_rawRGB/0001/*.png", "long/0001/half0001*.png"]
MATCHING = ("VBM4D_rawRGB/0001/1.png", "long/0001/half0001.png")


@in_one_test(
    "listed, below, targets",
    [
        (LISTED, None, {path: f"Sony/{path}" for path in ("long/00001_00_10s.ARW", SHORT, "short/new.ARW")}),
        (LISTED, None, {f"x/Sony2025/{SHORT}": f"Sony/{SHORT}", "x/README": None}),  # a folder of another name
        # unlisted files go with the listed ones
        (LISTED, None, {f"SID/Sony/{path}": f"Sony/{path}" for path in (SHORT, "list.txt")} | {"__MACOSX/x": None}),
        (LISTED, "short", {"0001/DSC1.ARW": "short/0001/DSC1.ARW"}),  # what the archive holds is not published
        (LISTED, "short", {f"Sony/{SHORT}": f"Sony/{SHORT}"}),  # what is listed says more
        # patterns match within their folder only
        (DRV, None, {f"DRV/{path}": path for path in (*MATCHING, "long/0001/other.png")} | {"preview.png": None}),
    ],
)
def test_where_files_go(listed: list[str], below: str | None, targets: dict[str, str | None]) -> None:
    wanted = {name: target for name, target in targets.items() if target is not None}
    assert find_targets(ARCHIVE, list(targets), listed, below) == wanted
    if listed is DRV:
        assert count_listed(wanted.values(), listed) == 2


ELD, SONY, FUJI = ([row.path for row in shipped_manifest(name).records] for name in ("eld", "sid-sony", "sid-fuji"))


@in_one_test(
    "names, listed, said",
    [
        (FUJI, SONY, "none of its 2590 files is listed.*another dataset's archive"),
        (["0001/DSC1.ARW"], LISTED, "none of its 1 files is listed"),
        # The two Canons of ELD have files of the same names.
        (["scene-1/IMG_0001.CR2"], ELD, r"in 2 ways \(\. as CanonEOS700D, \. as CanonEOS70D\)"),
        ([LISTED[1], f"backup/{LISTED[1]}"], LISTED, r"in 2 ways \(\. as \., backup as \.\); unpack it by hand"),
    ],
)
def test_nothing_is_guessed(names: list[str], listed: list[str], said: str) -> None:
    with pytest.raises(ArchiveError, match=said):
        find_targets(ARCHIVE, names, listed)
