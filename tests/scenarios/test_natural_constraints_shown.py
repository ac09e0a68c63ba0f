"""A scenario with a hybrid law shows its natural constraints before it runs."""

from __future__ import annotations

from pathlib import Path

import taut
from taut.scenarios.run import _remark, run_scenario
from taut.scenarios.scenario import load_scenario

SCENARIO = """
title = "pressing"

[arm]
model = "planar2"

[laws.pressing]
law = "HybridMotionForce"
constraint = {{ kind = "plane", point = {point}, normal = [0.0, 0.0, 1.0] }}

[laws.pressing.motion]
law = "TaskComputedTorque"
kp = [100.0, 100.0]
kd = 20.0

[plant]
kind = "rigid"

[run]
duration = 0.01
"""


def test_the_table_stands_before_the_run(tmp_path: Path) -> None:
    arm = taut.load_arm("planar2")
    x = taut.snapshot(arm, arm.home)
    file = tmp_path / "pressing.toml"
    file.write_text(SCENARIO.format(point=x.T().p.tolist()))
    said: list[str] = []
    run_scenario(load_scenario(str(file)), tmp_path / "out", say=said.append)
    table = taut.analysis.natural_constraints(taut.Constraint.plane(point=x.T().p, normal=[0.0, 0.0, 1.0]), at=x)
    assert said[:2] == [f"law 'pressing': {table}", "running pressing ..."]


def test_a_table_that_nobody_could_read_is_left_out_and_that_of_each_phase_is_there() -> None:
    bar = load_scenario("two_arms_bar")
    law = bar.laws["hybrid"]
    assert _remark(taut.compile(law, bar.arm, engine="float"), bar).splitlines() == [
        "constrained: 8 free motions and 6 free forces",
        "its rows are sums of many joints: taut.analysis.natural_constraints prints them",
        "the pose is off the constraint: phi[5] = 0.0122",
    ]
    writes = load_scenario("panda_writes")
    said = _remark(taut.compile(writes.laws["task"], writes.arm, engine="float"), writes)
    heads = [line for line in said.splitlines() if line.startswith("phase")]
    assert [head.partition(":")[0] for head in heads] == ["phase 'contact'", "phase 'slide'", "phase 'stick'"]
    assert "3 free motions and 3 free forces" in heads[2]
