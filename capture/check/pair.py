"""Check one pair: a noisy frame against its reference. What is found is one row; the manifest keeps two of its values.

The exposure ratio that the pixels show is held against the nominal one, which only names the frame, and against what
EXIF states, by which an input is amplified. Names of shutter times are rounded (30 s are 32 s, 1/200 s is 1/203 s), so
a conflict with EXIF need not be anybody's mistake; but it costs as much of a score as light that changed, so it is
settled only where the manifest holds the measured ratio.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Final

from capture.check.common_shift import common_shift
from capture.check.flicker import Flicker, flicker_of_contrast
from capture.check.frames import ReducedFrame, file_name
from capture.check.kinds import FINE_NOISE, FLICKER, GAPS, MATCH, MOVEMENT, SHIFT, SIGNAL
from capture.check.limits import LIGHT_AGAIN, LIGHT_LOOK, LIGHT_SOURCE, RATIO_AGAIN, RATIO_LOOK, RATIO_SOURCE
from capture.check.measures import SIGMAS, Estimate, MeasureKind
from capture.check.noise_structure import fine_noise
from capture.check.ratio import changed_share, fit_ratio
from capture.check.result import CheckedPair
from capture.shutter import ladder
from eldata.errors import RawFileError
from eldata.manifest.pairs import UNCERTAIN_ISO

if TYPE_CHECKING:
    from collections.abc import Mapping

    from capture.check.cells import Cells
    from capture.check.result import CheckedGroup
    from capture.check.shift import Tiles
    from eldata.records import Exposure, FrameRecord, RawHeader

_INFINITE: Final = float("inf")
_STEPS: Final = (Fraction(1, 3), Fraction(1, 2))
_RECORD_IT: Final = (
    'capture check --write puts the measured ratio into the manifest, and amplification="measured" uses it'
)


@dataclass(frozen=True, slots=True, eq=False)
class SeenReference:
    """What is kept of a reference while the noisy frames pass: cells, header, and tiles if it has the size for any."""

    cells: Cells
    header: RawHeader
    tiles: Tiles | None


def check_pair(
    frame: ReducedFrame,
    named: str,
    references: Mapping[str, SeenReference],
    noisy: list[FrameRecord],
    group: CheckedGroup,
) -> None:
    """Measure a noisy frame against its reference, ``named``: the scene that it shows, place, exposure ratio, flicker.

    ``noisy`` are all noisy frames of the scene.
    """
    record, path = frame.record, frame.record.path
    pair = CheckedPair(path, named)
    group.pairs.append(pair)
    group.measure(GAPS, path, "share of the values between others that never occur", 100 * frame.empty_share)
    reference = references.get(named)
    if reference is None:
        text = f"its reference {file_name(named)} cannot be used" if named else "the scene has no reference"
        group.remark(path, text, "shoot again")
        return
    fit = fit_ratio(reference.cells, frame.cells)
    if fit is None:
        text = "too few pixels that are neither saturated nor clipped at black: its exposure ratio cannot be measured"
        group.remark(path, text)
        return
    against = file_name(named)
    text = f"how much of the scene in {against} it shows"
    match = group.measure(MATCH, path, text, 100 * fit.match.value, 100 * fit.match.standard_error)
    if match.verdict == "shoot again":
        return  # with another scene there is neither shift nor ratio
    if _measure_place(frame, reference, against, pair, group) == "shoot again":
        return  # what is measured pixel by pixel would show the shift again
    exif_ratio = _exif_ratio(reference.header, frame.header)
    nominal = record.ratio
    if fit.ratio is None:
        expected = nominal or exif_ratio
        if expected is not None:
            text = f"signal, as a share of that at a ratio of {_number(expected)}; too little to measure the ratio by"
            scale = 100 * float(expected)
            group.measure(SIGNAL, path, text, scale * fit.slope.value, scale * fit.slope.standard_error)
        return
    pair.ratio = fit.ratio
    if nominal is not None:
        text = f"exposure ratio to {against} by the pixels, nominally {_number(nominal)}"
        kind = _nominal_kind(nominal, _ratio_advice(record, fit.ratio, exif_ratio, noisy))
        group.measure(kind, path, text, fit.ratio.value, fit.ratio.standard_error)
    if exif_ratio is not None:
        text = f"exposure ratio to {against} by the pixels, {_number(exif_ratio)} by EXIF"
        kind = _exif_kind(record, fit.ratio, exif_ratio, _given_ratio(reference.header.exposure, frame.header.exposure))
        group.measure(kind, path, text, fit.ratio.value, fit.ratio.standard_error)
    fine = group.row(pair).get(FINE_NOISE.name)
    if fine is None or fine.verdict == "keep":  # else edges differ everywhere
        changed = changed_share(reference.cells, frame.cells, fit.slope.value, fit.offset_dn)
        text = f"share of the picture that changed differently from the whole to {against}"
        # Without an error: only what exceeds eight of them is counted.
        group.measure(MOVEMENT, path, text, 100 * changed)
    add_flicker(group, path, flicker_of_contrast(fit.residuals))


def add_flicker(group: CheckedGroup, path: str, flicker: Flicker | None) -> None:
    """Add what flicker was measured in a frame, if it was."""
    if flicker is not None:
        text = f"bands across the picture, {flicker.cycles:g} per frame, amplitude"
        group.measures.append(flicker.measure(FLICKER, path, text))


def _measure_place(
    frame: ReducedFrame, reference: SeenReference, against: str, pair: CheckedPair, group: CheckedGroup
) -> str:
    """Measure how far the frame lies from its reference; return the verdict."""
    found = None if reference.tiles is None else common_shift(reference.tiles, frame.luminance)
    if found is None:
        pair.notes.append("texture or light is too weak to tell a shift")
        return "keep"
    pair.shift = found.shift.length(found.pixels, frame.scale)
    unseen = SIGMAS * pair.shift.standard_error
    if unseen > SHIFT.again:
        pair.notes.append(f"texture or light is weak: a shift below {unseen:.1f} px may not be seen")
    text = f"distance from {against}"
    verdict = group.measure(SHIFT, pair.path, text, pair.shift.value, pair.shift.standard_error).verdict
    fine = fine_noise(found) if verdict == "keep" else None  # else the scene is left over, too
    if fine is not None:
        text = "power of the finest noise over that of coarser noise"
        group.measure(FINE_NOISE, pair.path, text, 100 * fine.value, 100 * fine.standard_error)
    return verdict


# --- ratios -------------------------------------------------------------------------------------------------------


def _exif_ratio(reference: RawHeader, noisy: RawHeader) -> Fraction | None:
    from eldata.raw.reading import exposure_ratio

    try:
        return exposure_ratio(reference, noisy)
    except RawFileError:
        return None


def _given_ratio(reference: Exposure, noisy: Exposure) -> tuple[float, ...]:
    """Return the ratios by the times that shutters in steps of a third or a half give where EXIF has the names."""
    if reference.iso is None or noisy.iso is None:
        return ()
    speeds = float(reference.iso / noisy.iso)
    found = []
    for step in _STEPS:
        long, short = (ladder(step).get(one.exposure_s or Fraction(0)) for one in (reference, noisy))
        if long is not None and short is not None:
            found.append(speeds * long.true_s / short.true_s)
    return tuple(found)


def _nominal_kind(nominal: Fraction, advice: str) -> MeasureKind:
    value = float(nominal)
    return MeasureKind("ratio", "", RATIO_LOOK * value, RATIO_AGAIN * value, RATIO_SOURCE, advice, expected=value)


def _exif_kind(record: FrameRecord, ratio: Estimate, exif_ratio: Fraction, given: tuple[float, ...]) -> MeasureKind:
    """Return what is expected of a ratio that EXIF states, or that the manifest holds as measured."""
    stated, recorded = float(exif_ratio), record.measured_ratio
    doubted = UNCERTAIN_ISO in record.flags
    settled = recorded is not None and (doubted or abs(float(recorded) / stated - 1) <= RATIO_AGAIN)
    expected = float(recorded) if recorded is not None and settled else stated
    again = LIGHT_AGAIN * expected
    nearest = min(given, key=lambda one: abs(ratio.value - one), default=None)
    if settled:
        advice = "it is not the ratio that the manifest holds as measured: was the file replaced? Write it again"
    elif doubted:
        again = _INFINITE
        advice = f"EXIF has the names of ISOs, whose measured speeds are others: {_RECORD_IT}"
    elif nearest is not None and abs(ratio.value - nearest) <= max(LIGHT_LOOK * nearest, SIGMAS * ratio.standard_error):
        again = _INFINITE
        advice = f"EXIF has the rounded names of the shutter's times: {_RECORD_IT}"
    else:
        advice = (
            "the light changed, the shutter is off, or it is not the file that the camera wrote; to keep it anyway, "
            'record the ratio with capture check --write and use amplification="measured"'
        )
    return MeasureKind("EXIF ratio", "", LIGHT_LOOK * expected, again, LIGHT_SOURCE, advice, expected=expected)


def _ratio_advice(record: FrameRecord, ratio: Estimate, exif_ratio: Fraction | None, noisy: list[FrameRecord]) -> str:
    """Return what may have happened to a frame whose ratio is not the nominal one."""
    if exif_ratio is not None and _fits(ratio, exif_ratio):
        cause = "EXIF says the same: taken with another setting, or under another frame's name"
    else:
        cause = "EXIF does not show it"
    like = [
        other
        for other in noisy
        if other is not record and other.iso == record.iso and other.ratio is not None and _fits(ratio, other.ratio)
    ]
    if like:
        return f"{cause}; it fits {file_name(like[0].path)} (x{_number(like[0].ratio)}): swapped?"
    return f"{cause}; check the settings, then correct the manifest or shoot it again"


def _fits(ratio: Estimate, expected: Fraction) -> bool:
    return abs(ratio.value - float(expected)) <= RATIO_LOOK * float(expected)


def _number(value: Fraction | None) -> str:
    return "?" if value is None else f"{float(value):.4g}"
