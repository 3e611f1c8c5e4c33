"""Where lossless JPEG streams end, against an encoder of the standard's own words and one of someone else's."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

import imagecodecs
import numpy as np
import pytest

from eldata.raw import lossless_jpeg
from eldata.raw.lossless_jpeg import Stream, find_stream
from tests.cases import in_one_test
from tests.raw.helpers import random_mosaic, write_plain_dng

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

# Symbols in the order of their codes, which all have 5 bits: zero bits mean a difference of 5 bits.
SYMBOLS = (5, 0, 1, 2, 3, 4, *range(6, 17))


def encode(samples: NDArray[np.uint16], *, restart_rows: int = 0, end: bytes = b"\xff\xd9") -> bytes:
    """Encode (H, W, components) with predictor 1 (T.81, annex H), one code for all; restart markers between rows."""
    height, width, components = samples.shape
    head = b"\xff\xd8\xff\xc4" + struct.pack(">HB", 19 + len(SYMBOLS), 0) + bytes([0, 0, 0, 0, 17] + 11 * [0])
    head += bytes(SYMBOLS) + b"\xff\xc3" + struct.pack(">HBHHB", 8 + 3 * components, 16, height, width, components)
    head += b"".join(bytes([index, 0x11, 0]) for index in range(components))
    if restart_rows:
        head += b"\xff\xdd" + struct.pack(">HH", 4, restart_rows * width)
    head += b"\xff\xda" + struct.pack(">HB", 6 + 2 * components, components)
    head += b"".join(bytes([index, 0]) for index in range(components)) + bytes([1, 0, 0])
    body, bits = b"", ""
    for row in range(height):
        fresh = row % restart_rows == 0 if restart_rows else row == 0
        if fresh and row:
            body += stuffed(bits) + bytes([0xFF, 0xD0 + (row // restart_rows - 1) % 8])
            bits = ""
        for column in range(width):
            for component in range(components):
                if column:
                    predicted = int(samples[row, column - 1, component])
                else:
                    predicted = 1 << 15 if fresh else int(samples[row - 1, 0, component])
                bits += code_of((int(samples[row, column, component]) - predicted + (1 << 15)) % (1 << 16) - (1 << 15))
    return head + body + stuffed(bits) + end


def code_of(difference: int) -> str:
    size = abs(difference).bit_length()
    code = format(SYMBOLS.index(size), "05b")
    if size in (0, 16):
        return code
    return code + format(difference if difference > 0 else difference + (1 << size) - 1, f"0{size}b")


def stuffed(bits: str) -> bytes:
    bits += "1" * (-len(bits) % 8)
    return int(bits or "0", 2).to_bytes(len(bits) // 8, "big").replace(b"\xff", b"\xff\x00")


def stream(content: bytes) -> Stream:
    found = find_stream(np.frombuffer(content, np.uint8))
    assert found is not None
    return found


@pytest.fixture(scope="module")
def samples() -> NDArray[np.uint16]:
    return np.random.default_rng(0).integers(0, 1 << 16, (24, 13, 2), dtype=np.uint16)


@in_one_test("components", [1, 2])
@in_one_test("restart_rows", [0, 1, 5])
def test_an_undamaged_stream_ends_with_its_last_pixel(
    samples: NDArray[np.uint16], components: int, restart_rows: int
) -> None:
    content = encode(samples[:, :, :components], restart_rows=restart_rows)
    found = stream(content)
    assert (found.fault(), found.count_fault()) == (None, None)
    assert found.samples == 24 * 13 * components
    assert found.marker == (len(content) - 2, 0xD9)


@in_one_test("restart_rows", [0, 5])
def test_the_encoder_writes_what_libraw_reads(samples: NDArray[np.uint16], restart_rows: int, tmp_path: Path) -> None:
    """So the streams above are ones that occur: two components side by side are two columns."""
    from eldata.raw import read_raw

    content = encode(samples, restart_rows=restart_rows)
    write_plain_dng(tmp_path / "a.dng", iter([content]), shape=(24, 26), dtype=np.uint16, compression=7, white=65535)
    np.testing.assert_array_equal(read_raw(tmp_path / "a.dng").mosaic, samples.reshape(24, 26))


@in_one_test("bits", [8, 12, 14, 16])
@in_one_test("shape", [(24, 22), (61, 37), (200, 300)])
def test_undamaged_streams_of_another_encoder(bits: int, shape: tuple[int, int]) -> None:
    generator = np.random.default_rng(bits)
    for spread in (0.2, 3, 300):
        values = np.clip(generator.normal((1 << bits) / 3, spread, shape), 0, (1 << bits) - 1).astype(np.uint16)
        found = stream(bytes(imagecodecs.ljpeg_encode(values, bitspersample=bits)))
        assert (found.fault(), found.count_fault()) == (None, None)


def test_a_stream_with_too_few_or_too_many_pixels(samples: NDArray[np.uint16]) -> None:
    content = encode(samples)
    at = content.index(b"\xff\xc3") + 5
    for rows, said in ((25, "ends after 624 of 650 pixels"), (23, "bytes behind the last of its 598 pixels")):
        fault = stream(content[:at] + struct.pack(">H", rows) + content[at + 2 :]).count_fault()
        assert fault is not None
        assert said in fault[1]


def test_a_stream_without_its_end(samples: NDArray[np.uint16]) -> None:
    for end, faulty in ((b"", False), (bytes(16), True), (b"\xff" * 16, True)):
        found = stream(encode(samples, end=end))
        assert (found.fault() is not None) is faulty, end
        if b"\xff" not in end:
            assert found.count_fault() is None, "all pixels are there"


def test_a_marker_among_the_codes(samples: NDArray[np.uint16]) -> None:
    content = bytearray(encode(samples))
    content[-200:-198] = b"\xff\x41"
    assert stream(bytes(content)).fault() == (
        len(content) - 200,
        "has a marker 0xFF41, which does not belong into image data",
    )


@pytest.mark.parametrize("piece", [1, 2, 7])
def test_markers_lie_where_they_do_whatever_is_looked_at_together(
    samples: NDArray[np.uint16], piece: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    content = encode(samples, restart_rows=2)
    changed = content[:600] + b"\xff\xff\x41" + content[603:]
    before = [stream(whole).marker for whole in (content, content[:-2], changed)]
    monkeypatch.setattr(lossless_jpeg, "_PIECE", piece)
    assert [stream(whole).marker for whole in (content, content[:-2], changed)] == before
    assert before == [(len(content) - 2, 0xD9), None, (601, 0x41)]


def test_a_restart_marker_that_is_not_there(samples: NDArray[np.uint16]) -> None:
    content = encode(samples, restart_rows=5).replace(b"\xff\xd2", b"\x00\x00")
    fault = stream(content).count_fault()
    assert fault is not None


def test_bits_that_are_no_code(samples: NDArray[np.uint16]) -> None:
    content = bytearray(encode(samples))
    content[-100:-90] = b"\xfe" * 10  # 11111 begins no code
    fault = stream(bytes(content)).count_fault()
    assert fault is not None
    assert "not a code" in fault[1]


def test_what_is_not_a_lossless_jpeg() -> None:
    for content in (b"", b"\xff\xd8", b"not a JPEG", bytes(100)):
        if content != b"\xff\xd8":
            assert find_stream(np.frombuffer(content, np.uint8)) is None
    lossy = imagecodecs.jpeg_encode((random_mosaic(64, 64) >> 8).astype(np.uint8))
    assert find_stream(np.frombuffer(lossy, np.uint8)) is None


def test_a_damaged_header(samples: NDArray[np.uint16]) -> None:
    """A byte set to 0xFF, the header cut there or zero from there on: told, or the stream is none; no other error."""
    content = encode(samples)
    length = stream(content).start
    for at in range(2, length):
        for damaged in (
            content[:at],
            content[:at] + b"\xff" + content[at + 1 :],
            content[:at] + bytes(len(content) - at),
        ):
            try:
                found = find_stream(np.frombuffer(damaged, np.uint8))
            except ValueError as error:
                assert "JPEG header" in str(error)  # noqa: PT017 # most are refused, some are fine
            else:
                if found is not None:
                    found.count_fault()
