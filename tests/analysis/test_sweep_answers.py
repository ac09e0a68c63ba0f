"""Answers of a sweep: rates, bands and shares against closed forms and simulated truth; gains for a set of plants."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from refusals import refused
from scipy.stats import binomtest, spearmanr

import taut
from taut.analysis.sweeps.answers import GROUPS, bands_of, rate_of, shares_of
from taut.errors import RangeError, ShapeError, UnknownNameError, UsageError

PLANAR, ONE = taut.load_arm("planar2"), taut.load_arm("one_joint")
L = taut.laws


# -------------------------------------------------------------------- rates


@pytest.mark.parametrize(("count", "samples"), [(0, 30), (30, 30), (1, 7), (483, 1000)])
def test_a_rate_has_the_interval_of_clopper_and_pearson(count: int, samples: int) -> None:
    rate = rate_of(np.arange(samples) < count)
    low, high = rate.interval
    assert rate.value == count / samples
    expected = binomtest(count, samples).proportion_ci(0.95, method="exact")
    assert (low, high) == pytest.approx((expected.low, expected.high), abs=1e-9)


def test_the_interval_of_a_rate_covers_the_probability_as_often_as_it_says() -> None:
    rng = np.random.default_rng(3)
    inside = [low <= 0.07 <= high for low, high in (rate_of(rng.random(60) < 0.07).interval for _ in range(400))]
    assert np.mean(inside) >= 0.93


# -------------------------------------------------------------------- bands


def test_bands_are_the_percentiles_of_equally_full_bins_or_of_each_value() -> None:
    rng = np.random.default_rng(1)
    x, mass = rng.normal(size=4000), rng.choice([0.0, 0.5, 2.0], size=4000)
    y = x**2 + 0.1 * rng.normal(size=4000)
    y[7] = np.nan  # of a run that failed
    bands = bands_of(x, y)
    assert len(bands.x) == 20
    assert np.ptp(bands.counts) <= 1
    order = np.argsort(x)[400:600]  # the third bin
    values = y[order][np.isfinite(y[order])]
    np.testing.assert_allclose(bands.percentiles[:, 2], np.percentile(values, [5, 25, 50, 75, 95]), rtol=1e-12)
    of_masses = bands_of(mass, y)
    assert of_masses.x.tolist() == [0.0, 0.5, 2.0]
    assert of_masses.counts.tolist() == [np.sum(mass == m) for m in (0.0, 0.5, 2.0)]
    assert of_masses.percentiles[2, 1] == np.nanmedian(y[mass == 0.5])


# -------------------------------------------------------------------- shares


def drawn(n: int, seed: int) -> tuple[dict[str, Any], Any]:
    """Three parameters, the third of which does nothing, and a number: without a sign, skewed, with noise."""
    rng = np.random.default_rng(seed)
    a, b, c = rng.uniform(-1.0, 1.0, size=(3, n))
    return {"a": a, "b": b, "c": c}, np.exp(2.0 * a**2 + 0.7 * b + 0.2 * rng.normal(size=n))


def test_shares_are_those_of_many_samples_within_their_intervals() -> None:
    truth = {each.path: each.share for each in shares_of(*drawn(300_000, 99))}
    assert truth["c"] < 3e-4
    inside: dict[str, list[bool]] = {name: [] for name in truth}
    for seed in range(60):
        for each in shares_of(*drawn(1000, seed)):
            inside[each.path].append(abs(each.share - truth[each.path]) <= each.interval + 0.01)  # 0.01: of the bins
    assert min(np.mean(each) for each in inside.values()) >= 0.9, {k: np.mean(v) for k, v in inside.items()}


def test_a_share_sees_what_a_correlation_does_not_and_no_order_preserving_scale() -> None:
    inputs, y = drawn(4000, 5)
    found = {each.path: each for each in shares_of(inputs, y)}
    assert list(found) == ["a", "b", "c"]
    assert abs(found["a"].correlation) < 0.05
    assert found["a"].share > 0.4
    assert found["b"].correlation == pytest.approx(spearmanr(inputs["b"], y).statistic, abs=1e-12)
    assert found["c"].share <= found["c"].interval
    assert shares_of(inputs, np.log(y)) == tuple(found.values())
    alone = shares_of({"a": inputs["a"]}, np.cos(3.0 * inputs["a"]))[0]
    assert alone.share > 0.97
    both = shares_of(inputs, np.sign(inputs["a"] * inputs["b"]))  # a joint effect is in neither share
    assert all(each.share <= 0.02 + each.interval for each in both)


def test_shares_of_a_choice_of_success_and_of_nothing() -> None:
    rng = np.random.default_rng(8)
    kind, x = rng.choice([0.0, 1.0, 5.0], size=3000), rng.random(3000)
    good = (kind == 1.0).astype(float)  # neither smallest nor largest
    found = {each.path: each for each in shares_of({"kind": kind, "x": x, "same": np.full(3000, 2.0)}, good)}
    assert set(found) == {"kind", "x"}
    assert found["kind"].share == pytest.approx(1.0)
    assert found["x"].share <= found["x"].interval
    assert shares_of({"x": x}, np.ones(3000)) == ()
    assert shares_of({"x": x[: 2 * GROUPS - 1]}, x[: 2 * GROUPS - 1]) == ()
    holes = np.where(rng.random(3000) < 0.3, np.nan, good)
    assert shares_of({"kind": kind}, holes)[0].share == pytest.approx(1.0)


# -------------------------------------------------------------------- a sweep


@pytest.fixture(scope="module")
def found() -> taut.analysis.Sweep:
    """Gains, payloads and starts of a planar arm; three samples diverge."""
    ctrl = taut.compile(L.GravityPID(kp=[50.0, 50.0], kd=8.0), PLANAR)
    loop = taut.Loop(ctrl, taut.RigidPlant(PLANAR), taut.JointMotion(q=PLANAR.home), duration=0.3)
    kd = np.linspace(4.0, 12.0, 400)
    kd[[3, 50, 70]] = 1e9, 1e6, 1e9
    vary = {
        "law.kd": kd,
        "law.kp[1]": taut.uniform(20.0, 80.0),
        "plant.payload.mass": taut.uniform(0.0, 2.0),
        "q0": taut.uniform(PLANAR.home - 0.2, PLANAR.home + 0.2),
    }
    return taut.sweep(loop, vary, samples=400, success={"final_error": (0.0, 0.1)})


def test_a_sweep_ends_in_a_rate_of_runs_that_meet_what_was_asked(found: taut.analysis.Sweep) -> None:
    error = found.table["final_error"]
    good = (error <= 0.1) & (found.table["outcome"] == "completed")
    assert 0.05 < np.mean(good) < 0.95
    assert not good[[3, 50, 70]].any()
    assert (found.success.count, found.success.samples) == (int(good.sum()), 400)
    judged = dataclasses.replace(found, bounds={"final_error": (0.05, 0.1), "peak_torque": (-np.inf, 1e9)})
    assert judged.success.count == int((good & (error >= 0.05)).sum())
    assert dataclasses.replace(found, bounds={}).success.count == 397
    assert "success" in str(found)
    assert "success:" not in str(dataclasses.replace(found, bounds={}))
    assert f"{100 * good.mean():.4g} %" in str(found)


def test_the_worst_case_is_the_first_to_diverge_or_has_the_worst_number(found: taut.analysis.Sweep) -> None:
    ticks = found.table["ticks"]
    assert found.worst in (3, 70)
    assert ticks[found.worst] == ticks.min()
    healthy = dataclasses.replace(found.plan, varied=found.plan.varied[1:])
    kept = taut.sweep(
        healthy.subject.loop(healthy.subject.ref), {"law.kp[1]": taut.uniform(20.0, 80.0)}, samples=60,
        metrics=["final_error"], success={"peak_torque": (0.0, 1e3)},
    )  # fmt: skip
    assert kept.worst == int(np.argmax(kept.table["final_error"]))
    assert kept.run(kept.worst).metrics.overall("final_error") == pytest.approx(kept.table["final_error"][kept.worst])
    least = dataclasses.replace(kept, bounds={"final_error": (0.1, np.inf)})
    assert least.worst == int(np.argmin(kept.table["final_error"]))


def test_bands_shares_and_loops_are_those_of_the_samples(found: taut.analysis.Sweep) -> None:
    assert list(found.inputs) == ["law.kd", "law.kp[1]", "plant.payload.mass", "q0[0]", "q0[1]"]
    np.testing.assert_array_equal(found.inputs["q0[1]"], found.table["q0"][:, 1])
    bands = found.bands("final_error", "q0[0]")
    assert bands.counts.sum() == 400
    assert bands.percentiles[2, 0] > bands.percentiles[2, len(bands.x) // 2]  # a start that is far away
    far = {each.path: each.share for each in found.shares("final_error")}
    assert max(far, key=lambda path: far[path]) == "plant.payload.mass"  # which the law does not carry
    assert far["q0[0]"] > far["law.kd"]
    assert {each.path for each in found.shares()} == set(found.inputs)
    again = taut.run(found.loop(9), q0=found.table["q0"][9], progress=False)
    np.testing.assert_array_equal(again.q, found.run(9).q)


def test_a_sweep_describes_itself_with_pictures(found: taut.analysis.Sweep) -> None:
    data = found.json()
    rows = data["tables"]["which parameter matters most"]
    assert {row["of"] for row in rows} == {"success", "final error [rad]"}
    assert all(0.0 <= row["share"] <= 1.0 for row in rows)
    bands, shares = (draw() for draw in found.content().figures.values())
    assert [len(bands.axes), len(shares.axes)] == [6, 2]
    assert bands.axes[3].get_ylabel() == "success [%]"
    assert not taut.sweep(found.loop(0), {}, samples=2).content().figures


@pytest.mark.parametrize(
    ("error", "make"),
    [
        (UnknownNameError, lambda found: found.bands("final_error", "law.kq")),
        (UnknownNameError, lambda found: found.bands("final_eror", "law.kd")),
        (UnknownNameError, lambda found: found.shares("rms")),
        (UnknownNameError, lambda found: taut.sweep(found.loop(0), {}, samples=1, success={"final_eror": (0.0, 1.0)})),
        (RangeError, lambda found: taut.sweep(found.loop(0), {}, samples=1, success={"final_error": (1.0, 0.0)})),
        (RangeError, lambda found: taut.sweep(found.loop(0), {}, samples=1, success={"final_error": 0.1})),
        (RangeError, lambda found: taut.sweep(found.loop(0), {}, samples=1, success={"task_rms": (0.0, 1.0)})),
        (UsageError, lambda found: taut.sweep(found.loop(0), {}, samples=1, success=["final_error"])),
    ],
)  # fmt: skip
def test_wrong_questions_are_refused(error: Any, make: Callable[[Any], Any], found: taut.analysis.Sweep) -> None:
    with refused(error):
        make(found)


def test_the_loop_of_a_sample_is_of_a_model_plant() -> None:
    ctrl = taut.compile(L.GravityPID(kp=50.0, kd=8.0), PLANAR)
    found = taut.sweep(ctrl, {}, taut.MujocoPlant(PLANAR), duration=0.01, samples=1, workers=1)
    with refused(UsageError):
        found.loop(0)


# -------------------------------------------------------------------- gains for a set of plants


def loads(arm: taut.Arm, *masses: float) -> dict[str, taut.RigidPlant]:
    return {f"{m:g} kg": taut.RigidPlant(arm.with_payload(m), friction=None) for m in masses}


def judge_set(arm: taut.Arm, masses: tuple[float, ...]) -> None:
    """Gains for a set of payloads hold with each; those for the arm alone hold with it, and not with all."""
    asked: dict[str, Any] = {"overshoot": 10.0, "settling": 0.5, "coupled": True}
    plants = loads(arm, *masses)
    alone = {name: taut.design(L.GravityPID, arm, plant=plant, **asked) for name, plant in plants.items()}
    assert [each.met for each in alone.values()] == [True, *[False] * (len(masses) - 1)]
    found = taut.design(L.GravityPID, arm, plant=plants, **asked)
    assert found.met
    assert list(found.members) == list(plants)
    assert all(each.met and repr(each.law) == repr(found.law) for each in found.members.values())
    loop = taut.Loop(
        taut.compile(found.law, arm), list(plants.values())[-1], taut.JointMotion(q=arm.home), duration=1.0
    )
    rest = taut.linearise(loop, at=arm.home, within=1.0).point.q
    step = (taut.run(loop, q0=rest + 1e-3 * np.eye(arm.n)[0], progress=False).q - rest)[:, 0] / 1e-3
    assert np.abs(step[525:]).max() < 0.03  # the run, not the linear model
    assert -step.min() < 0.115


def test_gains_for_a_set_of_payloads_hold_with_each_those_for_the_arm_alone_do_not() -> None:
    judge_set(PLANAR, (0.0, 3.0))


@pytest.mark.long
@pytest.mark.bars
@pytest.mark.parametrize("name", ["ur10"])
def test_gains_for_a_set_of_payloads_hold_on_a_large_arm(name: str) -> None:
    judge_set(taut.load_arm(name), (0.0, 1.5, 3.0))


def test_a_set_that_cannot_be_met_is_described_by_its_worst_plant() -> None:
    late = taut.RigidPlant(ONE, friction=None, integrator="rk4", actuation=taut.drives.Actuation(delay=0.02))
    plants = [taut.RigidPlant(ONE, friction=None, integrator="rk4"), late]
    found = taut.design(L.ComputedTorque, ONE, zeta=0.7, omega_n=60.0, plant=plants)
    assert not found.stable
    assert not found.met
    assert found.members["plant 0"].met
    assert found.unstable == found.members["plant 1"].unstable
    assert [row["plant"] for row in found.json()["tables"]["plants, the worst of which is described here"]] == [
        "plant 0",
        "plant 1",
    ]
    one = taut.design(L.ComputedTorque, ONE, zeta=0.7, omega_n=60.0, plant=plants[:1])
    assert (one.met, one.members) == (True, {})


@pytest.mark.parametrize(
    ("error", "plant"),
    [
        (UsageError, []),
        (UsageError, "rigid"),
        (UsageError, [taut.RigidPlant(PLANAR), PLANAR]),
        (ShapeError, {"a": taut.RigidPlant(PLANAR), "b": taut.RigidPlant(ONE)}),
    ],
)
def test_plants_that_are_none_are_refused(error: Any, plant: Any) -> None:
    with refused(error):
        taut.design(L.ComputedTorque, PLANAR, zeta=1.0, omega_n=10.0, plant=plant)


@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_gains_tuned_for_the_worst_of_a_set_hold_on_each_those_for_the_nominal_do_not() -> None:
    ctrl = taut.compile(L.GravityPID(kp=10.0, kd=3.0), ONE)
    ref = taut.JointMotion(q=ONE.home + 0.3)

    def loop(law: taut.Law, delay: float) -> taut.Loop:
        plant = taut.RigidPlant(ONE, friction=None, actuation=taut.drives.Actuation(delay=delay))
        return taut.Loop(taut.compile(law, ONE), plant, ref, duration=0.4)

    loops = {"prompt": loop(ctrl.law, 0.0), "late": loop(ctrl.law, 0.01)}
    paths, bounds = ("law.kp", "law.kd"), {"law.kp": (1.0, 1e4), "law.kd": (0.1, 300.0)}
    alone = taut.tune(loops["prompt"], paths, bounds=bounds)
    worst = taut.tune(loops, paths, bounds=bounds, over="worst")

    def costs(law: taut.Law) -> list[float]:
        runs = [taut.run(loop(law, delay), progress=False) for delay in (0.0, 0.01)]
        return [float(np.mean(np.sum(run.error**2, axis=1))) if run.outcome.ok else np.inf for run in runs]

    start = costs(ctrl.law)
    assert costs(alone.law)[0] < start[0]
    assert costs(alone.law)[1] > start[1]
    assert all(after < 0.95 * before for before, after in zip(start, costs(worst.law), strict=True))
    assert [each.cost for each in worst.after] == pytest.approx(costs(worst.law), rel=1e-9)
    assert worst.cost == pytest.approx(max(costs(worst.law)) / max(start), rel=1e-9)
    twice = taut.RigidPlant(ONE, friction=None), taut.JointMotion(q=ONE.home + 0.03)
    both = {"large": loops["prompt"], "small": taut.Loop(ctrl, *twice, duration=0.4)}
    first = taut.tune(both, paths, bounds=bounds, over="worst", evaluations=1).history[0]
    assert first.costs.tolist() == [1.0, pytest.approx(first.figures[1].cost / first.figures[0].cost)]
    assert first.costs[1] < 0.05
    for change in ({"kp": 1.1}, {"kp": 0.9}, {"kd": 1.1}, {"kd": 0.9}):
        near = {name: np.asarray(getattr(worst.law, name)) * factor for name, factor in change.items()}
        assert max(costs(dataclasses.replace(worst.law, **near))) >= max(costs(worst.law))
    with refused(UsageError):
        taut.tune(loops, paths, over="largest")
