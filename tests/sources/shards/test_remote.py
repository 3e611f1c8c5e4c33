"""Shards elsewhere: fsspec's memory, a web server that fails, shards that are damaged, cut or of somebody else."""

from __future__ import annotations

import io
import os
import shutil
import subprocess
import sys
import tarfile
import time
import zlib
from collections import Counter
from contextlib import closing
from typing import TYPE_CHECKING

import fsspec  # type: ignore[import-untyped] # it has none
import numpy as np
import pytest

from eldata import StreamedPairs
from eldata.datasets.loading import evaluation_loader, set_epoch, training_loader
from eldata.datasets.ranks import Rank
from eldata.errors import ArgumentError
from eldata.sources.shards import ShardError, reading, verify_shards
from eldata.sources.shards.index import END, INDEX, Shard, ShardIndex, index_text, parse_index
from eldata.sources.shards.reading import Folder, Forward
from tests.sources.shards.helpers import identities, unbatched
from tests.sources.shards.server import serving
from tests.sources.shards.test_members import INPUT, JSON, TARGET, made

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


def copied(folder: Path, place: Path) -> Path:
    shutil.copytree(folder, place)
    return place


# --- other places -------------------------------------------------------------------------------------------------


@pytest.fixture
def memory(tiles: Path) -> Iterator[str]:
    system = fsspec.filesystem("memory")
    for path in tiles.iterdir():
        system.pipe_file(f"/bucket/tiles/{path.name}", path.read_bytes())
    yield "memory://bucket/tiles"
    system.rm("/bucket", recursive=True)


@pytest.mark.parametrize("end", ["", "/"])
def test_from_memory(end: str, memory: str, tiles: Path) -> None:
    here = identities(StreamedPairs(str(tiles), crop=10))
    assert identities(StreamedPairs(memory + end, crop=10)) == here
    assert verify_shards(memory + end) == []
    assert identities(StreamedPairs(f"file://{tiles}", crop=10)) == here


@pytest.mark.parametrize("ranges", [True, False])
def test_from_a_web_server(ranges: bool, tiles: Path) -> None:
    """One that knows no ranges, as python -m http.server, is read from the first byte on."""
    here = StreamedPairs(str(tiles), crop=10)
    with serving(tiles, ranges=ranges) as site:
        there = StreamedPairs(site.address, crop=10)
        assert identities(there) == identities(here)
        assert verify_shards(site.address) == []


def test_workers_read_from_a_web_server(tiles: Path) -> None:
    with serving(tiles) as site:
        loader = evaluation_loader(StreamedPairs(site.address, augment=False), 5, workers=2)
        got = unbatched(loader)
    assert Counter(got) == Counter(identities(StreamedPairs(str(tiles), augment=False)))


def test_a_rank_fetches_its_part_alone(tiles: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 144 samples the 72nd rank of 144 reads one; what is fetched at once is made as small as a sample."""

    monkeypatch.setattr(reading, "_BLOCK_BYTES", 4096)
    with serving(tiles) as site:
        dataset = StreamedPairs(site.address, rank=Rank(71, 144))
        site.sent = 0
        assert len(identities(dataset)) == 1
        assert 0 < site.sent < 30_000
    assert sum(path.stat().st_size for path in tiles.glob("*.tar")) > 800_000


@pytest.mark.parametrize(
    ("ranges", "failures"), [(False, ["cut"]), (True, ["503", "503", "503"]), (True, ["500", "cut", "502", "cut"])]
)
def test_a_connection_that_breaks_is_taken_up_again(ranges: bool, failures: list[str], tiles: Path) -> None:
    with serving(tiles, ranges=ranges) as site:
        dataset = StreamedPairs(site.address, crop=10, retry_wait_s=0)
        site.failures = list(failures)
        assert identities(dataset) == identities(StreamedPairs(str(tiles), crop=10))
        assert site.failures == []


@pytest.mark.parametrize(
    ("ranges", "failures"),
    [(True, ["reset"]), (True, ["stall"]), (False, ["stop", "stop"]), (False, ["trickle", "trickle", "trickle"])],
)
def test_a_slow_or_a_silent_server_is_waited_for_and_asked_again(
    ranges: bool, failures: list[str], tiles: Path
) -> None:
    """A body of fifty pieces takes a second, which is longer than no byte may come for, and no failure."""
    with serving(tiles, ranges=ranges) as site:
        dataset = StreamedPairs(site.address, crop=10, retry_wait_s=0, timeout_s=0.7)
        site.failures = list(failures)
        assert identities(dataset) == identities(StreamedPairs(str(tiles), crop=10))
        assert site.failures == []
        if "trickle" in failures:
            assert site.requests <= 2 * 4  # of index and three shards: none was asked for again


def test_a_server_that_never_answers_is_an_error(tiles: Path) -> None:
    with serving(tiles) as site:
        dataset = StreamedPairs(site.address, attempts=2, retry_wait_s=0, timeout_s=0.2)
        site.failures = ["stall"] * 100
        words = (
            r"shards/shard-00000\d\.tar: cannot be read after 2 attempts \(no byte came for 0\.2 s\); is the server up"
        )
        with pytest.raises(ShardError, match=words):
            next(iter(dataset))
        with pytest.raises(ArgumentError, match="timeout_s must be finite and above 0; found 0"):
            StreamedPairs(site.address, timeout_s=0)


def test_options_of_the_callers_own_decide_how_long_it_is_waited_for(tiles: Path) -> None:
    from aiohttp import ClientTimeout

    with serving(tiles) as site:
        own = {"client_kwargs": {"timeout": ClientTimeout(total=0.2)}}
        dataset = StreamedPairs(site.address, attempts=1, storage_options=own)
        site.failures = ["stall"] * 2
        with pytest.raises(ShardError, match="cannot be read"):
            next(iter(dataset))


def test_a_range_shorter_than_asked_for_is_read_on(tiles: Path) -> None:
    with serving(tiles) as site:
        dataset = StreamedPairs(site.address, crop=10, retry_wait_s=0)
        site.failures = ["", "short", "", "short", "short"]
        assert identities(dataset) == identities(StreamedPairs(str(tiles), crop=10))


@pytest.mark.parametrize("ranges", [True, False])
def test_a_body_without_an_end_is_not_kept(ranges: bool, tiles: Path) -> None:
    """What was asked for is 8 MiB at the most, and some lie in the buffers between server and client."""
    with serving(tiles, ranges=ranges) as site:
        dataset = StreamedPairs(site.address, crop=10, attempts=2, retry_wait_s=0)
        site.failures = ["endless"] * 100
        site.sent = 0
        words = r"shard-00000\d\.tar: .*(sent more than the \d+ bytes that it was asked for|index)"
        with pytest.raises(ShardError, match=words):
            identities(dataset)
        assert site.sent < 128 << 20


@pytest.mark.parametrize("failure", ["shifted", "other"])
def test_bytes_that_are_not_those_of_the_index_are_an_error(failure: str, tiles: Path) -> None:
    """A range that is another one than its header says, and a file that was replaced after the index was read."""
    with serving(tiles) as site:
        dataset = StreamedPairs(site.address, crop=10)
        site.failures = [failure] * 100
        words = (
            r"shard-00000\d\.tar: sample \d+ \(bytes \d+ to \d+\) is damaged or of other shards: its checksum is not"
        )
        with pytest.raises(ShardError, match=words):
            next(iter(dataset))


def test_a_restart_fetches_what_is_left_alone(tiles: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 144 samples 4 kB each are left; what was given out before is not fetched, but for parts of blocks."""
    monkeypatch.setattr(reading, "_BLOCK_BYTES", 4096)
    with serving(tiles) as site:
        loader = training_loader(StreamedPairs(site.address, crop=8, shuffle_buffer=5), 4, workers=0)
        site.sent = 0
        whole = unbatched(loader)
        all_sent = site.sent
        site.sent = 0
        set_epoch(loader, 0, first_batch=32)
        assert unbatched(loader) == whole[128:]
        assert site.sent < all_sent / 3


def test_what_keeps_failing_is_one_error(tiles: Path) -> None:
    with serving(tiles) as site:
        dataset = StreamedPairs(site.address, attempts=3, retry_wait_s=0)
        site.failures = ["503"] * 100
        with pytest.raises(
            ShardError, match=r"shards/shard-00000\d\.tar: cannot be read after 3 attempts \(.*is the addre"
        ):
            next(iter(dataset))
        assert 100 - len(site.failures) <= 6  # a HEAD and a GET each


def test_what_is_not_there_is_not_tried_again(tiles: Path, tmp_path: Path) -> None:
    folder = copied(tiles, tmp_path / "shards")
    for path in folder.glob("*.tar"):
        path.unlink()
    with serving(folder) as site:
        dataset = StreamedPairs(site.address, retry_wait_s=1000)
        with pytest.raises(ShardError, match=r"shard-00000\d\.tar: cannot be read \(FileNotFoundError"):
            next(iter(dataset))
        (folder / INDEX).unlink()
        with pytest.raises(ShardError, match=r"shards/index\.json: cannot be read \(FileNotFoundError"):
            StreamedPairs(site.address, retry_wait_s=1000)
    with pytest.raises(ShardError, match=r"nowhere/index\.json: cannot be read \(FileNotFoundError"):
        StreamedPairs(str(tmp_path / "nowhere"))


HUB = """
import sys
from eldata import StreamedPairs
try:
    StreamedPairs("hf://datasets/somebody/set", attempts=2, retry_wait_s=0)
except Exception as error:
    sys.exit(f"{type(error).__name__}: {error}")
"""


def said_of_the_hub(endpoint: str) -> str:
    pytest.importorskip("huggingface_hub")
    environment = {**os.environ, "HF_ENDPOINT": endpoint, "HF_HUB_OFFLINE": "0"}  # read as it is imported
    return subprocess.run(
        [sys.executable, "-c", HUB], env=environment, capture_output=True, text=True, check=False
    ).stderr


def test_a_hub_that_is_not_reached_is_one_error() -> None:
    said = said_of_the_hub("http://127.0.0.1:9")  # the port of discard: nothing listens
    assert said.startswith("ShardError: hf://datasets/somebody/set/index.json: cannot be read after 2 attempts (")
    assert "ConnectError" in said


def test_what_is_not_on_the_hub_is_not_tried_again(tiles: Path) -> None:
    with serving(tiles) as site:
        said = said_of_the_hub(site.address)
    assert said.startswith("ShardError: hf://datasets/somebody/set/index.json: cannot be read (")
    assert "404" in said


def test_addresses_that_fsspec_cannot_open() -> None:
    with pytest.raises(ArgumentError, match=r"tape://reel: cannot be opened .*tape"):
        StreamedPairs("tape://reel")


def test_waits_double(tiles: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    waited: list[float] = []
    monkeypatch.setattr(time, "sleep", waited.append)
    with serving(tiles) as site:
        site.failures = ["503"] * 100
        with pytest.raises(ShardError), closing(Forward(Folder(site.address, {}, 4, 0.25), "shard-000000.tar")) as file:
            file.read(10)
    assert waited == [0.25, 0.5, 1.0]


# --- damage -------------------------------------------------------------------------------------------------------


def test_a_truncated_shard(tiles: Path, tmp_path: Path) -> None:
    folder = copied(tiles, tmp_path / "shards")
    index = parse_index("", (folder / INDEX).read_bytes())
    path = folder / index.shards[1].name
    end = int(index.shards[1].starts[20]) + 700
    path.write_bytes(path.read_bytes()[:end])
    words = rf"shard-000001\.tar: is truncated: it ends at byte {end}, \d+ bytes too early; copy it again"
    with pytest.raises(ShardError, match=words):
        list(StreamedPairs(str(folder)))
    (problem,) = verify_shards(str(folder))
    assert "shard-000001.tar: is truncated" in problem


def test_a_changed_byte_anywhere_is_found(tiles: Path, tmp_path: Path) -> None:
    """In a header, in the facts, in pixels, in padding, and after the last sample."""
    folder = copied(tiles, tmp_path / "shards")
    path = folder / "shard-000002.tar"
    whole = path.read_bytes()
    for place in (3, 600, 3000, len(whole) - 1100):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
        with pytest.raises(
            ShardError, match=r"shard-000002\.tar: sample \d+ \(bytes \d+ to \d+\) is damaged or of other"
        ):
            list(StreamedPairs(str(folder)))
        assert len(verify_shards(str(folder))) == 1
    for tail in (b"", END + b"\0", END[:-1] + b"\1"):
        path.write_bytes(whole[: -len(END)] + tail)
        (problem,) = verify_shards(str(folder))
        assert "does not end after its 44 samples" in problem


def test_shards_of_other_work(tiles: Path, frames: Path, tmp_path: Path) -> None:
    folder = copied(tiles, tmp_path / "shards")
    shutil.copy(frames / "shard-000000.tar", folder)
    with pytest.raises(
        ShardError, match=r"shard-000000\.tar: sample 0 .* of other shards: its checksum is not that of the"
    ):
        list(StreamedPairs(str(folder)).for_evaluation(1, Rank()))
    (folder / "shard-000000.tar").unlink()
    (folder / "shard-000000.tar").mkdir()
    with pytest.raises(ShardError, match=r"shard-000000\.tar: cannot be read \(IsADirectoryError"):
        list(StreamedPairs(str(folder)))


# --- shards that somebody made, index and all ---------------------------------------------------------------------


def foreign(folder: Path, *samples: bytes) -> str:
    """Write a shard of any bytes with an index that fits them."""
    folder.mkdir()
    content = b"".join(samples) + END
    (folder / "shard-000000.tar").write_bytes(content)
    sizes = np.array([len(sample) for sample in samples], np.int64)
    sums = np.array([zlib.crc32(sample) for sample in samples], np.uint32)
    shard = Shard("shard-000000.tar", len(content), "sha256:0", sizes, sums)
    (folder / INDEX).write_text(index_text(ShardIndex("foreign", None, 0, 0, (shard,)), "somebody"))
    return str(folder)


def test_a_webdataset_of_other_things(tmp_path: Path) -> None:
    (tmp_path / "photos").mkdir()
    with tarfile.open(tmp_path / "photos" / "shard-000000.tar", "w") as archive:
        archive.addfile(tarfile.TarInfo("cat.jpg"), io.BytesIO())
    with pytest.raises(ShardError, match=r"photos/index\.json: cannot be read"):
        StreamedPairs(str(tmp_path / "photos"))
    address = foreign(tmp_path / "cats", made(("0.jpg", b"x"), ("0.cls", b"1"), ("0.txt", b"cat")))
    with pytest.raises(ShardError, match=r"member '0\.jpg' does not belong in a shard: expected KEY\.json"):
        list(StreamedPairs(address))


def test_numbers_that_come_twice_are_found(tmp_path: Path) -> None:
    good = made(JSON, INPUT, TARGET)
    address = foreign(tmp_path / "twice", good, good)
    assert any("expected sha256:0, found" in problem for problem in verify_shards(address))
    assert Counter(s["path"] for s in StreamedPairs(address, augment=False)) == {"a/ü 1.ARW": 2}
