from __future__ import annotations

import dataclasses
from fractions import Fraction

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capture import PAPER, RELEASED, CaptureProtocol
from eldata.errors import ArgumentError
from tests.cases import in_one_test

positive = st.integers(1, 10**6)
several = st.lists(positive, min_size=1, max_size=6, unique=True).map(tuple)
protocols = st.builds(CaptureProtocol, base_iso=positive, noisy_isos=several, low_light_factors=several)
times_s = st.fractions(min_value=Fraction(1, 10**6), max_value=10**4, max_denominator=10**6)


def test_paper_has_240_pairs() -> None:
    noisy = [frame for frame in PAPER.frames() if frame.role == "noisy"]
    assert {(frame.iso, frame.factor) for frame in noisy} == {
        (iso, factor) for iso in (800, 1600, 3200) for factor in (100, 200)
    }
    assert len(noisy) * 10 * 4 == 240
    assert [frame.number for frame in PAPER.frames() if frame.role == "reference"] == [1, 4, 7, 10]


@given(protocols, st.integers(1, 5), st.integers(1, 4))
def test_repeats_are_the_same_frames_more_often(protocol: CaptureProtocol, repeats: int, references: int) -> None:
    many = dataclasses.replace(protocol, repeats=repeats, references=references).frames()
    times = {"noisy": repeats, "reference": references}
    assert [(one.role, one.iso, one.factor) for one in many] == [
        (one.role, one.iso, one.factor) for one in protocol.frames() for _ in range(times[one.role])
    ]
    known = [one.number for one in many if one.role == "reference"]
    for one in many:
        if one.reference is not None:
            nearest = min(known, key=lambda number, one=one: (abs(number - one.number), number))  # type: ignore[misc]
            assert one.reference == nearest


@settings(deadline=None)
@given(protocols, times_s)
def test_exposure_ratio_is_exactly_the_factor(protocol: CaptureProtocol, metered_s: Fraction) -> None:
    """And each frame is in its place, with its reference."""
    frames = protocol.frames()
    assert [frame.number for frame in frames] == list(range(1, len(frames) + 1))
    references = {frame.number for frame in frames if frame.role == "reference"}
    block = len(protocol.low_light_factors) + 1
    assert references == set(range(1, len(protocol.noisy_isos) * block + 2, block))
    for frame in frames:
        exposure_s = protocol.exposure_s(frame, metered_s)
        assert type(exposure_s) is Fraction
        if frame.role == "reference":
            assert (frame.iso, frame.factor, frame.reference) == (protocol.base_iso, None, None)
            assert exposure_s == metered_s
            continue
        i, k = divmod(frame.number - 2, block)
        assert frame.iso == protocol.noisy_isos[i]
        assert frame.factor == sorted(protocol.low_light_factors)[k]
        assert frame.reference in references
        assert protocol.base_iso * metered_s / (frame.iso * exposure_s) == frame.factor


@in_one_test(
    "wrong, words",
    [
        ({"base_iso": 0}, "base_iso must be 1 or more; found 0"),
        ({"base_iso": 100.0}, "base_iso must be a whole number, 1 or more; found 100.0"),
        ({"repeats": 100}, "repeats must be at most 99, found 100"),
        ({"noisy_isos": (800, -1)}, "every value of noisy_isos must be 1 or more; found -1"),
        ({"noisy_isos": ()}, "noisy_isos must be a tuple of one or more positive whole numbers, found ()"),
        ({"low_light_factors": (10, 10)}, "low_light_factors must hold each value once, found 10 again"),
    ],
)
def test_wrong_settings_are_refused(wrong: dict[str, object], words: str) -> None:
    with pytest.raises(ArgumentError) as caught:
        CaptureProtocol(**wrong)  # type: ignore[arg-type]
    assert words in str(caught.value)


def test_metered_times_are_exact_and_positive_and_of_a_frame_of_the_protocol() -> None:
    for metered_s in (Fraction(0), Fraction(-1, 2)):
        with pytest.raises(ArgumentError, match="above 0 seconds"):
            RELEASED.exposure_s(RELEASED.frames()[0], metered_s)
    with pytest.raises(ArgumentError, match="must be a Fraction"):
        RELEASED.exposure_s(RELEASED.frames()[0], 0.5)  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, match="is not a frame of"):
        RELEASED.exposure_s(PAPER.frames()[1], Fraction(4))
