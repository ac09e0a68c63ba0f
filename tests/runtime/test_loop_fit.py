"""A controller and a plant that do not fit are refused when they meet, in one sentence."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from runtime_laws import HandPlant, Pushed, Spring

import taut
from taut.loop import check_fit

ARM = taut.load_arm("planar2")
PID = taut.laws.PID(kp=10.0, kd=1.0)
GRAVITY = taut.laws.GravityPID(kp=10.0, kd=1.0)
RATE = taut.Limits(tau_dot=100.0)


def swapped() -> taut.Arm:
    """The same names on the joints in another order."""
    first, second = ARM.joints
    renamed = (dataclasses.replace(first, name=second.name), dataclasses.replace(second, name=first.name))
    return dataclasses.replace(ARM, joints=renamed)


def compiled(law: taut.Law = PID, arm: taut.Arm = ARM, **options: Any) -> taut.Controller:
    return taut.compile(law, arm, engine="float", **options)


def plant(arm: taut.Arm = ARM, **options: Any) -> taut.RigidPlant:
    return taut.RigidPlant(arm, **options)


LOAD = {"gravity": taut.Payload(mass=1.0)}
DRIVES = taut.drives.Actuation(bandwidth=50.0)
CASES: list[tuple[Callable[[], tuple[taut.Controller, Any]], type[taut.TautError], str]] = [
    (
        lambda: (compiled(), plant(taut.load_arm("planar3"))),
        taut.errors.ShapeError,
        "plant 'RigidPlant(planar3)' has 3 joints and the controller's arm 'planar2' has 2; both must be the same arm, "
        "or the same subset of its joints",
    ),
    (
        lambda: (compiled(arm=taut.load_arm("planar3")), plant(taut.load_arm("gantry3"))),
        taut.errors.MatchError,
        "the joints of plant 'RigidPlant(gantry3)' are x [m], y [m], z [m], and those of the controller's arm "
        "'planar3' are joint1 [rad], joint2 [rad], joint3 [rad]; both must be the same arm, with its joints in the "
        "same order",
    ),
    (
        lambda: (compiled(), plant(swapped())),
        taut.errors.MatchError,
        "the joints of plant 'RigidPlant(planar2)' are joint2 [rad], joint1 [rad], and those of the controller's arm "
        "'planar2' are joint1 [rad], joint2 [rad]; both must be the same arm, with its joints in the same order",
    ),
    (
        lambda: (compiled(), plant(takes="velocity", actuation=DRIVES)),
        taut.errors.MatchError,
        "PID gives a torque and plant 'RigidPlant(planar2)' takes a velocity; choose a law for velocity commands, or a "
        "plant that takes 'torque'",
    ),
    (
        lambda: (compiled(taut.laws.VelocityPI(kp=1.0)), plant()),
        taut.errors.MatchError,
        "VelocityPI gives a velocity and plant 'RigidPlant(planar2)' takes a torque; choose a law for torque commands, "
        "or a plant that takes 'velocity'",
    ),
    (
        lambda: (compiled(Pushed(kp=1.0)), plant()),
        taut.errors.MatchError,
        "Pushed needs F_ext, which plant 'RigidPlant(planar2)' does not measure; it measures tau_meas, v; "
        "give the plant an environment or a contact, and a sensor of it, sensors.wrench",
    ),
    (
        lambda: (compiled(), HandPlant(measures="")),
        taut.errors.MatchError,
        "PID needs v, which plant 'HandPlant(planar2)' does not measure; it measures positions only; "
        "sensing with the velocity 'difference' needs positions only",
    ),
    (
        lambda: (compiled(GRAVITY), plant(adds=("gravity",))),
        taut.errors.MatchError,
        "plant 'RigidPlant(planar2)' adds gravity itself and the law GravityPID adds it too; compile with "
        "adds=plant.adds, use a law that does not add it, or a plant with adds=()",
    ),
    (
        lambda: (compiled(taut.laws.ComputedTorque(kp=1.0, kd=1.0)), plant(adds=("coriolis",))),
        taut.errors.MatchError,
        "plant 'RigidPlant(planar2)' adds coriolis itself and the law ComputedTorque adds it too; compile with "
        "adds=plant.adds, use a law that does not add it, or a plant with adds=()",
    ),
    (
        lambda: (compiled(GRAVITY, adds=("gravity",)), plant()),
        taut.errors.MatchError,
        "the controller was compiled to leave gravity to the plant, and plant 'RigidPlant(planar2)' does not add it; "
        "compile with adds=plant.adds",
    ),
    (
        lambda: (compiled(PID + taut.laws.FrictionCompensation()), plant(adds=("friction",))),
        taut.errors.MatchError,
        "plant 'RigidPlant(planar2)' adds friction itself and the law PID + FrictionCompensation adds it too; compile "
        "with adds=plant.adds, use a law that does not add it, or a plant with adds=()",
    ),
    (
        lambda: (compiled(GRAVITY, adds=LOAD), plant(adds={"gravity": taut.Payload(mass=1.5)})),
        taut.errors.MatchError,
        "plant 'RigidPlant(planar2)' compensates the gravity of another payload than the controller assumes; compile "
        "with adds=plant.adds",
    ),
    (
        lambda: (compiled(GRAVITY, adds=("gravity",)), plant(adds=LOAD)),
        taut.errors.MatchError,
        "plant 'RigidPlant(planar2)' compensates the gravity of another payload than the controller assumes; compile "
        "with adds=plant.adds",
    ),
    (
        lambda: (compiled(PID, limits=RATE), plant(adds=("gravity",))),
        taut.errors.MatchError,
        "plant 'RigidPlant(planar2)' adds gravity itself and the controller's limits count on it too; compile with "
        "adds=plant.adds, use a law that does not add it, or a plant with adds=()",
    ),
    (
        lambda: (compiled(PID, limits=RATE, adds=("gravity",)), plant()),
        taut.errors.MatchError,
        "the controller was compiled to leave gravity to the plant, and plant 'RigidPlant(planar2)' does not add it; "
        "compile with adds=plant.adds",
    ),
]


@pytest.mark.parametrize(("pair", "kind", "message"), CASES, ids=range(len(CASES)))
def test_what_does_not_fit_is_refused_in_words(
    pair: Callable[[], tuple[taut.Controller, Any]], kind: type[taut.TautError], message: str
) -> None:
    ctrl, other = pair()
    for meet in (
        lambda: check_fit(ctrl.side, other),
        lambda: taut.run(ctrl, other, duration=0.01),
    ):
        with pytest.raises(kind) as caught:
            meet()
        assert str(caught.value) == message


@pytest.mark.parametrize(
    "pair",
    [
        lambda: (compiled(), plant()),
        lambda: (compiled(arm=ARM.perturbed(seed=1, mass=0.3)), plant()),  # a modelling error is no misfit
        lambda: (
            compiled(),
            plant(adds=("gravity", "coriolis")),
        ),  # a law that adds nothing fits a plant that adds all
        lambda: (compiled(adds=("gravity",)), plant()),
        lambda: (compiled(GRAVITY, adds=("gravity",)), plant(adds=("gravity",))),
        lambda: (compiled(GRAVITY, adds=("gravity",)), plant(adds=("gravity", "coriolis"))),
        lambda: (
            compiled(GRAVITY, adds={"gravity": taut.Payload(mass=1.0)}),
            plant(adds=LOAD),
        ),  # equal, not the same
        lambda: (compiled(PID, limits=RATE, adds=("gravity",)), plant(adds=("gravity",))),
        lambda: (compiled(Pushed(kp=1.0)), plant(environment=Spring())),
        lambda: (compiled(sensing=taut.Sensing(velocity="difference")), HandPlant(measures="")),
        lambda: (compiled(taut.laws.VelocityPI(kp=1.0)), plant(takes="velocity", actuation=DRIVES)),
    ],
    ids=range(11),
)
def test_what_fits_is_let_through(pair: Callable[[], tuple[taut.Controller, Any]]) -> None:
    ctrl, other = pair()
    check_fit(ctrl.side, other)


def test_other_names_on_the_joints_are_no_misfit() -> None:
    """A model from another file may call its joints otherwise."""
    renamed = dataclasses.replace(ARM, joints=tuple(dataclasses.replace(j, name=f"a_{j.name}") for j in ARM.joints))
    check_fit(compiled().side, plant(renamed))


class TestALoopTakes:
    @pytest.mark.parametrize(
        ("make", "message"),
        [
            (
                lambda: taut.Loop(PID, plant(), duration=1.0),  # type: ignore[arg-type]
                "ctrl must be a controller from taut.compile; got PID",
            ),
            (
                lambda: taut.Loop(compiled(), ARM, duration=1.0),  # type: ignore[arg-type]
                "a Loop takes a model plant such as taut.RigidPlant(arm); got Arm; taut.run takes other plants too",
            ),
            (
                lambda: taut.Loop(compiled(), HandPlant(), duration=1.0),  # type: ignore[arg-type]
                "a Loop takes a model plant such as taut.RigidPlant(arm); got HandPlant; taut.run takes other plants too",
            ),
            (lambda: taut.Loop(compiled(), plant(), duration=0.0), "duration must be > 0 [s]; got 0.0"),
            (lambda: taut.Loop(compiled(), plant(), duration=np.nan), "duration must be finite [s]; got nan"),
            (
                lambda: taut.Loop(compiled(), plant(), [0.1, 0.2], duration=1.0),
                "a reference is a sample such as taut.JointMotion(q=...), taut.hold(), a trajectory with at(t), "
                "taut.stream(...) or taut.chunk(...); got list",
            ),
        ],
        ids=range(6),
    )
    def test_a_controller_a_model_plant_and_a_duration(self, make: Callable[[], object], message: str) -> None:
        with pytest.raises(taut.TautError) as caught:
            make()
        assert str(caught.value) == message


class TestRunTakes:
    @pytest.mark.parametrize(
        ("start", "message"),
        [
            (
                lambda: taut.run(PID, plant(), duration=1.0),  # type: ignore[arg-type]
                "run takes a controller from taut.compile, a taut.Loop, or a list of taut.Phase; got PID",
            ),
            (
                lambda: taut.run(compiled(), duration=1.0),
                "run needs a plant: taut.run(ctrl, taut.RigidPlant(arm), ref, duration=5.0), or a taut.PlantBase; got none",
            ),
            (
                lambda: taut.run(compiled(), plant()),
                "run needs a duration in seconds: taut.run(..., duration=5.0)",
            ),
            (
                lambda: taut.run(compiled(), ARM, duration=1.0),  # type: ignore[arg-type]
                "run needs a plant: taut.run(ctrl, taut.RigidPlant(arm), ref, duration=5.0), or a taut.PlantBase; got Arm",
            ),
            (lambda: taut.run(compiled(), plant(), duration=-1.0), "duration must be > 0 [s]; got -1.0"),
            (
                lambda: taut.run(compiled(), plant(), duration=1.0, seed=-1),
                "seed must be a whole number >= 0; got -1",
            ),
            (
                lambda: taut.run(compiled(), plant(), duration=1.0, seed=1.5),  # type: ignore[arg-type]
                "seed must be a whole number >= 0; got 1.5",
            ),
            (
                lambda: taut.run(compiled(), plant(), duration=1.0, q0=[0.1]),
                "q0 must have shape (2,) (2 joints) [rad | m]; got shape (1,)",
            ),
            (
                lambda: taut.run(compiled(), plant(), duration=1.0, v0=[0.1, np.inf]),
                "v0[1] (joint 'joint2') must be finite [rad/s | m/s]; got inf",
            ),
            (
                lambda: taut.run(compiled(), plant(), duration=1e12),
                "the record of 1e+15 ticks needs 1.68e+08 GB of memory; make duration= shorter, or the rate lower",
            ),
            (
                lambda: taut.run(taut.Loop(compiled(), plant(), duration=1.0), plant()),
                "a Loop has its plant, reference and duration already; pass run(loop) alone",
            ),
            (
                lambda: taut.run(taut.Loop(compiled(), plant(), duration=1.0), duration=2.0),
                "a Loop has its plant, reference and duration already; pass run(loop) alone",
            ),
        ],
        ids=range(12),
    )
    def test_what_is_missing_or_wrong_is_said_in_words(self, start: Callable[[], object], message: str) -> None:
        with pytest.raises(taut.TautError) as caught:
            start()
        assert str(caught.value) == message
