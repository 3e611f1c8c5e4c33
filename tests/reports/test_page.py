"""The page: well-formed, self-contained, safe with any text, the same for the same seed, and right in a browser."""

from __future__ import annotations

import base64
import hashlib
import subprocess
import sys
from dataclasses import replace
from typing import TYPE_CHECKING
from xml.etree import ElementTree as ET

import pytest

from eldata.calibration.acceptance.theory import diagnose, sample_parameters
from eldata.reports.profile import plots, profile_page
from tests.reports.pages import HOSTILE, assert_self_contained, assert_well_formed, checked, seen_in_browser
from tests.waiting import PATIENCE_S

if TYPE_CHECKING:
    from pathlib import Path

    from eldata.calibration.acceptance.verdicts import Diagnostics
    from eldata.noise.profile import CameraProfile


@pytest.fixture(scope="module")
def page(diagnostics: Diagnostics) -> str:
    return profile_page(diagnostics)


@pytest.fixture(scope="module")
def hostile(sony: CameraProfile) -> str:
    """A page with bad words in every text of the profile, without ISOs, and with most comparisons off."""
    profile = replace(
        sony,
        camera=HOSTILE,
        source=HOSTILE,
        notes=(HOSTILE, "long" * 100),
        iso_range=None,
        black_level_dn=512.0,
        white_level_dn=16383.0,
        rows=tuple(replace(row, iso=None, gain_dn_per_e=None) for row in sony.rows),
    )
    return profile_page(
        diagnose(profile, sample_parameters(profile, 3), simulated=sample_parameters(sony, 4), spec="P*+G+B+R+U")
    )


def test_well_formed_with_semantic_headings(page: str) -> None:
    assert_well_formed(page)


def test_says_what_was_found(page: str, diagnostics: Diagnostics) -> None:
    text = checked(page).text
    assert "Noise of SonyA7S2" in text
    assert "Ok: all 61 comparisons within 4 standard errors" in text
    assert page.count('<td class="verdict ok">ok</td>') == 61
    assert "the published file names neither" in text
    for plain in ("DN^2", "sigma", "lambda"):
        assert plain not in text.replace("Tukey-lambda", "")


@pytest.mark.parametrize("which", ["page", "hostile"])
def test_self_contained(which: str, request: pytest.FixtureRequest) -> None:
    assert_self_contained(request.getfixturevalue(which))


def test_hostile_text_stays_text(hostile: str) -> None:
    checker = checked(hostile)
    assert checker.text.count(HOSTILE) == 4  # title, heading, source, note
    assert "<script" not in hostile
    assert "Off: " in checker.text
    assert "not known" in checker.text
    assert "512 DN" in checker.text


def test_images_have_words_and_are_sound(page: str) -> None:
    images = checked(page).all("img")
    assert len(images) == 9
    for image in images:
        assert len(image["alt"]) > 20
        svg = ET.fromstring(base64.b64decode(image["src"].partition(",")[2]))  # noqa: S314 # our own
        assert svg.tag == "{http://www.w3.org/2000/svg}svg"
        for side in ("width", "height"):
            assert float(svg.attrib[side].removesuffix("pt")) == pytest.approx(float(image[side]), abs=1)


def test_without_read_noise_there_is_no_plot_of_it_and_matplotlib_stays_as_it_was(sony: CameraProfile) -> None:
    import matplotlib as mpl

    before = dict(mpl.rcParams)
    drawn = plots(diagnose(sony, sample_parameters(sony, 0), spec="P*"))
    assert "read-noise" not in [plot.name for plot in drawn]
    assert all(plot.light != plot.dark for plot in drawn)
    assert dict(mpl.rcParams) == before


def test_measured_rows_are_drawn(page: str, diagnostics: Diagnostics) -> None:
    """They change the plot of their own scale, and no other."""
    sony = diagnostics.profile
    measured = replace(sony, rows=tuple(replace(row, sigma_tl_dn=1.0) for row in sony.rows))
    drawn = plots(replace(diagnostics, profile=measured))
    changed = {plot.name for plot in drawn if base64.b64encode(plot.light).decode() not in page}
    assert changed == {"read-fit"}


def test_another_process_makes_the_same_page_without_pyplot(page: str) -> None:
    code = (
        "import hashlib, sys\n"
        "from eldata.noise.profile import CameraProfile\n"
        "from eldata.calibration.acceptance.theory import diagnose, sample_parameters\n"
        "from eldata.reports.profile import profile_page\n"
        "profile = CameraProfile.load('SonyA7S2')\n"
        "page = profile_page(diagnose(profile, sample_parameters(profile, 0)))\n"
        "print(hashlib.sha256(page.encode()).hexdigest())\n"
        "print([name for name in ('matplotlib.pyplot', 'torch', 'rawpy') if name in sys.modules])\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=PATIENCE_S)
    assert done.stdout.split() == [hashlib.sha256(page.encode()).hexdigest(), "[]"], done.stderr


# --- in a browser -------------------------------------------------------------------------------------------------


@pytest.mark.browser
@pytest.mark.parametrize("width", [390, 1280])
@pytest.mark.parametrize("which", ["page", "hostile"])
def test_in_a_browser(chromium: str, which: str, width: int, request: pytest.FixtureRequest, tmp_path: Path) -> None:
    found = seen_in_browser(chromium, request.getfixturevalue(which), width, tmp_path)
    assert found["width"] == width
    assert found["scroll"] <= width
    assert found["wide"] == []
    assert len(found["images"]) == 9
    for complete, natural, shown_width, shown_height in found["images"]:
        assert complete
        assert natural > 0
        assert shown_width > 250
        assert shown_height > 200
    if which == "page":
        assert max(found["tables"]) <= 40  # hardly to be scrolled sideways; letters differ from system to system
