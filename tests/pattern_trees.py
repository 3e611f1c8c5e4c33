"""Small copies of the sets whose rows are patterns: a few of their scenes, in their real layout."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import tifffile

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from eldata.manifest.catalogue import Manifest

SHAPE = (40, 56)
FRAMES, SHOTS = 5, 2
RATIOS = (125, 160)


def draw_mosaic(
    seed: int, black: float, white: float, noise: float, shape: tuple[int, int] = SHAPE
) -> NDArray[np.uint16]:
    """A scene of its own light, (H, W) in DN, with noise; one scene for each hundred seeds."""
    scene = np.random.default_rng(seed // 100).gamma(2.0, (white - black) / 12, shape)
    drawn = black + scene + np.random.default_rng(seed).normal(0, noise, shape)
    return np.clip(np.rint(drawn), 0, white).astype(np.uint16)


def build_recrvd_tree(manifest: Manifest, folder: Path) -> None:
    """Two test scenes and one for training; the folder that no text names is ISO6400 here."""
    del manifest
    for number, scene in enumerate(("flamingo", "goat", "Beauty")):
        for frame in range(1, FRAMES + 1):
            seed = 1000 * number + 100 * frame
            clean = folder / f"wb_scene_clean_postprocessed/{scene}/wb_clean_postprocessed_{frame}.tiff"
            clean.parent.mkdir(parents=True, exist_ok=True)
            tifffile.imwrite(clean, draw_mosaic(seed, 240, 4095, 2))
            for shot in range(SHOTS):
                noisy = folder / f"wb_scene_noisy/{scene}/ISO6400/wb_noisy_{frame}_{shot}.tiff"
                noisy.parent.mkdir(parents=True, exist_ok=True)
                tifffile.imwrite(noisy, draw_mosaic(seed + shot + 1, 240, 4095, 60))


def pack_rows(mosaic: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """(h, w, 4): R, G1, G2, B of an RGGB mosaic, as BRVE's loader stacks them."""
    return np.stack([mosaic[0::2, 0::2], mosaic[0::2, 1::2], mosaic[1::2, 0::2], mosaic[1::2, 1::2]], axis=-1)


def build_llrvd_tree(manifest: Manifest, folder: Path) -> None:
    """A scene for training and one for tests, an array a clip."""
    del manifest
    for scene in (1, 35):
        clean = [draw_mosaic(1000 * scene + 100 * frame, 512, 15360, 10) for frame in range(FRAMES)]
        (folder / f"ratio_gt/{scene}").mkdir(parents=True)
        np.save(folder / f"ratio_gt/{scene}/gt.npy", np.stack([pack_rows(mosaic) for mosaic in clean]))
        for ratio in RATIOS:
            place = folder / f"ratio_noisy_all/{scene}/{ratio}"
            place.mkdir(parents=True)
            generator = np.random.default_rng(scene + ratio)
            dark = [512 + (mosaic - 512.0) / ratio + generator.normal(0, 3, SHAPE) for mosaic in clean]
            np.save(place / "lq.npy", np.stack([pack_rows(np.rint(mosaic).astype(np.uint16)) for mosaic in dark]))


def build_pmrid_tree(manifest: Manifest, folder: Path) -> None:
    """Two exposures of one scene, at the size that every frame of the set has."""
    (facts,) = manifest.card.mosaics
    height, width = facts.shape
    for number, case in enumerate(("exposure-case1", "exposure-case2")):
        place = folder / f"Scene1/Dark/{case}"
        place.mkdir(parents=True)
        for name, noise in (("gt", 20.0), ("input", 900.0)):
            tile = draw_mosaic(100 * number + len(name), 0, 65535, noise, (200, 200)).astype("<u2")
            np.tile(tile, (height // 200, width // 200)).tofile(place / f"{name}.raw")


def build_imx_tree(manifest: Manifest, folder: Path) -> None:
    """Two scenes, of 12 bits; levels and colour filter array are nobody's but the test's."""
    del manifest
    for kind, noise in (("gt", 2.0), ("noisy", 60.0)):
        (folder / "RAW" / kind).mkdir(parents=True)
        for number, name in enumerate(("4Card_Gain160_E30", "Focus_Gain200_E30")):
            np.save(folder / f"RAW/{kind}/{name}_{kind}.npy", draw_mosaic(100 * number + len(kind), 200, 4095, noise))


BUILDERS = {
    "recrvd": build_recrvd_tree, "llrvd": build_llrvd_tree, "pmrid": build_pmrid_tree, "raw-denoise": build_imx_tree,
}  # fmt: skip
