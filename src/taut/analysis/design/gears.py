"""What a design runs into in the plant's transmissions: play and elasticity."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import numpy as np
from scipy.linalg import eigh

from taut import laws
from taut.analysis.design.limits import DesignLimit, Tried
from taut.base.types import Float64Array
from taut.plant.drives.transmission import Transmission
from taut.plant.rigid import RigidPlant

__all__ = ["gear_limits"]

SOFT: Final = 0.5  # of a flexible joint's frequency with its motor held: the usual rule for a design


def gear_limits(tried: Tried) -> Iterator[DesignLimit]:
    """Play and elasticity of the plant's transmissions."""
    plant = tried.plant
    gear = None if plant is None else plant.actuation.transmission
    if gear is None or plant is None:
        return
    if gear.has_play:
        yield _play(tried, plant, gear)
    soft = list(gear.compliant(tried.x.n))
    if not soft:
        return
    arm = plant.arm
    link = np.asarray(tried.x.M) - np.diag(tried.arm.rotor_inertia)
    stiffness = np.diag(np.broadcast_to(np.asarray(gear.stiffness), (tried.x.n,))[soft])
    squares, modes = eigh(stiffness, link[np.ix_(soft, soft)])
    slowest = float(np.sqrt(squares[0]))
    i = soft[int(np.argmax(np.abs(modes[:, 0])))]
    fastest = max((each.omega_n for each in tried.designed), default=0.0)
    yield DesignLimit(
        name="elastic joint", value=fastest, limit=SOFT * slowest, unit="rad/s", ok=fastest <= SOFT * slowest,
        sentence=(
            f"'{arm.joint_names[i]}' swings at {slowest:.4g} rad/s with the motors held; by the usual rule a design "
            f"has up to half of that, {SOFT * slowest:.4g} rad/s, and this one has {fastest:.4g} rad/s; the limit "
            "'on plant' tells whether its gains bear the swing"
        ),
    )  # fmt: skip


def _play(tried: Tried, plant: RigidPlant, gear: Transmission) -> DesignLimit:
    """Of the joint whose play is most for its gain and its dry friction: kp play / 2 must not move the motor."""
    arm, n = plant.arm, tried.x.n
    play = np.broadcast_to(np.asarray(gear.backlash, dtype=np.float64), (n,))
    stiff = _stiffnesses(tried)
    if plant.sensors.position.side == "motor" or stiff is None:
        i = int(np.argmax(play))
        where = (
            "stays off by up to half of it, for the encoder is at the motor"
            if plant.sensors.position.side == "motor"
            else "swings about there if its gain moves the motor against the friction"
        )
        return DesignLimit(
            name="backlash", value=float(play[i]), limit=0.0, unit=arm.units[i], ok=False,
            sentence=f"'{arm.joint_names[i]}' has {play[i]:.2g} {arm.units[i]} of play, within which it {where}",
        )  # fmt: skip
    dry = arm.coulomb if plant.friction == "arm" else np.zeros(n)
    most = 2.0 * dry / stiff
    i = int(np.argmax(play - most))
    ok = bool(play[i] <= most[i])
    unit = arm.units[i]
    return DesignLimit(
        name="backlash", value=float(play[i]), limit=float(most[i]), unit=unit, ok=ok,
        sentence=(
            f"'{arm.joint_names[i]}' has {play[i]:.2g} {unit} of play, and kp = {stiff[i]:.4g} "
            f"{'does not move' if ok else 'moves'} its motor against {dry[i]:.3g} {'N' if unit == 'm' else 'N m'} of "
            f"dry friction from half of that: it "
            f"{'rolls to rest within it' if ok else 'swings for ever where no weight presses the teeth together'}; "
            f"{most[i]:.2g} {unit} is the most that keeps still"
        ),
    )  # fmt: skip


def _stiffnesses(tried: Tried) -> Float64Array | None:
    """(n,) [N m/rad] of the joints of a law that has one for each; None of others."""
    law: Any = tried.bench.law
    if isinstance(law, laws.Sum):
        law = next((part for part in law.children().values() if hasattr(part, "kp")), law)
    if isinstance(law, (laws.PID, laws.GravityPID)):
        return np.asarray(np.diag(law.kp.matrix(tried.x.n)))
    if isinstance(law, laws.ComputedTorque):
        return np.asarray(np.diag(np.asarray(tried.x.M) @ law.kp.matrix(tried.x.n)))
    return None
