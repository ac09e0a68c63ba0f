"""Rules for every model, whoever read it: structure, joints, mass properties; and doubtful numbers.

Inertia is that of all that a moving joint carries, since frames without mass are normal.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from typing import TYPE_CHECKING, Final

import numpy as np

from taut.arm.parts import BASE
from taut.base.errors import Problem, quoted_list, unknown_name
from taut.base.types import Float64Array

if TYPE_CHECKING:
    from taut.arm.description import Arm, Joint
    from taut.arm.loaders.tree import Tree, TreeJoint, TreeLink

FIX_MASS: Final = "fix its mass and inertia"
CUT: Final = "an arm is a tree: cut the loop at one joint and state the closure as a constraint"
AXIS_TOLERANCE: Final = 1e-3  # an axis shorter than this has no direction; any other length is normalised
INERTIA_TOLERANCE: Final = 1e-6  # relative slack of the triangle inequality, for rounded files
LEAST_MOMENT: Final = 1e-12  # a principal moment below this share of the largest is rounding, not a size
OTHER_KINDS: Final = {
    "floating": "a floating joint is not one of an arm; make it fixed, cut the model there",
    "planar": "a planar joint is not one of an arm; write it as two prismatic joints and a revolute one",
    "ball": "a ball joint is not one of an arm; write it as three hinges",
}
MIN_EIGENVALUE: Final = 1e-12  # of M scaled to a unit diagonal; rounding is 1e-16 of its entries
RANDOM_POSES: Final = 10  # random ones, at which M is looked at
MAX_ENTRIES: Final = 20_000  # of all matrices M: fewer poses of an arm of many joints
MAX_LENGTH: Final = 1e4  # [m] between two joints, or of a slide; what is farther is a slip, and its square is lost
MAX_PAYLOAD_LENGTHS: Final = 3.0  # of an arm, from its tool to a payload; farther is said in millimetres
MAX_ROTOR_FACTOR: Final = 100.0  # of the inertia of all links; a wrong unit is off by 1e4 to 1e7
MAX_ROTOR: Final = 1000.0  # [kg m^2] or [kg] seen at any joint
OTHER_UNIT: Final = "if it was given in kg cm^2, kg mm^2 or g cm^2: 1 kg m^2 is 1e4, 1e6 and 1e7 of these"
DEGREES: Final = (13.0, 1000.0)  # [rad] limits in degrees are in here; no joint turns about twice and stops
MAX_DENSITY: Final = 25_000.0  # [kg/m^3] osmium has 22,600
MAX_ARM_DENSITY: Final = 1000.0  # [kg/m^3] of all that moves, in a cube as wide as the arm is long; 140 are known
MAX_LINKS: Final = 1000  # a humanoid with hands has 100; what is far beyond is no arm


def structure_problems(tree: Tree) -> Iterator[Problem]:
    """Names that are empty, doubled or unknown; more than one root or parent; cycles."""
    if not tree.links:
        text = "the model has no links; an arm needs a base and one link at least"
        yield Problem(object=tree.name, attribute="link", message=text, line=tree.line)
        return
    if len(tree.links) > MAX_LINKS:
        text = f"the model has {len(tree.links)} links; an arm has {MAX_LINKS} at most"
        yield Problem(object=tree.name, attribute="link", message=text, line=tree.line)
        return
    found = [*_name_problems(tree), *_reference_problems(tree)]
    yield from found
    parent_joint = {joint.child: joint for joint in reversed(tree.joints)}
    links = {link.name: link for link in tree.links}
    roots = [link.name for link in tree.links if link.name not in parent_joint]
    if len(roots) > 1 and not found and not tree.problems:  # else most likely a consequence
        text = f"the model has {len(roots)} roots ({quoted_list(roots)}); an arm has one base: "
        yield problem_at(links[roots[1]], "parent", f"{text}join the others to it with fixed joints")
    for link in _on_cycles(parent_joint):
        if link in links:
            yield problem_at(links[link], "parent", f"link '{link}' is on a closed chain; {CUT}")


def _name_problems(tree: Tree) -> Iterator[Problem]:
    items: tuple[tuple[str, list[TreeLink] | list[TreeJoint]], ...] = (
        ("link", tree.links),
        ("joint", tree.joints),
    )
    for kind, named in items:
        seen: dict[str, int | None] = {}
        for item in named:
            if not item.name:
                text = f"a {kind} has no name; give it one"
                yield Problem(object=kind, attribute="name", message=text, line=item.line)
            elif item.name in seen:
                first = "" if seen[item.name] is None else f" (first in line {seen[item.name]})"
                text = f"{kind} '{item.name}' is there twice{first}; rename one"
                yield Problem(object=item.name, attribute="name", message=text, line=item.line)
            else:
                seen[item.name] = item.line


def _reference_problems(tree: Tree) -> Iterator[Problem]:
    links = {link.name for link in tree.links}
    parent_joint: dict[str, TreeJoint] = {}
    for joint in tree.joints:
        for role, link in (("parent", joint.parent), ("child", joint.child)):
            if link not in links:
                text = str(unknown_name("the model", "link", link, sorted(links)))
                yield _bad(joint, role, f"its {role}: {text}")
        if joint.child == joint.parent:
            yield _bad(joint, "child", f"it joins link '{joint.child}' to itself; name another child")
        elif joint.child in parent_joint:
            first = parent_joint[joint.child].name
            yield _bad(joint, "child", f"link '{joint.child}' has two parents, also joint '{first}'; {CUT}")
        else:
            parent_joint[joint.child] = joint


def _on_cycles(parent_joint: Mapping[str, TreeJoint]) -> list[str]:
    """One link of each cycle of parents."""
    found: list[str] = []
    seen: set[str] = set()
    for start in parent_joint:
        path, link = [], start
        while link in parent_joint and link not in seen:
            seen.add(link)
            path.append(link)
            link = parent_joint[link].parent
        if link in path and parent_joint[link].parent != link:  # a self-loop is reported as such
            found.append(link)
    return found


def problem_at(item: TreeLink | TreeJoint, attribute: str, message: str) -> Problem:
    """A problem of a link or joint, with the line where the attribute stands."""
    return Problem(object=item.name, attribute=attribute, message=message, line=item.lines.get(attribute, item.line))


def _bad(joint: TreeJoint, attribute: str, text: str) -> Problem:
    return problem_at(joint, attribute, f"joint '{joint.name}': {text}")


def joint_problems(tree: Tree, locked: Collection[str]) -> Iterator[Problem]:
    """Types that an arm cannot have; axes, limits and friction of the joints that move."""
    names = {joint.name for joint in tree.joints}
    for joint in tree.joints:
        kind, far = joint.joint.kind, float(np.abs(joint.joint.placement.p).max())
        if not far <= MAX_LENGTH:
            yield _bad(joint, "origin", f"its place must be within {MAX_LENGTH:g} m of its parent; got {far:g}")
        if kind == "fixed" or joint.name in locked:
            continue
        hold = f"or hold it still: load_arm(..., locked={{'{joint.name}': 0.0}})"
        if kind in OTHER_KINDS:
            yield _bad(joint, "type", f"{OTHER_KINDS[kind]}, {hold}")
        elif joint.mimic is not None:
            follows = f"it mimics '{joint.mimic}'" if joint.mimic else "a coupling holds it"
            if joint.mimic and joint.mimic not in names:
                follows += " (there is no such joint)"
            yield _bad(joint, "mimic", f"{follows}, and taut has no coupled joints; make it fixed, {hold}")
        else:
            for attribute, text in value_problems(joint.joint):
                yield _bad(joint, attribute, text)


def value_problems(joint: Joint) -> Iterator[tuple[str, str]]:
    """What is wrong with the numbers of a joint that moves: (attribute, text) of each."""
    if not AXIS_TOLERANCE <= np.linalg.norm(joint.axis) < math.inf:
        yield "axis", "axis must be finite and not zero: a joint that moves needs a direction"
    missing = [name for name in ("lower", "upper", "velocity", "effort") if math.isnan(getattr(joint, name))]
    if missing:
        needs = f"a {joint.kind} joint needs <limit lower= upper= velocity= effort=>"
        yield missing[0] if len(missing) == 1 else "limit", f"it has no {' and '.join(missing)} limit; {needs}"
    low, high = joint.lower, joint.upper
    if joint.kind == "continuous" and not (math.isinf(low) and math.isinf(high)):
        yield "limit", "a continuous joint has no position limits; make it revolute"
    elif low >= high:
        way_out = "swap them" if low > high else "make a joint that does not move a fixed one"
        yield "limit", f"lower limit {low:g} must be below upper limit {high:g}; {way_out}"
    if joint.kind == "prismatic" and any(MAX_LENGTH < abs(x) < math.inf for x in (low, high)):
        yield "limit", f"limits of a slide must be within +-{MAX_LENGTH:g} m; got {low:g} to {high:g}"
    for attribute, word, value in (("velocity", "speed", joint.velocity), ("effort", "effort", joint.effort)):
        if value <= 0.0:
            yield attribute, f"{word} limit must be > 0; got {value:g}"
    for attribute, word, value in (
        ("damping", "damping", joint.viscous),
        ("friction", "friction", joint.coulomb),
        ("armature", "rotor inertia", joint.rotor_inertia),
    ):
        if not (math.isfinite(value) and value >= 0.0):
            yield attribute, f"{word} must be finite and >= 0; got {value:g}"


def mass_problems(tree: Tree) -> Iterator[Problem]:
    """Links whose own numbers no body has."""
    for link in tree.links:
        text = wrong_mass(link)
        if text is not None:
            yield problem_at(link, "mass", f"{tree.link_word} '{link.name}': {text}; {FIX_MASS}")


def wrong_mass(link: TreeLink) -> str | None:
    """What is wrong with a link's own numbers: not finite, or a negative mass. Zero is fine for a frame."""
    if link.inertia is None:
        return None
    mass = link.inertia.mass
    if not (math.isfinite(mass) and mass >= 0.0):
        return f"mass must be finite and >= 0 [kg]; got {mass:g}"
    if not (np.isfinite(link.inertia.com).all() and np.isfinite(link.inertia.inertia).all()):
        return "centre of mass and inertia must be finite"
    if np.abs(link.inertia.com).max() > MAX_LENGTH:
        return f"centre of mass must be within {MAX_LENGTH:g} m of its link; got {link.inertia.com.tolist()}"
    return None


def check_inertia(mass: float, inertia: Float64Array) -> tuple[str, str] | None:
    """(attribute, text) of what is wrong with a rigid body's mass properties, or None.

    The mass must be > 0, the inertia positive definite, no principal moment above the sum of the other two.
    """
    if not math.isfinite(mass) or not np.isfinite(inertia).all():
        return "inertia", "mass and inertia must be finite"
    if mass <= 0.0:
        return "mass", f"mass must be > 0 [kg]; got {mass:g}"
    if np.abs(inertia - inertia.T).max() > 1e-9 * max(np.abs(inertia).max(), 1e-300):
        return "inertia", "inertia must be symmetric"
    small, middle, large = np.linalg.eigvalsh(inertia)
    if small <= LEAST_MOMENT * large:
        text = f"inertia must be positive definite [kg m^2]; its smallest principal moment is {small:.3g}"
        return "inertia", text
    if large > (small + middle) * (1.0 + INERTIA_TOLERANCE):
        return "inertia", f"inertia violates the triangle inequality ({_triangle(inertia)})"
    return None


def _triangle(inertia: Float64Array) -> str:
    diagonal = np.diag(inertia)
    if not np.allclose(inertia, np.diag(diagonal), rtol=0.0, atol=1e-9 * float(diagonal.max())):
        small, middle, large = np.linalg.eigvalsh(inertia)
        return f"principal moments {large:.4g} > {small:.4g} + {middle:.4g}"
    k = int(np.argmax(diagonal))
    a, b = (i for i in range(3) if i != k)
    name = [f"I{axis}{axis}" for axis in "xyz"]
    return f"{name[k]} {diagonal[k]:.4g} > {name[a]} + {name[b]} {diagonal[a] + diagonal[b]:.4g}"


def indefinite(arm: Arm) -> float | None:
    """The least eigenvalue of M, scaled to a unit diagonal, where too small for floats at a random pose, or None."""
    poses = max(1, min(RANDOM_POSES, MAX_ENTRIES // arm.n**2))
    rng = np.random.default_rng(0)
    low, high = np.maximum(arm.lower, -math.pi), np.minimum(arm.upper, math.pi)
    q = np.where(low < high, rng.uniform(np.minimum(low, high), np.maximum(low, high), (poses, arm.n)), arm.home)
    M = _mass_matrices(arm, q)
    size = np.sqrt(np.einsum("kii->ki", M))
    if not (np.isfinite(M).all() and (size > 0.0).all()):
        return 0.0
    least = float(np.linalg.eigvalsh(M / (size[:, :, np.newaxis] * size[:, np.newaxis, :])).min())
    return None if least > MIN_EIGENVALUE else least


def _mass_matrices(arm: Arm, q: Float64Array) -> Float64Array:
    """(k, n, n) sum of m J_v^T J_v + J_w^T I J_w over the bodies, and the rotors."""
    k, n = q.shape
    R, p = np.zeros((n, k, 3, 3)), np.zeros((n, k, 3))
    axes = np.zeros((n, k, 3))
    M = np.zeros((k, n, n)) + np.diag(arm.rotor_inertia)
    for i, (joint, body) in enumerate(zip(arm.joints, arm.bodies, strict=True)):
        start = (np.eye(3), np.zeros(3)) if joint.parent == BASE else (R[joint.parent], p[joint.parent])
        R[i], p[i] = start[0] @ joint.placement.R, start[1] + start[0] @ joint.placement.p
        axes[i] = R[i] @ joint.axis
        if joint.kind == "prismatic":
            p[i] += axes[i] * q[:, i : i + 1]
        else:
            R[i] = R[i] @ _about(joint.axis, q[:, i])
        c = p[i] + R[i] @ body.com
        moving = list(arm.ancestors(i))
        slides = np.array([arm.joints[j].kind == "prismatic" for j in moving])[:, np.newaxis, np.newaxis]
        z = axes[moving]
        J_v = np.where(slides, z, np.cross(z, c - p[moving]))
        J_w = np.where(slides, 0.0, z)
        I = R[i] @ body.inertia @ np.swapaxes(R[i], 1, 2)
        part = body.mass * np.einsum("ikx,jkx->kij", J_v, J_v) + np.einsum("ikx,kxy,jky->kij", J_w, I, J_w)
        M[np.ix_(range(k), moving, moving)] += part
    return M


def _about(axis: Float64Array, angle: Float64Array) -> Float64Array:
    """(k, 3, 3) rotations about a unit axis."""
    x, y, z = axis
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    s, c = np.sin(angle)[:, np.newaxis, np.newaxis], np.cos(angle)[:, np.newaxis, np.newaxis]
    return np.asarray(np.eye(3) + s * K + (1.0 - c) * (K @ K))


def model_doubts(arm: Arm) -> Iterator[str]:
    """What is hard to believe of limits and masses, in sentences: mostly a wrong unit. Nothing of it is refused."""
    turned = [
        joint.name
        for joint in arm.joints
        if joint.kind == "revolute" and any(DEGREES[0] < abs(x) < DEGREES[1] for x in (joint.lower, joint.upper))
    ]
    if turned:
        yield f"position limits of {quoted_list(turned)} are more than two turns; were they given in degrees?"
    yield from rotor_doubts(arm)
    length = _length(arm)
    if not math.isfinite(length):
        return
    if arm.total_mass > MAX_ARM_DENSITY * length**3:
        yield f"{arm.total_mass:.4g} kg are hard to believe of an arm of {length:.3g} m; were masses given in g?"
    radii = np.array([math.sqrt(float(np.linalg.eigvalsh(body.inertia)[-1]) / body.mass) for body in arm.bodies])
    balls = 4.0 / 3.0 * math.pi * (math.sqrt(2.5) * radii) ** 3  # [m^3] with the same radius of gyration
    masses = np.array([body.mass for body in arm.bodies])
    for wrong, why in (
        (radii > length, f"its radius of gyration is up to {radii.max():.3g} m, and the arm has {length:.3g} m"),
        (masses > MAX_DENSITY * balls, "no matter is so dense that it could be so small for its mass"),
    ):
        if wrong.any():
            links = quoted_list([body.links[0] for body, one in zip(arm.bodies, wrong, strict=True) if one], 3)
            yield f"the inertia of {links} is hard to believe: {why}; give it in kg m^2, about the centre of mass"


def rotor_doubts(arm: Arm) -> Iterator[str]:
    """Rotor inertias that are hard to believe: far more than all links on one joint, whatever the pose."""
    if not arm.rotor_inertia.any():
        return
    moments = sum(float(np.linalg.eigvalsh(body.inertia)[-1]) for body in arm.bodies)
    links = {"m": arm.total_mass, "rad": arm.total_mass * _length(arm) ** 2 + moments}
    for joint in arm.joints:
        most, unit = links[joint.unit], "kg" if joint.kind == "prismatic" else "kg m^2"
        if joint.rotor_inertia > min(MAX_ROTOR, MAX_ROTOR_FACTOR * most):
            geared = f", gear {joint.gear:g}" if joint.gear != 1.0 else ""
            yield (
                f"the rotor inertia of joint '{joint.name}', {joint.rotor_inertia:.4g} [{unit}] seen at the "
                f"joint{geared}, is hard to believe: no joint of its kind can see more than {most:.3g} [{unit}] of "
                f"links; {OTHER_UNIT}"
            )


def payload_doubts(arm: Arm) -> Iterator[str]:
    """A payload that is hard to believe: one far from the tool by any measure of the arm."""
    away, length = float(np.linalg.norm(arm.payload.com)), _length(arm)
    if away > MAX_PAYLOAD_LENGTHS * length:
        yield (
            f"payload.com is {away:.4g} m from the tool, which is hard to believe of an arm of {length:.3g} m; "
            "give it in metres, in the tool frame"
        )


def _length(arm: Arm) -> float:
    """[m] from the first joint to the farthest centre of mass or the tool, were all of it stretched."""
    joints: list[float] = []
    for joint in arm.joints:
        before = 0.0 if joint.parent == BASE else joints[joint.parent] + float(np.linalg.norm(joint.placement.p))
        slide = max(abs(joint.lower), abs(joint.upper)) if joint.kind == "prismatic" else 0.0
        joints.append(before + slide)
    ends = [*zip(range(arm.n), (body.com for body in arm.bodies), strict=True)]
    tool = arm.frame(None)
    ends += [(tool.body, tool.placement.p)] if tool.body != BASE else []
    return max(joints[i] + float(np.linalg.norm(p)) for i, p in ends)
