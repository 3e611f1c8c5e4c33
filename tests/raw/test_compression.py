"""Which TIFF headers say that data was lost."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from eldata.raw.container import lossy_compression
from tests.raw.helpers import Tag, add_tags, random_mosaic, write_plain_dng

if TYPE_CHECKING:
    from pathlib import Path

PIXELS, LINEAR = 64 * 96, (262, "H", 1, 34892, True)


@pytest.mark.parametrize(
    ("compression", "held", "tags", "words"),
    [
        (32767, PIXELS, (), "Sony's lossy compression"),
        (32767, PIXELS * 14 // 8, (), "none"),  # 14 bits a pixel
        (1, PIXELS, (), "none"),  # eight bits
        (34892, PIXELS // 3, (), "a DNG's lossy JPEG"),
        (7, PIXELS // 2 * 3, (), "none"),
        (34892, PIXELS // 3, (LINEAR,), "none"),  # no mosaic: 34892 is LinearRaw too
    ],
)
def test_what_headers_say(compression: int, held: int, tags: tuple[Tag, ...], words: str, tmp_path: Path) -> None:
    path = tmp_path / "a.arw"
    write_plain_dng(path, random_mosaic(64, 96))
    add_tags(path, (259, "H", 1, compression, True), (279, "I", 1, held, True), *tags)
    assert (lossy_compression(path) or "none").startswith(words)
