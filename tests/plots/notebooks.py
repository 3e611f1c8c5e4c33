"""What a notebook is given: one line of text, and HTML that holds itself together."""

from __future__ import annotations

import re
from typing import Any

from tests.reports.pages import checked

# Colours of the page's own, and greys that show on white and on black.
_COLOURS = {"inherit", "none"}


def assert_one_line(shown: object, part: str) -> None:
    text = repr(shown)
    assert part in text
    assert "\n" not in text
    assert text.isprintable()


def assert_shows_in_a_notebook(shown: Any, *parts: str) -> None:
    """Well-formed, without script, style sheet or address, readable on a dark page; it says these texts."""
    html = shown._repr_html_()
    page = checked(html)
    for part in parts:
        assert part in page.text, part
    assert {tag for tag, _ in page.elements} <= {
        *("div", "p", "b", "table", "thead", "tbody", "tr", "th", "td", "figure", "img", "figcaption")
    }
    for tag, attributes in page.elements:
        assert set(attributes) <= ({"src", "alt"} if tag == "img" else {"style"}), tag
        for colour in re.findall(r"(?:^|; )(?:color|background): ([^;]+)", attributes.get("style", "")):
            assert colour in _COLOURS
    for picture in page.all("img"):
        assert picture["alt"]
        assert picture["src"].startswith("data:image/jpeg;base64,")
        assert len(picture["src"]) < 30_000
    assert page.text.replace("\n", " ").isprintable()
