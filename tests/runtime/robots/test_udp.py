"""A robot on UDP: the newest packet wins, counts are exact, silence ends the motion, nothing malformed gets through."""

from __future__ import annotations

import json
import os
import signal
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import refused
from udp_arm import delays, simulated

import taut
from taut.base.errors import RangeError, UsageError
from taut.cli.main import main
from taut.robots import DriverError, RobotError
from taut.runtime.realtime.bringup import remember
from taut.runtime.realtime.connect import hello_of
from taut.runtime.robots.udp import BUSY, COMMAND, COUNTS, HEAD, HELLO, INFO, LISTEN, STATE, UdpDriver

ARMS = {"planar2": 2, "ur5": 6, "ur10": 6, "panda": 7}


class Peer:
    """The robot's end of a connection, by hand: no clock, and packets as a test likes them."""

    def __init__(self, n: int, info: Any = None, version: int = 1) -> None:
        self.n, self.version, self.session, self.busy = n, version, 0, False
        self.info = {"name": "peer", "n": n, "rate": 1000.0, "takes": "torque", **(info or {})}
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(5.0)
        self.address = f"127.0.0.1:{self.socket.getsockname()[1]}"

    def packet(self, number: int, doubles: Any, mode: int = 0) -> bytes:
        head = HEAD.pack(b"taut", self.version, STATE, self.n, self.session, number, 0, mode)
        return head + np.asarray(doubles, dtype="<f8").tobytes()

    def send(self, data: bytes) -> None:
        self.socket.sendto(data, self.client)

    def heard(self) -> tuple[Any, ...]:
        """The next packet of the driver: head and doubles."""
        data, self.client = self.socket.recvfrom(65536)
        return (*HEAD.unpack_from(data), np.frombuffer(data, "<f8", offset=HEAD.size))

    def forget(self) -> None:
        """Drop what has arrived."""
        self.socket.settimeout(0.0)
        with suppress(BlockingIOError):
            while True:
                self.socket.recv(65536)
        self.socket.settimeout(5.0)

    def greet(self, first: bytes | None = None) -> None:
        """Answer a hello with the information, and the first question with a state."""
        _, _, kind, _, self.session, *_ = self.heard()
        assert kind == HELLO
        text = self.info if isinstance(self.info, bytes) else json.dumps(self.info).encode()
        kind = BUSY if self.busy else INFO
        self.send(HEAD.pack(b"taut", self.version, kind, self.n, self.session, 0, 0, 0) + text)
        if first is not None and self.heard()[2] == LISTEN:
            self.send(first or self.packet(1, np.zeros(2 * self.n)))


@contextmanager
def opened(peer: Peer, *, missed: int = 20, first: bytes = b"") -> Iterator[UdpDriver]:
    """A driver that is open, and controls the peer; its first state was number 1."""
    driver = UdpDriver(peer.address, missed=missed)
    try:
        answered(peer, driver.open, first=first)
        driver.begin()
        yield driver
    finally:
        driver.close()
        peer.socket.close()


def answered(peer: Peer, call: Callable[[], Any], *, first: bytes | None = b"") -> None:
    """Call what greets, while the peer answers; with state 1 unless another one is given."""
    answers = threading.Thread(target=peer.greet, args=(first,))
    answers.start()
    try:
        call()
    finally:
        answers.join()


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


def arrays(n: int) -> dict[str, Any]:
    return {"q": np.full(n, np.nan), "v": np.full(n, np.nan)}


@pytest.mark.parametrize("arm", ARMS)
def test_the_newest_of_lost_late_doubled_and_reordered_states_wins_and_the_counts_are_exact(arm: str) -> None:
    n, periods, seed = ARMS[arm], 1000, 1
    fates, rng = delays(seed, lost=0.1, doubled=0.1, delayed=0.1, by=15), np.random.default_rng(seed)
    arrivals: list[list[int]] = [[] for _ in range(periods + 20)]
    for number in range(2, periods):
        for delay in next(fates):
            arrivals[number + delay].append(number)
    states = rng.standard_normal((periods, 2 * n))
    seen, newest, state = {1}, 1, np.zeros(2 * n)
    expected = dict.fromkeys(COUNTS, 0) | {"received": 1}
    peer, measured = Peer(n), arrays(n)
    with opened(peer, missed=1000) as driver:
        expected["extrapolated"] = driver.call("counts", {})["extrapolated"]  # reads before state 1
        for numbers in arrivals:
            rng.shuffle(numbers)
            fresh = False
            for number in numbers:
                peer.send(peer.packet(number, states[number]))
                if number > newest:
                    expected["received"] += 1
                    state, newest, fresh = states[number].copy(), number, True
                else:
                    expected["doubled" if number in seen else "late"] += 1
                seen.add(number)
            if not fresh:
                expected["extrapolated"] += 1
                state[:n] = state[:n] + 1e-3 * state[n:]
            driver.read(measured)
            assert np.array_equal(np.concatenate([measured["q"], measured["v"]]), state)
        expected["lost"] = newest - len(seen)
        assert {name: driver.call("counts", {})[name] for name in COUNTS} == expected
    assert min(expected[name] for name in ("lost", "late", "doubled", "extrapolated")) > 30


@pytest.mark.parametrize("limit", [1, 7, 20])
def test_the_motion_ends_at_exactly_the_declared_number_of_missed_states(limit: int) -> None:
    n, peer, measured = 6, Peer(6), arrays(6)
    q, v = np.linspace(-1.0, 1.0, n), np.linspace(0.5, -0.5, n)
    with opened(peer, missed=limit) as driver:
        for number in (2, 3):  # every state begins the count anew
            peer.send(peer.packet(number, [*q, *v]))
            driver.read(measured)
            for k in range(1, limit):
                driver.read(measured)
                assert np.allclose(measured["q"], q + 1e-3 * k * v, atol=1e-15)
                assert np.array_equal(measured["v"], v)
        with pytest.raises(DriverError) as stopped:
            driver.read(measured)
        assert stopped.value.kind == "silent"


def test_a_robot_that_stopped_by_itself_ends_the_motion_and_is_not_controlled_again_before_recover() -> None:
    peer, measured = Peer(2, {"facts": {"modes": {"3": "motor 2 is too hot"}}}), arrays(2)
    with opened(peer) as driver:
        peer.send(peer.packet(2, np.zeros(4), mode=1))
        driver.read(measured)
        peer.send(peer.packet(3, np.zeros(4), mode=3))
        with refused(DriverError):
            driver.read(measured)
        driver.end()
        driver.read(measured)  # it is only read
        with refused(DriverError):
            driver.begin()
        peer.forget()
        answered(peer, driver.recover)
        driver.begin()
        driver.read(measured)


def test_commands_are_numbered_and_hold_what_was_written() -> None:
    peer, measured = Peer(7), arrays(7)
    with opened(peer) as driver:
        peer.forget()  # what asked for the first state
        numbers = []
        for k in range(3):
            command = np.arange(7.0) + k
            driver.write(command)
            _, _, kind, n, session, number, sent, _, doubles = peer.heard()
            assert (kind, n, session) == (COMMAND, 7, peer.session)
            assert abs(time.monotonic_ns() - sent) < 1e9
            assert np.array_equal(doubles, command)
            numbers.append(number)
        assert numbers == [numbers[0] + k for k in range(3)]
        driver.end()
        assert peer.heard()[2] == LISTEN
        driver.read(measured)
        assert peer.heard()[2] == LISTEN  # where it does not control, each read asks for a state


@pytest.mark.bars
def test_malformed_packets_never_change_the_state(
    share: Callable[[int], int], bar: Callable[[str, object], None]
) -> None:
    count, rng = share(10_000), np.random.default_rng(5)
    peer, measured = Peer(6), arrays(6)
    good = rng.standard_normal(12)
    with opened(peer, missed=10**6) as driver:
        before = dict(driver.call("counts", {}))
        for k in range(count):
            data = bytearray(peer.packet(2, good))
            kind = k % 5
            if kind == 0:  # another length
                data = data[: rng.integers(0, len(data))] if k % 2 else data + bytes(int(rng.integers(1, 9000)))
            elif kind == 1:  # one of the 16 bytes of head and session
                data[rng.integers(0, 16)] ^= int(rng.integers(1, 256))
            elif kind == 2:  # random bytes, of the right length
                data = bytearray(rng.bytes(len(data)))
            elif kind == 3:  # a number that is none, or runs away
                data[16:24] = struct.pack("<q", int(rng.choice([0, -1, -(2**63), 2**62, 2**63 - 1])))
            else:  # an empty packet
                data = bytearray()
            peer.send(bytes(data))
            driver.read(measured)
            assert not np.any(measured["q"])
            assert not np.any(measured["v"])
        after = driver.call("counts", {})
        assert after["malformed"] - before["malformed"] == count
        assert all(after[name] == before[name] for name in COUNTS if name not in ("malformed", "extrapolated"))
        peer.send(peer.packet(2, good))
        driver.read(measured)
        assert np.array_equal(np.concatenate([measured["q"], measured["v"]]), good)
    bar("malformed packets of a robot on UDP: that changed its state; crashes", f"0 of {count}; 0")


def test_a_flood_is_read_within_a_bounded_number_of_packets() -> None:
    peer, measured = Peer(2), arrays(2)
    with opened(peer) as driver:
        for number in range(2, 102):
            peer.send(peer.packet(number, np.full(4, float(number))))
        driver.read(measured)
        assert measured["q"][0] == 65.0
        driver.read(measured)
        assert measured["q"][0] == 101.0


BAD: dict[str, Any] = {
    "not JSON": b"{'n': 2}",
    "not an object": b"[1, 2]",
    "deep": b"[" * 20_000,
    "an unknown field": {"names": ["a"]},
    "no whole number": {"n": 2.5},
    "no joints": {"n": 0},
    "NaN": {"rate": float("nan")},
    "too many": {"n": 600},
    "a word": {"takes": "force"},
    "a measurement": {"measures": ["v", "w"]},
    "no velocity": {"measures": ["tau_meas"]},
    "an addition": {"adds": ["gravitation"]},
    "modes": {"facts": {"modes": 3}},
    "facts": {"facts": ["a"]},
    "joints": {"joint_names": 3},
    "a load": {"load": [1.0, 0.0, 0.0]},
}


@pytest.mark.parametrize("what", BAD)
def test_a_robot_that_declares_nonsense_is_refused(what: str) -> None:
    peer = Peer(2, None if isinstance(BAD[what], bytes) else BAD[what])
    if isinstance(BAD[what], bytes):
        peer.info = BAD[what]
    driver = UdpDriver(peer.address)
    driver._address = "udp://peer"  # without the port, in messages.txt
    with refused(DriverError) as found:
        answered(peer, driver.open, first=None)
    assert found.value.kind == "rejected"
    driver.close()
    peer.socket.close()


def test_another_version_a_second_client_states_of_another_size_and_wrong_addresses_are_refused() -> None:
    newer, second = Peer(2, version=2), Peer(2)
    second.busy = True
    for peer, kind in ((newer, "rejected"), (second, "busy")):
        driver = UdpDriver(peer.address)
        with pytest.raises(DriverError) as found:
            answered(peer, driver.open, first=None)
        assert found.value.kind == kind
        driver.close()
        peer.socket.close()
    with pytest.raises(DriverError) as found, opened(Peer(2), first=bytes(72)):
        pass
    assert found.value.kind == "rejected"
    with pytest.raises(DriverError) as found, closing(UdpDriver(f"127.0.0.1:{free_port()}")) as driver:
        driver.open()
    assert found.value.kind == "disconnected"
    with refused(UsageError):
        UdpDriver("localhost")
    with refused(RangeError):
        UdpDriver("127.0.0.1:1", missed=0)


def test_an_arm_moves_over_a_bad_network_and_its_death_is_a_fault_until_it_is_back() -> None:
    arm = taut.load_arm("ur5")
    network = {"seed": 4, "lost": 0.03, "doubled": 0.05, "delayed": 0.05, "by": 3}
    with (
        simulated("ur5", network=network) as (process, port),
        taut.connect(f"udp://127.0.0.1:{port}", arm, options={"missed": 300}) as robot,
    ):
        assert np.abs(robot.q - arm.home).max() < 1e-6
        with pytest.raises(DriverError) as second, closing(UdpDriver(f"127.0.0.1:{port}")) as other:
            other.open()
        assert second.value.kind == "busy"
        robot.move_to(arm.home + 0.05, speed=0.3)
        counts = robot.call("counts")
        assert min(counts[name] for name in ("lost", "late", "doubled", "extrapolated")) > 3
        assert counts["malformed"] == 0
        assert robot.status.state == "running"
        process.kill()
        with pytest.raises(RobotError) as dead:
            robot.wait(5.0)
        assert dead.value.fault.name == "silent"
        with pytest.raises(DriverError) as gone:
            robot.recover()
        assert gone.value.kind == "disconnected"
        with simulated("ur5", port=port):
            robot.recover()
            robot.hold()
            robot.wait(0.1)
            assert robot.status.state == "holding"


def test_a_robot_that_keeps_the_time_paces_the_loop_and_nan_stops_it() -> None:
    arm = taut.load_arm("planar2")
    with (
        simulated("planar2", info={"paced_by": "robot", "rate": 500.0}, nan_after=200) as (_, port),
        taut.connect(f"udp://127.0.0.1:{port}", arm, options={"missed": 300}) as robot,
    ):
        assert robot.rate == 500.0
        robot.hold()
        with pytest.raises(RobotError) as stopped:
            robot.wait(30.0)
        fault, run = stopped.value.fault, robot.run()
        assert (fault.name, fault.joint) == ("sensor_not_finite", arm.joint_names[-1])
        assert np.isfinite(run.command).all()
        assert robot.call("counts")["received"] > 100


def test_what_strangers_send_does_not_keep_the_arm_from_braking() -> None:
    """A client that is gone stops the arm, however many packets of others come in."""
    with simulated("planar2") as (_, port), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.settimeout(2.0)
        sock.connect(("127.0.0.1", port))
        sock.send(HEAD.pack(b"taut", 1, HELLO, 2, 7, 0, 0, 0))
        assert HEAD.unpack_from(sock.recv(2048))[2] == INFO
        sock.send(HEAD.pack(b"taut", 1, COMMAND, 2, 7, 1, 0, 0) + np.zeros(2).tobytes())
        assert HEAD.unpack_from(sock.recv(2048))[-1] == 1  # controlled
        until = time.monotonic() + 0.4
        while time.monotonic() < until:
            sock.send(b"junk")
            sock.send(HEAD.pack(b"taut", 1, COMMAND, 2, 8, 1, 0, 0) + np.zeros(2).tobytes())
            time.sleep(0.01)
        sock.send(HEAD.pack(b"taut", 1, LISTEN, 2, 7, 2, 0, 0))
        assert HEAD.unpack_from(sock.recv(2048))[-1] == 2  # stopped


@pytest.mark.long
def test_a_scenario_runs_on_a_robot_whose_bring_up_has_passed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    arm, file = taut.load_arm("planar2"), tmp_path / "reach.toml"
    file.write_text(
        """
        title = "A joint sine, on a robot"
        arm = { model = "planar2" }
        laws.stiff = { law = "ComputedTorque", kp = 400.0, kd = 40.0 }
        laws.soft = { law = "ComputedTorque", kp = 25.0, kd = 10.0 }
        plant = { kind = "rigid" }
        reference = { kind = "set-point", q = [0.55, 1.55] }
        run = { duration = 0.4, q0 = [0.5, 1.6] }
        outputs = { log = "reach.mcap", shown = "stiff" }
        [[event]]
        t = 0.2
        set = { "law.kp" = 100.0 }
        [[pass]]
        law = "stiff"
        metric = "final_error"
        max = 0.02
        """
    )
    with simulated("planar2", info={"rate": 100.0}) as (_, port):
        address = f"udp://127.0.0.1:{port}"
        remember(hello_of(address, arm), arm)
        assert main(["run", str(file), "--robot", address, "--out", str(tmp_path / "out")]) == 0
    run = taut.load_run(tmp_path / "out" / "reach.mcap")
    assert len(run) == 41
    assert run.info.plant.startswith("simulated planar2")
    assert np.abs(run.q[0] - [0.5, 1.6]).max() < 5e-3
    laws = {taut.load_run(file).info.law for file in (tmp_path / "out" / "robot").iterdir()}
    assert laws >= {"ComputedTorque(kp=400.0, kd=40.0)", "ComputedTorque(kp=25.0, kd=10.0)"}


@pytest.mark.long
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP])
@pytest.mark.parametrize("name", ["planar2", "ur10", "panda"])
def test_a_robot_that_dies_or_stops_is_a_fault_within_100_ms(
    name: str, how: signal.Signals, bar: Callable[[str, object], None]
) -> None:
    arm = taut.load_arm(name)
    with simulated(name) as (process, port), taut.connect(f"udp://127.0.0.1:{port}", arm) as robot:
        robot.start(taut.compile(taut.laws.ComputedTorque(kp=100.0, kd=20.0), arm, rate=1000.0))
        robot.wait(0.2)
        os.kill(process.pid, how)
        since = time.monotonic()
        while robot.fault is None and time.monotonic() < since + 2.0:
            time.sleep(5e-4)
        took = time.monotonic() - since
        assert robot.fault is not None
        assert robot.fault.name == "silent"
        bar(f"robot on UDP, {name}: {how.name} until the fault [ms]", round(1e3 * took, 1))
        assert took < 0.1
