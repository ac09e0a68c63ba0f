"""Sensing in a controller: what the law sees, on every engine, whatever the sensors give."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import scipy.signal
from refusals import refused

import taut
from taut.base.types import Float64Array

Array = Float64Array
ARM = taut.load_arm("planar2")
REF = taut.JointMotion(q=[0.0, 0.0])
RATE = 1000.0
engines = pytest.mark.parametrize("engine", ["native", "float"])


class ShowV(taut.Law):
    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        return taut.Torque(v=x.v)


class ShowQ(taut.Law):
    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        return taut.Torque(q=x.q)


class ShowForce(taut.Law):
    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        return taut.Torque(F=x.F_ext[:2], tau=x.tau_meas)


class ShowAll(taut.Law):
    """Everything that can be measured."""

    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        return taut.Torque(
            q=x.q, v=x.v, F=x.F_ext[:2], tau=x.tau_meas, q_motor=x.q_motor, v_motor=x.v_motor, a=x.a_tip[:2]
        )


SENSINGS: dict[str, taut.Sensing] = {
    "measured": taut.Sensing(),
    "low-pass": taut.Sensing(velocity=taut.sensors.LowPass(cutoff=[30.0, 40.0], order=2)),
    "difference": taut.Sensing(velocity="difference"),
    "difference and low-pass": taut.Sensing(velocity=taut.sensors.Difference(cutoff=30.0)),
    "difference and second order": taut.Sensing(velocity=taut.sensors.Difference(cutoff=30.0, order=2)),
    "kalman": taut.Sensing(velocity=taut.sensors.Kalman(acceleration_noise=[10.0, 30.0], position_noise=1e-4)),
    "notch": taut.Sensing(notch=taut.sensors.Notch(frequency=[18.0, 0.0], width=4.0)),
    "notch and kalman": taut.Sensing(
        velocity=taut.sensors.Kalman(acceleration_noise=10.0, position_noise=1e-4),
        notch=taut.sensors.Notch(frequency=18.0, width=4.0),
    ),
}
every = pytest.mark.parametrize("sensing", SENSINGS.values(), ids=SENSINGS)


def steps(ctrl: taut.Controller, q: Array, v: Array | None = None) -> Array:
    given = ([row, *([] if v is None else [v[k]])] for k, row in enumerate(q))
    return np.array([ctrl.step(*row, ref=REF) for row in given])


def walk(seed: int = 0, ticks: int = 400) -> tuple[Array, Array]:
    rng = np.random.default_rng(seed)
    v = rng.standard_normal((ticks, 2))
    return 0.3 + np.cumsum(v, axis=0) / RATE, v


# -------------------------------------------------------------------- against SciPy


@engines
@pytest.mark.parametrize("order", [1, 2])
def test_a_low_pass_of_the_measured_velocity_is_scipys(engine: Any, order: Any) -> None:
    q, v = walk()
    sensing = taut.Sensing(velocity=taut.sensors.LowPass(cutoff=25.0, order=order))
    got = steps(taut.compile(ShowV(), ARM, sensing=sensing, engine=engine), q, v)
    b, a = scipy.signal.butter(order, 25.0, fs=RATE)
    wanted, _ = scipy.signal.lfilter(b, a, v, axis=0, zi=scipy.signal.lfilter_zi(b, a)[:, np.newaxis] * v[0])
    np.testing.assert_allclose(got, wanted, rtol=0.0, atol=1e-12)


@engines
@pytest.mark.parametrize("order", [1, 2])
def test_differences_with_a_low_pass_are_scipys_of_the_differences(engine: Any, order: Any) -> None:
    q, _ = walk()
    sensing = taut.Sensing(velocity=taut.sensors.Difference(cutoff=25.0, order=order))
    got = steps(taut.compile(ShowV(), ARM, sensing=sensing, engine=engine), q)
    rates = np.vstack([np.zeros(2), np.diff(q, axis=0) * RATE])
    wanted = scipy.signal.lfilter(*scipy.signal.butter(order, 25.0, fs=RATE), rates, axis=0)
    np.testing.assert_allclose(got, wanted, rtol=0.0, atol=1e-10)


@engines
def test_a_notch_acts_on_positions_and_velocities_alike(engine: Any) -> None:
    q, v = walk()
    sensing = taut.Sensing(notch=taut.sensors.Notch(frequency=18.0, width=4.0, depth=400.0))
    b, a = scipy.signal.iirnotch(18.0, 4.5, fs=RATE)
    for law, signal, given in ((ShowQ(), q, (q,)), (ShowV(), v, (q, v))):
        got = steps(taut.compile(law, ARM, sensing=sensing, engine=engine), given[0], v)
        wanted, _ = scipy.signal.lfilter(
            b, a, signal, axis=0, zi=scipy.signal.lfilter_zi(b, a)[:, np.newaxis] * signal[0]
        )
        np.testing.assert_allclose(got, wanted, rtol=0.0, atol=1e-11)


@engines
def test_forces_and_torques_have_low_passes_of_their_own(engine: Any) -> None:
    rng = np.random.default_rng(1)
    F, tau = rng.standard_normal((200, 6)), rng.standard_normal((200, 2))
    sensing = taut.Sensing(
        F_ext=taut.sensors.LowPass(cutoff=[20.0] * 6), tau_meas=taut.sensors.LowPass(cutoff=50.0, order=2)
    )
    ctrl = taut.compile(ShowForce(), ARM, sensing=sensing, engine=engine)
    got = []
    for k in range(200):
        ctrl.step([0.1, 0.2], [0.0, 0.0], REF, F_ext=F[k], tau_meas=tau[k])
        got.append([ctrl.terms["F"], ctrl.terms["tau"]])
    for i, (signal, order, cutoff) in enumerate(((F[:, :2], 1, 20.0), (tau, 2, 50.0))):
        b, a = scipy.signal.butter(order, cutoff, fs=RATE)
        wanted, _ = scipy.signal.lfilter(
            b, a, signal, axis=0, zi=scipy.signal.lfilter_zi(b, a)[:, np.newaxis] * signal[0]
        )
        np.testing.assert_allclose(np.array(got)[:, i], wanted, rtol=0.0, atol=1e-12)


# -------------------------------------------------------------------- joints that turn without end


@pytest.mark.part(1)
@pytest.mark.parametrize("name", ["difference and second order", "kalman", "notch", "notch and kalman"])
def test_a_joint_that_turns_without_end_is_sensed_as_if_it_were_not_wrapped(name: str) -> None:
    kinova = taut.load_arm("kinova")
    turns, n = list(kinova.continuous), kinova.n
    sensing = {
        "difference and second order": taut.Sensing(velocity=taut.sensors.Difference(cutoff=30.0, order=2)),
        "kalman": taut.Sensing(velocity=taut.sensors.Kalman(acceleration_noise=10.0, position_noise=1e-4)),
        "notch": taut.Sensing(notch=taut.sensors.Notch(frequency=18.0, width=4.0)),
        "notch and kalman": taut.Sensing(
            velocity=taut.sensors.Kalman(acceleration_noise=10.0, position_noise=1e-4),
            notch=taut.sensors.Notch(frequency=18.0, width=4.0),
        ),
    }[name]
    t = np.arange(1500)[:, np.newaxis] / RATE
    far = np.zeros((1500, n))
    far[:, turns] = (
        8.0 * t + 0.05 * np.sin(2.0 * np.pi * 18.0 * t) + np.random.default_rng(2).normal(0.0, 1e-3, t.shape)
    )
    near = (far + np.pi) % (2.0 * np.pi) - np.pi
    ref = taut.JointMotion(q=np.zeros(n))
    v = () if not sensing.needs_velocity else (np.zeros(n),)
    for law in (ShowQ(), ShowV()):
        whole, wrapped = (taut.compile(law, kinova, sensing=sensing) for _ in range(2))
        for a, b in zip(far, near, strict=True):
            one, other = whole.step(a, *v, ref), wrapped.step(b, *v, ref)
            if isinstance(law, ShowQ):
                assert np.abs(other - b).max() < 0.2  # in the sensor's own turn
                one, other = np.exp(1j * one), np.exp(1j * other)
            np.testing.assert_allclose(other, one, rtol=0.0, atol=1e-9)


# -------------------------------------------------------------------- engines, parameters


@pytest.mark.part(1)
@every
def test_native_code_sees_what_plain_python_sees(sensing: taut.Sensing) -> None:
    q, v = walk(3)
    given = (q, v) if sensing.needs_velocity else (q,)
    for law in (ShowQ(), ShowV()):
        native, plain = (
            steps(taut.compile(law, ARM, sensing=sensing, engine=e), *given) for e in ("native", "float")
        )
        np.testing.assert_allclose(native, plain, rtol=0.0, atol=1e-12 * max(1.0, np.abs(plain).max()))


NEW: dict[str, Any] = {
    "sensing.velocity.cutoff": 3.0,
    "sensing.velocity.acceleration_noise": 1e4,
    "sensing.velocity.position_noise": 1e-2,
    "sensing.notch.frequency": [70.0, 5.0],
    "sensing.notch.width": 30.0,
    "sensing.notch.depth": 3.0,
}


@pytest.mark.part(1)
@every
@engines
def test_its_numbers_are_parameters_that_act_without_a_compile(
    sensing: taut.Sensing, engine: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    q, v = walk(4, ticks=60)
    given = (q, v) if sensing.needs_velocity else (q,)
    law = ShowQ() if sensing.notch is not None and sensing.needs_velocity else ShowV()
    ctrls = [taut.compile(law, ARM, sensing=sensing, engine=engine) for _ in range(2)]
    monkeypatch.setattr("taut.codegen.kernel.compiled", lambda *_: pytest.fail("compiled again"))
    monkeypatch.setattr("taut.codegen.kernel.trace", lambda *_: pytest.fail("traced again"))
    paths = [path for path in ctrls[0].parameters if path.startswith("sensing.")]
    assert paths == [f"sensing.{path}" for path in sensing.parameters()]
    for path in paths:
        new = NEW[path]
        if ctrls[0].parameters[path].shape == ():
            new = new[0] if isinstance(new, list) else new
        ctrls[1].parameters[path] = new
        first, second = (steps(ctrl, *given) for ctrl in ctrls)
        assert np.abs(first - second).max() > 1e-9, path
        for ctrl in ctrls:
            ctrl.reset()
        ctrls[1].parameters[path] = ctrls[0].parameters[path]
        np.testing.assert_array_equal(*(steps(ctrl, *given) for ctrl in ctrls))
        for ctrl in ctrls:
            ctrl.reset()


REFUSED: list[tuple[taut.Sensing, str, Any, type[taut.TautError]]] = [
    (SENSINGS["difference and low-pass"], "velocity.cutoff", 0.0, taut.errors.RangeError),
    (SENSINGS["difference and low-pass"], "velocity.cutoff", 500.0, taut.errors.RangeError),
    (SENSINGS["difference and low-pass"], "velocity.cutoff", [1.0, 2.0], taut.errors.ShapeError),
    (SENSINGS["low-pass"], "velocity.cutoff", [30.0, 700.0], taut.errors.RangeError),
    (SENSINGS["low-pass"], "velocity.cutoff", [1.0, 2.0, 3.0], taut.errors.ShapeError),
    (SENSINGS["low-pass"], "velocity.cutoff", np.nan, taut.errors.RangeError),
    (SENSINGS["notch"], "notch.frequency", 0.0, taut.errors.RangeError),
    (SENSINGS["notch"], "notch.width", 600.0, taut.errors.RangeError),
    (SENSINGS["kalman"], "velocity.position_noise", [1.0, -1.0], taut.errors.RangeError),
]  # fmt: skip


@pytest.mark.parametrize(("sensing", "path", "value", "kind"), REFUSED, ids=range(len(REFUSED)))
def test_a_number_that_it_cannot_have_is_refused_when_it_is_given_in_a_run_too(
    sensing: taut.Sensing, path: str, value: Any, kind: type[taut.TautError]
) -> None:
    ctrl = taut.compile(ShowV(), ARM, sensing=sensing, engine="float")
    with refused(kind):
        ctrl.parameters[f"sensing.{path}"] = value


@pytest.mark.parametrize(
    ("make", "kind"),
    [
        (lambda: taut.Sensing(velocity=3.0), taut.errors.UsageError),
        (lambda: taut.Sensing(notch=taut.sensors.LowPass(cutoff=3.0)), taut.errors.UsageError),
        (lambda: taut.Sensing(F_ext=30.0), taut.errors.UsageError),
        (lambda: taut.compile(ShowV(), ARM, rate=50.0, sensing=SENSINGS["difference and low-pass"]), taut.errors.RangeError),
        (lambda: taut.compile(ShowV(), ARM, sensing=taut.Sensing(notch=taut.sensors.Notch(frequency=[1.0] * 3, width=1.0))), taut.errors.ShapeError),
        (lambda: taut.compile(ShowForce(), ARM, sensing=taut.Sensing(F_ext=taut.sensors.LowPass(cutoff=[1.0, 1.0]))), taut.errors.ShapeError),
        (lambda: taut.compile(ShowV(), ARM, sensing=taut.Sensing(F_ext=taut.sensors.LowPass(cutoff=9.0))), taut.errors.UsageError),
    ],
    ids=range(7),
)  # fmt: skip
def test_what_does_not_fit_is_refused_in_words(make: Callable[[], Any], kind: type[taut.TautError]) -> None:
    with refused(kind):
        make()


def test_explain_says_what_it_does_and_prints_its_numbers_with_units() -> None:
    text = taut.compile(ShowV(), ARM, sensing=SENSINGS["notch and kalman"], engine="float").explanation()
    assert "sensing        q by Notch, v by Kalman\n" in text
    assert "  sensing.notch.frequency             18  [Hz]\n" in text
    assert "  sensing.notch.depth                 40  [dB]\n" in text
    assert "sensing" not in taut.compile(ShowV(), ARM, engine="float").explanation()


# -------------------------------------------------------------------- NaN


def tick(ctrl: taut.Controller, values: dict[str, Any]) -> Array:
    return ctrl.step(**{name: value for name, value in values.items() if name in ("q", *ctrl.side.takes)}, ref=REF)


def measurements(rng: np.random.Generator) -> dict[str, Array]:
    sizes = {"q": 2, "v": 2, "F_ext": 6, "tau_meas": 2, "q_motor": 2, "v_motor": 2, "a_tip": 3}
    return {name: 0.1 * rng.standard_normal(size) for name, size in sizes.items()}


@every
@engines
def test_a_sensor_that_gives_nan_stops_its_tick_and_leaves_nothing_behind(sensing: taut.Sensing, engine: Any) -> None:
    """In the first tick and later, through step and through bound arrays; the next good tick is as if it never was."""
    filters = {"F_ext": taut.sensors.LowPass(cutoff=30.0, order=2), "tau_meas": taut.sensors.LowPass(cutoff=30.0)}
    whole = taut.Sensing(velocity=sensing.velocity, notch=sensing.notch, **filters)
    ctrl, twin = (taut.compile(ShowAll(), ARM, sensing=whole, engine=engine) for _ in range(2))
    rng, bound = np.random.default_rng(6), ctrl.bind()
    for k in range(4):
        good = measurements(rng)
        for name in ("q", *ctrl.side.takes):
            for wrong in (np.nan, np.inf):
                bad = {**good, name: good[name].copy()}
                bad[name][1] = wrong
                who = (name, "joint2" if len(bad[name]) == 2 else None)
                with pytest.raises(taut.errors.RangeError) as caught:
                    tick(ctrl, bad)
                assert (caught.value.name, caught.value.joint) == who
                for path in ("q", *ctrl.side.takes):
                    getattr(bound, path)[:] = bad[path]
                with pytest.raises(taut.errors.RangeError) as caught:
                    bound.tick()
                assert (caught.value.name, caught.value.joint) == who
        np.testing.assert_array_equal(tick(ctrl, good), tick(twin, good))
        assert ctrl.ticks == twin.ticks == k + 1


@engines
def test_a_force_with_as_many_axes_as_joints_is_not_blamed_on_a_joint(engine: Any) -> None:
    class Feels(taut.Law):
        def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
            return taut.Torque(F=x.J().T @ x.F_ext, q=0.0 * x.q)

    arm = taut.load_arm("ur5")
    ctrl = taut.compile(Feels(), arm, engine=engine)
    F = np.array([0.0, np.nan, 0.0, 0.0, 0.0, 0.0])
    with refused(taut.errors.RangeError):
        ctrl.step(arm.home, np.zeros(6), taut.JointMotion(q=arm.home), F_ext=F)


# -------------------------------------------------------------------- the other measurements


@engines
def test_a_law_sees_the_motor_side_and_the_tip_as_they_are_given(engine: Any) -> None:
    ctrl = taut.compile(ShowAll(), ARM, engine=engine)
    assert ctrl.needs == ("v", "F_ext", "tau_meas", "q_motor", "v_motor", "a_tip")
    given = measurements(np.random.default_rng(7))
    tick(ctrl, given)
    for name, entry in (("q_motor", "q_motor"), ("v_motor", "v_motor"), ("a", "a_tip")):
        np.testing.assert_array_equal(ctrl.terms[name], given[entry][:2])
    for name in ("q_motor", "v_motor", "a_tip"):
        with refused(taut.errors.UsageError):
            tick(ctrl, {key: value for key, value in given.items() if key != name})
    with refused(taut.errors.ShapeError):
        tick(ctrl, {**given, "a_tip": np.zeros(2)})


@pytest.mark.parametrize(
    "name",
    [
        "q_motor",
        "v_motor",
        "a_tip",
    ],
)
def test_a_snapshot_says_what_would_measure_what_it_lacks(name: str) -> None:
    with refused(taut.errors.MatchError):
        getattr(taut.snapshot(ARM, [0.0, 0.0]), name)


def test_at_rest_a_law_is_tried_with_the_weight_at_its_tip() -> None:
    """A law that divides by what an accelerometer reads is no law that fails at rest."""

    class Upright(taut.Law):
        def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
            return taut.Torque(up=x.a_tip[:2] / taut.math.norm(x.a_tip))

    ctrl = taut.compile(Upright(), ARM, engine="float")
    at_rest = ctrl.side.measurements_at_rest(ARM.home)
    R_WE = taut.snapshot(ARM, ARM.home).T().R
    np.testing.assert_allclose(at_rest["a_tip"], R_WE.T @ -ARM.gravity, atol=1e-15)
    assert np.isclose(np.linalg.norm(at_rest["a_tip"]), np.linalg.norm(ARM.gravity))
