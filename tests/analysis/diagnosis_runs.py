"""Runs with one planted fault each, and healthy ones, for tests of the doctor: every number is drawn from a seed."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

import taut
from taut.base.types import Float64Array

Array = Float64Array
L = taut.laws
ARMS = ("panda", "ur10", "so101", "xarm7", "kinova", "z1")
RATE = 1000.0


class Planted(NamedTuple):
    """A run, the finding that is right for it, and the term that is responsible."""

    run: taut.Run
    fault: str
    term: str


@functools.cache
def arm_of(name: str) -> taut.Arm:
    """The arm without friction."""
    return taut.load_arm(name).with_friction(taut.Friction())


@functools.cache
def inertia(name: str) -> Array:
    """(n,) what each joint moves, the others free, at home; of wrists no less than a hundredth of the largest."""
    return inertia_of(arm_of(name))


def inertia_of(arm: taut.Arm) -> Array:
    """The same of an arm as it is loaded."""
    x = taut.snapshot(arm, arm.home, np.zeros(arm.n))
    return np.asarray(1.0 / np.diag(np.linalg.inv(np.asarray(x.M))))


@functools.cache
def weight(name: str) -> float:
    """The largest gravity torque at home, and in the poses around it [N m]."""
    arm, rng = arm_of(name), np.random.default_rng(0)
    rows = [
        np.asarray(taut.snapshot(arm, arm.home + 0.2 * rng.normal(size=arm.n), np.zeros(arm.n)).g) for _ in range(8)
    ]
    return float(np.abs(rows).max())


def mass(name: str, part: float) -> float:
    """[kg] a payload that changes the largest gravity torque by about this part."""
    arm, rng = arm_of(name), np.random.default_rng(0)
    moved = []
    for _ in range(8):
        q = arm.home + 0.2 * rng.normal(size=arm.n)
        moved.append(
            np.asarray(taut.snapshot(arm.with_payload(1.0), q, np.zeros(arm.n)).g)
            - np.asarray(taut.snapshot(arm, q, np.zeros(arm.n)).g)
        )
    return part * weight(name) / float(np.abs(moved).max())


def joint_law(name: str, kind: str, omega: float = 10.0, zeta: float = 1.0, **more: Any) -> taut.Law:
    """A law of joints of that frequency and damping, in the unit of its gains."""
    if kind == "ComputedTorque":
        return L.ComputedTorque(kp=omega**2, kd=2.0 * zeta * omega, **more)
    m = inertia(name)
    cls = L.PID if kind == "PID" else L.GravityPID
    return cls(kp=omega**2 * m, kd=2.0 * zeta * omega * m, **more)


def plant_of(arm: taut.Arm, kind: str, **more: Any) -> Any:
    return taut.RigidPlant(arm, **more) if kind == "rigid" else taut.MujocoPlant(arm, **more)


def path(name: str, rng: np.random.Generator, size: float = 0.3, duration: float = 1.2) -> taut.trajectories.Quintic:
    arm = arm_of(name)
    return taut.trajectories.Quintic(
        q0=arm.home, q1=arm.home + size * rng.uniform(-1.0, 1.0, arm.n), duration=duration
    )


# -------------------------------------------------------------------- faults


def no_gravity(name: str, rng: np.random.Generator, kind: str) -> Planted:
    """A PD of joints on an arm that hangs in gravity."""
    law = joint_law(name, "PID", rng.uniform(15.0, 30.0))
    run = taut.run(taut.compile(law, arm_of(name)), plant_of(arm_of(name), kind), path(name, rng), duration=2.0)
    return Planted(run, "gravity not compensated", "P")


def payload(name: str, rng: np.random.Generator, kind: str, law: str = "") -> Planted:
    """A payload that the law does not know, or one that is not there."""
    m = mass(name, rng.uniform(0.25, 0.6))
    arm, there = arm_of(name), bool(rng.integers(2))
    believed, true = (arm, arm.with_payload(m)) if there else (arm.with_payload(m), arm)
    law = law or str(rng.choice(["GravityPID", "ComputedTorque"]))
    ctrl = taut.compile(joint_law(name, law, rng.uniform(8.0, 20.0)), believed)
    run = taut.run(ctrl, plant_of(true, kind), path(name, rng), duration=2.0)
    return Planted(run, "wrong payload", "gravity" if law == "GravityPID" else "nonlinear")


def gravity_twice(name: str, rng: np.random.Generator, kind: str) -> Planted:
    """A plant that takes gravity away and does not say so."""
    law = str(rng.choice(["GravityPID", "ComputedTorque"]))
    ctrl = taut.compile(joint_law(name, law, rng.uniform(15.0, 30.0)), arm_of(name))
    plant = plant_of(arm_of(name).with_gravity([0.0, 0.0, 0.0]), kind)
    run = taut.run(ctrl, plant, path(name, rng), duration=2.0)
    return Planted(run, "gravity compensated twice", "gravity" if law == "GravityPID" else "nonlinear")


def late_torque(name: str, rng: np.random.Generator, kind: str) -> Planted:
    """Damping that arrives late: kd is beyond what the drives' delay bears, pi / (2 delay)."""
    delay = 1e-3 * float(rng.integers(10, 20))
    kd = 1.3 * 0.5 * np.pi / delay
    law = L.ComputedTorque(kp=0.05 * kd**2, kd=kd)
    plant = plant_of(arm_of(name), kind, actuation=taut.drives.Actuation(delay=delay))
    start = arm_of(name).home + 1e-3 * rng.normal(size=arm_of(name).n)
    ctrl = taut.compile(law, arm_of(name), limits=taut.Limits.of(arm_of(name)))
    run = taut.run(ctrl, plant, taut.JointMotion(q=arm_of(name).home), duration=1.5, q0=start)
    return Planted(run, "oscillation", "delay")


def unstable_rate(name: str, rng: np.random.Generator, kind: str) -> Planted:
    """kd over the border 2 / T of a loop at 100 Hz."""
    rate = 100.0
    law = L.ComputedTorque(kp=100.0, kd=rng.uniform(2.02, 2.1) * rate)
    arm = arm_of(name)
    start = arm.home + 1e-4 * rng.normal(size=arm.n)
    ctrl = taut.compile(law, arm, rate=rate, limits=taut.Limits.of(arm))
    more = {} if kind == "mujoco" else {"substeps": 10}
    run = taut.run(ctrl, plant_of(arm, kind, **more), taut.JointMotion(q=arm.home), duration=2.5, q0=start)
    return Planted(run, "oscillation", "D")


def too_much_integral(name: str, rng: np.random.Generator, kind: str) -> Planted:
    """ki beyond kd kp."""
    omega = rng.uniform(12.0, 20.0)
    kp, kd = omega**2, omega
    law = L.ComputedTorque(kp=kp, kd=kd, ki=rng.uniform(1.05, 1.3) * kp * kd)
    arm = arm_of(name)
    start = arm.home + 0.02 * rng.normal(size=arm.n)
    run = taut.run(taut.compile(law, arm), plant_of(arm, kind), taut.JointMotion(q=arm.home), duration=3.0, q0=start)
    return Planted(run, "oscillation", "I")


def underdamped(name: str, rng: np.random.Generator, kind: str) -> Planted:
    """A spring with a fiftieth of critical damping."""
    law = joint_law(name, str(rng.choice(["ComputedTorque", "GravityPID"])), rng.uniform(20.0, 30.0), 0.02)
    arm = arm_of(name)
    start = arm.home + 0.05 * rng.normal(size=arm.n)
    run = taut.run(taut.compile(law, arm), plant_of(arm, kind), taut.JointMotion(q=arm.home), duration=2.5, q0=start)
    return Planted(run, "oscillation", "D")


def windup(name: str, rng: np.random.Generator, kind: str) -> Planted:
    """An integral without anti-windup, on a motion that asks for more torque than there is."""
    arm = arm_of(name)
    M = float(np.asarray(taut.snapshot(arm, arm.home, np.zeros(arm.n)).M)[0, 0])
    m = np.append(M, inertia(name)[1:])
    law = L.GravityPID(kp=100.0 * m, kd=20.0 * m, ki=150.0 * m * (np.arange(arm.n) == 0), anti_windup="none")
    way = np.zeros(arm.n)
    way[0] = rng.choice([-0.6, 0.6])
    ref = taut.trajectories.Quintic(q0=arm.home, q1=arm.home + way, duration=0.6)
    ctrl = taut.compile(law, arm, limits=taut.Limits(tau=np.full(arm.n, np.inf)))
    free = taut.run(ctrl, plant_of(arm, kind), ref, duration=0.6)
    most = np.full(arm.n, np.inf)
    most[0] = rng.uniform(0.35, 0.45) * float(
        np.abs(free.command[:, 0]).max()
    )  # of the base, which carries no weight
    ctrl.parameters["limits.tau"] = most
    run = taut.run(ctrl, plant_of(arm, kind), ref, duration=3.0)
    return Planted(run, "wind-up", "I")


def saturation(name: str, rng: np.random.Generator, kind: str) -> Planted:
    """A motion faster than the torque, the torque rate or the speed that there is."""
    arm = arm_of(name)
    which = str(rng.choice(["torque_limit", "speed_limit", "rate_limit"]))
    law = L.ComputedTorque(kp=100.0, kd=20.0)
    way = np.zeros(arm.n)
    way[0] = rng.choice([-0.5, 0.5])
    T = 0.5
    need = 5.77 * 0.5 / T**2 * float(np.asarray(taut.snapshot(arm, arm.home, np.zeros(arm.n)).M)[0, 0])

    def base(value: float) -> Array:
        """A limit of the base, which carries no weight, alone."""
        out = np.full(arm.n, np.inf)
        out[0] = value
        return out

    limits = {
        "torque_limit": taut.Limits(tau=base(rng.uniform(0.4, 0.6) * need)),
        "speed_limit": taut.Limits(v=base(rng.uniform(0.4, 0.6) * 1.875 * 0.5 / T)),
        "rate_limit": taut.Limits(tau_dot=base(rng.uniform(2.5, 3.5) * need / T)),
    }[which]
    ref = taut.trajectories.Quintic(q0=arm.home, q1=arm.home + way, duration=T)
    run = taut.run(taut.compile(law, arm, limits=limits), plant_of(arm, kind), ref, duration=1.5)
    return Planted(run, "saturation", which)


def chatter(name: str, rng: np.random.Generator, kind: str) -> Planted:
    """Noise of the encoders through a differenced velocity."""
    arm = arm_of(name)
    law = joint_law(name, "ComputedTorque", rng.uniform(15.0, 25.0))
    kd = float(np.asarray(law.kd.as_array()))
    M = np.diag(np.asarray(taut.snapshot(arm, arm.home, np.zeros(arm.n)).M))
    noise = rng.uniform(2.0, 4.0) * 0.01 * float(np.min(arm.effort / (M * kd))) / RATE
    sensors = taut.sensors.Sensors(position=taut.sensors.Encoder(noise=noise), velocity=None)
    ctrl = taut.compile(law, arm, sensing=taut.Sensing(velocity="difference"))
    run = taut.run(
        ctrl, plant_of(arm, kind, sensors=sensors), path(name, rng), duration=1.5, seed=int(rng.integers(99))
    )
    return Planted(run, "chatter", "D")


def sticking(name: str, rng: np.random.Generator, kind: str) -> Planted:
    """Dry friction that a soft spring does not overcome near its target."""
    arm = arm_of(name)
    law = joint_law(name, "GravityPID", 10.0)
    kp = np.asarray(law.kp.as_array())
    dry = kp * rng.uniform(0.03, 0.08)
    true = arm.with_friction(taut.Friction(coulomb=dry))
    run = taut.run(taut.compile(law, arm), plant_of(true, kind), path(name, rng), duration=2.0)
    return Planted(run, "stiction", "friction")


def jump(name: str, rng: np.random.Generator, kind: str) -> Planted:
    """A set-point that is far from where the arm starts."""
    arm = arm_of(name)
    M = np.asarray(taut.snapshot(arm, arm.home, np.zeros(arm.n)).M)
    way = np.zeros(arm.n)
    i = int(np.argmax(np.diag(M) / arm.effort))
    torque = rng.uniform(0.35, 0.6) * arm.effort[i]
    kp = max(400.0, torque / (0.5 * M[i, i]))
    law = L.ComputedTorque(kp=kp, kd=2.0 * np.sqrt(kp))
    way[i] = torque / (kp * M[i, i])
    run = taut.run(taut.compile(law, arm), plant_of(arm, kind), taut.JointMotion(q=arm.home + way), duration=1.5)
    return Planted(run, "torque jump at the start", "P")


def wrong_sign(name: str, rng: np.random.Generator, kind: str) -> Planted:
    """A spring that is turned round."""
    arm = arm_of(name)
    law = Reversed(kp=20.0, kd=10.0)
    start = arm.home + 0.01 * rng.normal(size=arm.n)
    ctrl = taut.compile(law, arm, limits=taut.Limits.of(arm))
    run = taut.run(ctrl, plant_of(arm, kind), taut.JointMotion(q=arm.home), duration=1.2, q0=start)
    return Planted(run, "wrong sign", "P")


class Reversed(taut.Law):
    """Computed torque with e = actual - wanted.

    Law:          tau = M (- kp e - kd v) + h
    Closed loop:  e_ddot + kd e_dot - kp e = 0
    """

    kp: taut.Gain  # [1/s^2]
    kd: taut.Gain  # [1/s]

    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        e = x.difference(ref.q)
        return taut.Torque(x.M @ taut.Terms(P=-(self.kp @ e), D=-(self.kd @ x.v)) + taut.Terms(nonlinear=x.h))


class OneTurned(taut.Law):
    """Computed torque through drives the last but one of which turns against its torque.

    Law:          tau = s (M (kp e - kd v) + h), with s = -1 at one joint
    Closed loop:  e_ddot + kd e_dot + kp e = 0 were s = 1
    """

    kp: taut.Gain  # [1/s^2]
    kd: taut.Gain  # [1/s]

    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        s = np.diag(turned_sign(x.n))
        e = x.difference(ref.q)
        return taut.Torque(P=s @ (x.M @ (self.kp @ e)), D=-(s @ (x.M @ (self.kd @ x.v))), nonlinear=s @ x.h)


def turned_sign(n: int) -> Array:
    """(n,) -1 at the joint whose drive is turned round."""
    return np.where(np.arange(n) == max(n - 2, 0), -1.0, 1.0)


def turned_drive(name: str) -> taut.Run:
    """A drive that is turned round, as its controller records it: it does not know."""
    arm = arm_of(name)
    ctrl = taut.compile(OneTurned(kp=100.0, kd=20.0), arm)
    run = taut.run(ctrl, taut.RigidPlant(arm), taut.JointMotion(q=arm.home), q0=arm.home + 1e-3, duration=0.5)
    s = turned_sign(arm.n)
    terms = {term: value * s for term, value in run.terms.items()}
    return dataclasses.replace(run, tau=run.tau * s, command=run.command * s, terms=terms)


def late(name: str, rng: np.random.Generator, kind: str) -> Planted:
    """A clock that misses a fifth of its periods."""
    ctrl = taut.compile(joint_law(name, "ComputedTorque", 10.0), arm_of(name))
    run = taut.run(ctrl, taut.RigidPlant(arm_of(name)), path(name, rng, duration=0.4), duration=0.4)
    periods = np.where(rng.random(len(run)) < 0.2, rng.uniform(2.0, 4.0, len(run)), rng.uniform(0.95, 1.05, len(run)))
    run = dataclasses.replace(run, t=1e-3 * np.cumsum(periods))
    return Planted(run, "late periods", "period")


def stick_slip(name: str, rng: np.random.Generator, kind: str) -> Planted:
    """Slow motion of one joint whose friction is larger at rest than in motion, under a soft spring."""
    arm, i = arm_of(name), 0
    omega = rng.uniform(35.0, 45.0)
    m = np.append(np.asarray(taut.snapshot(arm, arm.home, np.zeros(arm.n)).M)[0, 0], inertia(name)[1:])
    kp = omega**2 * m
    law = L.GravityPID(kp=kp, kd=np.where(np.arange(arm.n) == 0, 0.1, 1.0) * omega * m)
    speed = rng.uniform(0.06, 0.08)
    static = np.zeros(arm.n)
    static[i] = 0.015 * kp[i]
    true = arm.with_friction(taut.Friction(coulomb=0.3 * static, static=static, stribeck=0.005))
    way = np.zeros(arm.n)
    way[i] = 3.0 * speed
    ref = taut.trajectories.Trapezoidal(q0=arm.home, q1=arm.home + way, velocity=speed, acceleration=10.0)
    run = taut.run(taut.compile(law, arm), plant_of(true, kind), ref, duration=2.9)
    return Planted(run, "stick-slip", "friction")


def play(name: str, rng: np.random.Generator, kind: str) -> Planted:
    """Backlash of the base, held by its link's encoder with more gain than it bears."""
    arm = arm_of(name)
    M = float(np.asarray(taut.snapshot(arm, arm.home, np.zeros(arm.n)).M)[0, 0])
    fast = rng.uniform(3.0, 4.0)  # times as fast as the link of the page on gain bounds, of 0.5 kg m^2
    size = 2.0 * M
    one = np.zeros(arm.n)
    one[0] = 1.0
    true = arm.with_joints(gear=np.where(one > 0.0, 50.0, 1.0), rotor_inertia=0.25 * size * one)
    true = true.with_friction(taut.Friction(coulomb=0.2 * size * fast**2 * one))
    teeth = taut.drives.Transmission(
        stiffness=np.where(one > 0.0, 200.0 * size * fast**2, np.inf),
        damping=1.0 * size * fast * one,
        backlash=0.02 * one,
    )
    base = joint_law(name, "GravityPID", 15.0)
    kp, kd = (np.array(g.as_array()) for g in (base.kp, base.kd))
    kp[0], kd[0] = 100.0 * size * fast**2, 4.0 * size * fast
    start = arm.home + 0.05 * one
    sensors = taut.sensors.Sensors(velocity=taut.sensors.Tachometer(side="motor"))
    more = {"substeps": 8} if kind == "rigid" else {"timestep": 1.25e-4}
    plant = plant_of(true, kind, actuation=taut.drives.Actuation(transmission=teeth), sensors=sensors, **more)
    ctrl = taut.compile(L.GravityPID(kp=kp, kd=kd), arm)
    run = taut.run(ctrl, plant, taut.JointMotion(q=arm.home), duration=3.0, q0=start)
    return Planted(run, "backlash", "transmission")


def pose_of(name: str) -> taut.Pose:
    arm = arm_of(name)
    return taut.snapshot(arm, arm.home, np.zeros(arm.n)).T()


def shifted(T: taut.Pose, way: Any) -> taut.Pose:
    return taut.Pose(T.p + np.asarray(way), R=T.R)


def out_of_rank(name: str, rng: np.random.Generator, kind: str) -> Planted:
    """A line of the tool that leaves the arm's reach."""
    arm, T = arm_of(name), pose_of(name)
    out = T.p / np.linalg.norm(T.p) + 0.1 * rng.normal(size=3)
    far = shifted(T, 2.0 * np.linalg.norm(T.p) * out)
    law = L.TaskComputedTorque(kp=100.0, kd=20.0)
    run = taut.run(
        taut.compile(law, arm), plant_of(arm, kind), taut.trajectories.Line(T0=T, T1=far, duration=3.0), duration=2.5
    )
    return Planted(run, "singularity", "singularity")


def other_links(name: str, rng: np.random.Generator, kind: str) -> Planted:
    """A second link that is heavier than the model says: no payload at the tool."""
    arm = arm_of(name)
    g = np.asarray(taut.snapshot(arm, arm.home, np.zeros(arm.n)).g)
    heavier = [arm.with_body(arm.joint_names[i], mass=arm.bodies[i].mass + 1.0) for i in range(arm.n - 3)]
    more = [np.abs(np.asarray(taut.snapshot(a, a.home, np.zeros(a.n)).g) - g).max() for a in heavier]
    i = int(np.argmax(more))
    true = arm.with_body(
        arm.joint_names[i], mass=arm.bodies[i].mass + rng.uniform(0.3, 0.6) * weight(name) / float(more[i])
    )
    law = joint_law(name, "GravityPID", rng.uniform(8.0, 12.0))
    run = taut.run(taut.compile(law, arm), plant_of(true, kind), path(name, rng), duration=2.5)
    return Planted(run, "steady-state error", "P")


def payload_of_tasks(name: str, rng: np.random.Generator, kind: str) -> Planted:
    """A payload that a law of the task does not know."""
    arm, T = arm_of(name), pose_of(name)
    law: taut.Law
    if rng.integers(2) and arm.n >= 6:
        law = L.TaskComputedTorque(kp=100.0, kd=20.0)
    else:
        law = L.Impedance(K=(400.0, 20.0), zeta=0.8)
    true = arm.with_payload(mass(name, rng.uniform(0.25, 0.6)))
    ref = taut.trajectories.Line(T0=T, T1=shifted(T, 0.03 * rng.normal(size=3)), duration=1.0)
    run = taut.run(taut.compile(law, arm), plant_of(true, kind), ref, duration=2.0)
    term = "gravity" if "gravity" in run.terms else "nonlinear"
    return Planted(run, "wrong payload", term)


def leaning_board(name: str, rng: np.random.Generator, kind: str) -> Planted:
    """A board that leans by 6 to 12 degrees, and of which the law says that it does not."""
    arm, T = arm_of(name), pose_of(name)
    lean = np.radians(rng.uniform(6.0, 12.0)) * rng.choice([-1.0, 1.0])
    stated, true = (taut.Constraint.plane(point=T.p, normal=[np.sin(a), 0.0, np.cos(a)]) for a in (0.0, lean))
    law = L.HybridMotionForce(constraint=stated, motion=L.TaskComputedTorque(kp=225.0, kd=30.0), kfp=0.3, kfi=10.0)
    stroke = taut.trajectories.Line(T0=T, T1=shifted(T, [-rng.uniform(0.05, 0.08), 0.0, 0.0]), duration=1.0)
    plant = taut.RigidPlant(arm, contact=taut.RigidContact(constraint=true))
    run = taut.run(taut.compile(law, arm), plant, taut.pressing(stroke, 15.0), duration=1.3)
    return Planted(run, "wrong surface", "constraint")


def flexible(name: str, rng: np.random.Generator, kind: str) -> Planted:
    """A base that gives between motor and link, held by its link's sensors with more damping than it bears.

    kd over D (M + B)^2 / (M B), of a link M and a rotor B, beyond which gains at the link swing up.
    """
    arm = arm_of(name)
    M = float(np.asarray(taut.snapshot(arm, arm.home, np.zeros(arm.n)).M)[0, 0])
    omega, B, D = rng.uniform(55.0, 70.0), 0.5 * M, 0.5 * M
    one = np.zeros(arm.n)
    one[0] = 1.0
    true = arm.with_joints(gear=np.where(one > 0.0, 50.0, 1.0), rotor_inertia=B * one)
    teeth = taut.drives.Transmission(stiffness=np.where(one > 0.0, M * omega**2, np.inf), damping=D * one)
    base = joint_law(name, "GravityPID", 10.0)
    kp, kd = (np.array(g.as_array()) for g in (base.kp, base.kd))
    kd[0] = rng.uniform(8.0, 11.0) * D * (M + B) ** 2 / (M * B)
    kp[0] = 4.0 * kd[0]
    more = {"substeps": 8} if kind == "rigid" else {"timestep": 1.25e-4}
    motor = taut.drives.Motor(peak=np.where(one > 0.0, 0.2 * arm.effort[0] / 50.0, 1e4))
    plant = plant_of(true, kind, actuation=taut.drives.Actuation(motor=motor, transmission=teeth), **more)
    start = arm.home + 0.02 * one
    run = taut.run(
        taut.compile(L.GravityPID(kp=kp, kd=kd), arm), plant, taut.JointMotion(q=arm.home), duration=4.0, q0=start
    )
    return Planted(run, "oscillation", "transmission")


_FAULTS = (no_gravity, payload, gravity_twice, late_torque, unstable_rate, too_much_integral, underdamped, windup)
_FAULTS += (saturation, chatter, sticking, jump, wrong_sign, late, stick_slip, play, out_of_rank, other_links)
_FAULTS += (payload_of_tasks, leaning_board, flexible)
FAULTS: dict[str, Callable[..., Planted]] = {f.__name__: f for f in _FAULTS}


# -------------------------------------------------------------------- healthy runs


def healthy_pid(name: str, rng: np.random.Generator, kind: str) -> taut.Run:
    """A PID with integral on a plant that says that it compensates gravity."""
    arm, m = arm_of(name), inertia(name)
    omega = rng.uniform(10.0, 15.0)
    law = L.PID(kp=omega**2 * m, kd=2.0 * omega * m, ki=0.1 * omega**3 * m)
    plant = plant_of(arm, kind, adds={"gravity"})
    return taut.run(taut.compile(law, arm, adds=plant.adds), plant, path(name, rng), duration=3.0)


def healthy_gravity_pid(name: str, rng: np.random.Generator, kind: str) -> taut.Run:
    """Along a path, within limits."""
    arm = arm_of(name)
    law = joint_law(name, "GravityPID", rng.uniform(8.0, 20.0), rng.uniform(0.6, 1.1))
    ctrl = taut.compile(law, arm, limits=taut.Limits.of(arm, rate=True))
    return taut.run(ctrl, plant_of(arm, kind), path(name, rng), duration=1.8)


def healthy_step(name: str, rng: np.random.Generator, kind: str) -> taut.Run:
    """A small step, answered with a damping ratio of 0.5 to 1."""
    arm = arm_of(name)
    law = joint_law(name, "ComputedTorque", rng.uniform(5.0, 8.0), rng.uniform(0.5, 1.0))
    ref = taut.JointMotion(q=arm.home + 0.1 * rng.uniform(-1.0, 1.0, arm.n))
    return taut.run(taut.compile(law, arm), plant_of(arm, kind), ref, duration=2.5)


def healthy_noise(name: str, rng: np.random.Generator, kind: str) -> taut.Run:
    """Encoders with steps and noise, and velocities that are filtered for it."""
    arm = arm_of(name)
    law = joint_law(name, "ComputedTorque", rng.uniform(8.0, 12.0))
    ctrl = taut.compile(law, arm, sensing=taut.Sensing(velocity=taut.sensors.Difference(cutoff=60.0)))
    sensors = taut.sensors.Sensors(position=taut.sensors.Encoder(resolution=1e-5, noise=1e-5), velocity=None)
    plant = plant_of(arm, kind, sensors=sensors)
    return taut.run(ctrl, plant, path(name, rng), duration=1.8, seed=int(rng.integers(99)))


def healthy_payload(name: str, rng: np.random.Generator, kind: str) -> taut.Run:
    """A payload that is declared."""
    arm = arm_of(name).with_payload(mass(name, rng.uniform(0.25, 0.6)))
    one, omega = str(rng.choice(["GravityPID", "ComputedTorque"])), rng.uniform(8.0, 15.0)
    law = joint_law(name, one, omega) if one == "ComputedTorque" else with_inertia(inertia_of(arm), omega)
    return taut.run(taut.compile(law, arm), plant_of(arm, kind), path(name, rng), duration=1.8)


def with_inertia(m: Array, omega: float) -> taut.Law:
    """PD control with gravity compensation, critically damped for those inertias."""
    return L.GravityPID(kp=omega**2 * m, kd=2.0 * omega * m)


def healthy_friction(name: str, rng: np.random.Generator, kind: str) -> taut.Run:
    """Friction that is known, given by the reference."""
    arm, m = arm_of(name), inertia(name)
    dry = m * rng.uniform(0.2, 0.5)
    true = arm.with_friction(taut.Friction(coulomb=dry, viscous=2.0 * dry))
    law = joint_law(name, "ComputedTorque", rng.uniform(12.0, 18.0)) + L.FrictionCompensation(at="ref")
    return taut.run(taut.compile(law, true), plant_of(true, kind), path(name, rng), duration=1.8)


def healthy_feed_forward(name: str, rng: np.random.Generator, kind: str) -> taut.Run:
    """Feedforward and PID along a sine."""
    arm = arm_of(name)
    law = L.FeedForward() + joint_law(name, "PID", rng.uniform(10.0, 15.0))
    size = 0.15 * rng.uniform(0.3, 1.0, arm.n)
    ref = taut.trajectories.Sine(center=arm.home, amplitude=size, frequency=float(rng.uniform(0.5, 1.0)))
    start = ref.at(0.0)
    return taut.run(taut.compile(law, arm), plant_of(arm, kind), ref, duration=2.5, q0=start.q, v0=start.v)


def healthy_delay(name: str, rng: np.random.Generator, kind: str) -> taut.Run:
    """Drives that are 2 to 4 ms late, which the gains bear."""
    arm = arm_of(name)
    plant = plant_of(arm, kind, actuation=taut.drives.Actuation(delay=1e-3 * float(rng.integers(2, 5))))
    ctrl = taut.compile(joint_law(name, "ComputedTorque", 10.0), arm)
    return taut.run(ctrl, plant, path(name, rng), duration=1.8)


def healthy_task(name: str, rng: np.random.Generator, kind: str) -> taut.Run:
    """Computed torque of the task along a short line."""
    arm, T = arm_of(name), pose_of(name)
    law = L.TaskComputedTorque(kp=100.0, kd=20.0)
    ref = taut.trajectories.Line(T0=T, T1=shifted(T, 0.02 * rng.normal(size=3)), duration=1.2)
    return taut.run(taut.compile(law, arm), plant_of(arm, kind), ref, duration=1.8)


def healthy_impedance(name: str, rng: np.random.Generator, kind: str) -> taut.Run:
    """A virtual spring that a real one pulls away, as it should."""
    arm, T = arm_of(name), pose_of(name)
    law = L.Impedance(K=(300.0, 20.0), zeta=0.8)
    spring = taut.environments.Spring(stiffness=[100.0] * 3 + [0.0] * 3, at=shifted(T, 0.03 * rng.normal(size=3)))
    plant = plant_of(arm, kind, environment=spring)
    return taut.run(taut.compile(law, arm), plant, taut.hold(), duration=2.5)


def healthy_force(name: str, rng: np.random.Generator, kind: str) -> taut.Run:
    """Pressing with a constant force against springs and dampers."""
    arm = arm_of(name)
    law = L.ForceControl(kfp=0.5, kfi=5.0, kdamp=[40.0] * 3 + [2.0, 2.0, 0.5])
    held = taut.environments.Environments(
        spring=taut.environments.Spring(stiffness=500.0), damper=taut.environments.Damper(damping=10.0)
    )
    plant = taut.RigidPlant(arm, environment=held, substeps=8)
    F = np.concatenate([rng.uniform(-5.0, 5.0, 3), np.zeros(3)])
    return taut.run(taut.compile(law, arm), plant, taut.TaskForce(F_app=F), duration=2.0)


def healthy_hybrid(name: str, rng: np.random.Generator, kind: str) -> taut.Run:
    """A stroke along a board, pressed."""
    arm, T = arm_of(name), pose_of(name)
    board = taut.Constraint.plane(point=T.p, normal=[0.0, 0.0, 1.0])
    law = L.HybridMotionForce(constraint=board, motion=L.TaskComputedTorque(kp=225.0, kd=30.0), kfp=0.3, kfi=10.0)
    way = 0.03 * rng.normal(size=3) * [1.0, 1.0, 0.0]
    stroke = taut.trajectories.Line(T0=T, T1=shifted(T, way), duration=1.0)
    plant = taut.RigidPlant(arm, contact=taut.RigidContact(constraint=board))
    ref = taut.pressing(stroke, float(rng.uniform(3.0, 8.0)))
    return taut.run(taut.compile(law, arm), plant, ref, duration=1.5)


def healthy_led(name: str, rng: np.random.Generator, kind: str) -> taut.Run:
    """An admittance that a hand leads to and fro."""
    arm = arm_of(name)
    law = L.Admittance(inner=L.TaskComputedTorque(kp=900.0, kd=60.0), D=(8.0, 1.0), B=(30.0, 3.0))
    swing = taut.environments.Oscillation(amplitude=[0.04, 0.0, 0.0], frequency=float(rng.uniform(0.6, 1.2)))
    hand = taut.environments.Hand(mass=1.0, damping=10.0, stiffness=100.0, motion=swing)
    more = {"substeps": 16} if kind == "rigid" else {}
    plant = plant_of(arm, kind, environment=hand, **more)
    return taut.run(taut.compile(law, arm), plant, taut.hold(), duration=2.5)


def healthy_phases(name: str, rng: np.random.Generator, kind: str) -> taut.Run:
    """A task: a way of joints, then a hold by impedance, then back."""
    arm = arm_of(name)
    law = joint_law(name, "ComputedTorque", rng.uniform(8.0, 12.0))
    there = path(name, rng, size=0.1, duration=0.8)
    back = taut.trajectories.Quintic(q0=there.q1, q1=arm.home, duration=0.8)
    task = [
        taut.Phase(law, there, until=lambda x: x.elapsed > 1.0, name="there"),
        taut.Phase(L.Impedance(K=(300.0, 20.0), zeta=0.8), until=lambda x: x.elapsed > 0.5, name="hold"),
        taut.Phase(law, back, until=lambda x: x.elapsed > 1.0, name="back"),
    ]
    return taut.run(taut.compile(task, arm), plant_of(arm, kind), duration=2.4, progress=False)


_HEALTHY = (healthy_pid, healthy_gravity_pid, healthy_step, healthy_noise, healthy_payload, healthy_friction)
_HEALTHY += (healthy_feed_forward, healthy_delay, healthy_task, healthy_impedance, healthy_force, healthy_hybrid)
_HEALTHY += (healthy_led, healthy_phases)
HEALTHY: dict[str, Callable[..., taut.Run]] = {f.__name__: f for f in _HEALTHY}
