"""The demo: make a dataset, verify it, predict, score, and draw a contact sheet."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from tqdm import tqdm

from eldata.datasets.eld import ELDDataset
from eldata.demo.contact_sheet import write_contact_sheet
from eldata.demo.denoise import denoise
from eldata.demo.folder import prepare_folder
from eldata.demo.scenes import scene_title
from eldata.demo.tree import make_tree
from eldata.errors import EldataError
from eldata.evaluation.evaluate import evaluate
from eldata.evaluation.predictions import load_prediction, save_prediction
from eldata.isp.preview import preview
from eldata.manifest.verify import verify
from eldata.raw.levels import packed_frame
from eldata.raw.reading import read_raw

if TYPE_CHECKING:
    from pathlib import Path

    from eldata.evaluation.results import EvaluationResult
    from eldata.manifest.catalogue import Manifest

_INPUT = "amplified"
_SCORED = {
    _INPUT: "the noisy input times the exposure ratio, nothing else",
    "dct": "sliding-window DCT thresholding",
}


def run_demo(folder: Path, *, scenes: int = 4, seed: int = 0) -> dict[str, EvaluationResult]:
    """Run the demo into a folder, printing what happens; return the results of ``amplified`` and ``dct``.

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

    print("\n$ eldata verify", f"{folder / 'manifests'} --root {root} --level metadata")
    report = verify([manifest], root, level="metadata")
    print(report.format_text())
    if not report.ok:
        raise EldataError("the demo's own files do not verify")

    predictions = folder / "predictions"
    _predict(manifest, manifest.folder(root), predictions)
    results = {}
    for name, what in _SCORED.items():
        place = None if name == _INPUT else predictions / name
        print(f"\n{name}: {what}")
        print(f"$ eldata evaluate {place or '--baseline input'} --manifest {manifest.path} --root {root}")
        results[name] = evaluate(place, manifest=manifest.path, root=root, baseline="input" if place is None else None)
        print(results[name].format_text())
        results[name].write_csv(folder / f"{name}.csv")
        results[name].write_json(folder / f"{name}.json")

    sheet = folder / "contact-sheet.png"
    _draw(sheet, manifest.folder(root), predictions, results)
    print(f"\nTo look at: {sheet}. Scores of each image: {folder}/*.csv. Took {time.perf_counter() - start:.0f} s.")
    return results


def _predict(manifest: Manifest, folder: Path, predictions: Path) -> None:
    # The denoiser needs the negative half of the read noise, or the dark parts come out too bright.
    unclipped = ELDDataset(folder, manifest=manifest.path, clip="none")
    for index in tqdm(range(len(unclipped)), desc="denoising", unit="frame", disable=None, leave=False):
        sample = unclipped[index]
        save_prediction(predictions / "dct", sample["path"], denoise(sample["input"].numpy()))


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
        denoised = load_prediction((predictions / "dct" / pair.path).with_suffix(".npy"), reference.sensor, "published")
        for (name, result), prediction in zip(results.items(), (noisy, denoised), strict=True):
            score = next(image for image in result.images if image.path == pair.path)
            caption = f"{name}, ISO 1600 x200: {score.psnr_db:.1f} dB, SSIM {score.ssim:.2f}"
            row.append((caption, preview(prediction * score.rescale, reference.sensor)))
        rows.append(row)
    write_contact_sheet(path, rows)
