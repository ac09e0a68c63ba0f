"""Handles, hands and pushes against exact solutions of the masses they are, and sums of environments."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from environment_runs import GANTRY, MASSES, at, free, rigid, work
from scipy.linalg import expm

import taut
from taut.base.types import Float64Array

M = 3.0  # [kg] of the gantry's last slide


def two_masses(m: float, b: float, k: float, grip: float) -> Float64Array:
    """(4, 4) of (z, vz, zh, vh): slide and handle in its grip."""
    g, d = m * grip**2, m * grip
    return np.array(
        [
            [0.0, 1.0, 0.0, 0.0],
            [-g / M, -d / M, g / M, d / M],
            [0.0, 0.0, 0.0, 1.0],
            [g / m, d / m, -(g + k) / m, -(d + b) / m],
        ]
    )


class TestAHandle:
    @pytest.mark.parametrize(("m", "b", "k"), [(0.5, 0.0, 200.0), (2.0, 15.0, 300.0)])
    def test_moves_as_two_masses_do(self, m: float, b: float, k: float) -> None:
        """First order: half the error with half the step."""
        A = two_masses(m, b, k, 300.0)
        errors = []
        for substeps in (5, 10):
            plant = rigid(taut.environments.Hand(mass=m, damping=b, stiffness=k), substeps=substeps)
            out = free(plant, duration=1.0, v0=[0, 0, 0.2])
            exact = np.array([expm(A * t) @ [0.0, 0.2, 0.0, 0.0] for t in out.t[::20]])
            errors.append(np.abs(out.q[::20, 2] - exact[:, 0]).max())
        assert errors[1] < 2e-4 * 0.2
        assert errors[0] / errors[1] == pytest.approx(2.0, abs=0.3)

    def test_makes_the_arm_ring_with_both_masses(self) -> None:
        out = free(rigid(taut.environments.Hand(mass=2.0, stiffness=500.0)), duration=2.0, v0=[0, 0, 0.1])
        crossings = np.flatnonzero((out.q[:-1, 2] < 0.0) & (out.q[1:, 2] >= 0.0))
        times = out.t[crossings] - out.q[crossings, 2] / (out.q[crossings + 1, 2] - out.q[crossings, 2]) * 1e-3
        omega = 2.0 * np.pi / np.diff(times).mean()
        assert omega == pytest.approx(np.sqrt(500.0 / (M + 2.0)), rel=2e-3)

    @pytest.mark.parametrize("damping", [0.0, 5.0])
    def test_gives_back_no_more_than_it_got(self, damping: float) -> None:
        out = free(
            rigid(taut.environments.Hand(mass=1.0, damping=damping, stiffness=300.0)),
            duration=20.0,
            v0=[0.1, -0.1, 0.2],
        )
        assert work(out)[1:].max() < 0.0
        np.testing.assert_allclose(work(out), 0.5 * (out.v**2 - out.v[0] ** 2) @ MASSES, rtol=0.0, atol=1e-12)

    def test_is_felt_as_its_mass(self) -> None:
        """A push of the tool moves arm and handle together."""
        push = taut.environments.Push(peak=[0, 0, 9.0], t=0.0, duration=0.05)
        both = taut.environments.Environments(hand=taut.environments.Hand(mass=1.5), push=push)
        out = free(rigid(both), duration=0.5)
        assert out.v[-1, 2] == pytest.approx(9.0 * 0.05 * 2.0 / np.pi / (M + 1.5), rel=1e-9)


class TestAHand:
    @pytest.mark.part(2)
    @pytest.mark.parametrize("frequency", [0.5, 2.5])
    @pytest.mark.parametrize("what", ["motion", "force"])
    def test_drives_the_arm_at_the_amplitude_of_the_closed_form(self, what: str, frequency: float) -> None:
        m, b, k = 1.0, 20.0, 300.0
        amplitude = {"motion": 0.02, "force": 6.0}[what]
        wave = taut.environments.Oscillation(amplitude=[0.0, 0.0, amplitude], frequency=frequency)
        hand = taut.environments.Hand(mass=m, damping=b, stiffness=k, **{what: wave})
        out = free(rigid(hand, substeps=2), duration=10.0)
        late = out.t >= 6.0
        omega = 2.0 * np.pi * frequency
        basis = np.stack([np.sin(omega * out.t[late]), np.cos(omega * out.t[late]), np.ones(late.sum())], axis=1)
        fit, *_ = np.linalg.lstsq(basis, out.q[late, 2], rcond=None)
        got = fit[0] + 1j * fit[1]
        drive = amplitude * (k if what == "motion" else 1.0)
        exact = np.linalg.solve(1j * omega * np.eye(4) - two_masses(m, b, k, 300.0), [0, 0, 0, drive / m])[0]
        simple = drive / (k - (M + m) * omega**2 + 1j * omega * b)
        assert abs(got - exact) < 2e-3 * abs(exact)
        assert abs(got - simple) < 1e-2 * abs(simple)

    def test_changes_its_frequency_without_a_jump(self) -> None:
        wave = taut.environments.Oscillation(amplitude=[0.0, 0.0, 0.05], frequency=1.0)
        hand = taut.environments.Hand(mass=1.0, damping=20.0, stiffness=300.0, motion=wave)
        event = taut.Event(t=2.125, set={"environment.motion.frequency": 3.0})
        out = free(rigid(hand), duration=4.0, events=[event])
        force = out.extra["F_ext"][:, 2]
        step = np.abs(np.diff(force))
        assert step[2120:2130].max() < step.max()
        late = force[2500:] - force[2500:].mean()
        spectrum = np.abs(np.fft.rfft(late))
        assert np.fft.rfftfreq(len(late), 1e-3)[np.argmax(spectrum)] == pytest.approx(3.0, abs=0.34)


class TestAPush:
    @pytest.mark.parametrize("rate", [200.0, 1000.0, 1300.0])
    @pytest.mark.parametrize(("shape", "mean"), [("half-sine", 2.0 / np.pi), ("rectangular", 1.0)])
    def test_has_the_impulse_that_it_says_however_long_the_steps(self, shape: Any, mean: float, rate: float) -> None:
        push = taut.environments.Push(peak=[30.0, -20.0, 10.0], t=0.1234, duration=0.0567, shape=shape)
        out = free(rigid(push), duration=0.3, rate=rate)
        expected = np.array([30.0, -20.0, 10.0]) * 0.0567 * mean / MASSES
        np.testing.assert_allclose(out.v[-1], expected, rtol=1e-12)
        assert (out.v[out.t < 0.1234] == 0.0).all()

    def test_has_its_shape(self) -> None:
        push = taut.environments.Push(peak=[8.0, 0, 0, 0, 0.5, 0], t=0.2, duration=0.1)
        out = free(rigid(push), duration=0.4)
        middle = out.t + 0.5e-3  # of the step
        inside = (out.t > 0.2 - 1e-9) & (out.t < 0.3 - 1e-9)
        expected = np.where(inside, np.sin(np.pi * (middle - 0.2) / 0.1), 0.0)
        np.testing.assert_allclose(out.extra["F_ext"][:, 0], 8.0 * expected, rtol=0.0, atol=1e-3)
        np.testing.assert_allclose(out.extra["F_ext"][:, 4], 0.5 * expected, rtol=0.0, atol=1e-4)

    def test_waits_for_an_event_and_comes_again(self) -> None:
        push = taut.environments.Push(peak=[8.0, 0.0, 0.0], duration=0.05)
        events = [taut.Event.push(t=0.2), taut.Event.push(t=0.5, peak=[0.0, 4.0, 0.0], duration=0.1)]
        out = free(rigid(push), duration=0.8, events=events)
        assert (out.v[out.t <= 0.2] == 0.0).all()
        between, end = out.v[400] * MASSES, out.v[-1] * MASSES
        np.testing.assert_allclose(between, [8.0 * 0.05 * 2.0 / np.pi, 0.0, 0.0], rtol=1e-12, atol=1e-15)
        np.testing.assert_allclose(end - between, [0.0, 4.0 * 0.1 * 2.0 / np.pi, 0.0], rtol=1e-12, atol=1e-12)


class TestSeveralAtOnce:
    SPRING, DAMPER = taut.environments.Spring(stiffness=300.0), taut.environments.Damper(damping=4.0)

    def test_add(self) -> None:
        both = taut.environments.Environments(a=self.SPRING, b=self.DAMPER)
        p, v = [0.1, 0.2, -0.3], [1.0, 2.0, 3.0]
        np.testing.assert_allclose(at(both, p, v), at(self.SPRING, p, v) + at(self.DAMPER, p, v), rtol=1e-15)

    def test_keep_their_memories_apart(self) -> None:
        two = taut.environments.Environments(
            near=taut.environments.Hand(mass=1.0), far=taut.environments.Hand(mass=2.0, stiffness=50.0)
        )
        out = free(rigid(two, substeps=2), duration=0.5, v0=[0, 0, 0.2])
        again = free(
            rigid(taut.environments.Environments(far=two.parts["far"], near=two.parts["near"]), substeps=2),
            duration=0.5,
            v0=[0, 0, 0.2],
        )
        np.testing.assert_allclose(out.q, again.q, rtol=0.0, atol=1e-14)


WALL = taut.environments.StiffWall(point=[0, 0, 0], normal=[0, 0, 1], stiffness=1e4)
HAND = taut.environments.Hand(
    mass=1.0, damping=1.0, stiffness=1.0, motion=taut.environments.Oscillation(amplitude=0.1, frequency=1.0)
)


@pytest.mark.parametrize(
    ("make", "kind", "name"),
    [
        (lambda: taut.environments.Spring(stiffness=-1.0), taut.errors.RangeError, "stiffness"),
        (lambda: taut.environments.Spring(stiffness=[1.0, 2.0, 3.0]), taut.errors.ShapeError, "stiffness"),
        (lambda: taut.environments.Spring(stiffness=(1.0, np.nan)), taut.errors.RangeError, "stiffness"),
        (lambda: taut.environments.Spring(stiffness=np.triu(np.ones((6, 6)))), taut.errors.RangeError, "stiffness"),
        (lambda: taut.environments.Spring(stiffness=1.0, at="here"), taut.errors.UsageError, "at"),
        (lambda: taut.environments.Spring(stiffness=(1.0, 2.0), slack=0.1), taut.errors.UsageError, "slack"),
        (lambda: taut.environments.Spring(stiffness=1.0, slack=-0.1), taut.errors.RangeError, "slack"),
        (lambda: taut.environments.StiffWall(point=[0, 0], normal=[0, 0, 1], stiffness=1.0), taut.errors.ShapeError, "point"),
        (lambda: taut.environments.StiffWall(point=[0, 0, 0], normal=[0, 0, 0], stiffness=1.0), taut.errors.RangeError, "normal"),
        (lambda: taut.environments.StiffWall(point=[0, 0, 0], normal=[0, 0, 1], stiffness=0.0), taut.errors.RangeError, "stiffness"),
        (lambda: taut.environments.StiffWall(point=[0, 0, 0], normal=[0, 0, 1], stiffness=[1.0, 2.0]), taut.errors.ShapeError, "stiffness"),
        (lambda: taut.environments.Hand(mass=0.0), taut.errors.RangeError, "mass"),
        (lambda: taut.environments.Hand(mass=1.0, damping=[1.0, 2.0]), taut.errors.ShapeError, "damping"),
        (lambda: taut.environments.Hand(mass=1.0, damping=1.0, stiffness=1.0, motion=3.0), taut.errors.UsageError, "motion"),  # type: ignore[arg-type]
        (lambda: taut.environments.Oscillation(amplitude=1.0, frequency=-1.0), taut.errors.RangeError, "frequency"),
        (lambda: taut.environments.Push(peak=[1.0, 2.0]), taut.errors.ShapeError, "peak"),
        (lambda: taut.environments.Push(peak=[1.0, 2.0, 3.0], duration=0.0), taut.errors.RangeError, "duration"),
        (lambda: taut.environments.Push(peak=[1.0, 2.0, 3.0], t=-1.0), taut.errors.RangeError, "t"),
        (lambda: taut.environments.Push(peak=[1.0, 2.0, 3.0], shape="square"), taut.errors.UsageError, "shape"),  # type: ignore[arg-type]
        (lambda: taut.environments.Environments(), taut.errors.UsageError, None),
        (lambda: taut.environments.Environments(wall=3.0), taut.errors.UsageError, "wall"),  # type: ignore[arg-type]
        (lambda: taut.environments.Environments(wall=taut.environments.StiffWall), taut.errors.UsageError, "wall"),  # type: ignore[arg-type]
        (lambda: taut.Event.push(t=1.0, peak=[1.0]), taut.errors.ShapeError, "peak"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused(make: Any, kind: type[taut.TautError], name: str | None) -> None:
    with pytest.raises(kind) as caught:
        make()
    assert caught.value.name == name


@pytest.mark.parametrize(
    ("environment", "path", "value"),
    [
        (WALL, "stiffness", 0.0),
        (WALL, "stiffness", np.inf),
        (WALL, "normal", [0, 0, 0]),
        (taut.environments.Environments(wall=WALL, hand=HAND), "hand.motion.frequency", -2.0),
        (taut.environments.Environments(wall=WALL, hand=HAND), "hand.mass", [1.0, 2.0, 3.0]),
        (HAND, "damping", [1.0, 2.0, 3.0]),
        (taut.environments.Spring(stiffness=(1.0, 1.0)), "stiffness", 3.0),
        (taut.environments.Push(), "t", -1.0),
    ],
)  # fmt: skip
@pytest.mark.parametrize("plant", [taut.RigidPlant, taut.MujocoPlant])
def test_a_parameter_is_checked_when_it_changes(plant: Any, environment: Any, path: str, value: Any) -> None:
    made = plant(GANTRY, environment=environment)
    with pytest.raises(taut.TautError) as caught:
        made.checked_parameter(f"environment.{path}", value)
    assert caught.value.name in (f"environment.{path}", path.rpartition(".")[2])


def test_a_changed_parameter_is_kept_as_it_would_be_made() -> None:
    spring = taut.environments.Spring(stiffness=np.eye(6), at=taut.Pose([1, 2, 3]))
    plant = taut.RigidPlant(GANTRY, environment=taut.environments.Environments(spring=spring, wall=WALL))
    np.testing.assert_array_equal(
        plant.checked_parameter("environment.spring.stiffness", (2.0, 3.0)), np.diag([2.0] * 3 + [3.0] * 3)
    )
    np.testing.assert_array_equal(plant.checked_parameter("environment.wall.normal", [0, 3, 0]), [0, 1, 0])
