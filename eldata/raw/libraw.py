"""LibRaw: opening a raw file with it, which of its images and areas it sees, and the CFA that it makes of them.

Fork and threads
----------------
Each read tells the OpenMP runtime inside rawpy's wheel to use the calling thread alone. So no thread pool is
left behind for a forked worker to wait for, and reading is safe in DataLoader workers under fork and spawn.
"""

from __future__ import annotations

import ctypes
import io
import struct
from contextlib import contextmanager
from functools import cache
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

from eldata.errors import RawFileError, UnusableRawError
from eldata.raw.levels import cfa_from, cfa_of_letters, packing_sites
from eldata.raw.tiff import CFA_PATTERN, MOST_PIXELS, SHORT
from eldata.raw.unsupported import unsupported_cfa

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    import rawpy

    from eldata.raw.container import RawContainer
    from eldata.raw.levels import CfaRows
    from eldata.raw.tiff import Directory


@contextmanager
def open_raw(file: RawContainer, what: str = "decode") -> Iterator[rawpy.RawPy]:
    """Open a raw file with LibRaw. Its errors say that it cannot do ``what``.

    Raises
    ------
    RawFileError
        If LibRaw does not know the file or refuses it, then or inside the block.
    """
    import rawpy

    _set_openmp_threads()(1)  # a setting of the calling thread, so it is made for each read
    # Not rawpy.imread: it warns in every forked process, of what the line above removes.
    raw = rawpy.RawPy()
    try:
        content = _mend(file)
        if content is None:
            _open(raw, file.path)
        else:
            raw.open_buffer(io.BytesIO(content))
        yield raw
    except rawpy.LibRawFileUnsupportedError as error:
        raise RawFileError(file.path, "is not a raw file that LibRaw knows") from error
    except rawpy.LibRawError as error:
        reason = error.args[0] if error.args else error
        # "Unsufficient memory" is mostly said of sizes that cannot be, without asking for any.
        text = reason.decode(errors="replace") if isinstance(reason, bytes) else str(reason)
        raise RawFileError(file.path, f"LibRaw cannot {what} it ({text}); is the file whole?") from error
    finally:
        raw.close()


def _mend(file: RawContainer) -> bytes | None:
    """Bytes of a file as LibRaw reads them right; None if it does so as they are.

    It takes the bytes of a CFAPattern's 16-bit numbers for numbers, and strips for rows that follow one another.
    """
    wide = [directory for directory in file.directories if directory.entries.get(CFA_PATTERN, (0, 0))[1] == SHORT]
    rows = None if file.rows is None or file.rows.are_found else file.rows
    if not wide and rows is None:
        return None
    content = bytearray(file.path.read_bytes())
    for directory in wide:
        entry, _ = directory.entries[CFA_PATTERN]
        numbers = bytes(min(int(number), 255) for number in directory.values[CFA_PATTERN])
        struct.pack_into(f"{directory.order}HHI", content, entry, CFA_PATTERN, 1, len(numbers))
        at = entry + 8
        if len(numbers) > 4:
            (at,) = struct.unpack_from(f"{directory.order}I", content, at)
        content[at : at + len(numbers)] = numbers
    return bytes(content) if rows is None else rows.rearrange(content)


def _open(raw: rawpy.RawPy, path: Path) -> None:
    try:
        raw.open_file(str(path))
    except UnicodeEncodeError:  # rawpy knows names in UTF-8 alone
        with path.open("rb") as file:
            raw.open_buffer(file)


@cache
def _set_openmp_threads() -> Callable[[int], object]:
    """Find omp_set_num_threads of the runtime that rawpy's wheel brings; or a function that does nothing."""
    import rawpy

    package = Path(rawpy.__file__).parent
    for library in sorted((package.parent / "rawpy.libs").glob("libgomp*")):
        return ctypes.CDLL(str(library)).omp_set_num_threads
    return lambda _: None


def check_sizes(path: Path, raw: rawpy.RawPy) -> None:
    """Refuse impossible sizes before memory is taken for the pixels."""
    sizes, held = raw.sizes, path.stat().st_size
    raw_pixels = sizes.raw_height * sizes.raw_width
    if held * MOST_PIXELS < raw_pixels:
        raise RawFileError(path, f"truncated: {held} bytes cannot hold {raw_pixels} pixels")
    inside = sizes.top_margin + sizes.height <= sizes.raw_height and sizes.left_margin + sizes.width <= sizes.raw_width
    if not (inside and sizes.height and sizes.width):
        raise RawFileError(
            path,
            f"damaged: its visible area of {sizes.height} x {sizes.width} pixels from {sizes.top_margin}, "
            f"{sizes.left_margin} on does not lie inside its {sizes.raw_height} x {sizes.raw_width} pixels",
        )


def check_one_image(path: Path) -> None:
    """Refuse a file whose directories name no mosaic, if LibRaw knows several images in it: a second one is asked for.

    Raises
    ------
    UnusableRawError
        If it does.
    """
    import rawpy

    raw = rawpy.RawPy()
    try:
        raw.set_unpack_params(shot_select=1)  # before it is opened: which of its images, is chosen then
        _open(raw, path)
        raw.unpack()
    except rawpy.LibRawRequestForNonexistentImageError:
        return
    except rawpy.LibRawError:  # there is one more, whatever is wrong with it
        pass
    finally:
        raw.close()
    advice = "write the one that you need as a DNG of its own (dnglab convert --image-index 0, for example)"
    raise UnusableRawError(path, "holds several images, as of a pixel shift or of dual pixels", advice)


# --- colour filter array ----------------------------------------------------------------------------------------------


def visible_cfa(path: Path, raw: rawpy.RawPy, main: Directory | None) -> tuple[CfaRows, tuple[int, ...]]:
    """Ask for the visible area's CFA in our channel indices, and LibRaw's colour index of each of them."""
    stated = None if main is None else _stated_cfa(raw, main)
    if stated is not None and packing_sites(stated[0]).block > 1:
        return stated
    names = raw.color_desc.decode("ascii", "replace")
    try:
        pattern = raw.raw_pattern
    except NotImplementedError as error:  # what rawpy raises for a CFA that it has no pattern for
        raise RawFileError(path, f"unsupported colour filter array ({error})") from error
    period = 0 if pattern is None else len(pattern)
    top, left = raw.sizes.top_margin, raw.sizes.left_margin
    sites = [[raw.raw_color(top + y, left + x) for x in range(period)] for y in range(period)]
    letters = ["".join(names[index] for index in row) for row in sites]
    cfa = cfa_of_letters(letters)
    if cfa is None:
        raise unsupported_cfa(path, letters)
    libraw_index = dict(zip(chain(*cfa), chain(*sites), strict=True))
    return cfa, tuple(libraw_index[channel] for channel in sorted(libraw_index))


def _stated_cfa(raw: rawpy.RawPy, main: Directory) -> tuple[CfaRows, tuple[int, ...]] | None:
    """CFA as :func:`visible_cfa` has it, from the tags beside the pixels; None if they state none that works."""
    whole, names = cfa_of_letters(main.cfa_letters or ()), raw.color_desc.decode("ascii", "replace")
    if whole is None or not set("RGB") <= set(names):
        return None
    # The pattern starts at the active area; LibRaw moves an odd margin on to the next even one.
    top, left = main.corner()
    cfa = cfa_from(whole, raw.sizes.top_margin - top, raw.sizes.left_margin - left)
    indices = (names.index("R"), names.index("G"), names.index("B"), names.rindex("G"))
    return cfa, indices[: packing_sites(cfa).levels]
