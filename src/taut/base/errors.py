"""The one tree of errors, and the words they share.

A message has four parts: what, the rule, the actual value, and how to fix it. The error keeps the data as attributes.
"""

from __future__ import annotations

import copy
import difflib
import functools
import pickle
import re
import sys
import sysconfig
import traceback
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any, ClassVar, Final, Self


class TautError(Exception):
    """Base of every error that taut raises. Its class has a `code` after its name: TAUT-SHAPE of ShapeError.

    Args:
        message: One sentence: what, rule, actual value, how to fix it.
        name: The argument, gain, frame or file that the sentence is about.
        joint: The joint that it is about, where there is one.
        value: The actual value.
        rule: The rule that was broken, in words.
    """

    code: ClassVar[str] = "TAUT"

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        cls.code = "TAUT" + re.sub("[A-Z]", r"-\g<0>", cls.__name__.removesuffix("Error")).upper()

    def __init__(
        self,
        message: str,
        *,
        name: str | None = None,
        joint: str | None = None,
        value: object = None,
        rule: str | None = None,
    ) -> None:
        super().__init__(printable(message, lines=True))
        self.name = name
        self.joint = joint
        self.value = value
        self.rule = rule

    def about(self, name: str, other: str) -> Self:
        """The error under another name of what it is about: a path in the place of a field's own name."""
        error, text = copy.copy(self), str(self)
        if text.startswith(name):
            error.args = (other + text.removeprefix(name),)
        error.name = other if self.name == name else self.name
        return error

    def __reduce__(self) -> tuple[Any, ...]:
        """Copies and pickles go without the constructor; a value that cannot be pickled becomes text."""
        state = {**vars(self), **{key: getattr(self, key) for key in ("name", "joint", "value", "rule")}}
        try:
            pickle.dumps(self.value)
        except Exception:  # whatever the class of a foreign value says of itself
            state["value"] = repr(self.value)
        return _revived, (type(self), self.args, state)


def _revived(kind: type[TautError], args: tuple[Any, ...], state: Mapping[str, Any]) -> TautError:
    error = kind.__new__(kind, *args)
    super(TautError, error).__init__(*args)  # that of the built-in class beside it
    for key, value in state.items():
        setattr(error, key, value)
    return error


class ShapeError(TautError, ValueError):
    """An array has the wrong number of entries or dimensions, or is no array of numbers."""


class RangeError(TautError, ValueError):
    """A number is not finite, has the wrong sign, or breaks another rule about its value."""


class UsageError(TautError, TypeError):
    """Arguments that do not go together, or one that is missing."""


class UnknownNameError(TautError, LookupError):
    """A name of a frame, joint, law, parameter or arm that does not exist."""


class MatchError(TautError, ValueError):
    """Two things that do not fit: a law and a plant, a controller and a reference."""


class TraceError(TautError, TypeError):
    """Law code does something that cannot be traced; the message names file and line."""


class MissingExtraError(TautError, ImportError):
    """A feature needs a package that is not installed."""


class FileError(TautError, OSError):
    """A file cannot be read or written, or is not what its name says."""


class ScenarioError(TautError, ValueError):
    """A scenario file breaks its schema; the message names file and key."""


class NumericalError(TautError, ArithmeticError):
    """A tick did not give finite numbers."""


class StabilityWarning(RuntimeWarning):
    """A simulation begins with a loop that is unstable at its start pose."""


@dataclass(frozen=True, kw_only=True)
class Problem:
    """One thing that is wrong with a robot model, and where."""

    object: str
    attribute: str | None
    message: str
    line: int | None = None

    def __str__(self) -> str:
        where = "" if self.line is None else f" (line {self.line})"
        return f"{self.message}{where}"


MODEL_FILES: Final = (".urdf", ".xml", ".mjcf")


class ModelError(TautError, ValueError):
    """A robot model breaks a rule; `problems` lists every one of them."""

    def __init__(self, source: str, problems: Sequence[Problem]) -> None:
        first = problems[0]
        more = len(problems) - 1
        file = Path(source).suffix in MODEL_FILES
        where = f"taut check {source} lists them" if file else "in the error's attribute problems"
        tail = "" if more == 0 else f" (and {more} more: {where})"
        super().__init__(f"{source}: {first}{tail}", name=first.object, rule=first.message, value=None)
        self.source = source
        self.problems = tuple(problems)


def quoted_list(names: Iterable[str], most: int = 12) -> str:
    """Names in quotes, joined by commas; a long list is cut and counted."""
    names = list(names)
    shown = ", ".join(f"'{name}'" for name in names[:most])
    return shown if len(names) <= most else f"{shown} and {len(names) - most} more"


def count_of(number: int, noun: str) -> str:
    """So many of something in words: 1 joint, 2 joints."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def unknown_name(owner: str, kind: str, name: Any, known: Iterable[str], hint: str = "") -> UnknownNameError:
    """The error for a name that does not exist, with the nearest that do.

    Example:
        >>> str(unknown_name("the arm", "frame", "tolo0", ["tool0", "base"]))
        "the arm has no frame 'tolo0'; did you mean 'tool0'?"
    """
    known = list(known)
    if not isinstance(name, str):  # callers without a type checker
        return UnknownNameError(f"a {kind} of {owner} is named by a text; got {name!r}", name=repr(name), value=name)
    close = difflib.get_close_matches(name, known, n=2, cutoff=0.6)
    if not close:  # the same name in other letters: 'Panda' for 'panda'
        close = [other for other in known if other.lower() == name.lower()]
    if close:
        way_out = f"did you mean {' or '.join(repr(other) for other in close)}?"
    elif known:
        way_out = f"it has {quoted_list(known, most=30)}"
    else:
        way_out = "it has none"
    tail = f" ({hint})" if hint else ""
    return UnknownNameError(
        f"{owner} has no {kind} {name!r}; {way_out}{tail}", name=name, value=name, rule=f"a {kind}"
    )


def missing_extra(what: str, package: str, extra: str) -> MissingExtraError:
    """The error for an optional package that is not installed, with the command that installs it."""
    return MissingExtraError(
        f"{what} needs the package '{package}', which is not installed; pip install -e \".[{extra}]\" installs it",
        name=package,
    )


def one_thread_at_a_time() -> UsageError:
    """The error for a tick that begins while another thread is in the middle of one."""
    return UsageError(
        "a controller is stepped by one thread at a time, and another thread is in the middle of a tick; compile one "
        "for each thread: taut.compile(ctrl.law, ctrl.arm, rate=ctrl.rate)",
        name="step",
    )


_PACKAGE_ROOT = Path(__file__).parents[1]  # as the loader spells it, like the file names in frames
_CONTROL = _PACKAGE_ROOT / "control"


def user_location() -> str:
    """File and line of the innermost frame of the caller's own code, else of a law of ours."""
    return _place(traceback.walk_stack(sys._getframe(1)))


def raised_location(error: BaseException) -> str:
    """The same for an error that was caught: the innermost frame that it came through, else one that called us."""
    through = reversed(list(traceback.walk_tb(error.__traceback__)))
    return _place([*through, *traceback.walk_stack(sys._getframe(1))])


def warn(text: str, kind: type[RuntimeWarning] = RuntimeWarning) -> None:
    """A warning at the line of the caller's own code, however deep in ours it arises."""
    level, frame = 2, sys._getframe(1)
    while frame.f_back is not None and _is_ours_or_generated(Path(frame.f_code.co_filename), frame.f_code.co_name):
        level, frame = level + 1, frame.f_back
    warnings.warn(text, kind, stacklevel=level)


def _place(frames: Iterable[tuple[FrameType, int]]) -> str:
    """The first of some frames, innermost first, that is no library's."""
    files = [(Path(frame.f_code.co_filename), frame.f_code.co_name, line) for frame, line in frames]
    foreign = [(file, line) for file, code, line in files if not _is_ours_or_generated(file, code)]
    installed = _installed()
    for file, line in foreign:
        if not any(folder in file.parents for folder in installed):
            return f"{file}:{line}"
    for file, line in foreign:  # a law that is installed itself
        return f"{file}:{line}"
    ours = [f"{file.name}:{line}" for file, _, line in files if _CONTROL in file.parents]
    return ours[0] if ours else "an unknown line"


def _is_ours_or_generated(file: Path, code: str) -> bool:
    """Our own files, NumPy's, and code without a file that libraries make (dataclasses, import)."""
    generated = file.name.startswith("<frozen") or (file.name == "<string>" and code.startswith("__"))
    return generated or _PACKAGE_ROOT in file.parents or "numpy" in file.parts


@functools.cache
def _installed() -> tuple[Path, ...]:
    """Where Python keeps its own modules and installed packages."""
    return tuple({Path(sysconfig.get_path(name)) for name in ("stdlib", "platstdlib", "purelib", "platlib")})


def printable(text: str, *, lines: bool = False) -> str:
    r"""A text in which control, bidirectional and other invisible characters are written out as escapes.

    A terminal obeys the first and shows what the second hide in another order; a lone surrogate cannot be written.

    Example:
        >>> print(printable("a\x1b]0;b\u202e"))
        a\x1b]0;b\u202e
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or (lines and c in "\n\t") else repr(c)[1:-1] for c in text)
