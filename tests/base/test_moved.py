"""Names of 0.1 that have moved."""

from __future__ import annotations

import sys
from importlib import import_module

import pytest

from eldata.base.moved import forwarded


@pytest.mark.parametrize(
    ("old", "new", "names"),
    [
        ("eldata.store", "eldata.sources.store", ("build_store", "open_store", "source_of_dataset", "verify_store")),
        ("eldata.streaming", "eldata.sources.shards", ("ShardError", "ShardIndex", "verify_shards", "write_shards")),
        ("eldata.streaming", "eldata.datasets", ("StreamedPairs",)),
    ],
)
def test_an_old_name_is_the_new_one_and_warns(old: str, new: str, names: tuple[str, ...]) -> None:
    for name in names:
        with pytest.warns(DeprecationWarning, match=f"{old}.{name} is {new}.{name} now; the old name will be removed"):
            found = getattr(import_module(old), name)
        assert found is getattr(import_module(new), name)


def test_unknown_names_and_dunders_are_not_forwarded() -> None:
    for name in ("nothing", "__path__"):
        with pytest.raises(AttributeError, match=f"module 'eldata.streaming' has no attribute '{name}'"):
            getattr(import_module("eldata.streaming"), name)
        with pytest.raises(AttributeError):
            getattr(import_module("eldata.store"), name)


def test_nothing_is_imported_before_a_name_is_asked_for() -> None:
    forward = forwarded("old", {"name": "eldata_that_is_not_there:name"})
    assert "eldata_that_is_not_there" not in sys.modules
    with pytest.raises(ModuleNotFoundError):
        forward("name")
