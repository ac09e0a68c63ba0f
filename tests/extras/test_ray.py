"""Sweeps on a Ray cluster of several processes on this machine, whose workers and nodes are killed during the run."""

from __future__ import annotations

import contextlib
import importlib.util
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ray_plants import EndsWorkers

import taut
from taut.analysis.sweeps import chunks, cluster
from taut.analysis.sweeps import sweep as front
from taut.cli.main import main
from taut.errors import ClusterError, FileError

if importlib.util.find_spec("ray") is None:
    pytest.skip("make test-extras installs Ray", allow_module_level=True)

U = taut.uniform
PLANAR, ONE = taut.load_arm("planar2"), taut.load_arm("one_joint")
VARY = {"law.kp": U(50.0, 400.0), "plant.payload.mass": U(0.0, 2.0), "sensors.position.noise": U(1e-5, 1e-3)}
SAMPLES = 600


class Cluster:
    """A cluster in a process of its own."""

    def __init__(self, path: str) -> None:
        command = [sys.executable, str(Path(__file__).with_name("ray_cluster.py"))]
        environment = {**os.environ, "PYTHONPATH": path, "RAY_USAGE_STATS_ENABLED": "0"}
        self.process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            env=environment,
        )
        self.address = self.answer()

    def answer(self) -> str:
        assert self.process.stdout is not None
        return self.process.stdout.readline().split()[1]

    def do(self, word: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(f"{word}\n")
        self.process.stdin.flush()
        self.answer()

    def close(self) -> None:
        with self.process:  # which closes its input
            pass
        assert self.process.returncode == 0

    def at_work(self) -> list[int]:
        """Processes below this cluster that run a chunk."""
        parents, names = {}, {}
        for folder in Path("/proc").iterdir():
            with contextlib.suppress(OSError, ValueError):
                pid = int(folder.name)
                parents[pid] = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
                names[pid] = (folder / "cmdline").read_bytes().split(b"\0")[0]

        def below(pid: int) -> bool:
            return pid == self.process.pid or (pid in parents and below(parents[pid]))

        return [pid for pid, name in names.items() if name.startswith(b"ray::work") and below(pid)]


PATH = os.pathsep.join([str(Path(__file__).parent), *filter(None, sys.path)])


@pytest.fixture(scope="module", autouse=True)
def token(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Clusters and their users have one token."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAY_AUTH_MODE", "token")
        patch.setenv("RAY_AUTH_TOKEN", uuid.uuid4().hex)
        yield


@contextlib.contextmanager
def running(path: str = PATH) -> Iterator[Cluster]:
    made = Cluster(path)
    try:
        yield made
    finally:
        made.close()


@pytest.fixture(scope="module")
def here(token: None) -> Iterator[Cluster]:
    with running() as made:
        yield made


@pytest.fixture(autouse=True)
def small_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(chunks, "IN_LANES", (24, 24))
    monkeypatch.setattr(chunks, "ONE_BY_ONE", (2, 2))


def loop(duration: float = 4.0) -> taut.Loop:
    sensors = taut.sensors.Sensors(position=taut.sensors.Encoder(resolution=1e-4, noise=1e-4))
    ctrl = taut.compile(taut.laws.ComputedTorque(kp=100.0, kd=20.0), PLANAR)
    ref = taut.trajectories.Sine(center=PLANAR.home, amplitude=0.3, frequency=1.0)
    return taut.Loop(ctrl, taut.RigidPlant(PLANAR, sensors=sensors), ref, duration=duration)


@pytest.fixture(scope="module")
def local() -> Any:
    found = taut.sweep(loop(), VARY, samples=SAMPLES, seed=3).table
    assert "ray" not in sys.modules
    return found


def assert_equal(found: Any, expected: Any) -> None:
    assert list(found) == list(expected)
    for name in expected:
        assert found[name].tobytes() == expected[name].tobytes() or found[name].tolist() == expected[name].tolist()


def when(monkeypatch: pytest.MonkeyPatch, actions: dict[int, Callable[[], None]]) -> None:
    """Do something when so many samples are done."""
    advance = front.Progress.advance

    def watched(self: Any, steps: int) -> None:
        advance(self, steps)
        for count in [count for count in actions if self._what == "sweeping" and self._done >= count]:
            actions.pop(count)()

    monkeypatch.setattr(front.Progress, "advance", watched)


def interrupt() -> None:
    raise KeyboardInterrupt


def test_the_table_is_the_local_one_bit_for_bit_and_ray_stays_out_of_this_process(here: Cluster, local: Any) -> None:
    for address in (here.address, "auto"):
        assert_equal(taut.sweep(loop(), VARY, samples=SAMPLES, seed=3, ray=address).table, local)
    assert "ray" not in sys.modules


def test_workers_that_are_killed_lose_and_double_nothing(
    here: Cluster, local: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    killed: list[int] = []

    def kill() -> None:
        end = time.monotonic() + 20.0
        while not (found := here.at_work()) and time.monotonic() < end:
            pass
        os.kill(found[0], signal.SIGKILL)
        killed.append(found[0])

    when(monkeypatch, {1: kill, 100: kill, 200: kill, 400: kill})
    written: list[int] = []
    write = front.Memory.write
    monkeypatch.setattr(front.Memory, "write", lambda self, r: (written.extend(r.table["sample"]), write(self, r))[1])
    found = taut.sweep(loop(), VARY, samples=SAMPLES, seed=3, ray=here.address)
    assert len(set(killed)) == 4
    assert sorted(written) == list(range(SAMPLES))
    assert found.complete
    assert_equal(found.table, local)


def test_a_node_that_is_lost_loses_nothing(here: Cluster, local: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    here.do("node")
    when(monkeypatch, {100: lambda: here.do("kill")})
    assert_equal(taut.sweep(loop(), VARY, samples=SAMPLES, seed=3, ray=here.address).table, local)


def sliding(tmp_path: Path, q0: Any, address: str | None, **more: Any) -> front.Sweep:
    ctrl, plant = taut.compile(taut.laws.PID(kp=8.0, kd=8.0), ONE), EndsWorkers(ONE, str(tmp_path))
    given = {"duration": 0.02, "samples": len(q0), "metrics": ["final_error"], **more}
    return taut.sweep(ctrl, {"q0": q0}, plant, taut.JointMotion(q=[0.0]), q0=[0.5], ray=address, **given)


def test_a_sample_that_ends_two_workers_has_failed_and_says_so(here: Cluster, tmp_path: Path) -> None:
    q0 = 1e-3 * np.arange(10)
    q0[[3, 4, 7]] += [1.0, 2.0, 3.0]
    found = sliding(tmp_path, q0, here.address)
    assert found.complete
    assert found.table["sample"].tolist() == list(range(10))
    assert np.flatnonzero(~found.completed).tolist() == [3, 7]
    assert (found.table["outcome"][[3, 7]] == "failed").all()
    assert "WorkerCrashedError" in found.messages[3]
    assert "the plant fails" in found.messages[7]
    begun = [float(line) for line in (tmp_path / "begun").read_text().split()]
    assert begun.count(float(q0[3])) == 3  # in its chunk, and twice alone
    healthy = [0, 1, 2, 5, 6, 8, 9]
    alone = sliding(tmp_path, q0[healthy], None, workers=1)
    np.testing.assert_array_equal(found.table["final_error"][healthy], alone.table["final_error"])


def test_only_so_many_chunks_are_in_flight(here: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    begun: list[int] = []
    write = front.Store.write

    def slow(self: Any, results: Any) -> None:
        if not begun:
            time.sleep(3.0)
            begun.append(len((tmp_path / "begun").read_text().split()))
        write(self, results)

    monkeypatch.setattr(front.Store, "write", slow)
    more = {"record": ("q", "v", "tau"), "duration": 3.0, "workers": 3}  # 240 kB a chunk, four times a pipe
    found = sliding(tmp_path, 1e-3 * np.arange(60), here.address, out=tmp_path / "out", **more)
    assert found.completed.all()
    assert begun[0] <= 1 + 2 * (2 + 2 * 3)  # the loop's own; chunks that are here, on their way and in flight
    assert len((tmp_path / "begun").read_text().split()) == 61


def test_ctrl_c_keeps_what_is_done_ends_what_runs_and_the_sweep_goes_on_anywhere(
    here: Cluster, local: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    with monkeypatch.context() as patch:
        when(patch, {200: interrupt})
        part = taut.sweep(loop(), VARY, samples=SAMPLES, seed=3, ray=here.address, out=tmp_path / "a")
    assert not part.complete
    assert part.samples == 24 * len(list((tmp_path / "a").glob("chunk-*.parquet")))
    end = time.monotonic() + 20.0
    while here.at_work() and time.monotonic() < end:
        time.sleep(0.05)
    assert not here.at_work()
    with monkeypatch.context() as patch:
        when(patch, {400: interrupt})
        assert not taut.sweep(loop(), VARY, samples=SAMPLES, seed=3, out=tmp_path / "a").complete
    whole = taut.sweep(loop(), VARY, samples=SAMPLES, seed=3, ray=here.address, out=tmp_path / "a")
    assert whole.complete
    assert_equal(whole.table, local)
    with pytest.raises(FileError):
        taut.sweep(loop(), VARY, samples=SAMPLES, seed=4, ray=here.address, out=tmp_path / "a")


def test_a_loop_with_mujoco_is_the_same_on_the_cluster(here: Cluster) -> None:
    arm = PLANAR.with_friction(taut.Friction())
    sensors = taut.sensors.Sensors(position=taut.sensors.Encoder(noise=1e-4))
    ctrl = taut.compile(taut.laws.GravityPID(kp=50.0, kd=10.0), arm)
    vary = {"plant.payload.mass": U(0.0, 2.0), "law.kp": U(30.0, 60.0)}
    plant, ref = taut.MujocoPlant(arm, sensors=sensors), taut.JointMotion(q=[0.1, 0.2])
    there, one = (
        taut.sweep(ctrl, vary, plant, ref, duration=0.05, samples=9, **where)
        for where in ({"ray": here.address}, {"workers": 1})
    )
    assert there.completed.all()
    assert_equal(there.table, one.table)


def test_the_command_sweeps_on_a_cluster(here: Cluster, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["sweep", "one_joint_pid", "--law", "PD", "--set", "run.duration=0.1", "--samples", "1e2", "--json"]
    words += ["--vary", "law.kp=1:9"]
    answers = []
    for more in (["--ray", here.address], []):
        assert main([*words, *more]) == 0
        answers.append(json.loads(capsys.readouterr().out))
    assert answers[0] == answers[1]
    assert answers[0]["samples"] == 100


# -------------------------------------------------------------------- clusters that cannot


def test_a_cluster_that_is_lost_ends_the_sweep_and_leaves_its_files(
    local: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("RAY_gcs_rpc_server_reconnect_timeout_s", "5")  # a minute otherwise
    with running() as lost:
        when(monkeypatch, {100: lambda: lost.do("head")})
        began = time.monotonic()
        with pytest.raises(ClusterError, match="was lost"):
            taut.sweep(loop(), VARY, samples=SAMPLES, seed=3, ray=lost.address, out=tmp_path / "a")
        assert time.monotonic() - began < 120.0
    assert len(list((tmp_path / "a").glob("chunk-*.parquet"))) >= 4
    assert_equal(taut.sweep(loop(), VARY, samples=SAMPLES, seed=3, out=tmp_path / "a").table, local)


def test_a_cluster_whose_nodes_lack_taut_or_have_another_one_is_refused(tmp_path: Path) -> None:
    (tmp_path / "lacks" / "taut").mkdir(parents=True)
    (tmp_path / "lacks" / "taut" / "__init__.py").touch()
    source = Path(taut.__file__).parent
    shutil.copytree(source, tmp_path / "other" / "taut", ignore=shutil.ignore_patterns("__pycache__"))
    file = tmp_path / "other" / "taut" / "base" / "__init__.py"
    changed = file.read_text().replace("0.1.0", "0.0.9")
    assert changed != file.read_text()
    file.write_text(changed)
    for name, words in (("lacks", "No module named 'taut"), ("other", "taut 0.0.9 and not 0.1.0")):
        with running(str(tmp_path / name)) as wrong, pytest.raises(ClusterError, match=words):
            taut.sweep(loop(0.1), VARY, samples=50, ray=wrong.address)


def test_a_wrong_token_and_what_is_no_cluster_are_refused(here: Cluster, monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        port = silent.getsockname()[1]
        monkeypatch.setattr(cluster, "CONNECT", 5.0)
        with pytest.raises(ClusterError, match="did not answer for 5 s"):
            taut.sweep(loop(0.1), VARY, samples=50, ray=f"127.0.0.1:{port}")
    with pytest.raises(ClusterError, match="refused"):
        taut.sweep(loop(0.1), VARY, samples=50, ray=f"127.0.0.1:{port}")
    monkeypatch.setattr(cluster, "CONNECT", 40.0)
    monkeypatch.setenv("RAY_AUTH_TOKEN", uuid.uuid4().hex)
    with pytest.raises(ClusterError, match="token"):
        taut.sweep(loop(0.1), VARY, samples=50, ray=here.address)
