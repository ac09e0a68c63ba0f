"""What moves the joints and not the tool: the projector, and the laws that go through it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from task_tools import Array, JointPath, Target

import taut
from taut.maths.spatial import rotation_log
from taut.maths.task_inertia import TaskInertia

L = taut.laws
ROUNDING = 1e-14  # times the condition of J M^-1 J^T, of which Lambda is the inverse
SEVEN = {name: taut.load_arm(name).with_joints(viscous=0.0, coulomb=0.0) for name in ("panda", "xarm7")}
KINOVA = taut.load_arm("kinova").with_joints(viscous=0.0, coulomb=0.0)  # six joints: its position alone leaves three
PANDA = SEVEN["panda"]
POSITION = taut.Coordinates.position()


def full(null: Any) -> taut.laws.TaskComputedTorque:
    return L.TaskComputedTorque(kp=100.0, kd=20.0, null=null)


def of_position(null: Any) -> taut.laws.TaskComputedTorque:
    return L.TaskComputedTorque(kp=100.0, kd=20.0, error="coordinates", coordinates=POSITION, null=null)


# Every arm with its task and what is free of it; a rest posture 0.2 rad away moves them at some 0.3 rad/s.
TASKS: dict[str, tuple[taut.Arm, Any]] = {
    "panda": (PANDA, full),
    "xarm7": (SEVEN["xarm7"], full),
    "kinova": (KINOVA, of_position),
}


def away(arm: taut.Arm) -> Array:
    """A posture 0.2 rad off in every joint, in the directions in which the arm can go and keep its tool."""
    free = np.linalg.svd(taut.snapshot(arm, arm.home).J()[: 6 if arm.n == 7 else 3])[2][-1]
    return np.array(arm.home) + 0.2 * np.sign(free)


class PseudoInverse(taut.Law):
    """A posture through I - J^T (J J^T)^-1 J, which is a projector too, and not the dynamically consistent one."""

    reference = taut.TaskMotion
    task: taut.Law
    posture: taut.Law

    def command(self, x: Any, ref: Any, memory: Any, dt: Any) -> Any:
        task, after = self.task.command(x, ref, memory.task, dt)  # type: ignore[attr-defined]
        posture, rest = self.posture.command(x, ref, memory.posture, dt)  # type: ignore[attr-defined]
        tau, J = posture.total, x.J()
        projected = tau - J.T @ taut.math.solve_spd(J @ J.T, J @ tau)
        return taut.Torque(task=task.total, null=projected), {"task": after, "posture": rest}


class TestTheProjector:
    @pytest.mark.parametrize("arm", ["panda", "xarm7", "kinova"])
    def test_is_one_that_the_task_does_not_feel(self, arm: str) -> None:
        """N^T N^T = N^T, J M^-1 N^T = 0, rank n - k."""
        made = TASKS[arm][0]
        for seed in range(20):
            q = np.array(made.home) + 0.5 * np.random.default_rng(seed).standard_normal(made.n)
            x = taut.snapshot(made, q)
            J = x.J() if made.n == 7 else x.J()[:3]
            if np.linalg.svd(J)[1][-1] < 0.1:
                continue
            inertia = TaskInertia.of(J, x.M_factors)
            NT = np.column_stack([inertia.project(column) for column in np.eye(made.n)])
            Minv = np.linalg.inv(x.M)
            worth = ROUNDING * np.linalg.cond(J @ Minv @ J.T) * max(1.0, np.abs(NT).max() ** 2)
            assert np.abs(NT @ NT - NT).max() < worth
            assert np.abs(J @ Minv @ NT).max() < worth * np.abs(J @ Minv).max()
            assert np.linalg.matrix_rank(NT, tol=1e-9) == made.n - len(J)
            # Its transpose keeps what does not move the tool, J v = 0.
            assert np.abs(J @ NT.T).max() < worth

    @pytest.mark.parametrize("null", [L.Posture(q=away(PANDA)), L.LimitAvoidance(margin=1.5), L.Manipulability()])
    def test_takes_from_a_torque_what_would_accelerate_the_tool(self, null: taut.Law) -> None:
        rng = np.random.default_rng(3)
        path = JointPath.random(PANDA, rng)
        q, v, _ = path.at(0.0)
        ref = Target.random(taut.snapshot(PANDA, q).T(), rng).at(0.0)
        x = taut.snapshot(PANDA, q, v)
        with_null, without = (taut.compile(full(law), PANDA, engine="float").step(q, v, ref) for law in (null, None))
        free = with_null - without
        assert np.abs(free).max() > 1e-2
        a = np.linalg.solve(x.M, free)
        assert np.abs(a).max() > 1e-2
        assert np.abs(x.J() @ a).max() < 1e-10 * np.abs(a).max()

    def test_is_given_as_a_term_of_its_own(self) -> None:
        ctrl = taut.compile(full(L.Posture(q=away(PANDA))), PANDA)
        x = taut.snapshot(PANDA, PANDA.home)
        tau = ctrl.step(PANDA.home, np.zeros(7), taut.TaskMotion(pose=x.T()))
        np.testing.assert_allclose(ctrl.terms["null"], tau - x.h, rtol=0.0, atol=1e-12)


class TestTheTaskIsLeftInPeace:
    """In continuous time exactly; what is left is the tick's, and falls with it."""

    def moved(
        self, arm: taut.Arm, law: taut.Law, rate: float, duration: float = 1.0, substeps: int = 1
    ) -> tuple[float, float, float]:
        """How far the joints, the tool's position and its rotation went."""
        out = taut.run(
            taut.compile(law, arm, rate=rate),
            taut.RigidPlant(arm, friction=None, substeps=substeps),
            taut.TaskMotion(pose=taut.snapshot(arm, arm.home).T()),
            duration=duration,
        )
        T = taut.snapshot(arm, arm.home).T()
        poses = [taut.snapshot(arm, q).T() for q in out.q[:: len(out) // 40]]
        p = max(float(np.abs(each.p - T.p).max()) for each in poses)
        R = max(float(np.abs(rotation_log(each.R @ T.R.T)).max()) for each in poses)
        return float(np.abs(out.q - arm.home).max()), p, R

    @pytest.mark.long
    @pytest.mark.parametrize("arm", TASKS)
    def test_by_a_posture(self, arm: str) -> None:
        made, task = TASKS[arm]
        gone = {rate: self.moved(made, task(L.Posture(q=away(made))), rate) for rate in (1e3, 1e4)}
        joints, p, R = gone[1e4]
        assert joints > 0.02
        assert p < 1e-6
        # The plain step adds J-dot v dt / 2 to the tool's speed, against which kd / kp dt / 2 of error stands.
        assert gone[1e3][1] / p == pytest.approx(10.0, rel=0.1)
        if made.n == 7:
            assert R < 1e-6

    @pytest.mark.part(1)
    @pytest.mark.bars
    @pytest.mark.parametrize("arm", ["panda", "fr3", "xarm7"])
    def test_by_less_than_a_micrometre_at_one_kilohertz(self, arm: str, bar: Any) -> None:
        """With kp = 400, kd = 40, whether the plant moves in steps of a tick or of a tenth of it."""
        made = taut.load_arm(arm).with_joints(viscous=0.0, coulomb=0.0)
        law = L.TaskComputedTorque(kp=400.0, kd=40.0, null=L.Posture(q=away(made)))
        for substeps in (1, 10):
            joints, p, _ = self.moved(made, law, 1e3, substeps=substeps)
            assert joints > 0.1
            bar(f"null space, {arm}: {joints:.2f} rad of it move the tool, {substeps} steps a tick", f"{p:.1e} m")
            assert p < 1e-6

    @pytest.mark.long
    @pytest.mark.parametrize("arm", ["panda", "kinova"])
    def test_by_manipulability(self, arm: str) -> None:
        made, task = TASKS[arm]
        start = {"panda": 5.0, "kinova": 0.2}[arm]
        joints, p, R = self.moved(made, task(L.Manipulability(gain=start)), 1e4)
        assert joints > 1e-4
        assert p < 1e-6
        if made.n == 7:
            assert R < 1e-6

    @pytest.mark.part(1)
    @pytest.mark.parametrize("arm", ["panda", "xarm7"])
    def test_by_limit_avoidance(self, arm: str) -> None:
        made, task = TASKS[arm]
        margin = np.minimum(np.minimum(made.upper - made.home, made.home - made.lower) + 0.05, 3.0)
        joints, p, R = self.moved(made, task(L.LimitAvoidance(margin=margin)), 1e4)
        assert joints > 1e-4
        assert p < 1e-6
        assert R < 1e-6

    @pytest.mark.long
    def test_but_not_where_the_projector_is_another_one(self) -> None:
        wrong = PseudoInverse(task=full(None), posture=L.Posture(q=away(PANDA)))
        right = self.moved(PANDA, full(L.Posture(q=away(PANDA))), 1e3)
        joints, p, _ = self.moved(PANDA, wrong, 1e3)
        assert joints > 0.02
        assert p > 1e-3
        assert p > 1e3 * right[1]


@dataclass(frozen=True)
class Circle:
    """Round and round in the world's y-z plane, starting at rest; the orientation stays."""

    T: taut.Pose
    radius: float
    omega: float

    def at(self, t: float) -> taut.TaskMotion:
        ramp = 1.0 - np.exp(-2.0 * t)
        phase, speed = self.omega * (t - ramp / 2.0), self.omega * ramp
        rate = self.omega * 2.0 * np.exp(-2.0 * t)
        c, s, r = np.cos(phase), np.sin(phase), self.radius
        p = self.T.p + r * np.array([0.0, s, c - 1.0])
        v = r * speed * np.array([0.0, c, -s])
        a = r * (rate * np.array([0.0, c, -s]) - speed**2 * np.array([0.0, s, c]))
        return taut.TaskMotion(pose=taut.Pose.of(self.T.R, p), twist=[*v, 0, 0, 0], acceleration=[*a, 0, 0, 0])


@pytest.mark.long
def test_limit_avoidance_keeps_joints_off_the_limits_that_a_long_circle_would_take_them_to() -> None:
    """With hardly any damping the elbow drifts from lap to lap, and ends up turning round; the tool does not feel it."""
    q0 = np.array(PANDA.home)
    circle = Circle(taut.snapshot(PANDA, q0).T(), 0.12, 3.0)
    damping = L.Posture(kp=0.0, kd=0.05)
    room, off = [], []
    for null in (damping, damping + L.LimitAvoidance(margin=0.15)):
        ctrl, plant = taut.compile(full(null), PANDA), taut.RigidPlant(PANDA, friction=None)
        out = taut.run(ctrl, plant, circle, duration=20.0, q0=q0)
        room.append(np.minimum(out.q - PANDA.lower, PANDA.upper - out.q).min())
        rows = zip(out.q[::500], out.t[::500], strict=True)
        off.append(max(np.abs(taut.snapshot(PANDA, q).T().p - circle.at(t).p).max() for q, t in rows))
    assert room[0] < -0.5
    assert room[1] > 0.0
    assert max(off) < 1e-3


class TestTheLaws:
    def test_a_posture_alone_is_a_spring_of_its_own_inertia(self) -> None:
        ctrl = taut.compile(L.Posture(q=away(PANDA)), PANDA)
        q, v = np.array(PANDA.home), np.linspace(-1.0, 1.0, 7)
        tau = ctrl.step(q, v, taut.JointMotion(q=q))
        a = 10.0 * (away(PANDA) - q) - 6.0 * v
        np.testing.assert_allclose(tau, taut.snapshot(PANDA, q).M @ a, rtol=0.0, atol=1e-12)

    def test_a_posture_that_is_not_said_is_where_the_arm_starts(self) -> None:
        q0 = away(PANDA)
        goal = taut.TaskMotion(pose=taut.snapshot(PANDA, q0).T())
        out = taut.run(taut.compile(full(L.Posture()), PANDA), taut.RigidPlant(PANDA), goal, duration=0.2, q0=q0)
        assert np.abs(out.q - q0).max() < 1e-9

    @pytest.mark.part(1)
    @pytest.mark.parametrize("seed", range(3))
    def test_manipulability_climbs_its_own_slope(self, seed: int) -> None:
        """M^-1 tau is gain times d/dq log sqrt(det(J J^T)), each entry bounded."""
        q = np.array(PANDA.home) + 0.4 * np.random.default_rng(seed).standard_normal(7)

        def measure(q: Array) -> float:
            J = taut.snapshot(PANDA, q).J()
            return 0.5 * float(np.linalg.slogdet(J @ J.T)[1])

        slope = np.array([(measure(q + 1e-5 * e) - measure(q - 1e-5 * e)) / 2e-5 for e in np.eye(7)])
        tau = taut.compile(L.Manipulability(), PANDA).step(q, np.zeros(7), taut.JointMotion(q=q))
        expected = 5.0 * slope / np.sqrt(1.0 + (slope / 5.0) ** 2)
        np.testing.assert_allclose(np.linalg.solve(taut.snapshot(PANDA, q).M, tau), expected, rtol=0.0, atol=1e-6)

    def test_manipulability_stays_bounded_at_a_singularity(self) -> None:
        tau = taut.compile(L.Manipulability(), PANDA).step(np.zeros(7), np.zeros(7), taut.JointMotion(q=np.zeros(7)))
        a = np.linalg.solve(taut.snapshot(PANDA, np.zeros(7)).M, tau)
        assert np.abs(a).max() <= 25.0 * (1.0 + 1e-9)

    def test_limit_avoidance_is_nothing_in_the_middle_and_a_spring_in_the_margin(self) -> None:
        ctrl = taut.compile(L.LimitAvoidance(margin=0.2), PANDA)
        middle = 0.5 * (PANDA.lower + PANDA.upper)
        assert not ctrl.step(middle, np.ones(7), taut.JointMotion(q=middle)).any()
        for side, limit in ((1.0, PANDA.lower), (-1.0, PANDA.upper)):
            q, v = limit + side * 0.05, np.linspace(0.1, 0.7, 7)
            a = np.linalg.solve(taut.snapshot(PANDA, q).M, ctrl.step(q, v, taut.JointMotion(q=q)))
            np.testing.assert_allclose(a, 100.0 * side * 0.15 - 20.0 * 0.75 * v, rtol=0.0, atol=1e-8)

    def test_limit_avoidance_leaves_joints_without_limits_alone(self) -> None:
        free = ~np.isfinite(KINOVA.lower)
        assert free.any()
        q = np.where(free, 50.0, KINOVA.lower + 0.1)
        tau = taut.compile(L.LimitAvoidance(), KINOVA).step(q, np.ones(6), taut.JointMotion(q=q))
        a = np.linalg.solve(taut.snapshot(KINOVA, q).M, tau)
        assert np.abs(a[free]).max() < 1e-9 * np.abs(a).max()
