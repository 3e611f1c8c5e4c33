"""The demo: make a dataset, verify it, predict, score, and draw a contact sheet."""

from __future__ import annotations

import math
import shlex
import time
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from eldata.base.files import atomic_write
from eldata.base.numbers import checked_whole, counted
from eldata.baselines.classical import BASELINES
from eldata.baselines.predicting import BaselineDenoiser, write_predictions
from eldata.calibration.joint import fit_log_log
from eldata.demo.camera import CAMERAS, SimulatedCamera
from eldata.demo.scenes import scene_title
from eldata.demo.tree import make_tree, prepare_folder, verify_own
from eldata.errors import EldataError
from eldata.evaluation.evaluate import evaluate
from eldata.evaluation.predictions import load_prediction
from eldata.isp.rendering import preview
from eldata.noise.parameters import tukey_lambda_variance
from eldata.noise.profile import CameraProfile, ProfileRow
from eldata.raw.levels import packed_frame
from eldata.raw.reading import read_raw

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from eldata.evaluation.results import EvaluationResult

INPUT = "amplified"
_GAUSSIAN_SHAPE = 0.14  # lambda at which the Tukey-lambda distribution is nearest to the normal one

# Of the contact sheet, in pixels, and its colours; the middle of each picture is shown twice as large.
_MARGIN = 16
_CAPTION = 26
_ENLARGED = 2
_INK, _PAPER = (225, 225, 225), (24, 24, 26)


def run_demo(folder: Path, *, scenes: int = 4, seed: int = 0, beside: str = "dct") -> dict[str, EvaluationResult]:
    """Run the demo into a folder, printing what happens; return the results of ``amplified``, ``dct`` and ``network``.

    ``beside`` is the baseline to compare the network with, by default ``dct``.

    Raises
    ------
    EldataError
        If the folder holds something that no demo made, or ``scenes`` is not positive.
    """
    checked_whole("scenes", scenes, at_least=1)
    checked_whole("seed", seed)
    start = time.perf_counter()
    prepare_folder(folder)
    manifest = make_tree(folder, scenes=scenes, seed=seed)
    root = folder / "data"
    of = f"{counted(scenes, 'scene')} and {len(manifest.card.cameras)} cameras"
    print(f"{len(manifest.records)} raw files (DNG) of {of}: {root}")

    at_root = f"--root {shlex.quote(str(root))}"
    verify_own(manifest, root)
    predictions = folder / "predictions"
    isos = sorted({int(record.iso) for record in manifest.records if record.iso is not None})
    profiles = {folder / "profiles" / f"{camera.name}.json": known_profile(camera, isos) for camera in CAMERAS}
    (folder / "profiles").mkdir(exist_ok=True)
    for path, profile in profiles.items():
        profile.save(path)
    listed = shlex.quote(str(manifest.path))
    given = " ".join(f"--profile {shlex.quote(str(path))}" for path in profiles)
    methods = {
        INPUT: "the noisy input times the exposure ratio, nothing else",
        beside: f"{BASELINES[beside].title}, which knows the noise of each camera",
        "network": "the network that ships with eldata, which is told each camera's noise and has seen neither",
    }
    for name in (beside, "network"):
        made = shlex.quote(str(predictions / name))
        print(f"\n$ eldata baseline {name} {given} --manifest {listed} {at_root} -o {made}")
        denoiser = BaselineDenoiser(name, tuple(map(CameraProfile.load, profiles)))
        report = write_predictions(denoiser, "", predictions / name, manifest=manifest.path, root=root)
        print(report.format_text())
        if report.problems:
            raise EldataError("the demo's own files could not be denoised")
    results: dict[str, EvaluationResult] = {}
    for name, what in methods.items():
        told = [note for result in results.values() for note in result.notes]
        results[name] = score_method(folder, name, what, None if name == INPUT else predictions / name, told)

    sheet = folder / "contact-sheet.png"
    _draw_sheet(sheet, manifest.folder(root), predictions, results)
    print(f"\nTo look at: {sheet}. Scores of each image: {folder}/*.csv. Took {time.perf_counter() - start:.0f} s.")
    page, place = (shlex.quote(str(folder / name)) for name in ("page.html", "predictions/network"))
    files = " ".join(shlex.quote(str(folder / f"{name}.json")) for name in results)
    print(f"Next:\n$ eldata evaluate {place} --manifest {listed} {at_root} --html {page}")
    print(f"$ eldata compare {files}\n$ eldata demo {shlex.quote(str(folder))} --train")
    return results


def score_method(
    folder: Path, name: str, what: str, place: Path | None, told: Collection[str] = ()
) -> EvaluationResult:
    """Score predictions of a demo's set, or with no place its input; print command and table, write ``<name>.csv``.

    Parameters
    ----------
    folder
        Of the demo.
    name, what
        The method's, and a line that says what it is.
    place
        Folder of the predictions.
    told
        Notes that are not printed again.
    """
    manifest, root = folder / "manifests" / "eld-demo.csv", folder / "data"
    print(f"\n{name}: {what}")
    scored = "--baseline input" if place is None else shlex.quote(str(place))
    print(f"$ eldata evaluate {scored} --manifest {shlex.quote(str(manifest))} --root {shlex.quote(str(root))}")
    result = evaluate(place, manifest=manifest, root=root, baseline="input" if place is None else None)
    print(replace(result, notes=tuple(note for note in result.notes if note not in told)).format_text())
    result.write_csv(folder / f"{name}.csv")
    result.write_json(folder / f"{name}.json")
    return result


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
                tukey_lambda=_GAUSSIAN_SHAPE,
                colour_bias_dn=(red, green, blue, second_green),
                iso=float(iso),
                gain_dn_per_e=gain,
                sigma_tl_dn=read / math.sqrt(tukey_lambda_variance(_GAUSSIAN_SHAPE)),
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


# --- the contact sheet ------------------------------------------------------------------------------------------------


def _draw_sheet(path: Path, folder: Path, predictions: Path, results: dict[str, EvaluationResult]) -> None:
    """Draw each scene once, cameras in turn, at the middle ISO and the larger factor."""
    pairs = next(iter(results.values())).units
    cameras = list(dict.fromkeys(pair.camera for pair in pairs))
    scenes = list(dict.fromkeys(pair.scene for pair in pairs))
    rows = []
    for index, scene in enumerate(scenes):
        camera = cameras[index % len(cameras)]
        pair = next(p for p in pairs if p.camera == camera and p.scene == scene and p.iso == 1600 and p.ratio == 200)
        reference = read_raw(folder / str(pair.reference))
        target = packed_frame(reference, levels="published", clip="both")
        title = scene_title(int(scene.removeprefix("scene-")))
        row = [(f"{title}, {camera}: reference, ISO 100", _enlarge_middle(preview(target, reference.sensor)))]
        noisy = packed_frame(read_raw(folder / pair.path), levels="published", clip="both", gain=float(pair.ratio or 1))
        for name, result in results.items():
            file = (predictions / name / pair.path).with_suffix(".npy")
            prediction = noisy if name == INPUT else load_prediction(file, reference.sensor, "published")
            score = next(image for image in result.scores if image.path == pair.path)
            caption = f"{name}, ISO 1600 x200: {score.psnr_db:.1f} dB, SSIM {score.ssim:.2f}"
            row.append((caption, _enlarge_middle(preview(prediction * score.rescale, reference.sensor))))
        rows.append(row)
    write_contact_sheet(path, rows)


def _enlarge_middle(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the middle of a picture in the size of the whole, so that a difference in detail is seen."""
    size = picture.shape[1], picture.shape[0]
    left, top = ((length - length / _ENLARGED) / 2 for length in size)
    box = left, top, size[0] - left, size[1] - top
    return np.asarray(Image.fromarray(picture).resize(size, Image.Resampling.BICUBIC, box=box))


def write_contact_sheet(path: Path, rows: Sequence[Sequence[tuple[str, NDArray[np.uint8]]]]) -> None:
    """Write rows of captioned pictures, each (h, w, 3) uint8 and all of one size, as a PNG, whole or not at all."""
    height, width = rows[0][0][1].shape[:2]
    columns = max(len(row) for row in rows)
    cell_height, cell_width = height + _CAPTION + _MARGIN, width + _MARGIN
    sheet = Image.new("RGB", (columns * cell_width + _MARGIN, len(rows) * cell_height + _MARGIN), _PAPER)
    draw = ImageDraw.Draw(sheet)
    font = ImageFont.load_default(size=15)
    for y, row in enumerate(rows):
        for x, (caption, picture) in enumerate(row):
            left, top = _MARGIN + x * cell_width, _MARGIN + y * cell_height
            draw.text((left, top), caption, fill=_INK, font=font)
            sheet.paste(Image.fromarray(picture), (left, top + _CAPTION))
    with atomic_write(path) as file:
        sheet.save(file, "PNG")
