"""Maximum stable and maximum passive stiffness of a sampled loop: an arm under its controller, or a virtual wall."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Final
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from taut.base.checks import (
    finite_array,
    finite_scalar,
    instance_of,
    positive_scalar,
    rate_in_hertz,
)
from taut.base.errors import RangeError, ShapeError, UsageError
from taut.base.paths import subtree
from taut.base.result import Cell, Content, Result, Table
from taut.base.types import ArrayLike, Float64Array
from taut.controller import Controller
from taut.linear.joint_loop import VelocityKind, joint_matrix, pid
from taut.linear.judgement import directions, largest_factor, uncertain_eigenvalues, without_dry_friction
from taut.linear.linear_system import LinearSystem, names
from taut.linear.linearise import observed_states
from taut.linear.period import Period
from taut.loop import Loop
from taut.maths.model import PayloadValues
from taut.maths.snapshot import Snapshot
from taut.plant.rigid import RigidPlant
from taut.trace.derivative import jacobian

Complex = NDArray[np.complex128]
LawOf = Callable[[float], LinearSystem]
"""Factor on the stiffness -> the sampled law from q and v to command."""

STIFFNESS: Final = ("K", "kp")  # names of stiffness gains
SLOWEST_SPRING: Final = 1e-2  # [1/s] of what no gain holds: rounding splits its two poles at 1; springs move faster
OF_JOINTS: Final = "viscous friction of the joints"
GRID_POINTS: Final = 256  # frequencies of a grid, for each period of delay
LOWEST: Final = 1e-4  # [rad] omega T: below it the condition has reached its limit for slow motion
ZOOMS: Final = 3  # each is 64 times finer
ROUNDING: Final = 1e-9  # of the largest damping, physical or of the law: a redundant arm has directions without any
MAX_FACTOR: Final = 2.0**40  # [-] on a stiffness, up to which a limit is searched
INTEGRATOR: Final = 1e-9  # [-] distance in z of a pole to 1


@dataclass(frozen=True, kw_only=True, eq=False)
class StiffnessCheck(Result):
    """Stability and passivity of the sampled loop of an inertia and a law, in all directions at once.

    Args:
        M: (n, n) inertia [kg m^2 | kg].
        damping: (n, n) physical damping [N m s/rad | N s/m].
        gravity: (n, n) derivative of the gravity torques that are not compensated [N m/rad | N/m].
        law_of: The sampled law with its stiffness times a factor.
        delay: [s] from the tick to the torque, beyond the zero-order hold.
        band: Highest frequency [Hz] of motions of which passivity is asked; None for every passive environment.
        joints: n names.
        J: (6, n) Jacobian of the tool in world axes; None without an arm.
        differenced: The law is linear by central differences, whose rounding counts as no growth.
        tolerance: Relative, of the limits.
        source: The physical damping in words.
    """

    M: Float64Array
    damping: Float64Array
    gravity: Float64Array
    law_of: LawOf
    delay: float
    band: float | None
    joints: tuple[str, ...]
    J: Float64Array | None = None
    differenced: bool = False
    tolerance: float = 1e-8
    source: str = "physical damping"

    @cached_property
    def law(self) -> LinearSystem:
        """The sampled law: from q and v to command."""
        return self.law_of(1.0)

    @cached_property
    def system(self) -> LinearSystem:
        """The closed loop, from tick to tick."""
        return self._closed(self.law)

    @cached_property
    def stable(self) -> bool:
        """The loop is stable by itself."""
        return self._is_stable(self.system)

    @cached_property
    def limit(self) -> float:
        """Largest factor on the stiffness up to which the loop is stable; 0 where no smaller one makes it stable.

        The first limit on a grid of factors of 2 from 1 on: a loop that is stable again above it is not counted.
        """
        return self._largest_factor(lambda law: self._is_stable(self._closed(law)))

    @cached_property
    def damping_margin(self) -> float:
        """Physical damping above the minimum of passivity [N m s/rad | N s/m], worst direction and frequency."""
        return self._margin(self.law)

    @property
    def passive(self) -> bool:
        """No passive environment makes the loop unstable; with a band, no motion in it gets energy out of it."""
        return (self.stable or self.band is None) and self.damping_margin >= -self._rounding

    @cached_property
    def passive_limit(self) -> float:
        """Largest factor on the stiffness up to which the loop is passive; 0 where no factor helps."""
        if self.damping_margin == -math.inf:
            return 0.0
        factor = self._largest_factor(lambda law: self._margin(law) >= -self._rounding)
        return factor if self.band is None else min(factor, self.limit)

    @cached_property
    def relies_on(self) -> tuple[str, ...]:
        """The physical damping without which one of the verdicts would be another; empty where none is needed."""
        if not self.damping.any():
            return ()
        bare = dataclasses.replace(self, damping=np.zeros_like(self.damping))
        return (self.source,) if (self.stable, self.passive) != (bare.stable, bare.passive) else ()

    @property
    def direction(self) -> Mapping[str, float]:
        """Fraction of each joint in the mode that becomes unstable first, by name, the largest first."""
        return self._directions[0]

    @property
    def tool_direction(self) -> Mapping[str, float]:
        """Fraction of each axis of the tool in that mode, by kinetic energy (world axes); empty without an arm."""
        return self._directions[1] if self.J is not None else {}

    @cached_property
    def _directions(self) -> tuple[Mapping[str, float], Mapping[str, float]]:
        system = self.system
        if self.stable and 0.0 < self.limit < math.inf:
            system = self._closed(self.law_of(1.01 * self.limit))
        mode = next((mode for mode in system.modes if not mode.resting), None)
        J = np.zeros((6, len(self.M))) if self.J is None else self.J
        return ({}, {}) if mode is None else directions(system, mode, self.joints, self.M, J)

    def content(self) -> Content:
        """Verdicts, limits and the direction that limits the stiffness."""
        who = "every passive environment" if self.band is None else f"motions below {self.band:g} Hz"
        stable, passive = "stable by itself", f"passive against {who}"
        rows: list[list[Cell]] = [[stable, self.stable, self.limit], [passive, self.passive, self.passive_limit]]
        fractions = [("joint", *each) for each in self.direction.items()]
        fractions += [("axis of the tool", *each) for each in self.tool_direction.items()]
        return Content(
            title=f"stiffness of a loop sampled at {1.0 / self.law.period:g} Hz",
            faults=[] if self.stable else ["the loop is unstable by itself"],
            summary=[str(verdict) for verdict, holds, _ in rows if holds],
            tables=[
                Table(columns=("", "holds", "largest factor on the stiffness"), rows=rows),
                Table(
                    title="direction that limits the stiffness", columns=("", "of", "fraction [-]"), rows=fractions
                ),
            ],
            notes=[f"the verdict relies on the {each}" for each in self.relies_on],
        )

    @property
    def _rounding(self) -> float:
        sampled = np.abs(self.law.D[self.law.rows("command")])
        of_law = [
            T * float(sampled[:, self.law.columns(name)].max(initial=0.0))
            for name, T in (("q", self.law.period), ("v", 1.0))
        ]
        return ROUNDING * max(float(np.abs(self.damping).max()), *of_law)

    @cached_property
    def _plant(self) -> LinearSystem:
        n = len(self.M)
        rates = np.linalg.solve(self.M, np.hstack([-self.gravity, -self.damping, np.eye(n)]))
        return LinearSystem(
            A=np.block([[np.zeros((n, n)), np.eye(n)], [rates[:, : 2 * n]]]),
            B=np.vstack([np.zeros((n, n)), rates[:, 2 * n :]]), C=np.eye(2 * n), inputs=names("command", n),
            states=(*names("plant.q", n), *names("plant.v", n)), outputs=(*names("q", n), *names("v", n)),
        ).zoh(self.law.period, self.delay)  # fmt: skip

    def _closed(self, law: LinearSystem) -> LinearSystem:
        return self._plant.feedback(law)

    def _is_stable(self, system: LinearSystem) -> bool:
        if not self.differenced:
            return system.stable
        z, slack = uncertain_eigenvalues(system.A)
        return bool(((np.abs(z) <= 1.0 + slack) | (np.abs(z - 1.0) < SLOWEST_SPRING * self.law.period)).all())

    def _margin(self, law: LinearSystem) -> float:
        return passivity_margin(law, self.damping, delay=self.delay, band=self.band)

    def _largest_factor(self, holds: Callable[[LinearSystem], bool]) -> float:
        return largest_factor(lambda factor: holds(self.law_of(factor)), self.tolerance, MAX_FACTOR)


def passivity_margin(
    law: LinearSystem, damping: Float64Array, *, delay: float = 0.0, band: float | None = None
) -> float:
    """Physical damping above the least that keeps a sampled loop passive, in the worst direction and frequency.

    Law:          with H(z) of positions, command = -H q, z = exp(j theta), and D = z^-d (1 - s + s z^-1) of a delay
                  of d + s periods, the loop is stable with every passive environment if and only if
                  damping - p D - (p D)^H - (1 - |D|^2) p^H damping^-1 p > 0   for all theta in (0, pi],
                  p = j T H exp(-j theta/2) / (4 sin(theta/2))
                  For whole periods this is Colgate and Schenkel's damping > T/2 Re((1 - z^-1) H z^-d) / (1 - cos
                  theta); for H = K + B (1 - z^-1) / T without delay damping > K T/2 + |B|.
                  With a band, of sinusoidal motions below it: damping + He(H_0) > 0,
                  H_0 = exp(-j omega delay) (1 - z^-1)/(j omega T) (H + j omega H_v) / (j omega),
                  the force's first harmonic over the velocity; H_v is that of a measured velocity

    A measured velocity has no bound for every environment (minus infinity): its samples contain nothing of the motion
    between ticks, so that resonances far above the rate can beat any damping. Nor has an integral: a slow enough
    motion gets more energy out of it than any damping takes.

    References:
        Colgate and Schenkel, Passivity of a class of sampled-data systems: application to haptic interfaces (1997),
        theorem 1. Its proof for a fraction of a period is ours: the aliases of the environment's response are discs,
        their weighted sum is one, and its centre moves with the fraction while its radius stays.
    """
    T = law.period
    if (np.abs(law.poles - 1.0) < INTEGRATOR).any():
        return -math.inf
    periods = delay / T
    whole = round(periods) if abs(periods - round(periods)) < INTEGRATOR else math.floor(periods)
    part = periods - whole if periods - whole > INTEGRATOR else 0.0

    def every_environment(theta: Float64Array) -> Float64Array:
        D: Complex = np.exp(-1j * whole * theta) * (1.0 - part + part * np.exp(-1j * theta))
        p = _matrices(-0.25j * T * np.exp(-0.5j * theta) / np.sin(0.5 * theta)) * _response(law, theta, "q")
        pD = p * _matrices(D)
        margin = damping - pD - _adjoint(pD)
        if not part:
            return np.asarray(np.linalg.eigvalsh(margin)[:, 0])
        # The Schur complement of this matrix is the condition, without an inverse of damping.
        off = _matrices(np.sqrt(1.0 - np.abs(D) ** 2)) * p
        own = np.broadcast_to(damping, p.shape)
        rows = [np.concatenate(row, axis=2) for row in ((margin, _adjoint(off)), (off, own))]
        return np.asarray(np.linalg.eigvalsh(np.concatenate(rows, axis=1))[:, 0])

    def in_band(theta: Float64Array) -> Float64Array:
        s = 1j * theta / T
        H: Complex = -_response(law, theta, "q") - _matrices(s) * _response(law, theta, "v")
        z = _matrices(np.exp(-s * delay) * (1.0 - np.exp(-1j * theta)) / (s * s * T)) * H
        return np.asarray(np.linalg.eigvalsh(damping + 0.5 * (z + _adjoint(z)))[:, 0])

    count = round(GRID_POINTS * (1.0 + periods))
    if band is not None:
        return _smallest(in_band, min(2.0 * math.pi * band * T, math.pi), count)
    if np.abs(law.B[:, law.columns("v")]).any() or np.abs(law.D[np.ix_(law.rows("command"), law.columns("v"))]).any():
        return -math.inf
    return _smallest(every_environment, math.pi, count)


def _smallest(function: Callable[[Float64Array], Float64Array], top: float, count: int) -> float:
    """The smallest value of a function of theta up to a frequency, on a grid that zooms in."""
    theta = np.linspace(LOWEST, top, count)
    smallest = math.inf
    for _ in range(ZOOMS + 1):
        values = function(theta)
        i = int(values.argmin())
        smallest = min(smallest, float(values[i]))
        theta = np.linspace(theta[max(i - 1, 0)], theta[min(i + 1, len(theta) - 1)], 65)
    return smallest


def _response(law: LinearSystem, theta: Float64Array, input: str) -> Complex:
    """(k, n, n) from an input to the command, at the angles theta = omega T."""
    return law.frequency_response(theta / law.period, input=input, output="command")


def _matrices(numbers: ArrayLike) -> Complex:
    """(k, 1, 1) of (k,) factors."""
    return np.asarray(numbers, dtype=np.complex128)[:, np.newaxis, np.newaxis]


def _adjoint(matrices: Complex) -> Complex:
    return matrices.conj().swapaxes(1, 2)


def check_virtual_wall(
    *,
    mass: ArrayLike,
    damping: ArrayLike = 0.0,
    K: ArrayLike = 1.0,
    B: ArrayLike = 0.0,
    rate: float = 1000.0,
    delay: float = 0.0,
    velocity: VelocityKind = "measured",
    band: float | None = None,
) -> StiffnessCheck:
    """Stability and passivity of a virtual wall: a mass that sees a spring and a damper once in a period.

    Law:          command = -K x - B v, held for a period
    Closed loop:  mass a + damping v = command(t - delay) + F_ext, sampled exactly

    Args:
        mass: A number, (n,) or (n, n) [kg | kg m^2]: Lambda of an arm at its tool.
        damping: Physical damping, likewise [N s/m | N m s/rad].
        K: Stiffness, likewise [N/m | N m/rad]; with 1 the limits are stiffnesses.
        B: Damping of the virtual damper, likewise [N s/m | N m s/rad]; negative for a negative damper.
        rate: [Hz].
        delay: [s] from the tick to the force, beyond the zero-order hold; whole periods or not.
        velocity: "measured", "difference", `taut.sensors.LowPass(...)`, `taut.sensors.Difference(cutoff=...)`.
        band: [Hz], at most half the rate: passivity for motions below it; for every passive environment if left out.

    Raises:
        RangeError, ShapeError, UsageError: A number without meaning, by name.

    Example:
        >>> import taut
        >>> wall = taut.analysis.check_virtual_wall(mass=0.2, damping=1.0, B=0.5, velocity="difference")
        >>> round(wall.limit), round(wall.passive_limit)  # [N/m]
        (2995, 1000)

    References:
        Colgate and Schenkel, Passivity of a class of sampled-data systems (1997). Chapter, section 10.5.1.
    """
    n = max((len(np.atleast_1d(np.asarray(x))) for x in (mass, damping, K, B) if np.ndim(x)), default=1)
    M, b = joint_matrix("mass", mass, n, "kg", above=0.0), joint_matrix("damping", damping, n, "N s/m", minimum=0.0)
    spring = joint_matrix("K", K, n, "N/m", minimum=0.0)
    rate = rate_in_hertz(rate)

    def law_of(factor: float) -> LinearSystem:
        return pid(n, kp=factor * spring, kd=B, rate=rate, velocity=velocity)

    law_of(1.0)  # refuses what has no meaning
    return StiffnessCheck(
        M=M, damping=b, gravity=np.zeros((n, n)), law_of=law_of,
        delay=finite_scalar("delay", delay, unit="s", minimum=0.0), band=_checked_band(band, rate),
        joints=("mass",) if n == 1 else tuple(f"direction {i + 1}" for i in range(n)),
    )  # fmt: skip


def _checked_band(band: float | None, rate: float) -> float | None:
    if band is None:
        return None
    value = positive_scalar("band", band, unit="Hz")
    if value > 0.5 * rate:
        raise RangeError(
            f"band must be at most {0.5 * rate:g} [Hz], half the rate; got {value:g}", name="band", value=value
        )
    return value


def check_stiffness(
    ctrl: Controller,
    at: ArrayLike | None = None,
    damping: ArrayLike | None = None,
    *,
    delay: float = 0.0,
    band: float | None = None,
) -> StiffnessCheck:
    """Stability and passivity of a controller at a pose of its arm, with gains, payload and sensing as they are now.

    Law:          command = law(q, v, its memory), linear about rest at the pose, held for a period
    Closed loop:  M dv/dt + damping v = command(t - delay), sampled exactly, with dg/dq dq on the left where gravity
                  is not compensated; a law that compensates it does so between ticks too

    Limits are factors on the law's stiffness, its gains K and kp. All motions of the joints count, those in the null
    space too. Dry friction, its compensation and limits of torque are left out; a damper of the law is no physical
    damping. Passive means: against every passive environment at the joints, for redundant arms more than at the tool.

    Args:
        ctrl: A controller whose law gives torques and reads no wrist sensor.
        at: (n,) positions [rad | m]; home if left out.
        damping: (n,) or a number, viscous friction of the joints [N m s/rad | N s/m]; the arm's own if left out.
        delay: [s] from the tick to the torque, beyond the zero-order hold; whole periods or not.
        band: [Hz] passivity for motions below it, such as 20 for hands; for every passive environment if left out.

    Raises:
        UsageError: No controller, a law that commands velocities or positions, or that reads a wrist sensor.
        ShapeError, RangeError: A number without meaning, by name.

    Example:
        >>> import taut
        >>> ctrl = taut.compile(taut.laws.Impedance(K=(800.0, 30.0), zeta=0.7), taut.load_arm("panda"))
        >>> check = taut.analysis.check_stiffness(ctrl)
        >>> check.stable, check.limit > 10.0, check.passive
        (True, True, False)

    References:
        Colgate and Schenkel, Passivity of a class of sampled-data systems (1997). Chapter, section 10.5.1.
    """
    instance_of("ctrl", ctrl, Controller, "a controller from taut.compile")
    if ctrl.kind != "torque" or "F_ext" in ctrl.side.needs:
        why = f"gives {ctrl.kind} commands" if ctrl.kind != "torque" else "reads the wrist sensor"
        raise UsageError(
            f"check_stiffness is for laws from joint motion to torque, and {type(ctrl.law).__name__} {why}; judge "
            "the whole loop with taut.linearise",
            name="ctrl",
        )
    arm = ctrl.arm
    q = arm.home if at is None else finite_array("at", at, shape=(arm.n,), joints=arm.joint_names)
    unit = "N m s/rad | N s/m"
    friction = arm.viscous if damping is None else finite_array("damping", damping, unit=unit, minimum=0.0)
    if friction.shape not in ((), (arm.n,)):
        raise ShapeError(f"damping must be a number or ({arm.n},); got shape {friction.shape}", name="damping")
    payload = PayloadValues.of(subtree(ctrl.parameters, "model.payload"))
    x = Snapshot(ctrl.side.model, q=q, v=np.zeros(arm.n), payload=payload)
    gravity = np.asarray(jacobian(lambda q: Snapshot(x.model, q=q, v=np.zeros(arm.n), payload=payload).g, q))
    law_of, compensates = _law_at(ctrl, q, x, gravity)
    return StiffnessCheck(
        M=np.asarray(x.M, dtype=np.float64), damping=np.diag(np.broadcast_to(friction, (arm.n,))),
        gravity=gravity * (not compensates and not ctrl.side.adds.gravity), law_of=law_of,
        delay=finite_scalar("delay", delay, unit="s", minimum=0.0), band=_checked_band(band, ctrl.rate),
        joints=arm.joint_names, J=np.asarray(x.J(), dtype=np.float64), differenced=True, tolerance=1e-3,
        source=OF_JOINTS,
    )  # fmt: skip


def _law_at(ctrl: Controller, q: Float64Array, x: Snapshot, gravity: Float64Array) -> tuple[LawOf, bool]:
    """The law of a controller at a pose as a linear system, and whether it compensates gravity there.

    `gravity` (n, n) [N m/rad | N/m] is the derivative of the gravity torques, which in a command are no stiffness.
    """
    loop = _LOOPS.get(ctrl)
    if loop is None:
        loop = _LOOPS[ctrl] = Loop(ctrl, RigidPlant(ctrl.arm, friction=None, adds=ctrl.side.adds), duration=1.0)
    values = {**ctrl.parameters, **without_dry_friction(ctrl.side, ctrl.parameters)}
    period = Period(loop, q, values)
    coordinates, views, n = period.state_coordinates, period.memory.views, len(q)
    stiffness = {
        path: np.asarray(value)
        for path, value in values.items()
        if path.startswith("law.") and ".null." not in path and path.rpartition(".")[2] in STIFFNESS
    }
    memory = period.after(period.start, period.start.memory)  # what begins in the first tick has begun
    for path in ("plant.q", "plant.v"):
        views(memory)[path][...] = views(period.start.memory)[path]
    point = dataclasses.replace(period.start, memory=memory)
    compensates = not ctrl.side.adds.gravity and np.allclose(period.command(point), x.g, rtol=1e-6, atol=1e-6)
    every = np.arange(len(coordinates))
    motion = np.concatenate([every[coordinates.places[path]] for path in ("plant.q", "plant.v")])

    def law_of(factor: float) -> LinearSystem:
        found = period.derivative(period.changed(point, {path: factor * x for path, x in stiffness.items()}))
        C = found.C[-n:].copy()
        C[:, motion[:n]] -= gravity * compensates
        law = np.setdiff1d(every, motion)
        own = found.A[np.ix_(law, law)]  # of its memory, without constants such as a posture at rest
        driven = observed_states(own.T, found.A[np.ix_(law, motion)].T)
        states = law[driven & observed_states(own, C[:, law])]
        return LinearSystem(
            A=found.A[np.ix_(states, states)], B=found.A[np.ix_(states, motion)], C=C[:, states], D=C[:, motion],
            dt=period.dt, states=[coordinates.names[i] for i in states],
            inputs=(*names("q", n), *names("v", n)), outputs=names("command", n),
        )  # fmt: skip

    return law_of, compensates


_LOOPS: Final[WeakKeyDictionary[Controller, Loop]] = WeakKeyDictionary()
