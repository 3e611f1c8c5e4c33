"""eldata compare: what it prints word for word, what it warns of, what it refuses."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.cases import in_one_test
from tests.cli.conftest import Cli, assert_golden
from tests.cli.test_usage import assert_one_line
from tests.reports.evaluations import result_data, table_of, written


@pytest.fixture
def files(tmp_path: Path) -> list[Path]:
    """A baseline, a method that is 0.5 dB better, and one with a hostile name that is worse."""
    return [
        written(tmp_path / "base.json", result_data()),
        written(tmp_path / "unet.json", result_data(gain_db=0.5, method=1)),
        written(tmp_path / "my_net&co.json", result_data(gain_db=-0.2, method=2)),
    ]


def changed(path: Path, change: Callable[[dict[str, Any]], None]) -> Path:
    data = json.loads(path.read_text(encoding="utf-8"))
    change(data)
    data["table"] = table_of(data)
    return written(path, data)


@pytest.mark.parametrize("form", ["text", "markdown", "latex"])
def test_tables(form: str, eldata: Cli, files: list[Path]) -> None:
    outcome = eldata("compare", *files, "--format", form)
    assert (outcome.code, outcome.err) == (0, "")
    assert_golden(f"compare-{form}", outcome.out)


def test_json_has_the_numbers_and_they_are_right(eldata: Cli, files: list[Path], tmp_path: Path) -> None:
    outcome = eldata("compare", *files[:2], "--json", tmp_path / "out.json")
    assert outcome.code == 0
    found = json.loads((tmp_path / "out.json").read_text(encoding="utf-8"))
    first, second = (json.loads(path.read_text(encoding="utf-8"))["images"] for path in files[:2])
    assert [method["name"] for method in found["methods"]] == ["base", "unet"]
    assert found["warnings"] == []
    assert found["common"] == [image["path"] for image in first]
    assert found["statistics"] == {"level": 0.95, "resamples": 9999, "seed": 0, "clusters": ["scene"]}
    keys = [(group["camera"], group["ratio"]) for group in found["groups"]]
    cameras, ratios = ("SonyA7S2", "NikonD850"), (100.0, 200.0)
    assert keys == [(c, r) for c in (*cameras, None) for r in ratios] + [(None, None)]
    for group in found["groups"]:
        chosen = [
            index
            for index, image in enumerate(first)
            if group["camera"] in (None, image["camera"]) and group["ratio"] in (None, image["ratio"])
        ]
        assert group["images"] == len(chosen)
        for field in ("psnr_db", "ssim"):
            a, b = (np.array([images[index][field] for index in chosen]) for images in (first, second))
            assert group["means"][0][field] == pytest.approx(a.mean(), rel=1e-13)
            assert group["means"][1][field] == pytest.approx(b.mean(), rel=1e-13)
            interval = group["gains"][0][field]["interval"]
            assert interval["mean"] == pytest.approx((b - a).mean(), rel=1e-9)
            assert interval["low"] < interval["mean"] < interval["high"]
    assert found["groups"][-1]["gains"][0]["psnr_db"]["p_value"] == 2 / 2**8, "eight scenes of both cameras"


def without_six(data: dict[str, Any]) -> None:
    """Leave the first six images out."""
    data["coverage"] |= {"scored": 90, "missing": [image["path"] for image in data["images"][:6]]}
    del data["images"][:6]


def test_only_common_images_count_and_that_is_said(eldata: Cli, files: list[Path]) -> None:
    changed(files[1], without_six)
    outcome = eldata("compare", *files[:2])
    assert outcome.code == 0
    assert "2 methods on 90 common images of 8 scenes" in outcome.out
    assert "warning: base has scores of 96 images, of which 90 are common to all" in outcome.err
    assert "warning: unet is incomplete: 90 of 96 pairs were scored" in outcome.err


def test_best_is_what_prints_like_the_best(eldata: Cli, files: list[Path]) -> None:
    """Equal methods are both best, in every row."""
    outcome = eldata("compare", files[0], files[0], "--name", "a", "--name", "b", "--format", "markdown")
    assert outcome.out.split("\n\n")[2].count("**") == 2 * 2 * 2 * 7
    assert "+0.00 to +0.00" in outcome.out


# --- what may not compare -----------------------------------------------------------------------------------------


def test_another_protocol_is_warned_of(eldata: Cli, files: list[Path], tmp_path: Path) -> None:
    other = written(tmp_path / "other.json", result_data(protocol="eld-uncorrected"))
    outcome = eldata("compare", files[0], other, "--html", tmp_path / "page.html", "--format", "markdown")
    assert outcome.code == 0
    assert outcome.err.count("\n") == 1
    assert "base and other may not compare: protocol: rescaling: one factor per image against none" in outcome.err
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "Read before use: 1 warning." in page
    assert "rescaling: one factor per image against none" in page
    assert "Warning: base and other may not compare" in outcome.out


@in_one_test(
    "change, words",
    [
        ({"manifest_sha256": "sha256:" + "b" * 64}, "manifest sha256: sha256:aaaaaaaa against sha256:bbbbbbbb"),
        ({"dataset": "mine"}, "dataset: 'eld' against 'mine'"),
        ({"scenes_shared": False}, "scenes shared: true against false"),
        ({"libraw": "0.21.4", "predictions": "/elsewhere"}, None),  # which change no number
        ({"excluded_flags": {"misaligned": 6}}, None),  # by the pairs, not by the name of the choice
    ],
)
def test_another_set_is_warned_of(change: dict[str, object], words: str | None, eldata: Cli, files: list[Path]) -> None:
    written(files[1], result_data(gain_db=0.5, method=1))
    changed(files[1], lambda data: data["provenance"].update(change))
    outcome = eldata("compare", *files[:2])
    assert outcome.code == 0
    expected = "" if words is None else f"eldata compare: warning: base and unet may not compare: {words}\n"
    assert outcome.err == expected


def test_another_choice_of_pairs_is_warned_of(eldata: Cli, files: list[Path]) -> None:
    def choose(data: dict[str, Any]) -> None:
        without_six(data)
        data["coverage"] |= {"pairs": 90, "missing": []}
        data["provenance"]["excluded_flags"] = {"misaligned": 6}

    changed(files[1], choose)
    said = eldata("compare", *files[:2]).err
    assert "warning: base and unet may not compare: excluded flags: {} against {'misaligned': 6}\n" in said
    assert "warning: base has scores of 96 images, of which 90 are common" in said


# --- what is refused ----------------------------------------------------------------------------------------------


def test_what_is_refused(eldata: Cli, files: list[Path], tmp_path: Path) -> None:
    other = written(tmp_path / "sid.json", result_data(cameras=["Sony"], dataset="sid-sony", protocol="sid"))
    page = tmp_path / "x.html"
    apart = eldata("compare", files[0], other, "--html", page)
    assert_one_line(apart, "no image is common", "96 of eld", "48 of sid-sony")
    assert not page.exists()
    assert_one_line(eldata("compare", files[0]), "two results or more")
    assert_one_line(eldata("compare", files[0], files[0]), "two results are called 'base'", "--name")
    assert_one_line(eldata("compare", *files[:2], "--name", "a"), "found 1 for 2 files")
    assert_one_line(eldata("compare", files[0], tmp_path / "none.json"), "none.json", "No such file")
    assert_one_line(eldata("compare", *files[:2], "--format", "word"), "--format", "word", "latex")


def test_perfect_predictions(eldata: Cli, files: list[Path], tmp_path: Path) -> None:
    """An infinite PSNR has no difference: the groups that it is in say so, the others stand."""
    changed(files[1], lambda data: data["images"][0].update({"psnr_db": "inf"}))
    outcome = eldata("compare", *files[:2], "--html", tmp_path / "page.html", "--json", tmp_path / "out.json")
    assert (outcome.code, outcome.err) == (0, "")
    groups = json.loads((tmp_path / "out.json").read_text(encoding="utf-8"))["groups"]
    assert groups[0]["gains"][0]["psnr_db"] == {
        "interval": {"mean": "inf", "low": None, "high": None, "images": 24, "scenes": 8},
        "p_value": None,
    }
    assert math.isfinite(groups[1]["gains"][0]["psnr_db"]["interval"]["low"])
    assert "is not finite" in (tmp_path / "page.html").read_text(encoding="utf-8")
