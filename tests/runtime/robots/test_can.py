"""Arms of MIT-type motors on a CAN bus: frames, bus load, faults and closed loops, against motors in another process."""

from __future__ import annotations

import itertools
import json
import re
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import can_arm
import numpy as np
import pytest
from can_arm import CanArm
from refusals import refused

import taut
from taut.cli.main import main
from taut.errors import MatchError, RangeError, ShapeError, UnknownNameError, UsageError
from taut.robots import CanMotors, DriverError, RobotError
from taut.runtime.realtime import bringup
from taut.runtime.robots.can import RANGES, CanDriver

pytestmark = pytest.mark.xdist_group("robots")
WHEEL: Final = Path(__file__).parents[3] / ".wheels" / "damiao_motor-1.0.6-py3-none-any.whl"  # filled by set-up
NAMES: Final = ("planar2", "seven")
ERRORS: Final = {0x8: "overvoltage", 0x9: "undervoltage", 0xA: "overcurrent", 0xB: "MOSFETs", 0xC: "coils",
                 0xD: "communication", 0xE: "overload", 0x5: "0x5"}  # fmt: skip
PUSH: Final = np.array([[0.0, 0.0]] * 4 + [[15.0, -3.0]])
HOLDS: Final = taut.laws.ViaMit(law=taut.laws.ComputedTorque(kp=400.0, kd=40.0), kp_motor=0.0, kd_motor=0.0)
STEP: Final = 25.0 / 65535  # [rad] of a position
OTHER: Final = {"DM4310": "4310", "DM4340": "4340", "DM8009": "8009", "DM6006": "6006", "DM10010L": "10010L"}


@pytest.fixture(scope="module")
def other() -> Iterator[Any]:
    """The module of another implementation, damiao-motor 1.0.6."""
    assert WHEEL.is_file(), f"{WHEEL} is missing; 'make test' fills it"
    sys.path.insert(0, str(WHEEL))
    import damiao_motor.core.motor as module

    yield module
    sys.path.remove(str(WHEEL))


@pytest.fixture(scope="module")
def arms() -> Iterator[dict[str, CanArm]]:
    with CanArm("planar2") as planar, CanArm("seven") as seven:
        yield {"planar2": planar, "seven": seven}


def codes_of(frame: bytes) -> list[int]:
    """The five codes of a command."""
    b = list(frame)
    return [
        b[0] << 8 | b[1],
        b[2] << 4 | b[3] >> 4,
        (b[3] & 15) << 8 | b[4],
        b[5] << 4 | b[6] >> 4,
        (b[6] & 15) << 8 | b[7],
    ]


class Host:
    """A driver and the arm at the other end; in each tick the arm has taken and answered every frame."""

    def __init__(self, arm: CanArm, **more: Any) -> None:
        self.sim, self.arm = arm, arm.arm
        self.sim(reset=True, rules=[], period=1.0 / arm.rate)
        self.motors = can_arm.motors(arm.name, **{"rate": arm.rate, **more})
        self.driver = CanDriver(arm.channel, motors={name: getattr(self.motors, name) for name in self.motors.specified},
                                joints=self.arm.joint_names)  # fmt: skip
        self.x = {name: np.zeros(self.arm.n) for name in ("q", "v", "tau_meas")}

    def __enter__(self) -> Host:
        try:
            self.info = self.driver.open()
        except BaseException:
            self.driver.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.driver.close()
        self.sim()

    def tick(self, command: Any = None) -> dict[str, Any]:
        """A period: what is true at the arm after it."""
        self.driver.read(self.x)
        if command is not None:
            self.driver.write(np.array(command(self.x) if callable(command) else command, dtype=np.float64))
        return self.sim()

    def ticks(self, count: int, command: Any = None) -> dict[str, Any]:
        """Several periods."""
        for _ in range(count):
            truth = self.tick(command)
        return truth

    def weight(self, x: Any = None) -> Any:
        """(5, n) gravity at the measured positions, with some damping in the motors."""
        q = self.x["q"] if x is None else x["q"]
        tau = np.asarray(taut.snapshot(self.arm, q).g)
        return np.array([q, 0.0 * q, 0.0 * q, 0.5 + 0.0 * q, tau])

    def lost(self) -> list[int]:
        """Missing replies by joint."""
        found = self.driver.call("motors", {})
        return [found[name]["lost"] for name in self.arm.joint_names]

    def run(self, law: taut.Law, ref: Any, ticks: int) -> Any:
        """(ticks, n) measured positions under a law."""
        ctrl = taut.compile(law, self.arm, rate=self.info.rate, limits=taut.Limits(tau=self.arm.effort))
        out = []
        for k in range(ticks):
            sample = ref.at(k / self.info.rate) if isinstance(ref, taut.trajectories.Sine) else ref
            self.tick(lambda x, sample=sample: ctrl.step(x["q"], x["v"], sample))
            out.append(self.x["q"].copy())
        return np.array(out)


def test_frames_are_those_of_another_implementation_at_all_corners(other: Any) -> None:
    """Commands are rounded, those of the other one cut off: on its grid both give the same bytes."""
    rng = np.random.default_rng(1)
    ends = [(-1.0, 0.0, 1.0) if row in (0, 1, 4) else (0.0, 0.5, 1.0) for row in range(5)]
    units = np.array([*itertools.product(*ends), *rng.uniform([-1, -1, 0, 0, -1], 1.0, (500, 5))])
    for kind, name in OTHER.items():
        n = len(units)  # a motor for each command
        motors = CanMotors(types=[kind] * n, master_id=np.arange(n + 1, 2 * n + 1), timeout=1.0)
        theirs = other.DaMiaoMotor(1, 0x11, None, motor_type=name)
        assert (theirs._p_max, theirs._v_max, theirs._t_max) == RANGES[kind]
        given = [theirs.encode_cmd_msg(q, v, tau, kp, kd) for q, v, kp, kd, tau in units * motors.highest[:, 0]]
        on_grid = motors.lowest + np.transpose([codes_of(frame) for frame in given]) * motors.steps
        frames, outside = motors.encoded(on_grid)
        assert frames == given
        assert not len(outside)
        frames, _ = motors.encoded((units * motors.highest[:, 0]).T)
        sent = motors.lowest + np.transpose([codes_of(frame) for frame in frames]) * motors.steps
        off = np.abs(sent - (units * motors.highest[:, 0]).T) / motors.steps
        assert off[:4].max() <= 0.5 + 1e-9


def test_replies_are_read_as_by_another_implementation_and_half_a_step(other: Any, arms: dict[str, CanArm]) -> None:
    with Host(arms["seven"]) as host:
        sign, offset = host.motors.per_joint("sign"), host.motors.per_joint("offset")
        for rest in ("80008008001f2a", "0001fff00100ff", "abcd123456789a", "ffffffffffffff", "00000000000000"):
            frames = [bytes([1 << 4 | i]) + bytes.fromhex(rest) for i in range(1, 8)]
            host.sim(rules=[["raw", i, 0, 99, list(frame)] for i, frame in enumerate(frames)])
            host.ticks(2)
            seen = host.driver.call("motors", {})
            for i, kind in enumerate(host.motors.types):
                theirs = other.DaMiaoMotor(i + 1, i + 0x11, None, motor_type=OTHER[kind])
                state = theirs.decode_sensor_feedback(frames[i])
                for name, key, row in (("q", "pos", 0), ("v", "vel", 1), ("tau_meas", "torq", 4)):
                    ours = (host.x[name][i] - (offset[i] if name == "q" else 0.0)) * sign[i]
                    assert ours == pytest.approx(state[key] + 0.5 * host.motors.steps[row, i], abs=1e-12)
                of_joint = seen[host.arm.joint_names[i]]
                assert (of_joint["t_mos"], of_joint["t_coil"]) == (state["t_mos"], state["t_rotor"])
                assert of_joint["status"] == state["status_code"]


def test_the_simulated_motors_understand_another_implementation(other: Any, arms: dict[str, CanArm]) -> None:
    from loopback_can import LoopbackBus

    sim = arms["planar2"]
    sim(reset=True, rules=[])
    bus = LoopbackBus(sim.channel)
    theirs = other.DaMiaoMotor(1, 0x11, bus, motor_type="8009")

    def answer() -> Any:
        sim()
        message = bus.recv(1.0)
        theirs.process_feedback_frame(bytes(message.data), arbitration_id=message.arbitration_id)
        return theirs.get_states()

    theirs.request_register_reading(23)
    answer()
    assert theirs.registers[23] == 54.0
    theirs.set_can_timeout(100)
    answer()
    assert sim()["timeout"][0] == 2000
    theirs.request_motor_feedback()
    assert answer()["pos"] == pytest.approx(sim.arm.home[0] - can_arm.OFFSETS["planar2"][0], abs=STEP)
    theirs.enable()
    assert answer()["status"] == "ENABLED"
    theirs.send_cmd_mit(0.25, 0.0, 30.0, 1.0, 2.0)
    answer()
    np.testing.assert_allclose(
        sim()["sent"][0], [0.25 + can_arm.OFFSETS["planar2"][0], 0.0, 30.0, 1.0, 2.0], atol=0.13
    )
    bus.shutdown()


@pytest.mark.parametrize("kind", RANGES)
def test_rounding_of_position_and_velocity_does_not_change_the_torque(kind: str) -> None:
    motors, rng = CanMotors(types=[kind]), np.random.default_rng(3)
    high = motors.highest[:, 0]
    for unit in rng.uniform([-0.9, -0.9, 0, 0, -0.5], [0.9, 0.9, 1, 1, 0.5], (300, 5)):
        command = unit * high
        (frame,), _ = motors.encoded(command[:, np.newaxis])
        codes = np.array(codes_of(frame))
        q, v, kp, kd, tau = motors.lowest[:, 0] + codes * motors.steps[:, 0]
        at = command[0] + 0.01, command[1]  # where the motor is: only the rounding of the gains is left
        asked = command[2] * (command[0] - at[0]) + command[3] * (command[1] - at[1]) + command[4]
        given = kp * (q - at[0]) + kd * (v - at[1]) + tau
        assert abs(given - asked) <= 0.51 * motors.steps[4, 0] + 0.01 * 0.51 * motors.steps[2, 0]


@pytest.mark.parametrize(
    ("n", "bus", "rate", "load"),
    [(7, {}, 500.0, 0.945), (6, {}, 500.0, 0.81), (2, {}, 1000.0, 0.54), (7, {"data_bitrate": 5e6}, 1000.0, 0.7924), (7, {"bitrate": 5e5}, 250.0, 0.945)],
)  # fmt: skip
def test_the_bus_load_is_that_of_the_longest_frames(n: int, bus: dict[str, float], rate: float, load: float) -> None:
    motors = CanMotors(types=["DM4310"] * n, **bus)
    assert motors.control_rate == rate
    assert motors.bus_load == pytest.approx(load, rel=1e-3)
    assert CanMotors(types=["DM4310"] * n, rate=rate / load * 0.999, **bus).bus_load < 1.0
    with pytest.raises(RangeError):
        CanMotors(types=["DM4310"] * n, rate=rate / load * 1.001, **bus)


def test_the_longest_classic_frame_is_found_by_stuffing_bits() -> None:
    """Bit by bit: a stuff bit after five equal ones, itself counted; the pattern that needs most, and random ones."""

    def length(bits: list[int]) -> int:
        count, last, equal = 0, -1, 0
        for bit in bits:
            count, equal = count + 1, equal + 1 if bit == last else 1
            last = bit
            if equal == 5:
                count, last, equal = count + 1, 1 - bit, 1
        return count + 13

    worst = [0] * 5 + [x for _ in range(30) for x in ([1] * 4 + [0] * 4)]
    assert length(worst[:98]) == 135
    rng = np.random.default_rng(0)
    assert max(length(list(rng.integers(0, 2, 98))) for _ in range(1000)) < 135


class TestWhatIsRefused:
    def test_in_the_motors(self) -> None:
        with refused(UnknownNameError):
            CanMotors(types=["DM4310", "DM4341"])
        with refused(ShapeError):
            CanMotors(types=["DM4310"] * 3, sign=[1.0, -1.0])
        with refused(ShapeError):
            CanMotors(types=["DM4310"] * 3, ranges=[[12.5, 30.0, 10.0]])
        with refused(ShapeError):
            CanMotors(types=["DM4310"] * 2, sign=["+", "-"])  # type: ignore[arg-type]
        with refused(RangeError):
            CanMotors(types=["DM4310"] * 2, sign=0.5)
        with refused(RangeError):
            CanMotors(types=["DM4310"] * 2, id=[3, 3])
        with refused(RangeError):
            CanMotors(types=["DM4310"] * 2, id=[1, 17], master_id=[0x20, 0x20])
        for wrong in (
            {"id": [1, 0x11]}, {"master_id": [2, 1]}, {"timeout": 1e-5}, {"timeout": 1e6}, {"rate": 20.0},
            {"data_bitrate": 1e5}, {"types": []},
        ):  # fmt: skip
            with refused(taut.TautError):
                CanMotors(**{"types": ["DM4310"] * 2, **wrong})  # type: ignore[arg-type]
        with refused(RangeError):
            CanMotors(types=["DM4310"] * 7, rate=1000.0)

    @pytest.mark.parametrize("name", ["tau", "v", "lower", "upper"])
    def test_in_limits_that_a_motor_cannot_give_or_measure(self, name: str) -> None:
        arm, motors = can_arm.load("planar2"), can_arm.motors("planar2")
        motors.options(arm, taut.SafetyLimits.of(arm))
        limits = taut.SafetyLimits.of(
            arm, **{name: [0.5 * x for x in getattr(arm, {"tau": "effort", "v": "velocity"}.get(name, name))]}
        )
        motors.options(arm, limits)
        beyond = {"tau": [40.0, 28.1], "v": [6.0, 10.1], "lower": [-12.3, 0.0], "upper": [2.0, 11.4]}[name]
        with refused(RangeError) as told:
            motors.options(arm, taut.SafetyLimits.of(arm, **{name: beyond}))
        assert told.value.joint == arm.joint_names[0 if name == "lower" else 1]
        with pytest.raises(RangeError):
            motors.options(arm, taut.SafetyLimits.of(arm, **{name: None}))

    def test_when_connecting(self) -> None:
        arm = can_arm.load("planar2")
        with refused(UsageError):
            taut.connect("can://can0", arm)
        with refused(UsageError):
            taut.connect("udp://127.0.0.1:4000", arm, motors=can_arm.motors("planar2"))
        with refused(MatchError):
            taut.connect("can://can0", arm, motors=can_arm.motors("seven"))
        with refused(UsageError):
            taut.connect("can://can0", arm, motors=can_arm.motors("planar2"), options={"rate": 200.0})

    def test_an_address_where_nobody_is(self) -> None:
        arm = can_arm.load("planar2")
        for motors in (can_arm.motors("planar2"), can_arm.motors("planar2", interface="no_such")):
            options = motors.options(arm, taut.SafetyLimits.of(arm))
            driver = CanDriver("127.0.0.1:9", **options)
            with pytest.raises(DriverError) as told:
                driver.open()
            driver.close()
            assert told.value.kind == "disconnected"


class TestTheMotorsAreRead:
    def test_and_nothing_is_commanded_before_the_arm_is_controlled(self, arms: dict[str, CanArm]) -> None:
        with Host(arms["seven"]) as host:
            truth = host.ticks(3)
            assert truth["status"] == [0] * 7
            assert truth["commands"] == [0] * 7
            assert truth["timeout"] == [0] * 7
            np.testing.assert_allclose(host.x["q"], host.arm.home, atol=0.51 * STEP)
            np.testing.assert_allclose(host.x["v"], 0.0, atol=1e-12)  # in the middle of its step

    def test_and_motors_that_another_program_controls_are_left_alone(self, arms: dict[str, CanArm]) -> None:
        with Host(arms["planar2"]) as first:
            first.driver.begin()
            options = first.motors.options(first.arm, taut.SafetyLimits.of(first.arm))
            driver, done = CanDriver(arms["planar2"].channel, **options), threading.Event()

            def commands() -> None:
                while not done.wait(0.005):
                    first.tick(first.weight)

            thread = threading.Thread(target=commands)
            thread.start()
            with pytest.raises(DriverError) as told:
                driver.open()
            done.set()
            thread.join()
            driver.close()
            assert told.value.kind == "busy"
            assert first.sim()["status"] == [1, 1]

            driver = CanDriver(arms["planar2"].channel, **options)
            driver.open()
            driver.read({name: np.zeros(2) for name in ("q", "v", "tau_meas")})
            driver.close()
            truth = first.sim()
            assert truth["status"] == [1, 1]
            assert truth["timeout"] == [2000, 2000]

    @pytest.mark.parametrize("register", [(1, 21, 12.0), (1, 22, 8.0), (0, 23, 40.0), (1, 10, 2)])
    def test_and_other_ranges_or_another_mode_are_refused(
        self, register: tuple[Any, ...], arms: dict[str, CanArm]
    ) -> None:
        host = Host(arms["planar2"])
        host.sim(registers=[register])
        with pytest.raises(DriverError) as told, host:
            pass
        assert told.value.kind == "rejected"
        assert f"'{host.arm.joint_names[register[0]]}'" in str(told.value)
        assert f"register {register[1]}" in str(told.value)

    def test_and_ranges_that_are_stated_are_used(self, arms: dict[str, CanArm]) -> None:
        host = Host(arms["planar2"], ranges=[[12.5, 45.0, 54.0], [12.0, 8.0, 28.0]])
        host.sim(registers=[(1, 21, 12.0), (1, 22, 8.0)])
        with host:
            host.ticks(2)
            np.testing.assert_allclose(host.x["q"], host.arm.home, atol=0.51 * STEP)

    def test_and_one_that_is_silent_is_named_with_who_else_is_there(self, arms: dict[str, CanArm]) -> None:
        host = Host(arms["planar2"])
        host.sim(rules=[["mute", 1, 0, 10**6]])
        with pytest.raises(DriverError) as told, host:
            pass
        assert told.value.kind == "silent"
        assert "'joint2'" in str(told.value)
        assert "'joint1'" not in str(told.value)

    def test_and_wrong_identifiers_are_named(self, arms: dict[str, CanArm]) -> None:
        host = Host(arms["planar2"], id=[1, 2], master_id=[0x11, 0x22])
        with pytest.raises(DriverError) as told, host:
            pass
        assert told.value.kind == "silent"
        assert "'joint2' (0x02, replies 0x22)" in str(told.value)
        assert "0x12" in str(told.value)

    def test_and_motors_that_were_exchanged_are_known_by_their_ranges(self, arms: dict[str, CanArm]) -> None:
        host = Host(arms["planar2"], id=[2, 1])
        with pytest.raises(DriverError) as told, host:
            pass
        assert told.value.kind == "rejected"

    def test_and_wrong_signs_show_in_the_torques_against_gravity(self, arms: dict[str, CanArm]) -> None:
        """What bring-up compares: the arm's weight at what is measured, against what the motors give at rest."""
        off = []
        for signs in (1.0, -1.0):
            sign = np.array(can_arm.SIGNS["seven"])
            sign[[1, 3]] *= signs
            with Host(arms["seven"], sign=sign) as host:
                host.tick()
                host.driver.begin()
                host.driver.end()
                host.sim(period=0.05)
                host.ticks(60)  # the motors hold by themselves, for 3 s
                weight = np.asarray(taut.snapshot(host.arm, host.x["q"]).g)
                off.append(float(np.abs(host.x["tau_meas"] - weight).max()))
        assert off[0] < 0.1
        assert off[1] > 1.0


def comes_to(sim: CanArm, status: list[int]) -> bool:
    """Whether the motors report it within some time, which is 0.1 s on a machine that is not busy."""
    until = time.monotonic() + 10.0
    while sim()["status"] != status and time.monotonic() < until:
        time.sleep(0.05)
    return sim()["status"] == status


@pytest.mark.parametrize("name", NAMES)
def test_an_arm_does_not_jump_when_it_is_enabled(name: str, arms: dict[str, CanArm]) -> None:
    """Though its motors remember a spring of 300 N m/rad to another place."""
    with Host(arms[name]) as host:
        host.tick()
        host.driver.begin()
        truth = host.sim()
        assert truth["status"] == [1] * host.arm.n
        assert truth["timeout"] == [2000] * host.arm.n
        path = host.run(HOLDS, taut.JointMotion(q=host.arm.home), 250)  # as long as `stop` lets it stand
        assert np.abs(path - host.arm.home).max() < 3e-3  # what it falls in three periods
        host.driver.end()
        host.sim(period=0.02)
        truth = host.ticks(100)  # it holds itself, for 2 s
        assert truth["status"] == [1] * host.arm.n
        assert truth["timeout"] == [0] * host.arm.n
        np.testing.assert_allclose(truth["q"], host.arm.home, atol=4e-3)
    assert host.sim()["status"] == [0] * host.arm.n  # when it is closed, they are disabled


class TestAReplyThatIsMissing:
    def test_is_counted_and_the_last_one_holds(self, arms: dict[str, CanArm]) -> None:
        with Host(arms["planar2"]) as host:
            host.driver.begin()
            host.ticks(10, lambda x: host.weight(x) + PUSH)
            host.sim(rules=[["lose_reply", 1, 3, 5]])
            seen = []
            for _ in range(12):
                host.tick(lambda x: host.weight(x) + PUSH)
                seen.append((*host.x["q"], host.lost()[1]))
            moved = np.diff(seen, axis=0)
            missing = moved[:, 2] > 0.0
            assert missing.sum() == 5
            assert (moved[missing, 1] == 0.0).all()
            assert (moved[~missing, 1] != 0.0).all()
            assert (moved[:, 0] != 0.0).all()

    @pytest.mark.parametrize("missed", [1, 5, 20])
    def test_ends_the_motion_at_the_declared_number_and_not_before(
        self, missed: int, arms: dict[str, CanArm]
    ) -> None:
        with Host(arms["planar2"], missed=missed) as host:
            for count in (missed - 1, missed):
                host.driver.begin()
                host.tick(host.weight)
                host.sim(rules=[["lose_reply", 0, 1, count]])
                reads, told = 0, None
                while told is None and reads < missed + 5:
                    try:
                        host.tick(host.weight)
                    except DriverError as error:
                        told = error
                    reads += 1
                if count < missed:
                    assert told is None
                    host.driver.end()
                    host.ticks(2)
            assert told is not None
            assert told.kind == "silent"
            assert "'joint1'" in str(told)
            assert reads == missed + 1  # the first one has the reply to the command before
            host.driver.end()
            host.sim(rules=[])
            host.driver.recover()
            host.driver.begin()
            host.tick(host.weight)

    def test_that_is_late_gives_way_to_the_newest(self, arms: dict[str, CanArm]) -> None:
        with Host(arms["planar2"]) as host:
            host.driver.begin()
            host.sim(rules=[["late", -1, 20, 1, 3]])
            true, ages = [], []
            for k in range(30):
                true.append(host.tick(lambda x: host.weight(x) + PUSH)["q"][0])
                ages.append(k - int(np.argmin(np.abs(np.array(true) - host.x["q"][0]))))
            assert host.lost()[0] == 3
            assert ages[15:] == [1] * 5 + [2, 3, 4] + [1] * 7  # what followed waited behind it, and came with it

    def test_is_not_the_only_thing_that_a_bus_has(self, arms: dict[str, CanArm]) -> None:
        with Host(arms["planar2"]) as host:
            host.sim(rules=[["error_frame", -1, 1, 4], ["stranger", -1, 0, 9]])
            host.ticks(12)
            assert host.driver.call("motors", {})["error_frames"] == 4
            assert host.lost() == [0, 0]


def test_a_command_that_is_lost_leaves_the_one_before(arms: dict[str, CanArm]) -> None:
    with Host(arms["planar2"]) as host:
        host.driver.begin()
        host.ticks(3, host.weight)
        before = host.sim()["sent"]
        host.sim(rules=[["lose_command", 0, 0, 100]])
        truth = host.ticks(3, lambda x: host.weight(x) + 1.0)
        assert truth["sent"][0] == before[0]
        assert truth["sent"][1] != before[1]


def test_the_bus_keeps_the_rate_that_is_allowed_and_not_twice_as_much(arms: dict[str, CanArm]) -> None:
    classic, fd = {"bitrate": 1e7}, {"data_bitrate": 5e6}  # the bus has a tenth of 10 Mbit/s
    for rate, bus, fine in ((500.0, classic, True), (1000.0, classic, False), (1000.0, fd, True)):
        with Host(arms["seven"], rate=rate, missed=1000, **bus) as host:
            host.driver.begin()
            host.sim(period=1.0 / rate)
            truth = host.ticks(60, host.weight)
            assert (sum(host.lost()) == 0) == fine
            assert (truth["late"] == 0) == fine


@pytest.mark.parametrize("code", ERRORS)
def test_a_motor_that_reports_an_error_is_named_with_its_cause_and_recovers(
    code: int, arms: dict[str, CanArm]
) -> None:
    host_arm = arms["planar2"]
    with Host(host_arm) as host:
        host.driver.begin()
        host.tick(host.weight)
        host.sim(rules=[["error", 1, 2, 1, code]])
        with pytest.raises(DriverError) as told:
            host.ticks(6, host.weight)
        assert told.value.kind == "robot_error"
        assert "'joint2'" in str(told.value)
        assert ERRORS[code] in str(told.value)
        assert host.sim()["k"] == 2  # it is the reply of that period
        host.driver.end()
        with pytest.raises(DriverError):  # until it is cleared
            host.driver.begin()
        host.driver.end()
        host.driver.recover()
        host.driver.begin()
        assert host.tick(host.weight)["status"] == [1, 1]


def test_an_error_that_stays_is_not_recovered_from(arms: dict[str, CanArm]) -> None:
    with Host(arms["planar2"]) as host:
        host.sim(rules=[["error", 0, 0, 10**6, 0x9]])
        with pytest.raises(DriverError) as told:
            host.driver.begin()
        assert told.value.kind == "robot_error"
        with pytest.raises(DriverError):
            host.driver.recover()


def test_a_motor_that_disabled_itself_ends_the_motion(arms: dict[str, CanArm]) -> None:
    with Host(arms["planar2"]) as host:
        host.driver.begin()
        host.tick(host.weight)
        host.sim(rules=[["error", 0, 1, 1, 0x0]])
        with pytest.raises(DriverError) as told:
            host.ticks(4, host.weight)
        assert told.value.kind == "robot_error"


def test_motors_disable_themselves_where_the_host_is_gone(arms: dict[str, CanArm]) -> None:
    """And not while they are only held: then the timeout is that which they had."""
    with Host(arms["planar2"]) as host:
        host.driver.begin()
        host.tick(host.weight)
        host.sim(rules=[["watch", -1, 0, 10**6]])
        assert comes_to(host.sim, [0xD, 0xD])
        host.driver.recover()
        host.driver.begin()
        host.driver.end()
        time.sleep(0.2)
        assert host.sim()["status"] == [1, 1]


@pytest.mark.parametrize(
    ("row", "value"), [(0, 13.0), (1, -46.0), (2, 501.0), (3, 5.1), (4, 54.1), (2, -1.0), (4, np.nan), (0, np.inf)]
)
def test_a_command_out_of_the_motors_range_is_not_sent(row: int, value: float, arms: dict[str, CanArm]) -> None:
    with Host(arms["planar2"]) as host:
        host.driver.begin()
        truth = host.tick(host.weight)
        wild = host.weight()
        wild[row, 0] = value
        with pytest.raises(DriverError) as told:
            host.tick(wild)
        assert told.value.kind == "rejected"
        assert "'joint1'" in str(told.value)
        assert host.sim()["sent"] == truth["sent"]


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("split", [False, True], ids=["host", "split"])
def test_a_law_over_the_bus_is_the_loop_that_is_simulated_with_a_period_of_delay(
    name: str, split: bool, arms: dict[str, CanArm]
) -> None:
    """Torque by the host, or kp and kd in the motors and the rest by the host, at every resolution of the frames."""
    arm, rate = arms[name].arm, arms[name].rate
    M = np.diag(np.asarray(taut.snapshot(arm, arm.home).M))
    gains = (
        {"kp_motor": 225.0 * M, "kd_motor": np.minimum(30.0 * M, 4.5)}
        if split
        else {"kp_motor": 0.0, "kd_motor": 0.0}
    )
    law = taut.laws.ViaMit(law=taut.laws.ComputedTorque(kp=225.0, kd=30.0), **gains)
    ref = taut.trajectories.Sine(center=arm.home + 0.15, amplitude=-0.15, frequency=0.7, phase=0.5 * np.pi)
    with Host(arms[name]) as host:
        host.tick()
        host.driver.begin()
        wire = host.run(law, ref, 350)
    drives = taut.drives.Actuation(delay=1.0 / rate, inner_rate=can_arm.INNER)
    plant = taut.RigidPlant(arm, takes="mit", substeps=round(can_arm.INNER / rate), actuation=drives)
    run = taut.run(taut.compile(law, arm, rate=rate), plant, ref, duration=0.7, q0=arm.home)
    # A motor is read where its frame comes in the burst; what the arm fell when it was enabled has decayed.
    skew = np.gradient(run.q[:350], 1.0 / rate, axis=0) * can_arm.FRAME * np.arange(1, arm.n + 1)
    off = np.abs(wire - run.q[:350] - skew)[200:]
    assert off.max() < 2e-3
    assert np.abs(wire[-1] - arm.home).max() > 0.2


def test_a_wrist_buzzes_beyond_the_limit_that_is_computed_and_not_with_its_gains_in_the_motor(
    arms: dict[str, CanArm],
) -> None:
    """Host torque at 500 Hz over a bus that takes a period; and the same, larger gain in the motor at 4 kHz."""
    arm, rate, gain = arms["seven"].arm, arms["seven"].rate, np.array([2.0, 2.0, 1.0, 1.0, 0.3, 0.3, 1.0])
    kp = np.array([70.0, 70.0, 70.0, 60.0, 10.0, 10.0, 10.0])
    drives = taut.drives.Actuation(delay=1.0 / rate)
    plant = taut.RigidPlant(arm, takes="mit", substeps=4, actuation=drives)

    def law(kd: Any, *, motor: bool) -> taut.Law:
        inner = taut.laws.GravityPID(kp=kp, kd=kd)
        return taut.laws.ViaMit(law=inner) if motor else taut.laws.ViaMit(law=inner, kp_motor=0.0, kd_motor=0.0)

    ctrl = taut.compile(law(gain, motor=False), arm, rate=rate)
    verdict = taut.analysis.judge(taut.Loop(ctrl, plant, duration=1.0), gains=["law.kd"])
    limit = verdict.largest["law.kd"] * gain[-1]
    inertia = 1.0 / np.linalg.inv(np.asarray(taut.snapshot(arm, arm.home).M))[-1, -1]
    assert limit == pytest.approx(inertia * rate, rel=0.1)  # kd T < I, with a delay of one period
    speed = {}
    for kd, motor in ((0.8 * limit, False), (1.25 * limit, False), (4.5, True)):
        with Host(arms["seven"]) as host:
            host.driver.begin()
            gain[-1] = kd
            path = host.run(law(gain, motor=motor), taut.JointMotion(q=arm.home + 0.02), 200)
            speed[kd, motor] = float(np.abs(np.diff(path[-50:, -1])).max()) * rate
    assert limit < 4.5 / 2.0
    still, buzz, inner = speed.values()
    assert still < 0.2
    assert inner < 0.2
    assert buzz > 2.0


class TestTheLoop:
    def test_holds_under_a_threshold_of_contact_by_the_motors_own_torques(self, arms: dict[str, CanArm]) -> None:
        sim = arms["planar2"]
        sim(reset=True, rules=[])
        limits = taut.SafetyLimits.of(sim.arm, missed=250.0, contact=3.0)
        motors = can_arm.motors("planar2", rate=500.0, missed=250)
        with taut.connect(f"can://{sim.channel}", sim.arm, motors=motors, limits=limits) as robot:
            robot.hold()
            robot.wait(0.5)  # motors that are enabled carry no gravity for some milliseconds
            assert 0.0 < np.abs(robot.run().extra["memory.sensing.observer.tau_ext"][-1]).max() < 0.2

    def test_holds_moves_stops_and_recovers(self, arms: dict[str, CanArm]) -> None:
        sim = arms["planar2"]
        sim(reset=True, rules=[])
        arm, motors = sim.arm, can_arm.motors("planar2", rate=500.0, missed=250)
        limits = taut.SafetyLimits.of(arm, missed=250.0)
        names = arm.joint_names
        with taut.connect(f"can://{sim.channel}", arm, motors=motors, limits=limits) as robot:
            assert robot.rate == 500.0
            assert sim()["commands"] == [0, 0]
            law = taut.laws.GravityPID(kp=[80.0, 40.0], kd=[4.0, 2.0])
            ctrl = taut.compile(taut.laws.ViaMit(law=law), arm, rate=robot.rate)
            robot.start(ctrl)
            robot.wait(0.1)
            truth = sim()
            np.testing.assert_allclose(truth["q"], arm.home, atol=1e-2)
            assert np.allclose(np.array(truth["sent"])[:, 2], [80.0, 40.0], atol=0.1)  # they run in the motors

            sim(rules=[["error", 1, 1, 1, 0xA]])
            with pytest.raises(RobotError) as told:
                robot.wait(2.0)
            assert told.value.fault.name == "robot_error"
            assert names[1] in str(told.value)
            assert "overcurrent" in str(told.value)
            sim(reset=True, rules=[])  # the arm is put back: that joint had no torque
            robot.recover()

            robot.start(ctrl)
            sim(rules=[["mute", 0, 1, 10**6]])
            with pytest.raises(RobotError) as told:
                robot.wait(3.0)
            assert told.value.fault.name == "silent"
            sim(rules=[])
            robot.recover()

            wild = taut.compile(taut.laws.ViaMit(law=law, kp_motor=0.0, kd_motor=7.0), arm, rate=robot.rate)
            with refused(RangeError):
                robot.start(wild)
            robot.start(ctrl)
            with refused(RangeError):
                robot.parameters.update({"law.kp": [80.0, 501.0]})

            torques = taut.laws.ViaMit(
                law=taut.laws.GravityPID(kp=[80.0, 40.0], kd=[4.0, 90.0]), kp_motor=0.0, kd_motor=0.0
            )
            with pytest.raises(RangeError) as refused_gains:
                robot.start(taut.compile(torques, arm, rate=robot.rate))
            assert "law.kd" in str(refused_gains.value)

            robot.start(ctrl)
            robot.wait(0.05)
            robot.stop()
            assert robot.fault is None
            robot.wait(0.05)
            truth = sim()
            assert truth["status"] == [1, 1]  # the motors hold the arm
            assert truth["timeout"] == [0, 0]
            sim(rules=[["error", 1, 1, 1, 0xB]])
            with pytest.raises(RobotError) as told:
                robot.wait(2.0)
            assert told.value.fault.name == "robot_error"
            assert "too hot" in str(told.value)
            sim(reset=True, rules=[])
            robot.recover()

            robot.start(ctrl)
            sim(rules=[["reversed", 0, 0, 10**6]])
            with pytest.raises(RobotError) as told:
                robot.move_to(arm.home + np.array([0.5, 0.0]))
            assert told.value.fault.name == "sensor_inconsistent"
            assert told.value.fault.joint == names[0]
            sim(reset=True, rules=[])
            robot.recover()

            robot.start(ctrl)
            sim(rules=[["watch", -1, 0, 10**6]])
            robot.link.process.kill()
            robot.link.process.wait()
            assert comes_to(sim, [0xD, 0xD])
        sim(rules=[])


@pytest.mark.long
def test_every_tick_of_the_loop_on_the_bus_is_computed_again_from_its_log(
    arms: dict[str, CanArm], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """On the command line: the law within the law, the arm with its gears, and what the motors show at rest are in it."""
    sim = arms["planar2"]
    sim(reset=True, rules=[], period=1.0 / sim.rate)
    arm, motors = sim.arm, can_arm.motors("planar2", rate=500.0, missed=250)
    joints = taut.laws.ViaMit(law=taut.laws.GravityPID(kp=[80.0, 40.0], kd=[4.0, 2.0]))
    torque = taut.laws.ComputedTorque(kp=225.0, kd=[30.0, 30.0], ki=[0.0, 0.0])
    split = taut.laws.ViaMit(law=torque, kp_motor=[60.0, 20.0], kd_motor=1.0)
    limits = taut.SafetyLimits.of(arm, missed=250.0)
    with taut.connect(f"can://{sim.channel}", arm, motors=motors, limits=limits, log=tmp_path) as robot:
        for law in (joints, split):
            robot.start(taut.compile(law, arm, rate=robot.rate))
            robot.wait(0.2)
        robot.parameters["law.kp"] = 200.0
        robot.move_to(arm.home + 0.02)
        robot.hold()
        robot.wait(0.1)
        robot.stop()
    found = set()
    for file in tmp_path.iterdir():
        assert main(["replay", str(file), "--json"]) == 0
        assert json.loads(capsys.readouterr().out)["percent"] == 100.0
        found.add(taut.load_run(file).info.law)
    assert {repr(joints), repr(split)} < found  # and the law of move_to


def test_an_arm_that_is_stopped_in_motion_stays_where_it_stopped(arms: dict[str, CanArm]) -> None:
    """The motors go on with the torque of rest: neither that which braked, nor that of one tick with its steps."""
    sim = arms["planar2"]
    sim(reset=True, rules=[], period=1.0 / sim.rate)
    arm, motors = sim.arm, can_arm.motors("planar2", rate=500.0, missed=250)
    limits = taut.SafetyLimits.of(arm, missed=250.0)
    with taut.connect(f"can://{sim.channel}", arm, motors=motors, limits=limits) as robot:
        law = taut.laws.ViaMit(law=taut.laws.GravityPID(kp=[80.0, 40.0], kd=[4.0, 2.0]))
        ctrl = taut.compile(law, arm, rate=robot.rate)
        robot.start(ctrl, taut.trajectories.Sine(center=robot.q, amplitude=0.2, frequency=0.5), duration=20.0)
        robot.wait(2.06)
        assert np.abs(robot.v).max() > 0.3
        robot.stop()
        stopped, away = np.array(sim()["q"]), []
        for _ in range(10):
            robot.wait(0.1)
            away.append(np.abs(sim()["q"] - stopped).max())
        assert max(away) < 5e-3


def test_the_program_on_the_page_runs_the_seven_joints(
    arms: dict[str, CanArm], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = (Path(__file__).parents[3] / "docs" / "can_motors.md").read_text(encoding="utf-8")
    (program,) = re.findall(r"^```py\n(.*?)^```", page, re.MULTILINE | re.DOTALL)
    assert len([line for line in program.splitlines() if line.strip()]) <= 15
    sim = arms["seven"]
    sim(reset=True, rules=[])
    (tmp_path / "openarm.urdf").write_text(
        (can_arm.HERE / "seven.urdf").read_text(encoding="utf-8"), encoding="utf-8"
    )
    monkeypatch.chdir(tmp_path)
    changes = {
        "can://can0": f"can://{sim.channel}",
        "CanMotors(": "CanMotors(interface='loopback', missed=250,",
        "motors=motors)": "motors=motors, limits=taut.SafetyLimits.of(arm, missed=250.0))",  # of a busy machine
    }
    for word, other in changes.items():
        assert word in program
        program = program.replace(word, other)
    names: dict[str, Any] = {}
    exec(program, names)
    assert names["run"].outcome.ok
    np.testing.assert_allclose(names["run"].q, np.tile(sim.arm.home, (len(names["run"].q), 1)), atol=5e-3)
    assert sim()["status"] == [0] * 7


def test_motors_that_hold_by_themselves_keep_their_torque_when_control_begins(arms: dict[str, CanArm]) -> None:
    with Host(arms["seven"]) as host:
        host.tick()
        host.driver.call("hold", {})
        host.sim(period=0.05)
        truth = host.ticks(60)
        assert truth["status"] == [1] * 7
        assert truth["timeout"] == [0] * 7
        weight = np.asarray(taut.snapshot(host.arm, host.x["q"]).g)
        np.testing.assert_allclose(host.x["tau_meas"], weight, atol=0.1)
        host.driver.begin()
        np.testing.assert_allclose(np.array(host.sim()["sent"])[:, 4], weight, atol=0.1)
        host.driver.call("hold", {})  # they are held
        assert host.sim()["timeout"] == [2000] * 7
        host.driver.end()


def test_motors_hold_with_the_torque_of_several_ticks(arms: dict[str, CanArm]) -> None:
    """At rest a law of high gains goes round the steps of position and velocity, by more than 0.2 N m in a tick."""
    off = []
    with Host(arms["planar2"]) as host:
        host.tick()
        for k in range(6):
            host.driver.begin()
            host.run(HOLDS, taut.JointMotion(q=host.arm.home), 200 + 7 * k)
            host.driver.end()
            truth = host.sim()
            weight = np.asarray(taut.snapshot(host.arm, np.array(truth["q"])).g)
            off.append(np.abs(np.array(truth["sent"])[:, 4] - weight).max())
    assert max(off) < 0.15


@pytest.mark.long
def test_half_a_step_halves_the_steady_state_error(arms: dict[str, CanArm]) -> None:
    """Of computed torque on the seven joints, which gravity pulls at: values as motors cut them off, and their middles."""
    errors = {}
    for cut in (0.5, 0.0):
        with Host(arms["seven"]) as host:
            steps = cut * host.motors.steps * host.motors.per_joint("sign")
            law = taut.laws.ViaMit(law=taut.laws.ComputedTorque(kp=225.0, kd=30.0), kp_motor=0.0, kd_motor=0.0)
            ctrl, ref = taut.compile(law, host.arm, rate=host.info.rate), taut.JointMotion(q=host.arm.home)
            host.tick()
            host.driver.begin()
            at_rest = [
                host.tick(lambda x, ctrl=ctrl, ref=ref, steps=steps: ctrl.step(x["q"] - steps[0], x["v"] - steps[1], ref))["q"]
                for _ in range(1000)
            ][500:]  # fmt: skip
            host.driver.end()
        errors[cut] = float(np.abs(np.array(at_rest) - host.arm.home).mean(axis=0).max())
    assert errors[0.5] == pytest.approx(1.8e-3, abs=0.2e-3)
    assert errors[0.0] == pytest.approx(0.9e-3, abs=0.2e-3)


@pytest.mark.long
def test_a_robot_file_is_brought_up_and_runs_a_scenario(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    for name, value in {"READ": 0.5, "SHADOW": 0.2, "SPEED": 0.3}.items():
        monkeypatch.setattr(bringup, name, value)
    file, wrong, scenario = (tmp_path / name for name in ("arm.toml", "wrong.toml", "reach.toml"))
    scenario.write_text(can_arm.SCENARIO)
    run = ["run", str(scenario), "--robot", str(file), "--out", str(tmp_path / "out"), "--yes"]
    with CanArm("planar2") as sim:
        file.write_text(can_arm.ROBOT.format(channel=sim.channel, sign="[1, -1]"))
        wrong.write_text(can_arm.ROBOT.format(channel=sim.channel, sign="[-1, -1]"))
        assert main(run) == 2
        assert f"taut bringup {file} --scenario {scenario}" in capsys.readouterr().err
        assert sim()["commands"] == [0, 0]

        assert main(["bringup", str(wrong), "--scenario", str(scenario), "--yes", "--json"]) == 1
        (fault,) = json.loads(capsys.readouterr().out)["faults"]
        assert fault.startswith("gravity")  # the motors alone held the arm meanwhile
        assert "sign, offset or ranges of its motors" in fault
        sim(reset=True)

        assert main(["bringup", str(file), "--scenario", str(scenario), "--yes", "--json"]) == 0
        found = json.loads(capsys.readouterr().out)
        assert found["passed"]
        assert "not compared: pose of the tool, load" in found["title"]
        assert main(run) == 0
        wrong.rename(file)  # the same robot with another sign is another one
        assert main(run) == 2
    done = taut.load_run(tmp_path / "out" / "reach.mcap")
    assert done.outcome.ok
    assert done.info.plant.startswith("CAN arm")
    assert np.abs(done.q[0] - sim.arm.home).max() < 0.01
    assert np.abs(done.q[-1] - [0.55, 1.55]).max() < 0.02
