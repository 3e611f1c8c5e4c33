"""How published sets lie: ELD's sixteen frames of a scene, and what a copy of the Dark Raw Video dataset (DRV) holds.

ELD: references are the frames 1, 6, 11 and 16; with i the index of the ISO and k that of the low-light factor, a noisy
frame is 5 i + 2 + k; its reference is the nearest of the four by number (so 4 and 5 have 6, not 1). Sources: K. Wei,
Y. Fu, Y. Zheng and J. Yang, "Physics-based Noise Modeling for Extreme Low-light Photography", TPAMI 2021 (section 3.3:
cameras, ISOs, factors, Algorithm 1); the ELD repository's test_ELD.py and sid_dataset.py for names and the choice of
reference; PMN's and LED's file lists for exposures and ratios.

DRV: a static clip (``0001`` to ``0202``) is a burst of short exposures with one long one as the reference; a dynamic
clip (``M0000`` to ``M0022``) has no reference. There are two forms:

preprocessed
    What the authors' code reads: ``VBM4D_rawRGB/<clip>/*.png``, denoised by VBM4D and amplified, and
    ``long/<clip>/half0001*.png``, both 16-bit RGB. Neither names nor numbers of the frames are published, so the
    shipped rows are patterns (:mod:`eldata.manifest.patterns`).
raw
    The camera's own files, in the archives ``short1`` to ``short5`` and ``long``. Their layout is not published:
    :func:`scan_raw` looks and says what it found.
"""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from fractions import Fraction
from functools import partial
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

from eldata.base.files import visible_below
from eldata.errors import DatasetError
from eldata.manifest.card import Card, counts_of
from eldata.manifest.catalogue import Manifest, save_manifest, shipped_manifest
from eldata.manifest.clips import clip_names
from eldata.manifest.patterns import is_pattern
from eldata.raw.files import is_raw
from eldata.records import FrameRecord, Role

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence


REFERENCE_NUMBERS = (1, 6, 11, 16)
NOISY_ISOS = (800, 1600, 3200)
LOW_LIGHT_FACTORS = (1, 10, 100, 200)

# Split of the clips without a reference.
DYNAMIC = "dynamic"

# Flag of a long exposure that is not the one that was chosen as the reference.
UNUSED = "unused"

_DIGITS = re.compile(r"[0-9]+")
_SHOWN = 5


@dataclass(frozen=True, slots=True)
class EldCamera:
    """A camera of an ELD-style set.

    Attributes
    ----------
    name
        Its folder.
    extension
        Of its files, with the dot, upper or lower case as in the file names.
    reference_iso
        ISO of the references, where known.
    reference_exposure_s
        Exposure time of the references by scene number, where known.
    """

    name: str
    extension: str
    reference_iso: int | None = None
    reference_exposure_s: Mapping[int, Fraction] | None = None


def frame_path(camera: EldCamera, scene: int, number: int) -> str:
    """Return a frame's path relative to the dataset's folder."""
    return f"{camera.name}/scene-{scene}/IMG_{number:04d}{camera.extension}"


def eld_records(
    cameras: Iterable[EldCamera], scenes: Sequence[int], flags: Mapping[str, tuple[str, ...]] | None = None
) -> tuple[FrameRecord, ...]:
    """Return the rows of an ELD-style set, sixteen frames for each camera and scene, sorted by path.

    ``ratio`` is the nominal low-light factor. Exposure times of noisy frames follow from the references' where those
    are known: t_noisy = ISO_ref t_ref / (ISO_noisy f). ``flags`` are given by path.
    """
    rows = []
    for camera in cameras:
        for scene in scenes:
            reference_iso = None if camera.reference_iso is None else Fraction(camera.reference_iso)
            reference_exposure_s = (camera.reference_exposure_s or {}).get(scene)
            frame = partial(FrameRecord, camera=camera.name, scene=f"scene-{scene}", split="test")
            path_of = partial(frame_path, camera, scene)
            reference = partial(frame, role="reference", iso=reference_iso, exposure_s=reference_exposure_s)
            rows += [reference(path_of(number)) for number in REFERENCE_NUMBERS]
            for i, iso in enumerate(NOISY_ISOS):
                for k, factor in enumerate(LOW_LIGHT_FACTORS):
                    number = 5 * i + 2 + k
                    exposure_s = None
                    if reference_iso is not None and reference_exposure_s is not None:
                        exposure_s = reference_iso * reference_exposure_s / (iso * factor)
                    nearest = path_of(min(REFERENCE_NUMBERS, key=lambda reference: abs(reference - number)))
                    noisy = partial(frame, path_of(number), "noisy", reference=nearest)
                    rows.append(noisy(iso=Fraction(iso), exposure_s=exposure_s, ratio=Fraction(factor)))
    flagged = [replace(row, flags=flags[row.path]) if flags and row.path in flags else row for row in rows]
    return tuple(sorted(flagged, key=lambda row: row.path))


# --- DRV --------------------------------------------------------------------------------------------------------------


def describe_layout(records: Iterable[FrameRecord]) -> str:
    """Describe how a copy's clips lie: for each kind of name, how many clips and files have it.

    The clip stands as ``<clip>``, other numbers of a name as ``<n>``. Patterns, which are no files, are left out.
    """
    rows = [row for row in records if not is_pattern(row.path)]
    clips: dict[tuple[str, str], list[str]] = defaultdict(list)
    for row in rows:
        clips[UNUSED if UNUSED in row.flags else row.role, _kind_of_name(row.path, row.scene)].append(row.scene)
    kinds = "; ".join(
        f"{role} {name}: {len(set(scenes))} clips, {len(scenes)} files"
        for (role, name), scenes in sorted(clips.items())
    )
    frames = Counter(clip_names(rows).values()).values()
    referenced = {row.scene for row in rows if row.role == "reference" and UNUSED not in row.flags}
    alone = tuple(dict.fromkeys(row.scene for row in rows if row.role == "noisy" and row.scene not in referenced))
    count = f"{min(frames, default=0)} to {max(frames, default=0)} frames per clip"
    return f"{kinds or 'no files'}; {count}{f'; without a reference: {_list_some(alone)}' if alone else ''}"


@dataclass(frozen=True, slots=True)
class Scan:
    """Files of one copy as a manifest: its card, and its rows, one per file."""

    card: Card
    records: tuple[FrameRecord, ...]

    def save(self, path: Path | str) -> Manifest:
        """Write the manifest's CSV and, beside it, its card; ``eldata verify`` and ``eldata lock`` take it then."""
        return save_manifest(path, self.card, self.records)


def scan_raw(folder: Path | str, *, reference: str = "*") -> Scan:
    """List the camera raws of a copy, wherever its archives were unpacked below ``folder``.

    A file belongs to the clip that one of its folders is named after. It is a reference if one of its folders is called
    ``long``, a noisy frame if the name of one begins with ``short``. Nothing else is assumed, and what does not fit is
    an error. Raws of dynamic clips below ``long`` are left out: what they are is not published.

    Parameters
    ----------
    folder
        The dataset's folder, such as ``data/DRV``.
    reference
        Pattern of the references' file names, for copies with several raws of a clip below ``long``; the others are
        listed with the flag ``unused``.

    Raises
    ------
    DatasetError
        If there is no raw file; if raws lie anywhere else; if a clip's files lie in several folders, or several fit
        ``reference``. The message says what was found.
    """
    folder = Path(folder)
    published = shipped_manifest("drv")
    (camera,) = published.card.cameras
    split_of = {row.scene: row.split for row in published.records if row.role == "noisy"}
    paths_of: dict[str, dict[str, list[str]]] = {kind: defaultdict(list) for kind in ("noisy", "reference", UNUSED, "")}
    for path in visible_below(folder):
        relative = path.relative_to(folder)
        kind, clip = _kind_and_clip(relative, split_of, reference)
        dynamic = split_of.get(clip) == DYNAMIC
        if is_raw(path) and not (dynamic and kind in ("reference", UNUSED)):
            paths_of[kind][clip].append(relative.as_posix())
    stray, noisy, bright, unused = paths_of[""][""], paths_of["noisy"], paths_of["reference"], paths_of[UNUSED]
    if stray:
        raise DatasetError(
            f"{folder}: cannot tell which clip {len(stray)} raw files belong to, such as {_list_some(stray)}; expected "
            "each below a folder called short, short1 ... or long, in one named after a clip (0001, M0000)"
        )
    if not noisy:
        raise DatasetError(f"{folder}: holds no camera raw of a clip, such as short/0001/<name>.ARW")
    for clip, paths in (*noisy.items(), *bright.items()):
        places = sorted({PurePosixPath(path).parent.as_posix() for path in paths})
        if len(places) > 1:
            raise DatasetError(f"{folder}: clip {clip} lies in {len(places)} folders: {_list_some(places)}; keep one")
    for clip, paths in bright.items():
        if len(paths) > 1:
            raise DatasetError(
                f"{folder}: clip {clip} has {len(paths)} long exposures, and which is the reference is not published: "
                f"{_list_some(paths)}; name it with reference='PATTERN'"
            )
    reference_of = {clip: paths[0] for clip, paths in bright.items()}

    def rows(role: Role, of_clips: Mapping[str, Sequence[str]], flags: tuple[str, ...] = ()) -> Iterator[FrameRecord]:
        """Yield a row for each file of these clips, noisy ones with their clip's reference."""
        for clip, paths in of_clips.items():
            named = reference_of.get(clip) if role == "noisy" else None
            row = FrameRecord("", role, camera, clip, split_of[clip], reference=named, flags=flags)
            yield from (replace(row, path=path) for path in paths)

    records = [*rows("noisy", noisy), *rows("reference", bright), *rows("reference", unused, (UNUSED,))]
    card = replace(
        published.card,
        name="drv-raw",
        title=f"{published.card.title}: camera raws of one copy",
        counts=counts_of(records),
        protocol="drv-raw",
        sources=(*published.card.sources, "the files of one copy: what is missing there is missing here"),
    )
    return Scan(card, tuple(sorted(records, key=lambda row: row.path)))


def _kind_and_clip(path: Path, clips: Collection[str], reference: str) -> tuple[str, str]:
    """Return a raw file's kind (a role, ``unused``, or empty if its folders do not say) and its clip."""
    folders = path.parts[:-1]
    named = [part for part in folders if part in clips]
    long = any(part.casefold() == "long" for part in folders)
    short = any(part.casefold().startswith("short") for part in folders)
    if len(named) != 1 or long == short:
        return "", ""
    return "noisy" if short else "reference" if fnmatchcase(path.name, reference) else UNUSED, named[0]


def _kind_of_name(path: str, clip: str) -> str:
    """Return a path with its clip and its other numbers replaced by placeholders."""
    parts = PurePosixPath(path).parts
    named = ["<clip>" if part == clip else part for part in parts[:-1]]
    return "/".join([*named, _DIGITS.sub("<n>", parts[-1])])


def _list_some(names: Sequence[str]) -> str:
    """List the first names, and count the others."""
    more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
    return f"{', '.join(names[:_SHOWN])}{more}"
