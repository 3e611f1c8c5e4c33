"""Figures: what is shown of a value follows from the declaration."""

from __future__ import annotations

from math import inf, nan

from eldata.metrics.registry import Figure

PSNR = Figure(name="psnr_db", label="PSNR", unit="dB", decimals=2, better="higher", meaning="peak signal to noise")
SSIM = Figure(name="ssim", label="SSIM", decimals=3, fine_decimals=4, meaning="similarity")


def test_means_single_values_and_differences_have_decimals_of_their_own() -> None:
    assert [PSNR.format(value) for value in (41.237, inf, nan)] == ["41.24", "inf", "-"]
    assert [PSNR.format_difference(value) for value in (0.126, -0.126, 0.0, inf, nan)] == [
        *("+0.13", "-0.13", "+0.00", "+inf", "-")
    ]
    assert (SSIM.format(0.98765), SSIM.format_single(0.98765)) == ("0.988", "0.9877")
    assert [(figure.heading, figure.sign) for figure in (PSNR, SSIM)] == [("PSNR [dB]", 1), ("SSIM", 0)]
