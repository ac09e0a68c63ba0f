"""Motors, gears, drivetrains, springs of variable stiffness, and a link that bends."""

from taut.base.front_door import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from taut.arm.servo import matched_ratio as matched_ratio
    from taut.arm.servo import reflected_inertia as reflected_inertia
    from taut.base.fields import Choice as Choice
    from taut.base.fields import Field as Field
    from taut.maths.springs import AntagonisticSprings as AntagonisticSprings
    from taut.maths.task_inertia import rotor_share as rotor_share
    from taut.plant.actuation import Actuation as Actuation
    from taut.plant.actuation import ElectricMotor as ElectricMotor
    from taut.plant.actuation import Motor as Motor
    from taut.plant.actuation import MotorInput as MotorInput
    from taut.plant.actuation import MotorModel as MotorModel
    from taut.plant.actuation import MotorStep as MotorStep
    from taut.plant.actuation import Ripple as Ripple
    from taut.plant.actuation import TorqueLoop as TorqueLoop
    from taut.plant.drivetrain import FrictionLaw as FrictionLaw
    from taut.plant.drivetrain import Transmission as Transmission
    from taut.plant.flexible_link import FlexibleLink as FlexibleLink
    from taut.plant.variable_stiffness import VariableStiffnessActuator as VariableStiffnessActuator

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
