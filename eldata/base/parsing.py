"""The parser of a command line: errors of one line that name what was probably meant, and help with examples."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING, Any, NoReturn

from eldata.errors import nearest

if TYPE_CHECKING:
    from collections.abc import Sequence

_WRONG_USAGE = 2  # eldata.base.console has the exit codes


class Help(argparse.HelpFormatter):
    """Help whose paragraphs are filled one by one; lines that begin with four spaces, commands to copy, stay whole."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        paragraphs = []
        for paragraph in text.split("\n\n"):
            lines = paragraph.splitlines()
            whole = len(lines) > 1 and all(line.startswith("    ") for line in lines[1:])
            paragraphs.append(paragraph if whole else super()._fill_text(paragraph, width, indent))
        return "\n\n".join(paragraphs)


class Parser(argparse.ArgumentParser):
    """An argument parser whose errors are one line, and that takes no abbreviated options."""

    def __init__(self, **options: Any) -> None:
        settings: dict[str, Any] = {"allow_abbrev": False, "formatter_class": Help} | options
        super().__init__(**settings)

    def error(self, message: str) -> NoReturn:
        """Print one line and exit with 2."""
        said = " ".join(message.split())
        self.exit(_WRONG_USAGE, f"{self.prog}: {said}{' See' if said.endswith('?') else '; see'} {self.prog} --help\n")

    def parse_known_args(self, args: Sequence[str] | None = None, namespace: Any = None) -> Any:  # type: ignore[override]
        """Parse; an option that there is not is the first thing that is said, not what lacks because of it."""
        given = sys.argv[1:] if args is None else list(args)
        self._refuse_unknown_options(given)
        return super().parse_known_args(given, namespace)

    def _refuse_unknown_options(self, given: Sequence[str]) -> None:
        for text in given:
            if text == "--" or (self._subparsers is not None and not text.startswith("-")):
                return  # what follows is not an option, or belongs to the command
            name = text.partition("=")[0]
            if not name.startswith("--") or " " in name or name in self._option_string_actions:
                continue
            known = [option.removeprefix("--") for option in self._option_string_actions if option.startswith("--")]
            near = nearest(name.removeprefix("--"), known)
            hint = f"; did you mean --{near}?" if near else ""
            after = ", and a command's options come after its name" if self._subparsers is not None else ""
            self.error(f"there is no option {name}{after}{hint}")

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is None or value in action.choices:
            return
        known = [str(choice) for choice in action.choices]
        near = nearest(str(value), known)
        hint = f"; did you mean {near}?" if near else ""
        if isinstance(action, argparse._SubParsersAction):  # noqa: SLF001 # its only name
            raise argparse.ArgumentError(None, f"there is no command {value!r}; commands are {', '.join(known)}{hint}")
        raise argparse.ArgumentError(action, f"invalid choice: {value!r} (choose from {', '.join(known)}){hint}")


def add_examples(parser: argparse.ArgumentParser, *commands: str) -> None:
    """Put commands to copy first in what a parser's help ends with."""
    lines = "\n".join(f"    {command}" for command in commands)
    heading = "example:" if len(commands) == 1 else "examples:"
    parser.epilog = "\n\n".join(filter(None, (f"{heading}\n{lines}", parser.epilog)))
