"""Laws that feed back what a momentum observer estimates: rejection of a disturbance, and reflex in a collision."""

from __future__ import annotations

from typing import ClassVar

from taut.control.command import Command, Torque
from taut.control.gains import Gain
from taut.control.law import Law
from taut.control.trajectories.reference import JointMotion
from taut.maths.snapshot import Snapshot


class DisturbanceRejection(Law):
    """Disturbance observer: takes out what a momentum observer estimates; add it to a law that follows a motion.

    Law:          tau = -x.tau_ext, with sensing=taut.Sensing(observer=taut.sensors.MomentumObserver(bandwidth=K_O))
    Closed loop:  that of the law it is added to, with d - r in place of a disturbance d, r' = K_O (d - r): a constant
                  d leaves no error, one that changes leaves |d - r| <= max |d'| / K_O
                  one joint under computed torque: the PID of gains kp + K_O kd, kd + K_O, ki = K_O kp
                  with a model M^ of an arm M the observer's pole is K_O M^/M; sampled, stable while
                  K_O T max eig(M^ M^-1) < 2 approximately: keep it <= 0.5

    It does not wind up: the observer is given the torque after limits. It pushes against contact.

    References:
        Ohnishi, Shibata and Murakami, Motion control for advanced mechatronics, IEEE/ASME Transactions on
        Mechatronics 1 (1996). De Luca and Mattone (2003), the momentum form. Section 10.6 other topics.
    """

    ignores_reference: ClassVar[bool] = True

    def command(self, x: Snapshot, ref: JointMotion) -> Command:  # noqa: ARG002
        return Torque(disturbance=-x.tau_ext)


class CollisionReflex(Law):
    """Reflex after a collision: torque along the estimated contact, so that the arm flees it; add gravity to it.

    Law:          tau = gain x.tau_ext, as in GravityCompensation() + CollisionReflex()
    Closed loop:  M a + C v = tau_ext + gain r: below the observer's bandwidth contact finds an arm whose inertia is
                  divided by 1 + gain

    Nothing stops the arm once it is free, so damping or a stop must follow. Keep K_O T <= 0.5.

    Args:
        gain: Torque per estimated torque.

    References:
        De Luca, Albu-Schaeffer, Haddadin and Hirzinger, Collision detection and safe reaction with the DLR-III
        lightweight manipulator arm, IROS (2006), section IV.
    """

    ignores_reference: ClassVar[bool] = True
    gain: Gain = Gain(1.0, unit="1")

    def command(self, x: Snapshot, ref: JointMotion) -> Command:  # noqa: ARG002
        return Torque(reflex=self.gain @ x.tau_ext)
