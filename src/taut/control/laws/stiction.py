"""Laws against sticking: dither, and gains that are raised near zero velocity (section 10.2.1.4)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from taut.base.checks import one_of, require_positive
from taut.base.errors import RangeError, ShapeError, UsageError
from taut.base.types import Array, Vector
from taut.control.command import Command, Torque
from taut.control.gains import Gain, GainValue
from taut.control.law import Law, MemoryView, call
from taut.control.trajectories.reference import JointMotion
from taut.maths.snapshot import Snapshot
from taut.trace import math as tm

__all__ = ["Dither", "RaisedGains"]

POINTS: Final = ("meas", "ref")
RAISED: Final = ("kp", "kd")
INTEGRAL: Final = "e_int"
TRACKING: Final = "tracking"  # how fast limits drive an integral back [1/s]


class Dither(Law):
    """Dither: a fast torque of zero mean that smooths dry friction; add it to a law: PID(...) + Dither(...).

    Law:          tau = A sin(2 pi f t), each joint on its own
    Closed loop:  that of the law it is added to, with (2 mu / pi) asin(v / V) in place of dry friction mu sign(v)
                  on average, while |v| < V = sqrt(A^2 - (4 mu / pi)^2) / (2 pi f M), what the dither shakes it with
                  that is viscous friction (2 mu / (pi V)) v near rest, which holds no joint, but slows it down
                  it needs A well above the static friction, and f well above what the loop follows

    The frequency must be below half the rate of the controller, where a sampled sine is no sine any more. Another
    frequency in a run is another phase at once; `Limits(blend=)` takes the jump up.

    References:
        Section 10.2.1.4 a closer look at friction. Armstrong-Helouvry, Dupont and Canudas de Wit (1994), section 4.
    """

    ignores_reference = True
    amplitude: Gain  # [N m | N]
    frequency: Gain  # [Hz]

    def __post_init__(self) -> None:
        for name in ("amplitude", "frequency"):
            _require_per_joint(name, getattr(self, name))

    def check_rate(self, rate: float) -> None:
        require_positive("frequency", np.asarray(self.frequency.as_array()), unit="Hz")
        largest = float(np.max(self.frequency.as_array()))
        if largest >= rate / 2.0:
            raise RangeError(
                f"frequency of a Dither must be below {rate / 2.0:g} [Hz], half the rate of {rate:g} Hz; got "
                f"{largest:g}; lower it, or compile with a higher rate",
                name="frequency",
                value=largest,
            )

    def command(self, x: Snapshot, ref: JointMotion) -> Command:  # noqa: ARG002
        cycles = np.ones(x.n) * (self.frequency.as_array() * x.t)
        wave = tm.sin(2.0 * np.pi * (cycles - tm.floor(cycles)))  # of what is left of whole turns: exact for hours
        return Torque(dither=self.amplitude @ wave)


class RaisedGains(Law):
    """Larger gains near zero velocity, against sticking: holds a law and raises its gains where the arm rests.

    Law:          that of the law it holds, with s kp and s kd in place of kp and kd, and int(s e) in place of int(e)
                  s = 1 + (factor - 1) exp(-(v* / width)^2), joint by joint, v* the measured or the desired velocity
    Closed loop:  that of the law it holds where |v*| is some widths; at rest that with kp, kd and ki times the factor
                  there dry friction leaves an error of up to mu / (factor kp) in place of mu / kp
                  the integral changes faster near rest, and does not jump or breathe with v; neither does the torque
                  at="meas": v* changes with the motion, and s kp e is a stiffness that falls as the joint moves off

    It raises gains named kp and kd, also of the laws in a sum, and what is integrated into a memory named e_int;
    other gains are left as they are. A matrix K becomes S K S with S the root of diag(s).

    References:
        Section 10.2.1.4 a closer look at friction.
    """

    inner: Law
    factor: Gain = Gain(minimum=1.0)
    width: Gain = Gain(0.05, minimum=1e-9)  # [rad/s | m/s]
    at: str = "meas"

    def __post_init__(self) -> None:
        one_of("at", self.at, POINTS)
        for name in ("factor", "width"):
            _require_per_joint(name, getattr(self, name))
        if not isinstance(self.inner, Law):
            raise UsageError(
                f"RaisedGains holds a law: inner=taut.laws.PID(...); got {type(self.inner).__name__}", name="inner"
            )
        if not _raised(self.inner):
            raise UsageError(
                f"RaisedGains raises kp and kd, and {type(self.inner).__name__} has neither; leave the wrapper out",
                name="inner",
            )
        if self.at == "ref" and self.inner.reference is not JointMotion:
            raise UsageError(
                f"at='ref' takes the velocity of a JointMotion, and {type(self.inner).__name__} follows a "
                f"{self.inner.reference.__name__}; use at='meas'",
                name="at",
            )
        object.__setattr__(self, "reference", self.inner.reference)

    def check_rate(self, rate: float) -> None:
        """The integral is driven back faster too, and not faster than the rate [Hz]."""
        factor = float(np.max(self.factor.as_array()))
        rates = [gain for path, gain in self.inner.parameters().items() if path.rpartition(".")[2] == TRACKING]
        largest = max((float(np.max(gain)) for gain in rates), default=0.0)
        if factor * largest > rate:
            raise RangeError(
                f"tracking of a law whose gains are raised must be at most the rate over the factor, "
                f"{rate / factor:g} [1/s], or its integral would swing near rest; got {largest:g}",
                name="inner.tracking",
                value=largest,
            )

    def command(self, x: Snapshot, ref: Any, memory: MemoryView, dt: float) -> tuple[Command, dict[str, Any]]:
        v = ref.v if self.at == "ref" else x.v
        ratio = v / self.width.as_array()
        s = 1.0 + (self.factor.as_array() - 1.0) * tm.exp(-ratio * ratio)
        raised = {path: _scaled(gain, s) for path, gain in _raised(self.inner).items()}
        inner = self.inner.bound({**self.inner.parameters(), **raised})
        before = memory["inner"]
        command, after = call(inner, x, ref, before, dt)
        return command, {"inner": _faster(before, after, s)}


def _require_per_joint(name: str, gain: GainValue) -> None:
    if gain.ndim == 2:
        raise ShapeError(f"{name} must be a scalar or one per joint; got shape {gain.shape}", name=name)


def _raised(law: Law) -> dict[str, Array]:
    """The gains that are raised, by path."""
    return {path: gain for path, gain in law.parameters().items() if path.rpartition(".")[2] in RAISED}


def _scaled(gain: Array, s: Vector) -> Array:
    """s K joint by joint; a matrix stays symmetric and positive."""
    if gain.ndim < 2:
        out: Array = s * gain
        return out
    root = tm.sqrt(s)
    matrix: Array = root[:, np.newaxis] * gain * root
    return matrix


def _faster(before: Mapping[str, Any], after: Mapping[str, Any], s: Vector) -> dict[str, Any]:
    """Memory in which integrals have changed by s times as much."""
    out: dict[str, Any] = {}
    for name, value in after.items():
        if isinstance(value, Mapping):
            out[name] = _faster(before[name], value, s)
        else:
            out[name] = before[name] + s * (value - before[name]) if name == INTEGRAL else value
    return out
