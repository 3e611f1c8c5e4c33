"""Makes the files of this folder; README.md says how. It refuses to run with another version than 0.1.0.

Only public names and commands stand here, but they are those of 0.1: it is kept as a record, not to be kept running.
"""
# Later versions have other names.
# mypy: ignore-errors

from __future__ import annotations

import json
import shutil
import tempfile
from collections import Counter
from contextlib import suppress
from datetime import datetime, timedelta
from fractions import Fraction
from pathlib import Path
from typing import Any

import imagecodecs
import numpy as np

import eldata
from capture import Plan
from eldata.datasets import DRVDataset, PairDataset
from eldata.download import DownloadError, Fetcher, Patience
from eldata.evaluation import save_clip_prediction, save_prediction
from eldata.manifest import save_records, shipped_manifest
from eldata.raw import write_dng
from eldata.records import Exposure, FrameRecord, Role, Sensor
from tests.test_written_by_0_1 import READERS, archive, as_json, run, serving

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
SIZE = (36, 44)
BLACK = (510.0, 511.0, 513.0, 514.0)
MATRIX = ((0.7, -0.2, -0.05), (-0.4, 1.2, 0.2), (-0.05, 0.15, 0.6))
XTRANS = (
    (1, 1, 0, 1, 1, 2),
    (1, 1, 2, 1, 1, 0),
    (2, 0, 1, 0, 2, 1),
    (1, 1, 2, 1, 1, 0),
    (1, 1, 0, 1, 1, 2),
    (0, 2, 1, 2, 0, 1),
)
KEPT = ("make.py", "README.md", "__pycache__")


def sensor(size: tuple[int, int] = SIZE, *, model: str = "Mine 1") -> Sensor:
    return Sensor("Maker", model, ((3, 2), (0, 1)), BLACK, 15300.0, *size, (2.1, 1.0, 1.6, 1.0), MATRIX)


def picture(size: tuple[int, int], seed: int, *, bright: bool = True) -> Any:
    """Waves with noise, some of it below black and some saturated; (H, W) uint16."""
    generator = np.random.default_rng(seed)
    rows, columns = np.mgrid[: size[0], : size[1]]
    wave = 0.5 + 0.5 * np.sin(rows / 7) * np.cos(columns / 5)
    mosaic = 505 + (15500 if bright else 150) * wave + generator.normal(0, 40 if bright else 8, size)
    return np.clip(np.rint(mosaic), 1, 16383).astype(np.uint16)


def exposed(iso: int, exposure_s: Fraction) -> Exposure:
    return Exposure(Fraction(iso), exposure_s, Fraction(28, 5))


def raw_files(folder: Path) -> None:
    folder.mkdir()
    write_dng(folder / "bayer.dng", picture(SIZE, 1), sensor(), exposed(100, Fraction(4)), compression="none")
    write_dng(
        folder / "jpeg.dng", picture((38, 50), 2), sensor((38, 50)), exposed(200, Fraction(1, 3)),
        compression="lossless-jpeg",
    )  # fmt: skip
    xtrans = Sensor("Maker", "X-T2", XTRANS, (1022.0,) * 3, 16200.0, 42, 48)
    write_dng(folder / "xtrans.dng", picture((42, 48), 3), xtrans, exposed(400, Fraction(10, 13)))


def own_set(folder: Path) -> None:
    """Two scenes of a reference and two noisy frames; `eldata lock` fills in sizes and hashes."""
    records = []
    for scene in range(2):
        reference = f"s{scene}/clean.dng"
        frames: list[tuple[str, Role, int, Fraction, Fraction | None]]
        frames = [(reference, "reference", 100, Fraction(4), None)]
        frames += [(f"s{scene}/x{r}.dng", "noisy", 1600, Fraction(1, 4) / r, Fraction(r)) for r in (50, 100)]
        for number, (path, role, iso, exposure_s, ratio) in enumerate(frames):
            file = folder / "data" / "MINE" / path
            file.parent.mkdir(parents=True, exist_ok=True)
            pixels = picture(SIZE, 10 * scene + number, bright=ratio is None)
            write_dng(file, pixels, sensor(), exposed(iso, exposure_s))
            records.append(
                FrameRecord(
                    path, role, "Mine", scene=f"s{scene}", iso=Fraction(iso), exposure_s=exposure_s, ratio=ratio,
                    reference=None if ratio is None else reference, flags=("misaligned",) if scene and ratio else (),
                )
            )  # fmt: skip
    card = {
        "name": "mine",
        "title": "A set of one's own",
        "version": "1.0",
        "folder": "MINE",
        "citation": "none",
        "licence": "ours",
        "homepage": "https://example.org/mine",
        "cfa": "bayer",
        "cameras": {"Mine": {"models": ["Mine 1"]}},
        "counts": dict(Counter(record.role for record in records)),
        "subsets": [
            {"name": "x50", "title": "the brighter ones", "source": "us", "pairs": 2, "paths": "*/x50.dng"},
            {"name": "all", "title": "all", "source": "us", "pairs": 4},
        ],
    }
    (folder / "mine.json").write_text(json.dumps(card, indent=2) + "\n", encoding="utf-8")
    save_records(folder / "mine.csv", records)
    run("eldata lock {0} --root {1} --jobs 1", folder / "mine.csv", folder / "data")


def clips(folder: Path, size: tuple[int, int], frames: int) -> None:
    """Preprocessed clips and camera raws of DRV's names, with a manifest of just these."""
    folder.mkdir()
    published = shipped_manifest("drv")
    records = [record for record in published.records if record.scene in ("0007", "0013", "M0003")]
    card = json.loads((ROOT / "manifests" / "drv.json").read_text(encoding="utf-8"))
    roles = [record.role for record in records]
    card |= {"counts": {role: roles.count(role) for role in sorted(set(roles))}, "subsets": []}
    (folder / "drv.json").write_text(json.dumps(card), encoding="utf-8")
    save_records(folder / "drv.csv", records)
    for clip in ("0007", "0013", "M0003"):
        rgb, raw = folder / "data" / "DRV" / "VBM4D_rawRGB" / clip, folder / "raw" / "DRV" / "short" / clip
        rgb.mkdir(parents=True)
        raw.mkdir(parents=True)
        for number in range(1, frames + 1):
            pixels = np.random.default_rng([ord(clip[0]), int(clip[1:]), number]).integers(
                0, 65536, (*size, 3), np.uint16
            )
            (rgb / f"{number:04d}.png").write_bytes(imagecodecs.png_encode(pixels))
        if clip.startswith("M"):
            continue
        camera = Sensor("SONY", "DSC-RX100M6", ((0, 1), (3, 2)), (801.0, 799.0, 802.0, 800.0), 16300.0, 26, 30)
        for number in range(998, 1003):
            pixels = picture((26, 30), number + int(clip), bright=False)
            write_dng(raw / f"DSC{number:05d}.ARW", pixels, camera, exposed(6400, Fraction(1, 50)))
        for root, name in (("data", "half0001_0.png"), ("raw", "DSC00001.ARW")):
            long = folder / root / "DRV" / "long" / clip
            long.mkdir(parents=True)
            if root == "raw":
                write_dng(long / name, picture((26, 30), int(clip)), camera, exposed(200, Fraction(64)))
            else:
                pixels = np.random.default_rng(int(clip)).integers(0, 65536, (*size, 3), np.uint16)
                (long / name).write_bytes(imagecodecs.png_encode(pixels))


def stores(folder: Path, mine: Path, work: Path) -> None:
    """Format 1: pairs, clips of raws, clean frames. Format 2: clips of RGB frames. And one that was begun."""
    folder.mkdir()
    packing = "eldata pack mine --manifest {0} --root {1} -o {2} --jobs 1"
    run(packing, mine / "mine.csv", mine / "data", folder / "mine.h5")
    run(f"{packing} --compression lz4", mine / "mine.csv", mine / "data", folder / "mine-lz4.h5")
    run(f"{packing} --compression zstd", mine / "mine.csv", mine / "data", folder / "mine-zstd.h5")
    run("eldata pack {0} -o {1} --jobs 1", folder.parent / "raw", folder / "clean.h5")
    small = work / "small"
    clips(small, (20, 26), 5)
    run(
        "eldata pack drv --manifest {0} --root {1} -o {2} --jobs 1",
        small / "drv.csv",
        small / "data",
        folder / "drv.h5",
    )
    run("eldata pack drv-raw --root {0} -o {1} --jobs 1", small / "raw", folder / "drv-raw.h5")
    shutil.copytree(mine, work / "mine")
    spoilt = work / "mine" / "data" / "MINE" / "s1" / "x100.dng"
    spoilt.write_bytes(spoilt.read_bytes()[:100])
    run(packing, work / "mine" / "mine.csv", work / "mine" / "data", folder / "begun.h5", code=2)


def results(folder: Path, mine: Path, work: Path) -> None:
    folder.mkdir()
    generator = np.random.default_rng(3)
    for name, sigma in (("preds", 0.02), ("better", 0.01)):
        dataset = PairDataset(mine / "data" / "MINE", mine / "mine.csv")
        for sample in (dataset[index] for index in range(len(dataset))):
            target = sample["target"].numpy()
            noisy = 1.1 * target + generator.normal(0, sigma, target.shape)
            save_prediction(work / name, sample["path"], noisy.astype(np.float32))
    (folder / "hallway.toml").write_text(
        'base = "eld"\nname = "hallway"\ntitle = "Our hallway: the cameras\' own levels, without edges"\n'
        'levels = "metadata"\nregion = "border-2"\nratios = [50, 100]\nssim_covariance = "population"\n',
        encoding="utf-8",
    )
    line = "eldata evaluate {0} --manifest {1} --root {2} --jobs 1 --subset all --json {3}"
    paths = mine / "mine.csv", mine / "data"
    run(f"{line} --csv {{4}}", work / "preds", *paths, folder / "eld.json", folder / "eld.csv")
    run(line, work / "better", *paths, folder / "better.json")
    run(f"{line} --protocol {{4}}", work / "preds", *paths, folder / "hallway.json", folder / "hallway.toml")
    line = line.replace(" --subset all", "")
    run(f"{line} --csv {{4}} --protocol all", work / "preds", *paths, folder / "all.json", folder / "all.csv")
    (work / "better" / "s1" / "x50.npy").unlink()
    run(f"{line} --allow-missing --subset all", work / "better", *paths, folder / "incomplete.json")

    large = work / "large"
    clips(large, (48, 56), 9)
    drv = large / "drv.csv"
    for record in DRVDataset(large / "data" / "DRV", split="test", frames="evaluation", manifest=drv).records:
        frames = generator.uniform(-0.1, 1.2, (5, 3, 48, 56)).astype(np.float32)
        save_clip_prediction(work / "clips", record, frames)
    line = "eldata evaluate {0} --manifest {1} --root {2} --clip 0007 --clip 0013 --jobs 1 --json {3}"
    paths = drv, large / "data"
    run(f"{line} --csv {{4}}", work / "clips", *paths, folder / "drv.json", folder / "drv.csv")
    (work / "clips" / "0013" / "0006.npy").unlink()
    run(f"{line} --allow-missing", work / "clips", *paths, folder / "drv-some.json")


def captured(folder: Path, work: Path) -> None:
    """A plan of two small scenes, the shoot of it, and what the commands make of both."""
    folder.mkdir()
    camera, plan, again = folder / "camera.json", folder / "plan.json", folder / "calibration-plan.json"
    run("capture camera --example {0}", camera)
    described = json.loads(camera.read_text(encoding="utf-8"))
    described |= {"name": "Mine", "models": ["Mine 1"], "raw_extension": ".dng"}
    camera.write_text(json.dumps(described, indent=2) + "\n", encoding="utf-8")
    run("capture plan --camera {0} --scenes 2 --metered 4 --isos 800 --factors 10 -o {1}", camera, plan)
    run("capture plan {0} --remeter scene-2=30 --note scene-1=bookshelf", plan)
    calibration = "--calibration --flat-clips-at 1/2 --calibration-isos 100 800 --bias-frames 4"
    run(f"capture plan {{0}} {calibration} -o {{1}}", plan, again)
    shots = [shot for scene in json.loads(plan.read_text(encoding="utf-8"))["scenes"] for shot in scene["shots"]]
    now = datetime(2026, 11, 21, 23, 59, 30)  # noqa: DTZ001 # a camera's clock
    (folder / "card").mkdir()
    for number, shot in enumerate([shots[0], *shots]):  # the first one twice: something to decide
        now += timedelta(seconds=7)
        exposure = exposed(shot["iso"], Fraction(shot["nominal_s"]))
        pixels = picture((24, 32), number, bright=shot["role"] == "reference")
        write_dng(folder / "card" / f"DSC{number:05d}.dng", pixels, sensor((24, 32)), exposure, taken=now)
    matching = "capture manifest {0} {1} -o {2} --jobs 1"
    run(matching, plan, folder / "card", folder / "again.csv", code=1)  # leaves the mapping
    taken = folder / "captured.csv"
    run(f"{matching} --yes --copy-to {{3}}", plan, folder / "card", taken, folder / "data" / "mine")
    progress(folder, work)


def progress(folder: Path, work: Path) -> None:
    """What the page's script exports, with ticks and remarks (tests/capture holds the script against this form)."""
    run("capture checklist {0} -o {1} --json {2}", folder / "plan.json", work / "list.html", work / "list.json")
    plan = Plan.load(folder / "plan.json")
    exported = {
        "kind": "capture-progress",
        "schema": 1,
        "plan": json.loads((work / "list.json").read_text(encoding="utf-8"))["plan"],
        "camera": plan.camera.name,
        "preparation": [],
        "scenes": [
            {
                "name": scene.name,
                "metered_s": str(scene.metered_s),
                "shots": [
                    {
                        "number": shot.number,
                        "count": 1,
                        "role": shot.role,
                        "iso": shot.iso,
                        "dial": shot.setting.dial,
                        "taken_at": shot.setting.dial if scene.name == "scene-1" else None,
                        "repeats": int(shot.number == 1),
                        "file": f"DSC{shot.number:05d}",
                        "remark": "a lorry went by" if shot.number == 2 else "",
                    }
                    for shot in scene.shots
                ],
            }
            for scene in plan.scenes
        ],
        "calibration": [],
    }
    (folder / "progress.json").write_text(json.dumps(exported, indent=1), encoding="utf-8")


def broken_download(folder: Path) -> None:
    """Every connection breaks after 20,000 bytes, and there is one try."""
    folder.mkdir()
    with serving(archive(), at_most=20_000) as (address, _), suppress(DownloadError):
        patience = Patience(tries=1, first_wait_s=0.001, longest_wait_s=0.002)
        Fetcher(patience, plain_http_hosts=["127.0.0.1"]).fetch(address, folder / "set.zip")


def without_places(places: dict[str, str]) -> None:
    """Take this machine's folders out of the texts, which mention them."""
    for path in sorted(HERE.rglob("*.json*")):
        text = path.read_text(encoding="utf-8")
        for place, name in places.items():
            text = text.replace(place, name)
        path.write_text(text, encoding="utf-8")


def main() -> None:
    if eldata.__version__ != "0.1.0":
        raise SystemExit(f"this is eldata {eldata.__version__}: these files are to be written by 0.1.0")
    for path in HERE.iterdir():
        if path.name not in KEPT:
            shutil.rmtree(path) if path.is_dir() else path.unlink()
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        raw_files(HERE / "raw")
        own_set(HERE / "mine")
        stores(HERE / "stores", HERE / "mine", work)
        results(HERE / "results", HERE / "mine", work)
        captured(HERE / "capture", work)
        broken_download(HERE / "download")
        (HERE / "shards").mkdir()
        store = HERE / "stores" / "mine.h5"
        run("eldata shard {0} -o {1} --tile 16 --samples-per-shard 6 --seed 2", store, HERE / "shards" / "tiles")
        run("eldata shard {0} -o {1} --tile whole", store, HERE / "shards" / "whole")
        line = "eldata synthesize {0} -o {1} --camera SonyA7S2 --seed 5 --jobs 1 --format"
        (HERE / "synthesised").mkdir()
        (work / "bayer").mkdir()
        shutil.copy(HERE / "raw" / "bayer.dng", work / "bayer")
        run(f"{line} dng --per-image 2", work / "bayer", HERE / "synthesised" / "dng")
        run(f"{line} npy --iso 1600", work / "bayer", HERE / "synthesised" / "npy")
        run("eldata demo {0} --scenes 1 --jobs 1", work / "demo")
        (HERE / "demo").mkdir()
        for file in ("manifests/eld-demo.csv", "manifests/eld-demo.json", "amplified.json", "dct.json"):
            shutil.copy(work / "demo" / file, HERE / "demo")
        run("eldata demo {0} --calibration --jobs 1", work / "frames")
        (HERE / "calibration").mkdir()
        shutil.copy(work / "frames" / "DemoGamma.json", HERE / "calibration" / "profile.json")
        for file in ("calibration-demo.csv", "calibration-demo.json"):
            shutil.copy(work / "frames" / "manifests" / file, HERE / "calibration")
        without_places({str(work): "{work}", str(HERE): "{files}"})
    record()


def record() -> None:
    """Note what this version finds in the files."""
    found = {}
    for name, read in sorted(READERS.items()):
        with tempfile.TemporaryDirectory() as place:
            found[name] = as_json(read(HERE, Path(place)))
    (HERE / "expected.json").write_text(json.dumps(found, indent=1, sort_keys=True) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
