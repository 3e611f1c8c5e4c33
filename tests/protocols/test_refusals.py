"""Protocols that cannot be, and those found by a digest; the rest of protocols is tested with evaluation."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from eldata.errors import ArgumentError
from eldata.protocols import PROTOCOLS
from eldata.protocols.named import of_digest
from eldata.protocols.words import in_words
from tests.cases import in_one_test


@in_one_test(
    "base, changes, words",
    [
        ("eld", {"ratios": (100, 0)}, r"ratios must be positive; found \[100, 0\]"),
        ("eld", {"ratios": (-1,)}, "ratios must be positive"),
        ("eld-srgb", {"mse_offset": 1e-8}, "rendering 'eld-isp' is scored with mse_offset 0"),
        ("eld-srgb", {"rounding": "8-bit"}, "rounding must be '8-bit-truncated', not '8-bit'"),
    ],
)
def test_what_does_not_go_together_is_refused(base: str, changes: dict[str, Any], words: str) -> None:
    with pytest.raises(ArgumentError, match=words):
        replace(PROTOCOLS[base], **changes).check()


def test_a_digest_names_its_protocol() -> None:
    for protocol in PROTOCOLS.values():
        assert of_digest(protocol.digest[:20]) == (protocol,)
    with pytest.raises(ArgumentError, match="no shipped protocol has the digest sha256:0123"):
        of_digest("sha256:0123")
    assert in_words("levels", "of-a-later-version") == "of-a-later-version"
