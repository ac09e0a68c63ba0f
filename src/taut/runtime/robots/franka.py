"""FrankaDriver: a Franka Panda or Research 3 on the vendor's own client, by torque at 1 kHz."""

from __future__ import annotations

import importlib
import json
import re
import select
import subprocess
import sys
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from taut.base.checks import finite_array, finite_scalar
from taut.base.errors import TautError, missing_extra
from taut.base.types import Float64Array
from taut.runtime.robots.driver import DriverError, RobotDriver, RobotInfo

N: Final = 7
BESIDE_START: Final = 10.0  # [s] for the process beside the loop's, which takes 0.1 s
FIRST_ANSWER: Final = 1.0  # [s] for a robot to take a client, which takes 3 ms
MAX_TORQUE: Final = 100.0  # [N m], the largest joints take 87; a command beyond is an error
SILENCE: Final = 0.02  # [s] without commands after which it brakes: 20 in a row, by libfranka's documentation
TORQUE_RATE: Final = 1000.0  # [N m/s] beyond which it stops itself (controller_torque_discontinuity)
FUNCTIONS: Final[Mapping[str, tuple[str, ...]]] = {
    "collision": ("lower_torque", "upper_torque", "lower_force", "upper_force"),
    "grasp": ("width", "speed", "force", "epsilon_inner", "epsilon_outer"),
    "move": ("width", "speed"),
    "homing": (),
    "look": (),
    "gripper": (),
    "state": (),
}
"""What is called, with its arguments in the client's order."""
CHECKS: Final[Mapping[str, Callable[[str, Any], Any]]] = {
    "lower_torque": partial(finite_array, shape=(N,), unit="N m", above=0.0),
    "upper_torque": partial(finite_array, shape=(N,), unit="N m", above=0.0),
    "lower_force": partial(finite_array, shape=(6,), unit="N | N m", above=0.0),
    "upper_force": partial(finite_array, shape=(6,), unit="N | N m", above=0.0),
    "width": partial(finite_scalar, unit="m", minimum=0.0),
    "speed": partial(finite_scalar, unit="m/s", above=0.0),
    "force": partial(finite_scalar, unit="N", above=0.0),
    "epsilon_inner": partial(finite_scalar, unit="m", minimum=0.0),
    "epsilon_outer": partial(finite_scalar, unit="m", minimum=0.0),
}
DEFAULTS: Final[Mapping[str, float]] = {"speed": 0.05, "epsilon_inner": 0.005, "epsilon_outer": 0.005}
WRONG_MODE: Final[Mapping[str, str]] = {
    "Move": "end the other motion first",
    "Guiding": "let go of the guiding button",
    "Reflex": "it stopped by itself; recover() clears its error",
    "UserStopped": "release the user stop",
    "AutomaticErrorRecovery": "try again when it has recovered",
    "Other": "unlock its joints and activate FCI in Desk",
}
NETWORK: Final[tuple[tuple[str, str, str], ...]] = (
    ("refused", "disconnected", "nothing listens there; check the address, and activate FCI in Desk"),
    ("Host not found", "disconnected", "no such host; check the address"),
    ("UDP receive: Timeout", "silent", "it sent no state for 1 s"),
    ("", "disconnected", "the connection is lost"),
)
"""What the client says of the network: part of its text, the kind of fault, what it means."""
REMEDIES: Final = {"aborted by reflex": "free the arm, then robot.recover()", "user stop": "release the user stop"}


class FrankaDriver(RobotDriver):
    """A Franka robot: `taut.connect("franka://172.16.0.2", arm)`.

    It adds gravity, of its arm, its end effector and the load that it knows, and the friction of its motors, to every
    torque; it adds no Coriolis torques. It keeps time: `read` blocks until its next state.

    Frames: F_ext acts on the arm at the robot's end effector, in the axes of its base. The frame of a load is that of
    the end effector, which is the arm's tool.

    Functions for `robot.call`: `state`; `collision(lower_torque=, upper_torque=, lower_force=, upper_force=)` for a
    robot that rests; `grasp(width=, force=, speed=0.05)`, `move(width=, speed=0.05)`, `homing` and `look` begin at
    once, also while the arm moves, and `gripper` reports what the last one came to.

    Args:
        address: Of the robot: "172.16.0.2".
    """

    def __init__(self, address: str) -> None:
        self._address, self._who = address, f"Franka at {address}"
        self._client: Any = None  # pylibfranka
        self._robot: Any = None
        self._control: Any = None  # a motion of ours
        self._state: Any = None
        self._sent: Any = None
        self._beside: Beside | None = None

    def open(self) -> RobotInfo:
        try:
            self._client = importlib.import_module("pylibfranka")
        except ImportError as cause:
            raise missing_extra("franka://", "pylibfranka", "franka") from cause
        self._beside = Beside(self._address)
        self._beside.answer(BESIDE_START)
        self._beside.ask("arm", [])
        answer = self._beside.answer(FIRST_ANSWER)
        if answer is None:
            raise DriverError(
                f"{self._who} takes no client: another program has it, which must end first, or nothing is there",
                kind="busy",
            )
        if "error" in answer:
            raise self._error(*answer["error"])
        self._robot = self._asked(self._client.Robot, self._address, self._client.RealtimeConfig.kIgnore)
        state = self._state = self._asked(self._robot.read_once)
        self._T_FE, self._to_E = _pose(state.F_T_EE), _wrench_map(_pose(state.EE_T_K))
        com = self._T_FE[:3, :3].T @ (np.array(state.F_x_Cload) - self._T_FE[:3, 3]) * (state.m_load > 0.0)
        return RobotInfo(
            name=self._who, n=N, rate=1000.0, takes="torque", measures=("v", "tau_meas", "F_ext"),
            adds=("gravity", "friction"), paced_by="robot", silence=SILENCE, torque_rate=TORQUE_RATE,
            delay=1e-3,  # assumed, on the safe side: a command acts from the next cycle on
            load=(state.m_load, tuple(com.tolist())), facts=self._facts(),
        )  # fmt: skip

    def read(self, measured: Mapping[str, Float64Array]) -> None:
        try:
            state = self._robot.read_once() if self._control is None else self._control.readOnce()[0]
        except Exception as error:
            if type(error).__name__ == "ControlException":
                self._control = None  # the motion has ended; the client would wait without end for that again
            raise self._error(type(error).__name__, str(error)) from error
        self._state = state
        measured["q"][:] = state.q
        measured["v"][:] = state.dq
        measured["tau_meas"][:] = state.tau_J
        # The client's wrench is that of the robot on its environment. K_F_ext_hat_K has a stated point and axes; the
        # moment of O_F_ext_hat_K, so users measured, is about the base.
        R_BE_transposed = np.array(state.O_T_EE).reshape(4, 4)[:3, :3]  # the client's matrices lie by columns
        measured["F_ext"][:] = -((self._to_E @ state.K_F_ext_hat_K).reshape(2, 3) @ R_BE_transposed).ravel()

    def begin(self) -> None:
        self._state = self._asked(self._robot.read_once)
        mode = self._state.robot_mode.name
        if mode != "Idle":
            raise DriverError(f"{self._who} is in the mode {mode}: {WRONG_MODE[mode]}", kind="rejected")
        self._sent = self._client.Torques([0.0] * N)
        self._control = self._asked(self._robot.start_torque_control)

    def write(self, command: Float64Array) -> None:
        joint = int(np.abs(command).argmax())  # that of a NaN, where there is one
        if not abs(command[joint]) <= MAX_TORQUE:
            raise DriverError(f"the torque of joint {joint + 1} is {command[joint]}: not sent", kind="rejected")
        torques = self._client.Torques(command)
        try:
            self._control.writeOnce(torques)
        except Exception as error:
            raise self._error(type(error).__name__, str(error)) from error
        self._sent = torques

    def end(self) -> None:
        control, self._control = self._control, None
        if control is not None:
            self._sent.motion_finished = True  # the torque that acts: a jump of more than 1 N m is a fault of its own
            try:
                control.writeOnce(self._sent)
            except Exception:
                self._asked(self._robot.stop)

    def recover(self) -> None:
        self._state = self._asked(self._robot.read_once)
        if self._state.robot_mode.name != "Idle" or self._state.current_errors:
            self._asked(self._robot.automatic_error_recovery)

    def set_load(self, mass: float, com: Float64Array, inertia: Float64Array) -> None:
        self._require_rest("set_load")
        R, p = self._T_FE[:3, :3], self._T_FE[:3, 3]
        self._asked(self._robot.set_load, mass, (R @ com + p).tolist(), (R @ inertia @ R.T).ravel().tolist())

    def call(self, name: str, arguments: Mapping[str, Any]) -> Any:
        assert self._beside is not None
        if name not in FUNCTIONS:
            return super().call(name, arguments)
        values = _checked(name, arguments)
        if name == "state":
            self._state = self._state if self._control is not None else self._asked(self._robot.read_once)
            return self._facts()
        if name == "gripper":
            found = self._beside.look()
            return found | {"error": str(self._error(*found["error"]))} if found.get("error") else found
        if name == "collision":
            self._require_rest(name)
            return self._asked(self._robot.set_collision_behavior, *values)
        if self._beside.look()["busy"]:
            raise DriverError(f"the gripper is busy; call {name} when that has ended", kind="rejected")
        return self._beside.ask(name, values)

    def close(self) -> None:
        try:
            self.end()
        finally:
            self._robot = None
            if self._beside is not None:
                self._beside.close()

    def _asked(self, function: Any, *arguments: Any) -> Any:
        """What a function of the client returns; its error in our words."""
        try:
            return function(*arguments)
        except Exception as error:
            raise self._error(type(error).__name__, str(error)) from error

    def _error(self, kind: str, text: str) -> DriverError:
        """An error of the client, from the name of its class and its text."""
        text = re.sub(r"^libfranka( robot)?: ", "", text.partition("\n")[0])
        versions = re.search(r"server version: (\d+), library version: (\d+)", text)
        flags = re.search(r"\[(.*)\]", text)
        if versions:
            words = f"version {versions[1]} of the interface, and pylibfranka speaks {versions[2]}"
            found = f"{self._who} speaks {words}; install the pylibfranka that fits its system", "rejected"
        elif kind == "NetworkException" or text == "Net Exception":
            fault, words = next(row[1:] for row in NETWORK if row[0] in text)
            found = f"{self._who}: {words} ({text})", fault
        elif flags:
            named = flags[1].replace('"', "")
            cause = f": {named}" if named else " and named no cause; release the user stop if it is pressed"
            found = f"{self._who} stopped by itself{cause}", "robot_error"
        else:
            remedy = "".join(f"; {words}" for part, words in REMEDIES.items() if part in text.lower())
            found = f"{self._who}: {text}{remedy}", "robot_error" if kind == "ControlException" else "rejected"
        return DriverError(found[0], kind=found[1])

    def _require_rest(self, name: str) -> None:
        if self._control is not None:
            raise DriverError(f"{name} is for a robot that rests: robot.stop() first", kind="rejected")

    def _facts(self) -> dict[str, Any]:
        """The newest state, for bring-up: plain values."""
        state = self._state
        real_time = Path("/sys/kernel/realtime").exists()
        return {
            "mode": state.robot_mode.name,
            "errors": str(state.current_errors) if state.current_errors else "",
            "success_rate": state.control_command_success_rate,  # of the last 100 commands; 0 outside control
            "q": list(state.q),
            "T_BE": _pose(state.O_T_EE).ravel().tolist(),  # base to end effector, by rows
            "F_T_EE": self._T_FE.ravel().tolist(),
            "NE_T_EE": _pose(state.NE_T_EE).ravel().tolist(),
            "m_ee": state.m_ee,  # [kg] of the end effector, whose gravity it adds too
            "F_x_Cee": list(state.F_x_Cee),
            "tau_ext": list(state.tau_ext_hat_filtered),
            "notes": () if real_time else ("the kernel is not a real-time one: periods may be late",),
        }


class Beside:
    """The process beside the loop's; it does one thing at a time."""

    def __init__(self, address: str) -> None:
        script = str(Path(__file__).with_name("franka_beside.py"))
        self._process = subprocess.Popen(
            [sys.executable, script, address], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self._doing, self._last = "", dict[str, Any]()

    def ask(self, name: str, arguments: list[Any]) -> None:
        """Begin something."""
        assert self._process.stdin is not None
        self._doing = name
        print(json.dumps([name, arguments]), file=self._process.stdin, flush=True)

    def answer(self, within: float) -> dict[str, Any] | None:
        """What it came to, if it ends in time [s]."""
        out = self._process.stdout
        assert out is not None
        if not select.select([out], [], [], within)[0]:
            return None
        line = out.readline()
        self._doing = ""
        return dict(json.loads(line)) if line else {"error": ["NetworkException", "the client died"]}

    def look(self) -> dict[str, Any]:
        """Whether the gripper is busy, and what its last function came to."""
        answer = self.answer(0.0) if self._doing else None
        if answer is not None:
            self._last = {"error": None, **answer}
        return {**self._last, "busy": bool(self._doing)}

    def close(self) -> None:
        """End it."""
        self._process.kill()
        self._process.communicate()


def _checked(name: str, arguments: Mapping[str, Any]) -> list[Any]:
    """Arguments of a function in the client's order; DriverError names one that is missing, unknown or wrong."""
    given, names = {**DEFAULTS, **arguments}, FUNCTIONS[name]
    wrong = [f"{one} is missing" for one in names if one not in given]
    wrong += [f"{one} is unknown" for one in arguments if one not in names]
    if wrong:
        raise DriverError(f"{name} takes {', '.join(names) or 'nothing'}; {', '.join(wrong)}", kind="rejected")
    try:
        values = [CHECKS[one](one, given[one]) for one in names]
    except TautError as cause:
        raise DriverError(str(cause), kind="rejected") from cause
    if name == "collision":
        for k in (0, 2):
            low, high = values[k : k + 2]
            i = int(np.argmax(low - high))
            if low[i] > high[i]:
                rule = f"{names[k]}[{i}] must be <= {names[k + 1]}[{i}], {high[i]:g}"
                raise DriverError(f"{rule}; got {low[i]:g}", kind="rejected")
    return values


def _pose(columns: list[float]) -> Float64Array:
    """(4, 4) pose from the client's 16 numbers."""
    return np.array(columns).reshape(4, 4).T


def _wrench_map(T: Float64Array) -> Float64Array:
    """(6, 6): a wrench at the inner frame's origin in its axes, force first, becomes that of the outer frame."""
    R, (x, y, z) = T[:3, :3], T[:3, 3]
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.block([[R, np.zeros((3, 3))], [cross @ R, R]])
