"""Items to be looked at: rendered quickly, both sides with one stretch, with their difference."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.base.tables import block, facts, picture
from eldata.errors import EldataError
from eldata.isp.rendering import brightening, preview
from eldata.plots.pictures import side_by_side, thumbnail

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    from eldata.plots.axes import Drawing
    from eldata.plots.pictures import Panel
    from eldata.records import Sensor

_THUMBNAIL = 220  # columns or rows


def title_of(sample: Mapping[str, Any]) -> str:
    """Return what a sample says of itself: camera, scene, ISO, ratio and files."""
    facts = [str(sample[name]) for name in ("camera", "scene") if sample.get(name)]
    for name, form in (("iso", "ISO {:g}"), ("ratio", "×{:g}"), ("start", "frame {:g}")):
        value = sample.get(name)
        if value is not None and math.isfinite(value) and (value > 0 or name == "start"):
            facts.append(form.format(value))
    return "\n".join(text for text in (", ".join(facts), str(sample.get("path", ""))) if text)


def panels_of(sample: Mapping[str, Any], sensor: Sensor | None) -> list[Panel]:
    """Return the pictures of a sample: its input, its target if it has one, and the error between them.

    Of a window of frames the first one is shown. Both sides are multiplied by the same number, which makes a dark
    target visible; the error is the mean over channels of the absolute difference, in the sample's own units.
    """
    sides = {name: _first(np.asarray(sample[name])) for name in ("input", "target") if name in sample}
    brighter = brightening(sides.get("target", sides["input"]))
    more = "" if brighter == 1 else f", {brighter:g} times as bright"
    ratio = sample.get("ratio", 1.0)
    names = {"input": f"input ×{ratio:g}" if math.isfinite(ratio) and ratio != 1 else "input", "target": "target"}
    panels: list[Panel] = [(names[side] + more, _rendered(array * brighter, sensor)) for side, array in sides.items()]
    if len(sides) == 2 and sides["input"].shape == sides["target"].shape:
        panels.append(("absolute error, mean of channels", np.abs(sides["input"] - sides["target"]).mean(axis=0)))
    return panels


def drawn_sample(sample: Mapping[str, Any], sensor: Sensor | None) -> Drawing:
    """Return the figure of a sample, which belongs to no pyplot and shows in a notebook."""
    return side_by_side(title_of(sample), panels_of(sample, sensor))


def shown_dataset(
    name: str, outline: Sequence[tuple[str, str]], seen: Callable[[], tuple[dict[str, Any], Sensor | None]] | None
) -> str:
    """Return a dataset as a notebook shows it: what it is, and its first item in small, or why that cannot be read."""
    parts, notes = [facts(outline)], []
    try:
        if seen is not None:
            sample, sensor = seen()
            panels = [panel for panel in panels_of(sample, sensor) if panel[1].ndim == 3]
            parts += [picture(thumbnail(pixels, _THUMBNAIL), text) for text, pixels in panels]
            notes = [f"first item: {line}" for line in title_of(sample).splitlines()[:1]]
    except (EldataError, OSError) as error:
        notes = [f"the first item cannot be shown: {error}"]
    return block(name, *parts, notes=notes)


def _first(array: NDArray[Any]) -> NDArray[Any]:
    """Return (C, h, w) as it is, and of (T, C, h, w) the first frame."""
    return array if array.ndim == 3 else array[0]


def _rendered(values: NDArray[Any], sensor: Sensor | None) -> NDArray[np.uint8]:
    """Return (C, h, w) as 8-bit colours: packed raw as a quick rendering, three colours as they are."""
    if len(values) != 3:
        return preview(values, sensor)
    colours: NDArray[np.uint8] = np.rint(np.clip(values, 0, 1) * 255).astype(np.uint8)
    return colours.transpose(1, 2, 0)
