"""The virtual mass, spring and damper of admittance control: closed forms, energy, rotations, moving references."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

import taut
from taut.control.gains import GainValue
from taut.control.laws.admittance import Body, Model, answered, damping_matrix, integrated
from taut.control.laws.task_space import Bound

ORIGIN = taut.TaskMotion(pose=taut.Pose([0.0, 0.0, 0.0], rpy=[0.0, 0.0, 0.0]))
NOTHING = np.zeros(6)
FRAMES = ("world", "task", "tool")
GROWTH = 1e-12  # of the energy at the start, in a tick: rounding


@functools.cache
def native(frame: str) -> Any:
    """One tick in native code: state (18,), reference (24,), F (6,), three matrices, dt."""

    def tick(y: Any, r: Any, F: Any, D: Any, B: Any, K: Any, dt: Any) -> Any:
        model = Model(D=D, B=B, K=K, turning=frame == "tool")
        body = Body(p=y[:3], R=y[3:12].reshape(3, 3), twist=y[12:])
        fields = {"p": r[:3], "R": r[3:12].reshape(3, 3), "twist": r[12:18], "acceleration": r[18:]}
        rate, new = integrated(model, frame, body, taut.TaskMotion.of(fields), F, dt)  # type: ignore[arg-type]
        return taut.math.array([*new.p, *new.R.reshape(9), *new.twist, *rate])

    return taut.native(tick, y=18, r=24, F=6, D=(6, 6), B=(6, 6), K=(6, 6), dt=())


class Ticks:
    """A model in native code, tick by tick."""

    def __init__(self, model: Model, frame: str = "world") -> None:
        self.numbers = [np.ascontiguousarray(x, dtype=np.float64) for x in (model.D, model.B, model.K)]
        self.tick = native(frame)

    def __call__(self, body: Body, ref: taut.TaskMotion, F: np.ndarray, dt: float) -> tuple[np.ndarray, Body]:
        y = np.concatenate([body.p, body.R.ravel(), body.twist])
        r = np.concatenate([ref.p, ref.R.ravel(), ref.twist, ref.acceleration])
        new = self.tick(y, r, F, *self.numbers, np.asarray(dt))
        return new[18:], Body(p=new[:3], R=new[3:12].reshape(3, 3), twist=new[12:18])


def spd(rng: np.random.Generator, kind: str) -> np.ndarray:
    """A stiffness, damping or inertia: one number for each half, six, or a full matrix."""
    if kind == "pair":
        return np.diag(np.repeat(np.exp(rng.uniform(-3.0, 5.0, 2)), 3))
    if kind == "diagonal":
        return np.diag(np.exp(rng.uniform(-3.0, 5.0, 6)))
    A = rng.standard_normal((6, 6))
    return np.asarray(A @ A.T * np.exp(rng.uniform(-2.0, 3.0)))


def somewhere(rng: np.random.Generator, speed: float = 1.0) -> Body:
    return Body(p=rng.standard_normal(3), R=turned(rng), twist=speed * rng.standard_normal(6))


def turned(rng: np.random.Generator) -> np.ndarray:
    return np.asarray(Rotation.from_rotvec(rng.uniform(-1.8, 1.8, 3)).as_matrix())


def energy(model: Model, frame: str, body: Body, ref: taut.TaskMotion) -> float:
    """[J], with the rotation vector of SciPy."""
    R = {"world": np.eye(3), "task": ref.R, "tool": body.R}[frame]
    X = np.concatenate([R.T @ (body.p - ref.p), R.T @ Rotation.from_matrix(body.R @ ref.R.T).as_rotvec()])
    U = np.concatenate([R.T @ body.twist[:3], R.T @ body.twist[3:]])
    return 0.5 * float(U @ model.D @ U + X @ model.K @ X)


class TestALineIsWhatTheLinearEquationSays:
    def test_the_answer_is_equation_10_50(self) -> None:
        rng = np.random.default_rng(0)
        D, B, K = (spd(rng, "full") for _ in range(3))
        body = Body(p=rng.standard_normal(3), R=np.eye(3), twist=rng.standard_normal(6))
        F = rng.standard_normal(6)
        expected = np.linalg.solve(D, F - B @ body.twist - K @ np.append(body.p, np.zeros(3)))
        got = answered(Model(D=D, B=B, K=K), "world", body, ORIGIN, F)
        np.testing.assert_allclose(got, expected, rtol=1e-12, atol=1e-12)

    def test_a_swing_is_that_of_the_matrix_exponential_to_second_order(self) -> None:
        D, B, K = (np.eye(6) * x for x in (2.0, 3.0, 200.0))
        model, body = Model(D=D, B=B, K=K), Body(p=np.array([0.1, 0.0, -0.2]), R=np.eye(3), twist=NOTHING)
        A = np.array([[0.0, 1.0], [-100.0, -1.5]])
        exact = (expm(A) @ np.array([1.0, 0.0]))[0] * body.p
        step, errors = Ticks(model), []
        for ticks in (500, 1000):
            now = body
            for _ in range(ticks):
                _, now = step(now, ORIGIN, NOTHING, 1.0 / ticks)
            errors.append(float(np.abs(now.p - exact).max()))
        assert errors[1] < 2e-5
        assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.05)

    def test_a_push_ends_where_the_spring_balances_it(self) -> None:
        model = Model(D=2.0 * np.eye(6), B=60.0 * np.eye(6), K=400.0 * np.eye(6))
        F, now = np.array([8.0, -4.0, 2.0, 0.0, 12.0, 0.0]), Body(p=np.zeros(3), R=np.eye(3), twist=NOTHING)
        step = Ticks(model)
        for _ in range(4000):
            _, now = step(now, ORIGIN, F, 1e-3)
        np.testing.assert_allclose(now.p, F[:3] / 400.0, rtol=1e-9)
        np.testing.assert_allclose(Rotation.from_matrix(now.R).as_rotvec(), F[3:] / 400.0, atol=1e-9)


class TestTheStepItself:
    """Before anything is taken from the velocity."""

    @pytest.mark.parametrize("dt", [1e-3, 0.1, 10.0])
    def test_keeps_the_books_of_energy_exactly_along_a_line(self, dt: float) -> None:
        rng = np.random.default_rng(7)
        D, B, K = (np.kron(np.eye(2), spd(rng, "full")[:3, :3]) for _ in range(3))
        model = Model(D=D, B=B, K=K)
        X, U, F = (np.append(rng.standard_normal(3), np.zeros(3)) for _ in range(3))
        mean = model.step(X, U, F, dt)
        before, after = model.energy(X, U), model.energy(X + dt * mean, 2.0 * mean - U)
        given = dt * float(F @ mean - mean @ B @ mean)
        assert after - before == pytest.approx(given, rel=1e-9, abs=1e-11 * (before + after))

    @pytest.mark.parametrize("seed", range(20))
    def test_gains_nothing_from_a_rotation_with_one_stiffness(self, seed: int) -> None:
        rng = np.random.default_rng([8, seed])
        model = Model(D=spd(rng, "pair"), B=np.zeros((6, 6)), K=spd(rng, "pair"))
        body, dt = somewhere(rng, 5.0), 10.0 ** rng.uniform(-3.0, 1.0)
        X = np.append(body.p, Rotation.from_matrix(body.R).as_rotvec())
        mean = model.step(X, body.twist, NOTHING, dt)
        turned_on = Rotation.from_rotvec(dt * mean[3:]) * Rotation.from_matrix(body.R)
        after = model.energy(np.append(body.p + dt * mean[:3], turned_on.as_rotvec()), 2.0 * mean - body.twist)
        before = model.energy(X, body.twist)
        assert after <= before * (1.0 + 1e-12)

    @pytest.mark.parametrize("frame", FRAMES)
    @pytest.mark.parametrize("bound", [None, 0.3])
    def test_pulls_down_the_gradient_of_the_energy(self, frame: str, bound: float | None) -> None:
        rng = np.random.default_rng(9)
        K, most = spd(rng, "full"), None
        if bound is not None:
            most = Bound.of(GainValue(np.array([bound, 2.0 * bound]), "error_max"))
        model = Model(D=np.eye(6), B=np.eye(6), K=K, bound=most, turning=frame == "tool")
        ref = taut.TaskMotion(pose=taut.Pose.of(turned(rng), rng.standard_normal(3)))
        body = somewhere(rng)

        def spring(step: np.ndarray) -> float:
            R_now = Rotation.from_rotvec(step[3:]).as_matrix() @ body.R
            R = {"world": np.eye(3), "task": ref.R, "tool": R_now}[frame]
            turn = Rotation.from_matrix(R_now @ ref.R.T).as_rotvec()
            return float(model.energy(np.append(R.T @ (body.p + step[:3] - ref.p), R.T @ turn), NOTHING))

        h = 1e-6 * np.eye(6)
        gradient = np.array([(spring(each) - spring(-each)) / 2e-6 for each in h])
        R = {"world": np.eye(3), "task": ref.R, "tool": body.R}[frame]
        turn = Rotation.from_matrix(body.R @ ref.R.T).as_rotvec()
        pull = model.pull(np.append(R.T @ (body.p - ref.p), R.T @ turn))
        np.testing.assert_allclose(np.append(R @ pull[:3], R @ pull[3:]), -gradient, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("frame", FRAMES)
class TestEnergy:
    @pytest.mark.part(1)
    @pytest.mark.parametrize("kind", ["pair", "diagonal", "full"])
    def test_never_grows_without_a_wrench_however_long_the_tick(self, frame: str, kind: str) -> None:
        rng = np.random.default_rng([1, len(kind), len(frame)])
        for _ in range(12):
            D, K = spd(rng, kind), spd(rng, kind)
            model = Model(D=D, B=spd(rng, kind) * rng.integers(0, 2), K=K, turning=frame == "tool")
            ref = taut.TaskMotion(pose=taut.Pose.of(turned(rng), rng.standard_normal(3)))
            step, now, dt = Ticks(model, frame), somewhere(rng, 3.0), 10.0 ** rng.uniform(-4.0, 1.0)
            first = last = energy(model, frame, now, ref)
            for _ in range(60):
                _, now = step(now, ref, NOTHING, dt)
                new = energy(model, frame, now, ref)
                assert new - last <= GROWTH * first
                last = new

    def test_is_kept_by_an_undamped_swing_of_one_stiffness(self, frame: str) -> None:
        model = Model(D=2.0 * np.eye(6), B=np.zeros((6, 6)), K=200.0 * np.eye(6), turning=frame == "tool")
        now = Body(p=np.array([0.1, 0.0, 0.0]), R=turned(np.random.default_rng(2)), twist=0.3 * np.ones(6))
        step, first = Ticks(model, frame), energy(model, frame, now, ORIGIN)
        for _ in range(2000):
            _, now = step(now, ORIGIN, NOTHING, 1e-3)
        assert energy(model, frame, now, ORIGIN) == pytest.approx(first, rel=1e-2)

    def test_a_wrench_brings_in_no_more_than_its_work(self, frame: str) -> None:
        rng = np.random.default_rng(3)
        D, B, K = (spd(rng, "diagonal") for _ in range(3))
        model, now, dt = Model(D=D, B=B, K=K, turning=frame == "tool"), somewhere(rng, 0.0), 2e-3
        stored = energy(model, frame, now, ORIGIN)
        step, scale = Ticks(model, frame), stored
        for k in range(300):
            F = 20.0 * np.sin(0.01 * k * np.arange(1.0, 7.0))
            before = now
            _, now = step(now, ORIGIN, F, dt)
            way = np.append(now.p - before.p, Rotation.from_matrix(now.R @ before.R.T).as_rotvec())
            new = energy(model, frame, now, ORIGIN)
            scale = max(scale, new)
            assert new - stored <= F @ way + 1e-11 * scale
            stored = new


@pytest.mark.long
def test_the_rotation_stays_a_rotation_for_a_million_ticks() -> None:
    tick, none, dt = native("world"), np.zeros((6, 6)), np.asarray(1e-3)
    r = np.concatenate([np.zeros(3), np.eye(3).ravel(), np.zeros(12)])
    y = np.concatenate([np.zeros(3), np.eye(3).ravel(), np.zeros(3), [0.7, -0.4, 1.1]])
    D = np.eye(6)
    for _ in range(1_000_000):
        y = tick(y, r, NOTHING, D, none, none, dt)[:18]
    R = y[3:12].reshape(3, 3)
    assert np.abs(R @ R.T - np.eye(3)).max() < 1e-14
    np.testing.assert_allclose(y[15:], [0.7, -0.4, 1.1], rtol=0.0, atol=1e-9)
    turn = Rotation.from_rotvec(np.array([0.7, -0.4, 1.1]) * 1e-3)
    lap = np.linalg.norm([0.7, -0.4, 1.1]) * 1000.0
    expected = Rotation.from_rotvec(turn.as_rotvec() / np.linalg.norm(turn.as_rotvec()) * (lap % (2.0 * np.pi)))
    np.testing.assert_allclose(R, expected.as_matrix(), atol=1e-8)


class TestAMovingReference:
    @pytest.mark.parametrize("frame", FRAMES)
    def test_carries_a_body_that_rests_on_it(self, frame: str) -> None:
        rng = np.random.default_rng(4)
        model = Model(D=2.0 * np.eye(6), B=5.0 * np.eye(6), K=80.0 * np.eye(6), turning=frame == "tool")
        twist, R = np.array([0.1, -0.2, 0.05, 0.4, 0.3, -0.5]), turned(rng)
        pose = taut.Pose.of(R, np.array([0.3, 0.1, 0.2]))
        step, now, dt = Ticks(model, frame), Body(p=pose.p, R=R, twist=twist), 1e-3
        for k in range(1000):
            at = taut.Pose.of(Rotation.from_rotvec(twist[3:] * k * dt).as_matrix() @ R, pose.p + twist[:3] * k * dt)
            ref = taut.TaskMotion(pose=at, twist=twist)
            rate, now = step(now, ref, NOTHING, dt)
            assert np.abs(rate).max() < 1e-8
        np.testing.assert_allclose(now.p, pose.p + twist[:3], atol=1e-10)
        np.testing.assert_allclose(now.R, Rotation.from_rotvec(twist[3:]).as_matrix() @ R, atol=1e-10)

    def test_leaves_the_error_that_10_48_predicts_of_one_that_accelerates_unsaid(self) -> None:
        """The offset is D a / K, and what its speed grows by in half a tick is damped: B a dt / (2 K)."""
        model = Model(D=2.0 * np.eye(6), B=80.0 * np.eye(6), K=400.0 * np.eye(6))
        step, now, dt, a = Ticks(model), Body(p=np.zeros(3), R=np.eye(3), twist=NOTHING), 1e-3, 0.5
        for k in range(3000):
            t = k * dt
            pose = taut.Pose([0.5 * a * t * t, 0.0, 0.0], rpy=[0.0, 0.0, 0.0])
            ref = taut.TaskMotion(pose=pose, twist=[a * t, 0, 0, 0, 0, 0])
            _, now = step(now, ref, NOTHING, dt)
        end = 0.5 * a * 3.0**2
        assert end - now.p[0] == pytest.approx((2.0 * a + 80.0 * a * 0.5 * dt) / 400.0, rel=1e-4)


def test_a_free_rotation_about_a_turning_reference_is_that_of_scipys_integrator() -> None:
    """U-dot relative to the reference, with its carried velocity: the derivative of the exact motion, by SciPy."""
    D, B, K = 0.5, 0.4, 6.0
    w_ref = np.array([0.3, -0.5, 0.2])
    R0 = Rotation.from_rotvec([0.5, 0.3, -0.4])

    def rates(t: float, y: np.ndarray) -> np.ndarray:
        Q, u = Rotation.from_quat(y[:4]), y[4:]
        X, quaternion = Q.as_rotvec(), y[:4]
        x, w = quaternion[:3], quaternion[3]
        q_dot = 0.5 * np.append(w * u + np.cross(u, x), -u @ x)
        return np.concatenate([q_dot, (-B * u - K * X) / D])

    done = solve_ivp(rates, (0.0, 1.0), np.append(R0.as_quat(), np.zeros(3)), rtol=1e-10, atol=1e-12)
    expected = Rotation.from_quat(done.y[:4, -1]) * Rotation.from_rotvec(w_ref)
    model = Model(D=D * np.eye(6), B=B * np.eye(6), K=K * np.eye(6))
    twist = np.append(np.zeros(3), R0.as_matrix() @ w_ref)
    step, now, dt = Ticks(model), Body(p=np.zeros(3), R=R0.as_matrix(), twist=twist), 1e-3
    for k in range(1000):
        pose = taut.Pose.of(Rotation.from_rotvec(w_ref * k * dt).as_matrix(), np.zeros(3))
        ref = taut.TaskMotion(pose=pose, twist=np.append(np.zeros(3), w_ref))
        _, now = step(now, ref, NOTHING, dt)
    np.testing.assert_allclose(now.R, expected.as_matrix(), atol=1e-5)


@pytest.mark.parametrize("kind", ["diagonal", "full"])
def test_designed_damping_gives_every_mode_its_ratio(kind: str) -> None:
    rng = np.random.default_rng(6)
    D, K = spd(rng, kind), spd(rng, kind)
    gains = [GainValue(np.diag(x) if kind == "diagonal" else x, "x") for x in (D, K)]
    B = np.asarray(damping_matrix(*gains, GainValue(np.asarray(0.6), "zeta")), dtype=np.float64)
    np.testing.assert_allclose(B, B.T, rtol=1e-5, atol=1e-5 * np.abs(B).max())
    poles = np.linalg.eigvals(
        np.block([[np.zeros((6, 6)), np.eye(6)], [-np.linalg.solve(D, K), -np.linalg.solve(D, B)]])
    )
    np.testing.assert_allclose(-poles.real / np.abs(poles), 0.6, rtol=1e-4)
