"""The published numbers that are shipped: each row against the schema, what eldata knows, and a sample read by hand."""

from __future__ import annotations

from functools import cache
from itertools import product

from eldata.evaluation.published import PublishedRow, published_rows, shipped_published
from eldata.manifest.catalogue import shipped_manifest, shipped_names
from eldata.manifest.pairs import Choice
from eldata.protocols import PROTOCOLS
from eldata.records import PairRecord
from tests.cases import in_one_test

ROWS = shipped_published().rows
CAMERAS = {"SonyA7S2", "NikonD850", "CanonEOS70D", "CanonEOS700D", "FujifilmXT2", "SonyRX100M6"}
CLIPS = {"drv-raw", "eld-dynamic"}


@cache
def chosen_pairs(dataset: str, subset: str | None, camera: str, ratios: tuple[float, ...]) -> tuple[PairRecord, ...]:
    manifest = shipped_manifest(dataset)
    return Choice(subset=subset, cameras=[camera], ratios=ratios).pairs(manifest.records, manifest.card.subsets)


def only(rows: tuple[PublishedRow, ...], **wanted: object) -> PublishedRow:
    (row,) = [row for row in rows if all(getattr(row, name) == value for name, value in wanted.items())]
    return row


# Averages over the factors as the tables print them: PSNR and SSIM of ELD Sony (60 pairs), then of SID Sony (129).
AVERAGES = [
    ("feng2024", "results", "noisy input", (28.38, 0.3826), (24.81, 0.3793)),
    ("feng2024", "results", "P-G", (40.12, 0.8274), (34.52, 0.7666)),
    ("feng2024", "results", "SFRN", (45.38, 0.9722), (39.82, 0.9349)),
    ("feng2022", "log ELD", "ELD", (44.44, 0.9649), (39.05, 0.9303)),
    ("feng2022", "log Paired", "Paired data", (43.22, 0.9479), (39.32, 0.9374)),
    ("feng2024", "log", "PMN (TPAMI)", (45.92, 0.9763), (40.59, 0.9465)),
    ("feng2023", "results", "NoiseFlow", (41.90, 0.8924), (37.09, 0.8750)),
    ("feng2023", "results", "Starlight", (42.33, 0.9098), (36.33, 0.8494)),
    ("feng2023", "results", "LLD", (44.93, 0.9712), (39.56, 0.9348)),
    ("feng2023", "results", "LRD", (45.04, 0.9753), (40.24, 0.9378)),
    ("feng2023", "results", "PNNP", (46.39, 0.9834), (40.83, 0.9479)),
    ("li2025", "1", "LLD", (45.85, 0.9815), (40.52, 0.9471)),
    ("li2025", "1", "SFRN", (45.51, 0.9790), (40.14, 0.9438)),
    ("li2025", "1", "Li et al.", (46.43, 0.9834), (40.85, 0.9478)),
]


@in_one_test("source, table, method, on_eld, on_sid", AVERAGES)
def test_the_rows_average_to_what_their_table_prints(
    source: str, table: str, method: str, on_eld: tuple[float, float], on_sid: tuple[float, float]
) -> None:
    """A check of every digit that was read from an image, and of the number of pairs behind each factor.

    Each row is rounded to half of its last digit and so is the average, so they differ by one whole last digit at most.
    """
    for dataset, printed in (("eld", on_eld), ("sid-sony", on_sid)):
        rows = [
            row for row in published_rows(dataset) if (row.source, row.table, row.method) == (source, table, method)
        ]
        counts = [row.pairs or 0 for row in rows]
        assert sum(counts) == {"eld": 60, "sid-sony": 129}[dataset]
        for values, average, last_digit in zip(
            ([row.psnr_db for row in rows], [row.ssim or 0.0 for row in rows]), printed, (0.01, 0.0001), strict=True
        ):
            mean = sum(count * value for count, value in zip(counts, values, strict=True)) / sum(counts)
            assert abs(mean - average) <= 1.001 * last_digit


def test_the_readme_of_pmn_and_its_logs() -> None:
    """They agree to the digits that the README prints but in two places, and there the row says so."""
    logs = {"ELD": "log ELD", "Paired data": "log Paired", "PMN": "log PMN"}
    apart = set()
    readme = [row for row in ROWS if (row.source, row.table) == ("feng2022", "corrected") and row.method in logs]
    assert len(readme) == 3 * 5
    for row in readme:
        same = {"dataset": row.dataset, "ratio": row.ratio, "method": row.method}
        log = only(ROWS, source="feng2022", table=logs[row.method], **same)
        assert row.psnr_db == log.psnr_db
        assert row.ssim is not None and log.ssim is not None  # noqa: PT018 # for mypy
        if abs(row.ssim - log.ssim) > 0.0005 + 1e-9:
            apart.add((row.method, row.dataset, row.ratio, row.ssim, log.ssim))
            assert f"{log.ssim:.4f}" in row.note
    assert apart == {("ELD", "sid-sony", 100, 0.963, 0.953), ("PMN", "eld", 200, 0.973, 0.9708)}


def test_every_source_and_table_is_used() -> None:
    sources = shipped_published().sources
    assert {row.source for row in ROWS} == set(sources)
    assert {(row.source, row.table) for row in ROWS} == {
        (key, table) for key, source in sources.items() for table in source.tables
    }
    assert len({source.label for source in sources.values()}) == len(sources)


@in_one_test("row", ROWS)
def test_each_row_is_of_what_eldata_knows(row: PublishedRow) -> None:
    assert row.camera in CAMERAS
    assert row.ratio in {None, 100, 200, 250, 300}
    assert row.method == row.method.strip()
    assert "ours" not in row.method.lower()
    for name in row.protocols:
        protocol = PROTOCOLS[name]
        assert row.dataset == protocol.dataset or row.dataset.startswith(f"{protocol.dataset}-")
    assert 10 < row.psnr_db < 50
    assert row.ssim is None or 0.2 < row.ssim < 1
    assert (row.st_rred is not None) == (row.dataset in CLIPS)
    assert row.st_rred is None or 0 < row.st_rred < 10


@in_one_test("row", [row for row in ROWS if row.protocols and row.dataset in shipped_names()])
def test_pairs_are_as_many_as_the_protocol_and_the_subset_give(row: PublishedRow) -> None:
    """The count that a result's has to equal, from the manifest."""
    for name in row.protocols:
        protocol = PROTOCOLS[name]
        assert protocol.subset in (None, row.subset), "or no result of this protocol would ever match"
        chosen = chosen_pairs(row.dataset, row.subset, row.camera, protocol.ratios)
        pairs = [
            pair
            for pair in chosen
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
    ("wei2021", "3", "eld", "SonyA7S2", 200, "ELD", 43.42, 0.954),
    ("wei2021", "3", "eld", "NikonD850", 100, "Noiseflow", 40.62, 0.870),
    ("wei2021", "3", "eld", "CanonEOS700D", 100, "BM3D", 29.70, 0.556),
    ("wei2021", "5", "sid-sony", "SonyA7S2", 300, "Noiseflow (RGB2RGB)", 15.57, 0.352),
    ("wei2021", "6", "sid-sony", "SonyA7S2", 250, "Paired data (Raw2Raw+ISP)", 23.49, 0.554),
    ("feng2022", "corrected", "eld", "SonyA7S2", 200, "SFRN", 44.10, 0.964),
    ("feng2022", "uncorrected", "sid-sony", "SonyA7S2", 300, "P-G", 28.53, 0.667),
    ("feng2022", "uncorrected", "eld", "SonyA7S2", 100, "PMN", 45.94, 0.984),
    ("feng2022", "log PMN", "sid-sony", "SonyA7S2", 300, "PMN", 37.77, 0.9341),
    ("wang2023", "4", "sid-sony", "SonyA7S2", 300, "PMN + ExposureDiffusion", 37.27, 0.888),
    ("wei2021", "8", "eld-dynamic", "SonyRX100M6", None, "FastDVDnet, ELD on dynamic clips", 37.48, 0.940),
    ("jin2023", "1", "eld", "SonyA7S2", 200, "ELD", 42.54, None),
    ("chen2018", "3", "sid-sony", "SonyA7S2", None, "SID", 28.88, 0.787),
]


def test_a_sample_read_by_hand() -> None:
    names = ("source", "table", "dataset", "camera", "ratio", "method")
    for *values, psnr_db, ssim in BY_HAND:
        row = only(ROWS, **dict(zip(names, values, strict=True)))
        assert (row.psnr_db, row.ssim) == (psnr_db, ssim), values


def test_st_rred() -> None:
    assert [row.st_rred for row in published_rows("drv-raw")] == [1.568, 0.773, 0.441, 0.369, 0.467, 0.407]
    assert [row.st_rred for row in published_rows("eld-dynamic")] == [0.482, 0.230, 5.746, 5.373, 0.224]


def test_which_protocol_is_which() -> None:
    """The centre of SID at TPAMI, the whole frame at PMN, scenes 3 to 10 at LED; nothing where it is not certain."""
    assert {row.protocols for row in published_rows("sid-sony") if row.table == "2"} == {("sid-tpami",)}
    assert {row.protocols for row in published_rows("eld") if row.source == "wei2021"} == {("eld",)}
    assert {row.subset for row in published_rows("sid-sony", "sid")} == {"eval-first"}
    assert [row.protocols for row in ROWS if row.source == "jin2023"] == [("led-eld",), ("led-sid",)]
    assert {(row.protocols, row.subset) for row in ROWS if row.source == "wang2023"} == {(("eld-cvpr20",), "indoor-15")}
    assert only(ROWS, source="chen2018").protocols == ("sid2018",)
    uncertain = {(row.source, row.table) for row in ROWS if not row.protocols}
    whole = {
        *product(["wei2021"], ["4", "5", "6", "7", "8"]),
        *product(["chen2018-retests"], ["issue 45", "issue 52", "issue 120"]),
    }
    assert uncertain == {*whole, ("feng2024", "results"), ("feng2023", "results"), ("li2025", "1")}
