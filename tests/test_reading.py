"""Every reader of text that people hand over: numbers that would take for ever are refused in its own words."""

from __future__ import annotations

import json
from dataclasses import asdict
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import pytest

from capture.camera import EXAMPLE, CameraDescription
from capture.plan import Plan, make_plan
from capture.protocol import CaptureProtocol
from capture.shutter import parse_seconds
from eldata.base.clusters import _scheduler
from eldata.errors import EldataError
from eldata.evaluation.published import COLUMNS as PUBLISHED_COLUMNS
from eldata.evaluation.published import load_published
from eldata.isp.response_files import read_response_table
from eldata.manifest.card import load_card
from eldata.manifest.catalogue import shipped_manifest
from eldata.manifest.table import COLUMNS, load_records
from eldata.noise.profile import CameraProfile
from eldata.protocols.named import load_protocol
from eldata.records import Exposure, PairRecord, Sensor
from eldata.sources.shards.index import Facts, Side, facts_text, parse_facts, parse_index
from eldata.sources.store.format import PackedFile, StoredFrame, facts_line, frames_in
from manifests.sid_scenes import SHORT_EXPOSURES, load_scenes

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

ENDLESS = ("1e16000000", "9" * 10_000, "1/" + "9" * 10_000)


def changed(content: Any, keys: tuple[str | int, ...], value: object) -> Any:
    inner = content
    for key in keys[:-1]:
        inner = inner[key]
    inner[keys[-1]] = value
    return content


def as_number(content: Any, text: str) -> str:
    """JSON in which a text stands as a number: ``1e16000000`` without its quotation marks."""
    return json.dumps(content).replace(json.dumps(text), text)


def read_profile(path: Path, text: str) -> None:
    data = {"schema": 1} | CameraProfile.load("SonyA7S2").as_dict()
    path.write_text(as_number(changed(data, ("gauss_fit", "slope"), text), text))
    CameraProfile.load(path.rename(path.with_suffix(".json")))


def read_card(path: Path, text: str) -> None:
    path.write_text(as_number(changed(asdict(shipped_manifest("eld").card), ("counts", "noisy"), text), text))
    load_card(path)


def read_table(path: Path, text: str) -> None:
    row = dict.fromkeys(COLUMNS, "") | {"path": "a", "role": "bias", "camera": "c", "exposure_s": text}
    path.write_text(f"{','.join(COLUMNS)}\n{','.join(row.values())}\n")
    load_records(path)


def read_protocol(path: Path, text: str) -> None:
    path.write_text(f'base = "eld"\nname = "x"\ntitle = "x"\ndata_range = {text}\n')
    load_protocol(path)


def read_published(path: Path, text: str) -> None:
    source: dict[str, object] = {
        "label": "x",
        "citation": "x",
        "url": "x",
        "commit": None,
        "tables": {"1": "x"},
        "known": [],
        "unknown": [],
    }
    (path.parent / "sources.json").write_text(json.dumps({"one": source}))
    row = dict.fromkeys(PUBLISHED_COLUMNS, "x") | {"source": "one", "table": "1", "psnr_db": text}
    row |= {"ratio": "", "pairs": "", "ssim": "", "st_rred": ""}
    path.with_suffix(".csv").write_text(f"{','.join(PUBLISHED_COLUMNS)}\n{','.join(row.values())}\n")
    load_published(path.parent)


def read_response(path: Path, text: str) -> None:
    path.write_text(f"0 0\n{text} 1\n")
    read_response_table(path)


def read_scenes(path: Path, text: str) -> None:
    path.write_text(f"scene,iso,long,{','.join(SHORT_EXPOSURES)}\n00001,{text},10s,1,1,1\n")
    load_scenes(path)


def read_camera(path: Path, text: str) -> None:
    EXAMPLE.save(path)
    path.write_text(json.dumps(changed(json.loads(path.read_text()), ("shutter", "step"), text)))
    CameraDescription.load(path)


def read_plan(path: Path, text: str) -> None:
    content = make_plan(EXAMPLE, CaptureProtocol(), {"scene-1": Fraction(1)}).as_dict()
    path.write_text(json.dumps(changed(content, ("scenes", 0, "metered_s"), text)))
    Plan.load(path)


def read_seconds(path: Path, text: str) -> None:  # of the command line
    parse_seconds(text)


SENSOR = Sensor("make", "model", ((0, 1), (3, 2)), (0.0,) * 4, 16383.0, 4, 4)


def read_store(path: Path, text: str) -> None:
    frame = StoredFrame("000000", "a", "bias", SENSOR, Exposure(Fraction(100)), "x", PackedFile(1, "x", "x"))
    data = json.loads(facts_line(frame, {}))
    frames_in(json.dumps(changed(data, (5, "exposure_s"), text)).encode())


def read_facts(path: Path, text: str) -> None:
    side = Side(SENSOR, Exposure(Fraction(100), Fraction(1, 30), None))
    record = PairRecord("a", "b", "c", "", "", Fraction(100), Fraction(1), Fraction(100), ())
    data = json.loads(facts_text(Facts(record, Fraction(100), 0, 0, side, side)))
    parse_facts(json.dumps(changed(data, ("input", "exposure", "exposure_s"), text)).encode())


READERS: tuple[Callable[[Path, str], None], ...] = (
    *(read_profile, read_card, read_table, read_protocol, read_published, read_response, read_scenes),
    *(read_camera, read_plan, read_seconds, read_store, read_facts),
)


@pytest.mark.parametrize("read", READERS, ids=lambda read: read.__name__)
def test_numbers_without_an_end_are_refused(read: Callable[[Path, str], None], tmp_path: Path) -> None:
    for number, text in enumerate(ENDLESS):
        folder = tmp_path / str(number)
        folder.mkdir()
        with pytest.raises(EldataError) as caught:
            read(folder / "file", text)
        assert len(str(caught.value)) < 1000


@pytest.mark.parametrize("read", READERS, ids=lambda read: read.__name__)
def test_the_same_files_are_read_with_another_number(read: Callable[[Path, str], None], tmp_path: Path) -> None:
    """Or the test above would pass on files that are wrong elsewhere."""
    read(tmp_path / "file", "1" if read is not read_camera else "1/3")


def test_other_readers_of_text(tmp_path: Path) -> None:
    path = tmp_path / "scheduler.json"
    for content in ("", "[]", '{"address": 1e16000000}', "[" * 100_000, '{"address": NaN}'):
        path.write_text(content)
        with pytest.raises(EldataError, match="as dask scheduler --scheduler-file writes it"):
            _scheduler(str(path))
        with pytest.raises(EldataError):
            parse_index("index.json", content.encode())
    path.write_text('{"address": "tcp://host:8786"}')
    assert _scheduler(str(path)) == "tcp://host:8786"
