"""Friction and rotors of an arm in the words of URDF and MJCF, and what these words cannot say."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from xml.sax.saxutils import quoteattr

from taut.arm.description import Arm, Joint
from taut.base.errors import UsageError, quoted_list, unknown_name

__all__ = ["JointWords", "to_mjcf_joints", "to_urdf_dynamics"]


@dataclass(frozen=True, kw_only=True)
class JointWords:
    """Attributes of an XML element for each joint, and what of the arm they leave out.

    Args:
        element: The element that has the attributes.
        attributes: By joint name, the attributes by name; `repr` of a float is exact, so that reading gives it back.
        notes: What the format cannot say, and what its words mean elsewhere, in sentences.
    """

    element: str
    attributes: Mapping[str, Mapping[str, float]]
    notes: tuple[str, ...]

    def xml(self, joint: str) -> str:
        """The element of one joint as text.

        Raises:
            UnknownNameError: The arm has no such joint.
        """
        if joint not in self.attributes:
            raise unknown_name("the arm", "joint", joint, self.attributes)
        values = " ".join(f'{name}="{value!r}"' for name, value in self.attributes[joint].items())
        named = f" name={quoteattr(joint)}" if self.element == "joint" else ""
        return f"<{self.element}{named} {values}/>"


def to_urdf_dynamics(arm: Arm) -> JointWords:
    """The attributes of `<dynamics>` in the `<joint>` of a URDF: damping and friction.

    Example:
        >>> from taut import Friction, load_arm
        >>> arm = load_arm("one_joint").with_friction(Friction(viscous=0.1, coulomb=0.5, static=0.8))
        >>> words = to_urdf_dynamics(arm)
        >>> words.xml("joint1")
        '<dynamics damping="0.1" friction="0.5"/>'
        >>> words.notes[1]
        "static friction above that in motion is left out, on 'joint1'"
    """
    _require_arm("to_urdf_dynamics", arm)
    dynamics = {joint.name: {"damping": joint.viscous, "friction": joint.coulomb} for joint in arm.joints}
    notes = []
    if arm.coulomb.any():
        notes.append(
            "friction is the friction at rest by the URDF's specification, and nearly every engine takes it as dry "
            "friction in motion, as taut does: written is coulomb"
        )
    notes += _left_out(arm)
    if arm.rotor_inertia.any():
        rotors = quoted_list(joint.name for joint in arm.joints if joint.rotor_inertia)
        notes.append(
            f"rotor inertia is left out, on {rotors}: <dynamics> has none; Drake reads drake:rotor_inertia and "
            "drake:gear_ratio in the <actuator> of a <transmission>, and so does taut"
        )
    return JointWords(element="dynamics", attributes=dynamics, notes=tuple(notes))


def to_mjcf_joints(arm: Arm) -> JointWords:
    """The attributes of a `<joint>` of an MJCF: damping, frictionloss and armature.

    Example:
        >>> from taut import load_arm
        >>> to_mjcf_joints(load_arm("one_joint").with_gears(10.0, 1e-3)).xml("joint1")
        '<joint name="joint1" damping="0.1" frictionloss="0.0" armature="0.1"/>'
    """
    _require_arm("to_mjcf_joints", arm)
    joints = {
        joint.name: {"damping": joint.viscous, "frictionloss": joint.coulomb, "armature": joint.rotor_inertia}
        for joint in arm.joints
    }
    notes = []
    if arm.coulomb.any():
        notes.append(
            "frictionloss is a soft constraint of MuJoCo: a joint that should stick creeps, less with a stiffer "
            'solreffriction and solimpfriction, and not at all with <option noslip_iterations="..."/>'
        )
    notes += _left_out(arm)
    if arm.friction.falls:
        notes.append(
            "the lugre attribute of MuJoCo's <dcmotor> has static friction and a Stribeck speed, behind its gear"
        )
    if arm.rotor_inertia.any():
        notes.append("armature is the reflected inertia, gear^2 times that of the rotor: give no gear for it again")
    return JointWords(element="joint", attributes=joints, notes=tuple(notes))


def _require_arm(name: str, arm: Arm) -> None:
    if not isinstance(arm, Arm):  # callers without a type checker
        raise UsageError(
            f"{name} takes an Arm; got {type(arm).__name__}; arm.with_friction(...) makes one", name="arm"
        )


def _left_out(arm: Arm) -> Iterator[str]:
    """What neither format has a word for."""
    parts: tuple[tuple[str, Callable[[Joint], bool]], ...] = (
        ("static friction above that in motion is left out", lambda j: j.static is not None and j.static > j.coulomb),
        (
            "the Stribeck effect is left out",
            lambda j: j.stribeck > 0.0 and j.static is not None and j.static > j.coulomb,
        ),
        ("friction that grows with load is left out", _loaded),
    )
    for text, has in parts:
        names = [joint.name for joint in arm.joints if has(joint)]
        if names:
            yield f"{text}, on {quoted_list(names)}"


def _loaded(joint: Joint) -> bool:
    given = (joint.load_motor, joint.load_external, joint.load_motor_static, joint.load_external_static)
    return any(value for value in given)
