"""The impulses of rigid contacts: they fulfil the laws of contact and of friction."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
import pytest

from taut.base.types import Float64Array
from taut.maths.constraints.impulses import Touch, contact_impulses, held_impulses

Array = Float64Array


def mobility(rng: np.random.Generator, m: int, n: int) -> Array:
    """B M^-1 B^T of m rows of an arm with n joints."""
    B, root = rng.standard_normal((m, n)), rng.standard_normal((n, n))
    out: Array = B @ np.linalg.inv(root @ root.T + 0.3 * np.eye(n)) @ B.T
    return out


def violation(W: Array, r: Array, p: Array, touches: list[Touch], mu: list[float]) -> float:
    """By how much the laws of contact are missed, against the size of the velocities."""
    u, worst = r + W @ p, 0.0
    for touch, friction in zip(touches, mu, strict=True):
        i = touch.normal
        if touch.one_sided:
            worst = max(worst, -u[i], -p[i] * W[i, i], min(abs(u[i]), abs(p[i]) * W[i, i]))
        else:
            worst = max(worst, abs(u[i]))
        if not touch.tangents:
            continue
        t, most = list(touch.tangents), friction * abs(p[i])
        force, slip = p[t], u[t]
        size = np.trace(W[np.ix_(t, t)])
        worst = max(worst, (np.linalg.norm(force) - most) * size)
        if np.linalg.norm(slip) > 1e-9 * np.abs(r).max():  # what slides is braked by all of it, and straight
            worst = max(worst, float(np.abs(force + most * slip / np.linalg.norm(slip)).max()) * size)
    return worst / float(np.abs(r).max())


@pytest.mark.part(1)
@pytest.mark.parametrize("one_sided", [True, False])
def test_one_contact_sticks_slides_or_opens_as_the_laws_say(one_sided: bool) -> None:
    rng = np.random.default_rng(3)
    touch, seen = Touch(normal=0, one_sided=one_sided, tangents=(1, 2)), set()
    for _ in range(400):
        W, r, mu = mobility(rng, 3, 6) + np.eye(3), rng.standard_normal(3), float(rng.uniform(0.0, 1.0))
        if mu * np.linalg.norm(W[0, 1:]) > 0.4 * W[0, 0]:
            continue  # near to where rigid bodies jam, and have no one answer
        p = contact_impulses(W, r, [touch], [mu], [True], np.zeros(3))
        assert violation(W, r, p, [touch], [mu]) < 1e-9
        slides = np.linalg.norm((r + W @ p)[1:]) > 1e-9
        seen.add("opens" if p[0] == 0.0 else "slides" if slides else "sticks")
    assert seen >= {"slides", "sticks"} | ({"opens"} if one_sided else set())


def test_where_all_directions_slide_alike_the_answer_is_the_closed_form() -> None:
    W, r = np.diag([2.0, 0.5, 0.5]), np.array([-1.0, 3.0, -4.0])
    p = contact_impulses(W, r, [Touch(normal=0, one_sided=True, tangents=(1, 2))], [0.3], [True], np.zeros(3))
    np.testing.assert_allclose(p, [0.5, -0.15 * 0.6, 0.15 * 0.8], rtol=1e-10)


def test_without_friction_several_contacts_fulfil_the_complementarity_of_every_set_of_them() -> None:
    rng = np.random.default_rng(5)
    touches = [Touch(normal=i, one_sided=True) for i in range(4)]
    for _ in range(40):
        W, r = mobility(rng, 4, 6) + np.eye(4), rng.standard_normal(4)
        p = contact_impulses(W, r, touches, [0.0] * 4, [True] * 4, np.zeros(4))
        best = np.inf
        for closed in itertools.product([False, True], repeat=4):  # one of the sets is the answer
            on, want = list(np.flatnonzero(closed)), np.zeros(4)
            if on:
                want[on] = np.linalg.solve(W[np.ix_(on, on)], -r[on])
            if (want >= 0.0).all() and (r + W @ want >= -1e-12).all():
                best = min(best, float(np.abs(p - want).max() / max(1.0, np.abs(want).max())))
        assert best < 1e-9


@pytest.mark.part(2)
@pytest.mark.parametrize(
    ("count", "own", "mu"),
    [(2, 2.0, 0.3), (2, 0.3, 0.3), (2, 2.0, 0.8), (3, 2.0, 0.3), (4, 0.5, 0.3)],
    ids=["two", "coupled", "rough", "three", "four coupled"],
)
def test_several_contacts_with_friction_settle_on_the_laws_from_a_warm_start(
    count: int, own: float, mu: float, bar: Callable[[str, object], None]
) -> None:
    rng = np.random.default_rng(7)
    touches = [Touch(normal=3 * i, one_sided=True, tangents=(3 * i + 1, 3 * i + 2)) for i in range(count)]
    frictions, there, m, worst = [mu] * count, [True] * count, 3 * count, 0.0
    for _ in range(15):
        W = mobility(rng, m, max(9, m + 3)) + own * np.eye(m)
        r, p = rng.standard_normal(m), np.zeros(m)
        for _ in range(3):  # as a run does, step by step
            p = contact_impulses(W, r, touches, frictions, there, p)
        worst = max(worst, violation(W, r, p, touches, frictions))
    assert worst < 1e-9
    bar(f"contacts: laws missed by {count} contacts, own mobility {own}, mu {mu}", f"{worst:.1e}")


def test_rows_beside_a_contact_hold_as_long_as_it_touches() -> None:
    rng = np.random.default_rng(9)
    touch = Touch(normal=0, one_sided=True, beside=(1, 2))
    for sign in (-1.0, 1.0):
        W, r = mobility(rng, 3, 6) + 5.0 * np.eye(3), np.array([sign, 0.1, -0.2])
        p = contact_impulses(W, r, [touch], [0.0], [True], np.zeros(3))
        if sign > 0.0:
            assert not p.any()
        else:
            np.testing.assert_allclose(r + W @ p, 0.0, atol=1e-12)


def test_a_contact_that_is_not_there_gives_no_impulse() -> None:
    touch = Touch(normal=0, one_sided=True, tangents=(1, 2))
    assert not contact_impulses(np.eye(3), -np.ones(3), [touch], [0.5], [False], np.zeros(3)).any()


def test_corners_that_share_a_load_need_not_be_independent() -> None:
    corners = np.array([[1.0, x, y] for x in (-0.1, 0.1) for y in (-0.1, 0.1)])
    W = corners @ np.diag([1.0, 30.0, 30.0]) @ corners.T  # of rank 3
    touches = [Touch(normal=i, one_sided=True) for i in range(4)]
    p = contact_impulses(W, W @ np.full(4, -1.0), touches, [0.0] * 4, [True] * 4, np.zeros(4))
    np.testing.assert_allclose(corners.T @ p, corners.T @ np.ones(4), atol=1e-8)


def test_held_rows_are_stopped_and_the_others_get_nothing() -> None:
    W, u = mobility(np.random.default_rng(1), 3, 5), np.array([1.0, -2.0, 0.5])
    p = held_impulses(W, u, [True, False, np.bool_(True)])
    assert p[1] == 0.0
    np.testing.assert_allclose((u + W @ p)[[0, 2]], 0.0, atol=1e-9)
