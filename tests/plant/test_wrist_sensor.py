"""A wrist sensor that weighs: what hangs beyond it shows in its reading, as MuJoCo and Newton say."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import pytest
from plant_laws import Array, run
from test_sensor_kinds import F_PUSH, Push, read

import taut
from taut.plant.sensors import Sensors

ARM = taut.load_arm("planar3")
TOOL = taut.Payload(mass=0.7, com=(0.01, -0.02, 0.06), inertia=(2e-3, 3e-3, 2e-3, 1e-4, 2e-4, -3e-4))
HELD = {"mass": 1.3, "com": (0.03, 0.02, 0.1), "inertia": (4e-3, 5e-3, 6e-3, 2e-4, -1e-4, 3e-4)}
HOLD = taut.JointMotion(q=[0.0, 0.0, 0.0])
NO_PAYLOAD = {"payload.mass": 0.0, "payload.com": np.zeros(3), "payload.inertia": np.zeros(6)}


class Feels(taut.Law):
    """Holds its weight, brakes, and asks for the wrench so that a run records it."""

    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Torque:
        return taut.Torque(gravity=x.g, D=-0.3 * x.v, wanted=ref.a, none=0.0 * x.F_ext[0] + 0.0 * x.q)


def with_flange(arm: taut.Arm, T_FE: taut.Pose) -> taut.Arm:
    """The arm with another tool, so that its old one is a frame of the same body elsewhere."""
    return arm.with_tool(arm.tool, T_FE, name="tip")


T_TIP = taut.Pose(p=[0.02, -0.03, 0.11], rpy=[0.3, -0.7, 1.1])


def mujoco_wrench(arm: taut.Arm, q: Array, v: Array, a: Array) -> Array:
    """(6,) what MuJoCo's sensors at the tool say tool and payload put on the arm, in the tool's axes.

    A force site gives parent on child: the arm on what it carries. Here that is the payload alone.
    """
    plant = taut.MujocoPlant(arm)
    model, data = plant.model, plant.data
    plant.reset(q, v, 1e-3)
    mujoco.mj_forward(model, data)
    data.qacc[[int(model.jnt_dofadr[model.joint(joint).id]) for joint in arm.joint_names]] = a
    mujoco.mj_rnePostConstraint(model, data)
    mujoco.mj_sensorAcc(model, data)
    return -data.sensordata[:6]


@pytest.mark.parametrize("name", ["planar3", "panda", "ur5", "kinova", "xarm7"])
def test_the_load_is_what_mujocos_force_and_torque_sensors_read(name: str) -> None:
    arm = taut.load_arm(name)
    rng, sensor = np.random.default_rng(3), taut.sensors.WrenchSensor(tool=taut.Payload())
    loaded, payload = arm.with_payload(**HELD), {f"payload.{word}": np.array(value) for word, value in HELD.items()}
    for _ in range(3):
        q, v, a = arm.home + rng.standard_normal(arm.n), rng.standard_normal(arm.n), rng.standard_normal(arm.n)
        seen = read(Sensors(wrench=sensor), {"q": q, "v": v, "a": a, **payload}, arm)["F_ext"]
        R = taut.snapshot(arm, q).T().R
        wanted = mujoco_wrench(loaded, q, v, a)
        in_tool = np.concatenate([R.T @ seen[:3], R.T @ seen[3:]])
        np.testing.assert_allclose(in_tool, wanted, rtol=0.0, atol=1e-9 * np.abs(wanted).max())
        # The same body as the sensor's own tool is the same load.
        own = taut.sensors.WrenchSensor(tool=taut.Payload(**HELD))
        true = {"q": q, "v": v, "a": a, **NO_PAYLOAD}
        np.testing.assert_allclose(read(Sensors(wrench=own), true, arm)["F_ext"], seen, rtol=0.0, atol=1e-12)


def test_at_another_frame_of_the_tools_body_it_reads_what_stands_beyond_that_frame() -> None:
    arm = with_flange(taut.load_arm("panda"), T_TIP)
    flange = taut.load_arm("panda").tool
    rng = np.random.default_rng(4)
    q, v, a = arm.home + 0.3 * rng.standard_normal(7), rng.standard_normal(7), rng.standard_normal(7)
    payload = {f"payload.{word}": np.array(value) for word, value in HELD.items()}
    true = {"q": q, "v": v, "a": a, "F_ext": F_PUSH, **payload}
    at_flange, at_tip = (
        read(Sensors(wrench=taut.sensors.WrenchSensor(tool=tool, frame=frame)), true, arm)["F_ext"]
        for tool, frame in ((TOOL, flange), (taut.Payload(), None))
    )
    # The tool in the tip's frame, by hand: what the two read differs by its load alone.
    R, p = T_TIP.R, T_TIP.p
    I = np.array([[2e-3, 1e-4, 2e-4], [1e-4, 3e-3, -3e-4], [2e-4, -3e-4, 2e-3]])
    moved = taut.Payload(mass=TOOL.mass, com=R.T @ (TOOL.com - p), inertia=R.T @ I @ R)
    both = read(Sensors(wrench=taut.sensors.WrenchSensor(tool=moved)), true, arm)["F_ext"]
    np.testing.assert_allclose(at_flange, both, rtol=0.0, atol=1e-12)
    assert np.abs(at_flange - at_tip).max() > 1.0


def test_bias_noise_and_range_are_those_of_its_own_axes_and_origin() -> None:
    arm = with_flange(taut.load_arm("panda"), T_TIP)
    flange = taut.load_arm("panda").tool
    true = {"q": arm.home, "v": np.zeros(7), "F_ext": F_PUSH}
    x = taut.snapshot(arm, arm.home)
    T_WE, T_WS = x.T(), x.T(flange)
    bias, limit = np.array([1.0, 2.0, 3.0, 0.1, 0.2, 0.3]), np.array([9.0, 3.0, 90.0, 0.4, 90.0, 0.2])
    seen = read(Sensors(wrench=taut.sensors.WrenchSensor(bias=bias, range=limit, frame=flange)), true, arm)
    f, r = F_PUSH[:3], T_WE.p - T_WS.p  # by hand: turned, and moved to the flange's origin
    in_sensor = np.concatenate([T_WS.R.T @ f, T_WS.R.T @ (F_PUSH[3:] + np.cross(r, f))])
    cut = np.clip(in_sensor + bias, -limit, limit)
    assert np.abs(cut - in_sensor - bias).max() > 0.1
    back = T_WS.R @ cut[:3]
    np.testing.assert_allclose(seen["F_ext"], [*back, *(T_WS.R @ cut[3:] - np.cross(r, back))], rtol=0.0, atol=1e-13)
    assert seen["saturated.F_ext"] == 1.0


def test_a_wrong_encoder_turns_the_reading_wrongly() -> None:
    """So that a controller cannot take a weight out better than it knows its pose."""
    sensors = Sensors(position=taut.sensors.Encoder(offset=0.1), wrench=taut.sensors.WrenchSensor(tool=TOOL))
    true = {"q": np.array([0.3, 0.4, 0.5]), "v": np.zeros(3), "a": np.zeros(3), **NO_PAYLOAD}
    right, wrong = (
        read(s, true, ARM)["F_ext"][:3] for s in (Sensors(wrench=taut.sensors.WrenchSensor(tool=TOOL)), sensors)
    )
    np.testing.assert_allclose(right, TOOL.mass * ARM.gravity, rtol=0.0, atol=1e-14)
    R = [taut.snapshot(ARM, true["q"] + off).T().R for off in (0.0, 0.1)]
    np.testing.assert_allclose(wrong, R[1] @ R[0].T @ right, rtol=0.0, atol=1e-14)
    assert np.abs(wrong - right).max() > 0.5


# -------------------------------------------------------------------- in runs


def plants(arm: taut.Arm, sensors: taut.sensors.Sensors) -> dict[str, Any]:
    return {"rigid": taut.RigidPlant(arm, sensors=sensors), "mujoco": taut.MujocoPlant(arm, sensors=sensors)}


def test_a_swinging_arm_reads_the_same_in_both_plants() -> None:
    arm = ARM.with_payload(**HELD)
    sensors = Sensors(wrench=taut.sensors.WrenchSensor(tool=TOOL, bias=(1.0, 0.1)))
    runs = [
        run(plant, HOLD, law=Feels(), v0=[1.0, -2.0, 1.5], duration=0.3) for plant in plants(arm, sensors).values()
    ]
    seen = [out.extra["sensed.F_ext"] for out in runs]
    still = (HELD["mass"] + TOOL.mass) * np.linalg.norm(arm.gravity)  # type: ignore[operator]
    assert np.abs(np.linalg.norm(seen[0][:, :3], axis=1) - still).max() > 1.0  # it swings
    np.testing.assert_allclose(seen[1], seen[0], rtol=0.0, atol=1e-6)


@pytest.mark.parametrize("kind", ["rigid", "mujoco"])
def test_what_hangs_there_is_a_number_that_changes_in_a_run(kind: str) -> None:
    plant = plants(ARM.with_payload(0.5), Sensors(wrench=taut.sensors.WrenchSensor(tool=TOOL)))[kind]
    names = sorted(path for path in plant.parameters if path.startswith("sensors."))
    assert names == ["sensors.wrench.tool.com", "sensors.wrench.tool.inertia", "sensors.wrench.tool.mass"]
    events = [
        taut.Event(t=0.1, set={"plant.payload.mass": 0.0, "model.payload.mass": 0.0}),
        taut.Event(t=0.2, set={"sensors.wrench.tool.mass": 0.2}),
    ]
    out = run(plant, HOLD, law=Feels(), duration=0.3, events=events)
    f = out.extra["sensed.F_ext"][:, :3]
    for k, mass in ((50, 1.2), (150, 0.7), (250, 0.2)):
        np.testing.assert_allclose(f[k], mass * ARM.gravity, rtol=0.0, atol=1e-3)


def test_stiff_drives_have_a_wrist_that_weighs_too() -> None:
    ur5 = taut.load_arm("ur5")
    plant = taut.RigidPlant(
        ur5.with_payload(2.0),
        takes="position",
        actuation=taut.drives.Actuation(bandwidth=30.0),
        sensors=Sensors(wrench=taut.sensors.WrenchSensor(tool=TOOL)),
    )
    assert "F_ext" in plant.measures
    numbers = plant.parameters
    memory = plant.start(ur5.home, np.zeros(6), numbers, 1e-3)
    memory = plant.command(ur5.home + 0.05, memory, 0.0)
    after = plant.advance(memory, numbers, 1e-3)
    np.testing.assert_allclose(plant.measure(memory, {}, numbers)["F_ext"][:3], 2.7 * ur5.gravity, atol=1e-12)
    assert np.abs(plant.measure(after, {}, numbers)["F_ext"][:3] - 2.7 * ur5.gravity).max() > 1.0


def test_without_a_tool_a_payload_does_not_show() -> None:
    plant = taut.RigidPlant(ARM.with_payload(**HELD), environment=Push(F=(0.0,) * 6))
    assert not run(plant, HOLD, law=Feels(), duration=0.01).extra["F_ext"].any()
    assert "F_ext" not in taut.RigidPlant(ARM).measures
    assert "F_ext" in taut.RigidPlant(ARM, sensors=Sensors(wrench=taut.sensors.WrenchSensor(tool=TOOL))).measures


CASES: list[tuple[Callable[[], object], type[taut.TautError], str]] = [
    (lambda: taut.sensors.WrenchSensor(tool=0.7), taut.errors.UsageError, "tool"),  # type: ignore[arg-type]
    (lambda: taut.RigidPlant(ARM, sensors=Sensors(wrench=taut.sensors.WrenchSensor(tool=TOOL, frame="link9"))), taut.errors.UnknownNameError, "link9"),
    (lambda: taut.MujocoPlant(ARM, sensors=Sensors(wrench=taut.sensors.WrenchSensor(frame="link1"))), taut.errors.UsageError, "frame"),
    (lambda: taut.RigidPlant(ARM, sensors=Sensors(wrench=taut.sensors.WrenchSensor(tool=TOOL))).checked_parameter("sensors.wrench.tool.mass", -1.0), taut.errors.RangeError, "sensors.wrench.tool.mass"),
    (lambda: taut.RigidPlant(ARM, sensors=Sensors(wrench=taut.sensors.WrenchSensor(tool=TOOL))).checked_parameter("sensors.wrench.tool.com", [0.0, 1.0]), taut.errors.ShapeError, "sensors.wrench.tool.com"),
]  # fmt: skip


@pytest.mark.parametrize(("make", "kind", "name"), CASES, ids=range(len(CASES)))
def test_what_cannot_be_is_refused_by_name(make: Callable[[], object], kind: type[taut.TautError], name: str) -> None:
    with pytest.raises(kind) as caught:
        make()
    assert caught.value.name == name
