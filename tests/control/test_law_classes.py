"""Laws as users write them: fields, laws that hold laws, and slips, each with its sentence."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from refusals import refused

import taut
from taut import Gain, JointMotion, Law, Memory, Snapshot, TautError, Terms, Torque

ARM = taut.load_arm("planar3")
REF = JointMotion(q=np.array(ARM.home) + 0.1)
Q, V = np.array(ARM.home), np.array([0.1, -0.2, 0.3])


def step(law: Law, engine: Any = "native") -> Any:
    return taut.compile(law, ARM, engine=engine).step(Q, V, REF)


# -------------------------------------------------------------------- fields


class Defaults(Law):
    kp: Gain = 5.0  # type: ignore[assignment]
    kd: Gain = Gain([1.0, 2.0, 3.0])
    z: Memory = Memory(np.zeros(3))  # either way it is no argument
    w = Memory(0.5)

    def command(self, x: Snapshot, ref: JointMotion, memory: Any, dt: float) -> Any:
        return Torque(P=self.kp @ (ref.q - x.q), D=-(self.kd @ x.v), z=memory.z + memory.w), {
            "z": memory.z + 1.0,
            "w": memory.w + x.q * 0.0,
        }


def test_defaults_may_be_numbers_lists_and_arrays() -> None:
    ctrl = taut.compile(Defaults(), ARM)
    expected = 5.0 * 0.1 - np.array([1.0, 2.0, 3.0]) * V + 0.5
    np.testing.assert_allclose(ctrl.step(Q, V, REF), expected, atol=1e-12)
    np.testing.assert_allclose(ctrl.step(Q, V, REF), expected + 1.0, atol=1e-12)
    ctrl.parameters["law.kp"] = 10.0
    np.testing.assert_allclose(ctrl.step(Q, V, REF), expected + 2.5, atol=1e-12)


def test_annotations_may_be_texts_or_classes() -> None:
    for gain, law in (("Gain", "taut.Law"), (Gain, Law)):
        made = type("L", (Law,), {
            "__annotations__": {"k": gain, "inner": law, "z": "Memory" if gain == "Gain" else Memory},
            "command": lambda self, x, ref: Torque(P=x.q),
        })  # fmt: skip
        held = made(k=2.0, inner=taut.laws.PID(kp=1.0))
        assert {path: x.item() for path, x in held.parameters().items()} == {
            "k": 2.0, "inner.kp": 1.0, "inner.kd": 0.0, "inner.ki": 0.0
        }  # fmt: skip
        assert list(made.memories) == ["z"]
        with refused(taut.errors.UnknownNameError):
            made(k=2.0, inner=held, z=0.0)


class Pull(Law):
    """A spring at the tool with a stiffness per axis: the gain has three entries on an arm of seven joints."""

    K: Gain = Gain(unit="N/m", shape=3)

    def command(self, x: Snapshot, ref: JointMotion) -> Torque:
        return Torque(pull=x.J()[:3].T @ (self.K @ (np.array([0.5, 0.0, 0.5]) - x.T().p)))


def test_a_gain_may_have_a_size_of_its_own() -> None:
    arm = taut.load_arm("panda")
    x = taut.snapshot(arm, arm.home)
    for K in (200.0, [100.0, 200.0, 300.0], np.diag([100.0, 200.0, 300.0])):
        got = taut.compile(Pull(K=K), arm).step(arm.home, np.zeros(7), JointMotion(q=arm.home))
        matrix = K if np.ndim(K) == 2 else np.eye(3) * K
        np.testing.assert_allclose(got, x.J()[:3].T @ (matrix @ (np.array([0.5, 0.0, 0.5]) - x.T().p)), atol=1e-12)
    with refused(taut.errors.ShapeError):
        taut.compile(Pull(K=[1.0] * 7), arm)


def test_an_array_that_a_law_is_given_is_its_own() -> None:
    class Push(Law):
        push: Any = None

        def command(self, x: Snapshot, ref: JointMotion) -> Torque:
            return Torque(push=self.push + 0.0 * x.q)

    given = np.ones(3)
    law = Push(push=given)
    ctrl = taut.compile(law, ARM)
    given[:] = 5.0
    ctrl.step(Q, V, REF)
    np.testing.assert_array_equal(ctrl.terms["push"], np.ones(3))
    with pytest.raises(ValueError, match="read-only"):
        law.push[0] = 2.0


# -------------------------------------------------------------------- laws that hold laws


class Scaled(Law):
    """A law of a user's own that holds any other, with memory or without."""

    inner: Law
    factor: Gain = Gain(1.0)

    def command(self, x: Snapshot, ref: JointMotion, memory: Any, dt: float) -> Any:
        command, after = self.inner.command(x, ref, memory.inner, dt)  # type: ignore[attr-defined]
        return Torque(self.factor * command.terms), {"inner": after}


@pytest.mark.parametrize("engine", ["native", "float"])
def test_a_law_may_hold_one_with_memory(engine: Any) -> None:
    inner = taut.laws.PID(kp=10.0, kd=1.0, ki=100.0)
    held, alone = (taut.compile(law, ARM, engine=engine) for law in (Scaled(inner=inner, factor=2.0), inner))
    assert {"law.inner.kp", "law.factor"} <= set(held.parameters)
    for _ in range(5):
        np.testing.assert_allclose(held.step(Q, V, REF), 2.0 * alone.step(Q, V, REF), rtol=1e-13)
    assert np.abs(held.terms["I"]).max() > 0.0


def test_a_law_that_starts_from_the_torque_held_is_told_it() -> None:
    class Holds(Law):
        def start(self, x: Snapshot, ref: JointMotion) -> dict[str, Any]:
            return {"held": x.tau_applied}

        def command(self, x: Snapshot, ref: JointMotion, memory: Any, dt: float) -> Any:
            return Torque(held=memory.held), {"held": memory.held}

    for engine in ("native", "float"):
        ctrl = taut.compile(Holds(), ARM, engine=engine)  # type: ignore[arg-type]
        np.testing.assert_allclose(ctrl.step(Q, V, REF), taut.snapshot(ARM, Q).g, atol=1e-12)
        ctrl.reset(tau_applied=[3.0, 4.0, 5.0])
        np.testing.assert_array_equal(ctrl.step(Q, V, REF), [3.0, 4.0, 5.0])
        ctrl.reset()
        np.testing.assert_allclose(ctrl.step(Q, V, REF), taut.snapshot(ARM, Q).g, atol=1e-12)


def test_what_one_law_of_a_sum_is_given_another_cannot_change() -> None:
    class Changes(Law):
        def command(self, x: Snapshot, ref: JointMotion) -> Torque:
            x.M[0, 0] = 1000.0
            return Torque(a=0.0 * x.q)

    class Moves(Law):
        def command(self, x: Snapshot, ref: JointMotion) -> Torque:
            x.q = 0.0 * x.q  # type: ignore[misc]
            return Torque(a=x.q)

    for law in (Changes(), Moves()):
        for engine in ("native", "float"):
            with refused(TautError):
                step(law + taut.laws.PID(kp=1.0), engine)


def test_a_law_that_reads_no_velocity_needs_none() -> None:
    ctrl = taut.compile(taut.laws.FeedForward(), ARM)
    assert ctrl.needs == ()
    np.testing.assert_array_equal(ctrl.step(Q, REF), ctrl.step(Q, V, REF))
    np.testing.assert_array_equal(ctrl.step(Q, ref=REF), ctrl.step(Q, V, REF))
    assert taut.compile(taut.laws.PID(kp=1.0), ARM).needs == ("v",)


def test_a_matrix_that_is_singular_at_home_alone_is_no_obstacle() -> None:
    class Inverse(Law):
        def command(self, x: Snapshot, ref: JointMotion) -> Torque:
            return Torque(P=taut.math.solve(np.diag(x.q - Q), x.q))

    ctrl = taut.compile(Inverse(), ARM)
    np.testing.assert_allclose(ctrl.step(Q + 0.5, V, REF), (Q + 0.5) / 0.5, rtol=1e-13)
    with pytest.raises(taut.errors.NumericalError):
        ctrl.step(Q, V, REF)


# -------------------------------------------------------------------- slips


def own(**body: Any) -> Any:
    """A class of law with this body."""

    def define() -> Law:
        plain: dict[str, Any] = {"command": lambda self, x, ref: Torque(P=x.q)}
        return type("L", (Law,), {"__module__": __name__, **plain, **body})()  # type: ignore[no-any-return]

    return define


def returns(result: Any) -> Any:
    return own(command=lambda self, x, ref: result(x))


def with_memory(command: Any) -> Any:
    def both(self: Any, x: Any, ref: Any, memory: Any, dt: Any) -> Any:
        return command(x, memory)

    return own(command=both, z=Memory(0.0), __annotations__={"z": "Memory"})


SLIPS: dict[str, Any] = {
    "a gain without its type": own(kp=Gain(5.0)),
    "a name that a law has": own(__annotations__={"bound": "Gain"}),
    "a list": own(w=[1.0, 2.0], __annotations__={"w": "list"}),
    "a term of None": returns(lambda x: Torque(P=None)),
    "a term of None among others": returns(lambda x: Torque(P=x.q, D=None)),
    "a text": returns(lambda x: Torque(P="abc")),
    "a scalar term": returns(lambda x: Torque(P=x.q, bias=1.0)),
    "a term named like a limit": lambda: (
        taut.compile(returns(lambda x: Torque(torque_limit=x.q))(), ARM, limits=taut.Limits(tau=1.0)).law
    ),
    "memory that is no dict": with_memory(lambda x, memory: (Torque(P=x.q), None)),
    "memory that is no number": with_memory(lambda x, memory: (Torque(P=x.q), {"z": None})),
    "memory that changes its shape": with_memory(
        lambda x, memory: (Torque(P=x.q), {"z": np.zeros(2 if np.shape(memory.z) == (3,) else 3)})
    ),
    "memory that is set": with_memory(lambda x, memory: setattr(memory, "z", 1.0)),
    "a quantity that there is not": returns(lambda x: Torque(P=x.qd)),
    "two torques added": returns(lambda x: Torque(P=x.q) + Torque(D=x.v)),
    "a torque mapped": returns(lambda x: x.M @ Torque(P=x.q)),
    "a torque added to terms": returns(lambda x: Torque(x.M @ Terms(P=x.q) + Torque(h=x.h))),
}


@pytest.mark.parametrize("engine", ["native", "float"])
@pytest.mark.parametrize("name", SLIPS)
def test_a_slip_is_told_in_one_sentence(name: str, engine: Any) -> None:
    define = SLIPS[name]
    with refused(TautError):
        step(define(), engine)


def test_a_gain_is_scaled_in_place_without_changing_the_law() -> None:
    class Doubled(Law):
        kp: Gain

        def command(self, x: Snapshot, ref: JointMotion) -> Torque:
            k = self.kp
            k *= 2.0
            return Torque(P=k @ (ref.q - x.q))

    law = Doubled(kp=3.0)
    for engine in ("native", "float"):
        np.testing.assert_allclose(step(law, engine), 0.6 * np.ones(3), atol=1e-12)


def test_a_branch_on_a_gain_is_refused_like_any_other() -> None:
    class Branches(Law):
        kp: Gain

        def command(self, x: Snapshot, ref: JointMotion) -> Torque:
            return Torque(P=x.q if self.kp > 3.0 else x.v)

    with refused(taut.errors.TraceError):
        step(Branches(kp=1.0))
