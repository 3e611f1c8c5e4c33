"""The directive ``public-names``: each name that a package exports, from its docstring.

What several packages export is described once, on the page that :data:`PAGES` has last; the others link there. A name
of ours in a docstring is found by its last part, as long as that is one thing's alone.
"""

from __future__ import annotations

import inspect
import re
import sys
from functools import cache, reduce
from importlib import import_module
from typing import TYPE_CHECKING, Any

from docutils import nodes
from docutils.statemachine import StringList
from sphinx.errors import ExtensionError
from sphinx.pycode import ModuleAnalyzer
from sphinx.util.docutils import SphinxDirective
from sphinx.util.nodes import get_node_source, make_refnode

if TYPE_CHECKING:
    from sphinx.addnodes import pending_xref
    from sphinx.application import Sphinx
    from sphinx.environment import BuildEnvironment

# Every package with public names, and the modules without a list of theirs that users import from.
PAGES = (
    *("eldata", "eldata.datasets", "eldata.evaluation", "eldata.protocols", "eldata.metrics", "eldata.noise"),
    *("eldata.calibration", "eldata.raw", "eldata.isp", "eldata.manifest", "eldata.baselines", "eldata.download"),
    *("eldata.sources.store", "eldata.integrations.torchmetrics"),
    *("eldata.integrations.basicsr", "eldata.records", "eldata.errors"),
    *("capture", "capture.checklist", "capture.check"),
)


def public_names(page: str) -> list[str]:
    """Return what a package exports, by the alphabet, or the classes and functions of a module, in its order."""
    module = import_module(page)
    if hasattr(module, "__all__"):
        names = sorted(module.__all__, key=str.lower)
        return [name for name in names if not inspect.ismodule(getattr(module, name))]
    own = [name for name, value in vars(module).items() if getattr(value, "__module__", None) == page]
    return [name for name in own if not name.startswith("_") and callable(vars(module)[name])]


@cache
def homes() -> dict[str, str]:
    """Return each full public name with the one under which it is described."""
    named = [(f"{page}.{name}", getattr(import_module(page), name)) for page in PAGES for name in public_names(page)]
    home = {id(value): full for full, value in named}
    return {full: home[id(value)] for full, value in named}


class PublicNames(SphinxDirective):
    """``.. public-names:: eldata.noise``; full names below it are described, too: what the public ones take or give."""

    required_arguments = 1
    has_content = True

    def run(self) -> list[nodes.Node]:
        """Describe what is at home on this page, and link to the rest."""
        (page,) = self.arguments
        lines = ["", f".. py:module:: {page}", ""]
        elsewhere, places = [], []
        for name in public_names(page):
            full = f"{page}.{name}"
            if homes()[full] == full:
                lines += _described(full, getattr(import_module(page), name))
            else:
                places.append(full)
                elsewhere.append(f"* :py:obj:`{name} <{homes()[full]}>`: {_summary(full)}")
                domain: Any = self.env.domains.python_domain
                domain.note_object(full, "class", full, aliased=True, location=self.get_location())
        if elsewhere:
            lines += ["", "Described with their packages:", "", *elsewhere, ""]
        if self.content:
            lines += ["", ".. rubric:: What they take and give", ""]
            lines += [line for full in self.content for line in _described(full, named(full))]
        holder = nodes.section()
        holder.document = self.state.document
        self.state.nested_parse(StringList([*lines, ""], source=f"names of {page}"), 0, holder)
        linked = [item for item in holder.findall(nodes.list_item) if item.parent.parent is holder]
        for item, full in zip(linked[-len(places) :] if places else [], places, strict=True):
            item["ids"].append(full)  # where an index's entry of the name leads
        return list(holder.children)


def named(full: str) -> Any:
    """Return what a full name stands for: a module, or something in it.

    Raises
    ------
    LookupError
        If there is nothing of that name.
    """
    parts = full.split(".")
    for length in range(len(parts), 0, -1):
        try:
            found = import_module(".".join(parts[:length]))
            return reduce(getattr, parts[length:], found)
        except (ImportError, AttributeError):
            continue
    raise LookupError(f"there is no {full}")


def _described(full: str, value: object) -> list[str]:
    if isinstance(value, type):
        is_dataset = hasattr(value, "__getitem__")  # each of them shows all that can be done with it
        bases = [base for base in value.__mro__[1:] if not _is_ours(base) or (_is_described(base) and not is_dataset)]
        ends = [base.__name__ for base in bases]
        options = []
        if any(_is_worth_a_word(base) for base in value.__bases__):
            options.append("   :show-inheritance:")
        if ends != ["object"]:
            options.append(f"   :inherited-members: {', '.join(dict.fromkeys(ends))}")
        return [f".. autoclass:: {full}", *options, ""]
    if inspect.isroutine(value):
        return [f".. autofunction:: {full}", ""]
    module, _, name = full.rpartition(".")
    return [f".. py:data:: {name}", f"   :module: {module}", "", *(f"   {line}" for line in _comment(full, value)), ""]


def _is_ours(value: type) -> bool:
    return value.__module__.partition(".")[0] in ("eldata", "capture")


def _is_described(value: type) -> bool:
    return any(named(full) is value for full in _by_last_part().get(value.__name__, ()))


def _is_worth_a_word(base: type) -> bool:
    """Whether a page describes a class, or it is one of another package that users know."""
    return _is_described(base) if _is_ours(base) else base.__module__ not in ("abc", "builtins", "typing", "enum")


def bases_shown(_app: Sphinx, _name: str, _value: object, _options: object, bases: list[Any]) -> None:
    """Leave out bases that no page describes; their methods stand with the class."""
    bases[:] = [base for base in bases if not isinstance(base, type) or _is_worth_a_word(base)] or bases[:1]


# How datasets are read, item by item, which their base classes hand to one another: nothing that a user calls.
_READING = frozenset({"drawn", "item", "reads_parts"})


def reading_left_out(_app: Sphinx, _what: str, name: str, value: Any, _skip: bool, _options: object) -> bool | None:
    """Leave out how datasets are read; ``None`` leaves the choice to others."""
    function = value.fget if isinstance(value, property) else value
    is_of_datasets = str(getattr(function, "__module__", "")).startswith("eldata.datasets.")
    return True if name in _READING and is_of_datasets else None


_ATTRIBUTE, _TYPE = ".. attribute:: ", "   :type: "


def attributes_listed(_app: Sphinx, _what: str, _name: str, _value: object, _options: object, lines: list[str]) -> None:
    """Of the attributes that napoleon has made: one entry for names with one text, the type beside, no contents.

    Other types lose a last underscore, which would make a link of them.
    """
    shown: list[str] = []
    heading = 0  # where the options of the last attribute go
    for line in lines:
        if line.startswith(_ATTRIBUTE):
            names = line.removeprefix(_ATTRIBUTE).split(", ")
            shown += [_ATTRIBUTE + names[0], *(" " * len(_ATTRIBUTE) + name for name in names[1:])]
            heading = len(shown)
            shown.append("   :no-contents-entry:")
        elif line.startswith(_TYPE) and heading:
            shown.insert(heading, line)
        else:
            shown.append(re.sub(r"\bbool_(?!\w)", "bool", line))
    lines[:] = shown


def _summary(full: str) -> str:
    page, _, name = full.rpartition(".")
    return str(inspect.getdoc(getattr(import_module(page), name))).partition("\n\n")[0].replace("\n", " ")


def _comment(full: str, value: object) -> list[str]:
    """Return what stands below the assignment of a value, in the module that makes it."""
    package, _, name = full.rpartition(".")
    for module in [loaded for loaded in sys.modules if f"{loaded}.".startswith(f"{package}.")]:
        if getattr(sys.modules[module], name, None) is value:
            found = ModuleAnalyzer.for_module(module).find_attr_docs().get(("", name))
            if found:
                return found
    raise ExtensionError(f"{full}: expected a docstring below its assignment, found none; write one")


@cache
def _by_last_part() -> dict[str, set[str]]:
    found: dict[str, set[str]] = {}
    for full in homes().values():
        found.setdefault(full.rpartition(".")[2], set()).add(full)
    return found


def resolve(app: Sphinx, env: BuildEnvironment, node: pending_xref, shown: nodes.TextElement) -> nodes.Element | None:
    """Find a name of ours by its last part; leave without a link what there is and no page describes.

    A name that there is not stays unresolved, and is warned of.
    """
    if node.get("refdomain") != "py":
        return None
    target = str(node["reftarget"])
    domain: Any = env.domains.python_domain
    parts = target.split(".")
    for length in (1, 2):  # the name itself, or the class of a method
        homes_of = _by_last_part().get(parts[-length], set()) if len(parts) >= length else set()
        if len(homes_of) == 1:
            full = ".".join([*homes_of, *parts[len(parts) - length + 1 :]])
            found = domain.objects.get(full)
            if found is not None:
                return make_refnode(app.builder, str(node["refdoc"]), found.docname, found.node_id, shown, full)
    if not isinstance(shown, nodes.literal):
        return shown  # the type of a parameter
    place = re.search(r"docstring of ([\w.]+)", get_node_source(node) or "")
    contexts = ["", f"{node.get('py:module')}."]
    if place is not None:
        inner = place[1].split(".")
        contexts += [".".join([*inner[:length], ""]) for length in range(1, len(inner) + 1)]
    for context in contexts:
        try:
            named(context + target)
        except LookupError:
            continue
        return shown
    return None


def setup(app: Sphinx) -> dict[str, bool]:
    """Sphinx's entry point."""
    app.add_directive("public-names", PublicNames)
    app.connect("missing-reference", resolve)
    app.connect("autodoc-process-bases", bases_shown)
    app.connect("autodoc-skip-member", reading_left_out)
    app.connect("autodoc-process-docstring", attributes_listed, priority=600)  # after napoleon
    return {"parallel_read_safe": True, "parallel_write_safe": True}
