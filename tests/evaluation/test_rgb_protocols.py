"""Raw2Raw + ISP, Raw2RGB and RGB2RGB, scored in sRGB: against the published way, step by step (``published_code``)."""

from __future__ import annotations

import json
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rawpy
import torch
from numpy.typing import NDArray

from eldata.baselines import load_network
from eldata.baselines.predicting import write_predictions
from eldata.cli.main import main
from eldata.errors import ArgumentError
from eldata.evaluation import evaluate, load_result, save_prediction
from eldata.evaluation.looking import protocol_of
from eldata.evaluation.request import SETTINGS
from eldata.manifest.table import load_records, save_records
from eldata.protocols import PROTOCOLS
from eldata.raw import read_raw, write_dng
from eldata.records import PairRecord
from tests.evaluation import published_code
from tests.evaluation.helpers import assert_equal
from tests.evaluation.own_set import OwnSet, build_own_set

NOISY_BALANCE = (1.4, 1.0, 2.5, 1.0)
SIZE = (60, 84)
WAYS = ("eld-raw2rgb", "eld-rgb2rgb")


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> OwnSet:
    """Noisy frames with a white balance of their own; the manifest states the frames' size."""
    made = build_own_set(tmp_path_factory.mktemp("own"), scenes=2, size=SIZE)
    for path in made.files.rglob("x*.dng"):
        raw = read_raw(path)
        write_dng(path, raw.mosaic, replace(raw.sensor, white_balance=NOISY_BALANCE), raw.exposure)
    rows = load_records(made.manifest)
    save_records(made.manifest, [replace(row, height=SIZE[0], width=SIZE[1], size_bytes=None) for row in rows])
    return made


def packed(path: Path, ratio: float | None = None) -> NDArray[Any]:
    with rawpy.imread(str(path)) as raw:
        frame = published_code.eld_frame
        return frame(raw) if ratio is None else published_code.amplified(frame, raw, ratio)


def shown(own: OwnSet, reference: str, name: str) -> NDArray[np.float32]:
    """A prediction, (3, h, w): the reference's rendering, darker and noisy, in places beyond [0, 1]."""
    clean = published_code.eld_rendered(packed(own.files / reference), own.files / reference)
    noise = np.random.default_rng(zlib.crc32(name.encode())).normal(0, 0.03, clean.shape)
    noise[:, 4:6, 4:9] += 1
    return (0.9 * clean + noise).astype(np.float32)


def score_of(own: OwnSet, pair: PairRecord, output: NDArray[Any]) -> published_code.Score:
    reference = own.files / pair.reference
    return published_code.eld_rgb_score(output, packed(reference), reference)


@pytest.fixture(scope="module")
def renderings(own: OwnSet) -> dict[str, NDArray[np.float32]]:
    """A prediction of each pair, which lies in the folder of the set's."""
    paths = [path.relative_to(own.files).as_posix() for path in own.files.rglob("x*.dng")]
    images = {path: shown(own, f"{path[:2]}/clean.dng", path) for path in paths}
    for path, image in images.items():
        save_prediction(own.predictions, path, image)
    return images


def test_predictions_of_three_channels(own: OwnSet, renderings: dict[str, NDArray[np.float32]]) -> None:
    """Other forms come to the same arrays (``test_predictions``)."""
    for name in WAYS:
        result = evaluate(own.predictions, **own.where, protocol=name)
        assert_equal(result, lambda pair: score_of(own, pair, renderings[pair.path]))


@pytest.mark.parametrize("name", WAYS)
def test_the_input_is_the_amplified_frame_in_its_own_colours(name: str, own: OwnSet) -> None:
    result = evaluate(None, **own.where, protocol=name, baseline="input")
    renderings = {}
    for pair in result.units:
        noisy, reference = own.files / pair.path, own.files / str(pair.reference)
        amplified = packed(noisy, published_code.ratio_by_exif(noisy, reference))
        renderings[pair.path] = published_code.eld_rendered(amplified, noisy)
    assert_equal(result, lambda pair: score_of(own, pair, renderings[pair.path]))


# --- predicting -------------------------------------------------------------------------------------------------------


class Green(torch.nn.Module):
    """Of four channels three."""

    def forward(self, image: torch.Tensor) -> torch.Tensor:
        return image[:, :3].clamp(min=0) ** 0.5


class Same(torch.nn.Module):
    """What is given."""

    def forward(self, image: torch.Tensor) -> torch.Tensor:
        return image


def test_networks_to_srgb_are_run_and_scored(own: OwnSet, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    where = [text for name, path in own.where.items() for text in (f"--{name}", str(path))]
    for name, network in (("eld-raw2rgb", Green), ("eld-rgb2rgb", Same)):
        model = f"{__name__}:{network.__name__}"
        out = str(tmp_path / name)
        assert main(["predict", model, *where, "--protocol", name, "-o", out]) == 0
        assert np.load(tmp_path / name / "s0" / "x50.npy").shape == (3, 30, 42)
        assert main(["evaluate", out, *own.arguments, "--protocol", name, "--allow-suspect"]) == 0
    stated = json.loads((tmp_path / "eld-rgb2rgb" / SETTINGS).read_text(encoding="utf-8"))
    assert [stated[name] for name in ("input_space", "prediction_space", "response")] == ["sRGB", "sRGB", "gamma 2.2"]
    scored = {**own.where, "protocol": "eld-rgb2rgb"}
    ours, theirs = evaluate(tmp_path / "eld-rgb2rgb", **scored), evaluate(None, baseline="input", **scored)
    expected = [one.psnr_db for one in theirs.scores]
    assert [one.psnr_db for one in ours.scores] == pytest.approx(expected, abs=1e-5, rel=0)  # files of float32
    capsys.readouterr()
    assert main(["evaluate", str(tmp_path / "eld-rgb2rgb"), *own.arguments, "--protocol", "eld-raw2rgb"]) == 2
    assert "network's input: sRGB, and protocol 'eld-raw2rgb' has packed raw (input_space)" in capsys.readouterr().err
    (tmp_path / "mine.toml").write_text('base = "eld-rgb2rgb"\nname = "x"\ntitle = "x"\nresponse = "gamma-1.8"\n')
    with pytest.raises(ArgumentError, match=r"response curve: gamma 2.2, .* has gamma 1.8 \(response\)"):
        evaluate(tmp_path / "eld-rgb2rgb", **scored | {"protocol": tmp_path / "mine.toml"})


def test_a_network_of_other_channels_is_refused(own: OwnSet, tmp_path: Path) -> None:
    for network, protocol, expected in ((Green, "eld", "(4, 30, 42)"), (Same, "eld-raw2rgb", "(3, 30, 42)")):
        loaded = load_network(f"{__name__}:{network.__name__}", device="cpu")
        report = write_predictions(loaded, "", tmp_path / protocol, **own.where, protocol=protocol)
        assert report.written == 0
        (problem,) = report.problems
        assert f"protocol {protocol} takes {expected}" in problem
    with pytest.raises(ArgumentError, match="'sid2018' scores renderings"):
        write_predictions(load_network(f"{__name__}:Same"), "", tmp_path / "p", **own.where, protocol="sid2018")


# --- response curves --------------------------------------------------------------------------------------------------

GRID = np.linspace(0, 1, 33)
COLOURS = np.stack([GRID**power for power in (0.45, 0.5, 0.6)])
# What a protocol of one's own may say of its curve, and that curve step by step.
RESPONSES: dict[str, published_code.Response] = {
    '"gamma-1.8"': lambda linear: np.maximum(linear, 1e-8) ** (1 / 1.8),
    '{table = "mine.txt"}': published_code.eld_curve(GRID, COLOURS),
}


def test_a_protocol_states_its_response_curve(
    own: OwnSet, renderings: dict[str, NDArray[np.float32]], tmp_path: Path
) -> None:
    """Of predictions in sRGB, of rendered raw ones and of the input; the digest is of the curve, not of its file."""
    digests = []
    np.savetxt(tmp_path / "mine.txt", np.column_stack([GRID, *COLOURS]))
    for number, (stated, response) in enumerate(RESPONSES.items()):
        for base in ("eld-rgb2rgb", "eld-srgb"):
            file = tmp_path / f"{base}-{number}.toml"
            text = f'base = "{base}"\nname = "{base}-mine"\ntitle = "x"\nresponse = {stated}\n'
            file.write_text(text, encoding="utf-8")
            place: dict[str, Any] = {"manifest": own.manifest, "root": own.root, "protocol": file}
            result = evaluate(None, baseline="input", **place)
            results = [(result, False)]
            if base == "eld-rgb2rgb":
                digests.append(result.protocol.digest)
                results.append((evaluate(own.predictions, **place), True))
            for scored, is_of_files in results:
                for pair, image in zip(scored.units, scored.scores, strict=True):
                    noisy, reference = own.files / pair.path, own.files / str(pair.reference)
                    output = packed(noisy, published_code.ratio_by_exif(noisy, reference))
                    score = published_code.eld_whole_srgb_score
                    if base == "eld-rgb2rgb":
                        score = published_code.eld_rgb_score
                        output = published_code.eld_rendered(output, noisy, response)
                    if is_of_files:
                        output = renderings[pair.path]
                    wanted = score(output, packed(reference), reference, response)
                    found = (image.psnr_db, image.ssim)
                    assert found == pytest.approx((wanted.psnr_db, wanted.ssim), abs=1e-6, rel=0), (base, stated)
    gamma, table = digests
    assert len({gamma, table, PROTOCOLS["eld-rgb2rgb"].digest}) == 3
    result.write_json(tmp_path / "r.json")  # of the last protocol, whose curve's file is not needed again
    (tmp_path / "mine.txt").unlink()
    again = evaluate(None, baseline="input", **own.where, protocol=protocol_of(load_result(tmp_path / "r.json")))
    assert again.scores == result.scores
