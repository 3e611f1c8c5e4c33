"""Protocols as objects: names, digests, words, comparison, and those of one's own."""

from __future__ import annotations

import json
import os
import re
from dataclasses import FrozenInstanceError, replace
from pathlib import Path
from typing import Any

import pytest

from eldata.errors import ArgumentError
from eldata.protocols import (
    PROTOCOLS,
    comparability,
    default_protocol,
    fields_digest,
    get_protocol,
    load_protocol,
    protocols_for,
)
from eldata.protocols.protocol import CHOICES, DESCRIPTIVE
from eldata.protocols.words import FIELDS, HEADER, described, summary
from tests.evaluation.helpers import scored_pairs

GOLDEN = Path(__file__).parent / "golden" / "protocols.json"

# --- frozen -----------------------------------------------------------------------------------------------------------


def deciding() -> dict[str, dict[str, Any]]:
    return {
        name: {"digest": protocol.digest}
        | {key: value for key, value in protocol.as_dict().items() if key not in DESCRIPTIVE}
        for name, protocol in PROTOCOLS.items()
    }


def test_protocols_are_frozen() -> None:
    """A published name keeps its meaning: to change a score, add a protocol of another name."""
    if os.environ.get("ELDATA_UPDATE_GOLDEN") == "1":
        GOLDEN.write_text(json.dumps(deciding(), indent=2) + "\n", encoding="utf-8")
    assert deciding() == json.loads(GOLDEN.read_text(encoding="utf-8"))


def test_the_first_protocols_score_as_they_did() -> None:
    """What these four had before fields were added has not changed."""
    first = {
        "eld": "1af296f728e5859d26d8e8af6d81f69ceff3b6a320dc00d1f0a448ccea3a1d7b",
        "eld-uncorrected": "6fe8de8c7f367beae75e1b9ff051ef617af5454419168552cbd33d03d5ddd3d8",
    }
    fields = ("name", "dataset", "ratios", "levels", "reference_clip", "region", "rescaling", "data_range", "rounding")
    for name, digest in first.items():
        values = PROTOCOLS[name].as_dict()
        assert fields_digest({field: values[field] for field in (*fields, "psnr", "ssim")}) == f"sha256:{digest}"


def test_protocol_cannot_be_changed() -> None:
    with pytest.raises(FrozenInstanceError):
        get_protocol("eld").rescaling = "none"  # type: ignore[misc]


def test_digests_differ() -> None:
    assert len({protocol.digest for protocol in PROTOCOLS.values()}) == len(PROTOCOLS)


@pytest.mark.parametrize(
    "change",
    [{"name": "x"}, {"dataset": "x"}, {"ratios": (100,)}, {"levels": "metadata"}, {"reference_clip": "none"},
     {"rescaling": "none"}, {"data_range": 255.0}, {"region": "border-2"}, {"subset": "x"}, {"cameras": ("x",)},
     {"scenes": ("x",)}, {"input_clip": "none"}, {"amplification": "nominal"}, {"space": "srgb"},
     {"rendering": "libraw"}, {"rounding": "8-bit"}, {"rescaling_mask": "all"}, {"prediction_clamp": "none"},
     {"mse_offset": 1e-8}, {"ssim_window": "gaussian-11"}, {"ssim_covariance": "population"}],
)  # fmt: skip
def test_digest_depends_on_what_decides_a_score(change: dict[str, Any]) -> None:
    assert replace(PROTOCOLS["eld"], **change).digest != PROTOCOLS["eld"].digest


def test_digest_does_not_depend_on_words() -> None:
    assert replace(PROTOCOLS["eld"], title="x", source="y", family="z").digest == PROTOCOLS["eld"].digest


def test_protocols_make_sense() -> None:
    for protocol in PROTOCOLS.values():
        protocol.check()
        assert protocol.source
        assert "\n" not in protocol.source + protocol.title


# --- names ------------------------------------------------------------------------------------------------------------


def test_get_protocol() -> None:
    assert get_protocol("eld") is PROTOCOLS["eld"]
    with pytest.raises(ArgumentError) as caught:
        get_protocol("ELD")
    for name in PROTOCOLS:
        assert name in str(caught.value)
    assert "'ELD'" in str(caught.value)


@pytest.mark.parametrize("family", ["pmn", "led", "lrd"])
def test_a_family_is_one_protocol_a_dataset(family: str) -> None:
    assert get_protocol(family, "eld") is PROTOCOLS[f"{family}-eld"]
    assert get_protocol(family, "sid-sony") is PROTOCOLS[f"{family}-sid"]
    for dataset in ("sid-fuji", None):
        with pytest.raises(ArgumentError, match=rf"{family}-sid \(for sid-sony\) and {family}-eld \(for eld\)"):
            get_protocol(family, dataset)


@pytest.mark.parametrize(
    ("dataset", "names"),
    [
        ("eld", ["eld", "eld-uncorrected", "pmn-eld", "led-eld", "lrd-eld"]),
        (
            "sid-sony",
            [
                "sid",
                "sid-uncorrected",
                "eld-cvpr20",
                "sid-tpami",
                "pmn-sid",
                "led-sid",
                "lrd-sid",
                "sid-srgb",
                "sid2018",
            ],
        ),
        ("sid-fuji", ["sid", "sid-uncorrected", "sid2018"]),
        ("mine", ["eld", "eld-uncorrected", "eld-cvpr20", "led-sid", "lrd-sid", "sid-srgb", "sid2018"]),
    ],
)
def test_protocols_for_a_dataset(dataset: str, names: list[str]) -> None:
    assert [protocol.name for protocol in protocols_for(dataset)] == names
    assert default_protocol(dataset).name == names[0]


# --- pairs ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "dataset", "counts"),
    [
        ("eld", "eld", {100: 120, 200: 120}),
        ("pmn-eld", "eld", {100: 30, 200: 30}),
        ("lrd-eld", "eld", {100: 30, 200: 30}),
        ("led-eld", "eld", {100: 48, 200: 48}),
        ("eld-cvpr20", "sid-sony", {100: 15, 250: 15, 300: 15}),
        ("sid-tpami", "sid-sony", {100: 40, 250: 40, 300: 49}),
        ("pmn-sid", "sid-sony", {100: 40, 250: 40, 300: 49}),
        ("lrd-sid", "sid-sony", {100: 40, 250: 40, 300: 49}),
        ("sid-srgb", "sid-sony", {100: 40, 250: 40, 300: 49}),
        ("led-sid", "sid-sony", {100: 29, 250: 29, 300: 35}),
        ("sid2018", "sid-sony", {100: 29, 250: 29, 300: 35}),
        ("sid2018", "sid-fuji", {100: 41, 250: 27, 300: 26}),
    ],
)
def test_pairs_of_the_published_sets(name: str, dataset: str, counts: dict[int, int]) -> None:
    scored = scored_pairs(dataset, name)
    found = [int(pair.ratio) for pair in scored]
    assert {ratio: found.count(ratio) for ratio in sorted(set(found))} == counts
    if name == "led-eld":
        assert {pair.scene for pair in scored} == {f"scene-{number}" for number in range(3, 11)}
    if name in ("led-sid", "sid2018"):
        assert {pair.split for pair in scored} == {"test"}


def test_a_protocol_that_fixes_its_pairs_takes_no_others() -> None:
    with pytest.raises(ArgumentError, match="'led-sid' scores the subset 'test-first', not 'all'"):
        scored_pairs("sid-sony", "led-sid", subset="all")
    with pytest.raises(ArgumentError, match="scores SonyA7S2, not NikonD850"):
        scored_pairs("eld", "pmn-eld", cameras=["NikonD850"])
    with pytest.raises(ArgumentError, match="'eld' is for dataset 'eld', not 'sid-sony'"):
        scored_pairs("sid-sony", "eld")


# --- words ------------------------------------------------------------------------------------------------------------


def test_every_field_has_words() -> None:
    stated = {field for name in ("eld", "drv-rgb") for field in PROTOCOLS[name].as_dict()}
    assert set(FIELDS) == stated - {"name", "title", "source", "family"}
    for field, choices in CHOICES.items():
        words = [FIELDS[field][1](choice) for choice in choices]
        assert len(set(words)) == len(words)


def test_lists_tell_protocols_apart() -> None:
    rows = [summary(protocol) for protocol in PROTOCOLS.values()]
    assert all(len(row) == len(HEADER) for row in rows)
    assert len({row[1:] for row in rows}) >= len(rows) - 2  # eld and sid are what pmn reports, but for the pairs
    shown = dict(described(PROTOCOLS["led-eld"]))
    assert shown["region"] == "all but 2 packed pixels at each edge"
    assert shown["PSNR"] == "10 log10(1 / (mean squared error over all packed entries + 1e-08))"
    assert "population covariance" in shown["SSIM"]


# --- comparison -------------------------------------------------------------------------------------------------------


def test_a_protocol_compares_with_itself_whatever_its_name() -> None:
    eld = PROTOCOLS["eld"].as_dict()
    assert comparability(eld, eld) == []
    assert comparability(eld, eld | {"name": "x", "title": "y", "source": "z"}) == []


def test_differences_are_named_in_words() -> None:
    eld, cvpr = PROTOCOLS["eld"].as_dict(), PROTOCOLS["eld-cvpr20"].as_dict()
    found = comparability(eld, cvpr)
    assert "region: full frame against packed centre 512 x 512" in found
    assert "subset: as chosen, else the card's first against indoor-15" in found
    assert not [text for text in found if text.startswith(("rescaling", "SSIM", "PSNR"))]
    assert comparability(eld, PROTOCOLS["eld-uncorrected"].as_dict()) == [
        "rescaling: one factor per image against none"
    ]


def test_a_field_that_an_older_version_did_not_state_is_said() -> None:
    eld = json.loads(json.dumps(PROTOCOLS["eld"].as_dict()))
    older = {key: value for key, value in eld.items() if key != "mse_offset"}
    assert comparability(older, eld) == ["added to the error: not stated against 0"]
    assert comparability(eld, eld | {"levels": "of tomorrow", "new": 1}) == [
        "levels: white 16383, black the file's against of tomorrow",
        "new: not stated against 1",
    ]


def test_protocols_of_clips_compare_too() -> None:
    raw, plain = (PROTOCOLS[name].as_dict() for name in ("drv-raw", "drv-raw-uncorrected"))
    assert comparability(raw, raw) == []
    assert comparability(raw, plain) == ["rescaling: one factor per image against none"]


# --- one's own --------------------------------------------------------------------------------------------------------


def written(folder: Path, text: str) -> Path:
    path = folder / "mine.toml"
    path.write_text(text, encoding="utf-8")
    return path


START = 'base = "eld"\nname = "mine"\ntitle = "My own"\n'


def test_a_protocol_of_ones_own(tmp_path: Path) -> None:
    path = written(
        tmp_path,
        START
        + 'region = "border-8"\nratios = [100, 250.5]\ncameras = ["A"]\nmse_offset = 1e-8\n'
        + 'ssim_window = "gaussian-11"\n',
    )
    found = load_protocol(path)
    expected = replace(
        PROTOCOLS["eld"],
        name="mine",
        title="My own",
        region="border-8",
        ratios=(100, 250.5),
        cameras=("A",),
        mse_offset=1e-8,
        ssim_window="gaussian-11",
    )
    assert replace(found, source=expected.source) == expected
    assert found.digest == expected.digest
    assert found.source.startswith("mine.toml, after eld: K. Wei")
    assert get_protocol(str(path)) == found


def test_the_example_in_the_docs(tmp_path: Path) -> None:
    text = (Path(__file__).parents[2] / "docs" / "evaluation.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"```toml mine\.toml\n(.*?)```", text, re.DOTALL)
    found = load_protocol(written(tmp_path, example))
    assert (found.name, found.levels, found.region, found.ratios) == ("hallway", "metadata", "border-8", (50, 100))
    for name in PROTOCOLS:
        assert f"`{name}`" in text
    for field in FIELDS:
        assert f"`{field}`" in text or field in ("psnr", "ssim") or field not in PROTOCOLS["eld"].as_dict()
    for choices in CHOICES.values():
        assert all(f"`{choice}`" in text for choice in choices)


def test_any_dataset_and_all_factors(tmp_path: Path) -> None:
    found = load_protocol(written(tmp_path, START + 'dataset = "any"\nratios = []\n'))
    assert found.covers("sid-sony")
    assert found.covers("mine")
    scored = scored_pairs("eld", found)
    assert len(scored) == 480


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (START + "regoin = 'full'\n", r"field regoin: is unknown \(did you mean region\?\); known are base, name"),
        (START + 'family = "pmn"\n', r"field family: is unknown"),
        (START + "region = 3\n", r"field region: expected a text, found 3"),
        (START + 'region = "middle"\n', r"region must be 'full', 'centre-N' or 'border-N'; found 'middle'"),
        (START + 'region = "centre-0"\n', r"region must be"),
        (START + 'levels = "16383"\n', r"levels: expected one of 'metadata', 'published'"),
        (START + "rescaling = true\n", r"rescaling: expected one of 'none', 'scalar', found true"),
        (START + 'ratios = ["100"]\n', r"field ratios\[0\]: expected a finite number above 0, found '100'"),
        (START + "ratios = [0]\n", r"field ratios\[0\]: expected a finite number above 0, found 0"),
        (
            START + "ratios = 100\n",
            r"ratios: expected a list of positive numbers, such as \[100, 200\]; \[\] for all, found 100",
        ),
        (START + 'cameras = "A"\n', r"cameras: expected a list of names"),
        (START + 'mse_offset = "small"\n', r"mse_offset: expected a finite number, found 'small'"),
        (START + "mse_offset = -1.0\n", r"mse_offset must be finite and not negative"),
        (START + "mse_offset = nan\n", r"field mse_offset: expected a finite number, found nan"),
        (START + "data_range = 0\n", r"data_range must be positive"),
        (START + 'space = "srgb"\n', r"rendering 'none' does not go with space 'srgb'"),
        (START + 'space = "srgb"\nrendering = "eld-isp"\n', r"rounding must be '8-bit-truncated'"),
        ('base = "eld"\ntitle = "x"\n', r"field name: is missing; a protocol needs base, name and title"),
        ('name = "x"\ntitle = "x"\n', r"field base: is missing; a protocol needs base"),
        ('base = "ELD"\nname = "x"\ntitle = "x"\n', r"field base: expected one of 'eld', .*, found 'ELD'"),
        ('base = "drv-rgb"\nname = "x"\ntitle = "x"\n', r"base: 'drv-rgb' scores clips; .* starts from one of images"),
        ('base = "eld"\nname = "sid"\ntitle = "x"\n', r"name: 'sid' is the name of a shipped protocol"),
        ('base = "eld"\nname = "all"\ntitle = "x"\n', r"name: 'all' is the name of a shipped"),
        ('base = "eld"\nname = "led"\ntitle = "x"\n', r"name: 'led' is the name of a shipped"),
        ('base = "eld"\nname = ""\ntitle = "x"\n', r"field name: expected a text, found ''"),
        ('base = "eld"\nname = "a\\nb"\ntitle = "x"\n', r"name: expected printable text"),
        ("base = eld\n", r"is not TOML"),
    ],
)
def test_bad_files_are_refused_in_one_line(text: str, said: str, tmp_path: Path) -> None:
    path = written(tmp_path, text)
    with pytest.raises(ArgumentError, match=said) as caught:
        load_protocol(path)
    assert str(caught.value).startswith((f"{path}: ", f"{path}, field "))
    assert "\n" not in str(caught.value)


def test_missing_and_unreadable_files(tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match=r"none\.toml: cannot be read: No such file"):
        get_protocol(str(tmp_path / "none.toml"))
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(ArgumentError, match=r"bytes\.toml: is not TOML"):
        load_protocol(tmp_path / "bytes.toml")


# --- regions ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("region", "shape", "rows", "columns"),
    [
        ("full", (4, 5, 6), (0, 5), (0, 6)),
        ("border-2", (4, 5, 7), (2, 3), (2, 5)),
        ("centre-4", (4, 9, 6), (2, 6), (1, 5)),
        ("centre-3", (4, 4, 3), (1, 4), (0, 3)),  # the published code's rule: size // 2 up from the middle
        ("centre-5", (4, 5, 6), (0, 5), (1, 6)),
    ],
)
def test_regions(region: str, shape: tuple[int, ...], rows: tuple[int, int], columns: tuple[int, int]) -> None:
    protocol = replace(PROTOCOLS["eld"], region=region)
    assert [s.indices(n)[:2] for s, n in zip(protocol.crop(shape)[1:], shape[1:], strict=True)] == [rows, columns]


@pytest.mark.parametrize(("region", "shape"), [("centre-512", (4, 600, 511)), ("border-2", (4, 4, 9))])
def test_regions_that_do_not_fit(region: str, shape: tuple[int, ...]) -> None:
    with pytest.raises(ArgumentError, match="too small for the region"):
        replace(PROTOCOLS["eld"], region=region).crop(shape)
