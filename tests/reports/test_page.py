"""The page: well-formed, self-contained, safe with any text, the same for the same seed, and right in a browser."""

from __future__ import annotations

import base64
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from html import unescape
from html.parser import HTMLParser
from itertools import pairwise
from typing import TYPE_CHECKING
from xml.etree import ElementTree as ET

import pytest

from eldata.reports.diagnostics import diagnose, sample_parameters
from eldata.reports.page import profile_page
from eldata.reports.plots import plots

if TYPE_CHECKING:
    from pathlib import Path

    from eldata.noise.profile import CameraProfile
    from eldata.reports.comparison import Diagnostics

HOSTILE = '<script>alert("x")</script>"\'&<img src=https://evil.example/x.png onerror=alert(1)>'
VOID = {"meta", "img", "source", "br", "link", "input", "hr"}


class Checker(HTMLParser):
    """Collects elements and complains about ones that are not closed in their order."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.elements: list[tuple[str, dict[str, str]]] = []
        self.text = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, {name: value or "" for name, value in attrs}))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open, f"</{tag}> closes nothing"
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data

    def all(self, *tags: str) -> list[dict[str, str]]:
        return [attributes for tag, attributes in self.elements if tag in tags]


def checked(page: str) -> Checker:
    checker = Checker()
    checker.feed(page)
    checker.close()
    assert checker.open == []
    return checker


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
    checker = checked(page)
    levels = [int(tag[1]) for tag, _ in checker.elements if re.fullmatch("h[1-6]", tag)]
    assert levels.count(1) == 1
    assert levels[0] == 1
    assert all(deeper - level <= 1 for level, deeper in pairwise(levels))
    identifiers = [attributes["id"] for _, attributes in checker.elements if "id" in attributes]
    assert len(identifiers) == len(set(identifiers))
    for _, attributes in checker.elements:
        assert attributes.get("aria-labelledby", identifiers[0]) in identifiers
    assert checker.all("html")[0]["lang"] == "en"
    assert len(checker.all("main")) == 1


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
    text: str = request.getfixturevalue(which)
    checker = checked(text)
    assert checker.all("script", "link", "iframe", "object", "embed", "base", "form") == []
    for tag, attributes in checker.elements:
        for name, value in attributes.items():
            assert not name.startswith("on"), f"{tag} has {name}"
            if name in ("src", "srcset", "href", "data", "action", "poster"):
                assert value.startswith(("data:image/svg+xml;base64,", "#")), f"{tag} has {name}={value[:60]}"
    assert "@import" not in text
    assert "url(" not in text
    (policy,) = [item["content"] for item in checker.all("meta") if item.get("http-equiv") == "Content-Security-Policy"]
    assert policy == "default-src 'none'; img-src data:; style-src 'unsafe-inline'"


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
        "from eldata.reports.diagnostics import diagnose, sample_parameters\n"
        "from eldata.reports.page import profile_page\n"
        "profile = CameraProfile.load('SonyA7S2')\n"
        "page = profile_page(diagnose(profile, sample_parameters(profile, 0)))\n"
        "print(hashlib.sha256(page.encode()).hexdigest())\n"
        "print([name for name in ('matplotlib.pyplot', 'torch', 'rawpy') if name in sys.modules])\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.stdout.split() == [hashlib.sha256(page.encode()).hexdigest(), "[]"], done.stderr


# --- in a browser -------------------------------------------------------------------------------------------------

PROBE = """<script>addEventListener("load", () => {
  const out = (item) => item.getBoundingClientRect().right > innerWidth + 0.5;
  const wide = [...document.querySelectorAll("body *")].filter((item) => !item.closest(".scroll, .skip") && out(item));
  parent.postMessage(JSON.stringify({
    width: innerWidth,
    scroll: document.documentElement.scrollWidth,
    wide: wide.map((item) => item.outerHTML.slice(0, 80)),
    images: [...document.images].map((item) => [item.complete, item.naturalWidth, item.width, item.height]),
    tables: [...document.querySelectorAll("div.scroll")].map((item) => item.scrollWidth - item.clientWidth),
  }), "*");
});</script></body>"""

# A window of --dump-dom is never narrower than 500 pixels; a frame in it may be.
FRAME = """<!DOCTYPE html><title>frame</title><pre id="probe"></pre><script>
addEventListener("message", (event) => { document.getElementById("probe").textContent = event.data; });
</script><iframe src="page.html" scrolling="no" style="border: 0; width: %dpx; height: 900px"></iframe>"""


@pytest.fixture(scope="module")
def chromium() -> str:
    found = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if found is None:
        if os.environ.get("ELDATA_REQUIRE_BROWSER"):
            pytest.fail("ELDATA_REQUIRE_BROWSER is set and there is no chromium")
        pytest.skip("no chromium here; apt-get install chromium")
    return found


@pytest.mark.parametrize("width", [390, 1280])
@pytest.mark.parametrize("which", ["page", "hostile"])
def test_in_a_browser(chromium: str, which: str, width: int, request: pytest.FixtureRequest, tmp_path: Path) -> None:
    text: str = request.getfixturevalue(which)
    # The probe is a script, which the page's own policy would refuse.
    probed = re.sub('<meta http-equiv="Content-Security-Policy"[^>]*>', "", text).replace("</body>", PROBE)
    (tmp_path / "page.html").write_text(probed, encoding="utf-8")
    path = tmp_path / "frame.html"
    path.write_text(FRAME % width, encoding="utf-8")
    options = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"]
    options += ["--disable-background-networking", "--disable-component-update", "--disable-sync"]
    options += [f"--user-data-dir={tmp_path / 'user'}", "--window-size=1600,1000", "--virtual-time-budget=5000"]
    command = [chromium, *options, "--dump-dom", path.as_uri()]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    match = re.search(r'<pre id="probe">(.+?)</pre>', done.stdout, flags=re.DOTALL)
    assert match, done.stderr[-2000:]
    found = json.loads(unescape(match[1]))
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
