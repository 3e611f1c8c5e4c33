"""What is said of a file that is read rightly: with the frame, with the header, and once by ``verify``."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from eldata.errors import RawFileError
from eldata.raw import read_header, read_raw
from tests.raw.helpers import Tag, opcode_list, random_mosaic, write_plain_dng

if TYPE_CHECKING:
    from pathlib import Path

# --- opcodes ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("order", ["<", ">"])
def test_opcodes_are_named_and_not_applied(order: str, tmp_path: Path) -> None:
    """By their numbers in the DNG specification 1.7.1; a list is big-endian in any file."""
    lists = opcode_list(1, 4, 5), opcode_list(2, 9, 9, 9, 9, 10), opcode_list(3, 1, 3, 14, 77, 2**32 - 1, 0)
    path, mosaic = tmp_path / "a.dng", random_mosaic(64, 64)
    write_plain_dng(path, mosaic, ("RG", "GB"), *lists, byteorder=order)
    found = read_raw(path)
    assert found.remarks == read_header(path).remarks
    assert [remark.partition(": ")[0] for remark in found.remarks] == [
        "its OpcodeList1 (FixBadPixelsConstant, FixBadPixelsList) is not applied",
        "its OpcodeList2 (GainMap, DeltaPerRow) is not applied",
        "its OpcodeList3 (WarpRectilinear, FixVignetteRadial, WarpRectilinear2, unknown) is not applied",
    ]
    assert found.remarks[0] in repr(found)
    np.testing.assert_array_equal(found.mosaic, mosaic)


def test_a_file_without_opcodes_is_not_remarked_on(tmp_path: Path) -> None:
    empty = (opcode_list(2), (51022, "B", 4, b"\0\0\0\0", True))
    for tags in ((), empty):
        write_plain_dng(tmp_path / "a.dng", random_mosaic(64, 64), ("RG", "GB"), *tags)
        assert read_raw(tmp_path / "a.dng").remarks == ()


@pytest.mark.parametrize("damaged", [opcode_list(2, 9, declared=2), opcode_list(2, 9, declared=2**32 - 1)])
def test_opcodes_beyond_their_list_are_refused(damaged: Tag, tmp_path: Path) -> None:
    write_plain_dng(tmp_path / "a.dng", random_mosaic(64, 64), ("RG", "GB"), damaged)
    with pytest.raises(RawFileError, match=r"a\.dng: damaged: its list of opcodes .* 40 bytes"):
        read_raw(tmp_path / "a.dng")


# --- verify -------------------------------------------------------------------------------------------------------
