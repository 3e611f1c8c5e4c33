"""A function of images over a large image in tiles, as if it had seen the whole.

Tiles overlap. Of the overlap an outer quarter on each side is thrown away, where a network sees the tile's edge; over
the half between them one tile fades into the next. So a network whose field of view reaches no further than a quarter
of the overlap gives what it gives of the whole image.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from eldata.errors import ArgumentError

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Values = NDArray[np.floating[Any]]


def tiled(
    function: Callable[[NDArray[np.float32]], Values],
    image: NDArray[np.float32],
    *,
    tile: int,
    overlap: int,
    multiple: int,
) -> NDArray[np.float32]:
    """Return ``function(image)``, put together from tiles.

    Parameters
    ----------
    function
        (C, h, w) to (C', h, w), where h and w are multiples of ``multiple``.
    image
        (C, h, w) of any size. It is extended by reflection to whole multiples, and cut again.
    tile
        Side of a tile; 0 takes the whole image at once.
    overlap
        Of neighbouring tiles.
    multiple
        What sides and places of tiles are multiples of, such as 16 for a network that halves its image four times: it
        is not the same network at other places.

    Raises
    ------
    ArgumentError
        If these do not go together, or ``function`` changes the size.

    Examples
    --------
    >>> import numpy as np
    >>> from eldata.baselines import tiled
    >>> image = np.random.default_rng(0).random((4, 100, 150), np.float32)
    >>> np.allclose(tiled(lambda tile: 2 * tile, image, tile=64, overlap=16, multiple=16), 2 * image)
    True
    """
    if multiple < 1 or tile < 0 or overlap < 0:
        raise ArgumentError(f"tile, overlap and multiple are not negative; found {tile}, {overlap}, {multiple}")
    if tile and (tile % multiple or overlap % multiple or 2 * overlap > tile):
        raise ArgumentError(
            f"tile and overlap are multiples of {multiple}, the overlap is at most half of the tile; found {tile} and "
            f"{overlap}"
        )
    _, height, width = image.shape
    whole = _extend_image(image, multiple)
    if not tile or (whole.shape[1] <= tile and whole.shape[2] <= tile):
        return np.ascontiguousarray(_check_size(function(whole), whole)[:, :height, :width], dtype=np.float32)
    rows, columns = (_place_tiles(length, min(tile, length), overlap) for length in whole.shape[1:])
    sides = tuple(min(tile, length) for length in whole.shape[1:])
    total = np.zeros((0, *whole.shape[1:]), np.float32)
    for top, row_weight in zip(rows, _weigh_tiles(rows, sides[0], overlap), strict=True):
        for left, column_weight in zip(columns, _weigh_tiles(columns, sides[1], overlap), strict=True):
            part = np.ascontiguousarray(whole[:, top : top + sides[0], left : left + sides[1]])
            made = _check_size(function(part), part)
            if not len(total):
                total = np.zeros((len(made), *whole.shape[1:]), np.float32)
            place = total[:, top : top + sides[0], left : left + sides[1]]
            weight = np.outer(row_weight, column_weight).astype(np.float32)
            # What has no weight may be anything, NaN too.
            np.add(place, made * weight, out=place, where=weight > 0)
    return np.ascontiguousarray(total[:, :height, :width])


def _extend_image(image: NDArray[np.float32], multiple: int) -> NDArray[np.float32]:
    """Mirror an image (C, h, w) at its lower and right edge, up to multiples of ``multiple`` pixels."""
    height, width = image.shape[1:]
    below, right = -height % multiple, -width % multiple
    if max(below - height, right - width) >= 0:
        raise ArgumentError(f"an image of {image.shape} is too small to be extended to multiples of {multiple}")
    return np.pad(image, ((0, 0), (0, below), (0, right)), mode="reflect") if below or right else image


def _check_size(made: Values, given: Values) -> Values:
    """Refuse a denoised image of another height or width than its input."""
    if made.ndim != 3 or made.shape[1:] != given.shape[1:]:
        raise ArgumentError(
            f"of an image of {given.shape} it made {made.shape}; a denoiser keeps height and width. If it halves its "
            "image k times, give --multiple 2^k"
        )
    return made


def _place_tiles(length: int, tile: int, overlap: int) -> list[int]:
    """List the starts of tiles: as few as reach the end, where the last one ends."""
    places = list(range(0, length - tile, tile - overlap)) if tile < length else []
    return [*places, length - tile]


def _weigh_tiles(places: list[int], tile: int, overlap: int) -> list[Values]:
    """Return the weights of each tile along one side; over all tiles they add up to 1 everywhere."""
    margin = overlap // 4
    fading = overlap - 2 * margin
    rising = np.concatenate([np.zeros(margin), (np.arange(fading) + 0.5) / max(fading, 1)])
    total = np.zeros(places[-1] + tile)
    weights: list[Values] = []
    for place in places:
        weight = np.ones(tile)
        if place != places[0]:
            weight[: rising.size] = rising
        if place != places[-1]:
            weight[tile - rising.size :] *= rising[::-1]
        total[place : place + tile] += weight
        weights.append(weight)
    return [weight / total[place : place + tile] for place, weight in zip(places, weights, strict=True)]
