"""To CasADi and back: the same numbers, and sentences where there is no way."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest
from law_oracles import LAWS, loaded

import taut
from taut import math as tm
from taut.codegen.layout import Block
from taut.codegen.program import trace
from taut.errors import MissingExtraError, TraceError, UsageError

AGREED = 1e-12  # relative to the largest torque
ROUNDING = 1e-14


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("name", ["planar2", "gantry3", "kinova"])
def test_a_tick_as_a_casadi_function_gives_the_native_numbers(name: str, law: str) -> None:
    arm = loaded(name)
    torque = law != "VelocityPI"
    ctrl = taut.compile(LAWS[law](arm.n), arm, limits=taut.Limits(tau=30.0, tau_dot=2e4) if torque else None)
    program, bound = ctrl.program, ctrl.bind()
    function = taut.to_casadi(program)
    rng = np.random.default_rng(0)
    for _ in range(3):
        bound.q[:], bound.v[:] = rng.standard_normal((2, arm.n))
        bound.ref.q[:], bound.ref.v[:], bound.ref.a[:] = rng.standard_normal((3, arm.n))
        blocks = ctrl._kernel.blocks
        if ctrl.ticks == 0:
            bound.tick()  # memory starts
        memory = blocks.memory.copy()
        bound.tick()
        outputs, after = function(blocks.inputs, blocks.parameters, memory)
        wanted = np.array(outputs).ravel()
        scale = max(1.0, np.abs(wanted).max())
        np.testing.assert_allclose(bound.command, wanted, rtol=0.0, atol=AGREED * scale)
        np.testing.assert_allclose(blocks.memory, np.array(after).ravel(), rtol=0.0, atol=AGREED * scale)


def test_names_of_the_casadi_function() -> None:
    function = taut.to_casadi(taut.compile(taut.laws.PID(kp=1.0), taut.load_arm("planar2")).program, "pid")
    assert function.name() == "pid"
    assert function.name_in() == ["inputs", "parameters", "memory"]
    assert function.name_out() == ["outputs", "new_memory"]


def test_a_program_goes_there_and_back() -> None:
    ctrl = taut.compile(taut.laws.ComputedTorque(kp=100.0, kd=20.0, ki=1.0), taut.load_arm("planar3"))
    program = ctrl.program
    back = taut.from_casadi(taut.to_casadi(program))
    sizes = [program.inputs.size, program.parameters.size, program.memory.size]
    again = trace(
        lambda i, p, m: (
            dict(zip(("y", "m"), back(i["i"], i["p"], i["m"]), strict=True)),
            {},
        ),
        Block.of(dict(zip("ipm", ((size,) for size in sizes), strict=True))),
        Block(),
        Block(),
    )
    assert again.operations <= program.operations * 1.3  # CasADi says x + x and x x in words of its own
    rng = np.random.default_rng(0)
    x = rng.standard_normal(sum(sizes))
    nodes = [*program.output_nodes, *program.memory_nodes]
    np.testing.assert_allclose(
        again.graph.evaluate(again.output_nodes, x), program.graph.evaluate(nodes, x), rtol=1e-11, atol=1e-11
    )


OPERATIONS: dict[str, Callable[[Any, Any], Any]] = {
    "add": lambda x, y: x + y,
    "twice": lambda x, y: x + x,
    "sub": lambda x, y: x - y,
    "mul": lambda x, y: x * y,
    "square": lambda x, y: x**2,
    "div": lambda x, y: x / y,
    "inverse": lambda x, y: 1.0 / x,
    "neg": lambda x, y: -x,
    "sqrt": lambda x, y: ca.sqrt(x),
    "sin": lambda x, y: ca.sin(x),
    "cos": lambda x, y: ca.cos(x),
    "tan": lambda x, y: ca.tan(x),
    "asin": lambda x, y: ca.asin(x / 3.0),
    "acos": lambda x, y: ca.acos(x / 3.0),
    "atan": lambda x, y: ca.atan(x),
    "atan2": lambda x, y: ca.atan2(x, -y),
    "exp": lambda x, y: ca.exp(x),
    "log": lambda x, y: ca.log(x),
    "tanh": lambda x, y: ca.tanh(x),
    "sinh": lambda x, y: ca.sinh(x),
    "cosh": lambda x, y: ca.cosh(x),
    "hypot": lambda x, y: ca.hypot(x, y),
    "abs": lambda x, y: ca.fabs(x - y),
    "floor": lambda x, y: ca.floor(-x),
    "ceil": lambda x, y: ca.ceil(-x),
    "fmod": lambda x, y: ca.fmod(-x, y),
    "sign": lambda x, y: ca.sign(x - y),
    "min": lambda x, y: ca.fmin(x, y),
    "max": lambda x, y: ca.fmax(x, y),
    "power": lambda x, y: x**y,
    "constant power": lambda x, y: x**1.7,
    "<": lambda x, y: x < y,
    "<=": lambda x, y: x <= y,
    "==": lambda x, y: x == y,
    "!=": lambda x, y: x != y,
    "not": lambda x, y: ca.logic_not(x < y),
    "and": lambda x, y: ca.logic_and(x < y, x > 0.5),
    "or": lambda x, y: ca.logic_or(x < y, x > 0.5),
    "if_else": lambda x, y: ca.if_else(x < y, x, y * 2.0),
    "copysign": lambda x, y: ca.copysign(x, -y),
}


@pytest.mark.parametrize("name", OPERATIONS)
def test_every_operation_comes_back_from_casadi(name: str) -> None:
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    function = ca.Function("f", [x, y], [OPERATIONS[name](x, y)])
    ours = taut.from_casadi(function)
    native = taut.native(lambda a, b: ours(a, b)[0], a=(), b=())
    for values in ((0.7, 1.3), (1.3, 0.7), (0.7, 0.7), (2.5, 0.4)):
        wanted = float(function(*values))
        assert float(ours(*values)[0]) == pytest.approx(wanted, rel=ROUNDING, abs=ROUNDING)
        assert float(native(*values)) == pytest.approx(wanted, rel=ROUNDING, abs=ROUNDING)


def test_shapes_come_back_as_arrays() -> None:
    x, M = ca.SX.sym("x", 3), ca.SX.sym("M", 3, 2)
    function = ca.Function("f", [x, M], [M.T @ x, M, ca.norm_2(x), ca.diag(x)])
    ours = taut.from_casadi(function)
    a, m = np.array([1.0, 2.0, 2.0]), np.arange(6.0).reshape(3, 2)
    vector, matrix, length, diagonal = ours(a, m)
    np.testing.assert_allclose(vector, m.T @ a)
    np.testing.assert_array_equal(matrix, m)  # by rows here, by columns there
    assert length.tolist() == [3.0]
    np.testing.assert_array_equal(diagonal, np.diag(a))  # zeros that CasADi does not store


def test_a_casadi_function_inside_a_law() -> None:
    q = ca.MX.sym("q", 2)  # MX: expanded on the way
    spring = ca.Function("spring", [q], [-3.0 * ca.sin(q)])
    pull = taut.from_casadi(spring)

    class Spring(taut.Law):
        kd: taut.Gain

        def command(self, x: Any, ref: Any) -> Any:
            return taut.Torque(spring=pull(x.q), D=-(self.kd @ x.v))

    arm = taut.load_arm("planar2")
    for engine in ("native", "float"):
        ctrl = taut.compile(Spring(kd=0.5), arm, engine=engine)  # type: ignore[arg-type]
        tau = ctrl.step([0.3, -0.4], [1.0, 2.0], taut.JointMotion(q=[0.0, 0.0]))
        np.testing.assert_allclose(tau, -3.0 * np.sin([0.3, -0.4]) - 0.5 * np.array([1.0, 2.0]), rtol=ROUNDING)
        assert sorted(ctrl.terms) == ["D", "spring"]


def test_a_derivative_through_a_casadi_function() -> None:
    x = ca.SX.sym("x", 2)
    ours = taut.from_casadi(ca.Function("f", [x], [ca.vertcat(x[0] * x[1], ca.sin(x[0]))]))
    np.testing.assert_allclose(tm.jacobian(ours, [0.5, 2.0]), [[2.0, 0.5], [np.cos(0.5), 0.0]], rtol=ROUNDING)


def some_function() -> Any:
    x = ca.SX.sym("x", 2)
    return ca.Function("f", [x], [x])


@pytest.mark.parametrize(
    ("call", "kind", "message"),
    [
        (lambda: taut.from_casadi(3), UsageError, "from_casadi takes a casadi.Function; got int"),
        (lambda: taut.from_casadi(some_function())(), UsageError, "f takes 1 arrays; got 0"),
        (
            lambda: taut.from_casadi(some_function())([1.0, 2.0, 3.0]),
            UsageError,
            "f: argument 0 needs 2 numbers; got 3",
        ),
        (
            lambda: taut.to_casadi(taut.laws.PID(kp=1.0)),
            UsageError,
            "to_casadi takes a traced program, such as ctrl.program; got PID",
        ),
        (
            lambda: taut.from_casadi(
                ca.Function("f", [ca.SX.sym("x")], [ca.erf(ca.SX.sym("x"))], {"allow_free": True})
            )(1.0),
            UsageError,
            "f has free variables; give them as inputs",
        ),
    ],
    ids=["no function", "too few", "too long", "no program", "free variables"],
)
def test_what_does_not_fit_gets_one_sentence(call: Callable[[], Any], kind: type[Exception], message: str) -> None:
    with pytest.raises(kind) as caught:
        call()
    assert str(caught.value) == message


def test_an_operation_that_the_graph_does_not_have_is_named() -> None:
    x = ca.SX.sym("x")
    with pytest.raises(TraceError) as caught:
        taut.from_casadi(ca.Function("f", [x], [ca.erf(x)]))(1.0)
    assert str(caught.value) == "f uses CasADi's OP_ERF, which taut's graph does not have"


def test_a_solver_in_a_function_is_named() -> None:
    x = ca.MX.sym("x")
    finder = ca.rootfinder("find", "newton", {"x": x, "g": x**2 - 2.0})
    with pytest.raises(TraceError) as caught:
        taut.from_casadi(finder)(1.0, [])
    assert str(caught.value) == "find uses CasADi's OP_CALL, which taut's graph does not have"


def test_without_casadi_the_command_that_installs_it_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "casadi", None)
    with pytest.raises(MissingExtraError) as caught:
        taut.from_casadi(3)
    assert str(caught.value) == (
        "the way to and from CasADi needs the package 'casadi', which is not installed; "
        'pip install -e ".[oracles]" installs it'
    )


@pytest.mark.parametrize(
    "build",
    [
        lambda x: ca.if_else(x, 1.0, 2.0),
        lambda x: ca.logic_not(x),
        lambda x: ca.logic_and(x, x - 3.0),
        lambda x: ca.logic_or(x, x - 3.0),
        lambda x: ca.logic_and(x > 0.0, ca.logic_not(x > 2.0)),
    ],
    ids=["if_else", "not", "and", "or", "of comparisons"],
)
def test_any_number_but_zero_is_true_as_in_casadi(build: Any) -> None:
    x = ca.SX.sym("x")
    f = ca.Function("f", [x], [build(x)])
    ours = taut.native(taut.from_casadi(f), x=())
    for value in (0.0, 1.0, 3.0, -1.0, 0.5, 5.0):
        expected = float(f(value))
        assert np.ravel(ours(np.array(value))).tolist() == [expected]
        assert np.ravel(taut.from_casadi(f)(value)).tolist() == [expected]


def test_what_is_no_number_is_nan_or_infinite_as_in_compiled_code() -> None:
    x = ca.SX.sym("x")
    f = ca.Function("f", [x], [ca.vertcat(x**2.5, 1.0 / x)])
    ours = taut.native(taut.from_casadi(f), x=())
    with np.errstate(all="ignore"):
        for value in (-2.0, 0.0, 2.0):
            np.testing.assert_allclose(ours(np.array(value)), np.array(f(value)).ravel(), rtol=1e-14)
            np.testing.assert_allclose(taut.from_casadi(f)(value), np.array(f(value)).ravel(), rtol=1e-14)
