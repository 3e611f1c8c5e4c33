"""`eldata completion`: commands, options and names at the TAB key."""

from __future__ import annotations

from eldata.base import console
from eldata.base.completion import add_completion, completion_script


def add_parser(commands: console.Commands) -> None:
    """Add this command."""
    what = "names of datasets, protocols, cameras and profiles (those that packages register too), and files"
    add_completion(commands, "eldata", what, run)


def run(arguments: console.Arguments) -> int:
    """Run this command."""
    from eldata.cli.main import parser
    from eldata.manifest.catalogue import carded_names, known_names, shipped_card
    from eldata.noise.profile_files import shipped_profiles
    from eldata.protocols.named import FAMILIES, PROTOCOLS

    protocols = (*PROTOCOLS, *FAMILIES)
    cameras = dict.fromkeys(camera for name in carded_names() for camera in shipped_card(name).cameras)
    names = {
        "dataset": known_names(),
        "manifests": known_names(),
        "protocol": protocols,
        "cameras": tuple(cameras),
        "camera": shipped_profiles(),
        "profile": shipped_profiles(),
        "profiles": shipped_profiles(),
    }
    print(completion_script(parser(), arguments.shell, names))
    return console.OK
