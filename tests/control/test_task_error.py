"""The four errors of task space, each against formulas of others and against differences along random motions."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation
from task_tools import Array, JointPath, Target, se3

import taut
from taut.control.laws.task_error import Coordinates, TaskError, task_error
from taut.maths.spatial import adjoint, pose_log_rate, rotation_exp
from taut.trace import math as tm

PANDA = taut.load_arm("panda")
ARMS = {
    "panda": PANDA,
    "ur10": taut.load_arm("ur10"),
    "xarm7": taut.load_arm("xarm7"),
    "so101": taut.load_arm("so101"),
}
BOUNDED = taut.compile(  # plain: what it asks out of reach, too
    taut.laws.TaskComputedTorque(kp=100.0, kd=20.0, error_max=(0.05, 0.2), singularity="plain"), PANDA, engine="float"
)
STEP = 2e-4  # [s] of differences
DIFFERENCE = 1e-8  # what they are worth, relative to the rates: a fifth derivative times STEP^4 / 30, and rounding
LOGARITHM = 1e-13  # of Pinocchio's and SciPy's logarithms, away from pi


def spherical(T: taut.Pose) -> Any:
    r = tm.norm(T.p)
    return tm.array([r, tm.acos(T.p[2] / r), tm.atan2(T.p[1], T.p[0])])


COORDINATES = {
    "position": Coordinates.position(),
    "position and rpy": Coordinates.position_and_rpy(),
    "spherical": Coordinates(function=spherical, angles=(2,)),
}
KINDS: dict[str, tuple[Any, Coordinates | None]] = {
    **{kind: (kind, None) for kind in ("decoupled", "body", "space")},
    **{name: ("coordinates", coordinates) for name, coordinates in COORDINATES.items()},
}


def slope(function: Callable[[float], Array], t: float) -> Array:
    """The rate of a function of time, by five points."""
    f = {k: function(t + k * STEP) for k in (-2, -1, 1, 2)}
    return (8.0 * (f[1] - f[-1]) - (f[2] - f[-2])) / (12.0 * STEP)


def error_at(name: str, arm: taut.Arm, q: Array, v: Array, ref: taut.TaskMotion) -> TaskError:
    kind, coordinates = KINDS[name]
    return task_error(taut.snapshot(arm, q, v), ref, kind=kind, coordinates=coordinates)


def motions(arm: taut.Arm, seed: int) -> tuple[JointPath, Target]:
    rng = np.random.default_rng(seed)
    path = JointPath.random(arm, rng)
    return path, Target.random(taut.snapshot(arm, path.at(0.0)[0]).T(), rng)


class TestTheError:
    def pair(self, seed: int) -> tuple[Array, taut.Pose, taut.TaskMotion]:
        path, target = motions(PANDA, seed)
        q = path.at(0.0)[0]
        return q, taut.snapshot(PANDA, q).T(), target.at(0.0)

    @pytest.mark.parametrize("seed", range(10))
    def test_is_what_pinocchio_and_scipy_say(self, seed: int) -> None:
        q, T, ref = self.pair(seed)
        v = np.zeros(7)
        decoupled = np.append(ref.p - T.p, Rotation.from_matrix(ref.R @ T.R.T).as_rotvec())
        assert np.abs(error_at("decoupled", PANDA, q, v, ref).X - decoupled).max() < LOGARITHM
        body = pin.log6(se3(T).actInv(se3(ref.pose))).vector
        assert np.abs(error_at("body", PANDA, q, v, ref).X - body).max() < LOGARITHM
        space = pin.log6(se3(ref.pose) * se3(T).inverse()).vector
        assert np.abs(error_at("space", PANDA, q, v, ref).X - space).max() < LOGARITHM
        rpy = np.append(ref.p - T.p, pin.rpy.matrixToRpy(ref.R) - pin.rpy.matrixToRpy(T.R))
        rpy[3:] = (rpy[3:] + np.pi) % (2.0 * np.pi) - np.pi
        assert np.abs(error_at("position and rpy", PANDA, q, v, ref).X - rpy).max() < LOGARITHM

    @pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-7, 0.0099, 0.0101, 3.0, np.pi - 1e-7])
    @pytest.mark.parametrize("name", ["decoupled", "body", "space"])
    def test_is_right_at_no_error_at_a_pure_translation_and_near_half_a_turn(self, name: str, angle: float) -> None:
        q = np.array(PANDA.home)
        T = taut.snapshot(PANDA, q).T()
        axis = np.array([1.0, -2.0, 2.0]) / 3.0
        for shift in (np.zeros(3), np.array([0.1, -0.2, 0.3])):
            R = Rotation.from_rotvec(angle * axis).as_matrix()
            if name == "body":
                made, ref = (
                    (shift, angle * axis),
                    taut.Pose.of(T.R @ R, T.p + T.R @ self.shifted(shift, angle * axis)),
                )
            elif name == "space":
                made, ref = (shift, angle * axis), taut.Pose.of(R @ T.R, R @ T.p + self.shifted(shift, angle * axis))
            else:
                made, ref = (shift, angle * axis), taut.Pose.of(R @ T.R, T.p + shift)
            got = error_at(name, PANDA, q, np.zeros(7), taut.TaskMotion(pose=ref)).X
            # Next to half a turn the angle is known to the root of what the entries of R are: about 1e-8 of 1e-7.
            assert np.abs(got - np.append(*made)).max() < 1e-14 * (1.0 if angle < 3.1 else 10.0) + 1e-15

    def shifted(self, v: Array, w: Array) -> Array:
        """Where the constant twist (v, w) takes the origin in a second: an integral, by quadrature."""
        nodes, weights = np.polynomial.legendre.leggauss(24)
        moved = [Rotation.from_rotvec(0.5 * (s + 1.0) * w).apply(v) for s in nodes]
        return 0.5 * np.einsum("i,ij->j", weights, np.array(moved))

    @pytest.mark.parametrize("name", KINDS)
    def test_is_nothing_at_the_target_itself(self, name: str) -> None:
        path, _ = motions(PANDA, 3)
        q, v, a = path.at(0.3)
        x = taut.snapshot(PANDA, q, v)
        ref = taut.TaskMotion(pose=x.T(), twist=x.twist(), acceleration=x.J() @ a + x.Jdot_v())
        error = error_at(name, PANDA, q, v, ref)
        assert np.abs(error.X).max() < 1e-15
        assert np.abs(error.V).max() < 1e-14
        assert np.abs(error.acceleration - (error.J @ a + error.Jdot_v)).max() < 1e-13

    def test_of_angles_goes_the_short_way_round(self) -> None:
        turn = Coordinates(function=lambda T: tm.array([tm.atan2(T.p[1], T.p[0])]), angles=(0,))
        x = taut.snapshot(taut.load_arm("planar2"), [3.0, 0.1])
        ref = taut.TaskMotion(pose=taut.Pose([np.cos(-3.0), np.sin(-3.0), 0.0]))
        short = task_error(x, ref, kind="coordinates", coordinates=turn).X[0]
        long = task_error(x, ref, kind="coordinates", coordinates=Coordinates(function=turn.function)).X[0]
        assert abs(short) < 0.5
        assert long == pytest.approx(short - 2.0 * np.pi, abs=1e-14)


class TestTheRates:
    @pytest.mark.part(1)
    @pytest.mark.parametrize("arm", ARMS)
    @pytest.mark.parametrize("name", KINDS)
    def test_of_velocity_errors_are_what_a_law_takes_them_for(self, name: str, arm: str) -> None:
        """V-dot = acceleration - (J a + Jdot_v), tool and target moving."""
        for seed in range(3):
            path, target = motions(ARMS[arm], seed)

            def V(t: float, path: JointPath = path, target: Target = target) -> Array:
                q, v, _ = path.at(t)
                return np.array(error_at(name, ARMS[arm], q, v, target.at(t)).V)

            t = 0.1 * seed
            q, v, a = path.at(t)
            error = error_at(name, ARMS[arm], q, v, target.at(t))
            expected = error.acceleration - (error.J @ a + error.Jdot_v)
            assert np.abs(slope(V, t) - expected).max() < DIFFERENCE * max(1.0, np.abs(expected).max())

    @pytest.mark.parametrize("name", COORDINATES)
    def test_of_errors_in_coordinates_are_their_velocity_errors(self, name: str) -> None:
        path, target = motions(PANDA, 1)

        def X(t: float) -> Array:
            q, v, _ = path.at(t)
            return np.array(error_at(name, PANDA, q, v, target.at(t)).X)

        q, v, _ = path.at(0.0)
        V = error_at(name, PANDA, q, v, target.at(0.0)).V
        assert np.abs(slope(X, 0.0) - V).max() < DIFFERENCE * np.abs(V).max()

    @pytest.mark.parametrize("name", ["body", "space"])
    def test_of_logarithms_follow_from_the_left_jacobian(self, name: str) -> None:
        """body: X-dot = Jl^-1 V, exactly; space: X-dot = Jl^-1 (V + (1 - Ad) V_tool)."""
        path, target = motions(PANDA, 2)

        def X(t: float) -> Array:
            q, v, _ = path.at(t)
            return np.array(error_at(name, PANDA, q, v, target.at(t)).X)

        q, v, _ = path.at(0.0)
        error = error_at(name, PANDA, q, v, target.at(0.0))
        twist = error.V
        if name == "space":
            T_e = target.at(0.0).pose @ taut.snapshot(PANDA, q).T().inverse()
            twist = twist + error.J @ v - adjoint(T_e) @ (error.J @ v)
        assert np.abs(slope(X, 0.0) - pose_log_rate(error.X) @ twist).max() < DIFFERENCE * np.abs(twist).max()

    @pytest.mark.parametrize(
        ("name", "turning", "order"),
        [
            ("decoupled", False, 2),
            ("body", False, 2),
            ("space", False, 2),
            ("decoupled", True, 1),
            ("body", True, 2),
            ("space", True, 1),
        ],
    )
    def test_agree_with_velocity_errors_to_the_order_that_the_docstring_says(
        self, name: str, turning: bool, order: int
    ) -> None:
        """X-dot - V falls with the error to the power 2, at a turning target to the power 1 but for body errors."""
        path = motions(PANDA, 4)[0]
        q, v, _ = path.at(0.0)
        x = taut.snapshot(PANDA, q, v)
        gaps = []
        for eps in (1e-2, 1e-3):
            # Near the tool, and moving with it but for a difference of the same size.
            away = taut.Pose.of(rotation_exp(eps * np.array([0.3, 0.8, -0.5])), eps * np.array([0.5, -0.2, 0.4]))
            motion = x.twist() if turning else np.zeros(6)
            V_des = motion + eps * np.array([0.5, 0.2, -0.4, 0.3, -0.7, 0.6])
            speed = v if turning else eps * v
            ref = taut.TaskMotion(pose=x.T() @ away, twist=V_des)

            def X(t: float, ref: taut.TaskMotion = ref, speed: Array = speed) -> Array:
                T = taut.Pose.of(rotation_exp(t * ref.twist[3:]) @ ref.R, ref.p + t * ref.twist[:3])
                return np.array(error_at(name, PANDA, q + t * speed, speed, taut.TaskMotion(pose=T)).X)

            gaps.append(np.abs(slope(X, 0.0) - error_at(name, PANDA, q, speed, ref).V).max())
        assert gaps[0] > 1e-6
        assert np.log10(gaps[0] / gaps[1]) == pytest.approx(order, abs=0.1)


class TestTheJacobian:
    @pytest.mark.parametrize("name", KINDS)
    def test_is_that_of_the_velocity_error(self, name: str) -> None:
        path, target = motions(PANDA, 5)
        q, v, _ = path.at(0.0)
        moving, resting = (error_at(name, PANDA, q, speed, target.at(0.0)) for speed in (v, np.zeros(7)))
        assert np.abs(moving.V - (resting.V - moving.J @ v)).max() < 1e-13

    @pytest.mark.parametrize("name", COORDINATES)
    def test_of_coordinates_is_their_difference_per_joint(self, name: str) -> None:
        q, v, _ = motions(PANDA, 6)[0].at(0.0)
        function, J = COORDINATES[name].function, error_at(name, PANDA, q, v, motions(PANDA, 6)[1].at(0.0)).J
        for i in range(7):
            e = 1e-6 * np.eye(7)[i]
            ends = [np.array(list(function(taut.snapshot(PANDA, q + s * e).T()))) for s in (1.0, -1.0)]
            assert np.abs((ends[0] - ends[1]) / 2e-6 - J[:, i]).max() < 1e-8

    def test_of_the_space_error_is_pinocchios_in_world_coordinates(self) -> None:
        path, target = motions(PANDA, 7)
        q, v, _ = path.at(0.0)
        x = taut.snapshot(PANDA, q, v)
        action = se3(taut.Pose(x.T().p, R=np.eye(3))).toActionMatrix()
        assert np.abs(error_at("space", PANDA, q, v, target.at(0.0)).J - action @ x.J()).max() < 1e-14


class TestTheBoundOfTheSpring:
    MAX = (0.05, 0.2)

    def spring(self, away: Array) -> tuple[Array, Array]:
        """(6,) kp X and what the terms P and bound accelerate the tool with, at a goal that far away."""
        q = np.array(PANDA.home)
        x = taut.snapshot(PANDA, q)
        goal = taut.Pose.of(rotation_exp(away[3:]) @ x.T().R, x.T().p + away[:3])
        BOUNDED.step(q, np.zeros(7), taut.TaskMotion(pose=goal))
        pull = BOUNDED.terms["P"] + BOUNDED.terms["bound"]
        return 100.0 * away, x.J() @ np.linalg.solve(x.M, pull)

    @pytest.mark.parametrize("size", [1e-6, 1e-2, 0.1, 1.0, 2.5])
    def test_pulls_along_the_error_and_never_by_more(self, size: float) -> None:
        away = size * np.array([0.5, -0.4, 0.3, -0.6, 0.7, 0.3])
        plain, got = self.spring(away)
        for part, most in ((slice(0, 3), self.MAX[0]), (slice(3, 6), self.MAX[1])):
            length = np.linalg.norm(away[part])
            np.testing.assert_allclose(got[part], plain[part] / np.sqrt(1.0 + (length / most) ** 2), rtol=1e-8)
            assert np.linalg.norm(got[part]) < 100.0 * most

    def test_is_smooth_where_the_error_vanishes(self) -> None:
        """Its slope is kp there: what it takes falls with the third power."""
        taken = []
        for size in (1e-2, 1e-3):
            plain, got = self.spring(size * np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
            taken.append(plain[0] - got[0])
        assert np.log10(taken[0] / taken[1]) == pytest.approx(3.0, abs=0.02)


class TestAnotherFrame:
    def test_is_controlled_where_it_is_named(self) -> None:
        path, target = motions(PANDA, 8)
        q, v, _ = path.at(0.0)
        x, frame = taut.snapshot(PANDA, q, v), "panda_link4"
        error = task_error(x, target.at(0.0), frame)
        assert np.array_equal(error.X[:3], target.at(0.0).p - x.T(frame).p)
        assert np.array_equal(error.J, x.J(frame))
