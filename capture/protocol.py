"""The capture protocol: which frames of a scene are taken, in which order and how they are exposed.

It is Algorithm 1 of Wei, Fu, Zheng and Yang, "Physics-based Noise Modeling for Extreme Low-light
Photography", IEEE TPAMI 2021, with the frames numbered as in the dataset that its authors released.

The algorithm takes one reference before and one after the noisy frames of every ISO. In the released set the
one after an ISO is also the one before the next, so three ISOs come with four references.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import TYPE_CHECKING, Final

from eldata.base.numbers import checked_whole
from eldata.errors import ArgumentError

if TYPE_CHECKING:
    from eldata.records import Role

_MOST_ALIKE: Final = 99


@dataclass(frozen=True, slots=True)
class ProtocolFrame:
    """One frame that the protocol asks for.

    Attributes
    ----------
    number
        The frame's place in the scene, from 1: the released set's ``IMG_0004`` is number 4.
    role
        ``"reference"`` or ``"noisy"``.
    iso
        ISO speed to set.
    factor
        Low-light factor of a noisy frame; ``None`` for a reference.
    reference
        Number of the reference that a noisy frame is compared with; ``None`` for a reference.
    """

    number: int
    role: Role
    iso: int
    factor: int | None
    reference: int | None


@dataclass(frozen=True, slots=True)
class CaptureProtocol:
    """The settings of Algorithm 1 (Wei, Fu, Zheng and Yang, TPAMI 2021); the defaults are the released set's.

    Attributes
    ----------
    base_iso
        ISO of the references: the algorithm's ``g_b``.
    noisy_isos
        ISOs of the noisy frames, in the order in which they are taken: the algorithm's ``g_h``.
    low_light_factors
        How much less light the noisy frames get, in any order: the algorithm's ``f``.
    repeats
        Noisy frames of each ISO and factor, one after the other; LRID has ten. Up to 99.
    references
        Reference frames of each block, one after the other, up to 99. Each noisy frame is compared with one of them.

    Raises
    ------
    ArgumentError
        If a value is not a positive whole number or too large, or if a tuple is empty or repeats a value.

    Examples
    --------
    >>> from capture import PAPER, RELEASED, CaptureProtocol
    >>> len(RELEASED.frames()), len(PAPER.frames())
    (16, 10)
    >>> CaptureProtocol(noisy_isos=(1600,), low_light_factors=(100,)).frames()[1].factor
    100
    >>> len(CaptureProtocol(repeats=10, references=2).frames())
    128
    """

    base_iso: int = 100
    noisy_isos: tuple[int, ...] = (800, 1600, 3200)
    low_light_factors: tuple[int, ...] = (1, 10, 100, 200)
    repeats: int = 1
    references: int = 1

    def __post_init__(self) -> None:
        checked_whole("base_iso", self.base_iso, at_least=1)
        for name in ("repeats", "references"):
            if checked_whole(name, getattr(self, name), at_least=1) > _MOST_ALIKE:
                raise ArgumentError(f"{name} must be at most {_MOST_ALIKE}, found {getattr(self, name)}")
        _check_distinct("noisy_isos", self.noisy_isos)
        _check_distinct("low_light_factors", self.low_light_factors)

    def __str__(self) -> str:
        isos, factors = (", ".join(map(str, some)) for some in (self.noisy_isos, self.low_light_factors))
        words = f"base ISO {self.base_iso}, ISOs {isos}, low-light factors {factors}"
        words += f", {self.repeats} noisy frames of each" if self.repeats > 1 else ""
        return words + (f", {self.references} references before and after" if self.references > 1 else "")

    def frames(self) -> tuple[ProtocolFrame, ...]:
        """Return the frames of one scene in the order in which they are taken.

        A block of references comes first. Then follow, for each ISO, its noisy frames by rising factor, those of a
        factor together, and another block of references. With the default settings the references are the numbers
        1, 6, 11 and 16, and the noisy frame of the i-th ISO and the k-th factor, both counted from 0, is
        ``5 i + 2 + k``. Other settings, :data:`PAPER` among them, number their own frames from 1 by the same rule.

        Returns
        -------
        tuple of ProtocolFrame
            The frame at index n has the number n + 1. The reference of a noisy frame is the one nearest by
            number, the earlier of two equally near: by default the noisy frames 4 and 5 use 6, not 1.
        """
        return _list_frames(self)

    def exposure_s(self, frame: ProtocolFrame, metered_s: Fraction | int) -> Fraction:
        """Return the exposure time of a frame, exactly.

        References are exposed for the metered time ``t``. A noisy frame at the ISO ``g_h`` would be as bright
        after ``t* = g_b t / g_h`` and is exposed for ``t* / f``. So the exposure ratio, ISO times exposure
        time of the reference over the same of the noisy frame, is exactly ``f``.

        Parameters
        ----------
        frame
            One of :meth:`frames`.
        metered_s
            Exposure time in seconds that exposes the scene well at the base ISO.

        Returns
        -------
        Fraction
            Exposure time in seconds.

        Raises
        ------
        ArgumentError
            If ``frame`` is not of this protocol, or if ``metered_s`` is not an exact number above 0.
        """
        if type(metered_s) not in (Fraction, int):
            raise ArgumentError(f"metered_s must be a Fraction, so that exposures are exact; found {metered_s!r}")
        if metered_s <= 0:
            raise ArgumentError(f"metered_s must be above 0 seconds, found {metered_s}")
        if self.frames()[frame.number - 1 : frame.number] != (frame,):
            raise ArgumentError(f"{frame} is not a frame of {self}; take one from its frames()")
        if frame.factor is None:
            return Fraction(metered_s)
        return Fraction(self.base_iso, frame.iso * frame.factor) * metered_s


@lru_cache(maxsize=64)  # every exposure of every time on a dial asks whether its frame is among them
def _list_frames(protocol: CaptureProtocol) -> tuple[ProtocolFrame, ...]:
    """List a scene's frames: references first and after each noisy ISO; each noisy frame has its nearest reference."""
    settings: list[tuple[int, int | None]] = [(protocol.base_iso, None)] * protocol.references
    for iso in protocol.noisy_isos:
        settings += [(iso, factor) for factor in sorted(protocol.low_light_factors) for _ in range(protocol.repeats)]
        settings += [(protocol.base_iso, None)] * protocol.references
    references = [number for number, (_, factor) in enumerate(settings, 1) if factor is None]
    frames = []
    for number, (iso, factor) in enumerate(settings, 1):
        if factor is None:
            frames.append(ProtocolFrame(number, "reference", iso, None, None))
            continue
        nearest = min(references, key=lambda reference, number=number: (abs(number - reference), reference))  # type: ignore[misc]
        frames.append(ProtocolFrame(number, "noisy", iso, factor, nearest))
    return tuple(frames)


def _check_distinct(name: str, values: object) -> None:
    """Refuse values other than a tuple of distinct whole numbers above 0."""
    if not isinstance(values, tuple) or not values:
        raise ArgumentError(f"{name} must be a tuple of one or more positive whole numbers, found {values!r}")
    for index, value in enumerate(values):
        checked_whole(f"every value of {name}", value, at_least=1)
        if value in values[:index]:
            raise ArgumentError(f"{name} must hold each value once, found {value} again")


RELEASED = CaptureProtocol()
"""The released set: 16 frames per scene, with the factors 1 and 10 besides the paper's 100 and 200."""

PAPER = CaptureProtocol(low_light_factors=(100, 200))
"""The paper's own settings: six noisy frames per scene, 240 pairs over ten scenes and four cameras.

Its frames are numbered on their own, 1 to 10; the released files keep the numbers of :data:`RELEASED`.
"""

PROTOCOLS: Final = {"released": RELEASED, "paper": PAPER}
"""The named protocols."""
