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
from taut.maths.model import PayloadValues, RigidBody, model_of
from taut.maths.regressor import PARAMETERS, body_of, parameters_of, regressor

Unknown: TypeAlias = Literal["payload", "friction", "rotors", "links"]
UNKNOWNS: Final[tuple[Unknown, ...]] = ("payload", "links", "rotors", "friction")  # in the order of their columns
BODY_UNITS: Final = ("kg", *["kg m"] * 3, *["kg m^2"] * 6)
CHUNK: Final = 2000  # samples that are evaluated at once: their intermediate results fit into the cache
STATES: Final = 100  # random ones, at which base parameters are determined
DEPENDENT: Final = 1e-8  # of a column of length 1, outside the span of those before it: it depends on them


class ArmRegression:
    """Torques = known + columns x: x the unknown parameters, by name; the rest is as the arm has it.

    The ten parameters of the payload are those about the tool's origin, in its axes; those of a link are those of the
    body that the joint moves, about the joint's frame, in the axes of the arm.
    """

    def __init__(self, arm: Arm, what: Sequence[Unknown]) -> None:
        instance_of("arm", arm, Arm, "an Arm from taut.load_arm")
        given = [one_of("what", part, UNKNOWNS) for part in ([what] if isinstance(what, str) else what)]
        if not given or len(set(given)) < len(given):
            raise UsageError(
                f"what must name one or more of {', '.join(UNKNOWNS)}, once each; got {given}", name="what"
            )
        if {"payload", "links"} <= set(given):
            raise UsageError(
                "the ten parameters of a payload add to those of the link that carries it; identify 'payload' or "
                "'links', and put a known payload into the arm",
                name="what",
            )
        self.arm, self.model = arm, model_of(arm)
        self.what = tuple(part for part in UNKNOWNS if part in given)
        n, model = arm.n, self.model
        body, R, p = model.placement(None)
        if "payload" in given and body == BASE:
            raise UsageError(f"the tool '{arm.tool}' does not move: it carries no payload", name="arm")
        links = np.array([parameters_of(link) for link in model.links])
        payload = parameters_of(PayloadValues.of(arm.payload).body())
        self._body, self._of_tool = body, _transform(R, p)
        self._of_links = [_transform(A.T, np.zeros(3)) for A in model.aligned]
        own = [np.linalg.solve(T, link) for T, link in zip(self._of_links, links, strict=True)]
        self._known = np.zeros((n, 10)) if "links" in given else links
        if "payload" not in given and body != BASE:
            self._known[body] += self._of_tool @ payload
        force = ["N" if unit == "m" else "N m" for unit in arm.units]
        names: list[str] = []
        units: list[str] = []
        values: list[float] = []
        for part in self.what:
            if part in ("payload", "links"):
                owners = ["payload"] if part == "payload" else list(arm.joint_names)
                names += [f"{owner}.{name}" for owner in owners for name in PARAMETERS]
                units += list(BODY_UNITS) * len(owners)
                values += payload.tolist() if part == "payload" else np.ravel(own).tolist()
            elif part == "rotors":
                names += [f"{joint}.rotor_inertia" for joint in arm.joint_names]
                units += ["kg" if unit == "m" else "kg m^2" for unit in arm.units]
                values += arm.rotor_inertia.tolist()
            else:
                names += [f"{joint}.{name}" for name in ("viscous", "coulomb") for joint in arm.joint_names]
                units += [f"{N} s/{unit}" for N, unit in zip(force, arm.units, strict=True)] + force
                values += [*arm.viscous.tolist(), *arm.coulomb.tolist()]
        self.names, self.units, self.nominal = tuple(names), tuple(units), np.array(values)
        self.bodies = sum(name.rpartition(".")[2] in PARAMETERS for name in names) // 10  # whose columns come first
        block = Block.of({"q": (n,), "v": (n,), "a": (n,)})

        def columns(inputs: Values, parameters: Values, memory: Values) -> tuple[Values, Values]:  # noqa: ARG001
            return {"Y": regressor(model, inputs["q"], inputs["v"], inputs["a"])}, {}

        self._program = trace(columns, block, Block(), Block())

    def at(self, q: Float64Array, v: Float64Array, a: Float64Array) -> tuple[Float64Array, Float64Array]:
        """(k, n, m) columns of the base parameters, and (k, n) known torques, at samples (k, n)."""
        parts = [self._all(*(x[i : i + CHUNK] for x in (q, v, a))) for i in range(0, len(q), CHUNK)]
        base = list(self.base)
        return np.concatenate([Y[:, :, base] for Y, _ in parts]), np.concatenate([known for _, known in parts])

    def _all(self, q: Float64Array, v: Float64Array, a: Float64Array) -> tuple[Float64Array, Float64Array]:
        """(k, n, m) columns of all unknowns, and (k, n) known torques."""
        k, n = q.shape
        ends = self._program.evaluated(np.hstack([q, v, a]).T)[0]
        Y = np.stack([np.broadcast_to(end, k) for end in ends], axis=1).reshape(k, n, n, 10)
        known = Y.reshape(k, n, 10 * n) @ self._known.ravel()
        columns: list[Float64Array] = []
        if "payload" in self.what:
            columns.append(Y[:, :, self._body] @ self._of_tool)
        if "links" in self.what:
            columns += [Y[:, :, i] @ T for i, T in enumerate(self._of_links)]
        if "rotors" in self.what:
            columns.append(a[:, :, np.newaxis] * np.eye(n))
        else:
            known = known + self.arm.rotor_inertia * a
        if "friction" in self.what:
            columns += [x[:, :, np.newaxis] * np.eye(n) for x in (v, np.sign(v))]
        else:
            known = known - np.asarray(friction_torque(FrictionValues.fixed(self.arm.friction), v))
        return np.concatenate(columns, axis=2), known

    @cached_property
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
        unit = Y / np.where(size > DEPENDENT, size, np.inf)
        basis, base = np.zeros((len(Y), 0)), list[int]()
        for j in range(unit.shape[1]):
            rest = unit[:, j]
            for _ in range(2):  # the second time for rounding
                rest = rest - basis @ (basis.T @ rest)
            if np.linalg.norm(rest) > DEPENDENT:
                basis = np.column_stack([basis, rest / np.linalg.norm(rest)])
                base.append(j)
        K = np.linalg.lstsq(Y[:, base], Y, rcond=None)[0]
        return tuple(base), np.where(np.abs(K) < DEPENDENT, 0.0, K)

    @cached_property
    def combinations(self) -> dict[str, str]:
        """Base parameters that stand for several unknowns, by name, as sums of these."""
        out = {}
        for row, j in zip(self.K, self.base, strict=True):
            terms = [(row[i], self.names[i]) for i in np.flatnonzero(row) if i != j]
            if terms:
                out[self.names[j]] = linear_text([(1.0, self.names[j]), *terms])
        return out

    @property
    def without_effect(self) -> tuple[str, ...]:
        """Unknowns that act on no torque in any motion."""
        return tuple(name for name, column in zip(self.names, self.K.T, strict=True) if not column.any())


def _transform(R: Float64Array, p: Float64Array) -> Float64Array:
    """(10, 10) from the parameters of a body in a frame at R, p to those in the frame around it."""
    bodies: list[RigidBody] = [body_of(unit).seen_from(R, p) for unit in np.eye(10)]
    return np.array([parameters_of(body) for body in bodies], dtype=np.float64).T


def linear_text(terms: Sequence[tuple[float, str]]) -> str:
    """A sum of named numbers in words: a - 0.5 b."""
    text = ""
    for factor, name in terms:
        size = "" if abs(abs(factor) - 1.0) < 1e-9 else f"{abs(factor):.3g} "
        sign = ("-" if factor < 0.0 else "") if not text else (" - " if factor < 0.0 else " + ")
        text += f"{sign}{size}{name}"
    return text
