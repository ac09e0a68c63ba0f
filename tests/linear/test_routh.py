"""Routh's table counts the roots of polynomials whose roots are known, special cases included."""

from __future__ import annotations

import numpy as np
import pytest

import taut

FACTORS = (  # polynomial, roots to the right, roots on the axis
    ([1, 3], 0, 0), ([1, -2], 1, 0), ([1, 0], 0, 1), ([1, 2, 5], 0, 0), ([1, -1, 4], 2, 0),
    ([1, 0, 4], 0, 2), ([1, 0, -9], 1, 0), ([1, 0, 1], 0, 2), ([1, 1], 0, 0),
)  # fmt: skip


def test_it_counts_the_roots_of_products_of_known_factors() -> None:
    rng = np.random.default_rng(3)
    mended = 0
    for _ in range(400):
        product, right, on_axis = np.ones(1), 0, 0
        for k in rng.integers(0, len(FACTORS), rng.integers(1, 5)):
            factor, more_right, more_on_axis = FACTORS[k]
            product = np.polymul(product, factor)
            right, on_axis = right + more_right, on_axis + more_on_axis
        table = taut.analysis.routh(rng.choice([-2.0, 0.5, 1.0]) * product)
        mended += any(row.note for row in table.rows)
        assert (table.right, table.on_axis) == (right, on_axis), product
    assert mended > 100  # special cases are among them


def test_it_agrees_with_the_roots_of_random_polynomials_of_small_whole_numbers() -> None:
    rng = np.random.default_rng(4)
    headless = 0
    for _ in range(400):
        given = rng.integers(-2, 3, size=rng.integers(3, 9)).astype(float)
        given[0] = given[0] or 1.0
        roots = np.roots(given)
        if np.abs(roots.real).min(initial=1.0) < 1e-3:
            continue
        table = taut.analysis.routh(given)
        headless += any(row.note.startswith("it began") for row in table.rows)
        assert (table.right, table.on_axis) == (int((roots.real > 0.0).sum()), 0), given
    assert headless > 20


def test_of_third_order_it_is_the_chapters_rule() -> None:
    """a2 a1 > a3 a0, and on the border a pair on the axis."""
    assert taut.analysis.routh([1.0, 2.0, 3.0, 5.999]).stable
    assert not taut.analysis.routh([1.0, 2.0, 3.0, 6.001]).stable
    at_the_border = taut.analysis.routh([1.0, 2.0, 3.0, 6.0])
    assert (at_the_border.right, at_the_border.on_axis, at_the_border.stable) == (0, 2, False)


def test_a_high_order_with_a_double_pair_on_the_axis() -> None:
    product = np.polymul(np.polymul([1, 0, 4], [1, 0, 4]), np.poly(-np.arange(1.0, 6.0)))
    table = taut.analysis.routh(product)
    assert (table.right, table.on_axis) == (0, 4)


def test_its_content_is_the_table_with_what_was_done() -> None:
    found = taut.analysis.routh([1.0, 1.0, 2.0, 2.0, 3.0])
    (table,) = found.content().tables
    assert [row[:2] for row in table.rows] == [["s^4", 1.0], ["s^3", 1.0], ["s^2", -3.0], ["s^1", 3.0], ["s^0", 3.0]]
    assert [bool(row[-1]) for row in table.rows] == [False, False, True, False, False]
    assert found.content().faults


@pytest.mark.parametrize(
    ("given", "kind"),
    [
        ([1.0], taut.errors.ShapeError),
        ([0.0, 1.0], taut.errors.RangeError),
        ([1.0, np.nan], taut.errors.RangeError),
    ],
)
def test_what_is_no_polynomial_is_refused(given: list[float], kind: type[Exception]) -> None:
    with pytest.raises(kind):
        taut.analysis.routh(given)
