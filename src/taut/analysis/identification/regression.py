"""Joint torques as linear in what is unknown of an arm: the regressor at many samples, and its base parameters."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Final, Literal, TypeAlias

import numpy as np

from taut.arm.description import BASE, Arm
from taut.base.checks import instance_of, one_of
from taut.base.errors import UsageError
from taut.base.types import Float64Array
from taut.codegen.program import Block, Values, trace
from taut.maths.friction import FrictionValues, friction_torque
from taut.maths.model import PayloadValues, model_of
from taut.maths.regressor import PARAMETERS, body_of, parameters_of, regressor

Unknown: TypeAlias = Literal["payload", "links", "rotors", "friction"]
UNKNOWNS: Final[tuple[Unknown, ...]] = ("payload", "links", "rotors", "friction")
BODY_UNITS: Final = ("kg", *["kg m"] * 3, *["kg m^2"] * 6)
JOINT_UNITS: Final = {  # of hinges, and of prismatic joints; in the order of the columns, after those of bodies
    "rotor_inertia": ("kg m^2", "kg"),
    "viscous": ("N m s/rad", "N s/m"),
    "coulomb": ("N m", "N"),
}
AT_ONE_GO: Final = 2000  # samples that are evaluated together: their intermediate results fit into the cache
STATES: Final = 100  # random ones, at which base parameters are determined
IN_SPAN: Final = 1e-8  # of a column of length 1, outside the span of those before it: it depends on them


class ArmRegression:
    """Torques = known + columns x: x the unknown parameters, by name; the rest is as the arm has it.

    The ten parameters of the payload are those about the tool's origin, in its axes; those of a link are those of the
    body that the joint moves, about the joint's frame, in the axes of the arm.
    """

    def __init__(self, arm: Arm, what: Sequence[Unknown]) -> None:
        instance_of("arm", arm, Arm, "an Arm from taut.load_arm")
        self.what = {one_of("what", part, UNKNOWNS) for part in ([what] if isinstance(what, str) else what)}
        if not self.what:
            raise UsageError(f"what must name one or more of {', '.join(UNKNOWNS)}", name="what")
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
        own = [
            (*pair, _transform(A.T, np.zeros(3)))
            for *pair, A in zip(arm.joint_names, range(n), model.aligned, strict=True)
        ]
        self._bodies = own if "links" in self.what else []
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

        def columns(inputs: Values, parameters: Values, memory: Values) -> tuple[Values, Values]:  # noqa: ARG001
            return {"Y": regressor(model, inputs["q"], inputs["v"], inputs["a"])}, {}

        self._program = trace(columns, Block.of(dict.fromkeys("qva", (n,))), Block(), Block())

    def at(self, q: Float64Array, v: Float64Array, a: Float64Array) -> tuple[Float64Array, Float64Array]:
        """(k, n, b) columns of the base parameters, and (k, n) known torques, at samples (k, n)."""
        parts = [self._all(*(x[i : i + AT_ONE_GO] for x in (q, v, a))) for i in range(0, len(q), AT_ONE_GO)]
        base = list(self.base)
        return np.concatenate([Y[:, :, base] for Y, _ in parts]), np.concatenate([known for _, known in parts])

    def _all(self, q: Float64Array, v: Float64Array, a: Float64Array) -> tuple[Float64Array, Float64Array]:
        """(k, n, m) columns of all unknowns, and (k, n) known torques."""
        k, n = q.shape
        ends = self._program.evaluated(np.hstack([q, v, a]).T)[0]
        Y = np.stack([np.broadcast_to(end, k) for end in ends], axis=1).reshape(k, n, n, 10)
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
