"""What a calibration found of a camera: the ISOs, the fits over all of them, the profile, and what to be wary of."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.base.numbers import counted
from eldata.base.tables import block, table, text_table, with_error
from eldata.base.visible import in_line
from eldata.calibration.iso_results import SCALES, list_symbols
from eldata.errors import ArgumentError, DatasetError

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.axes import Axes

    from eldata.calibration.iso_results import FailedIso, IsoCalibration, IsoGain, Quantities, Quantity
    from eldata.calibration.joint import FittedMode, LogLogEstimate
    from eldata.manifest.verify_report import Problem
    from eldata.noise.profile import CameraProfile, GainMode
    from eldata.plots.axes import Drawing, Fit, Point, Theme

    Table = tuple[tuple[str, ...], list[tuple[str, ...]]]

_COLUMNS = ("tukey_lambda", *SCALES, "r_squared_tl", "r_squared_gauss")


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """The result of :func:`~eldata.calibration.camera.calibrate`.

    Attributes
    ----------
    camera
        The camera's name.
    isos
        One record per ISO that has bias frames, ascending.
    gains
        One record per ISO that has flats alone, ascending: K, and nothing else.
    failed
        The ISOs whose frames cannot be used, which nothing else contains.
    source
        What the figures come from, in words.
    modes
        The lines over K with their uncertainty: one set, or one for each gain mode of the camera. None if no ISO has K.
    remarks
        About the calibration as a whole.
    made_profile
        The camera's profile; ``None`` if the figures do not make one.
    no_profile
        Why they do not; empty if they do.
    """

    camera: str
    isos: tuple[IsoCalibration, ...]
    source: str
    modes: tuple[FittedMode, ...]
    remarks: tuple[str, ...]
    made_profile: CameraProfile | None
    no_profile: str = ""
    gains: tuple[IsoGain, ...] = ()
    failed: tuple[FailedIso, ...] = ()

    @property
    def tukey_lambda_fit(self) -> LogLogEstimate | None:
        """The line of sigma_TL over K; ``None`` if fewer than three ISOs can be fitted, or there are several modes.

        With too few ISOs, the profile says in a note what it holds instead.
        """
        return self._only_fit("sigma_tl_dn")

    @property
    def gauss_fit(self) -> LogLogEstimate | None:
        """The line of sigma_G over K; ``None`` as for ``tukey_lambda_fit``."""
        return self._only_fit("sigma_gauss_dn")

    @property
    def row_fit(self) -> LogLogEstimate | None:
        """The line of sigma_row over K; ``None`` as for ``tukey_lambda_fit``."""
        return self._only_fit("sigma_row_dn")

    def _only_fit(self, scale: str) -> LogLogEstimate | None:
        """Find the line of a scale over K; ``None`` if there are several gain modes."""
        return self.modes[0].estimates[scale] if len(self.modes) == 1 else None

    @property
    def all_isos(self) -> tuple[IsoGain, ...]:
        """The ISOs that have bias frames and those that have flats alone, ascending."""
        return tuple(sorted((*self.isos, *self.gains), key=lambda record: record.iso))

    @property
    def accepted(self) -> tuple[str, ...]:
        """The figures that a check would withhold and somebody has accepted, by check, with their ISOs."""
        isos: dict[str, list[str]] = {}
        for record in self.all_isos:
            for finding in filter(attrgetter("is_accepted"), record.findings):
                isos.setdefault(f"{finding.check}: {list_symbols(finding.figures)}", []).append(f"{record.iso:g}")
        return tuple(f"{figures} at ISO {', '.join(places)}" for figures, places in isos.items())

    @property
    def problems(self) -> tuple[Problem, ...]:
        """What is wrong with the frames of the ISOs that are left out."""
        return tuple(problem for failed in self.failed for problem in failed.problems)

    @property
    def profile(self) -> CameraProfile:
        """The camera's profile, for :class:`~eldata.noise.model.NoiseModel`.

        Raises
        ------
        DatasetError
            If the figures do not make one: no ISO has both K and read noise. It says why.
        """
        if self.made_profile is None:
            raise DatasetError(f"{self.camera}: no profile can be made: {self.no_profile}")
        return self.made_profile

    @property
    def usual_gain_per_iso(self) -> float:
        """The median of K / ISO; nan if no gain is known."""
        ratios = [record.gain_dn_per_e / record.iso for record in self.all_isos if record.gain_dn_per_e is not None]
        return float(np.median(ratios)) if ratios else math.nan

    @property
    def all_remarks(self) -> tuple[str, ...]:
        """Every remark; a remark on one ISO has the ISO in front."""
        of_isos = (f"ISO {record.iso:g}: {remark}" for record in self.all_isos for remark in record.all_remarks)
        return (*of_isos, *self.remarks)

    # --- as tables, text and JSON ---

    def tables(self) -> dict[str, Table]:
        """Return header and rows of the tables that have any, by name; values with standard errors, or "withheld".

        ``figures`` of the ISOs with bias frames (``9 + 1``: nine were used, one was kept out to hold the result
        against), ``gains`` of those with flats alone, ``colour-bias``, the ``fits`` over K, and ``reproduction``: how
        well the noise model reproduces the frames that were kept out.
        """
        from eldata.calibration.held_out import HEADINGS

        gain = "K [DN/e-]"
        headings: list[str] = []
        channels: tuple[str, ...] = ()
        figures, gains, colour_bias, fits, kept = (list[tuple[str, ...]]() for _ in range(5))
        for record in self.isos:
            iso, flats, channels = f"{record.iso:g}", str(record.flat_frames), record.channels
            columns = [record.figures[name] for name in _COLUMNS]
            headings = [figure.heading for figure in columns]
            bias_frames = str(record.bias_frames) + ("" if record.reproduction is None else " + 1")
            texts = (figure.text for figure in columns)
            figures.append((iso, bias_frames, flats, record.gain_text, *texts, str(record.pattern.defects)))
            texts = (figure.text for figure in record.colour_bias or ())
            withheld = ("withheld",) * (len(channels) if record.colour_bias is None else 0)
            colour_bias.append((iso, *texts, *withheld, f"{max(record.pattern.dsnu_dn):.2f}"))
            if record.reproduction is not None:
                kept.append((iso, *record.reproduction.cells()))
        gains += [(f"{record.iso:g}", str(record.flat_frames), record.gain_text) for record in self.gains]
        for fitted in self.modes:
            for scale, label in SCALES.items():
                if (line := fitted.estimates[scale]) is not None:
                    values = (line.fit.slope, line.fit.intercept, line.fit.sigma)
                    errors = (line.slope_error, line.intercept_error, line.sigma_error)
                    name = f"{label}, {fitted.mode}" if len(self.modes) > 1 else label
                    fits.append((name, *map(with_error, values, errors), f"{line.r_squared:.4f}"))
        tables: dict[str, Table] = {
            "figures": (("ISO", "bias", "flat", gain, *headings, "defects"), figures),
            "gains": (("ISO", "flat", gain), gains),
            "colour-bias": (("ISO", *channels, "DSNU"), colour_bias),
            "fits": (("fit over ln K", "slope", "intercept", "sigma", "R2"), fits),
            "reproduction": (("ISO", *HEADINGS), kept),
        }
        return {name: table for name, table in tables.items() if table[1]}

    def format_text(self) -> str:
        """Return the measured figures as aligned tables, the fits, and the remarks."""
        titles = {
            "gains": "K alone, from flats without bias frames\n",
            "colour-bias": "colour bias over the recorded black level [DN]\n",
            "reproduction": "a bias frame kept out, against simulated ones\n",
        }
        parts = [
            titles.get(name, "") + text_table(header, rows, left=(0,) if name == "fits" else ())
            for name, (header, rows) in self.tables().items()
        ]
        if self.no_profile:
            parts.append(f"no profile can be made: {self.no_profile}")
        if self.accepted:
            parts.append("accepted, with larger errors\n" + "\n".join(f"  {figures}" for figures in self.accepted))
        if self.all_remarks:
            parts.append("remarks\n" + "\n".join(f"  {remark}" for remark in self.all_remarks))
        return "\n\n".join(parts)

    def __repr__(self) -> str:
        isos = ", ".join(f"{record.iso:g}" for record in self.all_isos)
        profile = "with a profile" if self.made_profile is not None else "no profile"
        remarks = counted(len(self.all_remarks), "remark")
        return f"Calibration({in_line(self.camera)!r}, ISO {isos or 'none'}; {profile}, {remarks})"

    def _repr_html_(self) -> str:
        """Render the tables of figures and gains for notebooks."""
        tables = [table(*each) for name, each in self.tables().items() if name in {"figures", "gains"}]
        return block(f"Calibration of {self.camera}", *tables, notes=self.all_remarks)

    def as_dict(self) -> dict[str, Any]:
        """Return every figure with its standard error as plain JSON types.

        Numbers that are not finite are ``None``, and so is what is withheld; ``"withheld"`` has the reasons by figure.
        """
        fits = {f"{name}_fit": getattr(self, f"{name}_fit") for name in ("tukey_lambda", "gauss", "row")}
        return {
            "camera": self.camera,
            "isos": [record.as_dict() for record in self.isos],
            "gains": [record.as_dict() for record in self.gains],
            "failed_isos": [failed.iso for failed in self.failed],
            "problems": [asdict(problem) for problem in self.problems],
            "fits": {name: None if estimate is None else asdict(estimate) for name, estimate in fits.items()},
            "modes": [asdict(fitted) for fitted in self.modes] if len(self.modes) > 1 else [],
            "profile": None if self.made_profile is None else self.made_profile.as_dict(),
            "no_profile": self.no_profile or None,
            "accepted": list(self.accepted),
            "remarks": list(self.all_remarks),
        }

    # --- drawing ---

    @property
    def scale_panels(self) -> tuple[ScalePanel, ...]:
        """The scales over K that can be drawn: of the read noise by either model, and of the row noise."""
        quantities: Quantities = ("shape", "read noise", "row noise")
        panels = []
        for (scale, label), quantity in zip(SCALES.items(), quantities, strict=True):
            known = ((record.gain.value, record.figures[scale]) for record in self.isos if record.gain is not None)
            points = tuple((gain, figure.value, figure.error) for gain, figure in known if 0 < figure.value < math.inf)
            lines = ((fitted.mode, fitted.estimates[scale]) for fitted in self.modes)
            if points:
                known_lines = tuple((mode, line) for mode, line in lines if line is not None)
                panels.append(ScalePanel(label.removeprefix("sigma_"), quantity, known_lines, points))
        return tuple(panels)

    def plot(self, iso: float | None = None) -> Drawing:
        """Draw photon transfer at one ISO, K over the ISO, and the scales of the noise over K.

        Parameters
        ----------
        iso
            Whose photon transfer; by default the middle one of those that have one.

        Returns
        -------
        matplotlib.figure.Figure
            One axes for each of what was found; it belongs to no pyplot, and a notebook shows it.

        Raises
        ------
        ArgumentError
            If there is no photon transfer at the ISO, or nothing to draw at all.
        """
        from eldata.plots import axes as plots

        transfers = {r.iso: (r.channels, r.transfer.channels) for r in self.all_isos if r.transfer is not None}
        known = sorted(transfers)
        if iso is not None and iso not in transfers:
            listed = ", ".join(f"{other:g}" for other in known) or "none"
            raise ArgumentError(f"no photon transfer was measured at ISO {iso:g}; ISOs with one: {listed}")
        draws: list[tuple[str, Callable[[Axes, Theme], object]]] = []
        if known:
            chosen = known[len(known) // 2] if iso is None else iso

            def draw_transfer(axes: Axes, theme: Theme) -> None:
                """Draw the photon transfer of the chosen ISO."""
                plots.transfer_lines(axes, None, *transfers[chosen], theme)

            draws.append((f"photon transfer, ISO {chosen:g}", draw_transfer))
        if gains := {record.iso: record.gain for record in self.all_isos if record.gain is not None}:
            values, errors = [gain.value for gain in gains.values()], [plots.bar(gain.error) for gain in gains.values()]

            def draw_gains(axes: Axes, theme: Theme) -> None:
                """Draw K over the ISO."""
                plots.gain_over_iso(axes, list(gains), values, errors, self.usual_gain_per_iso, theme)
                plots.iso_axis(axes, list(gains))

            draws.append(("system gain", draw_gains))
        for panel in self.scale_panels:

            def draw_scales(axes: Axes, theme: Theme, panel: ScalePanel = panel) -> None:
                """Draw a scale of the noise over K."""
                plots.scale_over_gain(axes, panel.name, panel.spans, panel.points, theme)

            draws.append(("row noise" if panel.name == "row" else f"read noise, {panel.name}", draw_scales))
        if not draws:
            raise plots.nothing_to_draw(
                f"the calibration of {self.camera}", "no ISO has flats or both K and bias frames"
            )
        return plots.drawn_grid(f"Calibration of {self.camera}", draws)


@dataclass(frozen=True, slots=True)
class ScalePanel:
    """The scale of one component over K.

    Attributes
    ----------
    name, quantity
        Index of its sigma, and what it is withheld with.
    lines
        The fitted ones, with their gain modes.
    points
        K, scale and its standard error where both are given and a logarithmic axis can show them; never empty.
    """

    name: str
    quantity: Quantity
    lines: tuple[tuple[GainMode, LogLogEstimate], ...]
    points: tuple[Point, ...]

    @property
    def spans(self) -> list[Fit]:
        """The lines, each with the lowest and the highest gain of its mode's points."""
        spans: list[Fit] = []
        for mode, line in self.lines:
            inside = [gain for gain, _, _ in self.points if mode.distance(gain) == 0]
            spans.append((line.fit.scale_dn, min(inside), max(inside)))
        return spans
