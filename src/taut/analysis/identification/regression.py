"""Joint torques as linear in what is unknown of an arm: regressor, base parameters, and the arm that has them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Final, Literal, TypeAlias

import numpy as np
from scipy.optimize import least_squares

from taut.arm.description import BASE, Arm
from taut.arm.friction import Friction
from taut.arm.parts import Payload
from taut.base.checks import instance_of, one_of
from taut.base.errors import UsageError
from taut.base.types import Float64Array
from taut.codegen.program import over_rows
from taut.maths.friction import FrictionValues, friction_torque
from taut.maths.model import PayloadValues, model_of
from taut.maths.regressor import PARAMETERS, body_of, parameters_of, pseudo_inertia, regressor
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
GYRATION: Final = 0.05  # [m] of gyration, of the body with which the search begins where there was none
MIN_MASS: Final = 1e-6  # [kg] of it
DIFFERENCE: Final = 1e-6  # for slopes
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
        self._known = np.array([parameters_of(link) for link in model.links])
        payload = _transform(R, p) @ parameters_of(PayloadValues.of(arm.payload).body())
        self._bodies: list[tuple[str, int, Float64Array]] = []
        if "links" in self.what:
            transforms = [_transform(A.T, np.zeros(3)) for A in model.aligned]
            self._bodies = list(zip(arm.joint_names, range(n), transforms, strict=True))
        if "payload" in self.what:
            self._bodies = [("payload", carrier, _transform(R, p))]
        values = [np.linalg.solve(T, payload if who == "payload" else self._known[i]) for who, i, T in self._bodies]
        if carrier != BASE:
            self._known[carrier] += payload
        for (_, i, T), value in zip(self._bodies, values, strict=True):
            self._known[i] -= T @ value
        rotors, friction = "rotors" in self.what, "friction" in self.what
        self.of_joints = ("rotor_inertia",) * rotors + ("viscous", "coulomb") * friction
        each = [(joint, unit == "m") for joint, unit in zip(arm.joint_names, arm.units, strict=True)]
        self.names = (
            *(f"{who}.{name}" for who, _, _ in self._bodies for name in PARAMETERS),
            *(f"{joint}.{name}" for name in self.of_joints for joint, _ in each),
        )
        self.units = (
            *BODY_UNITS * len(self._bodies),
            *(JOINT_UNITS[name][prismatic] for name in self.of_joints for _, prismatic in each),
        )
        self.bodies = len(self._bodies)
        self.nominal = np.concatenate([*values, *(getattr(arm, name) for name in self.of_joints)])

        self._regressor = over_rows(lambda q, v, a: {"Y": regressor(model, q, v, a)}, q=n, v=n, a=n)

    def at(self, q: Float64Array, v: Float64Array, a: Float64Array) -> tuple[Float64Array, Float64Array]:
        """(k, n, b) columns of the base parameters, and (k, n) known torques, at samples (k, n)."""
        Y, known = self._all(q, v, a)
        return Y[:, :, list(self.base)], known

    def _all(self, q: Float64Array, v: Float64Array, a: Float64Array) -> tuple[Float64Array, Float64Array]:
        """(k, n, m) columns of all unknowns, and (k, n) known torques."""
        k, n = q.shape
        Y = self._regressor(q=q, v=v, a=a)["Y"].reshape(k, n, n, 10)
        known = Y.reshape(k, n, 10 * n) @ self._known.ravel()
        if "rotor_inertia" not in self.of_joints:
            known = known + self.arm.rotor_inertia * a
        if "coulomb" not in self.of_joints:
            known = known - np.asarray(friction_torque(FrictionValues.fixed(self.arm.friction), v))
        motion = {"rotor_inertia": a, "viscous": v, "coulomb": np.sign(v)}
        columns = [Y[:, :, i] @ T for _, i, T in self._bodies]
        columns += [motion[name][:, :, np.newaxis] * np.eye(n) for name in self.of_joints]
        return np.concatenate(columns, axis=2), known

    @property
    def base(self) -> tuple[int, ...]:
        """Numbers of the unknowns that stand for the base parameters."""
        return self._reduction[0]

    @property
    def K(self) -> Float64Array:
        """(b, m) base parameters of all: those that act on torques are K x."""
        return self._reduction[1]

    @cached_property
    def _reduction(self) -> tuple[tuple[int, ...], Float64Array]:
        """By columns at random states: one that depends on those before it is regrouped with them."""
        rng = np.random.default_rng(0)
        Y = self._all(*rng.uniform(-np.pi, np.pi, (3, STATES, self.arm.n)))[0].reshape(-1, len(self.names))
        size = np.linalg.norm(Y, axis=0)
        basis, base = np.zeros((len(Y), 0)), list[int]()
        for j, column in enumerate((Y / np.where(size > IN_SPAN, size, np.inf)).T):
            rest = column - basis @ (basis.T @ column)
            rest = rest - basis @ (basis.T @ rest)  # again, for rounding
            if np.linalg.norm(rest) > IN_SPAN:
                basis = np.column_stack([basis, rest / np.linalg.norm(rest)])
                base.append(j)
        K = np.linalg.lstsq(Y[:, base], Y, rcond=None)[0]
        return tuple(base), np.where(np.abs(K) < IN_SPAN, 0.0, K)

    @property
    def combinations(self) -> dict[str, str]:
        """Base parameters that stand for several unknowns, by name, as sums of these."""
        out = {}
        for row, j in zip(self.K, self.base, strict=True):
            terms = [(1.0, self.names[j]), *((row[i], self.names[i]) for i in np.flatnonzero(row) if i != j)]
            if len(terms) > 1:
                out[self.names[j]] = linear_text(terms)
        return out

    @property
    def without_effect(self) -> tuple[str, ...]:
        """Unknowns that act on no torque in any motion."""
        return tuple(name for name, column in zip(self.names, self.K.T, strict=True) if not column.any())


def _transform(R: Float64Array, p: Float64Array) -> Float64Array:
    """(10, 10) from the parameters of a body in a frame at R, p to those in the frame around it."""
    return np.array([parameters_of(body_of(unit).seen_from(R, p)) for unit in np.eye(10)], dtype=np.float64).T


def linear_text(terms: Sequence[tuple[float, str]]) -> str:
    """A sum of named numbers in words: a - 0.5 b."""
    sizes = ["" if abs(abs(factor) - 1.0) < IN_SPAN else f"{abs(factor):.3g} " for factor, _ in terms]
    words = [f"{'-' if each[0] < 0.0 else '+'} {size}{each[1]}" for size, each in zip(sizes, terms, strict=True)]
    return " ".join(words).removeprefix("+ ")


def possible_bodies(
    regression: ArmRegression, estimate: Float64Array, covariance: Float64Array
) -> tuple[Float64Array, float]:
    """(m,) all unknowns, with bodies that are possible, and how far they are from the estimate [standard deviations].

    The base parameters K x are fitted with the weights of the estimate over log-Cholesky parameters of each body,
    P = U U^T, U upper triangular with positive diagonal. What K x does not determine stays near the arm as it was.
    """
    K, base, count = regression.K, list(regression.base), 10 * regression.bodies
    x = regression.nominal.copy()
    rows = [row for row, j in enumerate(base) if j < count]
    for row, j in enumerate(base[len(rows) :], start=len(rows)):
        x[j] = estimate[row]
    if len(rows) == count:
        x[:count] = estimate[rows]
        if all(_is_possible(body) for body in x[:count].reshape(-1, 10)):
            return x, 0.0
        x[:count] = regression.nominal[:count]
    A = K[rows][:, :count]
    target = estimate[rows] - K[rows][:, count:] @ x[count:]
    shape = np.linalg.inv(np.linalg.cholesky(covariance[np.ix_(rows, rows)]))
    pairs = zip(x[:count].reshape(-1, 10), np.linalg.lstsq(A, target, rcond=None)[0].reshape(-1, 10), strict=True)
    start = np.concatenate([_log_cholesky(own, likely) for own, likely in pairs])

    def misfit(theta: Float64Array) -> Float64Array:
        return np.concatenate([shape @ (A @ _bodies(theta) - target), PRIOR * (theta - start)])

    def slope(theta: Float64Array) -> Float64Array:
        steps = DIFFERENCE * np.eye(count)
        change = (_bodies(theta + steps) - _bodies(theta - steps)) / (2.0 * DIFFERENCE)
        return np.vstack([shape @ A @ change.T, PRIOR * np.eye(count)])

    theta = least_squares(misfit, start, jac=slope, max_nfev=200).x if rows else start
    x[:count] = _bodies(theta)
    return x, float(np.linalg.norm(misfit(theta)[: len(rows)]))


def _is_possible(body: Float64Array) -> bool:
    return bool(np.linalg.eigvalsh(pseudo_inertia(body))[0] > 0.0)


def _log_cholesky(own: Float64Array, likely: Float64Array) -> Float64Array:
    """(10,) logarithms of the diagonal of U, and what is above it: of a body, or of one about a likely centre."""
    P = np.asarray(pseudo_inertia(own), dtype=np.float64)
    if not _is_possible(own):
        mass = max(float(likely[0]), MIN_MASS)
        c = np.array([*(likely[1:4] / mass if likely[0] > MIN_MASS else np.zeros(3)), 1.0])
        P = mass * (np.outer(c, c) + GYRATION**2 * np.diag([1.0, 1.0, 1.0, 0.0]))
    U = np.linalg.cholesky(P[::-1, ::-1])[::-1, ::-1]
    return np.concatenate([np.log(np.diag(U)), U[UPPER]])


def _bodies(theta: Float64Array) -> Float64Array:
    """(..., m) parameters of bodies, ten each, from log-Cholesky parameters (..., m)."""
    parts = theta.reshape(-1, 10)
    U = np.exp(parts[:, :4])[:, :, np.newaxis] * np.eye(4)
    U[:, UPPER[0], UPPER[1]] = parts[:, 4:]
    P = U @ np.swapaxes(U, 1, 2)
    xx, yy, zz = (P[:, i, i] for i in range(3))
    six = [yy + zz, xx + zz, xx + yy, -P[:, 0, 1], -P[:, 0, 2], -P[:, 1, 2]]
    return np.stack([P[:, 3, 3], *P[:, :3, 3].T, *six], axis=1).reshape(theta.shape)


def changed_arm(regression: ArmRegression, x: Float64Array, slow: Mapping[int, tuple[float, float]]) -> Arm:
    """The arm with the unknowns x, and static friction and Stribeck speed by joint; none of them is negative."""
    arm, n = regression.arm, regression.arm.n
    parts = iter(np.split(x, 10 * regression.bodies + n * np.arange(4)))
    bodies = next(parts).reshape(-1, 10)
    if "payload" in regression.what:
        mass, com, inertia = _about_centre(bodies[0])
        arm = dataclasses.replace(arm, payload=Payload(mass=mass, com=com, inertia=inertia))
    if "links" in regression.what:
        for joint, body in zip(arm.joint_names, bodies, strict=True):
            mass, com, inertia = _about_centre(body)
            arm = arm.with_body(joint, mass=mass, com=com, inertia=inertia)
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


def _about_centre(parameters: Float64Array) -> tuple[float, Float64Array, Float64Array]:
    """Mass, centre of mass, and (3, 3) inertia about it."""
    body = body_of(parameters)
    com = body.h / body.m if body.m > 0.0 else np.zeros(3)
    S = tm.skew(com)
    return float(body.m), com, np.asarray(body.I + body.m * (S @ S), dtype=np.float64)
