"""What becomes of a figure for a finding: withheld everywhere, given with a larger error, or remarked."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from eldata.calibration import Calibration, Finding, IsoCalibration
from eldata.calibration.camera import join_isos
from eldata.calibration.iso_results import READ, SYMBOLS, Effect, Quantity, accept_findings, list_symbols
from eldata.noise import CameraProfile
from eldata.reports.calibration import calibration_page
from eldata.reports.html import typeset
from tests.reports.calibrations import camera_at, measured
from tests.reports.pages import checked
from tests.shared import there

WHY = "half of the frames are of another planet; photograph this one"
GAIN_CELL, ROW_CELL = 3, 7  # of a table's row
CELLS: dict[str, tuple[int, ...]] = {"gain": (3,), "shape": (4, 5), "read noise": (6,), "row noise": (7,)}
OF_FIGURE: dict[str, tuple[str, ...]] = {
    "gain": ("gain_dn_per_e", "gain_error", "gain_by_channel"),
    "shape": (
        *("tukey_lambda", "tukey_lambda_error", "sigma_tl_dn", "sigma_tl_error_dn"),
        *("ppcc_lambda", "ppcc_sigma_tl_dn"),
    ),
    "read noise": ("sigma_gauss_dn", "sigma_gauss_error_dn"),
    "row noise": ("sigma_row_dn", "sigma_row_error_dn", "sigma_column_dn", "sigma_column_error_dn"),
    "colour bias": ("colour_bias_dn", "colour_bias_error_dn"),
}


@pytest.fixture(scope="module")
def isos() -> tuple[IsoCalibration, ...]:
    """Four, so that lines can be fitted without one of them; all have every figure, and a comparison."""
    return tuple(measured(iso, camera_at(iso)) for iso in (100.0, 400.0, 1600.0, 6400.0))


def finding(*figures: Quantity, effect: Effect = "withheld", allowance: float = 0.0, check: str = "planet") -> Finding:
    return Finding(check, figures, effect, 0.5, 0.1, WHY, allowance)


def with_findings(isos: tuple[IsoCalibration, ...], *findings: Finding) -> Calibration:
    """The second ISO has the findings; what it would have been compared with is left out, as calibrate_iso does."""
    record = replace(isos[1], findings=findings)
    kept = record.reproduction if record.parameters else None
    return join_isos("TestCamera", [isos[0], replace(record, reproduction=kept), *isos[2:]])


def page_of(found: Calibration) -> str:
    """The text of the page of the first two ISOs: drawing each takes a second."""
    return checked(calibration_page(join_isos(found.camera, found.isos[:2]))).text


def as_json(found: Calibration) -> dict[str, Any]:
    data: dict[str, Any] = json.loads(json.dumps(found.as_dict(), allow_nan=False))
    return data


@pytest.mark.parametrize("figure", list(SYMBOLS))
def test_a_withheld_figure_is_given_nowhere(figure: Quantity, isos: tuple[IsoCalibration, ...]) -> None:
    whole, found = join_isos("TestCamera", isos), with_findings(isos, finding(figure))
    one, data, before = found.isos[1], as_json(found)["isos"][1], as_json(whole)["isos"][1]
    assert one.withheld == {figure}
    assert data["withheld"] == {figure: WHY}
    assert data["findings"][0]["check"] == "planet"
    for name, fields in OF_FIGURE.items():
        for field in fields:
            assert before[field] is not None
            assert data[field] == (None if name == figure else before[field]), field
    assert before["withheld"] == {}

    cells, hidden = found.tables()["figures"][1][1], CELLS.get(figure, ())
    assert [index for index, cell in enumerate(cells) if cell == "withheld"] == list(hidden)
    colours = found.tables()["colour-bias"][1][1][1:5]
    assert (colours == ("withheld",) * 4) == (figure == "colour bias")

    assert (one.parameters is None) == (data["reproduction"] is None) == (figure != "gain")
    # No number that only the withheld figure has is left in the text or the profile's notes.
    cells_of_it = {whole.tables()["figures"][1][1][index] for index in hidden}
    cells_of_it |= set(whole.tables()["colour-bias"][1][1][1:5]) if figure == "colour bias" else set()
    for text in (found.format_text(), *found.profile.notes):
        assert [cell for cell in cells_of_it if cell in text] == []


def test_a_page_shows_no_withheld_figure(isos: tuple[IsoCalibration, ...]) -> None:
    whole, page = join_isos("TestCamera", isos), page_of(with_findings(isos, finding(*SYMBOLS))).replace("−", "-")
    assert f"Withheld: {WHY}." in page
    assert f"Withheld, since an assumption does not hold: {typeset(list_symbols(SYMBOLS))} at ISO 400." in page
    assert "Not shown, since withheld: ISO 400." in page
    hidden = {*whole.tables()["figures"][1][1][GAIN_CELL : ROW_CELL + 1], *whole.tables()["colour-bias"][1][1][1:5]}
    assert [cell for cell in hidden if cell in page] == []


def test_the_profile_of_what_is_left(isos: tuple[IsoCalibration, ...], tmp_path: Path) -> None:
    """A row needs lambda and the colour bias; K and sigma_row may be unknown. Lines are of what is given."""
    whole = join_isos("TestCamera", isos)
    expected: dict[Quantity, tuple[int, tuple[int, int, int]]] = {
        "gain": (4, (3, 3, 3)),
        "shape": (3, (3, 4, 4)),
        "read noise": (3, (4, 3, 4)),
        "row noise": (4, (4, 4, 3)),
        "colour bias": (3, (4, 4, 4)),
    }
    for figure, (rows, points) in expected.items():
        found = with_findings(isos, finding(figure))
        found.profile.save(tmp_path / "p.json")
        profile = CameraProfile.load(tmp_path / "p.json")
        assert len(profile.rows) == rows, figure
        fits = (found.tukey_lambda_fit, found.gauss_fit, found.row_fit)
        assert tuple(0 if fit is None else fit.points for fit in fits) == points, figure
        assert (found.row_fit == whole.row_fit) == (figure not in ("gain", "row noise"))
        kept = [(row.gain_dn_per_e is None, row.sigma_row_dn is None) for row in profile.rows if row.iso == 400]
        assert kept == {"gain": [(True, False)], "row noise": [(False, True)]}.get(figure, [])
        assert any(note.startswith("ISO 400: half of the frames") for note in profile.notes)


@pytest.mark.usefixtures("undrawn")
def test_an_allowance_widens_errors_in_quadrature(isos: tuple[IsoCalibration, ...]) -> None:
    """Each share of the figure; of lambda and the colour bias as it is. Two findings add, remarks and others do not."""
    found = with_findings(
        isos,
        finding("gain", *READ, "row noise", "colour bias", effect="wider", allowance=0.03),
        finding("gain", *READ, effect="wider", allowance=0.04),
        finding("gain", effect="remark", allowance=9.0),
    )
    one = found.isos[1]
    transfer, read, rows = there(one.transfer), there(one.read), one.rows.rows
    for figure, value, error, allowance in (
        (one.gain, transfer.gain_dn_per_e, transfer.gain_error, 0.05 * transfer.gain_dn_per_e),
        (one.tukey_lambda, read.tukey_lambda, read.tukey_lambda_error, 0.05),
        (one.sigma_tl_dn, read.sigma_tl_dn, read.sigma_tl_error_dn, 0.05 * read.sigma_tl_dn),
        (one.sigma_gauss_dn, read.sigma_gauss_dn, read.sigma_gauss_error_dn, 0.05 * read.sigma_gauss_dn),
        (one.sigma_row_dn, rows.sigma_dn, rows.sigma_error_dn, 0.03 * rows.sigma_dn),
    ):
        assert there(figure).value == value
        assert there(figure).error == pytest.approx(math.hypot(error, allowance), rel=1e-12)
    for channel, error in zip(there(one.colour_bias), one.bias.standard_error_dn, strict=True):
        assert channel.error == pytest.approx(math.hypot(error, 0.03), rel=1e-12)
    assert as_json(found)["isos"][1]["gain_error"] == there(one.gain).error
    error_shown = float(found.tables()["figures"][1][1][GAIN_CELL].split(" ± ")[1])
    assert error_shown == pytest.approx(there(one.gain).error, rel=0.17)
    page = page_of(found)
    assert found.tables()["figures"][1][1][GAIN_CELL] in page
    assert f"Given with a larger error: {typeset(list_symbols(one.widened))} at ISO 400." in page
    assert "Errors made larger: " in page
    assert "Withheld" not in page
    assert found.profile.rows == join_isos("TestCamera", isos).profile.rows, "the figures themselves stay"


# --- accepted -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("figure", list(SYMBOLS))
def test_an_accepted_figure_is_given_with_a_larger_error_and_said(
    figure: Quantity, isos: tuple[IsoCalibration, ...]
) -> None:
    coarse = finding(figure, allowance=0.25, check="coarse values")
    refused = with_findings(isos, coarse)
    symbols, option = SYMBOLS[figure], '--accept "coarse values"'
    assert refused.isos[1].all_remarks == (
        f"{WHY} (withheld: {symbols}; to have it all the same, with a larger error: {option})",
    )
    assert refused.accepted == refused.profile.accepted == ()
    assert "accepted" not in refused.profile.as_dict()
    found = with_findings(isos, *accept_findings([coarse], ["coarse values"]))
    one, whole = found.isos[1], isos[1]
    assert one.withheld == frozenset()
    assert one.widened == {figure}
    assert one.all_remarks == (f"{WHY} (accepted, with a larger error: {symbols})",)
    assert [(accepted.effect, accepted.allowance) for accepted in one.findings] == [("wider", 0.25)]
    assert found.profile.rows == join_isos("TestCamera", isos).profile.rows
    assert whole.parameters == one.parameters

    said = f"coarse values: {symbols} at ISO 400"
    assert found.accepted == found.profile.accepted == (said,)
    assert as_json(found)["accepted"] == [said]
    assert f"accepted, with larger errors\n  {said}" in found.format_text()


def test_what_is_off_by_all_of_itself_cannot_be_accepted() -> None:
    """Nor what a check knows no size of. A level that light has raised is another matter: it is still a level."""
    for refused in (
        finding("row noise", allowance=1.0, check="correlated noise"),
        finding("read noise", allowance=0.0, check="coarse values"),
        finding("gain", allowance=0.1, check="photon transfer"),
    ):
        assert accept_findings([refused], [refused.check]) == (refused,)
        assert "--accept" not in refused.remark
    bias = finding("colour bias", allowance=7.0, check="light")
    (accepted,) = accept_findings([bias], ["light"])
    assert (accepted.effect, accepted.is_accepted, accepted.allowance) == ("wider", True, 7.0)
    assert accept_findings([bias], ["coarse values"]) == (bias,)
