"""A file that lost a part of its data decodes to a whole frame: every command that reads it names it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tests.raw.damaging import PAGE, Whole

if TYPE_CHECKING:
    from pathlib import Path

    from tests.cli.conftest import Cli
    from tests.evaluation.helpers import Tree

REFERENCE = "DemoAlpha/scene-1/IMG_0006.dng"


def test_no_command_takes_it_for_whole(eldata: Cli, own: Tree, predictions: Path) -> None:
    """Its compressed data has a page of zeros, as an interrupted download leaves it.

    Regression: verify said "all well", lock recorded its hash, and evaluate scored it, 28.84 dB instead of 43.05.
    """
    path = own.files / REFERENCE
    whole = Whole.read(path)
    data = bytearray(whole.content)
    data[whole.first + 3000 : whole.first + 3000 + PAGE] = bytes(PAGE)
    path.write_bytes(data)
    manifest = own.manifest.read_bytes()
    place = own.arguments[1:]
    assert eldata("verify", *place, "--level", "metadata").code == 0
    for command in (("verify", *place, "--level", "full"), ("lock", *place), ("evaluate", predictions, *own.arguments)):
        outcome = eldata(*command)
        assert outcome.code == 1
        assert REFERENCE in outcome.out + outcome.err
        assert "bytes of 0x00 in a row" in outcome.out + outcome.err
    assert own.manifest.read_bytes() == manifest
