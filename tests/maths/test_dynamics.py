"""Kinematics and dynamics of every arm of the catalogue, against Pinocchio's reading of the same file."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from maths_oracles import NAMES, Array, Oracle, catalogue_oracle, oracle_of, random_state, special_states

import taut
from taut.maths import dynamics as dyn
from taut.maths.model import Model, PayloadValues, model_of

# Rotation entries of the files within 1e-11 of zero are set to zero on loading; a few joints later that is 1e-10 of
# the largest entry. (Arms without such entries agree to rounding: see the random trees in test_dynamics_trees.)
SAME = 1e-10

Pair = tuple[Array, Array]


def quantities(
    model: Model, oracle: Oracle, q: Array, v: Array, a: Array, tau: Array, load: PayloadValues | None
) -> dict[str, Pair]:
    """Each quantity, ours and Pinocchio's."""
    T, T_pin = dyn.pose(model, q), oracle.pose(q)
    return {
        "M": (dyn.mass_matrix(model, q, load), oracle.M(q)),
        "h": (dyn.bias(model, q, v, load), oracle.h(q, v)),
        "g": (dyn.gravity_torque(model, q, load), oracle.g(q)),
        "C": (dyn.coriolis_matrix(model, q, v, load), oracle.C(q, v)),
        "C v": (dyn.bias(model, q, v, load, gravity=False), oracle.C(q, v) @ v),
        "J_WE_W": (dyn.jacobian(model, q), oracle.J(q, "W")),
        "J_WE_E": (dyn.jacobian(model, q, axes="E"), oracle.J(q, "E")),
        "twist": (dyn.twist(model, q, v), oracle.J(q, "W") @ v),
        "J-dot v in world axes": (dyn.jacobian_rate_v(model, q, v), oracle.Jdot_v(q, v, "W")),
        "J-dot v in tool axes": (dyn.jacobian_rate_v(model, q, v, axes="E"), oracle.Jdot_v(q, v, "E")),
        "position": (T.p, T_pin.translation),
        "orientation": (T.R, T_pin.rotation),
        "inverse dynamics": (dyn.inverse_dynamics(model, q, v, a, load), oracle.inverse_dynamics(q, v, a)),
        "forward dynamics": (dyn.forward_dynamics(model, q, v, tau, load), oracle.forward_dynamics(q, v, tau)),
        "kinetic energy": (np.array(dyn.kinetic_energy(model, q, v, load)), np.array(oracle.energies(q, v)[0])),
    }


def assert_same_as_pinocchio(arm: taut.Arm, oracle: Oracle, tolerance: float = SAME) -> None:
    """All quantities at special states, relative to the largest entry that each has among states of like speed.

    A state where gravity or Coriolis torques happen to vanish has no scale of its own.
    """
    rng = np.random.default_rng(1)
    carried = arm.payload
    load = PayloadValues(mass=carried.mass, com=carried.com, inertia=carried.inertia)
    found: dict[tuple[str, bool], list[tuple[str, Pair]]] = {}
    for state, (q, v) in special_states(arm, rng).items():
        a, tau = rng.normal(size=arm.n), rng.normal(size=arm.n)
        for name, pair in quantities(model_of(arm), oracle, q, v, a, tau, load).items():
            found.setdefault((name, state == "fast"), []).append((state, pair))
    for (name, _), pairs in found.items():
        scale = max(np.abs(expected).max() for _, (_, expected) in pairs)
        for state, (got, expected) in pairs:
            assert np.abs(got - expected).max() <= tolerance * scale, f"{arm.name}: {name} {state}"


@pytest.mark.parametrize("name", NAMES)
class TestEachArmOfTheCatalogueAgreesWithPinocchio:
    @pytest.mark.part(1)
    def test_as_its_file_says(self, name: str) -> None:
        arm = taut.load_arm(name)
        assert_same_as_pinocchio(arm, catalogue_oracle(name, arm))

    @pytest.mark.part(2)
    def test_with_a_payload_in_the_tool_frame(self, name: str) -> None:
        arm = taut.load_arm(name).with_payload(
            1.7, com=[0.03, -0.02, 0.08], inertia=[4e-3, 5e-3, 3e-3, 4e-4, 0, -2e-4]
        )
        oracle = catalogue_oracle(name, arm)
        oracle.carry(arm.payload)
        assert_same_as_pinocchio(arm, oracle)

    @pytest.mark.part(2)
    def test_with_rotor_inertia_mounted_askew_and_gravity_along_x(self, name: str) -> None:
        tilted = taut.Pose([0.5, -0.3, 0.2], rpy=[0.3, 1.1, -2.0])
        arm = taut.load_arm(name, T_WB=tilted, gravity=[9.81, 0.0, 0.0])
        arm = arm.with_joints(rotor_inertia=np.linspace(0.05, 0.4, arm.n))
        assert_same_as_pinocchio(arm, oracle_of(arm))

    def test_potential_energy_up_to_a_constant(self, name: str) -> None:
        arm = taut.load_arm(name).with_payload(1.7, com=[0.03, -0.02, 0.08])
        oracle, model, rng = catalogue_oracle(name, arm), model_of(arm), np.random.default_rng(2)
        oracle.carry(arm.payload)
        load = PayloadValues(mass=1.7, com=arm.payload.com, inertia=arm.payload.inertia)
        states = [random_state(arm, rng) for _ in range(5)]
        ours = np.array([dyn.potential_energy(model, q, load) for q, _ in states])
        theirs = np.array([oracle.energies(q, v)[1] for q, v in states])
        scale = max(np.abs(theirs).max(), 1.0)
        assert np.ptp(ours - theirs) <= SAME * scale

    def test_every_frame_of_the_file_stands_where_pinocchio_puts_it(self, name: str) -> None:
        arm = taut.load_arm(name)
        oracle, rng = catalogue_oracle(name, arm), np.random.default_rng(3)
        q, _ = random_state(arm, rng)
        for frame in arm.frame_names:
            ids = [i for i, f in enumerate(oracle.model.frames) if f.name == frame and "BODY" in str(f.type)]
            if not ids:  # a frame that only we have, such as the base
                continue
            T, expected = dyn.pose(model_of(arm), q, frame), oracle.pose(q, ids[0])
            np.testing.assert_allclose(T.p, expected.translation, rtol=0.0, atol=SAME)
            np.testing.assert_allclose(T.R, expected.rotation, rtol=0.0, atol=SAME)


def test_pinocchio_has_most_of_our_frames() -> None:
    """The test above must not pass because no frame was compared."""
    for name in NAMES:
        arm = taut.load_arm(name)
        theirs = {f.name for f in catalogue_oracle(name, arm).model.frames}
        assert len(set(arm.frame_names) & theirs) >= arm.n


@pytest.mark.part(2)
@pytest.mark.parametrize("name", ["panda", "kinova", "gantry3", "planar3"])
def test_symbols_give_what_floats_give(name: str) -> None:
    """The same code, traced and compiled; only the order of additions may differ."""
    arm = taut.load_arm(name)
    model, rng = model_of(arm), np.random.default_rng(4)
    n = arm.n

    def evaluated(q: Array, v: Array, tau: Array, mass: Array) -> Array:
        load = PayloadValues(mass=mass[0], com=mass[1:4], inertia=mass[4:])
        x = taut.Snapshot(model, q=q, v=v, payload=load)
        parts = [
            x.M.ravel(), x.h, x.g, x.Cv, x.C.ravel(), x.T().p, x.T().R.ravel(), x.J().ravel(), x.J(axes="E").ravel(),
            x.Jdot_v(), x.Jdot_v(axes="E"), x.twist(), dyn.forward_dynamics(model, q, v, tau, load),
            dyn.inverse_dynamics(model, q, v, tau, load),
        ]  # fmt: skip
        return taut.math.array([entry for part in parts for entry in np.asarray(part)])

    load = np.array([1.2, 0.02, -0.03, 0.1, 3e-3, 4e-3, 5e-3, 1e-4, 0.0, -2e-4])
    compiled = taut.native(evaluated, q=n, v=n, tau=n, mass=10)
    for q, v in special_states(arm, rng).values():
        tau = rng.normal(size=n)
        got, expected = compiled(q, v, tau, load), evaluated(q, v, tau, load)
        scale = max(np.abs(expected).max(), 1.0)
        # Native sine and cosine are polynomials; at a hundred turns their argument has lost two digits.
        assert np.abs(got - expected).max() <= 1e-11 * scale


class TestPlacesWhereAFormulaCouldBeRightByLuck:
    def test_none_stands_for_zeros(self) -> None:
        arm = taut.load_arm("panda")
        model, zero = model_of(arm), np.zeros(arm.n)
        q, v = random_state(arm, np.random.default_rng(5))
        np.testing.assert_array_equal(
            dyn.inverse_dynamics(model, q, None, None), dyn.inverse_dynamics(model, q, zero, zero)
        )
        np.testing.assert_array_equal(dyn.inverse_dynamics(model, q, v, None), dyn.bias(model, q, v))

    def test_a_tool_on_the_base_does_not_move(self) -> None:
        arm = taut.load_arm("panda", tool="panda_link0", T_WB=taut.Pose([1.0, 2.0, 3.0])).with_payload(5.0)
        model, (q, v) = model_of(arm), random_state(arm, np.random.default_rng(6))
        load = PayloadValues(mass=5.0, com=np.zeros(3), inertia=np.zeros(6))
        np.testing.assert_allclose(dyn.pose(model, q).p, [1.0, 2.0, 3.0])
        assert not dyn.jacobian(model, q).any()
        assert not dyn.jacobian_rate_v(model, q, v).any()
        np.testing.assert_array_equal(dyn.mass_matrix(model, q, load), dyn.mass_matrix(model, q))
        np.testing.assert_array_equal(dyn.gravity_torque(model, q, load), dyn.gravity_torque(model, q))

    def test_damping_stands_on_the_diagonal_of_forward_dynamics(self) -> None:
        arm = taut.load_arm("ur5")
        model, (q, v) = model_of(arm), random_state(arm, np.random.default_rng(7))
        tau, damping = np.arange(6.0), np.linspace(0.1, 2.0, 6)
        a = dyn.forward_dynamics(model, q, v, tau, damping=damping)
        back = (dyn.mass_matrix(model, q) + np.diag(damping)) @ a + dyn.bias(model, q, v)
        np.testing.assert_allclose(back, tau, rtol=0.0, atol=1e-11)

    def test_the_chapters_link_has_the_chapters_numbers(self) -> None:
        model = model_of(taut.load_arm("one_joint"))
        for theta in (0.0, 0.7, -np.pi / 2, 3.0):
            q, v = np.array([theta]), np.array([3.0])
            np.testing.assert_allclose(dyn.mass_matrix(model, q), [[0.5]], rtol=1e-14)
            np.testing.assert_allclose(dyn.bias(model, q, v), [9.81 * 0.1 * np.cos(theta)], rtol=0.0, atol=1e-15)


@pytest.mark.parametrize(
    ("quantity", "broken"),
    [
        ("C v", lambda model, q, v, load: -dyn.bias(model, q, v, load, gravity=False)),
        ("M", lambda model, q, v, load: dyn.mass_matrix(model, q)),
        ("h", lambda model, q, v, load: dyn.bias(model, q, v)),
        ("J-dot v", lambda model, q, v, load: dyn.jacobian_rate_v(model, q, v, axes="E")),
    ],
)
def test_these_comparisons_see_a_wrong_sign_a_dropped_payload_and_wrong_axes(
    quantity: str, broken: Callable[..., Array]
) -> None:
    arm = taut.load_arm("panda").with_payload(0.5, com=[0.0, 0.0, 0.1])
    oracle = catalogue_oracle("panda", arm)
    oracle.carry(arm.payload)
    load = PayloadValues(mass=0.5, com=arm.payload.com, inertia=arm.payload.inertia)
    q, v = random_state(arm, np.random.default_rng(8))
    expected = {
        "C v": lambda: oracle.C(q, v) @ v,
        "M": lambda: oracle.M(q),
        "h": lambda: oracle.h(q, v),
        "J-dot v": lambda: oracle.Jdot_v(q, v, "W"),
    }[quantity]()
    assert np.abs(broken(model_of(arm), q, v, load) - expected).max() > 1e-3 * np.abs(expected).max()
