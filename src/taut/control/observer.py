"""Momentum observer: the joint torques of the environment, from the arm's generalised momentum and the drives'."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final, Literal

import numpy as np

from taut.arm.description import Arm
from taut.base.errors import MatchError, RangeError
from taut.base.fields import Choice, Declared, Field
from taut.base.types import Array, Vector
from taut.control.command import Torque
from taut.maths import dynamics as dyn
from taut.maths.friction import FrictionValues, friction_torque
from taut.maths.model import Adds, Model, PayloadValues, links_of, model_of
from taut.maths.task_inertia import TaskInertia
from taut.trace import math as tm

Values = Mapping[str, Any]
WRENCH_DAMPING: Final = 1e-4  # [1/kg, 1/(kg m^2)] a direction in which the tool seems heavier than 10 t has no F_ext


class MomentumObserver(Declared):
    """Momentum observer: the external joint torques x.tau_ext without acceleration and without sensors of force.

    Law:          r' = K_O (p' - tau - C^T v + g - f - r),  p = M v,  x.tau_ext = r
                  exact in a sampled loop: tau by zero-order hold, C^T v - g + f by the trapezoidal rule:
                  r[k] = (1 - K_O T) r[k-1] + K_O (p[k] - p[k-1] - T tau[k-1] - T (b[k-1] + b[k]) / 2),
                  b = C^T v - g + f
    Closed loop:  each joint by itself r' = K_O (tau_ext - r): of a step of tau_ext, the fraction 1 - (1 - K_O T)^k
                  is there after k ticks. Errors of model, friction and drives are in tau_ext as well
                  white noise sigma of v: std(r_i) = K_O sigma |row i of M| sqrt(2 / (2 - K_O T))

    Friction f is that of the controller's arm, its dry part as tanh(v / width). At rest a push below its limit is not
    seen, and what it carries of the weight is taken for contact. A law that feeds r back needs K_O T <= 0.5, and K_O
    below a third of 1 / (all delays). Change the payload of the model at rest: a moving arm's momentum jumps with it.

    Args:
        bandwidth: K_O [1/s], scalar or one per joint; K_O T < 1.
        width: Velocity over which dry friction changes its sign [rad/s | m/s].
        torque: tau: "applied", the command of the last tick after limits with what the plant adds; or "measured",
            x.tau_meas behind gear and friction, for which neither friction nor drives nor rotors matter.
        F_ext: What x.F_ext is: "measured" by a wrist sensor; or estimated from tau_ext = J^T F, as a pure "force" at
            the tool or a full "wrench", by the dynamically consistent inverse F = (J M^-1 J^T)^-1 J M^-1 tau_ext.
            Contact elsewhere on the arm gives a wrong one; what the joints do not carry is not in it.

    Raises:
        RangeError: A bandwidth of zero or below, or one of the rate or above.
        MatchError: torque="applied" under a law whose torque is not known: of positions, velocities, or for
            motors with a loop of their own.

    References:
        De Luca and Mattone, Actuator failure detection and isolation using generalized momenta, ICRA (2003).
        Haddadin, De Luca and Albu-Schaeffer, Robot collisions: a survey, IEEE Transactions on Robotics 33 (2017).
    """

    bandwidth: Field = Field(unit="1/s", shape="n", above=0.0, hint="leave the observer out for none")
    width: Field = Field(0.01, unit="rad/s | m/s", shape="n", above=0.0)
    torque: Choice[Literal["applied", "measured"]] = Choice("applied", "measured")
    F_ext: Choice[Literal["measured", "force", "wrench"]] = Choice("measured", "force", "wrench")

    @property
    def estimates(self) -> tuple[str, ...]:
        """What it gives, by the name in the snapshot."""
        return ("tau_ext",) if self.F_ext == "measured" else ("tau_ext", "F_ext")

    @property
    def needs(self) -> tuple[str, ...]:
        """Measurements that it takes, beside positions and velocities."""
        return ("tau_meas",) if self.torque == "measured" else ()

    def counts_on(self, arm: Arm) -> set[str]:
        """What a plant may add only if the controller knows it."""
        if self.torque == "measured":
            return set()
        has_friction = FrictionValues.names(arm.friction)
        return {"gravity", "coriolis"} | ({"friction"} if has_friction else set())

    def check_fit(self, arm: Arm, rate: float) -> None:
        """It must fit an arm and a rate [Hz]. Raises ShapeError, RangeError."""
        self.check_size(arm.joint_names, "sensing.observer.")
        values = np.broadcast_to(self.bandwidth, (arm.n,))
        i = int(np.argmax(values >= rate))
        if values[i] >= rate:
            raise RangeError(
                f"sensing.observer.bandwidth of joint '{arm.joint_names[i]}' must be < {rate:g} [1/s], the "
                f"controller's rate, or the estimate overshoots; got {values[i]:g}; half of it serves laws that feed "
                "the estimate back",
                name="sensing.observer.bandwidth",
                joint=arm.joint_names[i],
                value=float(values[i]),
            )

    def check_command(self, kind: str, law: str) -> None:
        """The torque that acts must be known. Raises MatchError."""
        if self.torque == "applied" and kind != Torque.kind:
            raise MatchError(
                f"sensing.observer takes the torque of the last command, and {law} gives {kind} commands; use a law "
                "of torques, or torque='measured' with a plant that measures them",
                name="sensing.observer",
            )

    def observe(
        self,
        arm: Arm,
        seen: Values,  # measurements as the law sees them, by name
        tau: Vector,  # (n,) command of the last tick, after limits
        adds: Adds,
        parameters: Values,
        payload: PayloadValues,
        dt: Any,
        memory: Values | None = None,
    ) -> dict[str, Any]:
        """New memory: (n,) tau_ext [N m | N], and the momentum with half a period of what changes it.

        Without memory it is that of the tick before, of an arm on which nothing external acts.
        """
        tau, gain = seen["tau_meas"] if self.torque == "measured" else tau, parameters["bandwidth"]
        p, b = self._balance(arm, seen, tau, adds, parameters, payload)
        before = p - 0.5 * dt * b - dt * tau
        if memory is None:
            return {"tau_ext": tm.zeros(arm.n), "momentum": before}
        r = (1.0 - gain * dt) * memory["tau_ext"] + gain * (before - memory["momentum"])
        return {"tau_ext": r, "momentum": p + 0.5 * dt * b}

    def _balance(
        self, arm: Arm, seen: Values, tau: Vector, adds: Adds, parameters: Values, payload: PayloadValues
    ) -> tuple[Vector, Vector]:
        """(n,) each: the momentum, and its rate without the drives' torque and what is external."""
        q, v = seen["q"], seen["v"]
        model = model_of(arm) if self.torque == "applied" else links_of(arm)
        p, CT_v = dyn.momentum(model, q, v, payload)
        rate = CT_v - dyn.gravity_torque(model, q, payload)
        if self.torque == "applied":
            rate = rate + dyn.compensation(model, adds, q, v, payload)
            if not adds.friction:
                rate = rate + self.friction(arm, v, tau, parameters)
        return p, rate

    @staticmethod
    def friction(arm: Arm, v: Vector, tau: Vector, parameters: Values) -> Vector:
        """(n,) friction torques of the controller's arm, with a dry part that is smooth about rest."""
        return friction_torque(FrictionValues.fixed(arm.friction), v, tau, -tau, parameters["width"])

    def wrench(self, model: Model, q: Vector, tau_ext: Vector, payload: PayloadValues) -> Array:
        """(6,) F_ext at the tool in world axes [N, N m] of tau_ext; without moment if it is taken for a force."""
        rows = 3 if self.F_ext == "force" else 6
        factors = tm.factor_spd(dyn.mass_matrix(model, q, payload))
        F = TaskInertia.of(dyn.jacobian(model, q)[:rows], factors, WRENCH_DAMPING).wrench(tau_ext)
        return F if rows == 6 else tm.array([*F, 0.0, 0.0, 0.0])
