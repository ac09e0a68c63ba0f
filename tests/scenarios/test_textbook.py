"""The textbook's functions, against its own library, its own figure 10.13, and its own numbers."""

from __future__ import annotations

import sys
import types

import numpy as np
import pytest
from refusals import refused

import taut
from taut.base.types import Float64Array

with pytest.MonkeyPatch.context() as patch:
    patch.setitem(sys.modules, "matplotlib.pyplot", types.ModuleType("pyplot"))
    import modern_robotics as mr

M01 = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0.089159], [0, 0, 0, 1]]
M12 = [[0, 0, 1, 0.28], [0, 1, 0, 0.13585], [-1, 0, 0, 0], [0, 0, 0, 1]]
M23 = [[1, 0, 0, 0], [0, 1, 0, -0.1197], [0, 0, 1, 0.395], [0, 0, 0, 1]]
M34 = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0.14225], [0, 0, 0, 1]]
MLIST = np.array([M01, M12, M23, M34], dtype=float)
GLIST = np.array(
    [
        np.diag([0.010267, 0.010267, 0.00666, 3.7, 3.7, 3.7]),
        np.diag([0.22689, 0.22689, 0.0151074, 8.393, 8.393, 8.393]),
        np.diag([0.0494433, 0.0494433, 0.004095, 2.275, 2.275, 2.275]),
    ]
)
SLIST = np.array([[1, 0, 1, 0, 1, 0], [0, 1, 0, -0.089, 0, 0], [0, 1, 0, -0.089, 0, 0.425]], dtype=float).T
UNIT = SLIST / [np.sqrt(2.0), 1.0, 1.0]
G = np.array([0.0, 0.0, -9.8])
STATE = ([0.1, 0.1, 0.1], [0.1, 0.2, 0.3])
WANTED = ([1.0, 1.0, 1.0], [2.0, 1.2, 2.0], [0.1, 0.1, 0.1])
GAINS = {"Kp": 1.3, "Ki": 1.2, "Kd": 1.1}


def torque(eint: float, S: Float64Array = SLIST, **gains: float) -> Float64Array:
    gains = GAINS | gains
    return taut.textbook.ComputedTorque(*STATE, [eint] * 3, G, MLIST, GLIST, S, *WANTED, **gains)


def theirs(eint: float, S: Float64Array = SLIST, **gains: float) -> Float64Array:
    gains = GAINS | gains
    return mr.ComputedTorque(*STATE, np.full(3, eint), G, MLIST, GLIST, S, *map(np.array, WANTED), **gains)


class TestComputedTorque:
    def test_on_the_librarys_own_example_equation_10_21_gives_109_where_it_prints_133(self) -> None:
        assert theirs(0.2)[0] == pytest.approx(133.00525246)
        e, e_dot = np.subtract(WANTED[0], STATE[0]), np.subtract(WANTED[1], STATE[1])
        M = mr.MassMatrix(STATE[0], MLIST, GLIST, SLIST)
        asked = np.array(WANTED[2]) + 1.3 * e + 1.2 * 0.2 + 1.1 * e_dot
        h = mr.InverseDynamics(*STATE, np.zeros(3), G, np.zeros(6), MLIST, GLIST, SLIST)
        assert torque(0.2) == pytest.approx(M @ asked + h, rel=1e-12)
        assert torque(0.2)[0] == pytest.approx(109.0, abs=0.05)
        assert theirs(0.2) - torque(0.2) == pytest.approx(M @ (1.2 * e), rel=1e-9)  # what the page says

    @pytest.mark.parametrize("S", [SLIST, UNIT], ids=["as in the docs", "of unit length"])
    def test_is_the_librarys_where_its_integral_is_given_without_the_error(self, S: Float64Array) -> None:
        assert torque(0.2, S, Ki=0.0) == pytest.approx(theirs(0.2, S, Ki=0.0), rel=1e-12)
        e = 0.9
        assert torque(0.2, S) == pytest.approx(theirs(0.2 - e, S), rel=1e-12)

    def test_a_slide_is_taken_too(self) -> None:
        """A slide whose axis has length 2 goes twice as far."""
        S = np.array([[0.0, 0, 0, 0, 0, 2.0]]).T
        lists = ([np.eye(4), np.eye(4)], [np.diag([1.0, 1, 1, 3, 3, 3])], S)
        mine = taut.textbook.ComputedTorque([0.1], [0.2], [0.3], G, *lists, [0.4], [0.1], [0.7], 2.0, 3.0, 4.0)
        other = mr.ComputedTorque(
            [0.1], [0.2], np.array([0.3 - 0.3]), G, np.array(lists[0]), np.array(lists[1]), S, [0.4], [0.1], [0.7], 2, 3, 4
        )  # fmt: skip
        assert mine == pytest.approx(other, rel=1e-12)
        assert mine[0] == pytest.approx(4.0 * 3.0 * (0.7 + 2.0 * 0.3 + 3.0 * 0.3 - 4.0 * 0.1) + 2.0 * 3.0 * 9.8)


ROWS = 12


def motion(N: int = ROWS) -> tuple[Float64Array, Float64Array, Float64Array, float]:
    path = mr.JointTrajectory(np.full(3, 0.1), np.array([0.4, 0.5, 0.6]), 0.2, N, 5)
    dt = 0.2 / (N - 1.0)
    q = np.array(path)
    v = np.vstack([np.zeros(3), np.diff(q, axis=0) / dt])
    return q, v, np.vstack([np.zeros(3), np.diff(v, axis=0) / dt]), dt


MODEL = MLIST.copy()
MODEL[:, :3, 3] *= 1.05
HEAVY = 1.1 * GLIST
TIP = np.tile([0.3, -0.2, 0.1, 1.0, 2.0, -1.5], (ROWS, 1))


def arguments(S: Float64Array, Ki: float) -> tuple[object, ...]:
    q, v, a, dt = motion()
    wrong = np.array([0.8, 0.2, -8.8])
    return (*STATE, G, TIP, MLIST, GLIST, S, q, v, a, wrong, MODEL, HEAVY, 20.0, Ki, 18.0, dt, 3)


class TestSimulateControl:
    @pytest.fixture
    def no_picture(self, monkeypatch: pytest.MonkeyPatch) -> None:
        silent = types.ModuleType("matplotlib.pyplot")
        for name in ("plot", "legend", "xlabel", "ylabel", "title", "show"):
            setattr(silent, name, lambda *args, **kwargs: None)
        monkeypatch.setitem(sys.modules, "matplotlib.pyplot", silent)

    @pytest.mark.usefixtures("no_picture")
    @pytest.mark.parametrize("S", [SLIST, UNIT], ids=["as in the docs", "of unit length"])
    def test_without_an_integral_is_the_librarys(self, S: Float64Array) -> None:
        tau, theta = taut.textbook.SimulateControl(*arguments(S, 0.0))
        tau_theirs, theta_theirs = mr.SimulateControl(*arguments(S, 0.0))
        assert theta == pytest.approx(theta_theirs, abs=1e-9)
        assert tau == pytest.approx(tau_theirs, abs=1e-7)

    def test_with_an_integral_is_figure_10_13(self) -> None:
        """The figure's lines, with the library's dynamics."""
        args = arguments(UNIT, 50.0)
        q, v, a, dt = motion()
        _, _, _, _, _, _, S, _, _, _, gtilde, Mt, Gt, Kp, Ki, Kd, _, steps = args
        theta, rate, eint = np.array(STATE[0]), np.array(STATE[1]), np.zeros(3)
        torques = []
        for i in range(len(q)):
            e, edot = q[i] - theta, v[i] - rate
            eint = eint + e * dt
            h = mr.InverseDynamics(theta, rate, np.zeros(3), gtilde, np.zeros(6), Mt, Gt, S)
            tau = mr.MassMatrix(theta, Mt, Gt, S) @ (a[i] + Kp * e + Kd * edot + Ki * eint) + h
            for _ in range(steps):
                acceleration = mr.ForwardDynamics(theta, rate, tau, G, TIP[i], MLIST, GLIST, S)
                theta, rate = theta + dt / steps * rate, rate + dt / steps * acceleration
            torques.append(tau)
        tau, angles = taut.textbook.SimulateControl(*args)
        assert tau == pytest.approx(np.array(torques), abs=1e-7)
        assert angles[-1] == pytest.approx(theta, abs=1e-9)

    def test_takes_lists(self) -> None:
        lists = [value.tolist() if isinstance(value, np.ndarray) else value for value in arguments(UNIT, 0.0)]
        tau, _ = taut.textbook.SimulateControl(*lists)
        assert tau == pytest.approx(taut.textbook.SimulateControl(*arguments(UNIT, 0.0))[0])


class TestWhatIsRefused:
    def test_in_one_sentence(self) -> None:
        cases = [
            {"eint": 0.2, "Kp": -1.0},
            {"eint": 0.2, "Ki": np.nan},
            {"eint": 0.2, "S": SLIST.T},
        ]
        for given in cases:
            with refused(taut.TautError):
                torque(**given)
        changes = [
            (3, TIP[:5]),
            (7, np.zeros((ROWS, 2))),
            (16, 0.0),
            (17, 0),
            (17, 2.5),
            (10, [1.0, 2.0]),
            (11, MLIST[:2]),
            (12, -GLIST),
            (13, 1e9),
        ]
        for place, value in changes:
            args = list(arguments(UNIT, 0.0))
            args[place] = value
            with refused(taut.TautError):
                taut.textbook.SimulateControl(*args)
