"""Black levels of DNGs by truth known by construction: what was laid under the pixels comes back for their level.

The files in ``field/`` are small ones that readers get wrong.
"""

from __future__ import annotations

import struct
from fractions import Fraction
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
import tifffile

from eldata import evaluate
from eldata.cli.main import main
from eldata.errors import RawFileError, UnusableRawError
from eldata.raw import read_header, read_raw, write_dng
from eldata.raw.black_levels import VisibleArea, dng_black_level
from eldata.raw.sensor_facts import dng_noise_profile
from eldata.raw.tiff import ACTIVE_AREA, BLACK_DELTAS, Directory
from eldata.records import exact_fraction
from tests.raw.helpers import (
    BAYER,
    NONA,
    QUAD,
    Cfa,
    Tag,
    active_area,
    add_tags,
    black_levels,
    letters,
    opcode_list,
    random_mosaic,
    write_plain_dng,
    xtrans_at,
)
from tests.trees import copy_tree, tree_in

if TYPE_CHECKING:
    from collections.abc import Sequence

    from eldata.records import RawFrame

FIELD = Path(__file__).parent / "field"
MARGINS = [(0, 0), (1, 0), (2, 3)]


def field(name: str) -> RawFrame:
    return read_raw(FIELD / f"{name}.dng")


def level_map(frame: RawFrame) -> np.ndarray:
    """Black level of each pixel, (H, W)."""
    height, width = frame.mosaic.shape
    sites = np.tile(frame.sensor.cfa_pattern, (height, width))[:height, :width]
    return np.array(frame.sensor.black_level_dn)[sites]


def deltas(axis: str, values: Sequence[Fraction | int]) -> Tag:
    parts = tuple(part for value in values for part in Fraction(value).as_integer_ratio())
    return 50715 if axis == "H" else 50716, "2i", len(values), parts, True


def masked(*areas: tuple[int, int, int, int]) -> Tag:
    return 50830, "I", 4 * len(areas), tuple(number for area in areas for number in area), True


# --- the field's files --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "black"),
    [
        ("black-deltaH-columns", (64, 80, 80, 64)),
        ("black-deltaH-frac", (64.25,) * 4),
        ("black-repeatdim-count1", (64,) * 4),
        ("two-cfa-images-proxy-first", (64,) * 4),
        ("dual-pixel-2-samples", (64,) * 4),
        ("masked-areas-black-0", (0,) * 4),
    ],
)
def test_a_field_file_has_its_level_and_comes_back(name: str, black: tuple[float, ...], tmp_path: Path) -> None:
    found = field(name)
    assert found.mosaic.dtype == np.uint16
    assert found.sensor.black_level_dn == black
    assert found.sensor.white_level_dn == 1023
    write_dng(tmp_path / "a.dng", found.mosaic, found.sensor, found.exposure)
    again = read_raw(tmp_path / "a.dng")
    assert again.sensor == found.sensor
    assert list(map(exact_fraction, again.sensor.black_level_dn)) == list(map(Fraction, black))
    np.testing.assert_array_equal(again.mosaic, found.mosaic)


def test_a_slope_of_black_down_the_frame_is_taken_off_row_by_row(tmp_path: Path) -> None:
    found, stored = field("black-deltaV-slope"), tifffile.imread(FIELD / "black-deltaV-slope.dng")
    black = 250 + 12 * np.arange(128)[:, None] / 127
    np.testing.assert_allclose(found.mosaic - level_map(found), stored - black, atol=0.001)
    assert found.sensor.black_level_dn == pytest.approx((255.953, 255.953, 256.047, 256.047), abs=0.001)
    (remark,) = found.remarks
    assert "BlackLevelDeltaV (250 to 262 DN)" in remark
    write_dng(tmp_path / "a.dng", found.mosaic, found.sensor, found.exposure)
    again = read_raw(tmp_path / "a.dng")
    assert again.sensor == found.sensor
    np.testing.assert_array_equal(again.mosaic, found.mosaic)


def test_masked_pixels_are_remarked_on_where_the_file_says_otherwise() -> None:
    (remark,) = field("masked-areas-black-0").remarks
    assert "have a mean of 64.1 DN, but its BlackLevel says 0.0 DN" in remark


# --- counts -------------------------------------------------------------------------------------------------------


REPEAT, BLACK, SAMPLES = 50713, 50714, 277


@pytest.mark.parametrize(
    ("tags", "words"),
    [
        ([(REPEAT, "H", 2, (2, 2), True), (BLACK, "I", 2, (1, 2), True)], "has 2 numbers, expected 4, as .* is 2 x 2:"),
        ([(REPEAT, "H", 1, 2, True), (BLACK, "I", 4, (1, 2, 3, 4), True)], "has 4 numbers, expected 1, as .* is 2:"),
        ([(REPEAT, "H", 2, (1, 2), True), (BLACK, "I", 1, 64, True)], "has 1 number, expected 2, as .* is 1 x 2:"),
        ([deltas("H", [1] * 65)], "its BlackLevelDeltaH has 65 numbers, expected 66, the size of its active area"),
        ([deltas("V", [1] * 64), active_area(0, 0, 60, 66)], "DeltaV has 64 numbers, expected 60, the size"),
    ],
)
def test_counts_that_do_not_fit(tags: list[Tag], words: str, tmp_path: Path) -> None:
    write_plain_dng(tmp_path / "a.dng", random_mosaic(64, 66), ("RG", "GB"), *tags)
    for read in (read_raw, read_header):
        with pytest.raises(UnusableRawError, match=rf"a\.dng: .*{words}.*; write it again"):
            read(tmp_path / "a.dng")


def test_one_level_is_that_of_both_samples(tmp_path: Path) -> None:
    (tmp_path / "a.dng").write_bytes((FIELD / "dual-pixel-2-samples.dng").read_bytes())
    add_tags(tmp_path / "a.dng", (BLACK, "I", 1, 65, True))
    assert read_raw(tmp_path / "a.dng").sensor.black_level_dn == (65,) * 4


@pytest.mark.parametrize("samples", [0, -1])
def test_no_samples_are_damage(samples: int, tmp_path: Path) -> None:
    (tmp_path / "a.dng").write_bytes((FIELD / "dual-pixel-2-samples.dng").read_bytes())
    add_tags(tmp_path / "a.dng", (SAMPLES, "i", 1, samples, True))
    with pytest.raises(RawFileError, match=rf"a\.dng: damaged: it declares {samples} samples of each pixel"):
        read_raw(tmp_path / "a.dng")


@pytest.mark.parametrize("kind", ["f", "d"])
def test_a_level_written_as_a_float_is_exact(kind: str, tmp_path: Path) -> None:
    """LibRaw has 511 of it."""
    tags: list[Tag] = [(REPEAT, "H", 2, (1, 2), True), (BLACK, kind, 2, (511.625, 512.0), True)]
    write_plain_dng(tmp_path / "a.dng", random_mosaic(64, 66), ("RG", "GB"), *tags)
    assert read_raw(tmp_path / "a.dng").sensor.black_level_dn == (511.625, 512, 512, 511.625)
    tags[1] = (BLACK, kind, 2, (float("nan"), 512.0), True)
    write_plain_dng(tmp_path / "a.dng", random_mosaic(64, 66), ("RG", "GB"), *tags)
    with pytest.raises(RawFileError, match="its BlackLevel is not a number"):
        read_raw(tmp_path / "a.dng")


@pytest.mark.parametrize("tag", [BLACK, 50715, 50716])
def test_a_level_of_no_numbers_is_none(tag: int, tmp_path: Path) -> None:
    write_plain_dng(tmp_path / "a.dng", random_mosaic(64, 66))
    add_tags(tmp_path / "a.dng", (tag, "I", 0, (), True))
    assert read_raw(tmp_path / "a.dng").sensor.black_level_dn == (0,) * 4


# --- deltas -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", BAYER)
@pytest.mark.parametrize("margins", MARGINS)
def test_deltas_with_the_period_of_the_cfa_are_levels_of_channels(
    name: str, margins: tuple[int, int], tmp_path: Path
) -> None:
    """They count from the active area's corner, as the CFA does: a level that each site of a colour has."""
    top, left = margins
    height, width = 64 - top, 66 - left
    across, down = (Fraction(1, 3), 16), (Fraction(-5, 2), Fraction(4, 7))
    tags = [
        active_area(top, left, 64, 66),
        *black_levels([[60, 61], [63, 62]]),
        deltas("H", [across[x % 2] for x in range(width)]),
        deltas("V", [down[y % 2] for y in range(height)]),
    ]
    mosaic = random_mosaic(64, 66)
    write_plain_dng(tmp_path / "a.dng", mosaic, letters(BAYER[name]), *tags)
    found = read_raw(tmp_path / "a.dng")
    base = ((60, 61), (63, 62))
    expected = {BAYER[name][y][x]: base[y][x] + across[x] + down[y] for y, x in product(range(2), repeat=2)}
    assert [exact_fraction(level) for level in found.sensor.black_level_dn] == [expected[k] for k in range(4)]
    assert found.mosaic.dtype == np.uint16
    assert found.remarks == ()
    write_dng(tmp_path / "b.dng", found.mosaic, found.sensor, found.exposure)
    assert read_raw(tmp_path / "b.dng").sensor == found.sensor


@pytest.mark.parametrize("name", ["quad-00", "quad-13", "nona-00", "xtrans-00"])
def test_one_delta_for_all_is_added_to_any_cfa(name: str, tmp_path: Path) -> None:
    cfa: Cfa = {**QUAD, **NONA, "xtrans-00": xtrans_at(0, 0)}[name]
    tags: list[Tag] = [(BLACK, "I", 1, 64, True), deltas("V", [Fraction(1, 4)] * 72)]
    write_plain_dng(tmp_path / "a.dng", random_mosaic(72, 72), letters(cfa), *tags)
    found = read_raw(tmp_path / "a.dng")
    assert set(found.sensor.black_level_dn) == {64.25}
    assert found.mosaic.dtype == np.uint16


@pytest.mark.parametrize("name", ["RGGB", "GBRG", "quad-13", "nona-00", "xtrans-00"])
@pytest.mark.parametrize("margins", MARGINS)
def test_what_rows_and_columns_have_of_their_own_is_taken_off(
    name: str, margins: tuple[int, int], tmp_path: Path
) -> None:
    """Signal + black of each row and column, in whole DN: what is read less its levels is the signal, to float32."""
    cfa: Cfa = {**BAYER, **QUAD, **NONA, "xtrans-00": xtrans_at(0, 0)}[name]
    top, left = margins
    generator = np.random.default_rng(3)
    across, down = generator.integers(-9, 9, 72 - left), generator.integers(0, 30, 72 - top)
    signal = random_mosaic(72, 72, low=100)
    black = np.zeros((72, 72), np.int64)
    black[top:, left:] = 64 + across + down[:, None]
    tags = [
        active_area(top, left, 72, 72),
        (BLACK, "I", 1, 64, True),
        deltas("H", across.tolist()),
        deltas("V", down.tolist()),
    ]
    write_plain_dng(tmp_path / "a.dng", (signal + black).astype(np.uint16), letters(cfa), *tags)
    found = read_raw(tmp_path / "a.dng")
    assert found.mosaic.dtype == np.float32
    height, width = found.mosaic.shape  # LibRaw's visible area ends where the active one does
    np.testing.assert_allclose(found.mosaic - level_map(found), signal[72 - height :, 72 - width :], atol=0.002)
    (remark,) = found.remarks
    assert f"BlackLevelDeltaH ({across.min()} to {across.max()} DN) and BlackLevelDeltaV" in remark
    # Each channel's level is the mean of what was laid under it, but that those of a few columns count alike here.
    sites = np.tile(found.sensor.cfa_pattern, (height, width))[:height, :width]
    laid = [black[72 - height :, 72 - width :][sites == channel].mean() for channel in range(sites.max() + 1)]
    np.testing.assert_allclose(found.sensor.black_level_dn, laid, atol=0.5)


@pytest.mark.parametrize("first", [(0, 3), (5, 0), (0, 0)])
def test_pixels_beyond_the_active_area_have_no_deltas(first: tuple[int, int]) -> None:
    """LibRaw shows none; a decoder that did would be told."""
    values = {ACTIVE_AREA: (2, 4, 62, 64), BLACK_DELTAS[0]: range(60), BLACK_DELTAS[1]: range(60)}
    main = Directory({tag: tuple(map(Fraction, numbers)) for tag, numbers in values.items()})
    area = VisibleArea(*first, (64, 64), BAYER["RGGB"])
    with pytest.raises(RawFileError, match=r"a\.dng: damaged: its visible area, 64 x 64 pixels, is not all in"):
        dng_black_level(Path("a.dng"), main, area, np.zeros((64, 64), np.uint16))


# --- which image --------------------------------------------------------------------------------------------------


def test_levels_are_those_of_the_image_that_is_read(tmp_path: Path) -> None:
    """A proxy stands first, with everything else: a black of 256, another phase, masked areas, deltas and noise."""
    path = tmp_path / "a.dng"
    path.write_bytes((FIELD / "two-cfa-images-proxy-first.dng").read_bytes())
    profile = struct.pack("<2d", 1.0, 2.0)
    add_tags(
        path,
        (33422, "B", 4, bytes((2, 1, 1, 0)), True),
        (50717, "I", 1, 4095, True),
        masked((0, 0, 8, 8)),
        deltas("H", [40] * 96),
        active_area(1, 0, 64, 96),
        opcode_list(2, 9),
        (51041, "B", len(profile), profile, True),
    )
    found, plain = read_raw(path), field("two-cfa-images-proxy-first")
    assert found.sensor == plain.sensor
    assert (found.sensor.black_level_dn, found.sensor.white_level_dn) == ((64.0,) * 4, 1023.0)
    assert found.remarks == ()
    np.testing.assert_array_equal(found.mosaic, plain.mosaic)


@pytest.mark.parametrize("beside", [False, True])
def test_the_noise_profile_is_that_of_the_image_or_of_the_file(beside: bool, tmp_path: Path) -> None:
    """Of a proxy that has one too, the image's counts; IFD0 may state it for the whole file."""
    path, images = tmp_path / "a.dng", ((64, 96), (128, 192))
    with tifffile.TiffWriter(path) as writer:
        for number, shape in enumerate(images):
            tags: list[Tag] = [(33421, "H", 2, (2, 2), True), (33422, "B", 4, bytes((0, 1, 1, 2)), True)]
            if number == 0 or beside:
                tags.append((51041, "d", 2, (1.0 + number, 0.5), True))
            writer.write(random_mosaic(*shape), photometric=32803, metadata=None, extratags=tags, subifds=1 - number)
    assert dng_noise_profile(path) == ((2.0, 0.5) if beside else (1.0, 0.5))


# --- masked pixels ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["RGGB", "GBRG", "xtrans-00", "quad-13"])
@pytest.mark.parametrize("margins", [(8, 12), (7, 13)])
def test_masked_pixels_are_the_level_where_none_is_stated(name: str, margins: tuple[int, int], tmp_path: Path) -> None:
    """The mean of each channel's, exactly; what lies in the margin beside them does not count."""
    cfa: Cfa = {**BAYER, **QUAD, "xtrans-00": xtrans_at(0, 0)}[name]
    top, left = margins
    mosaic, generator = random_mosaic(80, 96), np.random.default_rng(5)
    areas = ((0, 2, 6, 90), (10, 1, 80, 10))
    for first, start, bottom, right in areas:
        mosaic[first:bottom, start:right] = generator.integers(60, 70, (bottom - first, right - start))
    write_plain_dng(tmp_path / "a.dng", mosaic, letters(cfa), active_area(top, left, 80, 96), masked(*areas))
    found = read_raw(tmp_path / "a.dng")
    # The CFA begins at the active area's corner.
    rows, columns = np.arange(80) - top, np.arange(96) - left
    sites = np.array(cfa)[(rows % len(cfa))[:, None], columns % len(cfa)]
    is_masked = np.zeros((80, 96), bool)
    for first, start, bottom, right in areas:
        is_masked[first:bottom, start:right] = True
    expected = [mosaic[is_masked & (sites == channel)] for channel in range(sites.max() + 1)]
    means = [Fraction(int(values.sum()), values.size) for values in expected]
    assert [exact_fraction(level) for level in found.sensor.black_level_dn] == means
    (remark,) = found.remarks
    assert (
        remark
        == f"it states no BlackLevel: the mean of its masked pixels is taken, {float(sum(means) / len(means)):.1f} DN"
    )
    write_dng(tmp_path / "b.dng", found.mosaic, found.sensor, found.exposure)
    assert read_raw(tmp_path / "b.dng").sensor == found.sensor


def test_masked_pixels_of_one_colour_count_for_all(tmp_path: Path) -> None:
    """A column of R and G2 alone."""
    mosaic = random_mosaic(64, 66)
    mosaic[:, 0] = 60
    mosaic[1::2, 0] = 63
    write_plain_dng(tmp_path / "a.dng", mosaic, ("RG", "GB"), active_area(0, 2, 64, 66), masked((0, 0, 64, 1)))
    assert read_raw(tmp_path / "a.dng").sensor.black_level_dn == (60, 61.5, 61.5, 63)


@pytest.mark.parametrize(("stated", "remarks"), [(64, 0), (63, 1), (0, 1)])
def test_a_stated_level_that_the_masked_pixels_bear_out_is_not_remarked_on(
    stated: int, remarks: int, tmp_path: Path
) -> None:
    mosaic = random_mosaic(64, 66)
    mosaic[:, :2] = 64
    tags = active_area(0, 2, 64, 66), masked((0, 0, 64, 2)), (BLACK, "I", 1, stated, True)
    write_plain_dng(tmp_path / "a.dng", mosaic, ("RG", "GB"), *tags)
    found = read_raw(tmp_path / "a.dng")
    assert found.sensor.black_level_dn == (stated,) * 4
    assert len(found.remarks) == remarks


# --- a set of such files ------------------------------------------------------------------------------------------


def restate(path: Path, kind: str) -> None:
    """State the same levels, or levels of other pixels of the same signal, in another way."""
    frame = read_raw(path)
    height = len(frame.mosaic)
    black = int(frame.sensor.black_level_dn[0])
    assert set(frame.sensor.black_level_dn) == {black}
    one_level: list[Tag] = [(REPEAT, "H", 2, (1, 1), True), (BLACK, "I", 1, black, True)]
    # Of rows in pairs, so that each channel's mean is 0.
    slope = np.repeat(np.arange(height // 2) * 2 - height // 2 + 1, 2)
    if kind == "one number":
        add_tags(path, (REPEAT, "H", 1, 1, True), one_level[1])
    elif kind == "no pattern":
        add_tags(path, one_level[0], (BLACK, "I", 4, (black,) * 4, True))
    else:
        write_dng(path, (frame.mosaic + slope[:, None]).astype(np.uint16), frame.sensor, frame.exposure)
        add_tags(path, *one_level, deltas("V", slope.tolist()))


@pytest.mark.parametrize("kind", ["one number", "a slope"])
def test_a_set_whose_levels_are_stated_otherwise_scores_the_same(
    kind: str, demo_tree: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tree = copy_tree(tree_in(demo_tree), tmp_path)
    plain = evaluate(None, manifest=tree.csv, root=tree.root, baseline="input", cameras=["DemoAlpha"])
    for number in range(1, 17):
        restate(tree.file(number), kind)
    found = evaluate(None, manifest=tree.csv, root=tree.root, baseline="input", cameras=["DemoAlpha"])
    assert len(plain.images) == 6
    assert found.images == plain.images
    assert main(["verify", str(tree.csv), "--root", str(tree.root), "--level", "metadata", "--jobs", "1"]) == 0
    said = [line for line in capsys.readouterr().out.splitlines() if ": remark: " in line]
    if kind == "a slope":
        assert len(said) == 1
        assert said[0].startswith("DemoAlpha/scene-1/IMG_0001.dng and 15 others alike: remark: by its BlackLevelDeltaV")
    else:
        assert said == []


def test_verify_names_levels_that_do_not_fit(
    demo_tree: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tree = copy_tree(tree_in(demo_tree), tmp_path)
    restate(tree.file(4), "no pattern")
    assert main(["verify", str(tree.csv), "--root", str(tree.root), "--jobs", "1", "--level", "metadata"]) == 1
    text = capsys.readouterr().out
    assert "DemoAlpha/scene-1/IMG_0004.dng: content" in text
    assert "found     its BlackLevel has 4 numbers, expected 1, as its BlackLevelRepeatDim is 1 x 1" in text
    assert "to do     write it again with a BlackLevelRepeatDim that fits" in text
