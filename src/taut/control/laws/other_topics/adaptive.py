"""Adaptive control: a law that learns the inertial parameters which the model does not know, and joint friction."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, Literal

import numpy as np

from taut.arm.description import BASE, Arm, Friction
from taut.base.errors import MatchError, RangeError, warn
from taut.base.fields import Choice
from taut.base.types import Float64Array, Matrix, Vector
from taut.control.command import Command, Terms, Torque
from taut.control.gains import Gain, Memory, MemoryView, require_at_most
from taut.control.law import Law
from taut.control.trajectories.reference import JointMotion, Sample
from taut.maths import dynamics as dyn
from taut.maths import regressor as rg
from taut.maths.model import Model, PayloadValues
from taut.maths.snapshot import Snapshot
from taut.trace import math as tm

Links = Literal["payload", "all"]
MAX_STEP: Final = 0.2  # [-] relative change of an estimate in one tick: a single bad tick must not overflow it
PRIOR_SIDE: Final = 0.1  # [m] of the cube that the prior payload is taken for
MAX_REACH: Final = 0.5  # [-] dt gamma max eig(Q W^T R W) of composite adaptation; unstable beyond 2
THINNEST: Final = 1e-9  # [-] smallest eigenvalue of a pseudo-inertia, relative to its largest


class Adaptive(Law):
    """Adaptive control in Slotine-Li form: tracking with a payload, masses or friction that the model does not know.

    Law:          tau = M^ a_r + C^ v_r + g^ + k M s + b^ v_r + c^ tanh(v_des / width)
                    v_r = v_des + lam e,  a_r = a_des + lam e_dot,  s = v_r - v = e_dot + lam e,  M of the model
                  P^ = G G^T,  G' = G (1 + (gamma dt / 2) G^T L G), so that dP^/dt = gamma P^ L P^
                    P^ is the pseudo-inertia of an adapted body, its first and second moments of mass
                    tr(L P) = s . (the body's part of M a_r + C v_r + g) for every P
                    at most 0.2 of itself in one tick
                  composite: s . (...) less e_p . R W pi for L, where e_p = W pi^ - tau and W pi, tau are filtered:
                    Y pi = d(M v)/dt - C^T v + g through a low-pass, for which accelerations are not needed
                    R^-1 = 1 / composite + 2 dt gamma W Q W^T, so that dt gamma eig(Q W^T R W) is below 0.5
                  b^' = b^ exp(gamma_friction b^ v_r s dt), c^' = c^ exp(gamma_friction c^ tanh(v_des / width) s dt)
                  all estimates rest where sqrt(s . M s) < dead_zone, and while limits cut the torque
    Closed loop:  M_true ds/dt + C s + b s + k M s = Y (pi - pi^), and e_dot + lam e = s
                  with the true parameters, M = M_true: e_ddot + (k + lam) e_dot + k lam e = 0
                  V = s . M_true s / 2 + sum d(P, P^) / gamma falls at the rate k s . M s (+ s . b s), so that s and e
                    tend to 0, for constant parameters, no other torques and no saturation, in continuous time
                    d(P, P^) = log(det P^ / det P) + tr(P^^-1 P) - 4
                  |s_i| <= sqrt(2 V(0) (M_true^-1)_ii): a payload step adds d / gamma to V
                  composite adaptation lets V fall at e_p . R e_p besides

    Guaranteed in the sampled loop: every estimate is that of a possible body, whatever is measured. Not guaranteed
    there: that V falls in every tick. Keep k dt <= 0.1 and gamma max eig(M^-1 Y Q Y^T) dt a fifth of k, where Q y are
    the parameters of P^ L(y) P^: beyond k the sampled adaptation is unstable, which is checked for Y at rest at the
    start, with `max_payload` in P^. State the rotors' inertia.
    Estimates need not tend to the truth: what the motion does not excite is not learned, see
    `taut.analysis.payload_estimate`, and a lasting torque that is in no parameter is taken for mass.

    The memory `estimate`, a column of runs, has for each adapted body m, m c and the inertia xx, yy, zz, xy, xz, yz
    about its joint's frame, in axes with the joint's axis on z. It starts at the model, its payload and `prior`.

    Args:
        lam: Rate at which e follows s.
        k: Rate at which s decays.
        gamma: Adaptation gain of inertial parameters.
        max_payload: Heaviest mass that the tool may carry beyond the model's payload, taken for a cube of 0.1 m: the
            limit of gamma is that of an estimate with it.
        links: "payload", the body that carries the tool with its payload, or "all" bodies.
        gamma_friction: Adaptation gain of viscous and dry friction; without it friction is no part of the law. The
            estimates start at the model's friction, and what is zero there stays zero.
        width: Speed over which the estimated dry friction changes its sign.
        dead_zone: Of sqrt(s . M s): residual torque / (k sqrt(min eig M)), so that a disturbance is not learned.
        prior: Mass that the tool is taken to carry at first beyond the model's payload, a cube of 0.1 m.
        composite: Weight of the error of the filtered torques in composite adaptation, such as 10; without it the
            tracking error alone adapts.
        cutoff: Of the low-pass of composite adaptation.

    Raises:
        UsageError: Composite adaptation and friction.
        MatchError: The arm's tool does not move, or friction is to be adapted and the model has none.
        RangeError: A body of the model that no real body can be, such as an infinitely thin rod; a gain too large for
            the rate.

    Example:
        >>> import taut
        >>> arm = taut.load_arm("panda")
        >>> ctrl = taut.compile(Adaptive(lam=10.0, k=10.0, gamma=5.0, max_payload=2.0), arm)
        >>> tau = ctrl.step(arm.home, np.zeros(7), taut.JointMotion(q=arm.home))
        >>> ctrl.memory["law.estimate"][0, 0].round(3)  # [kg] of hand and last link
        np.float64(1.496)

    References:
        Section 10.6 other topics. Slotine and Li (1987), IJRR 6 (3); composite: (1989), Automatica 25 (4). Lee, Kwon
        and Park (2018), IROS, the natural adaptation law.
    """

    lam: Gain = Gain(unit="1/s", accepts=("scalar",))
    k: Gain = Gain(unit="1/s", shape="scalar")
    gamma: Gain = Gain(unit="1/J", shape="scalar")
    max_payload: Gain = Gain(unit="kg", shape="scalar")
    links: Choice[Links] = Choice("payload", "all")
    gamma_friction: Gain = Gain(unit="1/J", shape="scalar", optional=True)
    width: Gain = Gain(0.01, unit="rad/s | m/s", accepts=("scalar",), above=0.0)
    dead_zone: Gain = Gain(0.0, unit="J^0.5", shape="scalar")
    prior: Gain = Gain(0.0, unit="kg", shape="scalar")
    composite: Gain = Gain(unit="1/(N m s)", shape="scalar", above=0.0, optional=True)
    cutoff: Gain = Gain(50.0, unit="1/s", shape="scalar", above=0.0)
    root = Memory(unit="kg^0.5, kg^0.5 m", doc="G of each adapted body")
    estimate = Memory(unit="kg, kg m, kg m^2", record=True, doc="ten parameters of each adapted body")
    friction = Memory(unit="N m s/rad, N m", record=True, doc="viscous and dry friction, where they are adapted")
    filtered = Memory(unit="N m, and that per parameter", doc="low-pass of composite adaptation")
    begun = Memory(doc="0 in the first tick, 1 after it")

    def check(self) -> None:
        if self.composite is not None and self.gamma_friction is not None:
            self.refuse("composite", "takes all torque for the bodies'; leave out composite or gamma_friction")

    def check_rate(self, rate: float) -> None:
        for name in ("lam", "k"):
            require_at_most(name, getattr(self, name), rate, "1/s", "or the sampled loop cannot be stable")

    def check_state(self, x: Snapshot, rate: float) -> None:
        """The adapted bodies must be possible, friction that is adapted must exist, and gamma fit the rate."""
        arm = x.arm
        if x.model.placement(None)[0] == BASE:
            raise MatchError(
                f"Adaptive needs a tool that moves; '{arm.tool}' of arm '{arm.name}' is fixed to the base; load the "
                "arm with tool= another frame",
                name="tool",
            )
        if self.gamma_friction is not None and not np.any(_friction(arm.friction)):
            raise MatchError(
                f"Adaptive has no friction to adapt: arm '{arm.name}' has none; state it with "
                "arm.with_friction(taut.Friction(...)), or leave gamma_friction out",
                name="friction",
            )
        which, estimate = adapted(x.model, self.links), self._at_start(x, self.prior[()])
        for k, row in zip(which, estimate, strict=True):
            sizes = np.linalg.eigvalsh(rg.pseudo_inertia(row))
            if not sizes[0] > THINNEST * sizes[-1]:
                raise RangeError(
                    f"Adaptive must start at possible bodies with a size in every direction; that of joint "
                    f"'{arm.joint_names[k]}' is not (its pseudo-inertia has eigenvalues {sizes[0]:.2g} to "
                    f"{sizes[-1]:.2g}); correct its inertia, or give it a size with prior= or a payload",
                    name="estimate",
                    value=float(sizes[0]),
                )
        y = np.array([rg.covectors(x.model, x.q, np.zeros(x.n), np.zeros(x.n), unit) for unit in np.eye(x.n)])
        loaded = self._at_start(x, max(self.prior[()], self.max_payload[()]))
        moved = sum(y[:, k] @ metric(row) @ y[:, k].T for k, row in zip(which, loaded, strict=True))
        fastest = float(np.linalg.eigvals(np.linalg.solve(x.M, moved)).real.max())
        if self.gamma[()] * fastest > self.k[()] * rate:
            raise RangeError(
                f"gamma must be <= {self.k[()] * rate / fastest:.4g} [1/J] at this pose with "
                f"max_payload={self.max_payload[()]:g} kg, k * rate / max eig(M^-1 Y Q Y^T), or the sampled "
                "adaptation to weight oscillates with growing amplitude; motion lowers the limit: stay a factor of "
                f"five below; got {self.gamma[()]:g}",
                name="gamma",
                value=float(self.gamma[()]),
            )

    def check_plant(self, path: str, arm: Arm, plant: str, parameters: Mapping[str, Any]) -> None:
        """Warn of a plant that carries more than `max_payload`."""
        excess = float(parameters.get("plant.payload.mass", 0.0)) - arm.payload.mass
        if excess > self.max_payload[()]:
            warn(
                f"{path}.max_payload is {self.max_payload[()]:g} kg and plant '{plant}' carries {excess:g} kg more "
                "than the controller's arm, for which gamma may be too large: the adaptation may oscillate with "
                "growing amplitude; raise max_payload"
            )

    def start(self, x: Snapshot, ref: Sample) -> Mapping[str, Any]:  # noqa: ARG002
        estimate = self._at_start(x, self.prior[()])
        roots = [tm.factor_spd(rg.pseudo_inertia(row)).root() for row in estimate]
        friction = tm.zeros(0) if self.gamma_friction is None else _friction(x.friction)
        size = 0 if self.composite is None else (x.n, 1 + 10 * len(estimate))
        return {"root": tm.stack(roots), "estimate": estimate, "friction": friction, "filtered": tm.zeros(size)}

    def _at_start(self, x: Snapshot, mass: Any) -> Matrix:
        """(m, 10) of the model's bodies with payload and a cube of this mass at the tool."""
        bodies = list(x.model.links)
        tool, R, p = x.model.placement(None)
        side = mass * PRIOR_SIDE**2 / 6.0
        cube = PayloadValues(mass=mass, com=np.zeros(3), inertia=tm.array([side, side, side, 0.0, 0.0, 0.0]))
        payload = x.bodies[tool] - x.model.bodies[tool]
        bodies[tool] = bodies[tool] + payload + cube.body().seen_from(R, p)
        return tm.stack([rg.parameters_of(bodies[k]) for k in adapted(x.model, self.links)])

    def command(
        self, x: Snapshot, ref: JointMotion, memory: MemoryView, dt: float
    ) -> tuple[Command, dict[str, object]]:
        e, e_dot = x.difference(ref.q), ref.v - x.v
        v_r, a_r, s = ref.v + self.lam @ e, ref.a + self.lam @ e_dot, e_dot + self.lam @ e
        bodies, which = list(x.model.bodies), adapted(x.model, self.links)
        for k, G in zip(which, memory.root, strict=True):
            bodies[k] = bodies[k] + (rg.body_of(_parameters(G)) - x.model.links[k])
        own = dyn.reference_dynamics(x.model, bodies, x.q, x.v, v_r, a_r)
        feedback = Terms(P=self.lam @ e, D=e_dot).mapped(lambda s: self.k[()] * x.at(x.q, s).momentum)
        torque = Terms(nonlinear=own - x.added) + feedback

        small = s @ feedback.total < self.k[()] * self.dead_zone[()] ** 2
        step = tm.where(small | (np.sum(tm.abs(x.tau_cut)) > 0.0), 0.0, dt)
        y = rg.reference_covectors(x.model, x.q, x.v, v_r, a_r, s)
        rows, filtered = [y[k] for k in which], memory.filtered
        if self.composite is not None:
            corrections, filtered = self._corrections(x, memory, dt)
            rows = [row - change for row, change in zip(rows, corrections, strict=True)]
        roots = [natural_step(G, row, self.gamma[()] * step) for row, G in zip(rows, memory.root, strict=True)]
        after = {"root": tm.stack(roots), "estimate": tm.stack([_parameters(G) for G in roots])}
        friction = memory.friction
        if self.gamma_friction is not None:
            per_friction = tm.stack([v_r, tm.tanh(ref.v / self.width.as_array())])
            torque = torque + Terms(friction=np.sum(friction * per_friction, axis=0))
            change = self.gamma_friction[()] * step * friction * per_friction * s
            friction = friction * tm.exp(tm.clip(change, -MAX_STEP, MAX_STEP))
        return Torque(torque), {**after, "friction": friction, "filtered": filtered, "begun": 1.0}

    def _momenta(self, x: Snapshot) -> tuple[Matrix, Matrix]:
        """(n, 1 + 10 m) p, and C^T v - g: of the model without payload, and per parameter of each adapted body."""
        model, rest, which = x.model, np.zeros(x.n), adapted(x.model, self.links)
        p, rate = dyn.momentum(model, x.q, x.v)
        of_p, of_g = (
            tm.stack([rg.covectors(model, x.q, rest, a, unit, gravity=gravity) for unit in np.eye(x.n)])
            for a, gravity in ((x.v, False), (rest, True))
        )
        energies = tm.jacobian(lambda q: 0.5 * rg.covectors(model, q, rest, x.v, x.v, gravity=False).reshape(-1), x.q)
        of_rate = energies.reshape(x.n, 10, x.n)  # by the rows of v M v / 2, whose slope by q is C^T v
        columns = [p, *(row for k in which for row in of_p[:, k].T)]
        rates = [rate - dyn.gravity_torque(model, x.q), *(row for k in which for row in of_rate[k] - of_g[:, k].T)]
        return tm.stack(columns).T, tm.stack(rates).T

    def _corrections(self, x: Snapshot, memory: MemoryView, dt: Any) -> tuple[list[Vector], Matrix]:
        """W^T R e_p of each adapted body (10,), and the new memory of the filter."""
        assert self.composite is not None
        a, (p, rate) = 1.0 - tm.exp(-self.cutoff[()] * dt), self._momenta(x)
        applied = tm.stack([x.tau_applied + x.added, *np.zeros((p.shape[1] - 1, x.n))]).T
        # Exact for held torques: p-dot is the difference of two ticks, C^T v - g the mean of both.
        impulse = (a / dt) * p
        before = tm.where(memory.begun > 0.0, memory.filtered + a * applied, impulse - 0.5 * a * rate)
        W = impulse - before - 0.5 * a * rate
        filtered = before + a * (impulse + (1.0 - 0.5 * a) * rate - before)
        e_p, reach = W[:, 0], np.eye(x.n) / self.composite[()]
        each = [W[:, i : i + 10] for i in range(1, W.shape[1], 10)]
        for k, G, own in zip(adapted(x.model, self.links), memory.root, each, strict=True):
            e_p = e_p + own @ (_parameters(G) - rg.parameters_of(x.model.links[k]))
            rows = tm.stack([(G.T @ rg.covector_matrix(w) @ G).reshape(-1) for w in own])
            reach = reach + (dt * self.gamma[()] / MAX_REACH) * (rows @ rows.T)
        e_p = tm.solve_spd(tm.factor_spd(reach), e_p)
        return [e_p @ own for own in each], filtered


def adapted(model: Model, links: Links) -> tuple[int, ...]:
    """The bodies that are adapted: the one that carries the tool, or all."""
    return tuple(range(model.n)) if links == "all" else (model.placement(None)[0],)


def natural_step(G: Matrix, y: Vector, gain: Any) -> Matrix:
    """(4, 4) root of a body's pseudo-inertia P = G G^T after a step of dP/dt = P L P by gain = gamma dt.

    L is that of the covector y: tr(L P) = y . parameters. P stays positive for every y, with rounding too, since the
    root is what is kept; to second order it is G exp(gain G^T L G) G^T.
    """
    A = gain * (G.T @ rg.covector_matrix(y) @ G)
    size = np.sum(A * A)
    large = size > MAX_STEP**2
    half = tm.where(large, 0.5 * MAX_STEP / tm.sqrt(tm.where(large, size, 1.0)), 0.5)
    out: Matrix = G + half * (G @ A)
    return out


def metric(parameters: Vector) -> Float64Array:
    """(10, 10) Q with Q y the parameters of P L(y) P: gamma Q y is the rate of a body's parameters."""
    P = np.asarray(rg.pseudo_inertia(parameters), dtype=np.float64)
    return np.array([rg.of_pseudo_inertia(P @ rg.covector_matrix(y) @ P) for y in np.eye(10)], dtype=np.float64)


def _parameters(G: Matrix) -> Vector:
    """(10,) of a root."""
    return rg.of_pseudo_inertia(G @ G.T)


def _friction(friction: Friction) -> Matrix:
    """(2, n) viscous and dry friction."""
    return tm.stack([friction.viscous, friction.coulomb])
