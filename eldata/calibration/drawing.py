"""The figure of a calibration."""

from __future__ import annotations

from typing import TYPE_CHECKING

from eldata.errors import ArgumentError
from eldata.plots.axes import drawn_grid, nothing_to_draw
from eldata.plots.gains import bar, gain_over_iso, iso_axis, scale_over_gain, transfer_lines

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from matplotlib.axes import Axes

    from eldata.calibration.core.photon_transfer import PhotonTransfer
    from eldata.calibration.panels import ScalePanel
    from eldata.plots.axes import Drawing, Theme
    from eldata.plots.gains import Point


def calibration_figure(
    camera: str,
    transfers: Mapping[float, tuple[tuple[str, ...], PhotonTransfer]],
    iso: float | None,
    gains: Sequence[Point],
    usual: float,
    panels: Sequence[ScalePanel],
) -> Drawing:
    """Draw what was found, an axes each.

    Parameters
    ----------
    camera
        For the title.
    transfers
        By ISO: names of the channels, and the lines.
    iso
        Which of them; the middle one by default.
    gains
        ISO, K and its standard error.
    usual
        The usual K / ISO.
    panels
        Scales over K.
    """
    known = sorted(transfers)
    if iso is not None and iso not in transfers:
        listed = ", ".join(f"{one:g}" for one in known) or "none"
        raise ArgumentError(f"no photon transfer was measured at ISO {iso:g}; ISOs with one: {listed}")
    draws: list[tuple[str, Callable[[Axes, Theme], object]]] = []
    if known:
        chosen = known[len(known) // 2] if iso is None else iso
        names, transfer = transfers[chosen]

        def draw_transfer(axes: Axes, theme: Theme) -> None:
            transfer_lines(axes, None, names, transfer.channels, theme)
            axes.set_xlabel("signal [DN]")

        draws.append((f"photon transfer, ISO {chosen:g}", draw_transfer))
    if gains:

        def draw_gains(axes: Axes, theme: Theme) -> None:
            isos, values, errors = zip(*gains, strict=True)
            gain_over_iso(axes, isos, values, [bar(error) for error in errors], usual, theme)
            iso_axis(axes, isos)

        draws.append(("system gain", draw_gains))
    for panel in panels:

        def draw_scales(axes: Axes, theme: Theme, panel: ScalePanel = panel) -> None:
            scale_over_gain(
                axes, panel.name, [(line.fit, low, high) for line, low, high in panel.spans], panel.points, theme
            )

        draws.append((panel.figure if panel.name == "row" else f"{panel.figure}, {panel.name}", draw_scales))
    if not draws:
        raise nothing_to_draw(f"the calibration of {camera}", "no ISO has flats or both K and bias frames")
    return drawn_grid(f"Calibration of {camera}", draws)
