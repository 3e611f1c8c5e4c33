"""How well structure is told from bias frames and flats: ``python -m tests.calibration.structure_study``.

Simulated cameras of 288 x 384 pixels, nine bias frames and three pairs of flats: what is claimed of clean ones, and of
planted structure the mean of the figures over their truth, their scatter in stated errors, and how often it is found.
docs/calibration.md sums the tables up.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from eldata.base.tables import text_table
from tests.calibration.faults import NONE, Planted, column_noise, drift, telegraph, together
from tests.calibration.judged import Specimen, calibrated
from tests.calibration.simulation import Camera

if TYPE_CHECKING:
    from eldata.calibration.audit.structure import MeasuredStructure

CAMERA = Camera(shape=(288, 384), hot_share=0.0)
LIGHT_DN = (1000.0, 4000.0, 9000.0)
CLEAN = 30
PLANTED = 8


def measured(specimen: Specimen) -> MeasuredStructure:
    found = calibrated(specimen, LIGHT_DN, specimen.seed).structure
    assert found is not None
    return found


def clean() -> None:
    claims = dict.fromkeys(("C", "W", "T", "F"), 0)
    runs = 0
    for shape in (-0.2, -0.05, 0.15):
        for seed in range(CLEAN // 3):
            found = measured(Specimen(CAMERA.with_(tukey_lambda=shape, prnu=0.0), NONE, seed))
            runs += 1
            claims["C"] += bool(found.sigma_column_dn)
            claims["W"] += found.row_spectrum is None or len(found.row_spectrum.power_dn2) > 1
            claims["T"] += found.telegraph is not None and found.telegraph.share > 0
            claims["F"] += bool(found.prnu)
    print(f"clean cameras: {runs}; claimed: {claims}\n")


def planted(name: str, fault: Planted, truths: dict[str, float], camera: Camera = CAMERA) -> list[tuple[str, ...]]:
    values: dict[str, list[tuple[float, float]]] = {figure: [] for figure in truths}
    for seed in range(PLANTED):
        found = measured(Specimen(camera, fault, seed))
        jumping = found.telegraph
        pairs = {
            "sigma_column": (found.sigma_column_dn, found.sigma_column_error_dn),
            "PRNU": (found.prnu, found.prnu_error),
        }
        if jumping is not None:
            pairs |= {
                "share": (jumping.share, found.share_error),
                "jump": (jumping.amplitude_dn, found.amplitude_error_dn),
                "duty": (jumping.duty if jumping.share else 0.0, found.duty_error),
            }
        if found.row_spectrum is not None and len(found.row_spectrum.power_dn2) > 1:
            pairs["slowest band"] = (found.row_spectrum.power_dn2[1], found.band_errors_dn2[1])
        for figure in truths:
            value, error = pairs.get(figure, (0.0, 0.0))
            if value:
                values[figure].append((value, error))
    rows: list[tuple[str, ...]] = []
    for figure, truth in truths.items():
        if not values[figure]:
            rows.append((name, figure, f"{truth:.4g}", "-", "-", "-", f"0 of {PLANTED}"))
            continue
        value, error = np.array(values[figure]).T
        off = (value - truth) / error
        rows.append(
            (
                *(name, figure, f"{truth:.4g}", f"{value.mean() / truth - 1:+.1%}", f"{np.median(error) / truth:.1%}"),
                *(f"{off.mean():+.1f} +- {off.std():.1f}", f"{len(value)} of {PLANTED}"),
            )
        )
    return rows


def main() -> None:
    clean()
    sigma = CAMERA.noise.sigma_gauss_dn
    rows = []
    rows += planted("columns, 0.1 DN", column_noise(0.1), {"sigma_column": 0.1})
    for share, jump in ((0.01, 5.0), (0.003, 8.0), (0.001, 5.0)):
        truths = {"share": share, "jump": jump * sigma, "duty": 0.5}
        rows += planted(f"telegraph pixels, {share:.2%}, {jump:g} sigma", telegraph(share, jump), truths)
    rows += planted("PRNU 0.2 %", NONE, {"PRNU": 0.002}, CAMERA.with_(prnu=0.002))
    both = together(column_noise(0.4), drift(1.0), telegraph(0.01, 6.0))
    rows += planted("all at once", both, {"sigma_column": 0.4, "share": 0.01, "jump": 6 * sigma, "PRNU": 0.01})
    header = ("planted", "figure", "truth", "mean off", "stated error", "off, in errors", "found")
    print(text_table(header, rows, left=(0, 1)))


if __name__ == "__main__":
    main()
