"""Reading a TOML file key by key, with sentences that name file, section, key and way out."""

from __future__ import annotations

import contextlib
import difflib
import math
import os
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from taut.base.checks import readable_file
from taut.base.errors import FileError, ScenarioError, TautError, quoted_list

__all__ = ["REQUIRED", "Section", "file_beside", "read_toml", "section_of"]

REQUIRED: Final = object()
EMPTY: Final[Mapping[str, str]] = {}
MOST_BYTES: Final = 500_000
DEEPEST: Final = 16  # tables within tables; a scenario has five
LONGEST: Final = 100  # letters of a value in a message
TEXT_OR_COMMENT: Final = re.compile(
    r'"""(?:\\.|[^\\])*?"""|\'\'\'.*?\'\'\'|"(?:\\.|[^"\\\n])*"|\'[^\'\n]*\'|#[^\n]*', re.DOTALL
)
DOTTED: Final = re.compile(rf"(?<![^\s.,=\[\]{{}}])(?:[^\s.,=\[\]{{}}]+[ \t]*+\.[ \t]*+){{{DEEPEST}}}")
WORDS: Final = {
    "friction=None": 'friction = "none"',
    "actuation=taut.drives.Actuation(bandwidth=50.0)  # rad/s": "actuation = { bandwidth = 50.0 } [rad/s]",
    "give taut.Limits(tau=...)": "write limits = { tau = [...] }",
    "give taut.Limits(v=...)": "write limits = { v = [...] }",
    "Limits needs one of tau=, tau_dot=, v= and blend= at least": "needs one of tau, tau_dot, v and blend at least",
    "give v= too": "give v too",
    "leave it out, or give taut.Limits(v=...)": "leave it out, or write limits = { v = [...] }",
    "for no limits leave limits=None": 'for no limits write limits = "none"',
    "sensing=taut.Sensing(velocity='difference')": 'velocity = "difference" in [control]',
    "velocity='difference'": 'velocity = "difference"',
    "give the plant environment= or contact=, or take a taut.MujocoPlant": (
        'kind = "mujoco" or [plant.environment] measures it'
    ),
    "sensors=taut.sensors.Sensors(torque=taut.sensors.TorqueSensor())": "[plant.sensors.torque]",
    "sensors=taut.sensors.Sensors(wrench=taut.sensors.WrenchSensor())": "[plant.sensors.wrench]",
    "sensors=taut.sensors.Sensors(motor=taut.sensors.Encoder())": "[plant.sensors.motor]",
    "sensors=taut.sensors.Sensors(motor_velocity=taut.sensors.Tachometer())": "[plant.sensors.motor_velocity]",
    "sensors=taut.sensors.Sensors(tip=taut.sensors.Accelerometer())": "[plant.sensors.tip]",
    "give environment= or tool= too, or leave it out": "write [plant.environment] too, give it a tool, or leave it "
    "out",
    "give it sensors=taut.sensors.Sensors(wrench=taut.sensors.WrenchSensor(tool=taut.Payload(mass=...))), or "
    "leave mass out of "
    "taut.sensors.Wrist": "give it [plant.sensors.wrench.tool], or leave mass out of [control.wrist]",
    "give mass= too": "give mass too",
    "a plant with takes='": "a plant that takes '",
    "Motor needs peak=, or stall= and no_load=, or all three": "needs peak, or stall and no_load, or all three",
    "a motor's curve needs both stall= [N m] and no_load= [rad/s]": "needs both stall [N m] and no_load [rad/s]",
    "TorqueLoop needs kp= or ki= above zero": "needs kp or ki above zero",
    "taut.drives.Transmission(stiffness=1e4, ...)  # N m/rad": "stiffness = 1e4 [N m/rad]",
    "arm.with_gears(ratio=, motor_inertia=), or with_joints(rotor_inertia=)": "give it gears or rotor_inertia",
    "give the plant substeps=": "give the plant substeps = ",
    "give the plant timestep=": "give the plant timestep = ",
}
"""Ways out that are written for Python, as they are written in a scenario."""


def read_toml(path: Path, label: str = "") -> Section:
    """The root section of a file.

    Args:
        path: The file.
        label: What messages call it; its path if left out.

    Raises:
        FileError: It cannot be read.
        ScenarioError: It is no TOML, or none that a scenario could be.
    """
    file = readable_file("scenario", path)
    if file.stat().st_size > MOST_BYTES:
        raise ScenarioError(f"scenario '{file}' is larger than {MOST_BYTES} bytes; a scenario is a page of text")
    try:
        text = file.read_text(encoding="utf-8-sig")  # editors on Windows begin a file with a mark
    except UnicodeDecodeError as cause:
        raise ScenarioError(f"scenario '{file}' is no UTF-8 text ({cause.reason} at byte {cause.start})") from cause
    return section_of(text, label or str(file), f"scenario '{file}'")


def section_of(text: str, label: str, what: str) -> Section:
    """The root section of a text.

    Args:
        text: The text.
        label: What messages about its keys call it.
        what: What a message calls it that it is no TOML.

    Raises:
        ScenarioError: It is no TOML, or none that a scenario could be.
    """
    dotted = DOTTED.search(TEXT_OR_COMMENT.sub(lambda found: "" if found[0][0] == "#" else "_", text))
    if dotted is not None:  # the parser's time grows with the third power of such a key's length
        raise Section(label, "", {}).error(
            f"has at '{dotted[0].rstrip('. ')[:LONGEST]}' more than {DEEPEST} tables in each other; no key takes that"
        )
    try:
        table = tomllib.loads(text)
    except (ValueError, RecursionError) as cause:  # TOML that is wrong, a number with thousands of digits
        raise ScenarioError(f"{what} is no valid TOML: {cause}") from cause
    root = Section(label, "", table)
    _refuse_monsters(root, table)
    return root


def _refuse_monsters(root: Section, table: Mapping[str, Any]) -> None:
    """What no scenario has, and what would not fit into any message."""
    waiting: list[tuple[tuple[str, ...], Any]] = [((), table)]
    while waiting:
        path, value = waiting.pop()
        place = f"has at '{'.'.join(path)[:LONGEST]}'"
        if isinstance(value, (dict, list)):
            if len(path) == DEEPEST:
                raise root.error(f"{place} more than {DEEPEST} tables or arrays in each other; no key takes that")
            inside = value.items() if isinstance(value, dict) else enumerate(value)
            waiting += [((*path, str(key)), each) for key, each in inside]
            hidden = next((key for key in value if isinstance(key, str) and not key.isprintable()), "")
            if hidden:
                raise root.error(f"{place} the key '{hidden[:LONGEST]}' with an invisible character; delete it")
        elif isinstance(value, str) and not value.replace("\n", "").replace("\t", "").isprintable():
            raise root.error(f"{place} a text with an invisible character: {_shown(value)}; delete it")
        elif isinstance(value, int) and not -(2**63) <= value < 2**63:
            raise root.error(f"{place} a whole number beyond the 64 bits of TOML; write it as 1e20")


def file_beside(kind: str, name: str, folder: Path) -> Path:
    """A file that a scenario names: a path from the scenario's own folder, or an absolute one.

    Raises:
        FileError: It cannot be read; the message says where it was looked for.
    """
    place = folder.resolve() / name
    try:
        return readable_file(kind, place)
    except FileError as cause:
        if Path(name).is_absolute() or os.path.exists(place):  # noqa: PTH110  (long names)
            raise
        raise FileError(f"{cause} (paths begin at the scenario's own folder)", name=cause.name) from cause


class Section:
    """One table of a file. Keys are taken one by one; what is left at the end is refused."""

    def __init__(self, file: str, name: str, table: Mapping[str, Any]) -> None:
        self._file = file
        self._name = name
        self._table = dict(table)
        self._known: list[str] = []

    def copy(self) -> Section:
        """The same table, of which keys are taken anew."""
        return Section(self._file, self._name, self._table)

    @property
    def where(self) -> str:
        """File and section, as messages begin with."""
        return f"{self._file}: [{self._name}]" if self._name else self._file

    def error(self, text: str) -> ScenarioError:
        """An error about this section."""
        return ScenarioError(f"{self.where} {text}")

    @contextlib.contextmanager
    def blamed(self, key: str | None = None) -> Iterator[None]:
        """Errors of what is made from this section name it, and the key that they are about.

        Args:
            key: The key to name where an error does not say itself which argument it is about.
        """
        try:
            yield
        except ScenarioError:
            raise
        except TautError as cause:
            raise self.error(self._with_key(cause, key)) from cause
        except OverflowError as cause:  # of a period, a delay, a time that no float holds
            raise self.error(f"{key or 'a number'} is too large: {cause}") from cause

    def _with_key(self, cause: TautError, key: str | None) -> str:
        """The text of an error, which calls a key as this section does: q, not ref.q."""
        text, name = str(cause), cause.name or ""
        for words, in_toml in WORDS.items():
            text = text.replace(words, in_toml)
        first, last = name.partition(".")[0], name.rpartition(".")[2]
        if first in self._known:
            return text if re.search(rf"(?<!\w){re.escape(first)}(?!\w)", text) else f"{first}: {text}"
        if last in self._known:
            return text.replace(name, last, 1)
        return text if key is None or re.match(rf"{re.escape(key)}(?!\w)", text) else f"{key}: {text}"

    def replaced(self, changes: Section, label: str) -> Section:
        """This table with some of its keys replaced: tables merge, anything else takes the place of what was there.

        Args:
            changes: The keys with their new values.
            label: What messages call the file then.
        """
        return Section(label, self._name, _merged(self._table, changes._table))

    # ---------------------------------------------------------------- values

    def __contains__(self, key: str) -> bool:
        return key in self._table

    def take(self, key: str, default: Any = REQUIRED, *, what: str | None = None) -> Any:
        """The value of a key, whatever it is; `what` is what a message calls it."""
        self._known.append(key)
        if key in self._table:
            return self._table.pop(key)
        if default is REQUIRED:
            close = difflib.get_close_matches(key, self._table, n=1)
            wanted = what or f"the key '{key}'"
            raise self.error(f"needs {wanted}" + (f"; is '{close[0]}' meant for it?" if close else ""))
        return default

    def peek(self, key: str) -> Any:
        """The value of a key, which stays; None if it is not there."""
        return self._table.get(key)

    def fields(self, names: Sequence[str], required: Sequence[str] = ()) -> dict[str, Any]:
        """The values of all keys that are there, which are the fields of something and nothing else."""
        self.only(*names)
        return {name: self.take(name) for name in names if name in self or name in required}

    def _typed(self, key: str, default: Any, kinds: tuple[type, ...], rule: str) -> Any:
        value = self.take(key, default)
        if value is default:
            return value
        if not isinstance(value, kinds) or (isinstance(value, bool) and bool not in kinds):
            raise self.error(f"{key} must be {rule}; got {_shown(value)}")
        return value

    def number(self, key: str, default: Any = REQUIRED) -> Any:
        """A finite number."""
        value = self._typed(key, default, (int, float), "a number")
        if value is not default and not math.isfinite(value):
            raise self.error(f"{key} must be finite; got {value!r}")
        return value

    def whole(self, key: str, default: Any = REQUIRED) -> Any:
        """A whole number."""
        return self._typed(key, default, (int,), "a whole number")

    def text(self, key: str, default: Any = REQUIRED) -> Any:
        """A text."""
        return self._typed(key, default, (str,), "a text in quotes")

    def texts(self, key: str, default: Any = REQUIRED, *, example: str) -> Any:
        """An array of texts, such as the example."""
        rule = f"an array of texts such as {example}"
        value = self._typed(key, default, (list,), rule)
        if value is not default and not all(isinstance(item, str) for item in value):
            raise self.error(f"{key} must be {rule}; got {_shown(value)}")
        return value

    def flag(self, key: str, default: Any = REQUIRED) -> Any:
        """True or false."""
        return self._typed(key, default, (bool,), "true or false")

    def numbers(self, key: str, default: Any = REQUIRED) -> Any:
        """A number, or arrays of numbers."""
        return self._typed(key, default, (int, float, list), "a number or an array of numbers")

    def word(self, key: str, options: Sequence[str], default: Any = REQUIRED) -> Any:
        """One of a few words."""
        value = self.take(key, default)
        if value is not default and value not in options:
            raise self.error(f"{key} must be one of {quoted_list(options)}; got {_shown(value)}")
        return value

    def section(self, key: str, *, required: bool = False) -> Section:
        """A table below this one; empty where it is not there."""
        if required and key not in self:
            self.take(key, what=f"the section [{self.below(key)}]")
        value = self._typed(key, {}, (dict,), f"a table: [{self.below(key)}]")
        return Section(self._file, self.below(key), value)

    def sections(self, key: str) -> list[Section]:
        """An array of tables: [[key]]."""
        value = self._typed(key, [], (list,), f"an array of tables: [[{self.below(key)}]]")
        if not all(isinstance(item, dict) for item in value):
            raise self.error(f"{key} must be an array of tables: [[{self.below(key)}]]; got {_shown(value)}")
        return [Section(self._file, f"{self.below(key)} {i + 1}", item) for i, item in enumerate(value)]

    def below(self, key: str) -> str:
        """The whole name of a table below this one."""
        return f"{self._name}.{key}" if self._name else key

    @property
    def above(self) -> str:
        """The whole name of the table that this one is in."""
        return self._name.rpartition(".")[0]

    @property
    def left(self) -> list[str]:
        """The keys that were not taken yet, in the order of the file."""
        return list(self._table)

    def only(self, *keys: str, elsewhere: Mapping[str, str] = EMPTY) -> None:
        """Nothing but these keys may be there, and what was taken already.

        Args:
            keys: The keys.
            elsewhere: What to say of keys that have their place where this section is of another kind.

        Raises:
            ScenarioError: There is another key.
        """
        self._known += keys
        for key in self._table:
            if key in self._known:
                continue
            close = [] if key in elsewhere else difflib.get_close_matches(key, self._known, n=1)
            known = sorted(set(self._known))  # all of them: a list that is cut sends the reader to the manual
            way_out = f"did you mean '{close[0]}'?" if close else f"it takes {quoted_list(known, most=len(known))}"
            raise self.error(f"has no key '{key}'{elsewhere.get(key, '')}; {way_out}")

    def done(self) -> None:
        """Nothing may be left.

        Raises:
            ScenarioError: There is a key that nobody asked for.
        """
        self.only()


def _merged(old: Mapping[str, Any], new: Mapping[str, Any]) -> dict[str, Any]:
    out = dict(old)
    for key, value in new.items():
        before = old.get(key)
        out[key] = _merged(before, value) if isinstance(before, dict) and isinstance(value, dict) else value
    return out


def _shown(value: object) -> str:
    """A value in a message: a long one is cut."""
    text = repr(value)
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 3]}..."
