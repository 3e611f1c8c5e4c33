"""Results, profiles, calibrations and datasets draw what they hold, print as one line, and show in a notebook."""

from __future__ import annotations

import re
import struct
import sys
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from eldata import CalibrationFrames, DRVDataset, ELDDataset, PackedStore, SyntheticPairs
from eldata.calibration.flats import PhotonTransferLine
from eldata.datasets import Arrays
from eldata.datasets.items import describe_sample
from eldata.errors import ArgumentError, EldataError
from eldata.evaluation.comparison import compare
from eldata.isp.rendering import brightening, preview
from eldata.noise import CameraProfile
from eldata.plots.axes import LIGHT, MARKERS
from eldata.plots.pictures import side_by_side
from eldata.protocols import PROTOCOLS
from eldata.raw import read_raw
from tests.calibration.trees import CAMERA, make_tree
from tests.drv_tree import small_drv
from tests.reports.calibrations import calibration, camera_at, measured
from tests.reports.evaluations import result
from tests.reports.pages import HOSTILE, checked
from tests.sources.store.helpers import pack_tree
from tests.trees import Tree, copy_tree

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.axes import Axes

    from eldata.calibration.results import Calibration


# Colours of the page's own, and greys that show on white and on black.
_COLOURS = {"inherit", "none"}


def assert_one_line(shown: object, part: str) -> None:
    text = repr(shown)
    assert part in text
    assert "\n" not in text
    assert text.isprintable()


def assert_shows_in_a_notebook(shown: Any, *parts: str) -> None:
    """Well-formed, without script, style sheet or address, readable on a dark page; it says these texts."""
    html = shown._repr_html_()
    page = checked(html)
    for part in parts:
        assert part in page.text, part
    assert {tag for tag, _ in page.elements} <= {
        *("div", "p", "b", "table", "thead", "tbody", "tr", "th", "td", "figure", "img", "figcaption")
    }
    for tag, attributes in page.elements:
        assert set(attributes) <= ({"src", "alt"} if tag == "img" else {"style"}), tag
        for colour in re.findall(r"(?:^|; )(?:color|background): ([^;]+)", attributes.get("style", "")):
            assert colour in _COLOURS
    for picture in page.all("img"):
        assert picture["alt"]
        assert picture["src"].startswith("data:image/jpeg;base64,")
        assert len(picture["src"]) < 30_000
    assert page.text.replace("\n", " ").isprintable()


def points_of(axes: Axes) -> list[tuple[float, float]]:
    """What is drawn as points, in data units, the bars of errors left out."""
    lines = [line for line in axes.lines if line.get_linestyle() == "None" and line.get_marker() in MARKERS]
    return [(float(x), float(y)) for line in lines for x, y in np.asarray(line.get_xydata())]


def bars_of(axes: Axes) -> list[tuple[list[float], list[float]]]:
    """What is drawn as lines of the ink's colour: means and their intervals."""
    lines = [line for line in axes.lines if line.get_color() == LIGHT.ink and line.get_linestyle() == "-"]
    return [(np.asarray(line.get_xdata()).tolist(), np.asarray(line.get_ydata()).tolist()) for line in lines]


def shown_png(figure: Any) -> tuple[int, int]:
    png = figure._repr_png_()
    assert png.startswith(b"\x89PNG")
    width, height = struct.unpack(">II", png[16:24])
    return width, height


# --- an evaluation ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("metric", ["psnr_db", "ssim"])
def test_every_score_and_every_mean_of_the_table_is_drawn(metric: str) -> None:
    scored = result(cameras=("SonyA7S2", "NikonD850"), scenes=8)
    figure = scored.plot(metric)
    assert isinstance(figure, Figure)
    (axes,) = figure.axes
    assert axes.get_title() == "eld, protocol eld"
    assert axes.get_ylabel() == {"psnr_db": "PSNR [dB]", "ssim": "SSIM"}[metric]
    assert [label.get_text() for label in axes.get_xticklabels()] == ["SonyA7S2", "NikonD850", "all"]
    legend = axes.get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == ["×100", "×200"]
    # Each score twice: in its camera's column, and in that of all.
    drawn = sorted(y for _, y in points_of(axes))
    assert drawn == sorted(2 * [score.values[metric] for score in scored.scores])
    rows = [row for row in scored.table if row.ratio is not None]
    means = sorted(ys[0] for _, ys in bars_of(axes) if ys[0] == ys[1])
    assert means == pytest.approx(sorted(row.values[metric] for row in rows), rel=1e-12)
    intervals = sorted((min(ys), max(ys)) for _, ys in bars_of(axes) if ys[0] != ys[1])
    assert intervals == sorted(scored.interval(row, metric).ends[1:] for row in rows)


def test_a_result_without_factors_has_a_column_for_each_camera() -> None:
    scored = result(scenes=2)
    scored = replace(
        scored,
        scores=tuple(replace(score, ratio=None) for score in scored.scores),
        table=tuple(replace(row, ratio=None) for row in scored.table if row.ratio is None),
    )
    (axes,) = scored.plot().axes
    assert [label.get_text() for label in axes.get_xticklabels()] == ["all"]
    assert axes.get_legend() is None
    assert len(points_of(axes)) == len(scored.scores)
    assert [ys for _, ys in bars_of(axes)] == [[pytest.approx(scored.psnr_db)] * 2]  # too few scenes for an interval


def test_infinite_scores_are_left_out() -> None:
    scored = result(scenes=2)
    perfect = replace(scored.scores[0], values=scored.scores[0].values | {"psnr_db": float("inf")})
    partly = replace(scored, scores=(perfect, *scored.scores[1:]))
    assert len(points_of(partly.plot().axes[0])) == 2 * (len(scored.scores) - 1)
    with pytest.raises(ArgumentError, match="nothing to draw of psnr_db of this result: nothing was scored"):
        replace(scored, scores=()).plot()
    with pytest.raises(ArgumentError, match="no score is finite"):
        replace(scored, scores=(perfect,)).plot()
    with pytest.raises(ArgumentError, match=r"psnr_db.*ssim"):
        scored.plot("psnr")


def test_a_comparison_in_one_line_and_in_a_notebook() -> None:
    compared = compare({"a": result(), "b": result(method=1, gain_db=0.5), "c": result(method=2)})
    assert_one_line(compared, "Comparison(96 common images; PSNR a ")
    assert_shows_in_a_notebook(compared, "3 methods on 96 common images", "a dB", "c SSIM")


# --- in words -----------------------------------------------------------------------------------------------------


def test_a_result_in_one_line_and_in_a_notebook() -> None:
    scored = result(scenes=2)
    assert_one_line(scored, f"EvaluationResult(eld, protocol eld ({scored.digest[:15]}): 24 of 24 pairs")
    assert f"PSNR [dB] {scored.psnr_db:.2f}, SSIM {scored.ssim:.3f})" in repr(scored)
    assert_shows_in_a_notebook(scored, "eld 1.0, protocol eld", f"{scored.psnr_db:.2f}", "SonyA7S2")
    assert_one_line(replace(scored, scores=()), "nothing was scored)")
    assert_shows_in_a_notebook(replace(scored, scores=()), "0 of 24 pairs")


def test_hostile_names_stay_text() -> None:
    scored = result(cameras=(HOSTILE, "$\\frac{$ 相机"), scenes=2, dataset=HOSTILE)
    for shown in (scored, compare({HOSTILE: scored, "b\n$x$": scored})):
        assert_one_line(shown, "")
        assert_shows_in_a_notebook(shown, HOSTILE)
    assert scored.plot().axes  # and neither mathematics nor a letter that the font lacks
    profile = replace(CameraProfile.load("SonyA7S2"), camera=HOSTILE + "$\\frac{$", source="\x1b" + HOSTILE)
    assert_one_line(profile, "CameraProfile(")
    assert_shows_in_a_notebook(profile, HOSTILE)
    assert shown_png(profile.plot("TL"))


@pytest.mark.parametrize("name", PROTOCOLS)
def test_every_protocol_in_one_line_and_in_a_notebook(name: str) -> None:
    protocol = PROTOCOLS[name]
    assert_one_line(protocol, f"{type(protocol).__name__}({name!r}, ")
    assert len(repr(protocol)) < 200
    assert_shows_in_a_notebook(protocol, protocol.title, protocol.digest)


# --- a profile ----------------------------------------------------------------------------------------------------


def test_a_profile_draws_its_lines_and_rows() -> None:
    profile = CameraProfile.load("SonyA7S2")
    figure = profile.plot()
    (mode,) = profile.gain_modes
    for axes, title, field, fit in (
        (figure.axes[0], "read noise, Tukey lambda", "sigma_tl_dn", mode.tukey_lambda_fit),
        (figure.axes[1], "read noise, Gaussian", "sigma_gauss_dn", mode.gauss_fit),
        (figure.axes[2], "row noise", "sigma_row_dn", mode.row_fit),
    ):
        assert fit is not None
        assert axes.get_title() == title
        assert (axes.get_xscale(), axes.get_yscale(), axes.get_xlabel()) == ("log", "log", "K [DN/e⁻]")
        rows = [(row.gain_dn_per_e, getattr(row, field)) for row in profile.rows]
        assert sorted(points_of(axes)) == sorted((k, s) for k, s in rows if k is not None and s)
        (line,) = [line for line in axes.lines if line.get_label() == "fit, ±1σ, ±2σ"]
        ends = np.asarray(line.get_xdata()), np.asarray(line.get_ydata())
        np.testing.assert_allclose(np.log(ends[1]), fit.slope * np.log(ends[0]) + fit.intercept, rtol=1e-12)
        assert len(axes.collections) >= 2  # bands of one and two deviations
    assert_one_line(profile, "CameraProfile('SonyA7S2', 18 rows, K 0.09392 to 6.011 DN/e-)")
    assert_shows_in_a_notebook(profile, "Camera profile of SonyA7S2", "bias G2 [DN]", "25600")
    assert "σ row" not in profile._repr_html_()  # of which no row says anything
    assert_shows_in_a_notebook(CameraProfile.load("SonyA7S2-PMN"), "σ row [DN]")


def test_one_sigma_of_a_profile() -> None:
    profile = CameraProfile.load("NikonD850")
    axes = Figure().subplots()
    assert profile.plot("row", ax=axes) is axes.figure
    assert axes.get_ylabel() == r"$\sigma_\mathrm{row}$ [DN]"
    with pytest.raises(ArgumentError, match="give sigma, one of TL, G, row"):
        profile.plot(ax=axes)
    with pytest.raises(ArgumentError, match="sigma"):
        profile.plot("read")  # type: ignore[arg-type]


# --- a calibration ------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def found() -> Calibration:
    """Four ISOs of small frames, one of them without flats."""
    levels = {400.0: (800, 7000), 800.0: (), 1600.0: (800, 7000), 3200.0: (800, 7000)}
    return calibration([measured(iso, camera_at(iso), frames=4, levels=levels[iso]) for iso in levels])


def test_a_calibration_draws_what_it_found(found: Calibration) -> None:
    figure = found.plot()
    titles = [axes.get_title() for axes in figure.axes]
    assert titles == ["photon transfer, ISO 1600", "system gain", "read noise, TL", "read noise, G", "row noise"]
    transfer, gain, read, _, rows = figure.axes
    assert gain.get_xlabel() == "ISO"
    known = [(one.iso, one.gain.value) for one in found.isos if one.gain is not None]
    assert [iso for iso, _ in known] == [400, 1600, 3200]
    assert points_of(gain) == known
    given = [one for one in found.isos if one.gain is not None]
    assert points_of(read) == [(one.gain_dn_per_e, one.sigma_tl_dn.value) for one in given if one.sigma_tl_dn]
    assert points_of(rows) == [(one.gain_dn_per_e, one.sigma_row_dn.value) for one in given if one.sigma_row_dn]
    lines = found.isos[2].transfer
    assert lines is not None
    signals = [signal for line in lines.channels for signal in line.pooled(20)[0]]
    assert [x for x, _ in points_of(transfer)] == signals
    assert_one_line(found, "Calibration('TestCamera', ISO 400, 800, 1600, 3200; ")
    assert_shows_in_a_notebook(found, "Calibration of TestCamera", "sigma_TL [DN]")


def test_the_photon_transfer_of_an_iso(found: Calibration) -> None:
    axes = found.plot(iso=400).axes[0]
    assert axes.get_title() == "photon transfer, ISO 400"
    transfer = found.isos[0].transfer
    assert transfer is not None
    assert all(isinstance(line, PhotonTransferLine) for line in transfer.channels)
    fitted = [line for line in axes.lines if line.get_color() == LIGHT.theory]
    slopes = [np.diff(line.get_ydata())[0] / np.diff(line.get_xdata())[0] for line in fitted]
    assert slopes == pytest.approx([line.gain_dn_per_e for line in transfer.channels], rel=1e-9)
    with pytest.raises(ArgumentError, match="no photon transfer was measured at ISO 800; ISOs with one: 400, 1600, 32"):
        found.plot(iso=800)


def test_pooled_points_are_means_by_inverse_variances() -> None:
    """Of neighbours by signal, in whatever order the points come."""
    points = np.array([[30.0, 10.0, 20.0, 40.0], [7.0, 3.0, 5.0, 9.0], [0.5, 0.1, 0.2, 1.0]])
    signal, variance, error = PhotonTransferLine(0.2, 0.01, 1.0, 0.1, 1.0, *points).pooled(2)
    assert signal == pytest.approx([(100 * 10 + 25 * 20) / 125, (4 * 30 + 40) / 5], rel=1e-12)
    assert variance == pytest.approx([(100 * 3 + 25 * 5) / 125, (4 * 7 + 9) / 5], rel=1e-12)
    assert error == pytest.approx([125**-0.5, 5**-0.5], rel=1e-12)


# --- figures ------------------------------------------------------------------------------------------------------


def test_a_notebook_shows_a_figure_without_pyplot() -> None:
    pyplot = sys.modules.get("matplotlib.pyplot")
    before = [] if pyplot is None else pyplot.get_fignums()
    profile = CameraProfile.load("SonyA7S2")
    assert shown_png(profile.plot()) == (1320, 360)
    assert shown_png(result(scenes=2).plot()) == (440, 360)
    pyplot = sys.modules.get("matplotlib.pyplot")
    assert ([] if pyplot is None else pyplot.get_fignums()) == before


def test_the_settings_of_others_stay() -> None:
    import matplotlib as mpl

    with mpl.rc_context({"axes.edgecolor": "magenta", "font.size": 23.0}):
        before = dict(mpl.rcParams)
        figure = CameraProfile.load("SonyA7S2").plot("TL")
        assert dict(mpl.rcParams) == before
        assert figure.axes[0].spines["left"].get_edgecolor() != mpl.colors.to_rgba("magenta")
        assert figure.axes[0].yaxis.label.get_fontsize() == 10


# --- datasets draw their items as they are given ---------------------------------------------------------------------


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
    shown = preview(sample["target"].numpy() * brightening(sample["target"].numpy()), packed._read_to_show(5)[1])
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
    made = make_tree(tmp_path, isos=(100,), bias_frames=1, flat_levels=2, size=(48, 64))
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
    assert_shows_in_a_notebook(eld, "ELDDataset", f"{len(eld.records)} of", "DemoAlpha, DemoBeta", "first item: ")
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
