"""Camera, exposure and time of every container, held against what exiftool 12.57 says of the same files.

The values of the two real files are exiftool's, copied by hand.
"""

from __future__ import annotations

import struct
from datetime import datetime
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest
import rawpy

from eldata.errors import RawFileError
from eldata.raw import exposure_ratio, read_header, read_raw, write_dng
from eldata.raw.container import lossy_compression, read_container
from eldata.raw.reading import raw_facts
from eldata.raw.tiff import TiffReader
from eldata.records import Exposure, RawHeader
from tests.raw.helpers import EXPOSURE, Tag, add_tags, check_refused, make_sensor, random_mosaic, write_plain_dng

REAL = Path(__file__).parent / "real"
CR3, DNG = REAL / "canon-eos-r6.cr3", REAL / "gopro-fusion.dng"


def stated(path: Path) -> RawHeader:
    """What a file says, without LibRaw: such files need no pixels."""
    return read_container(path).header


# --- CR3 ------------------------------------------------------------------------------------------------------


def test_a_real_cr3() -> None:
    header = read_header(CR3)
    assert (header.make, header.model) == ("Canon", "Canon EOS R6")
    assert header.exposure == Exposure(Fraction(25600), Fraction(1, 100), Fraction(14, 5))
    assert header.taken == datetime(2025, 9, 6, 20, 24, 47, 720_000)  # noqa: DTZ001


def at_box(data: bytes | bytearray, kind: bytes) -> int:
    """Where the first box of a kind begins."""
    return data.index(kind) - 4


def test_a_cr3_cut_off_anywhere(tmp_path: Path) -> None:
    data, path = CR3.read_bytes(), tmp_path / "a.CR3"
    for end in range(4, len(data), 97):
        path.write_bytes(data[:end])
        check_refused(path, ".")


@pytest.mark.parametrize(
    ("kind", "size", "words"),
    [
        (b"moov", 7, "less than its own head"),
        (b"moov", 2**31, "truncated: it declares data up to byte"),
        (b"CMT2", 3000, "reaches beyond the box that it stands in"),
        (b"CNCV", 4, "less than its own head"),
    ],
)
def test_a_cr3_whose_boxes_do_not_hold_together(kind: bytes, size: int, words: str, tmp_path: Path) -> None:
    data, path = bytearray(CR3.read_bytes()), tmp_path / "a.CR3"
    struct.pack_into(">I", data, at_box(data, kind), size)
    path.write_bytes(data)
    check_refused(path, words, stated)


def test_a_cr3_of_a_great_many_boxes(tmp_path: Path) -> None:
    data, path = CR3.read_bytes(), tmp_path / "a.CR3"
    moov = at_box(data, b"moov")
    path.write_bytes(data[:moov] + struct.pack(">I4s", 8, b"free") * 1001 + data[moov:])
    check_refused(path, "more than 1000 boxes", stated)


def test_sizes_of_64_bits_and_to_the_end_of_the_file(tmp_path: Path) -> None:
    data, path = CR3.read_bytes(), tmp_path / "a.CR3"
    moov = at_box(data, b"moov")
    size = struct.unpack_from(">I", data, moov)[0]
    wide = struct.pack(">I4sQ", 1, b"moov", size + 8) + data[moov + 8 : moov + size]
    for rest in (wide, b"\0\0\0\0" + data[moov + 4 : moov + size]):
        path.write_bytes(data[:moov] + rest)
        assert stated(path).exposure == stated(CR3).exposure


# --- TIFF by another name, and TIFF in a container ------------------------------------------------------------

EXIF: tuple[Tag, ...] = (
    (33434, "2I", 1, (1, 25), True),
    (33437, "2I", 1, (28, 10), True),
    (34855, "H", 1, 400, True),
    (36867, "s", 0, "2026:11:21 10:00:01", True),
)
EXPECTED = Exposure(Fraction(400), Fraction(1, 25), Fraction(14, 5))


def tiff(folder: Path, *tags: Tag, **fields: Any) -> bytes:
    write_plain_dng(folder / "tiff", random_mosaic(24, 24), ("RG", "GB"), *tags, **fields)
    return (folder / "tiff").read_bytes()


@pytest.mark.parametrize("magic", [b"IIRO", b"IIRS", b"IIU\0"])
def test_tiff_files_that_call_themselves_something_else(magic: bytes, tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(magic + tiff(tmp_path, *EXIF)[4:])
    header = stated(tmp_path / "a")
    assert (header.make, header.model, header.exposure) == ("Acme", "Nocturne 1", EXPECTED)
    assert header.taken == datetime(2026, 11, 21, 10, 0, 1)  # noqa: DTZ001


def test_panasonics_own_iso(tmp_path: Path) -> None:
    own: tuple[Tag, ...] = ((1, "B", 4, b"0340", True), (0x17, "H", 1, 80, True))
    (tmp_path / "a.RW2").write_bytes(b"IIU\0" + tiff(tmp_path, *own)[4:])
    assert stated(tmp_path / "a.RW2").exposure.iso == 80
    own = (own[0], (0x17, "H", 1, 65535, True), (0x37, "I", 1, 204800, True))
    (tmp_path / "a.RW2").write_bytes(b"IIU\0" + tiff(tmp_path, *own)[4:])
    assert stated(tmp_path / "a.RW2").exposure.iso == 204800


def mrw(*blocks: tuple[bytes, bytes]) -> bytes:
    body = b"".join(struct.pack(">4sI", name, len(content)) + content for name, content in blocks)
    return struct.pack(">4sI", b"\0MRM", len(body)) + body


def test_the_tiff_in_an_mrw(tmp_path: Path) -> None:
    path = tmp_path / "a.MRW"
    path.write_bytes(mrw((b"\0PRD", bytes(24)), (b"\0TTW", tiff(tmp_path, *EXIF)), (b"\0WBG", bytes(4))) + bytes(99))
    header = stated(path)
    assert (header.make, header.model, header.exposure) == ("Acme", "Nocturne 1", EXPECTED)
    path.write_bytes(path.read_bytes()[:500])
    check_refused(path, "truncated", stated)
    path.write_bytes(mrw(*[(b"\0WBG", b"")] * 100_000))
    check_refused(path, "damaged: it declares more than 1000 blocks", stated)
    path.write_bytes(mrw((b"\0PRD", bytes(24))).replace(struct.pack(">I", 24), struct.pack(">I", 25)))
    check_refused(path, "damaged: its block at byte 8 reaches beyond its header of 40 bytes", stated)


# --- values that files do not state ---------------------------------------------------------------------------


UNKNOWN = {"0 over something": (0, 1_000_000), "something over 0": (5, 0), "0 over 0": (0, 0)}


@pytest.mark.parametrize("parts", UNKNOWN.values(), ids=UNKNOWN)
def test_an_unknown_exposure_is_none(parts: tuple[int, int], tmp_path: Path) -> None:
    path = tmp_path / "a.dng"
    tags: tuple[Tag, ...] = ((33434, "2I", 1, parts, True), (33437, "2I", 1, parts, True), (34855, "H", 1, 400, True))
    write_plain_dng(path, random_mosaic(64, 66), ("RG", "GB"), *tags)
    assert read_header(path).exposure == Exposure(Fraction(400), None, None)
    with pytest.raises(RawFileError, match=r"a\.dng: states no exposure time, and an exposure ratio needs it"):
        exposure_ratio(read_raw(path), read_header(path))


@pytest.mark.parametrize(
    ("tags", "iso"),
    [
        ([(34855, "H", 1, 0, True)], None),
        ([(34855, "H", 1, 65535, True)], None),  # "more than 16 bits hold", and nothing says how much
        ([(34855, "H", 1, 65535, True), (34866, "I", 1, 102400, True)], 102400),
        # SensitivityType names the one that the ISO repeats.
        ([(34855, "H", 1, 65535, True), (34864, "H", 1, 1, True), (34865, "I", 1, 80000, True)], 80000),
        ([(34864, "H", 1, 3, True), (34866, "I", 1, 100, True), (34867, "I", 1, 102400, True)], 102400),
        ([(34855, "H", 1, 400, True), (34866, "I", 1, 500, True)], 400),
    ],
)
def test_the_iso(tags: list[Tag], iso: int | None, tmp_path: Path) -> None:
    write_plain_dng(tmp_path / "a.dng", random_mosaic(64, 66), ("RG", "GB"), *tags)
    header = stated(tmp_path / "a.dng")
    assert header.exposure.iso == iso
    if iso is None:
        with pytest.raises(RawFileError, match=r"a\.dng: states no ISO, and an exposure ratio needs it"):
            exposure_ratio(read_header(CR3), header)


def test_reading_a_header_decodes_no_pixels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Undecodable(rawpy.RawPy):
        def __getattribute__(self, name: str) -> object:
            assert name in {"open_file", "close"}, name  # what rawpy answers without decoding
            return super().__getattribute__(name)

    monkeypatch.setattr(rawpy, "RawPy", Undecodable)
    write_plain_dng(tmp_path / "a.dng", random_mosaic(64, 66))
    assert read_header(tmp_path / "a.dng").exposure == Exposure(None, None, None)
    assert read_header(CR3).model == "Canon EOS R6"


@pytest.mark.parametrize("text", ["0000:00:00 00:00:00", "1980:01:01 00:00:00", "2026-11-21 10:00:00"])
def test_a_clock_that_was_never_set_is_unknown(text: str, tmp_path: Path) -> None:
    write_plain_dng(tmp_path / "a.dng", random_mosaic(60, 64), ("RG", "GB"), (36867, "s", 0, text, True))
    assert stated(tmp_path / "a.dng").taken is None


def test_a_dng_that_names_its_camera_in_one_tag(tmp_path: Path) -> None:
    """Blackmagic's do."""
    data = tiff(tmp_path, make="Acme", model="Nocturne 1")
    path = tmp_path / "a.dng"
    path.write_bytes(
        data.replace(struct.pack("<H", 271), b"\x01\x04", 1).replace(struct.pack("<H", 272), b"\x02\x04", 1)
    )
    header = stated(path)
    assert (header.make, header.model) == ("", "Acme Nocturne 1")


# --- a real DNG -----------------------------------------------------------------------------------------------


def test_a_real_dng() -> None:
    frame, header = read_raw(DNG), read_header(DNG)
    assert (header.make, header.model) == ("GoPro", "FUSION")
    assert header.exposure == frame.exposure == Exposure(Fraction(100), Fraction(1, 3413), Fraction(14, 5))
    assert header.taken == datetime(2017, 9, 21, 16, 40, 10)  # noqa: DTZ001
    sensor = frame.sensor
    assert (sensor.cfa, sensor.black_level_dn, sensor.white_level_dn) == (((0, 1), (3, 2)), (0.0,) * 4, 16383.0)
    assert sensor.xyz_to_camera == ((1.0344, -0.421, -0.062), (-0.2315, 1.0625, 0.1948), (0.0093, 0.1058, 0.5541))
    assert frame.mosaic.shape == (64, 96)
    # Its Orientation is 2, mirrored: the mosaic stands as the sensor was read out.
    assert frame.mosaic[0, :4].tolist() == list(struct.unpack_from("<4H", DNG.read_bytes(), 6992))


# --- what loses data --------------------------------------------------------------------------------------------------

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


# --- once -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("decode", [False, True])
def test_the_directories_of_a_file_are_read_once(decode: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """For a header, its pixels and every check of damage together."""
    walk, walks = TiffReader.walk, []

    def counted(reader: TiffReader) -> Any:
        walks.append(reader)
        return walk(reader)

    monkeypatch.setattr(TiffReader, "walk", counted)
    write_dng(tmp_path / "a.dng", random_mosaic(60, 64), make_sensor(), EXPOSURE, compression="lossless-jpeg")
    header, sensor = raw_facts(tmp_path / "a.dng", decode=decode)
    assert len(walks) == 1
    assert header.exposure == EXPOSURE
    assert (sensor is not None) == decode
