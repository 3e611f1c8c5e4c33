"""Write st_rred.json with scikit-video and pyrtools, which the project itself does not need.

scikit-video 1.1.11 (2018) uses names that numpy has dropped, so its source is patched in memory: ``np.int`` becomes
``int``, and the unused imports of ``scipy.misc`` and ``..utils`` go. It computes in float32 on purpose; the reference
values are made with ``np.float32`` replaced by ``np.float64``, so that they show the method and not its rounding. The
score of the package as it is, in float32, is kept beside them.

Run from the root of the repository::

    python3.11 -m venv /tmp/oracle
    /tmp/oracle/bin/pip install "numpy==1.26.4" "scipy==1.12.0" "pyrtools==1.1.1"
    /tmp/oracle/bin/pip install --no-deps "scikit-video==1.1.11"
    OPENBLAS_NUM_THREADS=1 PYTHONPATH=. /tmp/oracle/bin/python tests/metrics/golden/st_rred_generate.py
"""

from __future__ import annotations

import importlib.metadata
import json
import re
import types
from pathlib import Path
from typing import Any

import numpy as np

from tests.metrics.golden.st_rred_clips import BAND_IMAGE, CASES, Clip

TARGET = Path(__file__).with_name("st_rred.json")
PACKAGES = ("numpy", "scipy", "scikit-video", "pyrtools")


def scikit_video(*, patches: dict[str, str]) -> Any:
    """Return a module with scikit-video's strred, rgb2gray and what they use, after ``patches``."""
    distribution = importlib.metadata.distribution("scikit-video")

    def text(name: str) -> str:
        return Path(str(distribution.locate_file(f"skvideo/{name}"))).read_text(encoding="utf-8")

    utilities = text("utils/__init__.py")
    source = "\n".join(
        [
            text("utils/stpyr.py"),
            utilities[utilities.index("def vshape") : utilities.index("__all__")],
            text("measure/strred.py"),
        ]
    )
    for old, new in {"import scipy.misc as sc": "", r"from \.\.utils import \*": "", **patches}.items():
        source = re.sub(old, new, source)
    module = types.ModuleType("scikit_video_strred")
    exec(compile(source, module.__name__, "exec"), module.__dict__)  # noqa: S102 (how a patched copy is loaded)
    return module


def grey(module: Any, clip: Clip) -> Clip:
    """The reduction of util/index.py in github.com/Vandermode/ELD (39846c7): RGBG to linear RGB to rgb2gray."""
    if clip.ndim == 3:
        return clip
    red, green_1, blue, green_2 = np.moveaxis(clip, 1, 0)
    rgb = np.stack([red, (green_1 + green_2) / 2, blue], axis=-1)
    return np.asarray(module.rgb2gray(rgb)[..., 0])


def band_of_pyrtools() -> list[list[float]]:
    """The authors' MATLAB release names its band "4": from the coarsest level, counted backwards, the fourth of six."""
    import pyrtools  # type: ignore[import-not-found]

    pyramid = pyrtools.pyramids.SteerablePyramidSpace(BAND_IMAGE, height=4, order=5, edge_type="reflect1")
    return [[float(value) for value in row] for row in pyramid.pyr_coeffs[3, 3]]


def main() -> None:
    integers = {r"np\.int\b": "int"}
    narrow = scikit_video(patches=integers)
    wide = scikit_video(patches={**integers, r"np\.float32\b": "np.float64"})
    cases = {}
    for case in CASES:
        prediction, reference = (case.peak * grey(wide, clip) for clip in case.make())
        pairs, score, _ = wide.strred(reference, prediction)
        cases[case.name] = {
            "spatial_pairs": pairs[:, 0].tolist(),
            "temporal_pairs": pairs[:, 1].tolist(),
            "st_rred": float(score),
            "st_rred_float32": float(narrow.strred(reference, prediction)[1]),
        }
    document = {
        "provenance": {
            "made by": "tests/metrics/golden/st_rred_generate.py, which says how",
            "implementation": "skvideo.measure.strred in float64; the band: pyrtools.pyramids.SteerablePyramidSpace",
            "versions": {name: importlib.metadata.version(name) for name in PACKAGES},
        },
        "cases": cases,
        "band": band_of_pyrtools(),
    }
    TARGET.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
