"""The house rules, read from the sources: who imports whom, what names mean, what is typed once, what never occurs."""

from __future__ import annotations

import ast
import importlib
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import zipfile
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

import eldata
from tests.trees import Tree
from tests.waiting import PATIENCE_S

ROOT = Path(__file__).parents[1]
EVERY = sorted(path for room in ("eldata", "capture") for path in (ROOT / room).rglob("*.py"))
PATHS = [path for path in EVERY if path.name != "__main__.py"]  # which `python -m` alone runs


@dataclass(frozen=True)
class Import:
    """One imported name; ``runtime`` is false where only type checkers see it."""

    importer: str
    name: str
    runtime: bool


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@cache  # and not at the top: every worker process collects this file, and parsing takes seconds
def trees() -> dict[str, ast.Module]:
    return {module_name(path): ast.parse(path.read_text(encoding="utf-8")) for path in PATHS}


PACKAGES = {module_name(path) for path in PATHS if path.name == "__init__.py"}


def package_of(module: str) -> str:
    return module if module in PACKAGES else module.rpartition(".")[0]


def imports_of(tree: ast.AST) -> Iterator[tuple[str, bool]]:
    """Every name of ours that code imports, wherever it does, and whether it does so when it runs.

    ``from eldata import manifest`` counts as ``eldata.manifest``, ``from eldata import __version__`` as ``eldata``.
    """
    typing = {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
        for statement in node.body
        for inner in ast.walk(statement)
    }
    for node in ast.walk(tree):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.module, "an import says where from"
            assert not node.level
            names = [node.module if a.name.startswith("__") else f"{node.module}.{a.name}" for a in node.names]
        yield from ((name, id(node) not in typing) for name in names if name.split(".")[0] in ("eldata", "capture"))


@cache
def imports() -> list[Import]:
    return [Import(module, name, runtime) for module, tree in trees().items() for name, runtime in imports_of(tree)]


@cache
def exports(package: str) -> dict[str, str]:
    """Name of each thing that a package's stub exports: the module that it names."""
    stub = ROOT / Path(*package.split(".")) / "__init__.pyi"
    if package not in PACKAGES or not stub.exists():
        return {}
    names = {}
    for line in ast.parse(stub.read_text(encoding="utf-8")).body:
        if not isinstance(line, ast.ImportFrom) or line.module is None:  # the packages themselves
            continue
        for alias in line.names:
            assert alias.asname == alias.name, f"{alias.name}: type checkers take 'import x as x' as an export"
            names[alias.name] = f"{package}.{line.module}"
    return names


def defining(name: str) -> str:
    """The module that an imported name comes from: through the stubs, which load it lazily, to where it is defined."""
    parent, _, last = name.rpartition(".")
    if name in trees() or not parent:
        return name
    if last in exports(parent):
        return defining(f"{exports(parent)[last]}.{last}")
    return defining(parent)


def below(name: str, *places: str) -> bool:
    return any(name == place or name.startswith(f"{place}.") for place in places)


def test_the_scan_finds_modules_and_every_kind_of_import() -> None:
    """Or every test below would pass on nothing."""
    assert len(trees()) > 200
    assert defining("eldata.metrics.psnr") == "eldata.metrics.image_score"
    source = """
import eldata.raw.levels, numpy
from eldata import __version__, manifest
def function():
    from eldata.raw import reading
if TYPE_CHECKING:
    from eldata.records import Sensor
"""
    assert sorted(imports_of(ast.parse(source))) == [
        ("eldata", True),
        ("eldata.manifest", True),
        ("eldata.raw.levels", True),
        ("eldata.raw.reading", True),
        ("eldata.records.Sensor", False),
    ]


# --- one-way imports ----------------------------------------------------------------------------------------------

# From bottom to top. A room imports from the rows above its own in this table, neither from below nor from its own row.
LAYERS = (
    ("eldata.errors",),
    ("eldata.records",),
    ("eldata.base",),
    ("eldata.raw",),
    ("eldata.manifest",),
    ("eldata.metrics", "eldata.isp", "eldata.plots", "eldata.download"),
    ("eldata.noise", "eldata.protocols"),
    ("eldata.sources",),
    ("eldata.datasets",),
    ("eldata.evaluation", "eldata.calibration"),
    ("eldata.reports", "eldata.integrations", "eldata.baselines"),
    ("eldata.demo",),
    ("eldata.examples",),
    ("eldata.cli",),
)
LEVEL = {room: level for level, rooms in enumerate(LAYERS) for room in rooms}

# Rooms that need less than all that lies under them.
ONLY = {
    "eldata.metrics": ("eldata.errors", "eldata.base"),
    # It states response curves, which are read as the ISP reads them.
    "eldata.protocols": ("eldata.errors", "eldata.base", "eldata.metrics", "eldata.isp", "eldata.manifest.card"),
    "eldata.isp": ("eldata.errors", "eldata.records", "eldata.base", "eldata.raw"),
    "eldata.plots": ("eldata.errors", "eldata.base"),  # it draws numbers, and knows no room's records
    "eldata.download": ("eldata.errors", "eldata.records", "eldata.base", "eldata.manifest"),
    "capture": (
        *("eldata.errors", "eldata.records", "eldata.base", "eldata.raw", "eldata.manifest"),
        *("eldata.isp.rendering", "eldata.reports.html"),  # the pictures and the page of its own sheets
    ),
}


def room_of(module: str) -> str:
    parts = module.split(".")
    return "capture" if parts[0] == "capture" else ".".join(parts[:2])


@cache
def edges() -> set[tuple[str, str]]:
    """Importing module and defining module of every import."""
    return {(i.importer, defining(i.name)) for i in imports() if i.name != "eldata"}


def crossings() -> set[tuple[str, str]]:
    """Importing and imported module of every import that leaves its room; anybody may state the version."""
    return {(a, b) for a, b in edges() if room_of(a) != room_of(b) and a != "eldata"}


def test_nothing_is_imported_upwards() -> None:
    assert {room_of(module) for module in trees()} == {*LEVEL, "capture", "eldata"}
    upwards = {
        (a, b)
        for a, b in crossings()
        if room_of(a) != "capture" and LEVEL.get(room_of(b), len(LAYERS)) >= LEVEL[room_of(a)]
    }
    assert upwards == set()


def test_some_rooms_need_less() -> None:
    """And only the command downloads."""
    assert {
        (a, b) for room, allowed in ONLY.items() for a, b in crossings() if below(a, room) and not below(b, *allowed)
    } == set()
    assert {a for a, b in crossings() if below(b, "eldata.download") and not below(a, "eldata.cli")} == set()


def test_nobody_imports_through_the_public_front() -> None:
    """``from eldata import verify`` inside of the package would load half of it; examples show it."""
    through = {
        (i.importer, i.name)
        for i in imports()
        if i.name.rpartition(".")[0] == "eldata" and i.name not in trees() and not below(i.importer, "eldata.examples")
    }
    assert through == set()


def circle(edges: Iterable[tuple[str, str]]) -> list[str]:
    """One circle of a graph, or nothing."""
    graph: dict[str, set[str]] = defaultdict(set)
    for start, end in edges:
        if start != end:
            graph[start].add(end)
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


def test_there_is_no_circle() -> None:
    """Imports for types and inside of functions count; a package's stub, which loads nothing by itself, does not."""

    def place(module: str) -> str:
        return module if package_of(module) == "eldata" else package_of(module)

    assert circle([("a", "a"), ("a", "b"), ("b", "c"), ("c", "b")]) in (["b", "c", "b"], ["c", "b", "c"])
    assert circle(edges()) == []
    assert circle((place(a), place(b)) for a, b in edges()) == []


def test_the_picture_of_the_rooms_is_true(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(ROOT / "docs" / "site")
    draw_rooms = importlib.import_module("draw_rooms")
    assert draw_rooms.PICTURE.read_text(encoding="utf-8") == draw_rooms.picture(draw_rooms.rooms_that_import()), (
        "an import between rooms has come or gone: python docs/site/draw_rooms.py draws them again"
    )


# --- reports show -------------------------------------------------------------------------------------------------

# What a page and its plots import when they run: how text, tables and files are written, and constants of results. What
# it shows is measured by the results that it is handed; to name their types it may import any room under it.
SHOWN = (
    *("eldata.errors", "eldata.records", "eldata.base", "eldata.plots", "eldata.reports"),
    # Words of results and protocols; what of a result is chosen, grouped and decoded to be looked at.
    *("eldata.evaluation.scores", "eldata.evaluation.comparison", "eldata.evaluation.looking"),
    *("eldata.metrics.registry", "eldata.protocols.words"),
)
LIBRARIES = {"numpy", "matplotlib", "jinja2", "PIL"}
STATISTICS = {
    *("mean", "nanmean", "average", "median", "quantile", "percentile", "std", "var", "cov", "corrcoef", "histogram"),
    *("interp", "polyfit", "lstsq", "solve", "rfft", "fft", "fft2", "convolve", "default_rng", "bincount", "cumsum"),
}
# Where measured arrays are turned into pixels: means of blocks, and the values that are black and white.
MAKES_PIXELS = ("eldata.plots.pictures",)


def libraries_of(tree: ast.AST) -> set[str]:
    """The top packages of what is imported that is neither ours nor the standard library's."""
    names = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    names |= {node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    return {name.split(".")[0] for name in names} - {"eldata", "capture"} - set(sys.stdlib_module_names)


def test_reports_compute_nothing() -> None:
    wrong = []
    for module, tree in trees().items():
        if not below(module, "eldata.reports", "eldata.plots"):
            continue
        imported = {defining(item.name) for item in imports() if item.importer == module and item.runtime}
        wrong += [(module, name) for name in imported if name != "eldata" and not below(name, *SHOWN)]
        wrong += [(module, name) for name in libraries_of(tree) - LIBRARIES]
        calls = {dotted(node.func) for node in ast.walk(tree) if isinstance(node, ast.Call)}
        statistics = {name for name in calls if name.rpartition(".")[2] in STATISTICS}
        wrong += [(module, name) for name in statistics if module not in MAKES_PIXELS]
    assert wrong == []


# --- text crosses a boundary once ---------------------------------------------------------------------------------

PARSERS = {"json.load", "json.loads", "tomllib.load", "tomllib.loads", "csv.reader", "csv.DictReader"}
READER = "eldata.base.fields"
WRITES = {
    "eldata.base.files": "the one writer of JSON files",
    "eldata.base.visible": "a value in a sentence",
    "eldata.protocols.protocol": "what a digest is made of",
    "eldata.reports.evaluation": "one value of a setting in a sentence",
    "eldata.sources.store.read": "a data set of an HDF5 store",
    "capture.checklist": "what a digest is made of, and a script's data",
}


def dotted(node: ast.expr) -> str:
    if isinstance(node, ast.Attribute):
        return f"{dotted(node.value)}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else "?"


def callers(names: set[str]) -> set[str]:
    return {
        module
        for module, tree in trees().items()
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and dotted(node.func) in names
    }


def test_text_is_parsed_and_written_in_one_place() -> None:
    assert callers(PARSERS) - {READER} == set()
    assert callers({"json.dump", "json.dumps"}) == set(WRITES)


# --- names --------------------------------------------------------------------------------------------------------

# Every command and every command line has one.
ENTRY_POINTS = {"main", "parser", "add_options", "run"}


def test_a_public_name_means_one_thing() -> None:
    """Of classes and functions, whatever package they are in; a stub exports them under no other name."""
    places: dict[str, set[str]] = defaultdict(set)
    for module, tree in trees().items():
        for node in ast.iter_child_nodes(tree):
            if isinstance(node, (ast.ClassDef, ast.FunctionDef)) and not node.name.startswith("_"):
                places[node.name].add(module)
    twice = {name: sorted(modules) for name, modules in places.items() if len(modules) > 1}
    assert {name: modules for name, modules in twice.items() if name not in ENTRY_POINTS} == {}


# --- constructs that do not occur ---------------------------------------------------------------------------------

# What ruff does not see: it bans asserts, eval, exec, pickles, shells and numpy's global seeds (S, NPY).
BANNED = {"torch.manual_seed", "random.seed", "allow_pickle=True", "weights_only=False"}
SILENCED = re.compile(r"noqa: (S[136]0[1-7]|NPY)")


def banned_in(tree: ast.AST) -> set[str]:
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call)]
    words = {ast.unparse(keyword) for call in calls for keyword in call.keywords}
    return BANNED & (words | {dotted(call.func) for call in calls})


def test_banned_constructs_do_not_occur() -> None:
    assert banned_in(ast.parse("random.seed(0)\nload(path, allow_pickle=True)")) == {"random.seed", "allow_pickle=True"}
    assert {module: banned_in(tree) for module, tree in trees().items() if banned_in(tree)} == {}
    assert [path for path in PATHS if SILENCED.search(path.read_text(encoding="utf-8"))] == []


# --- light commands -----------------------------------------------------------------------------------------------

# Runs each of some pieces of code in one interpreter, and says after each which heavy packages are loaded.
PROBE = """
import contextlib, io, json, sys
for code in json.loads(sys.argv[1]):
    with contextlib.redirect_stdout(io.StringIO()):
        exec(code, {'sys': sys})
    print(json.dumps([name for name in ('rawpy', 'torch') if name in sys.modules]))
"""


def loaded_after(*codes: str, cwd: Path = ROOT) -> list[list[str]]:
    """List the heavy packages that a fresh interpreter has loaded after each piece of code."""
    command = [sys.executable, "-c", PROBE, json.dumps(codes)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, cwd=cwd)
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()]


# What no help needs.
HEAVY = {"rawpy", "torch", "matplotlib", "jinja2", "numba", "py7zr", "requests", "pooch"}
EVERY_HELP = f"""
from tests.without_posix import show_help
for program in ('eldata', 'capture'): show_help(program)
assert not {HEAVY} & set(sys.modules)
"""
EVERY_MANIFEST_NAME = "import eldata.manifest\nfor name in eldata.manifest.__all__: getattr(eldata.manifest, name)"
AFRESH = "for name in [name for name in sys.modules if name.split('.')[0] == 'eldata']: del sys.modules[name]"
ALONE = "import eldata\nassert not {'eldata.metrics', 'numpy'} & set(sys.modules)"


def test_imports_help_and_verify_load_what_they_need(pristine: Tree) -> None:
    """Neither torch nor rawpy, but for pixels; capture plans without either."""
    light = [
        *(ALONE, "import eldata.records", "import eldata.manifest", EVERY_MANIFEST_NAME, "import capture", EVERY_HELP),
        "from eldata.cli.main import main; main(['info']); main(['download', 'eld'])",
        "from capture import RELEASED, plan_calibration; from capture.camera import EXAMPLE; RELEASED.frames()",
        "import eldata; eldata.metrics.psnr",  # which needs no import of its own
        "import numpy as np; from eldata.metrics import psnr; psnr(np.zeros((9, 9)), np.ones((9, 9)))",
    ]
    common = ["verify", str(pristine.csv), "--root", str(pristine.root), "--jobs", "1", "--level"]
    quick, metadata, full = (
        f"from eldata.cli.main import main; main({[*common, level]!r})" for level in ("quick", "metadata", "full")
    )
    *loaded, last = loaded_after(*light, quick, metadata, full, namesakes_are_functions())
    assert loaded == [*([[]] * len(light)), [], ["rawpy"], ["rawpy"]]
    assert last == ["rawpy", "torch"]


def namesakes_are_functions() -> str:
    """Write the code that finds each documented module, and the function of each name that a module has too.

    Importing ``eldata.manifest.verify`` sets ``eldata.manifest.verify`` to the module, if nothing prevents it.
    """
    modules = sorted(page.stem for page in (ROOT / "docs" / "reference").glob("eldata.*.rst"))
    namesakes = [
        f"{package}.{name}"
        for package in PACKAGES
        for name, module in exports(package).items()
        if (ROOT / Path(*package.split(".")) / f"{name}.py").exists() or module == f"{package}.{name}"
    ]
    assert namesakes
    imports = [f"import {name}" for name in namesakes]
    calls = [f"assert callable({name})" for name in (*namesakes, "eldata.verify")]
    return "\n".join([AFRESH, "import eldata", *modules, *imports, "eldata.ELDDataset", *calls])


# --- the wheel ----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the wheel and the source archive."""
    folder = tmp_path_factory.mktemp("built")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-t", "sdist", "-d", str(folder)]
    environment = os.environ | {"ELDATA_ADDRESS": "https://example.org/a/eldata"}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=PATIENCE_S)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture
def wheel(built: Path) -> Path:
    (path,) = built.glob("eldata-*.whl")
    return path


def test_the_source_archive_holds_what_its_tests_read(built: Path) -> None:
    (path,) = built.glob("*.tar.gz")
    with tarfile.open(path) as archive:
        held = {name.partition("/")[2] for name in archive.getnames()}
    files = ["README.md", "CHANGELOG.md", "CITATION.cff", "LICENSE", "Makefile", "constraints.txt", "pyproject.toml"]
    files += ["requirements-dev.txt", ".ci/uv.toml", ".pre-commit-config.yaml", ".ci/run", "tests/conftest.py"]
    for folder, pattern in (("docs", "**/*.md"), (".ci", "*.py"), (".github", "**/*.yml")):
        files += [file.relative_to(ROOT).as_posix() for file in (ROOT / folder).glob(pattern)]
    assert [name for name in files if name not in held] == []


def test_the_wheel_holds_the_packages_and_the_manifests_and_nothing_else(wheel: Path) -> None:
    places = [path for room in ("eldata", "capture") for path in (ROOT / room).rglob("*") if path.is_file()]
    files = {path.relative_to(ROOT).as_posix() for path in places if "__pycache__" not in path.parts}
    data = {"eldata/py.typed", "capture/py.typed", "eldata/protocols/shipped.toml", "capture/check/kinds.toml"}
    assert {*data, "eldata/__init__.pyi", "eldata/baselines/noise_aware.safetensors"} <= files
    # A script among the manifests would overwrite the installed ones when it is run, and is importable as ours.
    folder = ROOT / "manifests"
    manifests = [*folder.glob("*.csv"), *folder.glob("*.json"), *(folder / "published").iterdir()]
    files |= {f"eldata/manifest/shipped/{path.relative_to(folder).as_posix()}" for path in manifests}
    assert {name for name in zipfile.ZipFile(wheel).namelist() if "dist-info" not in name} == files


def test_links_of_the_readme_are_whole_on_a_package_index(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        (name,) = [name for name in archive.namelist() if name.endswith(".dist-info/METADATA")]
        text = archive.read(name).decode()
    assert "\nProject-URL: Issues, https://example.org/a/eldata/issues\n" in text
    links = re.findall(r"\]\(([^)]*)\)", text)
    tag = f"v{eldata.__version__}"
    images = f"https://example.org/a/eldata/raw/{tag}/docs/images/"
    assert {f"{images}contact-sheet.jpg", f"{images}evaluation.jpg"} <= {*links}
    places = [link.removeprefix(f"https://example.org/a/eldata/blob/{tag}/") for link in links if "/blob/" in link]
    assert len(places) == len(links) - 2
    assert all((ROOT / place.partition("#")[0]).is_file() for place in places)


def test_the_wheel_works_away_from_the_sources(wheel: Path, tmp_path: Path) -> None:
    """An installed package has its manifests inside; a checkout has them beside."""
    shutil.unpack_archive(wheel, tmp_path, "zip")
    code = (
        f"folder = {str(tmp_path)!r}; sys.path.insert(0, folder)\n"
        "import eldata, capture\n"
        "from eldata.manifest import shipped_manifest\n"
        "manifest = shipped_manifest('eld')\n"
        "assert str(manifest.path).startswith(folder), manifest.path\n"
        "assert str(eldata.__file__).startswith(folder), eldata.__file__\n"
        "assert len(manifest.records) == 640\n"
    )
    assert loaded_after(code, cwd=tmp_path) == [[]]
