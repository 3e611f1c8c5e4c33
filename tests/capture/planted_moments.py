"""Faults planted between the moments of sequences, and what is said: `python -m tests.capture.planted_moments`.

Scenes of the four kinds of :mod:`tests.capture.planted_faults`; another one, in a window of some share of the picture,
is what moves. Each sequence has three moments, and the fault lies between the second and the third.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from capture.check import check
from tests.capture.films import film, film_plan, made_set
from tests.capture.planted_faults import KINDS, picture
from tests.capture.simulated_scenes import moved

if TYPE_CHECKING:
    from numpy.typing import NDArray

SIZE: Final = (384, 576)
# By name: the share of the picture that moves, by how many pixels, and by how much camera and light change.
FAULTS: Final[dict[str, tuple[Fraction, int, float, float]]] = {
    "nothing": (Fraction(1, 30), 40, 0.0, 1.0),
    "nothing; a quarter of the picture moves": (Fraction(1, 4), 40, 0.0, 1.0),
    "nothing; 45 % of the picture moves": (Fraction(9, 20), 30, 0.0, 1.0),
    "70 % of the picture moves": (Fraction(7, 10), 30, 0.0, 1.0),
    "nothing moves": (Fraction(1, 30), 0, 0.0, 1.0),
    "the camera by 0.3 px": (Fraction(1, 10), 40, 0.3, 1.0),
    "the camera by 1 px": (Fraction(1, 10), 40, 1.0, 1.0),
    "the camera by 3 px": (Fraction(1, 10), 40, 3.0, 1.0),
    "light by 1 %": (Fraction(1, 10), 40, 0.0, 1.01),
    "light by 3 %": (Fraction(1, 10), 40, 0.0, 1.03),
}


def seen(scene: int, moment: int, share: Fraction, step: int) -> NDArray[np.float32]:
    """Return the picture of scene n with the window of another one where it is at a moment."""
    height, width = (int(size * float(share) ** 0.5) for size in SIZE)
    generator = np.random.default_rng([9, scene])
    top = int(generator.integers(0, SIZE[0] - height))
    left = int(generator.integers(0, max(1, SIZE[1] - width - 2 * step))) + step * (moment - 1)
    shown = picture(scene, SIZE).copy()
    window = shown[:, top : top + height, left : left + width]
    window[:] = picture(scene + 1000, SIZE)[:, : window.shape[1], : window.shape[2]]
    return shown


def planted(name: str, scene: int) -> str:
    """Return the verdict of the third moment of a sequence, and the names of what led to it."""
    share, step, pixels, light = FAULTS[name]

    def mishap(moment: str, _: NDArray[np.float32]) -> NDArray[np.float32]:
        number = int(moment[-1])
        shown = seen(scene, number, share, step)
        return shown if number < 3 else moved(shown, pixels, 0) * np.float32(light)

    with tempfile.TemporaryDirectory() as folder:
        plan = film_plan(3)
        film(Path(folder) / "card", plan, mishap=mishap, size=SIZE)
        group = check(made_set(Path(folder), plan), Path(folder) / "data").groups[2]
    return ", ".join([group.verdict, *sorted({getattr(one, "name", "nothing moved") for one in group.reasons})])


def main() -> None:
    """Print how many sequences have each verdict."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=len(KINDS), help="sequences of each fault")
    for name in FAULTS:
        found = Counter(planted(name, scene) for scene in range(parser.parse_args().scenes))
        print(f"{name}: {'; '.join(f'{count} {verdict}' for verdict, count in found.most_common())}", flush=True)


if __name__ == "__main__":
    main()
