"""What the torques of a run hold beyond its model: friction, gravity that somebody else gives, or a payload."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from scipy.optimize import least_squares, lsq_linear

from taut.analysis.diagnosis.model import ENOUGH, ArmModel
from taut.base.types import Array, Float64Array
from taut.record.metrics import MOVING

__all__ = ["KNOWN", "Fit", "fit_of"]

MOST: Final = 0.98  # of what friction leaves of the residual, in squares, that a load has to explain: all but 2 %
MOST_OF_FOUR: Final = 0.995  # of a payload with a centre, whose four numbers come near to a heavier link too
FLOOR: Final = 0.01  # of the largest gravity torque: what a model is not asked to explain
REACH: Final = 0.25  # of the arm's length: how far from the tool a payload may have its centre
KNOWN: Final = 0.02  # [m] standard error of a payload's centre, beyond which a run does not tell it
INDEPENDENT: Final = 100.0  # ticks of a run, neighbours of which are much alike, count as so many
HALF: Final = 0.5  # of what one mass leaves, that a second one has to explain
FEWEST: Final = 16  # ticks of a part of a run
FEWEST_MOVING: Final = 8  # ticks of a joint in motion: fewer cannot distinguish viscous from dry friction
SURE: Final = 3.0  # standard errors of what a payload has beyond the declared one
TINY: Final = 1e-12  # [kg] a mass that is none
WEAK: Final = 0.01  # of what is known of a centre before the run: it only holds what nothing else does
FRICTION: Final = ("viscous", "coulomb")


@dataclass(frozen=True, kw_only=True, eq=False)
class Fit:
    """What the torques of a run hold beyond the model, by the hypothesis that explains them with fewest numbers."""

    kind: str  # "none", "friction", "gravity" or "payload"
    load: Float64Array  # (k, n) the torque of it beyond friction, at the ticks that were looked at
    explained: float  # 0 to 1: of what friction leaves, in squares
    holds: bool  # whether that is as much as a load has to explain
    left: float  # 0 to 1: of the residual, what nothing explains
    gravity: float  # part of g that somebody else gives
    mass: float  # [kg] of the whole payload, the declared one in it; never negative
    mass_error: float  # [kg] its standard error
    centre: Float64Array  # (3,) [m] of the whole payload, in the tool frame
    centre_error: Float64Array  # (3, 3) [m^2] its covariance
    viscous: Float64Array  # (n,)
    coulomb: Float64Array  # (n,)
    seen: Array  # (n,) of which joints there was motion enough to show their friction
    told: float  # [kg] of the payload that the law was told
    taken: float | None = None  # [s] from when on a payload is there, where it was not before
    dropped: float | None = None  # [s] until when it is there, where it is not later


def fit_of(model: ArmModel, size: Float64Array) -> Fit:
    """What explains the residual of a run: friction, gravity that somebody else gives, a payload, or nothing.

    Each hypothesis is fitted by least squares, alone and with friction of each joint, b v + c sign(v) with b, c >= 0,
    to the joints that move; where next to nothing does, or too little to tell a payload's mass to a third, to all. A
    payload is a mass m >= 0 where the declared one is, or one with a centre c of its own: a point mass, of inertia
    -m S(c)^2 about the tool frame. The hypothesis with the least Bayesian information criterion is kept, in which
    what lies under 1 % of the largest gravity torque counts as noise; where friction alone leaves no more than that
    of joints in motion, no load is looked for, since one joint that moves one way cannot distinguish them. A payload
    whose centre is further from the tool than a quarter of the arm is none: that is a wrong arm.

    Where no load explains the whole run, one of a part of it is looked for, from the tick on, or up to it, that parts
    the run best into two with a mass each; in the other one the torques are those of the model.

    Args:
        model: The model that the run's controller had.
        size: (n,) what the torques of each joint are weighed with.
    """
    count = len(model.ticks)
    whole = _of_stretch(model, size, slice(0, count))
    k, left = _change(model, size)
    if k is None or (whole.holds and whole.kind in ("gravity", "payload") and left >= whole.left):
        return whole
    t = float(model.run.t[model.ticks[k]])
    square = np.sum((model.residual / size) ** 2, axis=1)
    for stretch, other in ((slice(k, count), slice(0, k)), (slice(0, k), slice(k, count))):
        if float(square[other].mean()) > (1.0 - MOST) * float(square[stretch].mean()):
            continue  # in one of its poses a heavier link is like a payload, but not now and then
        part = _of_stretch(model, size, stretch)
        sure = abs(part.mass - part.told) > SURE * part.mass_error
        if part.kind == "payload" and part.holds and sure:
            there = np.zeros((count, 1))
            there[stretch] = 1.0
            taken, dropped = (t, None) if stretch.start else (None, t)
            return dataclasses.replace(part, load=there * part.load, taken=taken, dropped=dropped)
    return whole


def _of_stretch(model: ArmModel, size: Float64Array, stretch: slice) -> Fit:
    """What explains the residual of some of the ticks."""
    there = np.zeros((len(model.ticks), 1), dtype=bool)
    there[stretch] = True
    v, after = model.run.v[model.ticks], model.run.v[model.ticks + 1]
    moving = (np.minimum(np.abs(v), np.abs(after)) > MOVING) & (v * after > 0.0) & there  # throughout the period
    moving &= np.sum(moving, axis=0) >= FEWEST_MOVING
    if moving[stretch].any(axis=1).mean() >= ENOUGH:
        found = _fitted(model, size, moving, moving)  # what dry friction holds says nothing of a load
        if found.kind != "payload" or abs(found.mass - found.told) > SURE * found.mass_error:
            return found
    return _fitted(model, size, moving, np.broadcast_to(there, moving.shape))


def _change(model: ArmModel, size: Float64Array) -> tuple[int | None, float]:
    """Where a mass at the tool changes, two masses explaining most of what one does not, and what part they leave."""
    column = (model.payload_columns @ _inertial(1.0, model.payload()[1])) / size
    d = model.residual / size
    a, b = np.cumsum(np.sum(column**2, axis=1)), np.cumsum(np.sum(column * d, axis=1))
    fewest = max(FEWEST, round(ENOUGH * len(d)))
    if len(d) < 2 * fewest or a[fewest - 1] <= 0.0 or a[-1] - a[-fewest] <= 0.0:
        return None, 1.0
    at = np.arange(fewest, len(d) - fewest)
    explained = b[at - 1] ** 2 / a[at - 1] + (b[-1] - b[at - 1]) ** 2 / (a[-1] - a[at - 1])
    k = int(np.argmax(explained))
    whole, one = float(np.sum(d**2)), float(b[-1] ** 2 / a[-1])
    if float(explained[k]) - one <= HALF * (whole - one) or whole <= 0.0:
        return None, 1.0
    return int(at[k]), 1.0 - float(explained[k]) / whole


def _fitted(model: ArmModel, size: Float64Array, moving: Any, used: Any) -> Fit:
    """The best hypothesis for the ticks and joints that are used; dry friction is one where they move."""
    v = model.run.v[model.ticks + 1]  # friction acts against the speed that a period ends with, in both plants
    problem = _Problem(model=model, size=size, used=used)
    friction = FRICTION if used is moving else FRICTION[:1]
    columns = {
        "gravity": -model.gravity[:, :, np.newaxis],
        "mass": (model.payload_columns @ _inertial(1.0, problem.told_centre))[:, :, np.newaxis],
        "viscous": np.einsum("ki,ij->kij", v, np.eye(model.run.n)),
        "coulomb": np.einsum("ki,ij->kij", np.sign(v) * moving, np.eye(model.run.n)),
    }
    without: list[tuple[str, ...]] = [(), friction]
    tried = [problem.solved(names, columns) for names in without]
    by_friction = used is moving and min(each.left for each in tried if each is not None) <= problem.floor**2
    if np.any(model.arm.gravity) and not by_friction:  # without it inertia alone tells of a load
        for load in ("gravity", "mass", "centre"):
            tried += [problem.solved(names, columns) for names in ((load,), (load, *friction))]
    return problem.told(min((each for each in tried if each is not None), key=lambda each: each.cost), columns)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Solved:
    """A hypothesis with its numbers."""

    names: tuple[str, ...]
    load: Float64Array  # (0,), (1,) or (4,): part of gravity, mass, or mass and centre
    friction: Float64Array
    left: float  # mean square of what it leaves, of torques over their sizes
    cost: float


@dataclass(frozen=True, kw_only=True, eq=False)
class _Problem:
    """The residual of a run, and what may explain it."""

    model: ArmModel
    size: Float64Array
    used: Any  # (k, n) the ticks and joints that are looked at

    @property
    def told_payload(self) -> tuple[Float64Array, Float64Array, Float64Array]:
        """What the law was told, in the last of the ticks that are looked at."""
        last = np.flatnonzero(self.used.any(axis=1))
        return self.model.payload(int(self.model.ticks[last[-1]]) if len(last) else -1)

    @property
    def told_mass(self) -> float:
        """[kg] that the law was told."""
        return float(self.told_payload[0])

    @property
    def told_centre(self) -> Float64Array:
        """(3,) [m]."""
        return self.told_payload[1]

    @property
    def d(self) -> Float64Array:
        """The residual as rows."""
        return np.asarray((self.model.residual / self.size)[self.used])

    @property
    def floor(self) -> float:
        """What counts as noise."""
        return FLOOR * float(np.abs(self.model.gravity / self.size).max()) + float(np.finfo(np.float64).tiny)

    def rows(self, column: Float64Array) -> Float64Array:
        """Columns (k, n, m) as (rows, m)."""
        return np.asarray((column / self.size[:, np.newaxis])[self.used])

    def solved(self, names: tuple[str, ...], columns: dict[str, Float64Array]) -> _Solved | None:
        """A hypothesis fitted; None where it is no payload of this arm."""
        d = self.d
        rubbing = [self.rows(columns[name]) for name in names if name in FRICTION]
        if "centre" in names:
            load, friction = self._with_centre(rubbing)
            if self._too_far(load, friction, rubbing):
                return None
            tau = self._payload_torque(load)
        else:
            loads = [self.rows(columns[name]) for name in names if name not in FRICTION]
            low = [-self.told_mass if "mass" in names else -math.inf] * len(loads)
            values = _bounded(d, [*loads, *rubbing], low)
            load, friction = values[: len(loads)], values[len(loads) :]
            tau = loads[0] @ load if loads else np.zeros_like(d)
        left = d - tau - (np.concatenate(rubbing, axis=1) @ friction if rubbing else 0.0)
        square = float(np.mean(left**2))
        used_up = len(load) + np.count_nonzero(friction > 0.0)
        cost = INDEPENDENT * math.log(square + self.floor**2) + used_up * math.log(INDEPENDENT)
        return _Solved(names=names, load=load, friction=friction, left=square, cost=cost)

    # ---------------------------------------------------------------- a payload with a centre

    def _beyond(self, load: Float64Array) -> Float64Array:
        """(10,) what a payload of mass and centre (4,) has beyond the declared one."""
        return _inertial(load[0], load[1:]) - _inertial(self.told_mass, self.told_centre)

    def _payload_torque(self, load: Float64Array) -> Float64Array:
        return np.asarray(self.rows(self.model.payload_columns) @ self._beyond(load))

    def _with_centre(self, rubbing: list[Float64Array]) -> tuple[Float64Array, Float64Array]:
        """Mass and centre of a point mass, and friction; a direction that nothing tells of stays at the tool."""
        X = np.concatenate([self.rows(self.model.payload_columns), *rubbing], axis=1)
        Q, R = np.linalg.qr(X)  # the same problem in as many rows as numbers
        d, count = Q.T @ self.d, X.shape[1] - 10
        start = _bounded(self.d, [X[:, :4], *rubbing], [-self.told_mass, *[-math.inf] * 3])
        mass = max(self.told_mass + start[0], 0.0)  # rounding may leave it just below
        moment = self.told_mass * self.told_centre + start[1:4]
        far = float(np.linalg.norm(moment)) / (REACH * self.model.length)  # [kg] that has it within reach
        centre = moment / max(mass, far) if max(mass, far) > TINY else self.told_centre
        hold = WEAK * self._prior_weight()

        def left(p: Float64Array) -> Float64Array:
            known = R[:, :10] @ self._beyond(p[:4]) + R[:, 10:] @ p[4:] - d
            return np.concatenate([known, hold * p[1:4]])

        low = np.concatenate([[0.0], np.full(3, -np.inf), np.zeros(count)])
        found = least_squares(
            left,
            np.maximum(np.concatenate([[mass], centre, start[4:]]), low),
            bounds=(low, np.inf),
            x_scale="jac",
            xtol=1e-12,
        )
        return found.x[:4], found.x[4:]

    def _prior_weight(self) -> float:
        """Of a centre that lies within reach: what is known of it before the run."""
        return self.floor * math.sqrt(len(self.d) / INDEPENDENT) / (REACH * self.model.length)

    def _too_far(self, load: Float64Array, friction: Float64Array, rubbing: list[Float64Array]) -> bool:
        """Whether the centre, as far as the run tells it, is out of reach; that of no mass is nowhere."""
        _, blur = self._blur(load, friction, rubbing)
        values, ways = np.linalg.eigh(blur)
        known = ways[:, values <= KNOWN**2]
        return bool(np.linalg.norm(known.T @ load[1:]) > REACH * self.model.length)

    def _blur(
        self, load: Float64Array, friction: Float64Array, rubbing: list[Float64Array]
    ) -> tuple[float, Float64Array]:
        """Standard error [kg] of a mass and covariance (3, 3) [m^2] of its centre, given together with friction."""
        X = self.rows(self.model.payload_columns)
        moves = np.column_stack([_inertial(1.0, load[1:]), *_by_centre(load).T])
        J = np.concatenate([X @ moves, *rubbing], axis=1)
        rest = self.d - self._payload_torque(load)
        if rubbing:
            rest = rest - np.concatenate(rubbing, axis=1) @ friction
        noise = (float(np.mean(rest**2)) + self.floor**2) * len(self.d) / INDEPENDENT
        before = np.zeros(J.shape[1])
        before[1:4] = 1.0 / (REACH * self.model.length) ** 2
        information = J.T @ J / noise + np.diag(before)
        scale = np.sqrt(np.diag(information))
        scale = np.where(scale > 0.0, scale, 1.0)
        blur = np.linalg.pinv(information / np.outer(scale, scale), hermitian=True) / np.outer(scale, scale)
        return math.sqrt(max(float(blur[0, 0]), 0.0)), np.asarray(blur[1:4, 1:4])

    # ---------------------------------------------------------------- what is told

    def told(self, best: _Solved, columns: dict[str, Float64Array]) -> Fit:
        """The numbers of the best hypothesis."""
        n, model = self.model.run.n, self.model
        load, rest = np.zeros_like(model.residual), model.residual
        payload, part = np.concatenate([[self.told_mass], self.told_centre]), 0.0
        if "gravity" in best.names:
            part, load = float(best.load[0]), columns["gravity"] @ best.load
        elif "mass" in best.names:
            payload[0] += best.load[0]
            load = columns["mass"] @ best.load
        elif "centre" in best.names:
            payload = best.load
            load = model.payload_columns @ self._beyond(payload)
        found, at = {"viscous": np.zeros(n), "coulomb": np.zeros(n)}, 0
        for name in best.names:
            if name in FRICTION:
                found[name] = best.friction[at : at + n]
                at += n
                rest = rest - columns[name] @ found[name]
        whole, before, after = (
            float(np.sum((x / self.size)[self.used] ** 2)) for x in (model.residual, rest, rest - load)
        )
        rubbing = [self.rows(columns[name]) for name in best.names if name in FRICTION]
        mass_error, blur = self._blur(payload, best.friction, rubbing)
        explained = 1.0 - after / before if before > 0.0 else 0.0
        kinds = {"gravity": "gravity", "mass": "payload", "centre": "payload", "viscous": "friction"}
        return Fit(
            kind=kinds[best.names[0]] if best.names else "none",
            load=load,
            explained=explained,
            holds=explained >= (MOST_OF_FOUR if "centre" in best.names else MOST),
            left=after / whole if whole > 0.0 else 0.0,
            gravity=part,
            mass=float(payload[0]),
            mass_error=mass_error,
            centre=payload[1:],
            centre_error=blur,
            viscous=found["viscous"],
            coulomb=found["coulomb"],
            seen=np.any(columns["coulomb"] != 0.0, axis=(0, 2)),
            told=self.told_mass,
        )


def _inertial(mass: Any, c: Float64Array) -> Float64Array:
    """(10,) mass, moment and inertia about the tool frame, xx, yy, zz, xy, xz, yz, of a point mass."""
    x, y, z = c
    squares = [y * y + z * z, x * x + z * z, x * x + y * y, -x * y, -x * z, -y * z]
    return np.asarray(mass * np.array([1.0, x, y, z, *squares]))


def _by_centre(load: Float64Array) -> Float64Array:
    """(10, 3) how they change with the centre."""
    m, (x, y, z) = load[0], load[1:]
    rows = [[0, 2 * y, 2 * z], [2 * x, 0, 2 * z], [2 * x, 2 * y, 0], [-y, -x, 0], [-z, 0, -x], [0, -z, -y]]
    return np.asarray(m * np.concatenate([np.zeros((1, 3)), np.eye(3), np.array(rows, dtype=np.float64)]))


def _bounded(d: Float64Array, columns: list[Float64Array], low: list[float]) -> Float64Array:
    """Least squares with lower bounds; what has none in `low` is friction, which does not drive.

    A number that the rows do not depend on, as the friction of a joint that never moved, is zero.
    """
    if not columns:
        return np.zeros(0)
    X = np.concatenate(columns, axis=1)
    least = np.array([*low, *[0.0] * (X.shape[1] - len(low))])
    scale = np.linalg.norm(X, axis=0)
    told, out = scale > 0.0, np.zeros(X.shape[1])
    if told.any():
        Q, R = np.linalg.qr(X[:, told] / scale[told])  # the same problem in as many rows as numbers
        bounds = (least[told] * scale[told], np.inf)
        out[told] = lsq_linear(R, Q.T @ d, bounds=bounds, method="bvls").x / scale[told]  # which reaches the bounds
    return out
