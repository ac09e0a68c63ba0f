"""Robots: drivers of your own for `taut.connect`, what they declare, and the errors of a robot's loop."""

from taut.base.front_door import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from taut.control.faults import FAULTS as FAULTS
    from taut.control.faults import Fault as Fault
    from taut.runtime.realtime.bringup import BringUp as BringUp
    from taut.runtime.realtime.bringup import bring_up as bring_up
    from taut.runtime.realtime.robot import Robot as Robot
    from taut.runtime.realtime.status import RobotError as RobotError
    from taut.runtime.realtime.status import RobotStatus as RobotStatus
    from taut.runtime.realtime.status import Timing as Timing
    from taut.runtime.robots.can import CanMotors as CanMotors
    from taut.runtime.robots.driver import DriverError as DriverError
    from taut.runtime.robots.driver import RobotDriver as RobotDriver
    from taut.runtime.robots.driver import RobotInfo as RobotInfo

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
