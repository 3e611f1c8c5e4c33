"""Figures: what is shown of a value follows from the declaration."""

from __future__ import annotations

import math

import pytest

from eldata.base.numbers import Figure

PSNR = Figure(name="psnr_db", label="PSNR", unit="dB", decimals=2, better="higher", meaning="peak signal to noise")
SSIM = Figure(name="ssim", label="SSIM", decimals=3, fine_decimals=4, meaning="similarity")
GAIN = Figure(name="gain_dn_per_e", label="K", unit="DN/e-", meaning="overall system gain")


@pytest.mark.parametrize(
    ("figure", "value", "error", "text"),
    [
        (PSNR, 41.237, math.nan, "41.24"),
        (PSNR, math.inf, math.nan, "inf"),
        (PSNR, math.nan, math.nan, "-"),
        (PSNR, None, math.nan, "withheld"),
        (GAIN, 2.34567, 0.012, "2.346 ± 0.012"),
        (GAIN, 2.345678, math.nan, "2.3457"),
    ],
)
def test_a_value_is_written_with_its_decimals_or_by_its_error(
    figure: Figure, value: float | None, error: float, text: str
) -> None:
    assert figure.format(value, error) == text


def test_one_value_and_a_difference_have_decimals_of_their_own() -> None:
    assert [(figure.heading, figure.sign) for figure in (PSNR, GAIN)] == [("PSNR [dB]", 1), ("K [DN/e-]", 0)]
    assert (SSIM.format(0.98765), SSIM.format_single(0.98765)) == ("0.988", "0.9877")
    assert [PSNR.format_difference(value) for value in (0.126, -0.126, 0.0, math.inf, math.nan, None)] == [
        *("+0.13", "-0.13", "+0.00", "+inf", "-", "withheld")
    ]
