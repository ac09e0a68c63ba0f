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
from refusals import refused

import taut
from taut import Gain, Memory, TautError, Torque
from taut import math as tm
from taut.errors import MatchError, RangeError, ShapeError, TraceError, UnknownNameError, UsageError

ARM = taut.load_arm("planar2")


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


FOOLS: dict[str, tuple[Callable[..., Any], type[TautError]]] = {
    "tau[0] = x.q[0]": (assigns_an_entry, TraceError),
    "tau[:] = x.q": (assigns_a_slice, TraceError),
    "tau += x.q": (adds_in_place, TraceError),
    "x.q -= ref.q": (changes_what_it_is_given, UsageError),
    "x.q[0] = 0": (changes_an_entry_of_what_it_is_given, UsageError),
    "float(x)": (lambda self, x, ref: Torque(P=np.ones(2) * float(x.q[0])), TraceError),
    "math.sin(x)": (lambda self, x, ref: Torque(P=np.ones(2) * math.sin(x.q[0])), TraceError),
    "int(x)": (lambda self, x, ref: Torque(P=np.ones(2) * int(x.q[0])), TraceError),
    "round(x)": (lambda self, x, ref: Torque(P=np.ones(2) * round(x.q[0])), TraceError),
    "if": (branches, TraceError),
    "while": (loops, TraceError),
    "min()": (lambda self, x, ref: Torque(P=np.ones(2) * min(x.q)), TraceError),
    "max(x, 0)": (lambda self, x, ref: Torque(P=np.ones(2) * max(x.q[0], 0.0)), TraceError),
    "sorted": (lambda self, x, ref: Torque(P=np.array(sorted(x.q))), TraceError),
    "np.clip on a list": (lambda self, x, ref: Torque(P=np.clip([x.q[0], x.q[1]], -1.0, 1.0)), TraceError),
    "a mask": (masks, TraceError),
    "np.linalg.svd": (lambda self, x, ref: Torque(P=np.linalg.svd(x.M)[1]), TraceError),
    "np.linalg.svd of a plain object array": (
        lambda self, x, ref: Torque(P=np.linalg.svd(np.array([[x.q[0], 0.0], [0.0, x.q[1]]]))[1]),
        TraceError,
    ),
    "np.sin of numbers and traced values": (
        lambda self, x, ref: Torque(P=np.sin(np.array([x.q[0], 0.0]))),
        TraceError,
    ),
    "NaN times x": (lambda self, x, ref: Torque(P=x.q * np.array([1.0, math.nan])), TraceError),
    "NaN": (lambda self, x, ref: Torque(P=np.array([1.0, math.nan])), TraceError),
    "1 / 0": (lambda self, x, ref: Torque(P=x.q / np.array([1.0, 0.0])), TraceError),
    "1 / 0 of plain numbers": (lambda self, x, ref: Torque(P=x.q * (1.0 / (len(x.q) - 2))), UsageError),
    "a NumPy random number": (lambda self, x, ref: Torque(P=x.q * np.random.random()), TraceError),  # noqa: NPY002
    "a random number": (lambda self, x, ref: Torque(P=x.q + random.random()), TraceError),
    "a clock": (lambda self, x, ref: Torque(P=x.q * time.time()), TraceError),
    "a clock of small numbers": (lambda self, x, ref: Torque(P=x.q + 1e-15 * time.perf_counter_ns()), TraceError),
    "a key error": (lambda self, x, ref: Torque(P={"a": x.q}["b"]), UsageError),
    "an unnamed array": (lambda self, x, ref: x.q, UsageError),
    "None": (lambda self, x, ref: None, UsageError),
    "three torques": (lambda self, x, ref: Torque(P=np.ones(3)), ShapeError),
    "one torque": (lambda self, x, ref: Torque(P=x.q[0]), ShapeError),
    "no term": (lambda self, x, ref: Torque(), UsageError),
    "an unnamed term": (lambda self, x, ref: Torque(x.q), UsageError),
    "a frame that does not exist": (lambda self, x, ref: Torque(P=x.J("tol").T @ np.ones(6)), UnknownNameError),
    "an attribute that does not exist": (lambda self, x, ref: Torque(P=x.inverse_dynamic), UsageError),
}


@pytest.mark.parametrize("name", FOOLS)
def test_it_is_refused_with_a_sentence(name: str) -> None:
    command, kind = FOOLS[name]
    with refused(TautError) as caught:
        compiled(command)
    assert type(caught.value) is kind


def test_a_matrix_gain_with_a_star_is_refused() -> None:
    with refused(UsageError):
        compiled(lambda self, x, ref: Torque(P=self.kp * x.q), kp=np.diag([1.0, 2.0]))


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
    for _ in range(2):  # when the code is checked, and when it is traced again
        with refused(TraceError):
            taut.compile(law, ARM)


def test_a_law_that_counts_its_calls_is_refused() -> None:
    calls: list[int] = []

    def command(self, x, ref):
        calls.append(1)
        return Torque(P=1.7320508 * x.q * len(calls))

    with refused(TraceError):
        compiled(command)


def test_a_law_that_asks_whether_it_is_traced_is_caught() -> None:
    def command(self, x, ref):
        return Torque(P=x.q if isinstance(x.q[0], float) else 1.4142136 * x.q)

    with refused(TraceError):
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


MEMORIES: dict[str, Callable[[], taut.Law]] = {
    "missing": lambda: with_memory(lambda self, x, ref, memory, dt: (Torque(P=x.q), {}), e_int=Memory(0.0)),
    "forgotten altogether": lambda: with_memory(lambda self, x, ref, memory, dt: Torque(P=x.q), e_int=Memory(0.0)),
    "extra": lambda: with_memory(
        lambda self, x, ref, memory, dt: (Torque(P=x.q), {"e_int": x.q, "more": x.q}), e_int=Memory(0.0)
    ),
    "misspelt": lambda: with_memory(
        lambda self, x, ref, memory, dt: (Torque(P=memory.e_imt), {"e_int": x.q}), e_int=Memory(0.0)
    ),
    "of another shape in the next tick": lambda: with_memory(
        lambda self, x, ref, memory, dt: (Torque(P=x.q), {"buffer": np.append(memory.buffer, 1.0)}),
        start=lambda self, x, ref: {"buffer": np.zeros(1)},
    ),
}


@pytest.mark.parametrize("name", MEMORIES)
def test_memory_that_does_not_fit_is_told(name: str) -> None:
    law = MEMORIES[name]
    with refused(TautError):
        taut.compile(law(), ARM)


def test_memory_that_is_no_number_is_told() -> None:
    law = with_memory(lambda self, x, ref, memory, dt: (Torque(P=x.q), {"mode": "free"}), mode=Memory(0.0))
    with refused(TautError):
        taut.compile(law, ARM)


# -------------------------------------------------------------------- the class, and its gains


def test_a_law_without_a_command_is_refused() -> None:
    with refused(UsageError):
        type("Mine", (taut.Law,), {})


@pytest.mark.parametrize(
    "command",
    [
        lambda self, x: None,
        lambda self, x, ref, memory: None,
        lambda self, state, ref: None,
        lambda self, x, ref, dt, memory: None,
    ],
)
def test_a_command_with_other_arguments_is_refused(command: Callable[..., Any]) -> None:
    with refused(UsageError):
        law_of(command)


def test_a_law_that_inherits_from_a_law_is_refused() -> None:
    with refused(UsageError):
        type("Mine", (taut.laws.PID,), {"command": lambda self, x, ref: None})


PID = taut.laws.PID
GAINS: list[tuple[str, Callable[[], Any], type[TautError]]] = [
    ("misspelt", lambda: PID(kp=1.0, kdd=1.0), UnknownNameError),
    ("missing", lambda: PID(kd=1.0), UsageError),
    ("positional", lambda: PID(1.0), UsageError),
    ("negative", lambda: PID(kp=-1.0), RangeError),
    ("negative entry", lambda: PID(kp=[1.0, -3.0]), RangeError),
    ("NaN", lambda: PID(kp=math.nan), RangeError),
    ("infinite", lambda: PID(kp=[1.0, math.inf]), RangeError),
    ("a text", lambda: PID(kp="10"), ShapeError),
    ("None", lambda: PID(kp=None), ShapeError),
    ("a truth value", lambda: PID(kp=True), ShapeError),
    ("ragged", lambda: PID(kp=[[1.0], [1.0, 2.0]]), ShapeError),
    ("empty", lambda: PID(kp=[]), ShapeError),
    ("oblong", lambda: PID(kp=np.ones((2, 3))), ShapeError),
    ("not symmetric", lambda: PID(kp=[[1.0, 0.5], [0.0, 1.0]]), RangeError),
    ("indefinite", lambda: PID(kp=[[1.0, 2.0], [2.0, 1.0]]), RangeError),
    ("for three joints", lambda: taut.compile(PID(kp=[1.0, 2.0, 3.0]), ARM), ShapeError),
    ("an option", lambda: PID(kp=1.0, integral=taut.laws.Integral(anti_windup="clip")), UsageError),
    (
        "gravity twice",
        lambda: taut.compile(taut.laws.GravityPID(kp=1.0, kd=1.0) + taut.laws.GravityCompensation(), ARM),
        MatchError,
    ),
]


@pytest.mark.parametrize(("what", "make", "kind"), GAINS, ids=[case[0] for case in GAINS])
def test_gains_that_are_none_get_one_sentence(what: str, make: Callable[[], Any], kind: type[TautError]) -> None:
    with refused(kind):
        make()
