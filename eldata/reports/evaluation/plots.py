"""Plots of an evaluation's scores, image by image: by camera, ISO and factor, and the rescaling that was found."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.font_manager import findfont, get_font
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from eldata.evaluation.statistics import interval_of_mean
from eldata.reports.figures import MARKERS, drawn, figure, number

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from eldata.evaluation.saved import SavedScore
    from eldata.reports.figures import Plot, Theme

_LONGEST_LABEL = 14
_GOLDEN = (math.sqrt(5) - 1) / 2
_USUAL = (0.8, 1.25)


def score_plots(images: Sequence[SavedScore], *, rescaled: bool) -> tuple[Plot, ...]:
    """Return the plots of a result; none of no images. Those of the rescaling only if the protocol rescales."""
    finite = [image for image in images if math.isfinite(image.psnr_db) and math.isfinite(image.ssim)]
    if not finite:
        return ()
    left_out = len(images) - len(finite)
    note = f" Not drawn: {left_out} without a finite score." if left_out else ""
    plots = [
        _strips("psnr-camera", "PSNR by camera and factor", "PSNR [dB]", finite, _camera, "psnr_db", note),
        _strips("ssim-camera", "SSIM by camera and factor", "SSIM", finite, _camera, "ssim", note),
        _strips("psnr-iso", "PSNR by ISO and factor", "PSNR [dB]", finite, _iso, "psnr_db", note),
        _strips("ssim-iso", "SSIM by ISO and factor", "SSIM", finite, _iso, "ssim", note),
    ]
    if rescaled:
        positive = [image for image in finite if math.isfinite(image.rescale) and image.rescale > 0]
        if positive:
            plots += [_rescaling_plot(positive), _rescaling_scores_plot(positive)]
    return tuple(plots)


def _camera(image: SavedScore) -> str:
    return image.camera


def _iso(image: SavedScore) -> str:
    return f"ISO {image.iso:g}" if image.iso else "not known"


# --- one column a group -------------------------------------------------------------------------------------------


def _strips(
    name: str,
    title: str,
    label: str,
    images: Sequence[SavedScore],
    group_of: Callable[[SavedScore], str],
    field: str,
    note: str,
) -> Plot:
    groups = _groups(images, group_of)
    ratios = sorted({image.ratio for image in images})
    values = [getattr(image, field) for image in images]

    def draw(theme: Theme) -> Figure:
        made = figure()
        axes = made.subplots()
        _columns(axes, images, groups, ratios, group_of, field, theme, means=True)
        axes.set_ylabel(label)
        return made

    return drawn(
        name,
        title,
        (
            f"{label} of {len(images)} images in {len(groups)} groups ({', '.join(groups)}), from "
            f"{min(values):.4g} to {max(values):.4g}."
        ),
        (
            "A point an image. The bar is the mean of its column with the interval over scenes, where there are "
            f"enough.{note}"
        ),
        draw,
    )


def _rescaling_plot(images: Sequence[SavedScore]) -> Plot:
    groups = _groups(images, _camera)
    ratios = sorted({image.ratio for image in images})
    factors = [image.rescale for image in images]

    def draw(theme: Theme) -> Figure:
        made = figure()
        axes = made.subplots()
        _exposure_band(axes, theme, horizontal=True)
        _columns(axes, images, groups, ratios, _camera, "rescale", theme, means=False)
        _factor_axis(axes, factors)
        axes.set_ylabel("rescaled by")
        return made

    return drawn(
        "rescaling",
        "Rescaling that was found",
        f"Factor of each of {len(images)} predictions by camera, from {min(factors):.3g} to {max(factors):.3g}.",
        (
            "What the protocol multiplied each prediction by. Good: near 1 (the band is 0.8 to 1.25). A column far "
            "from 1 is a wrong exposure or scale of all of its images, which the score forgives and a viewer does not."
        ),
        draw,
    )


def _rescaling_scores_plot(images: Sequence[SavedScore]) -> Plot:
    ratios = sorted({image.ratio for image in images})
    factors = [image.rescale for image in images]

    def draw(theme: Theme) -> Figure:
        made = figure()
        axes = made.subplots()
        _exposure_band(axes, theme, horizontal=False)
        for index, ratio in enumerate(ratios):
            members = [image for image in images if image.ratio == ratio]
            axes.plot(
                [image.rescale for image in members],
                [image.psnr_db for image in members],
                linestyle="none",
                alpha=0.7,
                **look_of_factor(index, ratio, theme),
            )
        _factor_axis(axes, factors, horizontal=True)
        axes.set_xlabel("rescaled by")
        axes.set_ylabel("PSNR [dB]")
        legend_of_factors(axes, len(ratios))
        return made

    return drawn(
        "rescaling-psnr",
        "PSNR against rescaling",
        f"PSNR of {len(images)} images against the factor that each prediction was multiplied by.",
        "Good: a narrow cloud at 1. Bad images far from 1 were exposed wrongly, bad ones at 1 were denoised badly.",
        draw,
    )


def _groups(images: Sequence[SavedScore], group_of: Callable[[SavedScore], str]) -> list[str]:
    """Return the names of the groups; ISOs in the order of their numbers."""
    if group_of is _iso:
        images = sorted(images, key=lambda image: image.iso)
    return list(dict.fromkeys(group_of(image) for image in images))


def _columns(
    axes: Axes,
    images: Sequence[SavedScore],
    groups: Sequence[str],
    ratios: Sequence[float],
    group_of: Callable[[SavedScore], str],
    field: str,
    theme: Theme,
    *,
    means: bool,
) -> None:
    """Draw the points of each group and factor in a column of their own, beside each other by factor."""
    width = 0.8 / len(ratios)
    for index, ratio in enumerate(ratios):
        look = look_of_factor(index, ratio, theme)
        xs: list[float] = []
        ys: list[float] = []
        for place, group in enumerate(groups):
            members = [image for image in images if image.ratio == ratio and group_of(image) == group]
            if not members:
                continue
            values = sorted(float(getattr(image, field)) for image in members)
            middle = place + (index - (len(ratios) - 1) / 2) * width
            # Neighbours in value lie far apart, the same each time.
            xs += [middle + (((rank * _GOLDEN) % 1) - 0.5) * 0.6 * width for rank in range(len(values))]
            ys += values
            if means:
                _mean_bar(axes, middle, 0.42 * width, members, field, theme)
        axes.plot(xs, ys, linestyle="none", alpha=0.55, **look)
    axes.set_xlim(-0.55, len(groups) - 0.45)
    axes.xaxis.set_major_locator(FixedLocator(list(range(len(groups)))))
    labels = [drawable(name, _LONGEST_LABEL) for name in groups]
    turned = len(groups) > 2 and sum(map(len, labels)) > 40
    axes.set_xticklabels(
        labels,
        parse_math=False,
        rotation=25 if turned else 0,
        ha="right" if turned else "center",
        rotation_mode="anchor",
    )
    axes.grid(visible=False, axis="x")
    legend_of_factors(axes, len(ratios))


def _mean_bar(axes: Axes, x: float, half: float, members: Sequence[SavedScore], field: str, theme: Theme) -> None:
    interval = interval_of_mean([float(getattr(image, field)) for image in members], [image.place for image in members])
    axes.plot([x - half, x + half], [interval.mean] * 2, color=theme.ink, linewidth=2, zorder=4)
    if interval.is_known:
        axes.plot([x, x], [interval.low, interval.high], color=theme.ink, linewidth=1.2, zorder=4)


def look_of_factor(index: int, ratio: float, theme: Theme) -> dict[str, Any]:
    """Return how the points of a factor look; ``index`` is its place among the factors."""
    colours = (theme.found, theme.theory, *theme.channels[1:])
    return {
        "color": colours[index % len(colours)],
        "marker": MARKERS[index % len(MARKERS)],
        "markersize": 4.2,
        "markeredgewidth": 0,
        "label": f"×{ratio:g}",
    }


def drawable(name: str, longest: int) -> str:
    """Return a name of at most so many letters, with a box in place of those that the plots' font lacks."""
    name = name if len(name) <= longest else f"{name[: longest - 1]}…"
    font = get_font(findfont("DejaVu Sans"))
    return "".join(letter if font.get_char_index(ord(letter)) else "□" for letter in name)


def legend_of_factors(axes: Axes, count: int) -> None:
    """Put the legend above the axes, where no point can be."""
    axes.legend(
        loc="lower center",
        bbox_to_anchor=(0.5, 1),
        ncols=min(count, 5),
        columnspacing=1,
        handlelength=1,
        handletextpad=0.4,
    )


def _exposure_band(axes: Axes, theme: Theme, *, horizontal: bool) -> None:
    (axes.axhspan if horizontal else axes.axvspan)(*_USUAL, color=theme.theory, alpha=0.13, linewidth=0)
    (axes.axhline if horizontal else axes.axvline)(1, color=theme.theory, linewidth=1)


def _factor_axis(axes: Axes, factors: Sequence[float], *, horizontal: bool = False) -> None:
    """Set up a logarithmic axis of factors, wide enough for the band."""
    low, high = min(0.7, *factors), max(1.43, *factors)
    low, high = low / 1.05, high * 1.05
    (axes.set_xscale if horizontal else axes.set_yscale)("log", base=2)
    (axes.set_xlim if horizontal else axes.set_ylim)(low, high)
    axis = axes.xaxis if horizontal else axes.yaxis
    doublings = math.log2(high / low)
    ticks = [0.7, 0.8, 0.9, 1, 1.1, 1.25, 1.4] if doublings < 1.3 else [0.5, 0.7, 1, 1.4, 2]
    if doublings > 2.5:
        step = max(1, math.ceil(doublings / 7))
        exponents = np.arange(math.ceil(math.log2(low) / step), math.floor(math.log2(high) / step) + 1) * step
        ticks = [float(2.0**exponent) for exponent in exponents]
    axis.set_major_locator(FixedLocator([tick for tick in ticks if low <= tick <= high]))
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda value, _position: number(float(f"{value:.3g}"))))
