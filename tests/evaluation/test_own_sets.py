"""Sets of one's own, choices of a protocol that come to the same, references that cannot be decoded."""

from __future__ import annotations

import gc
import shutil
import weakref
from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from eldata.base.workers import Workers
from eldata.errors import ArgumentError
from eldata.evaluation import evaluate, save_prediction
from eldata.evaluation.evaluate import perform_each
from eldata.evaluation.published import comparison_table
from eldata.evaluation.request import make_request
from eldata.manifest.card import Subset, save_card
from eldata.manifest.catalogue import load_manifest, shipped_manifest
from eldata.manifest.table import save_records
from eldata.metrics.registry import IMAGES
from eldata.protocols import PROTOCOLS
from eldata.raw.dng import write_dng
from eldata.raw.reading import read_raw
from tests.drv_tree import small_drv
from tests.evaluation import oracle
from tests.evaluation.helpers import scored_pairs
from tests.evaluation.own_set import OwnSet, build_own_set
from tests.sid_tree import SENSORS, exposure_of, frames_of, mosaic_of

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from eldata.records import RawFrame
    from tests.evaluation.helpers import Tree


def predict(own: OwnSet, folder: Path, *, scenes: int = 1, ratios: tuple[int, ...] = (50, 100)) -> Path:
    generator = np.random.default_rng(3)
    for scene in range(scenes):
        target = oracle.reference(own.files / f"s{scene}/clean.dng")
        for ratio in ratios:
            noisy = 1.1 * target + generator.normal(0, 0.02, target.shape)
            save_prediction(folder, f"s{scene}/x{ratio}.dng", noisy.astype(np.float32))
    return folder


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> OwnSet:
    return build_own_set(tmp_path_factory.mktemp("own"), scenes=2)


@pytest.fixture(scope="module")
def preds(own: OwnSet, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return predict(own, tmp_path_factory.mktemp("preds"), scenes=2)


# --- one pass ---------------------------------------------------------------------------------------------------------


def test_frames_are_gone_before_the_next_ones_are_read(
    own: OwnSet, preds: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without Python's search for circles, in which frames of hundreds of megabytes would wait for it."""
    from eldata.raw import reading

    read: list[weakref.ref[NDArray[Any]]] = []
    alive: list[int] = []
    genuine = reading.read_raw

    def watched(path: Path) -> RawFrame:
        alive.append(sum(mosaic() is not None for mosaic in read))
        frame = genuine(path)
        read.append(weakref.ref(frame.mosaic))
        return frame

    monkeypatch.setattr(reading, "read_raw", watched)
    gc.disable()
    try:
        evaluate(preds, **own.where)
    finally:
        gc.enable()
    assert alive == [0, 0]


# --- choices that come to the same ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def sony(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """SID's frames of the first factor with black level 512, and predictions: the root, the folder."""
    root = tmp_path_factory.mktemp("sony")
    manifest = shipped_manifest("sid-sony")
    wanted = {pair.path: pair.reference for pair in scored_pairs("sid-sony", "sid")}
    generator = np.random.default_rng(8)
    for record in frames_of(manifest, set(wanted)):
        path = root / "SID" / record.path
        path.parent.mkdir(parents=True, exist_ok=True)
        sensor = replace(SENSORS["sid-sony"], black_level_dn=(512.0,) * 4)
        write_dng(path, mosaic_of("sid-sony", record), sensor, exposure_of(record))
        if record.path in wanted:
            save_prediction(root / "preds", record.path, generator.uniform(0, 1, (4, 20, 30)).astype(np.float32))
    return root, root / "preds"


def test_names_that_share_a_score(sony: tuple[Path, Path]) -> None:
    """``sid`` takes the files' black level, ``pmn-sid`` 512, and these files say 512."""
    root, preds = sony
    sid, pmn = (evaluate(preds, "sid-sony", root=root, protocol=name) for name in ("sid", "pmn-sid"))
    assert sid.scored == 129
    assert sid.scores == pmn.scores
    assert sid.scored_unlike(pmn) == []
    assert pmn.provenance["equal_choices"] == {"levels": ["published", "sid-sony"]}
    assert not pmn.notes
    assert comparison_table(pmn).count("> yours") == comparison_table(sid).count("> yours") == 3


def test_the_input_has_its_amplification_too(sony: tuple[Path, Path], own: OwnSet, tmp_path: Path) -> None:
    """The files' ratio is the manifest's, or it is not."""
    root, _ = sony
    both = ["metadata", "nominal"]
    result = evaluate(None, "sid-sony", root=root, protocol="pmn-sid", baseline="input")
    assert result.provenance["equal_choices"] == {"levels": ["published", "sid-sony"], "amplification": both}
    records = load_manifest(own.manifest).records
    other = [replace(record, ratio=Fraction(99) if record.ratio == 100 else record.ratio) for record in records]
    shutil.copy(own.manifest.with_suffix(".json"), tmp_path / "mine.json")
    save_records(tmp_path / "mine.csv", other)
    result = evaluate(None, manifest=tmp_path / "mine.csv", root=own.root, protocol="eld", baseline="input")
    assert result.provenance["equal_choices"] == {"levels": ["published"], "amplification": ["metadata"]}
    result = evaluate(None, **own.where, protocol="eld", baseline="input")
    assert result.provenance["equal_choices"] == {"levels": ["published"], "amplification": both}
    sid = replace(result, protocol=replace(PROTOCOLS["eld"], amplification="nominal"))
    assert result.scored_unlike(sid) == []
    unstated = replace(result, provenance=result.provenance | {"equal_choices": {}})
    words = "input amplified: by the files' exposure ratio against by the manifest's ratio"
    assert unstated.scored_unlike(sid.protocol) == [words]  # type: ignore[arg-type]
    of_predictions = replace(unstated, provenance=unstated.provenance | {"predictions": "preds"})
    assert of_predictions.scored_unlike(PROTOCOLS["sid"]) == []


def test_levels_of_a_dng_count(own: OwnSet, tmp_path: Path) -> None:
    """A prediction that is a DNG is normalised with its own levels, which have to agree as well."""
    preds = tmp_path / "p"
    frame = read_raw(own.files / "s0/clean.dng")
    for place in ("s0/x50", "s0/x100", "s1/x50", "s1/x100"):
        (preds / place).parent.mkdir(parents=True, exist_ok=True)
        sensor = replace(frame.sensor, black_level_dn=(512.0,) * 4, white_level_dn=16383.0)
        write_dng((preds / place).with_suffix(".dng"), frame.mosaic, sensor, frame.exposure)

    def equal(own: OwnSet, protocol: str) -> dict[str, list[str]]:
        result = evaluate(preds, **own.where, protocol=protocol)
        assert result.scored == 4
        found: dict[str, list[str]] = result.provenance["equal_choices"]
        return found

    assert equal(own, "eld") == {"levels": ["published"]}
    flat = build_own_set(tmp_path / "flat", scenes=2)
    for path in flat.files.rglob("*.dng"):
        frame = read_raw(path)
        write_dng(path, frame.mosaic, replace(frame.sensor, black_level_dn=(512.0,) * 4), frame.exposure)
    assert equal(flat, "eld") == {"levels": ["published", "sid-sony"]}
    assert equal(flat, "lrd-sid") == {"levels": ["metadata", "metadata-per-channel"]}
    write_dng(preds / "s0/x50.dng", frame.mosaic, replace(sensor, black_level_dn=(500.0,) * 4), frame.exposure)
    assert equal(flat, "eld") == {"levels": ["published"]}


# --- sets of one's own ------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def ten_bits(tmp_path_factory: pytest.TempPathFactory) -> OwnSet:
    """Files of a camera of 10 bits: black 64, white 1023, as they state."""
    own = build_own_set(tmp_path_factory.mktemp("ten"))
    for path in own.files.rglob("*.dng"):
        frame = read_raw(path)
        mosaic = (frame.mosaic.astype(np.float64) - 512).clip(-200) * 959 / 14788 + 64
        sensor = replace(frame.sensor, black_level_dn=(64.0,) * 4, white_level_dn=1023.0)
        write_dng(path, np.rint(mosaic).clip(0, 1023).astype(np.uint16), sensor, frame.exposure)
    return own


def test_another_white_level_than_the_files_is_said(ten_bits: OwnSet, tmp_path: Path) -> None:
    """With both numbers, of the input as of predictions."""
    said = (
        "the files of Mine saturate at 1023 DN, and the protocol divides by 16383: --protocol raw takes the files' own "
        "white level"
    )
    for ratio in (50, 100):
        save_prediction(tmp_path / "p", f"s0/x{ratio}.dng", np.full((4, 30, 42), 0.02, np.float32))
    for given in ({"predictions": None, "baseline": "input"}, {"predictions": tmp_path / "p"}):
        assert evaluate(**given, **ten_bits.where, protocol="eld").notes.count(said) == 1
        assert not any("saturate" in note for note in evaluate(**given, **ten_bits.where, protocol="lrd-sid").notes)


@pytest.mark.parametrize(("white_dn", "is_said"), [(16056.0, False), (16055.0, True), (16711.0, True)])
def test_two_percent_of_the_white_level_are_usual(white_dn: float, is_said: bool, tmp_path: Path) -> None:
    own = build_own_set(tmp_path)
    for path in own.files.rglob("*.dng"):
        frame = read_raw(path)
        write_dng(path, frame.mosaic, replace(frame.sensor, white_level_dn=white_dn), frame.exposure)
    result = evaluate(None, **own.where, protocol="eld", baseline="input")
    assert any(f"saturate at {white_dn:g} DN" in note for note in result.notes) == is_said


def test_white_levels_of_several_cameras_are_one_line(tree: Tree) -> None:
    """The demo's: of its two cameras one saturates 7 % below 16383. Its card names ``eld``."""
    result = evaluate(None, **tree.where, baseline="input")
    assert result.protocol == PROTOCOLS["eld"]
    (note,) = [note for note in result.notes if "saturate" in note]
    assert note.startswith("the files of DemoBeta saturate at 15303 DN, and the protocol divides by 16383:")


@pytest.mark.parametrize("name", [name for name, one in PROTOCOLS.items() if one.space == "raw" and one.kind is IMAGES])
def test_any_protocol_scores_whatever_factors_a_set_has(name: str, own: OwnSet, preds: Path) -> None:
    result = evaluate(preds, **own.where, protocol=name)
    assert result.provenance["ratios"] == [50, 100]
    protocol = PROTOCOLS[name]
    chooses = protocol.ratios or protocol.cameras or protocol.scenes or protocol.subset
    assert bool(result.provenance["set_aside"]) == bool(chooses)
    if not PROTOCOLS[name].region.startswith("centre"):
        assert result.scored == 4
    if name == "eld":
        assert result.notes[0] == (
            "this set's own pairs are scored (x50, x100), not those of the protocol: factors x100, x200"
        )


@pytest.mark.parametrize(
    ("ratios", "scored", "set_aside"),
    [((100, 200), [100, 200], []), ((1, 10, 100, 200), [100, 200], []), ((100,), [100], ["factors x100, x200"])],
)
def test_a_set_with_all_of_the_protocols_factors_is_scored_at_them(
    ratios: tuple[int, ...], scored: list[int], set_aside: list[str], tmp_path: Path
) -> None:
    own = build_own_set(tmp_path, ratios=ratios)
    preds = predict(own, tmp_path / "p", ratios=ratios)
    result = evaluate(preds, **own.where, protocol="eld")
    assert result.provenance["ratios"] == scored
    assert result.provenance["set_aside"] == set_aside
    assert {image.ratio for image in result.scores} == set(scored)


@pytest.mark.parametrize(
    ("base", "stated", "found"),
    [
        ("raw", 'cameras = ["DemoBeta"]', {"DemoBeta/scene-1"}),
        ("raw", 'subset = "beta"', {"DemoBeta/scene-1"}),
        ("raw", 'scenes = ["scene-9"]', "no pair has scene scene-9; known are scene-1"),
        ("led-eld", "ratios = []", ["cameras SonyA7S2, NikonD850", "8 scenes"]),
    ],
)
def test_what_a_protocol_of_ones_own_chooses_is_applied_or_refused(
    base: str, stated: str, found: set[str] | list[str] | str, tree: Tree, tmp_path: Path
) -> None:
    """What it has from a published base, of another set, is set aside, and said."""
    subsets = Subset("all", "all", "", 24), Subset("beta", "beta", "", 12, paths="DemoBeta/*")
    table = tmp_path / "eld-demo.csv"
    shutil.copyfile(tree.manifest, table)
    save_card(table.with_suffix(".json"), replace(load_manifest(tree.manifest).card, subsets=subsets))
    file = tmp_path / "mine.toml"
    file.write_text(f'base = "{base}"\nname = "mine"\ntitle = "mine"\n{stated}\n', encoding="utf-8")

    def evaluated(**options: Any) -> Any:
        return evaluate(None, manifest=table, root=tree.root, protocol=file, baseline="input", **options)

    if isinstance(found, str):
        with pytest.raises(ArgumentError, match=found):
            evaluated()
        return
    result = evaluated()
    assert result.provenance["set_aside"] == (found if isinstance(found, list) else [])
    if isinstance(found, set):
        assert {f"{image.camera}/{image.scene}" for image in result.scores} == found
    if "cameras" in stated:
        with pytest.raises(ArgumentError, match="protocol 'mine' scores DemoBeta, not DemoAlpha"):
            evaluated(cameras=["DemoAlpha"])


# --- one bad file -----------------------------------------------------------------------------------------------------


def spoil_pixels(path: Path) -> None:
    """Make a file that states what it should and cannot be decoded: its last row is empty."""
    frame = read_raw(path)
    mosaic = frame.mosaic.copy()
    mosaic[-1] = 0x1234
    write_dng(path, mosaic, frame.sensor, frame.exposure)
    row, content = b"\x34\x12" * mosaic.shape[1], path.read_bytes()
    assert content.count(row) == 1
    path.write_bytes(content.replace(row, bytes(len(row))))


def test_a_reference_that_cannot_be_decoded_is_the_problem_of_its_pairs(tmp_path: Path) -> None:
    own = build_own_set(tmp_path, scenes=2)
    predict(own, tmp_path / "p", scenes=2)
    spoil_pixels(own.files / "s0/clean.dng")
    found = evaluate(tmp_path / "p", **own.where)
    assert [problem.path for problem in found.problems] == ["s0/x100.dng", "s0/x50.dng"]
    assert "its reference s0/clean.dng cannot be used: damaged: its last row" in str(found.problems[0])
    assert found.scored == 0
    rest = evaluate(tmp_path / "p", **own.where, allow_missing=True)
    assert [image.scene for image in rest.scores] == ["s1", "s1"]
    assert rest.problems == found.problems


def test_a_noisy_frame_that_cannot_be_decoded_is_the_problem_of_its_pair(tmp_path: Path) -> None:
    own = build_own_set(tmp_path)
    spoil_pixels(own.files / "s0/x50.dng")
    found = evaluate(None, **own.where, baseline="input", allow_missing=True)
    assert [problem.path for problem in found.problems] == [str(own.files / "s0/x50.dng")]
    assert [image.ratio for image in found.scores] == [100]


# --- errors of our own ------------------------------------------------------------------------------------------------


def test_an_error_of_our_own_is_raised_and_names_its_unit(own: OwnSet, preds: Path, tmp_path: Path) -> None:
    """It is not a problem of the data, of images and clips alike, whatever is allowed to be missing."""
    drv = small_drv(tmp_path / "drv", ("0007",), 12)
    broken = replace(PROTOCOLS["eld"], name="broken"), replace(PROTOCOLS["drv-rgb"], name="broken")
    for protocol in broken:
        object.__setattr__(protocol, "region", 1)  # as a mistake of ours might, past all checks
    images = make_request(preds, "", None, manifest=own.manifest, root=own.root, allow_missing=True)
    clips = make_request(None, "", None, manifest=drv.csv, root=drv.root, ids=["0007"], baseline="input")
    for request, protocol, unit in zip((images, clips), broken, ("s0/clean.dng", "long/0007/"), strict=True):
        with pytest.raises(TypeError) as caught:
            perform_each([replace(request, protocol=protocol, workers=Workers(1))])
        assert any(
            note.startswith(f"while the predictions for the reference {unit}") for note in caught.value.__notes__
        )
