"""Impedance at the tool of every law on several arms: predicted against sweeps, against closed forms, against runs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest
from sine_sweep import measured_Z

import taut
from taut.base.types import Float64Array
from taut.control.combine import law_classes
from taut.trace import math as tm

laws, Plant = taut.laws, taut.RigidPlant
Bar = Callable[[str, object], None]

SAME = 1e-9  # of engines, relative to the largest entry
SWEPT = 1e-3  # of a sweep that moves the tool by a tenth of a millimetre
HELD = 0.01  # of the hold, and of a damping that acts a tick late
LOOSE = 1e-2  # of one of a tool that a law leaves free, and that drifts meanwhile
PROMISED = 0.005  # of the hold, at 4 kHz
LATE = 0.07  # of forces that are a tick old, and of a damping that acts in the tick's end, with a light hand
RATE = 4000.0
OMEGA = np.array([3.0, 30.0])
ARMS = ("planar2", "planar3", "gantry3", "panda", "ur10", "kinova")
Z_AXIS = [0.0, 0.0, 1.0]

FREE, TOUCHED, VELOCITY, POSITION = "free", "with a wrist sensor", "velocity drives", "position drives"


def own(arm: taut.Arm) -> Float64Array:
    """(n,) the inertia of each joint by itself."""
    return np.diag(taut.snapshot(arm, arm.home).M)


def admittance(inner: taut.Law) -> taut.Law:
    return laws.Admittance(D=(8.0, 0.4), B=(100.0, 6.0), K=(800.0, 30.0), inner=inner)


def on_a_plane(arm: taut.Arm, **force: Any) -> taut.Law:
    """Hybrid control whose constraint is the level that the tool of an arm at home is at."""
    level = float(taut.snapshot(arm, arm.home).T().p[2])
    motion = laws.TaskComputedTorque(kp=100.0, kd=20.0)
    return laws.HybridMotionForce(constraint=lambda T: T.p[2] - level, motion=motion, **force)


TASK = laws.TaskComputedTorque(kp=400.0, kd=40.0)
LAWS: dict[str, tuple[Callable[[taut.Arm], taut.Law], str]] = {
    "PID": (lambda arm: laws.PID(kp=400.0 * own(arm), kd=40.0 * own(arm)), FREE),
    "PID with an integral": (
        lambda arm: laws.PID(kp=400.0 * own(arm), kd=40.0 * own(arm), ki=400.0 * own(arm)),
        FREE,
    ),
    "Adaptive": (lambda _: laws.Adaptive(lam=10.0, k=10.0, gamma=2.0, max_payload=2.0), FREE),
    "Robust": (
        # without intervals: a bound on what is zero at rest, such as weight without gravity, is not smooth there
        lambda _: laws.Robust(
            lam=10.0,
            k=10.0,
            phi=1.0,
            uncertainty=laws.Uncertainty(disturbance=1.0, viscous=(0.0, 0.0), coulomb=(0.0, 0.0)),
        ),
        FREE,
    ),
    "StateFeedback": (
        lambda arm: taut.analysis.lqr(arm, Q=[400.0] * arm.n + [1.0] * arm.n, R=0.001, rate=RATE).law,
        FREE,
    ),
    "FeedForward + PID": (
        lambda arm: laws.FeedForward() + laws.PID(kp=400.0 * own(arm), kd=40.0 * own(arm)),
        FREE,
    ),
    "ComputedTorque": (lambda _: laws.ComputedTorque(kp=100.0, kd=20.0, ki=50.0), FREE),
    "GravityPID": (lambda arm: laws.GravityPID(kp=400.0 * own(arm), kd=40.0 * own(arm)), FREE),
    "GravityCompensation": (lambda arm: laws.GravityCompensation(kd=40.0 * own(arm)), FREE),
    "VelocityPI": (lambda _: laws.VelocityPI(kp=10.0, ki=5.0), VELOCITY),
    "JointPosition": (lambda _: laws.JointPosition(), POSITION),
    "via_joint_space": (lambda _: taut.via_joint_space(laws.ComputedTorque(kp=100.0, kd=20.0)), FREE),
    "via_joint_space, drives": (lambda _: taut.via_joint_space(laws.VelocityPI(kp=10.0)), VELOCITY),
    "TaskComputedTorque": (lambda _: laws.TaskComputedTorque(kp=100.0, kd=20.0, ki=50.0), FREE),
    "TaskComputedTorque, body": (lambda _: laws.TaskComputedTorque(kp=100.0, kd=20.0, error="body"), FREE),
    "TaskComputedTorque, space": (lambda _: laws.TaskComputedTorque(kp=100.0, kd=20.0, error="space"), FREE),
    "TaskVelocity": (lambda _: laws.TaskVelocity(kp=10.0), VELOCITY),
    "TaskPosition": (lambda _: laws.TaskPosition(kp=10.0), POSITION),
    "Impedance": (lambda _: laws.Impedance(K=(800.0, 30.0), zeta=0.7), FREE),
    "Impedance with D": (
        lambda _: laws.Impedance(K=(800.0, 30.0), zeta=0.7, D=(8.0, 0.4), feedback="wrench"),
        TOUCHED,
    ),
    "Stiffness": (lambda arm: laws.Stiffness(K=(800.0, 30.0), kd=10.0 * own(arm)), FREE),
    "Admittance": (lambda _: admittance(TASK), TOUCHED),
    "Admittance, drives": (lambda _: admittance(laws.TaskVelocity(kp=20.0)), VELOCITY),
    "Admittance, joints": (
        lambda _: admittance(taut.via_joint_space(laws.ComputedTorque(kp=900.0, kd=60.0))),
        TOUCHED,
    ),
    "ForceControl": (lambda _: laws.ForceControl(kfp=1.0, kdamp=(50.0, 5.0), feedback="wrench"), TOUCHED),
    "ForceControl, feedforward": (lambda _: laws.ForceControl(kdamp=(50.0, 5.0), feedback="none"), FREE),
    "HybridMotionForce": (lambda arm: on_a_plane(arm, kfp=1.0, kdamp=50.0), TOUCHED),
}
SPECIFYING = frozenset({"Impedance", "Impedance with D", "Admittance", "Admittance, drives", "Admittance, joints"})
HARD = frozenset({"VelocityPI", "JointPosition", "via_joint_space, drives", "TaskVelocity", "TaskPosition"})
DRIFTS = frozenset({"GravityCompensation", "ForceControl", "ForceControl, feedforward", "HybridMotionForce"})
LED = frozenset(
    {"Admittance", "Admittance, drives", "Admittance, joints"}
)  # the inner loop, or the drive, is in it besides
FELT = LED | {"Impedance with D"}
OBLIQUE = frozenset((law, "planar2") for law in (*LED, "Impedance with D"))  # D pushes two joints off their way


def plant_of(arm: taut.Arm, kind: str, sensed: bool) -> taut.RigidPlant:
    more: dict[str, Any] = {"environment": taut.environments.Push()} if kind == TOUCHED or sensed else {}
    if kind in (VELOCITY, POSITION):
        takes = kind.split(maxsplit=1)[0]
        return Plant(arm, friction=None, takes=takes, actuation=taut.drives.Actuation(bandwidth=400.0), **more)  # type: ignore[arg-type]
    return Plant(arm, friction=None, **more)


def loop_of(law: str, arm: taut.Arm, engine: Any = "auto") -> taut.Loop:
    make, kind = LAWS[law]
    ctrl = taut.compile(make(arm), arm, rate=RATE, engine=engine)
    return taut.Loop(ctrl, plant_of(arm, kind, law in LED), duration=0.5)


def test_every_law_of_motion_and_force_is_here() -> None:
    """Those that are not are parts of others."""
    parts = {"FeedForward", "FrictionCompensation", "Dither", "RaisedGains", "NormalEstimate", "Posture", "Sum"}
    parts |= {
        "AppliedWrench",
        "EnergyTank",
        "LimitAvoidance",
        "LossOfContact",
        "Manipulability",
        "SideBySide",
        "ViaMit",
        "VirtualWall",
        "VirtualGroove",
        "VirtualBall",
    }
    parts |= {"CollisionReflex", "DisturbanceRejection", "MotorSide", "FastTorqueLoop", "JointTorqueFeedback"}
    parts |= {
        "MotorSidePD",
        "FullStateFeedback",
        "FlexibleJointLinearisation",
        "VariableStiffness",
    }  # of elastic joints
    here = {name.partition(" ")[0].partition(",")[0] for name in LAWS} | {"ViaJointSpace"}
    assert set(law_classes(laws)) - parts <= here


@pytest.mark.bars
def test_predicted_is_what_is_measured_and_near_what_is_specified(share: Callable[[int], int], bar: Bar) -> None:
    pairs = [(law, name) for law in LAWS for name in ARMS]
    count = share(len(pairs)) if share(10) == 10 else share(len(pairs)) // 3
    chosen = np.random.default_rng(11).permutation(len(pairs))[:count]
    swept, promised = [], []
    for law, name in (pairs[i] for i in chosen):
        tip = taut.analysis.tool_impedance(loop_of(law, taut.load_arm(name)), direction=Z_AXIS, within=2.0)
        assert tip.lin.point.branches == (), (law, name)
        assert (tip.specified is not None) is (law in SPECIFYING and (law, name) not in OBLIQUE), (law, name)
        Z, measured = tip.Z(OMEGA), measured_Z(tip, OMEGA)
        if law in HARD:
            assert np.isinf(Z).all(), (law, name)
            assert np.abs(measured).min() > 1e12, (law, name)
            continue
        off = np.abs(measured / Z - 1.0).max()
        assert off < (LOOSE if law in DRIFTS else SWEPT), (law, name)
        if law not in DRIFTS:
            swept.append(off)
        if tip.specified is not None:
            far = np.abs(tip.specified_Z(OMEGA) / Z - 1.0)
            assert far[0] < (LATE if law in FELT else PROMISED), (law, name, far)
            if law not in FELT:
                assert far[1] < PROMISED, (law, name, far)
                promised.append(far.max())
    bar(f"impedance at the tool, {len(chosen)} pairs of law and arm: predicted against sweeps", f"{max(swept):.1e}")
    bar(
        f"the same at {RATE / 1e3:g} kHz: predicted against the continuous closed form",
        f"{100 * max(promised, default=0.0):.2g} %",
    )


@pytest.mark.bars
def test_the_derivative_in_native_code_is_that_of_plain_python(share: Callable[[int], int], bar: Bar) -> None:
    arm, names = taut.load_arm("planar2"), list(LAWS)
    off = []
    for i in np.random.default_rng(12).permutation(len(names))[: share(len(names))]:
        native, plain = (taut.linearise(loop_of(names[i], arm, e), within=2.0) for e in ("native", "float"))
        pairs = [(native.A, plain.A), (native.B, plain.B), (native.C, plain.C), (native.D, plain.D)]
        off.append(max(np.abs(one - other).max() / max(1.0, np.abs(other).max()) for one, other in pairs))
        assert off[-1] < SAME, names[i]
    bar(f"the derivative of a period, {len(off)} laws: native code against plain Python", f"{max(off):.1e}")


@pytest.mark.long
def test_an_admittance_that_stays_put_at_rest_gives_way_all_the_same() -> None:
    """At the very point both of its energies are zero, and its body stays: the model is of what it does beside it."""
    tip = taut.analysis.tool_impedance(loop_of("Admittance, drives", taut.load_arm("panda")), direction=Z_AXIS)
    assert abs(tip.Z(OMEGA[0])[0]) == pytest.approx(800.0, rel=0.1)
    assert pytest.approx(tip.Z(OMEGA[:1]), rel=SWEPT) == measured_Z(tip, OMEGA[:1])


@pytest.mark.long
def test_an_admittance_over_joints_is_what_a_sweep_measures() -> None:
    """At rest inverse kinematics takes the length of an error that is zero, to the last bit."""
    tip = taut.analysis.tool_impedance(loop_of("Admittance, joints", taut.load_arm("ur10")), direction=Z_AXIS)
    assert tip.lin.point.branches == ()
    assert pytest.approx(tip.Z(OMEGA), rel=SWEPT) == measured_Z(tip, OMEGA)


def test_a_tool_that_stays_where_it_is_put_is_measured_all_the_same() -> None:
    tip = taut.analysis.tool_impedance(loop_of("ForceControl", taut.load_arm("panda")), direction=Z_AXIS, within=2.0)
    assert sum(mode.resting for mode in tip.lin.modes) == 6
    assert pytest.approx(tip.Z(OMEGA[-1:]), rel=LOOSE) == measured_Z(tip, OMEGA[-1:])


def closed_form(arm: taut.Arm, omega: Float64Array, kfp: float, kdamp: float) -> tuple[Float64Array, float]:
    """(k, 6, 6) X / F of hybrid control over a plane z = const: eqs. 10.31, 10.38 and 10.45 with M a = tau + J^T F.

    P Lambda a is a less Lambda^-1 A^T S A a, and A X is no error of the motion, so that

        (s^2 + (kp + kd s) (I - A^T A) + s Lambda^-1 A^T D A) X = Lambda^-1 (I + A^T kfp A) F,

    with the damping that acts, D = 1 / (1 / kdamp + dt A Lambda^-1 A^T), which is the second value.
    """
    x = taut.snapshot(arm, arm.home)
    mobility = x.J() @ np.linalg.solve(x.M, x.J().T)
    A = np.array([[0.0, 0.0, 1.0, 0.0, 0.0, 0.0]])
    damping = 1.0 / (1.0 / kdamp + float(mobility[2, 2]) / RATE)
    along = np.eye(6) - A.T @ A
    out = []
    for s in 1j * omega:
        left = s * s * np.eye(6) + (100.0 + 20.0 * s) * along + s * damping * mobility @ A.T @ A
        out.append(np.linalg.solve(left, mobility @ (np.eye(6) + kfp * A.T @ A)))
    return np.array(out), damping


@pytest.mark.part(1)
@pytest.mark.parametrize("name", ["planar3", "gantry3", "ur10"])
@pytest.mark.parametrize("kfp", [0.0, 1.0])
def test_hybrid_control_is_motion_along_its_constraint_and_force_against_it(name: str, kfp: float) -> None:
    arm, omega = taut.load_arm(name), np.array([1.0, 5.0, 30.0])
    force = {"kfp": kfp, "kdamp": 50.0} if kfp else {"kdamp": 50.0}
    loop = taut.Loop(
        taut.compile(on_a_plane(arm, **force), arm, rate=RATE), plant_of(arm, TOUCHED, True), duration=0.5
    )
    (wanted, damping), slow = closed_form(arm, omega, kfp, 50.0), np.array([0.01, 0.1])
    for way, order in (([1.0, 0.0, 0.0], 0), (Z_AXIS, 1)):  # a spring along it, a damper against it
        tip, d = taut.analysis.tool_impedance(loop, direction=way), np.array([*way, 0.0, 0.0, 0.0])
        assert tip.Z(omega) == pytest.approx(1.0 / (wanted @ d @ d), rel=HELD)
        assert pytest.approx(tip.Z(omega[1:]), rel=LOOSE) == measured_Z(tip, omega[1:])
        few, more = np.abs(tip.Z(slow))
        assert more / few == pytest.approx(10.0**order, rel=0.01)
    assert more == pytest.approx(0.1 * damping / (1.0 + kfp), rel=0.01)


def test_a_force_loop_adds_nothing_to_the_stiffness_of_what_it_presses_on() -> None:
    """The sensor feels the contact and the hand that pushes: what the hand takes, the integral gives back."""
    arm, k = taut.load_arm("planar3"), 5000.0
    ctrl = taut.compile(on_a_plane(arm, kfi=5.0, kdamp=200.0), arm, rate=RATE)
    spring = taut.environments.Spring(stiffness=(k, 0.0), at=taut.snapshot(arm, arm.home).T())
    tip = taut.analysis.tool_impedance(
        taut.Loop(ctrl, Plant(arm, friction=None, environment=spring), duration=0.5), direction=Z_AXIS
    )
    assert tip.lin.stable
    assert abs(tip.Z(0.01)[0]) == pytest.approx(k, rel=1e-3)
    assert pytest.approx(tip.Z(OMEGA), rel=SWEPT) == measured_Z(tip, OMEGA)


@pytest.mark.part(1)
@pytest.mark.parametrize("law", ["Impedance", "Impedance with D"])
def test_directions_are_those_of_the_world_however_the_arm_is_mounted(law: str) -> None:
    turn = taut.Pose([0.1, 0.2, 0.3], rpy=(0.0, 0.0, 0.5 * np.pi))
    arms = [taut.load_arm("planar3"), taut.load_arm("planar3", T_WB=turn)]
    for ways in (
        ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0]),
        ([0.0, 0.0, 0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, -1.0, 0.0, 0.0]),
    ):
        one, other = (
            taut.analysis.tool_impedance(loop_of(law, arm), direction=way)
            for arm, way in zip(arms, ways, strict=True)
        )
        assert one.Z(OMEGA) == pytest.approx(other.Z(OMEGA), rel=1e-9)
        assert one.specified_Z(OMEGA) == pytest.approx(other.specified_Z(OMEGA), rel=1e-9)


class Wave(taut.environments.Environment):
    """A force that swings along one axis for ever: written here, so that nothing of a sweep is used."""

    force: Any
    omega: float

    def wrench(
        self,
        T_WE: Any,
        twist: Any,
        t: Any,
        memory: Any,
        parameters: Mapping[str, Any],
        dt: Any,
    ) -> tuple[Any, dict[str, Any]]:
        return self.force * tm.sin(self.omega * t), {}


@pytest.mark.part(1)
@pytest.mark.parametrize("law", ["GravityPID", "Impedance", "Admittance"])
def test_a_run_against_a_swinging_force_has_the_predicted_admittance(law: str) -> None:
    """Delta X = Y Delta F, with the tool's motion out of the joints' by forward kinematics."""
    arm, omega, dt = taut.load_arm("planar3"), 20.0, 1e-3
    way = np.array([0.6, 0.0, 0.8, 0.0, 0.0, 0.0])
    ctrl = taut.compile(LAWS[law][0](arm), arm)
    tip = taut.analysis.tool_impedance(taut.Loop(ctrl, plant_of(arm, TOUCHED, True), duration=0.5), direction=way)
    force = 1e-4 * abs(tip.Z(omega)[0])
    plant = Plant(arm, friction=None, environment=Wave(force=force * way, omega=omega))
    run = taut.run(ctrl, plant, duration=4.0)
    late = run.t > 4.0 - 3.0 * 2.0 * np.pi / omega
    home = taut.snapshot(arm, run.q[0]).T().p
    moved = np.array([(taut.snapshot(arm, q).T().p - home) @ way[:3] for q in run.q[late]])
    basis = np.stack([np.sin(omega * run.t[late]), np.cos(omega * run.t[late]), np.ones(late.sum())], axis=1)
    along, across, _ = np.linalg.lstsq(basis, moved, rcond=None)[0]
    assert run.t[1] == pytest.approx(dt)
    assert (along + 1j * across) / force == pytest.approx(tip.Y(omega)[0], rel=2e-3)
