"""Scenario: an experiment in one TOML file. Code never comes from a scenario: files name built-ins only."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, Final

import numpy as np

from taut.apps.toml import Section, read_toml
from taut.arm.builtin import one_joint
from taut.arm.description import Arm
from taut.arm.load import load_arm
from taut.base.errors import unknown_name
from taut.base.pose import Pose
from taut.base.types import ArrayLike
from taut.control import laws as all_laws
from taut.control.gains import Memory
from taut.control.law import Law
from taut.control.limits import Limits
from taut.control.reference import Hold, JointMotion, Reference
from taut.control.sensing import VELOCITIES, Sensing
from taut.control.trajectory import Cubic, JerkLimited, Quintic, Samples, Sine, Spline, Trapezoidal
from taut.plant.rigid import RigidPlant
from taut.plant.stages import Actuation, Sensors
from taut.runtime.events import Event
from taut.runtime.host import HostPlant

__all__ = ["Outputs", "PassFigure", "Scenario", "built_in_scenarios", "load_scenario"]

TRAJECTORIES: Final = {
    "cubic": Cubic,
    "jerk-limited": JerkLimited,
    "quintic": Quintic,
    "samples": Samples,
    "sine": Sine,
    "spline": Spline,
    "trapezoidal": Trapezoidal,
}
POSITIONS: Final = ("q", "q0", "q1", "center", "points")  # fields that may be given relative to home


@dataclass(frozen=True, kw_only=True)
class Outputs:
    """Files that a scenario makes; None for those that it does not make."""

    plot: str | None
    video: str | None
    log: str | None
    csv: str | None
    shown: str  # the law whose video, log and table are made


@dataclass(frozen=True, kw_only=True)
class PassFigure:
    """A bound on a metric that decides whether a scenario passes."""

    law: str
    metric: str
    least: float
    most: float


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """An experiment: laws for one arm, against one plant, along one reference."""

    name: str
    title: str
    arm: Arm
    laws: Mapping[str, Law]
    rate: float
    sensing: Sensing
    limits: Limits | None
    make_plant: Callable[[], RigidPlant | HostPlant]
    reference: Reference
    duration: float
    q0: ArrayLike | None
    v0: ArrayLike | None
    seed: int
    events: tuple[Event, ...]
    outputs: Outputs
    figures: tuple[PassFigure, ...]


def built_in_scenarios() -> dict[str, Path]:
    """The scenarios that come with taut, by name."""
    folder = resources.files("taut.apps") / "scenarios"
    found = [Path(str(item)) for item in folder.iterdir() if item.name.endswith(".toml")]
    return {path.stem: path for path in sorted(found)}


def load_scenario(name: str, replace_laws: Mapping[str, Law] | None = None) -> Scenario:
    """A scenario by the name of a built-in one, or by the path of a file.

    Args:
        name: Name or path.
        replace_laws: Laws that take the place of the scenario's own.

    Raises:
        ScenarioError: The file breaks the schema; the message names file, section and key.
        FileError: It cannot be read.
        UnknownNameError: There is no such scenario.
    """
    known = built_in_scenarios()
    if name in known:
        path = known[name]
    elif name.endswith(".toml") or "/" in name or "\\" in name:
        path = Path(name)
    else:
        raise unknown_name("taut", "scenario", name, known, hint="or give the path of a .toml file")
    root = read_toml(path, f"scenario '{name}'")
    title = root.text("title", path.stem)
    arm = _arm(root.section("arm", required=True))
    laws = dict(replace_laws) if replace_laws else _laws(root.section("laws", required=True))
    if replace_laws:
        root.take("laws", None)
    control = root.section("control")
    rate = control.number("rate", 1000.0)
    sensing = Sensing(velocity=control.word("velocity", VELOCITIES, "measured"))
    limits = _limits(control, arm)
    control.done()
    make_plant, plant_arm = _plant(root.section("plant", required=True), arm, path.parent)
    reference = _reference(root.section("reference"), plant_arm, path.parent)
    run = root.section("run", required=True)
    duration, seed = run.number("duration"), run.whole("seed", 0)
    q0, v0 = _state(run, "q0", plant_arm), _state(run, "v0", plant_arm)
    run.done()
    events = tuple(_event(section) for section in root.sections("event"))
    outputs = _outputs(root.section("outputs"), laws)
    figures = tuple(_figure(section, laws, replaced=bool(replace_laws)) for section in root.sections("pass"))
    root.done()
    return Scenario(
        name=path.stem,
        title=title,
        arm=arm,
        laws=laws,
        rate=rate,
        sensing=sensing,
        limits=limits,
        make_plant=make_plant,
        reference=reference,
        duration=duration,
        q0=q0,
        v0=v0,
        seed=seed,
        events=events,
        outputs=outputs,
        figures=figures,
    )


# -------------------------------------------------------------------- arm


def _arm(section: Section, base: Arm | None = None) -> Arm:
    """[arm], or the part of [plant] that says how the true arm differs."""
    with section.blamed():
        if base is None:
            model = section.text("model")
            arm = load_arm(
                model,
                tool=section.text("tool", None),
                T_WB=_pose(section.section("T_WB")) if "T_WB" in section else None,
                locked=section.take("locked", None),
                joints=section.take("joints", None),
                home=section.take("home", None),
                gravity=section.numbers("gravity", None),
            )
            if "link" in section:
                arm = _one_joint(section, model)
        else:
            arm = load_arm(section.text("model")) if "model" in section else base
        arm = _changed(section, arm)
        if base is None:
            section.done()
        return arm


def _one_joint(section: Section, model: str) -> Arm:
    """The chapter's link with other numbers: link = { M, m, r, b }."""
    if model != "one_joint":
        raise section.error(f"link is for the model 'one_joint'; got model '{model}'")
    numbers = section.section("link")
    arm = one_joint(**{word: numbers.number(word) for word in ("M", "m", "r", "b") if word in numbers})
    numbers.done()
    return arm


def _changed(section: Section, arm: Arm) -> Arm:
    """The arm with the changes that a section states."""
    if "bodies" in section:
        bodies = section.section("bodies")
        for joint in bodies.left:
            body = bodies.section(joint)
            arm = arm.with_body(
                joint,
                mass=body.number("mass", None),
                com=body.numbers("com", None),
                inertia=body.numbers("inertia", None),
            )
            body.done()
    if "perturbed" in section:
        change = section.section("perturbed")
        arm = arm.perturbed(
            seed=change.whole("seed"),
            **{word: change.number(word, 0.0) for word in ("mass", "com", "inertia", "friction")},
        )
        change.done()
    if "joint_values" in section:
        values = section.section("joint_values")
        arm = arm.with_joints(**{key: values.take(key) for key in values.left})
    if "payload" in section:
        load = section.section("payload")
        arm = arm.with_payload(
            load.number("mass"), load.numbers("com", [0.0, 0.0, 0.0]), load.numbers("inertia", [0.0] * 6)
        )
        load.done()
    return arm


def _pose(section: Section) -> Pose:
    with section.blamed():
        rotation = {word: section.numbers(word) for word in ("xyzw", "wxyz", "rpy", "R") if word in section}
        pose = Pose(section.numbers("p", [0.0, 0.0, 0.0]), **rotation)
        section.done()
        return pose


# -------------------------------------------------------------------- laws and control


def _laws(section: Section) -> dict[str, Law]:
    labels = section.left
    if not labels:
        raise section.error("needs one law at least: [laws.PID] with law = 'PID' and its gains")
    return {label: _law(section.section(label)) for label in labels}


def _law(section: Section) -> Law:
    """law = "PID" with its gains, or law = ["FeedForward", "PID"] with a table of gains for each."""
    name = section.take("law")
    names = name if isinstance(name, list) else [name]
    total: Law | None = None
    for part in names:
        gains = section.section(part) if isinstance(name, list) else section
        with gains.blamed():
            law = _one_law(gains, part)
        total = law if total is None else total + law
        gains.done()
    section.done()
    if total is None:
        raise section.error("law must name one law at least; got an empty array")
    return total


def _one_law(section: Section, name: object) -> Law:
    known = [word for word in all_laws.__all__ if word != "Sum"]
    if not isinstance(name, str) or name not in known:
        raise section.error(str(unknown_name("taut.laws", "law", str(name), known)))
    cls = getattr(all_laws, name)
    fields = [f.name for f in dataclasses.fields(cls) if not isinstance(cls.__dict__.get(f.name), Memory)]
    values = {word: section.take(word) for word in fields if word in section}
    for word in fields:
        section.take(word, None)  # known, so that a misspelt one is compared with it
    law: Law = cls(**values)
    return law


def _limits(section: Section, arm: Arm) -> Limits | None:
    """limits = "arm", "arm with rate", "none", or a table { tau, tau_dot }."""
    with section.blamed():
        if section.is_table("limits"):
            table = section.section("limits")
            made = Limits(tau=table.numbers("tau", None), tau_dot=table.numbers("tau_dot", None))
            table.done()
            return made
        word = section.word("limits", ("none", "arm", "arm with rate"), "none")
        return None if word == "none" else Limits.of(arm, rate=word == "arm with rate")


# -------------------------------------------------------------------- plant


def _plant(section: Section, arm: Arm, folder: Path) -> tuple[Callable[[], RigidPlant | HostPlant], Arm]:
    kind = section.word("kind", ("rigid", "mujoco"), "rigid")
    true_arm = _arm(section, arm)
    friction = None if section.word("friction", ("arm", "none"), "arm") == "none" else "arm"
    options: dict[str, Any] = {"friction": friction, "adds": tuple(section.take("adds", []))}
    with section.blamed():
        if kind == "rigid":
            options |= {word: section.text(word) for word in ("integrator", "takes") if word in section}
            if "substeps" in section:
                options["substeps"] = section.whole("substeps")
            for word, cls in (("sensors", Sensors), ("actuation", Actuation)):
                if word in section:
                    options[word] = _made(section.section(word), cls)
            plant = RigidPlant(true_arm, **options)
            section.done()
            return lambda: plant, true_arm
        from taut.runtime.drivers.mujoco import MujocoPlant

        if "timestep" in section:
            options["timestep"] = section.number("timestep")
        if "scene" in section:
            options["scene"] = folder / section.text("scene")
        section.done()
        return lambda: MujocoPlant(true_arm, **options), true_arm


def _made(section: Section, cls: Any) -> Any:
    """An object of a dataclass from the keys of a section."""
    with section.blamed():
        names = [field.name for field in dataclasses.fields(cls)]
        values = {name: section.take(name) for name in names if name in section}
        for name in names:
            section.take(name, None)
        section.done()
        return cls(**values)


# -------------------------------------------------------------------- reference, state, events


def _reference(section: Section, arm: Arm, folder: Path) -> Reference:
    """A set-point, a hold, or a trajectory."""
    if not section.left:
        return Hold()
    kind = section.word("kind", ("hold", "set-point", *TRAJECTORIES))
    relative = section.flag("relative_to_home", False)
    with section.blamed():
        if kind == "hold":
            section.done()
            return Hold()
        if kind == "samples" and "file" in section:
            made: Any = Samples.from_csv(folder / section.text("file"))
            section.done()
            return made  # type: ignore[no-any-return]  # a trajectory
        cls: Any = JointMotion if kind == "set-point" else TRAJECTORIES[kind]
        names = ("q", "v", "a") if kind == "set-point" else [field.name for field in dataclasses.fields(cls)]
        values: dict[str, Any] = {}
        for name in names:
            if name not in section:
                section.take(name, None)
                continue
            value = section.take(name)
            if value == "home":
                value = arm.home
            elif name in POSITIONS and relative:
                value = arm.home + np.asarray(value, dtype=np.float64)
            values[name] = value
        section.done()
        try:
            return cls(**values)  # type: ignore[no-any-return]  # a sample or a trajectory
        except TypeError as cause:
            raise section.error(f"{kind}: {cause}") from cause


def _state(section: Section, key: str, arm: Arm) -> ArrayLike | None:
    value = section.take(key, None)
    return arm.home if value == "home" else value


def _event(section: Section) -> Event:
    with section.blamed():
        event = Event(t=section.number("t"), set=section.take("set"))
        section.done()
        return event


# -------------------------------------------------------------------- outputs and pass figures


def _outputs(section: Section, laws: Mapping[str, Law]) -> Outputs:
    shown = section.text("shown", list(laws)[-1])
    if shown not in laws and len(laws) > 1:
        raise section.error(
            f"shown must be one of the laws {', '.join(repr(label) for label in laws)}; got {shown!r}"
        )
    files = {}
    for word, suffixes in (
        ("plot", (".png", ".pdf", ".svg")),
        ("video", (".gif", ".mp4")),
        ("log", (".mcap",)),
        ("csv", (".csv",)),
    ):
        name = section.text(word, None)
        if name is not None and (Path(name).name != name or not name.endswith(suffixes)):
            raise section.error(f"{word} must be a file name ending in {' or '.join(suffixes)}; got {name!r}")
        files[word] = name
    section.done()
    return Outputs(shown=shown if shown in laws else next(iter(laws)), **files)


def _figure(section: Section, laws: Mapping[str, Law], *, replaced: bool) -> PassFigure:
    label = section.text("law")
    if label not in laws and not replaced:
        raise section.error(f"law must be one of {', '.join(repr(name) for name in laws)}; got {label!r}")
    figure = PassFigure(
        law=label,
        metric=section.text("metric"),
        least=float(section.number("min", -np.inf)),
        most=float(section.number("max", np.inf)),
    )
    if np.isinf(figure.least) and np.isinf(figure.most):
        raise section.error("needs min, max or both")
    section.done()
    return figure
