"""Writing shards: what they hold, that they are the same every time, and what is left when something goes wrong."""

from __future__ import annotations

import errno
import hashlib
import io
import json
import tarfile
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from eldata.datasets import PackedStore
from eldata.errors import ArgumentError, DatasetError, EldataError
from eldata.raw import read_raw
from eldata.raw.cfa import packed_area
from eldata.sources.shards import ShardError, index, verify_shards, write_shards, writing
from eldata.sources.shards.index import INDEX, index_text, parse_index
from eldata.sources.shards.writing import BEGUN, grid
from tests.cases import in_one_test
from tests.raw.helpers import BAYER, CFAS, layout_of, make_sensor, start_of

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from tests.trees import Tree


def tar_samples(folder: Path) -> Iterator[tuple[str, dict[str, Any], Any, Any]]:
    """Key, facts and both arrays of each sample, by tarfile, json and numpy alone."""
    for path in sorted(folder.glob("shard-*.tar")):
        with tarfile.open(path) as archive:
            contents = [(info.name, archive.extractfile(info)) for info in archive.getmembers()]
            read = [(name, file.read()) for name, file in contents if file is not None]
        for start in range(0, len(read), 3):
            (name, facts), *arrays = read[start : start + 3]
            assert [n.partition(".")[2] for n, _ in read[start : start + 3]] == ["json", "input.npy", "target.npy"]
            pixels = [np.load(io.BytesIO(content), allow_pickle=False) for _, content in arrays]
            yield name.partition(".")[0], json.loads(facts), *pixels


def bytes_of(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


# --- what is written ----------------------------------------------------------------------------------------------


def test_whole_frames_are_the_raw_files(frames: Path, pristine: Tree) -> None:
    pairs = [record for record in pristine.manifest.records if record.role == "noisy"]
    seen = {}
    for key, facts, noisy, reference in tar_samples(frames):
        seen[int(key)] = facts["record"]["path"]
        np.testing.assert_array_equal(noisy, read_raw(pristine.data / facts["record"]["path"]).mosaic)
        np.testing.assert_array_equal(reference, read_raw(pristine.data / facts["record"]["reference"]).mosaic)
    assert sorted(seen) == list(range(24))
    assert sorted(seen.values()) == sorted(record.path for record in pairs)
    assert list(seen) != sorted(seen)  # shuffled
    assert verify_shards(str(frames)) == []


def test_tiles_cover_each_frame(tiles: Path, pristine: Tree) -> None:
    covered: dict[str, Any] = {}
    for _, facts, noisy, reference in tar_samples(tiles):
        path, top, left = facts["record"]["path"], facts["top"], facts["left"]
        assert noisy.shape == reference.shape == (34, 34)
        place = np.s_[top : top + 34, left : left + 34]
        np.testing.assert_array_equal(noisy, read_raw(pristine.data / path).mosaic[place])
        np.testing.assert_array_equal(reference, read_raw(pristine.data / facts["record"]["reference"]).mosaic[place])
        covered.setdefault(path, np.zeros((64, 96), int))[place] += 1
    assert len(covered) == 24
    assert all(count.min() == 1 and count.max() <= 4 for count in covered.values())
    assert verify_shards(str(tiles)) == []


def test_the_index_says_where_samples_are(tiles: Path) -> None:
    index = parse_index("here", (tiles / INDEX).read_bytes())
    assert (len(index), index.tile, index.dataset) == (144, 16, "eld-demo")
    assert list(map(len, index.shards)) == [50, 50, 44]
    for shard in index.shards:
        content = (tiles / shard.name).read_bytes()
        assert len(content) == shard.bytes
        assert f"sha256:{hashlib.sha256(content).hexdigest()}" == shard.sha256
        with tarfile.open(tiles / shard.name) as archive:
            assert [info.offset for info in archive.getmembers()[::3]] == shard.starts[:-1].tolist()
    assert parse_index("here", index_text(index, "x").encode()).shards[2].sample_bytes.tolist() == (
        index.shards[2].sample_bytes.tolist()
    )


def test_the_same_bytes_whenever_it_is_done(eld: Path, tiles: Path, tmp_path: Path) -> None:
    write_shards(eld, tmp_path / "again", tile=16, samples_per_shard=50)
    assert bytes_of(tmp_path / "again") == bytes_of(tiles)
    write_shards(eld, tmp_path / "other", tile=16, samples_per_shard=50, seed=1)
    first, second = ({key: facts for key, facts, *_ in tar_samples(folder)} for folder in (tiles, tmp_path / "other"))
    assert first == second  # a sample keeps its number
    assert list(first) != list(second)


def test_a_part_of_the_store(eld: Path, tmp_path: Path) -> None:
    report = write_shards(eld, tmp_path / "part", tile=None, cameras=["DemoBeta"])
    assert (report.samples, report.shards) == (12, 1)
    records = PackedStore(eld, cameras=["DemoBeta"]).records
    assert {facts["record"]["path"] for _, facts, *_ in tar_samples(tmp_path / "part")} == {r.path for r in records}
    with pytest.raises(ArgumentError, match="DemoAlpha"):
        write_shards(eld, tmp_path / "none", cameras=["Nobody"])


# --- where tiles lie ----------------------------------------------------------------------------------------------


@in_one_test("cfa", [*BAYER.values(), *(CFAS[name] for name in ("xtrans-00", "xtrans-42", "quad-12", "nona-41"))])
@in_one_test("height, width", [(64, 96), (61, 99), (57, 57)])
@in_one_test("overlap", [0, 4])
def test_tiles_cover_what_packing_keeps(cfa: Any, height: int, width: int, overlap: int) -> None:
    sensor = make_sensor(cfa, height, width)
    period, scale = len(cfa), layout_of(cfa)[2]
    area = packed_area((height, width), cfa)
    count = np.zeros((height, width), int)
    places = grid("x", sensor, 8, overlap)
    assert len(set(places)) == len(places)
    for tile in places:
        assert tile.height == tile.width == 8 * scale + period
        assert ((tile.top - area.top) % period, (tile.left - area.left) % period) == (0, 0)
        assert tile.cfa == start_of(cfa)  # so that packing a tile loses nothing
        for y in range(period):
            assert tile.cfa[y] == tuple(cfa[(tile.top + y) % period][(tile.left + x) % period] for x in range(period))
        count[tile.slices] += 1
        assert tile.sensor(sensor).cfa == tile.cfa
    assert count[area.slices].min() == 1
    count[area.slices] = 0
    assert not count.any()  # nothing of what packing drops
    tops = sorted({tile.top for tile in places})
    assert all(8 * scale + period - (b - a) >= overlap * scale for a, b in pairwise(tops))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"tile": 1}, "tile must be 2 or more and overlap from 0 up to below it; found 1, 0"),
        ({"tile": 16, "overlap": 16}, "found 16, 16"),
        ({"tile": 16, "overlap": -1}, "found 16, -1"),
        ({"samples_per_shard": 0}, "samples_per_shard must be 1 or more and seed 0 or more; found 0, 0"),
        ({"seed": -1}, "found 64, -1"),
    ],
)
def test_wrong_options(options: dict[str, Any], words: str, eld: Path, tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match=words):
        write_shards(eld, tmp_path / "x", **options)
    assert not (tmp_path / "x").exists()


def test_tiles_that_do_not_fit(eld: Path, fuji: Path, tmp_path: Path) -> None:
    with pytest.raises(
        DatasetError, match=r"64 x 96 pixels are too few for a tile of 66 x 66 \(tile=32\); take smaller"
    ):
        write_shards(eld, tmp_path / "x", tile=32)
    with pytest.raises(ArgumentError, match="tile and overlap must be even for X-Trans; found 5, 0"):
        write_shards(fuji, tmp_path / "x", tile=5)


# --- interruptions ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("error", [KeyboardInterrupt(), OSError(errno.ENOSPC, "No space left on device")])
def test_the_same_call_goes_on(
    error: BaseException, eld: Path, tiles: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "shards"
    real, left = index.to_bytes, iter(range(70))

    def failing(*arguments: Any) -> bytes:
        if next(left, None) is None:
            raise error
        return real(*arguments)

    monkeypatch.setattr(writing, "to_bytes", failing)
    with pytest.raises(KeyboardInterrupt if isinstance(error, KeyboardInterrupt) else EldataError):
        write_shards(eld, folder, tile=16, samples_per_shard=50)
    assert sorted(bytes_of(folder)) == [BEGUN, "shard-000000.tar"]
    with pytest.raises(ShardError, match=r"index\.json: cannot be read"):
        verify_shards(str(folder))
    monkeypatch.setattr(writing, "to_bytes", real)
    report = write_shards(eld, folder, tile=16, samples_per_shard=50)
    assert (report.resumed, report.shards) == (1, 3)
    assert bytes_of(folder) == bytes_of(tiles)


def test_after_a_kill_what_was_half_goes_and_what_is_damaged_is_written_anew(
    eld: Path, tiles: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What kill -9 leaves: a hidden part, and no index. A shard that was changed since is not taken for whole."""
    folder = tmp_path / "shards"
    monkeypatch.setattr(writing, "index_text", None)  # it is called last
    with pytest.raises(TypeError):
        write_shards(eld, folder, tile=16, samples_per_shard=50)
    monkeypatch.undo()
    (folder / ".shard-000001.tar.0123456789abcdef.part").write_bytes(b"half")
    for number, change in enumerate((lambda b: b[:3000] + b"?" + b[3001:], lambda b: b[:-1], lambda b: b + b"\0")):
        path = folder / f"shard-{number:06d}.tar"
        path.write_bytes(change(path.read_bytes()))  # type: ignore[no-untyped-call] # a lambda
    (folder / "shard-000002.tar").unlink()
    report = write_shards(eld, folder, tile=16, samples_per_shard=50)
    assert report.resumed == 0
    assert bytes_of(folder) == bytes_of(tiles)


def test_after_a_kill_between_the_last_two_steps(
    eld: Path, tiles: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The index is there, and still what was begun."""
    folder = tmp_path / "shards"

    def killed(_: Path) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(type(folder), "unlink", killed)
        with pytest.raises(KeyboardInterrupt):
            write_shards(eld, folder, tile=16, samples_per_shard=50)
    assert {INDEX, BEGUN} <= set(bytes_of(folder))
    assert write_shards(eld, folder, tile=16, samples_per_shard=50).resumed == 3
    assert bytes_of(folder) == bytes_of(tiles)


def test_other_work_is_not_mixed_in(eld: Path, tiles: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "shards"
    monkeypatch.setattr(writing, "index_text", None)
    with pytest.raises(TypeError):
        write_shards(eld, folder, tile=16)
    monkeypatch.undo()
    before = bytes_of(folder)
    wrong: list[tuple[dict[str, Any], str]] = [
        ({"tile": 14}, "was begun with another tile: expected 14, found 16; give the same data and options as then"),
        ({"tile": 16, "seed": 1}, "another seed: expected 1, found 0"),
        ({"tile": 16, "cameras": ["DemoBeta"]}, "another samples: expected sha256:"),
    ]
    for options, words in wrong:
        with pytest.raises(ArgumentError, match=words):
            write_shards(eld, folder, **options)
    assert bytes_of(folder) == before
    (folder / BEGUN).write_text("{")
    with pytest.raises(EldataError, match=r"is not JSON, or not whole .* remove the folder to start again"):
        write_shards(eld, folder, tile=16)
    with pytest.raises(EldataError, match="holds finished shards already; remove it, or name another folder"):
        write_shards(eld, tiles, tile=16, samples_per_shard=50)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.tex").write_text("")
    with pytest.raises(EldataError, match=r"holds other files, such as thesis\.tex; name a new folder"):
        write_shards(eld, tmp_path / "full", tile=16)
    (tmp_path / "file").write_text("")
    with pytest.raises(EldataError, match=r"cannot write into .*file"):
        write_shards(eld, tmp_path / "file", tile=16)


# --- an index that is none ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda _: b"{", "is not JSON, or not whole .*; expected a whole index, as eldata shard writes it"),
        (lambda _: b"[]", r"expected an object, found \[\]; expected a whole index, as eldata shard writes it"),
        (lambda data: data | {"format": "mds"}, "is not an index of eldata's shards"),
        (lambda data: data | {"version": 2}, "is of version 2, written by eldata .*: install a newer one"),
        (lambda data: data | {"samples": 143}, "is damaged: expected 143 samples, found 144"),
        (lambda data: data | {"samples": 0, "shards": []}, "expected 0 samples, found 0"),
        (lambda data: data | {"shards": 5}, "is damaged"),
        (lambda data: data | {"tile": "x"}, "is damaged"),
        *(
            (lambda data, name=name: data | {"shards": [data["shards"][0] | {"name": name}]}, "is damaged .*shard name")
            for name in ("../shard-000000.tar", "/etc/passwd", "s3://elsewhere/shard-000000.tar", 5)
        ),
        *(
            (lambda data, s=s: data | {"shards": [data["shards"][0] | {"samples": s}]}, "is damaged")
            for s in ([[-1, 5]], [[10**12, 5]], [[5, -1]], [[5, 1 << 32]], [[10**30, 1]], [[1]], ["x"], [[5, 1.5, 2]])
        ),
    ],
)
def test_a_wrong_index(change: Any, words: str, tiles: Path) -> None:
    changed = change(json.loads((tiles / INDEX).read_text()))
    content = changed if isinstance(changed, bytes) else json.dumps(changed).encode()
    with pytest.raises(ShardError, match=words):
        parse_index("index.json", content)
