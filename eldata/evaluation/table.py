"""The table of a result: means by camera and factor, and how papers lay them out."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from eldata.evaluation.pairs import ratio_of
from eldata.evaluation.scores import UnitScore, Valued, means
from eldata.manifest.catalogue import shipped_manifest, shipped_names

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from eldata.evaluation.pairs import Pair
    from eldata.protocols.kinds import Kind


# A set whose pairs nearly all have factors of their own (LRD: 27 among 60) is not laid out by them.
_MOST_FACTORS = 12


@dataclass(frozen=True, slots=True)
class TableRow(Valued):
    """Means over a group. ``camera`` or ``ratio`` is ``None`` where the group spans all of them."""

    camera: str | None
    ratio: float | None
    pairs: int
    scored: int
    values: dict[str, float]

    def holds(self, score: UnitScore) -> bool:
        """Return whether a score is of this group."""
        return self.camera in (None, score.camera) and self.ratio in (None, score.ratio)

    @property
    def coverage(self) -> str:
        """How many were scored, as printed."""
        return str(self.pairs) if self.scored == self.pairs else f"{self.scored} of {self.pairs}"

    def texts(self, kind: Kind) -> tuple[str, ...]:
        """Return coverage and means as printed; ``-`` where nothing was scored."""
        return self.coverage, *(m.format(self.values[m.name]) if self.scored else "-" for m in kind.metrics)

    def as_dict(self, kind: Kind) -> dict[str, Any]:
        """Return it as plain types."""
        return {"camera": self.camera, "ratio": self.ratio, kind.counted: self.pairs, "scored": self.scored} | (
            self.values
        )


def groups_of(items: Sequence[tuple[str, float | None]], dataset: str = "") -> list[tuple[str | None, float | None]]:
    """Return the groups of a table over cameras and factors: camera by factor, each factor over all, and all.

    A set without factors, or with more than twelve, has each camera, if there are several, and all. Cameras come in the
    order of the set of this name (:func:`cameras_in_order`).
    """
    cameras = cameras_in_order((camera for camera, _ in items), dataset)
    ratios = sorted({ratio for _, ratio in items if ratio is not None})
    if len(ratios) > _MOST_FACTORS:
        ratios = []
    found = set(items)
    groups: list[tuple[str | None, float | None]] = [
        (camera, ratio) for camera in cameras for ratio in ratios if (camera, ratio) in found
    ]
    if len(cameras) > 1:
        groups += [(None, ratio) for ratio in ratios] if ratios else [(camera, None) for camera in cameras]
    return [*groups, (None, None)]


def table_of(pairs: Sequence[Pair], scores: Sequence[UnitScore], kind: Kind, dataset: str = "") -> tuple[TableRow, ...]:
    """Return the means over the groups of these pairs, of the dataset of this name."""
    keys = [(pair.camera, ratio_of(pair)) for pair in pairs]
    rows = []
    for camera, ratio in groups_of(keys, dataset):
        empty = TableRow(camera, ratio, 0, 0, {})
        members = [score for score in scores if empty.holds(score)]
        count = sum(camera in (None, key[0]) and ratio in (None, key[1]) for key in keys)
        names = [metric.name for metric in kind.metrics]
        rows.append(TableRow(camera, ratio, count, len(members), means(members, names)))
    return tuple(row for row in rows if row.pairs)


@dataclass(frozen=True, slots=True)
class PaperTable:
    """Cells of a table.

    Attributes
    ----------
    header, rows
        Texts.
    left
        Columns that stand to the left.
    rules
        Rows with a line above.
    transposed
        Whether the means of a row of the result stand in a column.
    """

    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    left: tuple[int, ...]
    rules: tuple[int, ...] = ()
    transposed: bool = False


def paper_table(
    rows: Sequence[TableRow],
    names: Sequence[str],
    texts: Sequence[Sequence[str]],
    *,
    one_camera: bool,
    times: str = "x",
) -> PaperTable:
    """Return the cells of a table of means.

    A set of several cameras has a row for each camera and factor, as in the ELD paper's table; a set of one camera has
    a column for each factor, as in those on SID; without factors it is one row, as in those on DRV.

    Parameters
    ----------
    rows
        Of the result.
    names, texts
        What each row states, and its texts.
    one_camera
        Whether the set has one camera, and all of it was chosen.
    times
        As for :func:`factor_text`.
    """
    if len(rows) == 1 and rows[0].ratio is None:
        return PaperTable(tuple(names), (tuple(texts[0]),), (0,))
    if one_camera and len({row.camera for row in rows if row.camera is not None}) == 1:
        header = (rows[0].camera or "", *(factor_text(row.ratio, times) for row in rows))
        cells = tuple((name, *values) for name, values in zip(names, zip(*texts, strict=True), strict=True))
        return PaperTable(header, cells, (0,), transposed=True)
    return grouped_table([(row.camera, row.ratio) for row in rows], names, texts, times)


def grouped_table(
    groups: Sequence[tuple[str | None, float | None]],
    names: Sequence[str],
    texts: Sequence[Sequence[str]],
    times: str = "x",
) -> PaperTable:
    """Return a row of texts for each group of camera and factor, with the camera's name once."""
    cameras = ["all" if camera is None else camera for camera, _ in groups]
    starts = [index for index, camera in enumerate(cameras) if not index or camera != cameras[index - 1]]
    cells = tuple(
        (cameras[index] if index in starts else "", factor_text(ratio, times), *texts[index])
        for index, (_, ratio) in enumerate(groups)
    )
    return PaperTable(("camera", "factor", *names), cells, (0,), tuple(starts[1:]))


def factor_text(ratio: float | None, times: str = "x") -> str:
    """Return a factor as printed, ``x100``, or ``all``; ``times`` is the sign of multiplication."""
    return "all" if ratio is None else f"{times}{ratio:g}"


def short_digest(digest: str) -> str:
    """Return the beginning of a digest that tells it from others: ``sha256:`` and eight digits."""
    return digest[:15]


# --- the order in which people read -----------------------------------------------------------------------------------


def natural(text: str) -> tuple[tuple[int, int, str], ...]:
    """Return a key that sorts texts with the numbers in them as numbers: ``scene-2`` before ``scene-10``."""
    parts = re.split(r"([0-9]+)", text)
    return tuple((0, int(part), part) if index % 2 else (1, 0, part) for index, part in enumerate(parts) if part)


def cameras_in_order(cameras: Iterable[str], dataset: str) -> list[str]:
    """Return names of cameras once each: in the order of the card, and of its paper, of a set that comes with eldata.

    Others, and those of a set of the user's own, follow by their names.
    """
    known = list(shipped_manifest(dataset).card.cameras) if dataset in shipped_names() else []
    found = set(cameras)
    return [name for name in known if name in found] + sorted(found.difference(known), key=natural)
