"""What is said of a file that is read rightly: with the frame, with the header, and once by ``verify``."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np
import pytest

from eldata.cli.main import main
from eldata.errors import RawFileError
from eldata.raw import read_header, read_raw
from tests.raw.helpers import Tag, add_tags, opcode_list, random_mosaic, write_plain_dng
from tests.trees import ALPHA, copy_tree, frame, tree_in

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


@pytest.mark.parametrize("level", ["metadata", "full"])
def test_verify_says_each_remark_once_and_it_is_no_problem(
    level: str, demo_tree: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tree = copy_tree(tree_in(demo_tree), tmp_path)
    for number in (3, 5, 7):
        tags = [opcode_list(2, 9)] + [opcode_list(3, 1)] * (number == 5)
        add_tags(tree.file(number), *tags)
    report = tmp_path / "report.json"
    arguments = ["verify", str(tree.csv), "--root", str(tree.root), "--level", level, "--jobs", "1"]
    assert main([*arguments, "--json", str(report)]) == 0
    said = [line for line in capsys.readouterr().out.splitlines() if ": remark: " in line]
    assert len(said) == 2
    assert said[0].startswith(f"{frame(3)} and 2 others alike: remark: its OpcodeList2 (GainMap) is not applied")
    assert said[1].startswith(f"{frame(5)}: remark: its OpcodeList3 (WarpRectilinear) is not applied")
    (dataset,) = json.loads(report.read_text())["datasets"]
    assert [(one["path"], one["files"]) for one in dataset["remarks"]] == [(f"{ALPHA}/IMG_0003.dng", 3), (frame(5), 1)]
    assert dataset["remarks"][1]["text"].startswith("its OpcodeList3 (WarpRectilinear) is not applied")
