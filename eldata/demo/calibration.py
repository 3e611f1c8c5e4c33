"""The calibration demo: frames of a camera whose noise is known, its calibration, and both side by side."""

from __future__ import annotations

import shlex
import time
from typing import TYPE_CHECKING, Any

from eldata.base.fields import TextFile
from eldata.base.files import write_text
from eldata.base.numbers import checked_whole
from eldata.base.tables import text_table
from eldata.base.workers import IN_THIS_PROCESS, Workers
from eldata.calibration.camera import calibrate
from eldata.datasets.calibration_frames import CalibrationFrames
from eldata.demo.calibration_frames import DEMO_GAMMA, make_calibration_frames
from eldata.demo.tree import prepare_folder
from eldata.errors import EldataError
from eldata.reports.calibration import calibration_page

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from eldata.calibration.iso_results import IsoCalibration, MeasuredFigure
    from eldata.calibration.results import Calibration


def run_calibration_demo(folder: Path, *, seed: int = 0, workers: Workers = IN_THIS_PROCESS) -> Calibration:
    """Make calibration frames in a folder, calibrate from them and compare with the truth, printing what happens.

    Parameters
    ----------
    folder
        New, empty, or an earlier demo's.
    seed
        Of the simulated camera.
    workers
        What runs the work.

    Raises
    ------
    EldataError
        If the folder holds something that no demo made, or ``seed`` is negative.
    """
    checked_whole("seed", seed)
    start = time.perf_counter()
    prepare_folder(folder)
    camera = DEMO_GAMMA
    manifest = make_calibration_frames(folder, camera=camera, seed=seed, workers=workers)
    data = folder / "data" / "calibration"
    print(f"{len(manifest.records)} raw files (DNG), bias and flat-field frames of {camera.name}: {data / camera.name}")

    profile, report = folder / f"{camera.name}.json", folder / "calibration.html"
    files = f"-o {shlex.quote(str(profile))} --html {shlex.quote(str(report))}"
    print(f"\n$ eldata calibrate {shlex.quote(str(data))} --camera {camera.name} {files}")
    calibration = calibrate(CalibrationFrames(data, camera.name), workers=workers)
    print(calibration.format_text())
    calibration.profile.save(profile)
    write_text(report, calibration_page(calibration))

    print(f"\nfound - true, in brackets in standard errors (truth: {folder / 'truth.json'})")
    print(compare_with_truth(calibration, TextFile(folder / "truth.json", EldataError).json().data))
    print(f"\nTo look at: {report}. Took {time.perf_counter() - start:.0f} s.")
    return calibration


def compare_with_truth(calibration: Calibration, truth: Mapping[str, Any]) -> str:
    """Return a table of the errors of a calibration.

    Parameters
    ----------
    calibration
        From frames of :func:`~eldata.demo.calibration_frames.make_calibration_frames`.
    truth
        Their ``truth.json``.
    """
    header = ("ISO", "K [%]", "lambda", "sigma_TL [%]", "sigma_G [%]", "sigma_row [%]", "colour bias [DN]")
    true = {known["iso"]: known for known in truth["isos"]}
    return text_table(header, [_list_errors(record, true[record.iso]) for record in calibration.isos], left=())


def _list_errors(record: IsoCalibration, true: dict[str, Any]) -> tuple[str, ...]:
    """List the errors of one ISO's figures, as a row of text."""
    shape = "withheld"
    if record.tukey_lambda is not None:
        off = record.tukey_lambda.value - true["tukey_lambda"]
        shape = f"{off:+.4f} ({off / record.tukey_lambda.error:+.1f})"
    bias = "withheld"
    # What the frames hold: the specimen's fixed pattern has a mean of its own.
    offsets = true["colour_bias_with_pattern_dn"]
    if record.colour_bias is not None:
        off = max((mean.value - offset for mean, offset in zip(record.colour_bias, offsets, strict=True)), key=abs)
        bias = f"{off:+.3f}"
    return (
        f"{record.iso:g}",
        "-" if record.transfer is None else _format_error(record.gain, true["gain_dn_per_e"]),
        shape,
        _format_error(record.sigma_tl_dn, true["sigma_tl_dn"]),
        _format_error(record.sigma_gauss_dn, true["sigma_gauss_dn"]),
        _format_error(record.sigma_row_dn, true["sigma_row_dn"]),
        bias,
    )


def _format_error(figure: MeasuredFigure | None, true: float) -> str:
    """Write a figure's relative error in percent and, in brackets, in standard errors."""
    if figure is None:
        return "withheld"
    return f"{100 * (figure.value / true - 1):+.2f} ({(figure.value - true) / figure.error:+.1f})"
