"""Why a score is what it is: the steps from files to numbers, and what each other choice would make of it."""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass, replace
from pathlib import PurePosixPath
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np

from eldata.base.arguments import spell_keywords
from eldata.base.numbers import counted
from eldata.base.tables import text_table, wrapped
from eldata.base.workers import Failed
from eldata.errors import ArgumentError, EldataError, RawFileError, did_you_mean
from eldata.evaluation.alternatives import changes_of, score_each, with_score
from eldata.evaluation.evaluate import perform
from eldata.evaluation.looking import images_of, worst_and_best
from eldata.evaluation.originals import levels_dn, normalised_frame
from eldata.evaluation.request import EvaluationOptions, make_request
from eldata.evaluation.scores import factor_text, frames_of, iso_of, json_object, ratio_of, reference_of
from eldata.protocols.digests import NEUTRAL
from eldata.protocols.protocol import NO_SHADING, Protocol
from eldata.protocols.words import FIELDS, described, in_words, region_words
from eldata.raw.reading import exposure_ratio
from eldata.records import PairRecord

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    import pandas as pd
    from numpy.typing import NDArray

    from eldata.base.numbers import Figure
    from eldata.evaluation.alternatives import Alternative
    from eldata.evaluation.frames import ComparedFrame
    from eldata.evaluation.looking import ScoredImage
    from eldata.evaluation.request import Request
    from eldata.evaluation.results import EvaluationResult
    from eldata.evaluation.scores import UnitScore
    from eldata.evaluation.units import PlanScores
    from eldata.protocols.kinds import Kind

_COLUMNS = 80
_STEP = 16  # characters of a step's name


@dataclass(frozen=True, slots=True)
class Explanation:
    """What :func:`explain` found of one image, or window of a clip.

    Attributes
    ----------
    rank
        What it is among the others, such as ``the worst of 48 images by PSNR``.
    protocol, kind
        The protocol's name; what is scored, with which numbers.
    score
        The evaluation's.
    steps
        From the files to the score: what a step is, and what it did here.
    alternatives
        In the order of an evaluation.
    """

    rank: str
    protocol: str
    kind: Kind
    score: UnitScore
    steps: tuple[tuple[str, str], ...]
    alternatives: tuple[Alternative, ...]

    @property
    def heading(self) -> str:
        """Which image it is, and what follows."""
        return f"{self.score.name}, {self.rank}: step by step"

    @property
    def header(self) -> tuple[str, ...]:
        """Columns of :attr:`rows`: each metric, its change, and the choice."""
        return *(text for metric in self.kind.metrics for text in (metric.heading, "change")), "if this alone were"

    @property
    def numbers(self) -> dict[str, float]:
        """The numbers of the score, as the evaluation has them."""
        return self.score.values  # noqa: PD011 # no DataFrame

    @property
    def rows(self) -> list[tuple[str, ...]]:
        """The score as it is, and every choice that moves it, those that come to the same in one row."""
        alike: dict[tuple[float, ...], list[str]] = defaultdict(list)
        for one in self.alternatives:
            if one.numbers and self._moves(one):
                alike[tuple(one.numbers[metric.name] for metric in self.kind.metrics)].append(one.words)
        own = tuple(self.numbers[metric.name] for metric in self.kind.metrics)
        rows = [(*self._cells(own, own), f"nothing: protocol {self.protocol}")]
        return rows + [(*self._cells(found, own), "; or ".join(words)) for found, words in alike.items()]

    def _cells(self, found: Sequence[float], own: Sequence[float]) -> Iterator[str]:
        for value, before, metric in zip(found, own, self.kind.metrics, strict=True):
            yield metric.format_single(value)
            yield _change(metric, value, before)

    def _moves(self, one: Alternative) -> bool:
        """Return whether a choice changes a number in the decimals that are shown."""
        metrics = self.kind.metrics
        return any(_change(metric, one.numbers[metric.name], self.numbers[metric.name]) for metric in metrics)

    @property
    def remarks(self) -> list[str]:
        """What does not move the score, and what cannot be told of this image, a line each."""
        still = [one for one in self.alternatives if one.numbers and not self._moves(one)]
        of = {group: [one for one in self.alternatives if one.group == group] for group in ("input", "alone", "here")}
        lines = [
            ("Changes nothing here", still),
            ("Of the network's input, which was fixed when the prediction was made", of["input"]),
            ("Only together with other fields: score under that protocol (--protocol NAME)", of["alone"]),
        ]
        told = [f"{what}: {'; '.join(one.in_short for one in ones)}." for what, ones in lines if ones]
        return [*told, *(f"Not for this image: {one.in_short}: {one.reason}." for one in of["here"])]

    @property
    def text(self) -> str:
        """All of it, in lines of 80 characters."""
        left = (len(self.header) - 1,)
        return "\n".join(
            [
                *wrapped(self.heading),
                "",
                *(line for name, what in self.steps for line in _step_lines(name, what)),
                "",
                text_table(self.header, self.rows, left, columns=_COLUMNS),
                "",
                *(line for remark in self.remarks for line in wrapped(remark)),
            ]
        )

    @property
    def frame(self) -> pd.DataFrame:
        """The alternatives as a pandas DataFrame, every digit; those without a score have the reason."""
        import pandas as pd

        rows = [
            {"field": one.name, "value": one.value, "like": ", ".join(one.like)}
            | {name: one.numbers.get(name, math.nan) for name in self.numbers}
            | {"reason": one.reason}
            for one in self.alternatives
        ]
        return pd.DataFrame(rows, columns=["field", "value", "like", *self.numbers, "reason"])

    def as_dict(self) -> dict[str, Any]:
        """Return everything as plain JSON types."""
        alternatives = [
            {"field": one.name, "value": one.value, "like": list(one.like), "values": one.numbers, "reason": one.reason}
            for one in self.alternatives
        ]
        own = {"rank": self.rank, "score": self.score.as_dict(self.kind), "steps": [list(step) for step in self.steps]}
        return json_object(own | {"alternatives": alternatives})


@spell_keywords(EvaluationOptions)
def explain(
    predictions: Path | str | None,
    dataset: str = "eld",
    frame: str | None = None,
    *,
    protocol: str | Path | Protocol | None = None,
    **options: Unpack[EvaluationOptions],
) -> Explanation:
    """Evaluate, and tell of one image the steps from its files to its score, and what other choices would make of it.

    The other choices are the values that shipped protocols have: the same image is scored under the protocol with one
    field replaced, such as without the factor, or by the files' own white level.

    Parameters
    ----------
    predictions, dataset, protocol, **options
        As for :func:`evaluate`.
    frame
        Path or name of a noisy frame, or the scene of a clip. Default: the one with the lowest PSNR.

    Returns
    -------
    Explanation
        Print its ``text``; ``frame`` has the other scores as a pandas DataFrame.

    Raises
    ------
    EldataError, DatasetError, ManifestError, ArgumentError
        Like :func:`evaluate`; or if no such frame was scored.

    Examples
    --------
    >>> from eldata.evaluation import explain
    >>> manifest = "eldata-demo/manifests/eld-demo.csv"
    >>> found = explain(None, manifest=manifest, root="eldata-demo/data", baseline="input")
    >>> found.score.path
    'DemoBeta/scene-1/IMG_0015.dng'
    >>> float(found.frame.set_index("field")["psnr_db"].round(2)["rescaling"])
    16.84
    """
    request = make_request(predictions, dataset, protocol, options)
    result = perform(request).results[0]
    return explain_scores(request, result, [chosen_score(result, frame)])[0]


def chosen_score(result: EvaluationResult, frame: str | None) -> tuple[str, UnitScore]:
    """Return the score of a frame, by its path or name, or the worst, and what it is among the others.

    Raises
    ------
    ArgumentError
        If there is none, or several have that name.
    """
    kind = result.kind
    if frame is None:
        return ranked_scores(result)[0]
    found = [one for one in result.scores if frame in (one.path, one.name)]
    found = found or [one for one in result.scores if frame == PurePosixPath(one.path).name]
    if len(found) == 1:
        return f"one of {counted(len(result.scores), kind.unit)}", found[0]
    if found:
        paths = ", ".join(one.path for one in found[:3])
        raise ArgumentError(f"{frame}: {len(found)} {kind.units} are called so, such as {paths}; give the path")
    if frame in result.missing:
        raise ArgumentError(f"{frame}: was not scored, so there is nothing to explain; the problems above say why")
    known = [one.path for one in result.scores]
    raise ArgumentError(f"{frame}: no such {kind.unit} was scored; the CSV lists them{did_you_mean(frame, known)}")


def ranked_scores(result: EvaluationResult) -> list[tuple[str, UnitScore]]:
    """Return the worst and, if it is another, the median by PSNR, with what they are.

    Raises
    ------
    ArgumentError
        If nothing has a score.
    """
    ranked = sorted((one for one in result.scores if not math.isnan(one.psnr_db)), key=lambda one: one.psnr_db)
    if not ranked:
        raise ArgumentError("nothing was scored, so there is nothing to explain")
    (worst,), _ = worst_and_best(ranked, 1)
    middle = ranked[(len(ranked) - 1) // 2]
    of = f"of {counted(len(ranked), result.kind.unit)} by PSNR"
    return [(f"the worst {of}", worst), *([(f"the median {of}", middle)] if middle is not worst else [])]


def explain_scores(
    request: Request, result: EvaluationResult, ranked: Sequence[tuple[str, UnitScore]]
) -> list[Explanation]:
    """Return the explanation of some of a result's scores, each with what it is among the others.

    Their files are read once for all choices.

    Raises
    ------
    EldataError
        If a file is no longer what was scored.
    """
    protocol = result.protocol
    if not isinstance(protocol, Protocol):
        raise ArgumentError("an explanation is of a result that was just computed; this one was read back")
    units = {unit.path: unit for unit in result.units}
    scores = [score for _, score in ranked]
    images = images_of(
        [result],
        [(score,) for score in scores],
        dataset_folder=request.files,
        predictions=[request.predictions],
        dark_shading=request.dark_shading,
        store=request.store,
    )
    changes = [list(changes_of(protocol, request, units[score.path])) for score in scores]
    tried = [[protocol, *(replace(protocol, **{one.name: one.value}) for one in of if not one.group)] for of in changes]
    outcomes = iter(score_each(request, images, tried))
    found = []
    for told, (rank, score), of in zip(request.workers.attempt(_tell, images), ranked, changes, strict=True):
        same = next(outcomes)
        if isinstance(told, Failed):
            raise told.error
        if repr(same.scores.get(score.path)) != repr(score):
            raise EldataError(f"{score.name}: does not score again what it did; was one of its files replaced?")
        alternatives = tuple(one if one.group else with_score(one, next(outcomes), score.path) for one in of)
        steps = (*told, *_last_steps(protocol, result.kind, score, same))
        found.append(Explanation(rank, protocol.name, result.kind, score, steps, alternatives))
    return found


def _change(metric: Figure, value: float, before: float) -> str:
    """Return a change with its sign; nothing of none in the decimals that are shown."""
    text = "" if value == before else metric.format_difference(value - before)
    return text if text.strip("+-0.") else ""


def _step_lines(name: str, what: str) -> list[str]:
    return wrapped(f"{name:<{_STEP}}{what}", " " * _STEP)


# --- the steps --------------------------------------------------------------------------------------------------------


def _tell(image: ScoredImage) -> tuple[tuple[str, str], ...]:
    """Return the steps up to the factor; in a worker."""
    protocol, file = image.protocols[0], image.files[0]
    compared = image.compared(0)
    packed = (*_level_steps(compared, protocol), *_input_steps(image, compared)) if protocol.is_of_packed else ()
    return (
        *_frame_steps(image),
        ("reference", reference_of(image.pair, compared.path) or ""),
        ("prediction", "the noisy frame itself, amplified" if file is None else str(file)),
        *packed,
        *_value_steps(compared, protocol, image.frames[0].rescale),
    )


def _frame_steps(image: ScoredImage) -> Iterator[tuple[str, str]]:
    unit, shown, frames = image.pair, image.frames[0], frames_of(image.pair)
    facts = [unit.camera, unit.scene, *([f"ISO {iso_of(unit):g}"] if iso_of(unit) else [])]
    facts += [factor_text(ratio_of(unit))] if ratio_of(unit) else []
    if len(frames) > 1:
        span = f"{counted(len(frames), 'frame')}, {frames[0]} to {frames[-1]}"
        yield "clip", f"{span}; the steps to the factor are of the worst"
        facts.append(f"{shown.psnr_db:.2f} dB by itself")
    yield "noisy frame", f"{shown.path} ({', '.join(facts)})"


def _level_steps(compared: ComparedFrame, protocol: Protocol) -> Iterator[tuple[str, str]]:
    raw = compared.reference.frame
    taken, stated = levels_dn(raw, protocol.levels), levels_dn(raw, "metadata")
    other = "" if taken == stated else f"; the file states {_levels_text(*stated)}"
    yield "levels", f"{_levels_text(*taken)}: {in_words('levels', protocol.levels)}{other}"
    values = normalised_frame(raw, protocol.levels, clip="none")
    shares = f"{_share(values < 0)} lies below 0, {_share(values > 1)} above 1"
    yield "reference clip", f"{in_words('reference_clip', protocol.reference_clip)}; {shares}"


def _levels_text(black: Sequence[float], white: Sequence[float]) -> str:
    texts = (", ".join(f"{one:g}" for one in dict.fromkeys(of)) for of in (black, white))
    return "black {}, white {}".format(*texts)


def _input_steps(image: ScoredImage, compared: ComparedFrame) -> Iterator[tuple[str, str]]:
    protocol, unit, originals = image.protocols[0], image.pair, image.originals
    try:
        path = reference_of(unit, compared.path) or ""
        by_files = f"{float(exposure_ratio(originals.header(path), originals.header(compared.path))):.6g}"
    except RawFileError:
        by_files = "not stated"
    measured = unit.measured_ratio if isinstance(unit, PairRecord) else None
    ratios = [f"{by_files} by the files' exposures"]
    ratios += [f"{ratio_of(unit):g} by the manifest"] if ratio_of(unit) else []
    ratios.append("not measured" if measured is None else f"measured {float(measured):.6g}")
    yield "exposure ratio", ", ".join(ratios)
    made = f"amplified {in_words('amplification', protocol.amplification)}"
    shading = "" if protocol.dark_shading == NO_SHADING else ", less the dark shading"
    yield "input", f"{made}, clip: {in_words('input_clip', protocol.input_clip)}{shading}"


def _value_steps(compared: ComparedFrame, protocol: Protocol, factor: float) -> Iterator[tuple[str, str]]:
    prediction, target = compared.prediction(protocol), compared.target(protocol)
    crop, part = protocol.crop(target.shape), protocol.factor_crop(target.shape)
    yield "region", f"{region_words(protocol.region)}: {' x '.join(map(str, target[crop].shape))} values"
    yield "reference has", _spread_text(target[crop])
    clamp = f"clamp: {in_words('prediction_clamp', protocol.prediction_clamp)}"
    yield "prediction has", f"{_spread_text(prediction[crop])}; {clamp}"
    if protocol.rescaling == "none":
        yield "factor", "none: the brightness of the prediction counts"
    else:
        where = region_words(protocol.factor_region)
        if protocol.rescaling_mask == "unsaturated":
            where += f" where the reference is not 1 ({_share(target[part] != 1)})"
        yield "factor", f"{factor:.6g}, for the least squared error over the {where}"
    for name in ("rendering", "quantisation", "rounding"):
        if getattr(protocol, name) != NEUTRAL[name]:
            yield FIELDS[name][0], in_words(name, getattr(protocol, name))


def _spread_text(values: NDArray[Any]) -> str:
    """Return the ends of values, their mean, and how many lie at the ends, which shows what was clipped."""
    low, high = values.min(), values.max()
    ends = f"at these ends {_share(values == low)} and {_share(values == high)}"
    return f"values from {low:.4g} to {high:.4g}, {ends}, mean {values.mean(dtype=np.float64):.4g}"


def _share(of: NDArray[np.bool_]) -> str:
    return f"{100 * np.count_nonzero(of) / of.size:.2f} %"


def _last_steps(protocol: Protocol, kind: Kind, score: UnitScore, same: PlanScores) -> Iterator[tuple[str, str]]:
    """Yield the scores with every digit, and the mistake that the prediction shows, if it shows one."""
    defined = dict(described(protocol))
    for metric in kind.metrics:
        value = f"{score.values[metric.name]!r} {metric.unit}".rstrip()  # noqa: PD011 # no DataFrame
        on = f", data range {protocol.data_range:g}" if metric.name == "psnr_db" else ""
        yield metric.label, f"{value}: {defined.get(metric.label, metric.meaning)}{on}"
    for one in same.inspections:
        if one.mistake is not None:
            without = "" if one.mistake.without_db is None else f": {one.mistake.without_db:.2f} dB without"
            yield "SUSPECT", f"{one.mistake.words}{without}"
