"""An Arm written as URDF, for round trips: a link for each body, and one for each frame."""

from __future__ import annotations

import numpy as np

from taut.arm.description import BASE, Arm
from taut.trace.pose import Pose


def as_urdf(arm: Arm) -> str:
    lines = [f'<robot name="{arm.name}">', '<link name="_base"/>']
    for joint, body in zip(arm.joints, arm.bodies, strict=True):
        I = body.inertia
        moments = {"ixx": I[0, 0], "iyy": I[1, 1], "izz": I[2, 2], "ixy": I[0, 1], "ixz": I[0, 2], "iyz": I[1, 2]}
        lines += [
            f'<link name="_{joint.name}"><inertial><origin xyz="{_words(body.com)}"/><mass value="{body.mass!r}"/>',
            f"<inertia {_attributes(moments)}/></inertial></link>",
        ]
        limits = {"lower": joint.lower, "upper": joint.upper, "velocity": joint.velocity, "effort": joint.effort}
        given = _attributes({name: value for name, value in limits.items() if np.isfinite(value)})
        lines += [
            f'<joint name="{joint.name}" type="{joint.kind}"><parent link="{_link(arm, joint.parent)}"/>',
            f'<child link="_{joint.name}"/>{_origin(joint.placement)}<axis xyz="{_words(joint.axis)}"/>',
            f'<limit {given}/><dynamics damping="{joint.viscous!r}" friction="{joint.coulomb!r}"/></joint>',
        ]
    for frame in arm.frames:
        lines += [
            f'<link name="{frame.name}"/><joint name="_{frame.name}_fixed" type="fixed">',
            f'<parent link="{_link(arm, frame.body)}"/><child link="{frame.name}"/>{_origin(frame.placement)}</joint>',
        ]
    return "\n".join([*lines, "</robot>"])


def _attributes(values: dict[str, float]) -> str:
    return " ".join(f'{name}="{float(value)!r}"' for name, value in values.items())


def _link(arm: Arm, body: int) -> str:
    return "_base" if body == BASE else f"_{arm.joint_names[body]}"


def _words(values: np.ndarray) -> str:
    return " ".join(repr(float(value)) for value in values)


def _origin(pose: Pose) -> str:
    return f'<origin xyz="{_words(pose.p)}" rpy="{_words(pose.rpy)}"/>'
