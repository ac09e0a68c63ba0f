"""The Lyapunov function of PD control with gravity compensation, along a run: equations 10.24 to 10.27."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final
from weakref import WeakKeyDictionary

import numpy as np

from taut.arm.description import Arm
from taut.base.errors import UsageError
from taut.base.paths import subtree
from taut.base.result import Content, Result, Table
from taut.base.types import Float64Array, Vector
from taut.codegen.engine import Steps, best_engine
from taut.codegen.layout import Block
from taut.codegen.loop import StepLoop
from taut.maths import dynamics as dyn
from taut.maths.model import PayloadValues, model_of
from taut.record.run import Run
from taut.trace.derivative import jacobian

__all__ = ["Lyapunov", "lyapunov"]

LAWS: Final = ("GravityPID", "GravityCompensation")
VISCOUS: Final = "plant.friction.viscous"
ROUNDING: Final = 1e-12  # of V
SAME: Final = 1e-9  # of torques, by which those of two ways differ that are the same
GEARS: Final = "actuation.transmission."


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
        notes: Assumptions of the proof that the run violates, in sentences.
    """

    t: Float64Array
    V: Float64Array
    kinetic: Float64Array
    rate: Float64Array
    expected: Float64Array
    notes: tuple[str, ...] = ()

    @property
    def worst(self) -> float:
        """Largest difference of the rates, over the largest of either: 0 where the proof's assumptions hold."""
        off = float(np.abs(self.rate - self.expected).max(initial=0.0))
        size = max(float(np.abs(x).max(initial=0.0)) for x in (self.expected, self.rate))
        ticks = np.diff(self.t)
        rounding = ROUNDING * float(self.V.max()) / float(ticks[0]) if len(ticks) else 0.0
        return off / size if size > rounding else 0.0

    @property
    def decreases(self) -> bool:
        """V never grows from one tick to the next by more than rounding."""
        return bool((np.diff(self.V) <= ROUNDING * max(float(self.V[0]), 1e-300)).all())

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
            notes=self.notes,
        )


def lyapunov(run: Run) -> Lyapunov:
    """The Lyapunov function 10.24 along a run of PD control with gravity compensation, and its derivative.

    Law:          V = e . Kp e / 2 + v . M v / 2                                                  eq. 10.24
    Closed loop:  V-dot = -v . Kd v for a set-point, an exact g and no other friction              eqs. 10.25 to 10.27
                  M-dot - 2 C is skew, so that the Coriolis torques do no work

    The rate is that at the instant of each tick; between ticks the torque is held, so that V decreases by slightly
    less or more than the integral. A model error of the law, such as another payload, shows as a difference of the
    rates.

    Args:
        run: Of `GravityPID` with ki = 0 or `GravityCompensation`, on a plant with viscous friction at most.

    Raises:
        UsageError: A run of another law, with an integral, with a reference that moves, with events, with dry
            friction or gears that lose power or give way, on a plant that compensates gravity itself, or that was
            loaded from a file and has no arm.

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
    if not isinstance(run, Run):  # callers without a type checker
        raise UsageError(f"lyapunov takes a taut.Run; got {type(run).__name__}", name="run")
    law, values = run.info.law.partition("(")[0], run.info.parameters
    _check(run, law, values)
    n = run.n
    assert run.arm is not None
    kp, viscous = _matrix(values.get("law.kp", 0.0), n), np.broadcast_to(values.get(VISCOUS, 0.0), (n,))
    kd = _matrix(values["law.kd"], n) + np.diag(viscous)
    e = np.zeros_like(run.q) if law == "GravityCompensation" else run.error
    assert e is not None
    kinetic, rate, g = _energies(run.arm).of(run, viscous, subtree(values, "plant.payload"))
    if g.any() and not run.terms["gravity"].any():
        raise UsageError(
            "eq. 10.24 is of a law that compensates gravity, and in this run the plant did; make both without adds",
            name="run",
        )
    return Lyapunov(
        t=run.t,
        V=0.5 * np.einsum("ki,ij,kj->k", e, kp, e) + kinetic,
        kinetic=kinetic,
        rate=rate - np.einsum("ki,ij,kj->k", e, kp, run.v),
        expected=-np.einsum("ki,ij,kj->k", run.v, kd, run.v),
        notes=tuple(_broken(run, g)),
    )


def _broken(run: Run, g: Float64Array) -> Iterator[str]:
    """Assumptions of the proof that a run violates, as far as its record shows."""
    if not run.outcome.ok:
        yield f"the run ended in a fault: {run.outcome}"

    def far(one: Float64Array, other: Float64Array) -> bool:
        return bool(np.abs(one - other).max(initial=0.0) > SAME * max(1.0, float(np.abs(other).max(initial=0.0))))

    if far(run.terms["gravity"], g):
        yield "the law's g is not that of the arm: masses, a payload or a direction of gravity that it does not know"
    if far(np.sum([run.terms[name] for name in ("P", "D", "gravity") if name in run.terms], axis=0), run.command):
        yield "limits of the controller cut or changed what the law commands"
    if far(run.tau, run.command):
        yield "the torque is not what is commanded: the drives give it late, or not all of it"


class _Energies:
    """The kinetic energy of an arm, its rate under the torques that act, and its weight, of all ticks at once."""

    def __init__(self, arm: Arm) -> None:
        n = arm.n
        self._inputs = Block.of({"q": (n,), "v": (n,), "tau": (n,)})
        self._numbers = Block.of({"viscous": (n,), "mass": (), "com": (3,), "inertia": (6,)})
        self._model = model_of(arm)
        example = np.cos(np.arange(self._inputs.size)), np.ones(self._numbers.size), np.zeros(0)
        steps = Steps(self._step, self._inputs, self._numbers, Block())
        self._loop = StepLoop(steps, example, engine=best_engine())

    def _step(
        self, inputs: Mapping[str, Any], numbers: Mapping[str, Any], memory: Mapping[str, Any]
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        q, v = inputs["q"], inputs["v"]
        payload = PayloadValues.of(numbers)

        def kinetic(s: Vector) -> Any:
            return 0.5 * (v @ (dyn.mass_matrix(self._model, q + s[0] * v, payload) @ v))

        push = inputs["tau"] - dyn.bias(self._model, q, v, payload) - numbers["viscous"] * v
        moved = jacobian(kinetic, np.zeros(1))[0]  # v . M-dot v / 2
        g = dyn.gravity_torque(self._model, q, payload)
        return {"kinetic": kinetic(np.zeros(1)), "rate": v @ push + moved, "g": g}, {**memory}

    def of(
        self, run: Run, viscous: Float64Array, payload: Mapping[str, Any]
    ) -> tuple[Float64Array, Float64Array, Float64Array]:
        """(k,) [J] and (k,) [W], and (k, n) the weight [N m | N]."""
        rows, found = np.hstack([run.q, run.v, run.tau]), np.zeros((len(run), self._loop.outputs.size))
        numbers = self._numbers.pack({"viscous": viscous, **payload})
        self._loop.run(rows, numbers, np.zeros(0), found)
        views = self._loop.outputs.views(found)
        return views["kinetic"], views["rate"], views["g"]


_ENERGIES: Final[WeakKeyDictionary[Arm, _Energies]] = WeakKeyDictionary()


def _energies(arm: Arm) -> _Energies:
    """Those of an arm, compiled once however often they are asked for."""
    known = _ENERGIES.get(arm)
    if known is None:
        known = _ENERGIES[arm] = _Energies(arm)
    return known


def _check(run: Run, law: str, values: Any) -> None:
    if law not in LAWS or "law.kd" not in values:
        raise UsageError(
            f"eq. 10.24 is for PD control with gravity compensation, {' or '.join(LAWS)} alone; this run is of "
            f"{run.info.law or '?'}",
            name="run",
        )
    if np.any(np.asarray(values.get("law.ki", 0.0))):
        raise UsageError(f"eq. 10.24 is for ki = 0; this run has law.ki = {values['law.ki']}", name="law.ki")
    if run.arm is None:
        raise UsageError("this run was loaded from a file and has no arm; make it anew with taut.run", name="run")
    if run.info.events:
        raise UsageError("eq. 10.24 is for gains that stay, and this run has events; run it without", name="run")
    wanted, rate = getattr(run.reference, "q", None), getattr(run.reference, "v", None)
    moves = wanted is not None and np.ptp(wanted, axis=0).max() > 0.0
    if law == "GravityPID" and (moves or (rate is not None and np.any(rate))):
        raise UsageError("eq. 10.24 is for a set-point, and the reference of this run moves", name="run")
    dry = [path for path in values if path.startswith("plant.friction.") and path != VISCOUS]
    if dry:
        raise UsageError(
            f"eq. 10.27 is without dry friction, and the plant has {', '.join(sorted(dry))}; run it with "
            "friction=None",
            name="run",
        )
    if any(path.startswith(GEARS) for path in values):
        raise UsageError(
            "eq. 10.27 is without losses, backlash and elasticity of gears; run it on a plant without a transmission",
            name="run",
        )
    if any(path.startswith(("environment.", "contact.")) for path in values):
        raise UsageError("eq. 10.27 is of an arm without contact, and this plant has an environment", name="run")


def _matrix(value: Any, n: int) -> Float64Array:
    given = np.asarray(value, dtype=np.float64)
    return given if given.ndim == 2 else np.diag(np.broadcast_to(given, (n,)))
