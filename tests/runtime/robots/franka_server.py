"""A Franka for tests: franky-sim with the vendor's losses, reflexes, wrench and modes, in a process of its own.

    python franka_server.py HOSTNAME SECONDS

It speaks the vendor's protocol on HOSTNAME, a loopback address, and ends by itself after SECONDS or when its input
ends. Orders are lines of JSON on its input, such as ["push", 10, 0, 0, 0, 0, 0]; events are lines of JSON on its
output, with CLOCK_MONOTONIC.

What it does that franky-sim does not, as libfranka's documentation states it:

* one step in each millisecond of an absolute clock
* K_F_ext_hat_K and O_F_ext_hat_K of pushes and of a table, positive where the robot acts on its environment
* 20 commands missed in a row, also of a client that died: communication_constraints_violation
* a torque that changes by more than 1000 N m/s: controller_torque_discontinuity
* forces above the collision thresholds: cartesian_reflex
* each of them ends the motion: it brakes, Move is answered by kReflexAborted, the mode is Reflex, and further motions
  are rejected until automatic error recovery; up to then the last torque acts
* the user stop in motion: it brakes, and Move is answered by kEmergencyAborted
* other modes, another version of the interface, states that are not sent
"""

from __future__ import annotations

import contextlib
import gc
import json
import os
import socket
import struct
import sys
import time
import xml.etree.ElementTree as ET
from collections import deque
from typing import Any

import mujoco
import numpy as np
from franky_sim.franka_robot_protocol import (
    AutomaticErrorRecoveryCommand,
    AutomaticErrorRecoveryStatus,
    BaseCommand,
    MoveCommand,
    MoveStatus,
    RobotCommand,
    RobotMode,
    SetCollisionBehaviorCommand,
    StateControllerMode,
    StateMotionGeneratorMode,
    UDPCommand,
)
from franky_sim.franka_robot_server import FrankaRobotServer
from franky_sim.franka_server import (
    Command,
    ConnectCommand,
    ConnectStatus,
    FrankaServer,
    MessageHeader,
    NonBlockingReceiver,
)
from franky_sim.mujoco_simulator import MujocoSimulator

MOST_MISSED = 20  # commands in a row
MOST_RATE = 1000.0  # [N m/s]
TOOL = 0.1034  # [m] from the hand's frame
AT_REST = 0.02  # [rad/s] below which it holds
FLAGS = {
    "force_control_safety_violation": 5,
    "cartesian_reflex": 7,
    "communication_constraints_violation": 25,
    "controller_torque_discontinuity": 32,
}  # of the 41 of a state
TOUCH = {  # of a table and of a tip at the end effector, which touch nothing else; the force grows smoothly
    "contype": "2", "conaffinity": "2", "friction": "0.1 0.005 0.0001", "priority": "1",
    "solref": "0.005 1", "solimp": "0 0.9 0.002 0.5 1",
}  # fmt: skip
HOME = (0.0, -np.pi / 4, 0.0, -3 * np.pi / 4, 0.0, np.pi / 2, np.pi / 4)


def say(event: str, **data: Any) -> None:
    print(json.dumps({"event": event, "time": time.monotonic(), **data}), flush=True)


class Server(FrankaRobotServer):
    """The arm on its port 1337, and its gripper on 1338."""

    def __init__(self, simulator: MujocoSimulator, hostname: str) -> None:
        self.arm = simulator.add_robot(initial_q=HOME)
        self.simulator = simulator
        hand = next(body for body in simulator.worldbody.iter("body") if body.get("name") == "robot0_hand")
        tip = {"name": "tip", "type": "sphere", "size": "0.01", "pos": f"0 0 {TOOL - 0.01}", "mass": "0"}
        table = ET.SubElement(simulator.worldbody, "body", name="table", mocap="true", pos="0.5 0 -1")
        for parent, geom in ((hand, tip), (table, {"name": "table", "type": "box", "size": "0.3 0.5 0.05"})):
            ET.SubElement(parent, "geom", **geom, **TOUCH)
        self.error: str | None = None  # for which it stopped
        self.mode: RobotMode | None = None  # that is reported whatever it does
        self.version: int | None = None
        self.missed = 0  # commands in a row
        self.worst = 0  # of them in a motion
        self.slowest = 0.0  # [s] between two states since it was last asked
        self.answered: deque[bool] = deque([True] * 100, maxlen=100)
        self.torque = np.zeros(7)  # the last one commanded
        self.orphan = False  # the client of a motion is gone
        self.braking = False
        self.unsent = 0  # states that are not sent
        self.thresholds: tuple[np.ndarray, np.ndarray] | None = None  # upper ones of torque and force
        self.push = np.zeros(6)  # on the robot, at its end effector, in the axes of its base
        self.wrench = np.zeros(6)  # of the robot on its environment, likewise
        # A stiffness frame that is not the end effector's, rotated and 0.05 m away.
        self.arm.EE_T_K = (0.0, 1.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.03, 0.0, 0.04, 1.0)
        super().__init__(self.arm, [hostname])

    def begin(self) -> None:
        self.init()
        self.simulator.start()
        model = self.simulator.model
        self.hand, self.table = model.body("robot0_hand").id, model.geom("table").id

    @property
    def moving(self) -> bool:
        return self.orphan or self.current_motion_id > 0

    # What goes wrong.

    def brake(self, status: MoveStatus) -> None:
        self.braking, self.orphan = True, False
        if self.current_motion_id and self.tcp_connected:
            BaseCommand.send_response(self._tcp_socket, RobotCommand.kMove, self.current_motion_id, status)
        self.stop_motion(send_preemption_signal=False)
        self.reset_current_motion_id()

    def stop_with(self, error: str) -> None:
        self.error = error
        self.brake(MoveStatus.kReflexAborted)
        say("stopped", error=error, missed=self.missed, torque=self.torque.tolist(), q=list(self.arm.inner_state.q))

    def _reset_state(self) -> None:
        if self.current_motion_id:
            self.orphan = True
            say("client_lost")
        super()._reset_state()

    # Commands.

    def start_motion(self, *given: Any) -> None:
        self.missed = self.worst = 0
        self.torque[:] = 0.0
        super().start_motion(*given)

    def _handle_udp_command(self, data: bytes) -> None:
        command = UDPCommand.from_bytes(data)
        if self.moving and self.error is None and command.message_id > 0:
            self.worst, self.missed = max(self.worst, self.missed), 0
            change = np.abs(np.array(command.tau_J_d) - self.torque).max()
            self.torque[:] = command.tau_J_d
            if change > 1.001e-3 * MOST_RATE:
                self.stop_with("controller_torque_discontinuity")
                return
        super()._handle_udp_command(data)

    def _post_process_commands(self) -> None:
        if self.moving and self.error is None:
            self.answered.append(self.missed == 0)
            self.missed += 1
            if self.missed > MOST_MISSED:
                self.stop_with("communication_constraints_violation")
            elif self.thresholds is not None and np.any(np.abs(self.wrench) > self.thresholds[1]):
                self.stop_with("cartesian_reflex")
        if self.orphan:
            self.arm.torque_control(self.torque)
        elif self.braking:
            self.braking = bool(np.abs(self.arm.inner_state.dq).max() > AT_REST)
            self.arm.joint_velocity_control(np.zeros(7))
            if not self.braking:
                self.stop_motion(send_preemption_signal=False)  # holds here
        else:
            super()._post_process_commands()

    # States.

    @property
    def robot_state(self) -> Any:
        state = super().robot_state
        new: dict[str, Any] = {"control_command_success_rate": sum(self.answered) / 100.0 if self.moving else 0.0}
        if self.wrench.any():
            T, K = np.array(state.O_T_EE).reshape(4, 4).T, np.array(state.EE_T_K).reshape(4, 4).T
            R = T[:3, :3] @ K[:3, :3]
            f, m = self.wrench[:3], self.wrench[3:]
            at_K = m - np.cross(T[:3, :3] @ K[:3, 3], f)
            new["K_F_ext_hat_K"] = (*(R.T @ f), *(R.T @ at_K))
            new["O_F_ext_hat_K"] = (*f, *(m + np.cross(T[:3, 3], f)))  # about the base, as measured on robots
        if self.error is not None:
            flags = tuple(i == FLAGS[self.error] for i in range(41))
            new |= {"robot_mode": RobotMode.kReflex, "errors": flags, "reflex_reason": flags}
        elif self.mode is not None:
            new["robot_mode"] = self.mode
        if self.error is not None or self.braking:
            new |= {
                "controller_mode": StateControllerMode.kOther,
                "motion_generator_mode": StateMotionGeneratorMode.kIdle,
            }
        for name, value in new.items():
            object.__setattr__(state, name, value)  # it is new, and replace() would take 50 us
        return state

    def send_state(self) -> None:
        if self.unsent > 0:
            self.unsent -= 1
            return
        super().send_state()

    # The environment.

    def touch(self) -> None:
        """Apply the push, and sum up what the robot does to its environment."""
        model, data = self.simulator.model, self.simulator.data
        body, table = self.hand, self.table
        if self.push.any() or data.xfrc_applied[body].any():
            data.xfrc_applied[body, :3] = self.push[:3]
            data.xfrc_applied[body, 3:] = self.push[3:] + np.cross(self.tool - data.xipos[body], self.push[:3])
        self.wrench = -self.push
        force = np.zeros(6)
        for i in range(data.ncon):
            contact = data.contact[i]
            if table not in contact.geom:
                continue
            mujoco.mj_contactForce(model, data, i, force)
            f = contact.frame.reshape(3, 3).T @ force[:3]  # on the second geom
            f = f if contact.geom[1] == table else -f  # on the table
            self.wrench[:3] += f
            self.wrench[3:] += np.cross(contact.pos - self.tool, f)

    @property
    def tool(self) -> Any:
        """(3,) where the end effector is."""
        data = self.simulator.data
        return data.xpos[self.hand] + TOOL * data.xmat[self.hand][2::3]

    def carry(self, mass: float, x: float, y: float, z: float) -> None:
        """Fix a point mass to the flange, in its frame."""
        model = self.simulator.model
        body = self.hand
        c, s = np.cos(np.pi / 4), np.sin(np.pi / 4)  # the hand is rotated by -45 degrees about the flange
        at = np.array([c * x - s * y, s * x + c * y, z])
        old, com = model.body_mass[body], model.body_ipos[body].copy()
        model.body_mass[body] = old + mass
        model.body_ipos[body] = (old * com + mass * at) / (old + mass)
        mujoco.mj_setConst(model, mujoco.MjData(model))

    def order(self, name: str, *given: Any) -> None:
        if name == "push":
            self.push[:] = given
        elif name == "stop":
            self.stop_with(*given)
        elif name == "gap":
            self.unsent = given[0]
        elif name == "thresholds":
            self.thresholds = None
        elif name == "mode":
            self.mode = RobotMode[given[0]] if given[0] else None
            if self.mode is RobotMode.kUserStopped and self.moving:
                self.brake(MoveStatus.kEmergencyAborted)
        elif name == "version":
            self.version = given[0]
        elif name == "carry":
            self.carry(*given)
        elif name == "table":  # the height of its surface
            self.simulator.data.mocap_pos[0, 2] = given[0] - 0.05
        elif name == "pause":  # it, with its clock
            time.sleep(given[0])
        elif name == "look":
            state = self.arm.inner_state
            slowest, self.slowest = self.slowest, 0.0
            say("state", slowest=slowest, q=list(state.q), v=list(state.dq), p=self.tool.tolist(), wrench=self.wrench.tolist(),
                torque=self.torque.tolist(), moving=self.moving, error=self.error, worst=self.worst,
                thresholds=None if self.thresholds is None else [x.tolist() for x in self.thresholds],
                load=[self.arm.m_load, *self.arm.F_x_Cload])  # fmt: skip


def connect(command: Any, server: Server, command_type_struct: str = "I") -> None:
    version = getattr(server, "version", None)
    if version is None:
        return ORIGINAL_CONNECT(command, server, command_type_struct)
    header = MessageHeader(Command.kConnect, command.command_id, 8).to_bytes(command_type_struct=command_type_struct)
    command.client_socket.sendall(header + struct.pack("<BH5x", ConnectStatus.kIncompatibleLibraryVersion, version))
    return None


def set_up_udp(server: Any, port: int) -> None:
    """As franky-sim's, which listens on every interface: on the server's address alone."""
    ORIGINAL_UDP(server, port)
    server._FrankaServer__udp_socket.close()
    udp = server._FrankaServer__udp_socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    udp.bind((server.hostname, 0))
    udp.setblocking(False)
    server._FrankaServer__udp_receiver = NonBlockingReceiver(udp)


def move(command: Any, server: Server) -> None:
    if server.error is not None or server.mode is not None:
        command.reply(MoveStatus.kCommandNotPossibleRejected)
    else:
        ORIGINAL_MOVE(command, server)


def recover(command: Any, server: Server) -> None:
    if server.mode is RobotMode.kUserStopped:
        command.reply(AutomaticErrorRecoveryStatus.kCommandNotPossibleRejected)
        return
    server.error = None
    command.reply(AutomaticErrorRecoveryStatus.kSuccess)


def set_thresholds(command: Any, server: Server) -> None:
    server.thresholds = (
        np.array(command.upper_torque_thresholds_nominal),
        np.array(command.upper_force_thresholds_nominal),
    )
    command.reply(0)


ORIGINAL_CONNECT, ORIGINAL_MOVE = ConnectCommand.handle, MoveCommand.handle
ORIGINAL_UDP, FrankaServer._setup_udp_connection = FrankaServer._setup_udp_connection, set_up_udp
ConnectCommand.handle, MoveCommand.handle = connect, move
AutomaticErrorRecoveryCommand.handle, SetCollisionBehaviorCommand.handle = recover, set_thresholds


def main(hostname: str, seconds: float) -> None:
    with contextlib.suppress(OSError, AttributeError):  # where it is allowed; below the loop's process
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(70))
    gc.disable()
    with MujocoSimulator() as simulator:
        server = Server(simulator, hostname)
        server.begin()
        say("ready")
        start = deadline = last = time.monotonic()
        orders = b""
        os.set_blocking(0, False)
        while time.monotonic() - start < seconds:
            with contextlib.suppress(BlockingIOError):
                data = os.read(0, 4096)
                if not data:
                    break
                *lines, orders = (orders + data).split(b"\n")
                for line in lines:
                    server.order(*json.loads(line))
            server.process_commands()
            server.touch()
            simulator.step()
            server.send_state()
            now = time.monotonic()
            server.slowest, last = max(server.slowest, now - last), now
            deadline += 1e-3
            late = now - deadline
            if late < 0.0:
                time.sleep(-late)
            else:  # a step took too long: what is lost is lost
                deadline += late
        server.cleanup()


if __name__ == "__main__":
    main(sys.argv[1], float(sys.argv[2]))
