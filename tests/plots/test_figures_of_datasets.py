"""Datasets draw their items as they are given, and show in a notebook what they are."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from eldata import CalibrationFrames, DRVDataset, ELDDataset, PackedStore, SyntheticPairs
from eldata.datasets import Arrays
from eldata.datasets.items import describe_sample
from eldata.errors import EldataError
from eldata.isp.rendering import brightening, preview
from eldata.plots.pictures import side_by_side
from eldata.raw import read_raw
from tests.calibration.trees import CAMERA, made_tree
from tests.drv_tree import small_drv
from tests.plots.test_figures_of_results import assert_one_line, assert_shows_in_a_notebook
from tests.reports.pages import HOSTILE, checked
from tests.sources.store.helpers import pack_tree
from tests.trees import copy_tree

if TYPE_CHECKING:
    from pathlib import Path

    from tests.trees import Tree


@pytest.fixture(scope="module")
def eld(pristine: Tree) -> ELDDataset:
    return ELDDataset(pristine.data, manifest=pristine.csv)


def images_of(figure: Figure) -> list[Any]:
    """The array of each picture, as matplotlib holds it."""
    return [image.get_array() for axes in figure.axes for image in axes.images]


def titles_of(figure: Figure) -> list[str]:
    return [axes.get_title() for axes in figure.axes if axes.images]


def test_a_pair_is_drawn_as_it_is_given(eld: ELDDataset, pristine: Tree) -> None:
    index = 1
    sample, record = eld[index], eld.records[index]
    figure = eld.plot(index)
    assert isinstance(figure, Figure)
    assert figure.get_suptitle().splitlines() == [
        f"{record.camera}, {record.scene}, ISO {sample['iso']:g}, ×{sample['ratio']:g}",
        record.path,
    ]
    noisy, clean, error = images_of(figure)
    sensor = read_raw(pristine.data / record.reference).sensor
    # One stretch for both sides, found on the target; colours are the reference's.
    brighter = brightening(sample["target"].numpy())
    assert brighter > 1
    np.testing.assert_array_equal(noisy, preview(sample["input"].numpy() * brighter, sensor))
    np.testing.assert_array_equal(clean, preview(sample["target"].numpy() * brighter, sensor))
    expected = (sample["input"] - sample["target"]).abs().mean(0).numpy()
    np.testing.assert_allclose(error, expected, rtol=1e-6)
    more = f", {brighter:g} times as bright"
    ours = [f"input ×{sample['ratio']:g}{more}", f"target{more}", "absolute error, mean of channels"]
    assert titles_of(figure) == ours
    scale = figure.axes[2].images[0]
    assert scale.get_clim() == pytest.approx(np.quantile(expected, (0.002, 0.998)), rel=1e-6)


def test_a_store_draws_its_crop(pristine: Tree, tmp_path: Path) -> None:
    packed = PackedStore(pack_tree(pristine, tmp_path / "eld.h5").store, crop=16, crops_per_frame=2, seed=3)
    noisy, clean, _ = images_of(packed.plot(5))
    assert noisy.shape == clean.shape == (16, 16, 3)
    sample = packed[5]
    shown = preview(sample["target"].numpy() * brightening(sample["target"].numpy()), packed._seen(5)[1])
    np.testing.assert_array_equal(clean, shown)
    assert_shows_in_a_notebook(packed, "PackedStore", "eld.h5", "crop=16, augment=True")


def test_arrays_are_shown_in_the_cameras_own_colours() -> None:
    values = np.random.default_rng(1).uniform(0.5, 0.9, (2, 4, 8, 10)).astype(np.float32)
    pairs = SyntheticPairs(Arrays(values, range_dn=15871.0), "SonyA7S2", crop=None, augment=False, ratio=1.0)
    figure = pairs.plot(1)
    clean = images_of(figure)[1]
    np.testing.assert_array_equal(clean, preview(values[1], None))
    assert titles_of(figure)[0] == "input"  # neither amplified nor brighter
    assert figure.get_suptitle().startswith("SonyA7S2")


def test_a_clip_shows_its_first_frame(tmp_path: Path) -> None:
    drv = small_drv(tmp_path, ["0007"], 6)
    clips = DRVDataset(drv.data, manifest=drv.csv, window=3)
    sample = clips[1]
    figure = clips.plot(1)
    noisy, clean, error = images_of(figure)
    brighter = brightening(sample["target"].numpy())
    for shown, values in ((noisy, sample["input"][0]), (clean, sample["target"])):
        expected = np.rint(np.clip(values.numpy() * brighter, 0, 1) * 255).astype(np.uint8).transpose(1, 2, 0)
        np.testing.assert_array_equal(shown, expected)
    np.testing.assert_allclose(error, (sample["input"][0] - sample["target"]).abs().mean(0), rtol=1e-6)
    assert f"frame {sample['start']}" in figure.get_suptitle()
    assert_shows_in_a_notebook(clips, "1 clips", "frame 0")


def test_calibration_frames_are_drawn_in_dn(tmp_path: Path) -> None:
    made = made_tree(tmp_path, isos=(100,), bias_frames=1, flat_levels=2, size=(48, 64))
    frames = CalibrationFrames(made.root, CAMERA)
    index = len(frames) - 1
    figure = frames.plot(index)
    sample = frames[index]
    np.testing.assert_array_equal(images_of(figure)[0], sample["mosaic"])
    assert titles_of(figure) == ["mosaic [DN]"]
    assert figure.get_suptitle().startswith(f"{frames.camera}, flat, ISO {sample['iso']:g}")
    assert_shows_in_a_notebook(frames, f"CalibrationFrames of {frames.camera}", "flat")
    assert_one_line(frames, "CalibrationFrames(")


# --- in a notebook ------------------------------------------------------------------------------------------------


def test_a_dataset_in_a_notebook(eld: ELDDataset) -> None:
    assert_one_line(eld, "ELDDataset(")
    assert_shows_in_a_notebook(
        eld, "ELDDataset", f"{len(eld.records)} of", "DemoAlpha, DemoBeta", "first item: DemoAlpha"
    )
    page = checked(eld._repr_html_())
    assert len(page.all("img")) == 2
    assert sum(len(picture["src"]) for picture in page.all("img")) < 40_000


def test_what_cannot_be_read_is_said(tree: Tree) -> None:
    eld = ELDDataset(tree.data, manifest=tree.csv)
    (tree.data / eld.records[0].path).unlink()
    html = eld._repr_html_()
    page = checked(html)
    assert page.all("img") == []
    assert "the first item cannot be shown: " in page.text
    assert eld.records[0].path.rpartition("/")[2] in page.text
    with pytest.raises(EldataError):
        eld.plot(0)


def test_hostile_names_of_folders_stay_text(pristine: Tree, tmp_path: Path) -> None:
    own = copy_tree(pristine, tmp_path / HOSTILE.replace("/", "|"))
    eld = ELDDataset(own.data, manifest=own.csv)
    assert_shows_in_a_notebook(eld, HOSTILE.replace("/", "|")[:20])
    title = describe_sample(eld[0] | {"camera": "$\\frac{$ 相机", "path": HOSTILE + "\x1b[2J"})
    figure = side_by_side(title, [("input", eld[0]["input"][0].numpy())])
    figure.draw_without_rendering()  # mathematics that cannot be set, and letters that the font lacks, are errors here
    assert "□" in figure.get_suptitle()
