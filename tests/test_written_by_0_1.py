"""Files that version 0.1 wrote are still read, and mean the same: see written_by_0_1/README.md.

Nothing but public names and commands stands here. Each reader returns what it found as plain JSON; expected.json holds
what version 0.1 itself found in the same files. Sentences are not held, so that they may be bettered.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
import shutil
import tomllib
import zipfile
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import asdict
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib import import_module
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import torch

from capture import CameraDescription, Plan
from eldata import PackedClips, PackedStore, StreamedPairs, verify
from eldata.datasets import PackedUnpairedClips, PairDataset, StoredFrames, normalise_batch
from eldata.manifest import load_manifest
from eldata.noise import CameraProfile, NoiseModel, NoiseParameters
from eldata.raw import read_raw
from eldata.raw.levels import packed_frame

if TYPE_CHECKING:
    from collections.abc import Iterator

    from eldata.records import FrameRecord

FILES = Path(__file__).parent / "written_by_0_1"
ROOT = Path(__file__).parents[1]
WHOLE: dict[str, Any] = {"crop": None, "augment": False, "levels": "published"}  # 0.1 took these for every set

Reader = Callable[[Path, Path], Any]
READERS: dict[str, Reader] = {}


def reader(function: Reader) -> Reader:
    """Note a function that reads some of the files, given their folder and an empty one to work in."""
    READERS[function.__name__] = function
    return function


def as_json(found: Any) -> Any:
    """Return what a reader found as JSON gives it back; nan, which equals nothing, as text."""
    return json.loads(json.dumps(found, default=str), parse_constant=str)


# --- helpers --------------------------------------------------------------------------------------------------------


def digest(values: Any) -> str:
    """Digest of an array or tensor: type, shape and every value."""
    array = np.ascontiguousarray(values)
    head = f"{array.dtype.str} {array.shape} ".encode()
    return hashlib.sha256(head + array.tobytes()).hexdigest()[:20]


def run(line: str, *paths: Path, code: int = 0) -> None:
    """Run a command line, in which {0}, {1} ... are the paths, from its installed entry point."""
    scripts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["scripts"]
    name, *arguments = line.split()
    module, function = scripts[name].split(":")
    assert getattr(import_module(module), function)([argument.format(*paths) for argument in arguments]) == code, line


def loaded(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8"))


def samples(dataset: Any, *names: str) -> list[Any]:
    """Path or clip, ratio and pixels of every item."""
    texts = ("path", "reference", "camera", "scene", "split", "ratio", *names)
    return [
        {name: item[name] for name in texts if name in item}
        | {name: digest(item[name]) for name in ("input", "target") if name in item}
        for item in (dataset[index] for index in range(len(dataset)))
    ]


def row(record: FrameRecord) -> dict[str, Any]:
    """Return a row of a manifest less the columns that 0.1 did not have, in which nothing is measured."""
    found = asdict(record)
    assert (found.pop("measured_ratio"), found.pop("measured_shift_px")) == (None, None)
    return found


def check_manifest(manifest: Path, root: Path, report: Path) -> Any:
    """Verify by the command, every byte; return how many files."""
    run("eldata verify {0} --root {1} --level full --jobs 1 --json {2}", manifest, root, report)
    (dataset,) = verify(manifest, root, level="full").datasets
    loaded_manifest = load_manifest(manifest)
    return {
        "checked": dataset.files_checked,
        "name": loaded_manifest.name,
        "folder": loaded_manifest.card.folder,
        "rows": [row(record) for record in loaded_manifest.records],
        "counts": loaded_manifest.card.counts,
        "cameras": {name: camera.models for name, camera in loaded_manifest.card.cameras.items()},
    }


# --- raw files, manifests, cards ------------------------------------------------------------------------------------


@reader
def raw_files(files: Path, work: Path) -> Any:
    """DNG, uncompressed and compressed, Bayer and X-Trans."""
    found = {}
    for path in sorted((files / "raw").glob("*.dng")):
        frame = read_raw(path)
        sensor = asdict(frame.sensor)
        assert sensor.pop("matrix_illuminant") == 21  # D65, which 0.1 wrote and did not read
        found[path.name] = [digest(frame.mosaic), sensor, asdict(frame.exposure)]
    return found


@reader
def own_set(files: Path, work: Path) -> Any:
    """A manifest that `eldata lock` filled in, its card and its files."""
    dataset = PairDataset(files / "mine" / "data" / "MINE", files / "mine" / "mine.csv", levels="published")
    return [
        check_manifest(files / "mine" / "mine.csv", files / "mine" / "data", work / "report.json"),
        samples(dataset),
    ]


@reader
def demo_manifest(files: Path, work: Path) -> Any:
    """Manifest and card of the demo's set, without its files."""
    manifest = load_manifest(files / "demo" / "eld-demo.csv")
    return [len(manifest.records), row(manifest.records[5]), asdict(manifest.card)["counts"], manifest.digest]


@reader
def captured_set(files: Path, work: Path) -> Any:
    """What `capture manifest` wrote."""
    return check_manifest(files / "capture" / "captured.csv", files / "capture" / "data", work / "report.json")


def with_0_1_target(folder: Path, sample: Any) -> Any:
    """The sample with its target as 0.1 had it, not clipped where the input is not."""
    frame = read_raw(folder / sample["reference"])
    return sample | {"target": torch.from_numpy(packed_frame(frame, levels="metadata", clip="none"))}


@reader
def synthesised(files: Path, work: Path) -> Any:
    """Noisy frames as DNG and npy, their manifest, and every parameter that was drawn."""
    found = []
    for name in ("dng", "npy"):
        folder = files / "synthesised" / name
        manifest = folder / "manifests" / f"{name}.csv"
        found.append(check_manifest(manifest, folder / "data", work / "report.json"))
        noisy = PairDataset(folder / "data" / name, manifest, levels="metadata", clip="none")
        found.append(samples([with_0_1_target(folder / "data" / name, sample) for sample in noisy]))
        parameters = loaded(folder / "parameters.json")
        NoiseModel(parameters["model"])
        for frame in parameters["frames"]:
            fields = ("gain_dn_per_e", "tukey_lambda", "sigma_tl_dn", "sigma_gauss_dn", "sigma_row_dn")
            drawn = {field: frame[field] for field in fields}
            found.append(
                [frame["path"], NoiseParameters(**drawn, colour_bias_dn=tuple(frame["colour_bias_dn"])).as_dict()]
            )
    return found


# --- stores and shards ----------------------------------------------------------------------------------------------


def checked_store(store: Path, work: Path) -> Any:
    run("eldata verify {0} --level full --jobs 1 --json {1}", store, work / "report.json")
    return loaded(work / "report.json")["datasets"][0]["files_checked"]


@reader
def stores_of_pairs(files: Path, work: Path) -> Any:
    """Format 1, plain and compressed: whole frames are those of the raw files."""
    found = {}
    raw = samples(PairDataset(files / "mine" / "data" / "MINE", files / "mine" / "mine.csv", levels="published"))
    for name in ("mine", "mine-lz4", "mine-zstd"):
        store = files / "stores" / f"{name}.h5"
        held = samples(PackedStore(store, **WHOLE))
        assert held == raw
        found[name] = [checked_store(store, work), held]
    return found


@reader
def crops_of_a_store(files: Path, work: Path) -> Any:
    """Which crops are drawn: item i of epoch e depends on (seed, e, i) alone.

    In transposed crops version 0.1 exchanged the black levels of the greens, a mistake that is made again here.
    """
    store = files / "stores" / "mine.h5"
    blacks = {
        sample["path"]: {name: sample[name] for name in ("input_black_dn", "target_black_dn")}
        for sample in PackedStore(store, **WHOLE).in_dn()
    }
    found = []
    dataset = PackedStore(store, crop=8, crops_per_frame=2, seed=7, levels="published")
    for epoch in range(2):
        dataset.set_epoch(epoch)
        found.append(samples([normalise_batch(sample | blacks[sample["path"]]) for sample in dataset.in_dn()]))
    return found


@reader
def stores_of_clips(files: Path, work: Path) -> Any:
    """Format 2 (RGB) and format 1 (mosaics): clips with a reference and without."""
    rgb, raw = (files / "stores" / f"{name}.h5" for name in ("drv", "drv-raw"))
    return [
        checked_store(rgb, work),
        checked_store(raw, work),
        samples(PackedClips(rgb, window=5, crop=None, augment=False)),
        samples(PackedUnpairedClips(rgb, window=5, crop=None, augment=False)),
        samples(PackedClips(raw, window=5, crop=None, augment=False)),
        samples(PackedClips(rgb, window=5, crop=8, seed=3)),
    ]


@reader
def store_of_clean_frames(files: Path, work: Path) -> Any:
    """Format 1 without a manifest: frames of any size and CFA."""
    store = files / "stores" / "clean.h5"
    frames = StoredFrames(store)
    found = []
    for index in range(len(frames)):
        frame = frames.frame(index)
        found.append([digest(np.asarray(frame.mosaic[:, :])), frame.cfa, frame.black_level_dn, frame.white_level_dn])
    return [checked_store(store, work), found]


@reader
def unfinished_store(files: Path, work: Path) -> Any:
    """A store that was begun and not finished goes on, and is then that of one run."""
    for path in (files / "stores").glob("begun.h5.part*"):
        shutil.copy(path, work / path.name)
    store = work / "begun.h5"
    manifest, root = files / "mine" / "mine.csv", files / "mine" / "data"
    run("eldata pack mine --manifest {0} --root {1} -o {2} --jobs 1", manifest, root, store)
    whole = samples(PackedStore(files / "stores" / "mine.h5", **WHOLE))
    assert samples(PackedStore(store, **WHOLE)) == whole
    return [checked_store(store, work), sorted(path.name for path in work.glob("begun*"))]


@reader
def shards(files: Path, work: Path) -> Any:
    """Tiles and whole frames."""
    found = []
    for name in ("tiles", "whole"):
        folder = files / "shards" / name
        run("eldata verify {0} --json {1}", folder / "index.json", work / "report.json")
        assert loaded(work / "report.json")["problems"] == []
        items = [
            [item["path"], item["ratio"], digest(item["input"]), digest(item["target"])]
            for item in StreamedPairs(str(folder), augment=False, shuffle_buffer=1)
        ]
        found.append(sorted(items, key=str))
    return found


# --- results --------------------------------------------------------------------------------------------------------


def compared(line: str, *paths: Path, work: Path) -> Any:
    """Compare results by the command; return methods, groups and their means."""
    run(f"{line} --json {work / 'out.json'}", *paths)
    found = loaded(work / "out.json")
    return {
        "methods": [[method["scored"], method["protocol"]["name"]] for method in found["methods"]],
        "common": found["common"],
        "groups": [[group[name] for name in ("camera", "ratio", "images", "means")] for group in found["groups"]],
    }


@reader
def results_of_images(files: Path, work: Path) -> Any:
    """One protocol, all of them in one file, one's own, incomplete ones, those of the demo."""
    results = files / "results"
    eld, better, everything, own, some = (
        results / f"{name}.json" for name in ("eld", "better", "all", "hallway", "incomplete")
    )
    demo = [files / "demo" / f"{name}.json" for name in ("amplified", "dct")]
    return [
        compared("eldata compare {0} {1}", eld, better, work=work),
        compared("eldata compare {0} {1} --protocol eld", everything, eld, work=work),
        compared("eldata compare {0} {0} --protocol eld-uncorrected --name a --name b", everything, work=work),
        compared("eldata compare {0} {0} --name a --name b", own, work=work),
        compared("eldata compare {0} {1}", eld, some, work=work),
        compared("eldata compare {0} {1}", *demo, work=work),
    ]


def test_formats_of_a_comparison(tmp_path: Path) -> None:
    results = [FILES / "results" / f"{name}.json" for name in ("eld", "better")]
    for form in ("text", "markdown", "latex"):
        run(f"eldata compare {{0}} {{1}} --format {form}", *results)
    run("eldata compare {0} {1} --html {2}", *results, tmp_path / "page.html")
    assert "better" in (tmp_path / "page.html").read_text(encoding="utf-8")


def test_results_of_clips_are_compared(tmp_path: Path) -> None:
    results = FILES / "results"
    run("eldata compare {0} {1} --json {2}", results / "drv.json", results / "drv-some.json", tmp_path / "out.json")


@reader
def tables_of_scores(files: Path, work: Path) -> Any:
    """The columns that scripts rely on."""
    found = {}
    for name in ("eld", "all", "drv"):
        with (files / "results" / f"{name}.csv").open(encoding="utf-8", newline="") as file:
            found[name] = list(csv.DictReader(file))
    assert {*found["eld"][0]} >= {"path", "camera", "scene", "iso", "ratio", "psnr_db", "ssim", "rescale"}
    scored = loaded(files / "results" / "eld.json")
    assert [float(row["psnr_db"]) for row in found["eld"]] == [image["psnr_db"] for image in scored["images"]]
    return found


# --- profiles and protocols -----------------------------------------------------------------------------------------


@reader
def camera_profile(files: Path, work: Path) -> Any:
    """What `eldata calibrate` wrote: the profile, and what is drawn from it."""
    path = files / "calibration" / "profile.json"
    run("eldata profile show {0} --seed 5 --json {1}", path, work / "shown.json")
    profile = CameraProfile.load(str(path))
    generator = np.random.default_rng(11)
    drawn = [profile.sample(generator, iso=iso, row="any").as_dict() for iso in (None, None, 400.0)]
    return [profile.as_dict(), drawn]


@reader
def calibration_manifest(files: Path, work: Path) -> Any:
    """Manifest and card of calibration frames, without the files."""
    manifest = load_manifest(files / "calibration" / "calibration-demo.csv")
    roles = [record.role for record in manifest.records]
    return [len(roles), roles.count("bias"), manifest.digest]


@reader
def custom_protocol(files: Path, work: Path) -> Any:
    """A protocol of the user's own: every field, and the digest that results name, by the rule of 0.1."""
    from eldata.evaluation import load_results
    from eldata.protocols import fields_digest_0_1, load_protocol

    path = files / "results" / "hallway.toml"
    run("eldata protocols {0} --json {1}", path, work / "shown.json")
    protocol = load_protocol(path)
    (result,) = load_results(files / "results" / "hallway.json")
    assert result.digest == protocol.digest
    digest = result.provenance["protocol_digest"]
    assert digest == fields_digest_0_1(result.protocol.as_dict())
    return [protocol.name, protocol.title, protocol.levels, protocol.region, protocol.ratios, digest]


# --- capture --------------------------------------------------------------------------------------------------------


@reader
def camera_description(files: Path, work: Path) -> Any:
    path = files / "capture" / "camera.json"
    run("capture camera {0} --json {1}", path, work / "shown.json")
    assert CameraDescription.load(path).name == loaded(path)["name"]
    return loaded(work / "shown.json")


@reader
def plans(files: Path, work: Path) -> Any:
    """With notes, a scene that was metered again, calibration frames; the checklists made of them."""
    found = []
    for name in ("plan", "calibration-plan"):
        path = files / "capture" / f"{name}.json"
        run("capture plan {0} --json {1}", path, work / "shown.json")
        assert loaded(work / "shown.json") == loaded(path), "what is read is what is written"
        run("capture checklist {0} -o {1} --json {2}", path, work / "list.html", work / "list.json")
        plan = Plan.load(path)
        found.append([loaded(work / "list.json")["plan"], len(plan.shots), asdict(plan.shots[1][1].setting)])
    return found


@reader
def progress(files: Path, work: Path) -> Any:
    """What the checklist's page exports."""
    from capture.checklist import load_progress

    plan = Plan.load(files / "capture" / "plan.json")
    return asdict(load_progress(files / "capture" / "progress.json", plan))


@reader
def mapping(files: Path, work: Path) -> Any:
    """A mapping of files to shots that `capture manifest` left to be edited."""
    folder = files / "capture"
    shutil.copytree(folder / "card", work / "card")
    text = (folder / "again.mapping.json").read_text(encoding="utf-8")
    (work / "mapping.json").write_text(text.replace("{files}/capture", str(work)), encoding="utf-8")
    paths = folder / "plan.json", work / "card", work / "again.csv", work / "mapping.json"
    run("capture manifest {0} {1} -o {2} --mapping {3} --jobs 1", *paths)
    return [row(record) for record in load_manifest(work / "again.csv").records]


# --- a download that broke off --------------------------------------------------------------------------------------


@contextmanager
def serving(content: bytes, *, at_most: int | None = None) -> Iterator[tuple[str, list[str | None]]]:
    """Serve a file, with ranges; yields its address and the ranges that were asked for."""
    ranges: list[str | None] = []

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_GET(self) -> None:
            wanted = self.headers.get("Range")
            ranges.append(wanted)
            start = int(wanted.removeprefix("bytes=").rstrip("-")) if wanted else 0
            self.send_response(206 if wanted else 200)
            self.send_header("Content-Length", str(len(content) - start))
            self.send_header("Content-Type", "application/zip")
            self.send_header("ETag", '"one"')
            self.send_header("Accept-Ranges", "bytes")
            if wanted:
                self.send_header("Content-Range", f"bytes {start}-{len(content) - 1}/{len(content)}")
            self.end_headers()
            self.wfile.write(content[start:at_most])
            self.close_connection = True

        def log_message(self, format: str, *arguments: Any) -> None:  # noqa: A002 # its name in the base class
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = Thread(target=server.serve_forever, daemon=True)
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_port}/set.zip", ranges
        finally:
            server.shutdown()
            thread.join()


def archive() -> bytes:
    """The file that was on its way."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as file:
        file.writestr(zipfile.ZipInfo("ELD/SonyA7S2/scene-1/IMG_0001.ARW"), np.random.default_rng(4).bytes(40_000))
    return buffer.getvalue()


@reader
def unfinished_download(files: Path, work: Path) -> Any:
    """It goes on where it ended: the part's note names its file by address, size and mark."""
    from eldata.download import Fetcher, fetch_dataset, overview
    from eldata.manifest import save_records, shipped_manifest

    part, note = (files / "download" / f"set.zip.part{end}" for end in ("", ".json"))
    held = work / "data" / "archives"
    held.mkdir(parents=True)
    shutil.copy(part, held)
    save_records(work / "eld.csv", shipped_manifest("eld").records)
    card = loaded(ROOT / "manifests" / "eld.json")
    with pytest.MonkeyPatch.context() as patch, serving(archive()) as (address, ranges):
        patch.setenv("NO_PROXY", "127.0.0.1")
        (held / note.name).write_text(json.dumps(loaded(note) | {"address": address}), encoding="utf-8")
        card["downloads"] = [{"address": address, "direct": True}]
        (work / "eld.json").write_text(json.dumps(card), encoding="utf-8")
        manifest = load_manifest(work / "eld.csv")
        # Version 0.1 has a record of its own for a download of the card.
        downloads: Any = getattr(overview(manifest, work / "data"), "places", manifest.card.downloads)
        fetch_dataset(downloads[0], manifest, work / "data", Fetcher(plain_http_hosts=["127.0.0.1"]))
    assert (held / "set.zip").read_bytes() == archive()
    there = sorted(path.relative_to(work).as_posix() for path in (work / "data").rglob("*") if path.is_file())
    return [ranges, there]


# --- the tests: after the readers, which they are made of -----------------------------------------------------------


@pytest.fixture(scope="module")
def expected() -> Any:
    return loaded(FILES / "expected.json")


@pytest.mark.parametrize("name", sorted(READERS))
def test_files_mean_what_they_meant(name: str, expected: Any, tmp_path: Path) -> None:
    check_equal(as_json(READERS[name](FILES, tmp_path)), expected[name], name)


def check_equal(found: Any, wanted: Any, place: str) -> None:
    """Compare part by part; numbers to twelve digits, the last ones being those of a machine's logarithm."""
    if isinstance(wanted, dict):
        assert set(found) == set(wanted), place
        for key, value in wanted.items():
            check_equal(found[key], value, f"{place}.{key}")
    elif isinstance(wanted, list):
        assert len(found) == len(wanted), place
        for index, value in enumerate(wanted):
            check_equal(found[index], value, f"{place}[{index}]")
    elif isinstance(wanted, float):
        assert found == pytest.approx(wanted, rel=1e-12, abs=1e-12), place
    else:
        assert found == wanted, place


def test_nothing_is_forgotten(expected: Any) -> None:
    assert set(expected) == set(READERS)
