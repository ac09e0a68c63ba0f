"""Changed copies of an Arm: joints locked, bodies or joint values replaced, a modelling error drawn."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from taut.arm.friction import AT_REST, FRICTION_FIELDS
from taut.arm.loaders.tree import Tree, TreeJoint, TreeLink, assemble, positions_within_limits
from taut.arm.parts import Body, Payload
from taut.arm.rules import check_inertia, payload_doubts, rotor_doubts, value_problems
from taut.base.checks import (
    finite_array,
    finite_scalar,
    per_joint,
    require_range,
    vector,
    whole_number,
)
from taut.base.errors import ModelError, Problem, RangeError, UsageError, quoted_list, unknown_name, warn
from taut.base.types import ArrayLike, Float64Array

if TYPE_CHECKING:
    from taut.arm.description import Arm

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
    at = positions_within_limits("home" if q is None else "q", arm.home if q is None else q, arm.joints)
    home = dict(zip(arm.joint_names, map(float, at), strict=True))
    tree = _tree_of(arm, locked={name: position for name, position in home.items() if name not in keep})
    made = assemble(type(arm), tree, T_WB=arm.T_WB, home=home)
    links = {_link_name(joint): body.links for joint, body in zip(arm.joint_names, arm.bodies, strict=True)}
    bodies = tuple(
        dataclasses.replace(body, links=tuple(name for made_of in body.links for name in links[made_of]))
        for body in made.bodies
    )
    return dataclasses.replace(made, bodies=bodies, payload=arm.payload, notes=arm.notes)


def _link_name(joint: str) -> str:
    return f"<{joint}>"


def _tree_of(arm: Arm, locked: dict[str, float]) -> Tree:
    """An Arm back as links and joints: one link per body."""
    links = [TreeLink(name=ROOT, is_frame=False)]
    joints = []
    for joint, body in zip(arm.joints, arm.bodies, strict=True):
        links.append(TreeLink(name=_link_name(joint.name), inertia=body, is_frame=False))
        joints.append(TreeJoint(joint=joint, parent=links[joint.parent + 1].name, child=_link_name(joint.name)))
    for visual in arm.visuals:
        links[visual.body + 1].visuals.append(visual)
    return Tree(
        name=arm.name,
        source=arm.source,
        links=links,
        joints=joints,
        frames=[(frame.name, links[frame.body + 1].name, frame.placement) for frame in arm.frames],
        gravity=arm.gravity,
        locked=locked,
        tool=arm.tool,
        commands=arm.commands,
    )


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
    _ = made.friction  # which refuses less friction at rest than in motion
    if "rotor_inertia" in columns:
        for doubt in rotor_doubts(made):
            warn(doubt)
    home = np.clip(arm.home, made.lower, made.upper)
    moved = [arm.joint_names[i] for i in np.flatnonzero(home != arm.home)]
    if not moved:
        return made
    note = f"home of {quoted_list(moved)} was moved into the new limits"
    return dataclasses.replace(made, home=home, notes=(*made.notes, note))


def _given(value: ArrayLike | Mapping[str, float], joint: str) -> bool:
    """Whether a value is given for this joint: one by joint name leaves the others as they are."""
    return not isinstance(value, Mapping) or joint in value


def loaded(arm: Arm, payload: Payload) -> Arm:
    """The arm with a payload at its tool."""
    made = dataclasses.replace(arm, payload=payload)
    for doubt in payload_doubts(made):
        warn(doubt)
    return made


def geared(arm: Arm, ratio: ArrayLike | Mapping[str, float], motor_inertia: ArrayLike) -> Arm:
    """The arm with geared motors, whose rotors act with their reflected inertia."""
    chosen = [not isinstance(ratio, Mapping) or name in ratio for name in arm.joint_names]
    G = _column(arm, "gear", ratio) if isinstance(ratio, Mapping) else per_joint("ratio", ratio, arm.joint_names)
    rotor = per_joint("motor_inertia", motor_inertia, arm.joint_names)
    require_range("ratio", G, above=0.0, joints=arm.joint_names)
    require_range("motor_inertia", rotor, minimum=0.0, unit="kg m^2", joints=arm.joint_names)
    return joints_replaced(arm, {"gear": G, "rotor_inertia": np.where(chosen, G**2 * rotor, arm.rotor_inertia)})


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
    return per_joint(name, given, arm.joint_names, infinite=name in LIMITS)


def perturbed_copy(arm: Arm, *, seed: int, mass: float, com: float, inertia: float, friction: float) -> Arm:
    """The arm with random errors in masses, centres of mass, sizes and friction, log-normal where positive.

    The size acts on the second moment of mass S = tr(I)/2 1 - I axis by axis: any S > 0 is a rigid body.
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
