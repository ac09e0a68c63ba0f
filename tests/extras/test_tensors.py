"""Batches on the arrays of torch, JAX and Warp: the same memory, the same bits."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import taut
from taut.errors import UsageError

jnp, torch, warp = (pytest.importorskip(name) for name in ("jax.numpy", "torch", "warp"))
ARM, N = taut.load_arm("ur5"), 37
RNG = np.random.default_rng(0)
Q = (ARM.home + 0.3 * RNG.standard_normal((N, ARM.n))).astype(np.float32)
V = (0.1 * RNG.standard_normal((N, ARM.n))).astype(np.float32)
GOAL = {"q": ARM.home.astype(np.float32), "v": np.zeros(ARM.n, np.float32), "a": np.zeros(ARM.n, np.float32)}


@pytest.fixture(scope="module")
def batch() -> Any:
    return taut.compile(taut.laws.ComputedTorque(kp=100.0, kd=20.0, ki=3.0), ARM).batch(N, real="float")


@pytest.fixture(scope="module")
def expected(batch: Any) -> Any:
    batch.reset()
    return batch.step(Q, V, GOAL).copy()


def test_torch_is_read_and_written_where_it_is(batch: Any, expected: Any) -> None:
    state = torch.zeros(N, 2 * ARM.n)  # as of a simulator whose arrays are views of one
    state[:, : ARM.n], state[:, ARM.n :] = torch.from_numpy(Q), torch.from_numpy(V)
    out, before = torch.zeros(N, ARM.n), state.data_ptr()
    batch.reset(torch.ones(N, dtype=torch.bool))
    ref = {name: torch.from_numpy(value) for name, value in GOAL.items()}
    assert batch.step(state[:, : ARM.n], state[:, ARM.n :], ref, out=out) is out
    np.testing.assert_array_equal(out.numpy(), expected)
    assert state.data_ptr() == before


def test_jax_is_read_and_never_written(batch: Any, expected: Any) -> None:
    batch.reset(jnp.ones(N, dtype=bool))
    np.testing.assert_array_equal(batch.step(jnp.asarray(Q), jnp.asarray(V), GOAL), expected)
    with pytest.raises(UsageError, match="read-only"):
        batch.step(Q, V, GOAL, out=jnp.zeros((N, ARM.n)))


def test_warp_is_read_and_written_through_its_memory(batch: Any, expected: Any) -> None:
    warp.config.quiet = True
    q, v = (warp.array(value, dtype=warp.float32, device="cpu") for value in (Q, V))
    out = warp.zeros((N, ARM.n), dtype=warp.float32, device="cpu")
    batch.reset()
    batch.step(q, v, GOAL, out=out.numpy())
    np.testing.assert_array_equal(out.numpy(), expected)


def test_gains_of_each_lane_may_be_tensors(batch: Any) -> None:
    kp = torch.linspace(50.0, 150.0, N)
    batch.parameters["law.kp"] = kp[:, None].expand(N, ARM.n) if batch.parameters["law.kp"].ndim else kp
    batch.reset()
    soft = batch.step(Q, V, GOAL)
    batch.parameters["law.kp"] = 100.0
    batch.reset()
    assert np.abs(soft - batch.step(Q, V, GOAL)).max() > 1.0


@pytest.mark.parametrize(
    "wrong",
    [
        torch.zeros(N, ARM.n, requires_grad=True),
        torch.zeros(N, ARM.n, dtype=torch.float64),
        torch.zeros(N, ARM.n, dtype=torch.bfloat16),
        torch.zeros(N, ARM.n, dtype=torch.int32),
        torch.zeros(N, ARM.n, device="meta"),
        torch.zeros(N, ARM.n).to_sparse(),
        torch.zeros(ARM.n, N).T,
    ],
    ids=["gradient", "double", "bfloat16", "whole numbers", "meta", "sparse", "transposed"],
)
def test_tensors_that_cannot_be_read_where_they_are_are_refused(batch: Any, wrong: Any) -> None:
    with pytest.raises(UsageError):
        batch.step(wrong, V, GOAL)
