"""Section 10.2.2: coupling of joints, and the Lyapunov function of PD control with gravity compensation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from taut.arm.description import Arm
from taut.base.checks import instance_of
from taut.base.errors import UsageError
from taut.base.paths import subtree
from taut.base.result import Content, Result, Table
from taut.base.types import ArrayLike, Float64Array, Vector
from taut.codegen.program import over_rows
from taut.linear.joint_loop import joint_matrix
from taut.linear.linearise import linearise
from taut.loop import Loop
from taut.maths import dynamics as dyn
from taut.maths.model import PayloadValues, model_of
from taut.maths.snapshot import Snapshot
from taut.record.run import Run
from taut.trace.derivative import jacobian

MAX_CROSSTALK: Final = 0.1  # [-] of decentralised control
LAWS: Final = ("GravityPID", "GravityCompensation")
VISCOUS: Final = "plant.friction.viscous"
ENERGY_ROUNDING: Final = 1e-12  # of V


@dataclass(frozen=True, kw_only=True, eq=False)
class Coupling(Result):
    """Coupling of the joints of a loop about a pose.

    Args:
        joints: Their names.
        inertia: 0 (decoupled) to 1: one less the smallest eigenvalue of D^-1/2 M D^-1/2, with D = diag(M).
        crosstalk: (n, n) largest gain over all frequencies from the reference of each joint (column) to each (row).
        droop: (n,) steady-state error of each joint under gravity [rad | m].
        unit: Of the joints, all of one kind.
    """

    joints: tuple[str, ...]
    inertia: float
    crosstalk: Float64Array
    droop: Float64Array
    unit: str

    @property
    def worst(self) -> tuple[float, str, str]:
        """The largest crosstalk of two joints, the joint that moves, and the one whose reference it was."""
        apart = np.where(np.eye(len(self.joints), dtype=bool), -1.0, self.crosstalk)
        i, j = np.unravel_index(int(np.argmax(apart)), apart.shape)
        return max(float(apart[i, j]), 0.0), self.joints[i], self.joints[j]

    @property
    def ok(self) -> bool:
        """Decentralised control is enough: no crosstalk of different joints is above 10 %."""
        return self.worst[0] <= MAX_CROSSTALK

    def content(self) -> Content:
        """The verdict, and a table of the joints."""
        size, joint, other = self.worst
        verdict = f"decentralised control is {'enough' if self.ok else 'not enough'}"
        if len(self.joints) > 1:
            verdict += (
                f": joint '{joint}' follows up to {100.0 * size:.3g} % of the reference of '{other}', and the "
                f"limit is {100.0 * MAX_CROSSTALK:g} %"
            )
        apart = self.crosstalk - np.diag(np.diag(self.crosstalk))
        rows = list(zip(self.joints, (100.0 * apart.max(axis=1)).tolist(), self.droop.tolist(), strict=True))
        return Content(
            title="coupling of the joints",
            summary=[verdict] if self.ok else [],
            faults=[] if self.ok else [verdict],
            tables=[Table(columns=("joint", "crosstalk [%]", f"droop under gravity [{self.unit}]"), rows=rows)],
            notes=[f"coupling of the inertia matrix {self.inertia:.3g} (0 is diagonal, 1 is singular)"],
        )


def coupling(loop: Loop, *, at: ArrayLike | None = None) -> Coupling:
    """Coupling of the joints of an arm at a pose, in the sampled loop: whether decentralised control is enough.

    The dynamics are decoupled where each joint's acceleration depends on its own torque and state alone: in gantries,
    and nearly in arms with large gears, whose rotors dominate the diagonal of M, and with little gravity.

    Args:
        loop: A loop of a law of joints, with a reference that stays.
        at: (n,) joint positions to begin at [rad | m]; home if left out.

    Raises:
        UsageError: A law that follows no joint positions; joints of different units; an unstable loop.
        RangeError: No equilibrium near `at`.

    Example:
        >>> import taut
        >>> arm = taut.load_arm("gantry3")
        >>> ctrl = taut.compile(taut.laws.GravityPID(kp=1000.0, kd=100.0), arm)
        >>> loop = taut.Loop(ctrl, taut.RigidPlant(arm, friction=None), duration=1.0)
        >>> taut.analysis.coupling(loop).ok
        True

    References:
        Section 10.2.2.1 decentralised multi-joint control; section 10.2.1.5 on gears.
    """
    lin = linearise(loop, at=at)
    if "ref.q[0]" not in lin.inputs:
        raise UsageError(
            f"coupling is for laws that follow joint positions; {type(loop.side.law).__name__} does not", name="loop"
        )
    units = loop.plant.arm.units
    if len(set(units)) > 1:
        raise UsageError(
            "coupling compares joints of one kind, and this arm has some in rad and some in m, whose crosstalk "
            "has units; look at lin.frequency_response(omega, input='ref.q', output='q') of taut.linearise",
            name="loop",
        )
    payload = PayloadValues.of(subtree(loop.parameters, "plant.payload"))
    arm, q = loop.plant.arm, lin.point.q
    M = np.array(Snapshot(model_of(arm), q=q, v=np.zeros(arm.n), payload=payload).M, dtype=float)
    root = np.sqrt(np.diag(M))
    scaled = M / np.outer(root, root)
    return Coupling(
        joints=lin.point.joints,
        inertia=1.0 - float(np.linalg.eigvalsh(scaled)[0]),
        crosstalk=lin.peak_gain(input="ref.q", output="q"),
        droop=lin.point.moved,
        unit=units[0],
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Lyapunov(Result):
    """V along a run, its rate by the equation of motion, and its rate by the proof.

    Args:
        t: (k,) [s].
        V: (k,) e . Kp e / 2 + v . M v / 2 [J].
        kinetic: (k,) the second part.
        rate: (k,) [W] dV/dt right after each tick, of the true arm under the torque that acted then:
            v . (M a + M-dot v / 2) - e . Kp v, with M-dot by differentiation and M a from the equation of motion.
        expected: (k,) [W] -v . Kd v, and what viscous friction takes besides.
    """

    t: Float64Array
    V: Float64Array
    kinetic: Float64Array
    rate: Float64Array
    expected: Float64Array

    @property
    def worst(self) -> float:
        """Largest difference of the rates, over the largest of either: 0 where the proof's assumptions hold."""
        off = float(np.abs(self.rate - self.expected).max(initial=0.0))
        size = max(float(np.abs(x).max(initial=0.0)) for x in (self.expected, self.rate))
        ticks = np.diff(self.t)
        rounding = ENERGY_ROUNDING * float(self.V.max()) / float(ticks[0]) if len(ticks) else 0.0
        return off / size if size > rounding else 0.0

    @property
    def decreases(self) -> bool:
        """V never grows from one tick to the next by more than rounding."""
        return bool((np.diff(self.V) <= ENERGY_ROUNDING * max(float(self.V[0]), 1e-300)).all())

    def content(self) -> Content:
        """V at the start and at the end, and whether it decreases as the proof requires."""
        verdict = "V decreases in every tick" if self.decreases else "V does not decrease in every tick"
        rows = [("V at the start [J]", float(self.V[0])), ("V at the end [J]", float(self.V[-1]))]
        rows.append(("largest difference of the rate to -v . Kd v, relative", self.worst))
        return Content(
            title="Lyapunov function of PD control with gravity compensation",
            summary=[verdict] if self.decreases else [],
            faults=[] if self.decreases else [verdict],
            tables=[Table(columns=("quantity", "value"), rows=rows)],
        )


def lyapunov(run: Run) -> Lyapunov:
    """The Lyapunov function 10.24 along a run of PD control with gravity compensation, and its derivative.

    Law:          V = e . Kp e / 2 + v . M v / 2                                                  eq. 10.24
    Closed loop:  V-dot = -v . Kd v for a set-point, an exact g and no other friction              eqs. 10.25 to 10.27
                  M-dot - 2 C is skew, so that the Coriolis torques do no work

    The rate is that at the instant of each tick; between ticks the torque is held, so that V decreases by slightly
    less or more than the integral. A model error of the law, or gravity that the plant compensates itself, shows as a
    difference of the rates.

    Args:
        run: Of `GravityPID` with ki = 0 or `GravityCompensation`, on a plant with viscous friction at most.

    Raises:
        UsageError: A run without an arm, of another law, or with an integral, a moving reference, events, dry
            friction, contact, or gears that lose power or give way.

    Example:
        >>> import taut
        >>> arm = taut.load_arm("planar2")
        >>> ctrl = taut.compile(taut.laws.GravityPID(kp=40.0, kd=8.0), arm)
        >>> plant = taut.RigidPlant(arm, friction=None)
        >>> run = taut.run(ctrl, plant, taut.JointMotion(q=[0.5, -0.5]), duration=1.0)
        >>> found = taut.analysis.lyapunov(run)
        >>> found.worst < 1e-6, found.decreases
        (True, True)

    References:
        Section 10.2.2.2, equations 10.24 to 10.27.
    """
    instance_of("run", run, Run, "a taut.Run")
    law, values = run.info.law.partition("(")[0], run.info.parameters
    _check(run, law, values)
    n = run.n
    assert run.arm is not None
    kp, viscous = joint_matrix("kp", values.get("law.kp", 0.0), n), np.broadcast_to(values.get(VISCOUS, 0.0), (n,))
    kd = joint_matrix("kd", values["law.kd"], n) + np.diag(viscous)
    e = np.zeros_like(run.q) if law == "GravityCompensation" else run.error
    assert e is not None
    kinetic, rate = _energies(run, run.arm, viscous, subtree(values, "plant.payload"))
    return Lyapunov(
        t=run.t,
        V=0.5 * np.einsum("ki,ij,kj->k", e, kp, e) + kinetic,
        kinetic=kinetic,
        rate=rate - np.einsum("ki,ij,kj->k", e, kp, run.v),
        expected=-np.einsum("ki,ij,kj->k", run.v, kd, run.v),
    )


def _energies(
    run: Run, arm: Arm, viscous: Float64Array, payload: Mapping[str, Any]
) -> tuple[Float64Array, Float64Array]:
    """(k,) kinetic energy [J], and (k,) its rate under the torques that act [W]."""
    model, load = model_of(arm), PayloadValues.of(payload)

    def energies(q: Vector, v: Vector, tau: Vector) -> dict[str, Any]:
        def kinetic(s: Vector) -> Any:
            return 0.5 * (v @ (dyn.mass_matrix(model, q + s[0] * v, load) @ v))

        push = tau - dyn.bias(model, q, v, load) - viscous * v
        moved = jacobian(kinetic, np.zeros(1))[0]  # v . M-dot v / 2
        return {"kinetic": kinetic(np.zeros(1)), "rate": v @ push + moved}

    found = over_rows(energies, q=arm.n, v=arm.n, tau=arm.n)(q=run.q, v=run.v, tau=run.tau)
    return found["kinetic"], found["rate"]


def _check(run: Run, law: str, values: Mapping[str, Any]) -> None:
    """Refuse a run that the proof is not about."""
    q, v = getattr(run.reference, "q", np.zeros(1)), getattr(run.reference, "v", 0.0)
    moves = law == "GravityPID" and bool(np.ptp(q, axis=0).any() or np.any(v))
    others = ("plant.friction.", "actuation.transmission.", "environment.", "contact.")
    if (
        law not in LAWS
        or "law.kd" not in values
        or np.any(np.asarray(values.get("law.ki", 0.0)))
        or run.arm is None
        or run.info.events
        or moves
        or any(path.startswith(others) and path != VISCOUS for path in values)
    ):
        raise UsageError(
            f"eqs. 10.24 to 10.27 are for {' or '.join(LAWS)} alone, with ki = 0 and no events, at a set-point, on "
            "an arm with viscous friction at most, without contact and losses of gears, in a run that was not loaded "
            f"from a file; this run is of {run.info.law or '?'}",
            name="run",
        )
