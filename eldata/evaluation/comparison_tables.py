"""A comparison of methods in text, Markdown and LaTeX, and the words that its page shares."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from eldata.base.tables import Strong, latex_table, markdown_table, markdown_text, text_table
from eldata.evaluation.statistics import LEVEL, RESAMPLES, SEED
from eldata.evaluation.table import camera_text, factor_text, short_digest

if TYPE_CHECKING:
    from eldata.base.tables import Format
    from eldata.evaluation.comparison import Comparison, Group
    from eldata.evaluation.statistics import Difference
    from eldata.protocols.kinds import Kind


def mean_texts(group: Group, kind: Kind) -> list[str]:
    """Return the means of each method as printed; what prints like the best of its row is :class:`Strong`."""
    columns = []
    for metric in kind.metrics:
        values = [means[metric.name] for means in group.means]
        texts = [metric.text(value) if not math.isnan(value) else "-" for value in values]
        known = [value for value in values if not math.isnan(value)]
        best = metric.text((max if metric.higher_is_better else min)(known)) if known else ""
        columns.append([Strong(text) if text == best else text for text in texts])
    return [text for each in zip(*columns, strict=True) for text in each]


def gain_texts(gain: dict[str, Difference], kind: Kind) -> list[str]:
    """Return difference, interval and p-value of each metric as printed."""
    cells = []
    for metric in kind.metrics:
        difference, places = gain[metric.name], metric.gain_places
        interval = difference.interval
        reach = f"{signed_text(interval.low, places)} to {signed_text(interval.high, places)}"
        cells += [
            signed_text(interval.mean, places),
            reach if interval.is_known else "-",
            p_text(difference.p_value),
        ]
    return cells


def signed_text(value: float, decimals: int) -> str:
    """Return a difference with its sign; ``-`` for one that is not known."""
    return f"{value:+.{decimals}f}" if not math.isnan(value) else "-"


def p_text(p_value: float) -> str:
    """Return a p-value as printed: three decimals, ``<0.001`` below."""
    if math.isnan(p_value):
        return "-"
    return f"{p_value:.3f}" if p_value >= 0.0005 else "<0.001"


def gain_header(kind: Kind) -> tuple[str, ...]:
    """Return the heads of :func:`gain_texts`."""
    return tuple(head for metric in kind.metrics for head in (metric.head, f"{LEVEL:.0%} interval", "p"))


def means_header(comparison: Comparison) -> tuple[str, ...]:
    """Return the heads of :func:`mean_texts`."""
    return tuple(
        f"{method.name} {metric.unit or metric.label}"
        for method in comparison.methods
        for metric in comparison.kind.metrics
    )


def labels(comparison: Comparison) -> list[tuple[str, str, str]]:
    """Return camera and factor of each group, a camera's name once, and how many images it has."""
    names = [camera_text(group.camera) for group in comparison.groups]
    return [
        ("" if index and name == names[index - 1] else name, factor_text(group.ratio), str(group.images))
        for index, (name, group) in enumerate(zip(names, comparison.groups, strict=True))
    ]


def label_header(kind: Kind) -> tuple[str, str, str]:
    """Return the heads of :func:`labels`."""
    return "camera", "factor", kind.units


def format_comparison(comparison: Comparison, form: Format) -> str:
    """Return the tables: means of every method, then each method's differences to the first."""
    if form == "latex":
        return _latex(comparison)
    return _markdown(comparison) if form == "markdown" else _text(comparison)


def summary_of(comparison: Comparison) -> str:
    """Return what was compared, in a line."""
    result, kind = comparison.methods[0].result, comparison.kind
    count, scenes = len(comparison.images), comparison.whole.scenes
    return (
        f"{len(comparison.methods)} methods on {count} common {kind.unit if count == 1 else kind.units} of {scenes} "
        f"{'scene' if scenes == 1 else 'scenes'}: {result.dataset}, protocol {result.protocol.name} "
        f"({short_digest(result.digest)})"
    )


def statistics_note() -> str:
    """Return what interval and p are, in a sentence."""
    return (
        f"Interval: {LEVEL:.0%}, bootstrap over scenes ({RESAMPLES} resamples, seed {SEED}); p: signs of whole scenes "
        "flipped, two-sided. Of fewer than 6 scenes there is no interval."
    )


def _means_rows(comparison: Comparison) -> list[tuple[str, ...]]:
    return [
        (*label, *mean_texts(group, comparison.kind))
        for label, group in zip(labels(comparison), comparison.groups, strict=True)
    ]


def _gains_rows(comparison: Comparison, index: int) -> list[tuple[str, ...]]:
    return [
        (*label, str(group.scenes), *gain_texts(group.gains[index], comparison.kind))
        for label, group in zip(labels(comparison), comparison.groups, strict=True)
    ]


def _means_header(comparison: Comparison) -> tuple[str, ...]:
    return (*label_header(comparison.kind), *means_header(comparison))


def _gains_header(comparison: Comparison) -> tuple[str, ...]:
    return (*label_header(comparison.kind), "scenes", *gain_header(comparison.kind))


def _text(comparison: Comparison) -> str:
    rows = [
        tuple(
            f"{cell}*" if isinstance(cell, Strong) else f"{cell} " if index > 2 else cell
            for index, cell in enumerate(row)
        )
        for row in _means_rows(comparison)
    ]
    header = tuple(f"{name} " if index > 2 else name for index, name in enumerate(_means_header(comparison)))
    lines = [summary_of(comparison), "", text_table(header, rows), "* best of its row", ""]
    for index, method in enumerate(comparison.methods[1:]):
        lines += [f"{method.name} minus {comparison.methods[0].name}", ""]
        lines += [text_table(_gains_header(comparison), _gains_rows(comparison, index)), ""]
    return "\n".join([*lines, statistics_note()])


def _markdown(comparison: Comparison) -> str:
    blocks = [
        markdown_text(summary_of(comparison)),
        markdown_table(_means_header(comparison), _means_rows(comparison)),
    ]
    for index, method in enumerate(comparison.methods[1:]):
        blocks += [
            markdown_text(f"{method.name} minus {comparison.methods[0].name}:"),
            markdown_table(_gains_header(comparison), _gains_rows(comparison, index)),
        ]
    blocks += [markdown_text(statistics_note()), *(markdown_text(f"Warning: {text}") for text in comparison.warnings)]
    return "\n\n".join(blocks)


def _latex(comparison: Comparison) -> str:
    summary = summary_of(comparison)
    label = f"tab:{comparison.methods[0].result.dataset}-{comparison.methods[0].result.protocol.name}"
    rules = [index for index, (camera, *_) in enumerate(labels(comparison)) if index and camera]
    names = [metric.label for _ in comparison.methods for metric in comparison.kind.metrics]
    tables = [
        latex_table(
            (*label_header(comparison.kind), *names),
            _means_rows(comparison),
            caption=f"{summary}. PSNR in dB.",
            label=f"{label}-methods",
            spans=[("", 3), *((method.name, len(comparison.kind.metrics)) for method in comparison.methods)],
            rules=rules,
        )
    ]
    tables += [
        latex_table(
            _gains_header(comparison),
            _gains_rows(comparison, index),
            caption=f"{method.name} minus {comparison.methods[0].name}: {summary}. {statistics_note()}",
            label=f"{label}-{method.name}",
            rules=rules,
        )
        for index, method in enumerate(comparison.methods[1:])
    ]
    return "\n\n".join(tables)
