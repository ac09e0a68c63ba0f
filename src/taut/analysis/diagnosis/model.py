"""The model that a controller had, and one least-squares fit of the torque beyond it: gravity, payload, friction."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Final, Literal

import numpy as np
from scipy.optimize import least_squares, lsq_linear

from taut.analysis.identification.regression import ArmRegression
from taut.arm.description import Arm
from taut.base.types import Array, Float64Array
from taut.codegen.program import over_rows
from taut.maths import dynamics as dyn
from taut.maths.model import Chain, PayloadValues, model_of
from taut.record.metrics import MOVING
from taut.record.run import Run

FIT_TICKS: Final = 600  # that a fit looks at, evenly spread
MIN_MOTION: Final = 0.05  # of the ticks: fewer in motion do not show friction
MIN_MOVING_TICKS: Final = 32
PAYLOAD: Final = {"mass": slice(0, 1), "com": slice(1, 4), "inertia": slice(4, 10)}  # columns
INDEPENDENT_TICKS: Final = (
    100.0  # neighbouring ticks of a run are much alike: it counts as so many in standard errors
)
TINY: Final = float(np.finfo(np.float64).tiny)
CENTRE_WEIGHT: Final = 0.01  # of the prior, which only keeps an unobservable centre of mass at the tool


@functools.lru_cache(maxsize=16)
def _torques_of(arm: Arm) -> Callable[..., dict[str, Float64Array]]:
    """M a + C v + g of an arm with a payload, over many rows."""
    model, n = model_of(arm), arm.n

    def torques(q: Any, v: Any, a: Any, mass: Any, com: Any, inertia: Any) -> dict[str, Any]:
        load = PayloadValues(mass=mass, com=com, inertia=inertia)
        return {"tau": dyn.inverse_dynamics(model, q, v, a, load)}

    return over_rows(torques, q=n, v=n, a=n, mass=(), com=3, inertia=6)


def external_torque(run: Run, tool: Chain | None) -> Float64Array:
    """(k, n) J^T F_ext of the measured wrench; zeros where none was measured."""
    if "F_ext" not in run.extra or tool is None:
        return np.zeros_like(run.q)
    return np.asarray(np.einsum("kij,ki->kj", tool.jacobians(run.q), run.extra["F_ext"]))


def stretched_length(tool: Chain) -> float:
    """[m] from the first joint to the tool, were the arm stretched."""
    return float(sum(np.linalg.norm(p) for p in [*(link.p for link in tool.links[1:]), tool.p]))


@dataclass(frozen=True, kw_only=True, eq=False)
class ArmModel:
    """The arm that the controller assumed, with the payload that was declared to it, along a run."""

    run: Run
    arm: Arm

    @cached_property
    def payloads(self) -> Float64Array:
        """(k, 10) mass [kg], centre [m] and inertia [kg m^2] declared to the law at every tick, by the log."""
        out = np.zeros((len(self.run), 10))
        sets: list[tuple[float, Mapping[str, Any]]] = [(-np.inf, self.run.info.parameters)]
        sets += [(event.t, event.set) for event in self.run.info.events]
        for t, values in sorted(sets, key=lambda pair: pair[0]):
            for name, columns in PAYLOAD.items():
                if f"model.payload.{name}" in values:
                    out[self.run.t >= t - 0.5 / self.run.rate, columns] = values[f"model.payload.{name}"]
        return out

    @property
    def payload(self) -> tuple[float, Float64Array]:
        """Mass [kg] and centre (3,) [m] declared to the law at the end."""
        return float(self.payloads[-1, 0]), self.payloads[-1, 1:4]

    @cached_property
    def ticks(self) -> np.ndarray[Any, np.dtype[np.intp]]:
        """The ticks that fits look at: all but the last, or some of them evenly spread."""
        count = len(self.run) - 1
        return np.unique(np.linspace(0, count - 1, min(count, FIT_TICKS)).round().astype(np.intp))

    def _torques(self, factor: float) -> Float64Array:
        """(ticks, n) torques with the declared payload, with velocities and accelerations times a factor."""
        payload, v, a = self.payloads[self.ticks], self.run.v[self.ticks], self.acceleration
        load = {name: payload[:, columns] for name, columns in PAYLOAD.items()}
        return _torques_of(self.arm)(q=self.run.q[self.ticks], v=factor * v, a=factor * a, **load)["tau"]

    @cached_property
    def acceleration(self) -> Float64Array:
        """(ticks, n) mean acceleration of the period behind each tick."""
        k = self.ticks
        period = (self.run.t[k + 1] - self.run.t[k])[:, np.newaxis]
        return np.asarray((self.run.v[k + 1] - self.run.v[k]) / period)

    @cached_property
    def gravity(self) -> Float64Array:
        """(ticks, n) g with the declared payload."""
        return self._torques(0.0)

    @cached_property
    def motion(self) -> Float64Array:
        """(ticks, n) M a + C v + g with the declared payload."""
        return self._torques(1.0)

    @cached_property
    def residual(self) -> Float64Array:
        """(ticks, n) tau + J^T F_ext - (M a + C v + g): what acted beyond what the model needs for the motion."""
        return np.asarray(self.run.tau[self.ticks] + external_torque(self.run, self.tool)[self.ticks] - self.motion)

    @cached_property
    def payload_columns(self) -> Float64Array:
        """(ticks, n, 10) torque of a payload by what it is linear in: its mass, moment and inertia at the tool."""
        if not self.tool.links:
            return np.zeros((*self.acceleration.shape, 10))
        state = self.run.q[self.ticks], self.run.v[self.ticks], self.acceleration
        return ArmRegression(self.arm, ("payload",)).columns(*state)[0]

    @cached_property
    def tool(self) -> Chain:
        """The arm's tool, at which F_ext is measured."""
        return Chain.of(model_of(self.arm), None)


@dataclass(frozen=True, kw_only=True, eq=False)
class Fit:
    """The torque beyond the model, explained by friction and at most one load."""

    kind: Literal["none", "gravity", "payload"]  # the load
    load: Float64Array  # (ticks, n) its torque [N m | N]
    explained: float  # 0 to 1: of what friction alone leaves, in squares
    unexplained: float  # 0 to 1: of the torque beyond the model, in squares
    viscous: Float64Array  # (n,) [N m s/rad | N s/m]
    coulomb: Float64Array  # (n,) [N m | N]; 0 of joints without motion
    moved: Array  # (n,) joints that moved enough to show their friction
    gravity: float = 0.0  # fraction that something else compensates
    mass: float = 0.0  # [kg] of the whole payload, never negative
    centre: Float64Array = field(default_factory=lambda: np.zeros(3))  # [m] its centre of mass in the tool frame
    covariance: Float64Array = field(default_factory=lambda: np.zeros((4, 4)))  # of mass [kg] and centre of mass [m]


def fit_residual(model: ArmModel, scale: Float64Array, threshold: Mapping[str, float]) -> Fit:
    """Explain the torque beyond the model by friction and, where friction does not suffice, by one load.

    Law:  residual = b v + c sign(v) + load,  load = -alpha g  or  Y(q, v, a) (pi(m, r) - pi_declared)

    with b, c >= 0 for each joint, and the inertial parameters pi of a point mass m >= 0 at r in the tool frame.
    Gravity is tried first: it has one parameter. Only moving joints count, because dry friction at rest may take any
    value up to its limit; if too little moves, all do, without dry friction. A payload whose centre of mass is far
    from the tool is none: another link is heavier. `scale` (n,) is what each joint's torques are compared with.
    """
    v, v_next = model.run.v[model.ticks], model.run.v[model.ticks + 1]
    moving = (np.minimum(np.abs(v), np.abs(v_next)) > MOVING) & (v * v_next > 0.0)  # throughout the period
    moving &= moving.sum(axis=0) >= MIN_MOVING_TICKS / 4
    everywhere = np.ones_like(moving)
    if not len(moving) or moving.any(axis=1).mean() < MIN_MOTION:
        return _fit(model, scale, threshold, everywhere, False)
    fit = _fit(model, scale, threshold, moving, True)
    uncertain = abs(fit.mass - model.payload[0]) <= 3.0 * math.sqrt(max(float(fit.covariance[0, 0]), 0.0))
    return _fit(model, scale, threshold, everywhere, False) if fit.kind == "payload" and uncertain else fit


def _fit(model: ArmModel, scale: Float64Array, threshold: Mapping[str, float], used: Array, in_motion: bool) -> Fit:
    """The fit to the ticks and joints that are used."""
    n, v_next = model.run.n, model.run.v[model.ticks + 1]

    def rows(columns: Float64Array) -> Float64Array:
        return np.asarray((columns / scale[:, np.newaxis])[used])

    # Both kinds of friction act against the velocity at the end of the period, as in the plants.
    dry = np.sign(v_next) * (used & in_motion)
    by_joint = [np.einsum("ki,ij->kij", x, np.eye(n)) for x in (v_next, dry)]
    friction, d = rows(np.concatenate(by_joint, axis=2)), np.asarray((model.residual / scale)[used])
    floor = threshold["model accuracy"] * float(np.abs(model.gravity / scale).max()) + TINY
    alone = _bounded(d, friction, np.zeros(2 * n))
    before, whole = float(np.sum((d - friction @ alone) ** 2)), float(np.sum(d**2))

    def made(
        kind: Literal["none", "gravity", "payload"], load: Float64Array, by: Float64Array, **numbers: Any
    ) -> Fit:
        after = float(np.sum((d - rows(load[:, :, np.newaxis])[:, 0] - friction @ by) ** 2))
        return Fit(
            kind=kind,
            load=load,
            explained=1.0 - after / before if before > 0.0 else 0.0,
            unexplained=after / whole if whole > 0.0 else 0.0,
            viscous=by[:n],
            coulomb=by[n:],
            moved=np.asarray(used.any(axis=0) & in_motion),
            **numbers,
        )

    by_friction = made("none", np.zeros_like(model.residual), alone)
    if not np.any(model.arm.gravity) or (in_motion and before <= floor**2 * len(d)):
        return by_friction
    columns = np.concatenate([rows(-model.gravity[:, :, np.newaxis]), friction], axis=1)
    values = _bounded(d, columns, np.array([-math.inf, *np.zeros(2 * n)]))
    fit = made("gravity", -values[0] * model.gravity, values[1:], gravity=float(values[0]))
    if fit.explained >= threshold["explained by the load"] and abs(fit.gravity - 1.0) <= 0.25:
        return fit
    reach = threshold["centre of mass"] * stretched_length(model.tool)
    p, covariance = _payload(model, rows(model.payload_columns), friction, d, floor, reach)
    beyond = _point_mass(p[0], p[1:4]) - _point_mass(*model.payload)
    load = model.payload_columns @ beyond
    fit = made("payload", load, p[4:], mass=float(p[0]), centre=p[1:4], covariance=covariance)
    near = float(np.linalg.norm(fit.centre)) <= reach
    return fit if near and fit.explained >= threshold["explained by the load"] else by_friction


def _payload(
    model: ArmModel, Y: Float64Array, friction: Float64Array, d: Float64Array, floor: float, reach: float
) -> tuple[Float64Array, Float64Array]:
    """(4 + 2 n,) mass, centre of mass and friction that explain d best, and the covariance (4, 4) of the first four.

    A weak prior, the reach its standard deviation, keeps a centre of mass that the run does not show at the tool.
    Standard errors are those of a model that is as accurate as its threshold says.
    """
    Q, R = np.linalg.qr(np.concatenate([Y, friction], axis=1))  # the same problem in as many rows as parameters
    y, (mass, centre) = Q.T @ d, model.payload
    declared, low = _point_mass(mass, centre), np.array([-mass, *np.full(3, -math.inf), *np.zeros(friction.shape[1])])
    linear = _bounded(d, np.concatenate([Y[:, :4], friction], axis=1), low)
    moment = mass * centre + linear[1:4]
    guess = max(mass + linear[0], float(np.linalg.norm(moment)) / reach, 0.0)
    sigma = floor * math.sqrt(len(d) / INDEPENDENT_TICKS)
    weight = np.concatenate([np.zeros((3, 1)), np.eye(3), np.zeros((3, friction.shape[1]))], axis=1) * sigma / reach

    def rest(p: Float64Array) -> Float64Array:
        fitted = R[:, :10] @ (_point_mass(p[0], p[1:4]) - declared) + R[:, 10:] @ p[4:]
        return np.concatenate([fitted - y, CENTRE_WEIGHT * weight @ p])

    low[0] = 0.0
    start = np.maximum(np.concatenate([[guess], moment / guess if guess > 0.0 else centre, linear[4:]]), low)
    found = least_squares(rest, start, bounds=(low, np.inf), x_scale="jac", xtol=1e-12)
    J = np.concatenate([found.jac[: len(y)], weight])
    noise = float(np.sum(rest(found.x) ** 2)) / INDEPENDENT_TICKS + sigma**2
    size = np.linalg.norm(J, axis=0)
    size = np.where(size > 0.0, size, 1.0)
    covariance = noise * np.linalg.pinv((J / size).T @ (J / size), hermitian=True) / np.outer(size, size)
    return found.x, np.asarray(covariance[:4, :4])


def _point_mass(mass: Any, centre: Float64Array) -> Float64Array:
    """(10,) mass, first moment and inertia xx, yy, zz, xy, xz, yz about the tool frame."""
    x, y, z = centre
    squares = [y * y + z * z, x * x + z * z, x * x + y * y, -x * y, -x * z, -y * z]
    return np.asarray(mass * np.array([1.0, x, y, z, *squares]))


def _bounded(d: Float64Array, X: Float64Array, low: Float64Array) -> Float64Array:
    """Least squares with lower bounds; zero where the rows do not depend on a parameter."""
    size = np.linalg.norm(X, axis=0)
    seen, out = size > 0.0, np.zeros(X.shape[1])
    if seen.any():
        Q, R = np.linalg.qr(X[:, seen] / size[seen])
        found = lsq_linear(R, Q.T @ d, bounds=(low[seen] * size[seen], np.inf), method="bvls")
        out[seen] = found.x / size[seen]
    return out
