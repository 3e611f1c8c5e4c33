"""When a frame was taken: written, read back, and absent where the file does not say."""

from __future__ import annotations

from datetime import datetime
from typing import TYPE_CHECKING

import pytest

from eldata.raw.dng import write_dng
from eldata.raw.reading import read_header
from tests.raw.helpers import EXPOSURE, make_sensor, random_mosaic, write_plain_dng

if TYPE_CHECKING:
    from pathlib import Path

SENSOR = make_sensor()
MOSAIC = random_mosaic(60, 64)


@pytest.mark.parametrize("milliseconds", [0, 7, 120, 999])
def test_round_trip(milliseconds: int, tmp_path: Path) -> None:
    taken = datetime(2026, 12, 31, 23, 59, 58, 1000 * milliseconds)  # noqa: DTZ001 # a camera's clock has no zone
    write_dng(tmp_path / "a.dng", MOSAIC, SENSOR, EXPOSURE, taken=taken)
    header = read_header(tmp_path / "a.dng")
    assert header.taken == taken
    assert header.exposure == EXPOSURE


def test_unknown_if_the_file_does_not_say(tmp_path: Path) -> None:
    write_dng(tmp_path / "a.dng", MOSAIC, SENSOR, EXPOSURE)
    assert read_header(tmp_path / "a.dng").taken is None


@pytest.mark.parametrize("text", ["0000:00:00 00:00:00", "    :  :     :  :  ", "2026-11-21 10:00:00"])
def test_a_clock_that_was_never_set_is_unknown(text: str, tmp_path: Path) -> None:
    write_plain_dng(tmp_path / "a.dng", MOSAIC, ("RG", "GB"), (36867, "s", 0, text, True))
    assert read_header(tmp_path / "a.dng").taken is None
