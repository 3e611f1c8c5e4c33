"""Print, as a constraints file for pip, the oldest release that pyproject.toml allows of whatever eldata runs with.

    python .ci/lowest.py > lowest.txt && pip install --constraint lowest.txt '.[dev]'

The tools of the extra ``dev`` alone are left out: nobody runs eldata with them.
"""

from __future__ import annotations

import re
import sys
import tomllib
from pathlib import Path

PROJECT = Path(__file__).parents[1] / "pyproject.toml"
_REQUIREMENT = re.compile(r"(?P<name>[A-Za-z0-9._-]+)(\[[^\]]*\])?>=(?P<floor>[0-9.]+)")


def floors(text: str) -> dict[str, str]:
    """Return the floor of each dependency and of each extra's packages, from the text of pyproject.toml.

    Raises
    ------
    ValueError
        If a requirement is not a name and a floor, or one name has two floors.
    """
    project = tomllib.loads(text)["project"]
    extras = {name: packages for name, packages in project["optional-dependencies"].items() if name != "dev"}
    found: dict[str, str] = {}
    for requirement in [*project["dependencies"], *(package for packages in extras.values() for package in packages)]:
        match = _REQUIREMENT.fullmatch(requirement)
        if match is None:
            raise ValueError(f"pyproject.toml: expected a requirement such as name>=1.2, found {requirement!r}")
        name, floor = match["name"], match["floor"]
        if found.setdefault(name, floor) != floor:
            raise ValueError(f"pyproject.toml: {name} has two floors, {found[name]} and {floor}; give it one")
    return found


if __name__ == "__main__":
    for line in sorted(f"{name}=={floor}" for name, floor in floors(PROJECT.read_text(encoding="utf-8")).items()):
        sys.stdout.write(f"{line}\n")
