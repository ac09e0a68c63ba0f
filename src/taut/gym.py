"""Environments of Gymnasium over scenarios; needs the package gymnasium."""

from taut.base.front_door import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from taut.scenarios.episodes import Episode as Episode
    from taut.scenarios.gymnasium_env import ScenarioEnv as ScenarioEnv
    from taut.scenarios.gymnasium_env import ScenarioVectorEnv as ScenarioVectorEnv

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
