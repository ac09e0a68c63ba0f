"""What a controller makes of its wrist sensor's readings: bias and load out, the end of the range and faults told."""

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
ARM = taut.load_arm("planar3").with_tool("tool", taut.Pose(p=[0.05, -0.02, 0.1], rpy=[0.4, 0.2, -0.7]), name="tip")
PAYLOAD = {"mass": 1.1, "com": (0.02, -0.01, 0.08)}
LADEN = ARM.with_payload(**PAYLOAD)  # type: ignore[arg-type]
BIAS = np.array([1.5, -2.0, 3.0, 0.1, -0.2, 0.3])
MASS, COM = 0.7, np.array([0.01, -0.02, 0.06])
REF = taut.JointMotion(q=[0.0, 0.0, 0.0])
engines = pytest.mark.parametrize("engine", ["native", "float"])


class Feels(taut.Law):
    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        return taut.Torque(f=x.F_ext[:3], n=x.F_ext[3:], g=0.0 * x.g)


class Blind(taut.Law):
    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        return taut.Torque(q=0.0 * x.q)


def reading(q: Array, F: Array, frame: str | None = None, payload: bool = True) -> Array:
    """By hand: what a sensor at a frame gives, in world axes at the tool's origin, with all that weighs."""
    x = taut.snapshot(ARM, q)
    T_WE, T_WS, g = x.T(), x.T(frame), ARM.gravity
    out = np.array(F, dtype=np.float64)
    loads = [(MASS, T_WS.act(COM)), (PAYLOAD["mass"], T_WE.act(PAYLOAD["com"]))]  # where they hang in the world
    for mass, centre in loads[: 1 + payload]:
        out[:3] += mass * g  # type: ignore[operator]
        out[3:] += np.cross(centre - T_WE.p, mass * g)  # type: ignore[operator]
    f = T_WS.R @ BIAS[:3]
    out[:3] += f
    out[3:] += T_WS.R @ BIAS[3:] + np.cross(T_WS.p - T_WE.p, f)
    return out


def states(count: int = 20) -> tuple[Array, Array]:
    rng = np.random.default_rng(2)
    return rng.standard_normal((count, 3)), 10.0 * rng.standard_normal((count, 6))


@engines
@pytest.mark.parametrize("frame", [None, "tool"])
def test_a_law_sees_contact_alone(engine: Any, frame: str | None) -> None:
    wrist = taut.sensors.Wrist(bias=BIAS, mass=MASS, com=COM, frame=frame)
    ctrl = taut.compile(Feels(), LADEN, sensing=taut.Sensing(wrist=wrist), engine=engine)
    for q, F in zip(*states(), strict=True):
        step(ctrl, q, reading(q, F, frame))
        np.testing.assert_allclose(np.concatenate([ctrl.terms["f"], ctrl.terms["n"]]), F, rtol=0.0, atol=1e-12)


@engines
def test_without_a_mass_nothing_weighs_and_the_payload_does_not_either(engine: Any) -> None:
    ctrl = taut.compile(Feels(), LADEN, sensing=taut.Sensing(wrist=taut.sensors.Wrist(bias=BIAS)), engine=engine)
    q, F = (rows[0] for rows in states())
    R = taut.snapshot(ARM, q).T().R
    step(ctrl, q, F)
    np.testing.assert_allclose(ctrl.sensed["F_ext"][:3], F[:3] - R @ BIAS[:3], rtol=0.0, atol=1e-12)


def step(ctrl: taut.Controller, q: Array, F: Array) -> Array:
    given = {"v": np.zeros(3)} if "v" in ctrl.side.takes else {}
    return ctrl.step(q, ref=REF, F_ext=F, **given)


@engines
def test_every_number_of_it_changes_without_a_compile(engine: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    wrist = taut.sensors.Wrist(bias=(0.0, 0.0), mass=0.0, range=(50.0, 5.0))
    ctrl = taut.compile(Feels(), ARM, sensing=taut.Sensing(wrist=wrist), engine=engine)
    monkeypatch.setattr("taut.codegen.kernel.trace", lambda *_: pytest.fail("traced again"))
    paths = [path for path in ctrl.parameters if path.startswith("sensing.")]
    assert paths == [f"sensing.wrist.{name}" for name in ("bias", "mass", "com", "range")]
    q, F = (rows[1] for rows in states())
    step(ctrl, q, F)
    np.testing.assert_allclose(ctrl.sensed["F_ext"], F, rtol=0.0, atol=1e-12)
    new = {"sensing.wrist.bias": BIAS, "sensing.wrist.mass": MASS, "sensing.wrist.com": COM}
    new |= {f"model.payload.{name}": value for name, value in PAYLOAD.items()}
    for path, value in new.items():
        ctrl.parameters[path] = value
    step(ctrl, q, reading(q, F))
    np.testing.assert_allclose(ctrl.sensed["F_ext"], F, rtol=0.0, atol=1e-12)
    ctrl.parameters["sensing.wrist.bias"] = (1.0, 0.1)
    assert ctrl.parameters["sensing.wrist.bias"].tolist() == [1.0] * 3 + [0.1] * 3


@engines
def test_a_low_pass_comes_after_it_and_starts_without_a_transient(engine: Any) -> None:
    """The weight turns with the arm: filtered before it is taken out, it would lag and leave a wrench behind."""
    low_pass = taut.sensors.LowPass(cutoff=20.0, order=2)
    sensing = taut.Sensing(wrist=taut.sensors.Wrist(bias=BIAS, mass=MASS, com=COM), F_ext=low_pass)
    ctrl = taut.compile(Feels(), LADEN, sensing=sensing, engine=engine)
    t = np.arange(200)[:, np.newaxis] * 1e-3
    q, F = np.sin(9.0 * t + np.arange(3)), np.sin(40.0 * t + np.arange(6))
    got = []
    for row, touch in zip(q, F, strict=True):
        step(ctrl, row, reading(row, touch))
        got.append(ctrl.sensed["F_ext"])
    b, a = scipy.signal.butter(2, 20.0, fs=1000.0)
    wanted, _ = scipy.signal.lfilter(b, a, F, axis=0, zi=scipy.signal.lfilter_zi(b, a)[:, np.newaxis] * F[0])
    np.testing.assert_allclose(got, wanted, rtol=0.0, atol=1e-11)


# -------------------------------------------------------------------- the end of the range


@engines
@pytest.mark.parametrize("frame", [None, "tool"])
def test_a_reading_at_the_end_of_the_range_is_told(engine: Any, frame: str | None) -> None:
    limit = np.array([30.0, np.inf, 20.0, 4.0, 5.0, np.inf])
    wrist = taut.sensors.Wrist(bias=BIAS, range=limit, frame=frame)
    ctrl = taut.compile(Feels(), ARM, sensing=taut.Sensing(wrist=wrist), engine=engine)
    rng, told = np.random.default_rng(5), []
    for k in range(40):
        q = rng.standard_normal(3)
        T_WE, T_WS = (taut.snapshot(ARM, q).T(name) for name in (None, frame))
        F_S = 0.7 * np.array([30.0, 90.0, 20.0, 4.0, 5.0, 9.0]) * rng.standard_normal(6)
        F_S = np.clip(F_S, -limit, limit)  # as the sensor cuts
        f = T_WS.R @ F_S[:3]
        step(ctrl, q, np.concatenate([f, T_WS.R @ F_S[3:] + np.cross(T_WS.p - T_WE.p, f)]))
        told.append(float(ctrl.sensed["saturated.F_ext"]))
        assert told[-1] == float((np.abs(F_S) >= limit).any()), k
    assert 5 < sum(told) < 35


def test_what_the_law_saw_can_be_looked_at() -> None:
    ctrl = taut.compile(Feels(), ARM, sensing=taut.Sensing(wrist=taut.sensors.Wrist(bias=BIAS)), engine="float")
    with refused(taut.errors.UsageError):
        ctrl.sensed  # noqa: B018
    q, F = (rows[2] for rows in states())
    step(ctrl, q, F)
    assert set(ctrl.sensed) >= {"q", "F_ext"}
    np.testing.assert_array_equal(ctrl.sensed["q"], q)
    with refused(taut.errors.UnknownNameError):
        ctrl.sensed["F_ex"]


# -------------------------------------------------------------------- faults


@engines
@pytest.mark.parametrize("entry", [1, 4])
@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf])
def test_a_reading_that_is_no_number_stops_its_tick_and_leaves_nothing_behind(
    engine: Any, entry: int, wrong: float
) -> None:
    sensing = taut.Sensing(
        wrist=taut.sensors.Wrist(bias=BIAS, mass=MASS, com=COM, range=(200.0, 10.0)),
        F_ext=taut.sensors.LowPass(cutoff=30.0, order=2),
    )
    ctrl, twin = (taut.compile(Feels(), LADEN, sensing=sensing, engine=engine) for _ in range(2))
    for q, F in zip(*states(4), strict=True):
        bad = F.copy()
        bad[entry] = wrong
        with refused(taut.errors.RangeError) as caught:
            step(ctrl, q, bad)
        assert caught.value.joint is None
        np.testing.assert_array_equal(step(ctrl, q, F), step(twin, q, F))


# -------------------------------------------------------------------- words


CASES: list[tuple[Callable[[], object], type[taut.TautError]]] = [
    (lambda: taut.sensors.Wrist(bias=1.0), taut.errors.ShapeError),
    (lambda: taut.sensors.Wrist(bias=[np.nan] * 6), taut.errors.RangeError),
    (lambda: taut.sensors.Wrist(mass=-0.1), taut.errors.RangeError),
    (lambda: taut.sensors.Wrist(mass=[0.1, 0.2]), taut.errors.ShapeError),
    (lambda: taut.sensors.Wrist(com=[0.0, 0.0, 0.1]), taut.errors.UsageError),
    (lambda: taut.sensors.Wrist(mass=0.1, com=[0.0, 0.1]), taut.errors.ShapeError),
    (lambda: taut.sensors.Wrist(range=(0.0, 1.0)), taut.errors.RangeError),
    (lambda: taut.Sensing(wrist=BIAS), taut.errors.UsageError),  # type: ignore[arg-type]
    (lambda: taut.compile(Blind(), ARM, sensing=taut.Sensing(wrist=taut.sensors.Wrist())), taut.errors.UsageError),
    (lambda: taut.compile(Feels(), ARM, sensing=taut.Sensing(wrist=taut.sensors.Wrist(frame="link2"))), taut.errors.UsageError),
    (lambda: taut.compile(Feels(), ARM, sensing=taut.Sensing(wrist=taut.sensors.Wrist(frame="tol"))), taut.errors.UnknownNameError),
    (lambda: compiled().parameters.__setitem__("sensing.wrist.mass", -1.0), taut.errors.RangeError),
    (lambda: compiled().parameters.__setitem__("sensing.wrist.com", [0.0]), taut.errors.ShapeError),
    (lambda: compiled().parameters.__setitem__("sensing.wrist.range", (9.0, 1.0)), taut.errors.UnknownNameError),
    (lambda: taut.run(compiled(), taut.MujocoPlant(ARM), duration=0.01), taut.errors.MatchError),
]  # fmt: skip


def compiled() -> taut.Controller:
    wrist = taut.sensors.Wrist(mass=MASS, com=COM)
    return taut.compile(Feels(), ARM, sensing=taut.Sensing(wrist=wrist), engine="float")


@pytest.mark.parametrize(("make", "kind"), CASES, ids=range(len(CASES)))
def test_what_cannot_be_is_refused_in_words(make: Callable[[], object], kind: type[taut.TautError]) -> None:
    with refused(kind):
        make()


def test_explain_says_what_it_takes_out_with_units() -> None:
    text = compiled().explanation()
    assert "sensing        F_ext by Wrist\n" in text
    assert "  sensing.wrist.mass       0.7  [kg]\n" in text
