"""Every law on every arm: native code gives what plain Python gives, and what the same law gives on Pinocchio."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from law_oracles import LAWS, NAMES, NATIVE, PI_LAWS, PINOCCHIO, OnPinocchio, loaded

import taut
from taut.base.types import Float64Array


def states(arm: taut.Arm) -> list[tuple[Float64Array, Float64Array, taut.JointMotion]]:
    """Positions, velocities and references: random, at rest, stretched out, folded up, far away."""
    rng = np.random.default_rng(0)
    low = np.where(np.isfinite(arm.lower), arm.lower, -np.pi)
    high = np.where(np.isfinite(arm.upper), arm.upper, np.pi)
    zero, far = np.zeros(arm.n), 200.0 * np.pi * (np.array(arm.units) == "rad")
    positions = [
        rng.uniform(low, high),
        rng.uniform(low, high),
        zero,
        low,
        high,
        np.full(arm.n, np.pi / 2),
        far,
        arm.home,
    ]
    speeds = [rng.standard_normal(arm.n) for _ in positions]
    speeds[2], speeds[3] = zero, 20.0 * speeds[3]
    return [
        (q, v, taut.JointMotion(q=q + 0.1 * rng.standard_normal(arm.n), v=rng.standard_normal(arm.n), a=speeds[k]))
        for k, (q, v) in enumerate(zip(positions, speeds, strict=True))
    ]


@pytest.mark.part(2)
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("name", NAMES)
def test_native_code_agrees_with_plain_python(name: str, law: str) -> None:
    arm = loaded(name)
    torque = law != "VelocityPI"
    even = (NAMES.index(name) + list(LAWS).index(law)) % 2 == 0  # half of the matrix one way, half the other
    options: dict[str, Any] = {
        "limits": taut.Limits(tau=30.0, tau_dot=np.linspace(2e4, 4e4, arm.n)) if torque and even else None,
        "sensing": taut.Sensing(velocity="measured" if even else "difference"),
    }
    native, plain = (taut.compile(LAWS[law](arm.n), arm, engine=e, **options) for e in ("native", "float"))  # type: ignore[arg-type]
    for q, v, ref in states(arm):
        measured = (q, v, ref) if even else (q, ref)
        wanted, got = plain.step(*measured), native.step(*measured)
        wanted_terms, got_terms = plain.terms, native.terms
        scale = max(1.0, *(np.abs(term).max() for term in wanted_terms.values()))
        np.testing.assert_allclose(got, wanted, rtol=0.0, atol=NATIVE * scale)
        assert list(got_terms) == list(wanted_terms)
        for term, value in wanted_terms.items():
            np.testing.assert_allclose(got_terms[term], value, rtol=0.0, atol=NATIVE * scale)
        np.testing.assert_allclose(sum(got_terms.values()), got, rtol=0.0, atol=NATIVE * scale)


@pytest.mark.part(1)
@pytest.mark.parametrize("law", PI_LAWS)
@pytest.mark.parametrize("name", NAMES)
def test_the_law_written_on_pinocchio_gives_the_same_torques(name: str, law: str) -> None:
    arm, (ours, theirs) = loaded(name), PI_LAWS[law]
    ctrl, oracle = taut.compile(ours, arm), OnPinocchio(arm)
    e_int = np.zeros(arm.n)
    turns = np.array([i in arm.continuous for i in range(arm.n)])
    for q, v, ref in states(arm):
        e = ref.q - q
        e = np.where(turns, (e + np.pi) % (2.0 * np.pi) - np.pi, e)
        e_int = e_int + e * ctrl.dt
        wanted = theirs(oracle, q, v, ref, e, e_int)
        got = ctrl.step(q, v, ref)
        np.testing.assert_allclose(got, wanted, rtol=0.0, atol=PINOCCHIO * np.abs(wanted).max())
