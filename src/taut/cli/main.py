"""The command `taut`. Exit status 0: done; 1: the run failed; 2: the request was wrong."""

from __future__ import annotations

import signal

try:  # while modules are loaded, Ctrl-C ends the process as the system does it, without a traceback of imports
    _HANDLER = signal.signal(signal.SIGINT, signal.SIG_DFL)
except ValueError:  # in another thread than the main one, which gets no signals
    _HANDLER = None

import argparse
import json
import os
import re
import sys
import warnings
from collections.abc import Callable, Sequence
from contextlib import chdir, redirect_stdout, suppress
from pathlib import Path
from typing import Any, Final, NoReturn, TextIO, cast

from taut.base.errors import TautError, UsageError, printable
from taut.cli import analysis, book, models, robots, run, sweep
from taut.cli.command import FAILED, STATUS, WRONG, Command

NEGATIVE: Final = re.compile(r"-(\d|\.\d|inf|nan)", re.IGNORECASE)  # a value, where argparse expects an option

COMMANDS: Final[tuple[Command, ...]] = (
    run.RUN,
    analysis.COMPARE,
    sweep.SWEEP,
    run.REPORT,
    run.SCENARIOS,
    run.EXPORT,
    robots.BRINGUP,
    models.ARMS,
    models.LAWS,
    models.CHECK,
    run.DOCTOR,
    run.REPAIR,
    run.REPLAY,
    analysis.DESIGN,
    models.BENCH,
    book.BOOK,
)


class _Help(argparse.RawDescriptionHelpFormatter):
    """Help with the names of the commands in one column."""

    def __init__(self, prog: str) -> None:
        super().__init__(prog, max_help_position=32)
        self._action_max_length = len("scenarios") + 4  # argparse forgets that commands are indented


class _Parser(argparse.ArgumentParser):
    """Wrong arguments are one sentence on standard error, like every other wrong request."""

    def error(self, message: str) -> NoReturn:
        raise UsageError(f"{message}; {self.prog} --help lists what it takes")


def _parser() -> argparse.ArgumentParser:
    from taut.base import __version__

    parser = _Parser(
        prog="taut",
        description="Control laws for robot arms, written once and run everywhere.",
        epilog=f"taut COMMAND --help says more about a command.\n\n{STATUS}",
        formatter_class=_Help,
    )
    parser.add_argument("--version", action="version", version=f"taut {__version__}")
    parsers = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    for each in COMMANDS:
        command = parsers.add_parser(
            each.name, help=each.help, description=each.help, epilog=each.more, formatter_class=_Help
        )
        command.set_defaults(command=each)
        command.add_argument("--json", action="store_true", help="print the result as JSON")
        for name, argument in each.arguments.items():
            command.add_argument(name, **argument)
        command._negative_number_matcher = NEGATIVE
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line, with the arguments of the process if left out; the exit status."""
    out = _Output(sys.stdout)
    status: int | SystemExit
    with redirect_stdout(cast("TextIO", out)):
        try:
            status = _status(list(sys.argv[1:] if argv is None else argv))
        except SystemExit as done:  # of --help and --version
            status = done
        out.flush()
    if out.refusal is not None and not isinstance(out.refusal, BrokenPipeError):
        _tell(f"standard output cannot be written: {out.refusal.strerror or out.refusal}")
        return FAILED
    if isinstance(status, SystemExit):
        raise status
    return status


class _Output:
    """Standard output on which no text from a file can command a terminal.

    The command goes on to its end where it cannot be written: its files and its status count. A closed pipe is no
    fault; anything else is in `refusal` to be reported.
    """

    def __init__(self, file: TextIO) -> None:
        self._file = file
        self.refusal: OSError | None = None

    def write(self, text: str) -> int:
        self._try(lambda: self._file.write(printable(text, lines=True)))
        return len(text)

    def flush(self) -> None:
        self._try(self._file.flush)

    def _try(self, action: Callable[[], object]) -> None:
        if self.refusal is not None or self._file is None:
            return
        try:
            action()
        except OSError as refusal:
            self.refusal = refusal
            with suppress(OSError):  # what is still in its buffer goes nowhere, also where Python closes it
                os.dup2(os.open(os.devnull, os.O_WRONLY), self._file.fileno())

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)


def _status(words: list[str]) -> int:
    try:
        if not words:
            _parser().print_help()
            return WRONG
        arguments = _parser().parse_args(words)
        arguments.words = words
        with warnings.catch_warnings():
            warnings.showwarning = _show_warning
            _ignore_matplotlibrc()
            return _answered(arguments)
    except TautError as wrong:
        _tell(str(wrong))
        return WRONG
    except OSError as refusal:  # such as no file descriptors
        place = "" if refusal.filename is None else f" '{refusal.filename}'"
        _tell(f"the system refuses{place}: {refusal.strerror or refusal}")
        return FAILED
    except KeyboardInterrupt as stop:
        _tell("; ".join(("interrupted", *map(str, stop.args))))
        return FAILED


def _answered(arguments: argparse.Namespace) -> int:
    """Run a command and print what it found: the exit status."""

    def say(text: str) -> None:  # lines of progress, for people at a terminal
        if not arguments.json and sys.stderr.isatty():
            print(printable(text), file=sys.stderr)

    answer = arguments.command.run(arguments, say)
    if arguments.json:
        print(json.dumps(answer.data, indent=1, allow_nan=False))
    elif answer.text:
        print(answer.text)
    for remark in answer.remarks:
        _tell(remark)
    return int(answer.status)


def _tell(text: str) -> None:
    """A sentence on standard error, if anybody reads it, in one line whatever names in it hold."""
    with suppress(OSError):
        print(f"taut: {printable(text)}", file=sys.stderr)


def _ignore_matplotlibrc() -> None:
    """matplotlib obeys a matplotlibrc of the current folder, which belongs to whoever made the folder."""
    if os.path.lexists("matplotlibrc"):
        with chdir(Path(__file__).parent):
            import matplotlib  # noqa: F401


def _show_warning(message: Warning | str, *_: object, **__: object) -> None:
    """A warning is a sentence for people; where in the code it was raised is not."""
    _tell(str(message))


if _HANDLER is not None:
    signal.signal(signal.SIGINT, _HANDLER)
