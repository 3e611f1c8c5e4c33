"""What an evaluation of clips found: scores per video and frame, their means, and everything that they depend on."""

from __future__ import annotations

import csv
import io
import json
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
    from eldata.manifest.clips import ClipRecord
    from eldata.protocols.video import VideoProtocol

VIDEO_COLUMNS = (
    *("scene", "split", "camera", "start", "frames", "psnr_db", "ssim", "st_rred", "spatial_rred", "temporal_rred"),
    "rescale",
)
_PROBLEMS_SHOWN = 20


@dataclass(frozen=True, slots=True)
class FrameScore:
    """Scores of one frame of a prediction; ``path`` is the noisy frame's, ``rescale`` the factor that it was given."""

    path: str
    psnr_db: float
    ssim: float
    rescale: float


@dataclass(frozen=True, slots=True)
class VideoScore:
    """Scores of one video.

    Attributes
    ----------
    scene, split, camera
        As in the manifest.
    start
        Position of the first scored frame in the clip.
    frames
        Scores of each frame.
    st_rred, spatial_rred, temporal_rred
        As :func:`eldata.metrics.st_rred` gives them.
    """

    scene: str
    split: str
    camera: str
    start: int
    frames: tuple[FrameScore, ...]
    st_rred: float
    spatial_rred: float
    temporal_rred: float

    @property
    def psnr_db(self) -> float:
        """Mean PSNR of the frames in dB; infinite if a frame equals its reference."""
        return mean([frame.psnr_db for frame in self.frames])

    @property
    def ssim(self) -> float:
        """Mean SSIM of the frames."""
        return mean([frame.ssim for frame in self.frames])

    @property
    def rescale(self) -> float:
        """Mean factor of the frames."""
        return mean([frame.rescale for frame in self.frames])

    def row(self) -> dict[str, Any]:
        """Return the columns :data:`VIDEO_COLUMNS`; ``frames`` is their number."""
        return {name: getattr(self, name) for name in VIDEO_COLUMNS} | {"frames": len(self.frames)}


@dataclass(frozen=True, slots=True)
class VideoResult:
    """The result of :func:`eldata.evaluation.evaluate_video`.

    Attributes
    ----------
    protocol
        The protocol of every score.
    provenance
        What the numbers depend on: versions, manifest and its digest, the protocol's digest; subset or ids; the layout
        of the files as found.
    windows
        The windows that the protocol and the subset name, one a video, scored or not.
    videos
        Scores, in the order of the windows.
    missing
        Videos without a usable prediction of each frame.
    problems
        What is wrong. With problems and without ``allow_missing`` nothing was scored.
    notes
        What a reader of the table should know.
    """

    protocol: VideoProtocol
    provenance: dict[str, Any]
    windows: tuple[ClipRecord, ...]
    videos: tuple[VideoScore, ...]
    missing: tuple[str, ...]
    problems: tuple[EvaluationProblem, ...]
    notes: tuple[str, ...]

    @property
    def scored(self) -> int:
        """How many videos were scored."""
        return len(self.videos)

    @property
    def psnr_db(self) -> float:
        """PSNR in dB, mean over videos; nan if nothing was scored."""
        return mean([video.psnr_db for video in self.videos])

    @property
    def ssim(self) -> float:
        """SSIM, mean over videos."""
        return mean([video.ssim for video in self.videos])

    @property
    def st_rred(self) -> float:
        """ST-RRED, mean over videos; lower is better."""
        return mean([video.st_rred for video in self.videos])

    @property
    def frame(self) -> pd.DataFrame:
        """The scores as a pandas DataFrame, one row a video."""
        import pandas as pd

        return pd.DataFrame([video.row() for video in self.videos], columns=list(VIDEO_COLUMNS))

    def format_table(self) -> str:
        """Return the means as the ELD paper prints them: PSNR to two decimals, SSIM and ST-RRED to three."""
        count = str(len(self.videos))
        if len(self.videos) < len(self.windows):
            count += f" of {len(self.windows)}"
        values = (f"{self.psnr_db:.2f}", f"{self.ssim:.3f}", f"{self.st_rred:.3f}") if self.videos else ("-", "-", "-")
        return text_table(("videos", "PSNR [dB]", "SSIM", "ST-RRED"), [(count, *values)])

    def format_text(self) -> str:
        """Return problems, the table with its protocol and coverage, and notes as text."""
        lines = [str(problem) for problem in self.problems[:_PROBLEMS_SHOWN]]
        if len(self.problems) > _PROBLEMS_SHOWN:
            lines.append(f"... and {len(self.problems) - _PROBLEMS_SHOWN} more (--json FILE lists all)")
        if self.problems and not self.videos:
            lines.append(f"nothing was scored: {len(self.problems)} problem{'s' if len(self.problems) > 1 else ''}")
            return "\n".join(lines)
        if lines:
            lines.append("")
        subset, ids = self.provenance["subset"], self.provenance["ids"]
        choice = f"subset {subset}" if ids is None else f"only {', '.join(ids)}"
        coverage = f"{len(self.videos)} of {len(self.windows)} videos"
        lines += [f"{self.provenance['dataset']}, protocol {self.protocol.name}: {coverage}, {choice}", ""]
        lines += [self.format_table(), ""]
        if self.missing:
            lines.append(
                f"INCOMPLETE: {len(self.missing)} videos are not in these means, so they do not compare with others"
            )
        lines += [f"note: {note}" for note in self.notes]
        lines.append(f"{self.protocol.title} ({self.protocol.digest[:15]})")
        return "\n".join(lines)

    def as_dict(self) -> dict[str, Any]:
        """Return everything as plain JSON types; an infinite PSNR is the text ``inf``."""
        result = {
            "protocol": self.protocol.as_dict(),
            "provenance": self.provenance,
            "coverage": {"videos": len(self.windows), "scored": len(self.videos), "missing": list(self.missing)},
            "videos": [
                video.row() | {"frame_scores": [asdict(frame) for frame in video.frames]} for video in self.videos
            ],
            "table": {"psnr_db": self.psnr_db, "ssim": self.ssim, "st_rred": self.st_rred},
            "problems": [asdict(problem) for problem in self.problems],
            "notes": list(self.notes),
        }
        return json_safe(result)  # type: ignore[no-any-return] # a dict stays a dict

    def write_json(self, path: Path | str) -> None:
        """Write :meth:`as_dict` as JSON, whole or not at all."""
        write_text(path, json.dumps(self.as_dict(), indent=2, allow_nan=False) + "\n")

    def write_csv(self, path: Path | str) -> None:
        """Write the scores as CSV, one row a video, with :data:`VIDEO_COLUMNS`, every digit, whole or not at all."""
        text = io.StringIO(newline="")
        writer = csv.writer(text, lineterminator="\n")
        rows: Sequence[dict[str, Any]] = [video.row() for video in self.videos]
        writer.writerows([VIDEO_COLUMNS, *([csv_number(row[name]) for name in VIDEO_COLUMNS] for row in rows)])
        write_text(path, text.getvalue())
