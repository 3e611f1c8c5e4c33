"""The directive ``command-reference``: a program's commands with their options, from the parsers that users meet."""

from __future__ import annotations

import argparse
import re
from importlib import import_module
from typing import TYPE_CHECKING

from docutils import nodes
from docutils.statemachine import StringList
from sphinx.util.docutils import SphinxDirective

if TYPE_CHECKING:
    from collections.abc import Iterator

    from sphinx.application import Sphinx

# Help is as wide as it would be in a terminal of this width.
_COLUMNS = 88


def commands(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    """Yield a parser, and those of its commands."""
    yield parser
    for action in parser._actions:  # noqa: SLF001 # argparse has no other way to ask
        if isinstance(action, argparse._SubParsersAction):  # noqa: SLF001 # its only name
            for below in action.choices.values():
                yield from commands(below)


class CommandReference(SphinxDirective):
    """``.. command-reference:: eldata.cli.main``: the module that has the function ``parser``."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Make a section for each command."""
        parser: argparse.ArgumentParser = import_module(self.arguments[0]).parser()
        return [self._section(command) for command in commands(parser)]

    def _section(self, parser: argparse.ArgumentParser) -> nodes.section:
        section = nodes.section(ids=[nodes.make_id(parser.prog)], names=[parser.prog])
        section += nodes.title(parser.prog, parser.prog)
        self.state.document.note_explicit_target(section, section)
        lines = ["", f".. program:: {parser.prog}", "", *_paragraphs(parser.description or "")]
        usage = parser.format_usage().removeprefix("usage: ").rstrip()
        lines += ["", ".. code-block:: text", "", *(f"   {line}" for line in usage.splitlines()), ""]
        formatter = argparse.HelpFormatter(parser.prog, width=_COLUMNS)
        for group in parser._action_groups:  # noqa: SLF001 # in the order of the help
            for action in group._group_actions:  # noqa: SLF001
                if action.help is argparse.SUPPRESS or isinstance(action, argparse._HelpAction):  # noqa: SLF001
                    continue
                lines += _option(action, formatter)
            if group.description and not group._group_actions:  # noqa: SLF001 # options that the program's help shows
                lines += _paragraphs(f"{str(group.title).capitalize()}: {group.description}")
        lines += _paragraphs(parser.epilog or "")
        self.state.nested_parse(StringList(lines, source=f"help of {parser.prog}"), 0, section)
        return section


def _option(action: argparse.Action, formatter: argparse.HelpFormatter) -> list[str]:
    if isinstance(action, argparse._SubParsersAction):  # noqa: SLF001
        about = {choice.dest: choice.help or "" for choice in action._choices_actions}  # noqa: SLF001
        return [line for name in action.choices for line in (f"``{name}``", f"   {_plain(about[name])}", "")]
    said = _plain(formatter._expand_help(action)) if action.help else ""  # noqa: SLF001
    value = formatter._format_args(action, formatter._get_default_metavar_for_optional(action))  # noqa: SLF001
    if not action.option_strings:
        value = formatter._format_args(action, formatter._get_default_metavar_for_positional(action))  # noqa: SLF001
        return [f"``{value}``", f"   {said}", ""]
    names = ", ".join(f"{name} {value}".rstrip() for name in action.option_strings)
    return [f".. option:: {names}", "", f"   {said}", ""]


def _plain(text: str) -> str:
    """Escape what would be markup: help is plain text."""
    return re.sub(r"([*`|_\\])", r"\\\1", " ".join(text.split()))


def _paragraphs(text: str) -> list[str]:
    """Return paragraphs, and what stands indented below a heading as a block to copy."""
    lines = []
    for paragraph in text.split("\n\n"):
        first, *rest = paragraph.splitlines() or [""]
        if rest and all(line.startswith("    ") for line in rest):
            lines += [_plain(first).capitalize(), "", ".. code-block:: sh", "", *rest, ""]
        else:
            lines += [_plain(paragraph), ""]
    return lines


def setup(app: Sphinx) -> dict[str, bool]:
    """Sphinx's entry point."""
    app.add_directive("command-reference", CommandReference)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
