"""The control functions of the textbook's library, by its names, signatures and order of six-vectors.

For code that uses the library `modern_robotics`: change the import to `taut.textbook`. The integral is that of
equation 10.21, where the library's has no time step.

References:
    Lynch and Park, Modern Robotics (2017), sections 8.9 and 11.4; chapter, equation 10.21 and figure 10.13.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from taut.arm.description import Arm
from taut.base.checks import finite_array, finite_scalar, positive_scalar, whole_number
from taut.base.errors import NumericalError, TautError
from taut.base.types import ArrayLike, Float64Array, Vector
from taut.codegen.kernel import native
from taut.control.laws.joint import ComputedTorque as ComputedTorqueLaw
from taut.control.trajectories.reference import JointMotion
from taut.controller import compile
from taut.maths import dynamics as dyn
from taut.maths.model import model_of

__all__ = ["ComputedTorque", "SimulateControl"]

MAX_INTEGRATION_STEPS: Final = 100_000  # of intRes
FAR: Final = 1e9  # [rad | m] where no arm is


def ComputedTorque(
    thetalist: ArrayLike,
    dthetalist: ArrayLike,
    eint: ArrayLike,
    g: ArrayLike,
    Mlist: ArrayLike,
    Glist: ArrayLike,
    Slist: ArrayLike,
    thetalistd: ArrayLike,
    dthetalistd: ArrayLike,
    ddthetalistd: ArrayLike,
    Kp: float,
    Ki: float,
    Kd: float,
) -> Float64Array:
    """Torques of feedback linearisation at one instant, in the textbook's notation.

    Law:          tau = M(theta) (theta-ddot_d + Kp e + Ki eint + Kd e-dot) + h(theta, theta-dot)           eq. 10.21
    Closed loop:  e-ddot + Kd e-dot + Kp e + Ki int(e) = 0, with an exact model                              eq. 10.17

    The library `modern_robotics` has Ki (eint + e) in the place of Ki eint, as if the time step were one second. A
    screw axis whose length is not one is taken as the library takes it: the joint turns by theta times that length.

    Frames:
        The angular part comes first: Slist is (omega, v), Glist diag(I, m 1).

    Args:
        thetalist: (n,) joint variables [rad | m].
        dthetalist: (n,) their rates.
        eint: (n,) integral of the error over time [rad s | m s].
        g: (3,) gravity [m/s^2].
        Mlist: (n + 1, 4, 4) link frame i in frame i - 1 at the zero pose.
        Glist: (n, 6, 6) spatial inertias.
        Slist: (6, n) screw axes in the space frame.
        thetalistd: (n,) desired joint variables.
        dthetalistd: (n,) their rates.
        ddthetalistd: (n,) their accelerations.
        Kp: [1/s^2].
        Ki: [1/s^3].
        Kd: [1/s].

    Returns:
        (n,) torques or forces [N m | N].

    Raises:
        ShapeError: Lists and vectors that do not fit together.
        RangeError: Not finite, or gains below zero.
        ModelError: An inertia or a screw axis that no rigid body or joint has.

    Example:
        >>> import numpy as np
        >>> turn, slide = np.eye(4), np.eye(4)
        >>> turn[0, 3] = slide[0, 3] = 0.1  # the link of the chapter, 0.1 m from its hinge to its mass
        >>> link = np.diag([0.49, 0.49, 0.49, 1.0, 1.0, 1.0])
        >>> lists = ([turn, slide], [link], [[0.0], [-1.0], [0.0], [0.0], [0.0], [0.0]])
        >>> tau = ComputedTorque([0.0], [0.0], [0.2], [0, 0, -9.81], *lists, [0.1], [0.0], [0.0], 100.0, 50.0, 20.0)
        >>> tau.round(6).tolist()  # 0.5 kg m^2 (100 * 0.1 + 50 * 0.2) + 1 kg 9.81 m/s^2 0.1 m
        [10.981]
    """
    arm, length = _arm(Mlist, Glist, Slist, g)
    n = arm.n
    q, v, e_int = (
        length * finite_array(name, value, shape=(n,))
        for name, value in (("thetalist", thetalist), ("dthetalist", dthetalist), ("eint", eint))
    )
    wanted = (("thetalistd", thetalistd), ("dthetalistd", dthetalistd), ("ddthetalistd", ddthetalistd))
    q_des, v_des, a_des = (length * finite_array(name, value, shape=(n,)) for name, value in wanted)
    Ki = finite_scalar("Ki", Ki, minimum=0.0)
    ctrl = compile(ComputedTorqueLaw(kp=Kp, kd=Kd), arm, engine="float")  # the integral is given
    tau: Float64Array = length * ctrl.step(q, v, JointMotion(q=q_des, v=v_des, a=a_des + Ki * e_int))
    return tau


def SimulateControl(
    thetalist: ArrayLike,
    dthetalist: ArrayLike,
    g: ArrayLike,
    Ftipmat: ArrayLike,
    Mlist: ArrayLike,
    Glist: ArrayLike,
    Slist: ArrayLike,
    thetamatd: ArrayLike,
    dthetamatd: ArrayLike,
    ddthetamatd: ArrayLike,
    gtilde: ArrayLike,
    Mtildelist: ArrayLike,
    Gtildelist: ArrayLike,
    Kp: float,
    Ki: float,
    Kd: float,
    dt: float,
    intRes: int,
) -> tuple[Float64Array, Float64Array]:
    """A run of feedback linearisation along a trajectory, in the textbook's notation.

    Law:          figure 10.13: e_int = e_int + e dt, then equation 10.21 with the model that has a tilde
    Closed loop:  e-ddot + Kd e-dot + Kp e + Ki int(e) = 0 as dt falls, with an exact model

    The arm is stepped as the library does it, by Euler: theta + h theta-dot, theta-dot + h theta-ddot with h = dt /
    intRes. So with Ki = 0 the numbers are the library's. No picture is drawn. `taut.run` does the same with sensors,
    friction, drives and contacts.

    Frames:
        The angular part comes first, in Ftipmat too, which is in the frame of the end-effector.

    Args:
        thetalist: (n,) joint variables at the start [rad | m].
        dthetalist: (n,) their rates.
        g: (3,) true gravity [m/s^2].
        Ftipmat: (N, 6) wrench of the end-effector on its environment, moment first [N m, N].
        Mlist: (n + 1, 4, 4) true link frames.
        Glist: (n, 6, 6) true spatial inertias.
        Slist: (6, n) screw axes, of the true arm and of the model.
        thetamatd: (N, n) desired joint variables, a row for each time.
        dthetamatd: (N, n) their rates.
        ddthetamatd: (N, n) their accelerations.
        gtilde: (3,) the model's gravity.
        Mtildelist: (n + 1, 4, 4) its link frames.
        Gtildelist: (n, 6, 6) its spatial inertias.
        Kp: [1/s^2].
        Ki: [1/s^3].
        Kd: [1/s].
        dt: From one row to the next [s].
        intRes: Steps of the integration in dt.

    Returns:
        (N, n) torques, and (N, n) joint variables dt after each of them.

    Raises:
        ShapeError: Lists and matrices that do not fit together.
        RangeError: Numbers that are not finite, gains below zero, a dt or intRes that is not above.
        ModelError: An inertia or a screw axis that no rigid body or joint has.
        NumericalError: A run that leaves all numbers.

    References:
        Chapter, equation 10.21 and figure 10.13.
    """
    arm, length = _arm(Mlist, Glist, Slist, g)
    try:
        model, _ = _arm(Mtildelist, Gtildelist, Slist, gtilde)
    except TautError as wrong:
        raise wrong.about("", "the model (with a tilde): ") from wrong
    n = arm.n
    q = length * finite_array("thetalist", thetalist, shape=(n,))
    v = length * finite_array("dthetalist", dthetalist, shape=(n,))
    N = len(np.atleast_1d(thetamatd))
    desired = (("thetamatd", thetamatd), ("dthetamatd", dthetamatd), ("ddthetamatd", ddthetamatd))
    wanted = [length * finite_array(name, value, shape=(N, n)) for name, value in desired]
    F_tip = finite_array("Ftipmat", Ftipmat, shape=(N, 6))
    intRes = whole_number("intRes", intRes, minimum=1, maximum=MAX_INTEGRATION_STEPS)
    h = positive_scalar("dt", dt, unit="s") / intRes
    ctrl = compile(ComputedTorqueLaw(kp=Kp, ki=Ki, kd=Kd), model, rate=1.0 / dt)
    dynamics = model_of(arm)

    def accelerations(q: Vector, v: Vector, tau: Vector, F_app: Vector) -> Vector:
        return dyn.forward_dynamics(dynamics, q, v, tau - dyn.jacobian(dynamics, q, None, "E").T @ F_app)

    accelerate = native(accelerations, q=n, v=n, tau=n, F_app=6)
    torques, angles = np.empty_like(wanted[0]), np.empty_like(wanted[0])
    for i, (q_des, v_des, a_des) in enumerate(zip(*wanted, strict=True)):
        tau = ctrl.step(q, v, JointMotion(q=q_des, v=v_des, a=a_des))
        for _ in range(intRes):
            a = accelerate(q, v, tau, np.roll(F_tip[i], 3))
            q, v = q + h * v, v + h * a
        if not (np.abs(q) < FAR).all():
            raise NumericalError(
                f"the arm is gone in row {i} of {len(torques)}: steps of {h:.3g} s are too long for these gains; "
                "make intRes larger, or dt or the gains smaller"
            )
        torques[i], angles[i] = length * tau, q / length
    return torques, angles


def _arm(Mlist: ArrayLike, Glist: ArrayLike, Slist: ArrayLike, g: ArrayLike) -> tuple[Arm, Float64Array]:
    """The arm with screw axes of unit length, and (n,) how long they were."""
    S = finite_array("Slist", Slist)
    gravity = finite_array("g", g, shape=(3,), unit="m/s^2")
    if S.ndim != 2 or S.shape[0] != 6:
        return Arm.from_screws(Mlist, Glist, S, gravity), np.ones(1)  # which says what is wrong
    turns, slides = np.linalg.norm(S[:3], axis=0), np.linalg.norm(S[3:], axis=0)
    length = np.where(turns > 0.0, turns, slides)
    length = np.where(length > 0.0, length, 1.0)
    return Arm.from_screws(Mlist, Glist, S / length, gravity), length
