"""How much the joints of an arm disturb each other, and whether independent joint controllers are enough."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from taut.base.checks import positive_scalar
from taut.base.errors import UsageError
from taut.base.paths import subtree
from taut.base.types import ArrayLike, Float64Array
from taut.linear.equilibrium import WITHIN
from taut.linear.linearise import linearise
from taut.linear.margins import frequency_grid
from taut.loop import Loop
from taut.maths.model import PayloadValues, model_of
from taut.maths.snapshot import Snapshot

__all__ = ["ENOUGH", "Coupling", "coupling"]

AT_REST: Final = 1e-12  # [rad | m] what rounding moves a joint by
ENOUGH: Final = 0.1  # of a joint's own motion: what others may follow of it


@dataclass(frozen=True, kw_only=True, eq=False)
class Coupling:
    """How much the joints disturb each other about a pose; print it for a sentence of each.

    Args:
        joints: Their names.
        inertia: 0 to 1, one less the smallest eigenvalue of D^-1/2 M D^-1/2, with D the diagonal of M, and M with
            rotors and payload: 0 for axes whose accelerations are decoupled.
        crosstalk: (n, n) the largest size over all frequencies of the response of each joint (row) to the reference
            of each (column).
        sag: (n,) what the weight moves each joint by, until the loop rests [rad | m].
        share: The most crosstalk of different joints that counts as enough.
        unit: Of the joints, all of one kind.
    """

    joints: tuple[str, ...]
    inertia: float
    crosstalk: Float64Array
    sag: Float64Array
    share: float
    unit: str

    @property
    def worst(self) -> tuple[float, str, str]:
        """The largest crosstalk of two joints, which of them moves, and whose reference it was."""
        apart = np.where(np.eye(len(self.joints), dtype=bool), -1.0, self.crosstalk)
        i, j = np.unravel_index(int(np.argmax(apart)), apart.shape)
        return max(float(apart[i, j]), 0.0), self.joints[i], self.joints[j]

    @property
    def enough(self) -> bool:
        """Whether no joint follows more than `share` of another one's reference."""
        return self.worst[0] <= self.share

    def __str__(self) -> str:
        if len(self.joints) == 1:
            return f"joint '{self.joints[0]}' is alone: there is nothing that it could be coupled to"
        size, follower, other = self.worst
        word = "is enough" if self.enough else "is not enough"
        i = int(np.argmax(np.abs(self.sag)))
        moved = f"'{self.joints[i]}' by {self.sag[i]:.3g} {self.unit}" if abs(self.sag[i]) > AT_REST else "no joint"
        return "\n".join(
            [
                f"decentralised control {word}: joint '{follower}' follows up to {100.0 * size:.3g} % of the "
                f"reference of '{other}', and {100.0 * self.share:g} % is the most",
                f"the inertia matrix is coupled by {self.inertia:.3g} (0 is diagonal, 1 is singular)",
                f"the weight moves {moved} until the loop rests",
            ]
        )


def coupling(loop: Loop, *, at: ArrayLike | None = None, share: float = ENOUGH, within: float = WITHIN) -> Coupling:
    """Whether independent controllers of the joints are enough for an arm at a pose, as the loop really runs.

    The dynamics are decoupled when each joint's acceleration depends on its own torque and state alone: in gantries,
    and nearly in arms with large gears, whose rotors are most of the diagonal of M, and where gravity is small
    beside what the joints give. The loop says how much that matters for its gains.

    Args:
        loop: A loop of a law of joints, with a reference that stays.
        at: (n,) joint positions to begin at [rad | m]; home if left out.
        share: The most crosstalk of different joints that counts as enough.
        within: [rad | m] how far from `at` the equilibrium may be.

    Raises:
        UsageError: A law that follows no joint positions; joints of metres beside joints of radians; an unstable
            loop.
        RangeError: No equilibrium near `at`.

    Example:
        >>> import taut
        >>> arm = taut.load_arm("gantry3")
        >>> ctrl = taut.compile(taut.laws.GravityPID(kp=1000.0, kd=100.0), arm)
        >>> loop = taut.Loop(ctrl, taut.RigidPlant(arm, friction=None), duration=1.0)
        >>> taut.analysis.coupling(loop).enough
        True

    References:
        Section 10.2.2.1 decentralised multi-joint control; section 10.2.1.5 on gears.
    """
    share = positive_scalar("share", share)
    lin = linearise(loop, at=at, within=within)
    if "ref.q[0]" not in lin.inputs:
        raise UsageError(
            f"coupling is for laws that follow joint positions; {type(loop.side.law).__name__} does not", name="loop"
        )
    units = loop.plant.arm.units
    if len(set(units)) > 1:
        raise UsageError(
            "coupling compares joints of one kind, and this arm has some in rad and some in m, whose shares of each "
            "other have units; look at lin.frequency_response(omega, input='ref.q', output='q') of taut.linearise",
            name="loop",
        )
    if not lin.stable:
        raise UsageError(
            f"crosstalk is that of a stable loop; this one is {lin.system.unstable_because}; lower the gains",
            name="loop",
        )
    payload = PayloadValues.of(subtree(loop.parameters, "plant.payload"))
    M = np.array(Snapshot(model_of(loop.plant.arm), q=lin.q, v=np.zeros(len(lin.q)), payload=payload).M, dtype=float)
    root = np.sqrt(np.diag(M))
    scaled = M / np.outer(root, root)
    omega = frequency_grid(lin.dt, np.abs(np.angle(lin.poles)) / lin.dt)
    columns, rows = list(lin.columns("ref.q")), list(lin.rows("q"))
    T = lin.system.response(omega, lin.B[:, columns], lin.C[rows], lin.D[np.ix_(rows, columns)])
    return Coupling(
        joints=lin.joints,
        inertia=1.0 - float(np.linalg.eigvalsh(scaled)[0]),
        crosstalk=np.abs(T).max(axis=0),
        sag=lin.moved,
        share=share,
        unit=units[0],
    )
