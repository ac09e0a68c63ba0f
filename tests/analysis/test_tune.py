"""Tuning: gradients against differences, optima against closed forms, constraints, and what goes wrong on the way."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from refusals import refused

import taut
from taut.analysis.run_gradient import RunGradient

Bar = Callable[[str, object], None]

laws = taut.laws


def run_cost(loop: taut.Loop, weights: dict[str, float], q0: Any, seed: int) -> float:
    """The named costs of a run, from its record."""
    run = taut.run(loop, q0=q0, seed=seed, progress=False)
    error = run.error if run.error is not None else run.task.position_error
    rows = {"tracking": error, "effort": run.tau, "speed": run.v}
    if "rotation" in weights:
        rows["rotation"] = run.task.rotation_error
    return sum(weight * float(np.mean(np.sum(rows[name] ** 2, axis=1))) for name, weight in weights.items())


# -------------------------------------------------------------------- gradients


@pytest.fixture(scope="module")
def noisy() -> tuple[taut.Loop, taut.Arm]:
    """A loop with all that stands in the way: noise, delay, a filter, limits, a payload that the law does not know."""
    arm = taut.load_arm("planar2").with_joints(effort=[40.0, 20.0])
    law = laws.ComputedTorque(kp=[60.0, 90.0], kd=12.0, ki=5.0)
    ctrl = taut.compile(
        law,
        arm,
        sensing=taut.Sensing(velocity=taut.sensors.Difference(cutoff=60.0)),
        limits=taut.Limits.of(arm, rate=True),
    )
    plant = taut.RigidPlant(
        arm.with_payload(0.5),
        friction=None,
        sensors=taut.sensors.Sensors(position=taut.sensors.Encoder(noise=1e-5), velocity=None),
        actuation=taut.drives.Actuation(delay=2e-3, bandwidth=300.0),
        substeps=2,
    )
    ref = taut.trajectories.Quintic(q0=[0.3, 0.8], q1=[0.7, 0.3], duration=0.4)
    return taut.Loop(ctrl, plant, ref, duration=0.5), arm


def test_the_gradient_is_that_of_central_differences(noisy: tuple[taut.Loop, taut.Arm]) -> None:
    loop, _ = noisy
    weights, paths = {"tracking": 1.0, "effort": 1e-5}, ("law.kp", "law.kd", "law.ki")
    tangent = RunGradient(loop, paths, weights)
    ways = {"law.kp": np.eye(4, 2), "law.kd": np.eye(4)[2], "law.ki": np.eye(4)[3]}
    q = np.array([0.3, 0.8])
    along = tangent.at({}, ways, q, np.zeros(2), 3)
    assert along.cost.mean() == pytest.approx(run_cost(loop, weights, q, 3), rel=1e-12)
    places: list[tuple[str, Any]] = [("law.kp", 0), ("law.kp", 1), ("law.kd", ()), ("law.ki", ())]
    run = taut.run(loop, q0=q, seed=3, progress=False)
    assert along.tau == pytest.approx(run.tau, rel=1e-9, abs=1e-9)
    for i, (path, place) in enumerate(places):
        kept = np.array(loop.parameters[path])
        h, costs = 1e-4 * float(kept[place]), []
        for shift in (2.0 * h, h, -h, -2.0 * h):
            moved = kept.copy()
            moved[place] += shift
            loop.parameters[path] = moved
            costs.append(run_cost(loop, weights, q, 3))
        loop.parameters[path] = kept
        differences = (-costs[0] + 8.0 * costs[1] - 8.0 * costs[2] + costs[3]) / (12.0 * h)
        assert along.cost_slopes[i].mean() == pytest.approx(differences, rel=1e-6)


def test_the_tool_has_the_same_cost_by_ticks_and_by_runs() -> None:
    arm = taut.load_arm("planar3")
    ctrl = taut.compile(laws.TaskComputedTorque(kp=80.0, kd=10.0), arm)
    x = taut.snapshot(arm, [0.3, 0.8, 0.4])
    T = x.T()
    target = taut.TaskMotion(pose=taut.Pose(np.asarray(T.p) + np.array([0.02, 0.01, 0.0]), R=np.asarray(T.R)))
    loop = taut.Loop(ctrl, taut.RigidPlant(arm, friction=None), target, duration=0.2)
    weights = {"tracking": 1.0, "rotation": 0.1, "speed": 1e-3}
    tangent = RunGradient(loop, ("law.kp",), weights)
    along = tangent.at({}, {"law.kp": np.ones(1)}, np.array([0.3, 0.8, 0.4]), np.zeros(3), 0)
    assert along.cost.mean() == pytest.approx(run_cost(loop, weights, [0.3, 0.8, 0.4], 0), rel=1e-9)


# -------------------------------------------------------------------- optima


def swing(kd: float = 0.2, duration: float = 6.0) -> taut.Loop:
    """M e_ddot + kd e_dot + kp e = 0 with M = 0.5 and kp = 50: omega_n = 10."""
    arm = taut.load_arm("one_joint", gravity=(0.0, 0.0, 0.0))
    ctrl = taut.compile(laws.GravityPID(kp=50.0, kd=kd), arm)
    return taut.Loop(ctrl, taut.RigidPlant(arm, friction=None), taut.JointMotion(q=[1.0]), duration=duration)


@pytest.fixture(scope="module")
def loop() -> taut.Loop:
    return swing(2.0)


def test_the_integral_of_the_squared_error_is_least_at_half_damping(loop: taut.Loop) -> None:
    """Of a step it is (1 + 4 zeta^2) / (4 zeta omega_n), least at zeta = 1/2: kd = M omega_n = 5."""
    tuned = taut.tune(loop, ("law.kd",), q0=[0.0])
    kd = float(tuned.parameters["law.kd"])
    assert kd == pytest.approx(5.0, rel=0.005)
    assert float(np.ravel(tuned.law.parameters()["kd"])[0]) == kd
    closed = {d: (1.0 + 4.0 * z * z) / (4.0 * z) for d, z in ((2.0, 0.2), (kd, kd / 10.0))}
    assert tuned.cost == pytest.approx(closed[kd] / closed[2.0], rel=0.01)
    assert float(loop.parameters["law.kd"]) == 2.0  # the loop is as it was
    assert tuned.before[0].cost * tuned.cost == pytest.approx(tuned.after[0].cost, rel=1e-9)
    assert tuned.ratios == {"loop": pytest.approx(tuned.cost)}


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_constraints_are_kept(noisy: tuple[taut.Loop, taut.Arm]) -> None:
    loop, arm = noisy
    limits = taut.Limits(tau=0.9 * arm.effort)
    tuned = taut.tune(
        loop, ("law.kp", "law.kd"), limits=limits, chatter=1.0, evaluations=25, seeds=(1, 2)
    )  # fmt: skip
    assert tuned.cost < 1.0
    assert tuned.after[0].chatter <= tuned.before[0].chatter * (1.0 + 1e-6)
    assert tuned.after[0].torque <= 1.0 + 1e-6
    free = taut.tune(loop, ("law.kp", "law.kd"), evaluations=25, seeds=(1, 2))
    assert free.after[0].chatter > free.before[0].chatter  # so that the constraint did something


@pytest.mark.long
def test_a_limit_of_the_torque_rate_is_kept_where_the_controller_has_none(loop: taut.Loop) -> None:
    """Next to the start it is kd kp / M, 200 N m/s; without a limit the best takes 4000."""
    limits = taut.Limits(tau_dot=[1500.0])
    tuned = taut.tune(
        loop, ("law.kp", "law.kd"), limits=limits, q0=[0.0], evaluations=40,
        bounds={"law.kp": (20.0, 200.0), "law.kd": (1.0, 20.0)},
    )  # fmt: skip
    assert tuned.after[0].rate <= 1.0 + 1e-6
    assert tuned.after[0].rate == pytest.approx(1.0, abs=1e-3)
    assert tuned.cost < 0.8


# -------------------------------------------------------------------- what goes wrong on the way


@pytest.mark.part(1)
@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"limits": taut.Limits(tau=[1e-3])}, "misses the torque limit of 'loop' by "),
        ({"chatter": 1e-6}, "misses the chatter of 'loop' by "),
    ],
)
def test_constraints_that_nothing_keeps_to_are_noted_with_the_nearest(
    loop: taut.Loop, asked: dict[str, Any], words: str
) -> None:
    tuned = taut.tune(loop, ("law.kd",), q0=[0.0], evaluations=4, **asked)
    note = tuned.notes[-1]
    assert words in note
    best = max(tuned.history, key=lambda trial: min(trial.slacks.values()))
    assert float(note.split(" by ")[1].split()[0]) == pytest.approx(-min(best.slacks.values()), rel=1e-2)


def test_what_ends_at_a_bound_is_told() -> None:
    loop = swing(2.0)  # of which kd = 5 is the best
    held = taut.tune(loop, ("law.kd",), q0=[0.0], bounds={"law.kd": (1.0, 3.0)})
    assert held.parameters["law.kd"] == pytest.approx(3.0)
    assert held.notes == ("law.kd ends at its high bound; bounds= moves it",)
    free = taut.tune(loop, ("law.kd",), q0=[0.0])
    assert free.notes == ()
    two = taut.load_arm("planar2")
    ctrl = taut.compile(laws.GravityPID(kp=20.0, kd=[0.5, 0.5]), two)
    both = taut.Loop(ctrl, taut.RigidPlant(two), taut.JointMotion(q=[0.6, 1.7]), duration=0.5)
    one = taut.tune(both, ("law.kd",), q0=two.home, bounds={"law.kd": (0.1, [0.6, 50.0])})
    assert one.notes == ("law.kd[0] ends at its high bound; bounds= moves it",)


def test_what_was_tuned_is_text_and_data(loop: taut.Loop) -> None:
    tuned = taut.tune(loop, ("law.kd",), q0=[0.0], evaluations=2)
    assert "after 2 trials" in str(tuned)
    assert tuned.notes[0] == "ended after 2 trials, which evaluations= allows"
    rows = tuned.json()["tables"]["loops"]
    assert [row["cost"] for row in rows] == [tuned.before[0].cost, tuned.after[0].cost]


@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")
def test_runs_that_diverge_are_told_and_never_best() -> None:
    loop = swing(2.0, duration=0.3)
    tuned = taut.tune(loop, ("law.kd",), bounds={"law.kd": (1.0, 5e4)}, q0=[0.0], evaluations=30)
    assert any("failed, the first: " in sentence for sentence in tuned.notes)
    assert float(tuned.parameters["law.kd"]) < 1000.0
    assert tuned.cost < 1.0


@pytest.mark.parametrize(
    "asked",
    [
        {"paths": "law.kd"},
        {"paths": ("law.kq",)},
        {"paths": ("law.ki",)},
        {"bounds": {"law.kd": (3.0, 4.0)}},
        {"bounds": {"law.kd": (4.0, 3.0)}},
        {"bounds": {"law.kp": (1.0, 2.0)}},
        {"cost": "traking"},
        {"cost": "rotation"},
        {"cost": {"tracking": -1.0}},
        {"evaluations": 0},
        {"seeds": ()},
        {"seeds": (-1,)},
        {"limits": 3.0},
        {"chatter": 0.0},
        {"loops": []},
        {"loops": [1]},
        {"loops": [3.0]},
    ],
)
def test_what_has_no_meaning_is_refused_in_words(loop: taut.Loop, asked: dict[str, Any]) -> None:
    given = {"loops": loop, "paths": ("law.kd",), "q0": [0.0], **asked}
    with refused(taut.TautError):
        taut.tune(given.pop("loops"), given.pop("paths"), **given)


def test_steps_have_no_gradient() -> None:
    arm = taut.load_arm("one_joint")
    ctrl = taut.compile(laws.GravityPID(kp=5.0, kd=1.0), arm)
    plant = taut.RigidPlant(arm, sensors=taut.sensors.Sensors(position=taut.sensors.Encoder(resolution=1e-3)))
    stepping = taut.Loop(ctrl, plant, taut.JointMotion(q=[1.0]), duration=0.1)
    with refused(taut.errors.UsageError):
        taut.tune(stepping, ("law.kd",))


def test_a_law_of_forces_is_tuned_by_its_effort_and_has_no_tracking_error() -> None:
    arm = taut.load_arm("planar2")
    ctrl = taut.compile(laws.ForceControl(kfp=1.0, kdamp=(20.0, 2.0)), arm)
    wall = taut.environments.Spring(stiffness=(1e3, 0.0))
    loop = taut.Loop(
        ctrl, taut.RigidPlant(arm, environment=wall), taut.TaskForce(F_app=[1.0, 0, 0, 0, 0, 0]), duration=0.05
    )
    tuned = taut.tune(loop, ("law.kdamp",), cost="effort", q0=[0.3, 0.8], evaluations=2)
    assert np.isnan(tuned.before[0].rms_error)
    with refused(taut.errors.UnknownNameError):
        taut.tune(loop, ("law.kdamp",), q0=[0.3, 0.8])


# -------------------------------------------------------------------- the bar


def panda_loops(first: int, count: int, *, measured: bool) -> dict[str, taut.Loop]:
    """Paths through random poses, with 1 kg that the law does not know and encoders of 1e-5 rad noise.

    Velocities are differences of what the encoders read, or come from tachometers without noise; then gains are
    those of each joint.
    """
    arm = taut.load_arm("panda")
    limits, encoder = taut.Limits.of(arm, rate=True), taut.sensors.Encoder(noise=1e-5)
    sensors = (
        taut.sensors.Sensors(position=encoder) if measured else taut.sensors.Sensors(position=encoder, velocity=None)
    )
    plant = taut.RigidPlant(arm.with_payload(1.0), friction=None, sensors=sensors)
    gains: dict[str, Any] = {"kp": 100.0, "kd": 20.0, "ki": 0.0}
    law = laws.ComputedTorque(**{name: [value] * 7 if measured else value for name, value in gains.items()})
    sensing = taut.Sensing(velocity="measured" if measured else "difference")
    ctrl = taut.compile(law, arm, limits=limits, sensing=sensing)
    loops = {}
    for k in range(first, first + count):
        rng = np.random.default_rng(k)
        low, high = arm.lower + 0.1, arm.upper - 0.1
        points = [arm.home, *(np.clip(arm.home + rng.uniform(-0.5, 0.5, 7), low, high) for _ in range(3))]
        ref = taut.trajectories.Spline(times=[0.0, 1.0, 2.0, 3.0], points=np.array(points))
        loops[f"path {k}"] = taut.Loop(ctrl, plant, ref, duration=3.0)
    return loops


def runs_before_and_after(
    tuned: taut.analysis.Tuned, loop: taut.Loop, seeds: tuple[int, ...]
) -> list[tuple[taut.Run, taut.Run]]:
    """Runs of a loop that was in no tuning, with the parameters of the start and with those found."""
    runs = []
    for values in (tuned.start, tuned.parameters):
        for path, value in values.items():
            loop.parameters[path] = value
        runs.append([taut.run(loop, q0=loop.ref.at(0.0).q, seed=seed, progress=False) for seed in seeds])
    return list(zip(*runs, strict=True))


@pytest.mark.bars
def test_the_tracking_error_of_a_panda_with_an_unknown_payload_falls(share: Callable[[int], int], bar: Bar) -> None:
    whole = share(10) == 10
    bounds: dict[str, Any] = {"law.kp": (10.0, 1000.0), "law.kd": (5.0, 200.0), "law.ki": (0.0, 2000.0)}
    limits = taut.Limits.of(taut.load_arm("panda"), rate=True)
    for measured in (False, True) if whole else (False,):
        tuned = taut.tune(
            panda_loops(1, 3 if whole else 1, measured=measured), tuple(bounds), bounds=bounds,
            limits=limits, chatter=0.99, seeds=(0, 1, 2) if whole and not measured else (0,),
            evaluations=40 if whole else 6,
        )  # fmt: skip
        for before, after in zip(tuned.before, tuned.after, strict=True):
            assert after.torque <= 1.0
            assert after.rate <= 1.0 + 1e-9
            assert after.chatter <= before.chatter
        if whole and not measured:  # paths and noise that were in no tuning, nor looked at
            for name, loop in panda_loops(21, 10, measured=False).items():
                for b, a in runs_before_and_after(tuned, loop, (7, 8)):
                    assert np.sum(a.error**2) < 0.8 * np.sum(b.error**2), name
                    assert a.metrics.chatter.sum() <= b.metrics.chatter.sum(), name
        told, others = max(tuned.ratios.values()), 0.0
        for loop in panda_loops(11, 5 if whole else 1, measured=measured).values():
            ((b, a),) = runs_before_and_after(tuned, loop, (0,))
            others = max(others, float(np.sum(a.error**2) / np.sum(b.error**2)))
            assert measured or a.metrics.chatter.sum() <= b.metrics.chatter.sum()  # there it is the motion's own
        assert told <= 0.7
        assert others <= 0.8
        how = "measured velocity, 21 gains" if measured else "differenced velocity, 3 gains"
        bar(f"tune: Panda, 1 kg unknown, {how}: worst of the paths, of the start's cost", f"{told:.3f}")
        bar(f"tune: the same, {how}: worst of 5 held-out paths", f"{others:.3f}")
