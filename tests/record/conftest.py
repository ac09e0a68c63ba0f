"""Runs to look at: made by hand, and from a real loop."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import taut
from taut.record.info import RunInfo

MakeRun = Callable[..., taut.Run]


@pytest.fixture
def make_run() -> MakeRun:
    """A run of given arrays; what is left out is zero."""

    def make(t: Any, q: Any, **others: Any) -> taut.Run:
        t = np.asarray(t, dtype=np.float64)
        q = np.asarray(q, dtype=np.float64)
        q = q[:, np.newaxis] if q.ndim == 1 else q
        n = q.shape[1]
        zero = np.zeros_like(q)
        wanted = np.broadcast_to(np.asarray(others.pop("q_ref", 0.0), dtype=np.float64), q.shape)
        speed = np.broadcast_to(np.asarray(others.pop("v_ref", 0.0), dtype=np.float64), q.shape)
        values: dict[str, Any] = {
            "v": zero,
            "tau": zero,
            "command": zero,
            "terms": {},
            "reference": taut.JointMotion.of({"q": wanted, "v": speed, "a": zero}),
            "outcome": taut.Outcome(kind="completed", message="completed", tick=len(t) - 1),
            "joint_names": tuple(f"joint{i + 1}" for i in range(n)),
            "units": ("rad",) * n,
            "info": RunInfo(rate=1000.0, law="Law()", arm="arm", plant="plant"),
        }
        return taut.Run(t=t, q=q, **(values | others))

    return make


@pytest.fixture
def noisy_run(make_run: MakeRun) -> taut.Run:
    """A run of random numbers with everything that a run can have, odd floats included."""
    rng = np.random.default_rng(0)
    k, n = 250, 3
    odd = rng.standard_normal((k, n))
    odd[0, 0], odd[1, 1], odd[2, 2], odd[3, 0] = np.nan, np.inf, -0.0, 5e-324
    terms = {name: rng.standard_normal((k, n)) for name in ("P", "D", "torque_limit")}
    return make_run(
        np.arange(k) * 0.001,
        rng.standard_normal((k, n)),
        v=rng.standard_normal((k, n)),
        tau=odd,
        command=sum(terms.values()),
        terms=terms,
        q_ref=rng.standard_normal((k, n)),
        v_ref=rng.standard_normal((k, n)),
        units=("rad", "m", "rad"),
        continuous=(2,),
        joint_names=("shoulder", "slide", "gelenk-ü"),
        extra={"F_ext": rng.standard_normal((k, 6)), "contact": rng.standard_normal(k), "none": np.zeros((k, 0))},
        info=RunInfo(rate=1000.0, law="PID(kp=1)", arm="a", parameters={"law.kp": np.array([1.0, 0.1])}),
    )


@pytest.fixture(scope="session")
def panda_run() -> taut.Run:
    """The Panda along a joint path under computed torque, with limits."""
    arm = taut.load_arm("panda")
    law = taut.laws.ComputedTorque(kp=100.0, kd=20.0)
    ctrl = taut.compile(law, arm, limits=taut.Limits.of(arm))
    path = taut.trajectories.Quintic(q0=arm.home, q1=arm.home + 0.3, duration=0.4)
    return taut.run(ctrl, taut.RigidPlant(arm.with_payload(1.0)), path, duration=0.5)


SCENE = """
<mujoco>
  <worldbody>
    <geom name="board" type="box" size="0.2 0.2 0.05" pos="0 0 -0.05" rgba="1 0 1 1" friction="0.3" priority="1"
          solref="0.005 1" solimp="0 0.9 0.002 0.5 1"/>
    <body name="flap" pos="0.2 -0.2 0.2">
      <joint name="flap" axis="0 1 0" damping="0.01"/>
      <geom type="box" size="0.1 0.02 0.02" pos="0.1 0 0" mass="0.1" rgba="0 1 1 1" contype="0" conaffinity="0"/>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.fixture(scope="session")
def pressing_task() -> taut.Run:
    """A UR5 that comes down on a board of a scene and presses, in two phases; beside it a flap falls on its hinge."""
    arm = taut.load_arm("ur5")
    tip = taut.snapshot(arm, arm.home).T()
    board = taut.Constraint.plane(point=tip.p - [0.0, 0.0, 0.001], normal=[0.0, 0.0, 1.0])
    move = taut.laws.TaskComputedTorque(kp=400.0, kd=40.0)
    hybrid = taut.laws.HybridMotionForce(constraint=board, motion=move, kfi=20.0, kdamp=150.0)
    task = [
        taut.Phase(
            move,
            lambda x: taut.trajectories.Steady(T0=x.T(), velocity=[0.0, 0.0, -0.02]),
            name="approach",
            until=lambda x: taut.guards.contact(x, 1.0),
        ),
        taut.Phase(hybrid, lambda x: taut.pressing(taut.TaskMotion(pose=x.T()), 4.0), name="press", contact=0.01),
    ]
    plant = taut.MujocoPlant(arm, scene=SCENE, scene_at=taut.Pose(tip.p - [0.0, 0.0, 0.011]), friction=None)
    return taut.run(task, plant, duration=0.2)
