"""Logs in the readers of other programs: Rerun's own importer, and the reader of bags by rosbags.

`make test-extras` installs them; where they are not there, these tests are skipped. The library of the makers of MCAP
and of Foxglove reads logs in test_log.py.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import taut
from taut.cli.main import main

RERUN = Path(sys.executable).with_name("rerun")


@pytest.fixture(scope="module")
def run() -> taut.Run:
    arm = taut.load_arm("planar3")
    ctrl = taut.compile(taut.laws.ComputedTorque(kp=100.0, kd=20.0), arm)
    return taut.run(ctrl, taut.RigidPlant(arm), taut.JointMotion(q=[0.3, 0.2, 0.1]), duration=1.0)


@pytest.fixture(params=["saved", "repaired"])
def log(run: taut.Run, tmp_path: Path, request: pytest.FixtureRequest) -> Path:
    whole = run.save(tmp_path / "log.mcap")
    if request.param == "saved":
        return whole
    whole.write_bytes(whole.read_bytes()[: -whole.stat().st_size // 3])
    assert main(["repair", str(whole)]) == 0
    return tmp_path / "log-repaired.mcap"


@pytest.mark.skipif(not RERUN.exists(), reason="rerun-sdk is not installed")
def test_rerun_imports_every_tick(log: Path, tmp_path: Path) -> None:
    ticks = len(taut.load_run(log))

    def rerun(*words: str | Path) -> str:
        home = {**os.environ, "HOME": str(tmp_path)}
        done = subprocess.run([RERUN, *words], capture_output=True, text=True, env=home, timeout=120)
        assert done.returncode == 0, done.stderr
        return done.stdout

    rerun("analytics", "disable")
    assert re.search(rf"\bok\b.*{re.escape('/run')}", rerun("mcap", "check", log))
    rerun("mcap", "convert", log, "-o", tmp_path / "log.rrd")
    rows = re.findall(
        r"with (\d+) rows .* - /run - data columns: \[taut.msg.Tick:", rerun("rrd", "print", tmp_path / "log.rrd")
    )
    assert sum(map(int, rows)) == ticks > 500


def test_rosbags_decodes_every_number(log: Path) -> None:
    bags: Any = pytest.importorskip("rosbags.highlevel")
    again = taut.load_run(log)
    with bags.AnyReader([log]) as reader:
        ticks = [reader.deserialize(raw, connection.msgtype) for connection, _, raw in reader.messages()]
    for name, values in (("q", again.q), ("tau", again.tau), ("terms_p", again.terms["P"])):
        table = [[getattr(getattr(tick, name), joint) for joint in again.joint_names] for tick in ticks]
        np.testing.assert_array_equal(table, values, err_msg=name)
    np.testing.assert_array_equal([tick.t for tick in ticks], again.t)
