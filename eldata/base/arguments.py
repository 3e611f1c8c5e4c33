"""What callers hand over: objects that a person names, tensors, the script that runs."""

from __future__ import annotations

import ast
import importlib
import sys
import threading
import tokenize
from operator import attrgetter
from pathlib import Path
from typing import Any

from eldata.base.visible import in_line
from eldata.errors import ArgumentError


def named_object(place: str) -> Any:
    """Return what ``package.module:name`` names; modules of the current folder are found, as ``python -m`` finds them.

    Raises
    ------
    ArgumentError
        If the text is not such a name, the module cannot be imported, or it has nothing of that name.
    """
    module_name, _, name = place.partition(":")
    if not module_name or not name:
        raise ArgumentError(f"{place!r} names nothing in a module; expected package.module:name")
    if "" not in sys.path and str(Path.cwd()) not in sys.path:
        sys.path.insert(0, str(Path.cwd()))
    try:
        module = importlib.import_module(module_name)
    except Exception as error:  # whatever the module does as it is imported
        said = str(error) if isinstance(error, ImportError) else f"{type(error).__name__}: {error}"
        raise ArgumentError(in_line(f"{place}: the module {module_name} cannot be imported: {said}")) from error
    try:
        return attrgetter(name)(module)
    except AttributeError:
        raise ArgumentError(f"{place}: the module {module_name} has no {name}") from None


def is_tensor(value: object) -> bool:
    """Tell whether ``value`` is a torch tensor, without importing torch where it is not used."""
    torch = sys.modules.get("torch")
    return torch is not None and isinstance(value, torch.Tensor)


# --- the script -----------------------------------------------------------------------------------------------------

# What a condition asks that keeps a worker away: its module's name, or whether it is a worker.
_ASKED = frozenset(("__name__", "parent_process", "current_process"))


def require_main_guard() -> None:
    """Raise :class:`ArgumentError` if a process that is started here would come here too; ask before the first one.

    A process that is spawned runs the main script first, all that does not stand under ``if __name__ == "__main__":``.
    The library ends that in each worker with a traceback, and the pool starts the next one: hundreds of lines.
    Where that cannot be told (no source, no frame of the script on the stack), nothing is raised.
    """
    main = sys.modules.get("__main__")
    path, spec = getattr(main, "__file__", None), getattr(main, "__spec__", None)
    if path is None or (spec is not None and spec.name.rpartition(".")[2] == "__main__"):
        return  # an interactive session, or a program that is not imported again
    line = _line_of(vars(main))
    try:
        with tokenize.open(path) as file:
            tree = ast.parse(file.read())
    except (OSError, SyntaxError, ValueError):
        return
    if line is None or any(_keeps_workers_away(node, line) for node in ast.walk(tree)):
        return
    raise ArgumentError(
        f"worker processes run {path} again from its first line, and each would come back to line {line}: put that "
        'under if __name__ == "__main__":, or work without processes (workers=1; for a DataLoader, workers=0)'
    )


def _line_of(names: dict[str, object]) -> int | None:
    """Return the line of the main script that runs, in the main thread; ``None`` if it does not."""
    frame = sys._current_frames().get(threading.main_thread().ident or 0)  # noqa: SLF001 # documented, in spite of its name
    line = None
    while frame is not None:
        # Python's own name for a script's top level. The outermost frame counts: others are of exec().
        if frame.f_globals is names and frame.f_code.co_name == "<module>":
            line = frame.f_lineno
        frame = frame.f_back
    return line


def _keeps_workers_away(node: ast.AST, line: int) -> bool:
    if not isinstance(node, ast.If) or not node.lineno <= line <= (node.end_lineno or 0):
        return False
    asked = {getattr(part, "id", getattr(part, "attr", None)) for part in ast.walk(node.test)}
    return bool(asked & _ASKED)
