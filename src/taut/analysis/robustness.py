"""Robust control: the boundary layer that a rate allows, the certified error, and the largest error that is found."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

import numpy as np

from taut.arm.description import Arm
from taut.base.checks import instance_of, positive_scalar, rate_in_hertz, whole_number
from taut.base.errors import RangeError
from taut.base.result import Content, Result, Table
from taut.base.types import Array, ArrayLike, Float64Array
from taut.codegen.program import over_rows
from taut.control.command import Command, Torque
from taut.control.gains import Gain
from taut.control.law import Law
from taut.control.laws.joint import ComputedTorque, FrictionCompensation
from taut.control.laws.other_topics.robust import Robust, Uncertainty, friction_and_error
from taut.control.trajectories.reference import JointMotion, Sample, Trajectory, known_rows
from taut.controller import compile
from taut.loop import Loop
from taut.maths import dynamics as dyn
from taut.maths.model import PayloadValues, model_of
from taut.maths.snapshot import Snapshot
from taut.plant.rigid import Integrator, RigidPlant
from taut.runtime.simulate import run as simulated
from taut.trace import math as tm

MAX_LAYER_RATE: Final = 0.5  # [-] of T times the loop's largest rate in its layer
MAX_SAMPLED_RATE: Final = 2.0  # [-] of the same: explicit steps are stable below
MIN_RHO: Final = 0.05  # of the largest: a joint that needs no robust torque on the reference gets a layer too
INSTANTS: Final = 401  # of the reference; the level set takes every sixth or so
LEVEL_INSTANTS: Final = 61
MAX_CORNERS: Final = 128  # of the box of position errors: all of them up to seven joints
MAX_CERTIFIED: Final = 1.0  # [rad | m] beyond which corners of that box no longer stand for the states inside it
LEVEL_GROWTH: Final = 1.002  # of the level set beyond what a step asks for, so that the iteration ends
ROUNDS: Final = 200  # of it
BETWEEN: Final = 8  # one simulation in so many is of an arm between the corners of the set
SUBSTEPS: Final[Mapping[Integrator, int]] = {"rk4": 2, "semi-implicit-euler": 4}  # dry friction needs the latter
LINKS, VISCOUS, COULOMB = "plant.payload.links", "plant.friction.viscous", "plant.friction.coulomb"
TORQUE: Final = "law.ConstantTorque.tau"
Case: TypeAlias = tuple[float, ...]
"""Where in its interval each unknown is, from -1 to 1."""


class ConstantTorque(Law):
    """A constant torque on the joints: the disturbance of a search."""

    ignores_reference = True
    tau: Gain = Gain(unit="N m | N", accepts=(), minimum=-np.inf)

    def command(self, x: Snapshot, ref: Sample) -> Command:  # noqa: ARG002
        return Torque(disturbance=self.tau.as_array())


@dataclass(frozen=True, kw_only=True, eq=False)
class Bounds:
    """Bounds over all arms of a set, exact, at k states."""

    M: Float64Array  # (k, n, n) of the law's model
    light: Float64Array  # (k, n, n) of the lightest arm
    rho: Float64Array  # (k, n) largest error of the law's torques

    @property
    def heavy(self) -> Float64Array:
        """(k, n, n) of the heaviest arm: M is in the middle."""
        return 2.0 * self.M - self.light

    @property
    def mobility(self) -> Float64Array:
        """(n,) largest (M^-1)_ii."""
        return np.asarray(np.einsum("kii->ki", np.linalg.inv(self.light)).max(axis=0))

    @property
    def c(self) -> Float64Array:
        """(k,) largest eigenvalues of M^^-1 M."""
        return _largest(self.heavy, self.M)


class UncertainArm:
    """The arms of a robust law's intervals.

    Torques are linear in the bodies, so that the box bound is a sum; the mass matrix lies between that of the
    lightest and of the heaviest arm, and M^-1 with it.
    """

    def __init__(self, arm: Arm, law: Robust) -> None:
        model, n, unknown = model_of(arm), arm.n, law.uncertainty
        law.check_size(arm.joint_names)
        unknown.check_arm(model)
        self.law, self.friction = law, unknown.friction(arm.friction)
        self.phi, self.lam = (np.broadcast_to(gain, (n,)) for gain in (law.phi, law.lam))
        loaded = dyn.loaded_bodies(model, PayloadValues.of(arm.payload))
        middle, lightest = unknown.middle(model, loaded), unknown.lightest(model, loaded)

        def at(q: Array, v_ref: Array, a_ref: Array) -> dict[str, Any]:
            def torques(s: Array) -> Array:
                return unknown.torques(model, q, v_ref - s, v_ref, a_ref + self.lam * s)

            M, light = (dyn.mass_matrix(dataclasses.replace(model, bodies=(*x,)), q) for x in (middle, lightest))
            rest = torques(np.zeros(n))
            slopes = tm.jacobian(lambda s: torques(s).reshape(-1), np.zeros(n)).reshape(*rest.shape, n)
            return {"M": M, "light": light, "torques": rest, "slopes": slopes}

        self._at = over_rows(at, q=n, v_ref=n, a_ref=n)

    def bounds(self, rows: JointMotion, e: ArrayLike = 0.0, V: float = 0.0, S: ArrayLike = 0.0) -> Bounds:
        """Bounds at position errors e (k, n) of a reference, for all s inside |s_i| <= S_i and s . M s / 2 <= V."""
        e = np.broadcast_to(e, rows.q.shape)
        v_ref, a_ref = rows.v + self.lam * e, rows.a - self.lam**2 * e  # where s = 0
        x = self._at(q=rows.q - e, v_ref=v_ref, a_ref=a_ref)
        # torques are affine in s, exactly: slopes b, and |b . s| <= sqrt(2 V b . M^-1 b)
        inverse = np.linalg.inv(x["light"])
        along = np.einsum("kmij,kjl,kmil->kmi", x["slopes"], inverse, x["slopes"], optimize=True)
        rho = (np.abs(x["torques"]) + np.sqrt(2.0 * V * np.maximum(along, 0.0))).sum(axis=1)
        # friction errs most at an end: towards v_des the error falls, and beyond v_des it grows with v - v_des
        ends = (friction_and_error(*self.friction, v_ref + s, rows.v, self.law.width) for s in (-np.asarray(S), S))
        rho += np.maximum(*(error for _, error in ends)) + self.law.uncertainty.disturbance
        return Bounds(M=x["M"], light=x["light"], rho=rho)

    def level_set(self, rows: JointMotion, V: float) -> Float64Array | None:
        """(n,) bounds S of |s| on the smallest level set of V that holds what it implies; None without one."""
        n, k = len(self.lam), len(rows.q)
        corners = itertools.product((-1.0, 1.0), repeat=n)
        drawn = np.random.default_rng(0).choice((-1.0, 1.0), (MAX_CORNERS, n))
        signs = np.array([np.zeros(n), *(corners if 2**n <= MAX_CORNERS else drawn)])
        each = JointMotion.of({name: np.tile(getattr(rows, name), (len(signs), 1)) for name in "qva"})
        signs, S = np.repeat(signs, k, axis=0), np.zeros(n)
        for _ in range(ROUNDS):
            x = self.bounds(each, signs * S / self.lam, V, S)
            asked = float((x.c * (x.rho @ self.phi)).max()) / (8.0 * float(self.law.k))
            if asked <= V and (2.0 * V * x.mobility <= S**2).all():
                return S
            V = max(V, LEVEL_GROWTH * asked)
            S = np.maximum(S, LEVEL_GROWTH * np.sqrt(2.0 * V * x.mobility))
            if (S / self.lam > MAX_CERTIFIED).any():
                return None
        return None


def _largest(A: Float64Array, B: Float64Array) -> Float64Array:
    """(k,) largest eigenvalues of B^-1 A, both symmetric, B positive definite."""
    values: Float64Array = np.linalg.eigvals(np.linalg.solve(B, A)).real.max(axis=1)
    return values


def _along(arm: Arm, reference: Trajectory | Sample, duration: float, instants: int) -> JointMotion:
    """The reference at so many instants."""
    instance_of("arm", arm, Arm, "an Arm from taut.load_arm")
    times = np.linspace(0.0, positive_scalar("duration", duration, unit="s"), instants)
    return known_rows("reference", reference, times, arm.n)


def boundary_layer(
    arm: Arm,
    reference: Trajectory | Sample,
    uncertainty: Uncertainty,
    *,
    lam: ArrayLike,
    k: float,
    duration: float,
    rate: float = 1000.0,
) -> Float64Array:
    """(n,) the boundary layer `phi` of `taut.laws.Robust` that a rate allows [rad/s | m/s].

    Law:          phi_i = rho_i,max (M^-1)_ii,max / kappa, with the largest kappa [1/s] for which
                  T max eig[(k M^ + diag(kappa / (M^-1)_ii,max)) M^-1] <= 0.5 over the set and the reference

    Without noise a third of it is still free of chatter, a tenth is not.

    Args:
        arm: The arm as the controller knows it.
        reference: A trajectory or a sample.
        uncertainty: The intervals.
        lam: Of the law, a number or (n,) [1/s].
        k: Of the law [1/s].
        duration: Of the reference [s].
        rate: Of the controller [Hz].

    Raises:
        RangeError: A k that alone is too fast for the rate; intervals without any width.
        UsageError, ShapeError, MatchError: A reference or intervals that are not for this arm.

    Example:
        >>> import taut
        >>> unknown = taut.laws.Uncertainty(links=0.2, payload=(0.0, 1.0))
        >>> arm = taut.load_arm("planar2")
        >>> ref = taut.JointMotion(q=arm.home)
        >>> taut.analysis.boundary_layer(arm, ref, unknown, lam=10.0, k=10.0, duration=1.0).round(3).tolist()
        [0.017, 0.05]
    """
    rows = _along(arm, reference, duration, INSTANTS)
    x = UncertainArm(arm, Robust(lam=lam, k=k, phi=1.0, uncertainty=uncertainty)).bounds(rows)
    rho, mobility, limit = x.rho.max(axis=0), x.mobility, MAX_LAYER_RATE * rate_in_hertz(rate)
    max_k = limit / float(_largest(x.M, x.light).max())
    if k >= max_k:
        raise RangeError(
            f"k must be below {max_k:.3g} [1/s] at {rate:g} Hz for the lightest arm; got {k:g}", name="k", value=k
        )
    # the eigenvalues stay below the limit as long as kappa diag(1 / mobility) <= limit M - k M^ of the lightest arm
    remaining = (limit * x.light - k * x.M) * np.sqrt(np.outer(mobility, mobility))
    phi: Float64Array = np.maximum(rho, MIN_RHO * rho.max()) * mobility / np.linalg.eigvalsh(remaining).min()
    return phi


@dataclass(frozen=True, kw_only=True, eq=False)
class Certificate(Result):
    """Two figures of robust control, kept apart: the error that is certified, and the largest that was found."""

    joints: tuple[str, ...]
    units: tuple[str, ...]  # of their positions
    certified: Float64Array | None  # (n,) [rad | m] error that no arm of the set exceeds; None without a level set
    found: Float64Array  # (n,) [rad | m] largest error in simulations of arms of the set
    computed_torque: Float64Array  # (n,) of computed torque with the same nominal loop and friction compensation
    alpha: float  # largest distance of an eigenvalue of M^-1 M^ from 1 over the set
    sampled: float  # T times the largest rate of the loop in its layer: explicit steps are stable below 2

    @property
    def ok(self) -> bool:
        """There is a certificate, nothing that was found exceeds it, and the rate is enough for the layer."""
        within = self.certified is not None and bool((self.found <= self.certified).all())
        return within and self.sampled < MAX_SAMPLED_RATE

    def content(self) -> Content:
        """Both figures for each joint, and computed torque's."""
        certified = [None] * len(self.joints) if self.certified is None else self.certified.tolist()
        columns = certified, self.found.tolist(), self.computed_torque.tolist()
        none = "no certificate: the level set on which rho holds grows without end; take a thinner phi or a larger k"
        thin = "the layer is too thin for the rate: the sampled loop is unstable in it and chatters; raise phi"
        notes = [
            "certified: in continuous time, while no torque saturates; positions in the level set are sampled at "
            "corners: an estimate there",
            f"sampled loop: T times its largest rate is {self.sampled:.3g}; it is stable below {MAX_SAMPLED_RATE:g}",
            f"inverse dynamics with an additional term has {'no' if self.alpha >= 1.0 else 'a'} bound: its alpha is "
            f"{self.alpha:.3g}, and must be below 1",
        ]
        return Content(
            title="robust control: error certified, and largest error found",
            faults=[none] * (self.certified is None) + [thin] * (self.sampled >= MAX_SAMPLED_RATE),
            tables=[
                Table(
                    columns=("joint", "certified", "found", "computed torque, found", "unit"),
                    rows=list(zip(self.joints, *columns, self.units, strict=True)),
                )
            ],
            notes=notes,
        )


def certify(
    law: Robust,
    arm: Arm,
    reference: Trajectory | Sample,
    *,
    duration: float,
    rate: float = 1000.0,
    trials: int = 32,
    seed: int = 0,
) -> Certificate:
    """The certified error of robust control, and the largest error found by sampling and search over the set.

    Law:          V_inf = max of (c / 8k) sum rho_i phi_i over the level set V <= V_inf,   c = max eig(M^^-1 M)
                  |s_i| <= S_i = sqrt(2 V_inf max (M^-1)_ii),   |e_i| <= S_i / lam_i
                  the level set grows until it contains what it implies; where it never does there is no certificate

    Over the set c, M^-1 and rho are exact; position errors up to S_i / lam_i are sampled at corners: an estimate.
    Simulations start on the reference: of arms at corners of the set, between them, and where a search leads that
    changes one unknown at a time; of computed torque, the same. A disturbance is constant in them.

    Args:
        law: The robust law.
        arm: The arm as the controller knows it.
        reference: A trajectory or a sample.
        duration: [s].
        rate: Of the controller [Hz].
        trials: Simulations before the search.
        seed: Of the sampled ones.

    Raises:
        UsageError, RangeError, ShapeError, MatchError: A law or reference that is not for this arm.

    References:
        Corless and Leitmann, IEEE TAC 26 (5) (1981). Spong, IEEE TAC 37 (11) (1992). Slotine and Li (1991).
    """
    instance_of("law", law, Robust, "a taut.laws.Robust")
    rows, trials = _along(arm, reference, duration, INSTANTS), whole_number("trials", trials, minimum=2)
    arms, k = UncertainArm(arm, law), float(law.k)
    x = arms.bounds(rows)
    start = float(x.c.max() * (x.rho.max(axis=0) @ arms.phi)) / (8.0 * k)
    level = arms.level_set(_along(arm, reference, duration, LEVEL_INSTANTS), start)
    layer = k * x.M + np.einsum("ki,ij->kij", x.rho / arms.phi, np.eye(arm.n))
    found, usual = _largest_errors(law, arm, reference, duration, rate, trials, seed)
    return Certificate(
        joints=arm.joint_names,
        units=arm.units,
        certified=None if level is None else level / arms.lam,
        found=found,
        computed_torque=usual,
        alpha=float(max(_largest(x.M, x.light).max() - 1.0, 1.0 - 1.0 / x.c.max())),
        sampled=float(_largest(layer, x.light).max()) / rate_in_hertz(rate),
    )


def _largest_errors(
    law: Robust, arm: Arm, reference: Trajectory | Sample, duration: float, rate: float, trials: int, seed: int
) -> list[Float64Array]:
    """(n,) each: found under the robust law, and under computed torque of the same nominal loop."""
    unknown, lam, k = law.uncertainty, law.lam.as_array(), law.k.as_array()
    nominal, (b, c) = unknown.nominal(arm), unknown.friction(arm.friction)
    ends = [(LINKS, rows) for rows in unknown.unknown(model_of(arm))]  # by how much a parameter moves at an end
    ends += [(VISCOUS, 0.5 * np.ptp(b, axis=0)), (COULOMB, 0.5 * np.ptp(c, axis=0))]
    ends += [(TORQUE, torque) for torque in unknown.disturbance * np.eye(arm.n)]
    ends = [(path, half) for path, half in ends if half.any()]
    laws: list[Law] = [law, ComputedTorque(kp=k * lam, kd=k + lam)]
    if np.any(b) or np.any(c):
        laws[1] = laws[1] + FrictionCompensation(at="ref", width=law.width)
    if np.any(unknown.disturbance):
        laws = [each + ConstantTorque(tau=np.zeros(arm.n)) for each in laws]
    integrator: Integrator = "semi-implicit-euler" if np.any(c) else "rk4"
    plant = RigidPlant(nominal, integrator=integrator, substeps=SUBSTEPS[integrator], link_payloads=True)
    start, cases = known_rows("reference", reference, np.zeros(1), arm.n), _cases(len(ends), trials, seed)
    loops = (
        Loop(compile(each, known, rate=rate), plant, reference, duration=duration)
        for each, known in zip(laws, (arm, nominal), strict=True)
    )
    return [_largest_error(loop, ends, start, cases) for loop in loops]


def _largest_error(
    loop: Loop, ends: Sequence[tuple[str, Float64Array]], start: JointMotion, cases: Sequence[Case]
) -> Float64Array:
    """(n,) of runs of the cases, and of a search from the worst: each unknown in turn at its other end [rad | m]."""
    middle = {path: loop.parameters[path] for path, _ in ends}

    def error(case: Case) -> Float64Array:
        """(n,) from a start on the reference; infinite where it diverged."""
        values = dict(middle)
        for (path, half), at in zip(ends, case, strict=True):
            values[path] = values[path] + at * half
        loop.parameters.update(values)
        run = simulated(loop, q0=start.q[0], v0=start.v[0], progress=False)
        assert run.error is not None
        return np.asarray(np.abs(run.error).max(axis=0)) if run.outcome.ok else np.full(run.n, np.inf)

    found = {case: error(case) for case in cases}
    worst = max(cases, key=lambda case: float(found[case].max()))
    for i, at in enumerate(worst):
        other = (*worst[:i], -1.0 if at > 0.0 else 1.0, *worst[i + 1 :])
        found[other] = error(other)
        worst = max(worst, other, key=lambda case: float(found[case].max()))
    return np.asarray(np.max(list(found.values()), axis=0))


def _cases(size: int, trials: int, seed: int) -> list[Case]:
    """All corners of a small set; else its two ends, other corners, and arms between them."""
    rng = np.random.default_rng(seed)
    if 2**size <= trials:
        return list(itertools.product((1.0, -1.0), repeat=size))
    drawn = rng.choice((-1.0, 1.0), (trials, size))
    drawn[:2] = [[1.0], [-1.0]]
    drawn[BETWEEN - 1 :: BETWEEN] = rng.uniform(-1.0, 1.0, (trials // BETWEEN, size))
    return [tuple(case) for case in drawn.tolist()]
