"""A tick for torch: its own check of the derivative by everything that goes in, over ticks with memory."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import taut
from taut import Gain, Torque
from taut.errors import ShapeError, UnknownNameError, UsageError

torch = pytest.importorskip("torch")
L, LANES = taut.laws, 2


class Feels(taut.Law):
    """A matrix gain, a measured force, and branches whose other side is infinite.

    Law:          tau = K (q_des - q) + J^T F_ext + |e| e
    """

    K: Gain = Gain()

    def command(self, x: Any, ref: Any) -> Any:
        e = ref.q - x.q
        length = taut.math.norm(e)
        direction = taut.math.where(length > 0.0, e / taut.math.where(length > 0.0, length, 1.0), 0.0 * e)
        return Torque(P=self.K @ e, force=x.J().T @ x.F_ext, more=length * length * direction)


CASES: dict[str, tuple[Any, str, dict[str, Any]]] = {
    "PID": (L.PID(kp=[9.0, 4.0], kd=3.0, ki=5.0), "planar2", {"limits": taut.Limits(tau=[90.0, 90.0])}),
    "difference": (L.GravityPID(kp=50.0, kd=5.0), "gantry3", {"sensing": taut.Sensing(velocity="difference")}),
    "computed torque": (L.ComputedTorque(kp=100.0, kd=20.0, ki=10.0), "ur5", {}),
    "impedance": (L.Impedance(K=(500.0, 30.0), B=(40.0, 4.0)), "panda", {}),
    "force": (Feels(K=np.diag([3.0, 2.0])), "planar2", {}),
}


def arguments(ctrl: Any) -> dict[str, Any]:
    """Tensors of all that goes in, by name; what belongs to the reference, or is a parameter, has its path."""
    torch.manual_seed(0)
    arm = ctrl.arm
    x = taut.snapshot(arm, arm.home)
    at = {"p": x.T().p, "R": x.T().R, "q": arm.home}
    given = {"q": torch.tensor(arm.home) + 0.2 * torch.randn(LANES, arm.n, dtype=torch.float64)}
    sizes = {"F_ext": 6}
    for name in ctrl.side.takes:
        given[name] = 0.3 * torch.randn(LANES, sizes.get(name, arm.n), dtype=torch.float64)
    for name, shape in ctrl.law.reference.fields(arm.n).items():
        base = torch.tensor(at.get(name, np.zeros(shape))).expand(LANES, *shape)
        given[f"ref.{name}"] = base + (0.0 if name == "R" else 0.1) * torch.randn(LANES, *shape, dtype=torch.float64)
    for path in ctrl.parameters:
        if path.startswith("law.") or path == "model.payload.mass":
            value = torch.tensor(np.array(ctrl.parameters[path]) + (path == "model.payload.mass"))
            given[path] = value.expand(LANES, *value.shape)
    return {name: value.clone().requires_grad_() for name, value in given.items()}


def ticks(ctrl: Any, count: int, names: list[str]) -> Any:
    """A function of tensors: the command after some ticks, and the memory."""
    step = taut.tensors.differentiable(ctrl)

    def run(*tensors: Any) -> Any:
        given = dict(zip(names, tensors, strict=True))
        ref = {name[4:]: value for name, value in given.items() if name.startswith("ref.")}
        parameters = {name: value for name, value in given.items() if name.startswith(("law.", "model."))}
        measured = {name: value for name, value in given.items() if "." not in name}
        command, memory = step(**measured, ref=ref, parameters=parameters)
        for _ in range(count - 1):
            measured["q"] = measured["q"] + 0.01 * command.tanh()
            command, memory = step(**measured, ref=ref, parameters=parameters, memory=memory)
        return (command, *(value for path, value in memory.items() if path != "t"))

    return run


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("count", [1, 3])
def test_the_derivative_passes_torchs_own_check(case: str, count: int) -> None:
    law, arm, options = CASES[case]
    ctrl = taut.compile(law, taut.load_arm(arm), **options)
    given = arguments(ctrl)
    assert torch.autograd.gradcheck(ticks(ctrl, count, list(given)), tuple(given.values()), atol=1e-4, rtol=1e-4)


@pytest.mark.parametrize("case", CASES)
def test_the_command_is_that_of_the_controller(case: str) -> None:
    law, arm, options = CASES[case]
    ctrl = taut.compile(law, taut.load_arm(arm), **options)
    given = {name: value.detach() for name, value in arguments(ctrl).items()}
    command, *_ = ticks(ctrl, 1, list(given))(*given.values())
    for path in ctrl.parameters:
        if path in given:
            ctrl.parameters[path] = given[path][1].numpy()
    ref = {name[4:]: value[1].numpy() for name, value in given.items() if name.startswith("ref.")}
    sample = ctrl.law.reference.of(ref)
    one = {name: value[1].numpy() for name, value in given.items() if "." not in name}
    np.testing.assert_allclose(command[1].numpy(), ctrl.step(**one, ref=sample), rtol=1e-12, atol=1e-12)


def test_single_precision_and_a_gradient_where_the_error_is_zero() -> None:
    ctrl = taut.compile(Feels(K=np.eye(2)), taut.load_arm("planar2"))
    step = taut.tensors.differentiable(ctrl)
    q = torch.zeros(3, 2, requires_grad=True)
    command, _ = step(q, ref={"q": torch.zeros(2), "v": torch.zeros(2), "a": torch.zeros(2)}, F_ext=torch.zeros(6))
    assert command.dtype == torch.float32
    command.sum().backward()
    np.testing.assert_allclose(q.grad.numpy(), -np.ones((3, 2)), atol=1e-6)


def test_a_lane_that_is_not_finite_has_no_derivative_and_the_others_theirs() -> None:
    ctrl = taut.compile(L.ComputedTorque(kp=9.0, kd=6.0), taut.load_arm("planar2"))
    step, ref = taut.tensors.differentiable(ctrl), taut.JointMotion(q=[0.1, 0.2])
    q = torch.full((9, 2), 0.3, dtype=torch.float64)
    q[4, 0] = torch.nan
    q.requires_grad_()
    command, _ = step(q, torch.zeros_like(q), ref)
    command.sum().backward()
    finite = np.delete(np.arange(9), 4)
    assert torch.isnan(command[4]).all()
    assert torch.isnan(q.grad[4]).all()
    np.testing.assert_array_equal(q.grad[finite].numpy(), np.tile(q.grad[0].numpy(), (8, 1)))


def test_tensors_that_do_not_fit_are_refused() -> None:
    ctrl = taut.compile(L.PID(kp=9.0, ki=1.0), taut.load_arm("planar2"))
    step, ref = taut.tensors.differentiable(ctrl), taut.JointMotion(q=[0.1, 0.2])
    q = torch.zeros(3, 2, dtype=torch.float64)
    _, memory = step(q, q, ref)
    wrong: list[tuple[Any, dict[str, Any]]] = [
        (UsageError, {"q": q.half()}),
        (UsageError, {"q": torch.zeros(3, 2, device="meta", dtype=torch.float64)}),
        (UsageError, {"v": q.float()}),
        (UsageError, {"v": torch.zeros(3, 2, device="meta", dtype=torch.float64)}),
        (ShapeError, {"q": q[0]}),
        (ShapeError, {"q": q.numpy()}),
        (ShapeError, {"v": torch.zeros(2, 2, dtype=torch.float64)}),
        (UsageError, {"v": None}),
        (UsageError, {"ref": {"q": q}}),
        (UnknownNameError, {"parameters": {"law.kq": q}}),
        (ShapeError, {"parameters": {"law.kp": torch.zeros(4, dtype=torch.float64)}}),
        (ShapeError, {"parameters": {"law.kp": "much"}}),
        (UsageError, {"memory": {"t": memory["t"]}}),
    ]
    for kind, change in wrong:
        with pytest.raises(kind):
            step(**{"q": q, "v": q, "ref": ref, **change})
