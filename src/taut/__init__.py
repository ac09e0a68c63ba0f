"""taut: control laws for robot arms, written once and run everywhere.

Everything public hangs here: `taut.load_arm`, `taut.laws`, `taut.compile`, `taut.run`, ... Names are loaded when
first used, so that `import taut` is quick.
"""

from __future__ import annotations

import importlib
import importlib.machinery
import os
import sys
import warnings

__version__ = "0.1.0"

TYPE_CHECKING = False  # type checkers know it by its name; to load typing would take as long as all of this
if TYPE_CHECKING:
    from taut.apps import textbook as textbook
    from taut.apps.compare import compare as compare
    from taut.apps.compare import grade as grade
    from taut.arm.description import Arm as Arm
    from taut.arm.description import Friction as Friction
    from taut.arm.description import Payload as Payload
    from taut.arm.gears import matched_ratio as matched_ratio
    from taut.arm.gears import reflected_inertia as reflected_inertia
    from taut.arm.load import load_arm as load_arm
    from taut.arm.servo import Servo as Servo
    from taut.arm.servo_file import load_servo as load_servo
    from taut.arm.write_friction import JointWords as JointWords
    from taut.arm.write_friction import to_mjcf_joints as to_mjcf_joints
    from taut.arm.write_friction import to_urdf_dynamics as to_urdf_dynamics
    from taut.base import math as math
    from taut.base.errors import FileError as FileError
    from taut.base.errors import MatchError as MatchError
    from taut.base.errors import MissingExtraError as MissingExtraError
    from taut.base.errors import ModelError as ModelError
    from taut.base.errors import NumericalError as NumericalError
    from taut.base.errors import RangeError as RangeError
    from taut.base.errors import ScenarioError as ScenarioError
    from taut.base.errors import ShapeError as ShapeError
    from taut.base.errors import StabilityWarning as StabilityWarning
    from taut.base.errors import TautError as TautError
    from taut.base.errors import TraceError as TraceError
    from taut.base.errors import UnknownNameError as UnknownNameError
    from taut.base.errors import UsageError as UsageError
    from taut.base.pose import Pose as Pose
    from taut.codegen.casadi import from_casadi as from_casadi
    from taut.codegen.casadi import to_casadi as to_casadi
    from taut.codegen.function import native as native
    from taut.codegen.inverse_kinematics import IkResult as IkResult
    from taut.codegen.inverse_kinematics import inverse_kinematics as inverse_kinematics
    from taut.control import laws as laws
    from taut.control.command import Position as Position
    from taut.control.command import Terms as Terms
    from taut.control.command import Torque as Torque
    from taut.control.command import Velocity as Velocity
    from taut.control.filters import LowPass as LowPass
    from taut.control.filters import Notch as Notch
    from taut.control.gains import Gain as Gain
    from taut.control.gains import Memory as Memory
    from taut.control.guards import Lasting as Lasting
    from taut.control.guards import contact as contact
    from taut.control.guards import lasting as lasting
    from taut.control.guards import moved as moved
    from taut.control.guards import no_contact as no_contact
    from taut.control.guards import reached as reached
    from taut.control.guards import settled as settled
    from taut.control.hybrid_motion import HybridMotion as HybridMotion
    from taut.control.hybrid_motion import pressing as pressing
    from taut.control.law import Law as Law
    from taut.control.limits import Limits as Limits
    from taut.control.phase import Phase as Phase
    from taut.control.reference import JointMotion as JointMotion
    from taut.control.reference import chunk as chunk
    from taut.control.reference import hold as hold
    from taut.control.reference import stream as stream
    from taut.control.sensing import Sensing as Sensing
    from taut.control.side_by_side import SideBySide as SideBySide
    from taut.control.side_by_side import together as together
    from taut.control.steady import Steady as Steady
    from taut.control.task_error import Coordinates as Coordinates
    from taut.control.task_force import TaskForce as TaskForce
    from taut.control.task_reference import TaskMotion as TaskMotion
    from taut.control.task_samples import TaskSamples as TaskSamples
    from taut.control.task_trajectory import Circle as Circle
    from taut.control.task_trajectory import Line as Line
    from taut.control.task_trajectory import Screw as Screw
    from taut.control.trajectory import Cubic as Cubic
    from taut.control.trajectory import JerkLimited as JerkLimited
    from taut.control.trajectory import Quintic as Quintic
    from taut.control.trajectory import Samples as Samples
    from taut.control.trajectory import Sine as Sine
    from taut.control.trajectory import Spline as Spline
    from taut.control.trajectory import Trapezoidal as Trapezoidal
    from taut.control.velocity import Difference as Difference
    from taut.control.velocity import Kalman as Kalman
    from taut.control.via_joint_space import via_joint_space as via_joint_space
    from taut.control.wrist import Wrist as Wrist
    from taut.controller import Controller as Controller
    from taut.controller import compile as compile
    from taut.loop import Loop as Loop
    from taut.maths import dynamics as dynamics
    from taut.maths.constraint import Constraint as Constraint
    from taut.maths.constraint_rows import ConstraintRows as ConstraintRows
    from taut.maths.gearing import rotor_share as rotor_share
    from taut.maths.ik import IkOutcome as IkOutcome
    from taut.maths.onto import onto as onto
    from taut.maths.snapshot import Snapshot as Snapshot
    from taut.maths.snapshot import snapshot as snapshot
    from taut.plant.actuation import Actuation as Actuation
    from taut.plant.actuation import Ripple as Ripple
    from taut.plant.contact import RigidContact as RigidContact
    from taut.plant.environment import Environment as Environment
    from taut.plant.environment import Environments as Environments
    from taut.plant.environment_held import Hand as Hand
    from taut.plant.environment_held import Handle as Handle
    from taut.plant.environment_push import Push as Push
    from taut.plant.environment_springs import Damper as Damper
    from taut.plant.environment_springs import Spring as Spring
    from taut.plant.environment_wall import StiffWall as StiffWall
    from taut.plant.environment_will import BandNoise as BandNoise
    from taut.plant.environment_will import Oscillation as Oscillation
    from taut.plant.joint_sensors import Encoder as Encoder
    from taut.plant.joint_sensors import Tachometer as Tachometer
    from taut.plant.joint_sensors import TorqueSensor as TorqueSensor
    from taut.plant.motor import ElectricMotor as ElectricMotor
    from taut.plant.motor import Motor as Motor
    from taut.plant.motor import TorqueLoop as TorqueLoop
    from taut.plant.rigid import RigidPlant as RigidPlant
    from taut.plant.sensors import Sensors as Sensors
    from taut.plant.tool_sensors import Accelerometer as Accelerometer
    from taut.plant.tool_sensors import WrenchSensor as WrenchSensor
    from taut.plant.transmission import Transmission as Transmission
    from taut.record.friction_curves import plot_friction as plot_friction
    from taut.record.metrics import Metrics as Metrics
    from taut.record.outcome import Outcome as Outcome
    from taut.record.read_log import load_run as load_run
    from taut.record.report import report as report
    from taut.record.run import Run as Run
    from taut.runtime.drivers.mujoco import MujocoPlant as MujocoPlant
    from taut.runtime.drivers.mujoco_tip import SpringTip as SpringTip
    from taut.runtime.events import Event as Event
    from taut.runtime.simulate import run as run
    from taut.study.admissible import Admissible as Admissible
    from taut.study.compare import Comparison as Comparison
    from taut.study.compare_grade import Grade as Grade
    from taut.study.compare_truth import WrongModel as WrongModel
    from taut.study.contact_modes import FrictionMargin as FrictionMargin
    from taut.study.coupling import Coupling as Coupling
    from taut.study.coupling import coupling as coupling
    from taut.study.design import Design as Design
    from taut.study.design import design as design
    from taut.study.diagnosis import Diagnosis as Diagnosis
    from taut.study.diagnosis import doctor as doctor
    from taut.study.diagnosis_finding import Finding as Finding
    from taut.study.error_dynamics import ErrorDynamics as ErrorDynamics
    from taut.study.freedom_words import FreedomRow as FreedomRow
    from taut.study.freedoms import Freedoms as Freedoms
    from taut.study.freedoms import freedoms as freedoms
    from taut.study.impedance import check_impedance as check_impedance
    from taut.study.limits import StiffnessCheck as StiffnessCheck
    from taut.study.limits import StiffnessLimits as StiffnessLimits
    from taut.study.limits import check_stiffness as check_stiffness
    from taut.study.limits import stiffness_limits as stiffness_limits
    from taut.study.linear_loop import LinearLoop as LinearLoop
    from taut.study.linearise import linearise as linearise
    from taut.study.locus import Locus as Locus
    from taut.study.locus import locus as locus
    from taut.study.lyapunov import Lyapunov as Lyapunov
    from taut.study.lyapunov import lyapunov as lyapunov
    from taut.study.routh import RouthTable as RouthTable
    from taut.study.routh import routh as routh
    from taut.study.sampled import SampledLoop as SampledLoop
    from taut.study.sampled_errors import SampledErrorDynamics as SampledErrorDynamics
    from taut.study.second_order import second_order as second_order
    from taut.study.specification import Specification as Specification
    from taut.study.specification import check_specification as check_specification
    from taut.study.specification import possible_specifications as possible_specifications
    from taut.study.stability_map import StabilityMap as StabilityMap
    from taut.study.stability_map import stability_map as stability_map
    from taut.study.tip import check_stiffness_at as check_stiffness_at
    from taut.study.tip import safe_stiffness as safe_stiffness
    from taut.study.tip_environment import TipEnvironment as TipEnvironment
    from taut.study.tip_response import TipMeasurement as TipMeasurement
    from taut.study.tip_response import TipRanking as TipRanking
    from taut.study.tip_response import TipResponse as TipResponse
    from taut.study.tip_response import rank_tips as rank_tips
    from taut.study.tip_response import tip_impedance as tip_impedance
    from taut.study.tune import Tick as Tick
    from taut.study.tune import Trial as Trial
    from taut.study.tune import Tuned as Tuned
    from taut.study.tune import tune as tune
    from taut.study.wrist import WristCalibration as WristCalibration
    from taut.study.wrist import calibrate_wrist as calibrate_wrist
    from taut.study.wrist_poses import calibration_poses as calibration_poses

if TYPE_CHECKING:
    from typing import Any, Final

_HOME: Final = {
    "apps.compare": ("compare", "grade"),
    "arm.description": ("Arm", "Friction", "Payload"),
    "arm.gears": ("matched_ratio", "reflected_inertia"),
    "arm.load": ("load_arm",),
    "arm.servo": ("Servo",),
    "arm.servo_file": ("load_servo",),
    "arm.write_friction": ("JointWords", "to_mjcf_joints", "to_urdf_dynamics"),
    "base.errors": (
        "FileError",
        "MatchError",
        "MissingExtraError",
        "ModelError",
        "NumericalError",
        "RangeError",
        "ScenarioError",
        "ShapeError",
        "StabilityWarning",
        "TautError",
        "TraceError",
        "UnknownNameError",
        "UsageError",
    ),
    "base.pose": ("Pose",),
    "codegen.casadi": ("from_casadi", "to_casadi"),
    "codegen.function": ("native",),
    "codegen.inverse_kinematics": ("IkResult", "inverse_kinematics"),
    "control.command": ("Position", "Terms", "Torque", "Velocity"),
    "control.filters": ("LowPass", "Notch"),
    "control.gains": ("Gain", "Memory"),
    "control.guards": ("Lasting", "contact", "lasting", "moved", "no_contact", "reached", "settled"),
    "control.hybrid_motion": ("HybridMotion", "pressing"),
    "control.law": ("Law",),
    "control.limits": ("Limits",),
    "control.phase": ("Phase",),
    "control.reference": ("JointMotion", "chunk", "hold", "stream"),
    "control.sensing": ("Sensing",),
    "control.side_by_side": ("SideBySide", "together"),
    "control.steady": ("Steady",),
    "control.task_error": ("Coordinates",),
    "control.task_force": ("TaskForce",),
    "control.task_reference": ("TaskMotion",),
    "control.task_samples": ("TaskSamples",),
    "control.task_trajectory": ("Circle", "Line", "Screw"),
    "control.trajectory": ("Cubic", "JerkLimited", "Quintic", "Samples", "Sine", "Spline", "Trapezoidal"),
    "control.velocity": ("Difference", "Kalman"),
    "control.via_joint_space": ("via_joint_space",),
    "control.wrist": ("Wrist",),
    "controller": ("Controller", "compile"),
    "loop": ("Loop",),
    "maths.constraint": ("Constraint",),
    "maths.constraint_rows": ("ConstraintRows",),
    "maths.gearing": ("rotor_share",),
    "maths.ik": ("IkOutcome",),
    "maths.onto": ("onto",),
    "maths.snapshot": ("Snapshot", "snapshot"),
    "plant.actuation": ("Actuation", "Ripple"),
    "plant.contact": ("RigidContact",),
    "plant.environment": ("Environment", "Environments"),
    "plant.environment_held": ("Hand", "Handle"),
    "plant.environment_push": ("Push",),
    "plant.environment_springs": ("Damper", "Spring"),
    "plant.environment_wall": ("StiffWall",),
    "plant.environment_will": ("BandNoise", "Oscillation"),
    "plant.joint_sensors": ("Encoder", "Tachometer", "TorqueSensor"),
    "plant.motor": ("ElectricMotor", "Motor", "TorqueLoop"),
    "plant.rigid": ("RigidPlant",),
    "plant.sensors": ("Sensors",),
    "plant.tool_sensors": ("Accelerometer", "WrenchSensor"),
    "plant.transmission": ("Transmission",),
    "record.friction_curves": ("plot_friction",),
    "record.metrics": ("Metrics",),
    "record.outcome": ("Outcome",),
    "record.read_log": ("load_run",),
    "record.report": ("report",),
    "record.run": ("Run",),
    "runtime.drivers.mujoco": ("MujocoPlant",),
    "runtime.drivers.mujoco_tip": ("SpringTip",),
    "runtime.events": ("Event",),
    "runtime.simulate": ("run",),
    "study.admissible": ("Admissible",),
    "study.compare": ("Comparison",),
    "study.compare_grade": ("Grade",),
    "study.compare_truth": ("WrongModel",),
    "study.contact_modes": ("FrictionMargin",),
    "study.coupling": ("Coupling", "coupling"),
    "study.design": ("Design", "design"),
    "study.error_dynamics": ("ErrorDynamics",),
    "study.diagnosis": ("Diagnosis", "doctor"),
    "study.diagnosis_finding": ("Finding",),
    "study.freedom_words": ("FreedomRow",),
    "study.freedoms": ("Freedoms", "freedoms"),
    "study.impedance": ("check_impedance",),
    "study.limits": ("StiffnessCheck", "StiffnessLimits", "check_stiffness", "stiffness_limits"),
    "study.locus": ("Locus", "locus"),
    "study.routh": ("RouthTable", "routh"),
    "study.linear_loop": ("LinearLoop",),
    "study.linearise": ("linearise",),
    "study.lyapunov": ("Lyapunov", "lyapunov"),
    "study.sampled": ("SampledLoop",),
    "study.sampled_errors": ("SampledErrorDynamics",),
    "study.second_order": ("second_order",),
    "study.specification": ("Specification", "check_specification", "possible_specifications"),
    "study.stability_map": ("StabilityMap", "stability_map"),
    "study.tip": ("check_stiffness_at", "safe_stiffness"),
    "study.tip_environment": ("TipEnvironment",),
    "study.tip_response": ("TipMeasurement", "TipRanking", "TipResponse", "rank_tips", "tip_impedance"),
    "study.tune": ("Tick", "Trial", "Tuned", "tune"),
    "study.wrist": ("WristCalibration", "calibrate_wrist"),
    "study.wrist_poses": ("calibration_poses",),
}
_MODULES: Final = {
    "dynamics": "maths.dynamics",
    "laws": "control.laws",
    "math": "base.math",
    "textbook": "apps.textbook",
}
_UNCHECKED: Final = dict(_HOME)  # modules whose classes do not refuse their arguments in words yet
_WHERE: Final = {name: module for module, names in _HOME.items() for name in names}

__all__ = sorted([*_WHERE, *_MODULES])


def __getattr__(name: str) -> Any:
    if name in _MODULES or name in _WHERE:
        try:
            module = importlib.import_module(f"taut.{_MODULES.get(name) or _WHERE[name]}")
        except OSError as cause:  # no file descriptor left
            from taut.base.errors import FileError

            raise FileError(f"taut.{name} cannot be loaded: {cause.strerror}", name=name) from cause
        value: Any = module if name in _MODULES else getattr(module, name)
        value = value if name == "math" else _checked(name, value)  # whose functions are too quick to wrap
    else:
        from taut.base.errors import unknown_name

        raise AttributeError(str(unknown_name("taut", "public name", name, __all__)), name=name, obj=None)
    globals()[name] = value
    return value


def _checked(name: str, value: Any) -> Any:
    """A public name whose arguments are checked, as are those of the classes whose objects it may give."""
    from taut.base.signatures import checked_arguments

    for module in [module for module in _UNCHECKED if f"taut.{module}" in sys.modules]:
        for other in _UNCHECKED.pop(module):
            thing = getattr(sys.modules[f"taut.{module}"], other, None)
            if isinstance(thing, type):
                checked_arguments(thing, other)
    return checked_arguments(value, name)


def __dir__() -> list[str]:
    return __all__


def _other_package_of_this_name() -> str | None:
    """The file of another package called taut that Python could find: the package index has some."""
    for entry in sys.path:
        spec = importlib.machinery.PathFinder.find_spec("taut", [entry])
        if spec is None or spec.origin is None:
            continue
        if os.path.realpath(spec.origin) != os.path.realpath(__file__):
            return spec.origin
    return None


_other = _other_package_of_this_name()
if _other is not None:
    warnings.warn(
        f"another package called taut is installed at {_other}, and the order of sys.path decides which of the two "
        'is imported; pip uninstall taut, then pip install -e "." in the folder of this one',
        RuntimeWarning,
        stacklevel=2,
    )
