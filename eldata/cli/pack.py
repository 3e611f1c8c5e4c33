"""`eldata pack`: decode a dataset once, into a store that training reads fast.

Decode each file of a dataset's pairs or clips, or of a folder of clean raws, once, into one HDF5 file: the pixels in DN
with levels, CFA, exposure and manifest (of preprocessed clips, their 16-bit RGB), lossless. PackedStore, PackedClips,
CleanFrames and CleanClips read random crops of it. A folder of bias frames, CAMERA/bias/ISO100/... (or DATASET
calibration), makes a store for DarkFrames.

    eldata pack sid-sony --split train -o sid-train.h5
    eldata pack data/SID/Sony/long -o clean.h5
"""

from __future__ import annotations

import math
import shlex
from pathlib import Path
from typing import TYPE_CHECKING

from eldata.base import console
from eldata.base.files import folder_problem, refuse_among
from eldata.base.numbers import counted
from eldata.cli.baseline import add_pairs
from eldata.errors import ArgumentError, DatasetError

if TYPE_CHECKING:
    from eldata.sources.store.write import Source

_CALIBRATION = "calibration"
REFERENCE_HELP = "pattern of the clean frames' paths, such as '*/long/*', or '*' (default: by manifest or EXIF)"


def add_options(parser: console.Parser) -> None:
    """Add the options of `eldata pack`."""
    text = "a dataset's name, such as eld, drv or drv-raw (DRV's camera raws), its manifest, or a folder of clean raws"
    parser.add_argument("dataset", metavar="DATASET", help=text)
    console.add_output(parser, "-o", "--output", metavar="STORE", required=True, help="a new file, such as store.h5")
    parser.add_argument("--manifest", metavar="M", help="the dataset's manifest, instead of the shipped one")
    parser.add_argument("--reference", metavar="PATTERN", help=REFERENCE_HELP)
    parser.add_argument("--split", action="append", metavar="S", help="only this split; may be repeated")
    add_pairs(parser)
    console.add_cameras(parser)
    text = "lossless; lz4 and zstd need the extra eldata[compression] (default: %(default)s)"
    parser.add_argument("--compression", choices=("none", "lz4", "zstd"), default="none", help=text)
    console.add_shared(parser, run, "root", "workers")


def run(arguments: console.Arguments) -> int:
    """Pack frames into a store (`eldata pack`)."""
    from eldata.sources.store.write import build_store

    source = _choose_source(arguments)
    refuse_among(Path(arguments.output).parent, source.folder, (path for path, _ in source.files))
    with console.chosen_workers(arguments) as workers:
        store = build_store(source, arguments.output, compression=arguments.compression, workers=workers)
    pixel_bytes = sum(2 * math.prod(frame.shape) for frame in store.frames)
    print(
        f"{counted(len(store.frames), 'frame')} packed: {store.path}, {store.path.stat().st_size / 1e6:.1f} MB for "
        f"{pixel_bytes / 1e6:.1f} MB of pixels"
    )
    print(f"to check: eldata verify {shlex.quote(str(store.path))} --level full")
    return console.OK


def _choose_source(arguments: console.Arguments) -> Source:
    """Open the frames to pack: of a folder of raws, or of a dataset by name."""
    from eldata.manifest.catalogue import is_manifest, is_name
    from eldata.sources.store.write import source_of_dataset, source_of_folder

    if not Path(arguments.dataset).is_dir() or arguments.manifest is not None:
        if arguments.reference:
            raise ArgumentError("--reference is for a folder of raws: the manifest of a dataset says what is clean")
        if arguments.dataset == _CALIBRATION and arguments.manifest is None:
            return _find_calibration(arguments)
        if arguments.manifest is None and not is_name(arguments.dataset) and not is_manifest(arguments.dataset):
            problem = folder_problem(Path(arguments.dataset))
            raise ArgumentError(f"{arguments.dataset}: {problem}; give a folder of camera raws, or a dataset's name")
        options = console.chosen(arguments, ("root", "manifest", "cameras", "split", "subset", "ids"))
        return source_of_dataset(arguments.dataset, **options)
    if arguments.root or arguments.split or arguments.subset or arguments.cameras or arguments.ids:
        raise ArgumentError(
            f"--root, --split, --subset, --clip and --camera are for datasets by name; {arguments.dataset} is a folder"
        )
    return source_of_folder(arguments.dataset, arguments.reference)


def _find_calibration(arguments: console.Arguments) -> Source:
    """Open the folder of calibration frames, of one camera or all."""
    from eldata.manifest.catalogue import data_root
    from eldata.sources.store.write import source_of_folder

    if arguments.split or arguments.subset or arguments.ids:
        raise ArgumentError("--split, --subset and --clip are for datasets of pairs and clips, not for calibration")
    cameras = arguments.cameras or [""]
    if len(cameras) > 1:
        raise ArgumentError("give --camera once, or not at all: a store then holds the frames of every camera")
    folder = data_root(arguments.root) / _CALIBRATION / cameras[0]
    if not folder.is_dir():
        raise DatasetError(f"{folder}: there is no such folder; calibration frames lie in <camera>/bias/ISO100/...")
    return source_of_folder(folder)
