"""Write the shipped manifests and their cards: ``python -m manifests.generate`` (or ``make manifests``).

The SID rows come from ``facts/sid-*.csv``, one line per scene. ``python -m manifests.generate --sid-lists FOLDER``
first writes those again from the file lists of the SID repository (its folder ``dataset``). ``--drv-lists FOLDER`` does
the same for ``facts/drv.csv``, one line per clip, from the lists of the DRV repository (its folder ``DRV``),
``--lrd-lists FOLDER`` for ``facts/lrd.csv``, one line per scene, from those of the LRD repository (its folder
``datalist``), and ``--lrid-infos FOLDER`` for ``facts/lrid.csv``, one line per burst, from the files of the PMN
repository's branch TPAMI (its folder ``infos``).

Sets whose files no public text lists have a card alone.
"""

import argparse
from collections.abc import Iterable
from pathlib import Path

from eldata.manifest.card import Card, save_card
from eldata.manifest.writing import save_manifest
from eldata.records import FrameRecord
from manifests.cards_alone import CARDS_ALONE
from manifests.published_crvd import published_crvd
from manifests.published_drv import load_splits, published_drv, save_splits, splits_from_lists
from manifests.published_eld import published_eld
from manifests.published_lrd import SPLITS as LRD_SPLITS
from manifests.published_lrd import load_lrd_scenes, lrd_scenes_from_lists, published_lrd, save_lrd_scenes
from manifests.published_lrid import bursts_from_infos, load_bursts, published_lrid, save_bursts
from manifests.published_sid import published_sid
from manifests.published_sidd import load_instances, published_blocks, published_sidd
from manifests.sid_scenes import SID_CAMERAS, load_scenes, save_scenes, scenes_from_lists

FOLDER = Path(__file__).parent


def facts_of(name: str) -> Path:
    """Return the table of what is published of a set."""
    return FOLDER / "facts" / f"{name}.csv"


def condense_sid_lists(lists: Path) -> None:
    """Write the tables of SID's scenes from the official file lists."""
    for name, camera in SID_CAMERAS.items():
        files = [lists / f"{camera.folder}_{split}_list.txt" for split in ("train", "val", "test")]
        save_scenes(facts_of(name), scenes_from_lists(camera, files))


def published() -> Iterable[tuple[Card, tuple[FrameRecord, ...]]]:
    """Yield card and rows of every manifest that the package ships."""
    yield published_eld()
    for name in SID_CAMERAS:
        yield published_sid(name, load_scenes(facts_of(name)))
    yield published_drv(load_splits(facts_of("drv")))
    yield published_lrd(load_lrd_scenes(facts_of("lrd")))
    yield published_lrid(load_bursts(facts_of("lrid")))
    yield published_sidd(load_instances(facts_of("sidd")))
    yield published_blocks(load_instances(facts_of("sidd-blocks")))
    yield published_crvd()


def main() -> None:
    """Write every manifest that the package ships."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sid-lists", type=Path, metavar="FOLDER", help="folder of the official SID file lists")
    parser.add_argument("--drv-lists", type=Path, metavar="FOLDER", help="folder of the official DRV lists of clips")
    parser.add_argument("--lrd-lists", type=Path, metavar="FOLDER", help="folder of the official LRD lists of pairs")
    parser.add_argument("--lrid-infos", type=Path, metavar="FOLDER", help="folder of the PMN repository's info files")
    arguments = parser.parse_args()
    if arguments.sid_lists is not None:
        condense_sid_lists(arguments.sid_lists)
    if arguments.drv_lists is not None:
        lists = {split: arguments.drv_lists / f"{split}_list.txt" for split in ("train", "val", "test")}
        save_splits(facts_of("drv"), splits_from_lists(lists))
    if arguments.lrd_lists is not None:
        lists = {split: arguments.lrd_lists / f"LRD_{split}_list.txt" for split in LRD_SPLITS}
        save_lrd_scenes(facts_of("lrd"), lrd_scenes_from_lists(lists))
    if arguments.lrid_infos is not None:
        save_bursts(facts_of("lrid"), bursts_from_infos(arguments.lrid_infos))
    for card in CARDS_ALONE:
        save_card(FOLDER / f"{card.name}.json", card)
    for card, records in published():
        save_manifest(FOLDER / f"{card.name}.csv", card, records)


if __name__ == "__main__":
    main()
