"""Snapshot: what a law sees, computed once, less what the plant adds, with a record of what was asked for."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from refusals import refused

import taut
from taut.base.types import Float64Array
from taut.maths import dynamics as dyn
from taut.maths.model import Adds, PayloadValues, model_of

ARM = taut.load_arm("panda").with_payload(1.3, com=[0.02, 0.0, 0.05], inertia=[2e-3, 3e-3, 4e-3, 0, 0, 0])
MODEL = model_of(ARM)
RNG = np.random.default_rng(0)
Q, V = ARM.home + 0.2 * RNG.normal(size=7), RNG.normal(size=7)
OWN = PayloadValues(mass=ARM.payload.mass, com=ARM.payload.com, inertia=ARM.payload.inertia)
TOLD = taut.Payload(mass=0.4, com=[0.0, 0.0, 0.1])
ROUNDING = 1e-13  # relative to the largest entry: the same formulas, added up in another order


def seen(adds: Adds | None = None, **measured: Float64Array) -> taut.Snapshot:
    return taut.Snapshot(MODEL, q=Q, v=V, t=1.5, payload=OWN, adds=adds, measured=measured)


def assert_same(got: Float64Array, expected: Float64Array) -> None:
    scale = max(float(np.abs(dyn.bias(MODEL, Q, V, OWN)).max()), float(np.abs(expected).max()))
    assert np.abs(got - expected).max() <= ROUNDING * scale


class TestQuantities:
    def test_are_those_of_the_dynamics_with_the_payload(self) -> None:
        x = seen()
        pairs = [
            (x.M, dyn.mass_matrix(MODEL, Q, OWN)),
            (x.h, dyn.bias(MODEL, Q, V, OWN)),
            (x.g, dyn.gravity_torque(MODEL, Q, OWN)),
            (x.Cv, dyn.bias(MODEL, Q, V, OWN, gravity=False)),
            (x.C, dyn.coriolis_matrix(MODEL, Q, V, OWN)),
            (x.J(), dyn.jacobian(MODEL, Q)),
            (x.J("panda_link4", axes="E"), dyn.jacobian(MODEL, Q, "panda_link4", "E")),
            (x.Jdot_v("panda_link4"), dyn.jacobian_rate_v(MODEL, Q, V, "panda_link4")),
            (x.twist(axes="E"), dyn.twist(MODEL, Q, V, axes="E")),
            (x.T("panda_link4").p, dyn.pose(MODEL, Q, "panda_link4").p),
        ]
        for got, expected in pairs:
            np.testing.assert_array_equal(got, expected)
        np.testing.assert_allclose(taut.math.solve_spd(x.M_factors, x.h), np.linalg.solve(x.M, x.h), rtol=1e-10)
        assert (x.n, x.t) == (7, 1.5)

    @pytest.mark.parametrize(
        "ask",
        [
            lambda x: x.M, lambda x: x.M_factors, lambda x: x.h, lambda x: x.g, lambda x: x.Cv, lambda x: x.C,
            lambda x: x.T("panda_link3"), lambda x: x.J(), lambda x: x.J(axes="E"), lambda x: x.Jdot_v(axes="E"),
        ],
        ids=["M", "factors", "h", "g", "Cv", "C", "T", "J", "J_E", "Jdot_v"],
    )  # fmt: skip
    def test_are_computed_once(self, ask: object) -> None:
        x = seen()
        assert ask(x) is ask(x)  # type: ignore[operator]

    def test_of_different_frames_and_axes_are_kept_apart(self) -> None:
        x = seen()
        J = [x.J(frame, axes) for frame in (None, "panda_link4", "panda_link6") for axes in ("W", "E")]
        for a, b in itertools.combinations(J, 2):
            assert np.abs(a - b).max() > 1e-3

    def test_at_another_state_are_those_of_that_state(self) -> None:
        x = seen()
        assert x.g is x.g  # what is kept here must not turn up there
        y = x.at(ARM.home, 2.0 * V)
        np.testing.assert_array_equal(y.h, dyn.bias(MODEL, ARM.home, 2.0 * V, OWN))
        np.testing.assert_array_equal(y.J(), dyn.jacobian(MODEL, ARM.home))
        np.testing.assert_array_equal(x.h, dyn.bias(MODEL, Q, V, OWN))
        assert y.t == x.t

    def test_difference_goes_the_short_way_round_for_joints_that_wrap(self) -> None:
        kinova = taut.load_arm("kinova")
        q = np.array(kinova.home)
        there = q + np.where(np.isin(np.arange(6), kinova.continuous), 2.0 * np.pi - 0.1, 0.3)
        expected = np.where(np.isin(np.arange(6), kinova.continuous), -0.1, 0.3)
        np.testing.assert_allclose(taut.snapshot(kinova, q).difference(there), expected, rtol=0.0, atol=1e-14)


# -------------------------------------------------------------------- what the plant adds itself


class TestWhatThePlantAddsIsLeftOut:
    @pytest.mark.part(2)
    @pytest.mark.parametrize(
        "names", [c for k in range(4) for c in itertools.combinations(("gravity", "coriolis", "friction"), k)]
    )
    @pytest.mark.parametrize("load", [None, TOLD], ids=["own load", "another load"])
    def test_in_every_combination(self, names: tuple[str, ...], load: taut.Payload | None) -> None:
        adds = Adds(**dict.fromkeys(names, True), load=load)
        g, Cv = dyn.gravity_torque(MODEL, Q, OWN), dyn.bias(MODEL, Q, V, OWN, gravity=False)
        if "gravity" in names:
            known = OWN if load is None else PayloadValues(mass=load.mass, com=load.com, inertia=load.inertia)
            g = g - dyn.gravity_torque(MODEL, Q, known)
        if "coriolis" in names:
            Cv = 0.0 * Cv
        x = seen(adds)
        assert_same(x.g, g)
        assert_same(x.Cv, Cv)
        assert_same(x.h, Cv + g)
        assert_same(x.at(Q, V).h, Cv + g)
        left = 0.0 if "friction" in names else 1.0
        np.testing.assert_array_equal(x.friction.viscous, left * ARM.viscous)
        np.testing.assert_array_equal(x.friction.coulomb, left * ARM.coulomb)
        np.testing.assert_array_equal(x.friction.static, left * ARM.friction.static)
        # The Christoffel matrix is the model's, whatever the plant adds: C v_ref is no torque that a plant knows.
        np.testing.assert_array_equal(x.C, dyn.coriolis_matrix(MODEL, Q, V, OWN))

    def test_a_wrong_load_leaves_the_difference_of_the_two_weights(self) -> None:
        """One kilogram too little known to the plant, at 1 m: what is left is m g r."""
        arm = taut.load_arm("one_joint").with_tool("tool", taut.Pose([0.9, 0.0, 0.0]), name="tip")
        x = taut.Snapshot(
            model_of(arm),
            q=np.zeros(1),
            v=np.zeros(1),
            payload=PayloadValues(mass=3.0, com=np.zeros(3), inertia=np.zeros(6)),
            adds=Adds.of({"gravity": taut.Payload(mass=2.0)}),
        )
        assert x.g[0] == pytest.approx(9.81)


class TestAdds:
    def test_come_from_names_a_mapping_or_another(self) -> None:
        assert Adds.of(("gravity", "friction")) == Adds(gravity=True, friction=True)
        assert Adds.of(()) == Adds()
        assert Adds.of({"coriolis": None}).names == ("coriolis",)
        told = Adds.of({"gravity": TOLD, "coriolis": None})
        assert told.load is TOLD
        assert told.names == ("gravity", "coriolis")
        assert Adds.of(told) is told
        assert str(told) == "{gravity, coriolis}"

    @pytest.mark.parametrize(
        "given",
        [
            "gravity",
            ("gravty",),
            (1,),
            True,
            {"gravity": 1.0},
        ],
        ids=range(5),
    )
    def test_what_is_none_is_refused_in_words(self, given: object) -> None:
        with refused(taut.TautError):
            Adds.of(given)  # type: ignore[arg-type]

    def test_a_payload_for_something_else_than_gravity_is_refused(self) -> None:
        with refused(taut.errors.UsageError):
            Adds.of({"friction": TOLD})


# -------------------------------------------------------------------- what was asked for


class TestTheRecordOfWhatWasAskedFor:
    @pytest.mark.parametrize(
        ("ask", "used"),
        [
            (lambda x: (x.q, x.M, x.J(), x.T()), set()),
            (lambda x: x.h, {"gravity", "coriolis", "v"}),
            (lambda x: x.g, {"gravity"}),
            (lambda x: x.Cv, {"coriolis", "v"}),
            (lambda x: x.C, {"coriolis", "v"}),
            (lambda x: x.friction, {"friction"}),
            (lambda x: x.tau_applied, {"tau_applied"}),
            (lambda x: x.tau_cut, {"tau_cut"}),
            (lambda x: x.at(x.q, x.v).g, {"gravity", "v"}),
            (lambda x: x.F_ext, {"F_ext"}),
            (lambda x: x.Jdot_v(), {"v"}),
            (lambda x: x.twist(), {"v"}),
        ],
        ids=range(12),
    )
    @pytest.mark.parametrize("adds", [None, Adds(gravity=True, coriolis=True, friction=True)], ids=["", "adds"])
    def test_names_it(self, ask: object, used: set[str], adds: Adds | None) -> None:
        x = seen(adds, F_ext=np.zeros(6))
        ask(x)  # type: ignore[operator]
        # Where the plant adds Coriolis torques, h and Cv are without them.
        assert x.used - {"v"} == used - {"v"}
        assert adds is not None or x.used == used

    def test_a_twin_shares_the_numbers_and_has_a_record_of_its_own(self) -> None:
        x = seen()
        h = x.h
        twin = x.with_own_record()
        assert not twin.used
        assert twin.h is h  # taken from what is kept, and noted all the same
        assert twin.used == {"gravity", "coriolis", "v"}
        assert twin.at(Q, V).friction is not None
        assert twin.used == {"gravity", "coriolis", "friction", "v"}
        assert x.used == {"gravity", "coriolis", "v"}
        assert twin.M is x.M


class TestMessages:
    @pytest.mark.parametrize(
        "name",
        [
            "F_ext",
            "tau_meas",
        ],
    )
    def test_what_is_not_measured(self, name: str) -> None:
        x = seen()
        with refused(taut.errors.MatchError) as caught:
            getattr(x, name)
        assert caught.value.name == name
        assert x.used == {name}

    @pytest.mark.parametrize(
        "make",
        [
            lambda: taut.snapshot(ARM, [0.0]),
            lambda: taut.snapshot(ARM, Q, V[:3]),
            lambda: taut.snapshot(ARM, [*Q[:6], np.nan]),
            lambda: taut.snapshot("panda", Q),
            lambda: taut.snapshot(ARM, Q, payload=1.0),
            lambda: taut.snapshot(ARM, Q).J(axes="B"),
            lambda: taut.snapshot(ARM, Q).Jdot_v(axes="w"),
            lambda: taut.snapshot(ARM, Q).T("panda_hand_tpc"),
        ],
        ids=range(8),
    )
    def test_bad_input(self, make: object) -> None:
        with refused(taut.TautError):
            make()  # type: ignore[operator]

    def test_a_plain_snapshot_is_at_rest_with_the_arms_own_payload_unless_told(self) -> None:
        np.testing.assert_array_equal(taut.snapshot(ARM, Q).h, dyn.gravity_torque(MODEL, Q, OWN))
        unloaded = taut.snapshot(ARM, Q, payload=taut.Payload())
        np.testing.assert_array_equal(unloaded.g, dyn.gravity_torque(MODEL, Q))
