"""A data set through denoisers and networks, from the command line to the score."""

from __future__ import annotations

import json
import pickle
import re
import shutil
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
import torch

from eldata.baselines.classical import BASELINES
from eldata.baselines.networks import load_network
from eldata.baselines.noisy_frames import NoisyFrame, find_parameters
from eldata.baselines.predicting import BaselineDenoiser, Denoiser, PredictionReport, write_predictions
from eldata.cli.baseline import NAMES
from eldata.cli.main import main
from eldata.datasets.published import ELDDataset
from eldata.demo.camera import CAMERAS
from eldata.demo.evaluation import known_profile
from eldata.errors import ArgumentError, EldataError, FileError
from eldata.evaluation.evaluate import evaluate
from eldata.evaluation.request import SETTINGS
from eldata.noise.profile import CameraProfile
from tests.bait import Bait
from tests.baselines.travelling import Travelling
from tests.onnx_file import onnx_network
from tests.trees import Tree


class Doubled(torch.nn.Module):
    """Keeps what it is given, less a learnt offset."""

    def __init__(self) -> None:
        super().__init__()
        self.offset = torch.nn.Parameter(torch.tensor(0.25))

    def forward(self, image: torch.Tensor) -> torch.Tensor:
        return 0.5 * image + self.offset


def halved(image: torch.Tensor) -> torch.Tensor:
    return 0.5 * image


def where(tree: Tree) -> dict[str, Any]:
    return {"manifest": tree.csv, "root": tree.root}


def of_set(pristine: Tree) -> list[str]:
    return ["--manifest", str(pristine.csv), "--root", str(pristine.root)]


def test_the_input_scores_as_the_input(pristine: Tree, tmp_path: Path) -> None:
    report = write_predictions(BaselineDenoiser("input"), "", tmp_path / "p", **where(pristine), clip="protocol")
    assert (report.written, report.kept, report.problems) == (12, 0, ())
    ours = evaluate(tmp_path / "p", **where(pristine))
    theirs = evaluate(None, **where(pristine), baseline="input")
    assert [one.psnr_db for one in ours.scores] == [one.psnr_db for one in theirs.scores]


def test_the_command_offers_every_baseline() -> None:
    assert tuple(BASELINES) == NAMES


def test_from_the_command_to_a_better_score(pristine: Tree, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "some predictions"
    profiles = []
    for camera in CAMERAS:
        known_profile(camera, (800, 1600, 3200)).save(tmp_path / f"{camera.name}.json")
        profiles += ["--profile", str(tmp_path / f"{camera.name}.json")]
    assert main(["baseline", "dct", *of_set(pristine), *profiles, "-o", str(out), "--jobs", "1"]) == 0
    shown = capsys.readouterr().out
    assert shown.startswith(f"12 frames predicted: {out}\nto score: eldata evaluate '{out}' --manifest")
    scored = evaluate(out, **where(pristine))
    rest = evaluate(None, **where(pristine), baseline="input")
    assert scored.table[-1].psnr_db > rest.table[-1].psnr_db + 3

    (out / SETTINGS).rename(tmp_path / SETTINGS)
    assert main(["baseline", "dct", *of_set(pristine), "-o", str(out)]) == 2
    assert "holds files, and none is predictions.json" in capsys.readouterr().err


def test_other_processes_change_nothing(pristine: Tree, tmp_path: Path) -> None:
    """With profiles: the denoiser travels with its work."""
    denoiser = BaselineDenoiser("dct", tuple(known_profile(camera, (800, 1600, 3200)) for camera in CAMERAS))
    found: list[dict[Path, bytes]] = []
    for workers in (1, Travelling()):
        out = tmp_path / str(len(found))
        write_predictions(denoiser, "", out, **where(pristine), workers=workers)
        found.append({path.relative_to(out): path.read_bytes() for path in out.rglob("*") if path.is_file()})
    assert found[0] == found[1]
    assert len(found[0]) == 13


def test_a_profile_is_taken_between_its_isos() -> None:
    """K of a camera whose ISO 50 has the gain of ISO 100; by one line from end to end 1.6 times that at 125."""
    known = known_profile(CAMERAS[0], (100, 200, 400, 800))
    rows = [replace(row, tukey_lambda=0.01 * place) for place, row in enumerate((known.rows[0], *known.rows))]
    profile = replace(known, rows=(replace(rows[0], iso=50.0), *rows[1:]), iso_range=(50.0, 800.0))
    base = CAMERAS[0].gain_dn_per_e(100)
    for iso, gain, shape in ((50, base, 0.0), (80, base, 0.0), (125, 1.25 * base, 0.0), (320, 3.2 * base, 0.03)):
        found = find_parameters(profile, iso)
        assert found.gain_dn_per_e == pytest.approx(gain, rel=1e-12)
        assert found.tukey_lambda == shape, "that of the nearest gain"


def test_what_is_there_is_kept_and_other_settings_are_refused(pristine: Tree, tmp_path: Path) -> None:
    out = tmp_path / "p"

    def again(name: str, **options: Any) -> Any:
        return write_predictions(BaselineDenoiser(name), "", out, **where(pristine), **options)

    again("input", cameras=["DemoAlpha"])
    first = {file: file.stat().st_mtime_ns for file in sorted(out.rglob("*.npy"))}
    [*first][3].unlink()
    report = again("input")
    assert (report.written, report.kept) == (7, 5)
    assert [file for file, time in first.items() if file.stat().st_mtime_ns != time] == [*first][3:4]
    with pytest.raises(ArgumentError, match="was started with denoiser input, now dct"):
        again("dct")
    with pytest.raises(ArgumentError, match="was started with dtype float32, now uint16"):
        again("input", dtype="uint16")


def test_a_folder_without_a_prediction_begins_again(pristine: Tree, tmp_path: Path) -> None:
    pytest.importorskip("fcntl")  # without locks nobody can tell whether another process works there
    out = tmp_path / "p"

    class Failing:
        def settings(self, cameras: Any, channels: Any) -> dict[str, Any]:
            assert (list(cameras), tuple(channels)) == (["DemoAlpha"], (4,))
            return {"denoiser": "failing"}

        def __call__(self, frame: NoisyFrame) -> Any:
            with pytest.raises(ArgumentError, match="started with denoiser failing, now input"):
                again(BaselineDenoiser("input"))  # while this one works, it is refused
            raise EldataError(f"not for {len(frame.image)} channels")

    def again(denoiser: Denoiser) -> PredictionReport:
        return write_predictions(denoiser, "", out, **where(pristine), cameras=["DemoAlpha"])

    assert (again(Failing()).written, list(out.rglob("*.npy"))) == (0, [])
    assert again(BaselineDenoiser("input")).written == 6
    assert json.loads((out / SETTINGS).read_text(encoding="utf-8"))["denoiser"] == "input"
    with pytest.raises(ArgumentError, match="started with denoiser input, now failing"):
        again(Failing())


class Changing(torch.nn.Module):
    """Scales by a weight, as its code has it, which the test changes as somebody edits a file between two runs."""

    power = 1.0
    weight = 0.5

    def __init__(self) -> None:
        super().__init__()
        self.scale = torch.nn.Parameter(torch.tensor(self.weight))

    def forward(self, image: torch.Tensor) -> torch.Tensor:
        return self.scale * image.abs() ** self.power


def unsteady(image: torch.Tensor) -> torch.Tensor:
    return image + 0.01 * torch.randn_like(image)


def test_predictions_of_a_network_that_has_changed_are_refused(
    pristine: Tree, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Code is known by the weights that it returns and by what it gives; only the same goes on."""
    code, out = "tests.baselines.test_predicting", tmp_path / "p"

    def predict(model: str, *options: str, to: Path = out) -> tuple[int, str]:
        found = main(["predict", model, *of_set(pristine), "--device", "cpu", "-o", str(to), *options])
        said = capsys.readouterr()
        return found, said.out + said.err

    changing = f"{code}:Changing"
    assert predict(changing, "--camera", "DemoAlpha")[0] == 0
    before = {file: file.read_bytes() for file in out.rglob("*.npy")}
    assert "6 frames predicted, 6 were there" in predict(changing)[1]  # the same network for the other camera
    for name, value, words in (
        ("weight", 0.75, "was started with weights sha256 "),
        ("power", 1.01, "was begun with a network of this name and these weights that gave something else"),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(Changing, name, value)
            found, said = predict(changing)
            assert (found, said.count("\n")) == (2, 1), said
            assert words in said
            assert predict(changing, to=tmp_path / name)[0] == 0
    assert predict(changing)[0] == 0
    assert {file: file.read_bytes() for file in before} == before

    assert predict(f"{code}:halved", to=tmp_path / "f")[0] == 0
    monkeypatch.setitem(globals(), "halved", lambda image: 0.49 * image)
    assert "gave something else for a fixed input" in predict(f"{code}:halved", to=tmp_path / "f")[1]

    found, said = predict(f"{code}:unsteady", to=tmp_path / "u")
    assert found == 0
    assert "the network gives something else for the same input at each call" in said
    found, said = predict(f"{code}:unsteady", to=tmp_path / "u")
    assert (found, "or it gives something else at each call" in said) == (2, True)


def test_what_lies_beside_an_onnx_file_is_part_of_it(pristine: Tree, tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime")
    (tmp_path / "net.onnx").write_bytes(onnx_network())
    weights = tmp_path / "net.onnx.data"
    weights.write_bytes(b"of yesterday")

    def predict() -> PredictionReport:
        network = load_network(str(tmp_path / "net.onnx"), tile=32, overlap=8, multiple=8, device="cpu")
        return write_predictions(network, "", tmp_path / "p", **where(pristine), cameras=["DemoBeta"])

    assert (predict().written, predict().kept) == (6, 6)
    weights.write_bytes(b"of today")
    with pytest.raises(ArgumentError, match=r"was started with net\.onnx\.data "):
        predict()
    weights.unlink()
    with pytest.raises(ArgumentError, match=r"was started with net\.onnx\.data .*, now None"):
        predict()


def test_a_missing_extra_is_one_line_before_anything_is_written(
    pristine: Tree, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("bm3d", "anscombe-bm3d"):
        with monkeypatch.context() as patch:
            patch.setitem(sys.modules, "bm3d", None)  # what an import of a package that is not installed meets
            assert main(["baseline", name, *of_set(pristine), "-o", str(tmp_path / "p"), "--jobs", "1"]) == 2
        said = capsys.readouterr()
        assert (said.out, said.err.count("\n")) == ("", 1)
        assert "pip install 'eldata[bm3d]'" in said.err
        assert not (tmp_path / "p").exists()


def test_damaged_frames_are_listed_and_the_rest_is_predicted(
    pristine: Tree, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(pristine.root, tmp_path / "data")
    name = next(record.path for record in pristine.manifest.records if record.role == "noisy" and record.ratio == 100)
    victim = tmp_path / "data" / "ELD-demo" / name
    with tifffile.TiffFile(victim) as tiff:
        start, length = tiff.pages.first.dataoffsets[0], tiff.pages.first.databytecounts[0]
    content = bytearray(victim.read_bytes())
    content[start + length // 4 : start + length] = bytes(length - length // 4)
    victim.write_bytes(content)
    code = main(["baseline", "input", "--manifest", str(pristine.csv), "--root", str(tmp_path / "data"), "-o",
                 str(tmp_path / "p"), "--jobs", "1"])  # fmt: skip
    shown = capsys.readouterr().out
    assert code == 1
    assert re.search(rf"^{name}: .*{name}: ", shown, re.MULTILINE)
    assert "11 frames predicted" in shown


def test_where_the_noise_is_known_from(pristine: Tree, tmp_path: Path) -> None:
    """From the profile alone where there is one; without, a frame that does not tell its noise is named."""

    options = {**where(pristine), "cameras": ["DemoAlpha"]}

    def predicted(name: str, *profiles: CameraProfile, another: bool = False) -> PredictionReport:
        return write_predictions(BaselineDenoiser("dct", profiles, another), "", tmp_path / name, **options)

    known = known_profile(CAMERAS[0], (800, 1600, 3200))
    assert predicted("known", known).written == 6
    with pytest.raises(ArgumentError, match=r"no profile of .* DemoAlpha was given, only of SonyA7S2, whose noise"):
        predicted("Sony", CameraProfile.load("SonyA7S2"))
    assert not (tmp_path / "Sony").exists()
    other = predicted("Sony", CameraProfile.load("SonyA7S2"), another=True)
    assert other.written == 6
    assert other.remarks == ("the noise of SonyA7S2 was taken for frames of DemoAlpha, another camera",)
    assert json.loads((tmp_path / "Sony" / SETTINGS).read_text(encoding="utf-8"))["profile_of_another_camera"] is True
    assert predicted("two", CameraProfile.load("SonyA7S2"), known).written == 6
    first = min((tmp_path / "known").rglob("*.npy")).relative_to(tmp_path / "known")
    one, other, two = (np.load(tmp_path / name / first) for name in ("known", "Sony", "two"))
    assert np.array_equal(one, two)
    assert not np.array_equal(one, other)

    several = (CameraProfile.load("SonyA7S2"), CameraProfile.load("NikonD850"))
    for another in (False, True):  # which of them to take nobody can tell
        with pytest.raises(ArgumentError, match=r"no profile of .* DemoAlpha was given, only of SonyA7S2, NikonD"):
            predicted("others", *several, another=another)
    with pytest.raises(ArgumentError, match="one profile of each camera; found profiles of DemoAlpha, DemoAlpha"):
        predicted("twice", known, known)
    with pytest.raises(ArgumentError, match="started with noise"):
        predicted("known", known_profile(CAMERAS[0], (400, 1600, 3200)))
    assert not (tmp_path / "others").exists()

    # 24 windows a channel hardly tell; what they do not is left to the user.
    report = predicted("own")
    assert report.written < 6
    assert re.match(r"(\d frames, such as )?DemoAlpha/scene-1/IMG_00\d\d.dng: the noise cannot be told from the scene: "
                    r".* windows .* With the camera's noise given \(--profile", report.problems[0])  # fmt: skip


@pytest.mark.parametrize("kind", ["module", "class", "function", "script", "export", "onnx"])
def test_predictions_are_the_networks_own(kind: str, pristine: Tree, tmp_path: Path) -> None:
    module, weights = Doubled(), None
    with torch.no_grad():
        module.offset.fill_(0.125)
    if kind == "class":
        torch.save({"state_dict": module.state_dict()}, tmp_path / "w.pth")
        name, weights = "tests.baselines.test_predicting:Doubled", tmp_path / "w.pth"
    elif kind == "module":
        name = "tests.baselines.test_predicting:INSTANCE"
    elif kind == "function":
        name = "tests.baselines.test_predicting:halved"
    elif kind == "script":
        name = str(tmp_path / "net.pt")
        with pytest.warns(DeprecationWarning, match="torch.jit"):
            torch.jit.save(torch.jit.trace(module, torch.zeros(1, 4, 16, 16)), name)  # type: ignore[no-untyped-call]
    elif kind == "export":
        name = str(tmp_path / "net.pt2")
        exported(tmp_path / "net.pt2", module)
    else:
        pytest.importorskip("onnxruntime")
        name = str(tmp_path / "net.onnx")
        (tmp_path / "net.onnx").write_bytes(onnx_network())
    network = load_network(name, tile=32, overlap=8, multiple=8, device="cpu", weights=weights)
    write_predictions(network, "", tmp_path / "p", **where(pristine), clip="both", cameras=["DemoBeta"])
    dataset = ELDDataset(pristine.data, manifest=pristine.csv, cameras=["DemoBeta"], clip="both")
    for sample in dataset:
        found = np.load((tmp_path / "p" / sample["path"]).with_suffix(".npy"))
        offset = {"module": 0.25, "function": 0.0, "onnx": 0.0}.get(kind, 0.125)
        assert np.abs(found - (0.5 * sample["input"].numpy() + np.float32(offset))).max() < 1e-6


INSTANCE = Doubled()


def test_what_is_not_a_network(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No file is unpickled: the canary would sing."""
    pytest.importorskip("onnxruntime")
    torch.save(INSTANCE.state_dict(), tmp_path / "weights.pth")
    torch.save(INSTANCE, tmp_path / "model.pth")
    torch.save({"other": torch.zeros(3)}, tmp_path / "other.pth")
    (tmp_path / "bad.onnx").write_bytes(b"nothing")
    (tmp_path / "plain.pkl").write_bytes(pickle.dumps(Bait(tmp_path / "sung")))
    (tmp_path / "cut.safetensors").write_bytes(b"\x40" + bytes(9))
    (tmp_path / "net.onnx").write_bytes(onnx_network())
    (tmp_path / "bad.pt2").write_bytes(b"nothing")
    here = "tests.baselines.test_predicting"
    cases: tuple[tuple[str, dict[str, Any], str], ...] = (
        ("no.pt", {}, "there is no such file; give a model's file, or package.module:name"),
        ("weights.pth", {}, "is not TorchScript. If it is a checkpoint, give the code"),
        ("plain.pkl", {}, "is not TorchScript"),
        ("bad.pt2", {}, "bad.pt2: cannot be loaded by torch.export"),
        ("bad.onnx", {}, "cannot be loaded by ONNX Runtime"),
        ("net.onnx", {"precision": "bfloat16"}, "--precision is torch's"),
        ("net.onnx", {"weights": "weights.pth"}, "--weights goes with package.module:name"),
        (f"{here}:nothing", {}, "has no attribute 'nothing'"),
        ("no.such.place:Network", {}, "no.such.place:Network: cannot be imported"),
        ("math:pi", {}, "math:pi is float, not a module or function of tensors"),
        (f"{here}:halved", {"weights": "weights.pth"}, "--weights goes with a torch.nn.Module"),
        (f"{here}:Doubled", {"weights": "none.pth"}, "none.pth: there is no such file"),
        (f"{here}:Doubled", {"weights": "model.pth"}, "save model.state_dict(), not the model"),
        (f"{here}:Doubled", {"weights": "plain.pkl"}, "cannot be loaded as weights alone"),
        (f"{here}:Doubled", {"weights": "cut.safetensors"}, "cut.safetensors: cannot be loaded as weights alone"),
        (f"{here}:Doubled", {"weights": "other.pth"}, "its weights are not those of Doubled"),
        (f"{here}:Doubled", {"device": "cpu", "precision": "float16"}, "float16 needs a GPU"),
    )
    monkeypatch.chdir(tmp_path)
    for model, options, words in cases:
        with pytest.raises((ArgumentError, FileError), match=re.escape(words)):
            load_network(model, **options)
    assert not (tmp_path / "sung").exists()


def exported(path: Path, module: torch.nn.Module) -> Path:
    sides = {2: torch.export.Dim("h"), 3: torch.export.Dim("w")}
    torch.export.save(torch.export.export(module, (torch.zeros(1, 4, 16, 24),), dynamic_shapes=(sides,)), path)
    return path


def test_what_the_commands_say_to_wrong_input(
    pristine: Tree, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One sentence each, and no folder of predictions is begun for a model that cannot be loaded."""
    code, out = "tests.baselines.test_predicting", ["-o", str(tmp_path / "p"), "--device", "cpu"]
    for words, said in (
        ([*of_set(pristine), f"{tmp_path}"], "is a folder; give a model's file"),
        ([*of_set(pristine), f"{code}:halved", "--device", "abacus"], "--device abacus: torch knows no such device"),
        (["--manifest", str(pristine.csv), "--root", str(tmp_path / "nowhere"), f"{code}:halved"], "nowhere"),
    ):
        assert main(["predict", *out, *words]) == 2
        error = capsys.readouterr().err
        assert (error.count("\n"), said in error) == (1, True), error
        assert not (tmp_path / "p").exists()

    assert main(["predict", f"{code}:Nine", *of_set(pristine), *out]) == 1
    shown = capsys.readouterr().out.splitlines()
    assert shown[0].startswith("12 frames, such as DemoAlpha/scene-1/IMG_0004.dng: the network cannot take (1, 4, ")
    assert "4 channels: " in shown[0]
    assert "9 channels" in shown[0]
    assert "cannot take a small fixed input" in shown[1]
    assert shown[2:] == [f"0 frames predicted: {tmp_path / 'p'}"]  # and no advice to score none


class Nine(torch.nn.Conv2d):
    """A network of X-Trans' channels."""

    def __init__(self) -> None:
        super().__init__(9, 9, 3, padding=1)


def test_predictions_of_16_bits(pristine: Tree, tmp_path: Path) -> None:
    """Of a network whose values lie on both sides of [0, 1]: clipped, and rounded to the nearest."""
    network = load_network("tests.baselines.test_predicting:wide")
    for dtype in ("float32", "uint16"):
        options: dict[str, Any] = {**where(pristine), "cameras": ["DemoBeta"], "dtype": dtype}
        assert write_predictions(network, "", tmp_path / dtype, **options).written == 6
    for file in (tmp_path / "uint16").rglob("*.npy"):
        exact = np.load(tmp_path / "float32" / file.relative_to(tmp_path / "uint16"))
        assert exact.min() < 0 < 1 < exact.max()
        np.testing.assert_array_equal(np.load(file), np.rint(np.clip(exact, 0, 1) * 65535))


def wide(image: torch.Tensor) -> torch.Tensor:
    return 9 * image - 1


def test_values_that_are_not_numbers_are_named(pristine: Tree, tmp_path: Path) -> None:
    network = load_network("tests.baselines.test_predicting:broken")
    report = write_predictions(network, "", tmp_path / "p", **where(pristine))
    assert report.written == 0
    assert "values NaN or infinite" in report.problems[0]
    assert not list((tmp_path / "p").rglob("*.npy"))


def broken(image: torch.Tensor) -> torch.Tensor:
    return image / 0 * 0
