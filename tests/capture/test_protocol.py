from __future__ import annotations

import dataclasses
from fractions import Fraction

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import capture
from capture import PAPER, RELEASED, CaptureProtocol, ProtocolFrame
from eldata.errors import ArgumentError

# The released set, from its published file lists: number, ISO, factor, reference.
RELEASED_NOISY = [
    (2, 800, 1, 1),
    (3, 800, 10, 1),
    (4, 800, 100, 6),
    (5, 800, 200, 6),
    (7, 1600, 1, 6),
    (8, 1600, 10, 6),
    (9, 1600, 100, 11),
    (10, 1600, 200, 11),
    (12, 3200, 1, 11),
    (13, 3200, 10, 11),
    (14, 3200, 100, 16),
    (15, 3200, 200, 16),
]

positive = st.integers(1, 10**6)
several = st.lists(positive, min_size=1, max_size=6, unique=True).map(tuple)
protocols = st.builds(CaptureProtocol, base_iso=positive, noisy_isos=several, low_light_factors=several)
times_s = st.fractions(min_value=Fraction(1, 10**6), max_value=10**4, max_denominator=10**6)


def test_frames_of_the_released_set() -> None:
    frames = RELEASED.frames()
    assert [frame.number for frame in frames] == list(range(1, 17))
    noisy = [frame for frame in frames if frame.role == "noisy"]
    assert [(frame.number, frame.iso, frame.factor, frame.reference) for frame in noisy] == RELEASED_NOISY
    references = [frame for frame in frames if frame.role != "noisy"]
    assert references == [ProtocolFrame(number, "reference", 100, None, None) for number in (1, 6, 11, 16)]


def test_numbers_of_the_released_set_follow_their_formula() -> None:
    by_number = {frame.number: frame for frame in RELEASED.frames()}
    for i, iso in enumerate((800, 1600, 3200)):
        for k, factor in enumerate((1, 10, 100, 200)):
            frame = by_number[5 * i + 2 + k]
            assert (frame.role, frame.iso, frame.factor) == ("noisy", iso, factor)


def test_released_set_is_the_default() -> None:
    assert CaptureProtocol() == RELEASED


def test_paper_has_240_pairs() -> None:
    noisy = [frame for frame in PAPER.frames() if frame.role == "noisy"]
    assert {(frame.iso, frame.factor) for frame in noisy} == {
        (iso, factor) for iso in (800, 1600, 3200) for factor in (100, 200)
    }
    assert len(noisy) * 10 * 4 == 240
    assert [frame.number for frame in PAPER.frames() if frame.role == "reference"] == [1, 4, 7, 10]


def test_equally_near_references_give_the_earlier() -> None:
    frames = CaptureProtocol(noisy_isos=(800, 1600), low_light_factors=(1, 10, 100)).frames()
    assert [frame.reference for frame in frames] == [None, 1, 1, 5, None, 5, 5, 9, None]


def test_repeated_frames_and_references() -> None:
    """Two references, three frames of each factor, two references: each frame with the nearer of the four."""
    protocol = CaptureProtocol(noisy_isos=(800,), low_light_factors=(100, 10), repeats=3, references=2)
    found = [(frame.number, frame.factor, frame.reference) for frame in protocol.frames()]
    assert found == [
        *((1, None, None), (2, None, None)),
        *((3, 10, 2), (4, 10, 2), (5, 10, 2)),
        *((6, 100, 9), (7, 100, 9), (8, 100, 9)),
        *((9, None, None), (10, None, None)),
    ]
    assert len(dataclasses.replace(RELEASED, repeats=10).frames()) == 4 + 12 * 10


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


def test_factors_rise_and_isos_keep_their_order() -> None:
    frames = CaptureProtocol(noisy_isos=(3200, 800), low_light_factors=(200, 100)).frames()
    noisy = [(frame.iso, frame.factor) for frame in frames if frame.role == "noisy"]
    assert noisy == [(3200, 100), (3200, 200), (800, 100), (800, 200)]


def test_exposures_of_a_scene_metered_at_four_seconds() -> None:
    exposures_s = " ".join(str(RELEASED.exposure_s(frame, 4)) for frame in RELEASED.frames())
    assert exposures_s == "4 1/2 1/20 1/200 1/400 4 1/4 1/40 1/400 1/800 4 1/8 1/80 1/800 1/1600 4"


@settings(deadline=None)
@given(protocols)
def test_structure_of_any_protocol(protocol: CaptureProtocol) -> None:
    frames = protocol.frames()
    assert [frame.number for frame in frames] == list(range(1, len(frames) + 1))
    references = {frame.number for frame in frames if frame.role == "reference"}
    block = len(protocol.low_light_factors) + 1
    assert references == set(range(1, len(protocol.noisy_isos) * block + 2, block))
    for frame in frames:
        if frame.role == "reference":
            assert (frame.iso, frame.factor, frame.reference) == (protocol.base_iso, None, None)
            continue
        i, k = divmod(frame.number - 2, block)
        assert frame.iso == protocol.noisy_isos[i]
        assert frame.factor == sorted(protocol.low_light_factors)[k]
        assert frame.reference in references
        distance = abs(frame.number - frame.reference)
        assert all(
            distance < abs(frame.number - other) or frame.reference < other
            for other in references
            if other != frame.reference and abs(frame.number - other) <= distance
        )


@settings(deadline=None)
@given(protocols, times_s)
def test_exposure_ratio_is_exactly_the_factor(protocol: CaptureProtocol, metered_s: Fraction) -> None:
    frames = protocol.frames()
    for frame in frames:
        exposure_s = protocol.exposure_s(frame, metered_s)
        assert type(exposure_s) is Fraction
        if frame.reference is None:
            assert exposure_s == metered_s
        else:
            reference = frames[frame.reference - 1]
            light = reference.iso * protocol.exposure_s(reference, metered_s)
            assert light / (frame.iso * exposure_s) == frame.factor


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        ({"base_iso": 0}, "base_iso must be a positive whole number, found 0"),
        ({"base_iso": True}, "base_iso must be a positive whole number, found True"),
        ({"base_iso": 100.0}, "base_iso must be a positive whole number, found 100.0"),
        ({"noisy_isos": (800, -1)}, "every value of noisy_isos must be a positive whole number, found -1"),
        ({"noisy_isos": ()}, "noisy_isos must hold at least one positive whole number, found none"),
        ({"noisy_isos": [800]}, "noisy_isos must be a tuple of positive whole numbers, found [800]"),
        ({"noisy_isos": (800, 1600, 800)}, "noisy_isos must hold each value once, found 800 again"),
        ({"low_light_factors": (10, 10)}, "low_light_factors must hold each value once, found 10 again"),
        (
            {"low_light_factors": (1.5,)},
            "every value of low_light_factors must be a positive whole number, found 1.5",
        ),
    ],
)
def test_wrong_settings_are_refused(wrong: dict[str, object], sentence: str) -> None:
    with pytest.raises(ArgumentError) as caught:
        CaptureProtocol(**wrong)  # type: ignore[arg-type]
    assert str(caught.value) == sentence


@pytest.mark.parametrize("metered_s", [Fraction(0), Fraction(-1, 2)])
def test_metered_time_must_be_positive(metered_s: Fraction) -> None:
    with pytest.raises(ArgumentError, match="metered_s must be above 0 seconds"):
        RELEASED.exposure_s(RELEASED.frames()[0], metered_s)


@pytest.mark.parametrize("metered_s", [0.5, "4", None, True])
def test_metered_time_must_be_exact(metered_s: object) -> None:
    with pytest.raises(ArgumentError, match="metered_s must be a Fraction"):
        RELEASED.exposure_s(RELEASED.frames()[0], metered_s)  # type: ignore[arg-type]


def test_frame_of_another_protocol_is_refused() -> None:
    with pytest.raises(ArgumentError, match="is not a frame of"):
        RELEASED.exposure_s(PAPER.frames()[1], Fraction(4))


def test_records_are_frozen_and_hashable() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        RELEASED.base_iso = 200  # type: ignore[misc]
    assert len({RELEASED, CaptureProtocol(), PAPER}) == 2
    assert len(set(RELEASED.frames())) == 16


def test_public_names() -> None:
    assert {"CaptureProtocol", "PAPER", "ProtocolFrame", "RELEASED", "Plan", "CameraDescription"} <= set(
        vars(capture)["__all__"]
    )
    assert all(hasattr(capture, name) for name in vars(capture)["__all__"])
