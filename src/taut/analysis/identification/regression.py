"""Joint torques as linear in what is unknown of an arm: regressor, base parameters, and the arm that has them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Final, Literal, TypeAlias

import numpy as np
from scipy.optimize import least_squares

from taut.arm.description import BASE, Arm
from taut.arm.friction import Friction
from taut.arm.parts import Payload, inertia_matrix
from taut.base.checks import instance_of, one_of
from taut.base.errors import UsageError
from taut.base.types import Array, Float64Array, Vector
from taut.codegen.program import over_rows
from taut.maths.friction import FrictionValues, friction_torque
from taut.maths.model import PayloadValues, model_of
from taut.maths.regressor import PARAMETERS, body_of, moved, parameters_of, pseudo_inertia, regressor
from taut.trace import math as tm

Unknown: TypeAlias = Literal["payload", "links", "rotors", "friction"]
UNKNOWNS: Final[tuple[Unknown, ...]] = ("payload", "links", "rotors", "friction")
BODY_UNITS: Final = ("kg", *["kg m"] * 3, *["kg m^2"] * 6)
JOINT_UNITS: Final = {  # of hinges, and of prismatic joints; in the order of the columns, after those of bodies
    "rotor_inertia": ("kg m^2", "kg"),
    "viscous": ("N m s/rad", "N s/m"),
    "coulomb": ("N m", "N"),
}
STATES: Final = 100  # random ones, at which base parameters are determined
IN_SPAN: Final = 1e-8  # of a column of length 1, outside the span of those before it: it depends on them
PRIOR: Final = 1e-3  # weight of the arm as it was, in standard deviations: it decides what the record does not
FLATTEST: Final = 1e-3  # of a body with which the search begins: eigenvalues of its pseudo-inertia over the largest
MIN_LARGEST: Final = 1e-6  # [kg, kg m^2] of that largest one
UPPER: Final = np.triu_indices(4, 1)


class ArmRegression:
    """Torques = known + columns x: x the unknown parameters, by name; the rest is as the arm has it.

    The ten parameters of the payload are those about the tool's origin, in its axes; those of a link are those of the
    body that the joint moves, about the joint's frame, in the axes of the arm.
    """

    def __init__(self, arm: Arm, what: Sequence[Unknown]) -> None:
        instance_of("arm", arm, Arm, "an Arm from taut.load_arm")
        parts = [what] if isinstance(what, str) else what
        if not isinstance(parts, Sequence) or not parts:
            raise UsageError(f"what must name one or more of {', '.join(UNKNOWNS)}; got {what!r}", name="what")
        self.what = {one_of("what", part, UNKNOWNS) for part in parts}
        if {"payload", "links"} <= self.what:
            raise UsageError(
                "the ten parameters of a payload add to those of the link that carries it; identify 'payload' or "
                "'links', and put a known payload into the arm",
                name="what",
            )
        self.arm, n, model = arm, arm.n, model_of(arm)
        carrier, R, p = model.placement(None)
        if "payload" in self.what and carrier == BASE:
            raise UsageError(f"the tool '{arm.tool}' does not move: it carries no payload", name="arm")
        payload, at_tool = parameters_of(PayloadValues.of(arm.payload).body()), moved(R, p)
        known = np.array([parameters_of(link) for link in model.links])
        bodies: list[tuple[str, int, Float64Array, Float64Array]] = []  # name, link, to its frame, parameters
        if "links" in self.what:
            frames = [moved(A.T, np.zeros(3)) for A in model.aligned]
            values = [np.linalg.solve(T, row) for T, row in zip(frames, known, strict=True)]
            bodies, known = list(zip(arm.joint_names, range(n), frames, values, strict=True)), np.zeros((n, 10))
        if "payload" in self.what:
            bodies = [("payload", carrier, at_tool, payload)]
        elif carrier != BASE:
            known[carrier] += at_tool @ payload
        rotors, friction = "rotors" in self.what, "friction" in self.what
        self.of_joints = ("rotor_inertia",) * rotors + ("viscous", "coulomb") * friction
        each = [(joint, unit == "m") for joint, unit in zip(arm.joint_names, arm.units, strict=True)]
        self.names = (
            *(f"{who}.{name}" for who, *_ in bodies for name in PARAMETERS),
            *(f"{joint}.{name}" for name in self.of_joints for joint, _ in each),
        )
        self.units = (
            *BODY_UNITS * len(bodies),
            *(JOINT_UNITS[name][prismatic] for name in self.of_joints for _, prismatic in each),
        )
        self.bodies = len(bodies)
        self.nominal = np.concatenate([*(x for *_, x in bodies), *(getattr(arm, name) for name in self.of_joints)])

        def of_bodies(q: Vector, v: Vector, a: Vector) -> dict[str, Array]:
            Y = regressor(model, q, v, a)
            columns = [Y[:, 10 * i : 10 * i + 10] @ T for _, i, T, _ in bodies]
            return {"Y": np.hstack([tm.zeros((n, 0)), *columns]), "known": Y @ known.ravel()}

        self._of_bodies = over_rows(of_bodies, q=n, v=n, a=n)
        states = np.random.default_rng(0).uniform(-np.pi, np.pi, (3, STATES, n))
        Y = self.columns(*states)[0].reshape(-1, len(self.names))
        size = np.linalg.norm(Y, axis=0)
        new = np.diag(np.linalg.qr(Y / np.where(size > IN_SPAN, size, np.inf), mode="r"))
        self.base = np.flatnonzero(np.abs(new) > IN_SPAN).tolist()
        """Numbers of the unknowns that stand for the base parameters: of columns outside the span of those before."""
        K = np.linalg.lstsq(Y[:, self.base], Y, rcond=None)[0]
        self.K = np.where(np.abs(K) < IN_SPAN, 0.0, K)
        """(b, m) base parameters of all: those that act on torques are K x."""

    def at(self, q: Float64Array, v: Float64Array, a: Float64Array) -> tuple[Float64Array, Float64Array]:
        """(k, n, b) columns of the base parameters, and (k, n) known torques, at samples (k, n)."""
        Y, known = self.columns(q, v, a)
        return Y[:, :, self.base], known

    def columns(self, q: Float64Array, v: Float64Array, a: Float64Array) -> tuple[Float64Array, Float64Array]:
        """(k, n, m) columns of all unknowns, and (k, n) known torques."""
        bodies = self._of_bodies(q=q, v=v, a=a)
        known, motion = bodies["known"], {"rotor_inertia": a, "viscous": v, "coulomb": np.sign(v)}
        if "rotor_inertia" not in self.of_joints:
            known = known + self.arm.rotor_inertia * a
        if "coulomb" not in self.of_joints:
            known = known - np.asarray(friction_torque(FrictionValues.fixed(self.arm.friction), v))
        columns = [motion[name][:, :, np.newaxis] * np.eye(self.arm.n) for name in self.of_joints]
        return np.concatenate([bodies["Y"], *columns], axis=2), known

    @property
    def combinations(self) -> dict[str, str]:
        """Base parameters that stand for several unknowns, by name, as sums of these."""
        out = {}
        for row, j in zip(self.K, self.base, strict=True):
            terms = [(row[i], self.names[i]) for i in np.flatnonzero(row)]
            if len(terms) > 1:
                out[self.names[j]] = linear_text(terms)
        return out

    @property
    def without_effect(self) -> tuple[str, ...]:
        """Unknowns that act on no torque in any motion."""
        return tuple(name for name, column in zip(self.names, self.K.T, strict=True) if not column.any())


def linear_text(terms: Sequence[tuple[float, str]]) -> str:
    """A sum of named numbers in words: a - 0.5 b."""
    sizes = ["" if abs(abs(factor) - 1.0) < IN_SPAN else f"{abs(factor):.3g} " for factor, _ in terms]
    words = [f"{'-' if each[0] < 0.0 else '+'} {size}{each[1]}" for size, each in zip(sizes, terms, strict=True)]
    return " ".join(words).removeprefix("+ ")


def possible_bodies(
    regression: ArmRegression, estimate: Float64Array, covariance: Float64Array
) -> tuple[Float64Array, float]:
    """(m,) all unknowns, with bodies that are possible, and how far they are from the estimate [standard deviations].

    They are those of the smallest change of the arm by which K x is the estimate. Where these are not possible, K x
    is fitted with the weights of the estimate over log-Cholesky parameters of each body, P = U U^T, U upper
    triangular with positive diagonal; what K x does not determine stays near that change.
    """
    count = 10 * regression.bodies
    rows = [row for row, j in enumerate(regression.base) if j < count]
    x = regression.nominal.copy()
    x[regression.base[len(rows) :]] = estimate[len(rows) :]
    A = regression.K[rows]
    target = estimate[rows] - A[:, count:] @ x[count:]
    A = A[:, :count]
    x[:count] += np.linalg.lstsq(A, target - A @ x[:count], rcond=None)[0]
    bodies = x[:count].reshape(-1, 10)
    sizes, axes = np.linalg.eigh(np.reshape([pseudo_inertia(body) for body in bodies], (-1, 4, 4)))
    if (sizes > 0.0).all():
        return x, 0.0
    shape = np.linalg.inv(np.linalg.cholesky(covariance[np.ix_(rows, rows)]))
    sizes = np.maximum(sizes, FLATTEST * np.abs(sizes).max(axis=1, keepdims=True, initial=MIN_LARGEST))
    P = axes * sizes[:, np.newaxis] @ np.swapaxes(axes, 1, 2)
    U = np.linalg.cholesky(P[:, ::-1, ::-1])[:, ::-1, ::-1]
    start = np.concatenate([np.log(np.diagonal(U, axis1=1, axis2=2)), U[:, *UPPER]], axis=1).ravel()

    def misfit(theta: Float64Array) -> Float64Array:
        return np.concatenate([shape @ (A @ _bodies(theta) - target), PRIOR * (theta - start)])

    theta = least_squares(misfit, start, jac="3-point", max_nfev=200).x
    x[:count] = _bodies(theta)
    return x, float(np.linalg.norm(misfit(theta)[: len(rows)]))


def _bodies(theta: Float64Array) -> Float64Array:
    """(m,) parameters of bodies, ten each, from log-Cholesky parameters (m,)."""
    parts = theta.reshape(-1, 10)
    U = np.exp(parts[:, :4])[:, :, np.newaxis] * np.eye(4)
    U[:, UPPER[0], UPPER[1]] = parts[:, 4:]
    P = U @ np.swapaxes(U, 1, 2)
    xx, yy, zz = (P[:, i, i] for i in range(3))
    six = [yy + zz, xx + zz, xx + yy, -P[:, 0, 1], -P[:, 0, 2], -P[:, 1, 2]]
    return np.stack([P[:, 3, 3], *P[:, :3, 3].T, *six], axis=1).ravel()


def changed_arm(regression: ArmRegression, x: Float64Array, slow: Mapping[int, Sequence[float]]) -> Arm:
    """The arm with the unknowns x, and static friction and Stribeck speed by joint; none of them is negative."""
    arm, n = regression.arm, regression.arm.n
    parts = iter(np.split(x, 10 * regression.bodies + n * np.arange(4)))
    bodies = next(parts).reshape(-1, 10)
    found = [PayloadValues.of_body(body_of(body)) for body in bodies]
    if "payload" in regression.what:
        (load,) = found
        payload = Payload(mass=load.mass, com=load.com, inertia=load.inertia) if load.mass else Payload()
        arm = dataclasses.replace(arm, payload=payload)
    if "links" in regression.what:
        for joint, body in zip(arm.joint_names, found, strict=True):
            arm = arm.with_body(joint, mass=body.mass, com=body.com, inertia=inertia_matrix(body.inertia))
    joints = {name: np.maximum(next(parts), 0.0) for name in regression.of_joints}
    if "rotor_inertia" in joints:
        arm = arm.with_joints(rotor_inertia=joints["rotor_inertia"])
    if "coulomb" in joints:
        viscous, coulomb = joints["viscous"], joints["coulomb"]
        static, stribeck = coulomb.copy(), np.zeros(n)
        for i, (at_rest, speed) in slow.items():
            static[i], stribeck[i] = max(at_rest, coulomb[i]), speed
        arm = arm.with_friction(Friction(viscous=viscous, coulomb=coulomb, static=static, stribeck=stribeck))
    return arm
