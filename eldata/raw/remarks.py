"""What should be known of a raw file that is read rightly: sentences that say what was, or was not, done with it.

A remark is not a problem: ``read_raw`` gives them with the frame, and ``eldata verify`` says each once.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from eldata.raw.tiff import OPCODE_LISTS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from eldata.raw.tiff import Directory

# By number, DNG specification 1.7.1, chapter 7.
_OPCODES = (
    *("WarpRectilinear", "WarpFisheye", "FixVignetteRadial", "FixBadPixelsConstant", "FixBadPixelsList"),
    *("TrimBounds", "MapTable", "MapPolynomial", "GainMap", "DeltaPerRow", "DeltaPerColumn", "ScalePerRow"),
    *("ScalePerColumn", "WarpRectilinear2"),
)
_NOT_APPLIED = (
    "the mosaic is what the sensor gave, as stored",
    "the mosaic keeps what they would correct, such as lens shading",
    "they are for a demosaiced image",
)


def directory_remarks(mosaic: Directory | None) -> tuple[str, ...]:
    """Return what there is to say before pixels are decoded; ``mosaic``: the directory whose pixels are read."""
    return () if mosaic is None else (*_of_samples(mosaic), *_of_opcodes(mosaic))


def image_remarks(images: int, image: int) -> tuple[str, ...]:
    """Return what there is to say of a file with several images, of which one, counted from 0, was read."""
    if images == 1:
        return ()
    which = f"the mosaic is image {image}, counted from 0 (read_raw's image= chooses)"
    return (f"it holds {images} images of one size, as of a pixel shift: {which}",)


def _of_samples(mosaic: Directory) -> Iterator[str]:
    if mosaic.samples > 1:
        yield f"it has {mosaic.samples} samples of each pixel, as dual pixels give: the mosaic is the first"


def _of_opcodes(mosaic: Directory) -> Iterator[str]:
    for number, (tag, meaning) in enumerate(zip(OPCODE_LISTS, _NOT_APPLIED, strict=True), 1):
        codes = map(int, mosaic.values.get(tag, ()))
        names = dict.fromkeys(_OPCODES[code - 1] if 0 < code <= len(_OPCODES) else "unknown" for code in codes)
        if names:
            yield f"its OpcodeList{number} ({', '.join(names)}) is not applied: {meaning}"
