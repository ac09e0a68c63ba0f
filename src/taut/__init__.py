"""taut: control laws for robot arms, written once and run everywhere.

Everything public is here: `taut.load_arm`, `taut.laws`, `taut.compile`, ... Names are loaded when first used, so that
`import taut` is quick.
"""

from __future__ import annotations

from taut.base import __version__ as __version__
from taut.base.front_door import lazy_names

TYPE_CHECKING = False  # type checkers know it by its name; to load typing would take as long as all of this
if TYPE_CHECKING:
    from taut import analysis as analysis
    from taut import drives as drives
    from taut import dynamics as dynamics
    from taut import environments as environments
    from taut import errors as errors
    from taut import guards as guards
    from taut import gym as gym
    from taut import laws as laws
    from taut import math as math
    from taut import robots as robots
    from taut import sensors as sensors
    from taut import tensors as tensors
    from taut import textbook as textbook
    from taut import trajectories as trajectories
    from taut.analysis.design.design import design as design
    from taut.analysis.diagnosis.diagnosis import doctor as doctor
    from taut.analysis.sweeps.distributions import choice as choice
    from taut.analysis.sweeps.distributions import log_uniform as log_uniform
    from taut.analysis.sweeps.distributions import normal as normal
    from taut.analysis.sweeps.distributions import uniform as uniform
    from taut.analysis.sweeps.sweep import sweep as sweep
    from taut.analysis.tuning import tune as tune
    from taut.arm.description import Arm as Arm
    from taut.arm.description import Friction as Friction
    from taut.arm.description import Payload as Payload
    from taut.arm.load import load_arm as load_arm
    from taut.arm.servo import Servo as Servo
    from taut.arm.servo import load_servo as load_servo
    from taut.base.errors import StabilityWarning as StabilityWarning
    from taut.base.errors import TautError as TautError
    from taut.codegen.inverse_kinematics import IkResult as IkResult
    from taut.codegen.inverse_kinematics import inverse_kinematics as inverse_kinematics
    from taut.codegen.kernel import native as native
    from taut.codegen.program import to_casadi as to_casadi
    from taut.control.combine import SideBySide as SideBySide
    from taut.control.command import Position as Position
    from taut.control.command import Terms as Terms
    from taut.control.command import Torque as Torque
    from taut.control.command import Velocity as Velocity
    from taut.control.gains import Gain as Gain
    from taut.control.gains import Memory as Memory
    from taut.control.law import Law as Law
    from taut.control.laws.task_error import Coordinates as Coordinates
    from taut.control.laws.via_joint_space import via_joint_space as via_joint_space
    from taut.control.limits import Limits as Limits
    from taut.control.safety import SafetyLimits as SafetyLimits
    from taut.control.sensing import Sensing as Sensing
    from taut.control.tasks.phase import Phase as Phase
    from taut.control.trajectories.compound import together as together
    from taut.control.trajectories.force_reference import TaskForce as TaskForce
    from taut.control.trajectories.force_reference import pressing as pressing
    from taut.control.trajectories.reference import JointMotion as JointMotion
    from taut.control.trajectories.reference import hold as hold
    from taut.control.trajectories.reference import stream as stream
    from taut.control.trajectories.samples import chunk as chunk
    from taut.control.trajectories.task_reference import TaskMotion as TaskMotion
    from taut.controller.compile import compile as compile
    from taut.controller.controller import Controller as Controller
    from taut.controller.export_c import export_c as export_c
    from taut.linear.joint_loop import error_dynamics as error_dynamics
    from taut.linear.linear_system import LinearSystem as LinearSystem
    from taut.linear.linearise import linearise as linearise
    from taut.loop import Loop as Loop
    from taut.maths.constraints.constraint import Constraint as Constraint
    from taut.maths.snapshot import Snapshot as Snapshot
    from taut.maths.snapshot import snapshot as snapshot
    from taut.plant.contact import RigidContact as RigidContact
    from taut.plant.rigid import RigidPlant as RigidPlant
    from taut.record.info import Outcome as Outcome
    from taut.record.log.reading import load_run as load_run
    from taut.record.metrics import Metrics as Metrics
    from taut.record.report import report as report
    from taut.record.run import Run as Run
    from taut.runtime.events import Event as Event
    from taut.runtime.host import PlantBase as PlantBase
    from taut.runtime.realtime.connect import connect as connect
    from taut.runtime.robots.mujoco.plant import MujocoPlant as MujocoPlant
    from taut.runtime.simulate import run as run
    from taut.scenarios.compare import compare as compare
    from taut.trace.pose import Pose as Pose

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
