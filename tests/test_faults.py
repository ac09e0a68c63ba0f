"""Numbers that are none in what is measured or asked for: refused in that tick, named, and without a trace."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any, Final

import numpy as np
import pytest

import taut

LAWS: Final = taut.laws
PANDA: Final = taut.load_arm("panda")
HOME: Final = PANDA.home
POSE: Final = taut.TaskMotion(pose=taut.snapshot(PANDA, HOME).T())
CASES: Final[dict[str, tuple[taut.Law, Callable[..., Any]]]] = {
    "PID": (LAWS.PID(kp=10.0, kd=1.0, ki=1.0), lambda q=HOME, v=None, a=None: taut.JointMotion(q=q, v=v, a=a)),
    "ComputedTorque": (LAWS.ComputedTorque(kp=100.0, kd=20.0, ki=5.0), lambda q=HOME, v=None, a=None: taut.JointMotion(q=q, v=v, a=a)),
    "GravityPID": (LAWS.GravityPID(kp=10.0, kd=1.0), lambda q=HOME, v=None, a=None: taut.JointMotion(q=q, v=v, a=a)),
    "Impedance": (LAWS.Impedance(K=(500.0, 20.0), zeta=0.7), lambda: POSE),
    "Impedance with a mass": (LAWS.Impedance(K=(500.0, 20.0), B=(60.0, 4.0), D=(5.0, 0.3)), lambda: POSE),
    "Stiffness": (LAWS.Stiffness(K=(500.0, 20.0), kd=0.2), lambda: POSE),
    "ForceControl": (LAWS.ForceControl(kfp=0.5, kfi=3.0, kdamp=(40.0, 1.0)), lambda: taut.TaskForce(F_app=[0.0, 0.0, -5.0, 0.0, 0.0, 0.0])),
}  # fmt: skip
NONE: Final = (np.nan, np.inf, -np.inf)


@pytest.mark.bars
@pytest.mark.parametrize("limits", [None, taut.Limits.of(PANDA)], ids=["no limits", "limits"])
@pytest.mark.parametrize("engine", ["native", "float"])
@pytest.mark.parametrize("case", CASES)
def test_a_number_that_is_none_is_refused_in_its_tick_and_leaves_no_trace(
    case: str,
    engine: Any,
    limits: taut.Limits | None,
    share: Callable[[int], int],
    bar: Callable[[str, object], None],
) -> None:
    law, asked = CASES[case]
    ctrl, untouched = (taut.compile(law, PANDA, engine=engine, limits=limits) for _ in range(2))
    good: dict[str, Any] = {"q": HOME + 0.01, "v": np.full(7, 0.02)}
    if "F_ext" in ctrl.needs:
        good["F_ext"] = np.full(6, 0.1)
    faults = [(name, i, bad) for name in good for i, bad in itertools.product(range(len(good[name])), NONE)]
    rng = np.random.default_rng(len(case))
    chosen = [faults[k] for k in rng.permutation(len(faults))[: max(6, share(len(faults)))]]
    for name, i, bad in chosen:
        spoilt = {key: np.array(value) for key, value in good.items()}
        spoilt[name][i] = bad
        with pytest.raises(taut.TautError) as refused:
            ctrl.step(**spoilt, ref=asked())
        assert refused.value.name == name or name in str(refused.value)
        if name != "F_ext":
            assert PANDA.joint_names[i] in str(refused.value)
        np.testing.assert_array_equal(ctrl.step(**good, ref=asked()), untouched.step(**good, ref=asked()))
