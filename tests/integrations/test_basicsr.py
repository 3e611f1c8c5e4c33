"""A dataset and metrics in BasicSR's registries: LED's arithmetic to the bit, the protocols' scores."""

from __future__ import annotations

import re
import sys
import types
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rawpy
import torch
import yaml

from eldata.cli.main import main
from eldata.errors import ArgumentError
from eldata.integrations import basicsr
from eldata.integrations.basicsr import EldataPairs, EldataReferences, MissingBasicSRError, register
from eldata.manifest.card import CameraCard, Card
from eldata.manifest.catalogue import Manifest, save_manifest
from eldata.raw.dng import write_dng
from eldata.records import Exposure, FrameRecord, Sensor

# --- a small set of one's own, named as SID's: real DNG files of a camera with channel whites ---

# LibRaw has a white level per channel of this model, 15311, which is not the file's: LED divides by it.
SENSOR = Sensor(
    "NIKON CORPORATION", "NIKON D850", ((2, 3), (1, 0)), (400.0, 401.0, 402.0, 401.0), 16000.0, 50, 68, (2.0, 1, 1.5, 1)
)
LONG_S = Fraction(10)
SHORT_S = {"0.04": Fraction(1, 25), "0.1": Fraction(1, 10), "0.033": Fraction(1, 30)}
RATIO = {"0.04": 250, "0.1": 100, "0.033": 300}


def photograph(path: Path, seconds: Fraction, seed: int) -> None:
    """A frame with pixels below black and above white."""
    path.parent.mkdir(parents=True, exist_ok=True)
    mosaic = np.random.default_rng(seed).integers(300, 16384, (SENSOR.height, SENSOR.width), dtype=np.uint16)
    mosaic[: SENSOR.height // 2] //= 16  # dark enough that amplifying does not saturate it
    mosaic[: SENSOR.height // 2] += 350
    write_dng(path, mosaic, SENSOR, Exposure(Fraction(200), seconds))


def sid_like(folder: Path) -> Manifest:
    """SID's names: scenes 00001 (train), 10003 (test) and 20004 (val), two shots of each time; ISO 200 throughout."""
    records, number = [], 0
    for scene, split in (("00001", "train"), ("10003", "test"), ("20004", "val")):
        long = f"Own/long/{scene}_00_10s.ARW"
        photograph(folder / "data/OWN" / long, LONG_S, number := number + 1)
        records.append(FrameRecord(long, "reference", "Own", scene, split, Fraction(200), LONG_S))
        for text, seconds in SHORT_S.items():
            for burst in range(2):
                path = f"Own/short/{scene}_{burst:02d}_{text}s.ARW"
                photograph(folder / "data/OWN" / path, seconds, number := number + 1)
                ratio = Fraction(RATIO[text])
                records.append(FrameRecord(path, "noisy", "Own", scene, split, Fraction(200), seconds, ratio, long))
    cameras, counts = {"Own": CameraCard(("NIKON D850",))}, {"noisy": 18, "reference": 3}
    card = Card("own", "A set of one's own", "1.0", "OWN", "", "CC0-1.0", "", "bayer", cameras, counts)
    return save_manifest(folder / "own.csv", card, records)


# --- the published loader's steps (LED repository, commit ee3d372, led/data/paired_raw_dataset.py) ---


def led_arrays(path: Path) -> list[torch.Tensor]:
    """Its ``depack_meta`` without a postfix: packed by ``raw_pattern``, and LibRaw's levels per channel."""
    with rawpy.imread(str(path)) as raw:
        visible, pattern = raw.raw_image_visible.copy(), raw.raw_pattern
        black = np.array(raw.black_level_per_channel, "float32").reshape(4, 1, 1)
        white = np.array(raw.camera_white_level_per_channel, "float32").reshape(4, 1, 1)
    visible = visible[: visible.shape[0] // 2 * 2, : visible.shape[1] // 2 * 2]
    sites = [[int(at[0]) for at in np.where(pattern == colour)] for colour in range(4)]
    packed = np.stack([visible[row::2, column::2] for row, column in sites]).astype("float32")
    return [torch.from_numpy(array) for array in (packed, black, white)]


def led_frame(path: Path) -> torch.Tensor:
    image, black_level, white_level = led_arrays(path)
    return (image - black_level) / (white_level - black_level)


def led_seconds(name: str) -> float:
    found = re.search(r"_(\d+(\.\d+)?)s.", name)
    assert found is not None
    return float(found.group(0)[1:-2])


def led_pair(root: Path, line: str, *, zero_clip: bool) -> tuple[torch.Tensor, torch.Tensor, float]:
    """Its ``__getitem__`` of whole frames, of one line of its list."""
    noisy, clean = line.split(" ")[:2]
    clean = clean.rstrip("\n")
    ratio = min(led_seconds(clean) / led_seconds(noisy), 300)
    lowest = 0 if zero_clip else None
    lq, gt = led_frame(root / noisy), led_frame(root / clean)
    return torch.clip(lq * ratio, lowest, 1), torch.clip(gt, 0, 1), ratio


# --- values -----------------------------------------------------------------------------------------------------------


def options(text: str) -> dict[str, Any]:
    """A dataset's part of a yaml, as BasicSR hands it on: its ``phase`` is added."""
    part: dict[str, Any] = yaml.safe_load(text)
    return {"phase": "val", "scale": 1, **part}


VALIDATION = """
name: OwnPaired
type: EldataPairs
postfix: ~
which_meta: gt
crop_size: ~
load_in_mem: false
amplification: nominal
"""


@pytest.mark.parametrize("zero_clip", [True, False])
@pytest.mark.parametrize("kind", ["manifest", "store"])
def test_samples_equal_leds_to_the_bit(kind: str, zero_clip: bool, tmp_path: Path) -> None:
    manifest = sid_like(tmp_path)
    root = tmp_path / "data/OWN"
    where = {"data_pair_list": str(manifest.path), "dataroot": str(root)}
    if kind == "store":
        store = tmp_path / "own.h5"
        packing = ["pack", "own", "--manifest", str(manifest.path), "--root", str(tmp_path / "data"), "-o", str(store)]
        assert main(packing) == 0
        where = {"data_pair_list": str(store)}
    dataset = EldataPairs(options(VALIDATION) | where | {"zero_clip": zero_clip})
    assert len(dataset) == 18
    below = 0
    for sample in (dataset[index] for index in range(len(dataset))):
        lq, gt, ratio = led_pair(root, f"{sample['lq_path']} {sample['gt_path']}\n", zero_clip=zero_clip)
        assert torch.equal(sample["lq"], lq)
        assert torch.equal(sample["gt"], gt)
        assert torch.equal(sample["ratio"], torch.tensor(ratio).float())
        below += int((lq < 0).sum())
    assert (below == 0) == zero_clip


@pytest.mark.parametrize("crop", [None, 16])
def test_references_equal_leds_clean_frames(crop: int | None, tmp_path: Path) -> None:
    """Its ``RAWGTDataset``: DN and levels as the file has them, a whole ratio; here of three references, each once."""
    manifest, root = sid_like(tmp_path), tmp_path / "data/OWN"
    where = {"data_pair_list": str(manifest.path), "dataroot": str(root), "crop_size": crop, "ratio_range": [100, 102]}
    dataset = EldataReferences(options(VALIDATION) | where)
    assert len(dataset) == 3
    for sample in (dataset[index] for index in range(len(dataset))):
        packed, black, white = led_arrays(root / sample["gt_path"])
        assert torch.equal(sample["gt"], packed if crop is None else packed[:, 4:20, 9:25])
        assert torch.equal(sample["lq"], sample["gt"])
        assert torch.equal(sample["black_level"], black)
        assert torch.equal(sample["white_level"], white)
    training = EldataReferences(options(VALIDATION) | where | {"phase": "train"})
    torch.manual_seed(1)
    assert {training[0]["ratio"] for _ in range(60)} == {100, 101, 102}  # one is missing with 3 (2/3)^60, below 1e-10
    with pytest.raises(ArgumentError, match="two whole numbers"):
        EldataReferences(options(VALIDATION) | where | {"ratio_range": [300, 100]})


def test_the_middle_in_validation_and_random_places_in_training(tmp_path: Path) -> None:
    manifest, root = sid_like(tmp_path), tmp_path / "data/OWN"
    where = {"data_pair_list": str(manifest.path), "dataroot": str(root), "split": "train", "crop_size": 16}
    middle = EldataPairs(options(VALIDATION) | where)[0]
    whole, _, _ = led_pair(root, f"{middle['lq_path']} {middle['gt_path']}", zero_clip=True)
    assert torch.equal(middle["lq"], whole[:, 4:20, 9:25])  # LED: (25 - 16) // 2 and (34 - 16) // 2
    assert middle["wb"].tolist() == [2.0, 1.0, 1.5, 1.0]
    assert np.allclose(middle["ccm"].sum(dim=1), 1, atol=1e-6)  # white-balanced white is white

    training = EldataPairs(options(VALIDATION) | where | {"phase": "train", "use_hflip": True, "use_rot": True})
    loader = torch.utils.data.DataLoader(training, batch_size=6)
    torch.manual_seed(5)
    batches = [next(iter(loader))["lq"] for _ in range(2)]
    assert batches[0].shape == (6, 4, 16, 16)
    assert not torch.equal(*batches), "BasicSR repeats an epoch's items: each time they are cut elsewhere"
    torch.manual_seed(5)
    assert torch.equal(next(iter(loader))["lq"], batches[0])


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"crop_siz": 3}, "did you mean crop_size"),
        ({"ratio_aug": [100, 300]}, "no such key"),
        ({"use_hflip": True}, "must be the same"),
        ({"ratio_range": [100, 300]}, "EldataPairs has no such key"),
        ({"data_pair_list": ""}, "found nothing"),
        ({"data_pair_list": "drv"}, "set of clips"),
        ({"data_pair_list": "a.h5"}, "leave it out"),
        ({"levels": "own"}, "metadata-per-channel"),
        ({"phase": "training"}, "train"),
    ],
)
def test_what_is_refused(more: dict[str, Any], said: str, tmp_path: Path) -> None:
    (tmp_path / "DRV").mkdir()
    given = options(VALIDATION) | {"data_pair_list": "own.csv", "dataroot": str(tmp_path / "DRV")} | more
    with pytest.raises(ArgumentError, match=re.escape(said)):
        EldataPairs(given)


# --- metrics and registries -------------------------------------------------------------------------------------------


def test_metrics_are_the_protocols() -> None:
    generator = torch.Generator().manual_seed(3)
    target = torch.rand((3, 4, 40, 44), generator=generator)
    prediction = 0.9 * target + 0.05 * torch.randn(target.shape, generator=generator)
    pytest.importorskip("torchmetrics", reason="needs eldata[torchmetrics]")
    from eldata.integrations.torchmetrics import ProtocolScore

    for function, column in ((basicsr.eldata_psnr_pt, "psnr_db"), (basicsr.eldata_ssim, "ssim")):
        found = function(prediction, target, protocol="led-sid", crop_border=2)
        for one, image, reference in zip(found.tolist(), prediction, target, strict=True):
            metric = ProtocolScore("led-sid")
            metric.update(image, reference)
            assert one == metric.compute()[column]
    with pytest.raises(ArgumentError, match="calculate_metric_in_batch: true"):
        basicsr.eldata_psnr(np.zeros((40, 44, 3), np.uint8), np.zeros((40, 44, 3), np.uint8))  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, match="is of clips"):
        basicsr.eldata_ssim(prediction, target, protocol="drv-raw")


def registry_module() -> types.ModuleType:
    """A module with the interface that BasicSR's registry documents."""
    module = types.ModuleType("standing_in.utils.registry")
    module.DATASET_REGISTRY, module.METRIC_REGISTRY = Registry(), Registry()  # type: ignore[attr-defined]
    return module


class Registry:
    """What BasicSR's ``Registry`` documents: objects by their ``__name__``, each once."""

    def __init__(self) -> None:
        self._held: dict[str, Any] = {}

    def register(self, entry: Any) -> None:
        assert entry.__name__ not in self._held
        self._held[entry.__name__] = entry

    def get(self, name: str) -> Any:
        return self._held[name]

    def __contains__(self, name: str) -> bool:
        return name in self._held


def test_the_registries_hold_what_a_yaml_names(monkeypatch: pytest.MonkeyPatch) -> None:
    registries = registry_module()
    for name in ("standing_in", "standing_in.utils"):
        monkeypatch.setitem(sys.modules, name, types.ModuleType(name))
    monkeypatch.setitem(sys.modules, "standing_in.utils.registry", registries)
    for _ in range(2):  # a second time changes nothing
        register("standing_in")
    assert registries.DATASET_REGISTRY.get("EldataPairs") is EldataPairs
    assert registries.DATASET_REGISTRY.get("EldataReferences") is EldataReferences
    for name in ("eldata_psnr", "eldata_ssim", "eldata_psnr_pt", "eldata_ssim_pt"):
        assert registries.METRIC_REGISTRY.get(name) is getattr(basicsr, name)

    def eldata_psnr() -> None: ...

    other = registry_module()
    other.METRIC_REGISTRY.register(eldata_psnr)
    monkeypatch.setitem(sys.modules, "standing_in.utils.registry", other)
    with pytest.raises(ArgumentError, match="something else is registered as eldata_psnr"):
        register("standing_in")
    with pytest.raises(MissingBasicSRError, match=r"no_such_code\.utils\.registry cannot be imported"):
        register("no_such_code")
