"""Impedance and stiffness control as laws: the torque written out, the spring against its energy, refusals."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from refusals import refused
from scipy.linalg import eigh

import taut
from taut.control.laws.task_error import task_error
from taut.control.laws.task_space import modal_damping
from taut.control.trajectories.task_reference import TaskMotion
from taut.maths.spatial import rotation_exp, rotation_log
from taut.trace.linalg import factor_spd

ENGINES = 1e-9  # MATHS section 2: task laws, relative to the largest torque
ARMS = ["panda", "ur10", "kinova"]
K = np.array([800.0, 600.0, 400.0, 30.0, 20.0, 10.0])
B = np.array([60.0, 50.0, 40.0, 3.0, 2.0, 1.0])
FAR, NEAR = np.array([10.0, 0.0, 0.0]), np.array([0.01, 0.0, -0.01])  # [m]
Impedance, Stiffness = taut.laws.Impedance, taut.laws.Stiffness


def state(arm: taut.Arm, seed: int) -> Any:
    rng = np.random.default_rng(seed)
    q, v = arm.home + rng.uniform(-0.4, 0.4, arm.n), rng.uniform(-0.5, 0.5, arm.n)
    T = taut.snapshot(arm, q).T()
    pose = taut.Pose.of(rotation_exp(rng.uniform(-0.3, 0.3, 3)) @ T.R, T.p + rng.uniform(-0.05, 0.05, 3))
    ref = TaskMotion(pose=pose, twist=rng.uniform(-0.3, 0.3, 6), acceleration=rng.uniform(-1.0, 1.0, 6))
    return q, v, ref


@pytest.mark.parametrize("name", ARMS)
def test_the_torque_is_the_law_written_out(name: str) -> None:
    arm = taut.load_arm(name)
    ctrl = taut.compile(Impedance(K=K, B=B, null=None), arm)
    for seed in range(5):
        q, v, ref = state(arm, seed)
        x = taut.snapshot(arm, q, v)  # whose terms are tested against Pinocchio by themselves
        M, h, J, Jdot_v, T = x.M, x.h, x.J(), x.Jdot_v(), x.T()
        Lam = np.linalg.inv(J @ np.linalg.inv(M) @ J.T)
        e = rotation_log(ref.R @ T.R.T)
        f = K[3:] * e
        c = (1.0 - 0.5 * np.linalg.norm(e) / np.tan(0.5 * np.linalg.norm(e))) / (e @ e)
        moment = f - 0.5 * np.cross(e, f) + c * np.cross(e, np.cross(e, f))  # the gradient of e . K e / 2
        spring = np.concatenate([K[:3] * (ref.p - T.p), moment])
        wanted = J.T @ (Lam @ (ref.acceleration - Jdot_v) + spring + B * (ref.twist - J @ v)) + h
        assert np.abs(ctrl.step(q, v, ref) - wanted).max() <= ENGINES * np.abs(wanted).max()


def test_with_equal_stiffness_the_moment_of_the_spring_is_the_rotation_vector_times_it() -> None:
    arm = taut.load_arm("panda")
    ctrl = taut.compile(Impedance(K=(500.0, 25.0), B=(1.0, 1.0), null=None), arm)
    q, v, ref = state(arm, 7)
    ctrl.step(q, v, ref)
    x = taut.snapshot(arm, q)
    e = np.concatenate([500.0 * (ref.p - x.T().p), 25.0 * rotation_log(ref.R @ x.T().R.T)])
    assert ctrl.terms["P"] == pytest.approx(x.J().T @ e, rel=1e-10)


# ------------------------------------------------------------------ the spring

SPRINGS = [
    {"frame": "world"},
    {"frame": "task"},
    {"frame": "tool"},
    {"error": "body"},
    {"error": "space"},
    {"error": "coordinates", "coordinates": taut.Coordinates(function=lambda T: T.p), "K": K[:3]},
]


@pytest.mark.part(1)
@pytest.mark.parametrize("options", SPRINGS, ids=lambda o: "-".join(str(v) for v in o.values() if isinstance(v, str)))
@pytest.mark.parametrize("name", ["panda", "ur10"])
def test_the_spring_is_the_gradient_of_its_energy(name: str, options: dict[str, Any]) -> None:
    arm = taut.load_arm(name)
    gains = {"K": K, **options}
    stiff = np.asarray(gains["K"])
    law = Stiffness(**gains)
    ctrl = taut.compile(law, arm)
    h = 1e-6
    for seed in range(3):
        q, _, moving = state(arm, seed)
        ref = TaskMotion(pose=moving.pose)
        ctrl.step(q, np.zeros(arm.n), ref)

        def energy(q: Any, ref: Any = ref) -> float:
            x = taut.snapshot(arm, q)
            felt = law.space.at(x, ref)
            return float(0.5 * felt.X @ (stiff * felt.X))

        slope = [(energy(q + h * e) - energy(q - h * e)) / (2.0 * h) for e in np.eye(arm.n)]
        assert ctrl.terms["P"] == pytest.approx(-np.array(slope), abs=2e-7 * np.abs(ctrl.terms["P"]).max())


@pytest.mark.parametrize("kind", ["random", "light wrist", "no stiffness in one direction"])
def test_designed_damping_has_its_ratio_in_every_mode(kind: str) -> None:
    rng = np.random.default_rng(3)
    for _ in range(20):
        A = rng.normal(size=(6, 6))
        Lam = A @ A.T + 0.1 * np.eye(6)
        stiff = np.diag(10.0 ** rng.uniform(0.0, 3.0, 6))
        if kind == "light wrist":
            Lam[3:] *= 0.05
            Lam[:, 3:] *= 0.05
        if kind == "no stiffness in one direction":
            stiff[2, 2] = 0.0
        factors = factor_spd(Lam)
        designed = np.column_stack([modal_damping(factors, stiff, 0.7, column) for column in np.eye(6)])
        values, vectors = eigh(stiff, Lam)
        modes = vectors.T @ designed @ vectors
        wanted = np.diag(1.4 * np.sqrt(np.maximum(values, 0.0)))
        assert np.abs(modes - wanted).max() <= 1e-4 * wanted.max()
        assert np.abs(designed - designed.T).max() <= 1e-4 * np.abs(designed).max()


def test_the_bound_of_the_spring_is_a_term_of_its_own() -> None:
    arm = taut.load_arm("panda")
    ctrl = taut.compile(Impedance(K=(800.0, 30.0), B=(1.0, 1.0), error_max=(0.02, 0.1), null=None), arm)
    T = taut.snapshot(arm, arm.home).T()
    ctrl.step(arm.home, np.zeros(7), TaskMotion(pose=taut.Pose(T.p + FAR, R=T.R)))
    J = taut.snapshot(arm, arm.home).J()
    force = np.linalg.lstsq(J.T, ctrl.terms["P"] + ctrl.terms["bound"], rcond=None)[0]
    assert force[0] == pytest.approx(800.0 * 0.02, rel=1e-4)
    ctrl.parameters["law.error_max"] = (0.04, 0.1)
    ctrl.step(arm.home, np.zeros(7), TaskMotion(pose=taut.Pose(T.p + FAR, R=T.R)))
    force = np.linalg.lstsq(J.T, ctrl.terms["P"] + ctrl.terms["bound"], rcond=None)[0]
    assert force[0] == pytest.approx(800.0 * 0.04, rel=1e-4)


@pytest.mark.parametrize("frame", ["world", "tool"])
def test_the_bounded_spring_is_the_gradient_of_an_energy_too(frame: Any) -> None:
    arm = taut.load_arm("panda")
    most = np.array([0.02, 0.1])
    ctrl = taut.compile(Stiffness(K=K, error_max=most, frame=frame), arm)
    q, _, moving = state(arm, 2)
    ref = TaskMotion(pose=moving.pose)
    ctrl.step(q, np.zeros(7), ref)

    def energy(q: Any) -> float:
        X = task_error(taut.snapshot(arm, q), ref, frame=frame).X
        parts = [X[:3], X[3:]]
        Y = np.concatenate(
            [
                x * np.sqrt(2.0 / (1.0 + np.hypot(1.0, np.linalg.norm(x) / m)))
                for x, m in zip(parts, most, strict=True)
            ]
        )
        return float(0.5 * Y @ (K * Y))

    slope = np.array([(energy(q + 1e-6 * e) - energy(q - 1e-6 * e)) / 2e-6 for e in np.eye(7)])
    spring = ctrl.terms["P"] + ctrl.terms["bound"]
    assert spring == pytest.approx(-slope, abs=1e-6 * np.abs(spring).max())


def test_a_bounded_spring_pays_for_what_grows_while_another_falls() -> None:
    arm = taut.load_arm("panda")
    spring = Impedance(K=(5000.0, 1.0), B=(1.0, 1.0), error_max=(0.001, 1.0), null=None)
    law = taut.laws.EnergyTank(law=spring, capacity=0.05, settle=0.001)
    ctrl = taut.compile(law, arm)
    T = taut.snapshot(arm, arm.home).T()
    turned = rotation_exp(np.array([0.5, 0.0, 0.0])) @ T.R
    ref = TaskMotion(pose=taut.Pose.of(turned, T.p + 10.0 * NEAR))
    ctrl.step(arm.home, np.zeros(7), ref)
    ctrl.parameters["law.K"] = (0.0, 100.0)  # 0.7 J less, 12.4 J more, where X K X / 2 says 50 J less
    for _ in range(5):
        ctrl.step(arm.home, np.zeros(7), ref)
    assert ctrl.memory["law.now.K"][3] < 5.0
    assert ctrl.memory["law.energy"] == pytest.approx(0.0, abs=1e-9)


def test_what_a_law_holds_beside_does_not_say_which_frame_it_controls() -> None:
    arm, elbow = taut.load_arm("panda"), taut.laws.Manipulability(tool="panda_link4")
    wall = taut.laws.VirtualWall(point=[0.0, 0.0, 0.0], normal=[0.0, 0.0, 1.0], K=100.0, tool="panda_link4")
    x = taut.snapshot(arm, arm.home)
    for law in (
        Impedance(K=(500.0, 20.0), zeta=0.7, null=elbow),
        wall + Impedance(K=(500.0, 20.0), zeta=0.7),
    ):
        assert law.controlled_frame is None
        assert law.at_rest(x).p == pytest.approx(x.T().p)  # type: ignore[attr-defined]


@pytest.mark.parametrize("twist", [0.5, -0.5])
def test_a_reference_that_moves_before_a_blocked_arm_fills_no_tank(twist: float) -> None:
    arm = taut.load_arm("panda")
    spring = Impedance(K=(500.0, 20.0), B=(50.0, 5.0), null=None)
    ctrl = taut.compile(taut.laws.EnergyTank(law=spring, capacity=1.0, settle=0.01), arm)
    T = taut.snapshot(arm, arm.home).T()
    ref = TaskMotion(pose=taut.Pose(T.p + 10.0 * NEAR, R=T.R), twist=[twist, 0.0, 0.0, 0.0, 0.0, 0.0])
    ctrl.step(arm.home, np.zeros(7), ref)
    ctrl.parameters["law.K"] = (3000.0, 20.0)
    for _ in range(200):
        ctrl.step(arm.home, np.zeros(7), ref)
    assert ctrl.memory["law.energy"] == pytest.approx(0.0, abs=1e-9)
    assert 0.5 * (ctrl.memory["law.now.K"][0] - 500.0) * 0.02 == pytest.approx(1.0, rel=1e-6)


def test_a_wrench_of_another_link_is_refused() -> None:
    inner = taut.laws.TaskVelocity(kp=5.0, tool="panda_link6")
    for law in (
        Impedance(**gains(D=(2.0, 0.2), tool="panda_link6")),
        taut.laws.Admittance(D=(5.0, 0.5), B=(40.0, 4.0), tool="panda_link6", inner=inner),
    ):
        with refused(taut.errors.MatchError):
            taut.compile(law, taut.load_arm("panda")).needs  # noqa: B018
    taut.compile(Impedance(**gains(D=(2.0, 0.2), tool="panda_hand")), taut.load_arm("panda"))


def test_an_inertia_cannot_become_zero_in_a_run() -> None:
    ctrl = taut.compile(Impedance(**gains(D=(5.0, 0.5))), taut.load_arm("panda"))
    with refused(taut.errors.RangeError):
        ctrl.parameters["law.D"] = (0.0, 0.5)


@pytest.mark.part(2)
@pytest.mark.parametrize("name", ["planar2", "planar3", "gantry3", "so101"])
@pytest.mark.parametrize("damping", [{"zeta": 0.7}, {"B": (0.5, 0.001)}], ids=["zeta", "B"])
def test_an_arm_of_few_joints_moves_in_the_directions_that_it_has(name: str, damping: dict[str, Any]) -> None:
    arm = taut.load_arm(name)
    T = taut.snapshot(arm, arm.home).T()
    for engine in ("native", "float"):
        ctrl = taut.compile(Impedance(K=(400.0, 20.0), **damping), arm, engine=engine)  # type: ignore[arg-type]
        ref = TaskMotion(pose=taut.Pose(T.p + NEAR, R=T.R))
        tau = ctrl.step(arm.home, 0.1 * np.ones(arm.n), ref)
        assert np.isfinite(tau).all()
        assert np.abs(tau).max() < 100.0


# ------------------------------------------------------------------ refusals


def gains(**given: Any) -> dict[str, Any]:
    return {"K": (800.0, 30.0), "zeta": 0.7} | given


REFUSED: dict[str, dict[str, Any]] = {
    "one number for both units": gains(K=800.0),
    "one number of damping": {"K": (1.0, 1.0), "B": 5.0},
    "both": gains(B=(1.0, 1.0)),
    "neither": {"K": (1.0, 1.0)},
    "negative": gains(K=(-1.0, 30.0)),
    "zeta of each": gains(zeta=[0.7, 0.7]),
    "no inertia": gains(D=(0.0, 1.0)),
    "a frame that is none": gains(frame="hand"),
    "axes of another error": gains(frame="tool", error="body"),
    "feedback without an inertia": gains(feedback="acceleration"),
    "a damping ratio without a swing": gains(K=(800.0, 0.0)),
    "a null law that follows something": gains(null=taut.laws.PID(kp=1.0)),
}


@pytest.mark.parametrize("case", REFUSED, ids=lambda case: case)
def test_gains_without_a_meaning_get_one_sentence(case: str) -> None:
    given = REFUSED[case]
    with refused(taut.TautError):
        Impedance(**given)


@pytest.mark.parametrize(
    "matrix",
    [
        np.diag([1.0, 1.0, 1.0, 1.0, 1.0, -1.0]),
        np.eye(6) + np.eye(6, k=1),
    ],
)
def test_a_matrix_must_be_symmetric_and_positive(matrix: Any) -> None:
    with refused(taut.errors.RangeError):
        Impedance(K=matrix, zeta=1.0)


def test_a_frame_that_the_arm_has_not_is_told_with_the_nearest() -> None:
    with refused(taut.errors.UnknownNameError):
        taut.compile(Impedance(**gains(tool="panda_hand_tpc")), taut.load_arm("panda")).needs  # noqa: B018


def test_a_wrench_that_nobody_measures_is_told() -> None:
    arm = taut.load_arm("panda")
    ctrl = taut.compile(Impedance(**gains(D=(2.0, 0.2))), arm)
    ref = TaskMotion(pose=taut.snapshot(arm, arm.home).T())
    with refused(taut.errors.UsageError):
        ctrl.step(arm.home, np.zeros(7), ref)
    with refused(taut.errors.MatchError):
        taut.run(ctrl, taut.RigidPlant(arm), ref, duration=0.1)


def test_a_new_stiffness_is_checked_like_the_first() -> None:
    arm = taut.load_arm("panda")
    ctrl = taut.compile(Impedance(**gains()), arm)
    with refused(taut.errors.ShapeError):
        ctrl.parameters["law.K"] = 500.0
    ctrl.parameters["law.K"] = (500.0, 10.0)
    assert ctrl.parameters["law.K"].tolist() == [500.0] * 3 + [10.0] * 3
    with refused(taut.errors.RangeError):
        taut.compile(Impedance(**gains(error_max=(0.1, 0.1))), arm).parameters["law.error_max"] = (0.0, 0.1)


def test_three_numbers_are_refused_with_what_is_taken() -> None:
    with refused(taut.errors.ShapeError):
        taut.compile(Impedance(**gains(K=[1.0, 1.0, 1.0])), taut.load_arm("panda"))


def test_a_function_that_gives_no_gain_is_told_where_a_run_starts() -> None:
    arm = taut.load_arm("panda")
    spring = Impedance(K=(1.0, 1.0), B=(8.0, 1.0))
    law = taut.laws.EnergyTank(law=spring, stiffness=lambda T: [-100.0 + 0.0 * T.p[0], 10.0], capacity=0.1)
    with refused(taut.errors.RangeError):
        taut.compile(law, arm).needs  # noqa: B018


def test_a_frame_that_lacks_two_directions_is_told() -> None:
    with refused(taut.errors.MatchError):
        taut.compile(Impedance(**gains(tool="panda_link4")), taut.load_arm("panda")).needs  # noqa: B018


def test_a_posture_in_degrees_is_told() -> None:
    arm = taut.load_arm("panda")
    law = Impedance(**gains(null=taut.laws.Posture(q=[0.0, -45.0, 0.0, -135.0, 0.0, 90.0, 45.0])))
    with refused(taut.errors.RangeError):
        taut.compile(law, arm).needs  # noqa: B018


def test_a_pose_in_degrees_is_told() -> None:
    with refused(taut.errors.RangeError):
        taut.Pose([0.0, 0.0, 0.0], rpy=[180.0, 0.0, 90.0])


def test_a_planar_arm_feels_at_its_tool_what_it_can_move() -> None:
    """It lacks directions, of which the rest must not know."""
    arm = taut.load_arm("planar2")
    ctrl = taut.compile(taut.laws.Impedance(K=(400.0, 20.0), zeta=0.7), arm)
    run = taut.run(ctrl, taut.RigidPlant(arm, friction=None), q0=[0.3, 0.8], duration=0.05)
    assert run.outcome.ok
