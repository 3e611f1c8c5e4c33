"""The house rules, read from the sources: who imports whom, what names mean, what is typed once, what never occurs."""

from __future__ import annotations

import ast
import importlib
import json
import subprocess
import sys
import zipfile
from collections import defaultdict
from dataclasses import dataclass
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.waiting import PATIENCE_S

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from tests.trees import Tree

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


def imports_of(tree: ast.AST, package: str) -> Iterator[tuple[str, bool]]:
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
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parents = package.split(".")[: len(package.split(".")) - node.level + 1]
                base = ".".join([*parents, *([node.module] if node.module else [])])
            names = [base if a.name.startswith("__") else f"{base}.{a.name}" for a in node.names]
        else:
            continue
        yield from ((name, id(node) not in typing) for name in names if name.split(".")[0] in ("eldata", "capture"))


@cache
def imports() -> list[Import]:
    return [
        Import(module, name, runtime)
        for module, tree in trees().items()
        for name, runtime in imports_of(tree, package_of(module))
    ]


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
from . import card
def function():
    from ..raw import reading
if TYPE_CHECKING:
    from eldata.records import Sensor
"""
    assert sorted(imports_of(ast.parse(source), "eldata.manifest")) == [
        ("eldata", True),
        ("eldata.manifest", True),
        ("eldata.manifest.card", True),
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
# Rooms that only these import.
ONLY_FOR = {
    "eldata.cli": (),
    "eldata.examples": ("eldata.cli",),
    "eldata.demo": ("eldata.examples", "eldata.cli"),
    "eldata.download": ("eldata.cli",),
    "capture": (),
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
    wrong = {
        (a, b) for room, allowed in ONLY.items() for a, b in crossings() if below(a, room) and not below(b, *allowed)
    }
    wrong |= {
        (a, b) for room, users in ONLY_FOR.items() for a, b in crossings() if below(b, room) and not below(a, *users)
    }
    assert wrong == set()


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


def statistics_of(tree: ast.AST) -> set[str]:
    calls = {node.func for node in ast.walk(tree) if isinstance(node, ast.Call)}
    return {call.attr for call in calls if isinstance(call, ast.Attribute)} & STATISTICS


def test_reports_compute_nothing() -> None:
    assert statistics_of(ast.parse("limit = np.quantile(values, 0.9) + values.mean()")) == {"quantile", "mean"}
    wrong = []
    for module, tree in trees().items():
        if not below(module, "eldata.reports", "eldata.plots"):
            continue
        imported = {defining(item.name) for item in imports() if item.importer == module and item.runtime}
        wrong += [(module, name) for name in imported if name != "eldata" and not below(name, *SHOWN)]
        wrong += [(module, name) for name in libraries_of(tree) - LIBRARIES]
        wrong += [(module, name) for name in statistics_of(tree) if module not in MAKES_PIXELS]
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

BANNED_CALLS = {
    *("eval", "exec", "pickle.load", "pickle.loads", "pickle.Unpickler"),  # run what a file says
    *("np.random.seed", "numpy.random.seed", "random.seed", "torch.manual_seed"),  # change everybody's random numbers
    "os.system",
}
BANNED_KEYWORDS = {"allow_pickle=True", "weights_only=False", "shell=True"}


def banned_in(tree: ast.AST) -> list[str]:
    """The constructs that this project does without; an assert is gone under ``python -O``."""
    banned = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Assert):
            banned.append("assert")
        elif isinstance(node, ast.ImportFrom) and node.module in ("pickle", "_pickle", "dill", "cloudpickle"):
            banned.append(f"from {node.module} import")
        elif isinstance(node, ast.Call):
            banned += {dotted(node.func)} & BANNED_CALLS
            banned += {ast.unparse(keyword) for keyword in node.keywords} & BANNED_KEYWORDS
    return banned


def test_banned_constructs_do_not_occur() -> None:
    for source in (
        "assert path",
        "pickle.load(file)",
        "from pickle import load",
        "np.load(path, allow_pickle=True)",
        "def f():\n    np.random.seed(0)",
    ):
        assert len(banned_in(ast.parse(source))) == 1, source
    assert {module: banned_in(tree) for module, tree in trees().items() if banned_in(tree)} == {}


# --- light commands -----------------------------------------------------------------------------------------------

# Runs each of some pieces of code in one interpreter, and says after each which heavy packages are loaded.
PROBE = """
import contextlib, io, json, sys
for code in json.loads(sys.argv[1]):
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        exec(code, {'sys': sys})
    heavy = [name for name in ('rawpy', 'torch') if name in sys.modules]
    print(json.dumps([code, heavy, printed.getvalue()]))
"""


def loaded_after(*codes: str, cwd: Path | None = None) -> list[list[str]]:
    """Which heavy packages a fresh interpreter has loaded after each piece of code, the earlier ones included."""
    command = [sys.executable, "-c", PROBE, json.dumps(codes)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, cwd=cwd or ROOT)
    assert done.returncode == 0, done.stderr
    answers = [json.loads(line) for line in done.stdout.splitlines()]
    assert [code for code, _, _ in answers] == list(codes)
    return [heavy for _, heavy, _ in answers]


# What no help needs.
HEAVY = ("rawpy", "torch", "matplotlib", "jinja2", "numba", "py7zr", "requests", "pooch")
EVERY_MANIFEST_NAME = "import eldata.manifest\nfor name in eldata.manifest.__all__: getattr(eldata.manifest, name)"
# Every subcommand, and those of subcommands, with --help.
EVERY_HELP = """
import importlib
from tests.without_posix import commands
command_line = importlib.import_module('{package}.main')
for command in commands(command_line.parser()):
    code = command_line.main([*command, '--help'])
    heavy = [name for name in {heavy} if name in sys.modules]
    if code or heavy: raise SystemExit(f'{{command}} --help: code {{code}}, loads {{heavy}}')
"""


def test_imports_and_help_load_neither_torch_nor_rawpy() -> None:
    """And capture plans without either; the probe sees what is loaded."""
    light = [
        *("import eldata", "import eldata.records", "import eldata.manifest", EVERY_MANIFEST_NAME, "import capture"),
        *(EVERY_HELP.format(package=package, heavy=HEAVY) for package in ("eldata.cli", "capture.cli")),
        "from eldata.cli.main import main; main(['info']); main(['download', 'eld'])",
        "from capture import RELEASED, plan_calibration; from capture.camera import EXAMPLE; RELEASED.frames()",
    ]
    *found, last = loaded_after(*light, "import rawpy")
    assert found == [[]] * len(light)
    assert last == ["rawpy"]


def test_verify_loads_what_its_level_needs(pristine: Tree) -> None:
    common = ["verify", str(pristine.csv), "--root", str(pristine.root), "--jobs", "1", "--level"]
    codes = [f"from eldata.cli.main import main; main({[*common, level]!r})" for level in ("quick", "metadata", "full")]
    assert loaded_after(*codes) == [[], ["rawpy"], ["rawpy"]]


# --- the wheel ----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=PATIENCE_S)
    assert done.returncode == 0, done.stderr
    (built,) = folder.glob("eldata-*.whl")
    return built


def test_the_wheel_holds_what_it_must_and_nothing_else(wheel: Path) -> None:
    names = set(zipfile.ZipFile(wheel).namelist())
    sources = [*(ROOT / "eldata").rglob("*.py*"), *(ROOT / "capture").rglob("*.py*")]
    ours = {path.relative_to(ROOT).as_posix() for path in sources if path.suffix in (".py", ".pyi")}
    assert "eldata/__init__.pyi" in ours
    data = {"eldata/py.typed", "capture/py.typed", "eldata/protocols/shipped.toml", "capture/check/kinds.toml"}
    assert {*ours, *data, "eldata/baselines/noise_aware.safetensors"} <= names
    assert {name.split("/")[0].split("-")[0] for name in names} == {"eldata", "capture"}
    # A script among the manifests would overwrite the installed ones when it is run, and is importable as ours.
    folder = ROOT / "manifests"
    files = [*folder.glob("*.csv"), *folder.glob("*.json"), *(folder / "published").iterdir()]
    held = {path.relative_to(folder).as_posix() for path in files}
    assert {f"{name}.{kind}" for name in ("eld", "sid-sony", "sid-fuji", "drv") for kind in ("csv", "json")} <= held
    start = "eldata/manifest/shipped/"
    assert {name.removeprefix(start) for name in names if name.startswith(start)} == held
    assert not [name for name in names if "__pycache__" in name or "tests" in name.split("/")]
    suffixes = {Path(name).suffix for name in names if "dist-info" not in name}
    data = {".css", ".csv", ".html", ".js", ".json", ".mplstyle", ".safetensors", ".sh", ".toml"}
    assert suffixes <= {".py", ".pyi", ".typed"} | data


def test_the_wheel_works_away_from_the_sources(wheel: Path, tmp_path: Path) -> None:
    """An installed package has its manifests inside; a checkout has them beside."""
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path)
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
