"""Snapshot: what a law sees at one instant. Measurements, and quantities of the model on demand."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final, TypeVar

import numpy as np

from taut.arm.description import Arm, Friction, Payload
from taut.base.checks import instance_of, one_of, vector
from taut.base.errors import MatchError, UsageError, unknown_name
from taut.base.types import Array, ArrayLike, Matrix, Rotation, Twist, Vector, Wrench
from taut.maths import dynamics as dyn
from taut.maths.model import Adds, Model, PayloadValues, RigidBody, model_of
from taut.trace import math as tm
from taut.trace.linalg import LTDL
from taut.trace.pose import Pose

T = TypeVar("T")

MEASUREMENTS: Final[Mapping[str, str]] = {
    "F_ext": "a wrist force-torque sensor: pass F_ext= or F_app= to step, or use a plant that measures it",
    "tau_meas": "joint torque sensors: pass tau_meas= to step, or use a plant that measures it",
    "q_motor": "encoders on the motors: pass q_motor= to step, or use a plant that measures it",
    "v_motor": "tachometers on the motors: pass v_motor= to step, or use a plant that measures it",
    "a_tip": "an accelerometer at the tool: pass a_tip= to step, or use a plant that measures it",
}
"""What a law may ask for beyond positions and velocities, and what it needs."""
ESTIMATES: Final[Mapping[str, str]] = {
    "tau_ext": "an observer: compile with sensing=taut.Sensing(observer=taut.sensors.MomentumObserver(bandwidth=...))"
}
"""What a law may ask for that sensing makes of other measurements, and what it needs."""
AXES: Final = ("W", "E")
AT_TOOL: Final = ("F_ext", "a_tip")  # measurements with axes, not joints, however many there are


def measurement_shapes(n: int) -> dict[str, tuple[int, ...]]:
    """Shape of everything that may be measured of an arm with n joints, or estimated."""
    others: dict[str, tuple[int, ...]] = {"F_ext": (6,), "a_tip": (3,)}
    return {"q": (n,), "v": (n,)} | {name: others.get(name, (n,)) for name in (*MEASUREMENTS, *ESTIMATES)}


class Snapshot:
    """The arm at one instant, as law code sees it: x.q, x.v, x.M, x.h, x.J("tool"), ...

    Everything is computed when first asked for, and once: symbols in a traced law, plain arrays in the float engine
    and in `taut.snapshot(arm, q, v)`.

    Frames: `x.T(frame)` is T_WE; `x.J(frame)` is J_WE_W (world-aligned), `x.J(frame, axes="E")` is J_WE_E.
    Model quantities are those of the controller's arm and payload; `x.g`, `x.h` and `x.Cv` leave out what the plant
    adds itself, so that a law adds exactly what is missing.
    """

    __slots__ = (
        "_adds",
        "_cache",
        "_measured",
        "_payload",
        "_q",
        "_t",
        "_v",
        "arm",
        "elsewhere",
        "model",
        "used",
    )

    def __init__(
        self,
        model: Model,
        *,
        q: Vector,
        v: Vector,
        t: Any = 0.0,
        payload: PayloadValues | None = None,
        adds: Adds | None = None,
        measured: Mapping[str, Array] | None = None,
        used: set[str] | None = None,
        elsewhere: bool = False,
    ) -> None:
        self.model = model
        self.arm = model.arm
        self._q = q
        self._v = v
        self._t = t
        self._payload = payload
        self._adds = adds or Adds()
        self._measured = dict(measured or {})
        self._cache: dict[Any, Any] = {}
        self.used = set() if used is None else used
        """Names of the measurements and compensations that were asked for."""
        self.elsewhere = elsewhere  # at a state that is not the measured one

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.model.n

    def _once(self, key: Any, compute: Callable[[], T]) -> T:
        if key not in self._cache:
            self._cache[key] = made = compute()
            if isinstance(made, np.ndarray):  # every law of a sum is given the same one
                made.flags.writeable = False
        value: T = self._cache[key]
        return value

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        known = [word for word in dir(type(self)) if not word.startswith("_")]
        raise AttributeError(str(unknown_name("the snapshot x", "quantity", name, known)), name=name, obj=None)

    @property
    def q(self) -> Vector:
        """(n,) measured positions [rad | m]."""
        return self._q

    @property
    def t(self) -> Any:
        """Time since the start [s]."""
        return self._t

    @property
    def v(self) -> Vector:
        """(n,) velocities, measured or as the controller's sensing makes them [rad/s | m/s]."""
        if not self.elsewhere:
            self.used.add("v")
        return self._v

    def _measurement(self, name: str) -> Array:
        self.used.add(name)
        if name not in self._measured:
            source = MEASUREMENTS.get(name) or ESTIMATES[name]
            raise MatchError(f"the law asks for {name}, which is not measured; it needs {source}", name=name)
        return self._measured[name]

    @property
    def F_ext(self) -> Wrench:
        """(6,) wrench of the environment on the arm at the tool, force first, world axes [N, N m].

        That of a wrist sensor, or estimated by `taut.sensors.MomentumObserver(F_ext=)`.
        """
        return self._measurement("F_ext")

    @property
    def tau_ext(self) -> Vector:
        """(n,) estimated joint torques of the environment, by `taut.sensors.MomentumObserver` [N m | N]."""
        return self._measurement("tau_ext")

    @property
    def tau_meas(self) -> Vector:
        """(n,) measured joint torques [N m | N]."""
        return self._measurement("tau_meas")

    @property
    def q_motor(self) -> Vector:
        """(n,) measured positions of the motors, in joint units: motor angle / gear [rad | m]."""
        return self._measurement("q_motor")

    @property
    def v_motor(self) -> Vector:
        """(n,) measured velocities of the motors, in joint units: motor speed / gear [rad/s | m/s]."""
        return self._measurement("v_motor")

    @property
    def a_tip(self) -> Array:
        """(3,) proper acceleration of the tool's origin, in the tool's axes: 9.81 upwards at rest [m/s^2]."""
        return self._measurement("a_tip")

    @property
    def tau_applied(self) -> Vector:
        """(n,) what really went out in the last tick, after limits [N m | N]."""
        self.used.add("tau_applied")
        return self._measured.get("tau_applied", np.zeros(self.n))

    @property
    def tau_cut(self) -> Vector:
        """(n,) what limits took from the last command, commanded minus applied, in its unit; zero without limits."""
        self.used.add("tau_cut")
        return self._measured.get("tau_cut", np.zeros(self.n))

    @property
    def M(self) -> Matrix:
        """(n, n) mass matrix [kg m^2]."""
        return self._once("M", lambda: dyn.mass_matrix(self.model, self.q, self._payload))

    @property
    def M_factors(self) -> LTDL:
        """Factors of M, for `taut.math.solve_spd(x.M_factors, b)`."""
        return self._once("M_factors", lambda: tm.factor_spd(self.M))

    @property
    def h(self) -> Vector:
        """(n,) C v + g, less what the plant adds itself [N m | N]."""
        self.used |= {"gravity", "coriolis"}
        if not self._adds.coriolis and not self.elsewhere:
            self.used.add("v")
        return self._once("h", self._bias)

    def _bias(self) -> Vector:
        adds = self._adds
        if not adds.gravity and not adds.coriolis:
            return dyn.bias(self.model, self.q, self._v, self._payload)
        if adds.gravity and adds.load is None:
            return self.Cv
        return self.Cv + self.g

    @property
    def g(self) -> Vector:
        """(n,) gravity torques, less what the plant adds itself [N m | N]."""
        self.used.add("gravity")
        return self._once("g", self._gravity)

    def _gravity(self) -> Vector:
        if not self._adds.gravity:
            return dyn.gravity_torque(self.model, self.q, self._payload)
        if self._adds.load is None:
            return tm.zeros(self.n)
        own = dyn.gravity_torque(self.model, self.q, self._payload)
        difference: Vector = own - dyn.gravity_torque(self.model, self.q, PayloadValues.of(self._adds.load))
        return difference

    @property
    def Cv(self) -> Vector:
        """(n,) Coriolis and centripetal torques, less what the plant adds itself [N m | N]."""
        self.used.add("coriolis")
        if self._adds.coriolis:
            return tm.zeros(self.n)
        v = self.v
        return self._once("Cv", lambda: dyn.bias(self.model, self.q, v, self._payload, gravity=False))

    @property
    def C(self) -> Matrix:
        """(n, n) Christoffel matrix of the whole model: M-dot - 2 C is skew, so C v_ref can be written."""
        self.used.add("coriolis")
        v = self.v
        return self._once("C", lambda: dyn.coriolis_matrix(self.model, self.q, v, self._payload))

    def forward_dynamics(self, tau: Vector) -> Vector:
        """(n,) accelerations M^-1 (tau - C v - g) of the whole model, without friction [rad/s^2 | m/s^2]."""
        return dyn.forward_dynamics(self.model, self.q, self.v, tau, self._payload)

    def inverse_dynamics(self, a: Vector, v_ref: Vector | None = None) -> Vector:
        """(n,) torques M a + C v + g of the whole model, without friction, by one recursion [N m | N].

        With `v_ref` (n,), M a + C v_ref + g with the C of Christoffel symbols: M-dot - 2 C is skew.
        """
        if v_ref is None:
            return dyn.inverse_dynamics(self.model, self.q, self.v, a, self._payload)
        bodies = dyn.loaded_bodies(self.model, self._payload)
        return dyn.reference_dynamics(self.model, bodies, self.q, self.v, v_ref, a)

    @property
    def bodies(self) -> list[RigidBody]:
        """The body of each joint, with the payload, for `taut.dynamics` with other bodies than the model's."""
        return dyn.loaded_bodies(self.model, self._payload)

    @property
    def added(self) -> Vector:
        """(n,) gravity and Coriolis torques that the plant adds itself: what a law leaves out [N m | N]."""
        self.used |= {"gravity", "coriolis"}
        payload = self._payload if self._payload is not None else PayloadValues.of(Payload())
        return dyn.compensation(self.model, self._adds, self.q, self._v, payload)

    @property
    def momentum(self) -> Vector:
        """(n,) generalised momentum M v of the whole model [kg m^2/s | kg m/s]."""
        return self._momentum[0]

    @property
    def CT_v(self) -> Vector:
        """(n,) C^T v of the whole model, with which d(M v)/dt = tau + C^T v - g [N m | N]."""
        return self._momentum[1]

    @property
    def _momentum(self) -> tuple[Vector, Vector]:
        v = self.v
        return self._once("momentum", lambda: dyn.momentum(self.model, self.q, v, self._payload))

    @property
    def kinetic_energy(self) -> Any:
        """Kinetic energy, rotors included [J]."""
        v = self.v
        return self._once("kinetic", lambda: dyn.kinetic_energy(self.model, self.q, v, self._payload))

    @property
    def potential_energy(self) -> Any:
        """Potential energy of the weights [J]; zero at the world's origin."""
        return self._once("potential", lambda: dyn.potential_energy(self.model, self.q, self._payload))

    @property
    def friction(self) -> Friction:
        """All of the model's joint friction, each number (n,), less what the plant adds itself."""
        self.used.add("friction")
        return (
            Friction(viscous=np.zeros(self.n), coulomb=np.zeros(self.n)) if self._adds.friction else self.arm.friction
        )

    def T(self, frame: str | None = None) -> Pose:
        """T_WE of a frame; of the tool if none is named."""
        return self._once(("T", frame), lambda: dyn.pose(self.model, self.q, frame))

    def J(self, frame: str | None = None, axes: str = "W") -> Matrix:
        """(6, n) Jacobian of a frame, linear part first: J_WE_W, or J_WE_E with axes="E"."""
        one_of("axes", axes, AXES)
        return self._once(("J", frame, axes), lambda: dyn.jacobian(self.model, self.q, frame, axes))

    def Jdot_v(self, frame: str | None = None, axes: str = "W") -> Twist:
        """(6,) J-dot v of a frame [m/s^2, rad/s^2]."""
        one_of("axes", axes, AXES)
        v = self.v
        return self._once(("Jdot_v", frame, axes), lambda: dyn.jacobian_rate_v(self.model, self.q, v, frame, axes))

    def twist(self, frame: str | None = None, axes: str = "W") -> Twist:
        """(6,) twist of a frame, linear part first [m/s, rad/s]."""
        moved: Twist = self.J(frame, axes) @ self.v
        return moved

    def difference(self, q_des: Vector) -> Vector:
        """(n,) q_des - q the short way round; continuous joints wrap."""
        return self.arm.difference(q_des, self.q)

    @property
    def measured(self) -> Mapping[str, Array]:
        """All that is measured by name, q and v among it, without a record that it was asked for."""
        return {**self._measured, "q": self._q, "v": self._v}

    def at(self, q: Vector, v: Vector) -> Snapshot:
        """The same arm, payload and time at another state."""
        return self.of_model(self.model, {**self.measured, "q": q, "v": v}, elsewhere=True)

    def of_model(self, model: Model, measured: Mapping[str, Array], *, elsewhere: bool) -> Snapshot:
        """Another model at this instant, with the payload and the record of this snapshot.

        Args:
            model: The model.
            measured: Its q and v, and its other measurements by name.
            elsewhere: Whether q and v are another state than the measured one.
        """
        return Snapshot(
            model,
            q=measured["q"],
            v=measured["v"],
            t=self._t,
            payload=self._payload,
            adds=self._adds,
            measured={name: values for name, values in measured.items() if name not in ("q", "v")},
            used=self.used,
            elsewhere=elsewhere,
        )

    def turned(self, R: Rotation, frame: str | None = None) -> Snapshot:
        """The same state and pose, with a frame's twist and Jacobian multiplied by R^T: motion in rotated axes."""
        twin = self.with_own_record()
        twin.used = self.used
        twin._cache = {
            ("T", frame): self.T(frame),
            ("J", frame, "W"): tm.array([*(R.T @ self.J(frame)[:3]), *(R.T @ self.J(frame)[3:])]),
            ("Jdot_v", frame, "W"): tm.array([*(R.T @ self.Jdot_v(frame)[:3]), *(R.T @ self.Jdot_v(frame)[3:])]),
        }
        return twin

    def feeling(self, change: Callable[[Wrench], Wrench]) -> Snapshot:
        """The same snapshot, shared, with another F_ext where one is measured."""
        twin = self.with_own_record()
        twin.used = self.used
        if "F_ext" in self._measured:
            twin._measured = {**self._measured, "F_ext": change(self._measured["F_ext"])}
        return twin

    def with_own_record(self) -> Snapshot:
        """The same snapshot, shared, with a record of its own of what is asked for."""
        twin = Snapshot.__new__(Snapshot)
        for name in Snapshot.__slots__:
            setattr(twin, name, getattr(self, name))
        twin.used = set()
        return twin


def snapshot(arm: Arm, q: ArrayLike, v: ArrayLike | None = None, payload: Payload | None = None) -> Snapshot:
    """The arm at one state, with plain numbers: M, h, g, C, poses and Jacobians of any frame.

    Args:
        arm: The arm.
        q: (n,) positions [rad | m].
        v: (n,) velocities [rad/s | m/s]; zero if left out.
        payload: What the tool carries; the arm's own payload if left out.

    Raises:
        ShapeError: Wrong number of entries.
        RangeError: NaN or infinite entries.
        UsageError: Not an arm or not a payload.

    Example:
        >>> import taut
        >>> x = taut.snapshot(taut.load_arm("one_joint"), q=[0.0])
        >>> x.g.round(3).tolist()
        [0.981]
    """
    instance_of("arm", arm, Arm, "an Arm from taut.load_arm")
    held = arm.payload if payload is None else payload
    if not isinstance(held, Payload):
        raise UsageError(f"payload must be taut.Payload(mass=...); got {type(held).__name__}", name="payload")
    return Snapshot(
        model_of(arm),
        q=vector("q", q, arm.n, joints=arm.joint_names),
        v=vector("v", np.zeros(arm.n) if v is None else v, arm.n, joints=arm.joint_names),
        payload=PayloadValues.of(held),
    )
