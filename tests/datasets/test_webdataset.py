"""docs/clusters.md, executed: the pairs of a store as tar files of webdataset, which reads the same tensors back."""

from __future__ import annotations

import gc
import re
from pathlib import Path
from typing import Any

import pytest
import torch

from tests.datasets.comparing import same

pytest.importorskip("webdataset", reason="needs webdataset, which only the tests use")

DOCUMENT = Path(__file__).parents[2] / "docs" / "clusters.md"


@pytest.mark.filterwarnings(
    "ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning"
)  # webdataset's
def test_the_recipe_gives_the_tensors_of_the_store(
    store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (recipe,) = re.findall(r"^```python tars.py\n(.*?)^```$", DOCUMENT.read_text("utf-8"), re.MULTILINE | re.DOTALL)
    for large, small in (("sid-train.h5", str(store)), ("crop=512", "crop=16"), ("{0000..0041}", "{0000..0002}")):
        assert large in recipe
        recipe = recipe.replace(large, small)
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    exec(compile(recipe, "tars.py", "exec"), names)  # noqa: S102 # our own document
    assert sorted(path.name for path in tmp_path.iterdir()) == ["sid-0000.tar", "sid-0001.tar", "sid-0002.tar"]
    pairs = names["pairs"]
    read = {sample["__key__"]: sample for sample in names["stream"]}
    assert len(read) == len(pairs) == 144
    for number, pair in enumerate(pairs):
        sample = read[f"{number:08d}"]
        tensors = {name: torch.from_numpy(sample[f"{name}.npy"]) for name in pair if f"{name}.npy" in sample}
        same(sample["facts.json"] | tensors, pair)
    batches = list(names["loader"])
    assert sum(len(batch[0]) for batch in batches) == 144
    assert batches[0][1].shape == (4, 4, 16, 16)
    names.clear()
    gc.collect()  # its last file is not closed before
