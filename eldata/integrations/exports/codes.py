"""One call: a set's pairs as one published repository's code reads them, names, lists and infos, after that code.

LED: commit ee3d372, led/data/paired_raw_dataset.py. ELD: commit 53d5408, dataset/sid_dataset.py and util/lmdb_data.py.
SID: commit 0448b58, train_Sony.py and the lists in dataset/. PMN: commit d207d3e, get_dataset_infos.py and
data_process/real_datasets.py.
"""

from __future__ import annotations

import io
import pickle
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any, Literal, Unpack, get_args

import numpy as np

from eldata.base.arguments import spell_keywords
from eldata.base.numbers import counted
from eldata.errors import ArgumentError, RawFileError, check_choice
from eldata.integrations.exports.frames import (
    ExportPlan,
    balance_multipliers,
    exported_pairs,
    matrix_to_srgb,
    write_export,
)
from eldata.integrations.exports.naming import (
    LARGEST_RATIO,
    eld_numbers,
    numbers_of,
    plain_number,
    sid_names,
)
from eldata.manifest.eld import nearest_reference
from eldata.manifest.pairs import Choice
from eldata.manifest.table import number_text

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence
    from fractions import Fraction

    from eldata.base.workers import AnyWorkers
    from eldata.integrations.exports.frames import ExportFrame, ExportPair, ExportReport, Linking

    PairsByCamera = Mapping[str, Sequence[ExportPair]]

Code = Literal["led", "pmn", "eld", "sid"]
CODES: tuple[Code, ...] = get_args(Code)

_PMN_SUFFIXES = (".arw", ".dng")
_SID_RATIOS = (100, 250, 300)


@spell_keywords(Choice)
def export(
    code: Code,
    folder: Path | str,
    name: str = "",
    *,
    manifest: Path | str | None = None,
    root: Path | str | None = None,
    link: Linking = "symbolic",
    workers: AnyWorkers = 1,
    **choice: Unpack[Choice],
) -> ExportReport:
    """Write what a published repository's code reads of a set: links under its names, and its lists or infos.

    Parameters
    ----------
    code
        ``"led"``, ``"pmn"``, ``"eld"`` or ``"sid"``: the code of the repository of that name.
    folder
        Where to write. Nothing in it is overwritten, and what is there as wanted is left.
    name
        A set that eldata knows.
    manifest
        A manifest's CSV file, in place of the name.
    root
        The folder that holds the datasets; default ``$ELDATA_ROOT``, else ``./data``.
    link
        ``"symbolic"`` or ``"hard"`` links to the files, or ``"copy"``. PMN's infos name the files themselves.
    workers
        Number of processes that read the files' headers, or an executor.
    choice
        Which pairs.

    Raises
    ------
    ArgumentError
        If an argument is unknown, or the code's names cannot say what the manifest does.
    ManifestError
        If there is no such set, or the manifest is malformed.
    DatasetError
        If files are missing or cannot be read.
    EldataError
        If something else lies where a link or list is to be; nothing is written then.

    Examples
    --------
    >>> from eldata.integrations.exports import export
    >>> manifest = "eldata-demo/manifests/eld-demo.csv"
    >>> report = export("led", "for-led", manifest=manifest, root="eldata-demo/data")
    >>> report.pairs, report.lists[0]
    (24, 'DemoAlpha/DemoAlpha_list.txt')
    """
    check_choice("code", code, CODES)
    _, pairs = exported_pairs(name, manifest=manifest, root=root, with_sensors=code == "pmn", workers=workers, **choice)
    plan = ExportPlan()
    for camera, own in pairs.items():
        _PLANS[code](plan, camera, own)
    return write_export(Path(folder), plan, sum(map(len, pairs.values())), link)


# --- LED --------------------------------------------------------------------------------------------------------------


def _led(plan: ExportPlan, camera: str, pairs: Sequence[ExportPair]) -> None:
    names = _linked(plan, camera, pairs, sid_names(pairs))
    for part, chosen in _by_split(pairs, always=False):
        lists = {"": chosen} | {
            f"_{number_text(ratio)}": [pair for pair in chosen if pair.record.ratio == ratio]
            for ratio in sorted({pair.record.ratio for pair in chosen})
        }
        for ending, listed in lists.items():
            lines = [
                f"{names[pair.noisy.path]} {names[pair.reference.path]} {_iso(pair.noisy.exposure.iso)} "
                f"{_iso(pair.reference.exposure.iso)}\n"
                for pair in listed
            ]
            plan.lists[f"{camera}/{camera}{part}_list{ending}.txt"] = "".join(lines).encode()
    plan.usage.append(
        f"{camera}: in LED's yaml, dataroot is the folder {camera} here, data_pair_list one of its lists, postfix ~"
    )
    _note_cap(plan, camera, pairs, "LED")


def _iso(iso: Fraction | None) -> str:
    return f"ISO{number_text(iso)}" if iso is not None else "ISO"


# --- ELD --------------------------------------------------------------------------------------------------------------


def _eld(plan: ExportPlan, camera: str, pairs: Sequence[ExportPair]) -> None:
    _check_suffixes(pairs)
    names = _linked(plan, camera, pairs, sid_names(pairs))
    bare = {path: name.partition("/")[2] for path, name in names.items()}
    for split, chosen in _by_split(pairs, always=True):
        lines = [f"{bare[pair.noisy.path]} {bare[pair.reference.path]}\n" for pair in chosen]
        plan.lists[f"{camera}{split}.txt"] = "".join(lines).encode()
    lines = [
        f"{bare[pair.noisy.path]} {bare[pair.reference.path]} {int(min(pair.record.ratio, LARGEST_RATIO))}\n"
        for pair in pairs
    ]
    plan.lists[f"{camera}_paired.txt"] = "".join(lines).encode()
    files = _files(pairs)
    for scene, numbered in _numbered_scenes(pairs).items():
        for number, path in numbered.items():
            file = files[path]
            plan.links[f"{camera}/scene-{scene}/IMG_{number:04d}{_elds_suffix(file)}"] = file
    plan.usage.append(
        f"{camera}: datadir of SIDDataset, and sourcedir of util/lmdb_data.py, are the folder {camera} here, the lists "
        "take the place of dataset/Sony_*.txt and SID_Sony_15_paired.txt; basedir of ELDEvalDataset is this folder"
    )
    _note_cap(plan, camera, pairs, "ELD's SIDDataset")


def _elds_suffix(file: Path) -> str:
    """Return ``.DNG`` for one whose time stands in the EXIF IFD, where ELD's code looks unless it ends in ``.dng``."""
    if file.suffix != ".dng":
        return file.suffix
    from eldata.raw.exif import exif_tags

    tags = exif_tags(file)
    return ".dng" if {"Image ExposureTime", "Image ISOSpeedRatings"} <= tags.keys() else ".DNG"


# --- SID --------------------------------------------------------------------------------------------------------------


def _sid(plan: ExportPlan, camera: str, pairs: Sequence[ExportPair]) -> None:
    _check_suffixes(pairs)
    names = _linked(plan, camera, pairs, sid_names(pairs, bursts=True))
    for split, chosen in _by_split(pairs, always=True):
        lines = [
            f"./{camera}/{names[pair.noisy.path]} ./{camera}/{names[pair.reference.path]} "
            f"{_iso(pair.noisy.exposure.iso)}\n"
            for pair in chosen
        ]
        plan.lists[f"{camera}{split}_list.txt"] = "".join(lines).encode()
    suffix = next(iter(names.values())).rpartition(".")[2]
    plan.usage.append(
        f"{camera}: input_dir and gt_dir of train_Sony.py are {camera}/short/ and {camera}/long/ here"
        + ("" if suffix == "ARW" else f", and its patterns of names end in .{suffix}, not in .ARW")
    )
    odd = sum(min(pair.record.ratio, LARGEST_RATIO) not in _SID_RATIOS for pair in pairs)
    if odd:
        plan.remarks.append(
            f"{camera}: {counted(odd, 'pair')} with a ratio other than 100, 250 and 300, which are the only ones that "
            "train_Sony.py has room for"
        )
    _note_cap(plan, camera, pairs, "SID's code")


# --- PMN --------------------------------------------------------------------------------------------------------------


def _pmn(plan: ExportPlan, camera: str, pairs: Sequence[ExportPair]) -> None:
    other = [pair.noisy for pair in pairs if pair.noisy.file.suffix.lower() not in _PMN_SUFFIXES]
    if other:
        raise ArgumentError(f"{other[0].file}: PMN's code opens .arw and .dng alone; eldata's own datasets read all")
    training = [pair for pair in pairs if pair.record.split == "train"]
    scored = [pair for pair in pairs if pair.record.split != "train"]
    if training:
        plan.lists[f"{camera}/infos/SID_train.info"] = _pickled(_sid_train_info(training))
    if scored:
        plan.lists[f"{camera}/infos/SID_evaltest.info"] = _pickled(_sid_evaltest_info(scored))
        counts = [sum(pair.record.ratio == ratio for pair in scored) for ratio in _SID_RATIOS]
        if counts != [40, 40, 49]:
            plan.remarks.append(
                f"{camera}: PMN's SID_Dataset cuts SID_evaltest.info after 40 and 80 pairs, for ratios of 100, 250 and "
                f"300; here there are {', '.join(map(str, counts))} of these, and {len(scored)} in all"
            )
    scenes = _numbered_scenes(scored or pairs)
    plan.lists[f"{camera}/infos/ELD_{camera}.info"] = _pickled(_eld_info(scored or pairs, scenes.values()))
    plan.usage.append(
        f"{camera}: {camera}/infos here takes the place of PMN's infos (ELD_{camera}.info under the name that its "
        "ELD_Dataset has, ELD_SonyA7S2.info); H, W, wp and bl of the runfile are those of your camera"
    )


def _sid_train_info(pairs: Sequence[ExportPair]) -> list[dict[str, Any]]:
    """Return one entry a reference: its facts, ``long``, and ``short`` and ``ratio`` of all of its noisy frames."""
    noisy_of: dict[str, list[ExportPair]] = {}
    for pair in pairs:
        noisy_of.setdefault(pair.reference.path, []).append(pair)
    return [
        _facts(own[0].reference)
        | {
            "ratio": np.array([plain_number(pair.record.ratio) for pair in own]),
            "long": str(own[0].reference.file),
            "short": [str(pair.noisy.file) for pair in own],
        }
        for own in noisy_of.values()
    ]


def _sid_evaltest_info(pairs: Sequence[ExportPair]) -> list[dict[str, Any]]:
    """Return one entry a pair, by ratio: PMN's code cuts the list where the ratio changes."""
    return [
        _facts(pair.reference)
        | {"ratio": plain_number(pair.record.ratio), "long": str(pair.reference.file), "short": str(pair.noisy.file)}
        for pair in sorted(pairs, key=lambda pair: pair.record.ratio)
    ]


def _eld_info(pairs: Sequence[ExportPair], scenes: Iterable[Mapping[int, str]]) -> list[list[dict[str, Any]]]:
    """Return for each scene an entry a number, from 1 on without a gap: PMN's code counts places, not names.

    Numbers without a frame have their reference's entry, which stands for no ISO and ratio that is asked for.
    """
    frames = {frame.path: frame for pair in pairs for frame in (pair.reference, pair.noisy)}
    ratio_of = {pair.noisy.path: plain_number(pair.record.ratio) for pair in pairs}
    infos = []
    for numbered in scenes:
        last = max(numbered)
        paths = [numbered.get(number, numbered.get(nearest_reference(number))) for number in range(1, last + 1)]
        known = next(path for path in paths if path is not None)
        entries = [path or known for path in paths]
        infos.append(
            [
                _facts(frames[path]) | {"ratio": ratio_of.get(path, 1), "data": str(frames[path].file)}
                for path in entries
            ]
        )
    return infos


def _facts(frame: ExportFrame) -> dict[str, Any]:
    iso, seconds = frame.exposure.iso, frame.exposure.exposure_s
    if iso is None or seconds is None:
        raise RawFileError(frame.file, "states no ISO or no exposure time, which PMN's infos have")
    return {
        "ISO": int(iso),
        "ExposureTime": float(seconds),
        "name": PurePosixPath(frame.path).stem,
        "wb": balance_multipliers(frame.sensor),
        "ccm": matrix_to_srgb(frame.sensor),
    }


class _Pickler(pickle.Pickler):
    """Writes arrays as calls of ``numpy.array``, which every numpy has.

    What numpy 2 writes of itself names modules that the numpy of PMN's code, below 1.20, does not have.
    """

    def reducer_override(self, value: Any) -> Any:
        if isinstance(value, np.ndarray):
            return np.array, (value.tolist(), value.dtype.str)
        return NotImplemented


def _pickled(content: Any) -> bytes:
    """Return a list of infos pickled, for any Python 3 and any numpy."""
    out = io.BytesIO()
    _Pickler(out, protocol=2).dump(content)
    return out.getvalue()


# --- what they share --------------------------------------------------------------------------------------------------

_PLANS: dict[Code, Callable[[ExportPlan, str, Sequence[ExportPair]], None]] = {
    "led": _led,
    "pmn": _pmn,
    "eld": _eld,
    "sid": _sid,
}


def _files(pairs: Iterable[ExportPair]) -> dict[str, Path]:
    return {frame.path: frame.file for pair in pairs for frame in (pair.reference, pair.noisy)}


def _linked(plan: ExportPlan, camera: str, pairs: Sequence[ExportPair], names: dict[str, str]) -> dict[str, str]:
    """Add links below the camera's folder; return their names there by the frames' paths."""
    plan.links |= {f"{camera}/{names[path]}": file for path, file in _files(pairs).items()}
    return names


def _by_split(pairs: Sequence[ExportPair], *, always: bool) -> list[tuple[str, list[ExportPair]]]:
    """Return pairs by ``_<split>``; unless ``always``, all of them first, and splits only if there are several."""
    splits = sorted({pair.record.split for pair in pairs})
    parts = [(f"_{one}" if one else "_all", [pair for pair in pairs if pair.record.split == one]) for one in splits]
    return parts if always else [("", list(pairs)), *(parts if len(parts) > 1 else [])]


def _numbered_scenes(pairs: Sequence[ExportPair]) -> dict[int, dict[int, str]]:
    """Return for each scene's number the frames by theirs."""
    scenes = numbers_of((pair.record.scene for pair in pairs), below=10_000, what="scenes")
    ordered = sorted(scenes, key=scenes.__getitem__)
    return {scenes[scene]: eld_numbers([pair for pair in pairs if pair.record.scene == scene]) for scene in ordered}


def _check_suffixes(pairs: Sequence[ExportPair]) -> None:
    for path in _files(pairs):
        if path[-4:-3] != ".":
            raise ArgumentError(
                f"{path}: the published code takes off 's' and an ending of three letters to read the time; rename it"
            )


def _note_cap(plan: ExportPlan, camera: str, pairs: Sequence[ExportPair], who: str) -> None:
    above = sum(pair.record.ratio > LARGEST_RATIO for pair in pairs)
    if above:
        plan.remarks.append(
            f"{camera}: {counted(above, 'pair')} with a ratio above 300, at which {who} caps it: their inputs come out "
            "darker than their references"
        )
