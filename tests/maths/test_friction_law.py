"""The law of friction: against its formulas, in all six laws of figure 10.14, at the points where a NaN could be born."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refused

from taut import Friction
from taut import math as tm
from taut.base.types import Float64Array
from taut.errors import ShapeError
from taut.maths.friction import FrictionValues, dry_limit, friction_torque, stribeck_share
from taut.trace.graph import Graph
from taut.trace.scalar import Scalar, tracing

SAME = 1e-14  # the same formula in another order, relative
TINY, HUGE = 5e-324, 1e150
SPEEDS = (0.0, TINY, -TINY, 1e-9, 0.02, -0.02, 0.1, -0.1, 3.0, -3.0, HUGE, -HUGE)

# Figure 10.14, panel by panel: the friction, and the torque that opposes a speed v > 0.
FIGURE: dict[str, tuple[Friction, Callable[[float], float]]] = {
    "a": (Friction(viscous=0.4), lambda v: 0.4 * v),
    "b": (Friction(coulomb=0.7), lambda v: 0.7),
    "c": (Friction(viscous=0.4, coulomb=0.7), lambda v: 0.7 + 0.4 * v),
    "d": (Friction(coulomb=0.7, static=1.1), lambda v: 0.7),
    "e": (Friction(viscous=0.4, coulomb=0.7, static=1.1), lambda v: 0.7 + 0.4 * v),
    "f": (
        Friction(viscous=0.4, coulomb=0.7, static=1.1, stribeck=0.1),
        lambda v: 0.7 + 0.4 * math.exp(-((v / 0.1) ** 2)) + 0.4 * v,
    ),
}
BREAK_AWAY = {"a": 0.0, "b": 0.7, "c": 0.7, "d": 1.1, "e": 1.1, "f": 1.1}

EVERYTHING = Friction(
    viscous=[0.4, 0.0, 0.1],
    coulomb=[0.7, 0.1, 0.0],
    static=[1.1, 0.1, 0.5],
    stribeck=[0.1, 0.0, 0.3],
    stribeck_shape=[2.0, 1.0, 0.7],
    load_motor=[0.05, 0.0, 0.1],
    load_external=[0.02, 0.3, 0.1],
    load_motor_static=[0.3, 0.1, 0.1],
    load_external_static=[0.02, 0.4, 0.6],
)


def by_hand(i: int, v: float, motor: float, load: float, *, rest: bool) -> float:
    """Dry friction of joint i of EVERYTHING, from the formulas of the docstring, one number at a time."""
    f = {name: float(np.asarray(getattr(EVERYTHING, name))[i]) for name in FrictionValues.names(EVERYTHING)}
    if rest:
        s = 1.0
    elif f["stribeck"] == 0.0:
        s = 0.0
    else:
        s = math.exp(-min((abs(v) / f["stribeck"]) ** f["stribeck_shape"], 700.0)) if abs(v) < 1e3 else 0.0
    moving = abs(f["load_external"] * load - f["load_motor"] * motor)
    excess_external = f["load_external_static"] - f["load_external"]
    excess_motor = f["load_motor_static"] - f["load_motor"]
    excess = abs(excess_external * load - excess_motor * motor)
    return f["coulomb"] + s * (f["static"] - f["coulomb"]) + moving + s * excess


@pytest.mark.parametrize("panel", FIGURE)
class TestFigure1014:
    def test_in_motion_it_is_the_curve_that_is_drawn(self, panel: str) -> None:
        friction, curve = FIGURE[panel]
        for v in (1e-6, 0.01, 0.1, 0.5, 20.0):
            for sign in (1.0, -1.0):
                f = friction_torque(FrictionValues.fixed(friction), np.array([sign * v]))
                assert f[0] == pytest.approx(-sign * curve(v), rel=SAME)

    def test_at_rest_it_holds_up_to_the_break_away_torque(self, panel: str) -> None:
        d = dry_limit(FrictionValues.fixed(FIGURE[panel][0]), np.zeros(1), np.array([True]))
        assert d.tolist() == [BREAK_AWAY[panel]]

    def test_the_curve_alone_says_nothing_about_rest(self, panel: str) -> None:
        assert friction_torque(FrictionValues.fixed(FIGURE[panel][0]), np.zeros(1)).tolist() == [0.0]


@pytest.mark.parametrize("v", SPEEDS)
@pytest.mark.parametrize("rest", [True, False, None])
@pytest.mark.parametrize(("motor", "load"), [(0.0, 0.0), (2.0, -2.0), (-1.0, 3.0), (0.0, -5.0)])
def test_it_is_the_formula_joint_by_joint(v: float, rest: bool | None, motor: float, load: float) -> None:
    values = FrictionValues.fixed(EVERYTHING)
    at_rest = None if rest is None else np.full(3, rest)
    got = dry_limit(values, np.full(3, v), at_rest, np.full(3, motor), np.full(3, load))
    wanted = [by_hand(i, v, motor, load, rest=bool(rest)) for i in range(3)]
    np.testing.assert_allclose(got, wanted, rtol=SAME, atol=0.0)


@pytest.mark.parametrize("v", SPEEDS)
def test_neither_the_limit_nor_its_derivative_is_ever_nan(v: float) -> None:
    values = FrictionValues.fixed(EVERYTHING)

    def limit(x: Any) -> Any:
        return dry_limit(values, x[:3], x[:3] == 0.0, x[3:6], x[6:])

    point = np.array([v, v, v, 1.0, 0.0, -1.0, 0.0, 0.0, 2.0])
    assert np.isfinite(limit(point)).all()
    assert np.isfinite(tm.jacobian(limit, point)).all()


def test_the_derivative_by_speed_is_that_of_the_formula() -> None:
    values = FrictionValues.fixed(Friction(coulomb=0.7, static=1.1, stribeck=0.1, stribeck_shape=[2.0, 1.3]))
    for v in (0.03, -0.2):
        got = np.diag(tm.jacobian(lambda x: dry_limit(values, x), np.array([v, v])))
        x = abs(v) / 0.1
        wanted = [-math.copysign(0.4 * math.exp(-(x**p)) * p * x ** (p - 1.0) / 0.1, v) for p in (2.0, 1.3)]
        np.testing.assert_allclose(got, wanted, rtol=1e-12)


@settings(max_examples=200, deadline=None, derandomize=True)
@given(
    v=st.floats(-1e6, 1e6),
    stribeck=st.floats(0.0, 1e3),
    shape=st.floats(1e-3, 50.0),
    tau=st.floats(-100.0, 100.0),
)
def test_dry_friction_lies_between_that_in_motion_and_that_at_rest(
    v: float, stribeck: float, shape: float, tau: float
) -> None:
    friction = Friction(
        coulomb=0.3,
        static=0.9,
        stribeck=stribeck,
        stribeck_shape=shape,
        load_motor=0.1,
        load_external=0.1,
        load_motor_static=0.4,
    )
    values = FrictionValues.fixed(friction)
    at = {"tau_motor": np.array([tau]), "tau_load": np.array([-tau])}
    d = float(dry_limit(values, np.array([v]), **at)[0])
    rest = float(dry_limit(values, np.array([v]), np.array([True]), **at)[0])
    moving = 0.3 + 0.2 * abs(tau)
    assert moving * (1.0 - SAME) <= d <= rest * (1.0 + SAME)
    assert rest == pytest.approx(0.9 + (0.2 + 0.3) * abs(tau), rel=1e-12)


def test_a_load_at_rest_counts_with_both_its_sides() -> None:
    """The motor pulls against the load, so that |load_external tau_load - load_motor tau_motor| has their sum."""
    values = FrictionValues.fixed(Friction(load_motor=0.1, load_external=0.1))
    assert dry_limit(values, np.zeros(1), None, np.array([3.0]), np.array([-3.0]))[0] == pytest.approx(0.6)


class TestWhatIsThere:
    """A field is there only where it says something; else no code is made for it."""

    @pytest.mark.parametrize(
        ("friction", "there"),
        [
            (Friction(), ()),
            (Friction(viscous=[0.0, 0.1]), ("viscous",)),
            (Friction(coulomb=1.0, static=1.0, stribeck=0.3), ("coulomb",)),
            (Friction(static=1.0), ("static",)),
            (Friction(coulomb=[1.0, 2.0], static=[1.0, 3.0]), ("coulomb", "static")),
            (Friction(static=1.0, stribeck=0.1, stribeck_shape=2.0), ("static", "stribeck")),
            (Friction(static=1.0, stribeck=0.1, stribeck_shape=1.0), ("static", "stribeck", "stribeck_shape")),
            (Friction(load_motor=0.1, load_motor_static=0.1), ("load_motor",)),
            (Friction(load_external_static=0.1, stribeck=0.1), ("stribeck", "load_external_static")),
        ],
    )
    def test_only_what_says_something(self, friction: Friction, there: tuple[str, ...]) -> None:
        assert FrictionValues.names(friction) == there
        values = FrictionValues.fixed(friction)
        assert (values.dry, values.loaded, values.falls) == (friction.dry, friction.loaded, friction.falls)

    def test_what_is_not_there_is_not_looked_up(self) -> None:
        only = {"coulomb": np.array([2.0])}
        assert dry_limit(FrictionValues.of(only, Friction(coulomb=1.0)), np.ones(1)).tolist() == [2.0]
        with pytest.raises(KeyError, match="static"):
            FrictionValues.of(only, Friction(coulomb=1.0, static=1.5))

    def test_a_value_of_run_time_may_become_zero(self) -> None:
        given = {"static": np.ones(2), "stribeck": np.array([0.0, 0.1])}
        s = stribeck_share(FrictionValues.of(given, Friction(static=1.0, stribeck=0.1)), np.full(2, 0.1))
        np.testing.assert_allclose(s, [0.0, math.exp(-1.0)], rtol=SAME)

    @pytest.mark.parametrize(
        ("friction", "most"),
        [(Friction(coulomb=1.0), 2), (Friction(static=1.0), 6), (Friction(static=1.0, stribeck=0.1), 15)],
    )
    def test_the_traced_code_is_lean(self, friction: Friction, most: int) -> None:
        graph = Graph()
        v, rest = Scalar(graph, graph.input()), Scalar(graph, graph.input())
        with tracing(graph):
            dry_limit(FrictionValues.fixed(friction), tm.array([v]), tm.array([rest > 0.5]))
        assert len(graph.ops) - 2 <= most


def test_numbers_and_symbols_give_the_same() -> None:
    values = FrictionValues.fixed(EVERYTHING)

    def limit(x: Any) -> Any:
        return dry_limit(values, x[:3], x[:3] == 0.0, x[3:], -x[3:])

    for v in (0.0, 0.05, -2.0):
        x: Float64Array = np.array([v, v, 2.0 * v, 1.0, 2.0, 3.0])
        graph = Graph()
        entries = [Scalar(graph, graph.input()) for _ in x]
        with tracing(graph):
            nodes = [
                entry.node if isinstance(entry, Scalar) else graph.const(entry) for entry in limit(tm.array(entries))
            ]
        np.testing.assert_allclose(graph.evaluate(nodes, x.tolist()), limit(x), rtol=SAME)


MISTAKES: dict[str, Callable[[], object]] = {
    "nothing": lambda: Friction(coulomb=None),  # type: ignore[arg-type]
    "no numbers": lambda: Friction(viscous=[]),
    "two sizes": lambda: Friction(viscous=[1.0, 1.0], coulomb=[0.5, 0.5, 0.5]),
    "two sizes at rest": lambda: Friction(coulomb=[0.5, 0.5], static=[1.0, 1.0, 1.0]),
    "two sizes of one": lambda: Friction(coulomb=[0.5], load_motor=[0.1, 0.1]),
}  # fmt: skip


@pytest.mark.parametrize("name", MISTAKES)
def test_friction_of_joints_is_numbers_for_the_same_joints(name: str) -> None:
    make = MISTAKES[name]
    with refused(ShapeError):
        make()
