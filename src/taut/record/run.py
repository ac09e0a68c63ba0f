"""Run: what happened, tick by tick."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from taut.arm.description import Arm
from taut.arm.parts import short_way
from taut.base.checks import finite_scalar, instance_of
from taut.base.errors import MatchError, RangeError, UsageError, count_of
from taut.base.paths import Named
from taut.base.types import Float64Array
from taut.control.trajectories.reference import Sample
from taut.record.info import Outcome, RunInfo

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from taut.base.result import Content
    from taut.record.metrics import Metrics
    from taut.record.parts import PhaseWindow
    from taut.record.tool import TaskSide

HALF: Final = 1e-9  # [s] between a time as people write it and as a tick has it


@dataclass(frozen=True, kw_only=True, eq=False)
class Run:
    """A recorded run. All arrays have one row per control tick; row k stands at time t[k].

    q and v are the true state at the tick, `command` and `terms` what the controller made of what it measured then,
    and tau what acted on the joints during the period that follows.

    Example:
        >>> import taut
        >>> arm = taut.load_arm("one_joint")
        >>> ctrl = taut.compile(taut.laws.GravityPID(kp=2.205, kd=2.0), arm)
        >>> run = taut.run(ctrl, taut.RigidPlant(arm), taut.JointMotion(q=[0.5]), duration=5.0)
        >>> run, run.terms["P"].shape
        (Run(5001 ticks, 5 s, 1 joint, completed), (5001, 1))
        >>> bool(run.metrics.overshoot[0] < 0.1)  # [%]
        True
    """

    t: Float64Array  # (k,) [s]
    q: Float64Array  # (k, n) [rad | m]
    v: Float64Array  # (k, n) [rad/s | m/s]
    tau: Float64Array  # (k, n) [N m | N]
    command: Float64Array  # (k, n) in the unit of the command's kind
    terms: Mapping[str, Float64Array]  # (k, n) each; they add up to the command
    reference: Sample  # the wanted sample, with fields (k, n), or (k, 3) and the like of the task
    outcome: Outcome
    joint_names: tuple[str, ...]
    units: tuple[str, ...]  # of each entry of q: rad or m
    continuous: tuple[int, ...] = ()  # joints that wrap
    kind: str = "torque"  # of the command
    extra: Mapping[str, Float64Array] = field(default_factory=dict)  # further columns, such as F_ext (k, 6)
    info: RunInfo = field(default_factory=RunInfo)  # what it was made with
    arm: Arm | None = None  # the plant's arm, to draw; None in a run that was loaded from a file

    def __post_init__(self) -> None:
        object.__setattr__(self, "terms", Named("the run", "term", self.terms))
        object.__setattr__(self, "extra", Named("the run", "further column", self.extra))

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joint_names)

    @property
    def rate(self) -> float:
        """Ticks per second [Hz]; UsageError if the run does not state it."""
        if self.info.rate is None:
            raise UsageError("the run has no rate; give info=RunInfo(rate=...) [Hz]", name="rate")
        return self.info.rate

    @property
    def effort_units(self) -> tuple[str, ...]:
        """Unit of each entry of tau: N m or N."""
        return tuple("N" if unit == "m" else "N m" for unit in self.units)

    @property
    def command_units(self) -> tuple[str, ...]:
        """Unit of each entry of the command and its terms."""
        if self.kind == "torque":
            return self.effort_units
        return tuple(f"{unit}/s" for unit in self.units) if self.kind == "velocity" else self.units

    @cached_property
    def error(self) -> Float64Array | None:
        """(k, n) tracking error [rad | m], wanted minus true, the short way round if it wraps; None of a task."""
        wanted = getattr(self.reference, "q", None)
        return None if wanted is None else short_way(np.asarray(wanted) - self.q, self.continuous)

    @property
    def is_setpoint(self) -> bool:
        """Whether the reference asks for one position of the joints throughout."""
        q, v = getattr(self.reference, "q", None), getattr(self.reference, "v", None)
        return q is not None and bool(len(self)) and not np.any(q != q[0]) and not np.any(v)

    @cached_property
    def task(self) -> TaskSide:
        """The controlled frame: pose, twist, Jacobian, errors of position and rotation; UsageError if unknown."""
        from taut.record.tool import task_of

        return task_of(self)

    @cached_property
    def metrics(self) -> Metrics:
        """How well it went, in numbers: overshoot, settling time, errors, effort, ..."""
        from taut.record.metrics import Metrics

        return Metrics(self)

    @property
    def arms(self) -> tuple[Arm, Arm]:
        """The controller's and the plant's arm, without what is only drawn; UsageError if not recorded."""
        controller, plant = self.info.controller_arm, self.info.plant_arm
        if controller is None or plant is None:
            raise UsageError("the run does not hold the arms that it was made with; it is no run of taut.run")
        return controller, plant

    @property
    def first_contact(self) -> float | None:
        """When something first acts on the tool, by the record [s]; None if nothing does."""
        touched = np.any(self.extra["F_ext"], axis=1) if "F_ext" in self.extra else np.zeros(1)
        return float(self.t[int(np.argmax(touched))]) if touched.any() else None

    def require_arm(self, arm: Arm) -> None:
        """Require that an arm has the joints of the run (UsageError, MatchError)."""
        instance_of("arm", arm, Arm, "an Arm from taut.load_arm")
        if arm.joint_names != self.joint_names:
            raise MatchError(
                f"arm '{arm.name}' does not have the joints of the run: {', '.join(arm.joint_names)} against "
                f"{', '.join(self.joint_names)}",
                name="arm",
            )

    def content(self) -> Content:
        """The description of the run that `taut.report` writes; UsageError if it has no two ticks."""
        from taut.record.report import content_of_run

        return content_of_run(self)

    def part(self, name: str) -> Run:
        """The run of one of the laws side by side: its joints, its terms, what it followed, its metrics.

        F_ext is in the part whose tool is the arm's.

        Raises:
            UsageError: The law was not `taut.SideBySide`.
            UnknownNameError: It has no such part.
        """
        from taut.record.parts import part_of

        return part_of(self, name)

    @property
    def phases(self) -> tuple[PhaseWindow, ...]:
        """The phases of a task, in the order in which they acted: name, start and end [s], what ended each.

        Raises:
            UsageError: The run is not one of a task.
        """
        from taut.record.parts import phases_of

        return phases_of(self)

    def phase(self, name: str, visit: int = 0) -> Run:
        """The run of one phase of a task: its ticks, what it followed, its metrics.

        Args:
            name: Of the phase; "stop" for what follows where the task has stopped.
            visit: Which time that it acted, from 0 on.

        Raises:
            UsageError: The run is not one of a task.
            UnknownNameError: It has no phase of that name.
            RangeError: The phase did not act that often.
        """
        from taut.record.parts import phase_of

        return phase_of(self, name, visit)

    def between(self, start: float, end: float) -> Run:
        """The ticks from time `start` to time `end` [s], both included: to plot, film or measure a stretch of a run.

        Raises:
            RangeError: Not start < end, or no tick between them.
        """
        first, last = np.searchsorted(
            self.t, [finite_scalar("start", start) - HALF, finite_scalar("end", end) + HALF]
        )
        if not start < end or first == last:
            span = f"{self.t[0]:g} to {self.t[-1]:g}" if len(self) else "no ticks"
            raise RangeError(f"the run has no ticks from {start:g} to {end:g} s; it has {span}", name="start")
        return self.ticks(slice(int(first), int(last)))

    def ticks(self, rows: slice) -> Run:
        """The ticks of a slice as a run."""
        fields = {name: getattr(self.reference, name)[rows] for name in type(self.reference).fields(self.n)}
        return dataclasses.replace(
            self,
            **{name: getattr(self, name)[rows] for name in ("t", "q", "v", "tau", "command")},
            terms={name: values[rows] for name, values in self.terms.items()},
            extra={name: values[rows] for name, values in self.extra.items()},
            reference=type(self.reference).of(fields),
        )

    def plot(self, *, joints: Iterable[str] | None = None) -> Figure:
        """Positions, tracking error, torque and its terms over time, as a matplotlib Figure (`figure.savefig`).

        Args:
            joints: Names; by default all, of more than eight those with the largest error.

        Raises:
            UnknownNameError: The run has no such joint.
        """
        from taut.record.run_plot import plot

        return plot(self, joints=joints)

    def video(
        self,
        path: str | os.PathLike[str],
        *,
        fps: int = 30,
        size: tuple[int, int] = (640, 480),
        speed: float = 1.0,
        camera: tuple[float, float] | None = None,
        arm: Arm | None = None,
    ) -> Path:
        """A film, rendered by MuJoCo, which needs OpenGL: EGL, OSMesa or a screen.

        It shows the arm, the scene of a MujocoPlant with what moves in it, and the surfaces that a RigidPlant's
        contacts and walls declare; a warning says what declares none. A log keeps them.

        Args:
            path: Where to (.gif).
            fps: Frames per second of the film.
            size: Width and height in pixels.
            speed: Speed of the film over that of the run [-].
            camera: Azimuth (from the x axis towards y) and elevation of the view [deg]; by default across
                the plane of an arm that moves in one, else from ahead and above.
            arm: The arm to draw; the plant's by default, of which a log has no meshes.

        Raises:
            FileError: Another suffix, no such folder.
            MissingExtraError: No OpenGL works here.
            UsageError: The run does not know its arm.
        """
        from taut.record.film import film

        return film(self, path, fps=fps, size=size, speed=speed, camera=camera, arm=arm)

    def arrays(self) -> dict[str, Float64Array]:
        """Everything by name: t, q, v, tau, command, terms.P, reference.q, extra.F_ext, ...; one row per tick."""
        fields = type(self.reference).fields(self.n)
        return {
            **{name: getattr(self, name) for name in ("t", "q", "v", "tau", "command")},
            **{f"terms.{name}": value for name, value in self.terms.items()},
            **{f"reference.{name}": getattr(self.reference, name) for name in fields},
            **{f"extra.{name}": value for name, value in self.extra.items()},
        }

    def to_csv(self, path: str | os.PathLike[str]) -> Path:
        """Write a table (.csv): a header of names such as q.elbow, then one line per tick that reads back exactly."""
        from taut.record.log.export import to_csv

        return to_csv(self, path)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write a log (.mcap) that common viewers open and `taut.load_run` reads back exactly."""
        from taut.record.log.writing import save

        return save(self, path)

    def __len__(self) -> int:
        return len(self.t)

    def __repr__(self) -> str:
        end = float(self.t[-1]) if len(self) else 0.0
        return f"Run({len(self)} ticks, {end:g} s, {count_of(self.n, 'joint')}, {self.outcome.kind})"
