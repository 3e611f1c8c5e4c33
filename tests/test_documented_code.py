"""Every block of Python in README and docs runs, and every command in them parses.

A document's blocks run in their order, in one namespace and a folder of their own, on small files of the names that
they mention. What they take for granted (a network, a loader, an array) is given to them. Worker processes are
replaced, for time, but for README's block, which is also run as a script.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import pytest
import torch

from capture.cli.main import parser as capture_parser
from eldata.base import workers
from eldata.cli.main import main
from eldata.cli.main import parser as eldata_parser
from eldata.examples import train_denoiser, train_video_denoiser
from eldata.manifest.catalogue import shipped_manifest
from eldata.raw.dng import write_dng
from eldata.records import Exposure, Sensor
from tests.drv_tree import build_drv_tree, write_raw_clip
from tests.sid_tree import build_sid_tree
from tests.sidd_tree import write_corrected
from tests.trees import build_published_tree
from tests.waiting import PATIENCE_S

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    Names = dict[str, Any]

ROOT = Path(__file__).parents[1]
DOCUMENTS = {
    path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8")
    for path in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
}
_FENCE = re.compile(r"^```(.*)\n((?:.*\n)*?)```$", re.MULTILINE)

# Whose blocks are run by another test.
ELSEWHERE = {
    "docs/adding-a-dataset.md": "tests/test_adding_a_dataset.py",
    "docs/clusters.md": "tests/datasets/test_webdataset.py",
    "docs/srgb.md": "tests/isp/test_docs.py",
}
# Sizes and times alone are made smaller.
SMALLER = {
    "crop=512": "crop=16",
    "crop=256": "crop=16",
    "region=(0, 0, 256, 256)": "region=(0, 0, 16, 16)",
    "range(100)": "range(2)",
    "range(200)": "range(2)",
    "(3072, 4096)": "(48, 64)",
}

SENSOR = Sensor("SONY", "ILCE-7SM2", ((0, 1), (3, 2)), (512.0,) * 4, 16383.0, 96, 128, (2.0, 1.0, 1.5, 1.0))


def blocks(document: str) -> list[str]:
    """The blocks of Python that have no file's name."""
    return [text for kind, text in _FENCE.findall(DOCUMENTS[document]) if kind == "python"]


def photograph(path: str, iso: int = 100, number: int = 0, sensor: Sensor = SENSOR) -> None:
    """A frame of a smooth scene, with noise."""
    place = Path(path)
    place.parent.mkdir(parents=True, exist_ok=True)
    generator = np.random.default_rng(number)
    light = np.linspace(50, 4000, sensor.height * sensor.width).reshape(sensor.height, sensor.width)
    mosaic = generator.poisson(light) + generator.normal(512, 3, light.shape)
    write_dng(place, np.rint(mosaic).clip(0, 16383).astype(np.uint16), sensor, Exposure(Fraction(iso), Fraction(1, 25)))


def packed(scale: float = 0.5, size: tuple[int, int] = (32, 48)) -> Any:
    return np.random.default_rng(3).uniform(0, scale, (4, *size)).astype(np.float32)


# --- what each document needs -----------------------------------------------------------------------------------------


def eld_and_predictions() -> None:
    manifest = shipped_manifest("eld")
    build_published_tree(manifest, Path("data/ELD"))
    for record in manifest.records:
        if record.role == "noisy":
            path = Path("preds", record.path).with_suffix(".npy")
            path.parent.mkdir(parents=True, exist_ok=True)
            np.save(path, packed(size=(24, 32)))


def of_readme(_: pytest.MonkeyPatch) -> Names:
    eld_and_predictions()
    photograph("data/SID/Sony/long/00001_00_10s.ARW")
    return {}


def of_evaluation(_: pytest.MonkeyPatch) -> Names:
    from eldata.demo.tree import make_tree

    eld_and_predictions()
    shutil.copytree("preds", "preds-bm3d")
    make_tree(Path("eldata-demo"), scenes=1, size=(64, 96))
    demo = ["--manifest", "eldata-demo/manifests/eld-demo.csv", "--root", "eldata-demo/data", "--jobs", "1"]
    assert main(["baseline", "input", *demo, "-o", "eldata-demo/predictions/dct"]) == 0
    return {"depth": lambda image: image.mean(axis=0)}


def of_scores(_: pytest.MonkeyPatch) -> Names:
    import eldata

    eld_and_predictions()
    return {"eldata": eldata, "Path": Path, "result": eldata.evaluate("preds", "eld", root="data")}


def of_datasets(_: pytest.MonkeyPatch) -> Names:
    for folders in ("ELD/SonyA7S2", "SID/Sony", "SID/Fuji"):
        Path("data", folders).mkdir(parents=True)
    write_corrected(Path("data/SIDD-CC"), shipped_manifest("sidd").records[:4])
    for manifest in map(shipped_manifest, ("lrd", "crvd", "lrid", "sidd", "sidd-blocks")):
        folder = manifest.folder("data")  # it looks where copies lie: once
        for place in {(folder / record.path).parent for record in manifest.records}:
            place.mkdir(parents=True, exist_ok=True)
    build_drv_tree(shipped_manifest("drv"), Path("data/DRV"), frames=12)
    for record in shipped_manifest("drv").records:
        if record.role == "noisy" and record.split == "train" and not record.scene.startswith("M"):
            write_raw_clip(Path("data/DRV"), record.scene, 5)
    for number in range(6):
        photograph(f"clean-clips/walk/{number:04d}.ARW", number=number)
    return {"clean": np.stack([packed()] * 5)}


def of_metrics(_: pytest.MonkeyPatch) -> Names:
    image = np.random.default_rng(5).uniform(0, 1, (3, 64, 64)).astype(np.float32)
    batch = {"input": torch.from_numpy(packed())[None], "target": torch.from_numpy(packed())[None]}
    return {"loader": [batch], "network": torch.nn.Identity(), "prediction": image, "reference": image}


def calibrated_frames(folder: str, camera: str) -> Any:
    """Calibration frames of the demo's camera, at the places and under the name that a document has."""
    from eldata.calibration import calibrate
    from eldata.datasets import CalibrationFrames
    from eldata.demo.calibration_frames import DEMO_GAMMA, make_calibration_frames

    make_calibration_frames(Path("made"), isos=(400, 800, 1600), bias_frames=6, flat_levels=4, size=(256, 256))
    Path(folder).mkdir(parents=True)
    (Path("made/data/calibration") / DEMO_GAMMA.name).rename(Path(folder) / camera)
    frames = CalibrationFrames(folder, camera)
    return frames, calibrate(frames)


def of_calibration(_: pytest.MonkeyPatch) -> Names:
    from eldata.calibration import dark_shading
    from eldata.demo.camera import CAMERAS
    from eldata.demo.tree import make_tree

    frames, found = calibrated_frames("data/calibration", "MyCamera")
    dark_shading(frames, found).save("mycamera.npz")
    build_published_tree(shipped_manifest("eld"), Path("data/ELD"))
    first = min(Path("data/calibration/MyCamera/flat/ISO400").iterdir())
    Path("frame.ARW").write_bytes(first.read_bytes())
    make_tree(Path("tree"), scenes=1, cameras=CAMERAS[1:])  # whose shadows and smooth parts tell gain and read noise
    Path("tree/data/ELD-demo/DemoBeta/scene-1/IMG_0012.dng").rename("IMG_0001.dng")
    return {"generator": np.random.default_rng(0), "packed": packed()}


def of_noise(patch: pytest.MonkeyPatch) -> Names:
    from eldata.calibration import dark_shading
    from eldata.datasets import Arrays
    from eldata.noise import CameraProfile, NoiseModel

    frames, found = calibrated_frames("calibration/held-out", "MyCamera")
    dark_shading(frames, found).save("MyCamera.npz")
    np.save("SonyA7S2_params.npy", np.array({"Kmin": 0.25}, dtype=object), allow_pickle=True)
    for name in ("mycamera.json", "MyCamera.json"):
        found.profile.save(name)
    assert main(["pack", "calibration/held-out", "-o", "bias.h5"]) == 0
    for number in range(2):
        photograph(f"clean/{number}.dng", number=number, sensor=replace(SENSOR, height=256, width=256))
        photograph(f"data/SID/Sony/long/{number}.ARW", number=number)

    class Network(torch.nn.Module):
        def forward(self, clean: Any, *_: Any) -> Any:
            return clean

    return {
        "clean": packed(),
        "source": Arrays([packed()], range_dn=15871.0),
        "loader": [],
        "network": Network(),
        "Adapter": lambda _: NoiseModel("P*+G*+B+R+U"),
        "CameraProfile": CameraProfile,
    }


def of_raw_files(_: pytest.MonkeyPatch) -> Names:
    photograph("IMG_0004.ARW")
    return {"torch": torch, "n": 2, "Fraction": Fraction}


def of_manifests(_: pytest.MonkeyPatch) -> Names:
    pd.DataFrame({"path": ["'=1+1.dng"], "psnr_db": [1.0]}).to_csv("scores.csv")
    return {"pd": pd}


def of_stores(_: pytest.MonkeyPatch) -> Names:
    manifest = shipped_manifest("sid-sony")
    build_sid_tree(manifest, Path("data/SID"))
    photograph("clean/0.dng")
    build_drv_tree(shipped_manifest("drv"), Path("data/DRV"))
    for line in (
        "pack sid-sony --subset indoor-15 -o sid-train.h5",
        "pack clean -o clean.h5",
        "pack drv --clip 0001 -o drv-train.h5",
    ):
        assert main(line.split()) == 0
    shutil.copy("sid-train.h5", "eld.h5")
    return {"network": lambda images: images}


def of_published_code(patch: pytest.MonkeyPatch) -> Names:
    """LED is not installed: its package's names, with the registries' interface."""
    build_sid_tree(shipped_manifest("sid-sony"), Path("data/SID"))
    from tests.integrations.test_basicsr import registry_module

    for name in ("led", "led.utils", "led.train"):
        patch.setitem(sys.modules, name, ModuleType(name))
    patch.setitem(sys.modules, "led.utils.registry", registry_module())
    patch.setattr(sys.modules["led.train"], "train_pipeline", lambda _: None, raising=False)
    return {}


NEEDS: dict[str, Callable[[pytest.MonkeyPatch], Names]] = {
    "README.md": of_readme,
    "docs/calibration.md": of_calibration,
    "docs/datasets.md": of_datasets,
    "docs/evaluation.md": of_evaluation,
    "docs/manifests.md": of_manifests,
    "docs/metrics.md": of_metrics,
    "docs/noise.md": of_noise,
    "docs/plots.md": of_scores,
    "docs/published-code.md": of_published_code,
    "docs/published-numbers.md": of_scores,
    "docs/raw-files.md": of_raw_files,
    "docs/reports.md": of_scores,
    "docs/training.md": of_stores,
}
# What a block takes to be otherwise than those before it have left it.
BEFORE: dict[tuple[str, int], Names] = {("docs/raw-files.md", 2): {"packed": torch.zeros(1, 16, 8, 8)}}
# They need a cluster of several machines: tests/base/clusters runs the same calls on one of processes.
ON_MACHINES = ("docs/clusters.md",)


def test_no_document_is_left_out() -> None:
    written = {name for name in DOCUMENTS if blocks(name)}
    assert written == {*NEEDS, "docs/srgb.md", *ON_MACHINES}
    for name, text in DOCUMENTS.items():
        named = {kind.partition(" ")[2] for kind, _ in _FENCE.findall(text) if kind.startswith("python ")}
        assert name in ELSEWHERE or not named
    for test in ELSEWHERE.values():
        assert (ROOT / test).is_file()
    for name in ON_MACHINES:
        for text in blocks(name):
            compile(text, name, "exec")


def in_this_process(_: Any, work: Any, units: Any) -> Iterator[Any]:
    return (workers._run_unit(work, unit) for unit in units)


# Those that score or pack whole sets, and calibrate.
LONG = {"README.md", *(f"docs/{name}.md" for name in (
    "calibration", "datasets", "evaluation", "metrics", "noise", "plots", "published-numbers", "reports", "training",
))}  # fmt: skip


@pytest.mark.parametrize("document", [pytest.param(name, marks=[pytest.mark.study] * (name in LONG)) for name in NEEDS])
def test_blocks_run(document: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("ELDATA_ROOT", raising=False)
    monkeypatch.setattr(workers.Workers, "_outcomes", in_this_process)
    names = NEEDS[document](monkeypatch) | {"__name__": "__main__"}
    for number, text in enumerate(blocks(document), 1):
        for large, small in SMALLER.items():
            text = text.replace(large, small)  # noqa: PLW2901 # the same block
        names |= BEFORE.get((document, number), {})
        exec(compile(text, f"{document}, block {number}", "exec"), names)  # noqa: S102 # our own


@pytest.mark.study
def test_the_readme_s_block_as_a_script(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With worker processes, two in place of four, each of which runs the script again up to the guard."""
    monkeypatch.chdir(tmp_path)
    eld_and_predictions()
    Path("script.py").write_text(blocks("README.md")[0].replace("workers=4", "workers=2"), encoding="utf-8")
    command = [sys.executable, "-W", "ignore::UserWarning", "script.py"]  # of machines with few CPUs
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=PATIENCE_S, env={**os.environ, "PYTHONPATH": str(ROOT)}
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.count("SonyA7S2") == 1


# --- commands ---------------------------------------------------------------------------------------------------------


def commands(document: str) -> Iterator[str]:
    """The commands of both programs in a document's blocks, as they would be typed."""
    for kind, text in _FENCE.findall(DOCUMENTS[document]):
        if kind.partition(" ")[0] not in ("", "sh", "console"):
            continue
        for line in text.replace("\\\n", " ").splitlines():
            found = re.match(r"(?:\$ )?((?:eldata|capture) .*)", line.strip())
            if found and not _PRINTED.match(found[1]) and not set("[|<") & set(found[1]):
                yield found[1]


# What a command prints may begin with its name; what has brackets or bars is a synopsis.
_PRINTED = re.compile(r"(eldata|capture)[ a-z]*:")


def test_commands_parse() -> None:
    lines = [line for document in DOCUMENTS for line in commands(document)]
    assert len(lines) > 60
    for line in lines:
        words = shlex.split(line, comments=True)
        program = eldata_parser if words[0] == "eldata" else capture_parser
        arguments = program().parse_args(words[1:])  # of another, argparse says which and leaves
        assert arguments.command.startswith(words[0])


@pytest.mark.parametrize("training", [train_denoiser, train_video_denoiser])
def test_commands_of_trainings_parse(training: ModuleType) -> None:
    """Those of the documents, and of its own help."""
    program = training.parser()
    text = "\n".join([*DOCUMENTS.values(), program.format_help()]).replace("\\\n", " ")
    lines = re.findall(rf"^ *(?:\$ )?{program.prog}( -.*)$", text, re.MULTILINE)
    assert len(lines) > 6
    for line in lines:
        program.parse_args(shlex.split(line, comments=True))
