"""Sets of one's own, of DNGs and of arrays; choices of a protocol that come to the same; undecodable files."""

from __future__ import annotations

import gc
import re
import shutil
import weakref
from collections.abc import Mapping
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from eldata import SyntheticPairs
from eldata.base.workers import Workers
from eldata.datasets import CleanFrames
from eldata.datasets.synthetic.synthesis import Recipe, synthesize
from eldata.errors import ArgumentError, EldataError
from eldata.evaluation import EvaluationResult, evaluate
from eldata.evaluation.evaluate import perform_each
from eldata.evaluation.request import make_request
from eldata.manifest.card import Subset, save_card
from eldata.manifest.catalogue import load_manifest, save_manifest
from eldata.manifest.table import save_records
from eldata.noise import CameraProfile
from eldata.protocols import PROTOCOLS
from eldata.raw.dng import write_dng
from eldata.raw.reading import read_raw
from eldata.raw.stated import MosaicFacts
from eldata.sources.store import build_store, source_of_dataset
from tests.drv_tree import SmallDrv
from tests.evaluation.helpers import Tree
from tests.evaluation.own_set import BLACK, WHITE, OwnSet, build_own_set, predict

# --- one pass ---------------------------------------------------------------------------------------------------------


def test_frames_are_gone_before_the_next_ones_are_read(own: OwnSet, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without Python's search for circles, in which frames of hundreds of megabytes would wait for it."""
    from eldata.raw import reading

    read: list[weakref.ref[NDArray[Any]]] = []
    alive: list[int] = []
    genuine = reading.open_frame

    def watched(path: Path) -> Any:
        alive.append(sum(mosaic() is not None for mosaic in read))
        frame, layout = genuine(path)
        read.append(weakref.ref(frame.mosaic))
        return frame, layout

    monkeypatch.setenv(reading.DECODER_VARIABLE, "libraw")
    monkeypatch.setattr(reading, "open_frame", watched)
    gc.disable()
    try:
        evaluate(own.predictions, **own.where)
    finally:
        gc.enable()
    assert alive == [0, 0]


# --- choices that come to the same ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def flat(tmp_path_factory: pytest.TempPathFactory) -> OwnSet:
    """A set whose files state black level 512, with predictions."""
    flat = build_own_set(tmp_path_factory.mktemp("flat"), scenes=2, black=(512.0,) * 4)
    predict(flat, flat.predictions, 0.02)
    return flat


def test_names_that_share_a_score(flat: OwnSet) -> None:
    """``sid`` takes the files' black level, ``pmn-sid`` 512, and these files say 512."""
    sid, pmn = (evaluate(flat.predictions, **flat.where, protocol=name) for name in ("sid", "pmn-sid"))
    assert (sid.scored, sid.scores) == (4, pmn.scores)
    assert sid.scored_unlike(pmn) == []
    assert pmn.provenance["equal_choices"] == {"levels": ["published", "sid-sony"]}
    assert not any("was taken for every file" in note for note in pmn.notes)


def test_the_input_has_its_amplification_too(flat: OwnSet, own: OwnSet, tmp_path: Path) -> None:
    """The files' ratio is the manifest's, or it is not."""
    both = ["metadata", "nominal"]
    result = evaluate(None, **flat.where, protocol="pmn-sid", baseline="input")
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


def test_levels_of_a_dng_count(own: OwnSet, flat: OwnSet, tmp_path: Path) -> None:
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
    assert equal(flat, "eld") == {"levels": ["published", "sid-sony"]}
    assert equal(flat, "lrd-sid") == {"levels": ["metadata", "metadata-per-channel"]}
    write_dng(preds / "s0/x50.dng", frame.mosaic, replace(sensor, black_level_dn=(500.0,) * 4), frame.exposure)
    assert equal(flat, "eld") == {"levels": ["published"]}


# --- sets of one's own ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("white_dn", "is_said"), [(1023.0, True), (16055.0, True), (16056.0, False), (16711.0, True)])
def test_a_white_level_that_is_off_by_two_percent_is_said(white_dn: float, is_said: bool, tmp_path: Path) -> None:
    """With both numbers, of the input as of predictions, unless the protocol takes the files' own."""
    own = build_own_set(tmp_path)
    for path in own.files.rglob("*.dng"):
        frame = read_raw(path)
        mosaic = np.minimum(frame.mosaic, int(white_dn))
        write_dng(path, mosaic, replace(frame.sensor, white_level_dn=white_dn), frame.exposure)
    words = (
        f"the files of Mine saturate at {white_dn:g} DN, and the protocol divides by 16383: --protocol raw takes the "
        "files' own white level"
    )
    for given in ({"predictions": None, "baseline": "input"}, {"predictions": predict(own, tmp_path / "p", 0.02)}):
        assert (words in evaluate(**given, **own.where, protocol="eld").notes) == is_said
        assert not any("saturate" in note for note in evaluate(**given, **own.where, protocol="lrd-sid").notes)


def test_white_levels_of_several_cameras_are_one_line(tree: Tree) -> None:
    """The demo's: of its two cameras one saturates 7 % below 16383. Its card names ``eld``."""
    result = evaluate(None, **tree.where, baseline="input")
    assert result.protocol == PROTOCOLS["eld"]
    (note,) = [note for note in result.notes if "saturate" in note]
    assert note.startswith("the files of DemoBeta saturate at 15303 DN, and the protocol divides by 16383:")


@pytest.mark.parametrize(
    ("ratios", "scored"), [((100, 200), [100, 200]), ((1, 10, 100, 200), [100, 200]), ((50, 100), [50, 100])]
)
def test_a_set_with_all_of_the_protocols_factors_is_scored_at_them(
    ratios: tuple[int, ...], scored: list[int], tmp_path: Path
) -> None:
    own = build_own_set(tmp_path, ratios=ratios)
    preds = predict(own, tmp_path / "p", 0.02)
    result = evaluate(preds, **own.where, protocol="eld")
    assert result.provenance["ratios"] == scored
    aside = "this set's own pairs are scored (x50, x100), not those of the protocol: factors x100, x200"
    assert result.provenance["set_aside"] == (["factors x100, x200"] if scored[0] == 50 else [])
    assert (aside in result.notes) == (scored[0] == 50)
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


def test_a_frame_that_cannot_be_decoded_is_the_problem_of_its_pairs(tmp_path: Path) -> None:
    """A reference, and then a noisy frame."""
    own = build_own_set(tmp_path, scenes=2)
    predict(own, tmp_path / "p", 0.02)
    spoil_pixels(own.files / "s0/clean.dng")
    found = evaluate(tmp_path / "p", **own.where)
    assert [problem.path for problem in found.problems] == ["s0/x100.dng", "s0/x50.dng"]
    assert "its reference s0/clean.dng cannot be used: damaged: its last row" in str(found.problems[0])
    assert found.scored == 0
    rest = evaluate(tmp_path / "p", **own.where, allow_missing=True)
    assert [image.scene for image in rest.scores] == ["s1", "s1"]
    assert rest.problems == found.problems
    spoil_pixels(own.files / "s1/x50.dng")
    found = evaluate(None, **own.where, baseline="input", allow_missing=True)
    assert [problem.path for problem in found.problems[-1:]] == [str(own.files / "s1/x50.dng")]
    assert [image.path for image in found.scores] == ["s1/x100.dng"]


# --- errors of our own ------------------------------------------------------------------------------------------------


def test_an_error_of_our_own_is_raised_and_names_its_unit(own: OwnSet, drv: SmallDrv) -> None:
    """It is not a problem of the data, of images and clips alike, whatever is allowed to be missing."""
    broken = replace(PROTOCOLS["eld"], name="broken"), replace(PROTOCOLS["drv-rgb"], name="broken")
    for protocol in broken:
        object.__setattr__(protocol, "region", 1)  # as a mistake of ours might, past all checks
    images = make_request(own.predictions, "", None, manifest=own.manifest, root=own.root, allow_missing=True)
    clips = make_request(None, "", None, manifest=drv.csv, root=drv.root, ids=["0007"], baseline="input")
    for request, protocol, unit in zip((images, clips), broken, ("s0/clean.dng", "long/0007/"), strict=True):
        with pytest.raises(TypeError) as caught:
            perform_each([replace(request, protocol=protocol, workers=Workers(1))])
        assert any(one.startswith(f"while the predictions for the reference {unit}") for one in caught.value.__notes__)


# --- files that are arrays of floats, with levels on the card: as the same whole numbers in DNGs ----------------------


FILE_LEVELS = ("lrd-eld", "led-eld")
"""Protocols with the files' own levels; LibRaw knows none of each channel for these files."""


def rewritten(own: OwnSet, folder: Path, which: str, scale: float = 1.0, hot: float | None = None) -> OwnSet:
    """The set with some files as floats, divided by ``scale``, one pixel of which is set to ``hot`` times white."""
    shutil.copytree(own.manifest.parent, folder, dirs_exist_ok=True)
    copy = OwnSet(folder / own.manifest.name, folder / "data")
    loaded = load_manifest(own.manifest)
    white = round(WHITE / scale)
    facts = MosaicFacts("*.npy", "GBRG", tuple(level / scale for level in BLACK), white)
    renamed = {}
    for path in sorted(copy.files.glob(which)):
        mosaic = read_raw(path).mosaic
        values = (mosaic / np.float64(scale)).astype(np.float32)
        if hot is not None:
            values[np.unravel_index(mosaic.argmax(), mosaic.shape)] = hot * white
        np.save(path.with_suffix(".npy"), values)
        path.unlink()
        row = path.relative_to(copy.files).as_posix()
        renamed[row] = row.replace(".dng", ".npy")
    rows = [
        replace(row, path=renamed.get(row.path, row.path), reference=renamed.get(row.reference or "", row.reference))
        for row in loaded.records
    ]
    save_manifest(copy.manifest, replace(loaded.card, mosaics=(facts,)), rows)
    return copy


def scored(own: OwnSet, protocol: str) -> EvaluationResult:
    return evaluate(None, baseline="input", **own.where, protocol=protocol)


def figures(result: EvaluationResult) -> list[tuple[str, float, float]]:
    return [(one.path.partition(".")[0], one.psnr_db, one.ssim) for one in result.scores]


@pytest.mark.parametrize("which", ["*/clean.dng", "*/*.dng"], ids=["references", "all"])
@pytest.mark.parametrize("protocol", [*FILE_LEVELS, "eld"])
def test_floats_of_the_same_numbers_score_the_same(own: OwnSet, protocol: str, which: str, tmp_path: Path) -> None:
    floats = rewritten(own, tmp_path, which)
    assert figures(scored(floats, protocol)) == figures(scored(own, protocol))


@pytest.mark.parametrize("protocol", FILE_LEVELS)
def test_shares_of_white_score_the_same_and_no_bright_pixel_matters(own: OwnSet, protocol: str, tmp_path: Path) -> None:
    """float32 has seven digits."""
    shares = rewritten(own, tmp_path, "*/clean.dng", scale=15300, hot=1.5)
    for one, other in zip(figures(scored(shares, protocol)), figures(scored(own, protocol)), strict=True):
        assert one[0] == other[0]
        assert one[1:] == pytest.approx(other[1:], abs=1e-5)


def test_shares_of_white_are_not_scored_against_a_white_level_in_dn(own: OwnSet, tmp_path: Path) -> None:
    shares = rewritten(own, tmp_path, "*/clean.dng", scale=15300)
    result = scored(shares, "eld")
    assert result.scores == ()
    reasons = {str(problem) for problem in result.problems}
    assert len(reasons) == 4
    assert all(re.search(r"clean\.npy: its white level is 1, .* white level of 16383 ", one) for one in reasons)


def test_clean_frames_in_dn_are_taken_and_shares_of_white_are_not(
    own: OwnSet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    profile = CameraProfile.load("SonyA7S2")

    def pair(of: OwnSet) -> Mapping[str, Any]:
        monkeypatch.setenv("ELDATA_ROOT", str(of.root))
        return SyntheticPairs(CleanFrames(of.manifest), profiles=profile, crop=16)[0]

    one, other = pair(rewritten(own, tmp_path / "dn", "*/clean.dng")), pair(own)
    assert np.array_equal(one["target"].numpy(), other["target"].numpy())
    assert np.array_equal(one["input"].numpy(), other["input"].numpy())
    with pytest.raises(EldataError, match=r"clean\.npy: its white level is 1, .* noise is in DN"):
        pair(rewritten(own, tmp_path / "shares", "*/clean.dng", scale=15300))


def test_what_needs_whole_dn_names_the_file(own: OwnSet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    floats = rewritten(own, tmp_path, "*/*.dng")
    monkeypatch.setenv("ELDATA_ROOT", str(floats.root))
    refused = r"[a-z0-9]*\.npy: its pixels are no whole DN.*as the camera wrote them"
    with pytest.raises(EldataError, match=refused):
        build_store(source_of_dataset("mine", **floats.where), tmp_path / "a.h5")
    with pytest.raises(EldataError, match=refused):
        synthesize(floats.manifest, tmp_path / "out", Recipe(CameraProfile.load("SonyA7S2")))
