"""Pairs whose sides are raw or sRGB: the paper's RGB2RGB and Raw2RGB, from any dataset of packed pairs.

A stage turns one side of a pair, packed and normalised, into what a network reads or is compared with; it gets the
sensors of both files. Raw2Raw + ISP needs no stage: train on the pairs themselves and render the predictions.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from torch.utils.data import Dataset

from eldata.base.visible import name_of
from eldata.errors import ArgumentError, DatasetError
from eldata.isp.rendering import PAPER_GAMMA, Rendering, truncate_to_8_bits
from eldata.sources.frames import FrameSource

if TYPE_CHECKING:
    import torch

    from eldata.isp.rendering import Response
    from eldata.records import Sensor


@dataclass(frozen=True, slots=True)
class PairSensors:
    """What the two files of a pair say of their sensor; synthetic noise has the clean file's for both."""

    noisy: Sensor
    reference: Sensor


Stage = Callable[["torch.Tensor", PairSensors], "torch.Tensor"]
SensorsOf = Callable[[Mapping[str, Any]], PairSensors]


# --- stages -------------------------------------------------------------------------------------------------------


def keep_raw(image: torch.Tensor, sensors: PairSensors) -> torch.Tensor:  # noqa: ARG001 # a Stage
    """Return the packed image as it is."""
    return image


def of_noisy(sensors: PairSensors) -> Sensor:
    """Return the noisy file's sensor: the white balance that the camera found in the dark."""
    return sensors.noisy


def of_reference(sensors: PairSensors) -> Sensor:
    """Return the reference's sensor: the white balance that the camera found in the light."""
    return sensors.reference


def eight_bits(image: torch.Tensor) -> torch.Tensor:
    """Return the image with the 256 values of an 8-bit picture, cut down to them as in the ELD code."""
    return truncate_to_8_bits(image).to(image.dtype) / 255


def continuous(image: torch.Tensor) -> torch.Tensor:
    """Return the image as it is: no 8 bits."""
    return image


@dataclass(frozen=True, slots=True)
class Rendered:
    """A stage that renders to sRGB (:class:`~eldata.isp.rendering.Rendering`).

    Attributes
    ----------
    colours
        Whose white balance and matrix: :func:`of_noisy`, :func:`of_reference`, or any function of the pair's sensors.
    response
        Gamma 2.2, or a measured curve.
    levels
        What becomes of the values: :func:`eight_bits`, as published, or :func:`continuous`.
    """

    colours: Callable[[PairSensors], Sensor]
    response: Response = PAPER_GAMMA
    levels: Callable[[torch.Tensor], torch.Tensor] = eight_bits

    def __call__(self, image: torch.Tensor, sensors: PairSensors) -> torch.Tensor:
        """Return the image (C, h, w) as sRGB (3, h, w) in [0, 1]."""
        return self.levels(Rendering.of(self.colours(sensors), self.response)(image))

    def __repr__(self) -> str:  # without the places in memory of functions: a training is known by it when it goes on
        return f"Rendered({name_of(self.colours)}, {self.response!r}, {name_of(self.levels)})"


# --- where sensors come from --------------------------------------------------------------------------------------


class SourceSensors:
    """Sensors of the frames that a sample names, each frame opened once and remembered.

    Parameters
    ----------
    source
        Where the frames come from.

    Notes
    -----
    A sample without ``reference`` is synthetic: both sensors are those of ``path``. A ``path`` that is not a raw file
    (a packed array) takes its reference's. The first sample of a raw file decodes that file once more.
    """

    def __init__(self, source: FrameSource) -> None:
        self.source = source
        self._known: dict[str, Sensor] = {}

    def __call__(self, sample: Mapping[str, Any]) -> PairSensors:
        """Return the sensors of a sample.

        Raises
        ------
        FileError
            If a file cannot be read.
        DatasetError
            If the source does not hold a frame, or no file states its sensor.
        """
        path, reference = sample["path"], sample.get("reference", sample["path"])
        noisy = reference if path.endswith(".npy") else path
        return PairSensors(self._find_sensor(noisy), self._find_sensor(reference))

    def _find_sensor(self, path: str) -> Sensor:
        """Find the sensor of a raw file, opened once; refuse other files."""
        if path not in self._known:
            sensor = self.source.frame(path).sensor
            if sensor is None:
                raise DatasetError(f"{path}: is not a raw file, whose sensor a stage needs")
            self._known[path] = sensor
        return self._known[path]


def sensors_of(pairs: object) -> SensorsOf:
    """Find the sensors of a dataset's samples: by its source, such as a store or raw files.

    Raises
    ------
    ArgumentError
        If the dataset has none: give ``sensors`` yourself.
    """
    source = getattr(pairs, "source", None)
    origin = getattr(source, "origin", source)
    if isinstance(origin, FrameSource):
        return SourceSensors(origin)
    raise ArgumentError(
        f"the sensors of {type(pairs).__name__} are not known; give sensors=, a function of the sample that returns "
        "PairSensors"
    )


# --- the dataset --------------------------------------------------------------------------------------------------


class StagedPairs(Dataset[dict[str, Any]]):
    """Pairs with a stage applied to each side: ``dataset[i]`` is the sample with other ``input`` and ``target``.

    Parameters
    ----------
    pairs
        A dataset of packed pairs: :class:`~eldata.datasets.base.PairDataset` (ELD, SID),
        :class:`~eldata.datasets.packed.PackedStore`, :class:`~eldata.datasets.synthetic.pairs.SyntheticPairs`, or one
        of your own whose samples are dicts with ``input`` and ``target`` (C, h, w).
    stage_in, stage_out
        Functions of (image, :class:`PairSensors`) for input and target: :func:`keep_raw`, :class:`Rendered`, your own.
    sensors
        Function of the sample that returns its :class:`PairSensors`. Default: :func:`sensors_of` the dataset.

    Raises
    ------
    ArgumentError
        If ``sensors`` is not given and the dataset does not say where they are.

    Notes
    -----
    Stages work pixel by pixel on packed data, so crops and orientations of the wrapped dataset stay what they are. For
    a DataLoader that spawns its workers, stages must be functions or objects that can be pickled.
    """

    def __init__(
        self, pairs: Dataset[Any], *, stage_in: Stage, stage_out: Stage, sensors: SensorsOf | None = None
    ) -> None:
        self.pairs = pairs
        self.stage_in = stage_in
        self.stage_out = stage_out
        self.sensors = sensors_of(pairs) if sensors is None else sensors

    def __len__(self) -> int:
        return len(self.pairs)  # type: ignore[arg-type] # torch's Dataset does not declare it

    def __iter__(self) -> Iterator[dict[str, Any]]:
        return (self[index] for index in range(len(self)))

    def __getitem__(self, index: int) -> dict[str, Any]:
        """Take one pair and apply the stages; raises like the wrapped dataset and its stages.

        Raises
        ------
        ArgumentError
            If a stage needs a white balance or matrix that the sensor does not have.
        """
        sample = self.pairs[index]
        sensors = self.sensors(sample)
        sides = {"input": self.stage_in(sample["input"], sensors), "target": self.stage_out(sample["target"], sensors)}
        return {**sample, **sides}

    def set_epoch(self, epoch: int) -> None:
        """Choose the epoch of the wrapped dataset, if it has epochs."""
        choose = getattr(self.pairs, "set_epoch", None)
        if choose is None:
            raise ArgumentError(f"{type(self.pairs).__name__} has no epochs")
        choose(epoch)

    def __repr__(self) -> str:
        return f"StagedPairs({self.pairs!r}, stage_in={name_of(self.stage_in)}, stage_out={name_of(self.stage_out)})"


def raw2rgb(pairs: Dataset[Any], *, response: Response = PAPER_GAMMA, sensors: SensorsOf | None = None) -> StagedPairs:
    """Return pairs of a packed raw input and an sRGB target, rendered with the reference's colours, in 8-bit levels."""
    return StagedPairs(pairs, stage_in=keep_raw, stage_out=Rendered(of_reference, response), sensors=sensors)


def rgb2rgb(
    pairs: Dataset[Any],
    *,
    response: Response = PAPER_GAMMA,
    input_colours: Callable[[PairSensors], Sensor] = of_noisy,
    sensors: SensorsOf | None = None,
) -> StagedPairs:
    """Return pairs of sRGB images in 8-bit levels.

    Each side is rendered with its own file's white balance and matrix, the default of the ELD code; with
    ``input_colours=of_reference`` both with the reference's, which is that code's ``gt_wb``.
    """
    return StagedPairs(
        pairs, stage_in=Rendered(input_colours, response), stage_out=Rendered(of_reference, response), sensors=sensors
    )
