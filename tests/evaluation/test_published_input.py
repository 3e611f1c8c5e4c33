"""The noisy input's own scores beside the published ones: what agrees, what is near, and what a difference means."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from skimage.metrics import structural_similarity

from eldata.evaluation.published import _NEAR, comparison_table
from eldata.evaluation.published.tables import NOISY_INPUT, published_rows
from eldata.evaluation.results import THE_INPUT, EvaluationResult
from eldata.evaluation.scores import UnitScore
from eldata.manifest.catalogue import shipped_manifest
from eldata.manifest.pairs import select_pairs
from eldata.protocols import PROTOCOLS

if TYPE_CHECKING:
    from numpy.typing import NDArray

PUBLISHED = {
    "eld": {100: (30.98, 0.4878), 200: (25.95, 0.2195)},
    "sid-sony": {100: (29.21, 0.5213), 250: (23.77, 0.3286), 300: (22.26, 0.2691)},
}
PROTOCOL = {"eld": "eld-uncorrected", "sid-sony": "sid-uncorrected"}


def of_input(
    dataset: str,
    moved: dict[float, tuple[float, float]] | None = None,
    protocol: str | None = None,
    predictions: str = THE_INPUT,
    skip: int = 0,
) -> EvaluationResult:
    """A result over the shipped pairs of the Sony camera whose means are the published ones, or ``moved`` from these.

    Images differ by 2 dB and 0.02, so that no image has the mean itself. ``skip`` leaves out images at x100.
    """
    rules = PROTOCOLS[protocol or PROTOCOL[dataset]]
    manifest = shipped_manifest(dataset)
    subset = rules.subset or ("eval-first" if dataset == "sid-sony" else None)
    pairs = [
        pair
        for pair in select_pairs(manifest.records, manifest.card.subsets, ratios=rules.ratios, subset=subset)
        if pair.camera == "SonyA7S2"
    ]
    scores = {}
    for ratio, (psnr_db, ssim) in PUBLISHED[dataset].items():
        by_db, by_ssim = (moved or {}).get(ratio, (0.0, 0.0))
        group = [pair for pair in pairs if pair.ratio == ratio]
        spread = np.linspace(-1, 1, len(group))
        for pair, step in list(zip(group, spread, strict=True))[skip if ratio == 100 else 0 :]:
            values = {"psnr_db": psnr_db + by_db + 2 * step, "ssim": ssim + by_ssim + 0.02 * step, "rescale": 1.0}
            scores[pair.path] = UnitScore(pair.path, pair.camera, pair.scene, float(pair.iso or 0), ratio, values)
    provenance: dict[str, Any] = {
        "dataset": dataset,
        "cameras": ["SonyA7S2"],
        "subset": subset,
        "excluded_flags": {},
        "scenes_shared": True,
        "protocol_digest": rules.digest,
        "manifest_sha256": manifest.digest,
        "eldata": "0.2.0",
        "predictions": predictions,
    }
    return EvaluationResult.of(rules, provenance, pairs, scores)


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
        "so these files, their levels and ratios and the metric are those of the published evaluation",
    ]


def test_yours_stands_beside_them() -> None:
    text = comparison_table(of_input("sid-sony"))
    block = text.partition("SonyA7S2 x300, 49 pairs")[2].partition("\n\n")[0]
    rows = [" ".join(line.split()) for line in block.splitlines()]
    assert rows[-3:] == [
        "noisy input less dark shading Feng 2023 (PNNP) 22.48 0.276",
        "> yours 22.26 0.269",
        "noisy input Feng 2022 (PMN) 22.26 0.269",
    ]


@pytest.mark.parametrize(
    ("moved", "words"),
    [
        ((0.0049, 0.00004), "agrees:"),
        ((-0.0049, -0.00007), "agrees:"),
        ((0.006, 0.0), "is near:"),
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


def test_what_follows_from_a_small_difference() -> None:
    lines = check(of_input("eld", {100: (0.012, -0.0001), 200: (-0.008, 0.0003)}))
    assert (
        lines[1] == "SonyA7S2 x100 is near: 30.98 dB and 0.4878 published, yours 30.992 and 0.48770 (+0.012, -0.00010)"
    )
    assert lines[-1].startswith("so files, levels, ratios and metric seem right: every mistake that was tried moves")


def test_one_factor_that_differs_has_wrong_files_or_a_wrong_ratio() -> None:
    lines = check(of_input("sid-sony", {300: (0.087, -0.004)}))
    assert lines[3] == (
        "SonyA7S2 x300 DOES NOT AGREE: 22.26 dB and 0.2691 published, yours 22.347 and 0.26510 (+0.087, -0.00400)"
    )
    assert lines[-1] == (
        "so levels and metric are right, and of SonyA7S2 x300 the files or the ratio are not: "
        "unpack or fetch them again and compare"
    )


def test_every_factor_that_differs_is_what_they_share() -> None:
    lines = check(of_input("eld", {100: (-0.044, -0.0016), 200: (-0.044, -0.0017)}))
    assert lines[-1].startswith(
        "so what all factors share is not as published: the black or white level that LibRaw states"
    )


def test_another_protocol_names_the_one_that_has_them() -> None:
    lines = check(of_input("eld", protocol="eld"))
    assert lines[0].startswith("the noisy input: its published scores are not beside yours (published for eld-unc")
    assert lines[1:] == [
        "--protocol eld-uncorrected, over all pairs of SonyA7S2, checks files, levels, ratios and metric"
    ]


def test_a_group_with_a_missing_pair_is_not_checked() -> None:
    lines = check(of_input("sid-sony", skip=1))
    assert lines[-2] == "SonyA7S2 x100 is not checked: yours has scores of 39 of 40 pairs"
    assert sum("agrees:" in line for line in lines) == 2


def test_predictions_are_not_taken_for_the_input() -> None:
    assert check(of_input("eld", predictions="preds")) == []


def test_a_set_without_published_scores_of_its_input() -> None:
    result = of_input("eld")
    other = replace(result, provenance=result.provenance | {"dataset": "sid-fuji"})
    assert check(other) == ["the noisy input: no published score of it on sid-fuji is known, so this checks nothing"]


def test_a_saved_result_says_the_same() -> None:
    result = of_input("eld", {200: (0.3, 0.01)})
    assert comparison_table(json.loads(json.dumps(result.as_dict()))) == comparison_table(result)


def test_the_published_figures_are_those_of_the_tables() -> None:
    for dataset, figures in PUBLISHED.items():
        rows = [row for row in published_rows(dataset, PROTOCOL[dataset]) if row.method == NOISY_INPUT]
        assert {row.ratio: (row.psnr_db, row.ssim) for row in rows} == figures


# --- how they are made --------------------------------------------------------------------------------------------


# --- what is near -------------------------------------------------------------------------------------------------

BLACK, WHITE, SIZE = 512, 16383, 96


def _frames(level: float, ratio: int, seed: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A noisy frame and its reference in DN, packed, of a simulated A7S2 at ISO 1600: 5 DN of read noise, 2 of bias."""
    generator = np.random.default_rng(seed)
    coarse = np.kron(generator.normal(size=(8, 8)), np.ones((SIZE // 8, SIZE // 8)))
    fine = 0.2 * generator.normal(size=(SIZE, SIZE))
    clean = np.minimum(level * np.exp(coarse + fine), 1) * np.array([0.55, 1, 0.5, 1])[:, None, None]
    dn, gain = clean * (WHITE - BLACK), 1.53
    read = generator.normal(scale=5.0, size=dn.shape)
    noisy = generator.poisson(dn / ratio / gain) * gain + read + 2
    return np.round(noisy + BLACK), np.round(dn + BLACK)


def _mean_scores(level: float, ratio: int, mistake: str) -> tuple[float, float]:
    black = BLACK + {"black - 1": -1, "black + 1": 1}.get(mistake, 0)
    white = 16300 if mistake == "white 16300" else WHITE
    amplified = ratio * {"ratio + 1 %": 1.01, "ratio - 1 %": 0.99, "no ratio": 1 / ratio}.get(mistake, 1)
    found = []
    for seed in range(8):
        noisy, reference = _frames(level, ratio, seed)
        if mistake == "a shifted scene" and seed == 0:
            reference = np.roll(reference, 1, axis=2)
        y = np.clip((reference - black) / (white - black), 0, 1)
        x = np.clip((noisy - black) / (white - black) * amplified, -np.inf if mistake == "negatives" else 0, 1)
        ssim = structural_similarity(y, x, data_range=1, channel_axis=0)  # type: ignore[no-untyped-call]
        found.append((-10 * np.log10(np.mean((x - y) ** 2)), ssim))
    psnr_db, mean_ssim = np.mean(found, axis=0)
    return float(psnr_db), float(mean_ssim)


@pytest.mark.parametrize(("level", "ratio"), [(0.03, 200), (0.1, 100)])
def test_no_mistake_passes_for_near(level: float, ratio: int) -> None:
    """Eight simulated scenes, with and without a mistake, from the same seeds, so that nothing else differs."""
    right = _mean_scores(level, ratio, "none")
    assert 20 < right[0] < 35
    mistakes = ["white 16300", "black - 1", "black + 1", "ratio + 1 %", "ratio - 1 %", "no ratio", "negatives"]
    for mistake in [*mistakes, "a shifted scene"]:
        wrong = _mean_scores(level, ratio, mistake)
        moved = [abs(b - a) for a, b in zip(right, wrong, strict=True)]
        assert any(by > limit for by, limit in zip(moved, _NEAR, strict=True)), (mistake, moved)
