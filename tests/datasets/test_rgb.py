"""Pairs whose sides are rendered to sRGB: RGB2RGB, Raw2RGB and stages of one's own."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from eldata.datasets.base import PairDataset
from eldata.datasets.clean import Arrays, CleanFrames
from eldata.datasets.rgb import PairSensors, Rendered, StagedPairs, continuous, of_noisy, of_reference, raw2rgb, rgb2rgb
from eldata.datasets.synthetic.pairs import SyntheticPairs
from eldata.errors import ArgumentError, DatasetError
from eldata.isp.rendering import Gamma, Rendering, render_pair_for_scoring
from eldata.raw import read_raw, write_dng
from eldata.records import Sensor
from eldata.sources.frames import Frame
from tests.datasets.comparing import same
from tests.raw.helpers import make_sensor
from tests.sources.store.helpers import pack_folder
from tests.trees import Tree, copy_tree

CAMERA = "DemoAlpha"
NOISY_BALANCE = (1.3, 1.0, 2.6, 1.0)


@pytest.fixture(scope="module")
def balanced(pristine: Tree, tmp_path_factory: pytest.TempPathFactory) -> Tree:
    """A tree whose noisy frames have another white balance than their references."""
    tree = copy_tree(pristine, tmp_path_factory.mktemp("balanced"))
    for record in tree.manifest.records:
        if record.role == "noisy" and record.camera == CAMERA:
            path = tree.data / record.path
            raw = read_raw(path)
            write_dng(path, raw.mosaic, replace(raw.sensor, white_balance=NOISY_BALANCE), raw.exposure)
    return tree


def pairs_of(tree: Tree) -> PairDataset:
    return PairDataset(tree.data, tree.csv, cameras=[CAMERA], ratios=[100])


def sensors_of(tree: Tree, sample: Mapping[str, Any]) -> tuple[Sensor, Sensor]:
    """Of a sample's files, read anew."""
    noisy, reference = (read_raw(tree.data / sample[name]).sensor for name in ("path", "reference"))
    return noisy, reference


def eight_bit(image: torch.Tensor) -> torch.Tensor:
    """As the published code: cut down to whole codes, then a share of 255."""
    return (image * 255).int().clamp(0, 255).float() / 255


def test_raw2rgb_renders_the_target_alone(balanced: Tree) -> None:
    pairs = pairs_of(balanced)
    staged = raw2rgb(pairs)
    assert len(staged) == len(pairs) > 1
    for plain, sample in zip(pairs, staged, strict=True):
        _, reference = sensors_of(balanced, plain)
        assert torch.equal(sample["input"], plain["input"])
        assert sample["target"].shape == (3, *plain["target"].shape[1:])
        assert torch.equal(sample["target"], eight_bit(Rendering.of(reference)(plain["target"])))
        rest = set(plain) - {"input", "target"}
        same(*({name: value for name, value in side.items() if name in rest} for side in (sample, plain)))
    assert "stage_in=keep_raw" in repr(staged)
    assert "stage_out=Rendered(of_reference, Gamma(exponent=2.2), eight_bits)" in repr(staged)  # so in each process


def test_the_target_is_what_predictions_are_scored_against(balanced: Tree) -> None:
    """Raw2Raw + ISP, RGB2RGB and Raw2RGB are compared on one picture."""
    plain = pairs_of(balanced)[0]
    _, reference = sensors_of(balanced, plain)
    scored = render_pair_for_scoring(plain["input"].numpy(), plain["target"].numpy(), reference)[1]
    codes = (raw2rgb(pairs_of(balanced))[0]["target"] * 255).round().numpy()
    # float32 here, float64 there: a value within rounding of a whole code may differ by one.
    assert np.abs(codes - scored).max() <= 1
    assert (codes != scored).mean() < 1e-3


@pytest.mark.parametrize("colours", [of_noisy, of_reference])
def test_rgb2rgb_renders_both(colours: Any, balanced: Tree) -> None:
    pairs = pairs_of(balanced)
    plain, sample = pairs[0], rgb2rgb(pairs, input_colours=colours)[0]
    noisy, reference = sensors_of(balanced, plain)
    assert noisy.white_balance == NOISY_BALANCE != reference.white_balance
    chosen = {of_noisy: noisy, of_reference: reference}[colours]
    assert torch.equal(sample["input"], eight_bit(Rendering.of(chosen)(plain["input"])))
    assert torch.equal(sample["target"], eight_bit(Rendering.of(reference)(plain["target"])))
    linear = Rendered(of_reference, Gamma(1), continuous)
    own = StagedPairs(pairs, stage_in=lambda image, _: image * 2, stage_out=linear)[0]
    assert torch.equal(own["input"], plain["input"] * 2)
    assert torch.equal(own["target"], Rendering.of(reference, Gamma(1))(plain["target"]))


# --- stores and synthetic noise -----------------------------------------------------------------------------------


def test_synthetic_pairs_have_their_clean_files_colours(pristine: Tree, tmp_path: Path) -> None:
    (tmp_path / "clean").mkdir()
    clean = Path(shutil.copy(pristine.file(1), tmp_path / "clean"))
    sensor = read_raw(clean).sensor
    for source in (CleanFrames(clean.parent), CleanFrames(pack_folder(clean.parent, tmp_path / "clean.h5").store)):
        pairs = SyntheticPairs(source, "SonyA7S2", crop=16, seed=3)
        pairs.set_epoch(0)
        plain, sample = pairs[0], rgb2rgb(pairs)[0]
        for side in ("input", "target"):
            assert torch.equal(sample[side], eight_bit(Rendering.of(sensor)(plain[side])))
        assert sample["gain_dn_per_e"] == plain["gain_dn_per_e"]


def test_arrays_need_a_sensor_from_the_caller() -> None:
    pairs = SyntheticPairs(Arrays([np.full((4, 32, 32), 0.3)], range_dn=15000), "SonyA7S2", crop=16)
    with pytest.raises(ArgumentError, match=r"sensors of SyntheticPairs are not known; give sensors="):
        rgb2rgb(pairs)
    sample = rgb2rgb(pairs, sensors=lambda _: PairSensors(make_sensor(), make_sensor()))[0]
    assert sample["input"].shape == (3, 16, 16)


# --- refusals -----------------------------------------------------------------------------------------------------


def test_what_has_no_epochs_or_sensor_is_refused(pristine: Tree) -> None:
    with pytest.raises(ArgumentError, match="list has no epochs"):
        raw2rgb([], sensors=lambda _: PairSensors(make_sensor(), make_sensor())).set_epoch(0)  # type: ignore[arg-type]
    staged = raw2rgb(pairs_of(pristine))
    staged.sensors.source.frame = lambda path: Frame.of_rgb(np.zeros((3, 2, 2), np.uint16), path)  # type: ignore[attr-defined]
    with pytest.raises(DatasetError, match="is not a raw file, whose sensor a stage needs"):
        staged[0]
