"""Results read back from the JSON that ``eldata evaluate --json`` wrote, checked field by field."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NoReturn, TypeVar

from eldata import __version__
from eldata.errors import FileError

Value = TypeVar("Value")

_AGAIN: Final = "write it again with eldata evaluate --json"


@dataclass(frozen=True, slots=True)
class SavedScore:
    """Scores of one prediction, as :class:`eldata.evaluation.results.ImageScore`.

    ``psnr_db`` is infinite where the prediction equals its reference; a score that is not known is nan; ``iso`` is 0
    where it is not known.
    """

    path: str
    camera: str
    scene: str
    iso: float
    ratio: float
    psnr_db: float
    ssim: float
    rescale: float

    @property
    def place(self) -> tuple[str, str]:
        """Camera and scene: images that share them are not independent."""
        return self.camera, self.scene


@dataclass(frozen=True, slots=True)
class SavedRow:
    """A row of the table: means over a group. ``camera`` or ``ratio`` is ``None`` where it spans all of them."""

    camera: str | None
    ratio: float | None
    pairs: int
    scored: int
    psnr_db: float
    ssim: float

    def holds(self, image: SavedScore) -> bool:
        """Return whether an image is of this group."""
        return self.camera in (None, image.camera) and self.ratio in (None, image.ratio)


@dataclass(frozen=True, slots=True)
class SavedProblem:
    """What kept a prediction from being scored."""

    path: str
    reason: str


@dataclass(frozen=True, slots=True)
class SavedResult:
    """One result of :func:`eldata.evaluate`, under one protocol.

    Attributes
    ----------
    source
        Where it was read from, for messages.
    protocol, provenance
        As plain types, with whatever fields the writing version had.
    pairs
        How many pairs the protocol and the subset name, scored or not.
    missing
        Noisy frames without a usable prediction.
    images, table
        Scores, and their means.
    problems, notes
        What was wrong, and what a reader of the table should know.
    """

    source: str
    protocol: dict[str, Any]
    provenance: dict[str, Any]
    pairs: int
    missing: tuple[str, ...]
    images: tuple[SavedScore, ...]
    table: tuple[SavedRow, ...]
    problems: tuple[SavedProblem, ...]
    notes: tuple[str, ...]

    @property
    def protocol_name(self) -> str:
        """The protocol's name."""
        return str(self.protocol["name"])

    @property
    def protocol_digest(self) -> str:
        """``sha256:<hex>`` of what of the protocol decides a score."""
        return str(self.provenance["protocol_digest"])

    @property
    def dataset(self) -> str:
        """The dataset's name."""
        return str(self.provenance["dataset"])

    def images_of(self, row: SavedRow) -> tuple[SavedScore, ...]:
        """Return the images that a row of the table is the mean of."""
        return tuple(image for image in self.images if row.holds(image))


def load_results(path: Path | str) -> tuple[SavedResult, ...]:
    """Read what ``eldata evaluate --json`` wrote: one result a protocol.

    Raises
    ------
    FileError
        If the file cannot be read, is not whole, is something else, holds scores of clips, or was written by a newer
        version; the message names the field.
    """
    path = Path(path)
    data = _parsed(path)
    if not isinstance(data, dict):
        raise FileError(path, f"is not a result of eldata evaluate: expected an object, found {_found(data)}; {_AGAIN}")
    if "results" not in data:
        return (saved_result(data, path),)
    many = data["results"]
    if not isinstance(many, list) or not many:
        raise FileError(path, f"field results must be a list of results; found {_found(many)}; {_AGAIN}")
    return tuple(saved_result(one, path, f"results[{index}].") for index, one in enumerate(many))


def saved_result(data: object, source: Path | str, prefix: str = "") -> SavedResult:
    """Return the checked records of one result.

    Parameters
    ----------
    data
        What :meth:`eldata.evaluation.results.EvaluationResult.as_dict` gives.
    source
        What messages call it.
    prefix
        What its fields' names begin with in messages.

    Raises
    ------
    FileError
        As :func:`load_results`.
    """
    top = _Fields(source, prefix, data)
    if "videos" in top.values:
        raise FileError(source, "holds scores of clips; this works on results of images (eld, sid, your own pairs)")
    provenance = top.fields("provenance")
    _require_known_version(provenance)
    for name in ("dataset", "protocol_digest", "manifest_sha256"):
        provenance.text(name)
    protocol = top.fields("protocol")
    protocol.text("name")
    coverage = top.fields("coverage")
    images = tuple(_score(one) for one in top.each("images"))
    pairs, scored = coverage.count("pairs"), coverage.count("scored")
    if scored != len(images):
        coverage.refuse("scored", f"must be the number of images, {len(images)}", scored)
    missing = coverage.texts("missing")
    if pairs < len(images):
        coverage.refuse("pairs", f"must be {len(images)} or more, for so many images were scored", pairs)
    seen: set[str] = set()
    for index, image in enumerate(images):
        if image.path in seen:
            top.refuse(f"images[{index}].path", "must be of an image that is not there yet", image.path)
        seen.add(image.path)
    return SavedResult(
        source=str(source),
        protocol=dict(protocol.values),
        provenance=dict(provenance.values),
        pairs=pairs,
        missing=missing,
        images=images,
        table=tuple(_row(one) for one in top.each("table")),
        problems=tuple(SavedProblem(one.text("path"), one.text("reason")) for one in top.each("problems")),
        notes=top.texts("notes"),
    )


def _score(one: _Fields) -> SavedScore:
    return SavedScore(
        path=one.text("path"),
        camera=one.text("camera"),
        scene=one.text("scene"),
        iso=one.number("iso", at_least=0),
        ratio=one.number("ratio", at_least=0),
        psnr_db=one.number_or_nothing("psnr_db"),
        ssim=one.number_or_nothing("ssim"),
        rescale=one.number_or_nothing("rescale"),
    )


def _row(one: _Fields) -> SavedRow:
    return SavedRow(
        camera=None if one.get("camera") is None else one.text("camera"),
        ratio=None if one.get("ratio") is None else one.number("ratio", at_least=0),
        pairs=one.count("pairs"),
        scored=one.count("scored"),
        psnr_db=one.number_or_nothing("psnr_db"),
        ssim=one.number_or_nothing("ssim"),
    )


def _require_known_version(provenance: _Fields) -> None:
    written = provenance.text("eldata")
    if _release(written) > _release(__version__):
        provenance.refuse("eldata", f"must be {__version__} or older, or this version may misread it; update", written)


def _release(version: str) -> tuple[int, ...]:
    """Return major and minor version; (0,) for what is not a version."""
    parts = version.split(".")[:2]
    return tuple(int(part) for part in parts) if all(part.isdecimal() for part in parts) else (0,)


# --- reading ------------------------------------------------------------------------------------------------------


def _parsed(path: Path) -> object:
    try:
        return json.loads(path.read_text(encoding="utf-8"), parse_constant=_refuse_constant)
    except OSError as error:
        raise FileError(path, f"cannot be read: {error.strerror or error}") from error
    except json.JSONDecodeError as error:
        reason = f"is not whole JSON ({error.msg} in line {error.lineno}); {_AGAIN}"
        raise FileError(path, reason) from error
    except UnicodeDecodeError as error:
        raise FileError(path, f"is not text in UTF-8, so not JSON; {_AGAIN}") from error
    except (ValueError, RecursionError) as error:
        reason = str(error) if isinstance(error, ValueError) else "it is nested too deeply"
        raise FileError(path, f"is not JSON of eldata evaluate: {reason}; {_AGAIN}") from error


def _refuse_constant(name: str) -> NoReturn:
    raise ValueError(f"found {name}, which JSON does not have")


def _found(value: object) -> str:
    """Return a value as a message shows it."""
    kinds = {dict: "an object", list: "a list", type(None): "null"}
    text = kinds.get(type(value), repr(value))
    return text if len(text) <= 60 else f"{text[:57]}..."


class _Fields:
    """An object of the JSON whose fields are read with checks; errors name the file and the field."""

    def __init__(self, source: Path | str, prefix: str, values: object) -> None:
        self._source = source
        self._prefix = prefix
        if not isinstance(values, dict):
            name = prefix.rstrip(".") or "the result"
            raise FileError(source, f"field {name} must be an object; found {_found(values)}; {_AGAIN}")
        self.values: dict[str, Any] = values

    def refuse(self, name: str, expected: str, found: object) -> NoReturn:
        raise FileError(self._source, f"field {self._prefix}{name} {expected}; found {_found(found)}")

    def get(self, name: str) -> Any:
        if name not in self.values:
            reason = f"is not a result of eldata evaluate, or not a whole one: field {self._prefix}{name} is missing"
            raise FileError(self._source, f"{reason}; {_AGAIN}")
        return self.values[name]

    def text(self, name: str) -> str:
        return self._of(name, str, "must be a text")

    def texts(self, name: str) -> tuple[str, ...]:
        values = self._of(name, list, "must be a list of texts")
        for index, value in enumerate(values):
            if not isinstance(value, str):
                self.refuse(f"{name}[{index}]", "must be a text", value)
        return tuple(values)

    def fields(self, name: str) -> _Fields:
        return _Fields(self._source, f"{self._prefix}{name}.", self.get(name))

    def each(self, name: str) -> list[_Fields]:
        values = self._of(name, list, "must be a list")
        return [_Fields(self._source, f"{self._prefix}{name}[{index}].", value) for index, value in enumerate(values)]

    def count(self, name: str) -> int:
        value = self.get(name)
        if type(value) is not int or value < 0:
            self.refuse(name, "must be a whole number of 0 or more", value)
        return int(value)

    def number(self, name: str, *, at_least: float) -> float:
        value = self.get(name)
        number = _number(value)
        if number is None or not math.isfinite(number) or number < at_least:
            self.refuse(name, f"must be a number of {at_least:g} or more", value)
        return number

    def number_or_nothing(self, name: str) -> float:
        """Return a number, an infinity that is written as text, or nan for null."""
        value = self.get(name)
        if value is None:
            return math.nan
        number = float(value) if value in ("inf", "-inf") else _number(value)
        if number is None:
            self.refuse(name, 'must be a number, the text "inf" or null', value)
        return number

    def _of(self, name: str, kind: type[Value], expected: str) -> Value:
        value = self.get(name)
        if not isinstance(value, kind):
            self.refuse(name, expected, value)
        return value


def _number(value: object) -> float | None:
    """Return a JSON number as float; ``None`` for anything else, and for what no float holds."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if math.isfinite(number) else None  # 1e999 is read as infinity
