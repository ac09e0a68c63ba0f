"""Section 10.2.3: the closed loops of task-space computed torque, as its docstring states them."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from runtime_laws import Array

import taut
from taut.control.laws.task_error import task_error
from taut.maths.model import model_of
from taut.maths.snapshot import Snapshot
from taut.maths.spatial import rotated, rotation_exp, rotation_log
from taut.maths.task_inertia import TaskInertia

L = taut.laws
ARMS = ("panda", "ur10", "kinova", "xarm7")
KP = np.array([100.0, 64.0, 144.0, 225.0, 81.0, 121.0])  # [1/s^2]
KD = 2.0 * np.array([0.8, 0.7, 0.6, 0.8, 0.7, 0.6]) * np.sqrt(KP)  # [1/s]
NEAR = np.array([0.004, -0.005, 0.003, 0.02, -0.03, 0.02])  # [m, rad] where the error is as good as linear
SAMPLED = 0.01  # MATHS section 3: the bar of task loops against the sampled prediction


def ideal(name: str) -> taut.Arm:
    return taut.load_arm(name).with_joints(viscous=0.0, coulomb=0.0)


PANDA = ideal("panda")


def pose_at(arm: taut.Arm, q: Array) -> taut.Pose:
    return taut.snapshot(arm, q).T()


def joints_towards(arm: taut.Arm, twist: Array) -> Array:
    """Joint speeds, or small steps, that move the tool so."""
    return np.linalg.lstsq(taut.snapshot(arm, arm.home).J(), twist, rcond=None)[0]


def run(
    law: taut.Law, arm: taut.Arm, ref: Any, *, rate: float = 1000.0, duration: float = 1.0, **more: Any
) -> taut.Run:
    start = {name: more.pop(name) for name in ("q0", "v0") if name in more}
    limits = more.pop("limits", None)
    plant = taut.RigidPlant(more.pop("real", arm), friction=None, **more)
    out = taut.run(taut.compile(law, arm, rate=rate, limits=limits), plant, ref, duration=duration, **start)
    assert out.outcome.ok, out.outcome
    return out


@functools.cache
def error_of(arm: taut.Arm, kind: Any, coordinates: taut.Coordinates | None) -> Any:
    """X of a law, as a compiled function of q and the goal's p and R."""
    model, n = model_of(arm), arm.n

    def X(q: Array, p: Array, R: Array) -> Array:
        x = Snapshot(model, q=q, v=np.zeros(n))
        ref = taut.TaskMotion.of({"p": p, "R": R, "twist": np.zeros(6), "acceleration": np.zeros(6)})
        return taut.math.array([*task_error(x, ref, kind=kind, coordinates=coordinates).X])

    return taut.native(X, q=n, p=3, R=(3, 3)).call


def errors(out: taut.Run, arm: taut.Arm, law: Any, target: Any, every: int = 1) -> Array:
    """(k, 6) the law's own error, from the true states."""
    X = error_of(arm, getattr(law, "error", "body"), getattr(law, "coordinates", None))
    refs = [target if isinstance(target, taut.TaskMotion) else target.at(t) for t in out.t[::every]]
    return np.array([X(q, ref.p, ref.R) for q, ref in zip(out.q[::every], refs, strict=True)])


def fitted(X: Array, dt: float) -> Array:
    """The two poles of x[k+1] = a x[k] + b x[k-1], by least squares; X may be complex."""
    a, b = np.linalg.lstsq(np.column_stack([X[1:-1], X[:-2]]), X[2:], rcond=None)[0]
    return np.log(np.roots([1.0, -a, -b]).astype(complex)) / dt


def sampled(kp: float, kd: complex, dt: float) -> Array:
    """Semi-implicit Euler of x_ddot + kd x_dot + kp x = 0: what an exact model leaves of the arm."""
    return np.log(np.roots([1.0, kd * dt + kp * dt**2 - 2.0, 1.0 - kd * dt]).astype(complex)) / dt


def frequency_and_damping(poles: Array) -> Array:
    omega = np.sqrt(np.prod(poles).real)
    return np.array([omega, -np.sum(poles).real / (2.0 * omega)])


class TestPoles:
    @pytest.mark.part(1)
    @pytest.mark.parametrize("arm", ARMS)
    @pytest.mark.parametrize("error", ["decoupled", "body", "space"])
    def test_of_each_direction_are_those_of_the_sampled_loop(self, error: Any, arm: str) -> None:
        made = ideal(arm)
        law = L.TaskComputedTorque(kp=KP, kd=KD, error=error, null=None)
        goal = taut.TaskMotion(pose=pose_at(made, made.home))
        out = run(law, made, goal, duration=0.4, q0=made.home + joints_towards(made, 0.2 * NEAR))
        X = errors(out, made, law, goal)
        assert np.abs(X[:, :3]).max() < 0.01 * (1.0 if error != "space" else 3.0)  # that of the world's origin
        assert np.abs(X[:, 3:]).max() < 0.05
        for i in range(6):
            got = frequency_and_damping(fitted(X[:, i], 1e-3))
            assert got == pytest.approx(frequency_and_damping(sampled(KP[i], KD[i], 1e-3)), rel=SAMPLED), i

    def test_tend_to_the_design_as_the_tick_falls(self) -> None:
        law = L.TaskComputedTorque(kp=100.0, kd=16.0, error="body", null=None)
        goal = taut.TaskMotion(pose=pose_at(PANDA, PANDA.home))
        off = []
        for rate, every in ((1e3, 1), (1e4, 10)):
            start = PANDA.home + joints_towards(PANDA, 0.1 * NEAR)
            X = errors(run(law, PANDA, goal, rate=rate, duration=0.3, q0=start), PANDA, law, goal, every)
            poles = np.array([fitted(X[:, i], 1e-3) for i in range(6)])
            off.append(np.abs(np.abs(poles.imag) + 1j * poles.real - (6.0 - 8.0j)).max())
        assert off[0] / off[1] == pytest.approx(10.0, rel=0.2)
        assert off[1] < 0.01

    def test_with_an_integral_are_the_three_designed_ones(self) -> None:
        law = L.TaskComputedTorque(kp=100.0, kd=20.0, ki=150.0, null=None)
        goal = taut.TaskMotion(pose=pose_at(PANDA, PANDA.home))
        out = run(law, PANDA, goal, rate=5000.0, q0=PANDA.home + joints_towards(PANDA, 0.5 * NEAR))
        X = errors(out, PANDA, law, goal, 5)
        rows = np.column_stack([X[2 - k : len(X) - 1 - k].ravel() for k in range(3)])
        z = np.linalg.lstsq(rows, X[3:].ravel(), rcond=None)[0]
        got, design = np.roots([1.0, *-z]), np.exp(1e-3 * np.roots([1.0, 20.0, 100.0, 150.0]))
        # Of the characteristic polynomial, since two of the poles are within 5 %.
        assert np.poly(got) == pytest.approx(np.poly(design), abs=1e-4)
        assert np.sort(np.log(got).real)[-1] / 1e-3 == pytest.approx(
            np.roots([1.0, 20.0, 100.0, 150.0]).real.max(), rel=0.02
        )


@dataclass(frozen=True)
class Spinning:
    """A target that turns on the spot."""

    T: taut.Pose
    w: Array

    def at(self, t: float) -> taut.TaskMotion:
        pose = taut.Pose.of(rotation_exp(self.w * t) @ self.T.R, self.T.p)
        return taut.TaskMotion(pose=pose, twist=[0.0, 0.0, 0.0, *self.w])


class WithoutTransport(taut.Law):
    """Equation 10.31 with the body error and the desired acceleration fed as it is."""

    reference = taut.TaskMotion
    kp: taut.Gain
    kd: taut.Gain

    def command(self, x: Any, ref: Any) -> taut.Torque:
        error = task_error(x, ref, kind="body")
        V_D, rate = rotated(ref.R.T, ref.twist), rotated(ref.R.T, ref.acceleration)
        V_dot_D = rate - taut.math.array([*taut.math.cross(V_D[3:], V_D[:3]), 0.0, 0.0, 0.0])
        a = V_dot_D + self.kp @ error.X + self.kd @ error.V - error.Jdot_v
        return taut.Torque(a=error.J.T @ (TaskInertia.of(error.J, x.M_factors).Lambda @ a) + x.h)


class TestATargetThatSpins:
    """At 3 rad/s about the tool's z axis: what turns about x and y is a complex number with poles of its own."""

    SPIN = 3.0

    def poles(self, law: taut.Law) -> Array:
        """Of the rotation error about the tool's x and y axes, as x + j y."""
        T = pose_at(PANDA, PANDA.home)
        target = Spinning(T, self.SPIN * T.R[:, 2])
        v0 = joints_towards(PANDA, np.append(np.zeros(3), target.w))
        start = PANDA.home + joints_towards(PANDA, 0.3 * NEAR)
        out = run(law, PANDA, target, duration=0.5, q0=start, v0=v0)
        X = errors(out, PANDA, law, target)
        found = fitted(X[:, 3] + 1j * X[:, 4], 1e-3)
        return self.by_frequency(found)

    def by_frequency(self, poles: Array) -> Array:
        return poles[np.argsort(poles.imag)]

    def test_leaves_the_poles_of_the_body_error_where_they_are(self) -> None:
        poles = self.poles(L.TaskComputedTorque(kp=100.0, kd=16.0, error="body", null=None))
        assert np.abs(poles - self.by_frequency(sampled(100.0, 16.0, 1e-3))).max() < SAMPLED * 10.0

    def test_moves_them_where_the_acceleration_is_not_transported(self) -> None:
        """s^2 + (kd +- j w) s + kp = 0: -6.14 +- 4.96j and -9.86 +- 7.96j."""
        poles = self.poles(WithoutTransport(kp=100.0, kd=16.0))
        expected = sampled(100.0, 16.0 + 1j * self.SPIN, 1e-3)
        assert np.abs(poles - self.by_frequency(expected)).max() < SAMPLED * 10.0
        assert np.abs(poles - np.array([-8.0 - 6.0j, -8.0 + 6.0j])).max() > 2.0

    def test_moves_those_of_the_decoupled_error_too(self) -> None:
        """X-dot = V + w x X there, so that it is right for targets that do not turn, as its docstring says."""
        poles = self.poles(L.TaskComputedTorque(kp=100.0, kd=16.0, null=None))
        assert np.abs(poles - np.array([-8.0 - 6.0j, -8.0 + 6.0j])).max() > 1.0


class TestCoordinates:
    """Exactly linear, however large the error: e_ddot + kd e_dot + kp e = 0 of each coordinate."""

    RATE = 5000.0

    def check(self, law: Any, arm: taut.Arm, pose: taut.Pose, q0: Array, least: Array) -> None:
        goal = taut.TaskMotion(pose=pose)
        out = run(law, arm, goal, rate=self.RATE, duration=1.0, q0=q0)
        X = errors(out, arm, law, goal, 25)
        assert (np.abs(X[0]) >= least).all(), X[0]
        t = out.t[::25, np.newaxis]
        expected = X[0] * (1.0 + 10.0 * t) * np.exp(-10.0 * t)
        # What the tick adds: about kp dt t e, and 2 % of it for how far the coordinates are from straight.
        assert np.abs(X - expected).max() < 6.0 / self.RATE * np.abs(X[0]).max()

    def test_of_position_alone(self) -> None:
        law = L.TaskComputedTorque(kp=100.0, kd=20.0, error="coordinates", coordinates=taut.Coordinates.position())
        T = pose_at(PANDA, PANDA.home)
        self.check(
            law, PANDA, taut.Pose(T.p + np.array([-0.1, 0.2, 0.1]), R=np.eye(3)), PANDA.home, np.full(3, 0.1 - 1e-12)
        )

    def test_of_the_plane(self) -> None:
        flat = taut.Pose([0.0, 0.0, 0.0], rpy=[-0.5 * np.pi, 0.0, 0.0])  # from upright to lying on a table
        arm = taut.load_arm("planar3", T_WB=flat).with_joints(viscous=0.0, coulomb=0.0)
        yaw = taut.Coordinates(function=lambda T: [*T.p[:2], taut.math.atan2(T.R[1, 0], T.R[0, 0])], angles=(2,))
        law = L.TaskComputedTorque(kp=100.0, kd=20.0, error="coordinates", coordinates=yaw)
        q0, q1 = np.array([0.3, 0.9, 0.5]), np.array([0.8, 0.7, 1.2])
        self.check(law, arm, pose_at(arm, q1), q0, np.full(3, 0.05))

    def test_of_a_cylinder(self) -> None:
        def cylindrical(T: taut.Pose) -> Any:
            return [taut.math.sqrt(T.p[0] ** 2 + T.p[1] ** 2), taut.math.atan2(T.p[1], T.p[0]), T.p[2]]

        coordinates = taut.Coordinates(function=cylindrical, angles=(1,))
        law = L.TaskComputedTorque(kp=100.0, kd=20.0, error="coordinates", coordinates=coordinates)
        p = pose_at(PANDA, PANDA.home).p
        r, angle = np.hypot(p[0], p[1]) + 0.1, np.arctan2(p[1], p[0]) + 1.0
        goal = taut.Pose([r * np.cos(angle), r * np.sin(angle), p[2] - 0.1])
        self.check(law, PANDA, goal, PANDA.home, np.array([0.1 - 1e-12, 1.0 - 1e-12, 0.1 - 1e-12]))

    def test_of_position_and_rpy(self) -> None:
        coordinates = taut.Coordinates.position_and_rpy()
        law = L.TaskComputedTorque(kp=100.0, kd=20.0, error="coordinates", coordinates=coordinates)
        T = pose_at(PANDA, PANDA.home)
        rpy = T.rpy + np.array([0.3, 0.4, -0.5])
        self.check(
            law, PANDA, taut.Pose(T.p + np.array([0.05, 0.1, 0.1]), rpy=rpy), PANDA.home, np.full(6, 0.05 - 1e-12)
        )


class TestTheIntegral:
    LOADED = PANDA.with_payload(1.0, [0.0, 0.0, 0.05])
    GOAL = taut.TaskMotion(pose=pose_at(PANDA, PANDA.home))

    @pytest.mark.part(1)
    @pytest.mark.parametrize("error", ["decoupled", "body", "space"])
    def test_takes_away_what_an_unknown_payload_leaves(self, error: Any) -> None:
        left = []
        for ki in (0.0, 200.0):
            law = L.TaskComputedTorque(kp=100.0, kd=20.0, ki=ki, error=error)
            out = run(law, PANDA, self.GOAL, real=self.LOADED, duration=8.0)
            left.append(np.abs(errors(out, PANDA, law, self.GOAL, len(out) - 1)[-1]).max())
        assert left[0] > 1e-2
        assert left[1] < 1e-6

    def overshoot(self, scheme: Any, limits: taut.Limits) -> float:
        """Past a goal 0.25 m up, in parts of the way, with a shoulder that gives little more than holds the arm."""
        T = pose_at(PANDA, PANDA.home)
        goal = taut.TaskMotion(pose=taut.Pose.of(T.R, T.p + 0.25 * np.eye(3)[2]))
        law = L.TaskComputedTorque(
            kp=100.0,
            kd=20.0,
            ki=150.0,
            integral=taut.laws.Integral(
                anti_windup=scheme, **({"tracking": 10.0} if scheme == "back-calculation" else {})
            ),
            singularity="plain",
        )
        out = run(law, PANDA, goal, duration=4.0, limits=limits)
        below = errors(out, PANDA, law, goal, 10)[:, 2]
        assert abs(below[-1]) < 0.02
        return float(-below.min() / 0.25)

    def test_does_not_wind_up_under_torque_limits(self) -> None:
        limits = taut.Limits(tau=np.array([87.0, 38.0, 87.0, 32.0, 12.0, 12.0, 12.0]))
        wound, *others = (self.overshoot(scheme, limits) for scheme in ("none", "clamping", "back-calculation"))
        assert wound > 0.25
        for overshoot in others:
            assert overshoot < 0.4 * wound


class TestTheBoundedSpring:
    MAX = (0.05, 0.2)

    def test_goes_slowly_where_the_plain_one_would_tear(self) -> None:
        T = pose_at(PANDA, PANDA.home)
        goal = taut.TaskMotion(
            pose=taut.Pose.of(T.R @ rotation_exp(np.array([0.0, 0.0, 1.0])), T.p + 0.3 * np.eye(3)[1])
        )
        peak = {}
        for error_max in (None, self.MAX):
            law = L.TaskComputedTorque(kp=100.0, kd=20.0, error_max=error_max)
            out = run(law, PANDA, goal, duration=4.0)
            speed = [taut.snapshot(PANDA, q, v).twist() for q, v in zip(out.q[::20], out.v[::20], strict=True)]
            peak[error_max] = np.abs(np.linalg.norm(np.array(speed)[:, :3], axis=1)).max()
            assert np.abs(errors(out, PANDA, law, goal, len(out) - 1)[-1]).max() < 1e-3
            if error_max is not None:
                assert np.abs(out.terms["bound"]).max() > 1.0
        # The pull is at most kp error_max, at which kd lets the tool go kp error_max / kd fast.
        assert peak[self.MAX] < 1.02 * 100.0 * 0.05 / 20.0
        assert peak[None] > 4.0 * peak[self.MAX]


def test_a_spinning_target_is_read_right() -> None:
    """Guards the tests above: the trajectory's twist is the rate of its pose."""
    target = Spinning(pose_at(PANDA, PANDA.home), np.array([1.0, -2.0, 0.5]))
    later = target.at(0.3 + 1e-6).R @ target.at(0.3 - 1e-6).R.T
    assert rotation_log(later) / 2e-6 == pytest.approx(target.w, abs=1e-8)
