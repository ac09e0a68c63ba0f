"""References on their way into a run: each tick gets its sample, asked for at the right time and no oftener."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import refused
from runtime_laws import TINY, Array, AtOnly, HandPlant, Seen, Spring, TorqueOf, seen

import taut
from taut.control.tasks.feed import ReferenceFeed
from taut.control.trajectories.reference import Sample, Stream
from taut.runtime import ongoing

ARM = taut.load_arm("planar2")
WAVE = taut.trajectories.Sine(center=[0.1, 0.2], amplitude=0.3, frequency=2.0)


PLANTS: dict[str, Callable[[], Any]] = {
    "fused": lambda: taut.RigidPlant(ARM, adds=("gravity", "coriolis")),
    "hosted": lambda: HandPlant(),
}


def run(plant: Any, ref: object = None, *, law: taut.Law | None = None, **options: Any) -> taut.Run:
    ctrl = taut.compile(law or TorqueOf(), ARM, adds=plant.adds)
    options.setdefault("duration", 0.02)
    return taut.run(ctrl, plant, ref, **options)


@pytest.mark.parametrize("plant", PLANTS.values(), ids=PLANTS)
class TestHolds:
    def test_a_bare_sample_a_hold_of_it_and_a_hold_of_the_first_state(self, plant: Callable[[], Any]) -> None:
        motion = taut.JointMotion(q=[0.5, -0.5], v=[0.1, 0.2], a=[0.3, 0.4])
        for ref in (motion, taut.hold(motion)):
            out = run(plant(), ref)
            for name in ("q", "v", "a"):
                wanted = getattr(out.reference, name)
                np.testing.assert_array_equal(wanted, np.broadcast_to(getattr(motion, name), (21, 2)))
        for ref in (None, taut.hold()):
            out = run(plant(), ref, q0=[0.7, 0.8], v0=[1.0, 2.0])
            np.testing.assert_array_equal(out.reference.q, np.broadcast_to([0.7, 0.8], (21, 2)))
            assert not out.reference.v.any()
            assert not out.reference.a.any()


@pytest.mark.parametrize("plant", PLANTS.values(), ids=PLANTS)
class TestTrajectories:
    def test_give_each_tick_its_own_sample_with_rows_or_at_alone(self, plant: Callable[[], Any]) -> None:
        rows, alone = run(plant(), WAVE), run(plant(), AtOnly(WAVE))
        for k, t in enumerate(rows.t):
            np.testing.assert_array_equal(rows.reference.q[k], WAVE.at(t).q)
            np.testing.assert_array_equal(rows.reference.a[k], WAVE.at(t).a)
        np.testing.assert_allclose(alone.reference.a, rows.reference.a, rtol=1e-14)

    def test_are_asked_for_times_in_the_run_only_and_not_all_at_once(
        self, plant: Callable[[], Any], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """A reference that knows the past only must not be asked for the end at the start."""
        monkeypatch.setattr(ReferenceFeed, "block", 8)
        wave = AtOnly(WAVE)
        run(plant(), wave)
        assert sorted(set(wave.asked)) == pytest.approx([k * 1e-3 for k in range(21)])
        assert len(wave.asked) <= 22  # the first one may be asked twice: for the start, and for the tick

    def test_that_break_off_leave_a_log_of_what_came_before(
        self, plant: Callable[[], Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
    ) -> None:
        monkeypatch.setattr(ReferenceFeed, "block", 8)
        monkeypatch.setattr(ongoing, "LOG_PERIOD", 0.0)

        class Breaks:
            def at(self, t: float) -> taut.JointMotion:
                if t > 0.0105:
                    raise ZeroDivisionError("mine")
                return taut.JointMotion(q=[0.0, 0.0])

        log = tmp_path / "run.mcap"
        out, kept = run(plant(), Breaks(), log=log), taut.load_run(log)
        assert (len(out), out.outcome.kind, out.outcome.tick) == (11, "stopped", 10)
        assert kept.outcome == out.outcome
        np.testing.assert_array_equal(kept.q, out.q)

    def test_that_run_out_rest_at_their_ends(self, plant: Callable[[], Any]) -> None:
        out = run(plant(), taut.trajectories.Quintic(q0=[0.0, 0.0], q1=[1.0, -1.0], duration=0.01))
        np.testing.assert_array_equal(out.reference.q[10:], np.broadcast_to([1.0, -1.0], (11, 2)))
        assert not out.reference.v[11:].any()


# -------------------------------------------------------------------- chunks


@pytest.mark.parametrize("plant", PLANTS.values(), ids=PLANTS)
class TestChunks:
    def test_are_linear_in_between_and_held_at_rest_after_the_end(self, plant: Callable[[], Any]) -> None:
        ref = taut.chunk([0.0, 0.004, 0.010], [[0.0, 0.0], [0.4, 0.0], [0.4, 0.6]])
        out = run(plant(), ref)
        ticks = np.arange(21)
        np.testing.assert_allclose(out.reference.q[:, 0], np.minimum(ticks, 4) * 0.1, atol=1e-15)
        np.testing.assert_allclose(out.reference.q[:, 1], np.clip(ticks - 4, 0, 6) * 0.1, atol=1e-15)
        assert out.reference.v[2].any()
        assert not out.reference.v[11:].any()

    def test_of_one_sample_are_that_sample(self, plant: Callable[[], Any]) -> None:
        out = run(plant(), taut.chunk([0.0], [[0.3, 0.4]]))
        np.testing.assert_array_equal(out.reference.q, np.broadcast_to([0.3, 0.4], (21, 2)))

    def test_of_samples_keep_their_accelerations(self, plant: Callable[[], Any]) -> None:
        samples = [taut.JointMotion(q=[0.0, 0.0], a=[1.0, 2.0]), taut.JointMotion(q=[1.0, 1.0], a=[3.0, 2.0])]
        out = run(plant(), taut.chunk([0.0, 0.01], samples))
        np.testing.assert_allclose(out.command[:11, 0], 1.0 + 0.2 * np.arange(11), atol=1e-12)


# -------------------------------------------------------------------- streams


@pytest.mark.parametrize("plant", PLANTS.values(), ids=PLANTS)
class TestStreams:
    def test_ask_once_a_period_with_the_state_and_time_of_that_tick(self, plant: Callable[[], Any]) -> None:
        asked: list[taut.Snapshot] = []

        def source(x: taut.Snapshot) -> taut.JointMotion:
            asked.append(x)
            return taut.JointMotion(q=x.q, a=[float(len(asked)), 0.5])

        out = run(plant(), taut.stream(period=0.005, source=source), q0=[0.2, 0.4], v0=[0.1, 0.0])
        assert [x.t for x in asked] == pytest.approx([0.0, 0.005, 0.010, 0.015, 0.020])
        for x, k in zip(asked, (0, 5, 10, 15, 20), strict=True):
            np.testing.assert_array_equal(x.q, out.q[k])
            np.testing.assert_array_equal(x.v, out.v[k])
            np.testing.assert_array_equal(out.reference.q[k], out.q[k])
        np.testing.assert_array_equal(out.command[:, 0], np.minimum(np.arange(21) // 5 + 1, 5))

    @pytest.mark.parametrize(
        ("period", "ticks"),
        [
            (1.0 / 300.0, [0, 4, 7, 10, 14, 17, 20]),  # 300 Hz at 1 kHz: three and a third ticks, on average kept
            (0.001, list(range(21))),
            (0.0004, list(range(21))),  # faster than the loop: every tick, and no oftener
            (0.007, [0, 7, 14]),
            (1.0, [0]),
        ],
    )
    def test_keep_their_period_on_average(self, plant: Callable[[], Any], period: float, ticks: list[int]) -> None:
        asked: list[float] = []

        def source(x: taut.Snapshot) -> taut.JointMotion:
            asked.append(x.t)
            return taut.JointMotion(q=[0.0, 0.0])

        run(plant(), taut.stream(period=period, source=source))
        assert [round(t * 1000.0) for t in asked] == ticks

    def test_may_answer_with_chunks_that_start_when_they_come(self, plant: Callable[[], Any]) -> None:
        def source(x: taut.Snapshot) -> object:
            start = 10.0 * x.t
            return taut.chunk([0.0, 0.004], [[start, 0.0], [start + 1.0, 0.0]])

        out = run(plant(), taut.stream(period=0.010, source=source))
        expected = [0.25 * min(k % 10, 4) + 0.01 * (k - k % 10) for k in range(21)]
        np.testing.assert_allclose(out.reference.q[:, 0], expected, atol=1e-12)
        assert not out.reference.v[6].any()

    def test_are_not_asked_again_because_of_an_event(self, plant: Callable[[], Any]) -> None:
        asked: list[float] = []

        def source(x: taut.Snapshot) -> taut.JointMotion:
            asked.append(x.t)
            return taut.JointMotion(q=[0.0, 0.0])

        made = plant()
        path = "plant.mass" if isinstance(made, HandPlant) else "plant.payload.mass"
        events = [taut.Event(t=k * 1e-3, set={path: 1.0}) for k in (0, 3, 5, 6)]
        run(made, taut.stream(period=0.005, source=source), events=events)
        assert asked == pytest.approx([0.0, 0.005, 0.010, 0.015, 0.020])

    def test_get_numbers_that_stay_what_they_were(self, plant: Callable[[], Any]) -> None:
        kept: list[tuple[taut.Snapshot, Array]] = []

        def source(x: taut.Snapshot) -> taut.JointMotion:
            kept.append((x, x.q.copy()))
            return taut.JointMotion(q=[0.0, 0.0], a=[1.0, 1.0])

        run(plant(), taut.stream(period=0.005, source=source))
        for x, q in kept:
            np.testing.assert_array_equal(x.q, q)


class TestTheSnapshotOfASource:
    def test_is_what_the_controller_sees_noise_and_all(self) -> None:
        sensors = taut.sensors.Sensors(
            position=taut.sensors.Encoder(noise=0.1, resolution=0.01), velocity=taut.sensors.Tachometer(noise=0.2)
        )
        plant = taut.RigidPlant(ARM, sensors=sensors)
        asked: list[taut.Snapshot] = []

        def source(x: taut.Snapshot) -> taut.JointMotion:
            asked.append(x)
            return taut.JointMotion(q=[0.0, 0.0])

        out = run(plant, taut.stream(period=0.002, source=source), law=Seen())
        for x, k in zip(asked, range(0, 21, 2), strict=True):
            np.testing.assert_allclose(x.q, seen(out, "q")[k], atol=1e-15)
            np.testing.assert_allclose(x.v, seen(out, "v")[k], atol=1e-15)

    def test_has_the_other_sensors_and_what_the_plant_adds(self) -> None:
        plant = taut.RigidPlant(ARM, environment=Spring(), adds=("gravity",))
        asked: list[taut.Snapshot] = []

        def source(x: taut.Snapshot) -> taut.JointMotion:
            asked.append(x)
            return taut.JointMotion(q=[0.0, 0.0], a=[1.0, 2.0])

        out = run(plant, taut.stream(period=0.010, source=source))
        np.testing.assert_array_equal(asked[1].F_ext, out.extra["F_ext"][9])
        x = taut.snapshot(ARM, out.q[9], out.v[9])
        arrived = out.tau[9] + x.g - ARM.viscous * out.v[10]  # the plant adds gravity, and friction takes its part
        np.testing.assert_allclose(asked[1].tau_meas, arrived, rtol=0.0, atol=1e-12)
        assert not asked[1].g.any()
        assert asked[1].Cv.any()
        np.testing.assert_array_equal(asked[1].T().p, taut.snapshot(ARM, out.q[10]).T().p)

    def test_carries_the_payload_that_an_event_brought(self) -> None:
        asked: list[Array] = []

        def source(x: taut.Snapshot) -> taut.JointMotion:
            asked.append(x.g)
            return taut.JointMotion(q=[0.0, 0.0])

        heavier = [taut.Event(t=0.010, set={"model.payload.mass": 2.0})]
        out = run(taut.RigidPlant(ARM), taut.stream(period=0.010, source=source), events=heavier)
        np.testing.assert_allclose(asked[0], taut.snapshot(ARM, out.q[0]).g)
        np.testing.assert_allclose(asked[1], taut.snapshot(ARM, out.q[10], payload=taut.Payload(mass=2.0)).g)


# -------------------------------------------------------------------- refused


class OtherSample(Sample):
    """A kind of sample that joint laws do not follow."""

    @classmethod
    def fields(cls, n: int) -> dict[str, tuple[int, ...]]:
        return {"x": (6,)}

    @classmethod
    def of(cls, values: Any) -> OtherSample:
        return cls()

    @classmethod
    def at_rest(cls, x: Any, tool: str | None) -> OtherSample:
        return cls()


class Gives:
    """A trajectory that gives one and the same thing from some time on."""

    def __init__(self, late: object, since: float = 0.0) -> None:
        self._late, self._since = late, since

    def at(self, t: float) -> Any:
        return self._late if t >= self._since else taut.JointMotion(q=[0.0, 0.0])


def broken(q: list[float]) -> taut.JointMotion:
    """A sample that was not checked when it was made."""
    return taut.JointMotion.of({"q": np.array(q), "v": np.zeros(2), "a": np.zeros(2)})


CASES: list[tuple[object, type[taut.TautError], str]] = [
    (OtherSample(), taut.errors.UsageError, "the law follows JointMotion; the reference gives OtherSample"),
    (taut.hold(OtherSample()), taut.errors.UsageError, "the law follows JointMotion; the reference gives OtherSample"),
    (Gives(OtherSample()), taut.errors.UsageError, "the law follows JointMotion; the reference gives OtherSample"),
    (Gives(None), taut.errors.UsageError, "the law follows JointMotion; the reference gives NoneType"),
    (taut.JointMotion(q=[0.0]), taut.errors.ShapeError, "ref.q must have shape (2,); the reference gives (1,)"),
    (taut.Pose(), taut.errors.UsageError, "a reference is a sample such as taut.JointMotion(q=...), taut.hold(), a trajectory with at(t), taut.stream(...) or taut.chunk(...); got Pose; a pose to go to is taut.TaskMotion(pose=...)"),
    (taut.load_arm, taut.errors.UsageError, "a reference is a sample such as taut.JointMotion(q=...), taut.hold(), a trajectory with at(t), taut.stream(...) or taut.chunk(...); got function"),
    (Gives(broken([0.0, np.nan]), since=0.0095), taut.errors.RangeError, "ref.q[1] must be finite; the reference gives nan at t = 0.01 s"),
    (taut.stream(period=0.01), taut.errors.UsageError, "a stream in a simulation needs source=, a function that gives the next sample"),
    (taut.stream(period=0.01, source=lambda x: None), taut.errors.UsageError, "the source of a stream must give a sample or a chunk; got NoneType at t = 0 s"),
    (taut.stream(period=0.01, source=lambda x: x.q if x.t > 0.005 else taut.JointMotion(q=x.q)), taut.errors.UsageError, "the source of a stream must give a sample or a chunk; got ndarray at t = 0.01 s"),
    (taut.stream(period=0.01, source=lambda x: OtherSample()), taut.errors.UsageError, "the law follows JointMotion; the reference gives OtherSample"),
    (taut.trajectories.Sine(center=[0.0, 0.0, 0.0], amplitude=1.0, frequency=1.0), taut.errors.ShapeError, "ref.q must have shape (2,); the reference gives (3,)"),
]  # fmt: skip


class Rows(Gives):
    """A trajectory whose rows are not as many as the times."""

    def rows(self, times: Array) -> taut.JointMotion:
        few = np.zeros((3, 2))
        return taut.JointMotion.of({"q": few, "v": few, "a": few})


CASES += [
    (Gives(taut.JointMotion(q=[0.0]), since=0.0095), taut.errors.ShapeError, "the samples of a reference must be of one kind and size"),
]  # fmt: skip


@pytest.mark.parametrize("plant", PLANTS.values(), ids=PLANTS)
@pytest.mark.parametrize(("ref", "kind", "message"), CASES, ids=range(len(CASES)))
def test_a_reference_that_does_not_fit_is_refused_in_words(
    plant: Callable[[], Any], ref: object, kind: type[taut.TautError], message: str
) -> None:
    if isinstance(ref, Stream) and "t = 0.01 s" in message:  # later: what came before is kept
        out = run(plant(), ref)
        assert (len(out), out.outcome.kind) == (10, "stopped")
        assert out.outcome.message == f"stopped at t = 0.01 s (tick 10): {message}"
        return
    with refused(kind):
        run(plant(), ref)


def test_rows_that_are_not_as_many_as_the_times_are_refused_in_words() -> None:
    with refused(taut.errors.ShapeError):
        run(HandPlant(), Rows(None))


def test_a_chunk_of_samples_of_different_sizes_is_refused_when_it_is_made() -> None:
    samples = [taut.JointMotion(q=[0.0, 0.0]), taut.JointMotion(q=[0.0])]
    with pytest.raises(taut.errors.ShapeError) as caught:
        taut.chunk([0.0, 1.0], samples)
    assert caught.value.name == "ref"


class SeenV(taut.Law):
    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        return taut.Torque(wanted=ref.a, v=x.v * TINY)


@pytest.mark.parametrize("plant", PLANTS.values(), ids=PLANTS)
def test_a_source_sees_the_velocity_that_the_law_sees(plant: Callable[[], Any]) -> None:
    """Differenced, where the controller differences: not what a sensor gives that nobody reads."""
    asked: list[Array] = []

    def source(x: taut.Snapshot) -> taut.JointMotion:
        asked.append(np.array(x.v))
        return taut.JointMotion(q=x.q, a=[1.0, -1.0])

    made = plant()
    ctrl = taut.compile(SeenV(), ARM, adds=made.adds, sensing=taut.Sensing(velocity="difference"))
    out = taut.run(ctrl, made, taut.stream(period=0.001, source=source), duration=0.01, v0=[0.3, -0.2])
    # What was asked for at a tick is in the snapshot of the law in that tick.
    np.testing.assert_allclose(np.array(asked), seen(out, "v")[: len(asked)], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("logged", [False, True])
@pytest.mark.parametrize("plant", PLANTS.values(), ids=PLANTS)
def test_what_does_not_fit_later_on_is_refused_before_the_first_tick(
    plant: Callable[[], Any], logged: bool, tmp_path: Path
) -> None:
    """A trajectory in degrees, such as of one that leaves the radians after half a second: with a log and without."""
    log = tmp_path / "run.mcap" if logged else None
    with pytest.raises(taut.errors.RangeError):
        run(plant(), Gives(broken([0.0, np.nan]), since=0.5), duration=1.0, log=log)
    assert not (tmp_path / "run.mcap").exists()
