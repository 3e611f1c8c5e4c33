"""The pages of calibrations: complete, self-contained, safe, the same each time."""

from __future__ import annotations

import base64
import hashlib
import io
import math
import subprocess
import sys
from dataclasses import replace
from typing import TYPE_CHECKING
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from PIL import Image

from eldata.plots.pictures import grey_png
from eldata.reports.calibration import calibration_page
from eldata.reports.html import digits, format_measured, prose, typeset
from tests.calibration.simulation import XTRANS
from tests.reports import calibrations
from tests.reports.calibrations import camera_at
from tests.reports.pages import HOSTILE, OUTSIDE, assert_self_contained, assert_well_formed, checked
from tests.shared import there
from tests.waiting import PATIENCE_S

if TYPE_CHECKING:
    from pathlib import Path

    from eldata.calibration.iso_results import IsoCalibration
    from eldata.calibration.results import Calibration
    from tests.capture.checklist_browser import Page

DRAWINGS, PICTURES = 8, 1 + 2 + 4  # of an ISO that has everything: spectrum, two frames, shading by channel


@pytest.fixture(scope="module")
def isos() -> tuple[IsoCalibration, ...]:
    """Three ISOs with all that there can be, the noise of the middle one off the line."""
    off = camera_at(800.0, sigma_tl=2.9, sigma_row=0.4, prnu=0.003)
    cameras = {100.0: camera_at(100.0), 800.0: off, 6400.0: camera_at(6400.0, shading=4.0)}
    return tuple(calibrations.measured(iso, camera) for iso, camera in cameras.items())


@pytest.fixture(scope="module")
def calibration(isos: tuple[IsoCalibration, ...]) -> Calibration:
    wary = ("K comes from 2 pairs of flats; 4 levels or more are advised", "R2 of the Tukey-lambda plot is 0.9")
    first, second, third = isos
    return replace(
        calibrations.calibration((replace(first, remarks=wary[:1]), second, replace(third, remarks=wary))),
        remarks=("sigma_row was 0 at 1 ISO, which its fit leaves out",),
    )


@pytest.fixture(scope="module")
def page(calibration: Calibration) -> str:
    return calibration_page(calibration)


@pytest.fixture(scope="module")
def sparse(isos: tuple[IsoCalibration, ...]) -> str:
    """Two ISOs and a hostile name: one without flats, comparison, row noise or errors, one without a second method."""
    bare = calibrations.measured(200.0, camera_at(200.0, sigma_row=0.0, dsnu=0.0, column_pattern=0.0), frames=4)
    quiet = replace(bare.rows.rows, sigma_dn=0.0, sigma_error_dn=0.03, fixed_sigma_dn=0.0)
    bare = replace(
        bare,
        transfer=None,
        flat_frames=0,
        rows=replace(bare.rows, rows=quiet),
        read=replace(there(bare.read), tukey_lambda_error=math.nan, sigma_gauss_error_dn=math.nan),
        bias=replace(bare.bias, standard_error_dn=(math.nan,) * 4),
        pattern=replace(bare.pattern, shading_dn=np.zeros_like(bare.pattern.shading_dn)),
        remarks=(HOSTILE, "\x1b[2J" + "long" * 100),
    )
    return calibration_page(calibrations.calibration((bare, isos[1]), HOSTILE))


@pytest.fixture(scope="module")
def xtrans() -> str:
    """One ISO of a camera with three channels."""
    camera = camera_at(800.0, cfa=XTRANS, bias=(1.0, -1.0, 0.5))
    return calibration_page(calibrations.calibration([calibrations.measured(800.0, camera)]))


PAGES = ("page", "sparse", "xtrans")
EVERY = pytest.mark.parametrize("which", PAGES)


# --- every page ---------------------------------------------------------------------------------------------------


@EVERY
def test_well_formed_and_self_contained(which: str, request: pytest.FixtureRequest) -> None:
    assert_well_formed(request.getfixturevalue(which))
    assert_self_contained(request.getfixturevalue(which))
    assert "<script" not in request.getfixturevalue(which)


def test_hostile_text_stays_text(sparse: str) -> None:
    checker = checked(sparse)
    assert checker.text.count(HOSTILE) == 4  # title, heading, remarks
    assert "\x1b" not in sparse, "and what does not show is shown"
    assert not any(HOSTILE in value for _, attributes in checker.elements for value in attributes.values())


def test_images_have_words_are_sound_and_drawn_for_both_themes(page: str) -> None:
    checker = checked(page)
    images, dark = checker.all("img"), iter(checker.all("source"))
    assert len(images) == 7 + 3 * (DRAWINGS + PICTURES) == len({image["alt"] for image in images})
    for image in images:
        assert len(image["alt"]) > 20
        assert any(letter.isdigit() for letter in image["alt"])
        kind, _, data = image["src"].partition(",")
        content = base64.b64decode(data)
        sides = int(image["width"]), int(image["height"])
        if kind.startswith("data:image/png"):
            assert Image.open(io.BytesIO(content)).size == sides
            continue
        svg = ET.fromstring(content)  # noqa: S314 # our own
        assert svg.tag == "{http://www.w3.org/2000/svg}svg"
        found = [float(svg.attrib[side].removesuffix("pt")) for side in ("width", "height")]
        assert found == pytest.approx(sides, abs=1)
        # What it draws with is in it.
        names = {element.attrib["id"] for element in svg.iter() if "id" in element.attrib}
        used = {element.attrib["href"].removeprefix("#") for element in svg.iter() if "href" in element.attrib}
        assert used <= names
        light, other = content.decode(), base64.b64decode(next(dark)["srcset"].partition(",")[2]).decode()
        assert "#1f2933" in light
        assert "#1f2933" not in other
        assert "#e6eaee" in other
    assert next(dark, None) is None


ANOTHER = """
import hashlib, sys
from tests.reports.calibrations import calibration, camera_at, measured
from eldata.reports.calibration import calibration_page
page = calibration_page(calibration([measured(800.0, camera_at(800.0))]))
print(hashlib.sha256(page.encode()).hexdigest(), 'matplotlib.pyplot' in sys.modules)
"""


def test_another_process_makes_the_same_page_without_pyplot() -> None:
    done = subprocess.run([sys.executable, "-c", ANOTHER], capture_output=True, text=True, timeout=PATIENCE_S)
    made = calibration_page(calibrations.calibration([calibrations.measured(800.0, camera_at(800.0))]))
    assert done.stdout.split() == [hashlib.sha256(made.encode()).hexdigest(), "False"], done.stderr


# --- calibrations -------------------------------------------------------------------------------------------------


def test_says_what_was_measured(page: str, calibration: Calibration) -> None:
    text = checked(page).text
    assert "Noise calibration of TestCamera" in text
    assert "Made from 15 bias and 24 flat frames of 384 × 264 pixels, and compared with 3 more bias frames." in text
    gains = [digits(one.gain_dn_per_e or 0.0) for one in calibration.isos]
    assert f"3 ISOs from 100 to 6400, K from {gains[0]} to {gains[-1]} DN/e⁻." in text
    for one in calibration.isos:
        assert f"ISO {one.iso:g}" in text
        assert one.transfer is not None
        assert format_measured(one.transfer.gain_dn_per_e, one.transfer.gain_error) in text
    tables = calibration.tables()
    for header, rows in (tables[name] for name in ("figures", "colour-bias", "reproduction")):
        for cell in (*header, *(cell for row in rows for cell in row)):
            assert typeset(cell).replace("-", "−") in text.replace("-", "−")
    for row in tables["fits"][1]:
        for cell in row[1:]:
            assert cell.replace("-", "−") in text
    for plain in ("DN^2", "sigma", "lambda", "R2 ", "nan"):
        assert plain not in text.replace("Tukey-lambda", "").replace("Tukey lambda", "")


def test_remarks_come_first_and_once(page: str) -> None:
    text = checked(page).text
    assert "Read before use: 4 remarks, on ISO 100, ISO 6400 and the calibration as a whole." in text
    top = text[: text.index("Measured values")]
    assert "ISO 100 and 6400: K comes from 2 pairs of flats" in top
    assert top.count("K comes from 2 pairs") == 1
    assert "ISO 6400: R² of the Tukey-lambda plot is 0.9" in top
    assert "σ row was 0 at 1 ISO" in top


def test_nothing_to_be_wary_of(xtrans: str, isos: tuple[IsoCalibration, ...]) -> None:
    quiet = replace(calibrations.calibration(isos[:1]), remarks=())
    assert "No problems found." in checked(calibration_page(quiet)).text
    assert "Read before use: 3 remarks, on the calibration as a whole." in checked(xtrans).text  # no fit over one ISO


def test_sections_are_linked_and_the_first_is_open(page: str) -> None:
    checker = checked(page)
    assert [item["href"] for item in checker.all("a")] == ["#main", "#iso-100", "#iso-800", "#iso-6400"]
    assert ["open" in item for item in checker.all("details")] == [True, False, False]
    assert page.count("<h3>Row noise</h3>") == 3


def test_what_is_missing_is_said(sparse: str) -> None:
    checker = checked(sparse)
    assert "K is not known and there is no photon transfer line" in checker.text
    assert "None was kept out: there were only 4 bias frames" in checker.text
    assert "not given at 1 of them" in checker.text
    assert "Lines of ln σ over ln K" not in checker.text  # two ISOs make none
    assert "nan" not in checker.text
    assert not any("nan" in image["alt"] for image in checker.all("img"))
    assert "–" in checker.text


def test_no_gain_at_all(isos: tuple[IsoCalibration, ...], calibration: Calibration) -> None:
    without = replace(isos[0], transfer=None, reproduction=None)
    text = calibration_page(replace(calibration, isos=(without,), modes=()))
    assert "ISO 100; K is not known, for want of flats." in checked(text).text
    assert "K over ISO" not in text


def test_three_channels(xtrans: str) -> None:
    text = checked(xtrans).text
    assert "K of G" in text
    assert "G1" not in text
    assert "ISO 800, K is" in text


# --- parts --------------------------------------------------------------------------------------------------------


def test_text_of_pages() -> None:
    assert typeset("sigma_TL in DN^2, 3 e-, lambda, R2") == "σ TL in DN², 3 e⁻, λ, R²"
    assert typeset("single-frame, Tukey-lambda, one-") == "single-frame, Tukey-lambda, one-"
    assert prose("from -0.05 to 3-4, p = -.1 (-2), ISO-100") == "from −0.05 to 3-4, p = −.1 (−2), ISO-100"
    assert [digits(value) for value in (-0.01234, 12345.0, math.nan)] == ["−0.0123", "1.23e+04", "not known"]
    numbers = format_measured(-1.234, 0.02, "DN"), format_measured(1.0, math.nan), format_measured(math.nan, 1.0)
    assert numbers == ("−1.234 ± 0.020 DN", "1", "not known")


def test_grey_spans_black_and_white() -> None:
    found = np.asarray(Image.open(io.BytesIO(grey_png(np.array([[-1.0, 0.0, 1.0, 9.0]]), -1.0, 1.0))))
    assert found[0, 0] == 0
    assert found[0, 1] == pytest.approx(127.5, abs=5)
    assert found[0, 2] == found[0, 3] == 255


# --- in a browser -------------------------------------------------------------------------------------------------


@pytest.mark.browser
@pytest.mark.parametrize(("which", "width"), [*((which, 390) for which in PAGES), ("page", 1280)])
def test_in_a_browser(bare: Page, which: str, width: int, request: pytest.FixtureRequest, tmp_path: Path) -> None:
    text = request.getfixturevalue(which).replace('<details class="iso">', '<details class="iso" open>')
    (tmp_path / "page.html").write_text(text, encoding="utf-8")
    bare.resize(width)
    bare.open((tmp_path / "page.html").as_uri())
    assert bare.run("innerWidth") == width
    assert bare.run("document.documentElement.scrollWidth") <= width
    assert bare.run(OUTSIDE) == []
    images = bare.run("[...document.images].map((e) => [e.complete, e.naturalWidth, e.width, e.height])")
    for complete, natural, *shown in images:
        assert complete
        assert natural > 0
        assert all(side > least for side, least in zip(shown, (130, 80), strict=True))
