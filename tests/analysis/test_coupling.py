"""When independent joint controllers are enough: section 10.2.2.1."""

from __future__ import annotations

import numpy as np
import pytest
from refusals import refused

import taut

laws, Plant = taut.laws, taut.RigidPlant
OMEGA = 20.0  # [rad/s]


def coupling_of(arm: taut.Arm, mass: float = 0.0, **gains: object) -> taut.analysis.Coupling:
    ctrl = taut.compile(laws.PID(**gains), arm)  # type: ignore[arg-type]
    return taut.analysis.coupling(taut.Loop(ctrl, Plant(arm.with_payload(mass), friction=None), duration=1.0))


def same_design(arm: taut.Arm) -> dict[str, object]:
    """The PD of each joint alone: the same poles for its own inertia, the diagonal of M at home."""
    own = np.diag(taut.snapshot(arm, arm.home).M)
    return {"kp": OMEGA**2 * own, "kd": 2.0 * OMEGA * own}


@pytest.fixture(scope="module")
def pandas() -> dict[tuple[str, str, float], taut.analysis.Coupling]:
    """The same Panda direct-driven and with G = 100, with and without gravity, with and without a payload of 2 kg."""
    out = {}
    for gravity in ("weight", "no weight"):
        given = {} if gravity == "weight" else {"gravity": (0.0, 0.0, 0.0)}
        direct = taut.load_arm("panda", **given)
        for drive, arm in (("direct", direct), ("geared", direct.with_gears(ratio=100.0, motor_inertia=2e-4))):
            for mass in (0.0, 2.0):
                out[drive, gravity, mass] = coupling_of(arm, mass, **same_design(arm))
    return out


def test_a_gantry_has_no_coupling() -> None:
    found = coupling_of(taut.load_arm("gantry3"), kp=3000.0, kd=300.0, ki=500.0)
    assert np.abs(found.droop).max() < 1e-9
    found = coupling_of(taut.load_arm("gantry3"), kp=3000.0, kd=300.0)
    assert found.droop[list(found.joints).index("z")] == pytest.approx(-0.00981, rel=1e-3)
    assert found.worst[1] != found.worst[2]
    assert found.inertia < 1e-12
    assert found.worst[0] < 1e-11  # of a resonance, whose size it is relative to
    assert found.ok


@pytest.mark.long
def test_gears_decouple_and_a_payload_couples(pandas: dict[tuple[str, str, float], taut.analysis.Coupling]) -> None:
    for gravity in ("weight", "no weight"):
        for mass in (0.0, 2.0):
            direct, geared = pandas["direct", gravity, mass], pandas["geared", gravity, mass]
            assert geared.inertia < direct.inertia
            assert geared.worst[0] < direct.worst[0]
        for drive in ("direct", "geared"):
            assert pandas[drive, gravity, 2.0].inertia > pandas[drive, gravity, 0.0].inertia
    assert not pandas["direct", "weight", 0.0].ok
    assert pandas["geared", "weight", 2.0].ok


def test_weight_moves_the_joints_and_more_with_a_payload(
    pandas: dict[tuple[str, str, float], taut.analysis.Coupling],
) -> None:
    for drive in ("direct", "geared"):
        assert np.abs(pandas[drive, "no weight", 2.0].droop).max() < 1e-9
        sags = [np.abs(pandas[drive, "weight", mass].droop).max() for mass in (0.0, 2.0)]
        assert sags[1] > 1.2 * sags[0] > 0.01


def test_the_inertia_of_two_joints_is_their_correlation() -> None:
    arm = taut.load_arm("planar2", gravity=(0.0, 0.0, 0.0))
    M = taut.snapshot(arm, arm.home).M
    assert coupling_of(arm, kp=30.0, kd=10.0).inertia == pytest.approx(abs(M[0, 1]) / np.sqrt(M[0, 0] * M[1, 1]))


def test_its_table_has_the_crosstalk_of_each_joint(
    pandas: dict[tuple[str, str, float], taut.analysis.Coupling],
) -> None:
    found = pandas["direct", "weight", 2.0]
    content = found.json()
    assert content["faults"]
    crosstalk = {row["joint"]: row["crosstalk [%]"] for row in content["tables"][""]}
    assert crosstalk[found.worst[1]] == pytest.approx(100.0 * found.worst[0])


def test_a_joint_alone_is_coupled_to_nothing() -> None:
    found = coupling_of(taut.load_arm("one_joint"), kp=30.0, kd=10.0)
    assert found.ok
    assert found.worst[0] == 0.0


def test_joints_of_metres_and_of_radians_have_no_common_share() -> None:
    S = np.transpose([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0, 0.0, 0.0]])
    rail = taut.Arm.from_screws([np.eye(4)] * 3, [np.diag([0.1, 0.1, 0.1, 1.0, 1.0, 1.0])] * 2, S, np.zeros(3))
    with pytest.raises(taut.errors.UsageError) as caught:
        coupling_of(rail, kp=30.0, kd=10.0)
    assert caught.value.name == "loop"


def test_bad_input_is_refused() -> None:
    arm = taut.load_arm("planar2")
    with pytest.raises(taut.errors.UsageError):
        coupling_of(arm, kp=300.0, kd=9000.0)
    ctrl = taut.compile(laws.TaskComputedTorque(kp=100.0, kd=20.0), arm)
    with refused(taut.errors.UsageError):
        taut.analysis.coupling(taut.Loop(ctrl, Plant(arm, friction=None), duration=1.0), at=[0.3, 0.5])
