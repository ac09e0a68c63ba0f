"""Robust control: the boundary layer that a rate allows, the certified error, and the largest error that is found."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, TypeAlias

import numpy as np
from scipy.optimize import brentq

from taut.arm.description import Arm, Friction, Payload
from taut.arm.parts import inertia_entries
from taut.base.checks import instance_of, positive_scalar, rate_in_hertz, whole_number
from taut.base.errors import RangeError
from taut.base.result import Content, Result, Table
from taut.base.types import Array, ArrayLike, Float64Array
from taut.codegen.loop import over_rows
from taut.control.command import Command, Torque
from taut.control.gains import Gain
from taut.control.law import Law
from taut.control.laws.joint import ComputedTorque, FrictionCompensation
from taut.control.laws.other_topics.robust import Robust, Uncertainty, friction_and_error, without_rotors
from taut.control.trajectories.reference import JointMotion, Sample, Trajectory, sample_rows
from taut.controller import Controller, compile
from taut.loop import Loop
from taut.maths import dynamics as dyn
from taut.maths.model import PayloadValues, model_of
from taut.maths.snapshot import Snapshot
from taut.plant.rigid import Integrator, RigidPlant
from taut.runtime.simulate import run as simulated
from taut.trace import math as tm

MAX_LAYER_RATE: Final = 0.5  # [-] of T times the loop's largest rate in its layer; explicit steps are stable below 2
MIN_RHO: Final = 0.05  # of the largest: a joint that needs no robust torque on the reference gets a layer too
INSTANTS: Final = 401  # of the reference, for the layer; the certificate takes every sixth or so
LEVEL_INSTANTS: Final = 61
MAX_CORNERS: Final = 128  # of the box of position errors: all of them up to seven joints
MAX_CERTIFIED: Final = 1.0  # [rad | m] beyond which corners of that box no longer stand for the states inside it
LEVEL_GROWTH: Final = 1.002  # of the level set beyond what a step asks for, so that the iteration ends
ROUNDS: Final = 200  # of it
TRIALS_PER_ARM: Final = 8  # links are constants of a plant, and every other one costs a compilation
SUBSTEPS: Final[Mapping[Integrator, int]] = {"rk4": 2, "semi-implicit-euler": 4}  # dry friction needs the latter
Case: TypeAlias = tuple[float, ...]
"""Where in its interval each unknown is, from -1 to 1: of links, payload, viscous, Coulomb friction, disturbance."""


class ConstantTorque(Law):
    """A constant torque on the joints: the disturbance of a search."""

    ignores_reference = True
    tau: Gain = Gain(unit="N m | N", accepts=(), minimum=-math.inf)

    def command(self, x: Snapshot, ref: Sample) -> Command:  # noqa: ARG002
        return Torque(disturbance=self.tau.as_array())


class UncertainArm:
    """Bounds of an arm in intervals along a reference, exact over the intervals.

    Torques are linear in the bodies, so that the box bound is a sum. The mass matrix grows with each body, so that it
    lies between that of the lightest and of the heaviest arm, and M^-1 with it.
    """

    def __init__(self, arm: Arm, unknown: Uncertainty, width: float) -> None:
        self.model, self.unknown, self.width = model_of(arm), unknown, width
        unknown.check_arm(self.model)
        self.b, self.c = unknown.friction(arm.friction)
        loaded = dyn.loaded_bodies(self.model, PayloadValues.of(arm.payload))
        nominal = dataclasses.replace(self.model, bodies=tuple(unknown.middle(self.model, loaded)))
        bare, n = without_rotors(self.model), arm.n
        parts = [dataclasses.replace(bare, bodies=tuple(part)) for part in unknown.unknown(self.model)]

        def masses(q: Array) -> dict[str, Any]:
            half = sum((dyn.mass_matrix(part, q) for part in parts), np.zeros((n, n)))
            return {"M": dyn.mass_matrix(nominal, q), "half": half}

        def torques(q: Array, v: Array, v_ref: Array, a_ref: Array) -> dict[str, Any]:
            return {"parts": unknown.torques(self.model, q, v, v_ref, a_ref)}

        self._masses = over_rows(masses, q=n)
        self._torques = over_rows(torques, q=n, v=n, v_ref=n, a_ref=n)

    def masses(self, q: Float64Array) -> tuple[Float64Array, Float64Array, Float64Array]:
        """(k, n, n) each: M of the law's model, the inverse of the lightest arm's M, and the heaviest arm's M."""
        found = self._masses(q=q)
        M, half = found["M"], found["half"]
        return M, _inverse(M - half), M + half

    def torques(self, **state: Float64Array) -> Float64Array:
        """(k, m, n) torques of each unknown at its largest, at q, v, v_ref and a_ref (k, n)."""
        return self._torques(**state)["parts"]

    def friction_error(self, v: Float64Array, v_des: Float64Array) -> Float64Array:
        """(k, n) largest error of the friction that the law assumes, and the disturbance."""
        return np.asarray(friction_and_error(self.b, self.c, v, v_des, self.width)[1] + self.unknown.disturbance)

    def rho(self, rows: JointMotion) -> Float64Array:
        """(k, n) the bound on a reference."""
        parts = self.torques(q=rows.q, v=rows.v, v_ref=rows.v, a_ref=rows.a)
        return np.asarray(np.abs(parts).sum(axis=1) + self.friction_error(rows.v, rows.v))


def _inverse(A: Float64Array) -> Float64Array:
    return np.asarray(np.linalg.inv(A), dtype=np.float64)


def _largest(A: Float64Array, B: Float64Array) -> Float64Array:
    """(k,) largest eigenvalues of A B, both symmetric and positive definite."""
    values: Float64Array = np.linalg.eigvals(A @ B).real.max(axis=1)
    return values


def _along(reference: Trajectory | Sample, duration: float, instants: int, n: int) -> JointMotion:
    """The reference at so many instants."""
    return JointMotion.of(sample_rows(reference, np.linspace(0.0, duration, instants), JointMotion, n))


def _checked(arm: Arm, reference: object, duration: object) -> float:
    instance_of("arm", arm, Arm, "an Arm from taut.load_arm")
    known = "a reference that is known beforehand, a trajectory with at(t) or a taut.JointMotion"
    instance_of("reference", reference, (Trajectory, Sample), known)
    return positive_scalar("duration", duration, unit="s")


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
                  M^-1 is largest for the lightest arm of the set, which so stands for all

    Ten times thinner layers chatter. A third of it is still free of chatter without noise, and multiplies the effect
    of noise in the velocity by three.

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
    length = _checked(arm, reference, duration)
    law = Robust(lam=lam, k=k, phi=1.0, uncertainty=uncertainty)
    uncertain = UncertainArm(arm, uncertainty, float(law.width))
    rows = _along(reference, length, INSTANTS, arm.n)
    M, inverse, _ = uncertain.masses(rows.q)
    mobility, T = np.einsum("kii->ki", inverse).max(axis=0), 1.0 / rate_in_hertz(rate)
    rho = uncertain.rho(rows).max(axis=0)
    if not rho.any():
        raise RangeError("uncertainty must have an interval of some width; nothing in it is unknown", name="links")

    def sampled(kappa: float) -> float:
        return T * float(_largest(k * M + np.diag(kappa / mobility), inverse).max())

    if sampled(0.0) >= MAX_LAYER_RATE:
        most = MAX_LAYER_RATE * k / sampled(0.0)
        raise RangeError(
            f"k must be below {most:.3g} [1/s] at {rate:g} Hz for the lightest arm; got {k:g}", name="k", value=k
        )
    # at the upper end it is larger, since diag(1 / (M^-1)_ii) M^-1 has an eigenvalue of 1 or more
    kappa = brentq(lambda kappa: sampled(kappa) - MAX_LAYER_RATE, 0.0, MAX_LAYER_RATE / T, xtol=1e-3)
    phi: Float64Array = np.maximum(rho, MIN_RHO * rho.max()) * mobility / kappa
    return phi


@dataclass(frozen=True, kw_only=True, eq=False)
class Certificate(Result):
    """Two figures of robust control, kept apart: the error that is certified, and the largest that was found.

    Args:
        joints: Their names.
        units: Of their positions.
        certified: (n,) error that no arm of the set exceeds from a start on the reference, in continuous time while
            no torque saturates [rad | m]; None where the iteration on the level set does not close.
        on_reference: (n,) the same with rho on the reference alone, which proves nothing: the first iterate.
        found: (n,) largest error in simulations of arms of the set [rad | m].
        computed_torque: (n,) the largest of computed torque with the same nominal loop and friction compensation.
        worst: The unknowns of the arm with the largest error, each as a position in its interval from -1 to 1.
        runs: Number of simulations of the robust law.
        alpha: Largest distance of an eigenvalue of M^-1 M^ from 1 over the set: inverse dynamics with an additional
            term (Corless and Leitmann's form) has no bound where this is 1 or more.
        sampled: T times the largest rate of the loop in its layer: explicit steps are stable below 2.
    """

    joints: tuple[str, ...]
    units: tuple[str, ...]
    certified: Float64Array | None
    on_reference: Float64Array
    found: Float64Array
    computed_torque: Float64Array
    worst: Mapping[str, list[float]]
    runs: int
    alpha: float
    sampled: float

    @property
    def ok(self) -> bool:
        """There is a certificate, and nothing that was found exceeds it."""
        return self.certified is not None and bool((self.found <= self.certified).all())

    def content(self) -> Content:
        """Both figures for each joint, and computed torque's."""
        n = len(self.joints)
        certified = np.full(n, np.nan) if self.certified is None else self.certified
        columns = (certified, self.found, self.computed_torque)
        rows = list(zip(self.joints, *(column.tolist() for column in columns), self.units, strict=True))
        heads = ("joint", "certified", "found", "computed torque, found", "unit")
        none = (
            "no certificate: the level set on which rho holds grows without end; choose a thinner phi or a larger k"
        )
        notes = [
            f"found: in {self.runs} simulations of arms of the set, corners among them, and a search from the worst",
            "certified: in continuous time, from a start on the reference, while no torque saturates; exact over the "
            "set and over velocities in the level set; positions in it are sampled at corners: an estimate there",
            f"sampled loop: T times its largest rate is {self.sampled:.3g}; it should stay below {MAX_LAYER_RATE:g}",
            f"inverse dynamics with an additional term has {'no' if self.alpha >= 1.0 else 'a'} bound: its alpha is "
            f"{self.alpha:.3g}, and must be below 1",
        ]
        return Content(
            title="robust control: error certified, and largest error found",
            faults=[none] if self.certified is None else [],
            tables=[Table(columns=heads, rows=rows)],
            notes=notes,
            settings={"worst arm": "; ".join(f"{name} {values}" for name, values in self.worst.items())},
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

    Over the set of arms c, M^-1 and rho are exact, and over velocities rho is bounded: its parts are affine in s.
    Over position errors up to S_i / lam_i the corners are taken, at instants of the reference: an estimate.
    Simulations start on the reference; unknowns stand at corners of the set, between them, and where a search
    leads that changes one at a time. A disturbance is constant in them.

    Args:
        law: The robust law.
        arm: The arm as the controller knows it.
        reference: A trajectory or a sample.
        duration: [s].
        rate: Of the controller [Hz].
        trials: Simulations before the search: one arm is compiled for each eight.
        seed: Of the sampled ones.

    Raises:
        UsageError, RangeError, ShapeError, MatchError: A law, reference or intervals that are not for this arm.

    Example:
        >>> import taut
        >>> arm, unknown = taut.load_arm("planar2"), taut.laws.Uncertainty(links=0.05)
        >>> ref = taut.trajectories.Quintic(q0=arm.home, q1=arm.home + 0.5, duration=1.0)
        >>> phi = taut.analysis.boundary_layer(arm, ref, unknown, lam=10.0, k=10.0, duration=1.0)
        >>> law = taut.laws.Robust(lam=10.0, k=10.0, phi=phi, uncertainty=unknown)
        >>> taut.analysis.certify(law, arm, ref, duration=1.0, trials=4).ok
        True

    References:
        Corless and Leitmann, IEEE TAC 26 (5) (1981). Spong, IEEE TAC 37 (11) (1992). Slotine and Li (1991).
    """
    instance_of("law", law, Robust, "a taut.laws.Robust")
    length, n = _checked(arm, reference, duration), arm.n
    T, trials = 1.0 / rate_in_hertz(rate), whole_number("trials", trials, minimum=2)
    uncertain = UncertainArm(arm, law.uncertainty, float(law.width))
    rows = _along(reference, length, INSTANTS, n)
    M, inverse, heavy = uncertain.masses(rows.q)
    rho, mobility = uncertain.rho(rows), np.einsum("kii->ki", inverse).max(axis=0)
    c = _largest(_inverse(M), heavy)
    k, phi, lam = float(law.k), np.broadcast_to(law.phi, (n,)), np.broadcast_to(law.lam, (n,))
    start = float(c.max() / (8.0 * k) * (rho.max(axis=0) @ phi))
    level = _level_set(uncertain, law, _along(reference, length, LEVEL_INSTANTS, n), start)
    search = Search(arm=arm, law=law, reference=reference, duration=length, rate=rate)
    cases = list(search.cases(trials, np.random.default_rng(seed)))
    usual = np.array([search.error(case, robust=False) for case in cases])
    worst = search.improved(max(cases, key=lambda case: float(search.error(case).max())))
    layer = k * M + np.einsum("ki,ij->kij", rho / phi, np.eye(n))
    return Certificate(
        joints=arm.joint_names,
        units=arm.units,
        certified=None if level is None else level / lam,
        on_reference=np.sqrt(2.0 * start * mobility) / lam,
        found=np.max([error for (_, robust), error in search.errors.items() if robust], axis=0),
        computed_torque=usual.max(axis=0),
        worst={name: list(worst[part]) for name, part in search.places.items() if worst[part]},
        runs=sum(robust for _, robust in search.errors),
        alpha=float(max(_largest(inverse, M).max() - 1.0, 1.0 - 1.0 / c.max())),
        sampled=T * float(_largest(layer, inverse).max()),
    )


def _level_set(uncertain: UncertainArm, law: Robust, rows: JointMotion, start: float) -> Float64Array | None:
    """(n,) bounds S of |s| on the smallest level set of V that holds what it implies; None where there is none."""
    n = rows.q.shape[1]
    k, phi, lam = float(law.k), np.broadcast_to(law.phi, (n,)), np.broadcast_to(law.lam, (n,))
    corners = itertools.product((-1.0, 1.0), repeat=n)
    drawn = np.random.default_rng(0).choice((-1.0, 1.0), (MAX_CORNERS, n))
    signs = np.array(list(corners)) if 2**n <= MAX_CORNERS else drawn
    V, S = start, np.zeros(n)
    for _ in range(ROUNDS):
        asked, mobility = 0.0, np.zeros(n)
        for sign in (np.zeros(n), *signs):
            e = np.broadcast_to(sign * S / lam, rows.q.shape)
            v_ref, a_ref = rows.v + lam * e, rows.a - lam**2 * e  # with s = 0
            q = rows.q - e
            M, inverse, heavy = uncertain.masses(q)
            parts = uncertain.torques(q=q, v=v_ref, v_ref=v_ref, a_ref=a_ref)
            slopes = np.stack(
                [uncertain.torques(q=q, v=v_ref - s, v_ref=v_ref, a_ref=a_ref + lam * s) - parts for s in np.eye(n)],
                axis=-1,
            )  # (k, m, n, n) by s, exact: at one position the torques are affine in s
            # |b . s| <= sqrt(2 V b . M^-1 b) where s . M s / 2 <= V
            along = np.einsum("kmij,kjl,kmil->kmi", slopes, inverse, slopes, optimize=True)
            rho = (np.abs(parts) + np.sqrt(2.0 * V * np.maximum(along, 0.0))).sum(axis=1)
            # friction errs most at an end: towards v_des the error falls, and beyond v_des it grows with v - v_des
            rho += np.maximum(*(uncertain.friction_error(v_ref + end, rows.v) for end in (-S, S)))
            asked = max(asked, float((_largest(_inverse(M), heavy) * (rho @ phi)).max()) / (8.0 * k))
            mobility = np.maximum(mobility, np.einsum("kii->ki", inverse).max(axis=0))
        implied = np.sqrt(2.0 * max(V, asked) * mobility)
        if asked <= V and (implied <= S).all():
            return S
        V = max(V, LEVEL_GROWTH * asked)
        S = np.maximum(S, np.sqrt(2.0 * V * mobility) * LEVEL_GROWTH)
        if (S / lam > MAX_CERTIFIED).any():
            return None
    return None


@dataclass(frozen=True, kw_only=True, eq=False)
class Search:
    """Simulations of arms of a set under the robust law, and under computed torque of the same nominal loop."""

    arm: Arm
    law: Robust
    reference: Trajectory | Sample
    duration: float
    rate: float
    errors: dict[tuple[Case, bool], Float64Array] = dataclasses.field(default_factory=dict)
    _loops: dict[tuple[Case, bool], Loop] = dataclasses.field(default_factory=dict)

    @property
    def places(self) -> dict[str, slice]:
        """The entries of a case that are about each kind of unknown: none where its interval has no width."""
        unknown, n = self.law.uncertainty, self.arm.n
        b, c = unknown.friction(self.arm.friction)
        sizes = {
            "links": n * bool(np.any(unknown.links)),
            "payload": int(np.ptp(unknown.payload) > 0.0),
            "viscous": int(np.ptp(b, axis=0).any()),
            "coulomb": int(np.ptp(c, axis=0).any()),
            "disturbance": n * bool(np.any(unknown.disturbance)),
        }
        ends = np.cumsum(list(sizes.values())).tolist()
        return {name: slice(end - size, end) for (name, size), end in zip(sizes.items(), ends, strict=True)}

    def cases(self, trials: int, rng: np.random.Generator) -> Iterator[Case]:
        """All corners of a small set; else the heaviest and the lightest links, other corners, and cases between."""
        size, links = self.places["disturbance"].stop, self.places["links"].stop
        if 2**size <= trials:
            yield from itertools.product((1.0, -1.0), repeat=size)
            return
        for i in range(max(2, math.ceil(trials / TRIALS_PER_ARM)) if links else 1):
            bodies = rng.choice((-1.0, 1.0), links) if i > 1 else np.full(links, 1.0 - 2.0 * i)
            for j in range(min(trials, TRIALS_PER_ARM)):
                other = rng.choice((-1.0, 1.0), size - links) if j > 1 else np.full(size - links, 1.0 - 2.0 * j)
                if j == TRIALS_PER_ARM - 1:
                    other = rng.uniform(-1.0, 1.0, size - links)
                yield (*bodies.tolist(), *other.tolist())

    def improved(self, case: Case) -> Case:
        """A case after each unknown was moved to the other end of its interval, where that was worse."""
        for i in range(len(case)):
            other = (*case[:i], -1.0 if case[i] > 0.0 else 1.0, *case[i + 1 :])
            if self.error(other).max() > self.error(case).max():
                case = other
        return case

    def error(self, case: Case, *, robust: bool = True) -> Float64Array:
        """(n,) largest error of a run [rad | m]; infinite where it diverged."""
        key = (case, robust)
        if key not in self.errors:
            self.errors[key] = self._simulated(case, robust)
        return self.errors[key]

    def _simulated(self, case: Case, robust: bool) -> Float64Array:
        at = {name: np.array(case[part]) for name, part in self.places.items()}
        loop = self._loop(case[self.places["links"]], robust)

        def value(name: str, low: Any, high: Any) -> Float64Array:
            return np.asarray(0.5 * (low + high) + 0.5 * (high - low) * (at[name] if at[name].size else 0.0))

        unknown, n = self.law.uncertainty, self.arm.n
        load = _carrying(self.arm.payload, value("payload", *unknown.payload).sum())
        changes: dict[str, ArrayLike] = {f"plant.payload.{name}": number for name, number in vars(load).items()}
        for name, interval in zip(("viscous", "coulomb"), unknown.friction(self.arm.friction), strict=True):
            changes[f"plant.friction.{name}"] = value(name, *interval)
        if at["disturbance"].size:
            changes[f"law.{ConstantTorque.__name__}.tau"] = unknown.disturbance * at["disturbance"]
        for path in changes.keys() & loop.parameters.keys():
            loop.parameters[path] = changes[path]
        first = sample_rows(self.reference, np.zeros(1), JointMotion, n)
        run = simulated(loop, q0=first["q"].reshape(n), v0=first["v"].reshape(n), progress=False)
        assert run.error is not None
        return np.asarray(np.abs(run.error).max(axis=0)) if run.outcome.ok else np.full(n, np.inf)

    def _loop(self, links: Case, robust: bool) -> Loop:
        """The loop with an arm of these links, whose payload, friction and disturbance are still to be set."""
        made = self._loops.get((links, robust))
        if made is None:
            b, c = (high for _, high in self.law.uncertainty.friction(self.arm.friction))
            factors = 1.0 + self.law.uncertainty.links * np.array(links or (0.0,) * self.arm.n)
            true = self.arm.with_friction(Friction(viscous=b, coulomb=c))
            bodies = zip(true.bodies, factors.tolist(), strict=True)
            true = dataclasses.replace(
                true,
                bodies=tuple(dataclasses.replace(x, mass=f * x.mass, inertia=f * x.inertia) for x, f in bodies),
            )
            integrator: Integrator = "semi-implicit-euler" if np.any(c) else "rk4"
            plant = RigidPlant(true, integrator=integrator, substeps=SUBSTEPS[integrator])
            made = Loop(self._controllers[robust], plant, self.reference, duration=self.duration)
            self._loops[links, robust] = made
        return made

    @cached_property
    def _controllers(self) -> dict[bool, Controller]:
        """The robust law, and computed torque with its nominal loop, on the middle of the set."""
        unknown, arm, k, lam = self.law.uncertainty, self.arm, float(self.law.k), np.asarray(self.law.lam)
        b, c = (0.5 * (low + high) for low, high in unknown.friction(arm.friction))
        usual: Law = ComputedTorque(kp=k * lam, kd=k + lam)
        if np.any(b) or np.any(c):
            usual = usual + FrictionCompensation(at="ref", width=self.law.width)
        middle = arm.with_friction(Friction(viscous=b, coulomb=c))
        middle = dataclasses.replace(middle, payload=_carrying(arm.payload, float(np.mean(unknown.payload))))
        laws = {True: (self.law, arm), False: (usual, middle)}
        push = [ConstantTorque(tau=np.zeros(arm.n))] if np.any(unknown.disturbance) else []
        return {robust: compile(sum(push, start=law), known, rate=self.rate) for robust, (law, known) in laws.items()}


def _carrying(payload: Payload, mass: float) -> Payload:
    """A payload with a point mass at the tool besides."""
    if mass == 0.0:
        return payload
    total = payload.mass + mass
    if total == 0.0:
        return Payload()
    com = payload.mass / total * payload.com
    # about the new centre of mass: both point masses lie on a line through the tool
    apart = payload.mass * mass / total
    S = np.asarray(tm.skew(payload.com))
    return Payload(mass=total, com=com, inertia=payload.inertia + np.asarray(inertia_entries(-apart * S @ S)))
