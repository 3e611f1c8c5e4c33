"""Published numbers: their tables and sources."""

from __future__ import annotations

import csv
import io
import json
import math
from dataclasses import dataclass, fields
from functools import cache
from typing import TYPE_CHECKING, Any

from eldata.errors import ManifestError
from eldata.evaluation.table import factor_text
from eldata.manifest.catalogue import shipped_folder

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable
    from pathlib import Path


COLUMNS = (
    *("source", "table", "dataset", "camera", "subset", "protocol", "ratio", "pairs", "method"),
    *("psnr_db", "ssim", "st_rred", "note"),
)


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
        Its name; what a paper calls "ours" has a name here.
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
        return place_text(self.camera, self.ratio)


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
    sources = _load_sources(folder / "sources.json")
    rows: list[PublishedRow] = []
    line_of: dict[tuple[object, ...], str] = {}
    for path in sorted(folder.glob("*.csv")):
        for where, row in _load_rows(path, sources):
            key = (row.source, row.table, row.dataset, row.camera, row.ratio, row.method)
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


def _load_sources(path: Path) -> dict[str, PublishedSource]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ManifestError(f"{path}: cannot be read: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise ManifestError(f"{path}: is not JSON ({error})") from error
    if not isinstance(content, dict):
        raise ManifestError(f"{path}: expected a JSON object, found {type(content).__name__}")
    return {key: _source(f"{path}, {key}", key, entry) for key, entry in content.items()}


def _source(where: str, key: str, entry: Any) -> PublishedSource:
    names = [field.name for field in fields(PublishedSource) if field.name != "key"]
    if not isinstance(entry, dict) or sorted(entry) != sorted(names):
        found = ", ".join(entry) if isinstance(entry, dict) else type(entry).__name__
        raise ManifestError(f"{where}: expected the fields {', '.join(names)}; found {found}")
    for name, kind in (("tables", dict), ("known", list), ("unknown", list)):
        if not isinstance(entry[name], kind):
            raise ManifestError(f"{where}, {name}: expected {kind.__name__}, found {type(entry[name]).__name__}")
    texts = [entry[name] for name in ("label", "citation", "url")]
    texts += [*entry["known"], *entry["unknown"], *entry["tables"].values()]
    if entry["commit"] is not None:
        texts.append(entry["commit"])
    if not all(isinstance(text, str) and text for text in texts):
        raise ManifestError(f"{where}: expected text that is not empty in every field")
    return PublishedSource(key=key, **(entry | {name: tuple(entry[name]) for name in ("known", "unknown")}))


def _load_rows(path: Path, sources: dict[str, PublishedSource]) -> Iterable[tuple[str, PublishedRow]]:
    try:
        text = path.read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise ManifestError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise ManifestError(f"{path}: is not UTF-8 text (byte {error.start})") from error
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    try:
        for cells in reader:
            where = f"{path} line {reader.line_num}"
            if reader.line_num == 1:
                if tuple(cells) != COLUMNS:
                    raise ManifestError(f"{where}: expected the columns {','.join(COLUMNS)}; found {','.join(cells)}")
            elif len(cells) != len(COLUMNS):
                raise ManifestError(f"{where}: expected {len(COLUMNS)} fields, found {len(cells)}")
            else:
                yield where, _row(where, dict(zip(COLUMNS, cells, strict=True)), sources)
    except csv.Error as error:
        raise ManifestError(f"{path} line {reader.line_num}: is not CSV ({error})") from error


def _row(where: str, cells: dict[str, str], sources: dict[str, PublishedSource]) -> PublishedRow:
    def number(column: str) -> float:
        try:
            value = float(cells[column])
        except ValueError:
            value = math.nan
        if not (math.isfinite(value) and value >= 0):
            raise ManifestError(f"{where}, column {column}: expected a number, found {cells[column]!r}")
        return value

    def optional(column: str) -> float | None:
        return number(column) if cells[column] else None

    for column in ("dataset", "camera", "method"):
        if not cells[column]:
            raise ManifestError(f"{where}, column {column}: is empty")
    source = sources.get(cells["source"])
    if source is None:
        raise ManifestError(f"{where}, column source: {cells['source']!r} is not in sources.json")
    if cells["table"] not in source.tables:
        raise ManifestError(
            f"{where}, column table: {source.key} has {', '.join(map(repr, source.tables))}; found {cells['table']!r}"
        )
    if not (cells["protocol"] or cells["note"]):
        raise ManifestError(f"{where}, column note: is empty; a number without a protocol needs the reason")
    if cells["pairs"] and not (cells["pairs"].isdecimal() and int(cells["pairs"]) > 0):
        raise ManifestError(f"{where}, column pairs: expected a count, found {cells['pairs']!r}")
    return PublishedRow(
        source=source.key,
        table=cells["table"],
        dataset=cells["dataset"],
        camera=cells["camera"],
        subset=cells["subset"] or None,
        protocols=tuple(name for name in cells["protocol"].split(";") if name),
        ratio=optional("ratio"),
        pairs=int(cells["pairs"]) if cells["pairs"] else None,
        method=cells["method"],
        psnr_db=number("psnr_db"),
        ssim=optional("ssim"),
        st_rred=optional("st_rred"),
        note=cells["note"],
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


def place_text(camera: str, ratio: float | None) -> str:
    """Return camera and factor as text."""
    return f"{camera} {factors_text(ratio)}"


def factors_text(ratio: float | None) -> str:
    """Return a factor as text; all of them, if it is ``None``."""
    return "all factors" if ratio is None else factor_text(ratio)
