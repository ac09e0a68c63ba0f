"""The arms that taut knows by name, from packages on PyPI: files, gripper locks, tools, home poses, drive commands.

Numbers that replace missing or senseless ones of a file are stated in the arm's notes.
"""

from __future__ import annotations

import dataclasses
import importlib
import math
import pkgutil
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, Final

from taut.arm.loaders.tree import Tree, TreeJoint, TreeLink
from taut.arm.loaders.urdf import urdf_tree
from taut.arm.loaders.xml import read_xml
from taut.arm.parts import COMMANDS, CommandKind
from taut.base.errors import FileError, MissingExtraError, missing_extra, unknown_name
from taut.trace.pose import Pose

if TYPE_CHECKING:
    from importlib.metadata import Distribution

VELOCITY_POSITION: Final[tuple[CommandKind, ...]] = ("velocity", "position")
DESCRIPTIONS: Final = "robot_descriptions"
PATTERN: Final = re.compile(r"[a-z0-9_]+_description\Z")
ROBOTS: Final = "cmeel.prefix/share/example-robot-data"


@dataclass(frozen=True, kw_only=True)
class Entry:
    """One arm of the catalogue."""

    name: str
    file: str  # below the folder that packages are installed in
    package: str = "example-robot-data"  # on PyPI
    extra: str = "arms"  # of taut, which installs the package
    meshes: str = ROBOTS  # folder that stands for package://example-robot-data
    tool: str
    home: Mapping[str, float]  # [rad | m] of the joints that move
    commands: tuple[CommandKind, ...] = COMMANDS  # what the real arm takes
    locked: Mapping[str, float] = field(default_factory=dict)  # [rad | m] the gripper
    limits: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)  # supplied for a joint
    frames: Mapping[str, tuple[str, Pose]] = field(default_factory=dict)  # supplied: name -> link, T_link_frame
    notes: tuple[str, ...] = ()


def installed_package(entry: Entry) -> Distribution | None:
    """The entry's package, if it is there."""
    from importlib import metadata  # 20 ms, for those who use the catalogue

    try:
        return metadata.distribution(entry.package)
    except metadata.PackageNotFoundError:
        return None


def entry_tree(entry: Entry) -> Tree:
    """The links and joints of an entry's file, with what the entry supplies."""
    package = installed_package(entry)
    if package is None:
        raise missing_extra(f"arm '{entry.name}'", entry.package, entry.extra)
    folders = {"example-robot-data": Path(str(package.locate_file(entry.meshes)))}
    file = Path(str(package.locate_file(entry.file)))
    tree = urdf_tree(read_xml(file), file, folders)
    tree.name, tree.home, tree.locked = entry.name, dict(entry.home), dict(entry.locked)
    tree.tool, tree.commands = entry.tool, entry.commands
    for item in tree.joints:
        item.joint = dataclasses.replace(item.joint, **entry.limits.get(item.name, {}))
    for name, (link, T_link_frame) in entry.frames.items():
        tree.links.append(TreeLink(name=name))
        tree.joints.append(TreeJoint.fixed(link, name, T_link_frame))
    tree.notes.extend(entry.notes)
    return tree


def _robot(folder: str, file: str) -> str:
    return f"{ROBOTS}/robots/{folder}_description/{file}"


def _in_order(names: str, positions: tuple[float, ...]) -> dict[str, float]:
    return dict(zip(names.split(), positions, strict=True))


FRANKA_HOME: Final = (0.0, -math.pi / 4, 0.0, -3 * math.pi / 4, 0.0, math.pi / 2, math.pi / 4)  # libfranka's examples
UR_JOINTS: Final = "shoulder_pan_joint shoulder_lift_joint elbow_joint wrist_1_joint wrist_2_joint wrist_3_joint"
UR_HOME: Final = (0.0, -math.pi / 2, math.pi / 2, -math.pi / 2, -math.pi / 2, 0.0)  # tool down, elbow at 90 degrees
SO_JOINTS: Final = "shoulder_pan shoulder_lift elbow_flex wrist_flex wrist_roll"


# Rotor inertias that other models of these arms have. They were chosen for simulations, not identified.
NO_ROTORS: Final = "the file has no rotor inertia, which gears multiply by the square of their ratio; approximate: "
UR_ROTORS: Final = (
    "0.1 kg m^2 at every joint of MuJoCo Menagerie's ur5e.xml and ur10e.xml, {}with_joints(rotor_inertia=0.1)"
)
XARM_ROTORS: Final = "0.1 kg m^2 at every joint of MuJoCo Menagerie's xarm7.xml, with_joints(rotor_inertia=0.1)"
JACO_ROTORS: Final = (
    "4 kg m^2 at joints 1 to 3 and 2 at the others of dm_control's jaco_arm.xml, "
    "with_joints(rotor_inertia=[4, 4, 4, 2, 2, 2])"
)


def _ur(name: str, larger: str = "") -> Entry:
    return Entry(
        name=name,
        file=_robot("ur", f"urdf/{name}_robot.urdf"),
        tool="tool0",
        home=_in_order(UR_JOINTS, UR_HOME),
        commands=VELOCITY_POSITION,
        notes=(NO_ROTORS + UR_ROTORS.format(larger),),
    )


ENTRIES: Final = (
    Entry(
        name="panda",
        file=_robot("panda", "urdf/panda.urdf"),
        tool="panda_hand_tcp",
        home={f"panda_joint{i}": q for i, q in enumerate(FRANKA_HOME, start=1)},
        locked={"panda_finger_joint1": 0.0, "panda_finger_joint2": 0.0},  # closed
    ),
    # fr3.urdf is the whole robot; fr3_clean.urdf, for franky-sim's simulator, lacks hand, meshes, joint prefixes.
    Entry(
        name="fr3",
        package="franky-sim",
        extra="franka",
        file="franky_sim/assets/fr3.urdf",
        tool="fr3_hand_tcp",
        home={f"fr3_joint{i}": q for i, q in enumerate(FRANKA_HOME, start=1)},
        locked={"fr3_finger_joint1": 0.0, "fr3_finger_joint2": 0.0},  # closed
        notes=(
            "rotor inertia is left out: the file gives it in words that are not URDF (motor_inertia, gear_ratio); "
            "with_joints(rotor_inertia=[0.606, 0.606, 0.462, 0.462, 0.206, 0.206, 0.206]) would add it",
        ),
    ),
    _ur("ur3", "which are larger arms, "),
    _ur("ur5"),
    _ur("ur10"),
    Entry(
        name="xarm7",
        file=_robot("xarm", "urdf/xarm7.urdf"),
        tool="link_eef",
        # The SRDF's 'home' is all zeros, which is singular; this is the bent pose of MuJoCo's xarm7.
        home={f"joint{i}": q for i, q in enumerate((0.0, -0.247, 0.0, 0.909, 0.0, 1.15644, 0.0), start=1)},
        commands=VELOCITY_POSITION,
        notes=(NO_ROTORS + XARM_ROTORS,),
    ),
    Entry(
        name="so100",
        file=_robot("so_arm", "urdf/so100.urdf"),
        tool="gripper",
        home=_in_order(SO_JOINTS, (0.0, 1.57, -1.57, 0.0, 0.0)),
        commands=("position",),
        locked={"gripper": 0.0},  # closed
    ),
    Entry(
        name="so101",
        file=_robot("so_arm", "urdf/so101.urdf"),
        tool="gripper_frame_link",
        home=_in_order(SO_JOINTS, (0.0, -0.5, 0.8, 0.6, 0.0)),
        commands=("position",),
        locked={"gripper": 0.0},  # closed
    ),
    Entry(
        name="z1",
        file=_robot("z1", "urdf/z1.urdf"),
        tool="gripperMover",
        # The SRDF's 'arm_up' is within 0.04 of a singularity; this is the 'forward' pose of the vendor's SDK.
        home={f"joint{i}": q for i, q in enumerate((0.0, 1.5, -1.0, -0.54, 0.0, 0.0), start=1)},
        locked={"jointGripper": 0.0},  # closed
    ),
    Entry(
        name="kinova",
        file=_robot("kinova", "robots/kinova.urdf"),
        tool="j2s6s200_end_effector",
        # The SRDF's 'arm_up' puts joint 3 out of its limits; this is the vendor's own home pose.
        home={f"j2s6s200_joint_{i}": q for i, q in enumerate((4.8, 2.92, 1.0, 4.2, 1.44, 1.31), start=1)},
        notes=(NO_ROTORS + JACO_ROTORS,),
    ),
    Entry(
        name="baxter",
        file=_robot("baxter", "urdf/baxter.urdf"),
        tool="left_gripper",
        home={
            f"{side}_{joint}": sign * q
            for side, mirror in (("left", 1.0), ("right", -1.0))
            for joint, sign, q in (
                ("s0", mirror, -0.3),
                ("s1", 1.0, -0.6),
                ("e0", mirror, 0.0),
                ("e1", 1.0, 1.6),
                ("w0", mirror, 0.0),
                ("w1", 1.0, 0.6),
                ("w2", mirror, 0.0),
            )
        },
        locked={"head_pan": 0.0, "l_gripper_l_finger_joint": 0.0, "l_gripper_r_finger_joint": 0.0}
        | {"r_gripper_l_finger_joint": 0.0, "r_gripper_r_finger_joint": 0.0},
    ),
    Entry(
        name="two_link",
        file=_robot("asr_twodof", "urdf/TwoDofs.urdf"),
        tool="Tip",
        home={"J1": 0.5, "J2": 1.0},
        commands=("position",),
    ),
    Entry(
        name="double_pendulum",
        file=_robot("double_pendulum", "urdf/double_pendulum.urdf"),
        tool="tip",
        home={"joint1": 2.6, "joint2": 0.6},  # it stands upright at zero and hangs at pi
        commands=("torque",),
        limits={
            name: {"lower": -2 * math.pi, "upper": 2 * math.pi, "velocity": 20.0, "effort": 2.0}
            for name in ("joint1", "joint2")
        },
        frames={"tip": ("link2", Pose((0.0, 0.0, 0.2)))},
        notes=(
            "the file gives every limit as 0; supplied: positions +-2 pi rad, speeds 20 rad/s, torques 2 N m",
            "the file has no frame at the tip; supplied: 'tip', 0.2 m along link2",
        ),
    ),
)
CATALOGUE: Final[Mapping[str, Entry]] = {entry.name: entry for entry in ENTRIES}


# Models by the names of the package robot_descriptions, where that is installed; it downloads what it names.


def described(name: str) -> tuple[Path, dict[str, Path]]:
    """The file of a robot_descriptions model, and the folders that stand for its package; may raise FileError."""
    try:
        package = importlib.import_module(DESCRIPTIONS)
    except ImportError as cause:
        raise MissingExtraError(
            f"the name '{name}' needs the package '{DESCRIPTIONS}', which is not installed; "
            f"pip install {DESCRIPTIONS} installs it, and taut arms lists the names that need no download",
            name=DESCRIPTIONS,
        ) from cause
    known = [module.name for module in pkgutil.iter_modules(package.__path__) if PATTERN.match(module.name)]
    if name not in known:
        raise unknown_name(DESCRIPTIONS, "description", name, known)
    module = _downloaded(name)
    for attribute in ("URDF_PATH", "MJCF_PATH"):
        path = getattr(module, attribute, None)
        if path is not None:
            folder = Path(getattr(module, "PACKAGE_PATH", Path(path).parent))
            return Path(path), {folder.name: folder}
    raise FileError(f"{DESCRIPTIONS} has neither URDF nor MJCF of '{name}'; name another description", name=name)


def _downloaded(name: str) -> ModuleType:
    try:
        return importlib.import_module(f"{DESCRIPTIONS}.{name}")
    except Exception as cause:  # it runs git, which fails in ways of its own
        said = next(iter(str(cause).strip().splitlines()), type(cause).__name__)
        raise FileError(
            f"{DESCRIPTIONS} could not supply '{name}': {said}; it downloads models: check the network, "
            "or give the path of a file",
            name=name,
        ) from cause
