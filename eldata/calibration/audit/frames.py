"""What the frames of one ISO show frame by frame: copies, odd bias frames, flats of unequal brightness."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from eldata.calibration.core.findings import UNEVEN
from eldata.manifest.verify_report import Problem

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from eldata.calibration.core._frames import Mosaic
    from eldata.calibration.core.findings import Finding
    from eldata.datasets.calibration_frames import FlatPair
    from eldata.records import FrameRecord, RawFrame

ADVISED_BIAS_FRAMES = 10

# Of the signal. Pairs are scaled to each other, and K is right at any ratio; but light that changes so much between two
# equal exposures is worth a word, and beyond the second limit it is doubtful that nothing else has changed.
_PAIR_DIFFERENCE = 0.05
_UNLIKE_PAIR = 0.25
_OF_NORMAL = 1.287  # standard deviation over the mean distance of the nearer 99 %
_DIGESTED_BYTES = 1 << 22  # of a frame
_COMPARED = 1000  # pixels, at least, that tell a copy


def problem_of(record: FrameRecord, field: str, expected: str, found: str, advice: str) -> Problem:
    """Return what is wrong with a frame."""
    return Problem(record.camera, record.path, field, expected, found, advice)


class Copies:
    """Tells frames whose pixels were seen before.

    Evenly spread rows of a frame are compared, by a digest: two frames of a sensor never agree in a thousand pixels
    that are not saturated. Frames with fewer of them are taken for new.
    """

    def __init__(self) -> None:
        self._seen: dict[bytes, FrameRecord] = {}
        self.remarks: list[str] = []

    def original(self, record: FrameRecord, mosaic: Mosaic) -> FrameRecord | None:
        """Return the frame that this one is a copy of, and remark on it; ``None`` for one that is new."""
        from hashlib import blake2b

        rows = np.ascontiguousarray(mosaic[:: max(1, mosaic.nbytes // _DIGESTED_BYTES)])
        if np.count_nonzero(rows < rows.max()) < _COMPARED:
            return None
        first = self._seen.setdefault(blake2b(rows.data, digest_size=16).digest(), record)
        if first is record:
            return None
        self.remarks.append(
            f"{record.path} has the same pixels as {first.path} and was left out: a copy, or noise too small for the "
            "values' steps"
        )
        return first


@dataclass(frozen=True, slots=True)
class FrameFigures:
    """A frame in two figures, DN: its mean, and the standard deviation by the distances of all but one in a hundred."""

    record: FrameRecord
    level_dn: float
    spread_dn: float

    @classmethod
    def of(cls, record: FrameRecord, mosaic: Mosaic) -> FrameFigures:
        """Measure a frame on some 100,000 of its pixels."""
        step = max(1, math.isqrt(mosaic.size // 100_000)) | 1  # odd: every site of the CFA takes part
        sample = mosaic[::step, ::step]
        away = np.abs(sample - np.median(sample))
        spread = _OF_NORMAL * float(away[away <= np.quantile(away, 0.99)].mean())
        return cls(record, float(sample.mean(dtype=np.float64)), spread)


def odd_bias_frames(figures: Sequence[FrameFigures]) -> list[Problem]:
    """Return the bias frames whose level or spread is not like the others' (light leak, lens cap off, another ISO).

    Off by more than 10 robust standard deviations of the frames' levels, a DN, and half the noise; or with a spread
    that differs by a quarter and a DN.
    """
    if not figures:
        return []
    levels = np.array([one.level_dn for one in figures])
    spreads = np.array([one.spread_dn for one in figures])
    level, spread = float(np.median(levels)), float(np.median(spreads))
    scatter = 1.4826 * float(np.median(np.abs(levels - level)))
    advice = "is it a bias frame of this ISO? look for light and for a lens without its cap, and leave it out"
    problems = []
    for one in figures:
        for field, found, usual, tolerance in (
            ("level", one.level_dn, level, max(10 * scatter, 1.0, 0.5 * spread)),
            ("noise", one.spread_dn, spread, max(0.25 * spread, 1.0)),
        ):
            if abs(found - usual) > tolerance:
                expected = f"about {usual:.1f} DN as in the others"
                problems.append(problem_of(one.record, field, expected, f"{found:.1f} DN", advice))
                break
    return problems


@dataclass(frozen=True, slots=True)
class PairLevels:
    """The mean levels over black of a pair of flats, DN."""

    pair: FlatPair
    first_dn: float
    second_dn: float

    @classmethod
    def of(cls, pair: FlatPair, first: RawFrame, second: RawFrame) -> PairLevels:
        """Measure a pair on some 100,000 pixels of each frame."""
        black = float(np.mean(first.sensor.black_level_dn))
        one, two = (FrameFigures.of(pair.first, frame.mosaic).level_dn - black for frame in (first, second))
        return cls(pair, one, two)

    @property
    def difference(self) -> float:
        """Of the two, as a share of the brighter; a DN is none."""
        apart = max(0.0, abs(self.first_dn - self.second_dn) - 1.0)
        return apart / max(self.first_dn, self.second_dn, 1.0)

    def __str__(self) -> str:
        return f"{self.pair.first.path} and {self.pair.second.path} ({self.first_dn:.0f} and {self.second_dn:.0f} DN)"


def unequal_pair(levels: PairLevels) -> str | None:
    """Return a remark if the two flats of a pair are too unlike to be one scene in one light, else ``None``."""
    if levels.difference <= _UNLIKE_PAIR:
        return None
    return (
        f"{levels.pair.first.path} and {levels.pair.second.path} were left out: their levels over black are "
        f"{levels.first_dn:.0f} and {levels.second_dn:.0f} DN; equal exposures of a constant light differ by less than "
        f"{_PAIR_DIFFERENCE:.0%}, and beyond {_UNLIKE_PAIR:.0%} they are not taken for two frames of one scene"
    )


def uneven_light(used: Sequence[PairLevels]) -> Iterator[Finding]:
    """Yield a remark if pairs differ by more than equal exposures of a constant light do."""
    uneven = [levels for levels in used if levels.difference > _PAIR_DIFFERENCE]
    if uneven:
        worst = max(uneven, key=lambda levels: levels.difference)
        yield UNEVEN.seen(
            worst.difference,
            _PAIR_DIFFERENCE,
            f"{len(uneven)} of {len(used)} pairs of flats differ in light by up to {worst.difference:.0%}: {worst}; "
            "they were scaled to each other, so K holds, but a constant light and a mechanical shutter are better",
        )
