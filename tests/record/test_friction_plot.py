"""Curves of friction: figure 10.14 with what is held at rest."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from test_plot import assert_legible

from taut import Friction
from taut.errors import RangeError, ShapeError, UsageError
from taut.record.friction_plot import plot_friction

LAWS = {
    "(a) viscous": Friction(viscous=0.8),
    "(b) Coulomb": Friction(coulomb=0.6),
    "(c) static and viscous": Friction(viscous=0.4, coulomb=0.6),
    "(d) static and kinetic": Friction(coulomb=0.6, static=1.0),
    "(e) static, kinetic, viscous": Friction(viscous=0.4, coulomb=0.6, static=1.0),
    "(f) Stribeck effect": Friction(viscous=0.4, coulomb=0.6, static=1.0, stribeck=0.15),
}
# Drawn torque at v = 1 rad/s and just beside rest, and the torque that rest can hold.
SEEN = {
    "(a) viscous": (0.8, 0.0, None),
    "(b) Coulomb": (0.6, 0.6, 0.6),
    "(c) static and viscous": (1.0, 0.6, 0.6),
    "(d) static and kinetic": (0.6, 0.6, 1.0),
    "(e) static, kinetic, viscous": (1.0, 0.6, 1.0),
    "(f) Stribeck effect": (1.0, 1.0, 1.0),
}


def panel(figure: Figure, title: str) -> Axes:
    return next(ax for ax in figure.axes if ax.get_title(loc="left") == title)


def curves(ax: Axes, kind: str) -> list[Any]:
    return [line for line in ax.lines if line.get_label() == kind]


class TestFigure1014:
    @pytest.mark.parametrize("title", LAWS)
    def test_each_panel_is_its_law(self, title: str) -> None:
        fast, slow, hold = SEEN[title]
        ax = panel(plot_friction(LAWS, speed=1.0), title)
        left, right = curves(ax, "in motion")
        for curve, sign in ((left, -1.0), (right, 1.0)):
            v, f = np.asarray(curve.get_xdata()), np.asarray(curve.get_ydata())
            assert (v * sign > 0.0).all()
            order = np.argsort(np.abs(v))
            assert f[order[-1]] == pytest.approx(sign * fast)
            assert f[order[0]] == pytest.approx(sign * slow, abs=1e-6)
        upright = curves(ax, "at rest: any value between")
        assert len(upright) == (0 if hold is None else 1)
        for line in upright:
            assert line.get_xdata().tolist() == [0.0, 0.0]
            assert line.get_ydata().tolist() == [-hold, hold]

    def test_it_is_legible(self) -> None:
        assert_legible(plot_friction(LAWS, speed=1.0))

    def test_the_panels_have_one_scale(self) -> None:
        figure = plot_friction(LAWS, speed=1.0)
        assert len({ax.get_ylim() for ax in figure.axes}) == 1


def test_no_friction_is_a_line_on_the_axis() -> None:
    figure = plot_friction({"a": Friction()})
    assert np.concatenate([line.get_ydata() for line in curves(figure.axes[0], "in motion")]).any() == np.False_


def test_what_cannot_be_drawn_is_told() -> None:
    for wrong in ([Friction()], {"a": 1.0}):
        with pytest.raises(UsageError, match=r"takes a taut\.Friction by each title"):
            plot_friction(wrong)  # type: ignore[arg-type]
    with pytest.raises(ShapeError, match="'a' must be the friction of one joint"):
        plot_friction({"a": Friction(coulomb=[0.1, 0.2])})
    for count in (0, 13):
        with pytest.raises(UsageError, match=f"a figure has 1 to 12 panels of friction; got {count}"):
            plot_friction({str(i): Friction() for i in range(count)})
    with pytest.raises(RangeError, match=r"speed must be > 0 \[rad/s\]; got 0.0"):
        plot_friction({"a": Friction()}, speed=0.0)
