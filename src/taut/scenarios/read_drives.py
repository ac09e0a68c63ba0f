"""The drives of a scenario's plant: [plant.actuation] with tables for motor, ripple, transmission and torque loop."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, fields
from typing import Any, Final

from taut.base.errors import quoted_list
from taut.plant.drives.actuation import Actuation, Ripple
from taut.plant.drives.motor import ElectricMotor, Motor, TorqueLoop
from taut.plant.drives.transmission import Transmission
from taut.scenarios.toml import Section

__all__ = ["made_from", "read_actuation"]

PARTS: Final[Mapping[str, Any]] = {
    "motor": Motor,
    "ripple": Ripple,
    "transmission": Transmission,
    "torque_loop": TorqueLoop,
}


def read_actuation(section: Section) -> Actuation:
    """The drives; a motor with electrical numbers is an electric motor."""
    options: dict[str, Any] = {}
    for name, cls in PARTS.items():
        if name in section:
            table = section.section(name)
            options[name] = made_from(table, _kind_of_motor(table) if name == "motor" else cls)
    return made_from(section, Actuation, **options)  # type: ignore[no-any-return]  # an Actuation


def _kind_of_motor(section: Section) -> type[Motor | ElectricMotor]:
    curve, electric = ([field.name for field in fields(cls)] for cls in (Motor, ElectricMotor))
    section.only(*curve, *electric)
    of_curve, of_electric = ([name for name in names if name in section] for names in (curve, electric))
    if of_curve and of_electric:
        raise section.error(
            f"has {quoted_list(of_curve)} of a speed-torque curve and {quoted_list(of_electric)} of an electric "
            "motor; keep one kind"
        )
    return ElectricMotor if of_electric else Motor


def made_from(section: Section, cls: Any, **parts: Any) -> Any:
    """An object of a dataclass from the keys of a section, and from what was made of its tables."""
    of = [field for field in fields(cls) if field.name not in parts]
    required = [field.name for field in of if field.default is MISSING and field.default_factory is MISSING]
    values = section.fields([field.name for field in of], required)
    with section.blamed():
        return cls(**values, **parts)
