"""What acts on the tool: springs, dampers, walls, hands, pushes."""

from taut.base.front_door import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from taut.base.fields import Choice as Choice
    from taut.base.fields import Field as Field
    from taut.plant.environments.environment import Environment as Environment
    from taut.plant.environments.environment import Environments as Environments
    from taut.plant.environments.kinds import Damper as Damper
    from taut.plant.environments.kinds import Hand as Hand
    from taut.plant.environments.kinds import Oscillation as Oscillation
    from taut.plant.environments.kinds import Push as Push
    from taut.plant.environments.kinds import Spring as Spring
    from taut.plant.environments.kinds import StiffWall as StiffWall
    from taut.runtime.robots.mujoco.model import SpringTip as SpringTip

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
