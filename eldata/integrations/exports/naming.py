"""Names of files from which published code reads scene, shot and exposure.

SID's names state the exposure time, ``00001_00_0.04s.ARW``, and the code of SID, ELD and LED divides the times of two
names. Where ISO differs within a pair that is not the exposure ratio: LED's own script
(scripts/data_preparation/eld_to_sid_structure.py) has ISO times seconds in the time's place, and so have names here.
"""

from __future__ import annotations

import math
import re
from decimal import Decimal
from fractions import Fraction
from pathlib import PurePosixPath
from typing import TYPE_CHECKING

from eldata.errors import ArgumentError, RawFileError
from eldata.evaluation.scores import natural
from eldata.manifest.eld import REFERENCE_NUMBERS, nearest_reference

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Sequence

    from eldata.integrations.exports.frames import ExportFrame, ExportPair

LARGEST_RATIO = Fraction(300)
"""At which the code of SID, ELD and LED caps the ratio of two names."""

_MOST_SCENES, _MOST_SHOTS = 10_000, 100
_SID_NAME = re.compile(r"[0-9]{5}_[0-9]{2}_([0-9]+(?:\.[0-9]+)?)s\.[A-Za-z0-9]{3}")
_LAST_NUMBER = re.compile(r"([0-9]+)$")
_SPLIT_DIGITS = {"train": 0, "test": 1, "val": 2}


def ratio_of_names(noisy: str, reference: str) -> float | None:
    """Return the ratio that published code reads from two names of SID's kind; ``None`` if one is not of it."""
    times = [_SID_NAME.fullmatch(name) for name in (noisy, reference)]
    if times[0] is None or times[1] is None or not float(times[0][1]):
        return None
    return min(float(times[1][1]) / float(times[0][1]), float(LARGEST_RATIO))


def exposure_in_name(frame: ExportFrame) -> str:
    """Return ISO times seconds, in Python's numbers as LED's script has them: ``400`` or ``80.0``, never ``1e-05``.

    Raises
    ------
    RawFileError
        If the file does not state both.
    """
    iso, seconds = frame.exposure.iso, frame.exposure.exposure_s
    if iso is None or seconds is None:
        raise RawFileError(frame.file, "states no ISO or no exposure time, from which published code takes the ratio")
    product = plain_number(iso) * plain_number(seconds)
    return str(product) if isinstance(product, int) else format(Decimal(repr(product)), "f")


def plain_number(value: Fraction) -> int | float:
    """Return a fraction as Python's plain numbers: a whole one as an int."""
    return value.numerator if value.denominator == 1 else float(value)


def numbers_of(names: Iterable[str], *, below: int, what: str) -> dict[str, int]:
    """Return a number for each name: the one that it ends with, if that tells them all apart, else 1, 2, 3...

    Raises
    ------
    ArgumentError
        If there are more than published names have digits for.
    """
    ordered = sorted(set(names), key=natural)
    if len(ordered) >= below:
        raise ArgumentError(f"{len(ordered)} {what}: the published names have digits for {below - 1}; choose fewer")
    found = [_LAST_NUMBER.search(name) for name in ordered]
    own = [int(number[1]) for number in found if number is not None]
    if len(own) == len(set(own)) == len(ordered) and max(own, default=0) < below:
        return dict(zip(ordered, own, strict=True))
    return {name: place for place, name in enumerate(ordered, start=1)}


def sid_names(pairs: Sequence[ExportPair], *, bursts: bool = False) -> dict[str, str]:
    """Return for the path of each frame of one camera its name below ``short`` or ``long``.

    Names that are of SID's kind and state the nominal ratio of every pair are kept. Others become
    ``<scene>_<shot>_<ISO times seconds>s``.

    Parameters
    ----------
    pairs
        Of one camera.
    bursts
        Whether the shot counts the frames of one scene and exposure, as in SID, where the code reads only ``_00``, and
        the scene's first digit is the split. Else it is the frame's number in its scene.

    Raises
    ------
    RawFileError
        If a file does not state ISO and exposure time.
    ArgumentError
        If there are too many scenes or shots for the digits of the names; with ``bursts``, if a split is not one of
        SID's.
    """
    own = _own_names(pairs)
    if own is not None:
        return own
    scenes = numbers_of((pair.record.scene for pair in pairs), below=_MOST_SCENES, what="scenes")
    names: dict[str, str] = {}
    for scene, number in scenes.items():
        inside = [pair for pair in pairs if pair.record.scene == scene]
        sides = {pair.reference.path: ("long", pair.reference) for pair in inside}
        sides |= {pair.noisy.path: ("short", pair.noisy) for pair in inside}
        texts = {path: (side, exposure_in_name(frame)) for path, (side, frame) in sides.items()}
        if bursts:
            digit = _SPLIT_DIGITS.get(inside[0].record.split)
            if digit is None:
                raise ArgumentError(
                    f"scene {scene}: its split is {inside[0].record.split!r}, and the code of SID tells train, test "
                    "and val by the first digit of a scene; state the split in the manifest"
                )
            number += digit * _MOST_SCENES  # noqa: PLW2901 # the same scene, as its split numbers it
            shots = _burst_numbers(texts)
        else:
            stems = {path: PurePosixPath(path).stem for path in texts}
            by_stem = numbers_of(stems.values(), below=_MOST_SHOTS, what=f"frames of scene {scene}")
            shots = {path: by_stem[stem] for path, stem in stems.items()}
        for path, (side, text) in texts.items():
            suffix = PurePosixPath(path).suffix
            names[path] = f"{side}/{number:05d}_{shots[path]:02d}_{text}s{suffix}"
    return names


def _own_names(pairs: Sequence[ExportPair]) -> dict[str, str] | None:
    names: dict[str, str] = {}
    for pair in pairs:
        noisy, reference = PurePosixPath(pair.noisy.path).name, PurePosixPath(pair.reference.path).name
        ratio = ratio_of_names(noisy, reference)
        if ratio is None or not math.isclose(ratio, min(pair.record.ratio, LARGEST_RATIO), rel_tol=1e-9):
            return None
        names |= {pair.noisy.path: f"short/{noisy}", pair.reference.path: f"long/{reference}"}
    return names if len(set(names.values())) == len(names) else None


def _burst_numbers(texts: dict[str, tuple[str, str]]) -> dict[str, int]:
    """Return the place of each frame among those of its side and exposure."""
    counted: dict[tuple[str, str], int] = {}
    numbers = {}
    for path in sorted(texts, key=natural):
        numbers[path] = counted.setdefault(texts[path], 0)
        counted[texts[path]] += 1
    if max(numbers.values(), default=0) >= _MOST_SHOTS:
        raise ArgumentError(f"{max(numbers.values()) + 1} frames of one scene and exposure: SID's names count to 99")
    return numbers


# --- ELD's numbers ----------------------------------------------------------------------------------------------------


def eld_numbers(pairs: Sequence[ExportPair]) -> dict[int, str]:
    """Return the path of the frame of each number of one scene, so that the nearest reference is each frame's own.

    Numbers that say so already are kept. A scene of fewer than four references has them under several numbers.

    Raises
    ------
    ArgumentError
        If no numbers can say which reference each frame has.
    """
    noisy_of: dict[str, list[str]] = {}
    for pair in sorted(pairs, key=lambda pair: natural(pair.noisy.path)):
        noisy_of.setdefault(pair.reference.path, []).append(pair.noisy.path)
    own = _own_numbers(noisy_of)
    return _given_numbers(noisy_of, pairs[0].record.scene) if own is None else own


def _own_numbers(noisy_of: dict[str, list[str]]) -> dict[int, str] | None:
    numbers: dict[int, str] = {}
    for reference, noisy in noisy_of.items():
        for path in (reference, *noisy):
            found = _LAST_NUMBER.search(PurePosixPath(path).stem)
            if found is None or int(found[1]) in numbers:
                return None
            numbers[int(found[1])] = path
    number_of = {path: number for number, path in numbers.items()}
    fits = all(
        number_of[reference] in REFERENCE_NUMBERS
        and all(nearest_reference(number_of[path]) == number_of[reference] for path in noisy)
        for reference, noisy in noisy_of.items()
    )
    return numbers if fits else None


def _given_numbers(noisy_of: dict[str, list[str]], scene: str) -> dict[int, str]:
    numbers: dict[int, str] = {}
    left, waiting = list(REFERENCE_NUMBERS), list(noisy_of)
    while waiting:
        reference = waiting.pop(0)
        noisy, taken = noisy_of[reference], left[:1]
        while len(taken) < len(left) - len(waiting) and (not waiting or _room(taken) < len(noisy)):
            taken = left[: len(taken) + 1]
        del left[: len(taken)]
        free = _free_numbers(taken, len(noisy))
        if not taken or len(free) < len(noisy):
            raise ArgumentError(
                f"{scene}: ELD's code takes the nearest of frames 1, 6, 11 and 16 for reference, and has no numbers "
                f"for {len(noisy_of)} references with {', '.join(str(len(one)) for one in noisy_of.values())} noisy "
                "frames; choose fewer"
            )
        numbers |= dict.fromkeys(taken, reference) | dict(zip(free, noisy, strict=False))
    return dict(sorted(numbers.items()))


def _room(taken: Sequence[int]) -> int:
    return len(_free_numbers(taken, _MOST_SHOTS))


def _free_numbers(taken: Collection[int], wanted: int) -> list[int]:
    """Return numbers whose nearest reference is one of ``taken``; the last reference has any number of them."""
    highest = REFERENCE_NUMBERS[-1] + wanted
    return [n for n in range(1, highest + 1) if n not in REFERENCE_NUMBERS and nearest_reference(n) in taken][:wanted]
