"""The house rules: imports run one way, light commands stay light, and some constructs do not occur at all."""

from __future__ import annotations

import ast
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.trees import Tree, build_tree

if TYPE_CHECKING:
    from collections.abc import Iterator

ROOT = Path(__file__).parents[1]
MODULES = sorted([*(ROOT / "eldata").rglob("*.py"), *(ROOT / "capture").rglob("*.py")])


def test_the_modules_are_found() -> None:
    """Or every test below would pass on nothing."""
    assert len(MODULES) > 30
    assert ROOT / "capture" / "protocol.py" in MODULES


# --- light commands -----------------------------------------------------------------------------------------------


def loaded_after(code: str, *arguments: str, cwd: Path | None = None) -> set[str]:
    """Which heavy packages a fresh interpreter has loaded after some code."""
    report = "import sys; print('LOADED', *(name for name in ('torch', 'rawpy') if name in sys.modules))"
    done = subprocess.run(
        [sys.executable, "-c", f"{code}\n{report}", *arguments], capture_output=True, text=True, timeout=60, cwd=cwd
    )
    assert done.returncode == 0, done.stderr
    return set(done.stdout.splitlines()[-1].split()[1:])


EVERY_MANIFEST_NAME = "import eldata.manifest\nfor name in eldata.manifest.__all__: getattr(eldata.manifest, name)"
RUN_ELDATA = "import sys; from eldata.cli.main import main; print(main(sys.argv[1:]))"
RUN_CAPTURE = "import sys; from capture.cli import main; print(main(sys.argv[1:]))"


def test_the_probe_sees_heavy_packages() -> None:
    assert loaded_after("import rawpy") == {"rawpy"}


@pytest.mark.parametrize(
    "code", ["import eldata", "import eldata.manifest", EVERY_MANIFEST_NAME, "import capture", "import eldata.records"]
)
def test_imports_load_neither_torch_nor_rawpy(code: str) -> None:
    assert loaded_after(code) == set()


@pytest.mark.parametrize(
    "command",
    [
        *("", "verify", "lock", "evaluate", "demo", "calibrate", "synthesize", "profile", "profile show"),
        *("info", "download", "pack", "protocols", "compare", "shard"),
    ],
)
def test_help_loads_neither_torch_nor_rawpy(command: str) -> None:
    assert loaded_after(RUN_ELDATA, *command.split(), "--help") == set()


@pytest.mark.parametrize("command", ["", "protocol", "camera", "plan", "checklist", "manifest", "check", "run"])
def test_help_of_capture_loads_neither_torch_nor_rawpy(command: str) -> None:
    assert loaded_after(RUN_CAPTURE, *command.split(), "--help") == set()


def test_capture_works_without_torch_and_rawpy() -> None:
    assert loaded_after(RUN_CAPTURE, "protocol", "--metered", "4") == set()


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Tree:
    return build_tree(tmp_path_factory.mktemp("tree"))


@pytest.mark.parametrize(("level", "loaded"), [("quick", set()), ("metadata", {"rawpy"}), ("full", {"rawpy"})])
def test_verify_loads_what_its_level_needs(tree: Tree, level: str, loaded: set[str]) -> None:
    arguments = ["verify", str(tree.csv), "--root", str(tree.root), "--level", level, "--jobs", "1"]
    assert loaded_after(RUN_ELDATA, *arguments) == loaded


# --- one-way imports ----------------------------------------------------------------------------------------------


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports_of(tree: ast.AST, package: str) -> Iterator[str]:
    """Every module of ours that code imports, wherever it does: inside of functions and for types alike.

    ``from eldata import manifest`` counts as ``eldata.manifest``, ``from eldata import __version__`` as ``eldata``.
    """
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                parents = package.split(".")[: len(package.split(".")) - node.level + 1]
                base = ".".join([*parents, *([node.module] if node.module else [])])
            found = [base if a.name.startswith("__") else f"{base}.{a.name}" for a in node.names]
        else:
            continue
        yield from (name for name in found if name.split(".")[0] in ("eldata", "capture"))


def imported() -> list[tuple[str, str]]:
    """Importing module and imported name, of all of ours."""
    pairs = []
    for path in MODULES:
        importer = module_name(path)
        package = importer if path.name == "__init__.py" else importer.rpartition(".")[0]
        tree = ast.parse(path.read_text(encoding="utf-8"))
        pairs += [(importer, name) for name in imports_of(tree, package)]
    return pairs


IMPORTED = imported()


def below(name: str, *places: str) -> bool:
    return any(name == place or name.startswith(f"{place}.") for place in places)


def violations(inside: str, *, allowed: tuple[str, ...] = (), refused: tuple[str, ...] = ()) -> list[tuple[str, str]]:
    ours = [(importer, name) for importer, name in IMPORTED if below(importer, inside)]
    if allowed:
        return [(importer, name) for importer, name in ours if not below(name, inside, *allowed)]
    return [(importer, name) for importer, name in ours if below(name, *refused)]


def test_the_scan_sees_every_kind_of_import() -> None:
    source = """
import eldata.raw.cfa, numpy
from eldata import __version__, manifest
from ..raw import reading
from . import card
def function():
    from eldata.datasets.base import PairDataset
if TYPE_CHECKING:
    from eldata.records import Sensor
"""
    assert sorted(imports_of(ast.parse(source), "eldata.manifest")) == [
        "eldata",
        "eldata.datasets.base.PairDataset",
        "eldata.manifest",
        "eldata.manifest.card",
        "eldata.raw.cfa",
        "eldata.raw.reading",
        "eldata.records.Sensor",
    ]
    assert ("eldata.manifest.lock", "eldata.manifest.verify.verify") in IMPORTED


ALLOWED = {
    "eldata.errors": ("nothing",),
    "eldata.base.files": ("eldata.errors",),
    "eldata.base.workers": ("eldata.errors", "eldata.base.clusters"),
    "eldata.base.clusters": ("eldata.errors",),
    "eldata.records": ("eldata.errors", "eldata.raw.colour"),
    "eldata.base.compiled": ("nothing",),
    "eldata.raw": ("eldata.records", "eldata.errors", "eldata.base.files", "eldata.base.compiled"),
    "eldata.metrics": ("eldata.errors", "eldata.base.compiled", "eldata.base.tensors", "eldata.base.moved"),
    "eldata.protocols": ("eldata.errors", "eldata.metrics"),
    "eldata.isp": ("eldata.raw", "eldata.records", "eldata.errors", "eldata.base.files"),
    "eldata.sources.store": (
        *(
            "eldata.manifest",
            "eldata.raw",
            "eldata.records",
            "eldata.errors",
            "eldata.base.files",
            "eldata.base.workers",
        ),
        "eldata.base.png",
    ),
    "eldata.download": ("eldata.manifest", "eldata.records", "eldata.errors", "eldata.base.files"),
    "capture": (
        *("eldata.records", "eldata.manifest", "eldata.raw", "eldata.errors", "eldata.base.files"),
        # What the two command lines share, as light as errors; files are read by several processes.
        *("eldata.base.console", "eldata.base.tables", "eldata.base.workers"),
    ),
}
REFUSED = {
    "eldata": ("capture",),
    "eldata.metrics": ("eldata.raw", "eldata.manifest", "eldata.datasets", "eldata.evaluation"),
    "eldata.manifest": ("eldata.datasets", "eldata.evaluation", "eldata.cli", "eldata.noise", "eldata.demo"),
    "eldata.datasets": ("eldata.cli", "eldata.evaluation", "eldata.demo", "eldata.sources.shards", "eldata.reports"),
    "eldata.sources.shards": ("eldata.cli", "eldata.evaluation", "eldata.demo", "eldata.reports"),
    "eldata.evaluation": ("eldata.cli", "eldata.demo", "eldata.calibration", "eldata.reports"),
    "eldata.calibration": ("eldata.cli", "eldata.evaluation", "eldata.demo", "eldata.reports"),
    "eldata.noise": ("eldata.cli", "eldata.evaluation", "eldata.demo", "eldata.reports", "eldata.calibration"),
    "eldata.reports": ("eldata.cli", "eldata.demo"),
    "eldata.isp": ("eldata.cli", "eldata.demo", "eldata.datasets", "eldata.evaluation"),
}


@pytest.mark.parametrize("room", ALLOWED)
def test_a_room_imports_only(room: str) -> None:
    found = violations(room, allowed=ALLOWED[room])
    # The version alone, which every command prints, every download tells the server and every store states.
    tells_the_version = room in ("capture", "eldata.download", "eldata.sources.store", "eldata.base.clusters")
    assert [(importer, name) for importer, name in found if not (tells_the_version and name == "eldata")] == []


@pytest.mark.parametrize("room", REFUSED)
def test_a_room_never_imports(room: str) -> None:
    assert violations(room, refused=REFUSED[room]) == []


def test_only_the_command_line_imports_the_command_line() -> None:
    users = [pair for pair in IMPORTED if below(pair[1], "eldata.cli") and not below(pair[0], "eldata.cli")]
    assert users == []


def test_only_the_command_line_imports_the_demo() -> None:
    users = [pair for pair in IMPORTED if below(pair[1], "eldata.demo") and not below(pair[0], "eldata.demo")]
    assert {importer.rpartition(".")[0] for importer, _ in users} <= {"eldata.cli"}


def test_nobody_imports_through_the_public_front() -> None:
    """``from eldata import verify`` inside of the package would load half of it, in a circle."""
    places = {module_name(path) for path in MODULES}
    through = [
        (importer, name)
        for importer, name in IMPORTED
        if name.count(".") == 1 and name.startswith("eldata.") and name not in places
    ]
    assert through == []


# --- constructs that do not occur ---------------------------------------------------------------------------------


def dotted(node: ast.expr) -> str:
    if isinstance(node, ast.Attribute):
        return f"{dotted(node.value)}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else "?"


BANNED_CALLS = {
    "eval": "runs what a file says",
    "exec": "runs what a file says",
    "pickle.load": "runs what a file says",
    "pickle.loads": "runs what a file says",
    "pickle.Unpickler": "runs what a file says",
    "np.random.seed": "changes everybody's random numbers",
    "numpy.random.seed": "changes everybody's random numbers",
    "random.seed": "changes everybody's random numbers",
    "torch.manual_seed": "changes everybody's random numbers",
    "os.system": "runs a shell",
}


def banned_in(tree: ast.AST) -> list[tuple[int, str]]:
    """Line and kind of each construct that this project does without."""
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Assert):
            found.append((node.lineno, "assert: gone under python -O, and no message for the user"))
        elif isinstance(node, ast.ImportFrom) and node.module in ("pickle", "_pickle", "dill", "cloudpickle"):
            found.append((node.lineno, f"from {node.module} import"))
        elif isinstance(node, ast.Call):
            name = dotted(node.func)
            if name in BANNED_CALLS:
                found.append((node.lineno, f"{name}: {BANNED_CALLS[name]}"))
            for keyword in node.keywords:
                value = keyword.value.value if isinstance(keyword.value, ast.Constant) else "computed"
                if (keyword.arg, value) in (("allow_pickle", True), ("weights_only", False), ("shell", True)):
                    found.append((node.lineno, f"{keyword.arg}={value!r}"))
    return found


@pytest.mark.parametrize(
    "source",
    [
        "assert path",
        "eval(tag)",
        "exec(code)",
        "import pickle\npickle.load(file)",
        "from pickle import load",
        "np.load(path, allow_pickle=True)",
        "torch.load(path, weights_only=False)",
        "def f():\n    np.random.seed(0)",
        "torch.manual_seed(0)",
        "subprocess.run(text, shell=True)",
    ],
)
def test_the_scan_sees(source: str) -> None:
    assert len(banned_in(ast.parse(source))) == 1


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(ROOT)))
def test_banned_constructs_do_not_occur(path: Path) -> None:
    assert banned_in(ast.parse(path.read_text(encoding="utf-8"))) == []


# --- the wheel ----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    (built,) = folder.glob("eldata-*.whl")
    return built


def test_the_wheel_holds_what_it_must(wheel: Path) -> None:
    names = set(zipfile.ZipFile(wheel).namelist())
    for name in ("eld", "sid-sony", "sid-fuji", "drv"):
        assert {f"eldata/manifest/shipped/{name}.csv", f"eldata/manifest/shipped/{name}.json"} <= names
    beside = {path.name for path in (ROOT / "manifests").iterdir() if path.suffix in (".csv", ".json")}
    published = {f"published/{path.name}" for path in (ROOT / "manifests" / "published").iterdir()}
    shipped = "eldata/manifest/shipped/"
    assert {name.removeprefix(shipped) for name in names if name.startswith(shipped)} == beside | published
    assert {"eldata/py.typed", "capture/py.typed", "eldata/protocols/shipped.toml"} <= names
    sources = [*(ROOT / "eldata").rglob("*.py*"), *(ROOT / "capture").rglob("*.py*")]
    ours = {path.relative_to(ROOT).as_posix() for path in sources if path.suffix in (".py", ".pyi")}
    assert "eldata/__init__.pyi" in ours
    assert ours <= names


def test_the_wheel_holds_nothing_else(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    assert {name.split("/")[0].split("-")[0] for name in names} == {"eldata", "capture"}
    assert not [name for name in names if "__pycache__" in name or "tests" in name.split("/")]
    assert {Path(name).suffix for name in names if "dist-info" not in name} <= {
        ".py",
        ".pyi",
        ".toml",
        ".typed",
        ".css",
        ".csv",
        ".html",
        ".js",
        ".json",
    }


def test_the_wheels_manifests_are_data_alone(wheel: Path) -> None:
    """A script among them would overwrite the installed manifests when it is run, and is importable as ours."""
    shipped = [name for name in zipfile.ZipFile(wheel).namelist() if name.startswith("eldata/manifest/shipped/")]
    assert {Path(name).suffix for name in shipped} == {".csv", ".json"}


def test_the_wheel_works_away_from_the_sources(wheel: Path, tmp_path: Path) -> None:
    """An installed package has its manifests inside; a checkout has them beside."""
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path)
    code = (
        "import sys; sys.path.insert(0, sys.argv[1])\n"
        "import eldata, capture\n"
        "from eldata.manifest import shipped_manifest\n"
        "manifest = shipped_manifest('eld')\n"
        "assert str(manifest.path).startswith(sys.argv[1]), manifest.path\n"
        "assert str(eldata.__file__).startswith(sys.argv[1]), eldata.__file__\n"
        "assert len(manifest.records) == 640\n"
    )
    assert loaded_after(code, str(tmp_path), cwd=tmp_path) == set()
