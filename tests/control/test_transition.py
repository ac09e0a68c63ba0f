"""Motions from a moving state: continuity at the switch, limits at their extremes, and a run that changes its goal."""

from __future__ import annotations

import numpy as np
import pytest
from refusals import refused

import taut
from taut import JointMotion, Pose, TaskMotion
from taut.errors import RangeError, ShapeError, UsageError
from taut.trajectories import Line, Quintic, Transition

FINE = 20001


def samples(motion, fields):
    rows = motion.rows(np.linspace(0.0, motion.duration, FINE))
    return [getattr(rows, name) for name in fields]


def peaks(motion):
    """Largest speed and acceleration of each joint, or (linear, angular) of the tool."""
    if isinstance(motion.start, JointMotion):
        return [np.abs(x).max(axis=0) for x in samples(motion, "va")]
    return [
        np.array([np.linalg.norm(x[:, part], axis=1).max() for part in (slice(0, 3), slice(3, 6))])
        for x in samples(motion, ("twist", "acceleration"))
    ]


def random_pose(rng, centre=(0.4, 0.0, 0.4)):
    return Pose(p=np.array(centre) + rng.uniform(-0.2, 0.2, 3), rpy=rng.uniform(-0.8, 0.8, 3))


def test_from_rest_it_is_the_motion_that_was_there():
    q0, q1 = [0.0, 0.3], [1.0, 0.1]
    old, new = (
        Quintic(q0=q0, q1=q1, duration=1.5),
        Transition(start=JointMotion(q=q0), goal=JointMotion(q=q1), duration=1.5),
    )
    t = np.linspace(-0.2, 1.7, 77)
    for name in "qva":
        np.testing.assert_allclose(getattr(new.rows(t), name), getattr(old.rows(t), name), atol=1e-13)
    T0, T1 = Pose([0.4, 0.0, 0.3]), Pose(p=[0.4, 0.2, 0.3], rpy=[0.5, 0.2, 0.1])
    limits = {"velocity": (0.5, 1.0), "acceleration": (2.0, 5.0)}
    line = Line(T0=T0, T1=T1, **limits)
    tool = Transition(start=TaskMotion(pose=T0), goal=TaskMotion(pose=T1), **limits)
    assert tool.duration == pytest.approx(line.duration, rel=1e-8)
    np.testing.assert_allclose(tool.at(0.4).twist, line.at(0.4).twist, atol=1e-7)


def test_joints_keep_their_limits_from_any_state_within_them_and_use_them(share):
    rng, used = np.random.default_rng(0), []
    for _ in range(share(300)):
        n = int(rng.integers(1, 8))
        v, a = rng.uniform(0.5, 3.0, n), rng.uniform(2.0, 20.0, n)
        start = JointMotion(
            q=rng.uniform(-1, 1, n), v=v * rng.uniform(-0.95, 0.95, n), a=a * rng.uniform(-1.0, 1.0, n)
        )
        goal = JointMotion(q=rng.uniform(-1, 1, n))
        move = Transition(start=start, goal=goal, velocity=v, acceleration=a)
        first, last = move.at(0.0), move.at(move.duration)
        for name in "qva":
            np.testing.assert_allclose(getattr(first, name), getattr(start, name), atol=1e-9)
            np.testing.assert_allclose(getattr(last, name), getattr(goal, name), atol=1e-8)
        speed, acceleration = peaks(move)
        assert (speed <= v * (1.0 + 2e-9)).all()
        assert (acceleration <= a * (1.0 + 2e-9)).all()
        used.append(max(np.max(speed / v), np.max(acceleration / a)))
        q, rate = samples(move, "qv")
        dt = move.duration / (FINE - 1)
        np.testing.assert_allclose(np.gradient(q, dt, axis=0)[1:-1], rate[1:-1], atol=1e-4 * v.max())
        assert np.abs(np.diff(rate, axis=0)).max() <= 1.001 * a.max() * dt  # also where the two pieces meet
    assert min(used) > 0.999


def test_the_tool_keeps_its_limits_and_begins_with_the_twist(share):
    rng = np.random.default_rng(1)
    for _ in range(share(100)):
        limits = {"velocity": rng.uniform(0.3, 1.0, 2), "acceleration": rng.uniform(2.0, 6.0, 2)}
        old = Transition(start=TaskMotion(pose=random_pose(rng)), goal=TaskMotion(pose=random_pose(rng)), **limits)
        start = old.at(rng.uniform(0.05, 0.95) * old.duration)
        new = Transition(start=start, goal=TaskMotion(pose=random_pose(rng)), **limits)
        for name in ("p", "R", "twist", "acceleration"):
            np.testing.assert_allclose(getattr(new.at(0.0), name), getattr(start, name), atol=1e-9)
        end = new.at(new.duration)
        np.testing.assert_allclose(end.pose.R, new.goal.pose.R, atol=1e-12)
        np.testing.assert_allclose(end.twist, 0.0, atol=1e-9)
        speed, acceleration = peaks(new)
        assert (speed <= limits["velocity"] * (1.0 + 1e-5)).all()
        assert (acceleration <= limits["acceleration"] * (1.0 + 1e-5)).all()
        p, R, twist = samples(new, ("p", "R", "twist"))
        dt = new.duration / (FINE - 1)
        turned = np.einsum("kij,kmj->kim", np.gradient(R, dt, axis=0), R)  # the skew matrix of omega
        omega = np.stack([turned[:, 2, 1], turned[:, 0, 2], turned[:, 1, 0]], axis=1)
        np.testing.assert_allclose(omega[1:-1], twist[1:-1, 3:], atol=1e-3)
        np.testing.assert_allclose(np.gradient(p, dt, axis=0)[1:-1], twist[1:-1, :3], atol=1e-3)


def test_it_ends_in_a_state_that_moves():
    start, goal = JointMotion(q=[0.0], v=[0.5], a=[1.0]), JointMotion(q=[1.0], v=[-0.4], a=[2.0])
    move = Transition(start=start, goal=goal, velocity=3.0, acceleration=9.0)
    end = move.at(move.duration)
    assert [end.q[0], end.v[0], end.a[0]] == pytest.approx([1.0, -0.4, 2.0])
    T = random_pose(np.random.default_rng(3))
    twist = np.array([0.1, 0.0, -0.1, 0.2, 0.1, -0.3])
    tool = Transition(
        start=TaskMotion(pose=Pose([0.4, 0.0, 0.3])), goal=TaskMotion(pose=T, twist=twist), duration=1.0
    )
    np.testing.assert_allclose(tool.at(1.0).twist, twist, atol=1e-12)


@pytest.mark.part(1)
@pytest.mark.parametrize("name", ["ur10", "panda"])
@pytest.mark.parametrize("tool", [False, True])
def test_a_new_goal_in_mid_motion_makes_no_jump_of_torque(tool, name):
    """Against the same change of goal by a motion that begins at rest."""
    arm = taut.load_arm(name)
    if tool:
        law = taut.laws.TaskComputedTorque(kp=400.0, kd=40.0)
        T = taut.snapshot(arm, arm.home).T()
        at = [
            TaskMotion(pose=Pose(p=T.p + np.array(d), R=T.R))
            for d in ([0.0, 0.0, 0.0], [0.0, 0.2, 0.1], [0.1, -0.2, 0.0])
        ]
        limits = {"velocity": (0.6, 2.0), "acceleration": (3.0, 8.0)}
    else:
        law = taut.laws.ComputedTorque(kp=400.0, kd=40.0)
        at = [JointMotion(q=arm.home + d) for d in (0.0, 0.4, -0.3)]
        limits = {"velocity": 1.0, "acceleration": 5.0}
    first = Transition(start=at[0], goal=at[1], **limits)
    t = 0.001 * round(400.0 * first.duration)
    moving = Transition(start=first.at(t), goal=at[2], **limits)
    here = first.at(t)
    rest = TaskMotion(pose=here.pose) if tool else JointMotion(q=here.q)
    ctrl, plant, jumps = taut.compile(law, arm), taut.RigidPlant(arm), []
    for second in (moving, Transition(start=rest, goal=at[2], **limits)):
        ref = taut.stream(period=0.001, source=lambda x, m=second: first.at(x.t) if x.t < t - 5e-4 else m.at(x.t - t))
        run = taut.run(ctrl, plant, ref, duration=0.8)
        k = round(1000 * t)
        steps = np.abs(np.diff(run.tau, axis=0)).max(axis=1)
        jumps.append(steps[k - 2 : k + 2].max() / np.median(steps[: k - 5]))
    assert jumps[0] < 5.0
    assert jumps[1] > 50.0


@pytest.mark.parametrize(
    ("make", "kind"),
    [
        (lambda q: Transition(start=q, goal=q), UsageError),
        (lambda q: Transition(start=q, goal=q, duration=1.0, velocity=1.0, acceleration=1.0), UsageError),
        (lambda q: Transition(start=q, goal=q, velocity=1.0), UsageError),
        (lambda q: Transition(start=q, goal=JointMotion(q=[0.0]), duration=1.0), ShapeError),
        (lambda q: Transition(start=q, goal=TaskMotion(pose=Pose([0, 0, 0])), duration=1.0), UsageError),
        (lambda q: Transition(start=q, goal=q, velocity=[1.0] * 3, acceleration=1.0), ShapeError),
        (lambda q: Transition(start=JointMotion(q=q.q, v=[3.0, 0.0]), goal=q, velocity=2.0, acceleration=9.0), RangeError),
        (lambda q: Transition(start=JointMotion(q=q.q, a=[0.0, 9.0]), goal=q, velocity=2.0, acceleration=6.0), RangeError),
        (lambda q: Transition(start=q, goal=q, duration=0.0), RangeError),
    ],
)  # fmt: skip
def test_what_has_no_meaning_is_refused(make, kind):
    with refused(kind):
        make(JointMotion(q=[0.0, 0.0]))


def test_a_motion_to_where_it_is_takes_no_time_to_speak_of():
    q = JointMotion(q=[0.2, 0.1])
    move = Transition(start=q, goal=q, velocity=1.0, acceleration=1.0)
    assert move.duration < 1e-3
    np.testing.assert_array_equal(move.at(0.5).q, q.q)
