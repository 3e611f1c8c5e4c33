"""A script without a main guard is told in one line, before a worker runs it again."""

from __future__ import annotations

import runpy
from typing import TYPE_CHECKING

import pytest

from eldata.errors import ArgumentError

if TYPE_CHECKING:
    from pathlib import Path

CALL = "from eldata.base.arguments import require_main_guard as check\n"

REFUSED = {
    "plain": "check()\n",
    "in-a-function": "def main():\n    check()\n\nmain()\n",
    "under-another-if": "if len('x') == 1:\n    check()\n",
    "after-the-guard": "if __name__ == '__main__':\n    pass\ncheck()\n",
    "in-a-thread": "import threading\nwent = []\n\ndef work():\n    try:\n        check()\n    except Exception as e:\n"
    "        went.append(e)\n\nt = threading.Thread(target=work)\nt.start()\nt.join()\nraise went[0]\n",
}
TAKEN = {
    "guarded": "if __name__ == '__main__':\n    check()\n",
    "guarded-the-other-way": "if '__main__' == __name__ and True:\n    for _ in range(2):\n        check()\n",
    "guarded-function": "def main():\n    check()\n\nif __name__ == '__main__':\n    main()\n",
    "guarded-by-process": "import multiprocessing\nif multiprocessing.parent_process() is None:\n    check()\n",
}


@pytest.mark.parametrize("name", [*REFUSED, *TAKEN])
def test_scripts(name: str, tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(CALL + (REFUSED | TAKEN)[name])
    if name in TAKEN:
        runpy.run_path(str(script), run_name="__main__")
        return
    with pytest.raises(ArgumentError, match=r"script\.py again from its first line, and each would come back to line"):
        runpy.run_path(str(script), run_name="__main__")


def test_what_a_script_imports(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "guard_test_experiment.py").write_text(CALL + "check()\n")
    (tmp_path / "script.py").write_text("import guard_test_experiment\n")
    with pytest.raises(ArgumentError, match=r"script\.py again from its first line, .* line 1:"):
        runpy.run_path(str(tmp_path / "script.py"), run_name="__main__")
