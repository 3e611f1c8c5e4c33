"""A set as a folder that the package ``datasets`` reads, and that can be put on the Hugging Face Hub as it is."""

from __future__ import annotations

import re
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

from tqdm import tqdm

from eldata.base.arguments import spell_keywords
from eldata.base.fields import names_of
from eldata.base.files import folder_problem, json_text
from eldata.base.tables import csv_text
from eldata.errors import ArgumentError, DatasetError
from eldata.integrations.exports.frames import ExportPlan, write_export
from eldata.integrations.exports.hub_card import PAIR_COLUMNS, HubLayout, HubSplit, hub_page
from eldata.manifest.catalogue import carded_names, known_manifest, load_manifest, shipped_card
from eldata.manifest.croissant import to_croissant
from eldata.manifest.pairs import Choice, select_pairs
from eldata.manifest.table import cell_text
from eldata.records import PairRecord
from eldata.sources.shards.index import INDEX
from eldata.sources.shards.reading import Folder, read_samples

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from eldata.integrations.exports.frames import ExportReport, Linking
    from eldata.manifest.catalogue import Manifest
    from eldata.records import FrameRecord
    from eldata.sources.shards.index import ShardIndex

# As `datasets` has it; it takes the pairs of "all" for those of every split.
_SPLIT = re.compile(r"(?!all$)\w+(\.\w+)*", re.ASCII)


@spell_keywords(Choice)
def export_hub(
    folder: Path | str,
    name: str = "",
    *,
    manifest: Path | str | None = None,
    shards: Sequence[Path | str] = (),
    link: Linking = "symbolic",
    **choice: Unpack[Choice],
) -> ExportReport:
    """Lay out a set for the package ``datasets``: a dataset card, manifest and Croissant, and pixels or references.

    ``load_dataset(folder)`` then gives the samples of the shards, or, without shards, a table of the pairs: names,
    exposures, ratios, hashes and where to get them, and ``load_dataset(folder, "frames")`` the manifest.

    Parameters
    ----------
    folder
        Where to write. Nothing in it is overwritten, and what is there as wanted is left.
    name
        A set that eldata knows.
    manifest
        A manifest's CSV file, in place of the name.
    shards
        Folders of shards of this set (``eldata shard``), one for each split; each sample is read and checked. They
        are taken only if the card states a licence by its SPDX name.
    link
        ``"symbolic"`` or ``"hard"`` links to the shards, or ``"copy"``.
    choice
        Which pairs the table has. Which ones shards have was chosen as they were written.

    Raises
    ------
    ArgumentError
        If an argument is unknown, the card states no licence by which the pixels may be passed on, or ``datasets``
        cannot have a split's name.
    ManifestError
        If there is no such set, or the manifest is malformed.
    DatasetError
        If shards are not of this set, hold several splits, or are not those of the manifest any more.
    ShardError
        If shards cannot be read or are damaged.
    EldataError
        If something else lies where a file is to be; nothing is written then.

    Examples
    --------
    >>> from eldata.integrations.exports import export_hub
    >>> report = export_hub("eld-on-the-hub", "eld")
    >>> report.pairs, report.lists[0], report.linked
    (480, 'pairs/test.csv', 0)
    """
    loaded = known_manifest(name) if manifest is None else load_manifest(manifest)
    plan = ExportPlan()
    if shards:
        if any(choice.values()):
            raise ArgumentError(
                "the pairs of shards were chosen as they were written: leave out split, camera and subset"
            )
        _check_passed_on(loaded)
        layout, pairs = _with_pixels(plan, loaded, [Path(place) for place in shards])
    else:
        layout, pairs = _with_references(plan, loaded, choice)
    stem = loaded.path.stem
    plan.lists[f"{stem}.csv"] = loaded.path.read_bytes()
    plan.lists[f"{stem}.json"] = loaded.path.with_suffix(".json").read_bytes()
    plan.lists[f"{stem}.croissant.json"] = json_text(to_croissant(loaded)).encode()
    plan.lists["README.md"] = hub_page(loaded, layout).encode()
    plan.usage.append(f'load_dataset("{folder}"), or: hf upload OWNER/{loaded.name} {folder} --repo-type dataset')
    if loaded.card.spdx.startswith("LicenseRef-"):
        plan.remarks.append(f"the card's licence is your own: put its text into {Path(folder) / 'LICENSE'}")
    return write_export(Path(folder), plan, pairs, link)


def _check_passed_on(manifest: Manifest) -> None:
    """Raise :class:`ArgumentError` unless the card states a licence by its SPDX name.

    Of a set that eldata knows, it is the card that comes with eldata that says so, whatever the copy of its manifest.
    """
    known = manifest.name in carded_names()
    card = shipped_card(manifest.name) if known else manifest.card
    if card.spdx:
        return
    way = (
        "passing them on is for its publishers"
        if known
        else f"if the photographs are yours, write one into {manifest.path.with_suffix('.json')}, such as "
        '"licence": "CC-BY-4.0"'
    )
    raise ArgumentError(
        f"{manifest.name}: its card states no licence by an SPDX name (found {card.licence!r}), so its pixels are not "
        f"copied: {way}; leave out --shards to write names, hashes and addresses alone"
    )


# --- pixels -----------------------------------------------------------------------------------------------------------


def _with_pixels(plan: ExportPlan, manifest: Manifest, places: Iterable[Path]) -> tuple[HubLayout, int]:
    known = {pair.path: pair for pair in select_pairs(manifest.records)}
    splits: dict[str, HubSplit] = {}
    shapes, pairs = set(), set()
    for place in places:
        problem = folder_problem(place)
        if problem is not None:
            raise DatasetError(f"{place}: {problem}; name a folder that eldata shard wrote")
        source = Folder(str(place))
        index = source.read_index()
        if index.dataset != manifest.name:
            raise DatasetError(f"{place}: holds pairs of {index.dataset!r}, but the manifest is of {manifest.name!r}")
        records = [(record, sizes) for record, *sizes in _checked(source, index, known)]
        first, *others = dict.fromkeys(record.split for record, _ in records)
        if others:
            raise DatasetError(
                f"{source.address}: holds pairs of the splits {first!r} and {others[0]!r}; the package datasets tells "
                "splits by their files: shard each by itself (eldata shard --split)"
            )
        split = _split_name(first)
        if split in splits:
            raise DatasetError(f"{place}: holds pairs of the split {split} as another folder does; shard them together")
        below = f"data/{split}"
        splits[split] = HubSplit(split, f"{below}/*.tar", len(records), sum(shard.bytes for shard in index.shards))
        plan.links |= {f"{below}/{name}": place.absolute() / name for name in [*(s.name for s in index.shards), INDEX]}
        shapes |= {size for _, sizes in records for size in sizes}
        pairs |= {record.path for record, _ in records}
    shape = next(iter(shapes)) if len(shapes) == 1 else None
    return HubLayout(tuple(splits.values()), pixels=True, shape=shape), len(pairs)


def _checked(
    source: Folder, index: ShardIndex, known: Mapping[str, PairRecord]
) -> Iterator[tuple[PairRecord, Any, Any]]:
    """Yield the record of every sample of a folder, held against the manifest's, and the sizes of its frames."""
    with tqdm(total=len(index), desc="checking shards", unit="sample", disable=None, leave=False) as bar:
        for number, shard in enumerate(index.shards):
            with closing(read_samples(source, index, number, range(len(shard)))) as samples:
                for sample in samples:
                    record = sample.facts.record
                    _check_record(source.address, record, known.get(record.path))
                    yield record, sample.input_dn.shape, sample.target_dn.shape
                    bar.update()


def _check_record(place: str, found: PairRecord, expected: PairRecord | None) -> None:
    if found == expected:
        return
    what = "it is not there"
    if expected is not None:
        name = next(name for name in names_of(PairRecord) if getattr(found, name) != getattr(expected, name))
        wanted, had = (cell_text(getattr(record, name)) or "nothing" for record in (expected, found))
        what = f"{name}: expected {wanted}, found {had}"
    raise DatasetError(
        f"{place}: the pair {found.path} is not as the manifest has it now ({what}); pack and shard the set again"
    )


def _split_name(split: str) -> str:
    """Return a split's name for ``datasets``, which calls the pairs of a set without splits ``train``."""
    if split and not _SPLIT.fullmatch(split):
        raise ArgumentError(
            f"split {split!r}: the package datasets takes names of letters, digits, _ and single dots, but not 'all'; "
            "rename it in the manifest"
        )
    return split or "train"


# --- references -------------------------------------------------------------------------------------------------------


def _with_references(plan: ExportPlan, manifest: Manifest, choice: Choice) -> tuple[HubLayout, int]:
    of_clips = not any(one.reference is not None and one.ratio is not None for one in manifest.records)
    if of_clips and any(choice.values()):
        raise ArgumentError(f"{manifest.name}: has no pairs with a ratio to choose from; its table has all frames")
    pairs = () if of_clips else select_pairs(manifest.records, manifest.card.subsets, **choice)
    rows_of = {record.path: record for record in manifest.records}
    parts: dict[str, list[PairRecord]] = {}
    for pair in pairs:
        parts.setdefault(_split_name(pair.split), []).append(pair)
    splits = []
    for split, chosen in sorted(parts.items()):
        path = f"pairs/{split}.csv"
        both = [(rows_of[pair.path], rows_of[pair.reference]) for pair in chosen]
        rows = [[_cell(name, manifest, *frames) for name in PAIR_COLUMNS] for frames in both]
        plan.lists[path] = csv_text(PAIR_COLUMNS, rows).encode()
        splits.append(HubSplit(split, path, len(chosen)))
    plan.remarks.append(
        "these are references; the pixels of a set whose card states its licence go along by --shards (eldata pack, "
        "eldata shard --split)"
    )
    return HubLayout(tuple(splits)), len(pairs)


def _cell(name: str, manifest: Manifest, noisy: FrameRecord, reference: FrameRecord) -> str:
    if name == "download":
        holders = [one for one in manifest.card.downloads if one.holds(noisy.path) or one.holds(reference.path)]
        return " ".join(one.address for one in holders)
    record, column = (reference, name.removeprefix("reference_")) if name.startswith("reference_") else (noisy, name)
    return cell_text(getattr(record, column))
