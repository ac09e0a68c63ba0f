"""Robust control: its bound holds for every arm of the set, and its figures are those of the verified mathematics."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from refusals import refused
from robust_sets import planar_set, reference, with_links

import taut
from taut.codegen.program import over_rows
from taut.control.laws.other_topics.robust import friction_and_error
from taut.maths.model import model_of

PHI = (0.051259, 0.230643)
MRAD = 1e-3


def followed(law: taut.Law, believed: taut.Arm, true: taut.Arm, **plant: object) -> taut.Run:
    ctrl = taut.compile(law, believed)
    body = taut.RigidPlant(true, integrator="rk4", substeps=2, **plant)
    return taut.run(ctrl, body, reference(believed), duration=4.0)


def last(run: taut.Run) -> float:
    return float(np.abs(run.error[run.t >= 2.0]).max())


def heavy_planar() -> taut.Arm:
    return with_links(taut.load_arm("planar2"), 1.2).with_payload(1.0)


def test_the_acceptance_figures_of_planar2() -> None:
    arm, true = taut.load_arm("planar2"), heavy_planar()
    law = taut.laws.Robust(lam=10.0, k=10.0, phi=PHI, uncertainty=planar_set())
    assert last(followed(law, arm, true)) == pytest.approx(19.88 * MRAD, rel=0.01)
    usual = taut.laws.ComputedTorque(kp=100.0, kd=20.0) + taut.laws.FrictionCompensation(at="ref")
    assert last(followed(usual, arm.with_payload(0.5), true)) == pytest.approx(185.96 * MRAD, rel=0.01)


@pytest.mark.part(1)
@pytest.mark.parametrize("name", ["planar2", "ur10", "xarm7"])
def test_no_arm_of_the_set_errs_by_more_than_rho(name: str, share: Callable[[int], int]) -> None:
    arm, rng = taut.load_arm(name), np.random.default_rng(7)
    n, model = arm.n, model_of(arm)
    unknown = taut.laws.Uncertainty(
        links=rng.uniform(0.0, 0.5, n), payload=(0.5, 2.0), viscous=(0.1, 0.4), coulomb=(np.zeros(n), np.ones(n)),
        disturbance=0.3,
    )  # fmt: skip
    states, wrong, others = [], [], []
    for trial in range(share(300)):
        at = rng.choice((-1.0, 1.0), n) if trial % 2 else rng.uniform(-1.0, 1.0, n)
        true = with_links(arm, 1.0 + unknown.links * at).with_payload(rng.choice((0.5, 2.0, rng.uniform(0.5, 2.0))))
        q, v, v_ref, a_ref, v_des = rng.normal(size=(5, n))
        v[0] = 0.0
        sign = np.where(v == 0.0, rng.uniform(-1.0, 1.0, n), np.sign(v))  # a joint at rest may stick
        b, c, d = rng.choice((0.1, 0.4), n), rng.uniform(0.0, 1.0, n), rng.choice((-0.3, 0.3), n)
        actual = taut.snapshot(true, q, v).inverse_dynamics(a_ref, v_ref) + b * v + c * sign - d
        middle = taut.snapshot(arm.with_payload(1.25), q, v).inverse_dynamics(a_ref, v_ref)
        friction, error = friction_and_error(*unknown.friction(arm.friction), v, v_des, 0.01)
        states.append((q, v, v_ref, a_ref))
        wrong.append(np.abs(actual - middle - friction))
        others.append(error + unknown.disturbance)
    names = ("q", "v", "v_ref", "a_ref")
    torques = over_rows(lambda **x: {"parts": unknown.torques(model, **x)}, **dict.fromkeys(names, n))
    parts = torques(**dict(zip(names, np.array(states).swapaxes(0, 1), strict=True)))["parts"]
    rho = np.abs(parts).sum(axis=1) + others
    assert (wrong <= rho * (1.0 + 1e-9)).all()
    assert (wrong / rho).max() > 0.5  # the bound is no empty one


def test_the_bound_of_friction_holds_and_is_attained(share: Callable[[int], int]) -> None:
    b, c, rng, width = np.array([[0.1], [0.4]]), np.array([[0.2], [1.0]]), np.random.default_rng(2), 0.05
    for intervals in ((b, 0.0 * c), (b, c), (0.0 * b, c)):
        v, v_des = rng.normal(size=(2, share(20000))) * rng.choice((0.01, 0.1, 1.0), share(20000))
        v[::7] = 0.0
        sign = np.where(v == 0.0, rng.choice((-1.0, 1.0), len(v)), np.sign(v))
        assumed, error = friction_and_error(*intervals, v, v_des, width)
        (b_true, c_true) = (rng.choice(interval[:, 0], len(v)) for interval in intervals)
        wrong = np.abs(b_true * v + c_true * sign - assumed)
        assert (wrong <= error * (1.0 + 1e-12)).all()
        assert (wrong / error).max() > 0.999


def test_the_bound_of_bodies_is_attained_by_an_arm_of_the_set() -> None:
    arm = taut.load_arm("ur10")
    unknown, rng = taut.laws.Uncertainty(links=0.2), np.random.default_rng(1)
    q, v, v_ref, a_ref = rng.normal(size=(4, arm.n))
    parts = unknown.torques(model_of(arm), q, v, v_ref, a_ref)
    for i in range(arm.n):
        worst = with_links(arm, 1.0 + 0.2 * np.where(parts[:, i] >= 0.0, 1.0, -1.0))
        both = [taut.snapshot(x, q, v).inverse_dynamics(a_ref, v_ref)[i] for x in (worst, arm)]
        assert both[0] - both[1] == pytest.approx(np.abs(parts[:, i]).sum(), rel=1e-9)


def test_with_an_exact_model_the_loop_is_the_nominal_one() -> None:
    """Hardly an interval, hardly a robust torque: e_ddot + (k + lam) e_dot + k lam e = 0, poles at -k and -lam."""
    arm = taut.load_arm("planar2").with_friction(taut.Friction())
    law = taut.laws.Robust(lam=6.0, k=15.0, phi=0.1, uncertainty=taut.laws.Uncertainty(disturbance=1e-9))
    loop = taut.Loop(taut.compile(law, arm), taut.RigidPlant(arm), taut.JointMotion(q=arm.home), duration=1.0)
    rates = np.sort(np.log(taut.linearise(loop).poles.real) / 1e-3)
    assert rates == pytest.approx([-15.0, -15.0, -6.0, -6.0], rel=0.02)


def test_intervals_without_width_are_refused_when_the_law_is_compiled() -> None:
    bare = taut.load_arm("planar2").with_friction(taut.Friction())
    known = taut.laws.Uncertainty(viscous=(0.1, 0.1))
    for unknown in (taut.laws.Uncertainty(), known):
        with refused(taut.errors.RangeError):
            taut.compile(taut.laws.Robust(lam=10.0, k=10.0, phi=0.1, uncertainty=unknown), bare)
    dry = bare.with_friction(taut.Friction(coulomb=0.1))  # friction at the desired velocity errs while a joint sticks
    taut.compile(taut.laws.Robust(lam=10.0, k=10.0, phi=0.1, uncertainty=taut.laws.Uncertainty()), dry)


def test_friction_with_an_interval_takes_the_place_of_the_models_own() -> None:
    arm = taut.load_arm("planar2")
    unknown = taut.laws.Uncertainty(viscous=(0.05, 0.15), coulomb=(0.0, 0.2))
    law = taut.laws.Robust(lam=10.0, k=10.0, phi=0.1, uncertainty=unknown)
    moving = [0.3, 0.8], [0.5, -0.7], taut.JointMotion(q=[0.4, 0.7], v=[0.6, -0.6])
    models = (arm.with_friction(taut.Friction(viscous=b, coulomb=c)) for b, c in ((0.1, 0.1), (10.0, 3.0)))
    one, other = (taut.compile(law, model, engine="float").step(*moving) for model in models)
    np.testing.assert_array_equal(one, other)


def test_a_plant_that_adds_gravity_is_given_what_is_missing() -> None:
    arm = taut.load_arm("panda")
    law = taut.laws.Robust(
        lam=10.0, k=10.0, phi=0.2, uncertainty=taut.laws.Uncertainty(links=0.1, payload=(0.0, 2.0))
    )
    q, v = arm.home + 0.1, np.full(arm.n, 0.2)
    whole, rest = (taut.compile(law, arm, adds=adds) for adds in ((), ("gravity",)))
    ref = taut.JointMotion(q=arm.home)
    assert whole.step(q, v, ref) - rest.step(q, v, ref) == pytest.approx(taut.snapshot(arm, q).g, abs=1e-9)


def test_float_and_native_agree_and_gains_change_between_ticks() -> None:
    arm = taut.load_arm("ur10")
    law = taut.laws.Robust(
        lam=10.0, k=10.0, phi=0.2, uncertainty=taut.laws.Uncertainty(links=0.1, coulomb=(0.0, 2.0))
    )
    native, plain = (taut.compile(law, arm, engine=engine) for engine in ("native", "float"))
    ref = taut.JointMotion(q=arm.home, v=np.full(6, 0.3), a=np.ones(6))
    for ctrl in (native, plain):
        ctrl.parameters["law.phi"] = 0.05
    got = [ctrl.step(arm.home + 0.01, np.full(6, 0.1), ref) for ctrl in (native, plain)]
    assert got[0] == pytest.approx(got[1], abs=1e-9)


def test_a_layer_ten_times_thinner_chatters() -> None:
    """On the lightest arm of the set, which reacts fastest to a torque."""
    arm, chatter, errors = taut.load_arm("planar2"), [], []
    for factor in (1.0, 0.3, 0.1):
        law = taut.laws.Robust(lam=10.0, k=10.0, phi=factor * np.array(PHI), uncertainty=planar_set())
        run = followed(law, arm, with_links(arm, 0.8))
        chatter.append(float(np.abs(np.diff(run.tau[run.t >= 2.0], axis=0)).sum()))
        errors.append(last(run))
    assert chatter[1] < 1.05 * chatter[0]
    assert chatter[2] > 5.0 * chatter[0]
    assert errors == sorted(errors, reverse=True)


BAD = {
    "a link whose mass may be zero": (lambda: taut.laws.Uncertainty(links=1.0), taut.errors.RangeError, "links"),
    "min above max": (lambda: taut.laws.Uncertainty(payload=(1.0, 0.5)), taut.errors.RangeError, "payload"),
    "negative friction": (lambda: taut.laws.Uncertainty(viscous=(-0.1, 0.5)), taut.errors.RangeError, "viscous"),
    "no interval": (lambda: taut.laws.Uncertainty(coulomb=0.5), taut.errors.ShapeError, "coulomb"),
}


@pytest.mark.parametrize("case", BAD)
def test_intervals_without_meaning_are_refused(case: str) -> None:
    make, kind, name = BAD[case]
    with pytest.raises(kind) as caught:
        make()
    assert caught.value.name == name


@pytest.mark.parametrize(
    ("unknown", "kind", "name"),
    [
        ({"links": [0.1, 0.1, 0.1]}, taut.errors.ShapeError, "uncertainty.links"),
        ({"coulomb": ([0.1] * 3, [0.2] * 3)}, taut.errors.ShapeError, "coulomb"),
        ({"payload": (-0.5, 0.5)}, taut.errors.RangeError, "payload"),
    ],
)
def test_intervals_that_do_not_fit_the_arm_are_refused(unknown: dict, kind: type, name: str) -> None:
    arm, ref = taut.load_arm("planar2"), taut.JointMotion(q=[0.0, 0.0])
    stated = taut.laws.Uncertainty(**unknown)
    with pytest.raises(kind) as caught:
        taut.compile(taut.laws.Robust(lam=10.0, k=10.0, phi=0.1, uncertainty=stated), arm)
    assert caught.value.name == name
    with pytest.raises(kind) as caught:
        taut.analysis.boundary_layer(arm, ref, stated, lam=10.0, k=10.0, duration=1.0)
    assert caught.value.name == name


def test_gains_of_other_joints_are_refused() -> None:
    arm, law = taut.load_arm("planar2"), taut.laws.Robust(lam=[10.0] * 3, k=10.0, phi=0.1, uncertainty=planar_set())
    with refused(taut.errors.ShapeError):
        taut.analysis.certify(law, arm, taut.JointMotion(q=arm.home), duration=1.0)


def test_a_lightest_body_that_cannot_be_is_refused() -> None:
    """The payload's mass is far from the tool: without a point mass at the tool, what is left is no rigid body."""
    arm = taut.load_arm("planar2").with_payload(1.0, [-0.3, 0.0, 0.0])
    law = taut.laws.Robust(lam=10.0, k=10.0, phi=0.1, uncertainty=taut.laws.Uncertainty(payload=(-1.0, 0.0)))
    with refused(taut.errors.MatchError):
        taut.compile(law, arm)
