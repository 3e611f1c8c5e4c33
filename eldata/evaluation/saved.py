"""Results read back from the JSON that ``eldata evaluate --json`` wrote, field by field."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final

from eldata import __version__
from eldata.base.fields import TextFile
from eldata.base.visible import shown
from eldata.errors import ArgumentError, FileError
from eldata.evaluation.diagnosis import Suspicion
from eldata.evaluation.results import EvaluationResult, kind_of
from eldata.evaluation.scores import EvaluationProblem, FrameScore, TableRow, UnitScore
from eldata.protocols.kinds import CLIPS, IMAGES, Kind
from eldata.protocols.protocol import StatedProtocol

if TYPE_CHECKING:
    from pathlib import Path

    from eldata.base.fields import Fields

_AGAIN: Final = "write it again with eldata evaluate --json"


def load_result(path: Path | str) -> EvaluationResult:
    """Read what ``eldata evaluate --json`` wrote.

    Raises
    ------
    FileError
        If the file cannot be read, is not whole, is something else, or was written by a newer version; the message
        names the field.
    """
    return _result(TextFile(path, FileError, advice=_AGAIN).json())


def saved_result(data: object, source: Path | str) -> EvaluationResult:
    """Return what :meth:`~eldata.evaluation.results.EvaluationResult.as_dict` gave as a result; ``source`` is its name.

    Raises
    ------
    FileError
        Like :func:`load_result`.
    """
    return _result(TextFile(source, FileError, advice=_AGAIN).fields(data))


def _result(top: Fields) -> EvaluationResult:
    if "provenance" not in top.data:
        raise top.problem("provenance", "is missing: this is not a result of eldata evaluate, or not a whole one")
    provenance, protocol, coverage = (top.inside(name) for name in ("provenance", "protocol", "coverage"))
    own = CLIPS if CLIPS.units in top.data else IMAGES
    if "task" in provenance.data:
        task = provenance.inside("task")
        for name in ("label", "callable", "images"):
            task.text(name)
        task.flag("higher_is_better")
    kind = kind_of(own, provenance.data)
    written = provenance.text("eldata")
    if _release(written) > _release(__version__):
        raise provenance.wrong("eldata", f"{__version__} or older (update eldata, or it may be misread)", written)
    for name in ("dataset", "manifest_sha256"):
        provenance.text(name)
    protocol.text("name")
    stated = StatedProtocol(own, dict(protocol.data))
    if provenance.text("protocol_digest") != stated.digest:
        expected = f"the digest of the fields in protocol, {stated.digest} (was one of them edited?)"
        raise provenance.wrong("protocol_digest", expected, provenance.data["protocol_digest"])
    provenance.optional("subset", provenance.text)
    provenance.inside("excluded_flags")
    provenance.flag("scenes_shared")
    if "equal_choices" in provenance.data:
        choices = provenance.inside("equal_choices")
        for name in choices.data:
            choices.texts(name)
    scores = tuple(_score(one, kind) for one in top.objects(kind.units))
    seen: set[str] = set()
    for index, score in enumerate(scores):
        if score.path in seen:
            raise top.wrong(f"{kind.units}[{index}].path", f"another {kind.unit} than those before it", score.path)
        seen.add(score.path)
    if coverage.whole("scored") != len(scores):
        raise coverage.wrong("scored", f"the number of {kind.units}, {len(scores)}", coverage.data["scored"])
    return EvaluationResult(
        protocol=stated,
        provenance=dict(provenance.data),
        scores=scores,
        table=_table(top, kind),
        expected=coverage.whole(kind.counted, at_least=len(scores)),
        missing=coverage.texts("missing"),
        problems=tuple(
            EvaluationProblem(one.text("path", unseen=True), one.text("reason", unseen=True))  # of any file's name
            for one in top.objects("problems")
        ),
        notes=top.texts("notes"),
        suspicions=tuple(_suspicion(one) for one in top.objects("suspicions")) if "suspicions" in top.data else (),
        source=str(top.file.name),
    )


def _suspicion(one: Fields) -> Suspicion:
    return Suspicion(
        words=one.text("words", unseen=True),
        where=one.text("where", empty=True, unseen=True),
        shown=one.whole("shown"),
        looked=one.whole("looked"),
        psnr_db=one.number("psnr_db"),
        without_db=one.optional("without_db", one.number),
        example=one.text("example", unseen=True),
    )


def _score(one: Fields, kind: Kind) -> UnitScore:
    camera, scene = one.text("camera"), one.text("scene")
    values = {name: one.parsed(name, _value) for name in kind.values}
    if not kind.is_of_clips:
        iso, ratio = one.number("iso", at_least=0), one.number("ratio", at_least=0)
        return UnitScore(one.text("path"), camera, scene, iso, ratio, values)
    frames = tuple(
        FrameScore(frame.text("path"), *(frame.parsed(name, _value) for name in ("psnr_db", "ssim", "rescale")))
        for frame in one.objects("frame_scores", fewest=1)
    )
    split, start = one.text("split"), one.whole("start")
    return UnitScore(frames[0].path, camera, scene, 0.0, None, values, split=split, start=start, frames=frames)


def _table(top: Fields, kind: Kind) -> tuple[TableRow, ...]:
    names = [metric.name for metric in kind.metrics]
    return tuple(
        TableRow(
            camera=row.optional("camera", row.text),
            ratio=row.optional("ratio", row.number, at_least=0),
            pairs=row.whole(kind.counted),
            scored=row.whole("scored"),
            values={name: row.parsed(name, _value) for name in names},
        )
        for row in top.objects("table", fewest=1)
    )


def _value(found: Any) -> float:
    """Return a number, an infinity that is written as text, or nan for null."""
    if found is None:
        return math.nan
    if found in ("inf", "-inf"):
        return float(found)
    if type(found) in (int, float) and abs(found) <= 1e300:
        return float(found)
    raise ArgumentError(f'expected a finite number, the text "inf" or null, found {shown(found)}')


def _release(version: str) -> tuple[int, ...]:
    """Return major and minor version; (0,) for what is not a version."""
    parts = version.split(".")[:2]
    return tuple(int(part) for part in parts) if all(part.isdecimal() for part in parts) else (0,)
