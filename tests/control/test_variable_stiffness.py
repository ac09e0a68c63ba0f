"""Variable-stiffness actuators, and position and stiffness under their law: closed forms, and section 10.6's figures."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import refused

import taut
from taut.base.types import Float64Array
from taut.drives import Actuation, AntagonisticSprings, VariableStiffnessActuator
from taut.laws import MitCommand, VariableStiffness

FREE = taut.Friction()
ONE = taut.load_arm("one_joint").with_friction(FREE)
FLOATING = taut.load_arm("one_joint", gravity=[0.0, 0.0, 0.0]).with_friction(FREE)  # M = 0.5 kg m^2
SPRINGS = AntagonisticSprings(a=40.0, c_min=0.25, c_max=0.75)  # 40 to 120 N m/rad


def plant(
    arm: taut.Arm = ONE,
    springs: AntagonisticSprings = SPRINGS,
    *,
    speed: Any = None,
    damping: Any = 0.0,
    preset: Any = None,
    bandwidth: float | None = None,
    delay: float = 0.0,
    substeps: int = 4,
    **more: Any,
) -> taut.RigidPlant:
    motors = VariableStiffnessActuator(springs=springs, speed=speed, damping=damping, preset=preset)
    drives = Actuation(motor=motors, bandwidth=bandwidth, delay=delay)
    return taut.RigidPlant(arm, takes="mit", actuation=drives, substeps=substeps, **more)


def law(stiffness: Any = 80.0, springs: AntagonisticSprings = SPRINGS, slew: Any = 160.0, **more: Any) -> taut.Law:
    return VariableStiffness(springs=springs, stiffness=stiffness, slew=slew, **more)


class Raw(taut.Law):
    """Five numbers, as they are given.

    Law:          q, kp and tau, v = 0, kd = 0
    """

    q: taut.Gain = taut.Gain(unit="rad", minimum=-np.inf)
    kp: taut.Gain = taut.Gain(unit="N m/rad")
    tau: taut.Gain = taut.Gain(0.0, unit="N m", minimum=-np.inf)

    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> MitCommand:
        one = np.ones(x.n)
        return MitCommand(q=self.q @ one, v=0.0, kp=self.kp @ one, kd=0.0, tau=self.tau @ one)


class TestSprings:
    def test_torque_stiffness_and_energy_are_the_closed_forms(self) -> None:
        rng = np.random.default_rng(1)
        for _ in range(100):
            a, c = rng.uniform(1.0, 100.0), rng.uniform(0.1, 1.0)
            phi = c * rng.uniform(-1.0, 1.0)
            s = AntagonisticSprings(a=a, c_min=0.05, c_max=2.0)
            assert s.torque(c, phi) == pytest.approx(4.0 * a * c * phi, rel=1e-9, abs=1e-12)
            assert s.stiffness(c, phi) == pytest.approx(4.0 * a * c, rel=1e-9)
            assert s.energy(c, phi) == pytest.approx(2.0 * a / 3.0 * (c**3 + 3.0 * c * phi**2), rel=1e-9)
            assert s.pretension(4.0 * a * c) == pytest.approx(c, rel=1e-9)
            assert s.max_torque(4.0 * a * c) == pytest.approx(4.0 * a * c**2, rel=1e-9)

    def test_beyond_the_pretension_one_tendon_is_slack_and_the_other_hardens(self) -> None:
        c, h = 0.3, 1e-6
        for phi in (0.31, 0.7, -0.31, -0.7):
            assert SPRINGS.torque(c, phi) == pytest.approx(40.0 * (c + abs(phi)) ** 2 * np.sign(phi), rel=1e-9)
        for phi in (-0.7, -0.1, 0.0, 0.25, 0.5):
            slope = (SPRINGS.torque(c, phi + h) - SPRINGS.torque(c, phi - h)) / (2.0 * h)
            force = (SPRINGS.energy(c, phi + h) - SPRINGS.energy(c, phi - h)) / (2.0 * h)
            assert slope == pytest.approx(SPRINGS.stiffness(c, phi), rel=1e-6)
            assert force == pytest.approx(SPRINGS.torque(c, phi), rel=1e-6, abs=1e-8)


class TestPlant:
    def test_the_joint_oscillates_as_on_a_spring_of_the_commanded_stiffness(self) -> None:
        for sigma in (40.0, 80.0, 120.0):
            ctrl, where = taut.compile(law(sigma), FLOATING), plant(FLOATING, preset=sigma)
            run = taut.run(ctrl, where, taut.JointMotion(q=[0.3]), duration=2.0, q0=[0.35])
            exact = 0.3 + 0.05 * np.cos(math.sqrt(sigma / 0.5) * run.t)
            assert np.abs(run.q[:, 0] - exact).max() < 2e-4
            assert run.extra["drives.stiffness"] == pytest.approx(sigma, rel=1e-9)  # whatever the deflection

    def test_motors_settle_at_the_equilibrium_and_the_pretension(self) -> None:
        goal = taut.JointMotion(q=[0.3])
        done = taut.run(taut.compile(law(), ONE), plant(bandwidth=50.0, damping=2.0), goal, duration=6.0, q0=[0.0])
        assert done.q[-1, 0] == pytest.approx(0.3, abs=1e-5)
        assert done.extra["drives.stiffness"][0, 0] == 80.0  # of the middle of the range
        weight = float(taut.snapshot(ONE, [0.3]).g[0])
        assert done.extra["drives.equilibrium"][-1, 0] == pytest.approx(0.3 + weight / 80.0, abs=1e-5)

    def test_neither_motor_is_faster_than_its_speed(self) -> None:
        done = taut.run(taut.compile(law(slew=1e6), ONE), plant(bandwidth=200.0, speed=0.7), taut.JointMotion(q=[0.4]),
                        duration=1.0, q0=[0.0], events=[taut.Event(t=0.1, set={"law.stiffness": 120.0})])  # fmt: skip
        mu, c = done.extra["drives.equilibrium"][:, 0], done.extra["drives.stiffness"][:, 0] / 160.0
        rates = np.abs(np.diff([mu + c, mu - c], axis=1)) / 1e-3
        assert 0.69 < rates.max() <= 0.7 + 1e-9

    @pytest.mark.parametrize(("bandwidth", "delay"), [(None, 0.0), (150.0, 0.0), (150.0, 0.002)])
    def test_a_run_starts_at_rest_with_the_weight_in_the_springs(self, bandwidth: Any, delay: float) -> None:
        drives = plant(bandwidth=bandwidth, delay=delay, preset=120.0)
        done = taut.run(taut.compile(law(120.0), ONE), drives, taut.JointMotion(q=[0.3]), duration=0.5, q0=[0.3])
        assert done.outcome.message == "completed: 501 ticks, 0.5 s"
        assert np.abs(done.q - 0.3).max() < (1e-12 if delay == 0.0 else 1e-5)

    def test_it_runs_alike_in_floats_in_native_code_and_in_mujoco(self) -> None:
        arm = taut.load_arm("planar2").with_friction(FREE)
        springs = AntagonisticSprings(a=[5000.0, 1000.0], c_min=0.05, c_max=0.2)
        motors = VariableStiffnessActuator(springs=springs, speed=2.0, damping=[10.0, 2.0])
        drives = Actuation(motor=motors, bandwidth=150.0, delay=0.001)
        made = law([2500.0, 500.0], springs, 1e4, kd=1.0)
        ref = taut.trajectories.Sine(center=arm.home + 0.1, amplitude=0.1, frequency=0.5, phase=-0.5 * np.pi)
        rigid = taut.RigidPlant(arm, takes="mit", actuation=drives, substeps=2)
        mujoco = taut.MujocoPlant(arm, takes="mit", actuation=drives, timestep=5e-4)
        change = [taut.Event(t=0.02, set={"law.stiffness": [3500.0, 700.0]})]
        one, *others = (
            taut.run(taut.compile(made, arm, engine=engine), where, ref, duration=0.1, events=change)  # type: ignore[arg-type]
            for engine, where in (("native", rigid), ("float", rigid), ("native", mujoco))
        )
        for other in others:
            assert np.abs(one.q - other.q).max() < 1e-10
        for column in ("drives.stiffness", "drives.equilibrium", "saturated.drives"):
            assert column in others[1].extra


def loaded(
    name: str, rate: float, rng: np.random.Generator
) -> tuple[taut.Arm, VariableStiffness, taut.RigidPlant, Float64Array]:
    """An arm at a pose near home, with springs that carry it, and a stiffness among those that they give."""
    arm = taut.load_arm(name).with_friction(FREE).with_joints(rotor_inertia=0.0)
    q = arm.home + rng.uniform(-0.3, 0.3, arm.n)
    x = taut.snapshot(arm, q)
    c_min = rng.uniform(0.02, 0.1, arm.n)
    a = (np.abs(x.g) + 0.5 * np.diag(x.M) * 100.0 + 1.0) / (4.0 * c_min**2)  # 4 a c_min^2 is more than the weight
    springs = AntagonisticSprings(a=a, c_min=c_min, c_max=4.0 * c_min)
    low, high = springs.stiffness_range
    made = VariableStiffness(springs=springs, stiffness=rng.uniform(low, high), slew=1e5)
    return (
        arm,
        made,
        plant(arm, springs, bandwidth=150.0, damping=np.sqrt(low * np.diag(x.M)), substeps=round(8000.0 / rate)),
        q,
    )


class TestGuarantees:
    @pytest.mark.parametrize("name", ["ur10", pytest.param("panda", marks=pytest.mark.long)])
    def test_the_joint_is_as_stiff_as_commanded_at_any_rate_and_does_not_move_with_it(
        self, name: str, share: Callable[[int], int]
    ) -> None:
        rng = np.random.default_rng(7)
        for _ in range(share(10)):
            rate = float(rng.choice([20.0, 100.0, 1000.0]))
            arm, made, where, q = loaded(name, rate, rng)
            lin = taut.linearise(
                taut.Loop(taut.compile(made, arm, rate=rate), where, taut.JointMotion(q=q), duration=1.0), at=q
            )
            assert lin.stable
            assert lin.point.moved == pytest.approx(0.0, abs=1e-9)  # whatever the stiffness
            h = 1e-6
            slope = [
                (taut.snapshot(arm, q + d).g - taut.snapshot(arm, q - d).g) / (2.0 * h) for d in h * np.eye(arm.n)
            ]
            K = np.diag(made.stiffness.as_array()) + np.stack(slope, axis=1)
            n = arm.n
            inputs = [lin.inputs.index(f"disturbance.torque[{i}]") for i in range(n)]
            outputs = [lin.outputs.index(f"q[{i}]") for i in range(n)]
            found = (lin.C @ np.linalg.solve(np.eye(len(lin.A)) - lin.A, lin.B))[np.ix_(outputs, inputs)]
            assert found @ K == pytest.approx(np.eye(n), abs=1e-4)

    @pytest.mark.parametrize(("bandwidth", "error"), [(None, 4e-4), (150.0, 7.5e-4)])
    def test_a_motion_is_followed_without_feedback(self, bandwidth: float | None, error: float) -> None:
        arm = taut.load_arm("planar2").with_friction(FREE)
        springs = AntagonisticSprings(a=[5000.0, 1000.0], c_min=0.05, c_max=0.2)
        where = plant(arm, springs, bandwidth=bandwidth, damping=[4.0, 0.8], preset=[2500.0, 500.0], substeps=1)
        ref = taut.trajectories.Septic(q0=arm.home, q1=arm.home + 0.8, duration=0.8)
        ctrl = taut.compile(law([2500.0, 500.0], springs, 1e4), arm, rate=8000.0)
        run = taut.run(ctrl, where, ref, duration=0.9)
        assert np.abs(run.q - run.reference.q).max() < error
        assert run.extra["drives.stiffness"][-1] == pytest.approx([2500.0, 500.0], rel=1e-9)

    def test_a_change_of_stiffness_moves_the_joint_by_what_the_motors_lag(self) -> None:
        """Acceptance: M 0.3, m g l 3, a 40, b 0.1 (here all times 5/3), 40 -> 120 N m/rad in 0.5 s.

        Its motors are not stated: a bandwidth of 28.4 rad/s gives its 1.54 mrad.
        """
        k = 5.0 / 3.0
        arm = taut.load_arm("one_joint", gravity=[0.0, 0.0, -9.81 * 3.0 * k / 0.981]).with_friction(
            taut.Friction(viscous=0.1 * k)
        )
        springs = AntagonisticSprings(a=40.0 * k, c_min=0.25, c_max=0.75)
        moved = {}
        for bandwidth in (28.4, 65.0, 100.0, 200.0, None):
            run = taut.run(
                taut.compile(law(40.0 * k, springs, 160.0 * k), arm),
                plant(arm, springs, bandwidth=bandwidth, preset=40.0 * k),
                taut.JointMotion(q=[0.0]),
                duration=1.5,
                q0=[0.0],
                events=[taut.Event(t=0.1, set={"law.stiffness": 120.0 * k})],
            )
            assert run.extra["drives.stiffness"][-1, 0] == pytest.approx(120.0 * k, rel=1e-6)
            moved[bandwidth] = 1e3 * float(np.abs(run.q).max())
        assert moved[28.4] == pytest.approx(1.54, rel=0.01)
        assert moved[65.0] < 0.40  # feedback linearisation of both outputs leaves 0.40
        assert moved[100.0] == pytest.approx(4.0 * moved[200.0], rel=0.1)  # falls with the square
        assert moved[None] < 1e-9

    def test_damping_by_the_motors_acts_up_to_their_bandwidth(self) -> None:
        loop = taut.Loop(
            taut.compile(law(kd=2.0), FLOATING),
            plant(FLOATING, bandwidth=2000.0),
            taut.JointMotion(q=[0.0]),
            duration=1.0,
        )
        lin = taut.linearise(loop, at=[0.0])
        slow = lin.s_poles[np.abs(lin.s_poles) < 100.0]
        assert np.poly(slow) == pytest.approx([1.0, 4.0, 160.0], rel=0.03)  # s^2 + kd / M s + sigma / M


PAGE = Path(__file__).parents[2] / "docs" / "variable_stiffness.md"


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The names of the page's law and plant of one's own: joints are the link and its two motors."""
    found = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    [block] = [text for text in found if "class Decoupling" in text]
    names: dict[str, Any] = {"np": np, "taut": taut}
    with contextlib.chdir(tmp_path_factory.mktemp("page")):
        exec(block, names)
    return names


class MotorPDs(taut.Law):
    """Each motor where statics put it, with the measured torque of its spring.

    Law:          tau_i = kp (mu +- c - q_i) - kd v_i +- f_i, c = sigma_des / (4 a), mu = q_des + tau_J,des / sigma_des
    """

    a: taut.Gain = taut.Gain(unit="N m/rad^2", shape="scalar")
    kp: taut.Gain = taut.Gain(unit="N m/rad", shape="scalar")
    kd: taut.Gain = taut.Gain(unit="N m s/rad", shape="scalar")

    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        a, c = self.a.as_array(), 0.5 * (ref.q[1] - ref.q[2])
        mu = ref.q[0] + x.at(ref.q, ref.v).inverse_dynamics(ref.a)[0] / (4.0 * a * c)
        P, D = taut.math.array([0.0, mu + c - x.q[1], mu - c - x.q[2]]), taut.math.array([0.0, -x.v[1], -x.v[2]])
        f = taut.math.array([0.0, a * (x.q[1] - x.q[0]) ** 2, -a * (x.q[0] - x.q[2]) ** 2])
        return taut.Torque(P=self.kp.as_array() * P, D=self.kd.as_array() * D, spring=f)


class Rising:
    """Stiffness that rises evenly from 40 to 120 N m/rad in half a second, with a = 40 N m/rad^2; q rests at 0."""

    def at(self, t: float) -> taut.JointMotion:
        c, rate = 0.25 + min(t, 0.5), 1.0 if t < 0.5 else 0.0
        return taut.JointMotion(q=[0.0, c, -c], v=[0.0, rate, -rate], j=np.zeros(3), s=np.zeros(3))


def behind_tendons(page: dict[str, Any], arm: taut.Arm, a: float, substeps: int = 64) -> taut.RigidPlant:
    return taut.RigidPlant(arm, actuation=Actuation(motor=page["Tendons"](a=a)), substeps=substeps)


def at_rest(arm: taut.Arm, q: float, c: float, a: float) -> Float64Array:
    """Link and motors with the weight in the springs."""
    phi = float(taut.snapshot(arm, [q, 0.0, 0.0]).g[0]) / (4.0 * a * c)
    return np.array([q, q + phi + c, q + phi - c])


class TestDecoupling:
    def test_its_tendons_are_the_springs_of_the_drives(self, page: dict[str, Any]) -> None:
        rng = np.random.default_rng(2)
        for _ in range(20):
            q, q_1, q_2 = rng.uniform(-1.0, 1.0, 3)  # often with a slack tendon
            asked = taut.drives.MotorInput(
                tau=np.zeros(3), q=np.array([q, q_1, q_2]), v=np.zeros(3), gear=np.ones(3), ripple=1.0, memory={},
                p={"a": 40.0}, bandwidth=None, dt=1e-3,
            )  # fmt: skip
            on_link, on_1, on_2 = page["Tendons"](a=40.0).step(asked).tau
            assert on_link == pytest.approx(SPRINGS.torque(0.5 * (q_1 - q_2), 0.5 * (q_1 + q_2) - q), abs=1e-12)
            assert on_link + on_1 + on_2 == pytest.approx(0.0, abs=1e-12)

    def test_a_change_of_stiffness_moves_the_link_by_what_the_sampling_leaves(self, page: dict[str, Any]) -> None:
        """Acceptance: 1.54 mrad by motor PDs, 0.40 by this law; gains and poles are not stated, and these give them."""
        arm = page["two"]

        def moved(law: taut.Law, rate: float = 1000.0) -> float:
            ctrl, start = taut.compile(law, arm, rate=rate), at_rest(arm, 0.0, 0.25, 40.0)
            run = taut.run(ctrl, behind_tendons(page, arm, 40.0), Rising(), duration=1.5, q0=start)
            assert 80.0 * (run.q[-1, 1] - run.q[-1, 2]) == pytest.approx(120.0, rel=1e-5)
            return 1e3 * float(np.abs(run.q[:, 0]).max())

        def decoupling(omega: float) -> taut.Law:
            law: taut.Law = page["Decoupling"](a=40.0, omega=omega, rate=30.0)
            return law

        assert moved(MotorPDs(a=40.0, kp=38.0, kd=2.0 * math.sqrt(38.0 * 0.05))) == pytest.approx(1.54, rel=0.01)
        assert moved(decoupling(11.4)) == pytest.approx(0.40, rel=0.01)
        assert moved(decoupling(30.0)) == pytest.approx(0.0093, rel=0.01)
        assert moved(decoupling(30.0), rate=2000.0) == pytest.approx(0.0047, rel=0.02)  # half of it

    def test_position_and_stiffness_have_each_their_own_error(
        self, page: dict[str, Any], share: Callable[[int], int]
    ) -> None:
        """Both references move, both outputs begin off them, and each error is the solution of its own equation."""
        rng = np.random.default_rng(3)
        for _ in range(share(20)):
            (a, omega, rate), B = rng.uniform([20.0, 10.0, 10.0], [80.0, 25.0, 40.0]), rng.uniform(0.01, 0.1)
            link, *motors = page["two"].bodies
            mass, x, inertia = rng.uniform([0.5, 0.1, 0.05], [2.0, 0.4, 0.3])
            link = dataclasses.replace(link, mass=mass, com=np.array([x, 0.0, 0.0]), inertia=inertia * np.eye(3))
            rotors = (dataclasses.replace(motor, inertia=B * np.eye(3)) for motor in motors)
            arm = dataclasses.replace(page["two"], bodies=(link, *rotors))
            arm = arm.with_joints(viscous=[rng.uniform(0.0, 0.3), 0.0, 0.0])
            (q, end), (c, c_end) = rng.uniform(-0.5, 0.5, 2), rng.uniform(0.4, 0.8, 2)
            ref = taut.trajectories.Septic(q0=[q, c, -c], q1=[end, c_end, -c_end], duration=0.8)
            off, c_off = rng.uniform(-0.02, 0.02), rng.uniform(-0.05, 0.05)
            ctrl = taut.compile(page["Decoupling"](a=a, omega=omega, rate=rate), arm, rate=8000.0)
            start = at_rest(arm, q - off, c - c_off, a)
            run = taut.run(ctrl, behind_tendons(page, arm, a, substeps=4), ref, duration=1.0, q0=start)
            assert np.diff(run.q[:, [2, 0, 1]]).min() > 0.0  # no tendon gets slack
            error, w, r = run.reference.q - run.q, omega * run.t, rate * run.t
            exact = off * np.exp(-w) * (1.0 + w + w**2 / 2.0 + w**3 / 6.0)
            assert error[:, 0] == pytest.approx(exact, abs=5e-3 * 0.02)
            apart = 0.5 * (error[:, 1] - error[:, 2])
            assert apart == pytest.approx(c_off * np.exp(-r) * (1.0 + r), abs=5e-3 * 0.05)

    def test_a_lasting_load_finds_the_stiffness_of_the_loop(self, page: dict[str, Any]) -> None:
        w, M, b, found = 30.0, 0.3, 0.1, []
        for c in (0.25, 0.75):
            lin = self.linear(page, c, w)
            column = lin.B[:, lin.inputs.index("disturbance.torque[0]")]
            row = lin.C[lin.outputs.index("q[0]")]
            compliance = row @ np.linalg.solve(np.eye(len(lin.A)) - lin.A, column)
            without = (6.0 * w**2 - 160.0 * c / M) / (M * w**4)
            assert compliance == pytest.approx(without - (4.0 * w - b / M) * b / (M**2 * w**4), rel=1e-6)
            found.append(1.0 / compliance)
        assert found == pytest.approx([46.5, 49.0], abs=0.05)

    @pytest.mark.parametrize("c", [0.25, 0.75])
    def test_its_poles_must_be_slower_than_half_the_rate(self, page: dict[str, Any], c: float) -> None:
        assert self.linear(page, c, 450.0).stable
        assert not self.linear(page, c, 520.0).stable

    @staticmethod
    def linear(page: dict[str, Any], c: float, omega: float) -> taut.LinearSystem:
        """At 1 kHz, the link at 0."""
        ctrl = taut.compile(page["Decoupling"](a=40.0, omega=omega, rate=30.0), page["two"])
        where = behind_tendons(page, page["two"], 40.0, substeps=4)
        loop = taut.Loop(ctrl, where, taut.JointMotion(q=[0.0, c, -c]), duration=1.0)
        return taut.linearise(loop, at=at_rest(page["two"], 0.0, c, 40.0))

    def test_without_tension_the_run_ends_at_once(self, page: dict[str, Any]) -> None:
        run = taut.run(page["ctrl"], page["tendons"], page["change"], duration=0.1, q0=np.zeros(3))
        assert not run.outcome.ok
        assert "'decoupling'" in run.outcome.message
        assert len(run) <= 1


class Strokes:
    """The motors to and fro at their speed, each stroke half a period, the last one forward."""

    def __init__(self, count: int, half: float, speed: float) -> None:
        self.half, self.ways = half, [speed * (-1.0) ** (count - 1 - k) for k in range(count)]

    def at(self, t: float) -> taut.JointMotion:
        k = min(int(t / self.half + 1e-9), len(self.ways) - 1)
        q = self.half * sum(self.ways[:k]) + self.ways[k] * (t - k * self.half)
        return taut.JointMotion(q=[q], v=[self.ways[k]])


class TestThrow:
    M, OMEGA, V = 0.5, 10.0, 0.8  # [kg m^2], [rad/s], [rad/s] of the motors
    SOFT = AntagonisticSprings(a=25.0, c_min=0.1, c_max=0.5)  # 50 N m/rad at its largest pretension

    @pytest.mark.parametrize(
        ("zeta", "strokes", "gain"),
        [(0.0, 1, 2.0), (0.0, 2, 4.0), (0.0, 3, 6.0), (0.05, 1, 1.855), (0.05, 2, 3.440), (0.05, 3, 4.796)],
    )
    def test_each_stroke_adds_twice_the_speed_of_the_motors(self, zeta: float, strokes: int, gain: float) -> None:
        half = math.pi / (self.OMEGA * math.sqrt(1.0 - zeta**2))
        where = plant(FLOATING, self.SOFT, speed=self.V, preset=50.0, damping=2.0 * zeta * self.M * self.OMEGA)
        ctrl = taut.compile(law(50.0, self.SOFT, 1.0), FLOATING)
        run = taut.run(ctrl, where, Strokes(strokes, half, self.V), duration=strokes * half + 0.01, q0=[0.0])
        assert np.interp(strokes * half, run.t, run.v[:, 0]) == pytest.approx(gain * self.V, rel=1e-3)
        deflection = np.abs(run.extra["drives.equilibrium"] - run.q).max()
        assert deflection <= (2 * strokes - 1) * self.V / self.OMEGA * (1.0 + 1e-4)
        assert run.extra["drives.stiffness"] == pytest.approx(50.0, rel=1e-9)  # no tendon gets slack


class TestImpact:
    M, B, SPEED, WALL = 0.5, 1.0, 1.0, 2e3  # [kg m^2], [kg m^2], [rad/s], [N m/rad]

    def wall(self) -> Any:
        return taut.environments.StiffWall(point=[0.0] * 3, normal=[0.0, 0.0, -1.0], stiffness=self.WALL / 0.1**2)

    def peak(self, run: taut.Run) -> float:
        """Largest torque, which is that of the first contact [N m]."""
        return -0.1 * float(run.extra["F_ext"][:, 2].min())

    @pytest.mark.parametrize(
        ("bandwidth", "impact"),
        [
            (None, 54.6),
            (10.0, 45.7),
            pytest.param(30.0, 40.7, marks=pytest.mark.long),
            pytest.param(100.0, 36.8, marks=pytest.mark.long),
            pytest.param(300.0, 35.5, marks=pytest.mark.long),
            (1000.0, 34.8),
        ],
    )
    def test_active_compliance_hides_the_rotor_as_far_as_its_bandwidth_goes(
        self, bandwidth: float | None, impact: float
    ) -> None:
        arm = FLOATING.with_joints(rotor_inertia=self.B)
        gear = taut.drives.Transmission(stiffness=2e5, damping=200.0)
        stiff = taut.RigidPlant(
            arm,
            actuation=Actuation(transmission=gear, bandwidth=bandwidth),
            environment=self.wall(),
            sensors=taut.sensors.Sensors(torque=taut.sensors.TorqueSensor()),
        )
        active: taut.Law = taut.laws.PID(kp=0.0)
        if bandwidth is not None:
            active = taut.laws.JointTorqueFeedback(law=active, inertia=self.B / 10.0)
        ctrl = taut.compile(active, arm, rate=250e3)
        run = taut.run(ctrl, stiff, duration=0.12, q0=[-1e-5], v0=[self.SPEED])
        assert self.peak(run) == pytest.approx(impact, rel=0.01)

    def test_a_soft_joint_hides_it_by_itself(self) -> None:
        soft = AntagonisticSprings(a=25.0, c_min=0.1, c_max=0.5)
        ctrl = taut.compile(law(50.0, soft, 1.0), FLOATING)
        run = taut.run(ctrl, plant(FLOATING, soft, preset=50.0, substeps=20, environment=self.wall()), Strokes(1, 1.0, self.SPEED),
                       duration=0.12, q0=[-1e-5], v0=[self.SPEED])  # fmt: skip
        assert self.peak(run) == pytest.approx(31.8, rel=0.01)
        assert self.peak(run) >= self.SPEED * math.sqrt(self.WALL * self.M)  # no joint goes below its link's own


class TestBeyondTheSprings:
    @pytest.mark.parametrize(
        ("q", "kp", "tau", "reached"),
        [(0.0, 500.0, 0.0, 120.0), (0.0, 5.0, 0.0, 40.0), (0.0, 0.0, 0.5, 40.0), (2.0, 80.0, 0.0, 80.0)],
    )
    def test_a_command_is_limited_and_the_outcome_says_so(
        self, q: float, kp: float, tau: float, reached: float
    ) -> None:
        where = plant(damping=2.0, bandwidth=100.0)
        run = taut.run(taut.compile(Raw(q=q, kp=kp, tau=tau), ONE), where, duration=1.0, q0=[0.0])
        assert "a command was beyond the springs of the drives, and limited, (index 0) in" in run.outcome.message
        assert run.extra["saturated.drives"][1, 0] == 1.0
        assert run.extra["drives.stiffness"][-1, 0] == pytest.approx(reached, rel=1e-6)
        c = reached / 160.0
        assert np.abs(run.extra["drives.equilibrium"] - run.q).max() < 1.3 * c

    def test_more_stiffness_than_the_springs_have_is_that_of_the_springs(self) -> None:
        """Fed back through the lag of the motors, the rest of it made a sustained oscillation of 0.9 rad."""
        stiff = AntagonisticSprings(a=160.0, c_min=0.25, c_max=0.75)  # 160 to 480 N m/rad
        weight = float(taut.snapshot(ONE, [0.3]).g[0])
        where = plant(damping=0.1, preset=40.0, bandwidth=100.0, substeps=2)
        ctrl = taut.compile(Raw(q=0.3, kp=400.0, tau=weight), ONE)
        run = taut.run(ctrl, where, taut.JointMotion(q=[0.3]), duration=4.0, q0=[0.3])
        assert run.info.stability.stable
        assert np.abs(run.q - 0.3).max() < 0.02
        assert run.extra["drives.equilibrium"][-1, 0] == pytest.approx(0.3 + weight / 120.0, abs=1e-6)
        with refused(taut.errors.MatchError):
            taut.run(taut.compile(law(400.0, stiff), ONE), where, taut.JointMotion(q=[0.3]), duration=1.0, q0=[0.3])
        with refused(taut.errors.MatchError):
            mujoco = taut.MujocoPlant(ONE, takes="mit", actuation=where.actuation)
            taut.run(
                taut.compile([taut.Phase(law(200.0, stiff), taut.JointMotion(q=[0.3]))], ONE), mujoco, duration=1.0
            )

    def test_what_is_beyond_is_one_sentence(self) -> None:
        errors = taut.errors
        with refused(errors.RangeError):
            AntagonisticSprings(a=40.0, c_min=0.75, c_max=0.25)
        with refused(errors.ShapeError):
            AntagonisticSprings(a=40.0, c_min=[0.1, 0.2], c_max=[0.3, 0.4, 0.5])
        with refused(errors.RangeError):
            law(200.0)
        with refused(errors.RangeError):
            law([80.0, 10.0])
        with refused(errors.RangeError):
            VariableStiffnessActuator(springs=SPRINGS, preset=20.0)
        event = [taut.Event(t=0.05, set={"law.stiffness": 200.0})]
        with refused(errors.RangeError):
            taut.run(taut.compile(law(), ONE), plant(), taut.JointMotion(q=[0.0]), duration=0.1, events=event)
        heavy = taut.load_arm("one_joint", gravity=[0.0, 0.0, -600.0])
        with refused(errors.RangeError):
            taut.run(taut.compile(law(), heavy), plant(heavy), duration=0.1, q0=[0.0])
        with refused(errors.RangeError):
            taut.run(taut.compile(law(), ONE, rate=10.0), plant(substeps=1), duration=0.1, q0=[0.0])

    def test_plants_that_do_not_fit_are_refused(self) -> None:
        motors, errors = VariableStiffnessActuator(springs=SPRINGS), taut.errors
        for more in (
            {"takes": "torque"},
            {"adds": ("gravity",)},
            {"integrator": "rk4"},
            {"arm": ONE.with_gears(ratio=50.0, motor_inertia=1e-4)},
            {"actuation": Actuation(motor=motors, resolution=0.1)},
        ):
            with refused(errors.UsageError):
                taut.RigidPlant(**{"arm": ONE, "takes": "mit", "actuation": Actuation(motor=motors)} | more)  # type: ignore[arg-type]
