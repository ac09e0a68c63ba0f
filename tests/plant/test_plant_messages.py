"""What a plant is made of is checked when it is made, in words."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import taut
from taut.plant.drives.actuation import Actuation
from taut.plant.sensors.sensors import Sensors

ARM = taut.load_arm("planar2")
DRY = ARM.with_joints(coulomb=[0.0, 0.3])


class Touch:
    """An environment that does nothing."""

    def parameters(self) -> dict[str, object]:
        return {}

    def start(self, T_WE: object) -> dict[str, object]:
        return {}

    def wrench(self, *_: object) -> object:
        return np.zeros(6), {}


CASES: list[tuple[Callable[[], object], type[taut.TautError], str]] = [
    (
        lambda: taut.RigidPlant("planar2"),  # type: ignore[arg-type]
        taut.errors.UsageError,
        "a plant takes an Arm from taut.load_arm; got str",
    ),
    (
        lambda: taut.RigidPlant(ARM, "none"),  # type: ignore[arg-type]
        taut.errors.UsageError,
        "friction must be 'arm', None or a taut.drives.FrictionLaw; got 'none'; another friction is the arm's: arm.with_friction(...)",
    ),
    (
        lambda: taut.RigidPlant(ARM, integrator="euler"),  # type: ignore[arg-type]
        taut.errors.UsageError,
        "integrator must be one of 'semi-implicit-euler', 'rk4'; got 'euler'",
    ),
    (
        lambda: taut.RigidPlant(ARM, takes="torques"),  # type: ignore[arg-type]
        taut.errors.UsageError,
        "takes must be one of 'torque', 'velocity', 'position'; got 'torques'",
    ),
    (lambda: taut.RigidPlant(ARM, substeps=0), taut.errors.RangeError, "substeps must be between 1 and 1000; got 0"),
    (
        lambda: taut.RigidPlant(ARM, substeps=1001),
        taut.errors.RangeError,
        "substeps must be between 1 and 1000; got 1001",
    ),
    (
        lambda: taut.RigidPlant(ARM, substeps=2.0),  # type: ignore[arg-type]
        taut.errors.UsageError,
        "substeps must be a whole number; got 2.0",
    ),
    (
        lambda: taut.RigidPlant(ARM, substeps=True),
        taut.errors.UsageError,
        "substeps must be a whole number; got True",
    ),
    (
        lambda: taut.RigidPlant(DRY, integrator="rk4"),
        taut.errors.UsageError,
        "rk4 needs smooth forces, and arm 'planar2' has dry friction; use semi-implicit-euler, or no friction",
    ),
    (
        lambda: taut.RigidPlant(ARM, takes="position"),
        taut.errors.UsageError,
        "a plant that takes position needs the bandwidth of its drives: actuation.bandwidth, 50 rad/s say",
    ),
    (
        lambda: taut.RigidPlant(ARM, takes="velocity", actuation=Actuation(bandwidth=9.0), adds=("gravity",)),
        taut.errors.UsageError,
        "adds is for torque commands; this plant takes velocity",
    ),
    (
        lambda: taut.RigidPlant(ARM, adds=("gravty",)),
        taut.errors.UnknownNameError,
        "what a plant adds has no component 'gravty'; did you mean 'gravity'?",
    ),
    (
        lambda: taut.RigidPlant(ARM, adds="gravity"),
        taut.errors.UsageError,
        "adds must be a tuple of names; got 'gravity'; write ('gravity',)",
    ),
    (
        lambda: taut.RigidPlant(ARM, actuation=50.0),  # type: ignore[arg-type]
        taut.errors.UsageError,
        "actuation must be taut.drives.Actuation(...); got float",
    ),
    (
        lambda: taut.RigidPlant(ARM, sensors=None),  # type: ignore[arg-type]
        taut.errors.UsageError,
        "sensors must be taut.sensors.Sensors(...); got NoneType",
    ),
    (
        lambda: taut.RigidPlant(ARM, environment=3.0),  # type: ignore[arg-type]
        taut.errors.UsageError,
        "environment must have parameters(), start(T_WE) and wrench(...), see taut.environments.Environment; got float",
    ),
    (
        lambda: taut.RigidPlant(ARM, sensors=Sensors(position=taut.sensors.Encoder(noise=[1e-3, 1e-3, 1e-3]))),
        taut.errors.ShapeError,
        "sensors.position.noise must have shape (2,) (2 joints); got shape (3,)",
    ),
    (
        lambda: taut.RigidPlant(ARM, sensors=Sensors(position=taut.sensors.Encoder(resolution=np.ones((2, 2))))),
        taut.errors.ShapeError,
        "encoder.resolution must be one number, or one for each; got shape (2, 2)",
    ),
    (
        lambda: Actuation(bandwidth=0.0),
        taut.errors.RangeError,
        "bandwidth must be > 0 [rad/s]; got 0.0; for an ideal torque drive leave it out",
    ),
    (
        lambda: Actuation(bandwidth="fast"),  # type: ignore[arg-type]
        taut.errors.ShapeError,
        "bandwidth must be numbers [rad/s]; got 'fast'",
    ),
    (
        lambda: Actuation(bandwidth=np.inf),
        taut.errors.RangeError,
        "bandwidth must be finite [rad/s]; got inf; for an ideal torque drive leave it out",
    ),
    (lambda: Actuation(delay=-1e-3), taut.errors.RangeError, "delay must be >= 0 [s]; got -0.001"),
    (
        lambda: Actuation(delay=0.0015).taps(1e-3),
        taut.errors.RangeError,
        "actuation.delay must be a whole number of control periods of 0.001 s, at most 1000; got 0.0015 s; a part of a "
        "period needs a higher control rate, or taut.error_dynamics(rate=..., delay=...), which takes any",
    ),
    (
        lambda: Actuation(delay=2.0).taps(1e-3),
        taut.errors.RangeError,
        "actuation.delay must be a whole number of control periods of 0.001 s, at most 1000; got 2 s",
    ),
]


@pytest.mark.parametrize(("make", "kind", "message"), CASES, ids=range(len(CASES)))
def test_what_does_not_go_together_is_refused_in_words(
    make: Callable[[], object], kind: type[taut.TautError], message: str
) -> None:
    with pytest.raises(kind) as caught:
        make()
    assert str(caught.value) == message


class TestAPlantDeclares:
    def test_what_it_takes_measures_and_adds(self) -> None:
        plain = taut.RigidPlant(ARM)
        assert (plain.name, plain.takes, plain.adds.names) == ("RigidPlant(planar2)", "torque", ())
        assert plain.measures == {"v", "tau_meas"}
        assert taut.RigidPlant(ARM, environment=Touch()).measures == {"v", "tau_meas", "F_ext"}  # type: ignore[arg-type]
        assert taut.RigidPlant(ARM, adds=["coriolis", "gravity"]).adds.names == ("gravity", "coriolis")

    def test_the_parameters_of_what_it_has(self) -> None:
        assert set(taut.RigidPlant(ARM, friction=None).parameters) == {
            "plant.payload.mass", "plant.payload.com", "plant.payload.inertia",
        }  # fmt: skip
        full = taut.RigidPlant(
            DRY,
            actuation=Actuation(bandwidth=9.0),
            sensors=Sensors(
                position=taut.sensors.Encoder(resolution=1e-3, noise=1e-3, offset=0.1),
                velocity=taut.sensors.Tachometer(noise=1e-3),
                torque=taut.sensors.TorqueSensor(bias=[0.0, 1.0]),
            ),
        )
        assert set(full.parameters) == {
            "plant.payload.mass", "plant.payload.com", "plant.payload.inertia", "plant.friction.viscous", "plant.friction.coulomb",
            "actuation.bandwidth", "sensors.position.resolution", "sensors.position.noise", "sensors.position.offset", "sensors.velocity.noise", "sensors.torque.bias",
        }  # fmt: skip

    def test_the_noise_that_it_needs(self) -> None:
        assert taut.RigidPlant(ARM).noise == {}
        assert taut.RigidPlant(ARM, sensors=Sensors(velocity=taut.sensors.Tachometer(noise=[0.0, 1.0]))).noise == {
            "v": (2,)
        }
