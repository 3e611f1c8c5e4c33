"""Print docs/licences.md: the licence of every package that requirements-dev.txt locks, as the installed ones state it.

make licences
"""

from __future__ import annotations

import re
import sys
import tomllib
from importlib import metadata
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[1]
LOCK = ROOT / "requirements-dev.txt"

# Packages whose metadata hold the licence's whole text, or nothing; where it was read.
STATED = {
    "exifread": "BSD-3-Clause",  # its licence field, in full
    "hdf5plugin": "MIT",  # LICENSE; its compressors have their own, in doc/information.rst
    "kiwisolver": "BSD-3-Clause",  # its licence field, in full
    "matplotlib": "PSF-based, as BSD",  # its licence field, in full
    "scikit-image": "BSD-3-Clause",  # its licence field, in full
    "scipy": "BSD-3-Clause",  # its licence field, in full
    "cycler": "BSD-3-Clause",  # its licence field, in full
    "colorama": "BSD-3-Clause",  # LICENSE.txt; installed on Windows alone
}
_LONGEST = 60

HEAD = """# Licences of the dependencies

eldata is under the [MIT licence](../LICENSE). It is installed with the packages below and contains none of their code.
`make licences` writes this page from the metadata of the locked packages.

A wheel may bring compiled libraries: rawpy LibRaw (LGPL-2.1 or CDDL-1.0), h5py HDF5 (a BSD licence), imagecodecs and
hdf5plugin a library for each codec, numpy and scipy OpenBLAS (BSD-3-Clause) and, on Linux, the runtime of GCC (GPL-3.0
with its exception for runtimes). Their texts are in each wheel's folder `*.dist-info`, or where that says.

"""


def locked(text: str) -> dict[str, str]:
    """Return the version of each package that a lock file's text has for the running Python, and of torch."""
    found = {}
    for line in text.splitlines():
        if re.match(r"[A-Za-z0-9]", line):
            requirement = Requirement(line.rstrip("\\ "))
            if requirement.marker is None or requirement.marker.evaluate():
                (specifier,) = requirement.specifier
                found[canonicalize_name(requirement.name)] = specifier.version
    return found


def licence_of(name: str) -> str | None:
    """Return the licence that an installed package states, or nothing."""
    if name in STATED:
        return STATED[name]
    about = metadata.metadata(name)
    stated = [about.get("License-Expression"), about.get("License")]
    for text in stated:
        if text is not None and text.strip() and len(text) <= _LONGEST and "\n" not in text:
            return " ".join(text.split())
    classifiers = [line for line in about.get_all("Classifier") or [] if line.startswith("License :: ")]
    names = [line.rpartition(" :: ")[2] for line in classifiers if line != "License :: OSI Approved"]
    return ", ".join(names) or stated[0]


def needed(names: list[str]) -> set[str]:
    """Return the packages that some requirements need, with all that those need, on this machine."""
    found: set[str] = set()
    waiting = [Requirement(name) for name in names]
    while waiting:
        one = waiting.pop()
        name = canonicalize_name(one.name)
        key = name + "".join(sorted(one.extras))
        if key in found:
            continue
        found |= {key, name}
        for text in metadata.requires(name) or []:
            inner = Requirement(text)
            if inner.marker is None or any(inner.marker.evaluate({"extra": extra}) for extra in (*one.extras, "")):
                waiting.append(inner)
    return found


def page(project: dict[str, object], lock: str) -> str:
    """Return docs/licences.md."""
    extras = dict(project["optional-dependencies"])  # type: ignore[call-overload] # a table of lists
    dev = extras.pop("dev")
    groups = [("eldata", needed(list(project["dependencies"])))]  # type: ignore[call-overload] # a list of texts
    groups += [(f"extra `{name}`", needed(packages)) for name, packages in extras.items()]
    groups += [("development", needed([*dev, "hatchling"]))]
    kinds: dict[tuple[str, str], list[str]] = {}
    for name in sorted({*locked(lock), "torch"}):
        use = next((group for group, packages in groups if name in packages), "development")
        kinds.setdefault((use, licence_of(name) or "unknown"), []).append(name)
    order = {group: number for number, (group, _) in enumerate(groups)}
    lines = ["| for | licence | packages |", "|---|---|---|"]
    for use, licence in sorted(kinds, key=lambda kind: (order[kind[0]], kind[1])):
        lines.append(f"| {use} | {licence} | {', '.join(kinds[use, licence])} |")
    return HEAD + "\n".join(lines) + "\n"


if __name__ == "__main__":
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    sys.stdout.write(page(project, LOCK.read_text(encoding="utf-8")))
