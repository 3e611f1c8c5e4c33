"""Whether worker processes would run the user's script again, up to the line that starts them, and start some too.

A process that is spawned runs the main script first, all that does not stand under ``if __name__ == "__main__":``. The
library ends that in each worker with a traceback, and the pool starts the next one: hundreds of lines.
"""

from __future__ import annotations

import ast
import sys
import threading
import tokenize

from eldata.errors import ArgumentError

# What a condition asks that keeps a worker away: its module's name, or whether it is a worker.
_ASKED = frozenset(("__name__", "parent_process", "current_process"))


def require_main_guard() -> None:
    """Raise :class:`ArgumentError` if a process that is started here would come here too; ask before the first one.

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
