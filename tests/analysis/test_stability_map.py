"""Stability maps: closed forms, and runs of taut on both sides of the border."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
from servo_runs import Servo

import taut

ASIDE = 0.01  # of the border's value
MOST = 60_000  # ticks of a run


def grows(servo: Servo, kp: float, kd: float, ki: float) -> bool:
    """Whether what a run sets off is larger in its last fifth than in its middle one."""
    rate = abs(math.log(servo.sampled(kp, kd, ki).radius))
    ticks = int(min(max(400, 25.0 / rate), MOST))
    parts = np.array_split(servo.error(kp, kd, ki, ticks), 5)
    middle, end = (float(np.average(part**2, weights=np.hanning(len(part)))) for part in (parts[2], parts[4]))
    return not end < middle


MAPS = {
    "kd against kp at 100 Hz": (
        Servo(rate=100.0, kind=0), ("kp", "kd"), np.geomspace(20.0, 20_000.0, 10), np.geomspace(2.0, 150.0, 10), {"ki": 0.0}
    ),
    "kd against ki, differenced and one period late": (
        Servo(rate=100.0, kind=1, taps=1, exact=True), ("ki", "kd"), np.geomspace(5.0, 2000.0, 10),
        np.geomspace(1.0, 60.0, 10), {"kp": 60.0},
    ),
    "kd against kp at 1 kHz, filtered": (
        Servo(rate=1000.0, kind=3, taps=2), ("kp", "kd"), np.geomspace(20.0, 20_000.0, 10), np.geomspace(2.0, 150.0, 10), {"ki": 0.0}
    ),
}  # fmt: skip


@pytest.mark.bars
@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_runs_die_away_one_percent_within_the_border_and_grow_one_percent_beyond(
    share: Callable[[int], int], bar: Callable[[str, object], None]
) -> None:
    count = wrong = 0
    step = 1 if share(10) == 10 else 3
    for servo, names, first, second, others in MAPS.values():
        found = taut.analysis.stability_map(
            lambda servo=servo, others=others, **two: servo.sampled(**{**others, **two}),
            {names[0]: first[::step], names[1]: second[::step]},
        )
        assert len(found.border) >= 4
        picked = np.random.default_rng(1).permutation(len(found.border))[: share(len(found.border))]
        for i in picked:
            inwards = 1.0 if found.inside[i] else -1.0
            for side in (1.0, -1.0):
                point = found.border[i].copy()
                point[found.along[i]] *= 1.0 + side * inwards * ASIDE
                numbers = {**others, **dict(zip(names, point.tolist(), strict=True))}
                wrong += grows(servo, **numbers) != (side < 0.0)
                count += 1
    assert wrong == 0
    bar(
        "stability maps of one_joint under PID, 1 % to either side of the border: runs that disagree", f"0 of {count}"
    )


def test_the_border_of_damping_against_rate_is_the_closed_form() -> None:
    def servo(rate: float, kd: float) -> taut.analysis.SampledErrorDynamics:
        return taut.analysis.second_order(M=0.5, kd=kd, zeta=1.0).sampled(rate=rate)

    found = taut.analysis.stability_map(
        servo, {"rate": np.geomspace(20.0, 1000.0, 4), "kd": np.geomspace(5.0, 2000.0, 4)}
    )
    np.testing.assert_allclose(found.border[:, 1] / found.border[:, 0], 1.0, rtol=1e-3)  # kd = 2 M / dt
    expected = found.values[1] < found.values[0][:, np.newaxis]
    assert np.array_equal(found.stable, expected)
    assert found.share == pytest.approx(expected.mean())


def test_the_border_of_ki_against_kd_is_the_chapters_bound() -> None:
    def joint(kd: float, ki: float) -> taut.analysis.ErrorDynamics:
        return taut.analysis.second_order(M=0.5, b=0.1, kp=2.205, kd=kd, ki=ki)

    found = taut.analysis.stability_map(joint, {"kd": np.linspace(0.5, 4.0, 6), "ki": np.linspace(0.5, 20.0, 6)})
    kd, ki = found.border.T
    np.testing.assert_allclose(ki, (0.1 + kd) * 2.205 / 0.5, rtol=2e-3)
    assert np.all(found.inside[found.along == 0])  # more damping is stable
    assert not found.inside[found.along == 1].any()


def test_it_takes_matrices_and_linear_loops() -> None:
    spring = taut.analysis.stability_map(
        lambda k, b: np.array([[0.0, 1.0], [-k, -b]]), {"k": [-1.0, -0.1, 1.0], "b": [-1.0, 1.0]}
    )
    assert spring.stable.tolist() == [[False, False], [False, False], [False, True]]
    np.testing.assert_allclose(spring.border[spring.along == 0], [[0.0, 1.0]], atol=1e-6)
    asked = []
    taut.analysis.stability_map(
        lambda k, b: asked.append(k) or np.array([[0.0, 1.0], [-k, -b]]), {"k": [-1.0, 1.0], "b": [1.0, 2.0]}
    )
    assert len(asked) < 60  # a border at zero is not bisected for ever
    circle = taut.analysis.stability_map(
        lambda a, b: np.array([[a, -b], [b, a]]),
        {"a": np.linspace(-1.5, 1.5, 7), "b": np.linspace(-1.5, 1.5, 7)},
        dt=0.01,
    )
    np.testing.assert_allclose(np.linalg.norm(circle.border, axis=1), 1.0, rtol=1e-3)


def test_its_picture_fills_what_is_stable() -> None:
    circle = taut.analysis.stability_map(
        lambda a, b: np.array([[a, -b], [b, a]]),
        {"a": np.linspace(-1.5, 1.5, 13), "b": np.linspace(-1.5, 1.5, 13)},
        dt=0.01,
    )
    (ax,) = circle.plot(("m", "s")).axes
    areas, lines = ax.collections[:2]
    corners = [path.vertices[:-1] for path in areas.get_paths()]
    total = sum(_area(p) for p in corners)
    assert total == pytest.approx(math.pi, rel=0.02)
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("a [m]", "b [s]")
    length = sum(float(np.linalg.norm(np.diff(segment, axis=0))) for segment in lines.get_segments())
    assert length == pytest.approx(2.0 * math.pi, rel=0.02)


def _area(points: np.ndarray) -> float:
    x, y = points.T
    return abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1))) / 2.0


@pytest.mark.parametrize(
    ("over", "sentence"),
    [
        ({"kd": [1.0, 2.0]}, r"over must name two numbers with the values of each, such as \{'rate': \[100, 200\], 'kd': \[1, 10\]\}; got \{'kd': \[1.0, 2.0\]\}"),
        ({"rate": [1.0, 2.0], "kd": 3.0}, r"kd must be a list of two values or more, such as np.linspace\(1, 10, 20\); got shape \(\)"),
        ({"rate": [2.0, 1.0], "kd": [1.0, 2.0]}, "rate must increase from one value to the next"),
    ],
)  # fmt: skip
def test_what_is_no_map_is_refused_in_a_sentence(over: dict[str, object], sentence: str) -> None:
    with pytest.raises(taut.TautError, match=f"^{sentence}$"):
        taut.analysis.stability_map(lambda rate, kd: np.eye(2), over)


def test_what_is_called_by_other_names_is_refused_with_both() -> None:
    words = (
        r"make is called by the names of over, make\(rate=..., gain=...\), and takes \(rate, kd\); name both alike"
    )
    with pytest.raises(taut.errors.UsageError, match=words):
        taut.analysis.stability_map(lambda rate, kd: np.eye(2), {"rate": [1.0, 2.0], "gain": [1.0, 2.0]})


def test_a_type_error_of_its_own_is_not_taken_for_that() -> None:
    with pytest.raises(TypeError, match="unsupported operand"):
        taut.analysis.stability_map(lambda a, b: a + "x", {"a": [1.0, 2.0], "b": [1.0, 2.0]})


# -------------------------------------------------------------------- the maps that are named, of whole loops


@dataclass(frozen=True, kw_only=True)
class Whole:
    """A loop of taut, a reference that sets it off, and how it is made of two numbers."""

    make: Callable[..., taut.Loop]
    q: tuple[float, ...]

    def linear(self, **numbers: float) -> taut.analysis.Linearisation:
        loop = self.make(**numbers)
        kept, loop.ref = loop.ref, taut.hold()
        try:
            return taut.linearise(loop, at=self.q)
        finally:
            loop.ref = kept

    def grows(self, **numbers: float) -> bool:
        """Whether the speeds that a small step of the reference sets off are larger at the end than in the middle."""
        lin, loop = self.linear(**numbers), self.make(**numbers)
        ticks = int(min(max(400, 15.0 / abs(math.log(lin.radius))), MOST))
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
        Whole(make=haptic, q=POSE), {"K": np.geomspace(300.0, 3e5, 10), "B": np.geomspace(3.0, 2e3, 10)}
    ),
    "environment stiffness against force gain": (
        Whole(make=pressing, q=POSE), {"stiffness": np.geomspace(100.0, 1e5, 8), "kfi": np.geomspace(1.0, 300.0, 8)}
    ),
}  # fmt: skip


@pytest.mark.bars
@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_runs_agree_with_the_map_of_gain_against_rate_one_percent_to_either_side(
    share: Callable[[int], int], bar: Callable[[str, object], None]
) -> None:
    """Differenced velocity, one period late: above the border in kd a run grows, and below that in the rate."""

    def servo(rate: float) -> Servo:
        return Servo(rate=rate, kind=1, taps=1)

    found = taut.analysis.stability_map(
        lambda rate, kd: servo(rate).sampled(40.0, kd, 0.0),
        {"rate": np.geomspace(50.0, 800.0, 7), "kd": np.geomspace(2.0, 400.0, 9)},
    )
    assert set(found.along.tolist()) == {0, 1}
    picked = np.random.default_rng(3).permutation(len(found.border))[: max(share(len(found.border)), 4)]
    wrong = 0
    for i in picked:
        inwards = 1.0 if found.inside[i] else -1.0
        for side in (1.0, -1.0):
            point = found.border[i].copy()
            point[found.along[i]] *= 1.0 + side * inwards * ASIDE
            wrong += grows(servo(float(point[0])), 40.0, float(point[1]), 0.0) != (side < 0.0)
    assert wrong == 0
    name = "stability map of one_joint, gain against rate, 1 % to either side of the border: runs that disagree"
    bar(name, f"0 of {2 * len(picked)}")


@pytest.mark.bars
@pytest.mark.parametrize("name", WHOLE)
@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_runs_of_an_arm_agree_with_the_named_maps_one_percent_to_either_side(
    name: str, share: Callable[[int], int], bar: Callable[[str, object], None]
) -> None:
    whole, grids = WHOLE[name]
    found = taut.analysis.stability_map(whole.linear, grids)
    assert len(found.border) >= 4
    assert 0.1 < found.share < 0.9
    names, count, wrong = list(grids), 0, 0
    for i in np.random.default_rng(2).permutation(len(found.border))[: max(share(len(found.border)), 2)]:
        inwards = 1.0 if found.inside[i] else -1.0
        for side in (1.0, -1.0):
            point = found.border[i].copy()
            point[found.along[i]] *= 1.0 + side * inwards * ASIDE
            numbers = dict(zip(names, point.tolist(), strict=True))
            assert whole.linear(**numbers).stable == (side > 0.0)
            wrong += whole.grows(**numbers) != (side < 0.0)
            count += 1
    assert wrong == 0
    bar(f"stability map of planar3, {name}, 1 % to either side of the border: runs that disagree", f"0 of {count}")


def servo(rate: float, kd: float) -> taut.analysis.SampledErrorDynamics:
    """Stable where kd < 2 M rate."""
    return taut.analysis.second_order(M=0.5, kd=kd, zeta=1.0).sampled(rate=rate)


def test_a_map_prints_its_borders_with_units_and_not_its_arrays() -> None:
    found = taut.analysis.stability_map(
        servo, {"rate": [50.0, 100.0, 200.0], "kd": [10.0, 90.0, 199.0]}, units=("Hz", "N m s/rad")
    )
    assert found.ranges(0) == [(10.0, pytest.approx(50.0, rel=1e-3))]
    assert found.ranges(2) == [(10.0, 199.0)]
    ((heads, *rows),) = found.tables().values()
    assert heads == ["rate [Hz]", "kd [N m s/rad]"]
    assert [row[0] for row in rows] == ["50", "100", "200"]
    assert rows[2][1] == "everywhere"
    told = str(found).splitlines()
    assert told[0] == "stability map over rate from 50 to 200 Hz and kd from 10 to 199 N m s/rad"
    assert len(told) == 3 + 3
    assert "array" not in repr(found)
    axes = found.plot().axes[0]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("rate [Hz]", "kd [N m s/rad]")
    assert found.plot(("1/s", "")).axes[0].get_xlabel() == "rate [1/s]"


@pytest.mark.parametrize("units", [("Hz",), "Hz", ("Hz", "N", "m"), (1, 2)])
def test_units_are_two_texts(units: object) -> None:
    grid = {"rate": [50.0, 100.0], "kd": [10.0, 90.0]}
    words = "units must be two texts, of rate and of kd, such as .*; got "
    with pytest.raises(taut.errors.UsageError, match=words):
        taut.analysis.stability_map(servo, grid).plot(units)  # type: ignore[arg-type]
    with pytest.raises(taut.errors.UsageError, match=words):
        taut.analysis.stability_map(servo, grid, units=units)  # type: ignore[arg-type]
