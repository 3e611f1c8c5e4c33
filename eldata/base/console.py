"""What every command line of this distribution shares: help by docstrings, one line for an error, exit codes.

Exit codes: 0 all well; 1 problems were found and listed; 2 wrong usage or unusable input; 130 Ctrl-C; 143 SIGTERM; 141
the reader of the output left before its end (head, less).
"""

from __future__ import annotations

import argparse
import io
import os
import signal
import sys
import tempfile
import threading
import traceback
from contextlib import contextmanager, nullcontext, redirect_stdout, suppress
from importlib import import_module
from inspect import cleandoc
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, NoReturn, TypeAlias

from eldata import __version__
from eldata.base.files import write_json, write_problem
from eldata.base.numbers import available_cpus, whole_of
from eldata.base.visible import visible
from eldata.errors import ArgumentError, EldataError, did_you_mean

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

    from eldata.base.workers import Workers

Arguments: TypeAlias = argparse.Namespace
"""What a subcommand's function ``run`` is handed."""

OK, PROBLEMS, UNUSABLE, CLOSED_PIPE = 0, 1, 2, 141
_NONE_HALF = "files are written whole or not at all, so none is left half"
_DASK_S = 10  # for a scheduler to answer
_EXIT_CODES = cleandoc(__doc__ or "").partition("\n\n")[2]


# --- parsers ----------------------------------------------------------------------------------------------------------


class Help(argparse.HelpFormatter):
    """Help with a short usage, and paragraphs filled one by one; indented lines, commands to copy, stay whole."""

    def __init__(self, prog: str) -> None:
        super().__init__(prog)
        self._action_max_length = 14  # or names of commands, which are indented twice, get lines of their own

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        """Wrap each paragraph; indented ones, which are examples, stay as they are."""
        return "\n\n".join(
            paragraph if paragraph.startswith("    ") else super(Help, self)._fill_text(paragraph, width, indent)
            for paragraph in text.split("\n\n")
        )

    def _format_usage(self, usage: str | None, actions: Iterable[Any], groups: Any, prefix: str | None) -> str:
        """Format a usage line of the required arguments and ``[options]``."""
        del groups
        needed = [action for action in actions if action.required or not action.option_strings]
        options = "" if usage or len(needed) == len(list(actions)) else " [options]"
        return f"{super()._format_usage(usage, needed, [], prefix).rstrip()}{options}\n\n"


class Parser(argparse.ArgumentParser):
    """An argument parser whose errors are one line, and that takes no abbreviated options."""

    def __init__(self, **options: Any) -> None:
        settings: dict[str, Any] = {"allow_abbrev": False, "formatter_class": Help} | options
        super().__init__(**settings)

    elsewhere: ClassVar[Mapping[str, str]] = {"train": "; training: python -m eldata.examples.train_denoiser"}

    def error(self, message: str) -> NoReturn:
        """Print one line and exit with 2."""
        line = " ".join(message.split())
        self.exit(UNUSABLE, f"{self.prog}: {line}{' See' if line.endswith('?') else '; see'} {self.prog} --help\n")

    def parse_known_args(self, args: Sequence[str] | None = None, namespace: Any = None) -> Any:  # type: ignore[override]
        """Parse; an unknown option is named first, before arguments that are missing because of it."""
        texts = sys.argv[1:] if args is None else list(args)
        known = [option for option in self._option_string_actions if option.startswith("--")]
        for text in texts:
            name = text.partition("=")[0]
            if text == "--" or (self._subparsers is not None and not text.startswith("-")):
                break  # the rest are no options, or a command's
            if name.startswith("--") and " " not in name and name not in known:
                where = ", and a command's options come after its name" if self._subparsers is not None else ""
                self.error(f"there is no option {name}{where}{did_you_mean(name, known)}")
        known_arguments, extra = super().parse_known_args(texts, namespace)
        if extra and self._subparsers is None:  # or the program would say it, and point to its own help
            self.error(f"unrecognized arguments: {' '.join(extra)}")
        return known_arguments, extra

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Refuse an unknown command or choice, with the known ones and a similar one."""
        if action.choices is None or value in action.choices:
            return
        known = [str(choice) for choice in action.choices]
        hint = did_you_mean(str(value), known) or self.elsewhere.get(str(value), "")
        if isinstance(action, argparse._SubParsersAction):  # noqa: SLF001 # its only name
            raise argparse.ArgumentError(None, f"there is no command {value!r}; commands are {', '.join(known)}{hint}")
        raise argparse.ArgumentError(action, f"invalid choice: {value!r} (choose from {', '.join(known)}){hint}")


def command_line(prog: str, description: str, package: str, modules: Iterable[str], examples: Iterable[str]) -> Parser:
    """Make a program's parser. Each subcommand is a module of a package: its docstring, and ``add_options``."""
    lines = "\n".join(f"    {example}" for example in examples)
    parser = Parser(prog=prog, description=f"{description}\n\n{lines}", epilog=_EXIT_CODES)
    parser.add_argument("--version", action="version", version=f"{prog} {__version__}", help="show the version")
    parser.set_defaults(bare=parser)
    commands = parser.add_subparsers(title="commands", metavar="COMMAND")
    for name in modules:
        module = import_module(f"{package}.{name}")
        module.add_options(add_command(commands, name, module.__doc__))
    return parser


def add_command(commands: argparse._SubParsersAction[Parser], name: str, documented: str | None) -> Parser:
    """Add a subcommand that a module's or function's docstring describes."""
    heading = cleandoc(documented or "").partition("\n\n")[0]
    parser = document(commands.add_parser(name, help=heading.partition("`: ")[2].removesuffix(".")), documented)
    parser.set_defaults(bare=parser)
    return parser


def document(parser: Parser, documented: str | None) -> Parser:
    """Describe a parser by a docstring: a line "`program name`: help.", then paragraphs and indented examples."""
    parser.description = cleandoc(documented or "").partition("\n\n")[2]
    return parser


# --- options that commands share --------------------------------------------------------------------------------------


def whole_number(at_least: int) -> Callable[[str], int]:
    """Make the type of an option that takes a whole number, for argparse."""

    def read(text: str) -> int:
        try:
            return whole_of(text, at_least=at_least)
        except ArgumentError as error:
            raise argparse.ArgumentTypeError(str(error)) from None

    return read


def add_shared(
    parser: argparse.ArgumentParser,
    run: Callable[[Arguments], int],
    *options: Literal["root", "jobs", "workers"],
    json: bool = False,
    interrupted: str = _NONE_HALF,
) -> None:
    """Finish a subcommand: add the options that commands share, and say what :func:`run` is to call.

    ``"workers"`` are ``--jobs`` and ``--dask``; ``--debug`` is for all. ``interrupted`` says what Ctrl-C leaves;
    ``{name}`` in it is the value of that argument. ``json``: whether it takes ``--json``.
    """
    if "root" in options:
        parser.add_argument("--root", metavar="R", help="datasets' folder (default: $ELDATA_ROOT, else ./data)")
    if json:
        add_output(parser, "--json", help="write what is shown as JSON; -: to standard output")
    if "jobs" in options or "workers" in options:
        text = "files to work on at a time (default: one per CPU)"
        where = parser.add_mutually_exclusive_group()
        where.add_argument("--jobs", type=whole_number(1), default=available_cpus(), metavar="J", help=text)
        if "workers" in options:
            text = "Dask scheduler to work on, such as tcp://host:8786"
            where.add_argument("--dask", metavar="ADDRESS", help=text)
    parser.add_argument("--debug", action="store_true", help="show the traceback of an error")
    parser.set_defaults(run=run, command=parser.prog, interrupted=interrupted)


def add_cameras(parser: argparse.ArgumentParser) -> None:
    """Add ``--camera`` to a subcommand."""
    text = "only this camera; may be repeated"
    parser.add_argument("--camera", action="append", dest="cameras", metavar="NAME", help=text)


@contextmanager
def chosen_workers(arguments: Arguments) -> Iterator[Workers]:
    """Yield the workers of ``--jobs`` or ``--dask``; a Dask cluster stays connected for the block."""
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


def chosen(arguments: Arguments, names: Iterable[str]) -> dict[str, Any]:
    """Collect options by name as keyword arguments for a function with parameters of these names."""
    return {name: getattr(arguments, name) for name in names}


# --- outputs ----------------------------------------------------------------------------------------------------------


def each_of(*steps: Callable[[], object] | None) -> None:
    """Run all steps, except ``None``, even if some fail, so that no result is lost.

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
    arguments: Arguments, text: Callable[[], str], data: Callable[[], object], *more: Callable[[], object] | None
) -> None:
    """Print a text, write the data for ``--json``, and run more steps, all by :func:`each_of`."""
    each_of(lambda: print(text()), arguments.json and (lambda: write_json(arguments.json, data())), *more)


def add_output(
    parser: argparse._ActionsContainer,
    *names: str,
    beside: Sequence[str] = (),
    makes_folder: bool = False,
    **options: Any,
) -> None:
    """Add an option that names a file to write, which is checked before the subcommand's work.

    ``beside`` has the suffixes of what is written in the same folder under the same name. The folder must exist,
    unless the subcommand makes it. What has been computed is written through :func:`each_of`.
    """
    action = parser.add_argument(*names, **{"metavar": "FILE"} | options)
    outputs = parser.get_default("outputs") or {}
    parser.set_defaults(outputs=outputs | {action.dest: (names[0], beside, makes_folder)})


def _check_outputs(arguments: Arguments) -> None:
    """Refuse a command whose files cannot be written, or that reads one of them, by whatever name."""
    others = [value for name, value in vars(arguments).items() if name not in arguments.outputs]
    inputs = [text for value in others for text in (value if isinstance(value, list) else [value])]
    for dest, (option, beside, makes_folder) in arguments.outputs.items():
        name = getattr(arguments, dest)
        if name is None:
            continue
        for path in (Path(name), *(Path(name).with_suffix(suffix) for suffix in beside if name)):
            problem = None if makes_folder and not path.parent.exists() else write_problem(path)
            if problem is not None:
                raise ArgumentError(f"{option}: cannot write {path}: {problem}")
            if any(isinstance(text, str | Path) and _is_same_file(path, text) for text in inputs):
                raise ArgumentError(f"{option}: {path} is a file that this command reads; give another name")


def _is_same_file(path: Path, other: str | Path) -> bool:
    """Tell whether both paths are one file, links followed; not if either is missing."""
    try:
        return path.samefile(other)
    except (OSError, ValueError):  # one of them is missing, or no path at all
        return False


# --- running ----------------------------------------------------------------------------------------------------------


def run(parser: argparse.ArgumentParser, argv: list[str] | None) -> int:
    """Parse arguments, run the subcommand's ``run`` and return the exit code.

    A subcommand is set up by :func:`add_shared`. What it raises, and what ends it from outside, is one line on stderr.
    """
    if sys.stdout is None or sys.stderr is None:  # closed at the start: >&-
        nowhere = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115 # for good
        sys.stdout, sys.stderr = sys.stdout or nowhere, sys.stderr or nowhere
    # What is there already, a parser's own default does not replace.
    arguments = argparse.Namespace(debug=False, command=parser.prog)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # names of files may be no text
    try:
        with _terminable():
            code = _parse_and_run(parser, argv, arguments)
            sys.stdout.flush()
    except (Exception, KeyboardInterrupt) as error:  # noqa: BLE001 # people see one line, --debug shows the rest
        if arguments.debug:
            traceback.print_exception(error)
        code, message = _explain(error, arguments)
        if message:
            with suppress(OSError):  # stderr is full or closed: the code has to do
                print(f"{arguments.command}: {' '.join(visible(message).split())}", file=sys.stderr)
    return code


@contextmanager
def _terminable() -> Iterator[None]:
    """Treat SIGTERM (of schedulers, ``timeout``, containers) as Ctrl-C, unless it is handled or ignored already."""
    if threading.current_thread() is not threading.main_thread() or signal.getsignal(signal.SIGTERM) != signal.SIG_DFL:
        yield
        return
    signal.signal(signal.SIGTERM, _terminate)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _terminate(number: int, _: object) -> None:
    """Handle SIGTERM like Ctrl-C, once; the signal is ignored from then on."""
    signal.signal(number, signal.SIG_IGN)  # timeout(1) sends it twice: what unwinds is not to be disturbed
    raise KeyboardInterrupt(number)


def _parse_and_run(parser: argparse.ArgumentParser, argv: list[str] | None, arguments: Arguments) -> int:
    """Run the subcommand that ``argv`` names; print the file of ``--json -`` or ``--csv -`` at its end."""
    words = sys.argv[1:] if argv is None else argv
    try:
        parser.parse_args([*words[1:], "--help"] if words[:1] == ["help"] else words, arguments)
    except SystemExit as leaving:  # argparse has said why
        return leaving.code if isinstance(leaving.code, int) else UNUSABLE
    if not hasattr(arguments, "run"):
        arguments.bare.print_help(sys.stderr)
        return UNUSABLE
    streamed = [dest for dest in ("json", "csv") if getattr(arguments, dest, None) == "-"]
    if len(streamed) > 1:
        raise ArgumentError("--json - and --csv - would both go to standard output; name a file for one")
    with tempfile.TemporaryDirectory() if streamed else nullcontext("") as folder:
        for dest in streamed:
            setattr(arguments, dest, str(Path(folder, dest)))
        if hasattr(arguments, "outputs"):
            _check_outputs(arguments)
        with redirect_stdout(sys.stderr) if streamed else nullcontext():
            code: int = arguments.run(arguments)
        for dest in streamed:
            with suppress(FileNotFoundError):  # of a command that found nothing to write
                sys.stdout.write(Path(getattr(arguments, dest)).read_text(encoding="utf-8"))
    return code


def _explain(error: BaseException, arguments: Arguments) -> tuple[int, str]:
    """Find the exit code and the message of what a command raised."""
    if isinstance(error, ExceptionGroup):
        codes, messages = zip(*(_explain(each, arguments) for each in error.exceptions), strict=True)
        return min(codes), "; ".join(filter(None, messages))
    if isinstance(error, EldataError):
        return UNUSABLE, str(error)
    if isinstance(error, KeyboardInterrupt):
        number, word = (error.args[0], "terminated") if error.args else (signal.SIGINT, "interrupted")
        kept = getattr(arguments, "interrupted", _NONE_HALF)
        return 128 + number, f"{word}; {kept.format_map(vars(arguments))}"
    if isinstance(error, OSError) and error.filename is not None:
        return UNUSABLE, f"{error.filename}: {error.strerror}"
    if isinstance(error, OSError) and error.strerror:
        with suppress(OSError, ValueError):  # or the interpreter would try to flush once more at its end, and complain
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if isinstance(error, BrokenPipeError):  # head, less: nothing to say, but nobody knows that all is well
            return CLOSED_PIPE, ""
        return UNUSABLE, f"the system refused a step of this: {error.strerror}; --debug shows which"
    if isinstance(error, ImportError):
        advice = "pip install torch" if error.name == "torch" else "install eldata again, in a fresh environment"
        return UNUSABLE, f"a library does not load ({error}): {advice}"
    return UNUSABLE, f"unexpected {type(error).__name__}: {error}; --debug shows where"
