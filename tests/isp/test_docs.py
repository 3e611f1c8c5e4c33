"""The examples of docs/srgb.md run, on files made here in the layouts that they name."""

from __future__ import annotations

import re
import runpy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from eldata import SIDDataset
from eldata.isp.response import read_response_table
from tests.isp.curves import GRID, family

TEXT = (Path(__file__).parents[2] / "docs" / "srgb.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```python\n(.*?)```", TEXT, flags=re.DOTALL)


def run(number: int, folder: Path, names: dict[str, Any] | None = None) -> dict[str, Any]:
    """Run an example in a folder, which must be the current one, and return the names that it leaves."""
    script = folder / f"example-{number}.py"
    script.write_text(EXAMPLES[number])
    return runpy.run_path(str(script), names)


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """What the first example leaves behind."""
    folder = tmp_path_factory.mktemp("docs")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        return folder, run(0, folder)


def test_there_are_four_examples() -> None:
    assert len(EXAMPLES) == 4


def test_a_frame_is_rendered(first: tuple[Path, dict[str, Any]]) -> None:
    folder, names = first
    picture = np.asarray(Image.open(folder / "frame.png"))
    assert picture.shape == (*names["packed"].shape[1:], 3)
    assert np.percentile(picture, 5) < 60 < 120 < np.percentile(picture, 95) < 255  # neither black nor blown


def test_curves_are_read(first: tuple[Path, dict[str, Any]], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    curves = np.array([curve.brightness[0] for curve in family()[:3]])
    np.savetxt("CRF_SonyA7S2_5.txt", curves)  # in the layout of the ELD repository
    run(2, tmp_path)
    run(1, tmp_path, {name: first[1][name] for name in ("Rendering", "frame")})
    table = read_response_table("mine.txt")
    np.testing.assert_array_equal(table.brightness, curves)
    np.testing.assert_array_equal(table.irradiance, np.broadcast_to(GRID, curves.shape))


def test_training_pairs_are_made(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    folder = tmp_path / "data" / "SID"
    for record in SIDDataset(folder, camera="sony", split="train", check="never").records:
        for path in record.files:
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            (folder / path).touch()
    monkeypatch.chdir(tmp_path)
    assert len(run(3, tmp_path)["pairs"]) == 1865
