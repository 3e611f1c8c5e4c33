"""A small CRVD: every name of a manifest, mosaics in TIFF of a few pixels."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import tifffile

from eldata.manifest.catalogue import Manifest

SHAPE = (40, 56)


def build_crvd_tree(manifest: Manifest, folder: Path) -> None:
    """Write the files below a folder; frames of a scene have its light, and noise of their own."""
    for number, row in enumerate(manifest.records):
        path = folder / row.path
        path.parent.mkdir(parents=True, exist_ok=True)
        scene = np.random.default_rng(int(row.scene.removeprefix("scene"))).gamma(2.0, 300.0, SHAPE)
        noise = np.random.default_rng(number).normal(0, 5 if row.role == "reference" else 60, SHAPE)
        tifffile.imwrite(path, np.clip(240 + scene + noise, 0, 4095).astype(np.uint16))
