"""Changed copies of an Arm: joints locked, bodies or joint values replaced, a modelling error drawn."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from taut.arm.friction import AT_REST, FRICTION_FIELDS
from taut.arm.gears import doubt_rotors, reflected_inertia, rotor_doubts
from taut.arm.loaders.tree import LinkInertia, Tree, TreeJoint, TreeLink, TreeVisual, assemble, require_within_limits
from taut.arm.parts import BASE, Body
from taut.arm.rules import check_inertia, value_problems
from taut.base.checks import (
    entry_names,
    finite_array,
    finite_scalar,
    require_range,
    vector,
    whole_number,
)
from taut.base.errors import ModelError, Problem, RangeError, ShapeError, UsageError, quoted_list, unknown_name
from taut.base.types import ArrayLike, Float64Array

if TYPE_CHECKING:
    from taut.arm.description import Arm

__all__ = ["body_replaced", "geared", "home_replaced", "joints_replaced", "locked_copy", "perturbed_copy"]

ROOT = "<base>"
LIMITS: Final = ("lower", "upper", "velocity", "effort")  # which may be infinite
JOINT_FIELDS: Final = (*LIMITS, *FRICTION_FIELDS, "gear", "rotor_inertia")
POSITIVE: Final = ("velocity", "effort", "stribeck_shape", "gear")


def locked_copy(arm: Arm, joints: Iterable[str], q: ArrayLike | None) -> Arm:
    """The arm with only `joints` moving, the others held at q."""
    keep = [joints] if isinstance(joints, str) else list(joints)
    for name in keep:
        arm.joint_index(name)
    if not keep:
        raise UsageError("a subset needs one joint at least; got none", name="joints")
    if len(set(keep)) != len(keep):
        raise UsageError(f"a subset names each joint once; got {keep}", name="joints")
    at = arm.home if q is None else vector("q", q, arm.n, joints=arm.joint_names)
    for i, joint in enumerate(arm.joints):
        require_within_limits(entry_names("home" if q is None else "q", [i], arm.joint_names), float(at[i]), joint)
    locked = {name: float(at[i]) for i, name in enumerate(arm.joint_names) if name not in keep}
    home = {name: float(at[i]) for i, name in enumerate(arm.joint_names)}
    made = assemble(
        type(arm),
        _tree_of(arm),
        locked=locked,
        tool=arm.tool,
        T_WB=arm.T_WB,
        gravity=arm.gravity,
        home=home,
        commands=arm.commands,
    )
    links = {_link_name(joint): body.links for joint, body in zip(arm.joint_names, arm.bodies, strict=True)}
    bodies = tuple(
        dataclasses.replace(body, links=tuple(name for made_of in body.links for name in links[made_of]))
        for body in made.bodies
    )
    return dataclasses.replace(made, bodies=bodies, payload=arm.payload, notes=arm.notes)


def home_replaced(arm: Arm, q: ArrayLike) -> Arm:
    """The arm with another pose to start from."""
    home = vector("home", q, arm.n, joints=arm.joint_names)
    for i, joint in enumerate(arm.joints):
        require_within_limits(entry_names("home", [i], arm.joint_names), float(home[i]), joint)
    return dataclasses.replace(arm, home=home)


def _link_name(joint: str) -> str:
    return f"<{joint}>"


def _tree_of(arm: Arm) -> Tree:
    """An Arm back as links and joints: one link per body."""
    links = [TreeLink(name=ROOT, is_frame=False)]
    joints = []
    for joint, body in zip(arm.joints, arm.bodies, strict=True):
        inertia = LinkInertia(mass=body.mass, com=body.com, inertia=body.inertia)
        links.append(TreeLink(name=_link_name(joint.name), inertia=inertia, is_frame=False))
        parent = ROOT if joint.parent == BASE else _link_name(arm.joints[joint.parent].name)
        values = {name: getattr(joint, name) for name in JOINT_FIELDS}
        joints.append(
            TreeJoint(
                name=joint.name,
                kind=joint.kind,
                parent=parent,
                child=_link_name(joint.name),
                origin=joint.placement,
                axis=joint.axis,
                **values,
            )
        )
    for visual in arm.visuals:
        links[visual.body + 1].visuals.append(
            TreeVisual(
                placement=visual.placement,
                shape=visual.shape,
                size=visual.size,
                file=visual.file,
                rgba=visual.rgba,
            )
        )
    frames = [(frame.name, links[frame.body + 1].name, frame.placement) for frame in arm.frames]
    return Tree(name=arm.name, source=arm.source, links=links, joints=joints, frames=frames)


def body_replaced(
    arm: Arm,
    joint: str,
    *,
    mass: float | None,
    com: ArrayLike | None,
    inertia: ArrayLike | None,
) -> Arm:
    """The arm with other mass properties of one body."""
    i = arm.joint_index(joint)
    old = arm.bodies[i]
    new = Body(
        mass=old.mass if mass is None else finite_scalar("mass", mass, unit="kg"),
        com=old.com if com is None else vector("com", com, 3, unit="m"),
        inertia=old.inertia if inertia is None else finite_array("inertia", inertia, shape=(3, 3), unit="kg m^2"),
        links=old.links,
    )
    wrong = check_inertia(new.mass, new.inertia)
    if wrong is not None:
        problem = Problem(object=joint, attribute=wrong[0], message=f"the body of joint '{joint}': {wrong[1]}")
        raise ModelError(arm.name, [problem])
    bodies = (*arm.bodies[:i], new, *arm.bodies[i + 1 :])
    return dataclasses.replace(arm, bodies=bodies)


def joints_replaced(arm: Arm, values: Mapping[str, ArrayLike | Mapping[str, float]]) -> Arm:
    """The arm with other limits, friction, gears or rotor inertia."""
    columns: dict[str, Float64Array] = {}
    for name, given in values.items():
        if name not in JOINT_FIELDS:
            raise unknown_name("a joint", "field", name, JOINT_FIELDS)
        columns[name] = column = _column(arm, name, given)
        above, minimum = 0.0 if name in POSITIVE else -math.inf, -math.inf if name in LIMITS else 0.0
        infinite = name in LIMITS
        require_range(name, column, joints=arm.joint_names, minimum=minimum, above=above, infinite=infinite)
    joints, problems = [], []
    for i, joint in enumerate(arm.joints):
        changed: dict[str, Any] = {
            name: float(column[i]) for name, column in columns.items() if _given(values[name], joint.name)
        }
        if changed.keys() >= set(FRICTION_FIELDS):  # a whole Friction, which says "as in motion" in numbers
            changed |= {at_rest: None for at_rest, moving in AT_REST.items() if changed[at_rest] == changed[moving]}
        joints.append(dataclasses.replace(joint, **changed))
        problems += [
            Problem(object=joint.name, attribute=attribute, message=f"joint '{joint.name}': {text}")
            for attribute, text in value_problems(joints[-1])
        ]
    if problems:
        raise ModelError(arm.name, problems)
    made = dataclasses.replace(arm, joints=tuple(joints))
    _check_friction(made)
    if "rotor_inertia" in columns:
        made = doubt_rotors(dataclasses.replace(made, notes=_notes_on_rotors(arm, made)))
    home = np.clip(arm.home, made.lower, made.upper)
    moved = [arm.joint_names[i] for i in np.flatnonzero(home != arm.home)]
    if not moved:
        return made
    note = f"home of {quoted_list(moved)} was moved into the new limits"
    return dataclasses.replace(made, home=home, notes=(*made.notes, note))


def _given(value: ArrayLike | Mapping[str, float], joint: str) -> bool:
    """Whether a value is given for this joint: one by joint name leaves the others as they are."""
    return not isinstance(value, Mapping) or joint in value


def _notes_on_rotors(before: Arm, after: Arm) -> tuple[str, ...]:
    """The notes of an arm whose rotors were changed: an old doubt goes, a new one comes."""
    old = rotor_doubts(before)
    return (*(note for note in before.notes if note not in old), *rotor_doubts(after))


def _check_friction(arm: Arm) -> None:
    """Refuse friction that is less at rest than in motion, joint by joint."""
    for joint in arm.joints:
        for name, moving in AT_REST.items():
            rest, kinetic = getattr(joint, name), getattr(joint, moving)
            if rest is not None and rest < kinetic:
                raise RangeError(
                    f"joint '{joint.name}': {name} must be >= {moving}, since friction at rest is no less than in "
                    f"motion; got {rest:g} < {kinetic:g}; give both, or with_friction(taut.Friction(...))",
                    name=name,
                    joint=joint.name,
                    value=rest,
                    rule=f">= {moving}",
                )


def geared(arm: Arm, ratio: ArrayLike | Mapping[str, float], motor_inertia: ArrayLike | Mapping[str, float]) -> Arm:
    """The arm with geared motors, whose rotors act with their reflected inertia."""
    given = {"ratio": ratio, "motor_inertia": motor_inertia}
    chosen = _named_joints(arm, given)
    columns = {"ratio": arm.gear.copy(), "motor_inertia": np.zeros(arm.n)}
    for name, value in given.items():
        if isinstance(value, Mapping):
            for joint, one in value.items():
                columns[name][arm.joint_index(joint)] = finite_scalar(f"{name}['{joint}']", one)
        else:
            columns[name][chosen] = _column(arm, name, value)[chosen]
    require_range("ratio", columns["ratio"], above=0.0, joints=arm.joint_names)
    require_range("motor_inertia", columns["motor_inertia"], minimum=0.0, unit="kg m^2", joints=arm.joint_names)
    rotor = arm.rotor_inertia.copy()
    rotor[chosen] = reflected_inertia(columns["ratio"], columns["motor_inertia"])[chosen]
    return joints_replaced(arm, {"gear": columns["ratio"], "rotor_inertia": rotor})


def _named_joints(arm: Arm, given: Mapping[str, ArrayLike | Mapping[str, float]]) -> list[int]:
    """The joints that are to be changed: all, or those that the mappings name, which then must be the same ones."""
    named = {name: value for name, value in given.items() if isinstance(value, Mapping)}
    if not named:
        return list(range(arm.n))
    first = next(iter(named.values()))
    for name, value in named.items():
        missing = [joint for joint in first if joint not in value] + [joint for joint in value if joint not in first]
        if missing:
            raise UsageError(
                f"ratio and motor_inertia by joint name must name the same joints; only one of them names "
                f"{quoted_list(missing)}",
                name=name,
            )
    return [arm.joint_index(joint) for joint in first]


def _column(arm: Arm, name: str, given: ArrayLike | Mapping[str, float]) -> Float64Array:
    """One value per joint, from one number, one per joint, or some by joint name."""
    if isinstance(given, Mapping):
        if name in AT_REST:
            column = getattr(arm.friction, name).tolist()
        else:
            column = [getattr(joint, name) for joint in arm.joints]
        for joint, value in given.items():
            column[arm.joint_index(joint)] = value
        return finite_array(name, column, shape=(arm.n,), joints=arm.joint_names, infinite=name in LIMITS)
    numbers = finite_array(name, given, infinite=name in LIMITS, joints=arm.joint_names)
    if numbers.shape not in ((), (arm.n,)):
        raise ShapeError(f"{name} must be one number or {arm.n}, one per joint; got shape {numbers.shape}", name=name)
    return np.broadcast_to(numbers, (arm.n,))


def perturbed_copy(arm: Arm, *, seed: int, mass: float, com: float, inertia: float, friction: float) -> Arm:
    """The arm with random errors in masses, centres of mass, sizes and friction.

    Spreads are log-normal where a value must stay positive, so that every draw is a possible arm. The size
    acts on the second moment of mass, S = tr(I)/2 1 - I, axis by axis: any positive S is a rigid body, so the
    triangle inequality holds by construction.
    """
    seed = whole_number("seed", seed)
    for name, value in (("mass", mass), ("com", com), ("inertia", inertia), ("friction", friction)):
        if not 0.0 <= finite_scalar(name, value) <= 1.0:
            spread = "a spread of 1 is 100 %, or 1 m"
            raise RangeError(f"{name} must be between 0 and 1 ({spread}); got {value!r}", name=name, value=value)
    rng = np.random.default_rng(seed)
    bodies = []
    for body in arm.bodies:
        k = math.exp(mass * rng.standard_normal())
        shift = com * rng.standard_normal(3)
        stretch = np.diag(np.exp(0.5 * inertia * rng.standard_normal(3)))
        second = k * stretch @ _second_moment(body.inertia) @ stretch
        new = np.trace(second) * np.eye(3) - second
        bodies.append(Body(mass=k * body.mass, com=body.com + shift, inertia=new, links=body.links))
    joints = []
    for joint in arm.joints:
        scale = np.exp(friction * rng.standard_normal(2))
        joints.append(
            dataclasses.replace(
                joint,
                viscous=float(joint.viscous * scale[0]),
                coulomb=float(joint.coulomb * scale[1]),
                static=None if joint.static is None else float(joint.static * scale[1]),
            )
        )
    return dataclasses.replace(arm, bodies=tuple(bodies), joints=tuple(joints))


def _second_moment(inertia: Float64Array) -> Float64Array:
    """The second moment of mass; what a rounded file puts below zero is lifted to zero."""
    values, axes = np.linalg.eigh(0.5 * np.trace(inertia) * np.eye(3) - inertia)
    second: Float64Array = (axes * np.maximum(values, 0.0)) @ axes.T
    return second
