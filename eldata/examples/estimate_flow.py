"""`python -m eldata.examples.estimate_flow`: make a set that moves, for optical flow as a task of `eldata evaluate`.

The demo's camera photographs the set, and turns from moment to moment. The task is how far the motion between two
denoised frames is from that between their references.

    python -m eldata.examples.estimate_flow eldata-moving
    eldata evaluate preds --manifest eldata-moving/moving.csv --task eldata.examples.estimate_flow:flow

The end-point error of the paper's section 4.7 (K. Wei et al., TPAMI 2021), with scikit-image's TV-L1 in place of RAFT:
C. Zach, T. Pock and H. Bischof, "A Duality Based Approach for Realtime TV-L1 Optical Flow", DAGM 2007.
"""

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from skimage.color import rgb2gray
from skimage.registration import optical_flow_tvl1

from eldata.base import console
from eldata.demo.camera import CAMERAS
from eldata.demo.scenes import scene_radiance
from eldata.demo.tree import demo_card
from eldata.evaluation import Task
from eldata.manifest.writing import save_manifest
from eldata.raw import write_dng
from eldata.records import Exposure, FrameRecord

Image = NDArray[np.float32]

STEP = (2, 6)  # rows and columns of the mosaic that the camera turns by from moment to moment; renderings have half


def motion(frames: Sequence[Image]) -> NDArray[np.float64]:
    """Return where the pixels of the first of two sRGB frames (3, h, w) are in the second: (2, h, w), rows, columns."""
    first, second = (rgb2gray(frame.transpose(1, 2, 0)) for frame in frames)
    found = optical_flow_tvl1(first, second)  # type: ignore[no-untyped-call] # scikit-image has no types
    return np.asarray(found, np.float64)


def endpoint_error(predictions: Sequence[Image], references: Sequence[Image]) -> float:
    """Return the mean distance in pixels between the motion in two predictions and that in their references.

    Parameters
    ----------
    predictions, references
        Of two consecutive frames, (3, h, w) sRGB in [0, 1] each.
    """
    return float(np.linalg.norm(motion(predictions) - motion(references), axis=0).mean())


flow = Task(endpoint_error, images="srgb", higher_is_better=False, label="EPE [px]", frames=2)


def photograph(folder: Path, scenes: int = 4, moments: int = 3, size: tuple[int, int] = (512, 768)) -> Path:
    """Write sequences of a turning camera, a noisy frame and its reference a moment; return their manifest."""
    camera, metered_s, rows = CAMERAS[0].with_size(*size), Fraction(4), []
    for scene, moment in product(range(1, scenes + 1), range(1, moments + 1)):
        wide = scene_radiance(scene, *(side + moments * step for side, step in zip(size, STEP, strict=True)))
        top, left = (step * (moment - 1) for step in STEP)
        seen = wide[:, top : top + size[0], left : left + size[1]]
        name = f"scene-{scene}-moment-{moment}"
        clean = FrameRecord(f"{name}/clean.dng", "reference", camera.name, name, "test", Fraction(100), metered_s)
        noisy = replace(clean, path=f"{name}/noisy.dng", role="noisy", iso=Fraction(800), exposure_s=metered_s / 800)
        rows += [clean, replace(noisy, ratio=Fraction(100), reference=clean.path)]
        (folder / "moving" / name).mkdir(parents=True, exist_ok=True)
        for row, iso, exposure_s in ((clean, 100, metered_s), (noisy, 800, metered_s / 800)):
            mosaic = camera.photograph(seen, exposure_s / metered_s, iso, np.random.default_rng([scene, moment, iso]))
            exposure = Exposure(Fraction(iso), exposure_s, Fraction(4))
            write_dng(folder / "moving" / row.path, mosaic, camera.sensor, exposure)
    card = demo_card("moving", "A camera that turns", "moving", {camera.name: camera.sensor}, rows, "simulated")
    return save_manifest(folder / "moving.csv", replace(card, protocol="sequences"), rows).path


if __name__ == "__main__":
    parser = console.document(console.Parser(prog="python -m eldata.examples.estimate_flow"), __doc__)
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="of the set; the demo's camera turns in it")
    print(photograph(parser.parse_args().folder))
