"""`capture protocol`: print the frames of one scene: order, ISO, low-light factor, exposure time, reference.

Print the frames that the capture protocol takes of one scene, in order. The defaults are those of the released ELD
dataset; the paper's own settings are --factors 100 200.

    capture protocol --metered 4
    capture protocol --repeats 10
"""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

from capture.cli.values import add_alike, add_numbers, given_counts, or_dash, seconds, spaced
from capture.protocol import RELEASED, CaptureProtocol
from eldata.base.console import OK, add_shared, show_and_write, whole_number
from eldata.base.tables import text_table

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence
    from fractions import Fraction

    from capture.protocol import ProtocolFrame


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add its options."""
    parser.add_argument(
        "--metered",
        type=seconds,
        metavar="SECONDS",
        help="time that exposes the scene well at the base ISO, as 4, 1/2 or 0.5; adds the exposure times",
    )
    parser.add_argument(
        "--base-iso",
        type=whole_number(1),
        default=RELEASED.base_iso,
        metavar="ISO",
        help="ISO of the references (default: %(default)s)",
    )
    isos, factors = RELEASED.noisy_isos, RELEASED.low_light_factors
    add_numbers(parser, "--isos", "ISO", f"ISOs of the noisy frames (default: {spaced(isos)})", isos)
    add_numbers(parser, "--factors", "FACTOR", f"low-light factors (default: {spaced(factors)})", factors)
    add_alike(parser)
    add_shared(parser, run, json=True)


def run(options: argparse.Namespace) -> int:
    """Run this command."""
    protocol = CaptureProtocol(options.base_iso, tuple(options.isos), tuple(options.factors), **given_counts(options))
    metered_s: Fraction | None = options.metered
    frames = protocol.frames()
    exposures = [None if metered_s is None else str(protocol.exposure_s(frame, metered_s)) for frame in frames]
    listed = [asdict(frame) | {"exposure_s": exposure} for frame, exposure in zip(frames, exposures, strict=True)]
    metered = None if metered_s is None else str(metered_s)
    rows = [
        (
            str(frame.number),
            frame.role,
            str(frame.iso),
            or_dash(frame.factor, "x{}"),
            or_dash(exposure, "{} s"),
            or_dash(frame.reference),
        )
        for frame, exposure in zip(frames, exposures, strict=True)
    ]
    table = text_table(("frame", "role", "ISO", "factor", "exposure", "reference"), rows, left=(1,))
    show_and_write(
        options,
        lambda: f"{table}\n{_summary(protocol, frames)}",
        lambda: asdict(protocol) | {"metered_s": metered, "frames": listed},
    )
    return OK


def _summary(protocol: CaptureProtocol, frames: Sequence[ProtocolFrame]) -> str:
    references = sum(frame.role == "reference" for frame in frames)
    noisy = len(frames) - references
    return (
        f"{len(frames)} frames per scene: {references} references at ISO {protocol.base_iso}, {noisy} noisy "
        f"(ISOs: {len(protocol.noisy_isos)}, factors: {len(protocol.low_light_factors)}"
        f"{'' if protocol.repeats == 1 else f', frames of each: {protocol.repeats}'})"
    )
