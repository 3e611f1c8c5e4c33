"""The command ``capture``: what to photograph, on the terminal."""

from __future__ import annotations

import argparse
import re
from fractions import Fraction
from typing import TYPE_CHECKING

from capture.protocol import RELEASED, CaptureProtocol
from eldata import __version__
from eldata.console import OK, Parser, add_debug, add_json, run, write_json
from eldata.tables import text_table

if TYPE_CHECKING:
    from collections.abc import Sequence

    from capture.protocol import ProtocolFrame

# Bounded: a mistyped key must not ask for products of thousands of digits.
_WHOLE = re.compile(r"-?[0-9]{1,9}")
_SECONDS = re.compile(r"-?(?:[0-9]{1,9}(?:/[0-9]{1,9}|\.[0-9]{1,9})?|\.[0-9]{1,9})")


def main(argv: list[str] | None = None) -> int:
    """Run the command ``capture``; return its exit code (:mod:`eldata.console`)."""
    return run(_parser(), argv)


def _parser() -> argparse.ArgumentParser:
    parser = Parser(prog="capture", description="Photograph scenes for a low-light denoising dataset.")
    parser.add_argument("--version", action="version", version=f"capture {__version__}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND")
    protocol = commands.add_parser(
        "protocol",
        help="print the frames of one scene: order, ISO, low-light factor, exposure time, reference",
        description="Print the frames that the capture protocol takes of one scene, in order. The defaults "
        "are those of the released ELD dataset; the paper's own settings are --factors 100 200.",
    )
    protocol.add_argument(
        "--metered",
        type=_seconds,
        metavar="SECONDS",
        help="time that exposes the scene well at the base ISO, as 4, 1/2 or 0.5; adds the exposure times",
    )
    protocol.add_argument(
        "--base-iso",
        type=_whole,
        default=RELEASED.base_iso,
        metavar="ISO",
        help="ISO of the references (default: %(default)s)",
    )
    protocol.add_argument(
        "--isos",
        type=_whole,
        nargs="+",
        default=RELEASED.noisy_isos,
        metavar="ISO",
        help=f"ISOs of the noisy frames (default: {_spaced(RELEASED.noisy_isos)})",
    )
    protocol.add_argument(
        "--factors",
        type=_whole,
        nargs="+",
        default=RELEASED.low_light_factors,
        metavar="FACTOR",
        help=f"low-light factors (default: {_spaced(RELEASED.low_light_factors)})",
    )
    add_json(protocol)
    add_debug(protocol)
    protocol.set_defaults(run=_protocol, command="protocol")
    return parser


def _spaced(numbers: Sequence[int]) -> str:
    return " ".join(map(str, numbers))


def _whole(text: str) -> int:
    if _WHOLE.fullmatch(text) is None:
        raise argparse.ArgumentTypeError(f"expected a whole number of at most nine digits, found {text!r}")
    return int(text)


def _seconds(text: str) -> Fraction:
    if _SECONDS.fullmatch(text) is None:
        raise argparse.ArgumentTypeError(f"expected seconds such as 4, 1/2 or 0.5, found {text!r}")
    try:
        seconds = Fraction(text)
    except ZeroDivisionError:
        raise argparse.ArgumentTypeError(f"expected seconds such as 1/2, found {text!r}: a division by 0") from None
    if seconds <= 0:
        raise argparse.ArgumentTypeError(f"expected a time above 0 seconds, found {text!r}")
    return seconds


def _protocol(options: argparse.Namespace) -> int:
    protocol = CaptureProtocol(options.base_iso, tuple(options.isos), tuple(options.factors))
    metered_s: Fraction | None = options.metered
    frames = protocol.frames()
    exposures_s = [None if metered_s is None else protocol.exposure_s(frame, metered_s) for frame in frames]
    if options.json is not None:
        content = _as_json(protocol, metered_s, frames, exposures_s)
        write_json(options.json, content)
    print(_table(frames, exposures_s))
    print(_summary(protocol, frames))
    return OK


def _as_json(
    protocol: CaptureProtocol,
    metered_s: Fraction | None,
    frames: Sequence[ProtocolFrame],
    exposures_s: Sequence[Fraction | None],
) -> dict[str, object]:
    return {
        "base_iso": protocol.base_iso,
        "noisy_isos": protocol.noisy_isos,
        "low_light_factors": protocol.low_light_factors,
        "metered_s": _exact(metered_s),
        "frames": [
            {
                "number": frame.number,
                "role": frame.role,
                "iso": frame.iso,
                "factor": frame.factor,
                "exposure_s": _exact(exposure_s),
                "reference": frame.reference,
            }
            for frame, exposure_s in zip(frames, exposures_s, strict=True)
        ],
    }


def _exact(seconds: Fraction | None) -> str | None:
    return None if seconds is None else str(seconds)


def _table(frames: Sequence[ProtocolFrame], exposures_s: Sequence[Fraction | None]) -> str:
    header = ("frame", "role", "ISO", "factor", "exposure", "reference")
    rows = []
    for frame, exposure_s in zip(frames, exposures_s, strict=True):
        factor = "-" if frame.factor is None else f"x{frame.factor}"
        exposure = "-" if exposure_s is None else f"{exposure_s} s"
        reference = "-" if frame.reference is None else str(frame.reference)
        rows.append((str(frame.number), frame.role, str(frame.iso), factor, exposure, reference))
    return text_table(header, rows, left=(1,))


def _summary(protocol: CaptureProtocol, frames: Sequence[ProtocolFrame]) -> str:
    references = sum(frame.role == "reference" for frame in frames)
    noisy = len(frames) - references
    return (
        f"{len(frames)} frames a scene: {references} references at ISO {protocol.base_iso}, {noisy} noisy "
        f"(ISOs: {len(protocol.noisy_isos)}, factors: {len(protocol.low_light_factors)})"
    )
