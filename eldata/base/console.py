"""What every command line of this distribution shares: one clear line for an error, exit codes, no traceback.

Exit codes: 0 all well; 1 problems were found and listed; 2 wrong usage or unusable input; 130 Ctrl-C; 143 SIGTERM; 141
the reader of the output left before its end.
"""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import sys
import threading
import traceback
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from importlib import import_module
from inspect import cleandoc
from typing import TYPE_CHECKING, Any, Literal, NoReturn, TypeAlias

from eldata import __version__
from eldata.base.files import write_json
from eldata.base.numbers import whole_of
from eldata.base.outputs import add_output, check_outputs
from eldata.base.visible import Screen, visible
from eldata.errors import ArgumentError, EldataError, nearest

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence
    from types import ModuleType

    from eldata.base.workers import Workers

Arguments: TypeAlias = argparse.Namespace
"""What a subcommand's function ``run`` is handed."""

OK, PROBLEMS, UNUSABLE, CLOSED_PIPE = 0, 1, 2, 141
_NONE_HALF = "files are written whole or not at all, so none is left half"
_DASK_S = 10  # for a scheduler to answer
_EXIT_CODES = (
    "Exit codes: 0 all well; 1 problems were found and listed; 2 wrong usage or unusable input; 130 Ctrl-C; 143 "
    "SIGTERM; 141 the reader of the output left before its end (head, less)."
)


class Help(argparse.HelpFormatter):
    """Help whose paragraphs are filled one by one; lines that begin with four spaces, commands to copy, stay whole."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        paragraphs = []
        for paragraph in text.split("\n\n"):
            lines = paragraph.splitlines()
            whole = len(lines) > 1 and all(line.startswith("    ") for line in lines[1:])
            paragraphs.append(paragraph if whole else super()._fill_text(paragraph, width, indent))
        return "\n\n".join(paragraphs)

    def add_usage(self, usage: str | None, actions: Any, groups: Any, prefix: str | None = None) -> None:
        """Leave out groups none of which is shown, in whose place would be a space more."""
        seen = [one for one in groups if any(action.help != argparse.SUPPRESS for action in one._group_actions)]  # noqa: SLF001
        super().add_usage(usage, actions, seen, prefix)


class Parser(argparse.ArgumentParser):
    """An argument parser whose errors are one line, and that takes no abbreviated options."""

    def __init__(self, **options: Any) -> None:
        settings: dict[str, Any] = {"allow_abbrev": False, "formatter_class": Help} | options
        super().__init__(**settings)

    def error(self, message: str) -> NoReturn:
        """Print one line and exit with 2."""
        said = " ".join(message.split())
        self.exit(UNUSABLE, f"{self.prog}: {said}{' See' if said.endswith('?') else '; see'} {self.prog} --help\n")

    def parse_known_args(self, args: Sequence[str] | None = None, namespace: Any = None) -> Any:  # type: ignore[override]
        """Parse; an option that there is not is the first thing that is said, not what lacks because of it."""
        given = sys.argv[1:] if args is None else list(args)
        if self._subparsers is not None:
            given = _behind_the_command(given)
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
            after = ", and a command's options come after its name" if self._subparsers is not None and not near else ""
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


def add_module(commands: argparse._SubParsersAction[Parser], module: ModuleType) -> None:
    """Add the subcommand that a module is, by its docstring and its function ``add_options``."""
    module.add_options(add_command(commands, module.__name__.rpartition(".")[2], module.__doc__))


def add_command(commands: argparse._SubParsersAction[Parser], name: str, documented: str | None) -> Parser:
    """Add a subcommand that a module's or function's docstring describes."""
    heading = cleandoc(documented or "").partition("\n\n")[0]
    return document(commands.add_parser(name, help=heading.partition("`: ")[2].removesuffix(".")), documented)


def document(parser: Parser, documented: str | None) -> Parser:
    """Make a parser's help what a docstring says, so that it is said once.

    That is a line "`program name`: help.", a description, the examples, indented, and what the help ends with.
    """
    _, *paragraphs = cleandoc(documented or "").split("\n\n")
    examples = [index for index, paragraph in enumerate(paragraphs) if paragraph.startswith("    ")]
    in_one_line = [" ".join(paragraph.split()) for paragraph in paragraphs]
    first = examples[0] if examples else len(paragraphs)
    parser.description, parser.epilog = "\n\n".join(in_one_line[:first]), "\n\n".join(in_one_line[first + 1 :])
    _add_examples(parser, *(line.strip() for index in examples for line in paragraphs[index].splitlines()))
    return parser


def _add_examples(parser: argparse.ArgumentParser, *commands: str) -> None:
    """Put commands to copy first in what a parser's help ends with."""
    if commands:
        lines = "\n".join(f"    {command}" for command in commands)
        heading = "example:" if len(commands) == 1 else "examples:"
        parser.epilog = "\n\n".join(filter(None, (f"{heading}\n{lines}", parser.epilog)))


def terminal_columns() -> int | None:
    """Return how many characters a line of the terminal has; None where the output goes elsewhere."""
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else None


def each_of(*steps: Callable[[], object] | None) -> None:
    """Take all of these steps but ``None``, whatever becomes of some, so that nothing computed is lost.

    Raises
    ------
    Exception
        Afterwards, what a step raised; an ``ExceptionGroup`` if several did. :func:`run` makes one line of it.
    """
    failed: list[Exception] = []
    for step in filter(None, steps):
        try:
            step()
        except Exception as error:  # noqa: BLE001 # raised below
            failed.append(error)
    if len(failed) > 1:
        raise ExceptionGroup("several outputs failed", failed)
    if failed:
        raise failed[0]


def show_and_write(
    arguments: Arguments,
    text: Callable[[], str],
    data: Callable[[], object],
    *more: Callable[[], object] | None,
) -> None:
    """Print a text, write the data that ``--json`` asks for, and take more steps, each as :func:`each_of` does."""
    each_of(lambda: print(text()), arguments.json and (lambda: write_json(arguments.json, data())), *more)


def chosen(arguments: Arguments, names: Iterable[str]) -> dict[str, Any]:
    """Return options as keyword arguments, for functions whose parameters are called as the options are stored."""
    return {name: getattr(arguments, name) for name in names}


def add_cameras(parser: argparse.ArgumentParser) -> None:
    """Add ``--camera`` to a subcommand."""
    parser.add_argument(
        "--camera", action="append", dest="cameras", metavar="NAME", help="only this camera; may be repeated"
    )


def add_camera_and_isos(parser: argparse.ArgumentParser) -> None:
    """Add ``--camera`` and ``--iso`` to a subcommand: which of a folder's calibration frames it takes."""
    parser.add_argument("--camera", metavar="NAME", help="the camera's name (default: the only camera there)")
    parser.add_argument(
        "--iso",
        action="append",
        dest="isos",
        type=whole_number(1),
        metavar="ISO",
        help="only this ISO; may be repeated",
    )


@contextmanager
def chosen_workers(arguments: Arguments) -> Iterator[Workers]:
    """Yield the workers that ``--jobs`` or ``--dask`` asks for; a cluster is connected to, and left, in between.

    Usage: ``with chosen_workers(arguments) as workers: verify(..., workers=workers)``.
    """
    from eldata.base.workers import Workers

    if arguments.dask is None:
        yield Workers(arguments.jobs)
        return
    try:
        from distributed import Client
    except ImportError as error:
        raise EldataError("--dask needs Dask's distributed: pip install 'eldata[dask]'") from error
    try:
        client = Client(arguments.dask, timeout=_DASK_S, set_as_default=False)  # type: ignore[no-untyped-call]
    except (OSError, ValueError, ImportError) as error:
        reason = f"no Dask scheduler answers at {arguments.dask} ({error})"
        raise EldataError(f"{reason}; is it running, and can this machine reach its port?") from error
    with client:
        yield Workers(executor=client.get_executor())  # type: ignore[no-untyped-call]


class _Default(int):
    """A default that argparse can tell from the same number on the command line: small ints share their identity."""


def running_options() -> dict[str, dict[str, Any]]:
    """Return the options of a program's running: how ``add_argument`` takes each."""
    cpus = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return {
        "root": {"metavar": "R", "help": "folder that holds the datasets (default: $ELDATA_ROOT, else ./data)"},
        "json": {"metavar": "FILE", "help": "write what is shown on the terminal to FILE, machine-readable"},
        "jobs": {
            "type": whole_number(1),
            "default": _Default(cpus),
            "metavar": "J",
            "help": "work on this many files at a time (default: one per CPU, here %(default)s)",
        },
        "dask": {
            "metavar": "ADDRESS",
            "help": "work on this Dask cluster instead: its scheduler's address, such as tcp://host:8786 (needs the "
            "extra eldata[dask]; docs/clusters.md)",
        },
        "debug": {"action": "store_true", "help": "show the traceback of an error"},
    }


def _add_running(container: argparse._ActionsContainer, names: Iterable[str], *, shown: bool) -> None:
    workers = container.add_mutually_exclusive_group() if "jobs" in names else container  # one without any is an error
    for name, shown_as in running_options().items():
        if name not in names:
            continue
        options = shown_as if shown else shown_as | {"help": argparse.SUPPRESS}
        if name == "json":
            add_output(container, "--json", **options)
        else:
            (workers if name in ("jobs", "dask") else container).add_argument(f"--{name}", **options)


def _behind_the_command(given: Sequence[str]) -> list[str]:
    """Return arguments with the options of a program's running that come before the command's name behind it."""
    known, rest, moved = running_options(), list(given), []
    while rest and rest[0].startswith("--"):
        name = rest[0].partition("=")[0].removeprefix("--")
        if name not in known:
            break
        count = 1 if "action" in known[name] or "=" in rest[0] else 2
        moved += rest[:count]
        del rest[:count]
    return [*rest[:1], *moved, *rest[1:]]


_BRINGS = {"root": ("root",), "jobs": ("jobs",), "workers": ("jobs", "dask")}


def add_shared(
    parser: argparse.ArgumentParser,
    run: Callable[[Arguments], int],
    *options: Literal["root", "cameras", "isos", "jobs", "workers"],
    json: bool = False,
    interrupted: str = _NONE_HALF,
) -> None:
    """Finish a subcommand: say which of the options that commands share it takes, and what :func:`run` is to call.

    ``"workers"`` are ``--jobs`` and ``--dask``; ``--debug`` is for all. ``interrupted`` says what Ctrl-C leaves;
    ``{name}`` in it is the value of that argument. ``json``: whether it takes ``--json``.
    """
    if "cameras" in options:
        add_cameras(parser)
    if "isos" in options:
        add_camera_and_isos(parser)
    names = [name for option in options for name in _BRINGS.get(option, ())]
    names += ["json", "debug"] if json else ["debug"]
    forms = (f"--{name} {one.get('metavar', '')}".rstrip() for name, one in running_options().items() if name in names)
    parser.add_argument_group("running", f"{', '.join(forms)}: see {parser.prog.partition(' ')[0]} --help")
    parser.set_defaults(
        run=run,
        command=parser.prog,
        interrupted=interrupted,
        actions=parser._actions,  # noqa: SLF001 # which of them name files that the subcommand reads
    )
    # They are shown once, in the program's help.
    _add_running(parser, names, shown=False)


def command_line(
    prog: str, description: str, package: str, modules: Iterable[str], examples: Iterable[str], running: Iterable[str]
) -> Parser:
    """Return a program's parser. Each subcommand is a module of a package (:func:`add_module`).

    ``running`` names the options of its running, which stand before a command's name or after it.
    """
    parser = Parser(
        prog=prog,
        description=description,
        epilog=_EXIT_CODES,
    )
    _add_examples(parser, *examples)
    parser.add_argument("--version", action="version", version=f"{prog} {__version__}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND")
    where = "before a command's name or after it; a command's help names those that it takes"
    _add_running(parser.add_argument_group("running", where), running, shown=True)
    for module in modules:
        add_module(commands, import_module(f"{package}.{module}"))
    return parser


def whole_number(at_least: int) -> Callable[[str], int]:
    """Return the type of an option that takes a whole number, for argparse."""

    def read(text: str) -> int:
        try:
            return whole_of(text, at_least=at_least)
        except ArgumentError as error:
            raise argparse.ArgumentTypeError(str(error)) from None

    return read


def run(parser: argparse.ArgumentParser, argv: list[str] | None) -> int:
    """Parse arguments, run the subcommand's ``run`` and return the exit code.

    A subcommand is set up by :func:`add_shared`. What it raises, and what ends it from outside, is one line on stderr.
    """
    _occupy_closed_streams()
    # What is there already, a parser's own default does not replace.
    arguments = argparse.Namespace(debug=False, command=parser.prog, outputs={})
    out: Any = Screen(sys.stdout)
    err: Any = Screen(sys.stderr, has_bars=True)
    with redirect_stdout(out), redirect_stderr(err):
        try:
            with _terminable():
                code = _parsed_and_run(parser, argv, arguments)
                sys.stdout.flush()
        except (Exception, KeyboardInterrupt) as error:  # noqa: BLE001 # people see one line, --debug shows the rest
            if arguments.debug:
                traceback.print_exception(error)
            code, message = _explained(error, arguments)
            if message:
                with suppress(OSError):  # stderr is full or closed: the code has to do
                    print(f"{arguments.command}: {' '.join(visible(message).split())}", file=sys.stderr)
    return code


class _Terminated(KeyboardInterrupt):
    """SIGTERM, of schedulers, ``timeout`` and containers: what handles Ctrl-C handles it."""


@contextmanager
def _terminable() -> Iterator[None]:
    """Raise :class:`_Terminated` in the block at SIGTERM, unless somebody handles or ignores that already."""
    if threading.current_thread() is not threading.main_thread() or signal.getsignal(signal.SIGTERM) != signal.SIG_DFL:
        yield
        return
    signal.signal(signal.SIGTERM, _terminate)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _terminate(number: int, _: object) -> None:
    signal.signal(number, signal.SIG_IGN)  # timeout(1) sends it twice: what unwinds is not to be disturbed
    raise _Terminated


def _parsed_and_run(parser: argparse.ArgumentParser, argv: list[str] | None, arguments: Arguments) -> int:
    try:
        parser.parse_args(argv, arguments)
    except SystemExit as leaving:  # argparse has said why
        return leaving.code if isinstance(leaving.code, int) else UNUSABLE
    if not hasattr(arguments, "run"):
        parser.print_usage(sys.stderr)
        print(f"{parser.prog}: a command is needed; see {parser.prog} --help", file=sys.stderr)
        return UNUSABLE
    check_outputs(arguments)
    code: int = arguments.run(arguments)
    return code


def _explained(error: BaseException, arguments: Arguments) -> tuple[int, str]:
    """Return exit code and message of what a command raised."""
    if isinstance(error, ExceptionGroup):
        codes, messages = zip(*(_explained(one, arguments) for one in error.exceptions), strict=True)
        return min(codes), "; ".join(filter(None, messages))
    if isinstance(error, EldataError):
        return UNUSABLE, str(error)
    if isinstance(error, KeyboardInterrupt):
        number, word = (15, "terminated") if isinstance(error, _Terminated) else (2, "interrupted")
        kept = getattr(arguments, "interrupted", _NONE_HALF if hasattr(arguments, "run") else "nothing was begun")
        return 128 + number, f"{word}; {kept.format_map(vars(arguments))}"
    if isinstance(error, BrokenPipeError):  # head, less: nothing to say, but nobody knows that all is well
        _drop_output()
        return CLOSED_PIPE, ""
    if isinstance(error, OSError) and error.filename is not None:
        return UNUSABLE, f"{error.filename}: {error.strerror}"
    if isinstance(error, OSError) and error.strerror:
        _drop_output()
        return UNUSABLE, f"the system refused a step of this: {error.strerror}; --debug shows which"
    if isinstance(error, ImportError):
        return UNUSABLE, f"a library does not load ({error}): install eldata again, in a fresh environment"
    return UNUSABLE, f"unexpected {type(error).__name__}: {error}; --debug shows where"


def _drop_output() -> None:
    # Or the interpreter would try to flush once more at its end, and complain.
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _occupy_closed_streams() -> None:
    """Give standard streams that were closed at the start (``>&-``) their places back.

    Or the next file that is opened would take them, and get what a library prints. Writing to standard output is still
    the error that it is on a full disk; standard error goes nowhere, standard input is empty.
    """
    for number, (name, flags) in enumerate((("stdin", os.O_RDONLY), ("stdout", os.O_RDONLY), ("stderr", os.O_WRONLY))):
        if getattr(sys, name) is not None:
            continue
        try:
            os.fstat(number)
        except OSError:
            taken = os.open(os.devnull, flags)
            if taken != number:
                os.dup2(taken, number)
                os.close(taken)
        setattr(sys, name, open(number, "w" if number else "r", closefd=False))  # noqa: SIM115 # for good
