"""Named terms and gains: what acts on what, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from refusals import refused

import taut
from taut.control.gains import GainValue

M = np.array([[2.0, 0.5], [0.5, 1.0]])
P, D = np.array([1.0, 2.0]), np.array([-0.5, 0.25])


def terms() -> taut.Terms:
    return taut.Terms(P=P, D=D)


class TestTerms:
    def test_the_sum_and_the_parts_go_through_linear_maps_alike(self) -> None:
        for mapped, expected in (
            (M @ terms(), lambda x: M @ x),
            (2.0 * terms(), lambda x: 2.0 * x),
            (np.array([2.0, 3.0]) * terms(), lambda x: np.array([2.0, 3.0]) * x),
            (terms() / 4.0, lambda x: x / 4.0),
            (-terms(), lambda x: -x),
            (taut.math.solve_spd(M, terms()), lambda x: np.linalg.solve(M, x)),
            (taut.math.solve(M, terms()), lambda x: np.linalg.solve(M, x)),
            (GainValue(M, "K") @ terms(), lambda x: M @ x),
            (GainValue(np.array(3.0), "k") @ terms(), lambda x: 3.0 * x),
        ):
            np.testing.assert_allclose(mapped.total, expected(P + D), atol=1e-15)
            np.testing.assert_allclose(mapped.parts["P"], expected(P), atol=1e-15)
            np.testing.assert_allclose(mapped.parts["D"], expected(D), atol=1e-15)

    def test_equal_names_add_and_others_stand_side_by_side(self) -> None:
        both = terms() + taut.Terms(P=P, gravity=D)
        assert set(both.parts) == {"P", "D", "gravity"}
        np.testing.assert_allclose(both.parts["P"], 2.0 * P)
        np.testing.assert_allclose(both.total, 2.0 * P + 2.0 * D)
        np.testing.assert_allclose((terms() - taut.Terms(P=P)).parts["P"], 0.0)

    @pytest.mark.parametrize(
        "add", [lambda t: t + P, lambda t: P + t, lambda t: t - 1.0, lambda t: np.add(P, t)], ids=range(4)
    )
    def test_an_unnamed_array_is_added_only_with_a_name(self, add: object) -> None:
        with refused(taut.errors.UsageError):
            add(terms())  # type: ignore[operator]

    def test_what_is_not_linear_cannot_go_through(self) -> None:
        with refused(taut.errors.UsageError):
            np.sin(terms())  # type: ignore[call-overload]

    def test_a_command_takes_named_terms_only(self) -> None:
        with refused(taut.errors.UsageError):
            taut.Torque(P)  # type: ignore[arg-type]
        with refused(taut.errors.UsageError):
            taut.Torque()
        np.testing.assert_allclose(taut.Torque(terms(), gravity=P).total, 2.0 * P + D)


class TestGains:
    @pytest.mark.parametrize(
        ("gain", "matrix"),
        [(3.0, 3.0 * np.eye(2)), (np.array([2.0, 5.0]), np.diag([2.0, 5.0])), (M, M)],
        ids=["scalar", "per joint", "matrix"],
    )
    def test_a_gain_acts_as_the_matrix_it_stands_for(self, gain: object, matrix: np.ndarray) -> None:
        value = GainValue(np.asarray(gain), "K")
        np.testing.assert_allclose(value @ P, matrix @ P)
        np.testing.assert_allclose(value @ np.eye(2), matrix)
        np.testing.assert_allclose(M @ value, M @ matrix)
        np.testing.assert_allclose(value.matrix(2), matrix)
        np.testing.assert_allclose((value @ value) @ P, matrix @ matrix @ P)
        np.testing.assert_allclose((2.0 * value) @ P, 2.0 * matrix @ P)
        np.testing.assert_allclose((value / 2.0) @ P, matrix @ P / 2.0)
        np.testing.assert_allclose((-value) @ P, -matrix @ P)
        np.testing.assert_allclose((value + GainValue(np.array(1.0), "k")) @ P, (matrix + np.eye(2)) @ P)

    def test_times_works_entry_by_entry_and_is_refused_for_a_matrix(self) -> None:
        np.testing.assert_allclose(GainValue(np.array([2.0, 5.0]), "kp") * P, [2.0, 10.0])
        for wrong in (lambda: GainValue(M, "kp") * P, lambda: P * GainValue(M, "kp")):
            with refused(taut.errors.UsageError):
                wrong()

    def test_a_gain_of_another_size_names_both(self) -> None:
        with refused(taut.errors.ShapeError):
            GainValue(np.ones(3), "kp") @ P

    def test_a_scalar_gain_reads_as_a_number(self) -> None:
        law = taut.laws.PID(kp=100.0)
        assert float(law.kp) == 100.0
        assert law.kp == 100.0
        assert np.sqrt(law.kp) == 10.0
        assert repr(law) == "PID(kp=100.0)"


class Spring(taut.Law):
    """A spring to a fixed point, with a leak."""

    k: taut.Gain = taut.Gain(unit="N m/rad")
    rest: taut.Gain = taut.Gain((0.1, 0.2), unit="rad", minimum=-np.inf)
    level: taut.Memory = taut.Memory(1.0)  # [1]

    def command(self, x, ref, memory, dt):  # type: ignore[no-untyped-def]
        leaked = memory.level * (1.0 - dt)
        return taut.Torque(spring=leaked * (self.k @ (self.rest.as_array() - x.q))), {"level": leaked}


class TestALawOfOnesOwn:
    arm = taut.load_arm("planar2")

    def test_it_is_a_frozen_dataclass_with_defaults_from_its_class(self) -> None:
        law = Spring(k=2.0)
        np.testing.assert_array_equal(law.rest.as_array(), [0.1, 0.2])
        with refused(AttributeError):
            law.k = 3.0  # type: ignore[misc]

    @pytest.mark.parametrize("engine", ["native", "float"])
    def test_scalar_memory_takes_its_shape_and_is_remembered(self, engine: str) -> None:
        ctrl = taut.compile(Spring(k=2.0), self.arm, rate=10.0, engine=engine)
        ref = taut.JointMotion(q=[0.0, 0.0])
        for k in range(1, 4):
            tau = ctrl.step(np.zeros(2), np.zeros(2), ref)
            np.testing.assert_allclose(tau, 0.9**k * 2.0 * np.array([0.1, 0.2]), rtol=1e-14)

    def test_its_units_stand_in_messages_and_in_the_explanation(self, capsys: pytest.CaptureFixture[str]) -> None:
        with refused(taut.errors.RangeError):
            Spring(k=-1.0)
        taut.compile(Spring(k=2.0), self.arm).explain()
        assert "law.k                    2  [N m/rad]" in capsys.readouterr().out

    def test_gains_change_between_ticks_without_compiling_and_are_checked(self) -> None:
        ctrl = taut.compile(Spring(k=2.0), self.arm)
        ref = taut.JointMotion(q=[0.0, 0.0])
        first = ctrl.step(np.zeros(2), np.zeros(2), ref)
        ctrl.parameters["law.k"] = 4.0
        ctrl.reset()
        np.testing.assert_allclose(ctrl.step(np.zeros(2), np.zeros(2), ref), 2.0 * first)
        with refused(taut.errors.ShapeError):
            ctrl.parameters["law.k"] = [1.0, 2.0]
        ctrl.parameters["law.rest"] = 0.5
        np.testing.assert_array_equal(ctrl.parameters["law.rest"], [0.5, 0.5])

    def test_terms_of_a_sum_add_up_and_keep_their_names(self) -> None:
        ctrl = taut.compile(Spring(k=2.0) + taut.laws.PID(kp=1.0, kd=0.5), self.arm)
        tau = ctrl.step(np.array([0.3, -0.1]), np.array([0.2, 0.1]), taut.JointMotion(q=[0.0, 0.0]))
        assert set(ctrl.terms) == {"spring", "P", "I", "D"}
        np.testing.assert_allclose(sum(ctrl.terms.values()), tau, atol=1e-15)
        assert "law.Spring.k" in ctrl.parameters
        assert "law.PID.kp" in ctrl.parameters


def test_two_laws_that_both_compensate_gravity_do_not_add() -> None:
    arm = taut.load_arm("planar2")
    both = taut.laws.GravityPID(kp=1.0, kd=1.0) + taut.laws.GravityCompensation()
    with refused(taut.errors.MatchError):
        taut.compile(both, arm)


def test_commands_of_two_kinds_do_not_add() -> None:
    arm = taut.load_arm("planar2")
    with refused(taut.errors.MatchError):
        taut.compile(taut.laws.PID(kp=1.0) + taut.laws.VelocityPI(kp=1.0), arm)


def test_equal_laws_in_a_sum_keep_gains_of_their_own() -> None:
    ctrl = taut.compile(taut.laws.PID(kp=1.0) + taut.laws.PID(kp=2.0), taut.load_arm("planar2"))
    assert [path for path in ctrl.parameters if path.endswith("kp")] == ["law.PID.kp", "law.PID2.kp"]
    tau = ctrl.step(np.zeros(2), np.zeros(2), taut.JointMotion(q=[1.0, 0.0]))
    np.testing.assert_allclose(tau, [3.0, 0.0])


def test_a_law_of_the_tool_and_one_of_the_joints_do_not_add() -> None:
    tool = taut.laws.TaskComputedTorque(kp=100.0, kd=20.0)
    with refused(taut.errors.UsageError):
        tool + taut.laws.FrictionCompensation()
    assert isinstance(tool + taut.via_joint_space(taut.laws.FrictionCompensation()), taut.laws.Sum)
