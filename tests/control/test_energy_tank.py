"""The energy tank: whatever the stiffness does, arm, springs and tank together never gain energy."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tank_ledger import excess

import taut

SLIDER = """<robot name="slider"><link name="base"/>
<link name="slide"><inertial><mass value="2"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="x" type="prismatic"><parent link="base"/><child link="slide"/><axis xyz="1 0 0"/>
<limit lower="-1000" upper="1000" effort="1e6" velocity="1e4"/></joint></robot>"""
T = 1e-3  # [s]


@pytest.mark.bars
def test_arm_springs_and_tank_never_gain_energy(
    share: Callable[[int], int], bar: Callable[[str, object], None]
) -> None:
    """Random schedules of K, starts and pushes, torques held over 1 ms, without any friction; gravity is not there."""
    count, worst = 0, 0.0
    for name in ("planar2", "ur10", "panda")[: 3 if share(10) == 10 else 2]:
        for seed in range(max(1, share(30) // 3)):
            total = excess(name, seed)
            worst = max(worst, float((total - np.minimum.accumulate(total)).max()))
            count += 1
    assert worst < 1e-8
    bar(
        "random K under the energy tank, planar2, ur10 and panda: rise of arm + springs + tank",
        f"{worst:.0e} J, {count}",
    )


@pytest.mark.part(1)
@pytest.mark.parametrize("tank", [True, False])
def test_a_spring_that_is_switched_with_the_motion_gains_energy_only_without_a_tank(
    tmp_path: Path, tank: bool
) -> None:
    """2 kg, 2 N s/m, 0.05 m, 1000 N/m while it returns and 200 while it departs."""
    (tmp_path / "slider.urdf").write_text(SLIDER)
    arm = taut.load_arm(tmp_path / "slider.urdf", tool="slide").with_gravity([0.0, 0.0, 0.0])
    along = taut.Coordinates(function=lambda T: taut.math.array([T.p[0]]))
    spring = taut.laws.Impedance(
        K=[200.0], B=[2.0], error="coordinates", coordinates=along, coriolis="keep", null=None
    )
    law = taut.laws.EnergyTank(law=spring, capacity=0.25, settle=T) if tank else spring
    ctrl = taut.compile(law, arm, rate=1.0 / T)
    K = [0.0]
    ref, x, v, total = taut.TaskMotion(pose=taut.Pose([0.0, 0.0, 0.0])), 0.05, 0.0, []
    for _ in range(1000):
        before, K = K, [1000.0 if x * v < 0.0 else 200.0]
        if before != K:
            ctrl.parameters["law.K"] = K
        tau = float(ctrl.step([x], [v], ref)[0])
        stiffness = float(ctrl.memory["law.now.K"][0] if tank else K[0])
        stored = 0.5 * 2.0 * v * v + 0.5 * stiffness * x * x
        total.append(stored + (float(ctrl.memory["law.energy"]) if tank else 0.0))
        x, v = x + T * v + 0.25 * T * T * tau, v + 0.5 * T * tau
    if tank:
        rise = np.array(total) - np.minimum.accumulate(total)
        assert rise.max() < 1e-8  # of the hold where the slider turns, and has no speed that is damped
    else:
        assert total[0] == pytest.approx(0.25)
        assert total[-1] > 200.0
