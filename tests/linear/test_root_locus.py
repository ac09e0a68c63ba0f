"""Root loci and stability maps: closed forms, and runs of taut on both sides of the boundary."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import control
import numpy as np
import pytest
from refusals import refused
from servo_runs import Servo

import taut

ASIDE = 0.01  # [-] of the boundary's value
LONGEST = 60_000  # ticks of a run


def joint(**numbers: float) -> taut.LinearSystem:
    return taut.error_dynamics(M=0.5, b=0.1, **numbers)


# -------------------------------------------------------------------- loci


def test_figure_10_5_two_roots_meet_at_critical_damping() -> None:
    found = taut.analysis.root_locus(lambda kp: joint(kp=kp, kd=10.0), np.linspace(0.0, 230.0, 60))
    (meeting,) = found.breakaways
    assert meeting.value == pytest.approx(10.1**2 / (4 * 0.5), rel=1e-9)
    assert meeting.pole.real == pytest.approx(-10.1)
    before = found.values < meeting.value
    assert np.all(found.poles[before].imag == 0.0)
    assert found.poles[~before].real == pytest.approx(np.full((int((~before).sum()), 2), -10.1))
    assert found.stable[1:].all()


def test_figure_10_7_three_roots_cross_at_the_bound_on_ki() -> None:
    found = taut.analysis.root_locus(lambda ki: joint(kp=2.205, kd=2.0, ki=ki), np.linspace(0.0, 12.0, 80))
    (limit,) = found.limits
    assert limit.value == pytest.approx(2.1 * 2.205 / 0.5, rel=1e-9)
    assert limit.pole.imag == pytest.approx(math.sqrt(2.205 / 0.5))
    assert np.isnan(found.poles[0]).sum() == 1  # without an integral there are two
    right = found.poles[-1].real > 0.0
    assert right.sum() == 2
    assert np.all(np.diff(found.poles[1:, ~right].real, axis=0) < 0.0)


def test_branches_do_not_jump() -> None:
    values = np.linspace(0.1, 12.0, 400)
    found = taut.analysis.root_locus(lambda ki: joint(kp=2.205, kd=2.0, ki=ki), values)
    steps = np.abs(np.diff(found.poles, axis=0))
    apart = np.abs(found.poles[1:, :, None] - found.poles[:-1, None, :])
    best = apart.min(axis=2)
    assert np.all(steps <= best + 0.3)
    assert sorted(np.abs(found.poles[-1])) == pytest.approx(sorted(np.abs(np.roots([0.5, 2.1, 2.205, 12.0]))))


def test_it_agrees_with_python_control() -> None:
    """1 + k G = 0 with G = (s + 3) / (s (s + 1)(s + 5))."""
    plant = control.tf([1.0, 3.0], np.poly([0.0, -1.0, -5.0]))
    gains = np.linspace(0.1, 30.0, 50)
    ours = taut.analysis.root_locus(lambda k: taut.LinearSystem.from_control(control.feedback(k * plant)), gains)
    theirs = control.root_locus_map(plant, gains).loci
    np.testing.assert_allclose(
        np.sort_complex(np.round(ours.poles, 8)), np.sort_complex(np.round(theirs, 8)), atol=1e-6
    )


def test_the_limit_of_a_compiled_loop_is_where_its_pole_crosses_the_circle() -> None:
    arm = taut.load_arm("one_joint").with_gravity([0.0, 0.0, 0.0])
    loop = taut.Loop(taut.compile(taut.laws.PID(kp=1.0, kd=1.0), arm, rate=100.0), taut.RigidPlant(arm), duration=1.0)

    def linear(kd: float) -> taut.LinearSystem:
        loop.parameters["law.kd"] = kd
        return taut.linearise(loop)

    found = taut.analysis.root_locus(linear, [10.0, 200.0], label="kd [N m s/rad]")
    (limit,) = found.limits
    assert abs(limit.pole) == pytest.approx(1.0, abs=1e-9)
    for factor, stable in ((1.0 - 1e-6, True), (1.0 + 1e-6, False)):
        assert linear(factor * limit.value).stable is stable
    assert found.dt == 0.01
    assert [row[0] for row in found.content().tables[0].rows] == ["stability limit"]
    assert found.plot().axes


@pytest.mark.parametrize("values", [[1.0], 1.0, [2.0, 1.0], [1.0, np.nan]])
def test_values_that_do_not_increase_are_refused(values: object) -> None:
    with pytest.raises((taut.errors.ShapeError, taut.errors.RangeError)):
        taut.analysis.root_locus(lambda kp: joint(kp=kp), values)
    with pytest.raises((taut.errors.ShapeError, taut.errors.RangeError)):
        taut.analysis.stability_map(lambda kp, kd: joint(kp=kp, kd=kd), values, [1.0, 2.0])


@pytest.mark.parametrize("given", [3, lambda *values: 3.0, taut.error_dynamics(kp=1.0)])
def test_what_gives_no_linear_system_is_refused_in_a_sentence(given: Any) -> None:
    with refused(taut.errors.UsageError):
        taut.analysis.root_locus(given, [1.0, 2.0])
    with refused(taut.errors.UsageError):
        taut.analysis.stability_map(given, [1.0, 2.0], [1.0, 2.0])


# -------------------------------------------------------------------- maps


def test_the_boundary_of_damping_against_rate_is_the_closed_form() -> None:
    found = taut.analysis.stability_map(
        lambda rate, kd: taut.error_dynamics(M=0.5, kd=kd, zeta=1.0, rate=rate),
        np.geomspace(20.0, 1000.0, 4), np.geomspace(5.0, 2000.0, 4),
    )  # fmt: skip
    np.testing.assert_allclose(found.boundary[:, 1] / found.boundary[:, 0], 1.0, rtol=1e-3)  # kd = 2 M / dt
    assert np.array_equal(found.stable, found.y < found.x[:, np.newaxis])


def test_the_boundary_of_ki_against_kd_is_the_chapters_bound() -> None:
    found = taut.analysis.stability_map(
        lambda kd, ki: joint(kp=2.205, kd=kd, ki=ki), np.linspace(0.5, 4.0, 6), np.linspace(0.5, 20.0, 6)
    )
    kd, ki = found.boundary.T
    np.testing.assert_allclose(ki, (0.1 + kd) * 2.205 / 0.5, rtol=2e-3)


def circle(count: int) -> taut.analysis.StabilityMap:
    """Stable within the unit circle."""
    grid = np.linspace(-1.5, 1.5, count)
    return taut.analysis.stability_map(lambda a, b: taut.LinearSystem(A=[[a, -b], [b, a]], dt=0.01), grid, grid)


def test_any_verdict_over_two_parameters_is_mapped() -> None:
    found = taut.analysis.stability_map(lambda step, kd: step * kd < 1.0, [0.1, 1.0], [0.5, 5.0, 20.0])
    np.testing.assert_allclose(found.boundary.prod(axis=1), 1.0, rtol=2e-3)
    assert found.stable.tolist() == [[True, True, False], [True, False, False]]
    assert np.isnan(found.decay_rate).all()


def test_its_picture_fills_what_is_stable() -> None:
    found = circle(13)
    np.testing.assert_allclose(np.linalg.norm(found.boundary, axis=1), 1.0, rtol=1e-3)
    (ax,) = found.plot().axes
    (area,) = ax.collections[0].get_paths()
    assert _area(area.vertices) == pytest.approx(math.pi, rel=0.05)
    assert area.contains_points(0.97 * found.boundary).all()
    assert not area.contains_points(1.01 * found.boundary).any()
    (table,) = found.content().tables
    assert len(table.rows) == len(found.boundary)


def _area(points: np.ndarray) -> float:
    x, y = points.T
    return abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1))) / 2.0


# -------------------------------------------------------------------- runs on both sides of a boundary


def grows(servo: Servo, kp: float, kd: float, ki: float) -> bool:
    """Whether the error of a run is larger in its last fifth than in its middle one."""
    rate = abs(math.log(servo.sampled(kp, kd, ki).radius))
    ticks = int(min(max(400, 25.0 / rate), LONGEST))
    parts = np.array_split(servo.error(kp, kd, ki, ticks), 5)
    middle, end = (float(np.average(part**2, weights=np.hanning(len(part)))) for part in (parts[2], parts[4]))
    return not end < middle


def both_sides(found: taut.analysis.StabilityMap, count: int, seed: int) -> list[tuple[tuple[float, float], bool]]:
    """Points 1 % to either side of some points of a boundary, and whether they are stable."""
    out = []
    for i in np.random.default_rng(seed).permutation(len(found.boundary))[:count]:
        along = int(found.along[i])
        place = [
            int(np.searchsorted(grid, x, side="right")) - 1
            for grid, x in zip((found.x, found.y), found.boundary[i], strict=True)
        ]
        inwards = -1.0 if found.stable[*place] else 1.0  # the corner of the cell with the smaller value
        for side in (1.0, -1.0):
            point = found.boundary[i].copy()
            point[along] *= 1.0 + side * inwards * ASIDE
            out.append(((float(point[0]), float(point[1])), side > 0.0))
    return out


MAPS: dict[str, tuple[Servo, Callable[[float, float], tuple[float, float, float]], np.ndarray, np.ndarray]] = {
    "kd against kp at 100 Hz": (
        Servo(rate=100.0, kind=0), lambda kp, kd: (kp, kd, 0.0), np.geomspace(20.0, 20_000.0, 10), np.geomspace(2.0, 150.0, 10),
    ),
    "kd against ki, differenced and one period late": (
        Servo(rate=100.0, kind=1, taps=1), lambda ki, kd: (60.0, kd, ki), np.geomspace(5.0, 2000.0, 10), np.geomspace(1.0, 60.0, 10),
    ),
    "kd against kp at 1 kHz, filtered": (
        Servo(rate=1000.0, kind=3, taps=2), lambda kp, kd: (kp, kd, 0.0), np.geomspace(20.0, 20_000.0, 10), np.geomspace(2.0, 150.0, 10),
    ),
}  # fmt: skip


@pytest.mark.bars
@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_runs_decay_one_percent_within_the_boundary_and_grow_one_percent_beyond(
    share: Callable[[int], int], bar: Callable[[str, object], None]
) -> None:
    count = wrong = 0
    step = 1 if share(10) == 10 else 3
    for servo, gains, x, y in MAPS.values():
        found = taut.analysis.stability_map(
            lambda a, b, servo=servo, gains=gains: servo.sampled(*gains(a, b)), x[::step], y[::step]
        )
        assert len(found.boundary) >= 4
        for (a, b), stable in both_sides(found, share(len(found.boundary)), 1):
            wrong += grows(servo, *gains(a, b)) == stable
            count += 1
    assert wrong == 0
    bar(
        "stability maps of one_joint under PID, 1 % to either side of the border: runs that disagree", f"0 of {count}"
    )


@pytest.mark.bars
@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_runs_agree_with_the_map_of_gain_against_rate_one_percent_to_either_side(
    share: Callable[[int], int], bar: Callable[[str, object], None]
) -> None:
    """Differenced velocity, one period late: above the boundary in kd a run grows, and below that in the rate."""

    def servo(rate: float) -> Servo:
        return Servo(rate=rate, kind=1, taps=1)

    found = taut.analysis.stability_map(
        lambda rate, kd: servo(rate).sampled(40.0, kd, 0.0),
        np.geomspace(50.0, 800.0, 7),
        np.geomspace(2.0, 400.0, 9),
    )
    assert set(found.along.tolist()) == {0, 1}
    points = both_sides(found, max(share(len(found.boundary)), 4), 3)
    assert not [point for point, stable in points if grows(servo(point[0]), 40.0, point[1], 0.0) == stable]
    name = "stability map of one_joint, gain against rate, 1 % to either side of the border: runs that disagree"
    bar(name, f"0 of {len(points)}")


@dataclass(frozen=True, kw_only=True)
class Whole:
    """A loop of taut, made of two numbers, and its start pose."""

    make: Callable[..., taut.Loop]
    q: tuple[float, ...]

    def linear(self, one: float, other: float) -> taut.LinearSystem:
        loop = self.make(one, other)
        reference, loop.ref = loop.ref, taut.hold()
        try:
            return taut.linearise(loop, at=self.q)
        finally:
            loop.ref = reference

    def grows(self, one: float, other: float) -> bool:
        """Whether the speeds after a small step of the reference are larger at the end than in the middle."""
        lin, loop = self.linear(one, other), self.make(one, other)
        ticks = int(min(max(400, 15.0 / abs(math.log(lin.radius))), LONGEST))
        loop.duration = ticks * lin.dt
        parts = np.array_split(taut.run(loop, q0=self.q, progress=False).v, 5)
        middle, end = (
            float(np.average(np.sum(part**2, axis=1), weights=np.hanning(len(part)))) for part in (parts[2], parts[4])
        )
        return not end < middle


POSE = (0.3, 0.8, 0.4)


@cache
def bent() -> taut.Arm:
    return taut.load_arm("planar3")


def aside(size: float) -> taut.TaskMotion:
    """The tool's pose there, and a little aside."""
    T = taut.snapshot(bent(), POSE).T()
    return taut.TaskMotion(pose=taut.Pose(T.p + size * np.array([1.0, 0.0, 0.5]), R=T.R))


@cache
def haptic_loop() -> taut.Loop:
    """Virtual stiffness against damping: an impedance at the tool at 500 Hz, its velocity differenced and filtered."""
    sensing = taut.Sensing(velocity=taut.sensors.Difference(cutoff=60.0))
    ctrl = taut.compile(taut.laws.Impedance(K=(1.0, 1.0), B=(1.0, 1.0)), bent(), rate=500.0, sensing=sensing)
    return taut.Loop(ctrl, taut.RigidPlant(bent(), friction=None), aside(1e-9), duration=1.0)


def haptic(K: float, B: float) -> taut.Loop:
    loop = haptic_loop()
    for name, size in (("law.K", K), ("law.B", B)):
        loop.parameters[name] = size * np.array([1.0, 1.0, 1.0, 0.04, 0.04, 0.04])
    return loop


@cache
def pressing_loop() -> taut.Loop:
    """Environment stiffness against force gain: a tool under ForceControl in a spring, with some damping."""
    ctrl = taut.compile(taut.laws.ForceControl(kfp=0.2, kfi=1.0, kdamp=(60.0, 2.0)), bent())
    plant = taut.RigidPlant(bent(), friction=None, environment=taut.environments.Spring(stiffness=(1e3, 10.0)))
    return taut.Loop(ctrl, plant, taut.TaskForce(F_app=[1e-7, 0.0, 1e-7, 0.0, 0.0, 0.0]), duration=1.0)


def pressing(stiffness: float, kfi: float) -> taut.Loop:
    loop = pressing_loop()
    loop.parameters["environment.stiffness"] = np.array([stiffness, 0.01 * stiffness])
    loop.parameters["law.kfi"] = kfi
    return loop


WHOLE = {
    "virtual stiffness against damping": (
        Whole(make=haptic, q=POSE), np.geomspace(300.0, 3e5, 10), np.geomspace(3.0, 2e3, 10)
    ),
    "environment stiffness against force gain": (
        Whole(make=pressing, q=POSE), np.geomspace(100.0, 1e5, 8), np.geomspace(1.0, 300.0, 8)
    ),
}  # fmt: skip


@pytest.mark.part(1)
@pytest.mark.bars
@pytest.mark.parametrize("name", WHOLE)
@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_runs_of_an_arm_agree_with_the_named_maps_one_percent_to_either_side(
    name: str, share: Callable[[int], int], bar: Callable[[str, object], None]
) -> None:
    whole, x, y = WHOLE[name]
    spacing = 1 if share(len(x)) == len(x) else 3
    found = taut.analysis.stability_map(whole.linear, x[::spacing], y[::spacing])
    assert len(found.boundary) >= 3
    assert 0.1 < found.stable.mean() < 0.9
    points = both_sides(found, max(share(len(found.boundary)), 2), 2)
    for point, stable in points:
        assert whole.linear(*point).stable == stable
        assert whole.grows(*point) != stable
    bar(
        f"stability map of planar3, {name}, 1 % to either side of the border: runs that disagree",
        f"0 of {len(points)}",
    )
