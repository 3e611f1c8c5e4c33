"""Run as a program: our code as a system without the modules and calls of POSIX would see it, such as Windows.

Only imports that our own modules make fail. The standard library of this system cannot do without them.
"""

from __future__ import annotations

import argparse
import builtins
import contextlib
import importlib
import io
import mmap
import multiprocessing.reduction
import os
import pkgutil
import signal
import sys
from collections.abc import Iterator
from typing import Any

OURS = ("eldata", "capture")
MODULES = frozenset({"fcntl", "grp", "pty", "pwd", "resource", "termios", "tty"})
MISSING = (
    (os, ("O_CLOEXEC", "killpg", "memfd_create", "pread", "preadv", "pwrite", "register_at_fork", "sched_getaffinity")),
    (os, ("MFD_CLOEXEC", "statvfs")),
    (mmap, ("MAP_ANONYMOUS", "MAP_PRIVATE")),
    (signal, ("SIGKILL",)),
    (multiprocessing.reduction, ("DupFd",)),
)


def take_away() -> None:
    """Let this process have nothing of :data:`MODULES` and :data:`MISSING` from now on, as far as we import it."""
    imported = builtins.__import__

    def import_(name: str, globals_: Any = None, *rest: Any) -> Any:
        importer = str((globals_ or {}).get("__name__"))
        if name in MODULES and importer.split(".", maxsplit=1)[0] in OURS:
            raise ImportError(f"No module named {name!r}, which {importer} imports")
        return imported(name, globals_, *rest)

    setattr(builtins, "__import__", import_)  # noqa: B010 # typed as if it could not be replaced
    for module, names in MISSING:
        for name in names:
            if hasattr(module, name):
                delattr(module, name)


def import_everything() -> None:
    for package in OURS:
        found = importlib.import_module(package)
        for module in pkgutil.walk_packages(found.__path__, f"{package}."):
            if not module.name.endswith("__main__"):
                importlib.import_module(module.name)


def commands(
    parser: argparse.ArgumentParser, words: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], argparse.ArgumentParser]]:
    """Yield the words and the parser of each command, and of each command's commands."""
    yield words, parser
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for name, below in action.choices.items():
                yield from commands(below, (*words, name))


def show_help(program: str) -> int:
    """Ask each command of a program for help; return how many there are."""
    main = importlib.import_module(f"{program}.cli.main")
    every = list(commands(main.parser()))
    for words, _ in every:
        with contextlib.redirect_stdout(io.StringIO()) as shown:
            main.main([*words, "--help"])
        if f"usage: {program}" not in shown.getvalue():
            raise SystemExit(f"{program} {' '.join(words)} --help printed {shown.getvalue()!r}")
    return len(every)


def main() -> None:
    import_everything()  # and what our modules rest on, which may use all that this system has
    for name in [name for name in sys.modules if name.split(".")[0] in OURS]:
        del sys.modules[name]
    take_away()
    print("helps", show_help("eldata"), show_help("capture"))
    import_everything()


if __name__ == "__main__":
    main()
