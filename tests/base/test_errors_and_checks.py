"""Errors and checks: one sentence each, with the data kept."""

from __future__ import annotations

import copy
import math
import os
import pickle
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import refused

import taut
from taut import TautError
from taut.base import checks, paths
from taut.base.errors import (
    Problem,
    count_of,
    missing_extra,
    quoted_list,
    raised_location,
    unknown_name,
    user_location,
)
from taut.errors import FileError, ModelError, RangeError, ShapeError, UsageError

JOINTS = ("base", "elbow")


def is_refused(call: Callable[[], Any], kind: type[Exception]) -> None:
    with refused(kind) as caught:
        call()
    assert isinstance(caught.value, TautError)


def test_what_is_counted_is_one_or_several() -> None:
    assert [count_of(n, "joint") for n in (0, 1, 2)] == ["0 joints", "1 joint", "2 joints"]
    arm = taut.load_arm("one_joint")
    assert repr(arm) == "Arm('one_joint', 1 joint, tool 'tool')"
    assert "'one_joint' (1 joint) at 1000 Hz" in taut.compile(taut.laws.PID(kp=1.0), arm).explanation()


ARRAYS: list[tuple[str, Any, type[Exception], str]] = [
    ("None", None, ShapeError, "kp must be numbers [N m/rad]; got None"),
    ("a text", "12", ShapeError, "kp must be numbers [N m/rad]; got '12'"),
    ("bytes", b"12", ShapeError, "kp must be numbers [N m/rad]; got b'12'"),
    ("texts", ["1", "2"], ShapeError, "kp must be real numbers [N m/rad]; got ['1', '2']"),
    (
        "a long list of texts",
        ["+"] * 9,
        ShapeError,
        "kp must be real numbers [N m/rad]; got ['+', '+', '+', '+', '+', '+', ...]",
    ),
    ("a text among numbers", [1.0, "a"], ShapeError, "kp must be real numbers [N m/rad]; got [1.0, 'a']"),
    ("truth values", [True, False], ShapeError, "kp must be real numbers [N m/rad]; got [True, False]"),
    ("complex", [1j, 2.0], ShapeError, "kp must be real numbers [N m/rad]; got [1j, 2.0]"),
    (
        "dates",
        np.array([1, 2], "m8[s]"),
        ShapeError,
        "kp must be real numbers [N m/rad]; got [datetime.timedelta(seconds=1), datetime.timedelta(seconds=2)]",
    ),
    (
        "records",
        np.zeros(2, dtype=[("a", "f8")]),
        ShapeError,
        "kp must be real numbers [N m/rad]; got [(0.0,), (0.0,)]",
    ),
    (
        "masked",
        np.ma.array([1.0, 2.0], mask=[False, True]),
        ShapeError,
        "kp has masked entries [N m/rad]; fill them: x.filled(...)",
    ),
    (
        "ragged",
        [[1.0], [1.0, 2.0]],
        ShapeError,
        "kp must be numbers [N m/rad] in a rectangular array; got [[1.0], [1.0, 2.0]]",
    ),
    (
        "a whole number beyond all floats",
        [10**400, 1],
        ShapeError,
        f"kp must be numbers [N m/rad] in a rectangular array; got [{10**400}, 1]",
    ),
    ("a mapping", {}, ShapeError, "kp must be numbers [N m/rad] in a rectangular array; got {}"),
    ("too long", [1.0, 2.0, 3.0], ShapeError, "kp must have shape (2,) (2 joints) [N m/rad]; got shape (3,)"),
    ("a column", [[1.0], [2.0]], ShapeError, "kp must have shape (2,) (2 joints) [N m/rad]; got shape (2, 1)"),
    ("a number", 1.0, ShapeError, "kp must have shape (2,) (2 joints) [N m/rad]; got shape ()"),
    ("empty", [], ShapeError, "kp must have shape (2,) (2 joints) [N m/rad]; got shape (0,)"),
    ("NaN", [1.0, math.nan], RangeError, "kp[1] (joint 'elbow') must be finite [N m/rad]; got nan"),
    ("None among numbers", [None, 1.0], RangeError, "kp[0] (joint 'base') must be finite [N m/rad]; got nan"),
    ("infinity", [-math.inf, 1.0], RangeError, "kp[0] (joint 'base') must be finite [N m/rad]; got -inf"),
]


@pytest.mark.parametrize(("what", "value", "kind", "message"), ARRAYS, ids=[case[0] for case in ARRAYS])
def test_an_array_that_is_none_gets_one_sentence(what: str, value: Any, kind: type[Exception], message: str) -> None:
    call = lambda: checks.finite_array("kp", value, shape=(2,), unit="N m/rad", joints=JOINTS)  # noqa: E731
    is_refused(call, kind)


@pytest.mark.parametrize(
    "value",
    [
        [1, 2],
        (1.0, 2.0),
        np.array([1, 2], dtype=np.int8),
        np.array([1, 2], dtype=np.float32),
        np.array([1, 2], dtype=">f8"),
        np.array([1, 2], dtype=np.longdouble),
        np.array([1, 0, 2, 0])[::2],
        np.array([1.0, 2.0], dtype=object),
        np.ma.array([1.0, 2.0], mask=False),
        memoryview(np.array([1.0, 2.0])),
        np.array([1.0, 2.0]).view(type("Sub", (np.ndarray,), {})),
    ],
    ids=lambda value: type(value).__name__ + str(getattr(value, "dtype", "")),
)
def test_whatever_holds_real_numbers_is_taken_as_a_read_only_copy(value: Any) -> None:
    array = checks.finite_array("q", value, shape=(2,))
    assert type(array) is np.ndarray
    assert array.dtype == np.float64
    assert array.tolist() == [1.0, 2.0]
    assert array.flags.c_contiguous
    assert not array.flags.writeable
    assert not np.shares_memory(array, np.asarray(value))


def test_the_error_keeps_the_data() -> None:
    with pytest.raises(RangeError) as caught:
        checks.finite_array("q", [1.0, math.nan], joints=JOINTS)
    error = caught.value
    assert (error.name, error.joint, error.rule) == ("q", "elbow", "finite")
    assert math.isnan(error.value)  # type: ignore[arg-type]
    assert isinstance(error, ValueError)


SCALARS: list[tuple[Any, type[Exception], str]] = [
    ("1000", ShapeError, "rate must be one number [Hz]; got '1000'"),
    (None, ShapeError, "rate must be one number [Hz]; got None"),
    (True, ShapeError, "rate must be one number [Hz]; got True"),
    (np.True_, ShapeError, "rate must be one number [Hz]; got np.True_"),
    ({}, ShapeError, "rate must be one number [Hz]; got {}"),
    ([1.0, 2.0], ShapeError, "rate must be one number [Hz]; got [1.0, 2.0]"),
    (1j, ShapeError, "rate must be one number [Hz]; got 1j"),
    (math.nan, RangeError, "rate must be finite [Hz]; got nan"),
    (math.inf, RangeError, "rate must be finite [Hz]; got inf"),
    (0, RangeError, "rate must be > 0 [Hz]; got 0.0"),
    (-1.5, RangeError, "rate must be > 0 [Hz]; got -1.5"),
]


@pytest.mark.parametrize(("value", "kind", "message"), SCALARS, ids=[repr(case[0]) for case in SCALARS])
def test_a_number_that_is_none_gets_one_sentence(value: Any, kind: type[Exception], message: str) -> None:
    is_refused(lambda: checks.positive_scalar("rate", value, unit="Hz"), kind)


@pytest.mark.parametrize("value", [2, 2.0, np.float32(2.0), np.int8(2), np.array(2.0), np.array(2)])
def test_any_real_number_is_a_scalar(value: Any) -> None:
    assert checks.positive_scalar("rate", value) == 2.0
    assert type(checks.positive_scalar("rate", value)) is float


def test_rules_name_the_entry() -> None:
    at_least = lambda value: checks.require_range("kp", value, minimum=0.0, unit="1/s^2", joints=JOINTS)  # noqa: E731
    positive = lambda value: checks.require_range("mass", value, above=0.0, unit="kg")  # noqa: E731
    is_refused(lambda: at_least([1.0, -3.0]), RangeError)
    is_refused(lambda: at_least(-3.0), RangeError)
    is_refused(lambda: positive([[1.0, 0.0]]), RangeError)


def test_matrices_must_be_symmetric_and_positive() -> None:
    psd = lambda value: checks.symmetric_psd("kp", np.array(value), unit="1/s^2")  # noqa: E731
    psd([[1.0, 0.5], [0.5, 1.0]])
    psd([[1.0, 1.0], [1.0, 1.0]])  # semidefinite
    psd([[1.0, 0.5 + 1e-12], [0.5, 1.0]])  # rounding
    psd(np.zeros((2, 2)))
    is_refused(lambda: psd([[1.0, 0.5], [0.4, 1.0]]), RangeError)
    is_refused(lambda: psd([[1.0, 2.0], [2.0, 1.0]]), RangeError)


def test_one_of_a_few_words() -> None:
    assert checks.one_of("engine", "float", ("native", "float")) == "float"
    is_refused(lambda: checks.one_of("engine", "c", ("native", "float")), UsageError)
    is_refused(lambda: checks.one_of("engine", None, ("native", "float")), UsageError)


def test_files_that_cannot_be_read_are_told(tmp_path: Path) -> None:
    good = tmp_path / "panda.urdf"
    good.write_text("<robot/>")
    empty = tmp_path / "empty.urdf"
    empty.touch()
    assert checks.readable_file("model", good) == good
    is_refused(lambda: checks.readable_file("model", tmp_path), FileError)
    is_refused(lambda: checks.readable_file("model", tmp_path / "pandaa.urdf"), FileError)
    is_refused(lambda: checks.readable_file("model", empty), FileError)
    if sys.platform != "win32":
        pipe = tmp_path / "pipe"
        os.mkfifo(pipe)
        is_refused(lambda: checks.readable_file("model", pipe), FileError)


# -------------------------------------------------------------------- words


@pytest.mark.parametrize(
    ("name", "known", "message"),
    [
        ("tolo0", ["tool0", "base"], "the arm has no frame 'tolo0'; did you mean 'tool0'?"),
        ("TOOL", ["tool", "base"], "the arm has no frame 'TOOL'; did you mean 'tool'?"),
        ("xyz", ["tool0", "base"], "the arm has no frame 'xyz'; it has 'tool0', 'base'"),
        ("xyz", [], "the arm has no frame 'xyz'; it has none"),
        (
            "xyz",
            [f"link{i}" for i in range(14)],
            "the arm has no frame 'xyz'; it has 'link0', 'link1', 'link2', 'link3', 'link4', 'link5', 'link6', 'link7', "
            "'link8', 'link9', 'link10', 'link11', 'link12', 'link13'",
        ),
    ],
)
def test_an_unknown_name_gets_the_nearest_ones(name: str, known: list[str], message: str) -> None:
    error = unknown_name("the arm", "frame", name, known)
    assert str(error) == message
    assert error.name == name
    assert isinstance(error, LookupError)


def test_lists_are_quoted_and_cut() -> None:
    assert quoted_list([]) == ""
    assert quoted_list("abc", most=2) == "'a', 'b' and 1 more"


def test_a_missing_package_is_named_with_the_command_that_installs_it() -> None:
    error = missing_extra("load_arm('panda')", "example-robot-data", "arms")
    assert str(error) == (
        "load_arm('panda') needs the package 'example-robot-data', which is not installed; "
        'pip install -e ".[arms]" installs it'
    )
    assert isinstance(error, ImportError)


def test_a_model_error_shows_its_first_problem_and_counts_the_others() -> None:
    first = Problem(object="link 'a'", attribute="mass", message="link 'a': mass must be > 0 [kg]; got 0.0", line=7)
    other = Problem(object="link 'b'", attribute=None, message="link 'b' has no joint")
    assert str(ModelError("arm.urdf", [first])) == "arm.urdf: link 'a': mass must be > 0 [kg]; got 0.0 (line 7)"
    error = ModelError("arm.urdf", [other, first])
    assert str(error) == "arm.urdf: link 'b' has no joint (and 1 more: taut check arm.urdf lists them)"
    assert error.problems == (other, first)


# -------------------------------------------------------------------- where it happened


def test_the_location_is_the_callers_own_line() -> None:
    assert user_location() == f"{__file__}:{user_line(test_the_location_is_the_callers_own_line, 1)}"


def user_line(function: Any, offset: int) -> int:
    return int(function.__code__.co_firstlineno) + offset


def test_the_location_skips_libraries_between_the_caller_and_us() -> None:
    import functools
    import statistics

    places = []
    functools.reduce(lambda a, b: places.append(user_location()), [1, 2])
    assert places[0].startswith(f"{__file__}:")

    class Number(float):
        def as_integer_ratio(self) -> tuple[int, int]:
            places.append(user_location())
            return super().as_integer_ratio()

        def __float__(self) -> float:
            places.append("inner")
            return 1.0

    statistics.fmean([Number(1.0)])  # Python's own module in between
    assert all(place.startswith(f"{__file__}:") or place == "inner" for place in places)


def test_an_error_is_placed_at_the_callers_innermost_line() -> None:
    import json

    with pytest.raises(ValueError, match="property name") as caught:
        json.loads("{")
    assert raised_location(caught.value).startswith(f"{__file__}:")


def test_code_without_a_file_has_a_place_too() -> None:
    code = (
        "import taut, numpy as np\n"
        "class Bad(taut.Law):\n"
        "    def command(self, x, ref):\n"
        "        return taut.Torque(P=np.ones(2) * float(x.q[0]))\n"
        "try:\n"
        "    taut.compile(Bad(), taut.load_arm('planar2'))\n"
        "except taut.errors.TraceError as error:\n"
        "    print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("a traced value is turned into a plain float at <string>:4; ")


# -------------------------------------------------------------------- paths and poses


def test_paths_flatten_and_unflatten() -> None:
    nested = {"law": {"kp": 1.0, "inner": {"ki": 2.0}}, "t": 0.0}
    flat = {"law.kp": 1.0, "law.inner.ki": 2.0, "t": 0.0}
    assert paths.flatten(nested) == flat
    assert paths.unflatten(flat) == nested
    assert paths.subtree(flat, "law") == {"kp": 1.0, "inner.ki": 2.0}
    assert paths.subtree(flat, "la") == {}


POSES: list[tuple[dict[str, Any], type[Exception], str]] = [
    ({"xyzw": [0, 0, 0, 1], "rpy": [0, 0, 0]}, UsageError, "a pose takes one rotation; got xyzw and rpy; keep one"),
    ({"p": [1.0, 2.0]}, ShapeError, "p must have shape (3,) [m]; got shape (2,)"),
    ({"xyzw": [0, 0, 0]}, ShapeError, "xyzw must have shape (4,); got shape (3,)"),
    ({"wxyz": [2, 0, 0, 0]}, RangeError, "wxyz must have length 1; its length is 2; divide it by its length"),
    ({"wxyz": [0, 0, 0, 0]}, RangeError, "wxyz must have length 1; its length is 0; divide it by its length"),
    ({"rpy": [0, math.nan, 0]}, RangeError, "rpy[1] must be finite [rad]; got nan"),
    (
        {"R": 2.0 * np.eye(3)},
        RangeError,
        "R must be orthonormal; R^T R differs from the identity by 3; orthonormalise it or give a quaternion",
    ),
    (
        {"R": np.diag([1.0, 1.0, -1.0])},
        RangeError,
        "R must be right-handed; its determinant is -1, so it mirrors; change the sign of one axis",
    ),
]


@pytest.mark.parametrize(("arguments", "kind", "message"), POSES, ids=[case[2][:30] for case in POSES])
def test_a_pose_that_is_none_gets_one_sentence(
    arguments: dict[str, Any], kind: type[Exception], message: str
) -> None:
    is_refused(lambda: taut.Pose(**arguments), kind)


def test_a_homogeneous_matrix_that_is_transposed_is_refused() -> None:
    T = np.eye(4)
    T[3, :3] = [1.0, 2.0, 3.0]
    is_refused(lambda: taut.Pose.from_matrix(T), RangeError)


ROTATIONS = [
    ("identity", [0.0, 0.0, 0.0]),
    ("half a turn about x", [math.pi, 0.0, 0.0]),
    ("half a turn about y", [0.0, math.pi, 0.0]),
    ("half a turn about z", [0.0, 0.0, math.pi]),
    ("nearly half a turn", [math.pi - 1e-8, 0.0, 0.0]),
    ("tiny", [1e-8, -1e-8, 1e-8]),
    ("pitch straight up", [0.3, math.pi / 2, 0.0]),
    ("pitch straight down", [0.0, -math.pi / 2, 0.7]),
    ("generic", [0.3, -1.1, 2.5]),
]
TURNS = 1e-12  # of an angle; half a turn from a matrix is good to the square root of rounding times itself


@pytest.mark.parametrize(("what", "rpy"), ROTATIONS, ids=[case[0] for case in ROTATIONS])
def test_every_description_of_a_rotation_is_the_same_rotation(what: str, rpy: list[float]) -> None:
    pose = taut.Pose(p=[1.0, -2.0, 3.0], rpy=rpy)
    for other in (
        taut.Pose(pose.p, xyzw=pose.xyzw),
        taut.Pose(pose.p, wxyz=pose.wxyz),
        taut.Pose(pose.p, wxyz=-pose.wxyz),
        taut.Pose(pose.p, R=pose.R),
        taut.Pose(pose.p, rpy=pose.rpy),
        taut.Pose.from_matrix(pose.matrix),
        pose @ taut.Pose.identity(),
    ):
        np.testing.assert_allclose(other.R, pose.R, rtol=0.0, atol=TURNS)
        np.testing.assert_allclose(other.p, pose.p, rtol=0.0, atol=TURNS)
    np.testing.assert_allclose((pose @ pose.inverse()).matrix, np.eye(4), rtol=0.0, atol=TURNS)
    np.testing.assert_allclose(
        pose.act([1.0, 0.0, 0.0]), pose.matrix[:3, :3] @ [1, 0, 0] + pose.p, rtol=0.0, atol=TURNS
    )


def test_a_pose_is_a_value() -> None:
    pose = taut.Pose(p=[1.0, 2.0, 3.0], rpy=[0.1, 0.2, 0.3])
    for twin in (copy.copy(pose), copy.deepcopy(pose), pickle.loads(pickle.dumps(pose))):
        assert twin == pose
        assert hash(twin) == hash(pose)
        with pytest.raises(ValueError, match="read-only"):
            twin.p[0] = 5.0
    with refused(AttributeError):
        pose.p = np.zeros(3)  # type: ignore[misc]
    assert pose != taut.Pose(p=[1.0, 2.0, 3.0])
    assert pose != "pose"
    assert repr(taut.Pose()) == "Pose(p=[0., 0., 0.], rpy=[0., 0., 0.])"


def test_rotations_within_rounding_of_quarter_turns_are_exact() -> None:
    for rpy in ([math.pi / 2, 0.0, 0.0], [0.0, math.pi, math.pi / 2], [-math.pi / 2, 0.0, math.pi]):
        assert set(np.abs(taut.Pose(rpy=rpy).R).ravel()) <= {0.0, 1.0}
    small = taut.Pose(rpy=[1e-9, 0.0, 0.0]).R[2, 1]  # a real small angle stays
    assert small == pytest.approx(1e-9, rel=1e-12)
