"""Pictures of what was measured at one ISO: spectrum, real and simulated bias frame, shading."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from eldata.reports.calibration.iso_plots import channel_names
from eldata.reports.html import digits
from eldata.reports.pictures import Pictures, grey, limits, pooled

if TYPE_CHECKING:
    from eldata.calibration.reproduction import Reproduction
    from eldata.calibration.results import IsoCalibration

_SHADING_SHOWN = 72  # rows or columns


def spectrum_picture(one: IsoCalibration) -> Pictures:
    """Show the centred power spectrum of a bias frame, in which row noise is a line."""
    spectrum = np.asarray(one.spectrum_dn2, dtype=np.float64)
    lines = one.spectrum_lines
    ground, rows, columns = lines.ground_dn2, lines.rows_dn2, lines.columns_dn2
    low, high = limits([spectrum], 0.01, 0.999)
    low = max(low, ground / 8, 1e-9)  # of a single tile, chance alone goes far down
    high = max(high, 2 * low)
    shown = np.log(np.maximum(spectrum, low))
    found = f"{digits(rows / ground)} times the ground" if ground > 0 else f"{digits(rows)} DN²"
    across = f"{digits(columns / ground)} times" if ground > 0 else f"{digits(columns)} DN²"
    return Pictures(
        name=f"spectrum-{one.iso:g}",
        title="Spectrum of a bias frame",
        caption=(
            f"Fourier spectrum, frequency 0 in the centre, greys by logarithm. Row noise is the vertical line in the "
            f"middle, here {found}; column noise a horizontal one, here {across}. Good: nothing else. Other dots and "
            "lines are banding with a period, which the model does not have; fixed patterns are still in it."
        ),
        pictures=(
            grey(
                "",
                f"Centred power spectrum of a bias frame at ISO {one.iso:g}: the vertical line of rows is {found}, the "
                f"horizontal one of columns {across}; the ground is {digits(ground)} DN².",
                shown,
                float(np.log(low)),
                float(np.log(high)),
            ),
        ),
        black=f"{digits(low)} DN²",
        white=f"{digits(high)} DN²",
        pixelated=False,
    )


def reproduced_pictures(one: IsoCalibration, reproduction: Reproduction) -> Pictures:
    """Show the same piece of a real bias frame and of a simulated one, on one scale."""
    frames = (reproduction.real_dn, reproduction.simulated_dn)
    low, high = limits(frames, 0.002, 0.998)
    names = ("real", "simulated")
    return Pictures(
        name=f"reproduced-{one.iso:g}",
        title="Bias frame, real and simulated",
        caption=(
            "A piece of a bias frame that no estimate has seen, and one that the model made with the figures above, "
            "both over the recorded black level. Good: not to be told apart. What only the real one shows, such as "
            "columns, spots or blocks, the model lacks; its fixed pattern is one of them."
        ),
        pictures=tuple(
            grey(
                name,
                f"Piece of the {name} bias frame at ISO {one.iso:g}, standard deviation {digits(sigma)} DN.",
                frame,
                low,
                high,
            )
            for name, frame, sigma in zip(names, frames, reproduction.shown_sigmas_dn, strict=True)
        ),
        black=f"{digits(low)} DN",
        white=f"{digits(high)} DN",
        pixelated=True,
    )


def shading_pictures(one: IsoCalibration) -> Pictures:
    """Show the level of blocks of the sensor over each channel's mean."""
    planes = [pooled(plane, _SHADING_SHOWN) for plane in one.pattern.shading_dn]
    limit = limits([abs(plane) for plane in planes], 0, 0.99)[1]
    return Pictures(
        name=f"shading-{one.iso:g}",
        title="Shading of the black level",
        caption=(
            "Mean bias frame by blocks over the channel's mean, the whole sensor. Good: even grey noise. Bright edges "
            "or corners are amplifier glow or heat, which a single colour bias does not take off."
        ),
        pictures=tuple(
            grey(
                name,
                f"Shading of {name} at ISO {one.iso:g}: blocks from {digits(float(plane.min()))} to "
                f"{digits(float(plane.max()))} DN around the mean.",
                plane,
                -limit,
                limit,
            )
            for name, plane in zip(channel_names(len(planes)), planes, strict=True)
        ),
        black=f"{digits(-limit)} DN",
        white=f"{digits(limit)} DN",
        pixelated=True,
    )
