"""Published numbers: their tables and sources."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

from eldata.base.fields import Fields, TextFile, TextRow, names_of
from eldata.base.visible import shown
from eldata.errors import ManifestError
from eldata.evaluation.scores import factor_text
from eldata.manifest.catalogue import shipped_folder

if TYPE_CHECKING:
    from collections.abc import Collection
    from pathlib import Path


COLUMNS = (
    *("source", "table", "dataset", "camera", "subset", "protocol", "ratio", "pairs", "method"),
    *("psnr_db", "ssim", "st_rred", "note"),
)
NOISY_INPUT = "noisy input"
"""The method of a row that scores the input itself, as ``--baseline input`` does, and no prediction."""


@dataclass(frozen=True, slots=True)
class PublishedSource:
    """Where published numbers come from.

    Attributes
    ----------
    key, label
        Name in the tables' column ``source``; name for readers.
    citation, url, commit
        What to cite, where it is, and the state of the code that says how it was computed, if there is code.
    tables
        Title of each of its tables by the table's name.
    known, unknown
        What is known of how the numbers were computed, and what is not.
    """

    key: str
    label: str
    citation: str
    url: str
    commit: str | None
    tables: dict[str, str]
    known: tuple[str, ...]
    unknown: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class PublishedRow:
    """A published number: PSNR with the SSIM beside it, of one method.

    Attributes
    ----------
    source, table
        Key of the :class:`PublishedSource` and name of its table.
    dataset, camera, subset, ratio
        What was scored. ``subset`` is a name on the dataset's card, ``None`` the whole set or not known; ``ratio`` is
        the low-light factor, ``None`` a mean over all.
    protocols
        Names of the protocols that score as the source did; empty if how it did is not known for certain, and then
        ``note`` says what is not.
    pairs
        How many pairs the mean is over, if known.
    method
        Its name; what a paper calls "ours" has a name here. :data:`NOISY_INPUT` is none: the input itself was scored.
    psnr_db, ssim, st_rred
        As printed; ``None`` where it is not published or not known.
    note
        What else to know.
    """

    source: str
    table: str
    dataset: str
    camera: str
    subset: str | None
    protocols: tuple[str, ...]
    ratio: float | None
    pairs: int | None
    method: str
    psnr_db: float
    ssim: float | None
    st_rred: float | None
    note: str

    @property
    def place(self) -> str:
        """Camera and factor as text."""
        return f"{self.camera} {factors_text(self.ratio)}"


@dataclass(frozen=True, slots=True)
class PublishedTables:
    """Published numbers and their sources, by key."""

    sources: dict[str, PublishedSource]
    rows: tuple[PublishedRow, ...]


# --- reading ------------------------------------------------------------------------------------------------------


def load_published(folder: Path) -> PublishedTables:
    """Read published numbers: ``sources.json`` and every ``*.csv`` of a folder.

    Raises
    ------
    ManifestError
        If a file cannot be read or is malformed; the message names file, line and column.
    """
    top = TextFile(folder / "sources.json", ManifestError).json()
    sources = {key: _source(key, top.inside(key)) for key in top.data}
    rows: list[PublishedRow] = []
    line_of: dict[tuple[object, ...], str] = {}
    for path in sorted(folder.glob("*.csv")):
        for cells in TextFile(path, ManifestError).rows(COLUMNS):
            row = _row(cells, sources)
            key = (row.source, row.table, row.dataset, row.camera, row.ratio, row.method)
            where = f"{path}, {cells.place}"
            if key in line_of:
                raise ManifestError(f"{where}: repeats {line_of[key]}: {row.method}, {row.place}")
            line_of[key] = where
            rows.append(row)
    if not rows:
        raise ManifestError(f"{folder}: holds no published numbers (*.csv)")
    return PublishedTables(sources, tuple(rows))


@cache
def shipped_published() -> PublishedTables:
    """Return the published numbers that come with the package."""
    return load_published(shipped_folder() / "published")


def _source(key: str, entry: Fields) -> PublishedSource:
    entry.only([name for name in names_of(PublishedSource) if name != "key"])
    tables = entry.inside("tables")
    return PublishedSource(
        key=key,
        label=entry.text("label"),
        citation=entry.text("citation"),
        url=entry.text("url"),
        commit=None if entry.value("commit") is None else entry.text("commit"),
        tables={name: tables.text(name) for name in tables.data},
        known=entry.texts("known"),
        unknown=entry.texts("unknown"),
    )


def _row(row: TextRow, sources: dict[str, PublishedSource]) -> PublishedRow:
    source = sources.get(row.text("source"))
    if source is None:
        raise row.problem("source", f"{shown(row.data['source'])} is not in sources.json")
    protocols, note = row.data["protocol"], row.data["note"]
    if not (protocols or note):
        raise row.problem("note", "is empty; a number without a protocol needs the reason")
    return PublishedRow(
        source=source.key,
        table=row.choice("table", tuple(source.tables)),
        dataset=row.text("dataset"),
        camera=row.text("camera"),
        subset=row.data["subset"] or None,
        protocols=tuple(name for name in protocols.split(";") if name),
        ratio=row.optional("ratio", row.number, at_least=0),
        pairs=row.optional("pairs", row.whole, at_least=1),
        method=row.text("method"),
        psnr_db=row.number("psnr_db", at_least=0),
        ssim=row.optional("ssim", row.number, at_least=0),
        st_rred=row.optional("st_rred", row.number, at_least=0),
        note=note,
    )


# --- choosing -----------------------------------------------------------------------------------------------------


def published_rows(
    dataset: str,
    protocol: str | None = None,
    *,
    subset: str | None = None,
    camera: str | None = None,
    ratios: Collection[float] | None = None,
) -> tuple[PublishedRow, ...]:
    """Return the published numbers on a dataset, in the order of the files. ``None`` means any.

    Parameters
    ----------
    dataset
        Name of a shipped manifest, such as ``sid-sony``.
    protocol
        Name of a protocol; numbers whose protocol is not known for certain are under none.
    subset, camera
        Name of a subset on the dataset's card, and of a camera.
    ratios
        Low-light factors.

    Examples
    --------
    >>> from eldata.evaluation import published_rows
    >>> sorted({row.method for row in published_rows("eld", "eld")})[:3]
    ['A-BM3D', 'BM3D', 'ELD']
    """
    return tuple(
        row
        for row in shipped_published().rows
        if row.dataset == dataset
        and (protocol is None or protocol in row.protocols)
        and (subset is None or row.subset == subset)
        and (camera is None or row.camera == camera)
        and (ratios is None or row.ratio in ratios)
    )


def factors_text(ratio: float | None) -> str:
    """Return a factor as text; all of them, if it is ``None``."""
    return "all factors" if ratio is None else factor_text(ratio)
