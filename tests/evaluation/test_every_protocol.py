"""Each shipped protocol of images, from real files to scores, against its authors' way (``published_code``)."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rawpy
from numpy.typing import NDArray
from PIL import Image

from eldata.errors import ArgumentError
from eldata.evaluation import EvaluationResult, evaluate, save_prediction
from eldata.manifest.card import save_card
from eldata.manifest.catalogue import shipped_manifest
from eldata.manifest.table import save_records
from eldata.metrics.registry import IMAGES
from eldata.protocols import PROTOCOLS
from eldata.raw.dng import write_dng
from eldata.records import Exposure, FrameRecord, PairRecord, Sensor
from tests.evaluation import oracle, published_code
from tests.evaluation.helpers import assert_equal, scored_pairs
from tests.evaluation.own_set import MATRIX, WHITE_BALANCE, build_own_set, mosaic_of, sensor_of
from tests.evaluation.published_code import Route, Score
from tests.raw.helpers import BAYER, CFAS, Cfa, indices_of, is_xtrans, levels_of, reference_pack, xtrans_at
from tests.trees import place_of

# --- trees: published names, sensors that change from scene to scene --------------------------------------------------

# What LibRaw makes of a DNG, it makes of whole numbers.
BLACKS = ((509.0, 516.0, 600.0, 2047.0), (512.0,) * 4, (400.0, 399.0, 402.0, 401.0), (2047.0, 2049.0, 2048.0, 2046.0))
WHITES = (15520.0, 16300.0, 13583.0, 16383.0)
SIZES = ((40, 56), (44, 48), (36, 64), (38, 50))
MODELS = {"SonyA7S2": ("SONY", "ILCE-7SM2"), "NikonD850": ("NIKON CORPORATION", "NIKON D850")}
DARK = 3
"""Number of the scene that has nothing but read noise in it."""


@dataclass(frozen=True)
class Pairs:
    """A set with a published name: its manifest, the data root, and the folder of predictions, as mosaics here."""

    name: str
    csv: Path
    root: Path
    files: Path
    mosaics: dict[str, NDArray[np.float32]]

    @property
    def predictions(self) -> Path:
        return self.root / "predictions"

    def evaluate(
        self, protocol: str, *, baseline: bool = False, cameras: Collection[str] | None = None
    ) -> EvaluationResult:
        where: dict[str, Any] = {"manifest": self.csv, "root": self.root, "protocol": protocol, "cameras": cameras}
        return evaluate(None, baseline="input", **where) if baseline else evaluate(self.predictions, **where)


def sensor_at(number: int, camera: str, size: tuple[int, int]) -> Sensor:
    """The sensor of the n-th scene: every phase with every black level, and other white levels."""
    turn = number + number // 4
    levels = BLACKS[turn % 4], WHITES[(number + 2 * (number // 4)) % 4]
    return Sensor(*MODELS[camera], list(BAYER.values())[number % 4], *levels, *size, WHITE_BALANCE, MATRIX)


def fuji_at(number: int, camera: str, size: tuple[int, int]) -> Sensor:
    """X-Trans in the one phase that the published code knows, with the black level that it has for every file."""
    del camera
    return Sensor("Maker", "X-T2", xtrans_at(0, 0), (1024.0,) * 3, WHITES[number % 4], *size, WHITE_BALANCE, MATRIX)


def pixels_of(record: FrameRecord, sensor: Sensor, *, dark: bool) -> NDArray[np.uint16]:
    """(H, W) in DN. References go from below black to above every white level; short frames drown in read noise."""
    generator = np.random.default_rng(zlib.crc32(record.path.encode()))
    height, width = size = sensor.height, sensor.width
    rows, columns = np.mgrid[:height, :width]
    wave = 0.5 + 0.45 * np.sin(rows / 7.0 + generator.uniform(0, 6)) * np.cos(columns / 11.0)
    black = np.zeros(size)
    pattern = np.array(sensor.cfa)
    for index, level in enumerate(sensor.black_level_dn):
        for row, column in np.argwhere(pattern == index):
            black[row :: len(pattern), column :: len(pattern)] = level
    clean, top_dn = record.role == "reference", max(16383.0, sensor.white_level_dn)
    signal = 3.0 * wave if dark else (13500.0 if clean else 13500.0 / float(record.ratio or 1)) * wave
    mosaic = black + signal + generator.normal(0, 6 if dark or not clean else 40, size)
    if clean and not dark:
        top, left = height // 2, width // 2
        mosaic[top : top + 6, left : left + 8] = top_dn
        mosaic[top - 8 : top, left : left + 8] = 15700
        mosaic[top : top + 6, left - 8 : left] = black[top : top + 6, left - 8 : left] - 30
    if not clean:
        mosaic[:4, :6] += 400  # above white, once amplified
    result: NDArray[np.uint16] = np.clip(np.rint(mosaic), 1, top_dn).astype(np.uint16)
    return result


def prediction_of(reference: NDArray[np.uint16], name: str) -> NDArray[np.float32]:
    """(H, W), too bright, a little noisy, in places saturated, beyond, or negative."""
    generator = np.random.default_rng(zlib.crc32(name.encode()))
    top_dn = 16383 if reference.max() <= 16383 else 65535
    result = 1.12 * (reference.astype(np.float64) - 512) / (top_dn - 512) + generator.normal(0.0, 0.02, reference.shape)
    result[10:14, 16:24] = 1.0
    result[18:20, 4:8] = 1.25
    result[24:28, 6:18] -= 0.1
    return result.astype(np.float32)


def exposure_of(record: FrameRecord, reference: FrameRecord) -> Exposure:
    """As the manifest has it; where it has none, 4 s at the base ISO and what the nominal ratio leaves of it."""
    long = Exposure(reference.iso or Fraction(100), reference.exposure_s or Fraction(4), Fraction(8))
    if record is reference:
        return long
    assert long.iso is not None
    assert long.exposure_s is not None
    iso = record.iso or long.iso
    return Exposure(iso, record.exposure_s or long.iso * long.exposure_s / (iso * (record.ratio or 1)), Fraction(8))


def build(
    name: str, folder: Path, chosen: Callable[[FrameRecord], bool], *,
    sensor: Callable[[int, str, tuple[int, int]], Sensor] = sensor_at, sizes: Sequence[tuple[int, int]] = SIZES,
    drift_dn: tuple[float, ...] = (1.0, -2.0, 3.0, 0.0), dark: int | None = DARK,
) -> Pairs:  # fmt: skip
    """Write a shipped set's chosen noisy frames, their references, a manifest of them, and predictions of all.

    The black levels of noisy frames are off those of their references by ``drift_dn``, as some cameras' are from ISO to
    ISO.
    Every other prediction lies there packed, the rest as mosaics. The card's subsets stay, with as many pairs as are
    left of them.
    """
    manifest = shipped_manifest(name)
    noisy = [record for record in manifest.records if record.role == "noisy" and chosen(record)]
    record_of = {record.path: record for record in manifest.records}
    wanted = {record.path for record in noisy} | {str(record.reference) for record in noisy}
    records = [record for record in manifest.records if record.path in wanted]
    scenes = sorted({(record.camera, record.scene) for record in records}, key=lambda of: (of[0], len(of[1]), of[1]))
    numbers = {scene: sum(one[0] == scene[0] for one in scenes[:at]) for at, scene in enumerate(scenes)}
    csv, files = folder / f"{name}.csv", manifest.folder(folder)
    pixels = {}
    for record in records:
        number = numbers[record.camera, record.scene]
        one = sensor(number, record.camera, sizes[number % len(sizes)])
        if record.role == "noisy":
            levels = zip(one.black_level_dn, drift_dn, strict=True)
            one = replace(one, black_level_dn=tuple(level + drift for level, drift in levels))
        pixels[record.path] = pixels_of(record, one, dark=number == dark)
        exposure = exposure_of(record, record_of[record.reference or record.path])
        write_dng(place_of(record, files), pixels[record.path], one, exposure)
    kept = [replace(subset, pairs=sum(map(subset.holds, noisy))) for subset in manifest.card.subsets]
    counts: dict[str, int] = {"noisy": len(noisy), "reference": len(records) - len(noisy)}
    save_records(csv, records)
    save_card(csv.with_suffix(".json"), replace(manifest.card, counts=counts, subsets=tuple(kept)))
    made = Pairs(name, csv, folder, files, {r.path: prediction_of(pixels[str(r.reference)], r.path) for r in noisy})
    arranged = published_code.xtrans if manifest.card.cfa == "xtrans" else published_code.bayer_by_pattern
    for at, record in enumerate(noisy):
        prediction = made.mosaics[record.path]
        if at % 2:
            with rawpy.imread(str(files / str(record.reference))) as raw:
                prediction = arranged(prediction, raw)
        save_prediction(made.predictions, record.path, prediction)
    return made


def assert_published_predictions(
    pairs: Pairs, protocol: str, routes: dict[str, Route] = published_code.BAYER
) -> EvaluationResult:
    route = routes[protocol]
    result = pairs.evaluate(protocol)
    assert_equal(result, lambda pair: route.of_prediction(pairs.mosaics[pair.path], pairs.files / pair.reference))
    return result


def assert_published(pairs: Pairs, protocol: str, routes: dict[str, Route] = published_code.BAYER) -> EvaluationResult:
    """Hold the input itself, which a network returns that changes nothing, and predictions; return their result."""
    baseline = pairs.evaluate(protocol, baseline=True)
    assert_equal(
        baseline, lambda pair: routes[protocol].of_input(pairs.files / pair.path, pairs.files / pair.reference)
    )
    return assert_published_predictions(pairs, protocol, routes)


# --- ELD --------------------------------------------------------------------------------------------------------------

ELD_CAMERAS = ["SonyA7S2", "NikonD850"]


def some_eld(record: FrameRecord) -> bool:
    """A frame of each factor of each scene, at one ISO and the next in turn."""
    number, turn = int(record.path[-8:-4]), int((record.scene or "").removeprefix("scene-"))
    return record.camera in ELD_CAMERAS and number in (4 + 5 * (turn % 3), 5 + 5 * ((turn + 1) % 3))


@pytest.fixture(scope="module")
def eld(tmp_path_factory: pytest.TempPathFactory) -> Pairs:
    return build("eld", tmp_path_factory.mktemp("eld"), some_eld)


ELD_COUNTS = dict.fromkeys(("eld", "eld-uncorrected", "eld-srgb"), 40) | {"led-eld": 32}
ELD_COUNTS |= dict.fromkeys(("pmn-eld", "sony-eld", "lrd-eld"), 20)


@pytest.mark.parametrize("name", ELD_COUNTS)
def test_protocols_of_eld(name: str, eld: Pairs) -> None:
    assert len(assert_published(eld, name).units) == ELD_COUNTS[name]


def test_led_cuts_an_odd_last_row_and_column_off(tmp_path: Path) -> None:
    assert_published(build("eld", tmp_path, some_eld, sizes=((41, 57), (45, 48), (38, 51))), "led-eld")


def test_libraw_states_white_levels_per_channel_of_one_of_the_cameras(eld: Pairs) -> None:
    """Or the comparison above would not cover them; where it does not, the result says so."""
    levels = []
    for camera in ("NikonD850", "SonyA7S2"):
        with rawpy.imread(str(next((eld.files / camera / "scene-3").glob("IMG_0006.*")))) as raw:
            levels.append((raw.camera_white_level_per_channel, raw.white_level))
    assert levels[0][0] is not None
    assert levels[0][0][0] not in (levels[0][1], 16383)
    assert levels[1][0] is None
    result = eld.evaluate("led")
    (note,) = (note for note in result.notes if note.startswith("LibRaw"))
    assert "of the references of 16 pairs, such as that of SonyA7S2/scene-" in note
    assert not any("SonyA7S2" in note for note in eld.evaluate("led", cameras=["NikonD850"]).notes)


def test_levels_that_are_not_the_files_are_said(eld: Pairs) -> None:
    pmn, eld_itself = (eld.evaluate(name, cameras=["SonyA7S2"]) for name in ("pmn-eld", "eld"))
    assert [image.path for image in pmn.scores] == [image.path for image in eld_itself.scores]
    assert pmn.scores != eld_itself.scores  # the files' black level is not 512
    assert any("black 512, white 16383 was taken for every file, as protocol pmn-eld" in note for note in pmn.notes)


# --- SID --------------------------------------------------------------------------------------------------------------

SONY_SCENES = ("10003", "10034", "10074", "10178", "10185", "10187", "20005", "20188")
FUJI_SCENES = ("10019", "10089", "10145", "10191")


def every_sid(record: FrameRecord) -> bool:
    return record.split != "train" and fnmatchcase(record.path, "*/short/?????_00_*")


@pytest.fixture(scope="module")
def sid(tmp_path_factory: pytest.TempPathFactory) -> Pairs:
    """Test and validation scenes, indoors and out, with one, two and three factors each."""
    folder = tmp_path_factory.mktemp("sid")
    return build("sid-sony", folder, lambda record: every_sid(record) and record.scene in SONY_SCENES)


SID_COUNTS = dict.fromkeys(("sid", "sid-uncorrected", "pmn-sid", "sony-sid", "lrd-sid"), 19) | {"led-sid": 14}


@pytest.mark.parametrize("name", SID_COUNTS)
def test_protocols_of_sid(name: str, sid: Pairs) -> None:
    assert len(assert_published(sid, name).units) == SID_COUNTS[name]


def test_each_protocol_has_as_many_pairs_as_were_published() -> None:
    """Of the shipped sets; the trees above hold a few of them."""
    counts = {
        240: ["eld eld"],
        60: ["eld pmn-eld", "eld sony-eld", "eld lrd-eld"],
        96: ["eld led-eld"],
        129: [f"sid-sony {name}" for name in ("sid", "pmn-sid", "sony-sid", "lrd-sid", "sid-tpami", "sid-srgb")],
        175: ["crvd rvidenet-crvd", "crvd florn-crvd"],
        93: ["sid-sony led-sid", "sid-sony sid2018"],
        45: ["sid-sony eld-cvpr20"],
        94: ["sid-fuji sid2018"],
    }
    for count, names in counts.items():
        assert [len(scored_pairs(*name.split())) for name in names] == [count] * len(names), names
    assert {pair.scene for pair in scored_pairs("eld", "led-eld")} == {f"scene-{number}" for number in range(3, 11)}
    for name in ("led-sid", "sid2018"):
        assert {pair.split for pair in scored_pairs("sid-sony", name)} == {"test"}


def test_a_protocols_own_subset_is_the_only_one() -> None:
    with pytest.raises(ArgumentError, match="'eld-cvpr20' scores the subset 'indoor-15', not 'eval-first'; leave"):
        scored_pairs("sid-sony", "eld-cvpr20", subset="eval-first")


def test_frames_that_are_too_small_for_a_region(sid: Pairs) -> None:
    result = sid.evaluate("eld-cvpr20")
    assert (result.scored, len(result.problems), len(result.units)) == (0, 9, 9)
    assert "a packed image of 20 x 28 is too small for the region 'centre-512'" in str(result.problems[0])


# --- X-Trans ----------------------------------------------------------------------------------------------------------

XTRANS_SIZES = ((48, 66), (50, 63), (54, 60), (53, 71))  # some do not fill whole periods: packing crops


@pytest.fixture(scope="module")
def fuji(tmp_path_factory: pytest.TempPathFactory) -> Pairs:
    folder = tmp_path_factory.mktemp("fuji")
    return build(
        "sid-fuji",
        folder,
        lambda record: every_sid(record) and record.scene in FUJI_SCENES,
        sensor=fuji_at,
        sizes=XTRANS_SIZES,
        drift_dn=(0.0,) * 3,
    )


@pytest.mark.parametrize("name", published_code.XTRANS)
def test_protocols_of_sid_on_xtrans(name: str, fuji: Pairs) -> None:
    assert len(assert_published(fuji, name, published_code.XTRANS).units) == 10


# --- LRD's own --------------------------------------------------------------------------------------------------------


def lrd_at(number: int, camera: str, size: tuple[int, int]) -> Sensor:
    """As the published code takes every file to be: R first, one black level, white 65535."""
    del number, camera
    return Sensor("Maker", "Drone", BAYER["RGGB"], (1024.0,) * 4, 65535.0, *size, WHITE_BALANCE, MATRIX)


def test_lrd_on_its_own_set(tmp_path: Path) -> None:
    scenes = [f"00{number}" for number in range(541, 549)]
    lrd = build("lrd", tmp_path, lambda record: record.scene in scenes, sensor=lrd_at, drift_dn=(0.0,) * 4)
    assert len(assert_published(lrd, "lrd-lrd").units) == 8


# --- every colour filter array, in a set of one's own -----------------------------------------------------------------

WHOLE = ["raw", *ELD_COUNTS, *SID_COUNTS]
ODD_LEVELS = {3: (1019.0,) * 3, 4: (497.0, 509.0, 516.0, 530.0)}  # by their number


def own_route(name: str, cfa: str, pattern: Cfa) -> Route:
    """A protocol's way on patterns that its code does not know.

    X-Trans: the SID code's packing, where its period begins. Quad-Bayer and nona-Bayer: packed in strided slices; the
    pixels are LibRaw's, which does not understand the pattern, so the levels are those that the file was written with.
    """
    top, left = (-int(digit) % 6 for digit in cfa[-2:])

    def arranged(mosaic: NDArray[np.float32], raw: rawpy.RawPy) -> NDArray[np.float32]:
        packed = published_code.xtrans(mosaic[top:, left:], raw) if is_xtrans(pattern) else None
        return reference_pack(mosaic, pattern) if packed is None else packed

    def target(raw: rawpy.RawPy) -> NDArray[np.float32]:
        stated = np.array([ODD_LEVELS[levels_of(pattern)][index] for index in indices_of(pattern)], np.float32)
        black = np.float32(512) if name.startswith(("pmn", "sony")) else stated[:, None, None]
        white = np.float32(raw.white_level if name.startswith(("led", "lrd", "raw")) else 16383)
        return published_code.unit((arranged(published_code.dn(raw), raw) - black) / (white - black))

    return replace(published_code.BAYER[name], arranged=arranged, target=target)


@pytest.mark.parametrize("cfa", [*BAYER, "xtrans-00", "xtrans-42", "quad-00", "quad-31", "nona-00", "nona-14"])
def test_a_set_of_ones_own_in_every_cfa(cfa: str, tmp_path: Path) -> None:
    """All protocols that score whole frames, with black and white levels that no code has as a constant."""
    pattern = CFAS[cfa]
    own = build_own_set(tmp_path, cfa=pattern, black=ODD_LEVELS[levels_of(pattern)], size=(120, 132))
    reference = own.files / "s0/clean.dng"
    with rawpy.imread(str(reference)) as raw:
        clean = raw.raw_image_visible.copy()
    written = {path: prediction_of(clean, path) for path in ("s0/x50.dng", "s0/x100.dng")}
    for path, mosaic in written.items():
        save_prediction(tmp_path / "p", path, mosaic)
    for name in WHOLE if cfa in BAYER else set(WHOLE) - {"eld-srgb"}:  # ELD's pipeline is of Bayer
        route = published_code.BAYER[name] if cfa in BAYER else own_route(name, cfa, pattern)
        result = evaluate(tmp_path / "p", **own.where, protocol=name)
        assert result.scored == 2
        scores = {path: route.of_prediction(mosaic, reference) for path, mosaic in written.items()}
        assert_equal(result, lambda pair: scores[pair.path])  # noqa: B023 (called here)


# --- the centre, and sRGB ---------------------------------------------------------------------------------------------

CENTRE = ("eld-cvpr20", "sid-tpami", "sid-srgb")
INDOORS = {"10185": 100, "10187": 250, "20188": 300, "20201": 100}


@pytest.fixture(scope="module")
def large(tmp_path_factory: pytest.TempPathFactory) -> Pairs:
    """A pair in each phase, of frames that are larger than the centre of 512 x 512 packed pixels, by odd numbers."""
    return build(
        "sid-sony",
        tmp_path_factory.mktemp("large"),
        lambda record: every_sid(record) and INDOORS.get(record.scene) == record.ratio,
        sizes=((1030, 1046), (1028, 1042)),
        dark=None,
    )


@pytest.mark.parametrize("name", CENTRE)
def test_the_centre_of_512(name: str, large: Pairs) -> None:
    result = assert_published_predictions(large, name)
    assert len(result.units) == 4


def test_predictions_in_srgb_of_the_centre(large: Pairs, tmp_path: Path) -> None:
    """Those of Raw2RGB and RGB2RGB are scored alike, whatever their input was."""
    made = {}
    for pair in scored_pairs("", "sid-raw2rgb", manifest=large.csv, root=large.root):
        with rawpy.imread(str(large.files / pair.reference)) as raw:
            clean = published_code.eld_frame(raw)
        noise = np.random.default_rng(zlib.crc32(pair.path.encode())).normal(0, 0.03, (3, *clean.shape[1:]))
        shown = 0.9 * published_code.eld_rendered(clean, large.files / pair.reference) + noise
        made[pair.path] = (shown.astype(np.float32), clean)
        save_prediction(tmp_path, pair.path, made[pair.path][0])

    def scored(pair: PairRecord) -> Score:
        output, clean = (published_code.centre(one) for one in made[pair.path])
        return published_code.eld_rgb_score(output, clean, large.files / pair.reference)

    for name in ("sid-raw2rgb", "sid-rgb2rgb"):
        result = evaluate(tmp_path, manifest=large.csv, root=large.root, protocol=name)
        assert_equal(result, scored)
        assert result.scored == 4


def test_renderings_in_each_phase(sid: Pairs, tmp_path: Path) -> None:
    codes = {}
    for pair in scored_pairs("", "sid2018", manifest=sid.csv, root=sid.root):
        clean = published_code.sid_reference(sid.files / pair.reference).astype(np.float64)
        noise = np.random.default_rng(zlib.crc32(pair.path.encode())).normal(0, 6, clean.shape)
        codes[pair.path] = np.rint(np.clip(0.95 * clean + noise, 0, 255)).astype(np.uint8)
        target = (tmp_path / pair.path).with_suffix(".png")
        target.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(codes[pair.path]).save(target)
    assert len(codes) == 14
    result = evaluate(tmp_path, manifest=sid.csv, root=sid.root, protocol="sid2018")
    assert_equal(result, lambda pair: published_code.sid_score(codes[pair.path], sid.files / pair.reference))


# --- no protocol is left out ------------------------------------------------------------------------------------------


def test_every_shipped_protocol_is_compared() -> None:
    """The clips' in ``test_video``, those of sets whose files are not all raw in tests of their own."""
    lrid = "pmn-lrid", "sony-lrid", "two-shots-lrid"
    assert {*ELD_COUNTS, *SID_COUNTS, *CENTRE, "lrd-lrd", *lrid, "raw"} == {*published_code.BAYER}
    elsewhere = {"sfrn-sidd", "yond-sidd", "rvidenet-crvd", "florn-crvd", "rvideformer-recrvd", "brve-llrvd"}
    assert {*published_code.BAYER, *published_code.RENDERED, *published_code.CLIPS, *elsewhere} == {*PROTOCOLS}
    assert {name for name in PROTOCOLS if PROTOCOLS[name].kind is not IMAGES} == {*published_code.CLIPS}


# --- levels per channel -----------------------------------------------------------------------------------------------


def test_levels_per_channel_may_differ_between_channels() -> None:
    from eldata.sources.frames import Frame

    sensor = sensor_of((8, 12))
    mosaic = mosaic_of("x", (8, 12), bright=True)
    whites = (15000.0, 15100.0, 14900.0, 15200.0)
    frame = Frame.of_raw(mosaic, sensor, "x", Exposure(), whites).with_levels("metadata-per-channel")
    packed = oracle.pack(mosaic.astype(np.float64), sensor.cfa_pattern.astype(np.int64))
    black = np.array(sensor.black_level_dn)[:, None, None]
    expected = (packed - black) / (np.array(whites)[:, None, None] - black)
    for clip, low, high in (("both", 0, 1), ("upper", -np.inf, 1), ("none", -np.inf, np.inf)):
        found = frame.normalise(clip, gain=3.0)  # type: ignore[arg-type] # one of three
        assert found.dtype == np.float32
        np.testing.assert_allclose(found, np.clip(3 * np.clip(expected, low, high), low, high), rtol=1e-5, atol=1e-6)
