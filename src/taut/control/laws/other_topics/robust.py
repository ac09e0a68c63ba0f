"""Robust control of joint motion: section 10.6, with the uncertainty of the model stated once as intervals."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from taut.arm.description import BASE, Arm, Friction
from taut.base.errors import MatchError, RangeError, ShapeError
from taut.base.fields import Declared, Field, Part
from taut.base.types import Array, ArrayLike, Float64Array, Vector
from taut.control.command import Command, Terms, Torque
from taut.control.gains import Gain
from taut.control.law import Law
from taut.control.trajectories.reference import JointMotion
from taut.maths import dynamics as dyn
from taut.maths.model import Model, PayloadValues, RigidBody, links_of
from taut.maths.regressor import body_of, parameters_of, pseudo_inertia
from taut.maths.snapshot import Snapshot
from taut.trace import math as tm

SMALLEST_EIGENVALUE = -1e-9  # of a pseudo-inertia, relative to the largest: a thin rod has eigenvalues of zero


def _rows(interval: Any) -> Float64Array:
    """(2, k) smallest and largest value, of two numbers or of two with one for each joint."""
    try:
        return np.atleast_2d(np.stack(np.broadcast_arrays(*interval)).astype(np.float64).T).T
    except (TypeError, ValueError) as cause:
        raise ShapeError(f"must be (smallest, largest), each a number or one per joint; got {interval!r}") from cause


def _interval(unit: str) -> Field:
    """The smallest and the largest value of a number, or of one for each joint: kept as (2, k), k = 1 or n."""
    return Field(unit=unit, shape=(2, "k"), minimum=0.0, run_time=False, optional=True, convert=_rows)


class Uncertainty(Declared):
    """Everything that is not known of an arm, as intervals: stated once, for the law, its layer and its certificate.

    Friction is b v + c sgn(v), whatever the load, and its intervals take the place of the model's own friction. Every
    combination belongs to the set; rotors, lengths and gravity are known.

    Args:
        links: (n,) or a number, relative, below 1: of mass and inertia of each link together [1].
        payload: (min, max) point mass at the tool's origin beyond the arm's own payload, or short of it [kg].
        viscous: (min, max), each a number or (n,) [N m s/rad | N s/m]; the model's own, as known, if left out.
        coulomb: (min, max), each a number or (n,), static friction included [N m | N]; likewise.
        disturbance: (n,) or a number, the largest further torque [N m | N].

    Raises:
        RangeError: A link known to +-100 % or worse, whose mass may be zero; negative friction; min above max.
    """

    links: Field = Field(0.0, unit="1", shape="n", minimum=0.0, run_time=False)
    payload: Field = Field((0.0, 0.0), unit="kg", shape=2, run_time=False)
    viscous: Field = _interval("N m s/rad | N s/m")
    coulomb: Field = _interval("N m | N")
    disturbance: Field = Field(0.0, unit="N m | N", shape="n", minimum=0.0, run_time=False)

    def check(self) -> None:
        if np.max(self.links) >= 1.0:
            worst = float(np.max(self.links))
            self.refuse("links", f"must be < 1 [1], or a mass may be zero or negative; got {worst:g}", RangeError)
        for name in ("payload", "viscous", "coulomb"):
            low, high = (0.0, 0.0) if getattr(self, name) is None else getattr(self, name)
            if np.any(low > high):
                got = f"({np.squeeze(low).tolist()}, {np.squeeze(high).tolist()})"
                self.refuse(name, f"must be (smallest, largest); got {got}", RangeError)

    def check_arm(self, model: Model) -> None:
        """Refuse intervals without width, and an arm they are not for: other joints, links that are no bodies."""
        self.check_size(model.arm.joint_names, "uncertainty.")
        own = model.arm.payload
        if own.mass + self.payload[0] < 0.0:
            raise RangeError(
                f"uncertainty.payload must begin at {0.0 - own.mass:g} [kg] or above, for the arm carries "
                f"{own.mass:g} kg; got {self.payload[0]:g}",
                name="payload",
            )
        if np.any(self.payload) and model.placement(None)[0] == BASE:
            raise MatchError("uncertainty.payload: the tool is fixed to the base, so the arm carries nothing")
        known = dyn.loaded_bodies(dataclasses.replace(model, bodies=model.links), PayloadValues.of(own))
        for joint, body, light in zip(model.arm.joint_names, known, self.lightest(model, known), strict=True):
            P = np.asarray(pseudo_inertia(parameters_of(light)), dtype=np.float64)
            smallest, largest = np.linalg.eigvalsh(P)[[0, -1]]
            if light.m != body.m and (light.m <= 0.0 or smallest < SMALLEST_EIGENVALUE * largest):
                raise MatchError(
                    f"uncertainty: the lightest body of joint '{joint}' in its intervals cannot be: its mass is "
                    f"{light.m:g} kg and the smallest eigenvalue of its pseudo-inertia {smallest:g}, which must not "
                    "be negative; mend the model, or narrow the intervals",
                    name="links",
                )
        b, c = self.friction(model.arm.friction)  # known dry friction is an error too: a joint sticks at any of it
        if not (self.unknown(model) or np.any(self.disturbance) or np.any(np.ptp(b, axis=0)) or np.any(c)):
            self.refuse("uncertainty", "must have an interval of some width; nothing in it is unknown", RangeError)

    def nominal(self, arm: Arm) -> Arm:
        """The arm with payload and friction in the middle of their intervals."""
        (b, _), (c, _) = map(middle_and_half, self.friction(arm.friction))
        made = arm.with_friction(Friction(viscous=b, coulomb=c))
        if not np.any(self.payload):
            return made
        load = PayloadValues.of_body(PayloadValues.of(arm.payload).body() + _point_mass(np.mean(self.payload)))
        return made.with_payload(load.mass, load.com, load.inertia)

    def middle(self, model: Model, bodies: list[RigidBody]) -> list[RigidBody]:
        """The bodies with the payload in the middle of its interval."""
        return [own + body_of(row) for own, row in zip(bodies, _carried(model, np.mean(self.payload)), strict=True)]

    def lightest(self, model: Model, bodies: list[RigidBody]) -> list[RigidBody]:
        """The bodies without what may be too much of them."""
        unknown = sum(self.unknown(model), start=np.zeros((model.n, 10)))
        return [own - body_of(row) for own, row in zip(self.middle(model, bodies), unknown, strict=True)]

    def unknown(self, model: Model) -> list[Float64Array]:
        """What may be missing or too much: parameters (n, 10) of bodies, which act by any factor from -1 to 1."""
        links = np.diag(np.broadcast_to(self.links, (model.n,)))
        known = np.array([parameters_of(link) for link in model.links])
        carried = _carried(model, 0.5 * np.ptp(self.payload))
        return [rows for rows in (*(row[:, np.newaxis] * known for row in links), carried) if rows.any()]

    def torques(self, model: Model, q: Vector, v: Vector, v_ref: Vector, a_ref: Vector) -> Array:
        """(m, n) torques Y_l pi_l of each unknown at its largest: s . (M a_ref + C v_ref + g) errs by their sum."""
        bare, unknown = links_of(model.arm), ([body_of(row) for row in rows] for rows in self.unknown(model))
        each = [dyn.reference_dynamics(bare, part, q, v, v_ref, a_ref) for part in unknown]
        return np.reshape(tm.array(each), (-1, model.n))

    def friction(self, known: Friction) -> tuple[Float64Array, Float64Array]:
        """(2, n) each: viscous and Coulomb friction, smallest and largest; that of the model where none is given."""
        out = {"viscous": np.stack([known.viscous] * 2), "coulomb": np.array([known.coulomb, known.static])}
        for name, own in out.items():
            given = getattr(self, name)
            if np.shape(given)[-1:] not in ((), (1,), own.shape[1:]):
                raise ShapeError(
                    f"uncertainty.{name} is for {given.shape[1]} joints and the arm has {own.shape[1]}", name=name
                )
            out[name] = own if given is None else np.broadcast_to(given, own.shape)
        return out["viscous"], out["coulomb"]


def middle_and_half(interval: Float64Array) -> tuple[Float64Array, Float64Array]:
    """(n,) each: the middle of intervals, and half their width."""
    low, high = interval
    return 0.5 * (low + high), 0.5 * (high - low)


def friction_and_error(
    b: Float64Array, c: Float64Array, v: Vector, v_des: Vector, width: ArrayLike
) -> tuple[Vector, Vector]:
    """(n,) each: friction at the desired velocity in the middle of its intervals, and the largest error of it.

    With b v + c sgn v true and b^ v_des + c^ tanh(v_des / width) assumed, for every sgn v that is right: also one
    between -1 and 1 of a joint that sticks.
    """
    (b_mid, b_half), (c_mid, c_half) = middle_and_half(b), middle_and_half(c)
    sign, assumed = tm.tanh(v / width), tm.tanh(v_des / width)
    wrong = tm.abs(sign - assumed) + 1.0 - tm.abs(sign)
    error = b_half * tm.abs(v_des) + (b_mid + b_half) * tm.abs(v - v_des) + c_half + c_mid * wrong
    return b_mid * v_des + c_mid * assumed, error


def _point_mass(mass: Any) -> RigidBody:
    return PayloadValues(mass=mass, com=np.zeros(3), inertia=np.zeros(6)).body()


def _carried(model: Model, mass: Any) -> Float64Array:
    """(n, 10) parameters of the bodies of an arm without mass that carries a point mass at the tool."""
    body, R, p = model.placement(None)
    return np.outer(np.arange(model.n) == body, parameters_of(_point_mass(mass).seen_from(R, p)))


class Robust(Law):
    """Robust computed torque: a bounded torque beats every model error in stated intervals (sliding mode with layer).

    Law:          tau = M^ (a_ref + k s) + C^ v_ref + g^ + f^ + u,   u_i = rho_i sat(s_i / phi_i)
                  s = e_dot + lam e,   v_ref = v_des + lam e,   a_ref = a_des + lam e_dot,   sat clipped at +-1
                  rho_i = sum over links of sig_l |Y_il pi_l| + (m_max - m_min)/2 |Y_i of 1 kg at the tool|
                          + |friction - f^|_max + d_i, the largest model error now, of `uncertainty`
                  ^ is the model with the payload in the middle of its interval; f^ is friction at v_des
    Closed loop:  M s_dot + C s = Delta - k M^ s - u,   |Delta_i| <= rho_i,   e_i follows s_i through 1/(p + lam_i)
                  V = s . M s / 2 falls at the rate (2 k / c) V less (1/4) sum rho_i phi_i,   c = max eig(M^^-1 M)
                  with an exact model and no friction e_ddot + (k + lam) e_dot + k lam e = -M^-1 u

    Proved, for every arm of the set, in continuous time and while no torque saturates: from a start on the reference
    e stays inside what `taut.analysis.certify` computes. Not proved: the sampled loop; a layer that is too thin
    chatters, and `taut.analysis.boundary_layer` gives the thinnest one that a rate allows.

    Args:
        lam: Rate at which e follows s, a number or (n,) [1/s].
        k: Rate of s; kp = k lam and kd = k + lam are computed torque's gains of the same nominal loop [1/s].
        phi: Boundary layer of s, a number or (n,): the certified error falls with its root [rad/s | m/s].
        width: Speed over which the sign of a velocity changes [rad/s | m/s].
        uncertainty: The intervals.

    Raises:
        RangeError, ShapeError, MatchError: An uncertainty without width or for another arm, when it is compiled.

    References:
        Slotine and Li, Applied Nonlinear Control (1991), chapters 7 to 9. Corless and Leitmann, IEEE TAC 26 (5)
        (1981). Spong, IEEE TAC 37 (11) (1992).
    """

    lam: Gain = Gain(unit="1/s", accepts=("scalar",), above=0.0)
    k: Gain = Gain(unit="1/s", shape="scalar", above=0.0)
    phi: Gain = Gain(unit="rad/s | m/s", accepts=("scalar",), above=0.0)
    width: Gain = Gain(0.01, unit="rad/s | m/s", shape="scalar", above=0.0)
    uncertainty: Part[Uncertainty] = Part(Uncertainty)

    def check_state(self, x: Snapshot, rate: float) -> None:  # noqa: ARG002
        self.uncertainty.check_arm(x.model)

    def command(self, x: Snapshot, ref: JointMotion) -> Command:
        e, e_dot = x.difference(ref.q), ref.v - x.v
        v_ref, a_ref = ref.v + self.lam @ e, ref.a + self.lam @ e_dot
        s = v_ref - x.v
        bodies, unknown = self.uncertainty.middle(x.model, x.bodies), self.uncertainty

        def model(a: Vector) -> Vector:
            return dyn.reference_dynamics(x.model, bodies, x.q, x.v, v_ref, a) - x.added

        width = self.width.as_array()
        wrong = tm.abs(unknown.torques(x.model, x.q, x.v, v_ref, a_ref))
        friction, of_friction = friction_and_error(*unknown.friction(x.friction), x.v, ref.v, width)
        rho = np.sum(wrong, axis=0) + of_friction + unknown.disturbance
        robust = rho * tm.clip(s / self.phi.as_array(), -1.0, 1.0)
        tau = Terms(nonlinear=model(a_ref)).up_to(model(a_ref + self.k @ s), "P")
        return Torque(tau + Terms(friction=friction, robust=robust))
