"""What acts on the tool by itself: hands and handles, masses with a motion of their own in a grip; pushes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from taut.base.fields import Choice, Declared, Field, Part
from taut.base.paths import subtree
from taut.base.types import Float64Array, Twist, Wrench
from taut.plant.environments.environment import Environment
from taut.trace import math as tm
from taut.trace.pose import Pose

__all__ = ["Hand", "Oscillation", "Push"]

Values = Mapping[str, Any]
GRIP: Final = 300.0  # [rad/s]


class Oscillation(Declared):
    """What a hand wants over time, at one frequency.

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

    The mass has a motion of its own, p_h and v_h, and the grip is a stiff spring and damper: a mass that answered
    to the tool's acceleration in the same instant would be an algebraic loop in every engine but one's own. What is
    measured differs from a rigid grip by (omega / grip)^2, 0.4 % at 20 rad/s. It has inertia, and no weight:
    give that to the arm's payload.

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

    In each step acts the mean of the pulse over that step, so that its impulse is exact however long the steps are.
    (In the smooth integrator rk4 it comes half a step early.) A push that comes again, or at a time that is not known
    yet, gets another t by an event: see `taut.Event.push`.

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
