"""Parameters of a loop: one namespace of paths, each checked like the first value."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from refusals import refused
from runtime_laws import Spring

import taut
from taut.runtime.events import Schedule
from taut.runtime.ongoing import FusedRun

ARM = taut.load_arm("planar2").with_joints(coulomb=[0.2, 0.1])
GOAL = taut.JointMotion(q=[0.4, 0.7])


def loop_of(law: taut.Law | None = None, **plant: Any) -> taut.Loop:
    law = law or taut.laws.PID(kp=[200.0, 100.0], kd=20.0, ki=np.eye(2))
    ctrl = taut.compile(law, ARM, limits=taut.Limits(tau=100.0), engine="float")
    return taut.Loop(ctrl, taut.RigidPlant(ARM, **plant), GOAL, duration=0.02)


FULL: dict[str, Any] = {
    "actuation": taut.drives.Actuation(bandwidth=300.0),
    "sensors": taut.sensors.Sensors(position=taut.sensors.Encoder(noise=[1e-3, 1e-3], resolution=1e-4)),
    "environment": Spring(),
}


def test_every_stage_has_its_paths() -> None:
    assert list(loop_of(**FULL).parameters) == [
        "law.kp", "law.kd", "law.ki", "limits.tau", "model.payload.mass", "model.payload.com", "model.payload.inertia",
        "plant.payload.mass", "plant.payload.com", "plant.payload.inertia", "plant.friction.viscous",
        "plant.friction.coulomb", "actuation.bandwidth", "sensors.position.resolution", "sensors.position.noise", "environment.k",
        "environment.b",
    ]  # fmt: skip


def test_they_start_with_what_the_controller_and_the_plant_have() -> None:
    ctrl = taut.compile(taut.laws.PID(kp=1.0), ARM, engine="float")
    ctrl.parameters["law.kp"] = 7.0
    loop = taut.Loop(ctrl, taut.RigidPlant(ARM.with_payload(2.0)), duration=1.0)
    assert loop.parameters["law.kp"] == 7.0
    assert loop.parameters["plant.payload.mass"] == 2.0
    assert loop.parameters["model.payload.mass"] == 0.0
    np.testing.assert_array_equal(loop.parameters["plant.friction.coulomb"], [0.2, 0.1])


def test_each_of_them_changes_the_run() -> None:
    """A path that is accepted and goes nowhere would be the worst of all."""
    new: dict[str, Any] = {
        "law.kp": 50.0, "law.kd": 1.0, "law.ki": np.eye(2) * 500.0, "limits.tau": 5.0, "plant.payload.mass": 2.0,
        "plant.payload.com": [0.1, 0.0, 0.0], "plant.payload.inertia": [0.3, 0.3, 0.3, 0.0, 0.0, 0.0],
        "plant.friction.viscous": 9.0, "plant.friction.coulomb": [9.0, 9.0], "actuation.bandwidth": 20.0,
        "sensors.position.noise": 0.1, "sensors.position.resolution": 0.1, "environment.k": 3e4, "environment.b": 300.0,
    }  # fmt: skip
    plain = taut.run(loop_of(**FULL)).q
    for path, value in new.items():
        loop = loop_of(**FULL)
        loop.parameters["plant.payload.mass"] = 1.0
        if "model" not in path:
            loop.parameters[path] = value
        assert np.abs(taut.run(loop).q[-1] - plain[-1]).max() > 1e-9, path
    loop = loop_of(taut.laws.GravityPID(kp=1.0, kd=1.0))
    before = taut.run(loop).tau[0]
    loop.parameters["model.payload.mass"] = 3.0
    assert np.abs(taut.run(loop).tau[0] - before).min() > 1.0


def test_a_scalar_serves_where_one_per_joint_or_a_matrix_stands() -> None:
    loop = loop_of()
    loop.parameters["law.kp"] = 3.0
    loop.parameters["law.ki"] = [1.0, 2.0]
    loop.parameters["plant.friction.viscous"] = 0.5
    np.testing.assert_array_equal(loop.parameters["law.kp"], [3.0, 3.0])
    np.testing.assert_array_equal(loop.parameters["law.ki"], np.diag([1.0, 2.0]))
    np.testing.assert_array_equal(loop.parameters["plant.friction.viscous"], [0.5, 0.5])


def test_there_is_no_way_round_the_checks() -> None:
    loop = loop_of()
    for write in (
        lambda: loop.parameters.update({"law.kp": -1.0}),
        lambda: loop.parameters["law.kp"].__setitem__(0, -1.0),
        lambda: loop.parameters["plant.payload.mass"].__setitem__((), np.nan),
        lambda: loop.parameters.setdefault("law.kpp", 1.0),
        lambda: loop.parameters.pop("law.kp"),
        lambda: loop.parameters.clear(),
    ):  # fmt: skip
        with pytest.raises((ValueError, LookupError, TypeError)):
            write()
    np.testing.assert_array_equal(loop.parameters["law.kp"], [200.0, 100.0])


def test_a_number_that_is_kept_is_a_copy() -> None:
    loop, kp = loop_of(), np.array([1.0, 2.0])
    loop.parameters["law.kp"] = kp
    kp[0] = np.nan
    assert loop.parameters["law.kp"][0] == 1.0


CASES: list[tuple[str, Any, type[taut.TautError]]] = [
    ("law.kpp", 1.0, taut.errors.UnknownNameError),
    ("plant.payload.maas", 1.0, taut.errors.UnknownNameError),
    ("law.kp", [1.0, -1.0], taut.errors.RangeError),
    ("law.kp", np.nan, taut.errors.RangeError),
    ("law.kd", [1.0, 2.0], taut.errors.ShapeError),
    ("law.ki", [[1.0, 0.5], [0.0, 1.0]], taut.errors.RangeError),
    ("limits.tau", 0.0, taut.errors.RangeError),
    ("plant.payload.mass", -1.0, taut.errors.RangeError),
    ("plant.payload.mass", [1.0, 2.0], taut.errors.ShapeError),
    ("plant.payload.com", [0.1, 0.2], taut.errors.ShapeError),
    ("plant.payload.inertia", 1.0, taut.errors.ShapeError),
    ("plant.payload.inertia", [1.0, 0.1, 0.1, 0.0, 0.0, 0.0], taut.errors.RangeError),
    ("model.payload.inertia", [-1.0, -1.0, -1.0, 0.0, 0.0, 0.0], taut.errors.RangeError),
    ("plant.friction.viscous", [0.1, -0.2], taut.errors.RangeError),
    ("plant.friction.coulomb", [1.0, 2.0, np.nan], taut.errors.RangeError),
    ("plant.friction.coulomb", [1.0, 2.0, 3.0], taut.errors.ShapeError),
    ("actuation.bandwidth", 0.0, taut.errors.RangeError),
    ("sensors.position.resolution", -1e-3, taut.errors.RangeError),
    ("sensors.position.resolution", 0.0, taut.errors.RangeError),
    ("sensors.position.noise", [0.0, -1.0], taut.errors.RangeError),
    ("sensors.position.resolution", [0.1, 0.1], taut.errors.ShapeError),
    ("environment.k", np.inf, taut.errors.RangeError),
    ("environment.k", "stiff", taut.errors.ShapeError),
]  # fmt: skip


@pytest.mark.parametrize(("path", "value", "kind"), CASES, ids=range(len(CASES)))
def test_a_wrong_value_is_refused_in_words_and_nothing_changes(
    path: str, value: Any, kind: type[taut.TautError]
) -> None:
    loop = loop_of(**FULL)
    before = {name: number.tolist() for name, number in loop.parameters.items()}
    with refused(kind):
        loop.parameters[path] = value
    assert {name: number.tolist() for name, number in loop.parameters.items()} == before


def test_an_environment_may_have_negative_numbers() -> None:
    loop = loop_of(**FULL)
    loop.parameters["environment.b"] = -1.0
    assert loop.parameters["environment.b"] == -1.0


def test_a_path_can_be_asked_for_without_knowing_whether_it_is_there() -> None:
    loop = loop_of()
    ctrl = taut.compile(taut.laws.PID(kp=1.0), taut.load_arm("planar2"))
    for parameters in (loop.parameters, ctrl.parameters):
        assert "law.kp" in parameters
        assert "law.kpp" not in parameters
        assert parameters.get("law.kpp") is None
        assert parameters.get("law.kpp", 3.0) == 3.0
        assert parameters.get("law.kp") is not None


def test_values_that_do_not_go_together_are_refused_and_nothing_changes() -> None:
    arm = taut.load_arm("planar2").with_friction(taut.Friction(coulomb=0.3, static=0.5))
    loop = taut.Loop(taut.compile(taut.laws.PID(kp=1.0), arm), taut.RigidPlant(arm), duration=0.1)
    with refused(taut.errors.RangeError):
        loop.parameters["plant.friction.coulomb"] = 0.6
    loop.parameters["plant.friction.static"] = 0.8
    loop.parameters["plant.friction.coulomb"] = 0.6
    together = taut.Event(t=0.05, set={"plant.friction.coulomb": 1.6, "plant.friction.static": 1.8})
    assert taut.run(loop, events=[together]).outcome.ok
    with refused(taut.errors.RangeError):
        taut.run(loop, events=[taut.Event(t=0.05, set={"plant.friction.coulomb": 1.6})])


def test_a_spring_that_a_parameter_makes_too_stiff_for_the_steps_is_refused_when_the_run_begins() -> None:
    arm = taut.load_arm("planar2").with_gears(ratio=10.0, motor_inertia=1e-3)
    soft = taut.drives.Actuation(transmission=taut.drives.Transmission(stiffness=200.0))
    loop = taut.Loop(
        taut.compile(taut.laws.PID(kp=1.0), arm), taut.RigidPlant(arm, actuation=soft, substeps=3), duration=0.1
    )
    assert taut.run(loop).outcome.ok
    loop.parameters["actuation.transmission.stiffness"] = 1e6
    with refused(taut.errors.RangeError):
        taut.run(loop)


def test_a_parameter_cannot_be_removed() -> None:
    with refused(taut.errors.UsageError):
        del loop_of().parameters["law.kp"]


def test_a_loop_can_be_run_again_and_runs_the_same() -> None:
    loop = loop_of(**FULL)
    first = taut.run(loop, events=[taut.Event(t=0.01, set={"law.kp": 1.0})])
    assert loop.parameters["law.kp"][0] == 200.0  # what an event sets lasts as long as the run
    again = taut.run(loop, events=[taut.Event(t=0.01, set={"law.kp": 1.0})])
    np.testing.assert_array_equal(first.q, again.q)
    loop.parameters["law.kp"] = 1.0
    assert np.abs(taut.run(loop).q - first.q).max() > 1e-6
    np.testing.assert_array_equal(first.info.parameters["law.kp"], [200.0, 100.0])


EVERYTHING: dict[str, Any] = {
    "actuation": taut.drives.Actuation(
        bandwidth=500.0,
        delay=0.002,
        resolution=0.01,
        motor=taut.drives.ElectricMotor(torque_constant=0.1, resistance=1.0, inductance=1e-3, voltage=24.0, current=9.0),
        ripple=taut.drives.Ripple(amplitude=0.02, periods=4),
        transmission=taut.drives.Transmission(efficiency=0.9, stiffness=[np.inf, 500.0], damping=[0.0, 0.5], backlash=[0.0, 0.01]),
        torque_loop=taut.drives.TorqueLoop(kp=0.2, ki=5.0),
    ),
    "sensors": taut.sensors.Sensors(
        position=taut.sensors.Encoder(resolution=1e-3, noise=1e-4, offset=1e-3, side="motor"),
        velocity=None,
        torque=taut.sensors.TorqueSensor(bias=0.01, noise=0.01),
        tip=taut.sensors.Accelerometer(bias=0.1),
    ),
}  # fmt: skip


@pytest.mark.filterwarnings("ignore::taut.StabilityWarning")  # friction is left out of the verdict
def test_no_parameter_of_any_stage_needs_a_compile_and_each_has_an_effect(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every number of law, sensing, limits, actuation, friction and sensors, changed one by one."""
    arm = taut.load_arm("planar2").with_gravity([0.0, -2.0, 0.0]).with_gears(ratio=[10.0, 20.0], motor_inertia=1e-3)
    friction = taut.Friction(
        viscous=0.2, coulomb=0.2, static=0.4, stribeck=0.1, stribeck_shape=1.5, load_motor=0.05, load_external=0.04,
        load_motor_static=0.08, load_external_static=0.06,
    )  # fmt: skip
    arm = arm.with_friction(friction)
    law = taut.laws.PID(
        kp=[60.0, 30.0],
        kd=[3.0, 1.5],
        ki=20.0,
        integral=taut.laws.Integral(anti_windup="back-calculation", tracking=4.0),
    )
    ctrl = taut.compile(
        law + taut.laws.Dither(amplitude=0.02, frequency=40.0),
        arm,
        rate=500.0,
        sensing=taut.Sensing(
            velocity=taut.sensors.Difference(cutoff=60.0), notch=taut.sensors.Notch(frequency=80.0, width=20.0)
        ),
        limits=taut.Limits(tau=[8.0, 4.0], tau_dot=400.0, v=1.5, blend=0.02),
    )
    swing = taut.trajectories.Sine(center=arm.home, amplitude=0.5, frequency=1.3)
    loop = taut.Loop(ctrl, taut.RigidPlant(arm, substeps=4, **EVERYTHING), swing, duration=0.3)
    plain = taut.run(loop)
    assert plain.outcome.ok, plain.outcome

    def never(*_: Any, **__: Any) -> None:
        raise AssertionError("it traces or compiles")

    def moved() -> np.ndarray:
        """(ticks, n) positions of a run, without the judgement of its start."""
        run = FusedRun(
            loop, arm.home, np.zeros(2), 0, Schedule(loop.side, loop.plant, loop.parameters, (), loop.ticks)
        )
        run.go(lambda _: None, None)
        return run.tape.outputs["q"]

    for place in ("taut.codegen.native.compiled", "taut.codegen.loop.compiled", "taut.codegen.loop.trace"):
        monkeypatch.setattr(place, never)
    idle = set()
    for path, value in list(loop.parameters.items()):
        before = value.copy()
        if path.endswith("efficiency"):
            changed = 0.8 * value
        elif path.endswith("periods"):
            changed = value + 1.0
        elif path.endswith(("inertia", "com")) and "payload" in path:
            changed = value + np.array(
                [0.3, 0.0, 0.0, 0.0, 0.0, 0.0] if path.endswith("inertia") else [0.1, 0.0, 0.0]
            )
            if path.endswith("inertia"):
                changed = value + np.array([0.3, 0.3, 0.3, 0.0, 0.0, 0.0])
        elif path in ("plant.friction.coulomb", "plant.friction.load_motor", "plant.friction.load_external"):
            changed = 0.5 * value
        else:
            changed = 1.3 * value + (0.0 if value.any() else 0.5)
        loop.parameters[path] = changed
        if np.array_equal(moved(), plain.q):
            idle.add(path)
        loop.parameters[path] = before
    assert idle <= {
        # Of a payload without mass the place does not matter; PID knows no model.
        "plant.payload.com", "model.payload.com", "model.payload.mass", "model.payload.inertia",
        # Sensors that this law does not read; the resolution of one that the inner loop reads.
        "sensors.torque.noise", "sensors.tip.bias",
        # Never reached here.
        "actuation.motor.current", "actuation.motor.voltage",
    }  # fmt: skip
    np.testing.assert_array_equal(moved(), plain.q)
