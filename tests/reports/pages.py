"""Checks of the text of pages, and what a browser is asked about them."""

from __future__ import annotations

import base64
import hashlib
import re
from html.parser import HTMLParser
from itertools import pairwise

HOSTILE = '<script>alert("x")</script>"\'&<img src=https://evil.example/x.png onerror=alert(1)>'
EMBEDDED = ("data:image/svg+xml;base64,", "data:image/png;base64,", "data:image/jpeg;base64,", "#")
OUTSIDE = (
    "[...document.querySelectorAll('body *')].filter((e) => !e.closest('.scroll, .skip, .unseen, .glass') &&"
    " e.getBoundingClientRect().right > innerWidth + 0.5).map((e) => e.outerHTML.slice(0, 80))"
)
"""What reaches beyond the window, for a browser to say."""
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


def assert_self_contained(text: str) -> None:
    """Nothing from outside, and no script but one that the page's policy names and that asks for nothing."""
    checker = checked(text)
    assert checker.all("link", "iframe", "object", "embed", "base", "form") == []
    for tag, attributes in checker.elements:
        for name, value in attributes.items():
            assert not name.startswith("on"), f"{tag} has {name}"
            if name in ("src", "srcset", "href", "data", "action", "poster"):
                assert value.startswith(EMBEDDED), f"{tag} has {name}={value[:60]}"
    assert "@import" not in text
    assert "url(" not in text
    (policy,) = [item["content"] for item in checker.all("meta") if item.get("http-equiv") == "Content-Security-Policy"]
    expected = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
    for script in re.findall(r"<script>(.*?)</script>", text, flags=re.DOTALL):
        assert not re.search(r"fetch|XMLHttpRequest|WebSocket|import\(|eval\(|innerHTML|http", script)
        expected += f"; script-src 'sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}'"
    assert text.count("<script") == text.count("<script>") == expected.count("script-src")
    assert policy == expected


def assert_well_formed(text: str) -> None:
    """One first heading, no level left out, every name once, and every reference to a name that is there."""
    checker = checked(text)
    levels = [int(tag[1]) for tag, _ in checker.elements if re.fullmatch("h[1-6]", tag)]
    assert levels.count(1) == 1
    assert levels[0] == 1
    assert all(deeper - level <= 1 for level, deeper in pairwise(levels))
    identifiers = [attributes["id"] for _, attributes in checker.elements if "id" in attributes]
    assert len(identifiers) == len(set(identifiers))
    for _, attributes in checker.elements:
        assert attributes.get("aria-labelledby", identifiers[0]) in identifiers
        if attributes.get("href", "").startswith("#"):
            assert attributes["href"][1:] in identifiers
    assert checker.all("html")[0]["lang"] == "en"
    assert len(checker.all("main")) == 1
