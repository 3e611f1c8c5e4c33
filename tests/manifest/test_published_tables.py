"""The published numbers that are shipped: each row against the schema, what eldata knows, and a sample read by hand."""

from __future__ import annotations

import csv
from collections import Counter
from functools import cache
from itertools import product
from typing import TYPE_CHECKING

from eldata.evaluation.published import (
    COLUMNS,
    PublishedRow,
    load_published,
    published_rows,
    shipped_published,
)
from eldata.manifest.catalogue import Manifest, shipped_folder, shipped_manifest, shipped_names
from eldata.manifest.pairs import select_pairs
from eldata.manifest.subsets import find_subset
from eldata.protocols import PROTOCOLS
from tests.cases import in_one_test

if TYPE_CHECKING:
    from pathlib import Path

ROWS = shipped_published().rows
CAMERAS = {
    "eld": {"SonyA7S2", "NikonD850", "CanonEOS70D", "CanonEOS700D"},
    "sid-sony": {"SonyA7S2"},
    "sid-fuji": {"FujifilmXT2"},
    "drv-raw": {"SonyRX100M6"},
}
RATIOS: dict[str, set[float | None]] = {
    "eld": {100, 200},
    "sid-sony": {100, 250, 300, None},
    "sid-fuji": {100, 250, 300},
    "drv-raw": {None},
}


@cache
def manifest_of(dataset: str) -> Manifest:
    return shipped_manifest(dataset)


def only(rows: tuple[PublishedRow, ...], **wanted: object) -> PublishedRow:
    (row,) = [row for row in rows if all(getattr(row, name) == value for name, value in wanted.items())]
    return row


def test_there_is_a_table_for_each_dataset_and_no_stray_file() -> None:
    folder = shipped_folder() / "published"
    assert sorted(path.name for path in folder.iterdir()) == sorted(
        [*(f"{name}.csv" for name in CAMERAS), "sources.json"]
    )
    for name in CAMERAS:
        with (folder / f"{name}.csv").open(encoding="utf-8", newline="") as file:
            reader = csv.DictReader(file)
            assert tuple(reader.fieldnames or ()) == COLUMNS
            assert {line["dataset"] for line in reader} == {name}


def test_they_do_not_pass_for_manifests() -> None:
    assert "published" not in shipped_names()
    assert not {"sources"} & set(shipped_names())


def test_the_counts() -> None:
    """Per table: cameras x factors x methods, counted by hand."""
    found = Counter((row.source, row.table, row.dataset) for row in ROWS)
    assert found == {
        ("wei2021", "2", "sid-sony"): 3 * 12,
        ("wei2021", "3", "eld"): 4 * 2 * 7,
        ("wei2021", "4", "sid-fuji"): 3 * 6,
        ("wei2021", "5", "sid-sony"): 3 * 5,
        ("wei2021", "6", "sid-sony"): 3 * 6,
        ("wei2021", "7", "drv-raw"): 6,
        ("feng2022", "corrected", "eld"): 2 * 5,
        ("feng2022", "corrected", "sid-sony"): 3 * 5,
        ("feng2022", "uncorrected", "eld"): 5,
        ("feng2022", "uncorrected", "sid-sony"): 5,
        ("feng2024", "log", "eld"): 2,
        ("feng2024", "log", "sid-sony"): 3,
        ("li2025", "1", "eld"): 2 * 7,
        ("li2025", "1", "sid-sony"): 3 * 7,
        ("jin2023", "1", "eld"): 1,
        ("chen2018", "3", "sid-sony"): 1,
        ("chen2018-retests", "issue 45", "sid-sony"): 2,
        ("chen2018-retests", "issue 52", "sid-sony"): 1,
        ("chen2018-retests", "issue 120", "sid-sony"): 1,
    }


def test_every_source_and_table_is_used() -> None:
    sources = shipped_published().sources
    assert {row.source for row in ROWS} == set(sources)
    assert {(row.source, row.table) for row in ROWS} == {
        (key, table) for key, source in sources.items() for table in source.tables
    }
    assert len({source.label for source in sources.values()}) == len(sources)


def test_each_source_says_how_it_was_computed() -> None:
    for source in shipped_published().sources.values():
        assert source.known or source.unknown
        assert source.url.startswith("https://")
        assert source.commit is None or "@" in source.commit


@in_one_test("row", ROWS)
def test_each_row_is_of_what_eldata_knows(row: PublishedRow) -> None:
    assert row.camera in CAMERAS[row.dataset]
    assert row.ratio in RATIOS[row.dataset]
    assert row.method == row.method.strip()
    assert "ours" not in row.method.lower()
    for name in row.protocols:
        protocol = PROTOCOLS[name]
        assert row.dataset == protocol.dataset or row.dataset.startswith(f"{protocol.dataset}-")
    assert 10 < row.psnr_db < 50
    assert row.ssim is None or 0.2 < row.ssim < 1
    assert (row.st_rred is not None) == (row.dataset == "drv-raw")
    assert row.st_rred is None or 0 < row.st_rred < 10


@in_one_test("row", [row for row in ROWS if row.protocols and row.dataset in shipped_names()])
def test_pairs_are_as_many_as_the_protocol_and_the_subset_give(row: PublishedRow) -> None:
    """The count that a result's has to equal, from the manifest."""
    manifest = manifest_of(row.dataset)
    for name in row.protocols:
        protocol = PROTOCOLS[name]
        assert protocol.subset in (None, row.subset), "or no result of this protocol would ever match"
        subset = None if row.subset is None else find_subset(manifest.card.subsets, row.subset)
        pairs = [
            pair
            for pair in select_pairs(manifest.records, subset=subset, cameras=[row.camera], ratios=protocol.ratios)
            if (row.ratio is None or pair.ratio == row.ratio) and pair.scene in (protocol.scenes or (pair.scene,))
        ]
        assert len(pairs) == row.pairs


def test_less_light_is_never_better() -> None:
    """A transposed column would break it: the same method at a larger factor has a lower PSNR."""
    series: dict[tuple[str, ...], list[tuple[float, float]]] = {}
    for row in ROWS:
        if row.ratio is not None:
            key = (row.source, row.table, row.dataset, row.camera, row.method)
            series.setdefault(key, []).append((row.ratio, row.psnr_db))
    assert len(series) > 60
    for method, values in series.items():
        ordered = [value for _, value in sorted(values)]
        assert ordered == sorted(ordered, reverse=True), method


# Read from the printed tables by hand, not from the files.
BY_HAND = [
    ("wei2021", "2", "sid-sony", "SonyA7S2", 100, "Paired data", 42.76, 0.948),
    ("wei2021", "2", "sid-sony", "SonyA7S2", 300, "BM3D", 30.98, 0.766),
    ("wei2021", "2", "sid-sony", "SonyA7S2", 250, "G*+P*+B", 40.44, 0.930),
    ("wei2021", "2", "sid-sony", "SonyA7S2", 300, "ELD (G*+P*+B+R+U)", 36.46, 0.916),
    ("wei2021", "3", "eld", "SonyA7S2", 200, "ELD", 43.42, 0.954),
    ("wei2021", "3", "eld", "SonyA7S2", 200, "Paired data", 42.45, 0.945),
    ("wei2021", "3", "eld", "NikonD850", 100, "Noiseflow", 40.62, 0.870),
    ("wei2021", "3", "eld", "CanonEOS70D", 200, "G+P", 37.64, 0.873),
    ("wei2021", "3", "eld", "CanonEOS700D", 100, "BM3D", 29.70, 0.556),
    ("wei2021", "4", "sid-fuji", "FujifilmXT2", 250, "ELD", 38.33, 0.937),
    ("wei2021", "5", "sid-sony", "SonyA7S2", 300, "Noiseflow (RGB2RGB)", 15.57, 0.352),
    ("wei2021", "6", "sid-sony", "SonyA7S2", 100, "ELD (Raw2RGB)", 24.65, 0.605),
    ("wei2021", "6", "sid-sony", "SonyA7S2", 250, "Paired data (Raw2Raw+ISP)", 23.49, 0.554),
    ("wei2021", "7", "drv-raw", "SonyRX100M6", None, "VBM4D", 33.29, 0.804),
    ("feng2022", "corrected", "eld", "SonyA7S2", 200, "SFRN", 44.10, 0.964),
    ("feng2022", "corrected", "sid-sony", "SonyA7S2", 300, "PMN", 37.77, 0.934),
    ("feng2022", "corrected", "sid-sony", "SonyA7S2", 100, "ELD", 41.95, 0.9530),
    ("feng2022", "uncorrected", "sid-sony", "SonyA7S2", 300, "P-G", 28.53, None),
    ("feng2022", "uncorrected", "eld", "SonyA7S2", 100, "PMN", 45.94, None),
    ("feng2024", "log", "sid-sony", "SonyA7S2", 250, "PMN (TPAMI)", 41.04, 0.9471),
    ("li2025", "1", "eld", "SonyA7S2", 100, "PNNP", 47.31, 0.9877),
    ("li2025", "1", "sid-sony", "SonyA7S2", 300, "LED", 36.67, 0.9147),
    ("jin2023", "1", "eld", "SonyA7S2", 200, "ELD", 42.54, None),
    ("chen2018", "3", "sid-sony", "SonyA7S2", None, "SID", 28.88, 0.787),
]


@in_one_test("source, table, dataset, camera, ratio, method, psnr_db, ssim", BY_HAND)
def test_a_sample_read_by_hand(
    source: str,
    table: str,
    dataset: str,
    camera: str,
    ratio: float | None,
    method: str,
    psnr_db: float,
    ssim: float | None,
) -> None:
    row = only(ROWS, source=source, table=table, dataset=dataset, camera=camera, ratio=ratio, method=method)
    assert (row.psnr_db, row.ssim) == (psnr_db, ssim)


def test_st_rred_of_the_static_clips() -> None:
    found = {row.method: row.st_rred for row in published_rows("drv-raw")}
    assert found == {
        "VBM4D": 1.568,
        "Noise2Noise": 0.773,
        "Noiseflow": 0.441,
        "Paired data": 0.369,
        "G+P": 0.467,
        "ELD": 0.407,
    }


def test_which_protocol_is_which() -> None:
    """The centre of SID at TPAMI, the whole frame at PMN, scenes 3 to 10 at LED; nothing where it is not certain."""
    assert {row.protocols for row in published_rows("sid-sony") if row.table == "2"} == {("sid-tpami",)}
    assert {row.protocols for row in published_rows("eld") if row.source == "wei2021"} == {("eld",)}
    assert {row.subset for row in published_rows("sid-sony", "sid")} == {"eval-first"}
    assert only(ROWS, source="jin2023").protocols == ("led-eld",)
    assert only(ROWS, source="chen2018").protocols == ("sid2018",)
    uncertain = {(row.source, row.table) for row in ROWS if not row.protocols}
    assert uncertain == {
        *product(["wei2021"], ["4", "5", "6", "7"]),
        *product(["chen2018-retests"], ["issue 45", "issue 52", "issue 120"]),
    }


def test_rows_by_what_they_are_of() -> None:
    rows = published_rows("eld", "eld", camera="NikonD850", ratios=[200])
    assert [row.method for row in rows] == ["BM3D", "A-BM3D", "Noise2Noise", "Paired data", "Noiseflow", "G+P", "ELD"]
    assert published_rows("sid-sony", subset="test-first") == (only(ROWS, source="chen2018"),)
    assert published_rows("sid-fuji", "sid-tpami") == ()
    assert published_rows("nowhere") == ()


def test_the_wheel_has_them_where_they_are_looked_for(tmp_path: Path) -> None:
    """A copy elsewhere reads the same: nothing depends on the checkout."""
    folder = tmp_path / "published"
    folder.mkdir()
    for path in (shipped_folder() / "published").iterdir():
        (folder / path.name).write_bytes(path.read_bytes())
    assert load_published(folder) == shipped_published()
