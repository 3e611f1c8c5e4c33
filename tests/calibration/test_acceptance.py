"""The acceptance test of noise models: the camera's own frames pass, and what a model lacks is missed by name.

Frames are those of the simulated camera and of faults planted in them, which share no code with the model. A statistic
is off beyond 4 standard errors: by Student's law with 15 degrees of freedom (16 pairs of a model), that is 0.12 % of
those that should pass. The seeds are fixed.
"""

from __future__ import annotations

import json
import math
from concurrent.futures import ThreadPoolExecutor
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from eldata.calibration.acceptance.comparison import check_noise
from eldata.calibration.acceptance.results import FrameStatistic
from eldata.calibration.frames import FramesError
from eldata.cli.main import main
from eldata.errors import ArgumentError
from eldata.examples.check_noise_model import Adapter, GaussianNetwork
from eldata.noise import CameraProfile, NoiseModel
from eldata.noise.gain_modes import LogLogFit, ProfileRow
from tests.calibration.faults import drift, telegraph
from tests.calibration.judged import Specimen, judged, truth
from tests.calibration.simulation import XTRANS, Camera
from tests.calibration.trees import CAMERA, FrameTree, made_tree

if TYPE_CHECKING:
    from pathlib import Path

    from eldata.calibration.acceptance.results import IsoAcceptance

PATTERNED = Camera(shape=(192, 288))
PLAIN = PATTERNED.with_(dsnu=0.0, column_pattern=0.0, hot_share=0.0, prnu=0.0)


def missed(found: IsoAcceptance) -> set[str]:
    """The checks that are missed, flats as one."""
    return {check.split(" of ")[0] if check.startswith("flats") else check for check in found.missed}


def symbols(found: IsoAcceptance, check: str) -> set[str]:
    return {one.symbol for one in found.off if one.check == check}


def test_the_cameras_own_further_frames_pass_with_all_their_faults() -> None:
    """Fixed pattern, hot pixels, drift of rows: 43 verdicts."""
    specimen = Specimen(PATTERNED, drift(1.0), seed=3)
    found = judged(specimen, specimen, flats=(3000.0,), pairs=16)
    assert found.off == ()
    assert len(found.statistics) > 35
    assert {one.held_out for one in found.statistics} == {4, 2, 1}
    assert {one.simulated for one in found.statistics} == {16, 8}


def test_the_papers_model_passes_where_its_assumptions_hold() -> None:
    """At the true parameters, and U is the real rounding."""
    assert judged(NoiseModel(), Specimen(PLAIN), flats=(60.0, 3000.0), pairs=16).off == ()


def test_what_simple_models_miss() -> None:
    specimen = Specimen(PLAIN)
    found = judged(NoiseModel("P+G"), specimen, flats=(60.0,), pairs=16)
    assert {"level", "difference of two", "rows"} <= missed(found)
    assert "fixed pattern" not in missed(found)
    assert any(symbol.startswith("share beyond") for symbol in symbols(found, "difference of two"))
    found = judged(NoiseModel("P*+G*+B"), specimen, pairs=16)
    assert "rows" in missed(found)
    assert "fixed pattern" not in missed(found)


def test_what_the_papers_model_misses() -> None:
    paper = NoiseModel()
    assert {"fixed pattern", "one frame"} <= missed(judged(paper, Specimen(PATTERNED), pairs=16))
    assert symbols(judged(paper, Specimen(PLAIN, drift(2.0)), pairs=16), "rows") >= {"spectrum, low frequencies"}
    jumping = judged(paper, Specimen(PLAIN, telegraph(0.01, 10.0)), pairs=16)
    assert {"pixels", "difference of two"} <= missed(jumping)


def test_another_specimens_pattern_has_the_energy_and_not_the_places() -> None:
    found = judged(Specimen(PATTERNED, seed=1), Specimen(PATTERNED, seed=2), pairs=16)
    assert "energy in common with the model's" in symbols(found, "fixed pattern")


def test_whole_frames_for_a_model_that_knows_the_places(monkeypatch: pytest.MonkeyPatch) -> None:
    """The middle is compared: given that piece alone, the model's own pattern would lie elsewhere (and not fit)."""
    monkeypatch.setattr(import_module("eldata.calibration.reproduction"), "_SIDE", 128)
    specimen = Specimen(PATTERNED)
    found = judged(specimen, specimen, flats=(2000.0,), pairs=16, whole_frames=True)
    assert found.shape == (128, 128)
    assert found.off == ()


def test_xtrans() -> None:
    camera = PLAIN.with_(cfa=XTRANS, bias=(1.5, -0.75, 0.5))
    own = Specimen(camera)

    def model(clean: Any, **options: Any) -> Any:
        return own(clean, **options)

    parameters = truth(camera.with_(bias=(1.5, -0.75, 0.5, -0.75)))
    assert judged(model, own, parameters=parameters, pairs=16).off == ()
    assert judged(NoiseModel(), own, parameters=parameters, pairs=16).off == ()


def test_the_law_of_the_verdicts() -> None:
    """4000 normal statistics of 1 and 16 pairs: 0.12 % beyond 4 s.e.; 18 of them or more come once in 1e6 tries."""
    generator = np.random.default_rng(5)
    for held_out in (1, 5):
        draws = generator.normal(7.0, 0.1, (4000, held_out + 16)).tolist()
        off = sum(FrameStatistic.of(("", "", ""), draw[:held_out], draw[held_out:]).verdict == "off" for draw in draws)
        assert off < 18, held_out
    # The camera's own wandering counts: its means scatter by 1 where the model's do not.
    wandering = FrameStatistic.of(("", "", ""), [0.0, 2.0, -1.0, 1.0], [0.5 + 1e-6 * i for i in range(16)])
    assert wandering.verdict == "ok"
    assert wandering.standard_error == pytest.approx(np.std([0, 2, -1, 1], ddof=1) * math.sqrt(1 / 4 + 1 / 16))


def test_other_units_and_clips_are_named() -> None:
    specimen = Specimen(PLAIN)

    def changed(change: Any) -> Any:
        def model(clean: Any, **options: Any) -> Any:
            return change(np.asarray(specimen(clean, **options)))

        return model

    range_dn = PLAIN.white - PLAIN.black
    for model, words in (
        (changed(lambda y: y * np.float32(range_dn)), r"times that of the held-out .* values are DN .*over 15871 DN"),
        (changed(lambda y: y / np.float32(range_dn)), "divided by the range"),
        (changed(lambda y: np.maximum(y, 0)), "clips at black: .* of its values .* exactly 0"),
        (NoiseModel(clip="both"), "clips at black"),
        (changed(lambda y: y * np.float32("nan")), "not finite"),
    ):
        with pytest.raises(ArgumentError, match=words):
            judged(model, specimen, pairs=16)


# --- files --------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def pristine(tmp_path_factory: pytest.TempPathFactory) -> FrameTree:
    """Two ISOs, four bias frames and two pairs of flats each. Not to be changed."""
    return made_tree(
        tmp_path_factory.mktemp("held-out") / "tree", isos=(100, 400), bias_frames=4, flat_levels=2, size=(192, 288)
    )


def profile(**changes: Any) -> CameraProfile:
    """As of the tree's camera, measured at ISO 100."""
    fit = LogLogFit(0.5, 0.0, 0.0)
    row = ProfileRow(0.1, (0.0, 0.0, 0.0, 0.0), 100.0, 0.1, 1.0, 1.5, 0.3)
    return CameraProfile(
        changes.pop("camera", CAMERA), "a test", (0.1, 0.1), fit, fit, fit, (row,), (100.0, 100.0), **changes
    )


def test_files_levels_and_what_is_missing(pristine: FrameTree, tmp_path: Path) -> None:
    frames = pristine.frames(isos=[100])
    with pytest.raises(ArgumentError, match="states a black level of 64 DN, and the held-out frames of ISO 100 512 DN"):
        check_noise(NoiseModel(), frames, profile(black_level_dn=64.0, white_level_dn=16383.0))
    with pytest.raises(ArgumentError, match="parameters are of one ISO"):
        check_noise(NoiseModel(), pristine.frames(), profile().measured(100))
    with pytest.raises(ArgumentError, match="no profile of the camera DemoGamma was given, only of Nobody's"):
        check_noise(NoiseModel(), frames, profile(camera="Nobody's"))
    with pytest.raises(ArgumentError, match="pairs must be"):
        check_noise(NoiseModel(), frames, profile(), pairs=2)
    few = pristine.copy(tmp_path / "few")
    for path in few.files("bias", 100)[1:]:
        path.unlink()
    with pytest.raises(FramesError, match="two held-out bias frames"):
        check_noise(NoiseModel(), few.frames(isos=[100]), profile())


def test_the_command(pristine: FrameTree, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Table, JSON, page and exit code, on files; the numbers do not depend on who works."""
    made, page, numbers = (tmp_path / name for name in ("nobody.json", "page.html", "found.json"))
    profile().save(made)
    options = ["--iso", "100", "--pairs", "16", "--jobs", "2", "--html", str(page), "--json", str(numbers)]
    assert main(["noise", "check", str(made), "--frames", str(pristine.root), *options]) == 1
    found = json.loads(numbers.read_text(encoding="utf-8"))
    (one,) = found["isos"]
    assert (one["iso"], one["bias_frames"], one["flat_frames"], one["parameters_as_measured"]) == (100, 4, 4, True)
    assert {"rows", "fixed pattern"} <= set(one["missed"])
    assert found["ok"] is False
    printed = capsys.readouterr().out
    assert "ISO 100: 4 bias frames and 4 flats held out, 192 x 288 pixels compared" in printed
    assert f"of {len(one['statistics'])} statistics off by more than 4 standard errors" in printed
    assert "Noise model against DemoGamma" in page.read_text(encoding="utf-8")
    with ThreadPoolExecutor(1) as executor:  # one thread, one ISO: the same numbers
        again = check_noise(NoiseModel(), pristine.frames(isos=[100]), profile(), pairs=16, workers=executor)
    assert json.loads(json.dumps(again.as_dict())) == found


def test_dark_frames_that_are_not_held_out(
    pristine: FrameTree, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """With frames of its own the command judges; those that the model has are refused."""
    made, numbers, own = tmp_path / "nobody.json", tmp_path / "found.json", pristine.copy(tmp_path / "own")
    profile(camera="Nobody's").save(made)
    held_out = pristine.copy(tmp_path / "held-out")
    for number, path in enumerate(sorted(own.files("bias", 100))):
        (path if number < 2 else next(one for one in held_out.files("bias", 100) if one.name == path.name)).unlink()
    command = ["noise", "check", str(made), "--frames", str(held_out.root), "--model", "P*+D", "--iso", "100"]
    assert main([*command, "--dark-frames", str(own.root)]) == 2
    assert "no profile of the camera DemoGamma was given, only of Nobody's" in capsys.readouterr().err
    command.append("--profile-of-another-camera")
    assert main([*command, "--pairs", "16", "--dark-frames", str(own.root), "--json", str(numbers)]) == 1
    found = json.loads(numbers.read_text(encoding="utf-8"))
    assert "rows" not in found["isos"][0]["missed"]  # which the paper's model of this profile misses, above
    assert found["model"].startswith("NoiseModel('P*+D', dark_frames=DarkFrames(")
    assert found["model"].endswith("), with the profile of Nobody's")
    assert found["model"] in capsys.readouterr().out
    assert main([*command, "--dark-frames", str(held_out.root)]) == 2
    assert "is in --frames and in --dark-frames; a model is judged by frames" in capsys.readouterr().err


def test_components_that_need_more_are_asked_for_in_the_commands_words(capsys: pytest.CaptureFixture[str]) -> None:
    check = ["noise", "check", "SonyA7S2", "--frames", "none"]
    synthesize = ["synthesize", "none", "-o", "none", "--camera", "SonyA7S2"]
    for command, words in (
        ([*check, "--model", "P*+D"], "component D takes real dark frames; give --dark-frames FOLDER|STORE"),
        ([*check, "--dark-frames", "bias"], "--dark-frames is for component D; name it in --model, as in 'P*+D'"),
        ([*check, "--model", "P*+S"], "component S takes a dark shading; give --dark-shading FILE"),
        ([*check, "--dark-shading", "s.npz"], "--dark-shading is for component S; name it in --model"),
        ([*check, "--model", "P*+S", "--dark-shading", "s.npz"], "s.npz: cannot be read: No such file"),
        ([*synthesize, "--model", "P*+D"], "component D takes real dark frames; give --dark-frames"),
        ([*synthesize, "--model", "P*+S"], "component S takes a dark shading; give --dark-shading FILE"),
        (
            [*synthesize, "--model", "P*+S", "--dark-shading", "s.npz"],
            "noise is made with the dark shading of one ISO; choose it with --iso",
        ),
    ):
        assert main(command) == 2
        assert words in capsys.readouterr().err


def test_the_example() -> None:
    """A torch model in its adapter: Gaussian noise of the true variance, and no rows."""
    found = judged(Adapter(GaussianNetwork()), Specimen(PLAIN), pairs=16)
    assert {"level", "difference of two", "rows"} <= missed(found)
    assert missed(found).isdisjoint({"columns", "neighbours", "fixed pattern"})
