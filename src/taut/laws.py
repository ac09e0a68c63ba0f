"""Control laws."""

from taut.base.front_door import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from taut.control.closed_loop import ClosedLoop as ClosedLoop
    from taut.control.combine import SideBySide as SideBySide
    from taut.control.combine import Sum as Sum
    from taut.control.combine import Wrapper as Wrapper
    from taut.control.command import MitCommand as MitCommand
    from taut.control.gains import Integral as Integral
    from taut.control.laws.admittance import Admittance as Admittance
    from taut.control.laws.applied_wrench import AppliedWrench as AppliedWrench
    from taut.control.laws.force import ForceControl as ForceControl
    from taut.control.laws.hybrid import HybridMotionForce as HybridMotionForce
    from taut.control.laws.impedance import Impedance as Impedance
    from taut.control.laws.impedance import Stiffness as Stiffness
    from taut.control.laws.joint import PID as PID
    from taut.control.laws.joint import ComputedTorque as ComputedTorque
    from taut.control.laws.joint import Dither as Dither
    from taut.control.laws.joint import FeedForward as FeedForward
    from taut.control.laws.joint import FrictionCompensation as FrictionCompensation
    from taut.control.laws.joint import GravityCompensation as GravityCompensation
    from taut.control.laws.joint import GravityPID as GravityPID
    from taut.control.laws.joint import JointPosition as JointPosition
    from taut.control.laws.joint import RaisedGains as RaisedGains
    from taut.control.laws.joint import StateFeedback as StateFeedback
    from taut.control.laws.joint import VelocityPI as VelocityPI
    from taut.control.laws.null_space import LimitAvoidance as LimitAvoidance
    from taut.control.laws.null_space import Manipulability as Manipulability
    from taut.control.laws.null_space import Posture as Posture
    from taut.control.laws.other_topics.adaptive import Adaptive as Adaptive
    from taut.control.laws.other_topics.disturbance import CollisionReflex as CollisionReflex
    from taut.control.laws.other_topics.disturbance import DisturbanceRejection as DisturbanceRejection
    from taut.control.laws.other_topics.flexible_joint import FastTorqueLoop as FastTorqueLoop
    from taut.control.laws.other_topics.flexible_joint import FlexibleJointLinearisation as FlexibleJointLinearisation
    from taut.control.laws.other_topics.flexible_joint import FullStateFeedback as FullStateFeedback
    from taut.control.laws.other_topics.flexible_joint import JointTorqueFeedback as JointTorqueFeedback
    from taut.control.laws.other_topics.flexible_joint import MotorSide as MotorSide
    from taut.control.laws.other_topics.flexible_joint import MotorSidePD as MotorSidePD
    from taut.control.laws.other_topics.robust import Robust as Robust
    from taut.control.laws.other_topics.robust import Uncertainty as Uncertainty
    from taut.control.laws.other_topics.variable_stiffness import VariableStiffness as VariableStiffness
    from taut.control.laws.task import TaskComputedTorque as TaskComputedTorque
    from taut.control.laws.task import TaskPosition as TaskPosition
    from taut.control.laws.task import TaskVelocity as TaskVelocity
    from taut.control.laws.via_joint_space import ViaJointSpace as ViaJointSpace
    from taut.control.laws.via_mit import ViaMit as ViaMit
    from taut.control.laws.virtual_objects import VirtualBall as VirtualBall
    from taut.control.laws.virtual_objects import VirtualGroove as VirtualGroove
    from taut.control.laws.virtual_objects import VirtualWall as VirtualWall
    from taut.control.laws.wrappers import EnergyTank as EnergyTank
    from taut.control.laws.wrappers import LossOfContact as LossOfContact
    from taut.control.laws.wrappers import NormalEstimate as NormalEstimate

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
