"""The control function of the textbook's library, by its name, signature and order of six-vectors.

For code that uses the library `modern_robotics`: change the import to `taut.textbook`. The integral is that of
equation 10.21, where the library's has no time step.

References:
    Lynch and Park, Modern Robotics (2017), sections 8.9 and 11.4; chapter, equation 10.21 and figure 10.13.
"""

from __future__ import annotations

import numpy as np

from taut.arm.description import Arm
from taut.base.checks import finite_array, finite_scalar
from taut.base.types import ArrayLike, Float64Array
from taut.control.laws.joint import ComputedTorque as ComputedTorqueLaw
from taut.control.trajectories.reference import JointMotion
from taut.controller import compile

__all__ = ["ComputedTorque"]


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
    desired = (("thetalistd", thetalistd), ("dthetalistd", dthetalistd), ("ddthetalistd", ddthetalistd))
    q_des, v_des, a_des = (length * finite_array(name, value, shape=(n,)) for name, value in desired)
    Ki = finite_scalar("Ki", Ki, minimum=0.0)
    ctrl = compile(ComputedTorqueLaw(kp=Kp, kd=Kd), arm, engine="float")  # the integral is given
    tau: Float64Array = length * ctrl.step(q, v, JointMotion(q=q_des, v=v_des, a=a_des + Ki * e_int))
    return tau


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
