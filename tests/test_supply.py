"""What is installed: every package at one version with its hashes, for every Python and system, and its licence."""

from __future__ import annotations

import re
import tomllib
from importlib import metadata
from itertools import product
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from tests.cases import in_one_test
from tests.test_project import PROJECT, script

ROOT = Path(__file__).parents[1]
LOCK = (ROOT / "requirements-dev.txt").read_text(encoding="utf-8")
LICENCES = (ROOT / "docs" / "licences.md").read_text(encoding="utf-8")
CONSTRAINTS = [
    Requirement(line) for line in (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines() if line[0] != "#"
]
PYTHONS = ("3.11", "3.12", "3.13", "3.14")
SYSTEMS = ("linux", "darwin", "win32")


def entries() -> list[tuple[Requirement, list[str]]]:
    """Each package of the lock file, with its hashes."""
    blocks = re.findall(r"^([^#\s].*?)((?: \\\n    \S+)*)$", LOCK, re.MULTILINE)
    return [(Requirement(text), hashes.replace("\\", "").split()) for text, hashes in blocks]


def locked(python: str, system: str) -> dict[str, str]:
    """Version of each package that is installed on a Python and a system."""
    environment = {"python_version": python, "python_full_version": f"{python}.0", "sys_platform": system}
    environment |= {"platform_python_implementation": "CPython", "implementation_name": "cpython"}
    found: dict[str, str] = {}
    for requirement, _ in entries():
        if requirement.marker is None or requirement.marker.evaluate(environment):
            name = canonicalize_name(requirement.name)
            assert name not in found, "two versions of one package"
            (specifier,) = requirement.specifier
            assert specifier.operator == "=="
            found[name] = specifier.version
    return found


def test_every_package_has_hashes_and_no_host() -> None:
    assert len(entries()) > 90
    for requirement, hashes in entries():
        assert hashes, requirement
        assert all(re.fullmatch(r"--hash=sha256:[0-9a-f]{64}", one) for one in hashes), requirement
    assert not re.search("://|--index|--find-links", LOCK)


def asked() -> list[Requirement]:
    """What pyproject.toml asks for, its extras included."""
    project = PROJECT["project"]
    extras = [line for packages in project["optional-dependencies"].values() for line in packages]
    return [Requirement(line) for line in (*project["dependencies"], *extras)]


@in_one_test("python, system", product(PYTHONS, SYSTEMS))
def test_all_that_pyproject_asks_for_is_locked_and_keeps_to_the_constraints(python: str, system: str) -> None:
    held = locked(python, system)
    for requirement in (*asked(), *map(Requirement, PROJECT["build-system"]["requires"]), *CONSTRAINTS):
        name = canonicalize_name(requirement.name)
        assert name == "torch" or requirement.specifier.contains(held[name]), requirement
    assert {requirement.name for requirement in CONSTRAINTS} >= {"torch", "pooch", "mypy", "ruff"}


def test_what_torch_needs_is_locked_though_torch_is_not() -> None:
    """Its needs are written down for the resolver; they are those that the installed one states."""
    assert "torch" not in locked("3.11", "linux")
    config = tomllib.loads((ROOT / ".ci" / "uv.toml").read_text(encoding="utf-8"))
    (torch,) = config["dependency-metadata"]
    (pinned,) = [one for one in CONSTRAINTS if one.name == "torch"]
    assert str(pinned.specifier) == f"=={torch['version']}"
    for text in torch["requires-dist"]:
        assert Requirement(text).specifier.contains(locked("3.11", "linux")[canonicalize_name(Requirement(text).name)])
    if metadata.version("torch").partition("+")[0] == torch["version"]:
        stated = [Requirement(text) for text in metadata.requires("torch") or []]
        plain = {str(one) for one in stated if one.marker is None}
        assert plain <= {str(Requirement(text)) for text in torch["requires-dist"]}


def test_make_and_the_workflows_install_what_is_locked() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    workflows = [path.read_text(encoding="utf-8") for path in (ROOT / ".github" / "workflows").glob("*.yml")]
    options = "--no-deps --require-hashes --only-binary :all: --requirement requirements-dev.txt"
    assert options in makefile
    assert all(options in text for text in workflows)


# --- licences -----------------------------------------------------------------------------------------------------


def rows() -> dict[str, str]:
    """Licence of each package, as the page has it: a row for each use and licence."""
    found = re.findall(r"^\| ([^|]*) \| ([^|]*) \| ([^|]*) \|$", LICENCES, re.MULTILINE)
    return {name: licence for use, licence, names in found if use != "for" for name in names.split(", ")}


def test_every_dependency_has_a_known_licence() -> None:
    assert {canonicalize_name(requirement.name) for requirement in asked()} <= set(rows())
    assert set(locked("3.11", "linux")) | {"torch"} == set(rows())
    assert [name for name, licence in rows().items() if licence in ("", "unknown", "None")] == []


def test_the_licences_are_those_that_the_installed_packages_state() -> None:
    """Of the packages whose locked version is installed: other versions may state it in other words."""
    licences = script("licences")
    installed: dict[str, str] = {
        canonicalize_name(package.name): package.version for package in metadata.distributions()
    }
    same = [name for name, version in locked("3.11", "linux").items() if installed.get(name) == version]
    if not same:
        pytest.skip("no package is installed at its locked version")
    assert {name: licences.licence_of(name) for name in same} == {name: rows()[name] for name in same}
