"""A controller and a plant that do not fit are refused when they meet, in one sentence."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from refusals import refused
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
CASES: list[tuple[Callable[[], tuple[taut.Controller, Any]], type[taut.TautError]]] = [
    (lambda: (compiled(), plant(taut.load_arm("planar3"))), taut.errors.ShapeError),
    (lambda: (compiled(arm=taut.load_arm("planar3")), plant(taut.load_arm("gantry3"))), taut.errors.MatchError),
    (lambda: (compiled(), plant(swapped())), taut.errors.MatchError),
    (lambda: (compiled(), plant(takes="velocity", actuation=DRIVES)), taut.errors.MatchError),
    (lambda: (compiled(taut.laws.VelocityPI(kp=1.0)), plant()), taut.errors.MatchError),
    (lambda: (compiled(Pushed(kp=1.0)), plant()), taut.errors.MatchError),
    (lambda: (compiled(), HandPlant(measures="")), taut.errors.MatchError),
    (lambda: (compiled(GRAVITY), plant(adds=("gravity",))), taut.errors.MatchError),
    (lambda: (compiled(taut.laws.ComputedTorque(kp=1.0, kd=1.0)), plant(adds=("coriolis",))), taut.errors.MatchError),
    (lambda: (compiled(GRAVITY, adds=("gravity",)), plant()), taut.errors.MatchError),
    (lambda: (compiled(PID + taut.laws.FrictionCompensation()), plant(adds=("friction",))), taut.errors.MatchError),
    (lambda: (compiled(GRAVITY, adds=LOAD), plant(adds={"gravity": taut.Payload(mass=1.5)})), taut.errors.MatchError),
    (lambda: (compiled(GRAVITY, adds=("gravity",)), plant(adds=LOAD)), taut.errors.MatchError),
    (lambda: (compiled(PID, limits=RATE), plant(adds=("gravity",))), taut.errors.MatchError),
    (lambda: (compiled(PID, limits=RATE, adds=("gravity",)), plant()), taut.errors.MatchError),
]


@pytest.mark.parametrize(("pair", "kind"), CASES, ids=range(len(CASES)))
def test_what_does_not_fit_is_refused_in_words(
    pair: Callable[[], tuple[taut.Controller, Any]], kind: type[taut.TautError]
) -> None:
    ctrl, other = pair()
    for meet in (
        lambda: check_fit(ctrl.side, other),
        lambda: taut.run(ctrl, other, duration=0.01),
    ):
        with refused(kind):
            meet()


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
        "make",
        [
            lambda: taut.Loop(PID, plant(), duration=1.0),
            lambda: taut.Loop(compiled(), ARM, duration=1.0),
            lambda: taut.Loop(compiled(), HandPlant(), duration=1.0),
            lambda: taut.Loop(compiled(), plant(), duration=0.0),
            lambda: taut.Loop(compiled(), plant(), duration=np.nan),
            lambda: taut.Loop(compiled(), plant(), [0.1, 0.2], duration=1.0),
        ],
        ids=range(6),
    )
    def test_a_controller_a_model_plant_and_a_duration(self, make: Callable[[], object]) -> None:
        with refused(taut.TautError):
            make()


class TestRunTakes:
    @pytest.mark.parametrize(
        "start",
        [
            lambda: taut.run(PID, plant(), duration=1.0),
            lambda: taut.run(compiled(), duration=1.0),
            lambda: taut.run(compiled(), plant()),
            lambda: taut.run(compiled(), ARM, duration=1.0),
            lambda: taut.run(compiled(), plant(), duration=-1.0),
            lambda: taut.run(compiled(), plant(), duration=1.0, seed=-1),
            lambda: taut.run(compiled(), plant(), duration=1.0, seed=1.5),
            lambda: taut.run(compiled(), plant(), duration=1.0, q0=[0.1]),
            lambda: taut.run(compiled(), plant(), duration=1.0, v0=[0.1, np.inf]),
            lambda: taut.run(compiled(), plant(), duration=1e12),
            lambda: taut.run(taut.Loop(compiled(), plant(), duration=1.0), plant()),
            lambda: taut.run(taut.Loop(compiled(), plant(), duration=1.0), duration=2.0),
        ],
        ids=range(12),
    )
    def test_what_is_missing_or_wrong_is_said_in_words(self, start: Callable[[], object]) -> None:
        with refused(taut.TautError):
            start()
