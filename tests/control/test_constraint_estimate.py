"""The estimate of a surface's normal from force and motion: what it shows, how fast, and what does not fool it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from refusals import refused

import taut
from taut.base.errors import RangeError, UsageError
from taut.control.laws.wrappers import NormalEstimate, turn_between, turned_rows
from taut.maths.spatial import rotation_exp, rotation_log

DT = 1e-3
UP = np.array([0.0, 0.0, 1.0])
Pair = tuple[np.ndarray, np.ndarray]


def angle(a: np.ndarray, b: np.ndarray) -> float:
    """[deg]"""
    return float(np.rad2deg(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))


def normal_of(tilt: np.ndarray, n_0: np.ndarray = UP) -> np.ndarray:
    return np.asarray((n_0 + tilt) / np.linalg.norm(n_0 + tilt))


def tilted(degrees: float, heading: float) -> np.ndarray:
    axis = np.array([np.cos(heading), np.sin(heading), 0.0])
    return np.asarray(rotation_exp(np.deg2rad(degrees) * axis) @ UP)


def sliding(n: np.ndarray, along: np.ndarray, speed: float, mu: float, N: float = 10.0) -> Pair:
    """Velocity of the tool, and the force of the surface on it."""
    s = along - (n @ along) * n
    s = s / np.linalg.norm(s)
    return speed * s, N * n - mu * N * s


def estimated(
    contact: Callable[[float], Pair], duration: float = 1.0, start: np.ndarray | None = None, **gains: float
) -> np.ndarray:
    """The tilt after so many seconds of a contact."""
    estimate = NormalEstimate(law=board_law(), **gains)
    tilt = np.zeros(3) if start is None else start
    for k in range(round(duration / DT)):
        v, F = contact(k * DT)
        tilt = np.asarray(estimate.updated(tilt, UP, v, F, DT))
    return tilt


@pytest.mark.part(1)
@pytest.mark.parametrize("mu", [0.0, 0.2, 0.5])
@pytest.mark.parametrize("degrees", [3.0, 10.0, 15.0])
def test_one_second_of_sliding_one_way_shows_any_tilt_to_a_degree_whatever_the_friction(
    degrees: float, mu: float
) -> None:
    for heading in np.arange(0.0, 2.0 * np.pi, np.pi / 3.0):
        n = tilted(degrees, heading)
        tilt = estimated(lambda t, n=n: sliding(n, np.array([1.0, 0.3, 0.0]), 0.05, mu))  # type: ignore[misc]
        assert angle(normal_of(tilt), n) < 0.02


def test_the_error_falls_at_the_stated_rate() -> None:
    n = tilted(8.0, 0.4)
    true = n / n[2] - UP
    for seconds in (0.1, 0.3):
        left = estimated(lambda t: sliding(n, np.array([1.0, 0.0, 0.0]), 0.05, 0.3), seconds, rate=5.0) - true
        assert np.allclose(left, -true * np.exp(-5.0 * seconds), rtol=1e-9, atol=1e-12)


@pytest.mark.long
def test_noise_of_the_sensors_is_averaged_as_stated() -> None:
    rng, d_F, d_v, rate = np.random.default_rng(1), 0.3, 0.005, 8.0
    errors = []
    for _ in range(12):
        n = tilted(10.0, rng.uniform(0.0, 6.0))

        def contact(t: float, n: np.ndarray = n) -> Pair:
            v, F = sliding(n, np.array([1.0, 0.0, 0.0]), 0.05, 0.3)
            return v + rng.normal(0.0, d_v, 3), F + rng.normal(0.0, d_F, 3)

        tilt = estimated(contact, rate=rate)
        errors.append(np.deg2rad(angle(normal_of(tilt), n)))
    stated = np.sqrt(rate * DT / 2.0) * np.hypot(d_F / 10.0, d_v / 0.05)
    assert 0.5 * stated < np.sqrt(np.mean(np.square(errors))) < 2.0 * stated
    assert np.rad2deg(np.max(errors)) < 1.0


def test_friction_is_not_taken_for_the_normal_where_force_alone_would_be() -> None:
    v, F = sliding(UP, np.array([1.0, 0.0, 0.0]), 0.05, 0.5)
    assert angle(F, UP) > 26.0  # what the force alone shows
    assert np.abs(estimated(lambda t: (v, F))).max() < 1e-12


def test_what_rests_or_hardly_presses_or_hits_the_surface_shows_nothing() -> None:
    n, start = tilted(10.0, 1.0), np.array([0.05, -0.02, 0.0])
    rng = np.random.default_rng(2)
    cases: list[Callable[[float], Pair]] = [
        lambda t: (rng.normal(0.0, 0.002, 3), np.array([3.0, -2.0, 10.0])),  # held by friction, with noise
        lambda t: sliding(n, np.array([1.0, 0.0, 0.0]), 0.05, 0.3, N=0.5),
        lambda t: sliding(n, np.array([1.0, 0.0, 0.0]), 0.05, 0.3, N=-10.0),  # a pull is no contact
        lambda t: (np.array([0.02, 0.0, -0.2]), np.array([1.0, 2.0, 50.0])),  # an impact
        lambda t: (np.array([0.1, 0.0, 0.0]), np.zeros(3)),
    ]
    for contact in cases:
        assert np.array_equal(estimated(contact, 0.3, start), start)


def test_no_tick_turns_the_normal_faster_than_stated() -> None:
    rng, estimate, tilt = np.random.default_rng(3), NormalEstimate(law=board_law()), np.zeros(3)
    for _ in range(400):
        v, F = rng.normal(0.0, 0.1, 3), rng.normal(0.0, 20.0, 3) + 10.0 * UP
        new = np.asarray(estimate.updated(tilt, UP, v, F, DT))
        turned = np.deg2rad(angle(normal_of(new), normal_of(tilt)))
        assert turned <= 2.0 * 8.0 * np.tan(0.6) * DT
        assert angle(normal_of(new), UP) < np.rad2deg(0.6)
        tilt = new
    assert tilt.any()


def test_on_a_cylinder_that_stands_elsewhere_the_estimate_follows_as_stated() -> None:
    radius, off, speed = 0.15, 0.02, 0.05
    estimate, tilt, behind = NormalEstimate(law=board_law()), np.zeros(3), []
    for k in range(2000):
        a = -0.4 + speed / radius * k * DT
        n, s = np.array([np.sin(a), 0.0, np.cos(a)]), np.array([np.cos(a), 0.0, -np.sin(a)])
        p = radius * n
        n_0 = (p - [off, 0.0, 0.0]) / np.linalg.norm(p - [off, 0.0, 0.0])
        tilt = np.asarray(estimate.updated(tilt, n_0, speed * s, 10.0 * n - 3.0 * s, DT))
        behind.append(angle(normal_of(tilt, n_0), n))
    assert behind[0] > 6.0  # [deg]
    assert max(behind[1000:]) < 0.2


def test_turned_rows_are_those_of_the_turned_surface() -> None:
    arm = taut.load_arm("panda")
    x = taut.snapshot(arm, arm.home, 0.1 * np.cos(np.arange(7.0)))
    R, p = rotation_exp(np.array([0.1, -0.15, 0.05])), x.T().p
    center = p - np.array([0.0, 0.0, 0.3])
    stated = taut.Constraint.sphere(center=center, radius=0.3)
    true = taut.Constraint.sphere(center=p + R @ (center - p), radius=0.3).at(x)
    rows = turned_rows(stated, x, R)
    assert rows.A is not None
    assert true.A is not None
    for name in ("A", "A_q", "phi", "phi_t", "bias", "curvature"):
        assert np.allclose(getattr(rows, name), getattr(true, name), atol=1e-12), name


def test_the_smallest_rotation_takes_one_normal_to_the_other() -> None:
    n = tilted(14.0, 2.0)
    R = turn_between(UP, n)
    assert np.allclose(R @ UP, n, atol=1e-15)
    assert np.allclose(R @ R.T, np.eye(3), atol=1e-15)
    assert np.isclose(np.linalg.norm(rotation_log(R)), np.deg2rad(14.0))


# -------------------------------------------------------------------- in the law

MOTION = taut.laws.TaskComputedTorque(kp=400.0, kd=40.0)


def board_law(**more: object) -> taut.laws.HybridMotionForce:
    T = taut.snapshot(taut.load_arm("panda"), taut.load_arm("panda").home).T()
    plane = taut.Constraint.plane(point=T.p, normal=UP)
    return taut.laws.HybridMotionForce(constraint=plane, motion=MOTION, kfi=5.0, kdamp=100.0, **more)  # type: ignore[arg-type]


def test_in_the_loop_the_normal_and_its_force_come_back() -> None:
    arm = taut.load_arm("panda")
    T, n = taut.snapshot(arm, arm.home).T(), tilted(10.0, np.pi / 2.0)
    wall = taut.environments.StiffWall(
        point=T.p, normal=n, stiffness=2e4, damping=300.0, friction=0.3, sliding_damping=1000.0
    )
    plant = taut.RigidPlant(arm, friction=None, environment=wall, substeps=2)
    way = taut.trajectories.Line(T0=T, T1=taut.Pose.of(T.R, T.p + np.array([0.06, 0.06, 0.0])), duration=1.6)
    errors = {}
    for name in ("nothing", "estimate"):
        law = board_law() if name == "nothing" else taut.laws.NormalEstimate(law=board_law())
        ctrl = taut.compile(law, arm)
        out = taut.run(ctrl, plant, taut.pressing(way, 10.0), duration=1.6)
        assert out.outcome.ok
        late = out.t > 1.2
        errors[name] = float(np.sqrt(np.mean((out.extra["F_ext"][late, :3] @ n - 10.0) ** 2)))
        if name == "estimate":
            fast = np.linalg.norm(out.task.twist[:, :3], axis=1) > 0.02
            at = int(np.argmax(np.cumsum(fast) >= 1000))
            assert angle(out.extra["law.normal"][at], n) < 1.0
    assert errors["estimate"] < 0.5  # 5 %
    assert errors["estimate"] < 0.5 * errors["nothing"]


def test_paths_of_the_law_are_those_without_the_estimate() -> None:
    arm = taut.load_arm("panda")
    plain, with_it = (taut.compile(law, arm) for law in (board_law(), taut.laws.NormalEstimate(law=board_law())))
    assert set(with_it.parameters) - set(plain.parameters) == {"law.rate", "law.speed", "law.force", "law.most"}
    assert with_it.parameters["law.rate"].item() == 8.0


def around(constraint: taut.Constraint) -> taut.laws.NormalEstimate:
    return taut.laws.NormalEstimate(law=taut.laws.HybridMotionForce(constraint=constraint, motion=MOTION))


def test_loss_of_contact_wraps_an_estimate_and_brakes_against_the_estimated_surface() -> None:
    board = board_law()
    both = taut.laws.LossOfContact(law=taut.laws.NormalEstimate(law=board), patience=0.02)
    assert set(both.parameters()) == {*board.parameters(), "rate", "speed", "force", "most", "contact", "patience"}
    ctrl = taut.compile(both, taut.load_arm("panda"), engine="float")
    assert {"law.lost", "law.normal", "law.lam"} <= set(ctrl.side.recorded)


REFUSED = [
    (lambda: taut.laws.NormalEstimate(law=taut.laws.Posture()), UsageError),
    (lambda: around(taut.Constraint.of_joints(lambda q: q[0])), UsageError),
    (
        lambda: taut.compile(
            around(taut.Constraint(lambda T: T.p[2], frames=("panda_link8",))), taut.load_arm("panda")
        ),
        UsageError,
    ),
    (lambda: taut.compile(around(taut.Constraint(lambda T: T.R[0, 2])), taut.load_arm("panda")), UsageError),
    (lambda: taut.laws.NormalEstimate(law=board_law(), most=1.5), RangeError),
]


@pytest.mark.parametrize(("make", "error"), REFUSED)
def test_what_cannot_be_estimated_is_refused(make: Callable[[], object], error: type[Exception]) -> None:
    with refused(error):
        make()
