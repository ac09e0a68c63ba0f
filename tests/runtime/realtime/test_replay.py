"""Records of a robot: each law in a file, no tick missing at a switch, each tick computed again to the last bit."""

from __future__ import annotations

import dataclasses
import itertools
import json
import os
import re
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from integrating_driver import IntegratingDriver
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from refusals import refused

import taut
from taut.cli.main import main
from taut.record.log.reading import CHUNK_MARK, CHUNK_MARK_AT, intact_parts
from taut.runtime.realtime.status import RobotError

pytestmark = pytest.mark.xdist_group("robots")


class Recorded:
    """What happened to a robot, with the controllers that acted, and the files of its log."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.laws = list[taut.Controller]()
        self.kept = list[taut.Run]()  # from the ring, after each law

    @property
    def files(self) -> list[Path]:
        return sorted(self.folder.iterdir())

    def file_of(self, name: str) -> Path:
        return next(file for file in self.files if name in file.name)


def panda() -> taut.Arm:
    return taut.load_arm("panda").with_payload(0.5)


@pytest.fixture(scope="module")
def torque(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """A Panda: parameters that change, a stream, a task, a law with filters and observer, a fault."""
    out, arm = Recorded(tmp_path_factory.mktemp("torque")), panda()
    limits = taut.SafetyLimits.of(arm, v=None, contact=60.0, tool_speed=1.0, missed=1e9)  # a machine may stall
    plant = taut.RigidPlant(arm.with_payload(1.0))
    seen = taut.Sensing(
        velocity=taut.sensors.LowPass(cutoff=80.0), observer=taut.sensors.MomentumObserver(bandwidth=40.0)
    )
    with taut.connect(plant, arm, limits=limits, log=out.folder) as robot:

        def made(law: Any, sensing: taut.Sensing = seen, **given: Any) -> taut.Controller:
            out.laws.append(taut.compile(law, arm, rate=robot.rate, adds=robot.adds, sensing=sensing, **given))
            return out.laws[-1]

        joints = taut.laws.ComputedTorque(kp=100.0, kd=20.0, ki=10.0)
        robot.start(made(joints, limits=taut.Limits.of(arm)))
        logger = robot._log.process  # type: ignore[union-attr]
        os.kill(logger.pid, signal.SIGSTOP)  # as if a disk stalled
        ticks = robot.status.ticks
        for kp in (120.0, 80.0, 150.0):
            robot.parameters["law.kp"] = kp
            robot.wait(0.05)
        assert robot.status.ticks > ticks
        os.kill(logger.pid, signal.SIGCONT)
        robot.parameters["model.payload.mass"] = 0.8
        robot.wait(0.05)
        out.kept.append(robot.run())
        robot.switch(made(taut.laws.Impedance(K=(300.0, 20.0), zeta=0.7)), taut.stream(period=0.05))
        send, pose = robot.stream(period=0.05), taut.snapshot(arm, robot.q, robot.v).T()
        for k in range(6):
            send(taut.TaskMotion(pose=taut.Pose.of(pose.R, pose.p + 0.002 * k)))
            robot.wait(0.02)
        with pytest.raises(RobotError):  # the stream stops
            robot.wait(1.0)
        out.kept.append(robot.run())
        robot.recover()
        there = taut.trajectories.Quintic(q0=robot.q, q1=robot.q + 0.02, duration=0.1)
        robot.start(made([
            taut.Phase(joints, there, name="go", until=lambda x: x.elapsed > 0.12),
            taut.Phase(taut.laws.ComputedTorque(kp=50.0, kd=14.0), name="stay"),
        ]))  # fmt: skip
        robot.wait(0.3)
        out.kept.append(robot.stop())
        assert robot.status.dropped == 0
    return out


@pytest.fixture(scope="module")
def velocity(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """A UR10 that takes velocities and measures none, by a driver in Python."""
    out, arm = Recorded(tmp_path_factory.mktemp("velocity")), taut.load_arm("ur10")
    limits = taut.SafetyLimits.of(arm, missed=1e9)
    with taut.connect(IntegratingDriver, arm, limits=limits, log=out.folder) as robot:
        law = taut.laws.VelocityPI(kp=5.0)
        seen = taut.Sensing(velocity="difference")
        out.laws.append(taut.compile(law, arm, rate=robot.rate, adds=robot.adds, sensing=seen))
        robot.start(out.laws[0], taut.JointMotion(q=robot.q + 0.05))
        robot.wait(0.2)
        out.kept.append(robot.stop())
    return out


def ticks_of(run: taut.Run) -> Any:
    return run.extra["loop.tick"].astype(int)


def test_torques_that_a_robot_neither_takes_nor_measures_are_not_a_number(velocity: Recorded) -> None:
    run = taut.load_run(velocity.file_of("VelocityPI"))
    for one in (velocity.kept[0], run):
        assert np.isnan(one.tau).all()
        assert np.isfinite(one.command).all()
        assert "effort" not in str(one.metrics)


def test_every_law_has_a_file_and_no_tick_is_missing_between_them(torque: Recorded) -> None:
    names = [file.name.partition("-")[2][11:].removesuffix(".mcap") for file in torque.files]
    assert names == ["ComputedTorque", "Impedance", "the_task_of_go_stay"]
    runs = [taut.load_run(file) for file in torque.files]
    ticks = [ticks_of(run) for run in runs]
    assert all((np.diff(numbers) == 1).all() for numbers in ticks)
    switched, recovered = (later[0] - earlier[-1] for earlier, later in itertools.pairwise(ticks))
    assert switched == 1
    assert recovered > 1  # not controlled, after the fault
    assert [run.outcome.kind for run in runs] == ["completed", "stopped", "completed"]
    assert "stream_stopped" in runs[1].outcome.message


def test_every_tick_of_every_law_is_computed_again_to_the_last_bit(
    torque: Recorded, velocity: Recorded, bar: Any
) -> None:
    total = 0
    for recorded in (torque, velocity):
        files = [recorded.file_of(re.sub("[^A-Za-z0-9]+", "_", law.side.title)) for law in recorded.laws]
        for ctrl, kept, file in zip(recorded.laws, recorded.kept, files, strict=True):
            for run in (kept, taut.load_run(file)):
                found = taut.analysis.replay(run, ctrl)
                assert (found.identical, found.first, found.ticks) == (len(run), None, len(run)), found
                total += len(run)
    changed = taut.load_run(torque.file_of("ComputedTorque")).extra
    assert len(np.unique(changed["parameters.law.kp"])) == 4
    assert {0.5, 0.8} <= set(changed["parameters.model.payload.mass"])
    bar("replay: ticks of 4 laws on 2 robots computed again; bit-identical", f"{total}; 100 %")


@pytest.mark.parametrize("rate", [100.0, 10_000.0])
def test_ticks_of_slow_and_of_fast_loops_are_computed_again_to_the_last_bit(rate: float) -> None:
    arm = taut.load_arm("planar2")
    with taut.connect(taut.RigidPlant(arm), rate=rate, limits=taut.SafetyLimits.of(arm, v=None, missed=1e9)) as robot:
        ctrl = taut.compile(taut.laws.ComputedTorque(kp=100.0, kd=20.0, ki=10.0), arm, rate=rate, adds=robot.adds)
        robot.start(ctrl, taut.JointMotion(q=robot.q + 0.05))
        robot.wait(0.3)
        run = robot.stop()
    found = taut.analysis.replay(run, ctrl)
    assert found.ok, found
    assert len(run) > 10


def test_a_changed_number_is_found_in_its_tick(torque: Recorded) -> None:
    """One unit in the last place of an input, a parameter, the memory, an output."""
    run = torque.kept[0]
    for name, k in (("q", 17), ("extra.parameters.law.kp", 5), ("extra.memory.safe.v", 9), ("command", 3)):
        arrays = {key: value.copy() for key, value in run.arrays().items()}
        row = arrays[name][k : k + 1]
        row[...] = np.nextafter(row, np.inf)
        parts: dict[str, Any] = {"extra": {key[6:]: x for key, x in arrays.items() if key.startswith("extra.")}}
        other = dataclasses.replace(run, q=arrays["q"], command=arrays["command"], **parts)
        found = taut.analysis.replay(other, torque.laws[0])
        assert found.first is not None
        assert found.first[0] in (k, k - 1), name
        assert len(run) - 2 <= found.identical < len(run)
        assert not found.ok
        json.dumps(found.json())


def test_a_record_of_another_law_arm_or_limit_is_refused(torque: Recorded, velocity: Recorded) -> None:
    run, arm, seen = torque.kept[0], panda(), torque.laws[0].side.sensing
    law = taut.laws.ComputedTorque(kp=1.0, kd=2.0, ki=3.0)  # gains are parameters, and in the record
    assert taut.analysis.replay(run, taut.compile(law, arm, sensing=seen, limits=taut.Limits.of(arm))).ok
    body = dataclasses.replace(arm.bodies[3], mass=arm.bodies[3].mass + 1e-9)
    heavier = dataclasses.replace(arm, bodies=(*arm.bodies[:3], body, *arm.bodies[4:]))
    others = {
        "law": taut.compile(taut.laws.GravityPID(kp=100.0, kd=20.0), arm, sensing=seen, limits=taut.Limits.of(arm)),
        "arm": taut.compile(law, heavier, sensing=seen, limits=taut.Limits.of(arm)),
        "sensing": taut.compile(law, arm, limits=taut.Limits.of(arm)),  # without the observer that the limits need
        "limits": taut.compile(law, arm, sensing=seen),
    }
    for ctrl in others.values():
        with pytest.raises(taut.errors.MatchError):
            taut.analysis.replay(run, ctrl)
    with refused(taut.errors.MatchError):
        taut.analysis.replay(run, velocity.laws[0])
    with refused(taut.errors.UsageError):
        taut.analysis.replay(taut.run(torque.laws[0], taut.RigidPlant(arm), duration=0.01), torque.laws[0])


def test_the_command_makes_the_law_from_the_log(
    torque: Recorded, velocity: Recorded, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Law, arm, sensing and limits stand in it; a task needs its file, and says so."""
    for recorded, name in (
        (torque, "ComputedTorque"),
        (torque, "Impedance"),
        (velocity, "Velocity"),
    ):
        assert main(["replay", str(recorded.file_of(name)), "--json"]) == 0
        found = json.loads(capsys.readouterr().out)
        assert found["percent"] == 100.0
        assert found["ticks"] > 20
    assert main(["replay", str(torque.file_of("task"))]) == 2
    assert "replay" in capsys.readouterr().err
    own = tmp_path / "own.py"
    own.write_text(
        "import taut\nclass Mine(taut.Law):\n    kp: taut.Gain\n    def command(self, x, ref):\n"
        "        return taut.Torque(P=self.kp @ (ref.q - x.q))\n"
    )
    assert main(["replay", str(torque.file_of("ComputedTorque")), "--law", f"{own}:Mine", "--gain", "kp=1"]) == 2
    assert main(["replay", str(torque.file_of("ComputedTorque")), "--arm", "ur10"]) == 2


# -------------------------------------------------------------------- repair and readers


def test_a_cut_or_damaged_log_is_repaired(
    torque: Recorded, tmp_path: Path, share: Callable[[int], int], bar: Any
) -> None:
    """Cut anywhere, bits flipped: what is whole is in files that the seeking reader takes, and each tick replays."""
    whole, rng = torque.file_of("Impedance").read_bytes(), np.random.default_rng(0)
    run = taut.load_run(torque.file_of("Impedance"))
    rows, source, kept = run.arrays(), tmp_path / "log.mcap", list[int]()
    for cut in [*rng.integers(0, len(whole), max(share(50), 5)).tolist(), *[None] * share(100)]:
        raw = bytearray(whole[:cut])
        if cut is None:
            bit = int(rng.integers(0, 8 * len(whole)))
            raw[bit // 8] ^= 1 << (bit % 8)
        source.write_bytes(raw)
        for file in tmp_path.glob("log-*"):
            file.unlink()
        status = main(["repair", str(source)])
        files = list(tmp_path.glob("log-*"))
        assert bool(files) == (status == 0)
        parts = sorted(map(taut.load_run, files), key=lambda part: float(part.t[0]))
        ticks = np.concatenate([[], *(ticks_of(part) - ticks_of(run)[0] for part in parts)]).astype(int)
        assert (np.diff(ticks) > 0).all()
        for name, values in rows.items():
            together = [part.arrays()[name].reshape(len(part), -1) for part in parts]
            if parts:
                assert np.concatenate(together).tobytes() == values[ticks].tobytes(), name
        for file in files:
            require_standard(file)
        if cut is None:
            kept.append(len(ticks))
    worst = min(kept)
    assert worst > 0.85 * len(run)
    bar(
        "repair: logs with one bit flipped; ticks that are left, median and least",
        f"{len(kept)}; {np.median(kept) / len(run):.1%}, {worst / len(run):.1%}",
    )


@pytest.mark.parametrize("bit", [8 * 1 + 4, 8 * 2 + 1, 8 * 7 + 7])  # of the length: so that it swallows some, or all
def test_a_damaged_length_of_a_chunk_costs_that_chunk(torque: Recorded, bit: int, tmp_path: Path) -> None:
    raw = bytearray(torque.file_of("Impedance").read_bytes())
    starts = [found.start() - CHUNK_MARK_AT for found in re.finditer(re.escape(CHUNK_MARK), raw)]
    run = taut.load_run(torque.file_of("Impedance"))
    raw[starts[3] + 1 + bit // 8] ^= 1 << (bit % 8)
    (tmp_path / "log.mcap").write_bytes(raw)
    before, behind = intact_parts(tmp_path / "log.mcap")
    assert 0 < len(run) - len(before) - len(behind) <= 33  # a chunk of 64 KiB
    assert f"damaged at byte {starts[3]}" in before.outcome.message
    assert behind.q.tobytes() == run.q[-len(behind) :].tobytes()


def require_standard(file: Path) -> None:
    """The seeking reader finds its index, and every message by it."""
    with file.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert sum(1 for _ in reader.iter_messages()) == summary.statistics.message_count > 0


def test_what_is_repaired_replays(torque: Recorded, tmp_path: Path) -> None:
    raw = bytearray(torque.file_of("ComputedTorque").read_bytes())
    raw[raw.index(CHUNK_MARK, len(raw) // 2) + 100] ^= 1
    (tmp_path / "log.mcap").write_bytes(raw[: -len(raw) // 8])
    assert main(["repair", str(tmp_path / "log.mcap"), "--out", str(tmp_path / "whole.mcap")]) == 0
    for name in ("whole.mcap", "whole-2.mcap"):
        assert taut.analysis.replay(taut.load_run(tmp_path / name), torque.laws[0]).ok


def test_a_log_of_a_robot_is_read_as_that_of_a_run(torque: Recorded) -> None:
    """By the report, the doctor, and the reader of the format's own makers with a decoder of ROS 2."""
    file = torque.file_of("Impedance")
    run = taut.load_run(file)
    assert run.content().settings["law"].startswith("Impedance")
    assert any("stream_stopped" in fault for fault in run.content().faults)
    assert taut.doctor(run) is not None
    np.testing.assert_allclose(sum(run.terms.values()), run.command, atol=1e-9)
    with file.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()], validate_crcs=True)
        seen = [each[3] for each in reader.iter_decoded_messages(starting_at=round(1e9 * run.t[-50]))]
    assert len(seen) == 50
    np.testing.assert_array_equal([tick.extra_safe_fault for tick in seen], run.extra["safe.fault"][-50:])
    np.testing.assert_array_equal([tick.reference_p for tick in seen], run.reference.p[-50:])
    task = taut.load_run(torque.file_of("task"))
    assert [window.name for window in task.phases] == ["go", "stay"]
    changes = taut.load_run(torque.file_of("ComputedTorque")).info.events
    assert [sorted(change.set) for change in changes] == [*[["law.kp"]] * 3, ["model.payload.mass"]]
