"""Random states by the thousand, on every arm: whole in `make bars`, a seeded tenth in `make test`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from law_oracles import LAWS, NAMES, NATIVE, PI_LAWS, PINOCCHIO, OnPinocchio, loaded

import taut
from taut.base.types import Float64Array

pytestmark = pytest.mark.bars
Bar = Callable[[str, object], None]
Share = Callable[[int], int]


def random_states(arm: taut.Arm, count: int, seed: int) -> list[tuple[Float64Array, Float64Array, taut.JointMotion]]:
    """Anywhere within the limits, up to 5 rad/s, after references that may be anything near."""
    rng = np.random.default_rng(seed)
    low = np.where(np.isfinite(arm.lower), arm.lower, -np.pi)
    high = np.where(np.isfinite(arm.upper), arm.upper, np.pi)
    n, states = arm.n, []
    for _ in range(count):
        q = rng.uniform(low, high)
        ref = taut.JointMotion(q=q + 0.2 * rng.standard_normal(n), v=rng.standard_normal(n), a=rng.standard_normal(n))
        states.append((q, rng.uniform(-5.0, 5.0, n), ref))
    return states


def test_native_code_against_plain_python(share: Share, bar: Bar) -> None:
    """Every law on every arm: 40 ticks each, memory included; in the normal run each law on a third of the arms."""
    worst, ticks, every = 0.0, 0, 3 // share(3)
    for a, name in enumerate(NAMES):
        arm = loaded(name)
        for b, make in list(enumerate(LAWS.values()))[a % every :: every]:
            law = make(arm.n)
            native, plain = (taut.compile(law, arm, engine=engine) for engine in ("native", "float"))  # type: ignore[arg-type]
            error, largest = 0.0, 0.0
            for q, v, ref in random_states(arm, share(40), 100 * a + b):
                wanted, got = plain.step(q, v, ref), native.step(q, v, ref)
                error, largest = max(error, np.abs(got - wanted).max()), max(largest, np.abs(wanted).max())
                ticks += 1
            worst = max(worst, float(error / largest))
    bar(
        f"native code against plain Python, {len(NAMES)} arms x {len(LAWS)} laws, {ticks} ticks",
        f"{worst:.1e}",
    )
    assert worst <= NATIVE


def test_native_code_against_pinocchio(share: Share, bar: Bar) -> None:
    """The same laws written with Pinocchio, on every arm: 5000 states each."""
    worst, ticks = 0.0, 0
    for a, name in enumerate(NAMES):
        arm = loaded(name)
        oracle, turns = OnPinocchio(arm), np.isin(np.arange(arm.n), arm.continuous)
        for b, (ours, theirs) in enumerate(PI_LAWS.values()):
            ctrl, e_int = taut.compile(ours, arm), np.zeros(arm.n)
            for q, v, ref in random_states(arm, share(5000), 100 * a + b):
                e = ref.q - q
                e = np.where(turns, (e + np.pi) % (2.0 * np.pi) - np.pi, e)
                e_int = e_int + e * ctrl.dt
                wanted, got = theirs(oracle, q, v, ref, e, e_int), ctrl.step(q, v, ref)
                worst, ticks = max(worst, float(np.abs(got - wanted).max() / np.abs(wanted).max())), ticks + 1
    bar(f"native code against Pinocchio, {len(NAMES)} arms x {len(PI_LAWS)} laws, {ticks} ticks", f"{worst:.1e}")
    assert worst <= PINOCCHIO


@pytest.mark.long
def test_forward_dynamics_undoes_inverse_dynamics(share: Share, bar: Bar) -> None:
    """Inverse dynamics of what forward dynamics gives, relative to the largest torque: 2000 states of each arm."""
    worst, states = 0.0, 0
    for k, name in enumerate(NAMES):
        arm = loaded(name)
        model = taut.snapshot(arm, arm.home).model

        def there_and_back(q: Any, v: Any, tau: Any, model: Any = model) -> Any:
            a = taut.dynamics.forward_dynamics(model, q, v, tau)
            return taut.dynamics.inverse_dynamics(model, q, v, a)

        bias = taut.native(lambda q, v, model=model: taut.dynamics.bias(model, q, v), q=arm.n, v=arm.n)
        run = taut.native(there_and_back, q=arm.n, v=arm.n, tau=arm.n)
        rng = np.random.default_rng(k)
        for q, v, _ in random_states(arm, share(2000), k):
            tau = 10.0 * rng.standard_normal(arm.n)
            got, h = run(q, v, tau), bias(q, v)
            scale = max(np.abs(tau).max(), np.abs(h).max())
            worst, states = max(worst, float(np.abs(got - tau).max() / scale)), states + 1
    bar(f"forward after inverse dynamics, {len(NAMES)} arms, {states} states", f"{worst:.1e}")
    assert worst <= 1e-9
