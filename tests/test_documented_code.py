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
from collections.abc import Callable, Iterator
from dataclasses import replace
from fractions import Fraction
from itertools import product
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pandas as pd
import pytest
import torch

import eldata
from capture.cli.main import parser as capture_parser
from eldata.base import workers
from eldata.calibration import Calibration, calibrate, dark_shading
from eldata.cli.main import main
from eldata.cli.main import parser as eldata_parser
from eldata.datasets import Arrays, CalibrationFrames
from eldata.evaluation import save_prediction
from eldata.examples import train_denoiser, train_video_denoiser
from eldata.manifest.catalogue import shipped_manifest
from eldata.raw import read_raw
from eldata.raw.dng import write_dng
from eldata.records import Exposure, Sensor
from tests.drv_tree import build_drv_tree, write_raw_clip
from tests.pattern_trees import build_llrvd_tree
from tests.shared import made_once
from tests.sid_tree import build_sid_tree
from tests.sidd_tree import write_corrected
from tests.trees import build_published_tree, place_of
from tests.waiting import PATIENCE_S

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


def packed(size: tuple[int, int] = (32, 48)) -> Any:
    return np.random.default_rng(3).uniform(0, 0.5, (4, *size)).astype(np.float32)


# --- what each document needs -----------------------------------------------------------------------------------------


@pytest.fixture(scope="session")
def eld(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """ELD and predictions of its frames, made once."""

    def make(folder: Path) -> None:
        manifest = shipped_manifest("eld")
        build_published_tree(manifest, folder / "data" / "ELD")
        for record in manifest.records:
            if record.role == "noisy":
                save_prediction(folder / "preds", record.path, packed((24, 32)))

    with made_once(tmp_path_factory, "eld-and-predictions", make) as folder:
        yield folder


def link_eld(eld: Path) -> None:
    Path("data").mkdir()
    for name in ("data/ELD", "preds"):
        Path(name).symlink_to(eld / name)


def of_readme(eld: Path) -> Names:
    link_eld(eld)
    photograph("data/SID/Sony/long/00001_00_10s.ARW")
    return {}


def of_evaluation(eld: Path) -> Names:
    from eldata.demo.tree import make_tree

    link_eld(eld)
    make_tree(Path("eldata-demo"), scenes=1, size=(64, 96))
    demo = ["--manifest", "eldata-demo/manifests/eld-demo.csv", "--root", "eldata-demo/data", "--jobs", "1"]
    assert main(["baseline", "input", *demo, "-o", "eldata-demo/predictions/dct"]) == 0
    return {"depth": lambda image: image.mean(axis=0)}


def of_scores(eld: Path) -> Names:
    link_eld(eld)
    return {"eldata": eldata, "Path": Path, "result": eldata.evaluate("preds", "eld", root="data")}


def of_datasets(_: Path) -> Names:
    write_corrected(Path("data/SIDD-CC"), shipped_manifest("sidd").records[:4])
    for manifest in map(shipped_manifest, ("eld", "sid-sony", "sid-fuji", "lrd", "crvd", "lrid", "sidd", "rawnind")):
        folder = manifest.folder("data")  # it looks where copies lie: once
        for record in {record.path: record for record in manifest.records}.values():
            place_of(record, folder).touch()
    for manifest, frame in product(map(shipped_manifest, ("recrvd", "pmrid", "raw-denoise")), "12345"):
        for record in manifest.records:
            path = re.sub(r"\{\w+\}|\*", "0", record.path.replace("{frame}", frame))
            place_of(replace(record, path=path), manifest.folder("data")).touch()
    build_llrvd_tree(shipped_manifest("llrvd"), Path("data/LLRVD"))
    build_drv_tree(shipped_manifest("drv"), Path("data/DRV"), frames=12)
    for record in shipped_manifest("drv").records:
        if record.role == "noisy" and record.split == "train" and not record.scene.startswith("M"):
            write_raw_clip(Path("data/DRV"), record.scene, 5)
    for number in range(6):
        photograph(f"clean-clips/walk/{number:04d}.ARW", number=number)
    return {"clean": np.stack([packed()] * 5)}


def of_metrics(_: Path) -> Names:
    image = torch.from_numpy(packed())[None]
    return {"loader": [{"input": image, "target": image}], "network": torch.nn.Identity()}


def calibrated_frames(folder: str, camera: str, shading: str) -> Calibration:
    """Calibrate frames of the demo's camera, at the places and under the names that a document has."""
    from eldata.demo.calibration_frames import DEMO_GAMMA, make_calibration_frames

    make_calibration_frames(Path("made"), isos=(400, 800, 1600), bias_frames=6, flat_levels=4, size=(256, 256))
    Path(folder).mkdir(parents=True)
    (Path("made/data/calibration") / DEMO_GAMMA.name).rename(Path(folder) / camera)
    frames = CalibrationFrames(folder, camera)
    calibration = calibrate(frames)
    dark_shading(frames, calibration).save(shading)
    return calibration


def of_calibration(eld: Path) -> Names:
    link_eld(eld)
    calibrated_frames("data/calibration", "MyCamera", "mycamera.npz")
    shutil.copy(min(Path("data/calibration/MyCamera/flat/ISO400").iterdir()), "frame.ARW")
    return {}


def of_noise(_: Path) -> Names:
    calibration = calibrated_frames("calibration/held-out", "MyCamera", "MyCamera.npz")
    calibration.profile.save("MyCamera.json")
    np.save("SonyA7S2_params.npy", np.array({"Kmin": 0.25}, dtype=object), allow_pickle=True)
    assert main(["pack", "calibration/held-out", "-o", "bias.h5"]) == 0
    for place in ("clean/0.dng", "data/SID/Sony/long/0.ARW"):
        photograph(place, sensor=replace(SENSOR, height=256, width=256))
    source = Arrays([packed()], range_dn=15871.0)
    return {"clean": packed(), "source": source, "loader": [], "network": torch.nn.Identity(), "torch": torch}


def of_raw_files(_: Path) -> Names:
    photograph("IMG_0004.ARW")
    return {"torch": torch, "n": 2, "quad": torch.zeros(1, 16, 8, 8), "Fraction": Fraction}


def of_manifests(_: Path) -> Names:
    pd.DataFrame({"path": ["'=1+1.dng"], "psnr_db": [1.0]}).to_csv("scores.csv")
    return {"pd": pd}


def of_stores(_: Path) -> Names:
    build_sid_tree(shipped_manifest("sid-sony"), Path("data/SID"))
    photograph("clean/0.dng")
    build_drv_tree(shipped_manifest("drv"), Path("data/DRV"))
    for line in (
        "pack sid-sony --subset indoor-15 -o sid-train.h5",
        "pack clean -o clean.h5",
        "pack drv --clip 0001 -o drv-train.h5",
    ):
        assert main(line.split()) == 0
    return {}


def of_srgb(_: Path) -> Names:
    for record in shipped_manifest("sid-sony").records:
        place_of(record, Path("data/SID")).touch()
    np.savetxt("mine.txt", np.stack([np.linspace(0, 1, 5)] * 4, axis=1))
    np.savetxt("CRF_SonyA7S2_5.txt", np.loadtxt("mine.txt").T[1:])
    return {}


# A scene of AIM 2025 in shares of white, once amplified by 100: (H, W, 4), each channel of its own brightness.
AIM = np.linspace(0.1, 0.9, 515)[:, None, None] * np.ones((1, 519, 1)) * (1, 0.8, 0.6, 0.4)


def of_published_code(_: Path) -> Names:
    """SID; and AIM 2025's folders, with frames of the demo's camera."""
    from eldata.demo.calibration_frames import DEMO_GAMMA, make_calibration_frames

    build_sid_tree(shipped_manifest("sid-sony"), Path("data/SID"))
    isos, canon = (400, 800, 1600), Path("data/AIM25/canon70d")
    make_calibration_frames(Path("made"), isos=isos, bias_frames=6, flat_levels=2, size=(1030, 1038))
    for path in Path("made").glob("data/calibration/*/bias/ISO*/*.dng"):
        place = canon / f"dark_frame/iso{path.parent.name[3:]}/{path.stem}.CR2"
        place.parent.mkdir(parents=True, exist_ok=True)
        path.rename(place)
    gains: Names = {f"iso{iso}": [DEMO_GAMMA.noise_at(iso).gain_dn_per_e] * 4 for iso in isos}
    (canon / "calib_res").mkdir()
    np.savez(canon / "calib_res/sys_gain.npz", **gains)
    frame = read_raw(min((canon / "dark_frame/iso800").iterdir()))
    electrons = AIM.reshape(515, 519, 2, 2).swapaxes(1, 2).reshape(1030, 1038) * 158.71 / gains["iso800"][0]
    noisy = frame.mosaic + np.random.default_rng(3).poisson(electrons) * gains["iso800"][0]
    place = canon / "test_data/paired_input/scene1_iso800_dgain100.CR2"
    place.parent.mkdir(parents=True)
    write_dng(place, np.rint(noisy).astype(np.uint16), frame.sensor, frame.exposure)
    return {}


def check_submission() -> None:
    """Of AIM 2025: its form, its order of channels, and a scene that is nearer to the truth than the noise is."""
    made = np.load("submission/canon70d/scene1_iso800_dgain100.npy")
    assert (made.shape, made.dtype) == ((512, 512, 4), np.uint16)
    assert np.abs(made / 65535 - AIM[2:514, 4:516]).mean() < 0.02


@pytest.fixture
def led(monkeypatch: pytest.MonkeyPatch) -> None:
    """LED, which is not installed: its package's names, with the registries' interface."""
    from tests.integrations.test_basicsr import registry_module

    for name in ("led", "led.utils", "led.train"):
        monkeypatch.setitem(sys.modules, name, ModuleType(name))
    monkeypatch.setitem(sys.modules, "led.utils.registry", registry_module())
    monkeypatch.setattr(sys.modules["led.train"], "train_pipeline", lambda _: None, raising=False)


NEEDS: dict[str, Callable[[Path], Names]] = {
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
    "docs/srgb.md": of_srgb,
    "docs/training.md": of_stores,
}
QUICK = {"docs/manifests.md", "docs/raw-files.md"}  # the others score, pack or calibrate


def test_no_document_is_left_out() -> None:
    assert {name for name in DOCUMENTS if blocks(name)} == {*NEEDS, "docs/clusters.md"}
    for name, text in DOCUMENTS.items():
        named = {kind.partition(" ")[2] for kind, _ in _FENCE.findall(text) if kind.startswith("python ")}
        assert name in ELSEWHERE or not named
    assert [test for test in ELSEWHERE.values() if not (ROOT / test).is_file()] == []
    for text in blocks("docs/clusters.md"):  # of several machines: tests/base/clusters makes the same calls on one
        compile(text, "docs/clusters.md", "exec")


def in_this_process(_: Any, work: Any, units: Any) -> Iterator[Any]:
    return (workers._run_unit(work, unit) for unit in units)


@pytest.mark.parametrize(
    "document", [pytest.param(name, marks=[pytest.mark.study] * (name not in QUICK)) for name in NEEDS]
)
@pytest.mark.usefixtures("led")
def test_blocks_run(document: str, eld: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("ELDATA_ROOT", raising=False)
    monkeypatch.setattr(workers.Workers, "_run_units", in_this_process)
    names = NEEDS[document](eld) | {"__name__": "__main__"}
    for number, text in enumerate(blocks(document), 1):
        for large, small in SMALLER.items():
            text = text.replace(large, small)  # noqa: PLW2901 # the same block
        exec(compile(text, f"{document}, block {number}", "exec"), names)  # noqa: S102 # our own
    if document == "docs/published-code.md":
        check_submission()


@pytest.mark.study
def test_the_readme_s_block_as_a_script(eld: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With worker processes, two instead of four, each of which runs the script again up to the guard."""
    monkeypatch.chdir(tmp_path)
    link_eld(eld)
    Path("script.py").write_text(blocks("README.md")[0].replace("workers=4", "workers=2"), encoding="utf-8")
    command = [sys.executable, "-W", "ignore::UserWarning", "script.py"]  # of machines with few CPUs
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=PATIENCE_S, env={**os.environ, "PYTHONPATH": str(ROOT)}
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.count("SonyA7S2") == 1


# --- commands ---------------------------------------------------------------------------------------------------------


TRAININGS = [train_denoiser.parser(), train_video_denoiser.parser()]
PROGRAMS = {program.prog: program for program in (eldata_parser(), capture_parser(), *TRAININGS)}


def test_commands_parse() -> None:
    """Those of documents and of trainings' help, as they would be typed; what has brackets or bars is a synopsis."""
    texts = [program.format_help() for program in TRAININGS]
    for document in DOCUMENTS.values():
        texts += [text for kind, text in _FENCE.findall(document) if kind.partition(" ")[0] in ("", "sh", "console")]
    names = "|".join(map(re.escape, PROGRAMS))
    command = re.compile(rf"^ *(?:\$ )?({names}) ((?!.*[\[|<])(?![ a-z]*:).+)$", re.MULTILINE)
    lines = command.findall("\n".join(texts).replace("\\\n", " "))
    assert set(PROGRAMS) == {name for name, _ in lines}
    assert len(lines) > 90
    for name, words in lines:
        PROGRAMS[name].parse_args(shlex.split(words, comments=True))  # of another, argparse says which and leaves
