"""Environments that come with taut: springs, dampers, walls, hands and pushes."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from taut.base.checks import finite_array, unit_vector
from taut.base.errors import UsageError
from taut.base.fields import Choice, Declared, Field, Part
from taut.base.paths import subtree
from taut.base.types import ArrayLike, Float64Array, Twist, Wrench
from taut.maths.spatial import left_jacobian_inverse, rotated, rotation_log
from taut.plant.environments.environment import Environment, applied, fastest
from taut.trace import math as tm
from taut.trace.pose import Pose

Values = Mapping[str, Any]
TINY: Final = 1e-12  # [m] a cord that is shorter has no direction
GRIP: Final = 300.0  # [rad/s]


def pose_or_point(place: Pose | ArrayLike) -> Pose:
    """A pose; a point has the axes of the world."""
    if isinstance(place, str):
        raise UsageError(f"at must be a taut.Pose or a point (3,) [m]; got {place!r}", name="at")
    return place if isinstance(place, Pose) else Pose(finite_array("at", place, shape=(3,), unit="m"))


class Spring(Environment):
    """A spring between the tool and a place in the world.

    Law:          F_ext = -dU/dx of U = 1/2 e^T stiffness e, with e = (p, phi) the position of the tool's origin and
                  the rotation vector of its axes, from the place and in its axes: conservative for any stiffness
    Closed loop:  of mass Lambda at the tool alone: omega^2 = eig(Lambda^-1 stiffness)

    In semi-implicit steps it neither loses nor gains in the long run, but its energy oscillates by the fraction
    omega dt / 2; it is stable while omega^2 dt^2 < 4, and steps with more than 2 are refused.

    Args:
        stiffness: One number of the position alone [N/m], (linear, angular) [N/m, N m/rad], six, or a matrix (6, 6),
            in the axes of `at`.
        at: Where it is at rest: a Pose, or a point [m] for the axes of the world; where the tool starts if left out.
        slack: Free length [m] of a cord, which pulls beyond it and never pushes. For one number of stiffness.

    Raises:
        ShapeError, RangeError: Numbers of another shape, negative, not finite, a matrix that is not symmetric.
        UsageError: A free length of a spring with several stiffnesses.

    Example:
        >>> import taut
        >>> spring = Spring(stiffness=(500.0, 20.0), at=taut.Pose([0.4, 0.0, 0.3]))
        >>> sorted(spring.parameters())
        ['stiffness']
    """

    stiffness: Field = Field(unit="N/m | N m/rad", shape=6, accepts=("scalar", "pair", "matrix"), minimum=0.0)
    at: Part[Pose | None] = Part(Pose, optional=True, convert=pose_or_point)
    slack: Field = Field(unit="m", minimum=0.0, optional=True)

    def check(self) -> None:
        """A cord has one stiffness."""
        if self.slack is not None and np.ndim(self.stiffness):
            self.refuse(
                "slack", "is the free length of a cord of one stiffness [N/m]; leave it out, or give stiffness 300"
            )

    def start(self, T_WE: Pose) -> dict[str, Any]:
        """Memory at the start: where the tool is, if that is where it is at rest."""
        return {} if self.at is not None else {"p": T_WE.p, "R": T_WE.R}

    def wrench(
        self, T_WE: Pose, twist: Twist, t: Any, memory: Values, parameters: Values, dt: Any
    ) -> tuple[Wrench, dict[str, Any]]:
        """(6,) [N, N m] on the arm, and the memory as it was."""
        K = parameters["stiffness"]
        at_rest, R_WA = (memory["p"], memory["R"]) if self.at is None else (self.at.p, self.at.R)
        way = T_WE.p - at_rest
        if np.ndim(K) == 0:
            if self.slack is not None:
                length = tm.maximum(tm.norm(way), TINY)
                way = way * tm.maximum(1.0 - parameters["slack"] / length, 0.0)
            return tm.array([*(-K * way), 0.0, 0.0, 0.0]), dict(memory)
        phi = rotation_log(R_WA.T @ T_WE.R)
        pull = applied(K, tm.array([*(R_WA.T @ way), *phi]))
        moment = left_jacobian_inverse(phi).T @ pull[3:]
        return rotated(R_WA, tm.array([*(-pull[:3]), *(-moment)])), dict(memory)

    def rates(self, mobility: Float64Array, parameters: Values) -> tuple[float, float]:
        """Natural frequency of the tool in it [rad/s]; it has no damping."""
        return float(np.sqrt(fastest(mobility, parameters["stiffness"]))), 0.0


class Damper(Environment):
    """A damper between the tool and the world, as of a liquid that rests.

    Law:          F_ext = -damping V, with V the twist of the tool at its origin
    Closed loop:  of mass Lambda at the tool, and nothing else: V = exp(-Lambda^-1 damping t) V0

    In semi-implicit steps it is stable while eig(Lambda^-1 damping) dt < 2; steps with more than 1 are refused.

    Args:
        damping: One number of the position alone [N s/m], (linear, angular) [N s/m, N m s/rad], six, or a matrix
            (6, 6), in world axes.

    Raises:
        ShapeError, RangeError: Numbers of another shape, negative, not finite, a matrix that is not symmetric.

    Example:
        >>> Damper(damping=(20.0, 0.5)).parameters()["damping"].tolist()
        [20.0, 20.0, 20.0, 0.5, 0.5, 0.5]
    """

    damping: Field = Field(unit="N s/m | N m s/rad", shape=6, accepts=("scalar", "pair", "matrix"), minimum=0.0)

    def wrench(
        self, T_WE: Pose, twist: Twist, t: Any, memory: Values, parameters: Values, dt: Any
    ) -> tuple[Wrench, dict[str, Any]]:
        """(6,) [N, N m] on the arm."""
        return -applied(parameters["damping"], twist), {}

    def rates(self, mobility: Float64Array, parameters: Values) -> tuple[float, float]:
        """How fast it brakes the tool [1/s]."""
        return 0.0, fastest(mobility, parameters["damping"])


class StiffWall(Environment):
    """A half-space that the tool's origin can be pressed into: a stiff surface that pushes and never pulls.

    Law:          N = max(0, stiffness d + s damping d_dot) where the depth d is above 0, else 0
                  s rises smoothly from 0 to 1 while d goes from 0 to onset, so that N begins without a jump
                  F_ext = N normal - min(sliding_damping, friction N / |v_t|) v_t, with v_t the speed along it
    Closed loop:  of mass Lambda pressed in deeper than onset, and nothing else:
                  d_ddot + (damping / Lambda) d_dot + (stiffness / Lambda) d = 0

    Coulomb friction creeps: below the speed friction N / sliding_damping it is viscous.

    Stable while (stiffness dt^2 + 2 damping dt) / Lambda < 4; steps with more than 2 are refused. A wall evaluated at
    the beginning of each step may add energy, at most stiffness (v dt)^2 / 2 in a contact; with damping >= stiffness
    dt / 2, as for Colgate's sampled wall, it does not.

    Args:
        point: (3,) [m] any point of its surface, in world axes.
        normal: (3,) its direction towards free space, of any length, in world axes.
        stiffness: [N/m].
        damping: [N s/m].
        onset: Depth [m] from which damping and friction act fully.
        friction: Coefficient of Coulomb friction; none if left out.
        sliding_damping: How steeply friction rises with speed [N s/m].

    Raises:
        ShapeError, RangeError: Numbers of another shape, negative, not finite; a normal without length.

    Example:
        >>> wall = StiffWall(point=[0.5, 0.0, 0.0], normal=[-1.0, 0.0, 0.0], stiffness=1e4, damping=100.0)
        >>> sorted(wall.parameters())
        ['damping', 'normal', 'onset', 'point', 'stiffness']

    References:
        Colgate and Schenkel, Passivity of a class of sampled-data systems, Journal of Robotic Systems 14 (1997).
        Hunt and Crossley, Coefficient of restitution interpreted as damping in vibroimpact, ASME Journal of Applied
        Mechanics 42 (1975).
    """

    point: Field = Field(unit="m", shape=3)
    normal: Field = Field(unit="1", shape=3, convert=functools.partial(unit_vector, "normal"))
    stiffness: Field = Field(unit="N/m", above=0.0, hint="for free space leave the wall out")
    damping: Field = Field(0.0, unit="N s/m", minimum=0.0)
    onset: Field = Field(1e-4, unit="m", above=0.0, hint="1e-6 is nearly none")
    friction: Field = Field(unit="1", minimum=0.0, optional=True)
    sliding_damping: Field = Field(300.0, unit="N s/m", above=0.0, hint="for no friction leave friction out")

    def parameters(self) -> dict[str, Float64Array]:
        """Run-time parameters by name; without friction none of it."""
        own = Declared.parameters(self)
        return own if self.friction is not None else {name: x for name, x in own.items() if name != "sliding_damping"}

    def wrench(
        self, T_WE: Pose, twist: Twist, t: Any, memory: Values, parameters: Values, dt: Any
    ) -> tuple[Wrench, dict[str, Any]]:
        """(6,) [N, N m] on the arm."""
        p, n, v = parameters, parameters["normal"], twist[:3]
        depth, inwards = n @ (p["point"] - T_WE.p), -(n @ v)
        share = tm.clip(depth / p["onset"], 0.0, 1.0)
        share = share * share * (3.0 - 2.0 * share)
        N = tm.where(depth > 0.0, tm.maximum(p["stiffness"] * depth + share * p["damping"] * inwards, 0.0), 0.0)
        force = N * n
        if self.friction is not None:
            along = v + inwards * n
            speed = tm.maximum(tm.norm(along), 1e-12)
            force = force - tm.minimum(share * p["sliding_damping"], p["friction"] * N / speed) * along
        return tm.array([*force, 0.0, 0.0, 0.0]), {}

    def rates(self, mobility: Float64Array, parameters: Values) -> tuple[float, float]:
        """Natural frequency of the tool in it [rad/s], and how fast it brakes the tool [1/s]."""
        n = np.asarray(parameters["normal"])
        across, flat = np.zeros((6, 6)), np.zeros((6, 6))
        across[:3, :3] = np.outer(n, n)
        damping = parameters["damping"] * across
        if self.friction is not None:
            flat[:3, :3] = np.eye(3) - np.outer(n, n)
            damping = damping + parameters["sliding_damping"] * flat
        omega = np.sqrt(fastest(mobility, parameters["stiffness"] * across))
        return float(omega), fastest(mobility, damping)


class Oscillation(Declared):
    """Reference of a hand over time, at one frequency.

    Law:          wanted = amplitude sin(2 pi frequency t + phase)

    The phase goes on at the frequency's rate, so that a change of it makes no jump.

    Args:
        amplitude: (3,) or scalar, in world axes [m] of a motion, [N] of a force.
        frequency: [Hz].
        phase: [rad].
    """

    amplitude: Field = Field(unit="m | N", shape=3, accepts=("scalar",))
    frequency: Field = Field(unit="Hz", minimum=0.0)
    phase: Field = Field(0.0, unit="rad")


class Hand(Environment):
    """A hand that holds the tool, or a handle (m, b, k) that it holds: a mass, with damper and spring to the world.

    Law:          mass a_h + damping v_h + stiffness (p_h - at - motion(t)) = f_grip + force(t),  F_ext = -f_grip
                  f_grip = mass grip^2 (p - p_h) + mass grip (v - v_h)
    Closed loop:  below the grip's frequency, of an arm without forces, at omega:
                  (p - at) (stiffness - (mass + Lambda) omega^2 + j omega damping) = stiffness motion + force
                  without motion and force: (mass + Lambda) a + damping v + stiffness (p - at) = 0

    The mass has a motion of its own, p_h and v_h, and the grip is a stiff spring and damper: a rigid grip would be an
    algebraic loop in other engines. Measurements differ from those of a rigid grip by (omega / grip)^2, 0.4 % at
    20 rad/s. The hand has inertia, but no weight: give that to the arm's payload.

    Stable while omega^2 dt^2 + 2 dt delta < 4, with omega^2 = grip^2 (1 + mass / Lambda) + stiffness / mass and
    delta = grip (1 + mass / Lambda); steps with more than 2 are refused.

    Args:
        mass: [kg].
        damping: (3,) in world axes or scalar [N s/m].
        stiffness: (3,) in world axes or scalar [N/m].
        motion: Where it wants to be, counted from `at` [m]: a taut.environments.Oscillation; none for a handle.
        force: What it pushes with besides [N]: the same.
        at: (3,) where its spring is at rest [m]; where the tool starts if left out.
        grip: Natural frequency of the mass in the grip of a tool that rests [rad/s].

    Raises:
        ShapeError, RangeError: Numbers of another shape, negative, not finite, no mass.
        UsageError: A motion or force of another kind.

    Example:
        >>> sorted(Hand(mass=1.0, damping=5.0, stiffness=200.0).parameters())
        ['damping', 'grip', 'mass', 'stiffness']
        >>> wave = Oscillation(amplitude=[0.02, 0.0, 0.0], frequency=1.0)
        >>> sorted(Hand(mass=1.0, damping=20.0, stiffness=300.0, motion=wave).parameters())[-3:]
        ['motion.frequency', 'motion.phase', 'stiffness']

    References:
        Chapter, section 10.5 impedance control.
    """

    mass: Field = Field(
        unit="kg", above=0.0, hint="without mass it is a taut.environments.Spring and a taut.environments.Damper"
    )
    damping: Field = Field(0.0, unit="N s/m", shape=3, accepts=("scalar",), minimum=0.0)
    stiffness: Field = Field(0.0, unit="N/m", shape=3, accepts=("scalar",), minimum=0.0)
    motion: Part[Oscillation | None] = Part(Oscillation, optional=True)
    force: Part[Oscillation | None] = Part(Oscillation, optional=True)
    at: Field = Field(unit="m", shape=3, optional=True)
    grip: Field = Field(GRIP, unit="rad/s", above=0.0, hint="not to hold it leave it out")

    def start(self, T_WE: Pose) -> dict[str, Any]:
        """Memory at the start: at rest where the tool is, with the phases of what it wants."""
        memory: dict[str, Any] = {"p": T_WE.p, "v": np.zeros(3)}
        if self.at is None:
            memory["at"] = T_WE.p
        return memory | {f"{name}.phase": 0.0 for name in self.declared_parts()}

    def wrench(
        self, T_WE: Pose, twist: Twist, t: Any, memory: Values, parameters: Values, dt: Any
    ) -> tuple[Wrench, dict[str, Any]]:
        """(6,) [N, N m] on the arm, and the motion after a step: semi-implicit, its damping at the step's end."""
        wanted: dict[str, Any] = {"motion": np.zeros(3), "force": np.zeros(3)}
        phases: dict[str, Any] = {}
        for name in self.declared_parts():
            own, phase = subtree(parameters, name), memory[f"{name}.phase"]
            wanted[name] = own["amplitude"] * tm.sin(phase + own["phase"]) + np.zeros(3)
            phases[f"{name}.phase"] = phase + dt * (2.0 * math.pi * own["frequency"])
        m, k, b, omega = (parameters[name] for name in ("mass", "stiffness", "damping", "grip"))
        p, v = memory["p"], memory["v"]
        at = parameters["at"] if "at" in parameters else memory["at"]
        grip = m * omega * (omega * (T_WE.p - p) + (twist[:3] - v))
        v_new = (m * v + dt * (grip + k * (at + wanted["motion"] - p) + wanted["force"])) / (m + dt * b)
        return tm.array([*(-grip), 0.0, 0.0, 0.0]), {**memory, "p": p + dt * v_new, "v": v_new, **phases}

    def rates(self, mobility: Float64Array, parameters: Values) -> tuple[float, float]:
        """How fast tool and mass oscillate in the grip [rad/s], and how fast it brakes that [1/s]."""
        m, omega = float(parameters["mass"]), float(parameters["grip"])
        both = float(np.linalg.eigvalsh(mobility[:3, :3]).max()) + 1.0 / m
        behind = float(np.max(parameters["stiffness"])) / m
        return float(np.sqrt(m * omega**2 * both + behind)), m * omega * both


class Push(Environment):
    """A push at the tool's origin: a wrench that comes and goes once.

    Law:          F_ext = peak s((t_now - t) / duration), with s(x) = sin(pi x) or 1 for 0 <= x < 1, else 0
    Closed loop:  of mass Lambda at the tool, and nothing else: V = Lambda^-1 peak duration 2 / pi after a half sine,
                  Lambda^-1 peak duration after a rectangular one

    Each step has the mean of the pulse over it, so that the impulse is exact for any dt (in the smooth integrator rk4
    half a step early). For another push, or one at a time not known yet, see `taut.Event.push`.

    Args:
        peak: (6,) the wrench at its peak, force first, in world axes [N, N m]; three numbers are a force.
        t: When it begins [s]; infinity, for one that waits for an event, if left out.
        duration: How long it takes [s].
        shape: "half-sine" or "rectangular".

    Raises:
        ShapeError, RangeError: Numbers of another shape, not finite, a duration that is not above zero.
        UsageError: Another shape of the pulse.

    Example:
        >>> Push(peak=[20.0, 0.0, 0.0], t=1.0, duration=0.1).peak.tolist()
        [20.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    """

    peak: Field = Field((0.0, 0.0, 0.0), unit="N, N m", shape=6, accepts=("force",))
    t: Field = Field(math.inf, unit="s", minimum=0.0, infinite=True)
    duration: Field = Field(0.1, unit="s", above=0.0, hint="for no push leave it out")
    shape: Choice[str] = Choice("half-sine", "rectangular")

    def wrench(
        self, T_WE: Pose, twist: Twist, t: Any, memory: Values, parameters: Values, dt: Any
    ) -> tuple[Wrench, dict[str, Any]]:
        """(6,) [N, N m] on the arm: the mean from t to t + dt."""
        length = parameters["duration"]
        begin, end = (tm.clip((now - parameters["t"]) / length, 0.0, 1.0) for now in (t, t + dt))
        if self.shape == "rectangular":
            share = end - begin
        else:
            share = (tm.cos(math.pi * begin) - tm.cos(math.pi * end)) / math.pi
        return parameters["peak"] * (share * length / dt), {}
