"""Results read back: every field, and one clear line for anything else."""

from __future__ import annotations

import math
import shutil
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest

from eldata import __version__
from eldata.base.tables import FORMATS
from eldata.errors import FileError
from eldata.evaluation.evaluate import evaluate
from eldata.evaluation.results import load_result, saved_result
from eldata.protocols.protocol import StatedProtocol
from tests.reports.evaluations import result_data, written

if TYPE_CHECKING:
    from pathlib import Path

    from eldata.evaluation.results import EvaluationResult
    from tests.evaluation.helpers import Tree


def as_read_back(result: EvaluationResult, path: Path) -> EvaluationResult:
    """What a result is once it was saved: without its pairs, with its protocol as it states itself."""
    protocol = result.protocol
    stated = StatedProtocol(protocol.kind, protocol.as_dict())
    return replace(result, protocol=stated, units=(), source=str(path))


def test_what_evaluate_wrote_is_read_back(tree: Tree, predictions: Path, tmp_path: Path) -> None:
    """One that lacks a prediction, and cannot use another."""
    shutil.copytree(predictions, tmp_path / "preds")
    first, second, *_ = (tmp_path / "preds" / pair.path for pair in tree.pairs)
    first.with_suffix(".npy").unlink()
    second.with_suffix(".npy").write_bytes(b"")
    result = evaluate(tmp_path / "preds", **tree.where, allow_missing=True)
    assert (len(result.missing), len(result.problems), result.expected) == (2, 1, 12)
    assert result.notes
    result.write_json(tmp_path / "a.json")
    saved = load_result(tmp_path / "a.json")
    assert saved == as_read_back(result, tmp_path / "a.json")
    for form in FORMATS:
        assert saved.format(form) == result.format(form)
    assert saved.as_dict() == result.as_dict()
    assert (saved.dataset, saved.protocol.name, saved.digest) == ("eld-demo", "eld", result.protocol.digest)
    assert saved.scores[0].place == ("DemoAlpha", "scene-1")


def test_infinite_and_unknown_scores() -> None:
    data = result_data()
    data["images"][0]["psnr_db"] = "inf"
    data["images"][1]["psnr_db"] = None
    saved = saved_result(data, "test")
    assert saved.scores[0].psnr_db == math.inf
    assert math.isnan(saved.scores[1].psnr_db)


# --- what cannot be used ------------------------------------------------------------------------------------------


def changed(*keys: str | int, to: object) -> dict[str, Any]:
    data = result_data(scenes=1)
    place: Any = data
    for key in keys[:-1]:
        place = place[key]
    place[keys[-1]] = to
    return data


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (changed("images", 3, "psnr_db", to="high"), ["images[3].psnr_db", '"inf"', "'high'"]),
        (changed("images", 3, "psnr_db", to=10**400), ["images[3].psnr_db", "finite"]),
        (changed("images", 2, "ratio", to=-1), ["images[2].ratio", "-1"]),
        (changed("images", 0, "path", to=7), ["images[0].path", "text", "7"]),
        (changed("images", 1, "path", to="SonyA7S2/scene-1/IMG_0002.ARW"), ["images[1].path", "another image"]),
        (changed("coverage", "scored", to=11), ["coverage.scored", "12", "11"]),
        (changed("coverage", "pairs", to=3), ["coverage.pairs", "12 or more", "3"]),
        (changed("provenance", to="eld"), ["field provenance", "object", "'eld'"]),
        (changed("provenance", "scenes_shared", to=None), ["provenance.scenes_shared", "true or false", "null"]),
        (changed("provenance", "eldata", to="99.0.0"), ["provenance.eldata", "99.0.0", __version__, "update"]),
        (changed("protocol", "name", to=3), ["protocol.name", "text"]),
        # An edited field would be taken for how the scores were made.
        (
            changed("protocol", "region", to="border-2"),
            ["protocol_digest: expected the digest of the fields"],
        ),
        (changed("problems", to=[{"path": "a"}]), ["problems[0].reason", "nothing"]),
        ({"problems": [], "ok": True}, ["not a result of eldata evaluate", "provenance", "missing"]),
        ([], ["expected an object", "[]"]),
    ],
)
def test_a_bad_field_is_named(data: object, words: list[str], tmp_path: Path) -> None:
    path = written(tmp_path / "bad.json", data)
    with pytest.raises(FileError) as caught:
        load_result(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    for word in words:
        assert word in message
