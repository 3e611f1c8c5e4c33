"""How well one photograph tells gain and read noise: ``python -m tests.calibration.one_image_study``.

The demo's scenes 1 to 6 by its two simulated cameras, at several exposures: bias, coverage of the errors, and what is
refused; then the first frames with their noise filtered. docs/calibration.md sums the tables up.
"""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import convolve1d

from eldata.base.tables import text_table
from eldata.calibration import estimate_profile, noise_line
from eldata.demo.camera import CAMERAS
from eldata.demo.scenes import scene_radiance
from eldata.errors import DatasetError
from eldata.raw import pack
from eldata.records import Exposure, RawFrame

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from eldata.demo.camera import SimulatedCamera

SIZE = (512, 768)
SCENES = range(1, 7)
EXPOSURES = ((100, 1), (800, 1), (800, 10), (3200, 1), (3200, 10), (3200, 100), (6400, 10), (6400, 200))
SEEDS = range(4)
KERNELS = {
    "neighbours mixed, 3 %": (0.03, 0.94, 0.03),
    "5 %": (0.05, 0.9, 0.05),
    "10 %": (0.1, 0.8, 0.1),
    "sharpened, 5 %": (-0.05, 1.1, -0.05),
    "15 %": (-0.15, 1.3, -0.15),
}


def photographs(iso: int, ratio: int, seed: int) -> list[tuple[SimulatedCamera, NDArray[np.uint16]]]:
    return [
        (camera, camera.photograph(scene_radiance(scene, *SIZE), Fraction(100, iso * ratio), iso, generator))
        for index, camera in enumerate(one.with_size(*SIZE) for one in CAMERAS)
        for scene in SCENES
        for generator in [np.random.default_rng([seed, index, scene, iso, ratio])]
    ]


def within(deviations: NDArray[np.float64], errors: float) -> str:
    return f"{np.mean(np.abs(deviations) < errors):.0%}"


def main() -> None:
    rows = []
    for iso, ratio in EXPOSURES:
        gains, reads, refused, no_read, no_gain = [], [], 0, 0, 0
        for camera, mosaic in (one for seed in SEEDS for one in photographs(iso, ratio, seed)):
            frame = RawFrame(Path("none"), mosaic, camera.sensor, Exposure(iso=Fraction(iso)))
            found = estimate_profile(frame, source="pixels").measured
            if found is None:
                refused += 1
                continue
            assert found.gain_error is not None
            assert found.variance_error is not None
            gain = camera.gain_dn_per_e(iso)
            variance = (gain * camera.sigma_read_e) ** 2 + camera.sigma_quantiser_dn**2
            no_gain += found.gain_dn_per_e < 2 * found.gain_error
            no_read += found.variance_dn2 < 2 * found.variance_error
            gains.append((found.gain_dn_per_e / gain - 1, found.gain_error / gain))
            reads.append((found.variance_dn2 / variance - 1, found.variance_error / variance))
        gain_off, gain_error = np.array(gains).T
        read_off, read_error = np.array(reads).T
        rows.append(
            (
                f"{iso}",
                f"{ratio}",
                *(f"{np.mean(gain_off):+.1%}", f"{np.std(gain_off):.1%}", f"{np.median(gain_error):.1%}"),
                *(within(gain_off / gain_error, errors) for errors in (1, 2, 3)),
                *(f"{np.median(read_off):+.1%}", f"{np.median(read_error):.1%}"),
                *(within(read_off / read_error, errors) for errors in (1, 2, 3)),
                *(f"{no_read}", f"{no_gain}", f"{refused}"),
            )
        )
    header = ("ISO", "ratio", "K off", "spread", "error", "1", "2", "3", "var. off", "error", "1", "2", "3")
    print(text_table((*header, "no read noise", "no K", "refused"), rows))
    for name, kernel in KERNELS.items():
        passed = total = 0
        for iso, ratio in EXPOSURES[1:]:
            for camera, mosaic in photographs(iso, ratio, 0):
                packed = pack(mosaic, camera.sensor.cfa) - np.array(camera.sensor.black_level_dn).reshape(4, 1, 1)
                for axis in (1, 2):
                    packed = convolve1d(packed, kernel, axis=axis)
                total += 1
                try:
                    noise_line(np.rint(packed))
                    passed += 1
                except DatasetError:
                    pass
        print(f"{name}: {total - passed} of {total} refused")


if __name__ == "__main__":
    main()
