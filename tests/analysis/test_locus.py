"""Root loci: figures 10.5 and 10.7 of the chapter, python-control, and loci of sampled loops."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.linalg
from scipy.optimize import brentq

import taut


class TestTheLocusOverKp:
    """Figure 10.5: Kd = 10 N m s/rad, Kp from zero up."""

    locus = taut.analysis.locus(
        lambda kp: taut.analysis.second_order(M=0.5, b=0.1, kp=kp, kd=10.0), [0.0, 220.0], name="kp"
    )

    def test_the_roots_meet_where_it_is_critically_damped(self) -> None:
        (meeting,) = self.locus.meetings
        assert meeting.value == pytest.approx(10.1**2 / (4.0 * 0.5), rel=1e-9)  # (b + Kd)^2 / (4 M)
        assert meeting.pole == pytest.approx(-10.1, rel=1e-6)

    def test_before_they_are_real_and_after_they_have_one_real_part(self) -> None:
        before = self.locus.values < 51.0
        assert np.all(self.locus.poles[before].imag == 0.0)
        np.testing.assert_allclose(self.locus.poles[self.locus.values > 51.01].real, -10.1, rtol=1e-12)

    def test_the_points_1_2_and_3_are_zeta_1_5_1_and_0_5(self) -> None:
        for zeta in (1.5, 1.0, 0.5):
            kp = 10.1**2 / (4.0 * 0.5 * zeta**2)
            d = taut.analysis.second_order(M=0.5, b=0.1, kp=kp, kd=10.0)
            assert d.zeta == pytest.approx(zeta, rel=1e-14)
            nearest = np.abs(self.locus.at(kp)[:, np.newaxis] - d.poles).min(axis=0)
            assert nearest.max() < 0.05 * d.omega_n

    def test_it_starts_at_the_border_and_its_picture_marks_what_is_asked(self) -> None:
        assert [crossing.value for crossing in self.locus.borders] == [0.0]
        (ax,) = self.locus.plot(mark=[22.67, 51.005, 204.02], unit="N m/rad").axes
        assert ax.get_title(loc="left") == "kp from 0 (x) to 220 N m/rad (o)"
        assert sorted(text.get_text() for text in ax.texts) == ["1", "1", "2", "3"]  # once where two meet


class TestTheLocusOverKi:
    """Figure 10.7: the critically damped PD controller of figure 10.6, Ki from zero up."""

    locus = taut.analysis.locus("ki", [0.0, 12.0], of=taut.analysis.second_order(M=0.5, b=0.1, kp=2.205, kd=2.0))

    def test_three_roots_cross_where_the_bound_says(self) -> None:
        (border,) = self.locus.borders
        assert border.value == pytest.approx((0.1 + 2.0) * 2.205 / 0.5, rel=1e-12)
        assert border.pole == pytest.approx(2.1j, abs=1e-9)  # sqrt(Kp / M)

    def test_a_third_root_starts_at_the_origin_and_two_meet_it_halfway(self) -> None:
        assert len(self.locus.at(0.0)) == 2
        np.testing.assert_allclose(self.locus.at(0.0), [-2.1, -2.1])
        first = self.locus.poles[1]
        assert np.abs(first).min() < 0.01
        (meeting,) = self.locus.meetings
        s = (-2.1 + math.sqrt(2.1**2 - 3.0 * 0.5 * 2.205 * 1.0)) / 1.5  # where d(ki)/ds is zero
        assert meeting.pole.real == pytest.approx(s, rel=1e-5)
        assert meeting.value == pytest.approx(-(0.5 * s**3 + 2.1 * s**2 + 2.205 * s), rel=1e-9)

    def test_one_root_goes_left_and_two_go_right(self) -> None:
        end = self.locus.at(12.0)
        assert (end.real > 0.0).sum() == 2
        assert end.real.min() < -4.0


def test_it_agrees_with_python_control() -> None:
    control = pytest.importorskip("control")
    gains = np.linspace(0.1, 30.0, 40)
    theirs = control.root_locus_map(control.tf([1.0, 3.0], [1.0, 4.0, 8.0, 0.0]), gains=gains).loci
    ours = taut.analysis.locus(
        lambda k: taut.analysis.ErrorDynamics(coefficients=[1.0, 4.0, 8.0 + k, 3.0 * k]), gains
    )
    for k, row in zip(gains, theirs, strict=True):
        np.testing.assert_allclose(np.sort_complex(ours.at(k)), np.sort_complex(row), rtol=1e-6, atol=1e-9)


def test_branches_do_not_jump() -> None:
    """Each branch moves by less than a few hundredths of the picture, but where two poles meet."""
    d = taut.analysis.second_order(M=0.5, b=0.1, kp=20.0, kd=4.0, ki=10.0).sampled(rate=100.0, velocity="difference")
    found = taut.analysis.locus("kd", [0.05, 120.0], of=d)
    steps = np.abs(np.diff(found.poles, axis=0))
    assert np.nanmax(steps) < 0.05
    assert found.dt == 0.01
    values = {crossing.value for crossing in found.borders}
    for value in values:
        below, above = d.replaced(kd=value * (1.0 - 1e-6)), d.replaced(kd=value * (1.0 + 1e-6))
        assert below.stable != above.stable
    assert len(values) == 2  # too little damping for its integral, and too much for its rate


def loops(k: float) -> list[object]:
    """The same undamped pair, 2 rad/s and k to the right, as everything that has poles."""
    s = np.array([k + 2.0j, k - 2.0j])
    made = taut.analysis.ErrorDynamics.from_poles(s)
    linear = SimpleNamespace(poles=np.exp(0.1 * s), dt=0.1, stable=bool(k < 0.0))
    return [made, made.of(__import__("control").tf([1.0], np.poly(s).real)), np.array([[k, 2.0], [-2.0, k]]), linear]


@pytest.mark.parametrize("kind", range(4))
def test_it_takes_all_that_has_poles(kind: int) -> None:
    pytest.importorskip("control")
    found = taut.analysis.locus(lambda k: loops(k)[kind], [-1.0, 0.6])
    (border,) = found.borders
    assert border.value == pytest.approx(0.0, abs=1e-9)
    expected = 2.0j if kind < 3 else np.exp(0.2j)
    assert border.pole == pytest.approx(expected, abs=1e-6)


def test_a_python_control_system_and_a_matrix_of_a_period_are_judged_by_the_unit_circle() -> None:
    control = pytest.importorskip("control")
    for make, dt in (
        (lambda k: control.tf([1.0], [1.0, -k], 0.1), None),
        (lambda k: np.array([[k]]), 0.1),
    ):
        found = taut.analysis.locus(make, [0.5, 1.5], dt=dt)
        assert found.borders[0].value == pytest.approx(1.0)
        assert found.dt == 0.1


def test_the_poles_at_a_value_between_are_those_there_and_not_of_the_next() -> None:
    found = TestTheLocusOverKi.locus
    assert 3.21 not in found.values
    expected = taut.analysis.second_order(M=0.5, b=0.1, kp=2.205, kd=2.0, ki=3.21).poles
    np.testing.assert_allclose(np.sort_complex(found.at(3.21)), np.sort_complex(expected), rtol=1e-12)


def test_the_poles_are_those_at_each_of_its_values() -> None:
    found = TestTheLocusOverKi.locus
    for value, row, stable in itertools.islice(zip(found.values, found.poles, found.stable, strict=True), 1, None, 7):
        d = taut.analysis.second_order(M=0.5, b=0.1, kp=2.205, kd=2.0, ki=value)
        np.testing.assert_allclose(np.sort_complex(row), np.sort_complex(d.poles), rtol=1e-9)
        assert stable == d.stable


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (lambda: taut.analysis.locus("kp", [0.0, 1.0]), r"the name 'kp' needs of=, error dynamics that have this number; or give a function of the number"),
        (lambda: taut.analysis.locus(3.0, [0.0, 1.0]), r"vary must be a function of one number, or the name of a number of `of`; got 3.0"),
        (lambda: taut.analysis.locus(lambda k: k, [0.0, 1.0], of=taut.analysis.second_order(kp=1, kd=1)), "of= is for the name of a number; a function makes the whole itself"),
        (lambda: taut.analysis.locus(lambda k: k, [0.0, 1.0]), "poles are those of error dynamics, a loop, a system of python-control or a square matrix; got float"),
        (lambda: taut.analysis.locus(lambda k: np.ones(3), [0.0, 1.0]), r"a matrix that has poles is square; got shape \(3,\)"),
        (lambda: taut.analysis.locus(lambda k: [[np.nan]], [0.0, 1.0]), r"a matrix that has poles must be finite; got nan at \[0, 0\]"),
        (lambda: taut.analysis.locus(lambda k: SimpleNamespace(poles=[np.nan]), [0.0, 1.0]), "poles must be numbers; SimpleNamespace has one that is NaN"),
        (lambda: taut.analysis.locus(lambda k: k, 1.0), r"values must be a list of two numbers or more, such as np.linspace\(0, 10, 50\); got shape \(\)"),
        (lambda: taut.analysis.locus(lambda k: k, [1.0, 0.0]), "values must increase from one to the next"),
    ],
)  # fmt: skip
def test_what_has_no_locus_is_refused_in_a_sentence(call: Callable[[], object], sentence: str) -> None:
    with pytest.raises(taut.TautError, match=f"^{sentence}$"):
        call()


def test_a_locus_prints_where_it_is_stable_and_not_its_arrays() -> None:
    """s^3 + 4.2 s^2 + 4.41 s + 2 ki: by Routh stable for 0 < ki < 9.261, with s = +-2.1j there."""
    found = taut.analysis.locus(
        "ki", [0.5, 12.0], of=taut.analysis.second_order(M=0.5, b=0.1, kp=2.205, kd=2.0), unit="N m/(rad s)"
    )
    assert found.ranges == [(0.5, pytest.approx(9.261))]
    told = str(found)
    assert told.splitlines()[0] == "root locus over ki from 0.5 to 12 N m/(rad s)"
    assert "stable           0.5 to 9.261" in told
    assert "border           ki = 9.261 N m/(rad s), 0 +- 2.1j" in told
    assert "array" not in repr(found)
    ((heads, *rows),) = found.tables().values()
    assert heads == ["ki [N m/(rad s)]", "what happens", "pole in s [1/s]"]
    assert [row[0] for row in rows] == ["0.5", "0.686", "9.261", "12"]
    assert "N m/(rad s)" in found.plot().axes[0].get_title(loc="left")


def test_the_border_of_a_compiled_loop_is_where_its_pole_crosses_the_circle() -> None:
    """Of a slow swing at 10 kHz, whose growth in a tick is small: M = 0.5, b = 0.1, held exactly, written out."""
    M, b, kp, kd, T = 0.5, 0.1, 2.205, 2.0, 1e-4
    arm = taut.load_arm("one_joint", gravity=(0.0, 0.0, 0.0))
    ctrl = taut.compile(taut.laws.PID(kp=kp, kd=kd, ki=1.0), arm, rate=1.0 / T)
    loop = taut.Loop(ctrl, taut.RigidPlant(arm, integrator="rk4"), taut.JointMotion(q=[0.0]), duration=1.0)

    def compiled(ki: float) -> taut.analysis.Linearisation:
        loop.parameters["law.ki"] = ki
        return taut.linearise(loop, at=[0.0])

    held = scipy.linalg.expm(T * np.array([[0.0, 1.0, 0.0], [0.0, -b / M, 1.0 / M], [0.0, 0.0, 0.0]]))

    def growth(ki: float) -> float:
        A = np.zeros((3, 3))  # of x, v and the integral of -x
        A[:2, :2], A[2] = held[:2, :2], [-T, 0.0, 1.0]
        A[:2] += np.outer(held[:2, 2], [-kp - ki * T, -kd, ki])
        return float(np.abs(np.linalg.eigvals(A)).max()) - 1.0

    (border,) = taut.analysis.locus(compiled, [8.0, 11.0]).borders
    assert border.value == pytest.approx(brentq(growth, 8.0, 11.0, xtol=1e-9), rel=1e-6)
    just = compiled(border.value * 1.00001)
    assert not just.stable
    assert just.why.startswith("the largest pole has modulus 1 + ")
