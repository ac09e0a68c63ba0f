"""Sensors of a plant, and the filters with which a controller reads them."""

from taut.base.front_door import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from taut.base.fields import Choice as Choice
    from taut.base.fields import Field as Field
    from taut.control.observer import MomentumObserver as MomentumObserver
    from taut.control.sensing import Difference as Difference
    from taut.control.sensing import Kalman as Kalman
    from taut.control.sensing import LowPass as LowPass
    from taut.control.sensing import Notch as Notch
    from taut.control.sensing import Wrist as Wrist
    from taut.plant.sensors import Accelerometer as Accelerometer
    from taut.plant.sensors import Encoder as Encoder
    from taut.plant.sensors import Sensor as Sensor
    from taut.plant.sensors import Sensors as Sensors
    from taut.plant.sensors import Tachometer as Tachometer
    from taut.plant.sensors import TorqueSensor as TorqueSensor
    from taut.plant.sensors import WrenchSensor as WrenchSensor

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
