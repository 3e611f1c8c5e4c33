"""What the predictions for one reference share: the job, the reference and each noisy frame, decoded once."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar, get_args

from eldata.errors import ArgumentError, DatasetError, EldataError, RawFileError, ShadingError
from eldata.evaluation.pairs import Pair, amplified_by
from eldata.evaluation.references import less_shading, levels_dn, normalised_frame
from eldata.noise.dark_shading import dark_shading_in
from eldata.protocols.protocol import NO_SHADING, Amplification
from eldata.raw.levels import with_levels

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    from eldata.evaluation.originals import Originals
    from eldata.evaluation.tasks import Task
    from eldata.noise.dark_shading import DarkShading
    from eldata.protocols.protocol import Protocol
    from eldata.records import RawFrame

Value = TypeVar("Value")


@dataclass(frozen=True, slots=True)
class ScoringJob:
    """What all units share: where predictions' paths begin, the dataset's frames, protocols, threads of a unit.

    ``dark_shading``: the file of what is taken off inputs. ``task``: one of the user's own, if one is wanted.
    """

    start: Path
    originals: Originals
    protocols: tuple[Protocol, ...]
    threads: int | None
    dark_shading: Path | None = None
    task: Task | None = None

    @property
    def shading(self) -> DarkShading | None:
        """The dark shading, which is the one that the protocols state."""
        stated, path = self.protocols[0].dark_shading, self.dark_shading
        if path is None and stated != NO_SHADING:
            raise ArgumentError(f"the inputs are less the dark shading {stated}; its file is needed to show them")
        found = None if path is None else dark_shading_in(path)
        if path is not None and found is not None and found.digest != stated:
            raise ShadingError(path, f"is {found.digest}, and was {stated} as the evaluation began: was it replaced?")
        return found


class Shared:
    """Values that are computed when they are first asked for; what that raises is raised each time."""

    def __init__(self) -> None:
        self._values: dict[Hashable, Any] = {}

    def get(self, key: Hashable, compute: Callable[[], Value]) -> Value:
        """Return the value of a key, computed if it is the first time."""
        if key not in self._values:
            try:
                self._values[key] = compute()
            except EldataError as error:
                self._values[key] = error
        value = self._values[key]
        if isinstance(value, EldataError):
            raise value
        return value  # type: ignore[no-any-return] # of the key's kind


class Reference:
    """A reference, decoded once, as each protocol takes it."""

    def __init__(self, originals: Originals, path: str) -> None:
        self._originals, self._path = originals, path
        self._shared = Shared()

    @property
    def frame(self) -> RawFrame:
        """The decoded file."""
        return self._shared.get("frame", lambda: self._originals.raw(self._path))

    def lacks_channel_whites(self, protocol: Protocol) -> bool:
        """Return whether a protocol takes the white level of each channel and LibRaw has none."""
        return protocol.levels == "metadata-per-channel" and self.frame.channel_white_levels_dn is None

    def white_levels_dn(self, protocol: Protocol) -> tuple[float, float] | None:
        """Return the white level that the file states, and the constant that a protocol has in its place, if any."""
        if protocol.pixels != "packed" or protocol.levels in ("metadata", "metadata-per-channel"):
            return None
        sensor = self.frame.sensor
        return sensor.white_level_dn, with_levels(sensor, protocol.frame_levels).white_level_dn

    def key(self, protocol: Protocol) -> Hashable:
        """Return what decides :meth:`target`: of levels the numbers, since two choices may come to the same."""
        if protocol.pixels != "packed":
            return protocol.pixels
        return levels_dn(self.frame, protocol.levels), protocol.reference_clip

    def target(self, protocol: Protocol) -> NDArray[Any]:
        """Return what predictions are compared with, (C, h, w) of the whole frame."""
        return self._shared.get(self.key(protocol), lambda: self._target(protocol))

    def _target(self, protocol: Protocol) -> NDArray[Any]:
        if protocol.pixels == "srgb":
            return self._originals.rendered(self._path)
        if protocol.pixels == "rgb":
            return self._originals.rgb(self._path)
        return normalised_frame(self.frame, protocol.levels, clip=protocol.reference_clip)


class NoisyInput:
    """A noisy frame of a pair, decoded once, whatever is scored of it, and when it is first asked for.

    It has to be like its reference.
    """

    def __init__(self, job: ScoringJob, reference: Reference, pair: Pair, path: str) -> None:
        self.path = path
        self._job, self._reference, self._pair, self._shared = job, reference, pair, Shared()

    def amplified(self, protocol: Protocol) -> tuple[Hashable, NDArray[Any]]:
        """Return the amplified noisy input as a protocol has it, and what decides it."""
        if protocol.pixels == "rgb":  # amplified by its authors
            return "input", self._shared.get("input", lambda: self._job.originals.rgb(self.path))
        ratio = self._ratio(protocol.amplification)
        key = ("input", levels_dn(self.frame, protocol.levels), protocol.input_clip, ratio)
        clip = protocol.input_clip
        return key, self._shared.get(
            key, lambda: normalised_frame(self._corrected, protocol.levels, clip=clip, gain=ratio)
        )

    @property
    def _corrected(self) -> RawFrame:
        """The noisy frame, less the dark shading where there is one."""
        shading = self._job.shading
        return self.frame if shading is None else self._shared.get("corrected", partial(self._less, shading))

    def _less(self, shading: DarkShading) -> RawFrame:
        noisy = self.frame
        with file_problem_of(self.path):
            return less_shading(noisy, shading, self.path)

    @property
    def frame(self) -> RawFrame:
        """The decoded file."""
        return self._shared.get("noisy", self._read)

    def _read(self) -> RawFrame:
        noisy, clean = self._job.originals.raw(self.path), self._reference.frame
        if noisy.mosaic.shape != clean.mosaic.shape or noisy.sensor.cfa != clean.sensor.cfa:
            raise RawFileError(
                self._job.originals.place(self.path),
                f"expected {clean.mosaic.shape} pixels with CFA {clean.sensor.cfa} like its reference, found "
                f"{noisy.mosaic.shape} with {noisy.sensor.cfa}",
            )
        return noisy

    def _ratio(self, amplification: Amplification) -> float:
        """Return what the input is multiplied by; windows of clips have no ratio but the files'."""
        from eldata.raw.reading import exposure_ratio

        stated = amplified_by(self._pair, amplification)
        return float(exposure_ratio(self._reference.frame, self.frame)) if stated is None else stated

    def equal_ratios(self, protocol: Protocol) -> frozenset[str]:
        """Return the choices of amplification that come to the protocol's own."""
        taken = self._ratio(protocol.amplification)

        def is_equal(amplification: Amplification) -> bool:
            try:
                return self._ratio(amplification) == taken
            except (RawFileError, DatasetError):  # a file that states no exposure; no measured ratio
                return False

        return frozenset(filter(is_equal, get_args(Amplification)))


@contextmanager
def file_problem_of(path: str) -> Iterator[None]:
    """Make what a dark shading has against a noisy file a problem of that file."""
    try:
        yield
    except DatasetError as error:
        raise RawFileError(path, str(error).removeprefix(f"{path}: ")) from error
