"""Trajectories of joints and of the tool."""

from taut.base.front_door import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from taut.control.trajectories.force_reference import HybridMotion as HybridMotion
    from taut.control.trajectories.joint import Cubic as Cubic
    from taut.control.trajectories.joint import Fourier as Fourier
    from taut.control.trajectories.joint import JerkLimited as JerkLimited
    from taut.control.trajectories.joint import Quintic as Quintic
    from taut.control.trajectories.joint import Septic as Septic
    from taut.control.trajectories.joint import Sine as Sine
    from taut.control.trajectories.joint import Spline as Spline
    from taut.control.trajectories.joint import Trapezoidal as Trapezoidal
    from taut.control.trajectories.reference import SmoothMotion as SmoothMotion
    from taut.control.trajectories.samples import Learned as Learned
    from taut.control.trajectories.samples import Samples as Samples
    from taut.control.trajectories.samples import TaskSamples as TaskSamples
    from taut.control.trajectories.task import Circle as Circle
    from taut.control.trajectories.task import Line as Line
    from taut.control.trajectories.task import Steady as Steady
    from taut.control.trajectories.transition import Transition as Transition

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
