"""The entries of `run.info`: their keys, and the plain values that tell what a run was made with."""

from __future__ import annotations

import dataclasses
import functools
import inspect
import json
import platform
from collections.abc import Iterator, Mapping
from importlib import metadata
from typing import Any, Final

import numpy as np

from taut.arm.description import BASE, Arm, Body, Frame, Joint, Payload
from taut.base.errors import TautError
from taut.base.types import Float64Array
from taut.maths.adds import Adds
from taut.trace.pose import Pose

__all__ = [
    "AROUND",
    "DYNAMICS",
    "IMPEDANCE",
    "LIMITS",
    "OPTIONS",
    "PARTS",
    "PHASES",
    "SCENARIO",
    "TOOL",
    "VERSIONS",
    "arm_from_json",
    "arm_json",
    "differences",
    "plant_options",
    "stated",
    "versions",
]

# Beside these, info has by their own names: rate [Hz], duration [s], seed, law, arm, plant and sensing as texts,
# command_limits, parameters by path, events, stability.
TOOL: Final = "tool"  # the chain of joints that carries the frame that the law controls
IMPEDANCE: Final = "impedance"  # what the law promises at the tool where F_ext is measured
LIMITS: Final = "limits"  # of the arm: by kind and joint
PARTS: Final = "parts"  # of laws side by side: joints, tool and impedance of each
PHASES: Final = "phases"  # of a task: by name, what each phase follows, and its tool
AROUND: Final = "around"  # the things that stand around the arm, to draw
SCENARIO: Final = "scenario"  # name, law, case and text of the scenario that it is a run of
VERSIONS: Final = "versions"  # of the programs that made the run
DYNAMICS: Final = "dynamics"  # the arms of controller and plant as plain values
OPTIONS: Final = "plant_options"  # what the plant was made with beside its arm

DRAWN: Final = ("visuals", "source", "notes")  # what no motion depends on
NAMES: Final = ("name", "home", "links")  # nor on these, once a run has begun
WHOLE: Final = ("placement", "T_WB", "payload")  # of which the parts are not named
WORDS: Final = ("name", "kind", "parent", "placement", "axis")  # of a joint, all others being numbers
KINDS: Final = ("revolute", "continuous", "prismatic")
PACKAGES: Final = ("numpy", "llvmlite", "mujoco")
TEXTS: Final = ("scene",)  # options whose words may name a file


def arm_json(arm: Arm) -> dict[str, Any]:
    """All of an arm but what is drawn of it, as plain values; of its parts what is as usual is left out."""
    return {part.name: _plain(getattr(arm, part.name)) for part in dataclasses.fields(arm) if part.name not in DRAWN}


def _plain(x: Any) -> Any:
    if isinstance(x, Pose):
        return {"p": x.p.tolist(), "R": x.R.tolist()}
    if isinstance(x, np.ndarray):
        return x.tolist()
    if isinstance(x, (tuple, list)):
        return [_plain(item) for item in x]
    if dataclasses.is_dataclass(x):
        values = {part.name: getattr(x, part.name) for part in dataclasses.fields(x)}
        usual = {part.name: part.default for part in dataclasses.fields(x)}
        return {name: _plain(y) for name, y in values.items() if isinstance(y, np.ndarray) or y != usual[name]}
    return x


def arm_from_json(values: Mapping[str, Any]) -> Arm | None:
    """The arm of `arm_json`, the same object each time; None where the values are not those of an arm.

    Example:
        >>> from taut import load_arm
        >>> arm = load_arm("planar2").with_gravity([0.0, 0.0, 0.0])
        >>> arm_from_json(arm_json(arm)).gravity.tolist()
        [0.0, 0.0, 0.0]
    """
    return _of_text(json.dumps(values))


@functools.lru_cache(maxsize=16)
def _of_text(text: str) -> Arm | None:
    values = json.loads(text)
    try:
        bodies = tuple(
            Body(
                mass=float(v["mass"]),
                com=_array(v["com"], 3),
                inertia=_array(v["inertia"], 3, 3),
                links=tuple(map(str, v.get("links", ()))),
            )
            for v in values["bodies"]
        )
        n = len(bodies)
        arm = Arm(
            name=str(values["name"]),
            joints=tuple(_joint(v, i) for i, v in enumerate(values["joints"])),
            bodies=bodies,
            frames=tuple(
                Frame(name=str(v["name"]), body=_index(v["body"], n), placement=_pose(v["placement"]))
                for v in values["frames"]
            ),
            tool=str(values["tool"]),
            home=_array(values["home"], n),
            gravity=_array(values["gravity"], 3),
            T_WB=_pose(values["T_WB"]),
            payload=Payload(**values["payload"]),
            commands=tuple(values["commands"]),
        )
        return arm if arm.n == n and arm.tool in arm.frame_names else None
    except (TautError, KeyError, TypeError, ValueError, AttributeError, OverflowError):
        return None


def _joint(values: Mapping[str, Any], i: int) -> Joint:
    known: dict[str, Any] = {name: x if x is None else float(x) for name, x in values.items() if name not in WORDS}
    if values["kind"] not in KINDS:
        raise ValueError(values["kind"])
    return Joint(
        name=str(values["name"]),
        kind=values["kind"],
        parent=_index(values["parent"], i),
        placement=_pose(values["placement"]),
        axis=_array(values["axis"], 3),
        **known,
    )


def _index(value: Any, most: int) -> int:
    """Of a joint before another, or of the base."""
    if type(value) is not int or not BASE <= value < most:
        raise ValueError(value)
    return value


def _array(values: Any, *shape: int) -> Float64Array:
    found = np.array(values, dtype=np.float64).reshape(shape)
    if not np.isfinite(found).all():
        raise ValueError(values)
    return found


def _pose(values: Mapping[str, Any]) -> Pose:
    """Exactly as it was: not normalised anew."""
    return Pose.of(_array(values["R"], 3, 3), _array(values["p"], 3))


def differences(one: Mapping[str, Any], other: Mapping[str, Any]) -> tuple[str, ...]:
    """In what two arms differ, of `arm_json`: the names of the numbers, such as gear, mass, axis."""
    return tuple(dict.fromkeys(name for name in _different(one, other) if name not in NAMES))


def _different(one: Any, other: Any, name: str = "") -> Iterator[str]:
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        for key in {**one, **other}:
            yield from _different(one.get(key), other.get(key), name if name in WHOLE else key)
    elif isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        for a, b in zip(one, other, strict=True):
            yield from _different(a, b, name)
    elif one != other:
        yield name


def plant_options(plant: object) -> dict[str, Any]:
    """What a plant was given beside its arm, where it is not the default.

    Args:
        plant: A plant that is a dataclass, or has the arguments that it was made with as `given`.

    Returns:
        "options", those that are numbers, words or components that it adds, by name; "others", the names of those
        that are more than that. Both are None of a plant of which they are not known.
    """
    kind = type(plant)
    parts = {part.name: part for part in dataclasses.fields(plant)} if dataclasses.is_dataclass(plant) else {}
    given: Mapping[str, Any] | None = getattr(plant, "given", None) or {name: getattr(plant, name) for name in parts}
    if not given:
        return {"options": None, "others": None}
    usual = {name: each.default for name, each in inspect.signature(kind).parameters.items()}
    options: dict[str, Any] = {}
    others: list[str] = []
    for name, value in given.items():
        factory = parts[name].default_factory if name in parts else dataclasses.MISSING
        default = usual.get(name) if factory is dataclasses.MISSING else factory()
        if name == "arm" or (type(value) is type(default) and stated(value) == stated(default)):
            continue
        if name == "adds" and Adds.of(value).load is None:
            options |= {name: list(Adds.of(value).names)} if Adds.of(value).names else {}
        elif value is None or (isinstance(value, (bool, int, float, str)) and name not in TEXTS):
            options[name] = value
        else:
            others.append(name)
    return {"options": options, "others": others}


@functools.cache
def versions() -> Mapping[str, str]:
    """The versions of taut and of what it computes with, and the kind of machine."""
    from taut.base.version import __version__

    found = {"taut": __version__}
    for package in PACKAGES:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            found[package] = "not installed"
    found["Python"] = platform.python_version()
    found["platform"] = f"{platform.system()} {platform.machine()}"
    return found


def stated(x: object) -> str:
    """What a frozen dataclass states, in one line: its fields that are not None."""
    if not dataclasses.is_dataclass(x) or isinstance(x, type):
        return str(x.tolist()) if isinstance(x, np.ndarray) else str(x)
    found = {part.name: getattr(x, part.name) for part in dataclasses.fields(x)}
    words = [
        f"{name} = {type(value).__name__}({stated(value)})"
        if dataclasses.is_dataclass(value)
        else f"{name} = {stated(value)}"
        for name, value in found.items()
        if value is not None
    ]
    return ", ".join(words) or "none"
