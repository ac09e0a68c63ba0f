"""The command `taut`. Exit status 0: done; 1: the run failed; 2: the request was wrong."""

from __future__ import annotations

import signal

try:  # while modules are loaded, Ctrl-C ends the process as the system does it, without a traceback of imports
    _HANDLER = signal.signal(signal.SIGINT, signal.SIG_DFL)
except ValueError:  # in another thread than the main one, which gets no signals
    _HANDLER = None

import argparse
import dataclasses
import json
import os
import sys
import warnings
from collections.abc import Callable, Sequence
from contextlib import chdir, redirect_stdout, suppress
from pathlib import Path
from typing import Any, Final, NoReturn, TextIO, cast

from rich.console import Console
from rich.table import Table

from taut.base.errors import FileError, ModelError, TautError, UsageError
from taut.base.words import printable
from taut.cli.compare import COMPARE, add_compare, compare_from
from taut.scenarios.name_value import with_negative_values

__all__ = ["main"]

DONE, FAILED, WRONG = 0, 1, 2
ENGINES: Final = ("auto", "native", "float")
UNBROKEN: Final = 10_000  # columns, of a table of any size


STATUS: Final = """exit status:
  0  done
  1  the run failed, or missed a pass figure
  2  the request was wrong
"""
RUN: Final = f"""examples:
  taut run one_joint_pid
  taut run my_scenario.toml --out results
  taut run one_joint_pid --law my_law.py:Spring --gain k=2.0

The metrics are printed as a table; below it stands each file that was made.

{STATUS}"""

DOCTOR: Final = """examples:
  taut doctor run.mcap
  taut doctor run.mcap --arm my_arm.urdf --out findings

exit status:
  0  done, whatever was found
  2  the request was wrong: no log, or one of a run that is too short, has gaps or ended in a fault, of which is
     printed what can be said
"""


BOOK: Final = f"""examples:
  taut book
  taut book fig-10.6 eq-10.14 --out results

A row that is farther from what is expected than it may be is marked (!), and the exit status is 1.

{STATUS}"""


class _Help(argparse.RawDescriptionHelpFormatter):
    """Help with the names of the commands in one column."""

    def __init__(self, prog: str) -> None:
        super().__init__(prog, max_help_position=32)
        self._action_max_length = len("scenarios") + 4  # argparse forgets that commands are indented


class _Parser(argparse.ArgumentParser):
    """Wrong arguments are one sentence on standard error, like every other wrong request."""

    def error(self, message: str) -> NoReturn:
        raise UsageError(f"{message}; {self.prog} --help lists what it takes")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        argv: Arguments; those of the process if left out.

    Returns:
        The exit status.
    """
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
    """Standard output. Where it cannot be written the command goes on to its end: its files and its status count.

    A reader of a pipe that went away has seen what it wanted; anything else is in `refusal` to be reported.
    """

    def __init__(self, file: TextIO) -> None:
        self._file = file
        self.refusal: OSError | None = None

    def write(self, text: str) -> int:
        self._try(lambda: self._file.write(text))
        return len(text)

    def flush(self) -> None:
        self._try(self._file.flush)

    def _try(self, action: Callable[[], object]) -> None:
        if self.refusal is not None:
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
    """Run the command line: the exit status."""
    try:
        arguments = _parser().parse_args(with_negative_values(words))
        arguments.words = words
        command: Callable[[argparse.Namespace], int] = arguments.command
        with warnings.catch_warnings():
            warnings.showwarning = _show_warning
            _ignore_matplotlibrc()
            with redirect_stdout(cast("TextIO", _Plain(sys.stdout)) if sys.stdout else sys.stdout):
                return command(arguments)
    except TautError as wrong:
        _tell(str(wrong))
        return WRONG
    except OSError as refusal:  # such as no file descriptors
        place = "" if refusal.filename is None else f" '{refusal.filename}'"
        _tell(f"the system refuses{place}: {refusal.strerror or refusal}")
        return FAILED
    except KeyboardInterrupt:
        _tell("interrupted")
        return FAILED


class _Plain:
    """A stream on which nothing that came from a file can command a terminal: everything is written as it reads."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        return self._stream.write(printable(text, lines=True))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


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


def _parser() -> argparse.ArgumentParser:
    from taut import __version__
    from taut.cli import design as design_command

    parser = _Parser(
        prog="taut",
        description="Control laws for robot arms, written once and run everywhere.",
        epilog=f"taut COMMAND --help says more about a command.\n\n{STATUS}",
        formatter_class=_Help,
    )
    parser.add_argument("--version", action="version", version=f"taut {__version__}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)

    def add(name: str, run: Callable[[argparse.Namespace], int], help_: str) -> argparse.ArgumentParser:
        command = commands.add_parser(name, help=help_, description=help_, epilog=STATUS, formatter_class=_Help)
        command.set_defaults(command=run)
        command.add_argument("--json", action="store_true", help="print the result as JSON")
        return command

    scenario = add("run", _run, "Run a scenario: a built-in one by its name, or a .toml file.")
    scenario.epilog = RUN
    scenario.add_argument("scenario", metavar="SCENARIO", help="a name that `taut scenarios` lists, or a path")
    scenario.add_argument("--out", type=Path, metavar="DIR", help="folder for the files (default: out/SCENARIO)")
    scenario.add_argument(
        "--law",
        metavar="FILE.py:CLASS",
        help="a law of your own instead of the scenario's laws, whose pass figures then do not count",
    )
    scenario.add_argument(
        "--gain",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="a gain of that law, such as kp=100 or kp=[100,50]; once for each gain",
    )
    scenario.add_argument(
        "--engine",
        choices=ENGINES,
        default="auto",
        help="native: machine code; float: plain Python, slow; auto: the first that is there (default)",
    )
    comparison = add("compare", _compare, "Compare laws on a scenario, or grade a law against a reference law.")
    comparison.epilog = f"{COMPARE}\n{STATUS}"
    add_compare(comparison, ENGINES)
    document = add("report", _report, "Write a report of a recorded run: one HTML file with everything in it.")
    document.add_argument("run", metavar="RUN.mcap", help="a log that taut run or run.save wrote")
    document.add_argument(
        "-o", "--out", type=Path, default=Path("report.html"), metavar="FILE.html", help="(default: report.html)"
    )
    document.add_argument("--title", default="", metavar="TEXT", help="a title, instead of the usual one")
    add("scenarios", _scenarios, "List the built-in scenarios.")
    add("arms", _arms, "List the arms that taut knows by name.")
    add("laws", _laws, "List the laws with their equations and what they need measured.")
    check = add("check", _check, "Read a robot model and say what is in it and everything that is wrong with it.")
    check.add_argument("model", metavar="MODEL", help="a name, a .urdf or an MJCF .xml file")
    patient = add("doctor", _doctor, "Say why a recorded run sags, oscillates, sticks, saturates, ...")
    patient.epilog = DOCTOR
    patient.add_argument("run", type=Path, metavar="RUN", help="a log (.mcap) of a run")
    patient.add_argument("--arm", metavar="MODEL", help="the arm that the controller was compiled for")
    patient.add_argument("--out", type=Path, metavar="DIR", help="folder for a picture of each finding")
    gains = add("design", _design, "Find the gains of a law from a specification, and what they run into.")
    gains.epilog = design_command.EXAMPLES
    design_command.add_arguments(gains)
    bench = add("bench", _bench, "Measure what a tick, a compile and a closed loop cost on this machine.")
    bench.add_argument("arm", nargs="?", default="planar3", metavar="ARM", help="name or file (default: planar3)")
    book = add("book", _book, "Compute the chapter's equations and figures, beside what they should be.")
    book.epilog = BOOK
    book.add_argument("ids", nargs="*", metavar="ID", help="eq-10.6, fig-10.6, sec-10.2.1.5; all if left out")
    book.add_argument("--out", type=Path, metavar="FOLDER", help="folder for pictures and tables (default: out/book)")
    return parser


def _print_json(value: Any) -> None:
    print(json.dumps(value, indent=1, allow_nan=False))


def _console(whole: int = 140) -> Console:
    """A console as wide as the terminal, or as COLUMNS says; in a file or a pipe wide enough to keep tables whole."""
    console = Console(color_system=None)
    keep = console.is_terminal or "COLUMNS" in os.environ
    return console if keep else Console(color_system=None, width=whole)


def _widened(console: Console, table: Table) -> Console:
    """In a file or a pipe a console that is as wide as a table needs, so that no number is broken."""
    if console.is_terminal or "COLUMNS" in os.environ:
        return console
    return Console(color_system=None, width=max(console.width, Console(width=UNBROKEN).measure(table).maximum))


def _say(arguments: argparse.Namespace) -> Callable[[str], None]:
    """Lines of progress, for people at a terminal."""

    def say(text: str) -> None:
        if not arguments.json and sys.stderr.isatty():
            print(printable(text), file=sys.stderr)

    return say


# -------------------------------------------------------------------- commands


def _run(arguments: argparse.Namespace) -> int:
    from taut.cli.user_law import load_law
    from taut.record.phases import PHASES
    from taut.scenarios.run import run_scenario
    from taut.scenarios.scenario import load_scenario

    if arguments.gain and arguments.law is None:
        raise UsageError("--gain is for a law of your own: --law FILE.py:CLASS --gain kp=100")
    own = None if arguments.law is None else {arguments.law: load_law(arguments.law, arguments.gain)}
    scenario = load_scenario(arguments.scenario, own)
    folder = arguments.out or Path("out") / scenario.name

    result = run_scenario(scenario, folder, say=_say(arguments), engine=arguments.engine)
    if arguments.json:
        _print_json(result.json())
    else:
        console = _console(whole=120)
        table = result.table(console.width)
        _widened(console, table).print(table)
        for kind, path in result.outputs.items():
            print(f"{kind:8} {path}")
        for kind, reason in result.skipped.items():
            print(printable(f"no {kind}: {reason}"))
        for trial, one in result.runs.items():
            if not one.outcome.ok or PHASES in one.info or "; " in one.outcome.message:
                print(printable(f"{trial.label}: {one.outcome}"))
        for text in result.missed:
            print(printable(f"missed: {text}"))
        if result.figures:
            print(f"reached: {result.figures - len(result.missed)} of {result.figures} pass figures")
    return DONE if result.ok else FAILED


def _compare(arguments: argparse.Namespace) -> int:
    done = compare_from(arguments, _say(arguments))
    if arguments.json:
        _print_json(done.json())
        return DONE if done.ok else FAILED
    print(done.report())
    for kind in ("plot", "report"):
        path = getattr(arguments, kind)
        if path is not None:
            print(f"{kind:8} {path}")
    return DONE if done.ok else FAILED


def _report(arguments: argparse.Namespace) -> int:
    from taut.record.log.files import checked_target
    from taut.record.log.reading import load_run
    from taut.record.report.report import report
    from taut.record.report.run_report import faults_of

    checked_target("report", arguments.out, (".html", ".htm"))
    run = load_run(arguments.run)
    report(run, arguments.out, title=arguments.title, log=Path(arguments.run).name)
    if arguments.json:
        _print_json({"report": str(arguments.out), "outcome": run.outcome.json()})
    else:
        print(f"report   {arguments.out}")
    faults = faults_of(run)
    for fault in faults:
        _tell(f"'{arguments.run}' is no whole run, and the report is of what there is: {fault}")
    return WRONG if faults else DONE


def _scenarios(arguments: argparse.Namespace) -> int:
    from taut.scenarios.scenario import built_in_scenarios
    from taut.scenarios.toml import read_toml

    rows = [(name, read_toml(path).text("title", name), path) for name, path in built_in_scenarios().items()]
    if arguments.json:
        _print_json([{"name": name, "title": title, "file": str(path)} for name, title, path in rows])
        return DONE
    table = Table("scenario", "what it shows", title="taut run SCENARIO")
    for name, title, _ in rows:
        table.add_row(name, title)
    _console().print(table)
    return DONE


def _arms(arguments: argparse.Namespace) -> int:
    from taut.arm.report import arm_rows

    rows = list(arm_rows())
    if arguments.json:
        _print_json([dataclasses.asdict(row) for row in rows])
        return DONE
    table = Table("arm", "joints", "takes in real life", "from", "installed", title="taut.load_arm(NAME)")
    for row in rows:
        table.add_row(
            row.name, str(row.joints), ", ".join(row.commands), row.source, "yes" if row.installed else "no"
        )
    _console().print(table)
    return DONE


def _laws(arguments: argparse.Namespace) -> int:
    from taut.cli.law_table import law_rows

    rows = law_rows()
    if arguments.json:
        _print_json([row.json() for row in rows])
        return DONE
    width = _console().width
    print("\n\n".join(row.text(width) for row in rows))
    return DONE


def _check(arguments: argparse.Namespace) -> int:
    from taut.arm.load import open_model
    from taut.arm.report import check_model

    report = check_model(arguments.model)
    if report.opened is None and not arguments.json:
        with suppress(ModelError):  # a model that is broken has its report; a name without a model ends here
            open_model(arguments.model)
    if arguments.json:
        _print_json(report.json())
    else:
        print(report.text())
    return DONE if report.ok else WRONG


def _doctor(arguments: argparse.Namespace) -> int:
    from taut.cli.doctor import examine

    report = examine(arguments.run, arguments.arm, arguments.out)
    if arguments.json:
        _print_json(report.json())
    else:
        print(report.text())
    for problem in report.diagnosis.problems:
        _tell(f"'{report.log}' is no whole run: {problem}")
    return DONE if report.ok else WRONG


def _design(arguments: argparse.Namespace) -> int:
    from taut.cli.design import design_of

    found = design_of(arguments)
    if arguments.json:
        _print_json(found.json())
    else:
        print(found.report())
    return DONE if found.met else FAILED


def _bench(arguments: argparse.Namespace) -> int:
    from taut.arm.load import load_arm
    from taut.cli.bench import bench_arm

    rows = bench_arm(load_arm(arguments.arm))
    if arguments.json:
        _print_json(dict(rows))
    else:
        for what, figure in rows:
            print(f"{what:22} {figure}")
    return DONE


def _book(arguments: argparse.Namespace) -> int:
    from taut.book import contents

    def say(text: str) -> None:
        if not arguments.json and sys.stderr.isatty():
            print(printable(text), file=sys.stderr)

    entries = contents.chosen(arguments.ids)
    folder = contents.prepared_folder(arguments.out or Path("out") / "book")
    pages = contents.made(entries, say)
    rows = [pair for page in pages for pair in page.rows]
    if arguments.json:
        _print_json([each.json(name) for name, each in rows])
    else:
        console = _console(whole=120)
        console.print(contents.table(pages, console.width))
    try:
        written = contents.write(pages, folder)
    except FileError as wrong:
        _tell(str(wrong))
        return FAILED
    missed = [f"{name}: {each.quantity}" for name, each in rows if not each.ok]
    if not arguments.json:
        for page in pages:
            if page.page.note:
                print(f"{page.entry.id}: {page.page.note}")
        for name, path in written.items():
            print(f"{name:20} {path}")
        for text in missed:
            print(f"missed: {text}")
        print(f"{len(rows) - len(missed)} of {len(rows)} numbers are what they should be")
    return FAILED if missed else DONE


if _HANDLER is not None:
    signal.signal(signal.SIGINT, _HANDLER)
