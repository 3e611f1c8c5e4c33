"""Damaged PNG files are refused: each part of one has a checksum."""

from __future__ import annotations

from typing import TYPE_CHECKING

import imagecodecs
import numpy as np
import pytest

from eldata.base.arrays import read_rgb16
from eldata.errors import FileError
from tests.cases import in_one_test
from tests.raw.damaging import HARMS, Whole

if TYPE_CHECKING:
    from pathlib import Path


@in_one_test("harm", HARMS)
def test_damaged_files_are_refused(harm: str, tmp_path: Path) -> None:
    """20 trials each; a smooth picture compresses well, noise does not."""
    generator = np.random.default_rng(0)
    y, x = np.mgrid[:120, :160]
    smooth = np.stack([300 * x + 40 * y, 90 * x + 20 * y, 30000 + 0 * x], axis=-1)
    for pixels in (smooth.astype(np.uint16), generator.integers(0, 1 << 16, smooth.shape, dtype=np.uint16)):
        path, content = tmp_path / "a.png", bytes(imagecodecs.png_encode(pixels))
        path.write_bytes(content)
        np.testing.assert_array_equal(read_rgb16(path), pixels)
        whole = Whole(content, 0, len(content), pixels, None)
        for _ in range(20):
            data = bytearray(content)
            HARMS[harm](data, whole, generator)
            if data == content:
                continue
            path.write_bytes(data)
            with pytest.raises(FileError) as caught:
                read_rgb16(path)
            assert caught.value.path == path
