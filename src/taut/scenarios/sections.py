"""Sections of a scenario: [arm] and [plant], [laws.LABEL] and [control], [spread]; laws as text, "PID(kp=100)"."""

from __future__ import annotations

import ast
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np

from taut import drives, sensors
from taut import laws as all_laws
from taut.arm.builtin import BUILT_IN, one_joint_tree
from taut.arm.catalogue import CATALOGUE
from taut.arm.change import joints_replaced
from taut.arm.description import Arm
from taut.arm.friction import Friction
from taut.arm.load import load_arm, open_model
from taut.base.checks import rate_in_hertz
from taut.base.errors import ScenarioError, TautError, UsageError, unknown_name
from taut.base.fields import Declared, Field, Part, Whole
from taut.base.plot_style import short
from taut.base.types import Float64Array
from taut.control.combine import SideBySide, Wrapper, law_classes
from taut.control.law import Law
from taut.control.laws.task_error import Coordinates
from taut.control.limits import Limits
from taut.control.observer import MomentumObserver
from taut.control.sensing import Difference, Kalman, LowPass, Sensing
from taut.drives import ElectricMotor, FlexibleLink, Motor, MotorModel, VariableStiffnessActuator
from taut.environments import (
    Damper,
    Environment,
    Environments,
    Hand,
    Push,
    Spring,
    StiffWall,
)
from taut.maths.constraints.constraint import Constraint
from taut.maths.model import Adds
from taut.maths.spatial import rotation_exp
from taut.plant.rigid import RigidPlant
from taut.runtime.host import PlantBase
from taut.scenarios.reading import Table, arguments, of_kind, read, reads
from taut.trace.pose import Pose

CONSTRAINTS: Final = ("plane", "point", "sphere", "cylinder", "line", "hinge", "grasp", "pin", "knife_edge")
VELOCITY_SOURCES: Final[Mapping[str, Any]] = {"low-pass": LowPass, "difference": Difference, "kalman": Kalman}
MAX_RATE: Final = 1e6  # [Hz] of any controller that there is


@reads(Law)
def _inner(table: Table, key: str) -> Law:
    return read_law(table.table(key, required=True))


def read_law(table: Table, designed: Sequence[str] = ()) -> Law:
    """law = "PID" with its gains, or law = ["FeedForward", "PID"] with a table of gains for each.

    `designed` are names that are read elsewhere, for a message.
    """
    table.need("law")
    if not isinstance(table.get("law"), list):
        return _one_law(table.without("law"), table, table.text("law"), designed)
    names = table.texts("law", example='["FeedForward", "PID"]') or []
    if len(names) != len(set(names)) or not names:
        raise table.error(f"must name one law at least, each once; got {names}", "law")
    table.only(("law", *names))
    laws = [_one_law(table.table(name), table, name) for name in names]
    with table.blamed("law"):
        return sum(laws[1:], start=laws[0])


def _one_law(gains: Table, table: Table, name: str, designed: Sequence[str] = ()) -> Law:
    if name == "SideBySide":
        return _side_by_side(gains)
    known = {word: kind for word, kind in law_classes(all_laws).items() if word != "Sum"}
    with table.blamed("law"):
        if name not in known:
            raise unknown_name("taut.laws", "law", name, [*known, *designed])
    if issubclass(known[name], Wrapper) and "law" not in gains:
        raise table.error(f"'{name}' is around another one: write wrapped_by = {{ law = '{name}' }} there", "law")
    law: Law = read(known[name], gains, others=["wrapped_by"])
    wrappers = {word: kind for word, kind in known.items() if issubclass(kind, Wrapper)}
    while "wrapped_by" in gains:
        gains = gains.table("wrapped_by")
        gains.need("law")
        wrapper = gains.choice("law", wrappers)
        try:
            law = read(wrappers[wrapper], gains, others=["law", "wrapped_by"], law=law)
        except ScenarioError as cause:
            text = str(cause).replace("] law must ", f"] the law that '{wrapper}' wraps must ")
            raise ScenarioError(text, name=cause.name) from cause
    return law


def _side_by_side(table: Table) -> Law:
    """A table for each law, with the names of its joints where it does not state them by its tool."""
    parts: dict[str, Any] = {}
    for part in table.values:
        below = table.table(part)
        joints, law = below.texts("joints", example='["head_pan"]'), read_law(below.without("joints"))
        parts[part] = law if joints is None else (law, joints)
    with table.blamed():
        return SideBySide(**parts)


@reads(Constraint)
def read_constraint(table: Table, key: str = "constraint") -> Constraint:
    """{ kind = "plane", point = [0.5, 0.0, 0.3], normal = [0, 0, 1] }, or an array of tables, which hold together."""
    table.need(key)
    tables = table.tables(key) if isinstance(table.get(key), list) else [table.table(key)]
    if not tables:
        raise table.error("must be a table, or an array of one at least; got []", key)
    kinds = {kind: getattr(Constraint, kind) for kind in CONSTRAINTS}
    constraints: list[Constraint] = [of_kind(kinds, each, blame="kind") for each in tables]
    return sum(constraints[1:], start=constraints[0])


def read_control(table: Table, arm: Arm) -> tuple[float, Sensing, Limits | None]:
    """Rate [Hz], sensing and limits."""
    with table.blamed():
        rate = rate_in_hertz(table.get("rate", 1000.0))
    if rate > MAX_RATE:
        raise table.error(f"must be <= {MAX_RATE:g} [Hz]; got {rate:g}", "rate")
    made: dict[str, Any] = {}
    if isinstance(table.get("velocity"), dict):
        made["velocity"] = of_kind(VELOCITY_SOURCES, table.table("velocity"))
    if "observer" in table:
        made["observer"] = read(MomentumObserver, table.table("observer"))
    sensing: Sensing = read(Sensing, table, others=["rate", "limits", "velocity", "observer"], **made)
    with table.blamed():
        sensing.check_fit(arm, rate)
    return rate, sensing, _limits(table, arm, rate)


def _limits(table: Table, arm: Arm, rate: float) -> Limits | None:
    """limits = "arm", or a table: with of = "arm" of the arguments of Limits.of, else of the fields of Limits."""
    if not isinstance(table.get("limits"), dict):
        if table.choice("limits", ("none", "arm"), "none") == "none":
            return None
        with table.blamed("limits"):
            return Limits.of(arm)
    below = table.table("limits")
    below.choice("of", ("arm",))
    limits: Limits = read(Limits.of, below, others=["of"], arm=arm) if "of" in below else read(Limits, below)
    with below.blamed():
        limits.check_fit(arm, rate)
    return limits


EXAMPLE: Final = "PID(kp=100, kd=20)"
MAX_TEXT: Final = 50_000  # letters: three gains of 30 joints as matrices
MAX_SHOWN: Final = 80  # of them in a message


def law_of_text(text: str) -> tuple[str, Law]:
    """A law and its name: the text, or what stands before it, "stiff: PID(kp=900)". Raises UsageError, ScenarioError.

    It is written as in Python: ViaMit(law=PID(kp=[100, 80])), SideBySide(left=..., right=...), and + for a sum. What
    is a table in a scenario may be a dictionary.
    """
    label, colon, rest = text.partition(":")
    named = bool(colon) and "(" not in label
    name, words = (label.strip(), rest) if named else (" ".join(text.split()), text)
    return name, of_text(words, name, Law)


def of_text(text: str, name: str, kind: type = Declared) -> Any:
    """A law, or the sensing or limits of a record, of that name from its text. Raises UsageError, ScenarioError."""
    place = Table(f"law '{short(name, MAX_SHOWN)}':", "", {})
    try:
        if not name or not name.isprintable() or len(text) > MAX_TEXT:
            raise ValueError(text)
        with place.blamed():
            made = _written(ast.parse(text.strip(), mode="eval").body, place)
        if not isinstance(made, kind):
            raise TypeError(text)
    except TautError:
        raise
    except (ValueError, TypeError, LookupError, SyntaxError, RecursionError, MemoryError) as cause:
        raise UsageError(
            f"a law is written as {EXAMPLE}, each gain by its name, or with a name before it, stiff: {EXAMPLE}; got "
            f"{short(text, MAX_SHOWN)!r}",
            name="laws",
            value=text,
        ) from cause
    return made


@cache
def _kinds() -> Mapping[str, Any]:
    """What a text makes, by its name there: laws, and the parts of laws, of sensing and of limits."""
    public = {name: getattr(door, name) for door in (all_laws, sensors, drives) for name in door.__all__}
    public |= {"Sensing": Sensing, "Limits": Limits}
    public |= dict.fromkeys(("Sum", "Wrapper"))  # a sum is written as one, and no law is a wrapper alone
    declared = {name: each for name, each in public.items() if isinstance(each, type) and issubclass(each, Declared)}
    ready = {Constraint: CONSTRAINTS, Coordinates: ("position", "position_and_rpy")}
    methods = {f"{kind.__name__}.{name}": getattr(kind, name) for kind, names in ready.items() for name in names}
    return {**declared, **methods, "Pose.of": lambda R, p: Pose.of(np.array(R), np.array(p))}


def _written(node: ast.expr, place: Table) -> Any:
    """The object or value that a text describes. Raises TautError, or ValueError, TypeError, LookupError."""
    match node:
        case ast.Name(id=word) if word.lower() in ("nan", "inf"):  # numbers: the law says which gain must be finite
            return float(word)
        case ast.Name():
            return _written(ast.Call(node, [], []), place)
        case ast.Call(func=func, args=[], keywords=given) if all(each.arg for each in given):
            name, kinds = ast.unparse(func), _kinds()
            if not name[:1].isupper():  # nothing that a text makes has such a name
                raise ValueError(name)
            if name not in kinds:
                raise unknown_name("taut.laws", "law", name, kinds)
            values = {str(each.arg): _written(each.value, place) for each in given}
            return SideBySide(**values) if name == "SideBySide" else read(kinds[name], place.at("", values))
        case ast.BinOp(op=ast.Add(), left=left, right=right):
            return _written(left, place) + _written(right, place)
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return -_written(operand, place)
        case ast.List(elts=items) | ast.Tuple(elts=items):
            made = [_written(item, place) for item in items]
            return made if isinstance(node, ast.List) else tuple(made)
        case ast.Dict(keys=keys, values=parts):
            return {ast.literal_eval(k or ""): _written(x, place) for k, x in zip(keys, parts, strict=True)}
    return ast.literal_eval(node)


Plant: TypeAlias = RigidPlant | FlexibleLink | PlantBase
CHANGES: Final = ("bodies", "friction", "gears", "perturbed", "joint_values", "payload")


def read_arm(table: Table) -> Arm:
    """The controllers' model of the arm, from [arm]."""
    table.need("model")
    model, link = table.text("model"), table.table("link")
    if not link.values:
        with table.blamed("model"):
            tree = open_model(_model(table))
    elif model == "one_joint":
        tree = read(one_joint_tree, link)
    else:
        raise table.error(f"is for the model 'one_joint'; got model '{model}'", "link")
    others = ("model", "link", "joints", "tool_offset", *CHANGES)
    arm: Arm = read(load_arm, table, others=others, blame="model", model=tree)
    if "joints" in table:
        with table.blamed("joints"):
            arm = arm.subset(table.texts("joints", example='["joint1"]') or ())
    if friction_word(table, "none") == "none":
        arm = arm.with_friction(Friction())
    if "tool_offset" in table:
        offset = read(Pose, table.table("tool_offset"))
        with table.blamed("tool_offset"):
            arm = arm.with_tool(arm.tool, offset)
    return _changed(table, arm)


def read_true_arm(table: Table, assumed: Arm) -> Arm:
    """The plant's arm: the assumed one, or another model, with the changes that [plant] states."""
    if "model" not in table:
        return _changed(table, assumed)
    with table.blamed("model"):
        arm = load_arm(_model(table))
    return _changed(table, arm)


def _model(table: Table) -> str:
    """A name that taut knows, else the path of a file."""
    name = table.text("model")
    path = Path(name)
    there = os.path.exists(table.folder / path)  # noqa: PTH110  (long names)
    is_file = (
        name and name not in BUILT_IN and name not in CATALOGUE and (path.suffix or len(path.parts) > 1 or there)
    )
    return str(table.file_of("model", "model")) if is_file else name


def friction_word(table: Table, *words: str) -> str | None:
    """The word that `friction` is, if it is no table."""
    return None if isinstance(table.get("friction"), dict) else table.choice("friction", words)


def _changed(table: Table, arm: Arm) -> Arm:
    bodies = table.table("bodies")
    for joint in bodies.values:
        arm = read(arm.with_body, bodies.table(joint), joint=joint)
    if isinstance(table.get("friction"), dict):
        below = table.table("friction")
        for key, value in below.values.items():
            if isinstance(value, dict):
                raise below.error("must be one number or one per joint; by joint name it stands in joint_values", key)
        friction = read(Friction, below)
        with below.blamed():
            arm = arm.with_friction(friction)
    if "gears" in table:
        arm = read(arm.with_gears, table.table("gears"))
    if "perturbed" in table:
        arm = read(arm.perturbed, table.table("perturbed"))
    values = table.table("joint_values")
    with values.blamed():
        arm = joints_replaced(arm, values.values)
    return read(arm.with_payload, table.table("payload")) if "payload" in table else arm


ENVIRONMENTS: Final[Mapping[str, Callable[..., Any]]] = {
    "spring": Spring,
    "damper": Damper,
    "wall": StiffWall,
    "hand": Hand,
    "push": Push,
}


@reads(Environment)
def _environment(table: Table, key: str) -> Environment:
    """One by its kind; without a kind, a table for each of several that act together."""
    below = table.table(key)
    if "kind" in below or not all(isinstance(each, dict) for each in below.values.values()) or not below.values:
        return of_kind(ENVIRONMENTS, below)  # type: ignore[no-any-return]
    parts = {name: of_kind(ENVIRONMENTS, below.table(name)) for name in below.values}
    with below.blamed():
        return Environments(**parts)


@reads(MotorModel)
def _motor(table: Table, key: str) -> Any:
    """A motor with electrical numbers is an electric motor, one with springs a variable-stiffness actuator."""
    below = table.table(key)
    if "springs" in below:
        return read(VariableStiffnessActuator, below)
    return read(Motor if below.values.keys() <= arguments(Motor).keys() else ElectricMotor, below)


def read_plant(table: Table, assumed: Arm, rate: float) -> Plant:
    """A flexible link, or a rigid plant or one in MuJoCo, whose true arm is made from the assumed one."""
    make: Callable[..., Plant] = RigidPlant
    kind = table.choice("kind", ("rigid", "mujoco", "flexible-link"), "rigid")
    if kind == "flexible-link":
        link: FlexibleLink = read(FlexibleLink, table, others=["kind"])
        _require_start(link, table, rate)
        return link
    if kind == "mujoco":
        from taut.runtime.robots.mujoco.plant import MujocoPlant

        make = MujocoPlant
    arm = read_true_arm(table, assumed)
    if arm.n != assumed.n:
        raise table.error(
            f"must have as many joints as that of [arm], the {assumed.n} of '{assumed.name}'; got the {arm.n} of "
            f"'{arm.name}'",
            "model",
        )
    made: dict[str, Any] = {"friction": None if friction_word(table, "arm", "none") == "none" else "arm"}
    if "adds" in table:
        with table.blamed("adds"):
            made["adds"] = Adds.of(table.texts("adds", example='["gravity"]') or ())
    if "scene" in table and "scene" in arguments(make):
        made["scene"] = table.file_of("scene", "scene")
    others, blame = ["kind", "model", *CHANGES, *made], "scene" if "scene" in made else ""
    plant: Plant = read(make, table, others=others, blame=blame, arm=arm, **made)
    _require_start(plant, table, rate)
    return plant


def _require_start(plant: Plant, table: Table, rate: float) -> None:
    """A delay of whole periods, and steps that are short enough for a spring."""
    rest, dt = np.zeros(plant.arm.n), 1.0 / rate
    if isinstance(plant, PlantBase):
        with table.blamed("timestep"):
            plant.reset(plant.arm.home, rest, dt, seed=0)
        return
    if isinstance(plant, RigidPlant):
        with table.blamed("actuation"):
            plant.actuation.taps(dt)
    with table.blamed():
        plant.start(plant.arm.home, rest, plant.parameters, dt)


MAX_TILT: Final = 0.5 * np.pi  # [rad]


class Spread(Declared):
    """[spread]: random displacement of the scene from where [plant] has it, in each of several runs.

    Shift and tilt are uniform over a disc across the world's z axis: the shift along a vector in it, the tilt about
    one, at the origin of the scene. The place of a run depends on the seed and its number alone.
    """

    at: Part[Pose] = Part(Pose)  # where the scene stands in the file
    runs: Whole = Whole(minimum=2, maximum=1000)  # how many
    seed: Whole = Whole(0)
    shift: Field = Field(0.0, unit="m", minimum=0.0)  # the largest, in any direction across z
    tilt: Field = Field(0.0, unit="rad", minimum=0.0, maximum=MAX_TILT)  # the largest, about any axis across z

    def check(self) -> None:
        if not self.shift and not self.tilt:
            self.refuse("", "needs shift [m], tilt [rad] or both above zero")

    def place(self, run: int) -> Pose:
        """Where the scene stands in a run."""
        rng = np.random.default_rng([self.seed, run])
        shift, tilt = self.shift * _on_disc(rng), self.tilt * _on_disc(rng)
        return Pose(self.at.p + shift, R=np.asarray(rotation_exp(tilt)) @ self.at.R)

    def plants(self, plant: Table) -> Iterator[tuple[str, Table]]:
        """Each run's name, and its section [plant]."""
        for run in range(1, self.runs + 1):
            place, name = self.place(run), f"run {run}"
            here = {"scene_at": {"p": place.p.tolist(), "R": place.R.tolist()}}
            yield name, Table(f"{plant.file}: {name}", "plant", {**plant.values, **here}, plant.folder)


def _on_disc(rng: np.random.Generator) -> Float64Array:
    """(3,) a point of the unit disc across z, each as likely as any other."""
    radius, angle = np.sqrt(rng.random()), 2.0 * np.pi * rng.random()
    return np.array([radius * np.cos(angle), radius * np.sin(angle), 0.0])


def read_spread(root: Table) -> Spread | None:
    """The spread of a scenario; None if it has none. Raises ScenarioError."""
    if "spread" not in root:
        return None
    table, plant = root.table("spread"), root.table("plant")
    if "cases" in root:
        raise table.error("does not go with [cases]; put them in scenarios of their own")
    if plant.get("kind") != "mujoco" or "scene" not in plant:
        raise table.error('moves the scene; give [plant] kind = "mujoco" and scene')
    return read(Spread, table, at=read(Pose, plant.table("scene_at")))  # type: ignore[no-any-return]
