"""Energy of an arm, of the springs of its impedance and of the tank, over a run with random stiffness and pushes."""

from __future__ import annotations

import warnings

import numpy as np

import taut
from taut.base.types import Float64Array

STEP = 7  # ticks between the rows of a ledger


def excess(
    name: str, seed: int, *, rate: float = 1000.0, damping: float = 1.0, tank: bool = True, push_gain: float = 1.0
) -> Float64Array:
    """(k,) H + E less what it was at the start and less the work of a push [J]: what the tank lets never rise above 0."""
    rng = np.random.default_rng(seed)
    arm = taut.load_arm(name).with_gravity([0.0, 0.0, 0.0])  # whose compensation is held as well
    position = taut.Coordinates.position() if name != "planar2" else taut.Coordinates(
        function=lambda T: taut.math.array([T.p[0], T.p[2]])
    )  # fmt: skip
    k = 3 if name != "planar2" else 2
    top = 1500.0
    spring = taut.laws.Impedance(
        K=np.full(k, 300.0), B=np.full(k, damping * 12.0), error="coordinates", coordinates=position, coriolis="keep",
        null=None,
    )  # fmt: skip
    law = taut.laws.EnergyTank(
        law=spring, capacity=0.3 if tank else 1e6, settle=float(rng.choice([1e-3, 5e-3, 0.05]))
    )
    q0 = arm.home + rng.uniform(-0.08, 0.08, arm.n)
    ref = taut.TaskMotion(pose=taut.snapshot(arm, arm.home).T())
    F = push_gain * np.concatenate([rng.uniform(-15.0, 15.0, 3), np.zeros(3)])
    push = taut.environments.Push(peak=F, t=0.05, duration=0.15, shape="rectangular")
    times = np.sort(rng.choice(np.arange(2, 300), 12, replace=False)) * 1e-3
    stiffness = [rng.uniform(50.0, top, k) for _ in times]
    events = [taut.Event(t=float(t), set={"law.K": K}) for t, K in zip(times, stiffness, strict=True)]
    ctrl = taut.compile(law, arm, rate=rate)
    plant = taut.RigidPlant(arm, friction=None, integrator="rk4", substeps=2, environment=push)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", taut.StabilityWarning)
        run = taut.run(ctrl, plant, ref, q0=q0, v0=rng.uniform(-0.2, 0.2, arm.n), duration=0.35, events=events)
    assert run.outcome.ok
    # The same ticks again: what acts in each.
    again, left = taut.compile(law, arm, rate=rate), list(zip(times, stiffness, strict=True))
    total = []
    for i, (t, q, v) in enumerate(zip(run.t, run.q, run.v, strict=True)):
        while left and t >= left[0][0] - 1e-9:
            again.parameters["law.K"] = left.pop(0)[1]
        again.step(q, v, ref)
        if i % STEP == 0:
            K = np.asarray(again.memory["law.now.K"])
            now = taut.snapshot(arm, q, v)
            own = spring.changed("K", K).energy(now, ref) + now.kinetic_energy
            total.append(float(own) + float(again.memory["law.energy"]) - run.extra["work.environment"][i])
    np.testing.assert_allclose(run.extra["law.energy"][-1], again.memory["law.energy"], atol=1e-9)
    return np.array(total) - total[0]
