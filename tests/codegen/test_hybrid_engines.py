"""Hybrid motion-force control in native code and as floats, at constraints of every kind."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import taut
from taut import Constraint, Pose
from taut import math as tm

SAME = 1e-9  # of task laws, relative to the largest torque, with default damping
UNDAMPED = 1e-15  # times the condition of what is inverted without: A M^-1 A^T, where the rows lose their rank
CENTER, AXIS = [0.4, 0.1, 0.2], [0.2, 0.9, 0.4]
CONSTRAINTS: dict[str, Constraint] = {
    "face": Constraint.plane(point=CENTER, normal=AXIS, face=[0.0, 0.0, 1.0]),
    "cylinder": Constraint.cylinder(point=CENTER, axis=AXIS, radius=0.1),
    "moving sphere": Constraint(lambda T, t: tm.norm(T.p - tm.array([0.4, 0.1 * t, 0.2])) - 0.2, one_sided=True),
    "hinge": Constraint.hinge(point=CENTER, axis=AXIS, T=Pose([0.5, 0.2, 0.4], rpy=[0.3, 2.0, 0.1])),
    "wheel": Constraint.plane(point=CENTER, normal=[0, 0, 1])
    + Constraint.pfaffian(lambda T: tm.array([*T.R[:, 1], 0.0, 0.0, 0.0])),
}


@pytest.mark.bars
@pytest.mark.parametrize(
    "name", ["xarm7", *(pytest.param(name, marks=pytest.mark.long) for name in ("panda", "ur10"))]
)
def test_native_code_gives_what_plain_python_gives(name: str, share: Callable[[int], int], bar: Any) -> None:
    arm, rng = taut.load_arm(name), np.random.default_rng(5)
    worst, near, ticks = 0.0, 0, 0
    for constraint in CONSTRAINTS.values():
        law = taut.laws.HybridMotionForce(
            constraint=constraint,
            motion=taut.laws.TaskComputedTorque(kp=100.0, kd=20.0, ki=10.0),
            kfp=0.4,
            kfi=5.0,
            kdamp=20.0,
            tolerance=np.inf,
        )
        native, plain = (taut.compile(law, arm, engine=engine) for engine in ("native", "float"))  # type: ignore[arg-type]
        largest, found = 0.0, []
        for _ in range(share(share(1000))):  # plain Python takes its time: in the normal run a hundredth
            q, v = np.array(arm.home) + rng.uniform(-0.8, 0.8, arm.n), rng.uniform(-2.0, 2.0, arm.n)
            T = taut.snapshot(arm, q).T()
            motion = taut.TaskMotion(pose=Pose(T.p + 0.01 * rng.normal(size=3), R=T.R), twist=rng.normal(size=6))
            forces = {"press": 10.0} if constraint.one_sided[0] else {"lam": 5.0 * rng.normal(size=constraint.count)}
            ref, F = taut.pressing(motion, **forces), 10.0 * rng.normal(size=6)  # type: ignore[arg-type]
            wanted, got = plain.step(q, v, ref, F_ext=F), native.step(q, v, ref, F_ext=F)
            x = taut.snapshot(arm, q)
            A = np.asarray(constraint.at(x).A_q, dtype=np.float64)
            found.append((np.linalg.cond(A @ np.linalg.solve(x.M, A.T)), float(np.abs(got - wanted).max())))
            largest = max(largest, float(np.abs(wanted).max()))
            ticks += 1
        for condition, error in found:
            if condition * UNDAMPED > SAME:
                near += 1
                assert error < condition * UNDAMPED * largest
            else:
                worst = max(worst, error / largest)
    bar(
        f"hybrid, {name}: native code against plain Python, {ticks} ticks at {len(CONSTRAINTS)} constraints",
        f"{worst:.1e}",
    )
    bar(f"hybrid, {name}: ticks of these with cond(A M^-1 A^T) > 1e6, within 1e-15 cond", f"{near} of {near}")
    assert worst < SAME
