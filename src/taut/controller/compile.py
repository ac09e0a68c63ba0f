"""taut.compile: a controller of a law, or of a task, for one arm and one rate."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

from taut.arm.description import Arm, Payload
from taut.base.checks import instance_of, rate_in_hertz
from taut.base.errors import UsageError
from taut.codegen.engine import EngineChoice, chosen_engine
from taut.control.law import Law
from taut.control.lawside import LawSide
from taut.control.limits import Limits
from taut.control.sensing import Sensing
from taut.controller.controller import Controller
from taut.maths.model import Adds

if TYPE_CHECKING:
    from taut.control.tasks.phase import Phase
    from taut.control.tasks.task import Task


def compile(
    law: Law | Task | Sequence[Phase],
    arm: Arm,
    *,
    rate: float = 1000.0,
    sensing: Sensing | None = None,
    limits: Limits | None = None,
    adds: Adds | Iterable[str] | Mapping[str, Payload | None] = (),
    engine: EngineChoice = "auto",
) -> Controller:
    """A controller: the law for this arm, as native code.

    Args:
        law: A law of `taut.laws`, a sum of them, or one of your own; or a task, a list of `taut.Phase`.
        arm: The controller's model of the arm, payload included.
        rate: Ticks per second [Hz].
        sensing: Where the velocity comes from, measured by default; filters of what is measured.
        limits: What a torque command is cut to; no limit unless given.
        adds: What the plant adds itself ("gravity", "coriolis", "friction"): `plant.adds`. It is left out.
        engine: "native" for machine code, "float" for plain Python, "auto" for the first that is there.

    Raises:
        UsageError: Not a law, not an arm, or a law whose command does not fit its memory.
        ShapeError: A gain, limit or cut-off of another size than the arm.
        RangeError: A cut-off at half the rate or above.
        MatchError: Two laws that add the same, limits on a command that is no torque.
        TraceError: Law code that cannot be traced; the message names file and line.

    Example:
        >>> import numpy as np, taut
        >>> arm = taut.load_arm("planar2")
        >>> ctrl = taut.compile(taut.laws.PID(kp=10.0, kd=1.0), arm, rate=500.0)
        >>> ctrl.step(np.zeros(2), np.zeros(2), taut.JointMotion(q=[0.1, 0.0])).tolist()
        [1.0, 0.0]
    """
    instance_of("arm", arm, Arm, "an Arm from taut.load_arm")
    instance_of("sensing", sensing, Sensing | None, "a taut.Sensing")
    instance_of("limits", limits, Limits | None, "a taut.Limits")
    side = LawSide(
        law=law if isinstance(law, Law) else _task(law),
        arm=arm,
        rate=rate_in_hertz(rate),
        sensing=sensing or Sensing(),
        limits=limits,
        adds=Adds.of(adds),
    )
    return Controller(side, chosen_engine(engine))


def _task(law: object) -> Task:
    """The task of a list of phases."""
    from taut.control.tasks.phase import Phase
    from taut.control.tasks.task import Task

    if isinstance(law, Task):
        return law
    if isinstance(law, (list, tuple)):
        return Task.of(law)
    if isinstance(law, Phase):
        raise UsageError("a task is a list of phases: taut.compile([taut.Phase(...)], arm)", name="law")
    raise UsageError(f"compile takes a law such as taut.laws.PID(kp=...), with its gains; got {law!r}", name="law")
