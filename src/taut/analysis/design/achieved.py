"""Achieved figures of the sampled loop of a law at a pose, in each direction, and its limits."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from taut.analysis.design.specification import Specification, per_coordinate, square
from taut.base.errors import UsageError
from taut.base.types import Float64Array
from taut.control.closed_loop import ClosedLoop
from taut.control.law import Law
from taut.control.trajectories.force_reference import TaskForce
from taut.control.trajectories.reference import JointMotion
from taut.linear.linear_system import LinearSystem
from taut.linear.performance import common_delay
from taut.loop import Loop
from taut.maths.model import Adds
from taut.maths.snapshot import Snapshot, snapshot
from taut.plant.rigid import RigidPlant

TOLERANCE: Final = 0.05  # [-] of a figure that was asked for: within it the figure is met
STATIC: Final = 0.01  # [-] likewise of a stiffness
OVERSHOOT: Final = 1.0  # [%] of the step that an overshoot may differ besides
BAND: Final = 0.02  # [-] of a step: the settling band; a mode with a smaller part in a step is not seen in it
SMALL_PART: Final = 1e-4  # [-] of a step: a mode with a smaller part is not one of its two poles
SAME_POLE: Final = 0.02  # [-] of a pole: nearer ones are one, set apart by rounding where several directions have it
REAL: Final = 1e-5  # [-] of a pole: a smaller imaginary part is rounding
STEP_TIME_CONSTANTS: Final = 8.0  # of the slowest mode that is seen in a step, for which it is followed
MIN_TICKS, MAX_TICKS = 50, 40_000  # of a step
NO_COMMAND: Final = 1e-9  # [-] of the largest command of a step: rounding
RANK: Final = 1e-9  # [-] of the largest singular value, or of a step: less is rounding
INSTANT: Final = 1e-6  # [-] modulus in z of a mode that is over within a period
ROUNDING: Final = 1e-9  # [-] of the imaginary part of a pole in z: that of a real one
DROOP: Final = 1e-9  # [rad | m] of a steady-state error: rounding
SHOWN: Final = ("zeta", "overshoot", "omega_n", "settling")  # requirements that a step has in each direction


@dataclass(frozen=True, kw_only=True)
class Requirement:
    """One number that was asked for, in one direction.

    Args:
        name: As in the specification: "zeta", "overshoot", "omega_n", "settling", "K" or "force".
        direction: The joint, the axis of the tool, or the row of a constraint.
        unit: Of both numbers.
        asked: The number that was asked for.
        got: Of the linear model of the sampled loop; NaN if unstable, infinite for a step that does not settle.
        met: Whether it is within 5 %, a stiffness within 1 %; a settling time or an overshoot may be less, an
            overshoot 1 % of the step more.
    """

    name: str
    direction: str
    unit: str
    asked: float
    got: float
    met: bool


@dataclass(frozen=True, kw_only=True)
class Limit:
    """One limit of a loop with the gains that were found."""

    name: str  # "largest step", "delay margin", "gain margin", "droop" or "largest factor"
    value: float  # infinite for none
    unit: str
    where: str  # the direction, joint or gain that it is about


@dataclass(frozen=True, kw_only=True, eq=False)
class Steps:
    """Unit steps of the reference in each of r directions, by the linear model."""

    t: Float64Array  # (m,) [s]
    e: Float64Array  # (m, r) error along each direction, as a fraction of the step
    command: Float64Array  # (m, n, r) change of the command of each joint
    units: tuple[str, ...]  # (n,) of the commands


@dataclass(frozen=True, kw_only=True, eq=False)
class Achieved:
    """The sampled loop of a law with its gains, about its equilibrium next to a pose."""

    law: Law
    loop: Loop  # of the law, or of the part of it that moves the arm
    system: LinearSystem  # from tick to tick
    specification: Specification

    @cached_property
    def stated(self) -> ClosedLoop:
        """The closed loop that the law states there."""
        return closed_loop_of(self.law, snapshot(self.loop.side.arm, self.system.point.q))

    @cached_property
    def _ahead(self) -> tuple[Float64Array, Float64Array, Float64Array]:
        """Unit steps at their beginning: (N, r) remaining states, (r, N) rows that see them, (N, r) final commands.

        A law that follows no reference has the free response to a unit velocity along each direction instead.
        """
        lin, motions, law = self.system, self.stated.motions, self.loop.side.single_law
        if law.ignores_reference:
            moving = np.zeros((len(lin.A), motions.shape[1]))
            moving[[lin.states.index(f"plant.v[{i}]") for i in range(len(motions))]] = motions
            return moving, self._seen("v"), np.zeros_like(motions)
        names: tuple[str, ...] = ("ref.q",)
        moved: Float64Array = np.asarray(motions)
        if law.reference is not JointMotion:
            names = ("ref.p", "ref.rotation")
            moved = np.asarray(self.stated.x.J(law.controlled_frame) @ motions)
        if law.reference is TaskForce:
            names = ("ref.F_world",)
            moved = np.asarray(square("contact", self.specification.contact, self.stated) @ moved)
        columns, rows = [i for name in names for i in lin.columns(name)], self._seen("q")
        inputs = np.asarray(lin.B[:, columns] @ moved)
        start = np.linalg.lstsq(np.eye(len(lin.A)) - lin.A, inputs, rcond=RANK)[0]
        command = list(lin.rows("command"))
        end = lin.C[command] @ start + lin.D[np.ix_(command, columns)] @ moved
        final = np.diag(rows @ start)
        if not final.all():
            raise UsageError(
                "a small step does not move the plant from rest, as where dry friction holds it; design for one "
                "without: taut.RigidPlant(..., friction=None), or friction = 'none' in [plant]",
                name="plant",
            )
        return start / final, rows, end / final

    def _seen(self, output: str) -> Float64Array:
        """(r, N) what a group of outputs of the joints shows along the directions."""
        return np.asarray(self.stated.rows @ self.system.C[list(self.system.rows(output))])

    @cached_property
    def steps(self) -> Steps:
        """Steps followed for some time constants of the slowest mode that is seen in them."""
        lin, (x, rows, end) = self.system, self._ahead
        poles, parts = self._modes
        slowest = float(-poles.real[(parts > BAND).any(axis=1)].max())
        count = int(np.clip(STEP_TIME_CONSTANTS / slowest / lin.period, MIN_TICKS, MAX_TICKS))
        command = lin.C[list(lin.rows("command"))]
        e, commands = np.zeros((count, x.shape[1])), np.zeros((count, *end.shape))
        for k in range(count):
            e[k], commands[k] = np.diag(rows @ x), end - command @ x
            x = lin.A @ x
        arm, kind = self.stated.x.arm, self.loop.side.probe.kind
        units = tuple(joint.effort_unit if kind == "torque" else f"{joint.unit}/s" for joint in arm.joints)
        return Steps(t=np.asarray(lin.period * np.arange(count)), e=e, command=commands, units=units)

    @cached_property
    def _modes(self) -> tuple[NDArray[np.complex128], Float64Array]:
        """(m,) poles [1/s], of a pair the upper one, and (m, r) their parts in the steps; equal poles are one."""
        start, rows, _ = self._ahead
        z, shapes = np.linalg.eig(self.system.A.astype(np.complex128))
        parts = (rows @ shapes).T * np.linalg.lstsq(shapes, start, rcond=None)[0]
        upper = (z.imag >= -ROUNDING) & (np.abs(z) > INSTANT)
        groups: list[tuple[list[complex], list[NDArray[np.complex128]]]] = []
        for s, part in zip((np.log(z[upper]) / self.system.period).tolist(), parts[upper], strict=True):
            poles, members = next((g for g in groups if abs(g[0][0] - s) <= SAME_POLE * abs(s)), ([], []))
            if not poles:
                groups.append((poles, members))
            poles.append(s)
            members.append(part)
        means = np.array([np.mean(poles) for poles, _ in groups])
        return means, np.abs([np.sum(members, axis=0) for _, members in groups])

    def damping_and_frequency(self, direction: int) -> tuple[float, float]:
        """zeta and omega_n of the two poles with the largest parts in a direction's step; zeta of any less damped."""
        poles, parts = self._modes
        part = parts[:, direction]
        order = [k for k in np.argsort(-part) if part[k] > SMALL_PART]
        if self.stated.single_pole == "always" or self.specification.damping_ratio is None:
            return 1.0, float(np.abs(poles[part > BAND]).min())
        first = poles[order[0]]
        oscillates = np.abs(poles.imag) > REAL * np.abs(poles)
        second = first.conjugate()
        if not oscillates[order[0]]:
            second = next((poles[k] for k in order[1:] if not oscillates[k]), first)
        omega = math.sqrt(abs(first * second))
        seen = [k for k in order if oscillates[k] and part[k] > BAND]
        ratios = [-poles[k].real / abs(poles[k]) for k in seen]
        return float(min([-(first + second).real / (2.0 * omega), *ratios])), omega

    def overshoot_and_settling(self, direction: int) -> tuple[float, float]:
        """Overshoot [%] and 2 % settling time [s] of a step; infinite where it has not settled after its time."""
        e = self.steps.e[:, direction]
        outside = np.flatnonzero(np.abs(e) > BAND)
        settled = int(outside[-1]) + 1 if outside.size else 0
        return 100.0 * max(-float(e.min()), 0.0), self.steps.t[settled] if settled < len(e) else math.inf

    def stiffness(self) -> Float64Array:
        """(r,) force that moves the arm along each direction by a unit at rest, in each alone [N/m | N m/rad]."""
        lin, rows, law = self.system, self.stated.rows, self.loop.side.single_law
        J = np.asarray(self.stated.x.J(law.controlled_frame))
        at_tool = law.reference is not JointMotion  # where a wrist sensor measures it
        columns = list(lin.columns("disturbance.wrench" if at_tool else "disturbance.torque"))
        forces = np.linalg.lstsq(J.T, rows.T, rcond=None)[0] if at_tool else rows.T
        rest = np.linalg.lstsq(np.eye(len(lin.A)) - lin.A, lin.B[:, columns] @ forces, rcond=RANK)[0]
        return np.asarray(1.0 / np.diag(self._seen("q") @ rest))

    def requirements(self) -> Iterator[Requirement]:
        """A row for each number that was asked for, in each direction."""
        given, r = self.specification.given, len(self.stated.directions)
        got = {name: np.full(r, math.nan) for name in (*SHOWN, "K")}
        if self.system.stable:
            for i in range(r):
                got["zeta"][i], got["omega_n"][i] = self.damping_and_frequency(i)
                got["overshoot"][i], got["settling"][i] = self.overshoot_and_settling(i)
            got["K"] = self.stiffness() if "K" in given else got["K"]
        axes = self.stated.axes
        for name in SHOWN:
            if name in given:
                asked = per_coordinate(name, given[name], self.stated)[axes]
                yield from self._rows(name, [Specification.declared[name].unit] * r, asked, got[name])
        if "K" in given:
            K = self.stated.inside(square("K", given["K"], self.stated))
            units = ["N/m" if self.stated.units[axis] == "m" else "N m/rad" for axis in axes]
            yield from self._rows("K", units, 1.0 / np.diag(np.linalg.inv(K)), got["K"])
        if "force" in given:
            force = self._of_force()
            yield from self._rows(
                "force", ["1/s"] * len(force), np.full(len(force), given["force"]), force.values(), force
            )

    def _rows(
        self,
        name: str,
        units: Sequence[str],
        asked: Float64Array,
        got: Iterable[float],
        directions: Iterable[str] | None = None,
    ) -> Iterator[Requirement]:
        """A row for each direction."""
        for each in zip(directions or self.stated.directions, units, asked.tolist(), map(float, got), strict=True):
            direction, unit, wanted, found = each
            met = self._met(name, wanted, found)
            yield Requirement(name=name, direction=direction, unit=unit, asked=wanted, got=found, met=met)

    def _met(self, name: str, asked: float, got: float) -> bool:
        if name in ("settling", "overshoot"):
            return bool(got <= asked * (1.0 + TOLERANCE) + (OVERSHOOT if name == "overshoot" else 0.0))
        tolerance = STATIC if name == "K" else TOLERANCE
        lowest = min(asked, 1.0) if name == "zeta" else asked  # two real poles have 1 each
        return bool(lowest * (1.0 - tolerance) <= got <= asked * (1.0 + tolerance))

    def _of_force(self) -> dict[str, float]:
        """The slow pole of the force [1/s]: on the contact, or against each row of a rigid constraint."""
        if self.stated.force is None:
            poles, parts = self._modes
            slow = [np.abs(poles[column > RANK]).min() if self.system.stable else math.nan for column in parts.T]
            return dict(zip(self.stated.directions, slow, strict=True))
        kfp, kfi = (np.diag(gain).tolist() for gain in self.stated.force)
        dt, plant = self.system.period, self.loop.plant
        assert isinstance(plant, RigidPlant)
        late = round(plant.actuation.delay / dt)
        return {f"row {i}": force_pole(kfp[i], kfi[i], dt, late) for i in range(len(kfp))}

    def limits(self) -> Iterator[Limit]:
        """Of a stable loop."""
        lin, arm, plant = self.system, self.stated.x.arm, self.loop.plant
        command, drives = self.steps.command, self.loop.side.probe.kind != "torque"
        effort = arm.velocity if drives else arm.effort
        hold = np.zeros(arm.n) if drives or Adds.of(plant.adds).gravity else np.asarray(self.stated.x.g)
        for i, direction in enumerate(self.stated.directions):
            used = command[:, :, i]
            room = np.maximum(np.where(used > 0.0, effort - hold, effort + hold), 0.0)
            size = np.divide(room, np.abs(used), out=np.full(used.shape, np.inf), where=np.abs(used) > NO_COMMAND)
            joint, axis = arm.joint_names[int(np.argmin(size.min(axis=0)))], self.stated.axes[i]
            where = direction if joint == direction else f"{direction} (joint {joint})"
            unit, scale = self.stated.units[axis], 1.0
            if self.stated.contact is not None:  # a step of the force that moves the contact
                unit = {"m": "N", "rad": "N m"}[unit]
                scale = float(square("contact", self.specification.contact, self.stated)[axis, axis])
            yield Limit(name="largest step", value=scale * float(size.min()), unit=unit, where=where)
        if drives:
            return
        angles = np.abs(np.angle(lin.poles[np.abs(lin.poles) > INSTANT])) / lin.period
        margin = common_delay(lin.sensitivity, lin.period, angles)
        yield Limit(name="delay margin", value=margin * lin.period, unit="s", where="all torques together")
        disk = lin.margins().disk
        yield Limit(name="gain margin", value=disk.gain[1], unit="-", where="all torques independently (disk margin)")
        moved = np.abs(lin.point.moved)
        if moved.max() > DROOP:
            worst = int(moved.argmax())
            yield Limit(name="droop", value=float(moved[worst]), unit=arm.units[worst], where=arm.joint_names[worst])


def closed_loop_of(law: Law, x: Snapshot) -> ClosedLoop:
    """The closed loop that a law states at rest; UsageError if it states none."""
    stated = law.closed_loop(x)
    if stated is None:
        raise UsageError(
            f"{type(law).__name__} states no closed loop to place poles in; find its gains with taut.tune, or design "
            "the feedback beside it: taut.design(taut.laws.FeedForward() + taut.laws.PID(kp=1.0), arm, ...)",
            name="law",
        )
    return stated


def force_pole(kfp: float, kfi: float, dt: float, late: int) -> float:
    """[1/s] the slowest pole of a force on a rigid contact, measured a tick late; NaN where it is unstable.

    Law:  e[k] = -lam[k-1], u[k] = kfp e[k] + kfi sum(e) dt, lam[k] = u[k-late]:
          z^(late + 1) (z - 1) + (kfp + kfi dt) z - kfp = 0
    """
    polynomial = np.zeros(late + 3)
    polynomial[:2] = 1.0, -1.0
    polynomial[-2:] += kfp + kfi * dt, -kfp
    modulus = float(np.abs(np.roots(polynomial)).max())
    return -math.log(modulus) / dt if 0.0 < modulus < 1.0 else math.nan
