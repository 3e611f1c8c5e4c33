"""Keywords stand in signatures with their defaults: what an editor and ``help()`` show of each dataset."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import pytest

from eldata import datasets

NEEDED = inspect.Parameter.empty
CHOICE: dict[str, Any] = dict.fromkeys(("cameras", "scenes", "isos", "ratios", "split", "subset"))
CHOICE["exclude_flags"] = ()
VALUES: dict[str, Any] = {"levels": None, "clip": "both", "amplification": "metadata", "dark_shading": None}
CROPS: dict[str, Any] = {"crop": None, "augment": False, "crops": "random", "seed": 0, "transform": None}
PACKED: dict[str, Any] = CROPS | {"crop": 512, "augment": True}
PAIRED: dict[str, Any] = VALUES | CROPS | {"crops_per_frame": 1}
PAIRS: dict[str, Any] = CHOICE | PAIRED | {"root": None, "check": "exists"}
WINDOWS: dict[str, Any] = {
    **CHOICE, **VALUES, **CROPS, "levels": "metadata",
    "ids": None, "window": 5, "stride": None, "frames": "all", "region": None, "crops_per_window": 1,
}  # fmt: skip
DRV: dict[str, Any] = {"root": None, "form": "preprocessed", "dynamic": False, "manifest": None, "reference": "*"}
DRV["check"] = "exists"
CRVD: dict[str, Any] = {"root": None, "shots": range(10), "manifest": None, "check": "exists"}
NOISE: dict[str, Any] = {
    "source": NEEDED, "profiles": NEEDED, "model": None, "clip": "both", "ratio": (100.0, 300.0), "iso": None,
    "range_dn": None, "row": None,
    "extrapolate": False, **PACKED,
}  # fmt: skip

SIGNATURES: list[tuple[Callable[..., Any], dict[str, Any]]] = [
    (datasets.PairDataset, PAIRS | {"root": NEEDED, "manifest": NEEDED}),
    (datasets.ELDDataset, PAIRS | {"manifest": "eld", "ratios": (100, 200)}),
    (datasets.SIDDataset, PAIRS | {"manifest": None, "camera": "sony", "amplification": "nominal"}),
    (datasets.LRDDataset, PAIRS | {"manifest": "lrd", "amplification": "nominal"}),
    (datasets.LRIDDataset, PAIRS | {"manifest": "lrid", "amplification": "nominal", "clip": "none"}),
    (datasets.SIDDDataset, PAIRS | {"manifest": None}),
    (datasets.PackedStore, CHOICE | VALUES | PACKED | {"path": NEEDED, "crops_per_frame": 1}),
    (datasets.SourcePairs, PAIRED | {"source": NEEDED, "records": NEEDED, "name": "", "levels": "metadata"}),
    (datasets.DRVDataset, WINDOWS | DRV),
    (datasets.PMRIDDataset, PAIRS | {"manifest": "pmrid"}),
    (datasets.RawNINDDataset, PAIRS | {"manifest": "rawnind"}),
    *((kind, WINDOWS | CRVD) for kind in (datasets.CRVDDataset, datasets.ReCRVDDataset, datasets.LLRVDDataset)),
    (datasets.PackedClips, WINDOWS | PACKED | {"path": NEEDED, "dynamic": False}),
    (datasets.SyntheticPairs, NOISE | {"crops_per_frame": 1}),
    (datasets.SyntheticClips, NOISE | {"frames": 5, "windows_per_clip": 1}),
]


@pytest.mark.parametrize(("shown", "defaults"), SIGNATURES, ids=lambda value: getattr(value, "__name__", None))
def test_every_keyword_stands_there_with_its_default(shown: Callable[..., Any], defaults: dict[str, Any]) -> None:
    parameters = inspect.signature(shown).parameters
    assert {name: one.default for name, one in parameters.items()} == defaults
