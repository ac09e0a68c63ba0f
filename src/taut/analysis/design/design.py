"""taut.design: gains of a law from a specification, figures achieved by the sampled loop, and its limits."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import numpy as np

from taut.analysis.design.achieved import Achieved, Limit, Requirement, Steps, closed_loop_of
from taut.analysis.design.specification import Specification, place_poles, square
from taut.arm.description import Arm
from taut.arm.parts import TURN, require_few_turns, require_radians
from taut.base.checks import finite_array, instance_of, rate_in_hertz
from taut.base.declarations import REQUIRED
from taut.base.errors import RangeError, TautError, UsageError
from taut.base.plot_style import INK, SMALL, WIDTH, colour, prepared
from taut.base.result import Content, Result, Table
from taut.base.types import ArrayLike, Float64Array
from taut.control.gains import Gain
from taut.control.law import Law
from taut.control.sensing import Sensing
from taut.controller import Controller, compile
from taut.linear.judgement import judge
from taut.linear.linear_system import LinearSystem
from taut.linear.linearise import linearise
from taut.loop import Loop
from taut.maths.snapshot import snapshot
from taut.plant.actuation import Actuation
from taut.plant.environments.kinds import Push, Spring
from taut.plant.rigid import RigidPlant

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Design", "Limit", "Requirement", "design"]

Plants: TypeAlias = RigidPlant | Sequence[RigidPlant] | Mapping[str, RigidPlant]
HEIGHT: Final = 3.2  # [inch] of a picture
ANYWHERE: Final = 1e3  # [rad | m] from the reference: an equilibrium is taken wherever it is
DRIVE: Final = 1e4  # [rad/s] bandwidth of drives that are as good as ideal
ACCURATE: Final = 0.3  # [-] of a step of rk4 times the fastest rate in it: its error is below 1e-4
MAX_DESIGN_SUBSTEPS: Final = 50
UPPER: Final = ("settling", "overshoot")  # numbers that may be less than asked
PLACED: Final = (1.0, 0.8, 0.5)  # of settling time and overshoot asked for: what is tried in turn for several plants


@dataclass(frozen=True, kw_only=True, eq=False)
class Design(Result):
    """A law with its gains, specified and achieved figures of the sampled loop, and its limits.

    Args:
        law: The law with its gains.
        specification: The specified numbers.
        requirements: A row for each specified number, in each direction.
        limits: Of the loop.
        arm: Name of the arm.
        rate: [Hz].
        q: (n,) the pose [rad | m].
        system: The linear model of the sampled loop about its equilibrium.
        directions: Names of the directions.
        steps: Unit steps of the reference; None for an unstable loop.
        unstable: Why the loop is unstable; empty where it is stable.
        members: Of a design for several plants: that with each, by name. All other fields are of the worst of them.
    """

    law: Law
    specification: Specification
    requirements: tuple[Requirement, ...]
    limits: tuple[Limit, ...]
    arm: str
    rate: float
    q: Float64Array
    system: LinearSystem
    directions: tuple[str, ...]
    steps: Steps | None
    unstable: str
    members: Mapping[str, Design] = field(default_factory=dict)

    @property
    def stable(self) -> bool:
        """Whether the sampled loop is stable, with each plant."""
        return not self.unstable

    @property
    def met(self) -> bool:
        """Whether the loop is stable and meets the specification, with each plant."""
        return self.stable and all(each.met for each in self.requirements)

    @property
    def _badness(self) -> tuple[bool, bool, float]:
        """Larger for a worse loop: unstable ones, then what misses its specification, then by the largest excess."""
        return not self.stable, not self.met, max((_excess(each) for each in self.requirements), default=0.0)

    def got(self, name: str) -> Float64Array:
        """Achieved values of a specified number, in each direction."""
        return np.array([each.got for each in self.requirements if each.name == name])

    def limit(self, name: str) -> Limit:
        """The limit of a name, the smallest of all directions; KeyError if there is none."""
        found = [each for each in self.limits if each.name == name]
        if not found:
            raise KeyError(name)
        return min(found, key=lambda each: each.value)

    def content(self) -> Content:
        """The description of the design."""
        missed = [each for each in self.requirements if not each.met]
        faults = [self.unstable] if self.unstable else []
        for name in dict.fromkeys(each.name for each in missed if self.stable):
            rows = [each for each in missed if each.name == name]
            places = ", ".join(dict.fromkeys(f"{each.direction} ({each.got:.4g})" for each in rows))
            faults.append(f"{name} is missed: {places}; asked for {rows[0].asked:.4g} {rows[0].unit}".rstrip())
        asked = Table(
            title="asked and got",
            columns=("number", "direction", "unit", "asked", "got", "met"),
            rows=[
                (each.name, each.direction, each.unit, each.asked, each.got, each.met) for each in self.requirements
            ],
            note="by the linear model of the sampled loop about its equilibrium; met: within 5 %, "
            "a stiffness within 1 %; a settling time or an overshoot may be less, an overshoot 1 % of the step more",
        )
        limits = Table(
            title="limits",
            columns=("limit", "of", "value", "unit"),
            rows=[
                (each.name, each.where, "over a turn" if _beyond_turn(each) else each.value, each.unit)
                for each in self.limits
            ],
        )
        gains = Table(
            title="gains",
            columns=("gain", "value"),
            rows=[
                (f"{path}[{i}]" if np.ndim(value) == 2 else path, ", ".join(f"{x:.5g}" for x in np.atleast_1d(row)))
                for path, value in self.law.parameters().items()
                for i, row in enumerate(np.asarray(value) if np.ndim(value) == 2 else [value])
            ],
        )
        members = Table(
            title="plants, the worst of which is described here",
            columns=("plant", "stable", "met", "worst number", "direction", "asked", "got"),
            rows=[(name, each.stable, each.met, *_worst_row(each)) for name, each in self.members.items()],
        )
        words = ", ".join(
            f"{name} = {np.asarray(value).tolist()}" for name, value in self.specification.given.items()
        )
        return Content(
            title=f"{type(self.law).__name__} on {self.arm} at {self.rate:g} Hz, for {words}",
            faults=faults,
            summary=[f"pose [rad | m]: {np.round(self.q, 4).tolist()}"],
            tables=[gains, *([members] if self.members else []), asked, *([limits] if self.limits else [])],
            figures={} if self.steps is None else {"steps": self._steps},
            settings={"pose": str(np.round(self.q, 4).tolist()), "rate [Hz]": f"{self.rate:g}"},
        )

    def json(self) -> dict[str, Any]:
        """The result as plain data, with the gains by path."""
        gains = {path: np.asarray(value).tolist() for path, value in self.law.parameters().items()}
        return {**super().json(), "met": self.met, "stable": self.stable, "gains": gains}

    def _steps(self) -> Figure:
        """The error of a unit step in each direction, and the largest command that it takes of a joint."""
        from matplotlib.figure import Figure

        steps = self.steps
        assert steps is not None
        figure = Figure(figsize=(WIDTH, HEIGHT), layout="constrained")
        left, right = figure.subplots(1, 2)
        prepared(left, f"{type(self.law).__name__} on {self.arm}: error after a step", "e / e(0)", "t [s]")
        units = " | ".join(dict.fromkeys(steps.units))
        prepared(right, "command of a unit step, largest joint", f"[{units}]", "t [s]")
        for i, name in enumerate(self.directions):
            left.plot(steps.t, steps.e[:, i], color=colour(i), linewidth=1.3, label=name)
            command = np.abs(steps.command[:, :, i]).max(axis=1)
            right.plot(steps.t, command, color=colour(i), linewidth=1.3)
        left.axhspan(-0.02, 0.02, color=INK, alpha=0.08, linewidth=0.0)
        left.legend(fontsize=SMALL, frameon=False, labelcolor=INK)
        return figure


def _excess(each: Requirement) -> float:
    """By what fraction a number is worse than asked; negative where it is better."""
    if not math.isfinite(each.got):
        return math.inf
    if each.name in UPPER:
        return (each.got - each.asked) / max(each.asked, 1.0 if each.name == "overshoot" else 0.0)
    return 0.0 if min(each.asked, 1.0) <= each.got <= each.asked else abs(each.got / each.asked - 1.0)


def _worst_row(found: Design) -> tuple[str, str, float, float]:
    worst = max(found.requirements, key=_excess)
    return worst.name, worst.direction, worst.asked, worst.got


def _beyond_turn(limit: Limit) -> bool:
    """Whether it is a step of more than a turn, where the linear model means nothing."""
    return limit.name == "largest step" and limit.unit == "rad" and TURN < limit.value < np.inf


def design(
    law: type[Law] | Law,
    arm: Arm,
    *,
    at: ArrayLike | None = None,
    zeta: float | None = None,
    overshoot: float | None = None,
    omega_n: ArrayLike | None = None,
    settling: ArrayLike | None = None,
    K: ArrayLike | None = None,
    contact: ArrayLike | None = None,
    force: float | None = None,
    integral: float = 0.0,
    coupled: bool = False,
    rate: float = 1000.0,
    sensing: Sensing | None = None,
    plant: Plants | None = None,
) -> Design:
    """Gains of a law by pole placement in the error dynamics that it states, and the figures that they achieve.

    Law:          K = omega_n inertia omega_n, or the stiffness as it is asked for; D = 2 zeta (inertia K)^(1/2): the
                  same damping ratio in every mode; ki = integral kd kp / M
                  of one pole D = inertia omega_n; of a force kfi = (1 + kfp) force
    Closed loop:  that of the law's own docstring, as its `closed_loop` states it; got is that of the linear model of
                  the sampled loop about its equilibrium, with zero-order hold, weight, delay and filters

    Ask for a damping (zeta or overshoot; zeta=1 is critical) and a speed (omega_n or settling), or a stiffness K. A
    loop that misses its specification, or is unstable, has met=False.

    Args:
        law: A class of laws; or a law whose gains are replaced, and whose other options stay.
        arm: The arm that the law knows.
        at: (n,) the pose [rad | m]; home if left out.
        zeta: Damping ratio of every mode.
        overshoot: Of a step [%], in place of zeta.
        omega_n: Natural frequency, or single pole [rad/s]: one, one for each joint, or (linear, angular) at the tool.
        settling: Exact 2 % settling time of a step [s], likewise.
        K: Stiffness: (linear, angular), (6,) or (6, 6) at the tool [N/m, N m/rad]; of joints a number or (n,).
        contact: Stiffness of what a law of force presses on, likewise.
        force: Pole of the force of `ForceControl` and `HybridMotionForce` [1/s].
        integral: ki as a fraction of its stability limit kd kp / M; the rest is asked of the loop without it.
        coupled: Matrices for the gains of PID and GravityPID, like M, so that all modes are alike.
        rate: [Hz].
        sensing: Filters, of the velocity say; none if left out.
        plant: Plant of the linear model, with its delays, springs and sensors; if left out a rigid one without
            friction under an exact zero-order hold, with nearly ideal drives where the law commands drives. Several,
            in a list or by name: the gains are placed for the arm and for that of each plant, also for 80 % and 50 %
            of the settling time and overshoot asked for; each choice is judged with all plants, and the first that
            meets the specification with each is taken, else the one whose worst plant is best.

    Raises:
        UsageError: A specification that does not fit the law; a law that states no closed loop.
        RangeError: A number out of range; a singular pose; a loop without an equilibrium.

    Example:
        >>> import taut
        >>> arm = taut.load_arm("one_joint")
        >>> d = taut.design(taut.laws.PID, arm, zeta=1.0, omega_n=10.0)
        >>> d.law
        PID(kp=[50.0], kd=[10.0], ki=[0.0])
        >>> d.met, d.got("zeta").round(3).tolist()
        (True, [1.002])

    References:
        Chapter, sections 10.2.1.1 to 10.2.1.5, 10.2.2, 10.3 and 10.5. Sampled loops: Astrom and Wittenmark,
        Computer-controlled systems (1997).
    """
    specification = Specification(
        zeta=zeta, overshoot=overshoot, omega_n=omega_n, settling=settling, K=K, contact=contact, force=force,
        integral=integral,
    )  # fmt: skip
    plants = _plants(plant)
    q, rate = pose_of(arm, at), rate_in_hertz(rate)
    given = law if isinstance(law, Law) else with_any_gains(law)
    stated = closed_loop_of(given, snapshot(arm, q))
    specification.check_fit(type(given).__name__, stated)
    if coupled and not stated.decentralised:
        raise UsageError(
            f"coupled=True is for PID and GravityPID; leave it out for {type(given).__name__}", name="coupled"
        )

    def judged(made: Law) -> Iterator[tuple[str, Design]]:
        for name, each in plants.items():
            yield name, _judged(made, arm, q, specification, rate, sensing, each)

    best = dict(judged(place_poles(stated, specification, coupled=coupled)))
    if len(plants) == 1:
        return next(iter(best.values()))
    models = [stated, *(closed_loop_of(given, snapshot(each.arm, q)) for each in plants.values() if each is not None)]
    upper = {name: specification.given[name] for name in UPPER if name in specification.given}
    for fraction, model in itertools.product(PLACED if upper else PLACED[:1], models):
        if all(each.met for each in best.values()):
            break
        placed = replace(specification, **{name: fraction * np.asarray(value) for name, value in upper.items()})
        worst, members = max(each._badness for each in best.values()), dict[str, Design]()
        for name, each in judged(place_poles(model, placed, coupled=coupled)):
            members[name] = each
            if each._badness >= worst:
                break
        else:
            best = members
    return replace(max(best.values(), key=lambda each: each._badness), members=best)


def _plants(plant: Plants | None) -> dict[str, RigidPlant | None]:
    """Plants by name; those without are numbered."""
    if plant is None or isinstance(plant, RigidPlant):
        return {"plant": plant}
    if not isinstance(plant, (list, tuple, Mapping)) or not plant:
        raise UsageError(
            f"plant must be a taut.RigidPlant, or several in a list or by name; got {plant!r}", name="plant"
        )
    named = plant if isinstance(plant, Mapping) else {f"plant {i}": each for i, each in enumerate(plant)}
    for name, each in named.items():
        instance_of(f"plant '{name}'", each, RigidPlant, "a taut.RigidPlant")
    return dict(named)


def _judged(
    made: Law,
    arm: Arm,
    q: Float64Array,
    specification: Specification,
    rate: float,
    sensing: Sensing | None,
    plant: RigidPlant | None,
) -> Design:
    """The design of a law with its gains: what it achieves with a plant."""
    moving = closed_loop_of(made, snapshot(arm, q)).alone or made
    ctrl = compile(moving, arm, rate=rate, sensing=sensing, adds=() if plant is None else plant.adds)
    loop = Loop(ctrl, plant_for(ctrl, specification) if plant is None else plant, duration=1.0)
    found = Achieved(law=made, loop=loop, system=linearise(loop, at=q, within=ANYWHERE), specification=specification)
    stable = found.system.stable
    unstable, limits = ("", list(found.limits())) if stable else blamed(loop, q, found.system)
    return Design(
        law=made,
        specification=specification,
        requirements=tuple(found.requirements()),
        limits=tuple(limits),
        arm=arm.name,
        rate=rate,
        q=q,
        system=found.system,
        directions=tuple(found.stated.directions),
        steps=found.steps if stable else None,
        unstable=unstable,
    )


def with_any_gains(law: type[Law]) -> Law:
    """A law of a class that needs gains alone, with gains that are to be replaced."""
    if not isinstance(law, type) or not issubclass(law, Law):
        raise UsageError(f"design takes a law of taut.laws, or its class; got {law!r}", name="law")
    gains: dict[str, Any] = {}
    for name, each in law.declared.items():
        required = each.default is REQUIRED
        if isinstance(each, Gain) and (required or name == "zeta"):
            gains[name] = (1.0, 1.0) if "pair" in each.accepts and "scalar" not in each.accepts else 1.0
        elif required:
            raise UsageError(
                f"{law.__name__} needs {name}; give a law, whose gains are replaced: "
                f"taut.design(taut.laws.{law.__name__}({name}=..., ...), arm, ...)",
                name="law",
            )
    return law(**gains)


def pose_of(arm: Arm, at: ArrayLike | None) -> Float64Array:
    """(n,) the pose to design for [rad | m]; home if left out."""
    instance_of("arm", arm, Arm, "an Arm from taut.load_arm")
    q = arm.home if at is None else finite_array("at", at, shape=(arm.n,), joints=arm.joint_names, unit="rad | m")
    require_radians("at", q, arm)
    require_few_turns("at", q, arm.joints)
    outside = np.flatnonzero((q < arm.lower) | (q > arm.upper))
    if outside.size:
        i = int(outside[0])
        raise RangeError(
            f"at must be within the limits of the joints; got {q[i]:g} for '{arm.joint_names[i]}', which goes "
            f"from {arm.lower[i]:g} to {arm.upper[i]:g} {arm.units[i]}",
            name="at",
            joint=arm.joint_names[i],
            value=float(q[i]),
            rule="within the limits",
        )
    return np.array(q)


def plant_for(ctrl: Controller, specification: Specification) -> RigidPlant:
    """The arm without friction, moving exactly under the zero-order hold, with the contact that is specified."""
    arm, kind, x = ctrl.side.arm, ctrl.side.probe.kind, snapshot(ctrl.side.arm, ctrl.side.arm.home)
    environment: Push | Spring | None = None
    stiffness = np.zeros((6, 6))
    if specification.contact is not None:
        stiffness = square("contact", specification.contact, closed_loop_of(ctrl.side.single_law, x))
        environment = Spring(stiffness=stiffness)
    elif "F_ext" in ctrl.needs:
        environment = Push(peak=np.zeros(6), duration=1.0)
    if ctrl.kind == "mit":
        return RigidPlant(
            arm, friction=None, environment=environment, integrator="rk4", takes="mit", substeps=MAX_DESIGN_SUBSTEPS
        )
    if kind != "torque":
        return RigidPlant(
            arm,
            takes=kind,  # type: ignore[arg-type]  # the kinds of commands are those of plants
            actuation=Actuation(bandwidth=DRIVE),
            environment=environment,
        )
    J = np.asarray(x.J())
    squares = np.linalg.eigvals(np.linalg.solve(np.asarray(x.M), J.T @ stiffness @ J))
    substeps = math.ceil(math.sqrt(float(np.abs(squares).max())) / (ACCURATE * ctrl.rate))
    return RigidPlant(
        arm, friction=None, environment=environment, integrator="rk4",
        substeps=min(max(substeps, 1), MAX_DESIGN_SUBSTEPS),
    )  # fmt: skip


def blamed(loop: Loop, q: Float64Array, system: LinearSystem) -> tuple[str, list[Limit]]:
    """Why a loop is unstable, and the largest factors on single gains with which it would be stable."""
    try:
        found = judge(loop, at=q)
    except TautError:  # no equilibrium near the reference
        return system.unstable_because, []
    factors = [Limit(name="largest factor", value=x, unit="-", where=path) for path, x in found.largest.items()]
    return system.unstable_because if found.stable else found.message, factors
