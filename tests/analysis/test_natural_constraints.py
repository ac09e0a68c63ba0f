"""Natural and artificial constraints: the chapter's table and its examples, linear algebra, modes, messages."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from numpy.testing import assert_allclose

import taut
from taut import Constraint, Pose
from taut.analysis.constraints import Mode, coefficients_of
from taut.trace import math as tm

AXES = ("x", "y", "z", "phi_x", "phi_y", "phi_z")
BOARD = Constraint.plane(point=[0.0, 0.0, 0.0], normal=[0.0, 0.0, 1.0])
ERASER = Constraint.plane(point=[0.0, 0.0, 0.02], normal=[0.0, 0.0, 1.0], face=[0.0, 0.0, -1.0])
WHEEL = Constraint.pfaffian(lambda T: tm.array([*T.R[:, 1], 0.0, 0.0, 0.0]))
SCREW = Constraint.pfaffian(
    lambda T: np.array(
        [[1, 0, 0, 0, 0, 0], [0, 1, 0, 0, 0, 0], [0, 0, 1, 0, 0, -0.01], [0, 0, 0, 1, 0, 0], [0, 0, 0, 0, 1, 0]],
        float,
    )
)


def read(table: taut.analysis.ConstraintTable) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What the printed rows say along the axes: of motions, what these are, and of forces."""
    motions, right, forces = [], [], []
    for row in table.rows:
        left, _, value = row.natural.partition(" = ")
        if row.free == "force":
            motions.append(coefficients_of(left.replace("-dot", "_dot"), [f"{a}_dot" for a in AXES]))
            right.append(float(value))
        else:
            forces.append(coefficients_of(left, [f"F_{a}" for a in AXES]))
    return np.array(motions).reshape(-1, 6), np.array(right), np.array(forces).reshape(-1, 6)


def of_axes_alone(table: taut.analysis.ConstraintTable) -> bool:
    return all(" + " not in row.natural and " - " not in row.natural for row in table.rows)


class TestTheChaptersExamples:
    @pytest.mark.parametrize("about_z", [0.0, 0.7])
    def test_the_eraser_has_the_chapters_six_rows(self, about_z: float) -> None:
        table = taut.analysis.natural_constraints(ERASER, at=Pose([0.4, 0.1, 0.02], rpy=[0.0, 0.0, about_z]))
        assert table.content().tables[0].rows == [
            ("phi_x-dot = 0", "F_phi_x = k1"), ("phi_y-dot = 0", "F_phi_y = k2"), ("F_phi_z = 0", "phi_z-dot = k3"),
            ("F_x = 0", "x-dot = k4"), ("F_y = 0", "y-dot = k5"), ("z-dot = 0", "F_z = k6"),
        ]  # fmt: skip
        assert (table.motions, table.forces) == (3, 3)

    def test_a_cabinet_door_has_one_motion_about_its_hinges_and_no_moment_about_them(self) -> None:
        T = Pose([0.8, 0.2, 0.3], rpy=[0.3, 0.1, 0.2])
        table = taut.analysis.natural_constraints(
            Constraint.hinge(point=[0.5, 0.2, 0.0], axis=[0.0, 0.0, 1.0], T=T), at=T, frame=Pose([0.5, 0.2, 0.3])
        )
        assert [(row.natural, row.artificial) for row in table.rows] == [
            ("phi_x-dot = 0", "F_phi_x"),
            ("phi_y-dot = 0", "F_phi_y"),
            ("F_phi_z = 0", "phi_z-dot"),
            ("x-dot = 0", "F_x"),
            ("y-dot = 0", "F_y"),
            ("z-dot = 0", "F_z"),
        ]

    @pytest.mark.parametrize(
        ("mode", "motions", "forces", "free"),
        [
            ("slide", 5, 1, ["phi_x-dot", "phi_y-dot", "phi_z-dot", "x-dot", "y-dot", "F_z"]),
            ("stick", 3, 3, ["phi_x-dot", "phi_y-dot", "phi_z-dot", "F_x", "F_y", "F_z"]),
            ("apart", 6, 0, ["phi_x-dot", "phi_y-dot", "phi_z-dot", "x-dot", "y-dot", "z-dot"]),
        ],
    )
    def test_the_chalk_slides_sticks_or_is_apart(
        self, mode: Mode, motions: int, forces: int, free: list[str]
    ) -> None:
        table = taut.analysis.natural_constraints(BOARD, at=Pose([0.4, 0.1, 0.0], rpy=[3.0, 0.2, 0.1]), mode=mode)
        assert (table.motions, table.forces) == (motions, forces)
        assert [row.artificial for row in table.rows] == free


THINGS = {
    "plane": (lambda T: Constraint.plane(point=T.p, normal=[0.3, -0.2, 0.9]), 1),
    "face": (lambda T: Constraint.plane(point=T.p, normal=T.R @ [0, 0, -1.0], face=[0.0, 0.0, 1.0]), 3),
    "sphere": (lambda T: Constraint.sphere(center=T.p - [0.06, 0.08, 0.0], radius=0.1), 1),
    "cylinder": (lambda T: Constraint.cylinder(point=T.p - [0, 0.06, 0.08], axis=[1.0, 0.0, 0.0], radius=0.1), 1),
    "line": (lambda T: Constraint.line(point=T.p, axis=[1.0, 2.0, -0.5]), 2),
    "hinge": (lambda T: Constraint.hinge(point=[0.5, 0.2, 0.1], axis=[0.2, -1.0, 0.3], T=T), 5),
    "wheel": (lambda T: WHEEL, 1),
    "wheel on a board": (lambda T: WHEEL + Constraint.plane(point=T.p, normal=T.R[:, 2]), 2),
    "chalk in a hand": (lambda T: Constraint(lambda X: X.p[2] + (X.R @ [0.1, 0, 0.2])[2] - 0.4, one_sided=True), 1),
}
POSE = Pose([0.4, -0.3, 0.5], rpy=[0.3, -0.4, 0.5])


class TestTables:
    @pytest.mark.parametrize("name", [*THINGS, "screw"])
    @pytest.mark.parametrize("frame", [None, Pose([1.0, -0.5, 0.2], rpy=[1.0, 2.0, 3.0])])
    def test_what_is_printed_is_what_the_constraint_says(self, name: str, frame: Pose | None) -> None:
        """In every frame: the rows, read back from text, hold for all of ker A and range A^T and for nothing else."""
        constraint = SCREW if name == "screw" else THINGS[name][0](POSE)
        table = taut.analysis.natural_constraints(constraint, at=POSE, frame=frame)
        task = table.frame
        assert task is not None
        motions, right, forces = read(table)
        A = constraint.of_twist(POSE)[0]
        d = task.p - POSE.p
        to_task = np.zeros((6, 6))
        to_task[:3, :3] = to_task[3:, 3:] = task.R.T
        to_task[:3, 3:] = task.R.T @ -np.cross(d, np.eye(3)).T  # v + w x d
        V = to_task @ scipy.linalg.null_space(A)
        F = np.linalg.inv(to_task).T @ A.T
        assert_allclose(motions @ V, 0.0, atol=2e-5)  # six digits are printed
        assert_allclose(forces @ F, 0.0, atol=2e-5)
        assert not right.any()
        assert np.linalg.matrix_rank(motions) == table.forces == np.linalg.matrix_rank(A)
        assert np.linalg.matrix_rank(forces) == table.motions
        # What may be chosen is independent: as coordinates of ker A and of range A^T.
        free = [row.index for row in table.rows if row.free == "motion"]
        held = [row.index for row in table.rows if row.free == "force"]
        assert np.linalg.cond(V[free]) < 1e3
        assert np.linalg.cond(F[held]) < 1e6

    def test_N_is_a_basis_of_the_kernel_with_the_free_motions_as_coordinates(self) -> None:
        rng = np.random.default_rng(3)
        for k in range(1, 6):
            A = rng.normal(size=(k, 6))
            table = taut.analysis.natural_constraints(Constraint.pfaffian(lambda T, A=A: A), at=POSE)
            assert_allclose(table.A @ table.N, 0.0, atol=1e-12)
            assert scipy.linalg.subspace_angles(table.N, scipy.linalg.null_space(A)).max() < 1e-7
            free = sorted(row.index for row in table.rows if row.free == "motion")
            u = rng.normal(size=6 - k)
            assert_allclose((table.N @ u)[free], u, atol=1e-12)
            assert_allclose(np.linalg.pinv(table.N) @ table.N, np.eye(6 - k), atol=1e-12)

    def test_a_screw_has_sums_and_so_has_a_hinge_seen_from_the_tool(self) -> None:
        naturals = [row.natural for row in taut.analysis.natural_constraints(SCREW, at=Pose()).rows]
        assert {"z-dot - 0.01 phi_z-dot = 0", "0.01 F_z + F_phi_z = 0"} < set(naturals)
        T = Pose([0.8, 0.2, 0.3])
        door = Constraint.hinge(point=[0.5, 0.2, 0.0], axis=[0.0, 0.0, 1.0], T=T)
        naturals = [row.natural for row in taut.analysis.natural_constraints(door, at=T).rows]
        assert {"y-dot - 0.3 phi_z-dot = 0", "0.3 F_y + F_phi_z = 0"} < set(naturals)

    def test_a_surface_that_moves_says_how_fast(self) -> None:
        belt = Constraint.plane(point=[0, 0, 0], normal=[0, 0, 1.0], velocity=[0.3, 0, 0.1])
        table = taut.analysis.natural_constraints(belt, at=Pose([0.0, 0.0, 0.2]))
        assert table.rows[-1].natural == "z-dot = 0.1"
        assert_allclose(table.phi_t, [-0.1])


class TestArms:
    def test_a_snapshot_says_what_its_pose_says(self) -> None:
        arm = taut.load_arm("panda")
        x = taut.snapshot(arm, arm.home)
        for make, _ in THINGS.values():
            constraint = make(x.T())
            table = taut.analysis.natural_constraints(constraint, at=x)
            assert str(table) == str(taut.analysis.natural_constraints(constraint, at=x.T()))
            assert_allclose(table.A, constraint.at(x).A, atol=1e-12)

    def test_a_surface_that_moves_does_so_for_a_snapshot_too(self) -> None:
        x = taut.snapshot(taut.load_arm("panda"), taut.load_arm("panda").home)
        belt = Constraint.plane(point=x.T().p, normal=[0, 0, 1.0], velocity=[0, 0, 0.1])
        assert taut.analysis.natural_constraints(belt, at=x).rows[-1].natural == "z-dot = 0.1"

    def test_two_arms_that_hold_one_bar_have_the_joints_that_are_left(self) -> None:
        arm = taut.load_arm("baxter")
        x = taut.snapshot(arm, arm.home)
        bar = Constraint.grasp(
            "left_gripper", "right_gripper", T=x.T("left_gripper").inverse() @ x.T("right_gripper")
        )
        table = taut.analysis.natural_constraints(bar, at=x)
        assert (table.motions, table.forces) == (arm.n - 6, 6)
        assert scipy.linalg.subspace_angles(table.N, scipy.linalg.null_space(bar.at(x).A_q)).max() < 1e-7

    def test_a_constraint_of_joints_has_its_rows_along_them(self) -> None:
        arm = taut.load_arm("planar2")
        table = taut.analysis.natural_constraints(
            Constraint.of_joints(lambda q: q[0] - 2.0 * q[1]), at=taut.snapshot(arm, [0.4, 0.2])
        )
        assert [(row.natural, row.artificial) for row in table.rows] == [
            ("tau_joint1 + 0.5 tau_joint2 = 0", "joint1-dot"),
            ("-0.5 joint1-dot + joint2-dot = 0", "tau_joint2"),
        ]
        assert table.frame is None
        assert_allclose(table.A @ [0.2, 0.1], 0.0, atol=1e-12)

    def test_rows_that_say_the_same_twice_count_once(self) -> None:
        table = taut.analysis.natural_constraints(BOARD + BOARD, at=Pose())
        assert (table.motions, table.forces) == (5, 1)

    def test_apart_nothing_of_the_eraser_is_left_but_other_constraints_are(self) -> None:
        assert taut.analysis.natural_constraints(ERASER, at=Pose([0, 0, 0.02]), mode="apart").motions == 6
        both = taut.analysis.natural_constraints(ERASER + WHEEL, at=Pose([0, 0, 0.02]), mode="apart")
        assert (both.motions, both.forces) == (5, 1)

    def test_a_frame_of_the_arm_sticks_where_it_touches(self) -> None:
        arm = taut.load_arm("panda")
        board = Constraint(lambda T: T.p[2] - 0.2, frames=("panda_hand",), one_sided=True)
        table = taut.analysis.natural_constraints(board, at=taut.snapshot(arm, arm.home), mode="stick")
        assert_allclose(table.N.T @ [1.0, 0.5, -5.0, 0, 0, 0], 0.0, atol=1e-12)  # a force at the frame's origin
        assert_allclose(table.A @ [0, 0, 0, 0.1, 0.2, 0.3], 0.0, atol=1e-12)  # a rotation about it
        assert of_axes_alone(table)


PLANAR = taut.snapshot(taut.load_arm("planar2"), [0.1, 0.2])
JOINT = Constraint.of_joints(lambda q: q[0], one_sided=True)
LEVER = Constraint(lambda T: T.p[2] + (T.R @ [0.1, 0, 0])[2], one_sided=True)
REFUSED: dict[str, tuple[dict[str, object], type[Exception], str]] = {
    "no constraint": ({"constraint": 3}, taut.errors.UsageError, "constraint"),
    "no mode": ({"mode": "roll"}, taut.errors.UsageError, "mode"),
    "no frame": ({"frame": "task"}, taut.errors.UsageError, "frame"),
    "apart from no contact": ({"constraint": WHEEL, "mode": "apart"}, taut.errors.UsageError, "mode"),
    "no pose": ({"at": [0, 0, 0]}, taut.errors.UsageError, "at"),
    "joints at a pose": ({"constraint": JOINT}, taut.errors.UsageError, "at"),
    "a frame of joints": ({"constraint": JOINT, "at": PLANAR, "frame": Pose()}, taut.errors.UsageError, "frame"),
    "no gradient": ({"constraint": Constraint(lambda T: T.p[2] ** 2)}, taut.errors.RangeError, "constraint"),
    "NaN": ({"constraint": Constraint(lambda T: tm.sqrt(T.p @ T.p) - 0.1)}, taut.errors.RangeError, "constraint"),
    "a moment alone": (
        {"constraint": Constraint(lambda T: (T.R @ [0.1, 0, 0])[2], one_sided=True), "mode": "stick"},
        taut.errors.RangeError, "mode",
    ),
    "off the origin": ({"constraint": LEVER, "mode": "stick"}, taut.errors.RangeError, "mode"),
    "sticking of joints": ({"constraint": JOINT, "at": PLANAR, "mode": "stick"}, taut.errors.RangeError, "mode"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_bad_input_is_refused_by_name(case: str) -> None:
    words, error, name = REFUSED[case]
    with np.errstate(all="ignore"), pytest.raises(error) as caught:
        taut.analysis.natural_constraints(**{"constraint": BOARD, "at": Pose(), **words})  # type: ignore[arg-type]
    assert getattr(caught.value, "name", None) == name
