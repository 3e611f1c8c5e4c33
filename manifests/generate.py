"""Write the shipped manifests: ``python -m manifests.generate`` (or ``make manifests``).

A set's card, ``<name>.json``, is written by hand; this puts it into form. The rows, ``<name>.csv``, come from what is
published of the set's files: a module here, and for most sets a table in ``facts``, which this makes of the publisher's
own lists: ``--sid-lists FOLDER`` of those of the SID repository (its folder ``dataset``) ``facts/sid-*.csv``, one line
per scene; ``--drv-lists FOLDER`` of those of the DRV repository (its folder ``DRV``) ``facts/drv.csv``, one line per
clip; ``--lrd-lists FOLDER`` of those of the LRD repository (its folder ``datalist``) ``facts/lrd.csv``, one line per
scene; and ``--lrid-infos FOLDER`` of the files of the PMN repository's branch TPAMI (its folder ``infos``)
``facts/lrid.csv``, one line per burst. Those of ReCRVD and LLRVD are the lists of scenes of their repositories as they
stand, with the split beside.

Sets whose files no public text lists have a card alone.
"""

import argparse
from pathlib import Path

from eldata.manifest.card import load_card, save_card
from eldata.manifest.catalogue import save_manifest
from eldata.records import FrameRecord
from manifests.published_by_pattern import pattern_records
from manifests.published_crvd import crvd_records
from manifests.published_drv import drv_records, load_splits, save_splits, splits_from_lists
from manifests.published_eld import published_eld_records
from manifests.published_lrd import SPLITS as LRD_SPLITS
from manifests.published_lrd import load_lrd_scenes, lrd_records, lrd_scenes_from_lists, save_lrd_scenes
from manifests.published_lrid import bursts_from_infos, load_bursts, lrid_records, save_bursts
from manifests.published_rawnind import rawnind_records
from manifests.published_sidd import block_records, load_instances, sidd_records
from manifests.sid_scenes import SID_CAMERAS, load_scenes, save_scenes, scenes_from_lists, sid_records

FOLDER = Path(__file__).parent


def facts_of(name: str) -> Path:
    """Return the table of what is published of a set."""
    return FOLDER / "facts" / f"{name}.csv"


def published() -> dict[str, tuple[FrameRecord, ...]]:
    """Return the rows of every manifest that the package ships, by its name."""
    return {
        "eld": published_eld_records(),
        **{name: sid_records(camera, load_scenes(facts_of(name))) for name, camera in SID_CAMERAS.items()},
        "drv": drv_records(load_splits(facts_of("drv"))),
        "lrd": lrd_records(load_lrd_scenes(facts_of("lrd"))),
        "lrid": lrid_records(load_bursts(facts_of("lrid"))),
        "sidd": sidd_records(load_instances(facts_of("sidd"))),
        "sidd-blocks": block_records(load_instances(facts_of("sidd-blocks"))),
        "crvd": crvd_records(),
        **{name: pattern_records(name, load_splits(facts_of(name))) for name in ("recrvd", "llrvd")},
        "pmrid": pattern_records("pmrid", {"": "test"}),
        "raw-denoise": pattern_records("raw-denoise", {"": "train"}),
        "rawnind": rawnind_records(facts_of("rawnind")),
    }


def condense_sid_lists(lists: Path) -> None:
    """Write the tables of SID's scenes from the official file lists."""
    for name, camera in SID_CAMERAS.items():
        files = [lists / f"{camera.folder}_{split}_list.txt" for split in ("train", "val", "test")]
        save_scenes(facts_of(name), scenes_from_lists(camera, files))


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
    for path in FOLDER.glob("*.json"):
        save_card(path, load_card(path))
    for name, records in published().items():
        save_manifest(FOLDER / f"{name}.csv", load_card(FOLDER / f"{name}.json"), records)


if __name__ == "__main__":
    main()
