"""Protocols as objects: names, digests, words, comparison, and those of one's own."""

from __future__ import annotations

import hashlib
import json
import os
import re
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import pytest

from eldata.errors import ArgumentError, ManifestError
from eldata.manifest import shipped_card
from eldata.manifest.card import OWN_PROTOCOL
from eldata.metrics import ssim
from eldata.metrics.image_score import ScoringRules
from eldata.protocols import (
    PROTOCOLS,
    ClipProtocol,
    Protocol,
    default_protocol,
    get_protocol,
    load_protocol,
    protocols_for,
)
from eldata.protocols.protocol import CHOICES, NEUTRAL, canonical, fields_digest
from eldata.protocols.words import FIELDS, comparability

GOLDEN = Path(__file__).parent / "golden" / "protocols.json"

# --- frozen -----------------------------------------------------------------------------------------------------------


def deciding() -> dict[str, dict[str, Any]]:
    return {
        name: {"digest": protocol.digest, "canonical": canonical(protocol.as_dict())}
        for name, protocol in PROTOCOLS.items()
    }


def test_protocols_are_frozen() -> None:
    """A published name keeps its meaning: to change a score, add a protocol of another name."""
    if os.environ.get("ELDATA_UPDATE_GOLDEN") == "1":
        GOLDEN.write_text(json.dumps(deciding(), indent=2) + "\n", encoding="utf-8")
    golden = json.loads(GOLDEN.read_text(encoding="utf-8"))
    assert deciding() == golden
    for protocol in PROTOCOLS.values():
        protocol.check()
    for stated in golden.values():  # as the documentation says, without this package
        text = json.dumps(stated["canonical"], sort_keys=True)
        assert stated["digest"] == f"sha256:{hashlib.sha256(text.encode()).hexdigest()}"


# Another value for every field of a protocol that decides a score.
CHANGES: dict[str, Any] = {
    "dataset": "x", "ratios": (100,), "levels": "metadata", "reference_clip": "none", "rescaling": "none",
    "region": "border-2", "subset": "x", "cameras": ("x",), "scenes": ("x",), "input_clip": "none",
    "amplification": "nominal", "space": "srgb", "rendering": "libraw", "rounding": "8-bit",
    "rescaling_region": "border-2", "prediction_clamp": "none", "mse_offset": 1e-8, "ssim_window": "gaussian-11",
    "ssim_covariance": "population", "dark_shading": "sha256:" + "0" * 64, "input_space": "srgb",
    "prediction_space": "srgb", "response": "gamma-1.8", "quantisation": "dn-truncated",
    "ssim_planes": "mosaic",
}  # fmt: skip
CHANGES_OF_CLIPS: dict[str, Any] = {"pixels": "rgb", "frames": "x", "frame_count": 4}
PROSE = ("name", "title", "source", "family")


def test_each_deciding_field_changes_the_digest() -> None:
    assert {field.name for field in fields(Protocol)} == {*CHANGES, *PROSE}
    assert {field.name for field in fields(ClipProtocol)} == {*CHANGES, *CHANGES_OF_CLIPS, *PROSE, "reference"}
    for name, value in CHANGES.items():
        assert replace(PROTOCOLS["eld"], **{name: value}).digest != PROTOCOLS["eld"].digest, name
    of_clips = CHANGES | CHANGES_OF_CLIPS | {"levels": "published", "ratios": (1,)}
    for name, value in of_clips.items():
        assert replace(PROTOCOLS["drv-raw"], **{name: value}).digest != PROTOCOLS["drv-raw"].digest, name


@pytest.mark.parametrize("name", PROTOCOLS)
def test_no_sentence_and_no_neutral_field_changes_a_digest(name: str) -> None:
    """Every sentence reworded, and fields with neutral values, stated and not."""
    stated = PROTOCOLS[name].as_dict()
    reworded = {key: "said otherwise" for key in (*PROSE, "psnr", "ssim", "st_rred", "reference") if key in stated}
    assert set(reworded) >= {"name", "title", "source", "psnr", "ssim"}
    assert fields_digest(stated | reworded) == PROTOCOLS[name].digest
    others = {key: value for key, value in stated.items() if key not in reworded}
    assert not any(" " in str(value) for key, value in others.items() if isinstance(value, str)), "prose counts"
    for field, neutral in NEUTRAL.items():
        if stated.get(field, neutral) == neutral:
            older = {key: value for key, value in stated.items() if key != field}
            assert fields_digest(older) == fields_digest(older | {field: neutral}) == PROTOCOLS[name].digest, field


def test_neutral_values_are_the_defaults() -> None:
    """A default that changes would change what every shipped protocol means, and no digest."""
    lists: dict[str, Any] = {name: [] for name in ("ratios", "cameras", "scenes")}
    none = dict.fromkeys(("dark_shading", "rendering", "rounding", "quantisation"), "none")
    raw = dict.fromkeys(("space", "input_space", "prediction_space"), "raw")
    clips = dict.fromkeys(("input_clip", "prediction_clamp"), "both")
    others = {"subset": None, "amplification": "metadata", "response": "gamma-2.2", "rescaling_region": "scored"}
    of_metrics = {"mse_offset": 0.0, "ssim_window": "uniform-7", "ssim_covariance": "sample", "ssim_planes": "packed"}
    assert dict(NEUTRAL) == lists | none | raw | clips | others | of_metrics


def test_what_has_no_effect_is_not_in_a_digest() -> None:
    plain, led = PROTOCOLS["eld-uncorrected"], PROTOCOLS["led-sid"]
    assert replace(plain, rescaling_region="border-2").digest == plain.digest
    assert replace(led, rescaling_region="border-2").digest == replace(led, rescaling_region="scored").digest
    turned = replace(led, ratios=(300.0, 100, 250))
    assert turned.digest == led.digest, "neither the order of a list nor 100 and 100.0"


# --- names ------------------------------------------------------------------------------------------------------------


def test_get_protocol() -> None:
    assert get_protocol("eld") is PROTOCOLS["eld"]
    for family in ("pmn", "led", "lrd"):  # one protocol a dataset
        for dataset in ("eld", "sid-sony"):
            assert get_protocol(family, dataset) is PROTOCOLS[f"{family}-{dataset.removesuffix('-sony')}"]
        for none in ("sid-fuji", None):
            with pytest.raises(ArgumentError, match=rf"{family}-sid \(for sid-sony\) and {family}-eld \(for eld\)"):
                get_protocol(family, none)
    with pytest.raises(ArgumentError, match="'ELD'") as caught:
        get_protocol("ELD")
    assert all(name in str(caught.value) for name in PROTOCOLS)


SRGB_OF_SID = "sid-srgb sid-raw2rgb sid-rgb2rgb sid2018"
OF_ONES_OWN = (
    "raw eld eld-uncorrected eld-cvpr20 led-sid lrd-sid sid-srgb sid-raw2rgb eld-srgb eld-raw2rgb sid2018 brve-llrvd"
)


@pytest.mark.parametrize(
    ("dataset", "names"),
    [
        ("eld", "eld eld-uncorrected pmn-eld sony-eld led-eld lrd-eld eld-srgb eld-raw2rgb eld-rgb2rgb"),
        ("sid-sony", "sid sid-uncorrected eld-cvpr20 sid-tpami pmn-sid sony-sid led-sid lrd-sid " + SRGB_OF_SID),
        ("sid-fuji", "sid sid-uncorrected sid2018"),
        ("lrd", "lrd-lrd"),
        ("lrid", "pmn-lrid sony-lrid two-shots-lrid"),
        ("drv", "drv-rgb drv-rgb-uncorrected"),
        ("mine", OF_ONES_OWN),
    ],
)
def test_protocols_for_a_dataset(dataset: str, names: str) -> None:
    assert [protocol.name for protocol in protocols_for(dataset)] == names.split()
    if dataset != "mine":
        assert default_protocol(shipped_card(dataset)).name == names.split(maxsplit=1)[0]


def test_the_card_names_the_default() -> None:
    """One rule: what the card says; a card that says nothing means ``raw``, whatever its set is called."""
    card = shipped_card("eld")
    assert default_protocol(replace(card, name="mine", protocol="sid")) is PROTOCOLS["sid"]
    assert default_protocol(replace(card, protocol=OWN_PROTOCOL)) is PROTOCOLS["raw"]
    for wrong, hint in (("edl", "did you mean eld"), ("pmn", ""), ("mine.toml", "")):
        with pytest.raises(ManifestError, match=f"eld.json: protocol: expected the name .*, found '{wrong}'.*{hint}"):
            default_protocol(replace(card, protocol=wrong))


# --- words ------------------------------------------------------------------------------------------------------------


def test_every_field_has_words() -> None:
    stated = {field for name in ("eld", "drv-rgb") for field in PROTOCOLS[name].as_dict()}
    assert set(FIELDS) == stated - {"name", "title", "source", "family"}
    for field, choices in CHOICES.items():
        words = [FIELDS[field][1](choice) for choice in choices]
        assert len(set(words)) == len(words)


# --- comparison -------------------------------------------------------------------------------------------------------


def test_differences_are_named_in_words() -> None:
    eld, cvpr = PROTOCOLS["eld"].as_dict(), PROTOCOLS["eld-cvpr20"].as_dict()
    found = comparability(eld, cvpr)
    assert "region: full frame against packed centre 512 x 512" in found
    assert "subset: as chosen, else the card's first against indoor-15" in found
    assert not [text for text in found if text.startswith(("rescaling", "SSIM", "PSNR"))]
    assert comparability(eld, eld | {"name": "x", "title": "y", "source": "z"}) == []
    for name in ("eld", "drv-raw"):
        one, plain = (PROTOCOLS[protocol].as_dict() for protocol in (name, f"{name}-uncorrected"))
        assert comparability(one, plain) == ["rescaling: one factor per image against none"]


def test_what_came_to_the_same_does_not_count() -> None:
    sid, pmn = PROTOCOLS["sid"].as_dict(), PROTOCOLS["pmn-sid"].as_dict()
    pairs = ("dataset", "subset")
    (levels,) = comparability(sid, pmn, ignored=pairs)
    assert levels == "levels: white 16383, black the file's against black 512, white 16383"
    assert comparability(sid, pmn, ignored=pairs, equal=[{}, {"levels": ["published", "sid-sony"]}]) == []
    others: list[dict[str, list[str]]] = [
        {"levels": ["published", "metadata"]},
        {"levels": []},
        {"region": ["published", "sid-sony"]},
    ]
    for choices in others:
        assert comparability(sid, pmn, ignored=pairs, equal=[choices]) == [levels]


# --- one's own --------------------------------------------------------------------------------------------------------


def written(folder: Path, text: str) -> Path:
    path = folder / "mine.toml"
    path.write_text(text, encoding="utf-8")
    return path


START = 'base = "eld"\nname = "mine"\ntitle = "My own"\n'
RGB = START.replace("eld", "eld-raw2rgb", 1)


def test_the_example_in_the_docs(tmp_path: Path) -> None:
    text = (Path(__file__).parents[2] / "docs" / "evaluation.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"```toml mine\.toml\n(.*?)```", text, re.DOTALL)
    found = load_protocol(written(tmp_path, example))
    assert (found.name, found.levels, found.region, found.ratios) == ("hallway", "metadata", "border-8", (50, 100))
    for name in PROTOCOLS:
        assert f"`{name}`" in text
    reference = f"{Protocol.__doc__}{ScoringRules.__doc__}{ssim.__doc__}"
    assert [field.name for field in fields(Protocol) if field.name not in reference] == []
    assert [choice for choices in CHOICES.values() for choice in choices if choice not in reference] == []


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (START + "regoin = 'full'\n", r"field regoin: is unknown \(did you mean region\?\); known are base, name"),
        (START + 'region = "middle"\n', r"region must be 'full', 'centre-N' or 'border-N'; found 'middle'"),
        (START + 'ratios = ["100"]\n', r"field ratios\[0\]: expected a finite number above 0, found '100'"),
        (START + "mse_offset = -1.0\n", r"mse_offset must be finite and not negative"),
        (START + 'space = "srgb"\n', r"rendering 'none' does not go with space 'srgb'"),
        (START + 'space = "srgb"\nrendering = "eld-isp"\n', r"rounding must be '8-bit-truncated'"),
        (RGB + 'rounding = "8-bit"\n', r"of predictions in srgb rounding must be 'none'"),
        (START + 'response = "gamma-2.4"\n', r"response goes with rendering 'eld-isp' alone"),
        (RGB + 'response = "gamma-2.20"\n', r"response must be 'gamma-2.2' or another exponent"),
        (RGB + 'response = "curve 0 1; 1 0"\n', r"response: the protocol's response \w+: brightness must never fall"),
        (START + 'prediction_space = "srgb"\n', r"prediction_space 'srgb' needs a reference to compare with"),
        (START + 'input_space = "srgb"\n', r"input_space 'srgb' goes with rendering 'eld-isp'"),
        ('base = "eld"\ntitle = "x"\n', r"field name: is missing; a protocol needs base, name and title"),
        ('base = "ELD"\nname = "x"\ntitle = "x"\n', r"field base: expected one of 'raw', 'eld', .*, found 'ELD'"),
        ('base = "drv-rgb"\nname = "x"\ntitle = "x"\n', r"base: 'drv-rgb' scores clips; .* starts from one of images"),
        ('base = "eld"\nname = "sid"\ntitle = "x"\n', r"name: 'sid' is the name of a shipped protocol"),
        ('base = "eld"\nname = "a\\nb"\ntitle = "x"\n', r"name: expected printable text"),
    ],
)
def test_bad_files_are_refused_in_one_line(text: str, said: str, tmp_path: Path) -> None:
    path = written(tmp_path, text)
    with pytest.raises(ArgumentError, match=said) as caught:
        load_protocol(path)
    assert str(caught.value).startswith((f"{path}: ", f"{path}, field "))
    assert "\n" not in str(caught.value)


# --- regions ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("region", "shape", "rows", "columns"),
    [
        ("full", (4, 5, 6), (0, 5), (0, 6)),
        ("border-2", (4, 5, 7), (2, 3), (2, 5)),
        ("centre-4", (4, 9, 6), (2, 6), (1, 5)),
        ("centre-3", (4, 4, 3), (1, 4), (0, 3)),  # the published code's rule: size // 2 up from the middle
        ("centre-5", (4, 5, 6), (0, 5), (1, 6)),
        ("centre-512", (4, 600, 511), None, None),
        ("border-2", (4, 4, 9), None, None),
    ],
)
def test_regions(region: str, shape: tuple[int, ...], rows: Any, columns: Any) -> None:
    protocol = replace(PROTOCOLS["eld"], region=region)
    if rows is None:
        with pytest.raises(ArgumentError, match="too small for the region"):
            protocol.crop(shape)
        return
    assert [s.indices(n)[:2] for s, n in zip(protocol.crop(shape)[1:], shape[1:], strict=True)] == [rows, columns]


def test_the_factor_has_a_region_of_its_own(tmp_path: Path) -> None:
    shape = (4, 30, 40)
    eld, led = PROTOCOLS["eld"], PROTOCOLS["led-sid"]
    assert eld.factor_crop(shape) == eld.crop(shape)
    assert replace(eld, region="border-3").factor_crop(shape) == replace(eld, region="border-3").crop(shape)
    assert led.factor_crop(shape) == eld.crop(shape) != led.crop(shape)
    mine = load_protocol(written(tmp_path, START + 'rescaling_region = "border-4"\n'))
    assert (mine.crop(shape), mine.factor_crop(shape)[1]) == (eld.crop(shape), slice(4, 26))
    unused = replace(mine, rescaling="none", rescaling_region="centre-512")
    assert unused.factor_crop(shape) == unused.crop(shape)
