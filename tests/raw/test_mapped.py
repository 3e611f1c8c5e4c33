"""Uncompressed mosaics read where their tags place them, beside what was written and what LibRaw decodes."""

from __future__ import annotations

import os
import pickle
import re
import struct
import subprocess
import sys
from dataclasses import fields, replace
from functools import partial
from importlib.metadata import version
from itertools import product
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import imagecodecs
import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray

from eldata import __version__
from eldata.errors import ArgumentError, RawFileError
from eldata.raw import mapped, read_header, read_raw, reading, write_dng
from eldata.raw.container import read_container
from eldata.raw.damage import check_samples
from eldata.raw.reading import raw_facts
from eldata.raw.tiff import Order
from eldata.records import RawFrame
from eldata.sources.frames import Files
from tests.raw.helpers import (
    BAYER,
    EXPOSURE,
    active_area,
    add_tags,
    check_refused,
    make_sensor,
    random_mosaic,
    write_plain_dng,
)
from tests.raw.test_strips import move_blocks
from tests.raw.test_strips import written as written_in

HEIGHT, WIDTH = 131, 67
DEPTHS = [(8, ">"), (10, "<"), (12, "<"), (14, "<"), (16, "<"), (16, ">")]
FORMS: list[dict[str, Any]] = [{}, {"rowsperstrip": 13}, {"tile": (32, 48)}]
written = partial(written_in, size=(HEIGHT, WIDTH))
PARTS = (slice(0, 1), slice(0, 1)), (slice(13, 71), slice(31, 66)), (slice(100, None), slice(-7, None))


@pytest.fixture(autouse=True)
def nothing_is_confirmed(monkeypatch: pytest.MonkeyPatch) -> dict[tuple[Any, ...], str]:
    verdicts: dict[tuple[Any, ...], str] = {}
    for module in (mapped, reading):
        monkeypatch.setattr(module, "verdicts", verdicts)
    return verdicts


def pack_bits(mosaic: NDArray[Any], bits: int) -> NDArray[np.uint8]:
    ones = (mosaic[:, :, None] >> np.arange(bits)[::-1]) & 1
    return np.packbits(ones.reshape(len(mosaic), -1).astype(np.uint8), axis=1)


def write_raf(
    path: Path, model: str, shape: tuple[int, int], bits: int, *, is_packed: bool, second: int = 0, words: int = 1
) -> Any:
    """A RAF: its own head; EXIF in a JPEG; records of the CFA, big-endian; a directory in a directory of the pixels."""
    mosaic = random_mosaic(*shape, low=1, high=1 << bits)
    size = shape[0] - 12, shape[1] - 64
    exif = struct.pack("<2sHI3H3I9s", b"II", 42, 8, 1, 271, 2, 9, 26, 0, b"FUJIFILM")
    jpeg = b"\xff\xd8\xff\xe1" + struct.pack(">H", len(exif) + 8) + b"Exif\0\0" + exif + b"\xff\xd9"
    table = struct.pack("<2xH4s2I", 0x0258, b"WRTS", *size[::-1]).ljust(20004, b"\0")  # as of an X-T2
    records = {0x100: struct.pack(">2H", *shape), 0x121: struct.pack(">2H", *size), 0x130: b"\1\x0c\0\0"}
    if model == "X-T2":
        records[0x131] = bytes(map("RGB".index, "GBGGRGRGRBGBGBGGRGGRGGBGBGBRGRGRGGBG"))
    records |= {0x2FF0: struct.pack(">4H", 300, 500, 300, 400), 0xC000: table}
    header = struct.pack(">I", len(records))
    header += b"".join(struct.pack(">2H", tag, len(value)) + value for tag, value in records.items())
    stored = pack_bits(mosaic, bits).reshape(-1, 4)[:, ::-1] if is_packed else mosaic
    tags = {0xF001: shape[1], 0xF002: shape[0], 0xF003: bits, 0xF007: 200, 0xF008: stored.nbytes}
    tags |= {0xF006: words} if bits == 12 else {}
    entries = b"".join(struct.pack("<2H2I", tag, 4, 1, tags[tag]) for tag in sorted(tags))
    outer = struct.pack("<2sHI3H3IH", b"II", 42, 8, 1, 0xF000, 4, 1, 26, 0, len(tags))
    pixels = (outer + entries).ljust(200, b"\0") + stored.tobytes()
    places = 148, len(jpeg), 300, len(header), 300 + len(header), len(pixels)
    head = b"FUJIFILMCCD-RAW 0201FF129502" + model.encode().ljust(32, b"\0")
    head = head.ljust(84, b"\0") + struct.pack(">6I12xI", *places, second)
    path.write_bytes((head.ljust(148, b"\0") + jpeg).ljust(300, b"\0") + header + pixels)
    return mosaic


def write_camera(path: Path, model: str, shape: tuple[int, int], bits: int, order: Order, is_packed: bool) -> Any:
    """A camera's own TIFF: 16 bits that call themselves fewer, unless they are packed."""
    mosaic: NDArray[Any] = random_mosaic(*shape, low=1, high=1 << bits)
    tags = [(271, "s", 0, model.partition(" ")[0], True), (272, "s", 0, model, True), (33421, "H", 2, (2, 2), True)]
    tags.append((33422, "B", 4, bytes((0, 1, 1, 2)), True))
    stored: Any = mosaic
    options: dict[str, Any] = {"photometric": 32803, "metadata": None, "extratags": tags, "byteorder": order}
    if is_packed:  # as bytes: tifffile packs numbers of this order wrongly
        stored = pack_bits(mosaic, bits)
    tifffile.imwrite(path, stored, **options)
    content = bytearray(path.read_bytes())
    with tifffile.TiffFile(path) as tiff:
        for tag, value in ((256, shape[1]), (258, bits)):
            entry = tiff.pages.first.tags[tag]
            struct.pack_into(f"{order}{'H' if entry.dtype == 3 else 'I'}", content, entry.offset + 8, value)
    path.write_bytes(content)
    return mosaic


def check(path: Path) -> NDArray[np.uint16]:
    """Assert that a file is mapped, whole and in parts, and that LibRaw says the same of it; return its mosaic."""
    by_libraw, first = read_raw(path, "libraw"), read_raw(path)
    frame = Files().frame(str(path))
    assert frame.reads_parts
    assert set(mapped.verdicts.values()) == {""}
    for mosaic in (first.mosaic, frame.whole()):
        np.testing.assert_array_equal(mosaic, by_libraw.mosaic)
    for rows, columns in PARTS:
        np.testing.assert_array_equal(frame.read(rows, columns), by_libraw.mosaic[rows, columns])
    for field in fields(RawFrame):
        assert field.name == "mosaic" or getattr(first, field.name) == getattr(by_libraw, field.name)
    assert (frame.sensor, frame.exposure) == (by_libraw.sensor, by_libraw.exposure)
    assert frame.channel_white_levels_dn == by_libraw.channel_white_levels_dn
    return first.mosaic


@pytest.mark.parametrize("form", FORMS, ids=str)
@pytest.mark.parametrize(("bits", "order"), DEPTHS)
@pytest.mark.parametrize("gap", [None, 4])
def test_layouts(form: dict[str, Any], bits: int, order: str, gap: int | None, tmp_path: Path) -> None:
    mosaic = written(tmp_path / "a.dng", bits=bits, byteorder=order, **form)
    if gap is not None:
        move_blocks(tmp_path / "a.dng", gap)
    np.testing.assert_array_equal(check(tmp_path / "a.dng"), mosaic)


@pytest.mark.parametrize(("bits", "order"), DEPTHS)
@pytest.mark.parametrize("corner", list(product((6, 7), (10, 11))), ids=str)
def test_visible_areas(bits: int, order: str, corner: tuple[int, int], tmp_path: Path) -> None:
    area = active_area(*corner, HEIGHT - 3, WIDTH - 2)
    mosaic = written(tmp_path / "a.dng", area, bits=bits, byteorder=order, **FORMS[bits % 3])
    visible = check(tmp_path / "a.dng")
    down, right = (side - side % 2 for side in corner)  # LibRaw may begin a pixel further in
    inside = np.lib.stride_tricks.sliding_window_view(mosaic, visible.shape)[down : down + 3, right : right + 3]
    assert (inside == visible).all(axis=(2, 3)).sum() == 1


@pytest.mark.parametrize(
    ("model", "shape", "bits", "order", "is_packed", "margin"),
    [
        ("SONY ILCE-7SM2", (160, 4256), 14, "<", False, 0),
        ("NIKON D850", (160, 8288), 14, ">", False, 0),
        ("NIKON D3", (160, 4288), 12, ">", True, 2),
        ("PENTAX K-5", (160, 4992), 12, ">", True, 0),
    ],
)
def test_cameras(
    model: str, shape: tuple[int, int], bits: int, order: Order, is_packed: bool, margin: int, tmp_path: Path
) -> None:
    mosaic = write_camera(tmp_path / "a.raw", model, shape, bits, order, is_packed)
    visible = check(tmp_path / "a.raw")
    np.testing.assert_array_equal(visible, mosaic[:, margin:][:, : visible.shape[1]])


def encode_jpeg(samples: NDArray[Any], bits: int, predictor: int) -> bytes:
    """A lossless JPEG (ITU-T T.81, annex H) of samples (rows, columns, components), each category a code of 5 bits."""
    values = samples.astype(np.int64)
    around = np.pad(values, ((1, 0), (1, 0), (0, 0)))
    left, above, corner = around[1:, :-1], around[:-1, 1:], around[:-1, :-1]
    of_both = left + above - corner, left + ((above - corner) >> 1), above + ((left - corner) >> 1), (left + above) >> 1
    guess = [left, above, corner, *of_both][predictor - 1].copy()
    guess[0], guess[:, 0] = left[0], above[:, 0]
    guess[0, 0] = 1 << (bits - 1)
    text = ""
    for value in (((values - guess + 32768) & 65535) - 32768).ravel().tolist():
        length = abs(value).bit_length()
        text += f"{length:05b}"
        if 0 < length < 16:  # -32768 alone has 16, and no bits
            text += f"{value if value > 0 else value + (1 << length) - 1:0{length}b}"
    text += "1" * (-len(text) % 8)
    count = samples.shape[2]
    segments = {
        0xC3: struct.pack(">B2HB", bits, *samples.shape) + b"".join(bytes((n, 0x11, 0)) for n in range(count)),
        0xC4: bytes((0, 0, 0, 0, 0, 17, *bytes(11), *range(17))),
        0xDA: bytes((count, *sum(((n, 0) for n in range(count)), ()), predictor, 0, 0)),
    }
    head = b"".join(struct.pack(">2BH", 255, marker, len(body) + 2) + body for marker, body in segments.items())
    code = int(text, 2).to_bytes(len(text) // 8, "big").replace(b"\xff", b"\xff\0")
    return b"\xff\xd8" + head + code + b"\xff\xd9"


@pytest.mark.parametrize("predictor", range(1, 8))
@pytest.mark.parametrize(
    ("bits", "shape"), [(8, (32, 24, 2)), (10, (32, 48, 1)), (12, (16, 48, 2)), (14, (32, 24, 2)), (16, (32, 16, 3))]
)
def test_tiles_of_lossless_jpeg(bits: int, shape: tuple[int, int, int], predictor: int, tmp_path: Path) -> None:
    """However each spreads its 32 x 48 pixels over rows and components; those at the edges are filled up."""
    padded = random_mosaic(160, 96, low=1 << (bits - 2), high=1 << (bits - 1), seed=predictor)
    tiles = [padded[y : y + 32, x : x + 48] for y in range(0, 160, 32) for x in (0, 48)]
    codes = (encode_jpeg(tile.reshape(shape), bits, predictor) for tile in tiles)
    options: dict[str, Any] = {"bitspersample": bits} if bits % 8 else {}
    options |= {"shape": (131, 67), "dtype": np.uint8 if bits == 8 else np.uint16, "tile": (32, 48)}
    write_plain_dng(tmp_path / "a.dng", codes, ("RG", "GB"), white=(1 << bits) - 1, compression=7, **options)
    np.testing.assert_array_equal(check(tmp_path / "a.dng"), padded[:131, :67])


def test_a_crop_decodes_its_tiles(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mosaic, decoded = random_mosaic(HEIGHT, WIDTH), Mock(wraps=imagecodecs.ljpeg_decode)
    padded = np.pad(mosaic, ((0, 13), (0, 29)), "symmetric")
    codes = [encode_jpeg(padded[y : y + 16, x : x + 48, None], 16, 1) for y in range(0, HEIGHT, 16) for x in (0, 48)]
    options: dict[str, Any] = {"shape": mosaic.shape, "dtype": np.uint16, "compression": 7}
    write_plain_dng(tmp_path / "a.dng", iter(codes), ("RG", "GB"), tile=(16, 48), **options)
    frame = Files().frame(str(tmp_path / "a.dng"))
    monkeypatch.setattr(imagecodecs, "ljpeg_decode", decoded)
    np.testing.assert_array_equal(frame.read(slice(20, 50), slice(5, 9)), mosaic[20:50, 5:9])
    assert sorted(call.args[0] for call in decoded.mock_calls) == sorted(codes[2:8:2])
    content = (tmp_path / "a.dng").read_bytes()
    (tmp_path / "a.dng").write_bytes(content.replace(codes[2], codes[2][:60].ljust(len(codes[2]), b"\xab")))
    with pytest.raises(RawFileError, match=r"a\.dng: damaged: its lossless JPEG at byte \d+ does not decode"):
        Files().frame(str(tmp_path / "a.dng")).read(slice(20, 40), slice(5, 9))
    write_plain_dng(tmp_path / "a.dng", iter(codes[:9]), ("RG", "GB"), rowsperstrip=16, **options)
    check_refused(tmp_path / "a.dng", "in 9 strips of lossless JPEG, of which LibRaw decodes the first alone")
    write_plain_dng(tmp_path / "a.dng", iter(codes[:9]), ("RG", "GB"), tile=(16, 80), **options)
    check_refused(tmp_path / "a.dng", "whose tiles of lossless JPEG are wider than it")


@pytest.mark.parametrize(
    ("model", "width", "bits", "is_packed", "corner"),
    [
        ("X-T2", 6160, 14, False, (6, 0)),
        ("X-A1", 5120, 14, False, (6, 0)),
        ("GFX 50R", 9216, 14, True, (0, 0)),
        ("X-T2", 6160, 14, True, (6, 0)),
        ("HS10 HS11", 3664, 12, True, (6, 32)),
    ],
)
def test_rafs(model: str, width: int, bits: int, is_packed: bool, corner: tuple[int, int], tmp_path: Path) -> None:
    mosaic = write_raf(tmp_path / "a.raf", model, (162, width), bits, is_packed=is_packed)
    top, left = corner
    visible = check(tmp_path / "a.raf")
    assert visible.shape[0] == 150
    np.testing.assert_array_equal(visible, mosaic[top:, left:][:150, : visible.shape[1]])


@pytest.mark.parametrize("changes", [{"second": 160}, {"words": 0}], ids=str)
def test_rafs_that_libraw_reads(changes: dict[str, int], tmp_path: Path) -> None:
    write_raf(tmp_path / "a.raf", "HS10 HS11", (162, 3664), 12, is_packed=True, **changes)
    assert read_container(tmp_path / "a.raf").rows is None


def test_a_file_of_a_confirmed_form_is_not_decoded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written(tmp_path / "a.dng")
    other = written(tmp_path / "b.dng", seed=1)
    read_raw(tmp_path / "a.dng")
    decode = reading._decode
    monkeypatch.setattr(reading, "_decode", lambda file, way: decode(file, way) if way == "short" else None)
    np.testing.assert_array_equal(read_raw(tmp_path / "b.dng").mosaic, other)
    monkeypatch.setattr(reading, "open_raw", None)
    assert read_header(tmp_path / "b.dng").levels_dn == (0, 65535)


@pytest.mark.parametrize("cfa", ["RGGB", "GBRG"])
@pytest.mark.parametrize(
    ("tags", "is_asked"),
    [
        ([], False),
        ([active_area(6, 10, 58, 61)], False),
        ([active_area(7, 10, 58, 61)], True),  # LibRaw's margin is another
        ([(37500, "B", 8, bytes(8), True)], True),  # a maker's notes
        ([(50717, "2I", 1, (31999, 2), True)], True),  # white, of which LibRaw keeps whole DN
        ([(50728, "2I", 4, (1, 2, 1, 1, 1, 2, 1, 1), True)], True),  # a white balance of four colours
        ([(50714, "2I", 4, (2049, 4, 511, 1, 512, 1, 513, 1), True)], False),
    ],
    ids=str,
)
def test_libraw_is_not_asked_what_tags_state(
    tags: list[Any], is_asked: bool, cfa: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in "ab":
        write_dng(tmp_path / f"{name}.dng", random_mosaic(60, 64), make_sensor(BAYER[cfa], 60, 64), EXPOSURE)
        add_tags(tmp_path / f"{name}.dng", *tags)
    check(tmp_path / "a.dng")
    asked = Mock(wraps=reading.open_raw)
    monkeypatch.setattr(reading, "open_raw", asked)
    check(tmp_path / "b.dng")
    assert asked.call_count == (3 if is_asked else 1)  # of three ways to read it, one by LibRaw


def test_a_worker_needs_no_rawpy(tmp_path: Path) -> None:
    mosaic = random_mosaic(60, 64)
    write_dng(tmp_path / "a.dng", mosaic, make_sensor(BAYER["RGGB"], 60, 64), EXPOSURE)
    check(tmp_path / "a.dng")
    code = (
        "import pickle, sys; frame = pickle.loads(sys.stdin.buffer.read()).frame(sys.argv[1])\n"
        "sys.stdout.buffer.write(pickle.dumps((frame.read(slice(3, 5), slice(7, 9)), 'rawpy' in sys.modules)))\n"
    )
    run = [sys.executable, "-c", code, str(tmp_path / "a.dng")]
    part, is_imported = pickle.loads(subprocess.check_output(run, input=pickle.dumps(Files())))
    np.testing.assert_array_equal(part, mosaic[3:5, 7:9])
    assert not is_imported


@pytest.mark.parametrize("wrong", ["a pixel", "the byte order", "a row"])
def test_a_wrong_layout_is_caught(wrong: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mosaic, of = written(tmp_path / "a.dng"), mapped.Layout.of

    def plan(*arguments: Any) -> mapped.Layout:
        layout = of(*arguments)
        (top, left, offset, rows), *_ = layout.blocks
        moved = (top, left, offset - (2 if wrong == "a pixel" else 2 * WIDTH), rows)
        return replace(layout, order=">") if wrong == "the byte order" else replace(layout, blocks=(moved,))

    monkeypatch.setattr(mapped.Layout, "of", plan)
    for _ in range(2):  # of the next file of that form, too
        frame = read_raw(tmp_path / "a.dng")
        np.testing.assert_array_equal(frame.mosaic, mosaic)
        said = rf"decoded by LibRaw, .* at row 0, column 0, there stand \d+ DN, and LibRaw has {mosaic[0, 0]} DN"
        assert re.search(said, frame.remarks[0])
    assert not Files().frame(str(tmp_path / "a.dng")).reads_parts


def test_verify_compares_every_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written(tmp_path / "a.dng")
    assert raw_facts(tmp_path / "a.dng", decode=True)[0].remarks == ()
    wrong = np.zeros((HEIGHT, WIDTH), np.uint16)
    with monkeypatch.context() as patch:
        patch.setattr(mapped.Layout, "read_whole", lambda _: wrong)
        assert "LibRaw has" in raw_facts(tmp_path / "a.dng", decode=True)[0].remarks[0]
    raw_facts(tmp_path / "a.dng", decode=True)  # the same again does not confirm the form
    assert not Files().frame(str(tmp_path / "a.dng")).reads_parts


def test_a_file_replaced_while_it_is_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.dng"
    written(path)
    read_raw(path)
    written(tmp_path / "b.dng", seed=1)

    def replace_it(*arguments: Any) -> None:
        check_samples(*arguments)
        (tmp_path / "b.dng").replace(path)

    monkeypatch.setattr("eldata.raw.reading.check_samples", replace_it)
    with pytest.raises(RawFileError, match="was replaced"):
        Files().frame(str(path)).read(slice(3), slice(3))


def test_forms_are_confirmed_one_by_one(
    tmp_path: Path, nothing_is_confirmed: dict[tuple[Any, ...], str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for order in "<>":
        written(tmp_path / "a.dng", byteorder=order)
        check(tmp_path / "a.dng")
    assert len(nothing_is_confirmed) == 2
    assert all(form[:2] == (__version__, version("rawpy")) for form in nothing_is_confirmed)
    source = pickle.dumps(Files())
    nothing_is_confirmed.clear()
    pickle.loads(source)  # as a DataLoader sends it to its workers
    assert len(nothing_is_confirmed) == 2
    nothing_is_confirmed.clear()
    monkeypatch.setenv("ELDATA_DECODER", "libraw")
    assert not Files().frame(str(tmp_path / "a.dng")).reads_parts
    assert not nothing_is_confirmed
    monkeypatch.setenv("ELDATA_DECODER", "dcraw")
    with pytest.raises(ArgumentError, match=r"ELDATA_DECODER must be one of 'mapped', 'libraw'; found 'dcraw'"):
        read_raw(tmp_path / "a.dng")


@pytest.mark.parametrize("form", [{}, {"rowsperstrip": 13}, {"bits": 12}], ids=str)
def test_a_file_that_changes_is_named(form: dict[str, Any], tmp_path: Path) -> None:
    path, words = tmp_path / "a.dng", r"a\.dng: was replaced or written to since .* \(it had \d+ bytes and has \d+ now"
    written(path, **form)
    if form == {"rowsperstrip": 13}:
        move_blocks(path, 2)
    frame, content = Files().frame(str(path)), path.read_bytes()
    for after in (content[: len(content) // 2], content + b"\0", b""):
        path.write_bytes(after)
        for rows in (slice(90, 131), slice(None)):
            with pytest.raises(RawFileError, match=words):
                frame.read(rows, slice(None))
    written(tmp_path / "b.dng", seed=2, **form)
    (tmp_path / "b.dng").replace(path)
    with pytest.raises(RawFileError, match=words):
        frame.read(slice(3), slice(3))
    path.unlink()
    with pytest.raises(RawFileError, match=r"a\.dng: cannot be read: No such file"):
        frame.read(slice(3), slice(3))


def test_damage_shows_in_a_whole_frame(tmp_path: Path) -> None:
    mosaic = random_mosaic(HEIGHT, WIDTH)
    black = (50714, "I", 1, 100, True)
    write_plain_dng(tmp_path / "a.dng", mosaic, ("RG", "GB"), black)
    frame = Files().frame(str(tmp_path / "a.dng"))
    assert frame.reads_parts
    mosaic[40:60] = 0
    write_plain_dng(tmp_path / "a.dng", mosaic, ("RG", "GB"), black)
    frame = Files().frame(str(tmp_path / "a.dng"))
    np.testing.assert_array_equal(frame.read(slice(30, 50), slice(None)), mosaic[30:50])
    with pytest.raises(RawFileError, match=r"damaged: 1340 pixels in a row, from row 40, column 0 on, are 0 DN"):
        frame.whole()


def test_few_files_are_open_at_a_time(tmp_path: Path) -> None:
    for number in range(100):
        written(tmp_path / f"{number}.dng", seed=number)
    code = (
        "import resource, sys; from pathlib import Path; from eldata.sources.frames import Files\n"
        "resource.setrlimit(resource.RLIMIT_NOFILE, (64, 64))\n"
        "frames = [Files().frame(str(path)) for path in sorted(Path(sys.argv[1]).iterdir())]\n"
        "print(sum(int(frame.read(slice(5, 9), slice(7)).sum()) for _ in range(2) for frame in frames))\n"
    )
    run = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path)], capture_output=True, text=True, check=True, env=dict(os.environ)
    )
    expected = sum(random_mosaic(HEIGHT, WIDTH, low=1, high=1 << 16, seed=n)[5:9, :7].sum() for n in range(100))
    assert int(run.stdout) == 2 * expected
