"""The calibration demo, end to end with small frames, and its table of errors."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import pytest

import eldata.demo.calibration
from eldata.cli.main import main
from eldata.demo.body import FixedFeatures
from eldata.demo.calibration import compare_with_truth, run_calibration_demo
from eldata.demo.calibration_frames import DEMO_FEATURES, make_calibration_frames
from eldata.noise import CameraProfile
from tests.cases import in_one_test
from tests.shared import there

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from eldata.calibration import Calibration

ISOS = (100, 400, 1600)
SMALL = partial(make_calibration_frames, isos=ISOS, bias_frames=6, flat_levels=4, size=(256, 384))


def page(found: Calibration) -> str:
    """In place of the real page, which takes seconds and has its own tests."""
    return f'<!DOCTYPE html><meta name="generator" content="eldata calibration">{found.camera}\n{found.format_text()}'


@pytest.fixture(scope="module", autouse=True)
def small() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(eldata.demo.calibration, "make_calibration_frames", SMALL)
        patch.setattr(eldata.demo.calibration, "calibration_page", page)
        patch.setattr("eldata.reports.calibration.calibration_page", page)
        yield


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Calibration, str]:
    """Folder, result, and what was printed; over an earlier demo of another kind."""
    folder = tmp_path_factory.mktemp("demo")
    (folder / ".eldata-demo").write_text("x")
    (folder / "data" / "ELD-demo").mkdir(parents=True)
    with pytest.MonkeyPatch.context() as patch:
        lines: list[str] = []
        patch.setattr("builtins.print", lambda *words, **_: lines.append(" ".join(map(str, words))))
        found = run_calibration_demo(folder)
    return folder, found, "\n".join(lines)


def test_what_it_leaves(demo: tuple[Path, Calibration, str]) -> None:
    folder, found, _ = demo
    assert len(list((folder / "data").rglob("*.dng"))) == 3 * (6 + 8)
    assert CameraProfile.load(folder / "DemoGamma.json") == found.profile
    assert (folder / "calibration.html").read_text(encoding="utf-8") == page(found)
    assert not list(folder.rglob("*.part"))
    assert [path.name for path in (folder / "data").iterdir()] == ["calibration"], "nothing is left of the earlier one"


def test_what_it_prints(demo: tuple[Path, Calibration, str]) -> None:
    folder, found, out = demo
    for words in (
        "42 raw files (DNG), bias and flat-field frames of DemoGamma",
        f"$ eldata calibrate {folder / 'data' / 'calibration'} --camera DemoGamma -o {folder / 'DemoGamma.json'}",
        found.format_text(),
        compare_with_truth(found, json.loads((folder / "truth.json").read_text())),
        str(folder / "calibration.html"),
    ):
        assert words in out


def test_the_command_that_it_names_gives_the_same(demo: tuple[Path, Calibration, str], tmp_path: Path) -> None:
    """Its own line, with another target."""
    folder, found, out = demo
    line = there(re.search(r"^\$ eldata (.*)$", out, re.MULTILINE))
    arguments = line[1].replace(str(folder / "DemoGamma.json"), str(tmp_path / "p.json")).split()
    arguments[arguments.index("--html") + 1] = str(tmp_path / "r.html")
    assert main(arguments) == 0
    assert CameraProfile.load(tmp_path / "p.json") == found.profile
    assert (tmp_path / "r.html").read_bytes() == (folder / "calibration.html").read_bytes()


def test_the_table_of_errors_is_found_less_true(demo: tuple[Path, Calibration, str]) -> None:
    folder, found, _ = demo
    truth = json.loads((folder / "truth.json").read_text())
    header, _, *rows = (re.split(r"  +", line.strip()) for line in compare_with_truth(found, truth).splitlines())
    assert header == ["ISO", "K [%]", "lambda", "sigma_TL [%]", "sigma_G [%]", "sigma_row [%]", "colour bias [DN]"]
    assert len(rows) == 3
    for row, one, true in zip(rows, found.isos, truth["isos"], strict=True):
        assert one.transfer is not None
        read, lines = one.read, one.rows.rows
        assert read is not None
        assert row[0] == f"{true['iso']}"
        for cell, value, known, error in (
            (row[1], one.transfer.gain_dn_per_e, true["gain_dn_per_e"], one.transfer.gain_error),
            (row[3], read.sigma_tl_dn, true["sigma_tl_dn"], read.sigma_tl_error_dn),
            (row[4], read.sigma_gauss_dn, true["sigma_gauss_dn"], read.sigma_gauss_error_dn),
            (row[5], lines.sigma_dn, true["sigma_row_dn"], lines.sigma_error_dn),
        ):
            percent, errors = map(float, re.fullmatch(r"(\S+) \((\S+)\)", cell).groups())  # type: ignore[union-attr] # it is one
            assert percent == pytest.approx(100 * (value - known) / known, abs=0.006)
            assert errors == pytest.approx((value - known) / error, abs=0.06)
            assert abs(errors) < 5
        shape, errors = map(float, re.fullmatch(r"(\S+) \((\S+)\)", row[2]).groups())  # type: ignore[union-attr] # it is one
        assert shape == pytest.approx(read.tukey_lambda - true["tukey_lambda"], abs=6e-5)
        assert errors == pytest.approx((read.tukey_lambda - true["tukey_lambda"]) / read.tukey_lambda_error, abs=0.06)
        offsets = zip(one.bias.bias_dn, true["colour_bias_with_pattern_dn"], strict=True)
        largest = max((value - known for value, known in offsets), key=abs)
        assert float(row[6]) == pytest.approx(largest, abs=6e-4)


OFF = {
    "shading": {"bias_shading_dn": 0.0, "vignetting": 0.0},
    "hot-pixels": {"hot_share": 0.0},
    "fixed-pattern": {"prnu": 0.0, "dsnu_dn": 0.0, "column_pattern_dn": 0.0},
}


@in_one_test("without", [["shading"], ["hot-pixels"], ["fixed-pattern"], list(OFF)])
def test_without(without: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each option switches off what its name says, and no more."""
    asked: list[FixedFeatures] = []
    monkeypatch.setattr(
        eldata.demo.calibration, "run_calibration_demo", lambda *_, features, **__: asked.append(features)
    )
    options = [word for name in without for word in ("--without", name)]
    assert main(["demo", str(tmp_path / "x"), "--calibration", *options]) == 0
    off = {field: value for name in without for field, value in OFF[name].items()}
    assert asked == [replace(DEMO_FEATURES, **off)]
    if len(without) == len(OFF):
        assert asked == [FixedFeatures()]


def test_wrong_usage(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demo", str(tmp_path / "x"), "--without", "shading"]) == 2
    assert "give --calibration too" in capsys.readouterr().err
    assert main(["demo", str(tmp_path / "x"), "--calibration", "--without", "noise"]) == 2
    assert main(["demo", str(tmp_path / "x"), "--calibration", "--beside", "dct"]) == 2
    assert main(["demo", str(tmp_path / "x"), "--calibration", "--seed", "-1"]) == 2
    assert main(["demo", str(tmp_path / "x"), "--calibration", "--scenes", "2"]) == 2
    assert "leave it out with --calibration" in capsys.readouterr().err
    assert not (tmp_path / "x").exists()
