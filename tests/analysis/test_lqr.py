"""Linear-quadratic regulator: against python-control on a model of its own, its cost, and runs."""

from __future__ import annotations

import control
import numpy as np
import pytest
from refusals import refused
from scipy.linalg import expm

import taut
from taut.errors import RangeError, ShapeError, UsageError

CASES = {"planar2": 100.0, "panda": 500.0, "ur10": 200.0}


def sampled_model(arm, q, rate):
    """The arm at rest at q under its weight and a zero-order hold, by the matrix exponential."""
    n, x = arm.n, taut.snapshot(arm, q)
    slope = np.stack([(x.at(q + d, 0 * q).g - x.at(q - d, 0 * q).g) / 2e-6 for d in 1e-6 * np.eye(n)], axis=1)
    inverse, zero = np.linalg.inv(x.M), np.zeros((n, n))
    whole = expm(np.block([[zero, np.eye(n), zero], [-inverse @ slope, zero, inverse], [zero] * 3]) / rate)
    return whole[: 2 * n, : 2 * n], whole[: 2 * n, 2 * n :]


@pytest.mark.part(1)
@pytest.mark.parametrize("name", CASES)
def test_the_gain_is_that_of_python_control_on_a_model_of_its_own(name):
    arm, rate, rng = taut.load_arm(name), CASES[name], np.random.default_rng(4)
    n = arm.n
    root = rng.standard_normal((2 * n, 2 * n))
    weights = [
        (np.diag([400.0] * n + [1.0] * n), 0.01 * np.eye(n)),
        (root @ root.T + 10.0 * np.eye(2 * n), np.eye(n)),
    ]
    q = arm.home + rng.uniform(-0.2, 0.2, n)
    for Q, R in weights:
        found = taut.analysis.lqr(arm, Q=Q, R=R, at=q, rate=rate)
        K, P, poles = control.dlqr(*sampled_model(arm, q, rate), Q, R)
        # The model of taut is rk4 in one step of 2 to 10 ms, of which the fastest joint has an error of 1e-6.
        np.testing.assert_allclose(found.K, K, rtol=2e-5, atol=1e-6 * np.abs(K).max())
        np.testing.assert_allclose(found.P, P, rtol=2e-5, atol=1e-6 * np.abs(P).max())
        np.testing.assert_allclose(np.sort(np.abs(found.poles)), np.sort(np.abs(poles)), atol=2e-5)
        np.testing.assert_array_equal(np.hstack([found.law.K_q, found.law.K_v]), found.K)


@pytest.mark.part(1)
@pytest.mark.parametrize("name", CASES)
def test_a_run_is_judged_stable_and_costs_what_it_says(name):
    arm, rate, n = taut.load_arm(name), CASES[name], taut.load_arm(name).n
    Q, R = np.diag([400.0] * n + [1.0] * n), 0.01 * np.eye(n)
    found = taut.analysis.lqr(arm, Q=Q, R=R, rate=rate)
    away = 1e-4 * np.cos(np.arange(n))
    plant = taut.RigidPlant(arm, friction=None, integrator="rk4")
    ref = taut.JointMotion(q=arm.home)
    run = taut.run(taut.compile(found.law, arm, rate=rate), plant, ref, q0=arm.home + away, duration=6.0)
    assert run.info.stability.stable
    x, u = np.hstack([run.q - arm.home, run.v]), run.command - found.law.tau_0.as_array()
    cost = np.einsum("ki,ij,kj->", x, Q, x) + np.einsum("ki,ij,kj->", u, R, u)
    assert cost == pytest.approx(x[0] @ found.P @ x[0], rel=1e-3)
    worse = taut.laws.StateFeedback(K_q=1.2 * found.K[:, :n], K_v=found.K[:, n:], tau_0=found.law.tau_0)
    other = taut.run(taut.compile(worse, arm, rate=rate), plant, ref, q0=arm.home + away, duration=6.0)
    x, u = np.hstack([other.q - arm.home, other.v]), other.command - found.law.tau_0.as_array()
    assert np.einsum("ki,ij,kj->", x, Q, x) + np.einsum("ki,ij,kj->", u, R, u) > 1.001 * cost


def test_friction_and_what_the_plant_adds_belong_to_the_model():
    arm = taut.load_arm("planar2")
    Q, R = [400.0, 400.0, 1.0, 1.0], 0.01
    plain = taut.analysis.lqr(arm, Q=Q, R=R)
    viscous = taut.RigidPlant(arm.with_friction(taut.Friction(viscous=2.0)), integrator="rk4")
    assert not np.allclose(taut.analysis.lqr(arm, Q=Q, R=R, plant=viscous).K, plain.K, rtol=1e-3)
    adding = taut.RigidPlant(arm, friction=None, adds=("gravity",))
    found = taut.analysis.lqr(arm, Q=Q, R=R, plant=adding)
    assert not found.law.tau_0.as_array().any()
    ctrl = taut.compile(found.law, arm, adds=adding.adds)
    assert taut.run(ctrl, adding, taut.JointMotion(q=arm.home), duration=0.2).outcome.ok
    assert "omega_n" in str(plain)


@pytest.mark.parametrize(
    ("options", "kind"),
    [
        ({"Q": [0.0] * 6 + [1.0] * 6, "arm": "ur10"}, RangeError),
        ({"R": 0.0}, RangeError),
        ({"Q": [1.0, 1.0]}, ShapeError),
        ({"Q": -np.eye(4)}, RangeError),
        ({"R": [[1.0, 0.5], [0.0, 1.0]]}, RangeError),
        ({"plant": {"actuation": taut.drives.Actuation(delay=0.002)}}, UsageError),
        ({"at": [0.1]}, ShapeError),
    ],
)
def test_what_has_no_meaning_is_refused(options, kind):
    arm = taut.load_arm(options.get("arm", "planar2"))
    options = {name: value for name, value in options.items() if name != "arm"}
    if "plant" in options:
        options = {"plant": taut.RigidPlant(arm, **options["plant"])}
    with refused(kind):
        taut.analysis.lqr(arm, **{"Q": np.eye(4), "R": 1.0, **options})


def test_a_law_of_another_size_is_refused():
    with refused(ShapeError):
        taut.laws.StateFeedback(K_q=np.zeros((2, 3)), K_v=np.eye(2), tau_0=0.0)
    law = taut.laws.StateFeedback(K_q=np.eye(3), K_v=np.eye(3), tau_0=0.0)
    with pytest.raises(taut.TautError):
        taut.compile(law, taut.load_arm("planar2"))
