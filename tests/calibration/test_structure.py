"""What the noise of pixels has in common: measured on simulated cameras, made by the model, and judged.

The cameras and the faults planted in them share no code with the model. Figures are held to 4.5 of their standard
errors (a dozen of them: by chance 1 in 1e4 of other seeds); a clean camera's are 0 but for the audit's own chance.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from eldata.calibration.audit.telegraph import two_values
from eldata.calibration.camera import joined
from eldata.cli.main import main
from eldata.noise import CameraProfile, NoiseModel
from tests.calibration.faults import NONE, column_noise, drift, telegraph, together, wave
from tests.calibration.in_memory import ISO
from tests.calibration.judged import Specimen, calibrated, judged
from tests.calibration.simulation import Camera
from tests.calibration.trees import made_tree

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

# Its own shape of the read noise, so that what telegraph pixels do to it shows.
CAMERA = Camera(shape=(288, 384), dsnu=0.0, column_pattern=0.0, hot_share=0.0, prnu=0.01, tukey_lambda=0.1)
LIGHT_DN = (800.0, 2500.0, 5000.0, 9000.0)
ERRORS = 4.5
PRNU = 0.008  # of the demo


def drift_power(camera: Camera, frequency: NDArray[np.float64]) -> NDArray[np.float64]:
    """1/f of the variance of the rows, over the frequencies that a frame has."""
    lines = camera.shape[0]
    every = np.fft.fftfreq(lines)[1:]
    unit = lines * camera.sigma_row**2 / np.sum(1 / np.abs(every))
    power: NDArray[np.float64] = camera.sigma_row**2 + unit / frequency
    return power


def test_every_figure_is_found_and_made() -> None:
    """Columns, drift, telegraph pixels and PRNU at once: the model misses each without its component."""
    specimen = Specimen(CAMERA, together(column_noise(0.4), drift(1.0), telegraph(0.01, 6.0)), seed=3)
    one = calibrated(specimen, LIGHT_DN)
    found = one.structure
    assert found is not None
    assert found.telegraph is not None
    assert found.prnu is not None
    assert found.row_spectrum is not None
    assert found.sigma_column_dn is not None
    sigma = CAMERA.noise.sigma_gauss_dn
    for value, error, truth in (
        (found.sigma_column_dn, found.sigma_column_error_dn, 0.4),
        (found.telegraph.share, found.share_error, 0.01),
        (found.telegraph.amplitude_dn, found.amplitude_error_dn, 6 * sigma),
        (found.telegraph.duty, found.duty_error, 0.5),
        (found.prnu, found.prnu_error, specimen.response.std()),
    ):
        assert abs(value - truth) < ERRORS * error
        assert error < 0.2 * truth
    spectrum = found.row_spectrum
    assert spectrum.waves == ()
    assert len(spectrum.power_dn2) > 5
    frequency = np.asarray(np.fft.rfftfreq(CAMERA.shape[0]), dtype=np.float64)
    for low, high, power, error in zip(
        spectrum.edges_per_row, spectrum.edges_per_row[1:], spectrum.power_dn2, found.band_errors_dn2, strict=False
    ):
        inside = frequency[(frequency > low) & (frequency <= high)]
        assert abs(power - drift_power(CAMERA, inside).mean()) < ERRORS * error
    # The read noise of all pixels has the jumps in it, that of the others is the camera's.
    own = one.read.tukey_lambda + found.telegraph.tukey_lambda_shift
    assert one.read.tukey_lambda < 0.07
    assert own == pytest.approx(0.1, abs=0.015)

    profile = joined("Acme", [one]).profile
    parameters = profile.measured(ISO)
    assert parameters.structure == profile.structure[0]
    every = {"columns", "rows", "pixels", "flats"}
    assert missed(specimen, "P*+G*+B+R", parameters) >= every
    assert missed(specimen, "P*+G*+B+W+C+T+F", parameters).isdisjoint(every)


def missed(specimen: Specimen, spec: str, parameters: Any) -> set[str]:
    """The checks that a model misses; of flats, their fixed pattern alone."""
    found = judged(NoiseModel(spec), specimen, parameters=parameters, flats=(5000.0,), seed=5, pairs=16)
    lit = {"flats" for one in found.off if one.check.startswith("flats") and one.symbol.startswith("fixed pattern")}
    return lit | {one.check for one in found.off if not one.check.startswith("flats")}


def test_a_wave_in_the_rows() -> None:
    """Of 21.7 rows and 1 DN; its phase differs from frame to frame."""
    specimen = Specimen(CAMERA, wave(2.0, 21.7), seed=4)
    one = calibrated(specimen, LIGHT_DN[:2])
    assert one.structure is not None
    assert one.structure.row_spectrum is not None
    (found,) = one.structure.row_spectrum.waves
    assert found.frequency_per_row == pytest.approx(1 / 21.7, abs=0.2 / CAMERA.shape[0])
    assert abs(found.amplitude_dn - 1.0) < ERRORS * one.structure.wave_errors_dn[0]
    for power, error in zip(one.structure.row_spectrum.power_dn2, one.structure.band_errors_dn2, strict=True):
        assert abs(power - 0.25) < ERRORS * error
    assert one.sigma_row_dn is None, "withheld: the rows are not white"
    parameters = joined("Acme", [one]).profile.measured(ISO)
    assert parameters.sigma_row_dn == pytest.approx(math.sqrt(one.structure.row_spectrum.variance_dn2))
    assert "rows" in missed(specimen, "P*+G*+B+R", parameters)
    assert "rows" not in missed(specimen, "P*+G*+B+W", parameters)


def test_nothing_is_found_where_there_is_nothing() -> None:
    """Read noise of heavy tails, with a fixed pattern that stays."""
    camera = CAMERA.with_(prnu=0.0, dsnu=0.6, column_pattern=0.3, tukey_lambda=-0.2)
    found = calibrated(Specimen(camera, NONE, seed=6), LIGHT_DN).structure
    assert found is not None
    assert (found.sigma_column_dn, found.prnu) == (0.0, 0.0)
    assert found.telegraph is not None
    assert found.telegraph.share == 0
    assert found.row_spectrum is not None
    assert found.row_spectrum.waves == ()
    (power,), (error,) = found.row_spectrum.power_dn2, found.band_errors_dn2
    assert abs(power - camera.sigma_row**2) < ERRORS * error
    assert 0 < found.sigma_column_error_dn < 0.1


def test_two_values() -> None:
    for share, step in ((0.01, 2.0), (0.3, 5.0), (0.9, 0.1)):
        second = share * (1 - share) * step**2
        assert two_values(second, second * (1 - 2 * share) * step) == pytest.approx((share, step))


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Demo frames have PRNU and nothing else."""
    tree = made_tree(tmp_path / "tree", isos=(400, 1600), bias_frames=6, flat_levels=2)
    full = tmp_path / "full.json"
    assert main(["calibrate", str(tree.root), "--structure", "-o", str(full)]) == 0
    assert "structure of the noise, for components C, W, T and F" in capsys.readouterr().out
    profile = CameraProfile.load(full)
    assert [one.iso for one in profile.structure] == [400, 1600]
    assert profile.structure[0].prnu == profile.structure[1].prnu == pytest.approx(PRNU, rel=0.02)
    assert {one.sigma_column_dn for one in profile.structure} == {0.0}
