"""eldata shard: text, exit codes, one line for what goes wrong, and what kill -9 leaves."""

from __future__ import annotations

import json
from functools import partial
from typing import TYPE_CHECKING

import pytest

from eldata import StreamedPairs
from eldata.sources.shards import verify_shards
from tests.cli.conftest import Outcome
from tests.cli.test_usage import assert_one_line

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from tests.cli.conftest import Cli
    from tests.evaluation.helpers import Tree

    Shard = Callable[..., Outcome]


@pytest.fixture
def sharded(eldata: Cli) -> Shard:
    return partial(eldata, "shard")


@pytest.fixture
def store(eldata: Cli, tree: Tree, tmp_path: Path) -> Path:
    path = tmp_path / "store.h5"
    packed = eldata("pack", "eld-demo", "--manifest", tree.manifest, "--root", tree.root, "-o", path)
    assert packed.code == 0, packed.err
    return path


def test_shards_of_a_store(sharded: Shard, store: Path, tmp_path: Path) -> None:
    outcome = sharded(store, "-o", tmp_path / "shards", "--tile", "16", "--overlap", 2, "--samples-per-shard", "100")
    assert (outcome.code, outcome.err) == (0, "")
    assert outcome.out.startswith("288 samples in 3 shards: ")
    assert verify_shards(str(tmp_path / "shards")) == []
    whole = sharded(store, "-o", tmp_path / "whole", "--tile", "whole", "--camera", "DemoBeta", "--seed", "3")
    assert whole.out.startswith("12 samples in 1 shard: ")
    assert len(StreamedPairs(str(tmp_path / "whole"))) == 12


def test_what_is_wrong_is_one_line(sharded: Shard, store: Path, tmp_path: Path) -> None:
    out = tmp_path / "shards"
    assert_one_line(sharded(store), "--output")
    assert_one_line(sharded(store, "-o", out, "--tile", "half"), "expected a whole number of 0 or more, found 'half'")
    assert_one_line(sharded(store, "-o", out, "--samples-per-shard", "0"), "samples_per_shard must be 1 or more")
    assert_one_line(sharded(store, "-o", out), "64 x 96 pixels are too few for a tile of 1026 x 1026")
    assert_one_line(sharded(tmp_path / "no.h5", "-o", out), "no.h5: cannot be read")
    assert not out.exists()
    assert sharded(store, "-o", out, "--tile", "whole").code == 0
    assert_one_line(sharded(store, "-o", out, "--tile", "whole"), "holds finished shards already; remove it")


def test_shards_are_verified(eldata: Cli, sharded: Shard, store: Path, tmp_path: Path) -> None:
    out = tmp_path / "shards"
    sharded(store, "-o", out, "--tile", "16", "--samples-per-shard", "100")
    assert eldata("verify", out / "index.json") == Outcome(0, f"{out}/: every shard is whole\n", "")
    (out / "shard-000001.tar").write_bytes((out / "shard-000001.tar").read_bytes()[:-5000])
    broken = eldata("verify", out / "index.json", "--json", tmp_path / "found.json")
    assert (broken.code, broken.err) == (1, "")
    assert "shard-000001.tar" in broken.out
    assert json.loads((tmp_path / "found.json").read_text())["problems"] == broken.out.splitlines()
    assert_one_line(eldata("verify", out / "index.json", "--root", tmp_path), "shards are checked whole")
