"""Pictures of what was measured at one ISO: spectrum, real and simulated bias frame, shading."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from eldata.reports.html import digits, plot_words
from eldata.reports.pictures import Picture, Pictures, grey, limits, pooled

if TYPE_CHECKING:
    from collections.abc import Iterable

    from eldata.calibration.acceptance.reproduction import Reproduction
    from eldata.calibration.iso_results import IsoCalibration

_SHADING_SHOWN = 72  # rows or columns


def _pictures(
    kind: str, one: IsoCalibration, pictures: Iterable[Picture], limits_dn: tuple[float, float], unit: str, **said: str
) -> Pictures:
    """Return pictures of one ISO on one scale, with the words of their kind."""
    of_kind = plot_words("calibration")[kind]
    black, white = (f"{digits(limit)} {unit}" for limit in limits_dn)
    caption = of_kind["caption"].format(**said)
    return Pictures(
        f"{kind}-{one.iso:g}", of_kind["title"], caption, tuple(pictures), black, white, pixelated=unit == "DN"
    )


def spectrum_picture(one: IsoCalibration) -> Pictures:
    """Show the centred power spectrum of a bias frame, in which row noise is a line."""
    spectrum = np.asarray(one.spectrum_dn2, dtype=np.float64)
    lines = one.spectrum_lines
    ground, rows, columns = lines.ground_dn2, lines.rows_dn2, lines.columns_dn2
    low, high = limits([spectrum], 0.01, 0.999)
    low = max(low, ground / 8, 1e-9)  # of a single tile, chance alone goes far down
    high = max(high, 2 * low)
    found = f"{digits(rows / ground)} times the ground" if ground > 0 else f"{digits(rows)} DN²"
    across = f"{digits(columns / ground)} times" if ground > 0 else f"{digits(columns)} DN²"
    alt = (
        f"Centred power spectrum of a bias frame at ISO {one.iso:g}: the vertical line of rows is {found}, the "
        f"horizontal one of columns {across}; the ground is {digits(ground)} DN²."
    )
    shown = grey("", alt, np.log(np.maximum(spectrum, low)), float(np.log(low)), float(np.log(high)))
    return _pictures("spectrum", one, [shown], (low, high), "DN²", rows=found, columns=across)


def reproduced_pictures(one: IsoCalibration, reproduction: Reproduction) -> Pictures:
    """Show the same piece of a real bias frame and of a simulated one, on one scale."""
    frames = (reproduction.real_dn, reproduction.simulated_dn)
    scale = limits(frames, 0.002, 0.998)
    shown = [
        grey(
            name,
            f"Piece of the {name} bias frame at ISO {one.iso:g}, standard deviation {digits(sigma)} DN.",
            frame,
            *scale,
        )
        for name, frame, sigma in zip(("real", "simulated"), frames, reproduction.shown_sigmas_dn, strict=True)
    ]
    return _pictures("reproduced", one, shown, scale, "DN")


def shading_pictures(one: IsoCalibration) -> Pictures:
    """Show the level of blocks of the sensor over each channel's mean."""
    planes = [pooled(plane, _SHADING_SHOWN) for plane in one.pattern.shading_dn]
    limit = limits([abs(plane) for plane in planes], 0, 0.99)[1]
    shown = [
        grey(
            name,
            f"Shading of {name} at ISO {one.iso:g}: blocks from {digits(float(plane.min()))} to "
            f"{digits(float(plane.max()))} DN around the mean.",
            plane,
            -limit,
            limit,
        )
        for name, plane in zip(one.bias.channels, planes, strict=True)
    ]
    return _pictures("shading", one, shown, (-limit, limit), "DN")
