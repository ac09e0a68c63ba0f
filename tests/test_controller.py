"""Controller: ticks, starts and resets, terms, parameters, and what it says of itself."""

from __future__ import annotations

import copy
import math
import pickle
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from refusals import refused

import taut
from taut import Gain, Memory, TautError, Torque
from taut.arm.parts import Body, Frame, Joint
from taut.controller.parameters import State
from taut.errors import MatchError, RangeError, ShapeError, UnknownNameError, UsageError

ARM = taut.load_arm("planar2")
REF = taut.JointMotion(q=[0.3, -0.2], v=[0.1, 0.0], a=[1.0, -1.0])
Q, V = np.array([0.1, 0.2]), np.array([1.0, -2.0])
ROUNDING = 1e-13
L = taut.laws

Engine = Any
engines = pytest.mark.parametrize("engine", ["native", "float"])


class Feels(taut.Law):
    """A law that asks for everything that can be measured.

    Law:          tau = J^T F_ext + gain tau_meas
    """

    gain: Gain = Gain(1.0)

    def command(self, x: Any, ref: Any) -> Any:
        return Torque(force=x.J().T @ x.F_ext, torque=self.gain @ x.tau_meas)


class Clock(taut.Law):
    """The time, as a torque."""

    def command(self, x: Any, ref: Any) -> Any:
        return Torque(time=np.ones(x.n) * x.t, nothing=0.0 * x.q)


class Counts(taut.Law):
    """Starts from the measured state, and counts the ticks."""

    first: Memory = Memory(0.0)
    ticks: Memory = Memory(0.0)

    def start(self, x: Any, ref: Any) -> Any:
        return {"first": x.q}

    def command(self, x: Any, ref: Any, memory: Any, dt: Any) -> Any:
        return Torque(first=memory.first, count=memory.ticks + 0.0 * x.q), {
            "first": memory.first,
            "ticks": memory.ticks + 1.0,
        }


# -------------------------------------------------------------------- ticks


@engines
def test_ticks_are_counted_and_time_is_ticks_times_dt(engine: Engine) -> None:
    ctrl = taut.compile(Clock(), ARM, rate=250.0, engine=engine)
    assert ctrl.ticks == 0
    for k in range(4):
        assert ctrl.step(Q, V, REF).tolist() == [k * 0.004] * 2
        assert ctrl.ticks == k + 1
        assert ctrl.terms["time"].tolist() == [k * 0.004] * 2
    ctrl.reset()
    assert ctrl.step(Q, V, REF).tolist() == [0.0] * 2
    assert ctrl.ticks == 1


@engines
def test_a_law_starts_from_the_state_at_the_first_tick_and_again_after_a_reset(engine: Engine) -> None:
    ctrl = taut.compile(Counts(), ARM, engine=engine)
    assert ctrl.step(Q, V, REF).tolist() == Q.tolist()
    assert ctrl.step(2.0 * Q, V, REF).tolist() == (Q + 1.0).tolist()
    ctrl.reset()
    assert ctrl.step(3.0 * Q, V, REF).tolist() == (3.0 * Q).tolist()
    assert ctrl.step(4.0 * Q, V, REF).tolist() == (3.0 * Q + 1.0).tolist()


@engines
def test_the_integral_is_that_of_the_chapter(engine: Engine) -> None:
    ctrl = taut.compile(L.PID(kp=0.0, ki=10.0), ARM, rate=100.0, engine=engine)
    e = REF.q - Q
    for k in range(1, 4):  # this tick's error is in it
        np.testing.assert_allclose(ctrl.step(Q, V, REF), 10.0 * k * 0.01 * e, rtol=ROUNDING)


@engines
def test_velocities_are_differenced_from_the_second_tick_on(engine: Engine) -> None:
    ctrl = taut.compile(
        L.PID(kp=0.0, kd=1.0), ARM, rate=100.0, sensing=taut.Sensing(velocity="difference"), engine=engine
    )
    still = taut.JointMotion(q=[0.0, 0.0])
    assert ctrl.needs == ()
    assert ctrl.step(Q, still).tolist() == [0.0, 0.0]
    for given in ((Q + 0.01, still), (Q + 0.02, None, still)):  # v may be left out, or be None
        np.testing.assert_allclose(ctrl.step(*given), [-1.0, -1.0], rtol=1e-10)  # 0.01 / dt, of numbers near 0.1
    with refused(UsageError):
        ctrl.step(Q, V, still)
    np.testing.assert_allclose(ctrl.step(q=Q + 0.03, ref=still), [-1.0, -1.0], rtol=1e-10)


@engines
@pytest.mark.parametrize("rate", [1.0, 333.3, 1000, np.float32(500.0), 1e5])
def test_any_rate_serves(engine: Engine, rate: Any) -> None:
    ctrl = taut.compile(L.PID(kp=0.0, ki=1.0), ARM, rate=rate, engine=engine)
    assert ctrl.rate == float(rate)
    assert ctrl.dt == 1.0 / float(rate)
    np.testing.assert_allclose(ctrl.step(Q, V, REF), (REF.q - Q) / float(rate), rtol=ROUNDING)


@engines
def test_a_bound_kernel_is_the_same_controller(engine: Engine) -> None:
    ctrl = taut.compile(L.ComputedTorque(kp=100.0, kd=20.0, ki=5.0), ARM, engine=engine)
    twin = taut.compile(L.ComputedTorque(kp=100.0, kd=20.0, ki=5.0), ARM, engine=engine)
    bound = ctrl.bind()
    bound.ref.q[:], bound.ref.v[:], bound.ref.a[:] = REF.q, REF.v, REF.a
    for k in range(3):
        bound.q[:], bound.v[:] = Q + 0.1 * k, V
        assert bound.tick() is None
        np.testing.assert_array_equal(bound.command, twin.step(Q + 0.1 * k, V, REF))
    np.testing.assert_array_equal(ctrl.step(Q, V, REF), twin.step(Q, V, REF))  # both ways on one memory
    assert ctrl.ticks == 4
    with pytest.raises(AttributeError):
        bound.w = 1.0  # type: ignore[attr-defined]


# -------------------------------------------------------------------- forces


@engines
def test_forces_come_by_keywords_that_say_their_sign(engine: Engine) -> None:
    ctrl = taut.compile(Feels(gain=2.0), ARM, engine=engine)
    assert ctrl.needs == ("F_ext", "tau_meas")
    F, tau_meas = np.array([1.0, -2.0, 0.5, 0.1, 0.2, -0.3]), np.array([0.5, 0.25])
    J = taut.snapshot(ARM, Q).J()
    wanted = J.T @ F + 2.0 * tau_meas
    for _ in range(2):  # in the first tick and later
        np.testing.assert_allclose(ctrl.step(Q, V, REF, F_ext=F, tau_meas=tau_meas), wanted, rtol=ROUNDING)
        np.testing.assert_allclose(ctrl.step(Q, V, REF, F_app=-F, tau_meas=list(tau_meas)), wanted, rtol=ROUNDING)
    np.testing.assert_allclose(ctrl.terms["force"], J.T @ F, rtol=ROUNDING, atol=ROUNDING)
    bound = ctrl.bind()
    bound.F_ext[:] = 2.0 * F
    bound.tick()
    np.testing.assert_allclose(bound.command, J.T @ (2.0 * F) + 2.0 * tau_meas, rtol=ROUNDING)


FORCES: list[tuple[str, dict[str, Any], type[TautError]]] = [
    ("none", {}, UsageError),
    ("no torque", {"F_ext": np.zeros(6)}, UsageError),
    ("both signs", {"F_ext": np.zeros(6), "F_app": np.zeros(6), "tau_meas": np.zeros(2)}, UsageError),
    ("a force alone", {"F_ext": np.zeros(3), "tau_meas": np.zeros(2)}, ShapeError),
    ("NaN", {"F_app": [0, 0, math.nan, 0, 0, 0], "tau_meas": np.zeros(2)}, RangeError),
    ("another arm's torques", {"F_ext": np.zeros(6), "tau_meas": np.zeros(3)}, ShapeError),
    ("misspelt", {"F_ex": np.zeros(6), "tau_meas": np.zeros(2)}, UnknownNameError),
]


@engines
@pytest.mark.parametrize(("what", "given", "kind"), FORCES, ids=[case[0] for case in FORCES])
def test_forces_that_do_not_fit_get_one_sentence(
    engine: Engine, what: str, given: dict[str, Any], kind: type[TautError]
) -> None:
    ctrl = taut.compile(Feels(), ARM, engine=engine)
    for _ in range(2):  # in the first tick and later: a call without forces is never the last tick once more
        with refused(kind):
            ctrl.step(Q, V, REF, **given)
        with refused(UsageError):
            ctrl.step()  # type: ignore[call-arg]
        ctrl.step(Q, V, REF, F_ext=np.zeros(6), tau_meas=np.zeros(2))


# -------------------------------------------------------------------- limits and resets


@engines
def test_a_rate_limit_starts_from_gravity_or_from_what_reset_says(engine: Engine) -> None:
    limits = taut.Limits(tau=100.0, tau_dot=1000.0)  # 1 N m in each tick
    ctrl = taut.compile(L.PID(kp=1e4), ARM, limits=limits, engine=engine)
    g, up = taut.snapshot(ARM, Q).g, np.array([1.0, -1.0])
    np.testing.assert_allclose(ctrl.step(Q, V, REF), g + up, rtol=ROUNDING)
    np.testing.assert_allclose(ctrl.step(Q, V, REF), g + 2.0 * up, rtol=ROUNDING)
    ctrl.reset(tau_applied=[5.0, 7.0])
    np.testing.assert_allclose(ctrl.step(Q, V, REF), [6.0, 6.0], rtol=ROUNDING)
    ctrl.reset()
    np.testing.assert_allclose(ctrl.step(Q, V, REF), g + up, rtol=ROUNDING)


@engines
def test_a_held_torque_is_kept_until_a_first_tick_succeeds(engine: Engine) -> None:
    ctrl = taut.compile(L.PID(kp=1e4), ARM, limits=taut.Limits(tau=100.0, tau_dot=1000.0), engine=engine)
    ctrl.reset(tau_applied=[5.0, 7.0])
    bound = ctrl.bind()
    bound.q[:] = math.nan
    with pytest.raises(RangeError):
        bound.tick()
    np.testing.assert_allclose(ctrl.step(Q, V, REF), [6.0, 6.0], rtol=ROUNDING)


@engines
def test_a_tick_that_fails_leaves_state_and_memory_as_they_were(engine: Engine) -> None:
    """Fresh, running, changed by a parameter that a blend takes up: each state with its own first tick."""
    ctrl, wrong = (
        taut.compile(L.PID(kp=10.0, ki=1.0), ARM, limits=taut.Limits(blend=0.1), engine=engine),
        Q * math.nan,
    )
    machine, states = ctrl._machine, []

    def tick(q: Any) -> None:
        states.append(machine.state)
        ctrl.step(q, V, REF)

    def fail() -> None:
        before = {} if machine.state is State.FRESH else {path: value.copy() for path, value in ctrl.memory.items()}
        with pytest.raises(RangeError):
            tick(wrong)
        assert machine.state is states[-1]
        assert all(np.array_equal(ctrl.memory[path], value) for path, value in before.items())

    fail()
    tick(Q)
    fail()
    tick(Q)
    ctrl.parameters["limits.blend"] = 0.2  # limits act at once: there is nothing to take up
    tick(Q)
    ctrl.parameters["law.kp"] = 50.0
    ctrl.parameters["law.ki"] = 2.0
    fail()
    tick(Q)
    tick(Q)
    ctrl.reset()
    tick(Q)
    fresh, running, changed = State.FRESH, State.RUNNING, State.CHANGED
    assert states == [fresh, fresh, running, running, running, changed, changed, running, fresh]


@engines
def test_what_limits_take_is_a_term_like_the_others(engine: Engine) -> None:
    ctrl = taut.compile(L.PID(kp=100.0), ARM, limits=taut.Limits(tau=[5.0, 7.0]), engine=engine)
    tau = ctrl.step(Q, V, REF)
    assert tau.tolist() == [5.0, -7.0]
    np.testing.assert_allclose(sum(ctrl.terms.values()), tau, rtol=ROUNDING)
    np.testing.assert_allclose(ctrl.terms["torque_limit"], [-15.0, 33.0], rtol=ROUNDING)


RESETS: list[tuple[Any, type[TautError]]] = [
    ([1.0], ShapeError),
    ([math.nan, 0.0], RangeError),
    ("5", ShapeError),
]


@pytest.mark.parametrize(("value", "kind"), RESETS)
def test_a_torque_to_start_from_that_is_none_is_told(value: Any, kind: type[TautError]) -> None:
    ctrl = taut.compile(L.PID(kp=1.0), ARM, limits=taut.Limits(tau_dot=10.0))
    with refused(kind):
        ctrl.reset(tau_applied=value)


def test_a_controller_that_remembers_no_torque_takes_none() -> None:
    with refused(UsageError):
        taut.compile(L.PID(kp=1.0), ARM).reset(tau_applied=[1.0, 2.0])


# -------------------------------------------------------------------- terms and parameters


@engines
def test_terms_are_those_of_the_last_tick_whatever_changed_since(engine: Engine) -> None:
    ctrl = taut.compile(L.PID(kp=10.0, kd=1.0, ki=5.0), ARM, engine=engine)
    ctrl.step(Q, V, REF)
    ctrl.step(Q, V, REF)
    before = ctrl.terms
    assert {name: term.tolist() for name, term in before.items()}.keys() == {"P", "I", "D"}
    ctrl.parameters["law.kp"] = 20.0  # acts from the next tick
    ctrl.parameters["law.kp"] = 30.0
    ctrl.bind().q[:] = 7.0
    with pytest.raises(RangeError):
        ctrl.step([math.nan, 0.0], V, REF)
    ctrl.reset()
    for name, term in ctrl.terms.items():
        np.testing.assert_array_equal(term, before[name])
    ctrl.step(Q, V, REF)
    np.testing.assert_allclose(ctrl.terms["P"], 30.0 * (REF.q - Q), rtol=ROUNDING)


@engines
def test_terms_after_a_reset_are_computed_with_the_gains_of_their_own_tick(engine: Engine) -> None:
    ctrl = taut.compile(L.PID(kp=10.0), ARM, engine=engine)
    ctrl.step(Q, V, REF)
    ctrl.parameters["law.kp"] = 20.0
    ctrl.reset()
    ctrl.step(Q, V, REF)  # the first tick again: its number is that of the tick before the change
    np.testing.assert_allclose(ctrl.terms["P"], 20.0 * (REF.q - Q), rtol=ROUNDING)


@engines
def test_terms_are_copies(engine: Engine) -> None:
    ctrl = taut.compile(L.PID(kp=10.0), ARM, engine=engine)
    tau = ctrl.step(Q, V, REF)
    ctrl.terms["P"][:] = 99.0
    np.testing.assert_allclose(sum(ctrl.terms.values()), tau, rtol=ROUNDING)


def test_there_are_no_terms_before_the_first_tick() -> None:
    with refused(UsageError):
        taut.compile(L.PID(kp=10.0), ARM).terms  # noqa: B018


@engines
def test_gains_payload_and_limits_change_between_ticks_without_compiling(engine: Engine) -> None:
    ctrl = taut.compile(L.GravityPID(kp=np.eye(2), kd=[1.0, 2.0]), ARM, limits=taut.Limits(tau=50.0), engine=engine)
    ctrl.step(Q, V, REF)
    kernel = ctrl._kernel
    ctrl.parameters["law.kp"] = 3.0  # a scalar where a matrix was compiled
    ctrl.parameters["law.kd"] = 0.5  # and where one per joint was
    ctrl.parameters["model.payload.mass"] = 2.0
    ctrl.parameters["model.payload.com"] = [0.0, 0.1, 0.0]
    ctrl.parameters["limits.tau"] = 40.0
    g = taut.snapshot(ARM.with_payload(2.0, com=[0.0, 0.1, 0.0]), Q).g
    wanted = np.clip(3.0 * (REF.q - Q) + 0.5 * (REF.v - V) + g, -40.0, 40.0)
    np.testing.assert_allclose(ctrl.step(Q, V, REF), wanted, rtol=ROUNDING)
    assert ctrl._kernel is kernel
    assert ctrl.parameters["law.kp"].tolist() == [[3.0, 0.0], [0.0, 3.0]]
    assert ctrl.law.gains()["kp"].as_array().tolist() == np.eye(2).tolist()  # what it was compiled with


def test_parameters_are_a_mapping() -> None:
    ctrl = taut.compile(L.FeedForward() + L.PID(kp=10.0, kd=[1.0, 2.0]), ARM, limits=taut.Limits(tau=5.0))
    assert list(ctrl.parameters) == [
        "law.PID.kp",
        "law.PID.kd",
        "law.PID.ki",
        "limits.tau",
        "model.payload.mass",
        "model.payload.com",
        "model.payload.inertia",
    ]
    assert len(ctrl.parameters) == 7
    assert "law.PID.kp" in ctrl.parameters
    assert "law.kp" not in ctrl.parameters
    assert repr(ctrl.parameters).startswith("{'law.PID.kp': 10, 'law.PID.kd': [1., 2.], 'law.PID.ki': 0, ")
    ctrl.parameters.update({"law.PID.kp": 11.0, "law.PID.ki": 1.0})
    assert ctrl.parameters["law.PID.kp"] == 11.0
    with pytest.raises(ValueError, match="read-only"):
        ctrl.parameters["law.PID.kd"][0] = 5.0


PARAMETERS: list[tuple[str, Any, type[TautError]]] = [
    ("law.kq", 1.0, UnknownNameError),
    ("kp", 1.0, UnknownNameError),
    ("law.kp", -1.0, RangeError),
    ("law.kp", math.nan, RangeError),
    ("law.kp", "10", ShapeError),
    ("law.kp", [1.0, 2.0], ShapeError),
    ("law.kd", np.eye(2), ShapeError),
    ("limits.tau", 0.0, RangeError),
    ("model.payload.mass", -1.0, RangeError),
    ("model.payload.com", [0.0, 0.1], ShapeError),
]  # fmt: skip


@pytest.mark.parametrize(("path", "value", "kind"), PARAMETERS)
def test_a_parameter_that_does_not_fit_is_told_and_nothing_changes(
    path: str, value: Any, kind: type[TautError]
) -> None:
    ctrl = taut.compile(L.PID(kp=10.0, kd=[1.0, 2.0]), ARM, limits=taut.Limits(tau=5.0))
    before = {name: entry.tolist() for name, entry in ctrl.parameters.items()}
    with refused(kind):
        ctrl.parameters[path] = value
    assert {name: entry.tolist() for name, entry in ctrl.parameters.items()} == before


def test_a_parameter_cannot_be_removed() -> None:
    with refused(UsageError):
        del taut.compile(L.PID(kp=10.0), ARM).parameters["law.kp"]
    with refused(UnknownNameError):
        taut.compile(L.PID(kp=10.0), ARM).parameters["law.kq"]


# -------------------------------------------------------------------- compile


COMPILES: list[tuple[str, Callable[[], Any], type[TautError]]] = [
    ("a class", lambda: taut.compile(L.PID, ARM), UsageError),
    ("no law", lambda: taut.compile(None, ARM), UsageError),
    ("a name", lambda: taut.compile(L.PID(kp=1.0), "panda"), UsageError),
    ("rate 0", lambda: taut.compile(L.PID(kp=1.0), ARM, rate=0), RangeError),
    ("rate -1", lambda: taut.compile(L.PID(kp=1.0), ARM, rate=-1), RangeError),
    ("rate NaN", lambda: taut.compile(L.PID(kp=1.0), ARM, rate=math.nan), RangeError),
    ("rate inf", lambda: taut.compile(L.PID(kp=1.0), ARM, rate=math.inf), RangeError),
    ("rate text", lambda: taut.compile(L.PID(kp=1.0), ARM, rate="1"), ShapeError),  # type: ignore[arg-type]
    ("rate in seconds", lambda: taut.compile(L.PID(kp=1.0), ARM, rate=0.001), RangeError),
    ("engine", lambda: taut.compile(L.PID(kp=1.0), ARM, engine="c"), UsageError),
    ("sensing", lambda: taut.compile(L.PID(kp=1.0), ARM, sensing="difference"), UsageError),
    ("limits", lambda: taut.compile(L.PID(kp=1.0), ARM, limits=5.0), UsageError),
    ("limits of another arm", lambda: taut.compile(L.PID(kp=1.0), ARM, limits=taut.Limits(tau=[1.0, 2.0, 3.0])), ShapeError),
    ("limits on a velocity", lambda: taut.compile(L.VelocityPI(kp=1.0), ARM, limits=taut.Limits(tau=1.0)), MatchError),
    ("adds", lambda: taut.compile(L.PID(kp=1.0), ARM, adds="gravity"), UsageError),
    ("adds of nothing known", lambda: taut.compile(L.PID(kp=1.0), ARM, adds=("gravit",)), UnknownNameError),
    ("a torque and a velocity", lambda: taut.compile(L.PID(kp=1.0) + L.VelocityPI(kp=1.0), ARM), MatchError),
]  # fmt: skip


@pytest.mark.parametrize(("what", "call", "kind"), COMPILES, ids=[case[0] for case in COMPILES])
def test_what_cannot_be_compiled_gets_one_sentence(what: str, call: Callable[[], Any], kind: type[TautError]) -> None:
    with refused(kind):
        call()


@pytest.mark.filterwarnings("error")
def test_a_guarded_quotient_that_is_no_number_at_home_compiles_in_silence() -> None:
    class Unit(taut.Law):
        def command(self, x: Any, ref: Any) -> Any:
            e = ref.q - x.q  # zero at home
            size = taut.math.norm(e)
            return Torque(P=taut.math.where(size > 0.0, e / size, 0.0))

    for engine in ("native", "float"):
        ctrl = taut.compile(Unit(), ARM, engine=engine)  # type: ignore[arg-type]
        assert ctrl.step(REF.q, V, REF).tolist() == [0.0, 0.0]
        np.testing.assert_allclose(np.linalg.norm(ctrl.step(Q, V, REF)), 1.0, rtol=ROUNDING)
        ctrl.terms  # noqa: B018


@engines
def test_what_the_plant_adds_is_left_out(engine: Engine) -> None:
    law, x = L.ComputedTorque(kp=100.0, kd=20.0), taut.snapshot(ARM, Q, V)
    whole = taut.compile(law, ARM, engine=engine).step(Q, V, REF)
    for adds, missing in ((("gravity",), x.g), (("coriolis",), x.Cv), (("gravity", "coriolis"), x.h)):
        ctrl = taut.compile(law, ARM, adds=adds, engine=engine)
        assert ctrl.adds.names == adds
        np.testing.assert_allclose(ctrl.step(Q, V, REF), whole - missing, rtol=ROUNDING)


def chain(n: int) -> taut.Arm:
    """An arm of n joints, every third of which slides, about and along all axes."""
    axes = np.eye(3)
    joints = tuple(
        Joint(
            name=f"j{i}",
            kind="prismatic" if i % 3 == 2 else "revolute",
            parent=i - 1,
            placement=taut.Pose(p=[0.1, 0.0, 0.2], rpy=[0.1 * i, 0.3, -0.2]),
            axis=axes[i % 3],
        )
        for i in range(n)
    )
    bodies = tuple(
        Body(mass=1.0 / (i + 1), com=np.array([0.01, 0.02, 0.1]), inertia=0.01 * np.eye(3)) for i in range(n)
    )
    tool = Frame(name="tool", body=n - 1, placement=taut.Pose(p=[0.0, 0.0, 0.1]))
    return taut.Arm(name=f"chain{n}", joints=joints, bodies=bodies, frames=(tool,), tool="tool", home=np.full(n, 0.1))


@pytest.mark.parametrize("n", [1, 2, 13, 30])
def test_kernels_of_one_to_thirty_joints(n: int) -> None:
    arm = chain(n)
    law = L.ComputedTorque(kp=100.0, kd=20.0, ki=1.0)
    native, plain = (taut.compile(law, arm, engine=engine) for engine in ("native", "float"))  # type: ignore[arg-type]
    rng = np.random.default_rng(n)
    for _ in range(2):
        q, v, ref = rng.standard_normal(n), rng.standard_normal(n), taut.JointMotion(q=rng.standard_normal(n))
        wanted = plain.step(q, v, ref)
        np.testing.assert_allclose(native.step(q, v, ref), wanted, rtol=0.0, atol=1e-12 * np.abs(wanted).max())


# -------------------------------------------------------------------- what it says of itself


def test_what_it_is() -> None:
    ctrl = taut.compile(L.ComputedTorque(kp=100.0, kd=20.0), ARM, rate=500.0)
    assert ctrl.law.gains()["kp"].as_array() == 100.0
    assert ctrl.arm is ARM
    assert (ctrl.rate, ctrl.dt, ctrl.kind, ctrl.engine) == (500.0, 0.002, "torque", "native")
    assert ctrl.needs == ("v",)
    assert ctrl.operations == ctrl.program.operations > 50
    assert (
        repr(ctrl) == "Controller(ComputedTorque(kp=100.0, kd=20.0), Arm('planar2', 2 joints, tool 'tool'), rate=500)"
    )
    plain = taut.compile(L.ComputedTorque(kp=100.0, kd=20.0), ARM, engine="float")
    assert (plain.engine, plain.operations) == ("float", 0)
    assert plain.program.content == ctrl.program.content
    assert taut.compile(L.VelocityPI(kp=1.0), ARM).kind == "velocity"


def test_the_explanation_tells_law_gains_and_cost(capsys: pytest.CaptureFixture[str]) -> None:
    ctrl = taut.compile(
        L.GravityPID(kp=[10.0, 20.0], kd=1.0), ARM, limits=taut.Limits(tau=5.0), adds=("coriolis",), rate=500.0
    )
    ctrl.explain()
    assert (
        capsys.readouterr().out
        == f"""\
GravityPID for arm 'planar2' (2 joints) at 500 Hz
  Law:         tau = kp e + ki int(e) + kd e_dot + g(q)   eq. 10.22
  Closed loop: M a + C v = kp e - kd v, for a set-point, ki = 0, an exact g and no friction   eq. 10.23
               V = e . kp e / 2 + v . M v / 2 falls at the rate v . kd v   eq. 10.25, 10.27
               globally asymptotically stable for kp > 0 and kd > 0, where no joint wraps, in continuous time;
               held over a tick, kd diverges where M^-1 kd dt has an eigenvalue above 2
               viscous friction adds to kd; dry friction leaves an error of up to mu / kp

parameters
  law.kp                   [10., 20.]  [N m/rad | N/m]
  law.kd                   1  [N m s/rad | N s/m]
  law.ki                   0  [N m/(rad s) | N/(m s)]
  limits.tau               5  [N m | N]
  model.payload.mass       0  [kg]
  model.payload.com        [0., 0., 0.]  [m]
  model.payload.inertia    [0., 0., 0., 0., 0., 0.]  [kg m^2]

terms          P, I, D, gravity, torque_limit
needs          q, v
left out       coriolis (the plant adds them)
engine         native, {ctrl.operations} operations a tick
"""
    )


def test_the_explanation_of_a_sum_names_its_parts() -> None:
    text = taut.compile(L.FeedForward() + L.PID(kp=1.0), ARM, engine="float").explanation()
    assert text.startswith("FeedForward + PID for arm 'planar2' (2 joints) at 1000 Hz\n")
    assert "\nFeedForward: Feedforward control: the model's torques along the desired motion." in text
    assert "\nPID: PID control, each joint on its own" in text
    assert text.endswith("engine         float, not traced")


@engines
def test_a_controller_is_not_copied_in_silence(engine: Engine) -> None:
    ctrl = taut.compile(L.PID(kp=1.0), ARM, engine=engine)
    for attempt in (copy.copy, copy.deepcopy, pickle.dumps):
        with refused(UsageError):
            attempt(ctrl)


def test_two_controllers_of_one_law_share_nothing() -> None:
    law = L.PID(kp=10.0, ki=1.0)
    one, other = taut.compile(law, ARM), taut.compile(law, ARM)
    first = one.step(Q, V, REF)
    one.step(Q, V, REF)
    one.parameters["law.kp"] = 50.0
    np.testing.assert_array_equal(other.step(Q, V, REF), first)


@pytest.mark.parametrize("engine", ["native", "float"])
def test_the_arrays_of_a_bound_kernel_are_written_into_and_not_replaced(engine: Engine) -> None:
    k = taut.compile(taut.laws.PID(kp=1.0), ARM, engine=engine).bind()
    for name in ("q", "ref", "command", "tick"):
        with refused(UsageError):
            setattr(k, name, np.zeros(2))
