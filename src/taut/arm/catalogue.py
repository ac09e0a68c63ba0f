"""The arms that taut knows by name, from packages on PyPI: files, gripper locks, tools, home poses, drive commands.

What a file lacks is stated in the arm's notes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Final

from taut.arm.loaders.tree import Tree
from taut.arm.loaders.urdf import urdf_tree
from taut.arm.loaders.xml import read_xml
from taut.arm.parts import COMMANDS, CommandKind
from taut.base.errors import missing_extra

if TYPE_CHECKING:
    from importlib.metadata import Distribution

VELOCITY_POSITION: Final[tuple[CommandKind, ...]] = ("velocity", "position")
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
)
CATALOGUE: Final[Mapping[str, Entry]] = {entry.name: entry for entry in ENTRIES}
