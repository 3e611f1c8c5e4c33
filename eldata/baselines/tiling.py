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
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    Values = NDArray[np.floating[Any]]
    Read = Callable[[slice, slice], NDArray[np.float32]]


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
    parts = tile_bands(
        function, lambda rows, columns: image[:, rows, columns], image.shape[1:], tile=tile, overlap=overlap,
        multiple=multiple,
    )  # fmt: skip
    return np.concatenate(list(parts), axis=1)


def tile_bands(
    function: Callable[[NDArray[np.float32]], Values], read: Read, shape: tuple[int, ...], *,
    tile: int, overlap: int, multiple: int,
) -> Iterator[NDArray[np.float32]]:  # fmt: skip
    """Yield what :func:`tiled` returns in bands of rows, from top to bottom; no more than a row of tiles is held.

    Parameters
    ----------
    function, tile, overlap, multiple
        As there.
    read
        Of rows and columns: that part of the image, (C, rows, columns). Tiles begin at multiples of ``multiple``.
    shape
        (h, w) of the image.
    """
    if multiple < 1 or tile < 0 or overlap < 0:
        raise ArgumentError(f"tile, overlap and multiple are not negative; found {tile}, {overlap}, {multiple}")
    if tile and (tile % multiple or overlap % multiple or 2 * overlap > tile):
        raise ArgumentError(
            f"tile and overlap are multiples of {multiple}, the overlap is at most half of the tile; found {tile} and "
            f"{overlap}"
        )
    height, width = shape
    whole = tuple(side + -side % multiple for side in shape)
    if any(side < 1 or length - side >= side for side, length in zip(shape, whole, strict=True)):
        raise ArgumentError(f"an image of {shape} is too small to be extended to multiples of {multiple}")
    tall, wide = (min(tile or length, length) for length in whole)
    rows, columns = _place_tiles(whole[0], tall, overlap), _place_tiles(whole[1], wide, overlap)
    total = np.zeros((0, tall, whole[1]), np.float32)
    for top, below, row_weight in zip(rows, [*rows[1:], whole[0]], _weigh_tiles(rows, tall, overlap), strict=True):
        for left, column_weight in zip(columns, _weigh_tiles(columns, wide, overlap), strict=True):
            part = _read_tile(read, shape, (top, left), (tall, wide), multiple)
            made = function(part)
            if made.ndim != 3 or made.shape[1:] != part.shape[1:]:
                raise ArgumentError(
                    f"of an image of {part.shape} it made {made.shape}; a denoiser keeps height and width. If it "
                    "halves its image k times, give --multiple 2^k"
                )
            if not len(total):
                total = np.zeros((len(made), *total.shape[1:]), np.float32)
            place = total[:, :, left : left + wide]
            weight = np.outer(row_weight, column_weight).astype(np.float32)
            # What has no weight may be anything, NaN too.
            np.add(place, made * weight, out=place, where=weight > 0)
        done = below - top
        yield total[:, : min(done, height - top), :width].copy()
        total[:, : tall - done] = total[:, done:]  # the next row of tiles fades in there
        total[:, tall - done :] = 0


def _read_tile(
    read: Read, shape: tuple[int, ...], place: tuple[int, int], sides: tuple[int, int], multiple: int
) -> NDArray[np.float32]:
    """Read a tile; beyond the lower and right edge the image is mirrored, up to a multiple of pixels."""
    # A tile of the last pixels alone would not hold what is mirrored.
    begins = [max(0, min(first, length - multiple)) for first, length in zip(place, shape, strict=True)]
    ends = [min(first + side, length) for first, side, length in zip(place, sides, shape, strict=True)]
    part = read(*(slice(begin, end) for begin, end in zip(begins, ends, strict=True)))
    missing = [(0, first + side - end) for first, side, end in zip(place, sides, ends, strict=True)]
    if any(map(any, missing)):
        part = np.pad(part, ((0, 0), *missing), mode="reflect")
    top, left = (first - begin for first, begin in zip(place, begins, strict=True))
    return np.ascontiguousarray(part[:, top:, left:])


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
