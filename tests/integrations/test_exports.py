"""What published code reads: small readers written after each repository's own, and eldata's datasets, to the bit."""

from __future__ import annotations

import io
import os
import pickle
import pickletools
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import exifread
import numpy as np
import pytest
import rawpy
import torch

from eldata.cli.main import main
from eldata.datasets.base import PairDataset
from eldata.errors import ArgumentError, DatasetError, EldataError
from eldata.integrations.basicsr import EldataPairs
from eldata.integrations.exports import export
from eldata.integrations.exports.naming import eld_numbers, numbers_of
from eldata.manifest.card import save_card
from eldata.manifest.catalogue import load_manifest, shipped_manifest
from eldata.manifest.eld import nearest_reference
from eldata.manifest.table import save_records
from tests.integrations.published_sets import SONY, eld_like, sid_like
from tests.integrations.test_basicsr import led_pair
from tests.trees import build_published_tree

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from eldata.manifest.catalogue import Manifest


def lines(path: Path) -> list[str]:
    return path.read_text(encoding="utf-8").splitlines()


def written(code: Any, folder: Path, manifest: Manifest, **more: Any) -> Path:
    export(code, folder / "out", manifest=manifest.path, root=folder / "data", **more)
    return folder / "out"


def dataset(folder: Path, manifest: Manifest, **options: Any) -> dict[str, Any]:
    """Samples of eldata's own dataset of pairs, by the noisy file's real path."""
    pairs = PairDataset(folder / "data/OWN", manifest.path, **options)
    return {os.path.realpath(pairs.root / sample["path"]): sample for sample in pairs}


# --- LED --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("layout", [sid_like, eld_like])
def test_led_reads_the_same_batches_through_its_lists(layout: Any, tmp_path: Path) -> None:
    manifest = layout(tmp_path)
    camera = written("led", tmp_path, manifest) / "Own"
    own = EldataPairs(
        {"phase": "val", "data_pair_list": str(manifest.path), "dataroot": str(tmp_path / "data/OWN")}
        | {"zero_clip": False, "amplification": "nominal" if layout is sid_like else "metadata"}
    )
    samples = {os.path.realpath(tmp_path / "data/OWN" / sample["lq_path"]): sample for sample in own}
    listed = lines(camera / "Own_list.txt")
    assert len(listed) == len(samples) == (18 if layout is sid_like else 24)
    for line in listed:
        lq, gt, ratio = led_pair(camera, line, zero_clip=False)
        sample = samples[os.path.realpath(camera / line.split(" ")[0])]
        assert torch.equal(sample["lq"], lq)
        assert torch.equal(sample["gt"], gt)
        assert torch.equal(sample["ratio"], torch.tensor(ratio).float())


def test_leds_lists_by_ratio_and_split(tmp_path: Path) -> None:
    camera = written("led", tmp_path, sid_like(tmp_path)) / "Own"
    found = {path.name: len(lines(path)) for path in camera.glob("*.txt")}
    whole = {"Own_list.txt": 18} | dict.fromkeys((f"Own_list_{ratio}.txt" for ratio in (100, 250, 300)), 6)
    for split in ("train", "test", "val"):
        whole |= {f"Own_{split}_list.txt": 6}
        whole |= dict.fromkeys((f"Own_{split}_list_{ratio}.txt" for ratio in (100, 250, 300)), 2)
    assert found == whole
    assert lines(camera / "Own_list_300.txt")[0] == ("short/00001_00_0.033s.ARW long/00001_00_10s.ARW ISO200 ISO200"), (
        "names that state the ratio are kept, so that LED's own lists of SID work here"
    )


def test_names_are_those_of_leds_own_lists(tmp_path: Path) -> None:
    """Lines of datasets/txtfiles/ELD/SonyA7S2/SonyA7S2_list.txt, LED repository, commit ee3d372."""
    eld = shipped_manifest("eld")
    chosen = [record for record in eld.records if (record.camera, record.scene) == ("SonyA7S2", "scene-3")]
    small = replace(eld, records=tuple(chosen))
    build_published_tree(small, tmp_path / "ELD")
    rows = tmp_path / "eld.csv"
    save_records(rows, chosen)
    save_card(rows.with_suffix(".json"), replace(eld.card, counts={"noisy": 12, "reference": 4}))
    export("led", tmp_path / "out", manifest=rows, root=tmp_path)
    listed = lines(tmp_path / "out/SonyA7S2/SonyA7S2_list.txt")
    assert {
        "short/00003_02_400.0s.ARW long/00003_01_400s.ARW ISO800 ISO100",
        "short/00003_03_40.0s.ARW long/00003_01_400s.ARW ISO800 ISO100",
        "short/00003_08_40.0s.ARW long/00003_06_400s.ARW ISO1600 ISO100",
    } <= set(listed)


def test_a_ratio_that_led_caps_is_noted(tmp_path: Path) -> None:
    manifest = eld_like(tmp_path)
    records = [
        replace(one, ratio=Fraction(400)) if one.ratio == 200 and one.scene == "scene-1" else one
        for one in manifest.records
    ]
    save_records(manifest.path, records)
    report = export("led", tmp_path / "out", manifest=manifest.path, root=tmp_path / "data")
    assert report.remarks == (
        "Own: 3 pairs with a ratio above 300, at which LED caps it: their inputs come out darker than their references",
    )


# --- ELD (repository, commit 53d5408) ---------------------------------------------------------------------------------


def eld_pack(path: Path) -> NDArray[np.float32]:
    """``pack_raw_bayer`` of dataset/sid_dataset.py and util/lmdb_data.py: white 16383 for every file."""
    with rawpy.imread(str(path)) as raw:
        image, pattern = raw.raw_image_visible.astype(np.float32), raw.raw_pattern
        black = np.array(raw.black_level_per_channel)[:, None, None].astype(np.float32)
    height, width = (side - side % 2 for side in image.shape)
    sites = [[int(at[0]) for at in np.where(pattern == colour)] for colour in range(4)]
    out = np.stack([image[row:height:2, column:width:2] for row, column in sites]).astype(np.float32)
    packed: NDArray[np.float32] = np.clip((out - black) / (16383 - black), 0, 1)
    return packed


def exif(path: Path) -> tuple[float, float]:
    """``metainfo`` of dataset/sid_dataset.py, ISO and seconds: of ``.dng`` from IFD0, else from the EXIF IFD."""
    with path.open("rb") as file:
        tags = exifread.process_file(file)
    values = []
    for name in ("ISOSpeedRatings", "ExposureTime"):
        over, _, under = str(tags[f"{'Image' if path.suffix == '.dng' else 'EXIF'} {name}"]).partition("/")
        values.append(int(over) / int(under) if under else int(over))
    return values[0], values[1]


@pytest.mark.parametrize("references", [(1, 6, 11, 16), (1,), (1, 16)])
def test_elds_evaluation_finds_each_frame_and_its_reference(references: tuple[int, ...], tmp_path: Path) -> None:
    """``ELDEvalDataset``: the nearest of 1, 6, 11 and 16 is the reference, the ratio is EXIF's."""
    manifest = eld_like(tmp_path, references)
    camera = written("eld", tmp_path, manifest) / "Own"
    own = dataset(tmp_path, manifest, levels="published")
    seen = set()
    for scene in (1, 2):
        folder = camera / f"scene-{scene}"
        present = sorted(int(path.stem[4:]) for path in folder.iterdir())
        for number in set(present) - {1, 6, 11, 16}:
            ids = np.array([1, 6, 11, 16])
            target = folder / f"IMG_{ids[np.argmin(np.abs(number - ids))]:04d}.DNG"
            noisy = folder / f"IMG_{number:04d}.DNG"
            (iso, seconds), (target_iso, target_seconds) = exif(noisy), exif(target)
            ratio = (target_iso * target_seconds) / (iso * seconds)
            sample = own[os.path.realpath(noisy)]
            assert os.path.realpath(target) == os.path.realpath(tmp_path / "data/OWN" / sample["reference"])
            assert np.array_equal(sample["input"], np.maximum(np.minimum(eld_pack(noisy) * ratio, 1.0), 0))
            assert np.array_equal(sample["target"], np.maximum(np.minimum(eld_pack(target), 1.0), 0))
            seen.add(os.path.realpath(noisy))
    assert seen == set(own)
    if references == (1, 6, 11, 16):
        kept = tmp_path / "data/OWN/Own/scene-1/IMG_0007.dng"
        assert (camera / "scene-1/IMG_0007.DNG").samefile(kept), "numbers that fit are kept"


def test_elds_list_of_pairs_and_ratios(tmp_path: Path) -> None:
    out = written("eld", tmp_path, sid_like(tmp_path))
    assert {line.count(" ") for line in lines(out / "Own_train.txt")} == {1}, "two frames, and nothing else"
    fields = [line.split(" ") for line in lines(out / "Own_paired.txt")]
    assert [sum(int(one[2]) == ratio for one in fields) for ratio in (100, 250, 300)] == [6, 6, 6]
    assert {name.name for name in out.glob("*.txt")} == {
        f"Own_{kind}.txt" for kind in ("train", "test", "val", "paired")
    }


# --- SID (repository, commit 0448b58) ---------------------------------------------------------------------------------


def sid_pack(path: Path) -> NDArray[np.float32]:
    """``pack_raw`` of train_Sony.py; its channels are R, G1, B, G2 at the end."""
    with rawpy.imread(str(path)) as raw:
        image = raw.raw_image_visible.astype(np.float32)
    light = (np.maximum(image - 512, 0) / (16383 - 512)).astype(np.float32)
    return np.stack((light[0::2, 0::2], light[0::2, 1::2], light[1::2, 1::2], light[1::2, 0::2]))


@pytest.mark.parametrize("renamed", [False, True])
def test_sids_code_finds_and_amplifies_the_same(renamed: bool, tmp_path: Path) -> None:
    """train_Sony.py: scenes by pattern, ``_00`` alone, times from the tenth letter of the name to the fifth last."""
    manifest = sid_like(tmp_path, sensor=SONY)
    if renamed:  # a set whose names say nothing
        records = []
        for number, one in enumerate(manifest.records):
            path = f"Own/{one.scene}/frame-{number}.ARW"
            (tmp_path / "data/OWN" / path).parent.mkdir(exist_ok=True)
            os.link(tmp_path / "data/OWN" / one.path, tmp_path / "data/OWN" / path)
            records.append(replace(one, path=path))
        new = {old.path: one.path for old, one in zip(manifest.records, records, strict=True)}
        save_records(manifest.path, [replace(one, reference=one.reference and new[one.reference]) for one in records])
        manifest = load_manifest(manifest.path)
    out = written("sid", tmp_path, manifest)
    own = dataset(tmp_path, manifest, levels="sid-sony", amplification="nominal")
    found = 0
    for digit in "012":
        for long in (out / "Own/long").glob(f"{digit}*.ARW"):
            scene = int(long.name[0:5])
            for short in (out / "Own/short").glob(f"{scene:05d}_00*.ARW"):
                times = [float(path.name[9:-5]) for path in (short, long)]
                sample = own[os.path.realpath(short)]
                assert np.array_equal(sample["input"], np.minimum(sid_pack(short) * min(times[1] / times[0], 300), 1.0))
                assert os.path.realpath(long) == os.path.realpath(tmp_path / "data/OWN" / sample["reference"])
                found += 1
    assert found == 9, "three scenes, three times; the second shots are not _00"
    for split, digit in (("train", "0"), ("test", "1"), ("val", "2")):
        listed = [line.split(" ") for line in lines(out / f"Own_{split}_list.txt")]
        assert len(listed) == 6
        for *frames, iso in listed:
            assert all((out / name).exists() for name in frames)
            assert [name.split("/")[-1][0] for name in frames] == [digit] * 2
            assert iso == "ISO200"


def test_sids_code_needs_splits(tmp_path: Path) -> None:
    manifest = eld_like(tmp_path)
    save_records(manifest.path, [replace(one, split="") for one in manifest.records])
    with pytest.raises(ArgumentError, match="first digit of a scene; state the split"):
        written("sid", tmp_path, manifest)


def test_ratios_that_sids_code_has_no_room_for(tmp_path: Path) -> None:
    report = export("sid", tmp_path / "out", manifest=eld_like(tmp_path).path, root=tmp_path / "data")
    assert "18 pairs with a ratio other than 100, 250 and 300" in report.format_text()
    assert "end in .dng, not in .ARW" in report.format_text()


# --- PMN (repository, commit d207d3e) ---------------------------------------------------------------------------------


def pmn_bayer(path: str, *, clip: bool) -> NDArray[np.float32]:
    """``raw2bayer(dataload(path), wp=16383, bl=512, norm=True)`` of data_process/process.py."""
    with rawpy.imread(path) as raw:
        image = raw.raw_image_visible.astype(np.float32)
    out = np.stack((image[0::2, 0::2], image[0::2, 1::2], image[1::2, 1::2], image[1::2, 0::2]))
    black = (np.array([0, 0, 0, 0]) + 512).reshape(4, 1, 1)
    out = (out - black) / (16383 - black)
    packed: NDArray[np.float32] = (np.clip(out, 0, 1) if clip else out).astype(np.float32)
    return packed


def loaded(path: Path) -> Any:
    content = path.read_bytes()
    called = {str(argument) for opcode, argument, _ in pickletools.genops(content) if opcode.name == "GLOBAL"}
    assert called <= {"numpy array"}, "all that numpy below 1.20, which PMN's code needs, has too"
    return pickle.load(io.BytesIO(content))


def test_pmns_infos_of_sid(tmp_path: Path) -> None:
    manifest = sid_like(tmp_path, sensor=SONY)
    infos = written("pmn", tmp_path, manifest) / "Own/infos"
    own = dataset(tmp_path, manifest, levels="sid-sony", amplification="nominal", clip="none")
    (train,) = loaded(infos / "SID_train.info")
    assert len(train["short"]) == 6
    assert train["ratio"].tolist() == [int(exif_seconds(train["long"]) / exif_seconds(one)) for one in train["short"]]
    assert (train["ISO"], train["ExposureTime"], train["name"]) == (200, 10.0, "00001_00_10s")
    with rawpy.imread(train["long"]) as raw:
        balance = np.array(raw.camera_whitebalance) / raw.camera_whitebalance[1]
    assert train["wb"].dtype == train["ccm"].dtype == np.float32
    assert train["wb"][:3].tolist() == balance[:3].tolist()
    assert train["ccm"].shape == (3, 3)
    for short, ratio in zip(train["short"], train["ratio"], strict=True):
        sample = own[os.path.realpath(short)]
        lr = pmn_bayer(short, clip=False)
        lr *= ratio
        assert np.array_equal(sample["input"], lr)
        assert np.array_equal(sample["target"].clamp(0, 1).numpy(), pmn_bayer(train["long"], clip=True))
    scored = loaded(infos / "SID_evaltest.info")
    assert [one["ratio"] for one in scored] == [100] * 4 + [250] * 4 + [300] * 4
    assert all(os.path.realpath(one["short"]) in own for one in scored)


def exif_seconds(path: str) -> float:
    return exif(Path(path))[1]


@pytest.mark.parametrize("references", [(1, 6, 11, 16), (1,)])
def test_pmns_info_of_eld(references: tuple[int, ...], tmp_path: Path) -> None:
    """``ELD_Dataset.get_raw_id``: the first entry of ISO and ratio, its reference by the nearest place."""
    manifest = eld_like(tmp_path, references)
    scenes = loaded(written("pmn", tmp_path, manifest) / "Own/infos/ELD_Own.info")
    own = dataset(tmp_path, manifest)
    assert len(scenes) == 2
    found = set()
    for scene in scenes:
        for iso in (800, 1600, 3200):
            for ratio in (100, 200):
                place = next(n for n, one in enumerate(scene) if (one["ISO"], one["ratio"]) == (iso, ratio)) + 1
                reference = min((1, 6, 11, 16), key=lambda one: abs(place - one))
                sample = own[os.path.realpath(scene[place - 1]["data"])]
                wanted = os.path.realpath(tmp_path / "data/OWN" / sample["reference"])
                assert os.path.realpath(scene[reference - 1]["data"]) == wanted
                assert (sample["iso"], sample["nominal_ratio"]) == (iso, ratio)
                found.add(sample["path"])
    assert len(found) == 12


def test_pmn_opens_two_kinds_of_files(tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match=r"opens \.arw and \.dng alone"):
        written("pmn", tmp_path, sid_like(tmp_path, suffix="nef"))


# --- numbers ----------------------------------------------------------------------------------------------------------


def test_numbers_of_names() -> None:
    assert numbers_of(["scene-10", "scene-2"], below=100, what="scenes") == {"scene-2": 2, "scene-10": 10}
    assert numbers_of(["b", "a-2", "c"], below=100, what="scenes") == {"a-2": 1, "b": 2, "c": 3}
    assert numbers_of(["a-1", "b-1"], below=100, what="scenes") == {"a-1": 1, "b-1": 2}
    with pytest.raises(ArgumentError, match="150 scenes"):
        numbers_of([f"s{number}" for number in range(150)], below=100, what="scenes")


def scene_of(shares: tuple[int, ...]) -> Any:
    """Pairs of one scene: so many noisy frames of each reference, whose names say nothing."""
    return [
        SimpleNamespace(
            record=SimpleNamespace(scene="night"),
            noisy=SimpleNamespace(path=f"n{place}-{number}x"),
            reference=SimpleNamespace(path=f"r{place}x"),
        )
        for place, count in enumerate(shares)
        for number in range(count)
    ]


@pytest.mark.parametrize("shares", [(2, 2), (9, 3), (2, 4, 4, 30), (5, 1, 1), (1, 4, 4, 1)])
def test_given_numbers_lead_to_the_own_reference(shares: tuple[int, ...]) -> None:
    pairs = scene_of(shares)
    numbered = eld_numbers(pairs)
    for pair in pairs:
        (number,) = [number for number, path in numbered.items() if path == pair.noisy.path]
        assert numbered[nearest_reference(number)] == pair.reference.path


@pytest.mark.parametrize("shares", [(1,) * 5, (3, 4, 4, 9), (2, 5, 5, 1)])
def test_numbers_that_elds_code_cannot_have(shares: tuple[int, ...]) -> None:
    """Of four references the first has room for 2 noisy frames (2, 3), the next two for 4 each, the last for any."""
    with pytest.raises(ArgumentError, match=rf"night: .* has no numbers for {len(shares)} references"):
        eld_numbers(scene_of(shares))


# --- writing ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("link", ["symbolic", "hard", "copy"])
def test_links_and_again(link: Any, tmp_path: Path) -> None:
    manifest = sid_like(tmp_path)
    first = export("led", tmp_path / "out", manifest=manifest.path, root=tmp_path / "data", link=link)
    again = export("led", tmp_path / "out", manifest=manifest.path, root=tmp_path / "data", link=link)
    assert (first.linked, first.there) == (21, 0)
    assert (again.linked, again.there) == (0, 21 + len(first.lists))
    made = tmp_path / "out/Own/short/00001_00_0.1s.ARW"
    original = tmp_path / "data/OWN/Own/short/00001_00_0.1s.ARW"
    assert made.is_symlink() == (link == "symbolic")
    assert made.samefile(original) == (link != "copy")
    assert made.read_bytes() == original.read_bytes()


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    manifest = sid_like(tmp_path)
    (tmp_path / "out/Own/short").mkdir(parents=True)
    other = tmp_path / "out/Own/short/00001_00_0.1s.ARW"
    other.write_bytes(b"mine")
    with pytest.raises(EldataError, match=r"00001_00_0\.1s\.ARW: is there already.*nothing was written"):
        export("led", tmp_path / "out", manifest=manifest.path, root=tmp_path / "data")
    assert other.read_bytes() == b"mine"
    assert [path for path in (tmp_path / "out").rglob("*") if path.is_file()] == [other]
    other.unlink()
    other.symlink_to(tmp_path / "nowhere")  # a dangling link is somebody's, too
    with pytest.raises(EldataError, match="is there already"):
        export("led", tmp_path / "out", manifest=manifest.path, root=tmp_path / "data")


def test_a_content_of_the_same_length_is_another_one(tmp_path: Path) -> None:
    manifest = sid_like(tmp_path)
    made = export("led", tmp_path / "out", manifest=manifest.path, root=tmp_path / "data", link="copy")
    for name in ("Own/short/00001_00_0.1s.ARW", made.lists[0]):
        path = tmp_path / "out" / name
        content = path.read_bytes()
        path.write_bytes(content[:-1] + b"?")
        with pytest.raises(EldataError, match="is there already"):
            export("led", tmp_path / "out", manifest=manifest.path, root=tmp_path / "data", link="copy")
        path.write_bytes(content)


def test_files_that_are_not_there(tmp_path: Path) -> None:
    manifest = sid_like(tmp_path)
    for path in (tmp_path / "data/OWN/Own/short").glob("10003*"):
        path.unlink()
    with pytest.raises(DatasetError, match="as 6 of 21 files in all; choose the pairs that you have by"):
        export("sid", tmp_path / "out", manifest=manifest.path, root=tmp_path / "data")
    assert export("sid", tmp_path / "out", manifest=manifest.path, root=tmp_path / "data", split="train").pairs == 6
    with pytest.raises(DatasetError, match="there is no such folder; --root names the folder that holds OWN"):
        export("sid", tmp_path / "out", manifest=manifest.path, root=tmp_path / "out")
    with pytest.raises(DatasetError, match="drv: its noisy frames are clips"):
        export("sid", tmp_path / "out", "drv", root=tmp_path)


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    manifest = eld_like(tmp_path)
    given = ["--manifest", str(manifest.path), "--root", str(tmp_path / "data"), "--jobs", "2"]
    assert main(["export", "led", str(tmp_path / "out"), *given]) == 0
    printed = capsys.readouterr().out
    assert printed.startswith(f"24 pairs below {tmp_path / 'out'}: 32 links made\n  Own/Own_list.txt\n")
    assert "to use it: Own: in LED's yaml, dataroot is the folder Own here" in printed
    (tmp_path / "out/Own/Own_list.txt").write_text("mine", encoding="utf-8")
    assert main(["export", "led", str(tmp_path / "out"), *given]) == 2
    assert "is there already" in capsys.readouterr().err
