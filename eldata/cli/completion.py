"""`eldata completion`: print the script that lets your shell complete commands, options and names.

Print the script with which a shell completes commands, options, names of datasets, protocols, cameras and profiles
(those that packages register too), and files. Keep it where the shell looks for such scripts; print it again after an
update. The first example is for the session that runs it.

    eval "$(eldata completion bash)"
    eldata completion bash > ~/.local/share/bash-completion/completions/eldata
    eldata completion fish > ~/.config/fish/completions/eldata.fish
"""

from __future__ import annotations

from eldata.base import console
from eldata.base.completion import SHELLS, completion_script


def add_options(parser: console.Parser) -> None:
    """Add its options."""
    parser.add_argument("shell", choices=SHELLS, help="for which shell")
    console.add_shared(parser, run)


def run(arguments: console.Arguments) -> int:
    """Run this command."""
    from eldata.cli.main import parser
    from eldata.manifest.catalogue import carded_names, known_names, shipped_card
    from eldata.noise.gain_modes import shipped_profiles
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
