"""Faults planted into simulated sets, and what `capture check` says: `python -m tests.capture.planted_faults --help`.

Scenes of four kinds, none of them the demo's: leaves (discs that cover each other), texture whose power falls with the
square of the frequency, soft light without detail, and bars and small marks. The camera is the demo's. Nothing here
shares code with what it tests.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from capture.check import check
from eldata.demo.camera import CAMERAS
from tests.capture.simulated_scenes import SIZE, Shot, write_scenes

Mishap = Callable[[Shot], Shot]
Digital = Callable[[NDArray[np.uint16]], NDArray[np.uint16]]

KINDS = ("leaves", "texture", "soft", "bars")
FEW = (1, 2, 4, 6, 11, 14, 15, 16)  # references, and noisy frames at x1 and x100 of ISO 800, x1, x100, x200 of ISO 3200
NOISY = (2, 4, 14, 15)
X1 = 2  # ISO 800 x1


# --- scenes -----------------------------------------------------------------------------------------------------------


@lru_cache(maxsize=8)
def picture(scene: int, size: tuple[int, int]) -> NDArray[np.float32]:
    """Return the radiance (3, h, w) of scene n: kinds in turn."""
    generator = np.random.default_rng([77, scene])
    grey = {"leaves": leaves, "texture": texture, "soft": soft, "bars": bars}[KINDS[scene % 4]](generator, size)
    grey = 0.02 + 0.75 * (grey - grey.min()) / np.ptp(grey)
    tints = [
        0.55 + 0.45 * ndimage.zoom(generator.random((4, 5)), (size[0] / 4, size[1] / 5), order=1) for _ in range(3)
    ]
    planes = np.stack([grey * tint[: size[0], : size[1]] for tint in tints])
    return planes.astype(np.float32)


def leaves(generator: np.random.Generator, size: tuple[int, int]) -> NDArray[np.float64]:
    """Discs of all sizes, each over those before it, seen through a lens."""
    rows, columns = np.mgrid[: size[0], : size[1]]
    grey = np.full(size, 0.5)
    for _ in range(500):
        radius = 4 / generator.uniform(0.04, 1) ** 0.8
        inside = (rows - generator.uniform(0, size[0])) ** 2 + (columns - generator.uniform(0, size[1])) ** 2
        grey[inside < radius**2] = generator.random()
    return ndimage.gaussian_filter(grey, 0.9)


def texture(generator: np.random.Generator, size: tuple[int, int]) -> NDArray[np.float64]:
    """Gaussian noise of power 1/f^2, as many photographs have it."""
    frequency = np.hypot(np.fft.fftfreq(size[0])[:, None], np.fft.rfftfreq(size[1]))
    frequency[0, 0] = 1
    return np.fft.irfft2(np.fft.rfft2(generator.normal(size=size)) / frequency, s=size)


def soft(generator: np.random.Generator, size: tuple[int, int]) -> NDArray[np.float64]:
    """Broad shades, and a few soft edges."""
    grey = ndimage.gaussian_filter(generator.normal(size=size), 60)
    return grey / np.ptp(grey) + 0.3 * ndimage.gaussian_filter((leaves(generator, size) > 0.6).astype(float), 5)


def bars(generator: np.random.Generator, size: tuple[int, int]) -> NDArray[np.float64]:
    """Rows of marks as of small print on paper, and bars of several widths."""
    grey = np.full(size, 0.9)
    for row in range(20, size[0] - 20, 14):
        ink = generator.random(size[1] // 3) < 0.45
        grey[row : row + 6] -= 0.75 * np.repeat(ink, 3)[: size[1]]
    width = size[1] // 6
    grey[:, -width:] = 0.5 + 0.4 * np.sign(np.sin(np.cumsum(np.linspace(0.15, 0.9, width))))
    return ndimage.gaussian_filter(grey, 0.8)


# --- faults -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Fault:
    """One mishap: what happens to which frames, and whether it lies above its stated limit (docs/capture.md).

    ``digital`` changes the DN that were read, ``kinds`` are the scenes in which it can be seen at all, ``verdict`` is
    the least that is to be said of the scene, "keep": nothing has to be.
    """

    name: str
    mishaps: Mapping[int, Mishap] = field(default_factory=dict)
    digital: Mapping[int, Digital] = field(default_factory=dict)
    verdict: str = "shoot again"
    kinds: tuple[str, ...] = KINDS


def moved(pixels: float) -> Mishap:
    """Move the camera, in a direction between rows and columns."""
    return lambda shot: shot.moved(0.6 * pixels, -0.8 * pixels)


def lit(percent: float) -> Mishap:
    """Change the light."""
    return lambda shot: shot.lit(1 + percent / 100)


def shutter(stops: Fraction) -> Mishap:
    """Expose longer than EXIF says."""
    return lambda shot: replace(shot, exposure_s=shot.exposure_s * Fraction(2 ** float(stops)).limit_denominator(10**6))


def object_moved(shot: Shot) -> Shot:
    """Move a part of the scene, a tenth of its height and width, by 12 pixels."""
    planes, (height, width) = shot.radiance.copy(), SIZE
    part = (slice(None), slice(height // 2, height // 2 + height // 10))
    planes[(*part, slice(width // 2 + 12, width // 2 + width // 10 + 12))] = shot.radiance[
        (*part, slice(width // 2, width // 2 + width // 10))
    ]
    return replace(shot, radiance=planes)


def twelve_bits(dn: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """Leave the last two bits out."""
    return (dn // 4 * 4).astype(np.uint16)


DETAIL = ("leaves", "texture", "bars")
FAULTS = (
    *(
        Fault(
            f"camera moved by {pixels} px after the sixth frame",
            dict.fromkeys((11, 14, 15, 16), moved(pixels)),
            verdict=verdict,
            kinds=DETAIL,
        )
        for pixels, verdict in ((0.3, "look"), (1, "shoot again"), (3, "shoot again"), (10, "shoot again"))
    ),
    *(
        Fault(f"light {percent:+} % in the noisy frames alone", dict.fromkeys(NOISY, lit(percent)), verdict=verdict)
        for percent, verdict in (
            *((-20, "shoot again"), (-5, "shoot again"), (-2, "shoot again"), (1, "look")),
            *((2, "shoot again"), (5, "shoot again"), (6, "shoot again"), (20, "shoot again")),
        )
    ),
    *(
        Fault(f"shutter {stops} stop off, ISO 800 x1", {X1: shutter(stops)}, verdict="look")
        for stops in (Fraction(-1, 3), Fraction(-1, 6), Fraction(1, 6), Fraction(1, 3))
    ),
    Fault("an object moved in ISO 800 x1", {X1: object_moved}, verdict="look", kinds=DETAIL),
    Fault("ISO 800 x1 out of focus (sigma 1.5 px)", {X1: lambda shot: shot.blurred(1.5)}, verdict="look", kinds=DETAIL),
    Fault("12 bits in all frames", digital=dict.fromkeys(FEW, twelve_bits), verdict="look"),
)
ORDER = ("keep", "look", "shoot again")


# --- the study --------------------------------------------------------------------------------------------------------


def verdicts(fault: Fault, scenes: int) -> list[tuple[str, str, list[str]]]:
    """Kind, verdict and the names of what was found, of scenes with a fault (seeds as their numbers)."""
    return [judged(scene, FEW, fault) for scene in range(1, 1 + 4 * scenes) if KINDS[scene % 4] in fault.kinds]


def clean(scenes: int) -> list[tuple[str, str, list[str]]]:
    """Kind, verdict and what was found of scenes without a fault, all sixteen frames of each."""
    return [judged(scene, range(1, 17)) for scene in range(1001, 1001 + scenes)]


def judged(scene: int, ids: Sequence[int], fault: Fault | None = None) -> tuple[str, str, list[str]]:
    """Photograph and check one scene."""
    mishaps, digital = (fault.mishaps, fault.digital) if fault else ({}, {})
    with tempfile.TemporaryDirectory() as folder:
        manifest = write_scenes(
            Path(folder),
            {(scene, number): mishap for number, mishap in mishaps.items()},
            scenes=(scene,),
            ids=ids,
            camera=CAMERAS[scene // 4 % 2],
            seed=scene,
            picture=picture,
            digital=digital,
        )
        (group,) = check(manifest, Path(folder) / "data").groups
    return KINDS[scene % 4], group.verdict, [getattr(reason, "name", str(reason)) for reason in group.reasons]


def main() -> None:
    """Print a row for each fault, and the false alarms."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=2, help="of each kind, a fault (default: %(default)s)")
    parser.add_argument("--clean", type=int, default=100, help="scenes without a fault (default: %(default)s)")
    options = parser.parse_args()
    print(
        "| fault | at least to be said | scenes | shoot again | look | keep | found by |\n|---|---|---|---|---|---|---|"
    )
    for fault in FAULTS if options.scenes else ():
        found = verdicts(fault, options.scenes)
        said: Any = Counter(verdict for _, verdict, _ in found)
        missed = [kind for kind, verdict, _ in found if ORDER.index(verdict) < ORDER.index(fault.verdict)]
        by = Counter(name for _, _, names in found for name in set(names)).most_common(4)
        cells = [fault.name, fault.verdict, len(found), *(said[verdict] for verdict in ORDER[::-1])]
        cells.append(", ".join(f"{name} {count}" for name, count in by) + f" **missed: {missed}**" * bool(missed))
        print("|", *cells, "|", sep=" | ", flush=True)
    if options.clean:
        alarmed = [(kind, reasons) for kind, verdict, reasons in clean(options.clean) if verdict != "keep"]
        print(f"\nof {options.clean} clean scenes, {len(alarmed)} are not kept:", *alarmed, sep="\n")


if __name__ == "__main__":
    main()
