"""Scores of images and of windows of clips, what keeps others from being scored, and their means."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

from eldata.base.visible import in_line

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence

    from eldata.protocols.kinds import Kind


@dataclass(frozen=True, slots=True)
class EvaluationProblem:
    """Something that kept a prediction from being scored, or that should not lie where it lies."""

    path: str
    reason: str

    def __str__(self) -> str:
        return in_line(f"{self.path}: {self.reason}")


class Valued:
    """Numbers by name, ``values``, of which the usual ones are attributes too."""

    __slots__ = ()
    values: Mapping[str, float]

    @property
    def psnr_db(self) -> float:
        """PSNR in dB; infinite where a prediction equals its reference."""
        return self.values["psnr_db"]

    @property
    def ssim(self) -> float:
        """Structural similarity."""
        return self.values["ssim"]

    @property
    def st_rred(self) -> float:
        """ST-RRED of clips; lower is better."""
        return self.values["st_rred"]

    @property
    def spatial_rred(self) -> float:
        """The spatial part of ST-RRED."""
        return self.values["spatial_rred"]

    @property
    def temporal_rred(self) -> float:
        """The temporal part of ST-RRED."""
        return self.values["temporal_rred"]

    @property
    def task(self) -> float:
        """The value of a task of the user's own, where one was asked for."""
        return self.values["task"]

    @property
    def rescale(self) -> float:
        """The factor that the protocol multiplied a prediction by; 1 if it does not rescale."""
        return self.values["rescale"]


@dataclass(frozen=True, slots=True)
class FrameScore:
    """Scores of one frame of a clip; ``path`` is the noisy frame's, ``rescale`` the factor that it was given."""

    path: str
    psnr_db: float
    ssim: float
    rescale: float


@dataclass(frozen=True, slots=True)
class UnitScore(Valued):
    """Scores of one prediction: of an image, or of the window of a clip.

    Attributes
    ----------
    path, camera, scene
        Of the noisy frame; of a clip's first scored one.
    iso
        0 where it is not known.
    ratio
        The nominal low-light factor; ``None`` where the manifest states none.
    values
        The numbers of the protocol's kind (:attr:`eldata.protocols.kinds.Kind.values`); those of a clip are means over
        its frames, and ST-RRED's. Infinite PSNR: the prediction equals the reference. nan: not known.
    split, start, frames
        Of a clip: its split, the position of the first scored frame, the scores of each.
    """

    path: str
    camera: str
    scene: str
    iso: float
    ratio: float | None
    values: dict[str, float] = field(hash=False)
    split: str = ""
    start: int = 0
    frames: tuple[FrameScore, ...] = ()

    @property
    def place(self) -> tuple[str, str]:
        """Camera and scene."""
        return self.camera, self.scene

    @property
    def name(self) -> str:
        """What a person calls it: the path of an image, the number of a clip."""
        return self.scene if self.frames else self.path

    def row(self, kind: Kind) -> dict[str, Any]:
        """Return the columns of its kind's CSV; ``frames`` is their number."""
        facts = self.values | {"frames": len(self.frames)}
        return {name: facts[name] if name in facts else getattr(self, name) for name in kind.columns}

    def as_dict(self, kind: Kind) -> dict[str, Any]:
        """Return the same, of a clip with the scores of each frame."""
        more = {"frame_scores": [asdict(frame) for frame in self.frames]} if self.frames else {}
        return self.row(kind) | more


def mean(values: Collection[float]) -> float:
    """Return the mean, summed exactly; nan of nothing."""
    return math.fsum(values) / len(values) if values else math.nan


def means(scores: Sequence[UnitScore], names: Iterable[str]) -> dict[str, float]:
    """Return the mean of each value of these names."""
    return {name: mean([score.values[name] for score in scores]) for name in names}


def json_object(values: dict[str, Any]) -> dict[str, Any]:
    """Return plain types as JSON has them: nan as ``None``, infinities as text."""
    return {key: _json_safe(value) for key, value in values.items()}


def _json_safe(value: Any) -> Any:
    if isinstance(value, dict):
        return json_object(value)
    if isinstance(value, (list, tuple)):
        return [_json_safe(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else str(value)
    return value


def csv_number(value: object) -> object:
    """Return a value as a CSV cell: 800, not 800.0; repr of any other float reads back the same."""
    return int(value) if isinstance(value, float) and value.is_integer() else value


def finite_values(scores: Iterable[UnitScore], name: str) -> tuple[float, ...]:
    """Return a value, such as ``psnr_db``, of the scores in which it is finite."""
    return tuple(score.values[name] for score in scores if math.isfinite(score.values[name]))
