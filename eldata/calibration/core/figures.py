"""The figures of the dark at one ISO, each declared once: tables, files, lines over K and drawings read it here."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final, overload

from eldata.base.numbers import Figure, by_name
from eldata.calibration.core.findings import GivenFigure, given

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Self

    from eldata.calibration.core import findings

GAIN: Final = Figure(
    name="gain_dn_per_e", label="K", meaning="system gain", unit="DN/e-", needs=("pairs of flat-field frames",)
)


@dataclass(frozen=True, slots=True, kw_only=True)
class DarkFigure(Figure):
    """A figure of bias frames. As an attribute of an ISO's record it is the :class:`GivenFigure`; ``None``: withheld.

    Attributes
    ----------
    of
        What the estimators found, of the record: the value and its standard error, or a value that has none; ``None``:
        they found nothing.
    basis
        The kind of figure that it is withheld with; ``None``: it is always given.
    is_relative
        Whether findings allow for a share of it, rather than for so much.
    fit
        The line over K that a profile has of it (:class:`~eldata.noise.profile.GainMode`); empty: none.
    """

    of: Callable[[Any], float | tuple[float, float] | None]
    basis: findings.Figure | None = None
    is_relative: bool = True
    fit: str = ""

    @overload
    def __get__(self, one: None, owner: type) -> Self: ...
    @overload
    def __get__(self, one: object, owner: type) -> GivenFigure | None: ...
    def __get__(self, one: Any, owner: type) -> Self | GivenFigure | None:
        """Return the figure of a record."""
        return self if one is None else self.given(one)

    def given(self, one: Any) -> GivenFigure | None:
        """Return the figure of a record, its error with what findings add; ``None``: withheld, or there is none."""
        found = self.of(one)
        if found is None:
            return None
        value, error = found if isinstance(found, tuple) else (found, math.nan)
        if math.isnan(value):
            return None
        if self.basis is None:
            return GivenFigure(value, error)
        return given(one.findings, self.basis, value, error, value if self.is_relative else 1.0)

    def as_dict(self, one: Any) -> dict[str, float | None]:
        """Return the figure of a record by its name, and its error: ``sigma_tl_dn`` and ``sigma_tl_error_dn``."""
        figure = self.given(one)
        found = {self.name: None if figure is None else figure.value}
        if isinstance(self.of(one), tuple):
            stem = self.name.removesuffix("_dn")
            found[f"{stem}_error{self.name.removeprefix(stem)}"] = None if figure is None else figure.error
        return found

    def cell(self, one: Any) -> str:
        """Return the figure of a record as tables show it."""
        figure = self.given(one)
        return self.format(None) if figure is None else self.format(figure.value, figure.error)


def _dark(
    name: str, label: str, meaning: str, of: Callable[[Any], float | tuple[float, float] | None], **more: Any
) -> DarkFigure:
    unit = "DN" if name.endswith("_dn") else ""
    return DarkFigure(name=name, label=label, meaning=meaning, of=of, unit=unit, **more)


def _of_read(value: str, error: str = "") -> Callable[[Any], float | tuple[float, float] | None]:
    """Return what a record found of its read noise: nothing where values end at a floor."""

    def of(one: Any) -> float | tuple[float, float] | None:
        found = math.nan if one.read is None else getattr(one.read, value)
        return (found, math.nan if one.read is None else getattr(one.read, error)) if error else found

    return of


TUKEY_LAMBDA: Final = _dark(
    *("tukey_lambda", "lambda", "shape of the read noise"),
    _of_read("tukey_lambda", "tukey_lambda_error"),
    basis="shape",
    is_relative=False,
)
SIGMA_TL: Final = _dark(
    *("sigma_tl_dn", "sigma_TL", "scale of the read noise"),
    _of_read("sigma_tl_dn", "sigma_tl_error_dn"),
    basis="shape",
    fit="tukey_lambda_fit",
)
SIGMA_GAUSS: Final = _dark(
    *("sigma_gauss_dn", "sigma_G", "standard deviation of the read noise"),
    _of_read("sigma_gauss_dn", "sigma_gauss_error_dn"),
    basis="read noise",
    fit="gauss_fit",
)
SIGMA_ROW: Final = _dark(
    *("sigma_row_dn", "sigma_row", "standard deviation of the row noise"),
    lambda one: (one.rows.rows.sigma_dn, one.rows.rows.sigma_error_dn),
    basis="row noise",
    fit="row_fit",
)
SIGMA_COLUMN: Final = _dark(
    *("sigma_column_dn", "sigma_column", "standard deviation of what columns have of their own"),
    lambda one: (one.rows.columns.sigma_dn, one.rows.columns.sigma_error_dn),
    basis="row noise",
)
SCALES: Final = (SIGMA_TL, SIGMA_GAUSS, SIGMA_ROW)
"""Those that have a line over K."""

_R_SQUARED: Final = (
    _dark("r_squared_tl", "R2 TL", "of the plot against Tukey lambda", _of_read("r_squared_tl"), decimals=5),
    _dark("r_squared_gauss", "R2 G", "of the normal plot", _of_read("r_squared_gauss"), decimals=5),
)


def _of_one_frame(figure: DarkFigure) -> DarkFigure:
    """Return the declaration of the same figure as published: of one frame, with its pattern."""
    meaning = f"{figure.meaning}, of one frame with its pattern"
    name = figure.name

    def of(one: Any) -> float | None:
        return None if one.single_frame is None else getattr(one.single_frame, name)

    return replace(figure, name=f"single_frame_{name}", label=f"{figure.label} as published", meaning=meaning, of=of)


DARK_FIGURES: Final = by_name(
    (
        *(TUKEY_LAMBDA, SIGMA_TL, SIGMA_GAUSS),
        _dark("ppcc_lambda", "lambda, PPCC", "by its plot", _of_read("ppcc_lambda"), basis="shape"),
        _dark("ppcc_sigma_tl_dn", "sigma_TL, PPCC", "of it", _of_read("ppcc_sigma_tl_dn"), basis="shape"),
        *(*_R_SQUARED, *map(_of_one_frame, _R_SQUARED)),
        _dark("read_chi2_per_dof", "chi2", "of the fit, per degree of freedom", _of_read("chi2_per_dof")),
        SIGMA_ROW,
        _dark("row_shapiro_p", "Shapiro-Wilk p", "of normal row noise", lambda one: one.rows.rows.shapiro_p),
        SIGMA_COLUMN,
    )
)
"""By name, in the order of JSON."""

COLUMNS: Final = (TUKEY_LAMBDA, *SCALES, *_R_SQUARED)
"""Those of the table of the ISOs."""
