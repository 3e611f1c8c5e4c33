"""A file that lost a part of its data decodes to a whole frame: every command that reads it names it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from tests.raw.damaging import PAGE, Whole

if TYPE_CHECKING:
    from pathlib import Path

    from tests.cli.conftest import Cli
    from tests.evaluation.helpers import Tree

REFERENCE = "DemoAlpha/scene-1/IMG_0006.dng"


@pytest.fixture
def holed(own: Tree) -> Tree:
    """A copy whose reference has a page of zeros in its compressed data, as an interrupted download leaves it."""
    path = own.files / REFERENCE
    whole = Whole.read(path)
    data = bytearray(whole.content)
    data[whole.first + 3000 : whole.first + 3000 + PAGE] = bytes(PAGE)
    path.write_bytes(data)
    return own


def options(tree: Tree) -> tuple[str | Path, ...]:
    return "--manifest", tree.manifest, "--root", tree.root


def test_verify_full_names_it(eldata: Cli, holed: Tree) -> None:
    """Regression: "all well"."""
    assert eldata("verify", holed.manifest, "--root", holed.root, "--level", "metadata").code == 0
    outcome = eldata("verify", holed.manifest, "--root", holed.root, "--level", "full")
    assert (outcome.code, outcome.err) == (1, "")
    assert f"{REFERENCE}: content" in outcome.out
    assert "bytes of 0x00 in a row" in outcome.out
    assert "1 problem\n" in outcome.out


def test_lock_does_not_make_it_official(eldata: Cli, holed: Tree) -> None:
    before = holed.manifest.read_bytes()
    outcome = eldata("lock", holed.manifest, "--root", holed.root)
    assert (outcome.code, outcome.err) == (1, "")
    assert f"{REFERENCE}: content: expected a raw file that decodes, found damaged: " in outcome.out
    assert holed.manifest.read_bytes() == before


def test_evaluate_does_not_score_it(eldata: Cli, holed: Tree, predictions: Path) -> None:
    """Regression: the other pairs' mean and a score of 28.84 dB in place of 43.05."""
    outcome = eldata("evaluate", predictions, *options(holed))
    assert outcome.code == 1
    assert REFERENCE in outcome.out + outcome.err
    assert "bytes of 0x00 in a row" in outcome.out + outcome.err
