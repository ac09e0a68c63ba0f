"""Laws that send out what the reference says, and what else the tests of plants share."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

import taut
from taut.base.types import Float64Array
from taut.maths import dynamics as dyn
from taut.maths.model import PayloadValues, model_of

Array = Float64Array
TINY = 2.0**-60  # a power of two, so that what is hidden in a torque with it comes back exactly


class TorqueOf(taut.Law):
    """The torque that stands in the reference's acceleration."""

    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        return taut.Torque(wanted=ref.a)


class VelocityOf(taut.Law):
    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Velocity:
        return taut.Velocity(wanted=ref.v)


class PositionOf(taut.Law):
    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Position:
        return taut.Position(wanted=ref.q)


class Seen(taut.Law):
    """The reference's torque, and what the law sees of q, v and tau, hidden in terms that move nothing."""

    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        return taut.Torque(wanted=ref.a, q=x.q * TINY, v=x.v * TINY, tau=x.tau_meas * TINY)


def seen(run: taut.Run, name: str) -> Array:
    return run.terms[name] / TINY


def run(
    plant: taut.RigidPlant,
    ref: object = None,
    *,
    law: taut.Law | None = None,
    duration: float = 1.0,
    rate: float = 1000.0,
    arm: taut.Arm | None = None,
    q0: object = None,
    v0: object = None,
    seed: int = 0,
    engine: str = "auto",
    events: list[taut.Event] | None = None,
) -> taut.Run:
    """A run of a plant under the torques, velocities or positions of the reference; by default under none."""
    made = {"torque": TorqueOf, "velocity": VelocityOf, "position": PositionOf}[plant.takes]() if law is None else law
    ctrl = taut.compile(made, arm or plant.arm, rate=rate, adds=plant.adds, engine=engine)
    out = taut.run(ctrl, plant, ref, duration=duration, q0=q0, v0=v0, seed=seed, events=events)
    assert out.outcome.ok, out.outcome
    return out


def accelerations(arm: taut.Arm, friction: bool = False) -> Callable[[float, Array], Array]:
    """The right-hand side of the arm's equations of motion, for SciPy; the state is (q, v)."""
    model, n = model_of(arm), arm.n
    load = PayloadValues(mass=arm.payload.mass, com=arm.payload.com, inertia=arm.payload.inertia)
    damping = arm.viscous if friction else np.zeros(n)

    def rates(state: Array) -> Array:
        q, v = state[:n], state[n:]
        a = dyn.forward_dynamics(model, q, v, -damping * v, load)
        return taut.math.array([*v, *a])

    compiled = taut.native(rates, state=2 * n)
    return lambda t, state: compiled(state)


def energy(arm: taut.Arm, q: Array, v: Array) -> Array:
    """Kinetic and potential energy of each row."""
    model = model_of(arm)
    load = PayloadValues(mass=arm.payload.mass, com=arm.payload.com, inertia=arm.payload.inertia)
    return np.array(
        [
            float(dyn.kinetic_energy(model, a, b, load) + dyn.potential_energy(model, a, load))
            for a, b in zip(q, v, strict=True)
        ]
    )
