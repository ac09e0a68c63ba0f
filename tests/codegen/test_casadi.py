"""A program as a CasADi function: the same numbers, and sentences where there is none."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from law_oracles import LAWS, loaded
from refusals import refused

import taut
from taut.errors import MissingExtraError, UsageError

AGREED = 1e-12  # relative to the largest torque


@pytest.mark.part(1)
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


def test_no_program_and_no_casadi_get_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    with refused(UsageError):
        taut.to_casadi(taut.laws.PID(kp=1.0))
    monkeypatch.setitem(sys.modules, "casadi", None)
    with refused(MissingExtraError):
        taut.to_casadi(taut.compile(taut.laws.PID(kp=1.0), taut.load_arm("planar2")).program)
