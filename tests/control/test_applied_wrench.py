"""A wrench beside an impedance: the force in contact, the speed without, frames, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from refusals import refused

import taut
from taut import JointMotion, Pose, RigidPlant, TaskMotion
from taut.errors import RangeError, UsageError
from taut.laws import AppliedWrench, Impedance

SOFT = {"K": [500.0, 500.0, 0.0, 30.0, 30.0, 30.0], "B": [60.0, 60.0, 20.0, 4.0, 4.0, 4.0]}  # free along z


def tool_speeds(arm, run, every=4):
    rows = zip(run.q[::every], run.v[::every], strict=True)
    return np.array([np.asarray(taut.snapshot(arm, q).J()) @ v for q, v in rows])


@pytest.mark.part(1)
@pytest.mark.parametrize("name", ["ur10", "panda", "kinova"])
@pytest.mark.parametrize("part", [0, 3])
def test_without_contact_the_tool_goes_no_faster_than_stated(name, part, share):
    """Along a random force, or moment, without a spring and nearly without a damper."""
    arm, rng = taut.load_arm(name), np.random.default_rng(part)
    for _ in range(share(30)):
        rate, q = float(rng.choice([250.0, 500.0, 1000.0])), arm.home + rng.uniform(-0.2, 0.2, arm.n)
        u, x = rng.standard_normal(3), taut.snapshot(arm, q)
        u /= np.linalg.norm(u)
        J, at = np.asarray(x.J()), slice(part, part + 3)
        mobility = (J @ np.linalg.solve(np.asarray(x.M), J.T))[at, at]
        speed = np.array([0.05, 0.2])
        largest = 0.49 * speed[part // 3] * rate / np.linalg.norm(mobility @ u)
        F = np.zeros(6)
        F[at] = u * rng.uniform(0.2, 1.0) * largest
        B = 0.02 * np.linalg.inv(np.diag(np.diag(J @ np.linalg.solve(np.asarray(x.M), J.T))))
        law = AppliedWrench(law=Impedance(K=(0.0, 0.0), B=np.diag(B)), speed=speed)
        ref = taut.pressing(TaskMotion(pose=x.T()), F_app=F)
        run = taut.run(taut.compile(law, arm, rate=rate), RigidPlant(arm, friction=None), ref, q0=q, duration=0.6)
        along = tool_speeds(arm, run)[:, at] @ u
        assert run.outcome.ok
        assert along.max() < 1.2 * speed[part // 3]
        assert along.max() > 0.5 * speed[part // 3]


def test_the_motion_without_the_bound_is_much_faster():
    """The test of the speed sees it: with a bound that is far away the same force gives more."""
    arm = taut.load_arm("panda")
    law = AppliedWrench(law=Impedance(K=(0.0, 0.0), B=(0.1, 0.01)), speed=(50.0, 50.0))
    ref = taut.pressing(TaskMotion(pose=taut.snapshot(arm, arm.home).T()), F_app=[0, 0, -10.0, 0, 0, 0])
    run = taut.run(taut.compile(law, arm), RigidPlant(arm, friction=None), ref, duration=0.4)
    assert tool_speeds(arm, run)[:, :3].min() < -0.3


@pytest.mark.part(1)
@pytest.mark.parametrize("engine", ["native", "float"])
def test_in_contact_the_environment_gets_the_wrench(engine):
    """On a wall that the law does not know, 2 cm below, met at the stated speed."""
    arm = taut.load_arm("panda")
    T = taut.snapshot(arm, arm.home).T()
    wall = taut.environments.StiffWall(point=T.p - [0, 0, 0.02], normal=[0, 0, 1], stiffness=5e3, damping=50.0)
    law = AppliedWrench(law=Impedance(**SOFT), speed=(0.05, 0.2))
    ctrl = taut.compile(law, arm, engine=engine)
    ref = taut.pressing(TaskMotion(pose=T), F_app=[0, 0, -10.0, 0, 0, 0])
    plant = RigidPlant(arm, friction=None, environment=wall)
    run = taut.run(ctrl, plant, ref, duration=1.0 if engine == "native" else 0.05)
    if engine == "native":
        np.testing.assert_allclose(run.extra["F_ext"][-1], [0, 0, 10.0, 0, 0, 0], atol=0.02)
    else:
        other = taut.run(taut.compile(law, arm), plant, ref, duration=0.05)
        np.testing.assert_allclose(run.q, other.q, atol=1e-10)
    np.testing.assert_allclose(sum(run.terms.values()), run.command, atol=1e-9)


@pytest.mark.part(1)
@pytest.mark.parametrize("name", ["panda", "ur10", "xarm7", "fr3"])
def test_the_example_of_the_page_presses_with_light_wrists_too(name):
    arm = taut.load_arm(name)
    T = taut.snapshot(arm, arm.home).T()
    wall = taut.environments.StiffWall(point=T.p - [0, 0, 0.02], normal=[0, 0, 1], stiffness=5e3, damping=50.0)
    law = AppliedWrench(law=Impedance(K=[500, 500, 1, 30, 30, 30], zeta=1.0), speed=(0.05, 0.2))
    ref = taut.pressing(TaskMotion(pose=T), F_app=[0, 0, -10.0, 0, 0, 0])
    run = taut.run(taut.compile(law, arm), RigidPlant(arm, friction=None, environment=wall), ref, duration=1.0)
    assert run.info.stability.stable
    assert abs(run.extra["F_ext"][-1, 2] - 10.0) < 0.05


def test_a_spring_along_it_holds_it():
    arm = taut.load_arm("panda")
    T = taut.snapshot(arm, arm.home).T()
    law = AppliedWrench(law=Impedance(K=(500.0, 30.0), zeta=1.0), speed=(0.2, 0.5))
    ref = taut.pressing(TaskMotion(pose=T), F_app=[0, 10.0, 0, 0, 0, 0.3])
    run = taut.run(taut.compile(law, arm), RigidPlant(arm, friction=None), ref, duration=3.0)
    end = taut.snapshot(arm, run.q[-1]).T()
    np.testing.assert_allclose(end.p - T.p, [0.0, 10.0 / 500.0, 0.0], atol=1e-5)
    turn = end.R @ T.R.T
    assert 0.5 * (turn[1, 0] - turn[0, 1]) == pytest.approx(0.3 / 30.0, rel=1e-3)


def test_frames_name_the_axes_of_the_wrench():
    arm, rng = taut.load_arm("ur10"), np.random.default_rng(0)
    q, v = arm.home + 0.1, 0.1 * rng.standard_normal(6)
    T, F = taut.snapshot(arm, q).T(), rng.standard_normal(6)
    goal = Pose(p=T.p, R=T.R @ taut.Pose(rpy=[0.1, -0.2, 0.3]).R)
    R = {"world": np.eye(3), "task": goal.R, "tool": T.R}
    given = {}
    for frame, turn in R.items():
        own = np.concatenate([turn.T @ F[:3], turn.T @ F[3:]])
        law = AppliedWrench(law=Impedance(K=(500.0, 30.0), zeta=1.0), speed=(5.0, 50.0), frame=frame)
        given[frame] = taut.compile(law, arm).step(q, v, taut.pressing(TaskMotion(pose=goal), F_app=own))
    np.testing.assert_allclose(given["task"], given["world"], atol=1e-10)
    np.testing.assert_allclose(given["tool"], given["world"], atol=1e-10)
    plain = taut.compile(Impedance(K=(500.0, 30.0), zeta=1.0), arm).step(q, v, TaskMotion(pose=goal))
    at_rest = taut.compile(law, arm).step(q, v, taut.pressing(TaskMotion(pose=goal), F_app=np.zeros(6)))
    np.testing.assert_allclose(at_rest, plain, atol=1e-12)


def test_a_moving_reference_is_no_speed_and_the_wrench_changes_in_time():
    arm = taut.load_arm("panda")
    T = taut.snapshot(arm, arm.home).T()

    class Growing:
        """Down at 0.1 m/s, with a force that grows."""

        def at(self, t):
            pose = Pose(p=T.p - np.array([0.0, 0.0, 0.1 * t]), R=T.R)
            return taut.pressing(TaskMotion(pose=pose, twist=[0, 0, -0.1, 0, 0, 0]), F_app=[0, 0, -20.0 * t, 0, 0, 0])

    ctrl = taut.compile(AppliedWrench(law=Impedance(**SOFT), speed=(0.02, 0.2)), arm)
    ref = Growing()
    x = taut.snapshot(arm, arm.home)
    v = np.linalg.lstsq(np.asarray(x.J()), ref.at(0.0).motion.twist, rcond=None)[0]
    for t in (0.1, 0.5):
        ctrl.step(arm.home, v, ref.at(t))
        np.testing.assert_allclose(ctrl.terms["applied"], np.asarray(x.J()).T @ [0, 0, -20.0 * t, 0, 0, 0], atol=1e-6)


@pytest.mark.parametrize(
    ("make", "kind"),
    [
        (lambda: AppliedWrench(law=taut.laws.PID(kp=1.0), speed=(0.1, 1.0)), UsageError),
        (lambda: AppliedWrench(law=Impedance(K=(5.0, 1.0), B=(1.0, 1.0), D=(5.0, 1.0)), speed=(0.1, 1.0)), UsageError),
        (lambda: AppliedWrench(law=Impedance(**SOFT), speed=(0.0, 1.0)), RangeError),
    ],
)  # fmt: skip
def test_what_has_no_meaning_is_refused(make, kind):
    with refused(kind):
        make()


@pytest.mark.part(1)
@pytest.mark.parametrize(
    ("forces", "kind"),
    [
        ({"press": 5.0}, UsageError),
        ({"lam": [-1.0]}, UsageError),
        ({"F_app": [0, 0, -400.0, 0, 0, 0]}, RangeError),
        ({"F_app": [0, 0, 0, 0, 0, 9.0]}, RangeError),
    ],
)
def test_a_reference_that_it_cannot_follow_is_refused(forces, kind):
    arm = taut.load_arm("panda")
    ctrl = taut.compile(AppliedWrench(law=Impedance(**SOFT), speed=(0.05, 0.2)), arm)
    ref = taut.pressing(TaskMotion(pose=taut.snapshot(arm, arm.home).T()), **forces)
    with refused(kind):
        taut.run(ctrl, RigidPlant(arm), ref, duration=0.1)
    with refused(UsageError):
        ctrl.step(arm.home, np.zeros(7), JointMotion(q=arm.home))
