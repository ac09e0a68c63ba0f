"""The task that all peers get: arms as URDF and as numbers, states, gains and motions, written into a folder."""

from __future__ import annotations

import dataclasses
import functools
import json
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

import rivals
import task_rivals

import taut

CHAINS: Final = (1, 2, 3, 5, 7, 10, 15, 20, 30)
SAMPLES: Final = 4096
LOAD: Final = (rivals.PAYLOAD_MASS, rivals.PAYLOAD_COM, rivals.PAYLOAD_INERTIA)
Body = tuple[float, Any, Any]  # mass, centre of mass, inertia about it


@functools.cache
def arm_of(robot: str) -> taut.Arm:
    """The Panda of the other benchmarks, or a chain of n hinges; "_loaded" with the payload.

    Gravity is the standard one: dynibo has no other.
    """
    name = robot.removesuffix("_loaded")
    arm = rivals.ARM if name == "panda" else rivals.chain(int(name.removeprefix("chain")))
    arm = dataclasses.replace(arm, gravity=[0.0, 0.0, -9.80665])
    return arm if name == robot else arm.with_payload(*LOAD)


def bodies_of(robot: str) -> list[Body]:
    """The arm's bodies, with the payload as a part of the last."""
    arm = arm_of(robot)
    bodies = [(body.mass, body.com, body.inertia) for body in arm.bodies]
    if robot.endswith("_loaded"):
        tool, (mass, com, inertia) = arm.frame().placement, LOAD
        bodies[-1] = together(bodies[-1], (mass, tool.p + tool.R @ com, tool.R @ inertia @ tool.R.T))
    return bodies


def together(one: Body, other: Body) -> Body:
    """Two bodies as one."""
    mass = one[0] + other[0]
    com = (one[0] * one[1] + other[0] * other[1]) / mass
    inertia = np.zeros((3, 3))
    for m, c, I in (one, other):
        d = c - com
        inertia = inertia + I + m * (d @ d * np.eye(3) - np.outer(d, d))
    return mass, com, inertia


def urdf(robot: str) -> str:
    """The arm as URDF, with the exact numbers; the tool is a frame without mass."""
    arm = arm_of(robot)

    def xyz(numbers: Iterable[float]) -> str:
        return " ".join(repr(float(x)) for x in numbers)

    def origin(T: taut.Pose) -> str:
        R = T.R
        rpy = (
            np.arctan2(R[2, 1], R[2, 2]),
            np.arctan2(-R[2, 0], np.hypot(R[0, 0], R[1, 0])),
            np.arctan2(R[1, 0], R[0, 0]),
        )
        return f'<origin xyz="{xyz(T.p)}" rpy="{xyz(rpy)}"/>'

    def link(name: str, mass: float, com: Any, I: Any) -> str:
        pairs = (f'i{"xyz"[a]}{"xyz"[b]}="{float(I[a, b])!r}"' for a in range(3) for b in range(a, 3))
        body = f'<origin xyz="{xyz(com)}" rpy="0 0 0"/><mass value="{float(mass)!r}"/><inertia {" ".join(pairs)}/>'
        return f'<link name="{name}"><inertial>{body}</inertial></link>'

    rows = [f'<robot name="{robot}">', link("link0", 1.0, np.zeros(3), np.eye(3))]
    for i, (joint, body) in enumerate(zip(arm.joints, bodies_of(robot), strict=True)):
        assert np.array_equal(joint.axis, [0.0, 0.0, 1.0])
        assert joint.parent == i - 1
        rows += [
            link(f"link{i + 1}", *body),
            f'<joint name="{joint.name}" type="revolute"><parent link="link{i}"/><child link="link{i + 1}"/>',
            f'{origin(joint.placement)}<axis xyz="0 0 1"/>',
            '<limit lower="-6.5" upper="6.5" effort="1000" velocity="100"/></joint>',
        ]
    rows += [
        '<link name="tool"/><joint name="tool_joint" type="fixed">',
        f'<parent link="link{arm.n}"/><child link="tool"/>{origin(arm.frame().placement)}</joint></robot>',
    ]
    return "\n".join(rows)


def data_of(robot: str, rng: np.random.Generator) -> dict[str, Any]:
    """Numbers of an arm, states, and the motion of its loop."""
    arm, panda = arm_of(robot), robot.startswith("panda")
    frequency = rivals.FREQUENCY if panda else np.linspace(0.2, 0.5, arm.n)
    sine = rivals.CENTER if panda else arm.home, np.full(arm.n, 0.3 if panda else 0.1), 2.0 * np.pi * frequency
    around = np.outer([1.0, 0.0, 1.0, 0.0, 0.0], arm.home)  # q, v, q_des, v_des, a_des

    def place(T: taut.Pose) -> dict[str, Any]:
        return {"p": T.p.tolist(), "R": T.R.tolist(), "wxyz": T.wxyz.tolist()}

    return {
        "joints": [{"name": joint.name, **place(joint.placement)} for joint in arm.joints],
        "tool": place(arm.frame().placement),
        "gravity": arm.gravity.tolist(),
        "states": (around + rng.standard_normal((20, 5, arm.n))).tolist(),
        "sine": np.stack(sine).tolist(),
    }


def write_task(folder: Path, chains: Iterable[int] = CHAINS) -> None:
    """task.json, and a URDF file for each robot."""
    rng = np.random.default_rng(0)
    robots: dict[str, Any] = {}
    for name in ("panda", *(f"chain{n}" for n in chains)):
        data = data_of(name, rng)
        for robot in (name, f"{name}_loaded"):
            bodies = [{"mass": m, "com": com.tolist(), "inertia": I.tolist()} for m, com, I in bodies_of(robot)]
            robots[robot] = {**data, "bodies": bodies}
            (folder / f"{robot}.urdf").write_text(urdf(robot))
    arm, targets = arm_of("panda"), []
    for state in robots["panda"][
        "states"
    ]:  # near home and near the target: no joint is singular, no error half a turn
        q = arm.home + 0.2 * rng.standard_normal(arm.n)
        state[0] = q.tolist()
        T = taut.snapshot(arm, q).T() @ taut.Pose(0.05 * rng.standard_normal(3), rpy=0.2 * rng.standard_normal(3))
        targets.append([x.tolist() for x in (T.p, T.R, rng.standard_normal(6), rng.standard_normal(6))])
    robots["panda"]["targets"] = targets
    impedance = {"K": np.diag(task_rivals.K), "B": np.diag(task_rivals.B), "rest": arm.home}
    task = {
        "kp": 100.0,
        "kd": 20.0,
        "dt": rivals.DT,
        "impedance": {name: x.tolist() for name, x in impedance.items()}
        | {"kp": task_rivals.REST_KP, "kd": task_rivals.REST_KD},
        "payload": {name: np.asarray(x).tolist() for name, x in zip(("mass", "com", "inertia"), LOAD, strict=True)},
        "gains": rng.uniform([50.0, 10.0, 0.0], [400.0, 60.0, 2.0], (SAMPLES, 3)).tolist(),
        "robots": robots,
    }
    (folder / "task.json").write_text(json.dumps(task))
