"""The layout of ELD-style sets: sixteen frames per scene.

Frame numbers: references are 1, 6, 11 and 16; with i the index of the ISO and k that of the low-light factor, a
noisy frame is 5 i + 2 + k; its reference is the nearest of the four by number (so 4 and 5 have 6, not 1).

Sources: K. Wei, Y. Fu, Y. Zheng and J. Yang, "Physics-based Noise Modeling for Extreme Low-light Photography",
TPAMI 2021 (section 3.3: cameras, ISOs, factors, Algorithm 1); the ELD repository's test_ELD.py and
sid_dataset.py for names and the choice of reference; PMN's and LED's file lists for exposures and ratios.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from typing import TYPE_CHECKING

from eldata.records import FrameRecord

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

REFERENCE_NUMBERS = (1, 6, 11, 16)
NOISY_ISOS = (800, 1600, 3200)
LOW_LIGHT_FACTORS = (1, 10, 100, 200)


@dataclass(frozen=True, slots=True)
class EldCamera:
    """A camera of an ELD-style set.

    Attributes
    ----------
    name
        Its folder.
    extension
        Of its files, with the dot, upper or lower case as in the file names.
    reference_iso
        ISO of the references, where known.
    reference_exposure_s
        Exposure time of the references by scene number, where known.
    """

    name: str
    extension: str
    reference_iso: int | None = None
    reference_exposure_s: Mapping[int, Fraction] | None = None


def frame_path(camera: EldCamera, scene: int, number: int) -> str:
    """Return a frame's path relative to the dataset's folder."""
    return f"{camera.name}/scene-{scene}/IMG_{number:04d}{camera.extension}"


def eld_records(
    cameras: Iterable[EldCamera], scenes: Sequence[int], flags: Mapping[str, tuple[str, ...]] | None = None
) -> tuple[FrameRecord, ...]:
    """Return the rows of an ELD-style set, sixteen frames for each camera and scene, sorted by path.

    ``ratio`` is the nominal low-light factor. Exposure times of noisy frames follow from the references' where those
    are known: t_noisy = ISO_ref t_ref / (ISO_noisy f). ``flags`` are given by path.
    """
    rows = []
    for camera in cameras:
        for scene in scenes:
            reference_iso = None if camera.reference_iso is None else Fraction(camera.reference_iso)
            reference_exposure_s = (camera.reference_exposure_s or {}).get(scene)
            frame = partial(FrameRecord, camera=camera.name, scene=f"scene-{scene}", split="test")
            reference = partial(frame, role="reference", iso=reference_iso, exposure_s=reference_exposure_s)
            rows += [reference(path=frame_path(camera, scene, number)) for number in REFERENCE_NUMBERS]
            for i, iso in enumerate(NOISY_ISOS):
                for k, factor in enumerate(LOW_LIGHT_FACTORS):
                    number = 5 * i + 2 + k
                    exposure_s = None
                    if reference_iso is not None and reference_exposure_s is not None:
                        exposure_s = reference_iso * reference_exposure_s / (iso * factor)
                    nearest = min(REFERENCE_NUMBERS, key=lambda reference: abs(reference - number))
                    rows.append(
                        frame(
                            path=frame_path(camera, scene, number),
                            role="noisy",
                            iso=Fraction(iso),
                            exposure_s=exposure_s,
                            ratio=Fraction(factor),
                            reference=frame_path(camera, scene, nearest),
                        )
                    )
    flagged = [replace(row, flags=flags[row.path]) if flags and row.path in flags else row for row in rows]
    return tuple(sorted(flagged, key=lambda row: row.path))
