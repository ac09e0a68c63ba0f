"""Noise from a counter: the published words, normal numbers, the same bits in each engine and however it is cut."""

from __future__ import annotations

import math

import numpy as np
import pytest

from taut.base.types import Float64Array
from taut.codegen import noise as made
from taut.codegen.noise import MAX_SEED, Noise, noise_block, philox
from taut.codegen.program import Block

INPUTS = Block.of({"t": (), "noise.q": (7,), "ref.q": (7,), "noise.F_ext": (6,), "noise.a_tip": (3,)})
NOISY = [i for f in INPUTS.fields if f.path.startswith("noise.") for i in range(f.offset, f.offset + f.size)]


def rows(engine: str, first: int, count: int, seed: int, inputs: Block = INPUTS) -> Float64Array:
    out = np.full((count, inputs.size), 0.25)
    Noise(inputs, engine).fill(out, first, seed)  # type: ignore[arg-type]
    return out


@pytest.mark.parametrize(
    ("keys", "counter", "words"),
    [
        ((0, 0), (0, 0, 0, 0), (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
        ((2**32 - 1,) * 2, (2**32 - 1,) * 4, (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)),
        (
            (0xA4093822, 0x299F31D0),
            (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
            (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
        ),
    ],
)
def test_the_words_are_those_of_the_authors(
    keys: tuple[int, int], counter: tuple[int, int, int, int], words: tuple[int, ...]
) -> None:
    """kat_vectors of Random123."""
    assert tuple(int(word) for word in philox(keys, counter)) == words


def test_both_engines_give_the_same_bits() -> None:
    for seed in (0, 1, 2**32 - 1, 2**32, 123456789012345, MAX_SEED):
        for first, count in ((0, 1), (0, 257), (3, 5), (2**31 - 3, 8)):
            np.testing.assert_array_equal(rows("native", first, count, seed), rows("float", first, count, seed))


def test_numbers_depend_on_seed_tick_and_name_alone() -> None:
    whole = rows("native", 0, 100, 7)
    for first, end in ((0, 13), (13, 14), (14, 100)):
        np.testing.assert_array_equal(rows("native", first, end - first, 7), whole[first:end])
    alone = noise_block({"F_ext": (6,)})
    views = INPUTS.views(whole)
    np.testing.assert_array_equal(rows("native", 0, 100, 7, alone), views["noise.F_ext"])
    assert (views["t"] == 0.25).all()  # nothing else is written
    assert (views["ref.q"] == 0.25).all()


def test_two_words_are_two_normal_numbers() -> None:
    """Box and Muller with Python's own functions, at the ends of the words too."""
    rng = np.random.default_rng(0)
    u = np.concatenate([[0, 0, 2**32 - 1, 2**32 - 1, 2**31], rng.integers(0, 2**32, 2000)]).astype(float)
    w = np.concatenate([[0, 2**32 - 1, 0, 2**32 - 1, 2**30], rng.integers(0, 2**32, 2000)]).astype(float)
    radius = np.sqrt(-2.0 * np.log((u + 0.5) / 2.0**32))
    found, _ = made.two_normals(made.DOUBLE).evaluated([u, w])
    np.testing.assert_allclose(found[0], radius * np.cos(2.0 * math.pi * w / 2.0**32), rtol=0.0, atol=1e-14)
    np.testing.assert_allclose(found[1], radius * np.sin(2.0 * math.pi * w / 2.0**32), rtol=0.0, atol=1e-14)
    assert max(np.abs(found[0]).max(), np.abs(found[1]).max()) < 6.8


def test_they_are_standard_normal_and_independent() -> None:
    """Within five standard errors of moments, of the distribution function, and of correlations."""
    x = np.concatenate([rows("native", 0, 20_000, seed)[:, NOISY] for seed in (0, 1)], axis=1)
    k, n = x.shape
    assert np.abs(x.mean(axis=0)).max() < 5.0 / np.sqrt(k)
    assert np.abs(x.var(axis=0) - 1.0).max() < 5.0 * np.sqrt(2.0 / k)
    assert np.abs((x**3).mean(axis=0)).max() < 5.0 * np.sqrt(15.0 / k)
    assert np.abs((x**4).mean() - 3.0) < 5.0 * np.sqrt(96.0 / x.size)
    sorted_x = np.sort(x.ravel())
    normal = 0.5 * (1.0 + np.vectorize(math.erf)(sorted_x / math.sqrt(2.0)))
    assert np.abs(normal - np.arange(x.size) / x.size).max() < 1.95 / np.sqrt(x.size)  # Kolmogorov, 0.1 %
    for shift in (0, 1, 2):  # between channels and seeds, and from tick to tick
        together = x[shift:].T @ x[: k - shift] / k
        assert np.abs(together - (np.eye(n) if shift == 0 else 0.0)).max() < 5.0 / np.sqrt(k)
