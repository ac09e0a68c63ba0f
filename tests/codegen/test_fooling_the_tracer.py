"""Each way to fool a tracer, tried on a user's law: what comes is a sentence that names the line, or the right number."""

from __future__ import annotations

import copy
import math
import random
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import taut
from taut import Gain, Memory, TautError, Torque
from taut import math as tm
from taut.errors import MatchError, RangeError, ShapeError, TraceError, UnknownNameError, UsageError

ARM = taut.load_arm("planar2")
HERE = r"\S*test_fooling_the_tracer\.py:\d+"
ANYWAY = r"; use taut\.math for arrays, branches and functions; engine='float' runs it on plain numbers"


def law_of(command: Callable[..., Any], **fields: Any) -> type[taut.Law]:
    """A law of the user's, with this command and these annotated fields."""
    annotations = {name: "Memory" if isinstance(value, Memory) else "Gain" for name, value in fields.items()}
    body = {name: value for name, value in fields.items() if value is not None}
    return type("Mine", (taut.Law,), {"__annotations__": annotations, **body, "command": command})


def compiled(command: Callable[..., Any], **gains: Any) -> taut.Controller:
    return taut.compile(law_of(command, kp=Gain(1.0))(**gains), ARM)


# -------------------------------------------------------------------- in a command


def assigns_an_entry(self, x, ref):
    tau = np.zeros(2)
    tau[0] = x.q[0]
    return Torque(P=tau)


def assigns_a_slice(self, x, ref):
    tau = np.zeros(2)
    tau[:] = x.q
    return Torque(P=tau)


def adds_in_place(self, x, ref):
    tau = np.zeros(2)
    tau += x.q
    return Torque(P=tau)


def changes_what_it_is_given(self, x, ref):
    q = x.q
    q -= ref.q
    return Torque(P=q)


def changes_an_entry_of_what_it_is_given(self, x, ref):
    x.q[0] = 0.0
    return Torque(P=x.q)


def branches(self, x, ref):
    if x.q[0] > 1.0:
        return Torque(P=x.q)
    return Torque(P=-x.q)


def loops(self, x, ref):
    q = x.q[0]
    while q > math.pi:
        q = q - 2.0 * math.pi
    return Torque(P=np.ones(2) * q)


def masks(self, x, ref):
    tau = x.q.copy()
    tau[x.q > 0.0] = 0.0
    return Torque(P=tau)


FOOLS: dict[str, tuple[Callable[..., Any], type[TautError], str]] = {
    "tau[0] = x.q[0]": (
        assigns_an_entry,
        TraceError,
        f"a traced value is turned into a plain float at {HERE}; while a law is traced its numbers are not known yet. "
        r"Use taut\.math\.sin\(x\) instead of math\.sin\(x\), leave out float\(x\), and make arrays that you assign into "
        r"with taut\.math\.zeros\(n\) instead of np\.zeros\(n\)",
    ),
    "tau[:] = x.q": (assigns_a_slice, TraceError, f"a traced value is turned into a plain float at {HERE}; .*"),
    "tau += x.q": (
        adds_in_place,
        TraceError,
        f"a traced value is written into an array of floats at {HERE}; make the array with taut\\.math\\.zeros\\(n\\), "
        r"or write x = x \+ y instead of x \+= y",
    ),
    "x.q -= ref.q": (
        changes_what_it_is_given,
        UsageError,
        f"Mine fails on plain numbers, at rest at home: what a law is given is changed in place at {HERE}; "
        r"change a copy: q = x\.q\.copy\(\)",
    ),
    "x.q[0] = 0": (
        changes_an_entry_of_what_it_is_given,
        UsageError,
        f"Mine fails on plain numbers, at rest at home: what a law is given is changed in place at {HERE}; "
        r"change a copy: q = x\.q\.copy\(\)",
    ),
    "float(x)": (
        lambda self, x, ref: Torque(P=np.ones(2) * float(x.q[0])),
        TraceError,
        f"a traced value is turned into a plain float at {HERE}; .*",
    ),
    "math.sin(x)": (
        lambda self, x, ref: Torque(P=np.ones(2) * math.sin(x.q[0])),
        TraceError,
        f"a traced value is turned into a plain float at {HERE}; .*",
    ),
    "int(x)": (
        lambda self, x, ref: Torque(P=np.ones(2) * int(x.q[0])),
        TraceError,
        f"a traced value is turned into an integer at {HERE}; "
        r"use taut\.math\.floor\(x\), or a plain number that the law is made with",
    ),
    "round(x)": (
        lambda self, x, ref: Torque(P=np.ones(2) * round(x.q[0])),
        TraceError,
        rf"a traced value is rounded at {HERE}; use taut\.math\.floor\(x \+ 0\.5\)",
    ),
    "if": (
        branches,
        TraceError,
        rf"a traced value decides a branch at {HERE} \(if, while, and, or, min, max, sort, np\.clip on a list\); while a "
        r"law is traced it is not known yet\. Use taut\.math\.where\(condition, a, b\), taut\.math\.minimum or "
        r"taut\.math\.clip; combine conditions with & \| ~",
    ),
    "while": (loops, TraceError, rf"a traced value decides a branch at {HERE} .*"),
    "min()": (
        lambda self, x, ref: Torque(P=np.ones(2) * min(x.q)),
        TraceError,
        rf"a traced value decides a branch at {HERE} .*",
    ),
    "max(x, 0)": (
        lambda self, x, ref: Torque(P=np.ones(2) * max(x.q[0], 0.0)),
        TraceError,
        rf"a traced value decides a branch at {HERE} .*",
    ),
    "sorted": (
        lambda self, x, ref: Torque(P=np.array(sorted(x.q))),
        TraceError,
        rf"a traced value decides a branch at {HERE} .*",
    ),
    "np.clip on a list": (
        lambda self, x, ref: Torque(P=np.clip([x.q[0], x.q[1]], -1.0, 1.0)),
        TraceError,
        rf"a traced value decides a branch at {HERE} .*",
    ),
    "a mask": (
        masks,
        TraceError,
        f"this code cannot be traced: a condition is used as an index at {HERE}; "
        r"write taut\.math\.where\(condition, a, b\)",
    ),
    "np.linalg.svd": (
        lambda self, x, ref: Torque(P=np.linalg.svd(x.M)[1]),
        TraceError,
        rf"np\.linalg\.svd cannot be traced; it is used at {HERE}\. "
        r"taut\.math has what law code may use, for floats and traced values alike",
    ),
    "np.linalg.svd of a plain object array": (
        lambda self, x, ref: Torque(P=np.linalg.svd(np.array([[x.q[0], 0.0], [0.0, x.q[1]]]))[1]),
        TraceError,
        rf"this code cannot be traced: .*Error: .* at {HERE}{ANYWAY}",
    ),
    "np.sin of numbers and traced values": (
        lambda self, x, ref: Torque(P=np.sin(np.array([x.q[0], 0.0]))),
        TraceError,
        f"this code cannot be traced: a NumPy function is used on an array of numbers and traced values at {HERE}; "
        r"make the array with taut\.math\.array",
    ),
    "NaN times x": (
        lambda self, x, ref: Torque(P=x.q * np.array([1.0, math.nan])),
        TraceError,
        f"a constant in the law is NaN at {HERE}; every number in it must be one",
    ),
    "NaN": (
        lambda self, x, ref: Torque(P=np.array([1.0, math.nan])),
        TraceError,
        r"command\[1\] is NaN whatever the law is given",
    ),
    "1 / 0": (
        lambda self, x, ref: Torque(P=x.q / np.array([1.0, 0.0])),
        TraceError,
        f"the law divides by a constant zero at {HERE}",
    ),
    "1 / 0 of plain numbers": (
        lambda self, x, ref: Torque(P=x.q * (1.0 / (len(x.q) - 2))),
        UsageError,
        f"Mine fails on plain numbers, at rest at home: it divides by a constant zero at {HERE}",
    ),
    "a NumPy random number": (
        lambda self, x, ref: Torque(P=x.q * np.random.random()),  # noqa: NPY002
        TraceError,
        "Mine: two traces of the same code differ; a law must give the same at the same inputs: no random numbers, no "
        "clock, no state outside its memory",
    ),
    "a random number": (
        lambda self, x, ref: Torque(P=x.q + random.random()),
        TraceError,
        "Mine: two traces of the same code differ; .*",
    ),
    "a clock": (
        lambda self, x, ref: Torque(P=x.q * time.time()),
        TraceError,
        "Mine: two traces of the same code differ; .*",
    ),
    "a clock of small numbers": (
        lambda self, x, ref: Torque(P=x.q + 1e-15 * time.perf_counter_ns()),
        TraceError,
        "Mine: two traces of the same code differ; .*",
    ),
    "a key error": (
        lambda self, x, ref: Torque(P={"a": x.q}["b"]),
        UsageError,
        f"Mine fails on plain numbers, at rest at home: KeyError: 'b' at {HERE}",
    ),
    "an unnamed array": (
        lambda self, x, ref: x.q,
        UsageError,
        r"Mine\.command must return a taut\.Torque, Velocity or Position; got an unnamed array of shape \(2,\); "
        r"write taut\.Torque\(P=\.\.\.\)",
    ),
    "None": (
        lambda self, x, ref: None,
        UsageError,
        r"Mine\.command must return a taut\.Torque, Velocity or Position; got NoneType",
    ),
    "three torques": (
        lambda self, x, ref: Torque(P=np.ones(3)),
        ShapeError,
        r"Mine\.command must give one entry per joint, shape \(2,\); its term 'P' has shape \(3,\)",
    ),
    "one torque": (
        lambda self, x, ref: Torque(P=x.q[0]),
        ShapeError,
        r"Mine\.command must give one entry per joint, shape \(2,\); its term 'P' has shape \(\)",
    ),
    "no term": (lambda self, x, ref: Torque(), UsageError, "Terms needs one named term at least; got none"),
    "an unnamed term": (
        lambda self, x, ref: Torque(x.q),
        UsageError,
        f"Torque takes named terms at {HERE}; got an unnamed ndarray; write Torque\\(feedforward=\\.\\.\\.\\)",
    ),
    "a frame that does not exist": (
        lambda self, x, ref: Torque(P=x.J("tol").T @ np.ones(6)),
        UnknownNameError,
        r".* has no frame 'tol'; did you mean 'tool'\?.*",
    ),
    "an attribute that does not exist": (
        lambda self, x, ref: Torque(P=x.mass),
        UsageError,
        rf"Mine fails on plain numbers, at rest at home: the snapshot x has no quantity 'mass'; it has .* at {HERE}",
    ),
}


@pytest.mark.parametrize("name", FOOLS)
def test_it_is_refused_with_a_sentence(name: str) -> None:
    command, kind, message = FOOLS[name]
    with pytest.raises(TautError, match=f"^{message}$") as caught:
        compiled(command)
    assert type(caught.value) is kind


def test_a_matrix_gain_with_a_star_is_refused() -> None:
    with pytest.raises(UsageError) as caught:
        compiled(lambda self, x, ref: Torque(P=self.kp * x.q), kp=np.diag([1.0, 2.0]))
    assert "kp is a matrix and np.multiply works entry by entry, at " in str(caught.value)
    assert str(caught.value).endswith("; gains act by @: write kp @ e")


def test_a_value_kept_from_another_compile_is_refused() -> None:
    kept: list[Any] = []

    def command(self, x, ref):
        before = kept[-1] if kept else 0.0
        if not isinstance(x.q[0], float):
            kept.append(x.q)
        return Torque(
            P=before + 0.6180339887 * x.q
        )  # a number of its own: no cached code without the check serves it

    law = law_of(command, kp=Gain(1.0))()
    message = (
        f"a value of another trace is used at {HERE}; a law must not keep traced values from one compile to the next"
    )
    for _ in range(2):  # when the code is checked, and when it is traced again
        with pytest.raises(TraceError, match=f"^{message}$"):
            taut.compile(law, ARM)


def test_a_law_that_counts_its_calls_is_refused() -> None:
    calls: list[int] = []

    def command(self, x, ref):
        calls.append(1)
        return Torque(P=1.7320508 * x.q * len(calls))

    with pytest.raises(TraceError, match=r"^Mine: two traces of the same code differ; "):
        compiled(command)


def test_a_law_that_asks_whether_it_is_traced_is_caught() -> None:
    def command(self, x, ref):
        return Torque(P=x.q if isinstance(x.q[0], float) else 1.4142136 * x.q)

    with pytest.raises(TraceError, match=r"^Mine: compiled code and plain Python differ, \S+ and \S+; "):
        compiled(command)


# -------------------------------------------------------------------- what must simply be right


def formats(self, x, ref):
    text = f"{x.q[0]:.3f} {x.q}"
    return Torque(P=x.q * min(len(text), 1))


def fills_zeros(self, x, ref):
    tau = tm.zeros(2)
    tau[0] = x.q[0]
    tau[1:] = x.q[1:] - 1.0
    tau += ref.q
    return Torque(P=tau)


def wraps(self, x, ref):
    e = ref.q - x.q
    return Torque(P=(e + np.pi) % (2.0 * np.pi) - np.pi)


def guards_a_quotient(self, x, ref):
    size = tm.norm(x.q - 3.0)
    return Torque(P=tm.where(size > 1e-9, (x.q - 3.0) / size, 0.0))


RIGHT: dict[str, Callable[..., Any]] = {
    "np.clip": lambda self, x, ref: Torque(P=np.clip(x.q, -0.1, 0.1)),
    "x.q.clip": lambda self, x, ref: Torque(P=x.q.clip(-0.1, 0.1)),
    "np.max with keepdims": lambda self, x, ref: Torque(P=(x.M - np.max(x.M, axis=1, keepdims=True))[:, 0]),
    "np.max of all": lambda self, x, ref: Torque(P=x.q * np.max(x.M)),
    "condition == True": lambda self, x, ref: Torque(P=tm.where((x.q > 0.0) == True, x.q, -2.0 * x.q)),  # noqa: E712
    "~(a & b)": lambda self, x, ref: Torque(P=tm.where(~((x.q > 0.0) & (x.v > 0.0)), x.q, -2.0 * x.q)),
    "sum of conditions": lambda self, x, ref: Torque(P=x.q * np.sum(x.q > 0.0)),
    "builtin sum": lambda self, x, ref: Torque(P=np.ones(2) * sum(x.q)),
    "//": lambda self, x, ref: Torque(P=x.q // 0.1),
    "whole power": lambda self, x, ref: Torque(P=x.q**20),
    "a power by a gain": lambda self, x, ref: Torque(P=tm.sign(x.q) * tm.abs(x.q) ** (0.5 * self.kp.as_array())),
    "a list of torques": lambda self, x, ref: Torque(P=[x.q[0], 0.0]),
    "np.array of numbers": lambda self, x, ref: Torque(P=np.array([x.q[0], 0.5])),
    "np.empty_like": lambda self, x, ref: Torque(P=0.0 * np.zeros_like(x.q) + x.q),
    "gains in an array": lambda self, x, ref: Torque(P=tm.array([self.kp, x.q[1]])),
    "gains in where": lambda self, x, ref: Torque(P=tm.where(x.q > 0.0, self.kp, x.q)),
    "gain times error": lambda self, x, ref: Torque(P=self.kp * (ref.q - x.q)),
    "np.std": lambda self, x, ref: Torque(P=x.q - x.q.mean() + x.q.std()),
    "a copy": lambda self, x, ref: Torque(P=copy.deepcopy(x.q) + copy.copy(x.v)),
    "a quotient that is guarded": guards_a_quotient,
    "an angle that is wrapped": wraps,
    "zeros that are filled": fills_zeros,
    "a printed value": formats,
    "the time": lambda self, x, ref: Torque(P=ref.q * tm.sin(x.t)),
    "a jacobian": lambda self, x, ref: Torque(P=tm.jacobian(lambda q: tm.sin(q[0]) * q[1], x.q)),
    "a solve": lambda self, x, ref: Torque(P=tm.solve(x.M, ref.q - x.q)),
    "np.linalg.inv": lambda self, x, ref: Torque(P=np.linalg.inv(x.M) @ x.q),
    "a pose": lambda self, x, ref: Torque(P=x.T().p[:2]),
}
NATIVE = 1e-12  # relative to the largest torque: the bar for targets against the float run


@pytest.mark.parametrize("name", RIGHT)
def test_it_is_traced_as_it_runs(name: str) -> None:
    law = law_of(RIGHT[name], kp=Gain(1.0))(kp=2.0)
    native, plain = (taut.compile(law, ARM, engine=engine) for engine in ("native", "float"))  # type: ignore[arg-type]
    rng = np.random.default_rng(0)
    for _ in range(5):
        q, v, ref = rng.standard_normal(2), rng.standard_normal(2), taut.JointMotion(q=rng.standard_normal(2))
        wanted = plain.step(q, v, ref)
        np.testing.assert_allclose(
            native.step(q, v, ref), wanted, rtol=0.0, atol=NATIVE * max(1.0, np.abs(wanted).max())
        )


# -------------------------------------------------------------------- memory


def with_memory(command: Callable[..., Any], start: Callable[..., Any] | None = None, **memory: Any) -> taut.Law:
    fields = {"__annotations__": dict.fromkeys(memory, "Memory"), **memory, "command": command}
    return type("Mine", (taut.Law,), fields if start is None else {**fields, "start": start})()


MEMORIES: dict[str, tuple[Callable[[], taut.Law], str]] = {
    "missing": (
        lambda: with_memory(lambda self, x, ref, memory, dt: (Torque(P=x.q), {}), e_int=Memory(0.0)),
        "Mine.command does not return its memory 'e_int'; return {'e_int': ...} with the command, in every tick",
    ),
    "forgotten altogether": (
        lambda: with_memory(lambda self, x, ref, memory, dt: Torque(P=x.q), e_int=Memory(0.0)),
        "Mine.command does not return its memory 'e_int'; return {'e_int': ...} with the command, in every tick",
    ),
    "extra": (
        lambda: with_memory(
            lambda self, x, ref, memory, dt: (Torque(P=x.q), {"e_int": x.q, "more": x.q}), e_int=Memory(0.0)
        ),
        "Mine.command returns memory 'more', which has no start; declare more: Memory = Memory(0.0), or return it from "
        "start(self, x, ref)",
    ),
    "misspelt": (
        lambda: with_memory(
            lambda self, x, ref, memory, dt: (Torque(P=memory.e_imt), {"e_int": x.q}), e_int=Memory(0.0)
        ),
        "the memory of Mine has no entry 'e_imt'; did you mean 'e_int'?",
    ),
    "of another shape in the next tick": (
        lambda: with_memory(
            lambda self, x, ref, memory, dt: (Torque(P=x.q), {"buffer": np.append(memory.buffer, 1.0)}),
            start=lambda self, x, ref: {"buffer": np.zeros(1)},
        ),
        "memory 'law.buffer' has shape (3,) in one tick and (4,) in the next; it must keep its shape",
    ),
}


@pytest.mark.parametrize("name", MEMORIES)
def test_memory_that_does_not_fit_is_told(name: str) -> None:
    law, message = MEMORIES[name]
    with pytest.raises(TautError) as caught:
        taut.compile(law(), ARM)
    assert str(caught.value) == message


def test_memory_that_is_no_number_is_told() -> None:
    law = with_memory(lambda self, x, ref, memory, dt: (Torque(P=x.q), {"mode": "free"}), mode=Memory(0.0))
    with pytest.raises(TautError) as caught:
        taut.compile(law, ARM)
    assert str(caught.value) == "law.mode must be numbers in a rectangular array; got 'free'"


# -------------------------------------------------------------------- the class, and its gains


def test_a_law_without_a_command_is_refused() -> None:
    with pytest.raises(UsageError) as caught:
        type("Mine", (taut.Law,), {})
    assert str(caught.value) == "law Mine has no command(self, x, ref)"


@pytest.mark.parametrize(
    ("command", "got"),
    [
        (lambda self, x: None, "self, x"),
        (lambda self, x, ref, memory: None, "self, x, ref, memory"),
        (lambda self, state, ref: None, "self, state, ref"),
        (lambda self, x, ref, dt, memory: None, "self, x, ref, dt, memory"),
    ],
)
def test_a_command_with_other_arguments_is_refused(command: Callable[..., Any], got: str) -> None:
    with pytest.raises(UsageError) as caught:
        law_of(command)
    assert str(caught.value) == (
        f"law Mine: command must take (self, x, ref) or (self, x, ref, memory, dt); got ({got})"
    )


def test_a_law_that_inherits_from_a_law_is_refused() -> None:
    with pytest.raises(UsageError) as caught:
        type("Mine", (taut.laws.PID,), {"command": lambda self, x, ref: None})
    assert str(caught.value) == (
        "law Mine inherits from law PID; inherit from taut.Law and hold the other law in a field"
    )


PID = taut.laws.PID
GAINS: list[tuple[str, Callable[[], Any], type[TautError], str]] = [
    ("misspelt", lambda: PID(kp=1.0, kdd=1.0), UnknownNameError, "PID has no field 'kdd'; did you mean 'kd'?"),
    ("missing", lambda: PID(kd=1.0), UsageError, "PID needs kp [N m/rad | N/m]"),
    (
        "positional",
        lambda: PID(1.0),
        UsageError,
        "PID takes its fields by name; got 1 without; write PID(kp=..., kd=..., ki=..., integral=...)",
    ),
    ("negative", lambda: PID(kp=-1.0), RangeError, "kp must be >= 0 [N m/rad | N/m]; got -1.0"),
    ("negative entry", lambda: PID(kp=[1.0, -3.0]), RangeError, "kp[1] must be >= 0 [N m/rad | N/m]; got -3.0"),
    ("NaN", lambda: PID(kp=math.nan), RangeError, "kp must be finite [N m/rad | N/m]; got nan"),
    ("infinite", lambda: PID(kp=[1.0, math.inf]), RangeError, "kp[1] must be finite [N m/rad | N/m]; got inf"),
    ("a text", lambda: PID(kp="10"), ShapeError, "kp must be numbers [N m/rad | N/m]; got '10'"),
    ("None", lambda: PID(kp=None), ShapeError, "kp must be numbers [N m/rad | N/m]; got None"),
    (
        "a truth value",
        lambda: PID(kp=True),
        ShapeError,
        "kp must be real numbers [N m/rad | N/m]; got an array of bool",
    ),
    (
        "ragged",
        lambda: PID(kp=[[1.0], [1.0, 2.0]]),
        ShapeError,
        "kp must be numbers [N m/rad | N/m] in a rectangular array; got [[1.0], [1.0, 2.0]]",
    ),
    ("empty", lambda: PID(kp=[]), ShapeError, "kp must be a number, (n,) or (n, n) [N m/rad | N/m]; got shape (0,)"),
    (
        "oblong",
        lambda: PID(kp=np.ones((2, 3))),
        ShapeError,
        "kp must be a number, (n,) or (n, n) [N m/rad | N/m]; got shape (2, 3)",
    ),
    (
        "not symmetric",
        lambda: PID(kp=[[1.0, 0.5], [0.0, 1.0]]),
        RangeError,
        "kp must be a symmetric matrix [N m/rad | N/m]; it differs from its transpose by 0.5",
    ),
    (
        "indefinite",
        lambda: PID(kp=[[1.0, 2.0], [2.0, 1.0]]),
        RangeError,
        "kp must be positive semidefinite [N m/rad | N/m]; its smallest eigenvalue is -1",
    ),
    (
        "for three joints",
        lambda: taut.compile(PID(kp=[1.0, 2.0, 3.0]), ARM),
        ShapeError,
        "kp must be a number, (2,) or (2, 2) [N m/rad | N/m] for 2 joints; got shape (3,)",
    ),
    (
        "an option",
        lambda: PID(kp=1.0, integral=taut.laws.Integral(anti_windup="clip")),
        UsageError,
        "anti_windup must be one of 'clamping', 'back-calculation', 'none'; got 'clip'",
    ),
    (
        "gravity twice",
        lambda: taut.compile(taut.laws.GravityPID(kp=1.0, kd=1.0) + taut.laws.GravityCompensation(), ARM),
        MatchError,
        "GravityPID + GravityCompensation: both compensate gravity, so it would be added twice; use one law that does "
        "not (PID instead of GravityPID or ComputedTorque)",
    ),
]


@pytest.mark.parametrize(("what", "make", "kind", "message"), GAINS, ids=[case[0] for case in GAINS])
def test_gains_that_are_none_get_one_sentence(
    what: str, make: Callable[[], Any], kind: type[TautError], message: str
) -> None:
    with pytest.raises(kind) as caught:
        make()
    assert str(caught.value) == message
