"""Stability maps: closed forms, and runs of taut on both sides of the border."""

from __future__ import annotations

import math
from collections.abc import Callable

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
def test_runs_die_away_one_percent_within_the_border_and_grow_one_percent_beyond(
    share: Callable[[int], int], bar: Callable[[str, object], None]
) -> None:
    count = wrong = 0
    step = 1 if share(10) == 10 else 3
    for servo, names, first, second, others in MAPS.values():
        found = taut.stability_map(
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
    def servo(rate: float, kd: float) -> taut.SampledErrorDynamics:
        return taut.second_order(M=0.5, kd=kd, zeta=1.0).sampled(rate=rate)

    found = taut.stability_map(servo, {"rate": np.geomspace(20.0, 1000.0, 4), "kd": np.geomspace(5.0, 2000.0, 4)})
    np.testing.assert_allclose(found.border[:, 1] / found.border[:, 0], 1.0, rtol=1e-3)  # kd = 2 M / dt
    expected = found.values[1] < found.values[0][:, np.newaxis]
    assert np.array_equal(found.stable, expected)
    assert found.share == pytest.approx(expected.mean())


def test_the_border_of_ki_against_kd_is_the_chapters_bound() -> None:
    def joint(kd: float, ki: float) -> taut.ErrorDynamics:
        return taut.second_order(M=0.5, b=0.1, kp=2.205, kd=kd, ki=ki)

    found = taut.stability_map(joint, {"kd": np.linspace(0.5, 4.0, 6), "ki": np.linspace(0.5, 20.0, 6)})
    kd, ki = found.border.T
    np.testing.assert_allclose(ki, (0.1 + kd) * 2.205 / 0.5, rtol=2e-3)
    assert np.all(found.inside[found.along == 0])  # more damping is stable
    assert not found.inside[found.along == 1].any()


def test_it_takes_matrices_and_linear_loops() -> None:
    spring = taut.stability_map(
        lambda k, b: np.array([[0.0, 1.0], [-k, -b]]), {"k": [-1.0, -0.1, 1.0], "b": [-1.0, 1.0]}
    )
    assert spring.stable.tolist() == [[False, False], [False, False], [False, True]]
    circle = taut.stability_map(
        lambda a, b: np.array([[a, -b], [b, a]]),
        {"a": np.linspace(-1.5, 1.5, 7), "b": np.linspace(-1.5, 1.5, 7)},
        dt=0.01,
    )
    np.testing.assert_allclose(np.linalg.norm(circle.border, axis=1), 1.0, rtol=1e-3)


def test_its_picture_fills_what_is_stable() -> None:
    circle = taut.stability_map(
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
        taut.stability_map(lambda rate, kd: np.eye(2), over)
