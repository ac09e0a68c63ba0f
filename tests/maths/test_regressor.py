"""The dynamics along a reference, the momentum and the regressor: against M, C and g, which other engines check."""

from __future__ import annotations

import numpy as np
import pytest

import taut
from taut.base.types import Float64Array
from taut.maths import regressor as rg
from taut.maths.model import Model, PayloadValues, model_of

NAMES = ["planar2", "gantry3", "panda", "ur10", "xarm7", "z1"]
TIGHT = 1e-12


def case(name: str, seed: int = 0) -> tuple[taut.Arm, Float64Array]:
    arm = taut.load_arm(name).with_payload(1.3, com=[0.02, -0.03, 0.05], inertia=[2e-3, 3e-3, 4e-3, 1e-4, 0, 0])
    arm = arm.with_joints(rotor_inertia=0.05, gear=50.0)
    return arm, np.random.default_rng(seed).standard_normal((5, arm.n))


def parameters(arm: taut.Arm, model: Model) -> Float64Array:
    """(n, 10) of the arm's own bodies and its payload."""
    links = list(model.links)
    body, R, p = model.placement(None)
    links[body] = links[body] + PayloadValues.of(arm.payload).body().seen_from(R, p)
    return np.array([rg.parameters_of(link) for link in links])


@pytest.mark.parametrize("name", NAMES)
def test_dynamics_along_a_reference_are_those_of_christoffel(name: str) -> None:
    arm, (q, v, v_ref, a, _) = case(name)
    x = taut.snapshot(arm, q, v)
    wanted = x.M @ a + x.C @ v_ref + x.g
    np.testing.assert_allclose(x.inverse_dynamics(a, v_ref), wanted, rtol=TIGHT, atol=TIGHT * np.abs(wanted).max())
    np.testing.assert_allclose(x.inverse_dynamics(a, v), x.inverse_dynamics(a), rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("name", NAMES)
def test_momentum_and_its_rate(name: str) -> None:
    arm, (q, v, *_) = case(name)
    x = taut.snapshot(arm, q, v)
    np.testing.assert_allclose(x.momentum, x.M @ v, rtol=TIGHT, atol=TIGHT)
    np.testing.assert_allclose(x.CT_v, x.C.T @ v, rtol=TIGHT, atol=TIGHT)


@pytest.mark.parametrize("name", NAMES)
def test_the_regressor_gives_the_torques_of_the_arms_own_parameters(name: str) -> None:
    arm, (q, v, v_ref, a, s) = case(name)
    model, x = model_of(arm), taut.snapshot(arm, q, v)
    pi, rotors = parameters(arm, model), arm.rotor_inertia * a
    Y = rg.regressor(model, q, v, a)
    np.testing.assert_allclose(Y @ pi.ravel() + rotors, x.inverse_dynamics(a), rtol=1e-11, atol=1e-11)
    y = rg.reference_covectors(model, q, v, v_ref, a, s)
    assert np.sum(y * pi) + s @ rotors == pytest.approx(s @ x.inverse_dynamics(a, v_ref), rel=1e-11)


@pytest.mark.parametrize(("name", "rank"), [("planar2", 6), ("ur5", 36), ("panda", 43)])
def test_as_many_base_parameters_as_the_literature_has(name: str, rank: int) -> None:
    model, rng = model_of(taut.load_arm(name)), np.random.default_rng(2)
    stacked = np.vstack([rg.regressor(model, *rng.standard_normal((3, model.n))) for _ in range(30)])
    assert np.linalg.matrix_rank(stacked, tol=1e-9 * np.linalg.norm(stacked)) == rank


def test_the_pseudo_inertia_and_back() -> None:
    arm, _ = case("panda")
    rng = np.random.default_rng(3)
    for pi in parameters(arm, model_of(arm)):
        P, y = rg.pseudo_inertia(pi), rng.standard_normal(10)
        np.testing.assert_allclose(P, P.T)
        np.testing.assert_allclose(rg.of_pseudo_inertia(P), pi, atol=1e-15)
        assert np.trace(rg.covector_matrix(y) @ P) == pytest.approx(y @ pi)
    assert np.linalg.eigvalsh(rg.pseudo_inertia(parameters(arm, model_of(arm))[-1]))[0] > 0.0


class Momenta(taut.Law):
    """All of it in one law, to trace."""

    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        y = rg.reference_covectors(x.model, x.q, x.v, ref.v, ref.a, ref.q)
        return taut.Torque(p=x.momentum, rate=x.CT_v, reference=x.inverse_dynamics(ref.a, ref.v), y=y @ np.ones(10))


@pytest.mark.parametrize("name", ["planar2", "panda"])
def test_a_law_of_it_runs_compiled_as_on_floats(name: str) -> None:
    arm, (q, v, v_ref, a, s) = case(name)
    ref = taut.JointMotion(q=s, v=v_ref, a=a)
    tau = [taut.compile(Momenta(), arm, engine=engine).step(q, v, ref) for engine in ("native", "float")]  # type: ignore[arg-type]
    np.testing.assert_allclose(*tau, rtol=1e-10, atol=1e-10)
