"""Sequences as a simulated photographer takes them: a scene that rests, and a thing in it that moves."""

from __future__ import annotations

from datetime import datetime, timedelta
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np

from capture.cli import main as capture
from capture.plan import make_plan
from capture.protocol import CaptureProtocol
from eldata.demo.camera import CAMERAS
from eldata.raw.dng import write_dng
from eldata.records import Exposure
from tests.capture.simulated_scenes import moved, radiance
from tests.capture.test_whole_path import description

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from capture.plan import Plan

    Picture = NDArray[np.float32]

ALPHA = CAMERAS[0]
SIZE = (256, 384)
NIGHT = datetime(2026, 11, 21, 22)  # noqa: DTZ001 # a camera's clock


def film_plan(moments: int, scenes: int = 1, **protocol: int) -> Plan:
    """Return a plan of scenes of so many moments: ISO 800, x1 and x100."""
    counts = CaptureProtocol(noisy_isos=(800,), low_light_factors=(1, 100), moments=moments, **protocol)
    return make_plan(description(ALPHA), counts, {f"scene-{n}": Fraction(4) for n in range(1, scenes + 1)})


def seen(scene: int, moment: int) -> Picture:
    """Return what stands before the camera: a striped thing that moves by 17 pixels from moment to moment."""
    picture = radiance(scene, SIZE).copy()
    rows, columns = np.mgrid[:64, :48]
    left = 20 + 17 * moment
    picture[:, 100:164, left : left + 48] = 0.25 + 0.2 * np.sin(rows / 3) * np.cos(columns / 4)
    return picture


def film(
    card: Path,
    plan: Plan,
    order: Sequence[str] | None = None,
    mishap: Callable[[str, Picture], Picture] = lambda _, picture: picture,
    size: tuple[int, int] = SIZE,
) -> Path:
    """Take the moments of a plan, by name in this order; ``mishap`` gets a name and what is seen at it."""
    card.mkdir(parents=True, exist_ok=True)
    camera, now, number = ALPHA.with_size(*size), NIGHT, len(list(card.iterdir()))
    for name in [scene.name for scene in plan.scenes] if order is None else order:
        planned = plan.scene(name)
        picture = mishap(name, seen(int(planned.sequence.removeprefix("scene-")), max(1, planned.moment)))
        now += timedelta(seconds=60)
        for shot in planned.shots:
            number += 1
            now += timedelta(seconds=10)
            share = shot.setting.nominal_s / planned.shots[0].setting.nominal_s  # a shutter that does what it says
            mosaic = camera.photograph(picture, share, shot.iso, np.random.default_rng([5, number]))
            exposure = Exposure(Fraction(shot.iso), shot.setting.nominal_s)
            path = card / f"DSC{number:05d}.dng"
            write_dng(path, mosaic, camera.sensor, exposure, taken=now, compression="none")
    return card


def made_set(folder: Path, plan: Plan, *options: str) -> Path:
    """Make the set of a card's files; return its manifest."""
    plan.save(folder / "plan.json")
    target = folder / "manifests" / "mine.csv"
    arguments = ["manifest", str(folder / "plan.json"), str(folder / "card"), "-o", str(target)]
    assert capture([*arguments, "--copy-to", str(folder / "data" / "Mine"), "--jobs", "1", *options]) == 0
    return target


def shifted(down: float, right: float = 0.0) -> Callable[[Picture], Picture]:
    return lambda picture: moved(picture, down, right)
