"""Pages that the tutorials make with the product's commands: copied into the site as they are.

A notebook runs in a folder that is removed; :func:`keep` saves a page from it and links it there. The settings
name the folder of the kept pages, which the site's builder copies.
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from IPython.display import HTML


def keep(file: str) -> HTML:
    """Keep a page, with its folder of pictures if it has one, and return a link to it from a tutorial."""
    kept = Path(os.environ["ELDATA_EXAMPLES"])
    kept.mkdir(parents=True, exist_ok=True)
    shutil.copy(file, kept)
    pictures = Path(file).with_name(f"{Path(file).stem}-pictures")
    if pictures.is_dir():
        shutil.copytree(pictures, kept / pictures.name, dirs_exist_ok=True)
    return HTML(f'<a href="../examples/{file}">{file}</a>')  # type: ignore[no-untyped-call]
