"""Laws via joint space: equations 10.28 to 10.30 tick by tick, closed loops, limits, singular poses, targets that jump."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from refusals import refused
from scipy.spatial.transform import Rotation

import taut
from taut.base.types import Float64Array
from taut.maths.ik import IkOutcome

RATE = 1000.0
KP, KD = 100.0, 20.0
LAW = taut.laws.ComputedTorque(kp=KP, kd=KD)


@dataclasses.dataclass
class Circle:
    """Round and round in a plane of the world, while the tool turns about z by a sine."""

    start: taut.Pose
    radius: float = 0.05  # [m]
    omega: float = np.pi  # [rad/s]
    turn: float = 0.3  # [rad]
    plane: tuple[int, int] = (1, 2)
    twist: bool = True

    def at(self, t: float) -> taut.TaskMotion:
        rows = self.rows(np.array([t]))
        return taut.TaskMotion.of({name: getattr(rows, name)[0] for name in taut.TaskMotion.fields(1)})

    def rows(self, t: Float64Array) -> taut.TaskMotion:
        w, r, (i, j) = self.omega, self.radius, self.plane
        p, V, A = np.tile(self.start.p, (len(t), 1)), np.zeros((len(t), 6)), np.zeros((len(t), 6))
        c, s = np.cos(w * t), np.sin(w * t)
        p[:, i], V[:, i], A[:, i] = p[:, i] + r * (c - 1.0), -r * w * s, -r * w * w * c
        p[:, j], V[:, j], A[:, j] = p[:, j] + r * s, r * w * c, -r * w * w * s
        V[:, 5], A[:, 5] = self.turn * w * c, -self.turn * w * w * s
        R = Rotation.from_rotvec(np.outer(self.turn * s, [0.0, 0.0, 1.0])).as_matrix() @ self.start.R
        return taut.TaskMotion.of({"p": p, "R": R, "twist": V * self.twist, "acceleration": A * self.twist})


@dataclasses.dataclass
class There:
    """A straight line out and back, each a quintic of the time `duration`, with a rest between them."""

    start: taut.Pose
    way: Float64Array  # (3,) [m]
    duration: float  # [s]
    rest: float = 1.0  # [s]
    back: bool = True

    def at(self, t: float) -> taut.TaskMotion:
        rows = self.rows(np.array([t]))
        return taut.TaskMotion.of({name: getattr(rows, name)[0] for name in taut.TaskMotion.fields(1)})

    def rows(self, t: Float64Array) -> taut.TaskMotion:
        T = self.duration
        out = np.logical_or(t < T + self.rest, not self.back)
        x = np.clip(np.where(out, t / T, (2.0 * T + self.rest - t) / T), 0.0, 1.0)[:, np.newaxis]
        sign, zero = np.where(out, 1.0, -1.0)[:, np.newaxis], np.zeros((len(t), 3))
        s = 10 * x**3 - 15 * x**4 + 6 * x**5
        ds, dds = sign * (30 * x**2 - 60 * x**3 + 30 * x**4) / T, (60 * x - 180 * x**2 + 120 * x**3) / T**2
        return taut.TaskMotion.of(
            {
                "p": self.start.p + s * self.way,
                "R": np.tile(self.start.R, (len(t), 1, 1)),
                "twist": np.hstack([ds * self.way, zero]),
                "acceleration": np.hstack([dds * self.way, zero]),
            }
        )


def home(arm: taut.Arm) -> taut.Pose:
    return taut.snapshot(arm, arm.home).T().kept()


def run(arm: taut.Arm, ref: object, duration: float, law: taut.Law = LAW, **options: Any) -> taut.Run:
    start = {"q0": options.pop("q0")} if "q0" in options else {}
    ctrl = taut.compile(taut.via_joint_space(law, **options), arm, rate=RATE)
    return taut.run(ctrl, taut.RigidPlant(arm, friction=None), ref, duration=duration, **start)


def position_error(arm: taut.Arm, run: taut.Run, q: Float64Array, every: int = 25) -> Float64Array:
    rows = range(0, len(q), every)
    return np.array([np.linalg.norm(taut.snapshot(arm, q[k]).T().p - run.reference.p[k]) for k in rows])


def outcomes(run: taut.Run) -> list[IkOutcome]:
    return [IkOutcome.of(code) for code in run.extra["law.ik_outcome"]]


class Recorder(taut.Law):
    """Passes what it is to follow on as its own memory, to be looked at."""

    q, v, a = taut.Memory(record=True), taut.Memory(record=True), taut.Memory(record=True)

    def start(self, x: taut.Snapshot, ref: taut.JointMotion) -> dict[str, Any]:
        return {"q": x.q, "v": ref.v, "a": ref.a}

    def command(
        self, x: taut.Snapshot, ref: taut.JointMotion, memory: Any, dt: float
    ) -> tuple[taut.Torque, dict[str, Any]]:
        return taut.Torque(hold=x.g), {"q": ref.q, "v": ref.v, "a": ref.a}


def followed(arm: taut.Arm, ref: object, duration: float, **options: Any) -> tuple[Float64Array, ...]:
    """What an inner law is asked to follow: q_des, v_des, a_des."""
    out = run(arm, ref, duration, law=Recorder(), **options)
    assert out.outcome.ok
    return tuple(out.extra[f"law.inner.{name}"] for name in "qva")


SMOOTH = {
    "planar3": {"plane": (0, 2), "turn": 0.0},
    "panda": {},
    "ur10": {},
    "xarm7": {"radius": 0.02},
    "z1": {"radius": 0.02},
}


class TestTheMotionOfTheJoints:
    @pytest.mark.part(1)
    @pytest.mark.parametrize("name", ["planar3", "panda", "ur10", "z1"])
    def test_is_the_inverse_kinematics_of_the_target(self, name: str) -> None:
        """Equation 10.28, after one step a tick: rounding is all that is left once the start has died away."""
        arm = taut.load_arm(name)
        ref = Circle(home(arm), **SMOOTH[name])  # type: ignore[arg-type]
        q, _, _ = followed(arm, ref, 1.5)
        for k in range(100, len(q), 100):
            T, wanted = taut.snapshot(arm, q[k]).T(), ref.at(k / RATE).pose
            assert np.linalg.norm(T.p - wanted.p) < 1e-10
            assert np.linalg.norm(pin.log3(np.array(wanted.R.T @ T.R))) < 1e-10

    @pytest.mark.part(1)
    @pytest.mark.parametrize("name", ["planar3", "panda", "ur10", "z1"])
    def test_has_velocities_and_accelerations_that_are_its_own(self, name: str) -> None:
        """Equations 10.29 and 10.30, with the free motion of redundant arms, are the rates of q_des."""
        arm = taut.load_arm(name)
        q, v, a = (x[100:] for x in followed(arm, Circle(home(arm), **SMOOTH[name]), 1.5))  # type: ignore[arg-type]
        scale = np.abs(a).max()
        assert np.abs(v[1:-1] - 0.5 * RATE * (q[2:] - q[:-2])).max() < 1e-5 * scale
        assert np.abs(a[1:-1] - RATE**2 * (q[2:] - 2.0 * q[1:-1] + q[:-2])).max() < 2e-3 * scale
        assert np.abs(a[1:-1] - 0.5 * RATE * (v[2:] - v[:-2])).max() < 2e-3 * scale

    def test_returns_with_a_closed_path_where_a_posture_pulls(self) -> None:
        """The pseudo-inverse alone drifts, by more than 0.05 rad a circle."""
        arm = taut.load_arm("panda")
        ref, ticks = Circle(home(arm), radius=0.1, omega=2.0 * np.pi), int(RATE)
        q = run(arm, ref, 30.0).extra["law.q_des"]
        assert np.abs(q[-1] - q[-1 - ticks]).max() < 1e-9

    def test_goes_to_a_given_posture_without_moving_the_tool(self) -> None:
        arm = taut.load_arm("panda")
        T = home(arm)
        posture = arm.home + np.array([0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
        q, v, _ = followed(arm, taut.TaskMotion(pose=T), 8.0, posture=posture)
        assert max(np.linalg.norm(taut.snapshot(arm, row).T().p - T.p) for row in q[::100]) < 1e-6
        J = taut.snapshot(arm, q[-1]).J()
        assert np.abs((np.eye(7) - np.linalg.pinv(J) @ J) @ (posture - q[-1])).max() < 2e-3
        assert np.abs(q[-1] - arm.home).max() > 0.1
        assert np.abs(v[1:-1] - 0.5 * RATE * (q[2:] - q[:-2]))[200:].max() < 1e-5

    def test_is_the_same_in_native_code_and_in_plain_python(self) -> None:
        arm = taut.load_arm("ur10")
        law, ref = taut.via_joint_space(LAW), Circle(home(arm))
        native, plain = (taut.compile(law, arm, engine=engine) for engine in ("native", "float"))  # type: ignore[arg-type]
        for k in range(5):
            got, wanted = (c.step(arm.home, np.zeros(6), ref.at(k / RATE)) for c in (native, plain))
            assert np.abs(got - wanted).max() < 1e-9 * np.abs(wanted).max()


class TestTheClosedLoop:
    @pytest.mark.part(1)
    @pytest.mark.parametrize("name", ["planar3", "panda", "ur10"])
    def test_is_that_of_the_law_inside(self, name: str) -> None:
        """From 5 mm off, joint errors fall as e_ddot + kd e_dot + kp e = 0, sampled: within 1 %."""
        arm = taut.load_arm(name)
        T = home(arm)
        out = run(arm, taut.TaskMotion(pose=T), 1.0, q0=arm.home, speed=1e3)
        still = np.abs(out.extra["law.q_des"] - arm.home).max()
        assert still < 1e-12
        ctrl = taut.compile(taut.via_joint_space(LAW), arm)
        goal = taut.TaskMotion(pose=T)
        off = arm.home + 0.01 * np.cos(np.arange(arm.n))
        ctrl.step(arm.home, np.zeros(arm.n), goal)  # q_des starts at home, and the arm is then found elsewhere
        plant, k = taut.RigidPlant(arm, friction=None), 300
        own = plant.parameters
        memory, e = plant.start(off, np.zeros(arm.n), own, ctrl.dt), []
        for tick in range(k):
            measured = plant.measure(memory, {}, own)
            e.append(arm.home - measured["q"])
            memory = plant.command(ctrl.step(measured["q"], measured["v"], goal), memory, tick * ctrl.dt)
            memory = plant.advance(memory, own, ctrl.dt)
        wanted, (x, v) = [], (e[0], np.zeros(arm.n))
        for _ in range(k):
            wanted.append(x)
            v = v - ctrl.dt * (KP * x + KD * v)
            x = x + ctrl.dt * v
        assert np.abs(np.array(e) - np.array(wanted)).max() < 0.01 * np.abs(e[0]).max()

    def test_of_a_velocity_controlled_arm_follows_the_circle(self) -> None:
        arm = taut.load_arm("ur10")
        kp, rate, ref = 5.0, 125.0, Circle(home(arm), radius=0.1, turn=0.0)
        ctrl = taut.compile(taut.via_joint_space(taut.laws.VelocityPI(kp=kp)), arm, rate=rate)
        assert ctrl.kind == "velocity"
        q, errors = arm.home, []
        for k in range(500):  # drives that do what they are told, held for a period
            errors.append(np.linalg.norm(taut.snapshot(arm, q).T().p - ref.at(k / rate).pose.p))
            q = q + ctrl.step(q, ref.at(k / rate)) / rate
        expected = 0.1 * np.pi**2 / (2.0 * rate) / np.hypot(kp, np.pi)
        assert np.mean(errors[250:]) == pytest.approx(expected, rel=0.05)

    def test_of_gravity_pid_follows_with_what_its_gains_leave(self) -> None:
        arm = taut.load_arm("panda")
        law = taut.laws.GravityPID(kp=[600.0] * 4 + [250.0, 150.0, 50.0], kd=[50.0] * 4 + [20.0, 15.0, 5.0])
        out = run(arm, Circle(home(arm)), 3.0, law=law)
        assert set(outcomes(out)) == {IkOutcome.SOLVED}
        assert position_error(arm, out, out.q).max() < 0.02
        assert position_error(arm, out, out.extra["law.q_des"])[10:].max() < 1e-9


class TestLimits:
    def test_are_kept_and_the_others_go_on(self) -> None:
        """Six joints: the shoulder's limit ends the line, and the joints come to rest there together."""
        arm = taut.load_arm("ur10").with_joints(upper=[0.2, 3.0, 3.0, 3.0, 3.0, 3.0], lower=[-3.0] * 6)
        T = home(arm)
        turned = taut.Pose(Rotation.from_rotvec([0, 0, 0.5]).as_matrix() @ T.p, R=T.R)
        ref = There(T, turned.p - T.p, 2.0)
        q, v, _ = followed(arm, ref, 6.0)
        assert q[:, 0].max() <= 0.2 + 1e-12
        assert np.abs(q[:, 0]).max() > 0.199
        assert np.abs(q[-1] - arm.home).max() < 1e-6  # and back
        lie = np.abs(v[1:-1] - 0.5 * RATE * (q[2:] - q[:-2])).max(axis=1)
        assert (lie > 0.02).sum() <= 5  # where joints are caught by a limit or set free by a target that comes back
        out = run(arm, ref, 6.0)
        assert IkOutcome.AT_LIMIT in outcomes(out)
        assert outcomes(out)[-1] is IkOutcome.SOLVED
        assert out.q[:, 0].max() <= 0.2 + 1e-4

    def test_of_one_joint_are_made_up_for_by_seven(self) -> None:
        """The Panda's first joint is stopped on the way; the tool does not notice."""
        free = taut.load_arm("panda")
        ref = There(home(free), np.array([0.0, 0.3, 0.0]), 2.0, back=False)
        far = followed(free, ref, 3.0)[0][:, 0].max()
        upper = np.array(free.upper)
        upper[0] = 0.5 * far
        arm = free.with_joints(upper=upper)
        out = run(arm, ref, 3.0)
        q = out.extra["law.q_des"]
        assert q[:, 0].max() <= upper[0] + 1e-12
        assert q[-1, 0] > 0.9 * upper[0]
        assert position_error(arm, out, q).max() < 1e-4
        assert position_error(arm, out, out.q)[-1] < 1e-5

    def test_are_returned_to_by_an_arm_that_starts_beyond_them(self) -> None:
        arm = taut.load_arm("gantry3")
        start = arm.upper + 0.05
        ref = taut.TaskMotion(pose=home(arm))
        q, _, _ = followed(arm, ref, 3.0, q0=start)
        assert (q[0] <= start).all()
        assert (np.diff(q, axis=0) <= 1e-12).all()
        assert np.abs(q[-1] - arm.home).max() < 1e-6


class TestSingularPoses:
    ARM = taut.load_arm("ur10")

    @pytest.mark.part(1)
    @pytest.mark.parametrize("axis", [0, 1, 2])
    def test_of_the_wrist_are_passed(self, axis: int) -> None:
        arm, way = self.ARM, 0.25 * np.eye(3)[axis]
        q = arm.home + np.array([0.1, 0.05, 0.1, 0.2, 0.5 * np.pi, 0.3])
        T = taut.snapshot(arm, q).T()
        ref = There(taut.Pose(T.p - way, R=T.R), 2.0 * way, 2.0, back=False)
        start = taut.inverse_kinematics(arm, ref.at(0.0).pose, q0=q)
        assert start.ok
        out = run(arm, ref, 4.0, q0=start.q)
        assert (np.abs(out.v) <= arm.velocity).all()
        assert (np.abs(out.tau) <= arm.effort).all()
        assert position_error(arm, out, out.q).max() < 1e-3
        assert position_error(arm, out, out.q)[-1] < 1e-6

    def test_of_the_stretched_arm_end_its_way_and_it_comes_back(self) -> None:
        arm = self.ARM
        T = home(arm)
        way = np.array([np.sign(T.p[0]) * 0.9, 0.0, 0.0])
        ref = There(T, way, 3.6)
        out = run(arm, ref, 11.0)
        assert IkOutcome.SINGULAR in outcomes(out)
        assert (np.abs(out.v) <= 1.01 * arm.velocity).all()
        reached = out.t[:-1][np.diff(out.extra["law.ik_error"][:, 0] > 1e-3)][-1]
        assert reached < 3.6 * 2.0 + 1.0 - 1.7 + 0.3  # a third of a second after the way back is reachable
        assert (np.abs(out.tau) <= arm.effort).all()
        assert position_error(arm, out, out.q)[-1] < 1e-6


class TestTargetsThatJump:
    ARM = taut.load_arm("panda")

    @pytest.mark.parametrize("away", [0.2, 2.0])
    def test_are_approached_at_a_bounded_speed(self, away: float) -> None:
        """Also one that is far out of reach, from the first tick on."""
        T = home(self.ARM)
        out = run(self.ARM, taut.TaskMotion(pose=taut.Pose(T.p + np.array([0.0, away, 0.0]), R=T.R)), 3.0)
        q = out.extra["law.q_des"]
        speed = np.abs(np.diff(q, axis=0)) * RATE
        assert speed.max() <= 1.0 + 0.5  # that of catching up, and the pull of the posture
        assert (np.abs(out.v) <= self.ARM.velocity).all()
        assert (np.abs(out.tau) <= self.ARM.effort).all()
        assert outcomes(out)[0] is IkOutcome.CATCHING_UP
        assert (outcomes(out)[-1] is IkOutcome.SOLVED) == (away < 1.0)
        left = out.extra["law.ik_error"][-1, 0]
        assert left == pytest.approx(position_error(self.ARM, out, q)[-1], abs=2e-4)

    def test_without_a_twist_are_followed_with_a_lag(self) -> None:
        still = run(self.ARM, Circle(home(self.ARM), twist=False), 2.0)
        moving = run(self.ARM, Circle(home(self.ARM)), 2.0)
        lag, none = (position_error(self.ARM, out, out.extra["law.q_des"])[20:].max() for out in (still, moving))
        assert 1e-4 < lag < 0.02
        assert none < 1e-9


class TestArmsOfFiveJoints:
    ARM = taut.load_arm("so101")

    def test_say_that_they_cannot_turn_every_way(self) -> None:
        T = home(self.ARM) @ taut.Pose(rpy=[0.0, 0.4, 0.0])
        out = run(self.ARM, taut.TaskMotion(pose=T), 3.0)
        assert outcomes(out)[-1] is IkOutcome.FEWER_JOINTS
        assert out.extra["law.ik_error"][-1, 1] > 0.01
        best = taut.inverse_kinematics(self.ARM, T)
        assert np.abs(out.extra["law.q_des"][-1] - best.q).max() < 1e-3

    def test_follow_the_position_alone(self) -> None:
        q = self.ARM.home + np.array([0.0, 0.2, 0.1, 0.1, 0.2])
        ref = Circle(taut.snapshot(self.ARM, q).T().kept(), radius=0.02, turn=0.5)
        out = run(self.ARM, ref, 2.0, directions="position", q0=q)
        assert set(outcomes(out)[10:]) == {IkOutcome.SOLVED}
        assert position_error(self.ARM, out, out.extra["law.q_des"])[10:].max() < 1e-9


def test_a_tool_that_may_spin_leaves_a_joint_to_spare() -> None:
    """Equations 10.29 and 10.30 in five directions: position, and where the tool's axis points."""
    arm = taut.load_arm("ur10")
    ref = Circle(home(arm), turn=0.0)
    q, v, a = (x[100:] for x in followed(arm, ref, 1.5, directions="pointing", posture=arm.home + 0.3))
    assert np.abs(v[1:-1] - 0.5 * RATE * (q[2:] - q[:-2])).max() < 1e-5
    assert np.abs(a[1:-1] - 0.5 * RATE * (v[2:] - v[:-2])).max() < 2e-3 * np.abs(a).max()
    T, wanted = taut.snapshot(arm, q[-1]).T(), ref.at(1.5).pose
    assert np.abs(T.p - wanted.p).max() < 1e-9
    assert np.abs(T.R[:, 2] - wanted.R[:, 2]).max() < 1e-9
    assert np.linalg.norm(pin.log3(np.array(wanted.R.T @ T.R))) > 0.05


def test_memory_is_read_after_a_step() -> None:
    arm = taut.load_arm("panda")
    ctrl = taut.compile(taut.via_joint_space(LAW), arm)
    with refused(taut.errors.UsageError):
        ctrl.memory  # noqa: B018
    T = home(arm)
    ctrl.step(arm.home, np.zeros(7), taut.TaskMotion(pose=taut.Pose(T.p + np.array([0.0, 0.1, 0.0]), R=T.R)))
    assert IkOutcome.of(ctrl.memory["law.ik_outcome"]) is IkOutcome.CATCHING_UP
    assert ctrl.memory["law.ik_error"][0] == pytest.approx(0.1, abs=1e-3)
    with refused(taut.errors.UnknownNameError):
        ctrl.memory["law.ik_eror"]


def test_the_record_stands_in_a_log_and_in_runs_of_other_plants(tmp_path: Any) -> None:
    arm = taut.load_arm("panda")
    out = run(arm, Circle(home(arm)), 0.1)
    again = taut.load_run(out.save(tmp_path / "run.mcap"))
    assert np.array_equal(again.extra["law.ik_error"], out.extra["law.ik_error"])
    hosted = taut.run(
        taut.compile(taut.via_joint_space(LAW), arm), taut.MujocoPlant(arm), Circle(home(arm)), duration=0.1
    )
    assert np.abs(hosted.extra["law.q_des"] - out.extra["law.q_des"]).max() < 1e-12


@pytest.mark.parametrize(
    ("make", "error"),
    [
        (lambda: taut.via_joint_space("PID"), taut.errors.UsageError),
        (lambda: taut.via_joint_space(taut.via_joint_space(LAW)), taut.errors.UsageError),
        (lambda: taut.via_joint_space(LAW, directions="six"), taut.errors.UsageError),
        (lambda: taut.via_joint_space(LAW, speed=np.eye(7)), taut.errors.ShapeError),
        (lambda: taut.via_joint_space(LAW, speed=0.0), taut.errors.RangeError),
        (lambda: taut.compile(taut.via_joint_space(LAW, posture=[0.0] * 6), taut.load_arm("panda")), taut.errors.ShapeError),
        (lambda: taut.compile(taut.via_joint_space(LAW, tool="panda_hand_tpc"), taut.load_arm("panda")), taut.errors.UnknownNameError),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said(make: Callable[[], object], error: type[Exception]) -> None:
    with refused(error):
        make()
