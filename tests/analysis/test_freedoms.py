"""Natural and artificial constraints: the chapter's table and its examples, linear algebra, modes, messages."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg
from numpy.testing import assert_allclose

import taut
from taut import Constraint, Pose
from taut.linear.linear_words import combination
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


def read(table: taut.analysis.Freedoms) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What the printed rows say along the axes: of motions, what these are, and of forces."""
    motions, right, forces = [], [], []
    for row in table.rows:
        left, _, value = row.natural.partition(" = ")
        if row.free == "force":
            motions.append(combination(left.replace("-dot", "_dot"), [f"{a}_dot" for a in AXES], "it", "motion"))
            right.append(float(value))
        else:
            forces.append(combination(left, [f"F_{a}" for a in AXES], "it", "force"))
    return np.array(motions).reshape(-1, 6), np.array(right), np.array(forces).reshape(-1, 6)


def of_axes_alone(table: taut.analysis.Freedoms) -> bool:
    return all(" + " not in row.natural and " - " not in row.natural for row in table.rows)


class TestTheChaptersExamples:
    @pytest.mark.parametrize("about_z", [0.0, 0.7])
    def test_the_eraser_has_the_chapters_six_rows(self, about_z: float) -> None:
        table = taut.analysis.freedoms(ERASER, at=Pose([0.4, 0.1, 0.02], rpy=[0.0, 0.0, about_z]))
        k1, k2 = 0.1, -10.0
        lines = table.table([k1, 0, 0, 0, 0, 0], [0, 0, k2, 0, 0, 0]).splitlines()
        assert [line.split("  ", 1)[0].strip() for line in lines[2:8]] == [
            "phi_x-dot = 0", "phi_y-dot = 0", "F_phi_z = 0", "F_x = 0", "F_y = 0", "z-dot = 0",
        ]  # fmt: skip
        assert [line.split("  ", 1)[1].strip() for line in lines[2:8]] == [
            "F_phi_x = 0", "F_phi_y = 0", "phi_z-dot = 0", "x-dot = 0.1", "y-dot = 0", "F_z = -10",
        ]  # fmt: skip
        assert (table.motions, table.forces) == (3, 3)

    def test_a_cabinet_door_has_one_motion_about_its_hinges_and_no_moment_about_them(self) -> None:
        T = Pose([0.8, 0.2, 0.3], rpy=[0.3, 0.1, 0.2])
        table = taut.analysis.freedoms(Constraint.hinge(point=[0.5, 0.2, 0.0], axis=[0.0, 0.0, 1.0], T=T), at=T)
        assert table.frame is not None
        assert_allclose(table.frame.p, [0.5, 0.2, 0.3], atol=1e-12)
        assert [(row.natural, row.artificial) for row in table.rows] == [
            ("phi_x-dot = 0", "F_phi_x"),
            ("phi_y-dot = 0", "F_phi_y"),
            ("F_phi_z = 0", "phi_z-dot"),
            ("x-dot = 0", "F_x"),
            ("y-dot = 0", "F_y"),
            ("z-dot = 0", "F_z"),
        ]
        assert "task frame: the world's axes, at [0.5, 0.2, 0.3] m" in str(table)

    @pytest.mark.parametrize(
        ("mode", "motions", "forces", "free"),
        [
            ("slide", 5, 1, ["phi_x-dot", "phi_y-dot", "phi_z-dot", "x-dot", "y-dot", "F_z"]),
            ("stick", 3, 3, ["phi_x-dot", "phi_y-dot", "phi_z-dot", "F_x", "F_y", "F_z"]),
            ("apart", 6, 0, ["phi_x-dot", "phi_y-dot", "phi_z-dot", "x-dot", "y-dot", "z-dot"]),
        ],
    )
    def test_the_chalk_slides_sticks_or_is_apart(
        self, mode: taut.analysis.constraints.contact_modes.Mode, motions: int, forces: int, free: list[str]
    ) -> None:
        table = taut.analysis.freedoms(BOARD, at=Pose([0.4, 0.1, 0.0], rpy=[3.0, 0.2, 0.1]), mode=mode, friction=0.3)
        assert (table.motions, table.forces) == (motions, forces)
        assert [row.artificial for row in table.rows] == free

    def test_sliding_friction_is_not_chosen(self) -> None:
        table = taut.analysis.freedoms(BOARD, at=Pose([0.4, 0.1, 0.0]), friction=0.3)
        assert str(table) == (
            "in contact: 5 motions and 1 force may be chosen\n"
            "natural         artificial\n"
            "F_phi_x = 0     phi_x-dot = k1\n"
            "F_phi_y = 0     phi_y-dot = k2\n"
            "F_phi_z = 0     phi_z-dot = k3\n"
            "F_x = friction  x-dot = k4\n"
            "F_y = friction  y-dot = k5\n"
            "z-dot = 0       F_z = k6\n"
            "task frame: the world's axes, at the tool's origin\n"
            "the contact can be pressed and not pulled: F_z <= 0\n"
            "friction is 0.3 of the force into the surface, along the motion on it; it is not chosen"
        )


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
    @pytest.mark.parametrize("name", THINGS)
    def test_each_ready_made_constraint_has_a_frame_with_axes_alone(self, name: str) -> None:
        make, k = THINGS[name]
        table = taut.analysis.freedoms(make(POSE), at=POSE)
        assert (table.motions, table.forces) == (6 - k, k)
        assert of_axes_alone(table), str(table)
        assert table.frame is not None
        assert_allclose(table.frame.R.T @ table.frame.R, np.eye(3), atol=1e-12)
        assert np.linalg.det(table.frame.R) == pytest.approx(1.0)

    @pytest.mark.parametrize("name", [*THINGS, "screw"])
    @pytest.mark.parametrize("frame", [None, "world", "tool", Pose([1.0, -0.5, 0.2], rpy=[1.0, 2.0, 3.0])])
    def test_what_is_printed_is_what_the_constraint_says(self, name: str, frame: Pose | None) -> None:
        """In every frame: the rows, read back from text, hold for all of ker A and range A^T and for nothing else."""
        constraint = SCREW if name == "screw" else THINGS[name][0](POSE)
        table = taut.analysis.freedoms(constraint, at=POSE, frame=frame)
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
            table = taut.analysis.freedoms(Constraint.pfaffian(lambda T, A=A: A), at=POSE, frame="world")
            assert_allclose(table.A @ table.N, 0.0, atol=1e-12)
            assert scipy.linalg.subspace_angles(table.N, scipy.linalg.null_space(A)).max() < 1e-7
            free = sorted(row.index for row in table.rows if row.free == "motion")
            u = rng.normal(size=6 - k)
            assert_allclose((table.N @ u)[free], u, atol=1e-12)
            assert_allclose(np.linalg.pinv(table.N) @ table.N, np.eye(6 - k), atol=1e-12)

    def test_a_slightly_tilted_board_keeps_the_names_of_its_axes(self) -> None:
        tilt = np.radians(3.0)
        board = Constraint.plane(point=POSE.p, normal=[np.sin(tilt), 0.0, np.cos(tilt)])
        table = taut.analysis.freedoms(board, at=POSE)
        assert table.rows[-1].natural == "z-dot = 0"
        assert table.frame is not None
        assert_allclose(table.frame.R, Pose(rpy=[0.0, tilt, 0.0]).R, atol=1e-12)
        assert f"x = [{np.cos(tilt):.4g}, 0, {-np.sin(tilt):.4g}], y = [0, 1, 0]" in str(table)

    def test_the_frame_follows_a_motion_of_everything(self) -> None:
        """Turned and shifted as a whole, a thing has rows of axes alone, and the same counts."""
        rng = np.random.default_rng(8)
        for _ in range(6):
            R, n, a = Pose(wxyz=(q := rng.normal(size=4)) / np.linalg.norm(q)).R, *rng.normal(size=(2, 3))
            T = Pose(rng.normal(size=3), R=R)
            for made in (
                Constraint.plane(point=T.p, normal=n) + Constraint.line(point=T.p, axis=np.cross(n, a)),
                Constraint.hinge(point=rng.normal(size=3), axis=a, T=T),
                Constraint.plane(point=T.p, normal=T.R @ n, face=-n),
            ):
                table = taut.analysis.freedoms(made, at=T)
                assert of_axes_alone(table), str(table)

    def test_a_screw_has_sums_and_so_has_a_hinge_seen_from_the_tool(self) -> None:
        naturals = [row.natural for row in taut.analysis.freedoms(SCREW, at=Pose()).rows]
        assert {"z-dot - 0.01 phi_z-dot = 0", "0.01 F_z + F_phi_z = 0"} < set(naturals)
        T = Pose([0.8, 0.2, 0.3])
        door = Constraint.hinge(point=[0.5, 0.2, 0.0], axis=[0.0, 0.0, 1.0], T=T)
        naturals = [row.natural for row in taut.analysis.freedoms(door, at=T, frame="world").rows]
        assert {"y-dot - 0.3 phi_z-dot = 0", "0.3 F_y + F_phi_z = 0"} < set(naturals)

    def test_a_surface_that_moves_says_how_fast(self) -> None:
        belt = Constraint.plane(point=[0, 0, 0], normal=[0, 0, 1.0], velocity=[0.3, 0, 0.1])
        table = taut.analysis.freedoms(belt, at=Pose([0.0, 0.0, 0.2]), t=2.0)
        assert table.rows[-1].natural == "z-dot = 0.1"
        assert_allclose(table.phi_t, [-0.1])
        assert "off the constraint" not in str(table)
        assert table.check([0.0, 0.0, 0.1, 0.0, 0.0, 0.0]).ok
        assert not table.check(np.zeros(6)).ok


class TestArms:
    def test_a_snapshot_says_what_its_pose_says(self) -> None:
        arm = taut.load_arm("panda")
        x = taut.snapshot(arm, arm.home)
        for make, _ in THINGS.values():
            constraint = make(x.T())
            table = taut.analysis.freedoms(constraint, at=x)
            assert str(table) == str(taut.analysis.freedoms(constraint, at=x.T()))
            assert_allclose(table.A, constraint.at(x).A, atol=1e-12)

    def test_a_surface_that_moves_does_so_for_a_snapshot_too(self) -> None:
        x = taut.snapshot(taut.load_arm("panda"), taut.load_arm("panda").home)
        belt = Constraint.plane(point=x.T().p, normal=[0, 0, 1.0], velocity=[0, 0, 0.1])
        assert taut.analysis.freedoms(belt, at=x).rows[-1].natural == "z-dot = 0.1"

    def test_a_frame_of_the_arm_is_called_by_its_name(self) -> None:
        arm = taut.load_arm("panda")
        x = taut.snapshot(arm, arm.home)
        T = x.T("panda_link6")
        slot = Constraint.plane(point=T.p, normal=T.R[:, 1], frame="panda_link6")
        table = taut.analysis.freedoms(slot, at=x, frame="tool")
        assert table.notes[0] == "task frame: the axes of 'panda_link6', at the origin of 'panda_link6'"
        assert table.notes[1] == "the contact can be pressed and not pulled: F_y <= 0"

    def test_two_arms_that_hold_one_bar_have_the_joints_that_are_left(self) -> None:
        arm = taut.load_arm("baxter")
        x = taut.snapshot(arm, arm.home)
        bar = Constraint.grasp(
            "left_gripper", "right_gripper", T=x.T("left_gripper").inverse() @ x.T("right_gripper")
        )
        table = taut.analysis.freedoms(bar, at=x)
        assert (table.motions, table.forces) == (arm.n - 6, 6)
        assert scipy.linalg.subspace_angles(table.N, scipy.linalg.null_space(bar.at(x).A_q)).max() < 1e-7
        assert table.check(table.N[:, 0], lam=[20.0, 0, 0, 0, 0, 0]).ok

    def test_an_arm_of_few_joints_has_fewer_freedoms_than_the_contact_leaves(self) -> None:
        arm = taut.load_arm("planar2")
        q = taut.dynamics.onto(Constraint.plane(point=[0, 0, 0.2], normal=[0, 0, 1.0]), arm, [0.3, 0.4])
        table = taut.analysis.freedoms(
            Constraint.plane(point=[0, 0, 0.2], normal=[0, 0, 1.0]), at=taut.snapshot(arm, q)
        )
        assert table.notes[-1] == "of these the joints of 'planar2' have 1 of 5 motions and 1 of 1 forces here"

    def test_a_constraint_of_joints_has_its_rows_along_them(self) -> None:
        arm = taut.load_arm("planar2")
        table = taut.analysis.freedoms(
            Constraint.of_joints(lambda q: q[0] - 2.0 * q[1]), at=taut.snapshot(arm, [0.4, 0.2])
        )
        assert str(table).startswith("held: 1 motion and 1 force may be chosen\n")
        assert [(row.natural, row.artificial) for row in table.rows] == [
            ("tau_joint1 + 0.5 tau_joint2 = 0", "joint1-dot"),
            ("-0.5 joint1-dot + joint2-dot = 0", "tau_joint2"),
        ]
        assert table.frame is None
        assert table.check([0.2, 0.1], lam=[3.0]).ok
        assert not table.check([0.2, 0.2]).ok

    def test_rows_that_say_the_same_twice_count_once(self) -> None:
        table = taut.analysis.freedoms(BOARD + BOARD, at=Pose())
        assert (table.motions, table.forces) == (5, 1)
        assert table.notes[-1] == "of the 2 rows 1 are independent"

    def test_a_pose_off_the_constraint_is_told(self) -> None:
        assert (
            taut.analysis.freedoms(BOARD, at=Pose([0, 0, 0.01])).notes[-1]
            == "the pose is off the constraint: phi[0] = 0.01"
        )


class TestChecks:
    def test_a_motion_and_forces_agree_with_brute_force(self) -> None:
        """Accepted are V in ker A and F in range A^T, and power along and against is zero."""
        rng = np.random.default_rng(11)
        for k in range(1, 6):
            A = rng.normal(size=(k, 6))
            table = taut.analysis.freedoms(Constraint.pfaffian(lambda T, A=A: A), at=POSE)
            V, F = scipy.linalg.null_space(A) @ rng.normal(size=6 - k), A.T @ rng.normal(size=k)
            assert table.check(V, F_app=F).ok
            assert abs(V @ F) < 1e-12
            for _ in range(5):
                wrong = rng.normal(size=6)
                assert not table.check(V + 1e-3 * wrong).ok
                assert not table.check(V, F_app=F + 1e-3 * wrong).ok

    @pytest.mark.parametrize(
        ("mode", "V", "F", "reason"),
        [
            ("slide", [0.1, 0, 0, 0, 0, 1.0], [0, 0, -5.0, 0, 0, 0], ""),
            (
                "slide", [0, 0, -0.1, 0, 0, 0], None,
                "z-dot = -0.1 may not be chosen, for the environment says z-dot = 0; choose F_z",
            ),
            (
                "slide", [0, 0, 0.1, 0, 0, 0], None,
                "z-dot = 0.1 may not be chosen, for the environment says z-dot = 0; choose F_z, or mode='apart' to leave "
                "the surface",
            ),
            (
                "slide", None, [2.0, 0, -5.0, 0, 0, 0],
                "F_x = 2 may not be chosen, for friction makes it while the contact slides; choose x-dot, or "
                "mode='stick'",
            ),
            (
                "slide", None, [0, 0, -5.0, 0.5, 0, 0],
                "F_phi_x = 0.5 may not be chosen, for the environment says F_phi_x = 0; choose phi_x-dot",
            ),
            (
                "slide", None, [0, 0, 5.0, 0, 0, 0],
                "the forces pull at a contact, lam[0] = 5, which can be pressed and not pulled; turn their sign",
            ),
            ("stick", [0, 0, 0, 0.1, 0, 0], [1.0, 1.0, -5.0, 0, 0, 0], ""),
            (
                "stick", [0.1, 0, 0, 0, 0, 0], None,
                "x-dot = 0.1 may not be chosen, for the environment says x-dot = 0; choose mode='slide'",
            ),
            (
                "stick", None, [3.0, 4.0, -10.0, 0, 0, 0],
                "5 N along the surface is outside the friction cone of 0.3 * 10 N; ask for less, or press with 16.67 N",
            ),
            ("apart", [0, 0, 0.1, 0, 0, 0], None, ""),
            (
                "apart", [0, 0, -0.1, 0, 0, 0], None,
                "the motion goes into the surface, d phi / dt = -0.1, where the tool touches it; move off it, or choose "
                "mode='slide'",
            ),
            (
                "apart", None, [0, 0, -5.0, 0, 0, 0],
                "F_z = -5 may not be chosen, for the environment says F_z = 0; choose z-dot",
            ),
        ],
    )  # fmt: skip
    def test_what_the_chalk_may_not_do_has_a_sentence(
        self, mode: str, V: list[float] | None, F: list[float] | None, reason: str
    ) -> None:
        table = taut.analysis.freedoms(BOARD, at=Pose([0.4, 0.1, 0.0]), mode=mode, friction=0.3)  # type: ignore[arg-type]
        answer = table.check(V, F_app=F)
        assert answer.ok == (not reason)
        assert "\n".join(answer.reasons) == reason
        assert not reason or str(answer) == reason

    def test_apart_in_the_air_any_motion_may_be_chosen(self) -> None:
        assert taut.analysis.freedoms(BOARD, at=Pose([0, 0, 0.1]), mode="apart").check([0, 0, -0.1, 0, 0, 0]).ok

    def test_apart_nothing_of_the_eraser_is_left_but_other_constraints_are(self) -> None:
        assert taut.analysis.freedoms(ERASER, at=Pose([0, 0, 0.02]), mode="apart").motions == 6
        both = taut.analysis.freedoms(ERASER + WHEEL, at=Pose([0, 0, 0.02]), mode="apart")
        assert (both.motions, both.forces) == (5, 1)

    @pytest.mark.parametrize("size", [1.0, 4.0])
    def test_the_friction_cone_is_that_of_coulomb(self, size: float) -> None:
        """On a tilted surface, whatever the length of its phi's gradient: margin = mu F_n - |F_t|."""
        rng = np.random.default_rng(4)
        n = np.array([0.6, 0.0, 0.8])
        wall = Constraint(lambda T: size * (n @ T.p), one_sided=True)
        table = taut.analysis.freedoms(wall, at=Pose(rpy=[0.1, 0.2, 0.3]), mode="stick", friction=0.4)
        seen = set()
        for _ in range(40):
            F = -n * rng.uniform(2.0, 10.0) + rng.uniform(-1.0, 1.0, size=3)
            pressing = -n @ F
            tangential = np.linalg.norm(F + pressing * n)
            answer = table.check(F_app=[*F, 0, 0, 0])
            (cone,) = answer.cones
            assert cone.margin == pytest.approx(0.4 * pressing - tangential, abs=1e-9)
            assert answer.ok == cone.inside == (tangential <= 0.4 * pressing)
            seen.add(answer.ok)
        assert seen == {True, False}

    def test_a_wrench_inside_the_cone_says_what_is_to_spare(self) -> None:
        table = taut.analysis.freedoms(BOARD, at=Pose(), mode="stick", friction=0.5)
        assert str(table.check(F_app=[3.0, 0, -10.0, 0, 0, 0])) == (
            "may be chosen\n3 N along the surface is inside the friction cone of 0.5 * 10 N, with 2 N to spare"
        )

    def test_a_chalk_in_a_hand_sticks_where_it_touches(self) -> None:
        """The force goes through the point, so its moment at the hand's origin is r x F."""
        r = np.array([0.1, 0.0, -0.2])
        board = Constraint(lambda T: (T.p + T.R @ r)[2], one_sided=True)
        T = Pose([0.0, 0.0, 0.2])
        table = taut.analysis.freedoms(board, at=T, mode="stick", friction=0.3, point=T.p + r)
        F = np.array([1.0, 0.5, -5.0])
        assert table.check(F_app=[*F, *np.cross(r, F)]).ok
        assert not table.check(F_app=[*F, 0, 0, 0]).ok
        w = np.array([0.1, 0.2, 0.3])
        assert table.check([*np.cross(r, w), *w]).ok  # what touches rests: v + w x r = 0
        assert of_axes_alone(table)

    def test_samples_are_taken_with_their_forces(self) -> None:
        arm = taut.load_arm("panda")
        x = taut.snapshot(arm, arm.home)
        board = Constraint.plane(point=x.T().p, normal=[0.6, 0.0, 0.8])
        table = taut.analysis.freedoms(board, at=x)
        along = taut.TaskMotion(pose=x.T(), twist=[0.8, 0.1, -0.6, 0, 0, 0])
        assert table.check(along).ok
        assert table.check(taut.pressing(along, 10.0)).ok  # type: ignore[arg-type]
        assert table.check(taut.pressing(along, lam=[-10.0])).ok  # type: ignore[arg-type]
        assert not table.check(taut.pressing(along, lam=[10.0])).ok  # type: ignore[arg-type]
        assert not table.check(taut.pressing(along, F_app=[0, 0, -1.0, 0, 0, 0])).ok  # type: ignore[arg-type]
        assert not table.check(taut.TaskMotion(pose=x.T(), twist=[1.0, 0, 0, 0, 0, 0])).ok


class TestMessages:
    @pytest.mark.parametrize(
        ("words", "error", "text"),
        [
            ({"constraint": 3}, taut.errors.UsageError, "freedoms takes a taut.Constraint; got int"),
            ({"mode": "roll"}, taut.errors.UsageError, "mode must be one of 'slide', 'stick', 'apart'; got 'roll'"),
            ({"friction": -0.1}, taut.errors.RangeError, "friction must be >= 0; got -0.1"),
            (
                {"mode": "stick"},
                taut.errors.UsageError,
                "mode='stick' needs a coefficient of friction, such as friction=0.3",
            ),
            ({"frame": "task"}, taut.errors.UsageError, "frame must be a taut.Pose, 'world' or 'tool'; got 'task'"),
            (
                {"constraint": WHEEL, "mode": "apart"},
                taut.errors.UsageError,
                "mode='apart' is for a contact, and no row of this constraint is one: say one_sided=True",
            ),
            (
                {"at": [0, 0, 0]},
                taut.errors.UsageError,
                "at must be a taut.Pose or a taut.snapshot(arm, q); got list",
            ),
            (
                {"at": taut.snapshot(taut.load_arm("planar2"), [0.1, 0.2]), "t": 1.0},
                taut.errors.UsageError,
                "t is for a pose; a snapshot has its time",
            ),
            (
                {"constraint": Constraint.of_joints(lambda q: q[0])},
                taut.errors.UsageError,
                "a constraint of joints or of several frames needs the whole arm: at=taut.snapshot(arm, q)",
            ),
            (
                {
                    "constraint": Constraint.of_joints(lambda q: q[0]),
                    "at": taut.snapshot(taut.load_arm("planar2"), [0.1, 0.2]),
                    "frame": "world",
                },
                taut.errors.UsageError,
                "frame is for a constraint of the tool; one of joints or of several frames has its rows along the joints",
            ),
            (
                {
                    "constraint": Constraint.of_joints(lambda q: q[0], one_sided=True),
                    "at": taut.snapshot(taut.load_arm("planar2"), [0.1, 0.2]),
                    "friction": 0.3,
                },
                taut.errors.UsageError,
                "friction is for contacts of the tool; this constraint is of joints or of several frames: leave it out",
            ),
            (
                {"constraint": Constraint(lambda T: T.p[2] ** 2), "at": Pose()},
                taut.errors.RangeError,
                "row 0 of the constraint must have a gradient, and it is zero there; take another pose",
            ),
            (
                {"constraint": Constraint(lambda T: tm.sqrt(T.p @ T.p) - 0.1), "at": Pose()},
                taut.errors.RangeError,
                "row 0 of the constraint must have a gradient, and it is not a number there; take another pose",
            ),
            (
                {"constraint": Constraint(lambda T: (T.R @ [0.1, 0, 0])[2], one_sided=True), "friction": 0.3},
                taut.errors.UsageError,
                "friction is for a contact that bears a force, and no row of this constraint is one: say one_sided=True, "
                "or leave it out",
            ),
            (
                {
                    "constraint": Constraint(lambda T: T.p[2] + (T.R @ [0.1, 0, 0])[2], one_sided=True),
                    "friction": 0.3,
                },
                taut.errors.UsageError,
                "friction acts where the contact is, and the force of row 0 passes the frame's origin at 0.1 m; give "
                "point=, where it touches",
            ),
            (
                {"constraint": BOARD, "friction": 0.3, "point": [0.02, 0, 0]},
                taut.errors.RangeError,
                "point must lie on the line of the contact force of row 0; it is 0.02 m off [m]",
            ),
        ],
    )
    def test_bad_input_is_refused_in_a_sentence(
        self, words: dict[str, object], error: type[Exception], text: str
    ) -> None:
        words = {"constraint": BOARD, "at": Pose(), **words}
        with np.errstate(all="ignore"), pytest.raises(error) as caught:
            taut.analysis.freedoms(**words)  # type: ignore[arg-type]
        assert str(caught.value) == text

    @pytest.mark.parametrize(
        ("arguments", "error", "text"),
        [
            ({}, taut.errors.UsageError, "check takes a motion, forces, or both; got none"),
            (
                {"F_app": np.zeros(6), "lam": [1.0]},
                taut.errors.UsageError,
                "check takes forces once; got F_app and lam",
            ),
            (
                {"motion": taut.pressing(taut.TaskMotion(pose=Pose()), 1.0), "lam": [1.0]},
                taut.errors.UsageError,
                "check takes forces once; got lam and taut.pressing(...)",
            ),
            (
                {"motion": taut.JointMotion(q=[0.0])},
                taut.errors.UsageError,
                "check takes a motion of the tool, such as taut.TaskMotion(pose=...); got JointMotion",
            ),
            (
                {"motion": taut.trajectories.Line(T0=Pose(), T1=Pose([0.1, 0, 0]), duration=1.0)},
                taut.errors.UsageError,
                "check takes a sample of a motion, such as ref.at(0.0); got a whole motion",
            ),
            ({"motion": [1.0, 2.0]}, taut.errors.ShapeError, "motion must have shape (6,); got shape (2,)"),
            ({"lam": [1.0, 2.0]}, taut.errors.ShapeError, "lam must have shape (1,) [N, N m]; got shape (2,)"),
            ({"F_app": [np.nan] * 6}, taut.errors.RangeError, "F_app[0] must be finite [N, N m]; got nan"),
        ],
    )
    def test_bad_questions_are_refused_in_a_sentence(
        self, arguments: dict[str, object], error: type[Exception], text: str
    ) -> None:
        with pytest.raises(error) as caught:
            taut.analysis.freedoms(BOARD, at=Pose()).check(**arguments)  # type: ignore[arg-type]
        assert str(caught.value) == text

    def test_press_is_for_a_row_that_has_a_force(self) -> None:
        tilt = Constraint(lambda T: T.R[2, 0])
        with pytest.raises(taut.errors.UsageError) as caught:
            taut.analysis.freedoms(tilt, at=Pose()).check(taut.pressing(taut.TaskMotion(pose=Pose()), 1.0))  # type: ignore[arg-type]
        assert str(caught.value) == (
            "press is a force, and the first row of the constraint holds rotations only; give lam="
        )

    def test_joint_speeds_are_asked_for_where_the_constraint_is_of_joints(self) -> None:
        table = taut.analysis.freedoms(
            Constraint.of_joints(lambda q: q[0]), at=taut.snapshot(taut.load_arm("planar2"), [0.0, 0.2])
        )
        with pytest.raises(taut.errors.UsageError) as caught:
            table.check(taut.TaskMotion(pose=Pose()))
        assert str(caught.value) == "check takes 2 joint speeds; got TaskMotion"
        with pytest.raises(taut.errors.UsageError) as caught:
            taut.Constraint.of_joints(lambda q: q[0]).of_twist(Pose())
        assert str(caught.value) == "a constraint of joints or of several frames has no A of one twist"
