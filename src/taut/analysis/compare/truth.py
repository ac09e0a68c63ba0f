"""How the truth may differ from what laws were compared on: a plant's arm drawn anew, its sensors noisier."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from taut.arm.description import Arm
from taut.base.checks import finite_scalar
from taut.base.errors import RangeError, UsageError, unknown_name
from taut.base.types import ArrayLike
from taut.plant.sensors.sensors import Sensors

__all__ = ["WrongModel", "PlantChange", "is_noisy"]

SHARES: Final = ("mass", "inertia", "friction")  # of what it is; com in m, payload in kg
MOST_TRIALS: Final = 1000


@dataclass(frozen=True, kw_only=True)
class WrongModel:
    """By how much the true arm may differ from the one that the laws were compared on.

    Trial k, from 0 on, draws with the seed `seed + k`: `arm.perturbed(seed=seed + k, mass=mass, ...)`, and of the
    payload a share of `payload` that is as likely as any other. Controllers keep the model that they have.

    Args:
        mass: Relative spread of each mass (log-normal, standard deviation).
        com: Spread of each centre of mass [m].
        inertia: Relative spread of the bodies' sizes.
        friction: Relative spread of viscous and dry friction.
        payload: [kg] that is added at most, where the payload has its centre of mass.
        trials: How many arms are drawn.
        seed: Of the first.

    Raises:
        RangeError: A spread outside 0 to 1, a negative payload, no trial.
        UsageError: Nothing differs.

    Example:
        >>> WrongModel(mass=0.1).text()
        'masses by 10 %, seeds 0 to 4'
    """

    mass: float = 0.0
    com: float = 0.0
    inertia: float = 0.0
    friction: float = 0.0
    payload: float = 0.0
    trials: int = 5
    seed: int = 0

    def __post_init__(self) -> None:
        for name in (*SHARES, "com"):
            if not 0.0 <= finite_scalar(name, getattr(self, name)) <= 1.0:
                raise RangeError(f"{name} must be between 0 and 1; got {getattr(self, name)!r}", name=name)
        if finite_scalar("payload", self.payload, unit="kg") < 0.0:
            raise RangeError(f"payload must be >= 0 [kg]; got {self.payload!r}", name="payload")
        for name, least in (("trials", 1), ("seed", 0)):
            number = getattr(self, name)
            if isinstance(number, bool) or not isinstance(number, (int, np.integer)) or not number >= least:
                raise RangeError(f"{name} must be a whole number >= {least}; got {number!r}", name=name)
        if self.trials > MOST_TRIALS:
            raise RangeError(f"trials must be <= {MOST_TRIALS}; got {self.trials}", name="trials")
        if not any(getattr(self, name) for name in (*SHARES, "com", "payload")):
            raise UsageError("a wrong model needs one of mass, com, inertia, friction and payload above zero")

    def text(self) -> str:
        """In words, for the foot of a table."""
        names = {"mass": "masses", "inertia": "sizes", "friction": "friction"}
        parts = [f"{names[name]} by {100.0 * getattr(self, name):g} %" for name in SHARES if getattr(self, name)]
        parts += [f"centres of mass by {self.com:g} m"] if self.com else []
        parts += [f"up to {self.payload:g} kg more payload"] if self.payload else []
        last = self.seed + self.trials - 1
        return f"{', '.join(parts)}, {f'seeds {self.seed} to {last}' if self.trials > 1 else f'seed {self.seed}'}"

    def arm(self, arm: Arm, trial: int) -> Arm:
        """The true arm of a trial."""
        seed, load = self.seed + trial, arm.payload
        made = arm.perturbed(seed=seed, mass=self.mass, com=self.com, inertia=self.inertia, friction=self.friction)
        if not self.payload:
            return made
        more = self.payload * float(np.random.default_rng([seed, 1]).random())
        return made.with_payload(load.mass + more, load.com, load.inertia)


@dataclass(frozen=True, kw_only=True)
class PlantChange:
    """What is different in another plant like the one of a setting.

    Args:
        error: Draws the true arm, in its trial `trial`.
        noise: Standard deviation by sensor, such as {"position": 1e-5}; an empty one takes all noise away. None
            leaves the sensors as they are.
    """

    error: WrongModel | None = None
    trial: int = 0
    noise: Mapping[str, ArrayLike] | None = None

    def arm(self, arm: Arm) -> Arm:
        """The true arm, changed."""
        return arm if self.error is None else self.error.arm(arm, self.trial)

    def sensors(self, sensors: Sensors) -> Sensors:
        """The sensors, changed.

        Raises:
            UnknownNameError: There is no such sensor.
            UsageError: The plant has none of that name.
        """
        if self.noise is None:
            return sensors
        noise = dict(self.noise) or {name: 0.0 for name in Sensors.declared if is_noisy(sensors, name)}
        new = {}
        for name, value in noise.items():
            if name not in Sensors.declared:
                raise unknown_name("a plant", "sensor", name, Sensors.declared)
            sensor = getattr(sensors, name)
            if sensor is None:
                raise UsageError(
                    f"the plant has no sensor '{name}', which noise is stated for; leave it out", name=name
                )
            new[name] = dataclasses.replace(sensor, noise=value if np.any(value) or name != "wrench" else None)
        return dataclasses.replace(sensors, **new)


def is_noisy(sensors: Sensors, name: str) -> bool:
    """Whether a sensor is there and has noise."""
    sensor = getattr(sensors, name)
    return sensor is not None and "noise" in sensor.parameters()
