"""A set laid out for the package ``datasets``: what that package reads, against LibRaw and eldata's own readers."""

from __future__ import annotations

import csv
import json
import logging
import re
import shutil
import tarfile
from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pytest
import yaml

pytest.importorskip("datasets", reason="needs datasets, which only the tests use")

from datasets import get_dataset_config_names, load_dataset
from datasets.exceptions import NonMatchingSplitsSizesError

from eldata.cli.main import main
from eldata.datasets import PackedStore, StreamedPairs, evaluation_loader
from eldata.errors import ArgumentError, EldataError
from eldata.integrations.exports import export_hub
from eldata.integrations.exports.hub_card import HubLayout, hub_page
from eldata.manifest import shipped_manifest, shipped_names
from eldata.manifest.card import save_card
from eldata.manifest.catalogue import load_manifest
from eldata.manifest.pairs import select_pairs
from eldata.manifest.table import number_text, save_records
from eldata.manifest.writing import save_manifest
from eldata.sources.shards import ShardError, write_shards
from tests.cases import in_one_test
from tests.integrations.published_sets import LONG_S, SENSOR, SHORT_S, photograph, sid_like
from tests.shared import made_once

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    from eldata.manifest.catalogue import Manifest

SPLITS = ("train", "test", "val")
LAST_COMES_LAST = 14  # a seed with which the sixth of six whole frames is the last of the shuffled ones


class OwnSet(NamedTuple):
    """A set of three splits, its store, and folders of shards: whole frames, and tiles. Not to be changed."""

    manifest: Manifest
    store: Path
    whole: dict[str, Path]
    tiles: dict[str, Path]

    @property
    def file(self) -> Path:
        return self.manifest.path


def own_set(folder: Path) -> OwnSet:
    manifest = load_manifest(folder / "own.csv")
    shards = {kind: {split: folder / kind / split for split in SPLITS} for kind in ("whole", "tiles")}
    return OwnSet(manifest, folder / "own.h5", **shards)


def make_own_set(folder: Path) -> None:
    """The last sample of a split has facts that its first five have not: flags, a measured ratio, an exact matrix."""
    manifest = sid_like(folder)
    last = max(one.path for one in manifest.records if one.split == "test" and one.role == "noisy")
    third = tuple(tuple(Fraction(column + 1, 3) for column in range(row, row + 3)) for row in range(3))
    sensor = replace(SENSOR, xyz_to_camera=third, matrix_illuminant=17)  # type: ignore[arg-type] # fractions are exact
    photograph(folder / "data/OWN" / last, 200, SHORT_S["0.1"], 99, sensor)
    records = [
        replace(one, flags=("misaligned", "windy"), measured_ratio=Fraction(301, 3)) if one.path == last else one
        for one in manifest.records
    ]
    manifest = save_manifest(manifest.path, manifest.card, records)
    given = ["--manifest", str(manifest.path), "--root", str(folder / "data")]
    assert main(["pack", "own", *given, "-o", str(folder / "own.h5"), "--jobs", "1"]) == 0
    for kind, tile in (("whole", None), ("tiles", 8)):
        for split in SPLITS:
            options: Any = {"tile": tile, "samples_per_shard": 4, "split": split, "seed": LAST_COMES_LAST}
            write_shards(folder / "own.h5", folder / kind / split, **options)


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> Iterator[OwnSet]:
    with made_once(tmp_path_factory, "hub", make_own_set) as folder:
        yield own_set(folder)


@pytest.fixture(autouse=True)
def no_warnings() -> Iterator[None]:
    """What ``datasets`` finds odd in a folder, it ignores and logs: no test here may make it do so."""
    found: list[str] = []
    handler = logging.Handler(logging.WARNING)
    handler.emit = lambda record: found.append(record.getMessage())  # type: ignore[method-assign] # as short as it gets
    logging.getLogger("datasets").addHandler(handler)
    yield
    logging.getLogger("datasets").removeHandler(handler)
    assert found == []


@pytest.fixture
def cache(tmp_path: Path) -> str:
    return str(tmp_path / "cache")


def laid_out(own: OwnSet, folder: Path, kind: str = "whole", **more: Any) -> Path:
    export_hub(folder / "out", manifest=own.file, shards=list(getattr(own, kind).values()), **more)
    return folder / "out"


# --- pixels -----------------------------------------------------------------------------------------------------------


def packed(dn: NDArray[Any], sensor: Mapping[str, Any]) -> NDArray[np.float32]:
    """Packed and normalised, as published code does it in numpy, with the levels of the sample's facts."""
    cfa = np.array(sensor["cfa"])
    sites = [np.argwhere(cfa == channel)[0] for channel in range(4)]
    out = np.stack([dn[row::2, column::2] for row, column in sites]).astype(np.float32)
    black = np.array(sensor["black_level_dn"], np.float32)[:, None, None]
    return (out - black) / (np.float32(sensor["white_level_dn"]) - black)


@pytest.mark.parametrize("kind", ["whole", "tiles"])
def test_both_libraries_give_the_same_from_the_same_files(kind: str, own: OwnSet, tmp_path: Path) -> None:
    out = laid_out(own, tmp_path, kind)
    names = []
    for split in SPLITS:
        stream = StreamedPairs(str(out / "data" / split), augment=False, levels="metadata", clip="upper")
        if kind == "tiles":  # which are a period larger than the crops that a stream takes of them
            stream.crop = None
        ours = list(evaluation_loader(stream, workers=0))
        foreign = list(load_dataset(str(out), split=split, streaming=True))
        assert len(ours) == len(foreign) == (6 if kind == "whole" else 6 * 15)
        for sample, one in zip(ours, foreign, strict=True):
            facts = one["json"]
            noisy, clean = (
                packed(np.asarray(one[f"{name}.npy"]), facts[name]["sensor"]) for name in ("input", "target")
            )
            amplified = noisy * np.float32(Fraction(facts["ratio"]))
            assert sample["path"] == [facts["record"]["path"]]
            assert np.array_equal(sample["input"][0], np.minimum(amplified, 1))
            assert np.array_equal(sample["target"][0], np.clip(clean, 0, 1))
            names += sample["path"]
    assert set(names) == {one.path for one in own.manifest.records if one.role == "noisy"}


def test_a_downloaded_copy_has_splits_and_the_values_of_the_store(own: OwnSet, tmp_path: Path, cache: str) -> None:
    """Not streamed: ``datasets`` copies the samples into tables of its own, and counts them."""
    out = laid_out(own, tmp_path)
    found = load_dataset(str(out), cache_dir=cache)
    assert {split: len(rows) for split, rows in found.items()} == dict.fromkeys(SPLITS, 6)
    store = PackedStore(own.store, crop=None, augment=False, levels="metadata", clip="upper")
    ours = {sample["path"]: sample for sample in store}
    for rows in found.values():
        assert str(rows.features["input.npy"]) == "Array2D(shape=(50, 68), dtype='uint16')"
        for one in rows.with_format("numpy"):
            facts = one["json"]
            clean = packed(one["target.npy"], facts["target"]["sensor"])
            assert np.array_equal(ours[str(facts["record"]["path"])]["target"], np.clip(clean, 0, 1))


def test_samples_that_are_missing_are_noticed(own: OwnSet, tmp_path: Path, cache: str) -> None:
    out = laid_out(own, tmp_path)
    (out / "data/test/shard-000001.tar").unlink()
    with pytest.raises(NonMatchingSplitsSizesError):
        load_dataset(str(out), split="test", cache_dir=cache)


def known(value: Any) -> Any:
    """A sample's facts without what is not known, which JSON leaves out or has as null."""
    if isinstance(value, dict):
        return {name: known(one) for name, one in value.items() if one is not None}
    return value


@pytest.mark.parametrize("streaming", [True, False])
def test_no_fact_is_lost(streaming: bool, own: OwnSet, tmp_path: Path, cache: str) -> None:
    out = laid_out(own, tmp_path)
    seen: set[str] = set()
    for split in SPLITS:
        written: dict[str, Any] = {}
        for shard in sorted((out / "data" / split).glob("*.tar")):
            with tarfile.open(shard) as tar:
                files = {one.name: tar.extractfile(one) for one in tar if one.name.endswith(".json")}
                written |= {name[:9]: json.load(file) for name, file in files.items() if file}
        read = {
            one["__key__"]: one["json"]
            for one in load_dataset(str(out), split=split, streaming=streaming, cache_dir=cache)
        }
        assert {key: known(facts) for key, facts in read.items()} == {key: known(one) for key, one in written.items()}
        assert not any("sensor_more" in facts["input"] for facts in list(written.values())[:5])
        seen |= {name for facts in written.values() for name in (*facts["record"], *facts["input"])}
        seen |= {flag for facts in written.values() for flag in facts["record"]["flags"]}
    assert {"measured_ratio", "sensor_more", "windy"} <= seen, "or the test says little"


def test_frames_of_several_sizes(tmp_path: Path) -> None:
    """Their arrays have no one shape to be stated, and are lists of rows."""
    manifest = sid_like(tmp_path)
    wide = replace(SENSOR, width=72)
    for one in manifest.records:
        if one.scene == "10003":
            photograph(tmp_path / "data/OWN" / one.path, 200, one.exposure_s or LONG_S, 5, wide)
    records = [replace(one, split="") for one in manifest.records]  # and without splits
    save_records(manifest.path, records)
    given = ["--manifest", str(manifest.path), "--root", str(tmp_path / "data"), "--jobs", "1"]
    assert main(["pack", "own", *given, "-o", str(tmp_path / "own.h5")]) == 0
    write_shards(tmp_path / "own.h5", tmp_path / "shards", tile=None)
    export_hub(tmp_path / "out", manifest=manifest.path, shards=[tmp_path / "shards"])
    rows = load_dataset(str(tmp_path / "out"), split="train", cache_dir=str(tmp_path / "cache"))
    shapes = {np.array(one["input.npy"]).shape for one in rows}
    assert shapes == {(50, 68), (50, 72)}


def test_the_lines_of_the_page_run(own: OwnSet, tmp_path: Path) -> None:
    out = laid_out(own, tmp_path)
    blocks = re.findall(r"```python\n(.*?)```", (out / "README.md").read_text(encoding="utf-8"), re.DOTALL)
    names: dict[str, Any] = {}
    for block in blocks:
        local = block.replace("hf://datasets/OWNER/own", str(out)).replace("OWNER/own", str(out))
        exec(compile(local, "README.md", "exec"), names)  # noqa: S102 # our own
    assert names["noisy"].dtype == np.uint16
    assert len(names["pairs"]) == 6


HOSTILE = (
    "<script>alert(1)</script>",
    "[a](javascript:alert(2)) <javascript:alert(3)> javascript:alert(4)",
    "![x](https://evil.example/x.png) <img src=x onerror=alert(5)>",
    "&lt;b&gt; `code` _a_ **b** ~~c~~ | d # e",
    "see https://example.org/a_b(c)?d=1&e=2. And https://example.org/x",
)


def test_texts_of_a_card_are_texts_on_its_page(own: OwnSet) -> None:
    """The oracle is markdown-it, with HTML switched on: no markup but links to web addresses, and every text whole."""
    from markdown_it import MarkdownIt

    title, citation, homepage, contents, licence = HOSTILE
    card = replace(
        own.manifest.card,
        title=title,
        citation=citation,
        homepage=homepage,
        contents=contents,
        licence=licence,
        unknown=HOSTILE,
        known_defects=HOSTILE,
    )
    page = hub_page(replace(own.manifest, card=card), HubLayout(()))
    body = page.split("---\n", 2)[2]
    tokens = [inner for token in MarkdownIt().parse(body) for inner in (token, *(token.children or ()))]
    assert not {"html_block", "html_inline", "image"} & {token.type for token in tokens}
    links = {str(token.attrGet("href")) for token in tokens if token.type == "link_open"}
    assert {"https://example.org/x", "https://example.org/a_b(c)?d=1&e=2"} <= links
    assert all(link.startswith("https://") for link in links)
    shown = [
        "".join(part.content for part in token.children or () if part.type in ("text", "text_special"))
        for token in tokens
        if token.type == "inline"
    ]
    assert [text for text in HOSTILE if not any(text in found for found in shown)] == []


# --- references -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", shipped_names())
def test_known_sets_are_referenced(name: str, tmp_path: Path, cache: str) -> None:
    manifest = shipped_manifest(name)
    report = export_hub(tmp_path / "out", name)
    assert sorted(path.name for path in (tmp_path / "out").iterdir() if path.is_file()) == sorted(
        ["README.md", f"{name}.csv", f"{name}.json", f"{name}.croissant.json"]
    )
    assert {path.suffix for path in (tmp_path / "out").rglob("*") if path.is_file()} == {".md", ".csv", ".json"}
    assert not any(path.is_symlink() for path in (tmp_path / "out").rglob("*"))
    with manifest.path.open(encoding="utf-8", newline="") as file:
        cells = list(csv.DictReader(file))
    frames = load_dataset(str(tmp_path / "out"), "frames", split="frames", cache_dir=cache)
    assert [as_text(row["path"]) for row in frames] == [row["path"] for row in cells]
    for column in cells[0]:
        assert [same(value, row[column]) for value, row in zip(frames[column], cells, strict=True)].count(False) == 0
    pairs = select_pairs(manifest.records) if report.pairs else ()
    assert get_dataset_config_names(str(tmp_path / "out")) == (["pairs", "frames"] if pairs else ["frames"])
    if not pairs:
        return
    found = load_dataset(str(tmp_path / "out"), cache_dir=cache)
    rows = {row["path"]: row | {"split": split} for split, part in found.items() for row in part}
    size = {one.path: one.size_bytes for one in manifest.records}
    assert rows.keys() == {pair.path for pair in pairs}
    for pair in pairs:
        row = rows[pair.path]
        assert (row["reference"], row["camera"], row["scene"]) == (pair.reference, pair.camera, pair.scene)
        assert row["split"] == (pair.split or "train")
        assert same(row["ratio"], number_text(pair.ratio))
        assert (row["size_bytes"], row["reference_size_bytes"]) == (size[pair.path], size[pair.reference])
        assert set((row["download"] or "").split()) <= {one.address for one in manifest.card.downloads}


def as_text(value: Any) -> str:
    return "" if value is None else str(value)


def same(value: Any, cell: str) -> bool:
    return float(cell or "nan") == value if isinstance(value, float) and cell else as_text(value) == cell


def test_which_pairs_are_referenced(tmp_path: Path) -> None:
    report = export_hub(tmp_path / "out", "sid-sony", split="test", exclude_flags=["misaligned"])
    assert report.lists[0] == "pairs/test.csv"
    rows = load_dataset(str(tmp_path / "out"), split="test", streaming=True)
    assert sum(1 for _ in rows) == report.pairs
    with pytest.raises(ArgumentError, match="drv: has no pairs with a ratio to choose from"):
        export_hub(tmp_path / "clips", "drv", split="test")


# --- licences ---------------------------------------------------------------------------------------------------------


def with_licence(own: OwnSet, folder: Path, licence: str) -> Path:
    path = folder / "own.csv"
    path.write_bytes(own.file.read_bytes())
    save_card(path.with_suffix(".json"), replace(own.manifest.card, licence=licence))
    return path


@in_one_test(
    "licence", ["", "not stated", "none stated", "unknown", "all rights reserved", "CC", "MIT for the code alone"]
)
def test_without_a_known_licence_nothing_is_copied(licence: str, own: OwnSet, tmp_path: Path) -> None:
    manifest = with_licence(own, tmp_path, licence)
    with pytest.raises(
        ArgumentError, match=r"states no licence by an SPDX name.* if the photographs are yours, write one"
    ):
        export_hub(tmp_path / "out", manifest=manifest, shards=list(own.whole.values()), link="copy")
    assert not (tmp_path / "out").exists()


def test_a_known_sets_licence_is_that_of_its_shipped_card(own: OwnSet, tmp_path: Path) -> None:
    """Whatever a copy of its manifest says."""
    known_set = shipped_manifest("eld")
    forged = save_manifest(tmp_path / "eld.csv", replace(known_set.card, licence="CC0-1.0"), known_set.records)
    with pytest.raises(ArgumentError, match=r"eld: .*passing them on is for its publishers; leave out --shards"):
        export_hub(tmp_path / "out", manifest=forged.path, shards=[own.whole["test"]])
    with pytest.raises(ArgumentError, match="passing them on is for its publishers"):
        export_hub(tmp_path / "out", "sid-sony", shards=[own.whole["test"]])
    assert not (tmp_path / "out").exists()


@in_one_test(
    "licence, header",
    [
        ("CC-BY-4.0", {"license": "cc-by-4.0"}),
        ("CC-BY-NC-SA-4.0", {"license": "cc-by-nc-sa-4.0"}),
        ("ODbL-1.0", {"license": "odbl"}),
        ("GPL-3.0-or-later", {"license": "gpl-3.0"}),
        (
            "CC-BY-SA-2.0",  # which the Hub does not list
            {
                "license": "other",
                "license_name": "cc-by-sa-2.0",
                "license_link": "https://spdx.org/licenses/CC-BY-SA-2.0",
            },
        ),
        ("LicenseRef-Our-Lab", {"license": "other", "license_name": "our-lab", "license_link": "LICENSE"}),
        ("not stated", {"license": "unknown"}),
        (
            'for "research": ask us\\',
            {"license": "other", "license_name": "in-words", "license_details": 'for "research": ask us\\'},
        ),
    ],
)
def test_the_header_states_the_licence(licence: str, header: dict[str, str], own: OwnSet, tmp_path: Path) -> None:
    folder = tmp_path / re.sub(r"\W", "", licence)
    folder.mkdir()
    export_hub(folder / "out", manifest=with_licence(own, folder, licence))
    _, text, _ = (folder / "out/README.md").read_text(encoding="utf-8").split("---\n", 2)
    found = yaml.safe_load(text)
    assert {name: value for name, value in found.items() if name.startswith("license")} == header
    assert found["pretty_name"] == "A set of one's own"
    assert found["size_categories"] == ["n<1K"]


# --- shards that do not belong, and writing ---------------------------------------------------------------------------


def test_shards_that_are_not_of_the_set(own: OwnSet, tmp_path: Path) -> None:
    def refused(message: str, *shards: Path, manifest: Path = own.file, **more: Any) -> None:
        with pytest.raises(EldataError, match=message):
            export_hub(tmp_path / "out", manifest=manifest, shards=shards, **more)
        assert not (tmp_path / "out").exists()

    refused("no such folder; name a folder that eldata shard wrote", tmp_path / "nowhere")
    refused("index.json", own.file.parent)
    refused("another folder does; shard them together", own.whole["test"], own.tiles["test"])
    refused("chosen as they were written", own.whole["test"], split="test")
    write_shards(own.store, tmp_path / "both", split=["test", "val"], tile=None)
    refused(
        "the splits '(test|val)' and '(test|val)'; the package datasets tells splits by their files",
        tmp_path / "both",
    )
    changed = tmp_path / "own.csv"
    card = own.manifest.card
    save_manifest(changed, card, [replace(one, flags=("windy",)) for one in own.manifest.records])
    refused(
        r"is not as the manifest has it now \(flags: expected windy, found nothing\); pack and shard the set again",
        own.whole["val"],
        manifest=changed,
    )
    rest = [one for one in own.manifest.records if one.split != "val"]
    save_manifest(changed, replace(card, counts={"noisy": 12, "reference": 2}), rest)
    refused(r"now \(it is not there\)", own.whole["val"], manifest=changed)
    save_manifest(changed, replace(card, name="other"), own.manifest.records)
    refused("holds pairs of 'own', but the manifest is of 'other'", own.whole["val"], manifest=changed)


def test_a_split_that_datasets_cannot_name(own: OwnSet, tmp_path: Path) -> None:
    for split in ("night-1", "all"):
        records = [replace(one, split=split) for one in own.manifest.records]
        save_manifest(tmp_path / "own.csv", own.manifest.card, records)
        with pytest.raises(ArgumentError, match=f"split '{split}': the package datasets takes names of letters"):
            export_hub(tmp_path / "out", manifest=tmp_path / "own.csv")


def test_a_damaged_shard(own: OwnSet, tmp_path: Path) -> None:
    damaged = tmp_path / "val"
    shutil.copytree(own.whole["val"], damaged)
    content = bytearray((damaged / "shard-000000.tar").read_bytes())
    content[9000] ^= 1
    (damaged / "shard-000000.tar").write_bytes(content)
    with pytest.raises(ShardError, match=r"shard-000000\.tar.* is damaged"):
        export_hub(tmp_path / "out", manifest=own.file, shards=[damaged])
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("link", ["symbolic", "hard", "copy"])
def test_an_interrupted_export_goes_on(link: Any, own: OwnSet, tmp_path: Path) -> None:
    out = laid_out(own, tmp_path, link=link)
    whole = {path.relative_to(out): path.read_bytes() for path in sorted(out.rglob("*")) if path.is_file()}
    assert (out / "data/test/index.json").is_symlink() == (link == "symbolic")
    for name in ("README.md", "own.csv", "data/val/index.json", "data/val/shard-000001.tar"):
        (out / name).unlink()
    report = export_hub(out, manifest=own.file, shards=list(own.whole.values()), link=link)
    assert (report.pairs, report.linked, report.there) == (18, 2, len(whole) - 4)
    assert {path.relative_to(out): path.read_bytes() for path in sorted(out.rglob("*")) if path.is_file()} == whole
    (out / "README.md").write_text("mine", encoding="utf-8")
    with pytest.raises(EldataError, match=r"README\.md: is there already"):
        export_hub(out, manifest=own.file, shards=list(own.whole.values()), link=link)
    assert (out / "README.md").read_text(encoding="utf-8") == "mine"


def test_the_command(own: OwnSet, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = str(tmp_path / "out")
    given = ["--manifest", str(own.file), "--shards", str(own.whole["test"]), "--shards", str(own.whole["val"])]
    assert main(["export", "hub", out, *given]) == 0
    printed = capsys.readouterr().out
    assert printed.startswith(f"12 pairs below {out}: 6 links made\n  own.csv\n")
    assert f'to use it: load_dataset("{out}"), or: hf upload OWNER/own {out} --repo-type dataset' in printed
    assert main(["export", "hub", str(tmp_path / "eld"), "--dataset", "eld"]) == 0
    assert "note: these are references" in capsys.readouterr().out
    assert main(["export", "led", out, *given]) == 2
    assert "--shards is for hub: the code of led reads the set's own files" in capsys.readouterr().err
