"""What a plant is made of is checked when it is made, in words."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import taut
from taut.plant.actuation import Actuation
from taut.plant.sensors import Sensors

ARM = taut.load_arm("planar2")
DRY = ARM.with_joints(coulomb=[0.0, 0.3])


class Touch(taut.environments.Environment):
    """An environment that does nothing."""

    def wrench(self, *_: object) -> object:
        return np.zeros(6), {}


CASES: list[tuple[Callable[[], object], type[taut.TautError], str]] = [
    (
        lambda: taut.RigidPlant("planar2"),  # type: ignore[arg-type]
        taut.errors.UsageError,
        "arm",
    ),
    (
        lambda: taut.RigidPlant(ARM, "none"),  # type: ignore[arg-type]
        taut.errors.UsageError,
        "friction",
    ),
    (
        lambda: taut.RigidPlant(ARM, integrator="euler"),  # type: ignore[arg-type]
        taut.errors.UsageError,
        "integrator",
    ),
    (
        lambda: taut.RigidPlant(ARM, takes="torques"),  # type: ignore[arg-type]
        taut.errors.UsageError,
        "takes",
    ),
    (lambda: taut.RigidPlant(DRY, integrator="rk4"), taut.errors.UsageError, "integrator"),
    (lambda: taut.RigidPlant(ARM, substeps=0), taut.errors.RangeError, "substeps"),
    (
        lambda: taut.RigidPlant(ARM, substeps=1001),
        taut.errors.RangeError,
        "substeps",
    ),
    (
        lambda: taut.RigidPlant(ARM, substeps=2.0),  # type: ignore[arg-type]
        taut.errors.RangeError,
        "substeps",
    ),
    (
        lambda: taut.RigidPlant(ARM, substeps=True),
        taut.errors.RangeError,
        "substeps",
    ),
    (
        lambda: taut.RigidPlant(DRY, integrator="rk4"),
        taut.errors.UsageError,
        "integrator",
    ),
    (
        lambda: taut.RigidPlant(ARM, takes="position"),
        taut.errors.UsageError,
        "actuation",
    ),
    (
        lambda: taut.RigidPlant(ARM, takes="velocity", actuation=Actuation(bandwidth=9.0), adds=("gravity",)),
        taut.errors.UsageError,
        "adds",
    ),
    (
        lambda: taut.RigidPlant(ARM, adds=("gravty",)),
        taut.errors.UnknownNameError,
        "gravty",
    ),
    (
        lambda: taut.RigidPlant(ARM, adds="gravity"),
        taut.errors.UsageError,
        "adds",
    ),
    (
        lambda: taut.RigidPlant(ARM, actuation=50.0),  # type: ignore[arg-type]
        taut.errors.UsageError,
        "actuation",
    ),
    (
        lambda: taut.RigidPlant(ARM, sensors=None),  # type: ignore[arg-type]
        taut.errors.UsageError,
        "sensors",
    ),
    (
        lambda: taut.RigidPlant(ARM, environment=3.0),  # type: ignore[arg-type]
        taut.errors.UsageError,
        "environment",
    ),
    (
        lambda: taut.RigidPlant(ARM, sensors=Sensors(position=taut.sensors.Encoder(noise=[1e-3, 1e-3, 1e-3]))),
        taut.errors.ShapeError,
        "sensors.position.noise",
    ),
    (
        lambda: taut.RigidPlant(ARM, sensors=Sensors(position=taut.sensors.Encoder(resolution=np.ones((2, 2))))),
        taut.errors.ShapeError,
        "resolution",
    ),
    (
        lambda: Actuation(bandwidth=0.0),
        taut.errors.RangeError,
        "bandwidth",
    ),
    (
        lambda: Actuation(bandwidth="fast"),  # type: ignore[arg-type]
        taut.errors.ShapeError,
        "bandwidth",
    ),
    (
        lambda: Actuation(bandwidth=np.inf),
        taut.errors.RangeError,
        "bandwidth",
    ),
    (lambda: Actuation(delay=-1e-3), taut.errors.RangeError, "delay"),
    (
        lambda: Actuation(delay=0.0015).taps(1e-3),
        taut.errors.RangeError,
        "actuation.delay",
    ),
    (
        lambda: Actuation(delay=2.0).taps(1e-3),
        taut.errors.RangeError,
        "actuation.delay",
    ),
]


@pytest.mark.parametrize(("make", "kind", "name"), CASES, ids=range(len(CASES)))
def test_what_does_not_go_together_is_refused_by_name(
    make: Callable[[], object], kind: type[taut.TautError], name: str
) -> None:
    with pytest.raises(kind) as caught:
        make()
    assert caught.value.name == name


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
