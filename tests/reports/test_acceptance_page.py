"""The page of a noise model's acceptance test: what it says, safe with any name, and right in a browser."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import pytest

from eldata.calibration.acceptance.results import Acceptance
from eldata.noise import NoiseModel
from eldata.reports.acceptance import acceptance_page
from tests.calibration.judged import Specimen, judged
from tests.calibration.simulation import Camera
from tests.reports.pages import HOSTILE, assert_self_contained, assert_well_formed, checked, seen_in_browser

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture(scope="module")
def acceptance() -> Acceptance:
    found = judged(NoiseModel("P+G"), Specimen(Camera(shape=(128, 192))), bias=4, flats=(2000.0,), pairs=16)
    remarked = replace(found, remarks=(HOSTILE,))
    return Acceptance(HOSTILE, "NoiseModel('P+G')", 0, 16, (remarked, replace(found, iso=200.0)))


def test_the_page(acceptance: Acceptance) -> None:
    page = acceptance_page(acceptance)
    assert_well_formed(page)
    assert_self_contained(page)
    text = checked(page).text
    assert f"Off: {len(acceptance.off)} of " in text
    assert page.count('<td class="verdict off">') == len(acceptance.off)
    assert text.count("4 bias frames and 2 flats held out, 128 x 192 pixels compared") == 2
    assert page == acceptance_page(acceptance)


@pytest.mark.parametrize("width", [375])
def test_in_a_browser(chromium: str, acceptance: Acceptance, width: int, tmp_path: Path) -> None:
    seen = seen_in_browser(chromium, acceptance_page(acceptance), width, tmp_path)
    assert seen["width"] == width
    assert seen["wide"] == []
    assert all(complete and natural for complete, natural, *_ in seen["images"])
