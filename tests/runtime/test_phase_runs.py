"""Tasks in runs: approach until contact, press, retreat, in both kinds of plant; switching without a jump."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from refusals import refused

import taut

BOW = np.array([0.0, -0.3, 0.0, -2.2, 0.0, 2.0, 0.785])
GAP = 0.01  # [m] below the tool
TOUCH = 2.0  # [N]
STIFF = taut.laws.GravityPID(kp=[600, 600, 600, 600, 250, 150, 50], kd=[50, 50, 50, 50, 30, 20, 5])
PANDA = taut.load_arm("panda", tool="panda_hand_tcp")
LIMITS = taut.Limits.of(PANDA, rate=True, blend=0.05)
TOOL = taut.snapshot(PANDA, BOW).T()


def down(x: taut.Snapshot) -> taut.trajectories.Steady:
    return taut.trajectories.Steady(T0=x.T(), velocity=[0.0, 0.0, -0.02])


def deeper(x: taut.Snapshot) -> taut.TaskMotion:
    T = x.T()
    return taut.TaskMotion(pose=taut.Pose(T.p - [0.0, 0.0, 0.02], R=T.R))


def back(x: taut.Snapshot) -> taut.trajectories.Line:
    T = x.T()
    return taut.trajectories.Line(T0=T, T1=taut.Pose(T.p + np.array([0.0, 0.0, 0.05]), R=T.R), duration=0.8)


def press() -> list[taut.Phase]:
    """Down at 20 mm/s until 2 N, softly on for half a second, up again; the arm then rests in its joints."""
    move = taut.laws.TaskComputedTorque(kp=400.0, kd=40.0)
    touch = taut.guards.lasting(lambda x: taut.guards.contact(x, TOUCH, direction=[0, 0, 1]), ticks=3)
    return [
        taut.Phase(move, down, name="approach", until=touch, timeout=3.0),
        taut.Phase(
            taut.laws.TaskComputedTorque(kp=100.0, kd=40.0),
            deeper,
            name="press",
            until=lambda x: x.elapsed > 0.5,
            unless=taut.guards.lasting(lambda x: taut.guards.no_contact(x, 0.5), ticks=50),
        ),
        taut.Phase(
            move,
            back,
            name="retreat",
            until=lambda x: taut.guards.moved(x, 0.049) & taut.guards.settled(x, position=1e-3),
        ),
        taut.Phase(STIFF, name="rest"),
    ]


@pytest.fixture(scope="module")
def ctrl() -> taut.Controller:
    return taut.compile(press(), PANDA, limits=LIMITS)


def check_pressed(run: taut.Run) -> None:
    assert run.outcome.ok, run.outcome
    assert [(window.name, window.ended) for window in run.phases] == [
        ("approach", "until"),
        ("press", "until"),
        ("retreat", "until"),
        ("rest", None),
    ]
    normal = run.extra["F_ext"][:, 2]
    approach, pressed, _, rest = run.phases
    first = int(np.argmax(normal > TOUCH))
    assert approach.last - first in (2, 3)  # three ticks on end; what is measured may be that of the tick before
    assert normal[pressed.last] > TOUCH
    assert not normal[rest.first :].any()
    assert (np.abs(np.diff(run.command, axis=0)) <= np.asarray(LIMITS.tau_dot) / run.rate * (1.0 + 1e-9)).all()
    total = sum(values for values in run.terms.values())
    np.testing.assert_allclose(total, run.command, atol=1e-9)


def test_approach_press_and_retreat_in_a_fused_run_and_from_its_log(ctrl: taut.Controller, tmp_path: Path) -> None:
    wall = taut.environments.StiffWall(point=TOOL.p - [0, 0, GAP], normal=[0, 0, 1], stiffness=1e4, damping=50.0)
    run = taut.run(ctrl, taut.RigidPlant(PANDA, environment=wall), duration=2.6, q0=BOW, log=tmp_path / "run.mcap")
    check_pressed(run)
    # The blend begins with the command of the tick before: at the switch itself there is no jump at all.
    for window in run.phases[1:]:
        assert np.abs(run.command[window.first] - run.command[window.first - 1]).max() < 1e-9
    again = taut.load_run(tmp_path / "run.mcap")
    assert again.phases == run.phases
    assert again.outcome == run.outcome
    for name in ("approach", "rest"):  # one follows the tool, the other the joints
        one, other = run.phase(name), again.phase(name)
        assert type(one.reference) is type(other.reference)
        assert one.metrics.json() == other.metrics.json()
    assert isinstance(run.phase("approach").reference, taut.TaskMotion)
    assert run.phase("approach").metrics.task_peak < 1e-3
    assert isinstance(run.phase("rest").reference, taut.JointMotion)
    felt = np.vstack([np.zeros(6), run.extra["F_ext"][:-1]])  # what is measured is that of the step before
    stepped = np.array([ctrl.step(q, v, F_ext=F) for q, v, F in zip(run.q, run.v, felt, strict=True)])
    np.testing.assert_allclose(stepped, run.command, atol=1e-9)
    assert run.plot().axes


def test_approach_press_and_retreat_against_contact_in_mujoco(ctrl: taut.Controller) -> None:
    x, y, z = TOOL.p
    floor = f'<geom type="box" size="0.3 0.3 0.05" pos="{x} {y} {z - 0.05 - GAP - 0.01}" friction="0"/>'
    plant = taut.MujocoPlant(PANDA, scene=floor, tool_radius=0.01)
    check_pressed(taut.run(ctrl, plant, duration=2.6, q0=BOW))


def test_where_nothing_is_touched_the_task_stops_and_says_so() -> None:
    arm = taut.load_arm("planar3")
    task = [
        taut.Phase(taut.laws.ComputedTorque(kp=100.0, kd=20.0), name="approach", until=lambda x: taut.guards.contact(x, 2.0), timeout=0.2)
    ]  # fmt: skip
    plant = taut.RigidPlant(arm, environment=taut.environments.Push(peak=[5.0, 0.0, 0.0]))
    run = taut.run(task, plant, duration=0.5)
    assert not run.outcome.ok
    assert str(run.outcome) == "stopped: 501 ticks, 0.5 s; phases: approach to 0.2 s (timeout), stopped at 0.2 s"
    with refused(taut.errors.RangeError):
        run.phase("approach", 1)
    with refused(taut.errors.UnknownNameError):
        run.phase("aproach")
    plain = taut.run(taut.compile(task[0].law, arm), taut.RigidPlant(arm), duration=0.01)
    with refused(taut.errors.UsageError):
        plain.phases  # noqa: B018


PLANAR = taut.load_arm("planar3")
HERE = np.array([0.5, 0.8, 0.6])
PD = taut.laws.ComputedTorque(kp=100.0, kd=20.0)
WAIT = taut.Phase(PD, name="wait", until=lambda x: x.elapsed > 0.0095)


class Ends:
    """A trajectory that is known for 20 ms."""

    def at(self, t: float) -> taut.JointMotion:
        if t > 0.0205:
            raise LookupError("no more")
        return taut.JointMotion(q=HERE)


def asked(x: taut.Snapshot) -> taut.JointMotion:
    if x.t > 0.025:
        raise LookupError("no more")
    return taut.JointMotion(q=HERE)


FAILS: dict[str, tuple[taut.Phase, int, str]] = {
    "function": (
        taut.Phase(PD, lambda x: {}["target"], name="go"),  # type: ignore[arg-type, return-value]
        11,
        "its reference fails: KeyError: 'target' at {file}:",
    ),
    "trajectory": (taut.Phase(PD, Ends(), name="go"), 32, "its reference fails: LookupError: no more at {file}:"),
    "stream": (
        taut.Phase(PD, taut.stream(period=0.005, source=asked), name="go"),
        26,
        "its reference fails: LookupError: no more at {file}:",
    ),
    "size": (
        taut.Phase(PD, lambda x: taut.JointMotion(q=[0.0]), name="go"),
        11,
        "ref.q must have shape (3,); the reference gives (1,)",
    ),
}


@pytest.mark.parametrize("plant", [taut.RigidPlant(PLANAR), taut.MujocoPlant(PLANAR)], ids=["fused", "hosted"])
@pytest.mark.parametrize(("phase", "tick", "text"), FAILS.values(), ids=FAILS)
def test_a_reference_that_fails_ends_the_run_in_words_with_its_record(
    plant: taut.RigidPlant | taut.MujocoPlant, phase: taut.Phase, tick: int, text: str, tmp_path: Path
) -> None:
    log = tmp_path / "run.mcap"
    run = taut.run([WAIT, phase], plant, duration=0.1, q0=HERE, log=log)
    began = tick == 11
    assert (run.outcome.kind, len(run)) == ("stopped", tick)
    assert run.outcome.message.startswith(
        f"stopped at t = {tick / 1000:g} s (tick {tick}): phase 'go': {text.format(file=__file__)}"
    )
    assert run.outcome.message.endswith(
        "phases: wait to 0.01 s" if began else "phases: wait to 0.011 s, go until then"
    )
    assert [window.name for window in run.phases] == (["wait"] if began else ["wait", "go"])
    assert run.phase(run.phases[-1].name).outcome.kind == ("completed" if began else "stopped")
    again = taut.load_run(log)
    assert again.outcome == run.outcome
    np.testing.assert_array_equal(again.q, run.q)
    first = taut.Phase(phase.law, phase.reference, name="go")
    if began:  # where it is the first phase, nothing has happened, and there is no record to keep
        with refused(taut.TautError):
            taut.run([first], plant, duration=0.1, q0=HERE)


def test_a_reference_that_fails_beyond_the_end_of_its_phase_is_never_asked() -> None:
    task = [WAIT, taut.Phase(PD, Ends(), name="go", until=lambda x: x.elapsed > 0.0195), taut.Phase(PD)]
    assert taut.run(task, taut.RigidPlant(PLANAR), duration=0.1, q0=HERE).outcome.ok


@pytest.mark.parametrize("plant", [taut.RigidPlant(PLANAR), taut.MujocoPlant(PLANAR)], ids=["fused", "hosted"])
def test_a_guard_that_fails_as_plain_python_ends_the_run_in_words_with_its_record(plant: Any) -> None:
    def until(x: taut.Snapshot) -> Any:
        if float(np.asarray(x.t)) > 0.0305:
            raise LookupError("no more")
        return x.t < 0.0

    ctrl = taut.compile([taut.Phase(PD, name="go", until=until)], PLANAR, engine="float")
    run = taut.run(ctrl, plant, duration=0.1, q0=HERE)
    assert (run.outcome.kind, len(run)) == ("stopped", 31)
    assert run.outcome.message.startswith(
        f"stopped at t = 0.031 s (tick 31): until of phase 'go' fails: LookupError: no more at {__file__}:"
    )
    assert run.outcome.message.endswith("; phases: go until then")


def test_the_law_and_reference_of_a_phase_are_checked_where_it_begins() -> None:
    T = taut.snapshot(PANDA, BOW).T()
    height = float(T.p[2])
    board = taut.Constraint.plane(point=T.p, normal=[0.0, 0.0, 1.0])
    move = taut.laws.TaskComputedTorque(kp=100.0, kd=20.0)
    hybrid = taut.laws.HybridMotionForce(constraint=board, motion=move)
    plant = taut.RigidPlant(PANDA, environment=taut.environments.Push(peak=[0.0, 0.0, 0.0]))

    def off(x: taut.Snapshot) -> Any:
        up = taut.Pose([*x.T().p[:2], height + 0.05], R=x.T().R)
        return taut.pressing(taut.trajectories.Line(T0=x.T(), T1=up, duration=0.5), 5.0)

    def task(reference: Any, law: taut.Law = hybrid) -> list[taut.Phase]:
        first = taut.Phase(move, name="wait", until=lambda x: x.elapsed > 0.0015)
        return [first, taut.Phase(law, reference, name="slide", contact=lambda x: x.t > -1.0)]

    def run(reference: Any, law: taut.Law = hybrid) -> taut.Run:
        return taut.run(taut.compile(task(reference, law), PANDA, engine="float"), plant, duration=0.01, q0=BOW)

    seen = taut.snapshot(PANDA, BOW)
    words = "phase 'slide': the motion must keep to the constraint, and at t = "
    beside = hybrid + taut.laws.FrictionCompensation(at="meas")
    for ended in (run(off(seen)), run(off(seen), beside), run(taut.pressing(taut.TaskMotion(pose=T), lam=[3.0]))):
        assert (ended.outcome.kind, len(ended)) == ("stopped", 3)
        assert words in ended.outcome.message or "phase 'slide': lam must" in ended.outcome.message
    swaying = taut.Constraint.plane(point=T.p, normal=[0.0, 0.0, 1.0], sway=[0.0, 0.0, 0.05], period=2.0)
    level = taut.trajectories.Line(T0=T, T1=taut.Pose(T.p + np.array([0.05, 0.0, 0.0]), R=T.R), duration=0.5)
    ended = run(taut.pressing(level, 5.0), taut.laws.HybridMotionForce(constraint=swaying, motion=move))
    assert (ended.outcome.kind, len(ended)) == ("stopped", 3)  # where the surface is then is known when it begins
    assert words in ended.outcome.message
    hybrid = taut.laws.HybridMotionForce(constraint=swaying, motion=move, kfi=1.0)
    estimate = taut.laws.NormalEstimate(law=hybrid)  # along the surface, whatever the motion asks for against it
    assert run(taut.pressing(level, 5.0), estimate).outcome.ok
    squared = taut.Constraint(lambda T: (T.p[2] - height) ** 2)  # nor may the law itself be without a meaning there
    flat = taut.laws.HybridMotionForce(constraint=squared, motion=move)
    ended = run(lambda x: taut.pressing(taut.TaskMotion(pose=x.T())), flat)
    assert (ended.outcome.kind, len(ended)) == ("stopped", 3)
    assert "phase 'slide': row 0 of the constraint must have a gradient" in ended.outcome.message
    ended = run(off)
    assert (ended.outcome.kind, len(ended)) == ("stopped", 3)
    assert words in ended.outcome.message
    assert run(lambda x: taut.pressing(taut.TaskMotion(pose=x.T()), 5.0)).outcome.ok


@pytest.mark.part(1)
@pytest.mark.parametrize(("kind", "off", "tolerance"), [("fused", 0.02, 0.01), ("hosted", -0.003, 0.001)])
def test_a_phase_that_begins_off_its_surface_states_the_distance_and_the_tolerance(
    kind: str, off: float, tolerance: float
) -> None:
    """It presses on the floor, with several newtons, and states the surface somewhere else."""
    T = taut.snapshot(PANDA, BOW).T()
    touching = T.p - np.array([0.0, 0.0, 0.011])
    stated = taut.Constraint.plane(point=touching - np.array([0.0, 0.0, off]), normal=[0.0, 0.0, 1.0])
    move = taut.laws.TaskComputedTorque(kp=100.0, kd=20.0)
    hybrid = taut.laws.HybridMotionForce(constraint=stated, motion=move, kfi=5.0, tolerance=tolerance)
    task = [
        taut.Phase(
            taut.laws.Impedance(K=(800.0, 30.0), B=(60.0, 4.0)),
            lambda x: taut.trajectories.Steady(T0=x.T(), velocity=[0.0, 0.0, -0.05]),
            name="approach",
            until=lambda x: taut.guards.contact(x, 3.0),
            timeout=1.0,
        ),
        taut.Phase(hybrid, lambda x: taut.pressing(taut.TaskMotion(pose=x.T()), 5.0), name="press"),
    ]
    floor = taut.environments.StiffWall(point=touching, normal=[0.0, 0.0, 1.0], stiffness=1e4, damping=50.0)
    plant = {"fused": taut.RigidPlant, "hosted": taut.MujocoPlant}[kind](PANDA, environment=floor)
    run = taut.run(task, plant, duration=1.0, q0=BOW)
    assert [window.ended for window in run.phases[:2]] == ["until", "no contact"]
    k = run.phases[1].first
    phi = float(stated.at(taut.snapshot(PANDA, run.q[k])).phi[0])
    assert abs(phi) > tolerance
    force = float(np.linalg.norm(run.extra["F_ext"][k, :3]))
    assert force > 2.0
    assert f"phi of row 0 of its constraint is {phi:.3g}, and the tolerance is {tolerance:g}" in run.outcome.message
    assert f"{force:.3g} N measured" in run.outcome.message


class Counts(taut.Law):
    """A law that counts its ticks.

    Law:          tau = 0
    Closed loop:  M a + h = 0
    """

    needs_contact: ClassVar[bool] = True
    count = taut.Memory(notice="it counted")

    def command(self, x: taut.Snapshot, ref: taut.JointMotion, memory: Any, dt: float) -> Any:
        return taut.Torque(P=0.0 * x.q), {"count": memory.count + 1.0}


@pytest.mark.parametrize("plant", [taut.RigidPlant(PLANAR), taut.MujocoPlant(PLANAR)], ids=["fused", "hosted"])
def test_what_a_law_remembers_is_nothing_where_its_phase_does_not_act(plant: Any, tmp_path: Path) -> None:
    task = [
        WAIT,
        taut.Phase(Counts(), name="one", contact=lambda x: x.t > 0.0, until=lambda x: x.elapsed > 0.0035),
        taut.Phase(Counts(), name="two", contact=lambda x: x.t < 0.0, otherwise="rest"),
        taut.Phase(PD, name="rest"),
    ]
    log = tmp_path / "run.mcap"
    run = taut.run(task, plant, duration=0.1, q0=HERE, log=log)
    count = np.full(101, np.nan)
    count[11:16] = [1.0, 2.0, 3.0, 4.0, 5.0]
    np.testing.assert_array_equal(run.extra["law.one.count"], count)
    assert np.isnan(run.extra["law.two.count"]).all()  # it was refused in its only tick
    assert run.outcome.message.startswith(
        "completed: 101 ticks, 0.1 s; it counted in 5 of 101 ticks, first at t = 0.011 s; phases"
    )
    np.testing.assert_array_equal(run.phase("one").extra["law.one.count"], count[11:16])
    np.testing.assert_array_equal(taut.load_run(log).extra["law.one.count"], count)
    np.testing.assert_array_equal(run.arrays()["extra.law.one.count"], count)
    np.testing.assert_allclose(sum(run.terms.values()), run.command, atol=1e-9)  # terms are zero, not nothing
    assert all(np.isfinite(values).all() for values in run.terms.values())


def test_a_run_of_a_task_that_diverges_names_its_phases(tmp_path: Path) -> None:
    wild = taut.laws.PID(kp=1e12, kd=0.0)
    task = [WAIT, taut.Phase(wild, taut.JointMotion(q=HERE + 0.1), name="wild")]
    for plant in (taut.RigidPlant(PLANAR), taut.MujocoPlant(PLANAR)):
        run = taut.run(task, plant, duration=0.5, q0=HERE, log=tmp_path / "run.mcap")
        assert run.outcome.kind == "diverged"
        assert run.outcome.message.endswith("; phases: wait to 0.011 s, wild until then")
        assert [window.name for window in run.phases] == ["wait", "wild"]
        assert [run.phase(name).outcome.kind for name in ("wait", "wild")] == ["completed", "diverged"]
        assert taut.load_run(tmp_path / "run.mcap").outcome == run.outcome


def test_contact_that_was_lost_in_a_phase_is_not_lost_for_ever() -> None:
    """The last number of a law of force is none of what comes after it."""
    force = taut.laws.LossOfContact(law=taut.laws.ForceControl(kfi=5.0, kdamp=(100.0, 5.0)), patience=0.005)
    task = [
        taut.Phase(force, taut.TaskForce(F_app=[0, 0, -5.0, 0, 0, 0]), contact=lambda x: x.t > -1.0, name="press",
                   until=lambda x: x.elapsed > 0.0195),
        taut.Phase(STIFF, name="rest"),
    ]  # fmt: skip
    run = taut.run(
        task, taut.RigidPlant(PANDA, environment=taut.environments.Push(peak=[0.1, 0, 0])), duration=0.1, q0=BOW
    )
    assert run.extra["law.press.lost"][20] == 1.0
    assert run.metrics.contact_lost_time == pytest.approx(run.phase("press").metrics.contact_lost_time + 0.001)


def swing() -> list[taut.Phase]:
    """Three phases of two laws, one of them the same object twice, with a guard that counts and a timeout."""
    pid = taut.laws.PID(kp=80.0, kd=8.0, ki=300.0)
    return [
        taut.Phase(pid, lambda x: taut.trajectories.Quintic(q0=x.q, q1=x.q + 0.1, duration=0.04), name="one", timeout=0.0305, otherwise="two"),
        taut.Phase(PD, taut.JointMotion(q=HERE), name="two", until=taut.guards.lasting(lambda x: x.q[0] > 0.0, ticks=40)),
        taut.Phase(pid, name="three", until=lambda x: x.elapsed > 0.0195, then="one"),
    ]  # fmt: skip


def test_both_engines_and_a_step_give_the_same_task_with_events_and_gains_of_one_phase() -> None:
    limits = taut.Limits(tau=60.0, tau_dot=2000.0, blend=0.01)
    plant = taut.RigidPlant(PLANAR)
    at = {0.02: {"law.one.kp": 60.0}, 0.04: {"law.two.kp": 150.0}, 0.06: {"law.three.kp": 20.0}}
    events = [taut.Event(t=t, set=new) for t, new in at.items()]
    runs = [
        taut.run(taut.compile(swing(), PLANAR, limits=limits, engine=engine), plant, duration=0.15, q0=HERE, events=events)  # type: ignore[arg-type]
        for engine in ("native", "float")
    ]  # fmt: skip
    names = ["one", "two", "three", "one", "two"]
    for run in runs:
        assert [window.name for window in run.phases] == names
    for field in ("q", "v", "command"):
        np.testing.assert_allclose(getattr(runs[0], field), getattr(runs[1], field), rtol=0.0, atol=1e-9)
    assert (np.abs(np.diff(runs[0].command, axis=0)) <= 2.0 * (1.0 + 1e-9)).all()
    ctrl = taut.compile(swing(), PLANAR, limits=limits)
    for k, (q, v) in enumerate(zip(runs[0].q, runs[0].v, strict=True)):
        for path, value in at.get(k / 1000, {}).items():
            ctrl.parameters[path] = value
        np.testing.assert_allclose(ctrl.step(q, v), runs[0].command[k], rtol=0.0, atol=1e-9)
    assert ctrl.parameters["law.one.kp"] != ctrl.parameters["law.three.kp"]  # of one law object
    swung = taut.compile(swing(), PLANAR)
    other = taut.run(swung, taut.RigidPlant(PLANAR), duration=0.15, q0=HERE, events=events[:1])
    assert np.abs(other.command - runs[0].command).max() > 0.1  # and events change something


def test_a_task_whose_velocity_is_made_from_positions_takes_positions_alone() -> None:
    ctrl = taut.compile(swing(), PLANAR, sensing=taut.Sensing(velocity="difference"))
    run = taut.run(ctrl, taut.RigidPlant(PLANAR), duration=0.1, q0=HERE)
    stepped = np.array([ctrl.step(q) for q in run.q])
    np.testing.assert_allclose(stepped, run.command, rtol=0.0, atol=1e-9)


def test_noise_does_not_depend_on_when_phases_begin() -> None:
    arm = taut.load_arm("planar3")
    law = taut.laws.ComputedTorque(kp=100.0, kd=20.0)
    plant = taut.RigidPlant(arm, sensors=taut.sensors.Sensors(position=taut.sensors.Encoder(noise=1e-4)))
    q = taut.JointMotion(q=[0.5, 0.8, 0.6])
    split = [
        taut.Phase(law, q, until=lambda x: x.t > 0.0535),
        taut.Phase(law, q, until=lambda x: x.t > 0.1),
        taut.Phase(law, q),
    ]
    runs = [taut.run(one, plant, duration=0.6, q0=q.q, seed=3) for one in (split, split[2:])]
    np.testing.assert_array_equal(runs[0].q, runs[1].q)
    assert len(runs[0].phases) == 3


# -------------------------------------------------------------------- bars


def test_switching_leaves_no_torque_jump_above_the_rate_limit_and_no_integrator(
    share: Callable[[int], int], bar: Callable[[str, object], None]
) -> None:
    """1000 seeded starts and times of a push that makes the phases change."""
    arm = taut.load_arm("planar3")
    here = np.array([0.5, 0.8, 0.6])
    pid = taut.laws.PID(kp=80.0, kd=8.0, ki=300.0)
    task = [
        taut.Phase(pid, taut.JointMotion(q=here), name="wait", until=lambda x: taut.guards.contact(x, 5.0)),
        taut.Phase(pid, taut.JointMotion(q=here + 0.3), name="yield_", until=lambda x: x.elapsed > 0.1, then="away"),
        taut.Phase(taut.laws.ComputedTorque(kp=400.0, kd=40.0), taut.JointMotion(q=here - 0.3), name="away", until=lambda x: x.elapsed > 0.1, then="wait"),
    ]  # fmt: skip
    limits = taut.Limits(tau=60.0, tau_dot=400.0, blend=0.03)
    plant = taut.RigidPlant(arm, environment=taut.environments.Push(peak=[20.0, 0.0, 0.0], duration=0.02))
    loop = taut.Loop(taut.compile(task, arm, limits=limits), plant, duration=0.6)
    rng = np.random.default_rng(0)
    jump = rest = 0.0
    switches = 0
    for _ in range(share(share(1000))):
        q0, t = here + rng.uniform(-0.2, 0.2, 3), float(rng.uniform(0.02, 0.3))
        run = taut.run(loop, q0=q0, v0=rng.uniform(-0.5, 0.5, 3), events=[taut.Event.push(t=t)])
        assert [window.name for window in run.phases] == ["wait", "yield_", "away", "wait"]
        jump = max(jump, float(np.abs(np.diff(run.command, axis=0)).max()) / 0.4)
        for window in run.phases:
            switches += window.first > 0
            k = window.first
            error = np.asarray(run.reference.q)[k] - run.q[k] if window.name != "away" else 0.0
            rest = max(rest, float(np.abs(run.terms["I"][k] - 300.0 * error * 1e-3).max()))
    assert jump <= 1.0 + 1e-9
    assert rest < 1e-9
    bar("phases: switches", switches)
    bar("phases: largest torque jump per tick / rate limit", f"{jump:.6f}")
    bar("phases: integral left behind [N m]", f"{rest:.1e}")


def test_a_log_of_motion_and_force_reads_back_in_another_process(tmp_path: Path) -> None:
    arm = taut.load_arm("planar3")
    law = taut.laws.ComputedTorque(kp=100.0, kd=20.0)
    hybrid = taut.laws.HybridMotionForce(constraint=taut.Constraint.of_joints(lambda q: q[0] - 0.5), motion=law)
    task = [
        taut.Phase(law, name="wait", until=lambda x: x.elapsed > 0.01),
        taut.Phase(
            hybrid, lambda x: taut.pressing(taut.JointMotion(q=x.q)), name="along", contact=lambda x: x.t > 0.0
        ),
    ]
    run = taut.run(task, taut.RigidPlant(arm), duration=0.05, q0=[0.5, 0.8, 0.6])
    path = run.save(tmp_path / "run.mcap")
    code = (
        f"import taut; run = taut.load_run({str(path)!r}); one = run.phase('along');"
        "print(type(one.reference).__name__, one.reference.q.tolist() == one.reference.motion.q.tolist(), run.outcome)"
    )
    done = subprocess.run([sys.executable, "-W", "ignore", "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == f"HybridMotion True {run.outcome}"
