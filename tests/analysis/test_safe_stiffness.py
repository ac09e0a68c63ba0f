"""Which stiffness is safe at the tool of an arm: against joint space, against runs, and in words."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import taut

PANDA = taut.load_arm("panda")
PLANAR = taut.load_arm("planar2")
POSE = [0.3, 0.8]


class TestAtTheTool:
    def test_a_loop_of_the_tool_has_the_poles_of_the_joints(self) -> None:
        """The linear arm in its own joints: M, the joints' damping, J^T K J and J^T B J."""
        K, B = np.diag([900.0, 400.0]), np.diag([8.0, 3.0])
        arm = PLANAR.with_joints(viscous=[0.3, 0.1])
        x = taut.snapshot(arm, POSE)
        J = x.J()[[0, 2]]
        joints = taut.analysis.SampledLoop(
            mass=x.M, damping=arm.viscous, K=J.T @ K @ J, B=J.T @ B @ J, rate=500.0, delay=1e-3, velocity="difference"
        )
        six = np.zeros((6, 6))
        six[np.ix_([0, 2], [0, 2])] = K
        damper = np.zeros((6, 6))
        damper[np.ix_([0, 2], [0, 2])] = B
        check = taut.analysis.check_stiffness_at(
            arm, POSE, K=six, B=damper, rate=500.0, delay=1e-3, velocity="difference"
        )
        np.testing.assert_allclose(np.abs(check.loop.poles())[:4], np.abs(joints.poles())[:4], rtol=1e-9)
        assert check.stable == joints.stable

    @pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
    def test_its_border_is_that_of_runs(self) -> None:
        """A stiff spring along x and z at the tool of two links, undamped but for the joints: runs grow above it."""
        arm = PLANAR.with_gravity([0.0, 0.0, 0.0]).with_joints(viscous=[2.0, 1.0])

        class TipSpring(taut.Law):
            K: taut.Gain = taut.Gain(shape=3)

            def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
                away = x.T().p - x.at(ref.q, ref.v).T().p
                return taut.Torque(spring=-x.J()[:3].T @ (self.K @ away))

        ctrl = taut.compile(TipSpring(K=[1.0, 1.0, 1.0]), arm)
        plant = taut.RigidPlant(arm, integrator="rk4")
        border = taut.analysis.check_stiffness_at(arm, POSE, K=(1.0, 0.0)).stable_up_to
        for factor, grows in ((0.97, False), (1.03, True)):
            ctrl.parameters["law.K"] = np.full(3, factor * border)
            run = taut.run(ctrl, plant, taut.JointMotion(q=POSE), duration=4.0, q0=[POSE[0] + 1e-7, POSE[1] - 1e-7])
            energy = np.hanning(1000)[:, np.newaxis]
            middle, end = ((energy * run.v[k : k + 1000] ** 2).sum() for k in (1500, 3000))
            assert bool(end > middle) is grows

    @pytest.mark.parametrize("direction", [[1, 0, 0], [0, 0, 2.0], [0, 0, 0, 0, 1.0, 0]])
    def test_a_direction_has_its_mass_and_its_least_damping(self, direction: list[float]) -> None:
        x = taut.snapshot(PANDA, PANDA.home)
        way = np.zeros(6)
        way[: len(direction)] = direction
        way /= np.linalg.norm(way)
        joints = np.linspace(0.5, 2.0, 7)
        limits = taut.analysis.safe_stiffness(PANDA, PANDA.home, direction, damping=joints)
        mass = 1.0 / (way @ x.J() @ np.linalg.inv(x.M) @ x.J().T @ way)
        assert np.asarray(limits.loop.mass)[0, 0] == pytest.approx(mass, rel=1e-9)
        # The least power of joint speeds that move the tool at unit speed along it: a constrained minimum.
        lost = 1.0 / (way @ x.J() @ np.diag(1.0 / joints) @ x.J().T @ way)
        assert np.asarray(limits.loop.damping)[0, 0] == pytest.approx(lost, rel=1e-9)
        assert limits.unit == ("N/m" if len(direction) == 3 else "N m/rad")

    def test_frames_turn_stiffness_along(self) -> None:
        options = {"K": (500.0, 20.0), "rate": 500.0, "delay": 2e-3, "damping": 1.0}
        in_world = taut.analysis.check_stiffness_at(PANDA, PANDA.home, **options)
        in_tool = taut.analysis.check_stiffness_at(PANDA, PANDA.home, frame="tool", **options)
        assert in_world.stable_up_to == pytest.approx(in_tool.stable_up_to, rel=1e-6)
        bent = PANDA.home + np.linspace(-0.4, 0.5, 7)
        stiff = {**options, "K": (500.0, 50.0, 50.0, 20.0, 20.0, 20.0)}
        turned = [
            taut.analysis.check_stiffness_at(PANDA, bent, frame=f, **stiff).stable_up_to for f in ("world", "tool")
        ]
        assert abs(turned[0] / turned[1] - 1.0) > 1e-3

    def test_a_matrix_is_passive_where_its_weakest_direction_is(self) -> None:
        turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
        K, b = np.array([1000.0, 3000.0, 200.0]), 2.0
        check = taut.analysis.check_stiffness(np.eye(3), K=turn @ np.diag(K) @ turn.T, damping=b)
        assert check.passive_up_to == pytest.approx(2.0 * b / 1e-3 / 3000.0, rel=1e-6)
        assert check.spare_damping == pytest.approx(b - 3000.0 * 0.5e-3, rel=1e-6)
        assert check.passive

    def test_in_words(self) -> None:
        check = taut.analysis.check_stiffness(np.eye(2), K=[5000.0, 100.0], damping=1.0)
        assert check.sentences == (
            "unstable by itself; up to 0.4 K it is not so",
            "some passive environment makes it unstable; up to 0.4 K it is not so",
            "gives energy to some motion below 500 Hz; up to 0.4 K it is not so",
        )
        limits = taut.analysis.stiffness_limits(mass=0.2, B=5.0, band=20.0)
        assert str(limits).splitlines() == [
            "stable by itself up to 1e+04 N/m, by the eigenvalues of the sampled loop; (b + B) / (T/2 + delay) says "
            "1e+04 N/m, -0.0 %",
            "no stiffness is stable with every passive environment: the arm has no damping of its own; (b - |B|) / (T/2 "
            "+ delay) says 0 N/m",
            "gives no energy to motion below 20 Hz up to 9987 N/m",
        ]


REFUSED: list[tuple[Callable[[], object], type[Exception], str]] = [
    (
        lambda: taut.analysis.stiffness_limits(mass=0.0),
        taut.errors.RangeError,
        "mass must be positive definite [kg]; its smallest eigenvalue is 0",
    ),
    (
        lambda: taut.analysis.stiffness_limits(mass=[1.0, 2.0]),
        taut.errors.ShapeError,
        "mass must be one number [kg]; got [1.0, 2.0]",
    ),
    (
        lambda: taut.analysis.stiffness_limits(mass=1.0, damping=-1.0),
        taut.errors.RangeError,
        "damping must be positive semidefinite ",
    ),
    (
        lambda: taut.analysis.stiffness_limits(mass=1.0, rate=0.0),
        taut.errors.RangeError,
        "rate must be > 0 [Hz]; got 0.0",
    ),
    (
        lambda: taut.analysis.stiffness_limits(mass=1.0, delay=-1e-3),
        taut.errors.RangeError,
        "delay must be >= 0 [s]; got -0.001",
    ),
    (
        lambda: taut.analysis.stiffness_limits(mass=1.0, delay=2.0),
        taut.errors.RangeError,
        "delay must be at most 1000 periods of 0.001 s; got 2 s",
    ),
    (
        lambda: taut.analysis.stiffness_limits(mass=1.0, velocity="differenced"),
        taut.errors.UsageError,
        "velocity must be 'measured', 'difference', taut.sensors.LowPass(...) or taut.sensors.Difference(...); got 'differenced'",
    ),
    (
        lambda: taut.analysis.stiffness_limits(mass=1.0, velocity=taut.sensors.LowPass(cutoff=600.0)),
        taut.errors.RangeError,
        "velocity.cutoff must be < 500 [Hz], half the controller's rate",
    ),
    (
        lambda: taut.analysis.SampledLoop(mass=[1.0, 1.0], velocity=taut.sensors.LowPass(cutoff=[50.0, 60.0])),
        taut.errors.UsageError,
        "velocity.cutoff must be one number here, for all directions",
    ),
    (
        lambda: taut.analysis.stiffness_limits(mass=1.0, integrator="rk4"),
        taut.errors.UsageError,
        "integrator must be one of 'exact', 'semi-implicit-euler'; got 'rk4'",
    ),
    (
        lambda: taut.analysis.stiffness_limits(mass=1.0, substeps=0, integrator="semi-implicit-euler"),
        taut.errors.RangeError,
        "substeps must be a whole number >= 1; got 0",
    ),
    (
        lambda: taut.analysis.stiffness_limits(mass=1.0, substeps=5),
        taut.errors.UsageError,
        "substeps are for integrator='semi-implicit-euler'; leave them out",
    ),
    (
        lambda: taut.analysis.stiffness_limits(mass=1.0, delay=0.5e-3, integrator="semi-implicit-euler"),
        taut.errors.UsageError,
        "a delay of part of a period is for integrator='exact'; RigidPlant delays by whole periods",
    ),
    (
        lambda: taut.analysis.stiffness_limits(mass=1.0, band=600.0),
        taut.errors.RangeError,
        "band must be at most 500 [Hz], half the rate; got 600",
    ),
    (
        lambda: taut.analysis.check_stiffness(np.eye(2), K=[[1.0, 2.0], [0.0, 1.0]]),
        taut.errors.RangeError,
        "K must be a symmetric matrix; it differs from its transpose by 2",
    ),
    (
        lambda: taut.analysis.check_stiffness(np.eye(2), K=[1.0, 2.0, 3.0]),
        taut.errors.ShapeError,
        "K must be a number, (2,) or (2, 2); got shape (3,)",
    ),
    (
        lambda: taut.analysis.check_stiffness(np.eye(2), K=[-1.0, 2.0]),
        taut.errors.RangeError,
        "K must be positive semidefinite [N/m]; its smallest eigenvalue is -1",
    ),
    (
        lambda: taut.analysis.check_stiffness_at(PANDA, PANDA.home, K=500.0),
        taut.errors.ShapeError,
        "K must be (linear, angular), (6,) or (6, 6): one number cannot be both per metre and per radian; got 500",
    ),
    (
        lambda: taut.analysis.check_stiffness_at("panda", [0.0], K=(1.0, 1.0)),
        taut.errors.UsageError,
        "an Arm from taut.load_arm is needed; got str",
    ),
    (
        lambda: taut.analysis.safe_stiffness(PANDA, PANDA.home, [1, 0, 0], damping=[1.0, 2.0]),
        taut.errors.ShapeError,
        "damping must be a number or (7,); got shape (2,)",
    ),
    (
        lambda: taut.analysis.safe_stiffness(PANDA, PANDA.home, [1, 0]),
        taut.errors.ShapeError,
        "direction must have shape (3,) or (6,); got shape (2,)",
    ),
    (
        lambda: taut.analysis.safe_stiffness(PANDA, PANDA.home, [0, 0, 0]),
        taut.errors.RangeError,
        "direction must not be zero",
    ),
    (
        lambda: taut.analysis.safe_stiffness(PANDA, PANDA.home, [1, 0, 0, 1, 0, 0]),
        taut.errors.RangeError,
        "direction must be a translation or a rotation, not both; got [1.0, 0.0, 0.0, 1.0, 0.0, 0.0]",
    ),
    (
        lambda: taut.analysis.safe_stiffness(PLANAR, POSE, [0, 1, 0]),
        taut.errors.RangeError,
        "arm 'planar2' cannot move its tool along [0.0, 1.0, 0.0, 0.0, 0.0, 0.0] at this pose; choose another "
        "direction or pose",
    ),
    (
        lambda: taut.analysis.safe_stiffness(PLANAR, POSE, [1, 0, 0], frame="base"),
        taut.errors.UsageError,
        "frame must be one of 'world', 'tool'; got 'base'",
    ),
    (
        lambda: taut.analysis.safe_stiffness(PLANAR, POSE, [1, 0, 0], tool="tip"),
        taut.errors.UnknownNameError,
        "has no frame 'tip'",
    ),
]


@pytest.mark.parametrize(("call", "kind", "words"), REFUSED, ids=[words[:40] for _, _, words in REFUSED])
def test_bad_input_is_refused_in_a_sentence(call: Callable[[], object], kind: type[Exception], words: str) -> None:
    with pytest.raises(kind) as caught:
        call()
    assert words in str(caught.value)
