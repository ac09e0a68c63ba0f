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
    @pytest.mark.parametrize(("m", "b", "k"), [(0.5, 0.0, 200.0), (2.0, 15.0, 300.0), (1.0, 4.0, 0.0)])
    def test_moves_as_two_masses_do(self, m: float, b: float, k: float) -> None:
        """First order: half the error with half the step."""
        A = two_masses(m, b, k, 300.0)
        errors = []
        for substeps in (5, 10):
            plant = rigid(taut.environments.Handle(mass=m, damping=b, stiffness=k), substeps=substeps)
            out = free(plant, duration=1.0, v0=[0, 0, 0.2])
            exact = np.array([expm(A * t) @ [0.0, 0.2, 0.0, 0.0] for t in out.t[::20]])
            errors.append(np.abs(out.q[::20, 2] - exact[:, 0]).max())
        assert errors[1] < 2e-4 * 0.2
        assert errors[0] / errors[1] == pytest.approx(2.0, abs=0.3)

    def test_makes_the_arm_ring_with_both_masses(self) -> None:
        out = free(rigid(taut.environments.Handle(mass=2.0, stiffness=500.0)), duration=2.0, v0=[0, 0, 0.1])
        crossings = np.flatnonzero((out.q[:-1, 2] < 0.0) & (out.q[1:, 2] >= 0.0))
        times = out.t[crossings] - out.q[crossings, 2] / (out.q[crossings + 1, 2] - out.q[crossings, 2]) * 1e-3
        omega = 2.0 * np.pi / np.diff(times).mean()
        assert omega == pytest.approx(np.sqrt(500.0 / (M + 2.0)), rel=2e-3)

    @pytest.mark.parametrize("damping", [0.0, 5.0])
    def test_gives_back_no_more_than_it_got(self, damping: float) -> None:
        out = free(
            rigid(taut.environments.Handle(mass=1.0, damping=damping, stiffness=300.0)),
            duration=20.0,
            v0=[0.1, -0.1, 0.2],
        )
        assert work(out)[1:].max() < 0.0
        np.testing.assert_allclose(work(out), 0.5 * (out.v**2 - out.v[0] ** 2) @ MASSES, rtol=0.0, atol=1e-12)

    def test_is_felt_as_its_mass(self) -> None:
        """A push of the tool moves arm and handle together."""
        both = taut.environments.Handle(mass=1.5) + taut.environments.Push(peak=[0, 0, 9.0], t=0.0, duration=0.05)
        out = free(rigid(both), duration=0.5)
        assert out.v[-1, 2] == pytest.approx(9.0 * 0.05 * 2.0 / np.pi / (M + 1.5), rel=1e-9)


class TestAHand:
    @pytest.mark.parametrize("frequency", [0.5, 1.0, 2.5])
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


class TestANoise:
    def wanted(self, noise: taut.environments.BandNoise, t: Any) -> Float64Array:
        p, phases = noise.parameters(), noise.start()
        return np.array([noise.value(phases + s * noise.rates(p), p) for s in t])

    def test_has_its_rms_and_its_band(self) -> None:
        noise = taut.environments.BandNoise(rms=[1.0, 2.0, 0.0], low=0.5, high=4.0, seed=4)
        t = np.arange(0.0, 200.0, 0.02)
        x = self.wanted(noise, t)
        np.testing.assert_allclose(np.sqrt((x**2).mean(axis=0)), [1.0, 2.0, 0.0], rtol=0.02)
        f = np.fft.rfftfreq(len(t), 0.02)
        power = np.abs(np.fft.rfft(x[:, 0] * np.hanning(len(t)))) ** 2
        outside = (f < 0.45) | (f > 4.05)
        assert power[outside].sum() < 1e-4 * power.sum()

    def test_is_its_seeds(self) -> None:
        t = [0.0, 0.1, 0.7]
        one, same, other = (
            self.wanted(taut.environments.BandNoise(rms=1.0, low=0.5, high=4.0, seed=s), t) for s in (1, 1, 2)
        )
        np.testing.assert_array_equal(one, same)
        assert np.abs(one - other).max() > 0.1


class TestAPush:
    @pytest.mark.parametrize("rate", [200.0, 1000.0, 1300.0])
    @pytest.mark.parametrize(("shape", "mean"), [("half-sine", 2.0 / np.pi), ("rectangular", 1.0)])
    def test_has_the_impulse_that_it_says_however_long_the_steps(self, shape: Any, mean: float, rate: float) -> None:
        push = taut.environments.Push(peak=[30.0, -20.0, 10.0], t=0.1234, duration=0.0567, shape=shape)
        out = free(rigid(push), duration=0.3, rate=rate)
        expected = np.array([30.0, -20.0, 10.0]) * 0.0567 * mean / MASSES
        np.testing.assert_allclose(out.v[-1], expected, rtol=1e-12)
        np.testing.assert_allclose(push.impulse[:3] / MASSES, expected, rtol=1e-14)
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

    def test_made_by_plus_have_the_names_of_their_classes(self) -> None:
        three = self.SPRING + self.DAMPER + taut.environments.Spring(stiffness=1.0)
        assert sorted(three.parameters()) == ["Damper.damping", "Spring.stiffness", "Spring2.stiffness"]

    def test_keep_their_memories_apart(self) -> None:
        two = taut.environments.Environments(
            near=taut.environments.Handle(mass=1.0), far=taut.environments.Handle(mass=2.0, stiffness=50.0)
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
    ("make", "kind", "words"),
    [
        (lambda: taut.environments.Spring(stiffness=-1.0), taut.errors.RangeError, "spring.stiffness must be >= 0 [N/m]; got -1.0"),
        (lambda: taut.environments.Spring(stiffness=[1.0, 2.0, 3.0]), taut.errors.ShapeError, "spring.stiffness must be one number of the position alone [N/m], (linear, angular), six, or a matrix (6, 6) [N/m, N m/rad]; got shape (3,)"),
        (lambda: taut.environments.Spring(stiffness=(1.0, np.nan)), taut.errors.RangeError, "spring.stiffness[1] must be finite [N/m, N m/rad]; got nan"),
        (lambda: taut.environments.Spring(stiffness=np.triu(np.ones((6, 6)))), taut.errors.RangeError, "spring.stiffness must be a symmetric matrix [N/m, N m/rad]; it differs from its transpose by 1"),
        (lambda: taut.environments.Spring(stiffness=1.0, at="here"), taut.errors.UsageError, "spring.at must be a taut.Pose or a point (3,) [m]; got 'here'"),
        (lambda: taut.environments.Spring(stiffness=(1.0, 2.0), slack=0.1), taut.errors.UsageError, "spring.slack is one number, the free length of a cord of one stiffness [N/m]; leave it out, or give stiffness=300.0"),
        (lambda: taut.environments.Spring(stiffness=1.0, slack=-0.1), taut.errors.RangeError, "spring.slack must be >= 0 [m]; got -0.1"),
        (lambda: taut.environments.Damper(damping=1.0, frame="base"), taut.errors.UsageError, "damper.frame must be one of 'world', 'tool'; got 'base'"),
        (lambda: taut.environments.StiffWall(point=[0, 0], normal=[0, 0, 1], stiffness=1.0), taut.errors.ShapeError, "wall.point must have shape (3,) [m]; got shape (2,)"),
        (lambda: taut.environments.StiffWall(point=[0, 0, 0], normal=[0, 0, 0], stiffness=1.0), taut.errors.RangeError, "wall.normal must have a length, as [0, 0, 1] for a floor; got [0.0, 0.0, 0.0]"),
        (lambda: taut.environments.StiffWall(point=[0, 0, 0], normal=[0, 0, 1], stiffness=0.0), taut.errors.RangeError, "wall.stiffness must be > 0 [N/m]; got 0.0; for free space leave the wall out"),
        (lambda: taut.environments.StiffWall(point=[0, 0, 0], normal=[0, 0, 1], stiffness=[1.0, 2.0]), taut.errors.ShapeError, "wall.stiffness must be one number [N/m]; got shape (2,)"),
        (lambda: taut.environments.Handle(mass=0.0), taut.errors.RangeError, "handle.mass must be > 0 [kg]; got 0.0; without mass it is a taut.environments.Spring and a taut.environments.Damper"),
        (lambda: taut.environments.Handle(mass=1.0, damping=[1.0, 2.0]), taut.errors.ShapeError, "handle.damping must be one number for all three axes, or three for those of the world [N s/m]; got shape (2,)"),
        (lambda: taut.environments.Hand(mass=1.0, damping=1.0, stiffness=1.0, motion=3.0), taut.errors.UsageError, "hand.motion must be taut.environments.Oscillation(...) or taut.environments.BandNoise(...); got float"),  # type: ignore[arg-type]
        (lambda: taut.environments.Oscillation(amplitude=1.0, frequency=-1.0), taut.errors.RangeError, "oscillation.frequency must be >= 0 [Hz]; got -1.0"),
        (lambda: taut.environments.BandNoise(rms=1.0, low=2.0, high=1.0), taut.errors.RangeError, "noise.low must be <= noise.high, 1 [Hz]; got 2"),
        (lambda: taut.environments.BandNoise(rms=1.0, low=1.0, high=2.0, tones=0), taut.errors.RangeError, "noise.tones must be between 1 and 64; got 0"),
        (lambda: taut.environments.BandNoise(rms=1.0, low=1.0, high=2.0, seed=1.5), taut.errors.UsageError, "noise.seed must be a whole number; got 1.5"),  # type: ignore[arg-type]
        (lambda: taut.environments.BandNoise(rms=1.0, low=1.0, high=2.0, seed=-1), taut.errors.RangeError, "noise.seed must be >= 0; got -1"),
        (lambda: taut.environments.Push(peak=[1.0, 2.0]), taut.errors.ShapeError, "push.peak must be a force (3,) [N] or a wrench (6,), force first [N, N m]; got shape (2,)"),
        (lambda: taut.environments.Push(peak=[1.0, 2.0, 3.0], duration=0.0), taut.errors.RangeError, "push.duration must be > 0 [s]; got 0.0; for no push leave it out"),
        (lambda: taut.environments.Push(peak=[1.0, 2.0, 3.0], t=-1.0), taut.errors.RangeError, "push.t must be >= 0 [s]; got -1.0"),
        (lambda: taut.environments.Push(peak=[1.0, 2.0, 3.0], shape="square"), taut.errors.UsageError, "push.shape must be one of 'half-sine', 'rectangular'; got 'square'"),  # type: ignore[arg-type]
        (lambda: taut.environments.Environments(), taut.errors.UsageError, "taut.environments.Environments needs one part at least: taut.environments.Environments(wall=taut.environments.StiffWall(...))"),
        (lambda: taut.environments.Environments(wall=3.0), taut.errors.UsageError, "wall must have parameters(), start(T_WE) and wrench(...), see taut.environments.Environment; got float"),  # type: ignore[arg-type]
        (lambda: taut.environments.Environments(wall=taut.environments.StiffWall), taut.errors.UsageError, "wall must have parameters(), start(T_WE) and wrench(...), see taut.environments.Environment; got StiffWall"),  # type: ignore[arg-type]
        (lambda: WALL + 3.0, taut.errors.UsageError, "a part of a sum must have parameters(), start(T_WE) and wrench(...), see taut.environments.Environment; got float"),  # type: ignore[operator]
        (lambda: taut.Event.push(t=1.0, peak=[1.0]), taut.errors.ShapeError, "push.peak must be a force (3,) [N] or a wrench (6,), force first [N, N m]; got shape (1,)"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused(make: Any, kind: type[taut.TautError], words: str) -> None:
    with pytest.raises(kind) as caught:
        make()
    assert str(caught.value) == words


@pytest.mark.parametrize(
    ("environment", "path", "value", "words"),
    [
        (WALL, "stiffness", 0.0, "wall.stiffness must be > 0 [N/m]; got 0.0; for free space leave the wall out"),
        (WALL, "stiffness", np.inf, "wall.stiffness must be finite [N/m]; got inf"),
        (WALL, "normal", [0, 0, 0], "wall.normal must have a length, as [0, 0, 1] for a floor; got [0.0, 0.0, 0.0]"),
        (WALL + HAND, "Hand.motion.frequency", -2.0, "oscillation.frequency must be >= 0 [Hz]; got -2.0"),
        (WALL + HAND, "Hand.mass", [1.0, 2.0, 3.0], "hand.mass must be one number [kg]; got shape (3,)"),
        (HAND, "damping", [1.0, 2.0, 3.0], "environment.damping has shape (); got shape (3,); make the plant with a value of the new shape"),
        (taut.environments.Spring(stiffness=(1.0, 1.0)), "stiffness", 3.0, "environment.stiffness has shape (6,); got shape (); make the plant with a value of the new shape"),
        (taut.environments.Spring(stiffness=1.0, at=[0, 0, 0]), "at.xyzw", [0, 0, 0, 2.0], "xyzw must have length 1; its length is 2; divide it by its length"),
        (taut.environments.Push(), "t", -1.0, "push.t must be >= 0 [s]; got -1.0"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("plant", [taut.RigidPlant, taut.MujocoPlant])
def test_a_parameter_is_checked_when_it_changes(
    plant: Any, environment: Any, path: str, value: Any, words: str
) -> None:
    made = plant(GANTRY, environment=environment)
    with pytest.raises(taut.TautError) as caught:
        made.checked_parameter(f"environment.{path}", value)
    assert str(caught.value) == words


def test_a_changed_parameter_is_kept_as_it_would_be_made() -> None:
    spring = taut.environments.Spring(stiffness=np.eye(6), at=taut.Pose([1, 2, 3]))
    plant = taut.RigidPlant(GANTRY, environment=spring + WALL)
    np.testing.assert_array_equal(
        plant.checked_parameter("environment.Spring.stiffness", (2.0, 3.0)), np.diag([2.0] * 3 + [3.0] * 3)
    )
    np.testing.assert_array_equal(plant.checked_parameter("environment.StiffWall.normal", [0, 3, 0]), [0, 1, 0])
    np.testing.assert_array_equal(plant.checked_parameter("environment.Spring.at.p", [1, 0, 0]), [1, 0, 0])
