"""Text files of response curves: tables, the DoRF database, the EMoR models, the curve that the ELD repository holds.

None of these data ship with the package: no licence of DoRF and EMoR is known. They are from Columbia University's CAVE
laboratory (M. D. Grossberg and S. K. Nayar, "Modeling the Space of Camera Response Functions", PAMI 2004).

Layouts
-------
table
    Lines of 2 numbers (irradiance, brightness) or 4 (irradiance, brightness of R, G, B), separated by white space,
    commas or semicolons; ``#`` starts a comment.
DoRF (dorfCurves.txt)
    Six lines per curve: name, kind, ``I =``, the irradiances, ``B =``, the brightnesses.
EMoR (emor.txt, invemor.txt)
    Sections of a label line that ends in ``=`` and lines of numbers: the grid (``E =`` or ``B =``), the mean curve
    (``f0 =`` or ``g0 =``), the components (``h(1)=`` or ``hinv(1)=`` and so on).
published (CRF_SonyA7S2_5.txt)
    Three lines, for R, G and B: brightness at equal steps of irradiance from 0 to 1.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from eldata.base.fields import TextFile
from eldata.base.numbers import number_of
from eldata.errors import ArgumentError, FileError
from eldata.isp.radiometric import CurveModel
from eldata.isp.response import ResponseCurve

if TYPE_CHECKING:
    from numpy.typing import NDArray

_SEPARATORS = re.compile(r"[\s,;]+")
_LABEL = re.compile(r"([A-Za-z]+\d*(?:\(\d+\))?)\s*=")
_DORF_LINES = 6


class ResponseFileError(FileError):
    """A file of response curves cannot be used."""


def read_response_table(path: Path | str) -> ResponseCurve:
    """Read a table of two columns (one curve) or four (a curve each for R, G, B).

    Raises
    ------
    ResponseFileError
        If the file is missing, not text, has lines of other lengths, or the curve does not rise from 0 to 1.
    """
    path = Path(path)
    rows = [_numbers(path, number, line) for number, line in _lines(path)]
    widths = {len(row) for row in rows}
    if widths not in ({2}, {4}):
        raise ResponseFileError(
            path,
            "expected lines of 2 numbers (irradiance, brightness) or 4 (irradiance, brightness of R, G, B); found "
            f"{'no line of numbers' if not rows else f'lines of {sorted(widths)} numbers'}",
        )
    columns = np.array(rows).T
    brightness = columns[1:]
    return _curve(path, np.broadcast_to(columns[0], brightness.shape), brightness, path.stem)


def write_response_table(path: Path | str, curve: ResponseCurve) -> None:
    """Write a curve as a table that :func:`read_response_table` gives back equal; whole or not at all.

    Raises
    ------
    ArgumentError
        If the three curves have different irradiances: a table has one column of them.
    EldataError
        If the file cannot be written.
    """
    from eldata.base.files import write_text

    if (curve.irradiance != curve.irradiance[0]).any():
        raise ArgumentError(f"{curve.name}: the curves of R, G and B have different irradiances; write each by itself")
    columns = np.vstack([curve.irradiance[:1], curve.brightness]).T
    head = "# irradiance brightness" if len(curve.brightness) == 1 else "# irradiance red green blue"
    lines = [head, *(" ".join(repr(float(value)) for value in row) for row in columns)]
    write_text(path, "\n".join(lines) + "\n")


def read_published_response(path: Path | str) -> ResponseCurve:
    """Read a curve in the layout of the ELD repository's ``EMoR/CRF_SonyA7S2_5.txt``, that of the paper.

    Raises
    ------
    ResponseFileError
        If the file is missing, not text, has not three lines of one length, or a curve does not rise from 0 to 1.
    """
    path = Path(path)
    rows = [_numbers(path, number, line) for number, line in _lines(path)]
    if len(rows) != 3 or len({len(row) for row in rows}) != 1:
        raise ResponseFileError(
            path,
            "expected three lines of one length (brightness of R, G and B at equal steps of irradiance); found lines "
            f"of {[len(row) for row in rows][:6]} numbers",
        )
    brightness = np.array(rows)
    irradiance = np.broadcast_to(np.linspace(0, 1, brightness.shape[1]), brightness.shape)
    return _curve(path, irradiance, brightness, path.stem)


def read_dorf(path: Path | str) -> tuple[ResponseCurve, ...]:
    """Read every curve of a DoRF file, such as ``dorfCurves.txt`` with its 201; ``name`` is the file's.

    Raises
    ------
    ResponseFileError
        If the file is missing, not text, cut short, or a curve does not rise from 0 to 1; the message says which line.
    """
    path = Path(path)
    lines = _lines(path, comments=False)
    if not lines or len(lines) % _DORF_LINES:
        raise ResponseFileError(
            path, f"expected six lines per curve; found {len(lines)} lines: cut short, or a different layout"
        )
    curves = []
    for at in range(0, len(lines), _DORF_LINES):
        (_, name), _kind, (i_line, i_label), (e_line, e), (b_label_line, b_label), (b_line, b) = lines[
            at : at + _DORF_LINES
        ]
        for number, label, wanted in ((i_line, i_label, "I"), (b_label_line, b_label, "B")):
            if _label(label) != wanted:
                raise ResponseFileError(path, f"line {number}: expected the label '{wanted} ='; found {label[:40]!r}")
        irradiance, brightness = _numbers(path, e_line, e), _numbers(path, b_line, b)
        curves.append(_curve(path, np.array(irradiance), np.array(brightness), name))
    return tuple(curves)


def read_curve_model(path: Path | str) -> CurveModel:
    """Read an EMoR model: ``emor.txt`` (responses) or ``invemor.txt`` (their inverses).

    Raises
    ------
    ResponseFileError
        If the file is missing, not text, cut short, its sections are not grid, mean and components of one length, or
        the mean curve does not rise from 0 to 1.
    """
    path = Path(path)
    sections: list[tuple[str, list[float]]] = []
    for number, line in _lines(path, comments=False):
        label = _label(line)
        if label is not None:
            sections.append((label, []))
        elif not sections:
            raise ResponseFileError(path, f"line {number}: expected a label such as 'E ='; found {line[:40]!r}")
        else:
            sections[-1][1].extend(_numbers(path, number, line))
    labels, lengths = [label for label, _ in sections], [len(values) for _, values in sections]
    inverse = labels[:2] == ["B", "g0"]
    stem = "hinv" if inverse else "h"
    wanted = [*(("B", "g0") if inverse else ("E", "f0")), *(f"{stem}({n})" for n in range(1, len(labels) - 1))]
    if len(labels) < 3 or labels != wanted:
        raise ResponseFileError(
            path,
            "expected the sections E, f0, h(1) ... (emor.txt) or B, g0, hinv(1) ... (invemor.txt); found "
            f"{', '.join(labels[:6]) or 'none'}",
        )
    if len(set(lengths)) != 1:
        odd = next(at for at, length in enumerate(lengths) if length != lengths[0])
        raise ResponseFileError(
            path,
            f"section {labels[odd]} has {lengths[odd]} numbers, but {labels[0]} has {lengths[0]}; is the file whole?",
        )
    values = np.array([section for _, section in sections])
    try:
        return CurveModel(values[0], values[1], values[2:], inverse=inverse, name=path.stem)
    except ArgumentError as error:
        raise ResponseFileError(path, str(error)) from error


def _lines(path: Path, *, comments: bool = True) -> list[tuple[int, str]]:
    """Return the lines that hold something, with their numbers from 1."""
    text = TextFile(path, ResponseFileError).text("a text file of response curves")
    stripped = [(line.partition("#")[0] if comments else line).strip() for line in text.splitlines()]
    return [(number, line) for number, line in enumerate(stripped, 1) if line]


def _label(line: str) -> str | None:
    match = _LABEL.fullmatch(line)
    return match[1] if match else None


def _numbers(path: Path, number: int, line: str) -> list[float]:
    values = []
    for text in _SEPARATORS.split(line):
        try:
            values.append(number_of(text))
        except ArgumentError as error:
            raise ResponseFileError(path, f"line {number}: {error}") from error
    return values


def _curve(path: Path, irradiance: NDArray[np.float64], brightness: NDArray[np.float64], name: str) -> ResponseCurve:
    try:
        return ResponseCurve(irradiance, brightness, name)
    except ArgumentError as error:
        raise ResponseFileError(path, str(error)) from error
