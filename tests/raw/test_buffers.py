"""Buffers without a header, against a decoder that goes through MIPI CSI-2's bits one by one."""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from eldata.errors import ArgumentError, RawFileError
from eldata.raw import bayer_cfa, read_buffer, read_raw, write_dng
from eldata.records import Exposure
from tests.raw.helpers import BAYER, NONA, QUAD, XTRANS, random_mosaic

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from numpy.typing import NDArray

    from eldata.raw.buffers import Packing

FEW = settings(deadline=None, max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
KNOWN: dict[str, Any] = {"cfa": BAYER["RGGB"], "black": 64, "white": 1023}


def sent_10(pixels: list[int]) -> bytes:
    """RAW10 (MIPI CSI-2, 11.4.4): P1[9:2], P2[9:2], P3[9:2], P4[9:2], then P4[1:0] P3[1:0] P2[1:0] P1[1:0]."""
    content = b""
    for at in range(0, len(pixels), 4):
        p1, p2, p3, p4 = (f"{pixel:010b}" for pixel in pixels[at : at + 4])
        for bits in (p1[:8], p2[:8], p3[:8], p4[:8], p4[8:] + p3[8:] + p2[8:] + p1[8:]):
            content += bytes([int(bits, 2)])
    return content


def sent_12(pixels: list[int]) -> bytes:
    """RAW12 (MIPI CSI-2, 11.4.5): P1[11:4], P2[11:4], then P2[3:0] P1[3:0]."""
    content = b""
    for at in range(0, len(pixels), 2):
        p1, p2 = (f"{pixel:012b}" for pixel in pixels[at : at + 2])
        for bits in (p1[:8], p2[:8], p2[8:] + p1[8:]):
            content += bytes([int(bits, 2)])
    return content


def sent_16(pixels: list[int]) -> bytes:
    return b"".join(bytes([pixel % 256, pixel // 256]) for pixel in pixels)


SENT: dict[tuple[Packing, int], Callable[[list[int]], bytes]] = {
    ("mipi", 10): sent_10,
    ("mipi", 12): sent_12,
    **{("le16", bits): sent_16 for bits in (10, 12, 14, 16)},
}
FORMS = st.sampled_from(list(SENT))


def content_of(mosaic: NDArray[Any], packing: Packing, bits: int, padding: bytes = b"") -> bytes:
    return b"".join(SENT[packing, bits](row) + padding for row in mosaic.tolist())


def written(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path


@given(
    form=FORMS,
    rows=st.integers(1, 4),
    groups=st.integers(1, 9),
    cfa=st.sampled_from([BAYER["GBRG"], QUAD["quad-00"], QUAD["quad-23"], NONA["nona-00"], XTRANS["xtrans-00"]]),
    padding=st.integers(0, 7),
    whole=st.booleans(),
    seed=st.integers(0, 2**32 - 1),
)
@FEW
def test_every_pixel_is_the_one_that_was_sent(
    form: tuple[Packing, int], rows: int, groups: int, cfa: Any, padding: int, whole: bool, seed: int, tmp_path: Path
) -> None:
    packing, bits = form
    generator = np.random.default_rng(seed)
    mosaic = generator.integers(0, 2**bits, (8 * rows + 1, 4 * (groups + 1)), dtype=np.uint16)
    content = content_of(mosaic, packing, bits, generator.bytes(padding))
    if not whole:  # drivers leave the last row's padding out
        content = content[: len(content) - padding]
    path = written(tmp_path / "a.raw", content)
    stride = len(content_of(mosaic[:1], packing, bits)) + padding
    frame = read_buffer(
        path, mosaic.shape, bits=bits, packing=packing, cfa=cfa, black=0, white=2**bits - 1,
        stride=stride if padding or whole else None,
    )  # fmt: skip
    assert frame.path == path
    np.testing.assert_array_equal(frame.mosaic, mosaic, strict=True)
    assert frame.mosaic.flags.c_contiguous
    assert frame.mosaic.flags.writeable
    assert frame.sensor.cfa == cfa
    assert (frame.sensor.height, frame.sensor.width) == mosaic.shape


def test_the_bytes_of_the_standards_own_figure(tmp_path: Path) -> None:
    """Pixels that set one bit each: where it lands is written out by hand."""
    cases: list[tuple[int, list[int], str]] = [
        (10, [512, 0, 0, 0], "80 00 00 00 00"),
        (10, [1, 0, 0, 0], "00 00 00 00 01"),
        (10, [0, 2, 0, 0], "00 00 00 00 08"),
        (10, [0, 0, 0, 3], "00 00 00 00 c0"),
        (10, [4, 8, 16, 1023], "01 02 04 ff c0"),
        (12, [1, 0, 0, 2048], "00 00 01 00 80 00"),
        (12, [0, 1, 4095, 0], "00 00 10 ff 00 0f"),
    ]
    for bits, pixels, text in cases:
        path = written(tmp_path / "a.raw", bytes.fromhex(text) * 2)
        frame = read_buffer(path, (2, 4), bits=bits, cfa=BAYER["RGGB"], black=0, white=2**bits - 1)
        assert frame.mosaic.tolist() == [pixels, pixels]


def test_what_is_said_of_the_frame_is_in_its_records_and_in_its_dng(tmp_path: Path) -> None:
    mosaic = random_mosaic(36, 44, low=60, high=1000)
    path = written(tmp_path / "a.raw", content_of(mosaic, "mipi", 10))
    cfa = bayer_cfa("GRBG", block=2)
    frame = read_buffer(
        str(path), (36, 44), cfa=cfa, black=(64, 63.5, 64.25, 64), white=1000, iso=800, exposure_s=0.1
    )  # fmt: skip
    assert frame.sensor.black_level_dn == (64.0, 63.5, 64.25, 64.0)
    assert frame.sensor.white_level_dn == 1000.0
    assert frame.exposure == Exposure(Fraction(800), Fraction(1, 10))  # not the float's 55 digits
    write_dng(tmp_path / "a.dng", frame.mosaic, frame.sensor, frame.exposure)
    again = read_raw(tmp_path / "a.dng")
    np.testing.assert_array_equal(again.mosaic, mosaic)
    assert (again.sensor, again.exposure) == (frame.sensor, frame.exposure)


def test_one_black_level_counts_for_every_channel_and_nothing_else_is_made_up(tmp_path: Path) -> None:
    path = written(tmp_path / "a.raw", content_of(random_mosaic(12, 12, low=60, high=1000), "le16", 10))
    for cfa, count in ((BAYER["RGGB"], 4), (NONA["nona-00"], 4), (XTRANS["xtrans-00"], 3)):
        frame = read_buffer(path, (12, 12), packing="le16", cfa=cfa, black=64, white=1023)
        assert frame.sensor.black_level_dn == (64.0,) * count
        sensor, exposure = frame.sensor, frame.exposure
        assert (sensor.make, sensor.model, sensor.white_balance, sensor.xyz_to_camera) == ("", "", None, None)
        assert (exposure.iso, exposure.exposure_s, exposure.f_number) == (None, None, None)


# --- what is refused --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("size", "options", "words"),
    [
        (599, {}, r"expected 600 bytes for 20 x 24 pixels of 10 bits \(mipi\) in 20 rows of 30 bytes; found 599 byt"),
        (601, {}, r"found 601 bytes; is it whole, and are shape, bits and packing right\?"),
        (640, {}, r"found 640 bytes; its rows may be padded: then give stride=32"),
        (600, {"stride": 32}, r"expected 640 bytes, or 638 without the last padding, .* 20 rows 32 bytes apart; found"),
        (639, {"stride": 32}, r"found 639 bytes; is it whole, and"),
        (600, {"bits": 12}, r"expected 720 bytes .* 20 rows of 36 bytes; found 600 bytes; is it whole\?"),
        (600, {"packing": "le16"}, r"expected 960 bytes .*\(le16\) in 20 rows of 48 bytes; found 600"),
        (0, {}, "found 0 bytes; is it whole"),
    ],
)  # fmt: skip
def test_another_size(size: int, options: dict[str, Any], words: str, tmp_path: Path) -> None:
    path = written(tmp_path / "a.raw", bytes(range(64, 128)) * 15)
    path.write_bytes(path.read_bytes()[:size])
    with pytest.raises(RawFileError, match=rf"a\.raw: .*{words}"):
        read_buffer(path, (20, 24), **KNOWN | options)


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(RawFileError, match=r"none\.raw: cannot be read: No such file"):
        read_buffer(tmp_path / "none.raw", (20, 24), **KNOWN)
    with pytest.raises(RawFileError, match=r"cannot be read|expected 600 bytes"):
        read_buffer(tmp_path, (20, 24), **KNOWN)


def test_a_size_that_no_memory_holds_is_a_matter_of_the_files_size(tmp_path: Path) -> None:
    path = written(tmp_path / "a.raw", bytes(600))
    with pytest.raises(RawFileError, match="found 600 bytes"):
        read_buffer(path, (10**9, 4 * 10**9), **KNOWN)


@pytest.mark.parametrize("values", ["upper bits", "upper byte first"])
def test_values_beyond_the_bits(values: str, tmp_path: Path) -> None:
    mosaic = random_mosaic(12, 12, low=64, high=1000)
    wrong = mosaic << 6 if values == "upper bits" else mosaic.byteswap()
    path = written(tmp_path / "a.raw", wrong.astype("<u2").tobytes())
    with pytest.raises(RawFileError, match=rf"holds {wrong.max()} DN, and 10 bits hold at most 1023: give the bits"):
        read_buffer(path, (12, 12), packing="le16", **KNOWN)


def test_a_hole_is_named_as_in_any_raw(tmp_path: Path) -> None:
    mosaic = random_mosaic(64, 64, low=64, high=1000)
    content = bytearray(content_of(mosaic, "mipi", 10))
    content[1000:2000] = bytes(1000)
    path = written(tmp_path / "a.raw", bytes(content))
    with pytest.raises(RawFileError, match=r"damaged, or its shape.* pixels in a row, .*are 0 DN, below the black le"):
        read_buffer(path, (64, 64), **KNOWN)
    assert read_buffer(path, (64, 64), **KNOWN | {"black": 0}).mosaic.shape == (64, 64)  # there it is darkness


@pytest.mark.parametrize(
    ("shape", "options", "words"),
    [
        ((20,), {}, r"shape must be \(H, W\), two whole numbers above 0; found \(20,\)"),
        ((20, 0), {}, r"found \(20, 0\)"),
        ((20.0, 24), {}, r"found \(20\.0, 24\)"),
        ((20, 26), {}, "groups of 4 pixels, and 26 is not a multiple of 4: give the width with its padding"),
        ((20, 25), {"bits": 12}, "rows of 12 bits hold whole groups of 2 pixels, and 25 is not"),
        ((20, 24), {"bits": 14}, r"bits must be one of 10, 12; found 14"),
        ((20, 24), {"bits": 8, "packing": "le16"}, "bits must be one of 10, 12, 14, 16; found 8"),
        ((20, 24), {"packing": "be16"}, "packing must be one of 'mipi', 'le16'; found 'be16'"),
        ((20, 24), {"cfa": ((0, 1), (1, 2))}, "unsupported CFA"),
        ((1, 24), {}, "does not hold one whole 2 x 2 period"),
        ((20, 24), {"black": (64, 64)}, "black must be one level, or 4 for this CFA; found"),
        ((20, 24), {"black": -1}, "black must be of numbers from 0 on, in DN; found -1"),
        ((20, 24), {"black": "64"}, "black must be of numbers from 0 on, in DN; found '64'"),
        ((20, 24), {"white": 64}, r"white must lie above the black level \(64 DN\) and be at most 1023.*found 64"),
        ((20, 24), {"white": 1024}, "at most 1023, the most that 10 bits hold; found 1024"),
        ((20, 24), {"white": float("nan")}, "found nan"),
        ((20, 24), {"iso": 0}, "iso must be a number above 0, or None if it is not known; found 0"),
        ((20, 24), {"exposure_s": "1/30"}, "exposure_s must be a number above 0, or None .*found '1/30'"),
        ((20, 24), {"exposure_s": float("inf")}, "exposure_s must be a number above 0.*found inf"),
        ((20, 24), {"stride": 29}, r"stride must be a whole number of at least 30 bytes, a row of 24 pixels.*found 29"),
    ],
)
def test_arguments(shape: Any, options: dict[str, Any], words: str, tmp_path: Path) -> None:
    path = written(tmp_path / "a.raw", bytes(600))
    with pytest.raises(ArgumentError, match=words):
        read_buffer(path, shape, **KNOWN | options)
