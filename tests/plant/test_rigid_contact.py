"""Rigid contacts in a plant: against closed forms, with all that a plant has beside them."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import pytest
from plant_laws import TorqueOf
from scipy.integrate import solve_ivp

import taut
from taut import math as tm
from taut.arm.description import BASE, Arm, Body, Frame, Joint
from taut.base.types import Float64Array
from taut.record.run import Run

Array = Float64Array
MASS = taut.load_arm("gantry3")  # 21, 9 and 3 kg along x, y and z; its tool hangs 0.2 m below
FLOOR = taut.Constraint.plane(point=[0.0, 0.0, -0.2], normal=[0.0, 0.0, 1.0])
WEIGHT = 3.0 * 9.81
MU = 0.4


def run(
    contact: object,
    tau: object = (0.0, 0.0, 0.0),
    *,
    arm: taut.Arm = MASS,
    q0: object = None,
    v0: object = None,
    duration: float = 1.0,
    events: list[taut.Event] | None = None,
    engine: str = "auto",
    **plant: object,
) -> Run:
    """An arm in contact under constant torques."""
    made = taut.RigidPlant(arm, contact=contact, **{"friction": None, **plant})  # type: ignore[arg-type]
    ctrl = taut.compile(TorqueOf(), arm, engine=engine)  # type: ignore[arg-type]
    ref = taut.JointMotion(q=np.zeros(arm.n), a=np.asarray(tau, dtype=np.float64))
    return taut.run(ctrl, made, ref, duration=duration, q0=q0, v0=v0, events=events or [])  # type: ignore[arg-type]


def energy(run: Run, ticks: range) -> Array:
    states = [taut.snapshot(run.arm, run.q[k], run.v[k]) for k in ticks]
    return np.array([x.kinetic_energy + x.potential_energy for x in states])


@functools.cache
def bead() -> Run:
    sphere = taut.Constraint.sphere(center=[0.0, 0.0, -1.2], radius=1.0, one_sided=False)
    return run(sphere, v0=[1.0, 0.5, 0.0], duration=10.0)


def test_the_multiplier_of_a_bead_is_the_closed_form_at_every_tick() -> None:
    found, M = bead(), np.array([21.0, 9.0, 3.0])
    n = found.q - np.array([0.0, 0.0, -1.0])  # of length 1
    along = found.v - n * np.sum(n * found.v, axis=1, keepdims=True)
    wanted = (-9.81 * n[:, 2] + np.sum(along**2, axis=1)) / np.sum(n**2 / M, axis=1)
    np.testing.assert_allclose(found.extra["contact.lam"][:, 0], wanted, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found.extra["F_ext"][:, :3], -wanted[:, None] * n, atol=1e-8)


def test_a_bead_neither_drifts_nor_gains_energy_in_ten_seconds() -> None:
    found = bead()
    assert found.extra["contact.drift"].max() < 1e-12
    E = energy(found, range(0, 10001, 20))
    kinetic = 0.5 * np.array([21.0, 9.0, 3.0]) @ (found.v**2).max(axis=0)
    assert abs(E[-100:].mean() - E[:100].mean()) < 1e-3 * kinetic
    assert np.ptp(E) < 0.01 * kinetic  # it swings with the step, as semi-implicit Euler's does
    assert abs(found.extra["work.environment"][-1]) < 0.01 * kinetic


def test_a_falling_tool_jumps_as_its_restitution_says() -> None:
    floor = taut.RigidContact(constraint=FLOOR, restitution=0.8)
    found = run(floor, q0=[0.0, 0.0, 1.0], duration=3.0)
    z, v = found.q[:, 2], found.v[:, 2]
    turns = np.flatnonzero((v[1:] < 0.0) & (v[:-1] >= 0.0))
    tops = [float(z[k : k + 2].max()) for k in turns[1:5]]
    np.testing.assert_allclose(tops, 0.64 ** np.arange(1, 5), rtol=1e-4)
    assert z.min() >= 0.0


def test_without_restitution_it_stays_where_it_lands_and_gives_up_its_energy() -> None:
    found = run(FLOOR, q0=[0.0, 0.0, 0.2], duration=1.0)
    lands = int(np.argmax(found.extra["contact.lam"][:, 0] < 0.0))
    assert abs(found.t[lands] - np.sqrt(0.4 / 9.81)) < 2e-3
    assert -found.extra["contact.lam"][lands, 0] * 1e-3 == pytest.approx(3.0 * np.sqrt(2.0 * 9.81 * 0.2), rel=0.01)
    np.testing.assert_array_equal(found.extra["contact.on"][lands:, 0], 1.0)
    np.testing.assert_allclose(found.q[lands + 1 :, 2], 0.0, atol=1e-14)
    np.testing.assert_allclose(found.extra["contact.lam"][lands + 2 :, 0], -WEIGHT, rtol=1e-9)
    assert found.extra["work.environment"][-1] == pytest.approx(-WEIGHT * 0.2, rel=0.01)


def test_rebounds_end_in_rest() -> None:
    found = run(taut.RigidContact(constraint=FLOOR, restitution=0.3), q0=[0.0, 0.0, 0.1], duration=1.5)
    np.testing.assert_allclose(found.v[-200:, 2], 0.0, atol=1e-12)
    np.testing.assert_allclose(found.q[-200:, 2], 0.0, atol=1e-12)


@pytest.mark.part(2)
@pytest.mark.parametrize("direction", [0.0, 0.7, 2.5])
def test_friction_holds_just_inside_its_cone_and_not_outside(direction: float) -> None:
    floor, along = taut.RigidContact(constraint=FLOOR, friction=MU), np.array([np.cos(direction), np.sin(direction)])
    for share in (0.99, 1.01):
        found = run(floor, [*(share * MU * WEIGHT * along), 0.0])
        if share < 1.0:
            np.testing.assert_allclose(found.q[:, :2], 0.0, atol=1e-12)
            np.testing.assert_allclose(found.extra["F_ext"][:, :2], np.tile(-share * MU * WEIGHT * along, (1001, 1)))
        else:
            assert found.q[-1, :2] @ along > 1e-3
            np.testing.assert_allclose(np.linalg.norm(found.extra["F_ext"][:, :2], axis=1), MU * WEIGHT, rtol=1e-6)
            assert np.abs(found.extra["contact.slip"][:, 0] - found.v).max() < 1e-12


def test_a_sliding_tool_stops_after_the_closed_forms_time_and_way() -> None:
    found = run(taut.RigidContact(constraint=FLOOR, friction=MU), v0=[0.3, 0.0, 0.0])
    slows = MU * WEIGHT / 21.0
    assert found.q[-1, 0] == pytest.approx(0.3**2 / (2.0 * slows), rel=4e-3)
    stops = found.t[np.argmax(np.abs(found.v[:, 0]) < 1e-12)]
    assert stops == pytest.approx(0.3 / slows, abs=2e-3)
    assert found.extra["work.environment"][-1] == pytest.approx(-0.5 * 21.0 * 0.3**2, rel=1e-9)


def test_a_tool_with_another_mass_in_each_direction_slides_as_integrated() -> None:
    push, M = np.array([3.0, 5.0]), np.array([21.0, 9.0])

    def rates(_: float, y: Array) -> Array:
        speed = y[2:]
        return np.concatenate([speed, (push - MU * WEIGHT * speed / np.linalg.norm(speed)) / M])

    found = run(taut.RigidContact(constraint=FLOOR, friction=MU), [*push, 0.0], v0=[0.3, -0.2, 0.0], duration=0.1)
    wanted = solve_ivp(rates, (0.0, 0.1), [0.0, 0.0, 0.3, -0.2], rtol=1e-10, atol=1e-12).y[:, -1]
    np.testing.assert_allclose(found.q[-1, :2], wanted[:2], atol=1e-4)  # of a step of 1 ms
    np.testing.assert_allclose(found.v[-1, :2], wanted[2:], atol=2e-4)


def test_friction_acts_in_impacts_too() -> None:
    found = run(taut.RigidContact(constraint=FLOOR, friction=0.1), q0=[0.0, 0.0, 0.2], v0=[0.5, 0.0, 0.0])
    lands = int(np.argmax(found.extra["contact.lam"][:, 0] < 0.0))
    lost = 0.1 * 3.0 * np.sqrt(2.0 * 9.81 * 0.2) / 21.0
    assert found.v[lands, 0] - found.v[lands + 1, 0] == pytest.approx(lost, rel=0.01)


def test_a_contact_lets_go_where_a_constraint_that_holds_both_ways_pulls() -> None:
    up = [0.0, 0.0, WEIGHT + 3.0]
    free = run(FLOOR, up, duration=0.5)
    assert not free.extra["contact.lam"].any()
    np.testing.assert_array_equal(free.extra["contact.on"][1:, 0], 0.0)
    assert free.q[-1, 2] == pytest.approx(0.5 * 0.5**2, rel=5e-3)
    both = taut.Constraint.plane(point=[0.0, 0.0, -0.2], normal=[0.0, 0.0, 1.0], one_sided=False)
    held = run(both, up, duration=0.1)
    np.testing.assert_allclose(held.extra["contact.lam"][:, 0], 3.0, rtol=1e-9)


def test_a_moving_surface_takes_the_tool_along_and_does_work_on_it() -> None:
    lift = taut.Constraint(lambda T, t: T.p[2] + 0.2 - 0.05 * t**2, one_sided=True)
    found = run(lift, duration=1.0)
    np.testing.assert_allclose(found.q[:, 2], 0.05 * found.t**2, atol=1e-12)
    np.testing.assert_allclose(found.v[1:, 2], 0.1 * found.t[1:], atol=1e-12)
    np.testing.assert_allclose(found.extra["contact.lam"][1:, 0], -(WEIGHT + 0.3), rtol=1e-9)
    assert found.extra["work.environment"][-1] == pytest.approx(WEIGHT * 0.05 + 0.5 * 3.0 * 0.1**2, rel=2e-3)


@pytest.mark.long
def test_events_change_friction_in_both_engines_alike() -> None:
    floor = taut.RigidContact(constraint=FLOOR, friction=MU)
    push = [0.5 * MU * WEIGHT, 0.0, 0.0]
    events = [taut.Event(t=0.05, set={"contact.friction": 0.1})]
    runs = [run(floor, push, duration=0.12, events=events, engine=engine) for engine in ("native", "float")]
    np.testing.assert_allclose(runs[0].q, runs[1].q, atol=1e-12)
    moved = runs[0].q[:, 0]
    np.testing.assert_allclose(moved[:50], 0.0, atol=1e-13)
    assert moved[-1] == pytest.approx(0.5 * (0.2 - 0.1) * WEIGHT / 21.0 * 0.07**2, rel=0.05)


def test_a_knife_edge_does_not_slip_sideways_wherever_it_turns() -> None:
    arm = taut.load_arm("planar3").with_gravity([0.0, 0.0, 0.0])
    edge = taut.Constraint.pfaffian(lambda T: tm.array([*T.R[:, 2], 0.0, 0.0, 0.0]))
    q0 = np.array([0.3, 0.8, -0.4])
    A = np.asarray(edge.at(taut.snapshot(arm, q0)).A_q)[0]
    v0 = np.array([0.5, -1.0, 2.0])
    v0 = v0 - A * (A @ v0) / (A @ A)
    found = run(edge, arm=arm, q0=q0, v0=v0)
    sideways = [edge.at(taut.snapshot(arm, found.q[k], found.v[k])).A_q @ found.v[k] for k in range(0, 1001, 50)]
    assert np.abs(sideways).max() < 1e-9
    E = energy(found, range(0, 1001, 10))
    assert np.ptp(E) < 0.01 * E[0]


PANDA = taut.load_arm("panda")
Q0 = np.array([0.0, -0.5, 0.0, -2.2, 0.0, 1.7, 0.8])
AT = taut.snapshot(PANDA, Q0)
NORMAL = np.array([0.1, 0.2, 1.0]) / np.linalg.norm([0.1, 0.2, 1.0])


def test_an_arm_presses_as_its_torques_say_and_the_wrist_feels_it() -> None:
    board = taut.Constraint.plane(point=AT.T().p, normal=NORMAL)
    tau = AT.g - AT.J().T @ np.concatenate([10.0 * NORMAL, np.zeros(3)])
    found = run(taut.RigidContact(constraint=board, friction=0.3), tau, arm=PANDA, q0=Q0, duration=0.01)
    np.testing.assert_allclose(found.extra["F_ext"][-1], [*(10.0 * NORMAL), 0.0, 0.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(found.q[-1], Q0, atol=1e-9)


def test_a_contact_at_another_point_of_the_tool_is_felt_with_its_moment() -> None:
    frame = "panda_link8"
    p = AT.T(frame).p
    board = taut.Constraint.plane(point=p, normal=NORMAL, frame=frame)
    tau = AT.g - AT.J(frame).T @ np.concatenate([10.0 * NORMAL, np.zeros(3)])
    found = run(taut.RigidContact(constraint=board, friction=0.3), tau, arm=PANDA, q0=Q0, duration=0.005)
    wanted = np.concatenate([10.0 * NORMAL, np.cross(p - AT.T().p, 10.0 * NORMAL)])
    np.testing.assert_allclose(found.extra["F_ext"][-1], wanted, atol=1e-6)
    elbow = taut.Constraint.plane(point=AT.T("panda_link4").p, normal=NORMAL, frame="panda_link4")
    assert "F_ext" not in taut.RigidPlant(PANDA, contact=elbow).measures


def test_a_face_that_lands_tilted_lies_down_and_holds_the_tilt_as_long_as_it_touches() -> None:
    looks = np.asarray(AT.T().R).T @ -NORMAL
    tilt = np.asarray(taut.Pose(rpy=[0.05, 0.0, 0.0]).R)
    board = taut.Constraint.plane(point=AT.T().p - 0.002 * NORMAL, normal=NORMAL, face=tilt @ looks)
    tau = AT.g - AT.J().T @ np.concatenate([10.0 * NORMAL, np.zeros(3)])
    found = run(board, tau, arm=PANDA, q0=Q0, duration=0.3)
    on = found.extra["contact.on"]
    assert not on[0].any()
    assert on[-1].all()
    end = board.at(taut.snapshot(PANDA, found.q[-1])).phi
    assert np.abs(end).max() < 1e-5
    assert np.abs(board.at(AT).phi[1:]).max() > 0.02


def test_an_arm_that_its_own_friction_holds_does_not_creep_in_contact() -> None:
    arm = PANDA.with_joints(coulomb=1.0, viscous=0.5)
    board = taut.Constraint.plane(point=AT.T().p, normal=NORMAL)
    tau = AT.g - AT.J().T @ np.concatenate([8.0 * NORMAL, np.zeros(3)])
    found = run(board, tau, arm=arm, q0=Q0, duration=0.5, friction="arm")
    np.testing.assert_allclose(found.v[10:], 0.0, atol=1e-12)  # two steps until friction knows what the board bears
    np.testing.assert_allclose(found.q[-1], Q0, atol=1e-5)
    through = tau - AT.g + AT.J().T @ found.extra["F_ext"][-1]
    assert np.abs(through).max() <= 1.0 + 1e-9  # what is left the joints' friction holds


def test_the_power_balance_of_the_drives_holds_in_contact() -> None:
    arm = PANDA.with_joints(rotor_inertia=0.2, viscous=0.5)
    board = taut.RigidContact(
        constraint=taut.Constraint.plane(point=AT.T().p - 0.003 * NORMAL, normal=NORMAL), friction=0.2
    )
    tau = AT.g - AT.J().T @ np.concatenate([20.0 * NORMAL + [5.0, 0.0, 0.0], np.zeros(3)])
    found = run(board, tau, arm=arm, q0=Q0, duration=0.2, friction="arm", energy=True)
    assert found.extra["contact.on"][-1, 0] == 1.0
    parts = {name.removeprefix("work."): x[-1] for name, x in found.extra.items() if name.startswith("work.")}
    taken = sum(parts[name] for name in ("rotor", "viscous", "link", "integration"))
    np.testing.assert_allclose(parts["motor"], taken, atol=1e-12)


GEARED = MASS.with_joints(rotor_inertia=[4.0, 3.0, 2.0])
SOFT = {"stiffness": 2e4, "damping": 50.0}
DRIVES: dict[
    str, tuple[taut.drives.Actuation, float, float]
] = {  # with the force, least and largest, that is left of 20 N
    "rigid": (taut.drives.Actuation(), 20.0, 20.0),
    "elastic": (taut.drives.Actuation(transmission=taut.drives.Transmission(**SOFT)), 20.0, 20.0),
    "backlash": (taut.drives.Actuation(transmission=taut.drives.Transmission(**SOFT, backlash=0.002)), 20.0, 20.0),
    "lossy": (taut.drives.Actuation(transmission=taut.drives.Transmission(efficiency=0.8)), 16.0, 16.0),
    "lossy and elastic": (
        taut.drives.Actuation(transmission=taut.drives.Transmission(efficiency=0.8, **SOFT)),
        16.0,
        25.0,
    ),
    "motor at its limit": (taut.drives.Actuation(motor=taut.drives.Motor(peak=12.0)), 12.0, 12.0),
    "slow amplifier": (taut.drives.Actuation(bandwidth=50.0, delay=0.002), 20.0, 20.0),
}


class Feels(taut.Law):
    """A law that keeps what the torque sensors gave.

    Law:          tau = a_des
    Closed loop:  none
    """

    felt = taut.Memory(record=True)

    def start(self, x: taut.Snapshot, ref: taut.JointMotion) -> dict[str, object]:
        return {"felt": x.tau_meas}

    def command(self, x: taut.Snapshot, ref: taut.JointMotion, memory: object, dt: float) -> object:
        return taut.Torque(P=ref.a), {"felt": x.tau_meas}


@pytest.mark.part(2)
@pytest.mark.parametrize("name", DRIVES)
def test_every_drive_presses_as_asked_and_its_torque_sensor_tells(name: str) -> None:
    """It falls on the floor first, which takes up the play; what the motor gives less the weight is what presses."""
    actuation, least, most = DRIVES[name]
    contact = taut.RigidContact(constraint=FLOOR, friction=MU)
    plant = taut.RigidPlant(GEARED, friction=None, contact=contact, actuation=actuation)
    ref = taut.JointMotion(q=np.zeros(3), a=[0.0, 0.0, -20.0])
    found = taut.run(taut.compile(Feels(), GEARED), plant, ref, duration=1.5, q0=[0.0, 0.0, 0.02])
    force = found.extra["F_ext"][-1, 2] - WEIGHT
    assert least * (1.0 - 1e-6) <= force <= most * (1.0 + 1e-6)  # gears that lose hold, too, so that both is at rest
    assert found.extra["law.felt"][-1] == pytest.approx([0.0, 0.0, -force], rel=1e-6, abs=1e-6)
    assert found.extra["contact.drift"].max() < 1e-9


@pytest.mark.parametrize("backlash", [0.0, 0.002])
def test_energy_does_not_grow_where_elastic_joints_bounce(backlash: float) -> None:
    """Restitution 1, springs without damping: the links, the rotors and the springs keep what they have, or less."""
    drives = taut.drives.Actuation(transmission=taut.drives.Transmission(stiffness=2e4, backlash=backlash))
    contact = taut.RigidContact(constraint=FLOOR, restitution=1.0)
    plant = {"actuation": drives, "energy": True, "substeps": 4}
    found = run(contact, arm=GEARED, q0=[0.0, 0.0, 0.05], v0=[0.3, 0.0, 0.0], duration=2.0, **plant)
    states = [taut.snapshot(MASS, found.q[k], found.v[k]) for k in range(0, 2001, 20)]  # of the links alone
    links = np.array([x.kinetic_energy + x.potential_energy for x in states])
    stored = sum(found.extra[f"work.{name}"].sum(axis=1) for name in ("rotor", "spring"))[::20]
    total = links + stored
    down = found.v[:, 2] < 0.0
    assert (down[:-1] & ~down[1:]).sum() > 4  # it bounces
    fall = WEIGHT * 0.05
    assert total.max() - total[0] < 0.02 * fall  # semi-implicit Euler swings about what it keeps
    assert np.mean(total[-20:]) - total[0] < 0.003 * fall  # of second order in the step


def test_contacts_and_environments_act_together() -> None:
    spring = taut.environments.Spring(stiffness=100.0, at=[0.1, 0.0, -0.2])
    found = run(taut.RigidContact(constraint=FLOOR, friction=MU), environment=spring, duration=0.1)
    np.testing.assert_allclose(found.extra["F_ext"][:, 2], WEIGHT, rtol=1e-9)
    np.testing.assert_allclose(found.extra["F_ext"][:, 0], 0.0, atol=1e-9)  # the spring pulls 10 N, friction holds
    np.testing.assert_allclose(found.q, 0.0, atol=1e-12)


def test_several_contacts_hold_a_tool_in_a_corner() -> None:
    wall = taut.Constraint.plane(point=[0.0, 0.0, 0.0], normal=[-1.0, 0.0, 0.0])
    found = run((taut.RigidContact(constraint=FLOOR, friction=MU), wall), [50.0, 2.0, 0.0], duration=0.2)
    np.testing.assert_allclose(found.q, 0.0, atol=1e-9)
    lam = found.extra["contact.lam"][-1]
    assert lam[0] == pytest.approx(-WEIGHT, rel=1e-6)
    assert -50.0 - 1e-6 <= lam[1] <= -50.0 + MU * WEIGHT
    assert found.extra["F_ext"][-1, 1] == pytest.approx(-2.0, rel=1e-3)


def test_numbers_of_one_of_several_contacts_have_its_place_in_their_path() -> None:
    plant = taut.RigidPlant(MASS, contact=(taut.RigidContact(constraint=FLOOR, friction=MU), FLOOR))
    assert [path for path in plant.parameters if path.startswith("contact.")] == ["contact.0.friction"]
    assert plant.checked_parameter("contact.0.friction", 0.2) == 0.2


def test_joints_can_be_held_by_a_function_of_them() -> None:
    tied = taut.Constraint.of_joints(lambda q: q[0] - 2.0 * q[1])
    found = run(tied, [3.0, 0.0, WEIGHT], duration=0.5)
    np.testing.assert_allclose(found.q[:, 0], 2.0 * found.q[:, 1], atol=1e-12)
    np.testing.assert_allclose(found.v[-1, 1], 0.5 * 2.0 * 3.0 / (4.0 * 21.0 + 9.0), rtol=1e-9)
    assert "F_ext" not in found.extra


def five_bar() -> taut.Arm:
    """Two arms of two links each on one base, cut open where their ends are pinned together."""
    y, feet = np.array([0.0, 1.0, 0.0]), ([-0.1, 0.0, 0.0], [0.1, 0.0, 0.0])
    joints = tuple(
        Joint(
            name=name,
            kind="revolute",
            parent=BASE if i % 2 == 0 else i - 1,
            placement=taut.Pose(feet[i // 2] if i % 2 == 0 else [0.3, 0.0, 0.0]),
            axis=y,
        )
        for i, name in enumerate(("left1", "left2", "right1", "right2"))
    )
    bodies = (Body(mass=1.0, com=np.array([0.15, 0.0, 0.0]), inertia=np.diag([1e-3, 8e-3, 8e-3])),) * 4
    ends = tuple(
        Frame(name=name, body=i, placement=taut.Pose([0.3, 0.0, 0.0])) for name, i in (("left", 1), ("right", 3))
    )
    return Arm(
        name="five_bar", joints=joints, bodies=bodies, frames=ends, tool="left", home=np.array([-2.0, 1.0, -1.1, -1.0]),
        gravity=np.array([0.0, 0.0, -9.81]), T_WB=taut.Pose(),
    )  # fmt: skip


def test_a_five_bar_stays_closed_and_keeps_its_energy() -> None:
    arm = five_bar()
    pin = taut.Constraint.pin("left", "right", directions=[[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    q0 = taut.dynamics.onto(pin, arm, arm.home)
    found = run(pin, arm=arm, q0=q0, duration=0.5, tau=np.zeros(4))
    assert found.extra["contact.drift"].max() < 1e-9
    assert np.ptp(found.q, axis=0).min() > 0.3
    E = energy(found, range(0, 501, 10))
    swing = np.ptp([taut.snapshot(arm, q).potential_energy for q in found.q[::10]])
    assert np.ptp(E) < 0.02 * swing
    for k in (0, 200, 400):  # the multipliers, from the equations of motion alone
        x = taut.snapshot(arm, found.q[k], found.v[k])
        rows = pin.at(x)
        A = np.asarray(rows.A_q)
        whole = np.block([[x.M, A.T], [A, np.zeros((2, 2))]])
        lam = np.linalg.solve(whole, np.concatenate([-np.asarray(x.h), -np.asarray(rows.bias)]))[4:]
        np.testing.assert_allclose(found.extra["contact.lam"][k], lam, rtol=1e-8, atol=1e-8)


def test_an_impact_whose_normal_and_friction_are_strongly_coupled_ends_in_its_step() -> None:
    """A UR10 once went on into this wall for 14 ticks: full steps of Newton's method alone do not converge here."""
    arm = taut.load_arm("ur10")
    q = np.array([0.792, -2.056, 2.363, -2.258, -1.032, -0.491])
    v = np.array([1.476, -0.265, -0.668, -3.021, -0.845, -0.604])
    n = np.array([-0.249, -0.915, -0.318]) / np.linalg.norm([-0.249, -0.915, -0.318])
    point = taut.snapshot(arm, q).T().p - 1e-4 * n
    wall = taut.RigidContact(constraint=taut.Constraint.plane(point=point, normal=n), friction=0.8)
    ctrl = taut.compile(taut.laws.GravityCompensation(), arm)
    run = taut.run(ctrl, taut.RigidPlant(arm, friction=None, contact=wall), taut.hold(), duration=0.03, q0=q, v0=v)
    x = [taut.snapshot(arm, *state) for state in zip(run.q, run.v, strict=True)]
    gaps = np.array([n @ (state.T().p - point) for state in x])
    rates = np.array([n @ (state.J()[:3] @ state.v) for state in x])
    assert rates[0] < -0.4
    assert (rates[gaps < 1e-9][1:] > -1e-4).all()
    assert (gaps > -1e-9).all()


@pytest.mark.part(2)
@pytest.mark.parametrize("friction", [None, 0.4])
@pytest.mark.parametrize("kind", ["cylinder", "sphere"])
def test_a_run_may_start_on_the_axis_of_a_hollow_where_the_distance_has_no_gradient(kind: str, friction: Any) -> None:
    middle = [0.0, 0.0, -0.2]
    if kind == "cylinder":
        hollow = taut.Constraint.cylinder(point=middle, axis=[0.0, 1.0, 0.0], radius=0.05, inside=True)
    else:
        hollow = taut.Constraint.sphere(center=middle, radius=0.05, inside=True)
    found = run(taut.RigidContact(constraint=hollow, friction=friction), duration=2.0)
    landed = int(np.sqrt(2.0 * 0.05 / 9.81) * 1000.0)
    np.testing.assert_allclose(found.q[: landed - 2, 2], -0.5 * 9.81 * found.t[: landed - 2] ** 2, atol=1e-3)
    np.testing.assert_allclose(found.q[-1], [0.0, 0.0, -0.05], atol=1e-9)
    assert found.extra["F_ext"][-1, 2] == pytest.approx(WEIGHT, rel=1e-9)
