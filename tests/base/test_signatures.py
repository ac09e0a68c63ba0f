"""Arguments that do not exist, are missing or come twice: one sentence, at every public name."""

from __future__ import annotations

import copy
import dataclasses
import enum
import inspect
import operator
import pickle
from collections.abc import Callable
from typing import Any

import pytest
from refusals import refused, warned

import taut
from taut.base.fields import Declared
from taut.base.front_door import checked_arguments

ARM = taut.load_arm("planar2")


def takes_named_arguments(name: str) -> bool:
    thing = operator.attrgetter(name)(taut)
    if inspect.isclass(thing):
        if (
            issubclass(thing, (Exception, enum.Enum))
            or getattr(thing, "_is_protocol", False)
            or thing is taut.Law
            or inspect.isabstract(thing)
        ):
            return False
    elif not inspect.isfunction(thing):
        return False
    return all(p.kind is not p.VAR_KEYWORD for p in inspect.signature(thing).parameters.values())


ROOMS = ["analysis", "drives", "environments", "guards", "laws", "sensors", "trajectories"]
NAMES = [*taut.__all__, *(f"{room}.{name}" for room in ROOMS for name in getattr(taut, room).__all__)]
PUBLIC = [name for name in NAMES if takes_named_arguments(name)]


def test_nearly_every_public_name_is_tried() -> None:
    assert len(PUBLIC) > 130


@pytest.mark.parametrize("name", PUBLIC)
def test_an_argument_that_does_not_exist_is_refused(name: str) -> None:
    thing = operator.attrgetter(name)(taut)
    any_name = (taut.SideBySide, taut.environments.Environments)
    declared = inspect.isclass(thing) and issubclass(thing, Declared) and thing not in any_name
    with pytest.raises(taut.errors.UnknownNameError if declared else taut.errors.UsageError) as caught:
        thing(no_such_argument=1.0)
    assert caught.value.name == "no_such_argument"


@pytest.mark.parametrize("name", [name for name in PUBLIC if name.rpartition(".")[2][0].islower()])
def test_a_public_function_is_pickled_by_its_name_and_shows_its_signature(name: str) -> None:
    function = operator.attrgetter(name)(taut)
    assert pickle.loads(pickle.dumps(function)) is function
    assert "args" not in inspect.signature(function).parameters
    assert function.__doc__


WRONG: list[tuple[str, Callable[[], Any]]] = [
    ("misspelt", lambda: taut.compile(taut.laws.PID(kp=1.0, kd=1.0), ARM, rat=100.0)),  # type: ignore[call-arg]
    ("misspelt in a class method", lambda: taut.Constraint.plane(points=[0, 0, 0], normal=[0, 0, 1])),  # type: ignore[call-arg]
    ("misspelt in a method", lambda: ARM.with_payload(masss=1.0)),  # type: ignore[call-arg]
    ("unlike any", lambda: taut.JointMotion(theta=[0.0])),  # type: ignore[call-arg]
    ("missing", lambda: taut.trajectories.Cubic(q0=0.0, duration=1.0)),  # type: ignore[call-arg]
    ("twice", lambda: ARM.with_payload(1.0, mass=2.0)),  # type: ignore[misc]
    ("too many by position", lambda: taut.Pose([0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0])),  # type: ignore[misc]
    ("by position", lambda: taut.stream(0.1, print)),  # type: ignore[misc]
    ("of a function of a module", lambda: taut.textbook.ComputedTorque(thetalst=1)),  # type: ignore[call-arg]
]


@pytest.mark.parametrize("call", [call for _, call in WRONG], ids=[name for name, _ in WRONG])
def test_what_is_wrong_with_a_call_is_named(call: Callable[[], Any]) -> None:
    with refused(taut.errors.UsageError) as caught:
        call()
    assert isinstance(caught.value, TypeError)


def test_a_type_error_inside_of_a_call_stays_what_it_is() -> None:
    def inner(a: float) -> float:
        return a + "text"  # type: ignore[operator, no-any-return]

    def outer(a: float) -> float:
        return inner(a, b=1.0)  # type: ignore[call-arg]

    for function in (inner, outer):
        with pytest.raises(TypeError) as caught:
            checked_arguments(function, function.__name__)(1.0)
        assert not isinstance(caught.value, taut.TautError)


def test_a_subclass_of_the_user_keeps_its_own_constructor() -> None:
    class Tilted(taut.Pose):
        def __init__(self, angle: float) -> None:
            super().__init__(rpy=[angle, 0.0, 0.0])

    assert isinstance(Tilted(0.1), taut.Pose)
    with pytest.raises(TypeError) as caught:
        Tilted(tilt=0.1)  # type: ignore[call-arg]
    assert not isinstance(caught.value, taut.TautError)


def test_copies_and_replacements_work_as_before() -> None:
    friction = taut.Friction(viscous=1.0)
    assert dataclasses.replace(friction, viscous=2.0).viscous == 2.0
    assert copy.deepcopy(taut.JointMotion(q=[1.0])).q.tolist() == [1.0]
    with pytest.raises(taut.errors.UsageError):
        dataclasses.replace(friction, viscosity=2.0)  # type: ignore[call-arg]


def test_a_warning_is_at_the_line_that_called() -> None:
    with warned(RuntimeWarning) as caught:
        ARM.with_gears(100.0, motor_inertia=50.0)
    assert caught[0].filename == __file__


@pytest.mark.parametrize("name", [name for name in PUBLIC if name.rpartition(".")[2][0].isupper()])
def test_its_methods_refuse_them_too(name: str) -> None:
    """Those that take any argument, inherited ones of taut among them."""
    cls = operator.attrgetter(name)(taut)
    for word in dir(cls):
        method = inspect.getattr_static(cls, word)
        function = getattr(method, "__func__", method)
        ours = inspect.isfunction(function) and function.__name__ == word and function.__module__.startswith("taut.")
        if word.startswith("_") or not ours:
            continue
        taken = [p for p in inspect.signature(function).parameters.values() if p.name not in ("self", "cls")]
        if taken and all(p.kind is not p.VAR_KEYWORD for p in taken):
            with pytest.raises(taut.errors.UsageError):
                function(cls, no_such_argument=1.0)
