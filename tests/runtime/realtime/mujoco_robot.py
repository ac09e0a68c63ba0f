"""A robot for tests: an arm in MuJoCo behind a driver, with its own load, friction and wiring."""

from __future__ import annotations

from typing import Any

import numpy as np

import taut
from taut.robots import RobotDriver, RobotInfo


class MujocoRobot(RobotDriver):
    """`address` names the arm. Uncontrolled it rests where it is, as behind brakes.

    Args:
        payload: Mass at its tool [kg].
        known: Mass that it compensates, and reports [kg].
        friction: Coulomb friction, a number or (n,) [N m].
        flipped: A joint whose torque has the wrong sign.
        takes, rate: As of RobotInfo.
        bias: (n,) error of the torque sensors [N m].
    """

    def __init__(
        self, address: str, *, payload: float = 0.0, known: float = 0.0, friction: Any = 0.0,
        flipped: int | None = None, rate: float = 1000.0, bias: Any = 0.0,
    ) -> None:  # fmt: skip
        arm = taut.load_arm(address).with_payload(payload)
        self.arm = (
            arm.with_friction(taut.Friction(coulomb=np.broadcast_to(friction, arm.n), viscous=np.full(arm.n, 0.1)))
            if np.any(friction)
            else arm
        )
        self.known, self.rate, self.bias = taut.load_arm(address).with_payload(known), rate, bias
        self.signs = np.ones(arm.n)
        if flipped is not None:
            self.signs[flipped] = -1.0
        self.controlled = False

    def open(self) -> RobotInfo:
        self.plant = taut.MujocoPlant(self.arm)
        self.plant.reset(self.arm.home, np.zeros(self.arm.n), 1.0 / self.rate, 0)
        self.last = self._g(self.arm, self.arm.home)
        x = taut.snapshot(self.arm, self.arm.home)
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = x.T().R, x.T().p
        return RobotInfo(
            name=f"simulated {self.arm.name}", n=self.arm.n, rate=self.rate, takes="torque", adds=("gravity",),
            measures=("v", "tau_meas"), load=(float(self.known.payload.mass), (0.0, 0.0, 0.0)),
            facts={"T_BE": T.tolist(), "q": self.arm.home.tolist(), "firmware": "test", "m_ee": 0.5},
        )  # fmt: skip

    def _g(self, arm: taut.Arm, q: Any) -> Any:
        return np.asarray(taut.snapshot(arm, q, 0.0 * q).g, dtype=np.float64)

    def read(self, measured: Any) -> None:
        q, v = self.plant.state()
        measured["q"][:], measured["v"][:] = q, v if self.controlled else 0.0 * v
        measured["tau_meas"][:] = (self.last if self.controlled else self._g(self.arm, q)) + self.bias

    def begin(self) -> None:
        self.plant.reset(self.plant.state()[0], np.zeros(self.arm.n), 1.0 / self.rate, 0)
        self.controlled = True

    def write(self, command: Any) -> None:
        tau = self.signs * command + self._g(self.known, self.plant.state()[0])
        self.last = self.plant.advance(tau)

    def end(self) -> None:
        self.controlled = False

    def recover(self) -> None:
        pass

    def close(self) -> None:
        pass
