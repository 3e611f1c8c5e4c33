"""A sample's bytes: as other people's readers see them, and as hostile ones are refused."""

from __future__ import annotations

import io
import json
import pickle
import tarfile
from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eldata.records import Exposure, PairRecord
from eldata.sources.shards.index import (
    END,
    Facts,
    MemberError,
    Side,
    _npy,
    facts_text,
    from_bytes,
    parse_facts,
    to_bytes,
)
from tests.raw.helpers import BAYER, XTRANS, make_sensor, random_mosaic

if TYPE_CHECKING:
    from pathlib import Path

RECORD = PairRecord(
    "a/ü 1.ARW", "a/b.ARW", "SonyA7S2", "scene-1", "test", Fraction(800), Fraction(1, 30), Fraction(100), ("x", "y")
)


def facts_of(height: int = 6, width: int = 8, cfa: Any = BAYER["RGGB"]) -> Facts:
    sensor = make_sensor(cfa, height, width)
    sides = [Side(sensor, Exposure(Fraction(800), Fraction(1, 30))), Side(sensor, Exposure(Fraction(100), Fraction(4)))]
    return Facts(RECORD, Fraction(960), 2, 4, *sides)


FACTS = facts_of()
PIXELS = random_mosaic(6, 8, seed=1), random_mosaic(6, 8, seed=2)


def made(*members: tuple[str, bytes], **fields: Any) -> bytes:
    """A tar of some members by tarfile, without its end; the fields are those of the last member's header."""
    file = io.BytesIO()
    with tarfile.open(fileobj=file, mode="w", format=tarfile.USTAR_FORMAT) as archive:
        for number, (name, content) in enumerate(members):
            info = tarfile.TarInfo(name)
            info.size = len(content)
            if number == len(members) - 1:
                for field, value in fields.items():
                    setattr(info, field, value)
            archive.addfile(info, io.BytesIO(content))
        size = archive.offset
    return file.getvalue()[:size]


def npy(array: Any, **options: Any) -> bytes:
    file = io.BytesIO()
    np.save(file, array, **options)
    return file.getvalue()


JSON = ("000000042.json", facts_text(FACTS).encode())
INPUT, TARGET = ("000000042.input.npy", npy(PIXELS[0])), ("000000042.target.npy", npy(PIXELS[1]))


def test_a_sample_comes_back() -> None:
    for cfa in (*BAYER.values(), XTRANS["xtrans-00"]):
        facts = facts_of(12, 18, cfa)
        mosaics = random_mosaic(12, 18, seed=3), random_mosaic(12, 18, seed=4)
        sample = from_bytes(to_bytes("000000042", facts, *mosaics))
        assert (sample.number, sample.facts) == (42, facts)
        np.testing.assert_array_equal(sample.input_dn, mosaics[0])
        np.testing.assert_array_equal(sample.target_dn, mosaics[1])
        assert sample.input_dn.dtype == np.uint16


def test_the_bytes_are_those_of_tarfile_and_numpy() -> None:
    """Nobody needs this package to read a shard."""
    content = to_bytes("000000042", FACTS, *PIXELS)
    assert content == made(JSON, INPUT, TARGET)
    with tarfile.open(fileobj=io.BytesIO(content + END)) as archive:
        assert archive.getnames() == ["000000042.json", "000000042.input.npy", "000000042.target.npy"]
        for info, wanted in zip(archive.getmembers()[1:], PIXELS, strict=True):
            file = archive.extractfile(info)
            assert file is not None
            np.testing.assert_array_equal(np.load(io.BytesIO(file.read()), allow_pickle=False), wanted)


# It leaves the file to the garbage collector.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning", "ignore::ResourceWarning")
def test_webdataset_reads_them(tmp_path: Path) -> None:
    """The library whose convention it is, without its decoders."""
    wds = pytest.importorskip("webdataset")
    other = to_bytes("000000007", facts_of(12, 18), random_mosaic(12, 18, seed=3), random_mosaic(12, 18, seed=4))
    (tmp_path / "shard-000000.tar").write_bytes(to_bytes("000000042", FACTS, *PIXELS) + other + END)
    got = list(wds.WebDataset(str(tmp_path / "shard-000000.tar"), shardshuffle=False))
    assert [sample["__key__"] for sample in got] == ["000000042", "000000007"]
    assert json.loads(got[0]["json"])["record"]["path"] == RECORD.path
    np.testing.assert_array_equal(np.load(io.BytesIO(got[0]["input.npy"])), PIXELS[0])
    np.testing.assert_array_equal(np.load(io.BytesIO(got[0]["target.npy"])), PIXELS[1])


@given(st.integers(0, 300), st.integers(0, 300))
def test_the_header_of_any_size_is_numpys(height: int, width: int) -> None:

    pixels = np.zeros((height, width), np.uint16)
    assert _npy(pixels) == npy(pixels)


# --- what is refused ----------------------------------------------------------------------------------------------


class Bomb:
    """Leaves a file behind if it is ever unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> Any:
        return open, (str(self.path), "w")


def test_no_pickle_is_ever_loaded(tmp_path: Path) -> None:
    """As a member of a kind that WebDataset would run, as an array of objects, and as either member's content."""
    trace = tmp_path / "was-here"
    pickled = pickle.dumps(Bomb(trace))
    array = np.empty((6, 8), object)
    array[:] = Bomb(trace)
    objects = npy(array, allow_pickle=True)
    for members in (
        (JSON, INPUT, ("000000042.pyd", pickled)),
        (JSON, ("000000042.pkl", pickled), TARGET),
        (JSON, INPUT, ("000000042.target.pth", pickled)),
        (("000000042.pickle", pickled),),
        (JSON, ("000000042.input.npy", objects), TARGET),
        (JSON, ("000000042.input.npy", pickled), TARGET),
        (("000000042.json", pickled), INPUT, TARGET),
        (JSON, INPUT, TARGET, ("000000042.extra.pyd", pickled)),
    ):
        with pytest.raises(MemberError):
            from_bytes(made(*members))
    assert not trace.exists()
    pickle.loads(pickled).close()  # the bomb would have gone off
    assert trace.exists()


@pytest.mark.parametrize(
    "name", ["../000000042.target.npy", "/etc/passwd", "a/000000042.target.npy", "..", "000000043.target.npy"]
)
def test_names_that_lead_elsewhere(name: str) -> None:
    with pytest.raises(MemberError, match=r"does not belong in a shard: expected 000000042\.target\.npy"):
        from_bytes(made(JSON, INPUT, (name, TARGET[1])))


@pytest.mark.parametrize(
    "kind", [tarfile.SYMTYPE, tarfile.LNKTYPE, tarfile.DIRTYPE, tarfile.CHRTYPE, tarfile.FIFOTYPE, b"x", b"L", b"S"]
)
def test_links_folders_devices_and_extensions(kind: bytes) -> None:
    content = bytearray(made(JSON, INPUT, TARGET))
    at = len(made(JSON, INPUT))
    info = tarfile.TarInfo("000000042.target.npy")
    info.type, info.linkname, info.size = kind, "/etc/passwd", len(TARGET[1])
    content[at : at + 512] = info.tobuf(tarfile.USTAR_FORMAT)
    with pytest.raises(MemberError, match=r"'000000042\.target\.npy' is a link, folder or device"):
        from_bytes(bytes(content))


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "a sample has 3 members; found 0"),
        (b"\0" * 1024, "is not a tar header"),
        (b"x" * 1024, "is not a tar header"),
        (made(JSON, INPUT), "a sample has 3 members; found 2"),
        (made(JSON, INPUT, TARGET)[:-512], "'000000042.target.npy' says that it has 224 bytes, more than its sample"),
        (made(JSON, INPUT, TARGET) + b"\1" * 100, "is not a tar header"),
        (made(JSON, TARGET, INPUT), "member '000000042.target.npy' does not belong in a shard"),
        (made(("42.json", JSON[1]), INPUT, TARGET), "member '42.json' does not belong in a shard"),
        (
            made(JSON, ("000000042.input.npy", npy(PIXELS[0].astype(np.int16))), TARGET),
            r"expected \(6, 8\) pixels of uint16",
        ),
        (
            made(JSON, ("000000042.input.npy", npy(PIXELS[0].astype(">u2"))), TARGET),
            r"expected \(6, 8\) pixels of uint16",
        ),
        (made(JSON, ("000000042.input.npy", npy(PIXELS[0][:4])), TARGET), r"expected \(6, 8\) pixels of uint16"),
        (made(JSON, ("000000042.input.npy", npy(PIXELS[0])[:-2]), TARGET), r"expected \(6, 8\) pixels of uint16"),
        (made(JSON, ("000000042.input.npy", npy(PIXELS[0].T)), TARGET), r"expected \(6, 8\) pixels of uint16"),
    ],
)
def test_other_bytes(content: bytes, words: str) -> None:
    with pytest.raises(MemberError, match=words):
        from_bytes(content)


def changed(**fields: Any) -> bytes:
    data = json.loads(facts_text(FACTS))
    for place, value in fields.items():
        *outer, name = place.split("__")
        inside = data
        for part in outer:
            inside = inside[part]
        inside[name] = value
    return json.dumps(data).encode()


@pytest.mark.parametrize(
    "text",
    [
        *(b"", b"{", b"[]", b"null", b"3", b"\xff\xfe", b"[" * 100_000, b'{"record": {}}'),
        changed(ratio="1e999999999"),  # a number that would take for ever
        changed(ratio="1/0"),
        changed(ratio="0"),
        changed(ratio=960),
        changed(record__ratio=None),
        changed(record__path=5),
        changed(record__flags=[None]),
        changed(input__sensor__height="6"),
        changed(input__sensor__height=-6),
        changed(input__sensor__width=10),
        changed(input__sensor__cfa=[[0, 0], [0, 0]]),
        changed(input__sensor__cfa=[[1, 0], [2, 3]]),
        changed(input__sensor__black_level_dn=[512.0]),
        changed(target__sensor__black_level_dn=[512.0, float("nan"), 512.0, 512.0]),
        changed(target__sensor__white_level_dn="high"),
        changed(target__sensor__unknown=1),
        changed(input__exposure__iso="many"),
    ],
)
def test_facts_that_are_none(text: bytes) -> None:
    with pytest.raises(MemberError, match=r"member 000000042\.json does not hold a sample's facts|expected .* pixels"):
        from_bytes(made(("000000042.json", text), INPUT, TARGET))


def test_facts_stay_exact() -> None:
    facts = replace(FACTS, record=replace(RECORD, iso=None, exposure_s=None, flags=()), ratio=Fraction(10**12, 7))
    assert parse_facts(facts_text(facts).encode()) == facts
