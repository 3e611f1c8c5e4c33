"""The profile of a simulated camera, as a calibration without errors would find it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from eldata.calibration.joint import fit_log_log
from eldata.calibration.one_photograph.estimate import GAUSSIAN_SHAPE
from eldata.noise.gain_modes import ProfileRow
from eldata.noise.parameters import tukey_lambda_variance
from eldata.noise.profile import CameraProfile

if TYPE_CHECKING:
    from collections.abc import Sequence

    from eldata.demo.camera import SimulatedCamera


def known_profile(camera: SimulatedCamera, isos: Sequence[int]) -> CameraProfile:
    """Return a camera's noise at three ISOs or more, rising; lines between them.

    Parameters
    ----------
    camera
        Whose figures are taken as they are.
    isos
        Of the rows.
    """
    rows = []
    for iso in isos:
        gain = camera.gain_dn_per_e(iso)
        read = math.hypot(gain * camera.sigma_read_e, camera.sigma_quantiser_dn)
        red, green, blue, second_green = (gain * bias for bias in camera.colour_bias_e)
        rows.append(
            ProfileRow(
                tukey_lambda=GAUSSIAN_SHAPE,
                colour_bias_dn=(red, green, blue, second_green),
                iso=float(iso),
                gain_dn_per_e=gain,
                sigma_tl_dn=read / math.sqrt(tukey_lambda_variance(GAUSSIAN_SHAPE)),
                sigma_gauss_dn=read,
                sigma_row_dn=gain * camera.sigma_row_e,
            )
        )
    gains = [row.gain_dn_per_e or 0.0 for row in rows]
    scales = zip(*((row.sigma_tl_dn, row.sigma_gauss_dn, row.sigma_row_dn) for row in rows), strict=True)
    lines = [fit_log_log(gains, [scale or 0.0 for scale in of_all]).fit for of_all in scales]
    return CameraProfile(
        camera=camera.name,
        source="eldata.demo: known, not measured",
        gain_range_dn_per_e=(gains[0], gains[-1]),
        tukey_lambda_fit=lines[0],
        gauss_fit=lines[1],
        row_fit=lines[2],
        rows=tuple(rows),
        iso_range=(float(isos[0]), float(isos[-1])),
        black_level_dn=max(camera.sensor.black_level_dn),
        white_level_dn=camera.sensor.white_level_dn,
    )
