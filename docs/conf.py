"""Sphinx's settings: the pages of this folder as they are, the reference from the sources, notebooks that are run."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sphinx.application import Sphinx

_HERE = Path(__file__).parent
sys.path[:0] = [str(_HERE / "site"), str(_HERE.parent)]
# The notebooks' kernels: commands of this environment, this source, no warnings of small machines.
os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [*sys.path[:2], os.environ.get("PYTHONPATH")]))
# What they keep goes into the site; it stays beside their cache, which says whether they run again.
_KEPT = _HERE / "_build" / "kept"
os.environ["ELDATA_EXAMPLES"] = str(_KEPT / "examples")
_KEPT.mkdir(parents=True, exist_ok=True)

import eldata  # noqa: E402 # of this folder's parent

project = "eldata"
author = "The eldata developers"
copyright = f"{author}, MIT licence"  # noqa: A001 # Sphinx's name
version = release = eldata.__version__

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "code_blocks",
    "command_reference",
    "name_reference",
    "notebook_output",
    "repository_links",
]
root_doc = "index"
exclude_patterns = ["_build", "site"]
nitpicky = True
suppress_warnings = ["myst.header"]  # a guide may begin with a heading below another's

html_theme = "furo"
html_title = f"eldata {release}"
html_static_path = ["site/static"]
html_extra_path = [str(_KEPT)]
html_css_files = ["site.css"]
html_show_sphinx = False
html_copy_source = False
html_theme_options = {"navigation_with_keys": True}

# Headings are linked to by the names that GitHub gives them.
myst_heading_anchors = 6
myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True

nb_execution_mode = "cache"  # again only where a notebook has changed; `make docs` of a new checkout runs all
nb_execution_raise_on_error = True
nb_execution_in_temp = True
nb_execution_timeout = 600
nb_merge_streams = True

autodoc_default_options = {"members": True, "member-order": "bysource"}
toc_object_entries_show_parents = "hide"
autodoc_preserve_defaults = False  # it reads a function's source, where spelt keywords do not stand
autodoc_typehints_format = "short"
python_use_unqualified_type_names = True
napoleon_google_docstring = False
napoleon_use_ivar = False
napoleon_use_rtype = False


def setup(app: Sphinx) -> None:
    """Name what the highlighter does not know."""
    from pygments.lexers import TextLexer

    app.add_lexer("csv", TextLexer)
