"""The calibration demo: frames of a camera whose noise is known, its calibration, and both side by side."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

from eldata.base.fields import TextFile
from eldata.base.files import write_text
from eldata.base.tables import text_table
from eldata.base.workers import IN_THIS_PROCESS, Workers
from eldata.calibration.camera import calibrate
from eldata.datasets.calibration_frames import CalibrationFrames
from eldata.demo.calibration_frames import DEMO_FEATURES, DEMO_GAMMA, make_calibration_frames
from eldata.demo.folder import prepare_folder
from eldata.errors import EldataError
from eldata.reports.calibration.page import calibration_page

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from eldata.calibration.results import Calibration, IsoCalibration
    from eldata.demo.body import FixedFeatures


def run_calibration_demo(
    folder: Path, *, seed: int = 0, features: FixedFeatures = DEMO_FEATURES, workers: Workers = IN_THIS_PROCESS
) -> Calibration:
    """Make calibration frames in a folder, calibrate from them and compare with the truth, printing what happens.

    Parameters
    ----------
    folder
        New, empty, or an earlier demo's.
    seed
        Of the simulated camera.
    features
        What stays the same from frame to frame.
    workers
        What runs the work.

    Raises
    ------
    EldataError
        If the folder holds something that no demo made, or ``seed`` is negative.
    """
    if seed < 0:
        raise EldataError(f"seed must be 0 or more; found {seed}")
    start = time.perf_counter()
    prepare_folder(folder)
    camera = DEMO_GAMMA
    manifest = make_calibration_frames(folder, camera=camera, seed=seed, features=features, workers=workers)
    data = folder / "data" / "calibration"
    print(f"{len(manifest.records)} raw files (DNG), bias and flat-field frames of {camera.name}: {data / camera.name}")

    profile, report = folder / f"{camera.name}.json", folder / "calibration.html"
    print(f"\n$ eldata calibrate {data} --camera {camera.name} -o {profile} --html {report}")
    found = calibrate(CalibrationFrames(data, camera.name), workers=workers)
    print(found.format_text())
    found.profile.save(profile)
    write_text(report, calibration_page(found))

    print(f"\nfound - true, in brackets in standard errors (truth: {folder / 'truth.json'})")
    print(against_truth(found, TextFile(folder / "truth.json", EldataError).json().data))
    print(f"\nTo look at: {report}. Took {time.perf_counter() - start:.0f} s.")
    return found


def against_truth(found: Calibration, truth: Mapping[str, Any]) -> str:
    """Return a table of the errors of a calibration.

    Parameters
    ----------
    found
        From frames of :func:`~eldata.demo.calibration_frames.make_calibration_frames`.
    truth
        Their ``truth.json``.
    """
    header = ("ISO", "K [%]", "lambda", "sigma_TL [%]", "sigma_G [%]", "sigma_row [%]", "colour bias [DN]")
    true = {known["iso"]: known for known in truth["isos"]}
    return text_table(header, [_errors(one, true[one.iso]) for one in found.isos], left=())


def _errors(one: IsoCalibration, true: dict[str, Any]) -> tuple[str, ...]:
    read, row = one.read, one.rows.rows
    gain = "-"
    if one.transfer is not None:
        gain = _relative(one.transfer.gain_dn_per_e, true["gain_dn_per_e"], one.transfer.gain_error)
    shape = read.tukey_lambda - true["tukey_lambda"]
    # What the frames hold: the specimen's fixed pattern has a mean of its own.
    offsets = true["colour_bias_with_pattern_dn"]
    bias = max((mean - offset for mean, offset in zip(one.bias.bias_dn, offsets, strict=True)), key=abs)
    return (
        f"{one.iso:g}",
        gain,
        f"{shape:+.4f} ({shape / read.tukey_lambda_error:+.1f})",
        _relative(read.sigma_tl_dn, true["sigma_tl_dn"], read.sigma_tl_error_dn),
        _relative(read.sigma_gauss_dn, true["sigma_gauss_dn"], read.sigma_gauss_error_dn),
        _relative(row.sigma_dn, true["sigma_row_dn"], row.sigma_error_dn),
        f"{bias:+.3f}",
    )


def _relative(found: float, true: float, error: float) -> str:
    return f"{100 * (found / true - 1):+.2f} ({(found - true) / error:+.1f})"
