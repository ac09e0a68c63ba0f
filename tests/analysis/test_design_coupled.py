"""Designs whose directions are coupled, by friction or by unlike gains: by the book is that of all joints together."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import taut

laws = taut.laws


@pytest.fixture(scope="module")
def arm() -> taut.Arm:
    """Held out: two links of unlike friction, which turn in a plane."""
    return taut.load_arm("planar2").with_gravity([0.0, 0.0, 0.0]).with_joints(viscous=[0.5, 2.0])


def settled(M: Any, C: Any, K: Any, column: Any, row: Any) -> float:
    """[s] from which on the error of M e_ddot + C e_dot + K e = 0 is within 2 %, by SciPy."""
    n = len(M)

    def rates(_: float, y: np.ndarray) -> np.ndarray:
        return np.concatenate([y[n:], -np.linalg.solve(M, C @ y[n:] + K @ y[:n])])

    found = solve_ivp(rates, (0.0, 6.0), np.r_[column, np.zeros(n)], rtol=1e-10, atol=1e-12, max_step=1e-3)
    return float(found.t[np.flatnonzero(np.abs(found.y[:n].T @ row) > 0.02)[-1]])


@pytest.mark.parametrize("law", [laws.ComputedTorque, laws.TaskComputedTorque, laws.Impedance, laws.GravityPID])
def test_friction_counts_with_all_joints_together(arm: taut.Arm, law: Any) -> None:
    q = np.array([0.3, 1.2])
    x = taut.snapshot(arm, q)
    M, b = np.asarray(x.M), np.diag([0.5, 2.0])
    asked: dict[str, Any] = {"zeta": 0.7, "omega_n": 8.0}
    if law is laws.Impedance:
        asked = {"zeta": 0.7, "K": (60.0, 2.0)}
    if law is laws.GravityPID:
        asked, b = {"zeta": 1.6, "K": [40.0, 8.0]}, 0.0 * b  # kd has what friction has not
    d = taut.design(law, arm, at=q, friction="arm", rate=4000.0, **asked)
    for each, way in zip(d.achieved, d.tried.directions, strict=True):
        if law in (laws.ComputedTorque, laws.TaskComputedTorque):
            C, K = 2.0 * 0.7 * 8.0 * M + b, 64.0 * M
            assert each.designed.settling == pytest.approx(settled(M, C, K, way.column, way.row), rel=2e-3)
        assert way.coupled is not None
        for name in ("zeta", "omega_n", "settling"):  # what sampling at 4 kHz takes is little
            book, seen = getattr(each.designed, name), getattr(each.simulated, name)
            assert seen == pytest.approx(book, rel=0.01), (each.direction, name)
    assert d.limit("damping").ok


def test_directions_that_stand_alone_are_the_closed_form(arm: taut.Arm) -> None:
    for law in (laws.ComputedTorque, laws.GravityPID, laws.TaskComputedTorque):
        d = taut.design(law, arm, at=[0.3, 1.2], zeta=0.7, omega_n=8.0, integral=0.1)
        assert all(way.coupled is None for way in d.tried.directions)


def test_the_picture_draws_what_was_designed_with_all_joints(arm: taut.Arm) -> None:
    d = taut.design(laws.ComputedTorque, arm, at=[0.3, 1.2], zeta=0.7, omega_n=8.0, friction="arm", rate=4000.0)
    solid, dashed = d.plot().axes[0].lines[:2]
    off = np.interp(dashed.get_xdata(), solid.get_xdata(), solid.get_ydata()) - dashed.get_ydata()
    assert np.abs(off).max() < 0.005


@pytest.mark.parametrize("asked", [{"K": [40.0, 8.0]}, {"omega_n": [4.0, 16.0]}], ids=str)
def test_borders_of_rate_and_delay_are_those_of_all_joints(arm: taut.Arm, asked: dict[str, Any]) -> None:
    """Of the fastest direction by itself they were up to 8 % too far, on the unsafe side."""
    d = taut.design(laws.GravityPID, arm, at=[0.3, 1.2], zeta=0.7, rate=500.0, **asked)

    def radius(rate: float, periods: int = 0) -> float:
        plant = taut.RigidPlant(
            arm, friction=None, integrator="rk4", substeps=20, actuation=taut.drives.Actuation(delay=periods / rate)
        )
        loop = taut.Loop(taut.compile(d.law, arm, rate=rate), plant, duration=1.0)
        return float(taut.linearise(loop, at=[0.3, 1.2]).radius)

    least = d.limit("rate").limit
    assert radius(0.99 * least) > 1.0 > radius(1.01 * least)
    most = round(d.limit("delay").limit * 500.0)
    assert radius(500.0, most) < 1.0 < radius(500.0, most + 1)
