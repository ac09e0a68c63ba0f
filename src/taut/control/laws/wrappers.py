"""Wrappers of laws of the tool: an energy tank for changing gains, loss of contact, an estimated normal."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Mapping
from typing import Any, Final, Protocol, runtime_checkable

import numpy as np

from taut.base.errors import UsageError
from taut.base.fields import Part, Plain
from taut.base.types import Rotation, Vector, Vector3
from taut.control.closed_loop import ApparentImpedance
from taut.control.combine import Wrapper, all_laws, bare
from taut.control.command import Command, Terms, Torque
from taut.control.gains import Gain, GainValue, Memory, MemoryView
from taut.control.law import Law
from taut.control.laws.constraints import check_place, check_reference
from taut.control.laws.force import ForceControl
from taut.control.laws.hybrid import HybridMotionForce
from taut.control.laws.task_space import check_sensor
from taut.control.trajectories.reference import Reference
from taut.control.trajectories.task_reference import TaskMotion
from taut.maths.constraints.constraint import Constraint
from taut.maths.constraints.multipliers import Constrained
from taut.maths.constraints.rows import ConstraintRows
from taut.maths.snapshot import Snapshot
from taut.maths.spatial import rotated
from taut.trace import math as tm

NEVER: Final = 1e-24  # keeps a root from zero, where it has no slope
GENTLE: Final = 2.0  # [-] times the threshold of contact: force with which a surface that was lost is sought
BRAKING: Final = 0.02  # [s] in which motion against a surface that was lost is braked
OF_SPRINGS: Final = ("P", "D", "bound", "reach")  # terms of the springs and the damping of an impedance
PAID: Final = ("K", "D")  # gains whose change the tank pays for
OfPose = Callable[[Any], Any]


@runtime_checkable
class WithEnergy(Protocol):
    """A law that states its energy, such as `taut.laws.Impedance`: what an energy tank needs."""

    def energy(self, x: Snapshot, ref: Any) -> Any:
        """Energy that changes with the gains [J]."""

    def dissipation(self, x: Snapshot, ref: Any) -> Any:
        """Power that damping takes from the arm [W]."""


class EnergyTank(Wrapper):
    """Energy tank: changes of K and D of a law bring in no more energy than is stored for them.

    Law:          K_now' = K_now + s (K - K_now) dt / settle, with s <= 1 such that the energy E of the tank pays
                  E' = E + R - (U(K_now') - U(K_now)), within [0, capacity]; it starts full
                  R = U[k-1] - U[k] - tau[k-1] (q[k] - q[k-1]) of the last tick: what its springs lost and its held
                    torque of springs and damping, tau, did not give to the arm; within [0, max(dissipation, 0) dt]
    Closed loop:  that of the law with K_now; with coriolis="keep" and a reference at rest
                    H + U + E <= H_0 + U_0 + E_0 + int F_ext v, H the arm's energy, whatever K does
                  exact in a sampled loop while R >= 0 in each tick, that is while damping makes up for the hold

    What damping took from the arm fills the tank, up to `capacity`. In a run the energy is the column `law.energy`.
    Of a law with an apparent inertia D the damping counts as it is at the tick, and the bound is approximate.
    Limits that cut the torque are not in it.

    Args:
        law: A law with gains K or D that states `energy` and `dissipation`, such as `taut.laws.Impedance`.
        capacity: Energy stored for changes of K and D.
        settle: Time constant of such changes.
        stiffness: A function of the pose in the place of the law's K, such as a stiffness that differs by place.

    Example:
        >>> import taut
        >>> law = EnergyTank(law=taut.laws.Impedance(K=(800.0, 30.0), B=(60.0, 4.0)), capacity=0.5)
        >>> sorted(law.parameters())
        ['B', 'K', 'capacity', 'null.kd', 'null.kp', 'settle']

    References:
        Ferraguti, Secchi and Fantuzzi (2013), IEEE ICRA.
    """

    capacity: Gain = Gain(unit="J", shape="scalar")
    settle: Gain = Gain(0.1, unit="s", shape="scalar", above=0.0)
    stiffness: Plain[OfPose | None] = Plain(Callable, optional=True)  # type: ignore[arg-type]  # an abstract class
    energy = Memory(unit="J", record=True)
    now = Memory(doc="the gains that act, by name")
    last = Memory(doc="of the tick before: torque of springs and damping, q, energy of the springs, dissipation")

    def check(self) -> None:
        super().check()
        if not isinstance(self.law, WithEnergy) or not self._gains():
            self.refuse("law", "must have gains K or D and state its energy and dissipation, such as Impedance")

    def check_state(self, x: Snapshot, rate: float) -> None:  # noqa: ARG002
        """The result of a function of the pose is checked like numbers, where a run starts."""
        if self.stiffness is not None:
            self.law.changed("K", self._wanted(x)["K"])

    def apparent_impedance(self, x: Snapshot) -> ApparentImpedance | None:
        return None if self.stiffness is not None else super().apparent_impedance(x)

    def start(self, x: Snapshot, ref: Any) -> Mapping[str, Any]:  # noqa: ARG002
        last = {"torque": tm.zeros(x.n), "q": tm.array(x.q), "stored": 0.0, "dissipated": 0.0}
        return {"energy": self.capacity.as_array(), "now": self._wanted(x), "last": last}

    def command(self, x: Snapshot, ref: Any, memory: MemoryView, dt: float) -> tuple[Command, dict[str, Any]]:
        before = memory["now"]
        fraction = dt / tm.maximum(self.settle.as_array(), dt)
        step = {name: (gain - before[name]) * fraction for name, gain in self._wanted(x).items()}
        cost = self.law.bound(step).energy(x, ref)  # energy is linear in the gains
        stored = self.law.bound(before).energy(x, ref)
        energy = memory.energy + self._returned(x, memory["last"], stored)
        short = cost > energy
        paid = tm.where(short, energy / tm.where(short, cost, 1.0), 1.0)
        now = {name: before[name] + paid * change for name, change in step.items()}
        law = self.law.bound(now)
        command, after = self.inner(law, x, ref, memory, dt)
        parts = command.terms.parts
        last = {
            "torque": sum((parts[name] for name in OF_SPRINGS if name in parts), start=tm.zeros(x.n)),
            "q": tm.array(x.q),
            "stored": stored + paid * cost,
            "dissipated": tm.maximum(law.dissipation(x, ref), 0.0) * dt,
        }
        energy = tm.clip(energy - paid * cost, 0.0, self.capacity.as_array())
        return command, {**after, "energy": energy, "now": now, "last": last}

    def _returned(self, x: Snapshot, last: Any, stored: Any) -> Any:
        """What the law kept of the arm's and the springs' energy in the last tick."""
        if "D" in self._gains():
            return last["dissipated"]
        given = last["torque"] @ -x.difference(last["q"])
        return tm.clip(last["stored"] - stored - given, 0.0, last["dissipated"])

    def _gains(self) -> dict[str, Any]:
        """The gains whose change the tank pays for."""
        return {name: gain.as_array() for name, gain in self.law.gains().items() if name in PAID}

    def _wanted(self, x: Snapshot) -> dict[str, Any]:
        """Desired values of these gains at a pose."""
        gains = self._gains()
        if self.stiffness is not None:
            gains["K"] = _six(self.stiffness(x.T(self.law.controlled_frame)), self.law.dimensions)
        return gains


def _six(value: Any, size: int) -> Any:
    """What a function of the pose gives as a gain: a pair, one per direction, or a matrix."""
    array = tm.array(value) if not isinstance(value, np.ndarray) else value
    pair = size == 6 and array.shape == (2,)
    return tm.array([array[0]] * 3 + [array[1]] * 3) if pair else array


class NormalEstimate(Wrapper):
    """Estimate of the normal of a surface from force and motion, around a `HybridMotionForce`, which then follows it.

    Law:          n_hat = (n_0 + tilt) / |n_0 + tilt|, with the stated normal n_0 and tilt at right angles to it
                  tilt-dot = rate w (seen - tilt)
                    seen = g / (n_0 . g) - n_0,  g = F_ext - (F_ext . s) s,  s = v / |v|
                    v is the velocity of the tool over the surface
                    w = 1 where the tool slides and presses, 0 below `speed` or `force` and beyond the angle `most`
    Closed loop:  tilt - tilt_true falls as exp(-rate integral(w dt)), whatever the arm does, since
                    `seen` does not depend on the estimate. 15 degrees become 1 in 2.8 / rate of sliding, 0.34 s at
                    rate = 8
                  The contact gives N n - mu N s with an unknown mu. A sliding tool moves in the surface, n . s = 0,
                    so g = N n: friction is in F_ext and not in g, and one direction of sliding shows both tilts, that
                    across it by the force, that along it by the motion alone
                  White noise of d_F and d_v in each tick leaves sqrt(rate dt / 2) (d_F / N, d_v / |v|) rad across and
                    along the motion; a constant force that is no contact's, such as a bias, leaves its share of N
                  n_hat rotates by less than 2 rate tan(most) a second, and not at all while the tool rests or is free

    What is estimated is a rotation of the whole constraint about where the tool touches: rows of a face turn with it,
    and a curved surface keeps its stated curvature. Where a curved surface is displaced from the stated one the tilt
    changes along the path, at a rate w_n, and the estimate lags by w_n / rate.

    Frames:
        World axes. Of the motion of a surface the part along n_0 is taken into account; a surface that moves in its
        own plane drags the tool by friction, which the estimate does not know.

    Args:
        law: The hybrid law, with its stated constraint.
        rate: Of the estimate.
        speed: Sliding speed below which the measurement is ignored; it counts in full from twice that on.
        force: Contact force, likewise.
        most: Largest angle between the stated and the true normal; used in full up to half its tangent.

    Example:
        >>> import taut
        >>> hybrid = taut.laws.HybridMotionForce(
        ...     constraint=taut.Constraint.plane(point=[0, 0, 0.1], normal=[0, 0, 1]),
        ...     motion=taut.laws.TaskComputedTorque(kp=100.0, kd=20.0),
        ...     kfi=5.0,
        ... )
        >>> sorted(NormalEstimate(law=hybrid, rate=8.0).parameters())[:4]
        ['force', 'kfi', 'most', 'motion.kd']

    References:
        Section 10.4.2 hybrid motion-force control, what to do about wrong constraints. Yoshikawa and Sudou (1993),
        IEEE Transactions on Robotics and Automation 9 (2), normals from force and motion.
    """

    law: Part[HybridMotionForce] = Part(HybridMotionForce, inline=True)
    rate: Gain = Gain(8.0, unit="1/s", shape="scalar")
    speed: Gain = Gain(0.02, unit="m/s", shape="scalar", above=0.0)
    force: Gain = Gain(1.0, unit="N", shape="scalar", above=0.0)
    most: Gain = Gain(0.6, unit="rad", shape="scalar", above=0.0, maximum=1.2)
    tilt = Memory((0.0, 0.0, 0.0), unit="1", doc="tangent of the angle, across the stated normal")
    normal = Memory((0.0, 0.0, 0.0), unit="1", record=True, doc="n_hat, world axes")

    def check(self) -> None:
        super().check()
        if self.law.constraint.frame is None or self.law.motion.reference is not TaskMotion:
            self.refuse("law", "must have a constraint of one frame, and a motion that follows a TaskMotion")

    def check_state(self, x: Snapshot, rate: float) -> None:  # noqa: ARG002
        constraint, moved = self.law.constraint, self.law.motion.controlled_frame or x.arm.tool
        (frame,) = constraint.frame or (None,)
        check_sensor(x, frame)
        if (frame or x.arm.tool) != moved or constraint.moments[0] or constraint.pieces[0].pfaffian:
            raise UsageError(
                f"NormalEstimate needs a surface of the frame that moves, '{moved}', as the first constraint; put it "
                "first, or leave the estimate out",
                name="NormalEstimate",
            )

    def check_references(self, x: Snapshot, ref: Reference, rate: float) -> None:  # noqa: ARG002
        """Not the motion: it goes along the surface that is estimated, whatever it asks for against it."""
        check_place(self.law.constraint, x, self.law.tolerance)
        check_reference(self.law.constraint, x, ref, self.law.motion.controlled_frame, np.inf)

    def command(self, x: Snapshot, ref: Any, memory: MemoryView, dt: float) -> tuple[Command, dict[str, Any]]:
        n_0, phi_t = self._stated(x)
        V = x.twist(*(self.law.constraint.frame or ()))
        sliding = V[:3] + (n_0[3:] @ V[3:] + phi_t) * n_0[:3]
        tilt = self.updated(memory.tilt, n_0[:3], sliding, x.F_ext[:3], dt)
        n = n_0[:3] + tilt
        n = n / tm.sqrt(n @ n + NEVER)
        inner = {name: memory[name] for name in memory if name not in self.memories}
        tau, after = self.law.controlled(x, ref, MemoryView(inner, "HybridMotionForce"), dt, self.turned(x, n))
        return tau, {**after, "tilt": tilt, "normal": n}

    def _stated(self, x: Snapshot) -> tuple[Vector, Any]:
        """(6,) the stated first row and the rate of its phi, for a normal of length 1."""
        rows = self.law.constraint.at(x)
        assert rows.A is not None
        size = tm.sqrt(rows.A[0, :3] @ rows.A[0, :3] + NEVER)
        return rows.A[0] / size, rows.phi_t[0] / size

    def turned(self, x: Snapshot, n: Vector3) -> ConstraintRows:
        """The rows of the constraint rotated about where the tool touches, so that its normal is n."""
        return turned_rows(self.law.constraint, x, turn_between(self._stated(x)[0][:3], n))

    def updated(self, tilt: Vector3, n_0: Vector3, v: Vector3, F: Vector3, dt: Any) -> Vector3:
        """Tilt (3,) after a tick, from the stated normal n_0, v over the surface [m/s], F on the tool [N]."""
        flat = _across(n_0, v)
        speed = tm.sqrt(flat @ flat + NEVER)
        g = F - v * ((v @ F) / (v @ v + NEVER))
        N = n_0 @ g
        seen = _across(n_0, g) / tm.maximum(N, self.force[()])
        # A tool that comes or goes is among what is too steep: g . v = 0, so |seen| >= |n_0 . v| / speed.
        steep = _within(tm.sqrt(seen @ seen + NEVER), tm.tan(self.most[()]))
        w = _above(speed, self.speed) * _above(N, self.force) * steep
        old = _across(n_0, tilt)
        out: Vector3 = old + (1.0 - tm.exp(-self.rate[()] * w * dt)) * (seen - old)
        return out


def check_streamed(law: Law, x: Snapshot, ref: Reference) -> None:
    """Check a recorded reference of hybrid laws, at the poses that it states. Raises RangeError, UsageError."""
    held = [inner for _, inner in all_laws(law)]
    estimated = any(isinstance(inner, NormalEstimate) for inner in held)
    for inner in held:
        if isinstance(inner, HybridMotionForce):
            tolerance = np.inf if estimated else inner.tolerance
            check_reference(inner.constraint, x, ref, inner.motion.controlled_frame, tolerance)


def _across(n: Vector3, v: Vector3) -> Vector3:
    out: Vector3 = v - (n @ v) * n
    return out


def _above(value: Any, least: GainValue) -> Any:
    """0 below `least`, 1 from twice that on."""
    return tm.clip(value / least[()] - 1.0, 0.0, 1.0)


def _within(tangent: Any, steepest: Any) -> Any:
    """1 up to half of the steepest, 0 beyond it."""
    return tm.clip(2.0 - 2.0 * tangent / steepest, 0.0, 1.0)


def turn_between(n_0: Vector3, n: Vector3) -> Rotation:
    """(3, 3) the smallest rotation that takes one unit vector to another, less than a half turn away."""
    w = tm.cross(n_0, n)
    W = tm.skew(w)
    out: Rotation = tm.eye(3) + W + (W @ W) / (1.0 + n_0 @ n)
    return out


def turned_rows(constraint: Constraint, x: Snapshot, R: Rotation) -> ConstraintRows:
    """Rows of a constraint of one frame whose surface is turned by R about where the frame is."""
    assert constraint.frame is not None
    (frame,) = constraint.frame
    seen = constraint.at(x.turned(R, frame))
    assert seen.A is not None
    return dataclasses.replace(seen, A=tm.array([rotated(R, row) for row in seen.A]))


class LossOfContact(Wrapper):
    """Loss of contact of a law of force: it is reported, and a hybrid law lets the force go and brakes.

    Law:          contact is missing where more than `contact` is asked for and less is measured along it, and lost
                    when it has been missing for longer than `patience`
                  of a one-sided row of a hybrid law: lam' = lam_0 + s (lam - lam_0), lam_0 = max(lam, -2 contact),
                    and the rate y against the row is braked by (1 - s) y / 0.02 s: the term `lost`
                    s goes to 0 within the patience while contact is missing, and back to 1; the integral rests
    Closed loop:  that of the law, in contact; without, a tool that seeks a surface at no more than 2 `contact`

    In a run `law.lost` is a column, 1 where contact is lost, of which the metric contact_lost_time is the time.
    A `ForceControl` is only watched: its kdamp bounds the speed.

    Args:
        law: A `ForceControl` or a `HybridMotionForce` that feeds a measured force back, or a `NormalEstimate` of it.
        contact: (force, moment) that count as contact.
        patience: Time without it after which contact is lost.

    Example:
        >>> import taut
        >>> law = LossOfContact(law=taut.laws.ForceControl(kfi=5.0, kdamp=(100.0, 5.0)), patience=0.02)
        >>> law.parameters()["patience"]
        array(0.02)
    """

    law: Part[Any] = Part(ForceControl, HybridMotionForce, NormalEstimate, inline=True)
    contact: Gain = Gain((1.0, 0.1), unit="N, N m", shape=2, accepts=("pair",), above=0.0)
    patience: Gain = Gain(0.05, unit="s", shape="scalar")
    alone = Memory(unit="s", doc="time since there was contact")
    lost = Memory(notice="the tool met less than was asked for, contact was lost")
    applied = Memory(1.0, doc="fraction s of the force of each row")

    def check(self) -> None:
        super().check()
        law: Any = bare(self.law)
        if not law.measures:
            self.refuse("law", "must feed a measured force back, with which contact is seen")

    def command(self, x: Snapshot, ref: Any, memory: MemoryView, dt: float) -> tuple[Command, dict[str, Any]]:
        command, after = self.inner(self.law, x, ref, memory, dt)
        law: Any = bare(self.law)
        patience = self.patience.as_array()
        missing = law.missing(x, ref, self.contact)
        alone = tm.where(functools.reduce(tm.maximum, missing) > 0.5, memory.alone + dt, 0.0)
        after |= {"alone": alone, "lost": tm.where(alone > patience + 0.5 * dt, 1.0, 0.0), "applied": memory.applied}
        if isinstance(law, HybridMotionForce):
            step, s = dt / tm.maximum(patience, dt), memory.applied + tm.zeros(len(missing))
            after["applied"] = tm.clip(s + tm.where(missing > 0.5, -step, step), 0.0, 1.0)
            after["e_int"] = tm.where(missing > 0.5, memory.e_int, after["e_int"])
            estimate = self.law if isinstance(self.law, NormalEstimate) else None
            rows = estimate.turned(x, after["normal"]) if estimate else law.constraint.at(x)
            held = Constrained.of(rows, x.M_factors)
            softer = (s - 1.0) * (after["lam"] - self._gentle(law.constraint, after["lam"]))
            braked = rows.rate(x.v) * np.array(rows.one_sided, dtype=np.float64) / (BRAKING + dt)
            braking = held.of_bias((s - 1.0) * braked)
            after["lam"] = after["lam"] + softer + braking
            command = Torque(command.terms + Terms(lost=held.pressing(softer + braking)))
        return command, after

    def _gentle(self, constraint: Constraint, lam: Vector) -> Vector:
        """(k,) the multipliers with which a one-sided row is still sought when it is lost."""
        least = -GENTLE * np.where(constraint.moments, self.contact[1], self.contact[0])
        out: Vector = tm.where(np.array(constraint.one_sided), tm.maximum(lam, least), lam)
        return out
