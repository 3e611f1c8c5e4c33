"""What an evaluation found: scores per image, means per group, and everything that they depend on."""

from __future__ import annotations

import csv
import io
import json
from collections import Counter
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from eldata.base.files import write_text
from eldata.base.tables import text_table
from eldata.evaluation.common import csv_number, json_safe, mean

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    import pandas as pd

    from eldata.evaluation.common import EvaluationProblem
    from eldata.protocols import Protocol
    from eldata.records import PairRecord

CSV_COLUMNS = ("path", "camera", "scene", "iso", "ratio", "psnr_db", "ssim", "rescale")
VALUE_NAMES = ("pairs", "PSNR [dB]", "SSIM")

_PROBLEMS_SHOWN = 20


@dataclass(frozen=True, slots=True)
class ImageScore:
    """Scores of one prediction.

    ``ratio`` is the nominal low-light factor, ``psnr_db`` infinite where the prediction equals the reference,
    ``rescale`` the factor that the protocol multiplied the prediction by (1 if it does not rescale).
    """

    path: str
    camera: str
    scene: str
    iso: float
    ratio: float
    psnr_db: float
    ssim: float
    rescale: float


@dataclass(frozen=True, slots=True)
class TableRow:
    """Means over one group of images. ``camera`` or ``ratio`` is ``None`` where the group spans all of them."""

    camera: str | None
    ratio: float | None
    pairs: int
    scored: int
    psnr_db: float
    ssim: float

    @property
    def factor_text(self) -> str:
        """The factor as printed: ``x100``, or ``all``."""
        return "all" if self.ratio is None else f"x{self.ratio:g}"

    @property
    def value_texts(self) -> tuple[str, str, str]:
        """Pairs, PSNR and SSIM as printed (:data:`VALUE_NAMES`); ``-`` where nothing was scored."""
        pairs = str(self.pairs) if self.scored == self.pairs else f"{self.scored} of {self.pairs}"
        return (pairs, f"{self.psnr_db:.2f}", f"{self.ssim:.3f}") if self.scored else (pairs, "-", "-")


@dataclass(frozen=True, slots=True)
class EvaluationResult:
    """The result of :func:`eldata.evaluate`.

    Attributes
    ----------
    protocol
        The protocol of every score.
    provenance
        What the numbers depend on: versions, manifest and its digest, the protocol's digest; cameras, subset, and
        excluded flags with their numbers of pairs.
    pairs
        The pairs that the protocol and the subset name, scored or not.
    images
        Scores, in the order of the pairs.
    missing
        Noisy frames without a usable prediction.
    problems
        What is wrong. With problems and without ``allow_missing`` nothing was scored.
    notes
        What a reader of the table should know.
    """

    protocol: Protocol
    provenance: dict[str, Any]
    pairs: tuple[PairRecord, ...]
    images: tuple[ImageScore, ...]
    missing: tuple[str, ...]
    problems: tuple[EvaluationProblem, ...]
    notes: tuple[str, ...]

    @property
    def scored(self) -> int:
        """How many images were scored."""
        return len(self.images)

    @property
    def frame(self) -> pd.DataFrame:
        """The scores as a pandas DataFrame, one row an image."""
        import pandas as pd

        return pd.DataFrame([asdict(image) for image in self.images], columns=list(CSV_COLUMNS))

    @property
    def table(self) -> tuple[TableRow, ...]:
        """Means: camera by factor, each factor over all cameras, and all."""
        cameras = list(dict.fromkeys(pair.camera for pair in self.pairs))
        ratios = sorted({float(pair.ratio) for pair in self.pairs})
        groups: list[tuple[str | None, float | None]] = [(camera, ratio) for camera in cameras for ratio in ratios]
        if len(cameras) > 1:
            groups += [(None, ratio) for ratio in ratios]
        groups.append((None, None))
        return tuple(row for row in (self._row(*group) for group in groups) if row.pairs)

    def _row(self, camera: str | None, ratio: float | None) -> TableRow:
        def belongs(item: PairRecord | ImageScore) -> bool:
            return (camera is None or item.camera == camera) and (ratio is None or float(item.ratio) == ratio)

        images = [image for image in self.images if belongs(image)]
        return TableRow(
            camera,
            ratio,
            sum(belongs(pair) for pair in self.pairs),
            len(images),
            mean([image.psnr_db for image in images]),
            mean([image.ssim for image in images]),
        )

    def format_table(self) -> str:
        """Return the table as aligned text: PSNR in dB to two decimals, SSIM to three, as the papers print them.

        A set of several cameras has a row for each camera and factor, as in the ELD paper's table; a set of one camera
        has a column for each factor, as in those on SID.
        """
        one_camera = self.provenance["cameras"] == "all" and len({pair.camera for pair in self.pairs}) == 1
        return self._factors_as_columns() if one_camera else self._factors_as_rows()

    def _factors_as_rows(self) -> str:
        rows = []
        previous: str | None = ""
        for row in self.table:
            name = "all" if row.camera is None else row.camera
            rows.append(("" if name == previous else name, row.factor_text, *row.value_texts))
            previous = name
        return text_table(("camera", "factor", *VALUE_NAMES), rows)

    def _factors_as_columns(self) -> str:
        rows = self.table
        header = (rows[0].camera or "", *(row.factor_text for row in rows))
        values = zip(*(row.value_texts for row in rows), strict=True)
        return text_table(header, [(name, *texts) for name, texts in zip(VALUE_NAMES, values, strict=True)])

    def format_text(self) -> str:
        """Return problems, the table with its protocol and coverage, and notes as text."""
        lines = problem_lines(self.problems)
        if self.problems and not self.images:
            lines.append(f"nothing was scored: {len(self.problems)} problem{'s' if len(self.problems) > 1 else ''}")
            return "\n".join(lines)
        if lines:
            lines.append("")
        lines += [f"{self.provenance['dataset']}, protocol {self.protocol.name}: {choice_text(self)}", ""]
        lines += [self.format_table(), ""]
        if self.missing:
            lines.append(
                f"INCOMPLETE: {len(self.missing)} pairs are not in these means, so they do not compare with others"
            )
        lines += [f"note: {note}" for note in self.notes]
        lines.append(f"{self.protocol.title} ({self.protocol.digest[:15]})")
        return "\n".join(lines)

    def as_dict(self) -> dict[str, Any]:
        """Return everything as plain JSON types; an infinite PSNR is the text ``inf``."""
        result = {
            "protocol": self.protocol.as_dict(),
            "provenance": self.provenance,
            "coverage": {"pairs": len(self.pairs), "scored": len(self.images), "missing": list(self.missing)},
            "images": [asdict(image) for image in self.images],
            "table": [asdict(row) for row in self.table],
            "problems": [asdict(problem) for problem in self.problems],
            "notes": list(self.notes),
        }
        return json_safe(result)  # type: ignore[no-any-return] # a dict stays a dict

    def write_json(self, path: Path | str) -> None:
        """Write :meth:`as_dict` as JSON, whole or not at all."""
        write_text(path, json.dumps(self.as_dict(), indent=2, allow_nan=False) + "\n")

    def write_csv(self, path: Path | str) -> None:
        """Write the scores as CSV with the columns :data:`CSV_COLUMNS`, every digit, whole or not at all."""
        text = io.StringIO(newline="")
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(CSV_COLUMNS)
        for image in self.images:
            values = [getattr(image, column) for column in CSV_COLUMNS]
            writer.writerow([csv_number(value) for value in values])
        write_text(path, text.getvalue())


def choice_text(result: EvaluationResult) -> str:
    """Return which pairs of the dataset are scored, as text for a table's first line."""
    cameras, subset = result.provenance["cameras"], result.provenance["subset"]
    parts = [f"{len(result.images)} of {len(result.pairs)} pairs"]
    if cameras != "all":
        parts.append(f"only {', '.join(cameras)}")
    if subset is not None:
        parts.append(f"subset {subset}")
    parts += [f"without {flag} ({count})" for flag, count in result.provenance["excluded_flags"].items()]
    included = Counter(flag for pair in result.pairs for flag in pair.flags)
    parts += [f"{flag} included ({count})" for flag, count in sorted(included.items())]
    return ", ".join(parts)


def problem_lines(problems: Sequence[EvaluationProblem]) -> list[str]:
    """Return problems as lines of text, the first of many."""
    lines = [str(problem) for problem in problems[:_PROBLEMS_SHOWN]]
    if len(problems) > _PROBLEMS_SHOWN:
        lines.append(f"... and {len(problems) - _PROBLEMS_SHOWN} more (--json FILE lists all)")
    return lines
