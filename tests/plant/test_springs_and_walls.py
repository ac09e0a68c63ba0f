"""Springs, cords, dampers and walls at the tool, against potentials, closed forms and what they may never do."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from environment_runs import GANTRY, MASSES, at, free, rigid, work
from refusals import refused
from scipy.spatial.transform import Rotation

import taut
from taut.base.types import Float64Array
from taut.maths import dynamics as dyn
from taut.maths.model import model_of

PANDA = taut.load_arm("panda").with_joints(viscous=0.0, coulomb=0.0)


def full_stiffness(seed: int = 3) -> Float64Array:
    """(6, 6) positive, with every coupling."""
    A = np.random.default_rng(seed).normal(size=(6, 6)) * np.array([10.0] * 3 + [2.0] * 3)[:, None]
    return A @ A.T + np.eye(6)


class TestASpring:
    K = full_stiffness()
    PLACE = taut.Pose([0.1, -0.2, 0.3], rpy=[0.3, -0.4, 0.5])

    def potential(self, p: Any, R: Any) -> float:
        """By SciPy's rotation vectors."""
        R_A = np.asarray(self.PLACE.R)
        e = np.concatenate([R_A.T @ (p - self.PLACE.p), Rotation.from_matrix(R_A.T @ R).as_rotvec()])
        return float(0.5 * e @ self.K @ e)

    @pytest.mark.parametrize("angle", [0.0, 1e-6, 0.02, 1.0, 2.5, 3.14])
    def test_pulls_down_its_potential(self, angle: float) -> None:
        spring = taut.environments.Spring(stiffness=self.K, at=self.PLACE)
        axis = np.array([1.0, -2.0, 0.5]) / np.sqrt(5.25)
        R = np.asarray(self.PLACE.R) @ Rotation.from_rotvec(angle * axis).as_matrix()
        p, h = np.array([0.15, -0.1, 0.25]), 1e-6
        got = at(spring, p, R=R)
        expected = np.zeros(6)
        for i in range(3):
            d = h * np.eye(3)[i]
            expected[i] = -(self.potential(p + d, R) - self.potential(p - d, R)) / (2 * h)
            turned = [Rotation.from_rotvec(s * d).as_matrix() @ R for s in (1.0, -1.0)]
            expected[3 + i] = -(self.potential(p, turned[0]) - self.potential(p, turned[1])) / (2 * h)
        np.testing.assert_allclose(got, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())

    def test_gives_back_what_it_got_on_any_way(self) -> None:
        """Motion and potential energy of a Panda that it throws about: fourth order keeps their sum."""
        home = taut.snapshot(PANDA, PANDA.home).T()
        place = taut.Pose(
            home.p + np.array([0.1, 0.1, -0.1]), R=home.R @ Rotation.from_rotvec([0.5, -0.6, 0.3]).as_matrix()
        )
        spring = taut.environments.Spring(stiffness=self.K, at=place)
        out = free(rigid(spring, PANDA, integrator="rk4"), duration=0.6, rate=4000.0)
        model = model_of(PANDA)
        kinetic = np.array([dyn.kinetic_energy(model, q, v) for q, v in zip(out.q[::200], out.v[::200], strict=True)])
        assert kinetic.max() > 1.0
        np.testing.assert_allclose(work(out)[::200], kinetic, rtol=0.0, atol=1e-8 * kinetic.max())
        stored = []
        for q in out.q[::200]:
            T = taut.snapshot(PANDA, q).T()
            R_A = np.asarray(place.R)
            e = np.concatenate([R_A.T @ (T.p - place.p), Rotation.from_matrix(R_A.T @ T.R).as_rotvec()])
            stored.append(0.5 * e @ self.K @ e)
        total = np.array(stored) + kinetic
        np.testing.assert_allclose(total, total[0], rtol=1e-7)

    def test_neither_gains_nor_loses_in_many_semi_implicit_steps(self) -> None:
        out = free(rigid(taut.environments.Spring(stiffness=300.0)), duration=60.0, v0=[0.0, 0.0, 0.2])
        energy = 0.5 * 3.0 * out.v[:, 2] ** 2 + 150.0 * out.q[:, 2] ** 2
        swing = 0.5 * 10.0 * 1e-3  # omega dt / 2: by how much the energy of the scheme differs from this one
        assert np.abs(energy / energy[0] - 1.0).max() < swing / (1.0 - swing) * (1.0 + 1e-4)
        first, last = energy[:20000], energy[-20000:]
        assert last.max() == pytest.approx(first.max(), rel=1e-9)
        assert work(out).max() < 1.001 * swing**2 * energy[0]  # what it gives back beyond what it got

    @pytest.mark.parametrize("name", ["one_joint", "planar2"])
    def test_makes_an_arm_ring_at_the_frequency_of_its_mass(self, name: str) -> None:
        arm = taut.load_arm(name).with_joints(viscous=0.0)
        q = np.full(arm.n, 0.4)
        x = taut.snapshot(arm, q)
        K = x.J()[:3].T @ (400.0 * np.eye(3)) @ x.J()[:3]
        omega2, modes = np.linalg.eig(np.linalg.solve(x.M, K))
        mode, omega = modes[:, -1], np.sqrt(omega2[-1])
        out = free(
            taut.RigidPlant(
                arm, environment=taut.environments.Spring(stiffness=400.0), adds=("gravity",), integrator="rk4"
            ),
            duration=2.0,
            q0=q,
            v0=1e-6 * mode,
        )
        expected = np.outer(np.sin(omega * out.t), 1e-6 / omega * mode)
        np.testing.assert_allclose(out.q - q, expected, rtol=0.0, atol=1e-5 * np.abs(expected).max())

    def test_is_stiffened_by_an_event(self) -> None:
        spring = taut.environments.Environments(
            spring=taut.environments.Spring(stiffness=(300.0, 0.0), at=[0.1, 0.0, -0.2]),
            damper=taut.environments.Damper(damping=60.0),
        )
        change = {"environment.spring.stiffness": [600.0] * 3 + [0.0] * 3}
        out = free(rigid(spring), duration=0.3, events=[taut.Event(t=0.2, set=change)])
        stiffness = np.where(out.t < 0.2 - 1e-9, 300.0, 600.0)
        np.testing.assert_allclose(
            out.extra["F_ext"][:, 0], stiffness * (0.1 - out.q[:, 0]) - 60.0 * out.v[:, 0], atol=1e-9
        )


class TestACord:
    CORD = taut.environments.Spring(stiffness=300.0, slack=0.1, at=[0.0, 0.0, 0.0])

    @pytest.mark.parametrize("way", [[0.0, 0.0, 0.0], [0.05, 0.0, 0.0], [0.0, 0.06, 0.08]])
    def test_is_slack_within_its_length(self, way: list[float]) -> None:
        np.testing.assert_array_equal(at(self.CORD, way), np.zeros(6))

    def test_pulls_along_itself_beyond_it(self) -> None:
        np.testing.assert_allclose(at(self.CORD, [0.0, 0.12, 0.16]), [0.0, -18.0, -24.0, 0.0, 0.0, 0.0], atol=1e-12)

    def test_without_a_length_is_a_spring(self) -> None:
        cord, spring = taut.environments.Spring(stiffness=300.0, slack=0.0), taut.environments.Spring(stiffness=300.0)
        np.testing.assert_allclose(at(cord, [0.1, 0.2, 0.3]), at(spring, [0.1, 0.2, 0.3]), rtol=1e-15)

    def test_throws_the_tool_back_no_faster(self) -> None:
        for v in (0.3, 0.33):
            out = free(rigid(taut.environments.Spring(stiffness=3000.0, slack=0.05)), duration=2.0, v0=[0.0, 0.0, v])
            speed = np.abs(out.v[:, 2])
            assert out.q[:, 2].min() < 0.0  # it came back
            assert speed.max() < v * 1.02
            assert speed.max() == pytest.approx(v, rel=0.02)


class TestADamper:
    def test_brakes_exponentially(self) -> None:
        out = free(rigid(taut.environments.Damper(damping=12.0), integrator="rk4"), v0=[0.1, 0.2, 0.3])
        expected = np.exp(-np.outer(out.t, 12.0 / MASSES)) * [0.1, 0.2, 0.3]
        np.testing.assert_allclose(out.v, expected, rtol=0.0, atol=1e-10)
        np.testing.assert_allclose(work(out), 0.5 * (out.v**2 - out.v[0] ** 2) @ MASSES, rtol=0.0, atol=1e-10)


class TestAWall:
    FLOOR = taut.environments.StiffWall(point=[0.3, 0.1, -0.25], normal=[0.0, 0.0, 2.0], stiffness=1e4, damping=100.0)

    def test_never_pulls_and_begins_without_a_jump(self) -> None:
        rng = np.random.default_rng(0)
        for _ in range(500):
            p, v = rng.normal(size=3) * 0.01 + [0, 0, -0.25], rng.normal(size=3)
            F = at(self.FLOOR, p, v)
            assert F[2] >= 0.0
            assert (F[[0, 1, 3, 4, 5]] == 0.0).all()
            if p[2] > -0.25:
                assert F[2] == 0.0
        depths = np.linspace(-1e-5, 2e-4, 2101)
        force = np.array([at(self.FLOOR, [0, 0, -0.25 - d], [0, 0, -0.5])[2] for d in depths])
        assert np.abs(np.diff(force)).max() < 0.01 * force.max()

    def test_carries_a_weight_at_its_static_depth(self) -> None:
        plant = taut.RigidPlant(GANTRY, environment=self.FLOOR, adds=())
        out = free(plant, duration=6.0)
        depth = -0.25 - (out.q[-1, 2] - 0.2)
        assert depth == pytest.approx(3.0 * 9.81 / 1e4, rel=1e-9)

    def test_rings_as_a_mass_on_spring_and_damper(self) -> None:
        """Pressed so deep that it stays below the onset of its damping."""
        m, k, b, dt = 3.0, 1e4, 100.0, 1e-4
        out = free(taut.RigidPlant(GANTRY, environment=self.FLOOR, substeps=10), duration=0.3, q0=[0.0, 0.0, -0.0545])
        rest = -0.05 - m * 9.81 / k
        zeta, omega = b / (2.0 * np.sqrt(k * m)), np.sqrt(k / m)
        damped = omega * np.sqrt(1.0 - zeta**2)
        y0 = out.q[0, 2] - rest
        swing = np.cos(damped * out.t) + zeta * omega / damped * np.sin(damped * out.t)
        expected = y0 * np.exp(-zeta * omega * out.t) * swing
        assert (out.q[:, 2] < -0.05 - 1e-4).all()
        np.testing.assert_allclose(out.q[:, 2] - rest, expected, rtol=0.0, atol=3.0 * omega * dt * abs(y0))

    @pytest.mark.part(1)
    @pytest.mark.parametrize("stiffness", [3e3, 3e4])
    def test_gives_back_no_more_than_it_got(self, stiffness: float) -> None:
        """Any speed and any place in a step at which it is met; without damping, as much as its docstring says."""
        dt, gained = 1e-3, []
        for damping in (0.0, 0.5 * stiffness * dt, 2.0 * np.sqrt(3.0 * stiffness)):
            wall = taut.environments.StiffWall(
                point=[0, 0, -0.25], normal=[0, 0, 1], stiffness=stiffness, damping=damping
            )
            plant = rigid(wall, substeps=2)
            most = -np.inf
            for speed in (0.05, 0.3):
                for place in np.linspace(0.0, 1.0, 5):
                    out = free(plant, duration=0.4, v0=[0, 0, -speed], q0=[0, 0, -0.05 + (3.0 + place) * speed * dt])
                    assert out.v[-1, 2] > -1e-9
                    bound = 0.5 * stiffness * (speed * 0.5 * dt) ** 2
                    most = max(most, float(work(out)[-1]) / bound)
            gained.append(most)
        assert 0.0 < gained[0] <= 1.01  # in units of stiffness (v dt)^2 / 2
        assert gained[1] <= 1e-9
        assert gained[2] < 0.0

    def test_brakes_what_slides_along_it_by_coulombs_law(self) -> None:
        wall = taut.environments.StiffWall(
            point=[0, 0, -0.2], normal=[0, 0, 1], stiffness=1e4, damping=300.0, friction=0.4, sliding_damping=1000.0
        )
        sunk = -3.0 * 9.81 / 1e4
        out = free(taut.RigidPlant(GANTRY, environment=wall), duration=0.5, q0=[0, 0, sunk], v0=[0.5, 0.0, 0.0])
        np.testing.assert_allclose(out.v[:, 0], 0.5 - 0.4 * 3.0 * 9.81 / 21.0 * out.t, rtol=0.0, atol=1e-9)

    def test_holds_by_friction_but_for_its_creep(self) -> None:
        wall = taut.environments.StiffWall(
            point=[0, 0, -0.2], normal=[0, 0, 1], stiffness=1e4, damping=300.0, friction=0.4, sliding_damping=1000.0
        )
        push = taut.environments.Push(peak=[5.0, 0.0, 0.0], t=0.0, duration=10.0, shape="rectangular")
        sunk = -3.0 * 9.81 / 1e4
        out = free(
            taut.RigidPlant(GANTRY, environment=taut.environments.Environments(wall=wall, push=push)),
            duration=1.0,
            q0=[0, 0, sunk],
        )
        assert out.v[-1, 0] == pytest.approx(5.0 / 1000.0, rel=1e-6)


class TestStepsThatAreTooLong:
    def test_are_refused_with_how_many_are_enough(self) -> None:
        wall = taut.environments.StiffWall(point=[0, 0, -0.25], normal=[0, 0, 1], stiffness=6e6, damping=2000.0)
        with refused(taut.errors.RangeError):
            free(rigid(wall))
        out = free(rigid(wall, substeps=2), v0=[0, 0, -0.3])
        assert np.abs(out.v[:, 2]).max() <= 0.3

    @pytest.mark.parametrize(
        ("environment", "rate"),
        [
            (taut.environments.Spring(stiffness=3.0), 1.0),
            (
                taut.environments.Environments(
                    a=taut.environments.Spring(stiffness=3.0), b=taut.environments.Spring(stiffness=9.0)
                ),
                2.0,
            ),
            (taut.environments.Spring(stiffness=np.diag([3.0, 3.0, 3.0, 0.0, 0.0, 0.0])), 1.0),
            (taut.environments.StiffWall(point=[0, 0, 0], normal=[0, 1, 0], stiffness=9.0), 1.0),
            (taut.environments.Hand(mass=3.0, grip=1.0), np.sqrt(2.0)),
        ],
    )
    def test_are_judged_by_how_fast_the_tool_swings(self, environment: Any, rate: float) -> None:
        mobility = np.zeros((6, 6))
        mobility[:3, :3] = np.diag(1.0 / MASSES)
        omega, _ = environment.rates(mobility, environment.parameters())
        assert omega == pytest.approx(rate, rel=1e-12)

    @pytest.mark.parametrize("share", [0.98, 1.02])
    def test_the_border_that_the_rule_is_half_of_is_that_of_stability(self, share: float) -> None:
        """omega^2 dt^2 + 2 delta dt = 4, with as much of it from the spring as from the damper."""
        m, dt = 3.0, 1e-3
        k, b = share * 2.0 * m / dt**2, share * m / dt
        x, v, peak = 0.0, 1e-3, 0.0
        for _ in range(500):
            v += dt * (-k * x - b * v) / m
            x += dt * v
            peak = abs(v)
        assert (peak < 1e-3) == (share < 1.0)

    def test_none_are_too_long_for_what_rests_in_stiff_drives(self) -> None:
        drives = taut.drives.Actuation(bandwidth=50.0)
        plant = taut.RigidPlant(
            GANTRY, takes="velocity", actuation=drives, environment=taut.environments.Spring(stiffness=1e7)
        )
        plant.start(np.zeros(3), np.zeros(3), plant.parameters, 1e-3)


def test_stiff_drives_feel_what_they_do_not_give_way_to() -> None:
    """The wrench is that of the spring at the true pose; the torque holds against it."""

    class Drives(taut.Law):
        def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Velocity:
            return taut.Velocity(wanted=ref.v, felt=0.0 * x.F_ext[:3])

    drives = taut.drives.Actuation(bandwidth=50.0)
    made = {"takes": "velocity", "actuation": drives}
    spring = taut.environments.Environments(
        a=taut.environments.Spring(stiffness=300.0), b=taut.environments.Damper(damping=7.0)
    )
    ctrl = taut.compile(Drives(), GANTRY)
    ref = taut.JointMotion(q=np.zeros(3), v=np.array([0.1, 0.2, -0.1]))
    out = taut.run(ctrl, taut.RigidPlant(GANTRY, environment=spring, **made), ref, duration=1.0)  # type: ignore[arg-type]
    bare = taut.run(
        taut.compile(VelocityAlone(), GANTRY),
        taut.RigidPlant(GANTRY, **made),
        ref,
        duration=1.0,  # type: ignore[arg-type]
    )
    np.testing.assert_allclose(out.q, bare.q, rtol=0.0, atol=1e-15)
    force = -300.0 * out.q - 7.0 * out.v
    np.testing.assert_allclose(out.extra["F_ext"][:, :3], force, rtol=0.0, atol=1e-11)
    np.testing.assert_allclose(out.tau, bare.tau - force, rtol=0.0, atol=1e-9)
    gone = 150.0 * (out.q**2).sum(axis=1) + 7.0 * np.cumsum((out.v**2).sum(axis=1)) * 1e-3
    assert work(out)[-1] == pytest.approx(-gone[-1], rel=2e-3)


class VelocityAlone(taut.Law):
    def command(self, x: taut.Snapshot, ref: taut.JointMotion) -> taut.Velocity:
        return taut.Velocity(wanted=ref.v)
