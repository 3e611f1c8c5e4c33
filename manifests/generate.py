"""Write the shipped manifests and their cards: ``python -m manifests.generate`` (or ``make manifests``).

The SID rows come from ``facts/sid-*.csv``, one line per scene. ``python -m manifests.generate --sid-lists FOLDER``
first writes those again from the file lists of the SID repository (its folder ``dataset``). ``--drv-lists FOLDER`` does
the same for ``facts/drv.csv``, one line per clip, from the lists of the DRV repository (its folder ``DRV``).
"""

import argparse
from collections.abc import Iterable
from pathlib import Path

from eldata.manifest.card import Card
from eldata.manifest.catalogue import save_manifest
from eldata.records import FrameRecord
from manifests.published_drv import load_splits, published_drv, save_splits, splits_from_lists
from manifests.published_eld import published_eld
from manifests.published_sid import published_sid
from manifests.sid_scenes import SID_CAMERAS, load_scenes, save_scenes, scenes_from_lists

FOLDER = Path(__file__).parent


def facts_of(name: str) -> Path:
    """Return the table of scenes of a half of SID."""
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


def main() -> None:
    """Write every manifest that the package ships."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sid-lists", type=Path, metavar="FOLDER", help="folder of the official SID file lists")
    parser.add_argument("--drv-lists", type=Path, metavar="FOLDER", help="folder of the official DRV lists of clips")
    arguments = parser.parse_args()
    if arguments.sid_lists is not None:
        condense_sid_lists(arguments.sid_lists)
    if arguments.drv_lists is not None:
        lists = {split: arguments.drv_lists / f"{split}_list.txt" for split in ("train", "val", "test")}
        save_splits(facts_of("drv"), splits_from_lists(lists))
    for card, records in published():
        save_manifest(FOLDER / f"{card.name}.csv", card, records)


if __name__ == "__main__":
    main()
