"""Drives that take velocities and positions in MuJoCo: RigidPlant's motion where nothing is touched, and give beside."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from refusals import refused, warned

import taut

pytest.importorskip("mujoco")

SAME = 1e-10  # [rad | rad/s]: one formula, two programs
UR10 = taut.load_arm("ur10").with_joints(viscous=2.0, effort=np.inf)  # agreement is before the effort cuts anything
GANTRY = taut.load_arm("gantry3").with_joints(effort=np.inf)
DRIVES = taut.drives.Actuation(bandwidth=60.0, delay=0.008)


class VelocityOf(taut.Law):
    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Velocity:
        return taut.Velocity(wanted=ref.v)


class PositionOf(taut.Law):
    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Position:
        return taut.Position(wanted=ref.q)


LAWS: dict[str, taut.Law] = {"velocity": VelocityOf(), "position": PositionOf()}


def run(plant: Any, ref: Any = None, *, rate: float = 500.0, duration: float = 0.6, **options: Any) -> taut.Run:
    ctrl = taut.compile(LAWS[plant.takes], plant.arm, rate=rate)
    out = taut.run(ctrl, plant, ref, duration=duration, **options)
    assert out.outcome.ok, out.outcome
    return out


def both(arm: taut.Arm, takes: str, **options: Any) -> tuple[taut.Run, taut.Run]:
    """The same swing by a rigid plant and by MuJoCo, in two steps of a control period."""
    swing = taut.trajectories.Sine(center=arm.home, amplitude=0.2, frequency=1.5)
    rigid = taut.RigidPlant(arm, takes=takes, substeps=2, **options)
    mujoco = taut.MujocoPlant(arm, takes=takes, limits=None, timestep=1e-3, **options)
    v0 = np.linspace(0.3, -0.2, arm.n)
    one, other = (run(plant, swing, q0=arm.home + 0.1, v0=v0) for plant in (rigid, mujoco))
    return one, other


@pytest.mark.parametrize("arm", [UR10, GANTRY], ids=["ur10", "gantry3"])
def test_velocity_drives_have_the_speed_of_a_rigid_plants(arm: taut.Arm) -> None:
    ours, theirs = both(arm, "velocity", actuation=DRIVES)
    np.testing.assert_allclose(theirs.v, ours.v, rtol=0.0, atol=SAME)
    # A step of MuJoCo moves by its last speed, and the exact way is that of the mean: half a step of what v changed.
    apart = theirs.q - ours.q - 0.5e-3 * (ours.v - ours.v[0])
    assert np.abs(apart).max() < 2e-5
    assert np.abs(theirs.q - ours.q).max() > 2e-4


@pytest.mark.parametrize("arm", [UR10, GANTRY], ids=["ur10", "gantry3"])
def test_position_drives_are_where_a_rigid_plants_are(arm: taut.Arm) -> None:
    ours, theirs = both(arm, "position", actuation=DRIVES)
    np.testing.assert_allclose(theirs.q, ours.q, rtol=0.0, atol=SAME)
    assert np.abs(ours.v).max() > 0.5
    settled = ours.t > 0.15  # the speed is that of half a step ago; commands are a staircase
    a = np.gradient(ours.v, ours.t, axis=0)
    np.testing.assert_allclose(theirs.v[settled], (ours.v - 0.5e-3 * a)[settled], rtol=0.0, atol=4e-3)


@pytest.mark.parametrize("takes", ["velocity", "position"])
def test_a_payload_and_a_bandwidth_change_in_a_run_by_the_same_paths(takes: str) -> None:
    rigid, mujoco = (make(UR10, takes=takes, actuation=DRIVES) for make in (taut.RigidPlant, taut.MujocoPlant))
    paths = "actuation.bandwidth", "plant.friction.viscous", "plant.payload.mass"
    assert all(path in rigid.parameters and path in mujoco.parameters for path in paths)
    set_to = {"plant.payload.mass": 3.0, "actuation.bandwidth": 30.0}
    swing = taut.trajectories.Sine(center=UR10.home, amplitude=0.2, frequency=1.5)
    out = run(mujoco, swing, events=[taut.Event(t=0.1, set=set_to)])
    same = run(taut.RigidPlant(UR10, takes=takes, actuation=DRIVES), swing, events=[taut.Event(t=0.1, set=set_to)])
    column = "v" if takes == "velocity" else "q"
    scale = 1.0 if takes == "velocity" else 1e-2
    # RigidPlant has one step of 2 ms here, exact for a command that is held, as two of 1 ms are.
    np.testing.assert_allclose(getattr(out, column), getattr(same, column), rtol=0.0, atol=1e-9 * scale + SAME)


@pytest.mark.parametrize("takes", ["velocity", "position"])
def test_what_is_pushed_gives_way_by_the_inner_loops_stiffness(takes: str) -> None:
    """A slide, pushed: M kp of the loop against the force, with both poles where they were put."""
    push = taut.environments.Push(peak=[30.0, 0.0, 0.0], t=0.05, duration=10.0, shape="rectangular")
    plant = taut.MujocoPlant(GANTRY, takes=takes, friction=None, actuation=DRIVES, environment=push, timestep=1e-3)
    out = run(plant, taut.JointMotion(q=GANTRY.home), duration=0.5)
    M = taut.snapshot(GANTRY, GANTRY.home).M[0, 0]
    left = np.exp(-10.0 * 60.0 * 1e-3)
    stiffness = M * ((1.0 - left) / 1e-3) ** 2
    k = 2.0 * np.maximum(np.arange(len(out.t)) - 25, 0)  # steps since the push
    way = 30.0 / stiffness * (1.0 - left**k * (1.0 + k * (1.0 - left)))
    np.testing.assert_allclose(out.q[:, 0] - out.q[0, 0], way, rtol=0.0, atol=1e-6 * way[-1])
    np.testing.assert_allclose(out.tau[-1, 0], -30.0, rtol=1e-6)
    np.testing.assert_allclose(out.extra["F_ext"][-1, 0], 30.0, rtol=1e-9)
    assert not out.extra["tau_cut"].any()


def test_a_drive_pushes_against_a_wall_with_no_more_than_its_effort_and_comes_away_softly() -> None:
    """Into a wall of MuJoCo at 0.2 m/s, on for a while, and back: it never winds up."""
    arm = taut.load_arm("gantry3").with_joints(effort=[40.0, 500.0, 500.0])
    scene = '<mujoco><worldbody><geom type="box" size="0.05 1 1" pos="0.16 0 0"/></worldbody></mujoco>'
    x0 = float(taut.snapshot(arm, [0.0, 0.0, 0.0]).T().p[0])

    class There(taut.Law):
        def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Velocity:
            return taut.Velocity(wanted=taut.math.array([taut.math.where(x.t < 2.0, 0.2, -0.2), 0.0, 0.0]))

    plant = taut.MujocoPlant(arm, takes="velocity", actuation=DRIVES, scene=scene, friction=None)
    with warned(RuntimeWarning):
        out = taut.run(taut.compile(There(), arm, rate=500.0), plant, duration=3.0, q0=[0.0, 0.0, 0.0])
    assert out.outcome.ok
    pressed = (out.t > 1.2) & (out.t < 2.0)
    np.testing.assert_allclose(out.tau[pressed, 0], 40.0, rtol=1e-9)
    np.testing.assert_allclose(-out.extra["F_ext"][pressed, 0], 40.0, rtol=1e-3)
    assert np.abs(out.q[pressed, 0] - (0.1 - x0)).max() < 5e-3
    assert (out.extra["tau_cut"][pressed, 0] > 1.0).all()
    # The command turns at 2 s, 8 ms late; a loop that had wound up 0.16 m would stay at the wall for 0.8 s more.
    away = out.t > 2.15
    np.testing.assert_allclose(out.v[away, 0], -0.2, rtol=1e-3)
    assert np.abs(out.v[:, 0]).max() < 0.21


def test_dry_friction_is_overcome() -> None:
    """The integral part of the velocity loop gives what sticks; the speed is the asked one after it."""
    arm = taut.load_arm("gantry3").with_joints(coulomb=20.0)
    plant = taut.MujocoPlant(arm, takes="velocity", actuation=DRIVES)
    out = run(plant, taut.JointMotion(q=arm.home, v=[0.1, 0.0, 0.0]), duration=0.5)
    np.testing.assert_allclose(out.v[-1], [0.1, 0.0, 0.0], rtol=0.0, atol=1e-9)


def test_the_same_by_the_float_engine(monkeypatch: pytest.MonkeyPatch) -> None:
    runs = []
    for native in (True, False):
        if not native:
            monkeypatch.setattr(taut.codegen.native, "available", lambda: False)
        swing = taut.trajectories.Sine(center=GANTRY.home, amplitude=0.1, frequency=2.0)
        plant = taut.MujocoPlant(GANTRY, takes="position", actuation=DRIVES)
        ctrl = taut.compile(PositionOf(), GANTRY, rate=500.0, engine="native" if native else "float")
        runs.append(taut.run(ctrl, plant, swing, duration=0.1))
    np.testing.assert_allclose(runs[0].q, runs[1].q, rtol=0.0, atol=1e-13)


MESSAGES: dict[str, tuple[Callable[[], object], type[taut.TautError]]] = {
    "no bandwidth": (lambda: taut.MujocoPlant(GANTRY, takes="velocity"), taut.errors.UsageError),
    "another word": (lambda: taut.MujocoPlant(GANTRY, takes="power"), taut.errors.UsageError),
    "what is for torques": (
        lambda: taut.MujocoPlant(
            GANTRY, takes="position", actuation=taut.drives.Actuation(bandwidth=9.0, resolution=0.1)
        ),
        taut.errors.UsageError,
    ),
    "what is added": (
        lambda: taut.MujocoPlant(GANTRY, takes="position", actuation=DRIVES, adds=("gravity",)),
        taut.errors.UsageError,
    ),
    "too fast": (
        lambda: run(
            taut.MujocoPlant(GANTRY, takes="position", actuation=taut.drives.Actuation(bandwidth=[9.0, 300.0, 9.0]))
        ),
        taut.errors.RangeError,
    ),
}


@pytest.mark.parametrize("name", MESSAGES)
def test_says_what_is_wrong(name: str) -> None:
    make, kind = MESSAGES[name]
    with refused(kind):
        make()
