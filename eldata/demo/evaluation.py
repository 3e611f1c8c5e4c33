"""The demo: make a dataset, verify it, predict, score, and draw a contact sheet."""

from __future__ import annotations

import shlex
import time
from typing import TYPE_CHECKING

from eldata.baselines.networks import load_network
from eldata.baselines.predicting import BaselineDenoiser, write_predictions
from eldata.demo.camera import CAMERAS
from eldata.demo.contact_sheet import write_contact_sheet
from eldata.demo.folder import prepare_folder
from eldata.demo.known_profile import known_profile
from eldata.demo.scenes import scene_title
from eldata.demo.tree import make_tree
from eldata.errors import EldataError
from eldata.evaluation.evaluate import evaluate
from eldata.evaluation.predictions import load_prediction
from eldata.isp.preview import preview
from eldata.manifest.verify import verify
from eldata.noise.profile import CameraProfile
from eldata.raw.levels import packed_frame
from eldata.raw.reading import read_raw

if TYPE_CHECKING:
    from pathlib import Path

    from eldata.baselines.predicting import Denoiser
    from eldata.evaluation.results import EvaluationResult
    from eldata.manifest.catalogue import Manifest

_INPUT = "amplified"
_SCORED = {
    _INPUT: "the noisy input times the exposure ratio, nothing else",
    "dct": "sliding-window DCT thresholding, which knows the noise of each camera",
    "unet": "the small network that ships with eldata, trained on the noise of virtual cameras alone",
}
_NETWORK = "eldata.baselines:reference_network"


def run_demo(folder: Path, *, scenes: int = 4, seed: int = 0) -> dict[str, EvaluationResult]:
    """Run the demo into a folder, printing what happens; return the results of ``amplified``, ``dct`` and ``unet``.

    Raises
    ------
    EldataError
        If the folder holds something that no demo made, or ``scenes`` is not positive.
    """
    if scenes < 1:
        raise EldataError(f"scenes must be 1 or more; found {scenes}")
    if seed < 0:
        raise EldataError(f"seed must be 0 or more; found {seed}")
    start = time.perf_counter()
    prepare_folder(folder)
    manifest = make_tree(folder, scenes=scenes, seed=seed)
    root = folder / "data"
    print(
        f"{len(manifest.records)} raw files (DNG) of {scenes} scenes and {len(manifest.card.cameras)} cameras: {root}"
    )

    at_root = f"--root {shlex.quote(str(root))}"
    print(f"\n$ eldata verify {shlex.quote(str(folder / 'manifests'))} {at_root} --level metadata")
    verified = verify([manifest], root, level="metadata")
    print(verified.format_text())
    if not verified.ok:
        raise EldataError("the demo's own files do not verify")

    predictions = folder / "predictions"
    profiles = _write_profiles(folder, manifest)
    listed = shlex.quote(str(manifest.path))
    given = " ".join(f"--profile {shlex.quote(str(path))}" for path in profiles)
    denoisers: dict[str, tuple[str, Denoiser]] = {
        "dct": (f"baseline dct {given}", BaselineDenoiser("dct", tuple(map(CameraProfile.load, profiles)))),
        "unet": (f"predict {_NETWORK}", load_network(_NETWORK, device="cpu")),
    }
    for name, (command, denoiser) in denoisers.items():
        made = shlex.quote(str(predictions / name))
        print(f"\n$ eldata {command} --manifest {listed} {at_root} -o {made}")
        report = write_predictions(denoiser, "", predictions / name, manifest=manifest.path, root=root)
        print(report.format_text())
        if report.problems:
            raise EldataError("the demo's own files could not be denoised")
    results = {}
    for name, what in _SCORED.items():
        place = None if name == _INPUT else predictions / name
        print(f"\n{name}: {what}")
        scored = "--baseline input" if place is None else shlex.quote(str(place))
        print(f"$ eldata evaluate {scored} --manifest {listed} {at_root}")
        results[name] = evaluate(place, manifest=manifest.path, root=root, baseline="input" if place is None else None)
        print(results[name].format_text())
        results[name].write_csv(folder / f"{name}.csv")
        results[name].write_json(folder / f"{name}.json")

    sheet = folder / "contact-sheet.png"
    _draw(sheet, manifest.folder(root), predictions, results)
    print(f"\nTo look at: {sheet}. Scores of each image: {folder}/*.csv. Took {time.perf_counter() - start:.0f} s.")
    return results


def _write_profiles(folder: Path, manifest: Manifest) -> list[Path]:
    """Write what is known of the cameras' noise; return the files."""
    isos = sorted({int(record.iso) for record in manifest.records if record.iso is not None})
    (folder / "profiles").mkdir(exist_ok=True)
    files = []
    for camera in CAMERAS:
        files.append(folder / "profiles" / f"{camera.name}.json")
        known_profile(camera, isos).save(files[-1])
    return files


def _draw(path: Path, folder: Path, predictions: Path, results: dict[str, EvaluationResult]) -> None:
    """Draw each scene once, cameras in turn, at the middle ISO and the larger factor."""
    pairs = next(iter(results.values())).pairs
    cameras = list(dict.fromkeys(pair.camera for pair in pairs))
    scenes = list(dict.fromkeys(pair.scene for pair in pairs))
    rows = []
    for index, scene in enumerate(scenes):
        camera = cameras[index % len(cameras)]
        pair = next(p for p in pairs if p.camera == camera and p.scene == scene and p.iso == 1600 and p.ratio == 200)
        reference = read_raw(folder / pair.reference)
        target = packed_frame(reference, levels="published", clip="both")
        title = scene_title(int(scene.removeprefix("scene-")))
        row = [(f"{title}, {camera}: reference, ISO 100", preview(target, reference.sensor))]
        noisy = packed_frame(read_raw(folder / pair.path), levels="published", clip="both", gain=float(pair.ratio or 1))
        for name, result in results.items():
            file = (predictions / name / pair.path).with_suffix(".npy")
            prediction = noisy if name == _INPUT else load_prediction(file, reference.sensor, "published")
            score = next(image for image in result.images if image.path == pair.path)
            caption = f"{name}, ISO 1600 x200: {score.psnr_db:.1f} dB, SSIM {score.ssim:.2f}"
            row.append((caption, preview(prediction * score.rescale, reference.sensor)))
        rows.append(row)
    write_contact_sheet(path, rows)
