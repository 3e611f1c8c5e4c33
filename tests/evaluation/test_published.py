"""A result among published numbers: shown where protocol and pairs are the same, with the reason where they are not."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from eldata.evaluation.published import comparison_table, shipped_published
from eldata.evaluation.results import THE_INPUT, EvaluationResult
from eldata.evaluation.scores import TableRow
from eldata.protocols import PROTOCOLS
from eldata.protocols.protocol import StatedProtocol


def row(camera: str | None, ratio: float | None, pairs: int, psnr_db: float, ssim: float) -> TableRow:
    return TableRow(camera, ratio, pairs, pairs, {"psnr_db": psnr_db, "ssim": ssim})


def result_on(
    dataset: str, protocol: str, table: list[TableRow], subset: str | None = None, **more: Any
) -> EvaluationResult:
    """A result that was read back, without its scores."""
    rules = StatedProtocol(PROTOCOLS[protocol].kind, PROTOCOLS[protocol].as_dict())
    provenance = {
        "dataset": dataset,
        "cameras": "all",
        "subset": subset,
        "excluded_flags": {},
        "protocol_digest": rules.digest,
        "manifest_sha256": "sha256:" + "a" * 64,
        "eldata": "0.2.0",
        "scenes_shared": True,
        **more,
    }
    return EvaluationResult(rules, provenance, (), tuple(table), table[-1].pairs, (), (), ())


SONY_ELD = [row("SonyA7S2", 100.0, 30, 46.0, 0.98), row("SonyA7S2", 200.0, 30, 43.0, 0.95)]
SONY_SID = [
    row("SonyA7S2", 100.0, 40, 42.5, 0.95),
    row("SonyA7S2", 250.0, 40, 40.0, 0.93),
    row("SonyA7S2", 300.0, 49, 37.0, 0.92),
    row(None, None, 129, 39.6, 0.93),
]


def compared(text: str) -> str:
    return text.partition("not compared:")[0]


def refused(text: str) -> str:
    return text.partition("not compared:")[2]


def order_in(text: str, place: str) -> list[str]:
    """Methods of one table, from its top."""
    block = text.partition(f"{place},")[2].partition("\n\n")[0]
    return [line[2:].split("  ")[0].strip() for line in block.splitlines()[3:]]


# --- where it matches ---------------------------------------------------------------------------------------------


def test_the_row_stands_where_its_psnr_puts_it() -> None:
    text = comparison_table(result_on("eld", "eld", SONY_ELD))
    order = order_in(text, "SonyA7S2 x200")
    # Wei 2021, table 3: 43.42, 42.45, 38.88, 37.98, 37.19, 35.26, 34.06; PMN's README has 43.43 for ELD.
    assert order[order.index("yours") - 2 : order.index("yours") + 2] == ["ELD", "ELD", "yours", "Paired data"]
    assert order.index("yours") < order.index("G+P") < order.index("BM3D")
    assert sum(line.startswith("> yours") for line in text.splitlines()) == 2


def test_the_same_numbers_are_under_the_protocols_that_score_alike() -> None:
    """What PMN published is under ``sid`` and ``pmn-sid``, and only the numbers with correction."""
    one = compared(comparison_table(result_on("sid-sony", "sid", SONY_SID, "eval-first")))
    other = compared(comparison_table(result_on("sid-sony", "pmn-sid", SONY_SID, "eval-first")))
    assert "PMN (TPAMI)" in order_in(one, "SonyA7S2 x300")
    assert "PMN (TPAMI)" in order_in(other, "SonyA7S2 x300")
    plain = compared(comparison_table(result_on("sid-sony", "sid-uncorrected", SONY_SID, "eval-first")))
    order = order_in(plain, "SonyA7S2 x300")
    assert order[:-2] == ["PMN", "yours", "Paired data", "SFRN", "ELD", "P-G"]
    assert order[-2:] == ["noisy input less dark shading", "noisy input"]


def test_a_mean_over_all_factors_of_the_only_camera() -> None:
    text = comparison_table(result_on("sid-sony", "sid2018", [row(None, None, 93, 28.5, 0.78)], "test-first"))
    assert order_in(text, "SonyA7S2 all factors") == ["SID", "yours"]
    assert "Which release of MATLAB" in compared(text)


# --- where it does not --------------------------------------------------------------------------------------------


def test_what_another_version_scored_otherwise_is_refused_in_words() -> None:
    """Under a name that is corrected since."""
    result = result_on("eld", "led-eld", [row("SonyA7S2", 200.0, 24, 42.0, 0.98)])
    old = StatedProtocol(result.kind, PROTOCOLS["led-eld"].as_dict() | {"rescaling_region": "scored"})
    words = "factor's region: all but 2 packed pixels at each edge against full frame"
    text = comparison_table(replace(result, protocol=old))
    assert f"your result's led-eld is not that of this version of eldata ({words}); score it again" in refused(text)
    assert "> yours" in comparison_table(result)


def test_a_protocol_of_your_own_compares_by_what_it_does() -> None:
    mine = result_on("eld", "eld", SONY_ELD)
    named = replace(mine, protocol=replace(PROTOCOLS["eld"], name="mine", title="Ours"))
    assert comparison_table(named).count("> yours") == 2
    other = replace(mine, protocol=replace(PROTOCOLS["eld"], name="mine", region="border-8"))
    assert "> yours" not in comparison_table(other)
    assert (
        "published for eld; yours is mine (region: all but 8 packed pixels at each edge against full frame)"
        in comparison_table(other)
    )


def test_levels_that_came_to_the_same_compare() -> None:
    """PMN's black level of 512 is the file's, where the files say 512; a result says whether they do."""
    levels = "published for sid; yours is pmn-sid (levels: black 512, white 16383 against white 16383, black the file"
    for equal, compares in ((["published", "sid-sony"], True), (["sid-sony"], False)):
        text = comparison_table(
            result_on("sid-sony", "pmn-sid", SONY_SID, "eval-first", equal_choices={"levels": equal})
        )
        assert ("Li et al." in compared(text)) == compares
        assert (levels in text) != compares


FEWER = [row("SonyA7S2", 100.0, 24, 46.0, 0.98)]
LOST = [SONY_ELD[0], replace(SONY_ELD[1], scored=29)]
OF_VIDEOS = "SonyRX100M6 all factors (32.73 to 37.24 dB): under no protocol"
OTHERS = "NikonD850 x100, x200; CanonEOS70D x100, x200; CanonEOS700D x100, x200 (27.52 to 42.27 dB): not in your table"
FUJI = [row("FujifilmXT2", 100.0, 41, 39.0, 0.95), row(None, None, 94, 38.0, 0.9)]
UNKNOWN = "under no protocol that is known for certain"
VIDEOS = [TableRow(None, None, 49, 49, {"psnr_db": 36.0, "ssim": 0.9, "st_rred": 0.4})]


@pytest.mark.parametrize(
    ("found", "words", "shown"),
    [
        *(
            (result_on("sid-sony", "sid", SONY_SID, name), f"published for subset eval-first; yours is {words}", 0)
            for name, words in (("test-first", "subset test-first"), (None, "no named subset"), ("all", "subset all"))
        ),
        (result_on("eld", "eld", SONY_ELD, excluded_flags={"misaligned": 0}), OTHERS, 2),
        # A group with a missing pair alone is not compared.
        (result_on("eld", "eld", LOST), "SonyA7S2 x200 (34.06 to 43.42 dB): yours has scores of 29 of 30 pairs", 1),
        # A manifest of your own may call itself eld: the number of pairs gives it away.
        (result_on("eld", "eld", FEWER), "published over 30 pairs; yours is over 24", 0),
        (result_on("eld", "eld", SONY_ELD, cameras=["SonyA7S2"]), OTHERS, 2),
        *(
            (result_on("sid-fuji", protocol, FUJI, "test-first"), f"{UNKNOWN}: which part of the frame", 0)
            for protocol in ("sid", "sid-uncorrected")
        ),
        # No published protocol of clips is certain.
        (result_on("drv-raw", "drv-raw", VIDEOS, "test", ids=None), OF_VIDEOS, 0),
    ],
)
def test_what_does_not_compare_is_refused_with_the_reason(found: EvaluationResult, words: str, shown: int) -> None:
    text = comparison_table(found)
    assert words in refused(text)
    assert text.count("> yours") == shown
    assert ("None compares with this result." in text) == (not shown)


def test_a_dataset_without_published_numbers() -> None:
    assert comparison_table(result_on("mine", "eld", SONY_ELD)) == "no published numbers on mine are known to eldata"


# --- the noisy input's own scores: what agrees, what is near, and what a difference means -----------------------------

PUBLISHED = {
    "eld": {100: (30.98, 0.4878), 200: (25.95, 0.2195)},
    "sid-sony": {100: (29.21, 0.5213), 250: (23.77, 0.3286), 300: (22.26, 0.2691)},
}
PROTOCOL = {"eld": "eld-uncorrected", "sid-sony": "sid-uncorrected"}


def of_input(
    dataset: str, moved: dict[float, tuple[float, float]] | None = None, protocol: str | None = None, **more: Any
) -> EvaluationResult:
    """A result on the Sony camera whose means are the published ones, or ``moved`` from these."""
    counts = {"eld": (30, 30), "sid-sony": (40, 40, 49)}[dataset]
    table = []
    for (ratio, published), count in zip(PUBLISHED[dataset].items(), counts, strict=True):
        means = (value + by for value, by in zip(published, (moved or {}).get(ratio, (0.0, 0.0)), strict=True))
        table.append(row("SonyA7S2", ratio, count, *means))
    subset = "eval-first" if dataset == "sid-sony" else None
    of_what: dict[str, Any] = {"cameras": ["SonyA7S2"], "predictions": THE_INPUT}
    return result_on(dataset, protocol or PROTOCOL[dataset], table, subset, **of_what | more)


def check(result: EvaluationResult) -> list[str]:
    """The lines on the noisy input, without the indentation."""
    paragraphs = [text for text in comparison_table(result).split("\n\n") if text.startswith("the noisy input")]
    return [line.strip() for text in paragraphs for line in text.splitlines()]


@pytest.mark.parametrize("dataset", PUBLISHED)
def test_the_published_figures_agree(dataset: str) -> None:
    """Each group has a sentence, and one says what follows. The numbers were read in the logs of PMN."""
    lines = check(of_input(dataset))
    assert lines == [
        "the noisy input, whose scores check files, levels, ratios and metric:",
        *(
            f"SonyA7S2 x{ratio} agrees: {psnr_db:.2f} dB and {ssim:.4f} published, yours {psnr_db:.3f} and {ssim:.5f}"
            for ratio, (psnr_db, ssim) in PUBLISHED[dataset].items()
        ),
        "so files, levels, ratios and metric are right: every mistake that was tried moves these scores more",
    ]


@pytest.mark.parametrize(
    ("moved", "words"),
    [
        ((0.0049, 0.00004), "agrees:"),
        ((0.0, 0.00009), "is near:"),
        ((0.0199, 0.00099), "is near:"),
        ((0.021, 0.0), "DOES NOT AGREE:"),
        ((0.0, -0.0011), "DOES NOT AGREE:"),
        ((float("inf"), 0.0), "DOES NOT AGREE:"),
    ],
)
def test_how_near(moved: tuple[float, float], words: str) -> None:
    """Half of the last printed digit and what float32 moves is agreement; 0.02 dB and 0.001 are near."""
    assert words in check(of_input("eld", {200: moved}))[2]


def test_one_factor_that_differs_has_wrong_files_or_a_wrong_ratio() -> None:
    lines = check(of_input("sid-sony", {300: (0.087, -0.004)}))
    assert lines[3] == (
        "SonyA7S2 x300 DOES NOT AGREE: 22.26 dB and 0.2691 published, yours 22.347 and 0.26510 (+0.087, -0.00400)"
    )
    assert lines[-1].startswith("so levels and metric are right, and of SonyA7S2 x300 the files or the ratio are not")


def test_every_factor_that_differs_is_what_they_share() -> None:
    lines = check(of_input("eld", {100: (-0.044, -0.0016), 200: (-0.044, -0.0017)}))
    assert lines[-1].startswith("so what all factors share is not as published: the levels that LibRaw states")


def test_another_protocol_names_the_one_that_has_them() -> None:
    lines = check(of_input("eld", protocol="eld"))
    assert lines[0].startswith("the noisy input: its published scores are not beside yours (published for eld-unc")
    assert lines[1:] == [
        "--protocol eld-uncorrected, over all pairs of SonyA7S2, checks files, levels, ratios and metric"
    ]


def test_without_a_published_score_nothing_is_checked() -> None:
    (line,) = check(result_on("sid-fuji", "sid", FUJI, "test-first", predictions=THE_INPUT))
    assert line == "the noisy input: no published score of it on sid-fuji is known, so this checks nothing"


def test_no_number_is_listed_twice_or_without_a_protocol_or_the_reason() -> None:
    rows = shipped_published().rows
    keys = {(row.source, row.table, row.dataset, row.camera, row.ratio, row.method) for row in rows}
    assert len(keys) == len(rows)
    assert all(row.protocols or row.note for row in rows)


def test_predictions_are_not_taken_for_the_input() -> None:
    assert check(of_input("eld", predictions="preds")) == []
