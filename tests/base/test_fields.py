"""Declared fields: unit, range, shape, messages, paths, symbols, and the reader of TOML data."""

from __future__ import annotations

import copy
import dataclasses
import inspect
import pickle
import tomllib
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from taut.base.errors import RangeError, ShapeError, TautError, UnknownNameError, UsageError
from taut.base.fields import Choice, Declared, Field, Part, Plain, Whole
from taut.trace.array import traced_array
from taut.trace.graph import Graph
from taut.trace.scalar import Scalar


class Tool(Declared):
    mass: Field = Field(unit="kg", above=0.0)
    com: Field = Field((0.0, 0.0, 0.0), unit="m", shape=3)


class Sensor(Declared):
    resolution: Field = Field(
        unit="rad", shape="n", above=0.0, zero_for_none=True, optional=True, hint="leave it out"
    )
    noise: Field = Field(0.0, unit="rad", shape="n", minimum=0.0)
    range: Field = Field(unit="N, N m", shape=6, accepts=("pair",), above=0.0, infinite=True, optional=True)
    side: Choice[str] = Choice("link", "motor")
    order: Choice[int] = Choice(1, 2)
    tool: Part[Tool | None] = Part(Tool, optional=True)
    name: Plain[str] = Plain(str, default="encoder")
    note: str | None = None

    def check(self) -> None:
        if self.side == "motor" and self.tool is not None:
            self.refuse("tool", "is for a sensor at the link; leave one of the two out")


class Mounted(Declared):
    sensor: Part[Sensor] = Part(Sensor, inline=True)
    gain: Field = Field(1.0, unit="1")


class Stiffness(Declared):
    rows: Plain[int] = Plain(int, default=6)
    K: Field = Field(unit="N/m", shape="rows", accepts=("pair", "force", "matrix"), minimum=0.0)


def error_of(make: Callable[[], Any]) -> TautError:
    with pytest.raises(TautError) as caught:
        make()
    return caught.value


WRONG: dict[str, tuple[type[TautError], type[Declared], str, str]] = {  # of an argument and of a key alike
    "range": (RangeError, Sensor, "noise = [1.0, -3.0]", "{}noise[1] must be >= 0 [rad]; got -3.0"),
    "hint": (RangeError, Sensor, "resolution = 0", "{}resolution must be > 0 [rad]; got 0.0; leave it out"),
    "none at all": (
        RangeError, Sensor, "resolution = [0, 0]",
        "{}resolution must be > 0 for one entry at least [rad]; got [0.0, 0.0]; leave it out",
    ),
    "not finite": (RangeError, Sensor, "noise = nan", "{}noise must be finite [rad]; got nan"),
    "infinite": (RangeError, Sensor, "noise = inf", "{}noise must be finite [rad]; got inf"),
    "shape": (
        ShapeError, Sensor, "range = [1, 2, 3]",
        "{}range must be (linear, angular) or (6,) [N, N m]; got shape (3,)",
    ),
    "alone": (
        ShapeError, Stiffness, "K = 8",
        "{}K must be (linear, angular), a force (3,), (6,) or (6, 6) [N/m]; got 8 alone",
    ),
    "asymmetric": (
        RangeError, Stiffness, "rows = 2\nK = [[1, 2], [0, 1]]",
        "{}K must be a symmetric matrix [N/m]; it differs from its transpose by 2",
    ),
    "flag": (ShapeError, Sensor, "noise = true", "{}noise must be real numbers [rad]; got True"),
    "text": (ShapeError, Sensor, 'noise = "a"', "{}noise must be numbers [rad]; got 'a'"),
    "word": (UsageError, Sensor, 'side = "lnk"', "{}side must be one of 'link', 'motor'; got 'lnk'"),
    "number": (UsageError, Sensor, "order = true", "{}order must be one of 1, 2; got True"),
    "kind": (UsageError, Sensor, "tool = 3", "{}tool must be a Tool; got 3"),
    "whole": (UsageError, Stiffness, "rows = true\nK = 1", "{}rows must be a whole number; got True"),
    "relation": (
        UsageError, Sensor, 'side = "motor"\ntool = { mass = 1 }',
        "{}tool is for a sensor at the link; leave one of the two out",
    ),
    "unknown": (UnknownNameError, Sensor, "nois = 1", "{owner} has no field 'nois'; did you mean 'noise'?"),
    "missing": (UsageError, Tool, "com = [0, 0, 0]", "{owner} needs mass [kg]"),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_a_wrong_value_gets_one_sentence(case: str) -> None:
    kind, cls, text, words = WRONG[case]
    given = {name: Tool(**x) if isinstance(x, dict) else x for name, x in tomllib.loads(text).items()}
    error = error_of(lambda: cls(**given))
    assert type(error) is kind
    assert str(error) == words.format("", owner=cls.__name__)


def test_an_error_keeps_field_joint_and_value() -> None:
    error = error_of(lambda: Sensor(noise=[0.0, -1.0]))
    assert (error.name, error.value, error.joint) == ("noise", -1.0, None)
    error = error_of(lambda: Sensor(noise=[0.0, 1.0]).check_size(["a", "b", "c"], "sensors."))
    assert str(error) == "sensors.noise must be a number or (3,) [rad] for 3 joints; got shape (2,)"
    error = error_of(lambda: Sensor.declared["noise"].checked([0.0, -1.0], joints=["a", "b"]))
    other = error.about("noise", "encoder.noise")
    assert str(other) == "encoder.noise[1] (joint 'b') must be >= 0 [rad]; got -1.0"
    assert (other.name, other.joint, error.name) == ("encoder.noise", "b", "noise")


def test_values_are_read_only_copies_in_one_shape() -> None:
    given = np.array([1.0, 2.0])
    sensor = Sensor(noise=given, range=(10.0, np.inf))
    given[:] = 5.0
    assert sensor.noise.tolist() == [1.0, 2.0]
    assert sensor.range.tolist() == [10.0] * 3 + [np.inf] * 3
    assert Stiffness(K=[1, 2, 3]).K.tolist() == [1, 2, 3, 0, 0, 0]
    with pytest.raises(ValueError, match="read-only"):
        sensor.noise[0] = 3.0
    for change in (lambda: setattr(sensor, "noise", 1.0), lambda: delattr(sensor, "noise")):
        with pytest.raises(dataclasses.FrozenInstanceError):
            change()


def test_it_is_a_dataclass_that_is_replaced_copied_and_shown() -> None:
    sensor = Sensor(noise=0.5, side="motor", note="left")
    assert [field.name for field in dataclasses.fields(sensor)] == list(Sensor.declared)
    other = dataclasses.replace(sensor, side="link")
    assert (other.noise, other.side, other.note) == (0.5, "link", "left")
    assert other.specified == {"noise", "note"}
    assert repr(sensor) == "Sensor(noise=0.5, side='motor', note='left')"
    for same in (copy.deepcopy(sensor), pickle.loads(pickle.dumps(sensor))):
        assert repr(same) == repr(sensor)
    assert "noise=0.0" in str(inspect.signature(Sensor))
    assert "takes its fields by name" in str(error_of(lambda: Sensor(1.0)))


def test_parameters_have_paths_and_take_symbols() -> None:
    mounted = Mounted(sensor=Sensor(noise=[1.0, 2.0], tool=Tool(mass=2.0)), gain=3.0)
    assert {path: x.tolist() for path, x in mounted.parameters().items()} == {
        "gain": 3.0,
        "noise": [1.0, 2.0],
        "tool.mass": 2.0,
        "tool.com": [0.0, 0.0, 0.0],
    }
    assert mounted.units() == {"gain": "1", "noise": "rad", "tool.mass": "kg", "tool.com": "m"}
    graph = Graph()
    noise = traced_array([Scalar(graph, graph.input()) for _ in range(2)])
    bound = mounted.bound({"noise": noise, "tool.mass": 4.0})
    assert bound.sensor.noise is noise
    assert bound.sensor.tool is not None
    assert bound.sensor.tool.mass == 4.0
    assert mounted.sensor.noise.tolist() == [1.0, 2.0]
    owner, field = mounted.find("tool.mass")
    assert (owner, field.unit) == (mounted.sensor.tool, "kg")


def test_a_parameter_is_changed_with_the_checks_of_the_constructor() -> None:
    mounted = Mounted(sensor=Sensor(noise=[1.0, 2.0], tool=Tool(mass=2.0)))
    changed = mounted.changed("tool.mass", 5.0).changed("noise", 7.0)
    assert (changed.parameters()["tool.mass"], changed.parameters()["noise"]) == (5.0, 7.0)
    name = "plant.sensors.tool.mass"
    assert (
        str(error_of(lambda: mounted.changed("tool.mass", -1.0, name=name))) == f"{name} must be > 0 [kg]; got -1.0"
    )
    assert str(error_of(lambda: mounted.checked_parameter("tool.mass", -1.0, name=name))).startswith(name)
    assert isinstance(error_of(lambda: mounted.changed("tool.mas", 1.0)), UnknownNameError)


class Steps(Declared):
    count: Whole = Whole(minimum=1, maximum=100)


def test_a_whole_number_is_one_in_its_range() -> None:
    assert type(Steps(count=np.int64(3)).count) is int
    for wrong in (0, 101, 2.5, True, "3"):
        assert str(error_of(lambda wrong=wrong: Steps(count=wrong))) == (
            f"count must be a whole number from 1 to 100; got {wrong!r}"
        )


def test_slips_in_a_class_are_refused_when_it_is_made() -> None:
    def no_type() -> Any:
        return type("A", (Declared,), {"kp": Field()})

    def method() -> Any:
        return type("A", (Declared,), {"__annotations__": {"bound": "Field"}, "bound": Field()})

    def mutable() -> Any:
        return type("A", (Declared,), {"__annotations__": {"w": "list"}, "w": [1.0]})

    assert str(error_of(no_type)) == "A: 'kp' needs its type; write kp: Field = Field(...)"
    assert str(error_of(method)) == "A: 'bound' is a word of Declared itself; give the field another name"
    assert str(error_of(mutable)) == "A: the default of 'w' is a list, which could be changed; write a tuple"
