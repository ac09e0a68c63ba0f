"""Episodes that cannot be."""

from __future__ import annotations

from typing import Any

from refusals import refused

from taut.errors import RangeError, ShapeError, UnknownNameError, UsageError
from taut.gym import Episode, ScenarioEnv


def test_what_is_no_episode_is_refused() -> None:
    wrong: list[tuple[Any, Any]] = [
        (UnknownNameError, {"scenario": "panda_paylod"}),
        (UsageError, {"scenario": "one_joint_pid", "action": "torques"}),
        (UsageError, {"scenario": "touch_and_press"}),
        (UsageError, {"scenario": "geared_force", "action": "torque", "scale": 1.0}),
        (UnknownNameError, {"scenario": "gain_bounds", "case": "none of them"}),
        (UnknownNameError, {"scenario": "one_joint_pid", "law": "PDD"}),
        (UnknownNameError, {"scenario": "one_joint_pid", "gains": {"law.K": (1.0, 2.0)}}),
        (RangeError, {"scenario": "one_joint_pid", "gains": {"law.kp": (-1.0, 2.0)}}),
        (ShapeError, {"scenario": "one_joint_pid", "scale": [1.0, 2.0]}),
        (ShapeError, {"scenario": "one_joint_pid", "action": "torque"}),
        (RangeError, {"scenario": "one_joint_pid", "decimation": 0}),
    ]
    for kind, arguments in wrong:
        with refused(kind):
            ScenarioEnv(Episode(**arguments))
