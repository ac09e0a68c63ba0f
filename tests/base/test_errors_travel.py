"""Errors come back whole from a copy and a pickle; what cannot be copied says so; every class has a code of its own."""

from __future__ import annotations

import copy
import pickle
import re
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import taut
from taut.base.errors import ModelError, Problem, TautError, missing_extra, unknown_name

ARM = taut.load_arm("planar2")
LOADED = [getattr(taut.errors, name) for name in taut.errors.__all__]
LAW = taut.laws.PID(kp=10.0, kd=1.0)
REF = taut.JointMotion(q=[0.1, 0.2])

COPIES: dict[str, Callable[[Any], Any]] = {
    "pickle": lambda x: pickle.loads(pickle.dumps(x)),
    "old pickle": lambda x: pickle.loads(pickle.dumps(x, protocol=0)),
    "copy": copy.copy,
    "deepcopy": copy.deepcopy,
}


def classes(kind: type[TautError] = TautError) -> list[type[TautError]]:
    """All that there are in taut, whatever of it is loaded."""
    return [
        kind,
        *(each for child in kind.__subclasses__() if child.__module__.startswith("taut.") for each in classes(child)),
    ]


def one_of(kind: type[TautError]) -> TautError:
    if kind is ModelError:
        return ModelError(
            "arm.urdf", [Problem(object="link", attribute="mass", message="is negative", line=n) for n in (3, 4)]
        )
    return kind("it must be so", name="kp", joint="elbow", value=np.array([1.0, np.inf]), rule="so")


@pytest.mark.parametrize("copied", COPIES.values(), ids=COPIES)
@pytest.mark.parametrize("kind", classes())
def test_a_copy_of_an_error_is_the_same_error(kind: type[TautError], copied: Callable[[Any], Any]) -> None:
    error = one_of(kind)
    error.add_note("a note")
    twin = copied(error)
    assert type(twin) is kind
    assert (str(twin), twin.args, twin.name, twin.joint, twin.rule) == (
        str(error),
        error.args,
        error.name,
        error.joint,
        error.rule,
    )
    np.testing.assert_array_equal(twin.value, error.value)
    assert twin.__notes__ == ["a note"]
    if kind is ModelError:
        assert (twin.source, twin.problems) == (error.source, error.problems)  # type: ignore[attr-defined]


def test_those_that_are_made_by_functions_are_whole_too() -> None:
    for error in (unknown_name("the arm", "frame", "tolo", ["tool"]), missing_extra("it", "pkg", "extra")):
        twin = pickle.loads(pickle.dumps(error))
        assert (type(twin), str(twin), twin.name) == (type(error), str(error), error.name)
        assert getattr(twin, "msg", None) == getattr(error, "msg", None)


def test_a_value_that_cannot_be_pickled_is_there_as_text() -> None:
    error = taut.errors.UsageError("no function", value=lambda: None)
    twin = pickle.loads(pickle.dumps(error))
    assert (str(twin), twin.value) == ("no function", repr(error.value))


def fails(_: int) -> object:
    return taut.load_arm("no_such_folder/broken.urdf")


def refuses(_: int) -> object:
    raise one_of(ModelError)


@pytest.mark.parametrize("work", [fails, refuses])
def test_a_pool_of_workers_gets_the_error(work: Any) -> None:
    """It once waited for ever."""
    with ProcessPoolExecutor(1, mp_context=get_context("fork")) as pool, pytest.raises(TautError):
        pool.submit(work, 0).result(timeout=60.0)


def test_every_class_has_a_code_of_its_own_that_stands_in_the_docs() -> None:
    codes = {kind.__name__: kind.code for kind in classes()}
    assert len(set(codes.values())) == len(codes)
    assert all(re.fullmatch(r"TAUT(-[A-Z]+)*", code) for code in codes.values())
    page = (Path(__file__).parents[2] / "docs" / "errors.md").read_text(encoding="utf-8")
    rows = dict(re.findall(r"^\| `(\w+)` \| `\w+` \| `([A-Z-]+)` \|", page, flags=re.MULTILINE))
    assert rows == {name: code for name, code in codes.items() if name != "TautError"}
    assert set(rows) == {name for name in taut.errors.__all__ if name.endswith("Error") and name != "TautError"}


# -------------------------------------------------------------------- what can be copied, and what cannot


@pytest.mark.parametrize("copied", COPIES.values(), ids=COPIES)
def test_what_holds_machine_code_refuses_to_be_copied(copied: Callable[[Any], Any]) -> None:
    ctrl, plant = taut.compile(LAW, ARM), taut.MujocoPlant(ARM)
    attached = taut.MujocoPlant.attach(plant.model, plant.data, ARM)
    for thing in (ctrl, ctrl.parameters, ctrl.bind(), attached):
        with pytest.raises(taut.errors.UsageError):
            copied(thing)
    assert dict(ctrl.parameters).keys() == ctrl.parameters.keys()


@pytest.mark.part(1)
@pytest.mark.parametrize("copied", COPIES.values(), ids=COPIES)
def test_a_copy_of_a_mujoco_plant_runs_as_it_does_and_is_another_one(copied: Callable[[Any], Any]) -> None:
    box = '<body name="box" pos="0.5 0 2"><freejoint/><geom type="box" size="0.1 0.1 0.1" mass="1"/></body>'
    sensors = taut.sensors.Sensors(torque=taut.sensors.TorqueSensor(noise=0.05))
    plant = taut.MujocoPlant(
        ARM, scene=box, adds=("gravity",), sensors=sensors, environment=taut.environments.Spring(stiffness=30.0)
    )
    plant.set_parameters({"plant.payload.mass": 0.5})
    twin = copied(plant)
    assert twin.model is not plant.model
    ctrl = taut.compile(LAW, ARM, adds=plant.adds)
    runs = [taut.run(ctrl, each, REF, duration=0.1) for each in (plant, twin)]
    for name, column in runs[0].arrays().items():
        np.testing.assert_array_equal(runs[1].arrays()[name], column, err_msg=name)
    twin.set_parameters({"plant.payload.mass": 0.1})
    assert plant.parameters["plant.payload.mass"] == 0.5


def doubled(x: Any) -> Any:
    return 2.0 * x


@pytest.mark.parametrize("copied", COPIES.values(), ids=COPIES)
def test_a_copy_of_a_native_function_is_compiled_anew(copied: Callable[[Any], Any]) -> None:
    np.testing.assert_array_equal(copied(taut.native(doubled, x=2))(np.ones(2)), [2.0, 2.0])
