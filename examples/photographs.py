"""Photographs under free licences: what the network that ships learns from, and what it is judged on.

    python examples/photographs.py photographs        # 170 MB, by apt-get of Debian or Ubuntu

They lie in packages of Debian 12 (wallpapers; photographs alone were chosen, by looking at each) and in scikit-learn,
and are fetched, never part of eldata. Each has one use, by its name: to train, to choose when to stop, or to judge.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import tempfile
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from PIL import Image

from eldata.base.files import atomic_write
from eldata.demo.scenes import linear_light
from eldata.errors import EldataError

if TYPE_CHECKING:
    from numpy.typing import NDArray


class Package(NamedTuple):
    """Where photographs come from: a package of Debian's, and the licence that its file copyright states."""

    name: str
    licence: str


OLD_LOMIRI, LOMIRI = Package("lomiri-wallpapers-16.04", "CC BY 4.0"), Package("lomiri-wallpapers-20.04", "CC BY-SA 3.0")
SHARED_LOMIRI, FREE_LOMIRI = OLD_LOMIRI._replace(licence="CC BY-SA 4.0"), OLD_LOMIRI._replace(licence="CC0 1.0")
MATE, PLASMA = Package("mate-backgrounds", "GPL-2+"), Package("plasma-workspace-wallpapers", "GPL-2+")
SKLEARN = Package("scikit-learn", "CC BY 2.0")  # of Python's package index

TRAIN = {
    "Picture_1A_by_freespace.jpg": OLD_LOMIRI,
    "Wine_by_Jakkub_Mede.jpg": OLD_LOMIRI,
    "friends_by_Aitzol_Berasategi.jpg": OLD_LOMIRI,
    "life_by_Aitzol_Berasategi.jpg": OLD_LOMIRI,
    "picosdeeuropa_by_Aitzol_Berasategi.jpg": OLD_LOMIRI,
    "sunset_by_Aitzol_Berasategi.jpg": OLD_LOMIRI,
    "Bridge_by_Sander_Klootwijk.jpg": SHARED_LOMIRI,
    "free_by_Peter_Nerlich.jpg": SHARED_LOMIRI,
    "greentock_by_Peter_Nerlich.jpg": SHARED_LOMIRI,
    **dict.fromkeys(("Aqua.jpg", "Blinds.jpg", "Garden.jpg", "LadyBird.jpg", "Storm.jpg", "TwoWings.jpg"), MATE),
    **dict.fromkeys(("Wood.jpg", "YellowFlower.jpg"), MATE),
    **dict.fromkeys(
        ("BytheWater", "ColdRipple", "ColorfulCups", "DarkestHour", "Grey", "Kite", "OneStandsOut"), PLASMA
    ),
    **dict.fromkeys(("Path", "summer_1am"), PLASMA),
}
STOP = {  # a tenth: on these it is chosen when to stop
    "aitzgorri_by_Aitzol_Berasategi.jpg": OLD_LOMIRI,
    "Picture_0B_by_freespace.jpg": OLD_LOMIRI,
    "GreenMeadow.jpg": MATE,
    "EveningGlow": PLASMA,
}
JUDGE = {
    "sklearn": dict.fromkeys(("china.jpg", "flower.jpg"), SKLEARN),  # looked at while the network was trained
    # By authors of whom nothing else is here.
    "large": {
        "Kleiber_by_Lukas_Baubkus.jpg": LOMIRI,
        "Dragonfly_by_Bolly.jpg": SHARED_LOMIRI,
        "seeding_by_Clements_Engelhardt.jpg": FREE_LOMIRI,
        "Dune.jpg": MATE,
        "RainDrops.jpg": MATE,
        "FallenLeaf": PLASMA,
    },
}


def main() -> None:
    """Fetch the packages."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="where the pictures are put")
    fetch_photographs(parser.parse_args().folder)


def fetch_photographs(folder: Path) -> None:
    """Fetch what is missing in a folder, all pictures of a package by their names."""
    wanted = TRAIN | STOP | JUDGE["large"]
    missing = {package.name for name, package in wanted.items() if not picture_path(folder, name).exists()}
    if missing and shutil.which("apt-get") is None:
        raise EldataError(f"{folder}: photographs are missing, and only apt-get of Debian or Ubuntu brings them")
    folder.mkdir(parents=True, exist_ok=True)
    for package in sorted(missing):
        with tempfile.TemporaryDirectory() as work:
            subprocess.run(["apt-get", "download", package], cwd=work, check=True)  # noqa: S603, S607 # names of ours
            (archive,) = Path(work).glob("*.deb")
            subprocess.run(["dpkg-deb", "-x", archive, work], check=True)  # noqa: S603, S607
            for name in (name for name, (place, _) in wanted.items() if place == package):
                found = [path for path in Path(work).rglob("*.jpg") if name in (path.name, path.parts[-4])]
                if not found:
                    raise EldataError(f"{package} of this system has no picture {name}; Debian 12's has it")
                # Of a wallpaper in several sizes, the largest.
                with atomic_write(picture_path(folder, name)) as file:
                    file.write(max(found, key=lambda path: path.stat().st_size).read_bytes())


def picture_path(folder: Path, name: str) -> Path:
    """Return the path of a picture, in the folder or in an installed scikit-learn; it need not exist."""
    if name in JUDGE["sklearn"]:
        found = find_spec("sklearn")
        if found is not None and found.origin is not None:
            return Path(found.origin).parent / "datasets" / "images" / name
    return folder / f"{Path(name).stem}.jpg"


@lru_cache(maxsize=256)
def photograph_radiance(path: Path, times: int, is_curved: bool = False) -> NDArray[np.float16]:
    """Return a photograph as linear light, (3, h, w), sRGB primaries, 0 to 1.

    Parameters
    ----------
    path
        Of the picture.
    times
        So many pixels a side are averaged to one, in linear light: enough that no block of the JPEG and no trace of
        demosaicing is left.
    is_curved
        Undo a camera's contrast curve too, 3 x^2 - 2 x^3, as T. Brooks et al., "Unprocessing Images for Learned Raw
        Denoising", CVPR 2019, have it.
    """
    with Image.open(path) as image:
        srgb = np.asarray(image.convert("RGB"))
    height, width = (side // times * times for side in srgb.shape[:2])
    curve = np.arange(256) / 255.0
    if is_curved:
        curve = 0.5 - np.sin(np.arcsin(1 - 2 * curve) / 3)
    light = np.asarray(linear_light(255 * curve), np.float32)[srgb[:height, :width]]
    parts = light.reshape(height // times, times, width // times, times, 3)
    return np.ascontiguousarray(parts.mean(axis=(1, 3)).transpose(2, 0, 1)).astype(np.float16)


if __name__ == "__main__":
    main()
