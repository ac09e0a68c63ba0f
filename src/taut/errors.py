"""Errors of the library; each is a TautError and a built-in error."""

from taut.base.front_door import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
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
    from taut.runtime.realtime.status import RobotError as RobotError
    from taut.runtime.robots.driver import DriverError as DriverError

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
